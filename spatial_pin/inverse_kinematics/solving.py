"""Targets by least squares on closed loops, in levels of priority.

First the loops are closed. Motions that keep them closed meet the exact targets. Motions that keep
those met reduce the weighted residuals. The remaining freedom minimises the displacement
[SicilianoSlotine1991].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import LimitedJoints, closed
from spatial_pin.inverse_kinematics.targets import CoordinateValue, Residual, Target
from spatial_pin.kernel.closer import ClosureResult
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.joint_limits import JointLimit
from spatial_pin.numerics.least_squares import (
    Bounds,
    Iterate,
    Lagrangian,
    LeastSquares,
    beyond,
    minimised,
)
from spatial_pin.numerics.linalg import Array, Triangular, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

CORRECTIONS = 8  # Newton steps after a step to first order: usually four


class Constrained(LimitedJoints):
    """A mechanism with closed loops and joint limits, and targets as residuals.

    Attributes:
        tolerance: norm of the residuals of met targets.
    """

    def __init__(
        self, evaluation: LoopEquations, limits: Sequence[JointLimit], still: Sequence[int],
        tolerance: float,
    ) -> None:
        moves = np.ones(evaluation.model.nv, dtype=bool)
        moves[list(still)] = False
        super().__init__(evaluation, moves, limits)
        self.tolerance = tolerance
        # the last residuals, with configuration and targets: they are needed again and again
        self._known: list[tuple[Array, Sequence[Target], tuple[Array, Array]]] = []
        self._last: ClosureResult | None = None  # where closing led

    def residual(self, q: Array, targets: Sequence[Target]) -> tuple[Array, Array]:
        """Return weighted residuals (k,) and derivatives (k, nv) for scaled velocities."""
        self.update(q)
        if not targets:
            return np.empty(0), np.empty((0, len(self.scale)))
        for at, known, weighted in self._known:
            if at is q and known is targets:
                return weighted
        parts = []
        for target in targets:
            residual, rows = target.residual(self.evaluation)
            weight = 1.0 if target.weight is None else target.weight
            parts.append((weight * residual, rows * (weight * self.scale)))
        weighted = parts[0] if len(parts) == 1 else (
            np.concatenate([r for r, _ in parts]), np.concatenate([j for _, j in parts]))
        self._known = [*self._known[-1:], (q, targets, weighted)]
        return weighted

    def pulled(self, targets: Sequence[Target], forces: Array) -> Array:
        """Return the sum (nv,) of forces (k,) times derivatives of residuals."""
        total = np.zeros(len(self.scale))
        for target in targets:
            pulled, forces = target.pulled(self.evaluation, forces)
            total += pulled if target.weight is None else target.weight * pulled
        return total * self.scale

    def closed(self, q: Array, free: NDArray[np.bool_]) -> Array:
        """Return a configuration with closed loops; only `free` (nv,) velocities move."""
        evaluation, last = self.evaluation, self._last
        if last is None or last.q is not q or last.error > TOLERANCES.round_off:
            last = self._last = closed(evaluation.mechanism, q, free, evaluation.angle_reference,
                                       TOLERANCES.round_off)
        self.update(last.q)
        return last.q

    def is_closed(self, q: Array) -> bool:
        """Whether loops are closed at q (nq,), without mirrored axes; updates the equations."""
        self.update(q)
        evaluation, last = self.evaluation, self._last
        if last is not None and last.q is q and not last.may_be_mirrored:
            return last.error <= TOLERANCES.closed
        return evaluation.closure_error <= TOLERANCES.closed and not evaluation.mirrored()

    def motions(self, q: Array) -> Array:
        """Return orthonormal rows (k, nv) of motions that keep loops closed, no idle rotations."""
        self.update(q)
        basis = Triangular(self.evaluation.jacobian[:, self.moves]).null_space
        motions = np.zeros((len(basis), len(self.moves)))
        motions[:, self.moves] = basis
        return motions

    def within(self, q: Array) -> tuple[Array, Bounds]:
        """Return a configuration with closed loops within the limits, if there is one.

        Joints beyond limits are moved to them.
        """
        closed, active, loops = self.closed(q, self.moves), Bounds(), Level(self, [], [])
        while more := beyond(self.room(closed), 0.0, active):
            active |= more
            tried = loops.corrected(self.at_bounds(closed, active), loops.free(active), 0.0)
            if tried is None:
                return closed, {}
            closed = tried
        return closed, active


class Level(LeastSquares):
    """One level of priority: wanted residuals become small, fixed ones stay met, loops closed."""

    def __init__(
        self, base: Constrained, fixed: Sequence[Target], wanted: Sequence[Target]
    ) -> None:
        self.base, self.fixed, self.wanted = base, fixed, wanted
        self.moves, self.tolerance = base.moves, base.tolerance

    def displaced(self, x: Array, step: Array) -> Array:
        """See `LeastSquares`."""
        return self.base.displaced(x, step)

    def room(self, x: Array) -> Array:
        """See `LeastSquares`."""
        return self.base.room(x)

    def at_bounds(self, x: Array, active: Bounds) -> Array:
        """See `LeastSquares`."""
        return self.base.at_bounds(x, active)

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`."""
        return self.base.residual(x, self.wanted)[0]

    def jacobian(self, x: Array) -> Array:
        """See `LeastSquares`."""
        return self.base.residual(x, self.wanted)[1]

    def constraints(self, x: Array) -> Array:
        """See `LeastSquares`: without equations of idle rotations, which a target may need."""
        rows = self.base.residual(x, self.fixed)[1]
        evaluation = self.base.evaluation
        closures = evaluation.jacobian[: evaluation.constraints.n_closure]
        return np.concatenate([closures, rows]) if self.fixed else closures

    def pulled(self, x: Array, multipliers: Array, forces: Array) -> Array:
        """See `LeastSquares`."""
        base = self.base
        base.update(x)
        n = base.evaluation.constraints.n_closure
        loops: Array = multipliers[:n] @ base.evaluation.jacobian[:n]
        return loops + base.pulled(self.wanted, forces) + base.pulled(self.fixed, multipliers[n:])

    def corrected(self, x: Array, free: NDArray[np.bool_], off: float) -> Array | None:
        """See `LeastSquares`."""
        base, last = self.base, np.inf
        q = base.closed(x, free)
        for _ in range(CORRECTIONS):
            residual, _ = base.residual(q, self.fixed)
            size = math.sqrt(residual.dot(residual))
            if size <= max(TOLERANCES.last_digit, off) or (
                    size <= self.tolerance and size > 0.5 * last):
                return q if base.is_closed(q) else None
            if size > min(TOLERANCES.unexplained, last):
                return None
            last = size
            step = np.zeros(len(free))
            step[free] = Triangular(self.constraints(q)[:, free]).minimum_norm(
                np.concatenate([-base.evaluation.residual, -residual]))
            q = base.closed(base.displaced(q, step), free)
        return q if last <= self.tolerance and base.is_closed(q) else None


class ReachResult(NamedTuple):
    """A solution of the targets."""

    q: Array  # (nq,) configuration with closed loops
    exact: Array  # (k,) residuals of the exact targets
    active: Bounds  # active joint limits
    missed: float = 0.0  # norm of the weighted residuals
    beyond: tuple[JointLimit, ...] = ()  # joint limits that it passes, since it started there
    ran_out: bool = False  # whether the steps ran out while they were still long

    @property
    def distance(self) -> float:
        """The norm of `exact`."""
        return float(np.linalg.norm(self.exact))

    def is_nearer(self, other: ReachResult, tolerance: float) -> bool:
        """Whether this is within limits and the other is not, or clearly nearer.

        If both meet the exact targets, the weighted residuals decide.
        """
        if bool(self.beyond) != bool(other.beyond):
            return not self.beyond
        own, others = self.distance, other.distance
        if max(own, others) <= tolerance:
            own, others = self.missed, max(other.missed, tolerance)
        return own < others * (1.0 - TOLERANCES.nothing)

    def is_met(self, tolerance: float) -> bool:
        """Whether the exact targets are met, within limits."""
        return not self.beyond and self.distance <= tolerance

    def is_best(self, tolerance: float) -> bool:
        """Whether all targets are met, weighted ones too."""
        return self.is_met(tolerance) and self.missed <= tolerance


@dataclass(frozen=True, eq=False, kw_only=True)
class AsNow(Target):
    """Residuals of another target, less constant values."""

    target: Target
    value: Array

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`."""
        residual, slope = self.target.residual(evaluation)
        return residual - self.value, slope


@dataclass(frozen=True, eq=False, kw_only=True)
class Unmoved(Target):
    """All joints at their start values (nq,)."""

    start: Array

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: in radians and characteristic lengths."""
        model, scale = evaluation.model, evaluation.mechanism.velocity_scale
        slope = pin.dDifference(model, self.start, evaluation.q, pin.ARG1)
        return pin.difference(model, self.start, evaluation.q) / scale, slope / scale[:, None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Stationary(Target):
    """A zero gradient of the cost along directions (k, nv) with curvatures `sizes`.

    Residuals that cannot be met may change at constant cost: an axis normal to a direction stays
    normal to it under any turn, and the angle between them, as a vector, turns with it. So the
    gradient is fixed, not the residuals.
    """

    sum: Lagrangian
    sizes: Array
    ways: Array

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: the Newton step to the minimum along each direction.

        The derivative is that along possible motions: other targets and the loops fix the rest.
        """
        half, ways = self._along(evaluation, self.ways / self.sizes[:, None])
        return ways @ half.slope, self._changes(evaluation, half, ways)

    def pulled(self, evaluation: LoopEquations, forces: Array) -> tuple[Array, Array]:
        """See `Target`: one direction is enough, as second derivatives are symmetric."""
        n = len(self.sizes)
        half, direction = self._along(evaluation, (forces[None, :n] / self.sizes) @ self.ways)
        return self._changes(evaluation, half, direction)[0], forces[n:]

    def _along(self, evaluation: LoopEquations, ways: Array) -> tuple[Lagrangian, Array]:
        half = self.sum.at(evaluation.q)
        return half, ways @ half.tangents.T @ half.tangents

    @staticmethod
    def _changes(evaluation: LoopEquations, half: Lagrangian, ways: Array) -> Array:
        q = evaluation.q
        changes: Array = half.changes(ways) / evaluation.mechanism.velocity_scale
        evaluation.update(q)
        return changes


class Solver(Constrained):
    """Inverse kinematics of a mechanism.

    Attributes:
        exact, weighted: targets without and with a weight, weights relative to the largest.
    """

    def __init__(
        self, evaluation: LoopEquations, targets: Sequence[Target], limits: Sequence[JointLimit],
        still: Sequence[int], tolerance: float,
    ) -> None:
        super().__init__(evaluation, limits, still, tolerance)
        self.exact = [t for t in targets if t.weight is None]
        weights = {k: t.weight for k, t in enumerate(targets) if t.weight is not None}
        most = max(weights.values(), default=1.0)
        self.weighted = [replace(targets[k], weight=weight / most)
                         for k, weight in weights.items()]

    def solve(self, q: Array, start: Array) -> ReachResult:
        """Return the solution from q (nq,), with least displacement from `start`."""
        (q, active), ran_out = self.within(q), False
        if self.exact:
            at, active, _, ran_out = minimised(Level(self, [], self.exact), q, active)
            q = at.x
        level = Level(self, self.exact, self.weighted)
        polished = level.corrected(q, level.free(active), 0.0)
        if polished is None:
            return self.reached(q, active)._replace(ran_out=ran_out)
        at, ran_out = Iterate(level, polished), False
        if self.weighted:
            at, active, _, ran_out = minimised(level, polished, active)
        q = at.x if ran_out else self._least_motion(level, at, start, active)
        return self.reached(q, active)._replace(ran_out=ran_out)

    def settled(self, result: ReachResult, start: Array) -> ReachResult:
        """Return the configuration with least displacement among those as near to the targets."""
        if result.beyond or result.ran_out or not self.is_closed(result.q):
            return result
        level = Level(self, [], self.exact)
        q = self._least_motion(level, Iterate(level, result.q), start, result.active)
        there = self.reached(q, result.active)
        is_nearer = result.is_nearer(there, self.tolerance)
        return result if is_nearer or not self.is_closed(q) else there

    def slopes(self, q: Array) -> Array:
        """Return the singular values of the exact targets' derivatives along possible motions."""
        level = Level(self, [], self.exact)
        return decompose(level.jacobian(q) @ Iterate(level, q).tangents(self.moves).T).s

    def _least_motion(self, level: Level, at: Iterate, start: Array, active: Bounds) -> Array:
        """Return the configuration nearest to the start, as good as the end of a level.

        If residuals cannot be met, their sum of squares is fixed, unless that leaves the same
        motions as fixed residuals.
        """
        fixed, wanted = level.fixed, level.wanted
        if at.size > self.tolerance:
            if not active and at.lagrangian(self.moves).is_single():
                return at.x
            pushed = {v: side for v, side in active.items()
                      if at.push(active, v) > TOLERANCES.nothing * at.size}
            free = level.free(pushed)
            least = Lagrangian(at, free)
            sizes, ways = least.curved()
            as_now = Level(self, [*fixed, *self._as_now(at.x, wanted)], [])
            unchanged = Iterate(as_now, at.x).tangents(free)
            if len(unchanged) != len(least.tangents) - len(sizes) or not (
                    np.abs(ways @ unchanged.T).max(initial=0.0) < TOLERANCES.half_precision):
                stops = [CoordinateValue(name=limit.name, value=limit.value)
                         for limit in self.limits_of(pushed)]
                curved = [Stationary(name="", sum=least, sizes=sizes, ways=ways)]
                nearest = self._nearest(at.x, start, active,
                                      [*fixed, *stops, *(curved if len(sizes) else [])])
                if Iterate(level, nearest).size <= at.size * (1.0 + TOLERANCES.nothing):
                    return nearest  # else it is level to second order only
        as_it_is = self._as_now(at.x, wanted)
        return self._nearest(at.x, start, active, [*fixed, *as_it_is] if wanted else fixed)

    def _nearest(self, q: Array, start: Array, active: Bounds, fixed: Sequence[Target]) -> Array:
        """Return the configuration nearest to the start with fixed targets, from q."""
        level = Level(self, fixed, [Unmoved(start=start)])
        if not active and not len(Iterate(level, q).tangents(self.moves)):
            return q
        return minimised(level, q, active).at.x

    def _as_now(self, q: Array, wanted: Sequence[Target]) -> list[Target]:
        """Return targets with the residuals at q as constants."""
        self.update(q)
        return [AsNow(name=t.name, target=t, value=t.residual(self.evaluation)[0])
                for t in wanted]

    def reached(self, q: Array, active: Bounds) -> ReachResult:
        """Return the residuals at a configuration, with its active limits."""
        missed = Iterate(Level(self, [], self.weighted), q).size
        return ReachResult(q, self.residual(q, self.exact)[0], active, missed,
                           self.limits_of(beyond(self.room(q), 0.0, {})))
