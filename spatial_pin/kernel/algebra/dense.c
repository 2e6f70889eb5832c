/* Dense factorisations of matrices stored by rows [GolubVanLoan2013]: L U with row exchanges, Q R with
 * column exchanges, L Lᵀ, and solutions with them. The matrices are small: no blocks.
 */
#include <float.h>
#include <string.h>

#include "dense.h"

/* y += factor * x */
static inline void add_row(Int n, Real factor, const Real *restrict x, Real *restrict y)
{
    for (Int j = 0; j < n; j++)
        y[j] += factor * x[j];
}

/* Four sums at a time, which a processor adds up side by side. */
static inline Real dot_row(Int n, const Real *x, const Real *y)
{
    Real sum[4] = {0.0, 0.0, 0.0, 0.0};
    Int j = 0;
    for (; j + 4 <= n; j += 4)
        for (int k = 0; k < 4; k++)
            sum[k] += x[j + k] * y[j + k];
    for (; j < n; j++)
        sum[0] += x[j] * y[j];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Row i of x (n, columns) less `count` rows of it from `first`, times a factor each. */
static inline void subtract_rows(Int count, const Real *factors, Int first, Int columns, Real *x,
                                 Int i)
{
    if (columns == 1) {
        x[i] -= dot_row(count, factors, x + first);
        return;
    }
    for (Int j = 0; j < count; j++)
        add_row(columns, -factors[j], x + (first + j) * columns, x + i * columns);
}

/* `count` rows of x (n, columns) from `first`, less row i times a factor each. */
static inline void spread_row(Int count, const Real *factors, Int first, Int columns, Real *x,
                              Int i)
{
    if (columns == 1) {
        add_row(count, -x[i], factors, x + first);
        return;
    }
    for (Int j = 0; j < count; j++)
        add_row(columns, -factors[j], x + i * columns, x + (first + j) * columns);
}

static void swap_rows(Int n, Real *x, Real *y)
{
    for (Int j = 0; j < n; j++) {
        const Real other = x[j];
        x[j] = y[j];
        y[j] = other;
    }
}

/* ---- L U ---- */

static Int largest_below(Int n, const Real *a, Int k)
{
    Int best = k;
    for (Int i = k + 1; i < n; i++)
        if (fabs(a[i * n + k]) > fabs(a[best * n + k]))
            best = i;
    return best;
}

/* Factor a (n, n) in place by partial pivoting: row k was exchanged with row order[k]. Return 0, or
   the number of the first column without a pivot. */
Int dense_lu(Int n, Real *a, Int *order)
{
    Int singular = 0;
    for (Int k = 0; k < n; k++) {
        const Int p = order[k] = largest_below(n, a, k);
        if (!(fabs(a[p * n + k]) > 0.0)) {
            singular = singular ? singular : k + 1;
            continue;
        }
        if (p != k)
            swap_rows(n, a + k * n, a + p * n);
        for (Int i = k + 1; i < n; i++) {
            if (a[i * n + k] == 0.0)
                continue;
            const Real factor = a[i * n + k] /= a[k * n + k];
            add_row(n - k - 1, -factor, a + k * n + k + 1, a + i * n + k + 1);
        }
    }
    return singular;
}

static void divide_row(Int columns, Real pivot, Real *x)
{
    for (Int c = 0; c < columns; c++)
        x[c] /= pivot;
}

/* x := U⁻¹ x, or U⁻ᵀ x, for the upper triangle of a (n, n) and x (n, columns). */
static void solve_upper(Int n, const Real *a, Int transposed, Int columns, Real *x)
{
    for (Int i = n - 1; !transposed && i >= 0; i--) {
        subtract_rows(n - 1 - i, a + i * n + i + 1, i + 1, columns, x, i);
        divide_row(columns, a[i * n + i], x + i * columns);
    }
    for (Int i = 0; transposed && i < n; i++) {
        divide_row(columns, a[i * n + i], x + i * columns);
        spread_row(n - 1 - i, a + i * n + i + 1, i + 1, columns, x, i);
    }
}

/* x := U⁻¹ L⁻¹ P x, for x (n, columns). */
static void solve_plain(Int n, const Real *lu, const Int *order, Int columns, Real *x)
{
    for (Int k = 0; k < n; k++)
        if (order[k] != k)
            swap_rows(columns, x + k * columns, x + order[k] * columns);
    for (Int i = 1; i < n; i++)
        subtract_rows(i, lu + i * n, 0, columns, x, i);
    solve_upper(n, lu, 0, columns, x);
}

/* x := Pᵀ L⁻ᵀ U⁻ᵀ x, for x (n, columns). */
static void solve_transposed(Int n, const Real *lu, const Int *order, Int columns, Real *x)
{
    solve_upper(n, lu, 1, columns, x);
    for (Int i = n - 1; i > 0; i--)
        spread_row(i, lu + i * n, 0, columns, x, i);
    for (Int k = n - 1; k >= 0; k--)
        if (order[k] != k)
            swap_rows(columns, x + k * columns, x + order[k] * columns);
}

/* x := a⁻¹ x, or a⁻ᵀ x, for x (n, columns) and the factors of a. */
void dense_lu_solve(Int n, const Real *lu, const Int *order, Int transposed, Int columns, Real *x)
{
    if (transposed)
        solve_transposed(n, lu, order, columns, x);
    else
        solve_plain(n, lu, order, columns, x);
}

/* x := signs of x; return whether any differs from those in `signs`, which is where they go. */
static int take_signs(Int n, Real *x, Real *signs)
{
    int differ = 0;
    for (Int i = 0; i < n; i++) {
        x[i] = x[i] >= 0.0 ? 1.0 : -1.0;
        differ |= x[i] != signs[i];
        signs[i] = x[i];
    }
    return differ;
}

static Real sum_of_sizes(Int n, const Real *x)
{
    Real sum = 0.0;
    for (Int i = 0; i < n; i++)
        sum += fabs(x[i]);
    return sum;
}

static Int index_of_largest(Int n, const Real *x)
{
    Int best = 0;
    for (Int i = 1; i < n; i++)
        if (fabs(x[i]) > fabs(x[best]))
            best = i;
    return best;
}

/* A lower bound, nearly always sharp, of the 1-norm of a⁻¹ [Higham2002, algorithm 15.4], from the
   factors of a and scratch (2 n). */
Real dense_inverse_norm(Int n, const Real *lu, const Int *order, Real *scratch)
{
    Real *x = scratch, *signs = scratch + n, best = 0.0;
    Int largest = -1;
    memset(signs, 0, (size_t)n * sizeof(Real));
    for (int turn = 0; turn < 5; turn++) { /* it rarely takes more than two */
        for (Int i = 0; i < n; i++)
            x[i] = largest < 0 ? 1.0 / (Real)n : i == largest ? 1.0 : 0.0;
        solve_plain(n, lu, order, 1, x);
        const Real size = sum_of_sizes(n, x);
        if (turn && !(size > best))
            break;
        best = size;
        if (!take_signs(n, x, signs))
            break;
        solve_transposed(n, lu, order, 1, x);
        const Int next = index_of_largest(n, x);
        if (largest >= 0 && fabs(x[next]) <= fabs(x[largest]))
            break;
        largest = next;
    }
    for (Int i = 0; i < n; i++) /* a guess that cancellation does not fool */
        x[i] = (i % 2 ? -1.0 : 1.0) * (1.0 + (n > 1 ? (Real)i / (Real)(n - 1) : 0.0));
    solve_plain(n, lu, order, 1, x);
    const Real other = 2.0 * sum_of_sizes(n, x) / (3.0 * (Real)n);
    return other > best ? other : best;
}

/* ---- L Lᵀ ---- */

/* Factor the symmetric a (n, n) in place, its lower triangle; x := a⁻¹ x for x (n). Return 0, or
   the number of the first column whose pivot is not above `least`, 0 for positive definite. */
Int dense_cholesky_solve(Int n, Real *a, Real *x, Real least)
{
    for (Int k = 0; k < n; k++) {
        for (Int j = 0; j <= k; j++) {
            const Real sum = a[k * n + j] - dot_row(j, a + k * n, a + j * n);
            if (j < k)
                a[k * n + j] = sum / a[j * n + j];
            else if (sum > least)
                a[k * n + k] = sqrt(sum);
            else
                return k + 1;
        }
    }
    for (Int i = 0; i < n; i++)
        x[i] = (x[i] - dot_row(i, a + i * n, x)) / a[i * n + i];
    for (Int i = n - 1; i >= 0; i--) {
        x[i] /= a[i * n + i];
        add_row(i, -x[i], a + i * n, x);
    }
    return 0;
}

/* ---- Q R ---- */

/* Length of column j of a (m, n) from row `first`, without overflow of squares. */
static Real column_length(Int m, Int n, const Real *a, Int first, Int j)
{
    Real largest = 0.0, sum = 0.0;
    for (Int i = first; i < m; i++)
        largest = fmax(largest, fabs(a[i * n + j]));
    if (!(largest > 0.0))
        return 0.0;
    for (Int i = first; i < m; i++) {
        const Real part = a[i * n + j] / largest;
        sum += part * part;
    }
    return largest * sqrt(sum);
}

static void swap_columns(Int m, Int n, Real *a, Int j, Int k)
{
    for (Int i = 0; i < m; i++) {
        const Real other = a[i * n + j];
        a[i * n + j] = a[i * n + k];
        a[i * n + k] = other;
    }
}

/* Reflect column k onto its diagonal entry: below it stands the reflection's vector, whose first
   entry is 1. Return the factor tau of I - tau v vᵀ. */
static Real reflect_column(Int m, Int n, Real *a, Int k)
{
    const Real alpha = a[k * n + k], below = column_length(m, n, a, k + 1, k);
    if (!(below > 0.0))
        return 0.0;
    const Real beta = -copysign(hypot(alpha, below), alpha);
    for (Int i = k + 1; i < m; i++)
        a[i * n + k] /= alpha - beta;
    a[k * n + k] = beta;
    return (beta - alpha) / beta;
}

/* Columns from `first` of x (m, columns) := (I - tau v vᵀ) of them, v being that of column k of
   the factors qr (m, n). */
static void reflect(Int m, Int n, const Real *qr, Int k, Real tau, Int columns, Int first, Real *x,
                    Real *scratch)
{
    const Int width = columns - first;
    memcpy(scratch, x + k * columns + first, (size_t)width * sizeof(Real));
    for (Int i = k + 1; i < m; i++)
        add_row(width, qr[i * n + k], x + i * columns + first, scratch);
    add_row(width, -tau, scratch, x + k * columns + first);
    for (Int i = k + 1; i < m; i++)
        add_row(width, -tau * qr[i * n + k], scratch, x + i * columns + first);
}

/* Lengths of the remainders of the columns after step k: those that have lost half their digits since
   they were last measured are measured anew [GolubVanLoan2013, 5.4.2]. */
static void shorten(Int m, Int n, const Real *a, Int k, Real *length, Real *measured)
{
    for (Int j = k + 1; j < n; j++) {
        if (!(length[j] > 0.0))
            continue;
        const Real part = a[k * n + j] / length[j], part_left = fmax(0.0, 1.0 - part * part);
        const Real since = length[j] / measured[j];
        if (part_left * since * since <= sqrt(DBL_EPSILON))
            length[j] = measured[j] = column_length(m, n, a, k + 1, j);
        else
            length[j] *= sqrt(part_left);
    }
}

/* The first of the longest columns from k. As long is what differs by no more than updated lengths
   may be off: in symmetric mechanisms columns are equally long, and round-off is to have no say. */
static Int next_column(Int n, const Real *length, Int k)
{
    const Real longest = length[k + index_of_largest(n - k, length + k)];
    Int j = k;
    while (length[j] < longest * (1.0 - sqrt(DBL_EPSILON)))
        j++;
    return j;
}

/* Factor a (m, n) in place, the longest remaining column first: column order[k] of a is column k
   of Q R. Scratch (3 n). */
void dense_qr(Int m, Int n, Real *a, Int *order, Real *tau, Real *scratch)
{
    Real *length = scratch, *measured = scratch + n;
    for (Int j = 0; j < n; j++) {
        order[j] = j;
        length[j] = measured[j] = column_length(m, n, a, 0, j);
    }
    for (Int k = 0; k < n && k < m; k++) {
        const Int p = next_column(n, length, k);
        if (p != k) {
            const Int other = order[p];
            swap_columns(m, n, a, p, k);
            order[p] = order[k];
            order[k] = other;
            length[p] = length[k];
            measured[p] = measured[k];
        }
        tau[k] = reflect_column(m, n, a, k);
        reflect(m, n, a, k, tau[k], n, k + 1, a, scratch + 2 * n);
        shorten(m, n, a, k, length, measured);
    }
}

/* x := Q x, or Qᵀ x, for x (m, columns) and `count` reflections of the factors qr (m, n); scratch
   (columns). */
void dense_qr_turn(Int m, Int n, const Real *qr, const Real *tau, Int count, Int transposed,
                   Int columns, Real *x, Real *scratch)
{
    for (Int step = 0; step < count; step++) {
        const Int k = transposed ? step : count - 1 - step;
        reflect(m, n, qr, k, tau[k], columns, 0, x, scratch);
    }
}
