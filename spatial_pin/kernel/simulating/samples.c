/* Samples of a simulation within its steps.
 *
 * The loops of each are closed, its forces evaluated. Where the closure tolerance is loose, most
 * samples lie on polynomials of the time between a few others, the anchors, and the ends of steps.
 * One whose loops are not closed to the tolerance, or that misses the unknowns of the integrator, is
 * an anchor itself, and the next anchors are taken nearer. */
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

static int close(Integrator *g, Dynamics *d, const Run *run, Int i)
{
    const Real t = run->times[i];
    const int code = integrator_between(g, &t, 1, g->trial);
    return code == DONE ? dynamics_sample(d, t, g->trial, &run->rows, i) : code;
}

/* ---- samples between anchors ---- */

static void swap(Point *a, Point *b)
{
    const Point first = *a;
    *a = *b;
    *b = first;
}

static int anchor_at(Integrator *g, Dynamics *d, const Run *run, Int i, Point *anchor)
{
    const int code = close(g, d, run, i);
    if (code == DONE)
        dynamics_point(d, run->times[i], g->trial, anchor);
    return code;
}

/* Natural rate of an integrator's motion, in radians: 2 pi by the unit of its rates. */
static Real natural_rate(const Integrator *g, const Dynamics *d)
{
    return 2.0 * PI * g->atol[d->n_free] / g->rtol;
}

/* How far a sample is from the unknowns y: its independent coordinates, their rates, and bodies that
 * spin freely. */
static Real misses(const Integrator *g, const Dynamics *d, const Real *q, const Real *v, const Real *y)
{
    const Kernel *k = d->k;
    Real most = 0.0;
    for (Int i = 0; i < d->n_free; i++) {
        const Real x = relative_coordinate(k, d->held_joint[i], d->held_component[i], d->start, q);
        most = fmax(most, fabs(x - y[i]));
        if (d->held_q[i] >= 0)
            most = fmax(most, fabs(v[d->held[i]] / k->scale[d->held[i]] - y[d->n_free + i]) /
                                  natural_rate(g, d));
    }
    for (Int s = 0; s < d->spins.n; s++) {
        const Real *own = q + k->iq[d->spins.joint[s]], *x = y + 2 * d->n_free + 4 * s;
        const Real part = dot3(own, x) + own[3] * x[3], size = dot3(x, x) + x[3] * x[3];
        most = fmax(most, sqrt(fmax(0.0, 1.0 - part * part / size)));
    }
    return most;
}

/* Write sample i between two anchors; returns what it misses, relative to what it may: as its loops
 * are open, as far as it is from where they would close by an anchor's factors, and as it misses the
 * integrator's unknowns. It is infinite where one is no anchor. */
static Real write_between(Integrator *g, Dynamics *d, const Run *run, const Point *from,
                          const Point *to, Int i)
{
    const Kernel *k = d->k;
    const Real way = (to->s - from->s) * natural_rate(g, d), *y = g->trial;
    const Real part = fmin(MAY_LEAVE, MAY_BEND * way * way);
    integrator_between(g, run->times + i, 1, g->trial);
    if (dynamics_sample_between(d, from, to, run->times[i], y, &run->rows, i) != DONE)
        return INFINITY;
    const Real open = fmax(run->rows.numbers[4 * i], solve_correction(d->k, NULL)) / part;
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
            d->curve.stride = 0.5 * (to->s - from->s);
        const int code = anchor_at(g, d, run, run->row, from);
        if (code != DONE)
            return code;
    }
    if (most < EASILY)
        d->curve.stride = fmax(d->curve.stride, 2.0 * (to->s - from->s));
    return DONE;
}

/* The samples before `end`, with anchors a stride apart; the last one is where the step ends. */
static int between_anchors(Integrator *g, Dynamics *d, Run *run, Int end)
{
    Point *const from = d->curve.anchor, *const to = d->curve.anchor + 1,
                 *const ended = d->curve.anchor + 2;
    int code = DONE;
    if (from->s != g->t_old) { /* or there is none */
        code = anchor_at(g, d, run, run->row, from);
        run->row += code == DONE;
    }
    while (code == DONE && run->row < end) {
        if (ended->s - from->s <= d->curve.stride)
            return between(g, d, run, from, ended, end);
        Int next = run->row;
        while (next + 1 < end && run->times[next + 1] - from->s <= d->curve.stride)
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
    const int interpolates = run->between > 0.0 && !d->n_drives && !d->projects;
    if (interpolates) {
        swap(d->curve.anchor, d->curve.anchor + 2);
        dynamics_point(d, g->t, g->y, d->curve.anchor + 2);
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
