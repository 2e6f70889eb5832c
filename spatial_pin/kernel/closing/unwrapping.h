/* Named coordinates: angles unwrapped to them, and the distance from them, see unwrapping.c. */
#ifndef SPATIAL_PIN_UNWRAPPING_H
#define SPATIAL_PIN_UNWRAPPING_H

#include "kernel.h"

/* Of an entry of q, in bits: its value is named, or is fixed; whole turns mean nothing. */
enum NamedKind { NAMED = 1, HELD = 2, TURNS = 4 };

typedef struct {
    const Real *value; /* (nq) of what is named or fixed; of a ball a quaternion; NULL: of nothing */
    const Int *kinds;           /* (nq) of a ball its first entry counts */
    const Real *lower, *upper; /* (nq) limits */
} Named;

void unwrap_angles(const Kernel *k, const Named *named, Real *q);
Real named_distance(const Kernel *k, const Named *named, const Real *q);

#endif
