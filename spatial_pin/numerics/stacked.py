"""Many small vectors, matrices and least-squares problems together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

MOST_DAMPING = 1e6  # with this damping nothing moves any more
Tries = Callable[[NDArray[np.intp], Array], tuple[NDArray[np.bool_], NDArray[np.bool_]]]


def levenberg(
    tries: Tries, problems: NDArray[np.intp], *, first: float, easing: float, hardening: float,
    least: float, most: int,
) -> None:
    """Minimise many sums of squares by Levenberg's method, each with its own damping.

    Beside `least_squares.minimised` for one problem: ten and more cost little more than one so.

    Args:
        tries: makes steps on problems (k,) with damping (k,), and takes those that help; returns
            which these are, and which problems are at their end.
        problems: by number.
        first: damping at first.
        easing: by what damping goes after a step that helped.
        hardening: the same after one that did not.
        least: damping at least after that.
        most: steps that are made at most.
    """
    damping, going = np.full(problems.max(initial=-1) + 1, first), problems
    for _ in range(most):
        if not going.size:
            return
        better, has_ended = tries(going, damping[going])
        damping[going] = np.where(better, easing * damping[going],
                                  hardening * np.maximum(damping[going], least))
        going = going[~has_ended & (damping[going] <= MOST_DAMPING)]


def cross(a: Array, b: Array) -> Array:
    """Return a x b of vectors (..., 3); `np.cross` takes ten times as long."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def damped_solutions(a: Array, b: Array, damping: Array) -> Array:
    """Return x (m, n) with |a x - b|² + damping |x|² least, a (m, k, n), b (m, k), damping (m,)."""
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    parts = s / (s * s + damping[:, None])
    return np.einsum("mkn,mk->mn", vt, parts * np.einsum("mik,mi->mk", u, b))


def padded_null_spaces(a: Array, tolerance: float = TOLERANCES.rank) -> Array:
    """Return orthonormal rows (m, n, n) that span the null space of each a (m, k, n), or are zero.

    With the ranks that `linalg.decompose` tells.
    """
    m, k, n = a.shape
    if not k or not n:
        return np.broadcast_to(np.eye(n), (m, n, n))
    _, s, vt = np.linalg.svd(a, full_matrices=k < n)
    return vt * (np.arange(n) >= _ranks(s, tolerance))[:, :, None]


def padded_row_spaces(a: Array) -> Array:
    """Return orthonormal rows (m, j, n) that span the rows of each a (m, k, n), or are zero."""
    if not a.size:
        return a
    _, s, vt = np.linalg.svd(a, full_matrices=False)
    return vt * (np.arange(s.shape[1]) < _ranks(s))[:, :, None]


def _ranks(s: Array, tolerance: float = TOLERANCES.rank) -> NDArray[np.intp]:
    """Return the ranks (m, 1) of matrices by their singular values (m, k)."""
    return np.count_nonzero(s > np.maximum(tolerance * s[:, :1], TOLERANCES.zero),
                            axis=1, keepdims=True)


def projected(b: Array, a: Array, weights: Array | None = None) -> Array:
    """Return the part of b (m, k, n) that is normal to the columns of a (m, k, j).

    Args:
        b: derivatives of residuals by given parameters.
        a: derivatives by fitted parameters, which minimise the residuals.
        weights: (m, k) the residuals. They are normal to the columns, except at the end of a curve,
            where a column vanishes: b keeps its part along that column.
    """
    u, s, _ = np.linalg.svd(a, full_matrices=False)
    part = (s > TOLERANCES.singular * np.maximum(s[:, :1], TOLERANCES.half_precision)).astype(float)
    if weights is not None:
        squares = np.maximum(s * s, np.finfo(float).tiny)
        part *= squares / (squares + np.abs(np.einsum("mkj,mk->mj", u, weights)))
    return b - (u * part[:, None]) @ (u.transpose(0, 2, 1) @ b)
