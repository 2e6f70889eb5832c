/* A path between two of its points. */
#ifndef SPATIAL_PIN_INTERPOLATING_H
#define SPATIAL_PIN_INTERPOLATING_H

#include "lane.h"
#include "path_point.h"

#define BETWEEN_DEGREE 8 /* the highest */
#define BETWEEN_NEAREST 0.4 /* distances of two points that a third one is to be away: nearer it tells little
                               but round-off */

/* Polynomials for the entries of q, and for the angles of screws. */
typedef struct {
    Real s, h; /* where they begin, and how long they are */
    Int degree;
    Real third; /* what a third point changes in the middle, scaled */
    Real *coefficient; /* (nq + n_angles, BETWEEN_DEGREE + 1) of (s' - s) / h, from the constant one on */
} Between;

/* The longest step from a point for whose polynomials a third one is far enough from both ends, behind
 * them or ahead in the sense of a number. */
Real third_reaches(const Point *third, const Point *from, Real sense);

/* Put them through two points, and through a third one outside, unless it is NULL or at no good
 * distance. */
void between_make(const Kernel *k, const Point *third, const Point *a, const Point *b, Between *p);

/* Configurations q (n, nq), t, c (n, nv) and angles (n, n_angles) as in `Point`, at driver values between the
 * points: LANES of them at most. */
void between_at(const Kernel *k, const Between *p, const Real *s, Int n, Real *q, Real *t, Real *c,
                Real *angle);
/* The first three of one value at once, by polynomials through two points. */
void point_between(const Kernel *k, const Point *a, const Point *b, Real s, Real *q, Real *t, Real *c);

#endif
