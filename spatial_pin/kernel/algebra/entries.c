/* Entries of a square matrix, see entries.h. */
#include <stdlib.h>

#include "entries.h"
#include "kernel.h"

int entries_begin(Entries *e, Int room)
{
    e->n = 0;
    if (room > e->room || !e->row) {
        if (!widen((void **)&e->row, room, sizeof(Int)) ||
            !widen((void **)&e->column, room, sizeof(Int)) ||
            !widen((void **)&e->value, room, sizeof(Real)))
            return 0;
        e->room = room;
    }
    return 1;
}

void entries_put(Entries *e, Int row, Int column, Real value)
{
    const Int at = e->n++;
    e->row[at] = row;
    e->column[at] = column;
    e->value[at] = value;
}

void entries_free(Entries *e)
{
    free(e->row);
    free(e->column);
    free(e->value);
}
