"""Derivatives of closure rows and spring lengths with respect to q and v.

Rows are products A . B of vectors linear in the placements of the bodies, or composed of such; the
kernel differentiates the products, see `tree_products.c`.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin._support.lazy import acquired, made_once
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composed_equations import Composed, composed_of
from spatial_pin.constraints.composite_joints import TreeArrays, single_joints
from spatial_pin.constraints.kernel_tree import centred_tree
from spatial_pin.constraints.trees import Motion, TreeMotion
from spatial_pin.dynamics.bushings import Coefficients
from spatial_pin.dynamics.forces import Forces
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class RowDerivatives:
    """Closure rows and springs between frames at a motion, with their derivatives.

    Products are those of closure equations, then from `closed` on half the squared spring lengths,
    then those of bushings.
    """

    def __init__(
        self, mechanism: Mechanism, forces: Forces, motion: Motion, angles: Array
    ) -> None:
        self.mechanism, self.constraints = mechanism, constraints_of(mechanism)
        self.motion, self.nv, self.forces = motion, mechanism.model.nv, forces
        self.angles = angles
        self.closed = self.constraints.passive_at
        self.of_products = products_of(mechanism)

    @property
    def values(self) -> Array:
        """(3, n) of the products and of their first and second rates."""
        return self._evaluated[0]

    @property
    def by_q(self) -> Array:
        """(3, n, nv) derivatives of each of the three by q."""
        return self._evaluated[1]

    @property
    def by_v(self) -> Array:
        """(3, n, nv) derivatives of each of the three by v."""
        return self._evaluated[2]

    @cached_property
    def _evaluated(self) -> tuple[Array, Array, Array]:
        n = self.of_products["n_products"]
        values, by_q, by_v = np.empty((3, n)), *np.zeros((2, 3, n, self.nv))
        with acquired(self.mechanism, centred_tree) as tree:
            tree.evaluate(*self.motion, **self.of_products, values=values, product_by_q=by_q,
                          product_by_v=by_v)
        values[0, : self.closed] -= self.constraints.constants[: self.closed]
        return values, by_q, by_v

    @cached_property
    def bodies(self) -> TreeMotion:
        """The bodies of the tree, at the motion."""
        return TreeMotion(self.mechanism, self.motion)

    @cached_property
    def placements(self) -> Array:
        """(njoints, 4, 3) columns of the rotation, then the position, of each joint."""
        with acquired(self.mechanism, centred_tree) as tree:
            n = len(tree.arrays.kind)
            rotations, positions = np.empty((n, 3, 3)), np.empty((n, 3))
            tree.evaluate(self.motion[0], R=rotations, p=positions)
            return tree.placed(rotations, positions)

    def force_changes(self, outside: Array, weights: Array, out: Array) -> None:
        """Find how joint forces that the motion needs change with q and v, less those of products.

        As `pin.computeRNEADerivatives` does, but for any joints.

        Args:
            outside: (joints, 6) wrenches that act on the bodies of single joints, world axes, about
                the joints' origins, and turn with them.
            weights: (n,) of the products, in whose sum the second derivatives are taken.
            out: (2, nv, nv) zeros, to be filled with the transposed derivatives by q and by v.
        """
        bent = np.zeros((self.nv, self.nv)) if weights.size else None
        with acquired(self.mechanism, centred_tree) as tree:
            tree.take_masses()
            tree.evaluate(*self.motion, **self.of_products, outside=outside, by_q=out[0],
                          by_v=out[1], weights=weights, bent=bent)
        if bent is not None:
            out[0] -= bent.T

    def changes(self, order: int) -> tuple[Array, Array]:
        """Return the derivatives (n_closure, nv) of the rows' rates of an order, in q and in v."""
        c = self.constraints
        if not composed_of(c):
            return self.by_q[order][: c.n_closure], self.by_v[order][: c.n_closure]
        out = np.zeros((2, c.n_closure, self.nv))
        values, motion = ([x[:, None] for x in part] for part in (self.values, self.motion))
        for k, change in enumerate((self.by_q, self.by_v)):
            out[k, c.plain] = change[order][c.product[c.plain]]
            moved = [np.zeros((self.nv, self.nv))] * 3
            moved[k] = np.eye(self.nv)
            for group in composed_of(c):
                inputs = group.inputs(values, motion, list(change), moved)
                out[k, group.rows] = group.values(inputs, self.angles)[0].change(order)
        return out[0], out[1]

    def joint_rows(self) -> tuple[Array, Array]:
        """Return derivatives (k, nv) of equations by the joint coordinates in them.

        And the q derivatives (k, nv, nv) of these.
        """
        c = self.constraints
        rows, changes = np.zeros((c.n_closure, self.nv)), np.zeros((c.n_closure, self.nv, self.nv))
        for group in composed_of(c):
            slopes = self._slopes(group)[len(group.products) :]
            for v, (by, change) in zip(group.coordinates[1], slopes, strict=True):
                np.add.at(rows, (group.rows, v), by)
                np.add.at(changes, (group.rows, v), change)
        return rows[c.of_joints], changes[c.of_joints]

    def _slopes(self, group: Composed) -> list[tuple[Array, Array]]:
        """Return derivatives (m,) by products and coordinates, and how they change (m, nv)."""
        products = [self.values[0][:, None, None], self.by_q[0][:, None]]
        coordinates = [self.motion[0][:, None, None], np.eye(self.nv)[:, None]]
        m = len(group.rows)
        return [(np.broadcast_to(x.values[0], (m, 1, 1))[:, 0, 0],
                 np.broadcast_to(x.values[1], (m, 1, self.nv))[:, 0])
                for x in group.slopes(products, coordinates, self.angles)]

    def weights(self, multipliers: Array, pulls: Array) -> tuple[Array, Array | None]:
        """Return the weights (n,) of the products in the sum of rows and springs, kept as strong.

        And q derivatives (nv, nv) of joint forces because the rows' derivatives by products and
        coordinates change, if they do.

        Args:
            multipliers: (n_closure,) of the closure rows.
            pulls: of the springs, by half their squared lengths, and by the products of bushings.
        """
        c = self.constraints
        if not (composed_of(c) or len(pulls)):
            return multipliers, None
        by_q = self.by_q[0]
        weights, total = np.zeros(len(by_q)), np.zeros((self.nv, self.nv))
        weights[c.product[c.plain]], weights[self.closed :] = multipliers[c.plain], pulls
        for group in composed_of(c):
            own, slopes = multipliers[group.rows], self._slopes(group)
            for at, (by, change) in zip(group.products, slopes, strict=False):
                np.add.at(weights, at, own * by)
                total += (own[:, None] * by_q[at]).T @ change
            n = len(group.products)
            for v, (_, change) in zip(group.coordinates[1], slopes[n:], strict=True):
                np.add.at(total, v, own[:, None] * change)
        return weights, total


@made_once
def products_of(mechanism: Mechanism) -> dict[str, Any]:
    """Return the products of closure rows, of springs between frames, and of bushings.

    They are inputs of `KernelTree.evaluate`.
    """
    c, forces = constraints_of(mechanism), Forces(mechanism)
    a, b = list[Coefficients](), list[Coefficients]()
    for numbers, factors in zip(c.parts[: c.passive_at], c.part_factors, strict=False):
        for vectors, own in ((a, slice(0, 2)), (b, slice(2, 4))):
            vectors.append({})
            for number, factor in zip(numbers[own].tolist(), factors[own], strict=True):
                if number >= 0:
                    _, joint, flag, local = c.vectors[number]
                    vectors[-1][joint] = vectors[-1].get(joint, 0.0) + factor * np.append(
                        local, flag)
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
    return _packed(single_joints(mechanism), a, b)


def _packed(tree: TreeArrays, a: list[Coefficients], b: list[Coefficients]) -> dict[str, Any]:
    """Return products of vectors a and b for the kernel."""
    bodies, both = np.zeros((len(a), 2), np.int64), np.zeros((2, len(a), 2, 4))
    for row, vectors in enumerate(zip(a, b, strict=True)):
        joints = set().union(*vectors)
        carried = sorted(joints - {0}, reverse=True)
        if len(carried) > 2 or (len(carried) == 2 and 0 in joints):
            raise NotImplementedError("the kernel has no products of vectors on three bodies")
        for side, joint in enumerate([*carried, 0][:2]):
            body = bodies[row, side] = tree.carriers[joint]
            for parts, vector in zip(both, vectors, strict=True):
                if joint in vector:
                    parts[row, side, :3] = tree.frames[body].T @ vector[joint][:3]
                    parts[row, side, 3] = vector[joint][3]
    return {"n_products": len(a), "bodies": bodies, "a_parts": both[0], "b_parts": both[1]}
