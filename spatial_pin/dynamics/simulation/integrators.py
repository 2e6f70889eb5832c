"""Integrators of ordinary differential equations, made of entries of `settings.INTEGRATORS`.

`Stepping.begin` returns an object that steps like those of SciPy: `step()`, `t`, `t_old`, `y`,
`status` ("running", "finished" or "failed") and `dense_output()`, a function of the time, or of
times (N,), over the last step that returns unknowns (n,) or (n, N).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module
from inspect import signature
from typing import Any

import numpy as np

from spatial_pin.dynamics.simulation.formulations import IndependentFormulation
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.errors import SpatialPinError, StepLimitError, warn
from spatial_pin.kernel.integrating import RungeKutta
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, KERNEL, Accuracy

Function = Callable[[float, Array], Array]

FINEST = 100.0 * float(np.finfo(float).eps)  # smallest tolerance of SciPy's methods
LONG = 15  # an explicit method continues after this many steps in a row that it could have taken
SLOW = 1.0  # step times fastest decay rate up to which an explicit method is stable
SLOPE_STEP = 1e-7  # step of differences for implicit methods, relative to the unknowns' units
HUGE = 1e100  # rate in place of a missing one, where loops cannot be closed: the step is refused
FASTEST = 1e100  # largest rate: its square divided by a tolerance is finite when squared
SLOWEST = 1e3  # longest natural time in durations: a slower motion does not matter
AUTOMATIC, IMPLICIT = "automatic", "Radau"
EXPLICIT, EXPLICIT_LOOSE = "DOP853", "RK45"  # of "automatic", which takes the second one
LOOSE_TOLERANCE = 3e-8  # of steps: from here on fifth order is as exact, and faster
NEAR = 1e-3  # pivot, and step, relative to the largest so far, below which the motion stagnates
TRIED = 1000  # every this many steps without damping, the progress is compared with the duration
# The simulation is refused if this many times the allowed steps would not reach the end.
HOPELESS = 10.0
CREEPING = 60  # such steps in a row that show a singular configuration just ahead
# A step is too short if all allowed steps of its length make less than this part of the longest
# step.
NOWHERE = 1e-2
STANDING = 200  # such steps in a row that show stagnation: stiff motions soon take longer ones


def natural_units(
    system: IndependentFormulation, t: float, y: Array, duration: float
) -> tuple[float, Array]:
    """Return the natural time T [s] and units (n,) of the unknowns of a motion at y (n,).

    A mechanism that moves a million times faster moves on the same curve. Its error control should
    see the same numbers, so rates are counted per natural time T, and work by the energy of its
    heaviest coordinate at that rate. 1/T is the largest of

        rates,  square roots of accelerations,  sqrt(gravity / characteristic length)

    at the start of the integration (all in radians or characteristic lengths), divided by 2 pi: T
    is about the period of a pendulum, or of a turn. Where nothing moves or pulls, T is many
    durations.

    Returns:
        T, and the unit of every unknown: 1 of coordinates and quaternions, 1/T of rates,
        and an energy of work.

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
    rate = max(pace / (2.0 * math.pi), 1.0 / (SLOWEST * duration))
    units = np.ones(len(y))
    units[n : 2 * n] = rate
    if problem.works:
        units[-1] = system.kernel.heaviest(t, y) * rate * rate or 1.0
    return 1.0 / rate, units


class DifferenceJacobian:
    """The Jacobian d fun/dy by differences of well-scaled steps, always finite.

    Those of SciPy grow without bound where nothing depends on an unknown, and those of LSODA
    vanish at rest. Where loops cannot be closed on one side the other is taken, and where they
    cannot be closed at all the last result: the integrator then shortens its step.
    """

    def __init__(self, fun: Function, units: Array) -> None:
        self._fun, self._units = fun, units
        self._last = np.zeros((len(units), len(units)))

    def __call__(self, t: float, y: Array) -> Array:
        """Return the (n, n) Jacobian at t, y."""
        f, slopes = self._fun(t, y), self._last.copy()
        steps = SLOPE_STEP * np.maximum(self._units, np.abs(y)) * np.isfinite(f).all()
        for j, h in enumerate(steps.tolist()):
            for step in (h, -h) if h else ():
                moved = y.copy()
                moved[j] += step
                column = (self._fun(t, moved) - f) / (moved[j] - y[j])
                if np.isfinite(column).all():
                    slopes[:, j] = column
                    break
        self._last = slopes
        return slopes.copy()


def first_step(
    fun: Function, t0: float, y0: Array, span: float, order: int, tolerance: float,
    units: tuple[float, Array],
) -> float:
    """Return a first step [s], the same whatever the unit of time [HairerNorsettWanner1993, II.4].

    SciPy's own begins with a microsecond where a motion starts from rest, be it an age.
    """
    unit, of_unknowns = units
    f0, size = fun(t0, y0), tolerance * (of_unknowns + np.abs(y0))

    def norm(x: Array) -> float:
        return float(np.linalg.norm(x / size)) / math.sqrt(len(x))

    d0, d1 = norm(y0), unit * norm(f0)
    trial = 0.01 * d0 / d1 if d0 >= 1e-5 <= d1 < math.inf else 1e-6
    trial = min(trial, span / unit)
    f1 = fun(t0 + trial * unit, y0 + trial * unit * f0)
    d2 = unit * norm(f1 - f0) / trial
    fastest = max(d1, d2)
    step = max(1e-6, 1e-3 * trial) if fastest <= 1e-15 else (0.01 / fastest) ** (1.0 / (order + 1))
    if not math.isfinite(d2):
        step = 0.01 * trial
    return min(unit * min(100.0 * trial, step), span)


class Stagnation:
    """Detects that steps only creep on, and where.

    Attributes:
        largest: (2,) pivot of the equations and step [s], the largest so far.
    """

    def __init__(self, most_steps: int) -> None:
        self.largest: Array = np.zeros(2)
        self._most_steps, self._creeping, self._standing = most_steps, 0, 0

    def note_kernel_steps(self, steps: int, largest: Array) -> None:
        """Record steps in the kernel, which checks their lengths itself."""
        if steps > 1:
            self._creeping = self._standing = 0
        self.largest = largest

    def creeps(self, pivot: float, step: float) -> bool:
        """Whether steps shorten towards a singular configuration, or are too short to end."""
        sizes = np.array([pivot, step])
        self.largest = np.maximum(self.largest, sizes)
        creeps = bool(np.all(sizes < NEAR * self.largest))
        self._creeping = self._creeping + 1 if creeps else 0
        stands = step * self._most_steps < NOWHERE * self.largest[1]
        self._standing = self._standing + 1 if stands else 0
        return self._creeping > CREEPING or self._standing > STANDING

    def is_short(self, time: float) -> bool:
        """Whether a time [s] is negligible relative to the longest step so far."""
        return bool(time <= NEAR**2 * self.largest[1])


class Stepping:
    """The integrator in use: the one given, or by turns an explicit and an implicit one.

    It also checks the number of the steps.

    Attributes:
        used: names of the integrators that have taken steps.
    """

    def __init__(self, problem: Problem, accuracy: Accuracy, end: float) -> None:
        self._problem, self._accuracy, self._end = problem, accuracy, end
        self._chosen, self._method = accuracy.integrator, ""
        self._easy, self._has_warned = 0, False
        self.used: list[str] = []

    def begin(
        self, system: IndependentFormulation, t: float, y: Array, longest: float = np.inf,
        only_first: bool = False,
    ) -> Any:
        """Return an integrator that starts at unknowns y, its error norm in natural units.

        `longest` bounds its steps [s], or with `only_first` the first one.
        """
        self._units = natural_units(system, t, y, self._end - t)
        method = self._explicit(system) if self._chosen == AUTOMATIC else self._chosen
        first, longest = (longest, np.inf) if only_first else (np.inf, longest)
        return self._made(method, system, t, y, longest, first)

    def _explicit(self, system: IndependentFormulation) -> str:
        """Return the explicit method of "automatic".

        Of several freedoms it has many stages: where they cannot be closed, a step has led across a
        singular configuration. The curve of one freedom tells that by itself.
        """
        is_loose = self._accuracy.time_tolerance >= LOOSE_TOLERANCE
        return EXPLICIT_LOOSE if is_loose and len(system.free) == 1 else EXPLICIT

    def next_integrator(
        self, system: IndependentFormulation, t: float, y: Array, solver: Any
    ) -> Any:
        """Return the integrator of the next steps: another one if stiffness has changed.

        An implicit one goes on until an explicit one could have taken its last steps.
        """
        if self._chosen != AUTOMATIC:
            return solver
        if isinstance(solver, RungeKutta):
            method, self._easy = (
                IMPLICIT if solver.creeps else self._explicit(system)), 0
        else:
            units = self._units[1]
            rates = np.linalg.eigvals(solver.J * units / units[:, None])
            fastest = float(np.abs(rates).max(initial=0.0))
            is_easy = (solver.t - solver.t_old) * fastest < SLOW
            self._easy = self._easy + 1 if is_easy else 0
            method = self._explicit(system) if self._easy >= LONG else IMPLICIT
        if method == self._method:
            return solver
        return self._made(method, system, t, y, solver.max_step)

    def note_integrator(self, system: IndependentFormulation, solver: Any) -> None:
        """Record the integrator in use; warn once of an explicit one in a stiff motion."""
        if self._method not in self.used:
            self.used.append(self._method)
        is_chosen = self._chosen != AUTOMATIC
        if self._has_warned or not is_chosen or not getattr(solver, "creeps", False):
            return
        self._has_warned = True
        problem, cause = self._problem, "a spring or damper"
        resistance = problem.forces.resistance
        if resistance:
            slopes = resistance.slopes(system.motion_at(solver.t, solver.y)[1]) * problem.scale**2
            at = int(slopes.argmax())
            damped = resistance.damping[at] * problem.scale[at] ** 2 > 0.5 * slopes[at]
            name = problem.mechanism.coordinates[at]
            cause = f"the {'damping' if damped else 'dry friction'} of {name!r}"
        warn(
            f"mechanism {problem.mechanism.name!r}: from {solver.t:.6g} s on the explicit "
            f"integrator {self._chosen!r} is no good, for steps of {solver.t - solver.t_old:.1e} s "
            f"are as long as it is stable with: {cause} is stiff. Leave the "
            "integrator out, or take Accuracy(integrator=\"Radau\")")

    def _made(
        self, method: str, system: IndependentFormulation, t: float, y: Array, longest: float,
        first: float = np.inf,
    ) -> Any:
        """Return an integrator, see the module's docstring.

        Raises:
            ValueError: it takes fixed steps, and the accuracy gives none.
        """
        self._method, self._easy = method, 0
        own, accuracy, external = INTEGRATORS[method], self._accuracy, self._problem.external
        if external and not own.is_fixed:
            longest = min(longest, external.longest_step)
        tolerance = max(accuracy.time_tolerance, FINEST)
        absolute, span = tolerance * self._units[1], self._end - t
        longest = min(longest, accuracy.step or math.inf)
        if not own.is_fixed and own.order:
            first = min(first, first_step(
                system, t, y, min(span, longest), own.order, tolerance, self._units))
        if own.solver == KERNEL:
            if own.is_fixed:
                if not math.isfinite(longest):
                    raise ValueError(f"integrator {method!r} needs a step: Accuracy(step=...)")
                first = float(max(1, int(np.ceil(span / longest * (1 - 1e-12)))))  # their number
            return RungeKutta(
                method, system, t, y, self._end, first, longest, tolerance, absolute)
        module, _, kind = own.solver.partition(":")
        made = getattr(import_module(module), kind)  # on use: SciPy's take half a second
        more: dict[str, Any] = {"max_step": longest, "rtol": tolerance, "atol": absolute}
        if "jac" in signature(made).parameters:  # of implicit ones
            more["jac"] = DifferenceJacobian(system, self._units[1])
        if own.order or math.isfinite(first):
            more["first_step"] = first
        if own.order:
            return made(system, t, y, self._end, **more)
        # LSODA does not see NaN, but shortens its step for HUGE
        return made(lambda t, y: np.nan_to_num(system(t, y), nan=HUGE), t, y, self._end, **more)

    def steps_at_once(self, steps: int) -> int:
        """Return the number of steps before the next check of the limit."""
        return min(TRIED - steps % TRIED, max(self._accuracy.most_steps - steps, 1))

    def check_step_limit(self, t: float, steps: int, solver: Any) -> None:
        """Refuse more steps than are allowed; early, if far more would be needed.

        The number of fixed steps is checked before the start.

        Raises:
            StepLimitError: there would be more.
        """
        most = self._accuracy.most_steps
        if solver.status != "running" or INTEGRATORS[self._accuracy.integrator].is_fixed:
            return
        is_hopeless = (self._problem.is_steady and not self._problem.is_damped
                       and steps % TRIED == 0 and t * HOPELESS * most < self._end * steps)
        if steps < most and not is_hopeless:
            return
        raise StepLimitError(
            f"mechanism {self._problem.mechanism.name!r}: {steps} steps have led to "
            f"{t:.6g} s of {self._end:.6g} s, the last of {solver.t - solver.t_old:.2g} s: "
            "take a shorter duration, a larger time_tolerance, integrator='Radau' where strong "
            f"springs or dampers make steps short, or Accuracy(most_steps={10 * most})")
