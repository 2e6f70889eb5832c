/* Functions of one variable: piecewise polynomials, the square root, functions of the caller. */
#ifndef SPATIAL_PIN_PIECEWISE_H
#define SPATIAL_PIN_PIECEWISE_H

#include "vectors.h"

/* Its shape: place of its first number among all, pieces, degree, whether it repeats. Its numbers:
   (pieces + 1) breaks, ascending; (pieces, degree + 1) coefficients, ascending powers of x less the
   break that a piece begins at; what it gains with every period. Without pieces, and numbers, it is
   the square root, or a function of the caller where CALLED is 1. */
enum { FIRST_NUMBER = 0, PIECES = 1, DEGREE = 2, CALLED = 2, REPEATS = 3, SHAPE = 4 };

/* A function of the caller: x, and where to write the value and its first two derivatives. */
typedef void (*Called)(Real, Real *);

/* Value and first two derivatives (3) at x; beyond its ends the last pieces go on, or it repeats. What
   is not there, as a function that the caller has not given, is NaN. `piece`: the one it was at
   before, and is at. */
void piecewise_at(const Int *shape, const Real *numbers, Called called, Real x, Int *piece, Real *out);
/* How many numbers n functions have; -1 if their shapes do not fit together. */
Int piecewise_size(const Int *shape, Int n);

#endif
