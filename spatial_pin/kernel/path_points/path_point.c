/* A point of a path: rates there, and predictions from it. */
#include <string.h>

#include "path_point.h"

#define FAR_AHEAD 8.0 /* distances of two points that Hermite's polynomial tells ahead: their
                         round-off grows by 20 r^5 */

static Int axis_numbers(const Kernel *k)
{
    return k->n_idle * (Int)(sizeof(IdleAxis) / sizeof(Real));
}

Int point_numbers(const Kernel *k)
{
    return 3 * (k->nq + k->n_angles) + 2 * k->nv + axis_numbers(k);
}

static Real *carve(Real **from, Int n)
{
    Real *part = *from;
    *from += n;
    return part;
}

void point_carve(const Kernel *k, Real **from, Point *point)
{
    point->q = carve(from, k->nq + k->n_angles);
    point->first = carve(from, k->nq + k->n_angles);
    point->second = carve(from, k->nq + k->n_angles);
    point->t = carve(from, k->nv);
    point->c = carve(from, k->nv);
    point->angle = point->q + k->nq;
    point->angle_rate = point->first + k->nq;
    point->axis = (IdleAxis *)carve(from, axis_numbers(k));
}

int point_rates(Kernel *k, const Prescribed *prescribed, Point *point)
{
    Real squares[2];
    point->size = determinant_size(k);
    point->error = equations_error(k);
    system_path_rates(k, prescribed->rate, prescribed->bend, point->t, point->c, squares);
    for (Int i = 0; i < k->n_angles; i++) {
        point->angle[i] = k->angle[i];
        point->angle_rate[i] = k->angles.rate[i]; /* at the rates t */
    }
    if (k->n_idle)
        tree_accelerate(k, point->c); /* after the rates t, see system_path_rates */
    for (Int i = 0; i < k->n_idle; i++)
        idle_axis(k, i, point->axis + i);
    tree_entry_rates(k, point->q, point->t, point->c, point->first, point->second);
    point->pace = sqrt(squares[0]);
    point->bend = sqrt(squares[1]);
    return isfinite(point->pace + point->bend) ? DONE : NOT_FINITE;
}

void point_bend_angles(Kernel *k, Point *point)
{
    for (Int i = 0; i < k->n_angles; i++) {
        Real bend = k->angles.bias[i];
        equations_angle_row(k, i, k->right);
        for (Int v = 0; v < k->nv; v++)
            bend += k->right[v] * point->c[v] / k->scale[v];
        point->second[k->nq + i] = bend;
    }
}

Real point_way(const Kernel *k, const Point *point, Real h)
{
    Real square = 0.0;
    for (Int v = 0; v < k->nv; v++) {
        const Real way = h * (point->t[v] + 0.5 * h * point->c[v]) / k->scale[v];
        square += way * way;
    }
    return sqrt(square);
}

Real point_reach(const Point *point, Real h)
{
    return fabs(h) * point->pace + 0.5 * h * h * point->bend;
}

void predict_taylor(const Kernel *k, const Point *at, const Point *before, Real h, Int order,
                    Real *q)
{
    const Real first = order >= 1 ? h : 0.0, second = order >= 2 ? 0.5 * h * h : 0.0;
    const Real third = before ? h * h * h / (6.0 * (at->s - before->s)) : 0.0;
    memcpy(q, at->q, (size_t)k->nq * sizeof *q);
    for (Int v = 0; v < k->nv; v++) {
        k->right[v] = first * at->t[v] + second * at->c[v];
        if (before)
            k->right[v] += third * (at->c[v] - before->c[v]);
    }
    tree_integrate(k, q, k->right);
}

/* With x = s - s1 by H = s1 - s0 and f = H q1', g = H² q1'': q1 + f x + g x² / 2 + x³ (A + B x +
 * C x²), where A, B, C match what that leaves open of q0, q0', q0'' at x = -1. */
void predict_hermite(const Kernel *k, const Point *before, const Point *at, Real h, Real *q)
{
    const Real H = at->s - before->s, x = h / H, cube = x * x * x;
    for (Int i = 0; i < k->nq; i++) {
        const Real f = H * at->first[i], g = H * H * at->second[i];
        const Real value = before->q[i] - (at->q[i] - f + 0.5 * g);
        const Real slope = H * before->first[i] - (f - g);
        const Real bend = H * H * before->second[i] - g;
        const Real A = -0.5 * (bend + 8.0 * slope + 20.0 * value);
        const Real C = A + slope + 4.0 * value, B = value + A + C;
        q[i] = at->q[i] + x * (f + 0.5 * x * g) + cube * (A + x * (B + x * C));
    }
    tree_normalize(k, q);
}

int hermite_reaches(const Point *before, const Point *at, Real h)
{
    return fabs(h) < FAR_AHEAD * fabs(at->s - before->s);
}
