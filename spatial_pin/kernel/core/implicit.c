/* Angles that sums define: where a point is nearest to a curve, or two curves to each other.
 *
 * With x all else that moves and u one or two angles, the sums g(x, u) vanish. Then g_u u' = -g_x x',
 * and u" follows from the second derivative of g in time with u" left out. */
#include <string.h>

#include "kernel.h"

#define MOST_STEPS 30     /* of Newton's method, as in Python (`composed_equations.py`) */
#define LONGEST_STEP 0.1  /* of the span of an angle */
#define STEP_NOISE 1e-13  /* likewise: a step so short is the last one */

enum { MOST = 2, N_STARTS = 48, N_STARTS_OF_TWO = 24 };

typedef struct {
    Int first, n, sum, periodic;
    const Real *span;
    Real *inverse;
} Root;

static Root root_at(const Kernel *k, Int i)
{
    const Int *at = k->implicit.at + 4 * i;
    return (Root){at[0], at[1], at[2], at[3], k->implicit.span + 4 * i, k->implicit.inverse + 4 * i};
}

/* A Newton step (n) from the angles as they are; `inverse` of the slopes there. */
static void newton_step(Kernel *k, const Root *r, Real *step)
{
    Real g[MOST], J[MOST * MOST];
    for (Int i = 0; i < r->n; i++) {
        g[i] = sum_value(k, r->sum + i);
        sum_slopes(k, r->sum + i, r->first, r->n, J + i * r->n);
    }
    if (r->n == 1) {
        r->inverse[0] = 1.0 / J[0];
        step[0] = -g[0] / fabs(J[0]); /* downhill, towards the nearest point of a curve */
        return;
    }
    const Real det = J[0] * J[3] - J[1] * J[2];
    r->inverse[0] = J[3] / det, r->inverse[1] = -J[1] / det;
    r->inverse[2] = -J[2] / det, r->inverse[3] = J[0] / det;
    for (Int i = 0; i < 2; i++)
        step[i] = -(r->inverse[2 * i] * g[0] + r->inverse[2 * i + 1] * g[1]);
}

/* Whether Newton's method finds a root, and a wanted one, from the angles as they are. */
static int descends(Kernel *k, const Root *r)
{
    Real *u = k->angle + r->first, step[MOST], size = INFINITY;
    for (Int i = 0; i < MOST_STEPS && size > STEP_NOISE; i++) {
        newton_step(k, r, step);
        size = 0.0;
        for (Int x = 0; x < r->n; x++)
            size = fmax(size, fabs(step[x]) / (r->span[2 * x + 1] - r->span[2 * x]));
        if (!(size < INFINITY)) /* NaN too: slopes that are singular */
            return 0;
        for (Int x = 0; x < r->n; x++)
            u[x] += step[x] * (size > LONGEST_STEP ? LONGEST_STEP / size : 1.0);
    }
    if (size > STEP_NOISE)
        return 0;
    newton_step(k, r, step); /* the slopes there */
    return sum_value(k, r->sum + r->n) > 0.0;
}

/* The best of all roots, of periodic angles on their first turn, or the turn nearest to others. */
static void place_at_best(Kernel *k, const Root *r, const Real *near)
{
    const Int n = r->n == 1 ? N_STARTS : N_STARTS_OF_TWO, rows = r->n == 1 ? 1 : n;
    Real *u = k->angle + r->first, best[MOST] = {NAN, NAN}, least = INFINITY, step[MOST];
    for (Int i = 0; i < n * rows; i++) {
        const Int at[MOST] = {i % n, i / n};
        for (Int x = 0; x < r->n; x++)
            u[x] = r->span[2 * x] + (r->span[2 * x + 1] - r->span[2 * x]) * (Real)at[x] / (Real)n;
        if (!descends(k, r))
            continue;
        const Real here = fabs(sum_value(k, r->sum + r->n + 1));
        if (here < least) {
            least = here;
            memcpy(best, u, (size_t)r->n * sizeof *u);
        }
    }
    for (Int x = 0; x < r->n; x++) {
        const Real low = r->span[2 * x], width = r->span[2 * x + 1] - low;
        u[x] = best[x];
        if (r->periodic >> x & 1)
            u[x] += width * (near[0] != 0.0 ? nearbyint((near[x] - u[x]) / width)
                                            : -floor((u[x] - low) / width));
    }
    newton_step(k, r, step);
}

void implicit_place(Kernel *k)
{
    for (Int i = 0; i < k->implicit.n; i++) {
        const Root r = root_at(k, i);
        const Real *near = k->angle_reference + r.first;
        memcpy(k->angle + r.first, near, (size_t)r.n * sizeof *near);
        if (near[0] == 0.0 || !descends(k, &r))
            place_at_best(k, &r, near);
    }
}

/* -inverse g (n) */
static void solve(const Root *r, const Real *g, Real *out)
{
    for (Int i = 0; i < r->n; i++) {
        out[i] = 0.0;
        for (Int x = 0; x < r->n; x++)
            out[i] -= r->inverse[i * r->n + x] * g[x];
    }
}

void implicit_rates(Kernel *k, const Real *v)
{
    for (Int i = 0; i < k->implicit.n; i++) {
        const Root r = root_at(k, i);
        Real *rate = k->angles.rate + r.first, *bias = k->angles.bias + r.first;
        Real first[MOST], second[MOST];
        for (Int x = 0; x < r.n; x++)
            rate[x] = bias[x] = 0.0;
        for (Int x = 0; x < r.n; x++)
            sum_rates(k, r.sum + x, v, first + x, second + x);
        solve(&r, first, rate);
        for (Int x = 0; x < r.n; x++)
            sum_rates(k, r.sum + x, v, first + x, second + x);
        solve(&r, second, bias);
    }
}

void implicit_add_row(Kernel *k, Int angle, Real factor)
{
    for (Int i = 0; i < k->implicit.n; i++) {
        const Root r = root_at(k, i);
        if (!within(angle - r.first, r.n))
            continue;
        for (Int x = 0; x < r.n; x++)
            sum_add_row(k, r.sum + x, -factor * r.inverse[(angle - r.first) * r.n + x], r.first, r.n);
    }
}

int implicit_is_sound(const Kernel *k)
{
    for (Int i = 0; i < k->implicit.n; i++) {
        const Int *at = k->implicit.at + 4 * i;
        if (at[1] < 1 || at[1] > MOST || at[0] < 0 || at[0] + at[1] > k->n_angles ||
            at[2] < k->n_equations ||
            at[2] + at[1] + 2 > k->n_equations + k->implicit.n_sums)
            return 0;
    }
    return 1;
}
