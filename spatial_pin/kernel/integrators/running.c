/* Many steps of a mechanism in time, with the samples within them, until something wants to be
 * looked at: a limit, a branch point, other coordinates, a motion that is stiff or hardly goes on. */
#include "running.h"

/* Why a run of steps paused; after FULL, STIFF, CREEPING and LIMIT the samples of its last step are
 * still to be made, after NO_SAMPLES they could not be. */
enum Pause { AT_END = 0, AT_FAILURE = 1, NEW_COORDINATES = 2, FULL = 3, STIFF = 4, CREEPING = 5,
             MANY = 6, RAISED = 7, LIMIT = 8, NO_SAMPLES = 9 };

/* Step, and pivot, relative to the largest so far, below which the motion creeps: neither alone
   is one */
#define CREEPS_BELOW 1e-3
#define NOWHERE 1e-2 /* of the longest step, that all steps allowed would lead to */
#define NEAR_LIMIT 0.5 /* of a velocity limit: a nearer velocity may pass it within a step */
#define COORDINATES_END 1.0 /* rotation vector at which coordinates are begun anew [rad] */

/* Whether a limit may have been passed in the last step, at whose end the mechanism stands: the
 * joint is beyond it, or has turned back near it, or is nearly as fast as allowed. A joint that swings
 * as a sine turns back by less than the step times both rates unless the step is nearly a period. */
static int meets_limit(const Integrator *g, const Dynamics *d, const Run *run)
{
    const Real h = g->t - g->t_old;
    int meets = run->looks != 0;
    for (Int i = 0; i < run->n_limits; i++) {
        const Real value = run->limit_value[i], rate = d->v[run->limit_v[i]];
        const Real side = (Real)run->limit_side[i];
        Real *before = run->limit_before + 2 * i, room = value - fabs(rate);
        if (side == 0.0)
            meets = meets || (before[0] >= 0.0 && fmin(before[0], room) < NEAR_LIMIT * value);
        else {
            room = side * (value - d->q[run->limit_q[i]]);
            const int turns = before[1] > 0.0 && side * rate < 0.0 &&
                              fmin(before[0], room) < h * (before[1] - side * rate);
            meets = meets || (before[0] >= 0.0 && (room < 0.0 || turns));
        }
        before[0] = room;
        before[1] = side * rate;
    }
    return meets;
}

static int creeps(Integrator *g, const Dynamics *d, Run *run)
{
    const Real h = g->t - g->t_old, pivot = d->crosses ? 1.0 : d->pivot;
    run->largest_step = fmax(run->largest_step, h);
    run->largest_pivot = fmax(run->largest_pivot, pivot);
    return (h < CREEPS_BELOW * run->largest_step && pivot < CREEPS_BELOW * run->largest_pivot) ||
           h * run->allowed < NOWHERE * run->largest_step;
}

/* Note the branch points that the last step has passed, whose samples are those from `first` on. */
static void note_branch_points(const Integrator *g, const Dynamics *d, Run *run, Int first)
{
    const Int room = MOST_CROSSED - run->n_crossed, q = d->held_q[0];
    const Int n = crossing_points(d, g->y_old[0], g->y[0], run->crossed + run->n_crossed, room);
    const Real sense = g->y[0] >= g->y_old[0] ? 1.0 : -1.0, scale = d->k->scale[d->held[0]];
    for (Int i = run->n_crossed; i < run->n_crossed + n; i++) {
        Int row = first;
        for (; row < run->row; row++) {
            const Real x = (run->rows.q[row * d->k->nq + q] - d->start[q]) / scale;
            if (!(sense * (x - run->crossed[i]) < 0.0))
                break;
        }
        run->crossed_row[i] = row;
    }
    run->n_crossed += n;
}

static int needs_new_coordinates(const Integrator *g, Dynamics *d, const Run *run)
{
    for (Int i = 0; !d->is_linear && i < d->n_free; i++)
        if (fabs(g->y[i]) > COORDINATES_END)
            return 1;
    return dynamics_save(d) > run->patience;
}

/* Steps, until something wants to be looked at; why it paused. Those of a mechanism have samples; d
 * NULL: they are of another function. */
EXPORT int integrator_run(Integrator *g, Dynamics *d, Run *run)
{
    for (Int step = 0; step < run->most; step++) {
        const Int first = run->row;
        if (integrator_step(g) != DONE)
            return RAISED;
        if (g->status == FAILED)
            return AT_FAILURE;
        if (!d && g->status == FINISHED)
            return AT_END;
        if (!d)
            continue;
        if (creeps(g, d, run))
            return CREEPING;
        if (meets_limit(g, d, run))
            return LIMIT;
        if (g->is_stiff)
            return STIFF;
        if (run->n_crossed > MOST_CROSSED / 2)
            return FULL;
        const int code = samples_of_step(g, d, run);
        if (code != DONE) {
            run->row = first;
            return code == CALLBACK_FAILED ? RAISED : NO_SAMPLES;
        }
        if (d->crosses)
            note_branch_points(g, d, run, first);
        if (needs_new_coordinates(g, d, run))
            return NEW_COORDINATES;
        if (g->status == FINISHED)
            return AT_END;
    }
    return MANY;
}

