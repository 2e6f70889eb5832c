/* Motion, forces and accelerations of a tree, body by body. */
#ifndef SPATIAL_PIN_ARTICULATED_H
#define SPATIAL_PIN_ARTICULATED_H

#include "kernel.h"
#include "springs.h"

typedef struct Tree Tree;

/* n motions of a tree, and what each gives: as `TreeTask` in kernel_tree.py. Outputs that are NULL are
   not wanted; from `outside` on they are those of one motion. */
typedef struct {
    Int n;
    const Real *q, *v, *a;   /* (nq), (nv), (nv); v NULL: placements and Jacobian alone; a NULL: none */
    const Real *armature;    /* (nv) */
    Real *R, *p, *jacobian;  /* (n_joints, 9) by columns, (n_joints, 3); (6, nv) of the world */
    Real *velocity, *acceleration; /* (n_joints, 6) of the bodies at their origins, world axes */
    Real *tau;               /* (nv) joint forces that the motion needs, as `pin.rnea` */
    Real *wrench;            /* (n_joints, 6) that joints hand on, world axes, about their origins;
                                where `tau` is wanted too */
    Springs *springs;        /* whose forces lessen `tau`, where it is wanted and v is given; or NULL */
    Real *of_springs;        /* (n_joints, 6) wrenches of springs on bodies, about the world origin */
    const Real *outside;     /* (n_joints, 6) wrenches on bodies, world axes, about the joints' origins,
                                that turn with the bodies: for by_q and by_v, where v and a are given */
    Real *by_q, *by_v;       /* (nv, nv) zeros before; a row for each entry of q and v: how `tau`,
                                less external forces, changes, as `pin.computeRNEADerivatives` */
    /* Products of two vectors A and B, where v and a are given */
    Int n_products;
    const Int *bodies;       /* (n_products, 2) the joints whose bodies carry them; 0: the ground */
    const Real *a_parts, *b_parts; /* (n_products, 2, 4) what each of these carries of A and of B, in
                                the joint's axes, and 1 for a point */
    Real *values;            /* (3, n_products) of the products and their first and second rates; NULL:
                                not wanted */
    Real *product_by_q, *product_by_v; /* (3, n_products, nv) zeros before: how these change */
    const Real *weights;     /* (n_products) */
    Real *bent;              /* (nv, nv) zeros before; second derivatives by q of their weighted sum: how
                                a row's derivative changes with a column's entry of q */
} TreeTask;

/* Memory for the motions and forces of a kernel's tree, freed with the kernel. is_core: (n_joints)
   whether loops are built on each joint. */
EXPORT int tree_create(Kernel *k, const Int *is_core, Tree **out);
/* Evaluate motions. */
EXPORT void tree_evaluate(Tree *s, const TreeTask *task);

/* Masses of all joints at q, in the order of put_masses. Where joint forces `force` (nv) are given,
   those of the core, the rest being eliminated as it moves under them; and the joint forces `needed`
   (nv) of the core. SINGULAR where a freedom of the rest has no inertia. */
EXPORT int tree_masses(Tree *s, const Real *q, const Real *v, const Real *force,
                       const Real *armature, Real *masses, Real *needed);

/* Accelerations (nv) of the eliminated freedoms, those of the core given, after `tree_masses` with
   these forces; corrected once by the residual of the forces. facts (4), by scale: the largest,
   the largest correction, and the largest that round-off of wrenches, and joint forces `off` (nv; may
   be NULL), make by themselves. `scratch` (4 nv). If n is not 0, those (n, nv) under joint
   forces (n, nv) alone, the core at rest, after `tree_masses` with any; `a` may be `force`. */
EXPORT void tree_accelerations(Tree *s, Int n, const Real *force, const Real *off, Real *a,
                               Real *scratch, Real *facts);
#endif
