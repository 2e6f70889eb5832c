"""Closed loops, and targets that are kept, while a mechanism moves within its joint limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.inverse_kinematics.targets import Target
from spatial_pin.mechanism.joint_limits import SLACK, JointLimit
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

CORRECTIONS = 8  # Newton's, after steps that nearly keep what is kept: four do as a rule
Held = dict[int, JointLimit]  # by place in the velocity: limits that joints stand at


class Constrained:
    """A mechanism whose loops stay closed, with joint limits.

    Attributes:
        evaluation: its closure equations.
        limits: joint limits to keep.
        scale: (nv,) velocity of a unit of each unknown.
        moves: (nv,) which velocities may move.
        tolerance: length of the residuals at which targets are reached.

    Args:
        evaluation: its closure equations.
        limits: joint limits to keep.
        still: places in the velocity vector that stand still.
        tolerance: length of the residuals at which targets are reached.
    """

    def __init__(
        self, evaluation: Evaluation, limits: Sequence[JointLimit], still: Sequence[int],
        tolerance: float,
    ) -> None:
        self.evaluation, self.tolerance = evaluation, tolerance
        self.limits = limits
        self._limited = np.array([limit.q for limit in limits], dtype=np.intp)
        self._ends = np.array([(x.side, x.side * x.value + SLACK * x.size) for x in limits])
        self.scale = evaluation.mechanism.velocity_scale
        self.moves = np.ones(len(self.scale), dtype=bool)
        self.moves[list(still)] = False
        # the last two residuals, with configuration and targets: they are asked for again and again
        self._known: list[tuple[Array, Sequence[Target], tuple[Array, Array]]] = []

    def residual(self, q: Array, targets: Sequence[Target]) -> tuple[Array, Array]:
        """Return weighted residuals (k,) and derivatives (k, nv) for scaled velocities."""
        if self.evaluation.q is not q:
            self.evaluation.update(q)
        if not targets:
            return np.empty(0), np.empty((0, len(self.scale)))
        for at, known, found in self._known:
            if at is q and known is targets:
                return found
        found = self._residual(targets)
        self._known = [*self._known[-1:], (q, targets, found)]
        return found

    def _residual(self, targets: Sequence[Target]) -> tuple[Array, Array]:
        parts = [t.residual(self.evaluation) for t in targets]
        weights = [1.0 if t.weight is None else t.weight for t in targets]
        return (np.concatenate([w * r for w, (r, _) in zip(weights, parts, strict=True)]),
                np.vstack([w * j * self.scale for w, (_, j) in zip(weights, parts, strict=True)]))

    def closed(self, q: Array) -> Array:
        """Return a configuration with its loops closed."""
        return self._closed(q, self.moves)

    def _closed(self, q: Array, free: NDArray[np.bool_]) -> Array:
        found, _ = close(self.evaluation, q, free, TOLERANCES.round_off)
        return found

    def motions(
        self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target], idle: bool = True
    ) -> Array:
        """Return orthonormal rows (k, nv) of motions that keep loops closed and targets met.

        Idle rotations are among them, unless they are not wanted: a target may ask for one.
        """
        _, rows = self.residual(q, kept)
        closures = self.closures() if idle else self.evaluation.jacobian
        basis = decompose(np.vstack([closures, rows])[:, free]).null_space
        found = np.zeros((len(basis), len(free)))
        found[:, free] = basis
        return found

    def closures(self) -> Array:
        """Return the derivative (k, nv) of the loops' equations, none of idle rotations."""
        found: Array = self.evaluation.jacobian[: self.evaluation.constraints.n_closure]
        return found

    def kept(self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target]) -> Array | None:
        """Return q with its loops closed and targets met again; None if that takes too far."""
        q, last = self._closed(q, free), np.inf
        for _ in range(CORRECTIONS):
            residual, rows = self.residual(q, kept)
            size = float(np.linalg.norm(residual))
            if size <= TOLERANCES.last_digit or (size <= self.tolerance and size > 0.5 * last):
                return q if self.is_closed() else None
            if size > min(TOLERANCES.unexplained, last):
                return None
            last = size
            step = np.zeros(len(free))
            step[free] = decompose(np.vstack([self.closures(), rows])[:, free]).minimum_norm(
                np.concatenate([-self.evaluation.residual, -residual]))
            q = self._closed(pin.integrate(self.evaluation.model, q, self.scale * step), free)
        return q if last <= self.tolerance and self.is_closed() else None

    def is_closed(self) -> bool:
        """Whether loops are closed where the equations stand, no axis the other way round."""
        evaluation = self.evaluation
        return evaluation.closure_error <= TOLERANCES.closed and not evaluation.mirrored()

    def free(self, held: Held) -> NDArray[np.bool_]:
        """Return which velocities may move (nv,) where joints stand at limits."""
        free = self.moves.copy()
        free[list(held)] = False
        return free

    def moved(self, q: Array, step: Array, held: Held) -> Array:
        """Return the configuration a scaled step (nv,) away, held joints at their limits."""
        found: Array = pin.integrate(self.evaluation.model, q, self.scale * step)
        for limit in held.values():
            found[limit.q] = limit.value
        return found

    def passed(self, q: Array, step: Array, held: Held) -> JointLimit | None:
        """Return the limit that a step passes first, or None."""
        first, part, ways = None, 1.0, (step * self.scale * self.moves).tolist()
        for limit in self.limits:
            way = limit.side * ways[limit.v]
            if way <= 0.0 or limit.v in held:
                continue
            room = max(float(limit.room(q)), 0.0)
            if way > room and room / way < part:
                first, part = limit, room / way
        return first

    def beyond(self, q: Array, held: Held, before: Array | None = None) -> Held:
        """Return limits that q is beyond, and farther than another configuration was."""
        if not self.limits or np.all(q[self._limited] * self._ends[:, 0] <= self._ends[:, 1]):
            return {}
        found = {}
        for limit in self.limits:
            room = float(limit.room(q))
            allowed = 0.0 if before is None else min(float(limit.room(before)), 0.0)
            if limit.v not in held and self.moves[limit.v] and room < allowed - SLACK * limit.size:
                found[limit.v] = limit
        return found

    def within(self, q: Array) -> tuple[Array, Held]:
        """Return a configuration with its loops closed within the limits, if they close there.

        Joints that were beyond limits stand at them.
        """
        closed, held = self.closed(q), Held()
        while beyond := self.beyond(closed, held):
            held |= beyond
            tried = self.kept(
                self.moved(closed, np.zeros(len(self.scale)), held), self.free(held), [])
            if tried is None:
                return closed, {}
            closed = tried
        return closed, held
