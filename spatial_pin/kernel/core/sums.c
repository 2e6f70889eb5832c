/* Sums of terms, which are numbers times quantities: products, joint coordinates, angles that count
 * turns, and functions of these; with their derivatives.
 *
 * Some angles are those at which other sums vanish: where a point is nearest to a curve, or two
 * curves to each other. With x all else that moves and u one or two such angles, these sums g(x, u)
 * vanish. Then g_u u' = -g_x x', and u" follows from the second derivative of g in time with u" left
 * out. */
#include <string.h>

#include "kernel.h"

#define MOST_ROOT_STEPS 30     /* of Newton's method, as in Python (`composed_equations.py`) */
#define LONGEST_STEP 0.1  /* of the span of an angle */
#define LAST_STEP 1e-8    /* likewise: the step after one so short is below round-off */

enum { MOST = 2, N_STARTS = 96, N_STARTS_OF_TWO = 16 };

#if N_PARTS == 1
static void implicit_place(Kernel *k);
static void implicit_rates(Kernel *k, const Real *v);
static void weigh_implicit(Kernel *k, Int angle, Real weight);
#endif

/* ---- products ---- */

/* Force and moment about the world origin that a product exerts on its second body. */
SHARED void product_wrench(const Evaluated *s, Int i, Number *force, Number *moment)
{
    const Kernel *k = kernel_of(s);
    const Number *B = s->products.B + 3 * i;
    Number X[3];
    zero3(X);
    if (k->products.x_term[i] >= 0)
        add3(k->products.x_factor[i], s->vectors.value + 3 * k->products.x_term[i], X);
    cross3(X, B, moment);
    multiple3(k->products.force[i], B, force);
}

/* Weigh product i by factor in the row that is added up: terms share products. */
WITHIN void weigh_product(Evaluated *s, Int i, Number factor)
{
    if (!s->products.is_weighted[i]) {
        s->products.is_weighted[i] = 1;
        s->products.weighted[s->products.n_weighted++] = i;
    }
    s->products.weight[i] += factor;
}

/* Add the derivatives of the products, by their weights, to the scratch row over all freedoms. */
WITHIN void add_weighted_products(Evaluated *s)
{
    const Products *all = &kernel_of(s)->products;
    for (Int x = 0; x < s->products.n_weighted; x++) {
        const Int i = s->products.weighted[x];
        Number force[3], moment[3];
        product_wrench(s, i, force, moment);
        for (Int t = all->support_start[i]; t < all->support_start[i + 1]; t++) {
            const Int v = all->support_v[t];
            s->equations.row[v] += s->products.weight[i] * all->support_sign[t] *
                         (dot3(force, s->linear + 3 * v) + dot3(moment, s->angular + 3 * v));
        }
        s->products.weight[i] = SPREAD(0.0);
        s->products.is_weighted[i] = 0;
    }
    s->products.n_weighted = 0;
}

/* ---- quantities of sums ---- */

/* What an angle is nearest to: coordinates tell how often it has turned, or else the reference does. */
WITHIN Number near_angle(const Evaluated *s, Int angle)
{
    const Angles *all = &kernel_of(s)->angles;
    const Int begin = all->spin_start[angle], end = all->spin_start[angle + 1];
    Number near = begin < end ? SPREAD(all->spin_offset[angle]) : s->angle_reference[angle];
    for (Int i = begin; i < end; i++)
        near += all->spin_sign[i] * s->q[all->spin_q[i]];
    return near;
}

SHARED void angles_place(Evaluated *s)
{
    const Kernel *k = kernel_of(s);
    const Real around = 2.0 * PI;
    for (Int i = 0; i < k->n_angles; i++) {
        if (k->implicit.is_angle[i])
            continue;
        const Number *value = s->products.value, near = near_angle(s, i);
        const Int sine = k->angles.product[2 * i], cosine = k->angles.product[2 * i + 1];
        for (int x = 0; x < N_PARTS; x++) {
            const Real angle = atan2(PART(value[sine], x), PART(value[cosine], x));
            PART(s->angle[i], x) = angle + around * nearbyint((PART(near, x) - angle) / around);
        }
    }
#if N_PARTS == 1
    implicit_place(s);
#endif
}

SHARED void angles_rates(Evaluated *e, const Number *v)
{
    const Kernel *k = kernel_of(e);
    for (Int i = 0; i < k->n_angles; i++) {
        if (k->implicit.is_angle[i])
            continue;
        const Int sine = k->angles.product[2 * i], cosine = k->angles.product[2 * i + 1];
        const Number s = e->products.value[sine], c = e->products.value[cosine], n = s * s + c * c;
        const Number ds = e->products.rate[sine], dc = e->products.rate[cosine];
        const Number dds = e->products.bias[sine], ddc = e->products.bias[cosine];
        const Number rate = (c * ds - s * dc) / n;
        e->angles.rate[i] = rate;
        e->angles.bias[i] = (c * dds - s * ddc) / n - 2.0 * rate * (c * dc + s * ds) / n;
    }
#if N_PARTS == 1
    implicit_rates(e, v);
#else
    (void)v;
#endif
}

WITHIN void place_quantity(Evaluated *s, Int i)
{
    const Quantities *all = &kernel_of(s)->quantities;
    const Int kind = all->kind[i], at = all->at[2 * i], f = all->function[i];
    const Number x = kind == COORDINATE ? s->q[at] : kind == ANGLE ? s->angle[at]
                                                                   : s->products.value[at];
    s->quantities.value[i] = x;
    if (f < 0)
        return;
    Number *last = s->quantities.last + 4 * f;
    for (int w = 0; w < N_PARTS; w++) {
        Real at_x[3];
        if (PART(last[0], w) == PART(x, w))
            continue;
        piecewise_at(all->shape + SHAPE * f, all->number, all->called[f], PART(x, w), all->piece + f, at_x);
        PART(last[0], w) = PART(x, w);
        PART(last[1], w) = at_x[0], PART(last[2], w) = at_x[1], PART(last[3], w) = at_x[2];
    }
    s->quantities.value[i] = last[1], s->quantities.slope[i] = last[2], s->quantities.bend[i] = last[3];
}

WITHIN void rate_quantity(Evaluated *s, Int i, const Number *v)
{
    const Quantities *all = &kernel_of(s)->quantities;
    const Int kind = all->kind[i], *at = all->at + 2 * i;
    Number rate = v[at[1]], bias = SPREAD(0.0);
    if (kind != COORDINATE) {
        rate = kind == ANGLE ? s->angles.rate[at[0]] : s->products.rate[at[0]];
        bias = kind == ANGLE ? s->angles.bias[at[0]] : s->products.bias[at[0]];
    }
    if (all->function[i] >= 0) {
        bias = s->quantities.slope[i] * bias + s->quantities.bend[i] * rate * rate;
        rate *= s->quantities.slope[i];
    }
    s->quantities.rate[i] = rate;
    s->quantities.bias[i] = bias;
}

/* ---- sums: terms, each a number times quantities ---- */

/* A term's number times its quantities but two of them (-1: none). */
SHARED Number product_without(const Evaluated *s, Int term, Int one, Int other)
{
    const Equations *all = &kernel_of(s)->equations;
    const Int *start = all->factor_start + term;
    Number product = SPREAD(all->term_number[term]);
    for (Int i = start[0]; i < start[1]; i++)
        if (i != one && i != other)
            product *= s->quantities.value[i];
    return product;
}

SHARED Number sum_value(Evaluated *s, Int i)
{
    const Equations *all = &kernel_of(s)->equations;
    const Int *term = all->term_start + i, *factor = all->factor_start;
    Number sum = SPREAD(0.0);
    for (Int t = term[0]; t < term[1]; t++) {
        for (Int x = factor[t]; x < factor[t + 1]; x++)
            place_quantity(s, x);
        sum += product_without(s, t, -1, -1);
    }
    return sum;
}

SHARED int is_one_of(const Kernel *k, Int quantity, Int first, Int n)
{
    return k->quantities.kind[quantity] == ANGLE && within(k->quantities.at[2 * quantity] - first, n);
}

/* Weigh what a sum's terms are made of, but n angles from `first` on, in the row that is added up. */
WITHIN void weigh_sum(Evaluated *s, Int sum, Number weight, Int first, Int n)
{
    const Kernel *k = kernel_of(s);
    const Quantities *all = &k->quantities;
    const Int *term = k->equations.term_start + sum, *factor = k->equations.factor_start;
    for (Int t = term[0]; t < term[1]; t++)
        for (Int i = factor[t]; i < factor[t + 1]; i++) {
            if (is_one_of(k, i, first, n))
                continue;
            const Int *at = all->at + 2 * i;
            Number own = weight * product_without(s, t, i, -1);
            if (all->function[i] >= 0)
                own *= s->quantities.slope[i];
            if (all->kind[i] == COORDINATE)
                s->equations.row[at[1]] += own * k->scale[at[1]];
            else if (all->kind[i] == OF_PRODUCT)
                weigh_product(s, at[0], own);
            else
                s->angles.weight[at[0]] += own;
        }
}

/* Weigh what an angle is made of by the angle's own weight. */
WITHIN void weigh_angle(Evaluated *e, Int angle)
{
    const Kernel *k = kernel_of(e);
    const Number weight = e->angles.weight[angle];
    e->angles.weight[angle] = SPREAD(0.0);
#if N_PARTS == 1
    if (weight == 0.0)
        return;
    if (k->implicit.is_angle[angle]) {
        weigh_implicit(e, angle, weight);
        return;
    }
#endif
    const Int *of = k->angles.product + 2 * angle;
    const Number s = e->products.value[of[0]], c = e->products.value[of[1]], square = s * s + c * c;
    weigh_product(e, of[0], weight * c / square);
    weigh_product(e, of[1], -weight * s / square);
}

SHARED void sum_add_row(Evaluated *s, Int sum)
{
    const Kernel *k = kernel_of(s);
    const Int *term = k->equations.term_start + sum, *factor = k->equations.factor_start;
    weigh_sum(s, sum, SPREAD(1.0), 0, 0);
    for (Int i = factor[term[0]]; i < factor[term[1]]; i++)
        if (k->quantities.kind[i] == ANGLE)
            weigh_angle(s, k->quantities.at[2 * i]);
    add_weighted_products(s);
}

SHARED void sum_rates(Evaluated *s, Int sum_at, const Number *v, Number *of_rate, Number *of_bias)
{
    const Equations *all = &kernel_of(s)->equations;
    const Int *term = all->term_start + sum_at, *factor = all->factor_start;
    const Number *rate = s->quantities.rate, *bias = s->quantities.bias;
    Number sum = SPREAD(0.0), first = SPREAD(0.0);
    for (Int t = term[0]; t < term[1]; t++) {
        const Int begin = factor[t], end = factor[t + 1];
        for (Int i = begin; i < end; i++)
            rate_quantity(s, i, v);
        for (Int i = begin; i < end; i++) {
            const Number product = product_without(s, t, i, -1);
            first += product * rate[i];
            sum += product * bias[i];
            for (Int j = begin; j < end; j++)
                if (j != i)
                    sum += product_without(s, t, i, j) * rate[i] * rate[j];
        }
    }
    *of_rate = first;
    *of_bias = sum;
}

#if N_PARTS == 1

void angle_add_row(Kernel *k, Int angle)
{
    k->angles.weight[angle] = 1.0;
    weigh_angle(k, angle);
    add_weighted_products(k);
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
    for (Int i = 0; i < MOST_ROOT_STEPS && size > LAST_STEP; i++) {
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

#endif
