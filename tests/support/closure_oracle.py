"""The oracle of the kernel: closure equations by Pinocchio, values, Jacobian, and bias.

Vectors and derivatives of equations are those of `compiled_equations`. With A, B vectors of a
product, linear in the placements G of all joints,

    bias = r'' at zero joint acceleration = A'' . B + 2 A' . B' + A . B''

Columns are scaled by `Mechanism.velocity_scale`, so that ranks and steps mean the same at every
size. Bodies' rates enter through G' = H^T G and G'' = (H^T H^T + H'^T) G with H the 4 x 4 matrix of
the body twist. Pinocchio's `computeJointJacobiansTimeVariation` is not used: in 4.1 it is wrong for
joints whose motion subspace varies (universal, composite).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.compiled_equations import (
    Constraints,
    combined_wrenches,
    composed_rates,
)
from spatial_pin.constraints.composed_equations import composed_rows
from spatial_pin.constraints.opposite_axes import opposite_axes
from spatial_pin.constraints.pinocchio_views import TWIST_MATRIX
from spatial_pin.constraints.product_vectors import Entries, VectorBlock, matrix_of, multiply
from spatial_pin.constraints.trees import tree_of
from spatial_pin.numerics.linalg import Array

# a @ _CYCLES = (a, a_yzx, a_zxy, a_yzx): a cross product from one multiplication and one difference
_CYCLES = np.hstack([np.eye(3)[:, c] for c in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 2, 0])])


def rate_matrix(a: Entries, b: Entries, r: int, n: int) -> Any:
    """Return the matrix that takes (G'', G', G) of n joints to A'', A', A and then B, B', B''."""
    orders = [(a, 2), (a, 1), (a, 0), (b, 0), (b, 1), (b, 2)]
    blocks = [Entries(x.rows, 12 * (x.columns // 4) + 4 * (2 - order) + x.columns % 4, x.values)
              for x, order in orders]
    return matrix_of(blocks, [k * r for k in range(6)], (6 * r, 12 * n))


class Evaluation:
    """Closure value, Jacobian and bias at one configuration at a time.

    A small tree's `pin.Data` is read through views made once.

    Attributes:
        q: (nq,) the last configuration; not to be changed before what is made of it.
        residual: (n_closure,) closure equations [-]; lengths divided by the characteristic length.
        jacobian: (n_closure + n_passive, nv) derivative of the equations for the scaled
            velocities v / `velocity_scale`; the last ones are rates of idle rotations.
        angles: (n_angles,) relative angle of every screw closure [rad], counting turns from the
            one in `angle_reference`.
        angle_reference: (n_angles,) the angles to which `angles` stays nearest, where the
            configuration does not tell their turns.
        angle_jacobian: (n_angles, nv) derivative of `angles`, like `jacobian`.
        wrenches: (rows, 6) force and moment about the world origin of each product.
        placements: (njoints, 4, 3) view on the joint placements, relative to the centre of the
            mechanism as all that is told of places here.
        regular: the last configuration that was found to be regular, see `rank_loss`.
    """

    def __init__(self, constraints: Constraints) -> None:
        self.regular: Any = None
        self.constraints = c = constraints
        self.mechanism = c.mechanism
        self.model = model = c.mechanism.centred_model
        self._tree = tree_of(model)
        self.data = self._tree.data
        nv, r = model.nv, len(c.constants)
        self._n_all = r
        self.angles = np.zeros(c.n_angles)
        self.angle_reference = np.zeros(c.n_angles)
        self.angle_jacobian = np.zeros((c.n_angles, nv))
        self._zero = np.zeros(nv)
        self.q = c.mechanism.neutral
        self.placements = self._tree.placements
        self._g = self.placements.reshape(-1, 3)
        self._twists, self._accelerations = self._tree.twists, self._tree.accelerations
        self._joint_jacobian = self._tree.columns
        blocks = [VectorBlock() for _ in range(2)]
        for block, terms in zip(blocks, c.terms[:2], strict=True):
            for of in terms:
                block.add(*of)
        self._c_rates = rate_matrix(*(x.entries() for x in blocks), r, model.njoints)
        self._make_buffers(nv, r)
        self._plain = not c.composed
        self._offset = bool(np.any(c.constants))
        self.residual = self._values[: c.n_closure] if self._plain else np.zeros(c.n_closure)
        self.jacobian = np.zeros((c.n_closure + c.n_passive, nv))

    def _make_buffers(self, nv: int, r: int) -> None:
        """Allocate once what every evaluation writes, with the views it is read through."""
        self._abx, self._cycled = np.empty((3 * r, 3)), np.empty((3 * r, 12))
        blocks = self._cycled[:r], self._cycled[r : 2 * r], self._cycled[2 * r :]
        self._a, self._b = blocks[0][:, :3], blocks[1][:, :3]
        self._b_cycles, self._x_cycles = blocks[1][:, 6:12], blocks[2][:, 3:9]
        self._values = np.zeros(r)
        self.wrenches = np.zeros((r, 6))
        self._forces, self._moments = self.wrenches[:, :3], self.wrenches[:, 3:]
        idle = slice(self.constraints.passive_at, r)
        self._idle_moments, self._idle_axes = self._moments[idle], self._b[idle]
        self._halves = np.empty((r, 6))
        self._first, self._second = self._halves[:, :3], self._halves[:, 3:]
        self._products = np.zeros((r, nv))

    def update(self, q: Array) -> None:
        """Evaluate `residual` and `jacobian` at the configuration q (nq,)."""
        self.update_wrenches(q)
        if self._n_all:
            products = np.dot(self.wrenches, self._joint_jacobian, self._products)
            if self._plain:
                np.multiply(products, self.constraints.signs, out=self.jacobian)
                return
        self._finish(q)

    def update_wrenches(self, q: Array) -> None:
        """Evaluate placements, joint Jacobian, values and wrenches of equations at q (nq,) only."""
        c, self.q = self.constraints, q
        self._tree.place(q)
        if self._n_all:
            multiply(c.c_abx, self._g, self._abx)
            np.dot(self._abx, _CYCLES, self._cycled)
            values = np.vecdot(self._a, self._b, out=self._values)
            if self._offset:
                values -= c.constants
            np.multiply(self._b, c.factors, out=self._forces)
            np.multiply(self._x_cycles, self._b_cycles, out=self._halves)
            np.subtract(self._first, self._second, out=self._moments)
            if c.n_passive:
                self._idle_moments[:] = self._idle_axes

    def row_wrenches(self) -> Array:
        """Return (n_wrenches, 6) force on body 2 per unit of each equation, and its moment.

        World axes, the moment about the world origin, at the last `update`; an equation's
        derivative is its wrench times the twist of body 2 relative to body 1. Joint coordinates
        act on joints, see `joint_rows`. Behind them come those of `Constraints.elsewhere`: they
        act on two bodies of their own.
        """
        (found,) = combined_wrenches(self.constraints, [self._values[:, None]],
                                     [self.q[:, None]], [self.wrenches])
        return found

    def joint_rows(self) -> Array:
        """Return (len(of_joints), nv) joint forces per unit of each equation `of_joints`.

        They are the derivatives of these equations by joint coordinates as such.
        """
        c = self.constraints
        found = np.zeros((c.n_closure, self.model.nv))
        for group in c.composed:
            if len(group.coordinates[0]):
                value, _ = group.values(group.seeded([self._values[:, None]], [self.q[:, None]]))
                none = np.zeros((len(self._values), self.model.nv))
                found[group.rows] = composed_rows(
                    group, value.changes[0], none, np.ones(self.model.nv))
        return found[c.of_joints]

    def frame(self, frame: int) -> pin.SE3:
        """Return where a frame of the model is, relative to the centre, at the last `update`."""
        at = self.model.frames[frame]
        return self.data.oMi[at.parentJoint] * at.placement

    def body_jacobian(self, joint: int) -> Array:
        """Return the world Jacobian (6, nv) of the body of a joint, at the last `update`."""
        return self._joint_jacobian * self.constraints.support(joint)

    def frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame at its origin, world axes, likewise."""
        return self._tree.frame_jacobian(frame)

    def twist_derivatives(self, joint: int) -> Array:
        """Return derivatives (n_closure, 6) of equations for a twist of what a joint carries."""
        c, at = self.constraints, self.model.idx_vs[joint]
        signs = c.signs[:, at, None] / self.mechanism.velocity_scale[at]
        (moved,) = combined_wrenches(c, [self._values[:, None]], [self.q[:, None]],
                                     [signs * self.wrenches])
        for k, x in enumerate(c.elsewhere, start=c.n_closure):
            moved[x.equation] += moved[k]
        return moved[: c.n_closure]

    def _finish(self, q: Array) -> None:
        """Put equations in their places, composed ones from what they are made of."""
        c, p = self.constraints, self.constraints.n_products
        products = self._products
        products *= c.signs
        self.jacobian[:p] = products[:p]
        self.residual[:p] = self._values[:p]
        for group in c.composed:
            inputs = group.seeded([self._values[:, None]], [q[:, None]])
            value, angles = group.values(inputs, c.reference(q, self.angle_reference))
            size = self.mechanism.velocity_scale
            self.residual[group.rows] = value.values[0][:, 0]
            self.jacobian[group.rows] = composed_rows(group, value.changes[0], products, size)
            for numbers, angle in zip(group.angles, angles, strict=True):
                self.angles[numbers] = angle.values[0][:, 0]
                self.angle_jacobian[numbers] = composed_rows(
                    group, angle.changes[0], products, size)
        self.jacobian[c.n_closure :] = products[c.passive_at :]

    def bias(self, q: Array, v: Array) -> Array:
        """Return (n_closure + n_passive,) second derivatives at zero joint acceleration.

        Call after `update` at the same q.
        """
        c = self.constraints
        self._tree.move(q, v, self._zero)
        if not self._n_all:
            return np.zeros(c.n_closure)
        g0, shape = self.placements, (-1, 4, 4)
        h1, h2 = (np.dot(x, TWIST_MATRIX).reshape(shape) for x in (
            self._twists, self._accelerations))
        g1 = h1 @ g0
        g2 = h1 @ g1 + h2 @ g0
        vectors = self._c_rates @ np.concatenate([g2, g1, g0], axis=1).reshape(-1, 3)
        a2, a1, a0, b0, b1, b2 = vectors.reshape(6, -1, 3)
        first = np.vecdot(a1, b0) + np.vecdot(a0, b1)
        bias = np.vecdot(a2, b0) + 2.0 * np.vecdot(a1, b1) + np.vecdot(a0, b2)
        if c.n_passive:
            bias[c.passive_at :] = np.dot(c.idle_bias, self._accelerations.reshape(-1))
        if not c.composed:
            return bias
        rows = composed_rates(c, [self._values, first, bias], [q, v])
        return np.concatenate([rows, bias[c.passive_at :]])

    def move(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Move the bodies as q (nq,), v and a (nv,) say.

        Returns:
            Views (njoints, 6) on the twists and spatial accelerations, joint axes.
        """
        self._tree.move(q, v, a)
        return self._twists, self._accelerations

    @property
    def closure_error(self) -> float:
        """Largest absolute closure equation at the last configuration [-]."""
        return float(np.abs(self.residual).max()) if self.residual.size else 0.0

    def worst_closure(self) -> str:
        """Return the name of the closure with the largest residual; empty when there is none."""
        if not self.residual.size:
            return ""
        return self.constraints.labels[int(np.argmax(np.abs(self.residual)))].closure

    def mirrored(self) -> str:
        """Return the name of a closure whose axes do not point the same way, else nothing."""
        return next(iter(opposite_axes(self.mechanism, self.data)), "")
