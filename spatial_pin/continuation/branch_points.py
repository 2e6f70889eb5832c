"""Crossing branch points: the path continues straight on through them.

At a branch point (a change point) the equations lose rank and nothing can be solved; on either side
each branch is a smooth curve. The one that goes straight on is the continuation of the curve
before it as a polynomial, corrected by the closure equations behind it; between the two
sides everything is interpolated from both. Simulations have their own in the kernel, `crossing.c`,
forty times as fast, for one freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.continuation.path_tracker import PathPoint, PathTracker
from spatial_pin.continuation.pseudo_arclength import CROSSINGS, Stopped
from spatial_pin.continuation.singular_points import zeros
from spatial_pin.continuation.solution_curve import (
    CurvePoint,
    OneDriver,
    SolutionCurve,
    matrices,
    nearest,
)
from spatial_pin.errors import SingularError
from spatial_pin.numerics.linalg import Array

# Distances from a branch point at which nodes are tried, largest first, by the joint that moves
# most [rad, characteristic lengths].
REACHES = 0.12 * 0.5 ** np.arange(7)
# Corrections of the distance of a node: the first step does not know the speeds there.
APPROACHES = 2
NODES = 8  # configurations on each side through which the polynomial goes
CLOSED = 1e-12  # largest closure residual between the nodes: with more, nearer nodes are tried
# Largest change by two more nodes [rad, characteristic lengths]: with more, nearer nodes are
# tried.
KNOWN = 1e-11
# Points between the nodes at which the residual is checked, as parts of the distance: Chebyshev
# points, which lie where polynomials are worst.
BETWEEN = np.cos(np.pi * (np.arange(12)[::-1] + 0.5) / 12)
ROUND_OFF = 5e-16  # closure residual of solved nodes: two roundings of one
SAME = 1e-9  # driver values closer than this are the branch point itself [rad or m]
# Largest change of values by a smoothed law [rad or m]. Its square remains in rates. In
# accelerations it is multiplied by third derivatives.
SMOOTHED = 1e-7
# Largest distance of the continued curve from closed configurations, as part of the distance
# across: a wrong branch is off by the whole distance.
OFF = 1e-4
Node = tuple[PathPoint, Array, Array]  # a place of a passage; `Passage.first` and `.second` there


def far_side(curve: SolutionCurve, base: CurvePoint, distance: float) -> CurvePoint | None:
    """Return the point straight on beyond a branch point, `distance` ahead of a point.

    None where no branch goes straight on.
    """
    lengths = -distance * np.arange(NODES)
    nodes = [curve.ahead(base, x) for x in lengths]
    if any(node is None for node in nodes):
        return None
    curve.expect(base, 2.0 * distance * base.t)
    expected = curve.normalized(_polynomial(lengths, np.array(nodes))(2.0 * distance))
    corrected = curve.onto(expected, base.t)
    if corrected is None or not (
            np.linalg.norm(curve.apart(expected, corrected)) < OFF * distance):
        return None
    return curve.settle(corrected, curve.apart(base.x, corrected))


def _polynomial(x: Array, y: Array) -> Callable[[float], Array]:
    """Return the polynomial through y (N, k) at nodes (N,) [BerrutTrefethen2004, 4.2]."""
    gaps = (4.0 / np.ptp(x)) * (x[:, None] - x)  # products neither large nor small
    np.fill_diagonal(gaps, 1.0)
    weights = 1.0 / gaps.prod(axis=1)

    def at(value: float) -> Array:
        away = value - x
        if not away.all():
            return y[np.argmin(np.abs(away))]
        parts = weights / away
        return (parts @ y) / parts.sum()

    return at


def straight_on(curve: SolutionCurve, point: CurvePoint) -> CurvePoint | None:
    """Return the nearest point straight on beyond a branch point; None if there is none."""
    for reach in (REACHES * _arc(point.t)).tolist():
        behind = curve.ahead(point, -reach)
        base = curve.settle(behind, point.t) if behind is not None else None
        halfway = curve.ahead(base, 0.5 * reach) if base is not None else None
        if base is None or halfway is None:
            continue
        sigma = [curve.sigma(x) for x in (base.x, halfway)]  # falls to 0 at the branch point
        if sigma[1] < sigma[0]:
            distance = 0.5 * reach * sigma[0] / (sigma[0] - sigma[1])
            far = far_side(curve, base, distance)
            if far is not None:
                return far
    return None


def _arc(t: Array) -> float:
    """Return the arc length of a path (nv,) per unit of the fastest joint's motion."""
    return float(np.linalg.norm(t) / np.abs(t).max())


class Passage(NamedTuple):
    """The part of a branch about a branch point, as polynomials in the continuation parameter.

    What the drivers do is not interpolated: between pieces of a law their accelerations bend.

    Attributes:
        tracker: the point that came to it.
        smooth: what leads along the polynomials: a law that bends between its pieces is followed
            by a smooth one, and the difference of the two is added by derivatives.
        branch_points: leading values of the branch point, and of others that are as near.
        ends: leading values before and behind them, where the equations are solvable.
        q, angles: interpolators of configuration and relative angles of screw closures.
        first, second: of joint rates (nv k) per rate of each driver that moves, and of joint
            accelerations (nv k k) per product of two such rates.
        outside: the places at the ends.
    """

    tracker: PathTracker
    smooth: OneDriver
    branch_points: list[float]
    ends: tuple[float, float]
    q: Callable[[float], Array]
    first: Callable[[float], Array]
    second: Callable[[float], Array]
    angles: Callable[[float], Array]
    outside: tuple[PathPoint, PathPoint]

    def holds(self, value: float) -> bool:
        """Whether a driver value lies between the ends."""
        return min(self.ends) < value < max(self.ends)

    def passed(self, first: float, last: float) -> list[float]:
        """Return the branch points between two driver values, in order."""
        low, high = min(first, last) - SAME, max(first, last) + SAME
        met = [x for x in self.branch_points if low <= x <= high and abs(x - first) > SAME]
        return met if last > first else met[::-1]

    def point_at(self, value: float) -> PathPoint:
        """Return the point at a driver value between the ends, else the nearer end."""
        if not self.holds(value):
            return self.outside[int(abs(value - self.ends[1]) < abs(value - self.ends[0]))]
        q, first, second = self.by_drivers(value)
        evaluation, angles = self.tracker.evaluation, self.angles(value)
        evaluation.angle_reference[:] = angles
        evaluation.update(q)
        error = float(np.abs(evaluation.residual).max(initial=0.0))
        missed = 3.0 * KNOWN * (NODES / (0.5 * abs(self.ends[1] - self.ends[0]))) ** np.arange(3.0)
        return PathPoint(value, q, *self.rates(value, first, second), error, missed, angles)

    def by_drivers(self, value: float) -> tuple[Array, Array, Array]:
        """Return the configuration (nq,) at a parameter between the ends, and its derivatives.

        Returns:
            (nq,) configuration; joint rates (nv, k) per rate of each driver that moves; joint
            accelerations (nv, k, k) per product of two.
        """
        tracker = self.tracker
        s, k = nearest(self.smooth, tracker.leading, value), tracker.leading.n_moving
        first, second = self.first(s).reshape(-1, k), self.second(s).reshape(-1, k, k)
        q: Array = pin.normalize(tracker.mechanism.model, self.q(s))
        off = (tracker.leading.values(value) - self.smooth.values(s))[:k]
        if off.any():
            q = pin.integrate(tracker.mechanism.model, q, (first + 0.5 * second @ off) @ off)
            first = first + second @ off
        tracker.leading.put(q, value)
        return q, first, second

    def rates(self, value: float, first: Array, second: Array) -> tuple[Array, Array]:
        """Return derivatives (nv,) of the configuration with respect to the parameter."""
        leading, k = self.tracker.leading, first.shape[1]
        rates, bends = leading.rates(value)[:k], leading.bends(value)[:k]
        return first @ rates, first @ bends + second @ rates @ rates

    def is_accurate(self, value: float, fewer: Callable[[float], Array]) -> bool:
        """Whether the residual at a value is small and an interpolant of fewer nodes agrees.

        Near a branch point the residual alone is no measure of the error.
        """
        mechanism, here = self.tracker.mechanism, self.point_at(value)
        other = pin.normalize(mechanism.model, fewer(value))
        off = pin.difference(mechanism.model, other, here.q) / mechanism.velocity_scale
        return bool(here.error < CLOSED and np.abs(off).max() < KNOWN)

    def matrices(self, curve: SolutionCurve, values: Array) -> Array:
        """Return the matrices (k, m, m) of equations and tangent at parameters (k,)."""
        points = []
        for s in values.tolist():
            q, first, second = self.by_drivers(s)
            t = self.rates(s, first, second)[0]
            points.append((curve.unknowns(q, s), curve.tangent(t)))
        return matrices(curve, points)


def passage(tracker: PathTracker, stopped: Stopped) -> Passage | None:
    """Return the polynomials that cross the branch point at which the tracker stopped.

    None where it has stopped for another reason, or none goes straight on; the point then stands
    where it stood.
    """
    if stopped.kind not in CROSSINGS:
        return None
    before, size = tracker.here, tracker.mechanism.velocity_scale
    sense = 1.0 if stopped.value >= before.s else -1.0
    clear, value = before, stopped.value  # where the equations are solvable, and about where not
    for k, reach in enumerate(REACHES.tolist()):
        if k:
            tracker.move_to(clear)
        try:
            for _ in range(APPROACHES):
                pace = float(np.abs(tracker.here.t / size).max())
                tracker.reach(value - sense * reach / pace)
            if k == 0:
                clear = tracker.here
            crossing = _passage(tracker, sense, reach * _arc(tracker.here.t / size))
        except (Stopped, SingularError):
            continue
        if crossing is not None and crossing.smooth is not tracker.leading:
            value = crossing.branch_points[0]
            crossing = _with_bends(crossing, tracker)
        if crossing is not None:
            return crossing
    tracker.move_to(before)
    return None


def _passage(tracker: PathTracker, sense: float, reach: float) -> Passage | None:
    """Return the crossing from the tracker's point on, as far as the arc length `reach`."""
    here, own = tracker.here, tracker
    apart = sense * reach / tracker.pace(here)
    law = tracker.leading.smooth(here.s, here.s - NODES * apart, here.s + (NODES + 2) * apart)
    if law is not None:  # a smooth one as far as nodes
        own = tracker.by(law)
    curve = own.leading.curve(own.system(), ROUND_OFF, own.pace(own.here))
    near = curve.settle(curve.unknowns(here.q, here.s), sense * curve.tangent(here.t))
    far = far_side(curve, near, reach) if near is not None else None
    if near is None or far is None:
        return None
    sides = [_nodes(own, curve, point, reach) for point in (near._replace(t=-near.t), far)]
    values = [node.s for node, _, _ in (*sides[0][::-1], *sides[1])]
    if not np.all(sense * np.diff(values) > 0.0):  # the driver turns back
        return None
    return _joined(own, curve, *sides)


def _with_bends(smoothed: Passage, tracker: PathTracker) -> Passage | None:
    """Return the crossing with the tracker's own law; None if smoothing changed too much."""
    leading, smooth, (low, high) = tracker.leading, smoothed.smooth, smoothed.ends
    exact = smoothed._replace(tracker=tracker)
    for x in (0.5 * (low + high) + 0.5 * (high - low) * BETWEEN).tolist():
        off = smooth.values(nearest(smooth, leading, x)) - leading.values(x)
        if np.abs(off[: leading.n_moving]).max() > SMOOTHED or exact.point_at(x).error > CLOSED:
            return None
    q = exact.by_drivers(high)[0]
    system = tracker.system_at(q, exact.angles(high))
    q = close(system.evaluation, q, system.free, ROUND_OFF)[0]
    behind = tracker.point_at(q, high, system.evaluation.angles.copy(), system)
    return exact._replace(
        branch_points=[nearest(leading, smooth, x) for x in smoothed.branch_points],
        outside=(tracker.here, behind))


def _nodes(
    tracker: PathTracker, curve: SolutionCurve, point: CurvePoint, reach: float
) -> list[Node]:
    """Return nodes from a point on, away from the branch point, the nearest to it first.

    Raises:
        SingularError: the rates are not determined at one of them.
    """
    nodes: list[Node] = []
    system, k = curve.system, tracker.leading.n_moving
    rest = np.zeros(len(system.driven))
    for length in reach * np.arange(NODES):
        x = curve.ahead(point, length)
        if x is None:
            raise SingularError("the branch bends away from its branch point")
        q = curve.configuration(x)
        # further away from the branch point the first node's equations do better still
        if not nodes:
            system.select(q)
        at_node = tracker.point_at(q, curve.value(x), curve.evaluation.angles.copy(), system)
        first = system.driver_rates()[:, :k]
        second = np.empty((len(first), k, k))
        for i in range(k):
            second[:, i, i] = system.acceleration(q, first[:, i], rest)
            for j in range(i):
                both = system.acceleration(q, first[:, i] + first[:, j], rest)
                second[:, i, j] = second[:, j, i] = 0.5 * (
                    both - second[:, i, i] - second[:, j, j])
        nodes.append((at_node, first, second))
    return nodes


def _joined(
    tracker: PathTracker, curve: SolutionCurve, near: list[Node], far: list[Node]
) -> Passage | None:
    """Return the crossing between two sides; None if it is inaccurate, or no branch crosses."""
    points, firsts, seconds = zip(*near, *far, strict=True)
    values = np.array([point.s for point in points])
    q, first, second, angles = (_polynomial(values, np.array(x).reshape(2 * NODES, -1)) for x in (
        [x.q for x in points], firsts, seconds, [x.angles for x in points]))
    outside = near[0][0], far[0][0]
    ends = outside[0].s, outside[1].s
    crossing = Passage(tracker, tracker.leading, [], ends, q, first, second, angles, outside)
    inner = np.delete(np.arange(2 * NODES), [NODES - 1, -1])
    fewer = _polynomial(values[inner], np.array([points[k].q for k in inner]))
    between = 0.5 * (ends[0] + ends[1]) + 0.5 * (ends[1] - ends[0]) * BETWEEN
    if not all(crossing.is_accurate(x, fewer) for x in between[1::3].tolist()):
        return None
    met = [x for x in zeros(between, crossing.matrices(curve, between)) if crossing.holds(x)]
    return crossing._replace(branch_points=met) if met else None
