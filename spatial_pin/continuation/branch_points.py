"""Going straight on where branches of closed configurations cross.

At a branch point (a change point) the equations lose rank and nothing can be solved; on either side
each branch is a smooth curve. The one that goes straight on is the continuation of the curve
before it as a polynomial, corrected by the closure equations behind it; between the two
sides everything is interpolated from both. Simulations have their own in the kernel, `passing.c`,
forty times as fast, for one freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.continuation.path_tracker import PathPoint, PathTracker, Stopped
from spatial_pin.continuation.pseudo_arclength import CROSSINGS, Arrival
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

# rad, characteristic lengths of the joint that moves most, from a branch point: there is a solution
REACHES = 0.12 * 0.5 ** np.arange(7)
APPROACHES = 2  # to such a place: how fast joints move is first known elsewhere
NODES = 8  # configurations on either side that the curve is continued through
CLOSED = 1e-12  # closure residual between the ends, above which nodes are taken nearer
KNOWN = 1e-11  # what two nodes more may change there [rad, characteristic lengths]
BETWEEN = np.cos(np.pi * (np.arange(12)[::-1] + 0.5) / 12)  # parts of the way out [Chebyshev]
ROUND_OFF = 5e-16  # closure residual of the nodes [-]
SAME = 1e-9  # difference of driver values that are the branch point's own [rad or m]
# Values by which a law that is smoothed may be off [rad or m]: its square is left in rates, and it
# is left in accelerations, of what third derivatives are
SMOOTHED = 1e-7
OFF = 1e-4  # part of the way across that the continued curve may be off the closed configurations
Node = tuple[PathPoint, Array, Array]  # a place of a passage; `Passage.first` and `.second` there


def far_side(curve: SolutionCurve, base: CurvePoint, distance: float) -> CurvePoint | None:
    """Return the point beyond a branch point that lies `distance` ahead of a point, straight on.

    None where no branch goes straight on.
    """
    lengths = -distance * np.arange(NODES)
    nodes = [curve.ahead(base, x) for x in lengths]
    if any(node is None for node in nodes):
        return None
    curve.expect(base, 2.0 * distance * base.t)
    unknowns = curve.unknowns
    expected = unknowns.normalized(_polynomial(lengths, np.array(nodes))(2.0 * distance))
    found = curve.onto(expected, base.t)
    if found is None or not np.linalg.norm(unknowns.apart(expected, found)) < OFF * distance:
        return None
    return curve.settle(found, unknowns.apart(base.x, found))


def _polynomial(x: Array, y: Array) -> Callable[[float], Array]:
    """Return the polynomial through y (N, k) at places (N,) [BerrutTrefethen2004, 4.2]."""
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
    """Return a point of the curve beyond the branch point just ahead of another, or None."""
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
    """The stretch of a branch about a branch point, as polynomials in the leading value.

    What the drivers do is not interpolated: between pieces of a law their accelerations bend.

    Attributes:
        tracker: the point that came to it.
        smooth: what leads along the polynomials: a law that bends between its pieces is followed
            by a smooth one, and what is between the two is added by derivatives.
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
        """Return the branch points met on the way from one driver value to another, in order."""
        low, high = min(first, last) - SAME, max(first, last) + SAME
        met = [x for x in self.branch_points if low <= x <= high and abs(x - first) > SAME]
        return met if last > first else met[::-1]

    def place(self, value: float) -> PathPoint:
        """Return the place at a driver value between the ends, else the end that is nearer."""
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
        """Return the configuration (nq,) at a leading value between the ends, and its derivatives.

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
        """Return derivatives (nv,) of the configuration with respect to the leading value."""
        leading, k = self.tracker.leading, first.shape[1]
        rates, bends = leading.rates(value)[:k], leading.bends(value)[:k]
        return first @ rates, first @ bends + second @ rates @ rates

    def is_accurate(self, value: float, fewer: Callable[[float], Array]) -> bool:
        """Whether the residual at a value is small and an interpolant of fewer nodes agrees.

        Near a branch point the residual alone is no measure of the error.
        """
        mechanism, place = self.tracker.mechanism, self.place(value)
        other = pin.normalize(mechanism.model, fewer(value))
        off = pin.difference(mechanism.model, other, place.q) / mechanism.velocity_scale
        return bool(place.error < CLOSED and np.abs(off).max() < KNOWN)

    def matrices(self, curve: SolutionCurve, values: Array) -> Array:
        """Return the matrices (k, m, m) of equations and tangent at leading values (k,)."""
        unknowns, places = curve.unknowns, []
        for s in values.tolist():
            q, first, second = self.by_drivers(s)
            t = self.rates(s, first, second)[0]
            places.append((unknowns.of(q, s), unknowns.along(t)))
        return matrices(curve, places)


def passage(tracker: PathTracker, arrival: Arrival) -> Passage | None:
    """Return the branch about a branch point where it has stopped, going straight on.

    None where it has stopped for another reason, or none goes straight on; the point then stands
    where it stood.

    Args:
        tracker: stands before the branch point.
        arrival: why it stopped, and at which driver value.
    """
    if arrival.kind not in CROSSINGS:
        return None
    before, size = tracker.here, tracker.mechanism.velocity_scale
    sense = 1.0 if arrival.value >= before.s else -1.0
    clear, value = before, arrival.value  # where the equations are solvable, and about where not
    for k, reach in enumerate(REACHES.tolist()):
        if k:
            tracker.move_to(clear)
        try:
            for _ in range(APPROACHES):
                pace = float(np.abs(tracker.here.t / size).max())
                tracker.reach(value - sense * reach / pace)
            if k == 0:
                clear = tracker.here
            found = _passage(tracker, sense, reach * _arc(tracker.here.t / size))
        except (Stopped, SingularError):
            continue
        if found is not None and found.smooth is not tracker.leading:
            value = found.branch_points[0]
            found = _with_bends(found, tracker)
        if found is not None:
            return found
    tracker.move_to(before)
    return None


def _passage(tracker: PathTracker, sense: float, reach: float) -> Passage | None:
    """Return the passage that begins where the tracker stands, as far as the arc length `reach`."""
    here, own = tracker.here, tracker
    apart = sense * reach / tracker.pace(here)
    law = tracker.leading.smooth(here.s, here.s - NODES * apart, here.s + (NODES + 2) * apart)
    if law is not None:  # a smooth one as far as nodes
        own = tracker.by(law)
    curve = own.curve(own.system(), ROUND_OFF)
    unknowns = curve.unknowns
    near = curve.settle(unknowns.of(here.q, here.s), sense * unknowns.along(here.t))
    far = far_side(curve, near, reach) if near is not None else None
    if near is None or far is None:
        return None
    sides = [_nodes(own, curve, point, reach) for point in (near._replace(t=-near.t), far)]
    values = [place.s for place, _, _ in (*sides[0][::-1], *sides[1])]
    if not np.all(sense * np.diff(values) > 0.0):  # the driver turns back
        return None
    return _joined(own, curve, *sides)


def _with_bends(smoothed: Passage, tracker: PathTracker) -> Passage | None:
    """Return the passage of a tracker whose law one has smoothed; None if by too much."""
    leading, smooth, (low, high) = tracker.leading, smoothed.smooth, smoothed.ends
    found = smoothed._replace(tracker=tracker)
    for x in (0.5 * (low + high) + 0.5 * (high - low) * BETWEEN).tolist():
        off = smooth.values(nearest(smooth, leading, x)) - leading.values(x)
        if np.abs(off[: leading.n_moving]).max() > SMOOTHED or found.place(x).error > CLOSED:
            return None
    q = found.by_drivers(high)[0]
    system = tracker.system_at(q, found.angles(high))
    free = np.ones(len(system.scale), dtype=bool)
    free[[*system.drive_at, *system.still]] = False
    q = close(system.evaluation, q, free, ROUND_OFF)[0]
    behind = tracker.point_at(q, high, system.evaluation.angles.copy(), system)
    return found._replace(
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
        q = curve.unknowns.configuration(x)
        # further away from the branch point the first node's equations do better still
        if not nodes:
            system.select(q)
        place = tracker.point_at(q, curve.value(x), curve.evaluation.angles.copy(), system)
        first = system.driver_rates()[:, :k]
        second = np.empty((len(first), k, k))
        for i in range(k):
            second[:, i, i] = system.acceleration(q, first[:, i], rest)
            for j in range(i):
                both = system.acceleration(q, first[:, i] + first[:, j], rest)
                second[:, i, j] = second[:, j, i] = 0.5 * (
                    both - second[:, i, i] - second[:, j, j])
        nodes.append((place, first, second))
    return nodes


def _joined(
    tracker: PathTracker, curve: SolutionCurve, near: list[Node], far: list[Node]
) -> Passage | None:
    """Return the passage between two sides; None if it is not accurate, or no branch crosses."""
    places, firsts, seconds = zip(*near, *far, strict=True)
    values = np.array([place.s for place in places])
    q, first, second, angles = (_polynomial(values, np.array(x).reshape(2 * NODES, -1)) for x in (
        [x.q for x in places], firsts, seconds, [x.angles for x in places]))
    outside = near[0][0], far[0][0]
    ends = outside[0].s, outside[1].s
    found = Passage(tracker, tracker.leading, [], ends, q, first, second, angles, outside)
    kept = np.delete(np.arange(2 * NODES), [NODES - 1, -1])
    fewer = _polynomial(values[kept], np.array([places[k].q for k in kept]))
    between = 0.5 * (ends[0] + ends[1]) + 0.5 * (ends[1] - ends[0]) * BETWEEN
    if not all(found.is_accurate(x, fewer) for x in between[1::3].tolist()):
        return None
    met = [x for x in zeros(between, found.matrices(curve, between)) if found.holds(x)]
    return found._replace(branch_points=met) if met else None
