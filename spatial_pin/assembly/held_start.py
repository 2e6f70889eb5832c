"""Start states of verbs: from a guess, or the first state of a motion with fixed coordinates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import BASE, Hold, held_by
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.errors import AssemblyError
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

Guess = Mapping[str, Any] | State | Array | None


def starting_state(mechanism: Mechanism, guess: Guess, state: Guess = None) -> State:
    """Return the state of a guess, closed if it is not a State.

    Args:
        mechanism: the mechanism.
        guess: as for `assemble`; a State is used as it is.
        state: another name of `guess`.

    Raises:
        AssemblyError: the guess does not close.
        TypeError: both are given.
    """
    if guess is not None and state is not None:
        raise TypeError("guess and state are two words for where to start: give one of them")
    start = state if guess is None else guess
    if isinstance(start, State):
        return of_mechanism(mechanism, start)
    return assembled(mechanism, {}, start)


def held_start(
    mechanism: Mechanism, values: Mapping[str, float],
    guess: Mapping[str, Any] | State | Array | None, hold: Hold, accuracy: Accuracy,
) -> tuple[State, list[str]]:
    """Assemble a State at driver values, with `hold` at the values of the guess.

    These values are exact if the guess is a State and the loops close so; otherwise the coordinates
    are released, after the drivers without a value. With another guess, they keep their assembled
    values.

    Args:
        mechanism: the mechanism.
        values: of drivers or coordinates by name [rad or m].
        guess: start of the assembly.
        hold: names of fixed coordinates, see `holding.held_by`.
        accuracy: of assembly.

    Returns:
        The State, and a sentence for each joint that is not at the value of the guess.

    Raises:
        AssemblyError: the values cannot be assembled.
    """
    if not isinstance(guess, State):
        return assembled(mechanism, values, guess, accuracy=accuracy), []
    held = {c.name: guess.coordinate(c.name).value
            for c in held_coordinates(mechanism, values, hold)
            if c.name in guess.mechanism.coordinate_table}
    if held:
        try:
            return assembled(mechanism, {**values, **held}, guess, accuracy=accuracy), []
        except AssemblyError:
            pass  # they are released, and the result says how far they went
    state = assembled(mechanism, values, guess, accuracy=accuracy)
    drivers = driver_coordinates(mechanism)
    texts, released = [], {drivers[name].name for name in state.released}
    for name in [name for name in held if name not in released]:
        coordinate = state.mechanism.coordinate(name)
        by = state.coordinate(name).value - held[name]
        if abs(by) > TOLERANCES.half_precision * state.mechanism.velocity_scale[coordinate.v]:
            texts.append(f"{name} is held {by:+.9g} {coordinate.unit} from where the guess has it, "
                         "as the loops would not close otherwise")
    return state, texts


def held_coordinates(
    mechanism: Mechanism, values: Iterable[str], hold: Hold
) -> list[Coordinate]:
    """Return the coordinates of `hold`, except free bases and coordinates with a value."""
    given = [mechanism.prescribed_coordinate(name) for name in values]
    held = held_by(mechanism, hold, given)
    base = held_by(mechanism, BASE, given).entries
    return [c for c in mechanism.coordinate_table.values()
            if ((c.q >= 0 and c.v in held.entries and c.v not in base) or c in held.coordinates)
            and c not in given]
