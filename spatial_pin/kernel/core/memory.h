/* Memory of a kernel, and the flat arrays that it is made of. */
#ifndef SPATIAL_PIN_MEMORY_H
#define SPATIAL_PIN_MEMORY_H

#include "kernel.h"

/* Memory that is freed with k, zeroed; NULL if there is none left. */
void *kernel_memory(Kernel *k, Int count, size_t size);
Real *kernel_reals(Kernel *k, Int count);
Int *kernel_ints(Kernel *k, Int count);
/* Whether all memory was there that was needed since the last call of this. */
int kernel_had_memory(Kernel *k);
/* Give an array room for n things, to be freed by its owner; 0 if there is no memory. */
int widen(void **array, Int n, size_t size);

/* Two flat arrays, read one part after the other into memory of a kernel. */
typedef struct {
    Kernel *k;
    const Int *ints; /* the rest of them, and how many these are */
    Int n_ints;
    const Real *reals;
    Int n_reals;
    int failed; /* whether the arrays were too short, or there is no memory */
} Source;

/* Copies of the next n; NULL if that fails. */
const Int *read_ints(Source *from, Int n);
const Real *read_reals(Source *from, Int n);

#endif
