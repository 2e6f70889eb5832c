/* What one configuration gives, copied out: the kernel held against Pinocchio, and its Jacobians. */
#include <string.h>

#include "kernel.h"

static void copy_out(Real *out, const Real *from, Int n)
{
    if (out)
        memcpy(out, from, (size_t)n * sizeof *out);
}

/* Any of the outputs may be NULL. R (9, by columns) and p (3) are of each joint; the dense
 * Jacobians of equations and angles (n_equations + n_angles, nv) are with respect to v / scale; the
 * bias (n_equations) wants v. */
EXPORT int kernel_evaluate(Kernel *k, const Real *q, const Real *v, const Real *reference, Real *R,
                           Real *p, Real *residual, Real *angle, Real *jacobian, Real *bias)
{
    equations_values_near(k, q, reference);
    copy_out(R, k->R, 9 * k->n_joints);
    copy_out(p, k->p, 3 * k->n_joints);
    copy_out(residual, k->residual, k->n_closure);
    copy_out(angle, k->angle, k->n_angles);
    if (jacobian || bias)
        equations_jacobian(k, &k->all);
    if (jacobian) {
        memset(jacobian, 0, (size_t)((k->n_equations + k->n_angles) * k->nv) * sizeof *jacobian);
        for (Int i = 0; i < k->n_equations; i++)
            for (Int e = k->entry_start[i]; e < k->entry_start[i + 1]; e++)
                jacobian[i * k->nv + k->entry_v[e]] = k->entry[e];
        for (Int i = 0; i < k->n_angles; i++)
            equations_angle_row(k, i, jacobian + (k->n_equations + i) * k->nv);
    }
    if (bias && v) {
        equations_bias(k, &k->all, v);
        copy_out(bias, k->bias, k->n_equations);
    }
    return isfinite(equations_error(k)) ? DONE : NOT_FINITE;
}

/* Placements and dense Jacobians, as above, of m configurations one after the other; angles of
 * screws count from zero. */
EXPORT void kernel_evaluate_all(Kernel *k, Int m, const Real *q, Real *R, Real *p, Real *jacobian)
{
    if (k->n_angles)
        memset(k->angle_reference, 0, (size_t)k->n_angles * sizeof *k->angle_reference);
    for (Int i = 0; i < m; i++, q += k->nq) {
        kernel_evaluate(k, q, NULL, k->angle_reference, R, p, NULL, NULL, jacobian, NULL);
        R += R ? 9 * k->n_joints : 0;
        p += p ? 3 * k->n_joints : 0;
        jacobian += jacobian ? (k->n_equations + k->n_angles) * k->nv : 0;
    }
}

/* Move configurations q (m, nq) by joint displacements (m, nv), as `pin.integrate`. */
EXPORT void kernel_integrate(const Kernel *k, Int m, Real *q, const Real *step)
{
    for (Int i = 0; i < m; i++)
        tree_integrate(k, q + i * k->nq, step + i * k->nv);
}

/* Solve the square system of `system_set` at q: right sides of chosen equations, idle rotations,
 * driven freedoms and filled rows -> v / scale, in place. */
EXPORT int kernel_solve(Kernel *k, const Real *q, const Real *reference, Real *x)
{
    equations_values_near(k, q, reference);
    equations_jacobian(k, &k->all);
    const int code = system_factor(k);
    if (code == DONE)
        system_solve(k, x);
    return code;
}
