"""Closed configurations followed while dimensions change and drivers are fixed.

The engine of `continuation` follows one model; here every step is another model. A test compares
the two. Usually one step is enough, and its cost is the loading of a file. The branch between two
sets of dimensions follows the straight line between them. It ends where the loops lose rank.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spatial_pin.assembly.assembly_problem import ACCEPTED
from spatial_pin.assembly.close import close
from spatial_pin.assembly.start_values import nearest_turn
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.files import load
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import coordinate_round_off, with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import decompose, determinant_sign_of, independent_rows
from spatial_pin.settings import Accuracy

# Largest change of a coordinate in one step [rad, characteristic lengths]: Newton's method starts
# at the last step, and its linear terms are then wrong by a twentieth.
FARTHEST_COORDINATE = 0.3
# shortest step, as a part of the change of dimensions: if a hundredth of it moves joints too far,
# the branch ends
SHORTEST_PART = 2.0**-7


def varied(mechanism: Mechanism, dimensions: Mapping[str, float]) -> Mechanism:
    """Return the mechanism with some dimensions changed, loaded again from its files."""
    if mechanism.path is None:
        raise SpatialPinError(f"mechanism {mechanism.name!r} has no file to change dimensions in")
    return load(mechanism.path, **{**mechanism.loading, **dimensions})


def followed(mechanism: Mechanism, drivers: Mapping[str, float], near: State) -> State:
    """Return the closed configuration of a mechanism on the branch of one with other dimensions.

    The dimensions change along a straight line. One step is enough if no coordinate moves by more
    than 0.3 rad or characteristic lengths; else there are more. The determinant of the independent
    rows of the loops keeps its sign from step to step. Drivers have the given values [rad, m].
    """
    drivers = {mechanism.driven_coordinate(name).name: x for name, x in drivers.items()}
    if mechanism.coordinates != near.mechanism.coordinates:
        raise SpatialPinError(f"mechanism {mechanism.name!r} has other coordinates at dimensions "
                              f"{dict(mechanism.parameters)}")
    state, done, part = near, 0.0, 1.0
    begin, end = near.mechanism.dimensions, mechanism.dimensions
    changed = {name: (begin.get(name, x), x) for name, x in end.items() if begin.get(name, x) != x}
    while done < 1.0:
        goal = min(1.0, done + part)
        there = mechanism if goal == 1.0 else varied(
            mechanism, {name: a + goal * (b - a) for name, (a, b) in changed.items()})
        ahead = _step(state, there, drivers)
        if ahead is not None:
            state, done, part = ahead, goal, 2.0 * part
        elif part > SHORTEST_PART and changed:
            part *= 0.5
        else:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: no closed configuration of this branch at "
                f"dimensions {dict(mechanism.parameters)}; it ends {done:.2g} of the way to them")
    return state


def _step(state: State, there: Mechanism, drivers: Mapping[str, float]) -> State | None:
    """Return the closed configuration next to a state; None if it may be of another branch."""
    near = state.mechanism
    values = {c.name: float(state.q[c.q]) for c in near.coordinate_table.values() if c.q >= 0}
    free = np.ones(near.model.nv, dtype=bool)
    free[[near.coordinate_table[name].v for name in drivers]] = False
    accuracy = Accuracy.named("engineering")
    with loops_of(near, state.angles) as evaluation:
        evaluation.update(state.q)
        jacobian = evaluation.jacobian[: evaluation.constraints.n_closure, free]
        rows = independent_rows(jacobian)
        spare = decompose(jacobian[rows]).null_space
        before = determinant_sign_of(np.vstack([jacobian[rows], spare]))
    with loops_of(there, state.angles) as evaluation:
        q = with_values(there, state.q, dict(drivers))
        q, error = close(evaluation, q, free, accuracy.tolerance)
        q = nearest_turn(there, q, drivers, values)
        evaluation.update(q)
        if not error <= max(ACCEPTED, coordinate_round_off(there, q)) or evaluation.mirrored():
            return None
        table = [c for c in there.coordinate_table.values() if c.q >= 0]
        if any(abs(q[c.q] - state.q[c.q]) / there.velocity_scale[c.v] > FARTHEST_COORDINATE
               for c in table):
            return None
        jacobian = evaluation.jacobian[: evaluation.constraints.n_closure, free]
        after = determinant_sign_of(np.vstack([jacobian[rows], spare]))
        if after != before:
            return None
        return State(there, q, closure_error=evaluation.closure_error, angles=evaluation.angles)
