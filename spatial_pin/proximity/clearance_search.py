"""Search of a motion for the least distance of two links, and for contacts.

Between samples a distance falls by at most half of the links' travel. An interval is refined while
it may contain the least distance or a contact.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.assemble import assembled
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion, first_samples
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import quintic
from spatial_pin.numerics.roots import sign_change
from spatial_pin.proximity.distances import Distances, Nearest

CURVED = 1.25  # largest ratio of a path to its chord: an arc of 90 degrees is 11 % longer
# Parts of a step taken as straight and of constant speed: links that start from rest end at nearly
# twice the mean speed, in a quarter at most at CURVED times it.
EVEN_PARTS = 4
WHOLE_TURN = 2.0 * np.pi  # of all joints together: for each there are EVEN_PARTS parts
# Travel of two links that is not refined, relative to the characteristic length: a contact shorter
# than half of it may be missed, by a thinner body. Each configuration of a pair costs 0.1 ms, for
# sliding links over the whole motion.
CERTAIN = 5e-3
# Error of distances relative to the characteristic length: nearer links count as touching, so that
# parts that slide on each other touch all along.
DISTANCE_ERROR = 1e-8
# part of an interval to which the minimum is located: the distance is then exact to 1e-10
NEAREST = 1e-5
# relative to the error of distances: the first point within it counts as the minimum
EQUAL_DISTANCE = 1e-4
# joint step up to which the polynomials are exact enough [rad, characteristic lengths]
FAIRLY_FAR = 0.1
STRAY = 0.05  # largest deviation of the polynomials from closed loops, relative to CERTAIN
INWARD = 1e-3  # part of an interval at whose end the slope of the distance is tested
VALLEYS = 2  # smallest known distances beside which the minimum is searched


class Between:
    """Interpolation of a motion between its samples.

    Joint coordinates follow Hermite's polynomials of fifth degree, from configurations, rates and
    accelerations of both samples; ball and floating joints those of third degree, in rotation
    vectors from the first sample. For a swept driver, `closed` closes the loops at its value.

    Args:
        motion: of two samples at least, if points between samples are used.
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
        """Return the configuration (nq,) at a part, 0 to 1, of the step to the next sample."""
        q0, q1 = self.motion.q[row], self.motion.q[row + 1]
        (slope0, slope1), bends = self._rates(row)
        difference = pin.difference(self.model, q0, q1)
        slope1 = pin.dDifference(self.model, q0, q1, pin.ARG1) @ slope1
        u, v = part, 1.0 - part
        cubic = u * u * ((3.0 - 2.0 * u) * difference - v * slope1) + u * v * v * slope0
        fifth = part**self._powers @ quintic((self._at_first, difference), (slope0, slope1), bends)
        step = np.where(self._is_linear, fifth, cubic)
        return pin.integrate(self.model, q0, step)

    def turned(self, row: int) -> float:
        """Return the angle [rad] of all joints together in the step to the next sample.

        It is that at the mean speed, or at the speed of either sample if that is larger.
        """
        difference = pin.difference(self.model, *self.motion.q[row : row + 2])
        most = np.abs([difference, *self._rates(row)[0]]).max(axis=0)
        return float(most[self._turns].sum())

    def closed(self, row: int, part: float) -> Array:
        """Return the closed configuration (nq,) at the driver's value."""
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
        """Return the driver's value [rad or m]; the time [s] without a driver."""
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
        """Return slopes (2, nv) and second derivatives (2, nv) at both samples, per step."""
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


class MotionPoint(NamedTuple):
    """A point of a motion: a part, 0 to 1, of the step from a sample to the next."""

    row: int
    part: float


class PairResult(NamedTuple):
    """The result for a pair of links."""

    at: MotionPoint  # point of the least distance
    nearest: Nearest  # the distance there
    contacts: tuple[tuple[MotionPoint, MotionPoint], ...]  # first and last point of each contact


class SampledClearance:
    """Distances of pairs of links at the samples of a motion.

    Attributes:
        sampled: (N, pairs) distances at the samples [m].
        points: (N, pairs, 2, 3) nearest points there, in the world [m].
    """

    def __init__(self, distances: Distances, between: Between, touching: float) -> None:
        self.distances, self.between, self.touching = distances, between, touching
        motion = between.motion
        size = motion.mechanism.characteristic_length
        self.certain, self.known = CERTAIN * size, DISTANCE_ERROR * size
        self.sampled = np.empty((len(motion), len(distances.pairs)))
        self.points = np.empty((*self.sampled.shape, 2, 3))
        self._travelled: list[Array] = []
        self._rough: set[int] = set()  # samples after which polynomials stray too far
        self._known_configurations: dict[MotionPoint, Array] = {}  # configurations, for all pairs

    def sample(self) -> Iterator[int]:
        """Compute the distances of all pairs at all samples, one sample at a time."""
        before = None
        for row, q in enumerate(self.between.motion.q):
            here = self.distances.middles(q)
            for pair, nearest in enumerate(self.distances.every()):
                self.sampled[row, pair], self.points[row, pair] = nearest
            if before is not None and self.sampled.shape[1]:
                motion = self.between.motion  # do bodies stray from where closed loops have them?
                step = pin.difference(motion.mechanism.model, *motion.q[row - 1 : row + 1])
                if np.abs(step / motion.mechanism.velocity_scale).max(initial=0.0) > FAIRLY_FAR:
                    strayed = self.distances.travel(*(self.distances.middles(q) for q in (
                        self.between.at(row - 1, 0.5), self.between.closed(row - 1, 0.5))))
                    if strayed.max(initial=0.0) > STRAY * self.certain:
                        self._rough.add(row - 1)
                # the approach of links at even parts of the step, (parts + 1, pairs)
                turns = self.between.turned(row - 1) / WHOLE_TURN
                parts = EVEN_PARTS * max(1, int(np.ceil(turns)))
                steps: list[Array] = [np.zeros(self.sampled.shape[1])]
                for k in range(1, parts + 1):
                    there = here if k == parts else self.distances.middles(
                        self._configuration(row - 1, k / parts))
                    steps.append(self.distances.approach(before, there))
                    before = there
                self._travelled.append(np.cumsum(steps, axis=0))
            before = here
            yield row

    def _configuration(self, row: int, part: float) -> Array:
        """Return the configuration (nq,) at a point, exact enough for the search."""
        point = MotionPoint(row, part)
        if point not in self._known_configurations:
            go = self.between.closed if row in self._rough else self.between.at
            self._known_configurations[point] = go(row, part)
        return self._known_configurations[point]

    def cut(self, n: int) -> Self:
        """Return a search of the first samples alone, which are computed."""
        between = Between(first_samples(self.between.motion, n))
        own = type(self)(self.distances, between, self.touching)
        own.sampled, own.points = self.sampled[:n], self.points[:n]
        return own

    def at_samples(self, pair: int) -> PairResult:
        """Return the result for a pair from the samples alone."""
        apart = self.sampled[:, pair]
        row = int(np.argmin(apart))
        touching = np.concatenate([[False], apart - self.touching <= self.known, [False]])
        ends = np.flatnonzero(np.diff(touching.astype(int)))
        contacts = tuple((MotionPoint(int(first), 0.0), MotionPoint(int(last) - 1, 0.0))
                         for first, last in zip(ends[::2], ends[1::2], strict=True))
        nearest = Nearest(float(apart[row]), self.points[row, pair])
        return PairResult(MotionPoint(row, 0.0), nearest, contacts)


class ClearanceSearch(SampledClearance):
    """The search of a motion, pair of links by pair of links."""

    def result(self, pair: int) -> PairResult:
        """Return the result for a pair, after `sample`."""
        known = {MotionPoint(row, 0.0): x for row, x in enumerate(self.sampled[:, pair].tolist())}
        self._look_into(pair, known)
        at = self._polished(pair, known)
        return PairResult(at, self._nearest(pair, at), tuple(self._contacts(pair, known)))

    def _nearest(self, pair: int, point: MotionPoint, closed: bool = True) -> Nearest:
        row, part = point
        if part == 0.0:
            q = self.between.motion.q[row]
        else:
            q = (self.between.closed if closed else self._configuration)(row, part)
        self.distances.update(q)
        return self.distances.least(pair)

    def _look_into(self, pair: int, known: dict[MotionPoint, float]) -> None:
        """Add distances between samples, until no interval can hold a smaller one or a contact."""
        least, touches = min(known.values()), self.touching + self.known
        for row, travelled in enumerate(self._travelled):
            come = CURVED * travelled[:, pair]
            parts = np.linspace(0.0, 1.0, len(come))
            intervals = [(0.0, 1.0, known[MotionPoint(row, 0.0)], known[MotionPoint(row + 1, 0.0)])]
            while intervals:
                first, last, before, after = intervals.pop()
                travel = float(np.subtract(*np.interp((last, first), parts, come)))
                bound = 0.5 * (before + after - travel)  # with nothing between nearer than that
                shows = min(before, after) <= touches  # its ends show a touch
                may_hide = bound < least - self.certain or (
                    not shows and bound < touches - self.certain)
                if not may_hide or travel < self.certain:
                    continue
                middle = 0.5 * (first + last)
                there = self._nearest(pair, MotionPoint(row, middle), closed=False).distance
                known[MotionPoint(row, middle)] = there
                least = min(least, there)
                intervals += [(first, middle, before, there), (middle, last, there, after)]

    def _polished(self, pair: int, known: dict[MotionPoint, float]) -> MotionPoint:
        """Return the point of the least distance, near the least known ones."""
        from scipy.optimize import minimize_scalar

        points = sorted(known)
        for k in sorted(range(len(points)), key=lambda k: known[points[k]])[:VALLEYS]:
            here = known[points[k]] = self._nearest(pair, points[k]).distance
            for (row, first), after in pairwise(points[max(k - 1, 0) : k + 2]):  # on both sides
                last = after.part if after.row == row else 1.0
                end, other = (first, last) if (row, first) == points[k] else (last, first)
                inside = MotionPoint(row, end + INWARD * (other - end))
                if self._nearest(pair, inside).distance >= here:
                    continue
                result = minimize_scalar(
                    lambda part, row=row: self._nearest(pair, MotionPoint(row, part)).distance,
                    bounds=(first, last), method="bounded", options={"xatol": NEAREST})
                known[MotionPoint(row, float(result.x))] = float(result.fun)
        least = min(known.values()) + EQUAL_DISTANCE * self.known
        return min(point for point, distance in known.items() if distance <= least)

    def _contacts(
        self, pair: int, known: dict[MotionPoint, float]
    ) -> Iterator[tuple[MotionPoint, MotionPoint]]:
        """Yield the first and last point of each contact."""
        points = sorted(known)
        first: MotionPoint | None = None
        for before, here in zip([None, *points], points, strict=False):
            touches = known[here] - self.touching <= self.known
            if touches and first is None:
                first = here if before is None else self._change(pair, before, here, known)
            elif not touches and first is not None and before is not None:
                yield first, self._change(pair, before, here, known)
                first = None
        if first is not None:
            yield first, points[-1]

    def _change(
        self, pair: int, a: MotionPoint, b: MotionPoint, known: dict[MotionPoint, float]
    ) -> MotionPoint:
        """Return the begin or end of a contact between two neighbouring points."""
        row, first = a
        last = b.part if b.row == row else 1.0
        # where they only come near enough to touch, not nearer, that is where
        level = self.touching
        if min(known[a], known[b]) > level - self.known:
            level += self.known

        def excess(part: float) -> float:
            point = MotionPoint(row, part) if part < 1.0 else MotionPoint(row + 1, 0.0)
            return self._nearest(pair, point).distance - level

        ends = excess(first), excess(last)
        if ends[0] * ends[1] > 0.0:  # by the round-off of configurations that were closed
            return min((a, b), key=lambda point: abs(known[point] - level))
        part = sign_change(excess, first, last, *ends)
        return MotionPoint(row, part) if part < 1.0 else MotionPoint(row + 1, 0.0)
