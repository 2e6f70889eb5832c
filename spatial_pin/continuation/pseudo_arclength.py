"""Pseudo-arclength continuation, for parts of a path where the driver is no good parameter.

Predictor along the tangent, corrector in the plane normal to it [AllgowerGeorg2003]. What differs
between callers is where they end: at a leading value, at a limit, where the curve closes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.close import close
from spatial_pin.continuation.singular_points import (
    LARGEST_STEP,
    SMALLEST_STEP,
    distance_after,
    located_singularity,
)
from spatial_pin.continuation.solution_curve import CurvePoint, SolutionCurve
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.roots import sign_change

FIRST_STEP = 1e-3  # rad or characteristic lengths. Steps double, so that seven lead to the largest
# Least cosine between the tangents at the two ends of a step, 11 degrees: a branch that crosses at
# a larger angle is never taken by mistake.
STRAIGHT = 0.98
MOST_STEPS = 2000  # steps of a path: 200 rad or characteristic lengths, thirty turns
# Longest step in which a sign change of the determinant is a branch point of this path. In a
# longer one it may belong to another branch.
NEAR_BRANCH_POINT = 1e-3
# A path ends at this distance from a branch point, relative to the square root of the closure
# residual. Branches of open loops pass each other at a distance of that root. At ten times the
# root the tangent is off by 1 %.
NEAREST_BRANCH_POINT = 10.0

CROSSINGS = ("branch point", "singular")  # kinds of ends where branches may cross


class Stopped(Exception):
    """A branch cannot be followed to a given value.

    Attributes:
        kind: "limit", "branch point", "singular", "lost", "half turn" (of a rotation vector), or
            "runs away" (a joint does so without end, see `asymptotes`).
        q: (nq,) the configuration at its end.
        value: the leading value there, of a driver [rad or m] or the parameter; where a joint runs
            away, the limit that it comes to.
        is_far: whether it was lost only because the way is too long.
        runs_away: name of the coordinate that does.
        sample: number of the one that could not be reached.
    """

    def __init__(
        self, kind: str, q: Array, value: float, is_far: bool = False, runs_away: str = ""
    ) -> None:
        super().__init__(kind)
        self.kind, self.q, self.value = kind, q, value
        self.is_far, self.runs_away, self.sample = is_far, runs_away, 0


class PredictedStep(NamedTuple):
    """A predicted step along a curve, not yet taken.

    Attributes:
        x: (n,) unknowns where it ends.
        t: (m,) scaled unit tangent there.
        length: its length [rad, characteristic lengths].
    """

    x: Array
    t: Array
    length: float


class ArcLengthPath:
    """A point that moves along a curve by pseudo-arclength.

    Attributes:
        curve: the curve.
        point: where it stands.
        distance: to the singularity ahead, where the equations would lose their rank as they did
            in the last step; infinite if none is in view.
    """

    def __init__(self, curve: SolutionCurve, point: CurvePoint, distance: float = np.inf) -> None:
        self.curve, self.point, self.distance = curve, point, distance

    @property
    def value(self) -> float:
        """The parameter at the point."""
        return self.curve.value(self.point.x)

    def ahead(self, length: float) -> PredictedStep:
        """Return the next step, of the given length or shorter where the curve bends.

        It goes no further than half the way to a singularity: two branch points in one step would
        not be noticed. Nor nearer than configurations tell a singularity from one beside it: what
        loops are left open by parts branches that cross, and a curve turns from one into the other.

        Raises:
            Stopped: none is possible: branches cross ahead, or the curve was lost.
        """
        curve, point = self.curve, self.point
        if self.distance < NEAREST_BRANCH_POINT * np.sqrt(curve.tolerance):
            raise branch_point_near(curve, point, point.x)
        length = min(length, 0.5 * self.distance)
        smallest = min(length, SMALLEST_STEP)
        while length >= smallest:
            x = curve.ahead(point, length)
            t, sign = curve.direction(x, point.t) if x is not None else (point.t, 0)
            if x is not None and sign == point.sign and t @ point.t >= STRAIGHT:
                return PredictedStep(x, t, length)
            length *= 0.5
            if length < NEAR_BRANCH_POINT and x is not None and sign != point.sign:
                raise branch_point_near(curve, point, point.x)
        raise _lost(curve, point)

    def turning_point(self, step: PredictedStep) -> PredictedStep | None:
        """Return the part of a step up to a turning point of the parameter, if there is one."""
        curve, point = self.curve, self.point
        before, after = curve.slope(point.t), curve.slope(step.t)
        if not before or before * after > 0.0:
            return None

        def slope(length: float) -> float:
            x = curve.ahead(point, length)
            return curve.slope(curve.direction(x, point.t)[0]) if x is not None else np.nan

        length = _root(slope, step.length)
        return PredictedStep(_point_at(curve, point, length), step.t, length)

    def take(self, step: PredictedStep) -> None:
        """Move by a step.

        Raises:
            Stopped: branches cross at its end; nothing moves.
        """
        point = self.curve.settle(step.x, step.t)
        if point is None:
            raise branch_point_near(self.curve, self.point, step.x)
        self.distance = distance_after(self.point, point, step.length)
        self.point = point


def followed_to(curve: SolutionCurve, x: Array, target: float, direction: Array) -> Array:
    """Follow a curve from x towards the parameter value `target`; return the configuration there.

    `direction` (nv,) is the derivative of the configuration with respect to the leading value.

    Raises:
        Stopped: a limit or branch point lies before it, or the curve was lost.
    """
    heading = np.sign(target - curve.value(x))
    along = heading * curve.tangent(direction)
    point = curve.settle(x, along)
    if point is None:
        raise branch_point_near(curve, curve.point(x, along), x)
    path = ArcLengthPath(curve, point)
    length = min(FIRST_STEP, 0.1 * point.sigma)
    for _ in range(MOST_STEPS):
        step = path.ahead(length)
        turn = path.turning_point(step)
        for end in (step,) if turn is None else (turn, step):
            if heading * (curve.value(end.x) - target) >= 0.0:
                return _closed_at(curve, path.point, end.length, target)
        if turn is not None:
            raise Stopped("limit", curve.configuration(turn.x), curve.value(turn.x))
        path.take(step)
        length = min(2.0 * step.length, LARGEST_STEP)
    raise _lost(curve, path.point)


def _closed_at(curve: SolutionCurve, point: CurvePoint, length: float, target: float) -> Array:
    """Return the configuration at the target value, reached within `length` of the point.

    Raises:
        Stopped: loops do not close there, or branches cross.
    """
    def gap(x: float) -> float:
        return curve.value(_point_at(curve, point, x)) - target

    ahead, evaluation = _point_at(curve, point, _root(gap, length)), curve.evaluation
    curve.put(ahead, target)
    q, error = close(
        evaluation, curve.configuration(ahead), curve.system.free, curve.tolerance)
    if error > 1e-11:
        raise Stopped("lost", q, target)
    x = curve.unknowns(q, target)
    if curve.settle(x, point.t) is None:
        raise branch_point_near(curve, point, x)
    return q


def branch_point_near(curve: SolutionCurve, point: CurvePoint, x: Array) -> Stopped:
    """Return that the branch ends at the branch point ahead of a point, at x if there is none."""
    kind, value = located_singularity(curve, point) or ("branch point", curve.value(x))
    return Stopped(kind, curve.configuration(x), value)


def _lost(curve: SolutionCurve, point: CurvePoint) -> Stopped:
    return Stopped("lost", curve.configuration(point.x), curve.value(point.x))


def _point_at(curve: SolutionCurve, point: CurvePoint, length: float) -> Array:
    ahead = curve.ahead(point, length)
    return point.x.copy() if ahead is None else ahead


def _root(function: Callable[[float], float], length: float) -> float:
    before, after = function(0.0), function(length)
    if not before * after <= 0.0:
        return length
    return sign_change(function, 0.0, length, before, after)
