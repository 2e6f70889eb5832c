/* Configurations side by side: the arithmetic of a few at once, in lanes of vectors that a processor
 * works on together. For samples that are known to lie near each other: what one of them needs, all do. */
#ifndef SPATIAL_PIN_LANES_H
#define SPATIAL_PIN_LANES_H

#include "kernel.h"

/* A mechanism's evaluation at several configurations: as the arrays of Kernel, which see. */
typedef struct Abreast {
    Lane *q, *R, *p, *linear, *angular, *omega, *velocity, *alpha, *acceleration;
    Lane *vector, *rate, *bias;      /* of vectors */
    Lane *A, *B;                     /* of products */
    Lane *residual, *equation_bias;
    Lane *entry;                     /* of the matrix of the square system, in its order */
    Lane *right;                     /* (nv) right sides, then solutions */
    LaneFactors factors;
    Lane *t, *c, *prescribed;        /* (nv) of a path; (3 nv) values and derivatives of what is driven */
    Int *stands;                     /* (n_joints) whether corrections leave a joint where it is */
} Abreast;

/* The lanes of a kernel, made once; NULL if there is no memory. */
Abreast *lanes_of(Kernel *k);
/* Whether a system's equations are all products, which lanes know. */
int lanes_know(const Kernel *k);
/* What follows from the system that is set, and from the ground. */
void lanes_begin(const Kernel *k, Abreast *s);
/* Placements, and the vectors, products and residuals of equations, at q; with `all` of the joints, else of
   those that corrections move. */
void lanes_residuals(const Kernel *k, Abreast *s, const Parts *of, int all);
/* The matrix of the system, factored in the order that the kernel's has: 0 where that is no good one for a
   lane, or where a determinant has another sign. */
int lanes_factor(const Kernel *k, Abreast *s);
void lanes_solve(const Kernel *k, Abreast *s);
/* Second derivatives of the system's equations at joint rates t, at zero joint acceleration. */
void lanes_bias(const Kernel *k, Abreast *s);
/* q moved by joint displacements s->right, so small that their squares matter little. */
void lanes_move(const Kernel *k, Abreast *s);
void lanes_normalize(const Kernel *k, Abreast *s);

#endif
