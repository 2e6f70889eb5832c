/* Closing the loops from a guess, by the least motion.
 *
 * Levenberg and Marquardt's method on the configuration manifold, with damping proportional to the
 * residual: quadratic near a solution even where equations are redundant [YamashitaFukushima2001].
 * Then undamped steps down to round-off. A step is -Jᵀ (J Jᵀ + damping)⁻¹ r: the shortest that does
 * what it does (least_motion.c), of many equations by the sparse squares (envelope.c). Where frames
 * are turned far against each other, the logarithms of their rotations lead first (far_rotations.c).
 *
 * Components of balls and floating joints can be pinned (pins.c): after each step they are given
 * their values, and each has an equation, zero there, that keeps steps from moving it. */
#include <float.h>
#include <string.h>

#include "choosing.h"
#include "closing.h"
#include "closing_parts.h"
#include "dense.h"
#include "memory.h"
#include "pins.h"

/* Residual from which products lead where the logarithms do: of angles of a hundredth radian
   they differ by their third power, 1e-6 */
#define PRODUCTS_LEAD 1e-2
/* Relative to the residual, at first: singular values above a tenth of its root are little damped */
#define DAMPING 1e-2
/* Damping after a good step: it falls faster than residuals do, so that Newton's method is what
   is left */
#define SOFTER 0.1
/* Less changes no singular value above its root, 1e-6 */
#define SOFTEST TOLERANCE_TIGHT
/* Damping after a bad step: a few of these undo one good step */
#define HARDER 8.0
/* At least, after a bad one: less shortens no step where singular values are above a thousandth */
#define LEAST_HARDER TOLERANCE_HALF_PRECISION
/* Trials of a damping, the last is 8^12 = 7e10 times the first: from 1e-12 to 0.07 */
#define DAMPINGS 12
/* Steps after which more than STALLED_LEFT of a residual will not vanish: damping has come and
   gone by then */
#define STALLED 10
/* Part of a residual: 60 steps that leave as much each ten take off less than half */
#define STALLED_LEFT 0.9
/* The same steps where anything may be the start, and valleys are long */
#define PATIENT 20
/* Part of a residual that a step leaves, at most, to be followed by one: less progress is that
   of a local minimum */
#define WORTHWHILE 0.9999
/* The same of a whole step of a further start, where more is released afterwards: one towards closed
   loops leaves less */
#define WORTHWHILE_FURTHER 0.9
/* Undamped steps at most: near a dead centre each leaves a quarter, which comes from 1e-2 to
   1e-20 */
#define POLISHED 30
/* Part of a distance that makes no branch the nearer one: half of the digits */
#define AS_NEAR TOLERANCE_HALF_PRECISION
/* The same of a place that is the nearer one, and the least difference, as `is_nearer` has them */
#define NEARER_PART 1e-6 /* of their distances: what closing leaves in doubt is far less */
#define NEARER_BY 1e-9   /* of two at the named values but for round-off neither is */
/* Residual, and remaining step, from which it is seen how far a branch is: the step is known
   from how fast steps grow shorter */
#define SEEN 1e-4
#define SQUARED (1e2 * DBL_EPSILON) /* of J Jᵀ by its size: redundant equations leave it singular */
/* Equations up to which steps are worked out without squares, whole: 0.5 ms each. Squares are
   sparse, and for many loops the only way. */
#define FEW_EQUATIONS 100
/* Rows of targets at most, besides one for each velocity: those of a placement in a plane */
#define MORE_TARGETS 6
/* Smallest over largest pivot of loops and targets: below it a target is at the end of its
   reach, and met to half of the digits */
#define IN_REACH TOLERANCE_HALF_PRECISION
/* Weight of targets beside loops: where they contradict each other on the way, as a placement of what
   moves along a line does, loops stay closed to its square */
#define TARGET_WEIGHT 1e-2
/* Newton steps at most to the least displacement: it takes some five */
#define NEAREST_STEPS 20
/* Size of the last of them: differences of this length leave half of the digits of the curvature,
   and so 1e-14 of the way */
#define NEAREST_STEP 1e-8
/* Part of a step that the next one by the same derivatives should be: below TOLERANCE_CONTRACTION, at
   which Newton's method is sure of its solution [Deuflhard2011, 2.1] */
#define WANTED_CONTRACTION 0.2
/* Least part of the way to the targets that is gone at once, and how much longer it may become */
#define LEAST_PART 1e-3
#define LONGER 4.0
#define DIFFERENCE 1e-6

struct Closer {
    Kernel *k;
    Rotations rotations;
    Int n_pins;
    const Pin *pin;
    Int n;                       /* equations, pinned coordinates behind the loops' */
    Int *start, *column;         /* pattern of their derivatives */
    Real *value, *residual, *multiplier;
    Envelope square;
    LeastMotion whole;           /* of few equations */
    Int room;                    /* rows of targets at most */
    Real *dense, *few;           /* (n + room, nv), (nv) of free velocities */
    Real *before;                /* (nq) scratch */
    Real *first_off, left;       /* (room) the targets' residuals at the start; part that may be left */
    Real *off, *freedom, *curvature, *gradient; /* (room); (nv, nv), likewise, (4 nv) */
    Int *moves, *of_loops;       /* (nv) whether an equation depends on each velocity; a loop's */
    Int *free_index, n_free;          /* (nv) of each of these among the free ones; how many */
    Real *q, *trial, *step;
    Real size, rest;     /* of the step tried last, of the remaining distance, by entries of v / scale */
    Real *begin;         /* (nq) where the first start was */
    Int *order;          /* (n) scratch */
    /* ---- of the call ---- */
    const Int *free;     /* (nv) velocities that may move */
    const Real *wanted;  /* values of pinned coordinates */
    Real cut;            /* size of equations, by the largest, that move nothing */
    Targets targets;
    Int n_rows;          /* of these */
    int squares;         /* whether steps are worked out by squares */
};

/* How a descent ends, and what leads it. */
typedef struct {
    Real tolerance;
    Int iterations;
    int far;     /* the logarithms of rotations lead */
    int counts;  /* angles of screws count turns from step to step */
    Int stalled; /* steps after which the residual must have become less */
    Real worthwhile; /* see WORTHWHILE */
} Descent;

/* ---------------------------------------------------------------- pinned coordinates */

static void put_pinned_rows(Closer *c)
{
    Real *row = c->value + c->k->entry_start[c->k->n_closure];
    for (Int i = 0; i < c->n_pins; i++, row += 3) {
        const Pin *pin = c->pin + i;
        const Real *scale = c->k->scale + pin->v;
        pin_row(pin, c->q, row);
        for (int x = 0; x < 3; x++)
            row[x] *= scale[x] / scale[pin->component];
    }
}

/* ---------------------------------------------------------------- steps */

/* Evaluate the equations at q, and the targets; returns the length of the residual. */
static Real residual_at(Closer *c, const Real *q, int far)
{
    equations_values(c->k, q);
    if (far)
        rotations_put_values(c->k, &c->rotations);
    targets_values(c->k, &c->targets, c->off);
    return sqrt(dot(c->k->residual, c->k->residual, c->k->n_closure) +
                dot(c->off, c->off, c->n_rows));
}

/* The largest residual, where they were evaluated last. */
static Real largest_residual(const Closer *c)
{
    const Real error = equations_error(c->k), off = largest(c->off, c->n_rows);
    return error >= off ? error : off;
}

static void let_move(Closer *c, const Int *free)
{
    c->free = free;
    c->n_free = 0;
    for (Int v = 0; v < c->k->nv && c->free_index; v++)
        c->free_index[v] = free[v] && c->moves[v] ? c->n_free++ : -1;
}

/* The derivatives with respect to free velocities as a matrix. Held entries take no part, nor what
   no equation depends on: it is not to move by the last bit. */
static void fill_dense(Closer *c)
{
    memset(c->dense, 0, (size_t)((c->n + c->n_rows) * c->n_free) * sizeof(Real));
    for (Int r = 0; r < c->n; r++) {
        Real *row = c->dense + r * c->n_free;
        for (Int i = c->start[r]; i < c->start[r + 1]; i++)
            if (c->free_index[c->column[i]] >= 0)
                row[c->free_index[c->column[i]]] = c->value[i];
    }
    Real *rows = c->dense + c->n * c->n_free;
    targets_put_rows(c->k, &c->targets, c->free_index, c->n_free, rows);
    for (Int i = 0; i < c->n_rows * c->n_free; i++)
        rows[i] *= TARGET_WEIGHT;
}

/* Take the residuals where they were evaluated last. */
static void take_residual(Closer *c)
{
    memcpy(c->residual, c->k->residual, (size_t)c->k->n_closure * sizeof(Real));
    for (Int i = 0; i < c->n_rows; i++)
        c->residual[c->n + i] = TARGET_WEIGHT * (c->off[i] - c->left * c->first_off[i]);
}

/* Linearise the equations where they were evaluated last, at c->q. */
static void linearise(Closer *c, int far)
{
    const Kernel *k = c->k;
    equations_jacobian(c->k, &c->k->equations.all);
    if (far)
        rotations_put_entries(c->k, &c->rotations);
    take_residual(c);
    memcpy(c->value, k->entry, (size_t)k->entry_start[k->n_closure] * sizeof(Real));
    put_pinned_rows(c);
    if (!c->squares) {
        fill_dense(c);
        least_motion_factor(&c->whole, c->dense, c->n + c->n_rows, c->n_free, c->cut);
        return;
    }
    for (Int i = 0; i < c->start[c->n]; i++)
        c->value[i] = c->free[c->column[i]] ? c->value[i] : 0.0;
    envelope_square(&c->square, c->value);
}

static void linearise_at(Closer *c, const Real *q)
{
    residual_at(c, q, 0);
    linearise(c, 0);
}

/* The step -Jᵀ (J Jᵀ + damping)⁻¹ r by the sparse squares; 0 where there is none. */
static int step_by_squares(Closer *c, Real damping)
{
    const Real part = c->cut * c->cut > SQUARED ? c->cut * c->cut : SQUARED;
    const Real least = part * c->square.largest;
    if (!envelope_factor(&c->square, damping > least ? damping : least))
        return 0;
    envelope_solve(&c->square, c->residual, c->multiplier);
    memset(c->step, 0, (size_t)c->k->nv * sizeof(Real));
    for (Int r = 0; r < c->n; r++)
        for (Int i = c->start[r]; i < c->start[r + 1]; i++)
            c->step[c->column[i]] -= c->value[i] * c->multiplier[r];
    return 1;
}

/* The same of few equations, and those that hang on others, to the last digits. */
static int step_of_few(Closer *c, Real damping)
{
    least_motion_solve(&c->whole, damping, c->residual, c->few);
    for (Int v = 0; v < c->k->nv; v++)
        c->step[v] = c->free_index[v] >= 0 ? c->few[c->free_index[v]] : 0.0;
    return 1;
}

/* Put the configuration a step away into c->trial; 0 where there is no such step. */
static int try_step(Closer *c, Real damping, Real longest)
{
    const Int nv = c->k->nv;
    if (!(c->squares ? step_by_squares : step_of_few)(c, damping))
        return 0;
    Real size = 0.0;
    for (Int v = 0; v < nv; v++)
        size = fabs(c->step[v]) > size ? fabs(c->step[v]) : size;
    const Real part = size > longest ? longest / size : 1.0;
    c->size = part * size;
    for (Int v = 0; v < nv; v++)
        c->step[v] *= part * c->k->scale[v];
    memcpy(c->trial, c->q, (size_t)c->k->nq * sizeof(Real));
    tree_integrate(c->k, c->trial, c->step);
    pins_put(c->pin, c->n_pins, c->wanted, c->trial);
    return 1;
}

static void accept(Closer *c)
{
    Real *q = c->q;
    c->q = c->trial;
    c->trial = q;
}

/* Take the longest step, of some, that makes the residual shorter. Whether a next one is worth it. */
static int damped_step(Closer *c, const Descent *d, Real *error, Real *damping)
{
    for (int trial = 0; trial < DAMPINGS; trial++) {
        if (try_step(c, *damping * *error, TOLERANCE_DAMPED_STEP)) {
            const Real trial_error = residual_at(c, c->trial, d->far);
            if (trial_error < *error) {
                const int is_whole = c->size < TOLERANCE_DAMPED_STEP;
                const int worthwhile = trial_error < (is_whole ? d->worthwhile : WORTHWHILE) * *error;
                accept(c);
                c->rest = sqrt((Real)c->k->nv) * c->size * trial_error / (*error - trial_error);
                if (d->counts)
                    memcpy(c->k->angle_reference, c->k->angle, (size_t)c->k->n_angles * sizeof(Real));
                *error = trial_error;
                *damping = *damping * SOFTER > SOFTEST ? *damping * SOFTER : SOFTEST;
                return worthwhile;
            }
        }
        *damping = *damping * HARDER > LEAST_HARDER ? *damping * HARDER : LEAST_HARDER;
    }
    return 0;
}

/* Damped steps from c->q until the residual is as short as the tolerance, or no step helps. */
static Real descend(Closer *c, const Descent *d)
{
    Real damping = DAMPING, error = residual_at(c, c->q, d->far), marked = INFINITY;
    c->rest = INFINITY;
    for (Int i = 0; i < d->iterations && error > d->tolerance; i++) {
        if (i % d->stalled == 0) {
            if (error > STALLED_LEFT * marked)
                break;
            marked = error;
        }
        linearise(c, d->far);
        if (!damped_step(c, d, &error, &damping))
            break;
    }
    return error;
}

/* Undamped steps while they make the closure error smaller; returns it. */
static Real polish(Closer *c)
{
    Kernel *k = c->k;
    residual_at(c, c->q, 0);
    Real error = largest_residual(c);
    for (int i = 0; i < POLISHED && error > DBL_EPSILON && k->n_closure + c->n_rows; i++) {
        linearise(c, 0);
        if (!try_step(c, 0.0, INFINITY))
            break;
        residual_at(c, c->trial, 0);
        const Real trial_error = largest_residual(c), before = error;
        if (trial_error < before) {
            accept(c);
            error = trial_error;
        }
        if (!(trial_error < 0.5 * before))
            break;
    }
    return error;
}

/* Newton's steps for loops and targets together, from closed loops in c->q; returns the largest
   residual, or infinity. The targets come nearer by parts that are so short that steps contract: the
   branch is the one that leads from the start to the targets. */
static Real go_to_targets(Closer *c, Int steps)
{
    Real part = 1.0, reached = 0.0, error = INFINITY;
    residual_at(c, c->q, 0);
    memcpy(c->first_off, c->off, (size_t)c->n_rows * sizeof(Real));
    for (Int i = 0; i < steps; i++) {
        if (c->whole.m < 0)
            linearise(c, 0);
        const Real to = smaller_of(1.0, reached + part), gone = to - reached;
        c->left = 1.0 - to;
        take_residual(c);
        try_step(c, 0.0, INFINITY);
        const Real size = c->size;
        Real shorter = size > TOLERANCE_LONGEST_STEP ? TOLERANCE_LONGEST_STEP / size : 1.0;
        if (shorter == 1.0) {
            memcpy(c->before, c->q, (size_t)c->k->nq * sizeof(Real));
            accept(c);
            residual_at(c, c->q, 0);
            take_residual(c);
            try_step(c, 0.0, INFINITY);
            const Real contraction = size > 0.0 ? c->size / size : 0.0;
            accept(c);
            residual_at(c, c->q, 0);
            const Real open = equations_error(c->k);
            if ((contraction <= TOLERANCE_CONTRACTION && open <= TOLERANCE_UNEXPLAINED * size) ||
                size < TOLERANCE_TIGHT) {
                error = largest_residual(c);
                if (to == 1.0 && (error <= DBL_EPSILON || c->size < TOLERANCE_ROUND_OFF))
                    return error;
                reached = to;
                part = gone * smaller_of(LONGER, WANTED_CONTRACTION / (contraction + LEAST_PART));
                c->whole.m = -1;
                continue;
            }
            memcpy(c->q, c->before, (size_t)c->k->nq * sizeof(Real));
            residual_at(c, c->q, 0);
            shorter = larger_of(smaller_of(0.5, WANTED_CONTRACTION / contraction),
                                TOLERANCE_UNEXPLAINED);
        }
        part = gone * shorter;
        if (!(part > LEAST_PART))
            break; /* or the last steps do not contract */
    }
    return INFINITY;
}

/* Descend from c->q to a residual of a length, or as far as that goes; returns the residual. */
static Real come_near(Closer *c, const Int *free, Real tolerance, Int iterations, Real worthwhile)
{
    Descent d = {PRODUCTS_LEAD, iterations, 1, 0, STALLED, worthwhile};
    let_move(c, free);
    pins_put(c->pin, c->n_pins, c->wanted, c->q);
    if (c->rotations.n) {
        residual_at(c, c->q, 0);
        if (rotations_are_far(c->k, &c->rotations))
            descend(c, &d);
    }
    d.far = 0;
    d.tolerance = tolerance;
    return descend(c, &d);
}

/* Close from c->q to the least residual; returns the closure error. */
static Real close_one(Closer *c, const Closing *how)
{
    come_near(c, how->free, how->tolerance, how->iterations, WORTHWHILE);
    return polish(c);
}

/* Take a configuration to c->q, and close it as far as the joints that move first can; whether the
   rest is a number. */
static int begin_from(Closer *c, const Closing *how, const Real *q, Real worthwhile)
{
    memcpy(c->q, q, (size_t)c->k->nq * sizeof(Real));
    if (!how->first)
        return 1;
    const Real left = come_near(c, how->first, how->loose, how->iterations, worthwhile);
    /* Joints that count their turns may be further than short steps go, and are linear */
    const int counts = c->k->n_angles || c->k->equations.term_start[c->k->n_equations];
    return isfinite(left <= how->loose || counts ? polish(c) : left);
}

/* ---------------------------------------------------------------- what Python calls */

static int take(Kernel *k, const Int *from, Int n, const Int **to)
{
    Int *copy = kernel_memory(k, n, sizeof(Int));
    if (copy && n)
        memcpy(copy, from, (size_t)n * sizeof(Int));
    *to = copy;
    return copy != NULL;
}

/* The pattern of all equations: of the loops as in the kernel, of a pinned coordinate three. */
static int make_pattern(Closer *c)
{
    Kernel *k = c->k;
    const Int closures = k->n_closure, entries = k->entry_start[closures];
    c->n = closures + c->n_pins;
    c->start = kernel_ints(k, c->n + 1);
    c->column = kernel_ints(k, entries + 3 * c->n_pins);
    c->value = kernel_reals(k, entries + 3 * c->n_pins);
    if (!kernel_had_memory(k))
        return NO_MEMORY;
    memcpy(c->start, k->entry_start, (size_t)(closures + 1) * sizeof(Int));
    memcpy(c->column, k->entry_v, (size_t)entries * sizeof(Int));
    for (Int i = 0; i < c->n_pins; i++) {
        for (int x = 0; x < 3; x++)
            c->column[entries + 3 * i + x] = c->pin[i].v + x;
        c->start[closures + i + 1] = entries + 3 * i + 3;
    }
    return envelope_create(k, c->n, c->start, c->column, &c->square);
}

static int make_room(Closer *c)
{
    Kernel *k = c->k;
    c->room = c->n > FEW_EQUATIONS ? 0 : k->nv + MORE_TARGETS;
    c->residual = kernel_reals(k, c->n + c->room); /* that of pinned ones stays zero */
    c->multiplier = kernel_reals(k, c->n + c->room);
    c->q = kernel_reals(k, k->nq);
    c->trial = kernel_reals(k, k->nq);
    c->begin = kernel_reals(k, k->nq);
    c->step = kernel_reals(k, k->nv);
    c->order = kernel_ints(k, c->n);
    if (c->n > FEW_EQUATIONS)
        return kernel_had_memory(k) ? DONE : NO_MEMORY;
    c->dense = kernel_reals(k, (c->n + c->room) * k->nv);
    c->off = kernel_reals(k, c->room);
    c->first_off = kernel_reals(k, c->room);
    c->before = kernel_reals(k, k->nq);
    c->freedom = kernel_reals(k, k->nv * k->nv);
    c->curvature = kernel_reals(k, k->nv * k->nv);
    c->gradient = kernel_reals(k, 4 * k->nv);
    c->few = kernel_reals(k, k->nv);
    c->moves = kernel_ints(k, k->nv);
    c->of_loops = kernel_ints(k, k->nv);
    c->free_index = kernel_ints(k, k->nv);
    if (!kernel_had_memory(k))
        return NO_MEMORY;
    for (Int i = 0; i < c->start[c->n]; i++)
        c->moves[c->column[i]] = 1;
    memcpy(c->of_loops, c->moves, (size_t)k->nv * sizeof(Int));
    return least_motion_create(k, c->n + c->room, k->nv, &c->whole);
}

static int take_axes(Closer *c, const Int *body, const Real *axis, Int n)
{
    for (Int end = 0; end < 2 * n; end++)
        if (!within(body[end], c->k->n_joints))
            return BAD_ARRAYS;
    Real *copy = kernel_reals(c->k, 6 * n);
    if (!copy || !take(c->k, body, 2 * n, &c->rotations.body))
        return NO_MEMORY;
    if (n)
        memcpy(copy, axis, (size_t)(6 * n) * sizeof(Real));
    c->rotations.axis = copy;
    c->rotations.n_pairs = n;
    return DONE;
}

EXPORT int closer_create(Kernel *k, const Int *rotations, Int n_rotations, const Int *pins,
                         Int n_pins, const Int *body, const Real *axis, Int n_axes, Closer **out)
{
    Closer *c = kernel_memory(k, 1, sizeof *c);
    const Int *pin = NULL;
    *out = NULL;
    if (!c || n_rotations < 0 || n_pins < 0)
        return c ? BAD_ARRAYS : NO_MEMORY;
    c->k = k;
    c->rotations.n = n_rotations;
    c->n_pins = n_pins;
    if (!take(k, rotations, n_rotations, &c->rotations.first) ||
        !take(k, rotations + n_rotations, n_rotations, &c->rotations.axes) ||
        !take(k, pins, 4 * n_pins, &pin))
        return NO_MEMORY;
    c->pin = (const Pin *)pin;
    if (!rotations_are_sound(k, &c->rotations) || !pins_are_sound(k, c->pin, n_pins))
        return BAD_ARRAYS;
    int code = make_pattern(c);
    if (code == DONE)
        code = make_room(c);
    if (code == DONE)
        code = take_axes(c, body, axis, n_axes);
    if (code == DONE)
        *out = c;
    return code;
}

static void begin(Closer *c, const Real *pinned, const Real *reference, Real cut)
{
    c->wanted = pinned;
    c->cut = cut;
    c->squares = c->n > FEW_EQUATIONS;
    c->targets.n = c->n_rows = 0;
    memcpy(c->k->angle_reference, reference, (size_t)c->k->n_angles * sizeof(Real));
}

Real closer_close_one(Closer *c, Real *q, const Closing *how, const Real *reference, Real cut)
{
    begin(c, NULL, reference, cut);
    const Real error = begin_from(c, how, q, WORTHWHILE) ? close_one(c, how) : INFINITY;
    equations_values(c->k, c->q);
    memcpy(q, c->q, (size_t)c->k->nq * sizeof(Real));
    return error;
}

/* Take whole turns off the angles of a configuration q (nq), where some are named. error: its closure
   error; mirrored: whether axes point opposite ways; distance: from the named values. */
static void judge(Closer *c, Real *q, const Real *reference, const Named *named, Real *error,
                  Int *mirrored, Real *distance)
{
    Kernel *k = c->k;
    *distance = 0.0;
    if (named->value)
        unwrap_angles(k, named, q);
    equations_values_near(k, q, reference);
    *error = equations_error(k);
    *mirrored = rotations_are_mirrored(k, &c->rotations);
    if (named->value)
        *distance = named_distance(k, named, q);
}

/* Make the columns of the closure equations' derivatives alike: short levers are none then. A zero
   column stays zero; `square` (nv) is scratch. */
static void make_even(Kernel *k, Real *square)
{
    const Int entries = k->entry_start[k->n_closure];
    memset(square, 0, (size_t)k->nv * sizeof(Real));
    for (Int e = 0; e < entries; e++)
        square[k->entry_v[e]] += k->entry[e] * k->entry[e];
    for (Int e = 0; e < entries; e++)
        if (square[k->entry_v[e]] > TOLERANCE_RANK * TOLERANCE_RANK)
            k->entry[e] /= sqrt(square[k->entry_v[e]]);
}

/* How clearly equations, all columns alike, are independent or follow from others: the length of what
   is left of the last independent one, and of the longest of the others, by the first one's. The
   latter is not quite zero if there are any. */
static int judge_independence(Closer *c, Real *least, Real *left_out)
{
    Kernel *k = c->k;
    Real facts[2];
    equations_jacobian(k, &k->equations.all);
    make_even(k, c->step);
    const Int rank = independent_equations(k, NULL, k->n_closure, k->n_closure, TOLERANCE_RANK,
                                            c->order, facts);
    if (rank < 0)
        return NO_MEMORY;
    *least = k->n_closure ? facts[0] : 1.0;
    *left_out = rank < k->n_closure ? fmax(facts[1], DBL_MIN) : 0.0;
    return DONE;
}

EXPORT int closer_examine(Closer *c, Real *q, const Real *reference, const Named *named, Real *facts,
                          Real *angle, Int *mirrored)
{
    judge(c, q, reference, named, facts, mirrored, facts + 1);
    if (!angle)
        return DONE;
    memcpy(angle, c->k->angle, (size_t)c->k->n_angles * sizeof(Real));
    return judge_independence(c, facts + 2, facts + 3);
}

/* Where c->q is, turns taken off: row i. */
static void judge_one(Closer *c, ClosureTask *r, Int i)
{
    Real *q = r->q + i * c->k->nq;
    memcpy(q, c->q, (size_t)c->k->nq * sizeof(Real));
    judge(c, q, r->reference, &r->named, r->error + i, r->mirrored + i, r->distance + i);
}

static void reach_one(Closer *c, ClosureTask *r, Int i)
{
    const int is_number = begin_from(c, &r->how, r->q + i * c->k->nq, WORTHWHILE);
    if (is_number)
        close_one(c, &r->how);
    judge_one(c, r, i);
    if (!is_number)
        r->error[i] = INFINITY;
}

static int is_sound(const ClosureTask *r, Int i)
{
    return r->error[i] <= TOLERANCE_CLOSED && !r->mirrored[i];
}

/* Whether the last row, from where not much is left to go, leads no nearer than another: that is less
   than the difference, or both are at the same place, of all that is named. */
static int leads_no_nearer(const Closer *c, const ClosureTask *r, Int nearest)
{
    Named closest = r->named;
    closest.value = r->q + nearest * c->k->nq;
    return r->distance[r->m] - c->rest >= r->distance[nearest] * (1.0 - AS_NEAR) ||
           named_distance(c->k, &closest, r->q + r->m * c->k->nq) <= c->rest;
}

/* The distance below which a place is nearer than another one. */
static Real nearer_than(Real distance) { return distance * (1.0 - NEARER_PART) - NEARER_BY; }

/* Close from the start in the last row; 0 where that leads no nearer than another row, which is seen
   before the last steps. */
static int reaches_nearer(Closer *c, ClosureTask *r, Int nearest)
{
    const Closing *how = &r->how;
    if (begin_from(c, how, r->q + r->m * c->k->nq, WORTHWHILE_FURTHER)) {
        if (come_near(c, how->free, SEEN, how->iterations, WORTHWHILE) <= SEEN) {
            judge_one(c, r, r->m);
            if (c->rest < SEEN && leads_no_nearer(c, r, nearest))
                return 0;
            come_near(c, how->free, how->tolerance, how->iterations, WORTHWHILE);
        }
        polish(c);
    }
    judge_one(c, r, r->m);
    return !is_sound(r, r->m) || r->distance[r->m] < nearer_than(r->distance[nearest]);
}

/* Put a further start into q: the nearest result so far, a group of loops displaced from where the
   first start was. */
static void put_start(const Closer *c, const ClosureTask *r, Int step, Int nearest, Real *q)
{
    const Kernel *k = c->k;
    memcpy(q, r->q + nearest * k->nq, (size_t)k->nq * sizeof(Real));
    for (Int j = 1; j < k->n_joints; j++) {
        const Int at = k->iq[j], end = j + 1 < k->n_joints ? k->iq[j + 1] : k->nq;
        if (r->group[k->iv[j]] == r->moved[step])
            memcpy(q + at, c->begin + at, (size_t)(end - at) * sizeof(Real));
    }
    tree_integrate(k, q, r->steps + step * k->nv);
}

/* Whether the result in the first row is the closed configuration nearest to its start: the first Newton
   step from there contracts so that there is one solution within twice its length, which is that
   [Deuflhard2011, 2.1]. Named coordinates are all. */
static int is_unique(Closer *c, const ClosureTask *r)
{
    Real *away = c->gradient;
    if (c->squares || r->how.first)
        return 0;
    let_move(c, r->how.free);
    memcpy(c->q, c->begin, (size_t)c->k->nq * sizeof(Real));
    linearise_at(c, c->q);
    try_step(c, 0.0, INFINITY);
    const Real size = norm(c->few, c->n_free);
    if (!(size <= TOLERANCE_DAMPED_STEP))
        return 0; /* from there derivatives change otherwise than that step tells */
    residual_at(c, c->trial, 0);
    take_residual(c);
    try_step(c, 0.0, INFINITY);
    displacement_gradient(c->k, c->begin, r->q, away);
    return norm(c->few, c->n_free) <= TOLERANCE_CONTRACTION * size &&
           norm(away, c->k->nv) <= 2.0 * size;
}

/* Close from further starts, until one leads near to the named values. Of results where nothing is at
   fault only those nearer than all before them stay. */
static void reach_nearer(Closer *c, ClosureTask *r)
{
    Int nearest = 0;
    for (Int i = 0; i < r->n_steps && !(r->distance[nearest] < r->near); i++) {
        put_start(c, r, i, nearest, r->q + r->m * c->k->nq);
        if (!reaches_nearer(c, r, nearest))
            continue;
        if (is_sound(r, r->m))
            nearest = r->m;
        r->m++;
    }
}

/* ---- targets ---- */

/* The gradient (n_free) of the displacement from the start, less the pull of the multipliers. */
static void pulled_gradient(Closer *c, const Real *q, int is_pulled, Real *out)
{
    Real *whole = c->gradient + 3 * c->k->nv;
    displacement_gradient(c->k, c->begin, q, whole);
    for (Int v = 0; v < c->k->nv; v++)
        if (c->free_index[v] >= 0)
            out[c->free_index[v]] = whole[v];
    for (Int r = 0; r < c->n + c->n_rows && is_pulled; r++)
        for (Int i = 0; i < c->n_free; i++)
            out[i] -= c->multiplier[r] * c->dense[r * c->n_free + i];
}

static void put_step(Closer *c, const Real *few, Real factor, Real *q)
{
    for (Int v = 0; v < c->k->nv; v++)
        c->step[v] = c->free_index[v] >= 0 ? factor * c->k->scale[v] * few[c->free_index[v]] : 0.0;
    memcpy(q, c->q, (size_t)c->k->nq * sizeof(Real));
    tree_integrate(c->k, q, c->step);
}

/* The Newton step along n freedoms to the least displacement [NocedalWright2006, 18]: the curvature of
   its Lagrangian is differenced. 0 where that is no minimum. */
static int nearest_step(Closer *c, Int n, Real *along)
{
    const Int m = c->n_free;
    Real *here = c->gradient, *there = c->gradient + c->k->nv;
    pulled_gradient(c, c->q, 0, here);
    least_motion_freedoms(&c->whole, c->freedom);
    least_motion_multipliers(&c->whole, here, c->multiplier);
    for (Int i = 0; i < n; i++)
        along[i] = -dot(c->freedom + i * m, here, m);
    for (Int i = 0; i < n; i++) {
        put_step(c, c->freedom + i * m, DIFFERENCE, c->trial);
        residual_at(c, c->trial, 0);
        equations_jacobian(c->k, &c->k->equations.all);
        memcpy(c->value, c->k->entry, (size_t)c->start[c->k->n_closure] * sizeof(Real));
        fill_dense(c);
        pulled_gradient(c, c->trial, 1, there);
        for (Int j = 0; j < n; j++)
            c->curvature[i * n + j] = (dot(c->freedom + j * m, there, m) + along[j]) / DIFFERENCE;
    }
    for (Int i = 0; i < n; i++)
        for (Int j = 0; j < i; j++)
            c->curvature[i * n + j] = 0.5 * (c->curvature[i * n + j] + c->curvature[j * n + i]);
    return !dense_cholesky_solve(n, c->curvature, along, TOLERANCE_REGULAR);
}

/* Go from a configuration that meets the targets to the nearest to the start that does. Whether that is
   one, and nothing is at the end of its reach. */
static int come_nearest(Closer *c)
{
    Real size_before = INFINITY;
    c->left = 0.0;
    for (int i = 0; i < NEAREST_STEPS; i++) {
        const Int rank = c->whole.rank, n = c->n_free - rank;
        const Real *R = c->whole.R, *last = R + (rank - 1) * (c->whole.n + 1);
        if (rank && fabs(*last) < IN_REACH * TARGET_WEIGHT * fabs(*R))
            return 0;
        if (!n)
            return 1;
        linearise_at(c, c->q);
        least_motion_solve(&c->whole, 0.0, c->residual, c->few);
        Real *along = c->gradient + c->k->nv * 2;
        if (!nearest_step(c, n, along))
            return 0;
        for (Int j = 0; j < n; j++)
            for (Int v = 0; v < c->n_free; v++)
                c->few[v] += along[j] * c->freedom[j * c->n_free + v];
        const Real size = norm(c->few, c->n_free);
        if (!(size < TOLERANCE_DAMPED_STEP && size < 0.5 * size_before))
            return 0;
        size_before = size;
        put_step(c, c->few, 1.0, c->trial);
        accept(c);
        if (size < NEAREST_STEP)
            return isfinite(polish(c));
    }
    return 0;
}

/* Close the loops from the first row where the targets are met too, with the least displacement. */
static int reach_targets(Closer *c, ClosureTask *r)
{
    const Real *start = c->begin;
    c->targets = r->targets;
    c->n_rows = targets_count(c->k, &c->targets);
    if (c->n_rows < 0 || c->n_rows > c->room || c->n + c->n_rows > FEW_EQUATIONS || c->n_pins) {
        c->targets.n = c->n_rows = 0;
        return BAD_ARRAYS;
    }
    targets_mark(c->k, &c->targets, c->moves);
    memcpy(c->q, start, (size_t)c->k->nq * sizeof(Real));
    let_move(c, r->how.free);
    c->whole.m = -1;
    const int is_nearest = go_to_targets(c, r->how.iterations) <= TOLERANCE_TIGHT && come_nearest(c);
    judge_one(c, r, 0);
    targets_values(c->k, &c->targets, c->off);
    r->distance[0] = norm(c->off, c->n_rows);
    memcpy(r->angle, c->k->angle, (size_t)c->k->n_angles * sizeof(Real));
    c->targets.n = c->n_rows = 0;
    memcpy(c->moves, c->of_loops, (size_t)c->k->nv * sizeof(Int));
    return is_nearest ? DONE : NOT_CONVERGED;
}

EXPORT int closer_close(Closer *c, ClosureTask *r)
{
    const Int starts = r->m, is_unique_wanted = r->unique;
    begin(c, r->pinned, r->reference, r->cut);
    r->unique = 0;
    memcpy(c->begin, r->q, (size_t)c->k->nq * sizeof(Real));
    if (r->targets.n)
        return reach_targets(c, r);
    for (Int i = 0; i < starts; i++)
        reach_one(c, r, i);
    if (!r->facts)
        return DONE;
    r->facts[0] = INFINITY;
    if (starts != 1 || !(r->error[0] <= TOLERANCE_CLOSED))
        return DONE;
    const Named nothing = {0};
    Int mirrored;
    const int code = closer_examine(c, r->q, r->reference, &nothing, r->facts, r->angle, &mirrored);
    if (code != DONE || !is_sound(r, 0))
        return code;
    r->unique = is_unique_wanted && is_unique(c, r);
    if (!r->unique)
        reach_nearer(c, r);
    return code;
}

int closed_straight(const ClosureTask *r, Real open)
{
    const Real nearer = nearer_than(r->distance[0]);
    if (!r->n_steps && r->distance[0] > r->near)
        return 0;
    for (Int i = 0; i < r->m; i++)
        if (is_sound(r, i) ? r->distance[i] < nearer
                           : !i || !(r->error[i] > open) || !isfinite(r->error[i]))
            return 0;
    return isfinite(r->facts[0]);
}

/* Descend from configurations q (m, nq) to residuals of a length, by products alone, the angles of
   screws counting from zero; error: (m) these lengths. Nothing is pinned. */
EXPORT int closer_descend(Closer *c, Int m, Real *q, const Int *free, Real tolerance,
                          Int iterations, Real *error)
{
    if (c->n_pins)
        return BAD_ARRAYS;
    const size_t nq = (size_t)c->k->nq;
    const Descent d = {tolerance, iterations, 0, 1, PATIENT, WORTHWHILE};
    let_move(c, free);
    c->cut = 0.0;
    c->squares = 1; /* which leave enough digits for a start */
    for (Int i = 0; i < m; i++) {
        memset(c->k->angle_reference, 0, (size_t)c->k->n_angles * sizeof(Real));
        memcpy(c->q, q + (size_t)i * nq, nq * sizeof(Real));
        error[i] = descend(c, &d);
        memcpy(q + (size_t)i * nq, c->q, nq * sizeof(Real));
    }
    return DONE;
}
