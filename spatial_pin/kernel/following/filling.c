/* Rows that fill the square system up: they ask for the least motion of passive freedoms.
 *
 * The columns of X with [equations; fill] X = [0; 1] span what the equations leave free. Its polar
 * factor, X (XᵀX)^(-1/2), is the orthonormal basis of that nearest to the old rows, for fill X = 1
 * [orthogonal Procrustes problem; Golub, Van Loan, 6.4.1]. */
#include <stdlib.h>

#include "path.h"

#define PASSES 8     /* of Newton-Schulz: errors square, from a half to round-off in six */
#define WIDEST_SQUARE 3.0 /* square of the size of a column above which it does not converge */

/* gram = 3 - XᵀX, columns of X one after the other; returns how far XᵀX is from 1. */
static Real three_less_gram(const Real *x, Int n, Int nv, Real *gram)
{
    Real off = 0.0;
    for (Int i = 0; i < n; i++)
        for (Int j = 0; j < n; j++) {
            const Real product = dot(x + i * nv, x + j * nv, nv);
            off = fmax(off, fabs(product - (i == j)));
            gram[i * n + j] = (i == j ? 3.0 : 0.0) - product;
        }
    return off;
}

/* X becomes its polar factor by X (3 - XᵀX) / 2; 0 where that does not converge. */
static int make_orthonormal(Real *x, Int n, Int nv, Real *gram, Real *row)
{
    for (int pass = 0; pass < PASSES; pass++) {
        const Real off = three_less_gram(x, n, nv, gram);
        if (!(off < WIDEST_SQUARE - 1.0))
            return 0;
        for (Int v = 0; v < nv; v++) {
            for (Int j = 0; j < n; j++) {
                row[j] = 0.0;
                for (Int i = 0; i < n; i++)
                    row[j] += 0.5 * x[i * nv + v] * gram[i * n + j];
            }
            for (Int j = 0; j < n; j++)
                x[j * nv + v] = row[j];
        }
        if (off <= TOLERANCE_LAST_DIGIT)
            return 1;
    }
    return 1;
}

/* Turn the filled rows to the passive freedoms of the present, factored point that are nearest to
 * them, and factor again. DONE, NO_MEMORY, SINGULAR, or NOT_CONVERGED where these have turned by
 * half a right angle or more. */
static int fill_again(Kernel *k)
{
    const Int n = k->system.n_fill, nv = k->nv;
    Real *x = calloc((size_t)(n * nv + n * n + n), sizeof *x);
    if (!x)
        return NO_MEMORY;
    for (Int i = 0; i < n; i++) {
        x[i * nv + nv - n + i] = 1.0;
        system_solve(k, x + i * nv);
    }
    int code = make_orthonormal(x, n, nv, x + n * nv, x + n * nv + n * n) ? DONE : NOT_CONVERGED;
    if (code == DONE)
        code = system_set(k, k->system.chosen, k->system.n_chosen, k->system.driven,
                          k->system.n_driven, x, n);
    free(x);
    return code == DONE ? system_factor(k) : code;
}

int factor_at_path_point(Kernel *k)
{
    equations_jacobian(k, &k->equations.system);
    const int code = system_factor(k);
    return code == DONE && k->system.n_fill ? fill_again(k) : code;
}
