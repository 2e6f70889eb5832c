/* Whether a closed configuration is regular, where some equations follow from others. */
#ifndef SPATIAL_PIN_REGULAR_H
#define SPATIAL_PIN_REGULAR_H

#include "kernel.h"

/* Whether the equations left out hold a step from q too, in all freedoms: where branches
 * cross, or a freedom is instantaneous only, they open by its square [ConnellyWhiteley1996]. DONE,
 * UNSAFE if they open, or what kept from telling. The system is factored at q, where the closure
 * error is `error`; the kernel is left at `there` (nq), the end of the step. */
int stays_closed(Kernel *k, const Real *q, Real error, Real *there);

#endif
