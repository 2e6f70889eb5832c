/* Runge-Kutta methods: steps, error control and dense output.
 *
 * A method is one entry of METHODS: its coefficients (tableaus.h), how its error is estimated and
 * how the last step is interpolated. Adaptive steps are controlled as SciPy's: the error is the root
 * mean square of that of every unknown, by rtol times its size and atol. Whether stability, not
 * accuracy, bounds the steps is seen from two stages at one time [HairerWanner1996, IV.2].
 *
 * Gauss's method of two stages is implicit, of fourth order and symmetric: a reversible motion keeps
 * its energy for ever to the order of the step [HairerLubichWanner2006, II.1]. */
#include <string.h>

#include "dynamics.h"
#include "integrating.h"
#include "tableaus.h"

#define LONG_STEPS 15 /* steps at the bound of stability of a stiff motion [HairerWanner1996] */
#define SHORT_STEPS 6 /* steps well within it that tell that it is none */
#define SELDOM 5    /* steps from one look to the next */

typedef struct {
    Int stages;     /* of a step; the slope at its end comes after them */
    const Real (*a)[MOST_STAGES];
    const Real *b, *c;
    Real order;     /* of the error estimate; 0: the step is fixed */
    Real (*error)(const Integrator *, Real h);
    int (*prepare)(Integrator *); /* of dense output; NULL: nothing */
    void (*between)(const Integrator *, Real part, Real *y);
    Int first, second; /* two stages at one time, and the weights of their difference */
    Real stable;    /* longest stable step, by the fastest decay; 0: any is stable */
    Int patience;   /* steps beyond that before the motion is called stiff */
} Method;

/* ---- errors ---- */

static Real mean_square(const Integrator *g, const Real *weights, Int count)
{
    Real sum = 0.0;
    for (Int i = 0; i < g->n; i++) {
        Real error = 0.0;
        for (Int s = 0; s < count; s++)
            error += weights[s] * g->slope[s * g->n + i];
        error /= g->atol[i] + g->rtol * fmax(fabs(g->y[i]), fabs(g->ended[i]));
        sum += error * error;
    }
    return sum;
}

static Real error_of_853(const Integrator *g, Real h)
{
    const Real fifth = mean_square(g, DOP853_E5, 13), third = mean_square(g, DOP853_E3, 13);
    if (fifth == 0.0 && third == 0.0)
        return 0.0;
    return h * fifth / sqrt((fifth + 0.01 * third) * (Real)g->n);
}

static Real error_of_45(const Integrator *g, Real h)
{
    return h * sqrt(mean_square(g, RK45_E, 7) / (Real)g->n);
}

/* ---- dense output ---- */

static int ask(Integrator *g, Real t, const Real *y, Real *rates)
{
    g->evaluations++;
    return g->code = g->rates(g->context, t, y, rates);
}

/* y + h times the stages' slopes by a row of weights. */
static void combine(const Integrator *g, const Real *from, const Real *weights, Int count, Real h,
                    Real *out)
{
    for (Int i = 0; i < g->n; i++) {
        Real sum = 0.0;
        for (Int s = 0; s < count; s++)
            if (weights[s] != 0.0)
                sum += weights[s] * g->slope[s * g->n + i];
        out[i] = from[i] + h * sum;
    }
}

static int prepare_853(Integrator *g)
{
    const Real h = g->t - g->t_old;
    const Int n = g->n;
    for (Int s = 13; s < 16; s++) {
        combine(g, g->y_old, DOP853_A[s], s, h, g->trial);
        const int code = ask(g, g->t_old + DOP853_C[s] * h, g->trial, g->slope + s * n);
        if (code != DONE)
            return code;
    }
    for (Int i = 0; i < n; i++) {
        const Real moved = g->y[i] - g->y_old[i];
        const Real first = h * g->slope[i], last = h * g->slope[12 * n + i];
        g->dense[i] = moved;
        g->dense[n + i] = first - moved;
        g->dense[2 * n + i] = 2.0 * moved - (last + first);
        for (Int row = 0; row < 4; row++) {
            Real sum = 0.0;
            for (Int s = 0; s < 16; s++)
                sum += DOP853_D[row][s] * g->slope[s * n + i];
            g->dense[(3 + row) * n + i] = h * sum;
        }
    }
    return DONE;
}

static void between_853(const Integrator *g, Real part, Real *y)
{
    for (Int i = 0; i < g->n; i++) {
        Real sum = 0.0;
        for (int row = 6; row >= 0; row--)
            sum = (sum + g->dense[row * g->n + i]) * (row % 2 == 0 ? part : 1.0 - part);
        y[i] = g->y_old[i] + sum;
    }
}

static void between_45(const Integrator *g, Real part, Real *y)
{
    const Real h = g->t - g->t_old;
    Real weights[7];
    for (int s = 0; s < 7; s++)
        weights[s] = part * (RK45_P[s][0] + part * (RK45_P[s][1] + part * (RK45_P[s][2] +
                                                                        part * RK45_P[s][3])));
    combine(g, g->y_old, weights, 7, h, y);
}

/* Cubic Hermite. */
static void between_4(const Integrator *g, Real part, Real *y)
{
    const Real h = g->t - g->t_old;
    for (Int i = 0; i < g->n; i++) {
        const Real moved = g->y[i] - g->y_old[i];
        const Real first = h * g->slope[i], last = h * g->slope[4 * g->n + i];
        y[i] = g->y_old[i] + part * (first + part * (3.0 * moved - 2.0 * first - last +
                                                     part * (first + last - 2.0 * moved)));
    }
}

/* ---- Gauss's method ---- */

#define MOST_ITERATIONS 60 /* of stages, which halve their error where steps are not too long */
#define SETTLED_SLOPE 1e-10 /* change of a slope, times the step: what grows below it is round-off */

/* Slopes 3, 4 at the stages that slopes 1, 2 lead to; how far these change, in natural units. */
static int iterate_gauss(Integrator *g, Real h, Real *change)
{
    const Real apart = sqrt(3.0) / 6.0;
    const Real weights[2][3] = {{0.0, 0.25, 0.25 - apart}, {0.0, 0.25 + apart, 0.25}};
    const Int n = g->n;
    for (int s = 0; s < 2; s++) {
        combine(g, g->y, weights[s], 3, h, g->trial);
        const int code = ask(g, g->t + (s ? 0.5 + apart : 0.5 - apart) * h, g->trial,
                             g->slope + (3 + s) * n);
        if (code != DONE)
            return code;
    }
    *change = 0.0;
    for (Int i = 0; i < 2 * n; i++)
        *change = fmax(*change, h * fabs(g->slope[3 * n + i] - g->slope[n + i]) * g->rtol /
                                    g->atol[i % n]);
    memcpy(g->slope + n, g->slope + 3 * n, (size_t)(2 * n) * sizeof(Real));
    return DONE;
}

/* Slopes by fixed-point iteration to round-off, begun with those of the last step. */
static int try_gauss(Integrator *g, Real t_new, Real h)
{
    const size_t size = (size_t)g->n * sizeof(Real);
    Real last = INFINITY, change = 0.0;
    memcpy(g->slope, g->f, size);
    for (Int s = 1; g->steps == 0 && s < 3; s++)
        memcpy(g->slope + s * g->n, g->f, size);
    for (int i = 0; i < MOST_ITERATIONS; i++, last = change) {
        const int code = iterate_gauss(g, h, &change);
        if (code != DONE)
            return code;
        if ((change >= last && change < SETTLED_SLOPE) || change == 0.0)
            break;
    }
    combine(g, g->y, GAUSS_B, 3, h, g->ended);
    return ask(g, t_new, g->ended, g->slope + 4 * g->n);
}

/* ---- the table ---- */

static const Method METHODS[] = {
    {.stages = 12, .a = DOP853_A, .b = DOP853_B, .c = DOP853_C, .order = 7.0,
     .error = error_of_853, .prepare = prepare_853, .between = between_853,
     .first = 11, .second = 12, .stable = 6.1, .patience = LONG_STEPS},
    {.stages = 6, .a = RK45_A, .b = RK45_B, .c = RK45_C, .order = 4.0,
     .error = error_of_45, .between = between_45,
     .first = 5, .second = 6, .stable = 3.25, .patience = LONG_STEPS},
    {.stages = 4, .a = RK4_A, .b = RK4_B, .c = RK4_C, .between = between_4,
     .first = 1, .second = 2, .stable = 2.78, .patience = 2},
    {.stages = 4, .b = GAUSS_B, .between = between_4},
};
enum { N_METHODS = sizeof METHODS / sizeof *METHODS };

static const Method *method_of(const Integrator *g) { return METHODS + g->method; }

/* ---- stiffness ---- */

/* The fastest decay rate, from two stages at one time: |df| / |dy| of them. */
static void look_at_stiffness(Integrator *g, Real h)
{
    const Method *m = method_of(g);
    Real fast = 0.0, far = 0.0;
    for (Int i = 0; i < g->n; i++) {
        const Real unit = g->atol[i] / g->rtol, *k = g->slope + i;
        const Real rate = k[m->second * g->n] - k[m->first * g->n];
        Real place = 0.0;
        for (Int s = 0; s <= m->first; s++) {
            const Real later = m->second == m->stages ? m->b[s] : m->a[m->second][s];
            place += (later - m->a[m->first][s]) * k[s * g->n];
        }
        fast += rate * rate / (unit * unit);
        far += place * place / (unit * unit);
    }
    fast = h * sqrt(fast), far = h * sqrt(far);
    if (fast > m->stable * far && m->stable * far > 0.0) {
        g->many_long++;
        g->many_short = 0;
        if (g->many_long >= m->patience)
            g->is_stiff = 1;
    } else if (++g->many_short >= SHORT_STEPS)
        g->many_long = 0;
}

/* ---- steps ---- */

/* Stages, the end and the slope there of a step h; LOST where one cannot be evaluated. */
static int try_step(Integrator *g, Real t_new, Real h)
{
    const Method *m = method_of(g);
    if (!m->a)
        return try_gauss(g, t_new, h);
    memcpy(g->slope, g->f, (size_t)g->n * sizeof *g->f);
    for (Int s = 1; s < m->stages; s++) {
        combine(g, g->y, m->a[s], s, h, g->trial);
        const int code = ask(g, g->t + m->c[s] * h, g->trial, g->slope + s * g->n);
        if (code != DONE)
            return code;
    }
    combine(g, g->y, m->b, m->stages, h, g->ended);
    return ask(g, t_new, g->ended, g->slope + m->stages * g->n);
}

static void accept(Integrator *g, Real t_new)
{
    const Method *m = method_of(g);
    g->t_old = g->t;
    g->t = t_new;
    memcpy(g->y_old, g->y, (size_t)g->n * sizeof *g->y);
    memcpy(g->y, g->ended, (size_t)g->n * sizeof *g->y);
    memcpy(g->f, g->slope + m->stages * g->n, (size_t)g->n * sizeof *g->f);
    g->is_dense = 0;
    g->steps++;
    if (m->stable == 0.0)
        return;
    if (m->order == 0.0 || g->many_long > 0 || g->steps % SELDOM == 0)
        look_at_stiffness(g, g->t - g->t_old);
}

static void fixed_step(Integrator *g)
{
    const Real h = (g->t_end - g->t_begin) / (Real)g->count;
    const Int done = g->done + 1;
    const Real t_new = done < g->count ? g->t_begin + (Real)done * h : g->t_end;
    if (try_step(g, t_new, h) != DONE) {
        g->status = FAILED;
        return;
    }
    g->done = done;
    accept(g, t_new);
    g->status = done < g->count ? RUNNING : FINISHED;
}

static void adaptive_step(Integrator *g)
{
    const Method *m = method_of(g);
    const Real shortest = 10.0 * (nextafter(g->t, INFINITY) - g->t);
    Real h = fmax(fmin(g->next, g->longest), shortest);
    for (int rejected = 0;; rejected = 1) {
        if (h < shortest) {
            g->status = FAILED;
            return;
        }
        const Real t_new = g->t + h < g->t_end ? g->t + h : g->t_end;
        const Real span = t_new - g->t;
        const int code = try_step(g, t_new, span);
        if (code == CALLBACK_FAILED) {
            g->status = FAILED;
            return;
        }
        const Real error = code == DONE ? m->error(g, span) : NAN;
        const Real factor = error == 0.0 ? 10.0 : 0.9 * pow(error, -1.0 / (m->order + 1.0));
        if (error < 1.0) {
            g->next = span * fmin(factor, rejected ? 1.0 : 10.0);
            accept(g, t_new);
            g->status = t_new < g->t_end ? RUNNING : FINISHED;
            return;
        }
        h = span * (factor > 0.2 ? factor : 0.2); /* 0.2 for an error that is no number */
    }
}

int integrator_step(Integrator *g)
{
    g->code = DONE;
    if (method_of(g)->order == 0.0)
        fixed_step(g);
    else
        adaptive_step(g);
    return g->code == CALLBACK_FAILED ? CALLBACK_FAILED : DONE;
}

EXPORT int integrator_between(Integrator *g, const Real *times, Int count, Real *y)
{
    const Method *m = method_of(g);
    if (!g->is_dense && m->prepare) {
        const int code = m->prepare(g);
        if (code != DONE)
            return code;
    }
    g->is_dense = 1;
    const Real h = g->t - g->t_old;
    for (Int i = 0; i < count; i++)
        m->between(g, (times[i] - g->t_old) / h, y + i * g->n);
    return DONE;
}

/* ---- beginning ---- */

EXPORT int integrator_begin(Integrator *g, const Real *y, const Real *atol, Real *room, Int n_room)
{
    const Int n = g->n;
    if (g->method < 0 || g->method >= N_METHODS || n < 1 || n_room < n * (MOST_STAGES + 14))
        return BAD_ARRAYS;
    Real **parts[] = {&g->y, &g->y_old, &g->f, &g->atol, &g->trial, &g->ended};
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++, room += n)
        *parts[i] = room;
    g->dense = room;
    g->slope = room + 7 * n;
    g->t_old = g->t_begin = g->t;
    g->count = (Int)g->next;
    g->rates = g->rates ? g->rates : dynamics_rates;
    memcpy(g->y, y, (size_t)n * sizeof *y);
    memcpy(g->y_old, y, (size_t)n * sizeof *y);
    memcpy(g->atol, atol, (size_t)n * sizeof *atol);
    const int code = ask(g, g->t, y, g->f);
    if (code != DONE)
        g->status = FAILED;
    return code == CALLBACK_FAILED ? CALLBACK_FAILED : DONE;
}
