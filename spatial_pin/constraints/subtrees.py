"""Closure rows and forces of large trees, sparse and piece by piece."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import (
    TWIST_MATRIX,
    combined_wrenches,
    composed_rates,
    constraints_of,
)
from spatial_pin.constraints.kinds import Equation
from spatial_pin.constraints.trees import TreeInPieces
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class PiecewiseRows:
    """Closure rows as `constraints.closure_equations.Evaluation` has them, sparse, piece by piece.

    Attributes:
        pieces: the tree.
        placements: (njoints, 4, 3) of the joints.
        row_at, column_at: (nnz,) places of the entries of the Jacobian of the `n_rows` rows.
        values: (nnz,) the entries, for scaled velocities.
        turns: angles of screw closures, not used.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self.model = mechanism, mechanism.model
        self.constraints = c = constraints_of(mechanism)
        self._tree = TreeInPieces(self.model)
        self.pieces, self.data = self._tree.pieces, self._tree.data
        self.placements, self._columns = self._tree.placements, self._tree.columns
        self._rest = np.zeros(self.model.nv)
        self.turns = np.zeros(c.n_angles)
        self._n = c.passive_at
        self._wrenches = np.zeros((self._n, 6))
        self._ab = c.c_abx[: 2 * len(c.constants)]
        self._make_pattern()

    def _make_pattern(self) -> None:
        c = self.constraints
        self._r, self._c = np.nonzero(c.signs[: self._n])
        self._signs = c.signs[self._r, self._c]
        self._own = np.isin(self._r, c.plain)
        self._of_product = np.split(np.arange(len(self._r)),
                                    np.searchsorted(self._r, np.arange(1, self._n)))
        self._patterns = [[self._pattern(e) for e in group.equations] for group in c.composed]
        rows = [np.full(len(columns), row) for group, patterns in zip(
            c.composed, self._patterns, strict=True)
            for row, (columns, _) in zip(group.rows, patterns, strict=True)]
        columns = [columns for patterns in self._patterns for columns, _ in patterns]
        self.row_at = np.concatenate([self._r[self._own], *rows])
        self.column_at = np.concatenate([self._c[self._own], *columns])

    def _pattern(self, equation: Equation) -> tuple[NDArray[np.intp], list[NDArray[np.intp]]]:
        """Return columns of an equation, and where those of its products and coordinates are."""
        parts = [self._c[self._of_product[at]] for at in equation.products]
        parts += [np.array([c.v]) for c in equation.coordinates]
        columns = np.unique(np.concatenate(parts))
        return columns, [np.searchsorted(columns, part) for part in parts]

    def update(self, q: Array) -> None:
        """Evaluate the rows' Jacobian at the configuration q (nq,)."""
        c, n = self.constraints, self._n
        self._tree.place(q)
        a, b, x = (c.c_abx @ self.placements.reshape(-1, 3)).reshape(3, -1, 3)[:, :n]
        self._a, self._b = a, b
        self._wrenches[:, :3] = b * c.factors[:n]
        self._wrenches[:, 3:] = np.cross(x, b)
        entries = np.vecdot(self._wrenches[self._r], self._columns.T[self._c]) * self._signs
        self._values = np.vecdot(a, b) - c.constants[:n]
        parts = [entries[self._own]]
        for group, patterns in zip(c.composed, self._patterns, strict=True):
            value, _ = group.values(group.seeded([self._values[:, None]], [q[:, None]]))
            slopes = np.broadcast_to(value.changes[0], (len(patterns), value.changes[0].shape[1]))
            for own, slope, equation in zip(patterns, slopes, group.equations, strict=True):
                parts.append(self._composed(equation, own, slope, entries))
        self.values = np.concatenate(parts)

    def _composed(
        self, equation: Equation, pattern: tuple[NDArray[np.intp], list[NDArray[np.intp]]],
        slopes: Array, entries: Array,
    ) -> Array:
        """Return the entries of an equation, from those of its products."""
        columns, places = pattern
        own = [entries[self._of_product[at]] for at in equation.products]
        own += [self.mechanism.velocity_scale[[c.v]] for c in equation.coordinates]
        out = np.zeros(len(columns))
        for at, slope, part in zip(places, slopes, own, strict=True):
            out[at] += slope * part
        return out

    @property
    def jacobian(self) -> Array:
        """(n_rows, nv) derivative of the rows with respect to scaled velocities."""
        dense = np.zeros((self.constraints.n_rows, self.model.nv))
        dense[self.row_at, self.column_at] = self.values
        return dense

    def row_wrenches(self) -> Array:
        """Return (n_wrenches, 6) as `Evaluation.row_wrenches`."""
        (found,) = combined_wrenches(self.constraints, [self._values[:, None]], [self._wrenches])
        return found

    def bias(self, q: Array, v: Array) -> Array:
        """Return (n_rows,) second derivatives of the rows at zero joint acceleration."""
        c, n = self.constraints, self._n
        tree = self._tree
        tree.move(q, v, self._rest)
        h, dh = ((x @ TWIST_MATRIX).reshape(-1, 4, 4) for x in (tree.twists, tree.accelerations))
        g1 = h @ self.placements
        g2 = h @ g1 + dh @ self.placements
        (a1, b1), (a2, b2) = ((self._ab @ g.reshape(-1, 3)).reshape(2, -1, 3)[:, :n]
                              for g in (g1, g2))
        second = np.vecdot(a2, self._b) + 2.0 * np.vecdot(a1, b1) + np.vecdot(self._a, b2)
        first = np.vecdot(a1, self._b) + np.vecdot(self._a, b1) if c.composed else second
        return composed_rates(c, [self._values, first, second], [q, v])

    # ------------------------------------------------------------ forces

    def mass_entries(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return places (rows, columns) of the entries that `mass` returns."""
        rows = [p.v[p.mass_at[0]] for p in self.pieces]
        columns = [p.v[p.mass_at[1]] for p in self.pieces]
        return np.concatenate(rows), np.concatenate(columns)

    def mass(self, q: Array) -> Array:
        """Return the entries (nnz,) of the mass matrix."""
        return np.concatenate([p.mass(q[p.q])[p.mass_at] for p in self.pieces])

    def motion_forces(self, q: Array, v: Array, a: Array) -> Array:
        """Return M a + b (nv,)."""
        total = np.empty(len(v))
        for p in self.pieces:
            total[p.v] = pin.rnea(p.model, p.data, q[p.q], v[p.v], a[p.v])
        return total

    def transmitted(self) -> Array:
        """Return (njoints, 6) forces through the joints, joint axes, at the last motion."""
        total = np.zeros((self.model.njoints, 6))
        for p in self.pieces:
            total[p.joints] = p.forces
        return total
