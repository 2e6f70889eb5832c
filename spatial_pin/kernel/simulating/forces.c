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

/* A point of a body and its velocity; needs the rates of the tree. */
static void body_point(const Kernel *k, Int j, const Real *local, Real *at, Real *velocity)
{
    Real arm[3];
    rotate3(k->R + 9 * j, local, arm);
    copy3(k->p + 3 * j, at);
    add3(1.0, arm, at);
    cross3(k->omega + 3 * j, arm, velocity);
    add3(1.0, k->velocity + 3 * j, velocity);
}

#define COINCIDENT 1e-15 /* part of a position that is round-off */

typedef struct {
    Real length, rate, along[3], end[3];
} Line;

static Line line_between(const Dynamics *d, Int i)
{
    Line line;
    Real first[3], v1[3], v2[3];
    body_point(d->k, d->forces.line_body[2 * i], d->forces.line_point + 6 * i, first, v1);
    body_point(d->k, d->forces.line_body[2 * i + 1], d->forces.line_point + 6 * i + 3, line.end, v2);
    copy3(line.end, line.along);
    add3(-1.0, first, line.along);
    add3(-1.0, v1, v2);
    line.length = sqrt(dot3(line.along, line.along));
    if (line.length <= COINCIDENT * sqrt(dot3(line.end, line.end))) { /* it parts as it moves */
        line.length = 0.0;
        copy3(v2, line.along);
    }
    const Real size = sqrt(dot3(line.along, line.along));
    for (int c = 0; c < 3; c++)
        line.along[c] = size > 0.0 ? line.along[c] / size : 0.0;
    line.rate = dot3(line.along, v2);
    return line;
}

/* Force of a spring, and how fast it stores energy. */
static int pull(const Dynamics *d, Int which, Int has_law, const Real *spring, Real length,
                Real rate, Real *force, Real *storing)
{
    if (has_law)
        return d->callbacks.spring(which, length, rate, force);
    *force = spring[0] * (length - spring[2]) + spring[1] * rate;
    *storing += spring[0] * (length - spring[2]) * rate;
    return DONE;
}

/* Forces and moments that all bodies need. */
static void bodies_need(Dynamics *d)
{
    Kernel *k = d->k;
    for (Int j = 0; j < k->n_joints; j++) {
        zero3(d->forces.force + 3 * j);
        zero3(d->forces.moment + 3 * j);
        if (j > 0 && moves_mass(k, j))
            needed(k, j, d->forces.force + 3 * j, d->forces.moment + 3 * j);
    }
}

/* Take the forces of springs between points from what bodies need; adds their power. */
static int springs_on_bodies(Dynamics *d)
{
    for (Int i = 0; i < d->forces.n_lines; i++) {
        const Line line = line_between(d, i);
        Real force = 0.0, moment[3];
        if (pull(d, i, d->forces.line_law[i], d->forces.line_spring + 3 * i, line.length, line.rate,
                 &force, &d->forces.power) != DONE)
            return CALLBACK_FAILED;
        d->forces.power -= force * line.rate;
        cross3(line.end, line.along, moment);
        for (int side = 0; side < 2; side++) {
            const Int at = 3 * d->forces.line_body[2 * i + side];
            const Real sign = side ? 1.0 : -1.0; /* pulled back towards the first */
            add3(sign * force, line.along, d->forces.force + at);
            add3(sign * force, moment, d->forces.moment + at);
        }
    }
    return DONE;
}

int forces_on_bodies(Dynamics *d)
{
    bodies_need(d);
    return springs_on_bodies(d) == DONE ? bushings_on_bodies(d) : CALLBACK_FAILED;
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
        if (pull(d, d->forces.n_lines + i, d->forces.turn_law[i], d->forces.turn_spring + 3 * i,
                 d->q[d->forces.turn_q[i]], v[at], &force, &d->forces.power) != DONE)
            return CALLBACK_FAILED;
        d->forces.given[at] -= force;
    }
    for (Int i = 0; i < k->nv; i++)
        d->forces.power += d->forces.given[i] * v[i];
    return DONE;
}

void forces_missing(Dynamics *d, const Real *a)
{
    Kernel *k = d->k;
    for (Int j = k->n_joints - 1; j > 0; j--) {
        const Int up = 3 * k->parent[j];
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++)
            d->forces.tau[v] = dot3(d->forces.force + 3 * j, k->linear + 3 * v) +
                               dot3(d->forces.moment + 3 * j, k->angular + 3 * v) +
                               d->forces.armature[v] * a[v] - d->forces.given[v];
        add3(1.0, d->forces.force + 3 * j, d->forces.force + up);
        add3(1.0, d->forces.moment + 3 * j, d->forces.moment + up);
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
    for (Int i = 0; i < d->forces.n_lines + d->forces.n_turns; i++) {
        const int line = i < d->forces.n_lines;
        const Int at = line ? i : i - d->forces.n_lines;
        const Real *spring = (line ? d->forces.line_spring : d->forces.turn_spring) + 3 * at;
        if (line ? d->forces.line_law[at] : d->forces.turn_law[at])
            continue;
        const Real x = (line ? line_between(d, at).length : d->q[d->forces.turn_q[at]]) - spring[2];
        stored += 0.5 * spring[0] * x * x;
    }
    *kinetic = moving;
    return moving + stored + bushings_energy(d);
}
