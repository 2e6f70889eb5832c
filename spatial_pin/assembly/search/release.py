"""Letting go of drivers whose values the loops do not allow, with the least motion of them all.

The motion is the sum of squares of how far each goes from where it should stand, angles in rad and
slides relative to the characteristic length. Newton's method finds its minimum over the closed
configurations with the second derivatives of the loops: that minimum is nearly always a dead centre
of the drivers let go, where first derivatives vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close, pinned_rows, scaled_row
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_bias, coordinate_value
from spatial_pin.numerics.linalg import EPS, Array, decompose, rank
from spatial_pin.numerics.tolerances import TOLERANCES

NEWTON_STEPS = 60  # a minimum takes five to ten, a start far from it as many for its way
# Curvature of the motion, of its largest or of 1, below which it is round-off: it has second
# derivatives by central differences, which are known to the two thirds power of epsilon, 4e-11.
FLAT_CURVATURE = 1e-8
# Speed of drivers relative to that of all joints at which they stand at a dead centre: loops closed
# to 1e-11 leave its square root at a dead centre, 3e-6.
STANDING_SPEED = 1e-4
ASIDE = EPS ** (1.0 / 3.0)  # step of central differences, whose round-off is as large as the rest


def can_stand(
    evaluation: LoopEquations, free: NDArray[np.bool_], standing: Mapping[str, float],
    pinned: Mapping[str, float],
) -> bool:
    """Whether drivers are independent of each other and of the loops at the evaluation.

    Args:
        evaluation: at a closed configuration.
        free: (nv,) the velocities that are not held anyway.
        standing: the drivers that are to stand, by coordinate.
        pinned: coordinates that are held, of those that are no entries of the configuration.
    """
    jacobian = pinned_rows(evaluation, free, pinned)[0]
    rows = _rows(evaluation, standing)[:, free]
    return rank(np.vstack([jacobian, rows])) == rank(jacobian) + len(standing)


def _rows(evaluation: LoopEquations, names: Iterable[str]) -> Array:
    """Return the derivatives (k, nv) of coordinates at the evaluation, all scaled."""
    mechanism = evaluation.mechanism
    rows = [scaled_row(mechanism, mechanism.coordinate_table[name], evaluation.q)
            for name in names]
    return np.array(rows).reshape(-1, evaluation.model.nv)


def can_move(
    evaluation: LoopEquations, free: NDArray[np.bool_], drivers: Mapping[str, float],
    pinned: Mapping[str, float],
) -> bool:
    """Whether drivers move all freedoms at the evaluation, or each of them can move by itself.

    Args:
        evaluation: at a closed configuration.
        free: (nv,) the velocities that are not held.
        drivers: by coordinate.
        pinned: as for `can_stand`.
    """
    null_space = decompose(pinned_rows(evaluation, free, pinned)[0]).null_space
    moved = null_space @ _rows(evaluation, drivers)[:, free].T
    return bool(decompose(moved).s.min(initial=1.0) > STANDING_SPEED)


def least_motion(
    evaluation: LoopEquations, q: Array, free: NDArray[np.bool_], wanted: Mapping[str, float],
    tolerance: float, pinned: Mapping[str, float],
) -> tuple[Array, float]:
    """Move a closed configuration until coordinates are as near to wanted values as loops allow.

    Args:
        evaluation: left at the configuration returned.
        q: (nq,) a closed configuration.
        free: (nv,) the velocities that may move.
        wanted: values by coordinate [rad, m].
        tolerance: to which loops are closed.
        pinned: as for `can_stand`.

    Returns:
        The configuration and its closure error.
    """
    goal = _CoordinateGoal(evaluation, free, wanted, pinned)
    evaluation.update(q)
    error, motion = evaluation.closure_error, goal.motion(q)
    slope, step = goal.newton(q)
    for _ in range(NEWTON_STEPS):
        if slope <= TOLERANCES.closed:
            break
        for _ in range(30):
            there, open_by = close(evaluation, pin.integrate(evaluation.model, q, step), free,
                                   tolerance, pinned=pinned)
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


class _CoordinateGoal:
    """How far coordinates are from wanted values, and its derivatives on closed configurations."""

    def __init__(
        self, evaluation: LoopEquations, free: NDArray[np.bool_], wanted: Mapping[str, float],
        pinned: Mapping[str, float],
    ) -> None:
        table = evaluation.mechanism.coordinate_table
        self.evaluation, self.free, self.wanted, self.pinned = evaluation, free, wanted, pinned
        self.scale = evaluation.mechanism.velocity_scale
        self._sizes = np.array([self.scale[table[name].v] for name in wanted])
        self._bent = [(k, table[name]) for k, name in enumerate(wanted) if table[name].q < 0]

    def _gaps(self, q: Array) -> Array:
        """Return (k,) how far each coordinate is from where it should be, scaled."""
        mechanism = self.evaluation.mechanism
        gaps = [coordinate_value(mechanism, mechanism.coordinate_table[name], q) - value
                for name, value in self.wanted.items()]
        return np.array(gaps) / self._sizes

    def motion(self, q: Array) -> float:
        """Return the sum of squares of the gaps."""
        gaps = self._gaps(q)
        return float(gaps @ gaps)

    def newton(self, q: Array) -> tuple[float, Array]:
        """Return the slope of half the motion along closed configurations, and Newton's step (nv,).

        With multipliers m, J^T m = D^T gaps, D the derivative of the coordinates, the second
        derivative along a tangent t is (D t)^2 + gaps bias_D(t) - m bias(t).
        """
        self.evaluation.update(q)
        gaps, rows = self._gaps(q), _rows(self.evaluation, self.wanted)[:, self.free]
        closed = pinned_rows(self.evaluation, self.free, self.pinned)[0]
        svd = decompose(closed)
        multipliers = svd.minimum_norm_transposed(gaps @ rows) if len(closed) else np.empty(0)
        moved = svd.null_space @ rows.T
        slopes = moved @ gaps
        tangents = np.zeros((len(moved), len(self.free)))
        tangents[:, self.free] = svd.null_space
        curvature = moved @ moved.T + self._bending(q, tangents, gaps, multipliers)
        values, vectors = np.linalg.eigh(curvature)
        along = vectors.T @ slopes
        flat = np.abs(values) <= FLAT_CURVATURE * max(1.0, float(np.abs(values).max(initial=0.0)))
        sizes = np.where(flat, 1.0, np.abs(values))  # downhill at saddles too
        step = -(along / sizes) @ vectors.T @ tangents
        step *= min(1.0, TOLERANCES.damped_step / max(float(np.abs(step).max(initial=0.0)), 1e-300))
        return float(np.abs(slopes).max(initial=0.0)), step * self.scale

    def _bending(self, q: Array, tangents: Array, gaps: Array, multipliers: Array) -> Array:
        """Return (d, d) what second derivatives of loops and coordinates add along tangents."""
        bend = self._bending_of_loops(q, tangents, multipliers)
        if not self._bent and not self.pinned:
            return bend
        mechanism, n = self.evaluation.mechanism, self.evaluation.constraints.n_closure
        pinned = [mechanism.coordinate_table[name] for name in self.pinned]

        def along(t: Array) -> float:
            v = self.scale * t
            bent = sum(gaps[k] * coordinate_bias(mechanism, c, q, v) / self.scale[c.v]
                       for k, c in self._bent)
            held = sum(m * coordinate_bias(mechanism, c, q, v) / self.scale[c.v]
                       for m, c in zip(multipliers[n:], pinned, strict=True))
            return float(bent - held)

        return bend + _polar(along, tangents)

    def _bending_of_loops(self, q: Array, tangents: Array, multipliers: Array) -> Array:
        """Return (d, d) less the second derivatives of the loops times their multipliers.

        Differences of the multipliers' forces: the slope that they lead to is exact all the same.
        """
        evaluation, n = self.evaluation, self.evaluation.constraints.n_closure
        found = np.zeros((len(tangents), len(tangents)))
        if not n:
            return found
        for row, t in zip(found, self.scale * tangents, strict=True):
            for sense in (1.0, -1.0):
                evaluation.update(pin.integrate(evaluation.model, q, (sense * ASIDE) * t))
                force = multipliers[:n] @ evaluation.jacobian[:n]
                row -= sense / (2.0 * ASIDE) * (tangents @ force)
        evaluation.update(q)
        return 0.5 * (found + found.T)


def _polar(form: Callable[[Array], float], vectors: Array) -> Array:
    """Return the matrix (d, d) of a quadratic form on vectors (d, n)."""
    d = len(vectors)
    matrix = np.diag([form(t) for t in vectors]) if d else np.zeros((0, 0))
    for i in range(d):
        for j in range(i):
            both = form(vectors[i] + vectors[j])
            matrix[i, j] = matrix[j, i] = 0.5 * (both - matrix[i, i] - matrix[j, j])
    return matrix
