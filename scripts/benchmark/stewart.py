"""The Gough platform of the library: six legs between two rings, and Newton on their lengths.

One leg is moved up and down, the others are held. The pose is solved from |X p + x - f| = length,
six equations by hand, independently of any joint between foot and platform.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BASE, TOP, HEIGHT = 0.30, 0.18, 0.36
BASE_HALF, TOP_HALF = math.radians(20.0), math.radians(15.0)
STROKE, SPEED = 0.03, 0.2  # of the moved leg [m, m/s]
TOLERANCE = 1e-14  # of a leg's length [m]


def _ring(radius: float, half: float) -> Array:
    turns = [2.0 * math.pi / 3.0 * (k // 2) + (1 if k % 2 else -1) * half for k in range(6)]
    return np.array([(radius * math.cos(t), radius * math.sin(t), 0.0) for t in turns])


FEET, TOPS = _ring(BASE, BASE_HALF), _ring(TOP, math.pi / 3.0 - TOP_HALF)
HOME = np.linalg.norm(TOPS + np.array([0.0, 0.0, HEIGHT]) - FEET, axis=1)


def lengths(steps: int) -> Array:
    """Return (steps,) lengths of the first leg [m]."""
    return HOME[0] + STROKE * np.sin(np.linspace(0.0, 2.0 * np.pi, steps + 1)[:-1])


def exponential(w: NDArray) -> Array:
    """Return the rotation (3, 3) of a rotation vector (Rodrigues)."""
    x, y, z = w
    k, angle = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]), float(np.linalg.norm(w))
    if angle < 1e-8:
        return np.eye(3) + k + 0.5 * k @ k
    return np.eye(3) + math.sin(angle) / angle * k + (1 - math.cos(angle)) / angle**2 * k @ k


def rows(x: Array, rotation: Array) -> tuple[Array, Array, Array, Array]:
    """Return arms (6, 3), legs (6, 3), their lengths (6,) and d(length)/d(twist) (6, 6)."""
    arms = TOPS @ rotation.T
    legs = arms + x - FEET
    length = np.sqrt(np.einsum("ij,ij->i", legs, legs))
    unit = legs / length[:, None]
    return arms, unit, length, np.hstack([unit, np.cross(arms, unit)])


def solve(values: Array, speed: float) -> Array:
    """Return (3, 3, N): centre of the platform, its velocity and acceleration, by axis first."""
    x, rotation, poses = np.array([0.0, 0.0, HEIGHT]), np.eye(3), []
    for value in values:
        target = np.array([value, *HOME[1:]])
        for _ in range(20):
            arms, unit, length, jacobian = rows(x, rotation)
            gap = target - length
            if np.abs(gap).max() <= TOLERANCE:
                break
            step = np.linalg.solve(jacobian, gap)
            x, rotation = x + step[:3], exponential(step[3:]) @ rotation
        inverse = np.linalg.inv(jacobian)
        twist = inverse[:, 0] * speed
        tips = twist[:3] + np.cross(twist[3:], arms)
        along = np.einsum("ij,ij->i", unit, tips)
        across = np.einsum("ij,ij->i", tips, tips) - along**2
        centripetal = np.cross(twist[3:], np.cross(twist[3:], arms))
        bias = np.einsum("ij,ij->i", unit, centripetal) + across / length
        poses.append((x, twist[:3], -(inverse @ bias)[:3]))
    return np.array(poses).transpose(2, 1, 0)


def judge(values: Array, speed: float, poses: Array) -> dict[str, float]:
    """Return the largest errors of a centre (3, 3, N), as `solve` returns it."""
    off = np.abs(poses - solve(values, speed)).max(axis=(0, 2))
    return dict(zip(("x", "x'", "x''"), off.tolist(), strict=True))
