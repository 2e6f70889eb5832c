"""Integrators of ordinary differential equations, made of entries of `settings.INTEGRATORS`.

`stepper` returns a function (fun, t0, y0, t_end, settings, units, longest, first) to an object that
steps like those of SciPy: `step()`, `t`, `t_old`, `y`, `status` ("running", "finished" or "failed")
and `dense_output()`, a function of the time, or of times (N,), over the last step that returns
unknowns (n,) or (n, N). `units` say what counts as one of every unknown, `longest` is the longest
step [s] and `first` the longest first one; steps of fixed length know neither but `longest`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module
from inspect import signature
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.integrating import RungeKutta
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, KERNEL, Accuracy

Function = Callable[[float, Array], Array]

FINEST = 100.0 * float(np.finfo(float).eps)  # tolerance that SciPy's methods can keep
LONG = 15  # steps of an implicit method that an explicit one would take too
SLOW = 1.0  # step times the fastest decay rate, at which an explicit method would do
SLOPE_STEP = 1e-7  # step of differences for implicit methods, relative to the unknowns' units
HUGE = 1e100  # rate that stands for none, where loops cannot be closed
FASTEST = 1e100  # rate whose square, divided by a tolerance, still has a square
SLOWEST = 1e3  # durations that a natural time may last


class Units(NamedTuple):
    """What counts as one.

    Attributes:
        time: the natural time T [s].
        unknowns: (n,) of every unknown: 1 of coordinates and quaternions, 1/T of rates, and an
            energy of work.
    """

    time: float
    unknowns: Array


def natural_units(system: Independent, t: float, y: Array, left: float) -> Units:
    """Return the natural units of a motion that stands at the unknowns y.

    A mechanism that moves a million times faster moves on the same curve. Its error control should
    see the same numbers, so rates are counted per natural time T, and work by the energy of its
    heaviest coordinate at that rate. 1/T is the largest of

        rates,  square roots of accelerations,  sqrt(gravity / characteristic length)

    at the start of the integration (all in radians or characteristic lengths), divided by 2 pi: T
    is about the period of a pendulum, or of a turn. Where nothing moves or pulls, T is many
    durations.

    Args:
        system: its equations.
        t: when [s].
        y: (n,) unknowns.
        left: how long it goes on [s].

    Raises:
        SpatialPinError: it changes faster than floating-point times resolve.
    """
    problem, n = system.problem, len(system.free)
    mechanism = problem.mechanism
    pull = np.fmax.reduce(np.abs(system(t, y)[n : 2 * n]), initial=0.0)  # where it is a number
    gravity = float(np.linalg.norm(problem.model.gravity.linear))
    pace = max(float(np.abs(y[n : 2 * n]).max(initial=0.0)),
               math.sqrt(pull),
               math.sqrt(gravity / mechanism.characteristic_length))
    if pace > FASTEST:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: at {t:.6g} s it moves so fast, or forces are so large, "
            f"that it changes within {1.0 / pace:.1g} s: numbers cannot tell how")
    rate = max(pace / (2.0 * math.pi), 1.0 / (SLOWEST * left))
    units = np.ones(len(y))
    units[n : 2 * n] = rate
    if problem.works:
        units[-1] = system.heaviest(t, y) * rate * rate or 1.0
    return Units(1.0 / rate, units)


class Differences:
    """d fun/dy by differences of well-scaled steps, finite wherever it is asked for.

    Those of SciPy grow without bound where nothing depends on an unknown, and those of LSODA
    vanish at rest. Where loops cannot be closed on one side the other is taken, and where they
    cannot be closed at all what was found last: the integrator then shortens its step.
    """

    def __init__(self, fun: Function, units: Array) -> None:
        self._fun, self._units = fun, units
        self._last = np.zeros((len(units), len(units)))

    def __call__(self, t: float, y: Array) -> Array:
        """Return the (n, n) Jacobian at t, y."""
        f, found = self._fun(t, y), self._last.copy()
        steps = SLOPE_STEP * np.maximum(self._units, np.abs(y)) * np.isfinite(f).all()
        for j, h in enumerate(steps.tolist()):
            for step in (h, -h) if h else ():
                moved = y.copy()
                moved[j] += step
                column = (self._fun(t, moved) - f) / (moved[j] - y[j])
                if np.isfinite(column).all():
                    found[:, j] = column
                    break
        self._last = found
        return found.copy()


def first_step(
    fun: Function, t0: float, y0: Array, span: float, order: int, tolerance: float, units: Units
) -> float:
    """Return a first step [s], the same whatever the unit of time [HairerNorsettWanner1993, II.4].

    SciPy's own begins with a microsecond where a motion starts from rest, be it an age.
    """
    f0, size = fun(t0, y0), tolerance * (units.unknowns + np.abs(y0))

    def norm(x: Array) -> float:
        return float(np.linalg.norm(x / size)) / math.sqrt(len(x))

    d0, d1 = norm(y0), units.time * norm(f0)
    trial = 0.01 * d0 / d1 if d0 >= 1e-5 <= d1 < math.inf else 1e-6
    trial = min(trial, span / units.time)
    f1 = fun(t0 + trial * units.time, y0 + trial * units.time * f0)
    d2 = units.time * norm(f1 - f0) / trial
    fastest = max(d1, d2)
    step = max(1e-6, 1e-3 * trial) if fastest <= 1e-15 else (0.01 / fastest) ** (1.0 / (order + 1))
    if not math.isfinite(d2):
        step = 0.01 * trial
    return min(units.time * min(100.0 * trial, step), span)


def _like_scipy(name: str) -> Callable[..., Any]:
    def make(
        fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
        longest: float = math.inf, first: float = math.inf,
    ) -> Any:
        module, _, own = INTEGRATORS[name].solver.partition(":")
        made = getattr(import_module(module), own)  # on use: SciPy's take half a second
        tolerance = max(accuracy.time_tolerance, FINEST)
        longest = min(longest, accuracy.step or math.inf)
        more: dict[str, Any] = {"max_step": longest, "rtol": tolerance,
                                "atol": tolerance * units.unknowns}
        if "jac" in signature(made).parameters:  # of implicit ones
            more["jac"] = Differences(fun, units.unknowns)
        order = INTEGRATORS[name].order
        if order:
            span = min(t_end - t0, longest)
            more["first_step"] = min(
                first_step(fun, t0, y0, span, order, tolerance, units), first)
            return made(fun, t0, y0, t_end, **more)
        if math.isfinite(first):
            more["first_step"] = first
        # LSODA does not see NaN, but shortens its step for HUGE
        return made(lambda t, y: np.nan_to_num(fun(t, y), nan=HUGE), t0, y0, t_end, **more)
    return make


def _in_kernel(name: str) -> Callable[..., Any]:
    def make(
        fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
        longest: float = math.inf, first: float = math.inf,
    ) -> RungeKutta:
        tolerance, span = max(accuracy.time_tolerance, FINEST), t_end - t0
        longest = min(longest, accuracy.step or math.inf)
        order, is_fixed = INTEGRATORS[name].order, INTEGRATORS[name].is_fixed
        step = float(_count(name, span, longest)) if is_fixed else min(
            first_step(fun, t0, y0, min(span, longest), order, tolerance, units), first)
        return RungeKutta(name, fun, t0, y0, t_end, step, longest, tolerance,
                          tolerance * units.unknowns)
    return make


def _count(name: str, span: float, step: float) -> int:
    """Return how many fixed steps there are in a span of time.

    Raises:
        ValueError: the accuracy gives no step.
    """
    if not math.isfinite(step):
        raise ValueError(f"integrator {name!r} needs a step: Accuracy(step=...)")
    return max(1, int(np.ceil(span / step * (1 - 1e-12))))


def successor(solver: Any, units: Array, easy: int) -> tuple[str, int]:
    """Return the method that is to go on in the place of "automatic", and new easy steps.

    Args:
        solver: the one that has taken a step.
        units: (n,) of the unknowns.
        easy: steps in a row of an implicit method that could have been an explicit one's.
    """
    if isinstance(solver, RungeKutta):
        return (IMPLICIT if solver.creeps else EXPLICIT), 0
    rates = np.linalg.eigvals(solver.J * units / units[:, None])
    is_easy = (solver.t - solver.t_old) * float(np.abs(rates).max(initial=0.0)) < SLOW
    easy = easy + 1 if is_easy else 0
    return (EXPLICIT, 0) if easy >= LONG else (IMPLICIT, easy)


AUTOMATIC, EXPLICIT, IMPLICIT = "automatic", "DOP853", "Radau"


def stepper(name: str) -> Callable[..., Any]:
    """Return what makes an integrator, see the module's docstring."""
    name = EXPLICIT if name == AUTOMATIC else name
    return _in_kernel(name) if INTEGRATORS[name].solver == KERNEL else _like_scipy(name)
