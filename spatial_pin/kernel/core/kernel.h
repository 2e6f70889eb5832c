/* The compiled kernel: a mechanism as flat arrays, and what is worked out on them.
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

#include "entries.h"
#include "piecewise.h"
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

/* A square matrix with a fixed pattern, factored as L U with an order of pivots chosen once. */
typedef struct SparseLU SparseLU;

/* A component of a ball or floating joint, see pins.h. */
typedef struct Pin Pin;

/* A square matrix and its factors, see factors.h. */
typedef struct Factors Factors;

/* Some of the equations, and what they are made of: products, and vectors that move. */
typedef struct {
    Int n_equations, n_products, n_vectors;
    Int *equation, *product, *vector;
} Parts;

typedef struct Kernel {
    /* ---- the tree: joint 0 is the ground, parents come before children ---- */
    Int n_joints, nq, nv;
    const Int *kind, *parent, *iq, *iv; /* per joint; iq, iv: first entry in q and v */
    Int *plain;                         /* whether the fixed rotation is the identity */
    const Real *rotation;               /* (9) placement in the parent at q = 0 */
    const Real *translation;            /* (3) */
    const Real *pitch;                  /* travel per radian of a screw; 1 of a slide */
    const Real *mass, *com, *inertia;   /* inertia (9) about the centre of mass */
    const Real *gravity;                /* (3) */
    const Real *scale;                  /* (nv) size of each velocity; solved-for ones are v / scale */

    /* ---- vectors fixed in bodies: world value R local + flag * p ---- */
    Int n_vectors;
    const Int *vector_body, *vector_flag;
    const Real *vector_local;

    /* ---- products A . B - constant, A = sum of terms; derivative from X and the sign of
       each freedom that moves one body relative to the other ---- */
    Int n_products;
    const Int *a_term, *b_term;      /* (2) vectors, -1: none */
    const Int *x_term;               /* (1) */
    const Real *a_factor, *b_factor; /* (2) */
    const Real *x_factor;            /* (1) */
    const Real *constant, *force;    /* force: factor of B in the force of the product */
    const Int *support_start;        /* (n_products + 1) into the two below */
    const Int *support_v;
    const Real *support_sign;        /* times scale */

    /* ---- equations: kind and what it is made of ---- */
    Int n_closure, n_idle, n_equations; /* n_equations = n_closure + n_idle */
    Int n_angles;
    const Int *spin_start;   /* (n_angles + 1) into the two below: what tells the turns of an angle */
    const Int *spin_q;       /* entries of q that turn it; where there are none, the reference tells */
    const Real *spin_offset; /* (n_angles) angle where these are zero */
    const Real *spin_sign;
    Parts all, system, rest; /* of the mechanism; of the square system; and what that is without */
    char *is_equation, *is_product, *is_vector; /* whether the system has it */
    const Int *angle_product; /* (2) products of sine and cosine of an angle */
    const Int *equation_kind;
    const Int *equation_product; /* of those that are one */
    const Int *term_start;       /* (n_equations + 1) terms of a sum */
    const Int *factor_start;     /* (n_terms + 1) quantities that a term's number is multiplied by */
    const Real *term_number;
    Int n_quantities;
    const Int *quantity_kind;
    const Int *quantity_at;   /* (2) number of product or angle; entries of q and v */
    const Int *quantity_function; /* of it, or -1 */
    Int n_functions;
    const Int *function_shape; /* (4) see piecewise.h */
    const Real *function_number;
    Called *called; /* functions of the caller, NULL of others */
    const Int *entry_start;    /* (n_equations + 1) pattern of the Jacobian, rows */
    const Int *entry_v;        /* ascending within a row */

    /* ---- the last evaluation ---- */
    Real *q;                        /* (nq) where it was */
    Int *moves, is_placed;          /* whether each joint was placed anew, and all were ever */
    Real *R, *p;                    /* (9), (3) placement of each joint in the world */
    Real *linear, *angular;         /* (3) columns of the joint Jacobian about the world origin */
    Real *vector;                   /* (3) of each vector; points relative to the world origin */
    Real *A, *B;                    /* (3) of each product */
    Real *value;                    /* of each product */
    Real *residual;                 /* (n_closure) */
    Real *angle, *angle_reference;  /* (n_angles) angles count turns from the reference */
    Real *entry;                    /* Jacobian with respect to v / scale, in the pattern's order */
    Real *omega, *velocity;         /* (3) of each joint's body and origin, world axes */
    Real *alpha, *acceleration;     /* (3) classical accelerations */
    Real *added;                    /* (6) what joint accelerations add to these two, in turn */
    Real *bias;                     /* (n_equations) second derivatives at zero joint acceleration */
    Real *product_rate, *product_bias, *angle_rate; /* angle_rate: (n_angles) */
    Real *angle_bias;
    Real *quantity, *quantity_slope, *quantity_bend; /* values; of functions, derivatives by what
                                                        they are of */
    Real *quantity_rate, *quantity_bias;
    Real *vector_rate, *vector_bias;
    Real *row;                      /* (nv) scratch, zero between uses */

    /* ---- the square system: chosen equations, idle rotations, what is driven, filled rows ---- */
    Int n_chosen, n_driven, n_fill;
    Int *chosen, *driven; /* equations; freedoms in v, or nv + v for the component that v is of */
    Int *candidate;       /* (nv) equations that may be chosen instead */
    Pin *pin;             /* (n_pins) the components among what is driven, */
    Int n_pins, *pin_row, *pin_entry; /* their rows of the matrix, and first of three entries */
    Real *fill;           /* (n_fill, nv) rows with respect to v / scale */
    SparseLU *lu;
    Entries matrix;       /* of chosen equations, idle rotations, what is driven, filled rows, in
                             this order */
    Real sign;            /* of the determinant of the last factorisation */
    Real pivot_ratio;     /* smallest over largest pivot of it */
    Real left_out;        /* largest part of an equation left out, by the longest one chosen, that
                             was independent of the chosen ones when these were chosen */
    Real mantissa;        /* size of the determinant is mantissa * 2^exponent */
    Int exponent;
    Real *right;

    Int factorisations; /* counted since creation */
    void **owned; /* memory to be freed */
    Int n_owned, owned_room, lacked_memory; /* lacked: since that was asked last */
    Factors **factors; /* (n_factors) to be freed too */
    Int n_factors;
} Kernel;

/* ---- model.c ---- */
EXPORT int kernel_create(const Int *ints, Int n_ints, const Real *reals, Int n_reals, Kernel **out);
EXPORT int kernel_set_numbers(Kernel *k, const Real *reals, Int n_reals);
/* Give one of its functions, which is one of the caller. */
EXPORT void kernel_set_function(Kernel *k, Int i, Called function);
EXPORT void kernel_destroy(Kernel *k);
/* Memory that is freed with k, zeroed; NULL if there is none left. */
void *kernel_memory(Kernel *k, Int count, size_t size);
Real *kernel_reals(Kernel *k, Int count);
Int *kernel_ints(Kernel *k, Int count);
/* Whether there was all the memory that was asked for since this was asked last. */
int kernel_had_memory(Kernel *k);
/* Give an array room for n things, to be freed by its owner; 0 if there is no memory. */
int widen(void **array, Int n, size_t size);

/* ---- tree.c ---- */
void tree_place(Kernel *k, const Real *q);   /* R, p; q is kept */
void tree_columns(Kernel *k);                /* linear, angular, after tree_place */
/* omega ... acceleration of bodies at joint rates v, without joint accelerations */
void tree_rates(Kernel *k, const Real *v);
void tree_accelerate(Kernel *k, const Real *a); /* what joint accelerations add, after tree_rates */
void tree_integrate(const Kernel *k, Real *q, const Real *step);   /* as pin.integrate */
void tree_normalize(const Kernel *k, Real *q);
void quaternion_rotation(const Real *quaternion, Real *R); /* of length one; by columns */
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

/* ---- evaluating.c ---- */
EXPORT int kernel_evaluate(Kernel *k, const Real *q, const Real *v, const Real *reference, Real *R,
                           Real *p, Real *residual, Real *angle, Real *jacobian, Real *bias);

/* ---- system.c ---- */
/* Equations to be solved (NULL: the first ones), what is driven, and rows that fill the system up;
   n_chosen + n_idle + n_driven + n_fill must be nv. Driven is a freedom v, or, as nv + v, the
   component of a ball or floating joint (pins.h) that stands at v. */
EXPORT int system_set(Kernel *k, const Int *chosen, Int n_chosen, const Int *driven, Int n_driven,
                      const Real *fill, Int n_fill);
/* Rows of a square matrix: of equations and of all idle rotations, at the evaluated point, with room
   for so many entries more; 0 if there is no memory. Then those of what is driven, at that point,
   `pin` being its component if it is one; and rows (n, nv) that fill it up. */
int system_put_equations(const Kernel *k, const Int *equations, Int n, Int more, Entries *to);
void system_put_driven(const Kernel *k, Int row, Int driven, const Pin *pin, Entries *to);
void system_put_fill(const Kernel *k, Int row, const Real *fill, Int n, Entries *to);
int system_factor(Kernel *k);            /* DONE or SINGULAR or NO_MEMORY, after equations_jacobian */
/* Size of the determinant of the last factorisation: its binary logarithm. */
static inline Real determinant_size(const Kernel *k) { return log2(k->mantissa) + (Real)k->exponent; }
/* right sides of chosen, idle, driven, fill -> v / scale; those of what is driven by its scale */
void system_solve(const Kernel *k, Real *x);
/* Other independent equations at the point that was evaluated, as many; SINGULAR, and those there
   were, if there are none.
   `left_out` tells how independent the others are. */
int system_reselect(Kernel *k);
int system_choose(Kernel *k, const Int *chosen); /* these (n_chosen) instead */
/* Right sides, in k->right, of rates where what is driven has these (n_driven); and of accelerations
   where joints have velocities v (nv). The others are zero. */
void system_put_rates(Kernel *k, const Real *rate);
void system_put_accelerations(Kernel *k, const Real *v, const Real *acceleration);
/* dq/ds and d2q/ds2 (joint rates), at a factored point, where what is driven has derivatives
   `rate` and `bend` (n_driven) by s */
void system_path_rates(Kernel *k, const Real *rate, const Real *bend, Real *first, Real *second);
Int driven_at(const Kernel *k, Int i); /* the velocity entry at which what is driven stands */

/* ---- sparse_lu.c ---- */
SparseLU *lu_new(void);
void lu_free(SparseLU *lu);
void lu_forget(SparseLU *lu);    /* the order is chosen anew at the next factorisation */
int lu_has_order(const SparseLU *lu);
void lu_determinant(const SparseLU *lu, Real *sign, Real *mantissa, Int *exponent);
Real lu_pivot_ratio(const SparseLU *lu); /* smallest over largest */
void lu_mark(SparseLU *lu); /* changes of the pivots are told from those of now on */
/* Bounds of their changes, relative to what they are now; infinite where they are not known. Where
   another order was chosen since, they are those by the former one. */
void lu_changes(const SparseLU *lu, Real *least, Real *most);
/* Smallest over largest pivot, each relative to the length (n) of its row. */
Real lu_even_ratio(const SparseLU *lu, const Real *length);
/* Choose the order for the entries of an n x n matrix, by their values. */
int lu_analyse(SparseLU *lu, Int n, const Entries *of);
int lu_factor(SparseLU *lu, const Real *value);  /* 1 good, 0 singular, -1 wants another order */
void lu_solve(const SparseLU *lu, Real *x); /* x: right sides, then the solution */

#endif
