/* A step on the surface of independent equations tells whether the others follow from them. */
#include <string.h>

#include "correcting.h"
#include "regular.h"

int stays_closed(Kernel *k, const Real *q, Real error, Real *there)
{
    Real *x = k->right;
    memset(x, 0, (size_t)k->nv * sizeof *x);
    for (Int i = 0; i < k->n_driven + k->n_fill; i++)
        x[k->n_chosen + k->n_idle + i] = cos(1.0 + (Real)i); /* a direction of none of them alone */
    system_solve(k, x);
    const Real size = norm(x, k->nv);
    for (Int v = 0; v < k->nv; v++)
        x[v] *= TOLERANCE_TRIAL_STEP / size * k->scale[v];
    memcpy(there, q, (size_t)k->nq * sizeof *q);
    tree_integrate(k, there, x);
    /* Closed more tightly than the others are judged by: of many loops these are sums of many chosen
       equations, and open by a multiple of what those are left open by. */
    Correction c = {.enough = 0.0, .tolerance = TOLERANCE_ZERO, .left = TOLERANCE_CLOSED,
                    .allowed = TOLERANCE_TRIAL_STEP, .fixed = -1};
    const int code = correct(k, there, &c);
    if (code != DONE)
        return code == UNSAFE ? NOT_CONVERGED : code;
    return equations_error(k) > fmax(TOLERANCE_CLOSED, 2.0 * error) ? UNSAFE : DONE;
}

/* The same at q with chosen equations and rows (n_fill, nv), with respect to v / scale, of the
   freedoms that they leave. */
EXPORT int tangent_step(Kernel *k, const Real *q, const Real *reference, const Int *chosen, Int n,
                          const Real *freedom, Int n_freedom, Real *there)
{
    equations_values_near(k, q, reference);
    equations_jacobian(k, &k->all);
    const Real error = equations_error(k);
    int code = system_set(k, chosen, n, NULL, 0, freedom, n_freedom);
    if (code == DONE)
        code = system_factor(k);
    return code == DONE ? stays_closed(k, q, error, there) : code;
}
