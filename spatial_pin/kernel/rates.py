"""Rates of all joints in the kernel, see `rates.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.kernel.kernel import Kernel, address, check
from spatial_pin.kernel.library import BAD_ARRAYS, DONE
from spatial_pin.numerics.linalg import Array


class Solved(NamedTuple):
    """Rates at a configuration.

    Attributes:
        v, a: (nv,) joint velocities and accelerations.
        pivot: smallest over largest pivot of the equations.
        lost: round-off of v and a, relative to their size.
    """

    v: Array
    a: Array
    pivot: float
    lost: float


class Rates:
    """Solves for rates with some freedoms driven; one caller at a time.

    Kept by the kernel whose memory it works in.

    Args:
        kernel: of the mechanism.
        driven: places in the velocity vector, those that stand still last; nv and that of a
            component of a ball or a floating joint.
        n_moving: how many do not.
    """

    def __init__(self, kernel: Kernel, driven: Sequence[int], n_moving: int) -> None:
        self._library, handle = kernel.library, ctypes.c_void_p()
        self.n_moving, nv = n_moving, kernel.nv
        at = np.array(driven, np.int64)
        code = self._library.rates_create(
            kernel.handle, address(at), len(at), ctypes.byref(handle))
        self.fits = code != BAD_ARRAYS
        if self.fits:
            check(code)
        self._handle = handle
        self._q, self._turns = np.empty(kernel.nq), np.empty(kernel.n_angles)
        self.speeds, self.accelerations = np.zeros(len(at)), np.zeros(len(at))
        self._columns, self._v, self._a = np.empty((n_moving, nv)), np.empty(nv), np.empty(nv)
        self._facts, self._local = np.empty(2), np.empty(3)
        self._jacobian = np.empty((6, n_moving))
        self._place = [handle, address(self._q), address(self._turns), n_moving]
        self._rates = [address(x) for x in (self.speeds, self.accelerations, self._columns, self._v,
                                            self._a, self._facts)]
        self._frame = [address(x) for x in (self._local, self._columns, self._jacobian)]

    def solve(self, q: Array, turns: Array) -> Solved | None:
        """Return the rates at q (nq,) for the drivers' rates in `speeds` and `accelerations`.

        None where equations are not clearly independent of each other and of what is driven, where
        there are not as many as freedoms, or where numbers overflow.

        Args:
            q: closed configuration.
            turns: (n_angles,) from which the angles of screws count [rad].
        """
        if not self.fits:
            return None
        self._q[:], self._turns[:] = q, turns
        if self._library.rates_solve(*self._place, *self._rates) != DONE:
            return None
        return Solved(self._v, self._a, *self._facts.tolist())

    def jacobian(self, q: Array, turns: Array, joint: int, local: Array) -> Array | None:
        """Return the Jacobian (6, n_moving) of a point of a joint's body; None as `solve`.

        Args:
            q: closed configuration.
            turns: as for `solve`.
            joint: of the kernel.
            local: (3,) the point in the joint's axes [m].
        """
        if not self.fits:
            return None
        self._q[:], self._turns[:], self._local[:] = q, turns, local
        code = self._library.rates_jacobian(*self._place, joint, *self._frame)
        return self._jacobian.copy() if code == DONE else None


def rates_of(kernel: Kernel, driven: tuple[int, ...], n_moving: int) -> Rates:
    """Return the solver for rates in a kernel, made once."""
    key = driven, n_moving
    if key not in kernel.kept:
        kernel.kept[key] = Rates(kernel, driven, n_moving)
    found: Rates = kernel.kept[key]
    return found
