/* Closure equations: value, Jacobian and second derivative.
 *
 * Most equations are products A . B - c of vectors that are fixed in bodies, or differences of
 * such. With f = force * B and m = X x B the wrench of the product about the world origin, its
 * derivative for a freedom with the twist (l, w) of one body relative to the other is
 * sign * (f . l + m . w); its second derivative at zero joint acceleration is
 * A'' . B + 2 A' . B' + A . B'' . */
#include <string.h>

#include "kernel.h"

/* ---- products ---- */

static inline void sum_of_terms(const Real *vectors, const Int *term, const Real *factor, Real *out)
{
    Real sum[3] = {0.0, 0.0, 0.0};
    for (int t = 0; t < 2; t++)
        if (term[t] >= 0)
            add3(factor[t], vectors + 3 * term[t], sum);
    copy3(sum, out);
}

/* Force and moment about the world origin that a product exerts on its second body. */
static void product_wrench(const Kernel *k, Int i, Real *force, Real *moment)
{
    const Real *B = k->B + 3 * i;
    Real X[3] = {0.0, 0.0, 0.0};
    if (k->x_term[i] >= 0)
        add3(k->x_factor[i], k->vector + 3 * k->x_term[i], X);
    cross3(X, B, moment);
    zero3(force);
    add3(k->force[i], B, force);
}

/* Derivatives of product i for the freedoms of its support, in their order. */
static void product_row(const Kernel *k, Int i, const Real *force, const Real *moment, Real *out)
{
    for (Int t = k->support_start[i]; t < k->support_start[i + 1]; t++) {
        const Int v = k->support_v[t];
        *out++ = k->support_sign[t] *
                 (dot3(force, k->linear + 3 * v) + dot3(moment, k->angular + 3 * v));
    }
}

/* Add factor times the derivatives of product i to the scratch row over all freedoms. */
static void add_product_row(Kernel *k, Int i, Real factor)
{
    Real force[3], moment[3];
    product_wrench(k, i, force, moment);
    for (Int t = k->support_start[i]; t < k->support_start[i + 1]; t++) {
        const Int v = k->support_v[t];
        k->row[v] += factor * k->support_sign[t] *
                     (dot3(force, k->linear + 3 * v) + dot3(moment, k->angular + 3 * v));
    }
}

/* Move the scratch row into the pattern of an equation, and leave it zero. */
static void store_row(Kernel *k, Int equation)
{
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++) {
        k->entry[e] = k->row[k->entry_v[e]];
        k->row[k->entry_v[e]] = 0.0;
    }
}

/* ---- quantities of sums ---- */

/* What an angle is nearest to: coordinates tell how often it has turned, or else the reference does. */
static Real near_angle(const Kernel *k, Int angle)
{
    const Int begin = k->spin_start[angle], end = k->spin_start[angle + 1];
    Real near = begin < end ? k->spin_offset[angle] : k->angle_reference[angle];
    for (Int i = begin; i < end; i++)
        near += k->spin_sign[i] * k->q[k->spin_q[i]];
    return near;
}

static void place_angles(Kernel *k)
{
    const Real around = 2.0 * PI;
    for (Int i = 0; i < k->n_angles; i++) {
        const Int *of = k->angle_product + 2 * i;
        const Real angle = atan2(k->value[of[0]], k->value[of[1]]);
        k->angle[i] = angle + around * nearbyint((near_angle(k, i) - angle) / around);
    }
}

static void angle_rates(Kernel *k)
{
    for (Int i = 0; i < k->n_angles; i++) {
        const Int sine = k->angle_product[2 * i], cosine = k->angle_product[2 * i + 1];
        const Real s = k->value[sine], c = k->value[cosine], n = s * s + c * c;
        const Real ds = k->product_rate[sine], dc = k->product_rate[cosine];
        const Real dds = k->product_bias[sine], ddc = k->product_bias[cosine];
        const Real rate = (c * ds - s * dc) / n;
        k->angle_rate[i] = rate;
        k->angle_bias[i] = (c * dds - s * ddc) / n - 2.0 * rate * (c * dc + s * ds) / n;
    }
}

static void place_quantity(Kernel *k, Int i)
{
    const Int kind = k->quantity_kind[i], at = k->quantity_at[2 * i], f = k->quantity_function[i];
    const Real x = kind == OF_PRODUCT ? k->value[at] : kind == ANGLE ? k->angle[at] : k->q[at];
    k->quantity[i] = x;
    if (f >= 0)
        piecewise_at(k->function_shape + SHAPE * f, k->function_number, k->called[f], x,
                     k->quantity + i, k->quantity_slope + i, k->quantity_bend + i);
}

static void rate_quantity(Kernel *k, Int i, const Real *v)
{
    const Int kind = k->quantity_kind[i], *at = k->quantity_at + 2 * i;
    Real rate = v[at[1]], bias = 0.0;
    if (kind != COORDINATE) {
        rate = kind == ANGLE ? k->angle_rate[at[0]] : k->product_rate[at[0]];
        bias = kind == ANGLE ? k->angle_bias[at[0]] : k->product_bias[at[0]];
    }
    if (k->quantity_function[i] >= 0) {
        bias = k->quantity_slope[i] * bias + k->quantity_bend[i] * rate * rate;
        rate *= k->quantity_slope[i];
    }
    k->quantity_rate[i] = rate;
    k->quantity_bias[i] = bias;
}

static void add_angle_row(Kernel *k, Int angle, Real factor)
{
    const Int *of = k->angle_product + 2 * angle;
    const Real s = k->value[of[0]], c = k->value[of[1]], square = s * s + c * c;
    add_product_row(k, of[0], factor * c / square);
    add_product_row(k, of[1], -factor * s / square);
}

/* Add factor times the derivatives of a quantity to the scratch row over all freedoms. */
static void add_quantity_row(Kernel *k, Int i, Real factor)
{
    const Int kind = k->quantity_kind[i], *at = k->quantity_at + 2 * i;
    if (k->quantity_function[i] >= 0)
        factor *= k->quantity_slope[i];
    if (kind == COORDINATE) {
        k->row[at[1]] += factor * k->scale[at[1]];
    } else if (kind == OF_PRODUCT) {
        add_product_row(k, at[0], factor);
    } else {
        add_angle_row(k, at[0], factor);
    }
}

/* ---- sums: terms, each a number times quantities ---- */

/* A term's number times its quantities but two of them (-1: none). */
static Real product_without(const Kernel *k, Int term, Int one, Int other)
{
    Real product = k->term_number[term];
    for (Int i = k->factor_start[term]; i < k->factor_start[term + 1]; i++)
        if (i != one && i != other)
            product *= k->quantity[i];
    return product;
}

static void value_of_sum(Kernel *k, Int equation)
{
    Real sum = 0.0;
    for (Int t = k->term_start[equation]; t < k->term_start[equation + 1]; t++) {
        for (Int i = k->factor_start[t]; i < k->factor_start[t + 1]; i++)
            place_quantity(k, i);
        sum += product_without(k, t, -1, -1);
    }
    k->residual[equation] = sum;
}

static void jacobian_of_sum(Kernel *k, Int equation)
{
    for (Int t = k->term_start[equation]; t < k->term_start[equation + 1]; t++)
        for (Int i = k->factor_start[t]; i < k->factor_start[t + 1]; i++)
            add_quantity_row(k, i, product_without(k, t, i, -1));
    store_row(k, equation);
}

static void bias_of_sum(Kernel *k, Int equation, const Real *v)
{
    Real sum = 0.0;
    for (Int t = k->term_start[equation]; t < k->term_start[equation + 1]; t++) {
        const Int begin = k->factor_start[t], end = k->factor_start[t + 1];
        for (Int i = begin; i < end; i++)
            rate_quantity(k, i, v);
        for (Int i = begin; i < end; i++) {
            sum += product_without(k, t, i, -1) * k->quantity_bias[i];
            for (Int j = begin; j < end; j++)
                if (j != i)
                    sum += product_without(k, t, i, j) * k->quantity_rate[i] * k->quantity_rate[j];
        }
    }
    k->bias[equation] = sum;
}

/* ---- the kinds ---- */

static void value_of(Kernel *k, Int equation)
{
    if (k->equation_kind[equation] == PRODUCT)
        k->residual[equation] = k->value[k->equation_product[equation]];
    else if (k->equation_kind[equation] == SUM)
        value_of_sum(k, equation); /* an idle rotation has no value, only a rate */
}

static void jacobian_of(Kernel *k, Int equation)
{
    const Int kind = k->equation_kind[equation], product = k->equation_product[equation];
    Real force[3] = {0.0, 0.0, 0.0}, moment[3];
    if (kind == SUM) {
        jacobian_of_sum(k, equation);
        return;
    }
    if (kind == PRODUCT)
        product_wrench(k, product, force, moment);
    product_row(k, product, force, kind == PRODUCT ? moment : k->B + 3 * product,
                k->entry + k->entry_start[equation]);
}

static void bias_of(Kernel *k, Int equation, const Real *v)
{
    const Int kind = k->equation_kind[equation], product = k->equation_product[equation];
    if (kind == SUM) {
        bias_of_sum(k, equation, v);
    } else if (kind == PRODUCT) {
        k->bias[equation] = k->product_bias[product];
    } else {
        const Int body = k->vector_body[k->b_term[2 * product]];
        k->bias[equation] = dot3(k->B + 3 * product, k->alpha + 3 * body);
    }
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
    for (Int t = k->support_start[product]; t < k->support_start[product + 1]; t++) {
        while (e < end && k->entry_v[e] < k->support_v[t])
            e++;
        if (e == end || k->entry_v[e] != k->support_v[t])
            return 0;
    }
    return 1;
}

static int angle_is_sound(const Kernel *k, Int equation, Int angle)
{
    return within(angle, k->n_angles) && covers(k, equation, k->angle_product[2 * angle]) &&
           covers(k, equation, k->angle_product[2 * angle + 1]);
}

static int quantity_is_sound(const Kernel *k, Int equation, Int i)
{
    const Int kind = k->quantity_kind[i], *at = k->quantity_at + 2 * i;
    if (k->quantity_function[i] < -1 || k->quantity_function[i] >= k->n_functions ||
        !within(at[1], k->nv)) /* zero but of coordinates */
        return 0;
    if (kind == COORDINATE)
        return within(at[0], k->nq) && holds(k, equation, at[1]);
    if (kind == OF_PRODUCT)
        return within(at[0], k->n_products) && covers(k, equation, at[0]);
    return kind == ANGLE && angle_is_sound(k, equation, at[0]);
}

static int sum_is_sound(const Kernel *k, Int equation)
{
    for (Int t = k->term_start[equation]; t < k->term_start[equation + 1]; t++)
        for (Int i = k->factor_start[t]; i < k->factor_start[t + 1]; i++)
            if (!quantity_is_sound(k, equation, i))
                return 0;
    return 1;
}

static int equation_is_sound(const Kernel *k, Int i)
{
    const Int kind = k->equation_kind[i], product = k->equation_product[i];
    if (!within(kind, IDLE + 1) || (kind == IDLE) != (i >= k->n_closure))
        return 0;
    if (kind == SUM)
        return sum_is_sound(k, i);
    if (!within(product, k->n_products) || !covers(k, i, product))
        return 0;
    /* their entries are written in the support's order */
    const Int n = k->support_start[product + 1] - k->support_start[product];
    if (k->entry_start[i + 1] - k->entry_start[i] != n)
        return 0;
    return kind != IDLE || k->b_term[2 * product] >= 0;
}

/* Whether places that parts of arrays begin at do not descend, from 0. */
static int ascends(const Int *start, Int n)
{
    for (Int i = 0; i < n; i++)
        if (start[i] > start[i + 1])
            return 0;
    return start[0] == 0;
}

int equations_are_sound(const Kernel *k)
{
    const Int ne = k->n_equations;
    if (piecewise_size(k->function_shape, k->n_functions) < 0 || !ascends(k->term_start, ne) ||
        !ascends(k->factor_start, k->term_start[ne]))
        return 0;
    for (Int i = 0; i < 2 * k->n_angles; i++)
        if (!within(k->angle_product[i], k->n_products))
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
    memset(k->is_equation, OUTSIDE, (size_t)k->n_equations);
    memset(k->is_product, OUTSIDE, (size_t)k->n_products);
    for (Int i = 0; i < k->n_vectors; i++)
        k->is_vector[i] = k->vector_body[i] ? OUTSIDE : STANDING;
}

static void mark_vector(Kernel *k, Int i)
{
    if (i >= 0 && k->vector_body[i])
        k->is_vector[i] = INSIDE;
}

static void mark_product(Kernel *k, Int product)
{
    k->is_product[product] = INSIDE;
    mark_vector(k, k->x_term[product]);
    for (int t = 0; t < 2; t++) {
        mark_vector(k, k->a_term[2 * product + t]);
        mark_vector(k, k->b_term[2 * product + t]);
    }
}

/* Mark what an equation of the system is made of; products of angles are marked anyway. */
static void mark_equation(Kernel *k, Int i)
{
    k->is_equation[i] = INSIDE;
    if (k->equation_kind[i] != SUM) {
        mark_product(k, k->equation_product[i]);
        return;
    }
    const Int end = k->factor_start[k->term_start[i + 1]];
    for (Int x = k->factor_start[k->term_start[i]]; x < end; x++)
        if (k->quantity_kind[x] == OF_PRODUCT)
            mark_product(k, k->quantity_at[2 * x]);
}

static Int list(const char *mark, char wanted, Int n, Int *places)
{
    Int count = 0;
    for (Int i = 0; i < n; i++)
        if (mark[i] == wanted)
            places[count++] = i;
    return count;
}

/* List what is marked so. */
static void list_parts(const Kernel *k, char mark, Parts *of)
{
    of->n_equations = list(k->is_equation, mark, k->n_equations, of->equation);
    of->n_products = list(k->is_product, mark, k->n_products, of->product);
    of->n_vectors = list(k->is_vector, mark, k->n_vectors, of->vector);
}

void equations_of_system(Kernel *k)
{
    unmark(k);
    for (Int i = 0; i < k->n_chosen; i++)
        mark_equation(k, k->chosen[i]);
    for (Int i = 0; i < k->n_equations; i++)
        if (i >= k->n_closure)
            mark_equation(k, i);
    for (Int i = 0; i < 2 * k->n_angles; i++)
        mark_product(k, k->angle_product[i]);
    list_parts(k, INSIDE, &k->system);
    list_parts(k, OUTSIDE, &k->rest);
}

void equations_make_room(Kernel *k)
{
    Parts *const parts[] = {&k->all, &k->system, &k->rest};
    for (int i = 0; i < 3; i++) {
        parts[i]->equation = kernel_ints(k, k->n_equations);
        parts[i]->product = kernel_ints(k, k->n_products);
        parts[i]->vector = kernel_ints(k, k->n_vectors);
    }
    k->is_equation = kernel_memory(k, k->n_equations, 1);
    k->is_product = kernel_memory(k, k->n_products, 1);
    k->is_vector = kernel_memory(k, k->n_vectors, 1);
}

void equations_begin(Kernel *k)
{
    unmark(k);
    list_parts(k, OUTSIDE, &k->all);
    equations_place_ground(k);
}

/* ---- all equations ---- */

static inline void place_vector(Kernel *k, Int i)
{
    const Int body = k->vector_body[i];
    Real turned[3];
    rotate3(k->R + 9 * body, k->vector_local + 3 * i, turned);
    if (k->vector_flag[i])
        add3(1.0, k->p + 3 * body, turned);
    copy3(turned, k->vector + 3 * i);
}

void equations_place_ground(Kernel *k)
{
    for (Int i = 0; i < k->n_vectors; i++)
        if (!k->vector_body[i])
            place_vector(k, i);
}

void equations_residuals(Kernel *k, const Parts *of)
{
    for (Int i = 0; i < of->n_vectors; i++)
        place_vector(k, of->vector[i]);
    for (Int p = 0; p < of->n_products; p++) {
        const Int i = of->product[p];
        sum_of_terms(k->vector, k->a_term + 2 * i, k->a_factor + 2 * i, k->A + 3 * i);
        sum_of_terms(k->vector, k->b_term + 2 * i, k->b_factor + 2 * i, k->B + 3 * i);
        k->value[i] = dot3(k->A + 3 * i, k->B + 3 * i) - k->constant[i];
    }
    if (of != &k->rest)
        place_angles(k);
    for (Int e = 0; e < of->n_equations; e++)
        value_of(k, of->equation[e]);
}

void equations_values(Kernel *k, const Real *q)
{
    tree_place(k, q);
    equations_residuals(k, &k->all);
}

void equations_values_near(Kernel *k, const Real *q, const Real *reference)
{
    if (k->n_angles) /* else there may be no array */
        memmove(k->angle_reference, reference, (size_t)k->n_angles * sizeof *reference);
    equations_values(k, q);
}

void equations_angle_row(Kernel *k, Int angle, Real *row)
{
    add_angle_row(k, angle, 1.0);
    for (Int v = 0; v < k->nv; v++) {
        row[v] = k->row[v];
        k->row[v] = 0.0;
    }
}

void equations_close_turns(Kernel *k, const Real *q)
{
    equations_values(k, q);
    if (!k->n_angles)
        return;
    memcpy(k->angle_reference, k->angle, (size_t)k->n_angles * sizeof *k->angle);
    for (Int e = 0; e < k->n_closure; e++) {
        const Int end = k->term_start[e + 1];
        for (Int t = k->term_start[e]; t < end; t++) {
            const Int i = k->factor_start[t];
            if (i < k->factor_start[t + 1] && k->quantity_kind[i] == ANGLE &&
                k->quantity_function[i] < 0) {
                const Real slope = product_without(k, t, i, -1);
                k->angle_reference[k->quantity_at[2 * i]] -=
                    slope != 0.0 ? k->residual[e] / slope : 0.0;
                break; /* one angle of an equation closes it */
            }
        }
    }
    equations_values(k, q);
}

void equations_jacobian(Kernel *k, const Parts *of)
{
    tree_columns(k);
    for (Int e = 0; e < of->n_equations; e++)
        jacobian_of(k, of->equation[e]);
}

/* First and second derivatives of the vectors, without those of the joint velocities. */
static void vector_rates(Kernel *k, const Parts *of)
{
    for (Int at = 0; at < of->n_vectors; at++) {
        const Int i = of->vector[at];
        const Int body = 3 * k->vector_body[i];
        Real arm[3], more[3], rate[3], bias[3];
        rotate3(k->R + 3 * body, k->vector_local + 3 * i, arm);
        cross3(k->omega + body, arm, rate);
        cross3(k->omega + body, rate, bias);
        cross3(k->alpha + body, arm, more);
        add3(1.0, more, bias);
        if (k->vector_flag[i]) {
            add3(1.0, k->velocity + body, rate);
            add3(1.0, k->acceleration + body, bias);
        }
        copy3(rate, k->vector_rate + 3 * i);
        copy3(bias, k->vector_bias + 3 * i);
    }
}

void equations_bias(Kernel *k, const Parts *of, const Real *v)
{
    tree_rates(k, v);
    vector_rates(k, of);
    for (Int p = 0; p < of->n_products; p++) {
        const Int i = of->product[p];
        const Real *A = k->A + 3 * i, *B = k->B + 3 * i;
        Real dA[3], dB[3], ddA[3], ddB[3];
        sum_of_terms(k->vector_rate, k->a_term + 2 * i, k->a_factor + 2 * i, dA);
        sum_of_terms(k->vector_rate, k->b_term + 2 * i, k->b_factor + 2 * i, dB);
        sum_of_terms(k->vector_bias, k->a_term + 2 * i, k->a_factor + 2 * i, ddA);
        sum_of_terms(k->vector_bias, k->b_term + 2 * i, k->b_factor + 2 * i, ddB);
        k->product_rate[i] = dot3(dA, B) + dot3(A, dB);
        k->product_bias[i] = dot3(ddA, B) + 2.0 * dot3(dA, dB) + dot3(A, ddB);
    }
    if (of != &k->rest)
        angle_rates(k);
    for (Int e = 0; e < of->n_equations; e++)
        bias_of(k, of->equation[e], v);
}

Real equations_error(const Kernel *k)
{
    return largest(k->residual, k->n_closure);
}
