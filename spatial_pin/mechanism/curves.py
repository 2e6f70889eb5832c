"""Curves as geometry, without a frame: a closure attaches them to its first frame.

The parameter of a plane closed curve is the polar angle about a centre. Distance and arc length
are piecewise polynomials of this angle, exact to round-off. Splines that are open, in space, or
not star-shaped about their centre have a parameter of their own.

Example:
    >>> profile = sp.curves.ellipse([0.04, 0.03])
    >>> print(f"{profile.length:.6f} m")
    0.221035 m
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from spatial_pin._support.checks import finite_array, finite_number, positive_number
from spatial_pin._support.lazy import made_once
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.piecewise import Piecewise, quintic_spline
from spatial_pin.numerics.taylor import Taylor, argument

__all__ = ["circle", "ellipse", "helix", "line", "spline"]
CELLS = 96  # of a turn, each with a polynomial of degree 9: the rest is below round-off
ORDER = 4  # of the derivatives that these have at their ends
FACTORIALS = np.array([math.factorial(k) for k in range(ORDER + 1)], float)
TURN = 2.0 * math.pi
FLAT = 1e-6  # of its size: how far points of rounded numbers may be off their plane
FLATTEST_CURVE = 0.02  # sine of the angle at which a curve is seen from its centre
MOST_HELIX_TURNS = 60.0  # most turns of a helix in a picture
STRAIGHT_PART = 0.25  # of its length, on which the end of an open spline becomes a line
SEEN_DIRECTIONS = 400  # candidates for an axis; one differs from every tangent
FORMS = ("circle", "ellipse", "line", "helix", "points", "table")


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True, eq=False)
class CurveShape:
    """A curve in the axes of a frame.

    Attributes:
        form: its table in a mechanism file, below `[curves.NAME]`.
        axes: (3, 3) x, y and normal of its plane in columns; of a line or helix its direction last.
        centre: (3,) origin of the polar angle; a point of a line or of a helix' axis [m].
        at: of plane closed ones: u (n,), and others in the same cells, -> points (n, 2) in the
            plane, from the centre, and their first five derivatives, (6, n, 2); anticlockwise.
        breaks: (k,) u between which all derivatives are continuous, from 0 on.
        numbers: radius and lead of a helix.
        path: the curve by a parameter, for splines that are open, in space, or not star-shaped;
            None for others, see `by_parameter`.
        end: arc length at its end [m]; infinite of a line without one, and of a helix.
        name: in a mechanism file.

    Example:
        >>> sp.curves.circle(0.03, centre=[0.01, 0.0, 0.0]).form["circle"]["radius"]  # [m]
        0.03
    """

    form: Mapping[str, Any]
    axes: Array
    centre: Array
    at: Callable[[Array, Array], Array] | None = None
    breaks: Array = field(default_factory=lambda: np.linspace(0.0, 2.0 * np.pi, CELLS + 1))
    numbers: tuple[float, ...] = ()
    path: CurvePath | None = None
    end: float = np.inf
    name: str = ""

    def __reduce__(self) -> Any:
        """Return the function and arguments from which it is rebuilt (pickle)."""
        return curve_of, (self.name, dict(self.form))

    @property
    def length(self) -> float:
        """Its length [m]; infinite of a line without one, and of a helix.

        Example:
            >>> print(f"{sp.curves.circle(0.5).length:.6f} m")
            3.141593 m
        """
        return self.end if self.at is None else float(self._arcs[-1])

    @cached_property
    def _arcs(self) -> Array:
        """(k,) arc length at each break."""
        x, w = np.polynomial.legendre.leggauss(16)
        half = 0.5 * np.diff(self.breaks)
        u = (self.breaks[:-1, None] + half[:, None] * (x + 1.0)).ravel()
        speed = np.linalg.norm(self._at(u, u)[1], axis=1).reshape(len(half), -1)
        return np.concatenate([[0.0], np.cumsum(half * (speed @ w))])

    def points(self, along: tuple[float, float] = (0.0, 1.0)) -> Array:
        """Return points (n, 3) of it to draw it by, of a closed one the first is the last [m].

        Args:
            along: from where to where, on a line without an end or the axis of a helix [m].
        """
        if self.at is not None:
            u = np.linspace(0.0, self.breaks[-1], 2 * CELLS + 1)
            flat = self.at(u, u)[0]
            return self.centre + flat @ self.axes[:, :2].T
        if self.path is not None:
            u = np.linspace(*self.path.span, 4 * CELLS + 1)
            flat = np.column_stack([x(Taylor([u])).values[0] for x in self.path.coordinates])
            return self.centre + flat @ self.axes.T
        if not self.numbers:
            ends = (0.0, self.end) if np.isfinite(self.end) else along
            return self.centre + np.outer(ends, self.axes[:, 2])
        radius, lead = self.numbers
        turns = abs((along[1] - along[0]) / lead)
        z = np.linspace(*along, int(CELLS * min(turns, MOST_HELIX_TURNS)) + 2)
        angle = 2.0 * np.pi * z / lead
        local = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
        return self.centre + local @ self.axes.T

    @cached_property
    def by_parameter(self) -> CurvePath:
        """The curve by a parameter; lines and helices have none."""
        if self.path is not None:
            return self.path
        middles = 0.5 * (self.breaks[:-1] + self.breaks[1:])
        ends = [self._at(u, middles)[: ORDER + 1] / FACTORIALS[:, None, None]
                for u in (self.breaks[:-1], self.breaks[1:])]
        widths = np.diff(self.breaks)
        begin = self.breaks + (self.breaks[-1] - self.breaks[0])
        flat = [Piecewise(begin, hermite(widths, ends[0][..., k], ends[1][..., k]), True)
                for k in range(2)]
        level = Piecewise(begin, np.zeros((len(widths), 1)), True)
        return CurvePath.of((*flat, level), (float(begin[0]), float(begin[-1])), begin)

    @property
    def is_plane(self) -> bool:
        """Whether it lies in the plane through its centre, square to its last axis."""
        return self.at is not None or (self.path is not None and self.path.is_level)

    @property
    def is_closed(self) -> bool:
        """Whether its end is its beginning."""
        return self.at is not None or (self.path is not None and self.path.arc.is_periodic)

    def tangent(self, point: Array) -> Array:
        """Return the direction (3,) of its tangent at the point nearest to a given point (3,)."""
        x, y, z = (point - self.centre) @ self.axes
        if self.numbers:
            radius, lead = self.numbers
            turn = math.atan2(y, x)
            local = np.array([-radius * math.sin(turn), radius * math.cos(turn), lead / TURN])
        elif self.at is not None:
            u = Taylor([np.array([math.atan2(y, x)])])
            nx, ny = (f(u).values[0][0] for f in self.normals)
            local = np.array([-ny, nx, 0.0])
        elif self.path is None:
            local = np.array([0.0, 0.0, 1.0])
        else:
            u = Taylor([np.linspace(*self.path.reach, 40 * CELLS)])
            apart = sum((f(u).values[0] - k)**2
                        for f, k in zip(self.path.coordinates, (x, y, z), strict=True))
            at = Taylor([u.values[0][np.argmin(apart)]])
            local = np.array([f(at).values[0] for f in self.path.slopes])
        return self.axes @ local / np.linalg.norm(local)

    def crosses_itself(self) -> bool:
        """Whether a closed curve in a plane crosses or touches itself."""
        p = ((self.points() - self.centre) @ self.axes)[:, :2]
        one, two = p[:-1, None], np.diff(p, axis=0)[:, None]
        n, (c, d) = len(one), (x.swapaxes(0, 1) for x in (one, two))
        apart = c - one
        cross = two[..., 0] * d[..., 1] - two[..., 1] * d[..., 0]
        with np.errstate(all="ignore"):
            along = (apart[..., 0] * d[..., 1] - apart[..., 1] * d[..., 0]) / cross
            other = (apart[..., 0] * two[..., 1] - apart[..., 1] * two[..., 0]) / cross
        meet = (along >= 0.0) & (along <= 1.0) & (other >= 0.0) & (other <= 1.0)
        far = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        return bool(np.any(meet & (far > 1) & (far < n - 1)))

    def part_inside(self, points: Array) -> float:
        """Return the fraction of points (n, 3) that it surrounds, seen along its last axis."""
        x, y, _ = ((points - self.centre) @ self.axes).T[:, :, None]
        own = ((self.points() - self.centre) @ self.axes)[:, :2]
        (x1, y1), (x2, y2) = own[:-1].T, own[1:].T
        crosses = (y1 > y) != (y2 > y)
        with np.errstate(all="ignore"):
            at = x1 + (y - y1) / (y2 - y1) * (x2 - x1)
        return float(np.mean(np.sum(crosses & (x < at), axis=1) % 2))

    @made_once
    def radial(self, offset: float) -> tuple[Piecewise, Piecewise]:
        """Return the squared distance [m^2] and the arc length [m] by direction from the centre.

        Args:
            offset: by which a parallel curve lies outside, as that of a roller's centre [m]; the
                arc length is that of the curve itself.

        Raises:
            ValueError: the centre does not see it whole, or the parallel curve has cusps.
        """
        def seen(x: Taylor, y: Taylor, dx: Taylor, dy: Taylor) -> tuple[Taylor, Taylor, Taylor]:
            away = power(dx * dx + dy * dy, -0.5) * offset
            px, py = _first(x, away) + dy * away, _first(y, away) + dx * away * -1.0
            if np.any(px.values[1] * dx.values[0] + py.values[1] * dy.values[0] <= 0.0):
                raise ValueError("the roller does not fit into the curve, whose radius is smaller: "
                                 "the path of its centre has cusps (undercut)")
            return px, py, px * px + py * py

        return self._by_direction(seen)

    @cached_property
    def normals(self) -> tuple[Piecewise, Piecewise]:
        """X and y of its outward normal by direction from the centre, a closed curve in a plane."""
        def part(k: int) -> Callable[..., tuple[Taylor, Taylor, Taylor]]:
            def of(x: Taylor, y: Taylor, dx: Taylor, dy: Taylor) -> tuple[Taylor, Taylor, Taylor]:
                size = power(dx * dx + dy * dy, -0.5)
                return x, y, (dy if k == 0 else dx * -1.0) * size
            return of

        return self._by_direction(part(0))[0], self._by_direction(part(1))[0]

    @made_once
    def support(self) -> tuple[Piecewise, Piecewise]:
        """Return the distance [m] of its tangent and the arc length [m], by outward normal.

        Raises:
            ValueError: it is not convex.
        """
        def normal(x: Taylor, y: Taylor, dx: Taylor, dy: Taylor) -> tuple[Taylor, Taylor, Taylor]:
            if np.any(dx.values[0] * dy.values[1] <= dy.values[0] * dx.values[1]):
                raise ValueError("a flat face needs a convex curve: this one is hollow somewhere")
            size = power(dx * dx + dy * dy, -0.5)
            distance = (_first(x, size) * dy + _first(y, size) * dx * -1.0) * size
            return dy, dx * -1.0, distance

        return self._by_direction(normal)

    def _at(self, u: Array, within: Array) -> Array:
        assert self.at is not None
        return self.at(u, within)

    def _by_direction(
        self, of: Callable[[Taylor, Taylor, Taylor, Taylor], tuple[Taylor, Taylor, Taylor]]
    ) -> tuple[Piecewise, Piecewise]:
        """Return a quantity and the arc length as functions of the direction of a vector.

        The function gives vector and quantity of a point and its derivative. Each cell is the
        polynomial that has their derivatives at its ends.
        """
        middles = 0.5 * (self.breaks[:-1] + self.breaks[1:])
        ends, angle = [], np.zeros(0)
        for u in (self.breaks[:-1], self.breaks[1:]):
            d = self._at(u, middles)
            x, y = (Taylor.of(list(d[: ORDER + 1, :, k])) for k in range(2))
            dx, dy = (Taylor.of(list(d[1 : ORDER + 2, :, k])) for k in range(2))
            vx, vy, quantity = of(x, y, dx, dy)
            turned = argument(vy, vx)
            size = np.hypot(vx.values[0], vy.values[0]) * np.hypot(vx.values[1], vy.values[1])
            square = vx.values[0] ** 2 + vy.values[0] ** 2
            if np.any(turned.values[1] * square < FLATTEST_CURVE * size):
                raise ValueError("its centre does not see all of it: a ray from there must meet it "
                                 "once, and not along it")
            speed = power(dx * dx + dy * dy, 0.5).values
            arc = Taylor([0.0 * u, *(v / (k + 1) for k, v in enumerate(speed[: ORDER]))])
            ends.append([by_angle(x.values, turned.values) for x in (quantity, arc)])
            angle = turned.values[0]
            if len(ends) == 1:
                first = angle
        turns = np.mod(angle - first, 2.0 * np.pi)
        breaks = first[0] + np.concatenate([[0.0], np.cumsum(turns)])
        if abs(breaks[-1] - breaks[0] - 2.0 * np.pi) > 1e-6:
            raise ValueError("it does not run once around its centre: it crosses itself, or the "
                             "centre is outside")
        breaks[-1] = breaks[0] + 2.0 * np.pi
        arcs = self._arcs
        for k, end in enumerate(ends):
            end[1][0] = arcs[k : len(arcs) - 1 + k]
        one, two = (hermite(np.diff(breaks), ends[0][k], ends[1][k]) for k in range(2))
        return (Piecewise(breaks, one, True), Piecewise(breaks, two, True, float(arcs[-1])))


@dataclass(frozen=True, eq=False)
class CurvePath:
    """A curve as a function of a parameter u, in its own axes from its centre.

    Open ones go on straight beyond their ends. The parameter never is 0 on the first turn.

    Attributes:
        coordinates: x, y and z [m].
        slopes: their derivatives.
        arc: length from the first point [m].
        span: u at the first and at the last point.
        reach: u between which a nearest point is looked for.
        is_level: whether z is zero.
    """

    coordinates: tuple[Piecewise, ...]
    slopes: tuple[Piecewise, ...]
    arc: Piecewise
    span: tuple[float, float]
    reach: tuple[float, float]
    is_level: bool

    @staticmethod
    def of(
        coordinates: tuple[Piecewise, ...], span: tuple[float, float], cells: Array
    ) -> CurvePath:
        """Return a path with its arc length, a polynomial in each of some cells."""
        slopes = tuple(x.derivative() for x in coordinates)
        nodes, weights = np.polynomial.legendre.leggauss(16)
        half = 0.5 * np.diff(cells)
        u = (cells[:-1, None] + half[:, None] * (nodes + 1.0)).ravel()
        arcs = np.concatenate([[0.0], np.cumsum(half * (_speed(slopes, u)[0].reshape(-1, 16)
                                                        @ weights))])
        arcs -= arcs[np.searchsorted(cells, span[0])]
        middles, ends = 0.5 * (cells[:-1] + cells[1:]), []
        for side, start in ((cells[:-1], arcs[:-1]), (cells[1:], arcs[1:])):
            speed = _speed(slopes, side, middles)
            ends.append(np.array([start, *(v / (k + 1) for k, v in enumerate(speed[:ORDER]))]))
        is_closed, rise = slopes[0].is_periodic, float(arcs[-1] - arcs[0])
        arc = Piecewise(cells, hermite(np.diff(cells), *ends), is_closed, rise * is_closed)
        return CurvePath(coordinates, slopes, arc, span, (float(cells[0]), float(cells[-1])),
                         not np.any(coordinates[2].coefficients))

    @property
    def length(self) -> float:
        """Its length between its first and last point [m]."""
        return float(np.ptp(self.arc(Taylor([np.array(self.span)])).values[0])) or self.arc.rise


def _speed(slopes: Sequence[Piecewise], u: Array, within: Array | None = None) -> list[Array]:
    """Return Taylor series of the derivative of the arc length at u (n,), `within` cells."""
    square: Any = 0.0
    for f in slopes:
        rates = f(Taylor([u, 1.0 + 0.0 * u, *[0.0 * u] * (ORDER - 1)]), within)
        square = rates * rates + square
    return list(power(square, 0.5).values)


def power(x: Taylor, exponent: float) -> Taylor:
    """Return a power of a series that begins with a positive number."""
    y = [x.values[0] ** exponent]
    for k in range(1, len(x.values)):
        y.append(sum((exponent * i - (k - i)) * x.values[i] * y[k - i]
                     for i in range(1, k + 1)) / (k * x.values[0]))
    return Taylor(y)


def by_angle(values: list[Array], angle: list[Array]) -> Array:
    """Return a series in a parameter as one (k, n) in an angle that is a series in it too."""
    rest, derivatives = list(values), [values[0]]
    ahead = Taylor([0.0 * angle[0], *angle[1:]])
    step = ahead
    for k in range(1, len(values)):
        derivatives.append(rest[k] / step.values[k])
        rest = [a - derivatives[k] * b for a, b in zip(rest, step.values, strict=True)]
        step = step * ahead
    return np.array(np.broadcast_arrays(*derivatives))


def hermite(widths: Array, first: Array, last: Array) -> Array:
    """Return coefficients (n, 2 k) of polynomials with series (k, n) at the ends of cells (n,)."""
    k = len(first)
    powers = np.arange(2 * k)
    # binomials: the series at x = 1 of x^p
    at_end = np.array([[math.comb(p, i) for p in powers] for i in range(k)], float)
    scaled = first * widths ** np.arange(k)[:, None]
    rest = last * widths ** np.arange(k)[:, None] - at_end[:, :k] @ scaled
    upper = np.linalg.solve(at_end[:, k:], rest)
    return np.ascontiguousarray(
        (np.concatenate([scaled, upper]) / widths ** powers[:, None]).T)


def _first(x: Taylor, like: Taylor) -> Taylor:
    """Return as many terms of a series as another has."""
    return Taylor(x.values[: len(like.values)])


def circle(radius: float, centre: ArrayLike = (0.0, 0.0, 0.0),
           normal: ArrayLike = (0.0, 0.0, 1.0)) -> CurveShape:
    """Return a circle.

    Args:
        radius: positive [m].
        centre: (3,) [m].
        normal: (3,) of its plane, about which it runs anticlockwise.

    Raises:
        ValueError: the radius is not positive, or another number none.

    Example:
        >>> sp.curves.circle(0.03).centre  # [m]
        array([0., 0., 0.])
    """
    r = positive_number(radius, "radius")
    form = {"radius": r, **_plane_entries(centre, normal)}
    return _conic({"circle": form}, (r, r), form)


def ellipse(semi_axes: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0),
            normal: ArrayLike = (0.0, 0.0, 1.0), x_axis: ArrayLike | None = None) -> CurveShape:
    """Return an ellipse.

    Args:
        semi_axes: (2,) positive [m], the first along `x_axis`.
        centre: (3,) [m].
        normal: (3,) of its plane, about which it runs anticlockwise.
        x_axis: (3,) direction of the first semi-axis; default x, or the direction nearest to it.

    Raises:
        ValueError: a semi-axis is not positive, or another number none.

    Example:
        >>> sp.curves.ellipse([1.0, 0.5]).form["ellipse"]["semi_axes"]  # [m]
        [1.0, 0.5]
    """
    a, b = (positive_number(x, "semi_axes") for x in finite_array(semi_axes, (2,), "semi_axes"))
    form = {"semi_axes": [a, b], **_plane_entries(centre, normal, x_axis)}
    return _conic({"ellipse": form}, (a, b), form)


def line(point: ArrayLike, direction: ArrayLike, length: float | None = None) -> CurveShape:
    """Return a straight line, as of a slot.

    Args:
        point: (3,) of it, where its arc length begins [m].
        direction: (3,) along it.
        length: where it ends, positive [m]; default nowhere. Motions have an event where their
            point leaves it.

    Raises:
        ValueError: a number is none, or the direction is zero.

    Example:
        >>> sp.curves.line([0, 0, 0], [1, 0, 0]).length  # [m]
        inf
    """
    p = finite_array(point, (3,), "point")
    axes = _axes(finite_array(direction, (3,), "direction"), None)
    form = {"point": p.tolist(), "direction": axes[:, 2].tolist()}
    if length is None:
        return CurveShape({"line": form}, axes, p)
    end = positive_number(length, "length")
    return CurveShape({"line": {**form, "length": end}}, axes, p, end=end)


def helix(radius: float, lead: float, axis: ArrayLike = (0.0, 0.0, 1.0),
          point: ArrayLike = (0.0, 0.0, 0.0)) -> CurveShape:
    """Return a helix.

    Args:
        radius: positive [m].
        lead: advance per turn, positive of a right-handed one [m].
        axis: (3,) direction of its axis.
        point: (3,) of its axis; the helix begins at the radius from there, along x or the direction
            nearest to x [m].

    Raises:
        ValueError: a number is none, the radius is not positive, or the lead zero.

    Example:
        >>> sp.curves.helix(0.02, 0.01).numbers  # [m]
        (0.02, 0.01)
    """
    r, p = positive_number(radius, "radius"), finite_array(point, (3,), "point")
    advance = finite_number(lead, "lead")
    if advance == 0.0:
        raise ValueError("lead is 0; a helix without one is a circle")
    axes = _axes(finite_array(axis, (3,), "axis"), None)
    form = {"radius": r, "lead": advance, "axis": axes[:, 2].tolist(), "point": p.tolist()}
    return CurveShape({"helix": form}, axes, p, numbers=(r, advance))


def spline(points: ArrayLike, closed: bool = True) -> CurveShape:
    """Return the quintic spline through points, in a plane or in space.

    It is a function of chord length.

    Args:
        points: (n, 3), four or more, no two neighbours at the same place [m].
        closed: whether the last one is followed by the first.

    Raises:
        ValueError: fewer than four points, or two neighbours at the same place.

    Example:
        >>> turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        >>> x, y = 0.03 + 0.02 * np.cos(turn), 0.02 * np.sin(turn)
        >>> profile = sp.curves.spline(np.column_stack([x, y, 0.0 * turn]))
        >>> print(f"{profile.length:.6f} m")
        0.125664 m
    """
    p, chords = _points(points, closed)
    if closed:
        try:
            return _profile(p, chords)
        except ValueError:
            pass  # in space, or a curve that no centre sees whole
    u = np.concatenate([[0.0], np.cumsum(chords)])
    around = np.vstack([p, p[:1]]) if closed else p
    centre = p.mean(axis=0) if closed else p[0]
    world = [quintic_spline(u, x, closed) for x in (around - centre).T]
    breaks = world[0].breaks
    cells = np.unique(np.concatenate([np.linspace(a, b, max(2, 1 + CELLS // len(p)))
                                      for a, b in pairwise(breaks)]))
    axes = _free_axes(np.column_stack([
        x.derivative()(Taylor([0.5 * (cells[:-1] + cells[1:])])).values[0] for x in world]),
        np.cross(p - centre, np.roll(p, -1, axis=0) - centre).sum(axis=0))
    turned = np.einsum("ki,knj->inj", axes, np.array([x.coefficients for x in world]))
    turned[np.abs(turned) <= 1e-15 * np.abs(turned).max(axis=(0, 1))] = 0.0
    shift = u[-1]
    if closed:
        shape = [Piecewise(breaks + shift, c, True) for c in turned]
    else:
        extra = STRAIGHT_PART * u[-1]
        shape = [_with_straight_ends(breaks + shift, c, extra) for c in turned]
        cells = np.concatenate([[-2.0 * extra, -extra], cells, u[-1] + [extra, 2.0 * extra]])
    path = CurvePath.of(tuple(shape), (shift, 2.0 * shift), cells + shift)
    return CurveShape({"points": p.tolist(), "closed": closed}, axes, centre, path=path,
                      end=path.length)


def _with_straight_ends(breaks: Array, coefficients: Array, extra: float) -> Piecewise:
    """Return a spline that goes over into straight lines beyond its ends, within a distance."""
    inside, width = Piecewise(breaks, coefficients), 2 * (ORDER + 1)

    def as_wide(x: Array) -> Array:
        wide: Array = np.pad(x, ((0, 0), (0, width - x.shape[1])))
        return wide

    def beyond(at: float, sign: float) -> list[Array]:
        """The piece next to an end, and the straight one behind it."""
        series = np.array([x[0] for x in inside(Taylor([
            np.array([at]), np.ones(1), *[np.zeros(1)] * (ORDER - 1)])).values])[:, None]
        line = np.zeros_like(series)
        line[:2] = series[:2]
        line[0] += sign * extra * series[1, 0]
        ends = (series, line) if sign > 0.0 else (line, series)
        straight = line[:2].T.copy()
        straight[0, 0] -= extra * straight[0, 1] * (sign < 0.0)
        return [as_wide(hermite(np.array([extra]), *ends)), as_wide(straight)]

    pieces = [*beyond(breaks[0], -1.0)[::-1], as_wide(coefficients), *beyond(breaks[-1], 1.0)]
    outer = np.array([2.0, 1.0]) * extra
    return Piecewise(np.concatenate([breaks[0] - outer, breaks, breaks[-1] + outer[::-1]]),
                     np.ascontiguousarray(np.vstack(pieces)))


def _free_axes(tangents: Array, area: Array) -> Array:
    """Return axes (3, 3) whose last is square to tangents (n, 3), or far from each of them.

    A closed curve in a plane runs anticlockwise about it: its area (3,) is along it.
    """
    tangents = tangents / np.linalg.norm(tangents, axis=1)[:, None]
    own = decompose(tangents).vt
    k = np.arange(SEEN_DIRECTIONS) + 0.5
    z, turn = 1.0 - k / SEEN_DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z * z)
    tried = np.vstack([own[::-1], np.column_stack([r * np.cos(turn), r * np.sin(turn), z])])
    apart = 1.0 - np.abs(tangents @ tried.T).max(axis=0)
    best = tried[int(np.argmax(apart > 0.9 * apart.max()))]
    sign = best @ area if abs(best @ area) > 1e-9 * np.linalg.norm(area) else best[
        np.argmax(np.abs(best))]
    best = best * np.sign(sign)
    return _axes(best, None)


def _points(points: ArrayLike, closed: bool) -> tuple[Array, Array]:
    """Return points (n, 3) and the chords from each to the next."""
    p = np.array(points, float)
    if p.ndim != 2 or p.shape[1:] != (3,) or len(p) < 4 or not np.isfinite(p).all():
        raise ValueError("points: four or more are needed, each of three finite numbers")
    around = np.vstack([p, p[:1]]) if closed else p
    chords = np.linalg.norm(np.diff(around, axis=0), axis=1)
    if np.any(chords <= 1e-9 * chords.max()):
        k = int(np.argmin(chords))
        raise ValueError(f"points: number {k + 1} and the next one are at the same place (a closed "
                         "curve does not repeat its first point)")
    return p, chords


def _profile(p: Array, chords: Array) -> CurveShape:
    """Return the closed curve through points (n, 3) in a plane, star-shaped about their middle.

    Raises:
        ValueError: they do not lie in a plane, or it does not see it whole.
    """
    middle = p.mean(axis=0)
    area = np.cross(p - middle, np.roll(p, -1, axis=0) - middle).sum(axis=0)  # anticlockwise
    size = float(np.abs(p - middle).max())
    if np.linalg.norm(area) <= 1e-9 * size**2:
        raise ValueError("points: the curve crosses itself, or lies on a line")
    axes = _axes(area, None)
    if np.abs((p - middle) @ axes[:, 2]).max() > FLAT * size:
        raise ValueError("points: they do not lie in a plane")
    u = np.concatenate([[0.0], np.cumsum(chords)])
    flat = (np.vstack([p, p[:1]]) - middle) @ axes[:, :2]
    flat[-1] = flat[0]
    pieces = [quintic_spline(u, x, True) for x in flat.T]

    def at(t: Array, within: Array) -> Array:
        still = [0.0 * t] * ORDER
        series = [x(Taylor([t, 1.0 + 0.0 * t, *still]), within).values for x in pieces]
        return np.array([[math.factorial(k) * x[k] for x in series]
                         for k in range(ORDER + 2)]).transpose(0, 2, 1)

    cells = np.unique(np.concatenate([np.linspace(a, b, max(2, 1 + CELLS // len(p)))
                                      for a, b in pairwise(u)]))
    made = CurveShape({"points": p.tolist(), "closed": True}, axes, middle, at, cells)
    made.radial(0.0)
    return made


def curve_of(name: str, given: Any, read: Callable[[str], Any] | None = None) -> CurveShape:
    """Return a curve from its table in a mechanism file; a ValueError says why it is none."""
    keys = [key for key in FORMS if isinstance(given, Mapping) and key in given]
    if len(keys) != 1:
        raise ValueError(f"a curve is one of {', '.join(FORMS)}")
    (kind,) = keys
    rest = set(given) - {kind} - ({"closed"} if kind in ("points", "table") else set())
    if rest:
        raise ValueError(f"{min(rest)} is not a key beside {kind}")
    value = given[kind]
    if kind in ("points", "table"):
        rows = read(value) if kind == "table" and read is not None else value
        flat = isinstance(rows, list) and rows and isinstance(rows[0], list) and len(rows[0]) == 2
        made = spline([[*row, 0.0] for row in rows] if flat else rows, given.get("closed", False))
    else:
        makers: dict[str, Callable[..., CurveShape]] = {
            "circle": circle, "ellipse": ellipse, "line": line, "helix": helix}
        if not isinstance(value, Mapping):
            raise ValueError(f"{kind} is a table, as {{radius = 0.03}}")
        try:
            made = makers[kind](**value)
        except TypeError as error:
            raise ValueError(f"{kind}: {error}") from error
    return replace(made, name=name)


def _plane_entries(
    centre: ArrayLike, normal: ArrayLike, x_axis: ArrayLike | None = None
) -> dict[str, list[float]]:
    axes = _axes(finite_array(normal, (3,), "normal"), x_axis)
    return {"centre": finite_array(centre, (3,), "centre").tolist(),
            "normal": axes[:, 2].tolist(),
            **({} if x_axis is None else {"x_axis": axes[:, 0].tolist()})}


def _conic(form: Mapping[str, Any], sizes: Sequence[float], plane: Mapping[str, Any]) -> CurveShape:
    axes = _axes(np.array(plane["normal"]), plane.get("x_axis"))
    a, b = sizes

    def at(u: Array, _: Array) -> Array:
        c, s = np.cos(u), np.sin(u)
        turn = [[a * c, b * s], [-a * s, b * c], [-a * c, -b * s], [a * s, -b * c]]
        return np.array([*turn, *turn[: ORDER - 2]]).transpose(0, 2, 1)

    return CurveShape(form, axes, np.array(plane["centre"]), at)


def _axes(z: Array, x_axis: ArrayLike | None) -> Array:
    """Return x, y and z in columns: z along a direction, x along another or the world's."""
    size = float(np.linalg.norm(z))
    if size == 0.0:
        raise ValueError("a direction is zero")
    z = z / size
    hint = np.array([1.0, 0.0, 0.0]) if x_axis is None else finite_array(x_axis, (3,), "x_axis")
    if x_axis is None and abs(z[0]) > 0.9:
        hint = np.array([0.0, 1.0, 0.0])
    x = hint - (hint @ z) * z
    if np.linalg.norm(x) <= 1e-9 * np.linalg.norm(hint):
        raise ValueError("x_axis is along the normal")
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@dataclass(frozen=True, eq=False)
class TouchingCurves:
    """Two profiles that touch.

    Attributes:
        one: the curve that frame 1 carries.
        two: that frame 2 carries.
        side: 1 outside each other, -1 where one is inside the other.
    """

    one: CurveShape
    two: CurveShape
    side: int = 1

    @property
    def form(self) -> list[str]:
        """Their names, as a mechanism file has them."""
        return [self.one.name, self.two.name]


@dataclass(frozen=True, eq=False)
class Follower:
    """The follower of a cam.

    Attributes:
        radius: of a roller about the origin of frame 2 [m]; 0 of a knife edge.
        flat: (3,) normal, in frame 2, of a face through its origin; None of a roller.
        side: 1 outside the cam, -1 inside; of a face, 1 where its normal leads away from it.
    """

    radius: float = 0.0
    flat: Array | None = None
    side: int = 1

    @property
    def form(self) -> dict[str, Any]:
        """Its table in a mechanism file."""
        if self.flat is not None:
            return {"flat": self.flat.tolist()}
        return {"roller": self.radius} if self.radius else {"knife": True}


def follower_of(given: Any, _: Any = None) -> Follower:
    """Return a follower from its table in a mechanism file, or refuse it with a ValueError."""
    if isinstance(given, Follower):
        return given
    if not isinstance(given, Mapping) or len(given) != 1 or not given.keys() <= {
            "roller", "flat", "knife"} or given.get("knife", True) is not True:
        raise ValueError("is {roller = 0.008}, {flat = [0, 1, 0]} or {knife = true}")
    if "flat" in given:
        normal = finite_array(given["flat"], (3,), "flat")
        if not np.any(normal):
            raise ValueError("flat: the normal of a face is not zero")
        return Follower(flat=normal / np.linalg.norm(normal))
    return Follower(positive_number(given["roller"], "roller") if "roller" in given else 0.0)


def curves_in(numbers: Mapping[str, Any]) -> tuple[CurveShape, ...]:
    """Return the curves among the numbers of a closure: one, two that touch, or none."""
    both = numbers.get("curves")
    return (both.one, both.two) if both is not None else tuple(
        filter(None, [numbers.get("curve")]))


def named_curve(given: Any, context: Any = None) -> CurveShape:
    """Return a curve by its name in a mechanism file, or as it is; or refuse it (ValueError)."""
    if isinstance(given, CurveShape):
        return given
    curves = getattr(context, "curves", {})
    if not isinstance(given, str) or given not in curves:
        there = ", ".join(curves) or "none"
        raise ValueError(f"names [curves.NAME], not {str(given)[:60]!r}; there are: {there}")
    curve: CurveShape = curves[given]
    return curve


def two_curves(given: Any, context: Any = None) -> TouchingCurves:
    """Return two curves by names in a mechanism file, or as they are; or raise a ValueError."""
    if isinstance(given, TouchingCurves):
        return given
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
        raise ValueError(f'are two, as ["cam", "lever"], not {str(given)[:60]!r}')
    one, two = (named_curve(each, context) for each in given)
    return TouchingCurves(one, two)
