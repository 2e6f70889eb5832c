/* Rates of a mechanism with some freedoms driven, and what round-off leaves of them: see rates.c. */
#ifndef SPATIAL_PIN_RATES_H
#define SPATIAL_PIN_RATES_H

#include "kernel.h"

typedef struct Rates Rates;

/* What rates are solved for, and the result: as `_RateTask` in rate_solver.py. */
typedef struct {
    const Real *q, *reference; /* (nq), (n_angles) from which angles of screws count */
    const Int *equations;      /* (n_equations) closure equations; NULL: they are chosen here */
    Int n_equations;
    const Real *fill; /* (n_fill, nv) rows, with respect to v / scale, that fill the system up */
    Int n_fill;
    Int n_moving;              /* the first driven freedoms, which move: the others do not */
    const Real *speed;         /* (n_driven) of the driven freedoms; NULL: rates are not wanted */
    const Real *acceleration;  /* (n_driven) likewise */
    Real *columns;             /* (n_moving, nv) joint velocities per unit speed of each that moves */
    Real *v, *a;               /* (nv) */
    Real *facts;               /* (3) smallest over largest pivot, round-off of the rates by their size,
                                  and what of it is known without the velocities */
} RateTask;

/* Memory for rates of a kernel, freed with it. */
EXPORT int rates_create(Kernel *k, const Int *driven, Int n_driven, Rates **out);

/* Evaluate and factor at q, and solve for the rates if they are wanted: DONE; UNSAFE or SINGULAR where
   there are none; NOT_FINITE where they are larger than numbers can be. */
EXPORT int rates_solve(Rates *r, const RateTask *task);

/* Joint rates (nv), there, of any order. Where joints have no rate of that order, the equations have
   the second derivatives at joint velocities v (nv), or these derivatives (n_equations); either may
   be NULL. Driven coordinates have rates `drive` (n_driven); no component with `derivative`. */
EXPORT int rates_answer(Rates *r, const Real *v, const Real *derivative, const Real *drive, Real *out);

/* Joint velocities (n, nv), there, for a unit speed of each of the first n driven freedoms; and the
   closed-loop Jacobian (6, n) of a point fixed in a joint's body, linear above angular, world axes.
   `local` (3): the point in the joint's axes. `jacobian` may be NULL. */
EXPORT int rates_columns(Rates *r, Int n, Real *columns, Int joint, const Real *local, Real *jacobian);

#endif
