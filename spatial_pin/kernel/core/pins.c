/* Components of balls and floating joints: values, derivatives, and how they are given values.
 *
 * With phi the rotation vector, t its length, w the angular velocity in the axes of what turns:
 * phi' = w + phi x w / 2 + g phi x (phi x w), g(t²) = (1 - (t/2) cot(t/2)) / t² [Chirikjian2011]. */
#include "pins.h"

#define SMALL_SQUARE 0.1 /* t² below which g is summed: six terms leave (0.1 / 4 pi²)^6, round-off */

int pin_of(const Kernel *k, Int v, Pin *pin)
{
    for (Int j = 1; j < k->n_joints; j++) {
        const Int at = v - k->iv[j];
        if (k->kind[j] < BALL || at < 0 || at >= joint_nv(k->kind[j]))
            continue;
        const Int slides = k->kind[j] == FREE ? 3 : 0;
        pin->turns = at >= slides;
        pin->component = at % 3;
        pin->v = k->iv[j] + (pin->turns ? slides : 0);
        pin->q = k->iq[j] + (pin->turns ? slides : 0);
        return 1;
    }
    return 0;
}

int pins_are_sound(const Kernel *k, const Pin *pin, Int n)
{
    for (Int i = 0; i < n; i++) {
        const Pin *p = pin + i;
        const Int entries = p->turns ? 4 : 7, freedoms = p->turns ? 3 : 6;
        if (p->q < 0 || p->q > k->nq - entries || p->v < 0 || p->v > k->nv - freedoms ||
            !within(p->component, 3))
            return 0;
    }
    return 1;
}

void rotation_vector(const Real *quaternion, Real *phi)
{
    const Real w = quaternion[3], sine = sqrt(dot3(quaternion, quaternion));
    const Real factor = sine > 0.0 ? 2.0 * atan2(sine, fabs(w)) / sine : 2.0;
    for (int i = 0; i < 3; i++)
        phi[i] = (w < 0.0 ? -factor : factor) * quaternion[i];
}

/* The quaternion of a rotation vector, of the two the one nearer to what it was. */
static void put_rotation(const Real *phi, Real *quaternion)
{
    const Real angle = sqrt(dot3(phi, phi));
    const Real factor = angle > 0.0 ? sin(0.5 * angle) / angle : 0.5, w = cos(0.5 * angle);
    const Real sign = factor * dot3(phi, quaternion) + w * quaternion[3] < 0.0 ? -1.0 : 1.0;
    for (int i = 0; i < 3; i++)
        quaternion[i] = sign * factor * phi[i];
    quaternion[3] = sign * w;
}

void pins_put(const Pin *pin, Int n, const Real *value, Real *q)
{
    for (Int i = 0; i < n; i++) {
        const Int at = pin[i].q;
        if (!pin[i].turns) {
            q[at + pin[i].component] = value[i];
            continue;
        }
        Real phi[3];
        rotation_vector(q + at, phi);
        phi[pin[i].component] = value[i];
        while (i + 1 < n && pin[i + 1].q == at) {
            i++;
            phi[pin[i].component] = value[i];
        }
        put_rotation(phi, q + at);
    }
}

Real pin_value(const Pin *pin, const Real *q)
{
    Real phi[3];
    if (!pin->turns)
        return q[pin->q + pin->component];
    rotation_vector(q + pin->q, phi);
    return phi[pin->component];
}

Real pin_value_near(const Pin *pin, const Real *q, Real wanted)
{
    Real phi[3], own = pin_value(pin, q);
    if (!pin->turns)
        return own;
    rotation_vector(q + pin->q, phi);
    phi[pin->component] = 0.0;
    const int is_own_axis = sqrt(dot3(phi, phi)) <= TOLERANCE_TIGHT;
    return is_own_axis ? own + 2.0 * PI * nearbyint((wanted - own) / (2.0 * PI)) : own;
}

/* g and its derivative by t², at t² = s. */
void rotation_factors(Real s, Real *g, Real *slope)
{
    static const Real series[6] = {1.0 / 12.0,      1.0 / 720.0,      1.0 / 30240.0,
                                   1.0 / 1209600.0, 1.0 / 47900160.0, 691.0 / 1307674368000.0};
    *g = *slope = 0.0;
    if (s < SMALL_SQUARE) {
        for (int i = 5; i >= 0; i--) {
            *slope = *slope * s + *g;
            *g = *g * s + series[i];
        }
        return;
    }
    const Real h = 0.5 * sqrt(s), cot = h / tan(h), over = h / sin(h);
    *g = (1.0 - cot) / s;
    *slope = (over * over + cot - 2.0) / (2.0 * s * s);
}

/* Component of the position: a row of the rotation matrix of the quaternion behind it. */
static void position_row(const Real *q, Int component, Real *row)
{
    const Real *u = q + 3, w = q[6];
    Real axis[3] = {0.0, 0.0, 0.0}, once[3], twice[3];
    axis[component] = 1.0;
    cross3(axis, u, once); /* turned back by the quaternion: a + 2 w a x u + 2 (a x u) x u */
    cross3(once, u, twice);
    for (int i = 0; i < 3; i++)
        row[i] = axis[i] + 2.0 * w * once[i] + 2.0 * twice[i];
}

void rotation_vector_row(const Real *phi, Int component, Real *row)
{
    Real axis[3] = {0.0, 0.0, 0.0}, once[3], twice[3], g, slope;
    rotation_factors(dot3(phi, phi), &g, &slope);
    axis[component] = 1.0;
    cross3(axis, phi, once);
    cross3(once, phi, twice);
    for (int i = 0; i < 3; i++)
        row[i] = axis[i] + 0.5 * once[i] + g * twice[i];
}

void pin_row(const Pin *pin, const Real *q, Real *row)
{
    Real phi[3];
    if (!pin->turns) {
        position_row(q + pin->q, pin->component, row);
        return;
    }
    rotation_vector(q + pin->q, phi);
    rotation_vector_row(phi, pin->component, row);
}

void pin_scaled_row(const Kernel *k, const Pin *pin, Real *row)
{
    const Real *scale = k->scale + pin->v;
    pin_row(pin, k->q, row);
    for (int x = 0; x < 3; x++)
        row[x] = row[x] * scale[x] / scale[pin->component];
}

/* phi'' at w' = 0: the formula of phi', phi and g taking turns to change. */
static void rotation_bias(const Real *phi, const Real *w, Real *bias)
{
    Real g, slope, once[3], twice[3], rate[3], turned[3], first[3], second[3];
    rotation_factors(dot3(phi, phi), &g, &slope);
    cross3(phi, w, once);
    cross3(phi, once, twice);
    for (int i = 0; i < 3; i++)
        rate[i] = w[i] + 0.5 * once[i] + g * twice[i];
    cross3(rate, w, turned);
    cross3(rate, once, first);
    cross3(phi, turned, second);
    const Real change = 2.0 * slope * dot3(phi, rate);
    for (int i = 0; i < 3; i++)
        bias[i] = 0.5 * turned[i] + g * (first[i] + second[i]) + change * twice[i];
}

/* Of a position x' = R v it is R (w x v). */
Real pin_bias(const Pin *pin, const Real *q, const Real *v)
{
    const Real *here = v + pin->v;
    Real phi[3], bias[3], row[3];
    if (!pin->turns) {
        cross3(here + 3, here, bias);
        position_row(q + pin->q, pin->component, row);
        return dot3(row, bias);
    }
    rotation_vector(q + pin->q, phi);
    rotation_bias(phi, here, bias);
    return bias[pin->component];
}
