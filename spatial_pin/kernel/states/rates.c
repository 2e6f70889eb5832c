/* Velocities and accelerations of all joints at given rates of driven freedoms: K v = drive,
 * K a = drive' - bias(v), and whatever else the same K answers. K holds independent closure
 * equations, idle rotations, what is driven, and rows that fill it up: passive freedoms that nothing
 * determines take the least rates.
 *
 * Equations are chosen here where as many as there have to be are independent of each other, of the
 * drivers and of the idle rotations, and clearly so. Where they are not, the caller has to find out
 * why, or chooses them. Equations and pivots are chosen anew at every configuration, so that answers
 * depend on nothing else. Where equations are left out, a step of the driven freedoms tells whether
 * they follow from the others near the configuration too: if not, branches cross there. */
#include <float.h>
#include <string.h>

#include "choosing.h"
#include "factors.h"
#include "memory.h"
#include "pins.h"
#include "rates.h"
#include "correcting.h"

/* Part of the longest equation that is left of each that is chosen, and smallest over largest pivot
   relative to the lengths of their rows, where it is clear what is independent. */
#define WELL TOLERANCE_WELL_CONDITIONED
/* Of a solution, relative to its size, before pivots magnify it */
#define SOLUTION_ERROR (8.0 * DBL_EPSILON)
/* Of a closure equation at a configuration closed to round-off: half of the most that 160 random
   mechanisms had */
#define CLOSURE_ROUND_OFF (2.0 * DBL_EPSILON)
#define PATTERNS 2 /* of their signs: what one of them hides by chance, the other shows */

struct Rates {
    Kernel *k;
    Int n_driven, n_chosen, wanted; /* wanted: closure equations that there have to be */
    const Int *driven; /* freedoms v, or nv + v for the component that v is of, see pins.h */
    Pin *pin;         /* (n_driven) of those that are components */
    Int *chosen;      /* closure equations, ascending */
    Factors *matrix;  /* K */
    Real *x;          /* (nv) */
    Real *away, *along, *change, *sum; /* (nv) to tell what round-off leaves */
    Real *q;          /* (nq) */
    int is_placed;    /* whether K is that of a configuration */
};

static int make_room(Rates *r)
{
    Kernel *k = r->k;
    r->chosen = kernel_ints(k, k->n_closure);
    r->x = kernel_reals(k, k->nv);
    r->away = kernel_reals(k, k->nv);
    r->along = kernel_reals(k, k->nv);
    r->change = kernel_reals(k, k->nv);
    r->sum = kernel_reals(k, k->nv);
    r->q = kernel_reals(k, k->nq);
    r->matrix = factors_new(k);
    return kernel_had_memory(k) && r->matrix ? DONE : NO_MEMORY;
}

EXPORT int rates_create(Kernel *k, const Int *driven, Int n_driven, Rates **out)
{
    *out = NULL;
    if (n_driven < 0)
        return BAD_ARRAYS;
    Rates *r = kernel_memory(k, 1, sizeof *r);
    Int *copy = kernel_ints(k, n_driven);
    Pin *pin = kernel_memory(k, n_driven, sizeof *pin);
    if (!kernel_had_memory(k))
        return NO_MEMORY;
    for (Int i = 0; i < n_driven; i++)
        if (!within(driven[i], 2 * k->nv) ||
            (driven[i] >= k->nv && !pin_of(k, driven[i] - k->nv, pin + i)))
            return BAD_ARRAYS;
    memcpy(copy, driven, (size_t)n_driven * sizeof(Int));
    r->k = k, r->n_driven = n_driven, r->driven = copy, r->pin = pin;
    r->wanted = k->nv - k->n_idle - n_driven;
    if (make_room(r) != DONE)
        return NO_MEMORY;
    *out = r;
    return DONE;
}

/* ---------------------------------------------------------------- choice of equations */

/* Equations whose derivatives are not all none: planar loops keep those in their plane. */
static void choose_those_that_are(Rates *r)
{
    const Kernel *k = r->k;
    r->n_chosen = 0;
    for (Int i = 0; i < k->n_closure; i++)
        if (equation_length(k, i) > TOLERANCE_ZERO)
            r->chosen[r->n_chosen++] = i;
}

/* Independent ones of the chosen; UNSAFE where it is not clear which, or how many. */
static int choose_independent(Rates *r)
{
    Real facts[2];
    const Int rank = independent_equations(r->k, r->chosen, r->n_chosen, r->wanted, WELL,
                                            r->chosen, facts);
    if (rank < 0)
        return NO_MEMORY;
    r->n_chosen = rank;
    return rank == r->wanted && facts[1] <= TOLERANCE_CLOSED ? DONE : UNSAFE;
}

static int choose(Rates *r)
{
    const Int n = r->n_chosen = r->k->n_closure;
    if (r->wanted < 0)
        return UNSAFE;
    for (Int i = 0; i < n; i++)
        r->chosen[i] = i;
    if (n > r->wanted)
        choose_those_that_are(r);
    if (r->n_chosen > r->wanted)
        return choose_independent(r);
    return r->n_chosen == r->wanted ? DONE : UNSAFE;
}

/* ---------------------------------------------------------------- the square system */

static int is_pin(const Rates *r, Int i) { return r->driven[i] >= r->k->nv; }

static Real driven_scale(const Rates *r, Int i) { return r->k->scale[r->driven[i] % r->k->nv]; }

/* Where the rows, and right sides, of what is driven begin. */
static Int first_driven(const Rates *r) { return r->n_chosen + r->k->n_idle; }

/* Factor K, with rows that fill it up, at the evaluated configuration. */
static int factor(Rates *r, const Real *fill, Int n_fill)
{
    const Kernel *k = r->k;
    Entries *to = &r->matrix->entries;
    const Int more = 3 * r->n_driven + n_fill * k->nv;
    if (!system_put_equations(k, r->chosen, r->n_chosen, more, to))
        return NO_MEMORY;
    for (Int i = 0; i < r->n_driven; i++)
        system_put_driven(k, first_driven(r) + i, r->driven[i], r->pin + i, to);
    system_put_fill(k, first_driven(r) + r->n_driven, fill, n_fill, to);
    return factors_make(r->matrix, k->nv);
}

/* Joint velocities (n, nv) for a unit speed of each of the first n driven freedoms; returns how
   fast the fastest joint is, relative to the driven one. */
static Real solve_columns(Rates *r, Int n, Real *columns)
{
    const Kernel *k = r->k;
    Real pace = 1.0;
    for (Int c = 0; c < n; c++) {
        const Real own = driven_scale(r, c);
        Real *x = columns + c * k->nv;
        memset(x, 0, (size_t)k->nv * sizeof(Real));
        x[first_driven(r) + c] = 1.0 / own;
        factors_solve(r->matrix, 1, x);
        for (Int v = 0; v < k->nv; v++) {
            pace = fabs(x[v]) * own > pace ? fabs(x[v]) * own : pace;
            x[v] *= k->scale[v];
        }
    }
    return pace;
}

/* x += factor times derivatives (n_equations) of the equations. */
static void add_equations(const Rates *r, const Real *derivative, Real factor, Real *x)
{
    for (Int i = 0; i < r->n_chosen; i++)
        x[i] += factor * derivative[r->chosen[i]];
    for (Int i = 0; i < r->k->n_idle; i++)
        x[r->n_chosen + i] += factor * derivative[r->k->n_closure + i];
}

/* x += factor times the second derivatives of the equations, and of driven components, at joint
   velocities v. */
static void add_bias(Rates *r, const Real *v, Real factor, Real *x)
{
    Kernel *k = r->k;
    equations_bias(k, &k->equations.all, v);
    add_equations(r, k->equations.bias, factor, x);
    for (Int i = 0; i < r->n_driven; i++)
        if (is_pin(r, i))
            x[first_driven(r) + i] += factor * pin_bias(r->pin + i, k->q, v) / driven_scale(r, i);
}

/* Joint rates (nv) of any order, for the right sides of the equations in r->x and rates (n_driven)
   of what is driven. */
static void answer(Rates *r, const Real *drive, Real *out)
{
    const Kernel *k = r->k;
    for (Int i = 0; i < r->n_driven; i++)
        r->x[first_driven(r) + i] += drive[i] / driven_scale(r, i);
    factors_solve(r->matrix, 1, r->x);
    for (Int i = 0; i < k->nv; i++)
        out[i] = k->scale[i] * r->x[i];
    for (Int i = 0; i < r->n_driven; i++)
        if (!is_pin(r, i))
            out[r->driven[i]] = drive[i]; /* as prescribed, to the last digit */
}

/* ---------------------------------------------------------------- round-off

   What round-off leaves of velocities and accelerations, at a configuration that is itself known to
   round-off only. */

/* How far off the configuration may be, relative to what closure equations are off by: where this is
   one, some this way, some that way. Returns its size, `away` (nv) its direction. */
static Real direction_off(Rates *r, int pattern, Real *away)
{
    const Int nv = r->k->nv;
    memset(r->x, 0, (size_t)nv * sizeof(Real));
    for (Int i = 0; i < r->n_chosen; i++)
        r->x[i] = cos((Real)(pattern * (i + 1) * (i + 1))) < 0.0 ? -1.0 : 1.0;
    factors_solve(r->matrix, 1, r->x);
    const Real size = largest(r->x, nv);
    for (Int v = 0; v < nv; v++)
        away[v] = size > 0.0 ? r->x[v] / size : 0.0;
    return size;
}

/* Change of the velocities t where the configuration changes along u, both relative to the scale:
   the polar form (a(t + u) - a(t - u)) / 4 of the accelerations, which are quadratic. Into r->x;
   returns its size. */
static Real response(Rates *r, const Real *t, const Real *u)
{
    const Kernel *k = r->k;
    memset(r->x, 0, (size_t)k->nv * sizeof(Real));
    for (int sign = 1; sign >= -1; sign -= 2) {
        for (Int v = 0; v < k->nv; v++)
            r->sum[v] = k->scale[v] * (t[v] + sign * u[v]);
        add_bias(r, r->sum, -0.25 * sign, r->x);
    }
    factors_solve(r->matrix, 1, r->x);
    return largest(r->x, k->nv);
}

/* How far velocities and accelerations, relative to their size, follow a configuration that is off
   by so much along `away`. Where branches cross, joints move no faster than the driver, and rates
   are uncertain all the same: velocities by the square of what a pivot magnifies, accelerations by
   its third power. */
static Real lost_along(Rates *r, Real off, const Real *away, const Real *velocity)
{
    const Kernel *k = r->k;
    Real size = 0.0, *t = r->along, *change = r->change;
    for (Int v = 0; v < k->nv; v++)
        size = fmax(size, fabs(velocity[v]) / k->scale[v]);
    if (!(size > 0.0))
        return 0.0;
    for (Int v = 0; v < k->nv; v++)
        t[v] = velocity[v] / k->scale[v] / size;
    const Real first = response(r, t, away);
    if (!(first > 0.0))
        return 0.0;
    for (Int v = 0; v < k->nv; v++)
        change[v] = r->x[v] / first;
    const Real second = 2.0 * first * response(r, t, change);
    response(r, t, t); /* a(2 t) / 4: the acceleration at constant speed of the driver */
    const Real bend = largest(r->x, k->nv);
    memcpy(change, r->x, (size_t)k->nv * sizeof(Real));
    const Real third = response(r, change, away);
    return off * fmax(first, (second + third) / fmax(bend, 1.0));
}

/* Whether what is closed to round-off loses no more than is known without the velocities. */
static int is_known_anyway(Rates *r, Real known)
{
    Real grown = 0.0;
    for (int pattern = 1; pattern <= PATTERNS; pattern++)
        grown = fmax(grown, direction_off(r, pattern, r->away));
    return !(2.0 * CLOSURE_ROUND_OFF * grown * grown * grown > known);
}

/* Round-off of the velocities v and of accelerations, relative to their size. Next to a limit
   position at a small distance e of the driver, joints move 1/sqrt(e) times as fast as the driver
   (`pace`); a configuration known to round-off times that gives rates to that squared. A short link
   leaves as much of it as its pivot: that is known without the velocities. A configuration that is
   not closed to round-off, as those of motions, is off by what is open. */
static Real round_off(Rates *r, const Real *v, Real known)
{
    const Real open = fmax(CLOSURE_ROUND_OFF, equations_error(r->k));
    if (open == CLOSURE_ROUND_OFF && is_known_anyway(r, known))
        return known; /* which is more than the estimate could be */
    Real lost = 0.0;
    for (int pattern = 1; pattern <= PATTERNS; pattern++) {
        const Real off = open * direction_off(r, pattern, r->away);
        lost = fmax(lost, lost_along(r, off, r->away, v));
    }
    return fmin(1.0, known + lost);
}

/* What is known of it without the velocities, where the fastest joint moves `pace` times as fast as
   what is driven. */
static Real known_round_off(const Rates *r, Real pace)
{
    return fmin(1.0, SOLUTION_ERROR * pace * fmax(pace, 1.0 / fmax(r->matrix->pivot, 1e-300)));
}

/* ---------------------------------------------------------------- what Python calls */

/* Whether equations that are left out hold near q too. Comes back to q. */
static int follow_beside(Rates *r, const Real *q)
{
    Kernel *k = r->k;
    if (r->n_chosen == k->n_closure || r->n_chosen == k->nv)
        return 1;
    int code = system_set(k, r->chosen, r->n_chosen, r->driven, r->n_driven, NULL, 0);
    if (code == DONE)
        code = system_factor(k);
    if (code == DONE)
        code = stays_closed(k, q, equations_error(k), r->q);
    equations_values(k, q);
    equations_jacobian(k, &k->equations.all);
    return code == DONE;
}

/* Choose equations and factor at the evaluated q; UNSAFE where they are not clearly independent. */
static int choose_and_factor(Rates *r, const Real *q)
{
    int code = choose(r);
    if (code == DONE)
        code = factor(r, NULL, 0);
    if (code != DONE)
        return code;
    if (!(r->matrix->pivot > TOLERANCE_SINGULAR || factors_even_ratio(r->matrix) > WELL))
        return UNSAFE;
    return follow_beside(r, q) ? DONE : UNSAFE;
}

/* Factor the equations that the caller has chosen. */
static int take_and_factor(Rates *r, const RateTask *task)
{
    const Kernel *k = r->k;
    if (task->n_equations < 0 || task->n_equations > k->n_closure || task->n_fill < 0 ||
        task->n_equations + task->n_fill != r->wanted)
        return BAD_ARRAYS;
    for (Int i = 0; i < task->n_equations; i++)
        if (!within(task->equations[i], k->n_closure))
            return BAD_ARRAYS;
    r->n_chosen = task->n_equations;
    memcpy(r->chosen, task->equations, (size_t)r->n_chosen * sizeof(Int));
    const int code = factor(r, task->fill, task->n_fill);
    return code == DONE && !(r->matrix->pivot > 0.0) ? SINGULAR : code;
}

/* Velocities and accelerations at the factored configuration, and what round-off leaves of them. */
static int solve(Rates *r, const RateTask *task)
{
    const Int nv = r->k->nv;
    const Real pace = solve_columns(r, task->n_moving, task->columns);
    memset(task->v, 0, (size_t)nv * sizeof(Real));
    for (Int c = 0; c < task->n_moving; c++)
        for (Int i = 0; i < nv; i++)
            task->v[i] += task->columns[c * nv + i] * task->speed[c];
    for (Int i = 0; i < r->n_driven; i++)
        if (!is_pin(r, i))
            task->v[r->driven[i]] = task->speed[i];
    memset(r->x, 0, (size_t)nv * sizeof(Real));
    add_bias(r, task->v, -1.0, r->x);
    answer(r, task->acceleration, task->a);
    task->facts[2] = known_round_off(r, pace);
    task->facts[1] = round_off(r, task->v, task->facts[2]);
    return are_finite(task->v, nv) && are_finite(task->a, nv) ? DONE : NOT_FINITE;
}

EXPORT int rates_solve(Rates *r, const RateTask *task)
{
    Kernel *k = r->k;
    if (task->n_moving < 0 || task->n_moving > r->n_driven)
        return BAD_ARRAYS;
    equations_values_near(k, task->q, task->reference);
    equations_jacobian(k, &k->equations.all);
    const int code = task->equations ? take_and_factor(r, task) : choose_and_factor(r, task->q);
    r->is_placed = code == DONE;
    task->facts[0] = r->matrix->pivot;
    return code == DONE && task->speed ? solve(r, task) : code;
}

EXPORT int rates_answer(Rates *r, const Real *v, const Real *derivative, const Real *drive, Real *out)
{
    if (!r->is_placed)
        return BAD_ARRAYS;
    memset(r->x, 0, (size_t)r->k->nv * sizeof(Real));
    if (v)
        add_bias(r, v, -1.0, r->x);
    if (derivative)
        add_equations(r, derivative, -1.0, r->x);
    answer(r, drive, out);
    return are_finite(out, r->k->nv) ? DONE : NOT_FINITE;
}

/* Twist of a point of a joint's body, at the evaluated configuration, for joint velocities (nv). */
static void twist(const Kernel *k, Int joint, const Real *point, const Real *v, Real *linear,
                  Real *angular)
{
    Real around[3];
    zero3(linear);
    zero3(angular);
    for (Int j = joint; j > 0; j = k->parent[j])
        for (Int i = k->iv[j]; i < k->iv[j] + joint_nv(k->kind[j]); i++) {
            add3(v[i], k->linear + 3 * i, linear);
            add3(v[i], k->angular + 3 * i, angular);
        }
    cross3(angular, point, around);
    add3(1.0, around, linear);
}

EXPORT int rates_columns(Rates *r, Int n, Real *columns, Int joint, const Real *local, Real *jacobian)
{
    const Kernel *k = r->k;
    if (!r->is_placed || n < 0 || n > r->n_driven || !within(joint, k->n_joints))
        return BAD_ARRAYS;
    solve_columns(r, n, columns);
    if (!jacobian)
        return DONE;
    Real point[3];
    rotate3(k->R + 9 * joint, local, point);
    add3(1.0, k->p + 3 * joint, point);
    for (Int c = 0; c < n; c++) {
        Real parts[6];
        twist(k, joint, point, columns + c * k->nv, parts, parts + 3);
        for (int i = 0; i < 6; i++)
            jacobian[i * n + c] = parts[i];
    }
    return are_finite(jacobian, 6 * n) ? DONE : NOT_FINITE;
}
