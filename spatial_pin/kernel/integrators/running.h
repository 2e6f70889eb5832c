/* A simulation's steps with their samples: what running.c and samples.c share. */
#ifndef SPATIAL_PIN_RUNNING_H
#define SPATIAL_PIN_RUNNING_H

#include "dynamics.h"
#include "integrating.h"

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

/* The samples within the last step, from its beginning on; the mechanism is left at its end. */
int samples_of_step(Integrator *g, Dynamics *d, Run *run);

#endif
