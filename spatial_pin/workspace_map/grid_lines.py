"""Following one branch along the lines of a grid of drivers or poses: what one worker does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.joint_limit_events import KIND as JOINT_LIMIT
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.proximity.clearance_search import PLACE_ERROR
from spatial_pin.proximity.distances import Distances
from spatial_pin.rates.jacobians import jacobian, moving_coordinates
from spatial_pin.rates.prescribed import Prescription

PLACE_OF_TOUCH = 1e-6  # part of a cell to which a place is known where links come too near
LOST = "lost"  # why a branch ends where the numbers give out
NOWHERE = np.full(3, np.nan)  # a point that is not known
NEAR_END = 1e-6  # of the last step: an end is looked at from there, where rates are finite
BEFORE = np.array([9.0, 4.0, 1.0])  # squares, so that square roots are evenly spaced
TO_END = np.array([1.0, -3.0, 3.0])  # the parabola through them, at the end


class GridConfig(NamedTuple):
    """What is asked for, the same for all lines."""

    mechanism: Mechanism  # what is followed: the mechanism, or its copy whose coordinates are poses
    names: tuple[str, ...]  # coordinates that span the grid
    frame: str  # whose points are wanted
    columns: tuple[str, ...] | None  # coordinates that Jacobians are for; None: all drivers
    limits: bool  # whether joint limits are kept
    on_crossing: str  # what to do at branch points, as `sweep` has it
    standing: tuple[str, ...]  # coordinates that stand still besides
    hold: tuple[str, ...]  # names of what else stands still, as `sweep` has it
    body: Mechanism  # the mechanism itself
    apart: float | None = None  # least distance that links which are not joined keep [m]

    @property
    def is_posed(self) -> bool:
        """Whether the grid is one of poses."""
        return self.body is not self.mechanism

    @property
    def moving(self) -> list[Coordinate]:
        """What the columns of Jacobians belong to."""
        given = Prescription.of(self.body, moving_coordinates(
            self.body, self.columns, self.hold), self.hold)
        return given.driven[: given.n_moving]

    def own(self, state: State) -> State:
        """Return a configuration of the mechanism itself."""
        if not self.is_posed:
            return state
        return State(self.body, state.q[: self.body.model.nq], closure_error=state.closure_error,
                     angles=state.angles)


class GridLine(NamedTuple):
    """A way along a line of the grid, from a configuration."""

    axis: int  # number of the coordinate that changes
    at: Array  # (k,) where it begins
    values: Array  # (m,) of that coordinate to go to, the next first
    q: Array  # the configuration where it begins
    angles: Array
    error: float  # its closure error


class Termination(NamedTuple):
    """Where the branch ends."""

    why: str  # "limit", "branch point", "singular", "lost", or "joint limit: " and which
    value: float  # of the coordinate that changes
    # (3,) of the frame there; NaN where it could not be followed up to there, or runs away without
    # end
    point: Array
    q: Array | None = None  # the last configuration before it that is known; None where none is
    angles: Array | None = None


class LinePoints(NamedTuple):
    """What was found along a run, at the m values that were reached."""

    q: Array  # (m, nq), (m, n_angles) configurations
    angles: Array
    errors: Array  # (m,) closure errors
    points: Array  # (m, 3), (m, 3, 3) of the frame
    rotations: Array
    jacobians: Array  # (m, 6, c) of the frame in natural units
    end: Termination | None  # why it goes no further; None where all values were reached


def followed(asked: GridConfig, runs: Sequence[GridLine]) -> list[LinePoints]:
    """Return what is found along some runs."""
    distances = None if asked.apart is None else Distances(asked.body)
    return [_along(asked, run, distances) for run in runs]


def motion_along(
    asked: GridConfig, run: GridLine, values: Array
) -> tuple[Motion | None, int, Termination | None]:
    """Follow the branch from where a run begins to values of its coordinate.

    Returns:
        The motion, whose first row is the beginning; how many of its rows count; and why there
        are no more of them.
    """
    others = [name for k, name in enumerate(asked.names) if k != run.axis]
    start = State(asked.mechanism, run.q, closure_error=run.error, angles=run.angles)
    values = np.append(run.at[run.axis], values)
    try:
        motion = sweep(asked.mechanism, asked.names[run.axis], values, guess=start,
                       hold=[*asked.hold, *others, *asked.standing],
                       on_limit="stop", on_crossing=asked.on_crossing)
    except SpatialPinError as error:
        kept: Motion | None = getattr(error, "motion", None)
        n = 0 if kept is None else len(kept)
        return kept, n, Termination(LOST, float(values[max(n - 1, 0)]), NOWHERE)
    n, end = len(motion), None
    if n < len(values):
        last = motion.events[-1]  # what ended it
        end = Termination(last.kind, last.value, NOWHERE)
    passed = [e for e in motion.events if e.kind == JOINT_LIMIT] if asked.limits else []
    if passed:
        n, words = passed[0].row, passed[0].text.partition(" passed ")[0]
        end = Termination(f"{JOINT_LIMIT}: {words}", passed[0].value, NOWHERE)
    return motion, n, end


def touching(asked: GridConfig, distances: Distances, q: Array) -> str:
    """Return which links are nearer to each other than is allowed, in words; empty if none."""
    assert asked.apart is not None
    distances.place(q[: asked.body.model.nq])
    links = distances.touching(asked.apart + PLACE_ERROR * asked.body.characteristic_length)
    if links is None:
        return ""
    return f"{'links touch' if not asked.apart else f'nearer than {asked.apart:.9g} m'}: " + (
        " and ".join(links))


def _apart(
    asked: GridConfig, run: GridLine, distances: Distances, motion: Motion, n: int,
    end: Termination | None,
) -> tuple[int, Termination | None]:
    """Return how many rows of a motion count, and why no more, where links are to keep apart.

    They are looked at at points of the grid; the place before one at which they come too near is
    searched by halves.
    """
    for row in range(1, n):
        words = touching(asked, distances, motion.q[row])
        if not words:
            continue
        last = begun(run, float(motion.swept[row - 1]), motion, row - 1)
        good, bad = float(motion.swept[row - 1]), float(motion.swept[row])
        cell = abs(bad - good)
        q, angles, point = last.q, last.angles, NOWHERE
        while abs(bad - good) > PLACE_OF_TOUCH * cell:
            middle = 0.5 * (good + bad)
            there, count, _ = motion_along(asked, last, np.array([middle]))
            if there is None or count < 2:
                break
            found = touching(asked, distances, there.q[1])
            if found:
                bad, words = middle, found
            else:
                good, q, angles = middle, there.q[1], there.angles[1]
                point = there.frame(asked.frame).position[1]
        return row, Termination(words, good, point, q, angles)
    return n, end


def _along(asked: GridConfig, run: GridLine, distances: Distances | None) -> LinePoints:
    motion, n, end = motion_along(asked, run, run.values)
    is_near = False
    if motion is not None and distances is not None:
        whole = n
        n, end = _apart(asked, run, distances, motion, n, end)
        is_near = n < whole
    if motion is None or n < 2:
        n_angles, none = len(run.angles), np.empty((0, 3))
        rows = LinePoints(np.empty((0, len(run.q))), np.empty((0, n_angles)), np.empty(0), none,
                        np.empty((0, 3, 3)), natural_jacobians(asked, []), end)
        last = run
    else:
        frame = motion.frame(asked.frame)
        states = [motion.state(row) for row in range(1, n)]
        q, angles, errors, points, turns = (x[1:n].copy() for x in (
            motion.q, motion.angles, motion.closure_error, frame.position, frame.rotation))
        rows = LinePoints(q, angles, errors, points, turns, natural_jacobians(asked, states), end)
        last = begun(run, float(motion.swept[n - 1]), motion, n - 1)
    if end is None or is_near:
        return rows._replace(end=end)
    return rows._replace(end=_seen(asked, last, end))


def begun(run: GridLine, value: float, motion: Motion, row: int) -> GridLine:
    """Return a run that begins at a row of a motion along another one."""
    at = run.at.copy()
    at[run.axis] = value
    return run._replace(at=at, q=motion.q[row], angles=motion.angles[row],
                        error=float(motion.closure_error[row]))


def _seen(asked: GridConfig, last: GridLine, end: Termination) -> Termination:
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
    if np.ptp(places[1:4], axis=0).max() > asked.body.characteristic_length:
        return end  # it runs away without end
    return end._replace(point=TO_END @ places[1:4], q=motion.q[3], angles=motion.angles[3])


def natural_jacobians(asked: GridConfig, states: Sequence[State]) -> Array:
    """Return (m, 6, c) Jacobians, lengths divided by the characteristic length; NaN if singular."""
    mechanism = asked.body
    moving = asked.moving
    scale = mechanism.velocity_scale[[c.v for c in moving]]
    found = np.full((len(states), 6, len(moving)), np.nan)
    for k, state in enumerate(states):
        try:
            found[k] = scale * jacobian(mechanism, asked.own(state), asked.frame, asked.columns,
                                        hold=asked.hold)
        except SpatialPinError:  # drivers do not determine the velocities there
            continue
    found[:, :3] /= mechanism.characteristic_length
    return found
