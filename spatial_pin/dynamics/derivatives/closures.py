"""Closure rows and spring lengths of a motion, and how they change with q and v.

Rows are products A . B of vectors linear in the stacked placements G, so that

    d r'' = dA'' . B + A'' . dB + 2 (dA' . B' + A' . dB') + dA . B'' + A . dB''

with dG, dG' and dG'' from Pinocchio's derivatives of twists and accelerations, on joints whose
motion subspace is constant (`constraints.composite_joints`). As r'' = J a for v = 0, the same
function gives the derivatives of J column by column.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.closure_equations import TWIST_MATRIX
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composite_joints import SplitModel
from spatial_pin.constraints.pinocchio_views import acceleration_derivatives, twist_derivatives
from spatial_pin.dynamics.forces import Forces
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

Product = Callable[[int, int], Array]


class Rates(NamedTuple):
    """Products of vectors with their rates at a motion, and how these change with q and v.

    Attributes:
        values: (n,) of the products and of their first and second rates.
        by_q, by_v: (n, nv) derivatives of each of the three.
        placements: (njoints, 4, 3) columns of the rotation, then the position, of each joint.
        placements_by_q: (njoints, nv, 4, 3).
    """

    values: tuple[Array, Array, Array]
    by_q: tuple[Array, Array, Array]
    by_v: tuple[Array, Array, Array]
    placements: Array
    placements_by_q: Array


class Products:
    """Products A . B of vectors linear in the placements, and what they do when q and v change.

    Args:
        mechanism: the mechanism.
        a, b: (n, 4 njoints) coefficients.
    """

    def __init__(self, mechanism: Mechanism, whole: SplitModel, a: Array, b: Array) -> None:
        self.model, self.joints = whole
        self.nv, self.a, self.b = mechanism.model.nv, a, b
        self.data = self.model.createData()

    def rates(self, q: Array, v: Array, acceleration: Array) -> Rates:
        """Return the products' rates at a motion."""
        pin.computeForwardKinematicsDerivatives(self.model, self.data, q, v, acceleration)
        n = len(self.joints)
        g, by_q, by_v = np.zeros((3, n, 4, 3)), np.zeros((3, n, self.nv, 4, 3)), np.zeros(
            (3, n, self.nv, 4, 3))
        g[0, 0, :3] = np.eye(3)
        for i, joint in enumerate(self.joints[1:].tolist(), start=1):
            g[:, i], by_q[:, i], by_v[:, i] = self._body(joint)
        vectors = [[self._combined(c, x) for x in g] for c in (self.a, self.b)]
        changed = [[[self._combined(c, x) for x in d] for c in (self.a, self.b)]
                   for d in (by_q, by_v)]
        values = _leibniz(lambda k, m: np.vecdot(vectors[0][k], vectors[1][m]))
        of_q, of_v = (_leibniz(_change(vectors, d)) for d in changed)
        return Rates(values, of_q, of_v, g[0], by_q[0])

    @staticmethod
    def _combined(coefficients: Array, g: Array) -> Array:
        """Return coefficients @ G for G (njoints, 4, 3) or (njoints, nv, 4, 3)."""
        moved = np.moveaxis(g, 0, -3)  # (..., njoints, 4, 3)
        return coefficients @ moved.reshape(*moved.shape[:-3], 4 * moved.shape[-3], 3)

    def _body(self, joint: int) -> tuple[Array, Array, Array]:
        """Return G, G', G'' (3, 4, 3) of a body and their q and v derivatives (3, nv, 4, 3)."""
        data = self.data
        nu_by_q, _ = twist_derivatives(self.model, data, joint)
        g0 = data.oMi[joint].homogeneous[:3].T
        _, accel_by_q, accel_by_v, columns = acceleration_derivatives(
            self.model, data, joint)
        h, dh = _matrix(data.v[joint].vector), _matrix(data.a[joint].vector)
        g1 = h @ g0
        g2 = h @ g1 + dh @ g0
        moved = _matrix(columns.T) @ g0
        turned = _matrix(nu_by_q.T)
        first = turned @ g0 + h @ moved
        second = turned @ g1 + h @ first + _matrix(accel_by_q.T) @ g0 + dh @ moved
        pace = _matrix(columns.T)
        rate = pace @ g0
        by_v = np.stack([np.zeros_like(rate), rate,
                         pace @ g1 + h @ rate + _matrix(accel_by_v.T) @ g0])
        return np.stack([g0, g1, g2]), np.stack([moved, first, second]), by_v


def _matrix(twist: Array) -> Array:
    """Return the transposed 4 x 4 matrices of twists (..., 6)."""
    return (twist @ TWIST_MATRIX).reshape(*twist.shape[:-1], 4, 4)


def _change(vectors: list[list[Array]], changed: list[list[Array]]) -> Product:
    """Return the change (n, nv) of the k-th rate of A times the m-th of B, as a function."""
    (a, b), (da, db) = vectors, changed
    return lambda k, m: (np.vecdot(da[k], b[m]) + np.vecdot(a[k], db[m])).T


def _leibniz(product: Product) -> tuple[Array, Array, Array]:
    """Return A . B and its first two rates, from products of rates of A and B."""
    return (product(0, 0), product(1, 0) + product(0, 1),
            product(2, 0) + 2.0 * product(1, 1) + product(0, 2))


class Rows:
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
        n, width = len(c.constants), 4 * mechanism.model.njoints
        rows = c.c_abx if isinstance(c.c_abx, np.ndarray) else c.c_abx.toarray()
        lines = np.zeros((len(forces.lines), width))
        for row, line in zip(lines, forces.lines, strict=True):
            for sense, i, point in zip((-1.0, 1.0), line.bodies, line.points, strict=True):
                row[4 * i : 4 * i + 4] += sense * point
        a = np.vstack([rows[: self.closed], lines])
        b = np.vstack([rows[n : n + self.closed], 0.5 * lines])
        self.products = Products(mechanism, whole, a, b)

    def accelerations(self, rates: Rates) -> tuple[Array, Array]:
        """Return the derivatives (n_closure, nv) of the rows' second rates, in q and in v."""
        c = self.constraints
        out = np.zeros((2, c.n_closure, self.nv))
        for total, change in zip(out, (rates.by_q, rates.by_v), strict=True):
            total[: c.n_products] = change[2][: c.n_products]
            for group in c.composed:
                inputs = group.inputs([x[:, None] for x in rates.values], [], change)
                total[group.rows] = group.values(inputs)[0].change(2)
        return out[0], out[1]

    def curvature(self, q: Array) -> tuple[Array, Array]:
        """Return q derivatives of the Jacobian of the closure equations (n_closure, nv, nv).

        And of that of half the squared spring lengths (n_lines, nv, nv).
        """
        nv = self.nv
        units = [self.products.rates(q, np.zeros(nv), unit) for unit in np.eye(nv)]
        if not units:
            return np.zeros((0, 0, 0)), np.zeros((0, 0, 0))
        closed = [self.accelerations(rates)[0] for rates in units]
        lines = [rates.by_q[2][self.closed :] for rates in units]
        return np.stack(closed, axis=1), np.stack(lines, axis=1)
