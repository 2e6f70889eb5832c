"""Equidistant points of a branch, close enough to interpolate between, computed together."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spatial_pin.constraints.stacked import Placed
from spatial_pin.constraints.vectorised_tree import WRAPPED, cross, dot, turned_back
from spatial_pin.continuation.branch import Branch
from spatial_pin.continuation.stacked_branch import BranchBatch
from spatial_pin.mechanism.coordinates import blur
from spatial_pin.numerics.interpolation import NodeCurve, integrals
from spatial_pin.numerics.linalg import Array, StackedLU

FEWEST = 4  # nodes that make a curve
SINGULAR = 1e-4  # fraction of the largest determinant below which arc length has the better view
ROUGH = 1e-6  # closure residual of steps
OFF = 1e-4  # closure residual of an interpolated point that is no longer a small correction
CORRECTIONS = 3
SPIN_PASSES = 6
SPIN_LEFT = 1e-8  # spin after which another pass would find none
NEGLIGIBLE = 1e-9  # of the displacement of other joints: round-off


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


def divided(batch: BranchBatch, skeleton: Skeleton, values: Array) -> Points:
    """Return points of the branch, free of spin, at equal distances from a skeleton's start on."""
    points = closed(batch, skeleton, values)
    if batch.branch.spins:
        h = float(values[-1] - values[0]) / (len(values) - 1)
        points = _displaced(batch, points, batch.spinning(points.lu, -_spun(batch, h, points)))
    return points


def _displaced(batch: BranchBatch, points: Points, step: Array) -> Points:
    """Return points moved by passive displacements (nv, m), which leave all other bodies alone."""
    q, tree = points.placed.q, batch.tree
    q, sizes = tree.displace(q, step), np.abs(step).max(axis=1)
    moved = [j for j in tree.joints
             if sizes[j.v : j.v + j.n].max() > NEGLIGIBLE * sizes.max()]
    if len(moved) == len(batch.branch.spins) and all(j.kind == "ball" for j in moved):
        # each turns in its own ball alone: rates are as they were, in axes that have turned
        t, c = points.t.copy(), points.c.copy()
        for j in moved:
            at = slice(j.v, j.v + 3)
            t[at], c[at] = (turned_back(x[at], step[at]) for x in (t, c))
        return points._replace(placed=points.placed._replace(q=q), t=t, c=c)
    placed, _ = _closed(batch, q, points.placed.angles, q[batch.branch.at])
    again = _evaluated(batch, placed, points.off)
    return again._replace(good=min(points.good, again.good))


def joined(batch: BranchBatch, points: Points, values: Array) -> Skeleton | None:
    """Return a skeleton of the good ones of `divided` points, None if these are too few."""
    n = points.good
    if n < FEWEST:
        return None
    q, t, c, angles = (x[:, :n] for x in
                       (points.placed.q, points.t, points.c, points.placed.angles))
    h = float(values[-1] - values[0]) / (len(values) - 1)
    curve = NodeCurve(float(values[0]), h, q, *batch.tree.entry_rates(q, t, c))
    return Skeleton(curve, angles)


def closed(batch: BranchBatch, skeleton: Skeleton, values: Array) -> Points:
    """Return the points of the branch at driver values (m,), in order, on a skeleton."""
    q = skeleton.curve(values)
    batch.tree.normalize(q)
    batch.branch.hold(q, values)
    points = _evaluated(batch, *_closed(batch, q, skeleton.angles(values), values))
    return points._replace(good=min(points.good, before_zero(values, points.lu.magnitude)))


def _closed(batch: BranchBatch, q: Array, near: Array, values: Array) -> tuple[Placed, float]:
    """Return configurations q (nq, m) closed by small corrections, and how open they were."""
    branch = batch.branch
    placed = batch.place(q, near)
    residual = np.abs(placed.residual).max(axis=0, initial=0.0)
    enough = 0.1 * tolerance(branch)
    near_enough = residual < OFF
    if near_enough.all():
        if residual.max() > enough:
            placed = _corrected(batch, placed, near, values, enough)
    elif (some := np.flatnonzero(near_enough & (residual > enough))).size:
        placed.put(some, _corrected(batch, placed.take(some), near[:, some], values[some], enough))
    return placed, float(residual.max())


def _corrected(
    batch: BranchBatch, placed: Placed, near: Array, values: Array, enough: float
) -> Placed:
    """Return configurations closed to a residual by a few corrections."""
    lu = batch.factor(placed)  # good for all corrections: points move little
    for _ in range(CORRECTIONS):
        q = batch.tree.integrate(placed.q, np.nan_to_num(batch.correction(placed, lu)))
        batch.branch.hold(q, values)
        placed = batch.place(q, near)
        if np.abs(placed.residual).max() <= enough:
            break
    return placed


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
        w, alpha = points.rates[0][at, 0], points.rates[1][at, 0] + alpha
        line = np.einsum("k,kxm->xm", axis, columns)
        mark = np.einsum("k,kxm->xm", _normal(axis), columns)
        for _ in range(SPIN_PASSES):
            spin = _spin(h, mark, w, alpha, line)
            total += spin
            if np.abs(spin).max() < SPIN_LEFT:
                break
            mark = _turned(mark, line, -spin)
    return spun


def _normal(axis: Array) -> Array:
    """Return a unit vector (3,) normal to an axis."""
    normal = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    return normal / np.linalg.norm(normal)


def _spin(h: float, mark: Array, w: Array, alpha: Array, line: Array) -> Array:
    """Return how much a body has turned about a line (5, m), more than its rates tell.

    Since the first point, told by a unit vector `mark` (5, m) of the body, normal to the line.
    """
    first = cross(w, mark)
    second = cross(w, first) + cross(alpha, mark)
    missing = np.diff(mark[:3]) - integrals(h, first[:3], second[:3])
    middle, along = (0.5 * (x[:, :-1] + x[:, 1:]) for x in (mark, line))
    turned = dot(along, cross(middle, missing[WRAPPED]))
    return np.concatenate([[0.0], np.cumsum(turned)])


def _turned(vector: Array, line: Array, angle: Array) -> Array:
    """Return vectors (5, m), normal to unit vectors (5, m), turned about these."""
    return np.cos(angle) * vector + np.sin(angle) * cross(line, vector)
