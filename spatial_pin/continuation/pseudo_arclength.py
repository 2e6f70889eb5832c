"""Following closed configurations by pseudo-arclength, where the driver is no parameter any more.

Predictor along the tangent, corrector in the plane normal to it [AllgowerGeorg2003]. What differs
between callers is where they end: at a driver value, at a limit, where the curve closes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.close import close
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.continuation.singular_points import distance_after, located
from spatial_pin.continuation.solution_curve import Curve, CurvePoint
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# rad or characteristic lengths; the next is twice as long, so that seven lead to the largest.
FIRST_STEP = 1e-3
LARGEST_STEP = 0.1  # far below the longest of a path, as it is taken where that may not be
# Where steps as short as this still fail, the branch is lost: configurations nearer to each other
# than the root of round-off, 1.5e-8, may tell nothing of a singularity between them.
SMALLEST_STEP = TOLERANCES.nothing
# Least cosine between the directions at the two ends of a step: 11 degrees, so that a branch that
# crosses at a larger angle is never taken for this one.
STRAIGHT = 0.98
MOST_STEPS = 2000  # two hundred radians or characteristic lengths: thirty turns
# Length of a step in which a change of the determinant's sign is believed: in longer ones it may be
# another branch's.
NEAR_BRANCH_POINT = 1e-3
# Distance to a branch point, relative to the root of what loops are left open by, at which the path
# ends there. Branches that cross pass each other at that root if loops are open; at ten times it
# the tangent is off by a hundredth.
NEAREST_BRANCH_POINT = 10.0


class Arrival(NamedTuple):
    """Where following a path ended.

    Attributes:
        kind: "reached", "limit", "branch point", "singular" or "lost".
        q: (nq,) the configuration.
        value: the driver value there [rad or m].
        is_far: whether it was lost only because the way is too long.
    """

    kind: str
    q: Array
    value: float
    is_far: bool = False


class Step(NamedTuple):
    """A step along a curve that is not taken yet.

    Attributes:
        kind: "regular", or where none is possible "branch point", or "lost".
        q: (nq,) configuration where it ends.
        t: (nv,) scaled unit tangent there.
        length: its length [rad, characteristic lengths].
    """

    kind: str
    q: Array
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

    def __init__(self, curve: Curve, point: CurvePoint, distance: float = np.inf) -> None:
        self.curve, self.point, self.distance = curve, point, distance

    @property
    def value(self) -> float:
        """Driver value of the point [rad or m]."""
        return float(self.point.q[self.curve.driver.q])

    def ahead(self, length: float) -> Step:
        """Return the next step, as long as asked for or shorter where the curve bends.

        It goes no further than half the way to a singularity: two branch points in one step would
        not be noticed. Nor nearer than configurations tell a singularity from one beside it: what
        loops are left open by parts branches that cross, and a curve turns from one into the other.
        """
        curve, point = self.curve, self.point
        if self.distance < NEAREST_BRANCH_POINT * np.sqrt(curve.tolerance):
            return Step("branch point", point.q, point.t, 0.0)
        length = min(length, 0.5 * self.distance)
        smallest = min(length, SMALLEST_STEP)
        while length >= smallest:
            q = curve.ahead(point, length)
            t, sign = curve.direction(q, point.t) if q is not None else (point.t, 0)
            if q is not None and sign == point.sign and t @ point.t >= STRAIGHT:
                return Step("regular", q, t, length)
            length *= 0.5
            if length < NEAR_BRANCH_POINT and q is not None and sign != point.sign:
                return Step("branch point", point.q, point.t, 0.0)
        return Step("lost", point.q, point.t, 0.0)

    def turning_point(self, step: Step) -> Step | None:
        """Return the part of a step to where the driver turns back, if it does."""
        curve, point = self.curve, self.point
        before, after = curve.slope(point.t), curve.slope(step.t)
        if not before or before * after > 0.0:
            return None

        def slope(x: float) -> float:
            q = curve.ahead(point, x)
            return curve.slope(curve.direction(q, point.t)[0]) if q is not None else np.nan

        length = _root(slope, step.length)
        return Step("regular", _place(curve, point, length), step.t, length)

    def take(self, step: Step) -> bool:
        """Move by a step; False, and nothing moves, where branches cross at its end."""
        point = self.curve.settle(step.q, step.t)
        if point is None:
            return False
        self.distance = distance_after(self.point, point, step.length)
        self.point = point
        return True


def towards(
    system: SquareSystem, q: Array, target: float, direction: Array, tolerance: float
) -> Arrival:
    """Follow the curve from q towards the driver value `target`.

    Args:
        system: the square system whose first driver is set free.
        q: (nq,) closed configuration.
        target: driver value to reach [rad or m].
        direction: (nv,) dq/d(driver) at q.
        tolerance: closure residual to reach [-].

    Returns:
        The configuration at the target, or at the limit or branch point that lies before it.
    """
    curve = Curve(system, max(tolerance, 1e-14))
    at = curve.driver.q
    heading = np.sign(target - q[at])
    point = curve.settle(q, heading * direction / curve.scale)
    if point is None:
        return branch_point_near(curve, curve.point(q, heading * direction / curve.scale), q)
    path = ArcLengthPath(curve, point)
    length = min(FIRST_STEP, 0.1 * point.sigma)
    for _ in range(MOST_STEPS):
        point, step = path.point, path.ahead(length)
        if step.kind == "lost":
            break
        if step.kind == "branch point":
            return branch_point_near(curve, point, point.q)
        turn = path.turning_point(step)
        for end in (step,) if turn is None else (turn, step):
            if heading * (end.q[at] - target) >= 0.0:
                return _arrive(curve, point, end.length, target)
        if turn is not None:
            return Arrival("limit", turn.q, float(turn.q[at]))
        if not path.take(step):
            return branch_point_near(curve, point, step.q)
        length = min(2.0 * step.length, LARGEST_STEP)
    return Arrival("lost", path.point.q, path.value)


def _arrive(curve: Curve, point: CurvePoint, length: float, target: float) -> Arrival:
    """Return the configuration at the target value, reached within `length` of the point."""
    at = curve.driver.q

    def gap(x: float) -> float:
        return float(_place(curve, point, x)[at]) - target

    ahead = _place(curve, point, _root(gap, length))
    ahead[at] = target
    free = np.ones(curve.model.nv, dtype=bool)
    free[[*curve.system.drive_at, *curve.system.still]] = False
    ahead, error = close(curve.evaluation, ahead, free, curve.tolerance)
    if error > 1e-11:
        return Arrival("lost", ahead, target)
    if curve.settle(ahead, point.t) is None:
        return branch_point_near(curve, point, ahead)
    return Arrival("reached", ahead, target)


def branch_point_near(curve: Curve, point: CurvePoint, q: Array) -> Arrival:
    """Return where the equations lose rank, ahead of a point, near q; there if none is found."""
    found = located(curve, point)
    kind, value = found if found is not None else ("branch point", float(q[curve.driver.q]))
    return Arrival(kind, q, value)


def _place(curve: Curve, point: CurvePoint, x: float) -> Array:
    found = curve.ahead(point, x)
    return point.q.copy() if found is None else found


def _root(function: Callable[[float], float], length: float) -> float:
    from scipy.optimize import brentq  # imported on use: it takes a tenth of a second

    if function(0.0) * function(length) > 0.0:
        return length
    return float(brentq(function, 0.0, length, xtol=1e-14, rtol=1e-14))
