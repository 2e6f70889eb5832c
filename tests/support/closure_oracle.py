"""The oracle of the kernel: closure equations by Pinocchio, values, Jacobian, and bias.

With A, B vectors of a product, linear in the placements G of all joints,

    bias = r'' at zero joint acceleration = A'' . B + 2 A' . B' + A . B''

Bodies' rates enter through G' = H^T G and G'' = (H^T H^T + H'^T) G with H the 4 x 4 matrix of the
body twist. Pinocchio's `computeJointJacobiansTimeVariation` is not used: in 4.1 it is wrong for
joints whose motion subspace varies (universal, composite).
"""

from __future__ import annotations

import numpy as np

from spatial_pin.constraints.compiled_equations import Constraints
from spatial_pin.constraints.composed_equations import (
    Composed,
    combined_wrenches,
    composed_of,
    composed_rates,
    vector_matrix,
)
from spatial_pin.constraints.pinocchio_views import TWIST_MATRIX
from spatial_pin.constraints.trees import tree_of
from spatial_pin.numerics.linalg import Array


class Evaluation:
    """What `LoopEquations` has of the same names, at the configuration of the last `update`."""

    def __init__(self, constraints: Constraints) -> None:
        self.constraints = c = constraints
        self.mechanism, self.model = c.mechanism, c.mechanism.centred_model
        self.tree = tree_of(self.model)
        self.data, nv = self.tree.data, self.model.nv
        self.residual = np.zeros(c.n_closure)
        self.jacobian = np.zeros((c.n_closure + c.n_passive, nv))
        self.angles, self.angle_reference = np.zeros((2, c.n_angles))
        self.angle_jacobian = np.zeros((c.n_angles, nv))

    def vectors(self, placements: Array) -> Array:
        """Return A, B and X (3, n, 3) of all products, or a rate of theirs."""
        matrix = vector_matrix(self.constraints)
        found: Array = (matrix @ placements.reshape(-1, 3)).reshape(3, -1, 3)
        return found

    def update(self, q: Array) -> None:
        """Evaluate `residual` and `jacobian` at the configuration q (nq,)."""
        c, self.q = self.constraints, q
        plain, own = c.plain, c.product[c.plain]
        self.tree.update(q)
        a, b, x = self.vectors(self.tree.placements)
        self.values = np.vecdot(a, b) - c.constants
        self.wrenches = np.hstack([b * c.factors, np.cross(x, b)])
        self.wrenches[c.passive_at :, 3:] = b[c.passive_at :]  # a rate about a line
        products, size = self.wrenches @ self.tree.columns * c.signs, c.mechanism.velocity_scale
        self.residual[plain], self.jacobian[plain] = self.values[own], products[own]
        self.jacobian[c.n_closure :] = products[c.passive_at :]
        near = np.array([x.row @ q + x.offset if x.is_of_joints else angle for x, angle
                         in zip(c.angles, self.angle_reference, strict=True)])
        for group in composed_of(c):
            inputs = group.seeded([self.values[:, None]], [q[:, None]])
            value, angles = group.values(inputs, near)
            self.residual[group.rows] = value.values[0][:, 0]
            self.jacobian[group.rows] = composed_rows(group, value.changes[0], products, size)
            for numbers, angle in zip(group.angles, angles, strict=True):
                self.angles[numbers] = angle.values[0][:, 0]
                self.angle_jacobian[numbers] = composed_rows(
                    group, angle.changes[0], products, size)

    @property
    def closure_error(self) -> float:
        """Largest absolute closure equation."""
        return float(np.abs(self.residual).max(initial=0.0))

    def row_wrenches(self) -> Array:
        """Return (n_wrenches, 6) of the equations, see `LoopEquations`."""
        (found,) = combined_wrenches(self.constraints, [self.values[:, None]], [self.q[:, None]],
                                     [self.wrenches], self.angles)
        return found

    def bias(self, q: Array, v: Array) -> Array:
        """Return (n_closure + n_passive,) second derivatives at zero joint acceleration.

        Call after `update` at the same q.
        """
        c, tree, shape = self.constraints, self.tree, (-1, 4, 4)
        tree.move(q, v, np.zeros(self.model.nv))
        g = tree.placements
        h1, h2 = ((x @ TWIST_MATRIX).reshape(shape) for x in (tree.twists, tree.accelerations))
        (a, b, _), (a1, b1, _), (a2, b2, _) = map(
            self.vectors, (g, h1 @ g, h1 @ h1 @ g + h2 @ g))
        first = np.vecdot(a1, b) + np.vecdot(a, b1)
        bias = np.vecdot(a2, b) + 2.0 * np.vecdot(a1, b1) + np.vecdot(a, b2)
        rows = composed_rates(c, [self.values, first, bias], [q, v], self.angles)
        idle = [axis @ tree.accelerations[joint, 3:] for joint, axis in c.idle_axes]
        return np.concatenate([rows, idle])


def composed_rows(group: Composed, slopes: Array, products: Array, scale: Array) -> Array:
    """Return (m, nv, ...) derivatives of composed equations, in scaled velocities.

    Args:
        group: the equations.
        slopes: (m, n, ...) derivatives with respect to their products and coordinates.
        products: (N, nv, ...) derivatives of all products.
        scale: (nv,) of the velocities.
    """
    m, p = len(group.rows), len(group.products)
    slopes = np.broadcast_to(slopes, (m, *slopes.shape[1:]))
    out = np.zeros((m, *products.shape[1:]))
    for k, at in enumerate(group.products):
        out += slopes[:, k, None] * products[at]
    for k, v in enumerate(group.coordinates[1], start=p):
        own = slopes[:, k]
        out[np.arange(m), v] += own * scale[v].reshape(-1, *[1] * (own.ndim - 1))
    return out
