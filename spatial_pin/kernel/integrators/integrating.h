/* Runge-Kutta methods, of the rates of whatever it is: see integrating.c. */
#ifndef SPATIAL_PIN_INTEGRATING_H
#define SPATIAL_PIN_INTEGRATING_H

#include "kernel.h"

enum Status { RUNNING = 0, FINISHED = 1, FAILED = 2 };

/* dy/dt of n unknowns: DONE, or LOST where there are none, or CALLBACK_FAILED. */
typedef int (*RateFunction)(void *context, Real t, const Real *y, Real *rates);

/* A method on its way: as `_IntegratorStruct` in integrating.py, whose memory it is. */
typedef struct {
    Int n, method, status, code;
    Real t, t_old, t_end, t_begin, next, longest, rtol;
    Int count, done; /* of fixed steps */
    Int steps, evaluations, many_long, many_short, is_stiff, is_dense;
    Real *y, *y_old, *f, *atol;
    Real *slope, *trial, *ended, *dense; /* (MOST_STAGES + 1, n), (n), (n), (7, n) */
    RateFunction rates;
    void *context;
} Integrator;

/* Begin at unknowns y (n), with absolute tolerances (n) and zeroed room for (MOST_STAGES + 14, n)
 * numbers. Set are n, method, t, t_end, next (the first step of an adaptive method, the number of
 * fixed ones), longest, rtol; rates and context (rates NULL: of a Dynamics, which `context` is). Asks
 * for the first slope. */
EXPORT int integrator_begin(Integrator *g, const Real *y, const Real *atol, Real *room, Int n_room);

/* One step; g->status tells how it ended. DONE or CALLBACK_FAILED. */
int integrator_step(Integrator *g);

/* The last step at times (count,): unknowns (count, n). */
EXPORT int integrator_between(Integrator *g, const Real *times, Int count, Real *y);

#endif
