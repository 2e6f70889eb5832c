"""Derivatives of the constrained dynamics, by implicit differentiation.

The equations M a + b - f - J^T lambda = 0 and r'' = J a + gamma = 0 are differentiated with
respect to q, v and f; the unknown derivatives of a and lambda solve the same linear system as a and
lambda do. Those of M a + b are Pinocchio's, on joints whose motion subspace is constant
(`kinematics.split`). Rows are products A . B of vectors linear in the stacked placements G, so that

    d r'' = dA'' . B + A'' . dB + 2 (dA' . B' + A' . dB') + dA . B'' + A . dB''

with dG, dG' and dG'' from Pinocchio's derivatives of twists and accelerations. As r'' = J a for
v = 0, the same function gives the derivatives of J column by column.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.dynamics.forces import Forces
from spatial_pin.dynamics.forward import forward_dynamics
from spatial_pin.kinematics.constraints import TWIST_MATRIX, constraints_of
from spatial_pin.kinematics.jacobians import closure_jacobian
from spatial_pin.kinematics.split import SplitModel, split_of
from spatial_pin.kinematics.state import State, of_mechanism
from spatial_pin.linalg import Array, independent_rows
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.mechanism.mechanism import Mechanism

LOCAL = pin.ReferenceFrame.LOCAL
Product = Callable[[int, int], Array]


class Derivatives(NamedTuple):
    """Derivatives of `forward_dynamics` at a state.

    Changes of q are joint velocities (the tangent of `pin.integrate`). Where loops are
    overconstrained, a_by_q dq + a_by_v dv holds for changes that keep the loops closed, in position
    and in velocity; the multipliers are those of `rows` alone, the others being zero.

    Attributes:
        a: (nv,) the accelerations.
        a_by_q, a_by_v, a_by_effort: (nv, nv).
        rows: indices of the independent closure rows.
        multipliers: (len(rows),) of these rows.
        multipliers_by_q, multipliers_by_v, multipliers_by_effort: (len(rows), nv).
    """

    a: Array
    a_by_q: Array
    a_by_v: Array
    a_by_effort: Array
    rows: NDArray[np.intp]
    multipliers: Array
    multipliers_by_q: Array
    multipliers_by_v: Array
    multipliers_by_effort: Array


class _Rates(NamedTuple):
    """Values, first and second rates of products (n,), with their derivatives (n, nv)."""

    values: tuple[Array, Array, Array]
    by_q: tuple[Array, Array, Array]
    by_v: tuple[Array, Array, Array]


class _Products:
    """Products A . B of vectors linear in the placements, and what they do when q and v change.

    Args:
        mechanism: the mechanism.
        a, b: (n, 4 njoints) coefficients.
    """

    def __init__(self, mechanism: Mechanism, whole: SplitModel, a: Array, b: Array) -> None:
        self.model, self.joints = whole
        self.nv, self.a, self.b = mechanism.model.nv, a, b
        self.data = self.model.createData()

    def rates(self, q: Array, v: Array, acceleration: Array) -> _Rates:
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
        return _Rates(_leibniz(lambda k, m: np.vecdot(vectors[0][k], vectors[1][m])),
                      *(_leibniz(_change(vectors, d)) for d in changed))

    @staticmethod
    def _combined(coefficients: Array, g: Array) -> Array:
        """Return coefficients @ G for G (njoints, 4, 3) or (njoints, nv, 4, 3)."""
        moved = np.moveaxis(g, 0, -3)  # (..., njoints, 4, 3)
        return coefficients @ moved.reshape(*moved.shape[:-3], -1, 3)

    def _body(self, joint: int) -> tuple[Array, Array, Array]:
        """Return G, G', G'' (3, 4, 3) of a body and their derivatives by q and v (3, nv, 4, 3)."""
        data = self.data
        nu_by_q, _ = pin.getJointVelocityDerivatives(self.model, data, joint, LOCAL)
        g0 = data.oMi[joint].homogeneous[:3].T
        _, accel_by_q, accel_by_v, columns = pin.getJointAccelerationDerivatives(
            self.model, data, joint, LOCAL)
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


class _Rows:
    """Closure rows and springs between frames, with their derivatives.

    Args:
        mechanism: the mechanism.
        whole: its model with single joints.
    """

    def __init__(self, mechanism: Mechanism, whole: SplitModel) -> None:
        self.constraints = c = constraints_of(mechanism)
        self.nv, self.closed = mechanism.model.nv, c.passive_at
        forces = Forces(mechanism)
        n, width = len(c.constants), 4 * mechanism.model.njoints
        rows = c.c_abx if isinstance(c.c_abx, np.ndarray) else c.c_abx.toarray()
        lines = np.zeros((len(forces.lines), width))
        for row, line in zip(lines, forces.lines, strict=True):
            for sense, i, point in zip((-1.0, 1.0), line.bodies, line.points, strict=True):
                row[4 * i : 4 * i + 4] += sense * point
        a = np.vstack([rows[: self.closed], lines])
        b = np.vstack([rows[n : n + self.closed], 0.5 * lines])
        self.products = _Products(mechanism, whole, a, b)

    def accelerations(self, rates: _Rates) -> tuple[Array, Array]:
        """Return the derivatives (n_rows, nv) of the rows' second rates by q and v."""
        c = self.constraints
        out = np.zeros((2, c.n_rows, self.nv))
        for total, change in zip(out, (rates.by_q, rates.by_v), strict=True):
            total[: c.n_products] = change[2][: c.n_products]
            for at, sine, pitch in c.screws:
                z, dz, ddz = (x[sine + 1] + 1j * x[sine] for x in rates.values)
                cz, cdz, cddz = (x[sine + 1] + 1j * x[sine] for x in change)
                turn = cddz / z - ddz * cz / z**2 - 2.0 * dz / z * (cdz / z - dz * cz / z**2)
                total[at] -= pitch * turn.imag
        return out[0], out[1]

    def curvature(self, q: Array) -> tuple[Array, Array]:
        """Return derivatives by q of the Jacobian of the closure rows (n_rows, nv, nv).

        And of that of half the squared spring lengths (n_lines, nv, nv).
        """
        closed, lines = [], []
        for unit in np.eye(self.nv):
            rates = self.products.rates(q, np.zeros(self.nv), unit)
            closed.append(self.accelerations(rates)[0])
            lines.append(rates.by_q[2][self.closed :])
        return np.stack(closed, axis=1), np.stack(lines, axis=1)


def _spring_slopes(
    mechanism: Mechanism, rows: _Rows, rates: _Rates, curvature: Array
) -> tuple[Array, Array]:
    """Return the derivatives (nv, nv) of the springs' joint forces by q and v."""
    by_q, by_v = np.zeros((2, rows.nv, rows.nv))
    springs = {spring.name: spring for spring in mechanism.springs}
    forces = Forces(mechanism)
    for turn in forces.turns:
        by_q[turn.v, turn.v] -= springs[turn.name].stiffness
        by_v[turn.v, turn.v] -= springs[turn.name].damping
    for k, line in enumerate(forces.lines):
        at, spring = rows.closed + k, springs[line.name]
        length = float(np.sqrt(2.0 * rates.values[0][at]))
        slope, rate = rates.by_q[0][at] / length, rates.values[1][at] / length
        rate_by_q = (rates.by_q[1][at] - rate * slope) / length
        bend = (curvature[k] - np.outer(slope, slope)) / length
        along = spring.stiffness * slope + spring.damping * rate_by_q
        by_q -= np.outer(slope, along) + line.law(length, rate) * bend
        by_v -= spring.damping * np.outer(slope, slope)
    return by_q, by_v


def dynamics_derivatives(
    mechanism: Mechanism, state: State, efforts: Mapping[str, float] | None = None
) -> Derivatives:
    """Differentiate `forward_dynamics` with respect to q, v and joint efforts.

    Args:
        mechanism: the mechanism, with its springs and gravity.
        state: configuration and velocity.
        efforts: by driver, joint or coordinate [N·m, N].

    Returns:
        The Derivatives.

    Raises:
        SingularError: as `forward_dynamics`.
        UnknownNameError: a name does not exist.
    """
    state = of_mechanism(mechanism, state)
    answer = forward_dynamics(mechanism, state, efforts)
    q, v, a, nv = state.q, state.v, answer.a, mechanism.model.nv
    whole = split_of(mechanism)
    rows = _Rows(mechanism, whole)
    rates = rows.products.rates(q, v, a)
    closed_by_q, closed_by_v = rows.accelerations(rates)
    curvature, bends = rows.curvature(q)
    jacobian = closure_jacobian(mechanism, q)
    scale = mechanism.velocity_scale
    chosen = independent_rows(jacobian * scale)
    spring_by_q, spring_by_v = _spring_slopes(mechanism, rows, rates, bends)
    inertias = MassMatrix(whole.model)
    data = inertias.model.createData()
    force_by_q, force_by_v = (inertias.unit * x for x in pin.computeRNEADerivatives(
        inertias.model, data, q, v, a)[:2])
    mass = inertias(q)
    borne = jacobian.T @ answer.multipliers
    multipliers = np.linalg.lstsq(jacobian[chosen].T * scale[:, None], borne * scale,
                                  rcond=None)[0]
    force_by_q -= np.tensordot(multipliers, curvature[chosen], 1) + spring_by_q
    force_by_v -= spring_by_v
    rhs = -np.hstack([np.vstack([force_by_q, closed_by_q[chosen]]),
                      np.vstack([force_by_v, closed_by_v[chosen]]),
                      np.vstack([-np.eye(nv), np.zeros((len(chosen), nv))])])
    x = _solved(mass, jacobian[chosen], scale, rhs)
    by_q, by_v, by_effort = np.split(x, 3, axis=1)
    return Derivatives(a, by_q[:nv], by_v[:nv], by_effort[:nv], chosen, multipliers, by_q[nv:],
                       by_v[nv:], by_effort[nv:])


def _solved(mass: Array, jacobian: Array, scale: Array, rhs: Array) -> Array:
    """Return the solution of [M -J^T; J 0] x = rhs, for many right-hand sides."""
    nv, r = len(scale), len(jacobian)
    scaled = scale[:, None] * mass * scale
    heaviest = float(np.abs(scaled).max(initial=0.0)) or 1.0
    a = jacobian * scale
    k = np.zeros((nv + r, nv + r))
    k[:nv, :nv], k[:nv, nv:], k[nv:, :nv] = scaled / heaviest, -a.T, a
    scaled_rhs = np.vstack([scale[:, None] * rhs[:nv] / heaviest, rhs[nv:]])
    x = np.linalg.solve(k, scaled_rhs)
    return np.vstack([scale[:, None] * x[:nv], heaviest * x[nv:]])
