/* A path of closed configurations, followed through many values of its parameter s.
 *
 * As a rule s is the value of the first driver. Samples are taken in any order; the path is
 * a cursor that goes back and forth. */
#ifndef SPATIAL_PIN_FOLLOWING_H
#define SPATIAL_PIN_FOLLOWING_H

#include "closing.h"
#include "correcting.h"

/* How exactly a path is followed. */
typedef struct {
    Real enough;    /* closure residual at which a prediction is left as it is */
    Real tolerance; /* closure residual to reach by corrections */
    Real left;      /* closure residual that round-off may leave where there is no closer */
    Real idle;      /* idle rotation that one step may leave [rad] */
    Real between;   /* error of samples that are interpolated between points, of q, and of rates by
                       their size; 0: none are */
    Int order;      /* of the predictor: 0 to 2 Taylor's, 3 Hermite's through two points */
    Int corrections; /* of a step, whatever the residual; -1: as many as it takes. A fixed number
                       of them goes with Taylor's predictor, of order 3 too */
} PathAccuracy;

/* The samples of a path: a row of each array belongs to one value. */
typedef struct {
    Real *q;      /* (n, nq) */
    Real *t, *c;  /* (n, nv) first and second derivative by s, joint rates */
    Real *error;  /* (n) largest residual of all closure equations */
    Real *estimate; /* (n, 3) error estimates of q, t and c, scaled; NULL: none are wanted */
    Real *angles; /* (n, n_angles) of screws, counting turns */
} PathRows;

/* A path, and where its current point is written: as `_PathTask` in paths.py. What it points to lives
 * as long as the path is followed. */
typedef struct {
    const Int *chosen;   /* (n_chosen) equations; NULL: as many independent ones are chosen where the
                            path starts, if the loops are regular there */
    Int n_chosen;
    const Int *driven;   /* (n_driven) as system_set has them */
    Int n_driven;
    const Real *fill;    /* (n_fill, nv) likewise */
    Int n_fill;
    PathAccuracy accuracy;
    Real begin;          /* s at the start, where values of driven coordinates, from the first on, are */
    Int n_pieces, degree; /* piecewise polynomials of s (prescribing.h); no pieces: they are not */
    const Real *breaks, *coefficients;
    Real open;           /* of path_from_guess, see `closed_straight` */
    Real *s;             /* the current point: its parameter, and one row */
    PathRows here;
} PathTask;

/* Start a path at a closed configuration q (nq), whose screw angles are near `angles`; the kernel
 * has one path at a time. DONE, or SINGULAR, NOT_FINITE, NO_MEMORY; UNSAFE: so near to a singular
 * configuration that it is in doubt; BAD_ARRAYS: nothing that has a value is driven first, or
 * sizes and polynomials are not sound. */
EXPORT int path_start(Kernel *k, const PathTask *task, const Real *q, const Real *angles);

/* Follow the kernel's path through values (n) of s, whose samples are written. Returns how many
 * were reached. There are no more where the next one lies beyond where equations seem to become
 * dependent, where steps become too small, where the path bends or ends, or where it is out of all
 * proportion; the current point is the last safe one. */
EXPORT Int path_follow(Kernel *k, const Real *values, Int n, const PathRows *rows);

/* Close the loops from a guess, start a path there and follow it, in one call. Returns as
 * `path_follow`; -1 where closing leaves something to choose, or the loops are not regular, -2
 * where closing has failed, as `closer_close` does. */
EXPORT Int path_from_guess(Kernel *k, const PathTask *task, Closer *c, ClosureTask *guess,
                           const Real *values, Int n, const PathRows *rows);

/* Configurations at scattered values of the first driven coordinates, each followed along a straight
   line from another one: as `_ScatterTask` in paths.py. */
typedef struct {
    Int n_rows, n;
    const Int *row;      /* (n) which rows of the arrays to find, in this order, */
    const Int *parent;   /* (n_rows) and from which each comes; where that is not reached, from its own.
                            The last row is the first configuration, which comes from none */
    Int n_values;
    const Real *values;  /* (n_rows, n_values) */
    Real *line;          /* (n_driven, 2) coefficients of the line: of coordinates that are not among the
                            values they stay */
    Int is_last;         /* whether unreachable rows end at the nearest configuration */
    PathRows rows;       /* (n_rows) */
    Real *part;          /* (n_rows) of the line that was gone: 1 where the values are reached */
} ScatterTask;

/* Find rows, each as if it were the first. DONE, or NO_MEMORY or BAD_ARRAYS as path_start. */
EXPORT int path_scatter(Kernel *k, const PathTask *task, const ScatterTask *scatter);

#endif
