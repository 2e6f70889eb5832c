"""A mechanism jogged by hand: one driver at a time on its branch, or a link that is dragged."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import Workspaces
from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State
from spatial_pin.continuation.branch_points import passage
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.continuation.pseudo_arclength import Stopped
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.inverse_kinematics.reach import reach
from spatial_pin.inverse_kinematics.targets import Residual, Target
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import finite_number
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.limit_events import joint_limits_passed
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.prescribed import driven_coordinates
from spatial_pin.settings import Accuracy

TURN = 2 * np.pi  # either way, that a driver without limits can be moved by hand [rad]
DRAGGED = 0.5  # the same of one that slides relative to the characteristic length
FARTHEST_MOVE = 20.0  # turns, or characteristic lengths, that one move may go
BESIDE = 1e-5  # distance from a limit that the next move begins at [rad, characteristic lengths]
FIRM = 1e-4  # smallest over largest pivot that a move may begin with
MOST_BRANCH_POINTS = 100  # in one move
NUDGE = 0.05  # away from a dead centre [rad, characteristic lengths]: its square moves the link
STILL = 1e-6  # of a driver that does not move [rad or m]
OFF_POINTER = 1e-3  # of a point from the pointer [characteristic lengths]: a pixel or two
STOPS = {
    "limit": "limit position",
    "branch point": "branch point",
    "singular": "singular configuration",
    "lost": "end of the branch as far as it can be followed",
    "joint limit": "joint limit",
}


class JogStop(NamedTuple):
    """Where a driver cannot go on."""

    kind: str  # one of STOPS
    value: float  # driver value [rad or m]
    of: str = ""  # the coordinate whose joint limit it is


class Jog:
    """A closed configuration that follows its drivers, never leaving its branch.

    Attributes:
        mechanism: what moves.
        state: where it is.
        names: of the drivers or coordinates that move it.
        driven: the coordinates that are held, those that are moved too.
        regular: the last state in which they determine the motion: moves begin there.
        keeps_limits: whether joint limits of the URDF are in the way, of any joint.
    """

    def __init__(self, state: State, names: Iterable[str]) -> None:
        """Begin at a state, with drivers or any coordinates that determine the motion.

        Raises:
            SingularError: they do not determine it there.
            UnknownNameError: there is no such driver or coordinate.
            SpatialPinError: there are none.
        """
        self.mechanism = state.mechanism
        self.names = tuple(names)
        if not self.names:
            raise SpatialPinError(
                f"mechanism {self.mechanism.name!r} has no drivers: name coordinates to move it by"
            )
        self._accuracy = Accuracy.named("engineering")
        self.keeps_limits = False
        self.driven = [self.mechanism.driven_coordinate(c.name)
                        for c in driven_coordinates(self.mechanism, self.names)]
        self._coordinates = {n: self.mechanism.driven_coordinate(n) for n in self.names}
        self.move_to(state)

    def move_to(self, state: State) -> None:
        """Go to another closed configuration, of this branch or any other."""
        with self._tracker(state, self.driven):
            self.state = self.regular = state  # moves begin where the motion is determined
        self._home = {name: self.value(name) for name in self.names}

    def value(self, name: str) -> float:
        """Return where a driver is [rad or m]."""
        return self.values(self.state)[name]

    def values(self, state: State) -> dict[str, float]:
        """Return where the drivers of a state are [rad or m]."""
        return {name: float(state.q[c.q]) for name, c in self._coordinates.items()}

    def others(self) -> list[str]:
        """Return the coordinates that are held and not moved."""
        moved = {c.name for c in self._coordinates.values()}
        return [c.name for c in self.driven if c.name not in moved]

    def held(self) -> dict[str, float]:
        """Return the values of all coordinates that are held, those that are moved too."""
        return {c.name: float(self.state.q[c.q]) for c in self.driven}

    def span(self, name: str) -> float:
        """Return how far a driver without limits goes either way [rad or m]."""
        unit = self._coordinates[name].unit
        return TURN if unit == "rad" else DRAGGED * self.mechanism.characteristic_length

    def move(self, name: str, value: float) -> JogStop | None:
        """Move a driver to a value [rad or m], or as far as it goes; the others are held.

        Return the obstacle at which the mechanism stopped; None without one.
        """
        value = finite_number(value, f"value of {name!r}")
        coordinate = self._coordinates[name]
        unit = TURN if coordinate.unit == "rad" else self.mechanism.characteristic_length
        if abs(value - self.value(name)) > FARTHEST_MOVE * unit:
            words = "turns" if coordinate.unit == "rad" else "characteristic lengths"
            raise ValueError(f"{name}: a move goes no further than {FARTHEST_MOVE:g} {words}")
        values = np.array([self.value(name), value])
        limit = first_joint_limit(self, name, values, followed(self, name, values))
        goal = value if limit is None else limit.value
        driven = sorted(self.driven, key=lambda c: c.name != coordinate.name)
        with self._tracker(self.regular, driven) as tracker:
            stop = self._go(tracker, goal)
        if self.state is not self.regular:  # else the others would jump in the next move
            with self._tracker(self.regular, driven) as tracker:
                end = goal if stop is None else stop.value
                size = self.mechanism.velocity_scale[tracker.driven[0].v]
                near = float(np.copysign(BESIDE * size, end - tracker.here.s))
                if abs(end - tracker.here.s) > abs(near):
                    with contextlib.suppress(Stopped):
                        tracker.reach(end - near)
                        self._keep(tracker)
        return stop or limit

    @contextlib.contextmanager
    def _tracker(self, state: State, driven: Sequence[Coordinate]) -> Iterator[PathTracker]:
        """Acquire a tracker on the branch of a state, the first coordinate driven."""
        with Workspaces() as workspaces:
            tracker = PathTracker(state.mechanism, driven, None, self._accuracy, workspaces)
            tracker.start(state)
            yield tracker

    def _go(self, tracker: PathTracker, value: float) -> JogStop | None:
        """Follow a branch to a value, straight on where it crosses another one."""
        for _ in range(MOST_BRANCH_POINTS):
            try:
                tracker.reach(value)
            except Stopped as stopped:
                self._keep(tracker)
                track = passage(tracker, stopped)
                if track is None:
                    self.state = tracker.here.state(tracker.mechanism)
                    if not stopped.runs_away and stopped.kind != "lost":
                        evaluation = tracker.evaluation
                        evaluation.angle_reference[:] = self.state.angles
                        evaluation.update(stopped.q)
                        self.state = State(self.mechanism, stopped.q, angles=evaluation.angles,
                                           closure_error=evaluation.closure_error)
                    kind = "limit" if stopped.runs_away else stopped.kind
                    return JogStop(kind, float(stopped.value))
                tracker.move_to(track.point_at(value))
            if tracker.here.s == value:
                break
        self.state = self._keep(tracker)
        return None

    def _keep(self, tracker: PathTracker) -> State:
        """Return the tracker's state; the next move begins there if the motion is determined."""
        state = tracker.here.state(tracker.mechanism)
        with contextlib.suppress(SingularError):
            if tracker.checked_system(state).pivot >= FIRM:
                self.regular = state
        return state

    def room(self, name: str) -> tuple[float, float]:
        """Return where a driver without limits ends [rad or m].

        That is a turn, or half a characteristic length, to either side of its home.
        """
        home, span, now = self._home[name], self.span(name), self.value(name)
        if abs(now - home) > span:
            home = self._home[name] = now
        return home - span, home + span


# ---------------------------------------------------------------- ranges of drivers


def followed(jog: Jog, name: str, values: Array) -> Motion | None:
    """Return the motion from the present pose through values of a driver."""
    moved = jog.mechanism.driven_coordinate(name).name
    others = {c.name: float(jog.regular.q[c.q]) for c in jog.driven if c.name != moved}
    try:
        return sweep(jog.mechanism, name, values, guess=jog.regular, hold=others, on_limit="stop")
    except SpatialPinError as error:
        return getattr(error, "motion", None)


def first_joint_limit(
    jog: Jog, name: str, values: Array, motion: Motion | None
) -> JogStop | None:
    """Return the first joint limit among values of a driver, if limits are kept.

    A joint that is beyond its limit from the start may come back, but go no further.
    """
    if not jog.keeps_limits or motion is None or not len(motion):
        return None
    if len(motion) < len(values):  # a last sample just before its end, if that is between two
        last, end = float(motion.swept[-1]), motion.events[-1].value
        before = BESIDE * jog.mechanism.velocity_scale[jog.mechanism.driven_coordinate(name).v]
        near = end - float(np.copysign(before, values[-1] - values[0]))
        if (near - last) * (values[-1] - values[0]) > 0.0:
            motion = followed(jog, name, np.append(motion.swept, near)) or motion
    start, stops = float(motion.swept[0]), list[JogStop]()
    for passing in joint_limits_passed(motion):
        room = passing.limit.room(motion.q[:2])
        if passing.where:
            stops.append(JogStop("joint limit", passing.value, passing.limit.name))
        elif room[-1] < room[0]:
            stops.append(JogStop("joint limit", start, passing.limit.name))
    return min(stops, key=lambda stop: abs(stop.value - start), default=None)


def reaches(
    jog: Jog, name: str, rows: int
) -> tuple[tuple[float, float], tuple[JogStop | None, JogStop | None], Array]:
    """Return how far a driver can be moved while the others are held.

    Least and greatest value [rad or m], the stop at each, and (N, nq) configurations in between.
    """
    lower, upper = (_path(jog, name, end, rows) for end in jog.room(name))
    q = np.concatenate([lower[2][::-1], jog.state.q[None], upper[2]])
    return (lower[0], upper[0]), (lower[1], upper[1]), q


def _path(jog: Jog, name: str, end: float, rows: int) -> tuple[float, JogStop | None, Array]:
    """Return the value that a driver reaches towards `end`, its stop, and the samples."""
    start = float(jog.regular.q[jog.mechanism.driven_coordinate(name).q])
    values = np.linspace(start, end, rows)
    motion = followed(jog, name, values)
    if motion is None:
        return start, JogStop("lost", start), jog.state.q[None]
    limit = first_joint_limit(jog, name, values, motion)
    if limit is not None:
        there = np.abs(motion.swept - start) <= abs(limit.value - start)
        return limit.value, limit, motion.q[there]
    if len(motion) == rows:
        return end, None, motion.q
    event = motion.events[-1]
    return event.value, JogStop(event.kind, event.value), motion.q


# ---------------------------------------------------------------- dragging


@dataclass(frozen=True, eq=False, kw_only=True)
class Grip(Target):
    """A point of a body on a line of the world: where the eye sees the pointer."""

    joint: int  # number of the joint that the body hangs on
    point: Array  # in the joint's frame, shape (3,) [m]
    origin: Array  # of the line, shape (3,) [m]
    direction: Array  # unit vector along it, shape (3,)

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: how far the point is from the line, by the characteristic length."""
        at = evaluation.data.oMi[self.joint].act(self.point)
        moved = evaluation.body_jacobian(self.joint)
        slope = moved[:3] - pin.skew(at) @ moved[3:]
        across = np.eye(3) - np.outer(self.direction, self.direction)
        size = evaluation.mechanism.characteristic_length
        origin = self.origin - evaluation.mechanism.centre
        return across @ (at - origin) / size, across @ slope / size

    def check(self, mechanism: Mechanism) -> None:
        """See `Target`: it names no frame."""

    def distance(self, state: State) -> float:
        """Return how far the point is from the line [m]."""
        at = state.data.oMi[self.joint].act(self.point)
        return float(np.linalg.norm(np.cross(at - self.origin, self.direction)))


def pulled(jog: Jog, grip: Grip) -> dict[str, float]:
    """Return the driver values [rad or m] at which a point is nearest to the pointer.

    Drivers without a slider, and all else that is held, stay where they are. Nothing is returned
    where no pose is better.
    """
    nearest = grasped = _reached(jog, jog.state, {"grip": grip})
    is_stuck = grasped is not None and len(jog.names) == 1 and (  # its link is at a dead centre
        abs(jog.values(grasped)[jog.names[0]] - jog.value(jog.names[0])) < STILL) and (
        grip.distance(grasped) > OFF_POINTER * jog.mechanism.characteristic_length)
    for nudge in (NUDGE, -NUDGE) if is_stuck else ():
        name, = jog.names
        size = jog.mechanism.velocity_scale[jog.mechanism.driven_coordinate(name).v]
        nudged = _reached(jog, jog.state, {name: jog.value(name) + nudge * size})
        grasped = nudged and _reached(jog, nudged, {"grip": grip})
        if grasped and (nearest is None or grip.distance(grasped) < 0.9 * grip.distance(nearest)):
            nearest = grasped
    return {} if nearest is None else jog.values(nearest)


def _reached(jog: Jog, start: State, targets: Mapping[str, Any]) -> State | None:
    """Return the configuration near another that meets targets; None where there is none."""
    with contextlib.suppress(SpatialPinError):
        return reach(jog.mechanism, targets, start, hold=[BASE, *jog.others()],
                     limits=jog.keeps_limits, starts=0)
    return None
