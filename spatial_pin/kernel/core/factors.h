/* A square matrix and its factors, for few or many unknowns. */
#ifndef SPATIAL_PIN_FACTORS_H
#define SPATIAL_PIN_FACTORS_H

#include "kernel.h"

struct Factors {
    Int n;                        /* unknowns */
    Entries entries;              /* to be put there before it is factored */
    Real pivot;                   /* smallest over largest, 0 if there is no solution */
    Real *matrix;                 /* (n, n), of a few unknowns or many entries */
    Int *order;
    SparseLU *lu;                 /* of many */
    Real *residual, *scratch;     /* (n), (2 n) */
    Int room, full_room;
};

Factors *factors_new(Kernel *k); /* freed with the kernel; NULL if there is no memory */
void factors_free(Factors *f);
/* Factor the entries of n unknowns: DONE, also where `pivot` is 0, or NO_MEMORY. */
int factors_make(Factors *f, Int n);
/* x := K^-1 x for x (n, columns); zero where there is no solution */
void factors_solve(const Factors *f, Int columns, Real *x);
/* Smallest over largest pivot, each relative to its row's length if the unknowns are many. */
Real factors_even_ratio(Factors *f);
/* Estimate of the largest sum of sizes in a column of the inverse; 0 if the unknowns are many. */
Real factors_inverse_norm(const Factors *f);

#endif
