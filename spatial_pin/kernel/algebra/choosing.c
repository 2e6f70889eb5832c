/* Independent rows by Gram and Schmidt's method, the longest row left first: as Q R of the transpose
 * with column exchanges chooses them [GolubVanLoan2013, 5.2.9, 5.4]. */
#include <float.h>
#include <stdlib.h>

#include "choosing.h"

#define FAINT 1e-34   /* square of an entry, relative to its row's, that is below round-off of it */

/* Rows among which independent ones are chosen. Columns have the order in which rows have them,
 * and a row is zero outside of those from `first` to before `end`: loops far from each other cost
 * each other nothing. */
typedef struct {
    Int n, width;
    Int *index, n_indices; /* of columns, -1 of those that no row has had */
    Real *row;            /* (n, width) */
    Real *square;         /* of its length; negative once it is chosen */
    Int *first, *end;
    Int *remaining, n_remaining;    /* rows that may yet be chosen, ascending */
} Choice;

static void forget(Choice *c)
{
    free(c->row);
    free(c->square);
    free(c->first);
}

/* Rows of zeros; DONE or NO_MEMORY. */
static int begin(Choice *c, Int n, Int width)
{
    const size_t rows = (size_t)n + 1;
    *c = (Choice){.n = n, .width = width};
    c->row = calloc(rows * (size_t)(width + 1), sizeof(Real));
    c->square = calloc(rows, sizeof(Real));
    c->first = calloc(3 * rows + (size_t)width, sizeof(Int));
    if (!c->row || !c->square || !c->first) {
        forget(c);
        return NO_MEMORY;
    }
    c->end = c->first + rows;
    c->remaining = c->end + rows;
    c->index = c->remaining + rows;
    for (Int v = 0; v < width; v++)
        c->index[v] = -1;
    return DONE;
}

static void measure(Choice *c, Int i)
{
    const Real *row = c->row + i * c->width + c->first[i];
    c->square[i] = dot(row, row, c->end[i] - c->first[i]);
}

/* The place of a column, from which on rows may have it. */
static Int index_of(Choice *c, Int column)
{
    if (c->index[column] < 0)
        c->index[column] = c->n_indices++;
    return c->index[column];
}

static void put(Choice *c, Int i, Int column, Real value)
{
    const Int at = index_of(c, column);
    c->first[i] = c->first[i] == c->end[i] || at < c->first[i] ? at : c->first[i];
    c->end[i] = at >= c->end[i] ? at + 1 : c->end[i];
    c->row[i * c->width + at] = value;
}

/* Forget what a row has at its ends below round-off: what loops hand on to others fades away. */
static void trim(Choice *c, Int i)
{
    Real *row = c->row + i * c->width;
    const Real faint = FAINT * c->square[i];
    Int first = c->first[i], end = c->end[i];
    while (first < end && row[first] * row[first] <= faint)
        row[first++] = 0.0;
    while (first < end && row[end - 1] * row[end - 1] <= faint)
        row[--end] = 0.0;
    c->first[i] = first;
    c->end[i] = end;
}

/* The first of the longest rows that are left, -1 if all are round-off; such rows are left no more.
   As long is what differs by no more than half of the digits: in symmetric mechanisms rows are
   equally long, and round-off is to have no say. */
static Int longest_row(Choice *c)
{
    Int n = 0, at = 0;
    Real most = 0.0;
    for (at = 0; at < c->n_remaining; at++) {
        const Int i = c->remaining[at];
        if (c->square[i] > TOLERANCE_ZERO * TOLERANCE_ZERO)
            c->remaining[n++] = i;
        most = fmax(most, c->square[i]);
    }
    c->n_remaining = n;
    for (at = 0; at < n; at++)
        if (c->square[c->remaining[at]] >= most * (1.0 - 2.0 * sqrt(DBL_EPSILON)))
            return c->remaining[at];
    return -1;
}

/* Take from row i its part along a chosen row, twice for the sake of round-off. */
static void straighten(Choice *c, Int i, Int chosen, Real square)
{
    const Real *along = c->row + chosen * c->width;
    Real *row = c->row + i * c->width;
    const Int first = c->first[chosen], end = c->end[chosen];
    for (int twice = 0; twice < 2; twice++) {
        const Real part = dot(row + first, along + first, end - first);
        if (part == 0.0)
            break;
        for (Int v = first; v < end; v++)
            row[v] -= part / square * along[v];
        c->first[i] = first < c->first[i] ? first : c->first[i];
        c->end[i] = end > c->end[i] ? end : c->end[i];
        measure(c, i);
    }
    trim(c, i);
}

static void take(Choice *c, Int chosen)
{
    const Real square = c->square[chosen];
    c->square[chosen] = -1.0;
    for (Int at = 0; at < c->n_remaining; at++) {
        const Int i = c->remaining[at];
        if (c->square[i] >= 0.0 && c->first[i] < c->end[chosen] && c->end[i] > c->first[chosen])
            straighten(c, i, chosen, square);
    }
}

/* Choose rows, `most` of them at most, as long as one is left whose length is more than a part of
   the first one's. Returns how many; `chosen`, ascending, may be `remaining`. facts: (2), or NULL. */
static Int choose(Choice *c, Int most, Real part, Int *chosen, Real *facts)
{
    Int picked = 0, count = 0, next;
    Real longest = 0.0, least = 0.0;
    for (c->n_remaining = 0; c->n_remaining < c->n; c->n_remaining++) {
        c->remaining[c->n_remaining] = c->n_remaining;
        measure(c, c->n_remaining);
    }
    for (;; picked++) {
        next = longest_row(c);
        if (picked == 0 && next >= 0)
            longest = c->square[next];
        if (next < 0 || picked == most || !(c->square[next] > part * part * longest))
            break;
        least = sqrt(c->square[next] / longest);
        take(c, next);
    }
    if (facts)
        facts[0] = least, facts[1] = next < 0 ? 0.0 : sqrt(c->square[next] / longest);
    for (Int i = 0; i < c->n; i++)
        if (c->square[i] < 0.0)
            chosen[count++] = i;
    return count;
}

Int independent_rows(Int n, Int width, const Real *rows, Int most, Real part, Int *chosen,
                     Real *facts)
{
    Choice c;
    if (n < 0 || width < 0 || begin(&c, n, width) != DONE)
        return -1;
    for (Int i = 0; i < n; i++)
        for (Int v = 0; v < width; v++)
            if (rows[i * width + v] != 0.0)
                put(&c, i, v, rows[i * width + v]);
    const Int count = choose(&c, most, part, chosen, facts);
    forget(&c);
    return count;
}

Int independent_equations(const Kernel *k, const Int *among, Int n, Int most, Real part,
                          Int *chosen, Real *facts)
{
    Choice c;
    if (begin(&c, n, k->nv) != DONE)
        return -1;
    for (Int i = 0; i < n; i++) {
        const Int equation = among ? among[i] : i;
        for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
            put(&c, i, k->entry_v[e], k->entry[e]);
    }
    const Int count = choose(&c, most, part, c.remaining, facts);
    for (Int i = 0; i < count; i++)
        chosen[i] = among ? among[c.remaining[i]] : c.remaining[i]; /* both ascend */
    forget(&c);
    return count;
}

Real equation_length(const Kernel *k, Int i)
{
    return norm(k->entry + k->entry_start[i], k->entry_start[i + 1] - k->entry_start[i]);
}
