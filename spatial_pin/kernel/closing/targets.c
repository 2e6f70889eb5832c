/* Targets: where frames and coordinates are wanted, as equations behind those of the loops; and how
 * far configurations are from where they started. Lengths are divided by a size. */
#include "closing_parts.h"
#include "pins.h"

#define TURNED_LITTLE 1e-8 /* sine of an angle that is its own sine to round-off */

static const Int *target_of(const Targets *t, Int i) { return t->of + TARGET_INTS * i; }

static const Real *number_of(const Targets *t, Int i) { return t->number + TARGET_REALS * i; }

static Int count_rows(const Int *of)
{
    switch (of[0]) {
    case POINT_TARGET:
        return (of[3] & 1) + (of[3] >> 1 & 1) + (of[3] >> 2 & 1);
    case TURN_TARGET:
        return 3;
    case DIRECTION_TARGET:
        return 2;
    default:
        return 1;
    }
}

Int targets_count(const Kernel *k, const Targets *t)
{
    Int rows = 0;
    for (Int i = 0; i < t->n; i++) {
        const Int *of = target_of(t, i), is_value = of[0] == VALUE_TARGET;
        if (!within(of[0], VALUE_TARGET + 1) || !within(of[1], is_value ? k->nq : k->n_joints) ||
            !within(of[2], is_value ? k->nv : k->n_joints))
            return -1;
        rows += count_rows(of);
    }
    return rows;
}

/* A point of a joint's body in the world. */
static void place_point(const Kernel *k, Int joint, const Real *local, Real *out)
{
    rotate3(k->R + 9 * joint, local, out);
    add3(1.0, k->p + 3 * joint, out);
}

/* The rotation (9, by columns) from a target to its frame. */
static void relative_rotation(const Kernel *k, Int joint, const Real *number, Real *out)
{
    Real turned[9];
    product3(k->R + 9 * joint, number, turned);
    for (int c = 0; c < 3; c++)
        rotate_back3(number + 9, turned + 3 * c, out + 3 * c);
}

static void turn_vector(const Kernel *k, Int joint, const Real *number, Real *phi)
{
    Real R[9], rows[9];
    relative_rotation(k, joint, number, R);
    for (int i = 0; i < 9; i++)
        rows[3 * (i % 3) + i / 3] = R[i];
    rotation_logarithm(rows, phi);
}

/* The vector from the first point of a distance to the second one; returns its length. */
static Real between(const Kernel *k, const Int *of, const Real *number, Real *out)
{
    Real first[3];
    place_point(k, of[1], number, first);
    place_point(k, of[2], number + 3, out);
    add3(-1.0, first, out);
    return sqrt(dot3(out, out));
}

/* Sine and cosine of the angle of a direction in a body, which is put into `arm`. */
static void pointed(const Kernel *k, const Int *of, const Real *number, Real *arm, Real *sine,
                    Real *cosine)
{
    rotate3(k->R + 9 * of[1], number, arm);
    *cosine = dot3(number + 3, arm);
    *sine = dot3(number + 6, arm);
}

/* An axis, its cosine with a direction, its parts across that, and their length, which is returned. */
static Real aside(const Kernel *k, const Int *of, const Real *number, Real *axis, Real *cosine,
                  Real *across)
{
    rotate3(k->R + 9 * of[1], number, axis);
    *cosine = dot3(number + 3, axis);
    across[0] = dot3(number + 6, axis);
    across[1] = dot3(number + 9, axis);
    return hypot(across[0], across[1]);
}

void targets_values(const Kernel *k, const Targets *t, Real *off)
{
    for (Int i = 0; i < t->n; i++) {
        const Int *of = target_of(t, i);
        const Real *number = number_of(t, i);
        Real x[3], across[2], cosine, sine;
        switch (of[0]) {
        case POINT_TARGET:
            place_point(k, of[1], number, x);
            for (int axis = 0; axis < 3; axis++)
                if (of[3] >> axis & 1)
                    *off++ = (x[axis] - number[3 + axis]) / t->size;
            continue;
        case TURN_TARGET:
            turn_vector(k, of[1], number, off);
            break;
        case DIRECTION_TARGET:
            sine = aside(k, of, number, x, &cosine, across);
            for (int a = 0; a < 2; a++)
                off[a] = sine < TURNED_LITTLE ? (cosine > 0.0 ? across[a] : a ? 0.0 : PI)
                                             : atan2(sine, cosine) / sine * across[a];
            break;
        case DISTANCE_TARGET:
            off[0] = (between(k, of, number, x) - number[6]) / t->size;
            break;
        case ANGLE_TARGET:
            pointed(k, of, number, x, &sine, &cosine);
            off[0] = atan2(sine, cosine) - number[9];
            off[0] -= 2.0 * PI * nearbyint(off[0] / (2.0 * PI));
            break;
        default:
            off[0] = (k->q[of[1]] - number[0]) / k->scale[of[2]];
        }
        off += count_rows(of);
    }
}

/* Add the rates of rows, linear in the velocity of a point of a body and in its angular velocity, for
   every freedom that carries the body. row: of each, the factors of both, 3 and 3. */
static void add_body_rows(const Kernel *k, Int joint, const Real *point, const Real (*row)[6], Int n,
                          Real sign, const Int *free_index, Int n_free, Real *to)
{
    for (Int j = joint; j > 0; j = k->parent[j])
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
            Real velocity[3];
            if (free_index[v] < 0)
                continue;
            cross3(k->angular + 3 * v, point, velocity);
            add3(1.0, k->linear + 3 * v, velocity);
            for (Int r = 0; r < n; r++)
                to[r * n_free + free_index[v]] +=
                    sign * k->scale[v] *
                    (dot3(row[r], velocity) + dot3(row[r] + 3, k->angular + 3 * v));
        }
}

/* Rows of the logarithm by the angular velocity of the frame: of phi' = w + phi x w / 2 + g phi x
   (phi x w), w in the frame's axes, see pins.c. */
static void turn_rows(const Kernel *k, Int joint, const Real *number, Real (*row)[6])
{
    Real phi[3], turned[9], part[3];
    turn_vector(k, joint, number, phi);
    product3(k->R + 9 * joint, number, turned);
    for (int i = 0; i < 3; i++) {
        rotation_vector_row(phi, i, part);
        zero3(row[i]);
        rotate3(turned, part, row[i] + 3);
    }
}

static void direction_rows(const Kernel *k, const Int *of, const Real *number, Real (*row)[6])
{
    Real axis[3], across[2], cosine, part[3];
    const Real sine = aside(k, of, number, axis, &cosine, across);
    const Real share = sine < TURNED_LITTLE ? 1.0 : atan2(sine, cosine) / sine;
    const Real bend = sine < TURNED_LITTLE ? 0.0 : (cosine * share - 1.0) / (sine * sine);
    for (int r = 0; r < 2; r++) {
        zero3(part);
        add3(share, number + 6 + 3 * r, part);
        add3(bend * across[r], number + 3, part);
        zero3(row[r]);
        cross3(axis, part, row[r] + 3); /* part . (w x axis) */
    }
}

/* The turn rate of a direction a about the axis that its angle is about, of its sine s and cosine c:
   (c s' - s c') / (c² + s²), s' = (a x sine's direction) . w */
static void angle_row(const Kernel *k, const Int *of, const Real *number, Real *row)
{
    Real arm[3], sine, cosine, part[3];
    pointed(k, of, number, arm, &sine, &cosine);
    const Real square = sine * sine + cosine * cosine;
    zero3(part);
    add3(cosine / square, number + 6, part);
    add3(-sine / square, number + 3, part);
    zero3(row);
    cross3(arm, part, row + 3);
}

void targets_put_rows(const Kernel *k, const Targets *t, const Int *free_index, Int n_free, Real *to)
{
    static const Real nowhere[3] = {0.0, 0.0, 0.0};
    for (Int i = 0; i < t->n; i++) {
        const Int *of = target_of(t, i), n = count_rows(of);
        const Real *number = number_of(t, i);
        Real row[3][6] = {{0.0}}, x[3], length;
        switch (of[0]) {
        case POINT_TARGET:
            for (int axis = 0, r = 0; axis < 3; axis++)
                if (of[3] >> axis & 1)
                    row[r++][axis] = 1.0 / t->size;
            place_point(k, of[1], number, x);
            add_body_rows(k, of[1], x, (const Real (*)[6])row, n, 1.0, free_index, n_free, to);
            break;
        case TURN_TARGET:
        case DIRECTION_TARGET:
        case ANGLE_TARGET:
            if (of[0] == TURN_TARGET)
                turn_rows(k, of[1], number, row);
            else if (of[0] == DIRECTION_TARGET)
                direction_rows(k, of, number, row);
            else
                angle_row(k, of, number, row[0]);
            add_body_rows(k, of[1], nowhere, (const Real (*)[6])row, n, 1.0, free_index, n_free, to);
            break;
        case DISTANCE_TARGET:
            length = between(k, of, number, x);
            row[0][0] = length > 0.0 ? 0.0 : 1.0 / t->size;
            if (length > 0.0)
                add3(1.0 / (length * t->size), x, row[0]);
            for (int end = 0; end < 2; end++) {
                place_point(k, of[1 + end], number + 3 * end, x);
                add_body_rows(k, of[1 + end], x, (const Real (*)[6])row, 1, end ? 1.0 : -1.0,
                              free_index, n_free, to);
            }
            break;
        default:
            if (free_index[of[2]] >= 0)
                to[free_index[of[2]]] = 1.0;
        }
        to += n * n_free;
    }
}

void targets_mark(const Kernel *k, const Targets *t, Int *moves)
{
    for (Int i = 0; i < t->n; i++) {
        const Int *of = target_of(t, i);
        if (of[0] == VALUE_TARGET) {
            moves[of[2]] = 1;
            continue;
        }
        for (int end = 1; end < (of[0] == DISTANCE_TARGET ? 3 : 2); end++)
            for (Int j = of[end]; j > 0; j = k->parent[j])
                for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++)
                    moves[v] = 1;
    }
}

/* ---- displacements ---- */

/* conj(a) b */
static void relative_quaternion(const Real *a, const Real *b, Real *out)
{
    cross3(b, a, out);
    add3(a[3], b, out);
    add3(-b[3], a, out);
    out[3] = dot3(a, b) + a[3] * b[3];
}

/* Of a floating joint log6 is (v, w) with v = p - w x p / 2 + g w x (w x p): |v|² = a |p|² +
   b (p . w)², with a = 1 + g s + 2 s² g', b = (1 - a) / s, s = |w|²; and by s a' = a g,
   b' = b g + 2 g'. */
static void floating_gradient(const Real *start, const Real *q, Real size, Real *out)
{
    Real relative[4], R[9], away[3], p[3], w[3], once[3], twice[3], g, slope;
    relative_quaternion(start + 3, q + 3, relative);
    rotation_vector(relative, w);
    quaternion_rotation(start + 3, R);
    copy3(q, away);
    add3(-1.0, start, away);
    rotate_back3(R, away, p);
    const Real s = dot3(w, w), pw = dot3(p, w), pp = dot3(p, p);
    rotation_factors(s, &g, &slope);
    const Real a = 1.0 + g * s + 2.0 * s * s * slope, b = -(g + 2.0 * s * slope);
    const Real square = size * size;
    Real pull[3] = {a * p[0], a * p[1], a * p[2]};
    add3(b * pw, w, pull);
    quaternion_rotation(relative, R);
    rotate_back3(R, pull, out);
    cross3(w, p, once);
    cross3(w, once, twice);
    for (int i = 0; i < 3; i++) {
        const Real v = p[i] - 0.5 * once[i] + g * twice[i];
        out[i] /= size;
        out[3 + i] = w[i] + ((a * g * pp + (b * g + 2.0 * slope) * pw * pw) * w[i] + b * pw * v) /
                                square;
    }
}

void displacement_gradient(const Kernel *k, const Real *start, const Real *q, Real *out)
{
    for (Int j = 1; j < k->n_joints; j++) {
        const Real *x = q + k->iq[j], *x0 = start + k->iq[j];
        Real *g = out + k->iv[j], relative[4];
        switch (k->kind[j]) {
        case FREE:
            floating_gradient(x0, x, k->scale[k->iv[j]], g);
            break;
        case BALL: /* the derivative of the rotation vector leaves its own direction */
            relative_quaternion(x0, x, relative);
            rotation_vector(relative, g);
            break;
        default:
            g[0] = (x[0] - x0[0]) / k->scale[k->iv[j]];
        }
    }
}
