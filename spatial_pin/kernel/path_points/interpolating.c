/* A path between two of its points, by Hermite's polynomials: of fifth degree through the two, or of
 * eighth through a third one too. */
#include <string.h>
#include <math.h>

#include "interpolating.h"

#define FARTHEST_NODE 6.0 /* distances of two points: a third one farther away tells no more than these */

/* Coefficients of an entry between a and b, from the constant one on, of u = (s - a->s) / h. */
static void quintic(const Point *a, const Point *b, Real h, Int i, Real *c)
{
    const Real first0 = h * a->first[i], first1 = h * b->first[i];
    const Real half0 = 0.5 * h * h * a->second[i], half1 = 0.5 * h * h * b->second[i];
    const Real value = b->q[i] - a->q[i] - first0 - half0;
    const Real slope = first1 - first0 - 2.0 * half0, bend = half1 - half0;
    c[0] = a->q[i];
    c[1] = first0;
    c[2] = half0;
    c[3] = 10.0 * value - 4.0 * slope + bend;
    c[4] = -15.0 * value + 7.0 * slope - 2.0 * bend;
    c[5] = 6.0 * value - 3.0 * slope + bend;
}

/* Let the polynomial go through a third point at u = -r too: what it misses there is that of
 * (u (1 - u))^3 times one of second degree, which is zero three times at either end. Returns the
 * largest of what that adds at the ends and in the middle, where (u (1 - u))^3 is 1/64. */
static Real through_third(const Point *third, Real h, Real r, Int i, Real *c)
{
    const Real g = -r * (1.0 + r), slope = 1.0 + 2.0 * r; /* u (1 - u) and its derivative there */
    const Real w = g * g * g, first = 3.0 * g * g * slope;
    const Real second = 6.0 * g * (slope * slope - g);
    Real at[3], d[3];
    polynomial_at(c, 5, -r, at);
    d[0] = (third->q[i] - at[0]) / w;
    d[1] = (h * third->first[i] - at[1] - first * d[0]) / w;
    d[2] = 0.5 * (h * h * third->second[i] - at[2] - second * d[0] - 2.0 * first * d[1]) / w;
    const Real by[3] = {d[0] + r * (d[1] + r * d[2]), d[1] + 2.0 * r * d[2], d[2]};
    static const Real cube[4] = {1.0, -3.0, 3.0, -1.0};
    for (int x = 0; x < 3; x++)
        for (int y = 0; y < 4; y++)
            c[3 + x + y] += by[x] * cube[y];
    const Real ends = fmax(fabs(by[0]), fabs(by[0] + by[1] + by[2]));
    return fmax(ends, fabs(by[0] + 0.5 * by[1] + 0.25 * by[2])) / 64.0;
}

Real third_reaches(const Point *third, const Point *from, Real sense)
{
    const Real behind = copysign(1.0, sense) * (from->s - third->s);
    return behind > 0.0 ? behind / BETWEEN_NEAREST : -behind / (1.0 + BETWEEN_NEAREST);
}

void between_make(const Kernel *k, const Point *third, const Point *a, const Point *b, Between *p)
{
    const Real h = b->s - a->s, r = third ? (a->s - third->s) / h : 0.0;
    const int is_near = third && fabs(r) < FARTHEST_NODE && fabs(h) < third_reaches(third, a, h);
    Real square = 0.0;
    p->s = a->s, p->h = h, p->degree = is_near ? BETWEEN_DEGREE : 5;
    for (Int i = 0; i < k->nq + k->n_angles; i++) {
        Real *c = p->coefficient + i * (BETWEEN_DEGREE + 1);
        memset(c + 6, 0, 3 * sizeof *c);
        quintic(a, b, h, i, c);
    }
    for (Int j = 1; j < k->n_joints && is_near; j++)
        for (Int x = 0; x < joint_nq(k->kind[j]); x++) {
            const Int i = k->iq[j] + x, turning = k->kind[j] == FREE ? 3 : 0;
            const int is_entry = joint_nv(k->kind[j]) > 1 && x >= turning; /* of a quaternion */
            const Real by = is_entry ? 2.0 : 1.0 / k->scale[k->iv[j] + x];
            const Real added = by * through_third(third, h, r, i, p->coefficient + i * (BETWEEN_DEGREE + 1));
            square += added * added;
        }
    for (Int i = k->nq; i < k->nq + k->n_angles && is_near; i++)
        through_third(third, h, r, i, p->coefficient + i * (BETWEEN_DEGREE + 1));
    p->third = sqrt(square);
}

/* Angular velocity and acceleration in the body's axes of a quaternion that is of length one but
 * for the error of the polynomials: w = 2 x̄ x', alpha = 2 x̄ x''. */
WITHIN void pure_product(const Real *x, const Real *rate, Real *out)
{
    Real across[3];
    cross3(x, rate, across);
    for (int i = 0; i < 3; i++)
        out[i] = 2.0 * (x[3] * rate[i] - rate[3] * x[i] - across[i]);
}

/* Joint rates of one joint from its entries of q and their derivatives. */
WITHIN void joint_rates(Int kind, const Real *q, const Real *first, const Real *second, Real *t,
                        Real *c)
{
    if (joint_nv(kind) == 1) {
        *t = *first;
        *c = *second;
        return;
    }
    const int at = kind == FREE ? 3 : 0;
    pure_product(q + at, first + at, t + at);
    pure_product(q + at, second + at, c + at);
    if (kind != FREE)
        return;
    Real R[9], turning[3];
    quaternion_rotation(q + 3, R);
    rotate_back3(R, first, t);
    rotate_back3(R, second, c); /* p'' = R (a + w x v) */
    cross3(t + 3, t, turning);
    add3(-1.0, turning, c);
}

/* ---- a few values at once ---- */

#include "side_by_side.h"

/* One joint at n values of u, by the polynomials of its entries. */
WITHIN void joint_at(const Kernel *k, Int j, const Real *coefficient, Int degree, Lane u, Int n, Real h,
                     Real *q, Real *t, Real *c)
{
    const Int nq = joint_nq(k->kind[j]);
    Lane at[7][3];
    for (Int i = 0; i < nq; i++) {
        polynomial_at(coefficient + i * (BETWEEN_DEGREE + 1), degree, u, at[i]);
        at[i][1] /= h;
        at[i][2] /= h * h;
    }
    for (Int l = 0; l < n; l++) {
        Real *x = q + l * k->nq + k->iq[j], rate[7], bend[7];
        for (Int i = 0; i < nq; i++)
            x[i] = at[i][0][l], rate[i] = at[i][1][l], bend[i] = at[i][2][l];
        joint_rates(k->kind[j], x, rate, bend, t + l * k->nv + k->iv[j], c + l * k->nv + k->iv[j]);
    }
}

FOR_WIDE void between_at(const Kernel *k, const Between *p, const Real *s, Int n, Real *q, Real *t, Real *c,
                         Real *angle)
{
    Lane u, at[3];
    for (Int l = 0; l < LANES; l++)
        u[l] = (s[l < n ? l : n - 1] - p->s) / p->h;
    for (Int j = 1; j < k->n_joints; j++)
        joint_at(k, j, p->coefficient + k->iq[j] * (BETWEEN_DEGREE + 1), p->degree, u, n, p->h, q, t, c);
    for (Int l = 0; l < n && k->nq > k->nv; l++)
        tree_normalize(k, q + l * k->nq);
    for (Int i = 0; i < k->n_angles; i++) {
        polynomial_at(p->coefficient + (k->nq + i) * (BETWEEN_DEGREE + 1), p->degree, u, at);
        for (Int l = 0; l < n; l++)
            angle[l * k->n_angles + i] = at[0][l];
    }
}

void point_between(const Kernel *k, const Point *a, const Point *b, Real s, Real *q, Real *t, Real *c)
{
    const Real h = b->s - a->s, u = (s - a->s) / h;
    Real own[7 * (BETWEEN_DEGREE + 1)];
    for (Int j = 1; j < k->n_joints; j++) {
        for (Int i = 0; i < joint_nq(k->kind[j]); i++)
            quintic(a, b, h, k->iq[j] + i, own + i * (BETWEEN_DEGREE + 1));
        joint_at(k, j, own, 5, SPREAD(u), 1, h, q, t, c);
    }
    tree_normalize(k, q);
}
