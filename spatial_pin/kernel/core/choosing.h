/* Which rows of a matrix are independent: the one way in which the package chooses them. */
#ifndef SPATIAL_PIN_CHOOSING_H
#define SPATIAL_PIN_CHOOSING_H

#include "kernel.h"

/* Rows among which independent ones are chosen. Columns stand in the order in which rows have them,
 * and a row is zero outside of those from `first` to before `end`: loops far from each other cost
 * each other nothing. */
typedef struct {
    Int n, width;
    Int *place, n_places; /* of columns, -1 of those that no row has had */
    Real *row;            /* (n, width) */
    Real *square;      /* of its length; negative once it is chosen */
    Int *first, *end;
    Int *left, n_left; /* rows that may yet be chosen, ascending */
    Real least;        /* length of the last row chosen, relative to the first one's; 0 if none is */
    Real left_out;     /* of the longest of the others, likewise, less its part along the chosen */
} Choice;

int choice_begin(Choice *c, Int n, Int width); /* rows of zeros; DONE or NO_MEMORY */
void choice_end(Choice *c);
/* Put entries (count) into row i. */
void choice_put(Choice *c, Int i, Int count, const Int *column, const Real *value);
/* Choose rows, `most` of them at most, as long as one is left whose length is more than a part of
   the first one's. Returns how many; `chosen`, ascending. */
Int choice_make(Choice *c, Int most, Real part, Int *chosen);

/* The same of a matrix (n, width) stored by rows; -1 where there is no memory. facts: (2) `least` and
   `left_out`, or NULL. */
EXPORT Int independent_rows(Int n, Int width, const Real *rows, Int most, Real part, Int *chosen,
                            Real *facts);

#endif
