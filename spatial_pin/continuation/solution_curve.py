"""The curve of closed configurations, with its parameter as an unknown; its two parameters.

That is the value of one driver, or a parameter that several go by.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.kernel.paths import Polynomials
from spatial_pin.mechanism.coordinates import coordinate_value
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array, decompose, determinant_sign_of, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES

# Chebyshev points of a smoothed law: as many as nodes on each side of a branch point.
SMOOTH_POINTS = 8

NEAREST_STEPS = 4  # Newton steps: each squares an error below 1e-4


class OneDriver:
    """The first prescribed coordinate is the parameter; the other prescribed ones are at rest.

    Attributes:
        begin: the leading value at the start [rad or m].
        n_moving: how many prescribed coordinates move, the first ones.
    """

    def __init__(self, mechanism: Mechanism, driven: Sequence[Coordinate], q: Array) -> None:
        self.driven = driven
        self._start = np.array([0.0 if isinstance(c, VelocityEntry) else
                                coordinate_value(mechanism, c, q) for c in driven])
        self.begin, self.n_moving = float(self._start[0]), 1

    def values(self, s: float) -> Array:
        """Return the values (k,) of the prescribed coordinates."""
        return np.append(s, self._start[1:])

    def rates(self, s: float) -> Array:
        """Return their derivatives (k,) with respect to the parameter."""
        return np.eye(1, len(self.driven))[0]

    def bends(self, s: float) -> Array:
        """Return their second derivatives (k,)."""
        return np.zeros(len(self.driven))

    def smooth(self, here: float, first: float, last: float) -> Any | None:
        """Return a law that is smooth between two parameters; None if this one is."""
        return None

    def put(self, q: Array, s: float) -> None:
        """Write the values of driven coordinates that are entries of q into it."""
        for c, value in zip(self.driven, self.values(s).tolist(), strict=True):
            if c.q >= 0:
                q[c.q] = value

    def polynomials(self, s: float, still: Sequence[int]) -> Polynomials | None:
        """Return None: the parameter is the driver. See `DriversLaw`."""
        return None

    def curve(self, system: SquareSystem, tolerance: float, pace: float) -> SolutionCurve:
        """Return the curve of a square system's configurations, the parameter as an unknown.

        `pace` is the inverse of what counts as one radian of a law's parameter.
        """
        return SolutionCurve(system, tolerance)


class DriversLaw(OneDriver):
    """The first prescribed coordinates are functions of a parameter; the others are at rest.

    The law is SciPy's piecewise polynomial of the parameter, to the values of those that go first.
    """

    def __init__(
        self, mechanism: Mechanism, driven: Sequence[Coordinate], q: Array, law: Any, begin: float
    ) -> None:
        from scipy.interpolate import PPoly  # on use: it takes a tenth of a second

        super().__init__(mechanism, driven, q)
        self.begin, self.n_moving = begin, law.c.shape[-1]
        n = self.n_moving
        c = np.zeros((*law.c.shape[:2], len(driven)))
        c[..., :n], c[-1, :, n:] = law.c, self._start[n:]
        self.law = PPoly(c, law.x)
        self._rates, self._bends = self.law.derivative(), self.law.derivative(2)
        self._standing = {c.v: float(q[c.q]) for c in mechanism.coordinate_table.values()
                          if c.q >= 0}

    def values(self, s: float) -> Array:
        """Return the values (k,) of the prescribed coordinates."""
        return self.law(s)

    def rates(self, s: float) -> Array:
        """Return their derivatives (k,) with respect to the parameter."""
        return self._rates(s)

    def bends(self, s: float) -> Array:
        """Return their second derivatives (k,)."""
        return self._bends(s)

    def smooth(self, here: float, first: float, last: float) -> Any:
        """Return one polynomial for the law between two parameters, the same `here`.

        Returns:
            SciPy's piecewise polynomial, of one piece, of what moves.
        """
        from scipy.interpolate import PPoly

        low, width = min(first, last), abs(last - first)
        parts = 0.5 - 0.5 * np.cos(np.pi * np.arange(SMOOTH_POINTS) / (SMOOTH_POINTS - 1))
        values = self.law(low + width * parts)[:, : self.n_moving]
        c = np.linalg.solve(np.vander(parts), values)
        c /= width ** np.arange(SMOOTH_POINTS - 1.0, -1.0, -1.0)[:, None]
        smoothed = PPoly(c[:, None, :], [low, low + width])
        smoothed.c[-1] += self.law(here)[: self.n_moving] - smoothed(here)
        return smoothed

    def polynomials(self, s: float, still: Sequence[int]) -> Polynomials | None:
        """Return the law for a path of the kernel that starts at a parameter.

        Coordinates in the entries `still` of the velocity vector have values that do not change.
        """
        coefficients = np.moveaxis(self.law.c[::-1], 0, 2)
        n, _, powers = coefficients.shape
        all_driven = np.zeros((n, len(self.driven) + len(still), powers))
        all_driven[:, : len(self.driven)] = coefficients
        all_driven[:, len(self.driven) :, 0] = [self._standing.get(v, 0.0) for v in still]
        return Polynomials(s, self.law.x, all_driven)

    def curve(self, system: SquareSystem, tolerance: float, pace: float) -> SolutionCurve:
        """Return the curve with the parameter as an unknown; see `OneDriver`."""
        span = float(self.law.x[-1] - self.law.x[0])
        return LawCurve(system, tolerance, self, 1.0 / max(pace, 1.0 / span))


def nearest(law: OneDriver, other: OneDriver, s: float) -> float:
    """Return the parameter at which a law is nearest to another law's values at s.

    It is farther off sideways, if at all, in what several drivers do.
    """
    if law is other:
        return s
    k, s_near = law.n_moving, s
    goal = other.values(s)[:k]
    for _ in range(NEAREST_STEPS):
        rates = law.rates(s_near)[:k]
        s_near += float((goal - law.values(s_near)[:k]) @ rates / (rates @ rates))
    return s_near


class CurvePoint(NamedTuple):
    """A closed configuration of the curve.

    Attributes:
        x: (n,) unknowns, which hold the configuration.
        t: (m,) scaled unit tangent.
        sign: sign of the determinant of [independent equations; tangent].
        sigma: smallest over largest singular value of the independent equations.
        angles, slopes: relative angles of screw closures, and their scaled derivatives.
    """

    x: Array
    t: Array
    sign: int
    sigma: float
    angles: Array
    slopes: Array


class SolutionCurve:
    """The curve of closed configurations through a point, the first driver free.

    Its unknowns x are configurations; of a `LawCurve` the parameter of a law besides.

    Attributes:
        system: has all that is driven, at a configuration of the curve.
        tolerance: residual to which points are closed.
        scale: (m,) change of a unit of each unknown's velocity.
        at, rate: indices of the parameter in x, and of its rate in tangents.
        selected: the independent closure equations.
    """

    def __init__(self, system: SquareSystem, tolerance: float) -> None:
        self.system, self.evaluation, self.tolerance = system, system.evaluation, tolerance
        self.selected, self.model = system.equations, system.evaluation.model
        self.scale, self._drive = system.scale, system.drive[1:]
        self.at, self.rate = system.driven[0].q, system.driven[0].v

    # ------------------------------------------------------------ unknowns

    def unknowns(self, q: Array, s: float) -> Array:
        """Return the unknowns at a configuration and a parameter, which q has already."""
        return q

    def configuration(self, x: Array) -> Array:
        """Return the configuration (nq,)."""
        return x

    def put(self, x: Array, s: float) -> None:
        """Set the prescribed coordinates to their values at a parameter, the new one of x."""
        x[self.at] = s

    def tangent(self, t: Array) -> Array:
        """Return the scaled tangent of the derivative (nv,) with respect to the parameter."""
        return t / self.scale

    def moved(self, x: Array, step: Array) -> Array:
        """Return the unknowns after a scaled step."""
        return pin.integrate(self.model, x, self.scale * step)

    def apart(self, x: Array, y: Array) -> Array:
        """Return the scaled step from unknowns to others."""
        return pin.difference(self.model, x, y) / self.scale

    def normalized(self, x: Array) -> Array:
        """Return the unknowns with quaternions of unit length."""
        return pin.normalize(self.model, x)

    def value(self, x: Array) -> float:
        """Return the parameter: a driver's value, or that of a law."""
        return float(x[self.at])

    def slope(self, t: Array) -> float:
        """Return the rate of the parameter along the scaled tangent."""
        return float(t[self.rate] * self.scale[self.rate])

    # ------------------------------------------------------------ equations

    def equations(self, x: Array) -> Array:
        """Return the (m - 1, m) independent equations' derivatives of the curve at x."""
        self.evaluation.update(self.configuration(x))
        jacobian, n = self.evaluation.jacobian, self.evaluation.constraints.n_closure
        return np.vstack([jacobian[self.selected], jacobian[n:], self._drive, self.system.passive])

    def gaps(self, x: Array) -> Array:
        """Return the errors of prescribed coordinates, relative to their sizes."""
        return np.empty(0)

    @property
    def first_driven(self) -> int:
        """The row of the equations at which those of prescribed coordinates begin."""
        return len(self.selected) + self.evaluation.constraints.n_passive

    # ------------------------------------------------------------ points

    def settle(self, x: Array, along: Array) -> CurvePoint | None:
        """Return the point at x whose tangent is nearest to `along`; None where branches cross."""
        rows = self.equations(x)
        if self.system.has_redundant_equations:
            n = self.evaluation.constraints.n_closure
            selected = independent_rows(self.evaluation.jacobian[:n], TOLERANCES.singular)
            if len(selected) < len(self.system.equations):
                return None
            self.selected = selected
            rows = self.equations(x)
        svd = decompose(rows, TOLERANCES.singular)
        if svd.rank < len(rows) or _ratio(svd.s, self.system.size) <= TOLERANCES.singular:
            return None
        return self.point(x, svd.null_space.T @ (svd.null_space @ along), rows, svd.s)

    def point(
        self, x: Array, t: Array, rows: Array | None = None, s: Array | None = None
    ) -> CurvePoint:
        """Return the point at x with a given tangent; rows and their singular values if known."""
        rows = self.equations(x) if rows is None else rows
        s = decompose(rows, 0.0).s if s is None else s
        t = t / np.linalg.norm(t)
        evaluation, sign = self.evaluation, determinant_sign_of(np.vstack([rows, t]))
        return CurvePoint(x, t, sign, _ratio(s, self.system.size),
                          evaluation.angles.copy(), evaluation.angle_jacobian.copy())

    def ahead(self, point: CurvePoint, length: float) -> Array | None:
        """Return the closed configuration `length` ahead along the tangent."""
        step = length * point.t
        self.expect(point, step)
        return self.onto(self.moved(point.x, step), point.t)

    def expect(self, point: CurvePoint, step: Array) -> None:
        """Set the expected relative angles of screw closures after a scaled step."""
        self.evaluation.angle_reference[:] = (
            point.angles + point.slopes @ step[: point.slopes.shape[1]])

    def onto(self, x: Array, normal: Array) -> Array | None:
        """Return the closed configuration near x in the plane through it with a scaled normal."""
        for _ in range(8):
            rows = self.equations(x)
            residual, gaps = self.evaluation.residual, self.gaps(x)
            square = residual @ residual + gaps @ gaps
            if square <= self.tolerance**2:
                return x
            rhs = np.zeros(len(rows) + 1)
            rhs[: len(self.selected)] = -residual[self.selected]
            rhs[self.first_driven : self.first_driven + len(gaps)] = -gaps
            step = decompose(np.vstack([rows, normal])).minimum_norm(rhs)
            if not np.abs(step).max() < 0.1:
                return None
            x = self.moved(x, step)
        return x if square <= TOLERANCES.closed**2 else None

    def direction(self, x: Array, along: Array) -> tuple[Array, int]:
        """Return tangent and determinant sign at x with the rows of the last `settle`."""
        rows = self.equations(x)
        null_space = decompose(rows, TOLERANCES.tight).null_space
        t = null_space.T @ (null_space @ along)
        t /= np.linalg.norm(t)
        return t, determinant_sign_of(np.vstack([rows, t]))

    def sigma(self, x: Array) -> float:
        """Return the smallest over the largest singular value of the rows at x.

        The largest counts as no smaller than rows were elsewhere: where a single one vanishes, it
        is as large as itself to the end.
        """
        return _ratio(decompose(self.equations(x), 0.0).s, self.system.size)


class LawCurve(SolutionCurve):
    """The curve through a point where drivers go by a law, whose parameter is the last unknown.

    `unit` is the change of the parameter that counts as one radian.
    """

    def __init__(
        self, system: SquareSystem, tolerance: float, law: DriversLaw, unit: float
    ) -> None:
        super().__init__(system, tolerance)
        self.law, self._unit, self.at, self.rate = law, unit, -1, -1
        self.scale, self._drive = np.append(system.scale, unit), system.drive
        self._indices = [c.q for c in system.driven]
        self._sizes = np.array([system.scale[c.v] for c in system.driven])

    def unknowns(self, q: Array, s: float) -> Array:
        """Return the unknowns at a configuration and a parameter."""
        return np.append(q, s)

    def configuration(self, x: Array) -> Array:
        """Return the configuration (nq,)."""
        return x[:-1]

    def put(self, x: Array, s: float) -> None:
        """Set the prescribed coordinates to their values at a parameter, the new one of x."""
        self.law.put(x[:-1], s)
        x[-1] = s

    def tangent(self, t: Array) -> Array:
        """Return the scaled tangent of the derivative (nv,) with respect to the parameter."""
        return np.append(t, 1.0) / self.scale

    def moved(self, x: Array, step: Array) -> Array:
        """Return the unknowns after a scaled step."""
        step = self.scale * step
        return np.append(pin.integrate(self.model, x[:-1], step[:-1]), x[-1] + step[-1])

    def apart(self, x: Array, y: Array) -> Array:
        """Return the scaled step from unknowns to others."""
        return np.append(pin.difference(self.model, x[:-1], y[:-1]), y[-1] - x[-1]) / self.scale

    def normalized(self, x: Array) -> Array:
        """Return the unknowns with quaternions of unit length."""
        return np.append(pin.normalize(self.model, x[:-1]), x[-1])

    def equations(self, x: Array) -> Array:
        """Return the (m - 1, m) independent equations' derivatives of the curve at x."""
        rows, first = super().equations(x), self.first_driven
        extended = np.column_stack([rows, np.zeros(len(rows))])
        extended[first : first + len(self._sizes), -1] = (
            -self._unit * self.law.rates(float(x[-1])) / self._sizes)
        return extended

    def gaps(self, x: Array) -> Array:
        """Return the errors of prescribed coordinates, relative to their sizes."""
        return (x[self._indices] - self.law.values(float(x[-1]))) / self._sizes


def _ratio(s: Array, size: float) -> float:
    """Return the least of singular values (n,) over the largest, or over `size` if that is more."""
    return float(s[-1] / np.hypot(s[0], size)) if s.size else 1.0


def matrices(curve: SolutionCurve, points: Iterable[tuple[Array, Array]]) -> Array:
    """Return matrices (k, m, m) of [independent equations; unit tangent] at points (x, t).

    Smooth functions of the place, singular where branches cross.
    """
    return np.array([np.vstack([curve.equations(x), t / np.linalg.norm(t)]) for x, t in points])
