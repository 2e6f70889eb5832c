/* J Jᵀ of a sparse J (n rows), and Cholesky factors of J Jᵀ + damping over its envelope. */
#ifndef SPATIAL_PIN_ENVELOPE_H
#define SPATIAL_PIN_ENVELOPE_H

#include "kernel.h"

typedef struct {
    Int n, nv;
    const Int *start, *column; /* pattern of J, by rows */
    Int *order;                /* the row of J at each place */
    Int *first;                /* first place that a place shares a column with */
    Int *at;                   /* where the entries of each place begin, from `first` on */
    Real *square;              /* J Jᵀ, lower half, by rows */
    Real *factor;              /* L, its diagonal inverted */
    Real *wide;                /* (nv) zero between uses */
    Real *answer;              /* (n) in the order of places */
    Real largest;              /* of the diagonal of J Jᵀ */
} Envelope;

/* The order of rows is chosen from the pattern alone. DONE or NO_MEMORY. */
int envelope_create(Kernel *k, Int n, const Int *start, const Int *column, Envelope *out);
void envelope_square(Envelope *e, const Real *value);
int envelope_factor(Envelope *e, Real damping); /* 0 where J Jᵀ + damping is not positive */
/* multipliers y of J Jᵀ y = right, both in the order of the rows of J */
void envelope_solve(const Envelope *e, const Real *right, Real *y);

#endif
