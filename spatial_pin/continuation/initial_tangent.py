"""The start of a curve of closed configurations: the assembled guess and the tangent there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import Hold, divided
from spatial_pin.assembly.passive_freedoms import moved_bodies
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.continuation.solution_curve import SolutionCurve
from spatial_pin.errors import SingularError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.depending import PartMotion, part_moving_with
from spatial_pin.rates.rates import check_not_held, prescribed_at
from spatial_pin.settings import Accuracy

# Arc length by which a start at a limit of the driver is moved away. Joints are twenty times
# faster than the driver there, and no sample is missed since the path back is followed too.
BESIDE_LIMIT = 0.05


def system_at(
    mechanism: Mechanism, driver: str, guess: Mapping[str, Any] | State | Array | None, hold: Hold
) -> tuple[SquareSystem, State, PartMotion]:
    """Return square system, State and moving part at the assembled guess, `driver` first.

    Where the guess is just a limit of the driver, a point a little further on is taken. Of a
    mechanism that the driver does not determine, it is that of the part that it moves.

    Raises:
        ValueError: the driver is held.
    """
    check_not_held(mechanism, [mechanism.driven_coordinate(driver)], hold)
    state = assembled(mechanism, {}, guess)
    moved = part_moving_with(state, [driver], hold)
    state, hold = moved.state, moved.hold
    mechanism = state.mechanism  # of a rounded file one without the equations that it contradicts
    driven = [mechanism.driven_coordinate(c.name) for c in prescribed_at(state, [driver], hold)]
    still = divided(mechanism, driven, hold)[1]
    try:
        return _square(mechanism, driven, state, still), state, moved
    except SingularError as error:
        singular = error
    for other in mechanism.coordinate_table.values():  # it moves a short distance along the curve
        if other.q < 0 or other in driven or other.v in still:
            continue
        try:
            system = _square(mechanism, [other, *driven[1:]], state, still)
        except SingularError:
            continue
        curve = SolutionCurve(system, Accuracy.named("engineering").tolerance)
        point = curve.settle(state.q, curve.tangent(system.driver_rates()[:, 0]))
        q = curve.ahead(point, BESIDE_LIMIT) if point is not None else None
        if q is not None:
            state = State(mechanism, q, closure_error=curve.evaluation.closure_error,
                          angles=curve.evaluation.angles)
            return _square(mechanism, driven, state, still), state, moved
    raise singular


def _square(
    mechanism: Mechanism, driven: Sequence[Coordinate], state: State, still: Sequence[int]
) -> SquareSystem:
    evaluation = LoopEquations(mechanism)
    evaluation.angle_reference[:] = state.angles
    system = SquareSystem(evaluation, driven, state.q, still)
    system.check_regular(state.q)
    return system


def non_spinning_bodies(system: SquareSystem) -> list[int]:
    """Return the bodies without passive freedoms, resolved or not, at the system's configuration.

    The others need not come back with the loops: what they spin over a turn is no whole one.
    """
    evaluation, mechanism = system.evaluation, system.evaluation.mechanism
    spinning = {joint for joint, _ in evaluation.constraints.idle_axes}
    if len(system.passive):
        spinning |= set(moved_bodies(evaluation, system.passive * system.scale))
    return [i for i in range(mechanism.model.njoints) if i not in spinning]


def body_placements(evaluation: LoopEquations, bodies: list[int]) -> Array:
    """Return the placements of bodies, lengths scaled."""
    scale = np.array([1.0, 1.0, 1.0, evaluation.mechanism.characteristic_length])[:, None]
    return evaluation.placements[bodies] / scale
