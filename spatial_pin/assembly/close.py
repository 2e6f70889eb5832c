"""Closing loops from a guess with the least motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.kernel.closer import Closed, closer_of
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_gradient
from spatial_pin.mechanism.joint_limits import JointLimit
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
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
) -> Closed:
    """Close loops like `close`, from a mechanism; `reference` are its unwrapping angles."""
    with closer_of(mechanism, pinned) as closer:
        return closer.close(q, free, reference, tolerance, iterations, pinned.values(), cut)


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
