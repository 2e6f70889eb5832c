/* Velocities and accelerations of all joints at given rates of driven freedoms: K v = drive,
 * K a = drive' - bias(v), and whatever else the same K answers. K holds independent closure
 * equations, idle rotations, driven coordinates, and rows that fill it up: passive freedoms that nothing
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
   relative to the lengths of their rows, where it is clear which are independent. */
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
    Int n_moving;     /* the first driven freedoms, which move: the others do not */
    const Int *driven; /* freedoms v, or nv + v for the component that v is of, see pins.h */
    Pin *pin;         /* (n_driven) of those that are components */
    Int *chosen;      /* closure equations, ascending */
    Int n_constant;   /* closure equations that no motion changes, as a planar loop's out of its plane */
    Factors *matrix;  /* K */
    Real *columns;    /* (n_moving, nv) joint velocities per unit speed of each that moves */
    Real *x;          /* (nv) */
    Real *turned, *polar; /* (nv) of a derivative of a Jacobian */
    Real *derivative; /* (n_equations) */
    Real *away, *along, *change, *sum; /* (nv) to tell what round-off leaves */
    Real *q;          /* (nq) */
    int is_placed;    /* whether K is that of a configuration */
};

static int make_room(Rates *r)
{
    Kernel *k = r->k;
    r->chosen = kernel_ints(k, k->n_closure);
    r->columns = kernel_reals(k, r->n_moving * k->nv);
    r->x = kernel_reals(k, k->nv);
    r->turned = kernel_reals(k, k->nv);
    r->polar = kernel_reals(k, k->nv);
    r->derivative = kernel_reals(k, k->n_equations);
    r->away = kernel_reals(k, k->nv);
    r->along = kernel_reals(k, k->nv);
    r->change = kernel_reals(k, k->nv);
    r->sum = kernel_reals(k, k->nv);
    r->q = kernel_reals(k, k->nq);
    r->matrix = factors_new(k);
    return kernel_had_memory(k) && r->matrix ? DONE : NO_MEMORY;
}

/* How many equations are constant: their derivatives vanish at configurations where no loop is closed.
   A function of the caller may have no value there, and is not evaluated. */
static Int count_constant(Rates *r)
{
    Kernel *k = r->k;
    Int n = 0;
    if (k->quantities.n_functions)
        return 0;
    memset(r->q, 0, (size_t)k->nq * sizeof(Real));
    for (Int j = 1; j < k->n_joints; j++)
        if (k->kind[j] >= BALL)
            r->q[k->iq[j] + joint_nq(k->kind[j]) - 1] = 1.0;
    for (Int v = 0; v < k->nv; v++)
        r->x[v] = k->scale[v] * cos(1.0 + (Real)v);
    tree_integrate(k, r->q, r->x);
    equations_values(k, r->q);
    equations_jacobian(k, &k->equations.all);
    for (Int i = 0; i < k->n_closure; i++)
        n += !(equation_length(k, i) > TOLERANCE_ZERO);
    return n;
}

EXPORT int rates_create(Kernel *k, const Int *driven, Int n_driven, Int n_moving, Rates **out)
{
    *out = NULL;
    if (n_driven < 0 || n_moving < 0 || n_moving > n_driven)
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
    r->k = k, r->n_driven = n_driven, r->n_moving = n_moving, r->driven = copy, r->pin = pin;
    r->wanted = k->nv - k->n_idle - n_driven;
    if (make_room(r) != DONE)
        return NO_MEMORY;
    r->n_constant = count_constant(r);
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

/* Where the rows, and right sides, of driven coordinates begin. */
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

/* Joint velocities for a unit speed of each driven freedom that moves; returns how fast the fastest
   joint is, relative to the driven one. */
static Real solve_columns(Rates *r)
{
    const Kernel *k = r->k;
    Real pace = 1.0;
    for (Int c = 0; c < r->n_moving; c++) {
        const Real own = driven_scale(r, c);
        Real *x = r->columns + c * k->nv;
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
   of the driven freedoms. */
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

/* Whether a configuration closed to round-off loses no more than is known without velocities. */
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
   not closed to round-off, as those of motions, is off by its closure error. */
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

/* A bound of it without the velocities, where the fastest joint moves `pace` times as fast as the
   drivers. */
static Real known_round_off(const Rates *r, Real pace)
{
    return fmin(1.0, SOLUTION_ERROR * pace * fmax(pace, 1.0 / fmax(r->matrix->pivot, 1e-300)));
}

/* ---------------------------------------------------------------- rates of one configuration */

/* Whether equations that are left out hold near q too, as constant ones do. Comes back to q. */
static int follow_beside(Rates *r, const Real *q)
{
    Kernel *k = r->k;
    if (r->n_chosen + r->n_constant == k->n_closure || r->n_chosen == k->nv)
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

/* Velocities and accelerations at the factored configuration, for rates of the driven freedoms, and
   their errors by round-off: into row `at`. */
static int put_rates(Rates *r, const RateTask *task, Int at, Real pace)
{
    const Int nv = r->k->nv;
    const Real *speed = task->speed + at * r->n_driven;
    Real *v = task->v + at * nv, *a = task->a + at * nv, *facts = task->facts + 3 * at;
    memset(v, 0, (size_t)nv * sizeof(Real));
    for (Int c = 0; c < r->n_moving; c++)
        for (Int i = 0; i < nv; i++)
            v[i] += r->columns[c * nv + i] * speed[c];
    for (Int i = 0; i < r->n_driven; i++)
        if (!is_pin(r, i))
            v[r->driven[i]] = speed[i];
    memset(r->x, 0, (size_t)nv * sizeof(Real));
    add_bias(r, v, -1.0, r->x);
    answer(r, task->acceleration + at * r->n_driven, a);
    facts[2] = known_round_off(r, pace);
    facts[1] = round_off(r, v, facts[2]);
    return are_finite(v, nv) && are_finite(a, nv) ? DONE : NOT_FINITE;
}

/* ---------------------------------------------------------------- Jacobians of a frame

   J of what moves, and its rate along joint velocities v. Derivatives D_u of a Jacobian A of the tree
   or of its equations along joint velocities u come from accelerations, which are quadratic in them:
   D_u A w + D_w A u is their polar form, and D_u A w - D_w A u follows from the bracket of the
   joints' velocities and that of angular velocities [MurrayLiSastry1994, A]. */

/* Twist (6) of a point an arm away from a joint's origin, for joint velocities (nv). */
static void twist(const Kernel *k, Int joint, const Real *arm, const Real *v, Real *out)
{
    Real point[3], around[3];
    zero3(out);
    zero3(out + 3);
    for (Int j = joint; j > 0; j = k->parent[j])
        for (Int i = k->iv[j]; i < k->iv[j] + joint_nv(k->kind[j]); i++) {
            add3(v[i], k->linear + 3 * i, out);
            add3(v[i], k->angular + 3 * i, out + 3);
        }
    copy3(k->p + 3 * joint, point);
    add3(1.0, arm, point);
    cross3(out + 3, point, around);
    add3(1.0, around, out);
}

/* out += factor times the classical acceleration (6) of the point at no joint acceleration, for the
   joint velocities of the last bias. */
static void add_acceleration(const Kernel *k, Int joint, const Real *arm, Real factor, Real *out)
{
    const Real *omega = k->omega + 3 * joint, *alpha = k->alpha + 3 * joint;
    Real turning[3], more[3];
    if (!joint)
        return;
    add3(factor, k->acceleration + 3 * joint, out);
    cross3(alpha, arm, more);
    add3(factor, more, out);
    cross3(omega, arm, turning);
    cross3(omega, turning, more);
    add3(factor, more, out);
    add3(factor, alpha, out + 3);
}

/* Lie bracket (nv) of joint velocities, zero except for balls and floating joints. */
static void bracket(const Kernel *k, const Real *u, const Real *w, Real *out)
{
    memset(out, 0, (size_t)k->nv * sizeof(Real));
    for (Int j = 1; j < k->n_joints; j++) {
        if (k->kind[j] < BALL)
            continue;
        const Int at = k->iv[j], turn = at + (k->kind[j] == FREE ? 3 : 0);
        cross3(u + turn, w + turn, out + turn);
        if (turn > at) {
            Real more[3];
            cross3(u + turn, w + at, out + at);
            cross3(u + at, w + turn, more);
            add3(1.0, more, out + at);
        }
    }
}

/* Asymmetry (n_equations) of the equations' second derivatives, along u and w with the bracket in
   r->turned. The spin about a line fixed in a body is not a function of the configuration: the
   body's angular velocities have a bracket of their own. */
static void put_asymmetry(Rates *r, const Real *u, const Real *w)
{
    const Kernel *k = r->k;
    const Real arm[3] = {0.0, 0.0, 0.0};
    for (Int i = 0; i < k->n_equations; i++) {
        Real sum = 0.0;
        for (Int e = k->entry_start[i]; e < k->entry_start[i + 1]; e++)
            sum += k->entry[e] * r->turned[k->entry_v[e]] / k->scale[k->entry_v[e]];
        r->derivative[i] = sum;
    }
    for (Int i = k->n_closure; i < k->n_equations; i++) {
        const Int product = k->equations.product[i];
        const Int body = k->vectors.body[k->products.b_term[2 * product]];
        Real first[6], second[6], turned[3];
        twist(k, body, arm, u, first);
        twist(k, body, arm, w, second);
        cross3(first + 3, second + 3, turned);
        r->derivative[i] -= dot3(k->products.B + 3 * product, turned);
    }
}

/* Rate (6) of a column w of the closed-loop Jacobian, along joint velocities v. */
static void put_column_rate(Rates *r, Int joint, const Real *arm, const Real *v, const Real *w,
                            Real *out)
{
    Kernel *k = r->k;
    const Int nv = k->nv;
    Real moved[6], first[6], second[6], turned[3];
    memset(out, 0, 6 * sizeof(Real));
    memset(r->x, 0, (size_t)nv * sizeof(Real));
    bracket(k, v, w, r->turned);
    put_asymmetry(r, v, w);
    add_equations(r, r->derivative, -0.5, r->x);
    for (int sign = 1; sign >= -1; sign -= 2) {
        for (Int i = 0; i < nv; i++)
            r->sum[i] = v[i] + sign * w[i];
        add_bias(r, r->sum, -0.25 * sign, r->x);
        add_acceleration(k, joint, arm, 0.25 * sign, out);
    }
    factors_solve(r->matrix, 1, r->x);
    for (Int i = 0; i < nv; i++)
        r->polar[i] = k->scale[i] * r->x[i];
    for (Int i = 0; i < r->n_driven; i++)
        if (!is_pin(r, i))
            r->polar[r->driven[i]] = 0.0;
    for (Int i = 0; i < nv; i++)
        r->polar[i] += 0.5 * r->turned[i];
    twist(k, joint, arm, r->polar, moved);
    twist(k, joint, arm, v, first);
    twist(k, joint, arm, w, second);
    cross3(first + 3, second + 3, turned);
    for (int i = 0; i < 6; i++)
        out[i] += moved[i] + (i < 3 ? 0.0 : 0.5 * turned[i - 3]);
}

/* The wanted Jacobians of the frame, into row `at`. */
static void put_jacobians(Rates *r, const RateTask *task, Int at)
{
    const Kernel *k = r->k;
    const Int n = r->n_moving;
    Real arm[3], column[6];
    rotate3(k->R + 9 * task->joint, task->local, arm);
    for (Int c = 0; c < n; c++) {
        const Real *w = r->columns + c * k->nv;
        if (task->jacobian) {
            twist(k, task->joint, arm, w, column);
            for (int i = 0; i < 6; i++)
                task->jacobian[(6 * at + i) * n + c] = column[i];
        }
        if (task->jacobian_rate) {
            put_column_rate(r, task->joint, arm, task->motion + at * k->nv, w, column);
            for (int i = 0; i < 6; i++)
                task->jacobian_rate[(6 * at + i) * n + c] = column[i];
        }
    }
}

/* ---------------------------------------------------------------- influence coefficients */

/* First order (nv, n_moving), into row `at`. */
static void put_columns(const Rates *r, Int at, Real *out)
{
    const Int nv = r->k->nv, n = r->n_moving;
    for (Int c = 0; c < n; c++)
        for (Int v = 0; v < nv; v++)
            out[(at * nv + v) * n + c] = r->columns[c * nv + v];
}

/* Second order (nv, n_moving, n_moving), into row `at`: the acceleration at no drive is a quadratic
   form a, polarised: (a(u + w) - a(u) - a(w)) / 2 [BenedictTesar1978]. */
static void put_second(Rates *r, Int at, Real *out)
{
    const Kernel *k = r->k;
    const Int nv = k->nv, n = r->n_moving;
    for (Int c = 0; c < n; c++)
        for (Int d = c; d >= 0; d--) {
            memset(r->x, 0, (size_t)nv * sizeof(Real));
            for (Int v = 0; v < nv; v++)
                r->sum[v] = r->columns[c * nv + v] + (d < c ? r->columns[d * nv + v] : 0.0);
            add_bias(r, r->sum, -1.0, r->x);
            factors_solve(r->matrix, 1, r->x);
            for (Int i = 0; i < r->n_driven; i++)
                if (!is_pin(r, i))
                    r->x[r->driven[i]] = 0.0;
            for (Int v = 0; v < nv; v++) {
                Real *row = out + (at * nv + v) * n * n, a = k->scale[v] * r->x[v];
                if (d < c)
                    a = 0.5 * (a - row[c * n + c] - row[d * n + d]);
                row[c * n + d] = row[d * n + c] = a;
            }
        }
}

/* ---------------------------------------------------------------- what Python calls */

/* Row `at` of a task; the code of `RateTask`. */
static int solve_row(Rates *r, const RateTask *task, Int at)
{
    Kernel *k = r->k;
    const Real *q = task->q + at * k->nq;
    equations_values_near(k, q, task->reference + at * k->n_angles);
    equations_jacobian(k, &k->equations.all);
    int code = task->equations ? take_and_factor(r, task) : choose_and_factor(r, q);
    r->is_placed = code == DONE;
    if (task->facts)
        task->facts[3 * at] = r->matrix->pivot;
    if (code != DONE)
        return code;
    const Real pace = solve_columns(r);
    if (task->columns)
        put_columns(r, at, task->columns);
    if (task->second)
        put_second(r, at, task->second);
    if (task->local)
        put_jacobians(r, task, at);
    return task->speed ? put_rates(r, task, at, pace) : DONE;
}

EXPORT int rates_solve(Rates *r, const RateTask *task)
{
    if (task->n < 0 || (task->local && !within(task->joint, r->k->n_joints)))
        return BAD_ARRAYS;
    for (Int i = 0; i < task->n; i++) {
        const int code = solve_row(r, task, i);
        if (code == BAD_ARRAYS || code == NO_MEMORY)
            return code;
        task->code[i] = code;
    }
    return DONE;
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
