"""Many driver values at once: nodes where the branch needs them, all rows together between them.

`Branch.step` is the specification; this is the same motion at a fraction of the cost. Nodes follow
the branch at equal distances that its curvature sets, whatever the rows are: extrapolated through
the last nodes and corrected with a matrix kept for a few steps (`nodes`). Rows are interpolated
between the nodes, corrected where their loops are not closed, and get their rates hundreds at a
time (`batch`). Every node and row is judged: closed, on the same side of every singularity, nodes
explained by the rates at both ends of their step. Rows from the first one that fails are thrown
away and followed step by step instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from spatial_pin.kinematics import nodes as node
from spatial_pin.kinematics.batch import BranchBatch, Placed
from spatial_pin.kinematics.branch import Branch
from spatial_pin.kinematics.interpolation import NodeCurve
from spatial_pin.kinematics.nodes import Nodes
from spatial_pin.linalg import Array

REST = 8  # rows step by step after a failure
CHUNK = 512  # rows that are computed together: their arrays fit a processor's cache
LONGEST = 96  # nodes that are judged together
FIRST_STEP = 0.08  # rad, characteristic lengths, that a joint moves between the first nodes
CLOSED = 1e-14  # closure residual between nodes that their distance is chosen for
# costs [µs] of a step of `Branch`, a node, a row, and of everything else
STEP_COST, NODE_COST, ROW_COST, START_COST = 55.0, 14.0, 3.0, 1200.0


class Rows(NamedTuple):
    """Some rows of a motion, m of them.

    Attributes:
        q: (m, nq) configurations.
        t, c: (m, nv) first and second derivative of the path with respect to the driver.
        residual: (m, n_rows) closure rows.
        angles: (m, n_angles) of screw closures, counting turns.
    """

    q: Array
    t: Array
    c: Array
    residual: Array
    angles: Array


def is_possible(branch: Branch) -> bool:
    """Whether all the branch's freedoms are determined, to tolerance, and it is not too large."""
    accuracy = branch.accuracy
    return (
        isinstance(branch.evaluation.constraints.c_abx, np.ndarray)
        and not len(branch.system.passive)
        and accuracy.corrections is None
        and accuracy.order == 3
    )


class Runner:
    """Follows a branch through many driver values at a time.

    Attributes:
        rest: rows to be followed step by step after a failure, before the next attempt.
    """

    def __init__(self, branch: Branch, values: Array) -> None:
        self.branch = branch
        self.values = values
        self.batch = BranchBatch(branch)
        self.tolerance = max(branch.accuracy.tolerance, CLOSED)
        self.rest = 0
        self._history: NodeCurve | None = None
        self._failures = 0
        self._restart()
        sense = np.sign(np.diff(values))
        self._turns = np.flatnonzero(np.diff(sense)) + 1  # rows after which another sense begins

    def _restart(self) -> None:
        """Choose the distance of nodes by the speed of the joints."""
        driver = self.branch.scale[self.branch.driven[0].v]
        pace = max(self._pace(), 1.0 / driver)
        self._spacing = FIRST_STEP / pace * 0.5 ** min(self._failures, 3)

    def _pace(self) -> float:
        return float(np.abs(self.branch.t / self.branch.scale).max())

    def pays(self, k: int) -> int:
        """Return the row after those from row k on that are worth while to take together, or k."""
        if k == 0 or self.values[k] == self.values[k - 1]:
            return k
        at = int(np.searchsorted(self._turns, k))
        end = int(self._turns[at]) + 1 if at < len(self._turns) else len(self.values)
        length = abs(float(self.values[end - 1]) - self.branch.s)
        if self._history is None:
            self._restart()
        saved = (end - k) * (STEP_COST - ROW_COST) - length / self._spacing * NODE_COST - START_COST
        return end if saved > 0.0 else k

    def follow(self, k: int, end: int) -> Iterator[tuple[int, Rows]]:
        """Yield rows from row k on, with the place of the first; ends before one that fails.

        The branch stands at, or before, the row before k; afterwards at the last row or node
        that is good.
        """
        branch, values = self.branch, self.values
        while k < end:
            left = float(values[end - 1]) - branch.s
            n_steps = max(math.ceil(abs(left) / self._spacing * (1.0 - 1e-9)), node.FEWEST - 1)
            h = left / n_steps
            nodes = node.follow(self.batch, h, min(n_steps, LONGEST), self._history)
            if nodes is None:
                break
            curve = nodes.curve(self.batch)
            until = end  # whatever round-off says of the last node
            if nodes.n <= n_steps:
                sense = math.copysign(1.0, h)
                until = k + int(np.searchsorted(sense * values[k:end], sense * nodes.end))
            self._open = 0.0
            for rows in self._rows(nodes, curve, k, until):
                yield k, rows
                k += len(rows.q)
            if k == len(values):
                return
            self._stand(nodes, curve, k if k < until else None)
            if k < until:
                break
            self._history = curve
            if nodes.n > min(n_steps, LONGEST):
                self._failures = 0
            if self._open:
                self._adapt(abs(h))
        else:
            return
        self._failures += 1
        self.rest = REST * 2 ** min(self._failures - 1, 4)
        self._history = None

    def _adapt(self, h: float) -> None:
        """Choose the distance of nodes for which rows between them would just be closed."""
        wanted = max(CLOSED, 0.01 * self.branch.accuracy.tolerance)
        factor = (wanted / max(self._open, 1e-4 * wanted)) ** (1.0 / 12.0)
        longest = 0.8 * node.LONGEST_STEP / self._pace()
        self._spacing = min(h * min(max(0.9 * factor, 0.5), 1.8), longest)

    def _rows(self, nodes: Nodes, curve: NodeCurve, k: int, end: int) -> Iterator[Rows]:
        """Yield rows from k to `end` in chunks, the last one shortened by the first that fails."""
        largest = float(nodes.lu.magnitude.max())
        for begin in range(k, end, CHUNK):
            values = self.values[begin : min(begin + CHUNK, end)]
            placed = self._closed(curve(values), values, nodes.angles(values))
            lu = self.batch.factor(placed)
            t, c, _, _ = self.batch.path_rates(placed, lu)
            bad = node.is_bad(self.branch, placed, lu, largest, self.tolerance)
            bad |= ~np.isfinite(c).all(axis=0)
            n = int(np.argmax(bad)) if bad.any() else len(values)
            if n:
                yield Rows(*(x.T[:n] for x in (placed.q, t, c, placed.residual, placed.angles)))
            if n < len(values):
                return

    def _closed(self, q: Array, values: Array, near: Array) -> Placed:
        """Return configurations at driver values, taken from q (nq, m) to closed loops."""
        batch = self.batch
        batch.tree.normalize(q)
        self._hold(q, values)
        placed = batch.place(q, near)
        for attempt in range(2):
            residual = np.abs(placed.residual).max(axis=0, initial=0.0)
            if not attempt:
                self._open = max(self._open, float(residual.max()))
            open_rows = np.flatnonzero(residual > 0.1 * self.tolerance)
            if not open_rows.size:
                break
            some = placed.take(open_rows)
            step = batch.correction(some, batch.factor(some))
            moved = batch.tree.integrate(some.q, np.nan_to_num(step))
            self._hold(moved, values[open_rows])
            q[:, open_rows] = moved
            placed = batch.place(q, near)
        return placed

    def _hold(self, q: Array, values: Array) -> None:
        q[self.branch.at] = values
        for index, fixed in self.branch.held:
            q[index] = fixed

    def _stand(self, nodes: Nodes, curve: NodeCurve, row: int | None) -> None:
        """Take the branch to the row before `row`, or to the last node."""
        s = nodes.end if row is None else float(self.values[row - 1])
        if (s - nodes.s0) / nodes.h < 1e-9:
            s = nodes.s0
        h = 0.25 * nodes.h if s != nodes.s0 else -0.25 * nodes.h
        points = np.array([s - h, s])
        placed = self._closed(curve(points), points, nodes.angles(points))
        self.branch.evaluation.turns[:] = placed.angles[:, 1]
        self.branch.jump(placed.q[:, 0], placed.q[:, 1], s, h)
        if self.branch.system.has_redundant_rows:
            self.branch.reselect()
