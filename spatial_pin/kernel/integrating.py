"""Integrators of the kernel: of a mechanism in the kernel, or of a function of Python."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.kernel.library import INT, POINTER, REAL, address, check, library
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, KERNEL

# in the order of METHODS in integrating.c
METHODS = tuple(name for name, x in INTEGRATORS.items() if x.solver == KERNEL)
STATUS = ("running", "finished", "failed")
RATES = ctypes.CFUNCTYPE(ctypes.c_int, POINTER, REAL, POINTER, POINTER)
LOST, CALLBACK_FAILED = 20, 21  # as in simulating/dynamics.h
MOST_CROSSINGS = 64  # branch points in one step
ROOM = 30  # numbers for each unknown: MOST_STAGES + 14, see integrating.h


class _IntegratorStruct(ctypes.Structure):
    """Integrator in integrating.h."""

    _fields_ = [
        ("n", INT), ("method", INT), ("status", INT), ("code", INT), ("t", REAL), ("t_old", REAL),
        ("t_end", REAL), ("t_begin", REAL), ("next", REAL), ("longest", REAL), ("rtol", REAL),
        ("count", INT), ("done", INT), ("steps", INT), ("evaluations", INT), ("many_long", INT),
        ("many_short", INT), ("is_stiff", INT), ("is_dense", INT), *((name, POINTER) for name in (
            "y", "y_old", "f", "atol", "slope", "trial", "ended", "dense")), ("rates", RATES),
        ("context", POINTER)]


AT_END, AT_FAILURE, NEW_COORDINATES, FULL, STIFF, CREEPING, MANY = range(7)  # why it paused
NO_SAMPLES = 9  # the same, see Pause in running.c


class SimulationSamples(NamedTuple):
    """N samples of a simulation.

    Attributes:
        q, v, a: (N, nq), (N, nv), (N, nv).
        numbers: (N, 4) closure error [-], kinetic and total energy [J], work [J].
        efforts: (N, n) of prescribed drivers [N·m, N].
        angles: (N, n_angles) of screw closures [rad].
    """

    q: Array
    v: Array
    a: Array
    numbers: Array
    efforts: Array
    angles: Array


class SampleStruct(ctypes.Structure):
    """SampleRows in dynamics.h."""

    _fields_ = [(name, POINTER) for name in (*SimulationSamples._fields, "heaviest")]


class RunStruct(ctypes.Structure):
    """Run in running.h: settings of many steps, and the storage of their samples."""

    _fields_ = [("times", POINTER), ("n_times", INT), ("row", INT), ("rows", SampleStruct),
                ("most", INT), ("patience", REAL), ("largest_step", REAL),
                ("largest_pivot", REAL), ("allowed", REAL), ("n_crossed", INT),
                ("crossed", REAL * MOST_CROSSINGS), ("crossed_row", INT * MOST_CROSSINGS),
                ("looks", INT), ("n_limits", INT), ("limit_q", POINTER), ("limit_v", POINTER),
                ("limit_side", POINTER), ("limit_value", POINTER), ("limit_before", POINTER),
                ("between", REAL)]


class CallbackErrors:
    """Errors of Python functions that the kernel calls; raised when the kernel returns."""

    def __init__(self) -> None:
        self.error: BaseException | None = None

    def caught(self, function: Callable[..., int]) -> Callable[..., int]:
        """Return a function that stores its error and returns the kernel's code."""
        def call(*args: Any) -> int:
            try:
                return function(*args)
            except BaseException as error:  # raised anew by `checked`
                self.error = error
                return CALLBACK_FAILED
        return call

    def checked(self, code: int) -> int:
        """Return a code of the kernel; raise what a function has raised."""
        if self.error is not None:
            error, self.error = self.error, None
            raise error
        return code


def view(pointer: int | None, n: int) -> Array:
    """Return n doubles at an address, without a copy."""
    if not n or pointer is None:
        return np.empty(0)
    block: Any = (ctypes.c_double * n).from_address(pointer)
    return np.frombuffer(block)


_ONE_STEP = RunStruct(most=1)


class RungeKutta:
    """A Runge-Kutta method, with what SciPy's solvers have.

    Args:
        method: one of METHODS.
        fun: dy/dt of (t, y); in the kernel where it has a `kernel_handle`.
        t0: where it begins.
        y0: (n,) unknowns there.
        t_end: where it ends.
        step: first step; of RK4 and Gauss the number of steps.
        longest: longest step.
        rtol: relative tolerance.
        atol: (n,) absolute ones.
    """

    def __init__(
        self, method: str, fun: Any, t0: float, y0: Array, t_end: float, step: float,
        longest: float, rtol: float, atol: Array,
    ) -> None:
        self._library, self._errors, self._fun = library(), CallbackErrors(), fun
        n, rates, context = len(y0), RATES(), getattr(fun, "kernel_handle", None)
        if context is None:
            def evaluate(_: int, t: float, y: int, out: int) -> int:
                slopes = view(out, n)
                slopes[:] = fun(t, view(y, n).copy())
                return 0 if np.isfinite(slopes).all() else LOST
            rates = RATES(self._errors.caught(evaluate))
        else:
            self._errors = fun.errors
        self.n, self.method, self._rates = n, method, rates  # C calls the rates
        self._room, y0, atol = np.zeros(ROOM * n), np.array(y0, float), np.array(atol, float)
        self._c = c = _IntegratorStruct(
            n, METHODS.index(method), t=t0, t_end=t_end, next=step, longest=longest, rtol=rtol,
            rates=rates, context=context)
        self._handle = ctypes.byref(c)
        code = self._library.integrator_begin(
            self._handle, address(y0), address(atol), address(self._room), len(self._room))
        if self._errors.checked(code) != CALLBACK_FAILED:
            check(code)
        self._y, self._y_old, self._f = (view(p, n) for p in (c.y, c.y_old, c.f))

    def step(self) -> None:
        """Take one step."""
        self._run(None, _ONE_STEP)

    def run(self, run: RunStruct) -> int:
        """Take many steps of a mechanism in the kernel with their samples; why it paused."""
        return self._run(self._fun.kernel_handle, run)

    def _run(self, handle: Any, run: RunStruct) -> int:
        why = self._library.integrator_run(self._handle, handle, ctypes.byref(run))
        return self._errors.checked(why)

    def dense_output(self) -> Callable[[Any], Array]:
        """Return the interpolant of the last step, of a time or of times (N,): (n,) or (n, N)."""
        def at(times: Any) -> Array:
            given = np.ascontiguousarray(np.atleast_1d(times), float)
            values = np.empty((len(given), self.n))
            code = self._errors.checked(self._library.integrator_between(
                self._handle, address(given), len(given), address(values)))
            if code:
                values[:] = math.nan
            return values.T if np.ndim(times) else values[0]
        return at

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the rates."""
        return int(self._c.evaluations)

    status = property(lambda self: STATUS[self._c.status])
    t = property(lambda self: self._c.t)
    t_old = property(lambda self: self._c.t_old)
    rtol = property(lambda self: self._c.rtol)
    steps = property(lambda self: self._c.steps)
    creeps = property(lambda self: bool(self._c.is_stiff), doc="Whether stability bounds its steps")

    @property
    def y(self) -> Array:
        """(n,) unknowns at t."""
        return self._y.copy()

    @y.setter
    def y(self, value: Array) -> None:
        self._y[:] = value

    @property
    def y_old(self) -> Array:
        """(n,) unknowns where the last step began."""
        return self._y_old.copy()

    @property
    def f(self) -> Array:
        """(n,) their rates at t."""
        return self._f.copy()

    @f.setter
    def f(self, value: Array) -> None:
        self._f[:] = value

    @property
    def max_step(self) -> float:
        """Longest step [s]."""
        return float(self._c.longest)

    @max_step.setter
    def max_step(self, value: float) -> None:
        self._c.longest = value
