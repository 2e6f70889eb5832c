/* A square matrix given by its entries, and its L U factors: see sparse_lu.c. */
#ifndef SPATIAL_PIN_SPARSE_LU_H
#define SPATIAL_PIN_SPARSE_LU_H

#include "lane.h"

/* Entries in any order, each place at most once. */
typedef struct {
    Int n, room;       /* how many there are, and how many there may be */
    Int *row, *column;
    Real *value;
} Entries;

int entries_begin(Entries *e, Int room); /* none, and room; 0 if there is no memory */
void entries_put(Entries *e, Int row, Int column, Real value);
void entries_free(Entries *e);

/* A matrix with a fixed pattern, factored as L U with an order of pivots chosen once. */
typedef struct SparseLU SparseLU;

SparseLU *lu_new(void);
void lu_free(SparseLU *lu);
void lu_forget(SparseLU *lu);    /* the order is chosen anew at the next factorisation */
int lu_has_order(const SparseLU *lu);
void lu_determinant(const SparseLU *lu, Real *sign, Real *mantissa, Int *exponent);
Real lu_pivot_ratio(const SparseLU *lu); /* smallest over largest */
void lu_mark(SparseLU *lu); /* changes of the pivots count from here */
/* Bounds of their changes, relative to what they are now; infinite where they are not known. Where
   another order was chosen since, they are those by the former one. */
void lu_changes(const SparseLU *lu, Real *least, Real *most);
/* Smallest over largest pivot, each relative to the length (n) of its row. */
Real lu_even_ratio(const SparseLU *lu, const Real *length);
/* Choose the order for the entries of an n x n matrix, by their values. */
int lu_analyse(SparseLU *lu, Int n, const Entries *of);
int lu_factor(SparseLU *lu, const Real *value);  /* 1 good, 0 singular, -1 wants another order */
void lu_solve(const SparseLU *lu, Real *x); /* x: right sides, then the solution */

/* Factors of several matrices of the pattern side by side, in the order that was chosen. */
typedef struct {
    Lane *value, *inverse, *work;
    Int room; /* of each */
} LaneFactors;

void lane_factors_free(LaneFactors *f);
/* 1, or 0 where the order is no good one for one of them, where a determinant's sign is not that of the last
   factorisation, or without memory */
int lu_factor_lanes(const SparseLU *lu, const Lane *entry, LaneFactors *f);
void lu_solve_lanes(const SparseLU *lu, const LaneFactors *f, Lane *x);

#endif
