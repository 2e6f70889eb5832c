"""The equations of motion for a choice of closure rows, dense: a saddle point, or its freedoms.

Freedoms are measured in velocities at which their own inertia is one: so scaled, light bodies keep
their digits beside heavy ones. The saddle point

    [M  J^T; J  0] [a; -lambda] = [f - b; -gamma]

costs one factorisation. Where it loses digits, near singular configurations of the loops or with a
heavy body carried between light ones, independent coordinates do better: some coordinates follow
the others by the closure rows alone (`Motions`), and of these `least_constraint` finds the
accelerations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import EPS, Array, Factors, independent_rows

ROUNDING = 128.0 * EPS  # of an entry, with all that is added to it
SINGULAR = 1e-13  # smallest over largest pivot below which nothing is determined
DOUBTFUL = 1e-10  # estimated error above which rows are chosen anew, then coordinates
HOLDS = 1e-9  # what an equation left out may lack, by the size of its terms


def jacobi_scaling(inertias: Array) -> Array:
    """Return the velocity of every freedom at which its own inertia is one.

    The heaviest one's for freedoms that have none.
    """
    heaviest = float(inertias.max(initial=0.0)) or 1.0
    return 1.0 / np.sqrt(np.where(inertias > 0.0, inertias, heaviest))


def round_off(pivot: float) -> float:
    """Return the estimated error of a solution, from the smallest over the largest pivot."""
    return ROUNDING / max(pivot, EPS)


class SaddlePoint:
    """The equations of motion with a choice of closure rows, in buffers that are used again.

    Freedoms and rows are scaled as is right where the rows were chosen: of rows that shrink to
    nothing later, nothing is to be left.

    Args:
        scale: (nv,) velocity of a unit of each scaled unknown.
        rows: the independent ones of the closure rows.
        mass: (nv, nv) where they were chosen.
        scaled: (n_rows, nv) Jacobian for scaled velocities there.

    Attributes:
        rows: as given.
        pivot: smallest over largest pivot of the last `solve`; 0 if it failed.
    """

    def __init__(
        self, scale: Array, rows: NDArray[np.intp], mass: Array, scaled: Array
    ) -> None:
        nv, n = len(scale), len(scale) + len(rows)
        self.rows, self.pivot = rows, 0.0
        self._some_left_out = len(rows) < len(scaled)
        unit = jacobi_scaling(mass.diagonal() * scale * scale)
        self._size = np.abs(scaled[rows] * unit).max(axis=1, initial=1e-300)
        self._weight = unit / self._size[:, None]
        self._scale, self._unit, self._own = scale, scale * unit, unit
        self._moved = np.zeros(nv)
        self._square = np.outer(self._unit, self._unit)
        self._jacobian, self._k = np.zeros((len(rows), nv)), np.zeros((n, n))
        self._mass, self._zero = self._k[:nv, :nv], self._k[nv:, nv:]
        self._down, self._right = self._k[nv:, :nv], self._k[:nv, nv:]

    @property
    def error(self) -> float:
        """Estimated round-off of accelerations, by their size.

        From the pivots and, for exchanges of rows may hide how small they are, from the condition;
        in the own units of freedoms, of which light ones have larger ones.
        """
        if not self.pivot or not len(self._k):
            return round_off(self.pivot)
        rcond = 1.0 / (self._norm * self._factors.inverse_norm())
        told = max(round_off(self.pivot), len(self._k) * EPS / max(rcond, EPS))
        size = float((self._own * self._moved).max(initial=0.0))
        return told * float(self._own.max()) * float(self._moved.max()) / size if size else told

    def solve(
        self, mass: Array, scaled: Array, work: Array, gamma: Array
    ) -> tuple[Array, Array]:
        """Return accelerations (nv,), and multipliers (rows,) of the Jacobian's rows.

        Or those of many right-hand sides, (nv, k) and (rows, k). All are zero where the matrix is
        singular: where `pivot` is.

        Args:
            mass: (nv, nv).
            scaled: (n_rows, nv) Jacobian for scaled velocities.
            work: (nv,) forces less those that the motion needs without acceleration.
            gamma: (n_rows,) second derivatives of the rows without acceleration.
        """
        nv, unit, size = len(self._unit), self._unit, self._size
        if not nv:
            self.pivot = 1.0
            return work, gamma[:0]
        rows = scaled.take(self.rows, 0, self._jacobian, "clip")
        rows *= self._weight
        np.multiply(mass, self._square, out=self._mass)
        self._down[:] = rows
        self._right[:] = rows.T
        self._zero[:] = 0.0
        self._norm = float(np.abs(self._k).sum(axis=0).max())
        rhs = np.concatenate((unit * work.T, gamma.take(self.rows, 0).T / -size), -1).T
        self._factors = Factors(self._k)
        self.pivot = self._factors.pivot
        x = self._factors.solve(rhs) if self.pivot else np.zeros_like(rhs)
        self._moved = np.abs(x[:nv])
        return (unit * x[:nv].T).T, (x[nv:].T / -size).T

    def forces(self, multipliers: Array) -> Array:
        """Return the generalised forces (nv,) of multipliers (rows,) at the last `solve`."""
        force: Array = (multipliers * self._size) @ self._jacobian
        force /= self._unit
        return force

    def holds(self, a: Array, scaled: Array, gamma: Array) -> bool:
        """Whether the rows that were left out hold as well for accelerations (nv,)."""
        if not self._some_left_out:
            return True
        a = a / self._scale
        lacking = np.dot(scaled, a)
        lacking += gamma
        return bool(lacking.dot(lacking) <= HOLDS**2 * (gamma.dot(gamma) + a.dot(a)))


class Blurred(NamedTuple):
    """Numbers with bounds on their errors.

    Attributes:
        value: the numbers.
        blur: as many bounds.
    """

    value: Array
    blur: Array

    def plain(self) -> Blurred:
        """Return the numbers with those that may be nothing as nothing."""
        kept = np.abs(self.value) > self.blur
        return Blurred(np.where(kept, self.value, 0.0), np.where(kept, self.blur, 0.0))


class Motions:
    """How some coordinates move the others by independent closure rows, and how surely.

    Args:
        rows: (r, nv) independent rows for scaled velocities, as many as there are others.
        scale: (nv,) velocity of a unit of each scaled unknown.
        opened: closure residual [-]: loops that are open by so much move as if rows were off by it.
        free: the coordinates; those that determine the others best if not given.

    Attributes:
        free: the coordinates, in the order of the columns.
        columns: (nv, n) joint velocities, one of the free coordinates at its own unit each.
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

    def _solve(self, rhs: Array, off: Array | None = None) -> Blurred:
        x = self._factors.solve(rhs)
        blur = self._factors.blur(x, self._known, ROUNDING)
        if off is not None:
            blur += self._factors.spread(off)
        return Blurred((self._scale * x.T).T, (self._scale * blur.T).T)

    def carried(self, gamma: Array, v: Array) -> Blurred:
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
