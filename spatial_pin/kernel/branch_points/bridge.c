/* Places on a bridge: polynomials through its nodes [BerrutTrefethen2004, 4.2]. */
#include <string.h>

#include "bridge.h"

void bridge_weights(Bridge *s, Int first, Int count)
{
    const Real width = fabs(s->x[first + count - 1] - s->x[first]);
    for (Int i = first; i < first + count; i++) {
        s->weight[i] = 1.0;
        for (Int j = first; j < first + count; j++)
            if (j != i)
                s->weight[i] *= 0.25 * width / (s->x[i] - s->x[j]);
    }
}

/* The polynomial through `count` nodes from `first` on, of rows of n numbers. */
void bridge_interpolate(const Bridge *s, Int first, Int count, const Real *rows, Int n, Real x,
                         Real *out)
{
    Real sum = 0.0;
    memset(out, 0, (size_t)n * sizeof *out);
    for (Int i = first; i < first + count; i++) {
        if (x == s->x[i]) {
            memcpy(out, rows + i * n, (size_t)n * sizeof *out);
            return;
        }
        const Real part = s->weight[i] / (x - s->x[i]);
        sum += part;
        for (Int j = 0; j < n; j++)
            out[j] += part * rows[i * n + j];
    }
    for (Int j = 0; j < n; j++)
        out[j] /= sum;
}

void bridge_evaluate(Dynamics *d, const Bridge *s, Int turn, Real x)
{
    Kernel *k = d->k;
    const Real local = x - (Real)turn * d->branches.period;
    bridge_interpolate(s, 0, 2 * NODE, s->q, k->nq, local, d->work.trial);
    bridge_interpolate(s, 0, 2 * NODE, s->angles, k->n_angles, local, k->angle_reference);
    for (Int i = 0; turn && i < k->nq; i++)
        d->work.trial[i] += (Real)turn * d->branches.period_q[i];
    for (Int i = 0; turn && i < k->n_angles; i++)
        k->angle_reference[i] += (Real)turn * d->branches.period_angle[i];
    tree_normalize(k, d->work.trial);
    d->work.trial[d->held_q[0]] = d->start[d->held_q[0]] + k->scale[d->held[0]] * x;
    equations_values(k, d->work.trial);
}

int bridge_repeats(const Dynamics *d)
{
    return d->branches.period != 0.0 && d->branches.period_is_known >= 0;
}

Int bridge_turns(const Dynamics *d, const Bridge *s, Real x)
{
    if (!bridge_repeats(d))
        return 0;
    const Real middle = 0.5 * (s->low + s->high);
    return (Int)floor((x - middle) / d->branches.period + 0.5);
}

Real distance_to_branch_point(const Dynamics *d, Real sense)
{
    return d->determinant.distance * sense > 0.0 ? d->determinant.distance * sense : INFINITY;
}

Real fastest_pace(const Dynamics *d) { return largest(d->columns, d->k->nv); }
