"""The closure equations of a mechanism at one configuration after the other.

The kernel evaluates them and their Jacobian; Pinocchio tells where bodies and frames are, once
something wants to know it. Columns are scaled by `Mechanism.velocity_scale`, so that ranks and
steps mean the same at every size.
"""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import acquired
from spatial_pin.constraints.compiled_equations import Constraints, constraints_of
from spatial_pin.constraints.composed_equations import (
    combined_wrenches,
    composed_of,
    vector_matrix,
)
from spatial_pin.constraints.trees import LargeTree, Tree, tree_of
from spatial_pin.kernel.closer import opposite_axes
from spatial_pin.kernel.kernel import EvaluationStruct, Kernel
from spatial_pin.kernel.library import address, numbers
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class LoopEquations:
    """Closure equations and their Jacobian at the configuration of the last `update`.

    Attributes:
        mechanism: the mechanism; model: its model, relative to the centre.
        constraints: what the equations are made of.
        q: (nq,) the last configuration; not to be changed before its results are used.
        residual: (n_closure,) closure equations [-]; lengths divided by the characteristic length.
        jacobian: (n_closure + n_passive, nv) derivative of the equations for the scaled
            velocities v / `velocity_scale`; the last ones are rates of idle rotations.
        angles: (n_angles,) angles that count turns [rad], from those in `angle_reference`.
        angle_reference: (n_angles,) the angles to which `angles` stays nearest, where the
            configuration does not tell their turns.
        angle_jacobian: (n_angles, nv) derivative of `angles`, like `jacobian`.
        regular: the last configuration that was found to be regular, see `rank_loss`.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self.model = mechanism, mechanism.centred_model
        self._kernel = kernel = Kernel(mechanism)
        self.constraints: Constraints = kernel.constraints
        self.regular: Any = None
        self.q = mechanism.neutral
        self._own_q, n = np.empty(kernel.nq), kernel.n_closure + kernel.n_passive
        self.residual = np.zeros(kernel.n_closure)
        self.angles, self.angle_reference = np.zeros((2, kernel.n_angles))
        self._rows = np.zeros((n + kernel.n_angles, kernel.nv))
        self.jacobian, self.angle_jacobian = self._rows[:n], self._rows[n:]
        self._is_placed = False
        self._at_q, self._at_reference, self._at_rows = map(
            address, (self._own_q, self.angle_reference, self._rows))
        self._task = EvaluationStruct(
            1, self._at_q, reference=self._at_reference, residual=address(self.residual),
            angle=address(self.angles))
        self._evaluated = ctypes.byref(self._task)

    def update(self, q: Array, with_jacobian: bool = True) -> None:
        """Evaluate the equations at the configuration q (nq,), and `jacobian` if it is wanted."""
        self.q, self._is_placed = q, False
        self._own_q[:] = q
        self._task.jacobian = self._at_rows if with_jacobian else None
        self._kernel.library.kernel_evaluate(self._kernel.handle, self._evaluated)

    def bias(self, q: Array, v: Array) -> Array:
        """Return (n_closure + n_passive,) second derivatives at zero joint acceleration.

        At q (nq,) and joint velocities v (nv,).
        """
        self._own_q[:] = q
        v, bias = numbers(v, (self.model.nv,)), np.empty(len(self.jacobian))
        self._kernel.library.kernel_evaluate(self._kernel.handle, ctypes.byref(EvaluationStruct(
            1, self._at_q, address(v), self._at_reference, bias=address(bias))))
        return bias

    @property
    def closure_error(self) -> float:
        """Largest absolute closure equation at the last configuration [-]."""
        return float(np.abs(self.residual).max()) if self.residual.size else 0.0

    def worst_closure(self) -> str:
        """Return the name of the closure with the largest residual; empty when there is none."""
        if not self.residual.size:
            return ""
        return self.constraints.closure_of[int(np.argmax(np.abs(self.residual)))]

    def mirrored(self) -> str:
        """Return the name of a closure whose axes do not point the same way, else nothing."""
        return next(iter(opposite_axes(self.mechanism, self.data)), "")

    # ------------------------------------------------------------ where the bodies are

    @cached_property
    def _unplaced(self) -> Tree | LargeTree:
        return tree_of(self.model)

    @property
    def _tree(self) -> Tree | LargeTree:
        """The tree at the last configuration."""
        if not self._is_placed:
            self._unplaced.update(self.q)
            self._is_placed = True
        return self._unplaced

    @property
    def data(self) -> Any:
        """Pinocchio's data at the last configuration: placements and the joint Jacobian."""
        return self._tree.data

    @property
    def placements(self) -> Array:
        """(njoints, 4, 3) of the joints, columns of the rotation, then the position; a view."""
        return self._tree.placements

    def frame(self, frame: int) -> pin.SE3:
        """Return the placement of a frame of the model, relative to the centre."""
        at = self.model.frames[frame]
        return self.data.oMi[at.parentJoint] * at.placement

    def body_jacobian(self, joint: int) -> Array:
        """Return the world Jacobian (6, nv) of the body of a joint."""
        return self._tree.columns * self.constraints.supports[joint]

    def frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame at its origin, world axes."""
        return self._tree.frame_jacobian(frame)

    def move(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Move the bodies to q (nq,), v and a (nv,); return their twists and accelerations.

        Returns:
            Views (njoints, 6) on the twists and spatial accelerations, joint axes.
        """
        tree = self._tree
        tree.move(q, v, a)
        return tree.twists, tree.accelerations

    # ------------------------------------------------------------ forces of the equations

    def row_wrenches(self) -> Array:
        """Return (n, 6) force on body 2 per unit of each equation, and its moment.

        World axes, the moment about the world origin; an equation's derivative is its wrench times
        the twist of body 2 relative to body 1. Joint coordinates act on joints, see `joint_rows`.
        Those of `Constraints.other_body_products` follow: they act on two bodies of their own.
        """
        on_bodies: Array = row_wrenches(
            self.constraints, self.placements[None], self.q[None], self.angles[None])[0]
        return on_bodies

    def joint_rows(self) -> Array:
        """Return (len(of_joints), nv) joint forces per unit of each equation `of_joints`.

        They are the derivatives of these equations by joint coordinates as such.
        """
        rows: Array = joint_rows(
            self.constraints, self.placements[None], self.q[None], self.angles[None])[0]
        return rows


def twist_derivatives(
    mechanism: Mechanism, joint: int, q: Array, placements: Array, angles: Array
) -> Array:
    """Return derivatives (m, n_closure, 6) of equations for a twist of what a joint carries.

    Args:
        mechanism: the mechanism.
        joint: the joint.
        q: (m, nq) configurations.
        placements: (m, njoints, 4, 3) of the joints there, see `Kernel.placements`.
        angles: (m, n_angles) that counted ones are nearest to [rad].
    """
    c, at = constraints_of(mechanism), mechanism.model.idx_vs[joint]
    values, wrenches = _products_at(c, placements)
    signs = c.signs[:, at, None, None] / mechanism.velocity_scale[at]
    (moved,) = combined_wrenches(c, [values.T[:, None]], [q.T[:, None]],
                                 [signs * np.moveaxis(wrenches, 0, 2)], angles.T[:, None])
    for k, (equation, _, _) in enumerate(c.other_body_products, start=c.n_closure):
        moved[equation] += moved[k]
    return moved[: c.n_closure].transpose(2, 0, 1)


def _products_at(c: Constraints, placements: Array) -> tuple[Array, Array]:
    """Return all products (m, n) at many placements, and their wrenches (m, n, 6)."""
    rows, matrix = placements.reshape(len(placements), -1, 3), vector_matrix(c)
    is_dense = isinstance(matrix, np.ndarray)
    vectors = matrix @ rows if is_dense else np.stack([matrix @ g for g in rows])
    a, b, x = np.moveaxis(vectors.reshape(len(rows), 3, -1, 3), 1, 0)
    wrenches = np.concatenate([b * c.factors, np.cross(x, b)], axis=2)
    return np.vecdot(a, b) - c.constants, wrenches


def row_wrenches(c: Constraints, placements: Array, q: Array, angles: Array) -> Array:
    """Return `LoopEquations.row_wrenches` (m, n, 6) at many configurations.

    Args:
        c: the equations.
        placements: (m, njoints, 4, 3) of the joints.
        q: (m, nq) the configurations.
        angles: (m, n_angles) that counted ones are nearest to [rad].
    """
    values, wrenches = _products_at(c, placements)
    (rows,) = combined_wrenches(c, [values.T[:, None]], [q.T[:, None]],
                                [np.moveaxis(wrenches, 0, 2)], angles.T[:, None])
    return np.moveaxis(rows, 2, 0)


def joint_rows(c: Constraints, placements: Array, q: Array, angles: Array) -> Array:
    """Return `LoopEquations.joint_rows` (m, k, nv) at many configurations, see `row_wrenches`."""
    values, m = _products_at(c, placements)[0].T[:, None], len(q)
    forces = np.zeros((c.n_closure, c.signs.shape[1], m))
    for group in composed_of(c):
        slopes = group.slopes([values], [q.T[:, None]], angles.T[:, None])[len(group.products) :]
        for v, slope in zip(group.coordinates[1], slopes, strict=True):
            forces[group.rows, v] += np.broadcast_to(
                slope.values[0], (len(group.rows), 1, m))[:, 0]
    return np.moveaxis(forces[c.of_joints], 2, 0)


def loops_at(mechanism: Mechanism, q: Array, angles: Array | float = 0.0) -> LoopEquations:
    """Return new `LoopEquations` at the configuration q (nq,), angles counting turns from some."""
    loops = LoopEquations(mechanism)
    loops.angle_reference[:] = angles
    loops.update(q)
    return loops


class loops_of(acquired["LoopEquations"]):  # with loops_of(...) as loops
    """Acquire `LoopEquations` of a mechanism, whose angles count turns from some.

    Args:
        mechanism: the mechanism.
        angles: (n_angles,) [rad].
    """

    def __init__(self, mechanism: Mechanism, angles: Array | float = 0.0) -> None:
        super().__init__(mechanism, LoopEquations)
        self._angles = angles

    def __enter__(self) -> LoopEquations:
        """Return the equations."""
        loops = super().__enter__()
        loops.angle_reference[:] = self._angles
        return loops
