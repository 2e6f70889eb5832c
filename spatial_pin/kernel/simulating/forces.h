/* Forces on bodies and joints of a moving mechanism (forces.c), and its masses (masses.c). */
#ifndef SPATIAL_PIN_FORCES_H
#define SPATIAL_PIN_FORCES_H

#include "dynamics.h"

/* Forces and moments about the world origin that bodies need to move as the tree's rates and
 * accelerations say, less those that springs between points exert; adds the power of these to
 * d->forces.springs.power. DONE or CALLBACK_FAILED. */
int forces_on_bodies(Dynamics *d);
/* Efforts, and what resists and turns back at joints: joint forces d->forces.given; adds their power.
 * They see the configuration q. DONE or CALLBACK_FAILED. */
int forces_at_joints(Dynamics *d, Real t, const Real *q);
/* Joint forces d->forces.tau that are missing, after both, at joint accelerations a. */
void forces_missing(Dynamics *d, const Real *a);
/* The energy, and what of it is kinetic; needs the rates of the tree. */
Real forces_energy(Dynamics *d, Real *kinetic);

/* d->z := (Gᵀ M G)⁻¹ d->z, see dynamics.c; 0 where digits would be lost. */
int masses_solve(Dynamics *d);

static inline int moves_mass(const Kernel *k, Int j)
{
    const Real *I = k->bodies.inertia + 9 * j;
    return k->bodies.mass[j] != 0.0 || I[0] != 0.0 || I[4] != 0.0 || I[8] != 0.0;
}

/* out = I w, of a body in its own axes. */
static inline void inertia_times(const Kernel *k, Int j, const Real *w, Real *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = dot3(k->bodies.inertia + 9 * j + 3 * i, w);
}

#endif
