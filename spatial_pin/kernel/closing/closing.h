/* Closing the loops from a guess, by the least motion: see closing.c. */
#ifndef SPATIAL_PIN_CLOSING_H
#define SPATIAL_PIN_CLOSING_H

#include "meant.h"

typedef struct Closer Closer;

/* What loops are closed with. */
typedef struct {
    const Int *first, *free;  /* (nv) velocities that may move first, or NULL, and then */
    Real loose, tolerance;    /* residuals to which, then and then */
    Int iterations;           /* damped steps at most */
} Closing;

/* What closer_reach closes with, and what it finds: as `Reaching` in closer.py. */
typedef struct {
    Int m;                        /* starts, then rows found */
    Real *q;                      /* (m, nq) */
    Closing how;
    const Real *pinned, *reference; /* as closer_close has them */
    Real cut;
    Meant meant;
    Int n_shakes;
    const Real *shakes;           /* (n_shakes, nv) of further starts: of a group, from the first one */
    Real near;                    /* distance from what is named that is not questioned */
    const Int *shaken, *group;    /* (n_shakes) the group of loops that each is of; (nv) of velocities */
    Real *error, *distance;       /* (m) */
    Int *mirrored;                /* (m) */
    Real *facts, *angle;          /* as closer_examine has them */
} Reaching;

EXPORT int closer_create(Kernel *k, const Int *rotations, Int n_rotations, const Int *pins,
                         Int n_pins, Closer **out);
EXPORT void closer_close(Closer *c, Real *q, const Int *first, const Int *free,
                         const Real *pinned, const Real *reference, Real loose, Real tolerance,
                         Int iterations, Real cut, Real *error, Int *mirrored);
EXPORT int closer_examine(Closer *c, const Real *q, const Real *reference, Real *facts, Real *angle,
                          Int *mirrored);

/* Close the loops as closer_close does, and judge where that leads. Of a single start, what is closed
   is examined too, else facts[0] is infinite; and where nothing is at fault there, further starts
   are tried: q, error, distance and mirrored have room for 1 + n_shakes rows. */
EXPORT int closer_reach(Closer *c, Reaching *r);
/* Whether nothing is at fault in the first place that was reached, and it is the nearest, or near
   where there was no other start. Others may be open by more than `open`: their starts have led
   nowhere. */
int reached_straight(const Reaching *r, Real open);

#endif
