"""Closure rows and spring lengths of a motion, and how they change with q and v.

Rows are products A . B of vectors linear in the placements G of the bodies, so that

    d r'' = dA'' . B + A'' . dB + 2 (dA' . B' + A' . dB') + dA . B'' + A . dB''

with dG, dG' and dG'' from Pinocchio's derivatives of twists and accelerations, on joints whose
motion subspace is constant (`constraints.composite_joints`). Rows are worked out by blocks of the
same bodies, with the joints that carry these alone: the work grows with the loops.

Second derivatives are wanted of weighted sums of rows only. A body's placement M moves with the
world twists S of its joints as S M; a joint m moves with those before it, and its own l, as
d_l S_m = S_l S_m - S_m S_l. So of a sum with derivative C by G the columns m change with q_l by

    tr(S_l S_m D_m) for l up to m,   tr(S_m S_l D_l) for l beyond it

and by the products of dA with dB; D_m is the sum of M C over the bodies that m carries.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composed_equations import Composed
from spatial_pin.constraints.composite_joints import SplitModel
from spatial_pin.constraints.pinocchio_views import (
    TWIST_MATRIX,
    acceleration_derivatives,
    twist_derivatives,
)
from spatial_pin.constraints.trees import Subtree, parts_of
from spatial_pin.dynamics.forces import Forces
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

Product = Callable[[int, int], Array]
Coefficients = dict[int, Array]  # of a vector: (4,) by joint
Levels = list[tuple[Array, Array]]  # A and B, and their first and second rates


class Block(NamedTuple):
    """Products of vectors of the same bodies.

    Attributes:
        rows: (k,) their numbers.
        joints: of the bodies.
        columns: (c,) velocity entries that move these.
        a, b: (k, 4 len(joints)) coefficients.
    """

    rows: NDArray[np.intp]
    joints: tuple[int, ...]
    columns: NDArray[np.intp]
    a: Array
    b: Array


class ProductRates(NamedTuple):
    """Products of vectors with their rates at a motion, and how these change with q and v.

    Attributes:
        values: (n,) of the products and of their first and second rates.
        by_q, by_v: (n, nv) derivatives of each of the three.
        vectors: by block A and B (k, 3), and their q derivatives (c, k, 3).
        placements: (njoints, 4, 3) columns of the rotation, then the position, of each joint.
        twists: (nv, 4, 4) world twists of the coordinates.
        motion: q (nq,), v and a (nv,).
    """

    values: Array
    by_q: Array
    by_v: Array
    vectors: list[tuple[Array, Array, Array, Array]]
    placements: Array
    twists: Array
    motion: tuple[Array, Array, Array]


class BodiesOfTree:
    """Bodies of a tree that move, each told by the part of the tree that it is in.

    Args:
        whole: the tree with single joints.

    Attributes:
        parts: of the tree, see `constraints.trees`.
    """

    def __init__(self, whole: SplitModel) -> None:
        model, self.joints = whole
        self.nv, self.parts = model.nv, parts_of(model)
        self.part, self.own = np.zeros((2, model.njoints), np.intp)
        self.column = np.zeros((2, model.nv), np.intp)  # part, and place there
        for k, part in enumerate(self.parts):
            self.part[part.joints], self.own[part.joints] = k, range(1, part.model.njoints)
            self.column[:, part.v] = np.array([[k] * len(part.v), range(len(part.v))])

    def at(self, body: int) -> tuple[Subtree, int]:
        """Return the part of the tree that a body is in, and the number of its joint there."""
        joint = self.joints[body]
        return self.parts[self.part[joint]], int(self.own[joint])

    def move(self, q: Array, v: Array, acceleration: Array) -> None:
        """Take the bodies to a motion."""
        for p in self.parts:
            pin.computeForwardKinematicsDerivatives(
                p.model, p.data, q[p.q], v[p.v], acceleration[p.v])

    def places(self) -> tuple[Array, Array]:
        """Return placements (njoints, 4, 3), and the world joint Jacobian (6, nv)."""
        placements, columns = np.zeros((len(self.joints), 4, 3)), np.zeros((6, self.nv))
        placements[0, :3] = np.eye(3)
        for body in range(1, len(self.joints)):
            p, joint = self.at(body)
            placements[body] = p.data.oMi[joint].homogeneous[:3].T
        for p in self.parts:
            columns[:, p.v] = p.columns
        return placements, columns

    def body(
        self, body: int, columns: NDArray[np.intp]
    ) -> tuple[NDArray[np.bool_], Array, Array, Array]:
        """Return G, G', G'' (3, 4, 3) of a body, and how they change.

        Args:
            body: its joint.
            columns: (c,) velocity entries.

        Returns:
            Which of the columns are in its part of the tree; G with its rates; their derivatives
            (3, k, 4, 3) with respect to q and to v of these.
        """
        p, joint = self.at(body)
        is_own = self.column[0, columns] == self.part[self.joints[body]]
        at = self.column[1, columns[is_own]]
        nu_by_q, _ = twist_derivatives(p.model, p.data, joint)
        g0 = p.data.oMi[joint].homogeneous[:3].T
        _, accel_by_q, accel_by_v, moving = acceleration_derivatives(p.model, p.data, joint)
        h, dh = _matrix(p.data.v[joint].vector), _matrix(p.data.a[joint].vector)
        g1 = h @ g0
        g2 = h @ g1 + dh @ g0
        pace, turned, by_q, by_v = (
            _matrix(x[:, at].T) for x in (moving, nu_by_q, accel_by_q, accel_by_v))
        moved = pace @ g0
        first = turned @ g0 + h @ moved
        second = turned @ g1 + h @ first + by_q @ g0 + dh @ moved
        of_v = np.stack([np.zeros_like(moved), moved, pace @ g1 + h @ moved + by_v @ g0])
        return is_own, np.stack([g0, g1, g2]), np.stack([moved, first, second]), of_v


class ProductDerivatives:
    """Products A . B of vectors linear in the placements, and what they do when q and v change.

    Args:
        mechanism: the mechanism.
        whole: its model with single joints.
        a, b: of each product, its vectors.
    """

    def __init__(
        self, mechanism: Mechanism, whole: SplitModel, a: Sequence[Coefficients],
        b: Sequence[Coefficients],
    ) -> None:
        self.model, self.joints = whole
        self.nv, self.n = mechanism.model.nv, len(a)
        self.bodies = BodiesOfTree(whole)
        rows_of: dict[tuple[int, ...], list[int]] = {}
        for row, vectors in enumerate(zip(a, b, strict=True)):
            rows_of.setdefault(tuple(sorted(set().union(*vectors))), []).append(row)
        self.blocks = [
            Block(np.array(rows), bodies, self.columns(bodies),
                  *(_stacked([x[r] for r in rows], bodies) for x in (a, b)))
            for bodies, rows in rows_of.items()]

    def columns(self, bodies: Sequence[int]) -> NDArray[np.intp]:
        """Return the velocity entries that move some bodies, ascending."""
        model = self.model
        before = {j for body in bodies for j in model.supports[int(self.joints[body])]}
        return np.array([v for j in sorted(before - {0})
                         for v in range(model.idx_vs[j], model.idx_vs[j] + model.nvs[j])], np.intp)

    def rates(self, q: Array, v: Array, acceleration: Array) -> ProductRates:
        """Return the products' rates at a motion."""
        self.bodies.move(q, v, acceleration)
        values, vectors = np.zeros((3, self.n)), []
        of_q, of_v = np.zeros((2, 3, self.n, self.nv))
        for block in self.blocks:
            levels, by_q, by_v = self._of_block(block)
            values[:, block.rows] = _leibniz(_products(levels))
            at = np.s_[:, block.rows[:, None], block.columns]
            of_q[at], of_v[at] = (_leibniz(_change(levels, x)) for x in (by_q, by_v))
            vectors.append((*levels[0], *by_q[0]))
        placements, columns = self.bodies.places()
        return ProductRates(values, of_q, of_v, vectors, placements,
                            _matrix(columns.T).swapaxes(1, 2), (q, v, acceleration))

    def _of_block(self, block: Block) -> tuple[Levels, Levels, Levels]:
        """Return A and B with their rates, and what these change by with q and with v."""
        width, nv = 4 * len(block.joints), len(block.columns)
        g, by_q, by_v = np.zeros((3, width, 3)), *np.zeros((2, 3, nv, width, 3))
        for k, body in enumerate(block.joints):
            own = slice(4 * k, 4 * k + 4)
            if body:
                at, g[:, own], *changes = self.bodies.body(body, block.columns)
                by_q[:, at, own], by_v[:, at, own] = changes
            else:
                g[0, 4 * k : 4 * k + 3] = np.eye(3)
        found = [[(block.a @ x, block.b @ x) for x in levels] for levels in (g, by_q, by_v)]
        return found[0], found[1], found[2]

    def first_slopes(self, rates: ProductRates, row: int) -> Array:
        """Return the q derivatives (c, 3) of the first vector of a product."""
        by_block = zip(self.blocks, rates.vectors, strict=True)
        found: Array = next(da[:, block.rows == row, :] for block, (_, _, da, _) in by_block
                            if row in block.rows)
        return found[:, 0]

    def bending(self, rates: ProductRates, weights: Array) -> Array:
        """Return q derivatives (nv, nv) of the q derivatives of the weighted sum of products.

        Args:
            rates: at the configuration.
            weights: (n,) of the products.
        """
        total, carried = np.zeros((self.nv, self.nv)), np.zeros((self.model.njoints, 4, 4))
        for block, (a, b, da, db) in zip(self.blocks, rates.vectors, strict=True):
            weight = weights[block.rows, None]
            both = (da * weight).reshape(len(da), -1) @ db.reshape(len(db), -1).T
            total[np.ix_(block.columns, block.columns)] += both + both.T
            slopes = block.a.T @ (weight * b) + block.b.T @ (weight * a)
            for body, slope in zip(block.joints, slopes.reshape(-1, 4, 3), strict=True):
                placed = rates.placements[body].T @ slope
                carried[self.joints[body], :3, :3] += placed
                carried[self.joints[body], 3, :3] += slope[3]
        for joint in range(self.model.njoints - 1, 0, -1):
            carried[self.model.parents[joint]] += carried[joint]
        return total + self._turned(rates.twists, carried)

    def _turned(self, twists: Array, carried: Array) -> Array:
        """Return what the weighted sum changes by as joints move with those before them."""
        model = self.model
        joint_of = np.repeat(np.arange(model.njoints), model.nvs)
        moved = (twists @ carried[joint_of]).swapaxes(1, 2)
        found: Array = twists.reshape(-1, 16) @ moved.reshape(-1, 16).T
        is_before = np.zeros((self.nv, self.nv), dtype=bool)
        for joint in range(1, model.njoints):
            own = slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
            parent = model.parents[joint]
            if parent:
                is_before[:, own] = is_before[:, [model.idx_vs[parent]]]
                is_before[joint_of == parent, own] = True
        same = joint_of[:, None] == joint_of
        return np.where(is_before | same, found, 0.0).T + np.where(is_before, found, 0.0)


def _stacked(vectors: list[Coefficients], bodies: Sequence[int]) -> Array:
    """Return the coefficients (k, 4 len(bodies)) of vectors."""
    found = np.zeros((len(vectors), len(bodies), 4))
    for row, vector in zip(found, vectors, strict=True):
        for body, x in vector.items():
            row[bodies.index(body)] = x
    return found.reshape(len(vectors), -1)


def _matrix(twist: Array) -> Array:
    """Return the transposed 4 x 4 matrices of twists (..., 6)."""
    return (twist @ TWIST_MATRIX).reshape(*twist.shape[:-1], 4, 4)


def _products(levels: Levels) -> Product:
    """Return the product (k,) of the k-th rate of A with the m-th of B, as a function."""
    return lambda k, m: np.vecdot(levels[k][0], levels[m][1])


def _change(levels: Levels, changed: Levels) -> Product:
    """Return the change (k, c) of the k-th rate of A times the m-th of B, as a function."""
    return lambda k, m: (np.vecdot(changed[k][0], levels[m][1])
                         + np.vecdot(levels[k][0], changed[m][1])).T


def _leibniz(product: Product) -> Array:
    """Return A . B and its first two rates, from products of rates of A and B."""
    return np.stack([product(0, 0), product(1, 0) + product(0, 1),
                     product(2, 0) + 2.0 * product(1, 1) + product(0, 2)])


class RowDerivatives:
    """Closure rows and springs between frames, with their derivatives.

    Products are those of closure equations, then from `closed` on half the squared spring lengths.

    Args:
        mechanism: the mechanism.
        whole: its model with single joints.
        forces: its springs.
    """

    def __init__(self, mechanism: Mechanism, whole: SplitModel, forces: Forces) -> None:
        self.constraints = c = constraints_of(mechanism)
        self.nv, self.closed, self.forces = mechanism.model.nv, c.passive_at, forces
        n = len(c.constants)
        found = _vectors(c.c_abx)
        a, b = found[: self.closed], found[n : n + self.closed]
        for line in forces.lines:
            ends: Coefficients = {}
            for sense, i, point in zip((-1.0, 1.0), line.bodies, line.points, strict=True):
                ends[i] = ends.get(i, np.zeros(4)) + sense * point
            a.append(ends)
            b.append({i: 0.5 * x for i, x in ends.items()})
        self.products = ProductDerivatives(mechanism, whole, a, b)

    def changes(self, rates: ProductRates, order: int) -> tuple[Array, Array]:
        """Return the derivatives (n_closure, nv) of the rows' rates of an order, in q and in v."""
        c = self.constraints
        out = np.zeros((2, c.n_closure, self.nv))
        for total, change in zip(out, (rates.by_q, rates.by_v), strict=True):
            total[: c.n_products] = change[order][: c.n_products]
            still = np.zeros((self.nv, self.nv))
            moved = [still, still, still]
            moved[0 if change is rates.by_q else 1] = np.eye(self.nv)
            for group in c.composed:
                inputs = group.inputs(
                    [x[:, None] for x in rates.values], [x[:, None] for x in rates.motion],
                    list(change), moved)
                total[group.rows] = group.values(inputs)[0].change(order)
        return out[0], out[1]

    def joint_rows(self, rates: ProductRates) -> tuple[Array, Array]:
        """Return the derivatives (k, nv) of equations by joint coordinates as such.

        And how they change with q (k, nv, nv).
        """
        c = self.constraints
        rows, changes = np.zeros((c.n_closure, self.nv)), np.zeros((c.n_closure, self.nv, self.nv))
        for group in c.composed:
            slopes = self._slopes(group, rates)[len(group.products) :]
            for v, (by, change) in zip(group.coordinates[1], slopes, strict=True):
                np.add.at(rows, (group.rows, v), by)
                np.add.at(changes, (group.rows, v), change)
        return rows[c.of_joints], changes[c.of_joints]

    def _slopes(self, group: Composed, rates: ProductRates) -> list[tuple[Array, Array]]:
        """Return derivatives (m,) by products and coordinates, and how they change (m, nv)."""
        products = [rates.values[0][:, None, None], rates.by_q[0][:, None]]
        coordinates = [rates.motion[0][:, None, None], np.eye(self.nv)[:, None]]
        m = len(group.rows)
        return [(np.broadcast_to(x.values[0], (m, 1, 1))[:, 0, 0],
                 np.broadcast_to(x.values[1], (m, 1, self.nv))[:, 0])
                for x in group.slopes(products, coordinates)]

    def bending(self, rates: ProductRates, multipliers: Array, pulls: Array) -> Array:
        """Return q derivatives (nv, nv) of the joint forces of rows and springs, kept as strong.

        Args:
            rates: at the configuration.
            multipliers: (n_closure,) of the closure rows.
            pulls: (n_lines,) of the springs, by half their squared lengths.
        """
        c = self.constraints
        weights, along = np.zeros(self.products.n), np.zeros((self.nv, self.nv))
        weights[c.plain], weights[self.closed :] = multipliers[c.plain], pulls
        for group in c.composed:
            own, slopes = multipliers[group.rows], self._slopes(group, rates)
            for at, (by, change) in zip(group.products, slopes, strict=False):
                np.add.at(weights, at, own * by)
                along += (own[:, None] * rates.by_q[0][at]).T @ change
            n = len(group.products)
            for v, (_, change) in zip(group.coordinates[1], slopes[n:], strict=True):
                np.add.at(along, v, own[:, None] * change)
        return along + self.products.bending(rates, weights)


def _vectors(matrix: Any) -> list[Coefficients]:
    """Return the rows (4 njoints) of a matrix, dense or sparse, by joint."""
    found: list[Coefficients] = [{} for _ in range(matrix.shape[0])]
    if isinstance(matrix, np.ndarray):
        rows, columns = np.nonzero(matrix)
        values = matrix[rows, columns]
    else:
        entries = matrix.tocoo()
        rows, columns, values = entries.row, entries.col, entries.data
    for row, column, x in zip(rows.tolist(), columns.tolist(), values.tolist(), strict=True):
        found[row].setdefault(column // 4, np.zeros(4))[column % 4] += x
    return found
