/* A path between two of its points. */
#ifndef SPATIAL_PIN_INTERPOLATING_H
#define SPATIAL_PIN_INTERPOLATING_H

#include "path_point.h"

/* Configuration q (nq), and t, c (nv) as in `Point`, at a driver value between two points: Hermite's
 * polynomials of fifth degree for the entries of q. With w the way between the points and e what
 * is missing of q in the middle, second derivatives by the way miss up to 24 e / w². */
void point_between(const Kernel *k, const Point *a, const Point *b, Real s, Real *q, Real *t,
                   Real *c);

#endif
