/* Masses of the free coordinates: the reduced mass matrix Gᵀ M G, from the bodies' velocities per
 * unit rate of each. */
#include <string.h>

#include "dense.h"
#include "forces.h"

/* Inertia, relative to the heaviest joint's, that may be round-off: half of the digits of a sum
   of inertias */
#define LIGHT_INERTIA 1e-8
/* Of a freedom's inertia that others leave it, below which digits are lost */
#define LEAST_PIVOT TOLERANCE_REGULAR

/* Velocity (3) of the point of each body at the world origin, and angular velocity (3), per unit
 * rate of a free coordinate. */
static void twists(Dynamics *d, Int i)
{
    Kernel *k = d->k;
    Real *twist = d->work.twist + 6 * k->n_joints * i;
    const Real *column = d->columns + i * k->nv;
    memset(twist, 0, 6 * sizeof *twist);
    for (Int j = 1; j < k->n_joints; j++) {
        Real *own = twist + 6 * j;
        memcpy(own, twist + 6 * k->parent[j], 6 * sizeof *own);
        for (Int v = k->iv[j]; v < k->iv[j] + joint_nv(k->kind[j]); v++) {
            add3(k->scale[v] * column[v], k->linear + 3 * v, own);
            add3(k->scale[v] * column[v], k->angular + 3 * v, own + 3);
        }
    }
}

/* Make the twist of a body one of its centre of mass, and of its own axes. */
static void see_from_centre(const Kernel *k, Int j, Real *twist)
{
    Real centre[3], velocity[3], turn[3];
    rotate3(k->R + 9 * j, k->bodies.com + 3 * j, centre);
    add3(1.0, k->p + 3 * j, centre);
    cross3(twist + 3, centre, velocity);
    add3(1.0, velocity, twist);
    rotate_back3(k->R + 9 * j, twist + 3, turn);
    copy3(turn, twist + 3);
}

/* Gᵀ M G, its lower half. */
static void reduced_mass(Dynamics *d)
{
    Kernel *k = d->k;
    const Int n = d->n_free, apart = 6 * k->n_joints;
    memset(d->work.mass, 0, (size_t)(n * n) * sizeof *d->work.mass);
    for (Int i = 0; i < n; i++)
        twists(d, i);
    for (Int j = 1; j < k->n_joints; j++) {
        if (!moves_mass(k, j))
            continue;
        for (Int a = 0; a < n; a++) {
            Real *own = d->work.twist + apart * a + 6 * j, moment[3];
            see_from_centre(k, j, own);
            inertia_times(k, j, own + 3, moment);
            for (Int b = 0; b <= a; b++) {
                const Real *other = d->work.twist + apart * b + 6 * j;
                d->work.mass[a * n + b] += k->bodies.mass[j] * dot3(own, other) +
                                           dot3(moment, other + 3);
            }
        }
    }
    for (Int a = 0; a < n; a++)
        for (Int b = 0; b <= a; b++)
            for (Int v = 0; v < k->nv; v++)
                if (d->forces.armature[v] != 0.0)
                    d->work.mass[a * n + b] += d->forces.armature[v] * k->scale[v] * k->scale[v] *
                                          d->columns[a * k->nv + v] * d->columns[b * k->nv + v];
}

/* Kinetic energy, twice, of a body whose twist about the world origin is (linear, angular). */
static Real inertia_about(const Kernel *k, Int j, const Real *linear, const Real *angular)
{
    Real twist[6], moment[3];
    copy3(linear, twist);
    copy3(angular, twist + 3);
    see_from_centre(k, j, twist);
    inertia_times(k, j, twist + 3, moment);
    return k->bodies.mass[j] * dot3(twist, twist) + dot3(moment, twist + 3);
}

Real largest_inertia(Dynamics *d)
{
    const Kernel *k = d->k;
    Real *own = d->forces.tau, most = 0.0;
    memcpy(own, d->forces.armature, (size_t)k->nv * sizeof *own);
    for (Int j = 1; j < k->n_joints; j++)
        for (Int up = moves_mass(k, j) ? j : 0; up > 0; up = k->parent[up])
            for (Int v = k->iv[up]; v < k->iv[up] + joint_nv(k->kind[up]); v++)
                own[v] += inertia_about(k, j, k->linear + 3 * v, k->angular + 3 * v);
    for (Int v = 0; v < k->nv; v++)
        most = fmax(most, own[v] * k->scale[v] * k->scale[v]);
    return most;
}

/* Freedoms of an open tree from which on it is solved body by body: below, the mass matrix is as
   fast. */
#define LONG_TREE 12
/* Part of the accelerations that round-off may be, as in `equations_of_motion.py` */
#define DOUBTFUL TOLERANCE_RANK

/* Accelerations of an open tree by articulated bodies, whose digits do not depend on its length; 0
 * where a freedom has no inertia, or digits are lost. */
static int tree_solve(Dynamics *d)
{
    const Kernel *k = d->k;
    const Int nv = k->nv;
    Real *force = d->work.tree_room, *needed = force + nv, *a = needed + nv, *scratch = a + nv,
         facts[4];
    tree_evaluate(d->work.tree,
                  &(TreeTask){.n = 1, .q = d->q, .v = d->v, .armature = d->forces.armature, .tau = force});
    for (Int v = 0; v < nv; v++)
        force[v] -= d->forces.tau[v];
    if (tree_masses(d->work.tree, d->q, d->v, force, d->forces.armature, d->work.mass, needed) != DONE)
        return 0;
    tree_accelerations(d->work.tree, 0, force, NULL, a, scratch, facts);
    for (Int i = 0; i < d->n_free; i++)
        d->z[i] = a[d->held[i]] / k->scale[d->held[i]];
    return facts[1] + facts[2] <= DOUBTFUL * facts[0];
}

/* By Cholesky's method, each freedom's own mass made one. */
int masses_solve(Dynamics *d)
{
    const Int n = d->n_free;
    Real *m = d->work.mass, *z = d->z, *unit = d->work.unit;
    if (d->work.tree && n > LONG_TREE)
        return tree_solve(d);
    reduced_mass(d);
    for (Int i = 0; i < n; i++) {
        if (!(m[i * n + i] > LIGHT_INERTIA * d->heaviest))
            return 0;
        unit[i] = 1.0 / sqrt(m[i * n + i]);
    }
    if (n == 1) {
        z[0] /= m[0];
        return 1;
    }
    for (Int i = 0; i < n; i++) {
        z[i] *= unit[i];
        for (Int j = 0; j <= i; j++)
            m[i * n + j] *= unit[i] * unit[j];
    }
    if (dense_cholesky_solve(n, m, z, LEAST_PIVOT))
        return 0;
    for (Int i = 0; i < n; i++)
        z[i] *= unit[i];
    return 1;
}
