"""Rotations, difference stencils: the mathematics of the judge, in extended precision.

Angles and vectors come many at a time, along the first axis. Quaternions are x, y, z, w.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

LD = np.longdouble
PI = LD("3.14159265358979323846264338327950288")
SERIES = 1e-4  # squared angle below which series of five terms are exact to the last bit


def skew(w):
    """Matrices (..., 3, 3) of the cross product with w (..., 3)."""
    out = np.zeros((*w.shape[:-1], 3, 3), dtype=w.dtype)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    return out - np.swapaxes(out, -1, -2)


def unit(v):
    """The vector v (3,) with length 1."""
    v = np.asarray(v, dtype=LD)
    return v / np.sqrt((v * v).sum())


def about(axis, angle):
    """Rotations (N, 3, 3) about a unit axis (3,) by angles (N,)."""
    k = skew(axis)
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3, dtype=LD) + sine * k + (1 - cosine) * (k @ k)


def from_rpy(rpy):
    """The rotation (3, 3) of URDF's roll, pitch, yaw."""
    angles = np.asarray(rpy, dtype=LD)
    x, y, z = (about(axis, angles[k : k + 1])[0] for k, axis in enumerate(np.eye(3, dtype=LD)))
    return z @ y @ x


def to_rpy(rotation):
    """Roll, pitch, yaw of a rotation (3, 3)."""
    r = np.asarray(rotation, dtype=float)
    level = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], level)
    if level < 1e-9:  # roll and yaw turn about the same axis
        return [math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0]
    return [math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])]


def onto(axis):
    """The least rotation (3, 3) that takes z onto an axis."""
    u = unit(axis)
    if u[2] <= -1 + 1e-15:
        return np.diag(np.array([1, -1, -1], dtype=LD))
    v = skew(np.cross(np.array([0, 0, 1], dtype=LD), u))
    return np.eye(3, dtype=LD) + v + v @ v / (1 + u[2])


def from_quaternion(q):
    """Rotations (N, 3, 3) of quaternions (N, 4)."""
    q = normal(q)
    k = skew(q[:, :3])
    return np.eye(3, dtype=LD) + 2 * q[:, 3, None, None] * k + 2 * (k @ k)


def normal(q):
    """Quaternions (N, 4) with length 1."""
    return q / np.sqrt((q * q).sum(-1, keepdims=True))


def product(a, b):
    """Products (N, 4) of quaternions: b first, then a."""
    av, aw, bv, bw = a[:, :3], a[:, 3:], b[:, :3], b[:, 3:]
    return np.concatenate([aw * bv + bw * av + np.cross(av, bv),
                           aw * bw - (av * bv).sum(-1, keepdims=True)], -1)


def _quotients(t2):
    """sin(t)/t, (1 - cos t)/t², (t - sin t)/t³ of squared angles (N,)."""
    small = t2 < SERIES
    s = np.where(small, LD(1), t2)
    t = np.sqrt(s)
    one = np.where(small, 1 - t2 / 6 + t2**2 / 120 - t2**3 / 5040, np.sin(t) / t)
    two = np.where(small, LD(1) / 2 - t2 / 24 + t2**2 / 720 - t2**3 / 40320, (1 - np.cos(t)) / s)
    three = np.where(small, LD(1) / 6 - t2 / 120 + t2**2 / 5040 - t2**3 / 362880,
                     (t - np.sin(t)) / (s * t))
    return one, two, three


def to_quaternion(w):
    """Quaternions (N, 4) of rotation vectors (N, 3)."""
    half = w / 2
    t2 = (half * half).sum(-1)
    return np.concatenate([_quotients(t2)[0][:, None] * half, np.cos(np.sqrt(t2))[:, None]], -1)


def from_turned(q):
    """The rotation vector (3,) of a quaternion (4,)."""
    q = -q if q[3] < 0 else q
    sine = np.sqrt((q[:3] ** 2).sum())
    angle = 2 * np.arctan2(sine, q[3])
    return q[:3] * (angle / sine if sine > 0 else 2)


def screw_shift(w):
    """Matrices (N, 3, 3) from the slide of a twist that turns by w (N, 3) to its displacement."""
    _, two, three = _quotients((w * w).sum(-1))
    k = skew(w)
    return np.eye(3, dtype=LD) + two[:, None, None] * k + three[:, None, None] * (k @ k)


def skew_part(r):
    """Vectors (N, 3) of the skew parts: zero where r (N, 3, 3) is no rotation, or a half turn."""
    return np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]],
                    -1) / 2


def _weights(points, order):
    """Weights of a derivative's difference formula, from exact fractions."""
    n = len(points)
    rows = [[Fraction(p) ** i for p in points] for i in range(n)]
    right = [Fraction(math.factorial(order)) if i == order else Fraction(0) for i in range(n)]
    for i in range(n):
        pivot = next(r for r in range(i, n) if rows[r][i] != 0)
        rows[i], rows[pivot], right[i], right[pivot] = rows[pivot], rows[i], right[pivot], right[i]
        for r in range(n):
            if r != i and rows[r][i] != 0:
                factor = rows[r][i] / rows[i][i]
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[i], strict=True)]
                right[r] -= factor * right[i]
    exact = (right[i] / rows[i][i] for i in range(n))
    return np.array([LD(x.numerator) / LD(x.denominator) for x in exact])


POINTS = np.arange(-5, 6)
FIRST, SECOND, THIRD = (_weights(POINTS.tolist(), order) for order in (1, 2, 3))
