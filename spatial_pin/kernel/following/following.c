/* A path of closed configurations, followed through many values of its parameter.
 *
 * A step is taken whole or not at all (stepping.c): what fails is tried again at half its length,
 * and where that does not help, the caller looks at what lies ahead. */
#include <stdlib.h>
#include <string.h>

#include "memory.h"
#include "path.h"

#define OPENED 2.0       /* times the rounding of a file by which equations left out may be open
                            before others are chosen: ill-conditioned choices show there first */
#define WITH_THIRD 0.1  /* first way of polynomials that a third point is needed for, put ahead */
#define ABREAST_FIRST 0.3 /* first way between points that samples are closed between */
#define BETWEEN_FIRST 0.5 /* first way between points that samples are interpolated between, by the
                            seventh root of the error allowed, which grows with its seventh power */

/* The path of a kernel, made once; NULL if there is no memory. */
static Path *path_of(Kernel *k)
{
    Path *path = k->path;
    if (path)
        return path;
    if (!(path = kernel_memory(k, 1, sizeof *path)))
        return NULL;
    const Int entries = (k->nq + k->n_angles) * (BETWEEN_DEGREE + 1);
    Real *from = kernel_reals(k, 4 * point_numbers(k) + 4 * k->nv + entries);
    Int *chosen = kernel_ints(k, k->nv);
    path->curve = kernel_memory(k, k->n_idle, sizeof *path->curve);
    if (!kernel_had_memory(k) || prescribed_create(k, &path->prescribed) != DONE)
        return NULL;
    for (int i = 0; i < 3; i++)
        point_carve(k, &from, path->points + i);
    point_carve(k, &from, &path->middle);
    path->probe.t = from;
    path->probe.along = from + k->nv;
    path->probe.change = from + 2 * k->nv;
    path->probe.c = from + 3 * k->nv;
    path->between.coefficient = from + 4 * k->nv;
    path->k = k;
    path->chosen = chosen;
    path->here = path->points;
    path->before = path->points + 1;
    path->next = path->points + 2;
    return k->path = path;
}

/* Choose independent equations, as many as the system wants, at an evaluated point: SINGULAR where
 * there are fewer, UNSAFE where there are more. */
static int choose_first(Kernel *k)
{
    const int code = system_reselect(k);
    return code == DONE && k->system.left_out > TOLERANCE_RANK ? UNSAFE : code;
}

/* Whether the path begins where the loops are regular. */
static int is_regular(Path *path)
{
    path->stale = 1;
    return stays_closed(path->k, path->here->q, path->here->error, path->next->q);
}

/* Move to q; prescribed values are those of q or, by polynomials, those where the path begins. */
static int move_to(Path *path, const Real *q)
{
    Prescribed *p = &path->prescribed;
    const PathTask *task = &path->task;
    Point *here = path->here;
    const int code = prescribed_read(path->k, p, q, task->n_pieces, task->degree,
                                     task->breaks, task->coefficients);
    if (code != DONE || !isfinite(task->begin))
        return code != DONE ? code : BAD_ARRAYS;
    memcpy(here->q, q, (size_t)path->k->nq * sizeof *q);
    here->s = task->begin;
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
    path->between_way = path->accuracy.between > WITHOUT_THIRD
                            ? BETWEEN_FIRST * pow(path->accuracy.between, 1.0 / 7.0) : WITH_THIRD;
    path->abreast_way = ABREAST_FIRST;
    path->degree = 0;
    path->open = OPENED * path->here->error;
    path->idle_left = path->missed = 0.0;
}

/* Choose equations, if there are more than are wanted, and find the rates where the path starts. */
static int start(Path *path, const Real *angles)
{
    Kernel *k = path->k;
    Point *here = path->here;
    equations_values_near(k, here->q, angles);
    if (!isfinite(equations_error(k)))
        return NOT_FINITE;
    const int is_chosen = !path->task.chosen && has_redundant(k);
    int code = is_chosen ? choose_first(k) : DONE;
    if (code == DONE)
        code = factor_at_path_point(k);
    if (code == DONE && k->system.pivot_ratio < TOLERANCE_NEAR_SINGULAR)
        code = UNSAFE;
    if (code == DONE)
        code = path_rates(path, here);
    if (code == DONE && path->task.here.estimate)
        probe_errors(path);
    keep_choice(path);
    path->sign = k->system.sign;
    path->selected = here->size;
    path->selected_ratio = k->system.pivot_ratio;
    forget(path);
    return code == DONE && is_chosen ? is_regular(path) : code;
}

/* Start the path at q, with the system that is set. */
static int start_at(Path *path, const PathTask *task, const Real *q, const Real *angles)
{
    path->task = *task;
    path->accuracy = task->accuracy;
    int code = move_to(path, q);
    if (code == DONE)
        code = start(path, angles);
    path->has_started = code == DONE;
    return code;
}

static void write_here(Path *path)
{
    *path->task.s = path->here->s;
    write_row(path, &path->task.here, 0);
}

EXPORT int path_start(Kernel *k, const PathTask *task, const Real *q, const Real *angles)
{
    Path *path = path_of(k);
    if (!path)
        return NO_MEMORY;
    int code = system_set(k, task->chosen, task->n_chosen, task->driven, task->n_driven, task->fill,
                          task->n_fill);
    path->has_started = 0;
    if (code == DONE)
        code = start_at(path, task, q, angles);
    if (code == DONE)
        write_here(path);
    return code;
}

EXPORT Int path_follow(Kernel *k, const Real *values, Int n, const PathRows *rows)
{
    if (!k->path || !k->path->has_started)
        return 0;
    const Int reached = follow_values(k->path, values, n, rows);
    write_here(k->path);
    return reached;
}

EXPORT Int path_from_guess(Kernel *k, const PathTask *task, Closer *c, ClosureTask *guess,
                           const Real *values, Int n, const PathRows *rows)
{
    if (closer_close(c, guess) != DONE)
        return -2;
    if (!closed_straight(guess, task->open) || path_start(k, task, guess->q, guess->angle) != DONE)
        return -1;
    return path_follow(k, values, n, rows);
}

/* ---------------------------------------------------------------- scattered values */

static const Real LINE[2] = {0.0, 1.0}; /* parameters of a line: one at its start, zero at its end */

/* The reached row that a row comes from, or -1. */
static Int origin(const ScatterTask *s, Int row)
{
    Int from = row;
    for (Int i = 0; i < s->n_rows && within(from, s->n_rows); i++) {
        from = s->parent[from];
        if (within(from, s->n_rows) && s->part[from] >= 1.0)
            return from;
    }
    return -1;
}

static void put_line(const ScatterTask *s, Int from, Int row)
{
    const Real *first = s->values + from * s->n_values, *last = s->values + row * s->n_values;
    for (Int i = 0; i < s->n_values; i++) {
        s->line[2 * i] = last[i]; /* exact where the line ends */
        s->line[2 * i + 1] = first[i] - last[i];
    }
}

/* Start at the first row, for the order of pivots that is chosen there: with it a row depends on no
   other one that was found before. */
static int start_over(Kernel *k, const PathTask *line, const ScatterTask *s, Int *orders)
{
    put_line(s, s->n_rows - 1, s->n_rows - 1);
    const Int root = s->n_rows - 1;
    const int code = path_start(k, line, s->rows.q + root * k->nq, s->rows.angles + root * k->n_angles);
    *orders = k->system.orders;
    return code;
}

/* Where a line cannot be begun its row is that of its start. */
static void copy_row(const Kernel *k, const PathRows *rows, Int from, Int to)
{
    memcpy(rows->q + to * k->nq, rows->q + from * k->nq, (size_t)k->nq * sizeof(Real));
    memset(rows->t + to * k->nv, 0, (size_t)k->nv * sizeof(Real));
    memset(rows->c + to * k->nv, 0, (size_t)k->nv * sizeof(Real));
    rows->error[to] = rows->error[from];
    for (Int i = 0; i < k->n_angles; i++)
        rows->angles[to * k->n_angles + i] = rows->angles[from * k->n_angles + i];
}

static int find_row(Kernel *k, const PathTask *line, const ScatterTask *s, Int row, Int *orders)
{
    const Int from = within(row, s->n_rows) ? origin(s, row) : -1;
    const int is_kept = k->system.orders == *orders && lu_has_order(k->system.lu);
    if (from < 0)
        return BAD_ARRAYS;
    int code = is_kept ? DONE : start_over(k, line, s, orders);
    put_line(s, from, row);
    copy_row(k, &s->rows, from, row);
    s->part[row] = 0.0;
    if (code == DONE)
        code = start_at(k->path, line, s->rows.q + from * k->nq, s->rows.angles + from * k->n_angles);
    if (code != DONE)
        return code;
    Path *path = k->path;
    path->goes_to_end = s->is_last != 0;
    reach(path, 0.0);
    path->goes_to_end = 0;
    write_row(path, &s->rows, row);
    s->part[row] = 1.0 - path->here->s;
    return DONE;
}

EXPORT int path_scatter(Kernel *k, const PathTask *task, const ScatterTask *scatter)
{
    PathTask line = *task;
    Int orders = -1;
    if (scatter->n_values < 0 || scatter->n_values > task->n_driven || scatter->n_rows < 1)
        return BAD_ARRAYS;
    line.begin = LINE[1], line.n_pieces = line.degree = 1;
    line.breaks = LINE, line.coefficients = scatter->line;
    line.here.estimate = NULL;
    for (Int i = 0; i < scatter->n; i++) {
        const int code = find_row(k, &line, scatter, scatter->row[i], &orders);
        if (code == BAD_ARRAYS || code == NO_MEMORY)
            return code;
    }
    return DONE;
}
