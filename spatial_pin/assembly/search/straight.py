"""Assembly where the guess leads straight to a configuration with nothing to decide.

It is the first attempt of `search.Search`, the rule rather than the exception: what names alone
decide is worked out once, so that an assembly of few loops costs little more than their closing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.search.closing import ACCEPTED
from spatial_pin.assembly.search.closure_settings import Left, asked_of, left_of
from spatial_pin.assembly.search.counted_turns import uncounted
from spatial_pin.assembly.search.guesses import (
    ANOTHER_SIZE,
    COORDINATE_ERROR,
    NEAR_GUESS,
    OPEN,
    Guess,
)
from spatial_pin.assembly.search.search import is_nearer
from spatial_pin.assembly.state import State, made
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.closer import MOST_GROUPS, closer_of
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy


class AssemblyPlan(NamedTuple):
    """What names alone decide of an assembly.

    Attributes:
        left: what may move.
        places: in q, of what is given a value.
        lengths: places in q of named lengths, which may be those of another size beyond `far`.
        far: where that begins [m].
        largest: entry of q that surely has a digit of its place left.
    """

    left: Left
    places: list[int]
    lengths: list[int]
    far: float
    largest: float

    def start(self, guess: Guess, values: Iterable[float]) -> Array | None:
        """Return the guess (nq,) with values of what is held; None if lengths are out of range."""
        q = guess.q.copy()
        for at, value in zip(self.places, values, strict=True):
            q[at] = value
        entries = q.tolist()
        if max(entries) > self.largest or min(entries) < -self.largest:
            return None
        if self.lengths and any(abs(entries[at]) > self.far for at in self.lengths):
            return None
        return q


def straight(
    mechanism: Mechanism, held: Mapping[str, float], guess: Guess, release: bool,
    accuracy: Accuracy, angles: Array,
) -> State | None:
    """Close the loops from a guess; None where a search has more to look at.

    Args:
        mechanism: the mechanism.
        held: coordinates that are given values.
        guess: where to start: the file's, or a whole configuration.
        release: whether drivers that the guess leaves out may go with the loops.
        accuracy: tolerance to reach.
        angles: (n_angles,) that screws count turns from [rad]; of another size: from zero.
    """
    plan = straight_plan(mechanism, tuple(held), guess.names, release)
    q = None if plan is None else plan.start(guess, held.values())
    if plan is None or q is None:
        return None
    shaken = plan.left.further is not None
    with closer_of(mechanism) as closer:
        asked, n = asked_of(mechanism, plan.left, accuracy.tolerance), closer.kernel.n_angles
        reference = angles if n and angles.size == n else 0.0
        found = closer.reach([q], asked, q, reference, shaken=shaken)
        best = found[0]
        for place in found:
            if place.error <= ACCEPTED and not place.may_be_mirrored:
                best = place if is_nearer(place.distance, best.distance) else best
            elif place is best or not leads_nowhere(accuracy) < place.error < math.inf:
                return None
        seen = best.examined or closer.examine(best.q, reference)
    if len(plan.left.groups) > MOST_GROUPS and best.distance > NEAR_GUESS:
        return None  # each group of loops may have a nearer place
    return made(mechanism, best.q, None, None, closure_error=seen.error, angles=seen.angles)


def leads_nowhere(accuracy: Accuracy) -> float:
    """Return the closure error beyond which no rounding of a file excuses what a start leads to."""
    return max(accuracy.gap, OPEN)


@made_once
def straight_plan(
    mechanism: Mechanism, held: tuple[str, ...], named: tuple[str, ...], release: bool
) -> AssemblyPlan | None:
    """Return what names decide of an assembly; None where more than names does.

    Args:
        mechanism: the mechanism.
        held: coordinates that are given values.
        named: those that the guess names: the file's, or all.
        release: whether drivers that it leaves out may go with the loops.
    """
    table = mechanism.coordinate_table
    drivers = [c.name for c in driver_coordinates(mechanism).values()]
    standing = [name for name in drivers if name not in held]
    if release and {*named} - {*drivers} and not {*named}.issuperset(standing):
        return None  # some may stand where the loops take them
    left = left_of(mechanism, (*held, *standing), (), named, None)
    lengths = [] if left.further is None else left.further.lengths
    places = [mechanism.place_of(table[name]) for name in lengths]
    if uncounted(mechanism, (*held, *standing)).held or any(
            not turns.are_all for turns in constraints_of(mechanism).turns):
        return None  # turns may have to be counted on the way
    if mechanism.whole is not None or left.pinned or not left.is_whole or not mechanism.model.nq:
        return None
    return AssemblyPlan(left, [table[name].q for name in held], places,
                ANOTHER_SIZE * mechanism.characteristic_length,
                float(mechanism.velocity_scale.min()) / COORDINATE_ERROR)
