"""Following closed configurations by arc length, where the driver is no parameter any more."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.kinematics.newton import SquareSystem, close
from spatial_pin.linalg import Array, decompose, determinant_sign_of, independent_rows

FIRST_STEP = 1e-3  # rad or characteristic lengths
LARGEST_STEP = 0.1
SMALLEST_STEP = 1e-9
STRAIGHT = 0.98  # least cosine between the directions at the two ends of a step
MOST_STEPS = 2000
NEAR_CROSSING = 1e-3  # length of a step in which a change of the determinant's sign is believed
VIEW = 8e-3, 2e-2  # least and most distance from a crossing that its place is told from
PROBE = 1e-4  # length over which the rows' loss of rank is judged
APPROACHES = 64  # steps to such a distance
PLACES = 0.16 * np.arange(6)  # parts of the way to a crossing that its place is told from
TOGETHER = 1e-4  # part of the way over which zeros of a determinant are one: round-off parts them
CROSSING = 1e-7  # smallest over largest singular value of the curve's rows where branches cross


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


class CurvePoint(NamedTuple):
    """A closed configuration of the curve.

    Attributes:
        q: (nq,) configuration.
        t: (nv,) scaled unit tangent.
        sign: sign of the determinant of [regular rows; tangent].
        sigma: smallest over largest singular value of the regular rows.
        angles, slopes: relative angles of screw closures, and their scaled derivatives.
    """

    q: Array
    t: Array
    sign: int
    sigma: float
    angles: Array
    slopes: Array


class Curve:
    """The curve of closed configurations through a point, the first driver set free."""

    def __init__(self, system: SquareSystem, tolerance: float) -> None:
        self.system, self.evaluation = system, system.evaluation
        self.model = system.evaluation.model
        self.scale = system.scale
        self.tolerance = tolerance
        self.driver = system.driven[0]
        self.drive = system.matrix[system.driver_rows][1:]
        self.selected = system.rows

    def rows(self, q: Array) -> Array:
        """Return the (nv - 1, nv) regular rows of the curve at q."""
        self.evaluation.update(q)
        jacobian, n = self.evaluation.jacobian, self.evaluation.constraints.n_rows
        parts = [jacobian[self.selected], jacobian[n:], self.drive, self.system.passive]
        return np.vstack(parts)

    def settle(self, q: Array, along: Array) -> CurvePoint | None:
        """Return the point at q whose tangent is nearest to `along`; None where branches cross."""
        rows = self.rows(q)
        if self.system.has_redundant_rows:
            n = self.evaluation.constraints.n_rows
            selected = independent_rows(self.evaluation.jacobian[:n], CROSSING)
            if len(selected) < len(self.system.rows):
                return None
            self.selected = selected
            rows = self.rows(q)
        svd = decompose(rows, CROSSING)
        if svd.rank < len(rows):
            return None
        return self.point(q, svd.null_space.T @ (svd.null_space @ along), rows, svd.s)

    def point(
        self, q: Array, t: Array, rows: Array | None = None, s: Array | None = None
    ) -> CurvePoint:
        """Return the point at q with a given tangent; rows and their singular values if known."""
        rows = self.rows(q) if rows is None else rows
        s = decompose(rows, 0.0).s if s is None else s
        t = t / np.linalg.norm(t)
        evaluation = self.evaluation
        return CurvePoint(q, t, determinant_sign_of(np.vstack([rows, t])), _sigma(s),
                          evaluation.angles.copy(), evaluation.angle_jacobian.copy())

    def ahead(self, point: CurvePoint, length: float) -> Array | None:
        """Return the closed configuration `length` ahead along the tangent."""
        step = length * point.t
        self.evaluation.turns[:] = point.angles + point.slopes @ step
        return self.onto(pin.integrate(self.model, point.q, self.scale * step), point.t)

    def onto(self, q: Array, normal: Array) -> Array | None:
        """Return the closed configuration near q in the plane through it with a scaled normal."""
        for _ in range(8):
            rows = self.rows(q)
            residual = self.evaluation.residual
            if residual @ residual <= self.tolerance**2:
                return q
            rhs = np.zeros(len(rows) + 1)
            rhs[: len(self.selected)] = -residual[self.selected]
            x = decompose(np.vstack([rows, normal])).minimum_norm(rhs)
            if not np.abs(x).max() < 0.1:
                return None
            q = pin.integrate(self.model, q, self.scale * x)
        return q if residual @ residual <= 1e-22 else None

    def direction(self, q: Array, along: Array) -> tuple[Array, int]:
        """Return tangent and determinant sign at q with the rows of the last `settle`."""
        rows = self.rows(q)
        null_space = decompose(rows, 1e-12).null_space
        t = null_space.T @ (null_space @ along)
        t /= np.linalg.norm(t)
        return t, determinant_sign_of(np.vstack([rows, t]))

    def sigma(self, q: Array) -> float:
        """Return the smallest over the largest singular value of the rows at q."""
        return _sigma(decompose(self.rows(q), 0.0).s)

    def determinants(self, places: Iterable[tuple[Array, Array]]) -> Array:
        """Return the determinants of [regular rows; tangent], up to a factor, at (q, t) places.

        A smooth function of the place, which vanishes where branches cross.
        """
        matrices = np.array([np.vstack([self.rows(q), t / np.linalg.norm(t)]) for q, t in places])
        sign, magnitude = np.linalg.slogdet(matrices)
        found: Array = sign * np.exp(magnitude - magnitude.max())
        return found

    def curvature(self, point: CurvePoint) -> Array:
        """Return d²q/d(arc)² (nv,) at a point; the evaluation is left there."""
        rows = self.rows(point.q)
        n = self.evaluation.constraints.n_rows
        bias = self.evaluation.bias(point.q, self.scale * point.t)
        rhs = np.zeros(len(rows) + 1)
        rhs[: len(self.selected)] = -bias[:n][self.selected]
        rhs[len(self.selected) : len(self.selected) + len(bias) - n] = -bias[n:]
        return self.scale * decompose(np.vstack([rows, point.t])).minimum_norm(rhs)

    def slope(self, t: Array) -> float:
        """Rate of the driver along the scaled tangent."""
        return float(t[self.driver.v] * self.scale[self.driver.v])


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


def _sigma(s: Array) -> float:
    return float(s[-1] / s[0]) if s.size else 1.0


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
    free[[c.v for c in curve.system.driven]] = False
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


def _place(curve: Curve, point: CurvePoint, x: float) -> Array:
    found = curve.ahead(point, x)
    return point.q.copy() if found is None else found


def _root(function: Callable[[float], float], length: float) -> float:
    from scipy.optimize import brentq  # imported on use: it takes a tenth of a second

    if function(0.0) * function(length) > 0.0:
        return length
    return float(brentq(function, 0.0, length, xtol=1e-14, rtol=1e-14))
