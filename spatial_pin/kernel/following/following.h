/* A path of closed configurations, followed through many values of one driver. */
#ifndef SPATIAL_PIN_FOLLOWING_H
#define SPATIAL_PIN_FOLLOWING_H

#include "correcting.h"

/* How exactly a path is followed. */
typedef struct {
    Real enough;    /* closure residual at which a prediction is left as it is */
    Real tolerance; /* closure residual to reach by corrections */
    Real left;      /* closure residual that round-off may leave where there is no closer */
    Real idle;      /* idle rotation that one step may leave [rad] */
    Real between;   /* error of points that are interpolated between others; 0: none are */
    Int order;      /* of the predictor: 0 to 2 Taylor's, 3 Hermite's through two points */
} PathAccuracy;

typedef struct Path Path;

/* A path on the kernel's square system, whose first driven freedom is the driver. */
EXPORT int path_create(Kernel *k, const PathAccuracy *accuracy, Path **out);
EXPORT void path_destroy(Path *path);

/* Stand at a closed configuration q (nq), whose screw angles are near `angles`. The equations are
 * those of the system, or with `choose` as many independent ones, if the loops are regular there.
 * DONE, or SINGULAR, NOT_FINITE, NO_MEMORY; UNSAFE: so near to a singular one that it is in doubt. */
EXPORT int path_start(Path *path, const Real *q, const Real *angles, Int choose);

/* Where the values (n) of a path go: a row of each array belongs to one value. */
typedef struct {
    Real *q;      /* (n, nq) */
    Real *t, *c;  /* (n, nv) first and second derivative by the driver, joint rates */
    Real *error;  /* (n) largest residual of all closure equations */
    Real *angle;  /* (n, n_angles) of screws, counting turns */
} PathRows;

/* Follow the path through driver values. Returns how many were reached; then `code` says why no
 * more: UNSAFE, where the next lies beyond something that is to be looked at, or where steps fail
 * for any other reason. The path then stands at the last safe point. */
EXPORT Int path_follow(Path *path, const Real *values, Int n, const PathRows *rows, int *code);

/* Where the path stands: its q (nq) and angles (n_angles); returns the driver's value. */
EXPORT Real path_stand(const Path *path, Real *q, Real *angles);

#endif
