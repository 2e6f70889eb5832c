/* Rates of a mechanism with some freedoms driven, and what round-off leaves of them: see rates.c. */
#ifndef SPATIAL_PIN_RATES_H
#define SPATIAL_PIN_RATES_H

#include "kernel.h"

typedef struct Rates Rates;

/* Inputs and results at n configurations, a row each: as `_RateTask` in rate_solver.py.
   Results that are NULL are not wanted. */
typedef struct {
    Int n;
    const Real *q, *reference; /* (n, nq), (n, n_angles) from which angles of screws count */
    const Int *equations;      /* (n_equations) closure equations; NULL: they are chosen at each */
    Int n_equations;
    const Real *fill; /* (n_fill, nv) rows, with respect to v / scale, that fill the system up */
    Int n_fill;
    const Real *speed;         /* (n, n_driven) of the driven freedoms; NULL: rates are not wanted */
    const Real *acceleration;  /* (n, n_driven) likewise */
    const Real *motion;        /* (n, nv) joint velocities along which `jacobian_rate` is */
    Int joint;                 /* that carries a point, */
    const Real *local;         /* (3) in its axes; NULL: there is none */
    Int *code;                 /* (n) DONE; UNSAFE or SINGULAR where there are no rates; NOT_FINITE where
                                  `v` or `a` is larger than numbers can be */
    Real *columns;             /* (n, nv, n_moving) joint velocities per unit speed of each that moves */
    Real *second;              /* (n, nv, n_moving, n_moving) accelerations per product of two speeds */
    Real *jacobian;            /* (n, 6, n_moving) of the point in closed loops: linear above angular,
                                  world axes; */
    Real *jacobian_rate;       /* its derivative by time */
    Real *v, *a;               /* (n, nv) */
    Real *facts;               /* (n, 3) smallest over largest pivot, round-off of the rates by their
                                  size, and what of it is known without the velocities */
} RateTask;

/* Memory for rates of a kernel, freed with it. Of the driven freedoms the first n_moving move. */
EXPORT int rates_create(Kernel *k, const Int *driven, Int n_driven, Int n_moving, Rates **out);

/* Evaluate, factor and solve at each configuration: DONE, or why arrays or memory do not do. */
EXPORT int rates_solve(Rates *r, const RateTask *task);

/* Joint rates (nv) of any order, at the last configuration. Where joints have no rate of that order,
   the equations have the second derivatives at joint velocities v (nv), or these derivatives
   (n_equations); either may be NULL. Driven coordinates have rates `drive` (n_driven); no component with
   `derivative`. */
EXPORT int rates_answer(Rates *r, const Real *v, const Real *derivative, const Real *drive, Real *out);

#endif
