"""What a demand is: numbers of a mechanism and its motion that should be zero, or at most zero.

Those of a whole motion are the largest in each of some parts of it, searched between the samples:
one number for all would have a kink wherever the worst place changes.

To add one: a class with `_words`, `_unit` and `values` in a module beside, and its constructor in
`goals`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.candidate import PER_TURN, STEP_OF_TURN, Candidate
from spatial_pin.synthesis.precision import Goal

PARTS = 6  # of a motion, each with a number of its own
PEAK = 1e-7  # of where a peak is: it is as high as its square
# Distances at which a peak is looked at, relative to that of the samples. A parabola's top is wrong
# by their square, and its height by as much times how far the next one is from the top: after the
# second it is 1e-7 rad, after the third round-off is left.
CLOSER = (2.0**-4, 2.0**-9, 2.0**-13)
SMOOTH = 2.0  # factor between curvatures of a peak from near and from nearer, where it is smooth
BEYOND = 0.25  # of a demand's unit, by which a part is met so well that samples are enough


@dataclass(frozen=True, eq=False, kw_only=True)
class Demand(Goal):
    """A goal that is asked of the mechanism as a whole.

    Attributes:
        is_one_sided: whether values below zero are as good as zero.
    """

    is_one_sided: ClassVar[bool] = True

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
class AtMost(Demand):
    """A demand whose numbers are relative to the largest value that is allowed.

    Attributes:
        at_most: that value.
    """

    at_most: float

    def errors(self, values: Array, mechanism: Mechanism) -> Array:
        """See `Demand`."""
        return super().errors(values, mechanism) * self.at_most


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionDemand(Demand):
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
    assert motion.driver_name is not None
    driver, best = motion.driver_name, int(rows[np.argmax(found[rows])])
    highest = float(found[best])
    inside = 0 < best < len(found) - 1 and highest >= max(found[best - 1], found[best + 1])
    if not inside or highest <= -BEYOND:
        return highest
    state = motion.state(best)

    def at(values: Array) -> Array:
        return measure(sweep(state.mechanism, driver, values, guess=state))

    with suppress(SpatialPinError, ValueError):  # it is flat there
        near = motion.swept[best - 1 : best + 2]
        top = smooth_peak(near, found[best - 1 : best + 2], at)
        if top is None:  # it may be sharp
            from scipy.optimize import minimize_scalar  # on use: it takes a quarter of a second

            top = -float(minimize_scalar(lambda value: -float(at(np.array([value]))[0]),
                                         bracket=tuple(near.tolist()), tol=PEAK).fun)
        return max(highest, top)
    return highest


def smooth_peak(x: Array, y: Array, at: Callable[[Array], Array]) -> float | None:
    """Return how high a smooth function is at its peak, by parabolas ever closer about the top.

    Args:
        x: (3,) in order, round the peak.
        y: (3,) values there.
        at: the function, of (3,).

    Returns:
        None where it does not look smooth.
    """
    wide, place, before = float(x[2] - x[0]), 0.0, 0.0
    for closer in CLOSER:
        place, _, before = _top(x, y)
        if not (before < 0.0 and min(x[0], x[2]) < place < max(x[0], x[2])):
            return None
        x = place + closer * wide * np.array([-1.0, 0.0, 1.0])
        y = at(x)
    place, height, bend = _top(x, y)
    is_inside = min(x[0], x[2]) < place < max(x[0], x[2])
    is_smooth = before * SMOOTH < bend < before / SMOOTH
    return height if is_inside and is_smooth else None


def _top(x: Array, y: Array) -> tuple[float, float, float]:
    """Return place and height of the top of the parabola through three points, and its bend."""
    left, right = float(x[1] - x[0]), float(x[2] - x[1])
    rise, fall = float(y[1] - y[0]) / left, float(y[2] - y[1]) / right
    bend = (fall - rise) / (left + right)
    slope = (rise * right + fall * left) / (left + right)  # in the middle
    if not bend < 0.0:
        return np.nan, np.nan, bend
    return float(x[1]) - 0.5 * slope / bend, float(y[1]) - 0.25 * slope * slope / bend, bend
