/* Rotations that closures ask for, where their frames are turned far against each other. */
#ifndef SPATIAL_PIN_FAR_ROTATIONS_H
#define SPATIAL_PIN_FAR_ROTATIONS_H

#include "kernel.h"

typedef struct {
    Int n;                  /* closures */
    const Int *first, *axes; /* their first equation of directions, and whether 1 or 3 axes agree */
} Rotations;

int rotations_are_sound(const Kernel *k, const Rotations *rotations);
int rotations_are_far(const Kernel *k, const Rotations *rotations); /* after equations_values */
int rotations_are_mirrored(const Kernel *k, const Rotations *rotations);         /* likewise */
void rotations_put_values(Kernel *k, const Rotations *rotations);   /* likewise */
void rotations_put_entries(Kernel *k, const Rotations *rotations);  /* after equations_jacobian */

#endif
