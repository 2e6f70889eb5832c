"""Branch points ahead on a curve, extrapolated from points before them.

Nothing can be solved there, but the matrix of equations and tangent is a smooth function of the arc
length and can be extrapolated. It is singular where branches cross. Loops of a chain that go flat
together lose one rank each at one place: there the determinant has a zero of that order, which
round-off scatters, but the place is an eigenvalue of the matrix function, which keeps its digits
[Ruhe1973].
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from spatial_pin.continuation.solution_curve import CurvePoint, SolutionCurve, matrices
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Rad or characteristic lengths: below the longest step of a path, since it is used where longer
# ones fail.
LARGEST_STEP = 0.1
# Where steps as short as this still fail, the branch is lost: configurations nearer to each other
# than the root of round-off, 1.5e-8, may tell nothing of a singularity between them.
SMALLEST_STEP = TOLERANCES.nothing
# Least and greatest distance from which a branch point is located [rad, characteristic lengths]:
# nearer round-off grows, farther the series does not converge.
VIEW = 8e-3, 2e-2
# Length of the difference that gives the slope of a singular value. Round-off leaves twelve digits
# of the change, and the truncation error is its square, 1e-8.
PROBE = 1e-4
# Steps to that distance: each is half of the distance, or a largest step; 6 rad in all.
STEPS_TO_VIEW = 64
PLACES = 0.16 * np.arange(6)  # nodes of the extrapolation, as parts of that distance
# Zeros closer than this part of the distance are one. A zero of order four is known to the fourth
# root of round-off, 1e-4.
TOGETHER = 1e-4
# parts of half the way: the matrices are interpolated to some hundred times machine epsilon
SETTLED = TOLERANCES.zero
# Zeros are accepted up to this far outside of the interval, as part of half of its length. Terms
# of a Chebyshev series grow by 2 + sqrt(3) each there.
BEYOND_VIEW = 1.0
# Longest next step relative to this one. It is one half where the matrix only touches singularity.
NEXT_STEP = 0.6


def through(x: Array, y: Array) -> np.polynomial.Polynomial:
    """Return the polynomial through the points (x, y)."""
    return np.polynomial.Polynomial.fit(x, y, len(x) - 1)


class _Interpolated:
    """The polynomial through matrices (k, n, n) at nodes (k,), scaled to [-1, 1]."""

    def __init__(self, nodes: Array, matrices: Array) -> None:
        self.shape = matrices.shape[1:]
        basis = chebyshev.chebvander(nodes, len(nodes) - 1)
        self.values = np.linalg.solve(basis, matrices.reshape(len(nodes), -1))
        self.slopes = chebyshev.chebder(self.values)

    def steps(self, at: float) -> Array:
        """Return the steps, complex, after which the tangent to the matrices is singular."""
        value, slope = (chebyshev.chebval(at, x).reshape(self.shape)
                        for x in (self.values, self.slopes))
        try:
            inverse = np.linalg.eigvals(np.linalg.solve(value, slope))
        except np.linalg.LinAlgError:  # singular right there
            return np.zeros(1)
        return -1.0 / inverse[inverse != 0.0]

    def singular(self, x0: float, reach: float) -> list[float]:
        """Return the singular points about x0, up to a distance `reach`.

        Found by successive linear eigenproblems, which converge quadratically; linearly, by halves,
        where the matrix only touches singularity, until round-off dominates.
        """
        away = self.steps(x0)
        steps = np.sort_complex(away[np.abs(away) <= reach])
        if not steps.size:
            return [x0] if reach < TOGETHER else []
        zeros = []
        gap = max(0.1 * reach, TOGETHER)  # else round-off splits one point into ever more
        for group in np.split(steps, np.flatnonzero(np.diff(steps.real) > gap) + 1):
            step, apart = group.real.mean(), np.ptp(group.real)
            if np.abs(group.real).max() <= SETTLED:
                zeros += [x0] if np.abs(group.imag).min() < TOGETHER else []
            else:
                within = max(NEXT_STEP * np.abs(group).max(), apart)
                zeros += self.singular(x0 + step, min(within, 0.9 * reach))
        return zeros


def zeros(x: Array, matrices: Array) -> list[float]:
    """Return the points where the polynomial through matrices (k, n, n) at x (k,) is singular.

    They rise; those nearer to each other than round-off can separate are returned as one.
    """
    middle, half = 0.5 * (x[0] + x[-1]), 0.5 * float(x[-1] - x[0])
    nodes = (x - middle) / half
    curve = _Interpolated(nodes, matrices)
    gaps = np.concatenate([[BEYOND_VIEW], np.diff(nodes), [BEYOND_VIEW]])
    roots = np.sort([middle + half * x0 for k, start in enumerate(nodes.tolist())
                     for x0 in curve.singular(start, float(gaps[k : k + 2].max()))])
    groups = np.split(roots, np.flatnonzero(np.diff(roots) > 2.0 * TOGETHER * abs(half)) + 1)
    return [float(group.mean()) for group in groups if group.size]


def _viewed(curve: SolutionCurve, point: CurvePoint) -> tuple[CurvePoint, float] | None:
    """Return a point before a branch point ahead of another, and its distance, in VIEW."""
    back, base, distance = VIEW[0], _moved(curve, point, -VIEW[0]), 0.0
    for _ in range(STEPS_TO_VIEW):
        if base is None:
            return None
        distance = distance_ahead(curve, base)
        if VIEW[0] <= distance <= VIEW[1]:
            return base, distance
        if VIEW[1] < distance < np.inf:
            base = _moved(curve, base, min(0.5 * distance, LARGEST_STEP))
        else:  # too near, or just behind it
            back *= 2.0
            base = _moved(curve, point, -back) if back < LARGEST_STEP else None
    return None


def _moved(curve: SolutionCurve, point: CurvePoint, length: float) -> CurvePoint | None:
    """Return the point `length` ahead of another one, or less far before a branch point."""
    while abs(length) > SMALLEST_STEP:
        x = curve.ahead(point, length)
        if x is None:
            return None
        moved = curve.point(x, curve.direction(x, point.t)[0])
        if moved.sign == point.sign:
            return moved
        length *= 0.5
    return None


def distance_ahead(curve: SolutionCurve, point: CurvePoint) -> float:
    """Return the distance from a point to the next loss of rank, about; inf if there is none."""
    x = curve.ahead(point, PROBE)
    if x is None:
        return 0.0
    return distance_after(point, point._replace(sigma=curve.sigma(x)), PROBE)


def distance_after(last: CurvePoint, point: CurvePoint, length: float) -> float:
    """Return the distance to the loss of rank ahead of a point, `length` after the last one."""
    fall = last.sigma - point.sigma
    return point.sigma * length / fall if fall > 0.0 else np.inf


def located_singularity(curve: SolutionCurve, point: CurvePoint) -> tuple[str, float] | None:
    """Return kind and parameter of the next point where the equations lose rank.

    The matrix of equations and tangent, a smooth function of the arc length, is extrapolated to
    where it is singular; so are the leading value and its slope. If the slope vanishes there, the
    value is at its limit; else branches cross.
    """
    viewed = _viewed(curve, point)
    if viewed is None:
        return None
    base, distance = viewed
    lengths = distance * PLACES
    nodes = [curve.ahead(base, x) for x in lengths]
    points = [node for node in nodes if node is not None]
    if len(points) < len(nodes):
        return None
    tangents = [curve.direction(x, base.t)[0] for x in points]
    there = matrices(curve, zip(points, tangents, strict=True))
    first = next((x for x in zeros(lengths, there) if x > 0.0), None)
    if first is None:
        return None
    value = float(through(lengths, np.array([curve.value(x) for x in points]))(first))
    slopes = through(lengths, np.array([curve.slope(t) for t in tangents]))
    rests = abs(slopes(first)) < 0.1 * abs(slopes(0.0))
    return "limit" if rests else "branch point", value
