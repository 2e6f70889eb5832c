"""Targets by Newton's and Gauss's methods on closed loops, one level of importance in the other.

Loops are closed first; in the motions that keep them closed, what is to be exact is met; in those
that keep that too, what has a weight is met as well as can be; what freedom is left is moved least
[SicilianoSlotine1991].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.inverse_kinematics.constrained import Constrained, Held, Lagrangian, Stationary
from spatial_pin.inverse_kinematics.descending import Descent
from spatial_pin.inverse_kinematics.targets import CoordinateValue, Residual, Target
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.joint_limits import JointLimit
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES


class ReachResult(NamedTuple):
    """Where solving has led."""

    q: Array  # (nq,) configuration, its loops closed
    exact: Array  # (k,) residuals of what was to be exact
    limits: tuple[JointLimit, ...]  # joint limits that hold it back
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
        if self.beyond or other.beyond:
            return bool(other.beyond) and (not self.beyond or self._is_less(other, tolerance))
        return self._is_less(other, tolerance)

    def _is_less(self, other: ReachResult, tolerance: float) -> bool:
        own, others = self.distance, other.distance
        if max(own, others) <= tolerance:
            own, others = self.missed, max(other.missed, tolerance)
        return own < others * (1.0 - TOLERANCES.nothing)

    def is_met(self, tolerance: float) -> bool:
        """Whether what is to be exact is met, within limits."""
        return not self.beyond and self.distance <= tolerance

    def is_best(self, tolerance: float) -> bool:
        """Whether no place can be nearer: what has a weight is met too."""
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
        q, held = self.within(q)
        is_on_its_way = False
        if self.exact:
            q, held, is_on_its_way = Descent(self, [], self.exact).run(q, held)
        polished = self.kept(q, self.stops.free(held), self.exact)
        if polished is None:
            return self.reached(q, held)._replace(is_on_its_way=is_on_its_way)
        q = polished
        descent, is_on_its_way = Descent(self, self.exact, self.weighted), False
        if self.weighted:
            q, held, is_on_its_way = descent.run(q, held)
        if not is_on_its_way:
            q = self._least_motion(q, start, held, descent)
        return self.reached(q, held)._replace(is_on_its_way=is_on_its_way)

    def settled(self, found: ReachResult, start: Array) -> ReachResult:
        """Return the place nearest to the start of those that are as near to the targets."""
        if found.beyond or found.is_on_its_way or not self.is_closed(found.q):
            return found
        held = {limit.v: limit for limit in found.limits}
        q = self._least_motion(found.q, start, held, Descent(self, [], self.exact))
        there = self.reached(q, held)
        is_nearer = found.is_nearer(there, self.tolerance)
        return found if is_nearer or not self.is_closed(q) else there

    def slopes(self, q: Array) -> Array:
        """Return how fast, along its principal directions, what is to be exact can change."""
        rows = self.residual(q, self.exact)[1] @ self.motions(q, self.stops.moves, []).T
        return decompose(rows).s

    def _least_motion(self, q: Array, start: Array, held: Held, descent: Descent) -> Array:
        """Return the configuration nearest to the start, as good as where a descent ended.

        Where residuals cannot be met their sum of squares is kept, unless that leaves the same
        motions as to keep the residuals themselves.
        """
        kept, wanted = descent.kept, descent.wanted
        missed = self._missed(q, wanted)
        if missed > self.tolerance:
            if not held and descent.is_single(q, held):
                return q
            pushed = [limit for v, limit in held.items()
                      if descent.push(q, held, v) > TOLERANCES.nothing * missed]
            free = self.stops.free({limit.v: limit for limit in pushed})
            least = Lagrangian(self, kept, wanted, q, free)
            sizes, ways = least.curved()
            unchanged = self.motions(q, free, [*kept, *self._as_now(q, wanted)])
            n = len(self.motions(q, free, kept))
            if len(unchanged) != n - len(sizes) or not (
                    np.abs(ways @ unchanged.T).max(initial=0.0) < TOLERANCES.half_precision):
                stops = [CoordinateValue(name=limit.name, value=limit.value) for limit in pushed]
                curved = [Stationary(name="", sum=least, sizes=sizes, ways=ways)]
                level = [*kept, *stops, *(curved if len(sizes) else [])]
                found = self._nearest(q, start, held, level)
                if self._missed(found, wanted) <= missed * (1.0 + TOLERANCES.nothing):
                    return found  # else it is level to second order only
        return self._nearest(q, start, held, [*kept, *self._as_now(q, wanted)] if wanted else kept)

    def _nearest(self, q: Array, start: Array, held: Held, kept: Sequence[Target]) -> Array:
        """Return the configuration nearest to the start, from q on, that keeps targets met."""
        if not held and not len(self.motions(q, self.stops.free(held), kept)):
            return q
        found, _, _ = Descent(self, kept, [Unmoved(start=start)]).run(q, held)
        return found

    def _missed(self, q: Array, wanted: Sequence[Target]) -> float:
        return float(np.linalg.norm(self.residual(q, wanted)[0]))

    def _as_now(self, q: Array, wanted: Sequence[Target]) -> list[Target]:
        """Return targets that keep residuals as they are at q."""
        self.stand(q)
        return [AsNow(name=t.name, target=t, value=t.residual(self.evaluation)[0])
                for t in wanted]

    def reached(self, q: Array, held: Held) -> ReachResult:
        """Return how far targets are met at a configuration, with what holds it there."""
        return ReachResult(q, self.residual(q, self.exact)[0], tuple(held.values()),
                       self._missed(q, self.weighted), tuple(self.stops.beyond(q, {}).values()))
