/* A kernel made from two flat arrays, one of integers (structure) and one of numbers (geometry,
 * masses). Every index is checked here, so that nothing else has to. The numbers may be exchanged
 * later for those of other dimensions; the structure may not. */
#include <stdlib.h>
#include <string.h>

#include "factors.h"
#include "pins.h"
#include "reading.h"

#ifndef SOURCE_HASH
#define SOURCE_HASH "0123456789abcdef" /* whoever compiles these files says which they are */
#endif
EXPORT extern const char kernel_source_hash[];
const char kernel_source_hash[] = SOURCE_HASH;
#ifndef PROTOTYPES
#define PROTOTYPES /* of what Python calls: likewise, each with a comma behind it */
#endif
EXPORT extern const char *const kernel_prototypes[];
const char *const kernel_prototypes[] = {PROTOTYPES NULL};

/* Of anything counted: products of two counts stay far below 2^63 */
#define MOST_COUNTED 100000000
#define N_COUNTS 14 /* that the arrays begin with */

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
    if (k->n_owned == k->owned_room) {
        if (!widen((void **)&k->owned, 2 * k->owned_room + 64, sizeof *k->owned))
            return 0;
        k->owned_room = 2 * k->owned_room + 64;
    }
    return 1;
}

void *kernel_memory(Kernel *k, Int count, size_t size)
{
    void *memory = has_place(k) ? calloc(count > 0 ? (size_t)count : 1, size) : NULL;
    if (memory)
        k->owned[k->n_owned++] = memory;
    else
        k->lacked_memory = 1;
    return memory;
}

Real *kernel_reals(Kernel *k, Int count) { return kernel_memory(k, count, sizeof(Real)); }

Int *kernel_ints(Kernel *k, Int count) { return kernel_memory(k, count, sizeof(Int)); }

int kernel_had_memory(Kernel *k)
{
    const int lacked = k->lacked_memory;
    k->lacked_memory = 0;
    return !lacked;
}

static int read_structure(Kernel *k, Source from)
{
    const Int *head = read_ints(&from, N_COUNTS);
    if (!head)
        return 0;
    for (int i = 0; i < N_COUNTS; i++)
        if (head[i] < 0 || head[i] > MOST_COUNTED)
            return 0;
    k->n_joints = head[0], k->nq = head[1], k->nv = head[2];
    k->n_vectors = head[3], k->n_products = head[4];
    k->n_closure = head[5], k->n_idle = head[6], k->n_angles = head[7];
    const Int n_support = head[8], n_entries = head[9], n_spins = head[10], np = k->n_products;
    const Int n_terms = head[11];
    k->n_quantities = head[12], k->n_functions = head[13];
    const Int n = k->n_joints, ne = k->n_equations = k->n_closure + k->n_idle;
    k->kind = read_ints(&from, n);
    k->parent = read_ints(&from, n);
    k->iq = read_ints(&from, n);
    k->iv = read_ints(&from, n);
    k->vector_body = read_ints(&from, k->n_vectors);
    k->vector_flag = read_ints(&from, k->n_vectors);
    k->a_term = read_ints(&from, 2 * np);
    k->b_term = read_ints(&from, 2 * np);
    k->x_term = read_ints(&from, np);
    k->support_start = read_ints(&from, np + 1);
    k->support_v = read_ints(&from, n_support);
    k->equation_kind = read_ints(&from, ne);
    k->equation_product = read_ints(&from, ne);
    k->angle_product = read_ints(&from, 2 * k->n_angles);
    k->term_start = read_ints(&from, ne + 1);
    k->factor_start = read_ints(&from, n_terms + 1);
    k->quantity_kind = read_ints(&from, k->n_quantities);
    k->quantity_at = read_ints(&from, 2 * k->n_quantities);
    k->quantity_function = read_ints(&from, k->n_quantities);
    k->function_shape = read_ints(&from, 4 * k->n_functions);
    k->entry_start = read_ints(&from, ne + 1);
    k->entry_v = read_ints(&from, n_entries);
    k->spin_start = read_ints(&from, k->n_angles + 1);
    k->spin_q = read_ints(&from, n_spins);
    return n > 0 && !from.failed && from.n_ints == 0 && k->support_start[np] == n_support &&
           k->entry_start[ne] == n_entries && k->spin_start[k->n_angles] == n_spins &&
           k->term_start[ne] == n_terms && k->factor_start[n_terms] == k->n_quantities;
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

static int spins_are_sound(const Kernel *k)
{
    const Int n = k->spin_start[k->n_angles];
    for (Int i = 0; i < k->n_angles; i++)
        if (k->spin_start[i] > k->spin_start[i + 1])
            return 0;
    for (Int i = 0; i < n; i++)
        if (!within(k->spin_q[i], k->nq))
            return 0;
    return k->spin_start[0] == 0;
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
        {&k->spin_offset, k->n_angles}, {&k->spin_sign, k->spin_start[k->n_angles]},
        {&k->term_number, k->term_start[ne]}, {&k->function_number, piecewise_size(k->function_shape, k->n_functions)},
    };
    const Int n_fields = (Int)(sizeof fields / sizeof *fields);
    Int total = 0;
    for (Int i = 0; i < n_fields; i++)
        total += fields[i].count;
    if (total != n_reals)
        return BAD_ARRAYS;
    Real *copy = k->rotation ? (Real *)k->rotation : kernel_reals(k, total);
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
        {&k->angle_rate, k->n_angles}, {&k->angle_bias, k->n_angles},
        {&k->quantity, k->n_quantities}, {&k->quantity_slope, k->n_quantities},
        {&k->quantity_bend, k->n_quantities}, {&k->quantity_rate, k->n_quantities},
        {&k->quantity_bias, k->n_quantities},
        {&k->entry, k->entry_start[ne]}, {&k->omega, 3 * n}, {&k->velocity, 3 * n},
        {&k->alpha, 3 * n},       {&k->acceleration, 3 * n}, {&k->added, 6 * n}, {&k->bias, ne},
        {&k->product_rate, np},   {&k->product_bias, np},   {&k->vector_rate, 3 * k->n_vectors},
        {&k->vector_bias, 3 * k->n_vectors}, {&k->row, nv}, {&k->right, nv},
    };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        *fields[i].to = kernel_reals(k, fields[i].count);
    k->called = kernel_memory(k, k->n_functions, sizeof *k->called);
    k->plain = kernel_ints(k, n);
    k->moves = kernel_ints(k, n);
    k->chosen = kernel_ints(k, nv);
    k->candidate = kernel_ints(k, nv);
    k->driven = kernel_ints(k, nv);
    k->pin = kernel_memory(k, nv, sizeof(Pin));
    k->pin_row = kernel_ints(k, nv);
    k->pin_entry = kernel_ints(k, nv);
    k->lu = lu_new();
    equations_make_room(k);
    return kernel_had_memory(k) && k->lu;
}

EXPORT int kernel_create(const Int *ints, Int n_ints, const Real *reals, Int n_reals, Kernel **out)
{
    *out = NULL;
    Kernel *k = calloc(1, sizeof *k);
    if (!k)
        return NO_MEMORY;
    const Source from = {.k = k, .ints = ints, .n_ints = n_ints};
    int code = BAD_ARRAYS;
    if (read_structure(k, from) && tree_is_sound(k) && products_are_sound(k) &&
        spins_are_sound(k) && equations_are_sound(k))
        code = make_room(k) ? read_numbers(k, reals, n_reals) : NO_MEMORY;
    if (code == DONE) {
        k->R[0] = k->R[4] = k->R[8] = 1.0; /* the ground */
        equations_begin(k);
        *out = k;
    } else
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

EXPORT void kernel_set_function(Kernel *k, Int i, Called function)
{
    if (within(i, k->n_functions))
        k->called[i] = function;
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
    entries_free(&k->matrix);
    lu_free(k->lu);
    free(k);
}
