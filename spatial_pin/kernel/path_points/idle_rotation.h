/* The idle rotation of a link: its rotation about its own axis, which moves nothing else.
 *
 * Its rate about that axis is zero all along a path, which is a statement on rates and not on
 * configurations: the link's rotation must be followed. A link that never rotates about its axis e
 * is carried by e as by parallel transport on the sphere. Between two points of a path that is the
 * least rotation that takes e to where it is then, and about e the solid angle between the path
 * of e and the great circle (Gauss-Bonnet). */
#ifndef SPATIAL_PIN_IDLE_ROTATION_H
#define SPATIAL_PIN_IDLE_ROTATION_H

#include "kernel.h"

/* The axis of one link at a point of a path, world axes. */
typedef struct {
    Real e[3];      /* unit vector */
    Real first[3];  /* its derivatives by the driver */
    Real second[3];
    Real mark[3];   /* a unit vector of the link normal to it, */
    Real normal[3]; /* and in the axes of the link */
} IdleAxis;

/* The path of e through two or three points, each with two derivatives, in Newton's form:
 * the sum of d[i] (u - z[0]) .. (u - z[i - 1]), u being 0 at the first point and 1 at the second. */
typedef struct {
    int n;
    Real z[9], d[9][3];
    Real mark[3]; /* of the link at the first point */
} IdleCurve;

/* Which of the kernel's vectors is the axis of idle rotation number `idle`. */
Int idle_vector(const Kernel *k, Int idle);
/* The axis, after the rates and accelerations dq/ds, d2q/ds2. */
void idle_axis(const Kernel *k, Int idle, IdleAxis *axis);

/* The path from one point to one a step h later; `before` is a point a gap earlier than `from`, or NULL. */
void idle_curve(const IdleAxis *before, const IdleAxis *from, const IdleAxis *to, Real gap, Real h,
                IdleCurve *curve);
/* What the curve through three points leaves of the rotation at u = 1 by estimate [rad]; 0 where two points
 * do not tell. */
Real idle_error(const IdleCurve *curve, const Real *end);

/* How far the link has turned about its axis [rad] on the way to u, where axis and mark are these. */
Real idle_turned(const IdleCurve *curve, const Real *e, const Real *mark, Real u);

/* The axis once the link is turned about it. */
void idle_turn(IdleAxis *axis, Real angle);

#endif
