/* A square matrix given by its entries, and its factors. */
#ifndef SPATIAL_PIN_FACTORS_H
#define SPATIAL_PIN_FACTORS_H

#include "kernel.h"

struct Factors {
    Int n;                        /* unknowns */
    Int n_entries, *row, *column; /* each place at most once */
    Real *value;
    Real pivot;                   /* smallest over largest, 0 if there is no solution */
    Real *matrix;                 /* (n, n) of a few unknowns */
    Int *order;
    SparseLU *lu;                 /* of many */
    Real *left, *scratch;         /* (n), (2 n) */
    Int room, entry_room;
};

Factors *factors_new(Kernel *k); /* freed with the kernel; NULL if there is no memory */
void factors_free(Factors *f);
int factors_begin(Factors *f, Int n, Int n_entries); /* no entries, and room; DONE or NO_MEMORY */
void factors_put(Factors *f, Int row, Int column, Real value);
int factors_make(Factors *f);                 /* DONE, also where `pivot` is 0, or NO_MEMORY */
void factors_solve(const Factors *f, Real *x); /* x := K^-1 x; zero where there is no solution */
/* Smallest over largest pivot, each relative to its row's length if the unknowns are many. */
Real factors_even_ratio(Factors *f);
/* Estimate of the largest sum of sizes in a column of the inverse; 0 if the unknowns are many. */
Real factors_inverse_norm(const Factors *f);

#endif
