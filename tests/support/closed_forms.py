"""Closed forms of the library's mechanisms in mpmath, independent of the library.

Each mechanism is a function of the crank angle (and of its dimensions, named as in its URDF) that
returns a `Pose`: every joint coordinate that is a plain angle or length, the placement of every
link whose orientation is determined, and the positions of the named points. They are smooth over
any number of turns, so `mpmath.diff` and `mpmath.taylor` may be applied to any of their entries;
`rates` differentiates all entries at once. Vectors and 4x4 placements are NumPy arrays of mpmath
numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import mpmath
import numpy as np
from mpmath import acos, asin, atan2, cos, mp, mpf, sin, sqrt

DIGITS = 40
SIXTY_DEGREES = math.radians(60)


class Pose(NamedTuple):
    """What a closed form says at one crank angle, or the time derivatives of that."""

    coordinates: dict  # {coordinate: angle in rad or length in m}
    links: dict  # {link: 4x4 placement in the world}
    points: dict  # {frame: position in the world}


class Rates(NamedTuple):
    """Poses with their first and second derivatives with respect to time."""

    value: Pose
    rate: Pose
    acceleration: Pose


def vector(*entries) -> np.ndarray:
    return np.array([mpf(x) for x in entries], dtype=object)


def placement(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    M = np.full((4, 4), mpf(0), dtype=object)
    M[:3, :3], M[:3, 3], M[3, 3] = rotation, position, mpf(1)
    return M


def rotation(axis: np.ndarray, angle) -> np.ndarray:
    """Rotation by `angle` about the unit vector `axis` (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=object)
    return np.eye(3, dtype=int) + sin(angle) * K + (1 - cos(angle)) * K.dot(K)


def rssr(phi, a=0.102, b=0.381, c=0.254, d=0.314) -> Pose:
    """RSSR of EMT 2431, Example 7.3: crank about +y, rocker about -z; the coupler may spin."""
    a, b, c, d = map(mpf, (a, b, c, d))
    cos_psi = (b**2 - a**2 - c**2 - d**2 + 2 * a * d * cos(phi)) / (2 * c * (d - a * cos(phi)))
    psi = acos(cos_psi)
    A = vector(-a * cos(phi), 0, a * sin(phi))
    B = vector(-d - c * cos(psi), c * sin(psi), 0)
    return Pose(
        coordinates={"crank_pin": phi, "rocker_pin": psi},
        links={
            "crank": placement(rotation(vector(0, 1, 0), phi), vector(0, 0, 0)),
            "rocker": placement(rotation(vector(0, 0, -1), psi), vector(-d, 0, 0)),
        },
        points={"coupler": A, "coupler_b": B, "rocker_b": B},
    )


def plane_link(angle, x, z) -> np.ndarray:
    """Placement of a link in the x-z plane whose angle is counted from +x towards +z."""
    return placement(rotation(vector(0, -1, 0), angle), vector(x, 0, z))


def four_bar(phi, r1=0.30, r2=0.10, r3=0.28, r4=0.24) -> Pose:
    """Plane four-bar, the branch with the coupler's tip B to the left of the line from A to r1."""
    r1, r2, r3, r4 = map(mpf, (r1, r2, r3, r4))
    x_a, z_a = r2 * cos(phi), r2 * sin(phi)
    diagonal = sqrt((r1 - x_a) ** 2 + z_a**2)
    coupler = atan2(-z_a, r1 - x_a) + acos((r3**2 + diagonal**2 - r4**2) / (2 * r3 * diagonal))
    x_b, z_b = x_a + r3 * cos(coupler), z_a + r3 * sin(coupler)
    rocker = atan2(z_b, x_b - r1)
    return Pose(
        coordinates={"crank_pin": phi, "coupler_pin": coupler - phi, "rocker_pin": rocker},
        links={
            "crank": plane_link(phi, 0, 0),
            "coupler": plane_link(coupler, x_a, z_a),
            "rocker": plane_link(rocker, r1, 0),
        },
        points={"coupler_b": vector(x_b, 0, z_b), "rocker_b": vector(x_b, 0, z_b)},
    )


def slider_crank(phi, r=0.05, l=0.16, e=0.0) -> Pose:  # noqa: E741 (l as in the URDF)
    """Plane slider-crank with offset e, the branch with the slider ahead of the crank."""
    r, l, e = map(mpf, (r, l, e))  # noqa: E741
    x_a, z_a = r * cos(phi), r * sin(phi)
    coupler = asin((e - z_a) / l)
    x = x_a + sqrt(l**2 - (z_a - e) ** 2)
    return Pose(
        coordinates={"crank_pin": phi, "coupler_pin": coupler - phi, "slide": x},
        links={
            "crank": plane_link(phi, 0, 0),
            "coupler": plane_link(coupler, x_a, z_a),
            "slider": plane_link(mpf(0), x, e),
        },
        points={"coupler_b": vector(x, 0, e)},
    )


def rspc(phi, h=0.30, alpha=SIXTY_DEGREES, d=0.25, l1=0.10, l2=0.20, a=0.15, rod=None) -> Pose:
    """RSPC of Pham and Nguyen, section III, with B above C on the line FC (`rod` moves nothing)."""
    h, alpha, d, l1, l2, a = map(mpf, (h, alpha, d, l1, l2, a))
    b = sqrt(l2**2 + a**2)
    B = vector(l1 * sin(phi) * sin(alpha), -l1 * sin(phi) * cos(alpha), h + l1 * cos(phi))
    u = b * (sqrt((B[1] - d) ** 2 + B[2] ** 2) / l2 - 1)
    delta = atan2(-(B[1] - d), B[2])
    x_d = B[0] + u * a / b
    cde = rotation(vector(1, 0, 0), delta)
    return Pose(
        coordinates={"crank_pin": phi, "guide.angle": delta, "guide.slide": x_d, "slide": u},
        links={
            "crank": placement(rotation(vector(cos(alpha), sin(alpha), 0), phi), vector(0, 0, h)),
            "cde": placement(cde, vector(x_d, d, 0)),
            "rod": placement(cde, B),
        },
        points={"crank_b": B, "rod_b": B},
    )


def _combine(f: Callable, poses: list[Pose]) -> Pose:
    """Apply `f` to the matching entries of `poses`."""
    tables = zip(*poses, strict=True)
    return Pose(*({key: f(*(t[key] for t in table)) for key in table[0]} for table in tables))


def rates(f: Callable[..., Pose], phi, speed, acceleration) -> Rates:
    """Value, rate and acceleration of every entry of f(phi) when phi has a speed and acceleration.

    The chain rule on the first two Taylor coefficients of f. Central differences with a step of
    1e-15 in 70 digits give them to 28 digits, and evaluate f three times for all entries together.
    """
    with mp.workdps(DIGITS + 30):
        h = mpf(10) ** -15
        before, value, after = (f(mpf(phi) + k * h) for k in (-1, 0, 1))
        first = _combine(lambda m, p: (p - m) / (2 * h), [before, after])
        second = _combine(lambda m, o, p: (p - 2 * o + m) / h**2, [before, value, after])
        speed, acceleration = mpf(speed), mpf(acceleration)
        return Rates(
            value,
            _combine(lambda d: d * speed, [first]),
            _combine(lambda d, dd: d * acceleration + dd * speed**2, [first, second]),
        )


def dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Scalar products along the last axis, which is kept."""
    return (p * q).sum(axis=-1, keepdims=True)


def unskew(K: np.ndarray) -> np.ndarray:
    lower, upper = [2, 0, 1], [1, 2, 0]
    return (K[..., lower, upper] - K[..., upper, lower]) / 2


def angular_rates(R: np.ndarray, dR: np.ndarray, ddR: np.ndarray) -> tuple:
    """Angular velocity and acceleration (..., 3) from direction cosines (..., 3, 3)."""
    turned_back = np.swapaxes(R, -1, -2)
    return unskew(dR @ turned_back), unskew(ddR @ turned_back)


def spinless_rates(A: tuple, B: tuple) -> tuple:
    """Angular velocity and acceleration (..., 3) of a body that does not spin about its line AB.

    Args:
        A, B: position, velocity and acceleration (..., 3) of the two points.
    """
    b, v, a = (q - p for p, q in zip(A, B, strict=True))
    omega = np.cross(b, v) / dot(b, b)
    return omega, np.cross(b, a - np.cross(omega, np.cross(omega, b))) / dot(b, b)


def long(values) -> np.ndarray:
    """Numbers of mpmath with all digits that extended precision holds."""
    return np.array([np.longdouble(mpmath.nstr(x, 25)) for x in values])
