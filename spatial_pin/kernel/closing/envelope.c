/* J Jᵀ + damping, factored over its envelope: of each row, what lies between its first entry and
 * the diagonal. Rows come in the order of Cuthill and McKee, reversed [GeorgeLiu1981, 4.3]: along
 * a chain of loops the envelope is a band, and the work grows with the number of loops; a few
 * loops have a full envelope, and this is Cholesky's method. */
#include "closing_parts.h"
#include "memory.h"

/* Which rows of J have an entry in each column. */
typedef struct {
    Int *start, *row;
} Columns;

static void transpose(const Envelope *e, Columns *out)
{
    for (Int i = 0; i < e->start[e->n]; i++)
        out->start[e->column[i] + 2]++;
    for (Int v = 0; v < e->nv; v++)
        out->start[v + 2] += out->start[v + 1];
    for (Int r = 0; r < e->n; r++)
        for (Int i = e->start[r]; i < e->start[r + 1]; i++)
            out->row[out->start[e->column[i] + 1]++] = r;
}

/* Append to `order`, from place n on, all rows that hang together with `row`, the nearest first;
   `mark` of rows and columns seen is `round`. Returns the place behind the last. */
static Int spread(Envelope *e, const Columns *c, Int row, Int n, Int *mark, Int round)
{
    Int *const mark_column = mark + e->n;
    Int done = n;
    e->order[n++] = row;
    mark[row] = round;
    for (; done < n; done++)
        for (Int i = e->start[e->order[done]]; i < e->start[e->order[done] + 1]; i++) {
            const Int v = e->column[i];
            if (mark_column[v] == round)
                continue;
            mark_column[v] = round;
            for (Int s = c->start[v]; s < c->start[v + 1]; s++)
                if (mark[c->row[s]] != round) {
                    mark[c->row[s]] = round;
                    e->order[n++] = c->row[s];
                }
        }
    return n;
}

/* Rows level by level, from one of those that are farthest from any other. */
static void choose_order(Envelope *e, const Columns *c, Int *mark)
{
    Int n = 0, round = 0;
    for (Int r = 0; r < e->n; r++) {
        if (mark[r])
            continue;
        Int row = r;
        for (int again = 0; again < 2; again++)
            row = e->order[spread(e, c, row, n, mark, ++round) - 1];
        n = spread(e, c, row, n, mark, ++round);
    }
    for (Int i = 0; i < n / 2; i++) {
        const Int other = e->order[i];
        e->order[i] = e->order[n - 1 - i];
        e->order[n - 1 - i] = other;
    }
}

/* Where each row of the lower half begins; `lowest` is for the first place of each column. */
static int lay_out(Kernel *k, Envelope *e, Int *lowest)
{
    Int entries = 0;
    for (Int v = 0; v < e->nv; v++)
        lowest[v] = e->n;
    for (Int p = 0; p < e->n; p++) {
        const Int row = e->order[p];
        Int first = p;
        for (Int i = e->start[row]; i < e->start[row + 1]; i++) {
            Int *low = lowest + e->column[i];
            *low = *low < p ? *low : p;
            first = *low < first ? *low : first;
        }
        e->first[p] = first;
        e->at[p] = entries;
        entries += p - first + 1;
    }
    e->square = kernel_reals(k, entries);
    e->factor = kernel_reals(k, entries);
    return kernel_had_memory(k) ? DONE : NO_MEMORY;
}

int envelope_create(Kernel *k, Int n, const Int *start, const Int *column, Envelope *e)
{
    e->n = n, e->nv = k->nv, e->start = start, e->column = column;
    e->order = kernel_ints(k, n);
    e->first = kernel_ints(k, n);
    e->at = kernel_ints(k, n);
    e->wide = kernel_reals(k, k->nv);
    e->answer = kernel_reals(k, n);
    Int *mark = kernel_ints(k, n + k->nv);
    Columns c = {kernel_ints(k, k->nv + 2), kernel_ints(k, start[n])};
    if (!kernel_had_memory(k))
        return NO_MEMORY;
    transpose(e, &c);
    choose_order(e, &c, mark);
    return lay_out(k, e, mark);
}

void envelope_square(Envelope *e, const Real *value)
{
    e->largest = 0.0;
    for (Int p = 0; p < e->n; p++) {
        const Int own = e->order[p], begin = e->start[own], end = e->start[own + 1];
        Real *row = e->square + e->at[p] - e->first[p];
        for (Int i = begin; i < end; i++)
            e->wide[e->column[i]] = value[i];
        for (Int s = e->first[p]; s <= p; s++) {
            const Int other = e->order[s];
            Real sum = 0.0;
            for (Int i = e->start[other]; i < e->start[other + 1]; i++)
                sum += value[i] * e->wide[e->column[i]];
            row[s] = sum;
        }
        for (Int i = begin; i < end; i++)
            e->wide[e->column[i]] = 0.0;
        if (row[p] > e->largest)
            e->largest = row[p];
    }
}

int envelope_factor(Envelope *e, Real damping)
{
    for (Int i = 0; i < e->n; i++) {
        const Int first = e->first[i];
        const Real *given = e->square + e->at[i] - first;
        Real *row = e->factor + e->at[i] - first;
        Real pivot = given[i] + damping;
        for (Int j = first; j < i; j++) {
            const Real *above = e->factor + e->at[j] - e->first[j];
            Real sum = given[j];
            for (Int s = e->first[j] > first ? e->first[j] : first; s < j; s++)
                sum -= row[s] * above[s];
            row[j] = sum * above[j];
            pivot -= row[j] * row[j];
        }
        if (!(pivot > 0.0))
            return 0;
        row[i] = 1.0 / sqrt(pivot);
    }
    return 1;
}

void envelope_solve(const Envelope *e, const Real *right, Real *y)
{
    Real *x = e->answer;
    for (Int i = 0; i < e->n; i++) {
        const Real *row = e->factor + e->at[i] - e->first[i];
        Real sum = right[e->order[i]];
        for (Int s = e->first[i]; s < i; s++)
            sum -= row[s] * x[s];
        x[i] = sum * row[i];
    }
    for (Int i = e->n - 1; i >= 0; i--) {
        const Real *row = e->factor + e->at[i] - e->first[i];
        x[i] *= row[i];
        for (Int s = e->first[i]; s < i; s++)
            x[s] -= row[s] * x[i];
        y[e->order[i]] = x[i];
    }
}
