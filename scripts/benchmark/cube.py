"""IFToMM A04: six hinges and five rods along the edges of a cube, one freedom, overconstrained.

Rods of 1 m, 1 kg and a square section of 0.1 m; gravity along -y moves it from rest for 10 s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DURATION, G, MASS, WIDTH = 10.0, 9.81, 1.0, 0.1
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], float)
AXES = "yzxyzx"  # of the hinges at the corners
P3 = np.array([0.999999963806, -1.000269012696, 0.999730951120])  # integrated to 1e-12
P3_ROD = 2  # P3 is its far end
POST = np.array([0.0, 0.0, 1.0])  # place of the last hinge on the ground


def edges() -> Array:
    """Return (5, 3): the rods, from their first hinge to their second."""
    return np.diff(CORNERS, axis=0)


def moments(edge: Array) -> Array:
    """Return (3,) moments of inertia about the rod's middle, world axes at the start [kg m²]."""
    across = MASS * (1.0 + WIDTH**2) / 12.0
    return np.where(np.abs(edge) > 0.5, MASS * WIDTH**2 / 6.0, across)


def unit(axis: str) -> Array:
    """Return the unit vector (3,) of "x", "y" or "z"."""
    return np.eye(3)["xyz".index(axis)]


def judge(corner: Array, closure: float | None) -> dict[str, float | None]:
    """Return the errors of P3 (3,) at the end [m] and the closure [m]."""
    return {"position": float(np.abs(corner - P3).max()), "closure": closure}
