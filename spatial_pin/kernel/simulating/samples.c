/* Samples of a simulation within its steps.
 *
 * The loops of each are closed, its forces evaluated. Where the closure tolerance is loose, the
 * integrator tells the accelerations as well, and most samples lie on polynomials between a few
 * others, the anchors, and the ends of steps: polynomials of the coordinate of one freedom, which
 * moves along a curve, else of the time. One whose loops are not closed to the tolerance, or that
 * misses the integrator's independent coordinates, is closed like an anchor, and the next anchors
 * are taken nearer. */
#include <string.h>

#include "correcting.h"
#include "running.h"

#define MAY_LEAVE 0.1 /* of the closure tolerance, that polynomials may leave open */
/* Of that and the square of the way between two anchors: accelerations miss 24 times the rest by
   that square, which is to be a hundred times the closure at most */
#define MAY_BEND 4.0
/* Of what they may, below which anchors may be twice as far apart: that leaves 64 times as much, and
   there is a margin of four */
#define EASILY 4e-3
#define RETRIED 1.1 /* growth of the distance of anchors from one to the next with none between */

/* Whether the integrator tells the accelerations of samples. */
static int tells(const Integrator *g, const Dynamics *d, const Run *run)
{
    return run->between > 0.0 && !d->n_drives && !d->projects && integrator_has_slopes(g);
}

static int close(Integrator *g, Dynamics *d, const Run *run, Int i)
{
    const Real t = run->times[i], *z = NULL;
    const int code = integrator_between(g, &t, 1, g->trial);
    if (code != DONE)
        return code;
    if (tells(g, d, run)) {
        integrator_slopes(g, t, g->ended);
        z = g->ended + d->n_free;
    }
    return dynamics_sample(d, t, g->trial, z, &run->rows, i);
}

/* ---- samples between anchors ---- */

static void swap(Point *a, Point *b)
{
    const Point first = *a;
    *a = *b;
    *b = first;
}

/* Take the present point for an anchor: of the curve, none on a bridge; else of the motion, at a time
 * and with the accelerations d->a. */
static void note_anchor(const Dynamics *d, Real t, Point *anchor)
{
    const Kernel *k = d->k;
    anchor->s = NAN;
    memcpy(anchor->angle, d->turns, (size_t)k->n_angles * sizeof *d->turns);
    if (!d->curve.is_curve) {
        anchor->s = t;
        memcpy(anchor->q, d->q, (size_t)k->nq * sizeof *d->q);
        tree_entry_rates(k, d->q, d->v, d->a, anchor->first, anchor->second);
    } else if (d->bridge < 0 && d->curve.n_points && d->curve.point->s == d->x[0]) {
        anchor->s = d->curve.point->s;
        memcpy(anchor->q, d->curve.point->q, (size_t)(3 * k->nq + 2 * k->nv) * sizeof *anchor->q);
    }
}

static int anchor_at(Integrator *g, Dynamics *d, const Run *run, Int i, Point *anchor)
{
    const int code = close(g, d, run, i);
    if (code == DONE)
        note_anchor(d, run->times[i], anchor);
    return code;
}

/* Natural rate of an integrator's motion, in radians: 2 pi by the unit of its rates. */
static Real natural_rate(const Integrator *g, const Dynamics *d)
{
    return 2.0 * PI * g->atol[d->n_free] / g->rtol;
}

/* How far the independent coordinates of a sample, and their rates, are from the unknowns y. */
static Real misses(const Integrator *g, const Dynamics *d, const Real *q, const Real *v, const Real *y)
{
    Real most = 0.0;
    for (Int i = 0; i < d->n_free; i++) {
        const Real x = relative_coordinate(d->k, d->held_joint[i], d->held_component[i], d->start, q);
        const Real rate = v[d->held[i]] / d->k->scale[d->held[i]];
        most = fmax(most, fabs(x - y[i]));
        if (d->held_q[i] >= 0)
            most = fmax(most, fabs(rate - y[d->n_free + i]) / natural_rate(g, d));
    }
    return most;
}

/* Write sample i between two anchors; returns what it misses, relative to what it may: as its loops
 * are open, and as far as it is from where they would close by an anchor's factors. It is infinite
 * where the sample does not lie between them, or one is none. */
static Real write_between(Integrator *g, Dynamics *d, const Run *run, const Point *from,
                          const Point *to, Int i)
{
    const Kernel *k = d->k;
    const Int is_curve = d->curve.is_curve;
    const Real way = (to->s - from->s) * (is_curve ? 1.0 : natural_rate(g, d));
    const Real part = fmin(MAY_LEAVE, MAY_BEND * way * way), *y = g->trial, *slope = g->ended;
    integrator_between(g, run->times + i, 1, g->trial);
    integrator_slopes(g, run->times[i], g->ended);
    const int code = is_curve ? dynamics_sample_between(d, from, to, y[0], y[1], slope[1], y, &run->rows, i)
                              : dynamics_sample_between(d, from, to, run->times[i], 1.0, 0.0, y, &run->rows, i);
    if (code != DONE)
        return INFINITY;
    const Real open = fmax(run->rows.numbers[4 * i], solve_correction(d->k, NULL)) / part;
    if (is_curve)
        return open / run->between;
    return fmax(open, misses(g, d, run->rows.q + i * k->nq, run->rows.v + i * k->nv, y)) / run->between;
}

/* Write the samples from the next one to before `end`, between two anchors. One that leaves too much
 * open becomes the first of the two. How far apart the next ones may be follows. */
static int between(Integrator *g, Dynamics *d, Run *run, Point *from, const Point *to, Int end)
{
    Real most = 0.0;
    if (run->row == end)
        d->curve.stride *= RETRIED;
    for (; run->row < end; run->row++) {
        const Real open = write_between(g, d, run, from, to, run->row);
        most = fmax(most, open);
        if (open <= 1.0)
            continue;
        if (isfinite(open))
            d->curve.stride = 0.5 * fabs(to->s - from->s);
        const int code = anchor_at(g, d, run, run->row, from);
        if (code != DONE)
            return code;
    }
    if (most < EASILY)
        d->curve.stride = fmax(d->curve.stride, 2.0 * fabs(to->s - from->s));
    return DONE;
}

/* What the polynomials are of, at a time. */
static Real parameter_at(Integrator *g, const Dynamics *d, Real t)
{
    if (!d->curve.is_curve)
        return t;
    integrator_between(g, &t, 1, g->trial);
    return g->trial[0];
}

/* The samples before `end`, with anchors a stride apart; the last one is where the step ends. */
static int between_anchors(Integrator *g, Dynamics *d, Run *run, Int end)
{
    Point *const from = d->curve.anchor, *const to = d->curve.anchor + 1,
                 *const ended = d->curve.anchor + 2;
    int code = DONE;
    if (from->s != (d->curve.is_curve ? g->y_old[0] : g->t_old)) { /* or there is none */
        code = anchor_at(g, d, run, run->row, from);
        run->row += code == DONE;
    }
    while (code == DONE && run->row < end) {
        if (fabs(ended->s - from->s) <= d->curve.stride)
            return between(g, d, run, from, ended, end);
        Int next = run->row;
        while (next + 1 < end &&
               fabs(parameter_at(g, d, run->times[next + 1]) - from->s) <= d->curve.stride)
            next++;
        code = anchor_at(g, d, run, next, to);
        if (code == DONE)
            code = between(g, d, run, from, to, next);
        run->row += code == DONE;
        swap(from, to);
    }
    return code;
}

/* ---- samples of a step ---- */

static int one_by_one(Integrator *g, Dynamics *d, Run *run, Int end)
{
    int code = DONE;
    for (; code == DONE && run->row < end; run->row += code == DONE)
        code = close(g, d, run, run->row);
    return code;
}

int samples_of_step(Integrator *g, Dynamics *d, Run *run)
{
    Int end = run->row;
    while (end < run->n_times && run->times[end] <= g->t)
        end++;
    if (end == run->row)
        return DONE;
    /* the curve of bodies that spin freely depends on its steps, which turn them */
    const int interpolates = tells(g, d, run) && !d->spins.n;
    if (interpolates) {
        swap(d->curve.anchor, d->curve.anchor + 2);
        dynamics_accelerations(d);
        note_anchor(d, g->t, d->curve.anchor + 2);
    }
    independent_save(d, &d->work.ended);
    const int is_dense = g->is_dense;
    int code = crossing_restore(d, &d->restart);
    if (code == DONE && !is_dense) {
        code = integrator_between(g, NULL, 0, NULL);
        if (code == DONE)
            code = crossing_restore(d, &d->restart);
    }
    if (code == DONE)
        code = (interpolates ? between_anchors : one_by_one)(g, d, run, end);
    return code != DONE ? code : crossing_restore(d, &d->work.ended);
}
