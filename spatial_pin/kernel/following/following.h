/* A path of closed configurations, followed through many values of its parameter s.
 *
 * As a rule s is the value of what is driven first. Samples are taken in any order; the path is
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

typedef struct Path Path;

/* A path on the kernel's square system. */
EXPORT int path_create(Kernel *k, const PathAccuracy *accuracy, Path **out);
EXPORT void path_destroy(Path *path);

/* Let values of what is driven, from the first on, be piecewise polynomials of s (prescribing.h),
 * of which a path starts at `begin` from now on. DONE, BAD_ARRAYS, NO_MEMORY. */
EXPORT int path_prescribe(Path *path, Real begin, Int n_pieces, Int degree, const Real *breaks,
                          const Real *coefficients);

/* Stand at a closed configuration q (nq), whose screw angles are near `angles`. The equations are
 * those of the system, or with `choose` as many independent ones, if the loops are regular there.
 * DONE, or SINGULAR, NOT_FINITE, NO_MEMORY; UNSAFE: so near to a singular one that it is in doubt;
 * BAD_ARRAYS: nothing that has a value is driven first. */
EXPORT int path_start(Path *path, const Real *q, const Real *angles, Int choose);

/* Where the values (n) of a path go: a row of each array belongs to one value. */
typedef struct {
    Real *q;      /* (n, nq) */
    Real *t, *c;  /* (n, nv) first and second derivative by s, joint rates */
    Real *error;  /* (n) largest residual of all closure equations */
    Real *estimate; /* (n, 3) error estimates of q, t and c, scaled */
    Real *angle;  /* (n, n_angles) of screws, counting turns */
} PathRows;

/* Follow the path through values of s. Returns how many were reached; then `code` says why no
 * more, as `path_go`. The path then stands at the last safe point. */
EXPORT Int path_follow(Path *path, const Real *values, Int n, const PathRows *rows, int *code);

/* Where a path begins, and where its values go: what `path_from_guess` takes. */
typedef struct {
    Int n_chosen;        /* equations to choose */
    const Int *driven;   /* (n_driven) as system_set has them */
    Int n_driven;
    Real open;           /* see `reached_straight` */
    const Real *value;   /* (n) */
    Int n;
    PathRows rows;
} PathTask;

/* Close the loops from a guess, begin the path there and follow it, in one call. Returns as
 * `path_follow`; -1 where closing leaves something to choose, or the loops are not regular, -2
 * where closing has failed, as `closer_reach` does. */
EXPORT Int path_from_guess(Path *path, Closer *c, Reaching *r, const PathTask *task);

/* Go to a value of s: DONE, or SINGULAR: it lies beyond where equations seem to become dependent,
 * UNSAFE, NOT_CONVERGED: steps become too small, the path bends or ends, or it is out of all
 * proportion to where the path stands, NOT_FINITE, NO_MEMORY. The path then stands at the last safe point. */
EXPORT int path_go(Path *path, Real target);

/* Where the path stands, in one row; returns s. */
EXPORT Real path_stand(Path *path, const PathRows *row);

#endif
