"""The plane four-bar of the library turned once, and its closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GROUND, CRANK, COUPLER, ROCKER = 0.30, 0.10, 0.28, 0.24
SPEED = 25.0  # of the crank [rad/s]
STEPS = (360,)


def angles(steps: int) -> Array:
    """Return (steps,) crank angles [rad]."""
    return np.linspace(0.0, 2.0 * np.pi, steps + 1)[:-1]


def solve(phi: Array, speed: float) -> Array:
    """Return (3, N): the rocker's angle [rad], its rate and acceleration.

    The rocker stands on the diagonal from its pin to the crank's tip; coupler and rocker turn so
    that the velocities and accelerations of the tips agree.
    """
    tip = CRANK * np.exp(1j * phi)
    diagonal = tip - GROUND
    length = np.abs(diagonal)
    psi = np.pi + np.angle(-diagonal) - np.arccos(
        (ROCKER**2 + length**2 - COUPLER**2) / (2.0 * ROCKER * length))
    rocker = ROCKER * np.exp(1j * psi)
    coupler = GROUND + rocker - tip
    across = (np.conj(coupler) * rocker).imag  # what is normal to the coupler drops out
    rate = speed * (np.conj(coupler) * tip).imag / across
    turn = speed * (np.conj(rocker) * tip).imag / across
    bend = rate**2 * rocker - speed**2 * tip - turn**2 * coupler
    acceleration = -(np.conj(coupler) * bend).real / across
    return np.array([psi, rate, acceleration])


def judge(phi: Array, speed: float, values: Array) -> dict[str, float]:
    """Return the largest errors of (3, N), as `solve` returns it."""
    off = np.abs(values - solve(phi, speed))
    return dict(zip(("ψ", "ψ'", "ψ''"), off.max(axis=1).tolist(), strict=True))
