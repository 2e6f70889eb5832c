"""Derivatives of the reactions of the pairs with respect to q, v and efforts.

A joint of the tree hands on what the bodies it carries need, less what else acts on them:

    F_i = sum over the carried bodies j of (W_j - w_j)

at the world's origin, with W_j what moves body j (`_needed`), and w_j the wrenches on
it of springs, closures and from outside.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import brief
from spatial_pin.constraints.composed_equations import combined_wrenches, vector_matrix
from spatial_pin.constraints.trees import motion_cross, skewed, twist_matrices
from spatial_pin.dynamics.coupling_forces import CouplingForce
from spatial_pin.dynamics.derivatives.row_derivatives import RowDerivatives
from spatial_pin.dynamics.derivatives.spring_derivatives import ExternalWrenches, Springs
from spatial_pin.dynamics.reactions import Pairs
from spatial_pin.numerics.linalg import Array


class Linear(NamedTuple):
    """A quantity and its derivatives.

    Attributes:
        value: (n,) the quantity [its unit].
        by_q, by_v, by_effort: (n, nv) its derivatives [its unit by rad or m, rad/s or m/s, N·m or
            N].

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.dynamics_derivatives(mech, sp.assemble(mech, {"crank": 1.0})).on_ground
        >>> found.value.shape, found.by_q.shape, found.by_effort.shape  # (n,), (n, nv), (n, nv)
        ((6,), (6, 3), (6, 3))
    """

    value: Array
    by_q: Array
    by_v: Array
    by_effort: Array

    def __repr__(self) -> str:
        return brief(self)


class ReactionChanges:
    """The reactions of a mechanism and their derivatives.

    Wrenches are arrays (..., 6, 1 + 2 nv + k): the value, then its derivatives with respect to q, v
    and k numbers: the efforts, or what efforts, accelerations and multipliers are functions of.

    Args:
        rows: closure equations and spring lengths at the motion.
        springs: their forces there.
        outside: wrenches on frames.
        effort: (nv,) efforts at joints.
        a, multipliers: accelerations (nv,), and multipliers of the rows `chosen`.
        chosen: the independent rows.
        effort_changes: (nv, k) of the efforts; by default they are the numbers.
        inertia_changes: (njoints, 10, k) of the bodies' numbers, as Pinocchio orders them.
    """

    def __init__(
        self, rows: RowDerivatives, springs: Springs, outside: ExternalWrenches, effort: Array,
        a: Linear, multipliers: Linear, chosen: NDArray[np.intp],
        effort_changes: Array | None = None, inertia_changes: Array | None = None,
    ) -> None:
        self.rows, self.springs, self.outside = rows, springs, outside
        self.effort_changes = np.eye(rows.nv) if effort_changes is None else effort_changes
        self.inertia_changes = inertia_changes
        self.mechanism, self.effort, self.nv = rows.mechanism, effort, rows.nv
        self.by_q = slice(1, 1 + self.nv)
        self.by_v = slice(1 + self.nv, 1 + 2 * self.nv)
        self.a = np.column_stack(a)
        self.multipliers = self._new(rows.constraints.n_closure)
        self.multipliers[chosen] = np.column_stack(multipliers)

    @cached_property
    def placements_by_q(self) -> Array:
        """(njoints, nv, 4, 3) of the placements."""
        bodies = self.rows.bodies
        changes = np.zeros((len(self.rows.placements), self.nv, 4, 3))
        twists = twist_matrices(bodies.columns)[:, :, :3]
        for body, placement in enumerate(self.rows.placements):
            at = np.flatnonzero(bodies.moved_by[bodies.joints[body]])
            whole = np.column_stack([placement, [0.0, 0.0, 0.0, 1.0]])
            changes[body, at] = whole @ twists[at]
        return changes

    def wrenches(self) -> tuple[dict[str, Array], Array]:
        """Return the reactions (6, ...) by pair and the wrench on the fixed link."""
        pairs = Pairs(self.mechanism)
        closed, on_bodies = self._of_closures(pairs)
        self._add_given(on_bodies)
        efforts, coupled = self._efforts(), {c.name: self._coupled(c) for c in pairs.couplings}
        for c in pairs.couplings:
            on_bodies[c.bodies[0]] -= coupled[c.name]
            on_bodies[c.bodies[1]] += coupled[c.name]
            efforts -= np.outer(c.row, self.multipliers[c.at])
        forces = pairs.carried(self._needed() - on_bodies)
        wrenches = {}
        for i in range(1, self.mechanism.model.njoints):
            force = _moved(forces[i], self.rows.placements[i, 3], self.placements_by_q[i, :, 3])
            wrenches[pairs.names[i - 1]] = self._without_effort(pairs, i, force, efforts)
        for (name, _, (_, body), point), wrench in zip(pairs.closed, closed, strict=True):
            wrenches[name] = _moved(wrench, point @ self.rows.placements[body],
                                 point @ self.placements_by_q[body])
        for c in pairs.couplings:
            point = np.append(c.lines[0].point, 1.0)
            wrenches[c.name] = _moved(coupled[c.name], point @ self.rows.placements[c.carrier],
                                    point @ self.placements_by_q[c.carrier])
        ground = on_bodies[0] - forces[pairs.grounded].sum(axis=0)
        ground[3:] += np.cross(pairs.centre, ground[:3], axisb=0, axisc=0)
        return wrenches, ground

    def _new(self, *shape: int) -> Array:
        return np.zeros((*shape, 1 + 2 * self.nv + self.effort_changes.shape[1]))

    # ------------------------------------------------------------ what acts

    def _needed(self) -> Array:
        """Return (njoints, 6, ...) what moves the bodies, and how it changes.

        The wrenches W = X (I a + v x* I v) at the world's origin, with X the force transformation
        of a body and a its acceleration less gravity. As it moves by a twist d of its own axes,
        d(X f) = X (df + d x* f) [Featherstone2008, 2.9].
        """
        tree, total = self.rows.bodies, self._new(len(self.rows.placements), 6)
        whole = self.mechanism.model
        carried = [total[0, :, 1:]]  # world twists of a joint's accelerations that move
        for joint, parent in enumerate(tree.parents[1:].tolist(), start=1):
            own = tree.joint_of == joint
            carried.append(carried[parent] + tree.columns[own].T @ self.a[own, 1:])
        for i, out in enumerate(total[1:], start=1):
            joint = tree.joints[i]
            (v_by_q,), (a_by_q,), (a_by_v,), (columns,) = tree.by_motion(np.array([i]))
            (back,) = tree.to_bodies(np.array([i]))
            inertia, v = whole.inertias[i].matrix(), back @ tree.v[joint]
            pull = self.rows.placements[i, :3] @ whole.gravity.linear
            falling = np.zeros((6, self.nv))
            falling[:3] = skewed(pull) @ columns[3:]
            momentum, dual = inertia @ v, -motion_cross(v).T
            a = back @ tree.a[joint] - np.append(pull, np.zeros(3))  # less gravity
            f = inertia @ a + dual @ momentum
            turning = _bar(momentum) + dual @ inertia
            out[:, 0] = f
            out[:, self.by_q] = inertia @ (a_by_q - falling) + turning @ v_by_q + _bar(f) @ columns
            out[:, self.by_v] = inertia @ a_by_v + turning @ columns
            out[:, 1:] += inertia @ back @ carried[joint]
            if self.inertia_changes is not None:
                out[:, 1 + 2 * self.nv :] += pin.bodyRegressor(
                    pin.Motion(v), pin.Motion(a)) @ self.inertia_changes[i]
            out[:] = back.T @ out
        return total

    def _of_closures(self, pairs: Pairs) -> tuple[list[Array], Array]:
        """Return the wrenches of the closures on their second bodies, and those on all bodies."""
        c, nv = self.rows.constraints, self.nv
        n, matrix = len(c.constants), vector_matrix(c)
        values = self.rows.values[0][:n]
        b, x = (matrix @ self.rows.placements.reshape(-1, 3))[n:].reshape(2, n, 3)
        changed = np.moveaxis(self.placements_by_q, 0, -3).reshape(nv, -1, 3)
        db, dx = np.stack([(matrix @ g)[n:] for g in changed], axis=1).reshape(2, n, nv, 3)
        wrenches = np.hstack([b * c.factors, np.cross(x, b)])
        by_q = np.concatenate([
            db * c.factors[:, :, None],
            np.cross(dx, b[:, None]) + np.cross(x[:, None], db)], axis=-1).swapaxes(1, 2)
        rows, rows_by_q = combined_wrenches(
            c, [values[:, None, None], self.rows.by_q[0][:n, None]],
            [self.rows.motion[0][:, None, None], np.eye(nv)[:, None]],
            [wrenches[:, :, None], by_q], self.rows.angles)
        total = self._new(self.mechanism.model.njoints, 6)

        def borne(own: slice, at: slice) -> Array:
            wrench: Array = np.tensordot(rows[at, :, 0], self.multipliers[own], (0, 0))
            wrench[:, self.by_q] += np.tensordot(self.multipliers[own, 0], rows_by_q[at], 1)
            return wrench

        on_second = []
        for _, own, (first, second), _ in pairs.closed:
            wrench = borne(own, own)
            on_second.append(wrench)
            total[first] -= wrench
            total[second] += wrench
        for at, (row, _, (first, second)) in enumerate(
                pairs.other_body_products, start=c.n_closure):
            wrench = borne(slice(row, row + 1), slice(at, at + 1))
            total[first] -= wrench
            total[second] += wrench
        return on_second, total

    def _coupled(self, coupling: CouplingForce) -> Array:
        """Return the wrench (6, ...) of a coupling on its second body, along its lines."""
        at, changes = (x[coupling.carrier] for x in (self.rows.placements, self.placements_by_q))
        multiplier, total = self.multipliers[coupling.at], self._new(6)
        for line in coupling.lines:
            force, slope = line.force(multiplier[0]), line.slope(multiplier[0])
            wrench, point = self._new(6), np.append(line.point, 1.0)
            wrench[:3] = np.outer(slope @ at[:3], multiplier)
            wrench[:3, 0] = force @ at[:3]
            wrench[:3, self.by_q] += (force @ changes[:, :3]).T
            total += _moved(wrench, -point @ at, -point @ changes)
        return total

    def _add_given(self, on_bodies: Array) -> None:
        """Add the wrenches of springs between frames, and those from outside."""
        forces = self.springs.forces
        for bushing, (_, acts, by_q, by_v) in zip(
                forces.bushings, self.springs.bushings, strict=True):
            a, b = (x @ self.rows.placements[i]
                    for i, x in zip(bushing.bodies, bushing.vectors, strict=True))
            da, db = (x @ self.placements_by_q[i]
                      for i, x in zip(bushing.bodies, bushing.vectors, strict=True))
            unit, turning = np.zeros((12, 6)), np.zeros((self.nv, 12, 6))
            unit[:3, :3], unit[:, 3:] = a[:3], np.cross(b, a)
            turning[:, :3, :3], turning[..., 3:] = da[:, :3], np.cross(db, a) + np.cross(b, da)
            wrench = self._new(6)
            wrench[:, 0] = acts @ unit
            wrench[:, self.by_q] = unit.T @ by_q + (acts @ turning).T
            wrench[:, self.by_v] = unit.T @ by_v
            on_bodies[bushing.bodies[0]] -= wrench
            on_bodies[bushing.bodies[1]] += wrench
        for line, pull in zip(forces.lines, self.springs.lines, strict=True):
            ends = [x @ self.rows.placements[i]
                    for i, x in zip(line.bodies, line.points, strict=True)]
            moved = [x @ self.placements_by_q[i]
                     for i, x in zip(line.bodies, line.points, strict=True)]  # (nv, 3)
            n = pull.along
            turned = pull.per_length * (moved[1] - moved[0] - np.outer(pull.row, n))
            along = np.concatenate([n, np.cross(ends[1], n)])
            bent = np.hstack([
                turned, pull.force * np.cross(moved[1], n) + np.cross(ends[1], turned)]).T
            wrench = self._new(6)
            wrench[:, 0] = pull.force * along
            wrench[:, self.by_q] = np.outer(along, pull.by_q) + bent
            wrench[:, self.by_v] = np.outer(along, pull.by_v)
            on_bodies[line.bodies[0]] += wrench
            on_bodies[line.bodies[1]] -= wrench
        for joint, placement, force in self.outside.given:  # points move with their frames
            at = np.append(placement.translation, 1.0)
            point, move = at @ self.rows.placements[joint], at @ self.placements_by_q[joint]
            on_bodies[joint, :3, 0] += force.linear
            on_bodies[joint, 3:, 0] += force.angular + np.cross(point, force.linear)
            on_bodies[joint, 3:, self.by_q] += np.cross(move, force.linear).T

    # ------------------------------------------------------------ efforts at joints

    def _efforts(self) -> Array:
        """Return (nv, ...) efforts at joints, springs, rotors and couplings there."""
        total = self._new(self.nv)
        total[:, 0] = self.effort
        total[:, 1 + 2 * self.nv :] = self.effort_changes
        total -= self.mechanism.model.armature[:, None] * self.a
        own, (force, by_q, by_v) = np.arange(self.nv), self.springs.turning
        total[:, 0] -= force
        total[own, 1 + own] -= by_q
        total[own, 1 + self.nv + own] -= by_v
        rows, changes = self.rows.joint_rows()
        borne = self.multipliers[self.rows.constraints.of_joints]
        total += rows.T @ borne
        total[:, self.by_q] += np.tensordot(borne[:, 0], changes, 1)
        return total

    def _without_effort(
        self, pairs: Pairs, joint: int, force: Array, efforts: Array
    ) -> Array:
        """Return what the pair itself bears: `force` less what the joint's effort does."""
        model, tree = self.mechanism.model, self.rows.bodies
        own = np.arange(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
        turns = pairs.turns[own]
        for part, chosen in ((slice(3, 6), own[turns]), (slice(0, 3), own[~turns])):
            if len(chosen):
                axes = tree.columns[chosen, part].T
                is_turned = tree.moved_by[tree.joint_of[chosen]]
                spins = np.where(is_turned[:, None], tree.columns[:, 3:].T, 0.0)  # (k, 3, nv)
                spun = np.cross(spins, axes.T[:, :, None], axis=1)
                force[part] -= _along(axes, spun, efforts[chosen])
        return force


def _bar(f: Array) -> Array:
    """Return the matrix of d x* f on twists d, for a force f (6,)."""
    out = np.zeros((6, 6))
    out[:3, 3:] = out[3:, :3] = -skewed(f[:3])
    out[3:, 3:] = -skewed(f[3:])
    return out


def _along(axes: Array, spun: Array, values: Array) -> Array:
    """Return (3, ...) the shortest x with axes^T x = values.

    With x = A y and A^T A y = t, dx = dA y + A (A^T A)^-1 (dt - dA^T x - A^T dA y).

    Args:
        axes: (3, k) A.
        spun: (k, 3, nv) derivatives of its columns with respect to q.
        values: (k, ...) t.
    """
    inverse = np.linalg.inv(axes.T @ axes)
    y = inverse @ values
    x = axes @ y
    bent = np.tensordot(y[:, 0], spun, 1)
    x[:, 1 : 1 + spun.shape[2]] += bent - axes @ inverse @ (
        np.einsum("i,kij->kj", x[:, 0], spun) + axes.T @ bent)
    return x


def _moved(wrench: Array, point: Array, by_q: Array) -> Array:
    """Return a wrench (6, ...) about a point (3,) that moves by `by_q` (nv, 3)."""
    moved = wrench.copy()
    moved[3:] -= np.cross(point, wrench[:3], axisb=0, axisc=0)
    moved[3:, 1 : 1 + len(by_q)] -= np.cross(by_q, wrench[:3, 0]).T
    return moved
