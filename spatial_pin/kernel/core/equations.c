/* Closure equations: value, Jacobian and second derivative of each kind, one entry a kind.
 *
 * Most equations are products A . B - c of vectors that are fixed in bodies, or differences of
 * such. With f = force * B and m = X x B the wrench of the product about the world origin, its
 * derivative for a freedom with the twist (l, w) of one body relative to the other is
 * sign * (f . l + m . w); its second derivative at zero joint acceleration is
 * A'' . B + 2 A' . B' + A . B'' . */
#include <string.h>

#include "kernel.h"

/* Of the four integers of an equation the first are products, then come the (q, v) of joint
 * coordinates, then the angle that counts turns. Kinds are numbered as in Python's table
 * (constraints/kinds.py): add one entry here and one there. */
typedef struct {
    int n_products, n_coordinates, n_angles;
    void (*value)(Kernel *k, Int equation, const Int *of, const Real *by);
    void (*jacobian)(Kernel *k, Int equation, const Int *of, const Real *by);
    void (*bias)(Kernel *k, Int equation, const Int *of, const Real *by);
} EquationTable;

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

/* ---- the kinds ---- */

static void value_of_product(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)by;
    k->residual[equation] = k->value[of[0]];
}

static void jacobian_of_product(Kernel *k, Int equation, const Int *of, const Real *by)
{
    Real force[3], moment[3];
    (void)by;
    product_wrench(k, of[0], force, moment);
    product_row(k, of[0], force, moment, k->entry + k->entry_start[equation]);
}

static void bias_of_product(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)by;
    k->bias[equation] = k->product_bias[of[0]];
}

/* What an angle is nearest to: coordinates tell how often it has turned, or else the reference does. */
static Real near_angle(const Kernel *k, Int angle)
{
    const Int begin = k->spin_start[angle], end = k->spin_start[angle + 1];
    Real near = begin < end ? k->spin_offset[angle] : k->angle_reference[angle];
    for (Int i = begin; i < end; i++)
        near += k->spin_sign[i] * k->q[k->spin_q[i]];
    return near;
}

/* of: product, products of sine and cosine, angle; by: pitch */
static void value_of_screw(Kernel *k, Int equation, const Int *of, const Real *by)
{
    const Real around = 2.0 * PI;
    Real angle = atan2(k->value[of[1]], k->value[of[2]]);
    angle += around * nearbyint((near_angle(k, of[3]) - angle) / around);
    k->angle[of[3]] = angle;
    k->residual[equation] = k->value[of[0]] - by[0] * angle;
}

static void jacobian_of_screw(Kernel *k, Int equation, const Int *of, const Real *by)
{
    const Real s = k->value[of[1]], c = k->value[of[2]], square = s * s + c * c;
    add_product_row(k, of[0], 1.0);
    add_product_row(k, of[1], -by[0] * c / square);
    add_product_row(k, of[2], by[0] * s / square);
    store_row(k, equation);
}

static void bias_of_screw(Kernel *k, Int equation, const Int *of, const Real *by)
{
    const Real s = k->value[of[1]], c = k->value[of[2]], n = s * s + c * c;
    const Real ds = k->product_rate[of[1]], dc = k->product_rate[of[2]];
    const Real dds = k->product_bias[of[1]], ddc = k->product_bias[of[2]];
    const Real rate = (c * ds - s * dc) / n;
    const Real angle = (c * dds - s * ddc) / n - 2.0 * rate * (c * dc + s * ds) / n;
    k->angle_rate[of[3]] = rate;
    k->bias[equation] = k->product_bias[of[0]] - by[0] * angle;
}

static void value_of_difference(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)by;
    k->residual[equation] = k->value[of[0]] - k->value[of[1]];
}

static void jacobian_of_difference(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)by;
    add_product_row(k, of[0], 1.0);
    add_product_row(k, of[1], -1.0);
    store_row(k, equation);
}

static void bias_of_difference(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)by;
    k->bias[equation] = k->product_bias[of[0]] - k->product_bias[of[1]];
}

/* of: entries (q, v) of a and of b; by: unit, ratio, offset */
static void value_of_coupling(Kernel *k, Int equation, const Int *of, const Real *by)
{
    k->residual[equation] = by[0] * (k->q[of[2]] - by[1] * k->q[of[0]] - by[2]);
}

static void jacobian_of_coupling(Kernel *k, Int equation, const Int *of, const Real *by)
{
    k->row[of[1]] -= by[0] * by[1] * k->scale[of[1]];
    k->row[of[3]] += by[0] * k->scale[of[3]];
    store_row(k, equation);
}

static void bias_of_coupling(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)of;
    (void)by;
    k->bias[equation] = 0.0;
}

/* of: product whose B is the line; it has no value, only a rate */
static void value_of_idle(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)k;
    (void)equation;
    (void)of;
    (void)by;
}

static void jacobian_of_idle(Kernel *k, Int equation, const Int *of, const Real *by)
{
    const Real none[3] = {0.0, 0.0, 0.0};
    (void)by;
    product_row(k, of[0], none, k->B + 3 * of[0], k->entry + k->entry_start[equation]);
}

static void bias_of_idle(Kernel *k, Int equation, const Int *of, const Real *by)
{
    (void)by;
    const Int body = k->vector_body[k->b_term[2 * of[0]]];
    k->bias[equation] = dot3(k->B + 3 * of[0], k->alpha + 3 * body);
}

static const EquationTable TABLE[] = {
    [PRODUCT] = {1, 0, 0, value_of_product, jacobian_of_product, bias_of_product},
    [SCREW_ANGLE] = {3, 0, 1, value_of_screw, jacobian_of_screw, bias_of_screw},
    [DIFFERENCE] = {2, 0, 0, value_of_difference, jacobian_of_difference, bias_of_difference},
    [COUPLING] = {0, 2, 0, value_of_coupling, jacobian_of_coupling, bias_of_coupling},
    [IDLE] = {1, 0, 0, value_of_idle, jacobian_of_idle, bias_of_idle},
};

#define N_KINDS ((Int)(sizeof TABLE / sizeof *TABLE))

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

static int equation_is_sound(const Kernel *k, Int i)
{
    const Int kind = k->equation_kind[i], *of = k->equation_int + 4 * i;
    if (!within(kind, N_KINDS) || (kind == IDLE) != (i >= k->n_closure))
        return 0;
    const EquationTable *entry = TABLE + kind;
    for (int p = 0; p < entry->n_products; p++, of++)
        if (!within(of[0], k->n_products) || !covers(k, i, of[0]))
            return 0;
    for (int c = 0; c < entry->n_coordinates; c++, of += 2)
        if (!within(of[0], k->nq) || !within(of[1], k->nv) || !holds(k, i, of[1]))
            return 0;
    for (int a = 0; a < entry->n_angles; a++, of++)
        if (!within(of[0], k->n_angles))
            return 0;
    of = k->equation_int + 4 * i;
    if (kind == PRODUCT || kind == IDLE) { /* their entries are written in the support's order */
        const Int n = k->support_start[of[0] + 1] - k->support_start[of[0]];
        if (k->entry_start[i + 1] - k->entry_start[i] != n)
            return 0;
    }
    return kind != IDLE || k->b_term[2 * of[0]] >= 0;
}

int equations_are_sound(const Kernel *k)
{
    if (k->n_angles > k->n_closure) /* each is of an equation */
        return 0;
    for (Int i = 0; i < k->n_equations; i++)
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

/* Mark what an equation of the system is made of. */
static void mark_equation(Kernel *k, Int i)
{
    k->is_equation[i] = INSIDE;
    for (int p = 0; p < TABLE[k->equation_kind[i]].n_products; p++) {
        const Int product = k->equation_int[4 * i + p];
        k->is_product[product] = INSIDE;
        mark_vector(k, k->x_term[product]);
        for (int t = 0; t < 2; t++) {
            mark_vector(k, k->a_term[2 * product + t]);
            mark_vector(k, k->b_term[2 * product + t]);
        }
    }
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
        if (i >= k->n_closure || TABLE[k->equation_kind[i]].n_angles)
            mark_equation(k, i);
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
    for (Int e = 0; e < of->n_equations; e++) {
        const Int i = of->equation[e];
        TABLE[k->equation_kind[i]].value(k, i, k->equation_int + 4 * i, k->equation_real + 3 * i);
    }
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

void equations_jacobian(Kernel *k, const Parts *of)
{
    tree_columns(k);
    for (Int e = 0; e < of->n_equations; e++) {
        const Int i = of->equation[e];
        TABLE[k->equation_kind[i]].jacobian(k, i, k->equation_int + 4 * i,
                                            k->equation_real + 3 * i);
    }
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
    for (Int e = 0; e < of->n_equations; e++) {
        const Int i = of->equation[e];
        TABLE[k->equation_kind[i]].bias(k, i, k->equation_int + 4 * i, k->equation_real + 3 * i);
    }
}

Real equations_error(const Kernel *k)
{
    return largest(k->residual, k->n_closure);
}
