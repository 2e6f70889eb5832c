/* The compiled kernel: a mechanism as flat arrays, and the work on them.
 *
 * A mechanism is a tree of joints (tree.c) and closure equations on it (equations.c). Joint axes
 * are the local z axes: whoever packs the mechanism turns the joint frames once. Rotations are
 * stored by columns. Equations are numbered as in Python: the closure equations first, then the
 * idle rotations (a link's rotation about its own axis that moves nothing else).
 *
 * One Kernel belongs to one thread at a time. Nothing is shared between two of them, nothing is
 * allocated after creation but by what says so, and every function returns a code, never aborts.
 */
#ifndef SPATIAL_PIN_KERNEL_H
#define SPATIAL_PIN_KERNEL_H

#include <stddef.h>

#include "piecewise.h"
#include "sparse_lu.h"
#include "tolerances.h"
#include "vectors.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define PI 3.14159265358979323846

/* Why a function ended. */
enum Code {
    DONE = 0,
    BAD_ARRAYS = 1,   /* sizes or indices that do not fit together */
    NO_MEMORY = 2,
    SINGULAR = 3,     /* the square system has no solution: a pivot vanishes */
    NOT_CONVERGED = 4,
    UNSAFE = 5,       /* a step that could lead to another branch */
    NOT_FINITE = 6
};

enum JointKind { TURN = 1, SLIDE = 2, SCREW = 3, BALL = 4, FREE = 5 };

/* Kinds of equations. */
enum EquationKind {
    PRODUCT = 0, /* product of two vectors */
    SUM = 1,     /* of terms: numbers times quantities */
    IDLE = 2     /* angular velocity of a link about a line fixed in it */
};

/* Kinds of quantities. */
enum QuantityKind {
    OF_PRODUCT = 0, /* a product */
    COORDINATE = 1, /* a joint coordinate: its entries of q and v */
    ANGLE = 2       /* an angle that counts turns */
};

/* A component of a ball or floating joint, see pins.h. */
typedef struct Pin Pin;

/* A square matrix and its factors, see factors.h. */
typedef struct Factors Factors;

/* Several evaluations side by side, and a path of closed configurations: see lanes.h, following.h. */
struct Abreast;
struct Path;

/* Some of the equations, and what they are made of: products, and vectors that move. */
typedef struct {
    Int n_equations, n_products, n_vectors;
    Int *equation, *product, *vector;
} Parts;

/* Inertia of the bodies. */
typedef struct {
    const Real *mass, *com, *inertia; /* (n_joints) 1, 3, 9: the inertia about the centre of mass */
    const Real *gravity;              /* (3) */
} Bodies;

/* Vectors fixed in bodies: in the world R local + flag * p. */
typedef struct {
    Int n;
    const Int *body, *flag;
    const Real *local;           /* (3) */
    Real *value, *rate, *bias;   /* (3) in the world, points relative to its origin; derivatives */
} Vectors;

/* Products A . B - constant of vectors. A and B are sums of terms; derivatives follow from X and the
   sign of each freedom that moves one body relative to the other. */
typedef struct {
    Int n;
    const Int *a_term, *b_term;      /* (2) vectors, -1: none */
    const Int *x_term;               /* (1) */
    const Real *a_factor, *b_factor; /* (2) */
    const Real *x_factor;            /* (1) */
    const Real *constant, *force;    /* force: factor of B in the force of the product */
    const Int *support_start;        /* (n + 1) into the two below */
    const Int *support_v;
    const Real *support_sign;        /* times scale */
    Real *A, *B;                     /* (3) of each */
    Real *value, *rate, *bias;       /* of each; bias: second derivative */
    Real *weight;                    /* of each in the row that is added up */
    Int *weighted, n_weighted;       /* those that have one */
    char *is_weighted;
} Products;

/* Angles that count turns, between half turns by the products that are their sine and cosine. */
typedef struct {
    const Int *product;      /* (2) */
    const Int *spin_start;   /* (n_angles + 1) into the two below: what tells the turns of an angle */
    const Int *spin_q;       /* entries of q that turn it; where there are none, the reference does */
    const Real *spin_offset; /* (n_angles) angle where these are zero */
    const Real *spin_sign;
    Real *rate, *bias;       /* of each; bias: second derivative */
    Real *weight;            /* of each in the row that is added up, zero between uses */
} Angles;

/* Angles that sums define: one or two, at which as many sums vanish. They follow the equations: those
   that vanish, one that is positive at a root, and one that is least there. */
typedef struct {
    Int n, n_sums;
    const Int *at;           /* (4) first angle, how many, first sum; bits: which are periodic */
    const Real *span;        /* (4) where roots of both are looked for */
    Real *inverse;           /* (4) of the slopes of their sums */
    char *is_angle;          /* (n_angles) whether an angle is one of them */
} Implicit;

/* Products, joint coordinates and angles, or functions of them, that terms of equations have. */
typedef struct {
    Int n, n_functions;
    const Int *kind;             /* QuantityKind */
    const Int *at;               /* (2) number of product or angle; entries of q and v */
    const Int *function;         /* of it, or -1 */
    const Int *shape;            /* (n_functions, 4) see piecewise.h */
    const Real *number;
    Called *called;              /* functions of the caller, NULL of others */
    Real *last;                  /* (n_functions, 4) where each was evaluated last, and its value and
                                    derivatives there: terms share functions */
    Int *piece;                  /* (n_functions) that it was in */
    Real *value, *rate, *bias;   /* of each; bias: second derivative */
    Real *slope, *bend;          /* derivatives of the functions */
} Quantities;

/* Equations: a product each, or a sum of terms, which are numbers times quantities. */
typedef struct {
    const Int *kind, *product;   /* (n_equations) EquationKind; the product of those that are one */
    const Int *term_start;       /* (n_equations + implicit.n_sums + 1) terms of a sum */
    const Int *factor_start;     /* (n_terms + 1) quantities that a term's number is times */
    const Real *term_number;
    Parts all, system, rest;     /* of the mechanism; of the square system; and all others */
    char *is_equation, *is_product, *is_vector; /* whether the system has it */
    Real *bias;                  /* (n_equations) second derivatives at zero joint acceleration */
    Real *row;                   /* (nv) scratch, zero between uses */
} Equations;

/* The square system: rows of chosen equations, idle rotations, driven coordinates, and filled rows. */
typedef struct {
    Int n_chosen, n_driven, n_fill;
    Int *chosen, *driven; /* equations; freedoms in v, or nv + v for the component that v is of */
    Int *candidate;       /* (nv) equations that may be chosen instead */
    Pin *pin;             /* (n_pins) the components among driven coordinates, */
    Int n_pins, *pin_row, *pin_entry; /* their rows of the matrix, and first of three entries */
    Real *fill;           /* (n_fill, nv) rows with respect to v / scale */
    SparseLU *lu;
    Entries matrix;       /* its rows in this order */
    Real sign;            /* of the determinant of the last factorisation */
    Real pivot_ratio;     /* smallest over largest pivot of it */
    Real left_out;        /* largest part of an equation left out, by the longest one chosen, that
                             was independent of the chosen ones when these were chosen */
    Real mantissa;        /* size of the determinant is mantissa * 2^exponent */
    Int exponent;
    Int factorisations, orders; /* counted since creation; orders of pivots that were chosen */
} SquareSystem;

/* Memory that is freed with a kernel. */
typedef struct {
    void **blocks;
    Int n_blocks, room, was_short; /* was_short: of memory, since the last kernel_had_memory */
    Factors **factors;
    Int n_factors;
    struct Abreast *lanes; /* evaluations side by side, see lanes.h; NULL: there were none yet */
} Memory;

typedef struct Kernel {
    /* ---- the tree: joint 0 is the ground, parents come before children ---- */
    Int n_joints, nq, nv;
    const Int *kind, *parent, *iq, *iv; /* per joint; iq, iv: first entry in q and v */
    Int *plain;                         /* whether the fixed rotation is the identity */
    const Real *rotation;               /* (9) placement in the parent at q = 0 */
    const Real *translation;            /* (3) */
    const Real *pitch;                  /* travel per radian of a screw; 1 of a slide */
    const Real *scale;                  /* (nv) size of each velocity; solved-for ones are v / scale */
    Bodies bodies;

    /* ---- where it was evaluated last, and the motion of its bodies there ---- */
    Real *q;                        /* (nq) */
    Int *moves, is_placed;          /* whether each joint was placed anew, and all were ever */
    Real *R, *p;                    /* (9), (3) placement of each joint in the world */
    Real *linear, *angular;         /* (3) columns of the joint Jacobian about the world origin */
    Real *omega, *velocity;         /* (3) of each joint's body and origin, world axes */
    Real *alpha, *acceleration;     /* (3) classical accelerations */
    Real *added;                    /* (6) what joint accelerations add to these two, in turn */

    /* ---- closure equations, then idle rotations ---- */
    Int n_closure, n_idle, n_equations; /* n_equations = n_closure + n_idle */
    Int n_angles;
    const Int *entry_start;         /* (n_equations + 1) pattern of the Jacobian, rows */
    const Int *entry_v;             /* ascending within a row */
    Real *entry;                    /* Jacobian with respect to v / scale, in the pattern's order */
    Real *residual;                 /* (n_closure) */
    Real *angle, *angle_reference;  /* (n_angles) angles count turns from the reference */
    Vectors vectors;
    Products products;
    Angles angles;
    Implicit implicit;
    Quantities quantities;
    Equations equations;

    SquareSystem system;
    Real *right;                    /* (nv) right sides, then solutions */
    struct Path *path;              /* the one that is followed; NULL: none ever was */
    Memory memory;
} Kernel;

/* What formulas evaluate, and the mechanism that it is of: side by side they are two, see side_by_side.h. */
#define Evaluated Kernel
#define kernel_of(s) (s)

/* ---- model.c ---- */
/* Make a kernel of two arrays, in the order in which read_structure and read_numbers read them, and of
   the caller's functions (n_called), NULL for those that have numbers. DONE, BAD_ARRAYS, NO_MEMORY. */
EXPORT int kernel_create(const Int *ints, Int n_ints, const Real *reals, Int n_reals,
                         const Called *called, Int n_called, Kernel **out);
/* Take the numbers of other dimensions; the kernel is as if it had been made of them. */
EXPORT int kernel_set_numbers(Kernel *k, const Real *reals, Int n_reals);
/* The same numbers but for some, at places below n_reals; other places are not looked at. */
int kernel_vary_numbers(Kernel *k, const Real *base, Int n_reals, const Int *varied_index,
                        const Real *varied, Int n_varied);
/* Free a kernel, and all that was made in its memory; NULL: nothing. */
EXPORT void kernel_destroy(Kernel *k);

/* ---- tree.c ---- */
void tree_place(Kernel *k, const Real *q);   /* R, p; q is copied */
void tree_columns(Kernel *k);                /* linear, angular, after tree_place */
/* omega ... acceleration of bodies at joint rates v, without joint accelerations */
void tree_rates(Kernel *k, const Real *v);
void tree_accelerate(Kernel *k, const Real *a); /* what joint accelerations add, after tree_rates */
void tree_integrate(const Kernel *k, Real *q, const Real *step);   /* as pin.integrate */
void tree_normalize(const Kernel *k, Real *q);
/* first and second derivatives of the entries of q at joint rates v and accelerations a */
void tree_entry_rates(const Kernel *k, const Real *q, const Real *v, const Real *a, Real *first,
                      Real *second);
static inline int within(Int index, Int n) { return index >= 0 && index < n; }
static inline int joint_nv(Int kind) { return kind == FREE ? 6 : kind == BALL ? 3 : 1; }
static inline int joint_nq(Int kind) { return kind == FREE ? 7 : kind == BALL ? 4 : 1; }

/* ---- equations.c ---- */
void equations_values(Kernel *k, const Real *q); /* placements, vectors, products, residual, angle */
/* The same with angles nearest to `reference` (n_angles) from now on */
void equations_values_near(Kernel *k, const Real *q, const Real *reference);
/* The same after tree_place, of some equations: vectors, products, residual, angle; of the system
   before its rest */
void equations_residuals(Kernel *k, const Parts *of);
/* entry, after equations_values; bias, after that: of all equations, or of some */
void equations_jacobian(Kernel *k, const Parts *of);
void equations_bias(Kernel *k, const Parts *of, const Real *v);
/* Find the parts of the square system: chosen equations, idle rotations, and all angles, which
   count turns whether their equations are chosen or not; and the rest. */
void equations_of_system(Kernel *k);
void equations_make_room(Kernel *k); /* for parts */
void equations_begin(Kernel *k);     /* the parts of all, and the ground */
/* Derivatives (nv) of an angle by v / scale, after equations_jacobian; `row` is zero before. */
void equations_angle_row(Kernel *k, Int angle, Real *row);
/* Evaluate at q, every angle in the turn that closes its equation best; the reference follows. */
void equations_close_turns(Kernel *k, const Real *q);
void equations_place_ground(Kernel *k); /* vectors that do not move, once for all */
Real equations_error(const Kernel *k);           /* largest absolute residual; NaN if one is */
int equations_are_sound(const Kernel *k);        /* whether their indices fit */

/* ---- sums.c ---- */
/* Force and moment about the world origin that a product exerts on its second body. */
void product_wrench(const Kernel *k, Int product, Real *force, Real *moment);
/* All angles, near the reference; those that sums define at their best root where that is 0. */
void angles_place(Kernel *k);
void angles_rates(Kernel *k, const Real *v);
/* Add the derivatives of an angle to the scratch row over all freedoms. */
void angle_add_row(Kernel *k, Int angle);
/* Of a sum: its value, first two derivatives in time, and its derivatives, added to the scratch row. */
Real sum_value(Kernel *k, Int sum);
void sum_rates(Kernel *k, Int sum, const Real *v, Real *rate, Real *bias);
void sum_add_row(Kernel *k, Int sum);
/* a term's number times its quantities but two of them (-1: none), after the sum's value */
Real product_without(const Kernel *k, Int term, Int one, Int other);
int is_one_of(const Kernel *k, Int quantity, Int first, Int n); /* whether it is one of n angles */

/* ---- evaluating.c ---- */
/* Configurations, and where goes what they give: as `EvaluationStruct` in kernel.py. Of the outputs
   those that are NULL are not wanted. */
typedef struct {
    Int m;
    const Real *q, *v;       /* (m, nq), (m, nv); v for the bias alone */
    const Real *reference;   /* (m, n_angles) that angles are nearest to */
    const Real *base;        /* (n_reals) numbers of other dimensions; NULL: the kernel's own */
    Int n_reals, n_varied;
    const Int *varied_index; /* (n_varied) those that differ from one configuration to the next */
    const Real *varied;      /* (m, n_varied) */
    Real *R, *p;             /* (m, n_joints, 9) by columns, (m, n_joints, 3) */
    Real *residual, *angle;  /* (m, n_closure), (m, n_angles) */
    Real *jacobian;          /* (m, n_equations + n_angles, nv) with respect to v / scale */
    Real *linear, *angular;  /* (m, nv, 3) columns of the joint Jacobian about the world origin,
                                where `jacobian` is wanted too */
    Real *bias;              /* (m, n_equations) second derivatives at zero joint acceleration */
} Evaluation;

/* Evaluate configurations. NOT_FINITE where an equation is no number, after all are evaluated. The
   numbers of the last configuration stay the kernel's. */
EXPORT int kernel_evaluate(Kernel *k, const Evaluation *e);

/* ---- system.c ---- */
/* Equations to be solved (NULL: the first ones), driven freedoms, and rows that fill the system up;
   n_chosen + n_idle + n_driven + n_fill must be nv. Driven is a freedom v, or, as nv + v, the
   component of a ball or floating joint (pins.h) whose velocity entry is v. */
int system_set(Kernel *k, const Int *chosen, Int n_chosen, const Int *driven, Int n_driven,
               const Real *fill, Int n_fill);
/* Rows of a square matrix: of equations and of all idle rotations, at the evaluated point, with room
   for `more` entries; 0 if there is no memory. Then those of driven coordinates, at that point,
   `pin` being its component if it is one; and rows (n, nv) that fill it up. */
int system_put_equations(const Kernel *k, const Int *equations, Int n, Int more, Entries *to);
void system_put_driven(const Kernel *k, Int row, Int driven, const Pin *pin, Entries *to);
void system_put_fill(const Kernel *k, Int row, const Real *fill, Int n, Entries *to);
int system_factor(Kernel *k);            /* DONE or SINGULAR or NO_MEMORY, after equations_jacobian */
/* Size of the determinant of the last factorisation: its binary logarithm. */
static inline Real determinant_size(const Kernel *k)
{
    return log2(k->system.mantissa) + (Real)k->system.exponent;
}
/* right sides of chosen, idle, driven, fill -> v / scale; those of driven coordinates by their scale */
void system_solve(const Kernel *k, Real *x);
/* Other independent equations at the point that was evaluated, as many; SINGULAR, and those there
   were, if there are none.
   `left_out` tells how independent the others are. */
int system_reselect(Kernel *k);
int system_choose(Kernel *k, const Int *chosen); /* these (n_chosen) instead */
/* Add a factor times second derivatives of the chosen equations and of idle rotations, at joint rates v, to
   right sides. */
void system_add_bias(Kernel *k, const Real *v, Real factor, Real *right);
/* Right sides, in k->right, of rates where driven coordinates have these (n_driven); and of accelerations
   where joints have velocities v (nv). The others are zero. */
void system_put_rates(Kernel *k, const Real *rate);
void system_put_accelerations(Kernel *k, const Real *v, const Real *acceleration);
/* dq/ds and d2q/ds2 (joint rates), at a factored point, where driven coordinates have derivatives
   `rate` and `bend` (n_driven) by s; and the squares (2) of their scaled sizes */
void system_path_rates(Kernel *k, const Real *rate, const Real *bend, Real *first, Real *second,
                       Real *squares);
Int driven_at(const Kernel *k, Int i); /* the velocity entry of a driven coordinate */

#endif
