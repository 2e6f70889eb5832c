/* All joint coordinates as unknowns, loops closed by projection [Eich1993].
 *
 * Unknowns are the relative coordinates of all joints and their velocities. What they say is
 * brought to the nearest configuration with closed loops, and to the nearest velocity that these
 * allow, before accelerations are worked out; after every step the unknowns themselves are. With
 * K x = -r solved for the held coordinates at rest, and Q an orthonormal basis of the freedoms'
 * motions, the shortest correction is x - Q Q^T x; the nearest velocity is Q Q^T v.
 *
 * Equations, pivots and held coordinates are those of independent coordinates: a step is good where
 * these, followed from its beginning, lead to the place that it is taken to. */
#include <string.h>

#include "correcting.h"
#include "dynamics.h"

#define MOST_CORRECTIONS 8   /* each leaves at most a quarter: 1e-4 of a residual, or it is lost */
/* How fast another joint may move by the held ones: it costs half a digit of the joint */
#define FASTER_THAN_HELD 4.0
/* Of the pivots where equations were chosen, at which others are tried: what the chosen ones leave
   open in those left out enters velocities by the square of their pivots */
#define RESELECT_PROJECTED 0.5
/* Apart, scaled, at which two closed configurations with the same held coordinates are one: what
   their tolerance leaves where the equations are ill conditioned */
#define SAME_PLACE TOLERANCE_HALF_PRECISION
/* Way of a step, ten turns, that errors allow only where nothing depends on the angle: no rank is
   lost on it */
#define NEVER_LOST 64.0

/* Evaluate the equations at d->q, screws in the turn that closes them best: steps may be long. */
static void evaluate(Dynamics *d)
{
    Kernel *k = d->k;
    memcpy(k->angle_reference, d->turns, (size_t)k->n_angles * sizeof *k->angle_reference);
    equations_close_turns(k, d->q);
    memcpy(d->turns, k->angle, (size_t)k->n_angles * sizeof *d->turns);
}

/* Leave of a motion (nv), scaled, its part along the freedoms, or across them. */
static void split(Dynamics *d, Real *motion, int along)
{
    const Int n = d->n_free, nv = d->k->nv;
    for (Int i = 0; i < n; i++) {
        Real sum = 0.0;
        for (Int v = 0; v < nv; v++)
            sum += d->work.freedoms[v * n + i] * motion[v];
        d->z[i] = sum;
    }
    for (Int v = 0; v < nv; v++) {
        Real sum = 0.0;
        for (Int i = 0; i < n; i++)
            sum += d->work.freedoms[v * n + i] * d->z[i];
        motion[v] = along ? sum : motion[v] - sum;
    }
}

static void shorten(void *owner, Real *step) { split(owner, step, 0); }

/* The shortest Newton correction of d->q. */
static void correct_shortest(Dynamics *d)
{
    const Held all_across = {.owner = d, .close = shorten};
    solve_correction(d->k, &all_across);
    tree_integrate(d->k, d->q, d->k->right);
}

/* Take d->q, whose loops are open by less than `allowed`, and d->v to where loops are closed. LOST
 * where they do not close, or have lost rank. */
static int project(Dynamics *d, Real allowed)
{
    Kernel *k = d->k;
    Real last = allowed;
    for (d->work.corrections = 0;; d->work.corrections++) {
        evaluate(d);
        const Real residual = chosen_residual(k);
        if (d->work.corrections == 0)
            d->work.opened = equations_error(k);
        const int stalls = !(residual < last);
        if (!isfinite(residual) || d->work.corrections == MOST_CORRECTIONS ||
            (stalls && (d->work.corrections == 0 || residual > TOLERANCE_NOTHING)))
            return LOST;
        if (independent_factor(d) != DONE || !(k->system.pivot_ratio > LEAST_SOLVED))
            return LOST;
        partitioning_orthonormal_freedoms(d);
        if (stalls || residual <= d->tolerance)
            break;
        last = TOLERANCE_CONTRACTION * residual;
        correct_shortest(d);
    }
    for (Int v = 0; v < k->nv; v++)
        d->v[v] /= k->scale[v];
    split(d, d->v, 1);
    for (Int v = 0; v < k->nv; v++)
        d->v[v] *= k->scale[v];
    return DONE;
}

static int project_unknowns(Dynamics *d, const Real *y, Real allowed)
{
    Kernel *k = d->k;
    relative_configuration(k, d->start, y, d->q);
    for (Int v = 0; v < k->nv; v++)
        d->v[v] = k->scale[v] * y[k->nv + v];
    const int code = project(d, allowed);
    if (code == DONE)
        independent_read(d);
    return code;
}

int projected_evaluate(Dynamics *d, const Real *y)
{
    const int code = are_finite(y, d->n_unknowns) ? project_unknowns(d, y, INFINITY) : LOST;
    if (code == DONE)
        independent_bias(d, d->v, NULL, d->a0);
    return code;
}

void projected_rates(Dynamics *d, Real *rates)
{
    const Kernel *k = d->k;
    relative_rates(d->k, d->start, d->q, d->v, rates);
    for (Int v = 0; v < k->nv; v++)
        rates[k->nv + v] = d->a[v] / k->scale[v];
}

/* ---- after a step ---- */

static Real distance(Dynamics *d, const Real *q)
{
    Real most = 0.0;
    relative_coordinates(d->k, d->q, q, d->work.step);
    for (Int v = 0; v < d->k->nv; v++)
        most = fmax(most, fabs(d->work.step[v]));
    return most;
}

/* Whether the held coordinates, followed from where the step began, lead to where it ends. */
static int leads_there(Dynamics *d)
{
    Real way = 0.0;
    for (Int i = 0; i < d->n_held; i++)
        way = fmax(way, fabs(d->x[i] - d->restart.x[i]));
    if (way > NEVER_LOST)
        return 1;
    independent_save(d, &d->work.ended);
    if (independent_restore(d, &d->restart) != DONE)
        return 0;
    memcpy(d->work.asking, d->work.ended.x, (size_t)d->n_held * sizeof *d->work.asking);
    return independent_follow(d, d->work.asking) == DONE && distance(d, d->work.ended.q) < SAME_PLACE;
}

static int has_better_equations(const Dynamics *d)
{
    return d->k->system.n_chosen < d->k->n_closure &&
           d->pivot < RESELECT_PROJECTED * d->determinant.first_pivot;
}

/* Take unknowns y (n_unknowns) at the end of a step to closed loops; tells how far these were open
 * and how many corrections it took. LOST, and y as it was, where they were open by more than is
 * allowed, where it is as good as singular, and where the step does not lead there. */
EXPORT int dynamics_settle(Dynamics *d, Real allowed, Real *y, Real *opened, Int *corrections)
{
    Kernel *k = d->k;
    if (project_unknowns(d, y, allowed) != DONE || !(d->pivot > TOLERANCE_SINGULAR))
        return LOST;
    *opened = d->work.opened, *corrections = d->work.corrections;
    if (!leads_there(d))
        return LOST;
    if (has_better_equations(d) &&
        (independent_choose_anew(d) != DONE || project(d, INFINITY) != DONE))
        return LOST;
    if (independent_pace(d) > FASTER_THAN_HELD && partitioning_hold_better(d) != DONE)
        return LOST;
    relative_coordinates(k, d->start, d->q, y);
    for (Int v = 0; v < k->nv; v++)
        y[k->nv + v] = d->v[v] / k->scale[v];
    return DONE;
}
