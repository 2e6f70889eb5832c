"""Equidistant points of a branch, close enough to interpolate between, computed together."""

from __future__ import annotations

import math
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.kinematics.batch import BranchBatch, Placed
from spatial_pin.kinematics.branch import Branch
from spatial_pin.kinematics.chord import NEAR, Chord
from spatial_pin.kinematics.flat import WRAPPED, cross, dot
from spatial_pin.kinematics.interpolation import NodeCurve, integrals
from spatial_pin.linalg import Array, StackedLU

HISTORY = 8  # nodes that an extrapolation goes through
FEWEST = 4  # nodes that make a curve
STRAIGHT = 0.9  # least cosine between the path directions at the two ends of a step
LONGEST_STEP = 0.5  # rad, characteristic lengths, that a joint may move between nodes
SINGULAR = 1e-4  # fraction of the largest determinant below which arc length has the better view
WORN = 0.1  # the same where redundant rows might better be chosen anew
UNEXPLAINED = 1e-3  # part of a step that the rates at its two ends may leave unexplained
SPIN_PASSES = 2
SPIN_LEFT = 1e-8  # spin after which another pass would find none
_EXTRAPOLATION = np.array(
    [(-1.0) ** (HISTORY - 1 - k) * math.comb(HISTORY, k) for k in range(HISTORY)]
)


class Nodes(NamedTuple):
    """Nodes s0 + h j of a branch, n of them; arrays as in `batch`."""

    s0: float
    h: float
    placed: Placed
    lu: StackedLU
    t: Array
    c: Array
    rates: tuple[Array, Array]

    @property
    def n(self) -> int:
        """Number of nodes."""
        return self.placed.q.shape[1]

    @property
    def end(self) -> float:
        """Driver value of the last node."""
        return self.s0 + self.h * (self.n - 1)

    def angles(self, values: Array) -> Array:
        """Return the angles (n_angles, m) of screw closures at driver values, roughly."""
        at = (values - self.s0) / self.h
        rows = [np.interp(at, np.arange(self.n), angle) for angle in self.placed.angles]
        return np.array(rows).reshape(-1, len(values))

    def curve(self, batch: BranchBatch) -> NodeCurve:
        """Return the configurations (nq, m) between the nodes as a function of driver values."""
        q = self.placed.q
        return NodeCurve(self.s0, self.h, q, *batch.tree.entry_rates(q, self.t, self.c))


def follow(
    batch: BranchBatch, h: float, n_steps: int, history: NodeCurve | None
) -> Nodes | None:
    """Return nodes from the branch's place on, at most n_steps + 1, up to the first that fails.

    None, and the branch as it was, if they are too few for a curve.

    Args:
        batch: of the branch, which is moved to some node.
        h: distance of the nodes, of either sign.
        n_steps: number of steps wanted.
        history: the branch up to its place, if known.
    """
    branch = batch.branch
    start = branch.q, branch.angles, branch.s, [copy(spin) for spin in branch.spins]
    q = _chain(branch, h, n_steps, history)
    nodes = _judged(batch, start[2], h, q, start[1]) if len(q) >= FEWEST else None
    if nodes is None:
        branch.evaluation.turns[:] = start[1]
        branch.place(start[0])
        branch.s, branch.spins = start[2:]
    return nodes


def _chain(branch: Branch, h: float, n_steps: int, history: NodeCurve | None) -> Array:
    """Return configurations (n, nq), all but closed, one from the other."""
    first, s = HISTORY - 1, branch.s
    q = np.empty((first + n_steps + 1, branch.model.nq))
    q[first] = branch.q
    past = s - h * np.arange(first, 0, -1)
    done = 0
    if history is not None and history.reaches(float(past[0])):
        q[:first] = history(past).T
    else:
        for done in range(1, min(n_steps, first) + 1):
            if not branch.step(s + h * done):
                return q[first : first + done]
            q[first + done] = branch.q
    chord = Chord(branch, h)
    for j in range(done + 1, n_steps + 1):
        found = chord.close(_EXTRAPOLATION @ q[first + j - HISTORY : first + j], s + h * j)
        if found is None:
            return q[first : first + j]
        q[first + j] = found
    return q[first:]


def _judged(
    batch: BranchBatch, s0: float, h: float, q: Array, angles: Array
) -> Nodes | None:
    """Return the nodes q (n, nq), closed and free of spin, up to the first that fails.

    None if these are too few. The first has the screw angles `angles`.
    """
    near = np.repeat(angles[:, None], len(q), axis=1)
    placed = batch.place(np.ascontiguousarray(q.T), near)
    if len(near):
        near = np.unwrap(placed.angles, axis=1)
        near += angles[:, None] - near[:, :1]
        placed = batch.place(placed.q, near)
    nodes = _evaluated(batch, s0, h, placed)
    n = _good(batch.branch, nodes)
    if n < FEWEST:
        return None
    step = batch.correction(placed, nodes.lu)
    if batch.branch.spins:
        step += batch.spinning(nodes.lu, -_spun(batch, nodes))
    q = batch.tree.integrate(placed.q[:, :n], step[:, :n])
    return _evaluated(batch, s0, h, batch.place(q, near[:, :n]))


def _evaluated(batch: BranchBatch, s0: float, h: float, placed: Placed) -> Nodes:
    lu = batch.factor(placed)
    t, c, first, second = batch.path_rates(placed, lu)
    return Nodes(s0, h, placed, lu, t, c, (first, second))


def _good(branch: Branch, nodes: Nodes) -> int:
    """Return how many nodes pass, the first one included."""
    h, t, c, lu = nodes.h, nodes.t, nodes.c, nodes.lu
    at, v = branch.linear
    # Hermite, as in `Branch`
    moved = np.diff(nodes.placed.q[at], axis=1)
    told = (0.5 * h) * (t[:, :-1] + t[:, 1:]) + (h * h / 12.0) * (c[:, :-1] - c[:, 1:])
    size, gap = (np.sqrt(np.square(x).sum(axis=0)) for x in (moved, moved - told[v]))
    length = np.sqrt(np.square(t).sum(axis=0))
    cosine = (t[:, :-1] * t[:, 1:]).sum(axis=0) / (length[:-1] * length[1:])
    root = np.exp(0.5 * (lu.magnitude - lu.magnitude.max()))
    vanishing = np.zeros(len(gap), dtype=bool)
    vanishing[1:] = 2.0 * root[1:-1] < root[:-2]  # zero is due before the node
    bad = (
        is_bad(branch, nodes.placed, lu, float(lu.magnitude.max()), 10.0 * NEAR)[1:]
        | vanishing
        | (np.abs(h * t[:, 1:] / branch.scale[:, None]).max(axis=0) > LONGEST_STEP)
        | ~(gap <= UNEXPLAINED * size + 1e-12)
        | ~(cosine > STRAIGHT)
        | ~np.isfinite(c[:, 1:]).all(axis=0)
    )
    return 1 + (int(np.argmax(bad)) if bad.any() else len(bad))


def is_bad(
    branch: Branch, placed: Placed, lu: StackedLU, largest: float, tolerance: float
) -> NDArray[np.bool_]:
    """Return which points are open, or beyond or too near a singular configuration.

    Args:
        branch: the branch.
        placed: the points.
        lu: their systems.
        largest: logarithm of the largest determinant around.
        tolerance: closure residual of a closed one.
    """
    worn = WORN if branch.system.has_redundant_rows else SINGULAR
    return (
        ~(np.abs(placed.residual).max(axis=0, initial=0.0) <= tolerance)
        | (lu.sign != branch.sign)
        | (lu.magnitude < largest + math.log(worn))
    )


def _spun(batch: BranchBatch, nodes: Nodes) -> Array:
    """Return the spin (n_passive, n) of each node since the first, which ought to be none.

    The rates have no spin, whatever the spin of the configuration: what the rotation of the body
    moves more than the integral of its rate tells is spin. Taken back, it tells better.
    """
    constraints = batch.constraints
    spun = np.zeros((len(constraints.spins), nodes.n))
    turning = batch.tree.columns(nodes.placed.g)[3:]
    for total, (joint, axis) in zip(spun, constraints.spins, strict=True):
        at = batch.tree.carrier[joint]
        columns = nodes.placed.g[at, :3]
        support = constraints.support(joint)
        alpha = np.einsum("ivm,vm,v->im", turning, nodes.c, support)[WRAPPED]
        w, alpha = nodes.rates[0][at, 0, None], (nodes.rates[1][at, 0] + alpha)[None]
        line = np.einsum("k,kxm->xm", axis, columns)
        for _ in range(SPIN_PASSES):
            spin = _spin(nodes.h, columns, w, alpha, line)
            total += spin
            if np.abs(spin).max() < SPIN_LEFT:
                break
            columns = _turned(columns, line, -spin)
    return spun


def _spin(h: float, columns: Array, w: Array, alpha: Array, line: Array) -> Array:
    """Return how much the columns (3, 5, n) of a rotation have turned about a line (5, n).

    More than their rates tell, since the first node.
    """
    first = cross(w, columns)
    second = cross(w, first) + cross(alpha, columns)
    missing = np.diff(columns[:, :3], axis=-1) - integrals(h, first[:, :3], second[:, :3])
    missing = np.concatenate([missing, missing[:, :2]], axis=1)
    middle = 0.5 * (columns[..., :-1] + columns[..., 1:])
    along = 0.5 * (line[:, :-1] + line[:, 1:])
    turned = 0.5 * dot(along, cross(middle, missing).sum(axis=0))
    return np.concatenate([[0.0], np.cumsum(turned)])


def _turned(columns: Array, line: Array, angle: Array) -> Array:
    """Return the columns (3, 5, n) turned about unit vectors (5, n) [Rodrigues]."""
    along = line * dot(line[None], columns)[:, None]
    return along + np.cos(angle) * (columns - along) + np.sin(angle) * cross(line[None], columns)
