"""Accelerations by Gauss's principle of least constraint, for masses of any ratio.

Of all accelerations a = a0 + G z that the loops allow, those happen for which

    1/2 sum_b ( m |c''_b - g|^2 + |I^(1/2) (w'_b + I^-1 (w x I w))|^2 ) - f . G z

is least [Gauss1829; UdwadiaKalaba1996], c'' and w' a body's accelerations, f the joint forces
given; an armature A of a joint coordinate x adds 1/2 A x''^2. Solved by QR of the bodies' own
rows, the heaviest first, no mass matrix is ever formed: in that a light body's part is rounded away
beside a heavy one's [GolubVanLoan, 6.2.5].
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from spatial_pin.dynamics.saddle import HOLDS, ROUNDING, own_units
from spatial_pin.kinematics.views import own_jacobian
from spatial_pin.linalg import Array, decompose, null_space

LEFT = 1e-12  # part of a motion, by the largest, that is what round-off of the loops has left


class LeastConstraint:
    """The bodies of a mechanism, at whose accelerations the constraint is least.

    Args:
        model: the tree.
        scale: (nv,) velocity of a unit of each scaled unknown.
    """

    def __init__(self, model: pin.Model, scale: Array) -> None:
        self._model, self._data, self._scale = model, model.createData(), scale
        self._bodies = []
        for joint, body in enumerate(model.inertias):
            if joint and (body.mass > 0.0 or np.any(body.inertia)):
                moments, axes = np.linalg.eigh(body.inertia)
                axes[:, 0] *= np.linalg.det(axes)  # right-handed: products of rates are to come
                self._bodies.append((joint, body.lever.copy(), axes,
                                     np.sqrt([body.mass] * 3 + np.maximum(moments, 0.0).tolist())))

        self._rotors = np.flatnonzero(model.armature)
        self._weights = np.sqrt(model.armature[self._rotors])

    def solve(
        self, q: Array, v: Array, a: Array, columns: Array, given: Array
    ) -> tuple[Array, Array, bool]:
        """Return the accelerations of freedoms; motions without inertia go on as they are.

        Args:
            q: (nq,) configuration.
            v: (nv,) joint velocities.
            a: (nv,) joint accelerations at which the freedoms have none.
            columns: (nv, n) joint velocities of unit freedoms.
            given: (nv,) joint forces.

        Returns:
            (n,) accelerations; (k, n) motions without inertia; whether forces work on one of them.
        """
        parts = np.abs(columns / self._scale[:, None])
        columns = np.where(parts > LEFT * parts.max(axis=0), columns, 0.0)
        rows, rest, terms = self._rows(q, v, a, columns)
        own = np.linalg.norm(rows, axis=0)
        rows[:, own <= ROUNDING * terms] = 0.0
        unit = own_units((rows * rows).sum(axis=0))
        rows *= unit
        load = unit * (columns.T @ given)
        order = np.argsort(-np.abs(rows).max(axis=1))
        z, still = _least(rows[order], -rest[order], load)
        if not len(still):
            return unit * z, still, False
        sizes = unit * (np.abs(columns).T @ np.abs(given))
        pulled = bool(np.any(np.abs(still @ load) > HOLDS * (np.abs(still) @ sizes)))
        z, still = unit * z, still * unit
        z = z + self._spinning_on(q, v, a + columns @ z, columns @ still.T) @ still
        return z, still, pulled

    def _spinning_on(self, q: Array, v: Array, a: Array, motions: Array) -> Array:
        """Return the accelerations (k,) of motions (nv, k) without inertia, on top of a (nv,).

        None; but a body that only spins on a ball joint keeps its spin about its line, as it would
        if it were a light ball. A component of its angular velocity, kept instead, would have it
        spin without bound where the line turns away from that.
        """
        model, data = self._model, self._data
        lines = []
        for joint, nv in enumerate(model.nvs):
            entries = slice(model.idx_vs[joint], model.idx_vs[joint] + nv)
            if nv == 3 and np.abs(motions[entries]).any():
                spins = null_space(np.delete(motions, entries, 0) / np.abs(motions).max())
                lines += [(joint, entries, motions[entries] @ spin) for spin in spins]
        if not lines:
            return np.zeros(motions.shape[1])
        pin.forwardKinematics(model, data, q, v, a)
        rows = np.array([line @ motions[entries] for _, entries, line in lines])
        rest = np.array([line @ data.a[joint].angular for joint, _, line in lines])
        largest = np.abs(rows).max()
        return decompose(rows / largest).minimum_norm(-rest / largest)

    def _rows(self, q: Array, v: Array, a: Array, columns: Array) -> tuple[Array, Array, Array]:
        """Return weighted accelerations per unit freedom (m, n), without (m,), and terms (n,)."""
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, a)
        rotors = slice(6 * len(self._bodies), None)
        rows = np.zeros((rotors.start + len(self._rotors), columns.shape[1]))
        rest = np.zeros(len(rows))
        rows[rotors] = self._weights[:, None] * columns[self._rotors]
        rest[rotors] = self._weights * a[self._rotors]
        terms = np.abs(rows[rotors]).sum(axis=0)
        sizes = np.abs(columns)
        for k, (joint, lever, axes, weights) in enumerate(self._bodies):
            at, across = slice(6 * k, 6 * k + 6), pin.skew(lever)
            local = own_jacobian(model, data, joint)
            joined = np.abs(local)
            joined[:3] += np.abs(across) @ joined[3:]
            terms += weights.max() * (joined @ sizes).sum(axis=0)
            local[:3] -= across @ local[3:]
            local[3:] = axes.T @ local[3:]
            rows[at] = weights[:, None] * (local @ columns)
            rest[at] = weights * self._rest(joint, lever, axes)
            rest[6 * k + 3 : 6 * k + 6] += _gyroscopic(weights[3:], axes.T @ data.v[joint].angular)
        return rows, rest, terms

    def _rest(self, joint: int, lever: Array, axes: Array) -> Array:
        """Return the acceleration (6,) of a body's centre less gravity, and angular, own axes."""
        data = self._data
        w, turning = data.v[joint].angular, data.a[joint].angular
        found = np.empty(6)
        found[:3] = (data.a[joint].linear + cross(w, data.v[joint].linear)
                     + cross(turning, lever) + cross(w, cross(w, lever))
                     - data.oMi[joint].rotation.T @ self._model.gravity.linear)
        found[3:] = axes.T @ turning
        return found


def cross(a: Array, b: Array) -> Array:
    """Return a x b; `np.cross` takes ten times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                     a[0] * b[1] - a[1] * b[0]])


def _gyroscopic(roots: Array, w: Array) -> Array:
    """Return I^(-1/2) (w x I w) (3,), from the roots of the principal moments; 0 for none."""
    squares = roots * roots
    moved = np.array([(squares[2] - squares[1]) * w[1] * w[2],
                      (squares[0] - squares[2]) * w[2] * w[0],
                      (squares[1] - squares[0]) * w[0] * w[1]])
    return np.divide(moved, roots, out=np.zeros(3), where=roots > ROUNDING * roots.max())


def _least(rows: Array, rest: Array, load: Array) -> tuple[Array, Array]:
    """Return z (n,) with rows^T (rows z - rest) = load, of least norm, and what is free (k, n)."""
    n = rows.shape[1]
    if len(rows) < n:
        rows = np.vstack([rows, np.zeros((n - len(rows), n))])
        rest = np.concatenate([rest, np.zeros(len(rows) - len(rest))])
    qr, pivots, tau, _, _ = lapack.dgeqp3(np.asfortranarray(rows))
    turned = lapack.dormqr("L", "T", qr, tau, rest[:, None], 64 * n)[0][:, 0]
    upper, order = np.triu(qr[:n]), pivots - 1
    diagonal = np.abs(upper.diagonal())
    rank = int(np.count_nonzero(diagonal > ROUNDING * diagonal[0]))
    known, pulled = upper[:rank], load[order]
    z = np.zeros(n)
    if rank == n:
        z[order] = lapack.dtrtrs(known, turned[:n] + lapack.dtrtrs(known, pulled, trans=1)[0])[0]
        return z, np.zeros((0, n))
    svd = decompose(known, ROUNDING)
    z[order] = svd.minimum_norm(turned[:rank] + svd.minimum_norm_transposed(pulled))
    still = np.zeros((n - rank, n))
    still[:, order] = svd.null_space
    return z, still
