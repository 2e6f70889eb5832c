/* The KKT system of a mechanism at one configuration,
 *
 *     [M  Jᵀ] [a      ]   [f - b ]
 *     [J  0 ] [-lambda] = [-gamma],
 *
 * with independent closure equations J. The mass matrix M and the joint forces f - b are given: they
 * are Pinocchio's. Unknowns and equations are scaled so that each freedom's own inertia is one, and
 * the largest entry of each equation (Jacobi scaling): light bodies keep their digits next to heavy
 * ones.
 *
 * Equations and pivots are chosen anew in each call, so that answers depend on nothing
 * else. */
#include <float.h>
#include <string.h>

#include "choosing.h"
#include "dense.h"
#include "factors.h"
#include "memory.h"
#include "tree_bodies.h"

#define ROUNDING (128.0 * DBL_EPSILON) /* of an entry, with all that is added to it */
#define PLACED (8.0 * DBL_EPSILON) /* of a place, by its distance: some joints, each rounded once */
/* Smallest over largest pivot above which equations that are independent in each closure by itself
   surely are so together: the pivot of one that is off the others by d is of the order of d². */
#define SURE TOLERANCE_HALF_PRECISION
#define LEAST_ERROR (16.0 * DBL_EPSILON) /* of accelerations: their forces are rounded a few times */

enum { BLOCK = 16 }; /* right sides that are solved for at once */

typedef struct {
    Kernel *k;
    Int n_groups, n_mass;
    const Int *group; /* (n_groups + 1) first equation of each closure */
    const Int *mass_row, *mass_column, *mass_from; /* (n_mass) entries of M, and where they come from */
    Int n_chosen;
    Int *chosen;      /* (n_chosen) independent closure equations, ascending */
    Real *unit;       /* (nv) velocity, by scale, at which the own inertia of a freedom is one */
    Real *size;       /* (n_closure) of each chosen equation, where it was chosen */
    Factors *matrix;
    Real length;      /* characteristic */
    Real shortest;    /* largest entry of the chosen equation whose own is the smallest */
    Real *x;          /* (nv + n_chosen, BLOCK) */
    Real *block;      /* to choose among the equations of a closure */
    Int *column;       /* the same: columns of it */
    Int n_given;
    Real *mass, *core; /* (n_given) entries of M; (nv) joint forces of the core */
    Real *scratch;     /* (5 nv) */
    Factors *rates;    /* with idle rotations: equations, actuators and idle rotations, by rows */
    Real *spin, *weight; /* (n_idle, nv) motions of idle rotations, and joint forces per unit of each */
    Real *gram, *pace;   /* (n_idle, n_idle) their inertia; (n_idle) accelerations */
    Real *moved;         /* (n_joints, 6) accelerations of the bodies */
    Real *changed;       /* (3 nv, nv + n_closure) changes of joint forces and equations; NULL at first */
} Kkt;

static Int most_in_a_group(const Kkt *s)
{
    Int most = 0;
    for (Int g = 0; g < s->n_groups; g++) {
        const Int n = s->group[g + 1] - s->group[g];
        most = n > most ? n : most;
    }
    return most;
}

static int make_room(Kkt *s)
{
    Kernel *k = s->k;
    const Int nv = k->nv, nc = k->n_closure, n = nv + (nc < nv ? nc : nv);
    s->chosen = kernel_ints(k, nc);
    s->unit = kernel_reals(k, nv);
    s->size = kernel_reals(k, nc);
    s->x = kernel_reals(k, BLOCK * n);
    s->block = kernel_reals(k, most_in_a_group(s) * nv);
    s->column = kernel_ints(k, nv);
    s->mass = kernel_reals(k, s->n_given);
    s->core = kernel_reals(k, nv);
    s->scratch = kernel_reals(k, 5 * nv);
    s->matrix = factors_new(k);
    s->rates = factors_new(k);
    s->spin = kernel_reals(k, k->n_idle * nv);
    s->weight = kernel_reals(k, k->n_idle * nv);
    s->gram = kernel_reals(k, k->n_idle * k->n_idle);
    s->pace = kernel_reals(k, k->n_idle);
    s->moved = kernel_reals(k, 6 * k->n_joints);
    if (!kernel_had_memory(k) || !s->matrix || !s->rates)
        return NO_MEMORY;
    for (Int v = 0; v < nv; v++)
        s->column[v] = -1;
    return DONE;
}

static int is_sound(const Kkt *s)
{
    const Kernel *k = s->k;
    if (s->group[0] != 0 || s->group[s->n_groups] != k->n_closure)
        return 0;
    for (Int g = 0; g < s->n_groups; g++)
        if (s->group[g + 1] < s->group[g] || s->group[g + 1] > k->n_closure)
            return 0;
    for (Int e = 0; e < s->n_mass; e++)
        if (!within(s->mass_row[e], k->nv) || !within(s->mass_column[e], k->nv) ||
            !within(s->mass_from[e], s->n_given))
            return 0;
    return 1;
}

static int take(Kkt *s, const Int *ints)
{
    Source from = {.k = s->k, .ints = ints, .n_ints = s->n_groups + 1 + 3 * s->n_mass};
    s->group = read_ints(&from, s->n_groups + 1);
    s->mass_row = read_ints(&from, s->n_mass);
    s->mass_column = read_ints(&from, s->n_mass);
    s->mass_from = read_ints(&from, s->n_mass);
    if (from.failed)
        return NO_MEMORY;
    return is_sound(s) ? make_room(s) : BAD_ARRAYS;
}

/* Memory for the KKT system of a kernel of a characteristic length, freed with the kernel. The ints
   are the first equation of each of n_groups closures and their number, then rows, columns and
   places of the n_mass entries of M among the n_given. */
EXPORT int kkt_create(Kernel *k, const Int *ints, Int n_groups, Int n_mass, Int n_given,
                      Real length, Kkt **out)
{
    *out = NULL;
    if (n_groups < 0 || n_mass < 0 || n_given < 0)
        return BAD_ARRAYS;
    Kkt *s = kernel_memory(k, 1, sizeof *s);
    if (!s)
        return NO_MEMORY;
    s->k = k, s->length = length, s->n_groups = n_groups, s->n_mass = n_mass;
    s->n_given = n_given;
    const int code = take(s, ints);
    if (code == DONE)
        *out = s;
    return code;
}

/* ---------------------------------------------------------------- choice of equations */

/* Independent equations of one closure, among all of its own that are longer than `least`. */
static int choose_in_closure(Kkt *s, Int first, Int end, Real least)
{
    const Kernel *k = s->k;
    const Int n = end - first, from = k->entry_start[first], to = k->entry_start[end];
    Int m = 0;
    for (Int e = from; e < to; e++)
        if (s->column[k->entry_v[e]] < 0)
            s->column[k->entry_v[e]] = m++;
    memset(s->block, 0, (size_t)(m * n) * sizeof(Real));
    for (Int i = first; i < end; i++)
        if (equation_length(k, i) > least)
            for (Int e = k->entry_start[i]; e < k->entry_start[i + 1]; e++)
                s->block[(i - first) * m + s->column[k->entry_v[e]]] = k->entry[e];
    for (Int e = from; e < to; e++)
        s->column[k->entry_v[e]] = -1;
    const Int rank = independent_rows(n, m, s->block, n, TOLERANCE_RANK,
                                      s->chosen + s->n_chosen, NULL);
    if (rank < 0)
        return NO_MEMORY;
    for (Int i = 0; i < rank; i++)
        s->chosen[s->n_chosen++] += first;
    return DONE;
}

/* Length of an equation below which it says nothing: what round-off leaves of one that vanishes is
   not to be scaled up. */
static Real nothing_said(const Kkt *s)
{
    Real longest = 0.0;
    for (Int i = 0; i < s->k->n_closure; i++)
        longest = fmax(longest, equation_length(s->k, i));
    return fmax(TOLERANCE_RANK * longest, TOLERANCE_ZERO);
}

static int choose_all(Kkt *s)
{
    const Real least = nothing_said(s);
    s->n_chosen = 0;
    for (Int i = 0; i < s->k->n_closure; i++)
        if (equation_length(s->k, i) > least)
            s->chosen[s->n_chosen++] = i;
    return DONE;
}

static int choose_in_closures(Kkt *s)
{
    const Real least = nothing_said(s);
    int code = DONE;
    s->n_chosen = 0;
    for (Int g = 0; g < s->n_groups && code == DONE; g++)
        code = choose_in_closure(s, s->group[g], s->group[g + 1], least);
    return code;
}

/* Independent equations among the chosen ones. */
static int choose_among_all(Kkt *s)
{
    const Int rank = independent_equations(s->k, s->chosen, s->n_chosen, s->n_chosen,
                                            TOLERANCE_RANK, s->chosen, NULL);
    if (rank < 0)
        return NO_MEMORY;
    s->n_chosen = rank;
    return DONE;
}

/* ---------------------------------------------------------------- the matrix */

/* Units of the freedoms, the heaviest one's for those without inertia. */
static void measure_freedoms(Kkt *s, const Real *mass)
{
    const Kernel *k = s->k;
    Real heaviest = 0.0;
    memset(s->unit, 0, (size_t)k->nv * sizeof(Real));
    for (Int e = 0; e < s->n_mass; e++)
        if (s->mass_row[e] == s->mass_column[e]) {
            const Int v = s->mass_row[e];
            s->unit[v] = mass[s->mass_from[e]] * k->scale[v] * k->scale[v];
            heaviest = fmax(heaviest, s->unit[v]);
        }
    if (!(heaviest > 0.0))
        heaviest = 1.0;
    for (Int v = 0; v < k->nv; v++)
        s->unit[v] = 1.0 / sqrt(s->unit[v] > 0.0 ? s->unit[v] : heaviest);
}

static void measure_equations(Kkt *s)
{
    const Kernel *k = s->k;
    s->shortest = 1.0;
    for (Int i = 0; i < s->n_chosen; i++) {
        Real most = 0.0, entry = 0.0;
        for (Int e = k->entry_start[s->chosen[i]]; e < k->entry_start[s->chosen[i] + 1]; e++) {
            most = fmax(most, fabs(k->entry[e]) * s->unit[k->entry_v[e]]);
            entry = fmax(entry, fabs(k->entry[e]));
        }
        s->size[i] = most > 0.0 ? most : 1.0;
        s->shortest = fmin(s->shortest, entry);
    }
}

/* Factor the matrix for the chosen equations. */
static int factor(Kkt *s, const Real *mass)
{
    const Kernel *k = s->k;
    Entries *to = &s->matrix->entries;
    if (!entries_begin(to, s->n_mass + 2 * k->entry_start[k->n_closure]))
        return NO_MEMORY;
    for (Int e = 0; e < s->n_mass; e++) {
        const Int i = s->mass_row[e], j = s->mass_column[e];
        const Real weight = k->scale[i] * s->unit[i] * (k->scale[j] * s->unit[j]);
        entries_put(to, i, j, mass[s->mass_from[e]] * weight);
    }
    for (Int i = 0; i < s->n_chosen; i++)
        for (Int e = k->entry_start[s->chosen[i]]; e < k->entry_start[s->chosen[i] + 1]; e++) {
            const Int v = k->entry_v[e];
            const Real value = k->entry[e] * s->unit[v] / s->size[i];
            entries_put(to, k->nv + i, v, value);
            entries_put(to, v, k->nv + i, value);
        }
    return factors_make(s->matrix, k->nv + s->n_chosen);
}

/* The largest sum of the sizes in a row: the matrix is symmetric. */
static Real matrix_norm(Kkt *s)
{
    const Entries *of = &s->matrix->entries;
    Real most = 0.0;
    memset(s->x, 0, (size_t)s->matrix->n * sizeof(Real));
    for (Int e = 0; e < of->n; e++)
        s->x[of->row[e]] += fabs(of->value[e]);
    for (Int i = 0; i < s->matrix->n; i++)
        most = fmax(most, s->x[i]);
    return most;
}

/* Choose independent equations and factor: all if they are that, then those of each closure by itself,
   then, in doubt, those of all together. */
static int choose_and_factor(Kkt *s, const Real *mass)
{
    int (*const ways[])(Kkt *) = {choose_all, choose_in_closures, choose_among_all};
    measure_freedoms(s, mass);
    s->matrix->pivot = 0.0;
    for (int way = 0; way < 3; way++) {
        const Int before = s->n_chosen;
        int code = ways[way](s);
        if (code == DONE && s->n_chosen <= s->k->nv && (!way || s->n_chosen != before)) {
            measure_equations(s);
            code = factor(s, mass);
        }
        if (code != DONE || s->matrix->pivot > SURE)
            return code;
    }
    return DONE;
}

/* ---------------------------------------------------------------- solutions */

/* Accelerations (n, nv) and multipliers (n, n_closure), 0 of equations that are not chosen, for n
   joint forces f - b (n, nv), BLOCK at most, and second derivatives (n, n_closure) of the equations
   at zero acceleration. */
static void solve(Kkt *s, Int n, const Real *force, const Real *gamma, Real *a, Real *multipliers)
{
    const Kernel *k = s->k;
    const Int nv = k->nv, nc = k->n_closure;
    Real *x = s->x;
    for (Int v = 0; v < nv; v++)
        for (Int c = 0; c < n; c++)
            x[v * n + c] = k->scale[v] * s->unit[v] * force[c * nv + v];
    for (Int i = 0; i < s->n_chosen; i++)
        for (Int c = 0; c < n; c++)
            x[(nv + i) * n + c] = -gamma[c * nc + s->chosen[i]] / s->size[i];
    factors_solve(s->matrix, n, x);
    for (Int v = 0; v < nv; v++)
        for (Int c = 0; c < n; c++)
            a[c * nv + v] = k->scale[v] * s->unit[v] * x[v * n + c];
    memset(multipliers, 0, (size_t)(n * nc) * sizeof(Real));
    for (Int i = 0; i < s->n_chosen; i++)
        for (Int c = 0; c < n; c++)
            multipliers[c * nc + s->chosen[i]] = -x[(nv + i) * n + c] / s->size[i];
}

/* How far off equations are, by the size of the shortest: their entries are differences of places,
   which are rounded by their distance from the world's origin, [characteristic lengths]. */
static Real entry_error(const Kkt *s)
{
    const Kernel *k = s->k;
    Real farthest = 0.0;
    if (!s->n_chosen)
        return 0.0;
    for (Int i = 0; i < 3 * k->n_joints; i++)
        farthest = fmax(farthest, fabs(k->p[i]));
    return PLACED * (1.0 + farthest / s->length) / fmax(s->shortest, DBL_EPSILON);
}

/* Estimated round-off of accelerations, by their size: from the pivots and, for exchanges of rows
   may hide how small they are, from the condition; in the own units of freedoms, where light
   ones have larger ones. After `solve`, which left the scaled solution in x: that is lost here. */
static Real estimated_error(Kkt *s)
{
    const Int nv = s->k->nv;
    const Int n = s->matrix->n;
    const Real pivot = s->matrix->pivot;
    Real error = ROUNDING / fmax(pivot, DBL_EPSILON), size = 0.0, largest = 0.0, most = 0.0;
    if (!n || !(pivot > 0.0))
        return error;
    for (Int v = 0; v < nv; v++) {
        size = fmax(size, s->unit[v] * fabs(s->x[v]));
        largest = fmax(largest, s->unit[v]);
        most = fmax(most, fabs(s->x[v]));
    }
    error = fmax(error, entry_error(s));
    const Real condition = matrix_norm(s) * factors_inverse_norm(s->matrix);
    error = fmax(error, (Real)n * DBL_EPSILON * fmin(condition, 1.0 / DBL_EPSILON));
    return size > 0.0 ? error * largest * most / size : error;
}

/* Joint forces (nv) of multipliers. */
static void forces_of(const Kernel *k, const Real *multipliers, Real *force)
{
    memset(force, 0, (size_t)k->nv * sizeof(Real));
    for (Int i = 0; i < k->n_closure; i++)
        if (multipliers[i] != 0.0)
            for (Int e = k->entry_start[i]; e < k->entry_start[i + 1]; e++)
                force[k->entry_v[e]] += multipliers[i] * k->entry[e];
    for (Int v = 0; v < k->nv; v++)
        force[v] /= k->scale[v];
}

/* ---------------------------------------------------------------- a tree with loops

   Joints that no loop is built on are eliminated before; the remaining tree, the core, has a KKT system as
   if its bodies had the inertias of all that they carry. */

/* Accelerations under joint forces, and what they follow from: as `_KktTask` in kkt.py. */
typedef struct {
    Int n;                 /* configurations */
    Tree *tree;            /* whose masses they are; NULL: of one configuration, masses are given */
    const Real *q, *v;     /* (n, nq), (n, nv) */
    const Real *reference; /* (n, n_angles) from which angles of screws count */
    const Real *mass;      /* entries of M; not with a tree */
    const Real *force;     /* (n, nv) f, and f - b where masses are given */
    const Real *armature;  /* (nv) of the tree */
    const Real *rounding;  /* (nv) by which part of it each joint force of the tree may be off */
    Int n_actuated;
    const Int *actuated;   /* (n_actuated) freedoms whose efforts are looked for, accelerations being
                              given; NULL: accelerations are looked for */
    Real *efforts;         /* (n, n_actuated) */
    Real *a, *closures;    /* (n, nv) accelerations; joint forces of the closures */
    Real *multipliers;     /* (n, n_closure), 0 of equations that are not chosen */
    Real *entry;           /* of the last: entries of J of all equations, for v / scale, row by row */
    Int *chosen;           /* (n, n_closure) the chosen ones, first in each row */
    Real *facts;           /* (n, 6) smallest over largest pivot; estimated error of the KKT system's
                              accelerations, how many equations are chosen; estimated error of all, or
                              of efforts;
                              whether round-off of the joint forces is most of that; whether there are
                              no results: a freedom of the limbs has no inertia, or it is not clear
                              that closures and actuators together bear any force in one way */
    Tree *single;          /* where derivatives are wanted, every equation being a product: of single
                              joints, relative to the centre, */
    const TreeTask *changes; /* its products, and room for what they give at one configuration */
    const Real *slopes;    /* (n, 2, nv) derivatives of joint forces by their own q and v; NULL: none */
    Real *a_by, *multipliers_by; /* (n, 3 nv, nv), (n, 3 nv, n_closure) a row for each entry of q, of v,
                              and of the efforts */
} KktTask;
enum { PIVOT, OF_CORE, RANK, OF_ALL, OF_FORCES, FAILED, FACTS };

/* Evaluate at q, choose equations, factor and solve, for joint forces f - b. */
static int solve_core(Kkt *s, const KktTask *task, Int i, const Real *mass, const Real *force)
{
    Kernel *k = s->k;
    Real *multipliers = task->multipliers + i * k->n_closure, *facts = task->facts + FACTS * i;
    equations_values_near(k, task->q + i * k->nq, task->reference + i * k->n_angles);
    equations_jacobian(k, &k->equations.all);
    const int code = choose_and_factor(s, mass);
    if (code != DONE)
        return code;
    equations_bias(k, &k->equations.all, task->v + i * k->nv);
    solve(s, 1, force, k->equations.bias, task->a + i * k->nv, multipliers);
    forces_of(k, multipliers, task->closures + i * k->nv);
    facts[PIVOT] = s->matrix->pivot;
    facts[OF_CORE] = facts[OF_ALL] = estimated_error(s);
    facts[RANK] = (Real)s->n_chosen;
    return DONE;
}

/* Joint forces f - b of the core, after tree_masses; the masses of all other freedoms are made the
   heaviest one's, for they have no part in the system. Returns how many freedoms are the core's. */
static Int put_core(Kkt *s, const Tree *tree, const Real *force)
{
    const Kernel *k = tree->k;
    Real heaviest = 0.0;
    Int n = 0;
    for (Int j = 1; j < k->n_joints; j++)
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
            s->core[v] = tree->is_core[j] ? force[v] - s->core[v] : 0.0;
            s->column[v] = tree->is_core[j] ? 1 : 0;
            n += tree->is_core[j] ? 1 : 0;
        }
    for (int others = 0; others < 2; others++)
        for (Int e = 0; e < s->n_mass; e++) {
            const Int v = s->mass_row[e];
            const Real square = k->scale[v] * k->scale[v];
            if (v != s->mass_column[e] || s->column[v] == others)
                continue;
            if (others)
                s->mass[s->mass_from[e]] = (heaviest > 0.0 ? heaviest : 1.0) / square;
            else
                heaviest = fmax(heaviest, s->mass[s->mass_from[e]] * square);
        }
    for (Int v = 0; v < k->nv; v++)
        s->column[v] = -1;
    return n;
}

static int solve_tree(Kkt *s, const KktTask *task, Int i)
{
    const Int nv = s->k->nv;
    const Real *force = task->force + i * nv;
    Real *a = task->a + i * nv, *facts = task->facts + FACTS * i, *off = s->scratch + 4 * nv, sizes[4];
    const int code = tree_masses(task->tree, task->q + i * s->k->nq, task->v + i * nv, force,
                                 task->armature, s->mass, s->core);
    memset(facts, 0, FACTS * sizeof *facts);
    facts[FAILED] = code != DONE;
    if (code != DONE)
        return DONE;
    const Int n = put_core(s, task->tree, force);
    if (n) {
        const int solved = solve_core(s, task, i, s->mass, s->core);
        if (solved != DONE || n == nv)
            return solved;
    } else {
        memset(task->closures + i * nv, 0, (size_t)nv * sizeof(Real));
        facts[PIVOT] = 1.0;
    }
    for (Int v = 0; v < nv; v++)
        off[v] = task->rounding[v] * force[v];
    tree_accelerations(task->tree, 0, force, off, a, s->scratch, sizes);
    const Real largest = sizes[0] != 0.0 ? sizes[0] : 1.0;
    facts[OF_ALL] = fmax(fmax(facts[OF_CORE], LEAST_ERROR), (sizes[1] + sizes[2]) / largest);
    facts[OF_FORCES] = facts[OF_ALL] * sizes[0] <= 10.0 * sizes[3];
    return DONE;
}

/* ---------------------------------------------------------------- efforts of a motion */

/* Factor the forces of the chosen equations, actuators and idle rotations, of the size of one; or, by
   rows, the rates that these are. */
static int factor_bearing(Kkt *s, const KktTask *task, Int n_idle, Factors *matrix, int by_rows)
{
    const Kernel *k = s->k;
    const Int n = s->n_chosen + task->n_actuated;
    Entries *to = &matrix->entries;
    if (!entries_begin(to, k->entry_start[k->n_equations] + task->n_actuated))
        return NO_MEMORY;
    s->shortest = 1.0;
    for (Int i = 0; i < s->n_chosen + n_idle; i++) {
        const Int equation = i < s->n_chosen ? s->chosen[i] : k->n_closure + i - s->n_chosen;
        const Int at = i < s->n_chosen ? i : i + task->n_actuated;
        Real most = 0.0;
        for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
            most = fmax(most, fabs(k->entry[e]));
        most = most > 0.0 ? most : 1.0;
        if (i < s->n_chosen)
            s->size[i] = most, s->shortest = fmin(s->shortest, most);
        for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
            entries_put(to, by_rows ? at : k->entry_v[e], by_rows ? k->entry_v[e] : at,
                        k->entry[e] / most);
    }
    for (Int c = s->n_chosen; c < n; c++) {
        const Int v = task->actuated[c - s->n_chosen];
        entries_put(to, by_rows ? c : v, by_rows ? v : c, 1.0);
    }
    return factors_make(matrix, k->nv);
}

/* Choose equations that, with actuators and n_idle idle rotations, bear any force in one way: their
   matrix has a pivot that is sure then, else 0. */
static int choose_bearing(Kkt *s, const KktTask *task, Int *n_idle)
{
    const Int nv = s->k->nv, n = task->n_actuated;
    int (*const ways[])(Kkt *) = {choose_all, choose_in_closures, choose_among_all};
    for (int way = 0; way < 3; way++) {
        int code = ways[way](s);
        s->matrix->pivot = 0.0;
        *n_idle = s->n_chosen + n == nv ? 0 : s->k->n_idle;
        if (code == DONE && s->n_chosen + n + *n_idle == nv)
            code = factor_bearing(s, task, *n_idle, s->matrix, 0);
        if (code != DONE || s->matrix->pivot > SURE)
            return code;
    }
    return DONE;
}

/* Whether the bodies' accelerations s->moved move a centre of mass; `heaviest` is their inertia. */
static int moves_a_centre(const Kkt *s, const Kernel *bodies, Real *heaviest)
{
    int moves = 0;
    *heaviest = 0.0;
    for (Int j = 1; j < bodies->n_joints; j++) {
        const Real mass = bodies->bodies.mass[j], *I = bodies->bodies.inertia + 9 * j;
        const Real *linear = s->moved + 6 * j;
        Real arm[3], shift[3];
        *heaviest = fmax(*heaviest, mass * s->length * s->length + I[0] + I[4] + I[8]);
        rotate3(bodies->R + 9 * j, bodies->bodies.com + 3 * j, arm);
        cross3(linear + 3, arm, shift);
        add3(1.0, linear, shift);
        moves |= mass > 0.0 && !(largest(shift, 3) <= TOLERANCE_HALF_PRECISION * s->length);
    }
    return moves;
}

/* Give idle rotations the accelerations that forces give them: to `a`, and to the joint forces
   `needed` that the motion needs beside the given ones. Returns UNSAFE where they move a centre of
   mass or have no inertia, and at rest under a load that would turn them. */
static int free_idle(Kkt *s, const KktTask *task, Int i, Real *needed)
{
    const Kernel *k = s->k;
    Kernel *bodies = task->tree->k;
    const Int nv = k->nv, n = k->n_idle;
    const Real none[3] = {0.0}, *gravity = bodies->bodies.gravity;
    Real *a = task->a + i * nv, *still = s->scratch, load = 0.0, heaviest = 0.0, most = 0.0;
    int code = factor_bearing(s, task, n, s->rates, 1);
    if (code != DONE)
        return code;
    memset(still, 0, (size_t)nv * sizeof(Real));
    for (Int v = 0; v < nv; v++)
        most = fmax(most, fabs(k->scale[v] * needed[v]));
    for (Int m = 0; m < n && code == DONE; m++) {
        Real *spin = s->spin + m * nv;
        memset(s->x, 0, (size_t)nv * sizeof(Real));
        s->x[nv - n + m] = 1.0;
        factors_solve(s->rates, 1, s->x);
        const Real length = norm(s->x, nv);
        for (Int v = 0; v < nv; v++)
            spin[v] = k->scale[v] * s->x[v] / (length > 0.0 ? length : 1.0);
        bodies->bodies.gravity = none;
        tree_evaluate(task->tree, &(TreeTask){.n = 1, .q = task->q + i * k->nq, .v = still, .a = spin,
                                              .armature = task->armature, .tau = s->weight + m * nv,
                                              .acceleration = s->moved});
        bodies->bodies.gravity = gravity;
        if (moves_a_centre(s, bodies, &heaviest))
            code = UNSAFE;
        s->pace[m] = -dot(spin, needed, nv);
        load = fmax(load, fabs(dot(spin, task->force + i * nv, nv)));
    }
    if (load > TOLERANCE_NOTHING * most && largest(a, nv) == 0.0 &&
        largest(task->v + i * nv, nv) == 0.0)
        code = UNSAFE;
    Real least = TOLERANCE_ZERO * heaviest;
    for (Int m = 0; m < n; m++)
        for (Int l = 0; l < n; l++) {
            s->gram[m * n + l] = dot(s->spin + m * nv, s->weight + l * nv, nv);
            least = m == l ? fmax(least, TOLERANCE_RANK * s->gram[m * n + l]) : least;
        }
    if (code != DONE || dense_cholesky_solve(n, s->gram, s->pace, least))
        return UNSAFE;
    for (Int m = 0; m < n; m++)
        for (Int v = 0; v < nv; v++) {
            a[v] += s->pace[m] * s->spin[m * nv + v];
            needed[v] += s->pace[m] * s->weight[m * nv + v];
        }
    return DONE;
}

/* Estimated round-off of efforts, by the largest of n (times its scale), 1 at most: from pivots and the
   condition, and by `size` of what cancels, the solution in x and forces. Overwrites x. */
static Real efforts_error(Kkt *s, const Real *efforts, Int n, Real size)
{
    const Factors *matrix = s->matrix;
    const Real most = largest(efforts, n);
    Real error = fmax(ROUNDING / fmax(matrix->pivot, DBL_EPSILON), entry_error(s));
    size = fmax(size, largest(s->x, matrix->n));
    const Real condition = matrix_norm(s) * factors_inverse_norm(matrix);
    error = fmax(error, (Real)matrix->n * DBL_EPSILON * condition);
    return size > 0.0 && n ? fmin(error * size / fmax(most, DBL_MIN), 1.0) : 0.0;
}

/* Efforts and multipliers that together are what the motion needs. */
static int solve_efforts(Kkt *s, const KktTask *task, Int i)
{
    Kernel *k = s->k;
    const Int nv = k->nv, n = task->n_actuated;
    Real *needed = task->closures + i * nv, *facts = task->facts + FACTS * i;
    Real *efforts = task->efforts + i * n, *multipliers = task->multipliers + i * k->n_closure;
    Int n_idle = 0;
    Real size = 0.0;
    memset(facts, 0, FACTS * sizeof *facts);
    tree_evaluate(task->tree, &(TreeTask){.n = 1, .q = task->q + i * k->nq, .v = task->v + i * nv,
                                          .a = task->a + i * nv, .armature = task->armature,
                                          .tau = needed});
    equations_values_near(k, task->q + i * k->nq, task->reference + i * k->n_angles);
    equations_jacobian(k, &k->equations.all);
    int code = choose_bearing(s, task, &n_idle);
    if (code != DONE)
        return code;
    facts[PIVOT] = s->matrix->pivot;
    facts[RANK] = (Real)s->n_chosen;
    facts[FAILED] = !(s->matrix->pivot > SURE);
    for (Int v = 0; v < nv; v++) {
        size = fmax(size, k->scale[v] * (fabs(needed[v]) + fabs(task->force[i * nv + v])));
        needed[v] -= task->force[i * nv + v];
    }
    if (n_idle && facts[FAILED] == 0.0) {
        code = free_idle(s, task, i, needed);
        facts[FAILED] = code == UNSAFE;
    }
    if (code == NO_MEMORY || facts[FAILED] != 0.0)
        return code == NO_MEMORY ? code : DONE;
    for (Int v = 0; v < nv; v++)
        s->x[v] = k->scale[v] * needed[v];
    factors_solve(s->matrix, 1, s->x);
    memset(multipliers, 0, (size_t)k->n_closure * sizeof(Real));
    for (Int e = 0; e < s->n_chosen; e++)
        multipliers[s->chosen[e]] = s->x[e] / s->size[e];
    memcpy(efforts, s->x + s->n_chosen, (size_t)n * sizeof(Real));
    facts[OF_ALL] = efforts_error(s, efforts, n, size);
    for (Int c = 0; c < n; c++) {
        efforts[c] /= k->scale[task->actuated[c]];
        needed[task->actuated[c]] -= efforts[c];
    }
    return DONE;
}

/* Solve with the last factors: forces f - b (n, nv), gamma (n, n_closure) -> a and multipliers, alike. */
EXPORT void kkt_solve(Kkt *s, Int n, const Real *force, const Real *gamma, Real *a, Real *multipliers)
{
    const Int nv = s->k->nv, nc = s->k->n_closure;
    for (Int i = 0; i < n; i += BLOCK)
        solve(s, n - i < BLOCK ? n - i : BLOCK, force + i * nv, gamma + i * nc, a + i * nv,
              multipliers + i * nc);
}

/* Derivatives of accelerations and multipliers at a configuration that was solved: joint forces and
   second derivatives of the equations change, at constant ones, and the same factors do the rest. */
static void put_changes(Kkt *s, const KktTask *task, Int i)
{
    const Int nv = s->k->nv, nc = s->k->n_closure, n = 3 * nv, last = 2 * nc * nv;
    const Real *slopes = task->slopes ? task->slopes + 2 * i * nv : NULL;
    Real *force = s->changed, *gamma = force + n * nv;
    TreeTask of = *task->changes;
    of.n = 1, of.q = task->q + i * s->k->nq, of.v = task->v + i * nv, of.a = task->a + i * nv;
    of.by_q = force, of.by_v = force + nv * nv, of.weights = task->multipliers + i * nc;
    memset(force, 0, (size_t)(n * (nv + nc)) * sizeof(Real));
    memset(of.bent, 0, (size_t)(nv * nv) * sizeof(Real));
    memset(of.product_by_q, 0, (size_t)(3 * nc * nv) * sizeof(Real));
    memset(of.product_by_v, 0, (size_t)(3 * nc * nv) * sizeof(Real));
    tree_evaluate(task->single, &of);
    for (Int j = 0; j < nv; j++) {
        for (Int v = 0; v < nv; v++) {
            Real *by_q = force + j * nv + v, *by_v = by_q + nv * nv;
            *by_q = of.bent[v * nv + j] - *by_q;
            *by_v = -*by_v;
            by_v[nv * nv] = j == v ? 1.0 : 0.0;
        }
        force[j * nv + j] -= slopes ? slopes[j] : 0.0;
        force[(nv + j) * nv + j] -= slopes ? slopes[nv + j] : 0.0;
        for (Int e = 0; e < nc; e++) {
            gamma[j * nc + e] = of.product_by_q[last + e * nv + j];
            gamma[(nv + j) * nc + e] = of.product_by_v[last + e * nv + j];
        }
    }
    kkt_solve(s, n, force, gamma, task->a_by + i * n * nv, task->multipliers_by + i * n * nc);
}

/* Accelerations under joint forces, and their derivatives if wanted, or efforts of accelerations, at all
   configurations of the task. */
EXPORT int kkt_accelerations(Kkt *s, const KktTask *task)
{
    const Kernel *k = s->k;
    for (Int c = 0; task->actuated && c < task->n_actuated; c++)
        if (!within(task->actuated[c], k->nv))
            return BAD_ARRAYS;
    if (task->single && task->changes->n_products != k->n_closure)
        return BAD_ARRAYS;
    if (task->single && !s->changed) {
        s->changed = kernel_reals(s->k, 3 * k->nv * (k->nv + k->n_closure));
        if (!kernel_had_memory(s->k))
            return NO_MEMORY;
    }
    for (Int i = 0; i < task->n; i++) {
        const int code = task->actuated ? solve_efforts(s, task, i)
                         : task->tree   ? solve_tree(s, task, i)
                                        : solve_core(s, task, i, task->mass, task->force);
        if (code != DONE)
            return code;
        memcpy(task->chosen + i * k->n_closure, s->chosen, (size_t)s->n_chosen * sizeof(Int));
        if (task->single && task->facts[FACTS * i + FAILED] == 0.0)
            put_changes(s, task, i);
    }
    memcpy(task->entry, k->entry, (size_t)k->entry_start[k->n_closure] * sizeof(Real));
    return DONE;
}
