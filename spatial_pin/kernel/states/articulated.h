/* Motion, forces and accelerations of a tree, body by body. */
#ifndef SPATIAL_PIN_ARTICULATED_H
#define SPATIAL_PIN_ARTICULATED_H

#include "kernel.h"

typedef struct Tree Tree;

/* See articulated.c. */
EXPORT int tree_create(Kernel *k, const Int *is_core, Tree **out);
EXPORT void tree_forces(Tree *s, const Real *q, const Real *v, const Real *a, const Real *armature,
                        Real *tau, Real *handed_on);
EXPORT int tree_eliminate(Tree *s, const Real *q, const Real *v, const Real *force,
                          const Real *armature, Real *masses, Real *needed);
EXPORT void tree_accelerations(Tree *s, const Real *force, Real *a, Real *scratch, Real *facts);

#endif
