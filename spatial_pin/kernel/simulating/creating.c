/* A Dynamics made from two flat arrays. Every index is checked here. */
#include "dynamics.h"
#include "memory.h"

static int read_arrays(Dynamics *d, Source from)
{
    Springs *springs = &d->forces.springs;
    const Int nv = d->k->nv;
    const Int *head = read_ints(&from, 8);
    if (!head)
        return 0;
    for (int i = 0; i < 8; i++)
        if (head[i] < 0 || head[i] > 1000000)
            return 0;
    d->n_free = head[0], d->n_drives = head[1], d->spins.n = head[2];
    springs->n_lines = head[3], d->forces.n_turns = head[4], springs->n_bushings = head[7];
    d->works = head[5], d->projects = head[6];
    d->n_held = d->n_free + d->n_drives;
    d->n_unknowns = (d->projects ? 2 * nv : 2 * d->n_free + 4 * d->spins.n) + (d->works ? 1 : 0);
    d->prescribed = read_ints(&from, d->n_drives);
    d->spins.joint = read_ints(&from, d->spins.n);
    springs->line_body = read_ints(&from, 2 * springs->n_lines);
    springs->line_law = read_ints(&from, springs->n_lines);
    d->forces.turn_q = read_ints(&from, d->forces.n_turns);
    d->forces.turn_v = read_ints(&from, d->forces.n_turns);
    d->forces.turn_law = read_ints(&from, d->forces.n_turns);
    springs->bushing_body = read_ints(&from, 2 * springs->n_bushings);
    springs->bushing_law = read_ints(&from, springs->n_bushings);
    const Real *tolerance = read_reals(&from, 1);
    d->forces.damping = read_reals(&from, nv);
    d->forces.friction = read_reals(&from, nv);
    d->forces.slip = read_reals(&from, nv);
    d->forces.armature = read_reals(&from, nv);
    d->forces.constant = read_reals(&from, nv);
    d->spins.axis = read_reals(&from, 3 * d->spins.n);
    springs->line_point = read_reals(&from, 6 * springs->n_lines);
    springs->line_spring = read_reals(&from, 3 * springs->n_lines);
    d->forces.turn_spring = read_reals(&from, 3 * d->forces.n_turns);
    springs->bushing = read_reals(&from, BUSHING_NUMBERS * springs->n_bushings);
    springs->law = d->callbacks.spring;
    springs->first_bushing = springs->n_lines + d->forces.n_turns;
    if (from.failed || from.n_ints || from.n_reals)
        return 0;
    d->tolerance = *tolerance;
    return 1;
}

static int forces_are_sound(const Dynamics *d)
{
    const Springs *springs = &d->forces.springs;
    const Kernel *k = d->k;
    int law = 0;
    if (d->n_held > k->nv || d->spins.n > k->nv || (d->projects && (d->n_drives || d->spins.n)))
        return 0;
    for (Int i = 0; i < d->n_drives; i++)
        if (!within(d->prescribed[i], k->nv))
            return 0;
    for (Int s = 0; s < d->spins.n; s++)
        if (!within(d->spins.joint[s], k->n_joints) || k->kind[d->spins.joint[s]] != BALL)
            return 0;
    for (Int i = 0; i < 2 * springs->n_lines; i++)
        if (!within(springs->line_body[i], k->n_joints))
            return 0;
    for (Int i = 0; i < springs->n_lines; i++)
        law = law || springs->line_law[i];
    for (Int i = 0; i < d->forces.n_turns; i++) {
        law = law || d->forces.turn_law[i];
        if (!within(d->forces.turn_q[i], k->nq) || !within(d->forces.turn_v[i], k->nv))
            return 0;
    }
    for (Int i = 0; i < springs->n_bushings; i++) {
        law = law || springs->bushing_law[i];
        if (!within(springs->bushing_body[2 * i], k->n_joints) ||
            !within(springs->bushing_body[2 * i + 1], k->n_joints) ||
            !within(springs->bushing_law[i], 7))
            return 0;
    }
    return (d->callbacks.spring || !law) && (d->callbacks.drives || !d->n_drives) && d->callbacks.least;
}

static void make_saved_position(const Dynamics *d, SavedPosition *position)
{
    Kernel *k = d->k;
    position->bridge = -1;
    position->q = kernel_reals(k, k->nq);
    position->x = kernel_reals(k, d->n_held);
    position->turns = kernel_reals(k, k->n_angles);
    position->bend = kernel_reals(k, k->nv);
    position->bend_rate = kernel_reals(k, d->n_held);
    position->change = kernel_reals(k, d->n_held);
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
        make_point(d->k, d->curve.points + i);
    for (int i = 0; i < 3; i++) {
        make_point(d->k, d->curve.anchor + i);
        d->curve.anchor[i].s = NAN;
    }
    d->curve.stride = INFINITY;
    d->curve.point = d->curve.points;
    d->curve.before = d->curve.points + 1;
}

static void make_bridges(Dynamics *d)
{
    Kernel *k = d->k;
    const Int n = 2 * BRIDGE_NODES;
    for (Int i = 0; d->n_free == 1 && !d->n_drives && i < MOST_BRIDGES; i++) {
        Bridge *s = d->branches.bridges + i;
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
        {&d->start, nq}, {&d->spins.rate, d->spins.n}, {&d->q, nq}, {&d->x, n}, {&d->turns, na},
        {&d->columns, n * nv}, {&d->by_velocity, 3 * n}, {&d->inverse, n * n}, {&d->bend, nv},
        {&d->bend_rate, n}, {&d->v, nv}, {&d->a, nv}, {&d->a0, nv}, {&d->forces.given, nv},
        {&d->forces.tau, nv}, {&d->z, n}, {&d->forces.drive_effort, d->n_drives},
        {&d->branches.period_q, nq}, {&d->branches.period_angle, na}, {&d->branches.t, nv},
        {&d->branches.c, nv}, {&d->work.step, nv}, {&d->work.trial, nq}, {&d->work.solved, nv},
        {&d->work.goal, nq}, {&d->work.by_rates, n * n}, {&d->work.asking, 3 * n},
        {&d->work.unit, d->n_free}, {&d->work.before, n}, {&d->work.halfway, n}, {&d->work.off, n},
        {&d->forces.springs.force, 3 * nj}, {&d->forces.springs.moment, 3 * nj},
        {&d->work.twist, 6 * nj * d->n_free}, {&d->work.mass, d->n_free * d->n_free + 1},
        {&d->work.freedoms, d->n_free * nv}, {&d->determinant.change, n},
        {&d->work.laws, 3 * d->n_drives}, {&d->work.tree_room, 7 * nv},
    };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        *fields[i].to = kernel_reals(k, fields[i].count);
    Int **indices[] = {&d->held, &d->held_q, &d->held_joint, &d->held_component, &d->work.order,
                       &d->work.best};
    for (size_t i = 0; i < sizeof indices / sizeof *indices; i++)
        *indices[i] = kernel_ints(k, n);
    d->work.former = kernel_ints(k, nv);
    make_saved_position(d, &d->restart);
    make_saved_position(d, &d->work.saved);
    make_saved_position(d, &d->work.ended);
    make_points(d);
    make_bridges(d);
    return kernel_had_memory(k);
}

EXPORT int dynamics_create(Kernel *k, const Int *ints, Int n_ints, const Real *reals, Int n_reals,
                           const Callbacks *callbacks, const StartingPoint *start, Dynamics **out)
{
    *out = NULL;
    Dynamics *d = kernel_memory(k, 1, sizeof *d);
    if (!d)
        return NO_MEMORY;
    d->k = k;
    d->factorisations = &k->system.factorisations;
    d->callbacks = *callbacks;
    d->bridge = -1;
    const Source from = {k, ints, n_ints, reals, n_reals, 0};
    if (k->n_idle || !read_arrays(d, from) || !forces_are_sound(d))
        return BAD_ARRAYS;
    for (Int i = 0; i < k->nv; i++)
        d->forces.resists = d->forces.resists || d->forces.damping[i] != 0.0 ||
                            d->forces.friction[i] != 0.0;
    if (!make_room(d))
        return NO_MEMORY;
    if (!k->n_equations && !d->n_drives && !d->spins.n) {
        const Int *no_core = kernel_ints(k, k->n_joints);
        if (!no_core || tree_create(k, no_core, &d->work.tree) != DONE)
            return NO_MEMORY;
    }
    const int code = partitioning_begin(d, start);
    if (code == DONE)
        *out = d;
    return code == DONE || code == NO_MEMORY ? code : SINGULAR;
}
