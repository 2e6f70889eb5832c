/* Rows that fill the square system up where freedoms are left that nothing determines. */
#ifndef SPATIAL_PIN_FILLING_H
#define SPATIAL_PIN_FILLING_H

#include "kernel.h"

/* Turn the filled rows to the passive freedoms of the present, factored point that are nearest to
 * them, and factor again. DONE, NO_MEMORY, SINGULAR, or NOT_CONVERGED where these have turned by
 * half a right angle or more. */
int fill_again(Kernel *k);

#endif
