/* Springs and dampers between points of two bodies (springs.c), and bushings (bushings.c). */
#ifndef SPATIAL_PIN_SPRINGS_H
#define SPATIAL_PIN_SPRINGS_H

#include "kernel.h"

enum { BUSHING_NUMBERS = 103 };

/* As `_SpringsStruct` in kernel_tree.py. */
typedef struct {
    Int n_lines, n_bushings;
    const Int *line_body, *line_law;       /* law: whether the force is a function */
    const Int *bushing_body, *bushing_law; /* law: 0, or 1 and the component that it is of */
    const Real *line_point, *line_spring;  /* spring: stiffness, damping, free */
    const Real *bushing;                   /* see bushings.c */
    Real *force, *moment; /* (n_joints, 3) that bodies need, about the world origin */
    Int n_coincident;     /* springs between points that coincide */
    Int first_bushing;    /* its number among all springs */
    int (*law)(Int which, Real length, Real rate, Real *force); /* as in dynamics.h; may be NULL */
    Real power;
} Springs;

typedef struct {
    Real length, rate, along[3], end[3];
} Line;

/* A point of a body and its velocity; as all below it needs the rates of the tree. */
void body_point(const Kernel *k, Int j, const Real *local, Real *at, Real *velocity);
/* Spring i between two points. */
Line spring_line(const Kernel *k, const Springs *s, Int i);
/* Force of a spring, numbered among all; adds what it stores, unless the force is a function. DONE, or what
   the law returns. */
int spring_force(Springs *s, Int which, Int has_law, const Real *spring, Real length, Real rate, Real *force);
/* Take the forces of springs from what bodies need; add their power. DONE, or what a law returns. */
int springs_on_bodies(const Kernel *k, Springs *s);
int bushings_on_bodies(const Kernel *k, Springs *s);
/* The energy that bushings store. */
Real bushings_energy(const Kernel *k, const Springs *s);

#endif
