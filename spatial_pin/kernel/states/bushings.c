/* Springs and dampers between two frames in all six directions: see dynamics/bushings.py. The pose of
 * frame 2 in frame 1 is x = (p, phi); the force F = K x + D x' + f0 by x pulls it back. */
#include "pins.h"
#include "springs.h"

/* Where a bushing stands in the numbers: two frames (rotation by columns, origin), K, D, f0, and the
   energy at x = 0. */
enum { FRAME = 12, STIFFNESS = 24, DAMPING = 60, PRELOAD = 96, STORED = 102 };

typedef struct {
    Real x[6], rate[6];
    Real turn[9], end[3]; /* axes of frame 1, and the origin of frame 2, in the world */
} Bend;

/* The quaternion of a rotation [Shepperd1978]. */
static void rotation_quaternion(const Real *R, Real *quaternion)
{
    const Real trace = R[0] + R[4] + R[8];
    int most = 3;
    Real size = trace;
    for (int i = 0; i < 3; i++)
        if (R[4 * i] > size)
            most = i, size = R[4 * i];
    const Real root = sqrt(1.0 + 2.0 * size - trace), part = 0.5 / root;
    if (most == 3) {
        quaternion[3] = 0.5 * sqrt(1.0 + trace);
        for (int i = 0; i < 3; i++) {
            const int j = (i + 1) % 3, l = (i + 2) % 3;
            quaternion[i] = 0.25 * (R[3 * j + l] - R[3 * l + j]) / quaternion[3];
        }
        return;
    }
    const int j = (most + 1) % 3, l = (most + 2) % 3;
    quaternion[most] = 0.5 * root;
    quaternion[j] = part * (R[3 * most + j] + R[3 * j + most]);
    quaternion[l] = part * (R[3 * most + l] + R[3 * l + most]);
    quaternion[3] = part * (R[3 * j + l] - R[3 * l + j]);
}

/* phi' = w - phi x w / 2 + g phi x (phi x w); its transpose has the other sign of the middle. */
static void by_turn(const Real *phi, const Real *w, Real sense, Real *out)
{
    Real g, slope, once[3], twice[3];
    rotation_factors(dot3(phi, phi), &g, &slope);
    cross3(phi, w, once);
    cross3(phi, once, twice);
    copy3(w, out);
    add3(-0.5 * sense, once, out);
    add3(g, twice, out);
}

static void frame_in_world(const Kernel *k, Int j, const Real *frame, Real *turn, Real *at)
{
    product3(k->R + 9 * j, frame, turn);
    rotate3(k->R + 9 * j, frame + 9, at);
    add3(1.0, k->p + 3 * j, at);
}

static Bend bend_of(const Kernel *k, const Springs *s, Int i)
{
    const Real *own = s->bushing + BUSHING_NUMBERS * i;
    const Int first = s->bushing_body[2 * i], second = s->bushing_body[2 * i + 1];
    Bend bend;
    Real start[3], second_turn[9], between[9], quaternion[4], arm[3], moved[3], once[3], spin[3];
    frame_in_world(k, first, own, bend.turn, start);
    frame_in_world(k, second, own + FRAME, second_turn, bend.end);
    for (int c = 0; c < 3; c++)
        rotate_back3(bend.turn, second_turn + 3 * c, between + 3 * c);
    rotation_quaternion(between, quaternion);
    rotation_vector(quaternion, bend.x + 3);
    copy3(bend.end, arm);
    add3(-1.0, start, arm);
    rotate_back3(bend.turn, arm, bend.x);

    copy3(k->velocity + 3 * second, moved); /* of the origin of frame 2, in body 1 */
    add3(-1.0, k->velocity + 3 * first, moved);
    for (int side = 0; side < 2; side++) {
        const Int j = side ? second : first;
        copy3(bend.end, arm);
        add3(-1.0, k->p + 3 * j, arm);
        cross3(k->omega + 3 * j, arm, once);
        add3(side ? 1.0 : -1.0, once, moved);
    }
    rotate_back3(bend.turn, moved, bend.rate);
    copy3(k->omega + 3 * second, once);
    add3(-1.0, k->omega + 3 * first, once);
    rotate_back3(bend.turn, once, spin);
    by_turn(bend.x + 3, spin, 1.0, bend.rate + 3);
    return bend;
}

static Real form6(const Real *matrix, const Real *x, Int row) { return dot(matrix + 6 * row, x, 6); }

int bushings_on_bodies(const Kernel *k, Springs *s)
{
    for (Int i = 0; i < s->n_bushings; i++) {
        const Real *own = s->bushing + BUSHING_NUMBERS * i;
        const Int law = s->bushing_law[i] - 1; /* the component that it is of */
        const Bend bend = bend_of(k, s, i);
        Real force[6], linear[3], angular[3], turned[3], moment[3];
        for (int c = 0; c < 6; c++) {
            const Real elastic = form6(own + STIFFNESS, bend.x, c) + own[PRELOAD + c];
            force[c] = elastic + form6(own + DAMPING, bend.rate, c);
            if (c == law) {
                const int code = s->law(s->first_bushing + i, bend.x[c], bend.rate[c], force + c);
                if (code != DONE)
                    return code;
            }
            s->power += (elastic - force[c]) * bend.rate[c];
        }
        by_turn(bend.x + 3, force + 3, -1.0, turned);
        rotate3(bend.turn, force, linear);
        rotate3(bend.turn, turned, angular);
        cross3(bend.end, linear, moment);
        add3(1.0, angular, moment);
        for (int side = 0; side < 2; side++) {
            const Int at = 3 * s->bushing_body[2 * i + side];
            add3(side ? 1.0 : -1.0, linear, s->force + at); /* pulled back towards the first */
            add3(side ? 1.0 : -1.0, moment, s->moment + at);
        }
    }
    return DONE;
}

Real bushings_energy(const Kernel *k, const Springs *s)
{
    Real stored = 0.0;
    for (Int i = 0; i < s->n_bushings; i++) {
        const Real *own = s->bushing + BUSHING_NUMBERS * i;
        const Bend bend = bend_of(k, s, i);
        stored += own[STORED];
        for (int c = 0; c < 6; c++)
            stored += (0.5 * form6(own + STIFFNESS, bend.x, c) + own[PRELOAD + c]) * bend.x[c];
    }
    return stored;
}
