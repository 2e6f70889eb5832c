"""How far a driver can go before a joint reaches a limit of the URDF."""

from __future__ import annotations

import numpy as np

from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.joint_limits import (
    Passing,
    falls,
    joint_limits_passed,
    passed_at_start,
)
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.ranges import Bound, Range
from spatial_pin.motion.sweep import sweep

ROWS = 721  # of a span
TOWARDS = 0.5 ** np.arange(13.0) / ROWS  # parts of the way left before a bound, at rows near it
SAME = 1e-6  # change of joints with limits over a turn that is none [rad, characteristic lengths]
MOST_TURNS = 100  # turns of a driver whose joints with limits go further with every turn


def within_joint_limits(
    mechanism: Mechanism, state: State, found: Range, span: float, hold: Hold = BASE
) -> Range:
    """Return a driver's range as far as no joint is beyond a limit.

    Args:
        mechanism: the mechanism.
        state: where the driver starts.
        found: its range without joint limits.
        span: a whole turn, or the longest way of a slide.
        hold: names of what stands still besides.

    Raises:
        SpatialPinError: a joint is beyond its limit at the start.
    """
    if not joint_limits(mechanism):
        return found
    start = passed_at_start(mechanism, state.q, 0.0)
    if start:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: {state} is beyond the {start[0].limit.words}; give a "
            "guess within the joint limits (assemble(limits=True) finds one)")
    lower, upper = (_nearer(mechanism, state, found.driver, bound, sense * span, hold)
                    for bound, sense in ((found.lower, -1.0), (found.upper, 1.0)))
    free = found.full_turn and lower == found.lower and upper == found.upper
    return found._replace(lower=lower, upper=upper, full_turn=free)


def _nearer(
    mechanism: Mechanism, state: State, driver: str, bound: Bound, span: float, hold: Hold
) -> Bound:
    """Return the first joint limit before a bound, else the bound; spans, turns, one by one."""
    for _ in range(MOST_TURNS):
        start = float(state.coordinate(driver).value)
        end = start + span
        last = abs(bound.value - start) <= abs(span)
        parts = np.append(np.arange(ROWS - 1.0) / (ROWS - 1), 1.0 - TOWARDS if last else 1.0)
        values = start + parts * ((bound.value if last else end) - start)
        motion = sweep(mechanism, driver, values, guess=state, hold=hold, on_limit="stop")
        passed = joint_limits_passed(motion)
        if passed:
            side = "upper" if passed[0].limit.side > 0 else "lower"
            return Bound(_exactly(motion, passed[0]), f"{side} limit of {passed[0].limit.name}")
        if last or _returns(motion) or mechanism.coordinate(driver).unit == "m":
            return bound
        state = motion.state(-1)
    return Bound(float(state.coordinate(driver).value), "not followed further")


def _exactly(motion: Motion, passing: Passing) -> float:
    """Return where a limit is passed between two rows, loops closed at every trial."""
    row, limit = passing.row, passing.limit
    rooms = limit.room(motion.q[row - 1 : row + 1])
    if not rooms[0] > 0.0 > rooms[1]:
        return passing.value  # it turns back in between
    ends, before = motion.swept[row - 1 : row + 1], motion.state(row - 1)

    def room(value: float) -> float:
        way = sweep(motion.mechanism, motion.driver_name, [ends[0], value], guess=before,
                    hold=motion.held)
        return float(limit.room(way.q[-1]))

    return falls(room, *ends.tolist())


def _returns(motion: Motion) -> bool:
    """Whether joints with limits end where they began."""
    return all(abs(motion.q[-1, limit.q] - motion.q[0, limit.q]) < SAME * limit.size
               for limit in joint_limits(motion.mechanism))
