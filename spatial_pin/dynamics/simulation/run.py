"""A simulation under way: one state machine, with these transitions.

    stepping -> stepping    an integrator leads on in the equations of motion in use: many steps in
                            the kernel, or one that is looked at here
             -> repeating   the step leads nowhere, or loops cannot be closed within it: the same
                            again, at most half as long
             -> choosing    the coordinates end, or the integrator has failed: the equations of
                            motion in others, or in the same ones counted from there
             -> ended       at the last sample, or at an event: a joint limit, a zero of
                            `stop_when`, a dead centre of links without inertia, a gap of a rounded
                            file beyond the one allowed

The independent equations of a rounded file are checked after each step, and chosen anew where they
come near to depending on each other: the loops are closed by the new ones, and the equations of
motion begin there.

An error ends it from any state: SingularError where no equations of motion are left to choose,
StepLimitError, EnergyError. `why_it_ends` says of the first one cause, with the number that shows
it and a remedy.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from typing import Any

import numpy as np

from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.redundant_equations import allowed_from, gap_allowed, independence_at
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dynamics.lift_off import contacts_of, lift_offs
from spatial_pin.dynamics.simulation.events import (
    SINGULAR,
    EventDetector,
    IntegrationStep,
    why_it_ends,
)
from spatial_pin.dynamics.simulation.formulations import (
    FORMULATIONS,
    GivenUp,
    IndependentFormulation,
    OpenLoopsError,
    ProjectedFormulation,
)
from spatial_pin.dynamics.simulation.integrators import Stagnation, Stepping
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import (
    ByDriver,
    Energies,
    Projection,
    Simulation,
    energy_drift,
)
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.errors import EnergyError, SingularError, SpatialPinError
from spatial_pin.kernel.integrating import (
    AT_END,
    AT_FAILURE,
    MANY,
    NEW_COORDINATES,
    NO_SAMPLES,
    RungeKutta,
    RunStruct,
    SampleStruct,
    SimulationSamples,
)
from spatial_pin.kernel.library import address
from spatial_pin.motion.limit_events import Passing, curve_end_events
from spatial_pin.motion.motion import Event
from spatial_pin.motion.rounding import independent_from
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy

# Part of the exchanged energy: larger than any error of steps at usual tolerances.
LOST_SHARE = 1e-2
WORST = 0.5  # the same for fixed steps and loose tolerances
MOST_ERRORS = 1e6  # errors of steps, all of one sign, that add up to it
ROUTINE = (AT_END, MANY, NEW_COORDINATES, AT_FAILURE)  # pauses at which all samples are made
LITTLE = 1e-3  # part of the largest residual of a step below which the next step may be longer
ROUNDING_OF_ENERGY = 1e-2  # part of the kinetic energy that rounded numbers change, at most
SHORTEST = 1e-13  # shortest step relative to the time: it is not halved any more
# Independence of a rounded file's equations, relative to that of all of them, below which others
# are tried; and again where it has fallen by half. Rates lose less than a digit until then.
NEARLY_DEPENDENT = 0.2


class Record:
    """Samples and events of a simulation up to the present time.

    Attributes:
        filled: how many samples there are.
        room: storage of all samples.
        events: in the order of their times.
        steps: how many steps have been taken.
        coordinates: names of the independent ones so far.
        start: energies at the start.
        balance: of the energies since then.
    """

    start = Energies(0.0, 0.0, 0.0)
    _time_tolerance = 0.0

    def __init__(self, problem: Problem, times: Array, detector: EventDetector) -> None:
        self._detector, self.filled = detector, 0
        self.times = np.ascontiguousarray(times)
        n, nq, nv = len(times) + 1, problem.model.nq, problem.model.nv  # one more where it stops
        n_angles = constraints_of(problem.mechanism).n_angles
        self._at = np.append(times, np.nan)
        self.room = SimulationSamples(*(np.empty((n, k)) for k in (
            nq, nv, nv, 4, len(problem.drives), n_angles)))
        self._passed: list[Passing] = list(detector.at_start)
        self.events = [passing.event for passing in detector.at_start]
        self.events += detector.rated.at_start if detector.rated else []
        self.steps = 0
        self.coordinates: list[str] = []

    def set_start(self, problem: Problem, accuracy: Accuracy, start: Energies) -> None:
        """Set the energies at the start."""
        self.start, self.balance = start, EnergyBalance(problem, accuracy, start)
        self._time_tolerance = (
            0.0 if INTEGRATORS[accuracy.integrator].is_fixed else accuracy.time_tolerance)

    @property
    def last(self) -> float:
        """The time of the last sample; before all times where there is none."""
        return float(self._at[self.filled - 1]) if self.filled else -math.inf

    def times_until(self, end: float) -> Array:
        """Return the times of missing samples up to `end`."""
        return self.times[self.filled : np.searchsorted(self.times, end, "right")]

    def add_samples(self, system: IndependentFormulation, times: Array, unknowns: Array) -> None:
        """Add the samples at times (N,) and unknowns (N, n)."""
        if not times.size:
            return
        self._at[self.filled : self.filled + len(times)] = times
        for into, part in zip(self.room, system.samples(times, unknowns), strict=True):
            into[self.filled : self.filled + len(times)] = part
        self.filled += len(times)

    def add_step(self, step: IntegrationStep, longest: float, before: Array) -> bool:
        """Add the samples and events of a step from unknowns `before` (n,).

        Returns whether the simulation ends in it. The step is compared with the `longest` so far.

        Raises:
            OpenLoopsError: the loops cannot be closed at a sample; nothing is added.
        """
        self.steps += 1
        system, after, length = step.system, step.end, step.last - step.first
        times = self.times_until(step.last)
        passed, rated, stop = self._detector.events_in_step(
            step, times, length / max(longest, length))
        if stop is not None:
            times = self.times_until(stop.value)
            if stop.value > max([self.last, *times]):
                times = np.union1d(times, [stop.value])
        unknowns = step.unknowns(times) if times.size else np.empty((0, len(after)))
        first = self.filled
        self.add_samples(system, times, unknowns)
        for value, at in system.crossings(before, after):
            earlier = (unknowns[:, 0] - at) * after[1] < 0.0
            self.note_crossing(value, first + int(np.count_nonzero(earlier)))
        for t, limit in passed:
            row = first + int(np.count_nonzero(times < t))
            self._passed.append(Passing(limit, t, row, f"at {t:.12g} s"))
            self.events.append(self._passed[-1].event)
        for t, over in rated:
            row = first + int(np.count_nonzero(times < t))
            self.events.append(Event(over.kind, t, row, f"{over.words} passed at {t:.12g} s"))
        if stop is not None:
            self.events.append(stop._replace(row=self.filled))
        return stop is not None

    def note_crossing(self, value: float, sample: int) -> None:
        """Record a branch point, before a sample, at a value of the present coordinate."""
        text = (f"branch point at {self.coordinates[-1]} = {value:.9g}: branches cross; followed "
                "the one that goes straight on")
        self.events.append(Event("branch point", value, sample, text))

    def recorded(self) -> tuple[Array, SimulationSamples]:
        """Return the times (N,) of the samples so far, and the samples."""
        return self._at[: self.filled], SimulationSamples(*(x[: self.filled] for x in self.room))

    def motion(
        self, problem: Problem, evaluations: int, projection: Projection | None,
        integrators: list[str],
    ) -> Simulation:
        """Return the samples so far, as a motion by the equations that were chosen last."""
        names = [c.name for c, _ in problem.drives]
        times, (q, v, a, numbers, efforts, angles) = self.recorded()
        error, kinetic, energy, work = numbers.T.copy()
        simulation = Simulation(
            mechanism=problem.mechanism, driver=None, driver_name="", time=times, q=q, v=v, a=a,
            closure_error=error, driver_speed=np.empty(0), events=list(self.events),
            angles=angles, energy=energy, work=work,
            energy_drift=energy_drift(problem.least_exchange, kinetic, energy, work, self.start),
            efforts=ByDriver(problem.mechanism, dict(zip(names, efforts.T.copy(), strict=True))),
            coordinates=list(dict.fromkeys(self.coordinates)), evaluations=evaluations,
            steps=self.steps, by_drivers=problem.by_drivers, joint_limits=self._passed,
            projection=projection, integrators=integrators, time_tolerance=self._time_tolerance,
        )
        lifted = lift_offs(simulation, _multipliers(problem, *self.recorded())) if contacts_of(
            problem.mechanism) else []
        simulation.events = sorted([*self.events, *lifted, *curve_end_events(simulation)],
                                   key=lambda x: x.row)
        return simulation

    def refuse_samples(self) -> None:
        """Refuse samples whose energy balance is wrong; they are dropped.

        Raises:
            EnergyError: there are some.
        """
        times, samples = self.recorded()
        for k, (t, row) in enumerate(zip(times.tolist(), samples.numbers.tolist(), strict=True)):
            try:
                self.balance.check(t, Energies(*row[1:]))
            except EnergyError:
                self.filled = k
                raise

    def end_without_inertia(self) -> bool:
        """End a motion that stops because inertia vanishes; return whether that is the cause.

        The samples before it remain, if their energy is right: a fixed step may jump over the
        singular configuration.
        """
        inertia = self._detector.inertia
        if not self.filled:
            return False
        with suppress(EnergyError):
            self.refuse_samples()
        times, samples = self.recorded()
        if not inertia.vanishes_after_samples(times, samples.q, samples.v):
            return False
        words = inertia.words(times[-1], samples.q[-1], samples.v[-1])
        self.events.append(Event(SINGULAR, float(times[-1]), len(times), words))
        return True


class EnergyBalance:
    """The energy balance along a motion, and its largest allowed error."""

    def __init__(self, problem: Problem, accuracy: Accuracy, start: Energies) -> None:
        self._start, self._least, self._most, self._size = start, np.inf, -np.inf, 0.0
        fixed = INTEGRATORS[accuracy.integrator].is_fixed
        creeps = fixed and problem.forces.resistance  # which is warned of: losses are not known
        self._is_checked = problem.is_steady and not creeps
        self._part = WORST if fixed else min(
            WORST, max(LOST_SHARE, MOST_ERRORS * accuracy.time_tolerance))
        self._remedy = ("take a smaller time_tolerance or step, or formulation='independent'"
                        if accuracy.formulation == "projected"
                        else "take a smaller time_tolerance or step")
        jumping = [repr(x.name) for x in problem.forces.bushings if x.jumps]
        if jumping:
            self._remedy += (f"; or {', '.join(jumping)} was wound beyond half a turn, where its "
                             "energy jumps: a spring about a joint counts turns")
        self._name, self._least_exchange = problem.mechanism.name, problem.least_exchange
        self._holds(start)

    def check(self, t: float, now: Energies) -> None:
        """Refuse a step, or a sample, at which the energy balance does not hold.

        Raises:
            EnergyError: energy was lost or gained.
        """
        if self._holds(now):
            return
        raise EnergyError(
            f"mechanism {self._name!r}: at {t:.9g} s there are "
            f"{now.total - now.work:.6g} J, the work done taken off, where "
            f"{self._start.total:.6g} J were at the start: energy came from nowhere or was lost; "
            f"{self._remedy}")

    def _holds(self, now: Energies) -> bool:
        rest = now.total - now.kinetic
        self._least, self._most = min(self._least, rest), max(self._most, rest)
        self._size = max(self._size, now.kinetic, self._most - self._least, abs(now.work))
        allowed = self._part * max(
            self._size, self._least_exchange(now.total, self._start.total))
        gap = abs(now.total - now.work - self._start.total + self._start.work)
        return not self._is_checked or gap <= allowed


def _multipliers(problem: Problem, times: Array, samples: SimulationSamples) -> Array:
    """Return the multipliers (N, n_closure) of the samples of a simulation."""
    mechanism, rows = problem.mechanism, []
    driven = [c.v for c, _ in problem.drives]
    with acquired(mechanism.whole or mechanism, Equations) as equations:
        for t, q, v, a, efforts, angles in zip(times.tolist(), samples.q, samples.v, samples.a,
                                               samples.efforts, samples.angles, strict=True):
            equations.update(State(mechanism, q, v, a, angles=angles))
            given = problem.joint_forces(t, q, v, equations.evaluation)
            closures = equations.motion_forces(a) - given
            closures[driven] -= efforts
            rows.append(equations.multipliers(closures))
    return np.array(rows).reshape(len(times), -1)


class NextAction(Enum):
    """The next action of a simulation."""

    STEP = "the next one"
    REPEAT = "the same one, shorter"
    CHOOSE = "steps in other coordinates, or in the same ones counted from there"
    GIVE_UP = "the same, without the method that failed there"
    END = "nothing"


class Run:
    """A simulation under way.

    Attributes:
        t: time reached [s].
        y: unknowns there.
        record: the samples so far.
    """

    def __init__(
        self, problem: Problem, accuracy: Accuracy, state: State, times: Array,
        detector: EventDetector,
    ) -> None:
        self._accuracy, self._detector = accuracy, detector
        self.t, self._end = 0.0, float(times[-1])
        self.y: Array = np.empty(0)
        self.record = record = Record(problem, times, detector)
        self._stepping = Stepping(problem, accuracy, self._end)
        self._stagnation = Stagnation(accuracy.most_steps)
        self._in_use = EquationsInUse(problem, accuracy, state, record, self._stagnation)
        self._solver: Any = None
        self._is_short = False
        self._kernel_run = RunStruct(
            address(record.times), len(record.times), 0, SampleStruct(*map(address, record.room)),
            allowed=float(accuracy.most_steps), looks=detector.always,
            n_limits=len(detector.bounds["limit_q"]), between=problem.between,
            **dict(zip(detector.bounds, map(address, detector.bounds.values()), strict=True)))

    def follow(self) -> Iterator[float]:
        """Take steps until the end; yields the time after each accepted step."""
        self._begin()
        action = self._check_equations(NextAction.STEP)
        while self.t < self._end and action is not NextAction.END:
            if action in (NextAction.CHOOSE, NextAction.GIVE_UP):
                self.y = self._in_use.change(self.t, self.y, action is NextAction.GIVE_UP)
                self._solver = self._stepping.begin(self._in_use.system, self.t, self.y)
            action = self._step()
            if action not in (NextAction.REPEAT, NextAction.GIVE_UP):
                action = self._check_equations(action)
                yield self.t

    def _begin(self) -> None:
        """Choose the first equations of motion, and record the start."""
        record, equations = self.record, self._in_use
        system = equations.begin(0.0, equations.first)
        self.y = system.unknowns(equations.first.v, 0.0)
        record.set_start(equations.problem, self._accuracy, system.energies(0.0, self.y))
        start = record.times_until(0.0)
        record.add_samples(system, start, self.y[None][: len(start)])
        if not len(self.y):  # no freedom and no work: the drivers' laws alone determine the motion
            rest = record.times_until(self._end)
            record.add_samples(system, rest, np.empty((len(rest), 0)))
            self.t = self._end
        elif self.t < self._end:
            self._solver = self._stepping.begin(system, self.t, self.y)

    def _check_equations(self, action: NextAction) -> NextAction:
        """Go on with other equations of a rounded file where those in use come to their end.

        Returns:
            The action given; END where the other equations open beyond the gap, with a last sample.
        """
        if action is NextAction.END or self._solver is None:
            return action
        before = self._in_use.system
        self.y, is_within_gap = self._in_use.checked(self.t, self.y)
        system = self._in_use.system
        if system is not before:
            self._solver = self._stepping.begin(system, self.t, self.y)
            action = NextAction.STEP
        if is_within_gap:
            return action
        if self.record.last < self.t:
            self.record.add_samples(system, np.array([self.t]), self.y[None])
        return NextAction.END

    def _step(self) -> NextAction:
        """Take one step, or many in the kernel; return the next action."""
        solver, why = self._solver, self._kernel_steps()
        if why is None:
            solver.step()
        if (solver.status == "failed" or why == AT_FAILURE
                or not solver.t > solver.t_old):  # LSODA goes on for ever
            return NextAction.GIVE_UP
        if why in ROUTINE:
            self._stepping.check_step_limit(self.t, self.record.steps, solver)
            return NextAction.CHOOSE if why == NEW_COORDINATES else NextAction.STEP
        before = self.y if why is None else solver.y_old
        if why == NO_SAMPLES or (stops := self._accept(before)) is None:
            self._repeat(before)
            return NextAction.REPEAT
        if stops:
            return NextAction.END
        self._stepping.check_step_limit(self.t, self.record.steps, solver)
        system = self._in_use.system
        if solver.status == "running":
            if system.needs_new_coordinates(self.t, solver.y):
                return NextAction.CHOOSE
            self._solver = self._stepping.next_integrator(system, self.t, self.y, solver)
        return NextAction.STEP

    def _kernel_steps(self) -> int | None:
        """Take many steps in the kernel; return why it paused, None if it takes none.

        Unless the reason is in ROUTINE, events and samples of the last step are still to be
        evaluated.
        """
        system, solver, record, run = (
            self._in_use.system, self._solver, self.record, self._kernel_run)
        if not isinstance(solver, RungeKutta) or system.projects:
            return None
        before, run.row, run.n_crossed, run.patience = (
            solver.steps, record.filled, 0, system.patience)
        run.most = (1 if self._in_use.problem.mechanism.whole is not None
                    else self._stepping.steps_at_once(record.steps))
        run.largest_pivot, run.largest_step = self._stagnation.largest
        try:
            why = solver.run(run)
        finally:
            record.filled = run.row
        for x, row in zip(run.crossed[: run.n_crossed], run.crossed_row, strict=False):
            record.note_crossing(system.coordinate_at(x), row)
        taken = solver.steps - before
        self._stagnation.note_kernel_steps(taken, np.array([run.largest_pivot, run.largest_step]))
        record.steps += taken if why in ROUTINE else max(taken - 1, 0)
        if why in ROUTINE:
            self._stepping.note_integrator(system, solver)
            self.t, self.y = solver.t, solver.y
        return why

    def _accept(self, before: Array) -> bool | None:
        """Record the last step, from unknowns (n,), with its samples and events.

        Returns:
            Whether it is the last one. None if it is rejected: the loops cannot be closed at its
            end or within it.

        Raises:
            SingularError: steps only creep on.
        """
        system, solver = self._in_use.system, self._solver
        if isinstance(system, ProjectedFormulation):
            opened = system.settle(solver)
            if opened > 1.0:
                self._is_short = True
                return None
            if self._is_short and opened < LITTLE:
                solver.max_step = min(2.0 * solver.max_step, self._accuracy.step or np.inf)
            self.record.balance.check(solver.t, system.energies(solver.t, solver.y))
        if self._stagnation.creeps(system.kernel.pivot, solver.t - solver.t_old):
            raise self._in_use.singular(self.t, system.state(solver.t, solver.y))
        self._stepping.note_integrator(system, solver)
        try:
            stops = self.record.add_step(
                IntegrationStep(system, solver), float(self._stagnation.largest[1]), before)
        except OpenLoopsError:
            return None
        self.t, self.y = solver.t, solver.y
        return stops

    def _repeat(self, before: Array) -> None:
        """Let an integrator repeat the last step, from unknowns (n,), at most half as long.

        Raises:
            SingularError: even the shortest steps open the loops.
            SpatialPinError: the step is fixed.
        """
        system = self._in_use.system
        self.t, self.y = float(self._solver.t_old), before
        self._detector.reset()
        step = self._solver.t - self.t
        if INTEGRATORS[self._accuracy.integrator].is_fixed:
            raise SpatialPinError(
                f"mechanism {self._in_use.problem.mechanism.name!r}: a step of {step:.3g} s at "
                f"{self.t:.9g} s opens the loops too far to be closed surely: take shorter ones")
        if step < SHORTEST * (self.t + step):
            raise self._in_use.singular(self.t, system.state(self.t, self.y))
        self._solver = self._stepping.begin(
            system, self.t, self.y, 0.5 * step, not system.projects)

    def why(self) -> str:
        """Return why the motion cannot be followed beyond the present time."""
        return self._in_use.why(self.t, self.y)

    @property
    def longest_step(self) -> float:
        """The longest step so far [s]; 0 where there was none."""
        return float(self._stagnation.largest[1])

    def motion(self) -> Simulation:
        """Return the samples so far."""
        equations = self._in_use
        return self.record.motion(equations.problem, *equations.cost(), self._stepping.used)


class EquationsInUse:
    """The equations of motion in use: a formulation, and its independent coordinates.

    Attributes:
        problem: as given; another one where equations of a rounded file are chosen anew.
        first: the state at the start.
    """

    def __init__(
        self, problem: Problem, accuracy: Accuracy, first: State, record: Record,
        stagnation: Stagnation,
    ) -> None:
        self.problem, self._accuracy, self.first = problem, accuracy, first
        self._record, self._stagnation = record, stagnation
        self._system: IndependentFormulation | None = None
        self._projections: list[Projection] = []  # of the equations of motion used before
        self._evaluations = 0  # of these
        self._started_at, self._failed_at = 0.0, -1.0
        self._given_up: set[tuple[type, tuple[int, ...]]] = set()  # at the time of the failure
        self._clock = time.perf_counter()
        self._gap = allowed_from(first, gap_allowed(problem.mechanism, accuracy))
        # Independence at which no others did better; twice the limit while there is none.
        self._tried_at = 2.0 * NEARLY_DEPENDENT

    @property
    def system(self) -> IndependentFormulation:
        """The formulation; there is one when the motion has begun."""
        assert self._system is not None
        return self._system

    def begin(
        self, t: float, state: State, given_up: GivenUp = frozenset()
    ) -> IndependentFormulation:
        """Return equations of motion that begin at a state.

        Raises:
            SingularError: there are none.
        """
        formulate = FORMULATIONS[self._accuracy.formulation]
        system = formulate(self.problem, state, given_up)
        if self._system is not None:
            self._evaluations += self._system.kernel.evaluations
        if isinstance(self._system, ProjectedFormulation):
            self._projections.append(self._system.projection)
        self._system = system
        if (type(system), tuple(system.free)) in given_up:
            raise self.singular(t, state)
        self._note_start(system, t)
        return system

    def checked(self, t: float, y: Array) -> tuple[Array, bool]:
        """Choose equations of a rounded file anew where they hardly are independent.

        Returns:
            The unknowns, and whether the file's other equations open no further than the gap.
        """
        if self.problem.mechanism.whole is None:
            return y, True
        state = self.system.state(t, y)
        independence, error = independence_at(state.mechanism, state.q, state.angles)
        if independence < min(NEARLY_DEPENDENT, 0.5 * self._tried_at):
            state, self._tried_at = independent_from(state, self._gap), independence
            if state.mechanism is not self.problem.mechanism:
                y, self._tried_at = self._gone_on(t, y, state), 2.0 * NEARLY_DEPENDENT
                _, error = independence_at(state.mechanism, state.q, state.angles)
        return y, error <= self._gap

    def _gone_on(self, t: float, y: Array, state: State) -> Array:
        """Go on with the equations of a state's mechanism; return the unknowns.

        Its loops differ from those before by the gap, velocities by more. The energy stays: it
        determines how fast the motion goes on.
        """
        before = self.system.energies(t, y)
        self.problem = self.problem.of(state.mechanism)
        system = self.begin(t, state)
        unknowns = system.unknowns(state.v, before.work)
        after, n = system.energies(t, unknowns), len(system.free)
        kinetic = before.total - (after.total - after.kinetic)
        if after.kinetic > 0.0 and abs(kinetic / after.kinetic - 1.0) < ROUNDING_OF_ENERGY:
            unknowns[n : 2 * n] *= math.sqrt(kinetic / after.kinetic)
        return unknowns

    def change(self, t: float, y: Array, failed: bool) -> Array:
        """Choose other independent coordinates, or restart; return the unknowns.

        Raises:
            SingularError: none can be followed.
        """
        system = self.system
        state = system.state(t, y)
        renewed = None if failed else system.renewed(t, y, state)
        if renewed is not None:
            self._note_start(system, t)
            return renewed
        if failed:  # a method that failed at the present time is given up
            if not self._stagnation.is_short(t - self._failed_at):
                self._failed_at = t
                self._given_up.clear()
            if system.is_unchanged_by_restart or self._stagnation.is_short(t - self._started_at):
                self._given_up.add((type(system), tuple(system.free)))
        try:
            fresh = self.begin(t, state, self._given_up if failed else frozenset())
        except SingularError as error:
            if self._stagnation.is_short(t):  # the error of a start
                raise
            raise self.singular(t, state) from error
        return fresh.unknowns(state.v, float(y[-1]) if self.problem.works else 0.0)

    def _note_start(self, system: IndependentFormulation, t: float) -> None:
        names = self.problem.mechanism.coordinates
        self._record.coordinates += [names[v] for v in system.free]
        self._started_at = t

    def singular(self, t: float, state: State) -> SingularError:
        """Return the error of a motion that cannot be followed beyond a time [s]."""
        cause = why_it_ends(self.problem, self._accuracy, self.first, t, state)
        return SingularError(
            f"mechanism {self.problem.mechanism.name!r}: the motion cannot be followed beyond "
            f"{t:.9g} s: {cause}; it is at {state}", state=state)

    def why(self, t: float, y: Array) -> str:
        """Return why the motion cannot be followed beyond unknowns y at a time [s]."""
        try:
            state = self._system.state(t, y) if self._system else self.first
        except OpenLoopsError:
            return "the loops cannot be closed there as on the way to it"
        return why_it_ends(self.problem, self._accuracy, self.first, t, state)

    def cost(self) -> tuple[int, Projection | None]:
        """Return how often equations of motion were evaluated, and the cost of projections."""
        evaluations = self._evaluations + (self._system.kernel.evaluations if self._system else 0)
        if not isinstance(self._system, ProjectedFormulation):
            return evaluations, None
        parts = [*self._projections, self._system.projection]
        seconds = sum(part.seconds for part in parts)
        return evaluations, Projection(
            sum(part.steps for part in parts), sum(part.corrections for part in parts),
            max(part.opened for part in parts), seconds,
            seconds / (time.perf_counter() - self._clock))
