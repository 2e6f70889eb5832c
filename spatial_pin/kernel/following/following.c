/* A path of closed configurations, followed through many values of its parameter.
 *
 * A step is taken whole or not at all (stepping.c): what fails is tried again at half its length,
 * and where that does not help, the caller looks at what lies ahead. */
#include <stdlib.h>
#include <string.h>

#include "path.h"
#include "regular.h"

#define OPENED 2.0       /* times the rounding of a file by which equations left out may be open
                            before others are chosen: ill-conditioned choices show there first */

EXPORT int path_create(Kernel *k, const PathAccuracy *accuracy, Path **out)
{
    Path *path = *out = calloc(1, sizeof *path);
    if (!path)
        return NO_MEMORY;
    path->memory = calloc((size_t)(4 * point_numbers(k) + 3 * k->nv + k->nq * (BETWEEN_DEGREE + 1)) + 1, sizeof(Real));
    path->chosen = calloc((size_t)k->nv + 1, sizeof(Int));
    if (!path->memory || !path->chosen || prescribed_create(k, &path->prescribed) != DONE) {
        path_destroy(path);
        *out = NULL;
        return NO_MEMORY;
    }
    Real *from = path->memory;
    for (int i = 0; i < 3; i++)
        point_carve(k, &from, path->points + i);
    point_carve(k, &from, &path->middle);
    path->probe.t = from;
    path->probe.along = from + k->nv;
    path->probe.change = from + 2 * k->nv;
    path->between.coefficient = from + 3 * k->nv;
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
    prescribed_free(&path->prescribed);
    free(path);
}

/* Choose independent equations, as many as the system wants, at an evaluated point: SINGULAR where
 * there are fewer, UNSAFE where there are more. */
static int choose_first(Kernel *k)
{
    const int code = system_reselect(k);
    return code == DONE && k->left_out > TOLERANCE_RANK ? UNSAFE : code;
}

/* Whether the path begins where the loops are regular. */
static int is_regular(Path *path)
{
    path->stale = 1;
    return stays_closed(path->k, path->here->q, path->here->error, path->next->q);
}

EXPORT int path_prescribe(Path *path, Real begin, Int n_pieces, Int degree, const Real *breaks,
                          const Real *coefficients)
{
    const int code = prescribed_read(path->k, &path->prescribed);
    path->begin = begin;
    if (!isfinite(begin) || code != DONE)
        return BAD_ARRAYS;
    return prescribed_take(&path->prescribed, n_pieces, degree, breaks, coefficients);
}

/* Stand at q, with what is prescribed as it is there or, by polynomials, where the path begins. */
static int stand_at(Path *path, const Real *q)
{
    Prescribed *p = &path->prescribed;
    Point *here = path->here;
    const int code = prescribed_read(path->k, p);
    if (code != DONE)
        return code;
    memcpy(here->q, q, (size_t)path->k->nq * sizeof *q);
    here->s = path->begin;
    if (!p->n_pieces) {
        here->s = prescribed_from(p, q);
        return DONE;
    }
    p->piece = piece_ahead(p, here->s, 1.0);
    prescribe(p, here->s);
    prescribed_put(p, here->q);
    return DONE;
}

/* Nothing is known but the present point. */
static void forget(Path *path)
{
    const int is_fixed = path->accuracy.corrections >= 0;
    path->zero = INFINITY;
    path->zero_known = path->has_before = path->stale = 0;
    path->idle_way = is_fixed ? INFINITY : IDLE_FIRST;
    path->between_way = BETWEEN_FIRST * pow(path->accuracy.between, 1.0 / 7.0);
    path->degree = 0;
    path->open = OPENED * path->here->error;
    path->idle_left = path->missed = 0.0;
}

EXPORT int path_start(Path *path, const Real *q, const Real *angles, Int choose)
{
    Kernel *k = path->k;
    Point *here = path->here;
    int code = stand_at(path, q);
    if (code != DONE)
        return code;
    equations_values_near(k, here->q, angles);
    if (!isfinite(equations_error(k)))
        return NOT_FINITE;
    const int is_chosen = choose && has_redundant(k);
    if (is_chosen)
        code = choose_first(k);
    if (code == DONE)
        code = factor_here(k);
    if (code == DONE && k->pivot_ratio < TOLERANCE_NEAR_SINGULAR)
        code = UNSAFE;
    if (code == DONE)
        code = point_rates(k, &path->prescribed, here);
    if (code == DONE)
        probe_errors(path);
    keep_choice(path);
    path->sign = k->sign;
    path->selected = here->size;
    path->selected_ratio = k->pivot_ratio;
    forget(path);
    return code == DONE && is_chosen ? is_regular(path) : code;
}

EXPORT Int path_from_guess(Path *path, Closer *c, Reaching *r, const PathTask *task)
{
    int code;
    if (closer_reach(c, r) != DONE)
        return -2;
    if (!reached_straight(r, task->open) ||
        system_set(path->k, NULL, task->n_chosen, task->driven, task->n_driven, NULL, 0) != DONE ||
        path_start(path, r->q, r->angle, 1) != DONE)
        return -1;
    return path_follow(path, task->value, task->n, &task->rows, &code);
}

EXPORT int path_go(Path *path, Real target)
{
    const int code = reach(path, target);
    return code == DONE ? turn_into(path, 1.0) : code;
}

EXPORT Real path_stand(Path *path, const PathRows *row)
{
    write_row(path, row, 0);
    return path->here->s;
}
