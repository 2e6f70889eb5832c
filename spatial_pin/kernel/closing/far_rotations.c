/* Products of directions x1 . y2 ... of a closure vanish where its axes are opposite, too, and grow
 * no more beyond a right angle: far from closure they lead to mirror images. There the rotation
 * vector phi that takes the axes of frame 1 to those of frame 2 replaces them: of three
 * axes the logarithm of the relative rotation, of one axis the shortest turn. Near closure both are
 * the same to first order:
 *
 *     x1 . y2 = -phi_z    y1 . z2 = -phi_x    z1 . x2 = -phi_y    (three axes)
 *     x1 . z2 =  phi_y    y1 . z2 = -phi_x                        (one axis, z)
 *
 * The relative angular velocity replaces the derivative of phi. For |phi|^2 / 2 that
 * gives the exact gradient at any angle, half a turn included, where the derivative of phi itself
 * has no bound. */
#include "closing_parts.h"

/* rad; the products of smaller angles differ from them in the third digit, and lead as well */
#define FAR_ANGLE 0.1
/* Sine of the angle of opposite axes, between which no turn is shortest: the root of round-off,
   as the cosine tells no smaller one */
#define OPPOSITE 1e-8
/* Cosine of axes, which is 1 or not above 0 where loops are closed: the middle */
#define SAME_WAY 0.5
/* rad short of half a turn, from where the axis is taken from the squares: the differences that
   it is taken from otherwise have lost two digits */
#define NEARLY_HALF 1e-2

static Int equations_of(Int axes) { return axes == 3 ? 3 : 2; }

static Int product_of(const Kernel *k, Int equation) { return k->equations.product[equation]; }

int rotations_are_sound(const Kernel *k, const Rotations *rotations)
{
    for (Int i = 0; i < rotations->n; i++) {
        const Int axes = rotations->axes[i], first = rotations->first[i];
        if ((axes != 1 && axes != 3) || first < 0 ||
            first > k->n_closure - equations_of(axes))
            return 0;
        for (Int e = first; e < first + equations_of(axes); e++) {
            const Int p = product_of(k, e), entries = k->entry_start[e + 1] - k->entry_start[e];
            if (k->equations.kind[e] != PRODUCT ||
                k->products.support_start[p + 1] - k->products.support_start[p] != entries)
                return 0;
        }
    }
    return 1;
}

void rotation_logarithm(const Real *r, Real *phi)
{
    const Real trace = r[0] + r[4] + r[8];
    const Real angle = trace >= 3.0 ? 0.0 : trace <= -1.0 ? PI : acos(0.5 * (trace - 1.0));
    const Real sines[3] = {r[7] - r[5], r[2] - r[6], r[3] - r[1]};
    if (angle >= PI - NEARLY_HALF) {
        const Real cosine = -0.5 * (trace - 1.0);
        for (int i = 0; i < 3; i++) {
            const Real square = (r[4 * i] + cosine) * angle * angle / (1.0 + cosine);
            phi[i] = (sines[i] > 0.0 ? 1.0 : -1.0) * (square > 0.0 ? sqrt(square) : 0.0);
        }
        return;
    }
    const Real factor = 0.5 * (angle > 1e-8 ? angle / sin(angle) : 1.0);
    for (int i = 0; i < 3; i++)
        phi[i] = factor * sines[i];
}

/* The rotation vector of the shortest turn that takes the z axis to `z`. */
static void shortest_turn(const Real *z, Real *phi)
{
    const Real sine = hypot(z[0], z[1]), angle = atan2(sine, z[2]);
    phi[2] = 0.0;
    if (sine > OPPOSITE) {
        phi[0] = -z[1] * (angle / sine);
        phi[1] = z[0] * (angle / sine);
        return;
    }
    phi[0] = z[2] < 0.0 ? angle : -z[1];
    phi[1] = z[2] > 0.0 ? z[0] : 0.0;
}

/* Axes of frame 2 in those of frame 1, r[3 * i + j] the product of axis i and axis j; of one axis
   the last column only. */
static void relative_axes(const Kernel *k, Int first, Int axes, Real *r)
{
    const Real *one[3], *two[3];
    Real z1[3];
    for (Int i = 0; i < equations_of(axes); i++) {
        one[i] = k->products.B + 3 * product_of(k, first + i);
        two[(i + 1) % 3] = k->products.A + 3 * product_of(k, first + i);
    }
    if (axes == 1) {
        cross3(one[0], one[1], z1);
        one[2] = z1;
        two[2] = two[1];
    }
    for (int i = 0; i < 3; i++)
        for (int j = axes == 3 ? 0 : 2; j < 3; j++)
            r[3 * i + j] = dot3(one[i], two[j]);
}

/* The rotation vector of a closure, in the axes of frame 1. */
static void rotation_vector(const Kernel *k, Int first, Int axes, Real *phi)
{
    Real r[9];
    relative_axes(k, first, axes, r);
    if (axes == 3) {
        rotation_logarithm(r, phi);
        return;
    }
    const Real z[3] = {r[2], r[5], r[8]};
    shortest_turn(z, phi);
}

/* Whether axes that closures make parallel point opposite ways, or are interchanged. */
int rotations_are_mirrored(const Kernel *k, const Rotations *rotations)
{
    for (Int i = 0; i < rotations->n; i++) {
        Real r[9];
        const Int axes = rotations->axes[i];
        relative_axes(k, rotations->first[i], axes, r);
        for (int a = axes == 3 ? 0 : 2; a < 3; a++)
            if (r[4 * a] < SAME_WAY)
                return 1;
    }
    for (Int i = 0; i < rotations->n_pairs; i++) {
        Real axes[6];
        for (Int end = 2 * i; end < 2 * i + 2; end++)
            rotate3(k->R + 9 * rotations->body[end], rotations->axis + 3 * end,
                    axes + 3 * (end - 2 * i));
        if (dot3(axes, axes + 3) < SAME_WAY)
            return 1;
    }
    return 0;
}

int rotations_are_far(const Kernel *k, const Rotations *rotations)
{
    for (Int i = 0; i < rotations->n; i++) {
        Real phi[3];
        rotation_vector(k, rotations->first[i], rotations->axes[i], phi);
        if (dot3(phi, phi) > FAR_ANGLE * FAR_ANGLE)
            return 1;
    }
    return 0;
}

/* The component of phi that replaces an equation is sign * phi[axis], see above. */
static int axis_of(Int axes, Int i) { return axes == 3 ? (int)((i + 2) % 3) : (int)(1 - i); }

static Real sign_of(Int axes, Int i) { return axes == 1 && i == 0 ? 1.0 : -1.0; }

void rotations_put_values(Kernel *k, const Rotations *rotations)
{
    for (Int i = 0; i < rotations->n; i++) {
        const Int axes = rotations->axes[i], first = rotations->first[i];
        Real phi[3];
        rotation_vector(k, first, axes, phi);
        for (Int r = 0; r < equations_of(axes); r++)
            k->residual[first + r] = sign_of(axes, r) * phi[axis_of(axes, r)];
    }
}

void rotations_put_entries(Kernel *k, const Rotations *rotations)
{
    for (Int i = 0; i < rotations->n; i++) {
        const Int axes = rotations->axes[i], first = rotations->first[i];
        for (Int r = 0; r < equations_of(axes); r++) {
            /* the B of equation x1, y1, z1 is that axis of frame 1 */
            const Real *axis = k->products.B + 3 * product_of(k, first + axis_of(axes, r));
            const Int p = product_of(k, first + r), to = k->entry_start[first + r];
            for (Int s = k->products.support_start[p]; s < k->products.support_start[p + 1]; s++)
                k->entry[to + s - k->products.support_start[p]] =
                    sign_of(axes, r) * k->products.support_sign[s] *
                    dot3(axis, k->angular + 3 * k->products.support_v[s]);
        }
    }
}
