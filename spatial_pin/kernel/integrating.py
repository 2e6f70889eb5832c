"""Integrators of the kernel: of a mechanism in the kernel, or of a function of Python."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

from spatial_pin.kernel.kernel import check
from spatial_pin.kernel.library import INT, POINTER, REAL, address, library
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, KERNEL

# in the order of METHODS in integrating.c
METHODS = tuple(name for name, x in INTEGRATORS.items() if x.solver == KERNEL)
STATUS = ("running", "finished", "failed")
RATES = ctypes.CFUNCTYPE(ctypes.c_int, POINTER, REAL, POINTER, POINTER)
LOST, ASK_FAILED = 20, 21  # as in simulating/dynamics.h


class _IntegratorStruct(ctypes.Structure):
    """The first entries of Integrator in integrating.h."""

    _fields_ = [
        ("n", INT), ("method", INT), ("status", INT), ("code", INT), ("t", REAL), ("t_old", REAL),
        ("t_end", REAL), ("t_begin", REAL), ("next", REAL), ("longest", REAL), ("rtol", REAL),
        ("count", INT), ("done", INT), ("steps", INT), ("evaluations", INT), ("many_long", INT),
        ("many_short", INT), ("is_stiff", INT), ("is_dense", INT), ("y", POINTER),
        ("y_old", POINTER), ("f", POINTER)]


class Asking:
    """Functions of Python that the kernel calls; what they raise is raised when it has ended."""

    def __init__(self) -> None:
        self.error: BaseException | None = None

    def safely(self, function: Callable[..., int]) -> Callable[..., int]:
        """Return a function that keeps what is raised, and returns the kernel's code."""
        def call(*args: Any) -> int:
            try:
                return function(*args)
            except BaseException as error:  # raised anew by `settle`
                self.error = error
                return ASK_FAILED
        return call

    def settle(self, code: int) -> int:
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
        self._library, self._asking, self._fun = library(), Asking(), fun
        n, rates, context = len(y0), None, getattr(fun, "kernel_handle", None)
        if context is None:
            def evaluate(_: int, t: float, y: int, out: int) -> int:
                found = view(out, n)
                found[:] = fun(t, view(y, n).copy())
                return 0 if np.isfinite(found).all() else LOST
            rates = self._rates = RATES(self._asking.safely(evaluate))
        else:
            self._asking = fun.asking
        handle, y0, atol = ctypes.c_void_p(), np.array(y0, float), np.array(atol, float)
        code = self._library.integrator_create(
            METHODS.index(method), n, rates, context, t0, address(y0), t_end, step, longest, rtol,
            address(atol), ctypes.byref(handle))
        self._handle = handle
        weakref.finalize(self, self._library.integrator_destroy, handle)
        if self._asking.settle(code) != ASK_FAILED:
            check(code)
        self._c = _IntegratorStruct.from_address(handle.value or 0)
        self.n, self.method = n, method
        self._y, self._y_old, self._f = (view(p, n) for p in (self._c.y, self._c.y_old, self._c.f))

    def step(self) -> None:
        """Take one step."""
        self._asking.settle(self._library.integrator_step(self._handle))

    def run(self, run: Any) -> int:
        """Take many steps of a mechanism in the kernel with their samples; why it paused."""
        why = self._library.integrator_run(
            self._handle, self._fun.kernel_handle, ctypes.byref(run))
        self._asking.settle(why)
        return int(why)

    def dense_output(self) -> Callable[[Any], Array]:
        """Return the interpolant of the last step, of a time or of times (N,): (n,) or (n, N)."""
        def at(times: Any) -> Array:
            given = np.ascontiguousarray(np.atleast_1d(times), float)
            found = np.empty((len(given), self.n))
            code = self._asking.settle(self._library.integrator_between(
                self._handle, address(given), len(given), address(found)))
            if code:
                found[:] = math.nan
            return found.T if np.ndim(times) else found[0]
        return at

    @property
    def evaluations(self) -> int:
        """How often rates were asked for."""
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
