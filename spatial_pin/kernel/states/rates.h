/* Rates of a mechanism with some freedoms driven, see rates.c; what round-off leaves of them, see
 * rate_errors.c. */
#ifndef SPATIAL_PIN_RATES_H
#define SPATIAL_PIN_RATES_H

#include "factors.h"
#include "pins.h"

typedef struct Rates {
    Kernel *k;
    Int n_driven, n_chosen, wanted; /* wanted: closure equations that there have to be */
    const Int *driven; /* freedoms v, or nv + v for the component that v is of, see pins.h */
    Pin *pin;         /* (n_driven) of those that are components */
    Int *chosen;      /* closure equations, ascending */
    Factors *matrix;  /* K */
    Real *x;          /* (nv) */
    Real *away, *along, *change, *sum; /* (nv) to tell what round-off leaves */
    Real *q;          /* (nq) */
    int is_placed;    /* whether K is that of a configuration */
} Rates;

/* x += factor times the second derivatives of the equations, and of driven components, at joint
   velocities v. */
void rates_add_bias(Rates *r, const Real *v, Real factor, Real *x);
/* Round-off of velocities and accelerations, relative to their size: what is known of it without the
   velocities, where the fastest joint moves `pace` times as fast as what is driven; and with them. */
Real rates_known_round_off(const Rates *r, Real pace);
Real rates_round_off(Rates *r, const Real *v, Real known);

#endif
