"""The saddle-point system of the equations of motion, for a choice of closure rows, dense."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from spatial_pin.linalg import Array

HOLDS = 1e-9  # what an equation left out may lack, by the size of its terms


class SaddlePoint:
    """The equations of motion, scaled, with a choice of closure rows.

    Args:
        scale: (nv,) velocity of a unit of each unknown.
        rows: the independent ones of the closure rows.
        n_rows: how many there are.
        heaviest: size of the scaled mass matrix, by which forces are divided.

    Attributes:
        rows, heaviest: as given.
        jacobian: (rows, nv) of these rows, for scaled velocities, at the last `solve`.
        pivot: smallest over largest pivot of the last `solve`; 0 if it failed.
    """

    def __init__(
        self, scale: Array, rows: NDArray[np.intp], n_rows: int, heaviest: float
    ) -> None:
        nv, n = len(scale), len(scale) + len(rows)
        self.rows, self.heaviest, self.pivot = rows, heaviest, 0.0
        self.jacobian = np.zeros((len(rows), nv))
        self._some_left_out = len(rows) < n_rows
        self._square, self._scale = np.outer(scale, scale) / heaviest, scale / heaviest
        self._k, self._rhs = np.zeros((n, n), order="F"), np.zeros(n)
        self._mass, self._zero = self._k[:nv, :nv], self._k[nv:, nv:]
        self._down, self._right = self._k[nv:, :nv], self._k[:nv, nv:]
        self._load, self._bias, self._nv = self._rhs[:nv], self._rhs[nv:], nv

    def solve(self, mass: Array, scaled: Array, work: Array, gamma: Array) -> Array:
        """Return scaled accelerations and multipliers (nv + rows,).

        Args:
            mass: (nv, nv).
            scaled: (n_rows, nv) Jacobian for scaled velocities.
            work: (nv,) forces less those that the motion needs without acceleration.
            gamma: (n_rows,) second derivatives of the rows without acceleration.
        """
        scaled.take(self.rows, 0, self.jacobian, "clip")
        np.multiply(mass, self._square, out=self._mass)
        self._down[:] = self.jacobian
        self._right[:] = self.jacobian.T
        self._zero[:] = 0.0
        np.multiply(self._scale, work, out=self._load)
        np.negative(gamma.take(self.rows), out=self._bias)
        lu, _, x, info = lapack.dgesv(self._k, self._rhs, overwrite_a=True)
        sizes = [abs(d) for d in lu.diagonal().tolist()]
        self.pivot = min(sizes) / max(sizes) if sizes and not info else float(not sizes)
        solution: Array = x
        return solution

    def holds(self, x: Array, scaled: Array, gamma: Array) -> bool:
        """Whether the rows that were left out hold as well."""
        if not self._some_left_out:
            return True
        a = x[: self._nv]
        lacking = np.dot(scaled, a)
        lacking += gamma
        return bool(lacking.dot(lacking) <= HOLDS**2 * (gamma.dot(gamma) + a.dot(a)))
