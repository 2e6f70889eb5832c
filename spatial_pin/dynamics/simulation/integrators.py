"""Integrators of ordinary differential equations.

To add one, add an entry to STEPPERS: a function (fun, t0, y0, t_end, settings, units, longest) to
an object that steps like those of SciPy: `step()`, `t`, `t_old`, `y`, `status` ("running",
"finished" or "failed") and `dense_output()`, a function of the time, or of times (N,), over the
last step that returns unknowns (n,) or (n, N). `units` say what counts as one of every unknown,
`longest` is the longest step [s]. An explicit one has `creeps`: whether it is not errors but its
stability that has kept its steps short for a while, as a stiff motion does.

1. "DOP853" and "RK45" (explicit, adaptive) and "RK4" (the classical method, fixed step) are the
   kernel's; "automatic": DOP853, and Radau as long as that would creep.
2. SciPy's "Radau" and "BDF" (stiff), "LSODA" (either).
3. "Gauss": two-stage Gauss, fourth order, implicit, symmetric: a reversible motion keeps its
   energy for ever to the order of the step [HairerLubichWanner2006, II.1].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from spatial_pin.dynamics.simulation.scales import Units
from spatial_pin.kernel.integrating import Explicit
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

Function = Callable[[float, Array], Array]

MOST_ITERATIONS = 60
FINEST = 100.0 * float(np.finfo(float).eps)  # tolerance that SciPy's methods can keep
LONG = 15  # steps of an implicit method that an explicit one would take too
SLOW = 1.0  # step, by the fastest decay, at which an explicit method would do
DIFFERENCE = 1e-7  # step of the differences for implicit methods, by the units of unknowns
HUGE = 1e100  # rate that stands for none, where loops cannot be closed
ROOT3 = np.sqrt(3.0)
GAUSS_A = np.array([[0.25, 0.25 - ROOT3 / 6], [0.25 + ROOT3 / 6, 0.25]])
GAUSS_C = np.array([0.5 - ROOT3 / 6, 0.5 + ROOT3 / 6])


class _Fixed:
    """A method of fixed step; the last step is cut to end on time."""

    def __init__(
        self, fun: Function, t0: float, y0: Array, t_end: float, step: float, units: Array
    ) -> None:
        self.fun, self.t, self.y, self.t_end = fun, t0, np.array(y0), t_end
        self.units = units
        count = max(1, int(np.ceil((t_end - t0) / step * (1 - 1e-12))))
        self.h, self.left = (t_end - t0) / count, count
        self.t_begin, self.done = t0, 0
        self.t_old: float | None = None
        self.status = "running"
        self.f = fun(t0, self.y)
        self.nfev = 1

    def step(self) -> None:
        """Take one step."""
        self._before = self.t, self.y, self.f
        y = self._advance(self.t, self.y, self.f, self.h)
        self.done += 1
        self.t_old = self.t
        self.t = self.t_begin + self.done * self.h if self.done < self.left else self.t_end
        self.y = y
        self.f = self.fun(self.t, y)
        self.nfev += 1
        if not np.all(np.isfinite(self.f)):
            self.status = "failed"
        elif self.done >= self.left:
            self.status = "finished"

    def _advance(self, t: float, y: Array, f: Array, h: float) -> Array:
        raise NotImplementedError

    def dense_output(self) -> Callable[[Any], Array]:
        """Return the cubic Hermite interpolant of the last step."""
        (t, y, f), h = self._before, self.t - self._before[0]
        moved, first, last = self.y - y, h * f, h * self.f
        second, third = 3.0 * moved - 2.0 * first - last, first + last - 2.0 * moved

        def at(times: Any) -> Array:
            x = np.expand_dims((np.asarray(times) - t) / h, -1)
            found: Array = (y + x * (first + x * (second + x * third))).T
            return found

        return at


class Gauss(_Fixed):
    """Two-stage Gauss method, solved by fixed-point iteration to round-off."""

    _k: Array | None = None  # slopes of the last step, to begin the iteration with

    def _advance(self, t: float, y: Array, f: Array, h: float) -> Array:
        k = np.stack([f, f]) if self._k is None else self._k
        last = np.inf
        for _ in range(MOST_ITERATIONS):
            stages = y + h * (GAUSS_A @ k)
            new = np.stack([self.fun(t + c * h, stage)
                            for c, stage in zip(GAUSS_C, stages, strict=True)])
            self.nfev += 2
            change = float((np.abs(new - k) / self.units).max()) * h
            k = new
            if not np.isfinite(change) or (change >= last and change < 1e-10) or change == 0.0:
                break
            last = change
        self._k = k
        return y + 0.5 * h * (k[0] + k[1])


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
        steps = DIFFERENCE * np.maximum(self._units, np.abs(y)) * np.isfinite(f).all()
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
    trial = 1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1
    trial = min(trial, span / units.time)
    f1 = fun(t0 + trial * units.time, y0 + trial * units.time * f0)
    d2 = units.time * norm(f1 - f0) / trial
    fastest = max(d1, d2)
    step = max(1e-6, 1e-3 * trial) if fastest <= 1e-15 else (0.01 / fastest) ** (1.0 / (order + 1))
    if not math.isfinite(d2):
        step = 0.01 * trial
    return min(units.time * min(100.0 * trial, step), span)


def _finite(fun: Function) -> Function:
    """Return a function without NaN: LSODA does not see them, but shortens its step for HUGE."""
    return lambda t, y: np.nan_to_num(fun(t, y), nan=HUGE)


ORDERS = {"DOP853": 7, "RK45": 4, "Radau": 3, "BDF": 1}  # of SciPy's error estimates


def _scipy(name: str) -> Callable[..., Any]:
    def make(
        fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
        longest: float = math.inf,
    ) -> Any:
        from scipy import integrate  # imported on use: it takes half a second

        tolerance = max(accuracy.time_tolerance, FINEST)
        longest = min(longest, accuracy.step or math.inf)
        more: dict[str, Any] = {"max_step": longest, "rtol": tolerance,
                                "atol": tolerance * units.unknowns}
        more["jac"] = Differences(fun, units.unknowns)
        if name in ORDERS:
            more["first_step"] = first_step(fun, t0, y0, min(t_end - t0, longest), ORDERS[name],
                                            tolerance, units)
        else:
            fun = _finite(fun)
        return getattr(integrate, name)(fun, t0, y0, t_end, **more)
    return make


def _explicit(name: str) -> Callable[..., Any]:
    def make(
        fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
        longest: float = math.inf,
    ) -> Explicit:
        tolerance, span = max(accuracy.time_tolerance, FINEST), t_end - t0
        longest = min(longest, accuracy.step or math.inf)
        if name in FIXED:
            step = float(_count(name, span, longest))
        else:
            step = first_step(fun, t0, y0, min(span, longest), ORDERS[name], tolerance, units)
        return Explicit(name, fun, t0, y0, t_end, step, longest, tolerance,
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


class Automatic:
    """DOP853, and Radau as long as that would creep.

    Args:
        make: makes a method by its name, at a time and place.
        units: (n,) of the unknowns.

    Attributes:
        used: names of the methods that have taken steps.
    """

    def __init__(self, make: Callable[..., Any], units: Array) -> None:
        self._make, self._units, self._easy = make, units, 0
        self._inner = make(EXPLICIT)
        self.used: list[str] = []

    @property
    def in_kernel(self) -> Explicit | None:
        """The method of the kernel that is next to take steps, if it is one."""
        inner = self._inner
        if not isinstance(inner, Explicit) or inner.creeps:
            return None
        self._note(EXPLICIT)
        return inner

    def step(self) -> None:
        """Take one step, with the other method if this one has been the wrong one for a while."""
        if isinstance(self._inner, Explicit):
            if self._inner.creeps:
                self._go_on_with(IMPLICIT)
        elif self._easy >= LONG:
            self._go_on_with(EXPLICIT)
        self._inner.step()
        if self._inner.status == "failed":
            return
        is_explicit = isinstance(self._inner, Explicit)
        self._note(EXPLICIT if is_explicit else IMPLICIT)
        self._easy = 0 if is_explicit or not self._is_easy() else self._easy + 1

    def _note(self, name: str) -> None:
        if name not in self.used:
            self.used.append(name)

    def _go_on_with(self, name: str) -> None:
        longest = self._inner.max_step
        self._inner, self._easy = self._make(name, self.t, self.y), 0
        self._inner.max_step = longest

    def _is_easy(self) -> bool:
        """Whether the step of the implicit method could have been an explicit one's."""
        inner, units = self._inner, self._units
        rates = np.linalg.eigvals(inner.J * units / units[:, None])
        fastest = float(np.abs(rates).max(initial=0.0))
        return bool((inner.t - inner.t_old) * fastest < SLOW)

    def dense_output(self) -> Callable[[Any], Array]:
        """Return what interpolates the last step."""
        found: Callable[[Any], Array] = self._inner.dense_output()
        return found

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_inner"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in ("y", "f", "max_step"):
            setattr(self._inner, name, value)
        else:
            object.__setattr__(self, name, value)


def _automatic(
    fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
    longest: float = math.inf,
) -> Automatic:
    def at(method: str, t: float = t0, y: Array = y0) -> Any:
        return STEPPERS[method](fun, t, y, t_end, accuracy, units, longest)
    return Automatic(at, units.unknowns)


def _fixed(method: type[_Fixed]) -> Callable[..., Any]:
    def make(
        fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
        longest: float = math.inf,
    ) -> Any:
        if accuracy.step is None:
            raise ValueError(f"integrator {method.__name__!r} needs a step: Accuracy(step=...)")
        return method(fun, t0, y0, t_end, min(longest, accuracy.step), units.unknowns)
    return make


AUTOMATIC, EXPLICIT, IMPLICIT = "automatic", "DOP853", "Radau"
FIXED = ("RK4", "Gauss")  # those that keep to the step given

STEPPERS: dict[str, Callable[..., Any]] = {
    AUTOMATIC: _automatic,
    **{name: _explicit(name) for name in ("DOP853", "RK45", "RK4")},
    **{name: _scipy(name) for name in ("Radau", "BDF", "LSODA")},
    "Gauss": _fixed(Gauss),
}
