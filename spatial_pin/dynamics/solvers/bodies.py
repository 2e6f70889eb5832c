"""Mass matrix and inverse dynamics of a tree, from Pinocchio."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.pinocchio_views import forces
from spatial_pin.constraints.trees import related, subtrees_of
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.numerics.linalg import Array


class Bodies:
    """A tree taken whole.

    Attributes:
        mass_at: rows, columns and places in what `masses` returns, of the entries of the mass
            matrix that can be other than zero.
        n_masses: how many numbers `masses` returns.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self._data = model, model.createData()
        self._matrix, self._transmitted = MassMatrix(model), forces(self._data)
        rows, columns = related(model)
        self.mass_at = rows, columns, rows * model.nv + columns
        self.n_masses = model.nv**2

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

    def needed(self, q: Array, v: Array, a: Array | None = None) -> Array:
        """Return M a + b (nv,), b if no accelerations are given."""
        if a is None:
            return pin.nonLinearEffects(self.model, self._data, q, v)
        return pin.rnea(self.model, self._data, q, v, a)

    def transmitted(self, q: Array, v: Array, a: Array) -> Array:
        """Return (njoints, 6) what joints hand on, joint axes; overwritten by the next call."""
        self.needed(q, v, a)
        return self._transmitted


class BodiesBySubtrees(Bodies):
    """A large tree: memory and time grow in proportion to its size, not to its cube."""

    def __init__(self, model: pin.Model) -> None:
        self.model, self._subtrees = model, subtrees_of(model)
        rows, columns = (np.concatenate([p.v[p.mass_at[k]] for p in self._subtrees])
                         for k in (0, 1))
        self.n_masses = len(rows)
        self.mass_at = rows, columns, np.arange(self.n_masses)

    def masses(self, q: Array) -> Array:
        """Return the numbers (n_masses,) of the mass matrix at q (nq,)."""
        return np.concatenate([p.mass(q[p.q])[p.mass_at] for p in self._subtrees])

    def matrix(self, q: Array) -> Array:
        """Return the mass matrix (nv, nv)."""
        dense = np.zeros((self.model.nv, self.model.nv))
        dense[self.mass_at[:2]] = self.masses(q)
        return dense

    def needed(self, q: Array, v: Array, a: Array | None = None) -> Array:
        """Return M a + b (nv,), b if no accelerations are given."""
        total = np.empty(len(v))
        for p in self._subtrees:
            part = q[p.q], v[p.v]
            total[p.v] = (pin.nonLinearEffects(p.model, p.data, *part) if a is None else
                          pin.rnea(p.model, p.data, *part, a[p.v]))
        return total

    def transmitted(self, q: Array, v: Array, a: Array) -> Array:
        """Return (njoints, 6) what joints hand on, joint axes."""
        self.needed(q, v, a)
        total = np.zeros((self.model.njoints, 6))
        for p in self._subtrees:
            total[p.joints] = p.forces
        return total


def bodies_of(model: pin.Model, by_subtrees: bool) -> Bodies:
    """Return the bodies of a tree."""
    return (BodiesBySubtrees if by_subtrees else Bodies)(model)
