/* What a path consists of, and the parts that it is followed by. */
#ifndef SPATIAL_PIN_PATH_H
#define SPATIAL_PIN_PATH_H

#include "following.h"
#include "interpolating.h"

/* How a path's equations magnify errors at one of its points, see estimating.c. */
typedef struct {
    Real gain;          /* of residuals, into errors of q */
    Real first, second; /* of errors of q, into those of t and of c */
    Real pace, bend, pivot; /* there: where they have changed, it is worth another look */
    Int rows;           /* written since */
    Real *t, *c, *along, *change; /* (nv), scaled */
} Probe;

typedef struct Path {
    Kernel *k;
    PathTask task;
    PathAccuracy accuracy; /* of the task */
    Prescribed prescribed;
    Point points[3], *here, *before, *next; /* `next` is the trial */
    Between between; /* polynomials of the last interpolated step */
    Point middle;   /* of that */
    IdleCurve *curve; /* (n_idle) axes of links in the last step */
    int has_started; /* whether there is a point `here` */
    int goes_to_end; /* whether steps become as short as it takes, where the path ends */
    int has_before; /* whether there is a point before `here`, on the same stretch */
    Int *chosen;    /* equations in use at `here` */
    Real sign;      /* of the determinant with these equations */
    Real selected, selected_ratio; /* its size, and the ratio of pivots, where they were chosen */
    Real zero;      /* s where it would vanish as it last fell; infinite if it rose */
    int zero_known, stale; /* `stale`: the factors are of another point than `here` */
    Real idle_way;  /* the joints' longest way in a step that idle rotations allow, with a point before */
    Real between_way; /* the joints' way between points that samples are interpolated between */
    Real abreast_way; /* the joints' way between points that samples are closed between */
    Real way;       /* the joints' way in the last step that was tried, by prediction */
    Real rounding;  /* closure error that round-off of q may leave, as of the last step */
    Probe probe;    /* of errors, where that was last worth it */
    Real idle_left; /* idle rotation that all steps may have left, by estimate [rad] */
    Real missed;    /* error in the middle of the last interpolated step, by the way's power that it
                       grows with; of polynomials of that degree */
    Int degree;
    Real between_open; /* closure error of samples in the last interpolated step, at most */
    Real open;      /* residual of equations left out that no other choice makes smaller */
} Path;

/* All that follows from a point that is evaluated and factored, as far as samples near it need it. */
static inline int path_rates(Path *path, Point *point)
{
    const int code = point_rates(path->k, &path->prescribed, point);
    if (code == DONE && path->accuracy.between > 0.0)
        point_bend_angles(path->k, point);
    return code;
}

/* ---- stepping.c ---- */
/* Step to a value of s in the piece in use: DONE, or why not; then nothing has changed, but for what
   is `stale`. */
int step(Path *path, Real target);
/* Evaluate and factor at `here` again, with the current piece of the drivers' laws. */
int stand_again(Path *path);
/* Let the piece that begins at `here` in the sense of a number be in use there. */
int turn_into(Path *path, Real sense);
/* Learn where the determinant vanishes, if that is not known, from a small part of a step h. */
int look_ahead(Path *path, Real h);
Real round_off_of(const Kernel *k, const Real *q); /* closure error that it may leave at q */
void keep_choice(Path *path); /* the equations in use are those at `here` */
int has_redundant(const Kernel *k);
Real distance_ahead(const Path *path, Real h); /* way of s to where the determinant vanishes, or inf */
/* The change of s in which the joints go a way; the longest step towards a value of s that is worth an
   attempt. */
Real step_of(const Path *path, Real way);
Real longest_step(const Path *path, Real target);

/* ---- filling.c ---- */
int factor_at_path_point(Kernel *k); /* where it is evaluated, passive freedoms as they are there */

/* ---- turning_back.c ---- */
/* Turn links about their own axes to where no idle rotation leaves them in a step to `next`. */
int take_idle_back(Path *path, Real way);
/* Whether there is a point before on the way to a value of s, which tells how links turn; the longest way
   there that idle rotations allow. */
int third_tells(const Path *path, Real target);
Real idle_way_to(const Path *path, Real target);

/* ---- estimating.c ---- */
/* See how errors are magnified where the path stands, at its factored point. */
void probe_errors(Path *path);
/* Error estimates (3) of q, t and c, scaled, where the path stands. Returns what of q is not idle
   rotation. */
Real estimate_here(Path *path, Real *estimate);
/* See again how errors are magnified where the path stands, if that may have changed. */
void look_again(Path *path);
/* The same estimates of a sample near by, where t and c have these scaled sizes, and the closure error is
   this one. */
Real estimate_at(Path *path, Real t, Real c, Real error, Real *estimate);
/* The same of samples that are interpolated between a point and the present one, to which one step has
   led, with a third point before them or NULL. Returns their size by the allowed one, and learns from
   it how long the next step may be. */
Real estimate_between(Path *path, const Point *third, const Point *from, Real *estimate);

/* ---- abreast.c ---- */
/* Whether samples between points may be closed side by side; then the lanes take the kernel's numbers. */
int goes_abreast(Path *path);
/* Write rows (n) from i on, at values between a point and the present one, to which one step has led, each
   closed by itself; `between` is their prediction. 0 where one of them does not close at once. The largest
   residual of predictions is `predicted`. */
int close_abreast(Path *path, const Point *from, const Real *values, Int n, const PathRows *rows, Int i,
                  Real *predicted);

/* ---- sampling.c ---- */
/* Go to a value of s by as many steps as the path needs, of equal length where they may be. */
int reach(Path *path, Real target);
void write_row(Path *path, const PathRows *rows, Int i); /* of the current point */
/* Write samples at values (n) of s; returns how many were reached. */
Int follow_values(Path *path, const Real *values, Int n, const PathRows *rows);

#define WITHOUT_THIRD 1e-8 /* error allowed up to which polynomials of fifth degree miss too much */
#define SOONEST 0.06   /* way between points for which one before them is far enough, as far as it stays
                          (stepping.c) */
#define IDLE_FIRST 0.05  /* first way with idle rotations, whose error is not known yet: of 4e-12
                            rad at a way of 0.3, as measured, (1/6)^6 is round-off */

#endif
