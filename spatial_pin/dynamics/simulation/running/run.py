"""A simulation under way: from step to step, and from independent coordinates to others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Set
from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.dynamics.simulation.formulations.projected import Projected
from spatial_pin.dynamics.simulation.independent_coordinates import Lost
from spatial_pin.dynamics.simulation.integrators import (
    AUTOMATIC,
    EXPLICIT,
    natural_units,
    stepper,
    successor,
)
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Energies, Projection, Simulation
from spatial_pin.dynamics.simulation.running.ending import why_it_ends
from spatial_pin.dynamics.simulation.running.energy_balance import Balance
from spatial_pin.dynamics.simulation.running.events import Watch
from spatial_pin.dynamics.simulation.running.record import Record
from spatial_pin.dynamics.simulation.running.step import Step
from spatial_pin.errors import (
    EnergyError,
    SingularError,
    SpatialPinError,
    StepLimitError,
    warn,
)
from spatial_pin.kernel.dynamics import AT_END, AT_FAILURE, MANY, NEW_CHART
from spatial_pin.kernel.dynamics import Run as KernelRun
from spatial_pin.kernel.integrating import RungeKutta
from spatial_pin.kernel.kernel import address
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy

NEAR = 1e-3  # pivot, and step, relative to the largest so far, below which the motion creeps
ROUTINE = (AT_END, MANY, NEW_CHART, AT_FAILURE)  # pauses after which all samples are already made
LITTLE = 1e-3  # of the residual that a step may leave, below which the step may be longer
SHORTEST = 1e-13  # step, relative to the time, that is not shortened any more
TRIED = 1000  # steps of a motion without damping, which go on as long as they are
HOPELESS = 10.0  # steps needed relative to those allowed: beyond, the duration is a mistake
CREEPING = 60  # such steps in a row that show a singular configuration just ahead
NOWHERE = 1e-2  # of the longest step: farther than all allowed steps would lead if as short
STANDING = 200  # such steps in a row that lead nowhere: stiff motions soon take longer ones

GivenUp = Set[tuple[type, tuple[int, ...]]]  # formulations, and their independent coordinates
Formulate = Callable[[Problem, State, GivenUp], Independent]


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
    """

    def __init__(
        self, problem: Problem, accuracy: Accuracy, formulate: Formulate, times: Array,
        watch: Watch,
    ) -> None:
        self.problem, self.accuracy, self.formulate = problem, accuracy, formulate
        self.record, self.watch = Record(problem, times, watch), watch
        self.start = Energies(0.0, 0.0, 0.0)
        self.t, self.end = 0.0, float(times[-1])
        self.y: Array = np.empty(0)
        self.system: Independent | None = None
        self._evaluations = 0
        self._projections: list[Projection] = []  # of the equations of motion used before
        self._largest, self._creeping, self._standing = np.zeros(2), 0, 0
        self._begun_at, self._failed_at = 0.0, -1.0
        self._has_failed = self._warned = self._is_short = False
        self._given_up: set[tuple[type, tuple[int, ...]]] = set()  # at the time of the failure
        self._began = time.perf_counter()

    def follow(self, state: State) -> Iterator[float]:
        """Integrate chart after chart until the end; yields the time reached."""
        self._first = state
        system = self._begin(state)
        self.y = system.unknowns(state.v, 0.0)
        self.start = system.energies(0.0, self.y)
        self._balance = Balance(self.problem, self.accuracy, self.start)
        start = self.record.until(0.0)
        self.record.ask(system, start, self.y[None][: len(start)])
        if not len(self.y):  # no freedom and no work: the drivers' laws alone determine the motion
            rest = self.record.until(self.end)
            self.record.ask(system, rest, np.empty((len(rest), 0)))
            self.t = self.end
        while self.t < self.end:
            before = system.evaluations
            try:
                for stopped in self._steps(system):
                    yield self.t
                    if stopped:
                        return
            finally:
                self._evaluations += system.evaluations - before
            if self.t < self.end:
                system = self._begin_again(system, self._has_failed)

    def _integrator(self, system: Independent, longest: float = np.inf) -> Any:
        """Return an integrator that starts here, its error norm in natural units."""
        self._units = natural_units(system, self.t, self.y, self.end - self.t)
        chosen = self.accuracy.integrator
        return self._made(EXPLICIT if chosen == AUTOMATIC else chosen, system, longest)

    def _made(self, method: str, system: Independent, longest: float = np.inf) -> Any:
        self._method, self._easy = method, 0
        return stepper(method)(
            system, self.t, self.y, self.end, self.accuracy, self._units, longest)

    def _succeeded(self, system: Independent, solver: Any) -> Any:
        """Return the integrator to go on with: another one if stiffness has changed."""
        if self.accuracy.integrator != AUTOMATIC:
            return solver
        method, self._easy = successor(solver, self._units.unknowns, self._easy)
        return solver if method == self._method else self._made(method, system, solver.max_step)

    def _steps(self, system: Independent) -> Iterator[bool]:
        """Take steps until the end, a failure or the end of a chart; yields whether to stop."""
        solver = self._integrator(system)
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
                self._refuse_to_go_on_for_ever(solver)
                if why == NEW_CHART:
                    break
                continue
            if isinstance(system, Projected) and not self._is_projected(system, solver):
                solver = self._shortened(system, solver.t - self.t)
                continue
            self._refuse_to_creep(system, solver)
            self._note_integrator(system, solver)
            before = self.y if why is None else solver.y_old
            self.t, self.y = solver.t, solver.y
            yield self._take(system, solver, before)
            self._refuse_to_go_on_for_ever(solver)
            if solver.status == "running":
                if system.needs_new_chart(self.t, solver.y):
                    break
                solver = self._succeeded(system, solver)

    @cached_property
    def _kernel_run(self) -> KernelRun:
        """What steps in the kernel want, and where their samples go."""
        record, bounds = self.record, self.watch.bounds
        return KernelRun(
            address(record.times), len(record.times), 0, *map(address, record.room),
            allowed=float(self.accuracy.most_steps), looks=self.watch.always,
            n_limits=len(bounds.q), limit_q=address(bounds.q), limit_v=address(bounds.v),
            limit_side=address(bounds.side), limit_value=address(bounds.value),
            limit_before=address(bounds.before))

    def _leap(self, system: Independent, solver: Any) -> int | None:
        """Take many steps and their samples in the kernel; why it paused, None if it cannot.

        Unless the reason is in ROUTINE, the caller still has to handle the last step: its events
        and its samples.
        """
        if not isinstance(solver, RungeKutta) or system.projects:
            return None
        record, run, before = self.record, self._kernel_run, solver.steps
        run.row, run.n_crossed, run.patience = record.filled, 0, system.patience
        run.most = min(TRIED - record.steps % TRIED,
                       max(self.accuracy.most_steps - record.steps, 1))
        run.largest_pivot, run.largest_step = self._largest
        try:
            why = solver.run(run)
        finally:
            record.filled = run.row
        for x, row in zip(run.crossed[: run.n_crossed], run.crossed_row, strict=False):
            record.note_crossing(system.coordinate_at(x), row)
        taken = solver.steps - before
        if taken > 1:
            self._creeping = self._standing = 0
        self._largest = np.array([run.largest_pivot, run.largest_step])
        record.steps += taken if why in ROUTINE else max(taken - 1, 0)
        if why in ROUTINE:
            self._note_integrator(system, solver)
            self.t, self.y = solver.t, solver.y
        return why

    def _refuse_to_lose_energy(self, t: float, now: Energies) -> None:
        """Refuse a step, or a sample, whose energy balance is wrong.

        Raises:
            EnergyError: energy was lost or gained.
        """
        if self._balance.keeps(now):
            return
        raise EnergyError(
            f"mechanism {self.problem.mechanism.name!r}: at {t:.9g} s there are "
            f"{now.total - now.work:.6g} J, the work done taken off, where {self.start.total:.6g} "
            "J were at the start: energy came from nowhere or was lost; take a smaller "
            "time_tolerance or step, or formulation='independent'")

    def refuse_samples(self) -> None:
        """Refuse samples whose energy balance is wrong; they are dropped.

        Raises:
            EnergyError: there are some.
        """
        times, samples = self.record.all()
        for k, (t, row) in enumerate(zip(times.tolist(), samples.numbers.tolist(), strict=True)):
            try:
                self._refuse_to_lose_energy(t, Energies(*row[1:]))
            except EnergyError:
                self.record.filled = k
                raise

    def _refuse_to_go_on_for_ever(self, solver: Any) -> None:
        """Refuse more steps than are allowed, early where there would be far more.

        How many fixed ones there are was known before.

        Raises:
            StepLimitError: there would be more.
        """
        most, steps = self.accuracy.most_steps, self.record.steps
        if solver.status != "running" or INTEGRATORS[self.accuracy.integrator].is_fixed:
            return
        is_hopeless = (self.problem.is_steady and not self.problem.is_damped
                       and steps % TRIED == 0
                       and self.t * HOPELESS * most < self.end * steps)
        if steps < most and not is_hopeless:
            return
        raise StepLimitError(
            f"mechanism {self.problem.mechanism.name!r}: {steps} steps have led to "
            f"{self.t:.6g} s of {self.end:.6g} s, the last of {solver.t - solver.t_old:.2g} s: "
            "take a shorter duration, a larger time_tolerance, integrator='Radau' where strong "
            f"springs or dampers make steps short, or Accuracy(most_steps={10 * most})")

    def _note_integrator(self, system: Independent, solver: Any) -> None:
        """Keep the names of integrators used; warn once of an explicit one that only creeps."""
        chosen = self.accuracy.integrator
        if self._method not in self.record.integrators:
            self.record.integrators.append(self._method)
        if self._warned or chosen == AUTOMATIC or not getattr(solver, "creeps", False):
            return
        self._warned = True
        warn(
            f"mechanism {self.problem.mechanism.name!r}: from {solver.t:.6g} s on the explicit "
            f"integrator {chosen!r} is no good, for steps of {solver.t - solver.t_old:.1e} s are "
            f"as long as it is stable with: {self._stiffest(system, solver)} is stiff. Leave the "
            "integrator out, or take Accuracy(integrator=\"Radau\")")

    def _stiffest(self, system: Independent, solver: Any) -> str:
        """Return what causes the stiffness at the solver's time, in words."""
        problem = self.problem
        resistance = problem.forces.resistance
        if not resistance:
            return "a spring or damper"
        slopes = resistance.slopes(system.place(solver.t, solver.y)[1]) * problem.scale**2
        by_v = {c.v: c.name for c in problem.mechanism.coordinate_table.values()}
        at = int(slopes.argmax())
        damped = resistance.damping[at] * problem.scale[at] ** 2 > 0.5 * slopes[at]
        return f"the {'damping' if damped else 'dry friction'} of {by_v[at]!r}"

    def _is_projected(self, system: Projected, solver: Any) -> bool:
        """Project the last step onto closed loops; False if its residual was too large for that."""
        opened = system.settle(solver)
        if opened > 1.0:
            self._is_short = True
            return False
        if self._is_short and opened < LITTLE:
            solver.max_step = min(2.0 * solver.max_step, self.accuracy.step or np.inf)
        self._refuse_to_lose_energy(solver.t, system.energies(solver.t, solver.y))
        return True

    def _shortened(self, system: Independent, step: float) -> Any:
        """Return an integrator that repeats a step [s], at most half as long.

        Raises:
            SingularError: even the shortest steps open the loops.
            SpatialPinError: the step is fixed.
        """
        if INTEGRATORS[self.accuracy.integrator].is_fixed:
            raise SpatialPinError(
                f"mechanism {self.problem.mechanism.name!r}: a step of {step:.3g} s at "
                f"{self.t:.9g} s opens the loops too far to be closed surely: take shorter ones")
        if step < SHORTEST * (self.t + step):
            raise self._singular(system.state(self.t, self.y))
        return self._integrator(system, 0.5 * step)

    def _refuse_to_creep(self, system: Independent, solver: Any) -> None:
        """Stop where steps become ever shorter ahead of a singular configuration.

        Raises:
            SingularError: steps shorten towards one, or are too short to come to the end.
        """
        sizes = np.array([system.pivot, solver.t - solver.t_old])
        self._largest = np.maximum(self._largest, sizes)
        creeps = bool(np.all(sizes < NEAR * self._largest))
        self._creeping = self._creeping + 1 if creeps else 0
        stands = sizes[1] * self.accuracy.most_steps < NOWHERE * self._largest[1]
        self._standing = self._standing + 1 if stands else 0
        if self._creeping > CREEPING or self._standing > STANDING:
            raise self._singular(system.state(solver.t, solver.y))

    def _singular(self, state: State) -> SingularError:
        return SingularError(
            f"mechanism {self.problem.mechanism.name!r}: the motion cannot be followed beyond "
            f"{self.t:.9g} s: {self.why(state)}; it is at {state}", state=state)

    def why(self, state: State | None = None) -> str:
        """Return why the motion cannot be followed beyond a state, the last one by default."""
        if state is None and self.system is not None:
            try:
                state = self.system.state(self.t, self.y)
            except Lost:
                return "the loops cannot be closed there as on the way to it"
        return why_it_ends(self.problem, self.accuracy, self._first, self.t, state or self._first)

    def _begin(self, state: State, given_up: GivenUp = frozenset()) -> Independent:
        if isinstance(self.system, Projected):
            self._projections.append(self.system.projection)
        self.system = system = self.formulate(self.problem, state, given_up)
        if _kind(system) in given_up:
            raise self._singular(state)
        self._note_begun(system)
        return system

    def _note_begun(self, system: Independent) -> None:
        self.record.note_coordinates(system.free)
        self._begun_at = self.t

    def _begin_again(self, system: Independent, failed: bool) -> Independent:
        """Choose new independent coordinates or a new chart, and change the unknowns to them.

        Raises:
            SingularError: none can be followed.
        """
        state = system.state(self.t, self.y)
        renewed = None if failed else system.renewed(self.t, self.y, state)
        if renewed is not None:
            self.y = renewed
            self._note_begun(system)
            return system
        try:
            fresh = self._begin(state, self._give_up(system) if failed else frozenset())
        except SingularError as error:
            if self._is_now(0.0):  # what is said of a start
                raise
            raise self._singular(state) from error
        self.y = fresh.unknowns(state.v, self.problem.work(self.y))
        return fresh

    def _give_up(self, system: Independent) -> GivenUp:
        """Return what has failed at the present time, the system included."""
        if not self._is_now(self._failed_at):
            self._failed_at = self.t
            self._given_up.clear()
        if system.is_fresh_the_same or self._is_now(self._begun_at):
            self._given_up.add(_kind(system))
        return self._given_up

    def _is_now(self, t: float) -> bool:
        """Whether the time since then is negligible relative to the longest step so far."""
        return self.t - t <= NEAR**2 * self._largest[1]

    def _take(self, system: Independent, solver: Any, before: Array) -> bool:
        """Keep samples and events of the last step; return whether it is to be the last."""
        self.record.steps += 1
        step = Step(system, solver)
        found = self.watch.look(step)
        self.record.take(step, found, before)
        return found.stop is not None

    def motion(self) -> Simulation:
        """Return the samples so far."""
        return self.record.motion(self.start, self._evaluations, self._projection())

    def _projection(self) -> Projection | None:
        """Return what projecting has taken, if anything was projected."""
        if not isinstance(self.system, Projected):
            return None
        parts = [*self._projections, self.system.projection]
        seconds = sum(part.seconds for part in parts)
        return Projection(
            sum(part.steps for part in parts), sum(part.corrections for part in parts),
            max(part.opened for part in parts), seconds,
            seconds / (time.perf_counter() - self._began))


def _kind(system: Independent) -> tuple[type, tuple[int, ...]]:
    return type(system), tuple(system.free)
