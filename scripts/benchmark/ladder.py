"""IFToMM A02: N square windows side by side, N + 1 upright rods and N couplers, 1 m and 1 kg each.

On the parallelogram branch every rod turns by the same angle θ from upright (clockwise) and
θ'' = k sin θ. Gravity moves it for 10 s through the flat configurations where branches cross; it
starts upright with the tops moving at 1 m/s.
"""

from __future__ import annotations

import math

from scipy.special import ellipj, ellipk

DURATION, G, START = 10.0, 9.81, 1.0  # [s, m/s², rad/s]
ANGLE, RATE = 0.5, 1.0  # state of forward dynamics [rad, rad/s]
ROD = 1.0 / 12.0  # moment of inertia of a rod about its middle [kg m²]
SIZES = (1, 20, 200)


def growth(n: int) -> float:
    """Return k: moment of the weights over the moment of inertia [1/s²]."""
    return ((n + 1) / 2.0 + n) * G / ((n + 1) / 3.0 + n)


def angle(n: int, t: float) -> float:
    """Return θ(t) from θ'² = START² + 2k(1 - cos θ), an elliptic amplitude.

    With θ = π + 2χ it is χ'² = (Ω/2)² (1 - m sin²χ), Ω² = START² + 4k, m = 4k/Ω².
    """
    fast = START**2 + 4.0 * growth(n)
    m = 4.0 * growth(n) / fast
    return math.pi + 2.0 * float(ellipj(math.sqrt(fast) / 2.0 * t - ellipk(m), m)[3])


def judge_end(value: float, closure: float | None) -> dict[str, float | None]:
    """Return the errors of A02 with one loop from θ at the end [rad] and the closure [m]."""
    return {"angle": abs(value - angle(1, DURATION)), "closure": closure}


def judge_acceleration(n: int, acceleration: float) -> dict[str, float | None]:
    """Return the error of θ'' [rad/s²] at ANGLE."""
    return {"acceleration": abs(acceleration - growth(n) * math.sin(ANGLE))}
