"""Clearance of links over a motion, and their contacts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import checked, finite_number
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError, unless_cut
from spatial_pin.motion.motion import Event, Motion, require_motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.proximity.clearance_search import Between, ClearanceSearch, MotionPoint, PairResult
from spatial_pin.proximity.distances import Distances

SHOWN = 12  # nearest pairs of links in a report


class Contact(NamedTuple):
    """A part of a motion on which two links touch.

    Attributes:
        begin, end: driver values [rad or m], or times [s] where none was swept.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 13))
        >>> contact = sp.clearance(motion, tolerance=0.15).between("crank", "rocker").contacts[0]
        >>> print(f"nearer than 0.15 m from {contact.begin:.2f} to {contact.end:.2f} rad")
        nearer than 0.15 m from 3.86 to 4.27 rad
    """

    begin: float
    end: float


@dataclass(frozen=True, eq=False)
class PairClearance:
    """Least distance of two links over a motion.

    Attributes:
        links: their names.
        distance: the least over the motion; below zero how deep they overlap [m].
        value: driver value there [rad or m], or time [s] where none was swept.
        row: number of the sample at or before it.
        at: (2, 3) nearest points of the first and the second link there, in the world [m].
        distances: (N,) at the samples [m].
        points: (N, 2, 3) nearest points at the samples, in the world [m].
        contacts: where they touch.

    Example:
        >>> mech = sp.load("four_bar")
        >>> pair = sp.clearance(sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 13))).least
        >>> pair.links, pair.distances.shape, pair.points.shape  # (N,) [m], (N, 2, 3) [m]
        (('ground', 'coupler'), (13,), (13, 2, 3))
    """

    links: tuple[str, str]
    distance: float
    value: float
    row: int
    at: Array
    distances: Array
    points: Array
    contacts: tuple[Contact, ...]

    def __repr__(self) -> str:
        return brief(self, distance="m", at="m", distances="m", points="m")


@dataclass(frozen=True, eq=False)
class Clearance:
    """Least distances of the links of a mechanism over a motion.

    Attributes:
        motion: the motion.
        pairs: of the links looked at, the nearest first; ties by names.
        joined: names of links that were not looked at, being joined to each other.
        tolerance: distance at which links count as touching [m].
        events: where links begin ("touch") and cease ("part") to touch, in the motion's order.
        is_whole: whether the search is complete (no Ctrl-C). Otherwise the motion ends with the
            last sample searched, and unsearched pairs have the least distance of their samples.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.clearance(sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 13)))
        >>> [pair.links for pair in found.pairs], found.touching
        ([('ground', 'coupler'), ('crank', 'rocker')], ())
        >>> print(f"{found.least.distance:.4f} m")
        0.0235 m
    """

    motion: Motion
    pairs: tuple[PairClearance, ...]
    joined: tuple[tuple[str, str], ...]
    tolerance: float
    events: tuple[Event, ...]
    is_whole: bool = True

    @property
    def least(self) -> PairClearance:
        """The pair of links that come nearest to each other.

        Raises:
            SpatialPinError: there is no pair to look at.
        """
        if not self.pairs:
            raise SpatialPinError(f"mechanism {self.motion.mechanism.name!r}: no two links that "
                                  "are not joined have a shape")
        return self.pairs[0]

    @property
    def touching(self) -> tuple[PairClearance, ...]:
        """The pairs of links that touch anywhere."""
        return tuple(pair for pair in self.pairs if pair.contacts)

    def between(self, first: str, second: str) -> PairClearance:
        """Return how far two links stay apart.

        Args:
            first: name of a link.
            second: name of another one, in any order.

        Returns:
            The PairClearance: distances in m.

        Raises:
            SpatialPinError: they were not looked at; says why.

        Example:
            >>> mech = sp.load("four_bar")
            >>> found = sp.clearance(sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 13)))
            >>> print(f"{found.between('crank', 'rocker').distance:.4f} m")
            0.1486 m
        """
        for pair in self.pairs:
            if set(pair.links) == {first, second}:
                return pair
        why = ("they are joined: name them in `pairs`"
               if {first, second} in map(set, self.joined) else
               "looked at were " + ", ".join(f"{a} and {b}" for a, b in (
                   p.links for p in self.pairs)))
        raise SpatialPinError(f"{first!r} and {second!r} were not looked at: {why}")

    def as_dict(self) -> dict[str, Any]:
        """Return the distances as plain numbers and lists, for JSON.

        Example:
            >>> mech = sp.load("four_bar")
            >>> found = sp.clearance(sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 13)))
            >>> len(found.as_dict()["pairs"])
            2
        """
        pairs = [{"links": list(p.links), "distance": p.distance, "value": p.value,
                  "at": p.at.tolist(), "contacts": [c._asdict() for c in p.contacts]}
                 for p in self.pairs]
        return {"tolerance": self.tolerance, "is_whole": self.is_whole, "pairs": pairs,
                "joined": [list(names) for names in self.joined],
                "events": [event._asdict() for event in self.events]}

    def __repr__(self) -> str:
        return (f"Clearance({self.motion!r}, {len(self.pairs)} pairs of links, "
                f"{len(self.touching)} of them touch{'' if self.is_whole else '; cut short'})")

    def __str__(self) -> str:
        motion = self.motion
        over = (f"{motion.driver_name} [{motion.driver_unit}]" if motion.driver is not None
                else "time [s]")
        if not self.pairs:
            return f"{motion.mechanism.name}: no two links that are not joined have a shape"
        lines = [f"{motion.mechanism.name}: {len(self.pairs)} pairs of links over {over}, "
                 f"{len(self.touching)} of them touch; {len(self.joined)} are joined"
                 f"{'' if self.is_whole else f'; cut short at {len(motion)} samples'}"]
        width = max(len(in_words(p)) for p in self.pairs[:SHOWN])
        for pair in self.pairs[:SHOWN]:
            touch = "".join(f", touch from {c.begin:.9g} to {c.end:.9g}" for c in pair.contacts)
            lines.append(f"  {in_words(pair):{width}}  {pair.distance: .6e} m at "
                         f"{pair.value:.9g}{touch}")
        if len(self.pairs) > SHOWN:
            lines.append(f"  {len(self.pairs) - SHOWN} more are farther apart")
        return "\n".join(lines)


def in_words(pair: PairClearance) -> str:
    """Return the names of two links."""
    return " and ".join(pair.links)


@checked
def clearance(
    motion: Motion | State,
    pairs: Iterable[tuple[str, str]] | None = None,
    *,
    tolerance: float = 0.0,
    progress: bool = False,
) -> Clearance:
    """Return the least distances of links that are not joined over a motion, and where they touch.

    The shape of a link is its collision geometry; without any, its visual geometry. A mesh counts
    as the convex hulls of its connected parts. Links are joined by a joint or a closure between
    them (but not by a distance, which is a rod), by a coupling, or by a link without a shape.

    Least distances are searched between the samples too: no place is nearer by more than 1/200 of
    the characteristic length, as far as links can travel from sample to sample. Where a driver was
    swept, the places at which links begin and cease to touch are located to round-off, with closed
    loops; elsewhere (simulations) on the interpolated motion.

    Args:
        motion: of `sweep`, `trace`, `simulate` and the like; a State is one of one sample.
        pairs: names of two links each, joined ones too; default all that are not joined.
        tolerance: distance at which links count as touching [m]; below zero as deep as they may
            overlap.
        progress: whether a bar shows how far it is.

    Returns:
        A Clearance.

    Raises:
        UnknownNameError: there is no such link.
        SpatialPinError: a link has no shape, or two are fixed to each other.
        ValueError: the motion has no samples, or the tolerance is no number.
        Interrupted: after Ctrl-C; `.result` has the distances until then.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 13))
        >>> least = sp.clearance(motion).least
        >>> least.links, round(least.distance, 4)  # [m]
        (('ground', 'coupler'), 0.0235)
    """
    if isinstance(motion, State):
        motion = standing(motion)
    require_motion(motion)
    if not len(motion):
        raise ValueError("the motion has no samples: there is nothing to look at")
    touching = finite_number(tolerance, "tolerance")
    named = None if pairs is None else list(pairs)
    if named == []:
        raise ValueError("pairs is empty: name two links each, or leave it out for all")
    search = ClearanceSearch(Distances(motion.mechanism, named),
                    Between(motion), touching)
    names = search.distances.pairs
    with progress_bar(len(motion) + len(names), "clearance", progress) as bar:
        search, results, is_whole = _searched(search, bar)
    between = search.between
    made = []
    for k, one in enumerate(results):
        contacts = tuple(Contact(between.value(*first), between.value(*last))
                         for first, last in one.contacts)
        made.append(PairClearance(names[k], one.nearest.distance, between.value(*one.at),
                                  one.at.row, one.nearest.points, search.sampled[:, k],
                                  search.points[:, k], contacts))
    made.sort(key=lambda pair: pair.distance)  # those that are as near as each other by names
    apart = np.diff([pair.distance for pair in made]) > (
        TOLERANCES.nothing * motion.mechanism.characteristic_length)
    ranks = [0, *np.cumsum(apart).tolist()]
    placed = sorted(zip(ranks, made, strict=False), key=lambda x: (x[0], x[1].links))
    result = Clearance(
        between.motion, tuple(pair for _, pair in placed), search.distances.joined, touching,
        _events(between, names, results), is_whole)
    return unless_cut(result, between.motion)


def _searched(search: ClearanceSearch, bar: Any) -> tuple[ClearanceSearch, list[PairResult], bool]:
    """Return the search, its result for each pair of links, and whether it is complete."""
    results, done, n = list[PairResult](), 0, len(search.distances.pairs)
    try:
        for row in search.sample():
            done = row + 1
            bar.update()
        for k in range(n):
            results.append(search.result(k))
            bar.update()
    except KeyboardInterrupt:  # the result has the distances until then
        if not done:
            raise
        search = search.cut(done)
        return search, [*results, *(search.at_samples(k) for k in range(len(results), n))], False
    return search, results, True


def standing(state: State) -> Motion:
    """Return a state as a motion of one sample."""
    s, none = state, np.zeros(1)
    q, v, a, error, angles = (np.atleast_2d(x) for x in (s.q, s.v, s.a, s.closure_error, s.angles))
    return Motion(s.mechanism, None, "", none, q, v, a, error[0], none, [], angles)


def _events(
    between: Between, names: Sequence[tuple[str, str]], results: Sequence[PairResult]
) -> tuple[Event, ...]:
    """Return where links begin and cease to touch, without the ends of the motion."""
    motion, placed = between.motion, []
    unit = motion.driver_unit if motion.driver is not None else "s"
    over = motion.driver_name or "time"
    ends = MotionPoint(0, 0.0), MotionPoint(len(motion) - 1, 0.0)
    for (a, b), one in zip(names, results, strict=True):
        for first, last in one.contacts:
            for kind, point, words in (("touch", first, "begin"), ("part", last, "cease")):
                if point not in ends:
                    value = between.value(*point)
                    text = f"{a} and {b} {words} to touch at {over} = {value:.12g} {unit}"
                    placed.append((point, Event(kind, value, point.row + 1, text)))
    return tuple(event for _, event in sorted(placed, key=lambda x: x[0]))
