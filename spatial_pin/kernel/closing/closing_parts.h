/* What closing is made of. */
#ifndef SPATIAL_PIN_CLOSING_PARTS_H
#define SPATIAL_PIN_CLOSING_PARTS_H

#include "kernel.h"

/* ---- far_rotations.c ---- */
/* Rotations that closures ask for, where their frames are turned far against each other. */
typedef struct {
    Int n;                  /* closures */
    const Int *first, *axes; /* their first equation of directions, and whether 1 or 3 axes agree */
    Int n_pairs;            /* of axes that other closures make parallel */
    const Int *body;        /* (n_pairs, 2) joints that carry them */
    const Real *axis;       /* (n_pairs, 2, 3) in these joints' axes */
} Rotations;

int rotations_are_sound(const Kernel *k, const Rotations *rotations);
int rotations_are_far(const Kernel *k, const Rotations *rotations); /* after equations_values */
int rotations_are_mirrored(const Kernel *k, const Rotations *rotations);         /* likewise */
void rotations_put_values(Kernel *k, const Rotations *rotations);   /* likewise */
void rotations_put_entries(Kernel *k, const Rotations *rotations);  /* after equations_jacobian */
/* The rotation vector of a rotation by rows, as Pinocchio's log3 */
void rotation_logarithm(const Real *rows, Real *phi);

/* ---- targets.c ---- */
/* Kinds of targets: joint, and for a point its axes in bits; two joints; entries of q and v. */
enum TargetKind {
    POINT_TARGET = 0,     /* point in the body, wanted in the world (3 each) */
    TURN_TARGET = 1,      /* frame in the body, wanted axes in the world (9 each, by columns) */
    DIRECTION_TARGET = 2, /* axis in the body, direction, two directions normal to it (3 each) */
    DISTANCE_TARGET = 3,  /* point in either body (3 each), length */
    ANGLE_TARGET = 4,     /* direction in the body, where it points at zero and a quarter of a turn,
                             angle: a number within half a turn */
    VALUE_TARGET = 5      /* value of a coordinate */
};
enum { TARGET_INTS = 4, TARGET_REALS = 18 };

/* Where frames and coordinates are wanted. */
typedef struct {
    Int n;
    const Int *of;      /* (n, TARGET_INTS) TargetKind, then what it is of */
    const Real *number; /* (n, TARGET_REALS) */
    Real size;          /* that lengths are divided by */
} Targets;

Int targets_count(const Kernel *k, const Targets *targets); /* rows; -1 where indices do not fit */
void targets_values(const Kernel *k, const Targets *targets, Real *off); /* after equations_values */
/* Derivatives by free velocities / scale into zero rows (n_free) each, after equations_jacobian */
void targets_put_rows(const Kernel *k, const Targets *targets, const Int *free_index, Int n_free,
                      Real *to);
void targets_mark(const Kernel *k, const Targets *targets, Int *moves); /* velocities they depend on */
/* Derivative (nv), by velocities / scale, of half the square of the displacement from a start, as
   Pinocchio's `difference`, in units of the scale */
void displacement_gradient(const Kernel *k, const Real *start, const Real *q, Real *out);

/* ---- envelope.c ---- */
/* J Jᵀ of a sparse J (n rows), and Cholesky factors of J Jᵀ + damping over its envelope. */
typedef struct {
    Int n, nv;
    const Int *start, *column; /* pattern of J, by rows */
    Int *order;                /* the row of J at each place */
    Int *first;                /* first place that a place shares a column with */
    Int *at;                   /* where the entries of each place begin, from `first` on */
    Real *square;              /* J Jᵀ, lower half, by rows */
    Real *factor;              /* L, its diagonal inverted */
    Real *wide;                /* (nv) zero between uses */
    Real *answer;              /* (n) in the order of places */
    Real largest;              /* of the diagonal of J Jᵀ */
} Envelope;

/* The order of rows is chosen from the pattern alone. DONE or NO_MEMORY. */
int envelope_create(Kernel *k, Int n, const Int *start, const Int *column, Envelope *out);
void envelope_square(Envelope *e, const Real *value);
int envelope_factor(Envelope *e, Real damping); /* 0 where J Jᵀ + damping is not positive */
/* multipliers y of J Jᵀ y = right, both in the order of the rows of J */
void envelope_solve(const Envelope *e, const Real *right, Real *y);

/* ---- least_motion.c ---- */
/* The shortest step that makes linear equations hold as well as they can, damped or not. */
typedef struct {
    Int n, m;       /* equations, unknowns of the last factorisation */
    Int most;       /* equations at most */
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
void least_motion_factor(LeastMotion *e, const Real *J, Int n, Int m, Real cut);
/* x of least |x| that minimises |J x + residual|^2 + damping |x|^2; damping may be 0 */
void least_motion_solve(LeastMotion *e, Real damping, const Real *residual, Real *x);
/* Orthonormal rows (m - rank, m) of changes that no equation notices */
void least_motion_freedoms(const LeastMotion *e, Real *rows);
/* y (n) with Jᵀ y as near to a gradient (m) as can be */
void least_motion_multipliers(LeastMotion *e, const Real *gradient, Real *y);

/* ---- unwrapping.c ---- */
/* Named coordinates: angles unwrapped to them, and the distance from them, see unwrapping.c. */
/* Of an entry of q, in bits: its value is named, or is fixed; whole turns mean nothing. */
enum NamedKind { NAMED = 1, HELD = 2, TURNS = 4 };

typedef struct {
    const Real *value; /* (nq) of named or fixed entries; of a ball a quaternion; NULL: none */
    const Int *kinds;           /* (nq) of a ball its first entry counts */
    const Real *lower, *upper; /* (nq) limits */
} Named;

void unwrap_angles(const Kernel *k, const Named *named, Real *q);
Real named_distance(const Kernel *k, const Named *named, const Real *q);

#endif
