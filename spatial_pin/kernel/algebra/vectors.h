/* Vectors, of three and of n, and rotations.
 *
 * Formulas that lanes (side_by_side.h) share are written in `Number`, of N_PARTS parts, PART(x, i); SPREAD(x)
 * is a single one in all parts. SHARED functions are static there, those WITHIN others are anyway. */
#ifndef SPATIAL_PIN_VECTORS_H
#define SPATIAL_PIN_VECTORS_H

#include <math.h>
#include <stdint.h>

typedef int64_t Int;
typedef double Real;

/* As fmax and fmin where the first is a number, but without a call. */
static inline Real larger_of(Real most, Real size) { return size > most ? size : most; }
static inline Real smaller_of(Real least, Real size) { return size < least ? size : least; }
/* The larger one, or NaN where one is: nothing is larger than NaN. */
static inline Real larger_or_nan(Real most, Real size) { return size > most || isnan(size) ? size : most; }

static inline Real dot(const Real *a, const Real *b, Int n)
{
    Real sum = 0.0;
    for (Int i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

static inline Real norm(const Real *a, Int n) { return sqrt(dot(a, a, n)); }

/* The largest size of an entry; NaN where one is. */
static inline Real largest(const Real *a, Int n)
{
    Real size = 0.0;
    for (Int i = 0; i < n; i++)
        size = larger_or_nan(size, fabs(a[i]));
    return size;
}

static inline int are_finite(const Real *a, Int n)
{
    for (Int i = 0; i < n; i++)
        if (!isfinite(a[i]))
            return 0;
    return 1;
}

/* ---- of single numbers here, of several in side_by_side.h ---- */

#define Number Real
#define N_PARTS 1 /* configurations at once */
#define PART(x, i) (x)
#define SPREAD(x) (x)
#define SHARED
#define larger_number larger_of
#define WITHIN static inline __attribute__((always_inline))

static inline void sine_and_cosine(Real angle, Real *sine, Real *cosine)
{
    *sine = sin(angle);
    *cosine = cos(angle);
}

#include "formulas.h"

/* out = Rᵀ v */
static inline void rotate_back3(const Real *R, const Real *v, Real *out)
{
    const Real x = dot3(R, v), y = dot3(R + 3, v), z = dot3(R + 6, v);
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

#endif
