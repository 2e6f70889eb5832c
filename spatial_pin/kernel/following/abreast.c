/* Samples between two points of a path, predicted by polynomials and closed side by side.
 *
 * Each is corrected by itself until it is closed as exactly as a point of the path; its rates are those of
 * its own equations. The path's tests are those of the step from one point to the other. */
#include <string.h>

#include "lanes.h"
#include "path.h"

#define ABREAST_CORRECTIONS 4 /* one of a good prediction, and one of round-off */

int goes_abreast(Path *path)
{
    const PathAccuracy *wanted = &path->accuracy;
    if (wanted->order != 3 || wanted->corrections >= 0 || !lanes_know(path->k) ||
        !lanes_of(path->k))
        return 0;
    lanes_begin(path->k, path->k->memory.lanes);
    return 1;
}

/* ---- prescribed values ---- */

WITHIN void prescribe_lanes(Path *path, const Real *values)
{
    Prescribed *p = &path->prescribed;
    Lane *to = path->k->memory.lanes->prescribed;
    for (int l = 0; l < LANES; l++) {
        prescribe(p, values[l]);
        for (Int i = 0; i < p->n; i++) {
            to[3 * i][l] = p->value[i];
            to[3 * i + 1][l] = p->rate[i];
            to[3 * i + 2][l] = p->bend[i];
        }
    }
}

WITHIN void put_prescribed(const Path *path)
{
    const Prescribed *p = &path->prescribed;
    Abreast *s = path->k->memory.lanes;
    for (Int i = 0; i < p->n; i++)
        if (p->q_index[i] >= 0)
            s->q[p->q_index[i]] = s->prescribed[3 * i];
}

/* Rates (which = 1), or accelerations (2), are those prescribed, to the last digit; and their scaled sizes'
   square. */
WITHIN void put_rates(const Path *path, int which, Lane *rates, Lane *square)
{
    const Kernel *k = path->k;
    *square = (Lane){0};
    for (Int v = 0; v < k->nv; v++) {
        *square += k->memory.lanes->right[v] * k->memory.lanes->right[v];
        rates[v] = k->scale[v] * k->memory.lanes->right[v];
    }
    for (Int i = 0; i < k->system.n_driven; i++)
        rates[k->system.driven[i]] = k->memory.lanes->prescribed[3 * i + which];
}

/* ---- closing them ---- */

WITHIN void predict_lanes(Path *path, const Real *values)
{
    const Between *p = &path->between;
    Kernel *k = path->k;
    Abreast *s = k->memory.lanes;
    Lane u;
    for (int l = 0; l < LANES; l++)
        u[l] = (values[l] - p->s) / p->h;
    for (Int i = 0; i < k->nq; i++) {
        const Real *c = p->coefficient + i * (BETWEEN_DEGREE + 1);
        Lane value = (Lane){0} + c[p->degree];
        for (Int d = p->degree - 1; d >= 0; d--)
            value = value * u + c[d];
        s->q[i] = value;
    }
    lanes_normalize(k, s);
    prescribe_lanes(path, values);
    put_prescribed(path);
}

/* The largest size of some entries, of any lane; NaN where one is. */
WITHIN Real largest_of(const Lane *x, const Int *index, Int n)
{
    Real most = 0.0;
    for (Int i = 0; i < n; i++)
        for (int l = 0; l < LANES; l++) {
            const Real size = fabs(x[index[i]][l]);
            if (size > most || isnan(size))
                most = size; /* which NaN stays */
        }
    return most;
}

/* A correction; returns its largest scaled size. */
WITHIN Real correct_lanes(Path *path)
{
    Kernel *k = path->k;
    Abreast *s = k->memory.lanes;
    Lane square = {0};
    Real most = 0.0;
    for (Int i = 0; i < k->nv; i++)
        s->right[i] = i < k->system.n_chosen ? -s->residual[k->system.chosen[i]] : (Lane){0};
    lanes_solve(k, s);
    for (Int v = 0; v < k->nv; v++) {
        square += s->right[v] * s->right[v];
        s->right[v] *= k->scale[v];
    }
    for (int l = 0; l < LANES; l++)
        if (square[l] > most || isnan(square[l]))
            most = square[l];
    lanes_move(k, s);
    put_prescribed(path);
    return sqrt(most);
}

/* Newton's method of all lanes, from predictions: as `correct`, but that all have as many corrections. */
WITHIN int close_lanes(Path *path, Real *predicted)
{
    Kernel *k = path->k;
    const PathAccuracy *wanted = &path->accuracy;
    const Real part = residual_part(k->system.pivot_ratio), least = path->rounding;
    const Real tolerance = larger_of(part * wanted->tolerance, 0.3 * least);
    const Real enough = larger_of(part * wanted->enough, 0.1 * least), left = larger_of(wanted->left, least);
    Real size = INFINITY, first = INFINITY;
    for (int count = 0;; count++) {
        lanes_residuals(k, k->memory.lanes, &k->equations.system, count == 0);
        const Real residual = largest_of(k->memory.lanes->residual, k->system.chosen, k->system.n_chosen);
        if (count == 0)
            *predicted = larger_of(*predicted, residual);
        if (residual <= (count ? tolerance : enough) || (size <= TOLERANCE_ROUND_OFF && residual <= left))
            return 1;
        if (count == ABREAST_CORRECTIONS || !(residual < TOLERANCE_HALF_PRECISION))
            return 0;
        if (!(first * residual <= 0.1 * tolerance) && !lanes_factor(k, k->memory.lanes))
            return 0;
        const Real last = size;
        size = correct_lanes(path);
        if (!(size <= TOLERANCE_REGULAR) || (count && size > TOLERANCE_CONTRACTION * last + TOLERANCE_ROUND_OFF))
            return 0;
        first = count ? first : size;
    }
}

/* ---- their rates, and their rows ---- */

/* 1, or 0 where a lane has no finite ones, as of a point of the path. */
WITHIN int find_rates(Path *path, Lane *squares)
{
    Kernel *k = path->k;
    Abreast *s = k->memory.lanes;
    const Int n = k->system.n_chosen;
    if (!lanes_factor(k, s))
        return 0;
    for (int which = 1; which <= 2; which++) {
        if (which == 2)
            lanes_bias(k, s);
        for (Int i = 0; i < n; i++)
            s->right[i] = which == 2 ? -s->equation_bias[k->system.chosen[i]] : (Lane){0};
        for (Int i = 0; i < k->system.n_driven; i++)
            s->right[n + i] = s->prescribed[3 * i + which] / k->scale[k->system.driven[i]];
        lanes_solve(k, s);
        put_rates(path, which, which == 1 ? s->t : s->c, squares + which - 1);
        for (int l = 0; l < LANES; l++)
            if (!isfinite(squares[which - 1][l]))
                return 0;
    }
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
    for (Int e = 0; e < k->n_closure; e++)
        error = larger_of(error, fabs(s->residual[e][l]));
    rows->error[i] = error;
    if (rows->estimate)
        estimate_at(path, sqrt(squares[0][l]), sqrt(squares[1][l]), error, rows->estimate + 3 * i);
}

FOR_WIDE int close_abreast(Path *path, const Real *values, Int n, const PathRows *rows, Int i, Real *predicted)
{
    Kernel *k = path->k;
    const Real most = larger_of(path->accuracy.tolerance, path->open);
    if (rows->estimate)
        look_again(path);
    for (Int done = 0; done < n; done += LANES) {
        Real few[LANES];
        Lane squares[2];
        for (int l = 0; l < LANES; l++)
            few[l] = values[done + l < n ? done + l : n - 1];
        predict_lanes(path, few);
        if (!close_lanes(path, predicted) || !find_rates(path, squares))
            return 0;
        lanes_residuals(k, k->memory.lanes, &k->equations.rest, 0);
        const Parts *rest = &k->equations.rest;
        if (rest->n_equations &&
            !(largest_of(k->memory.lanes->residual, rest->equation, rest->n_equations) <= most))
            return 0;
        for (int l = 0; l < LANES && done + l < n; l++)
            write_lane(path, l, squares, rows, i + done + l);
    }
    return 1;
}
