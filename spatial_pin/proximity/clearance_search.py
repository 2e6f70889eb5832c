"""Where over a motion two links are nearest to each other, and where they touch.

Between samples a distance cannot fall by more than half of what the links travel there: an interval
is looked into as far as that leaves it open whether it holds the least distance, or a touch.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.assemble import assembled
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion, first_samples
from spatial_pin.numerics.hermite import quintic
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.roots import sign_change
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


class Between:
    """Goes from each sample of a motion to the next.

    Joint coordinates follow Hermite's polynomials of fifth degree, through the configurations,
    rates and accelerations of both samples; ball and floating joints those of third degree, in the
    rotation vectors from the first sample. Where a driver was swept, `closed` closes the loops
    there at its value.

    Args:
        motion: of two samples at least, or no way is asked for.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion, self.model = motion, motion.mechanism.model
        self.driver = (motion.mechanism.prescribed_coordinate(motion.driver_name)
                       if motion.driver is not None else None)
        table = motion.mechanism.coordinate_table.values()
        self._is_linear = np.array([c.q >= 0 for c in table], dtype=bool)
        self._turns = np.array([c.unit == "rad" for c in table], dtype=bool)
        self._powers, self._at_first = np.arange(6), np.zeros(self.model.nv)

    def at(self, row: int, part: float) -> Array:
        """Return the configuration (nq,) a part, 0 to 1, of the way from a sample to the next."""
        q0, q1 = self.motion.q[row], self.motion.q[row + 1]
        (slope0, slope1), bends = self._rates(row)
        way = pin.difference(self.model, q0, q1)
        slope1 = pin.dDifference(self.model, q0, q1, pin.ARG1) @ slope1
        u, v = part, 1.0 - part
        cubic = u * u * ((3.0 - 2.0 * u) * way - v * slope1) + u * v * v * slope0
        fifth = part**self._powers @ quintic((self._at_first, way), (slope0, slope1), bends)
        step = np.where(self._is_linear, fifth, cubic)
        return pin.integrate(self.model, q0, step)

    def turned(self, row: int) -> float:
        """Return the angle [rad] that all joints together turn, on the way to the next sample.

        It is that at the mean speed, or the speed at either sample, if that is larger.
        """
        way = pin.difference(self.model, *self.motion.q[row : row + 2])
        most = np.abs([way, *self._rates(row)[0]]).max(axis=0)
        return float(most[self._turns].sum())

    def closed(self, row: int, part: float) -> Array:
        """Return the configuration (nq,) with its loops closed at the driver's value."""
        q = self.at(row, part)
        if self.driver is None or self.motion.per == "length":
            return q
        try:
            state = assembled(self.motion.mechanism, {self.driver.name: self.value(row, part)}, q,
                              release=False)
        except SpatialPinError:  # beside a limit the driver's value may have no configuration
            return q
        return state.q

    def value(self, row: int, part: float) -> float:
        """Return the driver's value [rad or m] there; the time [s] where none was swept."""
        motion = self.motion
        if motion.driver is None:
            given = np.arange(len(motion)) if motion.time is None else motion.time
            return float((1.0 - part) * given[row] + part * given[min(row + 1, len(given) - 1)])
        if part == 0.0 or self._steps_in_time(row) or motion.per == "length":
            value = float(motion.driver[row])
            if part == 0.0 or self.driver is None:
                return value
            moved = pin.difference(self.model, motion.q[row], self.at(row, part))
            return value + float(moved[self.driver.v])
        return float((1.0 - part) * motion.driver[row] + part * motion.driver[row + 1])

    def _steps_in_time(self, row: int) -> bool:
        return self.motion.time is not None and self.motion.driver is not None and bool(
            np.any(self.motion.driver_speed[row : row + 2] != self.motion.driver_speed[row]))

    def _rates(self, row: int) -> tuple[Array, Array]:
        """Return slopes (2, nv) and bends (2, nv) at both samples for a way of length one."""
        motion = self.motion
        v, a = motion.v[row : row + 2], motion.a[row : row + 2]
        if motion.per == "length":
            scale = motion.mechanism.velocity_scale
            h = float(np.linalg.norm(pin.difference(self.model, *motion.q[row : row + 2]) / scale))
        elif motion.driver is None or self._steps_in_time(row):
            # without times rates are those per sample
            h = 1.0 if motion.time is None else float(motion.time[row + 1] - motion.time[row])
        else:
            assert self.driver is not None
            h = float(motion.driver[row + 1] - motion.driver[row])
            speed, gain = v[:, [self.driver.v]], a[:, [self.driver.v]]
            if not np.all(speed):
                return np.repeat(pin.difference(self.model, *motion.q[row : row + 2])[None], 2,
                                 axis=0), np.zeros_like(a)
            v, a = v / speed, (a - v * (gain / speed)) / (speed * speed)
        return h * v, h * h * a


class MotionPlace(NamedTuple):
    """A place on a motion: a part, 0 to 1, of the way from a sample to the next."""

    row: int
    part: float


class PairResult(NamedTuple):
    """What a search has found of a pair of links.

    Attributes:
        at: where they are nearest.
        nearest: how near, there.
        contacts: first and last place of each part of the motion on which they touch.
    """

    at: MotionPlace
    nearest: Nearest
    contacts: tuple[tuple[MotionPlace, MotionPlace], ...]


class ClearanceSearch:
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
        self._known_places: dict[MotionPlace, Array] = {}  # configurations, for all pairs

    def sample(self) -> Iterator[int]:
        """Take the distances of all pairs at all samples, one sample at a time."""
        before = None
        for row, q in enumerate(self.between.motion.q):
            here = self.distances.middles(q)
            for pair, found in enumerate(self.distances.every()):
                self.sampled[row, pair], self.points[row, pair] = found
            if before is not None and self.sampled.shape[1]:
                motion = self.between.motion  # do bodies stray from where closed loops have them?
                way = pin.difference(motion.mechanism.model, *motion.q[row - 1 : row + 1])
                if np.abs(way / motion.mechanism.velocity_scale).max(initial=0.0) > FAIRLY_FAR:
                    strayed = self.distances.travel(*(self.distances.middles(q) for q in (
                        self.between.at(row - 1, 0.5), self.between.closed(row - 1, 0.5))))
                    if strayed.max(initial=0.0) > STRAY * self.certain:
                        self._rough.add(row - 1)
                self._travelled.append(self._way_to(row, before, here))
            before = here
            yield row

    def _on_way(self, row: int, part: float) -> Array:
        """Return the configuration (nq,) at a place, as good as the search for places needs it."""
        place = MotionPlace(row, part)
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

    def cut(self, n: int) -> ClearanceSearch:
        """Return a search of the first samples alone, which were taken."""
        between = Between(first_samples(self.between.motion, n))
        own = ClearanceSearch(self.distances, between, self.touching)
        own.sampled, own.points = self.sampled[:n], self.points[:n]
        return own

    def at_samples(self, pair: int) -> PairResult:
        """Return what the samples alone tell of a pair."""
        apart = self.sampled[:, pair]
        row = int(np.argmin(apart))
        touching = np.concatenate([[False], apart - self.touching <= self.known, [False]])
        ends = np.flatnonzero(np.diff(touching.astype(int)))
        contacts = tuple((MotionPlace(int(first), 0.0), MotionPlace(int(last) - 1, 0.0))
                         for first, last in zip(ends[::2], ends[1::2], strict=True))
        nearest = Nearest(float(apart[row]), self.points[row, pair])
        return PairResult(MotionPlace(row, 0.0), nearest, contacts)

    def found(self, pair: int) -> PairResult:
        """Return what there is of a pair, the samples taken."""
        known = {MotionPlace(row, 0.0): x for row, x in enumerate(self.sampled[:, pair].tolist())}
        self._look_into(pair, known)
        at = self._polished(pair, known)
        return PairResult(at, self._nearest(pair, at), tuple(self._contacts(pair, known)))

    def _nearest(self, pair: int, place: MotionPlace, closed: bool = True) -> Nearest:
        row, part = place
        if part == 0.0:
            q = self.between.motion.q[row]
        else:
            q = (self.between.closed if closed else self._on_way)(row, part)
        self.distances.place(q)
        return self.distances.least(pair)

    def _look_into(self, pair: int, known: dict[MotionPlace, float]) -> None:
        """Add distances between samples, until none can hide what was asked for."""
        least, touches = min(known.values()), self.touching + self.known
        for row, travelled in enumerate(self._travelled):
            come = CURVED * travelled[:, pair]
            places = np.linspace(0.0, 1.0, len(come))
            left = [(0.0, 1.0, known[MotionPlace(row, 0.0)], known[MotionPlace(row + 1, 0.0)])]
            while left:
                first, last, before, after = left.pop()
                way = float(np.subtract(*np.interp((last, first), places, come)))
                bound = 0.5 * (before + after - way)  # with nothing between nearer than that
                shows = min(before, after) <= touches  # its ends show a touch
                may_hide = bound < least - self.certain or (
                    not shows and bound < touches - self.certain)
                if not may_hide or way < self.certain:
                    continue
                middle = 0.5 * (first + last)
                there = self._nearest(pair, MotionPlace(row, middle), closed=False).distance
                known[MotionPlace(row, middle)] = there
                least = min(least, there)
                left += [(first, middle, before, there), (middle, last, there, after)]

    def _polished(self, pair: int, known: dict[MotionPlace, float]) -> MotionPlace:
        """Return the place of the least distance, beside the least of those known."""
        from scipy.optimize import minimize_scalar

        places = sorted(known)
        for k in sorted(range(len(places)), key=lambda k: known[places[k]])[:VALLEYS]:
            here = known[places[k]] = self._nearest(pair, places[k]).distance
            for row, first, last in _beside(places, k):
                end, other = (first, last) if (row, first) == places[k] else (last, first)
                inside = MotionPlace(row, end + INWARD * (other - end))
                if self._nearest(pair, inside).distance >= here:
                    continue
                found = minimize_scalar(
                    lambda part, row=row: self._nearest(pair, MotionPlace(row, part)).distance,
                    bounds=(first, last), method="bounded", options={"xatol": NEAREST})
                known[MotionPlace(row, float(found.x))] = float(found.fun)
        least = min(known.values()) + ONE_PLACE * self.known
        return min(place for place, distance in known.items() if distance <= least)

    def _contacts(
        self, pair: int, known: dict[MotionPlace, float]
    ) -> Iterator[tuple[MotionPlace, MotionPlace]]:
        """Yield the first and last place of each part of the motion on which links touch."""
        places = sorted(known)
        begun: MotionPlace | None = None
        for before, here in zip([None, *places], places, strict=False):
            touches = known[here] - self.touching <= self.known
            if touches and begun is None:
                begun = here if before is None else self._change(pair, before, here, known)
            elif not touches and begun is not None and before is not None:
                yield begun, self._change(pair, before, here, known)
                begun = None
        if begun is not None:
            yield begun, places[-1]

    def _change(
        self, pair: int, a: MotionPlace, b: MotionPlace, known: dict[MotionPlace, float]
    ) -> MotionPlace:
        """Return where links begin or cease to touch between two places beside each other."""
        row, first = a
        last = b.part if b.row == row else 1.0
        # where they only come near enough to touch, not nearer, that is where
        level = self.touching
        if min(known[a], known[b]) > level - self.known:
            level += self.known

        def excess(part: float) -> float:
            place = MotionPlace(row, part) if part < 1.0 else MotionPlace(row + 1, 0.0)
            return self._nearest(pair, place).distance - level

        ends = excess(first), excess(last)
        if ends[0] * ends[1] > 0.0:  # by the round-off of configurations that were closed
            return min((a, b), key=lambda place: abs(known[place] - level))
        part = sign_change(excess, first, last, *ends)
        return MotionPlace(row, part) if part < 1.0 else MotionPlace(row + 1, 0.0)


def _beside(places: list[MotionPlace], k: int) -> Iterator[tuple[int, float, float]]:
    """Yield (sample, first part, last part) of the intervals on both sides of a place."""
    if k > 0:
        row, first = places[k - 1]
        yield row, first, places[k].part if places[k].row == row else 1.0
    if k + 1 < len(places):
        row, first = places[k]
        yield row, first, places[k + 1].part if places[k + 1].row == row else 1.0


