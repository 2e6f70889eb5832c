/* Accelerations of independent coordinates under forces.
 *
 * With G the joint velocities per unit rate of the free coordinates and a0 the joint accelerations
 * at which these have none, virtual work along G gives
 *     G^T (M (a0 + G z) + b - f) = 0      [Wehage1982]
 * for their accelerations z. M a0 + b - f is what forces.c finds missing, G^T M G is that of
 * masses.c. */
#include <string.h>

#include "forces.h"
#include "interpolating.h"

/* ---- velocities and accelerations at unknowns ---- */

/* Joint velocities without spins, for rates of the held coordinates by scale. */
static void velocities(Dynamics *d, const Real *held)
{
    Kernel *k = d->k;
    memset(d->v, 0, (size_t)k->nv * sizeof *d->v);
    for (Int i = 0; i < d->n_held; i++)
        for (Int v = 0; v < k->nv; v++)
            d->v[v] += held[i] * d->columns[i * k->nv + v];
    for (Int v = 0; v < k->nv; v++)
        d->v[v] *= k->scale[v];
}

/* Let bodies spin about their lines: in their own axes, which turn with them. */
static void add_spins(Dynamics *d)
{
    for (Int s = 0; s < d->spins.n; s++) {
        const Int at = d->k->iv[d->spins.joint[s]];
        Real turned[3];
        cross3(d->spins.axis + 3 * s, d->v + at, turned);
        add3(-d->spins.rate[s], turned, d->a0 + at);
        add3(d->spins.rate[s], d->spins.axis + 3 * s, d->v + at);
    }
}

/* Go where the unknowns say: q, v, and a0 there. */
static int place(Dynamics *d, Real t, const Real *y)
{
    Kernel *k = d->k;
    const Int n = d->n_free;
    Real *x = d->work.asking, *held = x + d->n_held, *acceleration = held + d->n_held;
    if (d->projects)
        return projected_evaluate(d, y);
    memcpy(x, y, (size_t)n * sizeof *x);
    memcpy(held, y + n, (size_t)n * sizeof *held);
    if (d->n_drives && d->callbacks.drives(t, d->work.laws) != DONE)
        return CALLBACK_FAILED;
    for (Int i = 0; i < d->n_held; i++) {
        const Real *law = d->work.laws + 3 * (i - n), scale = k->scale[d->held[i]];
        acceleration[i] = i < n ? 0.0 : law[2] / scale;
        if (i >= n) {
            x[i] = (law[0] - d->start[d->held_q[i]]) / scale;
            held[i] = law[1] / scale;
        }
    }
    if (crossing_travel(d, x) != DONE)
        return LOST;
    velocities(d, held);
    if (d->bridge >= 0)
        for (Int v = 0; v < k->nv; v++)
            d->a0[v] = d->branches.c[v] * held[0] * held[0];
    else
        independent_bias(d, d->v, d->n_drives ? acceleration : NULL, d->a0);
    add_spins(d);
    return DONE;
}

/* The quaternion of a body that spins, turned the shortest way to where its line u is as it is with
 * the rotation S. */
static void turn_to_line(const Real *given, const Real *u, const Real *S, Real *whole)
{
    const Real size = sqrt(dot3(given, given) + given[3] * given[3]);
    Real turn[4], line[3], goal[3], way[4], R[9], side[3];
    for (int i = 0; i < 4; i++)
        turn[i] = given[i] / size;
    quaternion_rotation(turn, R);
    rotate3(S, u, goal);
    rotate3(R, u, line);
    cross3(line, goal, way);
    way[3] = 1.0 + dot3(line, goal);
    const Real length = sqrt(dot3(way, way) + way[3] * way[3]);
    cross3(way, turn, side);
    for (int i = 0; i < 3; i++)
        whole[i] = (way[3] * turn[i] + turn[3] * way[i] + side[i]) / length;
    whole[3] = (way[3] * turn[3] - dot3(way, turn)) / length;
}

/* Take a vector from the axes of one rotation to those of another. */
static void change_axes(const Real *from, const Real *to, Real *vector)
{
    Real seen[3];
    rotate3(from, vector, seen);
    rotate_back3(to, seen, vector);
}

/* The configuration as it is shown: spinning bodies turned as their quaternions say. Velocities and
 * accelerations with it; a may be NULL. */
static void show_spins(const Dynamics *d, const Real *y, Real *q, Real *v, Real *a)
{
    const Kernel *k = d->k;
    for (Int s = 0; s < d->spins.n; s++) {
        const Int iq = k->iq[d->spins.joint[s]], iv = k->iv[d->spins.joint[s]];
        Real S[9], R[9];
        quaternion_rotation(q + iq, S);
        turn_to_line(y + 2 * d->n_free + 4 * s, d->spins.axis + 3 * s, S, q + iq);
        quaternion_rotation(q + iq, R);
        change_axes(S, R, v + iv);
        if (a)
            change_axes(S, R, a + iv);
    }
}

/* Accelerations of the free coordinates, after `place`: z, the power, joint forces missing. */
static int accelerate(Dynamics *d, Real t, const Real *y)
{
    Kernel *k = d->k;
    const Int n = d->n_free;
    const Real *q = d->q;
    d->forces.springs.power = 0.0;
    if (d->spins.n || d->bridge >= 0) /* else independent_bias has worked them out */
        tree_rates(k, d->v);
    tree_accelerate(k, d->a0);
    if (d->spins.n && d->callbacks.efforts) { /* a law sees the bodies as they are turned */
        memcpy(d->work.trial, d->q, (size_t)k->nq * sizeof *d->q);
        memcpy(d->work.step, d->v, (size_t)k->nv * sizeof *d->v);
        show_spins(d, y, d->work.trial, d->work.step, NULL);
        q = d->work.trial;
    }
    if (forces_on_bodies(d) != DONE || forces_at_joints(d, t, q) != DONE)
        return CALLBACK_FAILED;
    forces_missing(d, d->a0);
    for (Int i = 0; i < n; i++) {
        d->z[i] = 0.0;
        for (Int v = 0; v < k->nv; v++)
            d->z[i] -= k->scale[v] * d->columns[i * k->nv + v] * d->forces.tau[v];
    }
    if (n && !masses_solve(d))
        return d->callbacks.least(t, d->q, d->v, d->a0, d->turns, d->z);
    return DONE;
}

/* Efforts of prescribed drivers: the residual forces at the accelerations. */
static int drive_efforts(Dynamics *d)
{
    Kernel *k = d->k;
    tree_rates(k, d->v);
    tree_accelerate(k, d->a);
    const Real power = d->forces.springs.power; /* that of springs is counted already */
    if (forces_on_bodies(d) != DONE)
        return CALLBACK_FAILED;
    d->forces.springs.power = power;
    forces_missing(d, d->a);
    for (Int i = 0; i < d->n_drives; i++) {
        const Real *column = d->columns + (d->n_free + i) * k->nv;
        Real sum = 0.0;
        for (Int v = 0; v < k->nv; v++)
            sum += k->scale[v] * column[v] * d->forces.tau[v];
        d->forces.drive_effort[i] = sum / k->scale[d->held[d->n_free + i]];
        d->forces.springs.power += d->forces.drive_effort[i] * d->v[d->held[d->n_free + i]];
    }
    return DONE;
}

static void whole_accelerations(Dynamics *d)
{
    Kernel *k = d->k;
    for (Int v = 0; v < k->nv; v++) {
        Real sum = 0.0;
        for (Int i = 0; i < d->n_free; i++)
            sum += d->columns[i * k->nv + v] * d->z[i];
        d->a[v] = d->a0[v] + k->scale[v] * sum;
    }
}

/* Rate of a quaternion (4) whose body turns with w, both relative to the body before it. */
static void quaternion_rate(const Real *x, const Real *w, Real *rate)
{
    Real side[3];
    cross3(w, x, side);
    for (int i = 0; i < 3; i++)
        rate[i] = 0.5 * (w[i] * x[3] + side[i]);
    rate[3] = -0.5 * dot3(w, x);
}

int dynamics_rates(void *from, Real t, const Real *y, Real *rates)
{
    Dynamics *d = from;
    Kernel *k = d->k;
    const Int n = d->n_free;
    d->evaluations++;
    int code = place(d, t, y);
    if (code == DONE)
        code = accelerate(d, t, y);
    if (code != DONE)
        return code;
    if (d->n_drives) {
        whole_accelerations(d);
        if (drive_efforts(d) != DONE)
            return CALLBACK_FAILED;
    }
    if (d->projects) {
        whole_accelerations(d);
        projected_rates(d, rates);
    } else {
        independent_rates(d, d->v, rates);
        memcpy(rates + n, d->z, (size_t)n * sizeof *rates);
    }
    for (Int s = 0; s < d->spins.n; s++) {
        Real S[9], w[3];
        quaternion_rotation(d->q + k->iq[d->spins.joint[s]], S);
        rotate3(S, d->v + k->iv[d->spins.joint[s]], w);
        quaternion_rate(y + 2 * n + 4 * s, w, rates + 2 * n + 4 * s);
    }
    if (d->works)
        rates[d->n_unknowns - 1] = d->forces.springs.power;
    return are_finite(rates, d->n_unknowns) ? DONE : LOST;
}

/* ---- what Python calls ---- */

/* Closure error, kinetic and total energy, work. */
static void put_numbers(Dynamics *d, const Real *y, Real *numbers)
{
    numbers[0] = equations_error(d->k);
    numbers[2] = forces_energy(d, numbers + 1);
    numbers[3] = d->works ? y[d->n_unknowns - 1] : 0.0;
}

static SampleRows row_of(const Dynamics *d, const SampleRows *rows, Int i)
{
    const Kernel *k = d->k;
    return (SampleRows){rows->q + i * k->nq, rows->v + i * k->nv, rows->a + i * k->nv,
                        rows->numbers + 4 * i, rows->efforts + i * d->n_drives,
                        rows->angles + i * k->n_angles, NULL};
}

int dynamics_sample(Dynamics *d, Real t, const Real *y, const SampleRows *rows, Int i)
{
    Kernel *k = d->k;
    const SampleRows row = row_of(d, rows, i);
    int code = place(d, t, y);
    if (code == DONE)
        code = accelerate(d, t, y);
    if (code != DONE)
        return code;
    whole_accelerations(d);
    put_numbers(d, y, row.numbers);
    if (d->n_drives && drive_efforts(d) != DONE)
        return CALLBACK_FAILED;
    memcpy(row.q, d->q, (size_t)k->nq * sizeof(Real));
    memcpy(row.v, d->v, (size_t)k->nv * sizeof(Real));
    memcpy(row.a, d->a, (size_t)k->nv * sizeof(Real));
    memcpy(row.efforts, d->forces.drive_effort, (size_t)d->n_drives * sizeof(Real));
    memcpy(row.angles, d->turns, (size_t)k->n_angles * sizeof(Real));
    show_spins(d, y, row.q, row.v, row.a);
    return DONE;
}

void dynamics_point(Dynamics *d, Real t, const Real *y, Point *point)
{
    const Kernel *k = d->k;
    whole_accelerations(d);
    point->s = t;
    memcpy(point->q, d->q, (size_t)k->nq * sizeof *d->q);
    memcpy(point->t, d->v, (size_t)k->nv * sizeof *d->v);
    memcpy(point->c, d->a, (size_t)k->nv * sizeof *d->a);
    memcpy(point->angle, d->turns, (size_t)k->n_angles * sizeof *d->turns);
    show_spins(d, y, point->q, point->t, point->c);
    tree_entry_rates(k, point->q, point->t, point->c, point->first, point->second);
}

/* The place that the way goes on from, and its factors, stay what they are. */
int dynamics_sample_between(Dynamics *d, const Point *from, const Point *to, Real t, const Real *y,
                            const SampleRows *rows, Int i)
{
    Kernel *k = d->k;
    const SampleRows row = row_of(d, rows, i);
    const size_t angles = (size_t)k->n_angles * sizeof(Real);
    const Real part = (t - from->s) / (to->s - from->s);
    Real *const here = d->q, *const velocity = d->v;
    if (!(part >= 0.0 && part <= 1.0))
        return LOST;
    point_between(k, from, to, t, row.q, row.v, row.a);
    for (Int n = 0; n < k->n_angles; n++)
        k->angle_reference[n] = from->angle[n] + part * (to->angle[n] - from->angle[n]);
    equations_values(k, row.q);
    memcpy(row.angles, k->angle, angles);
    memcpy(k->angle_reference, d->turns, angles);
    tree_rates(k, row.v);
    d->q = row.q, d->v = row.v;
    put_numbers(d, y, row.numbers);
    d->q = here, d->v = velocity;
    return DONE;
}

/* Configuration, velocity, screw angles and closure error at unknowns. */
static int sample_motion(Dynamics *d, Real t, const Real *y, const SampleRows *row)
{
    const int code = place(d, t, y);
    if (code != DONE)
        return code;
    memcpy(row->q, d->q, (size_t)d->k->nq * sizeof(Real));
    memcpy(row->v, d->v, (size_t)d->k->nv * sizeof(Real));
    memcpy(row->angles, d->turns, (size_t)d->k->n_angles * sizeof(Real));
    row->numbers[0] = equations_error(d->k);
    if (row->heaviest)
        *row->heaviest = largest_inertia(d);
    show_spins(d, y, row->q, row->v, NULL);
    return DONE;
}

/* Samples at times (n,) and unknowns (n, n_unknowns); LOST where loops cannot be closed. */
EXPORT int dynamics_samples(Dynamics *d, Int n, const Real *t, const Real *y,
                            const SampleRows *rows)
{
    int code = DONE;
    if (!rows->a)
        return n == 1 ? sample_motion(d, *t, y, rows) : BAD_ARRAYS;
    for (Int i = 0; i < n && code == DONE; i++)
        code = dynamics_sample(d, t[i], y + i * d->n_unknowns, rows, i);
    return code;
}

/* Change the unknowns y to the best coordinates where they are; `same` tells whether these are the
 * old ones, and nothing has been done as nothing would be better. SINGULAR where there are none. */
EXPORT int dynamics_renew(Dynamics *d, Real t, Real *y, Int *free_ones, Int *same)
{
    Real numbers[4];
    const SampleRows row = {.q = d->work.trial, .v = d->a, .numbers = numbers, .angles = d->k->angle};
    const int code = sample_motion(d, t, y, &row);
    return code == DONE ? partitioning_renew(d, row.q, row.v, y, free_ones, same) : code;
}

/* Branch points between two values of the independent coordinate, in the order in which they are met;
 * returns how many. */
EXPORT Int dynamics_crossed(const Dynamics *d, Real from, Real to, Real *x, Int room)
{
    return d->crosses ? crossing_points(d, from, to, x, room) : 0;
}

EXPORT Real dynamics_save(Dynamics *d)
{
    independent_save(d, &d->restart);
    if (d->bridge >= 0)
        return 1.0;
    d->curve.n_points = d->curve.n_points ? 1 : 0; /* as where it returns to */
    return independent_pace(d);
}
