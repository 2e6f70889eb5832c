"""A simulation under way: step after step, in independent coordinates and then in others."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.coordinate_partitioning import Lost
from spatial_pin.dynamics.simulation.equations_in_use import EquationsInUse
from spatial_pin.dynamics.simulation.events import IntegrationStep, Watch
from spatial_pin.dynamics.simulation.formulations import Formulate, Independent, Projected
from spatial_pin.dynamics.simulation.integrators import Stepping
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.record import Balance, Record
from spatial_pin.dynamics.simulation.result import Energies, Simulation
from spatial_pin.dynamics.simulation.vanishing_inertia import SINGULAR, VanishingInertia
from spatial_pin.errors import EnergyError, SpatialPinError
from spatial_pin.kernel.dynamics import (
    AT_END,
    AT_FAILURE,
    MANY,
    NEW_COORDINATES,
    NO_SAMPLES,
    RunStruct,
)
from spatial_pin.kernel.integrating import RungeKutta
from spatial_pin.kernel.library import address
from spatial_pin.motion.motion import Event
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy

ROUTINE = (AT_END, MANY, NEW_COORDINATES, AT_FAILURE)  # pauses at which all samples are made
LITTLE = 1e-3  # of the residual that a step may leave, below which the step may be longer
SHORTEST = 1e-13  # step, relative to the time, that is not shortened any more


class Run:
    """A simulation under way.

    Args:
        problem: mechanism, forces and prescribed drivers.
        accuracy: integrator, tolerance or step.
        formulate: makes the equations of motion for a state, of no kind that was given up.
        times: (N,) of the samples.
        watch: the events to look for.

    Attributes:
        t: time reached [s].
        y: unknowns there.
        start: energies at the start.
        record: the samples so far.
        balance: of their energies, once they have begun.
    """

    def __init__(
        self, problem: Problem, accuracy: Accuracy, formulate: Formulate, times: Array,
        watch: Watch,
    ) -> None:
        self._problem, self._accuracy, self._watch = problem, accuracy, watch
        self.start = Energies(0.0, 0.0, 0.0)
        self.t, self._end = 0.0, float(times[-1])
        self.y: Array = np.empty(0)
        self.record = Record(problem, times, watch)
        self._stepping = Stepping(problem, accuracy, self._end)
        self._in_use = EquationsInUse(problem, accuracy, formulate, self.record, self._stepping)
        self._inertia = VanishingInertia(problem.mechanism)
        self._evaluations, self._has_failed, self._is_short = 0, False, False
        record, limits = self.record, {k: address(x) for k, x in watch.bounds.items()}
        self._kernel_run = RunStruct(
            address(record.times), len(record.times), 0, *map(address, record.room),
            allowed=float(accuracy.most_steps), looks=watch.always,
            n_limits=len(watch.bounds["limit_q"]), between=problem.between, **limits)

    def follow(self, state: State) -> Iterator[float]:
        """Integrate until the end, in one set of coordinates after the other; yields the time."""
        system = self._in_use.begin(0.0, state)
        self.y = system.unknowns(state.v, 0.0)
        self.start = system.energies(0.0, self.y)
        self.balance = Balance(self._problem, self._accuracy, self.start)
        start = self.record.until(0.0)
        self.record.evaluate(system, start, self.y[None][: len(start)])
        if not len(self.y):  # no freedom and no work: the drivers' laws alone determine the motion
            rest = self.record.until(self._end)
            self.record.evaluate(system, rest, np.empty((len(rest), 0)))
            self.t = self._end
        while self.t < self._end:
            before = system.evaluations
            try:
                for stopped in self._steps(system):
                    yield self.t
                    if stopped:
                        return
            finally:
                self._evaluations += system.evaluations - before
            if self.t < self._end:
                system, self.y = self._in_use.begin_again(
                    system, self.t, self.y, self._has_failed)

    def _steps(self, system: Independent) -> Iterator[bool]:
        """Take steps until the end, a failure or other coordinates; yields whether to stop."""
        solver = self._stepping.begin(system, self.t, self.y)
        self._has_failed = False
        while solver.status == "running":
            why = self._leap(system, solver)
            if why is None:
                solver.step()
            if (solver.status == "failed" or why == AT_FAILURE
                    or not solver.t > solver.t_old):  # LSODA goes on for ever
                self._has_failed = True
                break
            if why in ROUTINE:
                yield False
                self._stepping.refuse_to_go_on_for_ever(self.t, self.record.steps, solver)
                if why == NEW_COORDINATES:
                    break
                continue
            stops = self._keep(system, solver, why)
            if stops is None:
                solver = self._repeated(system, solver, why)
                continue
            yield stops
            self._stepping.refuse_to_go_on_for_ever(self.t, self.record.steps, solver)
            if solver.status == "running":
                if system.needs_new_coordinates(self.t, solver.y):
                    break
                solver = self._stepping.succeed(system, self.t, self.y, solver)

    def _leap(self, system: Independent, solver: Any) -> int | None:
        """Take many steps and their samples in the kernel; why it paused, None if it cannot.

        Unless the reason is in ROUTINE, the caller still has to handle the last step: its events
        and its samples.
        """
        if not isinstance(solver, RungeKutta) or system.projects:
            return None
        record, run, before = self.record, self._kernel_run, solver.steps
        run.row, run.n_crossed, run.patience = record.filled, 0, system.patience
        run.most = self._stepping.most(record.steps)
        run.largest_pivot, run.largest_step = self._stepping.largest
        try:
            why = solver.run(run)
        finally:
            record.filled = run.row
        for x, row in zip(run.crossed[: run.n_crossed], run.crossed_row, strict=False):
            record.note_crossing(system.coordinate_at(x), row)
        taken = solver.steps - before
        self._stepping.leapt(taken, np.array([run.largest_pivot, run.largest_step]))
        record.steps += taken if why in ROUTINE else max(taken - 1, 0)
        if why in ROUTINE:
            self._stepping.note(system, solver)
            self.t, self.y = solver.t, solver.y
        return why

    def _keep(self, system: Independent, solver: Any, why: int | None) -> bool | None:
        """Keep the last step, which the kernel left for this reason, with its samples and events.

        Returns:
            Whether it is to be the last; None where it leads nowhere, or closed loops do not lie
            between its ends: nothing is kept.

        Raises:
            SingularError: steps only creep on.
        """
        if why == NO_SAMPLES:
            return None
        if isinstance(system, Projected):
            opened = system.settle(solver)
            if opened > 1.0:
                self._is_short = True
                return None
            if self._is_short and opened < LITTLE:
                solver.max_step = min(2.0 * solver.max_step, self._accuracy.step or np.inf)
            self.balance.refuse_to_lose(solver.t, system.energies(solver.t, solver.y))
        if self._stepping.creeps(system.pivot, solver.t - solver.t_old):
            raise self._in_use.singular(self.t, system.state(solver.t, solver.y))
        self._stepping.note(system, solver)
        try:
            stops = self._take(system, solver, self._before(solver, why))
        except Lost:
            return None
        self.t, self.y = solver.t, solver.y
        return stops

    def _before(self, solver: Any, why: int | None) -> Array:
        """Return the unknowns (n,) where the last step began."""
        before: Array = self.y if why is None else solver.y_old
        return before

    def _repeated(self, system: Independent, solver: Any, why: int | None) -> Any:
        """Return an integrator that repeats the last step, at most half as long.

        Raises:
            SingularError: even the shortest steps open the loops.
            SpatialPinError: the step is fixed.
        """
        self.t, self.y = float(solver.t_old), self._before(solver, why)
        self._watch.forget()
        step = solver.t - self.t
        if INTEGRATORS[self._accuracy.integrator].is_fixed:
            raise SpatialPinError(
                f"mechanism {self._problem.mechanism.name!r}: a step of {step:.3g} s at "
                f"{self.t:.9g} s opens the loops too far to be closed surely: take shorter ones")
        if step < SHORTEST * (self.t + step):
            raise self._in_use.singular(self.t, system.state(self.t, self.y))
        return self._stepping.begin(system, self.t, self.y, 0.5 * step, not system.projects)

    def _take(self, system: Independent, solver: Any, before: Array) -> bool:
        """Keep samples and events of the last step; return whether it is to be the last."""
        self.record.steps += 1
        step = IntegrationStep(system, solver)
        found = self._watch.look(step, self.record.until(step.last))
        if found.stop is None:
            length = step.last - step.first
            shortened = length / max(self._stepping.largest[1], length)
            at = (step.last, *step.place(step.last))
            if self._inertia.is_ahead(*at, shortened):
                found = found._replace(
                    stop=step.last, text=self._inertia.words(*at), kind=SINGULAR)
        self.record.take(step, found, before)
        return found.stop is not None

    def end_without_inertia(self) -> bool:
        """End a motion that cannot be followed, if that is for want of inertia; whether it is.

        It has the samples until then whose energy is right: a fixed step may leap over the place.
        """
        if not self.record.filled:
            return False
        with suppress(EnergyError):
            self.balance.refuse_samples(self.record)
        times, samples = self.record.all()
        if not self._inertia.was_ahead(times, samples.q, samples.v):
            return False
        words = self._inertia.words(times[-1], samples.q[-1], samples.v[-1])
        self.record.events.append(Event(SINGULAR, float(times[-1]), len(times), words))
        return True

    def why(self) -> str:
        """Return why the motion cannot be followed beyond the present time."""
        return self._in_use.why(self.t, self.y)

    def motion(self) -> Simulation:
        """Return the samples so far."""
        return self.record.motion(
            self.start, self._evaluations, self._in_use.projection(), self._stepping.used)
