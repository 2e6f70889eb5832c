"""What a trade-off does: one sweep, or one simulation, repeated with other settings."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from spatial_pin._support.brief import counted
from spatial_pin.assembly.assemble import assembled, held_coordinates
from spatial_pin.assembly.redundant_equations import with_independent_equations
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.dynamics.simulation.simulate import Simulation, simulate
from spatial_pin.errors import SingularError, SpatialPinError, UnknownNameError
from spatial_pin.mechanism.coordinates import require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.default_motion import default_motion
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.prescribed import driven_coordinates
from spatial_pin.rates.rates import prescribed_at
from spatial_pin.settings import LEVELS, Accuracy

OURS = ("mechanism", "accuracy", "progress")  # arguments that the trade-off itself gives
# Duration of the default simulation relative to sqrt(characteristic length / gravity). A pendulum
# of that length takes 2 pi for a small swing, so it makes more than one and less than two.
SWINGS = 9.0
SHORTER = 0.8  # part of the time to a singular configuration that is simulated: rates stay finite
SAMPLES = 201  # samples of the default simulation: more than a hundred per swing


@dataclass(frozen=True, eq=False)
class SweepTask:
    """A sweep that begins at a known state.

    Attributes:
        start: the exact motion's first state; every setting begins there.
        arguments: keyword arguments of `sweep`, without accuracy.
    """

    mechanism: Mechanism
    start: State
    arguments: dict[str, Any]
    kind: ClassVar[str] = "sweep"
    RATES: ClassVar[dict[str, float]] = {"speed": 1.0, "acceleration": 0.0}

    def run(self, accuracy: Accuracy) -> Motion:
        """Do it with a setting."""
        return sweep(self.mechanism, accuracy=accuracy, **self.arguments)

    def row_rates(self, name: str) -> Array:
        """Return "speed" or "acceleration" of the driver at every sample (N,)."""
        given = self.arguments.get(name, self.RATES[name])
        return np.array(np.broadcast_to(given, len(self.arguments["values"])), dtype=float)

    def finer(self) -> SweepTask:
        """Return the same with a value in the middle of every two."""
        rows = np.arange(len(self.arguments["values"]))
        at = np.arange(2 * rows[-1] + 1) / 2
        columns = {"values": self.arguments["values"],
                   **{name: self.row_rates(name) for name in self.RATES}}
        return replace(self, arguments={
            **self.arguments, **{k: np.interp(at, rows, x) for k, x in columns.items()}})

    def __str__(self) -> str:
        values, name = self.arguments["values"], self.arguments["driver"]
        unit = self.mechanism.coordinate(name).unit
        zero = TOLERANCES.tight * float(np.abs(values).max())
        first, last = (0.0 if abs(x) < zero else x for x in (values[0], values[-1]))
        return f"sweep of {name} from {first:.6g} to {last:.6g} {unit}, {len(values)} values"


@dataclass(frozen=True, eq=False)
class SimulationTask:
    """A simulation.

    Attributes:
        arguments: arguments of `simulate`, without accuracy.
        is_usual: the duration is the default.
    """

    mechanism: Mechanism
    arguments: dict[str, Any]
    is_usual: bool = False
    kind: ClassVar[str] = "simulate"

    def run(self, accuracy: Accuracy) -> Simulation:
        """Do it with a setting."""
        return simulate(self.mechanism, accuracy=accuracy, **self.arguments)

    def before(self, error: SingularError) -> SimulationTask:
        """Return a shorter one, which ends well before what it met.

        Raises:
            SingularError: that, if the caller gave the duration, or nothing came before.
        """
        if not self.is_usual or error.motion is None or len(error.motion) < 2:
            raise error
        assert error.motion.time is not None
        return _fall(self.mechanism, self.arguments["state"],
                     SHORTER * float(error.motion.time[-1]))

    def __str__(self) -> str:
        return f"simulation of {self.arguments['duration']:.6g} s"


Task = SweepTask | SimulationTask


def task_of(mechanism: Mechanism, task: Mapping[str, Any] | str | Motion | None) -> Task:
    """Return the task of an argument; see `tradeoff`.

    Raises:
        SpatialPinError: the mechanism has nothing to do such a thing with.
        TypeError, ValueError: the task is none.
        UnknownNameError: the task has an argument that neither verb has.
    """
    require_mechanism(mechanism)
    mechanism = with_independent_equations(mechanism)
    if task is None:
        task = "sweep"
    if isinstance(task, str):
        if task not in _USUAL:
            raise ValueError(f"no task {task!r}; there are 'sweep' and 'simulate', or a mapping "
                             "with the arguments of one of them")
        return _USUAL[task](mechanism)
    if isinstance(task, Motion):
        return _again(mechanism, task)
    if not isinstance(task, Mapping):
        raise TypeError(f"a task is a mapping with arguments of sweep or simulate, a swept Motion, "
                        f"'sweep' or 'simulate', not {type(task).__name__}")
    if "duration" in task:
        _check(task, simulate)
        given = dict(task)
        state = given.pop("state", None)
        state = assembled(mechanism) if state is None else of_mechanism(mechanism, state)
        return SimulationTask(mechanism, {"state": state, **given})
    _check(task, sweep)
    if "values" not in task:
        if set(task) - {"driver"}:
            raise ValueError("a task needs values (a sweep) or a duration (a simulation)")
        return _default_sweep(mechanism, task.get("driver"))
    return _sweep_task(mechanism, dict(task))


def _check(task: Mapping[str, Any], verb: Callable[..., Any]) -> None:
    valid = [name for name in inspect.signature(verb).parameters if name not in OURS]
    for name in task:
        if name in OURS:
            raise ValueError(f"{name!r} is no part of a task: a trade-off tries settings itself")
        if name not in valid:
            raise UnknownNameError(f"argument of {verb.__name__}", str(name), valid)


def _sweep_task(mechanism: Mechanism, given: dict[str, Any]) -> SweepTask:
    """Return the sweep of the values that can be reached, from a state that is assembled once."""
    if "driver" not in given:
        given["driver"] = _first_driver(mechanism)
    if given.get("speed") is None:
        given["speed"] = SweepTask.RATES["speed"]  # rates by the driver are those at this speed
    motion = sweep(mechanism, accuracy=Accuracy.named("reference"), **given)
    n = len(motion)
    if not n:
        raise SpatialPinError(f"mechanism {mechanism.name!r}: no value of the task is reached")
    for name in ("speed", "acceleration"):  # one number, or one a sample
        if np.ndim(given.get(name, 0.0)):
            given[name] = np.asarray(given[name], dtype=float)[:n]
    start = motion.state(0)
    driver = mechanism.driven_coordinate(given["driver"])
    hold = given.get("hold")
    held = hold if isinstance(hold, Mapping) else [
        c.name for c in held_coordinates(mechanism, [driver.name], hold)]
    driven = prescribed_at(start, [driver.name, *held])
    hold = {c.name: start.coordinate(c.name).value for c in driven if c.name != driver.name}
    given.update(values=np.array(motion.swept), guess=start, hold=hold)
    return SweepTask(mechanism, start, given)


def _first_driver(mechanism: Mechanism) -> str:
    driver = next(iter(mechanism.drivers), None)
    if driver is None:
        raise SpatialPinError(f"mechanism {mechanism.name!r} has no driver: give the task a "
                              "'driver' (any coordinate) and its 'values'")
    return driver


def _default_sweep(mechanism: Mechanism, driver: str | None = None) -> SweepTask:
    motion = default_motion(mechanism, driver or _first_driver(mechanism))
    if isinstance(motion, State):
        raise SpatialPinError(f"mechanism {mechanism.name!r}: the driver cannot move from the "
                              "guess: give the task 'values'")
    return _again(mechanism, motion)


def _again(mechanism: Mechanism, motion: Motion) -> SweepTask:
    """Return the sweep that a motion is."""
    if motion.driver is None:
        raise ValueError("a simulation does not know all that acted on it: give the task as a "
                         "mapping with the arguments of simulate")
    driver = mechanism.driven_coordinate(motion.driver_name)
    held = [c for c in driven_coordinates(mechanism, [driver.name]) if c.name != driver.name]
    return _sweep_task(mechanism, {
        "driver": motion.driver_name, "values": motion.driver, "speed": motion.driver_speed,
        "acceleration": motion.coordinate(driver.name).acceleration,
        "guess": of_mechanism(mechanism, motion.state(0)),
        "hold": {c.name: float(motion.q[0, c.q]) for c in held}})


def _default_simulation(mechanism: Mechanism) -> SimulationTask:
    """Return a few swings under gravity from the assembled guess on, at rest."""
    gravity = float(np.linalg.norm(mechanism.model.gravity.linear))
    if not any(inertia.mass > 0.0 for inertia in mechanism.inertias.values()) or not gravity:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r} has no masses, or no gravity, that would move it: give "
            "the task as a mapping with a 'duration', a 'state' and 'efforts'")
    duration = SWINGS * math.sqrt(mechanism.characteristic_length / gravity)
    task = _fall(mechanism, assembled(mechanism), duration)
    try:
        motion: Motion = task.run(Accuracy.named("draft"))
    except SingularError as error:
        task = task.before(error)
        assert error.motion is not None
        motion = error.motion
    if np.abs(motion.v / mechanism.velocity_scale).max(initial=0.0) < TOLERANCES.nothing:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r} stands still under gravity: give the task as a mapping "
            "with a 'duration', a 'state' and 'efforts'")
    return task


def _fall(mechanism: Mechanism, state: State, duration: float) -> SimulationTask:
    return SimulationTask(mechanism, {"state": state, "duration": duration,
                                      "times": np.linspace(0.0, duration, SAMPLES)}, is_usual=True)


_USUAL: dict[str, Callable[[Mechanism], Task]] = {
    "sweep": _default_sweep, "simulate": _default_simulation,
}


# ---------------------------------------------------------------- settings that are tried

CLOSURES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10, 1e-12, 1e-13, 1e-15)  # of order 3
FEWER = (1e-4, 1e-8, 1e-13)  # of lower ones
CORRECTIONS = (0, 1, 2)
TIME_TOLERANCES = {  # by formulation and integrator
    ("independent", "DOP853"): (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12),
    ("independent", "RK45"): (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
    ("independent", "LSODA"): (1e-4, 1e-6, 1e-8, 1e-10),
    ("independent", "Radau"): (1e-3, 1e-5, 1e-7),
    ("independent", "BDF"): (1e-4, 1e-6),
    ("projected", "DOP853"): (1e-4, 1e-6, 1e-8, 1e-10),
}
STEPS = {  # fixed steps relative to the mean step of the reference
    ("independent", "RK4"): (4.0, 2.0, 1.0, 0.5),
    ("independent", "Gauss"): (4.0, 1.0),
    ("projected", "RK4"): (2.0,),
}
# Closure tolerance relative to the tolerance in time, between 1e-13 and 1e-8: after a hundred
# steps the closure adds less error than the integrator.
SAFETY = 1e-2


def sweep_settings() -> list[Accuracy]:
    """Return predictor orders with fixed corrections, and with corrections to tolerances."""
    fixed = [Accuracy(order=order, corrections=n) for order in range(4) for n in CORRECTIONS
             if order or n]
    converged = [Accuracy(order=order, tolerance=x) for order in range(4)
                 for x in (CLOSURES if order == 3 else FEWER)]
    named = [Accuracy(tolerance=level.tolerance) for level in LEVELS.values()]
    return list(dict.fromkeys([*named, *converged, *fixed]))


def simulation_settings(step: float) -> list[Accuracy]:
    """Return integrators with tolerances, or with steps by a mean step [s]."""
    adaptive = [
        Accuracy(tolerance=float(f"{min(1e-8, max(1e-13, SAFETY * x)):.1e}"),
                 formulation=formulation, integrator=integrator, time_tolerance=x)
        for (formulation, integrator), tolerances in TIME_TOLERANCES.items() for x in tolerances]
    fixed = [
        Accuracy(formulation=formulation, integrator=integrator, step=float(f"{step * x:.2g}"))
        for (formulation, integrator), factors in STEPS.items() for x in factors]
    return list(dict.fromkeys([*LEVELS.values(), *adaptive, *fixed]))


def power(x: float) -> str:
    """Return a number as 1e-8, with two digits at most."""
    mantissa, exponent = f"{x:.1e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def describe(accuracy: Accuracy, kind: str) -> str:
    """Return a setting in words, for a "sweep" or for "simulate"."""
    same: tuple[str, ...] = ("order", "corrections", "tolerance")
    if kind == "sweep":
        n = accuracy.corrections
        words = f"to {power(accuracy.tolerance)}" if n is None else counted(n, "correction")
        text = f"order {accuracy.order}, {words}"
    else:
        dial = (f"step {accuracy.step:.3g} s" if accuracy.step is not None
                else power(accuracy.time_tolerance))
        projected = "projected " if accuracy.formulation == "projected" else ""
        text = f"{projected}{accuracy.integrator} {dial}"
        same = tuple(accuracy.__dataclass_fields__)
    level = next((name for name, x in LEVELS.items()
                  if all(getattr(x, key) == getattr(accuracy, key) for key in same)), None)
    return f"{text} ({level})" if level else text
