"""What a guess says: a configuration, and which of it somebody named; and starts elsewhere."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import cached_property, made_anew, made_once
from spatial_pin.assembly.search.loop_groups import LoopGroup
from spatial_pin.assembly.search.whole_turns import periodic
from spatial_pin.assembly.state import State
from spatial_pin.kernel.closer import AT_ONCE, MOST_GROUPS, FurtherStarts
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.mechanism.coordinates import (
    by_joint,
    finite_array,
    joint_values,
    rotation_components,
    with_values,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array

# Starts from other values of what the guess leaves open, before giving up: a branch that one start
# in ten closes on is missed by all in 0.2 % of cases.
MAX_STARTS = 60
OPEN = EPS**0.5  # closure error that no round-off excuses: half of the digits
COORDINATE_ERROR = 4.0 * EPS  # of a coordinate relative to its size: as `coordinate_round_off`
# A branch this near to the guess [rad, characteristic lengths] is not questioned: guesses have two
# or three digits.
NEAR_GUESS = 1e-2
# Characteristic lengths; a length named beyond them may be that of another size: joints go one or
# two, and millimetres for metres are a thousand.
ANOTHER_SIZE = 10.0


class Guess:
    """Where to start: the configuration, and the coordinates in it that somebody named.

    Args:
        mechanism: the mechanism.
        q: (nq,) the configuration.
        values: of the coordinates that are named; default: all, as they are at q.

    Attributes:
        names: of these coordinates.
    """

    def __init__(
        self, mechanism: Mechanism, q: Array, values: Mapping[str, float] | None = None
    ) -> None:
        self.mechanism, self.q, self._values = mechanism, q, values
        self.names = _all_names(mechanism) if values is None else tuple(values)

    @cached_property
    def values(self) -> Mapping[str, float]:
        """What is named, by coordinate [rad, m]."""
        if self._values is not None:
            return self._values
        entries = self.q.tolist()
        plain, turning = _places(self.mechanism)
        named = {name: entries[at] for name, at in plain}
        for names, at, turns in turning:
            components = rotation_components(*entries[turns : turns + 4])
            named |= zip(names, entries[at:turns] + components, strict=True)
        return named


def read_guess(
    mechanism: Mechanism, guess: Mapping[str, Any] | State | Array | None
) -> Guess:
    """Return the guess with its angles taken to a turn where they count too many."""
    if guess is not None:
        return _within_turns(mechanism, _as_given(mechanism, guess))
    return _of_file(mechanism, dict(mechanism.guess))


@made_anew  # as anybody may change it
def _of_file(mechanism: Mechanism, guess: Mapping[str, Any]) -> Guess:
    found = _within_turns(mechanism, _as_given(mechanism, guess))
    found.q.flags.writeable = False
    return found


def _within_turns(mechanism: Mechanism, given: Guess) -> Guess:
    entries = given.q.tolist()
    if not entries or max(max(entries), -min(entries)) * COORDINATE_ERROR <= OPEN:
        return given
    q, turned = given.q.copy(), dict[str, float]()
    for c in periodic(mechanism):
        if COORDINATE_ERROR * abs(entries[c.q]) > OPEN:
            turned[c.name] = math.atan2(math.sin(entries[c.q]), math.cos(entries[c.q]))
            q[c.q] = turned[c.name]
    if given.names is _all_names(mechanism):
        return Guess(mechanism, q)
    return Guess(mechanism, q, {k: turned.get(k, x) for k, x in given.values.items()})


def _as_given(mechanism: Mechanism, guess: Mapping[str, Any] | State | Array) -> Guess:
    if isinstance(guess, State):
        own = guess.mechanism
        if own is not mechanism and own.coordinates != mechanism.coordinates:
            raise ValueError(
                f"the guess is a state of mechanism {guess.mechanism.name!r}, which has other "
                f"coordinates than {mechanism.name!r}"
            )
        q = guess.q
    elif isinstance(guess, Mapping):
        base, named = joint_values(mechanism, mechanism.guess), joint_values(mechanism, guess)
        return Guess(mechanism, with_values(mechanism, mechanism.neutral, base | named), named)
    else:
        q = finite_array(guess, (mechanism.model.nq,), "guess q")
        if not pin.isNormalized(mechanism.model, q, 0.5):
            raise ValueError("guess q has a quaternion whose length is far from 1")
    return Guess(mechanism, pin.normalize(mechanism.model, q))


@made_once
def _all_names(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the names of all coordinates, every time the same tuple."""
    return mechanism.coordinates


@made_once
def _places(
    mechanism: Mechanism,
) -> tuple[list[tuple[str, int]], list[tuple[list[str], int, int]]]:
    """Return names and places in q of coordinates.

    Of those that are entries of q; and of joints that turn in space, where these begin and where
    their quaternion does.
    """
    starts, table = mechanism.model.idx_qs, mechanism.coordinate_table
    turning = [([c.name for c in found], at, at + len(found) - 3)
               for joint, found in by_joint(mechanism).items() if found[0].q < 0
               for at in [int(starts[mechanism.joint_id(joint)])]]
    return [(c.name, c.q) for c in table.values() if c.q >= 0], turning


class Further(NamedTuple):
    """How far further starts are from what the guess says.

    Attributes:
        phase: (MAX_STARTS - 1,) of each: 0 where what is named stays, 1 where it is shaken by up
            to a radian, 2 by any angle.
        size: (3, nv) of the steps in each.
        first: the first of each group of loops, where groups are few; else none.
        lengths: names of those that are named.
    """

    phase: NDArray[np.intp]
    size: Array
    first: FurtherStarts
    lengths: list[str]


def further_starts(
    mechanism: Mechanism, held: Sequence[str], named: Sequence[str], still: Sequence[int],
    groups: Sequence[LoopGroup],
) -> Further | None:
    """Return how far further starts are; None where all is held.

    Args:
        mechanism: the mechanism.
        held: coordinates that stay.
        named: coordinates that stay in half of the starts. Then they are shaken too, first by up
            to a radian, in the end by any angle, and lengths in proportion.
        still: velocity entries that stay too, named or not.
        groups: of loops that share nothing else.
    """
    table = mechanism.coordinate_table
    is_held = np.array([name in held or c.v in still for name, c in table.items()], dtype=bool)
    if is_held.all():
        return None
    is_named = ~is_held & np.array([name in named for name in table], dtype=bool)
    is_angle = np.array([c.unit == "rad" for c in table.values()], dtype=bool)
    open_ones = ~is_held & ~is_named
    sizes = np.where(is_angle, 1.0, mechanism.velocity_scale * 0.2)
    reach = np.where(open_ones, np.pi, 0.0)
    n, late = MAX_STARTS // 2 if open_ones.any() else 0, 3 * MAX_STARTS // 4 - 1
    phase = np.repeat([0, 1, 2], [n, late - n, MAX_STARTS - 1 - late])
    size = np.array([np.where(is_named, shake, reach) * sizes for shake in (0.0, 1.0, np.pi)])
    steps = _draws(mechanism)[:AT_ONCE] * size[phase[:AT_ONCE]]
    group = np.zeros(steps.shape[1], np.int64)
    by_group = steps[None]  # of each group of loops by itself, if these are few
    if len(groups) > MOST_GROUPS:
        by_group = np.empty((0, *steps.shape))
    elif len(groups) > 1:
        by_group = np.array([steps * own.entries for own in groups])
        for k, own in enumerate(groups):
            group[own.entries] = k
    return Further(phase, size, FurtherStarts(by_group, NEAR_GUESS, group),
                   [name for name in named if table[name].unit == "m"])


def starts_from(
    mechanism: Mechanism, fixed: Array, held: Mapping[str, float], named: Mapping[str, float],
    further: Further,
) -> Iterator[Array]:
    """Yield start configurations that keep what a guess names: it has its values in `fixed` (nq,).

    Named lengths far beyond the mechanism's size are cut where they are shaken.
    """
    far = far_ones(mechanism, named, further)
    near = with_values(mechanism, fixed, {**far, **held}) if far else fixed
    for i in range(0, MAX_STARTS - 1, AT_ONCE):
        phase = further.phase[i : i + AT_ONCE]
        steps = _draws(mechanism)[i : i + AT_ONCE] * further.size[phase]
        with kernel_of(mechanism) as kernel:
            moved = kernel.displaced(np.array([fixed, near, near])[phase], steps)
        yield from moved


def far_ones(
    mechanism: Mechanism, named: Mapping[str, float], further: Further
) -> dict[str, float]:
    """Return the named lengths far beyond the mechanism's size, cut to what is just as far."""
    far = ANOTHER_SIZE * mechanism.characteristic_length
    return {name: math.copysign(far, named[name])
            for name in further.lengths if abs(named[name]) > far}


@made_once
def _draws(mechanism: Mechanism) -> Array:
    """Return the random numbers (MAX_STARTS - 1, nv) in [-1, 1] of the further starts."""
    shape = MAX_STARTS - 1, mechanism.model.nv
    return np.random.default_rng(20110).uniform(-1.0, 1.0, shape)
