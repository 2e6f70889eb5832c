/* What a motion of a tree gives: its joint forces, and how they change with q and v
 * [SinghRussellWensing2022].
 *
 * Of joints j that carry joint i, or are it, with S the motions of freedoms, x and x* the cross
 * products of motions and of wrenches, I, B and f the inertia, the matrix of velocities and the
 * wrench of a body with all that it carries, V and A the twist and the acceleration of its parent:
 *
 *     dS = V x S,  ddS = A x S + V x dS,  2 B = v x* I - I v x + (d -> d x* I v)
 *     d tau_i / dq_j = S_i . (2 B_i dS_j + I_i ddS_j)
 *     d tau_i / dv_j = S_i . (2 B_i S_j + I_i (dS_j + v_j x S_j))
 *     d tau_j / dq_i = S_j . (2 B_i dS_i + I_i ddS_i + S_i x* f_i)
 *     d tau_j / dv_i = S_j . (2 B_i S_i + I_i (dS_i + v_i x S_i))
 *
 * As everywhere in a tree, all is in world axes about the origins of the joints' frames, so that
 * the tip of a long chain has all its digits. Of 2 B only the columns of rotations are not zero:
 * -2 h x with the momentum h, and D. */
#include <string.h>

#include "tree_bodies.h"

static void cross_motion(const Real *a, const Real *b, Real *out)
{
    Real more[3];
    cross3(a + 3, b, out);
    cross3(a, b + 3, more);
    add3(1.0, more, out);
    cross3(a + 3, b + 3, out + 3);
}

/* Momentum and D = w x C + (w x C)' - (C w) x - m ((v . c) terms), of a body about its origin. */
static void put_speed(const Tree *s, Int j, Speed *out)
{
    const Real *A = s->inertia + 27 * j, *B = A + 9, *C = A + 18, *v = s->velocity + 6 * j;
    const Real *w = v + 3, mc[3] = {B[5], B[6], B[1]};
    Real swung[3], angular[3], more[3], *D = out->D;
    cross3(w, mc, swung);
    for (int i = 0; i < 3; i++) {
        out->momentum[i] = A[0] * v[i] + swung[i];
        angular[i] = dot3(C + 3 * i, w);
    }
    cross3(mc, v, more);
    add3(1.0, more, angular);
    const Real along = 2.0 * dot3(mc, v);
    Real turning[9]; /* by rows; a column of C is a row */
    for (int l = 0; l < 3; l++) {
        Real column[3];
        cross3(w, C + 3 * l, column);
        for (int i = 0; i < 3; i++)
            turning[3 * i + l] = column[i];
    }
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < 3; l++)
            D[3 * i + l] = turning[3 * i + l] + turning[3 * l + i] - v[i] * mc[l] - mc[i] * v[l] +
                           (i == l ? along : 0.0);
    D[1] += angular[2], D[2] -= angular[1], D[5] += angular[0];
    D[3] -= angular[2], D[6] += angular[1], D[7] -= angular[0];
}

/* Speeds of bodies with all that they carry: D' = D - 2 r x h x. */
static void gather_speeds(const Kernel *k, const Real *arms, Speed *speed)
{
    for (Int j = k->n_joints - 1; j > 0; j--) {
        const Real *h = speed[j].momentum, *r = arms + 3 * j;
        Speed *up = speed + k->parent[j];
        const Real across = dot3(r, h);
        if (!k->parent[j])
            continue;
        add3(1.0, h, up->momentum);
        for (int i = 0; i < 3; i++)
            for (int l = 0; l < 3; l++)
                up->D[3 * i + l] += speed[j].D[3 * i + l] - 2.0 * (h[i] * r[l] - (i == l ? across : 0.0));
    }
}

static void add_two_B_times(const Speed *speed, const Real *spin, Real *out)
{
    Real swung[3];
    cross3(speed->momentum, spin, swung);
    add3(-2.0, swung, out);
    for (int i = 0; i < 3; i++)
        out[3 + i] += dot3(speed->D + 3 * i, spin);
}

/* Twist (6) and acceleration less gravity (3), as of a field, of what carries a joint. */
static void put_carrier(const Tree *s, Int j, const Real *gravity, Real *twist, Real *acceleration)
{
    const Kernel *k = s->k;
    const Int up = 6 * k->parent[j];
    Real field[6], swing[3];
    memcpy(field, s->motion + up, sizeof field);
    cross3(s->velocity + up + 3, s->velocity + up, swing);
    add3(-1.0, swing, field);
    add3(-1.0, gravity, field);
    carry_motion(s->velocity + up, s->arm + 3 * j, twist);
    carry_motion(field, s->arm + 3 * j, acceleration);
}

/* dS, ddS and dS + v x S of all freedoms, accelerations being less gravity. */
static void put_turning(Tree *s, const Real *gravity)
{
    const Kernel *k = s->k;
    for (Int j = 1; j < k->n_joints; j++) {
        Real twist[6], acceleration[6];
        put_carrier(s, j, gravity, twist, acceleration);
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
            const Real *S = s->column + 6 * v;
            Freedom *f = s->freedoms + v;
            Real more[6];
            cross_motion(twist, S, f->turned);
            cross_motion(acceleration, S, f->twice);
            cross_motion(twist, f->turned, more);
            cross_motion(s->velocity + 6 * j, S, f->paced);
            for (int i = 0; i < 6; i++) {
                f->twice[i] += more[i];
                f->paced[i] += f->turned[i];
            }
        }
    }
}

static void put_freedoms(const Tree *s, Int j, const Speed *speed, Freedom *of)
{
    const Kernel *k = s->k;
    const Real *inertia = s->inertia + 27 * j, *borne = s->needed + 6 * j, *h = speed->momentum;
    for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
        const Real *S = s->column + 6 * v;
        Freedom *f = of + v;
        Real more[6];
        memset(f->force, 0, sizeof f->force);
        memset(f->bent, 0, sizeof f->bent);
        memset(f->damped, 0, sizeof f->damped);
        cross3(h, S, more); /* S . (-2 h x spin) = 2 (h x S) . spin */
        for (int i = 0; i < 3; i++)
            f->by_spin[i] = 2.0 * more[i] + speed->D[i] * S[3] + speed->D[3 + i] * S[4] +
                            speed->D[6 + i] * S[5];
        add_inertia_times(inertia, S, f->force);
        add_inertia_times(inertia, f->twice, f->bent);
        add_two_B_times(speed, f->turned + 3, f->bent);
        cross3(S + 3, borne, more); /* S x* f */
        add3(1.0, more, f->bent);
        cross3(S + 3, borne + 3, more);
        add3(1.0, more, f->bent + 3);
        cross3(S, borne, more);
        add3(1.0, more, f->bent + 3);
        add_inertia_times(inertia, f->paced, f->damped);
        add_two_B_times(speed, S + 3, f->damped);
    }
}

/* A wrench about a joint's origin, about its parent's. */
static void carry_wrench(const Real *arm, Real *wrench)
{
    Real moment[3];
    cross3(arm, wrench, moment);
    add3(1.0, moment, wrench + 3);
}

/* The entries of a freedom v of joint j with those of its own joint and of all before it. */
static void put_entries(const Tree *s, const Freedom *of, Int j, Int v, Real *by_q, Real *by_v)
{
    const Kernel *k = s->k;
    const Int nv = k->nv;
    Freedom f = of[v];
    for (Int i = j; i; i = k->parent[i]) {
        for (Int w = k->iv[i]; w < k->iv[i] + joint_nv(k->kind[i]); w++) {
            const Real *S = s->column + 6 * w;
            const Freedom *g = of + w;
            by_q[w * nv + v] = dot3(f.by_spin, g->turned + 3) + dot(f.force, g->twice, 6);
            by_v[w * nv + v] = dot3(f.by_spin, S + 3) + dot(f.force, g->paced, 6);
            if (i == j)
                continue;
            by_q[v * nv + w] = dot(f.bent, S, 6);
            by_v[v * nv + w] = dot(f.damped, S, 6);
        }
        carry_wrench(s->arm + 3 * i, f.force);
        carry_wrench(s->arm + 3 * i, f.bent);
        carry_wrench(s->arm + 3 * i, f.damped);
    }
}

/* Where the bodies have their accelerations. */
static void put_derivatives(Tree *s, const Real *outside, Real *by_q, Real *by_v)
{
    const Kernel *k = s->k;
    put_needed(s);
    for (Int j = 1; j < k->n_joints; j++) {
        put_speed(s, j, s->speeds + j);
        for (int i = 0; i < 6; i++)
            s->needed[6 * j + i] -= outside[6 * j + i];
    }
    gather_wrenches(s, s->missing, NULL);
    gather_inertias(s, 1);
    gather_speeds(k, s->arm, s->speeds);
    put_turning(s, k->bodies.gravity);
    for (Int j = 1; j < k->n_joints; j++)
        put_freedoms(s, j, s->speeds + j, s->freedoms);
    for (Int j = 1; j < k->n_joints; j++)
        for (Int i = k->iv[j]; i < k->iv[j] + joint_nv(k->kind[j]); i++)
            put_entries(s, s->freedoms, j, i, by_q, by_v);
}

/* World joint Jacobian (6, nv), where the tree was placed last. */
static void put_jacobian(Kernel *k, Real *out)
{
    tree_columns(k);
    for (Int v = 0; v < k->nv; v++)
        for (int i = 0; i < 3; i++) {
            out[i * k->nv + v] = k->linear[3 * v + i];
            out[(3 + i) * k->nv + v] = k->angular[3 * v + i];
        }
}

static void copy_out(Real *out, const Real *from, Int n)
{
    if (out)
        memcpy(out, from, (size_t)n * sizeof *out);
}

/* Take the forces of springs from the wrenches that bodies need, where the bodies have their rates. */
static void take_springs(Tree *s, Springs *springs, Real *wrenches)
{
    Kernel *k = s->k;
    for (Int j = 0; j < k->n_joints; j++) {
        copy3(s->velocity + 6 * j, k->velocity + 3 * j);
        copy3(s->velocity + 6 * j + 3, k->omega + 3 * j);
        zero3(springs->force + 3 * j);
        zero3(springs->moment + 3 * j);
    }
    springs_on_bodies(k, springs);
    for (Int j = 0; j < k->n_joints; j++) {
        const Real *force = springs->force + 3 * j, *moment = springs->moment + 3 * j;
        Real swung[3];
        cross3(k->p + 3 * j, force, swung);
        for (int i = 0; i < 3; i++) {
            s->needed[6 * j + i] += force[i];
            s->needed[6 * j + 3 + i] += moment[i] - swung[i];
            if (wrenches)
                wrenches[6 * j + i] = -force[i], wrenches[6 * j + 3 + i] = -moment[i];
        }
    }
}

static void evaluate(Tree *s, const TreeTask *task)
{
    Kernel *k = s->k;
    const Int n = k->n_joints;
    if (task->v) {
        move_bodies(s, task->q, task->v);
        accelerate_bodies(s, task->a);
        copy_out(task->velocity, s->velocity, 6 * n);
        copy_out(task->acceleration, s->motion, 6 * n);
    } else {
        tree_place(k, task->q);
    }
    if (task->tau) {
        memcpy(s->armature, task->armature, (size_t)k->nv * sizeof(Real));
        put_needed(s);
        if (task->springs && task->v)
            take_springs(s, task->springs, task->of_springs);
        gather_wrenches(s, task->tau, task->a);
        copy_out(task->wrench, s->needed, 6 * n);
    }
    if (task->by_q)
        put_derivatives(s, task->outside, task->by_q, task->by_v);
    if (task->n_products) {
        const Real none[3] = {0.0};
        if (task->values)
            put_turning(s, none);
        put_products(s, task);
    }
    if (task->jacobian)
        put_jacobian(k, task->jacobian);
    copy_out(task->R, k->R, 9 * n);
    copy_out(task->p, k->p, 3 * n);
}

static Real *next(Real *row, Int size) { return row ? row + size : NULL; }

EXPORT void tree_evaluate(Tree *s, const TreeTask *task)
{
    const Int nq = s->k->nq, nv = s->k->nv, n = s->k->n_joints;
    TreeTask one = *task;
    for (Int i = 0; i < task->n; i++) {
        evaluate(s, &one);
        one.q += nq;
        one.v = one.v ? one.v + nv : NULL;
        one.a = one.a ? one.a + nv : NULL;
        one.R = next(one.R, 9 * n), one.p = next(one.p, 3 * n);
        one.jacobian = next(one.jacobian, 6 * nv);
        one.velocity = next(one.velocity, 6 * n), one.acceleration = next(one.acceleration, 6 * n);
        one.tau = next(one.tau, nv), one.wrench = next(one.wrench, 6 * n);
        one.of_springs = next(one.of_springs, 6 * n);
    }
}
