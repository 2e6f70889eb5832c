"""Closure rows, their Jacobians and rates of many configurations together.

The same equations as `constraints.closure_equations` evaluates one configuration at a time, over
flat arrays with the configurations along the last axis (`constraints.vectorised_tree`).
"""

from __future__ import annotations

from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.closure_equations import (
    Constraints,
    composed_rates,
    composed_rows,
)
from spatial_pin.constraints.sample_coefficients import Varying, times
from spatial_pin.constraints.vectorised_tree import FlatJoint, cross, dot, flat_tree_of
from spatial_pin.numerics.linalg import EPS, Array


class Placed(NamedTuple):
    """Bodies and rows at m configurations.

    Attributes:
        q: (nq, m).
        g: (njoints, 4, 5, m) placements, of `FlatTree.place`.
        a, b, x: (r, 5, m) vectors of the product rows.
        values: (r, m) of the product rows.
        residual: (n_rows, m) closure rows.
        angles: (n_angles, m) of screw closures, counting turns.
    """

    q: Array
    g: Array
    a: Array
    b: Array
    x: Array
    values: Array
    residual: Array
    angles: Array

    def take(self, which: NDArray[np.intp]) -> Placed:
        """Return some of the configurations."""
        return Placed(*(part[..., which] for part in self))

    def put(self, which: NDArray[np.intp], some: Placed) -> None:
        """Write some of the configurations."""
        for part, new in zip(self, some, strict=True):
            part[..., which] = new


class Batch:
    """The closure equations of a mechanism for many configurations.

    Attributes:
        tree: the tree without its loops.
        coefficients: (3 r, 4 bodies) of the vectors A, B, X of the r product rows on placements.
        constants: (r, 1) of the product rows; or (r, m), as the coefficients may be `Varying`.
        bodies: joints of the split model that carry the bodies.
    """

    def __init__(self, constraints: Constraints) -> None:
        self.mechanism = constraints.mechanism
        self.constraints = c = constraints
        self.tree = flat_tree_of(self.mechanism)
        self._n = n = len(c.constants)
        c_abx = c.c_abx.reshape(3 * n, self.mechanism.model.njoints, 4)
        bodies = np.flatnonzero(c_abx.any(axis=(0, 2)))
        self.bodies = self.tree.carrier[bodies]
        self._use(np.ascontiguousarray(c_abx[:, bodies]).reshape(3 * n, 4 * len(bodies)),
                  c.constants[:, None])
        self._spin_at = [self.tree.carrier[joint] for joint, _ in c.spins]

    def _use(self, coefficients: Any, constants: Array) -> None:
        self.coefficients, self.constants, n = coefficients, constants, 2 * self._n
        self._arms: list[Array] = [np.eye(3)] * len(self.bodies)
        if isinstance(coefficients, Varying):
            self._c_ab: Any = coefficients.until(n)
        else:
            self._arms, self._c_ab = _on_arms(coefficients[:n])
        counts = np.array([len(arms) for arms in self._arms], dtype=np.intp)
        self._carriers = np.repeat(self.bodies, counts)
        self._origins = np.cumsum(counts) + np.arange(len(counts))
        self._tips = np.setdiff1d(np.arange(self._c_ab.shape[1]), self._origins)

    def of_other_dimensions(
        self, joints: list[FlatJoint], coefficients: Any, constants: Array
    ) -> Batch:
        """Return the same equations with other constants, for each configuration its own."""
        other = copy(self)
        other.tree = copy(self.tree)
        other.tree.joints = joints
        other._use(coefficients, constants)
        return other

    def place(self, q: Array, near: Array) -> Placed:
        """Evaluate the rows at q (nq, m).

        Args:
            q: configurations.
            near: (n_angles, m) the angles of screw closures to which the turns are counted.
        """
        c, n = self.constraints, self._n
        g = self.tree.place(q)
        a, b, x = self._vectors(g).reshape(3, n, 5, q.shape[1])
        values = dot(a, b)
        values -= self.constants
        angles = np.empty((c.n_angles, q.shape[1]))
        residual = values[: c.n_products]
        if c.composed:
            residual = np.concatenate([residual, np.empty((len(c.couplings), q.shape[1]))])
        for group in c.composed:
            value, angle = group.values(group.inputs([values], [q]), near)
            residual[group.rows] = value.values[0]
            if angle is not None:
                angles[group.angles] = angle.values[0]
        return Placed(q, g, a, b, x, values, residual, angles)

    def _vectors(self, g: Array) -> Array:
        flat = 4 * len(self.bodies), 5, g.shape[3]
        return times(self.coefficients, g[self.bodies].reshape(flat))

    def _products(self, p: Placed) -> Array:
        """Return (r, nv, m) derivatives of the product rows."""
        c = self.constraints
        columns = self.tree.columns(p.g)
        moments = cross(p.x, p.b)[:, :3]
        moments[c.passive_at :] = p.b[c.passive_at :, :3]
        forces = p.b[:, :3] * c.factors[:, :, None]
        forces[c.passive_at :] = 0.0
        products = np.zeros((self._n, self.tree.nv, p.q.shape[1]))
        term = np.empty_like(products)
        for wrench, twist in ((forces, columns[:3]), (moments, columns[3:])):
            for k in range(3):
                products += np.multiply(wrench[:, k, None], twist[None, k], out=term)
        products *= c.signs[:, :, None]
        return products

    def jacobian(self, p: Placed) -> Array:
        """Return (n_rows + n_passive, nv, m) derivatives of the rows, for scaled velocities."""
        c, products = self.constraints, self._products(p)
        if not c.composed:
            return products
        out = np.zeros((c.n_rows + c.n_passive, *products.shape[1:]))
        out[: c.n_products], out[c.n_rows :] = products[: c.n_products], products[c.passive_at :]
        for group in c.composed:
            value, _ = group.values(group.seeded([p.values[:, None]], [p.q[:, None]]))
            out[group.rows] = composed_rows(group, value.changes[0], products,
                                            self.mechanism.velocity_scale)
        return out

    def bias(self, p: Placed, v: Array) -> tuple[Array, Array, Array]:
        """Return second derivatives at zero joint acceleration, and how the bodies move.

        Returns:
            (n_rows + n_passive, m) and the rates of `FlatTree.rates` at velocities v (nv, m).
        """
        c = self.constraints
        first, second = self.tree.rates(p.g, v)
        w, alpha = first[self._carriers, 0], second[self._carriers, 0]
        arms = np.concatenate([p.g[:0, 0], *(times(own, p.g[body, :3]) for own, body in
                                             zip(self._arms, self.bodies, strict=True))])
        swing = cross(w, arms)
        a1, b1 = self._rates(swing, first)
        a2, b2 = self._rates(cross(w, swing) + cross(alpha, arms), second)
        bias = dot(a2, p.b) + 2.0 * dot(a1, b1) + dot(p.a, b2)
        for k, at in enumerate(self._spin_at, start=c.passive_at):
            bias[k] = dot(p.b[k], second[at, 0])
        if c.composed:
            rate = dot(a1, p.b) + dot(p.a, b1)
            rows = composed_rates(c, [p.values, rate, bias], [p.q, v])
            bias = np.concatenate([rows, bias[c.passive_at :]])
        return bias, first, second

    def _rates(self, tips: Array, bodies: Array) -> Array:
        """Return rates (2, r, 5, m) of A and B, from those of the arms and of the bodies."""
        every = np.empty((self._c_ab.shape[1], *tips.shape[1:]))
        every[self._tips], every[self._origins] = tips, bodies[self.bodies, 1]
        found: Array = times(self._c_ab, every)
        return found.reshape(2, self._n, *tips.shape[1:])


def _on_arms(coefficients: Array) -> tuple[list[Array], Array]:
    """Return the arms of every body, and coefficients on arms and origins instead of placements.

    Arms (k, 3) are fixed in a body: one where all vectors of it have the same line, else its axes.
    """
    arms, parts = [], [coefficients[:, :0]]
    for k in range(0, coefficients.shape[1], 4):
        own = coefficients[:, k : k + 3]
        sizes = np.linalg.norm(own, axis=1)
        line = own[sizes.argmax()] / max(sizes.max(), np.finfo(float).tiny)
        off = np.abs(own - np.outer(own @ line, line))
        arms.append(line[None] if np.all(off <= 4.0 * EPS * sizes[:, None]) else np.eye(3))
        parts += [own @ arms[-1].T, coefficients[:, k + 3, None]]
    return arms, np.hstack(parts)
