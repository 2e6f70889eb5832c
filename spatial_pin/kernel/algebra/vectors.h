/* Vectors, of three and of n, and rotations, stored by columns: R[3 * c + i] is entry i of
 * column c. */
#ifndef SPATIAL_PIN_VECTORS_H
#define SPATIAL_PIN_VECTORS_H

#include <math.h>
#include <stdint.h>

typedef int64_t Int;
typedef double Real;

/* As fmax and fmin where the first is a number, but without a call. */
static inline Real larger_of(Real most, Real size) { return size > most ? size : most; }
static inline Real smaller_of(Real least, Real size) { return size < least ? size : least; }

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
        if (fabs(a[i]) > size || isnan(a[i]))
            size = fabs(a[i]);
    return size;
}

static inline int are_finite(const Real *a, Int n)
{
    for (Int i = 0; i < n; i++)
        if (!isfinite(a[i]))
            return 0;
    return 1;
}

static inline Real dot3(const Real *a, const Real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void cross3(const Real *a, const Real *b, Real *out)
{
    const Real x = a[1] * b[2] - a[2] * b[1];
    const Real y = a[2] * b[0] - a[0] * b[2];
    const Real z = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

static inline void copy3(const Real *a, Real *out)
{
    out[0] = a[0];
    out[1] = a[1];
    out[2] = a[2];
}

static inline void zero3(Real *out) { out[0] = out[1] = out[2] = 0.0; }

/* out += factor * a */
static inline void add3(Real factor, const Real *a, Real *out)
{
    out[0] += factor * a[0];
    out[1] += factor * a[1];
    out[2] += factor * a[2];
}

/* out = R v */
static inline void rotate3(const Real *R, const Real *v, Real *restrict out)
{
    for (int i = 0; i < 3; i++)
        out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}

/* out = Rᵀ v */
static inline void rotate_back3(const Real *R, const Real *v, Real *out)
{
    const Real x = dot3(R, v), y = dot3(R + 3, v), z = dot3(R + 6, v);
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

/* out = A B, both rotations */
static inline void product3(const Real *A, const Real *B, Real *out)
{
    for (int c = 0; c < 3; c++)
        rotate3(A, B + 3 * c, out + 3 * c);
}

#endif
