"""Mass matrix and inverse dynamics of a tree, from Pinocchio; of a large one from the kernel."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.constraints.pinocchio_views import forces
from spatial_pin.constraints.trees import is_in_kernel, mass_pattern
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.numerics.linalg import Array


class TreeDynamics:
    """Mass matrix and inverse dynamics of a small tree, by Pinocchio."""

    def __init__(self, model: pin.Model) -> None:
        self.model, self._data = model, model.createData()
        self._matrix, self._transmitted = MassMatrix(model), forces(self._data)

    @property
    def n_masses(self) -> int:
        """Length of `masses`."""
        return int(self.model.nv) ** 2

    @cached_property
    def mass_entry_indices(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Rows, columns and indices in `masses` of all entries that can be other than zero."""
        rows, columns = mass_pattern(self.model)
        return rows, columns, rows * self.model.nv + columns

    @cached_property
    def centres(self) -> tuple[NDArray[np.intp], Array]:
        """Joints (k,) whose bodies have a mass, and its centre (k, 4) in their axes, then 1."""
        inertias = self.model.inertias
        heavy = [k for k, body in enumerate(inertias) if k and body.mass > 0.0]
        levers = np.array([[*inertias[k].lever, 1.0] for k in heavy]).reshape(-1, 4)
        return np.array(heavy, dtype=np.intp), levers

    def masses(self, q: Array) -> Array:
        """Return the numbers (n_masses,) of the mass matrix at q (nq,)."""
        return self._matrix(q).reshape(-1)

    def matrix(self, q: Array) -> Array:
        """Return the mass matrix (nv, nv)."""
        return self._matrix(q)

    def inverse_dynamics(self, q: Array, v: Array, a: Array | None = None) -> Array:
        """Return M a + b (nv,), b if no accelerations are given."""
        if a is None:
            return pin.nonLinearEffects(self.model, self._data, q, v)
        return pin.rnea(self.model, self._data, q, v, a)

    def transmitted(self, q: Array, v: Array, a: Array) -> Array:
        """Return the forces (njoints, 6) through the joints, joint axes; overwritten later."""
        self.inverse_dynamics(q, v, a)
        return self._transmitted


class KernelTreeDynamics(TreeDynamics):
    """The same of a large tree in the kernel: memory and time grow in proportion to its size."""

    def __init__(self, model: pin.Model) -> None:
        self.model, self._tree = model, KernelTree(model)

    @cached_property
    def _entries(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        return self._tree.mass_entries()

    @property
    def n_masses(self) -> int:
        """Length of `masses`."""
        return len(self._entries[0])

    @cached_property
    def mass_entry_indices(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Rows, columns and indices, see `TreeDynamics`."""
        return both_halves(*self._entries)

    def masses(self, q: Array) -> Array:
        """Return the numbers (n_masses,) of the mass matrix at q (nq,)."""
        entries = np.empty(self.n_masses)
        self._tree.masses(q, entries)
        return entries

    def matrix(self, q: Array) -> Array:
        """Return the mass matrix (nv, nv)."""
        rows, columns = self._entries
        dense = np.zeros((self.model.nv, self.model.nv))
        dense[rows, columns] = dense[columns, rows] = self.masses(q)
        return dense

    def inverse_dynamics(self, q: Array, v: Array, a: Array | None = None) -> Array:
        """Return M a + b (nv,), b if no accelerations are given."""
        return self._tree.forces(q, v, a).copy()

    def transmitted(self, q: Array, v: Array, a: Array) -> Array:
        """Return the forces (njoints, 6) through the joints, joint axes."""
        return self._tree.transmitted(q, v, a)


def both_halves(
    rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return rows, columns and indices of all entries of a symmetric matrix, given one half."""
    indices, off_diagonal = np.arange(len(rows)), np.flatnonzero(rows != columns)
    return (np.concatenate([rows, columns[off_diagonal]]),
            np.concatenate([columns, rows[off_diagonal]]),
            np.concatenate([indices, off_diagonal]))


def bodies_of(model: pin.Model) -> TreeDynamics:
    """Return mass matrix and inverse dynamics of a tree."""
    return (KernelTreeDynamics if is_in_kernel(model) else TreeDynamics)(model)
