"""What the loops do not allow: drivers let go with the least motion, and joint limits kept.

The motion is the sum of squares of how far each driver goes from where it should stand, angles in
rad and slides relative to the characteristic length. Newton's method finds its minimum over the
closed configurations with the second derivatives of the loops: that minimum is nearly always a dead
centre of the drivers let go, where first derivatives vanish. Within joint limits the loops are
closed by bounded least squares.
"""


from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close, pinned_rows, scaled_row
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_bias, coordinate_value
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
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
# Weight of the motion of drivers against open loops, where limits are looked for: it leaves loops
# open by its square, 1e-6 of a characteristic length or radian, which closing them takes away.
LEAST_MOTION = 1e-3


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
        d, found = len(tangents), np.zeros_like(bend)
        pinned = [mechanism.coordinate_table[name] for name in self.pinned]

        def along(t: Array) -> float:
            v = self.scale * t
            bent = sum(gaps[k] * coordinate_bias(mechanism, c, q, v) / self.scale[c.v]
                       for k, c in self._bent)
            held = sum(m * coordinate_bias(mechanism, c, q, v) / self.scale[c.v]
                       for m, c in zip(multipliers[n:], pinned, strict=True))
            return float(bent - held)

        for i in range(d):
            found[i, i] = along(tangents[i])
        for i in range(d):  # the form's polar form
            for j in range(i):
                both = along(tangents[i] + tangents[j])
                found[i, j] = found[j, i] = 0.5 * (both - found[i, i] - found[j, j])
        return bend + found

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


def violated_limit(
    mechanism: Mechanism, q: Array, entries: NDArray[np.bool_] | None = None
) -> str:
    """Return which joint limit q breaks, of some velocities (nv,), as text; empty when none."""
    for name, by in beyond_limits(mechanism, q).items():
        c = mechanism.coordinate_table[name]
        is_looked_at = entries is None or entries[c.v]
        least = 1e-9 * max(mechanism.velocity_scale[c.v], abs(q[c.q]))
        if is_looked_at and abs(by) > least:
            return f"limit of {beyond_words(mechanism, q, name)}"
    return ""


def beyond_words(mechanism: Mechanism, q: Array, name: str) -> str:
    """Return a coordinate, its value and its range."""
    c, model = mechanism.coordinate_table[name], mechanism.model
    low, high = float(model.lowerPositionLimit[c.q]), float(model.upperPositionLimit[c.q])
    return f"{name}: {q[c.q]:.6g} {c.unit} is not in [{low:.6g}, {high:.6g}]"


def within_limits(
    evaluation: LoopEquations, q: Array, free: NDArray[np.bool_], let_go: Mapping[str, float]
) -> tuple[Array, NDArray[np.bool_]]:
    """Close the loops within the joint limits by bounded least squares, nearly.

    Args:
        evaluation: of the mechanism.
        q: where to start.
        free: (nv,) the velocities that may move.
        let_go: drivers that are to go as little as possible from these values.

    Returns:
        The configuration, and the velocities that no limit stops there (nv,).
    """
    if not np.any(free):
        return q, free.copy()
    from scipy.optimize import least_squares

    mechanism, model = evaluation.mechanism, evaluation.model
    n, scale = evaluation.constraints.n_closure, mechanism.velocity_scale
    low, high = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    start = q.copy()
    for c in mechanism.coordinate_table.values():
        if c.q >= 0 and free[c.v]:
            start[c.q] = np.clip(q[c.q], model.lowerPositionLimit[c.q],
                                 model.upperPositionLimit[c.q])
            low[c.v] = model.lowerPositionLimit[c.q] - start[c.q] - 1e-12
            high[c.v] = model.upperPositionLimit[c.q] - start[c.q] + 1e-12
    gone = [mechanism.driven_coordinate(name) for name in let_go]
    pull = LEAST_MOTION * np.eye(model.nv)[[c.v for c in gone]][:, free] / scale[free]
    wanted = np.array(list(let_go.values()), dtype=float)

    def at(x: Array) -> Array:
        step = np.zeros(model.nv)
        step[free] = x
        return pin.integrate(model, start, step)

    def residual(x: Array) -> Array:
        there = at(x)
        evaluation.update(there)
        gaps = (there[[c.q for c in gone]] - wanted) / scale[[c.v for c in gone]]
        return np.concatenate([evaluation.residual, LEAST_MOTION * gaps])

    def jacobian(x: Array) -> Array:  # exact for coordinates with limits, near zero for the rest
        evaluation.update(at(x))
        return np.vstack([evaluation.jacobian[:n, free] / scale[free], pull])

    fit = least_squares(residual, np.zeros(int(free.sum())), jacobian,
                        bounds=(low[free], high[free]), x_scale=scale[free],
                        xtol=1e-15, ftol=1e-15, gtol=1e-15)
    loose = free.copy()
    loose[free] = (fit.x > low[free] + 1e-9) & (fit.x < high[free] - 1e-9)
    return at(fit.x), loose
