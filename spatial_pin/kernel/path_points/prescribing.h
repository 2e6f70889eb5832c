/* Prescribed coordinates of a path: their values as functions of the path's parameter.
 *
 * As a rule the parameter s is the value of the first driver, and the others are held. Or the
 * values are piecewise polynomials of s, as of a table that splines go through. */
#ifndef SPATIAL_PIN_PRESCRIBING_H
#define SPATIAL_PIN_PRESCRIBING_H

#include "pins.h"

typedef struct {
    Int n;                      /* as many as are driven */
    Int *q_index;                 /* entry of q; -1 of components, and of entries of v that have none */
    Int n_pins, *pinned;        /* components, those of one rotation side by side: which they are */
    Pin *pin;
    Int n_pieces, degree;       /* of the polynomials; no pieces: see above */
    const Real *breaks, *coefficient; /* (n_pieces + 1); (n_pieces, n, degree + 1) of s less the break
                                   before, from the constant one on */
    Int piece;                  /* the one in use */
    Real *value, *rate, *bend;  /* (n) at the last `prescribe`, with derivatives by s */
    Real *pin_value;
    Int n_still, *still;        /* entries of q of rotations, and of positions in space, that are held */
    Real *still_value;
} Prescribed;

int prescribed_create(Kernel *k, Prescribed *p); /* DONE, NO_MEMORY */

/* Let it be what the system drives, by polynomials if there are pieces; what is held without having a
 * value of its own stands as at q. DONE; BAD_ARRAYS where nothing with a value is driven first, breaks
 * do not rise, numbers are not finite, or a coordinate without value is to move. */
int prescribed_read(const Kernel *k, Prescribed *p, const Real *q, Int n_pieces, Int degree,
                    const Real *breaks, const Real *coefficient);

/* Values that are held, and the parameter, are those at q. */
Real prescribed_from(Prescribed *p, const Real *q);

/* Values and derivatives at s, by the piece in use. */
void prescribe(Prescribed *p, Real s);

/* Write the prescribed values to q. */
void prescribed_put(Prescribed *p, Real *q);

/* What value number i is short of in q. */
Real prescribed_gap(const Prescribed *p, const Real *q, Int i);

/* Whether components have their values in q: a rotation vector about no axis of its own has none
 * that are longer than half a turn. */
int prescribed_holds(const Prescribed *p, const Real *q);

/* The piece on the way from s, in the sense of a number; where s is a break it begins there. */
Int piece_ahead(const Prescribed *p, Real s, Real sense);

/* How far one may go from s to a target by that piece: to the target, or to its end. */
Real piece_end(const Prescribed *p, Real s, Real target);

#endif
