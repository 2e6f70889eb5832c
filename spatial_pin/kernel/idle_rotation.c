/* Rotation of a link about its own axis along a path, see idle_rotation.h. */
#include "idle_rotation.h"

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

/* The product of equation `idle`, whose B is the axis: the table of equations.c tells it. */
static Int vector_of(const Kernel *k, Int idle)
{
    const Int product = k->equation_int[4 * (k->n_closure + idle)];
    return k->b_term[2 * product];
}

/* e' = w x e, e'' = alpha x e + w x e' */
void idle_axis(const Kernel *k, Int idle, IdleAxis *axis)
{
    const Int vector = vector_of(k, idle), body = k->vector_body[vector];
    const Real *local = k->vector_local + 3 * vector, *R = k->R + 9 * body;
    Real normal[3], turning[3];
    rotate3(R, local, axis->e);
    cross3(k->omega + 3 * body, axis->e, axis->first);
    cross3(k->alpha + 3 * body, axis->e, axis->second);
    cross3(k->omega + 3 * body, axis->first, turning);
    add3(1.0, turning, axis->second);
    normal_to(local, normal);
    rotate3(R, normal, axis->mark);
}

/* e and its derivative at u in (0, 1) of a step, by Hermite's polynomials of fifth degree. */
static void between(const IdleAxis *a, const IdleAxis *b, Real h, Real u, Real *e, Real *rate)
{
    const Real u2 = u * u, u3 = u2 * u, u4 = u3 * u, u5 = u4 * u;
    const Real value1 = 10.0 * u3 - 15.0 * u4 + 6.0 * u5;
    const Real slope0 = h * (u - 6.0 * u3 + 8.0 * u4 - 3.0 * u5);
    const Real slope1 = h * (-4.0 * u3 + 7.0 * u4 - 3.0 * u5);
    const Real bend0 = h * h * 0.5 * (u2 - 3.0 * u3 + 3.0 * u4 - u5);
    const Real bend1 = h * h * 0.5 * (u3 - 2.0 * u4 + u5);
    const Real value1_rate = 30.0 * u2 - 60.0 * u3 + 30.0 * u4;
    const Real slope0_rate = h * (1.0 - 18.0 * u2 + 32.0 * u3 - 15.0 * u4);
    const Real slope1_rate = h * (-12.0 * u2 + 28.0 * u3 - 15.0 * u4);
    const Real bend0_rate = h * h * 0.5 * (2.0 * u - 9.0 * u2 + 12.0 * u3 - 5.0 * u4);
    const Real bend1_rate = h * h * 0.5 * (3.0 * u2 - 8.0 * u3 + 5.0 * u4);
    for (int i = 0; i < 3; i++) {
        const Real way = b->e[i] - a->e[i];
        e[i] = a->e[i] + value1 * way + slope0 * a->first[i] + slope1 * b->first[i] +
               bend0 * a->second[i] + bend1 * b->second[i];
        rate[i] = value1_rate * way + slope0_rate * a->first[i] + slope1_rate * b->first[i] +
                  bend0_rate * a->second[i] + bend1_rate * b->second[i];
    }
}

/* Solid angle between the path of e and the great circle from its first to its last point.
 *
 * The triangle of the first point and a piece de of the path has e0 . (e x de) / (1 + e0 . e).
 * Gauss's four points are exact to degree 7: well beyond what the polynomials know. */
static Real solid_angle(const IdleAxis *a, const IdleAxis *b, Real h)
{
    static const Real place[4] = {-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                                  0.8611363115940526};
    static const Real weight[4] = {0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                                   0.3478548451374538};
    Real sum = 0.0;
    for (int i = 0; i < 4; i++) {
        Real e[3], rate[3], normal[3];
        between(a, b, h, 0.5 * (1.0 + place[i]), e, rate);
        cross3(a->e, e, normal);
        sum += 0.5 * weight[i] * dot3(normal, rate) / (1.0 + dot3(a->e, e));
    }
    return sum;
}

Real idle_turned(const IdleAxis *from, const IdleAxis *to, Real h)
{
    Real axis[3], once[3], twice[3], carried[3], normal[3];
    cross3(from->e, to->e, axis); /* least rotation: m + a x m + a x (a x m) / (1 + e0 . e1) */
    cross3(axis, from->mark, once);
    cross3(axis, once, twice);
    copy3(from->mark, carried);
    add3(1.0, once, carried);
    add3(1.0 / (1.0 + dot3(from->e, to->e)), twice, carried);
    cross3(carried, to->mark, normal);
    const Real turned = atan2(dot3(normal, to->e), dot3(carried, to->mark));
    return turned - solid_angle(from, to, h);
}

void idle_turn(IdleAxis *axis, Real angle)
{
    const Real c = cos(angle), s = sin(angle);
    Real across[3];
    cross3(axis->e, axis->mark, across);
    for (int i = 0; i < 3; i++)
        axis->mark[i] = c * axis->mark[i] + s * across[i];
}
