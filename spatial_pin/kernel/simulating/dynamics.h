/* A mechanism moved by independent coordinates under forces: what dynamics.c, independent.c,
 * partitioning.c and crossing.c share, and what integrating.c asks of them.
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
#include "springs.h"

/* More reasons why a function ended. */
enum { LOST = 20, CALLBACK_FAILED = 21 };

/* What only Python knows. Each returns 0, or CALLBACK_FAILED where an exception waits to be raised;
 * `least` also LOST where masses differ too much. Any may be NULL where it is not needed. */
typedef struct {
    int (*efforts)(Real t, const Real *q, const Real *v, const Real *angles, Real *force);
    int (*spring)(Int which, Real length, Real rate, Real *force);
    int (*drives)(Real t, Real *values); /* (n, 3) value, rate, acceleration */
    int (*least)(Real t, const Real *q, const Real *v, const Real *a, const Real *angles,
                 Real *z); /* accelerations of the free coordinates by scale */
} Callbacks;

/* Pivot at which a configuration has seven digits left */
#define LEAST_SOLVED TOLERANCE_NOTHING
/* Way of one trial, beyond which it is a wild one: no integrator that is right goes two hundred
   turns */
#define WILD_WAY 1280.0

enum { BRIDGE_NODES = 8, MOST_BRIDGES = 8, MOST_BRANCH_POINTS = 6 };

/* The stretch about a branch point of branches, as polynomials in x through nodes on both sides. */
typedef struct {
    Real x[2 * BRIDGE_NODES], weight[2 * BRIDGE_NODES];
    Real *q, *t, *c, *angles; /* per node: configuration, derivatives with respect to x */
    Real low, high;           /* between which the polynomials are the branch */
    Int near, far;            /* the nodes at the ends */
    Real branch_point[MOST_BRANCH_POINTS];
    Int n_branch_points;
} Bridge;

typedef struct {
    Real *q, *x, *turns;
    Int bridge, turn;
    Int has_bend; /* as below */
    Real *bend, *bend_rate, *change;
    Real distance;
} SavedPosition;

/* Bodies that spin freely about lines of their own. */
typedef struct {
    Int n;
    const Int *joint;
    const Real *axis; /* (3) in the body's axes */
    Real *rate;       /* angular velocity of each about its line */
} Spins;

/* What acts on bodies and joints, and what comes of it. */
typedef struct {
    const Real *damping, *friction, *slip, *armature, *constant; /* (nv) */
    Int resists, n_turns;
    const Int *turn_q, *turn_v, *turn_law;
    const Real *turn_spring; /* stiffness, damping, free */
    Springs springs;
    Real *given, *tau;           /* (nv) joint forces, given and missing */
    Real *drive_effort;          /* (n_drives) */
} Forces;

/* How near the equations are to losing rank, by the determinant of their square system. */
typedef struct {
    Real sign, first_pivot; /* where the equations were chosen */
    Real spare;             /* residual of equations left out, at the start */
    Real distance; /* change of x at which the equations would lose rank; 0: not known */
    Real *change;  /* (n_held) derivatives, along the last step, of what tells that, relative to it */
    Real mantissa;
    Int exponent;  /* of the determinant here */
    Real since;    /* its change since the last place, relative to what it is here */
    Int flipped;   /* whether the last step failed for a change of its sign */
} Determinant;

/* Branch points of one freedom, and the bridges across them. */
typedef struct {
    Int n, n_built;
    Bridge bridges[MOST_BRIDGES];
    Real period;                     /* of x: a whole turn; 0: there is none */
    Int period_is_known;             /* 0: not yet, 1: yes, -1: there is none */
    Real *period_q, *period_angle;
    Real refused[MOST_BRIDGES];     /* where no bridge could be built */
    Int n_refused, n_renewed;
    Real renewed; /* where other equations were chosen last instead of passing a branch point */
    Real *t, *c;                     /* (nv) derivatives by x on the present bridge */
} Branches;

/* The curve that one held coordinate moves along. */
typedef struct {
    Int is_curve, n_points;          /* whether it moves along one; points known of it */
    Point points[2], *point, *before; /* the last here, and the one before */
    Point anchor[3]; /* in time: the two that samples lie between, and where the last step ended */
    Real stride;     /* how far apart they may be */
} Curve;

/* Room to work in. */
typedef struct {
    const Real *wanted; /* (n_held) coordinates to be reached by corrections */
    Real *asking;       /* (3, n_held) the same, their rates and accelerations, as unknowns tell */
    Real *before, *halfway; /* (n_held) where a way begins, and where a step of it is to end */
    Real *off;          /* (n_held) by how much coordinates are off */
    Real *by_rates;     /* (n_held, n_held) rates of x by those of held coordinates, and factors */
    Real *trial, *goal; /* (nq) configurations that are tried */
    Real *step, *solved; /* (nv) by scale */
    Real *twist, *mass, *unit; /* see masses.c */
    Tree *tree;         /* of an open tree, else NULL: see masses.c */
    Real *tree_room;    /* (7 nv) */
    Real *laws;         /* (n_drives, 3) prescribed values, rates, accelerations */
    Real *freedoms;     /* (nv, n_free) orthonormal motions, see partitioning.c */
    Int *order;         /* (n_held) of rows in the inverse's factors */
    Int *best;          /* (n_free) coordinates that would be best */
    Int *former;        /* (nv) equations chosen before others were tried */
    SavedPosition saved, ended;
    Real opened;        /* closure error before the last projection */
    Int corrections;    /* number of corrections of the projection */
} Work;

typedef struct Dynamics {
    /* ---- what Python reads in place, as `_DynamicsHead` in dynamics.py ---- */
    Int evaluations;    /* of dy/dt */
    Int crosses;         /* whether branch points are passed: pivots tell nothing then */
    Real pivot;         /* smallest over largest pivot of the constraint equations */
    Int *held;          /* (n_held) velocity entries: the free ones, then the prescribed ones */
    const Int *factorisations; /* of the constraint equations */

    Kernel *k;
    Callbacks callbacks;

    /* ---- coordinates ---- */
    Int n_free, n_drives, n_held, n_unknowns, works;
    Int projects; /* whether all joint coordinates are unknowns, see projected.c */
    const Int *prescribed; /* velocity entries */
    Int *held_q;           /* entry of q, or -1 of a rotation in space */
    Int *held_joint, *held_component; /* of a ball (0..2) or a free joint (0..5) */
    Real *start;           /* (nq) what x counts from */
    Int is_linear;
    Real tolerance, heaviest;
    Spins spins;
    Forces forces;

    /* ---- where it is ---- */
    Real *q, *x, *turns; /* the configuration, coordinates of all held ones, screw angles */
    Int bridge, turn;   /* the bridge it is on, or -1, and after how many turns */
    Real *columns;    /* (n_held, nv) v / scale per unit rate of a held coordinate, by scale */
    Real *by_velocity, *inverse; /* (n_held, 3) derivatives of x; (n_held, n_held) by columns */
    Int has_bend;
    Real *bend, *bend_rate; /* (nv) a / scale at rates of x; (n_held) these, by their square */
    SavedPosition restart; /* where to begin anew from where the way from another is lost */
    Determinant determinant;
    Curve curve;
    Branches branches;

    Real *v, *a, *a0, *z;   /* the last evaluation */
    Work work;
} Dynamics;

/* Samples of a motion: a row of each array belongs to one. */
typedef struct {
    Real *q, *v;
    Real *a;        /* NULL: no forces are evaluated */
    Real *numbers;  /* (4) closure error; where forces are evaluated kinetic and total energy, work */
    Real *efforts;  /* (n_drives) of prescribed drivers, likewise */
    Real *angles;   /* (n_angles) of screws */
    Real *heaviest; /* NULL, or the largest inertia of a joint, scaled, the others held */
} SampleRows;

/* A closed configuration that coordinates count from, with independent ones and equations. */
typedef struct {
    const Real *q, *angles, *spins; /* (nq), (n_angles) of screws, (n_spins) about their lines */
    const Int *free;                /* (n_free) velocity entries */
    const Int *chosen;              /* (n_chosen) closure equations */
    Int n_chosen;
} StartingPoint;

/* ---- independent.c ---- */
int independent_begin(Dynamics *d);              /* at d->q: columns, sign, pivots */
int independent_evaluate(Dynamics *d);              /* evaluate and factor at d->q */
int independent_factor(Dynamics *d);             /* the same where it is evaluated */
void independent_read(Dynamics *d);              /* x of the held coordinates, at d->q */
int independent_choose_anew(Dynamics *d); /* other equations; the loops are closed with them */
int independent_measure_change(Dynamics *d); /* of the determinant, from d->restart to where it is */
int independent_step(Dynamics *d, const Real *x); /* one safe step, UNSAFE and lost otherwise */
int independent_settle(Dynamics *d, const Real *x, Real allowed); /* close the loops at x */
int independent_follow(Dynamics *d, const Real *x); /* as many steps as it takes */
void independent_save(const Dynamics *d, SavedPosition *position);
int independent_restore(Dynamics *d, const SavedPosition *position);
void independent_columns(Dynamics *d);
void independent_rates(Dynamics *d, const Real *v, Real *rates); /* of the free x, at v */
Real independent_pace(const Dynamics *d);
void independent_bias(Dynamics *d, const Real *v, const Real *held_acceleration, Real *a);

/* ---- partitioning.c ---- */
void partitioning_orthonormal_freedoms(Dynamics *d); /* d->work.freedoms, of the columns */
int partitioning_begin(Dynamics *d, const StartingPoint *start); /* SINGULAR where it cannot */
int partitioning_hold_better(Dynamics *d); /* hold the best coordinates, counted as they are */
/* Change the unknowns y, at q and v, to the best coordinates, see dynamics_renew. */
int partitioning_renew(Dynamics *d, const Real *q, const Real *v, Real *y, Int *free, Int *same);

/* ---- projected.c ---- */
int projected_evaluate(Dynamics *d, const Real *y); /* q, v, a0 */
void projected_rates(Dynamics *d, Real *rates);  /* of the coordinates and velocities */

/* ---- crossing.c ---- */
int crossing_restore(Dynamics *d, const SavedPosition *position);
int crossing_travel(Dynamics *d, const Real *x); /* to coordinates x, branch points included */
Int crossing_points(const Dynamics *d, Real from, Real to, Real *x, Int room);

/* ---- dynamics.c ---- */
/* dy/dt of a Dynamics. LOST where the loops cannot be closed at y. */
EXPORT int dynamics_rates(void *d, Real t, const Real *y, Real *rates);
/* Write sample i. */
int dynamics_sample(Dynamics *d, Real t, const Real *y, const SampleRows *rows, Int i);
/* Make a point of the motion in time where the last rates, or sample, were evaluated. */
void dynamics_point(Dynamics *d, Real t, const Real *y, Point *point);
/* Write sample i between two points of the motion; LOST where it does not lie between them. */
int dynamics_sample_between(Dynamics *d, const Point *from, const Point *to, Real t, const Real *y,
                            const SampleRows *rows, Int i);
/* Take the present place for one to begin anew from where the way from another is lost; returns how
 * many times faster than the coordinates another moves. */
EXPORT Real dynamics_save(Dynamics *d);

/* ---- masses.c ---- */
Real largest_inertia(Dynamics *d); /* of a joint, scaled, the others held: of all that it carries */

/* ---- creating.c ---- */
/* Make one on a kernel without equations of idle rotations, which it is freed with. The arrays are as
 * read_arrays takes them. BAD_ARRAYS, NO_MEMORY; SINGULAR where the coordinates do not determine the
 * motion at the start. */
EXPORT int dynamics_create(Kernel *k, const Int *ints, Int n_ints, const Real *reals, Int n_reals,
                           const Callbacks *callbacks, const StartingPoint *start, Dynamics **out);

#endif
