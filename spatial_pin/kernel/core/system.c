/* The square system: chosen closure equations, idle rotations, what is driven, and rows that fill
 * it up where freedoms are left (passive ones that nothing determines). Unknowns are v / scale. */
#include <string.h>

#include "choosing.h"
#include "pins.h"

static int indices_are_sound(const Int *index, Int n, Int below)
{
    for (Int i = 0; i < n; i++)
        if (!within(index[i], below))
            return 0;
    return 1;
}

static int make_room(Kernel *k, Int n)
{
    if (n > k->system_room) {
        if (!widen((void **)&k->system_row, n, sizeof(Int)) ||
            !widen((void **)&k->system_column, n, sizeof(Int)) ||
            !widen((void **)&k->system_from, n, sizeof(Int)) ||
            !widen((void **)&k->system_value, n, sizeof(Real)))
            return 0;
        k->system_room = n;
    }
    return 1;
}

static void put(Kernel *k, Int row, Int column, Int from, Real value)
{
    const Int e = k->n_system++;
    k->system_row[e] = row;
    k->system_column[e] = column;
    k->system_from[e] = from;
    k->system_value[e] = value;
}

static Int put_equation(Kernel *k, Int row, Int equation)
{
    for (Int e = k->entry_start[equation]; e < k->entry_start[equation + 1]; e++)
        put(k, row, k->entry_v[e], e, 0.0);
    return row + 1;
}

Int driven_at(const Kernel *k, Int i) { return k->driven[i] % k->nv; }

/* A row of what is driven: one of a freedom; three of a component, that are filled in later. */
static void put_driven(Kernel *k, Int row, Int i)
{
    const Int v = driven_at(k, i);
    if (k->driven[i] < k->nv) {
        put(k, row, v, -1, 1.0);
        return;
    }
    pin_of(k, v, k->pin + k->n_pins);
    k->pin_row[k->n_pins] = row;
    k->pin_entry[k->n_pins] = k->n_system;
    const Int first = k->pin[k->n_pins++].v;
    for (Int x = 0; x < 3; x++)
        put(k, row, first + x, -1, 1.0);
}

/* Where the entries of the square matrix stand and come from. */
static int lay_out(Kernel *k)
{
    Int row = 0, room = k->entry_start[k->n_equations] - k->entry_start[k->n_closure];
    for (Int i = 0; i < k->n_chosen; i++)
        room += k->entry_start[k->chosen[i] + 1] - k->entry_start[k->chosen[i]];
    if (!make_room(k, room + 3 * k->n_driven + k->n_fill * k->nv))
        return NO_MEMORY;
    k->n_system = k->n_pins = 0;
    for (Int i = 0; i < k->n_chosen; i++)
        row = put_equation(k, row, k->chosen[i]);
    for (Int i = k->n_closure; i < k->n_equations; i++)
        row = put_equation(k, row, i);
    for (Int i = 0; i < k->n_driven; i++)
        put_driven(k, row++, i);
    for (Int i = 0; i < k->n_fill; i++, row++)
        for (Int v = 0; v < k->nv; v++)
            if (k->fill[i * k->nv + v] != 0.0)
                put(k, row, v, -1, k->fill[i * k->nv + v]);
    equations_of_system(k);
    lu_forget(k->lu);
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

EXPORT int system_set(Kernel *k, const Int *chosen, Int n_chosen, const Int *driven, Int n_driven,
                      const Real *fill, Int n_fill)
{
    if (n_chosen < 0 || n_driven < 0 || n_fill < 0 || n_chosen > k->nv || n_driven > k->nv ||
        n_fill > k->nv || n_chosen + k->n_idle + n_driven + n_fill != k->nv)
        return BAD_ARRAYS;
    if (chosen ? !indices_are_sound(chosen, n_chosen, k->n_closure) : n_chosen > k->n_closure)
        return BAD_ARRAYS;
    if (!driven_is_sound(k, driven, n_driven))
        return BAD_ARRAYS;
    if (n_fill > 0 && fill != k->fill) {
        if (!widen((void **)&k->fill, n_fill * k->nv, sizeof *k->fill))
            return NO_MEMORY;
        memcpy(k->fill, fill, (size_t)(n_fill * k->nv) * sizeof *k->fill);
    }
    for (Int i = 0; i < n_chosen; i++)
        k->chosen[i] = chosen ? chosen[i] : i;
    if (n_driven > 0) /* else there may be no array */
        memmove(k->driven, driven, (size_t)n_driven * sizeof *driven);
    k->n_chosen = n_chosen;
    k->n_driven = n_driven;
    k->n_fill = n_fill;
    return lay_out(k);
}

/* The rows of components at the point that was evaluated. */
static void turn_pins(Kernel *k)
{
    for (Int i = 0; i < k->n_pins; i++) {
        const Pin *pin = k->pin + i;
        const Real *scale = k->scale + pin->v;
        Real row[3];
        pin_row(pin, k->q, row);
        for (int x = 0; x < 3; x++)
            k->system_value[k->pin_entry[i] + x] = row[x] * scale[x] / scale[pin->component];
    }
}

/* Factor with the order there is; choose another where it has become a bad one. */
int system_factor(Kernel *k)
{
    k->factorisations++;
    for (Int e = 0; e < k->n_system; e++)
        if (k->system_from[e] >= 0)
            k->system_value[e] = k->entry[k->system_from[e]];
    turn_pins(k);
    for (int attempt = 0; attempt < 2; attempt++) {
        int code = DONE;
        if (attempt || !lu_has_order(k->lu))
            code = lu_analyse(k->lu, k->nv, k->n_system, k->system_row, k->system_column,
                              k->system_value);
        if (code != DONE)
            return code;
        const int factored = lu_factor(k->lu, k->system_value);
        lu_determinant(k->lu, &k->sign, &k->pivot_ratio, &k->mantissa, &k->exponent);
        if (factored > 0 || (factored < 0 && attempt))
            return DONE;
    }
    return SINGULAR;
}

void system_solve(const Kernel *k, Real *x)
{
    lu_solve(k->lu, x);
}

int system_choose(Kernel *k, const Int *chosen)
{
    memcpy(k->chosen, chosen, (size_t)k->n_chosen * sizeof *chosen);
    return lay_out(k);
}

int system_reselect(Kernel *k)
{
    Real facts[2];
    equations_jacobian(k, &k->all);
    const Int found =
        independent_equations(k, NULL, k->n_closure, k->n_chosen, 0.0, k->candidate, facts);
    if (found < 0)
        return NO_MEMORY;
    k->left_out = facts[1];
    return found == k->n_chosen ? system_choose(k, k->candidate) : SINGULAR;
}

void system_put_rates(Kernel *k, const Real *rate)
{
    Real *x = k->right + k->n_chosen + k->n_idle;
    memset(k->right, 0, (size_t)k->nv * sizeof *x);
    for (Int i = 0; i < k->n_driven; i++)
        x[i] = rate[i] / k->scale[driven_at(k, i)];
}

void system_put_accelerations(Kernel *k, const Real *v, const Real *acceleration)
{
    equations_bias(k, &k->system, v);
    system_put_rates(k, acceleration);
    for (Int i = 0; i < k->n_chosen; i++)
        k->right[i] = -k->bias[k->chosen[i]];
    for (Int i = 0; i < k->n_idle; i++)
        k->right[k->n_chosen + i] = -k->bias[k->n_closure + i];
    for (Int i = 0; i < k->n_pins; i++) {
        const Pin *pin = k->pin + i;
        k->right[k->pin_row[i]] -= pin_bias(pin, k->q, v) / k->scale[pin->v + pin->component];
    }
}

static void solve_rates(Kernel *k, Real *rates)
{
    system_solve(k, k->right);
    for (Int v = 0; v < k->nv; v++)
        rates[v] = k->scale[v] * k->right[v];
}

void system_path_rates(Kernel *k, const Real *rate, const Real *bend, Real *first, Real *second)
{
    system_put_rates(k, rate);
    solve_rates(k, first);
    system_put_accelerations(k, first, bend);
    solve_rates(k, second);
}
