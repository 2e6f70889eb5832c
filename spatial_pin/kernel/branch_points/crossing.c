/* Passing branch points with one freedom, on the same smooth branch.
 *
 * The same for sweeps is continuation/branch_points.py, which takes several drivers, laws and loops
 * of any rank by singular values. This one takes 0.1 ms, that one 4.5 ms: longer than a whole
 * simulation of two bridges, 2.9 ms. A test holds both to the same branch, to 1e-11.
 *
 * At a branch point (a change point) the equations lose rank and near it they are ill conditioned;
 * on either side each branch is a smooth curve. Falling pivots announce a branch point. It is
 * passed by interpolation, on a Bridge: polynomials through eight closed configurations before it
 * and eight behind, which extrapolating the curve before it leads to. Bridges are used again after
 * whole turns. */
#include <string.h>

#include "bridge.h"

/* Step in which a change of the determinant's sign tells about where a branch point is */
#define SURE (FIRST_REACH / 2.0)
#define FASTER 2.0 /* times that joints move as fast as before, where a limit is near */
/* Step, relative to the way to go, that is tried last: limits are met as roots */
#define LAST_STEP TOLERANCE_NOTHING

enum { FOUND = 40, LEFT = 43 };

/* ---- standing on a bridge ---- */

static void put(Dynamics *d, Int which, Int turn, Real x)
{
    Kernel *k = d->k;
    const Bridge *s = d->branches.bridges + which;
    const Real local = x - (Real)turn * d->branches.period;
    bridge_evaluate(d, s, turn, x);
    tree_columns(k);
    bridge_interpolate(s, 0, 2 * NODE, s->t, k->nv, local, d->branches.t);
    bridge_interpolate(s, 0, 2 * NODE, s->c, k->nv, local, d->branches.c);
    for (Int v = 0; v < k->nv; v++)
        d->columns[v] = d->branches.t[v] / k->scale[v];
    memcpy(d->q, d->work.trial, (size_t)k->nq * sizeof *d->q);
    memcpy(d->turns, k->angle, (size_t)k->n_angles * sizeof *d->turns);
    d->x[0] = x;
    d->bridge = which;
    d->turn = turn;
    d->has_bend = 0;
    d->determinant.distance = 0.0;
}

/* The node at an end. */
static Int end_node(const Bridge *s, int high)
{
    return (s->x[s->far] > s->x[s->near]) == high ? s->far : s->near;
}

/* Stand at an end of a bridge, off it. */
static int leave(Dynamics *d, Int which, Int turn, int high)
{
    Kernel *k = d->k;
    const Bridge *s = d->branches.bridges + which;
    const Real x = s->x[end_node(s, high)] + (Real)turn * d->branches.period;
    bridge_evaluate(d, s, turn, x);
    memcpy(d->q, d->work.trial, (size_t)k->nq * sizeof *d->q);
    memcpy(d->turns, k->angle_reference, (size_t)k->n_angles * sizeof *d->turns);
    d->x[0] = x;
    d->determinant.distance = 0.0;
    return independent_evaluate(d);
}

/* ---- finding bridges again ---- */

/* The nearest bridge that holds x or lies on the way there; -1 if none. */
static Int nearest_bridge(const Dynamics *d, Real x, Int *turn)
{
    const Real from = d->x[0], sense = x >= from ? 1.0 : -1.0;
    Int best = -1;
    Real least = INFINITY;
    for (Int i = 0; i < d->branches.n; i++) {
        const Bridge *s = d->branches.bridges + i;
        const Int first = bridge_turns(d, s, from);
        for (Int n = first - 1; n <= first + 1; n++) {
            if (n != 0 && !bridge_repeats(d))
                continue;
            const Real shift = (Real)n * d->branches.period, low = s->low + shift,
                       high = s->high + shift;
            const Real entry = sense > 0.0 ? low : high;
            const Real way = sense * (entry - from);
            const int ahead = way >= -1e-12 && sense * (x - entry) > 0.0;
            const int inside = low < from && from < high; /* where it was not yet bridged */
            if ((ahead || inside) && (inside ? 0.0 : way) < least) {
                least = inside ? 0.0 : way;
                best = i;
                *turn = n;
            }
        }
    }
    return best;
}

/* Whether the branch is the same after whole turns: compared where the bridge's image begins. */
static int image_is_same(Dynamics *d, Int which, Int turn, Real x)
{
    Kernel *k = d->k;
    const Bridge *s = d->branches.bridges + which;
    if (turn == 0 || d->branches.period_is_known > 0)
        return 1;
    const Int node = end_node(s, d->x[0] > x);
    Real goal = s->x[node] + (Real)turn * d->branches.period, worst = 0.0;
    if (independent_follow(d, &goal) != DONE)
        return 0;
    for (Int j = 1; j < k->n_joints; j++)
        for (Int i = k->iq[j]; i < k->iq[j] + joint_nq(k->kind[j]); i++) {
            const Real change = d->q[i] - s->q[node * k->nq + i];
            const int turns = k->kind[j] == TURN || k->kind[j] == SCREW;
            const Real whole = turns ? 2.0 * PI * nearbyint(change / (2.0 * PI)) : 0.0;
            worst = fmax(worst, fabs(change - whole));
            d->branches.period_q[i] = whole / (Real)turn;
        }
    for (Int i = 0; i < k->n_angles; i++) {
        const Real change = d->turns[i] - s->angles[node * k->n_angles + i];
        d->branches.period_angle[i] = 2.0 * PI * nearbyint(change / (2.0 * PI)) / (Real)turn;
    }
    for (Int v = 0; v < k->nv; v++)
        worst = fmax(worst, fabs(d->columns[v] - s->t[node * k->nv + v] / k->scale[v]));
    d->branches.period_is_known = worst < TOLERANCE_HALF_PRECISION ? 1 : -1;
    return d->branches.period_is_known > 0;
}

/* ---- going ---- */

/* Follow the branch to x; FOUND where a branch point on the way has been bridged. */
static int walk(Dynamics *d, Real x, int may_build)
{
    Real part = x - d->x[0];
    const Real smallest = fabs(part) * LAST_STEP;
    const Real sense = part >= 0.0 ? 1.0 : -1.0, first = fastest_pace(d);
    while (d->x[0] != x) {
        const Real goal = fabs(x - d->x[0]) <= fabs(part) * (1.0 + 1e-12) ? x : d->x[0] + part;
        const Real from = d->x[0], before = d->pivot;
        if (goal == from)
            return LOST;
        const Real ahead = distance_to_branch_point(d, sense);
        if (may_build && ahead < 1.4 * fabs(goal - from) && ahead * fastest_pace(d) < 1.0 &&
            bridge_build(d, d->determinant.distance) == DONE)
            return FOUND;
        if (independent_step(d, &goal) == DONE) {
            part *= 2.0;
            if (may_build && distance_to_branch_point(d, sense) * fastest_pace(d) < AHEAD &&
                fastest_pace(d) <= FASTER * first && bridge_build(d, d->determinant.distance) == DONE)
                return FOUND;
            continue;
        }
        const int flipped = d->determinant.flipped && fabs(goal - from) * fastest_pace(d) < SURE;
        const Real after = d->k->system.pivot_ratio;
        if (independent_evaluate(d) != DONE)
            return LOST;
        if (flipped && bridge_build(d, (goal - from) * before / (before + after)) == DONE)
            return FOUND;
        part *= 0.5;
        if (fabs(part) < smallest || fabs(x - from) * fastest_pace(d) > WILD_WAY)
            return LOST;
    }
    return DONE;
}

/* Go on a bridge to x, or to its end on the way there: it is LEFT then. */
static int go_along(Dynamics *d, Int which, Int turn, Real x)
{
    const Bridge *s = d->branches.bridges + which;
    const Real shift = (Real)turn * d->branches.period;
    if (s->low + shift < x && x < s->high + shift) {
        put(d, which, turn, x);
        return DONE;
    }
    return leave(d, which, turn, x > d->x[0]) == DONE ? LEFT : LOST;
}

static int travel(Dynamics *d, Real x)
{
    int is_found = 0;
    for (int i = 0; i < 4 * MOST_BRIDGES; i++) {
        Int turn = 0;
        int code = d->bridge >= 0 ? go_along(d, d->bridge, d->turn, x) : LEFT;
        if (code != LEFT)
            return code;
        const Int which = nearest_bridge(d, x, &turn);
        if (which >= 0 && image_is_same(d, which, turn, x))
            code = go_along(d, which, turn, x);
        else
            code = walk(d, x, !is_found);
        if (code != FOUND && code != LEFT)
            return code;
        is_found = code == FOUND; /* the next one is looked for once it is passed */
    }
    return LOST;
}

int crossing_restore(Dynamics *d, const SavedPosition *position)
{
    if (position->bridge < 0)
        return independent_restore(d, position);
    put(d, position->bridge, position->turn, position->x[0]);
    return DONE;
}

static int try_to(Dynamics *d, const Real *x)
{
    return d->crosses ? travel(d, x[0]) : independent_follow(d, x);
}

/* Move to coordinates x. A wild trial of an integrator may end where there is hardly a way
 * back: then the way begins at the position that was saved last. That position itself, which a loose
 * tolerance may have taken just beyond where the loops close exactly, is as good as it was. */
int crossing_travel(Dynamics *d, const Real *x)
{
    if (!are_finite(x, d->n_held))
        return LOST;
    if (try_to(d, x) == DONE)
        return DONE;
    if (crossing_restore(d, &d->restart) == DONE && try_to(d, x) == DONE)
        return DONE;
    const int returned = crossing_restore(d, &d->restart);
    return memcmp(x, d->restart.x, (size_t)d->n_held * sizeof *x) == 0 ? returned : LOST;
}

/* Branch points in (from, to], in the order they are met; returns how many. */
Int crossing_points(const Dynamics *d, Real from, Real to, Real *x, Int n_most)
{
    Int n = 0;
    const Real low = fmin(from, to), high = fmax(from, to);
    for (Int i = 0; i < d->branches.n; i++)
        for (Int c = 0; c < d->branches.bridges[i].n_branch_points; c++) {
            const Real at = d->branches.bridges[i].branch_point[c];
            if (d->branches.period_is_known <= 0) {
                if (low < at && at <= high && n < n_most)
                    x[n++] = at;
                continue;
            }
            const Int first = (Int)floor((low - at) / d->branches.period) + 1;
            const Int last = (Int)floor((high - at) / d->branches.period);
            for (Int turn = first; turn <= last && n < n_most; turn++)
                x[n++] = at + (Real)turn * d->branches.period;
        }
    for (Int i = 1; i < n; i++) /* few: put in order by insertion */
        for (Int j = i; j > 0 && (to >= from ? x[j] < x[j - 1] : x[j] > x[j - 1]); j--) {
            const Real keep = x[j];
            x[j] = x[j - 1], x[j - 1] = keep;
        }
    Int n_apart = 0; /* bridges may overlap */
    for (Int i = 0; i < n; i++)
        if (n_apart == 0 || fabs(x[i] - x[n_apart - 1]) > NEARBY)
            x[n_apart++] = x[i];
    return n_apart;
}
