"""Guesses: a configuration with named coordinates; and other starts around it."""

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
from spatial_pin.kernel.closer import AT_ONCE, MOST_GROUPS, PerturbedStarts
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

# Most starts with other values of open coordinates. A branch that one start in ten reaches is
# missed by all in 0.2 % of cases.
MAX_STARTS = 60
OPEN = EPS**0.5  # closure error that no round-off explains: half of the digits
# round-off of a coordinate relative to its size: as in `coordinate_round_off`
COORDINATE_ERROR = 4.0 * EPS
# Distance of a branch that is surely the guess's [rad, characteristic lengths]: guesses have two or
# three digits.
NEAR_GUESS = 1e-2
# A named length beyond this may be in another unit [characteristic lengths]: joints move one or
# two, and millimetres for metres are a thousand.
ANOTHER_SIZE = 10.0


class Guess:
    """A start: a configuration, and its named coordinates.

    Args:
        mechanism: the mechanism.
        q: (nq,) the configuration.
        values: of the named coordinates; default: all, at their values in q.

    Attributes:
        names: of these coordinates.
        is_whole: whether these are all.
    """

    def __init__(
        self, mechanism: Mechanism, q: Array, values: Mapping[str, float] | None = None
    ) -> None:
        self.mechanism, self.q, self._values = mechanism, q, values
        self.is_whole = values is None
        self.names = mechanism.coordinates if values is None else tuple(values)

    @cached_property
    def values(self) -> Mapping[str, float]:
        """Named values, by coordinate [rad, m]."""
        if self._values is not None:
            return self._values
        entries = self.q.tolist()
        plain, turning = _spread_indices(self.mechanism)
        named = {name: entries[at] for name, at in plain}
        for names, at, turns in turning:
            components = rotation_components(*entries[turns : turns + 4])
            named |= zip(names, entries[at:turns] + components, strict=True)
        return named


def read_guess(
    mechanism: Mechanism, guess: Mapping[str, Any] | State | Array | None
) -> Guess:
    """Return the guess; angles with too many turns are reduced."""
    if guess is not None:
        return _within_turns(mechanism, _as_given(mechanism, guess))
    return _of_file(mechanism, dict(mechanism.guess))


@made_anew  # as anybody may change it
def _of_file(mechanism: Mechanism, guess: Mapping[str, Any]) -> Guess:
    start = _within_turns(mechanism, _as_given(mechanism, guess))
    start.q.flags.writeable = False
    return start


def _within_turns(mechanism: Mechanism, given: Guess) -> Guess:
    entries = given.q.tolist()
    if not entries or max(max(entries), -min(entries)) * COORDINATE_ERROR <= OPEN:
        return given
    q, turned = given.q.copy(), dict[str, float]()
    for c in periodic(mechanism):
        if COORDINATE_ERROR * abs(entries[c.q]) > OPEN:
            turned[c.name] = math.atan2(math.sin(entries[c.q]), math.cos(entries[c.q]))
            q[c.q] = turned[c.name]
    if given.is_whole:
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
def _spread_indices(
    mechanism: Mechanism,
) -> tuple[list[tuple[str, int]], list[tuple[list[str], int, int]]]:
    """Return names and indices in q of coordinates.

    Of single entries of q; and of joints that turn in space, with the index of the joint and of its
    quaternion.
    """
    starts, table = mechanism.model.idx_qs, mechanism.coordinate_table
    turning = [([c.name for c in components], at, at + len(components) - 3)
               for joint, components in by_joint(mechanism).items() if components[0].q < 0
               for at in [int(starts[mechanism.joint_id(joint)])]]
    return [(c.name, c.q) for c in table.values() if c.q >= 0], turning


class StartSpread(NamedTuple):
    """Spread of further starts around the guess.

    Attributes:
        phase: (MAX_STARTS - 1,) of each: 0 named coordinates fixed, 1 perturbed by up to a radian,
            2 by any angle.
        size: (3, nv) of the steps in each phase.
        first: the first starts of each group of loops, if groups are few; else none.
        lengths: names of named lengths.
    """

    phase: NDArray[np.intp]
    size: Array
    first: PerturbedStarts
    lengths: list[str]


def start_spread(
    mechanism: Mechanism, held: Sequence[str], named: Sequence[str], still: Sequence[int],
    groups: Sequence[LoopGroup],
) -> StartSpread | None:
    """Return the spread of further starts; None if all is fixed.

    Args:
        mechanism: the mechanism.
        held: fixed coordinates.
        named: coordinates fixed in half of the starts. Then they are perturbed too, first by up to
            a radian, at last by any angle, and lengths in proportion.
        still: fixed velocity entries, named or not.
        groups: of loops without common free coordinates.
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
    return StartSpread(phase, size, PerturbedStarts(by_group, NEAR_GUESS, group),
                   [name for name in named if table[name].unit == "m"])


def starts_from(
    mechanism: Mechanism, fixed: Array, held: Mapping[str, float], named: Mapping[str, float],
    spread: StartSpread,
) -> Iterator[Array]:
    """Yield start configurations with the named values of `fixed` (nq,).

    Named lengths far beyond the mechanism's size are reduced in perturbed starts.
    """
    far = far_lengths(mechanism, named, spread)
    near = with_values(mechanism, fixed, {**far, **held}) if far else fixed
    for i in range(0, MAX_STARTS - 1, AT_ONCE):
        phase = spread.phase[i : i + AT_ONCE]
        steps = _draws(mechanism)[i : i + AT_ONCE] * spread.size[phase]
        with kernel_of(mechanism) as kernel:
            moved = kernel.displaced(np.array([fixed, near, near])[phase], steps)
        yield from moved


def far_lengths(
    mechanism: Mechanism, named: Mapping[str, float], spread: StartSpread
) -> dict[str, float]:
    """Return the named lengths far beyond the mechanism's size, reduced."""
    far = ANOTHER_SIZE * mechanism.characteristic_length
    return {name: math.copysign(far, named[name])
            for name in spread.lengths if abs(named[name]) > far}


@made_once
def _draws(mechanism: Mechanism) -> Array:
    """Return the random numbers (MAX_STARTS - 1, nv) in [-1, 1] of the further starts."""
    shape = MAX_STARTS - 1, mechanism.model.nv
    return np.random.default_rng(20110).uniform(-1.0, 1.0, shape)
