"""Targets by Newton's and Gauss's methods on closed loops, one level of importance in the other.

Loops are closed first; in the motions that keep them closed, what is to be exact is met; in those
that keep that too, what has a weight is met as well as can be; what freedom is left is moved least
[SicilianoSlotine1991]. Joint limits are kept by an active set: a joint that a step takes beyond its
limit stands there, until a step would take it back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.inverse_kinematics.targets import Target
from spatial_pin.mechanism.joint_limits import JointLimit
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

STEPS_AT_MOST = 200  # of a level: Newton's take ten, towards what cannot be reached some dozens
CORRECTIONS = 8  # Newton's, after steps that nearly keep what is kept: four do as a rule
# First damping where a step did not help, relative to the largest singular value.
LEAST_DAMPING = 1e-3
MOST_DAMPING = 1e6  # with which nothing moves any more
NO_LONGER = 1e-9  # rad, characteristic lengths: what a least motion or least sum still changes


class Reached(NamedTuple):
    """Where solving has led.

    Attributes:
        q: (nq,) configuration, its loops closed.
        exact: (k,) residuals of what was to be exact.
        limits: joint limits that hold it back.
        is_on_its_way: whether it went on by long steps until these ran out.
    """

    q: Array
    exact: Array
    limits: tuple[JointLimit, ...]
    is_on_its_way: bool = False

    @property
    def distance(self) -> float:
        """The length of `exact`."""
        return _length(self.exact)


class Solver:
    """Moves a mechanism to targets.

    Attributes:
        exact, weighted: targets to be reached, and those to be met as well as can be.
        limits: joint limits to keep.
        scale: (nv,) velocity of a unit of each unknown.
        moves: (nv,) which velocities may move.

    Args:
        evaluation: its closure equations.
        targets: what is asked for.
        limits: joint limits to keep.
        still: places in the velocity vector that stand still.
        tolerance: length of the residuals at which targets are reached.
    """

    def __init__(
        self, evaluation: Evaluation, targets: Sequence[Target], limits: Sequence[JointLimit],
        still: Sequence[int], tolerance: float,
    ) -> None:
        self.evaluation, self.tolerance = evaluation, tolerance
        self.exact = [t for t in targets if t.weight is None]
        self.weighted = [t for t in targets if t.weight is not None]
        self.limits = limits
        self.scale = evaluation.mechanism.velocity_scale
        self.moves = np.ones(len(self.scale), dtype=bool)
        self.moves[list(still)] = False
        # the last two residuals, with configuration and targets: they are asked for again and again
        self._known: list[tuple[Array, Sequence[Target], tuple[Array, Array]]] = []

    def solve(self, start: Array) -> Reached:
        """Return where the targets are met, from a configuration (nq,) on."""
        q, held = self.closed(start), dict[int, JointLimit]()
        is_on_its_way = False
        if self.exact:
            q, held, is_on_its_way = self._descend(q, held, [], self.exact)
        polished = self._kept(q, self._free(held), self.exact)
        if polished is None:
            return self.reached(q, held)._replace(is_on_its_way=is_on_its_way)
        q = polished
        if self.weighted:
            q, held, _ = self._descend(q, held, self.exact, self.weighted)
        return self.reached(self._least_motion(q, start, held), held)

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

    def rank(self, q: Array) -> int:
        """Return how many of the numbers that are to be exact are free to change on their own."""
        slope = self.residual(q, self.exact)[1] @ self.motions(q, self.moves, []).T
        return decompose(slope, TOLERANCES.half_precision).rank

    def motions(
        self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target], idle: bool = True
    ) -> Array:
        """Return orthonormal rows (k, nv) of motions that keep loops closed and targets met.

        Idle rotations are among them, unless they are not wanted: a target may ask for one.
        """
        _, rows = self.residual(q, kept)
        closures = self._closures() if idle else self.evaluation.jacobian
        basis = decompose(np.vstack([closures, rows])[:, free]).null_space
        found = np.zeros((len(basis), len(free)))
        found[:, free] = basis
        return found

    def _closures(self) -> Array:
        """Return the derivative (k, nv) of the loops' equations, none of idle rotations."""
        found: Array = self.evaluation.jacobian[: self.evaluation.constraints.n_rows]
        return found

    def _kept(self, q: Array, free: NDArray[np.bool_], kept: Sequence[Target]) -> Array | None:
        """Return q with its loops closed and targets met again; None if that takes too far."""
        q, last = self._closed(q, free), np.inf
        for _ in range(CORRECTIONS):
            residual, rows = self.residual(q, kept)
            size = _length(residual)
            if size <= TOLERANCES.last_digit or (size <= self.tolerance and size > 0.5 * last):
                return q if self.is_closed() else None
            if size > min(TOLERANCES.unexplained, last):
                return None
            last = size
            step = np.zeros(len(free))
            step[free] = decompose(np.vstack([self._closures(), rows])[:, free]).minimum_norm(
                np.concatenate([-self.evaluation.residual, -residual]))
            q = self._closed(pin.integrate(self.evaluation.model, q, self.scale * step), free)
        return q if last <= self.tolerance and self.is_closed() else None

    def is_closed(self) -> bool:
        """Whether loops are closed where the equations stand, no axis the other way round."""
        evaluation = self.evaluation
        return evaluation.closure_error <= TOLERANCES.closed and not evaluation.mirrored()

    def _descend(
        self, q: Array, held: dict[int, JointLimit], kept: Sequence[Target],
        wanted: Sequence[Target],
    ) -> tuple[Array, dict[int, JointLimit], bool]:
        """Make the sum of squared residuals of targets least, others being kept.

        Returns:
            The configuration, the limits that hold it, and whether it went on by long steps until
            these ran out.
        """
        damping, size = 0.0, _length(self.residual(q, wanted)[0])
        for _ in range(STEPS_AT_MOST):
            held = self._released(q, held, kept, wanted)
            step, free, now_held = self._step(q, held, kept, wanted, damping)
            moved = _length(step)
            there = self._kept(self._moved(q, step, now_held), free, kept)
            if there is None:
                damping = max(LEAST_DAMPING, 4.0 * damping)
                continue
            found = _length(self.residual(there, wanted)[0])
            if found < size or (found <= self.tolerance and now_held == held):
                done = found <= self.tolerance or (
                    moved < NO_LONGER and now_held.keys() == held.keys())
                q, size, held, damping = there, found, now_held, 0.1 * damping
                if done:
                    return q, held, False
            elif now_held.keys() != held.keys() and found <= size * (1.0 + TOLERANCES.nothing):
                q, size, held = there, found, now_held
            else:
                damping = max(LEAST_DAMPING, 4.0 * damping)
                if damping > MOST_DAMPING or moved < NO_LONGER:
                    return q, held, False
        return q, held, moved > 0.5 * TOLERANCES.damped_step

    def _step(
        self, q: Array, held: dict[int, JointLimit], kept: Sequence[Target],
        wanted: Sequence[Target], damping: float,
    ) -> tuple[Array, NDArray[np.bool_], dict[int, JointLimit]]:
        """Return a step, which velocities it may use, and the limits that it stops at."""
        held = dict(held)
        while True:
            free = self._free(held)
            motions = self.motions(q, free, kept)
            residual, rows = self.residual(q, wanted)
            step = damped(rows @ motions.T, -residual, damping) @ motions
            length = np.linalg.norm(step)
            if length > TOLERANCES.damped_step:
                step *= TOLERANCES.damped_step / length
            passed = self._passed(q, step, held)
            if passed is None:
                return step, free, held
            held[passed.v] = passed

    def _passed(
        self, q: Array, step: Array, held: dict[int, JointLimit]
    ) -> JointLimit | None:
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

    def _released(
        self, q: Array, held: dict[int, JointLimit], kept: Sequence[Target],
        wanted: Sequence[Target],
    ) -> dict[int, JointLimit]:
        """Return limits that a free step, of some of them released, would not leave."""
        held = dict(held)
        for v, limit in list(held.items()):
            without = {k: x for k, x in held.items() if k != v}
            motions = self.motions(q, self._free(without), kept)
            residual, rows = self.residual(q, wanted)
            step = -(residual @ rows @ motions.T) @ motions
            if limit.side * step[v] < -TOLERANCES.nothing * np.linalg.norm(residual):
                held = without
        return held

    def _free(self, held: dict[int, JointLimit]) -> NDArray[np.bool_]:
        free = self.moves.copy()
        free[list(held)] = False
        return free

    def _moved(self, q: Array, step: Array, held: dict[int, JointLimit]) -> Array:
        found: Array = pin.integrate(self.evaluation.model, q, self.scale * step)
        for limit in held.values():
            found[limit.q] = limit.value
        return found

    def _least_motion(self, q: Array, start: Array, held: dict[int, JointLimit]) -> Array:
        """Return the configuration nearest to the start that meets the targets as well."""
        free = self._free(held)
        part, model = 1.0, self.evaluation.model
        for _ in range(STEPS_AT_MOST):
            rows = self.residual(q, self.weighted)[1]
            motions = self.motions(q, free, self.exact)
            left = decompose(rows @ motions.T, TOLERANCES.half_precision).null_space @ motions
            away = pin.difference(model, start, q) / self.scale
            step = -part * (left @ away) @ left
            size = np.linalg.norm(step)
            if size < NO_LONGER:
                return q
            step *= min(1.0, TOLERANCES.damped_step / float(size))
            if self._passed(q, step, held) is not None:
                part *= 0.5
                continue
            there = self._kept(pin.integrate(model, q, self.scale * step), free, self.exact)
            nearer = there is not None and np.linalg.norm(
                pin.difference(model, start, there) / self.scale) < np.linalg.norm(away)
            if nearer and there is not None:
                q = there
            else:
                part *= 0.5
        return q

    def reached(self, q: Array, held: dict[int, JointLimit]) -> Reached:
        """Return how far targets are met at a configuration, with what holds it there."""
        return Reached(q, self.residual(q, self.exact)[0], tuple(held.values()))


def _length(x: Array) -> float:
    return float(np.linalg.norm(x))


def damped(a: Array, b: Array, damping: float) -> Array:
    """Return x (n,) with a x = b as nearly as can be, of least norm; damped as Levenberg does."""
    svd = decompose(a, TOLERANCES.singular)
    if not svd.rank:
        return np.zeros(a.shape[1])
    s = svd.s[: svd.rank]
    parts = s / (s * s + damping * svd.s[0] ** 2)
    found: Array = (parts * (svd.u[:, : svd.rank].T @ b)) @ svd.vt[: svd.rank]
    return found
