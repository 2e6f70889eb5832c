/* Factors of a square matrix with few or many unknowns: the one place that chooses how.
 *
 * Of a few unknowns the full matrix is factored, transposed: pivots are sought among the unknowns of
 * an equation, so that equations of other sizes do not change them. Of many a sparse one, whose cost
 * grows with their number, in an order chosen anew each time: answers depend on nothing else. */
#include <stdlib.h>
#include <string.h>

#include "dense.h"
#include "factors.h"
#include "memory.h"

/* Unknowns up to which a full matrix is factored faster than a sparse one is put in order, and of
 * how many entries one is not zero where it is factored as a full one anyway. */
#define FEW_UNKNOWNS 64
#define DENSE 4 /* at least one of this many entries is not zero */

static int is_full(const Factors *f)
{
    return f->n <= FEW_UNKNOWNS || DENSE * f->entries.n > f->n * f->n;
}

Factors *factors_new(Kernel *k)
{
    if (!widen((void **)&k->memory.factors, k->memory.n_factors + 1, sizeof *k->memory.factors))
        return NULL;
    Factors *f = calloc(1, sizeof *f);
    if (f && !(f->lu = lu_new())) {
        free(f);
        f = NULL;
    }
    if (f)
        k->memory.factors[k->memory.n_factors++] = f;
    return f;
}

void factors_free(Factors *f)
{
    entries_free(&f->entries);
    free(f->matrix);
    free(f->order);
    free(f->residual);
    free(f->scratch);
    lu_free(f->lu);
    free(f);
}

static int make_room(Factors *f)
{
    const Int n = f->n, full = is_full(f) ? n : 0;
    if (full > f->full_room || !f->matrix) {
        if (!widen((void **)&f->matrix, full * full, sizeof(Real)) ||
            !widen((void **)&f->order, full, sizeof(Int)))
            return 0;
        f->full_room = full;
    }
    if (n > f->room || !f->residual) {
        if (!widen((void **)&f->residual, n, sizeof(Real)) ||
            !widen((void **)&f->scratch, 2 * n, sizeof(Real)))
            return 0;
        f->room = n;
    }
    return 1;
}

static void factor_full(Factors *f)
{
    const Entries *from = &f->entries;
    const Int n = f->n;
    Real least = INFINITY, most = 0.0;
    memset(f->matrix, 0, (size_t)(n * n) * sizeof(Real));
    for (Int e = 0; e < from->n; e++)
        f->matrix[from->column[e] * n + from->row[e]] = from->value[e];
    const Int failed = dense_lu(n, f->matrix, f->order);
    for (Int i = 0; i < n; i++) {
        least = fmin(least, fabs(f->matrix[i * (n + 1)]));
        most = fmax(most, fabs(f->matrix[i * (n + 1)]));
    }
    f->pivot = failed || !(least > 0.0) || !isfinite(most) ? 0.0 : least / most;
}

static int factor_sparse(Factors *f)
{
    const int code = lu_analyse(f->lu, f->n, &f->entries);
    if (code == DONE && lu_factor(f->lu, f->entries.value))
        f->pivot = lu_pivot_ratio(f->lu);
    return code == NO_MEMORY ? NO_MEMORY : DONE;
}

int factors_make(Factors *f, Int n)
{
    f->n = n;
    f->pivot = n ? 0.0 : 1.0;
    if (!make_room(f))
        return NO_MEMORY;
    if (n && !is_full(f))
        return factor_sparse(f);
    if (n)
        factor_full(f);
    return DONE;
}

/* Pivots of a sparse matrix are chosen for their places too: once more for the digits that this
   costs. */
static void solve_sparse(const Factors *f, Real *x)
{
    const Entries *of = &f->entries;
    memcpy(f->residual, x, (size_t)f->n * sizeof(Real));
    lu_solve(f->lu, x);
    for (Int e = 0; e < of->n; e++)
        f->residual[of->row[e]] -= of->value[e] * x[of->column[e]];
    lu_solve(f->lu, f->residual);
    for (Int i = 0; i < f->n; i++)
        x[i] += f->residual[i];
}

void factors_solve(const Factors *f, Int columns, Real *x)
{
    if (!(f->pivot > 0.0)) {
        memset(x, 0, (size_t)(f->n * columns) * sizeof(Real));
    } else if (is_full(f)) {
        if (f->n)
            dense_lu_solve(f->n, f->matrix, f->order, 1, columns, x);
    } else {
        Real *one = columns > 1 ? f->scratch : x;
        for (Int c = 0; c < columns; c++) {
            for (Int i = 0; i < f->n && columns > 1; i++)
                one[i] = x[i * columns + c];
            solve_sparse(f, one);
            for (Int i = 0; i < f->n && columns > 1; i++)
                x[i * columns + c] = one[i];
        }
    }
}

Real factors_even_ratio(Factors *f)
{
    if (is_full(f) || !(f->pivot > 0.0))
        return f->pivot;
    memset(f->residual, 0, (size_t)f->n * sizeof(Real));
    for (Int e = 0; e < f->entries.n; e++)
        f->residual[f->entries.row[e]] += f->entries.value[e] * f->entries.value[e];
    for (Int i = 0; i < f->n; i++)
        f->residual[i] = sqrt(f->residual[i]);
    return lu_even_ratio(f->lu, f->residual);
}

Real factors_inverse_norm(const Factors *f)
{
    if (!is_full(f) || !f->n || !(f->pivot > 0.0))
        return 0.0;
    return dense_inverse_norm(f->n, f->matrix, f->order, f->scratch);
}
