"""Kinds of demands on a mechanism as a whole: swing, full turn, transmission, limits, size, effort.

To add one: a class of `demand.Demand` with `_words`, `_unit` and `values`, and its constructor in
`goals`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.state import State, moving_in_time
from spatial_pin.dynamics.kinetostatics import inverse_dynamics
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.mechanism.inertia import moving_mass
from spatial_pin.mechanism.joint_limits import JointLimit, joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array, rank, singular_values
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.proximity.clearance import clearance
from spatial_pin.proximity.distances import Distances
from spatial_pin.rates.transmission import MovedOutput
from spatial_pin.synthesis.demand import (
    PARTS,
    SHORT_OF_LIMITS,
    TURN,
    AtMost,
    Candidate,
    MotionDemand,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Swing(MotionDemand):
    """The range of an output over a motion."""

    output: str
    angle: float
    _words, is_one_sided = "swing of {0.output}", False

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return str(mechanism.coordinate(self.output).unit)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the size of the coordinate."""
        motion, is_turn = self.motion(candidate)
        size = motion.mechanism.velocity_scale[motion.mechanism.coordinate(self.output).v]
        least, most = _ends(motion, self.output, is_turn or self.at is not None)
        return np.array([(most - least - self.angle) / size])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return np.abs(values) * mechanism.velocity_scale[mechanism.coordinate(self.output).v]


def _ends(motion: Motion, output: str, is_turn: bool) -> tuple[float, float]:
    """Return the least and the largest value of a coordinate over a motion.

    Where its rate changes sign, the cubic through two samples gives the turning point. From the
    configuration there, with rate v and derivative a, the rest is v²/2a. At a limit, at a distance
    d beyond the last sample, x = x0 + c sqrt(d) + e d.
    """
    value, rate, acceleration = motion.coordinate(output)
    ends, at = [value.min(), value.max()], motion.swept
    for k in np.flatnonzero(rate[:-1] * rate[1:] < 0.0):
        span = at[k + 1] - at[k]
        u = _turning(value[k + 1] - value[k], span * rate[k], span * rate[k + 1])
        there = sweep(motion.mechanism, motion.driver_name, [at[k] + u * span],
                      guess=motion.state(int(k))).coordinate(output)
        x, v, a = (float(part[0]) for part in there)
        ends.append(x - 0.5 * v * v / a if a else x)
    if not is_turn:
        d = SHORT_OF_LIMITS * (at[-1] - at[0]) / (1.0 - 2.0 * SHORT_OF_LIMITS)
        ends += [value[k] + sign * d * rate[k] + 2.0 * d * d * acceleration[k]
                  for k, sign in ((0, -1.0), (-1, 1.0))]
    return min(ends), max(ends)


def _turning(rise: float, first: float, last: float) -> float:
    """Return the root in (0, 1) of the slope of a cubic with end slopes of opposite sign."""
    a, b, c = 3.0 * (first + last - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * first - last), first
    root = np.sqrt(max(b * b - 4.0 * a * c, 0.0))
    ways = np.array([2.0 * c / (-b + sign * root) if -b + sign * root else np.inf
                     for sign in (1.0, -1.0)])
    return float(np.clip(ways[np.argmin(np.abs(ways - 0.5))], 0.0, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class DeadCentres(MotionDemand):
    """Values of the driver at which an output is at rest."""

    output: str
    _words, _unit = "dead centres of {0.output}", "output per driver"
    is_one_sided = False

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        output, driver = mechanism.coordinate(self.output), self.moved_by(mechanism)
        if output.name == mechanism.driven_coordinate(driver).name:
            raise ValueError(f"{self.name}: it is the driver itself; for its own dead centres name "
                             "it as the output of another joint's motion")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: speed ratios, relative to the sizes of the coordinates."""
        motion, _ = self.motion(candidate)
        mechanism, scale = motion.mechanism, motion.mechanism.velocity_scale
        driver = mechanism.driven_coordinate(self.moved_by(mechanism))
        rates = motion.v[:, mechanism.coordinate(self.output).v] / motion.v[:, driver.v]
        return rates * scale[driver.v] / scale[mechanism.coordinate(self.output).v]


# Square of the least singular value of the equations for what the driver determines, lengths
# relative to the characteristic length. It keeps a driver about one degree of transmission angle
# away from a limit.
REGULAR = 1e-4


class FullTurn(MotionDemand):
    """A driver that turns fully."""

    _words, _unit = "full turn of {0.mover}", "rad"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if mechanism.driven_coordinate(self.moved_by(mechanism)).unit != "rad":
            raise ValueError(f"{self.name}: it slides, and cannot turn")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: 1 - cos of half the gap in the turn, and the distance to a limit beyond it.

        The distance is the least singular value of the independent equations of the first sample:
        how well loops determine the rest of a mechanism with fixed drivers.
        """
        motion, is_turn = self.motion(candidate)
        if not is_turn:
            gap = max(0.0, TURN - float(np.ptp(motion.swept)))
            return (REGULAR + 1.0 - np.cos(0.5 * gap)) * np.eye(PARTS)[0]
        mechanism = motion.mechanism
        names = {motion.driver_name, *(d.joint for d in mechanism.drivers.values())}
        driven = [mechanism.driven_coordinate(name).v for name in names]

        def rest(some: Motion) -> Array:
            with kernel_of(mechanism) as kernel:
                return np.delete(kernel.jacobians_and_columns(some.q, some.angles)[0], driven,
                                 axis=2)

        independent = rank(rest(motion)[0])
        return self.worst(
            motion, lambda some: REGULAR - singular_values(rest(some))[:, independent - 1] ** 2)

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`: the missing angles."""
        return 2.0 * np.arccos(np.clip(1.0 - np.maximum(values, 0.0), -1.0, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class LeastTransmission(MotionDemand):
    """The least transmission angle of an output."""

    output: str
    at_least: float
    pair: str | None = None
    _words, _unit = "transmission to {0.output}", "rad"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        MovedOutput.of(mechanism, self.output, self.moved_by(mechanism), self.pair)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: the missing angles."""
        motion, _ = self.motion(candidate)
        moved = MovedOutput.of(motion.mechanism, self.output,
                               self.moved_by(candidate.mechanism), self.pair)

        return self.worst(motion, lambda some: self.at_least - moved.angles(
            some.mechanism, some.q, some.angles))


class WithinLimits(MotionDemand):
    """No joint beyond its limits, the driver excepted."""

    _words = "joint limits"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return ", ".join(sorted({limit.unit for limit in self._counting(mechanism)}))

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if not self._counting(mechanism):
            raise ValueError(f"joint limits: no joint of mechanism {mechanism.name!r} has any, "
                             "but for the driver perhaps; state them in its URDF")

    def _counting(self, mechanism: Mechanism) -> list[JointLimit]:
        """Return the limits of joints other than the driver's."""
        driver = mechanism.driven_coordinate(self.moved_by(mechanism)).name
        return [limit for limit in joint_limits(mechanism) if limit.name != driver]

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: excess over each limit, relative to the size of the coordinate."""
        motion, _ = self.motion(candidate)

        def beyond(limit: JointLimit) -> Callable[[Motion], Array]:
            return lambda some: -limit.room(some.q) / limit.size

        return np.concatenate([self.worst(motion, beyond(limit))
                               for limit in self._counting(candidate.mechanism)])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        sizes = np.array([limit.size for limit in self._counting(mechanism)])
        return np.maximum(values, 0.0) * np.repeat(sizes, len(values) // len(sizes))


@dataclass(frozen=True, eq=False, kw_only=True)
class LeastClearance(MotionDemand):
    """The least distance between links that are not joined."""

    at_least: float
    pairs: tuple[tuple[str, str], ...] | None = None
    _words, _unit = "clearance", "m"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        if not Distances(mechanism, self.pairs).pairs:
            raise ValueError(f"clearance: mechanism {mechanism.name!r} has no two links with a "
                             "shape that are not joined; name pairs of those that are")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: missing distances by pair of links, in characteristic lengths."""
        motion, _ = self.motion(candidate, whole=True)
        pairs = sorted(clearance(motion, self.pairs).pairs, key=lambda pair: pair.links)
        size = motion.mechanism.characteristic_length
        return np.array([(self.at_least - pair.distance) / size for pair in pairs])

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return np.maximum(values, 0.0) * mechanism.characteristic_length


@dataclass(frozen=True, eq=False, kw_only=True)
class MostSize(AtMost, MotionDemand):
    """The largest distance between two joints or closures."""

    _words, _unit = "size", "m"

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest allowed distance."""
        motion, _ = self.motion(candidate)
        model, closures = motion.mechanism.model, motion.mechanism.closures
        names = [*model.names[1:], *(name for c in closures for name in c.frames)]

        def beyond(motion: Motion) -> Array:
            points = np.array([motion.frame(name).position for name in dict.fromkeys(names)])
            apart = np.linalg.norm(points[:, None] - points[None], axis=3).max(axis=(0, 1))
            return apart / self.at_most - 1.0

        return self.worst(motion, beyond)


class MostMass(AtMost):
    """The mass of all moving links."""

    _words, _unit = "mass", "kg"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        if not moving_mass(mechanism.model) > 0.0:
            raise ValueError(f"mass: no moving link of mechanism {mechanism.name!r} has one")

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest allowed mass."""
        heavy = candidate.mechanism if candidate.has_masses else candidate.whole
        return np.array([moving_mass(heavy.model) / self.at_most - 1.0])


# relative difference up to which virtual work and inverse dynamics give the same effort
SAME_EFFORT = TOLERANCES.nothing


@dataclass(frozen=True, eq=False, kw_only=True)
class MostEffort(AtMost, MotionDemand):
    """The effort of a driver that holds loads at rest."""

    loads: Mapping[str, Array] = field(default_factory=dict)
    _words = "effort of {0.mover}"

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return "N m" if mechanism.driven_coordinate(self.moved_by(mechanism)).unit == "rad" else "N"

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        super().check(mechanism)
        for name in self.loads:
            mechanism.frame_id(name)

    def values(self, candidate: Candidate) -> Array:
        """See `Demand`: relative to the largest allowed effort."""
        motion, _ = self.motion(candidate, whole=not candidate.has_masses)
        loads = {name: pin.Force(wrench) for name, wrench in self.loads.items()}
        driver = motion.mechanism.driven_coordinate(self.moved_by(candidate.mechanism))
        balanced = _balanced(motion, 0, driver.name, loads)
        own = _by_work(motion, driver.v, loads, 1)[0]
        is_same = abs(own - balanced) <= SAME_EFFORT * max(abs(own), abs(balanced))

        def beyond(motion: Motion) -> Array:
            efforts = _by_work(motion, driver.v, loads) if is_same else np.array(
                [_balanced(motion, k, driver.name, loads) for k in range(len(motion))])
            return np.abs(efforts) / self.at_most - 1.0

        return self.worst(motion, beyond)


def _balanced(motion: Motion, row: int, driver: str, loads: Mapping[str, pin.Force]) -> float:
    """Return the driver's effort at rest in a sample, by inverse dynamics."""
    state = moving_in_time(motion.mechanism, motion.state(row))
    efforts = inverse_dynamics(motion.mechanism, state, external=loads).efforts
    return float(next(x for name, x in efforts.items()
                      if motion.mechanism.driven_coordinate(name).name == driver))


def _by_work(
    motion: Motion, driver: int, loads: Mapping[str, pin.Force], most: int | None = None
) -> Array:
    """Return efforts (n,) by virtual work, of the first `most` samples.

    The driver's work along the motion balances the work of all other forces. This is its effort if
    there are as many drivers as freedoms that they hold.
    """
    at_rest, efforts = np.zeros(motion.mechanism.model.nv), []
    with acquired(motion.mechanism, Equations) as equations:
        for q, angles, v in zip(
                motion.q[:most], motion.angles[:most], motion.v[:most], strict=True):
            equations.update(State(motion.mechanism, q, closure_error=0.0, angles=angles), loads)
            wanted = equations.motion_forces(at_rest) - equations.given
            efforts.append(float(wanted @ v) / v[driver])
    return np.array(efforts)
