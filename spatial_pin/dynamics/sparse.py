"""The equations of motion of mechanisms with many loops, by sparse factorisation.

The same equations as in `spatial_pin.dynamics.equations`. Their cost grows with the number of
loops; which rows are independent is found once, and again when an equation that was left out does
not hold.
"""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.dynamics.equations import EPS, ROUNDINGS, Equations
from spatial_pin.errors import SingularError
from spatial_pin.kinematics.pieces import PiecewiseRows
from spatial_pin.linalg import RANK_TOLERANCE, Array, independent_rows
from spatial_pin.mechanism.mechanism import Mechanism

LARGE = 60  # freedoms from which sparse factorisation is faster
PROBED = 128  # freedoms up to which the rank of the loops is found by trying configurations nearby
UNSURE = 1e-10  # smallest over largest pivot below which the equations are solved densely
HOLDS = 1e-9  # what an equation left out may lack, by the size of its terms


class _System:
    """The matrix of the equations of motion for a choice of closure rows, with its pattern.

    Args:
        rows: the closure rows.
        chosen: indices of the independent ones.
    """

    def __init__(self, rows: PiecewiseRows, chosen: NDArray[np.intp]) -> None:
        from scipy.sparse import csc_array  # imported on use: it takes a tenth of a second

        nv, self.chosen = rows.model.nv, chosen
        place = np.full(rows.constraints.n_rows, -1)
        place[chosen] = nv + np.arange(len(chosen))
        self._own = np.flatnonzero(place[rows.row_at] >= 0)
        at, columns = place[rows.row_at[self._own]], rows.column_at[self._own]
        i, j = rows.mass_entries()
        where = np.concatenate([i, at, columns]), np.concatenate([j, columns, at])
        n = nv + len(chosen)
        numbered = csc_array((np.arange(1.0, len(where[0]) + 1.0), where), shape=(n, n))
        self._order = numbered.data.astype(np.intp) - 1
        self.matrix: Any = numbered

    def factor(self, mass: Array, values: Array) -> Any:
        """Return the factors for entries of the mass matrix and of all rows; None if singular."""
        from scipy.sparse.linalg import splu

        own = values[self._own]
        self.matrix.data = np.concatenate([mass, own, own])[self._order]
        try:
            return splu(self.matrix)
        except RuntimeError:
            return None


class SparseEquations(Equations):
    """`Equations` whose accelerations cost no more than in proportion to the number of loops.

    With more than `PROBED` freedoms the rank of the loops is learnt from the configurations met:
    one that loses rank is refused if a better one came before it.
    """

    evaluation: PiecewiseRows  # type: ignore[assignment]

    def _make_rows(self) -> None:
        self.evaluation = PiecewiseRows(self.mechanism)
        self._columns = self.evaluation.data.J
        self._mass_at = self.evaluation.mass_entries()
        self._mass_scale = self.scale[self._mass_at[0]] * self.scale[self._mass_at[1]]
        self._system: _System | None = None

    def mass(self) -> Array:
        """Return the mass matrix (nv, nv)."""
        dense = np.zeros((self.model.nv, self.model.nv))
        dense[self._mass_at] = self.evaluation.mass(self.state.q)
        return dense

    def motion_forces(self, a: Array) -> Array:
        """Return M a + b (nv,)."""
        return self.evaluation.motion_forces(self.state.q, self.state.v, a)

    def transmitted(self, a: Array) -> Array:
        """Return (njoints, 6) what joints hand on to move as a (nv,) says, joint axes."""
        self.motion_forces(a)
        return self.evaluation.transmitted()

    def accelerations(self, force: Array) -> tuple[Array, Array]:
        """Return joint accelerations (nv,) and what the closures add to the forces, (nv,).

        Args:
            force: (nv,) joint efforts, springs and external wrenches.

        Raises:
            SingularError: the loops have lost rank, by what is known of them.
        """
        state, rows, d = self.state, self.evaluation, self.scale
        gamma = rows.bias(state.q, state.v)
        mass = rows.mass(state.q) * self._mass_scale
        heaviest = float(np.abs(mass).max(initial=0.0)) or 1.0
        load = d * (force - self.motion_forces(np.zeros(len(d)))) / heaviest
        if self._system is None:
            self._system = _System(rows, self._select())
            self.check_rank(len(self._system.chosen))
        x, holds = self._solve(mass / heaviest, load, gamma)
        if not holds and self._select_again():
            x, _ = self._solve(mass / heaviest, load, gamma)
        if x is None:
            return super().accelerations(force)
        scaled, multipliers = x[: len(d)], x[len(d) :]
        full = np.zeros(rows.constraints.n_rows)
        full[self._system.chosen] = multipliers
        closures = -heaviest * self._transposed(full) / d
        return d * scaled, closures

    def check_rank(self, rank: int) -> None:
        """Refuse configurations in which the loops have lost rank, if that is cheap to know.

        Raises:
            SingularError: they have.
        """
        if self.model.nv <= PROBED:
            super().check_rank(rank)

    def _solve(self, mass: Array, load: Array, gamma: Array) -> tuple[Array | None, bool]:
        """Return scaled accelerations and multipliers, None if the equations are singular.

        And whether the closure rows that were left out hold as well.
        """
        system = self._system
        assert system is not None
        rhs = np.concatenate([load, -gamma[system.chosen]])
        factors = system.factor(mass, self.evaluation.values)
        if factors is None:
            return None, False
        pivots = np.abs(factors.U.diagonal())
        if pivots.min(initial=1.0) < UNSURE * pivots.max(initial=1.0):
            return None, False
        self.error = ROUNDINGS * EPS * float(pivots.max(initial=1.0) / pivots.min(initial=1.0))
        x = factors.solve(rhs)
        x += factors.solve(rhs - system.matrix @ x)
        terms = self.evaluation.values * x[self.evaluation.column_at]
        n = len(gamma)
        lacking = np.abs(np.bincount(self.evaluation.row_at, terms, n) + gamma)
        size = np.abs(gamma) + np.bincount(self.evaluation.row_at, np.abs(terms), n)
        return x, bool(np.all(lacking <= HOLDS * max(float(size.max(initial=0.0)), 1e-300)))

    def _transposed(self, multipliers: Array) -> Array:
        """Return the scaled joint forces (nv,) of multipliers (n_rows,)."""
        rows = self.evaluation
        terms = rows.values * multipliers[rows.row_at]
        return np.bincount(rows.column_at, terms, len(self.scale)).astype(np.float64)

    def _select(self) -> NDArray[np.intp]:
        """Return independent rows: of each closure by itself first, then of all if need be."""
        jacobian, labels = self.scaled, self.evaluation.constraints.labels
        kept = [np.empty(0, dtype=np.intp)]
        for _, group in groupby(range(len(labels)), lambda k: labels[k].closure):
            rows = np.array(list(group))
            block = jacobian[rows]
            kept.append(rows[independent_rows(block[:, np.any(block, axis=0)])])
        local = np.concatenate(kept)
        if self._are_independent(local):
            return local
        return local[independent_rows(jacobian[local])]

    def _are_independent(self, chosen: NDArray[np.intp]) -> bool:
        """Whether rows are surely independent: no pivot of the equations with them is small."""
        mass = self.evaluation.mass(self.state.q) * self._mass_scale
        factors = _System(self.evaluation, chosen).factor(
            mass / (float(np.abs(mass).max(initial=0.0)) or 1.0), self.evaluation.values)
        if factors is None:
            return False
        pivots = np.abs(factors.U.diagonal())
        return bool(pivots.min(initial=1.0) > RANK_TOLERANCE * pivots.max(initial=1.0))

    def _select_again(self) -> bool:
        """Choose the rows anew; False if they are the same.

        Raises:
            SingularError: there are fewer than there were.
        """
        assert self._system is not None
        before, chosen = self._system.chosen, self._select()
        if len(chosen) < len(before):
            raise SingularError(
                f"mechanism {self.mechanism.name!r}: singular configuration, {self.state}: the "
                f"loops lose {len(before) - len(chosen)} independent equation(s) there; the motion "
                "is not determined by the forces", state=self.state)
        self._system = _System(self.evaluation, chosen)
        return not np.array_equal(before, chosen)


def is_large(mechanism: Mechanism) -> bool:
    """Whether sparse factorisation is the faster one for a mechanism."""
    branches = len(mechanism.model.children[0])
    return mechanism.model.nv >= LARGE and branches >= 4
