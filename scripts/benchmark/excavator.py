"""The excavator of the library: three cylinders along a dig, and the triangles that they span.

A pose is judged without solving for it: the pins' places follow from the angles of boom, arm,
bucket and tipping link, and what is between them must be the cylinders' and the link's lengths.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SECONDS = np.array([0.0, 2.0, 3.5, 5.0, 6.5, 8.0, 10.0])
DIG = {"boom": (2.89, 2.76, 2.70, 2.665, 2.64, 2.70, 3.00),
       "arm": (2.70, 2.67, 2.75, 2.86, 2.985, 3.09, 3.15),
       "bucket": (2.09, 2.09, 2.23, 2.385, 2.54, 2.67, 2.70)}
ANGLES = ("boom_pin", "arm_pin", "bucket_pin", "tipping_pin")
BOOM, ARM, GROUND, TIPPING, CONNECTING = 5.7, 2.925, 0.425, 0.64, 0.62
LUG, LUG_ANGLE = 0.47, np.radians(98.0)


def turned(point: tuple[float, float], angle: Array) -> Array:
    """Return (2, N) a point of a link that is turned by angles (N,)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def judge(angles: Array, lengths: Array) -> dict[str, float]:
    """Return the largest error of a length [m].

    Args:
        angles: (4, N) of ANGLES.
        lengths: (3, N) of the cylinders of boom, arm and bucket.
    """
    boom, arm, bucket, tipping = angles
    zero = np.zeros_like(boom)
    end = turned((TIPPING, 0.0), tipping) + np.array([[ARM - GROUND], [0.03]])  # tipping link's
    lug = turned((LUG, 0.0), bucket + LUG_ANGLE) + np.array([[ARM], [0.0]])
    spans = (turned((2.62, 0.86), boom) - turned((0.58, -0.58), zero),
             turned((-0.87, 0.23), arm) - turned((2.95 - BOOM, 1.32), zero),
             end - turned((0.36, 0.50), zero))
    off = [np.abs(np.hypot(*x) - y).max() for x, y in zip(spans, lengths, strict=True)]
    return {"length": float(max(*off, np.abs(np.hypot(*(end - lug)) - CONNECTING).max()))}
