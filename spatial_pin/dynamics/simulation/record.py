"""The record of a simulation: samples, events, numbers of steps, and its energy balance."""

from __future__ import annotations

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dynamics.lift_off import contacts_of, lift_offs
from spatial_pin.dynamics.simulation.events import EventDetector, IntegrationStep
from spatial_pin.dynamics.simulation.formulations import IndependentFormulation
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import (
    ByDriver,
    Energies,
    Projection,
    Simulation,
    energy_drift,
)
from spatial_pin.dynamics.solvers.equations_of_motion import equations_of
from spatial_pin.errors import EnergyError
from spatial_pin.kernel.integrating import SimulationSamples
from spatial_pin.motion.limit_events import Passing, curve_end_events
from spatial_pin.motion.motion import Event
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy

# Part of the exchanged energy: larger than any error of steps at usual tolerances.
LOST_SHARE = 1e-2
WORST = 0.5  # the same for fixed steps and loose tolerances
MOST_ERRORS = 1e6  # errors of steps, all of one sign, that add up to it


class Record:
    """Samples and events of a simulation up to the present time.

    Args:
        problem: the simulated mechanism, with its laws and efforts.
        times: (N,) of the samples.
        detector: detects the events.

    Attributes:
        problem: as given; another one where equations of a rounded file are chosen anew.
        filled: how many samples there are.
        room: storage of all samples.
        events: in the order of their times.
        steps: how many steps have been taken.
        start: energies at the start.
        balance: of the energies since then.
    """

    start = Energies(0.0, 0.0, 0.0)
    _time_tolerance = 0.0

    def __init__(self, problem: Problem, times: Array, detector: EventDetector) -> None:
        self.problem, self._detector, self.filled = problem, detector, 0
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
        self._coordinates: list[str] = []

    def set_start(self, start: Energies, accuracy: Accuracy) -> None:
        """Set the energies at the start."""
        self.start, self.balance = start, EnergyBalance(self.problem, accuracy, start)
        self._time_tolerance = (
            0.0 if INTEGRATORS[accuracy.integrator].is_fixed else accuracy.time_tolerance)

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
        """Add the samples and events of a step; return whether the simulation ends in it.

        Args:
            step: the step.
            longest: step so far [s].
            before: (n,) unknowns where it begins.

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
            last = self._at[self.filled - 1] if self.filled else -np.inf
            if stop.value > max([last, *times]):
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

    def note_coordinates(self, free: list[int]) -> None:
        """Record the names of new independent coordinates, from their velocity entries."""
        names = self.problem.mechanism.coordinates
        self._coordinates += [names[v] for v in free]

    def note_crossing(self, value: float, sample: int) -> None:
        """Record a branch point, before a sample, at a value of the present coordinate."""
        text = (f"branch point at {self._coordinates[-1]} = {value:.9g}: branches cross; followed "
                "the one that goes straight on")
        self.events.append(Event("branch point", value, sample, text))

    def recorded(self) -> tuple[Array, SimulationSamples]:
        """Return the times (N,) of the samples so far, and the samples."""
        return self._at[: self.filled], SimulationSamples(*(x[: self.filled] for x in self.room))

    def motion(
        self, evaluations: int, projection: Projection | None, integrators: list[str]
    ) -> Simulation:
        """Return the samples so far.

        Args:
            evaluations: how often the equations of motion were evaluated.
            projection: what projecting took.
            integrators: names of those that have taken the steps.
        """
        problem, names = self.problem, [c.name for c, _ in self.problem.drives]
        times, (q, v, a, numbers, efforts, angles) = self.recorded()
        error, kinetic, energy, work = numbers.T.copy()
        lifted = lift_offs(problem.mechanism, _multipliers(problem, *self.recorded()), times,
                           "at {:.9g} s") if contacts_of(problem.mechanism) else []
        simulation = Simulation(
            mechanism=problem.mechanism, driver=None, driver_name="", time=times, q=q, v=v, a=a,
            closure_error=error, driver_speed=np.empty(0), events=[*self.events, *lifted],
            angles=angles, energy=energy, work=work,
            energy_drift=energy_drift(problem.least_exchange, kinetic, energy, work, self.start),
            efforts=ByDriver(problem.mechanism, dict(zip(names, efforts.T.copy(), strict=True))),
            coordinates=list(dict.fromkeys(self._coordinates)), evaluations=evaluations,
            steps=self.steps, by_drivers=problem.by_drivers, joint_limits=self._passed,
            projection=projection, integrators=integrators, time_tolerance=self._time_tolerance,
        )
        simulation.events = sorted([*simulation.events, *curve_end_events(simulation)],
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


class EnergyBalance:
    """The energy balance along a motion, and its largest allowed error.

    Args:
        problem: what acts.
        accuracy: of the steps.
        start: energies at the start.
    """

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
    """Return the multipliers (N, n_closure) of the samples of a simulation.

    Args:
        problem: the simulated mechanism and its loads.
        times: (N,) [s].
        samples: at these.
    """
    mechanism, rows = problem.mechanism, []
    driven = [c.v for c, _ in problem.drives]
    with equations_of(mechanism.whole or mechanism) as equations:
        for t, q, v, a, efforts, angles in zip(times.tolist(), samples.q, samples.v, samples.a,
                                               samples.efforts, samples.angles, strict=True):
            equations.update(State(mechanism, q, v, a, angles=angles))
            given = problem.joint_forces(t, q, v, equations.evaluation)
            closures = equations.motion_forces(a) - given
            closures[driven] -= efforts
            rows.append(equations.multipliers(closures))
    return np.array(rows).reshape(len(times), -1)
