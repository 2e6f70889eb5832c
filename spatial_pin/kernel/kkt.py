"""The KKT system of a mechanism in the kernel, see `kkt.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kernel.kernel import Kernel, numbers
from spatial_pin.kernel.library import POINTER, address, check
from spatial_pin.kernel.packing import packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

Places = NDArray[Any]


class _KktTask(ctypes.Structure):
    """KktTask in kkt.c."""

    _fields_ = [(name, POINTER) for name in (
        "q", "v", "reference", "mass", "force", "a", "closures", "multipliers", "entry", "chosen",
        "facts")]


class KKT:
    """M a + b = f + J^T multipliers, J a + gamma = 0; one caller at a time.

    Args:
        mechanism: the mechanism.
        mass_entries: rows, columns and indices among the `n_masses` numbers of all entries of its
            mass matrix that can be other than zero.
        n_masses: length of `mass`.

    Attributes:
        mass: (n_masses,) the mass matrix, to be filled in.
        pivot: smallest over largest pivot of the last `accelerations`, 0 where there are none.
        error: estimated round-off of them, relative to their size.
        rank: how many independent equations there are.
        closures: (nv,) joint forces of the closures.
        multipliers: (n_closure,) 0 of equations that are left out.
    """

    def __init__(
        self, mechanism: Mechanism, mass_entries: tuple[Places, Places, Places], n_masses: int
    ) -> None:
        self._kernel = kernel = Kernel(mechanism, packed(mechanism, False))
        self._library, nv, n_closure = kernel.library, kernel.nv, kernel.n_closure
        labels = groupby(kernel.constraints.labels, lambda label: label.closure)
        groups = np.cumsum([0, *(len(list(group)) for _, group in labels)])  # by closure
        ints = np.concatenate([groups, *mass_entries]).astype(np.int64)
        handle = ctypes.c_void_p()
        check(self._library.kkt_create(kernel.handle, address(ints), len(groups) - 1,
                                       len(mass_entries[0]), n_masses,
                                       mechanism.characteristic_length, ctypes.byref(handle)))
        self._handle = handle
        self.pivot, self.error, self.rank = 1.0, 0.0, 0
        self._at = np.nonzero(kernel.constraints.occurring[:n_closure])
        self._values, self._chosen = np.empty(len(self._at[0])), np.empty(n_closure, np.int64)
        self._q, self._reference = np.empty(kernel.nq), np.empty(kernel.n_angles)
        self._v, self._force, self._a = np.empty((3, nv))
        self.mass, self._facts = np.empty(n_masses), np.empty(3)
        self.closures, self.multipliers = np.empty(nv), np.empty(n_closure)
        self._task = _KktTask(*map(address, (
            self._q, self._v, self._reference, self.mass, self._force, self._a, self.closures,
            self.multipliers, self._values, self._chosen, self._facts)))
        self._at_task = ctypes.byref(self._task)

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
        check(self._library.kkt_accelerations(self._handle, self._at_task))
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
        force, gamma = numbers(force, (n, len(self._v))), numbers(gamma, (n, len(self._chosen)))
        a, multipliers = np.empty_like(force), np.empty_like(gamma)
        self._library.kkt_solve(self._handle, n, *map(address, (force, gamma, a, multipliers)))
        return a, multipliers

    @property
    def entries(self) -> tuple[Places, Places, Array]:
        """Rows, columns and values (nnz,) of the Jacobian for scaled velocities, at that place."""
        rows, columns = self._at
        return rows, columns, self._values.copy()

    @property
    def rows(self) -> Places:
        """Indices of the independent equations that were chosen, ascending."""
        return self._chosen[: self.rank].copy()
