"""Functions of one variable with their derivatives: piecewise polynomials, roots, code."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor


@dataclass(frozen=True, eq=False)
class Piecewise:
    """A piecewise polynomial; its end pieces continue beyond its ends, or it repeats.

    Attributes:
        breaks: (n + 1,) where pieces begin and end, ascending.
        coefficients: (n, degree + 1) ascending powers of x less the break that a piece begins at.
        is_periodic: whether it repeats with the period from the first to the last break.
        rise: what it gains with every period.
    """

    breaks: Array
    coefficients: Array
    is_periodic: bool = False
    rise: float = 0.0

    def __call__(self, x: Taylor, within: Array | None = None) -> Taylor:
        """Return the function of a series of arrays, in the pieces it begins in.

        Or in those that other places are within. Horner's rule gives the polynomials about where
        the series begin, and, of these polynomials, what the rest of the series adds.
        """
        start = np.asarray(x.values[0] if within is None else within, float)
        first, last = self.breaks[0], self.breaks[-1]
        periods = np.floor((start - first) / (last - first)) if self.is_periodic else 0.0 * start
        shift = (last - first) * periods
        inner = self.breaks[1:-1]
        piece = np.searchsorted(inner, start - shift, side="right")
        at = x.values[0] - (self.breaks[piece] + shift)
        order = len(x.values) - 1 + bool(x.changes)
        about = [self.coefficients[piece, -1], *[0.0] * order]
        for k in range(self.coefficients.shape[1] - 2, -1, -1):
            for i in range(order, 0, -1):
                about[i] = about[i] * at + about[i - 1]
            about[0] = about[0] * at + self.coefficients[piece, k]
        rest = Taylor([0.0 * at, *x.values[1:]], x.changes)
        total = rest * 0.0 + about[order]
        for k in range(order - 1, -1, -1):
            total = total * rest + about[k]
        return total + self.rise * periods

    def derivative(self) -> Piecewise:
        """Return its derivative."""
        powers = np.arange(1, self.coefficients.shape[1])
        slopes = self.coefficients[:, 1:] * powers if len(powers) else np.zeros_like(
            self.coefficients)
        return Piecewise(self.breaks, np.ascontiguousarray(slopes), self.is_periodic)

    def of_scaled(self, scale: float) -> Piecewise:
        """Return the same function of scale times x."""
        powers = scale ** -np.arange(self.coefficients.shape[1], dtype=float)
        return Piecewise(self.breaks * scale, self.coefficients * powers, self.is_periodic,
                         self.rise)


def composed(x: Taylor, start: Array, derivatives: Sequence[Any]) -> Taylor:
    """Return a function of a series from its derivatives 0, 1, ... near where it starts."""
    rest, power = x - start, None
    total = 0.0 * rest + derivatives[0]
    for k, derivative in enumerate(derivatives[1:], start=1):
        power = rest if power is None else power * rest
        total = total + power * (derivative / math.factorial(k))
    return total


class SquareRoot:
    """The square root of a positive function."""

    def __call__(self, x: Taylor) -> Taylor:
        """Return the square root of a series of arrays."""
        start = np.asarray(x.values[0])
        root = np.sqrt(start)
        return composed(x, start, [root, 0.5 / root, -0.25 / root**3, 0.375 / root**5,
                            -0.9375 / root**7])


@dataclass(frozen=True, eq=False)
class CalledFunction:
    """A function in code: x -> value and first three derivatives.

    Attributes:
        function: of a number; where it fails its values are NaN, and nothing closes there.
    """

    function: Callable[[float], Sequence[float]]

    def __call__(self, x: Taylor) -> Taylor:
        """Return the function of a series of arrays."""
        start = np.asarray(x.values[0], float)
        rows = np.array([self.function(float(at)) for at in start.ravel()]).reshape(-1, 4).T
        return composed(x, start, [row.reshape(start.shape) for row in rows])

    @cached_property
    def callback(self) -> Any:
        """What C calls: x, and where to write the value and two derivatives."""
        def call(x: float, out: Any) -> None:
            try:
                out[0], out[1], out[2], _ = self.function(x)
            except Exception:  # which C cannot hand on
                out[0] = out[1] = out[2] = math.nan

        return CALLBACK(call)

    @property
    def address(self) -> int:
        """Where C finds it, while this object exists."""
        return ctypes.cast(self.callback, ctypes.c_void_p).value or 0

    def __getstate__(self) -> dict[str, Any]:
        """Return the content to copy or to send elsewhere: all but the address."""
        return {"function": self.function}


ROOT = SquareRoot()
CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.POINTER(ctypes.c_double))
Function = Piecewise | SquareRoot | CalledFunction


def quintic_spline(x: Array, y: Array, is_periodic: bool = False) -> Piecewise:
    """Return the spline of degree 5 through points: its first four derivatives are continuous.

    Fewer than six points have the polynomial through them.

    Args:
        x: (n,) rising.
        y: (n,) values; of a periodic spline the last is the first.
        is_periodic: whether it repeats with the period from the first to the last x.
    """
    from scipy.interpolate import PPoly, make_interp_spline  # imported on use: it takes a while

    if not is_periodic:
        spline = make_interp_spline(x, y, k=min(5, len(x) - 1))
        repeats = 0
    else:  # of several periods the spline is that of one, and there are points enough
        repeats = max(1, -(-6 // (len(x) - 1)))
        repeats += repeats % 2 == 0
        period = x[-1] - x[0]
        knots = [x[:-1] + (k - repeats // 2) * period for k in range(repeats)]
        knots.append(x[:1] + (repeats - repeats // 2) * period)
        values = np.concatenate([*[y[:-1]] * repeats, y[:1]])
        spline = make_interp_spline(np.concatenate(knots), values, k=5, bc_type="periodic")
    pieces = PPoly.from_spline(spline)
    begin = int(np.searchsorted(pieces.x, 0.5 * (x[0] + x[1]), side="right")) - 1
    end = int(np.searchsorted(pieces.x, 0.5 * (x[-2] + x[-1]), side="right"))
    breaks = pieces.x[begin : end + 1].copy()
    breaks[0], breaks[-1] = x[0], x[-1]
    return Piecewise(breaks, np.ascontiguousarray(pieces.c[::-1, begin:end].T), is_periodic)


Ends = Array | tuple[Array, Array]


def quintic(value: Ends, slope: Ends, bend: Ends) -> Array:
    """Return coefficients (6, ...) of the polynomial of fifth degree between two places, 0 and 1.

    Args:
        value: (2, ...) at both places.
        slope: (2, ...) first derivatives, with respect to the part of the way between them.
        bend: (2, ...) second ones.

    Returns:
        Factors of the powers of the part, the constant first.
    """
    first, half = slope[0], 0.5 * bend[0]
    # what the terms up to the second leave open at the far end: of value, slope, second derivative
    d = value[1] - value[0] - first - half
    e = slope[1] - first - bend[0]
    f = bend[1] - bend[0]
    return np.array([value[0], first, half, 10.0 * d - 4.0 * e + 0.5 * f,
                     7.0 * e - 15.0 * d - f, 6.0 * d - 3.0 * e + 0.5 * f])
