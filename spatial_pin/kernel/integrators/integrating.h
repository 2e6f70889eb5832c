/* Runge-Kutta methods, of the rates of whatever it is: see integrating.c. */
#ifndef SPATIAL_PIN_INTEGRATING_H
#define SPATIAL_PIN_INTEGRATING_H

#include "kernel.h"

enum Status { RUNNING = 0, FINISHED = 1, FAILED = 2 };

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

/* One step; g->status tells how it ended. DONE or ASK_FAILED. */
EXPORT int integrator_step(Integrator *g);

/* The last step at times (count,): unknowns (count, n). */
EXPORT int integrator_between(Integrator *g, const Real *times, Int count, Real *y);

/* Whether it tells derivatives of the unknowns as well; these (n), once `between` was asked. */
int integrator_has_slopes(const Integrator *g);
void integrator_slopes(const Integrator *g, Real t, Real *slopes);

#endif
