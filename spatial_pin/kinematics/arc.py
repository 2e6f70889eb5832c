"""Following closed configurations by arc length, where the driver is no parameter any more."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq

from spatial_pin.kinematics.newton import SquareSystem, close
from spatial_pin.linalg import Array, decompose, determinant_sign_of

FIRST_STEP = 1e-3  # rad or characteristic lengths
LARGEST_STEP = 0.1
SMALLEST_STEP = 1e-9
STRAIGHT = 0.98  # least cosine between the directions at the two ends of a step
MOST_STEPS = 2000


class Arrival(NamedTuple):
    """Where a march ended.

    Attributes:
        kind: "reached", "limit", "branch point", "singular" or "lost".
        q: (nq,) the configuration.
        value: the driver value there [rad or m].
    """

    kind: str
    q: Array
    value: float


class _Curve:
    """The curve of closed configurations through a point, the first driver set free."""

    def __init__(self, system: SquareSystem, tolerance: float) -> None:
        self.system, self.evaluation = system, system.evaluation
        self.model = system.evaluation.model
        self.scale = system.evaluation.mechanism.velocity_scale
        self.tolerance = tolerance
        self.driver = system.driven[0]

    def rows(self, q: Array) -> Array:
        """Return the (nv - 1, nv) scaled regular rows of the curve at q."""
        self.evaluation.update(q)
        jacobian, n = self.evaluation.jacobian, self.evaluation.constraints.n_rows
        drive = self.system.matrix[self.system._drivers][1:]
        parts = [jacobian[self.system.rows], jacobian[n:], drive / self.scale, self.system.passive]
        return np.vstack(parts) * self.scale

    def tangent(self, q: Array, along: Array) -> tuple[Array, int]:
        """Return the scaled unit tangent nearest to `along`, and the sign of [rows; tangent]."""
        rows = self.rows(q)
        null_space = decompose(rows).null_space
        t = null_space.T @ (null_space @ along)
        t /= np.linalg.norm(t)
        return t, determinant_sign_of(np.vstack([rows, t])) if len(null_space) == 1 else 0

    def correct(self, q: Array, t: Array) -> Array | None:
        """Close the loops from q by steps normal to the scaled tangent t."""
        for _ in range(8):
            rows = self.rows(q)
            residual = self.evaluation.residual
            if residual @ residual <= max(self.tolerance, 1e-14) ** 2:
                return q
            rhs = np.zeros(len(rows) + 1)
            rhs[: len(self.system.rows)] = -residual[self.system.rows]
            x = decompose(np.vstack([rows, t])).minimum_norm(rhs)
            if not np.abs(x).max() < 0.1:
                return None
            q = pin.integrate(self.model, q, self.scale * x)
        return q if residual @ residual <= 1e-22 else None

    def at(self, q: Array, t: Array, length: float) -> Array | None:
        """Return the closed configuration `length` ahead of q along t."""
        return self.correct(pin.integrate(self.model, q, self.scale * (length * t)), t)

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
    curve = _Curve(system, tolerance)
    at = curve.driver.q
    heading = np.sign(target - q[at])
    t, sign = curve.tangent(q, heading * direction / curve.scale)
    length = FIRST_STEP
    for _ in range(MOST_STEPS):
        if sign == 0:
            return Arrival("singular", q, float(q[at]))
        ahead = curve.at(q, t, length)
        t_ahead, sign_ahead = curve.tangent(ahead, t) if ahead is not None else (t, 0)
        if ahead is None or t_ahead @ t < STRAIGHT or sign_ahead != sign:
            length *= 0.5
            if length < SMALLEST_STEP:
                crossed = ahead is not None and sign_ahead != sign
                return Arrival("branch point" if crossed else "lost", q, float(q[at]))
            continue
        if heading * (ahead[at] - target) >= 0.0:
            return _arrive(curve, q, t, length, target)
        if heading * curve.slope(t_ahead) <= 0.0:
            turning = _turning_point(curve, q, t, length)
            limit = _point(curve, q, t, turning)
            if heading * (limit[at] - target) >= 0.0:
                return _arrive(curve, q, t, turning, target)
            return Arrival("limit", limit, float(limit[at]))
        q, t = ahead, t_ahead
        length = min(2.0 * length, LARGEST_STEP)
    return Arrival("lost", q, float(q[at]))


def _turning_point(curve: _Curve, q: Array, t: Array, length: float) -> float:
    """Return the length, at most `length`, after which the driver turns back."""

    def slope(x: float) -> float:
        ahead = curve.at(q, t, x)
        return curve.slope(curve.tangent(ahead, t)[0]) if ahead is not None else np.nan

    return _root(slope, length)


def _arrive(curve: _Curve, q: Array, t: Array, length: float, target: float) -> Arrival:
    """Return the configuration at the target value, reached within `length` of q."""
    at = curve.driver.q

    def gap(x: float) -> float:
        return float(_point(curve, q, t, x)[at]) - target

    ahead = _point(curve, q, t, _root(gap, length))
    ahead[at] = target
    free = np.ones(curve.model.nv, dtype=bool)
    free[[c.v for c in curve.system.driven]] = False
    ahead, error = close(curve.evaluation, ahead, free, curve.tolerance)
    return Arrival("reached" if error <= 1e-11 else "lost", ahead, target)


def _point(curve: _Curve, q: Array, t: Array, x: float) -> Array:
    found = curve.at(q, t, x)
    return q if found is None else found


def _root(function: Callable[[float], float], length: float) -> float:
    if function(0.0) * function(length) > 0.0:
        return length
    return float(brentq(function, 0.0, length, xtol=1e-14, rtol=1e-14))
