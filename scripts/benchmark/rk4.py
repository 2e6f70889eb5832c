"""Runge-Kutta of fourth order; Baumgarte's terms in the accelerations keep loops closed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STIFFNESS, DAMPING = 100.0, 20.0  # of Baumgarte's terms, critically damped [1/s², 1/s]
BY_HAND_STEPS = (5e-3, 2e-3, 1e-3)  # [s]


def rk4(
    acceleration: Callable[[Array, Array], Array], q: Array, v: Array, step: float, duration: float
) -> tuple[Array, Array]:
    """Return coordinates and velocities at the end; all joints are hinges, q' = v."""
    h = step
    for _ in range(round(duration / h)):
        k1 = acceleration(q, v)
        k2 = acceleration(q + 0.5 * h * v, v + 0.5 * h * k1)
        k3 = acceleration(q + 0.5 * h * v + 0.25 * h * h * k1, v + 0.5 * h * k2)
        k4 = acceleration(q + h * v + 0.5 * h * h * k2, v + h * k3)
        q = q + h * v + h * h / 6.0 * (k1 + k2 + k3)
        v = v + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return q, v
