/* The square system: chosen closure equations, idle rotations, driven freedoms, and rows that fill
 * it up where freedoms are left (passive ones that nothing determines). Unknowns are v / scale. */
#include <stdlib.h>
#include <string.h>

#include "kernel.h"

static int indices_are_sound(const Int *index, Int n, Int below)
{
    for (Int i = 0; i < n; i++)
        if (!within(index[i], below))
            return 0;
    return 1;
}

static int make_room(Kernel *k, Int n)
{
    if (n <= k->system_room)
        return 1;
    struct {
        void **to;
        size_t size;
    } arrays[] = {{(void **)&k->system_row, sizeof(Int)},
                  {(void **)&k->system_column, sizeof(Int)},
                  {(void **)&k->system_from, sizeof(Int)},
                  {(void **)&k->system_value, sizeof(Real)}};
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) {
        void *more = realloc(*arrays[i].to, (size_t)n * arrays[i].size);
        if (!more)
            return 0;
        *arrays[i].to = more;
    }
    k->system_room = n;
    return 1;
}

static void put(Kernel *k, Int row, Int column, Int from, Real value)
{
    const Int e = k->n_system++;
    k->system_row[e] = row;
    k->system_column[e] = column;
    k->system_from[e] = from;
    k->system_value[e] = value;
}

static Int put_equation(Kernel *k, Int row, Int equation)
{
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
        put(k, row, k->entry_v[e], e, 0.0);
    return row + 1;
}

/* Where the entries of the square matrix stand and come from. */
static int lay_out(Kernel *k)
{
    Int row = 0, room = k->entry_start[k->n_equations] - k->entry_start[k->n_closure];
    for (Int i = 0; i < k->n_chosen; i++)
        room += k->entry_start[k->chosen[i] + 1] - k->entry_start[k->chosen[i]];
    if (!make_room(k, room + k->n_driven + k->n_fill * k->nv))
        return NO_MEMORY;
    k->n_system = 0;
    for (Int i = 0; i < k->n_chosen; i++)
        row = put_equation(k, row, k->chosen[i]);
    for (Int i = k->n_closure; i < k->n_equations; i++)
        row = put_equation(k, row, i);
    for (Int i = 0; i < k->n_driven; i++)
        put(k, row++, k->driven[i], -1, 1.0);
    for (Int i = 0; i < k->n_fill; i++, row++)
        for (Int v = 0; v < k->nv; v++)
            if (k->fill[i * k->nv + v] != 0.0)
                put(k, row, v, -1, k->fill[i * k->nv + v]);
    lu_forget(k->lu);
    return DONE;
}

EXPORT int system_set(Kernel *k, const Int *chosen, Int n_chosen, const Int *driven, Int n_driven,
                      const Real *fill, Int n_fill)
{
    if (n_chosen < 0 || n_driven < 0 || n_fill < 0 || n_chosen > k->nv || n_driven > k->nv ||
        n_fill > k->nv || n_chosen + k->n_idle + n_driven + n_fill != k->nv)
        return BAD_ARRAYS;
    if (!indices_are_sound(chosen, n_chosen, k->n_closure) ||
        !indices_are_sound(driven, n_driven, k->nv))
        return BAD_ARRAYS;
    if (n_fill > 0) {
        Real *rows = realloc(k->fill, (size_t)(n_fill * k->nv) * sizeof *rows);
        if (!rows)
            return NO_MEMORY;
        k->fill = rows;
        memcpy(rows, fill, (size_t)(n_fill * k->nv) * sizeof *rows);
    }
    memmove(k->chosen, chosen, (size_t)n_chosen * sizeof *chosen);
    memmove(k->driven, driven, (size_t)n_driven * sizeof *driven);
    k->n_chosen = n_chosen;
    k->n_driven = n_driven;
    k->n_fill = n_fill;
    return lay_out(k);
}

/* Factor with the order there is; choose another where it has become a bad one. */
int system_factor(Kernel *k)
{
    k->factorisations++;
    for (Int e = 0; e < k->n_system; e++)
        if (k->system_from[e] >= 0)
            k->system_value[e] = k->entry[k->system_from[e]];
    for (int attempt = 0; attempt < 2; attempt++) {
        int code = DONE;
        if (attempt || !lu_has_order(k->lu))
            code = lu_analyse(k->lu, k->nv, k->n_system, k->system_row, k->system_column,
                              k->system_value);
        if (code != DONE)
            return code;
        const int factored = lu_factor(k->lu, k->system_value);
        lu_determinant(k->lu, &k->sign, &k->pivot_ratio, &k->mantissa, &k->exponent);
        if (factored > 0 || (factored < 0 && attempt))
            return DONE;
    }
    return SINGULAR;
}

void system_solve(const Kernel *k, Real *x)
{
    lu_solve(k->lu, x, x);
}

#define NOTHING 1e-26 /* square of a length that is round-off of rows of length one */
#define FAINT 1e-34   /* square of an entry, relative to its row's, that is below round-off of it */

/* Rows of the closure equations while independent ones are chosen. A row is zero outside of its
 * columns from `first` to before `end`: loops far from each other cost each other nothing. */
typedef struct {
    Int n, nv;
    Real *row;    /* (n, nv) */
    Real *square; /* of its length; negative once it is chosen */
    Int *first, *end;
    Int n_left, *left; /* rows that may yet be chosen, ascending */
} Choice;

static void measure(Choice *choice, Int i)
{
    const Real *row = choice->row + i * choice->nv;
    choice->square[i] = 0.0;
    for (Int v = choice->first[i]; v < choice->end[i]; v++)
        choice->square[i] += row[v] * row[v];
}

/* Forget what a row has at its ends below round-off: what loops hand on to others fades away. */
static void trim(Choice *choice, Int i)
{
    Real *row = choice->row + i * choice->nv;
    const Real faint = FAINT * choice->square[i];
    Int first = choice->first[i], end = choice->end[i];
    while (first < end && row[first] * row[first] <= faint)
        row[first++] = 0.0;
    while (first < end && row[end - 1] * row[end - 1] <= faint)
        row[--end] = 0.0;
    choice->first[i] = first;
    choice->end[i] = end;
}

static void begin(const Kernel *k, Choice *choice)
{
    for (Int i = 0; i < choice->n; i++) {
        const Int from = k->entry_start[i], to = k->entry_start[i + 1];
        for (Int e = from; e < to; e++)
            choice->row[i * choice->nv + k->entry_v[e]] = k->entry[e];
        choice->first[i] = from < to ? k->entry_v[from] : 0;
        choice->end[i] = from < to ? k->entry_v[to - 1] + 1 : 0;
        measure(choice, i);
        choice->left[choice->n_left++] = i;
    }
}

/* The longest row that is left, -1 if all are round-off; such rows are left no more. */
static Int longest_row(Choice *choice)
{
    Int best = -1, kept = 0;
    Real most = NOTHING;
    for (Int at = 0; at < choice->n_left; at++) {
        const Int i = choice->left[at];
        if (choice->square[i] > NOTHING)
            choice->left[kept++] = i;
        if (choice->square[i] > most) {
            most = choice->square[i];
            best = i;
        }
    }
    choice->n_left = kept;
    return best;
}

/* Take from row i its part along a chosen row, twice for the sake of round-off. */
static void straighten(Choice *choice, Int i, Int chosen, Real square)
{
    const Real *along = choice->row + chosen * choice->nv;
    Real *row = choice->row + i * choice->nv;
    const Int first = choice->first[chosen], end = choice->end[chosen];
    for (int twice = 0; twice < 2; twice++) {
        Real part = 0.0;
        for (Int v = first; v < end; v++)
            part += row[v] * along[v];
        if (part == 0.0)
            break;
        for (Int v = first; v < end; v++)
            row[v] -= part / square * along[v];
        choice->first[i] = first < choice->first[i] ? first : choice->first[i];
        choice->end[i] = end > choice->end[i] ? end : choice->end[i];
        measure(choice, i);
    }
    trim(choice, i);
}

/* Gram-Schmidt, the longest row left first: as many independent ones as are asked for. `left_out`
 * becomes the length of the longest of the others, relative to the longest of all. */
static int choose_rows(Choice *choice, Int wanted, Real *left_out)
{
    Real longest = 0.0;
    for (Int picked = 0; picked < wanted; picked++) {
        const Int best = longest_row(choice);
        if (best < 0)
            return SINGULAR;
        const Real square = choice->square[best];
        longest = fmax(longest, square);
        choice->square[best] = -1.0;
        for (Int at = 0; at < choice->n_left; at++) {
            const Int i = choice->left[at];
            if (i != best && choice->first[i] < choice->end[best] &&
                choice->end[i] > choice->first[best])
                straighten(choice, i, best, square);
        }
    }
    const Int next = longest_row(choice);
    *left_out = next < 0 ? 0.0 : sqrt(choice->square[next] / longest);
    return DONE;
}

int system_reselect(Kernel *k)
{
    const size_t n = (size_t)k->n_closure + 1;
    Choice choice = {.n = k->n_closure, .nv = k->nv};
    choice.row = calloc(n * (size_t)(k->nv + 1), sizeof(Real));
    choice.square = calloc(n, sizeof(Real));
    choice.first = calloc(n, sizeof(Int));
    choice.end = calloc(n, sizeof(Int));
    choice.left = calloc(n, sizeof(Int));
    int code = NO_MEMORY;
    if (choice.row && choice.square && choice.first && choice.end && choice.left) {
        begin(k, &choice);
        code = choose_rows(&choice, k->n_chosen, &k->left_out);
    }
    if (code == DONE) {
        Int count = 0;
        for (Int i = 0; i < k->n_closure; i++)
            if (choice.square[i] < 0.0)
                k->chosen[count++] = i;
        code = lay_out(k);
    }
    free(choice.row);
    free(choice.square);
    free(choice.first);
    free(choice.end);
    free(choice.left);
    return code;
}

void system_path_rates(Kernel *k, Real *first, Real *second)
{
    Real *x = k->right;
    memset(x, 0, (size_t)k->nv * sizeof *x);
    x[k->n_chosen + k->n_idle] = 1.0 / k->scale[k->driven[0]];
    system_solve(k, x);
    for (Int v = 0; v < k->nv; v++)
        first[v] = k->scale[v] * x[v];
    equations_bias(k, first);
    memset(x, 0, (size_t)k->nv * sizeof *x);
    for (Int i = 0; i < k->n_chosen; i++)
        x[i] = -k->bias[k->chosen[i]];
    for (Int i = 0; i < k->n_idle; i++)
        x[k->n_chosen + i] = -k->bias[k->n_closure + i];
    system_solve(k, x);
    for (Int v = 0; v < k->nv; v++)
        second[v] = k->scale[v] * x[v];
}
