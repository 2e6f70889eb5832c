"""The curve of closed configurations, its one driver set free."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.numerics.linalg import Array, decompose, determinant_sign_of, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES


class CurvePoint(NamedTuple):
    """A closed configuration of the curve.

    Attributes:
        q: (nq,) configuration.
        t: (nv,) scaled unit tangent.
        sign: sign of the determinant of [independent equations; tangent].
        sigma: smallest over largest singular value of the independent equations.
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
        self.drive = system.matrix[system.prescribed_rows][1:]
        self.selected = system.rows

    def equations(self, q: Array) -> Array:
        """Return the (nv - 1, nv) independent equations' derivatives of the curve at q."""
        self.evaluation.update(q)
        jacobian, n = self.evaluation.jacobian, self.evaluation.constraints.n_rows
        parts = [jacobian[self.selected], jacobian[n:], self.drive, self.system.passive]
        return np.vstack(parts)

    def settle(self, q: Array, along: Array) -> CurvePoint | None:
        """Return the point at q whose tangent is nearest to `along`; None where branches cross."""
        rows = self.equations(q)
        if self.system.has_redundant_rows:
            n = self.evaluation.constraints.n_rows
            selected = independent_rows(self.evaluation.jacobian[:n], TOLERANCES.singular)
            if len(selected) < len(self.system.rows):
                return None
            self.selected = selected
            rows = self.equations(q)
        svd = decompose(rows, TOLERANCES.singular)
        if svd.rank < len(rows) or self._sigma(svd.s) <= TOLERANCES.singular:
            return None
        return self.point(q, svd.null_space.T @ (svd.null_space @ along), rows, svd.s)

    def point(
        self, q: Array, t: Array, rows: Array | None = None, s: Array | None = None
    ) -> CurvePoint:
        """Return the point at q with a given tangent; rows and their singular values if known."""
        rows = self.equations(q) if rows is None else rows
        s = decompose(rows, 0.0).s if s is None else s
        t = t / np.linalg.norm(t)
        evaluation = self.evaluation
        return CurvePoint(q, t, determinant_sign_of(np.vstack([rows, t])), self._sigma(s),
                          evaluation.angles.copy(), evaluation.angle_jacobian.copy())

    def ahead(self, point: CurvePoint, length: float) -> Array | None:
        """Return the closed configuration `length` ahead along the tangent."""
        step = length * point.t
        self.evaluation.turns[:] = point.angles + point.slopes @ step
        return self.onto(pin.integrate(self.model, point.q, self.scale * step), point.t)

    def onto(self, q: Array, normal: Array) -> Array | None:
        """Return the closed configuration near q in the plane through it with a scaled normal."""
        for _ in range(8):
            rows = self.equations(q)
            residual = self.evaluation.residual
            if residual @ residual <= self.tolerance**2:
                return q
            rhs = np.zeros(len(rows) + 1)
            rhs[: len(self.selected)] = -residual[self.selected]
            x = decompose(np.vstack([rows, normal])).minimum_norm(rhs)
            if not np.abs(x).max() < 0.1:
                return None
            q = pin.integrate(self.model, q, self.scale * x)
        return q if residual @ residual <= TOLERANCES.closed**2 else None

    def direction(self, q: Array, along: Array) -> tuple[Array, int]:
        """Return tangent and determinant sign at q with the rows of the last `settle`."""
        rows = self.equations(q)
        null_space = decompose(rows, TOLERANCES.tight).null_space
        t = null_space.T @ (null_space @ along)
        t /= np.linalg.norm(t)
        return t, determinant_sign_of(np.vstack([rows, t]))

    def sigma(self, q: Array) -> float:
        """Return the smallest over the largest singular value of the rows at q.

        The largest counts as no smaller than rows were elsewhere: where a single one vanishes, it
        is as large as itself to the end.
        """
        return self._sigma(decompose(self.equations(q), 0.0).s)

    def _sigma(self, s: Array) -> float:
        return float(s[-1] / np.hypot(s[0], self.system.size)) if s.size else 1.0

    def matrices(self, places: Iterable[tuple[Array, Array]]) -> Array:
        """Return matrices (k, nv, nv) of [independent equations; unit tangent] at places (q, t).

        Smooth functions of the place, singular where branches cross.
        """
        return np.array([np.vstack([self.equations(q), t / np.linalg.norm(t)]) for q, t in places])

    def curvature(self, point: CurvePoint) -> Array:
        """Return d²q/d(arc)² (nv,) at a point; the evaluation is left there."""
        rows = self.equations(point.q)
        n = self.evaluation.constraints.n_rows
        bias = self.evaluation.bias(point.q, self.scale * point.t)
        rhs = np.zeros(len(rows) + 1)
        rhs[: len(self.selected)] = -bias[:n][self.selected]
        rhs[len(self.selected) : len(self.selected) + len(bias) - n] = -bias[n:]
        return self.scale * decompose(np.vstack([rows, point.t])).minimum_norm(rhs)

    def slope(self, t: Array) -> float:
        """Rate of the driver along the scaled tangent."""
        return float(t[self.driver.v] * self.scale[self.driver.v])
