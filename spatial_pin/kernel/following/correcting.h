/* Newton's method near a path of closed configurations: small corrections of a prediction. */
#ifndef SPATIAL_PIN_CORRECTING_H
#define SPATIAL_PIN_CORRECTING_H

#include "prescribing.h"

/* Coordinates that are to have given values, where these are more than what stands still. */
typedef struct {
    void *owner;
    Real (*put)(void *owner, Real *q); /* what it can; how far the others are from their values */
    int (*factor)(void *owner);        /* at q, evaluated, instead of the kernel's own factors */
    void (*close)(void *owner, Real *x); /* add what takes that off to a step x (nv), scaled */
} Held;

typedef struct Correction {
    /* wanted */
    Real enough;  /* residual at which the prediction is left as it is */
    Real tolerance; /* residual to reach by corrections */
    Real left;    /* residual that round-off may leave where corrections do no more; it is never
                     below `tolerance` */
    Real allowed; /* largest first correction: a larger one is none of a prediction on the path */
    Int fixed;    /* corrections to make whatever the residual; -1: as many as it takes */
    Prescribed *prescribed; /* coordinates set after every correction; NULL: none */
    const Held *held; /* NULL: all that is driven stands still */
    Int reuse;    /* whether the factors at hand, of a point near by, may serve for the first one */
    Real away;    /* how far from there, if it is known: that part of a residual is about what a
                     correction with these factors leaves, and later with others; 0: not known */
    /* answered */
    Real first;   /* size of the first correction; 0 if there was none */
    Int count;    /* corrections made */
} Correction;

/* Correct q (nq) until the chosen equations hold, drivers standing still.
 *
 * The system is bordered by the rows of `system_set`: drivers, independent
 * coordinates, or filled rows such as a tangent. Corrections have sizes of v / scale (Euclidean).
 *
 * DONE: the values (`equations_values`), but not the Jacobian nor the factors, are those at q.
 * UNSAFE: the first correction was larger than allowed. NOT_CONVERGED: corrections did not
 * contract. SINGULAR, NO_MEMORY: as `system_factor`. NOT_FINITE: the residual was no number.
 * After all but DONE, q is anything. */
int correct(Kernel *k, Real *q, Correction *correction);

/* Solve for a correction where the equations are evaluated, with the factors at hand: k->right
 * becomes joint displacements. Returns its scaled size. `held` may be NULL. */
Real solve_correction(Kernel *k, const Held *held);

/* The part of a residual to ask for where the smallest pivot is that of the largest: a residual
 * leaves the more open in configurations and rates, the worse the equations are conditioned. */
Real residual_part(Real pivot_ratio);

/* Largest absolute residual of the chosen equations; NaN if one is. */
Real chosen_residual(const Kernel *k);

/* Whether the equations left out hold a step from q too, in all freedoms: where branches
 * cross, or a freedom is instantaneous only, they open by its square [ConnellyWhiteley1996]. DONE,
 * UNSAFE if they open, or the reason why that is unknown. The system is factored at q, where the closure
 * error is `error`; the kernel is left at `there` (nq), the end of the step. */
int stays_closed(Kernel *k, const Real *q, Real error, Real *there);

#endif
