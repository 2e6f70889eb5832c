"""Closure equations in extended precision, evaluated without Pinocchio for many rows at once.

Placements are products of exponentials of the joints' screws, in `numpy.longdouble` (64 bits of
mantissa on x86). Every quantity is carried with its first two derivatives in time, as arrays
(3, N, ...) whose products follow Leibniz' rule: velocities and accelerations of the rows come from
differentiating their definition (`spatial_pin.mechanism.equations`), by no formula that the
library's solvers use. With T the placement of a joint and X the 4 x 4 matrix of its body twist,

    T' = T X,    T'' = T (X X + X').
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.compiled_equations import unit_length
from spatial_pin.mechanism.equations import (
    Bearing,
    ConstraintEquation,
    Cosine,
    Displacement,
    FunctionOf,
    ImplicitParameters,
    JointCoordinate,
    Parameter,
    PointDistance,
    Quantity,
    Square,
)
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body as point_on
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.taylor import Taylor

Long: Any = np.longdouble
EPS = float(np.finfo(Long).eps)  # 1.1e-19 on x86; that of float64 where there is nothing longer
LONG_PARTS = 3  # of Newton's method, from a parameter with the digits of float64


class _Joint(NamedTuple):
    """One joint: its parent, placement (4, 4), pair, places in q and v, and screws (6, n)."""

    parent: int
    placement: Array
    is_linear: bool
    q: int
    v: int
    nq: int
    screws: Array

    def elements(self, q: Array, v: Array, a: Array) -> list[Array]:
        """Return the motions (3, N, 4, 4) with their rates whose product is that of the joint."""
        if self.is_linear:
            return [_moving(_about(s, q[:, self.q + k]), v[:, [self.v + k]] * s,
                            a[:, [self.v + k]] * s)
                    for k, s in enumerate(self.screws.T)]
        end, count = self.q + self.nq, self.screws.shape[1]
        t = _of_quaternions(q[:, end - 4 : end])
        if count == 6:
            t[:, :3, 3] = q[:, self.q : self.q + 3]
        lead = np.zeros((len(q), 6 - count), dtype=Long)
        moving = (np.hstack([lead, x[:, self.v : self.v + count]]) for x in (v, a))
        return [_moving(t, *moving)]


def _matrix(placement: pin.SE3) -> Array:
    return placement.homogeneous.astype(Long)


def times(a: Array, b: Array) -> Array:
    """Return the matrix product of two quantities with their rates (3, N, ., .)."""
    return np.stack([a[0] @ b[0], a[1] @ b[0] + a[0] @ b[1],
                     a[2] @ b[0] + 2 * (a[1] @ b[1]) + a[0] @ b[2]])


def dot(a: Array, b: Array) -> Array:
    """Return the scalar product of two vectors with their rates (3, N, 3)."""
    return np.stack([(a[0] * b[0]).sum(-1), (a[1] * b[0] + a[0] * b[1]).sum(-1),
                     (a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]).sum(-1)])


def _twist_matrices(twists: Array) -> Array:
    """Return the matrices (N, 4, 4) of twists (N, 6), linear above angular."""
    x = np.zeros((len(twists), 4, 4), dtype=Long)
    v1, v2, v3, w1, w2, w3 = twists.T
    x[:, 0, 1], x[:, 0, 2], x[:, 1, 2] = -w3, w2, -w1
    x[:, 1, 0], x[:, 2, 0], x[:, 2, 1] = w3, -w2, w1
    x[:, 0, 3], x[:, 1, 3], x[:, 2, 3] = v1, v2, v3
    return x


def _moving(t: Array, twists: Array, rates: Array) -> Array:
    """Return placements (3, N, 4, 4) with their rates, from body twists and their rates (N, 6)."""
    x = _twist_matrices(twists)
    return np.stack([t, t @ x, t @ (x @ x + _twist_matrices(rates))])


def _about(screw: Array, angle: Array) -> Array:
    """Return exp(screw * angle) (N, 4, 4), the screw's axis through the origin.

    Rodrigues' formula; the translation is along the axis, or there is no rotation.
    """
    t = np.zeros((len(angle), 4, 4), dtype=Long)
    w = _twist_matrices(np.concatenate([np.zeros(3, dtype=Long), screw[3:]])[None])[0]
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    t[:] = np.eye(4) + s * w + (1 - c) * (w @ w)
    t[:, :3, 3] = angle[:, None] * screw[:3]
    return t


def _of_quaternions(quaternions: Array) -> Array:
    """Return placements (N, 4, 4) without translation of quaternions (N, 4) x, y, z, w."""
    x, y, z, w = (quaternions / np.sqrt((quaternions**2).sum(-1, keepdims=True))).T
    k = np.zeros((len(quaternions), 4, 4), dtype=Long)
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -z, y, -x
    k[:, 1, 0], k[:, 2, 0], k[:, 2, 1] = z, -y, x
    return np.eye(4) + 2 * (w[:, None, None] * k + k @ k)


def _compose(a: Array, b: Array) -> Array:
    """Return the products (N, 4) of quaternions x, y, z, w."""
    va, vb, wa, wb = a[:, :3], b[:, :3], a[:, 3:], b[:, 3:]
    return np.hstack([wa * vb + wb * va + np.cross(va, vb),
                      wa * wb - (va * vb).sum(-1, keepdims=True)])


def _argument(s: Array, c: Array, turns: Array) -> Array:
    """Return the angle of sine and cosine, times any length, with their rates (3, N)."""
    n = s[0] ** 2 + c[0] ** 2
    turning = c[0] * s[1] - s[0] * c[1]
    rate = turning / n
    change = 2 * (s[0] * s[1] + c[0] * c[1])
    value, turn = np.arctan2(s[0], c[0]), 8 * np.arctan(Long(1))
    return np.stack([value + turn * np.round((turns - value) / turn), rate,
                     (c[0] * s[2] - s[0] * c[2]) / n - rate * change / n])


def _inverse(x: Array) -> Array:
    """Return the inverse of matrices (N, m, m) of long numbers, m 1 or 2."""
    if x.shape[-1] == 1:
        return 1 / x
    (a, b), (c, d) = np.moveaxis(x, 0, -1)
    inverse: Array = np.moveaxis(np.array([[d, -b], [-c, a]], dtype=Long) / (a * d - b * c), -1, 0)
    return inverse


class _ClosureSamples(NamedTuple):
    """A closure at N samples, whose equations are made of its frames and joints with their rates.

    Attributes:
        mechanism, closure: the closure, and whose it is.
        frames: (3, N, 4, 4) placements.
        joints: (3, N) coordinates.
        turns: of its angles, in their order.
        parameters: those found so far.
        n: number of samples.
    """

    mechanism: Mechanism
    closure: Closure
    frames: Sequence[Array]
    joints: Sequence[Array]
    turns: Iterator[Array]
    parameters: dict[ImplicitParameters, list[Array]]
    n: int

    def sum(self, row: ConstraintEquation) -> Array:
        """Return a sum of terms with its rates (3, N)."""
        total = np.zeros((3, self.n), dtype=Long)
        for number, factors in row.terms:
            product = np.zeros((3, self.n), dtype=Long)
            product[0] = Long(number)
            for x in factors:
                product = dot(product[..., None], self._quantity(x)[..., None])
            total += product
        return total

    def _implicit(self, of: ImplicitParameters) -> list[Array]:
        """Return parameters with their rates (3, N), by Newton's method from what they were.

        A parameter that moves alone at a rate of 1 tells the slopes of the sums, and one that
        stands still what else makes of them.
        """
        m, still = len(of.spans), self._replace(frames=[
            x * np.array([1, 0, 0], dtype=Long)[:, None, None, None] for x in self.frames])
        u = np.stack([np.array(next(self.turns), dtype=Long) for _ in range(m)])
        inverse = np.zeros((self.n, m, m), dtype=Long)

        def sums(of_what: _ClosureSamples, moving: Array) -> Array:
            of_what.parameters[of] = list(moving)
            return np.stack([of_what.sum(x) for x in of.definition[:m]])

        for _ in range(LONG_PARTS):
            slopes = []
            for k in range(m):
                moving = np.zeros((m, 3, self.n), dtype=Long)
                moving[:, 0], moving[k, 1] = u, 1
                slope = sums(still, moving)
                slopes.append(slope[:, 1])
            inverse = _inverse(np.stack(slopes, axis=1).transpose(2, 0, 1))
            u = u - np.einsum("nij,jn->in", inverse, slope[:, 0])
        moving = np.zeros((m, 3, self.n), dtype=Long)
        moving[:, 0] = u
        for order in (1, 2):
            moving[:, order] = -np.einsum("nij,jn->in", inverse, sums(self, moving)[:, order])
        self.parameters[of] = list(moving)
        return self.parameters[of]

    def _quantity(self, x: Quantity) -> Array:
        """Return a quantity with its rates (3, N) [m, rad or 1]."""
        if isinstance(x, JointCoordinate):
            return self.joints[x.joint]
        if isinstance(x, Parameter):
            known = self.parameters.get(x.of)
            return (self._implicit(x.of) if known is None else known)[x.which]
        if isinstance(x, FunctionOf):
            inner = self._quantity(x.argument)
            series = x.function(Taylor([inner[0], Long(1), Long(0)]))
            f = [series.derivative(k) for k in range(3)]
            return np.stack([f[0], f[1] * inner[1], f[1] * inner[2] + f[2] * inner[1] ** 2])
        one, two = (self.frames[k] for k in x.frames)
        r1, r2, d = one[..., :3, :3], two[..., :3, :3], (two - one)[..., :3, 3]
        if isinstance(x, Displacement):
            along = (r2 if x.of_second else r1) @ x.u.astype(Long)
            return dot(along, d) - np.array([[x.offset], [0], [0]], dtype=Long)
        if isinstance(x, Bearing):
            c, s = (dot(r1 @ u.astype(Long), d) - np.array([[u @ x.centre], [0], [0]], dtype=Long)
                    for u in x.axes.T[:2])
            return _argument(s, c, next(self.turns))
        if isinstance(x, Cosine):
            return dot(r1 @ x.u.astype(Long), r2 @ x.w.astype(Long))
        if isinstance(x, PointDistance):
            n, along, change = np.sqrt((d[0] ** 2).sum(-1)), *dot(d, d)[1:]
            rate = along / (2 * n)
            return np.stack([n, rate, change / (2 * n) - rate**2 / n])
        if isinstance(x, Square):
            length = unit_length(self.mechanism, self.closure) if x.length is None else x.length
            return dot(d, d) / (2 * Long(length))
        of = r2 @ x.axes2[:, 0].astype(Long)
        c, s = (dot(r1 @ u.astype(Long), of) for u in x.axes1.T[:2])
        return _argument(s, c, next(self.turns))


class Extended:
    """The closure equations of a mechanism in extended precision.

    `n_spins` is the number of resolved passive freedoms.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, model = mechanism, mechanism.model
        data, n = model.createData(), model.njoints
        pin.computeJointJacobians(model, data, mechanism.neutral.copy())
        self._joints = []
        for i in range(1, n):
            at, count = model.idx_vs[i], model.nvs[i]
            columns = pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)
            screws = columns.reshape(6, -1)[:, at : at + count].astype(Long)
            sizes = np.sqrt((screws[3:] ** 2).sum(0))
            screws[3:] /= np.where(sizes > 0, sizes, 1)
            self._joints.append(_Joint(
                model.parents[i], _matrix(model.jointPlacements[i]),
                PAIRS[mechanism.pairs[i - 1]].is_linear, model.idx_qs[i], at, model.nqs[i], screws))
        self._scale = 1 / Long(mechanism.characteristic_length)
        self._spins = []
        for passive in mechanism.passives:
            joint, _ = mechanism.frame_on_joint(passive.body)
            a, b = (point_on(mechanism, joint, name).astype(Long) for name in passive.axis)
            self._spins.append((joint, (b - a) / np.sqrt(((b - a) ** 2).sum())))
        self.n_spins = len(self._spins)

    def placements(self, q: Array, v: Array, a: Array) -> list[Array]:
        """Return the joint placements (3, N, 4, 4) in the world with their rates."""
        still = np.zeros((3, len(q), 4, 4), dtype=Long)
        still[0] = np.eye(4)
        poses = [still]
        for joint in self._joints:
            t = np.einsum("knij,jl->knil", poses[joint.parent], joint.placement)
            for element in joint.elements(q, v, a):
                t = times(t, element)
            poses.append(t)
        return poses

    def rows(self, q: Array, v: Array, a: Array, turns: Array) -> Array:
        """Return closure equations with their rates (3, N, n_closure) [-], in its order.

        Args:
            q: (N, nq) configurations.
            v: (N, nv) velocities.
            a: (N, nv) accelerations.
            turns: (N, n) relative angles of screw closures to within half a turn [rad].
        """
        placements = self.placements(q, v, a)
        counted, blocks = iter(turns.T), []
        for closure in sorted(self.mechanism.closures, key=lambda c: not c.frames):
            frames = [placements[joint] @ _matrix(offset) for joint, offset in map(
                self.mechanism.frame_on_joint, (*closure.frames, *closure.between))]
            joints = [self.mechanism.coordinate(name) for name in closure.joints]
            known = [np.stack([q[:, c.q], v[:, c.v], a[:, c.v]]) for c in joints]
            for row in closure.rows:
                samples = _ClosureSamples(
                    self.mechanism, closure, frames, known, counted, {}, len(q))
                blocks.append(self._size(closure, row) * samples.sum(row))
        return np.stack(blocks, axis=-1) if blocks else np.zeros((3, len(q), 0), dtype=Long)

    def _size(self, closure: Closure, row: ConstraintEquation) -> Any:
        """Return what an equation is multiplied by: lengths are relative to the mechanism's."""
        if closure.frames:
            return self._scale if row.is_length else Long(1)
        sizes = [Long(1) if self.mechanism.coordinate(name).unit == "rad" else self._scale
                 for name in closure.joints]
        largest = max((abs(Long(number)) / sizes[x[0].joint] for number, x in row.terms
                       if len(x) == 1 and isinstance(x[0], JointCoordinate)), default=Long(0))
        # where a joint moves much more than others, they are judged by the one that moves less
        return 1 / largest if largest * sizes[-1] > 100 else sizes[-1]

    def spins(self, q: Array, v: Array, a: Array) -> Array:
        """Return (2, N, n) speed and acceleration of the resolved passive spins [rad/s, rad/s²]."""
        placements = self.placements(q, v, a) if self._spins else []
        parts = []
        for joint, axis in self._spins:
            r, dr, ddr = placements[joint][..., :3, :3]
            back = np.swapaxes(r, -1, -2)
            for k in (back @ dr, back @ ddr):  # axial vectors of the skew parts
                axial = np.stack([k[:, 2, 1] - k[:, 1, 2], k[:, 0, 2] - k[:, 2, 0],
                                  k[:, 1, 0] - k[:, 0, 1]], axis=-1) / 2
                parts.append(axial @ axis)
        return np.moveaxis(np.array(parts, dtype=Long).reshape(-1, 2, len(q)), 0, -1)

    def closure_errors(self, q: Array, turns: Array) -> Array:
        """Return the largest closure row (N,) of configurations (N, nq) [-]."""
        q = np.asarray(q, dtype=Long)
        still = np.zeros((len(q), self.mechanism.model.nv), dtype=Long)
        rows = np.abs(self.rows(q, still, still, turns)[0])
        return rows.max(axis=-1, initial=0).astype(float)

    # ------------------------------------------------------------ configurations

    def integrate(self, q: Array, step: Array) -> Array:
        """Return configurations (N, nq) moved by small steps (N, nv)."""
        moved = q.copy()
        for joint in self._joints:
            n, end = joint.screws.shape[1], joint.q + joint.nq
            dx = step[:, joint.v : joint.v + n]
            if joint.is_linear:
                moved[:, joint.q : end] += dx
                continue
            turn = q[:, end - 4 : end]
            if n == 6:
                r = _of_quaternions(turn)[:, :3, :3]
                moved[:, joint.q : end - 4] += (r @ dx[:, :3, None])[..., 0]
            small = np.hstack([dx[:, -3:] / 2, np.ones((len(q), 1), dtype=Long)])
            turned = _compose(turn, small)
            moved[:, end - 4 : end] = turned / np.sqrt((turned**2).sum(-1, keepdims=True))
        return moved

    def difference(self, first: Array, second: Array) -> Array:
        """Return the steps (N, nv) from configurations to others (N, nq).

        Rotation vectors in body axes; translations of floating joints in those of the first.
        """
        steps = np.zeros((len(first), self.mechanism.model.nv), dtype=Long)
        for joint in self._joints:
            n, end = joint.screws.shape[1], joint.q + joint.nq
            if joint.is_linear:
                steps[:, joint.v : joint.v + n] = (second - first)[:, joint.q : end]
                continue
            a, b = first[:, end - 4 : end], second[:, end - 4 : end]
            if n == 6:
                moved = (second - first)[:, joint.q : end - 4]
                back = np.swapaxes(_of_quaternions(a)[:, :3, :3], -1, -2)
                steps[:, joint.v : joint.v + 3] = (back @ moved[..., None])[..., 0]
            turn = _compose(a * np.array([-1, -1, -1, 1]), b)
            turn = np.where(turn[:, 3:] < 0, -turn, turn)
            sine = np.sqrt((turn[:, :3] ** 2).sum(-1, keepdims=True))
            angle = 2 * np.arctan2(sine, turn[:, 3:])
            factor = np.where(sine > 0, angle / np.where(sine > 0, sine, 1), 2)
            steps[:, joint.v + n - 3 : joint.v + n] = factor * turn[:, :3]
        return steps
