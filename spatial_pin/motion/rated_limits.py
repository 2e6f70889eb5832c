"""Effort and velocity limits of the URDF, and the samples of a motion beyond them.

A limit of 0 is none: URDF wants the attributes even where nothing is known.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.brief import brief
from spatial_pin._support.lazy import made_anew, made_once
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.joint_limit_events import SLACK
from spatial_pin.motion.motion import Event, Motion
from spatial_pin.motion.summary import EFFORTS, where
from spatial_pin.numerics.linalg import Array

VELOCITY, EFFORT = "velocity limit", "effort limit"  # kinds of events
UNSET = 1e300  # Pinocchio has its largest number, or infinity, where there is no limit


class RatedLimit(NamedTuple):
    """The largest velocity, or effort, of a joint coordinate.

    Attributes:
        kind: "velocity limit" or "effort limit".
        name: of the coordinate.
        v: its place in the velocity.
        value: the limit [rad/s, m/s, N·m or N].
        unit: of that.
    """

    kind: str
    name: str
    v: int
    value: float
    unit: str

    @property
    def words(self) -> str:
        """Its name, as text."""
        return f"{self.kind} {self.value:.9g} {self.unit} of {self.name}"

    def excess(self, values: Array) -> Array:
        """Return the excess of values (...) over the limit, negative within it."""
        return np.abs(values) - self.value * (1.0 + SLACK)


class BeyondLimit(NamedTuple):
    """A velocity or effort that is beyond its limit in some samples of a motion.

    Attributes:
        limit: the exceeded limit.
        samples: (n,) numbers of the samples of the motion that are beyond it, rising.
        worst: number of the sample that is farthest beyond.
        most: the velocity or effort there [rad/s, m/s, N·m or N].

    Example:
        >>> mech = sp.load("excavator")
        >>> motion = sp.sweep(mech, "boom", np.linspace(2.7, 2.9, 21), speed=1.0)  # [m], [m/s]
        >>> beyond = sp.kinetostatics(mech, motion).beyond_limits[0]
        >>> beyond.limit.kind, beyond.limit.name, float(beyond.most)
        ('velocity limit', 'boom_slide', 1.0)
        >>> print(f"{beyond.by:.3f} m/s too fast")
        0.677 m/s too fast
    """

    limit: RatedLimit
    samples: NDArray[np.intp]
    worst: int
    most: float

    @property
    def by(self) -> float:
        """Largest excess over the limit [rad/s, m/s, N·m or N]."""
        return abs(self.most) - self.limit.value

    def text(self, motion: Motion) -> str:
        """Return the same as a sentence.

        Args:
            motion: the motion that it is about.

        Example:
            >>> mech = sp.load("excavator")
            >>> motion = sp.sweep(mech, "boom", np.linspace(2.7, 2.9, 21), speed=1.0)  # [m], [m/s]
            >>> beyond = sp.kinetostatics(mech, motion).beyond_limits[0]
            >>> print(beyond.text(motion).split(",")[0])
            beyond the velocity limit 0.323467685 m/s of boom_slide in 21 of 21 samples
        """
        return (f"beyond the {self.limit.words} in {len(self.samples)} of {len(motion)} samples, "
                f"first {where(motion, int(self.samples[0]))}, by {self.by:.6g} {self.limit.unit} "
                f"at most, {where(motion, self.worst)}")

    def __repr__(self) -> str:
        return brief(self, most=self.limit.unit)


def velocity_limits(mechanism: Mechanism) -> list[RatedLimit]:
    """Return the velocity limits that the URDF states, in the order of the coordinates."""
    return _velocity_limits(mechanism, _highest_speeds(mechanism).tobytes())


@made_once
def _highest_speeds(mechanism: Mechanism) -> Array:
    """Return the velocity limits (nv,) of the model: its own array, not to be changed."""
    numbers: Array = mechanism.model.upperVelocityLimit
    return numbers


@made_anew  # as anybody may change the numbers
def _velocity_limits(mechanism: Mechanism, numbers: bytes) -> list[RatedLimit]:
    return [RatedLimit(VELOCITY, c.name, c.v, float(x), f"{c.unit}/s")
            for c, x in _stated(mechanism, _highest_speeds(mechanism))]


def effort_limits(mechanism: Mechanism) -> list[RatedLimit]:
    """Return the effort limits that the URDF states, in the order of the coordinates."""
    return [RatedLimit(EFFORT, c.name, c.v, float(x), EFFORTS[c.unit])
            for c, x in _stated(mechanism, mechanism.model.upperEffortLimit)]


def _stated(mechanism: Mechanism, values: Array) -> list[tuple[Coordinate, float]]:
    table = mechanism.coordinate_table.values()
    return [(c, x) for c, x in zip(table, values.tolist(), strict=True) if 0.0 < x < UNSET]


def beyond(pairs: Iterable[tuple[RatedLimit, Array]]) -> list[BeyondLimit]:
    """Return the limits that velocities or efforts (N,) exceed, with their samples."""
    exceeded = []
    for limit, values in pairs:
        excess = limit.excess(values)
        samples = np.flatnonzero(excess > 0.0)
        if samples.size:
            worst = int(np.argmax(excess))
            exceeded.append(BeyondLimit(limit, samples, worst, float(values[worst])))
    return exceeded


def velocities_beyond(motion: Motion) -> list[BeyondLimit]:
    """Return the velocity limits that a motion exceeds; none if its rates are not in time."""
    if motion.per != "s":
        return []
    return beyond((limit, motion.v[:, limit.v]) for limit in velocity_limits(motion.mechanism))


def velocity_limit_events(motion: Motion) -> list[Event]:
    """Return an event for each velocity limit that a motion exceeds, at the first such sample."""
    at = motion.time if motion.driver is None else motion.driver
    return [] if at is None else [
        Event(VELOCITY, float(at[b.samples[0]]), int(b.samples[0]), b.text(motion))
        for b in velocities_beyond(motion)]
