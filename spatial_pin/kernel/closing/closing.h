/* Closing the loops from a guess, by the least motion: see closing.c. */
#ifndef SPATIAL_PIN_CLOSING_H
#define SPATIAL_PIN_CLOSING_H

#include "closing_parts.h"

typedef struct Closer Closer;

/* What loops are closed with. */
typedef struct {
    const Int *first, *free;  /* (nv) velocities that may move first, or NULL, and then */
    Real loose, tolerance;    /* residuals to which, then and then */
    Int iterations;           /* damped steps at most */
} Closing;

/* What closer_close closes with, and what it finds: as `ClosureTask` in closer.py. */
typedef struct {
    Int m;                        /* starts, then results */
    Real *q;                      /* (m, nq) */
    Closing how;
    const Real *pinned;           /* values of pinned coordinates */
    const Real *reference;        /* (n_angles) from which the angles of screws count */
    Real cut;                     /* size of equations, by the largest, below which they move nothing */
    Named named;
    Int n_steps;
    const Real *steps;            /* (n_steps, nv) of further starts: of a group, from the first one */
    Real near;                    /* a distance from the named values that is accepted */
    const Int *moved, *group;     /* (n_steps) the group of loops that each moves; (nv) of velocities */
    Real *error, *distance;       /* (m) closure error; distance from the named values */
    Int *mirrored;                /* (m) whether axes point opposite ways */
    Real *facts, *angle;          /* as closer_examine has them; facts NULL: not wanted */
    Targets targets;              /* met too, from the first start */
    Int unique;  /* whether it is of interest that no other closed configuration is as near to the first
                    start; then whether that is certain, and further starts were not needed */
} ClosureTask;

/* Memory to close the loops of a kernel, freed with it. rotations: (n_rotations) first equations of
   closures, then whether 1 or 3 of their axes agree; pins: (n_pins, 4) see Pin, those of one joint
   side by side; body: (n_axes, 2) joints; axis: (n_axes, 2, 3) parallel axes in those of the joints, of
   closures without some equations of directions: they are judged too whether they point opposite ways. */
EXPORT int closer_create(Kernel *k, const Int *rotations, Int n_rotations, const Int *pins,
                         Int n_pins, const Int *body, const Real *axis, Int n_axes, Closer **out);

/* Close the loops from each start by itself, and judge where that leads. Of a single start, a closed
   result is examined too, else facts[0] is infinite; and where nothing is at fault there, further
   starts are tried: q, error, distance and mirrored have room for 1 + n_steps rows. With targets it
   is the nearest to the first start that meets them, `distance` the rest of them, `first` and
   pinned coordinates are none; NOT_CONVERGED where that was not found. */
EXPORT int closer_close(Closer *c, ClosureTask *r);
/* Whether nothing is at fault in the first row, and it is the nearest, or near where there was no
   other start. Others may be open by more than `open`: their starts have led nowhere. */
int closed_straight(const ClosureTask *r, Real open);

/* What a configuration q (nq) is like, whole turns taken off its angles where some are named. facts:
   (4) closure error, distance from the named values, and, where `angle` is wanted, how clearly equations
   are independent: `least` and `left_out`, see judge_independence. angle: (n_angles) of screws;
   mirrored: whether axes point opposite ways. */
EXPORT int closer_examine(Closer *c, Real *q, const Real *reference, const Named *named, Real *facts,
                          Real *angle, Int *mirrored);

/* Close from q (nq), nothing pinned or named; returns the closure error. The kernel is evaluated
   there. */
Real closer_close_one(Closer *c, Real *q, const Closing *how, const Real *reference, Real cut);

#endif
