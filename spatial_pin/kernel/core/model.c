/* A kernel made from two flat arrays, one of integers (structure) and one of numbers (geometry,
 * masses). Every index is checked here, so that nothing else has to. The numbers may be exchanged
 * later for those of other dimensions; the structure may not. */
#include <stdlib.h>
#include <string.h>

#include "factors.h"
#include "lanes.h"
#include "memory.h"
#include "pins.h"

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
#define N_COUNTS 16 /* that the arrays begin with */

static int read_structure(Kernel *k, Source from)
{
    const Int *head = read_ints(&from, N_COUNTS);
    if (!head)
        return 0;
    for (int i = 0; i < N_COUNTS; i++)
        if (head[i] < 0 || head[i] > MOST_COUNTED)
            return 0;
    k->n_joints = head[0], k->nq = head[1], k->nv = head[2];
    k->vectors.n = head[3], k->products.n = head[4];
    k->n_closure = head[5], k->n_idle = head[6], k->n_angles = head[7];
    const Int n_support = head[8], n_entries = head[9], n_spins = head[10], np = k->products.n;
    const Int n_terms = head[11];
    k->quantities.n = head[12], k->quantities.n_functions = head[13];
    k->implicit.n = head[14], k->implicit.n_sums = head[15];
    const Int n = k->n_joints, ne = k->n_equations = k->n_closure + k->n_idle;
    const Int n_sums = ne + k->implicit.n_sums;
    k->kind = read_ints(&from, n);
    k->parent = read_ints(&from, n);
    k->iq = read_ints(&from, n);
    k->iv = read_ints(&from, n);
    k->vectors.body = read_ints(&from, k->vectors.n);
    k->vectors.flag = read_ints(&from, k->vectors.n);
    k->products.a_term = read_ints(&from, 2 * np);
    k->products.b_term = read_ints(&from, 2 * np);
    k->products.x_term = read_ints(&from, np);
    k->products.support_start = read_ints(&from, np + 1);
    k->products.support_v = read_ints(&from, n_support);
    k->equations.kind = read_ints(&from, ne);
    k->equations.product = read_ints(&from, ne);
    k->angles.product = read_ints(&from, 2 * k->n_angles);
    k->implicit.at = read_ints(&from, 4 * k->implicit.n);
    k->equations.term_start = read_ints(&from, n_sums + 1);
    k->equations.factor_start = read_ints(&from, n_terms + 1);
    k->quantities.kind = read_ints(&from, k->quantities.n);
    k->quantities.at = read_ints(&from, 2 * k->quantities.n);
    k->quantities.function = read_ints(&from, k->quantities.n);
    k->quantities.shape = read_ints(&from, 4 * k->quantities.n_functions);
    k->entry_start = read_ints(&from, ne + 1);
    k->entry_v = read_ints(&from, n_entries);
    k->angles.spin_start = read_ints(&from, k->n_angles + 1);
    k->angles.spin_q = read_ints(&from, n_spins);
    return n > 0 && !from.failed && from.n_ints == 0 && k->products.support_start[np] == n_support &&
           k->entry_start[ne] == n_entries && k->angles.spin_start[k->n_angles] == n_spins &&
           k->equations.term_start[n_sums] == n_terms &&
           k->equations.factor_start[n_terms] == k->quantities.n;
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
    const Int n = k->angles.spin_start[k->n_angles];
    for (Int i = 0; i < k->n_angles; i++)
        if (k->angles.spin_start[i] > k->angles.spin_start[i + 1])
            return 0;
    for (Int i = 0; i < n; i++)
        if (!within(k->angles.spin_q[i], k->nq))
            return 0;
    return k->angles.spin_start[0] == 0;
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
    for (Int i = 0; i < k->vectors.n; i++)
        if (!within(k->vectors.body[i], k->n_joints) || !within(k->vectors.flag[i], 2))
            return 0;
    return terms_are_sound(k->products.a_term, 2 * k->products.n, k->vectors.n) &&
           terms_are_sound(k->products.b_term, 2 * k->products.n, k->vectors.n) &&
           terms_are_sound(k->products.x_term, k->products.n, k->vectors.n) &&
           pattern_is_sound(k->products.support_start, k->products.n, k->products.support_v, k->nv) &&
           pattern_is_sound(k->entry_start, k->n_equations, k->entry_v, k->nv);
}

/* Reads all numbers; the kernel's own copy is what its pointers show. Returns a code. */
static int read_numbers(Kernel *k, const Real *reals, Int n_reals)
{
    const Int n = k->n_joints, np = k->products.n, ne = k->n_equations;
    struct {
        const Real **to;
        Int count;
    } fields[] = {
        {&k->rotation, 9 * n}, {&k->translation, 3 * n}, {&k->pitch, n},
        {&k->bodies.mass, n}, {&k->bodies.com, 3 * n}, {&k->bodies.inertia, 9 * n},
        {&k->bodies.gravity, 3}, {&k->scale, k->nv}, {&k->vectors.local, 3 * k->vectors.n},
        {&k->products.a_factor, 2 * np}, {&k->products.b_factor, 2 * np},
        {&k->products.x_factor, np}, {&k->products.constant, np}, {&k->products.force, np},
        {&k->products.support_sign, k->products.support_start[np]},
        {&k->angles.spin_offset, k->n_angles},
        {&k->angles.spin_sign, k->angles.spin_start[k->n_angles]},
        {&k->implicit.span, 4 * k->implicit.n},
        {&k->equations.term_number, k->equations.term_start[ne + k->implicit.n_sums]},
        {&k->quantities.number, piecewise_size(k->quantities.shape, k->quantities.n_functions)},
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
    return DONE;
}

/* What follows from numbers: joints whose fixed rotation is the identity, and that no function has
   been evaluated. */
static void take_numbers(Kernel *k)
{
    for (Int f = 0; f < k->quantities.n_functions; f++)
        k->quantities.last[4 * f] = NAN;
    for (Int j = 0; j < k->n_joints; j++) {
        const Real *R = k->rotation + 9 * j;
        k->plain[j] = R[0] == 1.0 && R[4] == 1.0 && R[8] == 1.0 && R[1] == 0.0 && R[2] == 0.0 &&
                      R[3] == 0.0 && R[5] == 0.0 && R[6] == 0.0 && R[7] == 0.0;
    }
}

#include "evaluated.h"

/* Memory for what evaluations write, and for the square system. */
static int make_room(Kernel *k)
{
    const Int n = k->n_joints, nv = k->nv, n_functions = k->quantities.n_functions;
    make_room_of(k, k);
    k->added = kernel_reals(k, 6 * n);
    k->implicit.inverse = kernel_reals(k, 4 * k->implicit.n);
    k->quantities.called = kernel_memory(k, n_functions, sizeof *k->quantities.called);
    k->quantities.piece = kernel_ints(k, n_functions);
    k->plain = kernel_ints(k, n);
    k->system.chosen = kernel_ints(k, nv);
    k->system.candidate = kernel_ints(k, nv);
    k->system.driven = kernel_ints(k, nv);
    k->system.pin = kernel_memory(k, nv, sizeof(Pin));
    k->system.pin_row = kernel_ints(k, nv);
    k->system.pin_entry = kernel_ints(k, nv);
    k->system.lu = lu_new();
    k->implicit.is_angle = kernel_memory(k, k->n_angles, 1);
    equations_make_room(k);
    return kernel_had_memory(k) && k->system.lu;
}

EXPORT int kernel_create(const Int *ints, Int n_ints, const Real *reals, Int n_reals,
                         const Called *called, Int n_called, Kernel **out)
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
        for (Int i = 0; i < n_called && i < k->quantities.n_functions; i++)
            k->quantities.called[i] = called[i];
        k->R[0] = k->R[4] = k->R[8] = 1.0; /* the ground */
        take_numbers(k);
        for (Int i = 0; i < k->implicit.n; i++)
            for (Int x = 0; x < k->implicit.at[4 * i + 1]; x++)
                k->implicit.is_angle[k->implicit.at[4 * i] + x] = 1;
        equations_begin(k);
        *out = k;
    } else
        kernel_destroy(k);
    return code;
}

int kernel_vary_numbers(Kernel *k, const Real *base, Int n_reals, const Int *varied_index,
                        const Real *varied, Int n_varied)
{
    lu_forget(k->system.lu);
    const int code = read_numbers(k, base, n_reals);
    Real *own = (Real *)k->rotation; /* the first of them */
    for (Int i = 0; code == DONE && i < n_varied; i++)
        if (varied_index[i] < n_reals)
            own[varied_index[i]] = varied[i];
    if (code == DONE) {
        take_numbers(k);
        equations_place_ground(k);
    }
    return code;
}

EXPORT int kernel_set_numbers(Kernel *k, const Real *reals, Int n_reals)
{
    return kernel_vary_numbers(k, reals, n_reals, NULL, NULL, 0);
}

EXPORT void kernel_destroy(Kernel *k)
{
    if (!k)
        return;
    if (k->memory.lanes)
        lane_factors_free(&k->memory.lanes->factors);
    for (Int i = 0; i < k->memory.n_blocks; i++)
        free(k->memory.blocks[i]);
    for (Int i = 0; i < k->memory.n_factors; i++)
        factors_free(k->memory.factors[i]);
    free(k->memory.blocks);
    free(k->memory.factors);
    free(k->system.fill);
    entries_free(&k->system.matrix);
    lu_free(k->system.lu);
    free(k);
}
