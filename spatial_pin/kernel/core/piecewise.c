#include "piecewise.h"

#include <math.h>

#define MOST_BREAKS 1000000 /* of one function: times powers they stay far below 2^63 */
#define MOST_POWERS 1000    /* likewise */

/* The last piece that begins at or before x, among all but the first; 0 if there is none. It is
   often the one it was before. */
static Int piece_of(const Real *breaks, Int n, Real x, Int before)
{
    if (breaks[before] <= x && x < breaks[before + 1])
        return before;
    Int low = 0, high = n; /* breaks[low] <= x < breaks[high], but beyond the ends */
    while (high - low > 1) {
        const Int middle = low + (high - low) / 2;
        if (x < breaks[middle])
            high = middle;
        else
            low = middle;
    }
    return low;
}

/* The square root, or a function of the caller's. */
static void other_function_at(const Int *shape, Called called, Real x, Real *out)
{
    if (shape[CALLED]) {
        out[0] = out[1] = out[2] = NAN;
        if (called)
            called(x, out);
        return;
    }
    out[0] = sqrt(x);
    out[1] = 0.5 / out[0];
    out[2] = -0.5 * out[1] / x;
}

void piecewise_at(const Int *shape, const Real *numbers, Called called, Real x, Int *piece, Real *out)
{
    const Int n = shape[PIECES], degree = shape[DEGREE];
    if (!n) {
        other_function_at(shape, called, x, out);
        return;
    }
    const Real *breaks = numbers + shape[FIRST_NUMBER], *coefficients = breaks + n + 1;
    const Real period = breaks[n] - breaks[0], rise = coefficients[n * (degree + 1)];
    const Real periods = shape[REPEATS] ? floor((x - breaks[0]) / period) : 0.0;
    x -= period * periods;
    *piece = piece_of(breaks, n, x, *piece);
    polynomial_at(coefficients + *piece * (degree + 1), degree, x - breaks[*piece], out);
    out[0] += rise * periods;
}

Int piecewise_size(const Int *shape, Int n)
{
    Int total = 0;
    for (Int i = 0; i < n; i++, shape += SHAPE) {
        if (shape[FIRST_NUMBER] == total && !shape[PIECES] && !(shape[CALLED] & ~(Int)1) &&
            !shape[REPEATS])
            continue; /* it has no numbers */
        if (shape[FIRST_NUMBER] != total || shape[PIECES] < 1 || shape[PIECES] > MOST_BREAKS ||
            shape[DEGREE] < 0 || shape[DEGREE] > MOST_POWERS || (shape[REPEATS] & ~(Int)1))
            return -1;
        total += shape[PIECES] + 1 + shape[PIECES] * (shape[DEGREE] + 1) + 1;
    }
    return total;
}
