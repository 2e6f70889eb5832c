"""Distances between links at a configuration, by coal: signed, with the nearest points."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import combinations, product
from typing import NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.trees import tree_of
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.proximity.solids import SUPPORTS, ConvexSolid, solids_of

GJK_STEPS = 1000  # for coal's algorithms, which end long before by their tolerances
# Tolerances [m] for separate and for overlapping solids, tried in turn: of 2000 overlapping pairs
# six were wrong at 1e-8 and fifteen at 1e-6, not the same; finer ones are worse. The extents of the
# solids along the normal show which is right.
TOLERANCES = ((1e-12, 1e-8), (1e-12, 1e-6), (1e-6, 1e-6))
# difference of a distance from that along the normal, relative to the size of the solids: ten times
# the coarsest tolerance
ALIKE = 1e-5
PARALLEL = 1e-12  # squared sine of the angle between parallel segments
LOWERED = 4e-6  # reduction of bounds for that, relative to the solids: four times its root


def _around(n: int) -> Array:
    """Return n directions evenly around, on a spiral."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (1.0 + 5.0**0.5) * np.arange(n)
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])


AROUND = _around(100)
WIDE_GAP = 0.2  # angle between such directions [rad]


class Nearest(NamedTuple):
    """The distance of two links."""

    distance: float  # below zero the depth of overlap [m]
    points: Array  # (2, 3) nearest points of both, in the world [m]


NOWHERE = Nearest(np.inf, np.full((2, 3), np.nan))


class Distances:
    """The distances between links of a mechanism.

    Attributes:
        pairs: names of two links each.
        joined: names of two joined links each, which are left out.

    Args:
        mechanism: the mechanism.
        pairs: pairs of links; None for all that have solids and are not joined. Links are joined if
            they are fixed to each other, by a pair of the tree, a closure (but a distance, which is
            a rod between them) or a coupling, or by a link without solids.

    Raises:
        UnknownNameError: there is no such link.
        SpatialPinError: a link has no solids, or two are fixed to each other.
    """

    def __init__(
        self, mechanism: Mechanism, pairs: Sequence[tuple[str, str]] | None = None
    ) -> None:
        self.mechanism = mechanism
        self.solids = solids_of(mechanism)
        self._tree = tree_of(mechanism.model)
        self._of: dict[str, list[int]] = defaultdict(list)
        for k, solid in enumerate(self.solids):
            self._of[solid.link].append(k)
        self.joined: tuple[tuple[str, str], ...] = ()
        if pairs is not None:
            own = {name: self._joint(name) for name in self._of}
            self.pairs = tuple(_checked(mechanism, own, pair) for pair in pairs)
        else:
            joined = joined_bodies(mechanism, {s.joint for s in self.solids})
            bodies = {(a, b): frozenset((self._joint(a), self._joint(b)))
                      for a, b in combinations(self._of, 2)}
            self.joined = tuple(names for names, two in bodies.items() if two in joined)
            self.pairs = tuple(names for names, two in bodies.items()
                               if len(two) == 2 and two not in joined)
        self._parts = [np.array(list(product(self._of[a], self._of[b]))).T for a, b in self.pairs]
        self._centres = np.array([s.centre for s in self.solids]).reshape(-1, 3)
        self._radii = np.array([s.radius for s in self.solids])
        self._joints = np.array([s.joint for s in self.solids], dtype=int)
        self._own_halves = np.array([s.half for s in self.solids]).reshape(-1, 3)
        self._thickness = np.array([s.thickness for s in self.solids])
        # of each link of a pair its first solid, and how far it reaches about that one's centre
        self._leading = np.array([[self._of[name][0] for name in names] for names in self.pairs],
                                 dtype=int).reshape(-1, 2)
        self._reach = np.zeros(len(self.solids))
        for some in self._of.values():
            away = np.linalg.norm(self._centres[some] - self._centres[some[0]], axis=1)
            self._reach[some[0]] = float((away + self._radii[some]).max())

    def _joint(self, link: str) -> int:
        return self.solids[self._of[link][0]].joint

    def update(self, q: Array) -> None:
        """Move to a configuration (nq,)."""
        self._tree.update(q)
        placements = self._tree.placements[self._joints]
        self._rotations = placements[:, :3].transpose(0, 2, 1)
        self._origins = placements[:, 3]
        self._middles = self._origins + np.einsum("kij,kj->ki", self._rotations, self._centres)
        self._halves = np.einsum("kij,kj->ki", self._rotations, self._own_halves)
        self._frames: dict[int, coal.Transform3s] = {}

    def middles(self, q: Array) -> tuple[Array, Array]:
        """Return centres (n, 3) and rotations (n, 3, 3) of all solids at a configuration."""
        self.update(q)
        return self._middles, self._rotations

    def travel(self, before: tuple[Array, Array], after: tuple[Array, Array]) -> Array:
        """Return the largest straight displacement of points of solids between two `middles`."""
        moved = np.linalg.norm(after[0] - before[0], axis=1)
        return moved + 2.0 * _half_sine(before[1], after[1]) * self._radii

    def approach(self, before: tuple[Array, Array], after: tuple[Array, Array]) -> Array:
        """Return the largest straight approach of two links (pairs,) between two `middles`.

        Relative to either link, or in the world: for links that move together it is small.
        """
        alone = self.travel(before, after)
        own, other = self._leading.T
        first, second = (np.array([alone[self._of[name]].max() for name in names])
                         for names in zip(*self.pairs, strict=True))
        (seen, back, turn), (seen_then, back_then, turn_then) = (
            self._seen(middles, rotations) for middles, rotations in (before, after))
        swing = 2.0 * _half_sine(turn, turn_then)
        return np.min([
            first + second,
            np.linalg.norm(seen_then - seen, axis=1) + swing * self._reach[other],
            np.linalg.norm(back_then - back, axis=1) + swing * self._reach[own]], axis=0)

    def _seen(self, middles: Array, rotations: Array) -> tuple[Array, Array, Array]:
        """Return positions of second links relative to the first, the reverse, and rotations."""
        own, other = self._leading.T
        between, turned = middles[other] - middles[own], rotations[own].transpose(0, 2, 1)
        return (np.einsum("kij,kj->ki", turned, between),
                np.einsum("kji,kj->ki", rotations[other], between), turned @ rotations[other])

    def least(self, pair: int) -> Nearest:
        """Return the distance of a pair of links, at the last `update`."""
        first, second = self._parts[pair]
        return self._least(first, second, self._apart(first, second))

    def every(self) -> list[Nearest]:
        """Return the distances of all pairs of links, at the last `update`."""
        if not self.pairs:
            return []
        firsts, seconds = np.concatenate(self._parts, axis=1)
        ends = np.cumsum([parts.shape[1] for parts in self._parts[:-1]])
        bounds = np.split(self._apart(firsts, seconds), ends)
        return [self._least(first, second, apart)
                for (first, second), apart in zip(self._parts, bounds, strict=True)]

    def _least(self, first: NDArray[np.intp], second: NDArray[np.intp], apart: Array) -> Nearest:
        """Return the nearest of pairs of solids with lower bounds `apart` (n,)."""
        best = NOWHERE
        for k in np.argsort(apart):
            if apart[k] >= best.distance:
                break
            i, j = int(first[k]), int(second[k])
            candidate = nearest(self.solids[i], self._frame(i), self.solids[j], self._frame(j))
            if candidate.distance < best.distance:
                best = candidate
        return best

    def _apart(self, first: NDArray[np.intp], second: NDArray[np.intp]) -> Array:
        """Return lower bounds of the distances of pairs of solids (n,) at the last update [m]."""
        between = self._middles[first] - self._middles[second]
        radii = self._radii[first] + self._radii[second]
        spheres = np.sqrt(np.einsum("ki,ki->k", between, between)) - radii
        rods = (segments_apart(between, self._halves[first], self._halves[second])
                - self._thickness[first] - self._thickness[second])
        return np.maximum(spheres, rods) - LOWERED * radii

    def touching(self, tolerance: float) -> tuple[str, str] | None:
        """Return the first pair of links within a distance, at the last `update`; else None."""
        for pair, (first, second) in enumerate(self._parts):
            apart = self._apart(first, second)
            if apart.min() <= tolerance and (
                    self._least(first, second, apart).distance <= tolerance):
                return self.pairs[pair]
        return None

    def _frame(self, k: int) -> coal.Transform3s:
        if k not in self._frames:
            solid, rotation = self.solids[k], self._rotations[k]
            self._frames[k] = frame = coal.Transform3s()
            frame.setRotation(rotation @ solid.rotation)
            frame.setTranslation(self._origins[k] + rotation @ solid.position)
        return self._frames[k]


def _checked(
    mechanism: Mechanism, bodies: Mapping[str, int], pair: tuple[str, str]
) -> tuple[str, str]:
    """Return names of two links, from those with solids and their joints."""
    where = f"mechanism {mechanism.name!r}: "
    if isinstance(pair, str) or len(pair) != 2:
        raise SpatialPinError(f"{where}a pair is two links, not {pair!r}")
    for name in pair:
        if name not in mechanism.links:
            raise UnknownNameError("link", name, mechanism.links, where)
        if name not in bodies:
            raise SpatialPinError(f"{where}link {name!r} has no <collision> and no <visual>, "
                                  "so that nothing has a distance from it")
    a, b = pair
    if bodies[a] == bodies[b]:
        raise SpatialPinError(f"{where}links {a!r} and {b!r} are fixed to each other: their "
                              "distance does not change")
    return a, b


def _half_sine(before: Array, after: Array) -> Array:
    """Return the sines (n,) of half the angles between rotations (n, 3, 3)."""
    trace = np.einsum("kij,kij->k", before, after)
    return np.sqrt(np.clip(0.25 * (3.0 - trace), 0.0, 1.0))


def segments_apart(between: Array, first: Array, second: Array) -> Array:
    """Return the distances (n,) of pairs of segments.

    `between` (n, 3) are from the middles of the second to those of the first; `first` and `second`
    (n, 3) from the middles to an end. The point of the first that is nearest to the second's line
    is taken, then that of the second, then that of the first again, each within its segment.
    """
    a, b, c, d, e = (np.einsum("ki,ki->k", x, y) for x, y in (
        (first, first), (first, second), (second, second), (first, between), (second, between)))
    square = a * c - b * b  # of the parallelogram between them: zero if they are parallel
    flat = square <= PARALLEL * a * c
    s = np.where(flat, 0.0, b * e - c * d) / np.where(flat, 1.0, square)
    t = (b * np.clip(s, -1.0, 1.0) + e) / np.where(c > 0.0, c, 1.0)
    t = np.clip(t, -1.0, 1.0)
    s = np.clip((b * t - d) / np.where(a > 0.0, a, 1.0), -1.0, 1.0)
    apart = between + s[:, None] * first - t[:, None] * second
    return np.sqrt(np.einsum("ki,ki->k", apart, apart))


def nearest(
    a: ConvexSolid, at_a: coal.Transform3s, b: ConvexSolid, at_b: coal.Transform3s
) -> Nearest:
    """Return the distance of two solids.

    It is the largest of their distances along all directions, also for overlapping ones; the
    direction of the nearest points attains it. That, and other tolerances, detect wrong answers.
    """
    normals = []
    for request in _requests():
        result = coal.DistanceResult()
        distance = float(coal.distance(a.shape, at_a, b.shape, at_b, request, result))
        points = np.array([result.getNearestPoint1(), result.getNearestPoint2()])
        normals.append(result.normal)
        along_normal = float(_apart_along(result.normal[None], a, at_a, b, at_b)[0][0])
        if abs(distance - along_normal) <= ALIKE * (a.radius + b.radius):
            if distance > 0.0:
                return Nearest(distance, points)
            break
    return _deepest(Nearest(distance, points), normals, a, at_a, b, at_b)


def _deepest(
    known: Nearest, normals: Sequence[Array], a: ConvexSolid, at_a: coal.Transform3s,
    b: ConvexSolid, at_b: coal.Transform3s,
) -> Nearest:
    """Return the depth of overlap: the known one, unless another direction gives less.

    The directions are the known ones, the normals of faces and edges, and some all around; the
    search continues from the best of them.
    """
    axes, others = at_a.getRotation().T, at_b.getRotation().T
    across = np.cross(axes[:, None], others[None]).reshape(-1, 3)
    ways = np.concatenate([normals, axes, others, across, -axes, -others, -across, AROUND])
    sizes = np.linalg.norm(ways, axis=1)
    ways = ways[sizes > ALIKE] / sizes[sizes > ALIKE, None]
    best, direction = _along(ways, a, at_a, b, at_b)
    if best.distance <= known.distance + ALIKE * (a.radius + b.radius):
        return known
    turn = WIDE_GAP
    while turn > ALIKE:
        ways = direction + turn * AROUND
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        better, there = _along(ways, a, at_a, b, at_b)
        if better.distance > best.distance:
            best, direction = better, there
        else:
            turn *= 0.5
    return best


@cache
def _requests() -> tuple[coal.DistanceRequest, ...]:
    """Return the requests for coal, in their order."""
    made = []
    for apart, overlap in TOLERANCES:
        request = coal.DistanceRequest()
        request.gjk_tolerance, request.epa_tolerance = apart, overlap
        request.gjk_max_iterations = request.epa_max_iterations = GJK_STEPS
        made.append(request)
    return tuple(made)


def _along(
    ways: Array, a: ConvexSolid, at_a: coal.Transform3s, b: ConvexSolid, at_b: coal.Transform3s
) -> tuple[Nearest, Array]:
    """Return the distance of solids along the best of unit directions (k, 3), and that one."""
    apart, last = _apart_along(ways, a, at_a, b, at_b)
    k = int(apart.argmax())
    return Nearest(float(apart[k]), np.array([last[k], last[k] + apart[k] * ways[k]])), ways[k]


def _apart_along(
    ways: Array, a: ConvexSolid, at_a: coal.Transform3s, b: ConvexSolid, at_b: coal.Transform3s
) -> tuple[Array, Array]:
    """Return distances of solids along directions (k,), and the ends of the first (k, 3)."""
    own, other = at_a.getRotation(), at_b.getRotation()
    last = SUPPORTS[type(a.shape)](a.shape, ways @ own) @ own.T + at_a.getTranslation()
    first = SUPPORTS[type(b.shape)](b.shape, -ways @ other) @ other.T + at_b.getTranslation()
    return np.einsum("ki,ki->k", ways, first - last), last


def joined_bodies(mechanism: Mechanism, solid: set[int]) -> set[frozenset[int]]:
    """Return pairs of joints' bodies that are joined, also through bodies that are not `solid`."""
    joined: dict[int, set[int]] = defaultdict(set)

    def join(i: int, j: int) -> None:
        joined[i].add(j)
        joined[j].add(i)

    model = mechanism.model
    for i in range(1, model.njoints):
        join(i, int(model.parents[i]))
    for c in mechanism.closures:
        coupled = [mechanism.joint_id(mechanism.coordinate(name).joint) for name in c.joints]
        for one, other in combinations(coupled, 2):
            join(one, other)
        if not (c.pair.uses_length or c.pair.has_more) and any(row.is_length for row in c.rows):
            for first, second in c.joined:
                join(mechanism.frame_on_joint(first)[0], mechanism.frame_on_joint(second)[0])
    for i in range(model.njoints):
        if i not in solid:
            for j, k in combinations(joined.pop(i, set()) - {i}, 2):
                join(j, k)
    return {frozenset((i, j)) for i, others in joined.items() for j in others if i != j}
