"""A mechanism at dimensions that are tried, and the motions that demands are about."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.search.whole_turns import nearest_turn
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.dimension_batch import DimensionFamily
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limits import FARTHEST_SLIDE
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array

TURN = 2.0 * np.pi
PER_TURN = 36  # steps of a motion that is looked at
STEP_OF_TURN = TURN / PER_TURN  # ten degrees
# Part of its range that a driver stays short of its limits, where rates are infinite: still nearer
# samples cost ten times as much.
SHORT_OF_LIMITS = 1e-5


class Candidate:
    """A mechanism at some dimensions, with closed configurations.

    Args:
        mechanism: for its motion; its masses and shapes may be those at other dimensions.
        states: closed states.
        whole: the mechanism loaded at these dimensions; default the same one.
        has_masses: whether the mechanism has its masses.
    """

    def __init__(
        self, mechanism: Mechanism, states: tuple[State, ...],
        whole: Callable[[], Mechanism] | None = None, has_masses: bool = True,
    ) -> None:
        self.mechanism, self.states, self._whole = mechanism, states, whole
        self.has_masses = has_masses
        self._motions: dict[Any, tuple[Motion, bool]] = {}

    @classmethod
    def of(cls, family: DimensionFamily, dimensions: Array, near: State, samples: Any) -> Candidate:
        """Return the candidate at dimensions.

        Args:
            family: of mechanisms.
            dimensions: (n,) of one.
            near: a closed state at other dimensions.
            samples: closed configurations of goals of precision, if there are any.

        Raises:
            SpatialPinError: there is none, or it does not close.
        """
        names = dict(zip(family.names, dimensions.tolist(), strict=True))
        there = family.variants.at(names)
        if samples:
            states = [State(there, in_own_turn(there, q), closure_error=0.0, angles=a)
                      for s in samples for q, a in zip(s.q, s.angles, strict=True)]
        else:
            states = [_closed(there, near)]
        return cls(there, tuple(states), lambda: family.variants.whole(names),
                   family.variants.has_masses)

    @cached_property
    def whole(self) -> Mechanism:
        """The mechanism with its masses and shapes."""
        return self.mechanism if self._whole is None else self._whole()

    def motion(self, driver: str, values: Array | None, whole: bool = False) -> tuple[Motion, bool]:
        """Return the motion that a demand is about, and whether the driver turns all the way.

        Args:
            driver: what moves it.
            values: (k,) where; None: a turn, or from limit to limit.
            whole: whether masses and shapes count.

        Raises:
            SpatialPinError: the driver cannot go there.
        """
        key = driver, whole, None if values is None else values.tobytes()
        if key not in self._motions:
            mechanism, state = self.mechanism, self.states[0]
            if whole and self.whole is not mechanism:
                mechanism = self.whole
                state = State(mechanism, state.q, closure_error=0.0, angles=state.angles)
            self._motions[key] = (_turned(mechanism, driver, state) if values is None else
                                  (_led(mechanism, driver, state, values), False))
        return self._motions[key]


def in_own_turn(mechanism: Mechanism, q: Array, kept: Iterable[str] = ()) -> Array:
    """Return a configuration (nq,) without whole turns that take angles beyond their joint limits.

    Args:
        mechanism: the mechanism.
        q: (nq,) the configuration.
        kept: drivers that stand where they are said to.
    """
    stand = {mechanism.prescribed_coordinate(name).name for name in kept}
    beyond = beyond_limits(mechanism, q).keys() - stand
    if not beyond:
        return q
    others = {name: float(q[c.q]) for name, c in mechanism.coordinate_table.items()
              if c.q >= 0 and name not in beyond}
    return nearest_turn(mechanism, q, {}, others)


def _closed(mechanism: Mechanism, near: State) -> State:
    """Return the state on the branch of one at other dimensions, or the nearest where that ends."""
    with suppress(SpatialPinError):
        return followed(mechanism, {}, near)
    return assembled(mechanism, {}, near.q)


def _led(mechanism: Mechanism, driver: str, state: State, values: Array) -> Motion:
    """Return the motion through values of a driver, from a state on."""
    own = state.coordinate(mechanism.driven_coordinate(driver).name).value
    first = sweep(mechanism, driver, [own, values[0]], guess=state).state(-1)
    return sweep(mechanism, driver, values, guess=first)


def _turned(mechanism: Mechanism, driver: str, state: State) -> tuple[Motion, bool]:
    """Return the motion over a turn or from limit to limit, and whether it is a turn.

    Samples of a turn are at whole multiples of a step, whatever the state: one before the turn
    begins, one for each step.
    """
    coordinate = mechanism.driven_coordinate(driver)
    own = state.coordinate(coordinate.name).value
    if coordinate.unit == "rad":
        values = STEP_OF_TURN * (np.ceil(own / STEP_OF_TURN) + np.arange(-1, PER_TURN + 1))
        first = sweep(mechanism, driver, [own, values[0]], guess=state, on_limit="stop")
        if len(first) == 2:
            motion = sweep(mechanism, driver, values, guess=first.state(-1), on_limit="stop")
            if len(motion) == len(values):
                return motion, True
    low, high = (_limit(mechanism, driver, state, sense) for sense in (-1.0, 1.0))
    # joints go as the square root of the distance from a limit: so do the samples
    half = (0.5 - SHORT_OF_LIMITS) * np.cos(np.linspace(-np.pi, 0.0, PER_TURN + 1))
    return _led(mechanism, driver, state, 0.5 * (low + high) + half * (high - low)), False


def _limit(mechanism: Mechanism, driver: str, state: State, sense: float) -> float:
    """Return where a driver that does not turn fully is stopped."""
    coordinate = mechanism.driven_coordinate(driver)
    span = (2.0 * TURN if coordinate.unit == "rad" else
            FARTHEST_SLIDE * mechanism.characteristic_length)
    own = state.coordinate(coordinate.name).value
    values = own + sense * np.linspace(0.0, span, 2 * PER_TURN + 1)
    motion = sweep(mechanism, driver, values, guess=state, on_limit="stop")
    if len(motion) == len(values):
        raise SpatialPinError(f"{driver!r} has no limits: say through which values it goes")
    return motion.events[-1].value
