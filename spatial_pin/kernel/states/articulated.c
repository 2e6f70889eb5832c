/* Motion, forces and accelerations of a tree, body by body [Featherstone2008, 5.3, 6.2, 7.3].
 *
 * The time grows with the number of joints, the memory too. Wrenches and motions are in world
 * axes, about the origin of each joint's own frame, so that the tip of a long chain has all its
 * digits: linear before angular, accelerations of origins as one sees them (classical ones).
 *
 * Joints that no loop is built on are eliminated by articulated-body inertias, from the tips
 * inwards; the core that remains is a tree of bodies with articulated inertias whose mass matrix
 * and forces a solver of the loops is given. Without loops there is no core. A joint of several
 * freedoms is eliminated one freedom after the other. */
#include <float.h>
#include <stdint.h>
#include <math.h>
#include <string.h>

#include "articulated.h"
#include "memory.h"
#include "tree_bodies.h"

/* Of the inertia about all axes, what a freedom must have to be more than round-off. */
#define LEAST_INERTIA TOLERANCE_ZERO

static int make_room(Tree *s)
{
    Kernel *k = s->k;
    const Int n = k->n_joints, nv = k->nv;
    s->is_core = kernel_ints(k, n);
    s->loads = kernel_memory(k, n, sizeof *s->loads);
    s->speeds = kernel_memory(k, n, sizeof *s->speeds);
    s->freedoms = kernel_memory(k, nv, sizeof *s->freedoms);
    s->bends = kernel_memory(k, 2 * nv, sizeof *s->bends);
    Real **const parts[] = {&s->armature, &s->own, &s->missing, &s->column, &s->pull, &s->arm,
                            &s->bias, &s->wrench, &s->needed, &s->motion, &s->velocity, &s->inertia,
                            &s->lacking};
    const Int sizes[] = {nv, nv, nv, 6 * nv, 6 * nv, 3 * n, 6 * n, 6 * n, 6 * n, 6 * n, 6 * n, 27 * n,
                         LANES * nv};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++)
        *parts[i] = kernel_reals(k, sizes[i]);
    return kernel_had_memory(k) ? DONE : NO_MEMORY;
}

EXPORT int tree_create(Kernel *k, const Int *is_core, Tree **out)
{
    *out = NULL;
    Tree *s = kernel_memory(k, 1, sizeof *s);
    if (!s)
        return NO_MEMORY;
    s->k = k;
    const int code = make_room(s);
    if (code != DONE)
        return code;
    memcpy(s->is_core, is_core, (size_t)k->n_joints * sizeof *is_core);
    *out = s;
    return DONE;
}

/* ---------------------------------------------------------------- motion */

static void put_columns(Tree *s, Int j)
{
    const Kernel *k = s->k;
    const Real *R = k->R + 9 * j;
    Real *column = s->column + 6 * k->iv[j];
    const Int n = joint_nv(k->kind[j]);
    memset(column, 0, (size_t)(6 * n) * sizeof *column);
    if (n == 1) {
        if (k->kind[j] != TURN)
            add3(k->pitch[j], R + 6, column);
        if (k->kind[j] != SLIDE)
            copy3(R + 6, column + 3);
        return;
    }
    for (Int i = 0; i < n; i++)
        copy3(R + 3 * (i % 3), column + 6 * i + (n == 3 || i > 2 ? 3 : 0));
}

/* From the parent's origin; places are not subtracted, which would cost digits far away. */
static void put_arm(Tree *s, Int j)
{
    const Kernel *k = s->k;
    const Int up = k->parent[j];
    Real *arm = s->arm + 3 * j;
    if (up == 0 || k->kind[j] == FREE) {
        copy3(k->p + 3 * j, arm);
        add3(-1.0, k->p + 3 * up, arm);
        return;
    }
    rotate3(k->R + 9 * up, k->translation + 3 * j, arm);
    if (k->kind[j] == SLIDE || k->kind[j] == SCREW)
        add3(k->pitch[j] * k->q[k->iq[j]], k->R + 9 * j + 6, arm);
}

/* motion += rate times the columns of a joint's freedoms */
static void add_freedoms(const Tree *s, Int j, const Real *rate, Real *motion)
{
    const Int first = s->k->iv[j], end = first + joint_nv(s->k->kind[j]);
    for (Int v = first; v < end; v++) {
        add3(rate[v], s->column + 6 * v, motion);
        add3(rate[v], s->column + 6 * v + 3, motion + 3);
    }
}

/* Places, velocities, and accelerations relative to the parents', with no joint's own; see
 * `tree_rates`. */
void move_bodies(Tree *s, const Real *q, const Real *v)
{
    Kernel *k = s->k;
    tree_place(k, q);
    for (Int j = 1; j < k->n_joints; j++) {
        const Int up = 6 * k->parent[j], at = 6 * j;
        Real *bias = s->bias + at, own[6] = {0.0}, along[3], more[3];
        const Real *before = s->velocity + up + 3;
        put_columns(s, j);
        put_arm(s, j);
        add_freedoms(s, j, v, own);
        carry_motion(s->velocity + up, s->arm + 3 * j, s->velocity + at);
        for (int i = 0; i < 6; i++)
            s->velocity[at + i] += own[i];
        cross3(before, s->arm + 3 * j, along);
        add3(1.0, own, along);
        cross3(before, along, bias);
        cross3(s->velocity + at + 3, own, more);
        add3(1.0, more, bias);
        cross3(before, own + 3, bias + 3);
    }
}

/* Accelerations of all bodies at those of the joints; of no joint's own where a is NULL. */
void accelerate_bodies(Tree *s, const Real *a)
{
    const Kernel *k = s->k;
    for (Int j = 1; j < k->n_joints; j++) {
        Real *motion = s->motion + 6 * j;
        carry_motion(s->motion + 6 * k->parent[j], s->arm + 3 * j, motion);
        for (int i = 0; i < 6; i++)
            motion[i] += s->bias[6 * j + i];
        if (a)
            add_freedoms(s, j, a, motion);
    }
}

/* ---------------------------------------------------------------- bodies */

/* Inertia of a body about the origin of its joint, and what its velocity and weight need. */
static void put_body(Tree *s, Int j)
{
    const Kernel *k = s->k;
    const Real *R = k->R + 9 * j, *I = k->bodies.inertia + 9 * j, *w = s->velocity + 6 * j + 3;
    const Real m = k->bodies.mass[j];
    Real *A = s->inertia + 27 * j, *B = A + 9, *C = A + 18, *p = s->wrench + 6 * j;
    Real c[3], turned[9], spin[3], moment[3];
    rotate3(R, k->bodies.com + 3 * j, c);
    memset(A, 0, 27 * sizeof *A);
    A[0] = A[4] = A[8] = m;
    B[1] = m * c[2], B[2] = -m * c[1], B[5] = m * c[0];
    B[3] = -B[1], B[6] = -B[2], B[7] = -B[5];
    for (int i = 0; i < 3; i++)
        rotate3(R, I + 3 * i, turned + 3 * i); /* columns of R I, for I is symmetric */
    for (int i = 0; i < 3; i++)
        for (int l = 0; l <= i; l++) {
            const Real sum = turned[i] * R[l] + turned[3 + i] * R[3 + l] + turned[6 + i] * R[6 + l];
            C[3 * i + l] = C[3 * l + i] = sum;
        }
    for (int i = 0; i < 3; i++)
        spin[i] = dot3(C + 3 * i, w);
    cross3(w, spin, moment);
    const Real square = dot3(c, c);
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < 3; l++)
            C[3 * i + l] += m * ((i == l ? square : 0.0) - c[i] * c[l]);
    cross3(w, c, spin);
    cross3(w, spin, p);
    for (int i = 0; i < 3; i++)
        p[i] = m * (p[i] - k->bodies.gravity[i]);
    cross3(c, p, p + 3);
    add3(1.0, moment, p + 3);
}

/* X r x, the rows of X times the matrix of the cross product. */
static void times_cross(const Real *X, const Real *r, Real *out)
{
    for (int i = 0; i < 3; i++)
        cross3(X + 3 * i, r, out + 3 * i); /* (xᵀ [r])ᵀ = x x r */
}

/* An inertia about a joint's origin, added to one about its parent's:
 * B' = B - A [r], C' = C - Bᵀ [r] + [r] B'. */
static void add_inertia(const Real *from, const Real *r, Real *to)
{
    const Real *A = from, *B = from + 9, *C = from + 18;
    Real moved[9], turned[9], back[9], again[9];
    times_cross(A, r, moved);
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < 3; l++)
            back[3 * i + l] = B[3 * l + i];
    times_cross(back, r, turned);
    for (int i = 0; i < 9; i++)
        moved[i] = B[i] - moved[i];
    for (int l = 0; l < 3; l++) {
        const Real column[3] = {moved[l], moved[3 + l], moved[6 + l]};
        Real crossed[3];
        cross3(r, column, crossed);
        for (int i = 0; i < 3; i++)
            again[3 * i + l] = crossed[i];
    }
    for (int i = 0; i < 9; i++) {
        to[i] += A[i];
        to[9 + i] += moved[i];
        moved[i] = C[i] - turned[i] + again[i];
    }
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < 3; l++)
            to[18 + 3 * i + l] += 0.5 * (moved[3 * i + l] + moved[3 * l + i]);
}

/* ---------------------------------------------------------------- forces of a motion */

/* Wrenches that the bodies need at their accelerations, each without what it carries. */
void put_needed(Tree *s)
{
    for (Int j = 1; j < s->k->n_joints; j++) {
        put_body(s, j);
        memcpy(s->needed + 6 * j, s->wrench + 6 * j, 6 * sizeof(Real));
        add_inertia_times(s->inertia + 27 * j, s->motion + 6 * j, s->needed + 6 * j);
    }
}

/* Wrenches that all bodies need with all that they carry, about their origins. */
void gather_wrenches(Tree *s, Real *tau, const Real *a)
{
    const Kernel *k = s->k;
    for (Int j = k->n_joints - 1; j > 0; j--) {
        const Real *wrench = s->needed + 6 * j;
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++)
            tau[v] = dot(wrench, s->column + 6 * v, 6) + (a ? s->armature[v] * a[v] : 0.0);
        if (k->parent[j])
            add_wrench(wrench, s->arm + 3 * j, s->needed + 6 * k->parent[j]);
    }
}

/* Entries of the mass matrix of some joints, whose inertias are those of all that they carry: for
 * every freedom, ascending, those with the freedoms of its own joint up to itself and of all joints
 * before it, from the nearest on. */
static void put_masses(const Tree *s, int all, Real *out)
{
    const Kernel *k = s->k;
    for (Int j = 1; j < k->n_joints; j++) {
        if (!all && !s->is_core[j])
            continue;
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
            Real force[6] = {0.0};
            add_inertia_times(s->inertia + 27 * j, s->column + 6 * v, force);
            for (Int w = k->iv[j]; w <= v; w++)
                *out++ = dot(force, s->column + 6 * w, 6) + (v == w ? s->armature[v] : 0.0);
            for (Int i = j; k->parent[i]; i = k->parent[i]) {
                Real moment[3];
                cross3(s->arm + 3 * i, force, moment);
                add3(1.0, moment, force + 3);
                const Int up = k->parent[i];
                for (Int w = k->iv[up]; w < k->iv[up] + joint_nv(k->kind[up]); w++)
                    *out++ = dot(force, s->column + 6 * w, 6);
            }
        }
    }
}

/* Add the inertias of bodies, from the tips inwards, to those that carry them: of all joints, or of the
 * core's. */
void gather_inertias(Tree *s, int all)
{
    const Kernel *k = s->k;
    for (Int j = k->n_joints - 1; j > 0; j--)
        if ((all || s->is_core[j]) && k->parent[j])
            add_inertia(s->inertia + 27 * j, s->arm + 3 * j, s->inertia + 27 * k->parent[j]);
}

/* ---------------------------------------------------------------- accelerations */

/* Take the freedoms of a joint out of its inertia and wrench; 0 where one has no inertia. */
static int eliminate(Tree *s, Int j, const Real *force)
{
    const Kernel *k = s->k;
    Real *A = s->inertia + 27 * j, *B = A + 9, *C = A + 18, *p = s->wrench + 6 * j;
    for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
        const Real *column = s->column + 6 * v;
        Real *pull = s->pull + 6 * v;
        memset(pull, 0, 6 * sizeof *pull);
        add_inertia_times(A, column, pull);
        const Real own = dot(pull, column, 6);
        const Real all = dot3(column, column) * (A[0] + A[4] + A[8]) +
                         dot3(column + 3, column + 3) * (C[0] + C[4] + C[8]);
        s->own[v] = own + s->armature[v];
        s->missing[v] = force[v] - dot(p, column, 6);
        if (!(own > LEAST_INERTIA * all) && !(s->armature[v] > LEAST_INERTIA * all))
            return 0;
        const Real by = 1.0 / s->own[v];
        for (int i = 0; i < 3; i++)
            for (int l = 0; l < 3; l++) {
                A[3 * i + l] -= pull[i] * by * pull[l];
                B[3 * i + l] -= pull[i] * by * pull[3 + l];
                C[3 * i + l] -= pull[3 + i] * by * pull[3 + l];
            }
        for (int i = 0; i < 6; i++)
            p[i] += pull[i] * (s->missing[v] * by);
    }
    return 1;
}

/* The eliminated freedoms of a joint, from the last on, where its body moves without them. */
static void restore(const Tree *s, Int j, Real *motion, Real *a)
{
    const Kernel *k = s->k;
    for (Int v = k->iv[j] + joint_nv(k->kind[j]) - 1; v >= k->iv[j]; v--) {
        a[v] = (s->missing[v] - dot(s->pull + 6 * v, motion, 6)) / s->own[v];
        add3(a[v], s->column + 6 * v, motion);
        add3(a[v], s->column + 6 * v + 3, motion + 3);
    }
}

/* Take all joints but the core's out of the inertias; SINGULAR where a freedom has no inertia. */
static int eliminate_limbs(Tree *s, const Real *force)
{
    const Kernel *k = s->k;
    for (Int j = k->n_joints - 1; j > 0; j--) {
        if (s->is_core[j])
            continue;
        if (!eliminate(s, j, force))
            return SINGULAR;
        add_inertia_times(s->inertia + 27 * j, s->bias + 6 * j, s->wrench + 6 * j);
        if (k->parent[j]) {
            add_wrench(s->wrench + 6 * j, s->arm + 3 * j, s->wrench + 6 * k->parent[j]);
            add_inertia(s->inertia + 27 * j, s->arm + 3 * j, s->inertia + 27 * k->parent[j]);
        }
    }
    return DONE;
}

/* Joint forces (nv) that the core needs without acceleration, where the rest is eliminated. */
static void put_core_forces(Tree *s, Real *needed)
{
    const Kernel *k = s->k;
    memset(s->needed, 0, (size_t)(6 * k->n_joints) * sizeof *needed);
    accelerate_bodies(s, NULL);
    for (Int j = 1; j < k->n_joints; j++)
        if (s->is_core[j]) {
            memcpy(s->needed + 6 * j, s->wrench + 6 * j, 6 * sizeof(Real));
            add_inertia_times(s->inertia + 27 * j, s->motion + 6 * j, s->needed + 6 * j);
        }
    gather_wrenches(s, needed, NULL);
}

EXPORT int tree_masses(Tree *s, const Real *q, const Real *v, const Real *force,
                       const Real *armature, Real *masses, Real *needed)
{
    const Kernel *k = s->k;
    memcpy(s->armature, armature, (size_t)k->nv * sizeof *armature);
    memset(s->missing, 0, (size_t)k->nv * sizeof *armature);
    move_bodies(s, q, v ? v : s->missing);
    for (Int j = 1; j < k->n_joints; j++)
        put_body(s, j);
    if (force && eliminate_limbs(s, force) != DONE)
        return SINGULAR;
    if (force)
        put_core_forces(s, needed);
    gather_inertias(s, !force);
    put_masses(s, !force, masses);
    return DONE;
}

/* Residual (nv) of the joint forces at accelerations a (nv). */
static void find_missing(Tree *s, const Real *a, const Real *force, Real *missing)
{
    accelerate_bodies(s, a);
    put_needed(s);
    gather_wrenches(s, missing, a);
    for (Int v = 0; v < s->k->nv; v++)
        missing[v] = force[v] - missing[v];
}

/* out += round-off of numbers (6), of signs as a coin gives them. */
static void add_rounding(const Real *numbers, uint64_t *coin, Real *out)
{
    for (int i = 0; i < 6; i++) {
        *coin = *coin * 6364136223846793005u + 1442695040888963407u;
        out[i] += (*coin >> 63 ? DBL_EPSILON : -DBL_EPSILON) * numbers[i];
    }
}

/* Joint forces (nv) that there may be too many or too few, after `find_missing`: every motion and
 * every wrench of a body is rounded once. */
static void find_rounding(Tree *s, Real *rounding)
{
    const Kernel *k = s->k;
    uint64_t coin = 1;
    for (Int j = 1; j < k->n_joints; j++) {
        Real off[6] = {0.0}, *moved = s->velocity + 6 * j; /* which nobody needs any more */
        carry_motion(s->velocity + 6 * k->parent[j], s->arm + 3 * j, moved);
        add_rounding(s->motion + 6 * j, &coin, moved);
        add_rounding(s->needed + 6 * j, &coin, off);
        add_inertia_times(s->inertia + 27 * j, moved, off);
        memcpy(s->needed + 6 * j, off, sizeof off);
    }
    gather_wrenches(s, rounding, NULL);
}

/* ---------------------------------------------------------------- responses */

/* Wrenches about a joint's origin, added to those about its parent's. */
static void add_loads(const Lanes *from, const Real *arm, Lanes *to)
{
    for (int i = 0; i < 6; i++)
        for (int l = 0; l < LANES; l++)
            to->x[i][l] += from->x[i][l];
    for (int i = 0; i < 3; i++) {
        const int y = (i + 1) % 3, z = (i + 2) % 3;
        for (int l = 0; l < LANES; l++)
            to->x[3 + i][l] += arm[y] * from->x[z][l] - arm[z] * from->x[y][l];
    }
}

/* As `carry_motion`. */
static void carry_lanes(const Lanes *from, const Real *arm, Lanes *motion)
{
    for (int i = 0; i < 3; i++) {
        const int y = (i + 1) % 3, z = (i + 2) % 3;
        for (int l = 0; l < LANES; l++) {
            motion->x[i][l] = from->x[i][l] + from->x[3 + y][l] * arm[z] - from->x[3 + z][l] * arm[y];
            motion->x[3 + i][l] = from->x[3 + i][l];
        }
    }
}

/* As `restore`, of one freedom. */
static void restore_lanes(const Tree *s, Int v, Lanes *motion, Real *const a[LANES])
{
    const Real *column = s->column + 6 * v, *pull = s->pull + 6 * v;
    Real own[LANES];
    memcpy(own, s->lacking + LANES * v, sizeof own);
    for (int i = 0; i < 6; i++)
        for (int l = 0; l < LANES; l++)
            own[l] -= pull[i] * motion->x[i][l];
    for (int l = 0; l < LANES; l++) {
        own[l] /= s->own[v];
        if (a[l])
            a[l][v] = own[l];
    }
    for (int i = 0; i < 6; i++)
        for (int l = 0; l < LANES; l++)
            motion->x[i][l] += column[i] * own[l];
}

static Real largest_of(const Kernel *k, const Real *a)
{
    Real most = 0.0;
    for (Int v = 0; v < k->nv; v++)
        most = fmax(most, fabs(a[v] / k->scale[v]));
    return most;
}

/* Accelerations (nv) of eliminated freedoms under joint forces (nv) alone, several at once, which
 * takes little longer than one; the core rests. Where a force is NULL, there is none. */
static void respond(Tree *s, const Real *const force[LANES], Real *const a[LANES])
{
    const Kernel *k = s->k;
    memset(s->loads, 0, (size_t)k->n_joints * sizeof *s->loads);
    for (Int j = k->n_joints - 1; j > 0; j--) {
        Lanes *p = s->loads + j;
        if (s->is_core[j])
            continue;
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
            const Real *column = s->column + 6 * v, *pull = s->pull + 6 * v, by = 1.0 / s->own[v];
            Real *missing = s->lacking + LANES * v;
            for (int l = 0; l < LANES; l++)
                missing[l] = force[l] ? force[l][v] : 0.0;
            for (int i = 0; i < 6; i++)
                for (int l = 0; l < LANES; l++)
                    missing[l] -= column[i] * p->x[i][l];
            for (int i = 0; i < 6; i++)
                for (int l = 0; l < LANES; l++)
                    p->x[i][l] += pull[i] * (missing[l] * by);
        }
        if (k->parent[j])
            add_loads(p, s->arm + 3 * j, s->loads + k->parent[j]);
    }
    for (Int j = 1; j < k->n_joints; j++) {
        Lanes *motion = s->loads + j; /* whose load nobody needs any more */
        if (s->is_core[j]) {
            memset(motion, 0, sizeof *motion);
            for (int l = 0; l < LANES; l++)
                if (a[l])
                    memset(a[l] + k->iv[j], 0, (size_t)joint_nv(k->kind[j]) * sizeof(Real));
            continue;
        }
        carry_lanes(s->loads + k->parent[j], s->arm + 3 * j, motion);
        for (Int v = k->iv[j] + joint_nv(k->kind[j]) - 1; v >= k->iv[j]; v--)
            restore_lanes(s, v, motion, a);
    }
}

static void respond_to_all(Tree *s, Int n, const Real *forces, Real *a)
{
    const Int nv = s->k->nv;
    for (Int i = 0; i < n; i += LANES) {
        const Real *force[LANES] = {NULL};
        Real *to[LANES] = {NULL};
        for (Int l = 0; l < LANES && i + l < n; l++) {
            force[l] = forces + (i + l) * nv;
            to[l] = a + (i + l) * nv;
        }
        respond(s, force, to);
    }
}

EXPORT void tree_accelerations(Tree *s, Int n, const Real *force, const Real *off, Real *a,
                               Real *scratch, Real *facts)
{
    if (n) {
        respond_to_all(s, n, force, a);
        return;
    }
    const Kernel *k = s->k;
    Real *missing = scratch, *rounding = missing + k->nv, *more = rounding + k->nv;
    Real *off_by = more + k->nv;
    for (Int j = 1; j < k->n_joints; j++) {
        Real *motion = s->motion + 6 * j;
        carry_motion(s->motion + 6 * k->parent[j], s->arm + 3 * j, motion);
        for (int i = 0; i < 6; i++)
            motion[i] += s->bias[6 * j + i];
        if (s->is_core[j])
            add_freedoms(s, j, a, motion);
        else
            restore(s, j, motion, a);
    }
    find_missing(s, a, force, missing);
    find_rounding(s, rounding);
    const Real *forces[LANES] = {missing, rounding, off};
    Real *const by[LANES] = {more, rounding, off_by};
    respond(s, forces, by);
    for (int l = 0; l < 3; l++)
        facts[1 + l] = largest_of(k, by[l]);
    for (Int v = 0; v < k->nv; v++)
        a[v] += more[v];
    facts[0] = largest_of(k, a);
}
