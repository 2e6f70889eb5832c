/* A point of a path, and where the path goes from one or two of them. */
#ifndef SPATIAL_PIN_PATH_POINT_H
#define SPATIAL_PIN_PATH_POINT_H

#include "idle_rotation.h"
#include "prescribing.h"

typedef struct {
    Real s;                   /* the path's parameter, as a rule the driver's value */
    Real *q, *first, *second; /* configuration, derivatives of its entries by s; behind them the angles' */
    Real *t, *c;              /* first and second derivative by s, joint rates */
    Real *angle, *angle_rate; /* of screws, counting turns: the entries behind those of q, first */
    IdleAxis *axis;           /* of links with an idle rotation */
    Real pace, bend;          /* norms of t and c, scaled */
    Real size;                /* of the determinant: its binary logarithm */
    Real error;               /* largest residual of all closure equations */
} Point;

/* How many numbers a point needs, and how it takes them from memory that is left. */
Int point_numbers(const Kernel *k);
void point_carve(const Kernel *k, Real **from, Point *point);

/* All that follows from q and the prescribed values there, where the kernel is evaluated and factored.
 * DONE, or NOT_FINITE where rates are no numbers. */
int point_rates(Kernel *k, const Prescribed *prescribed, Point *point);

/* Second derivatives of its angles, after its rates. */
void point_bend_angles(Kernel *k, Point *point);

/* Norm of the scaled way of the joints over a step h, by Taylor's series to second order. */
Real point_way(const Kernel *k, const Point *point, Real h);

/* The same as the sum of what its two terms go, there and back. */
Real point_reach(const Point *point, Real h);

/* q (nq) a step h from a point: Taylor's series of an order from 0 to 2, or to 3, the derivative
 * being the difference of two second ones, where there is a point before. */
void predict_taylor(const Kernel *k, const Point *at, const Point *before, Real h, Int order,
                    Real *q);

/* The same by Hermite's polynomial of fifth degree through two points. Its error is
 * r^3 (1 + r)^3 times the sixth derivative, over 720, with r = h by the distance of the points. */
void predict_hermite(const Kernel *k, const Point *before, const Point *at, Real h, Real *q);

/* Whether a step h is so short that round-off of the two points does not show in that. */
int hermite_reaches(const Point *before, const Point *at, Real h);

#endif
