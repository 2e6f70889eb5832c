"""Where over a motion two links are nearest to each other, and where they touch.

Between samples a distance cannot fall by more than half of what the links travel there: an interval
is looked into as far as that leaves it open whether it holds the least distance, or a touch.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.motion.motion import first_samples
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.roots import sign_change
from spatial_pin.proximity.between import Between
from spatial_pin.proximity.distances import Distances, Nearest

# How much longer a way is than the chord between its ends, at most: an arc of 90 degrees is 11 %.
CURVED = 1.25
# Parts of the way to the next sample of which each is taken as straight and even: links that start
# from rest are at its end nearly twice as fast as on the mean, on a fourth no faster than CURVED.
EVEN_PARTS = 4
WHOLE_TURN = 2.0 * np.pi  # of all joints together: for each there are so many parts
# Way of two links, relative to the characteristic length, that is not looked into any more: what
# comes and goes on half of it may be missed, a body thinner than that; and each configuration of a
# pair costs a tenth of a millisecond, of links that slide side by side over the whole motion.
CERTAIN = 5e-3
# Distances of solids are known to this, relative to the characteristic length: what is nearer to
# touching than that touches, so that parts made to slide on each other do so all the way.
PLACE_ERROR = 1e-8
NEAREST = 1e-5  # part of an interval to which a least distance is searched: it changes by 1e-10
# Part of what is known of distances within which the first place counts as the least.
ONE_PLACE = 1e-4
# Joints that go no farther to the next sample [rad, characteristic lengths] go as polynomials say.
FAIRLY_FAR = 0.1
# How far polynomials may be from configurations with closed loops, relative to CERTAIN, to stand
# for them while places are searched.
STRAY = 0.05
INWARD = 1e-3  # part of an interval at whose end it is seen whether a distance falls into it
VALLEYS = 2  # places, the nearest of those known, beside which it is searched


class Place(NamedTuple):
    """A place on a motion: a part, 0 to 1, of the way from a sample to the next."""

    row: int
    part: float


class Found(NamedTuple):
    """What a search has found of a pair of links.

    Attributes:
        at: where they are nearest.
        nearest: how near, there.
        contacts: first and last place of each part of the motion on which they touch.
    """

    at: Place
    nearest: Nearest
    contacts: tuple[tuple[Place, Place], ...]


class Search:
    """Searches a motion, pair of links by pair of links.

    Attributes:
        sampled: (N, pairs) distances at the samples [m].
        points: (N, pairs, 2, 3) where links are nearest to each other there, in the world [m].

    Args:
        distances: of the pairs.
        between: goes from sample to sample.
        touching: distance at which links touch [m].
    """

    def __init__(self, distances: Distances, between: Between, touching: float) -> None:
        self.distances, self.between, self.touching = distances, between, touching
        motion = between.motion
        size = motion.mechanism.characteristic_length
        self.certain, self.known = CERTAIN * size, PLACE_ERROR * size
        self.sampled = np.empty((len(motion), len(distances.pairs)))
        self.points = np.empty((*self.sampled.shape, 2, 3))
        self._travelled: list[Array] = []
        self._rough: set[int] = set()  # samples after which polynomials stray too far
        self._known_places: dict[Place, Array] = {}  # configurations, for all pairs

    def sample(self) -> Iterator[int]:
        """Take the distances of all pairs at all samples, one sample at a time."""
        before = None
        for row, q in enumerate(self.between.motion.q):
            here = self.distances.middles(q)
            for pair, found in enumerate(self.distances.every()):
                self.sampled[row, pair], self.points[row, pair] = found
            if before is not None and self.sampled.shape[1]:
                if self._strays(row - 1):
                    self._rough.add(row - 1)
                self._travelled.append(self._way_to(row, before, here))
            before = here
            yield row

    def _strays(self, row: int) -> bool:
        """Whether bodies stray from where closed loops have them, on the way to the next sample."""
        motion = self.between.motion
        way = pin.difference(motion.mechanism.model, *motion.q[row : row + 2])
        if np.abs(way / motion.mechanism.velocity_scale).max(initial=0.0) <= FAIRLY_FAR:
            return False
        placed = (self.distances.middles(q) for q in (
            self.between.at(row, 0.5), self.between.closed(row, 0.5)))
        strayed = self.distances.travel(*placed).max(initial=0.0)
        return bool(strayed > STRAY * self.certain)

    def _on_way(self, row: int, part: float) -> Array:
        """Return the configuration (nq,) at a place, as good as the search for places needs it."""
        place = Place(row, part)
        if place not in self._known_places:
            go = self.between.closed if row in self._rough else self.between.at
            self._known_places[place] = go(row, part)
        return self._known_places[place]

    def _way_to(self, row: int, before: tuple[Array, Array], here: tuple[Array, Array]) -> Array:
        """Return how far links have come towards each other at even parts of the way to a sample.

        Returns:
            (parts + 1, pairs).
        """
        parts = EVEN_PARTS * max(1, int(np.ceil(self.between.turned(row - 1) / WHOLE_TURN)))
        way: list[Array] = []
        for k in range(1, parts + 1):
            there = here if k == parts else self.distances.middles(
                self._on_way(row - 1, k / parts))
            way.append(self.distances.approach(before, there))
            before = there
        return np.cumsum([np.zeros(self.sampled.shape[1]), *way], axis=0)

    def cut(self, n: int) -> Search:
        """Return a search of the first samples alone, which were taken."""
        own = Search(self.distances, Between(first_samples(self.between.motion, n)), self.touching)
        own.sampled, own.points = self.sampled[:n], self.points[:n]
        return own

    def at_samples(self, pair: int) -> Found:
        """Return what the samples alone tell of a pair."""
        apart = self.sampled[:, pair]
        row = int(np.argmin(apart))
        touching = np.concatenate([[False], apart - self.touching <= self.known, [False]])
        ends = np.flatnonzero(np.diff(touching.astype(int)))
        contacts = tuple((Place(int(first), 0.0), Place(int(last) - 1, 0.0))
                         for first, last in zip(ends[::2], ends[1::2], strict=True))
        return Found(Place(row, 0.0), Nearest(float(apart[row]), self.points[row, pair]), contacts)

    def found(self, pair: int) -> Found:
        """Return what there is of a pair, the samples taken."""
        known = {Place(row, 0.0): x for row, x in enumerate(self.sampled[:, pair].tolist())}
        self._look_into(pair, known)
        at = self._polished(pair, known)
        return Found(at, self._nearest(pair, at), tuple(self._contacts(pair, known)))

    def _nearest(self, pair: int, place: Place, closed: bool = True) -> Nearest:
        row, part = place
        if part == 0.0:
            q = self.between.motion.q[row]
        else:
            q = (self.between.closed if closed else self._on_way)(row, part)
        self.distances.place(q)
        return self.distances.least(pair)

    def _look_into(self, pair: int, known: dict[Place, float]) -> None:
        """Add distances between samples, until none can hide what was asked for."""
        least = min(known.values())
        for row, travelled in enumerate(self._travelled):
            come = CURVED * travelled[:, pair]
            places = np.linspace(0.0, 1.0, len(come))
            left = [(0.0, 1.0, known[Place(row, 0.0)], known[Place(row + 1, 0.0)])]
            while left:
                first, last, before, after = left.pop()
                way = float(np.subtract(*np.interp((last, first), places, come)))
                bound = 0.5 * (before + after - way)  # with nothing between nearer than that
                if not self._may_hide(before, after, bound, least) or way < self.certain:
                    continue
                middle = 0.5 * (first + last)
                there = self._nearest(pair, Place(row, middle), closed=False).distance
                known[Place(row, middle)] = there
                least = min(least, there)
                left += [(first, middle, before, there), (middle, last, there, after)]

    def _may_hide(self, before: float, after: float, bound: float, least: float) -> bool:
        """Whether an interval may hold the least distance, or a touch that its ends do not show."""
        if bound < least - self.certain:
            return True
        touches = self.touching + self.known
        return before > touches and after > touches and bound < touches - self.certain

    def _polished(self, pair: int, known: dict[Place, float]) -> Place:
        """Return the place of the least distance, beside the least of those known."""
        from scipy.optimize import minimize_scalar

        places = sorted(known)
        for k in sorted(range(len(places)), key=lambda k: known[places[k]])[:VALLEYS]:
            here = known[places[k]] = self._nearest(pair, places[k]).distance
            for row, first, last in _beside(places, k):
                end, other = (first, last) if (row, first) == places[k] else (last, first)
                inside = Place(row, end + INWARD * (other - end))
                if self._nearest(pair, inside).distance >= here:
                    continue
                found = minimize_scalar(
                    lambda part, row=row: self._nearest(pair, Place(row, part)).distance,
                    bounds=(first, last), method="bounded", options={"xatol": NEAREST})
                known[Place(row, float(found.x))] = float(found.fun)
        least = min(known.values()) + ONE_PLACE * self.known
        return min(place for place, distance in known.items() if distance <= least)

    def _contacts(self, pair: int, known: dict[Place, float]) -> Iterator[tuple[Place, Place]]:
        """Yield the first and last place of each part of the motion on which links touch."""
        places = sorted(known)
        begun: Place | None = None
        for before, here in zip([None, *places], places, strict=False):
            touches = known[here] - self.touching <= self.known
            if touches and begun is None:
                begun = here if before is None else self._change(pair, before, here, known)
            elif not touches and begun is not None and before is not None:
                yield begun, self._change(pair, before, here, known)
                begun = None
        if begun is not None:
            yield begun, places[-1]

    def _change(self, pair: int, a: Place, b: Place, known: dict[Place, float]) -> Place:
        """Return where links begin or cease to touch between two places beside each other."""
        row, first = a
        last = b.part if b.row == row else 1.0
        # where they only come near enough to touch, not nearer, that is where
        level = self.touching
        if min(known[a], known[b]) > level - self.known:
            level += self.known

        def excess(part: float) -> float:
            place = Place(row, part) if part < 1.0 else Place(row + 1, 0.0)
            return self._nearest(pair, place).distance - level

        ends = excess(first), excess(last)
        if ends[0] * ends[1] > 0.0:  # by the round-off of configurations that were closed
            return min((a, b), key=lambda place: abs(known[place] - level))
        part = sign_change(excess, first, last, *ends)
        return Place(row, part) if part < 1.0 else Place(row + 1, 0.0)


def _beside(places: list[Place], k: int) -> Iterator[tuple[int, float, float]]:
    """Yield (sample, first part, last part) of the intervals on both sides of a place."""
    if k > 0:
        row, first = places[k - 1]
        yield row, first, places[k].part if places[k].row == row else 1.0
    if k + 1 < len(places):
        row, first = places[k]
        yield row, first, places[k + 1].part if places[k + 1].row == row else 1.0


