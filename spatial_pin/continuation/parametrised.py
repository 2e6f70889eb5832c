"""Where a path of several drivers that depend on one parameter ends.

The kernel follows the path over the parameter. Where it stops, the curve of configuration and
parameter together is followed by pseudo-arclength, to where the parameter turns back, or the loops
lose rank, or over a hard stretch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.continuation.pseudo_arclength import Arrival
from spatial_pin.numerics.linalg import Array, decompose, determinant_sign_of
from spatial_pin.numerics.tolerances import TOLERANCES

FIRST_WAY = 1e-4  # rad, characteristic lengths: the kernel's last steps are smaller still
LARGEST_STEP = 0.1  # the same: where the path is smooth the kernel takes over again
SMALLEST_STEP = 1e-9  # where shorter ones fail too, the curve ends
STRAIGHT = 0.98  # least cosine between the directions at both ends of a step
CURVE_STEPS = 500  # fifty radians of the longest: what is longer is not one hard stretch
CLEAR_OF_CROSSING = 1e-3  # of a branch point: less loses digits to round-off, more to interpolation
CLEAR = 0.2  # arc length behind a hard stretch, from which the kernel goes on


class Point(NamedTuple):
    """A point of the curve.

    Attributes:
        q: (nq,) configuration.
        s: the parameter.
        t: (nv + 1,) unit tangent, scaled velocities first.
        sign: of the determinant of the equations with the tangent: it changes at a branch point.
    """

    q: Array
    s: float
    t: Array
    sign: int


class DrivenCurve:
    """The curve of closed configurations and the parameter that drivers go by.

    Args:
        system: the square system of all that is driven, chosen at a configuration of the curve.
        law: piecewise polynomial of the parameter: values (k,) of the driven coordinates, the
            first of them; what is driven besides stands at its last.
        unit: of the parameter: change that counts as one radian.
    """

    def __init__(self, system: SquareSystem, law: Any, unit: float) -> None:
        self.system, self.law, self.rate, self.unit = system, law, law.derivative(), unit
        self.evaluation, self.model = system.evaluation, system.evaluation.model
        self.scale = system.scale
        self.places = [c.q for c in system.driven]
        self.sizes = np.array([system.scale[c.v] for c in system.driven])

    def _equations(self, q: Array, s: float) -> tuple[Array, Array]:
        """Return residual (nv,) and derivative (nv, nv + 1)."""
        self.evaluation.update(q)
        self.system.factor()
        n = len(self.scale)
        derivative, residual = np.zeros((n, n + 1)), np.zeros(n)
        derivative[:, :n] = self.system.matrix
        first = self.system.prescribed_rows.start
        drivers = slice(first, first + len(self.places))
        derivative[drivers, n] = -self.unit * self.rate(s) / self.sizes
        residual[drivers] = (q[self.places] - self.law(s)) / self.sizes
        residual[self.system.closure_rows] = self.evaluation.residual[self.system.rows]
        return residual, derivative

    def point(self, q: Array, s: float, along: Array | None) -> Point | None:
        """Return the point at a configuration, its tangent nearest to `along`; None if singular."""
        derivative = self._equations(q, s)[1]
        svd = decompose(derivative, TOLERANCES.singular)
        if svd.rank < len(self.scale):
            return None
        t = svd.null_space[0]
        if along is not None and t @ along < 0.0:
            t = -t
        return Point(q, s, t, determinant_sign_of(np.vstack([derivative, t])))

    def ahead(self, point: Point, length: float) -> Point | None:
        """Return the point a length ahead; None if there is none near the tangent."""
        step = length * point.t
        q, s = pin.integrate(self.model, point.q, self.scale * step[:-1]), (
            point.s + self.unit * step[-1])
        last = np.inf
        for _ in range(8):
            residual, derivative = self._equations(q, s)
            size = float(np.abs(residual).max())
            if size <= TOLERANCES.last_digit or (size <= TOLERANCES.closed and size > 0.5 * last):
                return self.point(q, s, point.t)
            last = size
            x = decompose(np.vstack([derivative, point.t])).minimum_norm(
                np.append(-residual, 0.0))
            if not np.abs(x).max() < TOLERANCES.unexplained:
                return None
            q, s = pin.integrate(self.model, q, self.scale * x[:-1]), s + self.unit * x[-1]
        return None

    def towards(self, q: Array, s: float, target: float) -> Arrival:
        """Follow the curve from a point on, as the parameter rises, towards a value of it.

        Returns:
            "reached": well behind a hard stretch, or at the target; "limit": where the parameter
            turns back; "branch point": where the loops lose rank; or "lost".
        """
        point = self.point(q, s, np.append(np.zeros(len(self.scale)), 1.0))
        if point is None:
            return Arrival("singular", q, s)
        length, gone = FIRST_WAY, 0.0
        for _ in range(CURVE_STEPS):
            there = self.ahead(point, length)
            if there is None or there.t @ point.t < STRAIGHT:
                length *= 0.5
                if length < SMALLEST_STEP:
                    return self._crossing_or(point, "lost")
                continue
            if there.sign != point.sign:
                if length > FIRST_WAY:
                    length *= 0.5
                    continue
                return self._crossing_or(point, "branch point")
            if there.t[-1] <= 0.0:
                limit = self._where(point, length, lambda p: float(p.t[-1]))
                return Arrival("limit", limit.q, limit.s)
            gone += length
            if there.s >= target:
                end = self._where(point, length, lambda p: p.s - target)
                return Arrival("reached", end.q, target)
            if gone > CLEAR and length == LARGEST_STEP:
                return Arrival("reached", there.q, there.s)
            point, length = there, min(2.0 * length, LARGEST_STEP)
        return Arrival("lost", point.q, point.s)

    def _crossing_or(self, point: Point, kind: str) -> Arrival:
        """Return the branch point beside a point, or that the curve ends there as of a kind."""
        s = self._crossing(point)
        if s is None:
            return Arrival(kind, point.q, point.s)
        return Arrival("branch point", point.q, s)

    def _crossing(self, point: Point) -> float | None:
        """Return the parameter of a branch point beside a point; None if there is none.

        There the least singular value of the equations with the tangent, with the determinant's
        sign, passes zero. Two points on either side, all clear of it, tell where.
        """
        back = self.ahead(point._replace(t=-point.t), CLEAR_OF_CROSSING)
        first = back and self.ahead(back, CLEAR_OF_CROSSING)
        here = back and self.point(back.q, back.s, point.t)
        there = here and self.ahead(here, 2.0 * CLEAR_OF_CROSSING)
        last = there and self.ahead(there, CLEAR_OF_CROSSING)
        if first is None or here is None or there is None or last is None:
            return None
        if there.sign == here.sign or there.t @ here.t < STRAIGHT:
            return None
        sides = [here.sign * self._least(p) for p in (first, here)] + [
            there.sign * self._least(p) for p in (there, last)]
        if not np.all(np.diff(sides) * here.sign < 0.0):
            return None
        from scipy.interpolate import BarycentricInterpolator  # on use, as in `_where`

        return float(BarycentricInterpolator(sides, [first.s, here.s, there.s, last.s])(0.0))

    def _least(self, point: Point) -> float:
        """Return the least singular value of the equations with the tangent."""
        matrix = np.vstack([self._equations(point.q, point.s)[1], point.t])
        return float(decompose(matrix).s[-1])

    def _where(self, point: Point, length: float, zero: Any) -> Point:
        """Return the point, within a length ahead, where a function of points is zero."""
        from scipy.optimize import brentq  # imported on use: it takes a tenth of a second

        def at(x: float) -> Point:
            found = self.ahead(point, x)
            return point if found is None else found

        return at(float(brentq(lambda x: zero(at(x)), 0.0, length, xtol=1e-14, rtol=1e-14)))
