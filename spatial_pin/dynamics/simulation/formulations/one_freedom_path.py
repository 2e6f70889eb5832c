"""A mechanism of one freedom, moved by one coordinate along its branch, change points included."""

from __future__ import annotations

import math

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.continuation import branch_points
from spatial_pin.continuation.branch import Branch, Stopped
from spatial_pin.continuation.pseudo_arclength import Arrival
from spatial_pin.dynamics.simulation.independent_coordinates import Lost
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy

GUESSES = 12  # steps in search of a crossing ahead
AHEAD = 0.25  # arc length from a crossing at which its place is surely enough known
FASTER = 2.0  # times that joints move as fast as before, where it is no crossing but a limit
SAME = 1e-6  # difference of limits that are one
ROUND_OFF = 1e-15  # closure residual: places are few and all else is made of them
FARTHEST = 20.0  # stretches of a branch that one trial may go


class Path:
    """The branch of a mechanism of one freedom, as a place on it.

    Args:
        state: a closed configuration.
        coordinate: the independent coordinate.

    Attributes:
        unit: size of one unit of the coordinate, 1 rad or the characteristic length.
        start: value of the coordinate at `state`.
        crossings: values of the coordinate at which other branches were crossed.
        limits: values of the coordinate at which it turned out to end.
    """

    def __init__(self, state: State, coordinate: Coordinate) -> None:
        self.branch = Branch(state, [coordinate], Accuracy(tolerance=ROUND_OFF))
        self.branch.spins = []  # a place need not be the same whichever way it is reached
        self.evaluation = self.branch.evaluation
        self.unit = float(self.branch.scale[coordinate.v])
        self.start = float(state.q[coordinate.q])
        self.crossings: list[float] = []
        self.limits: list[float] = []
        self._strip: branch_points.Strip | None = None
        self._strips: list[branch_points.Strip] = []

    @property
    def value(self) -> float:
        """The coordinate's present value [rad or m]."""
        return self.branch.s

    def go_to(self, value: float) -> None:
        """Move to a value of the coordinate [rad or m].

        Raises:
            Lost: a limit lies before it, or a crossing that no branch passes straight.
        """
        if value == self.branch.s:
            return
        if any(self._is_between(limit, value) for limit in self.limits):
            raise Lost
        self._go(value)

    def _is_between(self, limit: float, value: float) -> bool:
        """Whether a known limit lies on the way to a value."""
        left = limit - self.branch.s
        return abs(left) > SAME * self.unit and left * (value - limit) > 0.0

    @property
    def q(self) -> Array:
        """(nq,) the present configuration."""
        return self.branch.q

    def is_on_strip(self, value: float) -> bool:
        """Whether a value of the coordinate lies on the strip about a known crossing."""
        return any(strip.holds(value) for strip in self._strips)

    def clear(self, values: Array) -> int:
        """Return how many of some values (N,), in their order, come before any known strip."""
        for k, value in enumerate(values.tolist() if self._strips else ()):
            before = values[max(k - 1, 0)]
            if any(strip.holds(value) or strip.is_between(before, value) for strip in self._strips):
                return k
        return len(values)

    def stand(self, q: Array, angles: Array, anew: bool = True) -> None:
        """Stand at a closed configuration of the same branch, off any strip.

        Args:
            q: (nq,) the configuration.
            angles: of screw closures there.
            anew: choose the independent rows anew; else those in use do there too.
        """
        self.branch.evaluation.turns[:] = angles
        self.branch.place(q, anew)
        self._strip = None

    def _go(self, value: float) -> None:
        branch = self.branch
        inside = next((strip for strip in self._strips if strip.holds(value)), None)
        if inside is not None:
            inside.put(branch, value)
            self._strip = inside
            return
        if self._strip is not None:
            self._strip.leave(branch, value)
            self._strip = None
        for _ in range(4):  # crossings on the way
            between = next((s for s in self._strips if s.is_between(branch.s, value)), None)
            if between is not None:
                between.leave(branch, value)
            found = self._crossing_ahead(value)
            if found is None:
                try:
                    branch.reach(value, FARTHEST)
                    return
                except Stopped as stopped:
                    found = self._crossing_at(stopped.arrival)
            if not self._take(found, value):
                return
        raise Lost

    def _crossing_ahead(self, value: float) -> branch_points.Strip | None:
        """Return the crossing that falling pivots tell of, on the way to a value.

        A guess that saves the search for the place, if what is found there is a crossing. At a
        limit pivots fall too, but joints move ever faster.
        """
        branch = self.branch
        if branch.step(value):
            return None
        first, h = self._pace(), 0.5 * (value - branch.s)
        for _ in range(GUESSES):
            left = value - branch.s
            h = left if abs(left) < abs(h) else h
            if not branch.step(branch.s + h):
                h *= 0.5
                continue
            if branch.s == value:
                return None
            pace, room = self._pace(), branch.room(h)
            if pace > FASTER * first:
                return None
            if room * pace < AHEAD:
                return branch_points.strip(branch, branch.s + math.copysign(room, h))
        return None

    def _pace(self) -> float:
        branch = self.branch
        return float(np.linalg.norm(branch.t / branch.scale))

    def _crossing_at(self, arrival: Arrival) -> branch_points.Strip:
        """Return the crossing at which the branch has stopped.

        Raises:
            Lost: it is none.
        """
        if arrival.is_far:  # a wild trial of an integrator, which tries a shorter step then
            raise Lost("a step goes too far to be followed; ask for a smaller error or step")
        found = None
        if arrival.kind in ("branch point", "singular"):
            found = branch_points.strip(self.branch, arrival.value)
        if found is None:
            if arrival.kind == "limit" and not any(
                    abs(limit - arrival.value) < SAME * self.unit for limit in self.limits):
                self.limits.append(arrival.value)
            raise Lost
        return found

    def _take(self, found: branch_points.Strip, value: float) -> bool:
        """Take in a crossing ahead; return whether the value lies beyond its strip."""
        self.crossings += found.crossings
        self._strips = [*self._strips[-7:], found]
        if not found.holds(value):
            found.leave(self.branch, value)
            return True
        found.put(self.branch, value)
        self._strip = found
        return False
