"""Independent coordinates: the closure equations alone give the other coordinates' motion.

Near singular configurations of the loops, and with a heavy body carried between light ones, they
keep the digits that the KKT system loses [Wehage1982]. Every result has bounds on its errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.numerics.linalg import Array, Factors, independent_rows
from spatial_pin.numerics.tolerances import EPS

ROUNDING = 128.0 * EPS  # round-off of an entry: a sum of some hundred terms, each rounded once


class Bounded(NamedTuple):
    """Numbers with bounds on their errors.

    Attributes:
        value: the numbers.
        bound: largest absolute error of each, of the same shape.
    """

    value: Array
    bound: Array

    def plain(self) -> Bounded:
        """Return the numbers; those whose bound allows them to be zero are zero."""
        is_nonzero = np.abs(self.value) > self.bound
        return Bounded(np.where(is_nonzero, self.value, 0.0), np.where(is_nonzero, self.bound, 0.0))


class IndependentCoordinates:
    """Motion of all joints per unit of the independent coordinates, with bounds on its errors.

    Args:
        rows: (r, nv) independent equations for scaled velocities, as many as there are others.
        scale: (nv,) velocity of a unit of each scaled unknown.
        opened: closure residual [-]; entries of the rows may be off by as much.
        free: velocity entries of the independent coordinates; if not given, those that determine
            the others best.

    Attributes:
        free: the independent coordinates, in the order of the columns.
        columns: (nv, n) joint velocities; in each, one of the free coordinates moves at its unit.
        pivot: smallest over largest pivot of their equations.
    """

    def __init__(
        self, rows: Array, scale: Array, opened: float, free: Sequence[int] | None = None
    ) -> None:
        r, nv = rows.shape
        self._scale = scale
        if free is None:
            free = np.setdiff1d(np.arange(nv), independent_rows(rows.T, 0.0)).tolist()
        self.free = free
        whole = np.zeros((nv, nv))
        whole[:r] = rows
        whole[np.arange(r, nv), list(free)] = 1.0
        self._largest = np.abs(rows).max(axis=1, initial=0.0)
        self._known = np.zeros((nv, nv))
        self._known[:r] = np.where(rows != 0.0, ROUNDING * self._largest[:, None], 0.0) + opened
        self._factors = Factors(whole)
        self.pivot = self._factors.pivot
        units = np.zeros((nv, nv - r))
        units[r:] = np.eye(nv - r)
        self.columns = self._solve(units)

    def _solve(self, rhs: Array, off: Array | None = None) -> Bounded:
        x = self._factors.solve(rhs)
        bound = self._factors.error_bounds(x, self._known, ROUNDING)
        if off is not None:
            bound += self._factors.spread(off)
        return Bounded((self._scale * x.T).T, (self._scale * bound.T).T)

    def carried(self, gamma: Array, v: Array) -> Bounded:
        """Return the accelerations (nv,) that rows need while the free coordinates have none.

        Args:
            gamma: (r,) second derivatives of the rows without acceleration.
            v: (nv,) joint velocities.
        """
        rhs, off = np.zeros((2, len(self._scale)))
        rhs[: len(gamma)] = -gamma
        speed = v / self._scale
        off[: len(gamma)] = ROUNDING * (np.abs(gamma) + self._largest * speed.dot(speed))
        return self._solve(rhs, off)
