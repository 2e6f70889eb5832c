/* A square matrix given by its entries, in any order, each place at most once. */
#ifndef SPATIAL_PIN_ENTRIES_H
#define SPATIAL_PIN_ENTRIES_H

#include "vectors.h"

typedef struct {
    Int n, room;       /* how many there are, and how many there may be */
    Int *row, *column;
    Real *value;
} Entries;

int entries_begin(Entries *e, Int room); /* none, and room; 0 if there is no memory */
void entries_put(Entries *e, Int row, Int column, Real value);
void entries_free(Entries *e);

#endif
