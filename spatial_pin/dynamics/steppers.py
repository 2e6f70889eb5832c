"""Integrators of ordinary differential equations.

To add one, add an entry to STEPPERS: a function (fun, t0, y0, t_end, settings) to an object that
steps like those of SciPy: `step()`, `t`, `t_old`, `y`, `status` ("running", "finished" or
"failed") and `dense_output()`, a function of the time, or of times (N,), over the last step that
returns unknowns (n,) or (n, N).

1. SciPy's adaptive methods: DOP853 and RK45 (explicit), Radau and BDF (stiff), LSODA (either).
2. "RK4": the classical method, fixed step.
3. "Gauss": two-stage Gauss, fourth order, implicit, symmetric: a reversible motion keeps its
   energy for ever to the order of the step [HairerLubichWanner2006, II.1].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spatial_pin.linalg import Array
from spatial_pin.settings import Accuracy

Function = Callable[[float, Array], Array]

MOST_ITERATIONS = 60
DIFFERENCE = 1e-7  # step of the differences for implicit methods [rad, characteristic lengths]
ROOT3 = np.sqrt(3.0)
GAUSS_A = np.array([[0.25, 0.25 - ROOT3 / 6], [0.25 + ROOT3 / 6, 0.25]])
GAUSS_C = np.array([0.5 - ROOT3 / 6, 0.5 + ROOT3 / 6])


class _Fixed:
    """A method of fixed step; the last step is cut to end on time."""

    def __init__(self, fun: Function, t0: float, y0: Array, t_end: float, step: float) -> None:
        self.fun, self.t, self.y, self.t_end = fun, t0, np.array(y0), t_end
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


class RK4(_Fixed):
    """The classical Runge-Kutta method."""

    def _advance(self, t: float, y: Array, f: Array, h: float) -> Array:
        k2 = self.fun(t + 0.5 * h, y + 0.5 * h * f)
        k3 = self.fun(t + 0.5 * h, y + 0.5 * h * k2)
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
            change = float(np.abs(new - k).max()) * h
            k = new
            if not np.isfinite(change) or (change >= last and change < 1e-10) or change == 0.0:
                break
            last = change
        self._k = k
        return y + 0.5 * h * (k[0] + k[1])


def _jacobian(fun: Function) -> Callable[[float, Array], Array]:
    """Return d fun/dy by forward differences; SciPy's own grow where nothing depends on y."""
    def jacobian(t: float, y: Array) -> Array:
        f = fun(t, y)
        steps = DIFFERENCE * np.maximum(1.0, np.abs(y))
        return np.column_stack([(fun(t, y + step) - f) / h
                                for step, h in zip(np.diag(steps), steps, strict=True)])
    return jacobian


def _scipy(name: str) -> Callable[..., Any]:
    def make(fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy) -> Any:
        from scipy import integrate  # imported on use: it takes half a second

        more: dict[str, Any] = {} if accuracy.step is None else {"max_step": accuracy.step}
        if name in ("Radau", "BDF"):
            more["jac"] = _jacobian(fun)
        return getattr(integrate, name)(fun, t0, y0, t_end, rtol=accuracy.time_tolerance,
                                        atol=accuracy.time_tolerance, **more)
    return make


def _fixed(method: type[_Fixed]) -> Callable[..., Any]:
    def make(fun: Function, t0: float, y0: Array, t_end: float, accuracy: Accuracy) -> Any:
        if accuracy.step is None:
            raise ValueError(f"integrator {method.__name__!r} needs a step: Accuracy(step=...)")
        return method(fun, t0, y0, t_end, accuracy.step)
    return make


STEPPERS: dict[str, Callable[..., Any]] = {
    **{name: _scipy(name) for name in ("DOP853", "RK45", "Radau", "BDF", "LSODA")},
    "RK4": _fixed(RK4),
    "Gauss": _fixed(Gauss),
}
