/* The shortest step that makes linear equations hold as well as they can, damped or not. */
#ifndef SPATIAL_PIN_LEAST_MOTION_H
#define SPATIAL_PIN_LEAST_MOTION_H

#include "kernel.h"

typedef struct {
    Int n, m;       /* equations, unknowns of the last factorisation */
    Int rank;
    Int *pivot;     /* equation of each column of R */
    Real *vectors;  /* (n, m) rows: Householder vectors of Jᵀ P = Q R */
    Real *factor;   /* of each */
    Real *R;        /* (min(n, m), n), rows; those below `rank` are taken as zero */
    Real *tall;     /* (min(n, m), n + min(n, m)) columns of Rᵀ over damping, then its own vectors */
    Real *right;    /* (n + m) */
    Real *square_lengths;     /* (n) squared lengths of columns that are left */
} LeastMotion;

/* For n equations of `most` unknowns or fewer; DONE or NO_MEMORY. */
int least_motion_create(Kernel *k, Int n, Int most, LeastMotion *out);
/* J (n, m); equations whose pivots are below `cut` times the largest move nothing */
void least_motion_factor(LeastMotion *e, const Real *J, Int m, Real cut);
/* x of least |x| that minimises |J x + residual|^2 + damping |x|^2; damping may be 0 */
void least_motion_solve(LeastMotion *e, Real damping, const Real *residual, Real *x);

#endif
