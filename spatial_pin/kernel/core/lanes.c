/* Configurations side by side: placements, equations, their derivatives and the square system.
 *
 * The formulas are those of tree.c, equations.c and system.c, where they are explained; no branch depends
 * on a number. */
#include <string.h>

#include "lanes.h"
#include "memory.h"

/* ---- sine and cosine ---- */

#define MOST_TURNED 1e5 /* angle up to which the reduction below is exact */

/* Both of an angle, by its nearest multiple of pi / 2 in two parts, the first of which has 33 bits, and the
   polynomials of least error of fdlibm [Ng1992]. */
WITHIN void sine_and_cosine(const Lane *angle, Lane *sine, Lane *cosine)
{
    static const Real whole = 6755399441055744.0; /* 1.5 * 2^52: what is added to it is rounded */
    const Lane n = (*angle * 6.36619772367581382433e-01 + whole) - whole;
    const Lane x = (*angle - n * 1.57079632673412561417e+00) - n * 6.07710050650619224932e-11;
    const Lane z = x * x, half = 0.5 * z, w = 1.0 - half;
    const Lane s = x + z * x * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z *
        (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z *
        (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    const Lane c = w + (((1.0 - w) - half) + z * z * (4.16666666666666019037e-02 + z *
        (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z *
        (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z *
        -1.13596475577881948265e-11))))));
    /* cosine and sine of these quarters of a turn, which are whole numbers: no branch, and no rounding */
    const Lane part = 0.25 * n - ((0.25 * n + whole) - whole), square = 16.0 * part * part;
    const Lane is_odd = square * (4.0 - square) * (1.0 / 3.0), is_half = square * (square - 1.0) * (1.0 / 12.0);
    const Lane cosine_of = 1.0 - is_odd - 2.0 * is_half, sine_of = 4.0 * part * is_odd;
    *sine = cosine_of * s + sine_of * c;
    *cosine = cosine_of * c - sine_of * s;
    for (int l = 0; l < LANES; l++)
        if (!(fabs((*angle)[l]) < MOST_TURNED))
            (*sine)[l] = sin((*angle)[l]), (*cosine)[l] = cos((*angle)[l]);
}

/* ---- vectors of three ---- */

WITHIN void put3(const Real *x, Lane *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = (Lane){0} + x[i];
}

WITHIN void sum3(const Lane *x, Lane *out)
{
    for (int i = 0; i < 3; i++)
        out[i] += x[i];
}

WITHIN void multiple3(const Lane *factor, const Lane *x, Lane *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = *factor * x[i];
}

WITHIN void cross(const Lane *a, const Lane *b, Lane *out)
{
    const Lane x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
    out[0] = x, out[1] = y;
}

/* out += a x b */
WITHIN void add_cross(const Lane *a, const Lane *b, Lane *out)
{
    Lane x[3];
    cross(a, b, x);
    sum3(x, out);
}

/* out = R v, of a vector of numbers, and of one of lanes */
WITHIN void turned_numbers(const Lane *R, const Real *v, Lane *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}

WITHIN void turned(const Lane *R, const Lane *v, Lane *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}

/* ---- the tree ---- */

WITHIN void rotation_of(const Lane *quaternion, Lane *R)
{
    const Lane x = quaternion[0], y = quaternion[1], z = quaternion[2], w = quaternion[3];
    const Lane xx = 2.0 * x * x, yy = 2.0 * y * y, zz = 2.0 * z * z;
    const Lane xy = 2.0 * x * y, xz = 2.0 * x * z, yz = 2.0 * y * z;
    const Lane wx = 2.0 * w * x, wy = 2.0 * w * y, wz = 2.0 * w * z;
    R[0] = 1.0 - yy - zz, R[1] = xy + wz, R[2] = xz - wy;
    R[3] = xy - wz, R[4] = 1.0 - xx - zz, R[5] = yz + wx;
    R[6] = xz + wy, R[7] = yz - wx, R[8] = 1.0 - xx - yy;
}

WITHIN const Lane *fixed_placement(const Kernel *k, const Abreast *s, Int j, Lane *p, Lane *own)
{
    const Int up = k->parent[j];
    const Lane *parent = s->R + 9 * up;
    if (up == 0)
        put3(k->translation + 3 * j, p);
    else {
        turned_numbers(parent, k->translation + 3 * j, p);
        sum3(s->p + 3 * up, p);
        if (k->plain[j])
            return parent;
    }
    for (int c = 0; c < 3; c++)
        if (up == 0)
            put3(k->rotation + 9 * j + 3 * c, own + 3 * c);
        else
            turned_numbers(parent, k->rotation + 9 * j + 3 * c, own + 3 * c);
    return own;
}

WITHIN void place_joint(const Kernel *k, Abreast *s, Int j)
{
    const Lane *x = s->q + k->iq[j];
    Lane *R = s->R + 9 * j, *p = s->p + 3 * j, own[9], free[9], sine, cosine, slide;
    const Lane *fixed = fixed_placement(k, s, j, p, own);
    switch (k->kind[j]) {
    case SLIDE:
        memcpy(R, fixed, 9 * sizeof *R);
        break;
    case TURN:
    case SCREW:
        sine_and_cosine(x, &sine, &cosine);
        for (int i = 0; i < 3; i++) {
            R[i] = cosine * fixed[i] + sine * fixed[3 + i];
            R[3 + i] = cosine * fixed[3 + i] - sine * fixed[i];
            R[6 + i] = fixed[6 + i];
        }
        break;
    case FREE:
        for (int i = 0; i < 3; i++)
            p[i] += x[0] * fixed[i] + x[1] * fixed[3 + i] + x[2] * fixed[6 + i];
        x += 3;
        /* fall through */
    default:
        rotation_of(x, free);
        for (int c = 0; c < 3; c++)
            turned(fixed, free + 3 * c, R + 3 * c);
    }
    if (k->kind[j] == SLIDE || k->kind[j] == SCREW) {
        slide = k->pitch[j] * x[0];
        for (int i = 0; i < 3; i++)
            p[i] += slide * R[6 + i];
    }
}

WITHIN void place_columns(const Kernel *k, Abreast *s)
{
    for (Int j = 1; j < k->n_joints; j++) {
        const Lane *R = s->R + 9 * j, *p = s->p + 3 * j;
        Lane *linear = s->linear + 3 * k->iv[j], *angular = s->angular + 3 * k->iv[j];
        const Int kind = k->kind[j], first = kind >= BALL ? 0 : 2;
        if (kind == FREE) {
            memcpy(linear, R, 9 * sizeof *R);
            linear += 9, angular += 9;
        }
        for (Int c = first; c < 3 && kind != SLIDE; c++) {
            memcpy(angular + 3 * (c - first), R + 3 * c, 3 * sizeof *R);
            cross(p, R + 3 * c, linear + 3 * (c - first));
        }
        for (int i = 0; i < 3 && (kind == SLIDE || kind == SCREW); i++)
            linear[i] = k->pitch[j] * R[6 + i] + (kind == SLIDE ? (Lane){0} : linear[i]);
    }
}

WITHIN void joint_rate(const Kernel *k, const Abreast *s, Int j, Lane *slide, Lane *turn)
{
    const Lane *R = s->R + 9 * j, *x = s->t + k->iv[j];
    const Int kind = k->kind[j];
    const Lane none = {0}, sliding = kind == SLIDE || kind == SCREW ? k->pitch[j] * x[0] : none;
    const Lane turning = kind == SLIDE ? none : x[0];
    if (kind < BALL) {
        multiple3(&sliding, R + 6, slide);
        multiple3(&turning, R + 6, turn);
        return;
    }
    slide[0] = slide[1] = slide[2] = none;
    if (kind == FREE)
        turned(R, x, slide);
    turned(R, x + (kind == FREE ? 3 : 0), turn);
}

WITHIN void tree_rates_of(const Kernel *k, Abreast *s)
{
    for (Int j = 1; j < k->n_joints; j++) {
        const Int up = 3 * k->parent[j], at = 3 * j;
        Lane arm[3], swing[3], slide[3], turn[3];
        Lane *omega = s->omega + at, *velocity = s->velocity + at;
        Lane *alpha = s->alpha + at, *acceleration = s->acceleration + at;
        joint_rate(k, s, j, slide, turn);
        if (up == 0) {
            memcpy(velocity, slide, sizeof slide);
            memcpy(omega, turn, sizeof turn);
            cross(turn, slide, acceleration);
            alpha[0] = alpha[1] = alpha[2] = (Lane){0};
            continue;
        }
        for (int i = 0; i < 3; i++)
            arm[i] = s->p[at + i] - s->p[up + i];
        cross(s->omega + up, arm, swing);
        cross(s->omega + up, turn, alpha);
        sum3(s->alpha + up, alpha);
        for (int i = 0; i < 3; i++) {
            omega[i] = s->omega[up + i] + turn[i];
            velocity[i] = s->velocity[up + i] + swing[i] + slide[i];
            acceleration[i] = s->acceleration[up + i];
            swing[i] += slide[i];
        }
        add_cross(s->alpha + up, arm, acceleration);
        add_cross(s->omega + up, swing, acceleration);
        if (k->kind[j] != TURN)
            add_cross(omega, slide, acceleration);
    }
}

FOR_WIDE void lanes_normalize(const Kernel *k, Abreast *s)
{
    for (Int j = 1; j < k->n_joints; j++) {
        Lane *x = s->q + k->iq[j] + (k->kind[j] == FREE ? 3 : 0), size;
        if (k->kind[j] < BALL)
            continue;
        size = x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3];
        for (int l = 0; l < LANES; l++)
            size[l] = sqrt(size[l]);
        for (int i = 0; i < 4; i++)
            x[i] /= size;
    }
}

FOR_WIDE void lanes_move(const Kernel *k, Abreast *s)
{
    for (Int j = 1; j < k->n_joints; j++) {
        Lane *x = s->q + k->iq[j], *w = s->right + k->iv[j], R[9], slide[3], change[4];
        if (k->kind[j] < BALL) {
            x[0] += w[0];
            continue;
        }
        if (k->kind[j] == FREE) {
            rotation_of(x + 3, R);
            turned(R, w, slide);
            sum3(slide, x);
            x += 3, w += 3;
        }
        cross(x, w, change);
        for (int i = 0; i < 3; i++)
            change[i] += x[3] * w[i];
        change[3] = -(x[0] * w[0] + x[1] * w[1] + x[2] * w[2]);
        for (int i = 0; i < 4; i++)
            x[i] += 0.5 * change[i];
    }
    lanes_normalize(k, s);
}

/* ---- equations ---- */

WITHIN void sum_of_terms(const Lane *vectors, const Int *term, const Real *factor, Lane *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = term[0] >= 0 ? factor[0] * vectors[3 * term[0] + i] : (Lane){0};
    for (int i = 0; i < 3 && term[1] >= 0; i++)
        out[i] += factor[1] * vectors[3 * term[1] + i];
}

FOR_WIDE void lanes_residuals(const Kernel *k, Abreast *s, const Parts *of, int all)
{
    const Products *products = &k->products;
    for (Int j = 1; j < k->n_joints && of != &k->equations.rest; j++)
        if (all || !s->stands[j])
            place_joint(k, s, j);
    for (Int x = 0; x < of->n_vectors; x++) {
        const Int i = of->vector[x], body = k->vectors.body[i];
        turned_numbers(s->R + 9 * body, k->vectors.local + 3 * i, s->vector + 3 * i);
        if (k->vectors.flag[i])
            sum3(s->p + 3 * body, s->vector + 3 * i);
    }
    for (Int x = 0; x < of->n_products; x++) {
        const Int i = of->product[x];
        sum_of_terms(s->vector, products->a_term + 2 * i, products->a_factor + 2 * i, s->A + 3 * i);
        sum_of_terms(s->vector, products->b_term + 2 * i, products->b_factor + 2 * i, s->B + 3 * i);
    }
    for (Int x = 0; x < of->n_equations; x++) {
        const Int i = k->equations.product[of->equation[x]];
        const Lane *A = s->A + 3 * i, *B = s->B + 3 * i;
        s->residual[of->equation[x]] =
            A[0] * B[0] + A[1] * B[1] + A[2] * B[2] - products->constant[i];
    }
}

WITHIN Lane *product_row(const Kernel *k, const Abreast *s, Int i, Lane *to)
{
    const Lane *B = s->B + 3 * i;
    const Int x = k->products.x_term[i];
    Lane moment[3] = {{0}, {0}, {0}};
    if (x >= 0) {
        cross(s->vector + 3 * x, B, moment);
        for (int c = 0; c < 3; c++)
            moment[c] *= k->products.x_factor[i];
    }
    for (Int e = k->products.support_start[i]; e < k->products.support_start[i + 1]; e++) {
        const Lane *l = s->linear + 3 * k->products.support_v[e];
        const Lane *w = s->angular + 3 * k->products.support_v[e];
        *to++ = k->products.support_sign[e] *
                (k->products.force[i] * (B[0] * l[0] + B[1] * l[1] + B[2] * l[2]) +
                 (moment[0] * w[0] + moment[1] * w[1] + moment[2] * w[2]));
    }
    return to;
}

FOR_WIDE void lanes_bias(const Kernel *k, Abreast *s)
{
    const Parts *of = &k->equations.system;
    const Products *products = &k->products;
    tree_rates_of(k, s);
    for (Int x = 0; x < of->n_vectors; x++) {
        const Int i = 3 * of->vector[x], body = 3 * k->vectors.body[of->vector[x]];
        const Int is_point = k->vectors.flag[of->vector[x]];
        Lane arm[3];
        for (int c = 0; c < 3; c++)
            arm[c] = is_point ? s->vector[i + c] - s->p[body + c] : s->vector[i + c];
        cross(s->omega + body, arm, s->rate + i);
        cross(s->omega + body, s->rate + i, s->bias + i);
        add_cross(s->alpha + body, arm, s->bias + i);
        if (is_point) {
            sum3(s->velocity + body, s->rate + i);
            sum3(s->acceleration + body, s->bias + i);
        }
    }
    for (Int x = 0; x < of->n_equations; x++) {
        const Int i = k->equations.product[of->equation[x]];
        const Int *a = products->a_term + 2 * i, *b = products->b_term + 2 * i;
        const Real *fa = products->a_factor + 2 * i, *fb = products->b_factor + 2 * i;
        const Lane *A = s->A + 3 * i, *B = s->B + 3 * i;
        Lane dA[3], dB[3], ddA[3], ddB[3], sum = {0};
        sum_of_terms(s->rate, a, fa, dA);
        sum_of_terms(s->rate, b, fb, dB);
        sum_of_terms(s->bias, a, fa, ddA);
        sum_of_terms(s->bias, b, fb, ddB);
        for (int c = 0; c < 3; c++)
            sum += ddA[c] * B[c] + 2.0 * dA[c] * dB[c] + A[c] * ddB[c];
        s->equation_bias[of->equation[x]] = sum;
    }
}

/* ---- the square system ---- */

FOR_WIDE int lanes_factor(const Kernel *k, Abreast *s)
{
    const Entries *matrix = &k->system.matrix;
    Lane *to = s->entry;
    place_columns(k, s);
    for (Int i = 0; i < k->system.n_chosen; i++)
        to = product_row(k, s, k->equations.product[k->system.chosen[i]], to);
    for (Int e = to - s->entry; e < matrix->n; e++)
        s->entry[e] = (Lane){0} + matrix->value[e];
    return lu_factor_lanes(k->system.lu, s->entry, &s->factors);
}

void lanes_solve(const Kernel *k, Abreast *s)
{
    lu_solve_lanes(k->system.lu, &s->factors, s->right);
}

/* ---- room ---- */

int lanes_know(const Kernel *k)
{
    if (k->n_angles || k->n_idle || k->system.n_fill || k->system.n_pins)
        return 0;
    for (Int i = 0; i < k->n_closure; i++)
        if (k->equations.kind[i] != PRODUCT)
            return 0;
    return 1;
}

void lanes_begin(const Kernel *k, Abreast *s)
{
    s->stands[0] = 1;
    for (Int j = 1; j < k->n_joints; j++) {
        s->stands[j] = 0;
        for (Int i = 0; i < k->system.n_driven; i++)
            if (k->system.driven[i] == k->iv[j] && joint_nv(k->kind[j]) == 1)
                s->stands[j] = s->stands[k->parent[j]];
    }
    for (Int i = 0; i < k->vectors.n; i++)
        if (!k->vectors.body[i])
            put3(k->vectors.value + 3 * i, s->vector + 3 * i);
}

Abreast *lanes_of(Kernel *k)
{
    const Int n = k->n_joints, nv = k->nv, np = k->products.n, vectors = 3 * k->vectors.n;
    Abreast *s = k->memory.lanes;
    if (s || !(s = kernel_memory(k, 1, sizeof *s)))
        return s;
    struct {
        Lane **to;
        Int count;
    } fields[] = {
        {&s->q, k->nq}, {&s->R, 9 * n}, {&s->p, 3 * n}, {&s->linear, 3 * nv}, {&s->angular, 3 * nv},
        {&s->omega, 3 * n}, {&s->velocity, 3 * n}, {&s->alpha, 3 * n}, {&s->acceleration, 3 * n},
        {&s->vector, vectors}, {&s->rate, vectors}, {&s->bias, vectors}, {&s->A, 3 * np},
        {&s->B, 3 * np}, {&s->residual, k->n_closure}, {&s->equation_bias, k->n_closure},
        {&s->entry, k->entry_start[k->n_equations] + 3 * nv}, {&s->right, nv}, {&s->t, nv}, {&s->c, nv},
        {&s->prescribed, 3 * nv},
    };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        *fields[i].to = kernel_memory(k, fields[i].count, sizeof(Lane));
    s->stands = kernel_ints(k, n);
    return k->memory.lanes = kernel_had_memory(k) ? s : NULL;
}
