/* What round-off leaves of velocities and accelerations, at a configuration that is itself known to
 * round-off only. */
#include <float.h>
#include <string.h>

#include "rates.h"

/* Of a solution, relative to its size, before pivots magnify it */
#define SOLUTION_ERROR (8.0 * DBL_EPSILON)
/* Of a closure equation at a configuration closed to round-off: half of the most that 160 random
   mechanisms had */
#define CLOSURE_ROUND_OFF (2.0 * DBL_EPSILON)
#define PATTERNS 2 /* of their signs: what one of them hides by chance, the other shows */

/* How far off the configuration may be, relative to what closure equations are off by: where this is
   one, some this way, some that way. Returns its size, `away` (nv) its direction. */
static Real direction_off(Rates *r, int pattern, Real *away)
{
    const Int nv = r->k->nv;
    memset(r->x, 0, (size_t)nv * sizeof(Real));
    for (Int i = 0; i < r->n_chosen; i++)
        r->x[i] = cos((Real)(pattern * (i + 1) * (i + 1))) < 0.0 ? -1.0 : 1.0;
    factors_solve(r->matrix, r->x);
    const Real size = largest(r->x, nv);
    for (Int v = 0; v < nv; v++)
        away[v] = size > 0.0 ? r->x[v] / size : 0.0;
    return size;
}

/* Change of the velocities t where the configuration changes along u, both relative to the scale:
   the polar form (a(t + u) - a(t - u)) / 4 of the accelerations, which are quadratic. Into r->x;
   returns its size. */
static Real response(Rates *r, const Real *t, const Real *u)
{
    const Kernel *k = r->k;
    memset(r->x, 0, (size_t)k->nv * sizeof(Real));
    for (int sign = 1; sign >= -1; sign -= 2) {
        for (Int v = 0; v < k->nv; v++)
            r->sum[v] = k->scale[v] * (t[v] + sign * u[v]);
        rates_add_bias(r, r->sum, -0.25 * sign, r->x);
    }
    factors_solve(r->matrix, r->x);
    return largest(r->x, k->nv);
}

/* How far velocities and accelerations, relative to their size, follow a configuration that is off
   by so much along `away`. Where branches cross, joints move no faster than the driver, and rates
   are uncertain all the same: velocities by the square of what a pivot magnifies, accelerations by
   its third power. */
static Real lost_along(Rates *r, Real off, const Real *away, const Real *velocity)
{
    const Kernel *k = r->k;
    Real size = 0.0, *t = r->along, *change = r->change;
    for (Int v = 0; v < k->nv; v++)
        size = fmax(size, fabs(velocity[v]) / k->scale[v]);
    if (!(size > 0.0))
        return 0.0;
    for (Int v = 0; v < k->nv; v++)
        t[v] = velocity[v] / k->scale[v] / size;
    const Real first = response(r, t, away);
    if (!(first > 0.0))
        return 0.0;
    for (Int v = 0; v < k->nv; v++)
        change[v] = r->x[v] / first;
    const Real second = 2.0 * first * response(r, t, change);
    response(r, t, t); /* a(2 t) / 4: the acceleration at constant speed of the driver */
    const Real bend = largest(r->x, k->nv);
    memcpy(change, r->x, (size_t)k->nv * sizeof(Real));
    const Real third = response(r, change, away);
    return off * fmax(first, (second + third) / fmax(bend, 1.0));
}

/* Whether what is closed to round-off loses no more than is known without the velocities. */
static int is_known_anyway(Rates *r, Real known)
{
    Real grown = 0.0;
    for (int pattern = 1; pattern <= PATTERNS; pattern++)
        grown = fmax(grown, direction_off(r, pattern, r->away));
    return !(2.0 * CLOSURE_ROUND_OFF * grown * grown * grown > known);
}

/* Round-off of the velocities v and of accelerations, relative to their size. Next to a limit
   position at a small distance e of the driver, joints move 1/sqrt(e) times as fast as the driver
   (`pace`); a configuration known to round-off times that gives rates to that squared. A short link
   leaves as much of it as its pivot: that is known without the velocities. A configuration that is
   not closed to round-off, as those of motions, is off by what is open. */
Real rates_round_off(Rates *r, const Real *v, Real known)
{
    const Real open = fmax(CLOSURE_ROUND_OFF, equations_error(r->k));
    if (open == CLOSURE_ROUND_OFF && is_known_anyway(r, known))
        return known; /* which is more than what could be found out */
    Real lost = 0.0;
    for (int pattern = 1; pattern <= PATTERNS; pattern++) {
        const Real off = open * direction_off(r, pattern, r->away);
        lost = fmax(lost, lost_along(r, off, r->away, v));
    }
    return fmin(1.0, known + lost);
}

Real rates_known_round_off(const Rates *r, Real pace)
{
    return fmin(1.0, SOLUTION_ERROR * pace * fmax(pace, 1.0 / fmax(r->matrix->pivot, 1e-300)));
}
