/* Configurations as they are meant: see meant.c. */
#ifndef SPATIAL_PIN_MEANT_H
#define SPATIAL_PIN_MEANT_H

#include "kernel.h"

/* What is said of an entry of q, in bits. */
enum Said { NAMED = 1, HELD = 2, TURNS = 4 }; /* TURNS: it means the same after a whole turn */

typedef struct {
    const Real *value;         /* (nq) of what is named or held; of a ball a quaternion */
    const Int *said;           /* (nq) of a ball its first entry counts */
    const Real *lower, *upper; /* (nq) limits */
} Meant;

void meant_put_turns(const Kernel *k, const Meant *meant, Real *q);
Real meant_distance(const Kernel *k, const Meant *meant, const Real *q);

#endif
