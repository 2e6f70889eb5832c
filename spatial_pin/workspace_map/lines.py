"""Following one branch along the lines of a grid of drivers: what one worker does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.joint_limits import KIND as JOINT_LIMIT
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.jacobians import jacobian, moving_coordinates

LOST = "lost"  # why a branch ends where the numbers give out
NOWHERE = np.full(3, np.nan)  # a point that is not known
NEAR_END = 1e-6  # of the last step: an end is looked at from there, where rates are finite
BEFORE = np.array([9.0, 4.0, 1.0])  # squares, so that square roots are evenly spaced
TO_END = np.array([1.0, -3.0, 3.0])  # the parabola through them, at the end


class Asked(NamedTuple):
    """What is asked for, the same for all lines.

    Attributes:
        mechanism: the mechanism.
        names: coordinates that span the grid.
        frame: whose points are wanted.
        columns: coordinates that Jacobians are taken with respect to; None: all drivers.
        limits: whether joint limits are kept.
        on_crossing: what to do at branch points, as `sweep` has it.
    """

    mechanism: Mechanism
    names: tuple[str, ...]
    frame: str
    columns: tuple[str, ...] | None
    limits: bool
    on_crossing: str


class Run(NamedTuple):
    """A way along a line of the grid, from a configuration.

    Attributes:
        axis: number of the coordinate that changes.
        at: (k,) where it begins.
        values: (m,) of that coordinate to go to, the next first.
        q, angles: the configuration where it begins.
        error: its closure error.
    """

    axis: int
    at: Array
    values: Array
    q: Array
    angles: Array
    error: float


class End(NamedTuple):
    """Where the branch ends.

    Attributes:
        why: "limit", "branch point", "singular", "lost", or "joint limit: " and which.
        value: of the coordinate that changes.
        point: (3,) of the frame there; NaN where it could not be followed up to there.
    """

    why: str
    value: float
    point: Array


class Followed(NamedTuple):
    """What was found along a run, at the m values that were reached.

    Attributes:
        q, angles: (m, nq), (m, n_angles) configurations.
        errors: (m,) closure errors.
        points, rotations: (m, 3), (m, 3, 3) of the frame.
        jacobians: (m, 6, c) of the frame in natural units.
        end: why it goes no further; None where all values were reached.
    """

    q: Array
    angles: Array
    errors: Array
    points: Array
    rotations: Array
    jacobians: Array
    end: End | None


def followed(asked: Asked, runs: Sequence[Run]) -> list[Followed]:
    """Return what is found along some runs."""
    return [_along(asked, run) for run in runs]


def motion_along(
    asked: Asked, run: Run, values: Array
) -> tuple[Motion | None, int, End | None]:
    """Follow the branch from where a run begins to values of its coordinate.

    Returns:
        The motion, whose first row is the beginning; how many of its rows count; and why there
        are no more of them.
    """
    others = {name: float(x) for k, (name, x) in enumerate(zip(asked.names, run.at, strict=True))
              if k != run.axis}
    start = State(asked.mechanism, run.q, closure_error=run.error, angles=run.angles)
    values = np.append(run.at[run.axis], values)
    try:
        motion = sweep(asked.mechanism, asked.names[run.axis], values, guess=start, hold=others,
                       on_limit="stop", on_crossing=asked.on_crossing)
    except SpatialPinError as error:
        kept: Motion | None = getattr(error, "motion", None)
        n = 0 if kept is None else len(kept)
        return kept, n, End(LOST, float(values[max(n - 1, 0)]), NOWHERE)
    n, end = len(motion), None
    if n < len(values):
        last = motion.events[-1]  # what ended it
        end = End(last.kind, last.value, NOWHERE)
    passed = [e for e in motion.events if e.kind == JOINT_LIMIT] if asked.limits else []
    if passed:
        n, words = passed[0].row, passed[0].text.partition(" passed ")[0]
        end = End(f"{JOINT_LIMIT}: {words}", passed[0].value, NOWHERE)
    return motion, n, end


def _along(asked: Asked, run: Run) -> Followed:
    motion, n, end = motion_along(asked, run, run.values)
    if motion is None or n < 2:
        n_angles, none = len(run.angles), np.empty((0, 3))
        rows = Followed(np.empty((0, len(run.q))), np.empty((0, n_angles)), np.empty(0), none,
                        np.empty((0, 3, 3)), natural_jacobians(asked, []), end)
        last = run
    else:
        frame = motion.frame(asked.frame)
        states = [motion.state(row) for row in range(1, n)]
        q, angles, errors, points, turns = (x[1:n].copy() for x in (
            motion.q, motion.angles, motion.closure_error, frame.position, frame.rotation))
        rows = Followed(q, angles, errors, points, turns, natural_jacobians(asked, states), end)
        last = begun(run, float(motion.swept[n - 1]), motion, n - 1)
    return rows if end is None else rows._replace(end=_seen(asked, last, end))


def begun(run: Run, value: float, motion: Motion, row: int) -> Run:
    """Return a run that begins at a row of a motion along another one."""
    at = run.at.copy()
    at[run.axis] = value
    return run._replace(at=at, q=motion.q[row], angles=motion.angles[row],
                        error=float(motion.closure_error[row]))


def _seen(asked: Asked, last: Run, end: End) -> End:
    """Return an end with the frame's point there, seen from the last configuration before it.

    Near a limit position points go as the square root of what is left of the driver's way: they
    are taken for a parabola of it through three places. A joint limit may come before it.
    """
    left = end.value - last.at[last.axis]
    if end.why == LOST or not left:
        return end
    near = end.value - BEFORE * NEAR_END * left
    motion, n, other = motion_along(asked, last, near)
    if other is not None and other.why.startswith(JOINT_LIMIT) and n < 4:
        left = other.value - last.at[last.axis]
        near, end = other.value - BEFORE * NEAR_END * left, other
        motion, n, _ = motion_along(asked, last, near)
    if motion is None or n < 4:
        return end
    places = motion.frame(asked.frame).position
    return end._replace(point=TO_END @ places[1:4])


def natural_jacobians(asked: Asked, states: Sequence[State]) -> Array:
    """Return (m, 6, c) Jacobians, lengths divided by the characteristic length; NaN if singular."""
    mechanism = asked.mechanism
    moving = moving_coordinates(mechanism, asked.columns, "base")
    scale = mechanism.velocity_scale[[c.v for c in moving]]
    found = np.full((len(states), 6, len(moving)), np.nan)
    for k, state in enumerate(states):
        try:
            found[k] = jacobian(mechanism, state, asked.frame, asked.columns) * scale
        except SpatialPinError:  # drivers do not determine the velocities there
            continue
    found[:, :3] /= mechanism.characteristic_length
    return found
