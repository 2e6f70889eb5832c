"""Long runs of equal driver steps: positions one by one, rates of all rows together.

`Branch.step` is the specification; this is the same motion at a third of the cost. Positions are
extrapolated through the last rows (polynomials in the entries of q, quaternions included) and
corrected with a matrix kept for a few steps. Then velocities, accelerations and determinants of
all rows are computed together over flat arrays, and every row is judged: closed, on the same side
of every singularity, and explained by the rates at both ends of its step. Rows from the first one
that fails are thrown away and followed step by step instead.
"""

from __future__ import annotations

from math import comb
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.kinematics.views import accelerations, twists
from spatial_pin.linalg import Array

if TYPE_CHECKING:
    from spatial_pin.kinematics.sweep import Branch


HISTORY = 8  # rows that an extrapolation goes through
SHORTEST = 8  # rows below which a run is not worth while
LONGEST = 512  # rows that are judged together
CHORDS = 4  # corrections with a kept matrix before a step is given up
FRESH = 3  # corrections after which the matrix is made anew for the next step
UNEXPLAINED = 1e-3  # part of a step that the rates at its two ends may leave unexplained
_EXTRAPOLATION = np.array([(-1.0) ** (HISTORY - 1 - k) * comb(HISTORY, k) for k in range(HISTORY)])


class Rows(NamedTuple):
    """Rates and judgement of m rows.

    Attributes:
        t, c: (m, nv) first and second derivative of the path with respect to the driver.
        residual: (m, rows) closure rows.
        sign: (m,) sign of the determinant, 0 when singular.
    """

    t: Array
    c: Array
    residual: Array
    sign: Array


def is_possible(branch: Branch) -> bool:
    """Whether the branch's equations are plain products and all its freedoms determined."""
    accuracy = branch.accuracy
    return (
        branch.evaluation.is_plain
        and not len(branch.system.passive)
        and accuracy.corrections is None
        and accuracy.order == 3
    )


def uniform_until(values: Array, k: int) -> int:
    """Return the end of the equal steps around row k - 1, or k when there are too few."""
    if k < HISTORY or len(values) - k < SHORTEST:
        return k
    steps = np.diff(values[k - HISTORY :])
    h = steps[HISTORY - 2]
    uneven = np.flatnonzero(np.abs(steps - h) > 1e-9 * abs(h))
    if h == 0.0 or (uneven.size and uneven[0] < HISTORY - 1):
        return k
    end = k + (int(uneven[0]) - HISTORY + 1 if uneven.size else len(values) - k)
    return end if end - k >= SHORTEST else k


def follow(branch: Branch, values: Array, q: Array, k: int, end: int) -> tuple[int, Rows | None]:
    """Follow equal steps from row k on; q (N, nq) holds the rows before and takes the new ones.

    Returns:
        The row after the last good one, at most `end`, and the rates of the rows from k on.
    """
    reached, jacobians, bodies = _positions(branch, values, q, k, end)
    if reached - k < SHORTEST:
        return k, None
    rows = _rates(branch, q[k:reached], jacobians[: reached - k], bodies[: reached - k])
    good = _good(branch, values[k] - values[k - 1], q[k - 1 : reached], rows)
    return k + good, Rows(*(x[:good] for x in rows))


def _positions(
    branch: Branch, values: Array, q: Array, k: int, end: int
) -> tuple[int, Array, Array]:
    """Fill q[k:end]; return the first row that would not close, and J, G of the rows."""
    m, n, model = end - k, branch.model.njoints, branch.model
    jacobians, bodies = np.empty((m, 6, model.nv)), np.empty((m, 3, 4 * n))
    corrector = _Corrector(branch, float(values[k] - values[k - 1]))
    joint_jacobian, placements = corrector.data.J, corrector.g.T
    for i, value in enumerate(values[k:end].tolist()):
        row = k + i
        x = pin.normalize(model, np.dot(_EXTRAPOLATION, q[row - HISTORY : row]))
        closed = corrector.close(x, value)
        if closed is None:
            return row, jacobians, bodies
        q[row] = closed
        jacobians[i] = joint_jacobian
        bodies[i] = placements
    return end, jacobians, bodies


class _Corrector:
    """Chord method: a correction is one product of a kept matrix with the terms A * B of the rows.

    The size of a correction is the measure of closure; the batch judges the residuals.
    """

    def __init__(self, branch: Branch, h: float) -> None:
        self.branch, self.h = branch, h
        self.model, self.data = branch.model, branch.evaluation.data
        self.g, self.c_ab, self.ab, self.a, self.b, self.terms = branch.evaluation.product_buffers()
        self.flat_terms = self.terms.reshape(-1)
        small = branch.accuracy.tolerance * min(1.0, branch.mechanism.characteristic_length)
        self.limit = 0.25 * small * small
        self.attempts = FRESH

    def close(self, x: Array, value: float) -> Array | None:
        """Return the closed configuration near x at the driver value, None when it goes astray.

        Pinocchio's data are left there.
        """
        self._hold(x, value)
        if self.attempts >= FRESH and not self._renew(x):
            return None
        spins = self.branch.spins
        for self.attempts in range(CHORDS + 1):
            pin.computeJointJacobians(self.model, self.data, x)
            np.dot(self.c_ab, self.g, self.ab)
            np.multiply(self.a, self.b, out=self.terms)
            step = np.dot(self.chord, self.flat_terms)
            step += self.offset
            if not self.attempts:
                for spin, column in zip(spins, self.spin_chord, strict=True):
                    step += spin.error(self.h) * column
            elif step.dot(step) <= self.limit:
                for spin in spins:
                    spin.accept(self.h)
                return x
            x = pin.integrate(self.model, x, step)
            self._hold(x, value)
        return None

    def _hold(self, x: Array, value: float) -> None:
        x[self.branch.at] = value
        for index, fixed in self.branch.held:
            x[index] = fixed

    def _renew(self, x: Array) -> bool:
        self.branch.evaluation.update(x)
        if not self.branch.system.factor():
            return False
        self.chord, self.offset, self.spin_chord = self.branch.system.chord()
        return True


def _rates(branch: Branch, q: Array, jacobians: Array, bodies: Array) -> Rows:
    evaluation, system = branch.evaluation, branch.system
    c = evaluation.constraints
    r, n_rows = len(c.constants), c.n_rows
    m = len(q)
    vectors = (bodies.reshape(3 * m, -1) @ c.c_abx.T).reshape(m, 3, 3 * r)
    a, b, x = vectors[:, :, :r], vectors[:, :, r : 2 * r], vectors[:, :, 2 * r :]
    residual = (a * b).sum(axis=1) - c.constants
    wrenches = np.empty((m, 6, r))
    np.multiply(b, c.factors[:, 0], out=wrenches[:, :3])
    _cross(x, b, wrenches[:, 3:])
    wrenches[:, 3:, c.passive_at :] = b[:, :, c.passive_at :]
    products = wrenches.transpose(0, 2, 1) @ jacobians
    products *= c.signs
    matrices = system.stack(products)
    sign, magnitude = np.linalg.slogdet(matrices)
    sign[~np.isfinite(magnitude)] = 0.0
    if not sign.all():  # judged singular: leave the solver something regular to do
        matrices[sign == 0.0] = np.eye(matrices.shape[1])
    drive = np.zeros((m, matrices.shape[1], 1))
    drive[:, system.first_driver_row] = 1.0
    t = np.linalg.solve(matrices, drive)[:, :, 0]
    rhs = np.zeros_like(drive)
    system.put_bias(rhs[:, :, 0], _bias(branch, q, t, bodies, a, b))
    second = np.linalg.solve(matrices, rhs)[:, :, 0]
    return Rows(t, second, residual[:, :n_rows], sign)


def _bias(branch: Branch, q: Array, t: Array, bodies: Array, a: Array, b: Array) -> Array:
    """Return (m, rows + passive) second derivatives of the rows at zero joint acceleration."""
    evaluation, model, data = branch.evaluation, branch.model, branch.evaluation.data
    c = evaluation.constraints
    m, n, r = len(q), model.njoints, len(c.constants)
    twist_view, acceleration_view = twists(data), accelerations(data)
    local = np.empty((m, n, 12))  # twist and spatial acceleration of every body
    zero = np.zeros(model.nv)
    for k in range(m):
        pin.forwardKinematics(model, data, q[k], t[k], zero)
        local[k, :, :6] = twist_view
        local[k, :, 6:] = acceleration_view
    g = bodies.reshape(m, 3, n, 4)
    rotations = g[..., :3].transpose(0, 2, 3, 1)  # (m, n, 3, 3), transposed
    world = (local.reshape(m, n, 4, 3) @ rotations).transpose(2, 0, 3, 1)
    v, w, a_linear, alpha = world  # (m, 3, n) each
    first, second = np.empty_like(g), np.empty_like(g)
    columns = g[..., :3]
    _cross(w[..., None], columns, first[..., :3])
    first[..., 3] = v
    _cross(w[..., None], first, second)  # ω × R', and ω × v for the classical acceleration
    spin = np.empty_like(columns)
    _cross(alpha[..., None], columns, spin)
    second[..., :3] += spin
    second[..., 3] += a_linear
    c_ab = c.c_abx[: 2 * r].T
    v1 = (first.reshape(3 * m, -1) @ c_ab).reshape(m, 3, 2 * r)
    v2 = (second.reshape(3 * m, -1) @ c_ab).reshape(m, 3, 2 * r)
    bias = (v2[:, :, :r] * b + 2.0 * v1[:, :, :r] * v1[:, :, r:] + a * v2[:, :, r:]).sum(axis=1)
    if c.n_passive:
        bias[:, c.passive_at :] = local[:, :, 6:].reshape(m, -1) @ c.spin_bias.T
    return bias


def _cross(x: Array, y: Array, out: Array) -> None:
    """Write x × y; the vectors lie along axis 1."""
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(x[:, j], y[:, k], out=out[:, i])
        out[:, i] -= x[:, k] * y[:, j]


def _good(branch: Branch, h: float, q: Array, rows: Rows) -> int:
    """Return how many rows pass; q (m + 1, nq) begins with the row before them."""
    model, linear = branch.model, branch.linear
    t = np.vstack([branch.t, rows.t])
    c = np.vstack([branch.c, rows.c])
    # Hermite: q1 - q0 = h (t0 + t1)/2 + h² (c0 - c1)/12, in the joints where dq/ds = t
    moved = np.diff(q[:, linear[0]], axis=0)
    told = (0.5 * h) * (t[:-1] + t[1:]) + (h * h / 12.0) * (c[:-1] - c[1:])
    told = told[:, linear[1]]
    size = np.linalg.norm(moved, axis=1)
    unexplained = np.linalg.norm(moved - told, axis=1) > UNEXPLAINED * size + 1e-12
    cosine = np.vecdot(t[:-1], t[1:]) / np.sqrt(np.vecdot(t[:-1], t[:-1]) * np.vecdot(t[1:], t[1:]))
    bad = unexplained | (rows.sign != branch.sign) | (cosine < 0.9) | ~np.isfinite(rows.c).all(1)
    assert model.nv == t.shape[1]
    return int(np.argmax(bad)) if bad.any() else len(bad)
