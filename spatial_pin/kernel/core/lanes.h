/* Configurations side by side: the arithmetic of a few at once, in lanes of vectors that a processor
 * works on together. For samples that are known to lie near each other: what one of them needs, all do. */
#ifndef SPATIAL_PIN_LANES_H
#define SPATIAL_PIN_LANES_H

#include "kernel.h"

/* A mechanism's evaluation at several configurations: what a Kernel has of one, by the same names. */
typedef struct {
    Lane *local; /* those of the kernel, in all lanes */
    Lane *value, *rate, *bias;
} LaneVectors;

typedef struct {
    Lane *A, *B, *value, *rate, *bias, *weight;
    Int *weighted, n_weighted;
    char *is_weighted;
} LaneProducts;

typedef struct {
    Lane *rate, *bias, *weight;
} LaneAngles;

typedef struct {
    Lane *last, *value, *rate, *bias, *slope, *bend;
} LaneQuantities;

typedef struct {
    Lane *bias, *row;
} LaneEquations;

typedef struct Abreast {
    const Kernel *k;
    Lane *rotation, *translation;    /* likewise */
    Int *moves, is_placed;
    Lane *q, *R, *p, *linear, *angular, *omega, *velocity, *alpha, *acceleration;
    Lane *entry, *residual, *angle, *angle_reference, *right;
    LaneVectors vectors;
    LaneProducts products;
    LaneAngles angles;
    LaneQuantities quantities;
    LaneEquations equations;
    Lane *matrix;                    /* of the square system, in the order of its entries */
    LaneFactors factors;
    Lane *next;                      /* (nq) a configuration to be evaluated */
    Lane *t, *c;                     /* (nv) of a path */
    Lane *prescribed;                /* (3 n_driven) values, rates and bends of what is driven */
} Abreast;

/* The lanes of a kernel, made once; NULL if there is no memory. */
Abreast *lanes_of(Kernel *k);
/* What follows from the numbers of the kernel. */
void lanes_begin(Abreast *s);
/* Residuals of equations, of the system at s->next, or of its rest where the system was evaluated last. */
void lanes_residuals(Abreast *s, const Parts *of);
/* The matrix of the system, factored in the order that the kernel's has: 0 where that is no good one for a
   lane, or where a determinant has another sign. */
int lanes_factor(Abreast *s);
void lanes_solve(const Abreast *s, Lane *x);
/* s->t and s->c by `system_path_rates`, at a factored point. */
void lanes_path_rates(Abreast *s, Lane *squares);
/* s->next moved by joint displacements s->right, so small that their squares matter little. */
void lanes_move(Abreast *s);
void lanes_normalize(Abreast *s);

#endif
