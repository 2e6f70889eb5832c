/* Components of balls and floating joints, which are no entries of q and whose rates are none of v.
 *
 * Of a rotation it is a component of the rotation vector, of length up to pi; of a floating joint
 * also one of the position in its parent. */
#ifndef SPATIAL_PIN_PINS_H
#define SPATIAL_PIN_PINS_H

#include "kernel.h"

/* One component: the first places of its kind in q and v, x y or z, whether of the rotation. */
struct Pin {
    Int q, v, component, turns;
};

/* Rotation vector, of length up to pi, of a quaternion x, y, z, w. */
void rotation_vector(const Real *quaternion, Real *phi);
/* Row of its derivative by the angular velocity w in the axes of what turns: for a unit vector a,
 * a . phi' = (a + a x phi / 2 + g (a x phi) x phi) . w, with g of pins.c. */
void rotation_vector_row(const Real *phi, Int component, Real *row);

/* The component that velocity entry v is that of; 0 where it is the entry of a single freedom. */
int pin_of(const Kernel *k, Int v, Pin *pin);

int pins_are_sound(const Kernel *k, const Pin *pin, Int n);

/* Give components their values in q: those of one rotation vector together, which come side by
 * side. The quaternion keeps the sign that is nearer to what it was. */
void pins_put(const Pin *pin, Int n, const Real *value, Real *q);

Real pin_value(const Pin *pin, const Real *q);

/* The value with as many whole turns as bring it nearest to the wanted value, of a rotation about the
 * component's own axis, which may go on past half a turn; else as `pin_value`. */
Real pin_value_near(const Pin *pin, const Real *q, Real wanted);

/* Derivative (3) of the value with respect to the velocities from `pin->v` on. */
void pin_row(const Pin *pin, const Real *q, Real *row);

/* The same with respect to v / scale, by the scale of the value, at the kernel's q. */
void pin_scaled_row(const Kernel *k, const Pin *pin, Real *row);

/* Second derivative of the value at joint rates v and zero joint accelerations. */
Real pin_bias(const Pin *pin, const Real *q, const Real *v);

/* The factor g of phi' = w - phi x w / 2 + g phi x (phi x w), w in the axes that phi starts from, and
 * its derivative by s, at s = phi . phi. */
void rotation_factors(Real s, Real *g, Real *slope);

#endif
