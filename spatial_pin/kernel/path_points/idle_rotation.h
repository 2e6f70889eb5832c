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
    Real mark[3];   /* a unit vector of the link normal to it */
} IdleAxis;

/* The axis of idle rotation number `idle`, after the rates and accelerations dq/ds, d2q/ds2. */
void idle_axis(const Kernel *k, Int idle, IdleAxis *axis);

/* How far the link has turned about its axis from one point to one a step h later [rad].
 *
 * `before` is a point a gap earlier than `from`, or NULL. `error` becomes the remainder of the
 * angle's error by estimate [rad]; 0 where two points do not tell. */
Real idle_turned(const IdleAxis *before, const IdleAxis *from, const IdleAxis *to, Real gap, Real h,
                 Real *error);

/* The axis once the link is turned about it. */
void idle_turn(IdleAxis *axis, Real angle);

#endif
