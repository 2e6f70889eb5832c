/* The stretch about a branch point on which polynomials stand for the branch: passage.c places on it,
 * bridging.c makes one, locating.c finds the branch points on it, passing.c goes along it. */
#ifndef SPATIAL_PIN_PASSAGE_H
#define SPATIAL_PIN_PASSAGE_H

#include "dynamics.h"

/* Way of the fastest joint from the branch point to the first node: eight nodes either side
   leave its eighth power, and rates there are still regular */
#define FIRST_REACH 0.12
#define AHEAD 0.25  /* way to a branch point at which its place is surely enough known */
#define NEARBY 1e-5 /* way from a zero of order three, known to the third root of round-off, 6e-6 */
#define NODE PASSAGE_NODES

enum { CHOSEN_ANEW = 41 }; /* other equations keep their rank where the chosen ones lost it */

/* The weights of a polynomial through `count` nodes from `first` on, and its values of n numbers. */
void passage_weights(Passage *s, Int first, Int count);
void passage_interpolate(const Passage *s, Int first, Int count, const Real *rows, Int n, Real x,
                         Real *out);
void passage_place(Dynamics *d, const Passage *s, Int turn, Real x); /* d->work.trial, evaluated */
int passage_repeats(const Dynamics *d); /* whether it may be the same after whole turns */
Int passage_turns(const Dynamics *d, const Passage *s, Real x); /* whole ones, to the one nearest x */
Real passage_distance(const Dynamics *d, Real sense); /* to where equations lose rank ahead */
Real passage_pace(const Dynamics *d); /* of the fastest joint, per unit of x */

int passage_locate(Dynamics *d, Passage *s);
int passage_bridge(Dynamics *d, Real ahead);

#endif
