"""The closed configurations over a section of a grid: a surface that curves lie on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close, scaled_row
from spatial_pin.assembly.holding import held_by
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import JointLimit, joint_limits
from spatial_pin.motion.joint_limits import KIND as JOINT_LIMIT
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.workspace_map.dexterity import TASKS, Task
from spatial_pin.workspace_map.lines import Asked

LIMIT = "limit"
CURVE_ENDS_BESIDE = 1e-4  # part of a step, or rank: so near to a branch point a curve ends


class Section:
    """The surface of closed configurations over a section of a grid.

    Attributes:
        evaluation: the closure equations.
        limits: joint limits that are kept, by words.

    Args:
        asked: the grid.
        task: what is asked of the frame.
        evaluation: the closure equations of what is followed.
        free: numbers of the two coordinates of the grid that span the section.
        spans: (k, 2) ranges of all of them.
    """

    def __init__(
        self, asked: Asked, task: Task, evaluation: Evaluation, free: tuple[int, int],
        spans: Array,
    ) -> None:
        mechanism = asked.mechanism
        self.asked, self.task, self.evaluation, self.free = asked, task, evaluation, free
        self.limits: dict[str, JointLimit] = {
            f"{JOINT_LIMIT}: {x.words}": x for x in
            (joint_limits(mechanism) if asked.limits else [])}
        own = [mechanism.prescribed_coordinate(name) for name in asked.names]
        moved = asked.moving
        others = ([mechanism.coordinate_table[name] for name in asked.standing] if asked.is_posed
                  else [c for c in moved if c.v not in [x.v for x in own]])
        held = held_by(mechanism, asked.hold, [*own, *others])
        for c in (*own, *others, *held.coordinates):
            if c.q < 0:
                raise SpatialPinError(f"{c.name!r} is a component of a joint that turns in space: "
                                      "no curves are followed in a section along it")
        self.grid = [*own, *others]
        self.scale = mechanism.velocity_scale
        self._sizes = self.scale[[c.v for c in own]]
        self.low, self.high = spans.T / self._sizes
        self._moved = [c.v for c in moved]
        self._frame = mechanism.frame_id(mechanism.placed(asked.frame))
        self._rows = np.array([scaled_row(mechanism, c, evaluation.q) for c in self.grid])
        self._loose = np.ones(len(self.scale), dtype=bool)
        self._loose[list(held.entries)] = False
        self._moves = self._loose.copy()  # while loops close, those that do not change stand
        self._moves[[c.v for i, c in enumerate(self.grid) if i not in free]] = False

    def motions(self, q: Array) -> Array:
        """Return orthonormal motions (m, nv), as many as coordinates give."""
        self.evaluation.update(q)
        svd = decompose(self.evaluation.jacobian[:, self._loose])
        found = np.zeros((len(self.grid), len(self.scale)))
        found[:, self._loose] = svd.vt[len(svd.vt) - len(self.grid) :]
        return found

    def is_branch_point(self, q: Array) -> bool:
        """Whether the loops' equations have lost their rank."""
        self.evaluation.update(q)
        s = decompose(self.evaluation.jacobian[:, self._loose], 0.0).s
        return bool(s[int(self._loose.sum()) - len(self.grid) - 1] < CURVE_ENDS_BESIDE * s[0])

    def matrix(self, why: str, motions: Array) -> Array:
        """Return the square matrix that loses its rank on a curve, where the equations stand."""
        if why == LIMIT:
            return self._rows @ motions.T
        if self.asked.is_posed:
            return motions[:, self._moved].T
        size = self.asked.mechanism.characteristic_length
        rows = self.evaluation.frame_jacobian(self._frame) * self.scale
        rows[:3] /= size
        return self.task.directions @ rows[TASKS[self.task.name]] @ motions.T

    def plane(self, motions: Array) -> Array:
        """Return two orthonormal motions (2, nv), those of the section."""
        fixed = [row for i, row in enumerate(self._rows) if i not in self.free]
        if not fixed:
            return motions
        return decompose(np.array(fixed) @ motions.T, 0.0).vt[len(fixed) :] @ motions

    def moved(self, q: Array, step: Array) -> Array | None:
        """Return the configuration a step (nv,) away, loops closed; None where they stay open."""
        there = pin.integrate(self.evaluation.model, q, self.scale * step)
        there, error = close(self.evaluation, there, self._moves, TOLERANCES.round_off)
        return there if error <= TOLERANCES.closed and not self.evaluation.mirrored() else None

    def values(self, q: Array) -> Array:
        """Return the grid's coordinates (k,) in natural units."""
        return q[[c.q for c in self.grid[: len(self._sizes)]]] / self._sizes

    def margin(self, q: Array) -> float:
        """Return how far it is from the ends of the section's ranges, in natural units."""
        free = list(self.free)
        values = self.values(q)[free]
        return float(min((values - self.low[free]).min(), (self.high[free] - values).min()))

    def seen(self, q: Array, t: Array) -> tuple[Array, Array]:
        """Return coordinates and point (k + 3,) in natural units, and their change along t."""
        size = self.asked.mechanism.characteristic_length
        self.evaluation.update(q)
        rows = self.evaluation.frame_jacobian(self._frame)[:3] * self.scale / size
        k = len(self._sizes)
        return (np.concatenate([self.values(q),
                                self.evaluation.frame(self._frame).translation / size]),
                np.concatenate([self._rows[:k] @ t, rows @ t]))

    def plain(self, y: Array) -> tuple[Array, Array]:
        """Return coordinates (m, k) and points (m, 3) of the world in their own units."""
        k = len(self._sizes)
        mechanism = self.asked.mechanism
        return (y[:, :k] * self._sizes,
                y[:, k:] * mechanism.characteristic_length + mechanism.centre)
