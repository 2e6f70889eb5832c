/* Products A . B of vectors that bodies carry, and how these and their rates change with q and v.
 *
 * A part y of A or B that a body carries moves with the motions S of the freedoms before it as
 *
 *     by q: dy = S y,  dy' = S y' + dS y,  dy'' = S y'' + 2 dS y' + (A x S + V x dS) y
 *     by v: dy' = S y,  dy'' = 2 S y' + (dS + v x S) y
 *
 * where S y = w x y for the rotation w of S, and for a point the velocity of S besides. So a product
 * and its rates change by wrenches on each of its bodies times S, dS and the rest:
 *
 *     y x z, and z as the force on a point y, for S y . z.
 *
 * Motions of what carries both bodies change nothing. The second derivatives by q are S_i S_j y . z
 * where the body carries y, i nearer to the ground than j, and S_i y . S_j z. */
#include <string.h>

#include "tree_bodies.h"

enum { SIDES = 2, COEFFICIENTS = 4 };

/* A part of a vector that a body carries, its rates and where it is from the body's origin. */
typedef struct {
    Real arm[3], value[3], rate[3], bend[3], flag;
} Part;

/* Both vectors of a product on one of its bodies, in the order A, B. */
typedef struct {
    Int body;
    Part part[2];
} Side;

static void put_part(const Tree *s, Int body, const Real *coefficients, Part *out)
{
    const Kernel *k = s->k;
    const Real *velocity = s->velocity + 6 * body, *motion = s->motion + 6 * body;
    Real more[3];
    out->flag = coefficients[3];
    rotate3(k->R + 9 * body, coefficients, out->arm);
    copy3(out->arm, out->value);
    cross3(velocity + 3, out->arm, out->rate);
    cross3(velocity + 3, out->rate, out->bend);
    cross3(motion + 3, out->arm, more);
    add3(1.0, more, out->bend);
    add3(out->flag, k->p + 3 * body, out->value);
    add3(out->flag, velocity, out->rate);
    add3(out->flag, motion, out->bend);
}

/* The sides of product i, and its whole vectors and their rates; returns the joint below which
   motions change it. */
static Int put_sides(const Tree *s, const TreeTask *task, Int i, Side *side, Real whole[2][3][3])
{
    Real points[2] = {0.0, 0.0};
    memset(whole, 0, 18 * sizeof(Real));
    for (int b = 0; b < SIDES; b++) {
        side[b].body = task->bodies[SIDES * i + b];
        for (int x = 0; x < 2; x++) {
            Part *part = side[b].part + x;
            put_part(s, side[b].body,
                     (x ? task->b_parts : task->a_parts) + COEFFICIENTS * (SIDES * i + b), part);
            add3(1.0, part->value, whole[x][0]);
            add3(1.0, part->rate, whole[x][1]);
            add3(1.0, part->bend, whole[x][2]);
            points[x] += part->flag;
        }
    }
    if (points[0] != 0.0 || points[1] != 0.0) /* places in the world, and no differences */
        return 0;
    Int one = side[0].body, other = side[1].body;
    while (one != other)
        if (one > other)
            one = s->k->parent[one];
        else
            other = s->k->parent[other];
    return one;
}

/* wrench += factor times that of S y . z, for a point or direction y. */
static void add_pull(Real factor, const Real *y, Real flag, const Real *z, Real *wrench)
{
    Real moment[3];
    cross3(y, z, moment);
    add3(factor * flag, z, wrench);
    add3(factor, moment, wrench + 3);
}

static Real times(const Real *wrench, const Real *motion) { return dot(wrench, motion, 6); }

static void carry_pull(const Real *arm, Real *wrench)
{
    Real moment[3];
    cross3(arm, wrench, moment);
    add3(1.0, moment, wrench + 3);
}

static void put_product(Tree *s, const TreeTask *task, Int i)
{
    const Kernel *k = s->k;
    const Int n = task->n_products, nv = k->nv;
    Side side[SIDES];
    Real whole[2][3][3];
    const Int stop = put_sides(s, task, i, side, whole);
    const Real(*A)[3] = whole[0], (*B)[3] = whole[1];
    task->values[i] = dot3(A[0], B[0]);
    task->values[n + i] = dot3(A[1], B[0]) + dot3(A[0], B[1]);
    task->values[2 * n + i] = dot3(A[2], B[0]) + 2.0 * dot3(A[1], B[1]) + dot3(A[0], B[2]);
    for (int b = 0; b < SIDES; b++) {
        Real still[6] = {0.0}, moving[6] = {0.0}, bending[6] = {0.0};
        for (int x = 0; x < 2; x++) {
            const Part *y = side[b].part + x;
            const Real(*z)[3] = whole[1 - x];
            add_pull(1.0, y->arm, y->flag, z[0], still);
            add_pull(1.0, y->arm, y->flag, z[1], moving);
            add_pull(1.0, y->rate, 0.0, z[0], moving);
            add_pull(1.0, y->arm, y->flag, z[2], bending);
            add_pull(2.0, y->rate, 0.0, z[1], bending);
            add_pull(1.0, y->bend, 0.0, z[0], bending);
        }
        for (Int j = side[b].body; j > stop; j = k->parent[j]) {
            for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
                const Real *S = s->column + 6 * v;
                const Freedom *f = s->freedoms + v;
                Real *by_q = task->product_by_q + i * nv + v, *by_v = task->product_by_v + i * nv + v;
                const Real first = times(still, S), second = times(moving, S);
                by_q[0] += first;
                by_q[n * nv] += second + times(still, f->turned);
                by_q[2 * n * nv] += times(bending, S) + 2.0 * times(moving, f->turned) +
                                    times(still, f->twice);
                by_v[n * nv] += first;
                by_v[2 * n * nv] += 2.0 * second + times(still, f->paced);
            }
            carry_pull(s->arm + 3 * j, still);
            carry_pull(s->arm + 3 * j, moving);
            carry_pull(s->arm + 3 * j, bending);
        }
    }
}

static Int put_bends(const Tree *s, const TreeTask *task, Int i, Bend *out)
{
    const Kernel *k = s->k;
    Side side[SIDES];
    Real whole[2][3][3];
    const Int stop = put_sides(s, task, i, side, whole);
    Bend *next = out;
    for (int b = 0; b < SIDES; b++) {
        Real reach[3] = {0.0};
        for (Int j = side[b].body; j > stop; j = k->parent[j]) {
            for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++, next++) {
                const Real *S = s->column + 6 * v;
                *next = (Bend){.v = v, .joint = j, .side = b};
                for (int x = 0; x < 2; x++) {
                    const Part *y = side[b].part + x;
                    Real from[3], more[3];
                    copy3(y->arm, from);
                    add3(y->flag, reach, from);
                    cross3(S + 3, from, next->moved[x]);
                    add3(y->flag, S, next->moved[x]);
                    cross3(next->moved[x], whole[1 - x][0], more);
                    add3(1.0, more, next->turn);
                }
            }
            add3(1.0, s->arm + 3 * j, reach);
        }
    }
    return next - out;
}

/* Add the second derivatives by q of product i, times its weight. */
static void add_bending(Tree *s, const TreeTask *task, Int i)
{
    const Int nv = s->k->nv;
    const Real weight = task->weights[i];
    const Int n = put_bends(s, task, i, s->bends);
    for (Int a = 0; a < n; a++) {
        const Bend *one = s->bends + a;
        for (Int c = 0; c < n; c++) {
            const Bend *other = s->bends + c;
            Real sum = dot3(one->moved[0], other->moved[1]) + dot3(other->moved[0], one->moved[1]);
            if (one->side == other->side)
                sum += one->joint >= other->joint ? dot3(s->column + 6 * other->v + 3, one->turn)
                                                  : dot3(s->column + 6 * one->v + 3, other->turn);
            task->bent[one->v * nv + other->v] += weight * sum;
        }
    }
}

void put_products(Tree *s, const TreeTask *task)
{
    for (Int i = 0; i < task->n_products; i++) {
        if (task->values)
            put_product(s, task, i);
        if (task->bent && task->weights[i] != 0.0)
            add_bending(s, task, i);
    }
}
