"""The record of a simulation: samples, events, and numbers of steps."""

from __future__ import annotations

import numpy as np

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import (
    ByDriver,
    Energies,
    Projection,
    Simulation,
    energy_drift,
)
from spatial_pin.dynamics.simulation.running.events import Found, Watch
from spatial_pin.dynamics.simulation.running.step import IntegrationStep
from spatial_pin.kernel.dynamics import SimulationSamples
from spatial_pin.motion.joint_limit_events import Passing
from spatial_pin.motion.motion import Event
from spatial_pin.numerics.linalg import Array


class Record:
    """Samples of a simulation, filled one after the other, and what has happened.

    Args:
        problem: what is simulated.
        times: (N,) of the samples.
        watch: what is looked for.

    Attributes:
        filled: how many samples there are.
        room: where all samples stand.
        events: in the order of their times.
        steps: how many steps have been taken.
    """

    def __init__(self, problem: Problem, times: Array, watch: Watch) -> None:
        self._problem, self.times, self.filled = problem, np.ascontiguousarray(times), 0
        n, nq, nv = len(times) + 1, problem.model.nq, problem.model.nv  # one more where it stops
        n_angles = constraints_of(problem.mechanism).n_angles
        self._at = np.append(times, np.nan)
        self.room = SimulationSamples(*(np.empty((n, k)) for k in (
            nq, nv, nv, 4, len(problem.drives), n_angles)))
        self._passed: list[Passing] = list(watch.at_start)
        self.events = [passing.event for passing in watch.at_start]
        self.events += watch.rated.at_start if watch.rated else []
        self.steps = 0
        self._coordinates: list[str] = []

    def until(self, end: float) -> Array:
        """Return the times of samples that are not yet there, up to `end`."""
        return self.times[self.filled : np.searchsorted(self.times, end, "right")]

    def ask(self, system: Independent, times: Array, unknowns: Array) -> None:
        """Work out samples at times (N,) and unknowns (N, n)."""
        if not times.size:
            return
        self._at[self.filled : self.filled + len(times)] = times
        for into, part in zip(self.room, system.samples(times, unknowns), strict=True):
            into[self.filled : self.filled + len(times)] = part
        self.filled += len(times)

    def take(self, step: IntegrationStep, found: Found, before: Array) -> None:
        """Keep the samples and events of a step.

        Args:
            step: the step.
            found: what it has met.
            before: (n,) unknowns where it begins.

        Raises:
            Lost: the loops cannot be closed at a sample; nothing is kept.
        """
        system, after = step.system, step.end
        times = self.until(step.last if found.stop is None else found.stop)
        last = self._at[self.filled - 1] if self.filled else -np.inf
        if found.stop is not None and found.stop > max([last, *times]):
            times = np.union1d(times, [found.stop])
        unknowns = step.unknowns(times) if times.size else np.empty((0, len(after)))
        first = self.filled
        self.ask(system, times, unknowns)
        for value, at in system.crossings(before, after):
            earlier = (unknowns[:, 0] - at) * after[1] < 0.0
            self.note_crossing(value, first + int(np.count_nonzero(earlier)))
        self._note_limits(found, times, first)
        if found.stop is not None:
            self.events.append(Event(found.kind, found.stop, self.filled, found.text))

    def note_coordinates(self, free: list[int]) -> None:
        """Record the independent coordinates used from here on, given their velocity entries."""
        by_v = {c.v: c.name for c in self._problem.mechanism.coordinate_table.values()}
        self._coordinates += [by_v[v] for v in free]

    def note_crossing(self, value: float, sample: int) -> None:
        """Record a branch point, before a sample, at a value of the present coordinate."""
        text = (f"branch point at {self._coordinates[-1]} = {value:.9g}: branches cross; followed "
                "the one that goes straight on")
        self.events.append(Event("branch point", value, sample, text))

    def _note_limits(self, found: Found, times: Array, first: int) -> None:
        """Keep the limits passed in a step, which has samples at `times`, numbered from `first`."""
        for t, limit in found.passed:
            row = first + int(np.count_nonzero(times < t))
            self._passed.append(Passing(limit, t, row, f"at {t:.12g} s"))
            self.events.append(self._passed[-1].event)
        for t, rated in found.rated:
            row = first + int(np.count_nonzero(times < t))
            self.events.append(Event(rated.kind, t, row, f"{rated.words} passed at {t:.12g} s"))

    def all(self) -> tuple[Array, SimulationSamples]:
        """Return the times (N,) of samples that are there, and these."""
        return self._at[: self.filled], SimulationSamples(*(x[: self.filled] for x in self.room))

    def motion(
        self, start: Energies, evaluations: int, projection: Projection | None,
        integrators: list[str],
    ) -> Simulation:
        """Return the samples so far.

        Args:
            start: energies at the start.
            evaluations: how often the equations of motion were evaluated.
            projection: what projecting took.
            integrators: names of those that have taken the steps.
        """
        problem, names = self._problem, [c.name for c, _ in self._problem.drives]
        times, (q, v, a, numbers, efforts, angles) = self.all()
        error, kinetic, energy, work = numbers.T.copy()
        return Simulation(
            mechanism=problem.mechanism, driver=None, driver_name="", time=times, q=q, v=v, a=a,
            closure_error=error, driver_speed=np.empty(0), events=self.events,
            angles=angles, energy=energy, work=work,
            energy_drift=energy_drift(problem.least_exchange, kinetic, energy, work, start),
            efforts=ByDriver(problem.mechanism, dict(zip(names, efforts.T.copy(), strict=True))),
            coordinates=list(dict.fromkeys(self._coordinates)), evaluations=evaluations,
            steps=self.steps, by_drivers=problem.by_drivers, joint_limits=self._passed,
            projection=projection, integrators=integrators,
        )
