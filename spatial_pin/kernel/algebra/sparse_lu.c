/* L U factors of a sparse matrix whose pattern stays and whose values change.
 *
 * The order of pivots is chosen once, by Markowitz's count of fill-in among entries that are not
 * small in their row [DuffErismanReid1986, 5.3]. The elimination is
 * then a list of multiply-adds in fixed places: nothing is searched when values change. It asks
 * for another order when the pivots have become small, or the multipliers large. */
#include <stdlib.h>
#include <string.h>

#include "memory.h"

/* Of the largest entry of its row that a pivot must have [DuffErismanReid1986, 5.4] */
#define NOT_SMALL 0.1
#define SEARCHED 4       /* rows of the smallest counts looked at for a pivot [Zlatev1980] */
#define GROWN 100.0      /* of a pivot, that an entry of its row may be: 2 digits lost at most in a
                            step; 1 / NOT_SMALL = 10 when the order was chosen */
#define SHRUNK 0.03      /* ratio of pivots relative to that when the order was chosen */

/* Column numbers and values of a row (or row numbers of a column) that grows. */
typedef struct {
    Int n, room;
    Int *at;
    Real *value;  /* NULL: numbers alone */
    int is_alone; /* whether these are its own memory, not parts of a larger block */
} List;

struct SparseLU {
    Int n, n_entries, n_values, chosen;
    Int *position;                         /* of each entry among the values */
    Int *pivot_row, *pivot_column, *pivot_at;
    Int *lower_start, *lower_row, *lower_at; /* multipliers below each pivot */
    Int *upper_start, *upper_column, *upper_at;
    Int *target;                        /* places that the multiply-adds change, in their order */
    Real *value, *inverse, *work;
    Real *marked;                       /* pivots that changes are relative to */
    Int is_marked;
    Real least_change, most_change;
    Real parity, first_ratio;
    Real sign, ratio, mantissa;
    Int exponent;
    void *order, *memory;               /* of the pivots, and of all else */
};

/* ---- entries ---- */

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

/* ---- pattern of the factors ---- */

SparseLU *lu_new(void) { return calloc(1, sizeof(SparseLU)); }

void lu_forget(SparseLU *lu)
{
    lu->chosen = 0;
    lu->least_change = -INFINITY, lu->most_change = INFINITY;
}

int lu_has_order(const SparseLU *lu) { return (int)lu->chosen; }

Real lu_pivot_ratio(const SparseLU *lu) { return lu->ratio; }

void lu_determinant(const SparseLU *lu, Real *sign, Real *mantissa, Int *exponent)
{
    *sign = lu->sign;
    *mantissa = lu->mantissa;
    *exponent = lu->exponent;
}

void lu_mark(SparseLU *lu)
{
    for (Int step = 0; step < lu->n; step++)
        lu->marked[step] = lu->value[lu->pivot_at[step]];
    lu->is_marked = 1;
}

void lu_changes(const SparseLU *lu, Real *least, Real *most)
{
    *least = lu->least_change;
    *most = lu->most_change;
}

static void release(SparseLU *lu)
{
    const Real least = lu->least_change, most = lu->most_change; /* with the order until now */
    free(lu->order);
    free(lu->memory);
    memset(lu, 0, sizeof *lu);
    lu->least_change = least, lu->most_change = most;
}

void lu_free(SparseLU *lu)
{
    if (lu)
        release(lu);
    free(lu);
}

/* ---- choosing the order ---- */

/* The matrix while the order is chosen: rows with values, columns with row numbers, and rows in
 * buckets of equal counts (doubly linked), so that those of the smallest counts are found at once. */
typedef struct {
    Int n;
    List *row, *column; /* of an eliminated column: the rows that its pivot is subtracted from.
                           Behind each other */
    Int *row_done, *column_done, *row_count, *column_count;
    Int *first, *next, *previous; /* buckets */
    void *block;                  /* memory of all, but of lists that have grown */
} Search;

#define LISTS 2  /* row, column */
#define SPARE 4  /* fill-in of a row, or column, for which there is room from the start */
#define ARRAYS 7 /* row_done to previous */

/* Move a list to memory of its own with more room. */
static int grow(List *list, int with_value)
{
    const Int room = 2 * list->room + 4;
    Int *at = malloc((size_t)room * sizeof *at);
    Real *value = with_value ? malloc((size_t)room * sizeof *value) : NULL;
    if (!at || (with_value && !value)) {
        free(at);
        free(value);
        return 0;
    }
    if (list->n)
        memcpy(at, list->at, (size_t)list->n * sizeof *at);
    if (list->n && with_value)
        memcpy(value, list->value, (size_t)list->n * sizeof *value);
    if (list->is_alone) {
        free(list->at);
        free(list->value);
    }
    list->at = at, list->value = value;
    list->room = room;
    list->is_alone = 1;
    return 1;
}

static int push(List *list, Int at, Real value, int with_value)
{
    if (list->n == list->room && !grow(list, with_value))
        return 0;
    if (with_value)
        list->value[list->n] = value;
    list->at[list->n++] = at;
    return 1;
}

static void search_free(Search *s)
{
    for (Int i = 0; s->row && i < LISTS * s->n; i++)
        if (s->row[i].is_alone) {
            free(s->row[i].at);
            free(s->row[i].value);
        }
    free(s->row);
    free(s->block);
}

static void bucket_add(Search *s, Int row)
{
    const Int count = s->row_count[row];
    s->previous[row] = -1;
    s->next[row] = s->first[count];
    if (s->first[count] >= 0)
        s->previous[s->first[count]] = row;
    s->first[count] = row;
}

static void bucket_remove(Search *s, Int row)
{
    if (s->previous[row] >= 0)
        s->next[s->previous[row]] = s->next[row];
    else
        s->first[s->row_count[row]] = s->next[row];
    if (s->next[row] >= 0)
        s->previous[s->next[row]] = s->previous[row];
}

static int search_begin(Search *s, Int n, const Entries *of)
{
    const size_t size = (size_t)n + 1, entries = (size_t)(of->n + SPARE * n);
    s->n = n;
    s->row = calloc(LISTS * size, sizeof *s->row);
    s->block = malloc(entries * sizeof(Real) + (ARRAYS * size + 2 * entries) * sizeof(Int));
    if (!s->row || !s->block)
        return 0;
    s->column = s->row + n;
    Real *values = s->block;
    Int *numbers = (Int *)(values + entries);
    Int **arrays[ARRAYS] = {&s->row_done, &s->column_done, &s->row_count, &s->column_count,
                            &s->first,    &s->next,        &s->previous};
    for (int i = 0; i < ARRAYS; i++, numbers += size)
        *arrays[i] = numbers;
    memset(s->row_done, 0, 2 * size * sizeof(Int)); /* and column_done */
    for (Int e = 0; e < of->n; e++) {
        s->row[of->row[e]].room++;
        s->column[of->column[e]].room++;
    }
    for (Int i = 0; i < 2 * n; i++) { /* rows, then columns */
        s->row[i].room += SPARE;
        s->row[i].at = numbers;
        numbers += s->row[i].room;
        if (i < n) {
            s->row[i].value = values;
            values += s->row[i].room;
        }
    }
    for (Int e = 0; e < of->n; e++)
        if (!push(s->row + of->row[e], of->column[e], of->value[e], 1) ||
            !push(s->column + of->column[e], of->row[e], 0.0, 0))
            return 0;
    for (Int i = 0; i <= n; i++)
        s->first[i] = -1;
    for (Int i = 0; i < n; i++) {
        s->column_count[i] = s->column[i].n;
        s->row_count[i] = s->row[i].n;
        bucket_add(s, i);
    }
    return 1;
}

/* The best pivot of a row so far: least Markowitz count, then largest value. */
static void look_at_row(const Search *s, Int i, Int *best_row, Int *best_entry, Int *best_cost,
                        Real *best_size)
{
    const List *row = s->row + i;
    Real most = 0.0;
    for (Int e = 0; e < row->n; e++)
        if (!s->column_done[row->at[e]] && fabs(row->value[e]) > most)
            most = fabs(row->value[e]);
    for (Int e = 0; e < row->n; e++) {
        const Real size = fabs(row->value[e]);
        if (s->column_done[row->at[e]] || !(size >= NOT_SMALL * most) || !(size > 0.0))
            continue;
        const Int cost = (s->row_count[i] - 1) * (s->column_count[row->at[e]] - 1);
        if (*best_row < 0 || cost < *best_cost || (cost == *best_cost && size > *best_size)) {
            *best_row = i;
            *best_entry = e;
            *best_cost = cost;
            *best_size = size;
        }
    }
}

/* Choose a pivot; 0 if no row has any entry left. */
static int choose(const Search *s, Int *row, Int *entry)
{
    Int cost = 0, seen = 0;
    Real size = 0.0;
    *row = -1;
    for (Int count = 1; count <= s->n && seen < SEARCHED; count++)
        for (Int i = s->first[count]; i >= 0 && seen < SEARCHED; i = s->next[i]) {
            look_at_row(s, i, row, entry, &cost, &size);
            if (*row >= 0 && cost == 0)
                return 1;
            seen += *row >= 0;
        }
    return *row >= 0;
}

/* Subtract the pivot's row from another one; new entries are added to the pattern. */
static int eliminate(Search *s, Int pivot, Real pivot_value, Int column, Int i)
{
    List *row = s->row + i;
    const List *from = s->row + pivot;
    Int at = 0;
    while (row->at[at] != column)
        at++;
    const Real factor = row->value[at] /= pivot_value;
    for (Int u = 0; u < from->n; u++) {
        const Int c = from->at[u];
        if (s->column_done[c])
            continue;
        Int e = 0;
        while (e < row->n && row->at[e] != c)
            e++;
        if (e < row->n)
            row->value[e] -= factor * from->value[u];
        else {
            if (!push(row, c, -factor * from->value[u], 1) || !push(s->column + c, i, 0.0, 0))
                return 0;
            s->row_count[i]++;
            s->column_count[c]++;
        }
    }
    return 1;
}

/* Eliminate step by step; the order is left in pivot_row, pivot_column. 1, 0 singular, -1 memory */
static int search(Search *s, Int *pivot_row, Int *pivot_column)
{
    for (Int step = 0; step < s->n; step++) {
        Int r, e;
        if (!choose(s, &r, &e))
            return 0;
        const Int c = s->row[r].at[e];
        const Real value = s->row[r].value[e];
        bucket_remove(s, r);
        pivot_row[step] = r;
        pivot_column[step] = c;
        s->row_done[r] = s->column_done[c] = 1;
        for (Int u = 0; u < s->row[r].n; u++)
            if (!s->column_done[s->row[r].at[u]])
                s->column_count[s->row[r].at[u]]--;
        Int below = 0;
        for (Int l = 0; l < s->column[c].n; l++) {
            const Int i = s->column[c].at[l];
            if (s->row_done[i])
                continue;
            bucket_remove(s, i);
            s->row_count[i]--;
            s->column[c].at[below++] = i;
            if (!eliminate(s, r, value, c, i))
                return -1;
            bucket_add(s, i);
        }
        s->column[c].n = below;
    }
    return 1;
}

/* ---- the list of multiply-adds ---- */

static Int position_of(const Search *s, const Int *offset, Int row, Int column)
{
    Int e = 0;
    while (s->row[row].at[e] != column)
        e++;
    return offset[row] + e;
}

static int allocate(SparseLU *lu, Int n_lower, Int n_upper, Int n_targets)
{
    const size_t n = (size_t)lu->n + 1;
    struct {
        Real **to;
        size_t count;
    } reals[] = {{&lu->value, (size_t)lu->n_values + 1}, {&lu->inverse, n}, {&lu->work, n},
                 {&lu->marked, n}};
    struct {
        Int **to;
        size_t count;
    } ints[] = {
        {&lu->pivot_at, n},      {&lu->lower_start, n},           {&lu->upper_start, n},
        {&lu->lower_row, (size_t)n_lower + 1},   {&lu->lower_at, (size_t)n_lower + 1},
        {&lu->upper_column, (size_t)n_upper + 1}, {&lu->upper_at, (size_t)n_upper + 1},
        {&lu->target, (size_t)n_targets + 1}, {&lu->position, (size_t)lu->n_entries + 1},
    };
    size_t n_reals = 0, n_ints = 0;
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        n_reals += reals[i].count;
    for (size_t i = 0; i < sizeof ints / sizeof *ints; i++)
        n_ints += ints[i].count;
    Real *real = lu->memory = calloc(1, n_reals * sizeof(Real) + n_ints * sizeof(Int));
    if (!real)
        return 0;
    for (size_t i = 0; i < sizeof reals / sizeof *reals; real += reals[i++].count)
        *reals[i].to = real;
    Int *number = (Int *)real;
    for (size_t i = 0; i < sizeof ints / sizeof *ints; number += ints[i++].count)
        *ints[i].to = number;
    return 1;
}

/* Sign of the permutation that takes the pivots to the diagonal. */
static Real parity_of(const SparseLU *lu, Int *to, Int *seen)
{
    Real parity = 1.0;
    for (Int i = 0; i < lu->n; i++) {
        to[lu->pivot_row[i]] = lu->pivot_column[i];
        seen[i] = 0;
    }
    for (Int i = 0; i < lu->n; i++) {
        Int length = 0;
        for (Int j = i; !seen[j]; j = to[j]) {
            seen[j] = 1;
            length++;
        }
        if (length > 0 && length % 2 == 0)
            parity = -parity;
    }
    return parity;
}

static int count_steps(SparseLU *lu, const Search *s, const Int *when)
{
    Int n_lower = 0, n_upper = 0, n_targets = 0;
    for (Int step = 0; step < lu->n; step++) {
        const List *row = s->row + lu->pivot_row[step];
        Int later = 0;
        for (Int e = 0; e < row->n; e++)
            later += when[row->at[e]] > step;
        const Int below = s->column[lu->pivot_column[step]].n;
        n_lower += below;
        n_upper += later;
        n_targets += later * below;
    }
    return allocate(lu, n_lower, n_upper, n_targets);
}

static void write_steps(SparseLU *lu, const Search *s, const Int *when, const Int *offset)
{
    Int lower = 0, upper = 0, target = 0;
    for (Int step = 0; step < lu->n; step++) {
        const Int r = lu->pivot_row[step], c = lu->pivot_column[step];
        const List *row = s->row + r, *below = s->column + c;
        lu->pivot_at[step] = position_of(s, offset, r, c);
        lu->lower_start[step] = lower;
        lu->upper_start[step] = upper;
        for (Int e = 0; e < row->n; e++)
            if (when[row->at[e]] > step) {
                lu->upper_column[upper] = row->at[e];
                lu->upper_at[upper++] = offset[r] + e;
            }
        for (Int l = 0; l < below->n; l++) {
            lu->lower_row[lower] = below->at[l];
            lu->lower_at[lower++] = position_of(s, offset, below->at[l], c);
            for (Int u = lu->upper_start[step]; u < upper; u++)
                lu->target[target++] = position_of(s, offset, below->at[l], lu->upper_column[u]);
        }
    }
    lu->lower_start[lu->n] = lower;
    lu->upper_start[lu->n] = upper;
}

/* Places of all entries, fill-in included, and the list of steps. */
static int record(SparseLU *lu, const Search *s, const Entries *of)
{
    const size_t n = (size_t)lu->n + 1;
    Int *offset = calloc(3 * n, sizeof *offset);
    int good = offset != NULL;
    if (good) {
        Int *when = offset + n, *to = when + n;
        for (Int i = 0; i < lu->n; i++) {
            offset[i + 1] = offset[i] + s->row[i].n;
            when[lu->pivot_column[i]] = i;
        }
        lu->n_values = offset[lu->n];
        good = count_steps(lu, s, when);
        if (good) {
            write_steps(lu, s, when, offset);
            for (Int e = 0; e < of->n; e++)
                lu->position[e] = position_of(s, offset, of->row[e], of->column[e]);
            lu->parity = parity_of(lu, to, when);
        }
    }
    free(offset);
    return good;
}

int lu_analyse(SparseLU *lu, Int n, const Entries *of)
{
    Search s = {0};
    release(lu);
    lu->n = n;
    lu->n_entries = of->n;
    lu->pivot_row = lu->order = calloc(2 * ((size_t)n + 1), sizeof(Int));
    int code = NO_MEMORY;
    if (lu->order && search_begin(&s, n, of)) {
        lu->pivot_column = lu->pivot_row + n;
        const int outcome = search(&s, lu->pivot_row, lu->pivot_column);
        if (outcome == 0)
            code = SINGULAR;
        else if (outcome > 0 && record(lu, &s, of))
            code = DONE;
    }
    search_free(&s);
    lu->chosen = code == DONE;
    lu->first_ratio = 0.0;
    return code;
}

/* ---- numbers ---- */

Real lu_even_ratio(const SparseLU *lu, const Real *length)
{
    Real least = INFINITY, most = 0.0;
    for (Int step = 0; step < lu->n; step++) {
        const Real size = fabs(lu->value[lu->pivot_at[step]]) / length[lu->pivot_row[step]];
        least = fmin(least, size);
        most = fmax(most, size);
    }
    return lu->n ? least / most : 1.0;
}

/* Keep the determinant's size as mantissa * 2^exponent, far from overflow. */
static void multiply_determinant(SparseLU *lu, Real size)
{
    lu->mantissa *= size;
    if (lu->mantissa < 1e-100 || lu->mantissa > 1e100) {
        int exponent;
        lu->mantissa = frexp(lu->mantissa, &exponent);
        lu->exponent += exponent;
    }
}

/* How the pivots have changed since they were marked. */
static void note_changes(SparseLU *lu)
{
    if (!lu->is_marked)
        return;
    lu->least_change = INFINITY, lu->most_change = -INFINITY;
    for (Int step = 0; step < lu->n; step++) {
        const Real change = 1.0 - lu->marked[step] * lu->inverse[step];
        lu->least_change = smaller_of(lu->least_change, change);
        lu->most_change = larger_of(lu->most_change, change);
    }
}

#include "elimination.h"

int lu_factor(SparseLU *lu, const Real *entry)
{
    const Real grown = find_factors(lu, entry, lu->value, lu->inverse);
    Real least = INFINITY, most = 0.0;
    lu->sign = lu->parity;
    lu->mantissa = 1.0;
    lu->exponent = 0;
    for (Int step = 0; step < lu->n; step++) {
        const Real pivot = lu->value[lu->pivot_at[step]], size = fabs(pivot);
        if (!(size > 0.0) || !isfinite(size)) {
            lu->sign = lu->ratio = 0.0;
            lu->least_change = -INFINITY, lu->most_change = INFINITY;
            return 0;
        }
        if (pivot < 0.0)
            lu->sign = -lu->sign;
        least = smaller_of(least, size);
        most = larger_of(most, size);
        multiply_determinant(lu, size);
    }
    note_changes(lu);
    lu->ratio = lu->n ? least / most : 1.0;
    if (lu->first_ratio == 0.0)
        lu->first_ratio = lu->ratio;
    return grown < GROWN * GROWN && lu->ratio > SHRUNK * lu->first_ratio ? 1 : -1;
}

void lu_solve(const SparseLU *lu, Real *x) { substitute(lu, lu->value, lu->inverse, lu->work, x); }

/* ---- several matrices side by side ---- */

void lane_factors_free(LaneFactors *f)
{
    free(f->value);
    free(f->inverse);
    free(f->work);
}

static int make_room(LaneFactors *f, Int room)
{
    if (room > f->room) {
        if (!widen((void **)&f->value, room, sizeof *f->value) ||
            !widen((void **)&f->inverse, room, sizeof *f->inverse) ||
            !widen((void **)&f->work, room, sizeof *f->work))
            return 0;
        f->room = room;
    }
    return 1;
}

#include "side_by_side.h"
#define find_factors lanes_find_factors
#define substitute lanes_substitute
#include "elimination.h"

FOR_WIDE int lu_factor_lanes(const SparseLU *lu, const Lane *entry, LaneFactors *f)
{
    const Real shrunk = SHRUNK * lu->first_ratio;
    Lane least = SPREAD(-INFINITY), most = {0}; /* squares of pivots, the least with its sign changed */
    LaneMask signs = {0};
    if (!make_room(f, lu->n_values > lu->n ? lu->n_values : lu->n))
        return 0;
    const Lane grown = find_factors(lu, entry, f->value, f->inverse);
    for (Int step = 0; step < lu->n; step++) {
        const Lane pivot = f->value[lu->pivot_at[step]], square = pivot * pivot;
        least = larger_number(least, -square);
        most = larger_number(most, square);
        signs ^= (LaneMask)pivot;
    }
    for (int l = 0; l < LANES; l++)
        if (!(grown[l] < GROWN * GROWN) || !(-least[l] > shrunk * shrunk * most[l]) ||
            (signs[l] < 0 ? -lu->parity : lu->parity) != lu->sign)
            return 0;
    return 1;
}

FOR_WIDE void lu_solve_lanes(const SparseLU *lu, const LaneFactors *f, Lane *x)
{
    substitute(lu, f->value, f->inverse, f->work, x);
}
