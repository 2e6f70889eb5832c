"""Accelerations by Gauss's principle of least constraint, for masses of any ratio.

Of all accelerations a = a0 + G z that the loops allow, those happen for which

    1/2 sum_b ( m |c''_b - g|^2 + |I^(1/2) (w'_b + I^-1 (w x I w))|^2 ) - f . G z

is least [Gauss1829; UdwadiaKalaba1996], c'' and w' a body's accelerations, f the joint forces
given; an armature A of a joint coordinate x adds 1/2 A x''^2. Solved by QR of the bodies' own
rows, the heaviest first, no mass matrix is ever formed: in that a light body's part is rounded away
beside a heavy one's [GolubVanLoan, 6.2.5]. Every row keeps its own relative accuracy
[CoxHigham1998], so it is bounded row by row how far entries may be off: a motion has no inertia if
no row of it is larger than that, however small its inertia is, and what the same bounds leave
uncertain of the accelerations is told with them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from spatial_pin.dynamics.saddle import HOLDS, ROUNDING, Blurred
from spatial_pin.linalg import EPS, Array, decompose, null_space, row_space
from spatial_pin.mechanism.mechanism import Mechanism


class Least(NamedTuple):
    """Where the constraint is least.

    Attributes:
        a: (nv,) joint accelerations.
        z: (n,) those of freedoms.
        still: (k, nv) motions without inertia; they go on as they are.
        pulled: whether forces work on one of them.
        off: (nv,) bounds on the round-off of a.
        error: the largest of them, by the size of a.
        lost: whether that is more than all that moves or pulls.
    """

    a: Array
    z: Array
    still: Array
    pulled: bool
    off: Array
    error: float
    lost: bool


class LeastConstraint:
    """The bodies of a mechanism, at whose accelerations the constraint is least.

    Args:
        mechanism: the mechanism.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._model = model = mechanism.model
        self._data, self._scale = model.createData(), mechanism.velocity_scale
        gravity = float(np.linalg.norm(model.gravity.linear))
        size = mechanism.characteristic_length
        self._falling, self._per_size = gravity / size, np.repeat([1.0 / size, 1.0], 3)
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
        self, q: Array, v: Array, a: Blurred, columns: Blurred, given: Array
    ) -> Least:
        """Return the accelerations of freedoms; motions without inertia go on as they are.

        Args:
            q: (nq,) configuration, the loops closed.
            v: (nv,) joint velocities.
            a: (nv,) joint accelerations at which the freedoms have none.
            columns: (nv, n) joint velocities of unit freedoms. What may be none in them is none.
            given: (nv,) joint forces.
        """
        columns = columns.plain()
        rows, known, rest, rest_known, unit = self._rows(q, v, a, columns)
        rows *= unit
        known *= unit
        moved = columns.value * unit
        blur = columns.blur * unit
        load = moved.T @ given
        order = np.argsort(-np.abs(rows).max(axis=1, initial=0.0))
        fit = _Fit(rows[order], known[order])
        z = fit.solve(-rest[order], load)
        still = fit.still
        allowed = np.abs(still) @ ((HOLDS * np.abs(moved) + blur).T @ np.abs(given))
        pulled = bool(np.any(np.abs(still @ load) > allowed))
        wide = fit.error(z, rest_known[order], blur.T @ np.abs(given)
                         + ROUNDING * np.abs(moved).T @ np.abs(given))
        off = a.blur + np.abs(moved) @ wide + blur @ np.abs(z)
        motions, found = moved @ still.T, a.value + moved @ z
        if len(still):
            y = self._spinning_on(q, v, found, motions)
            z, found = z + y @ still, found + motions @ y
        worst, size = (float(np.abs(x / self._scale).max(initial=0.0)) for x in (off, found))
        speed = v / self._scale
        natural = max(size, self._falling, speed.dot(speed))
        return Least(found, unit * z, motions.T, pulled, off,
                     worst / (size or natural or 1.0), worst > natural)

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

    def _rows(
        self, q: Array, v: Array, a: Blurred, columns: Blurred
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return weighted accelerations per unit freedom (m, n), and without (m,).

        Each with bounds on how far its entries may be off, and units of the freedoms (n,) at which
        some body moves by one: so scaled, no row is good for one freedom and too coarse for
        another.
        """
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q, v, a.value)
        n = columns.value.shape[1]
        twists, sizes = self._twists(columns, a, v)
        rotors = slice(6 * len(self._bodies), None)
        rows, known = np.zeros((2, rotors.start + len(self._rotors), n))
        rest, rest_known = np.zeros((2, len(rows)))
        turned = columns.value[self._rotors]
        rows[rotors] = self._weights[:, None] * turned
        known[rotors] = self._weights[:, None] * (
            columns.blur[self._rotors] + ROUNDING * np.abs(turned))
        rest[rotors] = self._weights * a.value[self._rotors]
        rest_known[rotors] = self._weights * (a.blur + ROUNDING * np.abs(a.value))[self._rotors]
        gravity = np.abs(model.gravity.linear)
        pace = np.abs(turned / self._scale[self._rotors, None]).max(axis=0, initial=0.0)
        for k, (joint, lever, axes, weights) in enumerate(self._bodies):
            at, across = slice(6 * k, 6 * k + 6), pin.skew(lever)
            local, size = twists[joint].copy(), sizes[joint].copy()
            local[:3] -= across @ local[3:]
            local[3:] = axes.T @ local[3:]
            size[:3] += np.abs(across) @ size[3:]
            size[3:] = np.abs(axes.T) @ size[3:]
            moves = np.abs(local) * np.where(weights > 0.0, self._per_size, 0.0)[:, None]
            np.maximum(pace, moves.max(axis=0), out=pace)
            rows[at] = weights[:, None] * local
            known[at] = weights[:, None] * size[:, :n]
            rest[at] = weights * self._rest(joint, lever, axes)
            rest[6 * k + 3 : 6 * k + 6] += _gyroscopic(weights[3:], axes.T @ data.v[joint].angular)
            moving, turning = size[:3, n + 1].max(), size[3:, n + 1].max()  # by its velocity
            size[:3, n] += moving * turning / ROUNDING + ROUNDING * (
                np.abs(data.oMi[joint].rotation.T) @ gravity)
            size[3:, n] += turning * turning / ROUNDING
            rest_known[at] = weights * size[:, n]
        return rows, known, rest, rest_known, 1.0 / np.where(pace > 0.0, pace, 1.0)

    def _twists(self, columns: Blurred, a: Blurred, v: Array) -> tuple[list[Array], list[Array]]:
        """Return what every joint's body moves like (6, n) in unit freedoms, its own axes.

        From body to body, which keeps what is nothing nothing, as a way by the world's axes does
        not. And bounds on how far that is off (6, n + 2): of these, of accelerations and velocity.
        """
        model, data = self._model, self._data
        n = columns.value.shape[1]
        off = np.column_stack([columns.blur + ROUNDING * np.abs(columns.value),
                               a.blur + ROUNDING * np.abs(a.value), ROUNDING * np.abs(v)])
        twists: list[Array] = [np.zeros((6, n))]
        sizes: list[Array] = [np.zeros((6, n + 2))]
        for joint in range(1, model.njoints):
            parent, placed = model.parents[joint], data.liMi[joint]
            back, across = placed.rotation.T, pin.skew(placed.translation)
            entries = slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
            own = np.reshape(data.joints[joint].S, (6, -1))
            twist, size = own @ columns.value[entries], np.abs(own) @ off[entries]
            if parent:
                before, bounds = twists[parent], sizes[parent]
                twist[:3] += back @ (before[:3] - across @ before[3:])
                twist[3:] += back @ before[3:]
                turned = np.abs(back)
                size[:3] += turned @ (bounds[:3] + np.abs(across) @ bounds[3:])
                size[3:] += turned @ bounds[3:]
                none, reach = _round_off(back), _round_off(across)
                moved, spun = np.abs(before[:3]), np.abs(before[3:])
                size[:3, :n] += none @ (moved + np.abs(across) @ spun) + turned @ (reach @ spun)
                size[3:, :n] += none @ spun
            twists.append(twist)
            sizes.append(size)
        return twists, sizes

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


def _round_off(placed: Array) -> Array:
    """Return the sizes of those entries of a rotation, or of arms, that may be none.

    A quarter turn in a file leaves a cosine of 6e-17 where there should be a zero.
    """
    sizes = np.abs(placed)
    return np.where(sizes < EPS * sizes.max(initial=0.0), sizes, 0.0)


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


class _Fit:
    """Least squares with rows of very different sizes, and unknowns that no row knows of.

    Args:
        rows: (m, n) the largest first.
        known: (m, n) how far their entries may be off.

    Attributes:
        still: (k, n) orthonormal changes of the unknowns that no row knows of.
    """

    def __init__(self, rows: Array, known: Array) -> None:
        m, n = rows.shape
        if m < n:
            rows, known = (np.vstack([x, np.zeros((n - m, n))]) for x in (rows, known))
        known = known + ROUNDING * np.abs(rows).max(axis=1, initial=0.0)[:, None]
        self._rows, self._known = rows, known
        qr, pivots, self._tau, _, _ = lapack.dgeqp3(np.asfortranarray(rows))
        self._qr, self._order, self._upper = qr, pivots - 1, np.triu(qr[:n])
        self._basis = lapack.dorgqr(qr[:, :n], self._tau)[0]
        rank, motions = n, self._following(n)
        while rank:  # the last unknowns are left out while they move nothing for certain
            found = self._following(rank - 1)
            off = known @ np.abs(found)
            off += np.abs(rows[:, self._order[: rank - 1]]) @ (self._pseudo(rank - 1) @ off)
            if np.any(np.abs(rows @ found) > off):
                break
            rank, motions = rank - 1, found
        self._rank = rank
        self.still = row_space(motions.T)

    def _following(self, rank: int) -> Array:
        """Return the motions (n, n - rank) of the last unknowns that the first ones make good."""
        n = self._rows.shape[1]
        found = np.zeros((n, n - rank))
        found[self._order[rank:]] = np.eye(n - rank)
        if rank:
            found[self._order[:rank]] = -self._solve(rank, self._upper[:rank, rank:])
        return found

    def _solve(self, rank: int, b: Array, transposed: bool = False) -> Array:
        """Return R^-1 b, or R^-T b, of the first unknowns."""
        if not rank or not b.size:
            return np.zeros((rank, *b.shape[1:]))
        x: Array = lapack.dtrtrs(self._upper[:rank, :rank], b, trans=int(transposed))[0]
        return x

    def _pseudo(self, rank: int) -> Array:
        """Return the sizes (rank, m) of the pseudo-inverse of the first unknowns' columns."""
        return np.abs(self._solve(rank, np.ascontiguousarray(self._basis.T[:rank])))

    def solve(self, rest: Array, load: Array) -> Array:
        """Return z (n,) with rows^T (rows z - rest) = load, of least norm."""
        n, r, first = len(load), self._rank, self._order[: self._rank]
        z = np.zeros(n)
        if r:
            full = np.concatenate([rest, np.zeros(len(self._rows) - len(rest))])
            turned, pull = self._turned(full, "T"), self._solve(r, load[first], transposed=True)
            z[first] = self._solve(r, turned[:r] + pull)
            turned[:r] = -pull
            self._left = self._turned(turned, "N")
        return z - self.still.T @ (self.still @ z)

    def _turned(self, x: Array, way: str) -> Array:
        """Return Q x (m,), or Q^T x."""
        turned: Array = lapack.dormqr(
            "L", way, self._qr, self._tau, x[:, None], 64 * len(self._order))[0][:, 0]
        return turned

    def error(self, z: Array, rest_known: Array, load_known: Array) -> Array:
        """Return bounds (n,) on the error of the last solution, of first order [Higham2002, 20.1].

        Args:
            z: (n,) the solution.
            rest_known: (m,) how far `rest` may be off.
            load_known: (n,) how far the load may be off.
        """
        r, m, first = self._rank, len(rest_known), self._order[: self._rank]
        wide = np.zeros(len(z))
        if not r:
            return wide
        known, inverse = self._known[:m], np.abs(self._solve(r, np.eye(r)))
        left = np.abs(self._left[:m])
        wide[first] = self._pseudo(r)[:, :m] @ (rest_known + known @ np.abs(z))
        wide[first] += inverse @ (inverse.T @ ((known.T @ left)[first] + load_known[first]))
        return wide
