/* Coordinates of joints relative to a configuration, the start: those with one entry of q by its
 * change, rotations by the rotation vector from the start, slides of free joints along the axes
 * there. All by the velocity's scale. */
#ifndef SPATIAL_PIN_RELATIVE_H
#define SPATIAL_PIN_RELATIVE_H

#include "kernel.h"

/* The coordinate of a component (0..2 of a ball, 0..5 of a free joint) of joint j at q. */
Real relative_coordinate(const Kernel *k, Int j, Int component, const Real *start, const Real *q);

/* Its derivative (3) by the joint's velocity, rotating or sliding, of a ball or free joint. */
void relative_row(const Kernel *k, Int j, Int component, const Real *start, const Real *q,
                  Real *row);

/* Its rate at v / scale (nv), given that row. */
Real relative_rate_by(const Kernel *k, Int j, Int component, const Real *row, const Real *v);

/* The configuration (nq) at coordinates x (nv) of all joints, and these at a configuration. */
void relative_configuration(Kernel *k, const Real *start, const Real *x, Real *q);
void relative_coordinates(const Kernel *k, const Real *start, const Real *q, Real *x);

/* Rates (nv) of the coordinates of all joints at q, at joint velocities v. */
void relative_rates(const Kernel *k, const Real *start, const Real *q, const Real *v, Real *rates);

#endif
