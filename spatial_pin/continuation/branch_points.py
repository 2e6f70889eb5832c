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

from spatial_pin.continuation.cursor import Cursor, Place, Stopped
from spatial_pin.continuation.pseudo_arclength import Arrival
from spatial_pin.continuation.singular_points import zeros
from spatial_pin.continuation.solution_curve import Curve, CurvePoint, matrices
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
OFF = 1e-4  # part of the way across that the continued curve may be off the closed configurations


def far_side(curve: Curve, base: CurvePoint, distance: float) -> CurvePoint | None:
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
        found: Array = (parts @ y) / parts.sum()
        return found

    return at


def straight_on(curve: Curve, point: CurvePoint) -> CurvePoint | None:
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
    """The stretch of a branch about a branch point, as polynomials in the driver value.

    Attributes:
        cursor: the point that came to it.
        branch_points: driver values of the branch point, and of others that are as near.
        ends: driver values before and behind them, where the equations are solvable.
        q, angles: interpolators of configuration and relative angles of screw closures.
        t, c: of the first and second derivatives with respect to the driver.
        outside: the places at the ends.
    """

    cursor: Cursor
    branch_points: list[float]
    ends: tuple[float, float]
    q: Callable[[float], Array]
    t: Callable[[float], Array]
    c: Callable[[float], Array]
    angles: Callable[[float], Array]
    outside: tuple[Place, Place]

    def holds(self, value: float) -> bool:
        """Whether a driver value lies between the ends."""
        return min(self.ends) < value < max(self.ends)

    def passed(self, first: float, last: float) -> list[float]:
        """Return the branch points met on the way from one driver value to another, in order."""
        low, high = min(first, last) - SAME, max(first, last) + SAME
        met = [x for x in self.branch_points if low <= x <= high and abs(x - first) > SAME]
        return met if last > first else met[::-1]

    def place(self, value: float) -> Place:
        """Return the place at a driver value between the ends, else the end that is nearer."""
        if not self.holds(value):
            return self.outside[int(abs(value - self.ends[1]) < abs(value - self.ends[0]))]
        q, angles = self.configuration(value), self.angles(value)
        evaluation = self.cursor.start.evaluation
        evaluation.angle_reference[:] = angles
        evaluation.update(q)
        error = float(np.abs(evaluation.residual).max(initial=0.0))
        return Place(value, q, self.t(value), self.c(value), error, angles)

    def is_accurate(self, value: float, fewer: Callable[[float], Array]) -> bool:
        """Whether the residual at a value is small and an interpolant of fewer nodes agrees.

        Near a branch point the residual alone is no measure of the error.
        """
        mechanism, place = self.cursor.start.mechanism, self.place(value)
        other = pin.normalize(mechanism.model, fewer(value))
        off = pin.difference(mechanism.model, other, place.q) / mechanism.velocity_scale
        return bool(place.error < CLOSED and np.abs(off).max() < KNOWN)

    def matrices(self, curve: Curve, values: Array) -> Array:
        """Return the matrices (k, nv, nv) of equations and tangent at driver values (k,)."""
        unknowns = curve.unknowns
        return matrices(curve, ((unknowns.of(self.configuration(s), s), unknowns.along(self.t(s)))
                                for s in values.tolist()))

    def configuration(self, value: float) -> Array:
        """Return the configuration (nq,) at a driver value between the ends."""
        q: Array = pin.normalize(self.cursor.start.mechanism.model, self.q(value))
        self.cursor.start.leading.put(q, value)
        return q


def passage(cursor: Cursor, arrival: Arrival) -> Passage | None:
    """Return the branch about a branch point where it has stopped, going straight on.

    None where it has stopped for another reason, or none goes straight on; the point then stands
    where it stood.

    Args:
        cursor: stands before the branch point.
        arrival: why it stopped, and at which driver value.
    """
    if arrival.kind not in ("branch point", "singular"):
        return None
    before, size = cursor.here, cursor.start.mechanism.velocity_scale
    sense = 1.0 if arrival.value >= before.s else -1.0
    clear = before  # where the equations are solvable
    for k, reach in enumerate(REACHES.tolist()):
        if k:
            cursor.stand(clear)
        try:
            for _ in range(APPROACHES):
                pace = float(np.abs(cursor.here.t / size).max())
                cursor.reach(arrival.value - sense * reach / pace)
            if k == 0:
                clear = cursor.here
            found = _passage(cursor, sense, reach * _arc(cursor.here.t / size))
        except (Stopped, SingularError):
            continue
        if found is not None:
            return found
    cursor.stand(before)
    return None


def _passage(cursor: Cursor, sense: float, reach: float) -> Passage | None:
    """Return the passage that begins where the cursor stands, as far as the arc length `reach`."""
    here = cursor.here
    curve = cursor.curve(cursor.system(), ROUND_OFF)
    unknowns = curve.unknowns
    near = curve.settle(unknowns.of(here.q, here.s), sense * unknowns.along(here.t))
    far = far_side(curve, near, reach) if near is not None else None
    if near is None or far is None:
        return None
    sides = [_nodes(cursor, curve, point, reach) for point in (near._replace(t=-near.t), far)]
    values = [place.s for place in (*sides[0][::-1], *sides[1])]
    if not np.all(sense * np.diff(values) > 0.0):  # the driver turns back
        return None
    return _joined(cursor, curve, *sides)


def _nodes(cursor: Cursor, curve: Curve, point: CurvePoint, reach: float) -> list[Place]:
    """Return nodes from a point on, away from the branch point, the nearest to it first.

    Raises:
        SingularError: the rates are not determined at one of them.
    """
    nodes: list[Place] = []
    for length in reach * np.arange(NODES):
        x = curve.ahead(point, length)
        if x is None:
            raise SingularError("the branch bends away from its branch point")
        q = curve.unknowns.configuration(x)
        # further away from the branch point the first node's equations do better still
        if not nodes:
            curve.system.select(q)
        nodes.append(cursor.place(q, curve.value(x), curve.evaluation.angles.copy(),
                                  curve.system))
    return nodes


def _joined(
    cursor: Cursor, curve: Curve, near: list[Place], far: list[Place]
) -> Passage | None:
    """Return the passage between two sides; None if it is not accurate, or no branch crosses."""
    nodes = [*near, *far]
    values = np.array([node.s for node in nodes])
    q, t, c, angles = (_polynomial(values, np.array(x)) for x in zip(
        *((node.q, node.t, node.c, node.angles) for node in nodes), strict=True))
    ends = near[0].s, far[0].s
    found = Passage(cursor, [], ends, q, t, c, angles, (near[0], far[0]))
    kept = np.delete(np.arange(2 * NODES), [NODES - 1, -1])
    fewer = _polynomial(values[kept], np.array([nodes[k].q for k in kept]))
    between = 0.5 * (ends[0] + ends[1]) + 0.5 * (ends[1] - ends[0]) * BETWEEN
    if not all(found.is_accurate(x, fewer) for x in between[1::3].tolist()):
        return None
    met = [x for x in zeros(between, found.matrices(curve, between)) if found.holds(x)]
    return found._replace(branch_points=met) if met else None
