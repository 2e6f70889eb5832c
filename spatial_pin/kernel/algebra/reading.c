/* Flat arrays as they come from Python: sizes are believed only as far as the arrays go. */
#include <string.h>

#include "reading.h"

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
