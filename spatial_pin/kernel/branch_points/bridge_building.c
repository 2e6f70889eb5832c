/* A new bridge: nodes before a branch point, and nodes behind it, which the continued curve leads to.
 */
#include <string.h>

#include "bridge.h"

/* Each half the one before, down to 1e-3, where polynomials no longer gain on round-off */
#define REACHES 7
#define VIEWS 6     /* looks from nearer at where a branch point is */
/* Part of the way across that the continued curve may be off */
#define OFF_CURVE TOLERANCE_REGULAR
#define BRIDGED 4.0 /* way to a known branch point, by an estimate: none other is before it */
#define REFUSED 0.1 /* change of x from where no bridge could be built, at which one may be */

enum { ASTRAY = 42 };

static void note_node(Dynamics *d, Bridge *s, Int node)
{
    Kernel *k = d->k;
    s->x[node] = d->x[0];
    memcpy(s->q + node * k->nq, d->q, (size_t)k->nq * sizeof *d->q);
    memcpy(s->angles + node * k->n_angles, d->turns, (size_t)k->n_angles * sizeof *d->turns);
    for (Int v = 0; v < k->nv; v++)
        s->t[node * k->nv + v] = k->scale[v] * d->columns[v];
    independent_bias(d, s->t + node * k->nv, NULL, s->c + node * k->nv);
}

/* Nodes from `first` on, outwards from x. */
static int note_side(Dynamics *d, Bridge *s, Int first, Real x, Real apart)
{
    for (Int i = 0; i < NODE; i++) {
        const Real goal = x + (Real)i * apart;
        if (independent_follow(d, &goal) != DONE)
            return LOST;
        note_node(d, s, first + i);
    }
    return DONE;
}

/* To the far side at x, by the curve before the branch point continued, and closed there. */
static int cross(Dynamics *d, Bridge *s, Real x, Real way)
{
    Kernel *k = d->k;
    bridge_weights(s, 0, NODE);
    bridge_interpolate(s, 0, NODE, s->q, k->nq, x, d->q);
    bridge_interpolate(s, 0, NODE, s->angles, k->n_angles, x, d->turns);
    tree_normalize(k, d->q);
    d->q[d->held_q[0]] = d->start[d->held_q[0]] + k->scale[d->held[0]] * x;
    d->x[0] = x;
    if (independent_evaluate(d) != DONE)
        return LOST;
    if (k->system.n_chosen < k->n_closure && /* what held before may be nearly dependent here */
        (system_reselect(k) != DONE || independent_evaluate(d) != DONE))
        return LOST;
    return independent_settle(d, &x, OFF_CURVE * way);
}

/* Whether residuals between the ends are small and an interpolant of fewer nodes agrees. */
static int is_accurate(Dynamics *d, Bridge *s)
{
    Kernel *k = d->k;
    Bridge fewer = *s;
    for (int part = 1; part < 8; part += 2) {
        const Real x = s->low + 0.125 * part * (s->high - s->low);
        Real worst;
        bridge_evaluate(d, s, 0, x);
        worst = equations_error(k);
        if (!(worst < fmax(TOLERANCE_TIGHT, 2.0 * d->determinant.spare)))
            return 0;
        /* without the outermost node of one side */
        bridge_weights(&fewer, 0, 2 * NODE - 1);
        bridge_interpolate(&fewer, 0, 2 * NODE - 1, s->q, k->nq, x, d->work.goal);
        for (Int i = 0; i < k->nq; i++)
            if (i != d->held_q[0] && !(fabs(d->work.goal[i] - d->work.trial[i]) < TOLERANCE_CLOSED))
                return 0;
    }
    return 1;
}

/* Estimate where the equations lose rank, from ever nearer: in the end from about a reach away. */
static int look_closer(Dynamics *d, Real *about, Real sense, Real reach)
{
    for (int i = 0; i < VIEWS; i++) {
        const Real apart = sense * reach / fastest_pace(d);
        Real goal = *about - apart;
        if (independent_follow(d, &goal) != DONE) {
            if (!(sense * (goal - d->x[0]) > 0.0))
                return LOST;
            *about = d->x[0]; /* it came to it: it is that near */
            continue;
        }
        const Real back = goal - 0.25 * apart;
        if (independent_follow(d, &back) != DONE)
            return LOST;
        const Real way = distance_to_branch_point(d, sense) - 0.25 * fabs(apart);
        if (!isfinite(way))
            return i ? DONE : LOST;
        const Real left = fmin(fmax(way, 0.3 * fabs(apart)), AHEAD);
        *about = goal + sense * left;
        if (i && fabs(left - fabs(apart)) < 0.2 * fabs(apart))
            return DONE;
    }
    return DONE;
}

static int build_at(Dynamics *d, Bridge *s, Real about, Real sense, Real reach)
{
    if (look_closer(d, &about, sense, reach) != DONE)
        return LOST;
    const Real apart = sense * reach / fastest_pace(d);
    if (note_side(d, s, 0, about - apart, -apart) != DONE)
        return LOST;
    if (cross(d, s, about + apart, 2.0 * fabs(apart) * fmax(1.0, fastest_pace(d))) != DONE ||
        note_side(d, s, NODE, about + apart, apart) != DONE)
        return LOST;
    bridge_weights(s, 0, 2 * NODE);
    s->near = 0, s->far = NODE;
    s->low = fmin(s->x[0], s->x[NODE]), s->high = fmax(s->x[0], s->x[NODE]);
    if (!is_accurate(d, s))
        return LOST;
    return bridge_locate(d, s);
}

/* Whether a branch point is bridged already that would be so far `ahead`, as the equations changed
 * over the last step. */
static int is_known(const Dynamics *d, Real ahead)
{
    const Real far = BRIDGED * fabs(ahead) + 0.02;
    for (Int i = 0; i < d->branches.n; i++) {
        const Bridge *s = d->branches.bridges + i;
        const Real shift = (Real)bridge_turns(d, s, d->x[0] + ahead) * d->branches.period;
        for (Int c = 0; c < s->n_branch_points; c++) {
            const Real way = copysign(1.0, ahead) * (s->branch_point[c] + shift - d->x[0]);
            if (way > 0.0 && way < far)
                return 1;
        }
    }
    return 0;
}

/* Bridge the branch point so far `ahead`; the position does not change. */
int bridge_build(Dynamics *d, Real ahead)
{
    const Real about = d->x[0] + ahead, sense = copysign(1.0, ahead);
    for (Int i = 0; i < d->branches.n_refused && i < MOST_BRIDGES; i++)
        if (fabs(about - d->branches.refused[i]) < REFUSED)
            return LOST;
    if (is_known(d, ahead))
        return LOST;
    Bridge *s = d->branches.bridges + d->branches.n_built % MOST_BRIDGES;
    int code = LOST;
    const Real tolerance = d->tolerance;
    independent_save(d, &d->work.saved);
    for (int i = 0; i < REACHES && code == LOST; i++) {
        d->tolerance = fmin(tolerance, 1e-14);
        code = build_at(d, s, about, sense, FIRST_REACH / (Real)(1 << i));
        d->tolerance = tolerance; /* what it stood on need not be closed better than it was */
        if (independent_restore(d, &d->work.saved) != DONE)
            code = ASTRAY;
    }
    /* Once at a place: where it is tried again at every step, with the equations that hold, five
       parallel cranks all but in a line take fifty times as long, and are given up. */
    if (code == CHOSEN_ANEW &&
        !(d->branches.n_renewed && fabs(about - d->branches.renewed) < REFUSED)) {
        d->branches.renewed = about;
        d->branches.n_renewed++;
        d->determinant.distance = 0.0;
        d->determinant.first_pivot = d->pivot;
        return DONE;
    }
    if (code == DONE) {
        d->branches.n_built++;
        d->branches.n = d->branches.n_built < MOST_BRIDGES ? d->branches.n_built : MOST_BRIDGES;
    } else
        d->branches.refused[d->branches.n_refused++ % MOST_BRIDGES] = about;
    return code == DONE ? DONE : LOST;
}
