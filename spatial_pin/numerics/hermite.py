"""Hermite's polynomial of fifth degree, through values and two derivatives at both ends."""

from __future__ import annotations

import numpy as np

from spatial_pin.numerics.linalg import Array

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
