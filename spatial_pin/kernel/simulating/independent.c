/* A closed mechanism moved by its independent coordinates.
 *
 * It shares the corrector, the points of curves and their polynomials with paths (following), not
 * their steps: a path knows its second derivatives at both ends of a step, along its one parameter.
 * Here every step has a direction of its own, in any number of coordinates; those derivatives would
 * cost two more solutions a step, which makes simulations of several freedoms a fifth to a quarter
 * slower (instructions counted: 1.21 of the excavator, 1.28 of the delta robot).
 *
 * Coordinates x of the held freedoms are entries of q less those at the start, by scale; for
 * joints that turn in space components of the rotation vector from the start. Steps in x are
 * predicted to second order, corrected by Newton's method with the held coordinates given, and
 * accepted only where the prediction explains the correction and no pivot has changed its sign:
 * else a neighbouring branch might be taken. */
#include <string.h>

#include "correcting.h"
#include "dense.h"
#include "dynamics.h"

/* Part of a step that the prediction may leave: twice what paths may, as the rates of the
   motion tell where it leads */
#define PREDICTED_TO 0.2
/* Longest step in one go [rad, characteristic lengths]: from there prediction leaves more than
   that */
#define LONGEST_GO 0.7
#define GO_HALVINGS 10       /* of a way, before it is given up: a thousandth of a step */
#define SHORTEST_WAY 1e-8    /* way on which a change of the determinant is more than round-off */
#define REMAINS 0.25         /* of the determinant, where one that falls in a line would be left */
/* Of the tolerance, at which a prediction is left as it is: what corrections reach is less, too */
#define ENOUGH 0.1
#define TIGHTENED_BY 0.1      /* way to closed loops, from where a loose tolerance has left them */
#define RESELECT_PIVOTS 1e-2  /* of the pivots where equations were chosen: there others are tried */

/* ---- held coordinates ---- */

/* Whether a held coordinate is an entry of q. */
static int is_plain(const Dynamics *d, Int i) { return d->held_q[i] >= 0; }

/* Rate of a held coordinate at v / scale. */
static Real held_rate(const Dynamics *d, Int i, const Real *v)
{
    if (is_plain(d, i))
        return v[d->held[i]];
    return relative_rate_by(d->k, d->held_joint[i], d->held_component[i],
                            d->by_velocity + 3 * i, v);
}

void independent_rates(Dynamics *d, const Real *v, Real *rates)
{
    for (Int i = 0; i < d->k->nv; i++)
        d->work.step[i] = v[i] / d->k->scale[i];
    for (Int i = 0; i < d->n_free; i++)
        rates[i] = held_rate(d, i, d->work.step);
}

/* ---- solving ---- */

/* Rows that hold the spins: the angular velocity of a body about its line. */
static void put_spin_rows(Dynamics *d)
{
    Kernel *k = d->k;
    const Int first = k->nv - d->spins.n;
    for (Int e = k->system.matrix.n - 1; e >= 0 && k->system.matrix.row[e] >= first; e--) {
        const Int s = k->system.matrix.row[e] - first, v = k->system.matrix.column[e];
        Real line[3];
        rotate3(k->R + 9 * d->spins.joint[s], d->spins.axis + 3 * s, line);
        k->system.matrix.value[e] = k->scale[v] * dot3(line, k->angular + 3 * v);
    }
}

static int factor_system(Dynamics *d)
{
    equations_jacobian(d->k, &d->k->equations.system);
    if (d->spins.n)
        put_spin_rows(d);
    return system_factor(d->k);
}

void independent_columns(Dynamics *d)
{
    Kernel *k = d->k;
    const Int nv = k->nv, n = d->n_held;
    for (Int i = 0; i < n; i++) {
        Real *column = d->columns + i * nv;
        memset(column, 0, (size_t)nv * sizeof *column);
        column[k->system.n_chosen + k->n_idle + i] = 1.0;
        system_solve(k, column);
    }
    if (d->is_linear)
        return;
    for (Int i = 0; i < n; i++)
        for (Int j = 0; j < n; j++)
            d->work.by_rates[i * n + j] = held_rate(d, i, d->columns + j * nv);
    memset(d->inverse, 0, (size_t)(n * n) * sizeof *d->inverse);
    for (Int i = 0; i < n; i++)
        d->inverse[i * n + i] = 1.0;
    dense_lu(n, d->work.by_rates, d->work.order);
    dense_lu_solve(n, d->work.by_rates, d->work.order, 0, n, d->inverse);
}

/* Add the motion of held coordinates that changes x by dx. */
static void add_motion(const Dynamics *d, const Real *dx, Real *step)
{
    const Int nv = d->k->nv, n = d->n_held;
    for (Int i = 0; i < n; i++) {
        Real rate = 0.0;
        if (d->is_linear)
            rate = dx[i];
        else
            for (Int j = 0; j < n; j++)
                rate += d->inverse[i * n + j] * dx[j];
        for (Int v = 0; v < nv; v++)
            step[v] += rate * d->columns[i * nv + v];
    }
}

/* The step (nv) by scale to coordinates x, of second order along the last velocity. */
static void predict(Dynamics *d, const Real *x)
{
    Real way = 0.0;
    memset(d->work.step, 0, (size_t)d->k->nv * sizeof *d->work.step);
    for (Int i = 0; i < d->n_held; i++) {
        d->work.off[i] = x[i] - d->x[i];
        way += d->has_bend ? d->work.off[i] * d->bend_rate[i] : 0.0;
    }
    add_motion(d, d->work.off, d->work.step);
    for (Int v = 0; way != 0.0 && v < d->k->nv; v++)
        d->work.step[v] += 0.5 * way * way * d->bend[v];
}

/* One held coordinate moves along a curve: note the present point of it, with the
 * derivatives by x of independent_bias. */
static void note_point(Dynamics *d)
{
    Kernel *k = d->k;
    if (!d->curve.is_curve || !d->has_bend)
        return;
    if (!(d->curve.n_points && d->curve.point->s == d->x[0])) {
        Point *oldest = d->curve.before;
        d->curve.before = d->curve.point;
        d->curve.point = oldest;
        d->curve.n_points = d->curve.n_points ? 2 : 1;
    }
    Point *here = d->curve.point;
    here->s = d->x[0];
    memcpy(here->q, d->q, (size_t)k->nq * sizeof *here->q);
    for (Int v = 0; v < k->nv; v++) {
        here->t[v] = k->scale[v] * d->columns[v];
        here->c[v] = k->scale[v] * d->bend[v] * d->bend_rate[0] * d->bend_rate[0];
    }
    tree_entry_rates(k, here->q, here->t, here->c, here->first, here->second);
}

static void move(const Dynamics *d, Real *q, const Real *step)
{
    Real *physical = d->k->right;
    for (Int v = 0; v < d->k->nv; v++)
        physical[v] = d->k->scale[v] * step[v];
    tree_integrate(d->k, q, physical);
}

/* The trial at x that the step, or two points of the curve, predict. */
static void move_trial(Dynamics *d, const Real *x)
{
    const Real h = x[0] - d->x[0];
    if (d->curve.is_curve && d->has_bend && d->curve.n_points == 2 &&
        hermite_reaches(d->curve.before, d->curve.point, h)) {
        predict_hermite(d->k, d->curve.before, d->curve.point, h, d->work.trial);
        return;
    }
    memcpy(d->work.trial, d->q, (size_t)d->k->nq * sizeof *d->q);
    move(d, d->work.trial, d->work.step);
}

/* Held entries of q become what they are at x; returns how far the other held coordinates are. */
static Real put_held(void *owner, Real *q)
{
    Dynamics *d = owner;
    Real square = 0.0;
    for (Int i = 0; d->is_linear && i < d->n_held; i++)
        q[d->held_q[i]] = d->start[d->held_q[i]] + d->k->scale[d->held[i]] * d->work.wanted[i];
    for (Int i = 0; !d->is_linear && i < d->n_held; i++) {
        d->work.off[i] = d->work.wanted[i] - relative_coordinate(d->k, d->held_joint[i],
                                                       d->held_component[i], d->start, q);
        square += d->work.off[i] * d->work.off[i];
    }
    return sqrt(square);
}

static int factor_held(void *owner)
{
    Dynamics *d = owner;
    const int code = factor_system(d);
    if (code == DONE && !d->is_linear) {
        for (Int i = 0; i < d->n_held; i++)
            if (!is_plain(d, i))
                relative_row(d->k, d->held_joint[i], d->held_component[i], d->start, d->work.trial,
                             d->by_velocity + 3 * i);
        independent_columns(d);
    }
    return code;
}

/* Add the motion that brings held coordinates to x, where some are rotations, to a step. */
static void close_held(void *owner, Real *step)
{
    Dynamics *d = owner;
    if (d->is_linear)
        return;
    for (Int i = 0; i < d->n_held; i++)
        d->work.off[i] -= held_rate(d, i, step);
    add_motion(d, d->work.off, step);
}

/* Newton's method from trial, `predicted` away from the factors at hand; factored where it ends. */
static int newton(Dynamics *d, const Real *x, Real predicted)
{
    const Held held = {d, put_held, factor_held, close_held};
    const Real tolerance = fmax(d->tolerance * residual_part(d->pivot),
                                fmin(d->tolerance, TOLERANCE_CLOSED));
    Correction c = {.enough = ENOUGH * tolerance, .tolerance = tolerance,
                    .left = TOLERANCE_CLOSED, .allowed = PREDICTED_TO * predicted, .fixed = -1,
                    .held = &held, .away = predicted};
    d->work.wanted = x;
    const int code = correct(d->k, d->work.trial, &c);
    return code == DONE ? factor_held(d) : UNSAFE;
}

/* Whether other equations than the chosen ones would do better here: those left out tell. */
static int is_ill_conditioned(const Dynamics *d)
{
    const Kernel *k = d->k;
    if (k->system.n_chosen == k->n_closure)
        return 0;
    return k->system.pivot_ratio < RESELECT_PIVOTS * d->determinant.first_pivot ||
           equations_error(k) > 10.0 * d->determinant.spare + TOLERANCE_ZERO + d->tolerance;
}

/* Note the determinant where it is evaluated, and how it has changed since the last place. With one
 * freedom no more than the pivot that has changed most: where N loops are to lose rank together, the
 * determinant falls by the N-th power of the way to there and would seem to vanish after an N-th of
 * it, and ways past it would be looked for; the pivots, whose product it is, fall in a line each.
 * With more freedoms what seems nearer than it is makes steps short that might leap over it. */
static void note_determinant(Dynamics *d)
{
    const Kernel *k = d->k;
    const Real change = 1.0 - ldexp(d->determinant.mantissa / k->system.mantissa,
                                    (int)(d->determinant.exponent - k->system.exponent));
    Real least, most;
    lu_changes(k->system.lu, &least, &most);
    d->determinant.since = d->crosses ? fmin(fmax(change, least), most) : change;
    d->determinant.mantissa = k->system.mantissa;
    d->determinant.exponent = k->system.exponent;
    lu_mark(k->system.lu);
}

/* Note what the change of the determinant on the way from one x to another tells. */
static void note_change(Dynamics *d, const Real *from, const Real *x)
{
    Real square = 0.0;
    for (Int i = 0; i < d->n_held; i++)
        square += (x[i] - from[i]) * (x[i] - from[i]);
    if (!(square > SHORTEST_WAY * SHORTEST_WAY))
        return;
    if (d->crosses)
        d->determinant.distance = (from[0] - x[0]) / d->determinant.since;
    for (Int i = 0; i < d->n_held; i++)
        d->determinant.change[i] = d->determinant.since * (x[i] - from[i]) / square;
}

/* Whether the determinant, as it has changed, would nearly vanish on the way to x. Where it has a
 * zero of even order its sign does not tell a step across: one freedom may go on to look for it,
 * more may not get there. */
static int may_cross(const Dynamics *d, const Real *x)
{
    Real left = 1.0;
    for (Int i = 0; !d->crosses && i < d->n_held; i++)
        left += d->determinant.change[i] * (x[i] - d->x[i]);
    return left < REMAINS;
}

static void accept(Dynamics *d, const Real *x)
{
    const Kernel *k = d->k;
    note_determinant(d);
    note_change(d, d->x, x);
    memcpy(d->q, d->work.trial, (size_t)k->nq * sizeof *d->q);
    memmove(d->x, x, (size_t)d->n_held * sizeof *x);
    memcpy(d->turns, k->angle, (size_t)k->n_angles * sizeof *d->turns);
    memcpy(k->angle_reference, k->angle, (size_t)k->n_angles * sizeof *d->turns);
    d->pivot = k->system.pivot_ratio;
    d->has_bend = 0;
    d->bridge = -1;
    if (d->is_linear)
        independent_columns(d);
}

/* How the determinant of other equations, or with other held coordinates, has changed on the way
 * from the position that was saved: the known changes of the former ones do not hold for it. */
int independent_measure_change(Dynamics *d)
{
    const size_t size = (size_t)d->n_held * sizeof *d->determinant.change;
    memset(d->determinant.change, 0, size);
    memset(d->restart.change, 0, size);
    independent_save(d, &d->work.saved);
    const int is_known = independent_restore(d, &d->restart) == DONE;
    independent_read(d);
    memcpy(d->restart.x, d->x, size);
    if (independent_restore(d, &d->work.saved) != DONE)
        return UNSAFE;
    if (!is_known)
        return DONE;
    note_change(d, d->restart.x, d->x);
    for (Int i = 0; i < d->n_held; i++)
        d->restart.change[i] = d->determinant.change[i] / (1.0 - d->determinant.since);
    return DONE;
}

int independent_choose_anew(Dynamics *d)
{
    if (system_reselect(d->k) != DONE || independent_evaluate(d) != DONE)
        return UNSAFE;
    d->determinant.first_pivot = d->pivot;
    d->determinant.distance = 0.0;
    memcpy(d->work.trial, d->q, (size_t)d->k->nq * sizeof *d->q);
    if (newton(d, d->x, 1e-3) != DONE)
        return UNSAFE;
    accept(d, d->x);
    const Real allowed = 10.0 * d->determinant.spare + TOLERANCE_NOTHING + d->tolerance;
    if (equations_error(d->k) > allowed)
        return UNSAFE;
    return d->crosses ? DONE : independent_measure_change(d);
}

/* One step from where the loops are closed well enough for its prediction. */
static int step_from_here(Dynamics *d, const Real *x)
{
    predict(d, x);
    const Real size = norm(d->work.step, d->k->nv);
    d->determinant.flipped = 0;
    if (!(size <= LONGEST_GO))
        return UNSAFE;
    move_trial(d, x);
    if (newton(d, x, size) != DONE)
        return UNSAFE;
    if (d->k->system.sign != d->determinant.sign || !(d->k->system.pivot_ratio > LEAST_SOLVED)) {
        d->determinant.flipped = d->k->system.sign != d->determinant.sign;
        return UNSAFE;
    }
    accept(d, x);
    return is_ill_conditioned(d) ? independent_choose_anew(d) : DONE;
}

/* Close the loops to round-off at the present position. UNSAFE where they are, where tolerances are
 * tight, or where that leads far. */
static int tighten(Dynamics *d)
{
    const Real tolerance = d->tolerance;
    if (!(tolerance > TOLERANCE_CLOSED) || independent_evaluate(d) != DONE ||
        chosen_residual(d->k) <= TOLERANCE_CLOSED)
        return UNSAFE;
    memcpy(d->work.trial, d->q, (size_t)d->k->nq * sizeof *d->q);
    d->tolerance = TOLERANCE_TIGHT;
    const int code = newton(d, d->x, fmin(TIGHTENED_BY, sqrt(tolerance)) / PREDICTED_TO);
    d->tolerance = tolerance;
    if (code != DONE || d->k->system.sign != d->determinant.sign)
        return UNSAFE;
    accept(d, d->x);
    return DONE;
}

/* What a loose tolerance has left open at the beginning is no error of a prediction: a step that
 * seems to leave the path for it is taken again, from closed loops. */
int independent_step(Dynamics *d, const Real *x)
{
    const int code = step_from_here(d, x);
    if (code == DONE || d->determinant.flipped || tighten(d) != DONE)
        return code;
    return step_from_here(d, x);
}

/* Newton's method from the present position to x, moving by no more than allowed; on any branch. */
int independent_settle(Dynamics *d, const Real *x, Real allowed)
{
    memcpy(d->work.trial, d->q, (size_t)d->k->nq * sizeof *d->q);
    if (newton(d, x, allowed / PREDICTED_TO) != DONE)
        return UNSAFE;
    d->determinant.sign = d->k->system.sign;
    accept(d, x);
    return DONE;
}

int independent_factor(Dynamics *d)
{
    Kernel *k = d->k;
    memcpy(d->work.trial, d->q, (size_t)k->nq * sizeof *d->q);
    memcpy(k->angle_reference, k->angle, (size_t)k->n_angles * sizeof *d->turns);
    d->has_bend = 0;
    d->curve.n_points = 0;
    d->bridge = -1;
    const int code = factor_held(d);
    if (code != DONE)
        return LOST;
    if (d->is_linear)
        independent_columns(d);
    d->determinant.sign = k->system.sign;
    d->pivot = k->system.pivot_ratio;
    note_determinant(d);
    return DONE;
}

int independent_evaluate(Dynamics *d)
{
    Kernel *k = d->k;
    memcpy(k->angle_reference, d->turns, (size_t)k->n_angles * sizeof *d->turns);
    equations_values(k, d->q);
    return independent_factor(d);
}

void independent_read(Dynamics *d)
{
    for (Int i = 0; i < d->n_held; i++)
        d->x[i] = relative_coordinate(d->k, d->held_joint[i], d->held_component[i], d->start, d->q);
}

/* Move to x in as many steps as it takes; where it cannot, it stops where it came to. */
int independent_follow(Dynamics *d, const Real *x)
{
    Real *from = d->work.before, *goal = d->work.halfway, part = 1.0, done = 0.0;
    memcpy(from, d->x, (size_t)d->n_held * sizeof *from);
    while (done < 1.0) {
        const Real fraction = done + part < 1.0 ? done + part : 1.0;
        for (Int i = 0; i < d->n_held; i++)
            goal[i] = fraction == 1.0 ? x[i] : from[i] + fraction * (x[i] - from[i]);
        if (may_cross(d, goal)) {
            part *= 0.5;
            if (part < 1.0 / (1 << GO_HALVINGS))
                return LOST;
            continue;
        }
        if (independent_step(d, goal) == DONE) {
            done = fraction;
            part *= 2.0;
            continue;
        }
        const Real size = norm(d->work.step, d->k->nv);
        if (independent_evaluate(d) != DONE)
            return LOST;
        part *= 0.5;
        if (part < 1.0 / (1 << GO_HALVINGS) || (done == 0.0 && part == 0.5 && size > WILD_WAY))
            return LOST;
    }
    return DONE;
}

void independent_save(const Dynamics *d, SavedPosition *position)
{
    memcpy(position->q, d->q, (size_t)d->k->nq * sizeof *d->q);
    memcpy(position->x, d->x, (size_t)d->n_held * sizeof *d->x);
    memcpy(position->turns, d->turns, (size_t)d->k->n_angles * sizeof *d->turns);
    position->bridge = d->bridge;
    position->turn = d->turn;
    position->has_bend = d->has_bend;
    memcpy(position->bend, d->bend, (size_t)d->k->nv * sizeof *d->bend);
    memcpy(position->bend_rate, d->bend_rate, (size_t)d->n_held * sizeof *d->bend_rate);
    memcpy(position->change, d->determinant.change, (size_t)d->n_held * sizeof *d->determinant.change);
    position->distance = d->determinant.distance;
}

int independent_restore(Dynamics *d, const SavedPosition *position)
{
    memcpy(d->q, position->q, (size_t)d->k->nq * sizeof *d->q);
    memcpy(d->x, position->x, (size_t)d->n_held * sizeof *d->x);
    memcpy(d->turns, position->turns, (size_t)d->k->n_angles * sizeof *d->turns);
    const int code = independent_evaluate(d);
    d->has_bend = position->has_bend && code == DONE;
    memcpy(d->bend, position->bend, (size_t)d->k->nv * sizeof *d->bend);
    memcpy(d->bend_rate, position->bend_rate, (size_t)d->n_held * sizeof *d->bend_rate);
    memcpy(d->determinant.change, position->change, (size_t)d->n_held * sizeof *d->determinant.change);
    d->determinant.distance = position->distance;
    note_point(d);
    return code;
}

int independent_begin(Dynamics *d)
{
    memset(d->x, 0, (size_t)d->n_held * sizeof *d->x);
    if (independent_evaluate(d) != DONE)
        return SINGULAR;
    d->determinant.first_pivot = d->pivot;
    d->determinant.spare = equations_error(d->k);
    memcpy(d->turns, d->k->angle, (size_t)d->k->n_angles * sizeof *d->turns);
    independent_save(d, &d->restart);
    return DONE;
}

/* How many times faster than a held coordinate another one moves, or coordinates bend. */
Real independent_pace(const Dynamics *d)
{
    Real most = 1.0;
    for (Int i = 0; i < d->n_held * d->k->nv; i++)
        if (fabs(d->columns[i]) > most)
            most = fabs(d->columns[i]);
    for (Int i = 0; !d->is_linear && i < d->n_held; i++)
        for (Int j = 0; j < d->n_held; j++)
            if (fabs(d->inverse[i * d->n_held + j]) > most)
                most = fabs(d->inverse[i * d->n_held + j]);
    return most;
}

/* Joint accelerations at joint velocities v that spin no body, for given held accelerations, by
 * scale, NULL: none. Takes note of them for the next prediction. */
void independent_bias(Dynamics *d, const Real *v, const Real *held_acceleration, Real *a)
{
    Kernel *k = d->k;
    Real *x = d->work.solved;
    memset(x, 0, (size_t)k->nv * sizeof *x);
    system_add_bias(k, v, -1.0, x);
    for (Int s = 0; s < d->spins.n; s++) {
        Real line[3];
        rotate3(k->R + 9 * d->spins.joint[s], d->spins.axis + 3 * s, line);
        x[k->nv - d->spins.n + s] = -dot3(line, k->alpha + 3 * d->spins.joint[s]);
    }
    system_solve(k, x);
    Real square = 0.0;
    for (Int j = 0; j < k->nv; j++)
        d->work.step[j] = v[j] / k->scale[j];
    for (Int i = 0; i < d->n_held; i++) {
        d->bend_rate[i] = held_rate(d, i, d->work.step);
        square += d->bend_rate[i] * d->bend_rate[i];
    }
    d->has_bend = square > 0.0;
    for (Int i = 0; d->has_bend && i < d->n_held; i++)
        d->bend_rate[i] /= square;
    memcpy(d->bend, x, (size_t)k->nv * sizeof *x);
    note_point(d);
    for (Int i = 0; held_acceleration && i < d->n_held; i++)
        for (Int j = 0; j < k->nv; j++)
            x[j] += held_acceleration[i] * d->columns[i * k->nv + j];
    for (Int j = 0; j < k->nv; j++)
        a[j] = k->scale[j] * x[j];
}
