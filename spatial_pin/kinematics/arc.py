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
NEAR_CROSSING = 1e-3  # distance from a crossing at which it is looked at
CROSSING = 1e-5  # smallest over largest singular value of the curve's rows where branches cross


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
        sigma: smallest over largest singular value of the regular rows; of one row its size.
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
            self.selected = independent_rows(self.evaluation.jacobian[:n], CROSSING)
            if len(self.selected) < len(self.system.rows):
                return None
            rows = self.rows(q)
        svd = decompose(rows, CROSSING)
        if svd.rank < len(rows) or _sigma(svd.s) < CROSSING:
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
    last = clear = point
    length = min(FIRST_STEP, 0.1 * point.sigma)
    for _ in range(MOST_STEPS):
        if point is None:
            return locate_crossing(curve, clear, q)
        q, last = point.q, point
        clear = point if point.sigma > NEAR_CROSSING else clear
        ahead = curve.ahead(point, length)
        t, sign = curve.direction(ahead, point.t) if ahead is not None else (point.t, 0)
        if ahead is None or t @ point.t < STRAIGHT or sign != point.sign:
            length *= 0.5
            if length < NEAR_CROSSING and ahead is not None and sign != point.sign:
                return locate_crossing(curve, clear, q)
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
        fall = last.sigma - point.sigma if point is not None else 0.0
        room = 0.5 * point.sigma * length / fall if point is not None and fall > 0.0 else np.inf
        length = min(2.0 * length, LARGEST_STEP, max(room, SMALLEST_STEP))
    return Arrival("lost", q, float(q[at]))


def _sigma(s: Array) -> float:
    if len(s) == 1:  # one row is as large as itself; it loses its rank where it vanishes
        return min(float(s[0]), 1.0)
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
    """Locate where the rows lose their rank, just ahead of a point, near q.

    There nothing can be solved: the driver value, and how fast it still changes, are extrapolated
    over the smallest singular value, from places before it. A driver that comes to rest there has
    reached its limit; else branches cross.
    """
    at = curve.driver.q
    start = curve.ahead(point, -2.0 * NEAR_CROSSING)
    base = curve.settle(start, point.t) if start is not None else None
    coarse = _places(curve, base, (0.0, 0.5 * NEAR_CROSSING))
    if base is None or coarse is None:
        return Arrival("branch point", q, float(q[at]))
    first, second = (curve.sigma(x) for x in coarse)
    distance = 0.5 * NEAR_CROSSING * first / (first - second)
    places = _places(curve, base, distance * np.array([0.0, 0.2, 0.4, 0.6, 0.8]))
    if places is None:
        return Arrival("branch point", q, float(q[at]))
    sigma = np.array([curve.sigma(x) for x in places])
    slopes = np.array([curve.slope(curve.direction(x, base.t)[0]) for x in places])
    value = _at_zero(sigma, np.array([x[at] for x in places]))
    rests = abs(_at_zero(sigma, slopes)) < 0.1 * abs(slopes[0])
    return Arrival("limit" if rests else "branch point", q, value)


def _at_zero(x: Array, y: Array) -> float:
    """Return the value at 0 of the polynomial through the points (x, y) [Lagrange]."""
    return float(sum(y[i] * np.prod(np.delete(x, i) / (np.delete(x, i) - x[i]))
                     for i in range(len(x))))


def _place(curve: Curve, point: CurvePoint, x: float) -> Array:
    found = curve.ahead(point, x)
    return point.q.copy() if found is None else found


def _root(function: Callable[[float], float], length: float) -> float:
    from scipy.optimize import brentq  # imported on use: it takes a tenth of a second

    if function(0.0) * function(length) > 0.0:
        return length
    return float(brentq(function, 0.0, length, xtol=1e-14, rtol=1e-14))


def _places(curve: Curve, base: CurvePoint | None, lengths: Iterable[float]) -> list[Array] | None:
    """Return the configurations at several lengths ahead of `base`, if all of them close."""
    places = [] if base is None else [curve.ahead(base, x) for x in lengths]
    found = [place for place in places if place is not None]
    return found if found and len(found) == len(places) else None
