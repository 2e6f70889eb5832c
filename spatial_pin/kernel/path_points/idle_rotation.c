/* Rotation of a link about its own axis along a path, see idle_rotation.h. */
#include "idle_rotation.h"

#define IDLE_SAFETY 10.0 /* of the estimate of an error: scales of length differ by as much */

/* e and its derivative at u. */
WITHIN void curve_at(const IdleCurve *curve, Number u, Number *e, Number *rate)
{
    zero3(e);
    zero3(rate);
    for (int i = curve->n - 1; i >= 0; i--)
        for (int x = 0; x < 3; x++) {
            rate[x] = rate[x] * (u - curve->z[i]) + e[x];
            e[x] = e[x] * (u - curve->z[i]) + curve->d[i][x];
        }
}

/* Solid angle between the path of e to u, and straight on to `end`, and the great circle from its first
 * point to there: where the end is off that does not show.
 *
 * The triangle of the first point and a piece de of the path has e0 . (e x de) / (1 + e0 . e).
 * Gauss's five points are exact to degree 9, beyond what the curve through three points knows; the
 * short steps between two points want no more than three, exact to degree 5. */
WITHIN Number solid_angle(const IdleCurve *curve, const Number *start, const Number *end, Number u)
{
    static const Real node[8] = {0.0, -0.7745966692414834, 0.7745966692414834,
                                  0.0, -0.5384693101056831, 0.5384693101056831,
                                  -0.9061798459386640, 0.9061798459386640};
    static const Real weight[8] = {0.8888888888888889, 0.5555555555555556, 0.5555555555555556,
                                   0.5688888888888889, 0.4786286704993665, 0.4786286704993665,
                                   0.2369268850561891, 0.2369268850561891};
    const int first = curve->n == 9 ? 3 : 0, last = curve->n == 9 ? 8 : 3;
    Number sum = SPREAD(0.0), e[3], rate[3], normal[3];
    for (int i = first; i < last; i++) {
        curve_at(curve, 0.5 * (1.0 + node[i]) * u, e, rate);
        cross3(start, e, normal);
        sum += 0.5 * weight[i] * dot3(normal, rate) / (1.0 + dot3(start, e));
    }
    curve_at(curve, u, e, rate);
    cross3(start, e, normal);
    return sum * u + dot3(normal, end) / (1.0 + dot3(start, end));
}

SHARED Number idle_turned(const IdleCurve *curve, const Number *e, const Number *mark, Number u)
{
    Number start[3], axis[3], once[3], twice[3], carried[3], normal[3], angle;
    for (int i = 0; i < 3; i++) {
        start[i] = SPREAD(curve->d[0][i]);
        carried[i] = SPREAD(curve->mark[i]);
    }
    cross3(start, e, axis); /* least rotation: m + a x m + a x (a x m) / (1 + e0 . e1) */
    cross3(axis, carried, once);
    cross3(axis, once, twice);
    add3(1.0, once, carried);
    add3(1.0 / (1.0 + dot3(start, e)), twice, carried);
    cross3(carried, mark, normal);
    const Number sine = dot3(normal, e), cosine = dot3(carried, mark);
    for (int i = 0; i < N_PARTS; i++)
        PART(angle, i) = atan2(PART(sine, i), PART(cosine, i));
    return angle - solid_angle(curve, start, e, u);
}

#if N_PARTS == 1

/* A unit vector of the body normal to a unit vector of it: made from the coordinate axis that is
 * furthest from it, so that neighbouring points have the same. */
static void normal_to(const Real *axis, Real *normal)
{
    int least = 0;
    for (int i = 1; i < 3; i++)
        if (fabs(axis[i]) < fabs(axis[least]))
            least = i;
    zero3(normal);
    normal[least] = 1.0;
    add3(-axis[least], axis, normal);
    const Real size = sqrt(dot3(normal, normal));
    for (int i = 0; i < 3; i++)
        normal[i] /= size;
}

/* The vector B of the product of equation `idle` is the axis. */
Int idle_vector(const Kernel *k, Int idle)
{
    const Int product = k->equations.product[k->n_closure + idle];
    return k->products.b_term[2 * product];
}

/* e' = w x e, e'' = alpha x e + w x e' */
void idle_axis(const Kernel *k, Int idle, IdleAxis *axis)
{
    const Int vector = idle_vector(k, idle), body = k->vectors.body[vector];
    const Real *local = k->vectors.local + 3 * vector, *R = k->R + 9 * body;
    Real turning[3];
    rotate3(R, local, axis->e);
    cross3(k->omega + 3 * body, axis->e, axis->first);
    cross3(k->alpha + 3 * body, axis->e, axis->second);
    cross3(k->omega + 3 * body, axis->first, turning);
    add3(1.0, turning, axis->second);
    normal_to(local, axis->normal);
    rotate3(R, axis->normal, axis->mark);
}

/* Divided differences of repeated nodes [StoerBulirsch2002, 2.1.5]. */
static void divide_differences(IdleCurve *curve, const IdleAxis *const *axes, Real h)
{
    for (int order = 1; order < curve->n; order++)
        for (int i = curve->n - 1; i >= order; i--) {
            const Real gap = curve->z[i] - curve->z[i - order];
            for (int x = 0; x < 3; x++) {
                Real *d = curve->d[i];
                if (gap != 0.0)
                    d[x] = (d[x] - curve->d[i - 1][x]) / gap;
                else
                    d[x] = order == 1 ? h * axes[i / 3]->first[x]
                                      : 0.5 * h * h * axes[i / 3]->second[x];
            }
        }
}

void idle_curve(const IdleAxis *before, const IdleAxis *from, const IdleAxis *to, Real gap, Real h,
                IdleCurve *curve)
{
    const IdleAxis *axes[3] = {from, to, before};
    const Real places[3] = {0.0, 1.0, -gap / h};
    curve->n = before ? 9 : 6;
    for (int i = 0; i < curve->n; i++) {
        curve->z[i] = places[i / 3];
        copy3(axes[i / 3]->e, curve->d[i]);
    }
    copy3(from->mark, curve->mark);
    divide_differences(curve, axes, h);
}

/* d[6] is what the third point adds to the other two, at most |d[6]| / 64 between them: that was
 * their error, of order h^6 / (64 6!) with a band of the way's length. Three points leave
 * 0.057 h^9 / 9!, which for one scale of length in all derivatives is 1.6 times its power 3/2. */
Real idle_error(const IdleCurve *curve, const Real *end)
{
    if (curve->n < 9)
        return 0.0;
    Real way[3];
    copy3(end, way);
    add3(-1.0, curve->d[0], way);
    const Real band = sqrt(dot3(way, way)), two = sqrt(dot3(curve->d[6], curve->d[6])) / 64.0;
    return IDLE_SAFETY * 1.6 * two * sqrt(two) * band;
}

void idle_turn(IdleAxis *axis, Real angle)
{
    const Real c = cos(angle), s = sin(angle);
    Real across[3];
    cross3(axis->e, axis->mark, across);
    for (int i = 0; i < 3; i++)
        axis->mark[i] = c * axis->mark[i] + s * across[i];
}

#endif
