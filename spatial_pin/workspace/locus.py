"""Following a curve on a section of a grid: the boundary, or zeros of a determinant.

The closed configurations over a section of the grid form a surface. A curve on it is the zero set
of a function: the room of a joint before its limit, or the last number g of the bordered system

    [A  b] [v]   [0]
    [c  0] [g] = [1]

whose square matrix A loses its rank there [Govaerts2000]. A maps the motions of the mechanism to
the coordinates of the grid (limit positions) or to the task of the frame (zeros of the
determinant). With b and c the singular vectors at the last point, g is about A's least singular
value, with a sign. It does not depend on the basis of the motions. Curves are followed by
pseudo-arclength on the surface, which is regular at limit positions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close, scaled_row
from spatial_pin.assembly.holding import held_by
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.joint_limits import JointLimit, joint_limits
from spatial_pin.motion.limit_events import KIND as JOINT_LIMIT
from spatial_pin.numerics.linalg import Array, aligned, decompose
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.workspace.dexterity import TASKS, FrameTask
from spatial_pin.workspace.grid_lines import GridConfig

LIMIT = "limit"
# distance from a branch point at which a curve ends: part of a step, or of the rank
CURVE_END_MARGIN = 1e-4


class Section:
    """The surface of closed configurations over a section of a grid.

    Attributes:
        evaluation: the closure equations.
        limits: active joint limits, by words.
        free: numbers of the two coordinates of the grid that span the section.
    """

    def __init__(
        self, config: GridConfig, task: FrameTask, evaluation: LoopEquations, free: tuple[int, int],
        spans: Array,
    ) -> None:
        mechanism = config.mechanism
        self.config, self.task, self.evaluation, self.free = config, task, evaluation, free
        self.limits: dict[str, JointLimit] = {
            f"{JOINT_LIMIT}: {x.words}": x for x in
            (joint_limits(mechanism) if config.limits else [])}
        own = [mechanism.prescribed_coordinate(name) for name in config.names]
        moved = config.moving
        others = ([mechanism.coordinate_table[name] for name in config.standing] if config.is_posed
                  else [c for c in moved if c.v not in [x.v for x in own]])
        held = held_by(mechanism, config.hold, [*own, *others])
        for c in (*own, *others, *held.coordinates):
            if c.q < 0:
                raise SpatialPinError(f"{c.name!r} is a component of a joint that turns in space: "
                                      "no curves are followed in a section along it")
        self.grid = [*own, *others]
        self.scale = mechanism.velocity_scale
        self._sizes = self.scale[[c.v for c in own]]
        self.low, self.high = spans.T / self._sizes
        self._moved = [c.v for c in moved]
        self._frame = mechanism.frame_id(mechanism.placed(config.frame))
        self._rows = np.array([scaled_row(mechanism, c, evaluation.q) for c in self.grid])
        self._loose = np.ones(len(self.scale), dtype=bool)
        self._loose[list(held.entries)] = False
        self._moves = self._loose.copy()  # while loops close, those that do not change stand
        self._moves[[c.v for i, c in enumerate(self.grid) if i not in free]] = False

    def motions(self, q: Array) -> Array:
        """Return orthonormal motions (m, nv), one for each coordinate."""
        self.evaluation.update(q)
        svd = decompose(self.evaluation.jacobian[:, self._loose])
        motions = np.zeros((len(self.grid), len(self.scale)))
        motions[:, self._loose] = svd.vt[len(svd.vt) - len(self.grid) :]
        return motions

    def is_branch_point(self, q: Array) -> bool:
        """Whether the loop equations lose rank."""
        self.evaluation.update(q)
        s = decompose(self.evaluation.jacobian[:, self._loose], 0.0).s
        return bool(s[int(self._loose.sum()) - len(self.grid) - 1] < CURVE_END_MARGIN * s[0])

    def matrix(self, why: str, motions: Array) -> Array:
        """Return the square matrix that loses its rank on a curve, at the last `update`."""
        if why == LIMIT:
            return self._rows @ motions.T
        if self.config.is_posed:
            return motions[:, self._moved].T
        size = self.config.mechanism.characteristic_length
        rows = self.evaluation.frame_jacobian(self._frame) * self.scale
        rows[:3] /= size
        return self.task.directions @ rows[TASKS[self.task.name]] @ motions.T

    def plane(self, motions: Array) -> Array:
        """Return two orthonormal motions (2, nv) in the section."""
        fixed = [row for i, row in enumerate(self._rows) if i not in self.free]
        if not fixed:
            return motions
        return decompose(np.array(fixed) @ motions.T, 0.0).vt[len(fixed) :] @ motions

    def moved(self, q: Array, step: Array) -> Array | None:
        """Return the closed configuration after a step (nv,); None if loops stay open."""
        there = pin.integrate(self.evaluation.model, q, self.scale * step)
        there, error = close(self.evaluation, there, self._moves, TOLERANCES.round_off)
        return there if error <= TOLERANCES.closed and not self.evaluation.mirrored() else None

    def values(self, q: Array) -> Array:
        """Return the grid's coordinates (k,) in natural units."""
        return q[[c.q for c in self.grid[: len(self._sizes)]]] / self._sizes

    def margin(self, q: Array) -> float:
        """Return the distance from the ends of the section's ranges, in natural units."""
        free = list(self.free)
        values = self.values(q)[free]
        return float(min((values - self.low[free]).min(), (self.high[free] - values).min()))

    def seen(self, q: Array, t: Array) -> tuple[Array, Array]:
        """Return coordinates and point (k + 3,) in natural units, and their derivatives along t."""
        size = self.config.mechanism.characteristic_length
        self.evaluation.update(q)
        rows = self.evaluation.frame_jacobian(self._frame)[:3] * self.scale / size
        k = len(self._sizes)
        return (np.concatenate([self.values(q),
                                self.evaluation.frame(self._frame).translation / size]),
                np.concatenate([self._rows[:k] @ t, rows @ t]))

    def plain(self, y: Array) -> tuple[Array, Array]:
        """Return coordinates (m, k) and points (m, 3) of the world in their own units."""
        k = len(self._sizes)
        mechanism = self.config.mechanism
        return (y[:, :k] * self._sizes,
                y[:, k:] * mechanism.characteristic_length + mechanism.centre)


RANGE = "range"  # a curve leaves the grid
CORNER = "corner"  # two limit positions meet: beyond is another sheet
CROSSING = "branch point"  # loops lose their rank
ON_CURVE = 1e-12  # value of the function at a point of a curve, in natural units
SMALL_MOVE = 1e-5  # step of central differences of g, which are exact to its square [rad, lengths]
FIRST_LOCUS_STEP, LARGEST_STEP, SMALLEST_STEP = 0.01, 0.1, 1e-7  # rad, characteristic lengths
ALONG = 0.95  # least cosine between the directions at the ends of a step: 18 degrees
MOST_POINTS = 20_000  # of a curve
LEVEL = 1e-9  # slope of a function below which it has no direction, in natural units
AT_CORNER = 1e-10  # accuracy of a corner [rad, lengths]


class LocusPoint(NamedTuple):
    """A point of a curve."""

    q: Array  # the configuration
    angles: Array
    # (nv,) unit tangent of the curve, and normal to it on the surface, in scaled velocities
    t: Array
    normal: Array
    slope: float  # derivative of the function along the normal
    motions: Array  # (m, nv) of the mechanism
    border: tuple[Array, Array] | None  # (m,) and (nv,) border of the matrix; None on a joint limit
    y: Array  # (k + 3,) coordinates of the grid and point of the frame, in natural units
    dy: Array  # (k + 3,) derivatives along the curve


class LocusTrace(NamedTuple):
    """Points along a curve."""

    spots: list[LocusPoint]  # at least the first point
    # reason of the end: a joint limit in words, `LIMIT`, `RANGE`, `CORNER`, `CROSSING`, "closed" or
    # "lost"
    end: str


class Locus:
    """A curve on a section.

    Args:
        section: the surface.
        why: kind of the curve: `LIMIT`, `SINGULAR` or a joint limit in words.
        tolerance: of the polyline [rad, characteristic lengths].
    """

    def __init__(self, section: Section, why: str, tolerance: float) -> None:
        self.section, self.why, self.tolerance = section, why, tolerance
        self._limit = section.limits.get(why)
        self.border: tuple[Array, Array] | None = None

    def value(self, q: Array) -> float:
        """Return the function that is zero on the curve."""
        if self._limit is not None:
            return float(self._limit.room(q)) / self._limit.size
        whole = self.bordered(self.section.motions(q))
        right = np.zeros(len(whole))
        right[-1] = 1.0
        return float(np.linalg.solve(whole, right)[-1])

    def bordered(self, motions: Array) -> Array:
        """Return the bordered matrix (m + 1, m + 1) at the last `update`."""
        assert self.border is not None
        b, c = self.border
        return np.block([[self.section.matrix(self.why, motions), b[:, None]],
                         [(motions @ c)[None], np.zeros((1, 1))]])

    def spot(self, q: Array, along: Array | None) -> LocusPoint | None:
        """Return the point at q, with the tangent along `along`; None without a tangent."""
        s = self.section
        motions = s.motions(q)
        angles = s.evaluation.angles.copy()
        if self._limit is None:
            svd = decompose(s.matrix(self.why, motions), 0.0)
            self.border = svd.u[:, -1], svd.vt[-1] @ motions
        plane = s.plane(motions)
        if self._limit is not None:
            slopes = -self._limit.side * plane[:, self._limit.v]
        else:  # of the function along two motions; NaN if not known
            ends = [[s.moved(q, sign * SMALL_MOVE * x) for sign in (1, -1)] for x in plane]
            slopes = np.array([np.nan if a is None or b is None else
                               (self.value(a) - self.value(b)) / (2.0 * SMALL_MOVE)
                               for a, b in ends])
        size = float(np.linalg.norm(slopes))
        if not size > LEVEL:
            return None
        normal, t = slopes @ plane / size, np.array([-slopes[1], slopes[0]]) @ plane / size
        if along is not None and t @ along < 0.0:
            t = -t
        return LocusPoint(q, angles, t, normal, size, motions, self.border, *s.seen(q, t))

    def settled(self, q: Array | None, normal: Array, slope: float) -> Array | None:
        """Return the configuration on the curve along a normal, by secants."""
        if q is None:
            return None
        x, f = 0.0, self.value(q)
        there: Array | None = q
        for _ in range(10):
            if abs(f) <= ON_CURVE:
                return there
            step = -f / slope
            if not abs(step) < LARGEST_STEP:
                return None
            x += step
            there, last = self.section.moved(q, x * normal), f
            if there is None:
                return None
            f = self.value(there)
            if f != last and abs(f) > ON_CURVE:
                slope = (f - last) / step
        return there if abs(f) <= 1e3 * ON_CURVE else None

    def beginning(self, q: Array) -> LocusPoint | None:
        """Return the point of the curve near a configuration."""
        spot: LocusPoint | None = self.spot(q, None)
        for _ in range(6):
            if spot is None:
                return None
            there = self.settled(spot.q, spot.normal, spot.slope)
            if there is None:  # far off: half of the way first
                step = -0.5 * self.value(spot.q) / spot.slope
                there = self.section.moved(spot.q, np.clip(step, -0.1, 0.1) * spot.normal)
                spot = None if there is None else self.spot(there, None)
                continue
            point = self.spot(there, None)
            return None if point is None else self._inside(point)
        return None

    def _inside(self, spot: LocusPoint) -> LocusPoint:
        """Return the point where the curve enters the grid, if a point is slightly outside."""
        margin = self.section.margin
        if margin(spot.q) >= -AT_CORNER:
            return spot
        for sign in (1.0, -1.0):
            directed = spot._replace(t=sign * spot.t, dy=sign * spot.dy)
            q = self.at(directed, FIRST_LOCUS_STEP)
            if q is not None and margin(q) > 0.0:
                back = directed._replace(q=q, t=-directed.t)
                q = self.at(back, _root(self, back, margin, FIRST_LOCUS_STEP))
                return (None if q is None else self.spot(q, None)) or spot
        return spot

    def at(self, spot: LocusPoint, length: float) -> Array | None:
        """Return the configuration on the curve at an arc length from a point."""
        self.border = spot.border
        return self.settled(self.section.moved(spot.q, length * spot.t), spot.normal, spot.slope)


def walk(locus: Locus, start: LocusPoint) -> LocusTrace:
    """Follow a curve from a point along its tangent."""
    spots, length = [start], FIRST_LOCUS_STEP
    while len(spots) < MOST_POINTS:
        spot = spots[-1]
        locus.section.evaluation.angle_reference[:] = spot.angles
        there, length = _ahead(locus, spot, length)
        if there is None:
            return LocusTrace(spots, "lost")
        taken = float((pin.difference(locus.section.evaluation.model, spot.q, there.q)
                       / locus.section.scale) @ spot.t)
        stop = _stop(locus, spot, there, taken)
        if stop is not None:
            end, last = stop
            return LocusTrace(spots if last is None else [*spots, last], end)
        # whether it passes where the curve was begun; joints may have turned wholly round
        chord, from_here = there.y - spot.y, start.y - spot.y
        size = float(np.linalg.norm(chord))
        along = float(from_here @ chord) / max(size, TOLERANCES.nothing)
        off = float(np.linalg.norm(from_here - along * chord / max(size, TOLERANCES.nothing)))
        if len(spots) > 2 and 0.0 < along <= size and off < 0.1 * size and start.dy @ chord > 0.0:
            return LocusTrace([*spots, start], "closed")
        spots.append(there)
        bend = max(_bend(spot, there), TOLERANCES.nothing * locus.tolerance)
        part = float(np.clip(0.9 * np.sqrt(locus.tolerance / bend), 0.3, 2.0))
        length = min(length * part, LARGEST_STEP)  # the bend goes as its square
    return LocusTrace(spots, "lost")


def _ahead(locus: Locus, spot: LocusPoint, length: float) -> tuple[LocusPoint | None, float]:
    """Return the next point, and the length of the step."""
    while length >= SMALLEST_STEP:
        q = locus.at(spot, length)
        there = None if q is None else locus.spot(q, spot.t)
        if (there is not None and there.t @ spot.t > ALONG
                and _bend(spot, there) <= locus.tolerance):
            return there, length
        if q is not None and there is None:  # curves cross: a little further
            q = locus.at(spot, 1.1 * length)
            there = None if q is None else locus.spot(q, spot.t)
            if there is not None and there.t @ spot.t > ALONG:
                return there, 1.1 * length
        length *= 0.5
    return None, length


def _bend(spot: LocusPoint, there: LocusPoint) -> float:
    """Return the largest distance of a curve from its chord, nearly.

    The height of an arc whose tangents make an angle a with its chord is a/4 of its length.
    """
    chord = there.y - spot.y
    length = float(np.linalg.norm(chord))
    out = 0.0
    for tangent in (spot.dy, there.dy):
        size = float(np.linalg.norm(tangent))
        if length and size:
            across = tangent / size - chord * float(tangent @ chord) / (size * length * length)
            out = max(out, 0.25 * length * float(np.linalg.norm(across)))
    return out


def _stop(
    locus: Locus, spot: LocusPoint, there: LocusPoint, length: float
) -> tuple[str, LocusPoint | None] | None:
    """Return the reason why a curve ends within a step, and the point there (None: the start)."""
    stops = [(_root(locus, spot, function, length), why)
             for why, function in _ends(locus, spot, there)]
    if not stops:
        return None
    at, why = min(stops)
    q = locus.at(spot, at) if at > 0.0 else None
    if why in (LIMIT, CORNER) and q is not None and locus.section.is_branch_point(q):
        why, q = CROSSING, locus.at(spot, (1.0 - CURVE_END_MARGIN) * at)
    return why, None if q is None else locus.spot(q, spot.t)


def _ends(
    locus: Locus, spot: LocusPoint, there: LocusPoint
) -> Iterator[tuple[str, Callable[[Array], float]]]:
    """Yield reasons whose functions become negative within a step, with the functions."""
    s = locus.section

    def room(limit: JointLimit) -> Callable[[Array], float]:
        return lambda q: float(limit.room(q)) / limit.size

    def turned(q: Array, sign: float = 0.0) -> float:
        motions = aligned(s.motions(q), spot.motions)
        a = locus.bordered(motions) if locus.why == LIMIT else s.matrix(LIMIT, motions)
        return (sign or before) * float(np.linalg.det(a))

    if s.margin(there.q) < -AT_CORNER:
        yield RANGE, s.margin
    for words, limit in s.limits.items():
        if words != locus.why and room(limit)(there.q) < -AT_CORNER:
            yield words, room(limit)
    locus.border = spot.border
    before = float(np.sign(turned(spot.q, 1.0)))
    if turned(there.q) < 0.0:
        yield CORNER if locus.why == LIMIT else LIMIT, turned


def _root(
    locus: Locus, spot: LocusPoint, function: Callable[[Array], float], length: float
) -> float:
    """Return the length in a step at which a function falls through zero; 0 if it begins there."""
    def value(x: float) -> float:
        q = locus.at(spot, x) if x else spot.q
        return np.nan if q is None else function(q)

    before, after = value(0.0), value(length)
    if not before > AT_CORNER or not after < 0.0:
        return 0.0
    return sign_change(value, 0.0, length, before, after)
