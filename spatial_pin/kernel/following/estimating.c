/* Error estimates of a path: of its points, and of samples that are interpolated between two of them.
 *
 * A point: q is off by what its equations magnify residuals and round-off to, and that changes t and c.
 * How much is told by solutions for an example, at one point of many, by the equations' second
 * derivatives.
 *
 * Hermite's polynomial of fifth degree misses (u (1 - u))^3 times the sixth derivative at a part u of a
 * step, over 720; that through a third point r steps before (u (1 - u) (u + r))^3 times the ninth, over
 * 9!. One correction tells what that is in the middle; of the rates it is told by derivatives. */
#include <string.h>
#include <float.h>

#include "interpolating.h"
#include "path.h"

#define ROUND_OFF_PART (4.0 * DBL_EPSILON) /* of an equation's value, and of its derivatives' */
#define CURVED_PART 0.1       /* third derivatives of equations by the cube of the rates, about */
#define OPEN_TIMES 2.0         /* times a residual: it may point where the equations are weak, example or not */
#define PROBED_POINTS 256        /* points whose errors are estimated by one of them, */
#define MUCH 1.5         /* unless rates have grown by so much, or pivots fallen */
#define SURE_TIMES 2.0         /* times the error in the middle, which factors of the end tell */
#define REMEMBERED 0.25  /* of the derivative before: in the middle it may just pass zero */
#define AIM 0.5          /* of the error allowed: it may grow from one step to the next */
#define STRAIGHT_BEND 1e-2 /* second derivative by the square of the rates below which a path is straight */
#define REST 0.1         /* of the way that the fastest joint goes, where prescribed values may come to rest */
#define GROWTH_POWER 2.4       /* of the way from one step to the next: the point before is to be near enough */
#define LONGEST_GUESS 1.0      /* way between two points */

/* What polynomials of fifth and of eighth degree miss, by the error e in the middle of a step h. */
typedef struct {
    Real order;        /* of second derivatives */
    Real rates, bends; /* up to so many e / h, e / h^2 */
    Real round_off;    /* second derivatives by errors of the points, over h^2 */
} Missed;
static const Missed MISSED[] = {{4.0, 3.43, 24.0, 12.0}, {7.0, 5.2, 41.0, 20.0}};

/* Change of t where q changes along u (nv), both scaled: the polar form (c(t + u) - c(t - u)) / 4 of the
   second derivatives, which are quadratic. Into k->right; returns its size. */
static Real response(Path *path, const Real *t, const Real *u)
{
    Kernel *k = path->k;
    Real *sum = path->middle.t, *half = path->middle.c;
    memset(half, 0, (size_t)k->nv * sizeof *half);
    for (int sign = 1; sign >= -1; sign -= 2) {
        for (Int v = 0; v < k->nv; v++)
            sum[v] = k->scale[v] * (t[v] + sign * u[v]);
        equations_bias(k, &k->equations.system, sum);
        for (Int i = 0; i < k->system.n_chosen; i++)
            half[i] -= 0.25 * sign * k->equations.bias[k->system.chosen[i]];
        for (Int i = 0; i < k->n_idle; i++)
            half[k->system.n_chosen + i] -= 0.25 * sign * k->equations.bias[k->n_closure + i];
    }
    memcpy(k->right, half, (size_t)k->nv * sizeof *half);
    system_solve(k, k->right);
    return norm(k->right, k->nv);
}

/* Of a configuration that is off where residuals are one, some this way, some that way, t is off by what
   changes it, and c by that twice, and by what changes with the bend. */
void probe_errors(Path *path)
{
    Kernel *k = path->k;
    const Point *here = path->here;
    Probe *p = &path->probe;
    Real *t = p->t, *u = p->along, *change = p->change;
    memset(k->right, 0, (size_t)k->nv * sizeof *k->right);
    for (Int i = 0; i < k->system.n_chosen; i++)
        k->right[i] = cos((Real)((i + 1) * (i + 1))) < 0.0 ? -1.0 : 1.0;
    system_solve(k, k->right);
    p->gain = norm(k->right, k->nv);
    path->rounding = round_off_of(k, here->q);
    p->pace = here->pace, p->bend = here->bend, p->pivot = k->system.pivot_ratio, p->rows = 0;
    p->first = p->second = 0.0;
    if (!(p->gain > 0.0))
        return;
    for (Int v = 0; v < k->nv; v++) {
        t[v] = here->t[v] / k->scale[v];
        u[v] = k->right[v] / p->gain;
    }
    p->first = response(path, t, u);
    memcpy(change, k->right, (size_t)k->nv * sizeof *change);
    p->second = 2.0 * response(path, t, change);
    for (Int v = 0; v < k->nv; v++)
        change[v] = here->c[v] / k->scale[v];
    p->second += response(path, change, u) + CURVED_PART * p->gain * here->pace * here->pace;
}

/* Whether errors may be magnified otherwise than where that was seen last. */
static int has_changed(const Path *path)
{
    const Probe *p = &path->probe;
    const Point *here = path->here;
    return p->rows >= PROBED_POINTS || here->pace > MUCH * p->pace || here->bend > MUCH * p->bend ||
           MUCH * path->k->system.pivot_ratio < p->pivot;
}

/* Returns what of q is not idle rotation. */
static Real estimate_point(Path *path, Real *estimate)
{
    const Point *here = path->here;
    Probe *p = &path->probe;
    if (!path->stale && has_changed(path))
        probe_errors(path);
    p->rows++;
    const Real t = here->pace, c = here->bend, turned = SURE_TIMES * path->idle_left;
    const Real q = SURE_TIMES * p->gain * (OPEN_TIMES * here->error + ROUND_OFF_PART + path->rounding);
    estimate[0] = q + turned + ROUND_OFF_PART;
    estimate[1] = p->first * q + t * (turned + (1.0 + p->gain) * 2.0 * DBL_EPSILON);
    estimate[2] = p->second * q + (t * t + c) * (turned + ROUND_OFF_PART);
    return q;
}

void estimate_here(Path *path, Real *estimate) { estimate_point(path, estimate); }

/* The error of q in the middle of an interpolated step, scaled: by one correction there, with the
   factors of its end. */
static Real missing_in_middle(Path *path, const Point *from)
{
    Kernel *k = path->k;
    const Point *to = path->here, *middle = &path->middle;
    const Real s = 0.5 * (from->s + to->s);
    between_at(k, &path->between, s, middle->q, middle->t, middle->c);
    prescribe(&path->prescribed, s);
    prescribed_put(&path->prescribed, middle->q);
    for (Int x = 0; x < k->n_angles; x++)
        k->angle_reference[x] = 0.5 * (from->angle[x] + to->angle[x]);
    equations_values(k, middle->q);
    path->stale = 1;
    return solve_correction(k, NULL);
}

static Real largest_rate(const Kernel *k, const Real *rate)
{
    Real most = 0.0;
    for (Int v = 0; v < k->nv; v++)
        most = larger_of(most, fabs(rate[v]) / k->scale[v]);
    return most;
}

Real estimate_between(Path *path, const Point *third, const Point *from, Real *estimate)
{
    const Kernel *k = path->k;
    const Point *to = path->here;
    const Real h = fabs(to->s - from->s), way = path->way;
    const Int degree = between_make(k, third, from, to, &path->between);
    const Missed *m = MISSED + (degree == BETWEEN_DEGREE);
    const Real missing = missing_in_middle(path, from), grown = pow(way, m->order + 2.0);
    const Real e = larger_of(missing, degree == path->degree ? REMEMBERED * path->missed * grown : 0.0);
    const Real t = h * larger_of(largest_rate(k, from->t), largest_rate(k, to->t)); /* of one joint */
    const Real c = h * h * larger_of(largest_rate(k, from->c), largest_rate(k, to->c));
    const Real first = larger_of(t, REST * way), second = larger_of(c, STRAIGHT_BEND * first * first);
    const Real rates = larger_of(m->rates * e / first, m->bends * e / second);
    const Real part = SURE_TIMES * larger_of(e, rates) / path->accuracy.between;
    const Real longer = pow(AIM / larger_of(part, 1e-30), 1.0 / m->order);
    const Real node = estimate_point(path, estimate);
    const Real noise = m->round_off * node / (second * path->accuracy.between);
    path->between_way = fmin(way * fmin(fmax(noise > 1.0 ? 0.0 : longer, 0.25), GROWTH_POWER), LONGEST_GUESS);
    path->missed = missing / grown;
    path->degree = degree;
    estimate[0] += SURE_TIMES * e;
    estimate[1] += (SURE_TIMES * m->rates * e + 2.0 * node) / h;
    estimate[2] += (SURE_TIMES * m->bends * e + m->round_off * node) / (h * h);
    return part + noise;
}
