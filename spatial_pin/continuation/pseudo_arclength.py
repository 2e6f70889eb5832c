"""Following closed configurations by arc length, where the driver is no parameter any more."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.close import close
from spatial_pin.assembly.newton import SquareSystem
from spatial_pin.continuation.singular_points import located, room_after
from spatial_pin.continuation.solution_curve import Curve, CurvePoint
from spatial_pin.numerics.linalg import Array

FIRST_STEP = 1e-3  # rad or characteristic lengths
LARGEST_STEP = 0.1
SMALLEST_STEP = 1e-9
STRAIGHT = 0.98  # least cosine between the directions at the two ends of a step
MOST_STEPS = 2000
NEAR_CROSSING = 1e-3  # length of a step in which a change of the determinant's sign is believed


class Arrival(NamedTuple):
    """Where a march ended.

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


def march(
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
        return locate_crossing(curve, curve.point(q, heading * direction / curve.scale), q)
    last = point
    length = min(FIRST_STEP, 0.1 * point.sigma)
    for _ in range(MOST_STEPS):
        if point is None:
            return locate_crossing(curve, last, q)
        q, last = point.q, point
        ahead = curve.ahead(point, length)
        t, sign = curve.direction(ahead, point.t) if ahead is not None else (point.t, 0)
        if ahead is None or t @ point.t < STRAIGHT or sign != point.sign:
            length *= 0.5
            if length < NEAR_CROSSING and ahead is not None and sign != point.sign:
                return locate_crossing(curve, point, q)
            if length < SMALLEST_STEP:
                return Arrival("lost", q, float(q[at]))
            continue
        if heading * (ahead[at] - target) >= 0.0:
            return _arrive(curve, point, length, target)
        if heading * curve.slope(t) <= 0.0:
            turning = turning_point(curve, point, length)
            limit = _place(curve, point, turning)
            if heading * (limit[at] - target) >= 0.0:
                return _arrive(curve, point, turning, target)
            return Arrival("limit", limit, float(limit[at]))
        q, point = ahead, curve.settle(ahead, t)
        # never further than half the way to where the rows would lose their rank
        room = 0.5 * room_after(last, point, length) if point is not None else np.inf
        length = min(2.0 * length, LARGEST_STEP, max(room, SMALLEST_STEP))
    return Arrival("lost", q, float(q[at]))


def turning_point(curve: Curve, point: CurvePoint, length: float) -> float:
    """Return the length, at most `length`, after which the driver turns back."""

    def slope(x: float) -> float:
        ahead = curve.ahead(point, x)
        return curve.slope(curve.direction(ahead, point.t)[0]) if ahead is not None else np.nan

    return _root(slope, length)


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
        return locate_crossing(curve, point, ahead)
    return Arrival("reached", ahead, target)


def locate_crossing(curve: Curve, point: CurvePoint, q: Array) -> Arrival:
    """Return where the rows lose their rank, ahead of a point, near q; there if none is found."""
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
