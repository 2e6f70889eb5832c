/* A complete orthogonal decomposition [GolubVanLoan2013, 5.5]: Jᵀ P = Q R with the longest column left
 * first, cut where the pivots end; then of [Rᵀ; sqrt(damping)], which has full rank. Steps leave
 * alone what no equation moves, and equations that follow from others change nothing: to the last
 * digits, where a factor of J Jᵀ + damping knows both by their squares only.
 *
 * Not by dense.c: here columns lie one behind the other, and zeros are left out. Closing a
 * platform on six legs (18 equations) takes 110 microseconds so, and 290 that way. */
#include <string.h>

#include "closing_parts.h"
#include "memory.h"

static Int smaller(Int a, Int b) { return a < b ? a : b; }

int least_motion_create(Kernel *k, Int n, Int most, LeastMotion *e)
{
    const Int r = smaller(n, most);
    e->n = e->most = n, e->m = most, e->rank = 0;
    e->pivot = kernel_ints(k, n);
    e->vectors = kernel_reals(k, n * most);
    e->factor = kernel_reals(k, 2 * r);
    e->R = kernel_reals(k, r * n);
    e->tall = kernel_reals(k, r * (n + r));
    e->right = kernel_reals(k, n + most);
    e->square_lengths = kernel_reals(k, n);
    return kernel_had_memory(k) ? DONE : NO_MEMORY;
}

/* Turn x (n) into the Householder vector that takes it to (head, 0 ...); its factor is left. */
static Real reflect(Real *x, Int n, Real *factor)
{
    const Real length = norm(x, n), head = x[0] > 0.0 ? -length : length;
    *factor = 0.0;
    if (!(length > 0.0))
        return 0.0;
    x[0] -= head;
    *factor = -1.0 / (head * x[0]);
    return head;
}

static void apply(const Real *vector, Real factor, Real *x, Int n)
{
    const Real part = factor * dot(vector, x, n);
    for (Int i = 0; i < n; i++)
        x[i] -= part * vector[i];
}

/* The column that is longest below row `step`; lengths are summed anew: columns are short. */
static Int longest(LeastMotion *e, Int step)
{
    Int best = step;
    for (Int j = step; j < e->n; j++) {
        const Real *column = e->vectors + j * e->m + step;
        e->square_lengths[j] = dot(column, column, e->m - step);
        if (e->square_lengths[j] > e->square_lengths[best])
            best = j;
    }
    return best;
}

static void exchange(LeastMotion *e, Int i, Int j)
{
    const Int pivot = e->pivot[i];
    e->pivot[i] = e->pivot[j];
    e->pivot[j] = pivot;
    for (Int v = 0; v < e->m && i != j; v++) {
        const Real x = e->vectors[i * e->m + v];
        e->vectors[i * e->m + v] = e->vectors[j * e->m + v];
        e->vectors[j * e->m + v] = x;
    }
}

/* Householder vectors of the columns in the order of pivots, down to those that are none. */
static void decompose(LeastMotion *e, const Real *J, Real cut)
{
    const Int n = e->n, m = e->m;
    Real least = TOLERANCE_ZERO;
    memcpy(e->vectors, J, (size_t)(n * m) * sizeof(Real));
    for (Int i = 0; i < n; i++)
        e->pivot[i] = i;
    e->rank = 0;
    for (Int step = 0; step < smaller(n, m); step++) {
        exchange(e, step, longest(e, step));
        Real *own = e->vectors + step * m;
        const Real head = reflect(own + step, m - step, e->factor + step);
        if (step == 0 && cut * fabs(head) > least)
            least = cut * fabs(head);
        if (!(fabs(head) > least))
            return;
        for (Int j = step + 1; j < n; j++)
            apply(own + step, e->factor[step], e->vectors + j * m + step, m - step);
        e->R[step * n + step] = head;
        e->rank = step + 1;
    }
}

/* The rows of R: its diagonal is there, the rest is above the vectors of the columns. */
static void gather(LeastMotion *e)
{
    for (Int s = 0; s < e->rank; s++)
        for (Int j = 0; j < e->n; j++)
            if (j != s)
                e->R[s * e->n + j] = j < s ? 0.0 : e->vectors[j * e->m + s];
}

void least_motion_factor(LeastMotion *e, const Real *J, Int n, Int m, Real cut)
{
    e->n = n, e->m = m;
    decompose(e, J, cut);
    gather(e);
}

/* z that minimises |Rᵀ z + b|^2 + damping |z|^2, b in the order of pivots: Householder's method on
   columns (row of R, then sqrt(damping) at their own place). */
static void solve_tall(LeastMotion *e, Real damping, const Real *residual, Real *z)
{
    const Int n = e->n, r = e->rank, rows = n + r;
    Real *right = e->right, *factor = e->factor + smaller(n, e->m);
    for (Int i = 0; i < n; i++)
        right[i] = -residual[e->pivot[i]];
    if (r == n && damping == 0.0) { /* Rᵀ is square, and it is solved as it is */
        for (Int i = 0; i < n; i++) {
            z[i] = right[i];
            for (Int s = 0; s < i; s++)
                z[i] -= e->R[s * n + i] * z[s];
            z[i] /= e->R[i * n + i];
        }
        return;
    }
    memset(right + n, 0, (size_t)r * sizeof(Real));
    for (Int c = 0; c < r; c++) {
        Real *column = e->tall + c * rows;
        memcpy(column, e->R + c * n, (size_t)n * sizeof(Real));
        memset(column + n, 0, (size_t)r * sizeof(Real));
        column[n + c] = sqrt(damping);
    }
    for (Int c = 0; c < r; c++) {
        Real *own = e->tall + c * rows + c;
        const Int height = n + (damping > 0.0 ? c + 1 : 0) - c; /* below it all are zero */
        const Real head = reflect(own, height, factor + c);
        for (Int j = c + 1; j < r; j++)
            apply(own, factor[c], e->tall + j * rows + c, height);
        apply(own, factor[c], right + c, height);
        z[c] = head;
    }
    for (Int c = r - 1; c >= 0; c--) {
        Real sum = right[c];
        for (Int j = c + 1; j < r; j++)
            sum -= e->tall[j * rows + c] * z[j];
        z[c] = sum / z[c];
    }
}

void least_motion_solve(LeastMotion *e, Real damping, const Real *residual, Real *x)
{
    memset(x, 0, (size_t)e->m * sizeof(Real));
    solve_tall(e, damping, residual, x);
    for (Int step = e->rank - 1; step >= 0; step--)
        apply(e->vectors + step * e->m + step, e->factor[step], x + step, e->m - step);
}

void least_motion_freedoms(const LeastMotion *e, Real *rows)
{
    memset(rows, 0, (size_t)((e->m - e->rank) * e->m) * sizeof(Real));
    for (Int i = e->rank; i < e->m; i++, rows += e->m) {
        rows[i] = 1.0;
        for (Int step = e->rank - 1; step >= 0; step--)
            apply(e->vectors + step * e->m + step, e->factor[step], rows + step, e->m - step);
    }
}

void least_motion_multipliers(LeastMotion *e, const Real *gradient, Real *y)
{
    Real *z = e->right;
    memcpy(z, gradient, (size_t)e->m * sizeof(Real));
    memset(y, 0, (size_t)e->n * sizeof(Real));
    for (Int step = 0; step < e->rank; step++)
        apply(e->vectors + step * e->m + step, e->factor[step], z + step, e->m - step);
    for (Int i = e->rank - 1; i >= 0; i--) {
        for (Int j = i + 1; j < e->rank; j++)
            z[i] -= e->R[i * e->n + j] * z[j];
        z[i] /= e->R[i * e->n + i];
        y[e->pivot[i]] = z[i];
    }
}
