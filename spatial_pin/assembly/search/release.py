"""What the loops do not allow: drivers let go with the least motion, and joint limits kept.

The motion is the sum of squares of how far each driver goes from where it should stand, angles in
rad and slides relative to the characteristic length. Its minimum over the closed configurations is
nearly always a dead centre of the drivers let go, where first derivatives vanish: second ones lead
there. Within joint limits the loops are closed as the sum of squares of what is open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.close import LimitedJoints, close, pinned_rows, scaled_row
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_value
from spatial_pin.mechanism.joint_limits import beyond_limits, joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.least_squares import LeastSquares, beyond, minimised
from spatial_pin.numerics.linalg import Array, decompose, rank
from spatial_pin.numerics.tolerances import TOLERANCES

# Speed of drivers relative to that of all joints at which they stand at a dead centre: loops closed
# to 1e-11 leave its square root at a dead centre, 3e-6.
STANDING_SPEED = 1e-4
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


class _Joints(LimitedJoints, LeastSquares):
    """Joints that move within limits, and values that coordinates are to be near to.

    Args:
        evaluation: the loops.
        free: (nv,) the velocities that may move.
        wanted: values by coordinate [rad, m].
        limits: whether joint limits are kept.
    """

    def __init__(
        self, evaluation: LoopEquations, free: NDArray[np.bool_], wanted: Mapping[str, float],
        limits: bool,
    ) -> None:
        super().__init__(evaluation, free, joint_limits(evaluation.mechanism) if limits else ())
        self.wanted, self.tolerance = wanted, TOLERANCES.round_off

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`: how far coordinates are from where they should be."""
        table, scale = self.mechanism.coordinate_table, self.scale
        return np.array([(coordinate_value(self.mechanism, table[name], x) - value)
                         / scale[table[name].v] for name, value in self.wanted.items()])

    def jacobian(self, x: Array) -> Array:
        """See `LeastSquares`."""
        self.stand(x)
        return _rows(self.evaluation, self.wanted)


class _Released(_Joints):
    """The same while loops are closed.

    Args:
        joints: evaluation, free, wanted and limits, of `_Joints`; loops are closed where it stands.
        tolerance: to which loops are closed.
        pinned: coordinates that are held, of those that are no entries of the configuration.
    """

    def __init__(self, *joints: Any, tolerance: float, pinned: Mapping[str, float]) -> None:
        super().__init__(*joints)
        self._closed_to, self._pinned = tolerance, pinned
        self._open = max(self.evaluation.closure_error, 1e3 * tolerance)

    def constraints(self, x: Array) -> Array:
        """See `LeastSquares`."""
        self.stand(x)
        return pinned_rows(self.evaluation, np.ones(len(self.moves), dtype=bool), self._pinned)[0]

    def corrected(self, x: Array, free: NDArray[np.bool_], off: float) -> Array | None:
        """See `LeastSquares`."""
        there, error = close(self.evaluation, x, free, self._closed_to, pinned=self._pinned)
        return there if error <= self._open else None


class _OpenLoops(_Joints):
    """The same where loops are open: they are to be closed, above all."""

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`."""
        self.stand(x)
        return np.concatenate([self.evaluation.residual, LEAST_MOTION * super().residual(x)])

    def jacobian(self, x: Array) -> Array:
        """See `LeastSquares`."""
        rows = LEAST_MOTION * super().jacobian(x)
        return np.vstack([
            self.evaluation.jacobian[: self.evaluation.constraints.n_closure], rows])


def least_motion(
    evaluation: LoopEquations, q: Array, free: NDArray[np.bool_], wanted: Mapping[str, float],
    tolerance: float, pinned: Mapping[str, float], limits: bool = False,
) -> tuple[Array, float]:
    """Move a closed configuration until coordinates are as near to wanted values as loops allow.

    Args:
        evaluation: left at the configuration returned.
        q: (nq,) a closed configuration.
        free: (nv,) the velocities that may move.
        wanted: values by coordinate [rad, m].
        tolerance: to which loops are closed.
        pinned: as for `can_stand`.
        limits: whether joint limits are kept, within which it is.

    Returns:
        The configuration and its closure error.
    """
    evaluation.update(q)
    problem = _Released(evaluation, free, wanted, limits, tolerance=tolerance, pinned=pinned)
    found = minimised(problem, q, {}).at.x
    evaluation.update(found)
    return found, evaluation.closure_error


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
    problem = _OpenLoops(evaluation, free, let_go, True)
    start = problem.at_bounds(q, beyond(problem.room(q), 0.0, {}))
    at, active, *_ = minimised(problem, start, {})
    return at.x, problem.free(active)
