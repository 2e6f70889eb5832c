"""Equidistant points of a branch, close enough to interpolate between, computed together."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spatial_pin.kinematics.batch import BranchBatch, Placed
from spatial_pin.kinematics.branch import Branch
from spatial_pin.kinematics.flat import WRAPPED, cross, dot
from spatial_pin.kinematics.interpolation import NodeCurve, integrals
from spatial_pin.linalg import Array, StackedLU
from spatial_pin.mechanism.configuration import blur

FEWEST = 4  # nodes that make a curve
SINGULAR = 1e-4  # fraction of the largest determinant below which arc length has the better view
ROUGH = 1e-6  # closure residual of steps
OFF = 1e-4  # closure residual of an interpolated point that is no longer a small correction
CORRECTIONS = 3
SPIN_PASSES = 6
SPIN_LEFT = 1e-8  # spin after which another pass would find none


class Skeleton(NamedTuple):
    """Equal steps of a branch.

    Attributes:
        curve: configurations (nq, m) between them as a function of driver values.
        turns: (n_angles, steps + 1) angles of screw closures.
    """

    curve: NodeCurve
    turns: Array

    @property
    def n(self) -> int:
        """Number of steps."""
        return self.curve.n - 1

    @property
    def s0(self) -> float:
        """First driver value."""
        return self.curve.s0

    @property
    def h(self) -> float:
        """Step, of either sign."""
        return self.curve.h

    @property
    def end(self) -> float:
        """Driver value of the last step."""
        return self.s0 + self.h * self.n

    def angles(self, values: Array) -> Array:
        """Return the angles (n_angles, m) of screw closures at driver values, roughly."""
        at = (values - self.s0) / self.h
        rows = [np.interp(at, np.arange(self.n + 1), angle) for angle in self.turns]
        return np.array(rows).reshape(-1, len(values))


class Points(NamedTuple):
    """Closed points of a branch, m of them, with their systems and rates; arrays as in `batch`.

    Attributes:
        off: largest closure residual before they were closed.
        good: how many pass before the first that is open, or beyond or near a singularity.
    """

    placed: Placed
    lu: StackedLU
    t: Array
    c: Array
    rates: tuple[Array, Array]
    off: float
    good: int


def steps(batch: BranchBatch, h: float, n: int) -> Skeleton | None:
    """Take at most n steps h with a branch; None, and the branch as it was, if they are too few.

    They are closed no better than the curve between them.
    """
    branch = batch.branch
    accuracy = branch.accuracy
    branch.accuracy = replace(accuracy, tolerance=max(accuracy.tolerance, ROUGH))
    try:
        return _steps(batch, h, n)
    finally:
        branch.accuracy = accuracy


def _steps(batch: BranchBatch, h: float, n: int) -> Skeleton | None:
    branch = batch.branch
    start = branch.q, branch.angles, branch.s, [copy(spin) for spin in branch.spins], branch.rooms
    rows, angles = [(branch.q, branch.t, branch.c)], [branch.angles]
    for j in range(1, n + 1):
        selected = branch.system.rows
        if not branch.step(start[2] + h * j):
            break
        rows.append((branch.q, branch.t, branch.c))
        angles.append(branch.angles)
        if branch.system.rows is not selected:  # what follows has other independent rows
            break
    if len(rows) < FEWEST:
        branch.evaluation.turns[:] = start[1]
        branch.place(start[0])
        branch.s, branch.spins, branch.rooms = start[2:]
        return None
    q, t, c = (np.ascontiguousarray(np.array(x).T) for x in zip(*rows, strict=True))
    curve = NodeCurve(start[2], h, q, *batch.tree.entry_rates(q, t, c))
    return Skeleton(curve, np.array(angles).T)


def divided(batch: BranchBatch, skeleton: Skeleton, parts: int) -> tuple[Skeleton | None, float]:
    """Return a skeleton with its steps divided, free of spin, as far as its points are good.

    None if these are too few. Second, the largest closure residual of the points before they were
    closed.
    """
    h, n = skeleton.h / parts, skeleton.n * parts
    values = skeleton.s0 + h * np.arange(n + 1)
    points = closed(batch, skeleton, values)
    n = points.good
    if n < FEWEST:
        return None, points.off
    q = points.placed.q
    if batch.branch.spins:
        q = batch.tree.integrate(q, batch.spinning(points.lu, -_spun(batch, h, points)))
        points = _evaluated(batch, batch.place(q, points.placed.angles), points.off)
    q, t, c, angles = (x[:, :n] for x in (q, points.t, points.c, points.placed.angles))
    curve = NodeCurve(skeleton.s0, h, q, *batch.tree.entry_rates(q, t, c))
    return Skeleton(curve, angles), points.off


def closed(batch: BranchBatch, skeleton: Skeleton, values: Array) -> Points:
    """Return the points of the branch at driver values (m,), in order, on a skeleton."""
    placed, off = _placed(batch, skeleton, values)
    points = _evaluated(batch, placed, off)
    return points._replace(good=min(points.good, before_zero(values, points.lu.magnitude)))


def _placed(batch: BranchBatch, skeleton: Skeleton, values: Array) -> tuple[Placed, float]:
    branch = batch.branch
    near, q = skeleton.angles(values), skeleton.curve(values)
    batch.tree.normalize(q)
    branch.hold(q, values)
    placed = batch.place(q, near)
    residual = np.abs(placed.residual).max(axis=0, initial=0.0)
    enough = 0.1 * tolerance(branch)
    opened = np.flatnonzero((residual > enough) & (residual < OFF))
    if opened.size:
        some = placed.take(opened)
        lu = batch.factor(some)  # good for all corrections: points move little
        for _ in range(CORRECTIONS):
            q = batch.tree.integrate(some.q, np.nan_to_num(batch.correction(some, lu)))
            branch.hold(q, values[opened])
            some = batch.place(q, near[:, opened])
            if np.abs(some.residual).max() <= enough:
                break
        placed.put(opened, some)
    return placed, float(residual.max())


def _evaluated(batch: BranchBatch, placed: Placed, off: float) -> Points:
    branch = batch.branch
    lu = batch.factor(placed)
    t, c, first, second = batch.path_rates(placed, lu)
    bad = (
        ~(np.abs(placed.residual).max(axis=0, initial=0.0) <= tolerance(branch))
        | (lu.sign != branch.sign)
        | (lu.magnitude < lu.magnitude.max() + math.log(SINGULAR))
        | ~np.isfinite(c).all(axis=0)
    )
    good = int(np.argmax(bad)) if bad.any() else len(bad)
    return Points(placed, lu, t, c, (first, second), off, good)


def before_zero(values: Array, magnitude: Array) -> int:
    """Return how many points come before one that a singular configuration is due before.

    Two branches that cross twice at one place leave the sign of the determinant as it was, but its
    root falls towards zero like a straight line.

    Args:
        values: (m,) driver values, rising or falling.
        magnitude: (m,) logarithms of the determinants.
    """
    if len(values) < 3:
        return len(values)
    root, step = np.exp(0.5 * (magnitude - magnitude.max())), np.diff(values)
    fall = (root[:-2] - root[1:-1]) / step[:-1] * step[1:]
    due = root[1:-1] < fall
    return 2 + int(np.argmax(due)) if due.any() else len(values)


def room_after(values: Array, magnitude: Array, sense: float) -> float:
    """Return how far beyond the last of two points a singular configuration is due, in a sense.

    Args:
        values: (2,) driver values.
        magnitude: (2,) logarithms of the determinants.
        sense: a number of the sign of the way on.
    """
    root = np.exp(0.5 * (magnitude - magnitude[-1]))
    fall = -math.copysign(1.0, sense) * float((root[1] - root[0]) / (values[1] - values[0]))
    return 1.0 / fall if fall > 0.0 else math.inf


def tolerance(branch: Branch) -> float:
    """Return the closure residual of closed points: no finer than round-off allows."""
    return max(branch.tolerance, 1e-14, blur(branch.mechanism, branch.q))


def _spun(batch: BranchBatch, h: float, points: Points) -> Array:
    """Return the spin (n_passive, n) of points a step h apart, which ought to be none.

    The rates have no spin, whatever the spin of the configuration: what the rotation of the body
    moves more than the integral of its rate tells is spin. Taken back, it tells better.
    """
    constraints = batch.constraints
    spun = np.zeros((len(constraints.spins), points.t.shape[1]))
    turning = batch.tree.columns(points.placed.g)[3:]
    for total, (joint, axis) in zip(spun, constraints.spins, strict=True):
        at = batch.tree.carrier[joint]
        columns = points.placed.g[at, :3]
        support = constraints.support(joint)
        alpha = np.einsum("ivm,vm,v->im", turning, points.c, support)[WRAPPED]
        w, alpha = points.rates[0][at, 0, None], (points.rates[1][at, 0] + alpha)[None]
        line = np.einsum("k,kxm->xm", axis, columns)
        for _ in range(SPIN_PASSES):
            spin = _spin(h, columns, w, alpha, line)
            total += spin
            if np.abs(spin).max() < SPIN_LEFT:
                break
            columns = _turned(columns, line, -spin)
    return spun


def _spin(h: float, columns: Array, w: Array, alpha: Array, line: Array) -> Array:
    """Return how much the columns (3, 5, n) of a rotation have turned about a line (5, n).

    More than their rates tell, since the first point.
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
