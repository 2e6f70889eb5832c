/* A Dynamics made from two flat arrays. Every index is checked here. */
#include <stdlib.h>
#include <string.h>

#include "dynamics.h"

#define MOST_OWNED 128 /* arrays of a simulation, of which there are about sixty */

static void *memory(Dynamics *d, Int count, size_t size)
{
    if (d->n_owned == MOST_OWNED)
        return NULL;
    void *made = calloc(count > 0 ? (size_t)count : 1, size);
    if (made)
        d->owned[d->n_owned++] = made;
    return made;
}

typedef struct {
    Dynamics *d;
    const Int *ints;
    Int ints_left;
    const Real *reals;
    Int reals_left;
    int failed;
} Source;

static const Int *take_ints(Source *from, Int n)
{
    Int *copy = n < 0 || n > from->ints_left ? NULL : memory(from->d, n, sizeof *copy);
    if (!copy) {
        from->failed = 1;
        return NULL;
    }
    memcpy(copy, from->ints, (size_t)n * sizeof *copy);
    from->ints += n;
    from->ints_left -= n;
    return copy;
}

static const Real *take_reals(Source *from, Int n)
{
    Real *copy = n < 0 || n > from->reals_left ? NULL : memory(from->d, n, sizeof *copy);
    if (!copy) {
        from->failed = 1;
        return NULL;
    }
    memcpy(copy, from->reals, (size_t)n * sizeof *copy);
    from->reals += n;
    from->reals_left -= n;
    return copy;
}

static int read_arrays(Dynamics *d, Source from)
{
    const Int nv = d->k->nv;
    const Int *head = take_ints(&from, 7);
    if (!head)
        return 0;
    for (int i = 0; i < 7; i++)
        if (head[i] < 0 || head[i] > 1000000)
            return 0;
    d->n_free = head[0], d->n_drives = head[1], d->n_spins = head[2];
    d->n_lines = head[3], d->n_turns = head[4], d->works = head[5], d->projects = head[6];
    d->n_held = d->n_free + d->n_drives;
    d->n_unknowns = (d->projects ? 2 * nv : 2 * d->n_free + 4 * d->n_spins) + (d->works ? 1 : 0);
    d->prescribed = take_ints(&from, d->n_drives);
    d->spin_joint = take_ints(&from, d->n_spins);
    d->line_body = take_ints(&from, 2 * d->n_lines);
    d->line_law = take_ints(&from, d->n_lines);
    d->turn_q = take_ints(&from, d->n_turns);
    d->turn_v = take_ints(&from, d->n_turns);
    d->turn_law = take_ints(&from, d->n_turns);
    const Real *tolerance = take_reals(&from, 1);
    d->damping = take_reals(&from, nv);
    d->friction = take_reals(&from, nv);
    d->slip = take_reals(&from, nv);
    d->armature = take_reals(&from, nv);
    d->constant = take_reals(&from, nv);
    d->spin_axis = take_reals(&from, 3 * d->n_spins);
    d->line_point = take_reals(&from, 6 * d->n_lines);
    d->line_spring = take_reals(&from, 3 * d->n_lines);
    d->turn_spring = take_reals(&from, 3 * d->n_turns);
    if (from.failed || from.ints_left || from.reals_left)
        return 0;
    d->tolerance = *tolerance;
    return 1;
}

static int forces_are_sound(const Dynamics *d)
{
    const Kernel *k = d->k;
    int law = 0;
    if (d->n_held > k->nv || d->n_spins > k->nv || (d->projects && (d->n_drives || d->n_spins)))
        return 0;
    for (Int i = 0; i < d->n_drives; i++)
        if (!within(d->prescribed[i], k->nv))
            return 0;
    for (Int s = 0; s < d->n_spins; s++)
        if (!within(d->spin_joint[s], k->n_joints) || k->kind[d->spin_joint[s]] != BALL)
            return 0;
    for (Int i = 0; i < 2 * d->n_lines; i++)
        if (!within(d->line_body[i], k->n_joints))
            return 0;
    for (Int i = 0; i < d->n_lines; i++)
        law = law || d->line_law[i];
    for (Int i = 0; i < d->n_turns; i++) {
        law = law || d->turn_law[i];
        if (!within(d->turn_q[i], k->nq) || !within(d->turn_v[i], k->nv))
            return 0;
    }
    return (d->asked.spring || !law) && (d->asked.drives || !d->n_drives) && d->asked.least;
}

static int make_place(Dynamics *d, Place *place)
{
    const Kernel *k = d->k;
    place->passage = -1;
    return (place->q = memory(d, k->nq, sizeof(Real))) &&
           (place->x = memory(d, d->n_held, sizeof(Real))) &&
           (place->turns = memory(d, k->n_angles, sizeof(Real))) &&
           (place->bend = memory(d, k->nv, sizeof(Real))) &&
           (place->bend_rate = memory(d, d->n_held, sizeof(Real))) &&
           (place->change = memory(d, d->n_held, sizeof(Real)));
}

static int make_points(Dynamics *d)
{
    const Int n = point_numbers(d->k);
    Real *from = memory(d, 5 * n, sizeof(Real));
    if (!from)
        return 0;
    for (int i = 0; i < 2; i++)
        point_carve(d->k, &from, d->points + i);
    for (int i = 0; i < 3; i++) {
        point_carve(d->k, &from, d->anchor + i);
        d->anchor[i].s = NAN;
    }
    d->stride = INFINITY;
    d->point = d->points;
    d->point_before = d->points + 1;
    return 1;
}

static int make_passages(Dynamics *d)
{
    const Kernel *k = d->k;
    for (Int i = 0; d->n_free == 1 && !d->n_drives && i < MOST_PASSAGES; i++) {
        Passage *s = d->passages + i;
        const Int n = 2 * PASSAGE_NODES;
        if (!(s->q = memory(d, n * k->nq, sizeof(Real))) ||
            !(s->t = memory(d, n * k->nv, sizeof(Real))) ||
            !(s->c = memory(d, n * k->nv, sizeof(Real))) ||
            !(s->angles = memory(d, n * k->n_angles, sizeof(Real))))
            return 0;
    }
    return 1;
}

static int make_room(Dynamics *d)
{
    const Kernel *k = d->k;
    const Int nq = k->nq, nv = k->nv, n = d->n_held, nj = k->n_joints, na = k->n_angles;
    struct {
        Real **to;
        Int count;
    } fields[] = {
        {&d->start, nq}, {&d->sigma, d->n_spins}, {&d->q, nq}, {&d->x, n},
        {&d->turns, na}, {&d->columns, n * nv}, {&d->by_velocity, 3 * n}, {&d->inverse, n * n},
        {&d->bend, nv}, {&d->bend_rate, n}, {&d->v, nv}, {&d->a, nv}, {&d->a0, nv},
        {&d->given, nv}, {&d->tau, nv}, {&d->z, n}, {&d->drive_effort, d->n_drives},
        {&d->period_q, nq}, {&d->period_angle, na}, {&d->passage_t, nv}, {&d->passage_c, nv},
        {&d->step, nv}, {&d->trial, nq}, {&d->solved, nv}, {&d->goal, n * n + nq}, {&d->asking, 3 * n},
        {&d->before, n}, {&d->rates, n}, {&d->off, n}, {&d->force, 3 * nj}, {&d->moment, 3 * nj},
        {&d->twist, 6 * nj * d->n_free}, {&d->mass, d->n_free * d->n_free + 1},
        {&d->freedoms, d->n_free * nv}, {&d->change, n},
        {&d->laws, 3 * d->n_drives},
    };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        if (!(*fields[i].to = memory(d, fields[i].count, sizeof(Real))))
            return 0;
    Int **indices[] = {&d->held, &d->held_q, &d->held_joint, &d->held_component, &d->order,
                       &d->best};
    for (size_t i = 0; i < sizeof indices / sizeof *indices; i++)
        if (!(*indices[i] = memory(d, n, sizeof(Int))))
            return 0;
    if (!(d->former = memory(d, nv, sizeof(Int))))
        return 0;
    return make_place(d, &d->kept) && make_place(d, &d->aside) &&
           make_place(d, &d->ended) && make_points(d) && make_passages(d);
}

EXPORT void dynamics_destroy(Dynamics *d)
{
    if (!d)
        return;
    for (Int i = 0; i < d->n_owned; i++)
        free(d->owned[i]);
    free(d->owned);
    free(d);
}

/* Make one on a kernel without equations of idle rotations, which it must not outlive. */
EXPORT int dynamics_create(Kernel *k, const Int *ints, Int n_ints, const Real *reals, Int n_reals,
                           const Asked *asked, Dynamics **out)
{
    *out = NULL;
    Dynamics *d = calloc(1, sizeof *d);
    void **owned = calloc(MOST_OWNED, sizeof *owned);
    if (!d || !owned) {
        free(d);
        free(owned);
        return NO_MEMORY;
    }
    d->owned = owned;
    d->k = k;
    d->asked = *asked;
    d->passage = -1;
    const Source from = {d, ints, n_ints, reals, n_reals, 0};
    int code = k->n_idle == 0 && read_arrays(d, from) && forces_are_sound(d)
                   ? DONE
                   : BAD_ARRAYS;
    if (code == DONE) {
        for (Int i = 0; i < k->nv; i++)
            d->resists = d->resists || d->damping[i] != 0.0 || d->friction[i] != 0.0;
        code = make_room(d) ? DONE : NO_MEMORY;
    }
    if (code == DONE)
        *out = d;
    else
        dynamics_destroy(d);
    return code;
}
