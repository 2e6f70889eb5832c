/* A mechanism moved by independent coordinates under forces: what dynamics.c, independent.c,
 * partitioning.c and passing.c share, and what integrating.c asks of them.
 *
 * Unknowns y: the n free coordinates x, their joint rates u (both in units of the
 * velocity's scale), a quaternion (x, y, z, w) for every body that spins freely about its own line,
 * and the work done, if anything does work; where it projects, x and u of all joints in the place of
 * the free ones. Held coordinates are the free ones, then the prescribed ones. */
#ifndef SPATIAL_PIN_DYNAMICS_H
#define SPATIAL_PIN_DYNAMICS_H

#include "articulated.h"
#include "relative.h"
#include "path_point.h"

/* More reasons why a function ended. */
enum { LOST = 20, ASK_FAILED = 21 };

/* What only Python knows. Each returns 0, or ASK_FAILED where an exception waits to be raised;
 * `least` also LOST where masses differ too much. Any may be NULL where nothing is asked. */
typedef struct {
    int (*efforts)(Real t, const Real *q, const Real *v, const Real *angles, Real *force);
    int (*spring)(Int which, Real length, Real rate, Real *force);
    int (*drives)(Real t, Real *values); /* (n, 3) value, rate, acceleration */
    int (*least)(Real t, const Real *q, const Real *v, const Real *a, const Real *angles,
                 Real *z); /* accelerations of the free coordinates by scale */
} Asked;

/* Pivot at which a configuration has seven digits left */
#define LEAST_SOLVED TOLERANCE_NOTHING
/* Way of one trial, beyond which it is a wild one: no integrator that is right goes two hundred
   turns */
#define WILD_WAY 1280.0

enum { BUSHING_NUMBERS = 103 };
enum { PASSAGE_NODES = 8, MOST_PASSAGES = 8, MOST_BRANCH_POINTS = 6 };

/* The stretch about a branch point of branches, as polynomials in x through nodes on both sides. */
typedef struct {
    Real x[2 * PASSAGE_NODES], weight[2 * PASSAGE_NODES];
    Real *q, *t, *c, *angles; /* per node: configuration, derivatives with respect to x */
    Real low, high;           /* between which the polynomials stand for the branch */
    Int near, far;            /* the nodes at the ends */
    Real branch_point[MOST_BRANCH_POINTS];
    Int n_branch_points;
} Passage;

typedef struct {
    Real *q, *x, *turns;
    Int passage, turn;
    Int has_bend; /* as below */
    Real *bend, *bend_rate, *change;
    Real distance;
} Place;

typedef struct Dynamics {
    Kernel *k;
    Asked asked;

    /* ---- coordinates ---- */
    Int n_free, n_drives, n_held, n_spins, n_unknowns, works;
    Int projects; /* whether all joint coordinates are unknowns, see projected.c */
    const Int *prescribed; /* velocity entries */
    Int *held, *held_q;    /* velocity entry; entry of q, or -1 of a rotation in space */
    Int *held_joint, *held_component; /* of a ball (0..2) or a free joint (0..5) */
    Real *start;           /* (nq) what x counts from */
    Int is_linear;
    const Int *spin_joint;
    const Real *spin_axis; /* (3) in the body's axes */
    Real *sigma;           /* angular velocity of each about its line */
    Real tolerance, heaviest, period;

    /* ---- forces ---- */
    const Real *damping, *friction, *slip, *armature, *constant; /* (nv) */
    Int resists, n_lines, n_turns, n_bushings;
    const Int *line_body, *line_law, *turn_q, *turn_v, *turn_law;
    const Real *line_point, *line_spring, *turn_spring; /* spring: stiffness, damping, free */
    const Int *bushing_body, *bushing_law; /* law: 0, or 1 and the component that it is of */
    const Real *bushing;                   /* see bushings.c */

    /* ---- where it is ---- */
    Real *q, *x, *turns; /* the configuration, coordinates of all held ones, screw angles */
    Real sign, pivot, first_pivot, spare; /* spare: residual of equations left out, at the start */
    Real *columns;    /* (n_held, nv) v / scale per unit rate of a held coordinate, by scale */
    Real *by_velocity, *inverse; /* (n_held, 3) derivatives of x; (n_held, n_held) by columns */
    Int has_bend;
    Real *bend, *bend_rate; /* (nv) a / scale at rates of x; (n_held) these, by their square */
    Int is_curve, n_points; /* whether it moves along a curve; points known of it, the last here */
    Point points[2], *point, *point_before;
    Place kept;
    Real opened;      /* what was left open before the last projection, and how many corrections */
    Int corrections;  /* it took */

    /* ---- the last evaluation ---- */
    Real *v, *a, *a0, *given, *tau, *z, *drive_effort;
    Real power;

    /* ---- branch points of one freedom ---- */
    Int passes, n_passages, n_built, passage, turn; /* passage: the one it stands on, or -1 */
    Passage passages[MOST_PASSAGES];
    Int period_is_known; /* 0: not yet, 1: yes, -1: there is none */
    Real *period_q, *period_angle;
    Real distance; /* change of x at which the equations, as they change, would lose rank; 0: not known */
    Real *change; /* (n_held) derivatives, along the last step, of what tells that, relative to it */
    Real mantissa;
    Int exponent; /* of the determinant here */
    Real since;   /* its change since the last place, relative to what it is here; see there */
    Real refused[MOST_PASSAGES];
    Int n_renewed;
    Real renewed; /* where other equations were chosen last instead of passing a branch point */
    Int n_refused, flipped;
    Real *passage_t, *passage_c;

    /* ---- room to work in ---- */
    const Real *wanted; /* (n_held) coordinates to be reached by corrections */
    Real *asking;       /* (3, n_held) the same, their rates and accelerations, as unknowns tell */
    Real *before, *halfway; /* (n_held) where a way begins, and where a step of it is to end */
    Real *off;          /* (n_held) by how much coordinates are off */
    Real *by_rates;     /* (n_held, n_held) rates of x by those of held coordinates, and factors */
    Real *trial, *goal; /* (nq) configurations that are tried */
    Real *step, *solved; /* (nv) by scale */
    Real *force, *moment; /* (n_joints, 3) that bodies need, see forces.h */
    Real *twist, *mass, *unit; /* see masses.c */
    Tree *tree;       /* of an open tree, else NULL: see masses.c */
    Real *tree_room;  /* (7 nv) */
    Real *laws;         /* (n_drives, 3) what is prescribed */
    Real *freedoms;     /* (nv, n_free) orthonormal motions, see partitioning.c */
    Int *order;  /* (n_held) of rows in the inverse's factors */
    Int *best;   /* (n_free) coordinates that would be best */
    Int *former; /* (nv) equations chosen before others were tried */
    Place aside, ended;
    Point anchor[3]; /* the two that samples lie between, and where the last step ended */
    Real stride;     /* of x, how far apart they may be */
    Int evaluations;
} Dynamics;

/* Samples of a motion: a row of each array belongs to one. */
typedef struct {
    Real *q, *v, *a;
    Real *numbers; /* (4) closure error, kinetic and total energy, work */
    Real *efforts; /* (n_drives) of prescribed drivers */
    Real *angles;  /* (n_angles) of screws */
} SampleRows;

/* ---- independent.c ---- */
int independent_begin(Dynamics *d);              /* at d->q: columns, sign, pivots */
int independent_stand(Dynamics *d);              /* evaluate and factor at d->q */
int independent_factor(Dynamics *d);             /* the same where it is evaluated */
void independent_note(Dynamics *d);              /* x of the held coordinates, at d->q */
int independent_choose_anew(Dynamics *d); /* other equations; the loops are closed with them */
int independent_learn_change(Dynamics *d); /* of the determinant, from d->kept to where it is */
int independent_step(Dynamics *d, const Real *x); /* one safe step, UNSAFE and lost otherwise */
int independent_settle(Dynamics *d, const Real *x, Real allowed); /* close the loops at x */
int independent_follow(Dynamics *d, const Real *x); /* as many steps as it takes */
void independent_remember(const Dynamics *d, Place *place);
int independent_return(Dynamics *d, const Place *place);
void independent_columns(Dynamics *d);
void independent_rates(Dynamics *d, const Real *v, Real *rates); /* of the free x, at v */
Real independent_pace(const Dynamics *d);
void independent_bias(Dynamics *d, const Real *v, const Real *held_acceleration, Real *a);

/* ---- partitioning.c ---- */
void partitioning_orthonormal_freedoms(Dynamics *d); /* d->freedoms, of the columns */
int partitioning_hold_better(Dynamics *d); /* hold the best coordinates, counted as they are */

/* ---- projected.c ---- */
int projected_place(Dynamics *d, const Real *y); /* q, v, a0 */
void projected_rates(Dynamics *d, Real *rates);  /* of the coordinates and velocities */

/* ---- passing.c ---- */
int passing_return(Dynamics *d, const Place *place);
int passing_travel(Dynamics *d, const Real *x); /* to coordinates x, branch points included */
Int passing_crossed(const Dynamics *d, Real from, Real to, Real *x, Int room);

/* ---- dynamics.c ---- */
/* dy/dt of a Dynamics. LOST where the loops cannot be closed at y. */
EXPORT int dynamics_rates(void *d, Real t, const Real *y, Real *rates);
/* Write sample i. Accelerations of the free coordinates are z, or NULL: they follow from forces. */
int dynamics_sample(Dynamics *d, Real t, const Real *y, const Real *z, const SampleRows *rows,
                    Int i);
/* The same where one freedom, accelerated by z, lies between two points of its curve; LOST where it
 * does not. */
int dynamics_sample_between(Dynamics *d, const Point *from, const Point *to, const Real *y, Real z,
                            const SampleRows *rows, Int i);
EXPORT Real dynamics_keep(Dynamics *d);
EXPORT Real dynamics_pivot(const Dynamics *d);
EXPORT Real dynamics_heaviest(Dynamics *d);
EXPORT int dynamics_place(Dynamics *d, Real t, const Real *y, Real *q, Real *v, Real *angles,
                          Real *error);

#endif
