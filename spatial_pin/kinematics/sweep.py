"""Following one branch of a closed mechanism through a list of driver values."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from tqdm import tqdm

from spatial_pin.errors import AssemblyError, LimitError, SingularError
from spatial_pin.kinematics import run
from spatial_pin.kinematics.arc import Arrival, march
from spatial_pin.kinematics.assembly import assemble
from spatial_pin.kinematics.constraints import Evaluation, constraints_of
from spatial_pin.kinematics.motion import Event, Motion
from spatial_pin.kinematics.newton import SINGULAR_PIVOT, SquareSystem
from spatial_pin.kinematics.rates import driven_coordinates
from spatial_pin.kinematics.spin import Spin
from spatial_pin.kinematics.state import State
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import finite_array
from spatial_pin.mechanism.mechanism import Coordinate, Mechanism
from spatial_pin.settings import Accuracy

MAX_CORRECTIONS = 6
LONGEST_STEP = 1.0  # rad, characteristic lengths: joints never move further in one step
EXPLAINED = 0.1  # part of a step that prediction, or the rates at its ends, may leave unexplained
CONTRACTION = 0.25  # a second correction may be this fraction of the first
TURNED = 0.5  # least cosine between the path directions at the two ends of a step
HALVINGS = 8  # halvings of a step before the path is followed by arc length
NEAR_SINGULAR = 1e-5  # smallest over largest pivot below which arc length has the better view
WORN = 0.2  # reselect redundant rows when the pivots have worn down to this fraction


class Branch:
    """A point that moves along one branch of closed configurations as one driver changes.

    Attributes:
        q: (nq,) configuration.
        s: driver value [rad or m].
        t: (nv,) dq/ds.
        c: (nv,) d²q/ds².
        angles: relative angle of every screw closure, counting turns.
    """

    def __init__(self, state: State, driven: Sequence[Coordinate], accuracy: Accuracy) -> None:
        self.mechanism = state.mechanism
        self.model = state.mechanism.model
        self.accuracy = accuracy
        self.evaluation = Evaluation(constraints_of(state.mechanism))
        self.evaluation.turns[:] = state.angles
        self.driven = driven
        self.held = [(c.q, float(state.q[c.q])) for c in driven[1:]]
        self.at = driven[0].q
        self.q = state.q.copy()
        self.s = float(state.q[self.at])
        self.system = SquareSystem(self.evaluation, driven, state.q)
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
        self.spins = [Spin(self.evaluation.placements[joint, :3], axis)
                      for joint, axis in self.evaluation.constraints.spins]
        self._set_rates()

    def _set_rates(self) -> None:
        self.t = self.scale * self.system.solve(self.unit)
        self.c = self.system.acceleration(self.q, self.t, self._drive)
        self.residual = self.evaluation.residual.copy()
        self.angles = self.evaluation.angles.copy()
        self.evaluation.turns[:] = self.angles

    def jump(self, before: Array, q: Array, s: float, h: float) -> None:
        """Go to a closed configuration of the same branch, `before` being a step h earlier."""
        self.q, self.s = q.copy(), s
        self._begin_spins(before, h)
        self.evaluation.update(self.q)
        self.system.factor()
        self._previous = None
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

    def hold(self, q: Array, value: float) -> None:
        """Write the prescribed values into a configuration."""
        q[self.at] = value
        for index, fixed in self.held:
            q[index] = fixed

    def predict(self, h: float) -> Array:
        """Return the Taylor step (nv,) for a change h of the driver."""
        order = self.accuracy.order
        step = h * self.t
        if order == 0:
            step[:] = 0.0
            step[self.driven[0].v] = h
        if order >= 2:
            step += (0.5 * h * h) * self.c
        if order == 3 and self._previous is not None:
            span, c = self._previous
            step += (h * h * h / (6.0 * span)) * (self.c - c)
        return step

    def step(self, target: float) -> bool:
        """Move to the driver value `target` in one step; False, and nothing changed, if unsafe."""
        h = target - self.s
        step = self.predict(h)
        scaled = step / self.scale
        size = math.sqrt(scaled.dot(scaled))
        if not size <= LONGEST_STEP:
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
        return True

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
        evaluation, system, tolerance = self.evaluation, self.system, self.accuracy.tolerance
        fixed = self.accuracy.corrections
        allowed = EXPLAINED * predicted
        last = np.inf
        for k in range((MAX_CORRECTIONS if fixed is None else fixed) + 1):
            self.hold(q, target)
            evaluation.update(q)
            residual = evaluation.residual
            error = float(residual.dot(residual))
            spun = [spin.error(h) for spin in self.spins]
            if k == fixed or (fixed is None and error <= tolerance * tolerance):
                return q
            if not system.factor():
                return None
            correction = system.correction(spun)
            size = math.sqrt(correction.dot(correction))
            if k == 0 and not size <= allowed + 1e-9 and self.accuracy.order:
                return None
            if k and not size <= CONTRACTION * last:
                # round-off, not divergence, ends the contraction of a closed loop
                return q if error <= 1e-22 else None
            last = max(size, 1e-13)
            q = pin.integrate(self.model, q, self.scale * correction)
        return None

    def reselect(self) -> None:
        """Choose the independent rows anew at the present point."""
        self.system.select(self.q)
        self.sign = self.system.pivots()[0]

    def reach(self, target: float) -> None:
        """Move to `target` by as many steps as the branch needs.

        Raises:
            _Stop: a limit or a singular configuration lies before it.
        """
        if target == self.s or self.step(target):
            return
        self.reselect()
        h = target - self.s
        size, smallest = 0.5 * h, abs(h) * 0.5**HALVINGS
        while self.s != target:
            goal = target if abs(target - self.s) <= abs(size) * (1 + 1e-12) else self.s + size
            if self.step(goal):
                size *= 2.0
            elif abs(size) > smallest:
                size *= 0.5
            else:
                self._march(target)
                return

    def _march(self, target: float) -> None:
        """Go on by arc length, which finds the limit or passes the hard stretch."""
        arrival = march(self.system, self.q, target, self.t, self.accuracy.tolerance)
        if arrival.kind != "reached":
            raise _Stop(arrival)
        self.q, self.s = arrival.q, target
        try:
            self.reselect()
        except SingularError:
            raise _Stop(Arrival("singular", arrival.q, target)) from None
        if self.system.pivots()[1] < SINGULAR_PIVOT:
            raise _Stop(Arrival("singular", arrival.q, target))
        self._previous = None
        for spin in self.spins:
            spin.forget()
        self._set_rates()


class _Stop(Exception):
    """The branch cannot be followed to the value asked for."""

    def __init__(self, arrival: Arrival) -> None:
        super().__init__(arrival.kind)
        self.arrival = arrival
        self.row = 0


@dataclass
class _Record:
    """Rows of a sweep, filled one by one."""

    q: Array
    t: Array
    c: Array
    residual: Array
    angles: Array

    @classmethod
    def empty(cls, n: int, branch: Branch) -> _Record:
        model = branch.model
        rows = branch.evaluation.constraints.n_rows
        return cls(np.empty((n, model.nq)), np.empty((n, model.nv)), np.empty((n, model.nv)),
                   np.empty((n, rows)), np.empty((n, len(branch.angles))))

    def put(self, k: int, branch: Branch) -> None:
        self.q[k] = branch.q
        self.t[k] = branch.t
        self.c[k] = branch.c
        self.residual[k] = branch.residual
        self.angles[k] = branch.angles

    def put_rows(self, k: int, rows: run.Rows) -> None:
        end = k + len(rows.t)
        self.t[k:end], self.c[k:end], self.residual[k:end] = rows.t, rows.c, rows.residual


def sweep(
    mechanism: Mechanism,
    driver: str,
    values: Any,
    speed: Any = 1.0,
    acceleration: Any = 0.0,
    *,
    guess: Mapping[str, Any] | State | Array | None = None,
    hold: Mapping[str, float] | None = None,
    on_limit: str = "raise",
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> Motion:
    """Follow one branch of a mechanism through a list of driver values.

    The first value is assembled, the rest are followed with a Taylor predictor and a Newton
    corrector; steps are halved where the branch bends, so that it is never left unnoticed.

    Args:
        mechanism: the mechanism.
        driver: a driver, or any coordinate of a joint.
        values: (N,) driver values in any order [rad or m].
        speed: the driver's speed at every row, one number or (N,) [rad/s or m/s].
        acceleration: likewise [rad/s² or m/s²].
        guess: where to assemble, as for `assemble`.
        hold: values of the other drivers; default those of the assembled configuration.
        on_limit: "raise", or "stop" to end the motion before a value that cannot be reached,
            with an event.
        accuracy: predictor order, corrections and tolerance; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Motion, one row per value.

    Raises:
        AssemblyError: the first value cannot be assembled.
        LimitError: a later value cannot be reached; has the limit and the motion so far.
        SingularError: the branch is not unique, or not determined, at a configuration.
        UnknownNameError, ValueError: names that do not exist, values that are not finite.
    """
    accuracy = accuracy or Accuracy.named("engineering")
    if on_limit not in ("raise", "stop"):
        raise ValueError(f"on_limit is {on_limit!r}; it is \"raise\" or \"stop\"")
    values = np.atleast_1d(np.asarray(values, dtype=np.float64))
    values = finite_array(values, (max(values.size, 1),), "values")
    speeds, accels = _rows(speed, values, "speed"), _rows(acceleration, values, "acceleration")
    coordinate = mechanism.driven_coordinate(driver)
    hold = dict(hold or {})
    state = assemble(mechanism, {**hold, coordinate.name: values[0]}, guess, accuracy=accuracy)
    driven = driven_coordinates(mechanism, [driver, *hold])
    driven.sort(key=lambda c: c.name != coordinate.name)
    branch = Branch(state, driven, accuracy)
    record = _Record.empty(len(values), branch)
    stop, n = None, len(values)
    bar = tqdm(total=n, desc=f"{mechanism.name}: {driver}", delay=1.0, leave=False,
               disable=None if progress else True)
    try:
        for done in _follow(branch, values, record):
            bar.update(done - bar.n)
    except _Stop as caught:
        stop, n = caught.arrival, caught.row
    finally:
        bar.close()
    motion = _motion(branch, driver, record, values[:n], speeds[:n], accels[:n])
    if stop is not None:
        motion.events.append(_event(stop, n, driver, coordinate))
        if on_limit == "raise" or stop.kind != "limit":
            raise _error(motion, stop, driver, coordinate, float(values[n]))
    return motion


def _rows(value: Any, values: Array, what: str) -> Array:
    """Return one number, or one for every row, as (N,)."""
    numbers = np.asarray(value, dtype=np.float64)
    return finite_array(np.full(values.shape, numbers) if numbers.ndim == 0 else numbers,
                        values.shape, what)


def _follow(branch: Branch, values: Array, record: _Record) -> Iterator[int]:
    """Fill the record row by row, or run by run; yields the number of rows done."""
    fast = run.is_possible(branch)
    k, careful_until = 0, 0
    while k < len(values):
        end = run.uniform_until(values, k) if fast and k >= careful_until else k
        if end > k:
            end = min(end, k + run.LONGEST)
            reached, rows = run.follow(branch, values, record.q, k, end)
            if rows is not None and reached > k:
                record.put_rows(k, rows)
                k = reached
                s = float(values[k - 1])
                branch.jump(record.q[k - 2], record.q[k - 1], s, s - float(values[k - 2]))
            if reached < end:
                careful_until = k + run.HISTORY
            yield k
            continue
        try:
            branch.reach(float(values[k]))
        except _Stop as caught:
            caught.row = k
            raise
        record.put(k, branch)
        k += 1
        yield k


def _motion(
    branch: Branch, driver: str, record: _Record, values: Array, speeds: Array, accels: Array
) -> Motion:
    n = len(values)
    t, c = record.t[:n], record.c[:n]
    residual = record.residual[:n]
    error = np.abs(residual).max(axis=1) if residual.shape[1] else np.zeros(n)
    return Motion(
        mechanism=branch.mechanism,
        driver=values.copy(),
        driver_name=driver,
        time=_time(values, speeds, accels),
        q=record.q[:n],
        v=t * speeds[:, None],
        a=c * (speeds * speeds)[:, None] + t * accels[:, None],
        closure_error=error,
        driver_speed=speeds.copy(),
        angles=record.angles[:n],
    )


def _time(values: Array, speeds: Array, accels: Array) -> Array | None:
    """(value - first)/speed where that rises from row to row at constant speed, else None."""
    if np.any(accels != 0.0) or np.any(speeds != speeds[0]) or speeds[0] == 0.0:
        return None
    time = (values - values[0]) / speeds[0]
    return time if np.all(np.diff(time) > 0.0) else None


def _event(stop: Arrival, row: int, driver: str, coordinate: Coordinate) -> Event:
    words = {"limit": "limit position (dead centre)", "singular": "singular configuration",
             "branch point": "branch point", "lost": "end of the followed path"}
    text = f"{words[stop.kind]} at {driver} = {stop.value:.12g} {coordinate.unit}"
    return Event(stop.kind, stop.value, row, text)


def _error(
    motion: Motion, stop: Arrival, driver: str, coordinate: Coordinate, value: float
) -> LimitError | SingularError | AssemblyError:
    name, unit = motion.mechanism.name, coordinate.unit
    where = f"mechanism {name!r}: {driver} = {value:.9g} {unit}"
    last = f"last closed at {motion.driver[-1]:.9g} {unit}"
    if stop.kind == "limit":
        return LimitError(
            f"{where} is out of reach: limit position at {stop.value:.12g} {unit} ({last})",
            limit=stop.value, motion=motion,
        )
    if stop.kind == "branch point":
        return SingularError(
            f"{where}: branches cross at {driver} = {stop.value:.12g} {unit} ({last}); which one "
            "to follow is not determined: start the sweep beyond it with a guess on the wanted "
            "branch", motion=motion,
        )
    if stop.kind == "singular":
        return SingularError(
            f"{where}: singular configuration at {driver} = {stop.value:.12g} {unit} ({last}); "
            "the rates are not determined there", motion=motion,
        )
    return SingularError(
        f"{where}: the branch was lost near {driver} = {stop.value:.9g} {unit} ({last}); "
        "ask for values nearer to each other", motion=motion,
    )
