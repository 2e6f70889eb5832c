"""The equations of motion for a choice of closure rows, dense: a saddle point, or its freedoms.

Both measure freedoms in velocities at which their own inertia is one: so scaled, light bodies keep
their digits beside heavy ones. The saddle point

    [M  J^T; J  0] [a; -lambda] = [f - b; -gamma]

costs one factorisation. Where it loses digits, near singular configurations of the loops or with a
heavy body carried between light ones, independent coordinates do better: some coordinates follow
the others by the closure rows alone, and these are left with an inertia of their own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from spatial_pin.linalg import EPS, Array, Factors, decompose, independent_rows

ROUNDING = 128.0 * EPS  # of an entry, with all that is added to it
SINGULAR = 1e-13  # smallest over largest pivot below which nothing is determined
HOLDS = 1e-9  # what an equation left out may lack, by the size of its terms


def own_units(inertias: Array) -> Array:
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
        unit = own_units(mass.diagonal() * scale * scale)
        self._size = np.abs(scaled[rows] * unit).max(axis=1, initial=1e-300)
        self._weight = unit / self._size[:, None]
        self._scale, self._unit = scale, scale * unit
        self._square = np.outer(self._unit, self._unit)
        self._jacobian, self._k = np.zeros((len(rows), nv)), np.zeros((n, n), order="F")
        self._mass, self._zero = self._k[:nv, :nv], self._k[nv:, nv:]
        self._down, self._right = self._k[nv:, :nv], self._k[:nv, nv:]

    @property
    def error(self) -> float:
        """Estimated round-off of accelerations, by their size."""
        return round_off(self.pivot)

    def solve(
        self, mass: Array, scaled: Array, work: Array, gamma: Array
    ) -> tuple[Array, Array]:
        """Return accelerations (nv,), and multipliers (rows,) of the Jacobian's rows.

        Or those of many right-hand sides, (nv, k) and (rows, k).

        Args:
            mass: (nv, nv).
            scaled: (n_rows, nv) Jacobian for scaled velocities.
            work: (nv,) forces less those that the motion needs without acceleration.
            gamma: (n_rows,) second derivatives of the rows without acceleration.
        """
        nv, unit, size = len(self._unit), self._unit, self._size
        if not nv:  # LAPACK asks for one equation at least
            self.pivot = 1.0
            return work, gamma[:0]
        rows = scaled.take(self.rows, 0, self._jacobian, "clip")
        rows *= self._weight
        np.multiply(mass, self._square, out=self._mass)
        self._down[:] = rows
        self._right[:] = rows.T
        self._zero[:] = 0.0
        rhs = np.concatenate((unit * work.T, gamma.take(self.rows, 0).T / -size), -1).T
        lu, _, x, info = lapack.dgesv(self._k, rhs, overwrite_a=True)
        sizes = [abs(d) for d in lu.diagonal().tolist()]
        self.pivot = min(sizes) / max(sizes) if sizes and not info else float(not sizes)
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


class IndependentCoordinates:
    """The equations of motion of coordinates that determine the others by the closure rows.

    Args:
        mass: (nv, nv).
        rows: (r, nv) the independent ones of the closure rows, for scaled velocities.
        scale: (nv,) velocity of a unit of each scaled unknown.

    Attributes:
        pivot: smallest over largest pivot of the inertia; 0 if a motion has none.
        error: estimated round-off of accelerations, by their size.
        motions: (nv, f) joint velocities, one for each of these coordinates at its own unit.
    """

    def __init__(self, mass: Array, rows: Array, scale: Array) -> None:
        self._scale, self._mass = scale, mass
        self._bound = bound = independent_rows(rows.T, 0.0)
        self._followers = Factors(rows[:, bound])
        freedoms, blur = self._motions(rows)
        inertia, size = freedoms.T @ mass @ freedoms, np.abs(freedoms)
        own, weight = inertia.diagonal(), np.abs(mass)
        terms = (size * (weight @ size)).sum(axis=0)  # not all of it is known: what cancels
        terms += (blur * (weight @ (2.0 * size + ROUNDING * blur))).sum(axis=0)  # and what blurs
        has = own > ROUNDING * terms
        unit = own_units(np.where(has, own, 0.0))
        self._inertia = unit[:, None] * inertia * unit
        self.motions, self._blur = freedoms * unit, ROUNDING * blur * unit
        self._factors = Factors(self._inertia)
        self.pivot = self._factors.pivot if has.all() else 0.0
        self._cancelled = float((terms[has] / own[has]).max(initial=1.0))
        self.error = self._error(self.pivot)

    def _motions(self, rows: Array) -> tuple[Array, Array]:
        """Return joint velocities (nv, f), one of the free coordinates each, and their round-off.

        The latter, in units of `ROUNDING`, bounds every entry [Higham, Accuracy, 7.2]; entries of
        rows are known as well as the largest, but for those that are zero by their structure.
        """
        nv, bound = len(self._scale), self._bound
        free = np.setdiff1d(np.arange(nv), bound)
        motions, blur = np.eye(nv)[:, free], np.zeros((nv, len(free)))
        follow = motions[bound] = self._followers.solve(-rows[:, free])
        back = np.abs(self._followers.solve(np.eye(len(bound))))
        known = (rows != 0.0) * np.abs(rows).max(axis=1, initial=0.0)[:, None]
        blur[bound] = back @ (known[:, bound] @ np.abs(follow) + known[:, free])
        return self._scale[:, None] * motions, self._scale[:, None] * blur

    def _error(self, pivot: float) -> float:
        """Return the estimated round-off for the smallest over the largest pivot of the inertia."""
        return ROUNDING * (self._cancelled / max(pivot, EPS)
                           + 1.0 / max(self._followers.pivot, EPS))

    def _carried(self, gamma: Array) -> Array:
        """Return the accelerations (nv,) that rows (r,) need while the free coordinates rest."""
        a = np.zeros(len(self._scale))
        a[self._bound] = self._followers.solve(-gamma)
        return self._scale * a

    def solve(self, work: Array, gamma: Array) -> Array:
        """Return accelerations (nv,), see `SaddlePoint.solve`, gamma (r,) of these rows only."""
        carried = self._carried(gamma)
        load = self.motions.T @ (work - self._mass @ carried)
        return carried + self.motions @ self._factors.solve(load)

    def solve_massless(
        self, work: Array, gamma: Array
    ) -> tuple[Array, Array, bool]:
        """Return accelerations (nv,) with which motions without inertia go on as they are.

        And these motions (k, nv), and whether forces work on one of them.
        """
        carried = self._carried(gamma)
        given = work - self._mass @ carried
        load = self.motions.T @ given
        allowed = (HOLDS * np.abs(self.motions) + self._blur).T @ np.abs(given)
        svd = decompose(self._inertia, SINGULAR)
        z = svd.minimum_norm(load)
        if svd.rank:
            self.error = self._error(float(svd.s[svd.rank - 1] / svd.s[0]))
        pulled = bool(np.any(np.abs(self._inertia @ z - load) > allowed))
        return carried + self.motions @ z, svd.null_space @ self.motions.T, pulled
