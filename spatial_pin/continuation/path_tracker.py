"""The path tracker: a point on a branch that moves to given values of the driver.

`PathTracker.reach` tells the method. The kernel follows regular stretches with the driver as
parameter. Where it stops, pseudo-arclength continuation passes the singular region, or finds what
ends the branch: the driver turns back, branches cross, or a joint runs away while the driver comes
to an asymptote. `Stopped` is raised with that. `path_following` moves a tracker through many
values, and straight on through branch points.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import Workspaces, made_once
from spatial_pin.assembly.assembly_problem import AssemblyProblem
from spatial_pin.assembly.holding import Hold, divided, fixed_base_entries, hold_names
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.start_values import OPEN
from spatial_pin.assembly.state import State
from spatial_pin.continuation.asymptotes import running_away
from spatial_pin.continuation.pseudo_arclength import Stopped, followed_to
from spatial_pin.continuation.solution_curve import DriversLaw, OneDriver
from spatial_pin.errors import SingularError
from spatial_pin.kernel.closer import closer_of
from spatial_pin.kernel.kernel import Kernel, kernel_of
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.kernel.paths import Path, PathSamples, path_of, prescribed_indices
from spatial_pin.mechanism.coordinates import coordinate_value, driver_coordinates
from spatial_pin.mechanism.extent import unlike_links
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array, Decomposition, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.rates import check_not_held, prescribed_at, usual_prescription
from spatial_pin.settings import Accuracy

ROUND_OFF = 4.0 * float(np.finfo(float).eps)  # of a closure equation, and of its derivatives
THIRD_STEP = 1e-4  # of a difference of second derivatives [rad]
FARTHEST = 640e3  # rad, characteristic lengths: longest path to one value, 100,000 turns
# Rad, characteristic lengths: longest path by pseudo-arclength before the kernel continues, ten
# turns.
STRETCH = 64.0
# Speed of a joint, relative to the driver's, that shows a limit of the driver: see `FAST` of
# sweeps.
UNBOUND = 300.0


class PathPoint(NamedTuple):
    """A closed configuration of a branch.

    Attributes:
        s: driver value [rad or m].
        q: (nq,) configuration.
        t, c: (nv,) dq/ds and d²q/ds².
        error: largest closure residual.
        estimate: (3,) error estimates of q, t and c, by the sizes of coordinates.
        angles: (n_angles,) of screw closures, counting turns [rad].
    """

    s: float
    q: Array
    t: Array
    c: Array
    error: float
    estimate: Array
    angles: Array

    @classmethod
    def of(cls, samples: PathSamples, k: int, s: float) -> PathPoint:
        """Return sample k, at driver value s."""
        q, t, c, error, estimate, angles = (part[k].copy() for part in samples)
        return cls(s, q, t, c, float(error), estimate, angles)

    def state(self, mechanism: Mechanism) -> State:
        """Return the State there, without rates."""
        return State(mechanism, self.q, closure_error=self.error, angles=self.angles)


class Branch:
    """A branch of closed configurations: its prescribed coordinates and its equations.

    Its evaluation and its kernel are acquired at the first use.

    Attributes:
        driven: the prescribed coordinates, the driver first.
        still: indices in the velocity vector of coordinates at rest, by default those of free
            bases.

    `law` has the first prescribed coordinates as functions of a parameter, see `DriversLaw`, which
    is `begin` at the start; by default the driver itself is the parameter.
    """

    def __init__(
        self, mechanism: Mechanism, driven: Sequence[Coordinate], still: Sequence[int] | None,
        accuracy: Accuracy, workspaces: Workspaces, law: Any = None, begin: float = 0.0,
    ) -> None:
        self.mechanism, self.driven, self.accuracy = mechanism, driven, accuracy
        self.still = fixed_base_entries(mechanism, driven) if still is None else tuple(still)
        self._law, self._begin, self._workspaces = law, begin, workspaces
        self._samples: PathSamples | None = None  # those that the kernel began with

    @cached_property
    def state(self) -> State:
        """The state at the start of the branch."""
        assert self._samples is not None
        return PathPoint.of(self._samples, 0, 0.0).state(self.mechanism)

    @cached_property
    def kernel(self) -> Kernel:
        """The kernel of the mechanism."""
        return self._workspaces.acquire(kernel_of(self.mechanism))

    @cached_property
    def evaluation(self) -> LoopEquations:
        """Its closure equations."""
        return self._workspaces.acquire(loops_of(self.mechanism))

    @cached_property
    def leading(self) -> OneDriver:
        """The parameter of the branch: a driver, or that of a law."""
        mechanism, driven, q = self.mechanism, self.driven, self.state.q
        if self._law is None:
            return OneDriver(mechanism, driven, q)
        return DriversLaw(mechanism, driven, q, self._law, self._begin)

    @cached_property
    def moving_drivers(self) -> set[str]:
        """The drivers that are not prescribed and must move."""
        return _moving_drivers(self.mechanism, self.driven, self.still)

    @property
    def has_arc_length(self) -> bool:
        """Whether the branch can be followed by pseudo-arclength.

        Components of balls and floating joints are no entries of q, so none can be the parameter.
        """
        return all(c.q >= 0 for c in self.driven)

    def room_for(self, n: int) -> PathSamples:
        """Return room for n samples."""
        k = self.kernel
        return PathSamples.empty(n, k.nq, k.nv, k.n_angles)

    def system_at(self, q: Array, angles: Array) -> SquareSystem:
        """Return the square system at a configuration.

        Raises:
            SingularError: the driver does not determine the motion there.
        """
        self.evaluation.angle_reference[:] = angles
        return SquareSystem(self.evaluation, self.driven, q, self.still)

    def checked_system(self, state: State) -> SquareSystem:
        """Return the square system at a state.

        Raises:
            SingularError: the driver does not determine the motion there, or loops lose rank.
        """
        system = self.system_at(state.q, state.angles)
        system.check_regular(state.q)
        if system.pivot < TOLERANCES.singular:
            unlike = unlike_links(self.mechanism.model, self.mechanism.extent)
            raise SingularError(f"mechanism {self.mechanism.name!r}: singular configuration at "
                                f"the start, {state}{unlike}", state=state)
        return system

    def point_at(self, q: Array, s: float, angles: Array, system: SquareSystem) -> PathPoint:
        """Return the point at a closed configuration.

        The system's equations are chosen again only if they are dependent there.

        Raises:
            SingularError: the prescribed coordinates do not determine the motion there.
        """
        self.evaluation.angle_reference[:] = angles
        self.evaluation.update(q)
        system.factor()
        if not system.pivot:
            system.select(q)
        return self.solved(system, q, s)

    def solved(self, system: SquareSystem, q: Array, s: float) -> PathPoint:
        """Return the point at a configuration, by a system that is factored there."""
        t = system.driver_rates() @ self.leading.rates(s)
        c = system.acceleration(q, t, self.leading.bends(s))
        evaluation = system.evaluation
        error = float(np.abs(evaluation.residual).max(initial=0.0))
        estimate = error_estimate(evaluation, decompose(system.matrix), system.equations,
                                  t / system.scale, c / system.scale)
        return PathPoint(s, q, t, c, error, estimate, evaluation.angles.copy())

    def pace(self, point: PathPoint) -> float:
        """Return the speed of the joints at a point, per unit of the parameter."""
        return float(np.linalg.norm(point.t / self.mechanism.velocity_scale))

    def distance(self, point: PathPoint, value: float) -> float:
        """Return how far joints move from a point to a parameter value, at the rates there."""
        return abs(value - point.s) * self.pace(point)

    def _path_from(
        self, q: Array, angles: Array, s: float, may_be_passive: bool = True
    ) -> Path | None:
        """Return the path that the kernel follows from q; None where it cannot.

        `may_be_passive`: whether passive freedoms may remain, which then move least.
        """
        k, driven = self.kernel, prescribed_indices(self.kernel.nv, self.driven, self.still)
        polynomials = None if self._law is None else self.leading.polynomials(s, self.still)
        if 0 <= k.nv - k.n_passive - len(driven) <= k.n_closure:
            path = Path(k, None, driven, None, self.accuracy, polynomials)
            if path.start(q, angles):
                return path
        if not may_be_passive:
            return None
        try:
            system = self.system_at(q, angles)
            system.check_regular(q)
        except SingularError:
            return None
        path = Path(k, system.equations, driven, system.passive, self.accuracy, polynomials)
        return path if path.start(q, angles) else None


class PathTracker(Branch):
    """A point on a branch, which moves to given values of the parameter; see `Branch`."""

    _path: Path | None = None  # of the kernel, where it is at the point or ahead of it
    _here: PathPoint | None = None  # the point, unless the path is there

    @classmethod
    def along(
        cls, state: State, names: Sequence[str], hold: Hold, accuracy: Accuracy,
        workspaces: Workspaces, law: Any = None, begin: float = 0.0,
    ) -> PathTracker:
        """Return a tracker at a state, with the first name as the driver and the others held.

        `law` has the names as functions of a parameter that is `begin` at the start; by default the
        first name is the parameter.

        Raises:
            SingularError: the prescribed coordinates do not determine the motion there.
        """
        mechanism = state.mechanism
        driven, still = usual_prescription(mechanism, tuple(names), hold_names(hold))
        tracker = cls(mechanism, driven, still, accuracy, workspaces, law, begin)
        tracker.state = state
        tracker._path = tracker._path_from(state.q, state.angles, begin, may_be_passive=False)
        if tracker._path is None:
            driven, kernel = prescribed_at(state, names, hold), tracker.kernel
            still = divided(mechanism, driven, hold)[1]
            tracker = cls(mechanism, driven, still, accuracy, workspaces, law, begin)
            tracker.kernel = kernel
            tracker.start(state)
        return tracker

    @classmethod
    def from_guess(
        cls, problem: AssemblyProblem, names: tuple[str, ...], hold: tuple[str, ...],
        accuracy: Accuracy, workspaces: Workspaces, values: Array, n: int,
    ) -> tuple[PathTracker, PathSamples, int] | None:
        """Close the loops and follow the branch from there, in one call of the kernel.

        The values (m,) are the first of n of the driver.

        Returns:
            The tracker, room for all samples, and how many of them are done: the tracker is behind
            them. None where closing leaves something to judge, or where loops are not regular.

        Raises:
            ValueError: the driver is held.
        """
        mechanism = problem.mechanism
        driven, still, indices, moving = _prescribed(mechanism, names, hold)
        tracker = cls(mechanism, driven, still, accuracy, workspaces)
        tracker.moving_drivers = moving
        closer = workspaces.acquire(closer_of(mechanism))
        k = tracker.kernel = closer.kernel
        tracker._path = path = path_of(closer, indices, accuracy)
        if path is not None:
            samples = tracker._samples = PathSamples.empty(n, k.nq, k.nv, k.n_angles)
            first = samples if n == len(values) else samples.between(0, len(values))
            widest = max(problem.gap, OPEN)
            problem.set_task(closer)
            done = path.from_guess(closer, widest, values, first)
            if done == -1:
                freed = problem.without_standing(moving) if moving and all(
                    result.error > widest for result in closer.results()) else None
                if freed is not None and freed.is_for_kernel():  # they cannot stand
                    freed.set_task(closer)
                    done = path.from_guess(closer, widest, values, first)
            if done > 0:
                return tracker, samples, done
        workspaces.release_last()
        return None

    def start(self, state: State | None = None) -> None:
        """Start at a closed state, by default that of the branch, without earlier samples.

        Raises:
            SingularError: the prescribed coordinates do not determine the motion there.
        """
        if state is not None:
            self.state = state
        state, self._here = self.state, None
        self._path = self._path_from(state.q, state.angles, self._begin)
        if self._path is None:
            self._here = self.solved(self.checked_system(state), state.q, self.leading.begin)

    def by(self, law: Any) -> PathTracker:
        """Return a tracker at the same point, with another law of the same coordinates."""
        other = copy(self)
        other._law, other._begin = law, self.here.s
        other.__dict__.pop("leading", None)
        other.move_to(self.here)
        return other

    # ------------------------------------------------------------ the current point

    @property
    def here(self) -> PathPoint:
        """The current point."""
        if self._here is None:
            assert self._path is not None
            s, sample = self._path.here
            self._here = PathPoint.of(sample, 0, s)
        return self._here

    def move_to(self, point: PathPoint) -> None:
        """Move to a known point of the branch."""
        self._here, self._path = point, None

    def system(self) -> SquareSystem:
        """Return the square system at the current point; raises as `system_at`."""
        return self.system_at(self.here.q, self.here.angles)

    # ------------------------------------------------------------ moving it

    def _moving_path(self) -> Path | None:
        """Return the kernel's path from the current point; None where it cannot start here."""
        if self._path is None:
            here = self.here
            self._path = self._path_from(here.q, here.angles, here.s)
        if self._path is not None:
            self._here = None
        return self._path

    def follow(self, values: Array, samples: PathSamples) -> int:
        """Write samples at driver values (m,) as far as the kernel goes; return how many."""
        path = self._moving_path()
        return path.follow(values, samples) if path is not None else 0

    def reach(self, value: float) -> None:
        """Move the tracker to a driver value.

        Raises:
            Stopped: a limit or a singular configuration lies before it, or it is too far away; the
                tracker is then at the last point before that.
        """
        while value != self.here.s:
            begin = self.here
            stretches = self.distance(begin, value) / STRETCH
            goal = value if stretches <= 1.0 else begin.s + (value - begin.s) / stretches
            # a stretch may be lost in the round-off of the driver's value
            if not stretches * STRETCH <= FARTHEST or goal == begin.s:
                raise _asymptote(self, value) or Stopped("lost", begin.q, begin.s, is_far=True)
            path = self._moving_path()
            if path is not None and path.go(goal):
                continue
            if not self.has_arc_length:
                raise _end_without_arc_length(self)
            self.move_to(_followed_by_arc_length(self, begin, goal, value))


# ---------------------------------------------------------------- where the kernel stops


def _end_without_arc_length(tracker: PathTracker) -> Stopped:
    """Return the end of a branch that is not followed by pseudo-arclength.

    A driver is at its limit if joint rates per unit of its rate grow without bound.
    """
    here, mechanism, driven = tracker.here, tracker.mechanism, tracker.driven
    scale = mechanism.velocity_scale
    for joint in {c.joint for c in driven if c.q < 0 and c.unit == "rad"}:
        vector = [coordinate_value(mechanism, c, here.q)
                  for c in mechanism.coordinate_table.values()
                  if c.joint == joint and c.unit == "rad"]
        if np.linalg.norm(vector) > np.pi - TOLERANCES.half_precision:
            return Stopped("half turn", here.q, here.s)
    driver_speed = np.abs(tracker.leading.rates(here.s) / scale[[c.v for c in driven]]).max()
    is_fast = np.abs(here.t / scale).max() > UNBOUND * driver_speed
    return Stopped("limit" if is_fast else "lost", here.q, here.s)


def _followed_by_arc_length(
    tracker: PathTracker, clear: PathPoint, value: float, goal: float
) -> PathPoint:
    """Return the point at a value on the way to a goal, which pseudo-arclength leads to.

    It begins at the point `clear`, if near: that is farther from the singularity ahead.

    Raises:
        Stopped: a limit lies before it, branches cross, or a joint runs away.
        SingularError: the driver does not determine the motion.
    """
    if tracker.distance(clear, tracker.here.s) < TOLERANCES.longest_step:
        tracker.move_to(clear)
    try:
        system = tracker.system()
    except SingularError:
        tracker.move_to(clear)
        try:
            system = tracker.system()
        except SingularError:
            if end := _asymptote(tracker, goal):
                raise end from None
            raise
    if end := _asymptote(tracker, goal, system):
        raise end
    # few steps: open loops would hide where the branch turns, and redundant equations
    wanted, here = min(tracker.accuracy.tolerance, TOLERANCES.tight), tracker.here
    curve = tracker.leading.curve(system, max(wanted, 1e-14), tracker.pace(here))
    try:
        q = followed_to(curve, curve.unknowns(here.q, here.s), value, here.t)
    except Stopped as stopped:
        if stopped.kind == "lost" and (end := _asymptote(tracker, goal, system, stopped)):
            raise end from None
        raise
    singular = Stopped("singular", q, value)
    try:
        system.select(q)
    except SingularError:
        raise singular from None
    if system.pivot < TOLERANCES.singular:
        raise _asymptote(tracker, goal, system, singular) or singular
    return tracker.solved(system, q, value)


def _asymptote(
    tracker: PathTracker, goal: float, system: SquareSystem | None = None,
    end: Stopped | None = None,
) -> Stopped | None:
    """Return the asymptote that ends a branch before a goal, or None.

    `end` is where following the branch ended, default the tracker's point; the evaluation expects
    angles as they are there. The square system is by default that of the start, if none can be
    chosen at the point.
    """
    here = tracker.here
    if not tracker.has_arc_length:
        return None
    if system is None:
        try:
            system = tracker.system()
        except SingularError:
            system = tracker.system_at(tracker.state.q, tracker.state.angles)
        tracker.evaluation.angle_reference[:] = here.angles
    q, s = (here.q, here.s) if end is None else (end.q, end.value)
    sizes = tracker.mechanism.velocity_scale[[c.v for c in tracker.driven]]
    # joints have any pace there; the drivers' is a measure
    pace = float(np.linalg.norm(tracker.leading.rates(s) / sizes))
    curve = tracker.leading.curve(system, TOLERANCES.round_off, pace)
    return running_away(curve, curve.unknowns(q, s), goal)


def error_estimate(
    evaluation: LoopEquations, rows: Decomposition, chosen: NDArray[np.intp], t: Array, c: Array
) -> Array:
    """Return error estimates (3,) of q, t and c where the equations are evaluated.

    q is off along u, where the equations are weakest; t then by what solves J dt = -f''(u, t), and
    c by J dc = -(f'''(u, t, t) + 2 f''(t, dt) + f''(u, c)), as in the kernel. `rows` are those of
    J: the chosen closure equations, those of passive freedoms, and others that hold exactly. t and
    c (nv,) are the derivatives there, by the sizes of coordinates.
    """
    if not rows.s[-1] > 0.0:
        return np.full(3, np.inf)
    q, scale = evaluation.q, evaluation.mechanism.velocity_scale
    n = evaluation.constraints.n_closure

    def bias(at: Array, v: Array) -> Array:
        every = evaluation.bias(at, scale * v)
        right = np.concatenate([every[:n][chosen], every[n:]])
        return rows.vt[: len(rows.s)].T @ (rows.u[: len(right)].T @ right / rows.s)

    def second(a: Array, b: Array) -> Array:
        return 0.25 * (bias(q, a + b) - bias(q, a - b))

    u, gain = rows.vt[len(rows.s) - 1], 1.0 / float(rows.s[-1])
    dt = -second(u, t)
    moved = pin.integrate(evaluation.model, q, THIRD_STEP * scale * u)
    dc = (bias(moved, t) - bias(q, t)) / THIRD_STEP + 2.0 * second(t, dt) + second(u, c)
    pace, bend = float(np.linalg.norm(t)), float(np.linalg.norm(c))
    off, solved = gain * (evaluation.closure_error + ROUND_OFF), gain * ROUND_OFF
    return np.array([off, float(np.linalg.norm(dt)) * off + pace * solved,
                     float(np.linalg.norm(dc)) * off + (pace * pace + bend) * solved])


@made_once
def _prescribed(
    mechanism: Mechanism, names: tuple[str, ...], hold: tuple[str, ...]
) -> tuple[list[Coordinate], tuple[int, ...], tuple[int, ...], set[str]]:
    """Return prescribed and resting coordinates, their indices for C, and drivers that move."""
    check_not_held(mechanism, [mechanism.prescribed_coordinate(names[0])], hold)
    driven, still = usual_prescription(mechanism, names, hold)
    indices = tuple(prescribed_indices(mechanism.model.nv, driven, still))
    return driven, still, indices, _moving_drivers(mechanism, driven, still)


def _moving_drivers(
    mechanism: Mechanism, driven: Sequence[Coordinate], still: Sequence[int]
) -> set[str]:
    return {name for name, c in driver_coordinates(mechanism).items()
            if c not in driven and c.v not in still}
