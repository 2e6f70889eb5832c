"""Best fit of parts of closed curves to given points, up to translation, rotation and size.

Curves are compared at points spaced evenly along them. For all places at which a part may begin the
sums of products are correlations, computed together by Fourier transforms. They give the best
rotation [Kabsch1976], the best size and the remaining error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array

EVEN = 48  # points at equal distances on the given curve
FINE = 2001  # points that measure the length of a smooth curve through the given points
# Lengths of the whole curve that are tried, relative to its part through the points. Among some
# thousand longer curves hardly any fits.
TIMES_AS_LONG = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0)

COARSE = 3  # with rotations in space, every third start of the part is tried first


class Matches(NamedTuple):
    """The best fits of parts of m curves to given points.

    Attributes:
        misfit: (m,) the distance that remains, relative to the size of the given curve.
        size: (m,) by which a curve is multiplied, then turned.
        rotation: (m, 3, 3).
        at: (m, k) parts of its length, 0 to 1, at which each curve is at the given points.
    """

    misfit: Array
    size: Array
    rotation: Array
    at: Array


def matches(
    points: Array, curves: Array, is_closed: bool, shifts: NDArray[np.bool_],
    turns: NDArray[np.bool_], scale: bool,
) -> Matches:
    """Return the best fits of closed curves, or of a part of each, in both directions.

    Args:
        points: (k, 3) in their order.
        curves: (m, n, 3) samples; the first one follows the last.
        is_closed: whether the first point follows the last.
        shifts: (3,) whether a curve may be moved along each axis.
        turns: (3,) whether it may be turned about each axis: none, one, or all.
        scale: whether it may have any size.
    """
    given, at = _even_points(points, is_closed)
    m, part = len(curves), at * (EVEN if is_closed else EVEN - 1)
    best = Matches(np.full(m, np.inf), np.ones(m), np.tile(np.eye(3), (m, 1, 1)),
                   np.zeros((m, len(points))))
    closed = np.concatenate([curves, curves[:, :1]], axis=1)
    for times in TIMES_AS_LONG[:1] if is_closed else TIMES_AS_LONG:
        n = round(times * EVEN)
        fractions = np.arange(n) / n
        forward = np.array([np.column_stack([np.interp(fractions, parts, x) for x in curve.T])
                            for parts, curve in zip(lengths_along(curves), closed, strict=True)])
        for sense in (1, -1):
            along = forward if sense > 0 else forward[:, (-np.arange(n)) % n]
            misfit, first, size, rotation = _best_starts(given, along, shifts, turns, scale)
            there = (sense * (first[:, None] + part)) % n / n
            better = misfit < best.misfit
            best = Matches(*(np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
                             for new, old in zip((misfit, size, rotation, there), best,
                                                 strict=True)))
    return best


def _even_points(points: Array, is_closed: bool) -> tuple[Array, Array]:
    """Return points (EVEN, 3) along the smooth curve through some, and the parts of it at these."""
    from scipy.interpolate import CubicSpline  # on use: it takes a tenth of a second

    ends = np.vstack([points, points[:1]]) if is_closed else points
    chords = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    knots = np.concatenate([[0.0], np.cumsum(np.maximum(chords, 1e-9 * chords.max()))])
    spline = CubicSpline(knots, ends, bc_type="periodic" if is_closed else "not-a-knot")
    fine = np.linspace(0.0, knots[-1], FINE)
    fine_points = spline(fine)
    steps = np.linalg.norm(np.diff(fine_points, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    even = np.linspace(0.0, length[-1], EVEN, endpoint=not is_closed)
    points_on = np.column_stack([np.interp(even, length, x) for x in fine_points.T])
    return points_on, np.interp(knots[: len(points)], fine, length) / length[-1]


def lengths_along(curves: Array) -> Array:
    """Return the parts (m, n + 1) of the length of closed curves (m, n, 3) at their samples."""
    steps = np.linalg.norm(np.diff(curves, axis=1, append=curves[:, :1]), axis=2)
    sums = np.concatenate([np.zeros((len(curves), 1)), np.cumsum(steps, axis=1)], axis=1)
    return sums / np.maximum(sums[:, -1:], np.finfo(float).tiny)


def _best_starts(
    given: Array, along: Array, shifts: NDArray[np.bool_], turns: NDArray[np.bool_], scale: bool
) -> tuple[Array, NDArray[np.intp], Array, Array]:
    """Return misfit, first point, size and rotation of the best part of each curve (m, n, 3)."""
    n, k = along.shape[1], len(given)
    centre = np.where(shifts, given.mean(axis=0), 0.0)
    z = given - centre
    shape = np.conj(np.fft.rfft(z, n, axis=0))
    products = np.fft.irfft(shape[None, :, :, None] * np.fft.rfft(along, axis=1)[:, :, None, :], n,
                            axis=1)  # (m, n, 3, 3): of z and a part from each place on
    stride = COARSE if turns.all() else 1
    window = np.conj(np.fft.rfft(np.ones(k), n))[None, :, None]
    sums, squares = (np.fft.irfft(window * np.fft.rfft(x, axis=1), n, axis=1)
                     for x in (along, along**2))
    products, sums, squares = (x[:, ::stride] for x in (products, sums, squares))
    own = (squares - np.where(shifts, sums**2 / k, 0.0)).sum(axis=2)
    both = _turned_products(products, turns)
    whole = float(np.sum(z * z))
    tiny = np.finfo(float).tiny
    size = np.maximum(both, 0.0) / np.maximum(own, tiny) if scale else np.ones_like(both)
    misfit = np.maximum(whole - 2.0 * size * both + size**2 * own, 0.0)
    first = np.argmin(misfit, axis=1)
    rows = np.arange(len(along))
    rotation = _rotations(products[rows, first], turns)
    return np.sqrt(misfit[rows, first] / whole), stride * first, size[rows, first], rotation


def _turned_products(products: Array, turns: NDArray[np.bool_]) -> Array:
    """Return the largest sums of products (m, n) of points and turned ones."""
    if turns.all():
        values = np.linalg.svd(products, compute_uv=False)
        mirrored = np.where(np.linalg.det(products) < 0.0, -1.0, 1.0)
        return values[..., 0] + values[..., 1] + mirrored * values[..., 2]
    if turns.any():
        i, j, axis = _plane(turns)
        return np.hypot(products[..., i, i] + products[..., j, j],
                        products[..., j, i] - products[..., i, j]) + products[..., axis, axis]
    return np.trace(products, axis1=-2, axis2=-1)


def _rotations(products: Array, turns: NDArray[np.bool_]) -> Array:
    """Return the rotations (m, 3, 3) of the largest sums of products (m, 3, 3)."""
    rotations = np.tile(np.eye(3), (len(products), 1, 1))
    if turns.all():
        u, _, vt = np.linalg.svd(products)
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        return np.asarray(u @ vt)
    if turns.any():
        i, j, _ = _plane(turns)
        angle = np.arctan2(products[:, j, i] - products[:, i, j],
                           products[:, i, i] + products[:, j, j])
        rotations[:, i, i] = rotations[:, j, j] = np.cos(angle)
        rotations[:, j, i], rotations[:, i, j] = np.sin(angle), -np.sin(angle)
    return rotations


def _plane(turns: NDArray[np.bool_]) -> tuple[int, int, int]:
    """Return the axes that a turn about the first allowed one takes into each other, and it."""
    axis = int(np.argmax(turns))
    return (axis + 1) % 3, (axis + 2) % 3, axis
