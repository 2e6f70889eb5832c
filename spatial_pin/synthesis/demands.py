"""What a mechanism should be like: swing, transmission, whole turns, dead centres, effort, size.

A demand is numbers of a mechanism and its motion that should be zero, or at most zero. Those of a
whole motion are the largest in each of some parts of it, searched between the samples: one number
for all would have a kink wherever the worst place changes.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dynamics.kinetostatics import kinetostatics
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.kernel import Kernel, kernel_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limits import FARTHEST_SLIDE
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array, rank, singular_values
from spatial_pin.proximity.clearance import clearance
from spatial_pin.proximity.distances import Distances
from spatial_pin.rates.transmission import MovedOutput, transmission_angle
from spatial_pin.synthesis.family import Family
from spatial_pin.synthesis.precision import Goal

TURN = 2.0 * np.pi
PER_TURN = 36  # steps of a motion that is looked at
STEP_OF_TURN = TURN / PER_TURN  # ten degrees
PARTS = 6  # of a motion, each with a number of its own
PEAK = 1e-7  # of where a peak is: it is as high as its square
BEYOND = 0.25  # of a demand's unit, by which a part is met so well that samples are enough
# Part of its range that a driver stays short of its limits, where rates are infinite: still nearer
# samples cost ten times as much.
SHORT_OF_LIMITS = 1e-5
# Square of the least singular value of what the driver leaves to be determined, lengths relative to
# the characteristic length: so far a driver that turns fully is from being stopped, about a degree
# of transmission angle.
REGULAR = 1e-4


class Candidate:
    """A mechanism at some dimensions, with closed configurations.

    Args:
        mechanism: for its motion; its masses and shapes may be those at other dimensions.
        states: closed states.
        whole: the mechanism loaded at these dimensions; default the same one.
    """

    def __init__(
        self, mechanism: Mechanism, states: tuple[State, ...],
        whole: Callable[[], Mechanism] | None = None,
    ) -> None:
        self.mechanism, self.states, self._whole = mechanism, states, whole
        self._motions: dict[Any, tuple[Motion, bool]] = {}

    @classmethod
    def of(cls, family: Family, dimensions: Array, near: State, samples: Any) -> Candidate:
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
            states = [State(there, q, closure_error=0.0, angles=a) for s in samples
                      for q, a in zip(s.q, s.angles, strict=True)]
        else:
            states = [_closed(there, near)]
        return cls(there, tuple(states), lambda: family.mechanism_at(names))

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


# ---------------------------------------------------------------- demands


@dataclass(frozen=True, eq=False, kw_only=True)
class Demand(Goal):
    """A goal that is asked of the mechanism as a whole."""

    @property
    def is_one_sided(self) -> bool:
        """Whether values below zero are as good as zero."""
        return True

    @abstractmethod
    def values(self, candidate: Candidate) -> Array:
        """Return the numbers (k,), zero where it is met.

        Raises:
            SpatialPinError: they are not defined.
        """

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """Return in its unit how far it is missed, (k,), from its numbers."""
        return np.maximum(values, 0.0) if self.is_one_sided else np.abs(values)


@dataclass(frozen=True, eq=False, kw_only=True)
class _AtMost(Demand):
    """A demand whose numbers are relative to the largest value that is allowed.

    Attributes:
        at_most: that value.
    """

    at_most: float

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return super().errors(values, mechanism) * self.at_most


@dataclass(frozen=True, eq=False, kw_only=True)
class _Moving(Demand):
    """A demand on a motion.

    Attributes:
        driver: what moves it; None: the only driver.
        at: (k,) driver values; None: a turn of it, or from limit to limit.
    """

    driver: str | None = None
    at: Array | None = None

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        mechanism.driven_coordinate(self.moved_by(mechanism))

    def moved_by(self, mechanism: Mechanism) -> str:
        """Return the driver.

        Raises:
            ValueError: none is named, and there is not one alone.
        """
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
        """Return the largest of what is measured, at every value asked for or by part (k,)."""
        found = measure(motion)
        if self.at is not None:
            return found
        return np.array([_peak(motion, found, rows, measure) for rows in _parts(motion)])


def _parts(motion: Motion) -> list[NDArray[np.intp]]:
    """Return rows of each part: those of a turn are sixths of it, whatever it begins with."""
    if len(motion) == PER_TURN + 1:
        return np.array_split(np.arange(PER_TURN + 1), PARTS)
    steps = np.rint(motion.swept[1 : PER_TURN + 1] / STEP_OF_TURN).astype(np.intp) % PER_TURN
    return [1 + np.flatnonzero(steps * PARTS // PER_TURN == part) for part in range(PARTS)]


def _peak(
    motion: Motion, found: Array, rows: NDArray[np.intp], measure: Callable[[Motion], Array]
) -> float:
    """Return the largest of some samples, and of what is between them if it counts."""
    from scipy.optimize import minimize_scalar  # on use: it takes a quarter of a second

    assert motion.driver_name is not None
    driver, best = motion.driver_name, int(rows[np.argmax(found[rows])])
    highest = float(found[best])
    inside = 0 < best < len(found) - 1 and highest >= max(found[best - 1], found[best + 1])
    if not inside or highest <= -BEYOND:
        return highest
    state = motion.state(best)

    def negative(value: float) -> float:
        return -float(measure(sweep(state.mechanism, driver, [value], guess=state))[0])

    with suppress(SpatialPinError, ValueError):  # it is flat there
        bracket = tuple(motion.swept[best - 1 : best + 2].tolist())
        return max(highest, -float(minimize_scalar(negative, bracket=bracket, tol=PEAK).fun))
    return highest


@dataclass(frozen=True, eq=False, kw_only=True)
class Swing(_Moving):
    """How far an output goes to and fro."""

    output: str
    angle: float

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"swing of {self.output}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return str(mechanism.coordinate(self.output).unit)

    @property
    def is_one_sided(self) -> bool:
        """See `Demand`."""
        return False

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        mechanism.coordinate(self.output)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: by the coordinate's own size."""
        motion, is_turn = self.motion(candidate)
        size = motion.mechanism.velocity_scale[motion.mechanism.coordinate(self.output).v]
        least, most = _ends(motion, self.output, is_turn or self.at is not None)
        return np.array([(most - least - self.angle) / size])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return np.abs(values) * mechanism.velocity_scale[mechanism.coordinate(self.output).v]


def _ends(motion: Motion, output: str, is_turn: bool) -> tuple[float, float]:
    """Return the least and the largest value of a coordinate over a motion.

    Where its rate changes sign, the cubic through both samples tells where it turns back; from the
    configuration there what is left of its rate v and its derivative a tell the rest: v²/2a.
    At a limit, a distance d beyond the last sample, x = x0 + c sqrt(d) + e d.
    """
    value, rate, acceleration = motion.coordinate(output)
    assert motion.driver_name is not None
    found, at = [value.min(), value.max()], motion.swept
    for k in np.flatnonzero(rate[:-1] * rate[1:] < 0.0):
        span = at[k + 1] - at[k]
        u = _turning(value[k + 1] - value[k], span * rate[k], span * rate[k + 1])
        there = sweep(motion.mechanism, motion.driver_name, [at[k] + u * span],
                      guess=motion.state(int(k))).coordinate(output)
        x, v, a = (float(part[0]) for part in there)
        found.append(x - 0.5 * v * v / a if a else x)
    if not is_turn:
        d = SHORT_OF_LIMITS * (at[-1] - at[0]) / (1.0 - 2.0 * SHORT_OF_LIMITS)
        found += [value[k] + sign * d * rate[k] + 2.0 * d * d * acceleration[k]
                  for k, sign in ((0, -1.0), (-1, 1.0))]
    return min(found), max(found)


def _turning(rise: float, first: float, last: float) -> float:
    """Return where in (0, 1) the cubic of a rise, with slopes of opposite sign, is level."""
    a, b, c = 3.0 * (first + last - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * first - last), first
    root = np.sqrt(max(b * b - 4.0 * a * c, 0.0))
    ways = np.array([2.0 * c / (-b + sign * root) if -b + sign * root else np.inf
                     for sign in (1.0, -1.0)])
    return float(np.clip(ways[np.argmin(np.abs(ways - 0.5))], 0.0, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class LeastTransmission(_Moving):
    """How large the transmission angle of an output is at least."""

    output: str
    at_least: float
    pair: str | None = None

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"transmission to {self.output}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "rad"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        MovedOutput.of(mechanism, self.output, self.moved_by(mechanism), self.pair)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: angles that are missing."""
        motion, _ = self.motion(candidate)
        driver = self.moved_by(candidate.mechanism)

        def missing(motion: Motion) -> Array:
            return self.at_least - np.array([
                transmission_angle(motion.mechanism, motion.state(k), self.output, driver,
                                   self.pair)[0] for k in range(len(motion))])

        return self.worst(motion, missing)


class _Loops:
    """The loops of a mechanism whose drivers stand: how well they determine the rest.

    Args:
        motion: of it; how many equations are independent is that of its first sample.
    """

    def __init__(self, motion: Motion) -> None:
        mechanism = motion.mechanism
        assert motion.driver_name is not None
        names = {motion.driver_name, *(d.joint for d in mechanism.drivers.values())}
        self._held = [mechanism.driven_coordinate(name).v for name in names]
        with kernel_of(mechanism) as kernel:
            self._rank = rank(self._left(kernel, motion.q[:1])[0])

    def _left(self, kernel: Kernel, q: Array) -> Array:
        """Return derivatives (n, ., .) of all equations for what is not driven."""
        return np.delete(kernel.jacobians(q), self._held, axis=2)

    def regularity(self, motion: Motion) -> Array:
        """Return the least singular value (n,) of as many equations as are independent."""
        with kernel_of(motion.mechanism) as kernel:
            return singular_values(self._left(kernel, motion.q))[:, self._rank - 1]


@dataclass(frozen=True, eq=False, kw_only=True)
class FullTurn(_Moving):
    """That a driver turns all the way round."""

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"full turn of {self.driver or 'the driver'}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "rad"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if mechanism.driven_coordinate(self.moved_by(mechanism)).unit != "rad":
            raise ValueError(f"{self.name}: it slides, and cannot turn")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: 1 - cos of half the gap in the turn, and nearness of a limit beyond it."""
        motion, is_turn = self.motion(candidate)
        if not is_turn:
            gap = max(0.0, TURN - float(np.ptp(motion.swept)))
            return (REGULAR + 1.0 - np.cos(0.5 * gap)) * np.eye(PARTS)[0]
        loops = _Loops(motion)
        return self.worst(motion, lambda some: REGULAR - loops.regularity(some) ** 2)

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`: angles that are missing."""
        return 2.0 * np.arccos(np.clip(1.0 - np.maximum(values, 0.0), -1.0, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class DeadCentres(_Moving):
    """That an output stands still at values of the driver."""

    output: str

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"dead centres of {self.output}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "output per driver"

    @property
    def is_one_sided(self) -> bool:
        """See `Demand`."""
        return False

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        output, driver = mechanism.coordinate(self.output), self.moved_by(mechanism)
        if output.name == mechanism.driven_coordinate(driver).name:
            raise ValueError(f"{self.name}: it is the driver itself; for its own dead centres name "
                             "it as the output of another joint's motion")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: speed ratios, each by the coordinates' sizes."""
        motion, _ = self.motion(candidate)
        mechanism, scale = motion.mechanism, motion.mechanism.velocity_scale
        driver = mechanism.driven_coordinate(self.moved_by(mechanism))
        rates = motion.v[:, mechanism.coordinate(self.output).v] / motion.v[:, driver.v]
        found: Array = rates * scale[driver.v] / scale[mechanism.coordinate(self.output).v]
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class MostEffort(_AtMost, _Moving):
    """That a driver needs little effort to hold loads."""

    loads: Mapping[str, Array] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """See `Goal`."""
        return f"effort of {self.driver or 'the driver'}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "N m" if mechanism.driven_coordinate(self.moved_by(mechanism)).unit == "rad" else "N"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        for name in self.loads:
            mechanism.frame_id(name)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest one allowed."""
        motion, _ = self.motion(candidate, whole=True)
        driver = self.moved_by(candidate.mechanism)
        loads = {name: pin.Force(wrench) for name, wrench in self.loads.items()}

        def beyond(motion: Motion) -> Array:
            efforts = kinetostatics(motion.mechanism, motion, external=loads).efforts
            held = motion.mechanism.driven_coordinate(driver).name
            own = next(x for name, x in efforts.items()
                       if motion.mechanism.driven_coordinate(name).name == held)
            found: Array = np.abs(own) / self.at_most - 1.0
            return found

        return self.worst(motion, beyond)


@dataclass(frozen=True, eq=False, kw_only=True)
class LeastClearance(_Moving):
    """That links that are not joined stay apart."""

    at_least: float
    pairs: tuple[tuple[str, str], ...] | None = None

    @property
    def name(self) -> str:
        """See `Goal`."""
        return "clearance"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "m"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if not Distances(mechanism, self.pairs).pairs:
            raise ValueError(f"clearance: mechanism {mechanism.name!r} has no two links with a "
                             "shape that are not joined; name pairs of those that are")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: distances that are missing, by pair of links, in characteristic lengths."""
        motion, _ = self.motion(candidate, whole=True)
        found = sorted(clearance(motion, self.pairs).pairs, key=lambda pair: pair.links)
        size = motion.mechanism.characteristic_length
        return np.array([(self.at_least - pair.distance) / size for pair in found])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return np.maximum(values, 0.0) * mechanism.characteristic_length


@dataclass(frozen=True, eq=False, kw_only=True)
class MostSize(_AtMost, _Moving):
    """That no two joints or closures are ever far apart."""

    @property
    def name(self) -> str:
        """See `Goal`."""
        return "size"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "m"

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest one allowed."""
        motion, _ = self.motion(candidate)
        model, closures = motion.mechanism.model, motion.mechanism.closures
        names = [*model.names[1:], *(name for c in closures for name in c.frames)]

        def beyond(motion: Motion) -> Array:
            points = np.array([motion.frame(name).position for name in dict.fromkeys(names)])
            apart = np.linalg.norm(points[:, None] - points[None], axis=3).max(axis=(0, 1))
            found: Array = apart / self.at_most - 1.0
            return found

        return self.worst(motion, beyond)


@dataclass(frozen=True, eq=False, kw_only=True)
class MostMass(_AtMost):
    """That all moving links together weigh little."""

    @property
    def name(self) -> str:
        """See `Goal`."""
        return "mass"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "kg"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        if not _mass(mechanism) > 0.0:
            raise ValueError(f"mass: no moving link of mechanism {mechanism.name!r} has one")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest one allowed."""
        return np.array([_mass(candidate.whole) / self.at_most - 1.0])


def _mass(mechanism: Mechanism) -> float:
    return float(sum(inertia.mass for inertia in list(mechanism.model.inertias)[1:]))
