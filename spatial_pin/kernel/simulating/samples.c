/* Samples of a simulation within its steps.
 *
 * The loops of each are closed, its forces evaluated. Where the closure tolerance is loose, the
 * integrator tells the accelerations as well. Where then one freedom moves along a curve, most
 * samples lie on polynomials between a few others, the anchors, and the ends of steps. One whose
 * loops are not closed to the tolerance is closed like an anchor, and the next anchors are taken
 * nearer. */
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

/* Take the present point of the curve for an anchor; none on a bridge. */
static void note_anchor(const Dynamics *d, Point *anchor)
{
    const Kernel *k = d->k;
    anchor->s = NAN;
    if (d->bridge >= 0 || !d->curve.n_points || d->curve.point->s != d->x[0])
        return;
    anchor->s = d->curve.point->s;
    memcpy(anchor->q, d->curve.point->q, (size_t)(3 * k->nq + 2 * k->nv) * sizeof *anchor->q);
    memcpy(anchor->angle, d->turns, (size_t)k->n_angles * sizeof *d->turns);
}

static int anchor_at(Integrator *g, Dynamics *d, const Run *run, Int i, Point *anchor)
{
    const int code = close(g, d, run, i);
    if (code == DONE)
        note_anchor(d, anchor);
    return code;
}

/* Write sample i between two anchors; returns what it misses, relative to what it may: as its loops
 * are open, and as far as it is from where they would close by an anchor's factors. It is infinite
 * where the sample does not lie between them, or one is none. */
static Real write_between(Integrator *g, Dynamics *d, const Run *run, const Point *from,
                          const Point *to, Int i)
{
    const Real way = to->s - from->s, part = fmin(MAY_LEAVE, MAY_BEND * way * way);
    integrator_between(g, run->times + i, 1, g->trial);
    integrator_slopes(g, run->times[i], g->ended);
    if (dynamics_sample_between(d, from, to, g->trial, g->ended[1], &run->rows, i) != DONE)
        return INFINITY;
    const Real open = run->rows.numbers[4 * i];
    return fmax(open, solve_correction(d->k, NULL)) / (part * run->between);
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

static Real coordinate_at(Integrator *g, Real t)
{
    integrator_between(g, &t, 1, g->trial);
    return g->trial[0];
}

/* The samples before `end`, with anchors a stride apart; the last one is where the step ends. */
static int between_anchors(Integrator *g, Dynamics *d, Run *run, Int end)
{
    Point *const from = d->curve.anchor, *const to = d->curve.anchor + 1,
                 *const ended = d->curve.anchor + 2;
    int code = DONE;
    if (from->s != g->y_old[0]) { /* or there is none */
        code = anchor_at(g, d, run, run->row, from);
        run->row += code == DONE;
    }
    while (code == DONE && run->row < end) {
        if (fabs(ended->s - from->s) <= d->curve.stride)
            return between(g, d, run, from, ended, end);
        Int next = run->row;
        while (next + 1 < end &&
               fabs(coordinate_at(g, run->times[next + 1]) - from->s) <= d->curve.stride)
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
    const int interpolates = tells(g, d, run) && d->curve.is_curve && !d->spins.n;
    if (interpolates) {
        swap(d->curve.anchor, d->curve.anchor + 2);
        note_anchor(d, d->curve.anchor + 2);
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
