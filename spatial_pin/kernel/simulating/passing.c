/* Passing branch points with one freedom, on the same smooth branch.
 *
 * The same for sweeps is continuation/branch_points.py, which takes several drivers, laws and loops
 * of any rank by singular values. This one takes 0.1 ms, that one 4.5 ms: longer than a whole
 * simulation of two passages, 2.9 ms. A test holds both to the same branch, to 1e-11.
 *
 * At a branch point (a change point) the equations lose rank and near it they are ill conditioned;
 * on either side each branch is a smooth curve. Falling pivots announce a branch point. It is
 * passed by interpolation, on a Passage: polynomials through eight closed configurations before it
 * and eight behind, found by extrapolating the curve before it. Passages are used again after
 * whole turns. */
#include <string.h>

#include "dynamics.h"

/* Way of the fastest joint from the branch point to the first node: eight nodes either side
   leave its eighth power, and rates there are still regular */
#define FIRST_REACH 0.12
/* Each half the one before, down to 1e-3, where polynomials no longer gain on round-off */
#define REACHES 7
#define VIEWS 6         /* looks from nearer at where a branch point is */
#define AHEAD 0.25      /* way to a branch point at which its place is surely enough known */
/* Step in which a change of the determinant's sign tells about where a branch point is */
#define SURE (FIRST_REACH / 2.0)
#define FASTER 2.0      /* times that joints move as fast as before, where a limit is near */
/* Part of the way across that the continued curve may be off */
#define OFF_CURVE TOLERANCE_REGULAR
#define BRIDGED 4.0     /* way to a known branch point, by an estimate: none other is before it */
#define PROBE_OF_ORDER 0.1 /* part of the way to a branch point on which the determinant falls */
#define REFUSED 0.1     /* change of x from where no passage was found, at which one may be */
/* Step, relative to the way to go, that is tried last: limits are met as roots */
#define LAST_STEP TOLERANCE_NOTHING
/* Way from a zero of order three, which is known to the third root of round-off, 6e-6 */
#define NEARBY 1e-5
#define LOOKS 16         /* places that a determinant is looked at */
#define NODE PASSAGE_NODES


enum { FOUND = 40, CHOSEN_ANEW = 41, ASTRAY = 42 };

/* ---- polynomials through nodes [BerrutTrefethen2004, 4.2] ---- */

static void set_weights(Passage *s, Int first, Int count)
{
    const Real width = fabs(s->x[first + count - 1] - s->x[first]);
    for (Int i = first; i < first + count; i++) {
        s->weight[i] = 1.0;
        for (Int j = first; j < first + count; j++)
            if (j != i)
                s->weight[i] *= 0.25 * width / (s->x[i] - s->x[j]);
    }
}

/* The polynomial through `count` nodes from `first` on, of rows of n numbers. */
static void interpolate(const Passage *s, Int first, Int count, const Real *rows, Int n, Real x,
                        Real *out)
{
    Real sum = 0.0;
    memset(out, 0, (size_t)n * sizeof *out);
    for (Int i = first; i < first + count; i++) {
        if (x == s->x[i]) {
            memcpy(out, rows + i * n, (size_t)n * sizeof *out);
            return;
        }
        const Real part = s->weight[i] / (x - s->x[i]);
        sum += part;
        for (Int j = 0; j < n; j++)
            out[j] += part * rows[i * n + j];
    }
    for (Int j = 0; j < n; j++)
        out[j] /= sum;
}

/* ---- standing on a passage ---- */

static void place_trial(Dynamics *d, const Passage *s, Int turn, Real x)
{
    Kernel *k = d->k;
    const Real local = x - (Real)turn * d->period;
    interpolate(s, 0, 2 * NODE, s->q, k->nq, local, d->trial);
    interpolate(s, 0, 2 * NODE, s->angles, k->n_angles, local, k->angle_reference);
    for (Int i = 0; turn && i < k->nq; i++)
        d->trial[i] += (Real)turn * d->period_q[i];
    for (Int i = 0; turn && i < k->n_angles; i++)
        k->angle_reference[i] += (Real)turn * d->period_angle[i];
    tree_normalize(k, d->trial);
    d->trial[d->held_q[0]] = d->start[d->held_q[0]] + k->scale[d->held[0]] * x;
    equations_values(k, d->trial);
}

static void put(Dynamics *d, Int which, Int turn, Real x)
{
    Kernel *k = d->k;
    const Passage *s = d->passages + which;
    const Real local = x - (Real)turn * d->period;
    place_trial(d, s, turn, x);
    tree_columns(k);
    interpolate(s, 0, 2 * NODE, s->t, k->nv, local, d->passage_t);
    interpolate(s, 0, 2 * NODE, s->c, k->nv, local, d->passage_c);
    for (Int v = 0; v < k->nv; v++)
        d->columns[v] = d->passage_t[v] / k->scale[v];
    memcpy(d->q, d->trial, (size_t)k->nq * sizeof *d->q);
    memcpy(d->turns, k->angle, (size_t)k->n_angles * sizeof *d->turns);
    d->x[0] = x;
    d->passage = which;
    d->turn = turn;
    d->has_bend = 0;
    d->distance = 0.0;
}

/* Stand at an end of a passage, off it. */
static int leave(Dynamics *d, Int which, Int turn, int high)
{
    Kernel *k = d->k;
    const Passage *s = d->passages + which;
    const Int node = (s->x[s->far] > s->x[s->near]) == high ? s->far : s->near;
    const Real x = s->x[node] + (Real)turn * d->period;
    place_trial(d, s, turn, x);
    memcpy(d->q, d->trial, (size_t)k->nq * sizeof *d->q);
    memcpy(d->turns, k->angle_reference, (size_t)k->n_angles * sizeof *d->turns);
    d->x[0] = x;
    d->distance = 0.0;
    return independent_stand(d);
}

/* ---- finding passages again ---- */

static Int turns_to(const Dynamics *d, const Passage *s, Real x)
{
    if (d->period == 0.0 || d->period_is_known < 0)
        return 0;
    const Real middle = 0.5 * (s->low + s->high);
    return (Int)floor((x - middle) / d->period + 0.5);
}

/* The nearest passage that holds x or lies on the way there; -1 if none. */
static Int nearest_passage(const Dynamics *d, Real x, Int *turn)
{
    const Real from = d->x[0], sense = x >= from ? 1.0 : -1.0;
    Int best = -1;
    Real least = INFINITY;
    for (Int i = 0; i < d->n_passages; i++) {
        const Passage *s = d->passages + i;
        const Int first = turns_to(d, s, from);
        for (Int n = first - 1; n <= first + 1; n++) {
            if (n != 0 && (d->period == 0.0 || d->period_is_known < 0))
                continue;
            const Real low = s->low + (Real)n * d->period, high = s->high + (Real)n * d->period;
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

/* Whether the branch is the same after whole turns: told where the passage's image begins. */
static int image_is_same(Dynamics *d, Int which, Int turn, Real x)
{
    Kernel *k = d->k;
    const Passage *s = d->passages + which;
    if (turn == 0 || d->period_is_known > 0)
        return 1;
    const int high = d->x[0] > x;
    const Int node = (s->x[s->far] > s->x[s->near]) == high ? s->far : s->near;
    Real goal = s->x[node] + (Real)turn * d->period, worst = 0.0;
    if (independent_follow(d, &goal) != DONE)
        return 0;
    for (Int j = 1; j < k->n_joints; j++)
        for (Int i = k->iq[j]; i < k->iq[j] + joint_nq(k->kind[j]); i++) {
            const Real change = d->q[i] - s->q[node * k->nq + i];
            const int turns = k->kind[j] == TURN || k->kind[j] == SCREW;
            const Real whole = turns ? 2.0 * PI * nearbyint(change / (2.0 * PI)) : 0.0;
            worst = fmax(worst, fabs(change - whole));
            d->period_q[i] = whole / (Real)turn;
        }
    for (Int i = 0; i < k->n_angles; i++) {
        const Real change = d->turns[i] - s->angles[node * k->n_angles + i];
        d->period_angle[i] = 2.0 * PI * nearbyint(change / (2.0 * PI)) / (Real)turn;
    }
    for (Int v = 0; v < k->nv; v++)
        worst = fmax(worst, fabs(d->columns[v] - s->t[node * k->nv + v] / k->scale[v]));
    d->period_is_known = worst < TOLERANCE_HALF_PRECISION ? 1 : -1;
    return d->period_is_known > 0;
}

/* ---- a new passage ---- */

static Real pace(const Dynamics *d)
{
    Real most = 0.0;
    for (Int v = 0; v < d->k->nv; v++)
        most = fmax(most, fabs(d->columns[v]));
    return most;
}

static int note_node(Dynamics *d, Passage *s, Int node)
{
    Kernel *k = d->k;
    s->x[node] = d->x[0];
    memcpy(s->q + node * k->nq, d->q, (size_t)k->nq * sizeof *d->q);
    memcpy(s->angles + node * k->n_angles, d->turns, (size_t)k->n_angles * sizeof *d->turns);
    for (Int v = 0; v < k->nv; v++)
        s->t[node * k->nv + v] = k->scale[v] * d->columns[v];
    return independent_bias(d, s->t + node * k->nv, NULL, s->c + node * k->nv);
}

/* Nodes from `first` on, outwards from x. */
static int note_side(Dynamics *d, Passage *s, Int first, Real x, Real apart)
{
    for (Int i = 0; i < NODE; i++) {
        const Real goal = x + (Real)i * apart;
        if (independent_follow(d, &goal) != DONE || note_node(d, s, first + i) != DONE)
            return LOST;
    }
    return DONE;
}

/* To the far side at x, by the curve before the branch point continued, and closed there. */
static int cross(Dynamics *d, Passage *s, Real x, Real way)
{
    Kernel *k = d->k;
    set_weights(s, 0, NODE);
    interpolate(s, 0, NODE, s->q, k->nq, x, d->q);
    interpolate(s, 0, NODE, s->angles, k->n_angles, x, d->turns);
    tree_normalize(k, d->q);
    d->q[d->held_q[0]] = d->start[d->held_q[0]] + k->scale[d->held[0]] * x;
    d->x[0] = x;
    if (independent_stand(d) != DONE)
        return LOST;
    if (k->n_chosen < k->n_closure && /* what held before may be nearly dependent here */
        (system_reselect(k) != DONE || independent_stand(d) != DONE))
        return LOST;
    return independent_settle(d, &x, OFF_CURVE * way);
}

/* Whether residuals between the ends are small and an interpolant of fewer nodes agrees. */
static int is_accurate(Dynamics *d, Passage *s)
{
    Kernel *k = d->k;
    Passage fewer = *s;
    for (int part = 1; part < 8; part += 2) {
        const Real x = s->low + 0.125 * part * (s->high - s->low);
        Real worst;
        place_trial(d, s, 0, x);
        worst = equations_error(k);
        if (!(worst < fmax(TOLERANCE_TIGHT, 2.0 * d->spare)))
            return 0;
        /* without the outermost node of one side */
        set_weights(&fewer, 0, 2 * NODE - 1);
        interpolate(&fewer, 0, 2 * NODE - 1, s->q, k->nq, x, d->goal);
        for (Int i = 0; i < k->nq; i++)
            if (i != d->held_q[0] && !(fabs(d->goal[i] - d->trial[i]) < TOLERANCE_CLOSED))
                return 0;
    }
    return 1;
}

static int factor_at(Dynamics *d, const Passage *s, Real x)
{
    place_trial(d, s, 0, x);
    equations_jacobian(d->k);
    return system_factor(d->k);
}

/* 1 / (w . K^-1 e) is smooth about a branch point and vanishes, however many loops go flat there. */
static Real inverse_solution(Dynamics *d, const Passage *s, Real x)
{
    Kernel *k = d->k;
    if (factor_at(d, s, x) != DONE)
        return 0.0;
    Real sum = 0.0;
    for (Int i = 0; i < k->nv; i++)
        d->solved[i] = i < k->n_chosen ? 1.0 + 0.37 * (Real)(i % 7) : 0.0;
    system_solve(k, d->solved);
    for (Int i = 0; i < k->nv; i++)
        sum += (1.0 + 0.61 * (Real)(i % 5)) * d->solved[i];
    return 1.0 / sum;
}

/* Whether other equations keep their rank where the chosen ones lose it: these are taken then. */
static int others_hold(Dynamics *d, const Passage *s, Real x)
{
    place_trial(d, s, 0, x);
    equations_jacobian(d->k);
    return system_reselect(d->k) == DONE && system_factor(d->k) == DONE &&
           d->k->pivot_ratio > TOLERANCE_SINGULAR;
}

/* The power of two of the determinant at x. */
static Int exponent_at(Dynamics *d, const Passage *s, Real x)
{
    return factor_at(d, s, x) == DONE ? d->k->exponent : 0;
}

/* The determinant at x, by a power of two that is the same along a passage. */
static Real determinant(Dynamics *d, const Passage *s, Real x, Int exponent)
{
    Kernel *k = d->k;
    if (factor_at(d, s, x) != DONE)
        return 0.0;
    return k->sign * ldexp(k->mantissa, (int)(k->exponent - exponent));
}

/* The zero between a and b, where the determinant changes its sign; the bisection's end is made
 * exacter by secants of the inverse solution, which a manifold zero does not blur. */
static Real zero_between(Dynamics *d, const Passage *s, Real a, Real b, Int exponent)
{
    const Real sign = determinant(d, s, a, exponent);
    while (fabs(b - a) > 1e-12 * (1.0 + fabs(b))) {
        const Real middle = 0.5 * (a + b), there = determinant(d, s, middle, exponent);
        if (there * sign > 0.0)
            a = middle;
        else
            b = middle;
    }
    return b;
}

/* A zero of the inverse solution by secants from a and b; NaN where they lead out of low to high. */
static Real secants(Dynamics *d, const Passage *s, Real a, Real b, Real low, Real high)
{
    Real fa = inverse_solution(d, s, a), fb = inverse_solution(d, s, b);
    for (int i = 0; i < 30 && fb != 0.0 && fb != fa && fabs(b - a) > 1e-14 * (1.0 + fabs(b)); i++) {
        const Real next = b - fb * (b - a) / (fb - fa);
        if (!(next >= low && next <= high))
            return NAN;
        a = b, fa = fb;
        b = next, fb = inverse_solution(d, s, b);
    }
    return b;
}

/* Note the branch point from low to high; where secants from there lead out, the one near a zero of
 * the determinant. Round-off blurs such a zero far and wide if it is one of higher order, but not
 * that of the inverse solution. */
static void note_branch_point(Dynamics *d, Passage *s, Real low, Real high, Int exponent)
{
    Real x = secants(d, s, low, high, low, high);
    if (!isfinite(x)) {
        const Real zero = zero_between(d, s, low, high, exponent);
        x = secants(d, s, zero - NEARBY, zero + NEARBY, low, high);
        x = isfinite(x) ? x : zero;
    }
    for (Int i = 0; i < s->n_branch_points; i++)
        if (fabs(x - s->branch_point[i]) < NEARBY)
            return;
    if (s->n_branch_points < MOST_BRANCH_POINTS && x > s->low && x < s->high)
        s->branch_point[s->n_branch_points++] = x;
}

/* Zeros of the determinant between low and high, at places so near that few are between two. Where
 * it comes near zero and goes back, closer looks tell two zeros from none; one at that is a zero
 * of even order. */
static void look_for_zeros(Dynamics *d, Passage *s, Real low, Real high)
{
    Real value[LOOKS + 1], largest = 0.0;
    const Int exponent = exponent_at(d, s, low);
    for (int level = 0; level < 6; level++) {
        const Real apart = (high - low) / LOOKS;
        int found = 0, least = 0;
        for (int i = 0; i <= LOOKS; i++) {
            value[i] = determinant(d, s, low + i * apart, exponent);
            largest = fmax(largest, fabs(value[i]));
            if (fabs(value[i]) < fabs(value[least]))
                least = i;
        }
        for (int i = 0; i < LOOKS; i++)
            if (value[i] * value[i + 1] < 0.0) {
                found = 1;
                const Real from = low + i * apart, to = from + apart;
                note_branch_point(d, s, from, to, exponent);
            }
        if (found)
            return;
        if (least == 0 || least == LOOKS)
            return; /* it only falls: with many loops by many orders of magnitude */
        if (fabs(value[least]) < TOLERANCE_RANK * largest) {
            const Real x = low + least * apart;
            note_branch_point(d, s, x - apart, x + apart, exponent);
            return;
        }
        low += (least - 1) * apart;
        high = low + 2.0 * apart;
    }
}

/* Order of the determinant's zeros on a passage, as it falls at an end: by that power of the way
 * to the branch point. As many loops go flat there. */
static Real order_of_zeros(Dynamics *d, const Passage *s)
{
    const Int exponent = exponent_at(d, s, s->low);
    const Real nearer = s->low + PROBE_OF_ORDER * (s->branch_point[0] - s->low);
    const Real left = determinant(d, s, nearer, exponent) / determinant(d, s, s->low, exponent);
    return left > 0.0 ? fmax(log(left) / log(1.0 - PROBE_OF_ORDER), 1.0) : 1.0;
}

static int locate(Dynamics *d, Passage *s)
{
    const Kernel *k = d->k;
    s->n_branch_points = 0;
    look_for_zeros(d, s, s->low, s->high);
    if (s->n_branch_points && k->n_chosen < k->n_closure && others_hold(d, s, s->branch_point[0]))
        return CHOSEN_ANEW;
    s->order = s->n_branch_points ? order_of_zeros(d, s) : 0.0;
    return s->n_branch_points ? DONE : LOST;
}

/* How far ahead the equations lose rank, told by two places `apart` from each other, the farther one
 * of which the branch stands on: by the least pivot, which falls in a line however many loops go
 * flat there; where another loop has that, by the determinant. */
static Real way_to_loss(const Dynamics *d, Real pivot, Real mantissa, Int exponent, Real apart)
{
    const Real fall = d->pivot > pivot
        ? d->pivot / pivot : ldexp(d->mantissa / mantissa, (int)(d->exponent - exponent));
    return fall > 1.0 ? apart / (fall - 1.0) : INFINITY;
}

/* About where the equations lose rank, told from ever nearer: in the end from about a reach away. */
static int look_closer(Dynamics *d, Real *about, Real sense, Real reach)
{
    for (int i = 0; i < VIEWS; i++) {
        const Real apart = sense * reach / pace(d);
        Real goal = *about - apart;
        if (independent_follow(d, &goal) != DONE) {
            if (!(sense * (goal - d->x[0]) > 0.0))
                return LOST;
            *about = d->x[0]; /* it came to it: it is that near */
            continue;
        }
        const Real pivot = d->pivot, mantissa = d->mantissa, back = goal - 0.25 * apart;
        const Int exponent = d->exponent;
        if (independent_follow(d, &back) != DONE)
            return LOST;
        const Real way = way_to_loss(d, pivot, mantissa, exponent, 0.25 * fabs(apart));
        if (!isfinite(way))
            return i ? DONE : LOST;
        const Real left = fmin(fmax(way, 0.3 * fabs(apart)), AHEAD);
        *about = goal + sense * left;
        if (i && fabs(left - fabs(apart)) < 0.2 * fabs(apart))
            return DONE;
    }
    return DONE;
}

static int build_at(Dynamics *d, Passage *s, Real about, Real sense, Real reach)
{
    if (look_closer(d, &about, sense, reach) != DONE)
        return LOST;
    const Real apart = sense * reach / pace(d);
    if (note_side(d, s, 0, about - apart, -apart) != DONE)
        return LOST;
    if (cross(d, s, about + apart, 2.0 * fabs(apart) * fmax(1.0, pace(d))) != DONE ||
        note_side(d, s, NODE, about + apart, apart) != DONE)
        return LOST;
    set_weights(s, 0, 2 * NODE);
    s->near = 0, s->far = NODE;
    s->low = fmin(s->x[0], s->x[NODE]), s->high = fmax(s->x[0], s->x[NODE]);
    if (!is_accurate(d, s))
        return LOST;
    return locate(d, s);
}

/* How far ahead the determinant would vanish with a zero of an order, as it fell over a step: its
 * root of that order is linear. `ahead` is the same of order one. */
static Real way_by_order(Real ahead, Real step, Real order)
{
    return step == 0.0 ? order * ahead : step / expm1(log1p(step / ahead) / order);
}

/* Whether a branch point is bridged already that would be so far `ahead` were the determinant
 * linear, as it was over the last step. */
static int is_known(const Dynamics *d, Real ahead, Real step)
{
    for (Int i = 0; i < d->n_passages; i++) {
        const Passage *s = d->passages + i;
        const Real shift = (Real)turns_to(d, s, d->x[0] + ahead) * d->period;
        const Real far = BRIDGED * fabs(way_by_order(ahead, step, s->order)) + 0.02;
        for (Int c = 0; c < s->n_branch_points; c++) {
            const Real way = copysign(1.0, ahead) * (s->branch_point[c] + shift - d->x[0]);
            if (way > 0.0 && way < far)
                return 1;
        }
    }
    return 0;
}

/* Bridge the branch point so far `ahead`; the branch stands where it stood. */
static int build(Dynamics *d, Real ahead, Real step)
{
    const Real about = d->x[0] + ahead, sense = copysign(1.0, ahead);
    for (Int i = 0; i < d->n_refused && i < MOST_PASSAGES; i++)
        if (fabs(about - d->refused[i]) < REFUSED)
            return LOST;
    if (is_known(d, ahead, step))
        return LOST;
    Passage *s = d->passages + d->n_built % MOST_PASSAGES;
    int code = LOST;
    const Real tolerance = d->tolerance;
    independent_remember(d, &d->aside);
    d->tolerance = fmin(tolerance, 1e-14);
    for (int i = 0; i < REACHES && code == LOST; i++) {
        code = build_at(d, s, about, sense, FIRST_REACH / (Real)(1 << i));
        if (independent_return(d, &d->aside) != DONE)
            code = ASTRAY;
    }
    d->tolerance = tolerance;
    if (code == ASTRAY)
        return LOST;
    if (code == CHOSEN_ANEW) {
        d->distance = 0.0;
        d->first_pivot = d->pivot;
        return DONE;
    }
    if (code == DONE) {
        d->n_built++;
        d->n_passages = d->n_built < MOST_PASSAGES ? d->n_built : MOST_PASSAGES;
    } else
        d->refused[d->n_refused++ % MOST_PASSAGES] = about;
    return code;
}

/* ---- going ---- */

/* How far ahead the determinant would vanish. */
static Real distance_ahead(const Dynamics *d, Real sense)
{
    return d->distance * sense > 0.0 ? d->distance * sense : INFINITY;
}

/* Follow the branch to x; FOUND where a branch point on the way has been bridged. */
static int walk(Dynamics *d, Real x, int may_build)
{
    Real part = x - d->x[0];
    const Real smallest = fabs(part) * LAST_STEP;
    const Real sense = part >= 0.0 ? 1.0 : -1.0, first = pace(d);
    while (d->x[0] != x) {
        const Real goal = fabs(x - d->x[0]) <= fabs(part) * (1.0 + 1e-12) ? x : d->x[0] + part;
        const Real from = d->x[0], before = d->pivot;
        if (goal == from)
            return LOST;
        const Real ahead = distance_ahead(d, sense);
        if (may_build && ahead < 1.4 * fabs(goal - from) && ahead * pace(d) < 1.0 &&
            build(d, d->distance, d->distance_step) == DONE)
            return FOUND;
        if (independent_step(d, &goal) == DONE) {
            part *= 2.0;
            if (may_build && distance_ahead(d, sense) * pace(d) < AHEAD &&
                pace(d) <= FASTER * first && build(d, d->distance, d->distance_step) == DONE)
                return FOUND;
            continue;
        }
        const int flipped = d->flipped && fabs(goal - from) * pace(d) < SURE;
        const Real after = d->k->pivot_ratio;
        if (independent_stand(d) != DONE)
            return LOST;
        if (flipped && build(d, (goal - from) * before / (before + after), 0.0) == DONE)
            return FOUND;
        part *= 0.5;
        if (fabs(part) < smallest || fabs(x - from) * pace(d) > 1280.0)
            return LOST;
    }
    return DONE;
}

static int travel(Dynamics *d, Real x)
{
    int is_found = 0;
    for (int i = 0; i < 4 * MOST_PASSAGES; i++) {
        Int turn = 0;
        const int on_passage = d->passage >= 0;
        if (on_passage) {
            const Passage *s = d->passages + d->passage;
            const Real shift = (Real)d->turn * d->period;
            if (s->low + shift < x && x < s->high + shift) {
                put(d, d->passage, d->turn, x);
                return DONE;
            }
            if (leave(d, d->passage, d->turn, x > d->x[0]) != DONE)
                return LOST;
        }
        const Int which = nearest_passage(d, x, &turn);
        if (which >= 0 && image_is_same(d, which, turn, x)) {
            const Passage *s = d->passages + which;
            const Real low = s->low + (Real)turn * d->period, high = s->high + (Real)turn * d->period;
            if (low < x && x < high) {
                put(d, which, turn, x);
                return DONE;
            }
            if (leave(d, which, turn, x > d->x[0]) != DONE)
                return LOST;
            is_found = 0;
            continue;
        }
        const int code = walk(d, x, !is_found);
        is_found = code == FOUND; /* the next one is looked for once it is passed */
        if (code != FOUND)
            return code;
    }
    return LOST;
}

int passing_return(Dynamics *d, const Place *place)
{
    if (place->passage < 0)
        return independent_return(d, place);
    put(d, place->passage, place->turn, place->x[0]);
    return DONE;
}

static int try_to(Dynamics *d, const Real *x)
{
    return d->passes ? travel(d, x[0]) : independent_follow(d, x);
}

/* Move to chart coordinates x. A wild trial of an integrator may end where there is hardly a way
 * back: then the way begins at the place that was kept last. */
int passing_travel(Dynamics *d, const Real *x)
{
    for (Int i = 0; i < d->n_held; i++)
        if (!isfinite(x[i]))
            return LOST;
    if (try_to(d, x) == DONE)
        return DONE;
    if (passing_return(d, &d->kept) == DONE && try_to(d, x) == DONE)
        return DONE;
    passing_return(d, &d->kept);
    return LOST;
}

/* Branch points in (from, to], in the order they are met; returns how many. */
Int passing_crossed(const Dynamics *d, Real from, Real to, Real *x, Int n_most)
{
    Int n = 0;
    const Real low = fmin(from, to), high = fmax(from, to);
    for (Int i = 0; i < d->n_passages; i++)
        for (Int c = 0; c < d->passages[i].n_branch_points; c++) {
            const Real at = d->passages[i].branch_point[c];
            if (d->period_is_known <= 0) {
                if (low < at && at <= high && n < n_most)
                    x[n++] = at;
                continue;
            }
            const Int first = (Int)floor((low - at) / d->period) + 1;
            const Int last = (Int)floor((high - at) / d->period);
            for (Int turn = first; turn <= last && n < n_most; turn++)
                x[n++] = at + (Real)turn * d->period;
        }
    for (Int i = 1; i < n; i++) /* few: put in order by insertion */
        for (Int j = i; j > 0 && (to >= from ? x[j] < x[j - 1] : x[j] > x[j - 1]); j--) {
            const Real keep = x[j];
            x[j] = x[j - 1], x[j - 1] = keep;
        }
    Int kept = 0; /* passages may overlap */
    for (Int i = 0; i < n; i++)
        if (kept == 0 || fabs(x[i] - x[kept - 1]) > NEARBY)
            x[kept++] = x[i];
    return kept;
}
