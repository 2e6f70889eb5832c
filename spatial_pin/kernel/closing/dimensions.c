/* Many mechanisms that differ in their dimensions, each closed near a configuration of its own.
 *
 * A sample is a set of numbers in the place of the kernel's own. It is closed from where it starts
 * by the least motion (closing.c), as one mechanism alone would be; then its rates follow from the
 * square system of `system_set`, K v = drive and K a = drive' - bias(v). Whether it is on the
 * branch of its start, the caller judges by these results: how far it has gone, how much of
 * the motion the linear equations at its end leave unexplained, and the determinant. */
#include <string.h>

#include "closing.h"
#include "relative.h"

/* The record of a sample. */
typedef struct {
    Real error;           /* closure error */
    Real farthest, way;   /* of a joint, and of all together [rad, characteristic lengths] */
    Real sign, magnitude; /* of the determinant, 0 of a singular one; its natural logarithm */
    Real bend;            /* by how much the way is bent */
    Real opened;          /* part of the rates by which equations left out would open */
} Facts;

/* Samples and what becomes of them, m of each: as `_DimensionStruct` in dimensions.py. */
typedef struct {
    const Int *chosen;  /* (n_chosen) equations of the square system, as system_set has them */
    const Int *driven;  /* (n_driven) */
    const Real *fill;   /* (n_fill, nv) */
    const Real *base;   /* (n_reals + 3 n_points) numbers, then points in the axes of their joints */
    const Int *varied_index; /* (n_varied) which of them differ from sample to sample */
    const Real *varied; /* (m, n_varied) */
    const Int *free;    /* (nv) velocities that may move */
    const Int *joint;   /* (n_points) that carry the points */
    const Real *speed, *acceleration; /* (n_driven) of the driven freedoms; NULL: nothing moves */
    Real *q;            /* (m, nq) starts, then closed */
    Real *angle;        /* (m, n_angles) from which angles of screws count, then those reached */
    Real *v, *a;        /* (m, nv) */
    Real *point;        /* (m, n_points, 5, 3) position, velocity, acceleration, w, w' */
    Facts *fact;        /* (m) */
    Int n_chosen, n_driven, n_fill, n_reals, n_varied, n_points, iterations;
    Real tolerance, cut;
} Samples;

typedef struct {
    Kernel *k;
    Closer *closer;
    const Samples *s;
    Real *points;         /* (n_points, 3) of the sample, in the axes of their joints */
    Real *q, *way, *open; /* (nq) start; (nv) scaled way from there; (n_closure) residual there */
    Real *idle;           /* (n_fill, nv) orthonormal motions that nothing prescribes */
} Work;

/* ---------------------------------------------------------------- the way */

static Real entry_times(const Kernel *k, Int equation, const Real *x)
{
    Real sum = 0.0;
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
        sum += k->entry[e] * x[k->entry_v[e]];
    return sum;
}

/* Newton's step back to the start less the way there: by how much the way is bent. */
static Real bend(Work *w)
{
    const Kernel *k = w->k;
    Real *x = k->right;
    memset(x, 0, (size_t)k->nv * sizeof *x);
    for (Int i = 0; i < k->system.n_chosen; i++)
        x[i] = w->open[k->system.chosen[i]] + entry_times(k, k->system.chosen[i], w->way);
    system_solve(k, x);
    return largest(x, k->nv);
}

/* ---------------------------------------------------------------- rates */

static void take_off(const Real *direction, Int n, Real *x)
{
    const Real part = dot(direction, x, n);
    for (Int v = 0; v < n; v++)
        x[v] -= part * direction[v];
}

/* Solve for rates of the least norm: right sides in x, scaled velocities out. */
static void solve_least(const Work *w, Int n_idle, Real *x)
{
    const Kernel *k = w->k;
    system_solve(k, x);
    for (Int i = 0; i < n_idle; i++)
        take_off(w->idle + i * k->nv, k->nv, x);
}

/* Orthonormal motions that leave all equations and drivers alone, by Gram and Schmidt's method. */
static void find_idle(Work *w)
{
    const Kernel *k = w->k;
    for (Int i = 0; i < k->system.n_fill; i++) {
        Real *x = w->idle + i * k->nv;
        memset(x, 0, (size_t)k->nv * sizeof *x);
        x[k->nv - k->system.n_fill + i] = 1.0;
        solve_least(w, i, x);
        const Real size = norm(x, k->nv);
        for (Int v = 0; v < k->nv; v++)
            x[v] /= size;
    }
}

static void scale_out(const Kernel *k, const Real *x, const Real *rate, Real *out)
{
    for (Int v = 0; v < k->nv; v++)
        out[v] = k->scale[v] * x[v];
    for (Int i = 0; i < k->system.n_driven; i++)
        out[k->system.driven[i]] = rate[i]; /* as prescribed, to the last digit */
}

/* Velocities and accelerations at the factored configuration; by how much the fastest joint would
   open equations that are left out. */
static Real solve_rates(Work *w, Real *v, Real *a)
{
    Kernel *k = w->k;
    Real *x = k->right, opened = 0.0;
    find_idle(w);
    system_put_rates(k, w->s->speed);
    solve_least(w, k->system.n_fill, x);
    for (Int i = 0; i < k->n_closure; i++)
        opened = fmax(opened, fabs(entry_times(k, i, x)));
    const Real fastest = largest(x, k->nv);
    scale_out(k, x, w->s->speed, v);
    system_put_accelerations(k, v, w->s->acceleration);
    solve_least(w, k->system.n_fill, x);
    scale_out(k, x, w->s->acceleration, a);
    return fastest > 0.0 ? opened / fastest : 0.0;
}

/* Motion of the points fixed in bodies, world axes. */
static void write_points(Work *w, const Real *v, const Real *a, Real *out)
{
    Kernel *k = w->k;
    tree_rates(k, v);
    tree_accelerate(k, a);
    for (Int i = 0; i < w->s->n_points; i++, out += 15) {
        const Int at = 3 * w->s->joint[i];
        Real arm[3], swing[3], more[3];
        rotate3(k->R + 3 * at, w->points + 3 * i, arm);
        cross3(k->omega + at, arm, swing);
        copy3(k->p + at, out);
        add3(1.0, arm, out);
        copy3(k->velocity + at, out + 3);
        add3(1.0, swing, out + 3);
        copy3(k->acceleration + at, out + 6);
        cross3(k->alpha + at, arm, more);
        add3(1.0, more, out + 6);
        cross3(k->omega + at, swing, more);
        add3(1.0, more, out + 6);
        copy3(k->omega + at, out + 9);
        copy3(k->alpha + at, out + 12);
    }
}

/* ---------------------------------------------------------------- one sample after the other */

/* Let the kernel, and the points, have the numbers of sample i. */
static int take_numbers(Work *w, Int i)
{
    const Samples *s = w->s;
    const Real *varied = s->varied + i * s->n_varied;
    memcpy(w->points, s->base + s->n_reals, (size_t)(3 * s->n_points) * sizeof(Real));
    for (Int n = 0; n < s->n_varied; n++)
        if (s->varied_index[n] >= s->n_reals)
            w->points[s->varied_index[n] - s->n_reals] = varied[n];
    return kernel_vary_numbers(w->k, s->base, s->n_reals, s->varied_index, varied, s->n_varied);
}

/* Close sample i, whose numbers the kernel has, from its start; it is evaluated there. */
static void close_from_start(Work *w, Int i)
{
    const Samples *s = w->s;
    Kernel *k = w->k;
    Real *q = s->q + i * k->nq, *angle = s->angle + i * k->n_angles;
    const Closing how = {NULL, s->free, 0.0, s->tolerance, s->iterations};
    memcpy(w->q, q, (size_t)k->nq * sizeof *q);
    equations_values_near(k, q, angle);
    memcpy(w->open, k->residual, (size_t)k->n_closure * sizeof(Real));
    s->fact[i].error = closer_close_one(w->closer, q, &how, angle, s->cut);
    equations_jacobian(k, &k->equations.all);
    memcpy(angle, k->angle, (size_t)k->n_angles * sizeof(Real));
}

/* Write down what tells whether a sample at q, evaluated, is on the branch of its start. DONE or
   SINGULAR, where the system has no solution, or NO_MEMORY. */
static int judge(Work *w, const Real *q, Facts *fact)
{
    Kernel *k = w->k;
    relative_coordinates(k, w->q, q, w->way);
    fact->farthest = largest(w->way, k->nv);
    fact->way = 0.0;
    for (Int v = 0; v < k->nv; v++)
        fact->way += fabs(w->way[v]);
    const int code = system_factor(k);
    fact->sign = code == DONE ? k->system.sign : 0.0;
    fact->magnitude = log(k->system.mantissa) + (Real)k->system.exponent * log(2.0);
    fact->bend = code == DONE ? bend(w) : INFINITY;
    return code;
}

static int close_sample(Work *w, Int i)
{
    const Samples *s = w->s;
    Kernel *k = w->k;
    Real *v = s->v + i * k->nv, *a = s->a + i * k->nv;
    int code = take_numbers(w, i);
    if (code != DONE)
        return code;
    close_from_start(w, i);
    code = judge(w, s->q + i * k->nq, s->fact + i);
    memset(v, 0, (size_t)k->nv * sizeof *v);
    memset(a, 0, (size_t)k->nv * sizeof *a);
    s->fact[i].opened = code == DONE && s->speed ? solve_rates(w, v, a) : 0.0;
    write_points(w, v, a, s->point + 15 * i * s->n_points);
    return code == SINGULAR ? DONE : code;
}

static int is_sound(const Kernel *k, const Samples *s)
{
    for (Int i = 0; i < s->n_points; i++)
        if (!within(s->joint[i], k->n_joints))
            return 0;
    for (Int i = 0; i < s->n_varied; i++)
        if (!within(s->varied_index[i], s->n_reals + 3 * s->n_points))
            return 0;
    return 1;
}

/* Close m samples. The numbers of the kernel are the last sample's then.

   work: (3 n_points + nq + nv + n_closure + n_fill nv). */
EXPORT int dimensions_close(Kernel *k, Closer *closer, const Samples *s, Int m, Real *work)
{
    if (!is_sound(k, s))
        return BAD_ARRAYS;
    int code = system_set(k, s->chosen, s->n_chosen, s->driven, s->n_driven, s->fill, s->n_fill);
    Work w = {.k = k, .closer = closer, .s = s, .points = work};
    w.q = w.points + 3 * s->n_points;
    w.way = w.q + k->nq;
    w.open = w.way + k->nv;
    w.idle = w.open + k->n_closure;
    for (Int i = 0; i < m && code == DONE; i++)
        code = close_sample(&w, i);
    return code;
}
