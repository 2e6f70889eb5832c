/* What configurations give, copied out. */
#include <string.h>

#include "kernel.h"

static void copy_out(Real *out, const Real *from, Int row, Int n)
{
    if (out)
        memcpy(out + row * n, from, (size_t)n * sizeof *out);
}

/* The dense Jacobians of equations and angles, where they are evaluated. */
static void put_jacobian(Kernel *k, Real *jacobian)
{
    memset(jacobian, 0, (size_t)((k->n_equations + k->n_angles) * k->nv) * sizeof *jacobian);
    for (Int i = 0; i < k->n_equations; i++)
        for (Int e = k->entry_start[i]; e < k->entry_start[i + 1]; e++)
            jacobian[i * k->nv + k->entry_v[e]] = k->entry[e];
    for (Int i = 0; i < k->n_angles; i++)
        equations_angle_row(k, i, jacobian + (k->n_equations + i) * k->nv);
}

static int numbers_are_sound(const Evaluation *e)
{
    for (Int i = 0; i < e->n_varied; i++)
        if (!within(e->varied_index[i], e->n_reals))
            return 0;
    return 1;
}

EXPORT int kernel_evaluate(Kernel *k, const Evaluation *e)
{
    const Int size = (k->n_equations + k->n_angles) * k->nv;
    int finite = 1;
    if (e->base && !numbers_are_sound(e))
        return BAD_ARRAYS;
    for (Int i = 0; i < e->m; i++) {
        const int code = e->base ? kernel_vary_numbers(k, e->base, e->n_reals, e->varied_index,
                                                       e->varied + i * e->n_varied, e->n_varied)
                                 : DONE;
        if (code != DONE)
            return code;
        equations_values_near(k, e->q + i * k->nq, e->reference + i * k->n_angles);
        finite = finite && isfinite(equations_error(k));
        copy_out(e->R, k->R, i, 9 * k->n_joints);
        copy_out(e->p, k->p, i, 3 * k->n_joints);
        copy_out(e->residual, k->residual, i, k->n_closure);
        copy_out(e->angle, k->angle, i, k->n_angles);
        if (e->jacobian || e->bias)
            equations_jacobian(k, &k->equations.all);
        if (e->jacobian)
            put_jacobian(k, e->jacobian + i * size);
        copy_out(e->linear, k->linear, i, 3 * k->nv);
        copy_out(e->angular, k->angular, i, 3 * k->nv);
        if (e->bias)
            equations_bias(k, &k->equations.all, e->v + i * k->nv);
        copy_out(e->bias, k->equations.bias, i, k->n_equations);
    }
    return finite ? DONE : NOT_FINITE;
}

/* Move configurations q (m, nq) by joint displacements (m, nv), as `pin.integrate`. */
EXPORT void kernel_integrate(const Kernel *k, Int m, Real *q, const Real *step)
{
    for (Int i = 0; i < m; i++)
        tree_integrate(k, q + i * k->nq, step + i * k->nv);
}
