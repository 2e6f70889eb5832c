/* The bodies of a tree as the algorithms in articulated.c and tree_evaluation.c have them. */
#ifndef SPATIAL_PIN_TREE_BODIES_H
#define SPATIAL_PIN_TREE_BODIES_H

#include "articulated.h"


/* Wrenches or motions of a body, one of each right side. */
typedef struct {
    Real x[6][LANES];
} Lanes;

/* Of a freedom, about the origin of its joint. */
typedef struct {
    Real turned[6], twice[6], paced[6]; /* dS, ddS, dS + v x S */
    Real by_spin[3];                    /* S . 2 B on rotations */
    Real force[6], bent[6], damped[6];  /* I S, and the wrenches that all joints before it bear */
} Freedom;

/* What a freedom does to the vectors of a product on its side of it. */
typedef struct {
    Int v, joint, side;
    Real moved[2][3], turn[3]; /* S A and S B; w . turn is S_w S y . z, summed over A and B */
} Bend;

/* What 2 B of a body is made of, with all that it carries. */
typedef struct {
    Real momentum[3], D[9];
} Speed;

struct Tree {
    Kernel *k;
    Int *is_core;     /* (n_joints) whether loops are built on it */
    Real *armature;   /* (nv) */
    Real *column;     /* (6 nv) motion of the body per unit of each freedom */
    Real *arm;        /* (3) from the parent's origin to the joint's */
    Real *bias;       /* (6) acceleration of the body relative to that of its parent, at no joint's */
    Real *wrench;     /* (6) that the body needs without acceleration; with all beyond it */
    Real *inertia;    /* (27) lin-lin, lin-ang, ang-ang by rows; with all beyond it */
    Real *needed;     /* (6) of the core's bodies */
    Real *motion;     /* (6) accelerations of the bodies */
    Real *pull;       /* (6 nv) wrench per unit acceleration of each eliminated freedom */
    Real *own;        /* (nv) its inertia, */
    Real *missing;    /* (nv) and its force that is not borne */
    Real *velocity;   /* (6) of the bodies */
    Lanes *loads;     /* of the bodies, of each right side */
    Speed *speeds;    /* of the bodies */
    Freedom *freedoms; /* (nv) */
    Bend *bends;      /* (2 nv) */
    Real *lacking;    /* (nv, LANES) `missing` of each right side */
};

/* What a body's motion gives the next one, whose origin is an arm away. */
static inline void carry_motion(const Real *from, const Real *arm, Real *motion)
{
    Real swing[3];
    cross3(from + 3, arm, swing);
    for (int i = 0; i < 3; i++) {
        motion[i] = from[i] + swing[i];
        motion[3 + i] = from[3 + i];
    }
}

/* out += the wrench that accelerations need of an inertia. */
static inline void add_inertia_times(const Real *inertia, const Real *motion, Real *out)
{
    const Real *A = inertia, *B = A + 9, *C = A + 18, *a = motion, *alpha = motion + 3;
    for (int i = 0; i < 3; i++) {
        out[i] += dot3(A + 3 * i, a) + dot3(B + 3 * i, alpha);
        out[3 + i] += B[i] * a[0] + B[3 + i] * a[1] + B[6 + i] * a[2] + dot3(C + 3 * i, alpha);
    }
}

/* A wrench about a joint's origin, added to one about its parent's. */
static inline void add_wrench(const Real *wrench, const Real *arm, Real *out)
{
    Real moment[3];
    cross3(arm, wrench, moment);
    add3(1.0, wrench, out);
    add3(1.0, wrench + 3, out + 3);
    add3(1.0, moment, out + 3);
}

/* Places, velocities, and accelerations relative to the parents', with no joint's own. */
void move_bodies(Tree *s, const Real *q, const Real *v);
/* Accelerations of all bodies at those of the joints; of no joint's own where a is NULL. */
void accelerate_bodies(Tree *s, const Real *a);
/* Wrenches that the bodies need at their accelerations, each without what it carries. */
void put_needed(Tree *s);
/* Wrenches that all bodies need with all that they carry, about their origins. */
void gather_wrenches(Tree *s, Real *tau, const Real *a);
/* Inertias of bodies with all that they carry: of all joints, or of the core's. */
void gather_inertias(Tree *s, int all);

/* ---- tree_products.c ---- */
/* Products of vectors, where the bodies have their motions and the freedoms theirs. */
void put_products(Tree *s, const TreeTask *task);

#endif
