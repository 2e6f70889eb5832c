/* Sums of terms, which are numbers times quantities: products, joint coordinates, angles that count
 * turns, and functions of these; with their derivatives.
 *
 * Some angles are those at which other sums vanish: where a point is nearest to a curve, or two
 * curves to each other. With x all else that moves and u one or two such angles, these sums g(x, u)
 * vanish. Then g_u u' = -g_x x', and u" follows from the second derivative of g in time with u" left
 * out. */
#include <string.h>

#include "kernel.h"

#define MOST_STEPS 30     /* of Newton's method, as in Python (`composed_equations.py`) */
#define LONGEST_STEP 0.1  /* of the span of an angle */
#define LAST_STEP 1e-8    /* likewise: the step after one so short is below round-off */

enum { MOST = 2, N_STARTS = 96, N_STARTS_OF_TWO = 16 };

static void implicit_place(Kernel *k);
static void implicit_rates(Kernel *k, const Real *v);
static void weigh_implicit(Kernel *k, Int angle, Real weight);

/* ---- products ---- */

/* Force and moment about the world origin that a product exerts on its second body. */
void product_wrench(const Kernel *k, Int i, Real *force, Real *moment)
{
    const Real *B = k->products.B + 3 * i;
    Real X[3] = {0.0, 0.0, 0.0};
    if (k->products.x_term[i] >= 0)
        add3(k->products.x_factor[i], k->vectors.value + 3 * k->products.x_term[i], X);
    cross3(X, B, moment);
    zero3(force);
    add3(k->products.force[i], B, force);
}

/* Weigh product i by factor in the row that is added up: terms share products. */
static void weigh_product(Kernel *k, Int i, Real factor)
{
    if (!k->products.is_weighted[i]) {
        k->products.is_weighted[i] = 1;
        k->products.weighted[k->products.n_weighted++] = i;
    }
    k->products.weight[i] += factor;
}

/* Add the derivatives of the products, by their weights, to the scratch row over all freedoms. */
static void add_weighted_products(Kernel *k)
{
    for (Int x = 0; x < k->products.n_weighted; x++) {
        const Int i = k->products.weighted[x];
        Real force[3], moment[3];
        product_wrench(k, i, force, moment);
        for (Int t = k->products.support_start[i]; t < k->products.support_start[i + 1]; t++) {
            const Int v = k->products.support_v[t];
            k->equations.row[v] += k->products.weight[i] * k->products.support_sign[t] *
                         (dot3(force, k->linear + 3 * v) + dot3(moment, k->angular + 3 * v));
        }
        k->products.weight[i] = 0.0;
        k->products.is_weighted[i] = 0;
    }
    k->products.n_weighted = 0;
}

/* ---- quantities of sums ---- */

/* What an angle is nearest to: coordinates tell how often it has turned, or else the reference does. */
static Real near_angle(const Kernel *k, Int angle)
{
    const Int begin = k->angles.spin_start[angle], end = k->angles.spin_start[angle + 1];
    Real near = begin < end ? k->angles.spin_offset[angle] : k->angle_reference[angle];
    for (Int i = begin; i < end; i++)
        near += k->angles.spin_sign[i] * k->q[k->angles.spin_q[i]];
    return near;
}

void angles_place(Kernel *k)
{
    const Real around = 2.0 * PI;
    for (Int i = 0; i < k->n_angles; i++) {
        if (k->implicit.is_angle[i])
            continue;
        const Int *of = k->angles.product + 2 * i;
        const Real angle = atan2(k->products.value[of[0]], k->products.value[of[1]]);
        k->angle[i] = angle + around * nearbyint((near_angle(k, i) - angle) / around);
    }
    implicit_place(k);
}

void angles_rates(Kernel *k, const Real *v)
{
    for (Int i = 0; i < k->n_angles; i++) {
        if (k->implicit.is_angle[i])
            continue;
        const Int sine = k->angles.product[2 * i], cosine = k->angles.product[2 * i + 1];
        const Real s = k->products.value[sine], c = k->products.value[cosine], n = s * s + c * c;
        const Real ds = k->products.rate[sine], dc = k->products.rate[cosine];
        const Real dds = k->products.bias[sine], ddc = k->products.bias[cosine];
        const Real rate = (c * ds - s * dc) / n;
        k->angles.rate[i] = rate;
        k->angles.bias[i] = (c * dds - s * ddc) / n - 2.0 * rate * (c * dc + s * ds) / n;
    }
    implicit_rates(k, v);
}

static void place_quantity(Kernel *k, Int i)
{
    const Quantities *all = &k->quantities;
    const Int kind = all->kind[i], at = all->at[2 * i], f = all->function[i];
    const Real x = kind == COORDINATE ? k->q[at] : kind == ANGLE ? k->angle[at]
                                                                 : k->products.value[at];
    all->value[i] = x;
    if (f < 0)
        return;
    Real *last = all->last + 4 * f;
    if (last[0] != x) {
        piecewise_at(all->shape + SHAPE * f, all->number, all->called[f], x, all->piece + f,
                     last + 1, last + 2, last + 3);
        last[0] = x;
    }
    all->value[i] = last[1], all->slope[i] = last[2], all->bend[i] = last[3];
}

static void rate_quantity(Kernel *k, Int i, const Real *v)
{
    const Quantities *all = &k->quantities;
    const Int kind = all->kind[i], *at = all->at + 2 * i;
    Real rate = v[at[1]], bias = 0.0;
    if (kind != COORDINATE) {
        rate = kind == ANGLE ? k->angles.rate[at[0]] : k->products.rate[at[0]];
        bias = kind == ANGLE ? k->angles.bias[at[0]] : k->products.bias[at[0]];
    }
    if (all->function[i] >= 0) {
        bias = all->slope[i] * bias + all->bend[i] * rate * rate;
        rate *= all->slope[i];
    }
    all->rate[i] = rate;
    all->bias[i] = bias;
}

/* ---- sums: terms, each a number times quantities ---- */

/* A term's number times its quantities but two of them (-1: none). */
Real product_without(const Kernel *k, Int term, Int one, Int other)
{
    const Int *start = k->equations.factor_start + term;
    Real product = k->equations.term_number[term];
    for (Int i = start[0]; i < start[1]; i++)
        if (i != one && i != other)
            product *= k->quantities.value[i];
    return product;
}

Real sum_value(Kernel *k, Int i)
{
    const Int *term = k->equations.term_start + i, *factor = k->equations.factor_start;
    Real sum = 0.0;
    for (Int t = term[0]; t < term[1]; t++) {
        for (Int x = factor[t]; x < factor[t + 1]; x++)
            place_quantity(k, x);
        sum += product_without(k, t, -1, -1);
    }
    return sum;
}

int is_one_of(const Kernel *k, Int quantity, Int first, Int n)
{
    return k->quantities.kind[quantity] == ANGLE && within(k->quantities.at[2 * quantity] - first, n);
}

static void sum_slopes(const Kernel *k, Int sum, Int first, Int n, Real *slopes)
{
    const Int *term = k->equations.term_start + sum, *factor = k->equations.factor_start;
    for (Int i = 0; i < n; i++)
        slopes[i] = 0.0;
    for (Int t = term[0]; t < term[1]; t++)
        for (Int i = factor[t]; i < factor[t + 1]; i++)
            if (is_one_of(k, i, first, n))
                slopes[k->quantities.at[2 * i] - first] +=
                    product_without(k, t, i, -1) *
                    (k->quantities.function[i] >= 0 ? k->quantities.slope[i] : 1.0);
}

/* Weigh what a sum's terms are made of, but n angles from `first` on, in the row that is added up. */
static void weigh_sum(Kernel *k, Int sum, Real weight, Int first, Int n)
{
    const Quantities *all = &k->quantities;
    const Int *term = k->equations.term_start + sum, *factor = k->equations.factor_start;
    for (Int t = term[0]; t < term[1]; t++)
        for (Int i = factor[t]; i < factor[t + 1]; i++) {
            if (is_one_of(k, i, first, n))
                continue;
            const Int *at = all->at + 2 * i;
            const Real slope = all->function[i] >= 0 ? all->slope[i] : 1.0;
            const Real own = weight * product_without(k, t, i, -1) * slope;
            if (all->kind[i] == COORDINATE)
                k->equations.row[at[1]] += own * k->scale[at[1]];
            else if (all->kind[i] == OF_PRODUCT)
                weigh_product(k, at[0], own);
            else
                k->angles.weight[at[0]] += own;
        }
}

/* Weigh what an angle is made of by the angle's own weight. */
static void weigh_angle(Kernel *k, Int angle)
{
    const Real weight = k->angles.weight[angle];
    k->angles.weight[angle] = 0.0;
    if (weight == 0.0)
        return;
    if (k->implicit.is_angle[angle]) {
        weigh_implicit(k, angle, weight);
        return;
    }
    const Int *of = k->angles.product + 2 * angle;
    const Real s = k->products.value[of[0]], c = k->products.value[of[1]], square = s * s + c * c;
    weigh_product(k, of[0], weight * c / square);
    weigh_product(k, of[1], -weight * s / square);
}

void angle_add_row(Kernel *k, Int angle)
{
    k->angles.weight[angle] = 1.0;
    weigh_angle(k, angle);
    add_weighted_products(k);
}

void sum_add_row(Kernel *k, Int sum)
{
    const Int *term = k->equations.term_start + sum, *factor = k->equations.factor_start;
    weigh_sum(k, sum, 1.0, 0, 0);
    for (Int i = factor[term[0]]; i < factor[term[1]]; i++)
        if (k->quantities.kind[i] == ANGLE)
            weigh_angle(k, k->quantities.at[2 * i]);
    add_weighted_products(k);
}

void sum_rates(Kernel *k, Int sum_at, const Real *v, Real *of_rate, Real *of_bias)
{
    const Int *term = k->equations.term_start + sum_at, *factor = k->equations.factor_start;
    const Real *rate = k->quantities.rate, *bias = k->quantities.bias;
    Real sum = 0.0, first = 0.0;
    for (Int t = term[0]; t < term[1]; t++) {
        const Int begin = factor[t], end = factor[t + 1];
        for (Int i = begin; i < end; i++)
            rate_quantity(k, i, v);
        for (Int i = begin; i < end; i++) {
            const Real product = product_without(k, t, i, -1);
            first += product * rate[i];
            sum += product * bias[i];
            for (Int j = begin; j < end; j++)
                if (j != i)
                    sum += product_without(k, t, i, j) * rate[i] * rate[j];
        }
    }
    *of_rate = first;
    *of_bias = sum;
}

/* ---- angles that sums define ---- */

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
    for (Int i = 0; i < MOST_STEPS && size > LAST_STEP; i++) {
        newton_step(k, r, step);
        size = 0.0;
        for (Int x = 0; x < r->n; x++)
            size = fmax(size, fabs(step[x]) / (r->span[2 * x + 1] - r->span[2 * x]));
        if (!(size < INFINITY)) /* NaN too: slopes that are singular */
            return 0;
        for (Int x = 0; x < r->n; x++)
            u[x] += step[x] * (size > LONGEST_STEP ? LONGEST_STEP / size : 1.0);
    }
    if (size > LAST_STEP)
        return 0;
    newton_step(k, r, step); /* and the slopes there */
    for (Int x = 0; x < r->n; x++)
        u[x] += step[x];
    return sum_value(k, r->sum + r->n) > 0.0;
}

/* How far angles at place (i, j) of a grid are from a root: squares of the sums; of one angle the
   last sum, which is least at a nearest point. INFINITY where no root is wanted. */
static Real grid_value(Kernel *k, const Root *r, Int n, Int i, Int j)
{
    const Int at[MOST] = {i, j};
    Real *u = k->angle + r->first, total = 0.0;
    for (Int x = 0; x < r->n; x++)
        u[x] = r->span[2 * x] + (r->span[2 * x + 1] - r->span[2 * x]) * (Real)at[x] / (Real)n;
    if (r->n == 1)
        return sum_value(k, r->sum + 2);
    if (!(sum_value(k, r->sum + 2) > 0.0))
        return INFINITY;
    for (Int x = 0; x < r->n; x++) {
        const Real g = sum_value(k, r->sum + x);
        total += g * g;
    }
    return total;
}

/* Whether a place of a grid is as low as those next to it. */
static int is_lowest(const Real *value, Int n, Int rows, Int i, Int j)
{
    for (Int b = -1; b <= 1; b++)
        for (Int a = -1; a <= 1; a++) {
            const Int x = (i + a + n) % n, y = (j + b + rows) % rows;
            if (value[y * n + x] < value[j * n + i])
                return 0;
        }
    return value[j * n + i] < INFINITY;
}

/* The best of all roots, of periodic angles on their first turn, or the turn nearest to others; the
   reference follows. */
static void place_at_best(Kernel *k, const Root *r)
{
    const Int n = r->n == 1 ? N_STARTS : N_STARTS_OF_TWO, rows = r->n == 1 ? 1 : n;
    Real *u = k->angle + r->first, *near = k->angle_reference + r->first, step[MOST];
    Real value[N_STARTS_OF_TWO * N_STARTS_OF_TWO], best[MOST] = {NAN, NAN}, least = INFINITY;
    for (Int i = 0; i < n * rows; i++)
        value[i] = grid_value(k, r, n, i % n, i / n);
    for (Int i = 0; i < n * rows; i++) {
        if (!is_lowest(value, n, rows, i % n, i / n))
            continue;
        grid_value(k, r, n, i % n, i / n); /* which places the angles */
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
    if (least < INFINITY)
        memcpy(near, u, (size_t)r->n * sizeof *u);
}

static void implicit_place(Kernel *k)
{
    for (Int i = 0; i < k->implicit.n; i++) {
        const Root r = root_at(k, i);
        const Real *near = k->angle_reference + r.first;
        memcpy(k->angle + r.first, near, (size_t)r.n * sizeof *near);
        if (near[0] == 0.0 || !descends(k, &r))
            place_at_best(k, &r);
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

static void implicit_rates(Kernel *k, const Real *v)
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

static void weigh_implicit(Kernel *k, Int angle, Real weight)
{
    for (Int i = 0; i < k->implicit.n; i++) {
        const Root r = root_at(k, i);
        if (!within(angle - r.first, r.n))
            continue;
        for (Int x = 0; x < r.n; x++)
            weigh_sum(k, r.sum + x, -weight * r.inverse[(angle - r.first) * r.n + x], r.first, r.n);
    }
}
