"""Where the rows of a curve lose their rank: told from places before, nothing can be solved there.

The determinant of rows and tangent is a smooth function of the place. It vanishes where branches
cross, as often as they do, and can be continued to there.
"""

from __future__ import annotations

import numpy as np

from spatial_pin.continuation.solution_curve import Curve, CurvePoint
from spatial_pin.numerics.linalg import Array

LARGEST_STEP, SMALLEST_STEP = 0.1, 1e-9  # rad or characteristic lengths
VIEW = 8e-3, 2e-2  # least and most distance from a crossing that its place is told from
PROBE = 1e-4  # length over which the rows' loss of rank is judged
APPROACHES = 64  # steps to such a distance
PLACES = 0.16 * np.arange(6)  # parts of the way to a crossing that its place is told from
TOGETHER = 1e-4  # part of the way over which zeros of a determinant are one: round-off parts them


def through(x: Array, y: Array) -> np.polynomial.Polynomial:
    """Return the polynomial through the points (x, y)."""
    return np.polynomial.Polynomial.fit(x, y, len(x) - 1)


def zeros(x: Array, y: Array) -> list[float]:
    """Return the real zeros of the polynomial through (x, y), rising, several at a place as one."""
    span = float(np.ptp(x))
    roots = through(x, y).roots()
    real = np.sort(roots[np.abs(roots.imag) < TOGETHER * span].real)
    groups = np.split(real, np.flatnonzero(np.diff(real) > TOGETHER * span) + 1)
    return [float(group.mean()) for group in groups if group.size]


def _viewed(curve: Curve, point: CurvePoint) -> tuple[CurvePoint, float] | None:
    """Return a point before a crossing ahead of another point, and how far it about is, in VIEW."""
    back, base, distance = VIEW[0], _moved(curve, point, -VIEW[0]), 0.0
    for _ in range(APPROACHES):
        if base is None:
            return None
        distance = room_ahead(curve, base)
        if VIEW[0] <= distance <= VIEW[1]:
            return base, distance
        if VIEW[1] < distance < np.inf:
            base = _moved(curve, base, min(0.5 * distance, LARGEST_STEP))
        else:  # too near, or just behind it
            back *= 2.0
            base = _moved(curve, point, -back) if back < LARGEST_STEP else None
    return None


def _moved(curve: Curve, point: CurvePoint, length: float) -> CurvePoint | None:
    """Return the point `length` ahead of another one, or less far if a crossing lies between."""
    while abs(length) > SMALLEST_STEP:
        q = curve.ahead(point, length)
        if q is None:
            return None
        moved = curve.point(q, curve.direction(q, point.t)[0])
        if moved.sign == point.sign:
            return moved
        length *= 0.5
    return None


def room_ahead(curve: Curve, point: CurvePoint) -> float:
    """Return about how far ahead of a point the rows lose their rank, inf if not at all."""
    q = curve.ahead(point, PROBE)
    if q is None:
        return 0.0
    return room_after(point, point._replace(sigma=curve.sigma(q)), PROBE)


def room_after(last: CurvePoint, point: CurvePoint, length: float) -> float:
    """Return how far ahead of a point, `length` after the last, its rows would lose their rank."""
    fall = last.sigma - point.sigma
    return point.sigma * length / fall if fall > 0.0 else np.inf


def located(curve: Curve, point: CurvePoint) -> tuple[str, float] | None:
    """Return what is met where the rows lose their rank ahead of a point, and the driver value.

    There nothing can be solved: the place is that where the determinant of rows and tangent, a
    smooth function of the arc length, vanishes if continued from places before it; so are driver
    value and how fast it still changes. A driver that comes to rest there has reached its limit;
    else branches cross.
    """
    at = curve.driver.q
    viewed = _viewed(curve, point)
    if viewed is None:
        return None
    base, distance = viewed
    lengths = distance * PLACES
    places = [curve.ahead(base, x) for x in lengths]
    found = [place for place in places if place is not None]
    if len(found) < len(places):
        return None
    tangents = [curve.direction(x, base.t)[0] for x in found]
    determinants = curve.determinants(zip(found, tangents, strict=True))
    first = next((x for x in zeros(lengths, determinants) if x > 0.0), None)
    if first is None:
        return None
    value = float(through(lengths, np.array([x[at] for x in found]))(first))
    slopes = through(lengths, np.array([curve.slope(t) for t in tangents]))
    rests = abs(slopes(first)) < 0.1 * abs(slopes(0.0))
    return "limit" if rests else "branch point", value
