"""Integrators of ordinary differential equations.

To add one, add an entry to STEPPERS: a function (fun, t0, y0, t_end, settings, units, longest) to
an object that steps like those of SciPy: `step()`, `t`, `t_old`, `y`, `status` ("running",
"finished" or "failed") and `dense_output()`, a function of the time, or of times (N,), over the
last step that returns unknowns (n,) or (n, N). `units` say what counts as one of every unknown,
`longest` is the longest step [s]. An explicit one has `creeps`: whether it is not errors but its
stability that has kept its steps short for a while, as a stiff motion does.

1. SciPy's adaptive methods: DOP853 and RK45 (explicit), Radau and BDF (stiff), LSODA (either).
2. "RK4": the classical method, fixed step.
   "automatic": DOP853, and Radau as long as that would creep.
3. "Gauss": two-stage Gauss, fourth order, implicit, symmetric: a reversible motion keeps its
   energy for ever to the order of the step [HairerLubichWanner2006, II.1].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from spatial_pin.dynamics.simulation.scales import Units
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

Function = Callable[[float, Array], Array]

MOST_ITERATIONS = 60
FINEST = 100.0 * float(np.finfo(float).eps)  # tolerance that SciPy's methods can keep
STABLE = {"DOP853": 6.1, "RK45": 3.25, "RK4": 2.78}  # steps by the fastest decay, at most
LONG = 15  # steps at that bound, by a few beyond it, that tell a stiff motion [HairerWanner1996]
FEW = 2  # the same of a fixed step, which is soon far away
SHORT = 6  # steps well within it that tell that it is none
SELDOM = 5  # steps from one look at a motion that is not stiff so far to the next
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


class Stiffness:
    """Counts steps whose length is bounded by stability [HairerWanner1996, IV.2].

    Two stages at one time that differ tell how fast a motion decays: |f1 - f2| / |y1 - y2|.

    Args:
        bound: longest stable step, by the fastest decay.
        units: (n,) of the unknowns.
        patience: steps beyond that before the motion is called stiff.

    Attributes:
        found: whether the motion is stiff for an explicit method.
    """

    def __init__(self, bound: float, units: Array, patience: int = LONG) -> None:
        self._bound, self._units, self._patience = bound, units, patience
        self.found = False
        self._long = self._short = self._steps = 0

    @property
    def is_due(self) -> bool:
        """Whether the next step should be looked at: each, once one was too long."""
        self._steps += 1
        return self._long > 0 or self._steps % SELDOM == 0

    def look(self, step: float, rates: Array, places: Array) -> None:
        """Take note of a step, and of differences (n,) of rates and places of two stages."""
        far = float(np.linalg.norm(places / self._units))
        fast = step * float(np.linalg.norm(rates / self._units))
        if fast > self._bound * far > 0.0:
            self._long, self._short = self._long + 1, 0
            self.found = self.found or self._long >= self._patience
        else:
            self._short += 1
            self._long = 0 if self._short >= SHORT else self._long


class RK4(_Fixed):
    """The classical Runge-Kutta method."""

    _stiffness: Stiffness | None = None

    @property
    def creeps(self) -> bool:
        """Whether its steps are too long to be stable."""
        return self._stiffness is not None and self._stiffness.found

    def _advance(self, t: float, y: Array, f: Array, h: float) -> Array:
        k2 = self.fun(t + 0.5 * h, y + 0.5 * h * f)
        k3 = self.fun(t + 0.5 * h, y + 0.5 * h * k2)
        self._stiffness = self._stiffness or Stiffness(STABLE["RK4"], self.units, FEW)
        self._stiffness.look(h, k3 - k2, 0.5 * h * (k2 - f))
        k4 = self.fun(t + h, y + h * k3)
        self.nfev += 3
        return y + h / 6.0 * (f + 2.0 * k2 + 2.0 * k3 + k4)


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
        if name not in ("DOP853", "RK45"):
            more["jac"] = Differences(fun, units.unknowns)
        if name in ORDERS:
            more["first_step"] = first_step(fun, t0, y0, min(t_end - t0, longest), ORDERS[name],
                                            tolerance, units)
        else:
            fun = _finite(fun)
        return getattr(integrate, name)(fun, t0, y0, t_end, **more)
    return make


class Watched:
    """An explicit method of SciPy that knows when it creeps, or what goes on instead of it.

    Args:
        make: makes a method by its name, at a time and place.
        name: "DOP853" or "RK45".
        units: (n,) of the unknowns.
        instead: the method that takes over where the first creeps, if any.

    Attributes:
        used: names of the methods that have taken steps.
    """

    def __init__(
        self, make: Callable[..., Any], name: str, units: Array, instead: str | None = None
    ) -> None:
        self._make, self._name, self._units, self._instead = make, name, units, instead
        self._inner, self._now = make(name), name
        self._longest = self._inner.max_step
        self.used: list[str] = []
        self._count()

    def _count(self) -> None:
        self._stiffness, self._easy = Stiffness(STABLE[self._name], self._units), 0

    @property
    def creeps(self) -> bool:
        """Whether stability bounds its steps."""
        return self._stiffness.found

    def step(self) -> None:
        """Take one step, with the other method if this one has been the wrong one for a while."""
        if self._instead and self.creeps and self._now == self._name:
            self._go_on_with(self._instead)
        elif self._easy >= LONG:
            self._go_on_with(self._name)
        self._inner.step()
        if self._inner.status == "failed":
            return
        if self._now not in self.used:
            self.used.append(self._now)
        if self._now == self._name:
            if self._stiffness.is_due:
                self._look()
        else:
            self._easy = self._easy + 1 if self._is_easy() else 0

    def _go_on_with(self, name: str) -> None:
        longest = self._inner.max_step
        self._inner, self._now = self._make(name, self.t, self.y), name
        self._inner.max_step = longest
        self._count()

    def _look(self) -> None:
        """Compare the last stage of the step with its end, which are at the same time."""
        inner, last = self._inner, self._inner.n_stages - 1
        h, k = inner.t - inner.t_old, inner.K
        weights = inner.B - np.append(inner.A[last, :last], 0.0)
        self._stiffness.look(h, k[last + 1] - k[last], h * (weights @ k[: last + 1]))

    def _is_easy(self) -> bool:
        """Whether the step of the implicit method could have been an explicit one's."""
        inner, units = self._inner, self._units
        rates = np.linalg.eigvals(inner.J * units / units[:, None])
        fastest = float(np.abs(rates).max(initial=0.0))
        return (inner.t - inner.t_old) * fastest < SLOW

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


def _watched(name: str, instead: str | None = None) -> Callable[..., Any]:
    def make(
        fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
        longest: float = math.inf,
    ) -> Any:
        def at(method: str, t: float = t0, y: Array = y0) -> Any:
            return _scipy(method)(fun, t, y, t_end, accuracy, units, longest)
        return Watched(at, name, units.unknowns, instead)
    return make


def _fixed(method: type[_Fixed]) -> Callable[..., Any]:
    def make(
        fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy, units: Units,
        longest: float = math.inf,
    ) -> Any:
        if accuracy.step is None:
            raise ValueError(f"integrator {method.__name__!r} needs a step: Accuracy(step=...)")
        return method(fun, t0, y0, t_end, min(longest, accuracy.step), units.unknowns)
    return make


AUTOMATIC = "automatic"
FIXED = ("RK4", "Gauss")  # those that keep to the step given

STEPPERS: dict[str, Callable[..., Any]] = {
    AUTOMATIC: _watched("DOP853", "Radau"),
    **{name: _watched(name) for name in ("DOP853", "RK45")},
    **{name: _scipy(name) for name in ("Radau", "BDF", "LSODA")},
    "RK4": _fixed(RK4),
    "Gauss": _fixed(Gauss),
}
