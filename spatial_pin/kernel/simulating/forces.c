/* Forces by Newton's and Euler's equations, body by body: what each needs to move as it does, less
 * the forces on it, gathered along the tree to the residuals at the joints [Featherstone2008, 5.3].
 * Springs act as forces on the bodies, gravity too. */
#include <string.h>

#include "forces.h"

/* ---- bodies ---- */

/* The force at the centre of mass and the moment about the world origin that a body needs. */
static void needed(const Kernel *k, Int j, Real *force, Real *moment)
{
    const Real *R = k->R + 9 * j, *w = k->omega + 3 * j, *alpha = k->alpha + 3 * j;
    Real centre[3], point[3], swing[3], once[3], turning[3], w_own[3], alpha_own[3], own[3], spun[3];
    rotate3(R, k->bodies.com + 3 * j, centre);
    cross3(w, centre, once);
    cross3(w, once, swing);
    cross3(alpha, centre, turning);
    for (int i = 0; i < 3; i++)
        force[i] = k->bodies.mass[j] *
                   (k->acceleration[3 * j + i] + turning[i] + swing[i] - k->bodies.gravity[i]);
    rotate_back3(R, w, w_own);
    rotate_back3(R, alpha, alpha_own);
    inertia_times(k, j, w_own, spun);
    cross3(w_own, spun, own);
    inertia_times(k, j, alpha_own, spun);
    add3(1.0, spun, own);
    rotate3(R, own, moment);
    copy3(k->p + 3 * j, point);
    add3(1.0, centre, point);
    cross3(point, force, once);
    add3(1.0, once, moment);
}

/* Forces and moments that all bodies need. */
static void bodies_need(Dynamics *d)
{
    Kernel *k = d->k;
    for (Int j = 0; j < k->n_joints; j++) {
        zero3(d->forces.springs.force + 3 * j);
        zero3(d->forces.springs.moment + 3 * j);
        if (j > 0 && moves_mass(k, j))
            needed(k, j, d->forces.springs.force + 3 * j, d->forces.springs.moment + 3 * j);
    }
}

int forces_on_bodies(Dynamics *d)
{
    bodies_need(d);
    return springs_on_bodies(d->k, &d->forces.springs) == DONE ? DONE : CALLBACK_FAILED;
}

/* ---- joints ---- */

int forces_at_joints(Dynamics *d, Real t, const Real *q)
{
    Kernel *k = d->k;
    const Real *v = d->v;
    memcpy(d->forces.given, d->forces.constant, (size_t)k->nv * sizeof *d->forces.given);
    if (d->callbacks.efforts && d->callbacks.efforts(t, q, v, d->turns, d->forces.given) != DONE)
        return CALLBACK_FAILED;
    for (Int i = 0; d->forces.resists && i < k->nv; i++) {
        if (d->forces.damping[i] != 0.0)
            d->forces.given[i] -= d->forces.damping[i] * v[i];
        if (d->forces.friction[i] != 0.0)
            d->forces.given[i] -= d->forces.friction[i] * tanh(v[i] / d->forces.slip[i]);
    }
    for (Int i = 0; i < d->forces.n_turns; i++) {
        Real force = 0.0;
        const Int at = d->forces.turn_v[i];
        if (spring_force(&d->forces.springs, d->forces.springs.n_lines + i, d->forces.turn_law[i],
                         d->forces.turn_spring + 3 * i, d->q[d->forces.turn_q[i]], v[at], &force) != DONE)
            return CALLBACK_FAILED;
        d->forces.given[at] -= force;
    }
    for (Int i = 0; i < k->nv; i++)
        d->forces.springs.power += d->forces.given[i] * v[i];
    return DONE;
}

void forces_missing(Dynamics *d, const Real *a)
{
    Kernel *k = d->k;
    for (Int j = k->n_joints - 1; j > 0; j--) {
        const Int up = 3 * k->parent[j];
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++)
            d->forces.tau[v] = dot3(d->forces.springs.force + 3 * j, k->linear + 3 * v) +
                               dot3(d->forces.springs.moment + 3 * j, k->angular + 3 * v) +
                               d->forces.armature[v] * a[v] - d->forces.given[v];
        add3(1.0, d->forces.springs.force + 3 * j, d->forces.springs.force + up);
        add3(1.0, d->forces.springs.moment + 3 * j, d->forces.springs.moment + up);
    }
}

/* ---- energy ---- */

Real forces_energy(Dynamics *d, Real *kinetic)
{
    Kernel *k = d->k;
    Real moving = 0.0, stored = 0.0;
    for (Int j = 1; j < k->n_joints; j++) {
        if (!moves_mass(k, j))
            continue;
        Real at[3], velocity[3], w[3], moment[3];
        body_point(k, j, k->bodies.com + 3 * j, at, velocity);
        rotate_back3(k->R + 9 * j, k->omega + 3 * j, w);
        inertia_times(k, j, w, moment);
        moving += 0.5 * (k->bodies.mass[j] * dot3(velocity, velocity) + dot3(w, moment));
        stored -= k->bodies.mass[j] * dot3(k->bodies.gravity, at);
    }
    for (Int v = 0; v < k->nv; v++)
        moving += 0.5 * d->forces.armature[v] * d->v[v] * d->v[v];
    for (Int i = 0; i < d->forces.springs.n_lines + d->forces.n_turns; i++) {
        const int line = i < d->forces.springs.n_lines;
        const Int at = line ? i : i - d->forces.springs.n_lines;
        const Real *spring = (line ? d->forces.springs.line_spring : d->forces.turn_spring) + 3 * at;
        if (line ? d->forces.springs.line_law[at] : d->forces.turn_law[at])
            continue;
        const Real length = line ? spring_line(k, &d->forces.springs, at).length : d->q[d->forces.turn_q[at]];
        const Real x = length - spring[2];
        stored += 0.5 * spring[0] * x * x;
    }
    *kinetic = moving;
    return moving + stored + bushings_energy(k, &d->forces.springs);
}
