/* The square system: chosen closure equations, idle rotations, drivers, and rows that fill
 * it up where freedoms are left (passive ones that nothing determines). Unknowns are v / scale. */
#include <string.h>

#include "choosing.h"
#include "memory.h"
#include "pins.h"

SHARED Int driven_at(const Kernel *k, Int i) { return k->system.driven[i] % k->nv; }

WITHIN Number *put_equation_values(const Evaluated *s, Int equation, Number *to)
{
    const Kernel *k = kernel_of(s);
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
        *to++ = s->entry[e];
    return to;
}

/* Put what the matrix has at the evaluated point, in the order of its entries. */
WITHIN void put_values(const Evaluated *s, Number *value)
{
    const Kernel *k = kernel_of(s);
    Number *to = value;
    for (Int i = 0; i < k->system.n_chosen; i++)
        to = put_equation_values(s, k->system.chosen[i], to);
    for (Int i = k->n_closure; i < k->n_equations; i++)
        to = put_equation_values(s, i, to);
#if N_PARTS == 1
    for (Int i = 0; i < k->system.n_pins; i++)
        pin_scaled_row(k, k->system.pin + i, value + k->system.pin_entry[i]);
#else
    for (Int e = to - value; e < k->system.matrix.n; e++)
        value[e] = SPREAD(k->system.matrix.value[e]);
#endif
}

SHARED void system_put_rates(Evaluated *s, const Number *rate)
{
    const Kernel *k = kernel_of(s);
    Number *x = s->right + k->system.n_chosen + k->n_idle;
    memset(s->right, 0, (size_t)k->nv * sizeof *x);
    for (Int i = 0; i < k->system.n_driven; i++)
        x[i] = rate[i] / k->scale[driven_at(k, i)];
}

SHARED void system_add_bias(Evaluated *s, const Number *v, Real factor, Number *right)
{
    const Kernel *k = kernel_of(s);
    equations_bias(s, &k->equations.system, v);
    for (Int i = 0; i < k->system.n_chosen; i++)
        right[i] += factor * s->equations.bias[k->system.chosen[i]];
    for (Int i = 0; i < k->n_idle; i++)
        right[k->system.n_chosen + i] += factor * s->equations.bias[k->n_closure + i];
}

SHARED void system_put_accelerations(Evaluated *s, const Number *v, const Number *acceleration)
{
    system_put_rates(s, acceleration);
    system_add_bias(s, v, -1.0, s->right);
#if N_PARTS == 1
    const Kernel *k = s;
    for (Int i = 0; i < k->system.n_pins; i++) {
        const Pin *pin = k->system.pin + i;
        s->right[k->system.pin_row[i]] -= pin_bias(pin, k->q, v) / k->scale[pin->v + pin->component];
    }
#endif
}

/* Rates that are prescribed are so to the last digit. Returns the square of their scaled size. */
WITHIN Number solve_rates(Evaluated *s, const Number *prescribed, Number *rates)
{
    const Kernel *k = kernel_of(s);
    Number square = SPREAD(0.0);
    system_solve(s, s->right);
    for (Int v = 0; v < k->nv; v++) {
        square += s->right[v] * s->right[v];
        rates[v] = k->scale[v] * s->right[v];
    }
    for (Int i = 0; i < k->system.n_driven; i++)
        if (k->system.driven[i] < k->nv)
            rates[k->system.driven[i]] = prescribed[i];
    return square;
}

SHARED void system_path_rates(Evaluated *s, const Number *rate, const Number *bend, Number *first,
                              Number *second, Number *squares)
{
    system_put_rates(s, rate);
    squares[0] = solve_rates(s, rate, first);
    system_put_accelerations(s, first, bend);
    squares[1] = solve_rates(s, bend, second);
}

#if N_PARTS == 1

void system_solve(const Kernel *k, Real *x) { lu_solve(k->system.lu, x); }

static int indices_are_sound(const Int *index, Int n, Int below)
{
    for (Int i = 0; i < n; i++)
        if (!within(index[i], below))
            return 0;
    return 1;
}

static Int put_equation(const Kernel *k, Int row, Int equation, Entries *to)
{
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
        entries_put(to, row, k->entry_v[e], k->entry[e]);
    return row + 1;
}

int system_put_equations(const Kernel *k, const Int *equations, Int n, Int more, Entries *to)
{
    Int row = 0, room = more + k->entry_start[k->n_equations] - k->entry_start[k->n_closure];
    for (Int i = 0; i < n; i++)
        room += k->entry_start[equations[i] + 1] - k->entry_start[equations[i]];
    if (!entries_begin(to, room))
        return 0;
    for (Int i = 0; i < n; i++)
        row = put_equation(k, row, equations[i], to);
    for (Int i = k->n_closure; i < k->n_equations; i++)
        row = put_equation(k, row, i, to);
    return 1;
}

void system_put_driven(const Kernel *k, Int row, Int driven, const Pin *pin, Entries *to)
{
    Real gradient[3];
    if (driven < k->nv) {
        entries_put(to, row, driven, 1.0);
        return;
    }
    pin_scaled_row(k, pin, gradient);
    for (Int x = 0; x < 3; x++)
        entries_put(to, row, pin->v + x, gradient[x]);
}

void system_put_fill(const Kernel *k, Int row, const Real *fill, Int n, Entries *to)
{
    for (Int i = 0; i < n; i++)
        for (Int v = 0; v < k->nv; v++)
            if (fill[i * k->nv + v] != 0.0)
                entries_put(to, row + i, v, fill[i * k->nv + v]);
}

/* The matrix, whose values of equations and components are those of some point. */
static int lay_out(Kernel *k)
{
    Int row = k->system.n_chosen + k->n_idle;
    if (!system_put_equations(k, k->system.chosen, k->system.n_chosen,
                              3 * k->system.n_driven + k->system.n_fill * k->nv, &k->system.matrix))
        return NO_MEMORY;
    k->system.n_pins = 0;
    for (Int i = 0; i < k->system.n_driven; i++, row++) {
        Pin *pin = k->system.pin + k->system.n_pins;
        if (k->system.driven[i] >= k->nv && pin_of(k, driven_at(k, i), pin)) {
            k->system.pin_row[k->system.n_pins] = row;
            k->system.pin_entry[k->system.n_pins++] = k->system.matrix.n;
        }
        system_put_driven(k, row, k->system.driven[i], pin, &k->system.matrix);
    }
    system_put_fill(k, row, k->system.fill, k->system.n_fill, &k->system.matrix);
    equations_of_system(k);
    lu_forget(k->system.lu);
    return DONE;
}

static int driven_is_sound(const Kernel *k, const Int *driven, Int n)
{
    Pin pin;
    for (Int i = 0; i < n; i++)
        if (!within(driven[i], 2 * k->nv) ||
            (driven[i] >= k->nv && !pin_of(k, driven[i] - k->nv, &pin)))
            return 0;
    return 1;
}

int system_set(Kernel *k, const Int *chosen, Int n_chosen, const Int *driven, Int n_driven,
               const Real *fill, Int n_fill)
{
    if (n_chosen < 0 || n_driven < 0 || n_fill < 0 || n_chosen > k->nv || n_driven > k->nv ||
        n_fill > k->nv || n_chosen + k->n_idle + n_driven + n_fill != k->nv)
        return BAD_ARRAYS;
    if (chosen ? !indices_are_sound(chosen, n_chosen, k->n_closure) : n_chosen > k->n_closure)
        return BAD_ARRAYS;
    if (!driven_is_sound(k, driven, n_driven))
        return BAD_ARRAYS;
    if (n_fill > 0 && fill != k->system.fill) {
        if (!widen((void **)&k->system.fill, n_fill * k->nv, sizeof *k->system.fill))
            return NO_MEMORY;
        memcpy(k->system.fill, fill, (size_t)(n_fill * k->nv) * sizeof *k->system.fill);
    }
    for (Int i = 0; i < n_chosen; i++)
        k->system.chosen[i] = chosen ? chosen[i] : i;
    if (n_driven > 0) /* else there may be no array */
        memmove(k->system.driven, driven, (size_t)n_driven * sizeof *driven);
    k->system.n_chosen = n_chosen;
    k->system.n_driven = n_driven;
    k->system.n_fill = n_fill;
    return lay_out(k);
}

/* Factor with the order there is; choose another where it has become a bad one. */
int system_factor(Kernel *k)
{
    k->system.factorisations++;
    if (k->system.matrix.n) /* else there is no system yet */
        put_values(k, k->system.matrix.value);
    for (int attempt = 0; attempt < 2; attempt++) {
        int code = DONE;
        if (attempt || !lu_has_order(k->system.lu)) {
            k->system.orders++;
            code = lu_analyse(k->system.lu, k->nv, &k->system.matrix);
        }
        if (code != DONE)
            return code;
        const int factored = lu_factor(k->system.lu, k->system.matrix.value);
        lu_determinant(k->system.lu, &k->system.sign, &k->system.mantissa, &k->system.exponent);
        k->system.pivot_ratio = lu_pivot_ratio(k->system.lu);
        if (factored > 0 || (factored < 0 && attempt))
            return DONE;
    }
    return SINGULAR;
}

int system_choose(Kernel *k, const Int *chosen)
{
    memcpy(k->system.chosen, chosen, (size_t)k->system.n_chosen * sizeof *chosen);
    return lay_out(k);
}

int system_reselect(Kernel *k)
{
    Real facts[2];
    equations_jacobian(k, &k->equations.all);
    const Int rank = independent_equations(k, NULL, k->n_closure, k->system.n_chosen, 0.0,
                                            k->system.candidate, facts);
    if (rank < 0)
        return NO_MEMORY;
    k->system.left_out = facts[1];
    return rank == k->system.n_chosen ? system_choose(k, k->system.candidate) : SINGULAR;
}

#endif
