"""Piecewise polynomials of one variable, with all their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

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

    def __call__(self, x: Taylor) -> Taylor:
        """Return the function of a series of arrays, by Horner's rule in the piece it begins in."""
        start = np.asarray(x.values[0], float)
        first, last = self.breaks[0], self.breaks[-1]
        periods = np.floor((start - first) / (last - first)) if self.is_periodic else 0.0 * start
        shift = (last - first) * periods
        inner = self.breaks[1:-1]
        piece = np.searchsorted(inner, start - shift, side="right")
        local = x - (self.breaks[piece] + shift)
        total = local * 0.0 + self.coefficients[piece, -1]
        for k in range(self.coefficients.shape[1] - 2, -1, -1):
            total = total * local + self.coefficients[piece, k]
        return total + self.rise * periods
