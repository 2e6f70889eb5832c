/* The stretch about a branch point on which polynomials stand for the branch: bridge.c places on it,
 * bridge_building.c makes one, locating.c finds the branch points on it, crossing.c goes along it. */
#ifndef SPATIAL_PIN_BRIDGE_H
#define SPATIAL_PIN_BRIDGE_H

#include "dynamics.h"

/* Way of the fastest joint from the branch point to the first node: eight nodes either side
   leave its eighth power, and rates there are still regular */
#define FIRST_REACH 0.12
#define AHEAD 0.25  /* way to a branch point at which its place is surely enough known */
#define NEARBY 1e-5 /* way from a zero of order three, known to the third root of round-off, 6e-6 */
#define NODE BRIDGE_NODES

enum { CHOSEN_ANEW = 41 }; /* other equations keep their rank where the chosen ones lost it */

/* The weights of a polynomial through `count` nodes from `first` on, and its values of n numbers. */
void bridge_weights(Bridge *s, Int first, Int count);
void bridge_interpolate(const Bridge *s, Int first, Int count, const Real *rows, Int n, Real x,
                         Real *out);
void bridge_evaluate(Dynamics *d, const Bridge *s, Int turn, Real x); /* d->work.trial, evaluated */
int bridge_repeats(const Dynamics *d); /* whether it may be the same after whole turns */
Int bridge_turns(const Dynamics *d, const Bridge *s, Real x); /* whole ones, to the one nearest x */
Real distance_to_branch_point(const Dynamics *d, Real sense); /* to where equations lose rank ahead */
Real fastest_pace(const Dynamics *d); /* of the fastest joint, per unit of x */

int bridge_locate(Dynamics *d, Bridge *s);
int bridge_build(Dynamics *d, Real ahead);

#endif
