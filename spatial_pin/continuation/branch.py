"""A branch of closed configurations, followed step by step."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.holding import BASE, Hold, divided
from spatial_pin.assembly.newton import SINGULAR_PIVOT, SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.continuation.idle_rotation import Spin
from spatial_pin.continuation.pseudo_arclength import Arrival, towards
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.coordinates import coordinate_round_off, coordinate_value, with_values
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import prescribed_at
from spatial_pin.settings import Accuracy

MAX_CORRECTIONS = 6
TIGHT = 1e-12  # closure residual of loops with redundant rows
LONGEST_STEP = 1.0  # rad, characteristic lengths: joints never move further in one step
FARTHEST = 1e100  # rad or m: no Taylor series overflows
EXPLAINED = 0.1  # part of a step that prediction, or the rates at its ends, may leave unexplained
ROUND_OFF = 1e-14  # correction after which there is no closer
CLOSED = 1e-22  # square of the closure residual that round-off may leave
CONTRACTION = 0.25  # a second correction may be this fraction of the first
TURNED = 0.5  # least cosine between the path directions at the two ends of a step
STRETCH = 64.0  # rad, characteristic lengths, that joints move between new estimates of the way
SPUN = 0.02  # likewise in one step where bodies spin: it leaves up to about 1e-6 rad
MOST_STRETCHES = 1e4  # a value farther away is not followed to in one row
HALVINGS = 8  # halvings of a step before the path is followed by arc length
BENT_HALVINGS = 48  # the same where it cannot be: a component of a ball or floating joint drives
UNBOUND = 300.0  # speed of a joint by the driver's at which the driver has come to its limit
TELLING = 1e3  # lengths of the last step, in which its change of curvature is more than round-off
NEAR_SINGULAR = 1e-5  # smallest over largest pivot below which arc length has the better view
NEARER = 0.75  # part of the way to where the pivots would vanish that one step may go
ROOMY = math.inf, math.inf  # down and up to where the pivots would vanish, before that is known
LOOK = 1e-3  # part of the first step over which their fall is judged
WORN = 0.2  # reselect redundant rows when the pivots have worn down to this fraction


class Branch:
    """A point that moves along one branch of closed configurations as one driver changes.

    Attributes:
        q: (nq,) configuration.
        s: driver value [rad or m].
        t: (nv,) dq/ds.
        c: (nv,) d²q/ds².
        angles: relative angle of every screw closure, counting turns.
        rooms: how far the driver may go down and up before the last steps' pivots would vanish.
    """

    def __init__(
        self, state: State, driven: Sequence[Coordinate], accuracy: Accuracy,
        evaluation: Evaluation | None = None, still: Sequence[int] | None = None,
    ) -> None:
        self.mechanism = state.mechanism
        self.model = state.mechanism.model
        self.accuracy = accuracy
        self.evaluation = evaluation or Evaluation(constraints_of(state.mechanism))
        self.evaluation.turns[:] = state.angles
        self.driven = driven
        self.values = {c.name: coordinate_value(state.mechanism, c, state.q) for c in driven}
        self.held = [(c.q, self.values[c.name]) for c in driven[1:]]
        self.at = driven[0].q
        self.q = state.q.copy()
        self.s = self.values[driven[0].name]
        self.system = SquareSystem(self.evaluation, driven, state.q, still)
        self.system.check_regular(state.q)
        self.scale = self.system.scale
        self.sign, pivot = self.system.pivots()
        if pivot < SINGULAR_PIVOT:
            raise SingularError(
                f"mechanism {self.mechanism.name!r}: singular configuration at the start, {state}",
                state=state,
            )
        table = self.mechanism.coordinate_table.values()
        self.linear = np.array([(c.q, c.v) for c in table if c.q >= 0], dtype=int).reshape(-1, 2).T
        self.unit = np.zeros(len(self.system.matrix))
        self.unit[self.system.driver_rows.start] = 1.0 / self.scale[driven[0].v]
        self._drive = np.zeros(len(driven))
        self._previous: tuple[float, Array] | None = None
        self._pivot, self.rooms = pivot, ROOMY
        self.spins = [Spin(self.evaluation.placements[joint, :3], axis)
                      for joint, axis in self.evaluation.constraints.spins]
        self._set_rates()

    @classmethod
    def along(cls, state: State, driver: str, accuracy: Accuracy, hold: Hold = BASE) -> Branch:
        """Return the branch through a state along which one driver changes, the others held."""
        driven = prescribed_at(state, [driver], hold)
        return cls(state, driven, accuracy, still=divided(state.mechanism, driven, hold)[1])

    @property
    def tolerance(self) -> float:
        """Closure residual to reach: open loops hide which of their rows are redundant."""
        wanted = self.accuracy.tolerance
        return min(wanted, TIGHT) if self.system.has_redundant_rows else wanted

    def _set_rates(self) -> None:
        self.t: Array = self.scale * self.system.solve(self.unit)
        self.c: Array = self.system.acceleration(self.q, self.t, self._drive)
        self.residual = self.evaluation.residual.copy()
        self.angles: Array = self.evaluation.angles.copy()
        self.evaluation.turns[:] = self.angles

    def jump(self, before: Array, q: Array, s: float, h: float) -> None:
        """Go to a closed configuration of the same branch, `before` being a step h earlier."""
        self.q, self.s = q.copy(), s
        self._begin_spins(before, h)
        self.evaluation.update(self.q)
        self.system.factor()
        self._previous = None
        self._pivot, self.rooms = self.system.pivots()[1], ROOMY
        self._set_rates()

    def place(self, q: Array, anew: bool = True) -> None:
        """Stand at a closed configuration; spins are left alone.

        Args:
            q: the configuration.
            anew: choose the independent rows anew; else those in use are known to do.

        Raises:
            SingularError: the driver does not determine the motion there.
        """
        self.q, self.s = q, coordinate_value(self.mechanism, self.driven[0], q)
        self.evaluation.update(q)
        if anew or not self.system.factor():
            self.system.select(q)
        self.sign, self._pivot = self.system.pivots()
        self._previous, self.rooms = None, ROOMY
        self._set_rates()

    def _begin_spins(self, before: Array, h: float) -> None:
        if not self.spins:
            return
        evaluation = self.evaluation
        evaluation.update(before)
        rotations = [evaluation.placements[joint, :3].copy()
                     for joint, _ in evaluation.constraints.spins]
        evaluation.update(self.q)
        for spin, rotation in zip(self.spins, rotations, strict=True):
            spin.begin(rotation, h)

    def hold(self, q: Array, value: float | Array) -> None:
        """Write the prescribed values into a configuration (nq,), or some (nq, m)."""
        if self.system.is_bent:
            here = {**self.values, self.driven[0].name: float(value)}
            q[:] = with_values(self.mechanism, q, here)
            return
        q[self.at] = value
        for index, fixed in self.held:
            q[index] = fixed

    def limit_room(self, room: float, sense: float) -> None:
        """Take note that a singular configuration is due after so much more in a sense."""
        self.rooms = (math.inf, room) if sense > 0.0 else (room, math.inf)

    def room(self, sense: float) -> float:
        """Return how far ahead the pivots would vanish if they fell as in the last step, or inf."""
        return self.rooms[1] if sense > 0.0 else self.rooms[0]

    def predict(self, h: float) -> Array:
        """Return the Taylor step (nv,) for a change h of the driver."""
        order = self.accuracy.order
        step = h * self.t
        if order == 0 and not self.system.is_bent:
            step[:] = 0.0
            step[self.driven[0].v] = h
        if order >= 2:
            step += (0.5 * h * h) * self.c
        if order == 3 and self._previous is not None:
            span, c = self._previous
            if abs(h) < TELLING * abs(span):
                step += (h * h * h / (6.0 * span)) * (self.c - c)
        return step

    def step(self, target: float) -> bool:
        """Move to the driver value `target` in one step; False, and nothing changed, if unsafe."""
        h = target - self.s
        return not h or (abs(h) < FARTHEST and self._step(h, target))

    def _step(self, h: float, target: float) -> bool:
        step = self.predict(h)
        scaled = step / self.scale
        size = math.sqrt(scaled.dot(scaled))
        if not size <= LONGEST_STEP:
            return False
        if self.rooms is ROOMY:
            self._look(h)
        if abs(h) > NEARER * self.room(h):
            return False
        if self.spins and not self.spins[0].continues(h):
            back = (0.5 * h * h) * self.c - h * self.t
            self._begin_spins(pin.integrate(self.model, self.q, back), h)
        evaluation = self.evaluation
        if len(self.angles):
            evaluation.turns[:] = self.angles + evaluation.angle_jacobian @ scaled
        found = self._correct(pin.integrate(self.model, self.q, step), target, size, h)
        if found is None or not self._arrive(found, h):
            evaluation.turns[:] = self.angles
            if len(self.angles):
                evaluation.update(self.q)
            return False
        self.s = target
        for spin in self.spins:
            spin.accept(h)
        return True

    def _arrive(self, found: Array, h: float) -> bool:
        """Take `found` as the new point if it lies on the same stretch of the same branch."""
        before = self.q, self.t, self.c, self.residual, self.angles
        system = self.system
        system.refresh_passive()
        if not system.factor():
            return False
        pivot_before = self._pivot
        sign, pivot = system.pivots()
        if sign != self.sign or pivot < NEAR_SINGULAR:
            return False
        self.q = found
        worn = system.has_redundant_rows and pivot < WORN * system.selected_pivot
        if worn:
            self.reselect()
        self._set_rates()
        if not self._is_explained(before[0], before[1], before[2], h):
            self.q, self.t, self.c, self.residual, self.angles = before
            if worn:
                self.reselect()
            return False
        self._previous = (h, before[2])
        self._note_room(pivot_before, pivot, h)
        if not worn:  # else `reselect` has taken it
            self._pivot = pivot
        return True

    def _look(self, h: float) -> None:
        """Take note of the room for a step h where no step has told it yet."""
        part = LOOK * h
        self.evaluation.update(pin.integrate(self.model, self.q, self.predict(part)))
        pivot = self.system.pivots()[1] if self.system.factor() else 0.0
        self._note_room(self._pivot, pivot, part)
        if len(self.angles):  # the step's guess of them begins at the present ones
            self.evaluation.update(self.q)

    def _note_room(self, before: float, pivot: float, h: float) -> None:
        """Take note how far the pivots, as they change over h, still are from vanishing.

        Two branches that cross twice at one place, or two crossings in one step, leave the sign of
        the determinant as it was.
        """
        fall = before - pivot
        self.limit_room(pivot * abs(h / fall) if fall else math.inf, math.copysign(h, h * fall))

    def _is_explained(self, q: Array, t: Array, c: Array, h: float) -> bool:
        """Whether the rates at both ends, (t, c) and ours, account for the way from q to here.

        Hermite: q1 - q0 = h (t0 + t1)/2 + h² (c0 - c1)/12, in the joints where dq/ds = t.
        """
        t1 = self.t
        if t.dot(t1) < TURNED * math.sqrt(t.dot(t) * t1.dot(t1)):
            return False
        at, v = self.linear
        moved = (self.q - q)[at]
        missing = moved - ((0.5 * h) * (t + t1) + (h * h / 12.0) * (c - self.c))[v]
        return missing.dot(missing) <= EXPLAINED**2 * moved.dot(moved) + 1e-24

    def _correct(self, q: Array, target: float, predicted: float, h: float) -> Array | None:
        """Newton from a predicted configuration, drivers held; None when it goes astray."""
        evaluation, system, tolerance = self.evaluation, self.system, self.tolerance
        fixed = self.accuracy.corrections
        allowed = EXPLAINED * predicted
        last = size = np.inf
        for k in range((MAX_CORRECTIONS if fixed is None else fixed) + 1):
            self.hold(q, target)
            evaluation.update(q)
            residual = evaluation.residual
            error = float(residual.dot(residual))
            spun = [spin.error(h) for spin in self.spins]
            if k == fixed or (fixed is None and error <= tolerance * tolerance):
                return q
            if k and size <= ROUND_OFF and error <= self._closed(q):  # no closer than this
                return q
            if not system.factor():
                return None
            correction = system.correction(spun)
            size = math.sqrt(correction.dot(correction))
            if k == 0 and not size <= allowed + 1e-9 and self.accuracy.order:
                return None
            if k and not size <= CONTRACTION * last:
                # round-off, not divergence, ends the contraction of a closed loop
                return q if error <= self._closed(q) else None
            last = max(size, 1e-13)
            q = pin.integrate(self.model, q, self.scale * correction)
        return None

    def _closed(self, q: Array) -> float:
        """Return the square of the closure residual that round-off may leave."""
        return max(CLOSED, coordinate_round_off(self.mechanism, q) ** 2)

    def reselect(self) -> None:
        """Choose the independent rows anew at the present point."""
        self.system.select(self.q)
        self.sign, self._pivot = self.system.pivots()

    def reach(self, target: float, most: float = MOST_STRETCHES) -> None:
        """Move to `target` by as many steps as the branch needs, over at most so many stretches.

        Raises:
            Stopped: a limit or a singular configuration lies before it, or it is too far away.
        """
        while target != self.s:
            stretches = self.stretches(target - self.s)
            if not stretches <= most:
                raise Stopped(Arrival("lost", self.q, self.s, is_far=True))
            if self.spins and self.accuracy.corrections is None:
                stretches *= STRETCH / SPUN
            goal = target if stretches <= 1.0 else self.s + (target - self.s) / stretches
            if goal == self.s:  # a stretch is lost in the round-off of the driver's value
                raise Stopped(Arrival("lost", self.q, self.s, is_far=True))
            self._reach(goal)

    def stretches(self, h: float) -> float:
        """Return how many stretches a change h of the driver is at the present rates."""
        return abs(h) * float(np.linalg.norm(self.t / self.scale)) / STRETCH

    def _reach(self, target: float) -> None:
        """Move over one stretch, whose length the halvings of a step can deal with."""
        if self.step(target):
            return
        self.reselect()
        h = target - self.s
        halvings = BENT_HALVINGS if self.system.is_bent else HALVINGS
        size, smallest = 0.5 * h, abs(h) * 0.5**halvings
        while self.s != target:
            goal = target if abs(target - self.s) <= abs(size) * (1 + 1e-12) else self.s + size
            if goal != self.s and self.step(goal):
                size *= 2.0
            elif goal != self.s and abs(size) > smallest:
                size *= 0.5
            elif self.system.is_bent:
                raise Stopped(self._end())
            else:
                self._march(target)
                return

    def _end(self) -> Arrival:
        """Return where the branch ends, to the smallest step, if arc length is of no use.

        A driver has come to its limit where joints move without bound by it.
        """
        pace = float(np.abs(self.t / self.scale).max()) * self.scale[self.driven[0].v]
        return Arrival("limit" if pace > UNBOUND else "lost", self.q, self.s)

    def _march(self, target: float) -> None:
        """Go on by arc length, which finds the limit or passes the hard stretch."""
        arrival = towards(self.system, self.q, target, self.t, self.tolerance)
        if arrival.kind != "reached":
            raise Stopped(arrival)
        self.q, self.s = arrival.q, target
        try:
            self.reselect()
        except SingularError:
            raise Stopped(Arrival("singular", arrival.q, target)) from None
        if self.system.pivots()[1] < SINGULAR_PIVOT:
            raise Stopped(Arrival("singular", arrival.q, target))
        self._previous, self.rooms = None, ROOMY
        for spin in self.spins:
            spin.forget()
        self._set_rates()


class Stopped(Exception):
    """The branch cannot be followed to the value asked for.

    Attributes:
        arrival: where it ended.
        row: row of the sweep that was asked for.
    """

    def __init__(self, arrival: Arrival) -> None:
        super().__init__(arrival.kind)
        self.arrival = arrival
        self.row = 0
