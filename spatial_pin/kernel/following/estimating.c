/* Error estimates of a path: of its points, and of samples that are interpolated between two of them.
 *
 * A point: q is off by what its equations magnify residuals and round-off to, and that changes t and c.
 * The size of this change is estimated at one point of many, by solving for an example with the
 * equations' second derivatives.
 *
 * Hermite's polynomial of fifth degree misses (u (1 - u))^3 times the sixth derivative at a part u of a
 * step, over 720; that through a third point r steps before (u (1 - u) (u + r))^3 times the ninth, over
 * 9!. One correction measures this error in the middle; derivatives give that of the rates. */
#include <string.h>
#include <float.h>

#include "interpolating.h"
#include "path.h"

#define ROUND_OFF_PART (2.0 * DBL_EPSILON) /* of an equation's value, and of its derivatives' */
#define PROBES 2              /* examples of residuals: one alone may be one that matters little */
#define THIRD_STEP 1e-4       /* of a difference of second derivatives [rad] */
#define RESOLVED_PART 0.25    /* of what round-off of q may leave at most */
#define OPEN_TIMES 3.0         /* times a residual: it may point where the equations are weak, example or not */
#define PROBED_POINTS 256        /* points whose errors are estimated by one of them, */
#define MUCH 1.5         /* unless rates have grown by so much, or pivots fallen */
#define SURE_TIMES 2.0         /* times the error in the middle: it may be largest elsewhere */
#define BEND_BY_MISSED 16.0 /* second derivative of (u (1 - u))^3 in the middle by its value is -24; with a third
                               point 0.4 steps before, -16.6 */
#define REMEMBERED 0.25  /* of the derivative before: in the middle it may just pass zero */
#define AIM 0.5          /* of the error allowed: it may grow from one step to the next */
#define STRAIGHT_BEND 1e-2 /* second derivative by the square of the rates below which a path is straight */
#define BETWEEN_PART 0.17 /* of the bound of a point's error that shows between points: where there is one
                            equation, SURE_TIMES and OPEN_TIMES make the bound six times the error */
#define LEAST_CHANGE 0.3 /* of rates, by errors of q: a probe may be where these change them little */
#define NODE_RATES 6.0   /* the same of rates, by the step */
#define REST 0.1         /* of the way that the fastest joint goes, where prescribed values may come to rest */
#define GROWTH_POWER 2.4       /* of the way from one step to the next: the point before is to be near enough */
#define LONGEST_GUESS 1.0      /* way between two points */

/* What polynomials of fifth and of eighth degree miss, by the error e in the middle of a step h. */
typedef struct {
    Real order;        /* of second derivatives */
    Real rates, bends; /* at most these multiples of e / h, e / h^2 */
    Real round_off;    /* second derivatives by errors of the points, over h^2 */
} Missed;
static const Missed MISSED[] = {{4.0, 3.43, 24.0, 12.0}, {7.0, 5.2, 41.0, 20.0}};

/* Add second derivatives along a and b (nv), scaled, times a factor, to a right side: by the polar form
   of the quadratic terms, (c(a + b) - c(a - b)) / 4. */
static void add_second(Path *path, const Real *a, const Real *b, Real factor, Real *right)
{
    Kernel *k = path->k;
    Real *sum = path->middle.t;
    for (int sign = 1; sign >= -1; sign -= 2) {
        for (Int v = 0; v < k->nv; v++)
            sum[v] = k->scale[v] * (a[v] + sign * b[v]);
        system_add_bias(k, sum, 0.25 * sign * factor, right);
    }
}

/* Subtract third derivatives along the path's t, twice, and along u (nv), scaled, from a right side: by a
   difference. */
static void subtract_third(Path *path, const Real *u, Real *right)
{
    Kernel *k = path->k;
    const Point *here = path->here;
    Real *q = path->middle.q, *step = path->middle.t;
    system_add_bias(k, here->t, 1.0 / THIRD_STEP, right);
    for (Int v = 0; v < k->nv; v++)
        step[v] = THIRD_STEP * k->scale[v] * u[v];
    memcpy(q, here->q, (size_t)k->nq * sizeof *q);
    tree_integrate(k, q, step);
    equations_values_near(k, q, here->angle);
    system_add_bias(k, here->t, -1.0 / THIRD_STEP, right);
    equations_values_near(k, here->q, here->angle);
}

/* Let x be what J x = right (nv) has as its solution; returns its size. */
static Real magnified(Kernel *k, const Real *right, Real *x)
{
    memcpy(k->right, right, (size_t)k->nv * sizeof *x);
    system_solve(k, k->right);
    memcpy(x, k->right, (size_t)k->nv * sizeof *x);
    return norm(x, k->nv);
}

/* An example: residuals of one, with signs by a phase. q is off along u, then t by what solves
   J dt = -f''(u, t), and c by J dc = -(f'''(u, t, t) + 2 f''(t, dt) + f''(u, c)). */
static void probe_example(Path *path, Real phase)
{
    Kernel *k = path->k;
    const Point *here = path->here;
    Probe *p = &path->probe;
    Real *u = p->along, *dt = p->change, *right = path->middle.c;
    const size_t size = (size_t)k->nv * sizeof *u;
    memset(right, 0, size);
    for (Int i = 0; i < k->system.n_chosen; i++)
        right[i] = cos((Real)((i + 1) * (i + 1)) + phase) < 0.0 ? -1.0 : 1.0;
    const Real gain = magnified(k, right, u);
    if (!(gain > 0.0))
        return;
    for (Int v = 0; v < k->nv; v++) {
        p->t[v] = here->t[v] / k->scale[v];
        p->c[v] = here->c[v] / k->scale[v];
        u[v] /= gain;
    }
    memset(right, 0, size);
    add_second(path, p->t, u, -1.0, right);
    p->first = larger_of(p->first, magnified(k, right, dt));
    memset(right, 0, size);
    add_second(path, p->t, dt, -2.0, right);
    add_second(path, p->c, u, -1.0, right);
    subtract_third(path, u, right);
    p->gain = larger_of(p->gain, gain);
    p->second = larger_of(p->second, magnified(k, right, dt));
}

void probe_errors(Path *path)
{
    const Point *here = path->here;
    Probe *p = &path->probe;
    path->rounding = round_off_of(path->k, here->q);
    p->pace = here->pace, p->bend = here->bend, p->pivot = path->k->system.pivot_ratio, p->rows = 0;
    p->gain = p->first = p->second = 0.0;
    for (int i = 0; i < PROBES; i++)
        probe_example(path, (Real)i);
}

/* Whether errors may be magnified otherwise than where that was seen last. */
static int has_changed(const Path *path)
{
    const Probe *p = &path->probe;
    const Point *here = path->here;
    return p->rows >= PROBED_POINTS || here->pace > MUCH * p->pace || here->bend > MUCH * p->bend ||
           MUCH * path->k->system.pivot_ratio < p->pivot;
}

void look_again(Path *path)
{
    if (!path->stale && has_changed(path))
        probe_errors(path);
}

Real estimate_at(Path *path, Real t, Real c, Real error, Real *estimate)
{
    Probe *p = &path->probe;
    p->rows++;
    const Real turned = SURE_TIMES * path->idle_left;
    const Real open = OPEN_TIMES * error + ROUND_OFF_PART + RESOLVED_PART * path->rounding;
    const Real q = SURE_TIMES * p->gain * open, solved = turned + (1.0 + p->gain) * ROUND_OFF_PART;
    estimate[0] = q + turned + ROUND_OFF_PART + RESOLVED_PART * path->rounding;
    estimate[1] = larger_of(p->first, LEAST_CHANGE * t) * q + t * solved;
    estimate[2] = larger_of(p->second, LEAST_CHANGE * (t * t + c)) * q + (t * t + c) * solved;
    return q;
}

Real estimate_here(Path *path, Real *estimate)
{
    look_again(path);
    return estimate_at(path, path->here->pace, path->here->bend, path->here->error, estimate);
}

/* The error of q in the middle of a step h, scaled, by that of second derivatives there: it is what a correction
   finds, and idle rotations as well, which no residual shows. */
static Real missing_by_bend(Path *path, Real h)
{
    Kernel *k = path->k;
    const Point *middle = &path->middle;
    Real square = 0.0;
    system_put_accelerations(k, middle->t, path->prescribed.bend);
    system_solve(k, k->right);
    for (Int v = 0; v < k->nv; v++) {
        const Real off = k->right[v] - middle->c[v] / k->scale[v];
        square += off * off;
    }
    return sqrt(square) * h * h / BEND_BY_MISSED;
}

/* The error of q in the middle of an interpolated step, scaled, by one correction there: with its own factors,
   as those of an end may magnify errors less. INFINITY where it is singular. */
static Real missing_in_middle(Path *path, const Point *from)
{
    Kernel *k = path->k;
    const Point *to = path->here, *middle = &path->middle;
    const Real s = 0.5 * (from->s + to->s);
    between_at(k, &path->between, &s, 1, middle->q, middle->t, middle->c, k->angle_reference);
    prescribe(&path->prescribed, s);
    prescribed_put(&path->prescribed, middle->q);
    equations_values(k, middle->q);
    equations_jacobian(k, &k->equations.system);
    path->stale = 1;
    if (system_factor(k) != DONE)
        return INFINITY;
    const Real corrected = solve_correction(k, NULL);
    return k->n_idle ? larger_of(corrected, missing_by_bend(path, to->s - from->s)) : corrected;
}

static Real largest_rate(const Kernel *k, const Real *rate)
{
    Real most = 0.0;
    for (Int v = 0; v < k->nv; v++)
        most = larger_of(most, fabs(rate[v]) / k->scale[v]);
    return most;
}

/* What an error in the middle of a step may leave, of q, and of rates by their size. */
static Real part_of(const Missed *m, Real e, Real first, Real second)
{
    return SURE_TIMES * larger_of(e, larger_of(m->rates * e / first, m->bends * e / second));
}

Real estimate_between(Path *path, const Point *third, const Point *from, Real *estimate)
{
    const Kernel *k = path->k;
    const Point *to = path->here;
    const Real h = fabs(to->s - from->s), way = path->way, allowed = path->accuracy.between;
    between_make(k, third, from, to, &path->between);
    const Int degree = path->between.degree;
    const Missed *m = MISSED + (degree == BETWEEN_DEGREE);
    const Real missing = missing_in_middle(path, from), grown = pow(way, m->order + 2.0);
    if (!isfinite(missing)) {
        path->between_way = 0.5 * way;
        return INFINITY;
    }
    Real e = larger_of(missing, degree == path->degree ? REMEMBERED * path->missed * grown : 0.0);
    const Real open = missing > 0.0 ? equations_error(k) / missing : 0.0;
    const Real t = h * larger_of(largest_rate(k, from->t), largest_rate(k, to->t)); /* of one joint */
    const Real c = h * h * larger_of(largest_rate(k, from->c), largest_rate(k, to->c));
    const Real first = larger_of(t, REST * way), second = larger_of(c, STRAIGHT_BEND * first * first);
    Real part = part_of(m, e, first, second) / allowed;
    const Real longer = pow(AIM / larger_of(part, 1e-30), 1.0 / m->order);
    const Real node = BETWEEN_PART * estimate_here(path, estimate);
    /* Noise falls with the square of the distance, as far as a third point allows. The missing part
       does not grow where it is noise too. Where no distance will do, none is tried soon. */
    const Real noise = m->round_off * node / (second * allowed);
    const int is_noise = missing <= node + 0.3 * h * estimate[1] + 0.03 * h * h * estimate[2];
    const Real reached = third ? third_reaches(third, from, to->s - from->s) / h : 0.0;
    const Real room = third ? larger_of(reached, SOONEST / way) : 1.0;
    const Real most = fmin(GROWTH_POWER, room);
    const Real shorter = smaller_of(longer, 1.0);
    const Real best = noise <= shorter * shorter ? longer : is_noise && noise < most * most ? most : 1.0;
    path->between_way = fmin(way * fmin(fmax(best, 0.25), GROWTH_POWER), LONGEST_GUESS);
    const Real last = degree == path->degree ? path->missed : 0.0; /* round-off tells no more than that */
    path->missed = is_noise ? smaller_of(last, missing / grown) : missing / grown;
    path->degree = degree;
    /* A polynomial of fifth degree takes less time, where the third point makes little of it. */
    const Real without = SURE_TIMES * (e + path->between.third);
    if (degree == BETWEEN_DEGREE && part_of(m, without, first, second) <= AIM * allowed) {
        e = without, part = part_of(m, e, first, second) / allowed;
        between_make(k, NULL, from, to, &path->between);
    }
    path->between_open = SURE_TIMES * open * e + larger_of(from->error, to->error);
    estimate[0] += SURE_TIMES * e;
    estimate[1] += (SURE_TIMES * m->rates * e + NODE_RATES * node) / h;
    estimate[2] += (SURE_TIMES * m->bends * e + m->round_off * node) / (h * h);
    return part + noise;
}
