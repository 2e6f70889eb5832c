/* A path of closed configurations, followed through many values of one driver.
 *
 * Predictor, corrector, and tests that a step stays on its path [AllgowerGeorg2003].
 * A step is taken whole or not at all: what fails is tried again at half
 * its length, and where that does not help, the caller looks at what lies ahead. */
#include <float.h>
#include <stdlib.h>
#include <string.h>

#include "filling.h"
#include "following.h"
#include "interpolating.h"
#include "path_point.h"
#include "regular.h"

#define LONGEST 1.0      /* rad, characteristic lengths: the joints' way in one step, norm */
#define CURVED 1.05      /* room for the way's curvature where steps of that length are counted */
#define FARTHEST 640e3   /* the same of a value that is followed to at all */
#define EXPLAINED 0.1    /* part of a step that prediction, or the rates at its ends, may miss */
#define MISSED 1e-24     /* square of what they may miss at any length: round-off */
#define TURNED 0.5       /* least cosine between the directions of the path at the ends of a step */
#define NEARER 0.75      /* part of the way to where the determinant vanishes that a step may go */
#define LOOK 1e-3        /* part of a first step over which the determinant's fall is judged */
#define NEAR_SINGULAR 1e-5 /* smallest over largest pivot: beyond, arc length has the better view */
#define REGULAR 0.1      /* smallest over largest pivot: below, a residual leaves the more open in
                            configurations and rates, and is asked to be smaller by as much;
                            factors of another point are off where the equations are weakest */
#define WORN 2.3         /* binary orders (a factor of 5) by which the determinant falls, */
#define WORN_PIVOT 0.2   /* and the ratio of pivots, before redundant equations are chosen anew */
#define OPENED 2.0       /* times the rounding of a file by which equations left out may be open
                            before others are chosen: worn choices show there first */
#define INDEPENDENT 1e-10 /* part of an equation left out above which it is independent */
#define FAR_AHEAD 8.0    /* distances of its points that Hermite's polynomial tells ahead: their
                            round-off grows by 20 r^5 */
#define NEAR_BY 0.03     /* way from the point before within which it need not be the last one: of
                            that way, (0.03)^6 / 720 is round-off */
#define BETWEEN_FIRST 0.5 /* first way between points that samples are interpolated between, by the
                            fourth root of the error allowed, which grows with its fourth power */
#define BETWEEN_LONGEST 0.5 /* and the longest */
#define BETWEEN_NEARER 0.25 /* part of the way to where the determinant vanishes that it may be: it
                            grows there like a root, whose sixth derivative so grows fivefold */
#define SAFE 0.7         /* part of the way at which errors, of fourth order, are a quarter of those
                            allowed: there they may grow from one step to the next */
#define STRAIGHT 1e-2    /* second derivative by the way below which a path is straight */
#define HALVINGS 8       /* of a step, before the caller is asked */
#define IDLE_FIRST 0.05  /* first way with idle rotations, whose error is not known yet: of 4e-12
                            rad at a way of 0.3, as measured, (1/6)^6 is round-off */
#define IDLE_SAME 1e-15  /* rotation [rad] that is round-off */
#define IDLE_SMALL 1e-8  /* rotation whose square is round-off */
#define IDLE_PASSES 6    /* of turning links back that move other joints with them */
#define ALONE 1e-9       /* part of a displacement in other joints that is round-off */

struct Path {
    Kernel *k;
    PathAccuracy accuracy;
    Point points[3], *here, *before, *next; /* `next` is the trial */
    int has_before; /* whether there is a point before `here`, on the same stretch */
    Int *chosen;    /* equations in use at `here` */
    Int driver_q;   /* the driver's place in q */
    Real sign;      /* of the determinant with these equations */
    Real selected, selected_ratio; /* its size, and the ratio of pivots, where they were chosen */
    Real zero;      /* driver value where it would vanish as it last fell; infinite if it rose */
    int zero_known, stale; /* `stale`: the factors are of another point than `here` */
    Real idle_way;  /* the joints' longest way in a step that idle rotations allow */
    Real between_way; /* the joints' way between points that samples are interpolated between */
    int is_between; /* whether the last step is as short, as far as its error is known */
    Real missed;    /* of q, by the last step's prediction: Hermite's error between its points */
    Real open;      /* residual of equations left out that no other choice makes smaller */
    Real *memory;
};

EXPORT int path_create(Kernel *k, const PathAccuracy *accuracy, Path **out)
{
    Path *path = *out = calloc(1, sizeof *path);
    if (!path)
        return NO_MEMORY;
    path->memory = calloc((size_t)(3 * point_numbers(k)) + 1, sizeof(Real));
    path->chosen = calloc((size_t)k->nv + 1, sizeof(Int));
    if (!path->memory || !path->chosen) {
        path_destroy(path);
        *out = NULL;
        return NO_MEMORY;
    }
    Real *from = path->memory;
    for (int i = 0; i < 3; i++)
        point_carve(k, &from, path->points + i);
    path->k = k;
    path->accuracy = *accuracy;
    path->here = path->points;
    path->before = path->points + 1;
    path->next = path->points + 2;
    return DONE;
}

EXPORT void path_destroy(Path *path)
{
    if (!path)
        return;
    free(path->memory);
    free(path->chosen);
    free(path);
}

/* ---- the determinant ---- */

/* Two branches that cross twice at one place leave its sign as it was, but its root falls to zero
 * like a straight line: note where, from its sizes before and after a step h. */
static void note_zero(Path *path, Real before, Real after, Real s, Real h)
{
    const Real fall = exp2(0.5 * (before - after)) - 1.0;
    path->zero = fall != 0.0 ? s + h / fall : INFINITY;
    path->zero_known = 1;
}

/* How far ahead the determinant vanishes, for a step h; infinite if it does not. */
static Real room_ahead(const Path *path, Real h)
{
    const Real way = path->zero - path->here->s;
    return way * h > 0.0 ? fabs(way) : INFINITY;
}

/* Learn where the determinant vanishes from a small part of a step h. */
static int look_ahead(Path *path, Real h)
{
    Kernel *k = path->k;
    predict_taylor(k, path->here, LOOK * h, 2, path->next->q);
    path->stale = 1;
    equations_values(k, path->next->q);
    equations_jacobian(k);
    const int code = system_factor(k);
    const Real size = code == DONE ? log2(k->mantissa) + (Real)k->exponent : -INFINITY;
    note_zero(path, path->here->size, size, path->here->s + LOOK * h, LOOK * h);
    return code == SINGULAR ? DONE : code;
}

/* ---- a step ---- */

static int keep_choice(Path *path)
{
    const size_t size = (size_t)path->k->n_chosen * sizeof *path->chosen;
    const int is_new = memcmp(path->chosen, path->k->chosen, size) != 0;
    memcpy(path->chosen, path->k->chosen, size);
    return is_new;
}

static int has_redundant(const Kernel *k) { return k->n_chosen < k->n_closure; }

static void expect_angles(const Path *path, Real h)
{
    for (Int i = 0; i < path->k->n_angles; i++)
        path->k->turns[i] = path->here->angle[i] + h * path->here->angle_rate[i];
}

/* Predict `next` at a driver value. */
static void predict(Path *path, Real target)
{
    const Point *here = path->here, *before = path->before;
    const Real h = target - here->s;
    const int is_near = path->has_before && fabs(h) < FAR_AHEAD * fabs(here->s - before->s);
    if (path->accuracy.order == 3 && is_near)
        predict_hermite(path->k, before, here, h, path->next->q);
    else
        predict_taylor(path->k, here, h, path->accuracy.order < 2 ? path->accuracy.order : 2,
                       path->next->q);
    path->next->q[path->driver_q] = target;
    path->next->s = target;
}

static int is_driven(const Kernel *k, Int v)
{
    for (Int i = 0; i < k->n_driven; i++)
        if (k->driven[i] == v)
            return 1;
    return 0;
}

/* Closure error that round-off of the unknown coordinates may leave: an angle that counts a million
 * turns is known to 1e-9 rad. What is driven has its value exactly. */
static Real round_off_of(const Kernel *k, const Real *q)
{
    Real most = 0.0;
    for (Int j = 1; j < k->n_joints; j++)
        if (joint_nv(k->kind[j]) == 1 && !is_driven(k, k->iv[j]))
            most = fmax(most, fabs(q[k->iq[j]]) / k->scale[k->iv[j]]);
    return 4.0 * DBL_EPSILON * most;
}

/* Close the prediction; choose other equations where those left out tell that these are worn. */
static int close_prediction(Path *path, Real way)
{
    Kernel *k = path->k;
    const PathAccuracy *wanted = &path->accuracy;
    const Real least = round_off_of(k, path->here->q);
    const Real part = fmin(1.0, k->pivot_ratio / REGULAR);
    Correction c = {.enough = fmax(part * wanted->enough, 0.1 * least),
                    .tolerance = fmax(part * wanted->tolerance, 0.3 * least),
                    .left = fmax(wanted->left, least), .fixed = -1, .reuse = !path->stale && part == 1.0};
    c.allowed = wanted->order ? EXPLAINED * way : INFINITY;
    path->stale = 1;
    int code = correct(k, path->next->q, &c);
    path->missed = c.first;
    if (code != DONE || !has_redundant(k) || equations_error(k) <= fmax(c.tolerance, path->open))
        return code;
    equations_jacobian(k);
    code = system_reselect(k);
    if (code != DONE)
        return code;
    c.reuse = 0;
    c.enough = 0.0;
    code = correct(k, path->next->q, &c);
    path->open = fmax(path->open, OPENED * equations_error(k));
    return code == DONE && equations_error(k) > c.left ? UNSAFE : code;
}

/* Factor at the corrected point, with passive freedoms as they are there. */
static int factor_here(Kernel *k)
{
    equations_jacobian(k);
    const int code = system_factor(k);
    return code == DONE && k->n_fill ? fill_again(k) : code;
}

/* Choose the independent equations anew at a factored point; the sign starts anew with them. */
static int choose_again(Path *path)
{
    Kernel *k = path->k;
    int code = system_reselect(k);
    if (code == DONE)
        code = system_factor(k);
    if (code != DONE)
        return code;
    path->next->size = log2(k->mantissa) + (Real)k->exponent;
    return DONE;
}

/* Do the rates at both ends of a step account for the way between?
 * Hermite: q1 - q0 = h (t0 + t1) / 2 + h² (c0 - c1) / 12, in the joints of one freedom. */
static int is_explained(const Path *path)
{
    const Kernel *k = path->k;
    const Point *a = path->here, *b = path->next;
    const Real h = b->s - a->s;
    Real along = 0.0, square0 = 0.0, square1 = 0.0, moved = 0.0, missed = 0.0;
    for (Int v = 0; v < k->nv; v++) {
        along += a->t[v] * b->t[v];
        square0 += a->t[v] * a->t[v];
        square1 += b->t[v] * b->t[v];
    }
    for (Int j = 1; j < k->n_joints; j++) {
        if (joint_nv(k->kind[j]) != 1)
            continue;
        const Int v = k->iv[j];
        const Real way = b->q[k->iq[j]] - a->q[k->iq[j]];
        const Real left = way - 0.5 * h * (a->t[v] + b->t[v]) - h * h / 12.0 * (a->c[v] - b->c[v]);
        moved += way * way;
        missed += left * left;
    }
    return along >= TURNED * sqrt(square0 * square1) &&
           missed <= EXPLAINED * EXPLAINED * moved + MISSED;
}

/* ---- idle rotations ---- */

/* Rates of a ball's joint once its body is turned by a rotation vector x (in body axes). */
static void turn_back(const Real *x, Real *rate)
{
    const Real angle = sqrt(dot3(x, x));
    if (!(angle > 0.0))
        return;
    Real axis[3] = {x[0] / angle, x[1] / angle, x[2] / angle}, once[3], twice[3];
    const Real half = sin(0.5 * angle);
    cross3(axis, rate, once);
    cross3(axis, once, twice);
    add3(-sin(angle), once, rate);
    add3(2.0 * half * half, twice, rate);
}

/* Whether a displacement x (nv) turns nothing but as many balls as there are idle rotations: then
 * the rates are as they were, in axes that have turned. */
static int turns_balls_only(const Kernel *k, const Real *x)
{
    Real most = 0.0;
    Int moved = 0;
    for (Int v = 0; v < k->nv; v++)
        most = fmax(most, fabs(x[v]));
    for (Int j = 1; j < k->n_joints; j++) {
        Real size = 0.0;
        for (Int i = 0; i < joint_nv(k->kind[j]); i++)
            size = fmax(size, fabs(x[k->iv[j] + i]));
        if (size > ALONE * most && k->kind[j] != BALL)
            return 0;
        moved += size > ALONE * most;
    }
    return moved <= k->n_idle;
}

static void turn_rates(const Path *path, const Real *x)
{
    const Kernel *k = path->k;
    Point *next = path->next;
    for (Int j = 1; j < k->n_joints; j++)
        if (k->kind[j] == BALL) {
            turn_back(x + k->iv[j], next->t + k->iv[j]);
            turn_back(x + k->iv[j], next->c + k->iv[j]);
        }
    tree_entry_rates(k, next->q, next->t, next->c, next->first, next->second);
}

/* Displacement x = k->right (nv) that takes back what links have turned about their own axes in
 * the step. Returns the largest such rotation, and of all the largest error by estimate [rad]. */
static Real idle_displacement(Path *path, Real way, Real *error)
{
    Kernel *k = path->k;
    const Point *before = path->before, *here = path->here;
    Real most = 0.0;
    memset(k->right, 0, (size_t)k->nv * sizeof *k->right);
    for (Int i = 0; i < k->n_idle; i++) {
        Real own;
        const int three = path->has_before && way > IDLE_FIRST; /* else two points are enough */
        const Real turned = idle_turned(three ? before->axis + i : NULL, here->axis + i,
                                        path->next->axis + i, here->s - before->s,
                                        path->next->s - here->s, &own);
        k->right[k->n_chosen + i] = -turned;
        idle_turn(path->next->axis + i, -turned);
        *error = fmax(*error, own);
        if (!(fabs(turned) <= most))
            most = fabs(turned);
    }
    system_solve(k, k->right);
    for (Int v = 0; v < k->nv; v++)
        k->right[v] *= k->scale[v];
    return most;
}

/* Longest step that idle rotations allow next, from the error of this one, of ninth order. */
static int is_exact(Path *path, Real way, Real error)
{
    const Real part = path->accuracy.idle / fmax(error, 1e-30);
    path->idle_way = fmax(way * fmin(fmax(0.9 * pow(part, 1.0 / 9.0), 0.5), 2.5), IDLE_FIRST);
    return error <= 4.0 * path->accuracy.idle;
}

/* Turn links about their own axes to where no idle rotation leaves them. */
static int take_idle_back(Path *path, Real way)
{
    Kernel *k = path->k;
    for (int pass = 0; pass < IDLE_PASSES; pass++) {
        Real error = 0.0;
        const Real most = idle_displacement(path, way, &error);
        if (!isfinite(most + error))
            return NOT_FINITE;
        if (!is_exact(path, way, error))
            return UNSAFE;
        if (most <= IDLE_SAME)
            return DONE;
        tree_integrate(k, path->next->q, k->right);
        path->next->q[path->driver_q] = path->next->s;
        if (turns_balls_only(k, k->right)) {
            turn_rates(path, k->right);
            return DONE;
        }
        equations_values(k, path->next->q);
        int code = factor_here(k);
        if (code == DONE)
            code = point_rates(k, path->next);
        if (code != DONE || most <= IDLE_SMALL)
            return code;
    }
    return NOT_CONVERGED;
}

/* ---- one step, whole or not at all ---- */

/* What is known at the corrected `next`: DONE if it lies on the same stretch of the same path. */
static int arrive(Path *path, Real way)
{
    Kernel *k = path->k;
    Point *here = path->here, *next = path->next;
    int is_new = memcmp(path->chosen, k->chosen, (size_t)k->n_chosen * sizeof *path->chosen) != 0;
    int code = factor_here(k);
    if (code != DONE)
        return code;
    if (k->pivot_ratio < NEAR_SINGULAR || (!is_new && k->sign != path->sign))
        return UNSAFE;
    const Real size = log2(k->mantissa) + (Real)k->exponent;
    if (!is_new && has_redundant(k) && size < path->selected - WORN &&
        k->pivot_ratio < WORN_PIVOT * path->selected_ratio) {
        code = choose_again(path);
        is_new = memcmp(path->chosen, k->chosen, (size_t)k->n_chosen * sizeof *path->chosen) != 0;
        if (!is_new)
            path->selected = size, path->selected_ratio = k->pivot_ratio;
    }
    if (code == DONE)
        code = point_rates(k, next);
    if (code == DONE && !is_explained(path))
        code = UNSAFE;
    if (code == DONE && k->n_idle)
        code = take_idle_back(path, way);
    if (code != DONE)
        return code;
    if (is_new) {
        keep_choice(path);
        path->sign = k->sign;
        path->selected = next->size;
        path->selected_ratio = k->pivot_ratio;
        path->zero = INFINITY;
        path->zero_known = 0;
    } else
        note_zero(path, here->size, next->size, next->s, next->s - here->s);
    return DONE;
}

static int try_step(Path *path, Real target)
{
    const Real h = target - path->here->s, way = point_way(path->k, path->here, h);
    int code = DONE;
    if (!(way <= LONGEST) || (path->k->n_idle && way > 1.1 * path->idle_way))
        return UNSAFE;
    expect_angles(path, h);
    if (!path->zero_known)
        code = look_ahead(path, h);
    if (code != DONE || fabs(h) > NEARER * room_ahead(path, h))
        return code != DONE ? code : UNSAFE;
    predict(path, target);
    code = close_prediction(path, way);
    return code == DONE ? arrive(path, way) : code;
}

/* Make `next` the present point. The point before stays what it is as long as it is near: what
 * is told ahead by less than the distance of two points does not suffer from their round-off. */
static void take(Path *path)
{
    Point *next = path->next;
    const Real apart = fabs(next->s - path->before->s);
    const int stays = path->has_before && apart > fabs(next->s - path->here->s) &&
                      point_way(path->k, next, apart) < NEAR_BY;
    path->next = stays ? path->here : path->before;
    path->before = stays ? path->before : path->here;
    path->here = next;
    path->has_before = 1;
    path->stale = 0;
}

/* Learn the way between points from what prediction missed. With r the step by the distance of the
 * points it was predicted from, that is 64 (1 + 1/r)^3 times what Hermite's polynomials miss in the
 * middle of the step: both are products of cubed distances from two points, times the sixth
 * derivative. Second derivatives miss 24 / way² times that. */
static void note_missed(Path *path, Real way, Real ratio)
{
    const Real growth = 64.0 * pow(1.0 + 1.0 / ratio, 3.0);
    const Kernel *k = path->k;
    Real bend = 0.0, pace = 0.0; /* second derivative by the way: that is what errors are parts of */
    for (Int v = 0; v < k->nv; v++) {
        bend += (path->here->c[v] / k->scale[v]) * (path->here->c[v] / k->scale[v]);
        pace += (path->here->t[v] / k->scale[v]) * (path->here->t[v] / k->scale[v]);
    }
    bend = fmax(sqrt(bend) / pace, STRAIGHT);
    const Real error = 24.0 * path->missed / (growth * way * way);
    const Real part = path->accuracy.between * bend / fmax(error, 1e-30);
    path->is_between = part >= 1.0;
    path->between_way = fmin(way * fmin(fmax(SAFE * pow(part, 0.25), 0.25), 4.0), BETWEEN_LONGEST);
}

static int step(Path *path, Real target)
{
    Kernel *k = path->k;
    const Real h = target - path->here->s, way = point_way(k, path->here, h);
    const Real ratio = path->has_before ? h / (path->here->s - path->before->s) : 0.0;
    const int code = try_step(path, target);
    if (code != DONE) {
        if (memcmp(path->chosen, k->chosen, (size_t)k->n_chosen * sizeof *path->chosen) != 0)
            system_set(k, path->chosen, k->n_chosen, k->driven, k->n_driven, k->fill, k->n_fill);
        path->stale = 1;
        return code;
    }
    take(path);
    path->is_between = 1;
    if (path->accuracy.between > 0.0 && ratio > 0.0)
        note_missed(path, way, ratio);
    return DONE;
}

/* ---- many values ---- */

/* The change of the driver in which the joints go a way. */
static Real step_of(const Path *path, Real way)
{
    const Kernel *k = path->k;
    Real square = 0.0;
    for (Int v = 0; v < k->nv; v++)
        square += (path->here->t[v] / k->scale[v]) * (path->here->t[v] / k->scale[v]);
    return way / (CURVED * sqrt(square));
}

/* The longest step that is worth an attempt. */
static Real longest_step(const Path *path)
{
    return step_of(path, path->k->n_idle ? fmin(LONGEST, path->idle_way) : LONGEST);
}

/* Go to a driver value by as many steps as the path needs, of equal length where they may be. */
static int reach(Path *path, Real target)
{
    const Real first = fmin(fabs(target - path->here->s), longest_step(path));
    const Real least = first * exp2(-HALVINGS);
    Real length = first;
    if (!(fabs(target - path->here->s) <= FARTHEST * longest_step(path)))
        return UNSAFE;
    while (path->here->s != target) {
        const Real left = target - path->here->s;
        const Real parts = ceil(fabs(left) / fmin(length, longest_step(path)) - 1e-9);
        const Real goal = parts <= 1.0 ? target : path->here->s + left / parts;
        const Real tried = fabs(goal - path->here->s);
        const int code = goal != path->here->s ? step(path, goal) : UNSAFE;
        if (code == DONE)
            length = fmax(length, 2.0 * tried);
        else if (code == NO_MEMORY || 0.5 * tried < least)
            return code;
        else
            length = 0.5 * tried;
    }
    return DONE;
}

static int find_driver(Path *path)
{
    const Kernel *k = path->k;
    for (Int j = 1; j < k->n_joints; j++)
        if (k->n_driven && k->iv[j] == k->driven[0] && joint_nv(k->kind[j]) == 1) {
            path->driver_q = k->iq[j];
            return DONE;
        }
    return BAD_ARRAYS;
}

/* Choose independent equations, as many as the system wants, at an evaluated point: SINGULAR where
 * there are fewer, UNSAFE where there are more. */
static int choose_first(Kernel *k)
{
    equations_jacobian(k);
    const int code = system_reselect(k);
    return code == DONE && k->left_out > INDEPENDENT ? UNSAFE : code;
}

/* Whether the path begins where the loops are regular. */
static int is_regular(Path *path)
{
    path->stale = 1;
    return stays_closed(path->k, path->here->q, path->here->error, path->next->q);
}

EXPORT int path_start(Path *path, const Real *q, const Real *angles, Int choose)
{
    Kernel *k = path->k;
    Point *here = path->here;
    int code = find_driver(path);
    if (code != DONE)
        return code;
    memcpy(here->q, q, (size_t)k->nq * sizeof *q);
    here->s = q[path->driver_q];
    memcpy(k->turns, angles, (size_t)k->n_angles * sizeof *angles);
    equations_values(k, here->q);
    if (!isfinite(equations_error(k)))
        return NOT_FINITE;
    const int is_chosen = choose && has_redundant(k);
    if (is_chosen)
        code = choose_first(k);
    if (code == DONE)
        code = factor_here(k);
    if (code == DONE && k->pivot_ratio < NEAR_SINGULAR)
        code = UNSAFE;
    if (code == DONE)
        code = point_rates(k, here);
    keep_choice(path);
    path->sign = k->sign;
    path->selected = here->size;
    path->selected_ratio = k->pivot_ratio;
    path->zero = INFINITY;
    path->zero_known = path->has_before = path->stale = 0;
    path->idle_way = IDLE_FIRST;
    path->between_way = BETWEEN_FIRST * sqrt(sqrt(path->accuracy.between));
    path->open = OPENED * here->error;
    return code == DONE && is_chosen ? is_regular(path) : code;
}

static void put_row(const Path *path, const PathRows *rows, Int i)
{
    const Kernel *k = path->k;
    const Point *here = path->here;
    memcpy(rows->q + i * k->nq, here->q, (size_t)k->nq * sizeof *here->q);
    memcpy(rows->t + i * k->nv, here->t, (size_t)k->nv * sizeof *here->t);
    memcpy(rows->c + i * k->nv, here->c, (size_t)k->nv * sizeof *here->c);
    memcpy(rows->angle + i * k->n_angles, here->angle, (size_t)k->n_angles * sizeof *here->angle);
    rows->error[i] = here->error;
}

/* ---- values between two points ---- */

/* The last of the values from i on, one after the other in one sense, that one step may reach. */
static Int last_within(const Path *path, const Real *values, Int i, Int n)
{
    const Real s = path->here->s, sense = values[i] - s;
    const Real longest = fmin(longest_step(path), step_of(path, path->between_way));
    const Real most = fmin(longest, BETWEEN_NEARER * room_ahead(path, sense));
    Int last = i;
    while (last + 1 < n && (values[last + 1] - values[last]) * sense > 0.0 &&
           fabs(values[last + 1] - s) <= most)
        last++;
    return last;
}

/* Write row i, at a value between a point and the present one; DONE if its loops are closed. */
static int put_between(Path *path, const Point *from, Real value, const PathRows *rows, Int i)
{
    Kernel *k = path->k;
    const Point *to = path->here;
    const Real part = (value - from->s) / (to->s - from->s);
    Real *q = rows->q + i * k->nq, *angle = rows->angle + i * k->n_angles;
    point_between(k, from, to, value, q, rows->t + i * k->nv, rows->c + i * k->nv);
    q[path->driver_q] = value;
    for (Int x = 0; x < k->n_angles; x++)
        k->turns[x] = from->angle[x] + part * (to->angle[x] - from->angle[x]);
    equations_values(k, q);
    for (Int x = 0; x < k->n_angles; x++)
        angle[x] = k->angle[x];
    rows->error[i] = equations_error(k);
    path->stale = 1;
    return rows->error[i] <= path->accuracy.between ? DONE : NOT_CONVERGED;
}

/* Go to value `last` in one step, and write the rows from i on that lie before it. Returns how
 * many rows are done: none if the step fails, fewer than asked for if one of them is open. */
static Int follow_between(Path *path, const Real *values, Int i, Int last, const PathRows *rows)
{
    const Point *from = path->here; /* it stays what it is until the next step is tried */
    if (step(path, values[last]) != DONE) {
        path->between_way *= 0.5;
        return 0;
    }
    if (!path->is_between)
        return 0;
    for (Int row = i; row < last; row++)
        if (put_between(path, from, values[row], rows, row) != DONE)
            return row - i;
    put_row(path, rows, last);
    return last + 1 - i;
}

EXPORT Int path_follow(Path *path, const Real *values, Int n, const PathRows *rows, int *code)
{
    *code = DONE;
    for (Int i = 0; i < n;) {
        const Int last = path->accuracy.between > 0.0 ? last_within(path, values, i, n) : i;
        const Int done = last > i ? follow_between(path, values, i, last, rows) : 0;
        i += done;
        if (done)
            continue;
        *code = reach(path, values[i]);
        if (*code != DONE)
            return i;
        put_row(path, rows, i++);
    }
    return n;
}

EXPORT Real path_stand(const Path *path, Real *q, Real *angles)
{
    const Kernel *k = path->k;
    memcpy(q, path->here->q, (size_t)k->nq * sizeof *q);
    memcpy(angles, path->here->angle, (size_t)k->n_angles * sizeof *angles);
    return path->here->s;
}
