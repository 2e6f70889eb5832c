/* Values of what is driven along a path, see prescribing.h. */
#include <stdlib.h>
#include <string.h>

#include "prescribing.h"

#define MOST_DEGREE 100 /* of a polynomial: beyond, its terms cancel all digits */
#define MOST_PIECES 100000000

static void find_single(const Kernel *k, Int v, Int *place)
{
    for (Int j = 1; j < k->n_joints; j++)
        if (k->iv[j] == v && joint_nv(k->kind[j]) == 1)
            *place = k->iq[j];
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

int prescribed_create(const Kernel *k, Prescribed *p)
{
    const size_t n = (size_t)k->nv + 1;
    char *from = p->memory = calloc(n, 4 * sizeof(Real) + 2 * sizeof(Int) + sizeof(Pin));
    if (!from)
        return NO_MEMORY;
    p->pin = (Pin *)from;
    p->place = (Int *)(p->pin + n);
    p->pinned = p->place + n;
    p->value = (Real *)(p->pinned + n);
    p->rate = p->value + n;
    p->bend = p->rate + n;
    p->pin_value = p->bend + n;
    return DONE;
}

void prescribed_free(Prescribed *p)
{
    free(p->memory);
    free(p->breaks);
    free(p->coefficient);
}

static int has_value(const Prescribed *p, Int i)
{
    for (Int pin = 0; pin < p->n_pins; pin++)
        if (p->pinned[pin] == i)
            return 1;
    return p->place[i] >= 0;
}

int prescribed_read(const Kernel *k, Prescribed *p)
{
    if (p->n_pieces && p->n != k->n_driven)
        return BAD_ARRAYS;
    p->n = k->n_driven;
    p->n_pins = 0;
    for (Int i = 0; i < p->n; i++) {
        Pin pin;
        p->place[i] = -1;
        if (k->driven[i] < k->nv)
            find_single(k, k->driven[i], p->place + i);
        else if (pin_of(k, driven_at(k, i), &pin))
            take_pin(p, &pin, i);
    }
    return p->n_pieces || (p->n && has_value(p, 0)) ? DONE : BAD_ARRAYS;
}

static int polynomials_are_sound(const Prescribed *p, Int n_pieces, Int degree, const Real *breaks,
                                 const Real *coefficient)
{
    for (Int piece = 0; piece <= n_pieces; piece++)
        if (!isfinite(breaks[piece]) || (piece && !(breaks[piece] > breaks[piece - 1])))
            return 0;
    for (Int piece = 0; piece < n_pieces; piece++)
        for (Int i = 0; i < p->n; i++)
            for (Int d = 0; d <= degree; d++, coefficient++)
                if (!isfinite(*coefficient) || (*coefficient != 0.0 && !has_value(p, i)))
                    return 0;
    return 1;
}

int prescribed_take(Prescribed *p, Int n_pieces, Int degree, const Real *breaks,
                    const Real *coefficients)
{
    if (n_pieces < 1 || n_pieces > MOST_PIECES || !within(degree, MOST_DEGREE + 1) ||
        !polynomials_are_sound(p, n_pieces, degree, breaks, coefficients))
        return BAD_ARRAYS;
    const size_t n = (size_t)(n_pieces * p->n * (degree + 1));
    Real *own = malloc((size_t)(n_pieces + 1) * sizeof *own);
    Real *numbers = malloc((n + 1) * sizeof *own);
    if (!own || !numbers) {
        free(own);
        free(numbers);
        return NO_MEMORY;
    }
    memcpy(own, breaks, (size_t)(n_pieces + 1) * sizeof *own);
    memcpy(numbers, coefficients, n * sizeof *numbers);
    free(p->breaks);
    free(p->coefficient);
    p->breaks = own, p->coefficient = numbers;
    p->n_pieces = n_pieces, p->degree = degree, p->piece = 0;
    return DONE;
}

static Real value_at(const Prescribed *p, const Real *q, Int i, Real wanted)
{
    for (Int pin = 0; pin < p->n_pins; pin++)
        if (p->pinned[pin] == i)
            return pin_value_near(p->pin + pin, q, wanted);
    return p->place[i] >= 0 ? q[p->place[i]] : 0.0;
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
        Real value = 0.0, rate = 0.0, half = 0.0;
        for (Int d = p->degree; d >= 0; d--) { /* Horner's scheme of a value and its derivatives */
            half = half * x + rate;
            rate = rate * x + value;
            value = value * x + a[d];
        }
        p->value[i] = value;
        p->rate[i] = rate;
        p->bend[i] = 2.0 * half;
    }
}

void prescribed_put(Prescribed *p, Real *q)
{
    for (Int i = 0; i < p->n; i++)
        if (p->place[i] >= 0)
            q[p->place[i]] = p->value[i];
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
