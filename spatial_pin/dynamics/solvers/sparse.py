"""The equations of motion of mechanisms with many loops, by sparse factorisation.

The same equations as in `spatial_pin.dynamics.solvers.equations`. Their cost grows with the number
of loops; which rows are independent is found once, and again where one of them depends on the
others or an equation that was left out does not hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.newton import Regular
from spatial_pin.assembly.state import State
from spatial_pin.constraints.subtrees import PiecewiseRows
from spatial_pin.dynamics.forces import Law
from spatial_pin.dynamics.solvers.equations import Equations
from spatial_pin.dynamics.solvers.kkt import HOLDS, jacobi_scaling, round_off
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import RANK_TOLERANCE, Array, Decomposition, independent_rows
from spatial_pin.numerics.sparse_spaces import SparseSpaces

PROBED = 128  # freedoms up to which the rank of the loops is found by trying configurations nearby
STAYS = 1e-6  # what an equation left out may lack for a motion of unit size, by that of its terms
UNSURE = 1e-10  # smallest over largest pivot below which the equations are solved densely


class _System:
    """The matrix of the equations of motion for a choice of closure rows, with its pattern.

    Args:
        rows: the closure rows.
        chosen: indices of the independent ones.
    """

    def __init__(self, rows: PiecewiseRows, chosen: NDArray[np.intp]) -> None:
        from scipy.sparse import csc_array  # imported on use: it takes a tenth of a second

        nv, self.chosen = rows.model.nv, chosen
        self._sizes: Array | None = None
        self._place = place = np.full(rows.constraints.n_rows, -1)
        place[chosen] = nv + np.arange(len(chosen))
        self._own = np.flatnonzero(place[rows.row_at] >= 0)
        at, columns = place[rows.row_at[self._own]], rows.column_at[self._own]
        i, j = rows.mass_entries()
        where = np.concatenate([i, at, columns]), np.concatenate([j, columns, at])
        n = nv + len(chosen)
        numbered = csc_array((np.arange(1.0, len(where[0]) + 1.0), where), shape=(n, n))
        self._order = numbered.data.astype(np.intp) - 1
        self.matrix: Any = numbered

    def sizes(self, row_at: NDArray[np.intp], values: Array) -> Array:
        """Return the sizes of all rows from their entries, always those of the first time."""
        if self._sizes is None:  # of rows that shrink to nothing later, nothing is to be left
            self._sizes = np.sqrt(np.bincount(row_at, values * values, len(self._place)))
            self._sizes[self._sizes == 0.0] = 1.0
        return self._sizes

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

    With more than `PROBED` freedoms the rank of the loops is not found by closing them nearby. A
    configuration is refused there if rows that depend on others do not go on doing so: if for a
    motion v that the loops allow J a = -gamma(v) has no solution (second-order analysis
    [ConnellyWhiteley1996]).
    """

    evaluation: PiecewiseRows  # type: ignore[assignment]

    def _make_rows(self) -> None:
        self.evaluation = PiecewiseRows(self.mechanism)
        self._columns = self.evaluation.data.J
        self._mass_at = self.evaluation.mass_entries()
        self._mass_scale = self.scale[self._mass_at[0]] * self.scale[self._mass_at[1]]
        self._diagonal = np.flatnonzero(self._mass_at[0] == self._mass_at[1])
        self._system: _System | None = None
        self._sparse: SparseSpaces | None = None

    def update(
        self, state: State, external: Mapping[str, pin.Force] | None = None,
        laws: Mapping[str, Law] | None = None, slip_speed: SlipSpeed | None = None,
    ) -> None:
        """Evaluate rows and given forces at a State of this mechanism, as `Equations` does."""
        super().update(state, external, laws, slip_speed)
        self._sparse = None

    @property
    def spaces(self) -> Decomposition | SparseSpaces:  # type: ignore[override]
        """Freedoms, self-stresses and what is between, of the closure rows at the state.

        Those of a rounded file, whose rank is that of fewer equations, and those of rows that are
        no sure choice, are found densely.
        """
        if self._rank is not None or self._svd is not None:
            return super().spaces
        if self._sparse is None:
            self._sparse = self._make_spaces()
        return self._sparse or super().spaces

    def _make_spaces(self) -> SparseSpaces | None:
        """Return the spaces for rows that are surely all the independent ones; None if in doubt."""
        rows = self.evaluation
        for anew in (self._system is None, True):
            if anew or self._system is None:
                self._system = _System(rows, self._select())
            found = SparseSpaces(rows.row_at, rows.column_at, rows.values,
                                 (self.n_rows, len(self.scale)), self._system.chosen)
            if found.is_sure:
                return found
        return None

    @property
    def self_stresses(self) -> Array:
        """(k, n_rows) multipliers that balance among themselves: some that have a part of each."""
        spaces = self.spaces
        return spaces.self_stresses if isinstance(spaces, SparseSpaces) else super().self_stresses

    def _couplings(self) -> Array:
        """Return the efforts (n_couplings, nv) at joints of unit multipliers of the couplings."""
        rows, n = self.evaluation, len(self.evaluation.constraints.couplings)
        found = np.zeros((n, len(self.scale)))
        first = self.n_rows - n
        own = rows.row_at >= first
        found[rows.row_at[own] - first, rows.column_at[own]] = rows.values[own]
        return found / self.scale

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
        state, rows, (i, j) = self.state, self.evaluation, self._mass_at
        gamma = rows.bias(state.q, state.v)
        mass = rows.mass(state.q)
        own = np.zeros(len(self.scale))
        own[i[self._diagonal]] = mass[self._diagonal]
        unit = jacobi_scaling(own * self.scale**2)
        d = unit * self.scale
        mass *= d[i]
        mass *= d[j]
        load = d * (force - self.motion_forces(np.zeros(len(d))))
        if self._system is None:
            self._system = _System(rows, self._select())
        x, holds = self._solve(mass, load, gamma, unit)
        if not holds and self._select_again():
            x, _ = self._solve(mass, load, gamma, unit)
        self.check_rank(len(self._system.chosen))
        if x is None:
            return super().accelerations(force)
        full = np.zeros(rows.constraints.n_rows)
        full[self._system.chosen] = x[len(d) :]
        return self.scale * x[: len(d)], -self._transposed(full) / self.scale

    def _learn(self) -> bool:
        """Stay with sparse factors, which are faster than Pinocchio's dense ones."""
        return False

    def check_rank(self, rank: int) -> None:
        """Refuse configurations in which the loops have lost rank, if that is cheap to know.

        Raises:
            SingularError: they have.
        """
        if self.model.nv <= PROBED:
            super().check_rank(rank)
        elif not self._is_known(self.state, rank):
            if self._system is None or len(self._system.chosen) != rank:
                self._system = _System(self.evaluation, self._select())
            if not self._stays():
                raise SingularError(
                    f"mechanism {self.mechanism.name!r}: {self.state}: singular configuration: the "
                    "loops lose independent equations there, so that the forces do not determine "
                    "the motion; start beside this configuration", state=self.state)
            self._regular = Regular(self.state.q.copy(), rank, 0.0)

    def _stays(self) -> bool:
        """Whether rows that depend on others here do so in motion, tried with a random one."""
        rows, (i, j) = self.evaluation, self._mass_at
        alike, n = (i == j).astype(float), rows.constraints.n_rows
        any_way = np.random.default_rng(3).standard_normal(len(self.scale))
        motion, _ = self._solve(alike, any_way, np.zeros(n))
        if motion is None:
            return True
        v = self.scale * motion[: len(self.scale)]
        return self._solve(alike, np.zeros_like(v), rows.bias(self.state.q, v), lack=STAYS)[1]

    def _solve(
        self, mass: Array, load: Array, gamma: Array, unit: Array | None = None,
        lack: float = HOLDS,
    ) -> tuple[Array | None, bool]:
        """Return scaled accelerations and multipliers, None if the equations are singular.

        And whether the closure rows that were left out hold as well.

        Args:
            mass: entries, for scaled velocities that are multiplied by `unit` once more.
            load: (nv,) forces, likewise.
            gamma: (n_rows,) of the rows.
            unit: (nv,), 1 if not given.
            lack: what a row left out may lack.
        """
        rows, system, n = self.evaluation, self._system, len(gamma)
        assert system is not None
        is_scaled = unit is not None
        unit = np.ones(len(load)) if unit is None else unit
        values = rows.values * unit[rows.column_at]
        size = system.sizes(rows.row_at, values) if is_scaled else np.ones(n)
        factors = system.factor(mass, values / size[rows.row_at])
        if factors is None:
            return None, False
        pivots = np.abs(factors.U.diagonal())
        pivot = float(pivots.min(initial=1.0) / pivots.max(initial=1.0))
        if not pivot >= UNSURE:
            return None, False
        self.error = round_off(pivot)
        rhs = np.concatenate([load, -gamma[system.chosen] / size[system.chosen]])
        x = factors.solve(rhs)
        x += factors.solve(rhs - system.matrix @ x)
        x[: len(unit)] *= unit
        x[len(unit) :] /= size[system.chosen]
        terms = rows.values * x[rows.column_at]
        lacking = np.abs(np.bincount(rows.row_at, terms, n) + gamma)
        total = np.abs(gamma) + np.bincount(rows.row_at, np.abs(terms), n)
        return x, bool(np.all(lacking <= lack * max(float(total.max(initial=0.0)), 1e-300)))

    def _transposed(self, multipliers: Array) -> Array:
        """Return the scaled joint forces (nv,) of multipliers (n_rows,)."""
        rows = self.evaluation
        terms = rows.values * multipliers[rows.row_at]
        return np.bincount(rows.column_at, terms, len(self.scale)).astype(np.float64)

    def _select(self) -> NDArray[np.intp]:
        """Return independent rows: of each closure by itself first, then of all if need be."""
        rows, labels = self.evaluation, self.evaluation.constraints.labels
        kept = [np.empty(0, dtype=np.intp)]
        for _, group in groupby(range(len(labels)), lambda k: labels[k].closure):
            of_closure = list(group)
            first, last = np.searchsorted(rows.row_at, (of_closure[0], of_closure[-1] + 1))
            columns, place = np.unique(rows.column_at[first:last], return_inverse=True)
            block = np.zeros((len(of_closure), len(columns)))
            block[rows.row_at[first:last] - of_closure[0], place] = rows.values[first:last]
            kept.append(independent_rows(block) + of_closure[0])
        local = np.concatenate(kept)
        if self._are_independent(local):
            return local
        return local[independent_rows(self.scaled[local])]

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
        """Choose the rows anew; False if they are the same."""
        assert self._system is not None
        before, chosen = self._system.chosen, self._select()
        self._system = _System(self.evaluation, chosen)
        return not np.array_equal(before, chosen)
