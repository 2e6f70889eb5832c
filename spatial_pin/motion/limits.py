"""The range of a driver, up to limit positions or up to joint limits of the URDF."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import checked
from spatial_pin._support.lazy import Workspaces
from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.state import State
from spatial_pin.continuation.initial_tangent import (
    body_placements,
    non_spinning_bodies,
    system_at,
)
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.continuation.pseudo_arclength import Stopped
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.limit_events import joint_limits_passed, passed_at_start
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

TURN = 2.0 * np.pi
# Characteristic lengths: a slide that goes ten times as far as links reach has no limit.
FARTHEST_SLIDE = 20.0
# After this many turns of a driver the search for a limit ends. Gear trains of the library repeat
# after dozens of turns.
MOST_TURNS = 100
# The same where a joint has gone so far [rad or characteristic lengths]: a hundred turns for each
# of these. By a cubic law of a coupling it would be millions.
FARTHEST_JOINT = 100 * MOST_TURNS * TURN
SPAN_SAMPLES = 721  # samples of one turn: one per half degree
# Distances to a bound at which samples are added, as parts of the range: each is half of the one
# before, and the last is a ten-thousandth of a sample distance.
TOWARDS = 0.5 ** np.arange(13.0) / SPAN_SAMPLES


class Bound(NamedTuple):
    """One end of a driver's range.

    Attributes:
        value: driver value [rad or m], infinite where there is no limit.
        kind: "limit" (the driver turns back), "branch point", "singular", "none", "upper limit of
            JOINT" or "lower limit of JOINT" (of the URDF), "COORDINATE runs away" (without end,
            while the driver comes to that value), or "not followed further" (the value is then the
            last one reached).

    Example:
        >>> bound = sp.limits(sp.load("four_bar", r2=0.25), "crank").upper
        >>> bound.kind, round(bound.value, 4)  # [rad]
        ('limit', 2.4751)
    """

    value: float
    kind: str


class Range(NamedTuple):
    """The range of a driver on its branch.

    Attributes:
        driver: name of the driver or coordinate.
        lower, upper: the two ends.
        unit: "rad" or "m".
        full_turn: whether it turns fully.

    Example:
        >>> span = sp.limits(sp.load("four_bar"), "crank")
        >>> span.full_turn, span.lower.value, span.upper.kind
        (True, -inf, 'none')
    """

    driver: str
    lower: Bound
    upper: Bound
    unit: str
    full_turn: bool

    def __str__(self) -> str:
        if self.full_turn:
            return f"{self.driver}: full turn"
        ends = []
        for bound in (self.lower, self.upper):
            degrees = f" ({np.degrees(bound.value):.9g}°)" * (self.unit == "rad")
            ends.append("no limit" if bound.kind == "none" else
                        f"{bound.value:.12g} {self.unit}{degrees} ({bound.kind})")
        return f"{self.driver}: from {ends[0]} to {ends[1]}"


@checked
def limits(
    mechanism: Mechanism,
    driver: str,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    joints: bool = False,
    hold: Hold = BASE,
) -> Range:
    """Find the range of a driver on the branch of a guess.

    Dead centres are located by arc length, where the driver turns back, to about 1e-14. If a joint
    goes to infinity, the driver's value is extrapolated, to 1e-11 at least.

    Args:
        mechanism: the mechanism; other drivers stay where the guess has them.
        driver: a driver or coordinate.
        guess: where to start, as for `assemble`.
        joints: end the range where a joint, the driver's own among them, reaches a limit of the
            URDF: the bound is then of kind "upper limit of" or "lower limit of" that joint.
        hold: names of other joints that stand still, as for `sweep`.

    Returns:
        The Range [rad or m]; its bounds are infinite where nothing stops the driver.

    Raises:
        AssemblyError: the guess does not close.
        SingularError: the guess closes in a singular configuration.
        SpatialPinError: with `joints`, the guess closes beyond a joint limit.
        ValueError: the driver is held.

    Example:
        >>> span = sp.limits(sp.load("four_bar", r2=0.25), "crank")
        >>> round(span.lower.value, 4), round(span.upper.value, 4), span.unit, span.full_turn
        (-2.4751, 2.4751, 'rad', False)
    """
    system, state, moved = system_at(mechanism, driver, guess, hold)
    coordinate, bodies = system.driven[0], non_spinning_bodies(system)
    span = TURN if coordinate.unit == "rad" else FARTHEST_SLIDE * mechanism.characteristic_length
    ends = [_bound(state, coordinate, moved.hold, bodies, sense * span) for sense in (-1.0, 1.0)]
    turns = coordinate.unit == "rad" and all(end.kind == "none" for end in ends)
    limit_range = Range(driver, ends[0], ends[1], coordinate.unit, turns)
    mechanism = state.mechanism
    if not joints or not joint_limits(mechanism):
        return limit_range
    passed = passed_at_start(mechanism, state.q, 0.0)
    if passed:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: {state} is beyond the {passed[0].limit.words}; give a "
            "guess within the joint limits (assemble(limits=True) finds one)")
    lower, upper = (_nearer(mechanism, state, driver, bound, sense * span, moved.hold)
                    for bound, sense in ((limit_range.lower, -1.0), (limit_range.upper, 1.0)))
    free = limit_range.full_turn and lower == limit_range.lower and upper == limit_range.upper
    return limit_range._replace(lower=lower, upper=upper, full_turn=free)


def _bound(
    state: State, driver: Coordinate, hold: Hold, bodies: list[int], span: float
) -> Bound:
    """Follow span after span up to a limit, or until a turn ends in its first configuration.

    `bodies` are those that come back with the loops.
    """
    singles = [c for c in state.mechanism.coordinate_table.values() if c.q >= 0]
    entries = [c.q for c in singles]
    farthest = FARTHEST_JOINT * state.mechanism.velocity_scale[[c.v for c in singles]]
    with Workspaces() as workspaces:
        tracker = PathTracker.along(
            state, [driver.name], hold, Accuracy.named("engineering"), workspaces)
        evaluation = tracker.evaluation

        def places() -> Array:
            here = tracker.here
            evaluation.angle_reference[:] = here.angles
            evaluation.update(here.q)
            return body_placements(evaluation, bodies)

        start, first = tracker.here.s, places()
        for k in range(1, MOST_TURNS + 1):
            try:
                tracker.reach(start + k * span)
            except Stopped as stopped:
                kind = "not followed further" if stopped.kind == "lost" else stopped.kind
                if stopped.runs_away:
                    kind = f"{stopped.runs_away} runs away"
                return Bound(stopped.value, kind)
            moved = np.abs(places() - first).max(initial=0.0)
            if driver.unit != "rad" or (moved < TOLERANCES.half_precision and np.allclose(
                    tracker.here.angles, state.angles)):
                return Bound(math.copysign(math.inf, span), "none")
            if (np.abs(tracker.here.q - state.q)[entries] > farthest).any():
                break
        return Bound(tracker.here.s, "not followed further")


def _nearer(
    mechanism: Mechanism, state: State, driver: str, bound: Bound, span: float, hold: Hold
) -> Bound:
    """Return the first joint limit before a bound, else the bound; spans, turns, one by one."""
    for _ in range(MOST_TURNS):
        start = float(state.coordinate(driver).value)
        end = start + span
        last = abs(bound.value - start) <= abs(span)
        parts = np.append(np.arange(SPAN_SAMPLES - 1.0) / (SPAN_SAMPLES - 1),
                          1.0 - TOWARDS if last else 1.0)
        values = start + parts * ((bound.value if last else end) - start)
        motion = sweep(mechanism, driver, values, guess=state, hold=hold, on_limit="stop")
        passed = joint_limits_passed(motion)
        if passed:
            side = "upper" if passed[0].limit.side > 0 else "lower"
            return Bound(passed[0].value, f"{side} limit of {passed[0].limit.name}")
        returns = all(abs(motion.q[-1, limit.q] - motion.q[0, limit.q])
                      < TOLERANCES.half_precision * limit.size
                      for limit in joint_limits(motion.mechanism))
        if last or returns or mechanism.coordinate(driver).unit == "m":
            return bound
        state = motion.state(-1)
    return Bound(float(state.coordinate(driver).value), "not followed further")
