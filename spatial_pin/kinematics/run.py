"""Long runs of equal driver steps: positions one by one, rates of all rows together.

`Branch.step` is the specification; this is the same motion at a third of the cost. Positions are
extrapolated through the last rows (polynomials in the entries of q, quaternions included) and
corrected with a matrix kept for a few steps. Then velocities, accelerations and determinants of
all rows are computed together over flat arrays, and every row is judged: closed, on the same side
of every singularity, and explained by the rates at both ends of its step. Rows from the first one
that fails are thrown away and followed step by step instead.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.blas import dgemv

from spatial_pin.kinematics.views import accelerations, joint_jacobian, twists
from spatial_pin.linalg import Array

if TYPE_CHECKING:
    from spatial_pin.kinematics.branch import Branch


HISTORY = 8  # rows that an extrapolation goes through
SHORTEST = 8  # rows below which a run is not worth while
LONGEST = 512  # rows that are judged together
CHORDS = 4  # corrections with a kept matrix before a step is given up
CONTRACTION = 1e-2  # square of the factor by which corrections with a kept matrix must shrink
STRAIGHT = 0.9  # least cosine between the path directions at the two ends of a step
LONGEST_STEP = 0.5  # rad, characteristic lengths, that a joint may move in a step
SINGULAR = 1e-4  # fraction of the largest determinant below which arc length has the better view
WORN = 0.1  # the same where redundant rows might better be chosen anew
UNEXPLAINED = 1e-3  # part of a step that the rates at its two ends may leave unexplained
_EXTRAPOLATION = np.array(
    [(-1.0) ** (HISTORY - 1 - k) * math.comb(HISTORY, k) for k in range(HISTORY)]
)


class Rows(NamedTuple):
    """Rates and judgement of m rows.

    Attributes:
        t, c: (m, nv) first and second derivative of the path with respect to the driver.
        residual: (m, rows) closure rows.
        sign: (m,) sign of the determinant, 0 when singular.
        magnitude: (m,) logarithm of its size.
    """

    t: Array
    c: Array
    residual: Array
    sign: Array
    magnitude: Array


def is_possible(branch: Branch) -> bool:
    """Whether the branch's equations are plain products and all its freedoms determined."""
    accuracy = branch.accuracy
    return (
        branch.evaluation.is_plain
        and not len(branch.system.passive)
        and accuracy.corrections is None
        and accuracy.order == 3
    )


def is_short(branch: Branch, h: float) -> bool:
    """Whether a step h of the driver moves the joints little enough for a run."""
    return float(np.abs(h * branch.t / branch.scale).max()) <= LONGEST_STEP


class EqualSteps:
    """Where in a list of driver values the steps are equal."""

    def __init__(self, values: Array) -> None:
        steps = np.diff(values)
        n = len(steps)
        new = np.ones(n + 1, dtype=bool)  # whether step i begins another run
        if n > 1:
            new[1:n] = np.abs(np.diff(steps)) > 1e-9 * np.abs(steps[1:])
        begins = np.flatnonzero(new)
        run = np.cumsum(new[:n]) - 1
        self.begin, self.end, self.steps = begins[:-1][run], begins[1:][run], steps

    def until(self, k: int) -> int:
        """Return the row after the last equal step around row k, or k for too few of them."""
        j = k - 1  # the step from row k - 1 to row k
        if not 0 <= j < len(self.steps) or self.steps[j] == 0.0 or self.begin[j] > k - HISTORY:
            return k
        end = int(self.end[j]) + 1
        return end if end - k >= SHORTEST else k


def follow(branch: Branch, values: Array, q: Array, k: int, end: int) -> tuple[int, Rows | None]:
    """Follow equal steps from row k on; q (N, nq) holds the rows before and takes the new ones.

    Returns:
        The row after the last good one, at most `end`, and the rates of the rows from k on.
    """
    reached = _positions(branch, values, q, k, end)
    if reached - k < SHORTEST:
        return k, None
    rows = _rates(branch, q[k:reached])
    good = _good(branch, float(values[k] - values[k - 1]), q[k - 1 : reached], rows)
    return k + good, Rows(*(x[:good] for x in rows))


def _positions(branch: Branch, values: Array, q: Array, k: int, end: int) -> int:
    """Fill q[k:end]; return the first row that would not close."""
    model = branch.model
    corrector = _Corrector(branch, float(values[k] - values[k - 1]))
    has_quaternions = model.nq != model.nv
    for row, value in enumerate(values[k:end].tolist(), start=k):
        x = np.dot(_EXTRAPOLATION, q[row - HISTORY : row])
        if has_quaternions:
            x = pin.normalize(model, x)
        closed = corrector.close(x, value)
        if closed is None:
            return row
        q[row] = closed
    return end


class _Corrector:
    """Chord method: a correction is one product of a kept matrix with the terms A * B of the rows.

    The size of a correction is the measure of closure: one below the tolerance is the last. The
    kept matrix is made anew when corrections shrink slowly. The batch judges the residuals.
    """

    def __init__(self, branch: Branch, h: float) -> None:
        self.branch, self.h = branch, h
        self.model, self.data = branch.model, branch.evaluation.data
        self.buffers = branch.evaluation.product_buffers()
        self.flat_terms = self.buffers[-1].reshape(-1)
        last = branch.accuracy.tolerance * min(1.0, branch.mechanism.characteristic_length)
        self.last = last * last
        self.is_stale = True

    def close(self, x: Array, value: float) -> Array | None:
        """Return the closed configuration near x at the driver value, None when it goes astray."""
        model, data, branch, terms = self.model, self.data, self.branch, self.flat_terms
        g, c_ab, ab, a, b, products = self.buffers
        kinematics, dot, multiply = pin.computeJointJacobians, np.dot, np.multiply
        branch.hold(x, value)
        if self.is_stale and not self._renew(x):
            return None
        before = math.inf
        for attempt in range(CHORDS):
            kinematics(model, data, x)
            dot(c_ab, g, ab)
            multiply(a, b, products)
            step = dgemv(1.0, self.chord, terms)
            if self.offset is not None:
                step += self.offset
            if not attempt:
                for spin, column in zip(branch.spins, self.spin_chord, strict=True):
                    step += spin.error(self.h) * column
            size = step.dot(step)
            x = pin.integrate(model, x, step)
            branch.hold(x, value)
            if attempt and size > CONTRACTION * before:
                self.is_stale = True
            if size <= self.last:
                for spin in branch.spins:
                    spin.accept(self.h)
                return x
            before = size
        return None

    def _renew(self, x: Array) -> bool:
        self.branch.evaluation.update(x)
        if not self.branch.system.factor():
            return False
        self.chord, self.offset, self.spin_chord = self.branch.system.chord()
        self.is_stale = False
        return True


def _rates(branch: Branch, q: Array) -> Rows:
    evaluation, system = branch.evaluation, branch.system
    c = evaluation.constraints
    m, r = len(q), len(c.constants)
    jacobians, placed = _placements(branch, q)
    g = np.ascontiguousarray(placed.reshape(m, -1, 3).transpose(2, 0, 1))  # (3, m, 4 njoints)
    a, b, x = _vectors(g, c.c_abx, 3)
    residual = _dot(a, b) - c.constants
    wrenches = np.empty((6, m, r))
    np.multiply(b, c.factors[:, 0], out=wrenches[:3])
    _cross(x, b, wrenches[3:])
    wrenches[3:, :, c.passive_at :] = b[:, :, c.passive_at :]
    products = wrenches.transpose(1, 2, 0) @ jacobians
    products *= c.signs
    matrices = system.stack(products)
    sign, magnitude = np.linalg.slogdet(matrices)
    sign[~np.isfinite(magnitude)] = 0.0
    if not sign.all():  # judged singular: leave the solver something regular to do
        matrices[sign == 0.0] = np.eye(matrices.shape[1])
    drive = np.broadcast_to(branch.unit[:, None], (m, len(branch.unit), 1))
    t = branch.scale * np.linalg.solve(matrices, drive)[:, :, 0]
    rhs = np.zeros((m, len(branch.unit), 1))
    system.put_bias(rhs[:, :, 0], _bias(branch, q, t, placed, g))
    second = branch.scale * np.linalg.solve(matrices, rhs)[:, :, 0]
    return Rows(t, second, residual[:, : c.n_rows], sign, magnitude)


def _placements(branch: Branch, q: Array) -> tuple[Array, Array]:
    """Return Pinocchio's joint Jacobians (m, 6, nv) and joint placements (m, njoints, 4, 3)."""
    model, data, placement = branch.model, branch.evaluation.data, branch.evaluation.placements
    jacobians, placed = np.empty((len(q), 6, model.nv)), np.empty((len(q), *placement.shape))
    columns = joint_jacobian(data, model.nv)
    for k, x in enumerate(q):
        pin.computeJointJacobians(model, data, x)
        jacobians[k] = columns
        placed[k] = placement
    return jacobians, placed


def _bias(branch: Branch, q: Array, t: Array, placed: Array, g: Array) -> Array:
    """Return (m, rows + passive) second derivatives of the rows at zero joint acceleration."""
    model, data, c = branch.model, branch.evaluation.data, branch.evaluation.constraints
    m, n = len(q), model.njoints
    twist, acceleration = twists(data), accelerations(data)
    local = np.empty((m, n, 12))
    moving, accelerating = local[..., :6], local[..., 6:]
    zero = np.zeros(model.nv)
    for k in range(m):
        pin.forwardKinematics(model, data, q[k], t[k], zero)
        moving[k] = twist
        accelerating[k] = acceleration
    # linear and angular parts of twist and acceleration in world axes (xyz, m, n)
    v, w, a, alpha = (local.reshape(m, n, 4, 3) @ placed[:, :, :3]).transpose(2, 3, 0, 1)
    g1, g2, spin = np.empty_like(g), np.empty_like(g), np.empty_like(g)
    w = np.repeat(w, 4, axis=2)
    _cross(w, g, g1)
    g1[:, :, 3::4] = v
    _cross(w, g1, g2)  # omega x R', and omega x v of the classical acceleration
    _cross(np.repeat(alpha, 4, axis=2), g, spin)
    spin[:, :, 3::4] = a
    g2 += spin
    c_ab = c.c_abx[: 2 * len(c.constants)]
    (a0, b0), (a1, b1), (a2, b2) = (_vectors(x, c_ab, 2) for x in (g, g1, g2))
    bias = _dot(a2, b0) + 2.0 * _dot(a1, b1) + _dot(a0, b2)
    if c.n_passive:
        bias[:, c.passive_at :] = accelerating.reshape(m, 6 * n) @ c.spin_bias.T
    return bias


def _vectors(g: Array, coefficients: Array, blocks: int) -> list[Array]:
    """Return the blocks (3, m, r) of vectors that are linear in G (3, m, 4 njoints)."""
    m = g.shape[1]
    vectors = (g.reshape(3 * m, -1) @ coefficients.T).reshape(3, m, blocks, -1)
    return [vectors[:, :, k] for k in range(blocks)]


def _dot(x: Array, y: Array) -> Array:
    """Return x . y; the vectors lie along axis 0."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def _cross(x: Array, y: Array, out: Array) -> None:
    """Write x × y; the vectors lie along axis 0."""
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(x[j], y[k], out=out[i])
        out[i] -= x[k] * y[j]


def _good(branch: Branch, h: float, q: Array, rows: Rows) -> int:
    """Return how many rows pass; q (m + 1, nq) begins with the row before them."""
    t = np.vstack([branch.t, rows.t])
    c = np.vstack([branch.c, rows.c])
    at, v = branch.linear
    # Hermite, as in `Branch`
    moved = np.diff(q[:, at], axis=0)
    told = (0.5 * h) * (t[:-1] + t[1:]) + (h * h / 12.0) * (c[:-1] - c[1:])
    size, gap = (np.linalg.norm(x, axis=1) for x in (moved, moved - told[:, v]))
    length = np.sqrt(np.vecdot(t, t))
    cosine = np.vecdot(t[:-1], t[1:]) / (length[:-1] * length[1:])
    magnitude = np.concatenate([[rows.magnitude[0]], rows.magnitude])
    root = np.exp(0.5 * (magnitude - magnitude.max()))
    vanishing = np.zeros(len(root) - 1, dtype=bool)
    vanishing[1:] = 2.0 * root[1:-1] < root[:-2]  # zero is due before the row
    worn = WORN if branch.system.has_redundant_rows else SINGULAR
    bad = (
        (np.abs(rows.residual).max(axis=1) > branch.accuracy.tolerance)
        | (rows.sign != branch.sign)
        | (magnitude[1:] < magnitude.max() + math.log(worn))
        | vanishing
        | (np.abs(h * rows.t / branch.scale).max(axis=1) > LONGEST_STEP)
        | (gap > UNEXPLAINED * size + 1e-12)
        | ~(cosine > STRAIGHT)
        | ~np.isfinite(rows.c).all(axis=1)
    )
    return int(np.argmax(bad)) if bad.any() else len(bad)
