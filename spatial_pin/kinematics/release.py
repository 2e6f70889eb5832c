"""Letting go of drivers whose values the loops do not allow: by the least motion of all of them.

The motion is the sum of squares of how far each goes from where it should stand, angles in rad and
slides by the characteristic length. It is made least over the closed configurations by Newton's
method with the exact second derivatives of the loops, as the least motion is nearly always a
dead centre of the drivers let go, where first derivatives vanish.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.kinematics.constraints import Evaluation
from spatial_pin.kinematics.newton import MAX_STEP, close
from spatial_pin.linalg import EPS, Array, decompose, rank

STEPS = 60  # of Newton's method; a minimum takes five to ten
FLAT = 1e-8  # curvature of the motion, of its largest or of 1, below which nothing is told by it
SLOW = 1e-4  # speed of drivers, by that of all joints, at which they stand at a dead centre
LEVEL = 1e-11  # slope of the motion that is round-off of closing the loops


def can_stand(
    evaluation: Evaluation, free: NDArray[np.bool_], standing: Mapping[str, float]
) -> bool:
    """Whether drivers are independent of each other and of the loops at the evaluation.

    Args:
        evaluation: at a closed configuration.
        free: (nv,) the velocities that are not held anyway.
        standing: the drivers that are to stand, by coordinate.
    """
    jacobian = evaluation.jacobian[: evaluation.constraints.n_rows, free]
    rows = np.eye(len(free))[[evaluation.mechanism.coordinate_table[n].v for n in standing]]
    return rank(np.vstack([jacobian, rows[:, free]])) == rank(jacobian) + len(standing)


def can_move(
    evaluation: Evaluation, free: NDArray[np.bool_], drivers: Mapping[str, float]
) -> bool:
    """Whether drivers move all freedoms at the evaluation, or each of them can move by itself.

    Args:
        evaluation: at a closed configuration.
        free: (nv,) the velocities that are not held.
        drivers: by coordinate.
    """
    svd = decompose(evaluation.jacobian[: evaluation.constraints.n_rows, free])
    tangents = np.zeros((len(svd.null_space), len(free)))
    tangents[:, free] = svd.null_space
    moved = tangents[:, [evaluation.mechanism.coordinate_table[name].v for name in drivers]]
    return bool(decompose(moved).s.min(initial=1.0) > SLOW)


def least_motion(
    evaluation: Evaluation, q: Array, free: NDArray[np.bool_], wanted: Mapping[str, float],
    tolerance: float,
) -> tuple[Array, float]:
    """Move a closed configuration until coordinates are as near to wanted values as loops allow.

    Args:
        evaluation: left at the configuration returned.
        q: (nq,) a closed configuration.
        free: (nv,) the velocities that may move.
        wanted: values by coordinate [rad, m].
        tolerance: to which loops are closed.

    Returns:
        The configuration and its closure error.
    """
    goal = _Goal(evaluation, free, wanted)
    evaluation.update(q)
    error, motion = evaluation.closure_error, goal.motion(q)
    slope, step = goal.newton(q)
    for _ in range(STEPS):
        if slope <= LEVEL:
            break
        for _ in range(30):
            there, open_by = close(evaluation, pin.integrate(evaluation.model, q, step), free,
                                   tolerance)
            less = goal.motion(there)
            if open_by <= max(error, 1e3 * tolerance) and less <= motion * (1.0 + 8.0 * EPS):
                break
            step = 0.5 * step
        else:
            break
        flatter, ahead = goal.newton(there)
        if not (less < motion * (1.0 - 1e-9) or flatter < 0.5 * slope):
            break
        q, error, motion, slope, step = there, open_by, less, flatter, ahead
    evaluation.update(q)
    return q, evaluation.closure_error


class _Goal:
    """How far coordinates are from wanted values, and its derivatives on closed configurations."""

    def __init__(
        self, evaluation: Evaluation, free: NDArray[np.bool_], wanted: Mapping[str, float]
    ) -> None:
        mechanism = evaluation.mechanism
        self.evaluation, self.free = evaluation, free
        self.scale = mechanism.velocity_scale
        places = [mechanism.coordinate_table[name] for name in wanted]
        self._q = np.array([c.q for c in places], dtype=np.intp)
        self._v = np.array([c.v for c in places], dtype=np.intp)
        self._values = np.array(list(wanted.values()), dtype=float)

    def _gaps(self, q: Array) -> Array:
        """Return (k,) how far each coordinate is from where it should be, scaled."""
        gaps: Array = (q[self._q] - self._values) / self.scale[self._v]
        return gaps

    def motion(self, q: Array) -> float:
        """Return the sum of squares of the gaps."""
        gaps = self._gaps(q)
        return float(gaps @ gaps)

    def newton(self, q: Array) -> tuple[float, Array]:
        """Return the slope of half the motion along closed configurations, and Newton's step (nv,).

        With multipliers m, J^T m = gaps, the second derivative along the tangents t is that of
        the coordinates themselves less m times that of the loops: t_v^2 - m bias(t).
        """
        evaluation, n = self.evaluation, self.evaluation.constraints.n_rows
        evaluation.update(q)
        svd = decompose(evaluation.jacobian[:n, self.free])
        tangents = np.zeros((len(svd.null_space), len(self.free)))
        tangents[:, self.free] = svd.null_space
        force = np.zeros(len(self.free))
        force[self._v] = self._gaps(q)
        slopes = tangents @ force
        multipliers = (svd.minimum_norm_transposed(force[self.free]) if n else np.empty(0))
        moved = tangents[:, self._v]
        curvature = moved @ moved.T - self._bending(q, tangents, multipliers)
        values, vectors = np.linalg.eigh(curvature)
        along = vectors.T @ slopes
        flat = np.abs(values) <= FLAT * max(1.0, float(np.abs(values).max(initial=0.0)))
        sizes = np.where(flat, 1.0, np.abs(values))  # downhill at saddles too
        step = -(along / sizes) @ vectors.T @ tangents
        step *= min(1.0, MAX_STEP / max(float(np.abs(step).max(initial=0.0)), 1e-300))
        return float(np.abs(slopes).max(initial=0.0)), step * self.scale

    def _bending(self, q: Array, tangents: Array, multipliers: Array) -> Array:
        """Return (d, d) the multipliers times the second derivatives of the loops, by polarity."""
        d, n = len(tangents), self.evaluation.constraints.n_rows
        bend = np.zeros((d, d))

        def along(t: Array) -> float:
            return float(multipliers @ self.evaluation.bias(q, self.scale * t)[:n])

        if not n:
            return bend
        for i in range(d):
            bend[i, i] = along(tangents[i])
        for i in range(d):
            for j in range(i):
                both = along(tangents[i] + tangents[j])
                bend[i, j] = bend[j, i] = 0.5 * (both - bend[i, i] - bend[j, j])
        return bend
