"""Motion in time under forces, the loops closed exactly in every evaluation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from tqdm import tqdm

from spatial_pin.dynamics.embedding import Lost, best_coordinates
from spatial_pin.dynamics.forces import Law
from spatial_pin.dynamics.freedoms import Freedoms
from spatial_pin.dynamics.one_freedom import OneFreedom
from spatial_pin.dynamics.problem import EffortLaw, Problem, Row, System
from spatial_pin.dynamics.projected import Projected
from spatial_pin.dynamics.steppers import STEPPERS
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kinematics.motion import Event, Motion
from spatial_pin.kinematics.state import State, of_mechanism
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import finite_array
from spatial_pin.mechanism.laws import DriverLaw
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.settings import Accuracy

ROWS = 1000  # rows of a simulation whose times are not given, less one
NEAR = 1e-3  # pivot, and step, by the largest so far, below which the motion creeps
CREEPING = 60  # such steps in a row that tell a singular configuration just ahead


@dataclass(eq=False)
class Simulation(Motion):
    """A Motion in time, with its energies.

    Attributes:
        energy: (N,) kinetic, potential and spring energy [J].
        work: (N,) of efforts, dampers, prescribed drivers and spring laws since the start [J].
        energy_drift: largest difference of energy and work to the energy at the start, by the
            largest kinetic energy or change of the rest [-].
        efforts: (N,) of every prescribed driver [N·m, N].
        coordinates: independent coordinates that were used, in their order.
        evaluations: how often the equations of motion were evaluated.
        steps: how many steps were taken.
        by_drivers: whether, besides gravity and springs as the file has them, only drivers acted;
            False where efforts were a function.
    """

    energy: Array = field(default_factory=lambda: np.empty(0))
    work: Array = field(default_factory=lambda: np.empty(0))
    energy_drift: float = 0.0
    efforts: dict[str, Array] = field(default_factory=dict)
    coordinates: list[str] = field(default_factory=list)
    evaluations: int = 0
    steps: int = 0
    by_drivers: bool = True


class _Rows:
    """Rows of a simulation, filled one after the other, several in one go.

    Args:
        times: (N,) when.
    """

    def __init__(self, times: Array) -> None:
        self.times, self.asked = times, 0
        self._waiting: list[tuple[Array, Array]] = []
        self._times: list[float] = []
        self._rows: list[Row] = []
        self._work: list[float] = []

    def until(self, end: float) -> Array:
        """Return the times of rows not yet asked for, up to `end`."""
        return self.times[self.asked : np.searchsorted(self.times, end, "right")]

    def ask(self, system: System, times: Array, unknowns: Array) -> None:
        """Ask for rows at times (N,) and unknowns (N, n)."""
        self._waiting.append((times, unknowns))
        self.asked += len(times)
        if self.asked - len(self._rows) >= system.rows_at_once:
            self.fill(system)

    def fill(self, system: System) -> None:
        """Work out all rows that were asked for."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            times, unknowns = (np.concatenate(x) for x in zip(*waiting, strict=True))
            self._rows += system.rows(times, unknowns)
            self._times += times.tolist()
            self._work += [system.problem.work(y) for y in unknowns]

    def filled(self) -> tuple[Array, list[Row], Array]:
        """Return the rows that are worked out: times (N,), rows, and work done until each (N,)."""
        return np.array(self._times), self._rows, np.array(self._work)


def simulate(
    mechanism: Mechanism,
    state: State,
    duration: float,
    efforts: Mapping[str, float] | EffortLaw | None = None,
    times: Any = None,
    accuracy: Accuracy | None = None,
    *,
    drives: Mapping[str, DriverLaw] | None = None,
    laws: Mapping[str, Law] | None = None,
    stop_when: Callable[[float, State], float] | None = None,
    progress: bool = False,
) -> Simulation:
    """Simulate a mechanism in time.

    The equations of motion are solved in independent coordinates, chosen anew when others move
    faster; every evaluation closes the loops to `accuracy.tolerance`, so that nothing drifts. With
    one freedom, change points (branches that cross) are passed straight on, with an event.

    Args:
        mechanism: the mechanism.
        state: configuration and velocity at time 0, from `solve_rates`.
        duration: how long [s].
        efforts: by driver, joint or coordinate, constant, or a function (t, State) -> such a
            mapping [N·m about it, N along it]. Drivers are free unless they have a law in `drives`.
        times: (N,) rising times of the rows, default 0 to duration in 1000 steps [s].
        accuracy: integrator, its tolerance or step, and closure; default "engineering".
        drives: by driver or coordinate, a law (see `spatial_pin.laws`) that prescribes it.
        laws: by spring, force as a function of (length, rate), see `forward_dynamics`.
        stop_when: ends the simulation where this function (t, State) crosses zero, with an event
            and a last row there.
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Simulation, a Motion with energy, work and efforts.

    Raises:
        SingularError: the motion is not determined at some configuration; `.motion` holds what
            came before.
        SpatialPinError: the state does not fit the laws, or the integrator gives up.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite, or times do not rise.
    """
    accuracy = accuracy or Accuracy.named("engineering")
    state = of_mechanism(mechanism, state)
    times = _times(duration, times)
    if accuracy.integrator not in STEPPERS:
        raise ValueError(f"no integrator {accuracy.integrator!r}; there are {', '.join(STEPPERS)}")
    _check_formulation(accuracy)
    problem = Problem(mechanism, efforts, drives, laws, accuracy.tolerance)
    _check_start(problem, state)
    run = _Run(problem, accuracy, times, stop_when)
    bar = tqdm(total=float(times[-1]), desc=f"{mechanism.name}: seconds", delay=1.0, leave=False,
               disable=None if progress else True)
    try:
        for t in run.follow(state):
            bar.update(t - bar.n)
    except Lost:
        raise SingularError(
            f"mechanism {mechanism.name!r}: the motion cannot be followed beyond {run.t:.9g} s: "
            "the loops lose rank, or branches cross, there", motion=run.motion(),
        ) from None
    except SingularError as error:
        error.motion = run.motion()
        raise
    finally:
        bar.close()
    return run.motion()


def _check_formulation(accuracy: Accuracy) -> None:
    if accuracy.formulation not in FORMULATIONS:
        raise ValueError(f"no formulation {accuracy.formulation!r}; there are "
                         f"{', '.join(FORMULATIONS)}")
    if accuracy.formulation == "projected" and accuracy.integrator not in SETTLING:
        raise ValueError(f"integrator {accuracy.integrator!r} cannot be corrected after a step; "
                         f"for the projected formulation there are {', '.join(SETTLING)}")


def _times(duration: float, times: Any) -> Array:
    duration = float(duration)
    if not (np.isfinite(duration) and duration > 0.0):
        raise ValueError(f"duration is {duration}; it must be positive")
    if times is None:
        return np.linspace(0.0, duration, ROWS + 1)
    array = np.atleast_1d(np.asarray(times, dtype=float))
    array = finite_array(array, (array.size,), "times")
    if not array.size or array[0] < 0.0 or np.any(np.diff(array) <= 0.0) or array[-1] > duration:
        raise ValueError("times must rise from 0 at least to the duration at most")
    return array


def _check_start(problem: Problem, state: State) -> None:
    """Refuse a state that does not start as the laws of its prescribed drivers do."""
    name = problem.mechanism.name
    for c, law in problem.drives:
        value, rate, _ = law(0.0)
        scale = problem.scale[c.v]
        if abs(value - state.q[c.q]) > 1e-9 * scale:
            raise SpatialPinError(
                f"mechanism {name!r}: the law of {c.name} starts at {value:.9g} {c.unit}, the "
                f"state is at {state.q[c.q]:.9g}: assemble it there")
        if abs(rate - state.v[c.v]) > 1e-9 * scale * (1.0 + abs(rate)):
            raise SpatialPinError(
                f"mechanism {name!r}: the law of {c.name} starts with {rate:.9g} {c.unit}/s, the "
                f"state moves with {state.v[c.v]:.9g}: solve its rates")


def _independent(problem: Problem, state: State) -> System:
    """Return the equations of motion in the independent coordinates that fit a state best.

    Raises:
        SingularError: the motion is not determined there.
    """
    free = best_coordinates(state, [c.v for c, _ in problem.drives])
    if len(free) == 1 and not problem.drives:
        only = next(c for c in problem.mechanism.coordinate_table.values() if c.v == free[0])
        if only.q >= 0:
            return OneFreedom(problem, state, only)
    return Freedoms(problem, state, free)


FORMULATIONS: dict[str, Callable[[Problem, State], System]] = {
    "independent": _independent,
    "projected": Projected,
}
SETTLING = ("DOP853", "RK45", "Radau", "RK4", "Gauss")  # integrators that a projection can correct


class _Run:
    """A simulation under way.

    Attributes:
        t: time reached [s].
        y: unknowns there.
    """

    def __init__(
        self, problem: Problem, accuracy: Accuracy, times: Array,
        stop_when: Callable[[float, State], float] | None,
    ) -> None:
        self.problem, self.accuracy = problem, accuracy
        self.rows, self.events = _Rows(times), list[Event]()
        self.stop_when, self.last = stop_when, 0.0
        self.t, self.end = 0.0, float(times[-1])
        self.y: Array = np.empty(0)
        self.steps, self.evaluations = 0, 0
        self.used: list[str] = []
        self._largest, self._creeping = np.zeros(2), 0
        self._failed_at = -1.0

    def follow(self, state: State) -> Iterator[float]:
        """Integrate from coordinates to coordinates until the end; yields the time reached."""
        system = self._begin(state)
        self.y = system.unknowns(state.v, 0.0)
        start = self.rows.until(0.0)
        self.rows.ask(system, start, self.y[None][: len(start)])
        if self.stop_when is not None:
            self.last = self.stop_when(0.0, state)
        while self.t < self.end:
            solver = STEPPERS[self.accuracy.integrator](
                system, self.t, self.y, self.end, self.accuracy)
            before = system.evaluations
            try:
                for stopped in self._steps(system, solver):
                    yield self.t
                    if stopped:
                        return
            finally:
                self.evaluations += system.evaluations - before
                self.rows.fill(system)
            if self.t < self.end:
                system = self._begin_again(system, solver.status == "failed")

    def _steps(self, system: System, solver: Any) -> Iterator[bool]:
        """Take steps until the end, a failure or worn coordinates; yields whether to stop."""
        while solver.status == "running":
            solver.step()
            if solver.status == "failed":
                break
            system.settle(solver)
            self._watch(system, solver)
            self.t, self.y = solver.t, solver.y
            yield self._take(system, solver)
            if solver.status == "running" and system.is_worn(self.t, solver.y):
                break

    def _watch(self, system: System, solver: Any) -> None:
        """Refuse to creep into a singular configuration.

        Raises:
            SingularError: ever shorter steps lead to one.
        """
        sizes = np.array([system.pivot, solver.t - solver.t_old])
        self._largest = np.maximum(self._largest, sizes)
        creeps = bool(np.all(sizes < NEAR * self._largest))
        self._creeping = self._creeping + 1 if creeps else 0
        if self._creeping > CREEPING:
            raise self._singular(system.state(solver.t, solver.y))

    def _singular(self, state: State) -> SingularError:
        return SingularError(
            f"mechanism {self.problem.mechanism.name!r}: the motion cannot be followed beyond "
            f"{self.t:.9g} s: the loops lose rank, or branches cross, just ahead of {state}",
            state=state)

    def _begin(self, state: State) -> System:
        system = FORMULATIONS[self.accuracy.formulation](self.problem, state)
        by_v = {c.v: c.name for c in self.problem.mechanism.coordinate_table.values()}
        self.used += [by_v[v] for v in system.free]
        return system

    def _begin_again(self, system: System, failed: bool) -> System:
        """Choose new coordinates where the old ones are worn, and change the unknowns to them."""
        state = system.state(self.t, self.y)
        if failed and self.t == self._failed_at:
            raise self._singular(state)
        if failed:
            self._failed_at = self.t
        free = best_coordinates(state, [c.v for c, _ in self.problem.drives])
        if free == system.free and system.is_fresh_the_same:
            if failed:
                raise self._singular(state)
            system.patience *= 2.0
            return system
        fresh = self._begin(state)
        self.y = fresh.unknowns(state.v, self.problem.work(self.y))
        return fresh

    def _take(self, system: System, solver: Any) -> bool:
        """Keep rows and events of the last step; return whether it is to be the last."""
        self.steps += 1
        stop = self._crossed(system, solver)
        times = self.rows.until(solver.t if stop is None else stop)
        if stop is not None:
            times = np.union1d(times, [stop])
        unknowns = solver.dense_output()(times).T if times.size else np.empty((0, len(solver.y)))
        self._note_crossings(system, solver.y, unknowns)
        if times.size:
            self.rows.ask(system, times, unknowns)
        if stop is not None:
            self.events.append(Event("stopped", stop, self.rows.asked, f"stopped at {stop:.12g} s"))
        return stop is not None

    def _crossed(self, system: System, solver: Any) -> float | None:
        """Return when `stop_when` has crossed zero in the last step, if it has."""
        function = self.stop_when
        if function is None:
            return None
        before, self.last = self.last, function(solver.t, system.state(solver.t, solver.y))
        if before == 0.0 or before * self.last > 0.0:
            return None
        from scipy.optimize import brentq  # imported on use: it takes a tenth of a second

        dense = solver.dense_output()
        return float(brentq(lambda t: function(t, system.state(t, dense(t))), solver.t_old,
                            solver.t, xtol=1e-14, rtol=1e-14))

    def _note_crossings(self, system: System, y: Array, unknowns: Array) -> None:
        """Keep crossings passed in the last step, which ended at y and has rows at `unknowns`."""
        for value, at in system.crossings_to(y):
            row = self.rows.asked + int(np.count_nonzero((unknowns[:, 0] - at) * y[1] < 0.0))
            text = (f"branch point at {self.used[-1]} = {value:.9g}: branches cross; followed the "
                    "one that goes straight on")
            self.events.append(Event("branch point", value, row, text))

    def motion(self) -> Simulation:
        """Return the rows so far."""
        problem, names = self.problem, [c.name for c, _ in self.problem.drives]
        times, rows, work = self.rows.filled()
        n = len(rows)
        q, v, a, error, energy, efforts, angles = (
            np.array(column) for column in (zip(*rows, strict=True) if n else [[]] * 7))
        model = problem.model
        q, v, a = q.reshape(n, model.nq), v.reshape(n, model.nv), a.reshape(n, model.nv)
        return Simulation(
            mechanism=problem.mechanism, driver=None, driver_name="", time=times, q=q, v=v, a=a,
            closure_error=error, driver_speed=np.empty(0), events=self.events,
            angles=angles.reshape(n, angles.size // max(n, 1)), energy=energy, work=work,
            energy_drift=_drift(problem, q, v, energy, work),
            efforts=dict(zip(names, efforts.reshape(n, len(names)).T, strict=True)),
            coordinates=list(dict.fromkeys(self.used)), evaluations=self.evaluations,
            steps=self.steps, by_drivers=problem.by_drivers,
        )


def _drift(problem: Problem, q: Array, v: Array, energy: Array, work: Array) -> float:
    """Return the largest energy that came from nowhere, by what the motion exchanges."""
    if not len(energy):
        return 0.0
    kinetic = np.array([pin.computeKineticEnergy(problem.model, problem.data, *row)
                        for row in zip(q, v, strict=True)])
    size = max(float(kinetic.max()), float(np.ptp(energy - kinetic)))
    drift = float(np.abs(energy - work - energy[0]).max())
    return drift / size if size > 0.0 else 0.0
