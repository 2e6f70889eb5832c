/* A kernel made from two flat arrays, one of integers (structure) and one of numbers (geometry,
 * masses). Every index is checked here, so that nothing else has to. The numbers may be exchanged
 * later for those of other dimensions; the structure may not. */
#include <stdlib.h>
#include <string.h>

#include "factors.h"
#include "pins.h"

#ifndef SOURCE_HASH
#define SOURCE_HASH "0123456789abcdef" /* whoever compiles these files says which they are */
#endif
EXPORT extern const char kernel_source_hash[];
const char kernel_source_hash[] = SOURCE_HASH;

/* Of anything counted: products of two counts stay far below 2^63 */
#define MOST_COUNTED 100000000

void *kernel_memory(Kernel *k, Int count, size_t size)
{
    if (k->n_owned == k->owned_room) {
        const Int room = 2 * k->owned_room + 64;
        void **more = realloc(k->owned, (size_t)room * sizeof *more);
        if (!more)
            return NULL;
        k->owned = more;
        k->owned_room = room;
    }
    void *memory = calloc(count > 0 ? (size_t)count : 1, size);
    if (memory)
        k->owned[k->n_owned++] = memory;
    return memory;
}

/* What is left of an array to be read. */
typedef struct {
    const Int *at;
    Int left;
} Ints;

/* Copy the next n integers into memory of the kernel; NULL when there are not as many. */
static const Int *take_ints(Kernel *k, Ints *from, Int n)
{
    if (n < 0 || n > from->left)
        return NULL;
    Int *copy = kernel_memory(k, n, sizeof *copy);
    if (copy && n)
        memcpy(copy, from->at, (size_t)n * sizeof *copy);
    from->at += n;
    from->left -= n;
    return copy;
}

static int read_structure(Kernel *k, Ints from)
{
    const Int *head = take_ints(k, &from, 10);
    if (!head)
        return 0;
    for (int i = 0; i < 10; i++)
        if (head[i] < 0 || head[i] > MOST_COUNTED)
            return 0;
    k->n_joints = head[0], k->nq = head[1], k->nv = head[2];
    k->n_vectors = head[3], k->n_products = head[4];
    k->n_closure = head[5], k->n_idle = head[6], k->n_angles = head[7];
    const Int n_support = head[8], n_entries = head[9], np = k->n_products;
    const Int n = k->n_joints, ne = k->n_equations = k->n_closure + k->n_idle;
    int good = n > 0;
    good = good && (k->kind = take_ints(k, &from, n));
    good = good && (k->parent = take_ints(k, &from, n));
    good = good && (k->iq = take_ints(k, &from, n));
    good = good && (k->iv = take_ints(k, &from, n));
    good = good && (k->vector_body = take_ints(k, &from, k->n_vectors));
    good = good && (k->vector_flag = take_ints(k, &from, k->n_vectors));
    good = good && (k->a_term = take_ints(k, &from, 2 * np));
    good = good && (k->b_term = take_ints(k, &from, 2 * np));
    good = good && (k->x_term = take_ints(k, &from, np));
    good = good && (k->support_start = take_ints(k, &from, np + 1));
    good = good && (k->support_v = take_ints(k, &from, n_support));
    good = good && (k->equation_kind = take_ints(k, &from, ne));
    good = good && (k->equation_int = take_ints(k, &from, 4 * ne));
    good = good && (k->entry_start = take_ints(k, &from, ne + 1));
    good = good && (k->entry_v = take_ints(k, &from, n_entries));
    return good && from.left == 0 && k->support_start[np] == n_support &&
           k->entry_start[ne] == n_entries;
}

/* Whether every freedom and every entry of q belongs to exactly one joint, parents come first. */
static int tree_is_sound(Kernel *k)
{
    Int nq = 0, nv = 0;
    if (k->kind[0] != 0 || k->parent[0] != 0)
        return 0;
    for (Int j = 1; j < k->n_joints; j++) {
        if (k->kind[j] < TURN || k->kind[j] > FREE || !within(k->parent[j], j))
            return 0;
        if (k->iq[j] != nq || k->iv[j] != nv)
            return 0; /* joints hold their entries in the order of the joints */
        nq += joint_nq(k->kind[j]);
        nv += joint_nv(k->kind[j]);
    }
    return nq == k->nq && nv == k->nv;
}

/* Whether rows of a pattern start one after the other and their columns ascend below nv. */
static int pattern_is_sound(const Int *start, Int rows, const Int *column, Int nv)
{
    if (start[0] != 0)
        return 0;
    for (Int r = 0; r < rows; r++) {
        if (start[r + 1] < start[r] || start[r + 1] > start[rows])
            return 0;
        for (Int i = start[r]; i < start[r + 1]; i++)
            if (!within(column[i], nv) || (i > start[r] && column[i] <= column[i - 1]))
                return 0;
    }
    return 1;
}

static int terms_are_sound(const Int *term, Int n, Int n_vectors)
{
    for (Int i = 0; i < n; i++)
        if (term[i] < -1 || term[i] >= n_vectors)
            return 0;
    return 1;
}

static int products_are_sound(const Kernel *k)
{
    for (Int i = 0; i < k->n_vectors; i++)
        if (!within(k->vector_body[i], k->n_joints) || !within(k->vector_flag[i], 2))
            return 0;
    return terms_are_sound(k->a_term, 2 * k->n_products, k->n_vectors) &&
           terms_are_sound(k->b_term, 2 * k->n_products, k->n_vectors) &&
           terms_are_sound(k->x_term, k->n_products, k->n_vectors) &&
           pattern_is_sound(k->support_start, k->n_products, k->support_v, k->nv) &&
           pattern_is_sound(k->entry_start, k->n_equations, k->entry_v, k->nv);
}

/* Reads all numbers; the kernel's own copy is what its pointers show. Returns a code. */
static int read_numbers(Kernel *k, const Real *reals, Int n_reals)
{
    const Int n = k->n_joints, np = k->n_products, ne = k->n_equations;
    struct {
        const Real **to;
        Int count;
    } fields[] = {
        {&k->rotation, 9 * n},       {&k->translation, 3 * n}, {&k->pitch, n},
        {&k->mass, n},               {&k->com, 3 * n},         {&k->inertia, 9 * n},
        {&k->gravity, 3},            {&k->scale, k->nv},       {&k->vector_local, 3 * k->n_vectors},
        {&k->a_factor, 2 * np},      {&k->b_factor, 2 * np},   {&k->x_factor, np},
        {&k->constant, np},          {&k->force, np},          {&k->support_sign, k->support_start[np]},
        {&k->equation_real, 3 * ne},
    };
    const Int n_fields = (Int)(sizeof fields / sizeof *fields);
    Int total = 0;
    for (Int i = 0; i < n_fields; i++)
        total += fields[i].count;
    if (total != n_reals)
        return BAD_ARRAYS;
    Real *copy = k->rotation ? (Real *)k->rotation : kernel_memory(k, total, sizeof *copy);
    if (!copy)
        return NO_MEMORY;
    memcpy(copy, reals, (size_t)total * sizeof *copy);
    for (Int i = 0; i < n_fields; copy += fields[i++].count)
        *fields[i].to = copy;
    k->is_placed = 0;
    for (Int j = 0; j < n; j++) {
        const Real *R = k->rotation + 9 * j;
        k->plain[j] = R[0] == 1.0 && R[4] == 1.0 && R[8] == 1.0 && R[1] == 0.0 && R[2] == 0.0 &&
                      R[3] == 0.0 && R[5] == 0.0 && R[6] == 0.0 && R[7] == 0.0;
    }
    return DONE;
}

/* Memory for what evaluations write. */
static int make_room(Kernel *k)
{
    const Int n = k->n_joints, nv = k->nv, np = k->n_products, ne = k->n_equations;
    struct {
        Real **to;
        Int count;
    } fields[] = {
        {&k->q, k->nq},           {&k->R, 9 * n},           {&k->p, 3 * n},
        {&k->linear, 3 * nv},     {&k->angular, 3 * nv},    {&k->vector, 3 * k->n_vectors},
        {&k->A, 3 * np},          {&k->B, 3 * np},          {&k->value, np},
        {&k->residual, k->n_closure}, {&k->angle, k->n_angles}, {&k->angle_reference, k->n_angles},
        {&k->angle_rate, k->n_angles},
        {&k->entry, k->entry_start[ne]}, {&k->omega, 3 * n}, {&k->velocity, 3 * n},
        {&k->alpha, 3 * n},       {&k->acceleration, 3 * n}, {&k->added, 6 * n}, {&k->bias, ne},
        {&k->product_rate, np},   {&k->product_bias, np},   {&k->vector_rate, 3 * k->n_vectors},
        {&k->vector_bias, 3 * k->n_vectors}, {&k->row, nv}, {&k->right, nv},
    };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        if (!(*fields[i].to = kernel_memory(k, fields[i].count, sizeof(Real))))
            return 0;
    k->chosen = kernel_memory(k, nv, sizeof(Int));
    k->candidate = kernel_memory(k, nv, sizeof(Int));
    k->driven = kernel_memory(k, nv, sizeof(Int));
    k->pin = kernel_memory(k, nv, sizeof(Pin));
    k->pin_row = kernel_memory(k, nv, sizeof(Int));
    k->pin_entry = kernel_memory(k, nv, sizeof(Int));
    k->lu = lu_new();
    k->R[0] = k->R[4] = k->R[8] = 1.0; /* the ground */
    equations_place_ground(k);
    return equations_begin(k) && k->chosen && k->candidate && k->driven && k->pin && k->pin_row && k->pin_entry && k->lu;
}

EXPORT int kernel_create(const Int *ints, Int n_ints, const Real *reals, Int n_reals, Kernel **out)
{
    *out = NULL;
    Kernel *k = calloc(1, sizeof *k);
    if (!k)
        return NO_MEMORY;
    const Ints from = {ints, n_ints};
    int code = BAD_ARRAYS;
    if (read_structure(k, from) && tree_is_sound(k) && products_are_sound(k) &&
        equations_are_sound(k)) {
        k->plain = kernel_memory(k, k->n_joints, sizeof(Int));
        k->moves = kernel_memory(k, k->n_joints, sizeof(Int));
        code = k->plain && k->moves ? read_numbers(k, reals, n_reals) : NO_MEMORY;
        if (code == DONE && !make_room(k))
            code = NO_MEMORY;
    }
    if (code == DONE)
        *out = k;
    else
        kernel_destroy(k);
    return code;
}

/* Take the numbers of other dimensions; the kernel is as if it had been made of them. */
EXPORT int kernel_set_numbers(Kernel *k, const Real *reals, Int n_reals)
{
    lu_forget(k->lu);
    const int code = read_numbers(k, reals, n_reals);
    if (code == DONE)
        equations_place_ground(k);
    return code;
}

EXPORT void kernel_destroy(Kernel *k)
{
    if (!k)
        return;
    for (Int i = 0; i < k->n_owned; i++)
        free(k->owned[i]);
    for (Int i = 0; i < k->n_factors; i++)
        factors_free(k->factors[i]);
    free(k->owned);
    free(k->factors);
    free(k->fill);
    free(k->system_row);
    free(k->system_column);
    free(k->system_from);
    free(k->system_value);
    lu_free(k->lu);
    free(k);
}
