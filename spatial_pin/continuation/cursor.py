"""A point on a branch of closed configurations that moves to given values of the driver.

The kernel follows regular stretches with the driver as parameter. Where it stops, pseudo-arclength
continuation takes over, which passes the hard stretch or finds what ends the branch.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.continuation.asymptotes import running_away
from spatial_pin.continuation.driving import DriversLaw
from spatial_pin.continuation.pseudo_arclength import Arrival, towards
from spatial_pin.continuation.solution_curve import SolutionCurve, WithParameter
from spatial_pin.continuation.start import Start
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import Path, PathSamples
from spatial_pin.mechanism.coordinates import coordinate_value
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

FARTHEST = 640e3  # rad, characteristic lengths, that joints move on the way to one value
STRETCH = 64.0  # the same by pseudo-arclength, before the kernel is asked again
UNBOUND = 300.0  # speed of a joint relative to the driver's at which that has come to its limit


class Stopped(Exception):
    """The branch cannot be followed to the value asked for.

    Attributes:
        arrival: where it ended.
        sample: number of the one that could not be reached.
    """

    def __init__(self, arrival: Arrival) -> None:
        super().__init__(arrival.kind)
        self.arrival = arrival
        self.sample = 0


class PathPoint(NamedTuple):
    """A closed configuration of a branch.

    Attributes:
        s: driver value [rad or m].
        q: (nq,) configuration.
        t, c: (nv,) dq/ds and d²q/ds².
        error: largest closure residual.
        angles: (n_angles,) of screw closures, counting turns [rad].
    """

    s: float
    q: Array
    t: Array
    c: Array
    error: float
    angles: Array

    @classmethod
    def of(cls, samples: PathSamples, k: int, s: float) -> PathPoint:
        """Return sample k, at driver value s."""
        q, t, c, error, angles = (part[k].copy() for part in samples)
        return cls(s, q, t, c, float(error), angles)

    def state(self, start: Start) -> State:
        """Return the State there, without rates."""
        return State(start.mechanism, self.q, closure_error=self.error, angles=self.angles)


class Cursor:
    """A point on a branch of closed configurations.

    Attributes:
        start: where it begins.
        has_arc_length: whether the branch can be followed by pseudo-arclength.

    Raises:
        SingularError: what is driven does not determine the motion at the start.
    """

    def __init__(self, start: Start) -> None:
        self.start = start
        # components of balls and floating joints are no entries of q that a curve could lead by
        self.has_arc_length = all(c.q >= 0 for c in start.driven)
        self._path = start.first_path()
        state = start.state
        self._here = None if self._path is not None else self._solved(
            start.checked_system(state), state.q, start.leading.begin)

    @property
    def here(self) -> PathPoint:
        """The current place."""
        if self._here is None:
            assert self._path is not None
            s, sample = self._path.here
            self._here = PathPoint.of(sample, 0, s)
        return self._here

    def stand(self, place: PathPoint) -> None:
        """Move to a known place of the branch."""
        self._here, self._path = place, None

    def by(self, start: Start) -> Cursor:
        """Return a cursor where this one stands that goes on as another start does."""
        other = copy(self)
        other.start = start
        other.stand(self.here)
        return other

    def system(self) -> SquareSystem:
        """Return the square system at the current place.

        Raises:
            SingularError: the driver does not determine the motion there.
        """
        return self.start.system(self.here.q, self.here.angles)

    def curve(
        self, system: SquareSystem, tolerance: float, pace: float | None = None
    ) -> SolutionCurve:
        """Return the curve through the current place, what leads set free.

        Args:
            system: the square system there.
            tolerance: closure residual to reach.
            pace: how much of a law's parameter counts as one radian, its inverse; default: how
                fast joints move here.
        """
        leading = self.start.leading
        if not isinstance(leading, DriversLaw):
            return SolutionCurve(system, tolerance)
        span = float(leading.law.x[-1] - leading.law.x[0])
        pace = max(self.pace(self.here) if pace is None else pace, 1.0 / span)
        return SolutionCurve(system, tolerance, WithParameter(system, leading, 1.0 / pace))

    def place(self, q: Array, s: float, angles: Array, system: SquareSystem) -> PathPoint:
        """Return the place at a closed configuration.

        Args:
            q: (nq,) the configuration.
            s: the leading value.
            angles: (n_angles,) of screw closures.
            system: its equations are chosen again only if they are dependent there.

        Raises:
            SingularError: what is driven does not determine the motion there.
        """
        self.start.evaluation.angle_reference[:] = angles
        self.start.evaluation.update(q)
        system.factor()
        if not system.pivot:
            system.select(q)
        return self._solved(system, q, s)

    def _solved(self, system: SquareSystem, q: Array, s: float) -> PathPoint:
        leading = self.start.leading
        t = system.driver_rates() @ leading.rates(s)
        c = system.acceleration(q, t, leading.bends(s))
        evaluation = system.evaluation
        error = float(np.abs(evaluation.residual).max(initial=0.0))
        return PathPoint(s, q, t, c, error, evaluation.angles.copy())

    def _moving_path(self) -> Path | None:
        """Return the kernel's path from the current place; None where it cannot start here."""
        if self._path is None:
            self._path = self.start.path(self.here.q, self.here.angles, self.here.s)
        if self._path is not None:
            self._here = None
        return self._path

    def follow(self, values: Array, samples: PathSamples) -> int:
        """Write samples at driver values (m,) as far as the kernel goes; return how many."""
        path = self._moving_path()
        return path.follow(values, samples) if path is not None else 0

    def reach(self, value: float) -> None:
        """Go to a driver value.

        Raises:
            Stopped: a limit or a singular configuration lies before it, or it is too far away; the
                point then stands before that.
        """
        while value != self.here.s:
            begin = self.here
            stretches = self.way(begin, value) / STRETCH
            goal = value if stretches <= 1.0 else begin.s + (value - begin.s) / stretches
            # a stretch may be lost in the round-off of the driver's value
            if not stretches * STRETCH <= FARTHEST or goal == begin.s:
                raise Stopped(self._running_away(value) or Arrival(
                    "lost", begin.q, begin.s, is_far=True))
            path = self._moving_path()
            if path is not None and path.go(goal):
                continue
            if not self.has_arc_length:
                raise Stopped(self._end())
            self._go_by_arc_length(goal, begin, value)

    def _end(self) -> Arrival:
        """Return where the branch ends if pseudo-arclength cannot be used, to the smallest step.

        What is driven is at its limit if joint rates per unit of its own grow without bound.
        """
        here, start, scale = self.here, self.start, self.start.mechanism.velocity_scale
        asked = np.abs(start.leading.rates(here.s) / scale[[c.v for c in start.driven]]).max()
        mechanism = start.mechanism
        for joint in {c.joint for c in start.driven if c.q < 0 and c.unit == "rad"}:
            vector = [coordinate_value(mechanism, c, here.q)
                      for c in mechanism.coordinate_table.values()
                      if c.joint == joint and c.unit == "rad"]
            if np.linalg.norm(vector) > np.pi - TOLERANCES.half_precision:
                return Arrival("half turn", here.q, here.s)
        is_fast = np.abs(here.t / scale).max() > UNBOUND * asked
        return Arrival("limit" if is_fast else "lost", here.q, here.s)

    def pace(self, place: PathPoint) -> float:
        """Return how fast joints move at a place, by the leading value."""
        return float(np.linalg.norm(place.t / self.start.mechanism.velocity_scale))

    def way(self, place: PathPoint, value: float) -> float:
        """Return how far joints move from a place to a leading value at the rates there."""
        return abs(value - place.s) * self.pace(place)

    def _running_away(
        self, goal: float, system: SquareSystem | None = None, arrival: Arrival | None = None
    ) -> Arrival | None:
        """Return the end of the branch before a goal at which a joint runs away, or None.

        Args:
            goal: the leading value that is to be reached.
            system: the square system; default: that of the start, if none can be chosen here.
            arrival: where following the branch ended; default: here. The evaluation expects angles
                as they are there.
        """
        start, here = self.start, self.here
        if not self.has_arc_length:
            return None
        if system is None:
            try:
                system = self.system()
            except SingularError:
                system = start.system(start.state.q, start.state.angles)
            start.evaluation.angle_reference[:] = here.angles
        q, s = (here.q, here.s) if arrival is None else (arrival.q, arrival.value)
        sizes = start.mechanism.velocity_scale[[c.v for c in start.driven]]
        # joints have any pace there; that of what is driven is a measure
        pace = float(np.linalg.norm(start.leading.rates(s) / sizes))
        curve = self.curve(system, TOLERANCES.round_off, pace)
        return running_away(curve, curve.unknowns.of(q, s), goal)

    def _go_by_arc_length(self, value: float, clear: PathPoint, goal: float) -> None:
        """Continue by pseudo-arclength, which finds the limit or passes the hard stretch.

        It starts at the place `clear`, if near: that is farther from the singularity ahead. The
        value is one on the way to the goal.
        """
        if self.way(clear, self.here.s) < TOLERANCES.longest_step:
            self.stand(clear)
        try:
            system = self.system()
        except SingularError:
            self.stand(clear)
            try:
                system = self.system()
            except SingularError:
                if end := self._running_away(goal):
                    raise Stopped(end) from None
                raise
        if end := self._running_away(goal, system):
            raise Stopped(end)
        here = self.here
        # few steps: open loops would hide where the branch turns, and what is redundant
        wanted = min(self.start.accuracy.tolerance, TOLERANCES.tight)
        curve = self.curve(system, max(wanted, 1e-14))
        arrival = towards(curve, curve.unknowns.of(here.q, here.s), value, here.t)
        if arrival.kind == "lost":
            raise Stopped(self._running_away(goal, system, arrival) or arrival)
        if arrival.kind != "reached":
            raise Stopped(arrival)
        singular = Arrival("singular", arrival.q, value)
        try:
            system.select(arrival.q)
        except SingularError:
            raise Stopped(singular) from None
        if system.pivot < TOLERANCES.singular:
            raise Stopped(self._running_away(goal, system, singular) or singular)
        self.stand(self._solved(system, arrival.q, value))


@contextmanager
def cursor_along(
    state: State, driver: str, accuracy: Accuracy, hold: Hold = BASE
) -> Iterator[Cursor]:
    """Acquire a cursor at a state, along the branch of one driver, the others held.

    Raises:
        SingularError: the driver does not determine the motion there.
    """
    mechanism = state.mechanism
    with loops_of(mechanism, state.angles) as evaluation, kernel_of(mechanism) as kernel:
        yield Cursor(Start.along(state, [driver], hold, accuracy, kernel, evaluation))
