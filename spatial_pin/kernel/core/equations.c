/* Closure equations: value, Jacobian and second derivative.
 *
 * Most equations are products A . B - c of vectors that are fixed in bodies, or differences of
 * such. With f = force * B and m = X x B the wrench of the product about the world origin, its
 * derivative for a freedom with the twist (l, w) of one body relative to the other is
 * sign * (f . l + m . w); its second derivative at zero joint acceleration is
 * A'' . B + 2 A' . B' + A . B'' . */
#include <string.h>

#include "kernel.h"
#include "memory.h"

/* ---- products ---- */

WITHIN void sum_of_terms(const Number *vectors, const Int *term, const Real *factor, Number *out)
{
    zero3(out);
    if (term[0] >= 0)
        multiple3(factor[0], vectors + 3 * term[0], out);
    if (term[1] >= 0)
        add3(factor[1], vectors + 3 * term[1], out);
}

/* Derivatives of product i for the freedoms of its support, in their order. */
WITHIN void product_row(const Evaluated *s, Int i, const Number *force, const Number *moment, Number *out)
{
    const Kernel *k = kernel_of(s);
    for (Int t = k->products.support_start[i]; t < k->products.support_start[i + 1]; t++) {
        const Int v = k->products.support_v[t];
        *out++ = k->products.support_sign[t] *
                 (dot3(force, s->linear + 3 * v) + dot3(moment, s->angular + 3 * v));
    }
}

/* Move the scratch row into the pattern of an equation, and leave it zero. */
WITHIN void store_row(Evaluated *s, Int equation)
{
    const Kernel *k = kernel_of(s);
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++) {
        s->entry[e] = s->equations.row[k->entry_v[e]];
        s->equations.row[k->entry_v[e]] = SPREAD(0.0);
    }
}

/* ---- the kinds ---- */

WITHIN void value_of(Evaluated *s, Int equation)
{
    const Kernel *k = kernel_of(s);
    if (k->equations.kind[equation] == PRODUCT)
        s->residual[equation] = s->products.value[k->equations.product[equation]];
    else if (k->equations.kind[equation] == SUM)
        s->residual[equation] = sum_value(s, equation); /* an idle rotation has no value, only a rate */
}

WITHIN void jacobian_of(Evaluated *s, Int equation)
{
    const Kernel *k = kernel_of(s);
    const Int kind = k->equations.kind[equation], product = k->equations.product[equation];
    Number force[3], moment[3];
    if (kind == SUM) {
        sum_add_row(s, equation);
        store_row(s, equation);
        return;
    }
    zero3(force);
    if (kind == PRODUCT)
        product_wrench(s, product, force, moment);
    product_row(s, product, force, kind == PRODUCT ? moment : s->products.B + 3 * product,
                s->entry + k->entry_start[equation]);
}

WITHIN void bias_of(Evaluated *s, Int equation, const Number *v)
{
    const Kernel *k = kernel_of(s);
    const Int kind = k->equations.kind[equation], product = k->equations.product[equation];
    Number rate;
    if (kind == SUM) {
        sum_rates(s, equation, v, &rate, s->equations.bias + equation);
    } else if (kind == PRODUCT) {
        s->equations.bias[equation] = s->products.bias[product];
    } else {
        const Int body = k->vectors.body[k->products.b_term[2 * product]];
        s->equations.bias[equation] = dot3(s->products.B + 3 * product, s->alpha + 3 * body);
    }
}

/* ---- all equations ---- */

WITHIN void place_vector(Evaluated *s, Int i)
{
    const Kernel *k = kernel_of(s);
    const Int body = k->vectors.body[i];
    Number turned[3];
    rotate3(s->R + 9 * body, s->vectors.local + 3 * i, turned);
    if (k->vectors.flag[i])
        add3(1.0, s->p + 3 * body, turned);
    copy3(turned, s->vectors.value + 3 * i);
}

SHARED void equations_place_ground(Evaluated *s)
{
    const Kernel *k = kernel_of(s);
    for (Int i = 0; i < k->vectors.n; i++)
        if (!k->vectors.body[i])
            place_vector(s, i);
}

SHARED void equations_residuals(Evaluated *s, const Parts *of)
{
    const Kernel *k = kernel_of(s);
    const Products *all = &k->products;
    for (Int i = 0; i < of->n_vectors; i++)
        place_vector(s, of->vector[i]);
    for (Int p = 0; p < of->n_products; p++) {
        const Int i = of->product[p];
        Number *A = s->products.A + 3 * i, *B = s->products.B + 3 * i;
        sum_of_terms(s->vectors.value, all->a_term + 2 * i, all->a_factor + 2 * i, A);
        sum_of_terms(s->vectors.value, all->b_term + 2 * i, all->b_factor + 2 * i, B);
        s->products.value[i] = dot3(A, B) - all->constant[i];
    }
    if (of != &k->equations.rest)
        angles_place(s);
    for (Int e = 0; e < of->n_equations; e++)
        value_of(s, of->equation[e]);
}

SHARED void equations_jacobian(Evaluated *s, const Parts *of)
{
    tree_columns(s);
    for (Int e = 0; e < of->n_equations; e++)
        jacobian_of(s, of->equation[e]);
}

/* First and second derivatives of the vectors, without those of the joint velocities. */
WITHIN void vector_rates(Evaluated *s, const Parts *of)
{
    const Kernel *k = kernel_of(s);
    for (Int at = 0; at < of->n_vectors; at++) {
        const Int i = of->vector[at];
        const Int body = 3 * k->vectors.body[i];
        Number arm[3], more[3], rate[3], bias[3];
        rotate3(s->R + 3 * body, s->vectors.local + 3 * i, arm);
        cross3(s->omega + body, arm, rate);
        cross3(s->omega + body, rate, bias);
        cross3(s->alpha + body, arm, more);
        add3(1.0, more, bias);
        if (k->vectors.flag[i]) {
            add3(1.0, s->velocity + body, rate);
            add3(1.0, s->acceleration + body, bias);
        }
        copy3(rate, s->vectors.rate + 3 * i);
        copy3(bias, s->vectors.bias + 3 * i);
    }
}

SHARED void equations_bias(Evaluated *s, const Parts *of, const Number *v)
{
    const Kernel *k = kernel_of(s);
    const Products *all = &k->products;
    const Number *rate = s->vectors.rate, *bias = s->vectors.bias;
    tree_rates(s, v);
    vector_rates(s, of);
    for (Int p = 0; p < of->n_products; p++) {
        const Int i = of->product[p], *a = all->a_term + 2 * i, *b = all->b_term + 2 * i;
        const Number *A = s->products.A + 3 * i, *B = s->products.B + 3 * i;
        const Real *fa = all->a_factor + 2 * i, *fb = all->b_factor + 2 * i;
        Number dA[3], dB[3], ddA[3], ddB[3];
        sum_of_terms(rate, a, fa, dA);
        sum_of_terms(rate, b, fb, dB);
        sum_of_terms(bias, a, fa, ddA);
        sum_of_terms(bias, b, fb, ddB);
        s->products.rate[i] = dot3(dA, B) + dot3(A, dB);
        s->products.bias[i] = dot3(ddA, B) + 2.0 * dot3(dA, dB) + dot3(A, ddB);
    }
    if (of != &k->equations.rest)
        angles_rates(s, v);
    for (Int e = 0; e < of->n_equations; e++)
        bias_of(s, of->equation[e], v);
}

#if N_PARTS == 1

void equations_values(Kernel *k, const Real *q)
{
    tree_place(k, q);
    equations_residuals(k, &k->equations.all);
}

void equations_values_near(Kernel *k, const Real *q, const Real *reference)
{
    if (k->n_angles) /* else there may be no array */
        memmove(k->angle_reference, reference, (size_t)k->n_angles * sizeof *reference);
    equations_values(k, q);
}

void equations_angle_row(Kernel *k, Int angle, Real *row)
{
    angle_add_row(k, angle);
    for (Int v = 0; v < k->nv; v++) {
        row[v] = k->equations.row[v];
        k->equations.row[v] = 0.0;
    }
}

void equations_close_turns(Kernel *k, const Real *q)
{
    equations_values(k, q);
    if (!k->n_angles)
        return;
    memcpy(k->angle_reference, k->angle, (size_t)k->n_angles * sizeof *k->angle);
    for (Int e = 0; e < k->n_closure; e++) {
        const Int end = k->equations.term_start[e + 1];
        for (Int t = k->equations.term_start[e]; t < end; t++) {
            const Int i = k->equations.factor_start[t];
            if (i < k->equations.factor_start[t + 1] && k->quantities.kind[i] == ANGLE &&
                k->quantities.function[i] < 0) {
                const Real slope = product_without(k, t, i, -1);
                k->angle_reference[k->quantities.at[2 * i]] -=
                    slope != 0.0 ? k->residual[e] / slope : 0.0;
                break; /* one angle of an equation closes it */
            }
        }
    }
    equations_values(k, q);
}

Real equations_error(const Kernel *k)
{
    return largest(k->residual, k->n_closure);
}

/* ---- what Python's arrays must satisfy ---- */

static int holds(const Kernel *k, Int equation, Int v)
{
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
        if (k->entry_v[e] == v)
            return 1;
    return 0;
}

/* Whether the pattern of an equation holds the support of a product. */
static int covers(const Kernel *k, Int equation, Int product)
{
    Int e = k->entry_start[equation];
    const Int end = k->entry_start[equation + 1];
    for (Int t = k->products.support_start[product]; t < k->products.support_start[product + 1]; t++) {
        while (e < end && k->entry_v[e] < k->products.support_v[t])
            e++;
        if (e == end || k->entry_v[e] != k->products.support_v[t])
            return 0;
    }
    return 1;
}

/* Whether a quantity that is no angle is there, and an equation holds what it depends on. */
static int quantity_fits(const Kernel *k, Int equation, Int i)
{
    const Int kind = k->quantities.kind[i], *at = k->quantities.at + 2 * i;
    if (k->quantities.function[i] < -1 || k->quantities.function[i] >= k->quantities.n_functions ||
        !within(at[1], k->nv)) /* zero but of coordinates */
        return 0;
    if (kind == COORDINATE)
        return within(at[0], k->nq) && holds(k, equation, at[1]);
    return kind == ANGLE || (kind == OF_PRODUCT && within(at[0], k->products.n) &&
                             covers(k, equation, at[0]));
}

/* Likewise of an angle that sums define: these have no other angles. */
static int implicit_fits(const Kernel *k, Int equation, const Int *of)
{
    const Int *start = k->equations.factor_start, *term = k->equations.term_start + of[2];
    for (Int i = start[term[0]]; i < start[term[of[1] + 2]]; i++)
        if (!quantity_fits(k, equation, i) ||
            (k->quantities.kind[i] == ANGLE && !is_one_of(k, i, of[0], of[1])))
            return 0;
    return 1;
}

static int angle_is_sound(const Kernel *k, Int equation, Int angle)
{
    for (Int i = 0; i < k->implicit.n; i++)
        if (within(angle - k->implicit.at[4 * i], k->implicit.at[4 * i + 1]))
            return implicit_fits(k, equation, k->implicit.at + 4 * i);
    return within(angle, k->n_angles) && covers(k, equation, k->angles.product[2 * angle]) &&
           covers(k, equation, k->angles.product[2 * angle + 1]);
}

static int sum_is_sound(const Kernel *k, Int equation)
{
    for (Int t = k->equations.term_start[equation]; t < k->equations.term_start[equation + 1]; t++)
        for (Int i = k->equations.factor_start[t]; i < k->equations.factor_start[t + 1]; i++)
            if (!quantity_fits(k, equation, i) ||
                (k->quantities.kind[i] == ANGLE &&
                 !angle_is_sound(k, equation, k->quantities.at[2 * i])))
                return 0;
    return 1;
}

static int equation_is_sound(const Kernel *k, Int i)
{
    const Int kind = k->equations.kind[i], product = k->equations.product[i];
    if (!within(kind, IDLE + 1) || (kind == IDLE) != (i >= k->n_closure))
        return 0;
    if (kind == SUM)
        return sum_is_sound(k, i);
    if (!within(product, k->products.n) || !covers(k, i, product))
        return 0;
    /* their entries are written in the support's order */
    const Int n = k->products.support_start[product + 1] - k->products.support_start[product];
    if (k->entry_start[i + 1] - k->entry_start[i] != n)
        return 0;
    return kind != IDLE || k->products.b_term[2 * product] >= 0;
}

/* Whether places that parts of arrays begin at do not descend, from 0. */
static int ascends(const Int *start, Int n)
{
    for (Int i = 0; i < n; i++)
        if (start[i] > start[i + 1])
            return 0;
    return start[0] == 0;
}

static int implicit_is_sound(const Kernel *k)
{
    for (Int i = 0; i < k->implicit.n; i++) {
        const Int *at = k->implicit.at + 4 * i;
        if (at[1] < 1 || at[1] > 2 || at[0] < 0 || at[0] + at[1] > k->n_angles ||
            at[2] < k->n_equations ||
            at[2] + at[1] + 2 > k->n_equations + k->implicit.n_sums)
            return 0;
    }
    return 1;
}

int equations_are_sound(const Kernel *k)
{
    const Int ne = k->n_equations, n_sums = ne + k->implicit.n_sums;
    if (piecewise_size(k->quantities.shape, k->quantities.n_functions) < 0 ||
        !ascends(k->equations.term_start, n_sums) ||
        !ascends(k->equations.factor_start, k->equations.term_start[n_sums]) || !implicit_is_sound(k))
        return 0;
    for (Int i = 0; i < 2 * k->n_angles; i++)
        if (!within(k->angles.product[i], k->products.n))
            return 0;
    for (Int i = 0; i < ne; i++)
        if (!equation_is_sound(k, i))
            return 0;
    return 1;
}

/* ---- parts: some of the equations, and what they are made of ---- */

/* Marks: in the system, not in it; and vectors of the ground, which do not move. */
enum { OUTSIDE = 0, INSIDE = 1, STANDING = 2 };

static void unmark(Kernel *k)
{
    memset(k->equations.is_equation, OUTSIDE, (size_t)k->n_equations);
    memset(k->equations.is_product, OUTSIDE, (size_t)k->products.n);
    for (Int i = 0; i < k->vectors.n; i++)
        k->equations.is_vector[i] = k->vectors.body[i] ? OUTSIDE : STANDING;
}

static void mark_vector(Kernel *k, Int i)
{
    if (i >= 0 && k->vectors.body[i])
        k->equations.is_vector[i] = INSIDE;
}

static void mark_product(Kernel *k, Int product)
{
    k->equations.is_product[product] = INSIDE;
    mark_vector(k, k->products.x_term[product]);
    for (int t = 0; t < 2; t++) {
        mark_vector(k, k->products.a_term[2 * product + t]);
        mark_vector(k, k->products.b_term[2 * product + t]);
    }
}

/* Mark the products that sums from one number to another are made of; those of angles are anyway. */
static void mark_sums(Kernel *k, Int i, Int last)
{
    const Int end = k->equations.factor_start[k->equations.term_start[last]];
    for (Int x = k->equations.factor_start[k->equations.term_start[i]]; x < end; x++)
        if (k->quantities.kind[x] == OF_PRODUCT)
            mark_product(k, k->quantities.at[2 * x]);
}

/* Mark what an equation of the system is made of. */
static void mark_equation(Kernel *k, Int i)
{
    k->equations.is_equation[i] = INSIDE;
    if (k->equations.kind[i] == SUM)
        mark_sums(k, i, i + 1);
    else
        mark_product(k, k->equations.product[i]);
}

static Int list(const char *mark, char wanted, Int n, Int *places)
{
    Int count = 0;
    for (Int i = 0; i < n; i++)
        if (mark[i] == wanted)
            places[count++] = i;
    return count;
}

/* List the marked entries. */
static void list_parts(const Kernel *k, char mark, Parts *of)
{
    of->n_equations = list(k->equations.is_equation, mark, k->n_equations, of->equation);
    of->n_products = list(k->equations.is_product, mark, k->products.n, of->product);
    of->n_vectors = list(k->equations.is_vector, mark, k->vectors.n, of->vector);
}

void equations_of_system(Kernel *k)
{
    unmark(k);
    for (Int i = 0; i < k->system.n_chosen; i++)
        mark_equation(k, k->system.chosen[i]);
    for (Int i = k->n_closure; i < k->n_equations; i++)
        mark_equation(k, i);
    for (Int i = 0; i < 2 * k->n_angles; i++)
        mark_product(k, k->angles.product[i]);
    mark_sums(k, k->n_equations, k->n_equations + k->implicit.n_sums);
    list_parts(k, INSIDE, &k->equations.system);
    list_parts(k, OUTSIDE, &k->equations.rest);
}

void equations_make_room(Kernel *k)
{
    Parts *const parts[] = {&k->equations.all, &k->equations.system, &k->equations.rest};
    for (int i = 0; i < 3; i++) {
        parts[i]->equation = kernel_ints(k, k->n_equations);
        parts[i]->product = kernel_ints(k, k->products.n);
        parts[i]->vector = kernel_ints(k, k->vectors.n);
    }
    k->equations.is_equation = kernel_memory(k, k->n_equations, 1);
    k->equations.is_product = kernel_memory(k, k->products.n, 1);
    k->equations.is_vector = kernel_memory(k, k->vectors.n, 1);
}

void equations_begin(Kernel *k)
{
    unmark(k);
    list_parts(k, OUTSIDE, &k->equations.all);
    equations_place_ground(k);
}

#endif
