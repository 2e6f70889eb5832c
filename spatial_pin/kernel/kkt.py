"""The KKT system of a mechanism in the kernel, see `kkt.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.kernel import Kernel, check, numbers
from spatial_pin.kernel.library import address
from spatial_pin.kernel.packing import packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

Places = NDArray[Any]


class KKT:
    """M a + b = f + J^T multipliers, J a + gamma = 0; one caller at a time.

    Args:
        mechanism: the mechanism.
        mass_at: rows, columns and places among `n_masses` given numbers of the entries of its mass
            matrix that can be other than zero.
        n_masses: how many numbers the mass matrix has.

    Attributes:
        mass: (n_masses,) the mass matrix, to be filled in.
        pivot: smallest over largest pivot of the last `accelerations`, 0 where there are none.
        error: estimated round-off of them, relative to their size.
        rank: how many independent equations there are.
        closures: (nv,) joint forces of the closures.
        multipliers: (n_closure,) 0 of equations that are left out.
    """

    def __init__(
        self, mechanism: Mechanism, mass_at: tuple[Places, Places, Places], n_masses: int
    ) -> None:
        self._kernel = kernel = Kernel(mechanism, packed(mechanism, False))
        self._library, nv, n_closure = kernel.library, kernel.nv, kernel.n_closure
        groups = np.cumsum([0, *_equations_by_closure(kernel)])
        ints = np.concatenate([groups, *mass_at]).astype(np.int64)
        handle = ctypes.c_void_p()
        check(self._library.kkt_create(kernel.handle, address(ints), len(groups) - 1,
                                       len(mass_at[0]), n_masses, mechanism.characteristic_length,
                                       ctypes.byref(handle)))
        self._handle = handle
        self.pivot, self.error, self.rank = 1.0, 0.0, 0
        self._q, self._reference = np.empty(kernel.nq), np.empty(kernel.n_angles)
        self._v, self._force, self._a = np.empty((3, nv))
        self.mass, self._facts = np.empty(n_masses), np.empty(3)
        self.closures, self.multipliers = np.empty(nv), np.empty(n_closure)
        self._rows = np.empty(n_closure, np.int64)
        self._inputs = [handle, *map(address, (
            self._q, self._v, self._reference, self.mass, self._force))]
        self._outputs = [address(x) for x in (
            self._a, self.closures, self.multipliers, self._facts)]

    def accelerations(
        self, q: Array, v: Array, reference: Array | Sequence[float], given: Array, needed: Array
    ) -> Array:
        """Return accelerations (nv,), 0 where they are not determined; the next call overwrites.

        Args:
            q: (nq,) configuration; `mass` is that there.
            v: (nv,) joint velocities.
            reference: (n_angles,) from which the angles of screws count [rad].
            given: (nv,) joint forces f.
            needed: (nv,) joint forces b that the motion needs without acceleration.
        """
        self._q[:], self._v[:], self._reference[:] = q, v, reference
        np.subtract(given, needed, out=self._force)
        check(self._library.kkt_accelerations(*self._inputs, *self._outputs))
        self.pivot, self.error, rank = self._facts.tolist()
        self.rank = int(rank)
        return self._a

    def solve(self, force: Array, gamma: Array) -> tuple[Array, Array]:
        """Return accelerations (k, nv) and multipliers (k, n_closure) with the last matrix.

        Args:
            force: (k, nv) joint forces f - b.
            gamma: (k, n_closure) second derivatives of the closure equations without acceleration.
        """
        n = len(force)
        force, gamma = numbers(force, (n, len(self._v))), numbers(gamma, (n, len(self._rows)))
        a, multipliers = np.empty_like(force), np.empty_like(gamma)
        self._library.kkt_solve(self._handle, n, *map(address, (force, gamma, a, multipliers)))
        return a, multipliers

    @property
    def entries(self) -> tuple[Places, Places, Array]:
        """Rows, columns and values (nnz,) of the Jacobian for scaled velocities, at that place."""
        n = self._library.kkt_entries(self._handle, None, None, None)
        rows, columns = np.empty((2, n), np.int64)
        values = np.empty(n)
        self._library.kkt_entries(self._handle, *map(address, (rows, columns, values)))
        return rows, columns, values

    @property
    def rows(self) -> Places:
        """Indices of the independent equations that were chosen, ascending."""
        n = self._library.kkt_chosen(self._handle, address(self._rows))
        return self._rows[:n].copy()


def _equations_by_closure(kernel: Kernel) -> list[int]:
    """Return how many equations each closure has, in their order."""
    labels = constraints_of(kernel.mechanism).labels
    return [len(list(group)) for _, group in groupby(labels, lambda label: label.closure)]
