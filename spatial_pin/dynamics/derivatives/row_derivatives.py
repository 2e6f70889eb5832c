"""Derivatives of closure rows and spring lengths with respect to q and v.

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
Motion = tuple[Array, Array, Array]  # q (nq,), v and a (nv,)
# Products of vectors of the same bodies: their numbers (k,), the bodies, the velocity entries (c,)
# that move these, coefficients (2, k, 4 bodies) of A and B; A and B (k, 3), and their q derivatives
# (c, k, 3).
Block = tuple[NDArray[np.intp], tuple[int, ...], NDArray[np.intp], Array,
              tuple[Array, Array], tuple[Array, Array]]


class BodiesOfTree:
    """Moving bodies of a tree, each in one of its subtrees.

    Args:
        whole: the tree with single joints.

    Attributes:
        parts: of the tree, see `constraints.trees`.
    """

    def __init__(self, whole: SplitModel) -> None:
        model, self.joints = whole
        self._model = model
        self.nv, self.parts = model.nv, parts_of(model)
        self.part, self.own = np.zeros((2, model.njoints), np.intp)
        self.column = np.zeros((2, model.nv), np.intp)  # part, and place there
        for k, part in enumerate(self.parts):
            self.part[part.joints], self.own[part.joints] = k, range(1, part.model.njoints)
            self.column[:, part.v] = np.array([[k] * len(part.v), range(len(part.v))])

    def at(self, body: int) -> tuple[Subtree, int]:
        """Return the subtree of a body, and the number of its joint there."""
        joint = self.joints[body]
        return self.parts[self.part[joint]], int(self.own[joint])

    def move(self, q: Array, v: Array, acceleration: Array) -> None:
        """Move the bodies to q, v and a."""
        for p in self.parts:
            pin.computeForwardKinematicsDerivatives(
                p.model, p.data, q[p.q], v[p.v], acceleration[p.v])

    def kinematics(self) -> tuple[Array, Array]:
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
        """Return G, G', G'' (3, 4, 3) of a body, and their derivatives.

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

    def body_wrenches(self, a_by: Array) -> Array:
        """Return the wrenches (njoints, 6, 1 + 3 nv) that move the bodies, and their derivatives.

        The wrenches W = X (I a + v x* I v) at the world's origin, then their derivatives by q, v
        and efforts, with X the force transformation of a body and a its acceleration less
        gravity. As it moves by a twist d of its own axes, d(X f) = X (df + d x* f)
        [Featherstone2008, 2.9].

        Args:
            a_by: (nv, 3 nv) derivatives of the joints' accelerations.
        """
        total = np.zeros((len(self.joints), 6, 1 + 3 * self.nv))
        for i, out in enumerate(total[1:], start=1):
            part, joint = self.at(i)
            model, data, at = part.model, part.data, 1 + part.v
            v_by_q, a_by_q, a_by_v, columns = acceleration_derivatives(model, data, joint)
            inertia, v = model.inertias[joint].matrix(), data.v[joint].vector
            pull = data.oMi[joint].rotation.T @ model.gravity.linear
            falling = np.zeros((6, model.nv))
            falling[:3] = pin.skew(pull) @ columns[3:]
            momentum = inertia @ v
            f = inertia @ (data.a[joint].vector - np.append(pull, np.zeros(3)))
            f += _dual(v) @ momentum
            turning = _bar(momentum) + _dual(v) @ inertia
            out[:, 0] = f
            out[:, at] = inertia @ (a_by_q - falling) + turning @ v_by_q + _bar(f) @ columns
            out[:, self.nv + at] = inertia @ a_by_v + turning @ columns
            out[:, 1:] += inertia @ columns @ a_by[part.v]
            out[:] = data.oMi[joint].toDualActionMatrix() @ out
        return total

    def axes(self) -> tuple[Array, Array]:
        """Return the world joint Jacobian (6, nv) and the angular velocities, (nv, 3, nv).

        The latter of what each coordinate's axis is fixed in.
        """
        model, columns = self._model, self.kinematics()[1]
        turned = np.zeros((self.nv, 3, self.nv))
        for i in range(1, model.njoints):
            own = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
            for j in list(model.supports[i])[1:]:
                at = slice(model.idx_vs[j], model.idx_vs[j] + model.nvs[j])
                turned[own, :, at] = columns[3:, at]
        return columns, turned


def _dual(v: Array) -> Array:
    """Return the matrix of v x* on forces, for a twist v (6,)."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = pin.skew(v[3:])
    out[3:, :3] = pin.skew(v[:3])
    return out


def _bar(f: Array) -> Array:
    """Return the matrix of d x* f on twists d, for a force f (6,)."""
    out = np.zeros((6, 6))
    out[:3, 3:] = out[3:, :3] = -pin.skew(f[:3])
    out[3:, 3:] = -pin.skew(f[3:])
    return out


class ProductDerivatives:
    """Products A . B of vectors linear in the placements, with their derivatives.

    Args:
        mechanism: the mechanism.
        whole: its model with single joints.
        a, b: of each product, its vectors.
        motion: q (nq,), v and a (nv,).

    Attributes:
        bodies: those of the tree, at the motion.
        values: (3, n) of the products and of their first and second rates.
        by_q, by_v: (3, n, nv) derivatives of each of the three.
        placements: (njoints, 4, 3) columns of the rotation, then the position, of each joint.
        twists: (nv, 4, 4) world twists of the coordinates.
    """

    def __init__(
        self, mechanism: Mechanism, whole: SplitModel, a: Sequence[Coefficients],
        b: Sequence[Coefficients], motion: Motion,
    ) -> None:
        self.model, self.joints = whole
        self.nv, n = mechanism.model.nv, len(a)
        self.bodies = BodiesOfTree(whole)
        self.bodies.move(*motion)
        self.values, (self.by_q, self.by_v) = np.zeros((3, n)), np.zeros((2, 3, n, self.nv))
        rows_of: dict[tuple[int, ...], list[int]] = {}
        for row, vectors in enumerate(zip(a, b, strict=True)):
            rows_of.setdefault(tuple(sorted(set().union(*vectors))), []).append(row)
        self._blocks = [self._block(np.array(rows), bodies, a, b)
                        for bodies, rows in rows_of.items()]
        self.placements, columns = self.bodies.kinematics()
        self.twists = _matrix(columns.T).swapaxes(1, 2)

    def columns(self, bodies: Sequence[int]) -> NDArray[np.intp]:
        """Return the velocity entries that move some bodies, ascending."""
        model = self.model
        before = {j for body in bodies for j in model.supports[int(self.joints[body])]}
        return np.array([v for j in sorted(before - {0})
                         for v in range(model.idx_vs[j], model.idx_vs[j] + model.nvs[j])], np.intp)

    def _block(
        self, rows: NDArray[np.intp], bodies: tuple[int, ...], a: Sequence[Coefficients],
        b: Sequence[Coefficients],
    ) -> Block:
        """Work out the products of vectors of the same bodies."""
        columns, width = self.columns(bodies), 4 * len(bodies)
        both = np.zeros((2, len(rows), len(bodies), 4))
        for stacked, vectors in zip(both, (a, b), strict=True):
            for at, row in zip(stacked, rows, strict=True):
                for body, x in vectors[row].items():
                    at[bodies.index(body)] = x
        coefficients = both.reshape(2, len(rows), width)
        g, by_q, by_v = np.zeros((3, width, 3)), *np.zeros((2, 3, len(columns), width, 3))
        for k, body in enumerate(bodies):
            own = slice(4 * k, 4 * k + 4)
            if body:
                moved, g[:, own], *changes = self.bodies.body(body, columns)
                by_q[:, moved, own], by_v[:, moved, own] = changes
            else:
                g[0, 4 * k : 4 * k + 3] = np.eye(3)
        levels, of_q, of_v = ([(coefficients[0] @ x, coefficients[1] @ x) for x in part]
                              for part in (g, by_q, by_v))
        self.values[:, rows] = _leibniz(
            lambda k, m: np.vecdot(levels[k][0], levels[m][1]))
        for total, changed in ((self.by_q, of_q), (self.by_v, of_v)):
            total[:, rows[:, None], columns] = _leibniz(
                lambda k, m, changed=changed: (  # type: ignore[misc]
                    np.vecdot(changed[k][0], levels[m][1])
                    + np.vecdot(levels[k][0], changed[m][1])).T)
        return rows, bodies, columns, coefficients, levels[0], of_q[0]

    def first_slopes(self, row: int) -> Array:
        """Return the q derivatives (c, 3) of the first vector of a product."""
        slopes_of: Array = next(slopes[0][:, rows == row] for rows, *_, slopes in self._blocks
                            if row in rows)
        return slopes_of[:, 0]

    def second_derivatives(self, weights: Array) -> Array:
        """Return second q derivatives (nv, nv) of a weighted sum of the products."""
        total, carried = np.zeros((self.nv, self.nv)), np.zeros((self.model.njoints, 4, 4))
        for rows, bodies, columns, coefficients, (a, b), (da, db) in self._blocks:
            weight = weights[rows, None]
            both = (da * weight).reshape(len(da), -1) @ db.reshape(len(db), -1).T
            total[np.ix_(columns, columns)] += both + both.T
            slopes = coefficients[0].T @ (weight * b) + coefficients[1].T @ (weight * a)
            for body, slope in zip(bodies, slopes.reshape(-1, 4, 3), strict=True):
                placed = self.placements[body].T @ slope
                carried[self.joints[body], :3, :3] += placed
                carried[self.joints[body], 3, :3] += slope[3]
        for joint in range(self.model.njoints - 1, 0, -1):
            carried[self.model.parents[joint]] += carried[joint]
        joint_of = np.repeat(np.arange(self.model.njoints), self.model.nvs)
        moved = (self.twists @ carried[joint_of]).swapaxes(1, 2)
        by_turning: Array = self.twists.reshape(-1, 16) @ moved.reshape(-1, 16).T
        is_before = self._are_before(joint_of)
        same = joint_of[:, None] == joint_of
        total += np.where(is_before | same, by_turning, 0.0).T
        return total + np.where(is_before, by_turning, 0.0)

    def _are_before(self, joint_of: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return (nv, nv) whether a velocity entry is of a joint that carries that of another.

        Args:
            joint_of: (nv,) the joint of every entry.
        """
        model, is_before = self.model, np.zeros((self.nv, self.nv), dtype=bool)
        for joint in range(1, model.njoints):
            own = slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
            parent = model.parents[joint]
            if parent:
                is_before[:, own] = is_before[:, [model.idx_vs[parent]]]
                is_before[joint_of == parent, own] = True
        return is_before


def _matrix(twist: Array) -> Array:
    """Return the transposed 4 x 4 matrices of twists (..., 6)."""
    return (twist @ TWIST_MATRIX).reshape(*twist.shape[:-1], 4, 4)


def _leibniz(product: Product) -> Array:
    """Return A . B and its first two rates, from products of rates of A and B."""
    return np.stack([product(0, 0), product(1, 0) + product(0, 1),
                     product(2, 0) + 2.0 * product(1, 1) + product(0, 2)])


class RowDerivatives:
    """Closure rows and springs between frames at a motion, with their derivatives.

    Products are those of closure equations, then from `closed` on half the squared spring lengths.

    Args:
        mechanism: the mechanism.
        whole: its model with single joints.
        forces: its springs.
        motion: q (nq,), v and a (nv,).
    """

    def __init__(
        self, mechanism: Mechanism, whole: SplitModel, forces: Forces, motion: Motion
    ) -> None:
        self.constraints = c = constraints_of(mechanism)
        self.whole, self.motion, self.nv = whole, motion, mechanism.model.nv
        self.closed, self.forces = c.passive_at, forces
        n = len(c.constants)
        vectors: list[Coefficients] = [{} for _ in range(c.c_abx.shape[0])]
        if isinstance(c.c_abx, np.ndarray):
            rows, columns = np.nonzero(c.c_abx)
            entries = zip(rows.tolist(), columns.tolist(), c.c_abx[rows, columns], strict=True)
        else:
            sparse = c.c_abx.tocoo()
            entries = zip(sparse.row.tolist(), sparse.col.tolist(), sparse.data, strict=True)
        for row, column, x in entries:
            vectors[row].setdefault(column // 4, np.zeros(4))[column % 4] += x
        a, b = vectors[: self.closed], vectors[n : n + self.closed]
        for line in forces.lines:
            ends: Coefficients = {}
            for sense, i, point in zip((-1.0, 1.0), line.bodies, line.points, strict=True):
                ends[i] = ends.get(i, np.zeros(4)) + sense * point
            a.append(ends)
            b.append({i: 0.5 * x for i, x in ends.items()})
        for bushing in forces.bushings:
            more = bushing.products
            a += more[0]
            b += more[1]
        self.products = ProductDerivatives(mechanism, whole, a, b, motion)
        self.products.values[0][: self.closed] -= c.constants[: self.closed]

    def changes(self, order: int) -> tuple[Array, Array]:
        """Return the derivatives (n_closure, nv) of the rows' rates of an order, in q and in v."""
        c, products = self.constraints, self.products
        out = np.zeros((2, c.n_closure, self.nv))
        values, motion = ([x[:, None] for x in part] for part in (products.values, self.motion))
        for k, change in enumerate((products.by_q, products.by_v)):
            out[k, : c.n_products] = change[order][: c.n_products]
            moved = [np.zeros((self.nv, self.nv))] * 3
            moved[k] = np.eye(self.nv)
            for group in c.composed:
                inputs = group.inputs(values, motion, list(change), moved)
                out[k, group.rows] = group.values(inputs)[0].change(order)
        return out[0], out[1]

    def joint_rows(self) -> tuple[Array, Array]:
        """Return derivatives (k, nv) of equations by the joint coordinates in them.

        And the q derivatives (k, nv, nv) of these.
        """
        c = self.constraints
        rows, changes = np.zeros((c.n_closure, self.nv)), np.zeros((c.n_closure, self.nv, self.nv))
        for group in c.composed:
            slopes = self._slopes(group)[len(group.products) :]
            for v, (by, change) in zip(group.coordinates[1], slopes, strict=True):
                np.add.at(rows, (group.rows, v), by)
                np.add.at(changes, (group.rows, v), change)
        return rows[c.of_joints], changes[c.of_joints]

    def _slopes(self, group: Composed) -> list[tuple[Array, Array]]:
        """Return derivatives (m,) by products and coordinates, and how they change (m, nv)."""
        products = [self.products.values[0][:, None, None], self.products.by_q[0][:, None]]
        coordinates = [self.motion[0][:, None, None], np.eye(self.nv)[:, None]]
        m = len(group.rows)
        return [(np.broadcast_to(x.values[0], (m, 1, 1))[:, 0, 0],
                 np.broadcast_to(x.values[1], (m, 1, self.nv))[:, 0])
                for x in group.slopes(products, coordinates)]

    def second_derivatives(self, multipliers: Array, pulls: Array) -> Array:
        """Return q derivatives (nv, nv) of the joint forces of rows and springs of constant size.

        Args:
            multipliers: (n_closure,) of the closure rows.
            pulls: of the springs, by half their squared lengths, and by the products of bushings.
        """
        c, by_q = self.constraints, self.products.by_q[0]
        weights, along = np.zeros(len(by_q)), np.zeros((self.nv, self.nv))
        weights[c.plain], weights[self.closed :] = multipliers[c.plain], pulls
        for group in c.composed:
            own, slopes = multipliers[group.rows], self._slopes(group)
            for at, (by, change) in zip(group.products, slopes, strict=False):
                np.add.at(weights, at, own * by)
                along += (own[:, None] * by_q[at]).T @ change
            n = len(group.products)
            for v, (_, change) in zip(group.coordinates[1], slopes[n:], strict=True):
                np.add.at(along, v, own[:, None] * change)
        return along + self.products.second_derivatives(weights)
