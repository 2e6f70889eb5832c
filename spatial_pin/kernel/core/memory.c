/* Memory that is freed with a kernel, and flat arrays of Python copied into it: sizes are believed only
 * as far as the arrays go. */
#include <stdlib.h>
#include <string.h>

#include "memory.h"

int widen(void **array, Int n, size_t size)
{
    void *more = realloc(*array, (size_t)(n > 0 ? n : 1) * size);
    if (more)
        *array = more;
    return more != NULL;
}

/* Room for one block of memory more. */
static int has_place(Kernel *k)
{
    if (k->memory.n_blocks == k->memory.room) {
        if (!widen((void **)&k->memory.blocks, 2 * k->memory.room + 64, sizeof *k->memory.blocks))
            return 0;
        k->memory.room = 2 * k->memory.room + 64;
    }
    return 1;
}

void *kernel_memory(Kernel *k, Int count, size_t size)
{
    void *memory = has_place(k) ? calloc(count > 0 ? (size_t)count : 1, size) : NULL;
    if (memory)
        k->memory.blocks[k->memory.n_blocks++] = memory;
    else
        k->memory.was_short = 1;
    return memory;
}

Real *kernel_reals(Kernel *k, Int count) { return kernel_memory(k, count, sizeof(Real)); }

Int *kernel_ints(Kernel *k, Int count) { return kernel_memory(k, count, sizeof(Int)); }

int kernel_had_memory(Kernel *k)
{
    const int lacked = k->memory.was_short;
    k->memory.was_short = 0;
    return !lacked;
}

static void *copy_of(Source *from, const void *at, Int left, Int n, size_t size)
{
    void *copy = n < 0 || n > left ? NULL : kernel_memory(from->k, n, size);
    if (!copy)
        from->failed = 1;
    else if (n) /* else there may be no array */
        memcpy(copy, at, (size_t)n * size);
    return copy;
}

const Int *read_ints(Source *from, Int n)
{
    const Int *copy = copy_of(from, from->ints, from->n_ints, n, sizeof *copy);
    if (copy)
        from->ints += n, from->n_ints -= n;
    return copy;
}

const Real *read_reals(Source *from, Int n)
{
    const Real *copy = copy_of(from, from->reals, from->n_reals, n, sizeof *copy);
    if (copy)
        from->reals += n, from->n_reals -= n;
    return copy;
}
