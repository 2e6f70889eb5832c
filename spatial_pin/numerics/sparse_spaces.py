"""Null space, left null space and shortest solutions of a large sparse Jacobian, by sparse factors.

What the singular value decomposition tells of the Jacobian J of a few loops, for many: with the
independent equations J_r, and the columns J_c that are left when as many coordinates are taken out
as there are freedoms, both

    [1  J_r^T; J_r  0]     and     [1  J_c; J_c^T  0]

are regular. The first, a KKT system, takes any velocities to the nearest that the loops allow, the
second any multipliers to the nearest self-stress, or generalised forces to the shortest multipliers
that bear them [GolubVanLoan2013, 5.5]. Both have the pattern of the loops: their factors grow with
the number of loops.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array, weighty_rows
from spatial_pin.numerics.tolerances import TOLERANCES

# Random members that represent all self-stresses. One would do with a chance of 1 - 1e-8 per
# reaction.
MEMBERS = 3


class SparseSpaces:
    """The subspaces of a Jacobian (n_rows, nv), named as those of a `Decomposition`.

    Args:
        row_at, column_at: (nnz,) places of its entries.
        values: (nnz,) its entries, of order one.
        shape: n_rows, nv.
        rank: how many independent rows there are, as is thought.
        nearest: takes motions (k, nv) to the nearest that as many rows allow.

    Attributes:
        null_space: (nv - rank, nv) orthonormal rows that span the freedoms.
        is_sure: whether the other rows follow from those.
    """

    def __init__(
        self, row_at: NDArray[np.intp], column_at: NDArray[np.intp], values: Array,
        shape: tuple[int, int], rank: int, nearest: Callable[[Array], Array],
    ) -> None:
        from scipy.sparse import csr_array  # imported on use: it takes a tenth of a second

        self.jacobian: Any = csr_array((values, (row_at, column_at)), shape=shape)
        self.rank = rank
        motions = np.random.default_rng(4).standard_normal((shape[1] - rank, shape[1]))
        for _ in range(2):  # once more for the digits that the first time has lost
            motions = np.linalg.qr(nearest(motions).T)[0].T
        self.null_space = motions
        motion = np.ones(len(motions)) @ motions
        residual, terms = np.abs(self.jacobian @ motion), abs(self.jacobian) @ np.abs(motion)
        self.is_sure = bool(np.all(residual <= TOLERANCES.nothing * terms.max(initial=1.0)))

    @cached_property
    def _dependent(self) -> NDArray[np.intp]:
        """Places of the coordinates that the others determine."""
        free = weighty_rows(self.null_space.T, len(self.null_space))
        return np.setdiff1d(np.arange(self.jacobian.shape[1]), free)

    @cached_property
    def _balanced(self) -> _ProjectionMatrix:
        return _ProjectionMatrix(self.jacobian[:, self._dependent])

    def minimum_norm_transposed(self, b: Array) -> Array:
        """Return the shortest x (n_rows,) with x J = b, for a b (nv,) that no freedom feels."""
        if not self.rank:
            return np.zeros(self.jacobian.shape[0])
        return self._balanced.shortest(b[self._dependent])

    @cached_property
    def self_stresses(self) -> Array:
        """(k, n_rows) random x with x J = 0 and entries of order one, each a bit of all."""
        n = self.jacobian.shape[0]
        members = np.random.default_rng(5).standard_normal((min(MEMBERS, n - self.rank), n))
        return np.array([self._balanced.nearest(x) for x in members]).reshape(members.shape)


class _ProjectionMatrix:
    """The regular matrix [1 A; A^T 0] of a sparse matrix A (m, r) of full column rank, factored."""

    def __init__(self, a: Any) -> None:
        from scipy.sparse import block_array, eye_array
        from scipy.sparse.linalg import splu

        self._m, self._r = a.shape
        self._matrix = block_array([[eye_array(self._m), a], [a.T, None]], format="csc")
        self._factors: Any = splu(self._matrix) if self._r else None

    def nearest(self, x: Array) -> Array:
        """Return the nearest vector (m,) to x with A^T y = 0."""
        return self._solved(np.concatenate([x, np.zeros(self._r)])) if self._r else x

    def shortest(self, b: Array) -> Array:
        """Return the shortest vector (m,) with A^T y = b (r,)."""
        return self._solved(np.concatenate([np.zeros(self._m), b])) if self._r else b

    def _solved(self, rhs: Array) -> Array:
        x = self._factors.solve(rhs)
        x += self._factors.solve(rhs - self._matrix @ x)
        return x[: self._m]
