/* Piecewise polynomials of one variable. */
#ifndef SPATIAL_PIN_PIECEWISE_H
#define SPATIAL_PIN_PIECEWISE_H

#include "vectors.h"

/* Its shape: place of its first number among all, pieces, degree, whether it repeats. Its numbers:
   (pieces + 1) breaks, ascending; (pieces, degree + 1) coefficients, ascending powers of x less the
   break that a piece begins at; what it gains with every period. */
enum { FIRST_NUMBER = 0, PIECES = 1, DEGREE = 2, REPEATS = 3, SHAPE = 4 };

/* Value and first two derivatives at x; beyond its ends the last pieces go on, or it repeats. */
void piecewise_at(const Int *shape, const Real *numbers, Real x, Real *value, Real *slope,
                  Real *bend);
/* How many numbers n functions have; -1 if their shapes do not fit together. */
Int piecewise_size(const Int *shape, Int n);

#endif
