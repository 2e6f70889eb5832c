/* Velocities and accelerations of all joints at given rates of driven freedoms, where as many
 * closure equations as there have to be are independent of each other, of the drivers and of the
 * idle rotations, and clearly so: K v = drive, K a = drive' - bias(v). Where they are not, the
 * caller has to find out why.
 *
 * Equations and pivots are chosen anew at every configuration, so that answers depend on nothing
 * else. Where equations are left out, a step of the driven freedoms tells whether they follow from
 * the others beside the configuration too: if not, branches cross there. */
#include <float.h>
#include <string.h>

#include "choosing.h"
#include "dense.h"
#include "kernel.h"
#include "pins.h"
#include "regular.h"
#include "tolerances.h"

/* Part of the longest equation that is left of each that is chosen, and smallest over largest pivot
   relative to the lengths of their rows, where it is clear what is independent. */
#define WELL TOLERANCE_WELL_CONDITIONED
/* Of a solution, relative to its size, before pivots magnify it */
#define SOLUTION_ERROR (8.0 * DBL_EPSILON)
/* Of a closure equation at a configuration closed to round-off: half of the most that 160 random
   mechanisms had */
#define CLOSURE_ROUND_OFF (2.0 * DBL_EPSILON)
#define PATTERNS 2 /* of their signs: what one of them hides by chance, the other shows */
/* Freedoms up to which a full matrix is factored faster than a sparse one is put in order. */
#define FEW_FREEDOMS 40

typedef struct {
    Kernel *k;
    Int n_driven, n_chosen, wanted; /* wanted: closure equations that there have to be */
    const Int *driven; /* freedoms v, or nv + v for the component that v is of, see pins.h */
    Pin *pin;         /* (n_driven) of those that are components */
    Int *chosen;      /* closure equations, ascending */
    Int *places;      /* among them, of independent ones */
    Real *matrix;     /* (nv, nv) transposed K, factored; of few freedoms */
    Int *order;
    Real *x;          /* (nv) */
    Real *away, *along, *change, *sum; /* (nv) to tell what round-off leaves */
    Real *q;          /* (nq) */
    Real pivot;       /* smallest over largest */
    Real even;        /* the same, pivots relative to the lengths of their rows */
} Rates;

static int make_room(Rates *r)
{
    Kernel *k = r->k;
    const Int size = k->nv <= FEW_FREEDOMS ? k->nv * k->nv : 0;
    r->chosen = kernel_memory(k, k->n_closure, sizeof(Int));
    r->places = kernel_memory(k, k->n_closure, sizeof(Int));
    r->matrix = kernel_memory(k, size, sizeof(Real));
    r->order = kernel_memory(k, k->nv, sizeof(Int));
    r->x = kernel_memory(k, 5 * k->nv, sizeof(Real));
    r->q = kernel_memory(k, k->nq, sizeof(Real));
    if (!r->chosen || !r->places || !r->matrix || !r->order || !r->x || !r->q)
        return NO_MEMORY;
    r->away = r->x + k->nv, r->along = r->away + k->nv;
    r->change = r->along + k->nv, r->sum = r->change + k->nv;
    return DONE;
}

/* Memory for rates of a kernel, freed with it; BAD_ARRAYS unless there are at least as many
   equations and driven freedoms as freedoms. */
EXPORT int rates_create(Kernel *k, const Int *driven, Int n_driven, Rates **out)
{
    *out = NULL;
    const Int wanted = k->nv - k->n_idle - n_driven;
    if (n_driven < 0 || wanted < 0 || wanted > k->n_closure)
        return BAD_ARRAYS;
    Rates *r = kernel_memory(k, 1, sizeof *r);
    Int *copy = kernel_memory(k, n_driven, sizeof(Int));
    Pin *pin = kernel_memory(k, n_driven, sizeof *pin);
    if (!r || !copy || !pin)
        return NO_MEMORY;
    for (Int i = 0; i < n_driven; i++)
        if (!within(driven[i], 2 * k->nv) ||
            (driven[i] >= k->nv && !pin_of(k, driven[i] - k->nv, pin + i)))
            return BAD_ARRAYS;
    memcpy(copy, driven, (size_t)n_driven * sizeof(Int));
    r->k = k, r->n_driven = n_driven, r->driven = copy, r->pin = pin, r->wanted = wanted;
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
    for (Int i = 0; i < k->n_closure; i++) {
        Real square = 0.0;
        for (Int e = k->entry_start[i]; e < k->entry_start[i + 1]; e++)
            square += k->entry[e] * k->entry[e];
        if (square > TOLERANCE_ZERO * TOLERANCE_ZERO)
            r->chosen[r->n_chosen++] = i;
    }
}

/* Independent ones of the chosen; UNSAFE where it is not clear which, or how many. */
static int choose_independent(Rates *r)
{
    const Kernel *k = r->k;
    Choice c;
    if (choice_begin(&c, r->n_chosen, k->nv) != DONE)
        return NO_MEMORY;
    for (Int i = 0; i < r->n_chosen; i++) {
        const Int from = k->entry_start[r->chosen[i]];
        choice_put(&c, i, k->entry_start[r->chosen[i] + 1] - from, k->entry_v + from,
                   k->entry + from);
    }
    r->n_chosen = choice_make(&c, r->wanted, WELL, r->places);
    const int is_clear = r->n_chosen == r->wanted && c.left_out <= TOLERANCE_CLOSED;
    choice_end(&c);
    for (Int i = 0; i < r->n_chosen; i++)
        r->chosen[i] = r->chosen[r->places[i]];
    return is_clear ? DONE : UNSAFE;
}

static int choose(Rates *r)
{
    const Int n = r->n_chosen = r->k->n_closure;
    for (Int i = 0; i < n; i++)
        r->chosen[i] = i;
    if (n > r->wanted)
        choose_those_that_are(r);
    if (r->n_chosen > r->wanted)
        return choose_independent(r);
    return r->n_chosen == r->wanted ? DONE : UNSAFE;
}

/* ---------------------------------------------------------------- the square system */

static void fill_row(Rates *r, Int row, Int equation)
{
    const Kernel *k = r->k;
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
        r->matrix[k->entry_v[e] * k->nv + row] = k->entry[e];
}

static int is_pin(const Rates *r, Int i) { return r->driven[i] >= r->k->nv; }

static Real driven_scale(const Rates *r, Int i) { return r->k->scale[r->driven[i] % r->k->nv]; }

/* The row of a driven freedom, or of a component that is none. */
static void fill_driven(Rates *r, Int i)
{
    const Kernel *k = r->k;
    const Int row = k->nv - r->n_driven + i, first = r->pin[i].v;
    Real gradient[3];
    if (!is_pin(r, i)) {
        r->matrix[r->driven[i] * k->nv + row] = 1.0;
        return;
    }
    pin_row(r->pin + i, k->q, gradient);
    for (int x = 0; x < 3; x++)
        r->matrix[(first + x) * k->nv + row] = gradient[x] * k->scale[first + x] / driven_scale(r, i);
}

/* K transposed: equation by equation in the columns. */
static void fill_matrix(Rates *r)
{
    const Kernel *k = r->k;
    memset(r->matrix, 0, (size_t)(k->nv * k->nv) * sizeof(Real));
    for (Int i = 0; i < r->n_chosen; i++)
        fill_row(r, i, r->chosen[i]);
    for (Int i = 0; i < k->n_idle; i++)
        fill_row(r, r->n_chosen + i, k->n_closure + i);
    for (Int i = 0; i < r->n_driven; i++)
        fill_driven(r, i);
}

static Real pivot_ratio(const Real *matrix, Int n)
{
    Real least = INFINITY, most = 0.0;
    for (Int i = 0; i < n; i++) {
        const Real size = fabs(matrix[i * n + i]);
        least = size < least ? size : least;
        most = size > most ? size : most;
    }
    return most > 0.0 ? least / most : n ? 0.0 : 1.0;
}

/* Factor the kernel's square system at the evaluated configuration, in an order chosen there. */
static int factor_system(Rates *r)
{
    const int code =
        system_set(r->k, r->chosen, r->n_chosen, r->driven, r->n_driven, NULL, 0);
    return code == DONE ? system_factor(r->k) : code;
}

/* Smallest over largest pivot relative to its row's length: a loop that is short beside the whole
   mechanism has short rows, however independent they are. */
static Real even_ratio(Rates *r)
{
    const Kernel *k = r->k;
    Real *length = r->x;
    memset(length, 0, (size_t)k->nv * sizeof *length);
    for (Int e = 0; e < k->n_system; e++)
        length[k->system_row[e]] += k->system_value[e] * k->system_value[e];
    for (Int i = 0; i < k->nv; i++)
        length[i] = sqrt(length[i]);
    return lu_even_ratio(k->lu, length);
}

/* Factor at the evaluated configuration. */
static int factor(Rates *r)
{
    Kernel *k = r->k;
    if (k->nv <= FEW_FREEDOMS) {
        fill_matrix(r);
        const Int singular = k->nv ? dense_lu(k->nv, r->matrix, r->order) : 0;
        r->even = r->pivot = singular ? 0.0 : pivot_ratio(r->matrix, k->nv);
        return DONE;
    }
    const int code = factor_system(r);
    r->pivot = code == DONE ? k->pivot_ratio : 0.0;
    r->even = code == DONE ? even_ratio(r) : 0.0;
    return code == SINGULAR ? DONE : code;
}

static void solve(Rates *r, Real *x)
{
    if (r->k->nv > FEW_FREEDOMS)
        system_solve(r->k, x);
    else if (r->k->nv)
        dense_lu_solve(r->k->nv, r->matrix, r->order, 1, 1, x);
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
        x[k->nv - r->n_driven + c] = 1.0 / own;
        solve(r, x);
        for (Int v = 0; v < k->nv; v++) {
            pace = fabs(x[v]) * own > pace ? fabs(x[v]) * own : pace;
            x[v] *= k->scale[v];
        }
    }
    return pace;
}

/* x += factor times the second derivatives of the equations, and of driven components, at joint
   velocities v. */
static void add_bias(Rates *r, const Real *v, Real factor, Real *x)
{
    Kernel *k = r->k;
    equations_bias(k, v);
    for (Int i = 0; i < r->n_chosen; i++)
        x[i] += factor * k->bias[r->chosen[i]];
    for (Int i = 0; i < k->n_idle; i++)
        x[r->n_chosen + i] += factor * k->bias[k->n_closure + i];
    for (Int i = 0; i < r->n_driven; i++)
        if (is_pin(r, i))
            x[k->nv - r->n_driven + i] += factor * pin_bias(r->pin + i, k->q, v) / driven_scale(r, i);
}

static void solve_acceleration(Rates *r, const Real *v, const Real *acceleration, Real *a)
{
    Kernel *k = r->k;
    memset(r->x, 0, (size_t)k->nv * sizeof(Real));
    add_bias(r, v, -1.0, r->x);
    for (Int i = 0; i < r->n_driven; i++)
        r->x[k->nv - r->n_driven + i] += acceleration[i] / driven_scale(r, i);
    solve(r, r->x);
    for (Int i = 0; i < k->nv; i++)
        a[i] = k->scale[i] * r->x[i];
    for (Int i = 0; i < r->n_driven; i++)
        if (!is_pin(r, i))
            a[r->driven[i]] = acceleration[i]; /* as asked for, to the last digit */
}

/* ---------------------------------------------------------------- what round-off leaves */

static Real largest(const Real *x, Int n)
{
    Real found = 0.0;
    for (Int i = 0; i < n; i++)
        found = fmax(found, fabs(x[i]));
    return found;
}

/* How far off the configuration may be, relative to the round-off of a closure equation: where
   these are off by one, some this way, some that way. Returns its size, `away` (nv) its direction. */
static Real direction_off(Rates *r, Real *away)
{
    const Int nv = r->k->nv;
    Real most = 0.0;
    memset(away, 0, (size_t)nv * sizeof(Real));
    for (int pattern = 1; pattern <= PATTERNS; pattern++) {
        memset(r->x, 0, (size_t)nv * sizeof(Real));
        for (Int i = 0; i < r->n_chosen; i++)
            r->x[i] = cos((Real)(pattern * (i + 1) * (i + 1))) < 0.0 ? -1.0 : 1.0;
        solve(r, r->x);
        const Real size = largest(r->x, nv);
        if (!(size > most))
            continue;
        most = size;
        for (Int v = 0; v < nv; v++)
            away[v] = r->x[v] / size;
    }
    return most;
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
    solve(r, r->x);
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

/* Round-off of the velocities v and of accelerations, relative to their size. Next to a limit
   position at a small distance e of the driver, joints move 1/sqrt(e) times as fast as the driver
   (`pace`); a configuration known to round-off times that gives rates to that squared. A short link
   leaves as much of it as its pivot. */
static Real lost(Rates *r, const Real *v, Real pace)
{
    const Real known = SOLUTION_ERROR * pace * fmax(pace, 1.0 / fmax(r->pivot, 1e-300));
    const Real grown = direction_off(r, r->away);
    if (!(2.0 * CLOSURE_ROUND_OFF * grown * grown * grown > known))
        return known; /* which is more than what could be found out */
    return fmin(1.0, fmax(known, lost_along(r, CLOSURE_ROUND_OFF * grown, r->away, v)));
}

/* ---------------------------------------------------------------- what Python calls */

static void evaluate(Kernel *k, const Real *q)
{
    equations_values(k, q);
    equations_jacobian(k);
}

/* Whether equations that are left out hold beside q too. Comes back to q. */
static int follow_beside(Rates *r, const Real *q)
{
    Kernel *k = r->k;
    if (r->n_chosen == k->n_closure || r->n_chosen == k->nv)
        return 1;
    int code = factor_system(r);
    if (code == DONE)
        code = stays_closed(k, q, equations_error(k), r->q);
    evaluate(k, q);
    return code == DONE && factor(r) == DONE;
}

/* Evaluate, choose and factor at q; UNSAFE where equations are not clearly independent. */
static int place(Rates *r, const Real *q, const Real *turns)
{
    Kernel *k = r->k;
    memcpy(k->turns, turns, (size_t)k->n_angles * sizeof(Real));
    evaluate(k, q);
    int code = choose(r);
    if (code == DONE)
        code = factor(r);
    if (code != DONE)
        return code;
    if (!(r->pivot > TOLERANCE_SINGULAR || r->even > WELL))
        return UNSAFE;
    return follow_beside(r, q) ? DONE : UNSAFE;
}

static int are_finite(const Real *x, Int n)
{
    for (Int i = 0; i < n; i++)
        if (!isfinite(x[i]))
            return 0;
    return 1;
}

/* Rates at q with speeds and accelerations (n_driven) of the driven freedoms.

   n_moving: the first driven freedoms, of which columns (n_moving, nv) are wanted: the others stand
   still; v, a: (nv); facts: (2) smallest over largest pivot, and the pace of the fastest joint. */
EXPORT int rates_solve(Rates *r, const Real *q, const Real *turns, Int n_moving, const Real *speed,
                       const Real *acceleration, Real *columns, Real *v, Real *a, Real *facts)
{
    const Int nv = r->k->nv;
    const int code = n_moving < 0 || n_moving > r->n_driven ? BAD_ARRAYS : place(r, q, turns);
    if (code != DONE)
        return code;
    const Real pace = solve_columns(r, n_moving, columns);
    memset(v, 0, (size_t)nv * sizeof(Real));
    for (Int c = 0; c < n_moving; c++)
        for (Int i = 0; i < nv; i++)
            v[i] += columns[c * nv + i] * speed[c];
    for (Int i = 0; i < r->n_driven; i++)
        if (!is_pin(r, i))
            v[r->driven[i]] = speed[i];
    solve_acceleration(r, v, acceleration, a);
    facts[0] = r->pivot;
    facts[1] = lost(r, v, pace);
    return are_finite(v, nv) && are_finite(a, nv) ? DONE : NOT_FINITE;
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

/* The closed-loop Jacobian (6, n) of a point fixed in a joint's body, for the first n driven
   freedoms: linear above angular, world axes. `local` (3) in the joint's axes; columns as above. */
EXPORT int rates_jacobian(Rates *r, const Real *q, const Real *turns, Int n, Int joint,
                          const Real *local, Real *columns, Real *jacobian)
{
    const Kernel *k = r->k;
    if (n < 0 || n > r->n_driven || joint < 0 || joint >= k->n_joints)
        return BAD_ARRAYS;
    const int code = place(r, q, turns);
    if (code != DONE)
        return code;
    solve_columns(r, n, columns);
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
