"""Rates of all joints in the kernel, see `rates.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.kernel import Kernel, check, numbers
from spatial_pin.kernel.library import DONE, NOT_FINITE, SINGULAR, UNSAFE, address
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


class RateSolver:
    """Solves for rates with some freedoms driven; one caller at a time.

    Kept by the kernel whose memory it works in. What is asked for after `place` or `solve` is that
    of their configuration.

    Args:
        kernel: of the mechanism.
        driven: places in the velocity vector, those that stand still last; nv and that of a
            component of a ball or a floating joint.
        n_moving: how many do not.

    Attributes:
        speeds, accelerations: (n,) of what is driven, for `solve`.
        pivot: smallest over largest pivot of the equations, where they were last placed.
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
        self._jacobian = np.empty((6, n_moving))
        self._at = [handle, address(self._q), address(self._reference)]
        self._pivot = address(self._facts)
        self._rates = [n_moving, *(address(x) for x in (
            self.speeds, self.accelerations, self._columns, self._v, self._a, self._facts))]
        self._frame = [address(x) for x in (self._local, self._columns, self._jacobian)]

    def place(self, q: Array, reference: Array, chosen: Chosen | None = None) -> bool:
        """Factor the equations at q (nq,); False where nothing determines rates there.

        Without `chosen`: where equations are not clearly independent of each other and of what is
        driven, or where there are not as many as freedoms.

        Args:
            q: closed configuration.
            reference: (n_angles,) from which the angles of screws count [rad].
            chosen: the equations, if the kernel is not to choose them.
        """
        self._q[:], self._reference[:] = q, reference
        given, _kept = _NONE if chosen is None else _addresses(chosen)
        return _determined(self._library.rates_place(*self._at, *given, self._pivot))

    def solve(self, q: Array, reference: Array, chosen: Chosen | None = None) -> Solved | None:
        """Return the rates at q (nq,) for the drivers' rates in `speeds` and `accelerations`.

        None as `place`.
        """
        self._q[:], self._reference[:] = q, reference
        given, _kept = _NONE if chosen is None else _addresses(chosen)
        code = self._library.rates_solve(*self._at, *given, *self._rates)
        if not _determined(code):
            return None
        pivot, lost, known = self._facts.tolist()
        return Solved(self._v.copy(), self._a.copy(), pivot, lost, known, code == DONE)

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the equations, where they were last placed."""
        return self._facts.item(0)

    def columns(self) -> Array:
        """Return (nv, n_moving): joint velocities per unit speed of each that moves."""
        check(self._library.rates_columns(self._handle, self.n_moving, address(self._columns)))
        return self._columns.T.copy()

    def acceleration(self, v: Array, drive: Array | None = None) -> Array:
        """Return (nv,) joint accelerations at joint velocities v (nv,).

        Args:
            v: joint velocities.
            drive: (n_driven,) accelerations of what is driven; none by default.
        """
        v, drive = numbers(v, (self.nv,)), self._drive(drive)
        a = np.empty(self.nv)
        self._library.rates_acceleration(self._handle, *map(address, (v, drive, a)))
        return a

    def answer(self, derivative: Array, drive: Array | None = None) -> Array:
        """Return joint rates (nv,) of any order; what is driven must have no components.

        Args:
            derivative: (n_closure + n_passive,) of the equations, where the rates are zero.
            drive: (n_driven,) rates of what is driven; none by default.
        """
        derivative, drive = numbers(derivative, (self._n_equations,)), self._drive(drive)
        rates = np.empty(self.nv)
        self._library.rates_answer(self._handle, *map(address, (derivative, drive, rates)))
        return rates

    def _drive(self, drive: Array | None) -> Array:
        """Return the rates of all that is driven: the last ones stand still."""
        full = np.zeros(self.n_driven)
        if drive is not None:
            full[: len(drive)] = drive
        return full

    def jacobian(self, joint: int, local: Array) -> Array:
        """Return the Jacobian (6, n_moving) of a point of a joint's body.

        Args:
            joint: of the kernel.
            local: (3,) the point in the joint's axes [m].
        """
        self._local[:] = local
        code = self._library.rates_jacobian(self._handle, self.n_moving, joint, *self._frame)
        if code != NOT_FINITE:
            check(code)
        return self._jacobian.copy()


_NONE = (None, 0, None, 0), None  # `_addresses` where the kernel is to choose


def _addresses(chosen: Chosen) -> tuple[tuple[int, int, int, int], object]:
    """Return chosen equations as C takes them, and the arrays that are to live as long."""
    rows = np.ascontiguousarray(chosen.rows, np.int64)
    fill = np.ascontiguousarray(chosen.fill, float)
    return (address(rows), len(rows), address(fill), len(fill)), (rows, fill)


def _determined(code: int) -> bool:
    """Return whether there are rates: a code of the kernel that tells it."""
    if code == DONE:
        return True
    if code not in (UNSAFE, SINGULAR, NOT_FINITE):
        check(code)
    return code == NOT_FINITE


def rates_of(kernel: Kernel, driven: tuple[int, ...], n_moving: int) -> RateSolver:
    """Return the solver for rates in a kernel, made once."""
    key = driven, n_moving
    if key not in kernel.solvers:
        kernel.solvers[key] = RateSolver(kernel, driven, n_moving)
    return kernel.solvers[key]
