/* Newton's method near a path of closed configurations, of sweeps and of simulations.
 *
 * K x = -r with K the square system and r the residual of the chosen equations, 0 for all other
 * rows: drivers stand still, idle rotations and filled rows have no part in x. One test tells
 * a correction from a jump to something else: the first is small beside the prediction, and every
 * other is much smaller than the one before. Held coordinates of a rotation have rows of no
 * K: a `Held` tells how far they are, and what brings them there. */
#include <string.h>

#include "correcting.h"

#define WEAK 0.1           /* smallest over largest pivot, below which residuals are to be smaller */
#define PATH_CORRECTIONS 6 /* four square a tenth down to round-off, two for singular places */

Real residual_part(Real pivot_ratio) { return smaller_of(1.0, pivot_ratio / WEAK); }

Real chosen_residual(const Kernel *k)
{
    Real largest = 0.0;
    for (Int i = 0; i < k->system.n_chosen; i++)
        largest = larger_or_nan(largest, fabs(k->residual[k->system.chosen[i]]));
    return largest;
}

Real solve_correction(Kernel *k, const Held *held)
{
    Real *x = k->right, square = 0.0;
    for (Int i = 0; i < k->system.n_chosen; i++)
        x[i] = -k->residual[k->system.chosen[i]];
    for (Int i = k->system.n_chosen; i < k->nv; i++)
        x[i] = 0.0;
    system_solve(k, x);
    if (held)
        held->close(held->owner, x);
    for (Int v = 0; v < k->nv; v++) {
        square += x[v] * x[v];
        x[v] *= k->scale[v];
    }
    return sqrt(square);
}

static int factor_here(Kernel *k, const Held *held)
{
    if (held)
        return held->factor(held->owner);
    equations_jacobian(k, &k->equations.system);
    return system_factor(k);
}

/* Whether no correction more is wanted: a last one of round-off is as good as any after it. */
static int is_closed(const Correction *c, Real residual, Real size)
{
    if (size <= TOLERANCE_ROUND_OFF && residual <= c->left)
        return 1;
    if (c->fixed >= 0)
        return c->count >= c->fixed;
    return residual <= (c->count ? c->tolerance : c->enough);
}

/* What the system is without is evaluated where that ends. */
static int closed(Kernel *k)
{
    equations_residuals(k, &k->equations.rest);
    return DONE;
}

/* Whether the factors at hand, of another point, will do for one correction more. */
static int serves(const Correction *c, int old, Real away, Real residual, Real before)
{
    if (c->away > 0.0)
        return residual * away <= c->tolerance;
    return old && (c->count ? residual * (residual / before) <= c->tolerance
                            : residual < TOLERANCE_HALF_PRECISION);
}

int correct(Kernel *k, Real *q, Correction *c)
{
    Real size = INFINITY, last = INFINITY, before = INFINITY;
    Real away = c->away;
    int old = c->reuse; /* the factors are of another point */
    int is_own = 0;     /* they are of a correction before, whose next one they serve as well */
    c->first = 0.0;
    for (c->count = 0;; c->count++) {
        const Real gap = c->held ? c->held->put(c->held->owner, q) : 0.0;
        tree_place(k, q);
        equations_residuals(k, &k->equations.system);
        const Real residual = chosen_residual(k) + gap;
        if (!isfinite(residual))
            return NOT_FINITE;
        if (is_closed(c, residual, size))
            return closed(k);
        if (c->fixed < 0 && c->count == PATH_CORRECTIONS)
            return NOT_CONVERGED;
        old = serves(c, old, away, residual, before);
        away = old ? away : 0.0;
        if (!old && !(is_own && size * residual <= 0.1 * c->tolerance)) {
            const int code = factor_here(k, c->held);
            if (code != DONE)
                return code;
            is_own = c->away == 0.0;
        }
        size = solve_correction(k, c->held);
        if (!isfinite(size))
            return NOT_FINITE;
        if (c->count == 0)
            c->first = size;
        if (c->count == 0 && size > c->allowed + TOLERANCE_NOTHING)
            return UNSAFE;
        if (c->count && size > TOLERANCE_CONTRACTION * last) /* round-off ends it too */
            return residual <= c->left ? closed(k) : NOT_CONVERGED;
        away += size;
        if (c->away > 0.0)
            last = larger_of(size, TOLERANCE_ROUND_OFF);
        else /* old factors do not contract alike where it is not known how far off they are */
            last = old ? INFINITY : larger_of(size, TOLERANCE_ZERO);
        before = residual;
        tree_integrate(k, q, k->right);
        if (c->prescribed)
            prescribed_put(c->prescribed, q);
    }
}

/* ---- whether a place is regular ---- */

int stays_closed(Kernel *k, const Real *q, Real error, Real *there)
{
    Real *x = k->right;
    memset(x, 0, (size_t)k->nv * sizeof *x);
    for (Int i = 0; i < k->system.n_driven + k->system.n_fill; i++)
        x[k->system.n_chosen + k->n_idle + i] = cos(1.0 + (Real)i); /* none of them alone */
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
    equations_jacobian(k, &k->equations.all);
    const Real error = equations_error(k);
    int code = system_set(k, chosen, n, NULL, 0, freedom, n_freedom);
    if (code == DONE)
        code = system_factor(k);
    return code == DONE ? stays_closed(k, q, error, there) : code;
}
