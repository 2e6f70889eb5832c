"""Kinematics and dynamics of large trees, piece by piece.

A `pin.Data` takes memory with the cube of the number of freedoms (4 GB for 400), and some of its
algorithms time with the square. Branches that meet only at the ground know nothing of each other:
each piece is a model of a few of them. The results are those of the whole model, in its order.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

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
from spatial_pin.constraints.pinocchio_views import (
    accelerations,
    forces,
    joint_jacobian,
    placements,
    twists,
)
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

FREEDOMS = 32  # of a piece, at least, if there are so many branches


class Piece(NamedTuple):
    """Some branches of a tree as a model of their own.

    Attributes:
        model, data: of the branches.
        joints, q, v: places of its joints (but the ground), configuration and velocity in the
            whole model.
        mass: its mass matrix at a configuration.
        mass_at: (rows, columns) of the entries of its mass matrix that can be other than zero.
        placements, twists, accelerations, forces, columns: views on `data`.
        rest: zero velocity.
    """

    model: pin.Model
    data: pin.Data
    joints: NDArray[np.intp]
    q: NDArray[np.intp]
    v: NDArray[np.intp]
    mass: MassMatrix
    mass_at: tuple[NDArray[np.intp], NDArray[np.intp]]
    placements: Array
    twists: Array
    accelerations: Array
    forces: Array
    columns: Array
    rest: Array


def pieces_of(model: pin.Model) -> list[Piece]:
    """Return a model in pieces."""
    groups: list[list[int]] = [[]]
    size = 0
    for root in model.children[0]:
        if size >= FREEDOMS:
            groups.append([])
            size = 0
        branch = [int(i) for i in model.subtrees[root]]
        groups[-1] += branch
        size += sum(model.nvs[i] for i in branch)
    return [_piece(model, sorted(group)) for group in groups if group]


def _piece(whole: pin.Model, joints: list[int]) -> Piece:
    model = pin.Model()
    model.gravity = whole.gravity
    own = {0: 0}
    for i in joints:
        own[i] = model.addJoint(own[whole.parents[i]], whole.joints[i].extract(),
                                whole.jointPlacements[i], whole.names[i])
        model.inertias[own[i]] = whole.inertias[i]
    v = np.concatenate([np.arange(whole.nvs[i]) + whole.idx_vs[i] for i in joints])
    model.armature = whole.armature[v]
    data = model.createData()
    q = np.concatenate([np.arange(whole.nqs[i]) + whole.idx_qs[i] for i in joints])
    return Piece(model, data, np.array(joints), q, v, MassMatrix(model), _related(model),
                 placements(data)[1:], twists(data)[1:], accelerations(data)[1:], forces(data)[1:],
                 joint_jacobian(data, model.nv), np.zeros(model.nv))


def _related(model: pin.Model) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return (rows, columns) of freedoms of which one carries the other."""
    related = np.zeros((model.nv, model.nv), dtype=bool)
    for i in range(1, model.njoints):
        own = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
        for j in model.supports[i]:
            other = slice(model.idx_vs[j], model.idx_vs[j] + model.nvs[j])
            related[own, other] = related[other, own] = True
    rows, columns = np.nonzero(related)
    return rows, columns


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
        self.pieces = pieces_of(self.model)
        self.turns = np.zeros(c.n_angles)
        nj, nv, self._n = self.model.njoints, self.model.nv, c.passive_at
        self.placements = np.zeros((nj, 4, 3))
        self.placements[0, :3] = np.eye(3)
        self._twists, self._accelerations = np.zeros((nj, 6)), np.zeros((nj, 6))
        self._columns = np.zeros((6, nv))
        self.data = SimpleNamespace(J=self._columns)  # as far as joint_jacobian reads it
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
        for p in self.pieces:
            pin.computeJointJacobians(p.model, p.data, q[p.q])
            self.placements[p.joints] = p.placements
            self._columns[:, p.v] = p.columns
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
        for p in self.pieces:
            pin.forwardKinematics(p.model, p.data, q[p.q], v[p.v], p.rest)
            self._twists[p.joints], self._accelerations[p.joints] = p.twists, p.accelerations
        h, dh = ((x @ TWIST_MATRIX).reshape(-1, 4, 4) for x in (self._twists, self._accelerations))
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
