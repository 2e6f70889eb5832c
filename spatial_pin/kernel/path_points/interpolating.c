/* A path between two of its points, by Hermite's polynomials of fifth degree. */
#include "interpolating.h"

/* Value and derivatives of one entry at u in (0, 1) of a step h. */
typedef struct {
    Real value1, slope0, slope1, bend0, bend1; /* factors: of the way, of slopes and bends */
} Weights;

static void weights_at(Real u, Weights *value, Weights *first, Weights *second)
{
    const Real u2 = u * u, u3 = u2 * u, u4 = u3 * u, u5 = u4 * u;
    value->value1 = 10.0 * u3 - 15.0 * u4 + 6.0 * u5;
    value->slope0 = u - 6.0 * u3 + 8.0 * u4 - 3.0 * u5;
    value->slope1 = -4.0 * u3 + 7.0 * u4 - 3.0 * u5;
    value->bend0 = 0.5 * (u2 - 3.0 * u3 + 3.0 * u4 - u5);
    value->bend1 = 0.5 * (u3 - 2.0 * u4 + u5);
    first->value1 = 30.0 * u2 - 60.0 * u3 + 30.0 * u4;
    first->slope0 = 1.0 - 18.0 * u2 + 32.0 * u3 - 15.0 * u4;
    first->slope1 = -12.0 * u2 + 28.0 * u3 - 15.0 * u4;
    first->bend0 = 0.5 * (2.0 * u - 9.0 * u2 + 12.0 * u3 - 5.0 * u4);
    first->bend1 = 0.5 * (3.0 * u2 - 8.0 * u3 + 5.0 * u4);
    second->value1 = 60.0 * u - 180.0 * u2 + 120.0 * u3;
    second->slope0 = -36.0 * u + 96.0 * u2 - 60.0 * u3;
    second->slope1 = -24.0 * u + 84.0 * u2 - 60.0 * u3;
    second->bend0 = 0.5 * (2.0 - 18.0 * u + 36.0 * u2 - 20.0 * u3);
    second->bend1 = 0.5 * (6.0 * u - 24.0 * u2 + 20.0 * u3);
}

static Real weighted(const Weights *by, const Point *a, const Point *b, Real h, Int i)
{
    return by->value1 * (b->q[i] - a->q[i]) + h * (by->slope0 * a->first[i] +
           by->slope1 * b->first[i]) + h * h * (by->bend0 * a->second[i] + by->bend1 * b->second[i]);
}

/* Angular velocity and acceleration in the body's axes of a quaternion that is of length one but
 * for the error of the polynomials: w = 2 x̄ x', alpha = 2 x̄ x''. */
static void pure_product(const Real *x, const Real *rate, Real *out)
{
    Real across[3];
    cross3(x, rate, across);
    for (int i = 0; i < 3; i++)
        out[i] = 2.0 * (x[3] * rate[i] - rate[3] * x[i] - across[i]);
}

/* Joint rates of one joint from its entries of q and their derivatives. */
static void joint_rates(Int kind, const Real *q, const Real *first, const Real *second, Real *t,
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

void point_between(const Kernel *k, const Point *a, const Point *b, Real s, Real *q, Real *t,
                   Real *c)
{
    const Real h = b->s - a->s;
    Weights value, first, second;
    weights_at((s - a->s) / h, &value, &first, &second);
    for (Int j = 1; j < k->n_joints; j++) {
        Real x[7], rate[7], bend[7];
        for (Int i = 0; i < joint_nq(k->kind[j]); i++) {
            const Int at = k->iq[j] + i;
            x[i] = a->q[at] + weighted(&value, a, b, h, at);
            rate[i] = weighted(&first, a, b, h, at) / h;
            bend[i] = weighted(&second, a, b, h, at) / (h * h);
            q[at] = x[i];
        }
        joint_rates(k->kind[j], x, rate, bend, t + k->iv[j], c + k->iv[j]);
    }
    tree_normalize(k, q);
}
