/* Closing the loops from a guess, by the least motion: see closing.c. */
#ifndef SPATIAL_PIN_CLOSING_H
#define SPATIAL_PIN_CLOSING_H

#include "kernel.h"

typedef struct Closer Closer;

EXPORT int closer_create(Kernel *k, const Int *rotations, Int n_rotations, const Int *pins,
                         Int n_pins, Closer **out);
EXPORT void closer_close(Closer *c, Real *q, const Int *first, const Int *free,
                         const Real *pinned, const Real *reference, Real loose, Real tolerance,
                         Int iterations, Real cut, Real *error, Int *mirrored);
EXPORT int closer_examine(Closer *c, const Real *q, const Real *reference, Real *facts, Real *angle,
                          Int *mirrored);

#endif
