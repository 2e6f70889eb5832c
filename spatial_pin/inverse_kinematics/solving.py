"""Targets by least squares on closed loops, one level of importance in the other.

Loops are closed first; in the motions that keep them closed, what is to be exact is met; in those
that keep that too, what has a weight is met as well as can be; what freedom is left is moved least
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
from spatial_pin.kernel.closer import Closed
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

CORRECTIONS = 8  # Newton's, after steps that nearly keep what is kept: four do as a rule


class Constrained(LimitedJoints):
    """A mechanism whose loops stay closed, with joint limits.

    Attributes:
        tolerance: length of the residuals at which targets are reached.
    """

    def __init__(
        self, evaluation: LoopEquations, limits: Sequence[JointLimit], still: Sequence[int],
        tolerance: float,
    ) -> None:
        moves = np.ones(evaluation.model.nv, dtype=bool)
        moves[list(still)] = False
        super().__init__(evaluation, moves, limits)
        self.tolerance = tolerance
        # the last residuals, with configuration and targets: they are asked for again and again
        self._known: list[tuple[Array, Sequence[Target], tuple[Array, Array]]] = []
        self._last: Closed | None = None  # where closing led

    def residual(self, q: Array, targets: Sequence[Target]) -> tuple[Array, Array]:
        """Return weighted residuals (k,) and derivatives (k, nv) for scaled velocities."""
        self.stand(q)
        if not targets:
            return np.empty(0), np.empty((0, len(self.scale)))
        for at, known, found in self._known:
            if at is q and known is targets:
                return found
        parts = []
        for target in targets:
            residual, rows = target.residual(self.evaluation)
            weight = 1.0 if target.weight is None else target.weight
            parts.append((weight * residual, rows * (weight * self.scale)))
        found = parts[0] if len(parts) == 1 else (
            np.concatenate([r for r, _ in parts]), np.concatenate([j for _, j in parts]))
        self._known = [*self._known[-1:], (q, targets, found)]
        return found

    def pulled(self, targets: Sequence[Target], forces: Array) -> Array:
        """Return the sum (nv,) of forces (k,) times derivatives of residuals, where they stand."""
        found = np.zeros(len(self.scale))
        for target in targets:
            pulled, forces = target.pulled(self.evaluation, forces)
            found += pulled if target.weight is None else target.weight * pulled
        return found * self.scale

    def closed(self, q: Array, free: NDArray[np.bool_]) -> Array:
        """Return a configuration with its loops closed by what is free (nv,) to move."""
        evaluation, last = self.evaluation, self._last
        if last is None or last.q is not q or last.error > TOLERANCES.round_off:
            last = self._last = closed(evaluation.mechanism, q, free, evaluation.angle_reference,
                                       TOLERANCES.round_off)
        self.stand(last.q)
        return last.q

    def is_closed(self, q: Array) -> bool:
        """Whether loops are closed at q (nq,), no axis turned round; equations stand there."""
        self.stand(q)
        evaluation, last = self.evaluation, self._last
        if last is not None and last.q is q and not last.may_be_mirrored:
            return last.error <= TOLERANCES.closed
        return evaluation.closure_error <= TOLERANCES.closed and not evaluation.mirrored()

    def motions(self, q: Array) -> Array:
        """Return orthonormal rows (k, nv) of motions that keep loops closed, none idle."""
        self.stand(q)
        basis = Triangular(self.evaluation.jacobian[:, self.moves]).null_space
        found = np.zeros((len(basis), len(self.moves)))
        found[:, self.moves] = basis
        return found

    def within(self, q: Array) -> tuple[Array, Bounds]:
        """Return a configuration with its loops closed within the limits, if they close there.

        Joints that were beyond limits stand at them.
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
    """Targets whose residuals are to become small while others stay met and loops closed."""

    def __init__(
        self, base: Constrained, kept: Sequence[Target], wanted: Sequence[Target]
    ) -> None:
        self.base, self.kept, self.wanted = base, kept, wanted
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
        """See `LeastSquares`: none of idle rotations, which a target may ask for."""
        rows = self.base.residual(x, self.kept)[1]
        evaluation = self.base.evaluation
        closures = evaluation.jacobian[: evaluation.constraints.n_closure]
        return np.concatenate([closures, rows]) if self.kept else closures

    def pulled(self, x: Array, multipliers: Array, forces: Array) -> Array:
        """See `LeastSquares`."""
        base = self.base
        base.stand(x)
        n = base.evaluation.constraints.n_closure
        found: Array = multipliers[:n] @ base.evaluation.jacobian[:n]
        return found + base.pulled(self.wanted, forces) + base.pulled(self.kept, multipliers[n:])

    def corrected(self, x: Array, free: NDArray[np.bool_], off: float) -> Array | None:
        """See `LeastSquares`."""
        base, last = self.base, np.inf
        q = base.closed(x, free)
        for _ in range(CORRECTIONS):
            residual, _ = base.residual(q, self.kept)
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
    """Where solving has led."""

    q: Array  # (nq,) configuration, its loops closed
    exact: Array  # (k,) residuals of what was to be exact
    active: Bounds  # joint limits that hold it back
    missed: float = 0.0  # length of the weighted residuals of what has a weight
    beyond: tuple[JointLimit, ...] = ()  # joint limits that it is beyond, since it started there
    is_on_its_way: bool = False  # whether it went on by long steps until these ran out

    @property
    def distance(self) -> float:
        """The length of `exact`."""
        return float(np.linalg.norm(self.exact))

    def is_nearer(self, other: ReachResult, tolerance: float) -> bool:
        """Whether this is within limits where the other is not, or clearly nearer.

        Where what is to be exact is met in both, it is nearer to what has a weight.
        """
        if bool(self.beyond) != bool(other.beyond):
            return not self.beyond
        own, others = self.distance, other.distance
        if max(own, others) <= tolerance:
            own, others = self.missed, max(other.missed, tolerance)
        return own < others * (1.0 - TOLERANCES.nothing)

    def is_met(self, tolerance: float) -> bool:
        """Whether what is to be exact is met, within limits."""
        return not self.beyond and self.distance <= tolerance

    def is_best(self, tolerance: float) -> bool:
        """Whether no configuration can be nearer: what has a weight is met too."""
        return self.is_met(tolerance) and self.missed <= tolerance


@dataclass(frozen=True, eq=False, kw_only=True)
class AsNow(Target):
    """Residuals of another target as they have become."""

    target: Target
    value: Array

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`."""
        found, slope = self.target.residual(evaluation)
        return found - self.value, slope


@dataclass(frozen=True, eq=False, kw_only=True)
class Unmoved(Target):
    """All joints where they were at the start (nq,)."""

    start: Array

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: in radians and characteristic lengths."""
        model, scale = evaluation.model, evaluation.mechanism.velocity_scale
        slope = pin.dDifference(model, self.start, evaluation.q, pin.ARG1)
        return pin.difference(model, self.start, evaluation.q) / scale, slope / scale[:, None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Stationary(Target):
    """The sum's derivative is zero along directions (k, nv) in which its curvature is `sizes`.

    Residuals that cannot be met may change without their sum: an axis that is normal to a direction
    stays normal to it however it turns, and the angle between them, as a vector, turns with it.
    """

    sum: Lagrangian
    sizes: Array
    ways: Array

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: how far it is from the least sum along each direction.

        The derivative is that along the motions that there are: other targets and the loops see to
        the rest.
        """
        half, ways = self._along(evaluation, self.ways / self.sizes[:, None])
        return ways @ half.slope, self._changes(evaluation, half, ways)

    def pulled(self, evaluation: LoopEquations, forces: Array) -> tuple[Array, Array]:
        """See `Target`: one way is enough, as second derivatives do not depend on the order."""
        n = len(self.sizes)
        half, way = self._along(evaluation, (forces[None, :n] / self.sizes) @ self.ways)
        return self._changes(evaluation, half, way)[0], forces[n:]

    def _along(self, evaluation: LoopEquations, ways: Array) -> tuple[Lagrangian, Array]:
        half = self.sum.at(evaluation.q)
        return half, ways @ half.tangents.T @ half.tangents

    @staticmethod
    def _changes(evaluation: LoopEquations, half: Lagrangian, ways: Array) -> Array:
        q = evaluation.q
        found: Array = half.changes(ways) / evaluation.mechanism.velocity_scale
        evaluation.update(q)
        return found


class Solver(Constrained):
    """Moves a mechanism to targets.

    Attributes:
        exact, weighted: targets to be reached, and those to be met as well as can be, their weights
            relative to the largest.
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
        """Return where the targets are met, from q (nq,) on, with least motion from `start`."""
        (q, active), is_on_its_way = self.within(q), False
        if self.exact:
            at, active, _, is_on_its_way = minimised(Level(self, [], self.exact), q, active)
            q = at.x
        level = Level(self, self.exact, self.weighted)
        polished = level.corrected(q, level.free(active), 0.0)
        if polished is None:
            return self.reached(q, active)._replace(is_on_its_way=is_on_its_way)
        at, is_on_its_way = Iterate(level, polished), False
        if self.weighted:
            at, active, _, is_on_its_way = minimised(level, polished, active)
        q = at.x if is_on_its_way else self._least_motion(level, at, start, active)
        return self.reached(q, active)._replace(is_on_its_way=is_on_its_way)

    def settled(self, found: ReachResult, start: Array) -> ReachResult:
        """Return what is nearest to the start of all that is as near to the targets."""
        if found.beyond or found.is_on_its_way or not self.is_closed(found.q):
            return found
        level = Level(self, [], self.exact)
        q = self._least_motion(level, Iterate(level, found.q), start, found.active)
        there = self.reached(q, found.active)
        is_nearer = found.is_nearer(there, self.tolerance)
        return found if is_nearer or not self.is_closed(q) else there

    def slopes(self, q: Array) -> Array:
        """Return how fast, along its principal directions, what is to be exact can change."""
        level = Level(self, [], self.exact)
        return decompose(level.jacobian(q) @ Iterate(level, q).tangents(self.moves).T).s

    def _least_motion(self, level: Level, at: Iterate, start: Array, active: Bounds) -> Array:
        """Return the configuration nearest to the start, as good as where a level ended.

        Where residuals cannot be met their sum of squares is kept, unless that leaves the same
        motions as to keep the residuals themselves.
        """
        kept, wanted = level.kept, level.wanted
        if at.size > self.tolerance:
            if not active and at.lagrangian(self.moves).is_single():
                return at.x
            pushed = {v: side for v, side in active.items()
                      if at.push(active, v) > TOLERANCES.nothing * at.size}
            free = level.free(pushed)
            least = Lagrangian(at, free)
            sizes, ways = least.curved()
            as_now = Level(self, [*kept, *self._as_now(at.x, wanted)], [])
            unchanged = Iterate(as_now, at.x).tangents(free)
            if len(unchanged) != len(least.tangents) - len(sizes) or not (
                    np.abs(ways @ unchanged.T).max(initial=0.0) < TOLERANCES.half_precision):
                stops = [CoordinateValue(name=limit.name, value=limit.value)
                         for limit in self.limits_of(pushed)]
                curved = [Stationary(name="", sum=least, sizes=sizes, ways=ways)]
                found = self._nearest(at.x, start, active,
                                      [*kept, *stops, *(curved if len(sizes) else [])])
                if Iterate(level, found).size <= at.size * (1.0 + TOLERANCES.nothing):
                    return found  # else it is level to second order only
        as_it_is = self._as_now(at.x, wanted)
        return self._nearest(at.x, start, active, [*kept, *as_it_is] if wanted else kept)

    def _nearest(self, q: Array, start: Array, active: Bounds, kept: Sequence[Target]) -> Array:
        """Return the configuration nearest to the start, from q on, that keeps targets met."""
        level = Level(self, kept, [Unmoved(start=start)])
        if not active and not len(Iterate(level, q).tangents(self.moves)):
            return q
        return minimised(level, q, active).at.x

    def _as_now(self, q: Array, wanted: Sequence[Target]) -> list[Target]:
        """Return targets that keep residuals as they are at q."""
        self.stand(q)
        return [AsNow(name=t.name, target=t, value=t.residual(self.evaluation)[0])
                for t in wanted]

    def reached(self, q: Array, active: Bounds) -> ReachResult:
        """Return how far targets are met at a configuration, with what holds it there."""
        missed = Iterate(Level(self, [], self.weighted), q).size
        return ReachResult(q, self.residual(q, self.exact)[0], active, missed,
                           self.limits_of(beyond(self.room(q), 0.0, {})))
