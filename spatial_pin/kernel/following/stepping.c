/* One step of a path, whole or not at all.
 *
 * Predictor, corrector, and tests that a step stays on its path [AllgowerGeorg2003]. */
#include <float.h>
#include <string.h>

#include "path.h"

#define CURVED_WAY 1.05  /* room for the way's curvature where steps of that length are counted */
#define MISSED 1e-24     /* square of what they may miss at any length: round-off */
#define TURNED 0.5       /* least cosine between the directions of the path at the ends of a step */
#define NEARER 0.75      /* part of the way to where the determinant vanishes that a step may go */
#define LOOK 1e-3        /* part of a first step over which the determinant's fall is judged */
#define RESELECT_ORDERS 1.0  /* binary orders by which the determinant falls, */
#define RESELECT_PIVOT 0.5   /* and the ratio of pivots, before redundant equations are chosen anew:
                               accelerations lose digits with its square */
#define OPENED 2.0       /* times a residual that no choice makes smaller: one like it is no news */
#define TELLING_BEND 1e3 /* distances of two points that a third derivative by the difference of
                            second ones tells ahead */
#define NEAR_BY 0.03     /* way from the point before within which it need not be the last one: of
                            that way, (0.03)^6 / 720 is round-off */

/* ---- the determinant ---- */

/* Two branches that cross twice at one place leave its sign as it was, but its root falls to zero
 * like a straight line: note where, from its sizes before and after a step h. */
static void note_zero(Path *path, Real before, Real after, Real s, Real h)
{
    const Real fall = exp2(0.5 * (before - after)) - 1.0;
    path->zero = fall != 0.0 ? s + h / fall : INFINITY;
    path->zero_known = 1;
}

Real distance_ahead(const Path *path, Real h)
{
    const Real way = path->zero - path->here->s;
    return way * h > 0.0 ? fabs(way) : INFINITY;
}

static void expect_angles(const Path *path, Real h)
{
    for (Int i = 0; i < path->k->n_angles; i++)
        path->k->angle_reference[i] = path->here->angle[i] + h * path->here->angle_rate[i];
}

int look_ahead(Path *path, Real h)
{
    Kernel *k = path->k;
    if (path->zero_known)
        return DONE;
    expect_angles(path, LOOK * h);
    predict_taylor(k, path->here, NULL, LOOK * h, 2, path->next->q);
    path->stale = 1;
    equations_values(k, path->next->q);
    equations_jacobian(k, &k->equations.system);
    const int code = system_factor(k);
    const Real size = code == DONE ? determinant_size(k) : -INFINITY;
    note_zero(path, path->here->size, size, path->here->s + LOOK * h, LOOK * h);
    return code == SINGULAR ? DONE : code;
}

/* ---- a step ---- */

/* Whether other equations are in use than at `here`. */
static int is_new_choice(const Path *path)
{
    const Kernel *k = path->k;
    return memcmp(path->chosen, k->system.chosen,
                  (size_t)k->system.n_chosen * sizeof *path->chosen) != 0;
}

void keep_choice(Path *path)
{
    memcpy(path->chosen, path->k->system.chosen,
           (size_t)path->k->system.n_chosen * sizeof *path->chosen);
}

int has_redundant(const Kernel *k) { return k->system.n_chosen < k->n_closure; }

/* Predict `next` at a value of s, by points that are closed or, corrected a fixed number of times,
 * not quite: those no polynomial is put through, that would make the more of it. Nor through points
 * with freedoms that nothing determines: no correction sets these right, and an error would grow
 * from step to step. */
static void predict(Path *path, Real target)
{
    const Point *here = path->here, *before = path->has_before ? path->before : NULL;
    const Real h = target - here->s;
    const Int order = path->accuracy.order;
    const int is_closed = path->accuracy.corrections < 0, is_determined = !path->k->system.n_fill;
    if (order == 3 && is_closed && is_determined && before && hermite_reaches(before, here, h))
        predict_hermite(path->k, before, here, h, path->next->q);
    else if (order == 3 && !is_closed && before &&
             fabs(h) < TELLING_BEND * fabs(here->s - before->s))
        predict_taylor(path->k, here, before, h, order, path->next->q);
    else
        predict_taylor(path->k, here, NULL, h, order < 2 ? order : 2, path->next->q);
    path->next->s = target;
}

/* Move a prediction to the prescribed values by the rates at `here`: polynomials of s may be at
 * rest there and go far all the same. `way` becomes longer by as much. */
static int follow_prescribed(Path *path, Real *way)
{
    Kernel *k = path->k;
    Real most = 0.0, square = 0.0;
    for (Int i = 0; i < k->system.n_driven; i++) {
        const Real gap = prescribed_gap(&path->prescribed, path->next->q, i);
        most = fmax(most, fabs(gap) / k->scale[driven_at(k, i)]);
    }
    if (most <= DBL_EPSILON || !path->accuracy.order)
        return DONE;
    const int code = path->stale ? stand_again(path) : DONE;
    if (code != DONE)
        return code;
    memset(k->right, 0, (size_t)k->nv * sizeof *k->right);
    for (Int i = 0; i < k->system.n_driven; i++)
        k->right[k->system.n_chosen + k->n_idle + i] =
            prescribed_gap(&path->prescribed, path->next->q, i) / k->scale[driven_at(k, i)];
    system_solve(k, k->right);
    for (Int v = 0; v < k->nv; v++) {
        square += k->right[v] * k->right[v];
        k->right[v] *= k->scale[v];
    }
    *way += sqrt(square);
    if (!(*way <= TOLERANCE_LONGEST_STEP))
        return UNSAFE;
    tree_integrate(k, path->next->q, k->right);
    return DONE;
}

static int is_driven(const Kernel *k, Int v)
{
    for (Int i = 0; i < k->system.n_driven; i++)
        if (k->system.driven[i] == v)
            return 1;
    return 0;
}

/* Closure error that round-off of the unknown coordinates may leave: an angle that counts a million
 * turns is known to 1e-9 rad. Drivers have their values exactly; but all that hangs on a free base
 * is known as well only as far as that is from the origin. */
Real round_off_of(const Kernel *k, const Real *q)
{
    Real most = 0.0;
    for (Int j = 1; j < k->n_joints; j++) {
        const Int n = k->kind[j] == FREE ? 3 : joint_nv(k->kind[j]) == 1;
        for (Int i = 0; i < n; i++)
            if (n == 3 || !is_driven(k, k->iv[j]))
                most = larger_of(most, fabs(q[k->iq[j] + i]) / k->scale[k->iv[j] + i]);
    }
    return 4.0 * DBL_EPSILON * most;
}

/* Close the prediction; choose other independent equations where the residuals
 * of those left out show that the present choice is ill conditioned. */
static int close_prediction(Path *path, Real way)
{
    Kernel *k = path->k;
    const PathAccuracy *wanted = &path->accuracy;
    const Real least = path->rounding = round_off_of(k, path->here->q);
    const Real part = residual_part(k->system.pivot_ratio); /* 1, or factors near by are off as well */
    Correction c = {.enough = larger_of(part * wanted->enough, 0.1 * least),
                    .tolerance = larger_of(part * wanted->tolerance, 0.3 * least),
                    .left = larger_of(wanted->left, least), .fixed = wanted->corrections,
                    .reuse = !path->stale && part == 1.0 && wanted->corrections < 0,
                    .prescribed = &path->prescribed};
    c.allowed = wanted->order ? TOLERANCE_UNEXPLAINED * way : INFINITY;
    path->stale = 1;
    int code = correct(k, path->next->q, &c);
    if (code != DONE || !has_redundant(k) || c.fixed >= 0 ||
        equations_error(k) <= larger_of(c.tolerance, path->open))
        return code;
    code = system_reselect(k);
    if (code != DONE)
        return code;
    c.reuse = 0;
    c.enough = 0.0;
    code = correct(k, path->next->q, &c);
    path->open = fmax(path->open, OPENED * equations_error(k));
    return code == DONE && equations_error(k) > c.left ? UNSAFE : code;
}

/* Choose the independent equations anew at a factored point where redundant ones have become weak;
 * the sign starts anew with them. */
static int choose_again(Path *path)
{
    Kernel *k = path->k;
    if (!has_redundant(k) || !(k->system.pivot_ratio < RESELECT_PIVOT * path->selected_ratio))
        return DONE;
    const Real size = determinant_size(k);
    if (!(size < path->selected - RESELECT_ORDERS))
        return DONE;
    int code = system_reselect(k);
    if (code == DONE)
        code = system_factor(k);
    if (!is_new_choice(path))
        path->selected = size, path->selected_ratio = k->system.pivot_ratio;
    return code;
}

/* Does the path go on in its direction? Where polynomials are prescribed it may come to rest, and
 * back: then second derivatives have to account for the change of the first ones. */
static int goes_on(const Path *path)
{
    const Int nv = path->k->nv;
    const Point *a = path->here, *b = path->next;
    const Real square0 = dot(a->t, a->t, nv), square1 = dot(b->t, b->t, nv);
    if (dot(a->t, b->t, nv) >= TURNED * sqrt(square0 * square1))
        return 1;
    const Real h = b->s - a->s;
    Real left = 0.0;
    for (Int v = 0; v < nv; v++) {
        const Real one = b->t[v] - a->t[v] - 0.5 * h * (a->c[v] + b->c[v]);
        left += one * one;
    }
    const Real bent = 0.25 * h * h * (dot(a->c, a->c, nv) + dot(b->c, b->c, nv));
    return path->prescribed.n_pieces && left <= TURNED * TURNED * (square0 + square1 + bent);
}

/* Do the rates at both ends of a step account for the way between?
 * Hermite: q1 - q0 = h (t0 + t1) / 2 + h² (c0 - c1) / 12, in the joints of one freedom. */
static int is_explained(const Path *path)
{
    const Kernel *k = path->k;
    const Point *a = path->here, *b = path->next;
    const Real h = b->s - a->s, part = path->prescribed.n_pieces ? 0.25 * h * h : 0.0;
    Real moved = 0.0, missed = 0.0;
    for (Int j = 1; j < k->n_joints; j++) {
        if (joint_nv(k->kind[j]) != 1)
            continue;
        const Int v = k->iv[j];
        const Real way = b->q[k->iq[j]] - a->q[k->iq[j]];
        const Real left = way - 0.5 * h * (a->t[v] + b->t[v]) - h * h / 12.0 * (a->c[v] - b->c[v]);
        moved += way * way + part * (a->t[v] * a->t[v] + b->t[v] * b->t[v]); /* there and back */
        missed += left * left;
    }
    return goes_on(path) &&
           missed <= TOLERANCE_UNEXPLAINED * TOLERANCE_UNEXPLAINED * moved + MISSED;
}

/* ---- one step, whole or not at all ---- */

/* The verdict on the corrected `next`: DONE if it lies on the same stretch of the same path. */
static int arrive(Path *path, Real way)
{
    Kernel *k = path->k;
    Point *here = path->here, *next = path->next;
    int is_new = is_new_choice(path);
    int code = prescribed_holds(&path->prescribed, next->q) ? factor_at_path_point(k) : UNSAFE;
    if (code != DONE)
        return code;
    if (k->system.pivot_ratio < TOLERANCE_NEAR_SINGULAR || (!is_new && k->system.sign != path->sign))
        return SINGULAR;
    if (!is_new) {
        code = choose_again(path);
        is_new = is_new_choice(path);
    }
    if (code == DONE)
        code = path_rates(path, next);
    if (code == DONE && !is_explained(path))
        code = UNSAFE;
    if (code == DONE && k->n_idle && path->accuracy.corrections)
        code = take_idle_back(path, way);
    if (code != DONE)
        return code;
    if (is_new) {
        keep_choice(path);
        path->sign = k->system.sign;
        path->selected = next->size;
        path->selected_ratio = k->system.pivot_ratio;
        path->zero = INFINITY;
        path->zero_known = 0;
    } else
        note_zero(path, here->size, next->size, next->s, next->s - here->s);
    return DONE;
}

static int try_step(Path *path, Real target)
{
    const Real h = target - path->here->s;
    Real way = path->prescribed.n_pieces ? point_reach(path->here, h)
                                         : point_way(path->k, path->here, h);
    if (!(way <= TOLERANCE_LONGEST_STEP) || (path->k->n_idle && way > 1.1 * idle_way_to(path, target)))
        return UNSAFE;
    int code = look_ahead(path, h);
    if (code != DONE || fabs(h) > NEARER * distance_ahead(path, h))
        return code != DONE ? code : SINGULAR;
    predict(path, target);
    prescribe(&path->prescribed, target);
    if (path->prescribed.n_pieces)
        code = follow_prescribed(path, &way);
    if (code != DONE)
        return code;
    expect_angles(path, h);
    prescribed_put(&path->prescribed, path->next->q);
    path->way = way;
    code = close_prediction(path, way);
    return code == DONE ? arrive(path, way) : code;
}

/* Make `next` the present point. The point before stays what it is as long as it is near: a
 * prediction over less than the distance of two points does not suffer from their round-off. */
static void take(Path *path)
{
    Point *next = path->next;
    const Real apart = fabs(next->s - path->before->s);
    const int stays = path->has_before && path->accuracy.corrections < 0 &&
                      apart > fabs(next->s - path->here->s) &&
                      point_way(path->k, next, apart) < NEAR_BY;
    path->next = stays ? path->here : path->before;
    path->before = stays ? path->before : path->here;
    path->here = next;
    path->has_before = 1;
    path->stale = 0;
}

int stand_again(Path *path)
{
    Kernel *k = path->k;
    equations_values_near(k, path->here->q, path->here->angle);
    const int code = factor_at_path_point(k);
    path->stale = code != DONE;
    return code;
}

int turn_into(Path *path, Real sense)
{
    Prescribed *p = &path->prescribed;
    const Int piece = piece_ahead(p, path->here->s, sense);
    const Int last = p->piece;
    if (piece == last)
        return DONE;
    p->piece = piece;
    prescribe(p, path->here->s);
    int code = stand_again(path);
    if (code == DONE)
        code = path_rates(path, path->here);
    path->has_before = path->zero_known = 0;
    p->piece = code == DONE ? piece : last;
    return code;
}

int step(Path *path, Real target)
{
    Kernel *k = path->k;
    const int code = try_step(path, target);
    if (code != DONE) {
        if (is_new_choice(path))
            system_set(k, path->chosen, k->system.n_chosen, k->system.driven, k->system.n_driven,
                       k->system.fill, k->system.n_fill);
        path->stale = 1;
        return code;
    }
    take(path);
    return DONE;
}

Real step_of(const Path *path, Real way) { return way / (CURVED_WAY * path->here->pace); }

Real longest_step(const Path *path, Real target)
{
    const Real most = TOLERANCE_LONGEST_STEP;
    return step_of(path, path->k->n_idle ? fmin(most, idle_way_to(path, target)) : most);
}
