/* Steps of a path leave links where no idle rotation does: they are turned back about their axes. */
#include <float.h>
#include <string.h>

#include "path.h"

#define IDLE_SMALL 1e-8  /* rotation whose square is round-off */
#define IDLE_NEXT 0.125  /* way of a step that is worth it to see what a third point tells */
#define IDLE_PASSES 6    /* of turning links back that move other joints with them */

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
    const Real least = TOLERANCE_NOTHING * largest(x, k->nv);
    Int moved = 0;
    for (Int j = 1; j < k->n_joints; j++) {
        const int moves = largest(x + k->iv[j], joint_nv(k->kind[j])) > least;
        if (moves && k->kind[j] != BALL)
            return 0;
        moved += moves;
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
    const int three = way > IDLE_FIRST && third_tells(path, path->next->s); /* else two points are enough */
    for (Int i = 0; i < k->n_idle; i++) {
        IdleAxis *to = path->next->axis + i;
        IdleCurve *curve = path->curve + i;
        idle_curve(three ? before->axis + i : NULL, here->axis + i, to, here->s - before->s,
                   path->next->s - here->s, curve);
        const Real turned = idle_turned(curve, to->e, to->mark, 1.0);
        k->right[k->system.n_chosen + i] = -turned;
        idle_turn(to, -turned);
        *error = fmax(*error, idle_error(curve, to->e));
        if (!(fabs(turned) <= most))
            most = fabs(turned);
    }
    system_solve(k, k->right);
    for (Int v = 0; v < k->nv; v++)
        k->right[v] *= k->scale[v];
    return most;
}

int third_tells(const Path *path, Real target)
{
    const Point *before = path->before, *here = path->here;
    return path->has_before && (here->s > before->s) == (target > here->s);
}

Real idle_way_to(const Path *path, Real target)
{
    const int is_fixed = path->accuracy.corrections >= 0; /* whatever that leaves */
    return is_fixed || third_tells(path, target) ? path->idle_way : IDLE_FIRST;
}

/* Longest step that idle rotations allow next, from the error of this one, of ninth order. From now on
   three points tell it. */
static int is_exact(Path *path, Real way, Real error)
{
    const Real part = path->accuracy.idle / fmax(error, 1e-30);
    path->idle_way = fmax(way * fmin(fmax(0.9 * pow(part, 1.0 / 9.0), 0.5), 2.5), IDLE_NEXT);
    return error <= 4.0 * path->accuracy.idle;
}

int take_idle_back(Path *path, Real way)
{
    Kernel *k = path->k;
    for (int pass = 0; pass < IDLE_PASSES; pass++) {
        Real error = 0.0;
        const Real most = idle_displacement(path, way, &error);
        if (!isfinite(most + error))
            return NOT_FINITE;
        if (!is_exact(path, way, error))
            return UNSAFE;
        if (pass == 0)
            path->idle_left += error + DBL_EPSILON; /* round-off may have one sign */
        if (most <= TOLERANCE_LAST_DIGIT)
            return DONE;
        tree_integrate(k, path->next->q, k->right);
        prescribed_put(&path->prescribed, path->next->q);
        if (turns_balls_only(k, k->right)) {
            turn_rates(path, k->right);
            return DONE;
        }
        equations_values(k, path->next->q);
        int code = factor_at_path_point(k);
        if (code == DONE)
            code = path_rates(path, path->next);
        if (code != DONE || most <= IDLE_SMALL)
            return code;
    }
    return NOT_CONVERGED;
}
