/* A Dynamics made from two flat arrays. Every index is checked here. */
#include "dynamics.h"
#include "reading.h"

static int read_arrays(Dynamics *d, Source from)
{
    const Int nv = d->k->nv;
    const Int *head = read_ints(&from, 8);
    if (!head)
        return 0;
    for (int i = 0; i < 8; i++)
        if (head[i] < 0 || head[i] > 1000000)
            return 0;
    d->n_free = head[0], d->n_drives = head[1], d->n_spins = head[2];
    d->n_lines = head[3], d->n_turns = head[4], d->n_bushings = head[7];
    d->works = head[5], d->projects = head[6];
    d->n_held = d->n_free + d->n_drives;
    d->n_unknowns = (d->projects ? 2 * nv : 2 * d->n_free + 4 * d->n_spins) + (d->works ? 1 : 0);
    d->prescribed = read_ints(&from, d->n_drives);
    d->spin_joint = read_ints(&from, d->n_spins);
    d->line_body = read_ints(&from, 2 * d->n_lines);
    d->line_law = read_ints(&from, d->n_lines);
    d->turn_q = read_ints(&from, d->n_turns);
    d->turn_v = read_ints(&from, d->n_turns);
    d->turn_law = read_ints(&from, d->n_turns);
    d->bushing_body = read_ints(&from, 2 * d->n_bushings);
    d->bushing_law = read_ints(&from, d->n_bushings);
    const Real *tolerance = read_reals(&from, 1);
    d->damping = read_reals(&from, nv);
    d->friction = read_reals(&from, nv);
    d->slip = read_reals(&from, nv);
    d->armature = read_reals(&from, nv);
    d->constant = read_reals(&from, nv);
    d->spin_axis = read_reals(&from, 3 * d->n_spins);
    d->line_point = read_reals(&from, 6 * d->n_lines);
    d->line_spring = read_reals(&from, 3 * d->n_lines);
    d->turn_spring = read_reals(&from, 3 * d->n_turns);
    d->bushing = read_reals(&from, BUSHING_NUMBERS * d->n_bushings);
    if (from.failed || from.n_ints || from.n_reals)
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
    for (Int i = 0; i < d->n_bushings; i++) {
        law = law || d->bushing_law[i];
        if (!within(d->bushing_body[2 * i], k->n_joints) ||
            !within(d->bushing_body[2 * i + 1], k->n_joints) || !within(d->bushing_law[i], 7))
            return 0;
    }
    return (d->asked.spring || !law) && (d->asked.drives || !d->n_drives) && d->asked.least;
}

static void make_place(const Dynamics *d, Place *place)
{
    Kernel *k = d->k;
    place->passage = -1;
    place->q = kernel_reals(k, k->nq);
    place->x = kernel_reals(k, d->n_held);
    place->turns = kernel_reals(k, k->n_angles);
    place->bend = kernel_reals(k, k->nv);
    place->bend_rate = kernel_reals(k, d->n_held);
    place->change = kernel_reals(k, d->n_held);
}

static void make_point(Kernel *k, Point *point)
{
    Real *from = kernel_reals(k, point_numbers(k));
    if (from)
        point_carve(k, &from, point);
}

static void make_points(Dynamics *d)
{
    for (int i = 0; i < 2; i++)
        make_point(d->k, d->points + i);
    for (int i = 0; i < 3; i++) {
        make_point(d->k, d->anchor + i);
        d->anchor[i].s = NAN;
    }
    d->stride = INFINITY;
    d->point = d->points;
    d->point_before = d->points + 1;
}

static void make_passages(Dynamics *d)
{
    Kernel *k = d->k;
    const Int n = 2 * PASSAGE_NODES;
    for (Int i = 0; d->n_free == 1 && !d->n_drives && i < MOST_PASSAGES; i++) {
        Passage *s = d->passages + i;
        s->q = kernel_reals(k, n * k->nq);
        s->t = kernel_reals(k, n * k->nv);
        s->c = kernel_reals(k, n * k->nv);
        s->angles = kernel_reals(k, n * k->n_angles);
    }
}

static int make_room(Dynamics *d)
{
    Kernel *k = d->k;
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
        {&d->step, nv}, {&d->trial, nq}, {&d->solved, nv}, {&d->goal, nq},
        {&d->by_rates, n * n}, {&d->asking, 3 * n}, {&d->unit, d->n_free},
        {&d->before, n}, {&d->halfway, n}, {&d->off, n}, {&d->force, 3 * nj}, {&d->moment, 3 * nj},
        {&d->twist, 6 * nj * d->n_free}, {&d->mass, d->n_free * d->n_free + 1},
        {&d->freedoms, d->n_free * nv}, {&d->change, n},
        {&d->laws, 3 * d->n_drives}, {&d->tree_room, 7 * nv},
    };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        *fields[i].to = kernel_reals(k, fields[i].count);
    Int **indices[] = {&d->held, &d->held_q, &d->held_joint, &d->held_component, &d->order,
                       &d->best};
    for (size_t i = 0; i < sizeof indices / sizeof *indices; i++)
        *indices[i] = kernel_ints(k, n);
    d->former = kernel_ints(k, nv);
    make_place(d, &d->kept);
    make_place(d, &d->aside);
    make_place(d, &d->ended);
    make_points(d);
    make_passages(d);
    return kernel_had_memory(k);
}

/* Make one on a kernel without equations of idle rotations, which it is freed with. */
EXPORT int dynamics_create(Kernel *k, const Int *ints, Int n_ints, const Real *reals, Int n_reals,
                           const Asked *asked, Dynamics **out)
{
    *out = NULL;
    Dynamics *d = kernel_memory(k, 1, sizeof *d);
    if (!d)
        return NO_MEMORY;
    d->k = k;
    d->asked = *asked;
    d->passage = -1;
    const Source from = {k, ints, n_ints, reals, n_reals, 0};
    if (k->n_idle || !read_arrays(d, from) || !forces_are_sound(d))
        return BAD_ARRAYS;
    for (Int i = 0; i < k->nv; i++)
        d->resists = d->resists || d->damping[i] != 0.0 || d->friction[i] != 0.0;
    if (!make_room(d))
        return NO_MEMORY;
    if (!k->n_equations && !d->n_drives && !d->n_spins) {
        const Int *no_core = kernel_ints(k, k->n_joints);
        if (!no_core || tree_create(k, no_core, &d->tree) != DONE)
            return NO_MEMORY;
    }
    *out = d;
    return DONE;
}
