/* Values of driven coordinates along a path, see prescribing.h. */
#include "memory.h"
#include "prescribing.h"

#define MOST_DEGREE 100 /* of a polynomial: beyond, its terms cancel all digits */
#define MOST_PIECES 100000000

static void find_single(const Kernel *k, Int v, Int *q_index)
{
    for (Int j = 1; j < k->n_joints; j++)
        if (k->iv[j] == v && joint_nv(k->kind[j]) == 1)
            *q_index = k->iq[j];
}

/* Components in the order of their places: those of one rotation come together. */
static void take_pin(Prescribed *p, const Pin *pin, Int which)
{
    Int at = p->n_pins++;
    for (; at > 0 && p->pin[at - 1].q > pin->q; at--) {
        p->pin[at] = p->pin[at - 1];
        p->pinned[at] = p->pinned[at - 1];
    }
    p->pin[at] = *pin;
    p->pinned[at] = which;
}

int prescribed_create(Kernel *k, Prescribed *p)
{
    p->pin = kernel_memory(k, k->nv, sizeof *p->pin);
    p->q_index = kernel_ints(k, k->nv);
    p->pinned = kernel_ints(k, k->nv);
    p->value = kernel_reals(k, k->nv);
    p->rate = kernel_reals(k, k->nv);
    p->bend = kernel_reals(k, k->nv);
    p->pin_value = kernel_reals(k, k->nv);
    p->still = kernel_ints(k, k->nq);
    p->still_value = kernel_reals(k, k->nq);
    return kernel_had_memory(k) ? DONE : NO_MEMORY;
}

static int has_value(const Prescribed *p, Int i)
{
    for (Int pin = 0; pin < p->n_pins; pin++)
        if (p->pinned[pin] == i)
            return 1;
    return p->q_index[i] >= 0;
}

static int polynomials_are_sound(const Prescribed *p)
{
    const Real *coefficient = p->coefficient;
    if (p->n_pieces > MOST_PIECES || !within(p->degree, MOST_DEGREE + 1))
        return 0;
    for (Int piece = 0; piece <= p->n_pieces; piece++)
        if (!isfinite(p->breaks[piece]) || (piece && !(p->breaks[piece] > p->breaks[piece - 1])))
            return 0;
    for (Int piece = 0; piece < p->n_pieces; piece++)
        for (Int i = 0; i < p->n; i++)
            for (Int d = 0; d <= p->degree; d++, coefficient++)
                if (!isfinite(*coefficient) || (*coefficient != 0.0 && !has_value(p, i)))
                    return 0;
    return 1;
}

/* Whether three entries of the velocity are driven. */
static int are_driven(const Kernel *k, Int v)
{
    Int found = 0;
    for (Int i = 0; i < k->system.n_driven; i++)
        found += k->system.driven[i] >= v && k->system.driven[i] < v + 3;
    return found == 3;
}

/* No equation corrects them: what a prediction by polynomials makes of their round-off would grow from
 * step to step. */
static void let_stand(const Kernel *k, Prescribed *p, const Real *q)
{
    p->n_still = 0;
    for (Int j = 1; j < k->n_joints; j++) {
        const Int turning = k->kind[j] == FREE ? 3 : 0;
        const int is_placed = turning && are_driven(k, k->iv[j]);
        const int is_turned = k->kind[j] >= BALL && are_driven(k, k->iv[j] + turning);
        for (Int x = is_placed ? 0 : turning; x < (is_turned ? turning + 4 : turning); x++) {
            p->still[p->n_still] = k->iq[j] + x;
            p->still_value[p->n_still++] = q[k->iq[j] + x];
        }
    }
}

int prescribed_read(const Kernel *k, Prescribed *p, const Real *q, Int n_pieces, Int degree,
                    const Real *breaks, const Real *coefficient)
{
    let_stand(k, p, q);
    p->n = k->system.n_driven, p->n_pins = p->piece = 0;
    p->n_pieces = n_pieces, p->degree = degree;
    p->breaks = breaks, p->coefficient = coefficient;
    for (Int i = 0; i < p->n; i++) {
        Pin pin;
        p->q_index[i] = -1;
        if (k->system.driven[i] < k->nv)
            find_single(k, k->system.driven[i], p->q_index + i);
        else if (pin_of(k, driven_at(k, i), &pin))
            take_pin(p, &pin, i);
    }
    if (n_pieces)
        return n_pieces > 0 && polynomials_are_sound(p) ? DONE : BAD_ARRAYS;
    return p->n && has_value(p, 0) ? DONE : BAD_ARRAYS;
}

static Real value_at(const Prescribed *p, const Real *q, Int i, Real wanted)
{
    for (Int pin = 0; pin < p->n_pins; pin++)
        if (p->pinned[pin] == i)
            return pin_value_near(p->pin + pin, q, wanted);
    return p->q_index[i] >= 0 ? q[p->q_index[i]] : 0.0;
}

Real prescribed_from(Prescribed *p, const Real *q)
{
    for (Int i = 0; i < p->n; i++) {
        p->value[i] = value_at(p, q, i, 0.0);
        p->rate[i] = i ? 0.0 : 1.0;
        p->bend[i] = 0.0;
    }
    return p->n ? p->value[0] : 0.0;
}

void prescribe(Prescribed *p, Real s)
{
    if (!p->n_pieces) {
        p->value[0] = s;
        return;
    }
    const Int order = p->degree + 1;
    const Real x = s - p->breaks[p->piece], *a = p->coefficient + p->piece * p->n * order;
    for (Int i = 0; i < p->n; i++, a += order) {
        Real at[3];
        polynomial_at(a, p->degree, x, at);
        p->value[i] = at[0], p->rate[i] = at[1], p->bend[i] = at[2];
    }
}

void prescribed_put(Prescribed *p, Real *q)
{
    for (Int i = 0; i < p->n; i++)
        if (p->q_index[i] >= 0)
            q[p->q_index[i]] = p->value[i];
    for (Int i = 0; i < p->n_still; i++)
        q[p->still[i]] = p->still_value[i];
    if (!p->n_pins)
        return;
    for (Int i = 0; i < p->n_pins; i++)
        p->pin_value[i] = p->value[p->pinned[i]];
    pins_put(p->pin, p->n_pins, p->pin_value, q);
}

Real prescribed_gap(const Prescribed *p, const Real *q, Int i)
{
    return has_value(p, i) ? p->value[i] - value_at(p, q, i, p->value[i]) : 0.0;
}

int prescribed_holds(const Prescribed *p, const Real *q)
{
    for (Int pin = 0; pin < p->n_pins; pin++)
        if (!(fabs(prescribed_gap(p, q, p->pinned[pin])) <= TOLERANCE_HALF_PRECISION))
            return 0;
    return 1;
}

Int piece_ahead(const Prescribed *p, Real s, Real sense)
{
    Int low = 0, high = p->n_pieces - 1;
    while (low < high) { /* the last piece whose beginning lies before s */
        const Int middle = (low + high + 1) / 2;
        if (sense < 0.0 ? p->breaks[middle] < s : p->breaks[middle] <= s)
            low = middle;
        else
            high = middle - 1;
    }
    return low;
}

Real piece_end(const Prescribed *p, Real s, Real target)
{
    if (!p->n_pieces)
        return target;
    const Int piece = piece_ahead(p, s, target - s);
    if (target < s)
        return piece > 0 ? fmax(target, p->breaks[piece]) : target;
    return piece + 1 < p->n_pieces ? fmin(target, p->breaks[piece + 1]) : target;
}
