"""Going straight on where branches of closed configurations cross.

At a crossing (a change point) the equations lose rank and nothing can be solved; on either side
each branch is a smooth curve. The one that goes straight on is the continuation of the curve
before the crossing as a polynomial, corrected by the closure equations behind it; between the two
sides everything is interpolated from both.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.continuation.branch import Branch, Stopped
from spatial_pin.continuation.singular_points import zeros
from spatial_pin.continuation.solution_curve import Curve, CurvePoint
from spatial_pin.errors import SingularError
from spatial_pin.numerics.linalg import Array

# rad, characteristic lengths of the joint that moves most, from a crossing: there it may be solved
REACHES = 0.12 * 0.5 ** np.arange(7)
APPROACHES = 2  # to such a place: how fast joints move is first known elsewhere
NODES = 8  # configurations on either side that the curve is continued through
CLOSED = 1e-12  # closure residual between the ends, above which nodes are taken nearer
KNOWN = 1e-11  # what two nodes more may change there [rad, characteristic lengths]
BETWEEN = np.cos(np.pi * (np.arange(12)[::-1] + 0.5) / 12)  # parts of the way out [Chebyshev]
ROUND_OFF = 5e-16  # closure residual of the nodes [-]
SAME = 1e-9  # difference of driver values that are the crossing's own [rad or m]
OFF = 1e-4  # part of the way across that the continued curve may be off the closed configurations


def far_side(curve: Curve, base: CurvePoint, distance: float) -> CurvePoint | None:
    """Return the point beyond a crossing that lies `distance` ahead of a point, straight on.

    None where no branch goes straight on.
    """
    lengths = -distance * np.arange(NODES)
    nodes = [curve.ahead(base, x) for x in lengths]
    if any(node is None for node in nodes):
        return None
    curve.evaluation.turns[:] = base.angles + base.slopes @ (2.0 * distance * base.t)
    expected = _polynomial(lengths, np.array(nodes))(2.0 * distance)
    expected = pin.normalize(curve.model, expected)
    found = curve.onto(expected, base.t)
    if found is None:
        return None
    off = pin.difference(curve.model, expected, found) / curve.scale
    if not np.linalg.norm(off) < OFF * distance:
        return None
    return curve.settle(found, pin.difference(curve.model, base.q, found) / curve.scale)


def _polynomial(x: Array, rows: Array) -> Callable[[float], Array]:
    """Return the polynomial through rows (N, k) at places (N,) [BerrutTrefethen2004, 4.2]."""
    gaps = (4.0 / np.ptp(x)) * (x[:, None] - x)  # products neither large nor small
    np.fill_diagonal(gaps, 1.0)
    weights = 1.0 / gaps.prod(axis=1)

    def at(value: float) -> Array:
        away = value - x
        if not away.all():
            return rows[np.argmin(np.abs(away))]
        parts = weights / away
        found: Array = (parts @ rows) / parts.sum()
        return found

    return at


def straight_on(curve: Curve, point: CurvePoint) -> CurvePoint | None:
    """Return a point of the curve beyond the crossing just ahead of a point; None if none is."""
    for reach in (REACHES * _arc(point.t)).tolist():
        behind = curve.ahead(point, -reach)
        base = curve.settle(behind, point.t) if behind is not None else None
        halfway = curve.ahead(base, 0.5 * reach) if base is not None else None
        if base is None or halfway is None:
            continue
        sigma = [curve.sigma(q) for q in (base.q, halfway)]  # falls to 0 at the crossing
        if sigma[1] < sigma[0]:
            distance = 0.5 * reach * sigma[0] / (sigma[0] - sigma[1])
            far = far_side(curve, base, distance)
            if far is not None:
                return far
    return None


def _arc(t: Array) -> float:
    """Return the arc length of a path (nv,) by the way of the joint that moves most."""
    return float(np.linalg.norm(t) / np.abs(t).max())


class Strip(NamedTuple):
    """The stretch of a branch about a crossing, as polynomials in the driver value.

    Attributes:
        crossings: driver values of the crossing, and of others that are as near.
        ends: driver values before and behind them, where the equations are solvable.
        q, angles: interpolators of configuration and relative angles of screw closures.
        t, c: of the first and second derivatives with respect to the driver.
        places: (q, driver value) of two nodes at either end, the outer one first.
    """

    crossings: list[float]
    ends: tuple[float, float]
    q: Callable[[float], Array]
    t: Callable[[float], Array]
    c: Callable[[float], Array]
    angles: Callable[[float], Array]
    places: tuple[tuple[Array, Array], tuple[Array, Array]]

    def holds(self, value: float) -> bool:
        """Whether a driver value lies between the ends."""
        return min(self.ends) < value < max(self.ends)

    def crossed(self, first: float, last: float) -> list[float]:
        """Return the crossings met on the way from one driver value to another, in this order."""
        low, high = min(first, last) - SAME, max(first, last) + SAME
        met = [x for x in self.crossings if low <= x <= high and abs(x - first) > SAME]
        return met if last > first else met[::-1]

    def is_told(self, branch: Branch, value: float, fewer: Callable[[float], Array]) -> bool:
        """Whether loops are closed at a value, where an interpolator of fewer nodes says the same.

        The one alone is not enough: at a crossing open loops are no measure of what is amiss.
        """
        other = pin.normalize(branch.model, fewer(value))
        self.put(branch, value)
        off = pin.difference(branch.model, other, branch.q) / branch.scale
        return bool(np.abs(branch.residual).max(initial=0.0) < CLOSED and np.abs(off).max() < KNOWN)

    def matrices(self, branch: Branch, values: Array) -> Array:
        """Return the matrices (k, nv, nv) of rows and tangent at driver values (k,)."""
        curve = Curve(branch.system, ROUND_OFF)
        return curve.matrices((self.configuration(branch, x), self.t(x) / branch.scale)
                              for x in values.tolist())

    def configuration(self, branch: Branch, value: float) -> Array:
        """Return the configuration (nq,) at a driver value between the ends."""
        q: Array = pin.normalize(branch.model, self.q(value))
        branch.hold(q, value)
        return q

    def put(self, branch: Branch, value: float) -> None:
        """Write the branch at a driver value between the ends into `branch`."""
        q = self.configuration(branch, value)
        branch.q, branch.s = q, value
        branch.t, branch.c, branch.angles = (x(value) for x in (self.t, self.c, self.angles))
        branch.evaluation.turns[:] = branch.angles
        branch.evaluation.update(q)
        branch.residual = branch.evaluation.residual.copy()

    def leave(self, branch: Branch, value: float) -> None:
        """Take a branch to the end that is nearer to a driver value outside."""
        side = int(abs(value - self.ends[1]) < abs(value - self.ends[0]))
        before, q = self.places[side]
        branch.evaluation.turns[:] = self.angles(self.ends[side])
        branch.place(q)
        branch.jump(before, q, self.ends[side], self.ends[side] - float(before[branch.at]))
        branch.reselect()


def strip(branch: Branch, crossing: float) -> Strip | None:
    """Return the branch about a crossing ahead of it, going straight on; None if none does.

    The branch is left somewhere on the strip, or before it where there is none.

    Args:
        branch: stands before the crossing.
        crossing: driver value of the crossing [rad or m].
    """
    sense = 1.0 if crossing >= branch.s else -1.0
    clear = branch.q, branch.angles  # where the equations are solvable, before the crossing
    for k, reach in enumerate(REACHES.tolist()):
        try:
            if k:
                branch.evaluation.turns[:] = clear[1]
                branch.place(clear[0])
            for _ in range(APPROACHES):
                pace = float(np.abs(branch.t / branch.scale).max())
                branch.reach(crossing - sense * reach / pace)
            if k == 0:
                clear = branch.q, branch.angles
            sides = _sides(branch, sense, reach * _arc(branch.t / branch.scale))
        except (Stopped, SingularError):
            continue
        if sides is not None:
            values = np.concatenate([sides[0].q[::-1, branch.at], sides[1].q[:, branch.at]])
            if np.all(sense * np.diff(values) > 0.0):  # else the driver turns back
                found = _joined(branch, *sides)
                if found is not None:
                    return found
    with contextlib.suppress(SingularError):
        branch.evaluation.turns[:] = clear[1]
        branch.place(clear[0])
    return None


class _Side(NamedTuple):
    """Nodes on one side of a crossing, the nearest first, as in `Strip`."""

    q: Array
    t: Array
    c: Array
    angles: Array


def _sides(branch: Branch, sense: float, reach: float) -> tuple[_Side, _Side] | None:
    curve = Curve(branch.system, ROUND_OFF)
    near = curve.settle(branch.q, sense * branch.t / branch.scale)
    far = far_side(curve, near, reach) if near is not None else None
    if near is None or far is None:
        return None
    outward = near._replace(t=-near.t)
    return _side(branch, curve, outward, reach), _side(branch, curve, far, reach)


def _side(branch: Branch, curve: Curve, point: CurvePoint, reach: float) -> _Side:
    """Return nodes from a point on, away from the crossing.

    Raises:
        SingularError: the rates are not determined at one of them.
    """
    rows: list[tuple[Array, ...]] = []
    for length in reach * np.arange(NODES):
        q = curve.ahead(point, length)
        if q is None:
            raise SingularError("the branch bends away from its crossing")
        branch.place(q, anew=not rows)  # further away from the crossing those rows do better still
        rows.append((q, branch.t, branch.c, branch.angles))
    return _Side(*(np.array(column) for column in zip(*rows, strict=True)))


def _joined(branch: Branch, near: _Side, far: _Side) -> Strip | None:
    """Return the strip between two sides; None if the nodes do not tell it, or nothing crosses."""
    values = np.concatenate([side.q[:, branch.at] for side in (near, far)])
    columns = [np.concatenate(pair) for pair in zip(near, far, strict=True)]
    q, t, c, angles = (_polynomial(values, x) for x in columns)
    ends = float(near.q[0, branch.at]), float(far.q[0, branch.at])
    places = (near.q[1], near.q[0]), (far.q[1], far.q[0])
    found = Strip([], ends, q, t, c, angles, places)
    fewer = _polynomial(*(np.delete(x, [NODES - 1, -1], axis=0) for x in (values, columns[0])))
    between = 0.5 * (ends[0] + ends[1]) + 0.5 * (ends[1] - ends[0]) * BETWEEN
    if not all(found.is_told(branch, x, fewer) for x in between[1::3].tolist()):
        return None
    crossings = zeros(between, found.matrices(branch, between))
    crossings = [x for x in crossings if found.holds(x)]
    return found._replace(crossings=crossings) if crossings else None
