/* Two flat arrays, read one part after the other into memory of a kernel. */
#ifndef SPATIAL_PIN_READING_H
#define SPATIAL_PIN_READING_H

#include "kernel.h"

typedef struct {
    Kernel *k;
    const Int *ints; /* what is left of them, and how many these are */
    Int n_ints;
    const Real *reals;
    Int n_reals;
    int failed; /* whether more was asked for than there was, or there is no memory */
} Source;

/* Copies of the next n; NULL if that fails. */
const Int *read_ints(Source *from, Int n);
const Real *read_reals(Source *from, Int n);

#endif
