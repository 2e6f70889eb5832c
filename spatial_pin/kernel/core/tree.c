/* The tree of joints: placements, joint Jacobian, rates of the bodies, displacements.
 *
 * The joint axis is the local z axis. Quaternions are (x, y, z, w); velocities of balls and free
 * joints are in the axes of the body, as in Pinocchio. */
#include <string.h>

#include "kernel.h"

/* Placement of the joint's frame before it moves: its origin, and its rotation: one that is there, or
   put into `own`. The world's frame changes nothing. */
WITHIN const Number *fixed_placement(const Evaluated *s, Int j, Number *p, Number *own)
{
    const Kernel *k = kernel_of(s);
    const Int up = k->parent[j];
    const Number *parent = s->R + 9 * up;
    if (up == 0) {
        copy3(s->translation + 3 * j, p);
        return s->rotation + 9 * j;
    }
    rotate3(parent, s->translation + 3 * j, p);
    add3(1.0, s->p + 3 * up, p);
    if (k->plain[j])
        return parent;
    product3(parent, s->rotation + 9 * j, own);
    return own;
}

/* R = fixed * rotation about z */
WITHIN void turn_about_z(const Number *fixed, Number angle, Number *restrict R)
{
    Number s, c;
    sine_and_cosine(angle, &s, &c);
    for (int i = 0; i < 3; i++) {
        R[i] = c * fixed[i] + s * fixed[3 + i];
        R[3 + i] = c * fixed[3 + i] - s * fixed[i];
        R[6 + i] = fixed[6 + i];
    }
}

/* Whether entries are the same to the last bit. */
WITHIN int are_same(const Number *a, const Number *b, Int n)
{
    for (Int i = 0; i < n; i++)
        if (memcmp(a + i, b + i, sizeof *a) != 0)
            return 0;
    return 1;
}

/* Joints that have not moved, as those that are driven while others are corrected, and all
 * before them do, are placed already. */
SHARED void tree_place(Evaluated *s, const Number *q)
{
    const Kernel *k = kernel_of(s);
    const int is_placed = s->is_placed;
    s->is_placed = 1;
    for (Int j = 1; j < k->n_joints; j++) {
        const Int at = k->iq[j];
        s->moves[j] = !is_placed || s->moves[k->parent[j]] ||
                      !are_same(q + at, s->q + at, joint_nq(k->kind[j]));
        if (!s->moves[j])
            continue;
        Number *R = s->R + 9 * j, *p = s->p + 3 * j, turned[9], own[9];
        const Number *x = q + at, *fixed = fixed_placement(s, j, p, turned);
        switch (k->kind[j]) {
        case SLIDE:
            for (int i = 0; i < 9; i++)
                R[i] = fixed[i];
            add3(k->pitch[j] * x[0], R + 6, p);
            break;
        case TURN:
            turn_about_z(fixed, x[0], R);
            break;
        case SCREW:
            turn_about_z(fixed, x[0], R);
            add3(k->pitch[j] * x[0], R + 6, p);
            break;
        case FREE:
            for (int c = 0; c < 3; c++)
                add3(x[c], fixed + 3 * c, p);
            x += 3;
            /* fall through */
        default:
            quaternion_rotation(x, own);
            product3(fixed, own, R);
        }
    }
    memcpy(s->q, q, (size_t)k->nq * sizeof *q);
}

SHARED void tree_columns(Evaluated *s)
{
    const Kernel *k = kernel_of(s);
    for (Int j = 1; j < k->n_joints; j++) {
        const Number *R = s->R + 9 * j, *p = s->p + 3 * j;
        Number *linear = s->linear + 3 * k->iv[j], *angular = s->angular + 3 * k->iv[j];
        switch (k->kind[j]) {
        case SLIDE:
            multiple3(k->pitch[j], R + 6, linear);
            break;
        case TURN:
        case SCREW:
            copy3(R + 6, angular);
            cross3(p, angular, linear);
            if (k->kind[j] == SCREW)
                add3(k->pitch[j], R + 6, linear);
            break;
        case FREE:
            for (int c = 0; c < 3; c++)
                copy3(R + 3 * c, linear + 3 * c);
            linear += 9, angular += 9;
            /* fall through */
        default:
            for (int c = 0; c < 3; c++) {
                copy3(R + 3 * c, angular + 3 * c);
                cross3(p, angular + 3 * c, linear + 3 * c);
            }
        }
    }
}

/* Velocity of the body relative to its parent: slide and turn, world axes. */
WITHIN void joint_rate(const Evaluated *s, Int j, const Number *v, Number *slide, Number *turn)
{
    const Kernel *k = kernel_of(s);
    const Number *R = s->R + 9 * j, *x = v + k->iv[j];
    zero3(slide);
    zero3(turn);
    switch (k->kind[j]) {
    case TURN:
        multiple3(x[0], R + 6, turn);
        break;
    case SCREW:
        multiple3(x[0], R + 6, turn);
        /* fall through */
    case SLIDE:
        multiple3(k->pitch[j] * x[0], R + 6, slide);
        break;
    case FREE:
        rotate3(R, x, slide);
        x += 3;
        /* fall through */
    default:
        rotate3(R, x, turn);
    }
}

/* With w the parent's angular velocity, r the arm from its origin to the joint's, u and t the
 * slide and turn of the joint:  velocity = vp + w x r + u,  acceleration = ap + alphap x r +
 * w x (w x r) + w x u + (w + t) x u,  omega = w + t,  alpha = alphap + w x t. */
SHARED void tree_rates(Evaluated *s, const Number *v)
{
    const Kernel *k = kernel_of(s);
    for (Int j = 1; j < k->n_joints; j++) {
        const Int up = 3 * k->parent[j], at = 3 * j;
        Number arm[3], swing[3], slide[3], turn[3], more[3], body[3];
        Number *acceleration = s->acceleration + at;
        joint_rate(s, j, v, slide, turn);
        if (up == 0) { /* the world does not move */
            copy3(slide, s->velocity + at);
            copy3(turn, s->omega + at);
            cross3(turn, slide, acceleration);
            zero3(s->alpha + at);
            continue;
        }
        copy3(s->p + at, arm);
        add3(-1.0, s->p + up, arm);
        cross3(s->omega + up, arm, swing);
        copy3(s->velocity + up, s->velocity + at);
        add3(1.0, swing, s->velocity + at);
        add3(1.0, slide, s->velocity + at);
        copy3(s->omega + up, body);
        add3(1.0, turn, body);
        copy3(s->acceleration + up, acceleration);
        cross3(s->alpha + up, arm, more);
        add3(1.0, more, acceleration);
        add3(1.0, slide, swing); /* w x (w x r) + w x u */
        cross3(s->omega + up, swing, more);
        add3(1.0, more, acceleration);
        if (k->kind[j] != TURN) {
            cross3(body, slide, more);
            add3(1.0, more, acceleration);
        }
        cross3(s->omega + up, turn, more);
        copy3(s->alpha + up, s->alpha + at);
        add3(1.0, more, s->alpha + at);
        copy3(body, s->omega + at);
    }
}

WITHIN void normalize_quaternion(Number *x)
{
    const Number square = dot3(x, x) + x[3] * x[3];
    Number size;
    for (int i = 0; i < N_PARTS; i++)
        PART(size, i) = sqrt(PART(square, i));
    for (int i = 0; i < 4; i++)
        x[i] /= size;
}

SHARED void tree_normalize(const Kernel *k, Number *q)
{
    for (Int j = 1; j < k->n_joints; j++)
        if (k->kind[j] >= BALL)
            normalize_quaternion(q + k->iq[j] + (k->kind[j] == FREE ? 3 : 0));
}

#if N_PARTS == 1

/* They are linear: a joint adds du to the acceleration and dt to alpha of what it carries, besides
 * what reaches it from the ground. */
void tree_accelerate(Kernel *k, const Real *a)
{
    for (Int j = 1; j < k->n_joints; j++) {
        const Int up = k->parent[j];
        Real *slide = k->added + 6 * j, *turn = slide + 3, arm[3], more[3];
        joint_rate(k, j, a, slide, turn);
        if (up > 0) {
            copy3(k->p + 3 * j, arm);
            add3(-1.0, k->p + 3 * up, arm);
            cross3(k->added + 6 * up + 3, arm, more);
            add3(1.0, more, slide);
            add3(1.0, k->added + 6 * up, slide);
            add3(1.0, k->added + 6 * up + 3, turn);
        }
        add3(1.0, slide, k->acceleration + 3 * j);
        add3(1.0, turn, k->alpha + 3 * j);
    }
}

/* b = (1 - cos t)/t² and c = (t - sin t)/t³ where t² is `square`; series for small angles. */
static void exponential_factors(Real square, Real *b, Real *c)
{
    if (square < 1e-2) { /* the terms left out are below 1e-17 of the first */
        *b = 0.5 * (1.0 - square / 12.0 * (1.0 - square / 30.0 *
             (1.0 - square / 56.0 * (1.0 - square / 90.0))));
        *c = (1.0 - square / 20.0 * (1.0 - square / 42.0 *
             (1.0 - square / 72.0 * (1.0 - square / 110.0)))) / 6.0;
    } else {
        const Real angle = sqrt(square), half = sin(0.5 * angle);
        *b = 2.0 * half * half / square;
        *c = (angle - sin(angle)) / (square * angle);
    }
}

/* x += R(quaternion) (u + b w x u + c w x (w x u)): the slide of a screw motion (u, w). */
static void slide_along(const Real *quaternion, const Real *u, const Real *w, Real *x)
{
    Real b, c, once[3], twice[3], slide[3], R[9], moved[3];
    exponential_factors(dot3(w, w), &b, &c);
    cross3(w, u, once);
    cross3(w, once, twice);
    copy3(u, slide);
    add3(b, once, slide);
    add3(c, twice, slide);
    quaternion_rotation(quaternion, R);
    rotate3(R, slide, moved);
    add3(1.0, moved, x);
}

/* x becomes x * exp(w / 2). */
static void turn_quaternion(Real *x, const Real *w)
{
    const Real half = 0.5 * sqrt(dot3(w, w));
    const Real factor = half < 1e-8 ? 0.5 : 0.5 * sin(half) / half, c = cos(half);
    Real pure[3] = {factor * w[0], factor * w[1], factor * w[2]}, added[4];
    times_pure(x, pure, added);
    for (int i = 0; i < 4; i++)
        x[i] = c * x[i] + added[i];
    normalize_quaternion(x);
}

/* Of the two quaternions of a rotation take the one nearer to that before the turn w: Pinocchio
 * does so for free joints, not for balls. */
static void stay_near(Real *x, const Real *w)
{
    if (cos(0.5 * sqrt(dot3(w, w))) < 0.0)
        for (int i = 0; i < 4; i++)
            x[i] = -x[i];
}

void tree_integrate(const Kernel *k, Real *q, const Real *step)
{
    for (Int j = 1; j < k->n_joints; j++) {
        Real *x = q + k->iq[j];
        const Real *s = step + k->iv[j];
        switch (k->kind[j]) {
        case FREE:
            slide_along(x + 3, s, s + 3, x);
            turn_quaternion(x + 3, s + 3);
            stay_near(x + 3, s + 3);
            break;
        case BALL:
            turn_quaternion(x, s);
            break;
        default:
            x[0] += s[0];
        }
    }
}

/* Derivatives of a quaternion at the body's angular velocity w and acceleration alpha. */
static void quaternion_rates(const Real *x, const Real *w, const Real *alpha, Real *first,
                             Real *second)
{
    Real again[4];
    times_pure(x, w, first);
    for (int i = 0; i < 4; i++)
        first[i] *= 0.5;
    times_pure(x, alpha, second);
    times_pure(first, w, again);
    for (int i = 0; i < 4; i++)
        second[i] = 0.5 * (second[i] + again[i]);
}

void tree_entry_rates(const Kernel *k, const Real *q, const Real *v, const Real *a, Real *first,
                      Real *second)
{
    for (Int j = 1; j < k->n_joints; j++) {
        Int iq = k->iq[j], iv = k->iv[j];
        switch (k->kind[j]) {
        case FREE: {
            Real R[9], sliding[3];
            quaternion_rotation(q + iq + 3, R);
            rotate3(R, v + iv, first + iq);
            cross3(v + iv + 3, v + iv, sliding);
            add3(1.0, a + iv, sliding);
            rotate3(R, sliding, second + iq);
            iq += 3, iv += 3;
        }
            /* fall through */
        case BALL:
            quaternion_rates(q + iq, v + iv, a + iv, first + iq, second + iq);
            break;
        default:
            first[iq] = v[iv];
            second[iq] = a[iv];
        }
    }
}

#endif
