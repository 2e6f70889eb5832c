"""Rates of all joints in the kernel, see `rates.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.kernel import Kernel, numbers
from spatial_pin.kernel.library import (
    DONE,
    INT,
    NOT_FINITE,
    POINTER,
    SINGULAR,
    UNSAFE,
    address,
    check,
)
from spatial_pin.numerics.linalg import Array


class Solved(NamedTuple):
    """Rates at a configuration.

    Attributes:
        v, a: (nv,) joint velocities and accelerations.
        pivot: smallest over largest pivot of the equations.
        lost: round-off of v and a, relative to their size.
        known: what of it is known whatever the velocities are.
        is_finite: whether v and a are; else they are larger than numbers can be.
    """

    v: Array
    a: Array
    pivot: float
    lost: float
    known: float
    is_finite: bool


class Chosen(NamedTuple):
    """Equations that determine the rates where it is not clear which are independent.

    Attributes:
        rows: (r,) independent closure equations, ascending.
        fill: (k, nv) what fills the system up: unresolved passive freedoms, scaled, orthonormal.
    """

    rows: NDArray[np.integer[Any]]
    fill: Array


class _RateTask(ctypes.Structure):
    """RateTask in rates.h."""

    _fields_ = [
        ("q", POINTER), ("reference", POINTER), ("equations", POINTER), ("n_equations", INT),
        ("fill", POINTER), ("n_fill", INT), ("n_moving", INT), *((name, POINTER) for name in (
            "speed", "acceleration", "columns", "v", "a", "facts"))]


class RateSolver:
    """Solves for rates with some freedoms driven; one caller at a time.

    Kept by the kernel whose memory it works in. Results read after `factor` or `solve` are those
    of their configuration.

    Args:
        kernel: of the mechanism.
        driven: places in the velocity vector, those that stand still last; nv and that of a
            component of a ball or a floating joint.
        n_moving: how many do not.

    Attributes:
        speeds, accelerations: (n,) of driven coordinates, for `solve`.
        pivot: smallest over largest pivot of the equations, where they were last factored.
    """

    def __init__(self, kernel: Kernel, driven: Sequence[int], n_moving: int) -> None:
        self._library, handle = kernel.library, ctypes.c_void_p()
        self.n_moving, self.n_driven, self.nv = n_moving, len(driven), kernel.nv
        self._n_equations = kernel.n_closure + kernel.n_passive
        at = np.array(driven, np.int64)
        check(self._library.rates_create(
            kernel.handle, address(at), len(at), ctypes.byref(handle)))
        self._handle = handle
        self._q, self._reference = np.empty(kernel.nq), np.empty(kernel.n_angles)
        self.speeds, self.accelerations = np.zeros((2, len(at)))
        self._columns, self._v, self._a = np.empty((n_moving, self.nv)), *np.empty((2, self.nv))
        self._facts, self._local = np.zeros(3), np.empty(3)
        self._jacobian, self._at_speeds = np.empty((6, n_moving)), address(self.speeds)
        self._task = _RateTask(
            address(self._q), address(self._reference), n_moving=n_moving,
            acceleration=address(self.accelerations), columns=address(self._columns),
            v=address(self._v), a=address(self._a), facts=address(self._facts))
        self._at_task = ctypes.byref(self._task)
        self._frame = [address(x) for x in (self._local, self._jacobian)]

    def factor(self, q: Array, reference: Array, chosen: Chosen | None = None) -> bool:
        """Factor the equations at q (nq,); False where nothing determines rates there.

        Without `chosen`: where equations are not clearly independent of each other and of what is
        driven, or where there are not as many as freedoms.

        Args:
            q: closed configuration.
            reference: (n_angles,) from which the angles of screws count [rad].
            chosen: the equations, if the kernel is not to choose them.
        """
        self._task.speed = None
        return self._code(q, reference, chosen) in (DONE, NOT_FINITE)

    def solve(self, q: Array, reference: Array, chosen: Chosen | None = None) -> Solved | None:
        """Return the rates at q (nq,) for the drivers' rates in `speeds` and `accelerations`.

        None as `factor`.
        """
        self._task.speed = self._at_speeds
        code = self._code(q, reference, chosen)
        if code not in (DONE, NOT_FINITE):
            return None
        pivot, lost, known = self._facts.tolist()
        return Solved(self._v.copy(), self._a.copy(), pivot, lost, known, code == DONE)

    def _code(self, q: Array, reference: Array, chosen: Chosen | None) -> int:
        """Solve the task; return the kernel's code, which says whether rates are determined."""
        self._q[:], self._reference[:], task = q, reference, self._task
        if chosen is None:
            task.equations = None
        else:
            rows = np.ascontiguousarray(chosen.rows, np.int64)
            fill = np.ascontiguousarray(chosen.fill, float)
            task.equations, task.n_equations = address(rows), len(rows)
            task.fill, task.n_fill = address(fill), len(fill)
        code: int = self._library.rates_solve(self._handle, self._at_task)
        if code not in (DONE, UNSAFE, SINGULAR, NOT_FINITE):
            check(code)
        return code

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the equations, where they were last factored."""
        return self._facts.item(0)

    def columns(self) -> Array:
        """Return (nv, n_moving): joint velocities per unit speed of each that moves."""
        check(self._library.rates_columns(
            self._handle, self.n_moving, self._task.columns, 0, None, None))
        return self._columns.T.copy()

    def acceleration(self, v: Array, drive: Array | None = None) -> Array:
        """Return (nv,) joint accelerations at joint velocities v (nv,).

        Args:
            v: joint velocities.
            drive: (n_driven,) accelerations of driven coordinates; none by default.
        """
        v = numbers(v, (self.nv,))
        return self._answer(address(v), None, drive)

    def answer(self, derivative: Array, drive: Array | None = None) -> Array:
        """Return joint rates (nv,) of any order; driven coordinates must be velocity entries.

        Args:
            derivative: (n_closure + n_passive,) of the equations, where the rates are zero.
            drive: (n_driven,) rates of driven coordinates; none by default.
        """
        derivative = numbers(derivative, (self._n_equations,))
        return self._answer(None, address(derivative), drive)

    def _answer(self, v: int | None, derivative: int | None, drive: Array | None) -> Array:
        rates, full = np.empty(self.nv), np.zeros(self.n_driven)  # the last ones stand still
        if drive is not None:
            full[: len(drive)] = drive
        self._library.rates_answer(self._handle, v, derivative, address(full), address(rates))
        return rates

    def jacobian(self, joint: int, local: Array) -> Array:
        """Return the Jacobian (6, n_moving) of a point of a joint's body.

        Args:
            joint: of the kernel.
            local: (3,) the point in the joint's axes [m].
        """
        self._local[:] = local
        code = self._library.rates_columns(
            self._handle, self.n_moving, self._task.columns, joint, *self._frame)
        if code != NOT_FINITE:
            check(code)
        return self._jacobian.copy()


def rates_of(kernel: Kernel, driven: tuple[int, ...], n_moving: int) -> RateSolver:
    """Return the solver for rates in a kernel, made once."""
    key = driven, n_moving
    if key not in kernel.solvers:
        kernel.solvers[key] = RateSolver(kernel, driven, n_moving)
    return kernel.solvers[key]
