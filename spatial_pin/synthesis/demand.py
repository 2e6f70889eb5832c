"""Goals for the whole mechanism: numbers that must be zero, or at most zero.

A demand over a motion has one number for each part of the motion: its largest value there, refined
between the samples. One number for the whole motion would have a kink wherever the worst part
changes.

To add one: a class with `_words`, `_unit` and `values` in `demands`, and its constructor in
`goals`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.start_values import nearest_turn
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.variants import Variants
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limits import FARTHEST_SLIDE
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.precision import Goal

TURN = 2.0 * np.pi
PER_TURN = 36  # samples of a motion
STEP_OF_TURN = TURN / PER_TURN  # ten degrees
# Distance from a limit of the driver, where rates are infinite, relative to its range: ten times
# nearer costs ten times as much.
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
    def of(cls, family: Variants, dimensions: Array, near: State, samples: Any) -> Candidate:
        """Return the candidate at dimensions."""
        names = dict(zip(family.names, dimensions.tolist(), strict=True))
        there = family.at(names)
        if samples:
            states = [State(there, in_own_turn(there, q), closure_error=0.0, angles=a)
                      for s in samples for q, a in zip(s.q, s.angles, strict=True)]
        else:
            states = [_closed(there, near)]
        return cls(there, tuple(states), lambda: family.whole(names),
                   family.has_masses)

    @cached_property
    def whole(self) -> Mechanism:
        """The mechanism with its masses and shapes."""
        return self.mechanism if self._whole is None else self._whole()

    def motion(self, driver: str, values: Array | None, whole: bool = False) -> tuple[Motion, bool]:
        """Return the motion over a driver, and whether the driver turns fully.

        Args:
            driver: name of a driver or coordinate.
            values: (k,) its values; None: a turn, or from limit to limit.
            whole: whether masses and shapes count.
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


def in_own_turn(mechanism: Mechanism, q: Array, fixed: Iterable[str] = ()) -> Array:
    """Return q (nq,) without whole turns that put angles beyond joint limits."""
    fixed_names = {mechanism.prescribed_coordinate(name).name for name in fixed}
    beyond = beyond_limits(mechanism, q).keys() - fixed_names
    if not beyond:
        return q
    others = {name: float(q[c.q]) for name, c in mechanism.coordinate_table.items()
              if c.q >= 0 and name not in beyond}
    return nearest_turn(mechanism, q, {}, others)


def _closed(mechanism: Mechanism, near: State) -> State:
    """Return the state on the same branch as one at other dimensions, else the nearest state."""
    with suppress(SpatialPinError):
        return followed(mechanism, {}, near)
    return assembled(mechanism, {}, near.q)


def _led(mechanism: Mechanism, driver: str, state: State, values: Array) -> Motion:
    """Return the motion from a state through values of a driver."""
    own = state.coordinate(mechanism.driven_coordinate(driver).name).value
    first = sweep(mechanism, driver, [own, values[0]], guess=state).state(-1)
    return sweep(mechanism, driver, values, guess=first)


def _turned(mechanism: Mechanism, driver: str, state: State) -> tuple[Motion, bool]:
    """Return the motion over a turn or from limit to limit, and whether it is a turn.

    Samples of a turn are at whole multiples of the step: one before the turn begins, then one a
    step.
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
    """Return the driver's limit in one direction."""
    coordinate = mechanism.driven_coordinate(driver)
    span = (2.0 * TURN if coordinate.unit == "rad" else
            FARTHEST_SLIDE * mechanism.characteristic_length)
    own = state.coordinate(coordinate.name).value
    values = own + sense * np.linspace(0.0, span, 2 * PER_TURN + 1)
    motion = sweep(mechanism, driver, values, guess=state, on_limit="stop")
    if len(motion) == len(values):
        raise SpatialPinError(f"{driver!r} has no limits: say through which values it goes")
    return motion.events[-1].value


PARTS = 6  # parts of a motion, each with its own number
PEAK = 1e-7  # tolerance of the driver at a peak: the height is exact to its square
# Distances at which a peak is sampled, relative to the distance between samples. A parabola's top
# is wrong by their square. After the second round the error is 1e-7 rad, after the third it is
# round-off.
CLOSER = (2.0**-4, 2.0**-9, 2.0**-13)
SMOOTH = 2.0  # ratio of curvatures at two distances up to which a peak is smooth
BEYOND = 0.25  # in units of the demand: a part met by more than this is not refined


class Demand(Goal):
    """A goal for the whole mechanism."""

    is_one_sided: ClassVar[bool] = True  # whether values below zero are as good as zero

    @abstractmethod
    def values(self, candidate: Candidate) -> Array:
        """Return the numbers (k,) that must be zero."""

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """Return the errors (k,) in the demand's unit, from its numbers."""
        return np.maximum(values, 0.0) if self.is_one_sided else np.abs(values)


@dataclass(frozen=True, eq=False, kw_only=True)
class AtMost(Demand):
    """A demand with numbers relative to the largest allowed value."""

    at_most: float  # the largest allowed value

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return super().errors(values, mechanism) * self.at_most


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionDemand(Demand):
    """A demand over a motion."""

    driver: str | None = None  # name of the driver; None: the only one
    at: Array | None = None  # (k,) driver values; None: a turn, or from limit to limit

    @property
    def mover(self) -> str:
        """The driver in words."""
        return self.driver or "the driver"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        mechanism.driven_coordinate(self.moved_by(mechanism))
        if output := getattr(self, "output", ""):
            mechanism.coordinate(output)

    def moved_by(self, mechanism: Mechanism) -> str:
        """Return the driver."""
        if self.driver is not None:
            return self.driver
        names = list(mechanism.drivers)
        if len(names) != 1:
            raise ValueError(f"{self.name}: mechanism {mechanism.name!r} has {len(names)} drivers; "
                             "say which one moves it")
        return names[0]

    def motion(self, candidate: Candidate, whole: bool = False) -> tuple[Motion, bool]:
        """Return the motion, and whether it is a turn."""
        return candidate.motion(self.moved_by(candidate.mechanism), self.at, whole)

    def worst(self, motion: Motion, measure: Callable[[Motion], Array]) -> Array:
        """Return the largest values of a measure (k,): one a driver value of `at`, else one a part.

        Parts of a turn are sixths of it, wherever it begins.
        """
        measured = measure(motion)
        if self.at is not None:
            return measured
        if len(motion) == PER_TURN + 1:
            parts = np.array_split(np.arange(PER_TURN + 1), PARTS)
        else:
            steps = np.rint(motion.swept[1 : PER_TURN + 1] / STEP_OF_TURN).astype(np.intp)
            which = steps % PER_TURN * PARTS // PER_TURN
            parts = [1 + np.flatnonzero(which == part) for part in range(PARTS)]
        return np.array([_peak(motion, measured, rows, measure) for rows in parts])


def _peak(
    motion: Motion, measured: Array, rows: NDArray[np.intp], measure: Callable[[Motion], Array]
) -> float:
    """Return the largest value of a measure at samples, refined between them if it counts."""
    driver, best = motion.driver_name, int(rows[np.argmax(measured[rows])])
    highest = float(measured[best])
    inside = 0 < best < len(measured) - 1 and highest >= max(measured[best - 1], measured[best + 1])
    if not inside or highest <= -BEYOND:
        return highest
    state = motion.state(best)

    def at(values: Array) -> Array:
        return measure(sweep(state.mechanism, driver, values, guess=state))

    with suppress(SpatialPinError, ValueError):  # it is flat there
        near = motion.swept[best - 1 : best + 2]
        top = smooth_peak(near, measured[best - 1 : best + 2], at)
        if top is None:  # it may be sharp
            from scipy.optimize import minimize_scalar  # on use: it takes a quarter of a second

            top = -float(minimize_scalar(lambda value: -float(at(np.array([value]))[0]),
                                         bracket=tuple(near.tolist()), tol=PEAK).fun)
        return max(highest, top)
    return highest


def smooth_peak(x: Array, y: Array, at: Callable[[Array], Array]) -> float | None:
    """Return the height of a smooth peak of a function, by parabolas closer and closer to the top.

    Values y (3,) at x (3,) are around it. None if the function is not smooth there.
    """
    wide, top, before = float(x[2] - x[0]), 0.0, 0.0
    for closer in CLOSER:
        top, _, before = _top(x, y)
        if not (before < 0.0 and min(x[0], x[2]) < top < max(x[0], x[2])):
            return None
        x = top + closer * wide * np.array([-1.0, 0.0, 1.0])
        y = at(x)
    top, height, bend = _top(x, y)
    is_inside = min(x[0], x[2]) < top < max(x[0], x[2])
    is_smooth = before * SMOOTH < bend < before / SMOOTH
    return height if is_inside and is_smooth else None


def _top(x: Array, y: Array) -> tuple[float, float, float]:
    """Return abscissa and height of the top of the parabola through three points, and curvature."""
    behind, ahead = float(x[1] - x[0]), float(x[2] - x[1])
    rise, fall = float(y[1] - y[0]) / behind, float(y[2] - y[1]) / ahead
    bend = (fall - rise) / (behind + ahead)
    slope = (rise * ahead + fall * behind) / (behind + ahead)  # in the middle
    if not bend < 0.0:
        return np.nan, np.nan, bend
    return float(x[1]) - 0.5 * slope / bend, float(y[1]) - 0.25 * slope * slope / bend, bend
