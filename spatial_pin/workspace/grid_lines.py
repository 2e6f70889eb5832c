"""Following one branch along the lines of a grid of drivers or poses: the work of one worker."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.limit_events import KIND as JOINT_LIMIT
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.proximity.clearance import standing
from spatial_pin.proximity.clearance_search import DISTANCE_ERROR
from spatial_pin.proximity.distances import Distances
from spatial_pin.rates.jacobians import jacobian, moving_coordinates
from spatial_pin.rates.prescribed import Prescription

CONTACT_ACCURACY = 1e-6  # of the configuration where links come too near, relative to a cell
LOST = "lost"  # reason of an end by a failure of the numbers
NOWHERE = np.full(3, np.nan)  # an unknown point
NEAR_END = 1e-6  # of the last step: an end is extrapolated from there, where rates are finite
BEFORE = np.array([9.0, 4.0, 1.0])  # squares, so that square roots are evenly spaced
TO_END = np.array([1.0, -3.0, 3.0])  # the parabola through them, at the end


class GridConfig(NamedTuple):
    """The settings of a grid, the same for all lines."""

    mechanism: Mechanism  # the mechanism, or its copy with poses as coordinates
    names: tuple[str, ...]  # coordinates that span the grid
    frame: str
    columns: tuple[str, ...] | None  # coordinates of the Jacobians; None: all drivers
    limits: bool  # whether joint limits count
    on_crossing: str  # behaviour at branch points, as for `sweep`
    standing: tuple[str, ...]  # other fixed coordinates
    hold: tuple[str, ...]  # names of further fixed coordinates, as for `sweep`
    body: Mechanism  # the mechanism itself
    apart: float | None = None  # least distance between links that are not joined [m]

    @property
    def is_posed(self) -> bool:
        """Whether the grid is one of poses."""
        return self.body is not self.mechanism

    @property
    def moving(self) -> list[Coordinate]:
        """The coordinates of the Jacobians' columns."""
        given = Prescription.of(self.body, moving_coordinates(
            self.body, self.columns, self.hold), self.hold)
        return given.driven[: given.n_moving]

    def distances(self) -> Distances | None:
        """Return the distances of links; None if they need not keep one."""
        return None if self.apart is None else Distances(self.body)

    def own(self, state: State) -> State:
        """Return a configuration as a state of the mechanism itself."""
        if not self.is_posed:
            return state
        return State(self.body, state.q[: self.body.model.nq], closure_error=state.closure_error,
                     angles=state.angles)


class Border(NamedTuple):
    """The end of the branch on a line of the grid, or a zero of a determinant."""

    drivers: Array  # (k,) values of the grid's coordinates
    point: Array  # (3,) of the frame; NaN if it could not be followed so far, or is infinite
    # the reason: "limit", "branch point", "singular", "lost", "joint limit: " and its name, ...
    why: str
    q: Array | None = None  # a configuration there, or just before; None if unknown
    angles: Array | None = None


class GridLine(NamedTuple):
    """A part of a line of the grid, from a configuration."""

    axis: int  # number of the coordinate that changes
    at: Array  # (k,) start values
    values: Array  # (m,) values of that coordinate to reach, the next first
    q: Array  # start configuration
    angles: Array
    error: float  # its closure error

    def to(self, value: float) -> Array:
        """Return the coordinates (k,) where the one that changes has a value."""
        at = self.at.copy()
        at[self.axis] = value
        return at


class LinePoints(NamedTuple):
    """The m reached points of a line."""

    q: Array  # (m, nq), (m, n_angles) configurations
    angles: Array
    errors: Array  # (m,) closure errors
    points: Array  # (m, 3), (m, 3, 3) of the frame
    rotations: Array
    jacobians: Array  # (m, 6, c) of the frame in natural units
    end: Border | None  # reason of the end; None if all values were reached


def followed(config: GridConfig, runs: Sequence[GridLine]) -> list[LinePoints]:
    """Return the points of some lines."""
    distances = config.distances()
    return [_along(config, run, distances) for run in runs]


def motion_along(
    config: GridConfig, run: GridLine, values: Array
) -> tuple[Motion, int, Border | None]:
    """Follow the branch from the start of a line to values of its coordinate.

    Return the motion from the start on, the number of its valid rows, and why there are no more.
    """
    others = [name for k, name in enumerate(config.names) if k != run.axis]
    start = State(config.mechanism, run.q, closure_error=run.error, angles=run.angles)
    values = np.append(run.at[run.axis], values)
    try:
        motion = sweep(config.mechanism, config.names[run.axis], values, guess=start,
                       hold=[*config.hold, *others, *config.standing],
                       on_limit="stop", on_crossing=config.on_crossing)
    except SpatialPinError as error:
        partial: Motion = getattr(error, "motion", None) or standing(start)
        n = len(partial)
        return partial, n, Border(run.to(float(values[n - 1])), NOWHERE, LOST)
    n, end = len(motion), None
    if n < len(values):
        last = motion.events[-1]  # what ended it
        end = Border(run.to(last.value), NOWHERE, last.kind)
    passed = [e for e in motion.events if e.kind == JOINT_LIMIT] if config.limits else []
    if passed:
        n, words = passed[0].row, passed[0].text.partition(" passed ")[0]
        end = Border(run.to(passed[0].value), NOWHERE, f"{JOINT_LIMIT}: {words}")
    return motion, n, end


def touching(config: GridConfig, distances: Distances | None, q: Array) -> str:
    """Return the links that are too near to each other, in words; empty if none."""
    if distances is None or config.apart is None:
        return ""
    distances.update(q[: config.body.model.nq])
    links = distances.touching(config.apart + DISTANCE_ERROR * config.body.characteristic_length)
    if links is None:
        return ""
    return f"{'links touch' if not config.apart else f'nearer than {config.apart:.9g} m'}: " + (
        " and ".join(links))


def _apart(
    config: GridConfig, run: GridLine, distances: Distances, motion: Motion, n: int,
    end: Border | None,
) -> tuple[int, Border | None]:
    """Return the number of valid rows of a motion, and why no more, if links must keep a distance.

    Distances are checked at points of the grid; the end before a point with too near links is found
    by bisection.
    """
    for row in range(1, n):
        words = touching(config, distances, motion.q[row])
        if not words:
            continue
        last = restarted(run, float(motion.swept[row - 1]), motion, row - 1)
        good, bad = float(motion.swept[row - 1]), float(motion.swept[row])
        cell = abs(bad - good)
        q, angles, point = last.q, last.angles, NOWHERE
        while abs(bad - good) > CONTACT_ACCURACY * cell:
            middle = 0.5 * (good + bad)
            there, count, _ = motion_along(config, last, np.array([middle]))
            if count < 2:
                break
            links = touching(config, distances, there.q[1])
            if links:
                bad, words = middle, links
            else:
                good, q, angles = middle, there.q[1], there.angles[1]
                point = there.frame(config.frame).position[1]
        return row, Border(run.to(good), point, words, q, angles)
    return n, end


def _along(config: GridConfig, run: GridLine, distances: Distances | None) -> LinePoints:
    motion, n, end = motion_along(config, run, run.values)
    followed = n
    if distances is not None:
        n, end = _apart(config, run, distances, motion, n, end)
    if end is not None and n == followed:
        last = run if n < 2 else restarted(run, float(motion.swept[n - 1]), motion, n - 1)
        end = _seen(config, last, end)
    frame = motion.frame(config.frame)
    q, angles, errors, points, turns = (x[1:n].copy() for x in (
        motion.q, motion.angles, motion.closure_error, frame.position, frame.rotation))
    jacobians = natural_jacobians(config, [motion.state(row) for row in range(1, n)])
    return LinePoints(q, angles, errors, points, turns, jacobians, end)


def restarted(run: GridLine, value: float, motion: Motion, row: int) -> GridLine:
    """Return a line that begins at a row of a motion along another one."""
    return run._replace(at=run.to(value), q=motion.q[row], angles=motion.angles[row],
                        error=float(motion.closure_error[row]))


def _seen(config: GridConfig, last: GridLine, end: Border) -> Border:
    """Return an end with the frame's point there, extrapolated from the configuration before it.

    Near a limit position points change as the square root of the driver's distance: they are taken
    as a parabola of it through three points. A joint limit may come before it.
    """
    value = end.drivers[last.axis]
    distance = value - last.at[last.axis]
    if end.why == LOST or not distance:
        return end
    near = value - BEFORE * NEAR_END * distance
    motion, n, other = motion_along(config, last, near)
    if other is not None and other.why.startswith(JOINT_LIMIT) and n < 4:
        value, end = other.drivers[last.axis], other
        near = value - BEFORE * NEAR_END * (value - last.at[last.axis])
        motion, n, _ = motion_along(config, last, near)
    if n < 4:
        return end
    positions = motion.frame(config.frame).position
    if np.ptp(positions[1:4], axis=0).max() > config.body.characteristic_length:
        return end  # it runs away without end
    return end._replace(point=TO_END @ positions[1:4], q=motion.q[3], angles=motion.angles[3])


def natural_jacobians(config: GridConfig, states: Sequence[State]) -> Array:
    """Return (m, 6, c) Jacobians, lengths divided by the characteristic length; NaN if singular."""
    mechanism = config.body
    moving = config.moving
    scale = mechanism.velocity_scale[[c.v for c in moving]]
    jacobians = np.full((len(states), 6, len(moving)), np.nan)
    for k, state in enumerate(states):
        try:
            jacobians[k] = scale * jacobian(mechanism, config.own(state), config.frame,
                                            config.columns, hold=config.hold)
        except SpatialPinError:  # drivers do not determine the velocities there
            continue
    jacobians[:, :3] /= mechanism.characteristic_length
    return jacobians
