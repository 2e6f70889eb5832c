"""Asymptotes: a joint grows without bound while the driver approaches a value.

A slide along a turning arm whose end stays in a plane is such a joint: it is parallel to the plane
at last. The curve of closed configurations goes on for ever there; of its leading value only the
limit is a number. It is a power series of one over the joint's coordinate, or of a root of that,
and is extrapolated from places farther and farther out.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from spatial_pin.continuation.pseudo_arclength import STRAIGHT, Stopped
from spatial_pin.continuation.solution_curve import CurvePoint, SolutionCurve
from spatial_pin.mechanism.coordinates import coordinate_gradient, coordinate_value
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Rad or characteristic lengths: ten times as far as links reach. A driver beyond this value is
# checked for an asymptote.
BEYOND_LINKS = 20.0
# Rad or characteristic lengths: the last point used. Machine epsilon times this value opens loops
# by 4e-12.
FARTHEST_OUT = 2e4
FEWEST_PLACES = 6  # points for an extrapolation
ROOTS = 1, 2, 3  # the leading value is tried as a power series in this root of the coordinate
# Steps from one point to the next, which is twice as far out: steps halve where they fail.
MOST_TRIALS = 40


def running_away(curve: SolutionCurve, x: Array, target: float) -> Stopped | None:
    """Return that an asymptote ends a branch before a target; None without one.

    A target so near the end that the joint would be farther out than is followed is beyond it too.
    The unknowns x (n,) are farther out than links reach if a joint runs away; the curve's
    evaluation expects angles as they are there.
    """
    runner = _outward(curve, x)
    if runner is None:
        return None
    points = np.array(_points_outward(*runner)).reshape(-1, 2)
    known = TOLERANCES.closed * float(curve.scale[curve.rate])
    limit = _limit(points[:, 0], points[:, 1], known)
    if limit is None or not (target - points[-1, 1]) * (limit - points[0, 1]) > 0.0:
        return None
    return Stopped("runs away", curve.configuration(x), limit, runs_away=runner[0].of.name)


class _Far(NamedTuple):
    """A coordinate that may grow without bound along a curve."""

    curve: SolutionCurve
    of: Coordinate

    @property
    def size(self) -> float:
        """Its unit [rad or m]."""
        return float(self.curve.scale[self.of.v])

    def value(self, x: Array) -> float:
        """Return its absolute value [rad, characteristic lengths]."""
        mechanism, q = self.curve.evaluation.mechanism, self.curve.configuration(x)
        return coordinate_value(mechanism, self.of, q) / self.size

    def row(self, x: Array) -> Array:
        """Return the derivative of that (m,) with respect to scaled steps."""
        mechanism, q = self.curve.evaluation.mechanism, self.curve.configuration(x)
        gradient, scale = coordinate_gradient(mechanism, self.of, q), self.curve.scale
        gradient_row = np.zeros(len(scale))
        gradient_row[: len(gradient)] = gradient * scale[: len(gradient)] / self.size
        return gradient_row

    def pace(self, point: CurvePoint) -> float:
        """Return its rate along the tangent at a point."""
        return float(self.row(point.x) @ point.t)


def _outward(curve: SolutionCurve, x: Array) -> tuple[_Far, CurvePoint] | None:
    """Return the joint that grows at x, and the point with its tangent in that direction."""
    table = curve.evaluation.mechanism.coordinate_table.values()
    far = [f for c in table if c not in curve.system.driven and (f := _Far(curve, c))
           and abs(f.value(x)) >= BEYOND_LINKS]
    if not far:
        return None
    along = np.sum([f.value(x) * f.row(x) for f in far], axis=0)
    point = curve.settle(x, along) or curve.point(x, curve.direction(x, along)[0])
    if not np.isfinite(point.t).all():
        return None
    fastest = max(far, key=lambda f: abs(f.pace(point)))
    return (fastest, point) if fastest.value(x) * fastest.pace(point) > 0.0 else None


def _points_outward(far: _Far, point: CurvePoint) -> list[tuple[float, float]]:
    """Return coordinate and parameter at points, each twice as far out as the one before."""
    back = point._replace(t=-point.t, sign=-point.sign)
    inward: list[CurvePoint] = []
    outward = [point]
    if abs(far.value(point.x)) > FARTHEST_OUT:
        outward = []
    while not inward or abs(far.value(back.x)) > BEYOND_LINKS or len(inward) < FEWEST_PLACES:
        goal = min(0.5 * abs(far.value(back.x)), FARTHEST_OUT)
        inner = _led(far, back, float(np.copysign(goal, far.value(back.x))))
        if inner is None:
            break
        back = inner
        inward.append(inner)
    while outward and abs(far.value(outward[-1].x)) < FARTHEST_OUT:
        outer = _led(far, outward[-1], 2.0 * far.value(outward[-1].x))
        if outer is None:
            break
        outward.append(outer)
    return [(far.value(p.x), far.curve.value(p.x)) for p in [*inward[::-1], *outward]]


def _led(far: _Far, point: CurvePoint, goal: float) -> CurvePoint | None:
    """Return the point of the curve where a coordinate has about a given value, or None."""
    curve, length = far.curve, np.inf
    for _ in range(MOST_TRIALS):
        gap, pace = goal - far.value(point.x), far.pace(point)
        if not gap * pace > 0.0:
            return None  # it turned back
        length = min(length, gap / pace)
        step = length * point.t
        curve.expect(point, step)
        ahead = curve.moved(point.x, step)
        x = curve.onto(ahead, far.row(ahead))
        t, sign = curve.direction(x, point.t) if x is not None else (point.t, 0)
        if x is None or sign != point.sign or t @ point.t < STRAIGHT:
            length *= 0.5
            continue
        point, is_there = curve.point(x, t), length == gap / pace
        if is_there:
            return point
        length *= 2.0
    return None


def _limit(x: Array, values: Array, known: float) -> float | None:
    """Return the limit of values (n,) for growing x (n,); None if it is not certain.

    Inner points are omitted where the limit is more certain without them: laws have pieces. `known`
    is by how much the limit may change if the innermost point is omitted.
    """
    best, change = np.nan, np.inf
    for first, root in product(range(len(x) - FEWEST_PLACES + 1), ROOTS):
        y, column = np.abs(x[first:]) ** (-1.0 / root), values[first:]
        for k in range(1, len(y)):  # Neville's scheme for the polynomial at y = 0
            last = column[-1]
            column = (y[:-k] * column[1:] - y[k:] * column[:-1]) / (y[:-k] - y[k:])
        off = float(abs(column[0] - last))  # by the innermost point
        best, change = (float(column[0]), off) if off < change else (best, change)
    distance = np.abs(best - values)
    comes_near = bool((distance[1:] < distance[:-1]).all())
    return best if comes_near and change <= known else None
