"""Accelerations by Gauss's principle of least constraint, for masses of any ratio.

Of all accelerations a = a0 + G z that the loops allow, those happen for which

    1/2 sum_b ( m |c''_b - g|^2 + |I^(1/2) (w'_b + I^-1 (w x I w))|^2 ) - f . G z

is least [Gauss1829; UdwadiaKalaba1996], c'' and w' a body's accelerations, f the joint forces
given; an armature A of a joint coordinate x adds 1/2 A x''^2. Solved by QR of the bodies' own
rows, the heaviest first, no mass matrix is ever formed: in that a light body's part is rounded away
beside a heavy one's [GolubVanLoan2013, 6.2.5]. Every row keeps its own relative accuracy
[CoxHigham1998], so it is bounded row by row how far entries may be off: a motion has no inertia if
no row of it is larger than that, however small its inertia is, and what the same bounds leave
uncertain of the accelerations is returned with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.dense import qr, qr_turn, upper_solve
from spatial_pin.numerics.linalg import Array, Factors, decompose, independent_rows, row_space
from spatial_pin.numerics.stacked import cross
from spatial_pin.numerics.tolerances import EPS, TOLERANCES

ROUNDING = 128.0 * EPS  # round-off of an entry: a sum of some hundred terms, each rounded once


class Bounded(NamedTuple):
    """Numbers with bounds on their errors.

    Attributes:
        value: the numbers.
        bound: largest absolute error of each, of the same shape.
    """

    value: Array
    bound: Array

    def plain(self) -> Bounded:
        """Return the numbers; those whose bound allows them to be zero are zero."""
        is_nonzero = np.abs(self.value) > self.bound
        return Bounded(np.where(is_nonzero, self.value, 0.0), np.where(is_nonzero, self.bound, 0.0))


class IndependentCoordinates:
    """Motion of all joints per unit of the independent coordinates, with bounds on its errors.

    The closure equations alone give it: near singular configurations of the loops, and with a heavy
    body carried between light ones, it has digits that the KKT system loses [Wehage1982].

    Args:
        rows: (r, nv) independent equations for scaled velocities, as many as there are others.
        scale: (nv,) velocity of a unit of each scaled unknown.
        opened: closure residual [-]; entries of the rows may be off by as much.
        free: velocity entries of the independent coordinates; if not given, those that determine
            the others best.

    Attributes:
        columns: (nv, n) joint velocities; in each, one of the free coordinates moves at its unit.
    """

    def __init__(
        self, rows: Array, scale: Array, opened: float, free: Sequence[int] | None = None
    ) -> None:
        r, nv = rows.shape
        self._scale = scale
        if free is None:
            free = np.setdiff1d(np.arange(nv), independent_rows(rows.T, 0.0)).tolist()
        whole = np.zeros((nv, nv))
        whole[:r] = rows
        whole[np.arange(r, nv), list(free)] = 1.0
        self._largest = np.abs(rows).max(axis=1, initial=0.0)
        self._known = np.zeros((nv, nv))
        self._known[:r] = np.where(rows != 0.0, ROUNDING * self._largest[:, None], 0.0) + opened
        self._factors = Factors(whole)
        units = np.zeros((nv, nv - r))
        units[r:] = np.eye(nv - r)
        self.columns = self._solve(units)

    def _solve(self, rhs: Array, off: Array | None = None) -> Bounded:
        x = self._factors.solve(rhs)
        bound = self._factors.error_bounds(x, self._known, ROUNDING)
        if off is not None:
            bound += self._factors.spread(off)
        return Bounded((self._scale * x.T).T, (self._scale * bound.T).T)

    def carried(self, gamma: Array, v: Array) -> Bounded:
        """Return the accelerations (nv,) that rows need while the free coordinates have none.

        Args:
            gamma: (r,) second derivatives of the rows without acceleration.
            v: (nv,) joint velocities.
        """
        rhs, off = np.zeros((2, len(self._scale)))
        rhs[: len(gamma)] = -gamma
        speed = v / self._scale
        off[: len(gamma)] = ROUNDING * (np.abs(gamma) + self._largest * speed.dot(speed))
        return self._solve(rhs, off)


class Least(NamedTuple):
    """The accelerations of least constraint.

    Attributes:
        a: (nv,) joint accelerations.
        z: (n,) accelerations of the freedoms.
        still: (k, nv) motions without inertia; they move their bodies with the least accelerations.
        pulled: whether applied forces do work on one of these motions.
        off: (nv,) bounds on the round-off of a.
        error: the largest of them, relative to the largest of a.
        lost: whether that error exceeds every acceleration that motion or gravity gives.
    """

    a: Array
    z: Array
    still: Array
    pulled: bool
    off: Array
    error: float
    lost: bool


class BodyRows:
    """Accelerations of bodies, weighted by the roots of their inertias, with bounds on errors."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._model = model = mechanism.model
        self._data, self._scale = model.createData(), mechanism.velocity_scale
        self._per_size = np.repeat([1.0 / mechanism.characteristic_length, 1.0], 3)
        heavy = [j for j, body in enumerate(model.inertias)
                 if j and (body.mass > 0.0 or np.any(body.inertia))]
        bodies = [model.inertias[j] for j in heavy]
        moments, axes = np.linalg.eigh(np.reshape([b.inertia for b in bodies], (-1, 3, 3)))
        axes[:, :, 0] *= np.linalg.det(axes)[:, None]  # right-handed: products of rates are to come
        self._heavy, self._back = np.array(heavy, dtype=np.intp), axes.transpose(0, 2, 1)
        self._levers = np.reshape([b.lever for b in bodies], (-1, 3))
        self._across = skew(self._levers)
        masses = np.repeat([b.mass for b in bodies], 3).reshape(-1, 3)
        self._roots = np.sqrt(np.hstack([masses, np.maximum(moments, 0.0)]))  # (bodies, 6)
        self._parents = [int(x) for x in model.parents]
        self._starts = np.array(model.idx_vs[1:], dtype=np.intp)
        self._rotors = np.flatnonzero(model.armature)
        self._weights = np.sqrt(model.armature[self._rotors])

    def rows(
        self, q: Array, v: Array, a: Bounded, columns: Bounded
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return weighted accelerations per unit freedom (m, n), and without (m,), with bounds.

        Bounds are the largest errors of the entries. Last come units of the freedoms (n,) at which
        some body moves by one: with them a row resolves all freedoms alike. Motion within its
        bounds does not count.
        """
        pin.forwardKinematics(self._model, self._data, q, v, a.value)
        bodies = self._of_bodies(columns, a, v)
        at, weights = self._rotors, self._weights  # joints with an armature
        turned, turning = columns.value[at], a.value[at]
        rotors = (weights[:, None] * turned,
                  weights[:, None] * (columns.bound[at] + ROUNDING * np.abs(turned)),
                  weights * turning, weights * (a.bound[at] + ROUNDING * np.abs(turning)))
        rows, known, rest, rest_known = (
            np.concatenate(pair) for pair in zip(bodies[:4], rotors, strict=True))
        pace = np.maximum(bodies[4], np.abs(turned / self._scale[at, None]).max(
            axis=0, initial=0.0))
        return rows, known, rest, rest_known, 1.0 / np.where(pace > 0.0, pace, 1.0)

    def _of_bodies(self, columns: Bounded, a: Bounded, v: Array) -> tuple[Array, ...]:
        """Return the rows of bodies with mass, as `rows` does, and their speeds (n,)."""
        data, n, roots = self._data, columns.value.shape[1], self._roots
        twists, sizes = (x[self._heavy] for x in self.twists(columns, a, v))
        twists[:, :3] -= self._across @ twists[:, 3:]
        twists[:, 3:] = self._back @ twists[:, 3:]
        sizes[:, :3] += np.abs(self._across) @ sizes[:, 3:]
        sizes[:, 3:] = np.abs(self._back) @ sizes[:, 3:]
        sure = np.where(np.abs(twists) > sizes[:, :, :n], np.abs(twists), 0.0)
        moves = sure * np.where(roots > 0.0, self._per_size, 0.0)[:, :, None]
        heavy = self._heavy.tolist()
        motion = np.reshape([data.v[j].vector for j in heavy], (-1, 6))
        change = np.reshape([data.a[j].vector for j in heavy], (-1, 6))
        down = np.reshape([data.oMi[j].rotation for j in heavy], (-1, 3, 3)).transpose(0, 2, 1)
        fastest, rest_known = sizes[:, :, n + 1], sizes[:, :, n]
        moving, turning = fastest[:, :3].max(axis=1), fastest[:, 3:].max(axis=1)
        gravity = self._model.gravity.linear
        rest_known[:, :3] += (moving * turning)[:, None] / ROUNDING + ROUNDING * (
            np.abs(down) @ np.abs(gravity))
        rest_known[:, 3:] += (turning * turning)[:, None] / ROUNDING
        rest = self._rest(motion, change, down @ gravity)
        flat = (6 * len(heavy), n)  # either may be 0
        return ((roots[:, :, None] * twists).reshape(flat),
                (roots[:, :, None] * sizes[:, :, :n]).reshape(flat), rest.ravel(),
                (roots * rest_known).ravel(), moves.max(axis=(0, 1), initial=0.0))

    def twists(self, columns: Bounded, a: Bounded, v: Array) -> tuple[Array, Array]:
        """Return twists (njoints, 6, n) of the joints' bodies per unit freedom, body axes.

        They are added up from body to body: a component that is zero stays exactly zero, which
        world axes would not keep. Also returned: bounds on their errors (njoints, 6, n + 2), of
        the twists, then of acceleration and velocity.
        """
        data, n, count = self._data, columns.value.shape[1], self._model.njoints
        off = np.column_stack([columns.bound + ROUNDING * np.abs(columns.value),
                               a.bound + ROUNDING * np.abs(a.value), ROUNDING * np.abs(v)])
        axes = np.hstack([np.reshape(data.joints[j].S, (6, -1)) for j in range(1, count)]).T
        twists, sizes = np.zeros((count, 6, n)), np.zeros((count, 6, n + 2))
        for all_of, own, given in ((twists, axes, columns.value), (sizes, np.abs(axes), off)):
            np.add.reduceat(own[:, :, None] * given[:, None], self._starts, out=all_of[1:])
        placed = np.array([data.liMi[j].homogeneous[:3] for j in range(count)])
        back, across = placed[:, :, :3].transpose(0, 2, 1), skew(placed[:, :, 3])
        grown, added = _bounds(back, across)
        for joint in range(1, count):
            parent = self._parents[joint]
            if parent:
                before = twists[parent]
                twists[joint, :3] += back[joint] @ (before[:3] - across[joint] @ before[3:])
                twists[joint, 3:] += back[joint] @ before[3:]
                sizes[joint] += grown[joint] @ sizes[parent]
                sizes[joint, :, :n] += added[joint] @ np.abs(before)
        return twists, sizes

    def _rest(self, motion: Array, change: Array, gravity: Array) -> Array:
        """Return the weighted accelerations (bodies, 6) of centres less gravity, and angular.

        The latter in own axes, with the gyroscopic I^(-1/2) (w x I w); 0 of bodies without I.
        """
        w, lever = motion[:, 3:], self._levers
        rest = np.empty_like(motion)
        rest[:, :3] = (change[:, :3] + cross(w, motion[:, :3]) + cross(change[:, 3:], lever)
                        + cross(w, cross(w, lever)) - gravity)
        rest[:, 3:] = (self._back @ change[:, 3:, None])[:, :, 0]
        rest = self._roots * rest
        own, roots = (self._back @ w[:, :, None])[:, :, 0], self._roots[:, 3:]
        squares, i, j = roots * roots, [2, 0, 1], [1, 2, 0]
        moved = (squares[:, i] - squares[:, j]) * own[:, j] * own[:, i]
        held = roots > ROUNDING * roots.max(axis=1, keepdims=True, initial=0.0)
        rest[:, 3:] += np.divide(moved, roots, out=np.zeros_like(moved), where=held)
        return rest

    def least(self, q: Array, v: Array, a: Array, twists: Array) -> Array:
        """Return the accelerations (k,) of motions without inertia, on top of a (nv,).

        `twists` (njoints, 6, k) are those of the bodies per unit of each motion, body axes.
        Nothing determines them. Those are taken for which the accelerations of the bodies that they
        move, of their origins and angular, have the least sum of squares: a body that spins goes
        on as if it were a light ball, whatever coordinates count its motion. A component of its
        angular velocity, kept instead, would have it spin without bound where the line turns away
        from that.
        """
        pin.forwardKinematics(self._model, self._data, q, v, a)
        change, motion = (np.array([x.vector for x in part]) for part in (
            self._data.a, self._data.v))
        change[:, :3] += cross(motion[:, 3:], motion[:, :3])
        moves = (np.abs(twists) > TOLERANCES.tight * np.abs(twists).max()).any(axis=(1, 2))
        rows = (twists[moves] * self._per_size[:, None]).reshape(-1, twists.shape[2])
        largest = np.abs(rows).max()
        rest = (change[moves] * self._per_size).ravel()
        return decompose(rows / largest).minimum_norm(-rest / largest)


class LeastConstraint:
    """Accelerations of a mechanism by Gauss's principle of least constraint."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._bodies, self._scale = BodyRows(mechanism), mechanism.velocity_scale
        gravity = float(np.linalg.norm(mechanism.model.gravity.linear))
        self._falling = gravity / mechanism.characteristic_length

    def solve(self, q: Array, v: Array, a: Bounded, columns: Bounded, given: Array) -> Least:
        """Return the accelerations; motions without inertia have the least ones of their bodies.

        Args:
            q: (nq,) configuration, the loops closed.
            v: (nv,) joint velocities.
            a: (nv,) joint accelerations while those of the freedoms are zero.
            columns: (nv, n) joint velocities per unit of each freedom; entries within their bounds
                count as zero.
            given: (nv,) joint forces.
        """
        columns = columns.plain()
        rows, known, rest, rest_known, unit = self._bodies.rows(q, v, a, columns)
        rows *= unit
        known *= unit
        moved = columns.value * unit
        bound = columns.bound * unit
        load = moved.T @ given
        order = np.argsort(-np.abs(rows).max(axis=1, initial=0.0))
        fit = _Fit(rows[order], known[order])
        z = fit.solve(-rest[order], load)
        still = fit.still
        allowed = np.abs(still) @ ((TOLERANCES.nothing * np.abs(moved) + bound).T @ np.abs(given))
        pulled = bool(np.any(np.abs(still @ load) > allowed))
        wide = fit.error(z, rest_known[order], bound.T @ np.abs(given)
                         + ROUNDING * np.abs(moved).T @ np.abs(given))
        off = a.bound + np.abs(moved) @ wide + bound @ np.abs(z)
        motions, total = moved @ still.T, a.value + moved @ z
        if len(still):
            still_twists = self._bodies.twists(columns, a, v)[0] @ (unit[:, None] * still.T)
            y = self._bodies.least(q, v, total, still_twists)
            z, total = z + y @ still, total + motions @ y
        worst, size = (float(np.abs(x / self._scale).max(initial=0.0)) for x in (off, total))
        speed = v / self._scale
        natural = max(size, self._falling, speed.dot(speed))
        return Least(total, unit * z, motions.T, pulled, off,
                     worst / (size or natural or 1.0), worst > natural)


def _bounds(back: Array, across: Array) -> tuple[Array, Array]:
    """Return two (m, 6, 6): the bounds that twists pass to the next body, and those it adds.

    Args:
        back: (m, 3, 3) rotations.
        across: (m, 3, 3) cross product matrices of the arms.
    """
    turned, none, reach = np.abs(back), _round_off(back), _round_off(across)
    grown, added = np.zeros((2, len(back), 6, 6))
    grown[:, :3, :3] = grown[:, 3:, 3:] = turned
    grown[:, :3, 3:] = turned @ np.abs(across)
    added[:, :3, :3] = added[:, 3:, 3:] = none
    added[:, :3, 3:] = none @ np.abs(across) + turned @ reach
    return grown, added


def _round_off(placed: Array) -> Array:
    """Return the sizes of the entries of rotations, or of arms, that may be round-off of zero.

    A quarter turn in a file leaves a cosine of 6e-17 where there should be a zero.
    """
    sizes = np.abs(placed)
    return np.where(sizes < EPS * sizes.max(axis=(1, 2), keepdims=True), sizes, 0.0)


def skew(arms: Array) -> Array:
    """Return the matrices (m, 3, 3) of cross products with vectors (m, 3)."""
    across = np.zeros((len(arms), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        across[:, j, i], across[:, i, j] = arms[:, k], -arms[:, k]
    return across


class _Fit:
    """Least squares with rows of very different sizes, and unknowns that no row determines.

    Args:
        rows: (m, n) the largest first.
        known: (m, n) how far their entries may be off.

    Attributes:
        still: (k, n) orthonormal changes of the unknowns that change no row.
    """

    def __init__(self, rows: Array, known: Array) -> None:
        m, n = rows.shape
        if m < n:
            rows, known = (np.vstack([x, np.zeros((n - m, n))]) for x in (rows, known))
        known = known + ROUNDING * np.abs(rows).max(axis=1, initial=0.0)[:, None]
        self._rows, self._known = rows, known
        self._qr, self._order, self._tau = qr(rows)
        self._upper = np.triu(self._qr[:n])
        self._basis = qr_turn(self._qr, self._tau, np.eye(len(rows), n))
        rank = int(np.count_nonzero(self._upper.diagonal()))  # of the rest nothing at all is left
        motions = self._following(rank)
        while rank:  # the last unknowns are left out while they move nothing for certain
            change = self._following(rank - 1)
            off = known @ np.abs(change)
            off += np.abs(rows[:, self._order[: rank - 1]]) @ (self._pseudo(rank - 1) @ off)
            if np.any(np.abs(rows @ change) > off):
                break
            rank, motions = rank - 1, change
        self._rank = rank
        self.still = row_space(motions.T)

    def _following(self, rank: int) -> Array:
        """Return changes (n, n - rank): one of the last unknowns by 1, the first ones in return."""
        n = self._rows.shape[1]
        null = np.zeros((n, n - rank))
        null[self._order[rank:]] = np.eye(n - rank)
        for k in range(rank, n):
            null[self._order[:rank], k - rank] = -self._solve(rank, self._upper[:rank, k])
        return null

    def _solve(self, rank: int, b: Array, transposed: bool = False) -> Array:
        """Return R^-1 b, or R^-T b, (rank,) of the first unknowns."""
        return upper_solve(self._upper[:rank, :rank], b, transposed)

    def _inverse(self, rank: int) -> Array:
        """Return R^-1 (rank, rank) of the first unknowns."""
        return upper_solve(self._upper[:rank, :rank], np.eye(rank))

    def _pseudo(self, rank: int) -> Array:
        """Return absolute values (rank, m) of the pseudo-inverse of the first unknowns' columns."""
        return np.abs(self._inverse(rank) @ self._basis.T[:rank])

    def solve(self, rest: Array, load: Array) -> Array:
        """Return z (n,) with rows^T (rows z - rest) = load, of least norm."""
        n, r, first = len(load), self._rank, self._order[: self._rank]
        z = np.zeros(n)
        if r:
            full = np.concatenate([rest, np.zeros(len(self._rows) - len(rest))])
            turned = qr_turn(self._qr, self._tau, full, transposed=True)
            pull = self._solve(r, load[first], transposed=True)
            z[first] = self._solve(r, turned[:r] + pull)
            turned[:r] = -pull
            self._turned_rows = qr_turn(self._qr, self._tau, turned)
        return z - self.still.T @ (self.still @ z)

    def error(self, z: Array, rest_known: Array, load_known: Array) -> Array:
        """Return bounds (n,) on the error of the last solution z, see [Higham2002, 20.1].

        Of first order; `rest` and `load` may be off by `rest_known` (m,) and `load_known` (n,).
        """
        r, m, first = self._rank, len(rest_known), self._order[: self._rank]
        wide = np.zeros(len(z))
        if not r:
            return wide
        known, inverse = self._known[:m], np.abs(self._inverse(r))
        load = np.abs(self._turned_rows[:m])
        wide[first] = self._pseudo(r)[:, :m] @ (rest_known + known @ np.abs(z))
        wide[first] += inverse @ (inverse.T @ ((known.T @ load)[first] + load_known[first]))
        return wide
