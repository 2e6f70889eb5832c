/* Springs and dampers between points of two bodies: their forces on these. */
#include "springs.h"

void body_point(const Kernel *k, Int j, const Real *local, Real *at, Real *velocity)
{
    Real arm[3];
    rotate3(k->R + 9 * j, local, arm);
    copy3(k->p + 3 * j, at);
    add3(1.0, arm, at);
    cross3(k->omega + 3 * j, arm, velocity);
    add3(1.0, k->velocity + 3 * j, velocity);
}

#define COINCIDENT 1e-15 /* part of a position that is round-off */

Line spring_line(const Kernel *k, const Springs *s, Int i)
{
    Line line;
    Real first[3], v1[3], v2[3];
    body_point(k, s->line_body[2 * i], s->line_point + 6 * i, first, v1);
    body_point(k, s->line_body[2 * i + 1], s->line_point + 6 * i + 3, line.end, v2);
    copy3(line.end, line.along);
    add3(-1.0, first, line.along);
    add3(-1.0, v1, v2);
    line.length = sqrt(dot3(line.along, line.along));
    if (line.length <= COINCIDENT * sqrt(dot3(line.end, line.end))) { /* it parts as it moves */
        line.length = 0.0;
        copy3(v2, line.along);
    }
    const Real size = sqrt(dot3(line.along, line.along));
    for (int c = 0; c < 3; c++)
        line.along[c] = size > 0.0 ? line.along[c] / size : 0.0;
    line.rate = dot3(line.along, v2);
    return line;
}

int spring_force(Springs *s, Int which, Int has_law, const Real *spring, Real length, Real rate, Real *force)
{
    if (has_law)
        return s->law(which, length, rate, force);
    const Real elastic = spring[0] * (length - spring[2]);
    *force = elastic + spring[1] * rate;
    s->power += elastic * rate;
    return DONE;
}

int springs_on_bodies(const Kernel *k, Springs *s)
{
    for (Int i = 0; i < s->n_lines; i++) {
        const Line line = spring_line(k, s, i);
        Real force = 0.0, moment[3];
        s->n_coincident += line.length == 0.0;
        const int code = spring_force(s, i, s->line_law[i], s->line_spring + 3 * i, line.length, line.rate, &force);
        if (code != DONE)
            return code;
        s->power -= force * line.rate;
        cross3(line.end, line.along, moment);
        for (int side = 0; side < 2; side++) {
            const Int at = 3 * s->line_body[2 * i + side];
            const Real sign = side ? 1.0 : -1.0; /* pulled back towards the first */
            add3(sign * force, line.along, s->force + at);
            add3(sign * force, moment, s->moment + at);
        }
    }
    return bushings_on_bodies(k, s);
}
