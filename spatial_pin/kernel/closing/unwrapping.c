/* Angle unwrapping: whole turns taken off the angles of configurations, which are then nearest to the
 * values that somebody has named; and how far configurations are from these. */
#include "closing_parts.h"

static const Real WHOLE_TURN = 2.0 * PI;
/* Turns, by which an angle half a turn away may be beyond it by round-off: it is +pi, not -pi */
#define HALF_TURN_SLACK 1e-9

/* The angle that is nearest to a value, or a turn away from there where only that is in limits. */
static Real without_turns(Real angle, Real value, Real lower, Real upper)
{
    angle -= WHOLE_TURN * ceil((angle - value) / WHOLE_TURN - 0.5 - HALF_TURN_SLACK);
    if (angle > upper && angle - WHOLE_TURN >= lower)
        return angle - WHOLE_TURN;
    if (angle < lower && angle + WHOLE_TURN <= upper)
        return angle + WHOLE_TURN;
    return angle;
}

/* Take whole turns off angles: nearest to the named values, else to zero; held ones have their values. */
void unwrap_angles(const Kernel *k, const Named *named, Real *q)
{
    for (Int i = 0; i < k->nq; i++) {
        if (!(named->kinds[i] & TURNS))
            continue;
        const Real value = named->kinds[i] & (NAMED | HELD) ? named->value[i] : 0.0;
        q[i] = named->kinds[i] & HELD
                   ? value
                   : without_turns(q[i], value, named->lower[i], named->upper[i]);
    }
}

/* Square of the angle between two orientations, given by quaternions. */
static Real square_between(const Real *one, const Real *two)
{
    Real same = 0.0, opposite = 0.0;
    for (int i = 0; i < 4; i++) {
        same += (one[i] - two[i]) * (one[i] - two[i]);
        opposite += (one[i] + two[i]) * (one[i] + two[i]);
    }
    const Real angle = 4.0 * atan2(sqrt(same < opposite ? same : opposite),
                                   sqrt(same < opposite ? opposite : same));
    return angle * angle;
}

/* How far q (nq) is from the named values: angles, and lengths by the size of a unit of each. Floating joints
   have all components named, as their orientation is, or none. A turn that limits ask for is no way. */
Real named_distance(const Kernel *k, const Named *named, const Real *q)
{
    Real sum = 0.0;
    for (Int j = 1; j < k->n_joints; j++) {
        const Int at = k->iq[j], turning = at + (k->kind[j] == FREE ? 3 : 0);
        if (!(named->kinds[turning] & NAMED))
            continue;
        if (k->kind[j] >= BALL)
            sum += square_between(q + turning, named->value + turning);
        for (Int i = at; i < (k->kind[j] >= BALL ? turning : at + 1); i++) {
            Real gap = q[i] - named->value[i];
            if (named->kinds[i] & TURNS)
                gap -= WHOLE_TURN * floor(gap / WHOLE_TURN + 0.5);
            gap /= k->scale[k->iv[j] + i - at];
            sum += gap * gap;
        }
    }
    return sqrt(sum);
}
