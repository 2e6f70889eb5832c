/* Which rows of a matrix are independent: the one way in which the package chooses them. */
#ifndef SPATIAL_PIN_CHOOSING_H
#define SPATIAL_PIN_CHOOSING_H

#include "kernel.h"

/* Choose rows of a matrix (n, width), stored by rows: `most` of them at most, the longest one left
 * first, as long as one is left whose length is more than a part of the first one's. Returns how many;
 * -1 where there is no memory. `chosen`, ascending. facts: (2), or NULL: length of the last one chosen,
 * 0 if none is, and the remainder of the longest of the others, less its part along the chosen, both
 * relative to the length of the first one. */
EXPORT Int independent_rows(Int n, Int width, const Real *rows, Int most, Real part, Int *chosen,
                            Real *facts);

/* The same of n equations of the evaluated Jacobian: those `among`, or where that is NULL the first.
 * `chosen` may be `among`. */
Int independent_equations(const Kernel *k, const Int *among, Int n, Int most, Real part,
                          Int *chosen, Real *facts);

/* Length of the derivative of an equation with respect to v / scale. */
Real equation_length(const Kernel *k, Int i);

#endif
