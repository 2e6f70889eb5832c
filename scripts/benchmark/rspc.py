"""The RSPC four-bar of the library, and its closed form (Pham and Nguyen, section III).

The ball B of the rod goes on the crank's circle; the rod slides in a link that turns about and
slides along the guide y = D, z = 0.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

H, ALPHA, D, L1, L2, A = 0.30, math.radians(60.0), 0.25, 0.10, 0.20, 0.15
SPEED = 25.13  # of the crank [rad/s]
COORDINATES = ("guide.angle", "guide.slide", "slide")


def angles(steps: int) -> Array:
    """Return (steps,) crank angles of one turn [rad]."""
    return np.linspace(0.0, 2.0 * np.pi, steps + 1)[:-1]


def exact(phi: Array, speed: float) -> Array:
    """Return (3, 3, N): value, rate and acceleration of each of COORDINATES."""
    s, c, w = L1 * np.sin(phi), L1 * np.cos(phi), speed
    x, y = ((k * s, k * w * c, -k * w * w * s) for k in (
        math.sin(ALPHA), -math.cos(ALPHA)))
    z = H + c, -w * s, -w * w * c
    y = y[0] - D, y[1], y[2]
    r = np.hypot(y[0], z[0])
    r1 = (y[0] * y[1] + z[0] * z[1]) / r
    r2 = (y[1] ** 2 + y[0] * y[2] + z[1] ** 2 + z[0] * z[2] - r1 * r1) / r
    turn = np.arctan2(-y[0], z[0])
    t1 = (y[0] * z[1] - y[1] * z[0]) / r**2
    t2 = (y[0] * z[2] - y[2] * z[0]) / r**2 - 2.0 * t1 * r1 / r
    b = math.hypot(L2, A)
    u = b * (r / L2 - 1.0), b * r1 / L2, b * r2 / L2
    along = [x[k] + u[k] * A / b for k in range(3)]
    return np.array([(turn, t1, t2), along, u])


def judge(phi: Array, speed: float, found: Array) -> dict[str, float]:
    """Return the largest errors of coordinates (3, 3, N), as `exact` returns them."""
    off = np.abs(found - exact(phi, speed)).max(axis=(0, 2))
    return dict(zip(("q", "q'", "q''"), off.tolist(), strict=True))
