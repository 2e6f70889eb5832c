/* Coordinates of joints relative to a configuration. */
#include <string.h>

#include "pins.h"
#include "relative.h"

/* The rotation vector (3) from one quaternion to another. */
static void rotation_between(const Real *from, const Real *to, Real *vector)
{
    Real turn[4], side[3];
    cross3(from, to, side);
    for (int i = 0; i < 3; i++)
        turn[i] = from[3] * to[i] - to[3] * from[i] - side[i];
    turn[3] = from[3] * to[3] + dot3(from, to);
    rotation_vector(turn, vector);
}

/* Whether a component is a slide of a free joint. */
static int slides(const Kernel *k, Int j, Int component)
{
    return k->kind[j] == FREE && component < 3;
}

/* The quaternion of a joint, in some q. */
static const Real *quaternion(const Kernel *k, Int j, const Real *q)
{
    return q + k->iq[j] + (k->kind[j] == FREE ? 3 : 0);
}

/* The slide (3) of a free joint, along the axes at the start. */
static void slide_between(const Kernel *k, Int j, const Real *start, const Real *q, Real *slide)
{
    Real away[3], R[9];
    copy3(q + k->iq[j], away);
    add3(-1.0, start + k->iq[j], away);
    quaternion_rotation(quaternion(k, j, start), R);
    rotate_back3(R, away, slide);
}

Real relative_coordinate(const Kernel *k, Int j, Int component, const Real *start, const Real *q)
{
    const Int at = k->iq[j];
    const Real scale = k->scale[k->iv[j] + component];
    Real away[3];
    if (joint_nv(k->kind[j]) == 1)
        return (q[at] - start[at]) / scale;
    if (slides(k, j, component))
        slide_between(k, j, start, q, away);
    else
        rotation_between(quaternion(k, j, start), quaternion(k, j, q), away);
    return away[component % 3] / scale;
}

void relative_row(const Kernel *k, Int j, Int component, const Real *start, const Real *q,
                  Real *row)
{
    Real away[3], R[9], base[9], axis[3];
    if (!slides(k, j, component)) {
        rotation_between(quaternion(k, j, start), quaternion(k, j, q), away);
        rotation_vector_row(away, component % 3, row);
        return;
    }
    quaternion_rotation(quaternion(k, j, start), base);
    quaternion_rotation(quaternion(k, j, q), R);
    copy3(base + 3 * component, axis);
    rotate_back3(R, axis, row);
}

Real relative_rate_by(const Kernel *k, Int j, Int component, const Real *row, const Real *v)
{
    const Int first = k->iv[j], at = first + (k->kind[j] == FREE && component > 2 ? 3 : 0);
    Real sum = 0.0;
    for (int c = 0; c < 3; c++)
        sum += row[c] * k->scale[at + c] * v[at + c];
    return sum / k->scale[first + component];
}

/* ---- all joints ---- */

void relative_configuration(Kernel *k, const Real *start, const Real *x, Real *q)
{
    Real *step = k->right;
    memcpy(q, start, (size_t)k->nq * sizeof *q);
    for (Int v = 0; v < k->nv; v++)
        step[v] = k->scale[v] * x[v];
    for (Int j = 1; j < k->n_joints; j++) {
        Real R[9], *u = step + k->iv[j];
        if (k->kind[j] != FREE)
            continue;
        quaternion_rotation(quaternion(k, j, start), R);
        for (int c = 0; c < 3; c++)
            add3(u[c], R + 3 * c, q + k->iq[j]);
        zero3(u); /* it slides straight, then turns */
    }
    tree_integrate(k, q, step);
}

void relative_coordinates(const Kernel *k, const Real *start, const Real *q, Real *x)
{
    for (Int j = 1; j < k->n_joints; j++) {
        Real *own = x + k->iv[j];
        switch (k->kind[j]) {
        case FREE:
            slide_between(k, j, start, q, own);
            own += 3;
            /* fall through */
        case BALL:
            rotation_between(quaternion(k, j, start), quaternion(k, j, q), own);
            break;
        default:
            own[0] = q[k->iq[j]] - start[k->iq[j]];
        }
    }
    for (Int v = 0; v < k->nv; v++)
        x[v] /= k->scale[v];
}

void relative_rates(const Kernel *k, const Real *start, const Real *q, const Real *v, Real *rates)
{
    for (Int i = 0; i < k->nv; i++)
        k->right[i] = v[i] / k->scale[i];
    for (Int j = 1; j < k->n_joints; j++)
        for (Int c = 0; c < joint_nv(k->kind[j]); c++) {
            Real row[3];
            Real *rate = rates + k->iv[j] + c;
            *rate = k->right[k->iv[j] + c];
            if (joint_nv(k->kind[j]) == 1)
                continue;
            relative_row(k, j, c, start, q, row);
            *rate = relative_rate_by(k, j, c, row, k->right);
        }
}
