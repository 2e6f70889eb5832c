"""Derivatives of closure rows and spring lengths with respect to q and v.

Rows are products A . B of vectors linear in the placements G of the bodies, so that

    d r'' = dA'' . B + A'' . dB + 2 (dA' . B' + A' . dB') + dA . B'' + A . dB''

and of a body's placement G with the matrices S, dS, ... of `TreeMotion` and those of its own twist
V and acceleration A,

    G' = V G,  G'' = (V V + A) G
    by q: dG = S G, dG' = S G' + dS G, dG'' = S G'' + 2 dS G' + (A x S + V x dS) G
    by v: dG' = S G, dG'' = 2 S G' + (dS + v x S) G

Rows are worked out by blocks of the same bodies, with the joints that carry these alone: the work
grows with the loops.

Second derivatives are wanted of weighted sums of rows only. A body's placement M moves with the
world twists S of its joints as S M; a joint m moves with those before it, and its own l, as
d_l S_m = S_l S_m - S_m S_l. So of a sum with derivative C by G the columns m change with q_l by

    tr(S_l S_m D_m) for l up to m,   tr(S_m S_l D_l) for l beyond it

and by the products of dA with dB; D_m is the sum of M C over the bodies that m carries.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composed_equations import Composed
from spatial_pin.constraints.pinocchio_views import TWIST_MATRIX
from spatial_pin.constraints.tree_motion import Motion, TreeMotion
from spatial_pin.dynamics.forces import Forces
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

Product = Callable[[int, int], Array]
Coefficients = dict[int, Array]  # of a vector: (4,) by joint
# Products of vectors of the same bodies: their numbers (k,), the bodies, the velocity entries (c,)
# that move these, coefficients (2, k, 4 bodies) of A and B; A and B (k, 3), and their q derivatives
# (c, k, 3).
Block = tuple[NDArray[np.intp], tuple[int, ...], NDArray[np.intp], Array,
              tuple[Array, Array], tuple[Array, Array]]


class ProductDerivatives:
    """Products A . B of vectors linear in the placements, with their derivatives.

    Args:
        mechanism: the mechanism.
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
        self, mechanism: Mechanism, a: Sequence[Coefficients], b: Sequence[Coefficients],
        motion: Motion,
    ) -> None:
        self.bodies = tree = TreeMotion(mechanism, motion)
        self.nv, n, self.placements = mechanism.model.nv, len(a), tree.placements
        self.twists = _matrix(tree.columns).swapaxes(1, 2)
        self._rates = _matrix(np.stack([tree.columns, tree.turned, tree.twice, tree.paced]))
        self.values, (self.by_q, self.by_v) = np.zeros((3, n)), np.zeros((2, 3, n, self.nv))
        rows_of: dict[tuple[int, ...], list[int]] = {}
        for row, vectors in enumerate(zip(a, b, strict=True)):
            rows_of.setdefault(tuple(sorted(set().union(*vectors))), []).append(row)
        self._blocks = [self._block(np.array(rows), bodies, a, b)
                        for bodies, rows in rows_of.items()]

    def columns(self, bodies: Sequence[int]) -> NDArray[np.intp]:
        """Return the velocity entries that move some bodies, ascending."""
        tree = self.bodies
        return np.flatnonzero(tree.moved_by[tree.joints[list(bodies)]].any(axis=0))

    def _body(
        self, body: int, columns: NDArray[np.intp]
    ) -> tuple[NDArray[np.bool_], Array, Array, Array]:
        """Return G, G', G'' (3, 4, 3) of a body, and how they change.

        Args:
            body: its joint.
            columns: (c,) velocity entries.

        Returns:
            Which of the columns move it; G with its rates; their derivatives (3, k, 4, 3) with
            respect to q and to v of these.
        """
        tree, joint = self.bodies, self.bodies.joints[body]
        is_own = tree.moved_by[joint, columns]
        s, turned, twice, paced = self._rates[:, columns[is_own], :, :3]
        twist, accel = _matrix(np.stack([tree.v[joint], tree.a[joint]]))[..., :3]
        g = np.zeros((3, 4, 4))
        g[0, :, :3], g[0, 3, 3] = self.placements[body], 1.0
        g[1, :, :3] = g[0] @ twist
        g[2, :, :3] = g[1] @ twist + g[0] @ accel
        moved = g[0] @ s
        by_q = np.stack([
            moved, g[1] @ s + g[0] @ turned, g[2] @ s + 2.0 * (g[1] @ turned) + g[0] @ twice])
        by_v = np.stack([np.zeros_like(moved), moved, 2.0 * (g[1] @ s) + g[0] @ paced])
        return is_own, g[..., :3], by_q, by_v

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
                moved, g[:, own], *changes = self._body(body, columns)
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
        """Return the q derivatives (nv, 3) of the first vector of a product."""
        total = np.zeros((self.nv, 3))
        for rows, _, columns, *_, slopes in self._blocks:
            if row in rows:
                total[columns] = slopes[0][:, rows == row][:, 0]
        return total

    def second_derivatives(self, weights: Array) -> Array:
        """Return q derivatives (nv, nv) of the q derivatives of the products' sum by weights."""
        tree, joint_of = self.bodies, self.bodies.joint_of
        total, carried = np.zeros((self.nv, self.nv)), np.zeros((tree.model.njoints, 4, 4))
        for rows, bodies, columns, coefficients, (a, b), (da, db) in self._blocks:
            weight = weights[rows, None]
            both = np.tensordot(da * weight, db, ((1, 2), (1, 2)))
            total[np.ix_(columns, columns)] += both + both.T
            slopes = coefficients[0].T @ (weight * b) + coefficients[1].T @ (weight * a)
            for body, slope in zip(bodies, slopes.reshape(-1, 4, 3), strict=True):
                placed = self.placements[body].T @ slope
                carried[tree.joints[body], :3, :3] += placed
                carried[tree.joints[body], 3, :3] += slope[3]
        for joint in range(tree.model.njoints - 1, 0, -1):
            carried[tree.model.parents[joint]] += carried[joint]
        moved = (self.twists @ carried[joint_of]).swapaxes(1, 2)
        by_turning: Array = self.twists.reshape(-1, 16) @ moved.reshape(-1, 16).T
        is_up_to = tree.moved_by[joint_of].T
        total += np.where(is_up_to, by_turning, 0.0).T
        is_before = is_up_to & (joint_of[:, None] != joint_of)
        return total + np.where(is_before, by_turning, 0.0)



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
        forces: its springs.
        motion: q (nq,), v and a (nv,).
        angles: (n_angles,) that counted ones are nearest to [rad].
    """

    def __init__(
        self, mechanism: Mechanism, forces: Forces, motion: Motion, angles: Array
    ) -> None:
        self.constraints, self.angles = (c := constraints_of(mechanism)), angles
        self.motion, self.nv = motion, mechanism.model.nv
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
        self.products = ProductDerivatives(mechanism, a, b, motion)
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
                out[k, group.rows] = group.values(inputs, self.angles)[0].change(order)
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
                for x in group.slopes(products, coordinates, self.angles)]

    def take_bending(self, total: Array, multipliers: Array, pulls: Array) -> None:
        """Subtract the q derivatives (nv, nv) of joint forces of rows and springs, kept as strong.

        Args:
            total: what they are subtracted from.
            multipliers: (n_closure,) of the closure rows.
            pulls: of the springs, by half their squared lengths, and by the products of bushings.
        """
        c, by_q = self.constraints, self.products.by_q[0]
        weights = np.zeros(len(by_q))
        weights[c.plain], weights[self.closed :] = multipliers[c.plain], pulls
        for group in c.composed:
            own, slopes = multipliers[group.rows], self._slopes(group)
            for at, (by, change) in zip(group.products, slopes, strict=False):
                np.add.at(weights, at, own * by)
                total -= (own[:, None] * by_q[at]).T @ change
            n = len(group.products)
            for v, (_, change) in zip(group.coordinates[1], slopes[n:], strict=True):
                np.subtract.at(total, v, own[:, None] * change)
        if len(weights):
            total -= self.products.second_derivatives(weights)
