/* Many values of a path: steps to each of them, or few steps and samples between their ends. */
#include <float.h>
#include <string.h>

#include "path.h"

/* Way, in longest steps, of a value that is followed to at all: a hundred thousand turns,
   whose angles have lost five digits */
#define FARTHEST_VALUE 640e3
#define MOST_HALVINGS 8.0 /* of a step, before the caller takes over by arc length */
#define LAST_HALVINGS 48.0 /* the same where there is no going on: a component is driven, or the way
                             is to be gone as far as it goes */
#define MOST_FAILED 10000 /* steps on the way to one value: every path ends */
#define REGROWTH 1.03  /* of the way between points from sample to sample, while there is none between */
#define FIRST_FAILURES 8     /* steps in vain that are worth it to learn where samples can be interpolated; */
#define FAILURES_APART 40    /* samples to one more: all of them take little of the time */
#define SHORTENINGS 3        /* of steps to interpolate in, each as long as the last one has shown */
#define MOST_ABREAST 128 /* samples closed between two points, 32 times as many as lanes: steps are few */
#define ABREAST_AIM 1e-8    /* residual of predictions there: one correction squares it */
#define ABREAST_MOST 1.0    /* way between them */
#define BETWEEN_NEARER 0.0625 /* part of the way to where the determinant vanishes that a step which
                            samples are interpolated in may go. At a limit the determinant falls
                            like a root, and that way is four times the true one: a quarter of
                            this is left, and the path's sixth derivative grows fivefold */

/* Go on to a value of s, by one piece of the drivers' laws. */
static int reach_within(Path *path, Real target)
{
    const Real first = smaller_of(fabs(target - path->here->s), longest_step(path, target));
    const int is_last = path->goes_to_end || path->k->system.n_pins;
    const Real least = first * exp2(is_last ? -LAST_HALVINGS : -MOST_HALVINGS);
    Real length = first;
    Int failed = 0;
    if (!(fabs(target - path->here->s) <= FARTHEST_VALUE * longest_step(path, target)))
        return UNSAFE;
    while (path->here->s != target) {
        const Real left = target - path->here->s;
        const Real parts = ceil(fabs(left) / smaller_of(length, longest_step(path, target)) - 1e-9);
        const Real goal = parts <= 1.0 ? target : path->here->s + left / parts;
        const Real tried = fabs(goal - path->here->s);
        const int code = goal != path->here->s ? step(path, goal) : UNSAFE;
        if (code == DONE)
            length = larger_of(length, 2.0 * tried);
        else if (code == NO_MEMORY || 0.5 * tried < least || tried == 0.0 || ++failed > MOST_FAILED)
            return code;
        else
            length = 0.5 * tried;
    }
    return DONE;
}

int reach(Path *path, Real target)
{
    int code = isfinite(target) ? DONE : UNSAFE;
    while (code == DONE && path->here->s != target) {
        code = turn_into(path, target - path->here->s);
        if (code == DONE)
            code = reach_within(path, piece_end(&path->prescribed, path->here->s, target));
    }
    return code;
}

void write_row(Path *path, const PathRows *rows, Int i)
{
    const Kernel *k = path->k;
    const Point *here = path->here;
    memcpy(rows->q + i * k->nq, here->q, (size_t)k->nq * sizeof *here->q);
    memcpy(rows->t + i * k->nv, here->t, (size_t)k->nv * sizeof *here->t);
    memcpy(rows->c + i * k->nv, here->c, (size_t)k->nv * sizeof *here->c);
    memcpy(rows->angles + i * k->n_angles, here->angle, (size_t)k->n_angles * sizeof *here->angle);
    rows->error[i] = here->error;
    if (rows->estimate)
        estimate_here(path, rows->estimate + 3 * i);
}

/* Row i is where the path stands; at a break the laws go on as behind it. */
static int put_row(Path *path, const PathRows *rows, Int i)
{
    const int code = turn_into(path, 1.0);
    write_row(path, rows, i);
    return code;
}

/* ---- values between two points ---- */

/* Whether the value after the one at i lies ahead, in the sense of a number. */
static int lies_ahead(const Real *values, Int i, Int n, Real sense)
{
    return i + 1 < n && (values[i + 1] - values[i]) * sense > 0.0;
}

/* Put a point ahead, which polynomials of the first step go through as well, and come back. */
static int look_beyond(Path *path, Real h)
{
    Point *const from = path->here;
    if (step(path, from->s + h) != DONE)
        return 0;
    path->before = path->here;
    path->here = from;
    path->stale = 1;
    return 1;
}

/* The last of the values from i on, one after the other in one sense to number `end`, that one step may
   reach. */
static Int last_within(Path *path, const Real *values, Int i, Int end)
{
    const Real s = path->here->s, sense = values[i] - s;
    const Real left = fabs(values[end] - s), wanted = step_of(path, path->between_way);
    if (i == end || sense == 0.0 || fabs(values[i + 1] - s) > wanted || turn_into(path, sense) != DONE)
        return i;
    const Real ends = piece_end(&path->prescribed, s, copysign(INFINITY, sense));
    const Real longest = fmin(longest_step(path, values[i]), wanted);
    if (look_ahead(path, copysign(longest, sense)) != DONE)
        return i;
    Real most = fmin(fmin(longest, BETWEEN_NEARER * distance_ahead(path, sense)), fabs(ends - s));
    if (path->accuracy.between <= WITHOUT_THIRD) {
        const Real beyond = fmin(most * (1.0 + BETWEEN_NEAREST), left);
        const int is_worth = path->has_before || fabs(values[i + 1] - s) < beyond;
        if (!is_worth || (!path->has_before && !look_beyond(path, copysign(beyond, sense))))
            return i;
        const Real third = third_reaches(path->before, path->here, sense);
        if (third < 0.7 * fmin(fmin(most, left), step_of(path, SOONEST)))
            return i;
        most = fmin(most, third);
    }
    most = (1.0 + DBL_EPSILON) * left / ceil(left / most); /* in steps of one length */
    Int last = i;
    while (last < end && fabs(values[last + 1] - s) <= most)
        last++;
    return last;
}

/* Write rows from i to before `last`, at values between a point and the present one. Their closure error
   is a bound. */
static void put_between(Path *path, const Real *values, const Real *estimate, const PathRows *rows, Int i,
                        Int last)
{
    Kernel *k = path->k;
    for (Int row = i; row < last; row += LANES)
        between_at(k, &path->between, values + row, last - row < LANES ? last - row : LANES,
                   rows->q + row * k->nq, rows->t + row * k->nv, rows->c + row * k->nv,
                   rows->angles + row * k->n_angles);
    for (Int row = i; row < last; row++) {
        prescribe(&path->prescribed, values[row]);
        prescribed_put(&path->prescribed, rows->q + row * k->nq);
        rows->error[row] = path->between_open;
        memcpy(rows->estimate + 3 * row, estimate, 3 * sizeof *estimate);
    }
}

/* Take the last step back, to a point with another one before it, or NULL. */
static void go_back(Path *path, Point *before, Point *to)
{
    Point *const ahead = path->here;
    for (int i = 0; i < 3; i++)
        if (path->points + i != ahead && path->points + i != to)
            path->before = path->points + i;
    path->next = ahead;
    path->here = to;
    path->has_before = before != NULL;
    path->stale = 1;
}

/* Go to value `last` in one step, and write the rows from i on that lie before it. Returns how
 * many rows are done: none if the step fails, or if its middle is not as exact as it should be. */
static Int follow_between(Path *path, const Real *values, Int i, Int last, const PathRows *rows)
{
    Point *const from = path->here, *const third = path->has_before ? path->before : NULL;
    Real estimate[3];
    if (step(path, values[last]) != DONE) {
        path->between_way *= 0.5;
        return 0;
    }
    if (!(estimate_between(path, third, from, estimate) <= 1.0)) {
        go_back(path, third, from);
        return 0;
    }
    put_between(path, values, estimate, rows, i, last);
    const int code = put_row(path, rows, last);
    for (int x = 0; x < 3; x++) /* which a probe far back may not know */
        rows->estimate[3 * last + x] = larger_of(rows->estimate[3 * last + x], estimate[x]);
    return last - i + (code == DONE);
}

/* ---- values between two points, closed a few side by side ---- */

/* The last of the values from i on that a step may reach which those before it are closed in; i where these
   are too few. */
static Int last_abreast(Path *path, const Real *values, Int i, Int n)
{
    const Real s = path->here->s, sense = values[i] - s;
    const Real longest = smaller_of(longest_step(path, values[i]), step_of(path, path->abreast_way));
    const Int few = i + LANES - 1;
    if (!(few < n) || !(fabs(values[few] - s) <= longest) || !lies_ahead(values, i, n, sense) ||
        turn_into(path, sense) != DONE || look_ahead(path, copysign(longest, sense)) != DONE)
        return i;
    const Real end = piece_end(&path->prescribed, s, copysign(INFINITY, sense));
    const Real most = smaller_of(smaller_of(longest, BETWEEN_NEARER * distance_ahead(path, sense)),
                                 fabs(end - s));
    Int last = i;
    while (lies_ahead(values, last, n, sense) && fabs(values[last + 1] - s) <= most &&
           last - i < MOST_ABREAST)
        last++;
    const Int inner = last - i;
    return inner < LANES - 1 ? i : inner < LANES ? last : i + inner / LANES * LANES;
}

/* Go to value `last` in one step, and close the samples from i on that lie before it. Returns how many rows
   are done: none if something does not go at once. */
static Int follow_abreast(Path *path, const Real *values, Int i, Int last, const PathRows *rows)
{
    Point *const from = path->here, *const third = path->has_before ? path->before : NULL;
    Real predicted = 0.0;
    if (step(path, values[last]) != DONE) {
        path->abreast_way *= 0.5;
        return 0;
    }
    between_make(path->k, third, from, path->here, &path->between);
    if (!close_abreast(path, from, values + i, last - i, rows, i, &predicted)) {
        path->abreast_way *= 0.5;
        go_back(path, third, from);
        return 0;
    }
    const Real part = pow(ABREAST_AIM / larger_of(predicted, 1e-30), 1.0 / 9.0);
    path->abreast_way = smaller_of(path->abreast_way * larger_of(smaller_of(part, 2.0), 0.5), ABREAST_MOST);
    return last - i + (put_row(path, rows, last) == DONE);
}

Int follow_values(Path *path, const Real *values, Int n, const PathRows *rows)
{
    int tried = 0; /* steps that samples could not be interpolated in, one after the other */
    Int end = -1;  /* of the values that go on in one sense */
    Int failed = 0; /* of those steps */
    const int is_abreast = n > LANES && goes_abreast(path);
    for (Int i = 0; i < n;) {
        if (i > end)
            for (end = i; lies_ahead(values, end, n, values[i] - path->here->s);)
                end++;
        const int is_tried = path->accuracy.between > 0.0 && failed <= FIRST_FAILURES + i / FAILURES_APART;
        const Int last = is_tried ? last_within(path, values, i, end) : i;
        const Real way = path->between_way;
        const Int done = last > i ? follow_between(path, values, i, last, rows) : 0;
        i += done;
        tried = done ? 0 : tried + 1;
        failed += last > i && !done;
        if (done || (last > i && tried < SHORTENINGS && path->between_way < way))
            continue;
        const Int abreast = is_abreast ? last_abreast(path, values, i, n) : i;
        const Int closed = abreast > i ? follow_abreast(path, values, i, abreast, rows) : 0;
        i += closed;
        if (closed)
            continue;
        const int code = reach(path, values[i]);
        path->between_way *= REGROWTH;
        if (code != DONE || put_row(path, rows, i) != DONE)
            return i;
        i++;
    }
    return n;
}
