/* Coordinate partitioning: which coordinates are independent, and how others are chosen.
 *
 * The coordinates that determine a motion best are those of the joints that move most: independent
 * rows of an orthonormal basis of the freedoms' motions [Wehage1982]. One freedom that crosses branch
 * points is the coordinate of a joint with one entry of q, the fastest. */
#include <stdlib.h>
#include <string.h>

#include "choosing.h"
#include "dynamics.h"

#define PLAIN 0.1  /* speed of a plain coordinate, relative to the fastest, at which it will do */

/* The joint of a velocity entry. */
static Int joint_of(const Kernel *k, Int v)
{
    Int j = 1;
    while (v >= k->iv[j] + joint_nv(k->kind[j]))
        j++;
    return j;
}

/* Hold a velocity entry as coordinate i. */
static void hold(Dynamics *d, Int i, Int v)
{
    const Kernel *k = d->k;
    const Int j = joint_of(k, v);
    d->held[i] = v;
    d->held_joint[i] = j;
    d->held_component[i] = v - k->iv[j];
    d->held_q[i] = joint_nv(k->kind[j]) == 1 ? k->iq[j] : -1;
    d->is_linear = d->is_linear && d->held_q[i] >= 0;
}

/* Hold free and prescribed coordinates; 0 where they cannot be. */
static int hold_all(Dynamics *d, const Int *free_ones)
{
    const Kernel *k = d->k;
    d->is_linear = 1;
    for (Int i = 0; i < d->n_held; i++) {
        const Int v = i < d->n_free ? free_ones[i] : d->prescribed[i - d->n_free];
        if (!within(v, k->nv))
            return 0;
        hold(d, i, v);
        if (i >= d->n_free && d->held_q[i] < 0)
            return 0;
    }
    d->crosses = d->n_free == 1 && d->n_drives == 0 && d->is_linear && k->n_closure > 0 &&
                !d->projects;
    d->curve.is_curve = d->n_held == 1 && d->is_linear;
    const int turns = d->crosses && k->kind[d->held_joint[0]] != SLIDE;
    d->branches.period = turns ? 2.0 * PI / k->scale[d->held[0]] : 0.0;
    return 1;
}

/* Rows that hold spins, where they may not vanish: the freedoms that carry the body. */
static Real *spin_pattern(const Dynamics *d)
{
    const Kernel *k = d->k;
    Real *rows = calloc((size_t)(d->spins.n * k->nv) + 1, sizeof *rows);
    for (Int s = 0; rows && s < d->spins.n; s++)
        for (Int j = d->spins.joint[s]; j > 0; j = k->parent[j])
            for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++)
                rows[s * k->nv + v] = 1.0;
    return rows;
}

/* Solve for the other coordinates from now on. */
static int set_system(Dynamics *d, const Int *free_ones, const Int *chosen, Int n_chosen)
{
    if (!hold_all(d, free_ones))
        return BAD_ARRAYS;
    Real *rows = spin_pattern(d);
    if (!rows)
        return NO_MEMORY;
    const int code = system_set(d->k, chosen, n_chosen, d->held, d->n_held, rows, d->spins.n);
    free(rows);
    return code;
}

/* Let these coordinates count from the present position, without memory of any other. */
static int begin(Dynamics *d, const Int *free_ones, const Int *chosen, Int n_chosen)
{
    Kernel *k = d->k;
    const int code = set_system(d, free_ones, chosen, n_chosen);
    if (code != DONE)
        return code;
    memcpy(d->start, d->q, (size_t)k->nq * sizeof *d->q);
    Branches *b = &d->branches;
    b->n = b->n_built = b->n_refused = b->n_renewed = b->period_is_known = 0;
    d->determinant.distance = 0.0;
    memset(d->determinant.change, 0, (size_t)d->n_held * sizeof *d->determinant.change);
    return independent_begin(d);
}

int partitioning_begin(Dynamics *d, const StartingPoint *start)
{
    memcpy(d->q, start->q, (size_t)d->k->nq * sizeof *d->q);
    memcpy(d->turns, start->angles, (size_t)d->k->n_angles * sizeof *d->turns);
    memcpy(d->spins.rate, start->spins, (size_t)d->spins.n * sizeof *d->spins.rate);
    const int code = begin(d, start->free, start->chosen, start->n_chosen);
    if (code == DONE)
        d->heaviest = largest_inertia(d);
    return code;
}

/* ---- the best coordinates ---- */

static Real product(const Real *basis, Int n, Int nv, Int i, Int j)
{
    Real sum = 0.0;
    for (Int v = 0; v < nv; v++)
        sum += basis[v * n + i] * basis[v * n + j];
    return sum;
}

/* An orthonormal basis (nv, n) of the freedoms' motions; each twice for the sake of round-off. */
void partitioning_orthonormal_freedoms(Dynamics *d)
{
    const Int n = d->n_free, nv = d->k->nv;
    Real *basis = d->work.freedoms;
    for (Int i = 0; i < n; i++) {
        for (Int v = 0; v < nv; v++)
            basis[v * n + i] = d->columns[i * nv + v];
        for (Int pass = 0; pass < 2 * i; pass++) {
            const Real part = product(basis, n, nv, i, pass % i);
            for (Int v = 0; v < nv; v++)
                basis[v * n + i] -= part * basis[v * n + pass % i];
        }
        const Real size = sqrt(product(basis, n, nv, i, i));
        for (Int v = 0; v < nv; v++)
            basis[v * n + i] /= size;
    }
}

/* Leave the joints with one entry of q alone, of one freedom, if they move enough; whether they do. */
static int leave_plain_ones(Dynamics *d)
{
    const Kernel *k = d->k;
    Real most = 0.0, most_plain = 0.0;
    for (Int v = 0; v < k->nv; v++) {
        const Real speed = fabs(d->work.freedoms[v]);
        most = fmax(most, speed);
        if (joint_nv(k->kind[joint_of(k, v)]) == 1)
            most_plain = fmax(most_plain, speed);
    }
    if (!(most_plain > PLAIN * most))
        return 0;
    for (Int v = 0; v < k->nv; v++)
        if (joint_nv(k->kind[joint_of(k, v)]) != 1)
            d->work.freedoms[v] = 0.0;
    return 1;
}

/* The best coordinates at the present place, ascending, in d->work.best; 0 where there are none: joints
 * of bodies that spin tell nothing. */
static int choose(Dynamics *d)
{
    partitioning_orthonormal_freedoms(d);
    if (d->n_free == 1 && !d->n_drives && !leave_plain_ones(d) && d->spins.n)
        return 0;
    return independent_rows(d->k->nv, d->n_free, d->work.freedoms, d->n_free, 0.0, d->work.best,
                            NULL) == d->n_free;
}

static int are_held(const Dynamics *d)
{
    for (Int i = 0; i < d->n_free; i++) {
        Int at = 0;
        while (at < d->n_free && d->held[at] != d->work.best[i])
            at++;
        if (at == d->n_free)
            return 0;
    }
    return 1;
}

int partitioning_hold_better(Dynamics *d)
{
    Kernel *k = d->k;
    if (!choose(d) || are_held(d))
        return DONE;
    int code = set_system(d, d->work.best, k->system.chosen, k->system.n_chosen);
    if (code == DONE)
        code = independent_evaluate(d);
    if (code != DONE)
        return code;
    independent_read(d);
    d->determinant.first_pivot = d->pivot;
    return independent_measure_change(d);
}

/* Begin with these coordinates at the present position, with other equations if there are more: the
 * former ones may be nearly dependent. DONE or SINGULAR. */
static int begin_anew(Dynamics *d, const Int *free_ones)
{
    Kernel *k = d->k;
    int code = begin(d, free_ones, k->system.chosen, k->system.n_chosen);
    if (k->system.n_chosen < k->n_closure && (code == DONE || code == SINGULAR))
        code = system_reselect(k) == DONE ? independent_begin(d) : SINGULAR;
    return code == DONE && d->pivot > TOLERANCE_SINGULAR ? DONE : SINGULAR;
}

/* The unknowns where coordinates begin, at joint velocities v; the work done stays. */
static void put_unknowns(const Dynamics *d, const Real *v, Real *y)
{
    const Kernel *k = d->k;
    const Int n = d->projects ? k->nv : d->n_free;
    for (Int i = 0; i < n; i++) {
        const Int at = d->projects ? i : d->held[i];
        y[i] = 0.0;
        y[n + i] = v[at] / k->scale[at];
    }
    for (Int s = 0; s < d->spins.n; s++)
        memcpy(y + 2 * n + 4 * s, d->q + k->iq[d->spins.joint[s]], 4 * sizeof *y);
}

int partitioning_renew(Dynamics *d, const Real *q, const Real *v, Real *y, Int *free_ones, Int *same)
{
    if (!choose(d))
        return SINGULAR;
    const int keeps = are_held(d);
    *same = keeps && d->is_linear && !d->projects;
    memcpy(free_ones, keeps ? d->held : d->work.best, (size_t)d->n_free * sizeof *free_ones);
    if (*same)
        return DONE;
    memcpy(d->q, q, (size_t)d->k->nq * sizeof *d->q);
    if (begin_anew(d, free_ones) != DONE)
        return SINGULAR;
    put_unknowns(d, v, y);
    return DONE;
}
