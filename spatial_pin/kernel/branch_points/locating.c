/* Where on a bridge the equations lose rank: zeros of a determinant, of any order. */
#include <string.h>

#include "bridge.h"

#define LOOKS 16 /* places that a determinant is looked at */

static int factor_at(Dynamics *d, const Bridge *s, Real x)
{
    bridge_evaluate(d, s, 0, x);
    equations_jacobian(d->k, &d->k->equations.system);
    return system_factor(d->k);
}

/* 1 / (w . K^-1 e) is smooth about a branch point and vanishes, however many loops go flat there. */
static Real inverse_solution(Dynamics *d, const Bridge *s, Real x)
{
    Kernel *k = d->k;
    if (factor_at(d, s, x) != DONE)
        return 0.0;
    Real sum = 0.0;
    for (Int i = 0; i < k->nv; i++)
        d->work.solved[i] = i < k->system.n_chosen ? 1.0 + 0.37 * (Real)(i % 7) : 0.0;
    system_solve(k, d->work.solved);
    for (Int i = 0; i < k->nv; i++)
        sum += (1.0 + 0.61 * (Real)(i % 5)) * d->work.solved[i];
    return 1.0 / sum;
}

/* Whether other equations keep their rank where the chosen ones lose it: these are taken then. */
static int others_hold(Dynamics *d, const Bridge *s, Real x)
{
    Kernel *k = d->k;
    memcpy(d->work.former, k->system.chosen, (size_t)k->system.n_chosen * sizeof *d->work.former);
    bridge_evaluate(d, s, 0, x);
    if (system_reselect(k) != DONE)
        return 0;
    if (system_factor(k) == DONE && k->system.pivot_ratio > TOLERANCE_SINGULAR)
        return 1;
    system_choose(k, d->work.former);
    return 0;
}

/* Sign of the determinant at x, and the logarithm of its size: many loops have it fall by hundreds of
 * orders of magnitude. */
static Real determinant(Dynamics *d, const Bridge *s, Real x, Real *size)
{
    const Kernel *k = d->k;
    *size = -INFINITY;
    if (factor_at(d, s, x) != DONE)
        return 0.0;
    *size = determinant_size(k);
    return k->system.sign;
}

/* The zero between a and b, where the determinant changes its sign; the bisection's end is made
 * exacter by secants of the inverse solution, which a manifold zero does not blur. */
static Real zero_between(Dynamics *d, const Bridge *s, Real a, Real b)
{
    Real size;
    const Real sign = determinant(d, s, a, &size);
    while (fabs(b - a) > 1e-12 * (1.0 + fabs(b))) {
        const Real middle = 0.5 * (a + b), there = determinant(d, s, middle, &size);
        if (there * sign > 0.0)
            a = middle;
        else
            b = middle;
    }
    return b;
}

/* A zero of the inverse solution by secants from a and b; NaN where they lead out of low to high. */
static Real secants(Dynamics *d, const Bridge *s, Real a, Real b, Real low, Real high)
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
 * the determinant if its sign changes. Round-off blurs such a zero far and wide if it is one of higher
 * order, but not that of the inverse solution. */
static void note_branch_point(Dynamics *d, Bridge *s, Real low, Real high, int changes)
{
    Real x = secants(d, s, low, high, low, high);
    if (!isfinite(x) && changes) {
        const Real zero = zero_between(d, s, low, high);
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
static void look_for_zeros(Dynamics *d, Bridge *s, Real low, Real high)
{
    Real sign[LOOKS + 1], size[LOOKS + 1], most = -INFINITY;
    for (int level = 0; level < 6; level++) {
        const Real apart = (high - low) / LOOKS;
        int has_zero = 0, least = 0;
        for (int i = 0; i <= LOOKS; i++) {
            sign[i] = determinant(d, s, low + i * apart, size + i);
            most = fmax(most, size[i]);
            if (size[i] < size[least])
                least = i;
        }
        for (int i = 0; i < LOOKS; i++)
            if (sign[i] * sign[i + 1] < 0.0) {
                has_zero = 1;
                const Real from = low + i * apart, to = from + apart;
                note_branch_point(d, s, from, to, 1);
            }
        if (has_zero)
            return;
        if (least == 0 || least == LOOKS)
            return; /* it only falls: with many loops by many orders of magnitude */
        if (size[least] < most + log2(TOLERANCE_RANK)) {
            const Real x = low + least * apart;
            note_branch_point(d, s, x - apart, x + apart, 0);
            return;
        }
        low += (least - 1) * apart;
        high = low + 2.0 * apart;
    }
}

int bridge_locate(Dynamics *d, Bridge *s)
{
    const Kernel *k = d->k;
    s->n_branch_points = 0;
    look_for_zeros(d, s, s->low, s->high);
    if (s->n_branch_points && k->system.n_chosen < k->n_closure &&
        others_hold(d, s, s->branch_point[0]))
        return CHOSEN_ANEW;
    return s->n_branch_points ? DONE : LOST;
}
