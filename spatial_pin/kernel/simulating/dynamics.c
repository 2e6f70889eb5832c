/* Accelerations of independent coordinates under forces.
 *
 * With G the joint velocities per unit rate of the free coordinates and a0 the joint accelerations
 * at which these have none, virtual work along G gives
 *     G^T (M (a0 + G z) + b - f) = 0      [Wehage1982]
 * for their accelerations z. M a0 + b is worked out body by body (Newton and Euler), G^T M G from
 * the bodies' velocities per unit rate. Springs act as forces on the bodies, gravity too. */
#include <string.h>

#include "dense.h"
#include "dynamics.h"
#include "interpolating.h"

/* Inertia, relative to the heaviest joint's, that may be round-off: half of the digits of a sum
   of inertias */
#define LIGHT_INERTIA 1e-8
/* Of a freedom's inertia that others leave it, below which digits are lost */
#define LEAST_PIVOT TOLERANCE_REGULAR

/* ---- forces on bodies ---- */

static int moves_mass(const Kernel *k, Int j)
{
    const Real *I = k->inertia + 9 * j;
    return k->mass[j] != 0.0 || I[0] != 0.0 || I[4] != 0.0 || I[8] != 0.0;
}

/* out = I w, of a body in its own axes. */
static inline void inertia_times(const Kernel *k, Int j, const Real *w, Real *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = dot3(k->inertia + 9 * j + 3 * i, w);
}

/* The force at the centre of mass and the moment about the world origin that a body needs. */
static void needed(const Kernel *k, Int j, Real *force, Real *moment)
{
    const Real *R = k->R + 9 * j, *w = k->omega + 3 * j, *alpha = k->alpha + 3 * j;
    Real centre[3], point[3], swing[3], once[3], turning[3], w_own[3], alpha_own[3], own[3], spun[3];
    rotate3(R, k->com + 3 * j, centre);
    cross3(w, centre, once);
    cross3(w, once, swing);
    cross3(alpha, centre, turning);
    for (int i = 0; i < 3; i++)
        force[i] = k->mass[j] *
                   (k->acceleration[3 * j + i] + turning[i] + swing[i] - k->gravity[i]);
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

typedef struct {
    Real length, rate, along[3], end[3];
} Line;

static Line line_between(const Dynamics *d, Int i)
{
    Line line;
    Real first[3], v1[3], v2[3];
    body_point(d->k, d->line_body[2 * i], d->line_point + 6 * i, first, v1);
    body_point(d->k, d->line_body[2 * i + 1], d->line_point + 6 * i + 3, line.end, v2);
    copy3(line.end, line.along);
    add3(-1.0, first, line.along);
    line.length = sqrt(dot3(line.along, line.along));
    for (int c = 0; c < 3; c++)
        line.along[c] = line.length > 0.0 ? line.along[c] / line.length : 0.0;
    add3(-1.0, v1, v2);
    line.rate = dot3(line.along, v2);
    return line;
}

/* Force of a spring, and how fast it stores energy. */
static int pull(const Dynamics *d, Int which, Int has_law, const Real *spring, Real length,
                Real rate, Real *force, Real *storing)
{
    if (has_law)
        return d->asked.spring(which, length, rate, force);
    *force = spring[0] * (length - spring[2]) + spring[1] * rate;
    *storing += spring[0] * (length - spring[2]) * rate;
    return DONE;
}

/* Take the forces of springs between points from what bodies need; adds their power. */
static int springs_on_bodies(Dynamics *d)
{
    for (Int i = 0; i < d->n_lines; i++) {
        const Line line = line_between(d, i);
        Real force = 0.0, moment[3];
        if (pull(d, i, d->line_law[i], d->line_spring + 3 * i, line.length, line.rate, &force,
                 &d->power) != DONE)
            return ASK_FAILED;
        d->power -= force * line.rate;
        cross3(line.end, line.along, moment);
        for (int side = 0; side < 2; side++) {
            const Int at = 3 * d->line_body[2 * i + side];
            const Real sign = side ? 1.0 : -1.0; /* pulled back towards the first */
            add3(sign * force, line.along, d->force + at);
            add3(sign * force, moment, d->moment + at);
        }
    }
    return DONE;
}

/* Efforts, and what resists and turns back at joints: joint forces `given` and their power. */
static int forces_at_joints(Dynamics *d, Real t, const Real *q)
{
    Kernel *k = d->k;
    const Real *v = d->v;
    memcpy(d->given, d->constant, (size_t)k->nv * sizeof *d->given);
    if (d->asked.efforts && d->asked.efforts(t, q, v, d->turns, d->given) != DONE)
        return ASK_FAILED;
    for (Int i = 0; d->resists && i < k->nv; i++) {
        if (d->damping[i] != 0.0)
            d->given[i] -= d->damping[i] * v[i];
        if (d->friction[i] != 0.0)
            d->given[i] -= d->friction[i] * tanh(v[i] / d->slip[i]);
    }
    for (Int i = 0; i < d->n_turns; i++) {
        Real force = 0.0;
        const Int at = d->turn_v[i];
        if (pull(d, d->n_lines + i, d->turn_law[i], d->turn_spring + 3 * i, d->q[d->turn_q[i]],
                 v[at], &force, &d->power) != DONE)
            return ASK_FAILED;
        d->given[at] -= force;
    }
    for (Int i = 0; i < k->nv; i++)
        d->power += d->given[i] * v[i];
    return DONE;
}

/* Forces and moments that all bodies need; the springs on them are taken off where asked. */
static void bodies_need(Dynamics *d)
{
    Kernel *k = d->k;
    for (Int j = 0; j < k->n_joints; j++) {
        zero3(d->force + 3 * j);
        zero3(d->moment + 3 * j);
        if (j > 0 && moves_mass(k, j))
            needed(k, j, d->force + 3 * j, d->moment + 3 * j);
    }
}

/* Joint forces of what bodies need, less those given: tau. */
static void gather(Dynamics *d, const Real *a)
{
    Kernel *k = d->k;
    for (Int j = k->n_joints - 1; j > 0; j--) {
        const Int up = 3 * k->parent[j];
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++)
            d->tau[v] = dot3(d->force + 3 * j, k->linear + 3 * v) +
                        dot3(d->moment + 3 * j, k->angular + 3 * v) + d->armature[v] * a[v] -
                        d->given[v];
        add3(1.0, d->force + 3 * j, d->force + up);
        add3(1.0, d->moment + 3 * j, d->moment + up);
    }
}

/* ---- masses of the free coordinates ---- */

/* Velocity (3) of the point of each body at the world origin, and angular velocity (3), per unit
 * rate of a free coordinate. */
static void twists(Dynamics *d, Int i)
{
    Kernel *k = d->k;
    Real *twist = d->twist + 6 * k->n_joints * i;
    const Real *column = d->columns + i * k->nv;
    memset(twist, 0, 6 * sizeof *twist);
    for (Int j = 1; j < k->n_joints; j++) {
        Real *own = twist + 6 * j;
        memcpy(own, twist + 6 * k->parent[j], 6 * sizeof *own);
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
            add3(k->scale[v] * column[v], k->linear + 3 * v, own);
            add3(k->scale[v] * column[v], k->angular + 3 * v, own + 3);
        }
    }
}

/* Make the twist of a body one of its centre of mass, and of its own axes. */
static void see_from_centre(const Kernel *k, Int j, Real *twist)
{
    Real centre[3], velocity[3], turn[3];
    rotate3(k->R + 9 * j, k->com + 3 * j, centre);
    add3(1.0, k->p + 3 * j, centre);
    cross3(twist + 3, centre, velocity);
    add3(1.0, velocity, twist);
    rotate_back3(k->R + 9 * j, twist + 3, turn);
    copy3(turn, twist + 3);
}

static void reduced_mass(Dynamics *d)
{
    Kernel *k = d->k;
    const Int n = d->n_free, apart = 6 * k->n_joints;
    memset(d->mass, 0, (size_t)(n * n) * sizeof *d->mass);
    for (Int i = 0; i < n; i++)
        twists(d, i);
    for (Int j = 1; j < k->n_joints; j++) {
        if (!moves_mass(k, j))
            continue;
        for (Int a = 0; a < n; a++) {
            Real *own = d->twist + apart * a + 6 * j, moment[3];
            see_from_centre(k, j, own);
            inertia_times(k, j, own + 3, moment);
            for (Int b = 0; b <= a; b++) {
                const Real *other = d->twist + apart * b + 6 * j;
                d->mass[a * n + b] += k->mass[j] * dot3(own, other) + dot3(moment, other + 3);
            }
        }
    }
    for (Int a = 0; a < n; a++)
        for (Int b = 0; b <= a; b++)
            for (Int v = 0; v < k->nv; v++)
                if (d->armature[v] != 0.0)
                    d->mass[a * n + b] += d->armature[v] * k->scale[v] * k->scale[v] *
                                          d->columns[a * k->nv + v] * d->columns[b * k->nv + v];
}

/* Kinetic energy, twice, of a body whose twist about the world origin is (linear, angular). */
static Real inertia_about(const Kernel *k, Int j, const Real *linear, const Real *angular)
{
    Real twist[6], moment[3];
    copy3(linear, twist);
    copy3(angular, twist + 3);
    see_from_centre(k, j, twist);
    inertia_times(k, j, twist + 3, moment);
    return k->mass[j] * dot3(twist, twist) + dot3(moment, twist + 3);
}

/* The largest inertia of a joint, scaled, the others held: that of all that it carries. */
EXPORT Real dynamics_heaviest(Dynamics *d)
{
    const Kernel *k = d->k;
    Real *own = d->tau, most = 0.0;
    memcpy(own, d->armature, (size_t)k->nv * sizeof *own);
    for (Int j = 1; j < k->n_joints; j++)
        for (Int up = moves_mass(k, j) ? j : 0; up > 0; up = k->parent[up])
            for (Int v = k->iv[up]; v < k->iv[up] + joint_nv(k->kind[up]); v++)
                own[v] += inertia_about(k, j, k->linear + 3 * v, k->angular + 3 * v);
    for (Int v = 0; v < k->nv; v++)
        most = fmax(most, own[v] * k->scale[v] * k->scale[v]);
    return most;
}

/* Cholesky of the masses, each freedom's own one; 0 where digits would be lost. */
static int solve_masses(Dynamics *d)
{
    const Int n = d->n_free;
    Real *m = d->mass, *z = d->z, *unit = d->off;
    for (Int i = 0; i < n; i++) {
        if (!(m[i * n + i] > LIGHT_INERTIA * d->heaviest))
            return 0;
        unit[i] = 1.0 / sqrt(m[i * n + i]);
    }
    if (n == 1) {
        z[0] /= m[0];
        return 1;
    }
    for (Int i = 0; i < n; i++) {
        z[i] *= unit[i];
        for (Int j = 0; j <= i; j++)
            m[i * n + j] *= unit[i] * unit[j];
    }
    if (dense_cholesky_solve(n, m, z, LEAST_PIVOT))
        return 0;
    for (Int i = 0; i < n; i++)
        z[i] *= unit[i];
    return 1;
}

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
    for (Int s = 0; s < d->n_spins; s++) {
        const Int at = d->k->iv[d->spin_joint[s]];
        Real turned[3];
        cross3(d->spin_axis + 3 * s, d->v + at, turned);
        add3(-d->sigma[s], turned, d->a0 + at);
        add3(d->sigma[s], d->spin_axis + 3 * s, d->v + at);
    }
}

/* Go where the unknowns say: q, v, and a0 there. */
static int place(Dynamics *d, Real t, const Real *y)
{
    Kernel *k = d->k;
    const Int n = d->n_free;
    Real *x = d->asking, *held = x + d->n_held, *acceleration = held + d->n_held;
    if (d->projects)
        return projected_place(d, y);
    memcpy(x, y, (size_t)n * sizeof *x);
    memcpy(held, y + n, (size_t)n * sizeof *held);
    if (d->n_drives && d->asked.drives(t, d->laws) != DONE)
        return ASK_FAILED;
    for (Int i = 0; i < d->n_held; i++) {
        const Real *law = d->laws + 3 * (i - n), scale = k->scale[d->held[i]];
        acceleration[i] = i < n ? 0.0 : law[2] / scale;
        if (i >= n) {
            x[i] = (law[0] - d->start[d->held_q[i]]) / scale;
            held[i] = law[1] / scale;
        }
    }
    if (passing_travel(d, x) != DONE)
        return LOST;
    velocities(d, held);
    if (d->passage >= 0)
        for (Int v = 0; v < k->nv; v++)
            d->a0[v] = d->passage_c[v] * held[0] * held[0];
    else
        independent_bias(d, d->v, d->n_drives ? acceleration : NULL, d->a0);
    add_spins(d);
    return DONE;
}

/* The configuration as it is shown: spinning bodies turned as their quaternions say, which are
 * taken the shortest way to where the body's line is. Velocities and accelerations with it. */
static void show_spins(const Dynamics *d, const Real *y, Real *q, Real *v, Real *a)
{
    const Kernel *k = d->k;
    for (Int s = 0; s < d->n_spins; s++) {
        const Real *u = d->spin_axis + 3 * s, *given = y + 2 * d->n_free + 4 * s;
        const Int iq = k->iq[d->spin_joint[s]], iv = k->iv[d->spin_joint[s]];
        const Real size = sqrt(dot3(given, given) + given[3] * given[3]);
        Real turn[4], line[3], goal[3], way[4], R[9], S[9], seen[3];
        for (int i = 0; i < 4; i++)
            turn[i] = given[i] / size;
        quaternion_rotation(q + iq, S);
        quaternion_rotation(turn, R);
        rotate3(S, u, goal);
        rotate3(R, u, line);
        cross3(line, goal, way);
        way[3] = 1.0 + dot3(line, goal);
        const Real length = sqrt(dot3(way, way) + way[3] * way[3]);
        Real whole[4], side[3];
        cross3(way, turn, side);
        for (int i = 0; i < 3; i++)
            whole[i] = (way[3] * turn[i] + turn[3] * way[i] + side[i]) / length;
        whole[3] = (way[3] * turn[3] - dot3(way, turn)) / length;
        memcpy(q + iq, whole, sizeof whole);
        quaternion_rotation(whole, R);
        rotate3(S, v + iv, seen);
        rotate_back3(R, seen, v + iv);
        if (a) {
            rotate3(S, a + iv, seen);
            rotate_back3(R, seen, a + iv);
        }
    }
}

/* Accelerations of the free coordinates, after `place`: z, the power, joint forces missing. */
static int accelerate(Dynamics *d, Real t, const Real *y)
{
    Kernel *k = d->k;
    const Int n = d->n_free;
    const Real *q = d->q;
    d->power = 0.0;
    if (d->n_spins || d->passage >= 0) /* else independent_bias has worked them out */
        tree_rates(k, d->v);
    tree_accelerate(k, d->a0);
    bodies_need(d);
    if (d->n_spins && d->asked.efforts) { /* a law sees the bodies as they are turned */
        memcpy(d->trial, d->q, (size_t)k->nq * sizeof *d->q);
        memcpy(d->step, d->v, (size_t)k->nv * sizeof *d->v);
        show_spins(d, y, d->trial, d->step, NULL);
        q = d->trial;
    }
    if (springs_on_bodies(d) != DONE || forces_at_joints(d, t, q) != DONE)
        return ASK_FAILED;
    gather(d, d->a0);
    for (Int i = 0; i < n; i++) {
        d->z[i] = 0.0;
        for (Int v = 0; v < k->nv; v++)
            d->z[i] -= k->scale[v] * d->columns[i * k->nv + v] * d->tau[v];
    }
    if (n) {
        reduced_mass(d);
        if (!solve_masses(d)) {
            const int code = d->asked.least(t, d->q, d->v, d->a0, d->turns, d->z);
            if (code != DONE)
                return code;
        }
    }
    return DONE;
}

/* Efforts of prescribed drivers: what is missing at the accelerations found. */
static int drive_efforts(Dynamics *d)
{
    Kernel *k = d->k;
    tree_rates(k, d->v);
    tree_accelerate(k, d->a);
    bodies_need(d);
    const Real power = d->power; /* that of springs is counted already */
    if (springs_on_bodies(d) != DONE)
        return ASK_FAILED;
    d->power = power;
    gather(d, d->a);
    for (Int i = 0; i < d->n_drives; i++) {
        const Real *column = d->columns + (d->n_free + i) * k->nv;
        Real sum = 0.0;
        for (Int v = 0; v < k->nv; v++)
            sum += k->scale[v] * column[v] * d->tau[v];
        d->drive_effort[i] = sum / k->scale[d->held[d->n_free + i]];
        d->power += d->drive_effort[i] * d->v[d->held[d->n_free + i]];
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
            return ASK_FAILED;
    }
    if (d->projects) {
        whole_accelerations(d);
        projected_rates(d, rates);
    } else {
        independent_rates(d, d->v, rates);
        memcpy(rates + n, d->z, (size_t)n * sizeof *rates);
    }
    for (Int s = 0; s < d->n_spins; s++) {
        Real S[9], w[3];
        quaternion_rotation(d->q + k->iq[d->spin_joint[s]], S);
        rotate3(S, d->v + k->iv[d->spin_joint[s]], w);
        quaternion_rate(y + 2 * n + 4 * s, w, rates + 2 * n + 4 * s);
    }
    if (d->works)
        rates[d->n_unknowns - 1] = d->power;
    for (Int i = 0; i < d->n_unknowns; i++)
        if (!isfinite(rates[i]))
            return LOST;
    return DONE;
}

/* ---- what is asked from outside ---- */

static Real energies(Dynamics *d, Real *kinetic)
{
    Kernel *k = d->k;
    Real moving = 0.0, stored = 0.0;
    for (Int j = 1; j < k->n_joints; j++) {
        if (!moves_mass(k, j))
            continue;
        Real at[3], velocity[3], w[3], moment[3];
        body_point(k, j, k->com + 3 * j, at, velocity);
        rotate_back3(k->R + 9 * j, k->omega + 3 * j, w);
        inertia_times(k, j, w, moment);
        moving += 0.5 * (k->mass[j] * dot3(velocity, velocity) + dot3(w, moment));
        stored -= k->mass[j] * dot3(k->gravity, at);
    }
    for (Int v = 0; v < k->nv; v++)
        moving += 0.5 * d->armature[v] * d->v[v] * d->v[v];
    for (Int i = 0; i < d->n_lines + d->n_turns; i++) {
        const int line = i < d->n_lines;
        const Int at = line ? i : i - d->n_lines;
        const Real *spring = (line ? d->line_spring : d->turn_spring) + 3 * at;
        if (line ? d->line_law[at] : d->turn_law[at])
            continue;
        const Real x = (line ? line_between(d, at).length : d->q[d->turn_q[at]]) - spring[2];
        stored += 0.5 * spring[0] * x * x;
    }
    *kinetic = moving;
    return moving + stored;
}

/* Closure error, kinetic and total energy, work. */
static void put_numbers(Dynamics *d, const Real *y, Real *numbers)
{
    numbers[0] = equations_error(d->k);
    numbers[2] = energies(d, numbers + 1);
    numbers[3] = d->works ? y[d->n_unknowns - 1] : 0.0;
}

static SampleRows row_of(const Dynamics *d, const SampleRows *rows, Int i)
{
    const Kernel *k = d->k;
    return (SampleRows){rows->q + i * k->nq, rows->v + i * k->nv, rows->a + i * k->nv,
                        rows->numbers + 4 * i, rows->efforts + i * d->n_drives,
                        rows->angles + i * k->n_angles};
}

int dynamics_sample(Dynamics *d, Real t, const Real *y, const Real *z, const SampleRows *rows,
                    Int i)
{
    Kernel *k = d->k;
    const SampleRows row = row_of(d, rows, i);
    int code = place(d, t, y);
    if (code == DONE && !z)
        code = accelerate(d, t, y);
    if (code != DONE)
        return code;
    if (z) {
        memcpy(d->z, z, (size_t)d->n_free * sizeof *z);
        tree_rates(k, d->v);
    }
    whole_accelerations(d);
    put_numbers(d, y, row.numbers);
    if (d->n_drives && drive_efforts(d) != DONE)
        return ASK_FAILED;
    memcpy(row.q, d->q, (size_t)k->nq * sizeof(Real));
    memcpy(row.v, d->v, (size_t)k->nv * sizeof(Real));
    memcpy(row.a, d->a, (size_t)k->nv * sizeof(Real));
    memcpy(row.efforts, d->drive_effort, (size_t)d->n_drives * sizeof(Real));
    memcpy(row.angles, d->turns, (size_t)k->n_angles * sizeof(Real));
    show_spins(d, y, row.q, row.v, row.a);
    return DONE;
}

/* The place that the way goes on from, and its factors, stay what they are. */
int dynamics_sample_between(Dynamics *d, const Point *from, const Point *to, const Real *y, Real z,
                            const SampleRows *rows, Int i)
{
    Kernel *k = d->k;
    const SampleRows row = row_of(d, rows, i);
    const size_t angles = (size_t)k->n_angles * sizeof(Real);
    const Real x = y[0], rate = y[1], part = (x - from->s) / (to->s - from->s);
    Real *const here = d->q, *const velocity = d->v;
    if (!(part >= 0.0 && part <= 1.0))
        return LOST;
    point_between(k, from, to, x, row.q, row.v, row.a);
    for (Int n = 0; n < k->n_angles; n++)
        k->angle_reference[n] = from->angle[n] + part * (to->angle[n] - from->angle[n]);
    equations_values(k, row.q);
    memcpy(row.angles, k->angle, angles);
    memcpy(k->angle_reference, d->turns, angles);
    for (Int v = 0; v < k->nv; v++) {
        row.a[v] = row.a[v] * rate * rate + row.v[v] * z;
        row.v[v] *= rate;
    }
    tree_rates(k, row.v);
    d->q = row.q, d->v = row.v;
    put_numbers(d, y, row.numbers);
    d->q = here, d->v = velocity;
    return DONE;
}

/* Configuration, velocity, screw angles and closure error at unknowns. */
EXPORT int dynamics_place(Dynamics *d, Real t, const Real *y, Real *q, Real *v, Real *angles,
                          Real *error)
{
    const int code = place(d, t, y);
    if (code != DONE)
        return code;
    memcpy(q, d->q, (size_t)d->k->nq * sizeof *q);
    memcpy(v, d->v, (size_t)d->k->nv * sizeof *v);
    memcpy(angles, d->turns, (size_t)d->k->n_angles * sizeof *angles);
    *error = equations_error(d->k);
    show_spins(d, y, q, v, NULL);
    return DONE;
}

/* Samples at times (n,) and unknowns (n, n_unknowns). */
EXPORT int dynamics_samples(Dynamics *d, Int n, const Real *t, const Real *y,
                            const SampleRows *rows)
{
    int code = DONE;
    for (Int i = 0; i < n && code == DONE; i++)
        code = dynamics_sample(d, t[i], y + i * d->n_unknowns, NULL, rows, i);
    return code;
}

EXPORT Int dynamics_crossed(const Dynamics *d, Real from, Real to, Real *x, Int room)
{
    return d->passes ? passing_crossed(d, from, to, x, room) : 0;
}

/* Take the present place for one to begin anew from where the way from another is lost; returns
 * how many times faster than the coordinates another moves. */
EXPORT Real dynamics_keep(Dynamics *d)
{
    independent_remember(d, &d->kept);
    if (d->passage >= 0)
        return 1.0;
    d->n_points = d->n_points ? 1 : 0; /* as where it returns to */
    return independent_pace(d);
}

/* Velocity entries (n_free) of the coordinates that it solves for. */
EXPORT void dynamics_free(const Dynamics *d, Int *free_ones)
{
    memcpy(free_ones, d->held, (size_t)d->n_free * sizeof *free_ones);
}

EXPORT Int dynamics_evaluations(const Dynamics *d) { return d->evaluations; }

EXPORT Int dynamics_factorisations(const Dynamics *d) { return d->k->factorisations; }

EXPORT Real dynamics_pivot(const Dynamics *d) { return d->passes ? 1.0 : d->pivot; }
