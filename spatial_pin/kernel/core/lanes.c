/* Configurations side by side: the formulas of tree.c, sums.c, equations.c and system.c, compiled once
 * more. No branch depends on a number. */
#include <string.h>

#include "lanes.h"
#include "memory.h"
#include "side_by_side.h"

/* ---- sine and cosine ---- */

#define MOST_TURNED 1e5 /* angle up to which the reduction below is exact */

/* Both of an angle, by its nearest multiple of pi / 2 in two parts, the first of which has 33 bits, and the
   polynomials of least error of fdlibm [Ng1992]. */
WITHIN void lanes_sine_and_cosine(Lane angle, Lane *sine, Lane *cosine)
{
    static const Real whole = 6755399441055744.0; /* 1.5 * 2^52: what is added to it is rounded */
    const Lane n = (angle * 6.36619772367581382433e-01 + whole) - whole;
    const Lane x = (angle - n * 1.57079632673412561417e+00) - n * 6.07710050650619224932e-11;
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
        if (!(fabs(angle[l]) < MOST_TURNED))
            (*sine)[l] = sin(angle[l]), (*cosine)[l] = cos(angle[l]);
}

/* ---- formulas ---- */

#define sine_and_cosine lanes_sine_and_cosine
#define tree_place lanes_tree_place
#define tree_columns lanes_tree_columns
#define tree_rates lanes_tree_rates
#define tree_normalize lanes_tree_normalize
#include "tree.c"

#define product_wrench lanes_product_wrench
#define angles_place lanes_angles_place
#define angles_rates lanes_angles_rates
#define product_without lanes_product_without
#define sum_value lanes_sum_value
#define sum_add_row lanes_sum_add_row
#define sum_rates lanes_sum_rates
#define is_one_of lanes_is_one_of
#include "sums.c"

#define equations_place_ground lanes_equations_place_ground
#define equations_residuals lanes_equations_residuals
#define equations_jacobian lanes_equations_jacobian
#define equations_bias lanes_equations_bias
#include "equations.c"

#define driven_at lanes_driven_at
#define system_solve lanes_solve
#define system_put_rates lanes_system_put_rates
#define system_add_bias lanes_system_add_bias
#define system_put_accelerations lanes_system_put_accelerations
#define system_path_rates lanes_system_path_rates
#include "system.c"

FOR_WIDE void lanes_residuals(Abreast *s, const Parts *of)
{
    if (of != &s->k->equations.rest)
        tree_place(s, s->next);
    equations_residuals(s, of);
}

FOR_WIDE int lanes_factor(Abreast *s)
{
    equations_jacobian(s, &s->k->equations.system);
    put_values(s, s->matrix);
    return lu_factor_lanes(s->k->system.lu, s->matrix, &s->factors);
}

void lanes_solve(const Abreast *s, Lane *x) { lu_solve_lanes(s->k->system.lu, &s->factors, x); }

FOR_WIDE void lanes_path_rates(Abreast *s, Lane *squares)
{
    const Lane *rate = s->prescribed + s->k->system.n_driven;
    system_path_rates(s, rate, rate + s->k->system.n_driven, s->t, s->c, squares);
}

FOR_WIDE void lanes_normalize(Abreast *s) { tree_normalize(s->k, s->next); }

FOR_WIDE void lanes_move(Abreast *s)
{
    const Kernel *k = s->k;
    for (Int j = 1; j < k->n_joints; j++) {
        Lane *x = s->next + k->iq[j], *w = s->right + k->iv[j], R[9], slide[3], change[4];
        if (k->kind[j] < BALL) {
            x[0] += w[0];
            continue;
        }
        if (k->kind[j] == FREE) {
            quaternion_rotation(x + 3, R);
            rotate3(R, w, slide);
            add3(1.0, slide, x);
            x += 3, w += 3;
        }
        times_pure(x, w, change);
        for (int i = 0; i < 4; i++)
            x[i] += 0.5 * change[i];
    }
    tree_normalize(k, s->next);
}

/* ---- room ---- */

WITHIN void spread(const Real *from, Int n, Lane *to)
{
    for (Int i = 0; i < n; i++)
        to[i] = SPREAD(from[i]);
}

void lanes_begin(Abreast *s)
{
    const Kernel *k = s->k;
    spread(k->rotation, 9 * k->n_joints, s->rotation);
    spread(k->translation, 3 * k->n_joints, s->translation);
    spread(k->vectors.local, 3 * k->vectors.n, s->vectors.local);
    spread(k->R, 9, s->R); /* the ground */
    for (Int f = 0; f < k->quantities.n_functions; f++)
        s->quantities.last[4 * f] = SPREAD(NAN);
    s->is_placed = 0;
    equations_place_ground(s);
}

#define make_room_of lanes_make_room_of
#include "evaluated.h"

Abreast *lanes_of(Kernel *k)
{
    const Int n = k->n_joints, nv = k->nv;
    Abreast *s = k->memory.lanes;
    if (s || !(s = kernel_memory(k, 1, sizeof *s)))
        return s;
    struct {
        Lane **to;
        Int count;
    } fields[] = {
        {&s->rotation, 9 * n}, {&s->translation, 3 * n}, {&s->vectors.local, 3 * k->vectors.n},
        {&s->matrix, k->entry_start[k->n_equations] + 3 * nv}, {&s->next, k->nq}, {&s->t, nv}, {&s->c, nv},
        {&s->prescribed, 3 * nv},
    };
    make_room_of(k, s);
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        *fields[i].to = kernel_memory(k, fields[i].count, sizeof(Lane));
    s->k = k;
    return k->memory.lanes = kernel_had_memory(k) ? s : NULL;
}
