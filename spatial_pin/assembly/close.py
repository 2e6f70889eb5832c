"""Closing loops with the least motion, with released drivers, and within joint limits.

Released drivers have the least sum of squares of their displacements, angles in rad and slides
relative to the characteristic length. The minimum over closed configurations is nearly always a
dead centre of these drivers, where first derivatives vanish; second ones lead there. Within joint
limits, the loops are closed by least squares of their residuals.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.kernel.closer import ClosureResult, ClosureSettings, closer_of
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_gradient, coordinate_value
from spatial_pin.mechanism.joint_limits import JointLimit, beyond_limits, joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.least_squares import LeastSquares, beyond, minimised
from spatial_pin.numerics.linalg import Array, decompose, rank
from spatial_pin.numerics.tolerances import TOLERANCES

# Most damped steps. From random starts of `delta` 57 % close in 60 steps, 75 % in 120: another
# start is worth more than more steps.
DAMPED_STEPS = 60
NOTHING: Mapping[str, float] = MappingProxyType({})


def close(
    evaluation: LoopEquations,
    q: Array,
    free: NDArray[np.bool_],
    tolerance: float,
    iterations: int = DAMPED_STEPS,
    pinned: Mapping[str, float] = NOTHING,
    cut: float = TOLERANCES.rank,
) -> tuple[Array, float]:
    """Close the loops from q (nq,) by least motion of `free`; return configuration and error.

    Damped steps, then undamped least-norm steps down to round-off, see `kernel/closing/closing.c`.
    If frames of closures are turned far against each other, the logarithms of their rotations are
    solved first: products would lead to mirror images. `pinned` coordinates have their values
    exactly: components of balls and floating joints, which are no velocity entries. Singular values
    below `cut` times the largest are ignored: their rows are closed as well as the others allow.

    Returns:
        The configuration and its closure error, small or not; `evaluation` is at it.

    Raises:
        SingularError: positions have become infinite.
    """
    q = closed(evaluation.mechanism, q, free, evaluation.angle_reference, tolerance, iterations,
               pinned, cut).q
    evaluation.update(q)
    return q, evaluation.closure_error


def closed(
    mechanism: Mechanism,
    q: Array,
    free: NDArray[np.bool_],
    reference: Array,
    tolerance: float,
    iterations: int = DAMPED_STEPS,
    pinned: Mapping[str, float] = NOTHING,
    cut: float = TOLERANCES.rank,
) -> ClosureResult:
    """Close loops like `close`, from a mechanism; `reference` are its unwrapping angles."""
    with closer_of(mechanism, pinned) as closer:
        how = ClosureSettings(free, None, tolerance, iterations, cut)
        return closer.solve([q], how, None, reference, pinned.values())[0]


class LimitedJoints:
    """Joints within limits, and the loops that they close; steps are scaled.

    Attributes:
        evaluation: the closure equations.
        mechanism: their mechanism.
        moves: (nv,) free velocities.
        scale: (nv,) velocity of a unit of each unknown.
        limits: joint limits, by index in the velocity and side, 1 the upper one.
    """

    def __init__(
        self, evaluation: LoopEquations, moves: NDArray[np.bool_], limits: Iterable[JointLimit]
    ) -> None:
        self.evaluation, self.mechanism, self.moves = evaluation, evaluation.mechanism, moves
        self.scale = self.mechanism.velocity_scale
        self.limits = {(x.v, int(x.side > 0)): x for x in limits if moves[x.v]}
        own = self.limits.values()
        self._at = np.array([x.q for x in own], dtype=np.intp)
        self._entries = np.array([*self.limits], dtype=np.intp).reshape(-1, 2)
        self._sides = np.array([x.side / x.size for x in own])
        self._ends = np.array([x.side * x.value / x.size for x in own])

    def update(self, q: Array) -> None:
        """Evaluate the equations at q (nq,), unless they are there."""
        if self.evaluation.q is not q:
            self.evaluation.update(q)

    def displaced(self, x: Array, step: Array) -> Array:
        """Return the configuration (nq,) after a step (nv,), with open loops."""
        moved: Array = pin.integrate(self.evaluation.model, x, self.scale * step)
        return moved

    def room(self, x: Array) -> Array:
        """Return distances of coordinates from their limits (2, nv), the lower ones first."""
        room = np.full((2, len(self.scale)), np.inf)
        room[self._entries[:, 1], self._entries[:, 0]] = self._ends - self._sides * x[self._at]
        return room

    def at_bounds(self, x: Array, active: Mapping[int, int]) -> Array:
        """Return x (nq,) with joints at the active limits."""
        x = x.copy()
        for limit in self.limits_of(active):
            x[limit.q] = limit.value
        return x

    def limits_of(self, active: Mapping[int, int]) -> tuple[JointLimit, ...]:
        """Return the active limits."""
        return tuple(self.limits[x] for x in active.items())


def pinned_rows(
    evaluation: LoopEquations, free: NDArray[np.bool_], pinned: Iterable[str]
) -> tuple[Array, Array]:
    """Return the closure equations for the `free` velocities, scaled, and their residual.

    Rows of pinned coordinates, with zero residual, come last.
    """
    n, mechanism = evaluation.constraints.n_closure, evaluation.mechanism
    rows = evaluation.jacobian[:n, free]
    if not pinned:
        return rows, evaluation.residual
    more = [scaled_row(mechanism, mechanism.coordinate_table[name], evaluation.q)[free]
            for name in pinned]
    return np.vstack([rows, *more]), np.append(evaluation.residual, np.zeros(len(more)))


def scaled_row(mechanism: Mechanism, coordinate: Coordinate, q: Array) -> Array:
    """Return the derivative (nv,), in scaled velocities, of a coordinate relative to its size."""
    size = mechanism.velocity_scale
    return coordinate_gradient(mechanism, coordinate, q) * size / size[coordinate.v]


# Speed of drivers at a dead centre, relative to that of all joints: loops closed to 1e-11 give its
# square root, 3e-6.
LEAST_SPEED = 1e-4
# Weight of driver motion against open loops within limits: it leaves loops open by its square, 1e-6
# characteristic lengths or radians, which the final closing removes.
LEAST_MOTION = 1e-3


def can_be_fixed(
    evaluation: LoopEquations, free: NDArray[np.bool_], standing: Mapping[str, float],
    pinned: Mapping[str, float],
) -> bool:
    """Whether drivers are independent of each other and of the loops at the evaluation.

    It is at a closed configuration, with other free velocities (nv,) and fixed components `pinned`
    of balls and floating joints.
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
    """Whether drivers move all freedoms at the evaluation, or each can move by itself.

    For `pinned` see `can_be_fixed`.
    """
    null_space = decompose(pinned_rows(evaluation, free, pinned)[0]).null_space
    moved = null_space @ _rows(evaluation, drivers)[:, free].T
    return bool(decompose(moved).s.min(initial=1.0) > LEAST_SPEED)


class _Joints(LimitedJoints, LeastSquares):
    """Joints within limits, with wanted values by coordinate [rad, m]."""

    def __init__(
        self, evaluation: LoopEquations, free: NDArray[np.bool_], wanted: Mapping[str, float],
        limits: bool,
    ) -> None:
        super().__init__(evaluation, free, joint_limits(evaluation.mechanism) if limits else ())
        self.wanted, self.tolerance = wanted, TOLERANCES.round_off

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`: deviations of coordinates from their wanted values."""
        table, scale = self.mechanism.coordinate_table, self.scale
        return np.array([(coordinate_value(self.mechanism, table[name], x) - value)
                         / scale[table[name].v] for name, value in self.wanted.items()])

    def jacobian(self, x: Array) -> Array:
        """See `LeastSquares`."""
        self.update(x)
        return _rows(self.evaluation, self.wanted)


class _Released(_Joints):
    """The same with closed loops, as they are at the evaluation of the joints."""

    def __init__(self, *joints: Any, tolerance: float, pinned: Mapping[str, float]) -> None:
        super().__init__(*joints)
        self._closed_to, self._pinned = tolerance, pinned
        self._open = max(self.evaluation.closure_error, 1e3 * tolerance)

    def constraints(self, x: Array) -> Array:
        """See `LeastSquares`."""
        self.update(x)
        return pinned_rows(self.evaluation, np.ones(len(self.moves), dtype=bool), self._pinned)[0]

    def corrected(self, x: Array, free: NDArray[np.bool_], off: float) -> Array | None:
        """See `LeastSquares`."""
        there, error = close(self.evaluation, x, free, self._closed_to, pinned=self._pinned)
        return there if error <= self._open else None


class _OpenLoops(_Joints):
    """The same with open loops, whose residuals dominate."""

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`."""
        self.update(x)
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

    q (nq,) is closed; `limits`: whether to stay within joint limits. The evaluation is left at the
    result.

    Returns:
        The configuration and its closure error.
    """
    evaluation.update(q)
    problem = _Released(evaluation, free, wanted, limits, tolerance=tolerance, pinned=pinned)
    nearest = minimised(problem, q, {}).at.x
    evaluation.update(nearest)
    return nearest, evaluation.closure_error


def violated_limit(
    mechanism: Mechanism, q: Array, entries: NDArray[np.bool_] | None = None
) -> str:
    """Return the joint limit that q violates, of some velocities (nv,), as text; "" if none."""
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
    """Close the loops within the joint limits by bounded least squares, approximately.

    Drivers in `let_go` move as little as possible from these values.

    Returns:
        The configuration, and the velocities without active limits (nv,).
    """
    problem = _OpenLoops(evaluation, free, let_go, True)
    start = problem.at_bounds(q, beyond(problem.room(q), 0.0, {}))
    at, active, *_ = minimised(problem, start, {})
    return at.x, problem.free(active)
