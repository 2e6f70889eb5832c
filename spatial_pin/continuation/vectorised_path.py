"""Many driver values at once: steps as long as the branch allows, all rows together between them.

`Branch.step` follows the branch at equal distances that its curvature sets, whatever the rows are.
Its points and rates make a curve; rows are interpolated on it, closed, and get their rates
hundreds at a time (`batch`). Where rows are many, or bodies spin, the steps are divided first, so
that rows between them are closed to round-off as they are; a few hundred rows at equal distances
are such a division themselves. Every row is judged: closed, and on the same side of every
singularity; those from the first one that fails on are thrown away and followed step by step
instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from spatial_pin.continuation import collocation
from spatial_pin.continuation.branch import Branch
from spatial_pin.continuation.collocation import Points, Skeleton
from spatial_pin.continuation.stacked_branch import BranchBatch
from spatial_pin.numerics.linalg import Array

REST = 8  # rows step by step after a failure
CHUNK = 24_000  # joint coordinates in rows computed together: their arrays fit a processor's cache
TRIES = 3  # each with half the length, before rows are followed step by step
LONGEST = 128  # steps that make a curve
FIRST_STEP = 0.4  # rad, characteristic lengths, that a joint moves in the first steps
LONGEST_STEP = 0.7  # the same in any step
OFF = 3e-6  # closure residual between steps that their length is chosen for: one correction
CLOSED = 1e-15  # the same for divided steps: none
EVEN = 1e-15  # of the driver, by which rows at equal distances may be elsewhere
SPUN = 0.01  # rad, characteristic lengths, that a step of bodies that spin may be long
MANY = 3.0  # rows by steps after a division above which steps are divided
# costs [µs] of a row step by step, of a long step, of a row together with others, of all else
STEP_COST, LONG_COST, ROW_COST, START_COST = 70.0, 100.0, 3.5, 1500.0


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
        and not branch.system.is_bent
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
        self.rest = 0
        self._failures = 0
        self._length: float | None = None
        self._parts = 8
        sense = np.sign(np.diff(values))
        self._turns = np.flatnonzero(np.diff(sense)) + 1  # rows after which another sense begins

    def _reach(self, motion: float) -> float:
        """Return the change of the driver in which no joint moves further than `motion`."""
        driver = self.branch.scale[self.branch.driven[0].v]
        pace = float(np.abs(self.branch.t / self.branch.scale).max())
        return motion / max(pace, 1.0 / driver)

    def pays(self, k: int) -> int:
        """Return the row after those from row k on that are worth while to take together, or k."""
        if k == 0 or self.values[k] == self.values[k - 1]:
            return k
        at = int(np.searchsorted(self._turns, k))
        end = int(self._turns[at]) + 1 if at < len(self._turns) else len(self.values)
        left = abs(float(self.values[end - 1]) - self.branch.s)
        if self._length is None:
            self._length = self._reach(FIRST_STEP) * 0.5 ** min(self._failures, 3)
        if self.branch.spins and np.ptp(self.values[k - 1 : k + 1]) > self._reach(SPUN):
            return end  # only divided steps tell the spin exactly
        saved = (end - k) * (STEP_COST - ROW_COST) - left / self._length * LONG_COST - START_COST
        return end if saved > 0.0 else k

    def follow(self, k: int, end: int) -> Iterator[tuple[int, Rows]]:
        """Yield rows from row k on, with the place of the first; ends before one that fails.

        The branch stands at, or before, the row before k; afterwards at the last row that is good,
        or behind it.
        """
        branch, values, tries = self.branch, self.values, TRIES
        while k < end:
            left = float(values[end - 1]) - branch.s
            length = min(self._length or abs(left), self._reach(LONGEST_STEP))
            n = max(math.ceil(abs(left) / length * (1.0 - 1e-9)), collocation.FEWEST - 1)
            h = left / n
            skeleton = collocation.steps(self.batch, h, min(n, LONGEST))
            if skeleton is None:
                self._length, tries = 0.5 * abs(h), tries - 1
                if tries:
                    continue
                break
            until = self._until(skeleton, n, k, end)
            if until == k and not branch.spins:
                # shorter than the rows are apart: these are faster one by one
                self._stand(skeleton, k)
                break
            self._curve, self._off, self._is_whole = skeleton, 0.0, True
            for rows in self._rows(skeleton, k, until):
                yield k, rows
                k += len(rows.q)
                if k == len(values):
                    return
            failed = k < until or not self._is_whole
            self._stand(self._curve, k if failed else None)
            if failed:
                break
            tries = TRIES
            self._adapt(abs(h), skeleton.n == min(n, LONGEST))
        else:
            return
        self._failures += 1
        self.rest = REST * 2 ** min(self._failures - 1, 4)
        self._length = None

    def _until(self, skeleton: Skeleton, n: int, k: int, end: int) -> int:
        """Return the row after those from k on that a skeleton holds, `end` if it has n steps."""
        if skeleton.n == n:  # whatever round-off says of the last step
            return end
        sense = math.copysign(1.0, skeleton.h)
        return k + int(np.searchsorted(sense * self.values[k:end], sense * skeleton.end))

    def _adapt(self, h: float, is_whole: bool) -> None:
        """Choose the length of steps, and into how many to divide them, by the residual between."""
        size = max(self._off, 1e-4 * OFF)
        self._length = h * min(max(0.9 * (OFF / size) ** (1.0 / 12.0), 0.5), 1.8)
        self._parts = min(max(math.ceil((size / CLOSED) ** (1.0 / 12.0)), 2), 10)
        if is_whole:
            self._failures = 0
        else:
            self._length = min(self._length, 0.5 * h)

    def _rows(self, skeleton: Skeleton, k: int, end: int) -> Iterator[Rows]:
        """Yield rows from k to `end`, shortened by the first that fails."""
        n, curve = self._parts * skeleton.n, skeleton
        if self.branch.spins or end - k > MANY * n:
            rows = self.values[k - 1 : end]
            stride = _stride(rows, skeleton.s0, n) if end > k else 0
            values = (_subdivided(rows, stride) if stride else
                      np.linspace(skeleton.s0, skeleton.end, n + 1))
            points = collocation.divided(self.batch, skeleton, values)
            self._off, self._is_whole = points.off, points.good == len(values)
            if stride and points.good > stride:
                yield _rows_of(points, slice(stride, points.good, stride))
            joined = collocation.joined(self.batch, points, values)
            if stride or joined is None:
                self._curve = joined or skeleton
                return
            self._curve = curve = joined
            end = min(end, self._until(curve, n, k, end))
        if end > k:
            yield from self._on_curve(curve, k, end)

    def _on_curve(self, skeleton: Skeleton, k: int, end: int) -> Iterator[Rows]:
        """Yield rows from k to `end` in chunks, the last one shortened by the first that fails."""
        seen = np.empty((2, 0))
        chunks = math.ceil((end - k) * self.batch.tree.nv / CHUNK)
        for values in np.array_split(self.values[k:end], chunks):
            points = collocation.closed(self.batch, skeleton, values)
            self._off = max(self._off, points.off)
            seen = np.hstack([seen[:, -2:], [values, points.lu.magnitude]])
            before = seen.shape[1] - len(values)
            n = max(min(points.good, collocation.before_zero(*seen) - before), 0)
            if n:
                yield _rows_of(points, slice(n))
            if n < len(values):
                return

    def _stand(self, skeleton: Skeleton, row: int | None) -> None:
        """Take the branch to the row before `row`, or to the end of a skeleton."""
        s = skeleton.end if row is None else float(self.values[row - 1])
        if (s - skeleton.s0) / skeleton.h < 1e-9:
            s = skeleton.s0
        h = (0.25 if s != skeleton.s0 else -0.25) * skeleton.h
        values = np.array([s - h, s])
        points = collocation.closed(self.batch, skeleton, values)
        p = points.placed
        self.branch.evaluation.turns[:] = p.angles[:, 1]
        self.branch.jump(p.q[:, 0], p.q[:, 1], s, h)
        if self.branch.system.has_redundant_rows:
            self.branch.reselect()
        room = collocation.room_after(values, points.lu.magnitude, skeleton.h)
        self.branch.limit_room(room, skeleton.h)


def _rows_of(points: Points, which: slice) -> Rows:
    p = points.placed
    return Rows(*(x.T[which] for x in (p.q, points.t, points.c, p.residual, p.angles)))


def _stride(values: Array, s0: float, n: int) -> int:
    """Return into how many parts equal gaps of values from s0 on make n points, or not many more.

    0 if they make far more, or are not equal.
    """
    gaps = np.diff(values)
    if s0 != values[0] or np.ptp(gaps) > EVEN * np.abs(values).max():
        return 0
    stride = math.ceil(n / len(gaps))
    return stride if stride * len(gaps) <= MANY * n else 0


def _subdivided(values: Array, parts: int) -> Array:
    """Return values with each gap between them in equal parts."""
    m = len(values)
    return np.interp(np.arange((m - 1) * parts + 1) / parts, np.arange(m), values)
