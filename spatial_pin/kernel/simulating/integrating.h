/* Steps in time, and what many of them want: what integrating.c and samples.c share. */
#ifndef SPATIAL_PIN_INTEGRATING_H
#define SPATIAL_PIN_INTEGRATING_H

#include "dynamics.h"

typedef int (*Rates)(void *context, Real t, const Real *y, Real *rates);
typedef struct Integrator Integrator;

struct Integrator {
    Int n, method, status, code;
    Real t, t_old, t_end, t_begin, next, longest, rtol;
    Int count, done; /* of fixed steps */
    Int steps, evaluations, many_long, many_short, is_stiff, is_dense;
    Real *y, *y_old, *f, *atol;
    Real *slope, *trial, *ended, *dense; /* (MOST_STAGES + 1, n), (n), (n), (7, n) */
    Rates rates;
    void *context;
};

enum { MOST_CROSSED = 64 };

typedef struct {
    const Real *times; /* of all samples */
    Int n_times, row;  /* how many there are, and how many are made */
    SampleRows rows;
    Int most;          /* steps to take */
    Real patience, largest_step, largest_pivot, allowed; /* allowed: steps of the whole */
    Int n_crossed;     /* branch points passed: the coordinate, and samples before */
    Real crossed[MOST_CROSSED];
    Int crossed_row[MOST_CROSSED];
    Int looks, n_limits;   /* whether every step is looked at; limits of coordinates */
    const Int *limit_q, *limit_v, *limit_side; /* side: 1 above, -1 below, 0 of the velocity */
    const Real *limit_value;
    Real *limit_before;    /* (2) room, and how fast it closes, where the last step ended */
    Real between; /* what samples between others may miss: closure, and x; 0: there are none */
} Run;

/* The last step at times (count,): unknowns (count, n). */
EXPORT int integrator_between(Integrator *g, const Real *times, Int count, Real *y);

/* Whether it tells derivatives of the unknowns as well; these (n), once `between` was asked. */
int integrator_has_slopes(const Integrator *g);
void integrator_slopes(const Integrator *g, Real t, Real *slopes);

/* The samples within the last step, from its beginning on; the mechanism is left at its end. */
int samples_of_step(Integrator *g, Dynamics *d, Run *run);

#endif
