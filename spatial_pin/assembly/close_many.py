"""Closing the loops from many configurations together, by the least motion.

`newton.close` is the specification, one configuration at a time. Here all of them take their
steps together over flat arrays (`kinematics.batch`); the last digits are left to `newton.close`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.newton import MAX_STEP
from spatial_pin.constraints.stacked import Batch, Placed
from spatial_pin.numerics.linalg import EPS, Array

DAMPING = 1e-2  # as `newton.close` begins with
LEAST, MOST = 1e-12, 1e4  # of the damping; beyond it no step is left
SOFTER, HARDER = 0.1, 8.0
STALLED, LEFT = 20, 0.9  # steps after which more than that part of a residual will not vanish
ROUND_OFF = 1e2 * EPS  # of J Jᵀ by its size: redundant rows leave it singular


def close_many(
    batch: Batch, q: Array, free: NDArray[np.bool_], tolerance: float, iterations: int
) -> tuple[Array, Array]:
    """Move the `free` velocities of configurations q (nq, m) until their loops close.

    Returns:
        The configurations (nq, m) and the lengths (m,) of their residuals, small or not.
    """
    scale = batch.mechanism.velocity_scale[:, None]
    found, errors = q.copy(), np.full(q.shape[1], np.inf)
    near = np.zeros((batch.constraints.n_angles, q.shape[1]))
    at = np.arange(q.shape[1])
    p = batch.place(q, near)
    error, damping = _length(p), np.full(q.shape[1], DAMPING)
    marked = np.full(q.shape[1], np.inf)
    for k in range(iterations):
        going = (error > tolerance) & (damping < MOST)
        if k % STALLED == 0:
            going &= error < LEFT * marked
            marked = error.copy()
        if not going.all():
            found[:, at[~going]], errors[at[~going]] = p.q[:, ~going], error[~going]
            kept = np.flatnonzero(going)
            at, p, marked = at[kept], p.take(kept), marked[kept]
            error, damping = error[kept], damping[kept]
        if not at.size:
            break
        step = np.zeros((len(scale), at.size))
        step[free] = _least(batch.jacobian(p)[: len(p.residual), free], p.residual, damping * error)
        trial = batch.place(batch.tree.displace(p.q, scale * step), p.angles)
        trial_error = _length(trial)
        better = np.flatnonzero(trial_error < error)
        p.put(better, trial.take(better))
        damping *= HARDER
        damping[better] = np.maximum(damping[better] * (SOFTER / HARDER), LEAST)
        error[better] = trial_error[better]
    found[:, at], errors[at] = p.q, error
    return found, errors


def _length(p: Placed) -> Array:
    return np.sqrt((p.residual * p.residual).sum(axis=0))


def _least(jacobian: Array, residual: Array, damping: Array) -> Array:
    """Return steps (n, m), none longer than `MAX_STEP`, for Jacobians (r, n, m)."""
    j = np.ascontiguousarray(jacobian.transpose(2, 0, 1))
    wide = j.shape[1] <= j.shape[2]
    square = j @ j.transpose(0, 2, 1) if wide else j.transpose(0, 2, 1) @ j
    n = np.arange(square.shape[1])
    size = square[:, n, n].max(axis=1, initial=EPS)
    square[:, n, n] += np.maximum(damping, ROUND_OFF * size)[:, None]
    r = -residual.T[:, :, None]
    right = r if wide else j.transpose(0, 2, 1) @ r
    x = np.linalg.solve(square, right)
    x = (j.transpose(0, 2, 1) @ x if wide else x)[:, :, 0]
    longest = np.abs(x).max(axis=1, initial=EPS)
    found: Array = (x * np.minimum(1.0, MAX_STEP / longest)[:, None]).T
    return found
