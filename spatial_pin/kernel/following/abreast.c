/* Samples between two points of a path, predicted by polynomials and closed side by side.
 *
 * Each is corrected by itself until it is closed as exactly as a point of the path; its rates are those of
 * its own equations. Links are turned about their own axes to where no idle rotation leaves them, on the
 * curves of the step. The path's tests are those of the step from one point to the other. */
#include <string.h>

#include "lanes.h"
#include "path.h"
#include "side_by_side.h"
#define idle_turned lanes_idle_turned
#include "idle_rotation.c"

#define ABREAST_CORRECTIONS 4 /* one of a good prediction, and one of round-off */

/* Components that are driven, rows that fill the system up and angles that sums define are found anew at
   every point, by branches that depend on its numbers. */
int goes_abreast(Path *path)
{
    Kernel *k = path->k;
    const PathAccuracy *wanted = &path->accuracy;
    if (wanted->order != 3 || wanted->corrections >= 0 || k->system.n_fill || k->system.n_pins ||
        k->implicit.n || !lanes_of(k))
        return 0;
    lanes_begin(k->memory.lanes);
    return 1;
}

/* ---- prediction ---- */

WITHIN void prescribe_lanes(Path *path, const Real *values)
{
    Prescribed *p = &path->prescribed;
    Lane *value = path->k->memory.lanes->prescribed, *rate = value + p->n, *bend = rate + p->n;
    for (int l = 0; l < LANES; l++) {
        prescribe(p, values[l]);
        for (Int i = 0; i < p->n; i++)
            value[i][l] = p->value[i], rate[i][l] = p->rate[i], bend[i][l] = p->bend[i];
    }
}

WITHIN void put_prescribed(const Path *path)
{
    const Prescribed *p = &path->prescribed;
    Abreast *s = path->k->memory.lanes;
    for (Int i = 0; i < p->n; i++)
        if (p->q_index[i] >= 0)
            s->next[p->q_index[i]] = s->prescribed[i];
    for (Int i = 0; i < p->n_still; i++)
        s->next[p->still[i]] = SPREAD(p->still_value[i]);
}

/* Returns the parts of the step at which the values are. */
WITHIN Lane predict_lanes(Path *path, const Point *from, const Real *values)
{
    const Between *p = &path->between;
    const Point *to = path->here;
    const Kernel *k = path->k;
    Abreast *s = k->memory.lanes;
    Lane u;
    for (int l = 0; l < LANES; l++)
        u[l] = (values[l] - p->s) / p->h;
    for (Int i = 0; i < k->nq; i++) {
        Lane at[3];
        polynomial_at(p->coefficient + i * (BETWEEN_DEGREE + 1), p->degree, u, at);
        s->next[i] = at[0];
    }
    for (Int i = 0; i < k->n_angles; i++)
        s->angle_reference[i] = from->angle[i] + u * (to->angle[i] - from->angle[i]);
    lanes_normalize(s);
    prescribe_lanes(path, values);
    put_prescribed(path);
    return u;
}

/* ---- closing them ---- */

/* The largest size of some entries, of any lane; NaN where one is. */
WITHIN Real largest_of(const Lane *x, const Int *index, Int n)
{
    Real most = 0.0;
    for (Int i = 0; i < n; i++)
        for (int l = 0; l < LANES; l++)
            most = larger_or_nan(most, fabs(x[index[i]][l]));
    return most;
}

/* How far a link has turned about its own axis since the step began, at parts u of it. */
WITHIN Lane turned_idly(const Path *path, Int idle, Lane u)
{
    const Kernel *k = path->k;
    const Abreast *s = k->memory.lanes;
    const Int vector = idle_vector(k, idle);
    const Lane *R = s->R + 9 * k->vectors.body[vector];
    Lane normal[3], e[3], mark[3];
    for (int i = 0; i < 3; i++)
        normal[i] = SPREAD(path->here->axis[idle].normal[i]);
    rotate3(R, s->vectors.local + 3 * vector, e);
    rotate3(R, normal, mark);
    return idle_turned(path->curve + idle, e, mark, u);
}

/* A correction; returns its largest scaled size. */
WITHIN Real correct_lanes(Path *path, Lane u)
{
    const Kernel *k = path->k;
    Abreast *s = k->memory.lanes;
    Lane *x = s->right, square = {0};
    Real most = 0.0;
    memset(x, 0, (size_t)k->nv * sizeof *x);
    for (Int i = 0; i < k->system.n_chosen; i++)
        x[i] = -s->residual[k->system.chosen[i]];
    for (Int i = 0; i < k->n_idle; i++)
        x[k->system.n_chosen + i] = -turned_idly(path, i, u);
    lanes_solve(s, x);
    for (Int v = 0; v < k->nv; v++) {
        square += x[v] * x[v];
        x[v] *= k->scale[v];
    }
    for (int l = 0; l < LANES; l++)
        most = larger_or_nan(most, square[l]);
    lanes_move(s);
    put_prescribed(path);
    return sqrt(most);
}

/* Newton's method of all lanes, from predictions: as `correct`, but that all have as many corrections. What
   links have turned idly is seen in a correction alone: it is squared by the one before. */
WITHIN int close_lanes(Path *path, Lane u, Real *predicted)
{
    const Kernel *k = path->k;
    Abreast *s = k->memory.lanes;
    const PathAccuracy *wanted = &path->accuracy;
    const Real part = residual_part(k->system.pivot_ratio), least = path->rounding;
    const Real tolerance = larger_of(part * wanted->tolerance, 0.3 * least);
    const Real enough = larger_of(part * wanted->enough, 0.1 * least);
    const Real left = larger_of(wanted->left, least);
    Real size = INFINITY, first = INFINITY;
    for (int count = 0;; count++) {
        lanes_residuals(s, &k->equations.system);
        const Real residual = largest_of(s->residual, k->system.chosen, k->system.n_chosen);
        if (count == 0)
            *predicted = larger_of(*predicted, residual);
        const int is_still = !k->n_idle || size * size <= TOLERANCE_LAST_DIGIT;
        if (is_still && (residual <= (count ? tolerance : enough) ||
                         (size <= TOLERANCE_ROUND_OFF && residual <= left)))
            return 1;
        if (count == ABREAST_CORRECTIONS || !(residual < TOLERANCE_HALF_PRECISION))
            return 0;
        if (!(first * residual <= 0.1 * tolerance) && !lanes_factor(s))
            return 0;
        const Real last = size;
        size = correct_lanes(path, u);
        if (!(size <= TOLERANCE_REGULAR) ||
            (count && size > TOLERANCE_CONTRACTION * last + TOLERANCE_ROUND_OFF))
            return 0;
        first = count ? first : size;
    }
}

/* ---- their rates, and their rows ---- */

/* 1, or 0 where a lane has no finite ones, as of a point of the path. */
WITHIN int find_rates(Path *path, Lane *squares)
{
    Abreast *s = path->k->memory.lanes;
    if (!lanes_factor(s))
        return 0;
    lanes_path_rates(s, squares);
    for (int l = 0; l < LANES; l++)
        if (!isfinite(squares[0][l] + squares[1][l]))
            return 0;
    return 1;
}

WITHIN void write_lane(Path *path, int l, const Lane *squares, const PathRows *rows, Int i)
{
    const Kernel *k = path->k;
    const Abreast *s = k->memory.lanes;
    Real *q = rows->q + i * k->nq, *t = rows->t + i * k->nv, *c = rows->c + i * k->nv;
    Real error = 0.0;
    for (Int x = 0; x < k->nq; x++)
        q[x] = s->q[x][l];
    for (Int v = 0; v < k->nv; v++)
        t[v] = s->t[v][l], c[v] = s->c[v][l];
    for (Int x = 0; x < k->n_angles; x++)
        rows->angles[i * k->n_angles + x] = s->angle[x][l];
    for (Int e = 0; e < k->n_closure; e++)
        error = larger_of(error, fabs(s->residual[e][l]));
    rows->error[i] = error;
    if (rows->estimate)
        estimate_at(path, sqrt(squares[0][l]), sqrt(squares[1][l]), error, rows->estimate + 3 * i);
}

FOR_WIDE int close_abreast(Path *path, const Point *from, const Real *values, Int n,
                           const PathRows *rows, Int i, Real *predicted)
{
    const Kernel *k = path->k;
    const Parts *rest = &k->equations.rest;
    Abreast *s = k->memory.lanes;
    const Real most = larger_of(path->accuracy.tolerance, path->open);
    if (rows->estimate)
        look_again(path);
    for (Int done = 0; done < n; done += LANES) {
        Real few[LANES];
        Lane squares[2];
        for (int l = 0; l < LANES; l++)
            few[l] = values[done + l < n ? done + l : n - 1];
        const Lane u = predict_lanes(path, from, few);
        if (!close_lanes(path, u, predicted) || !find_rates(path, squares))
            return 0;
        lanes_residuals(s, rest);
        if (rest->n_equations && !(largest_of(s->residual, rest->equation, rest->n_equations) <= most))
            return 0;
        for (int l = 0; l < LANES && done + l < n; l++)
            write_lane(path, l, squares, rows, i + done + l);
    }
    return 1;
}
