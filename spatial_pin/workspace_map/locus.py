"""Following a curve on a section of a grid: a branch ends on it, or a determinant vanishes.

On the closed configurations over a section of the grid, a surface, a curve is where a function
vanishes: the room of a joint before its limit, or the last number g of the bordered system

    [A  b] [v]   [0]
    [c  0] [g] = [1]

whose square matrix A loses its rank there [Govaerts2000]: A takes the motions of the mechanism to
the coordinates of the grid (limit positions) or to what is asked of the frame (a determinant that
vanishes). With b and c the singular vectors at the last point, g is about A's least singular value,
with a sign. It does not matter which basis of the motions A is written in. Curves are followed by
pseudo-arclength on the surface, where limit positions are no special places.
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
from spatial_pin.motion.joint_limit_events import KIND as JOINT_LIMIT
from spatial_pin.numerics.linalg import Array, aligned, decompose
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.workspace_map.dexterity import TASKS, FrameTask
from spatial_pin.workspace_map.grid_lines import GridConfig

LIMIT = "limit"
CURVE_ENDS_BESIDE = 1e-4  # part of a step, or rank: so near to a branch point a curve ends


class Section:
    """The surface of closed configurations over a section of a grid.

    Attributes:
        evaluation: the closure equations.
        limits: joint limits that are kept, by words.
        free: numbers of the two coordinates of the grid that span the section.
    """

    def __init__(
        self, asked: GridConfig, task: FrameTask, evaluation: LoopEquations, free: tuple[int, int],
        spans: Array,
    ) -> None:
        mechanism = asked.mechanism
        self.asked, self.task, self.evaluation, self.free = asked, task, evaluation, free
        self.limits: dict[str, JointLimit] = {
            f"{JOINT_LIMIT}: {x.words}": x for x in
            (joint_limits(mechanism) if asked.limits else [])}
        own = [mechanism.prescribed_coordinate(name) for name in asked.names]
        moved = asked.moving
        others = ([mechanism.coordinate_table[name] for name in asked.standing] if asked.is_posed
                  else [c for c in moved if c.v not in [x.v for x in own]])
        held = held_by(mechanism, asked.hold, [*own, *others])
        for c in (*own, *others, *held.coordinates):
            if c.q < 0:
                raise SpatialPinError(f"{c.name!r} is a component of a joint that turns in space: "
                                      "no curves are followed in a section along it")
        self.grid = [*own, *others]
        self.scale = mechanism.velocity_scale
        self._sizes = self.scale[[c.v for c in own]]
        self.low, self.high = spans.T / self._sizes
        self._moved = [c.v for c in moved]
        self._frame = mechanism.frame_id(mechanism.placed(asked.frame))
        self._rows = np.array([scaled_row(mechanism, c, evaluation.q) for c in self.grid])
        self._loose = np.ones(len(self.scale), dtype=bool)
        self._loose[list(held.entries)] = False
        self._moves = self._loose.copy()  # while loops close, those that do not change stand
        self._moves[[c.v for i, c in enumerate(self.grid) if i not in free]] = False

    def motions(self, q: Array) -> Array:
        """Return orthonormal motions (m, nv), as many as coordinates give."""
        self.evaluation.update(q)
        svd = decompose(self.evaluation.jacobian[:, self._loose])
        found = np.zeros((len(self.grid), len(self.scale)))
        found[:, self._loose] = svd.vt[len(svd.vt) - len(self.grid) :]
        return found

    def is_branch_point(self, q: Array) -> bool:
        """Whether the loops' equations have lost their rank."""
        self.evaluation.update(q)
        s = decompose(self.evaluation.jacobian[:, self._loose], 0.0).s
        return bool(s[int(self._loose.sum()) - len(self.grid) - 1] < CURVE_ENDS_BESIDE * s[0])

    def matrix(self, why: str, motions: Array) -> Array:
        """Return the square matrix that loses its rank on a curve, where the equations stand."""
        if why == LIMIT:
            return self._rows @ motions.T
        if self.asked.is_posed:
            return motions[:, self._moved].T
        size = self.asked.mechanism.characteristic_length
        rows = self.evaluation.frame_jacobian(self._frame) * self.scale
        rows[:3] /= size
        return self.task.directions @ rows[TASKS[self.task.name]] @ motions.T

    def plane(self, motions: Array) -> Array:
        """Return two orthonormal motions (2, nv), those of the section."""
        fixed = [row for i, row in enumerate(self._rows) if i not in self.free]
        if not fixed:
            return motions
        return decompose(np.array(fixed) @ motions.T, 0.0).vt[len(fixed) :] @ motions

    def moved(self, q: Array, step: Array) -> Array | None:
        """Return the configuration a step (nv,) away, loops closed; None where they stay open."""
        there = pin.integrate(self.evaluation.model, q, self.scale * step)
        there, error = close(self.evaluation, there, self._moves, TOLERANCES.round_off)
        return there if error <= TOLERANCES.closed and not self.evaluation.mirrored() else None

    def values(self, q: Array) -> Array:
        """Return the grid's coordinates (k,) in natural units."""
        return q[[c.q for c in self.grid[: len(self._sizes)]]] / self._sizes

    def margin(self, q: Array) -> float:
        """Return how far it is from the ends of the section's ranges, in natural units."""
        free = list(self.free)
        values = self.values(q)[free]
        return float(min((values - self.low[free]).min(), (self.high[free] - values).min()))

    def seen(self, q: Array, t: Array) -> tuple[Array, Array]:
        """Return coordinates and point (k + 3,) in natural units, and their change along t."""
        size = self.asked.mechanism.characteristic_length
        self.evaluation.update(q)
        rows = self.evaluation.frame_jacobian(self._frame)[:3] * self.scale / size
        k = len(self._sizes)
        return (np.concatenate([self.values(q),
                                self.evaluation.frame(self._frame).translation / size]),
                np.concatenate([self._rows[:k] @ t, rows @ t]))

    def plain(self, y: Array) -> tuple[Array, Array]:
        """Return coordinates (m, k) and points (m, 3) of the world in their own units."""
        k = len(self._sizes)
        mechanism = self.asked.mechanism
        return (y[:, :k] * self._sizes,
                y[:, k:] * mechanism.characteristic_length + mechanism.centre)


RANGE = "range"  # where a curve leaves the grid
CORNER = "corner"  # where two limit positions meet: beyond it is another sheet
CROSSING = "branch point"  # where loops lose their rank
ON_CURVE = 1e-12  # of the function, in natural units, at a point of a curve
SMALL_MOVE = 1e-5  # rad, lengths: central differences of g are good to its square
FIRST_LOCUS_STEP, LARGEST_STEP, SMALLEST_STEP = 0.01, 0.1, 1e-7  # rad, characteristic lengths
ALONG = 0.95  # least cosine between the directions at both ends of a step: 18 degrees
MOST_POINTS = 20_000  # of a curve
LEVEL = 1e-9  # slope of a function, in natural units, that gives no direction
AT_CORNER = 1e-10  # rad, lengths: a corner is known to that


class LocusPoint(NamedTuple):
    """A point of a curve."""

    q: Array  # the configuration
    angles: Array
    t: Array  # (nv,) directions along the curve, and across it on the surface, in scaled velocities
    normal: Array
    slope: float  # of the function along the normal
    motions: Array  # (m, nv) of the mechanism there
    # (m,) and (nv,) what borders the matrix there; None on a joint limit
    border: tuple[Array, Array] | None
    y: Array  # (k + 3,) coordinates of the grid and point of the frame, in natural units
    dy: Array  # (k + 3,) how they change along the curve


class LocusTrace(NamedTuple):
    """What was walked along a curve."""

    spots: list[LocusPoint]  # at least the first one
    # why it goes no further: a limit's words, `LIMIT`, `RANGE`, `CORNER`, `CROSSING`, "closed" or
    # "lost"
    end: str


class Locus:
    """A curve on a section, as it is followed.

    Args:
        section: the surface.
        why: what it is: `LIMIT`, `SINGULAR` or a joint limit in words.
        tolerance: of the polyline [rad, characteristic lengths].
    """

    def __init__(self, section: Section, why: str, tolerance: float) -> None:
        self.section, self.why, self.tolerance = section, why, tolerance
        self._limit = section.limits.get(why)
        self.border: tuple[Array, Array] | None = None

    def value(self, q: Array) -> float:
        """Return the function that vanishes on it."""
        if self._limit is not None:
            return float(self._limit.room(q)) / self._limit.size
        whole = self.bordered(self.section.motions(q))
        right = np.zeros(len(whole))
        right[-1] = 1.0
        return float(np.linalg.solve(whole, right)[-1])

    def bordered(self, motions: Array) -> Array:
        """Return the bordered matrix (m + 1, m + 1) where the equations stand."""
        assert self.border is not None
        b, c = self.border
        return np.block([[self.section.matrix(self.why, motions), b[:, None]],
                         [(motions @ c)[None], np.zeros((1, 1))]])

    def spot(self, q: Array, along: Array | None) -> LocusPoint | None:
        """Return the point at q, directed as `along`; None where it has no direction."""
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
            ends = [[s.moved(q, sign * SMALL_MOVE * way) for sign in (1, -1)] for way in plane]
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
        """Return the configuration on the curve that is reached along a normal, by secants."""
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
                way = -0.5 * self.value(spot.q) / spot.slope
                there = self.section.moved(spot.q, np.clip(way, -0.1, 0.1) * spot.normal)
                spot = None if there is None else self.spot(there, None)
                continue
            found = self.spot(there, None)
            return None if found is None else self._inside(found)
        return None

    def _inside(self, spot: LocusPoint) -> LocusPoint:
        """Return the point where the grid begins, of one that lies a little beyond it."""
        margin = self.section.margin
        if margin(spot.q) >= -AT_CORNER:
            return spot
        for sign in (1.0, -1.0):
            way = spot._replace(t=sign * spot.t, dy=sign * spot.dy)
            q = self.at(way, FIRST_LOCUS_STEP)
            if q is not None and margin(q) > 0.0:
                back = way._replace(q=q, t=-way.t)
                q = self.at(back, _root(self, back, margin, FIRST_LOCUS_STEP))
                return (None if q is None else self.spot(q, None)) or spot
        return spot

    def at(self, spot: LocusPoint, length: float) -> Array | None:
        """Return the configuration on the curve ahead of a point."""
        self.border = spot.border
        return self.settled(self.section.moved(spot.q, length * spot.t), spot.normal, spot.slope)


def walk(locus: Locus, start: LocusPoint) -> LocusTrace:
    """Follow a curve from a point on, along its direction."""
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
        chord, way = there.y - spot.y, start.y - spot.y
        size = float(np.linalg.norm(chord))
        along = float(way @ chord) / max(size, TOLERANCES.nothing)
        off = float(np.linalg.norm(way - along * chord / max(size, TOLERANCES.nothing)))
        if len(spots) > 2 and 0.0 < along <= size and off < 0.1 * size and start.dy @ chord > 0.0:
            return LocusTrace([*spots, start], "closed")
        spots.append(there)
        bend = max(_bend(spot, there), TOLERANCES.nothing * locus.tolerance)
        part = float(np.clip(0.9 * np.sqrt(locus.tolerance / bend), 0.3, 2.0))
        length = min(length * part, LARGEST_STEP)  # the bend goes as its square
    return LocusTrace(spots, "lost")


def _ahead(locus: Locus, spot: LocusPoint, length: float) -> tuple[LocusPoint | None, float]:
    """Return the next point, and how long the step to it is."""
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
    """Return how far a curve goes from the straight piece between two points, nearly.

    An arc whose tangents make an angle a with its chord goes from it by a quarter of a times the
    chord's length.
    """
    chord = there.y - spot.y
    length = float(np.linalg.norm(chord))
    out = 0.0
    for way in (spot.dy, there.dy):
        size = float(np.linalg.norm(way))
        if length and size:
            across = way / size - chord * float(way @ chord) / (size * length * length)
            out = max(out, 0.25 * length * float(np.linalg.norm(across)))
    return out


def _stop(
    locus: Locus, spot: LocusPoint, there: LocusPoint, length: float
) -> tuple[str, LocusPoint | None] | None:
    """Return what ends a curve within a step, and the point there (None: where the step begins)."""
    found = [(_root(locus, spot, function, length), why)
             for why, function in _ends(locus, spot, there)]
    if not found:
        return None
    at, why = min(found)
    q = locus.at(spot, at) if at > 0.0 else None
    if why in (LIMIT, CORNER) and q is not None and locus.section.is_branch_point(q):
        why, q = CROSSING, locus.at(spot, (1.0 - CURVE_ENDS_BESIDE) * at)
    return why, None if q is None else locus.spot(q, spot.t)


def _ends(
    locus: Locus, spot: LocusPoint, there: LocusPoint
) -> Iterator[tuple[str, Callable[[Array], float]]]:
    """Yield what becomes negative within a step: words, and function of the configuration."""
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
    """Return where on a step a function falls through zero; zero where it begins there."""
    def value(x: float) -> float:
        q = locus.at(spot, x) if x else spot.q
        return np.nan if q is None else function(q)

    before, after = value(0.0), value(length)
    if not before > AT_CORNER or not after < 0.0:
        return 0.0
    return sign_change(value, 0.0, length, before, after)
