"""Curves of closed configurations of one driver, and where on them configurations lie."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State
from spatial_pin.continuation.initial_tangent import body_placements, not_spinning, system_at
from spatial_pin.continuation.solution_curve import SolutionCurve
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Event
from spatial_pin.motion.trace import trace
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

SAMPLE_STEP = 0.05  # from sample to sample of a curve: some two hundred are a turn of a four-bar
MOST_CURVE_SAMPLES = 4000  # of one curve: two hundred radians, thirty turns, which gears may take
BORDERS = ("limit", "branch point")  # which the driver cannot lead across
# Samples of a curve may be this many times as far from a place on it as from each other: at most
# half a step, but bodies move by other parts of it before and after.
ON_CIRCUIT = 2.0
MOST_CORRECTIONS_TO_PLACE = 20  # of the way to a place: each leaves about a hundredth of the error


class CircuitPlace(NamedTuple):
    """Where a configuration lies on a circuit."""

    value: float  # the driver's, as it is counted along the branch [rad or m]
    branches: frozenset[int]  # numbers of the branches it is on: two where it is a border


class Circuit:
    """One connected curve of closed configurations, with its driver's borders.

    Between two borders, limits or branch points of the driver, is a branch; where a closed curve
    has none, it is one branch, which the driver turns round for ever.

    Attributes:
        driver: its name.
        motion: samples of the curve, `SAMPLE_STEP` apart.
        is_closed: whether it was followed until it came back.
        borders: limits and branch points, in the order of the curve.
        turn: by how much the driver goes on while it goes round once [rad or m].
    """

    def __init__(self, mechanism: Mechanism, driver: str, state: State) -> None:
        self.driver = driver
        self.motion = trace(mechanism, driver, state, step=SAMPLE_STEP,
                            most_rows=MOST_CURVE_SAMPLES)
        events = self.motion.events
        ends_at_first = all(event.kind != "not closed" for event in events)
        self.borders: list[Event] = sorted(
            (event for event in events if event.kind in BORDERS), key=lambda event: event.row)
        self._n = len(self.motion) - ends_at_first
        self._bodies = not_spinning(system_at(self.motion.mechanism, driver,
                                              self.motion.state(0), BASE)[0])
        with loops_of(self.motion.mechanism) as evaluation:
            self._places = np.array([self._at(evaluation, q) for q in self.motion.q[: self._n]])
        # a screw may have gone on by less than a step
        self.is_closed = ends_at_first and self._ahead(self._n - 1, self._places[0]) is not None
        self.turn = float(self.motion.swept[-1] - self.motion.swept[0]) if self.is_closed else 0.0

    @classmethod
    def through(
        cls, mechanism: Mechanism, driver: str, states: Sequence[State]
    ) -> list[tuple[Circuit, dict[int, CircuitPlace]]]:
        """Return the circuits that states lie on, and where."""
        found: list[tuple[Circuit, dict[int, CircuitPlace]]] = []
        rest = list(range(len(states)))
        while rest:
            circuit = cls(mechanism, driver, states[rest[0]])
            places = {i: place for i in rest if (place := circuit.place(states[i])) is not None}
            if rest[0] not in places:
                raise SpatialPinError(f"the curve through sample {rest[0]} cannot be followed")
            found.append((circuit, places))
            rest = [i for i in rest if i not in places]
        return found

    @property
    def turns_fully(self) -> bool:
        """Whether the driver turns round without meeting a border."""
        return self.is_closed and not self.borders

    def place(self, state: State) -> CircuitPlace | None:
        """Return where a configuration lies; None if the curve does not lead to it.

        Links that spin freely may stand as they like.
        """
        with loops_of(self.motion.mechanism) as evaluation:
            target = self._at(evaluation, state.q)
        for row in self._near(target):
            found = self._ahead(row, target)
            if found is not None:
                break
        else:
            return None
        at, value, slope = row + found[0] / SAMPLE_STEP, *found[1:]
        mechanism, last = self.motion.mechanism, len(self.motion) - 1
        size = mechanism.velocity_scale[mechanism.coordinate(self.driver).v]
        if self.is_closed and at < 0.0:
            at, value = at + last, value + self.turn
        crossed, doubtful = 0, 0
        for event in self.borders:
            way = np.sign(self.motion.driver_speed[event.row - 1])
            if not event.row - 1 <= at <= event.row:
                crossed += at > event.row
                continue
            beyond = (-slope if event.kind == "limit" else (value - event.value) / size) * way
            is_at = abs(beyond) < TOLERANCES.half_precision
            doubtful += is_at
            crossed += beyond > 0.0 and not is_at
        numbers, counted = self._numbered(np.arange(crossed, crossed + doubtful + 1),
                                          np.full(doubtful + 1, value))
        return CircuitPlace(float(counted[0]), frozenset(numbers.tolist()))

    def rows_of(self, branch: int) -> tuple[NDArray[np.intp], Array]:
        """Return samples of a branch, and the driver's values as they are counted along it."""
        rows = [event.row for event in self.borders]
        crossed = np.searchsorted(rows, np.arange(self._n), "right")
        numbers, values = self._numbered(crossed, self.motion.swept[: self._n])
        own = np.flatnonzero(numbers == branch)
        return own, values[own]

    def values_at_borders(self) -> list[float]:
        """Return the driver's values at the borders."""
        return [event.value for event in self.borders]

    def may_meet(self, other: Circuit) -> bool:
        """Whether both have a branch point at what may be the same place."""
        return any(np.abs(self._places[i] - other._places[j]).max() < ON_CIRCUIT * max(
            self._spacing(i), other._spacing(j))
            for i in self._branch_points() for j in other._branch_points())

    def _at(self, evaluation: LoopEquations, q: Array) -> Array:
        evaluation.update(q)
        return body_placements(evaluation, self._bodies)

    def _branch_points(self) -> list[int]:
        return [event.row - k for event in self.borders if event.kind == "branch point"
                for k in (0, 1) if 0 <= event.row - k < self._n]

    def _spacing(self, row: int) -> float:
        """Return how far bodies go to the neighbours of a sample."""
        near = self._places[max(row - 1, 0) : row + 2]
        return float(np.abs(np.diff(near, axis=0)).max(initial=0.0))

    def _near(self, target: Array) -> list[int]:
        """Return samples near to placements, the nearest first."""
        gaps = np.abs(self._places - target).reshape(len(self._places), -1).max(axis=1, initial=0.0)
        return [k for k in np.argsort(gaps, kind="stable").tolist()
                if gaps[k] <= ON_CIRCUIT * self._spacing(k) + TOLERANCES.half_precision]

    def _ahead(self, row: int, target: Array) -> tuple[float, float, float] | None:
        """Return how far ahead of a sample bodies are at placements, and value and slope there.

        It is where the curve meets the plane through these, normal to how bodies move. None if the
        curve does not lead there from the sample; the slope is that of the driver.
        """
        mechanism, state = self.motion.mechanism, self.motion.state(row)
        system, near, _ = system_at(mechanism, self.driver, state, BASE)
        if np.abs(self._at(system.evaluation, near.q) - self._places[row]).max(
                initial=0.0) > TOLERANCES.half_precision:
            return None  # a dead centre: its neighbours are as good
        curve = SolutionCurve(system, Accuracy.named("engineering").tolerance)
        point = curve.settle(near.q, self.motion.v[row] / system.scale)
        h = TOLERANCES.trial_step * SAMPLE_STEP
        ends = [] if point is None else [
            end for x in (h, -h) if (end := curve.ahead(point, x)) is not None]
        if point is None or len(ends) < 2:
            return None
        after, before = (self._at(curve.evaluation, end) for end in ends)
        along = (after - before) / (2.0 * h)
        length = 0.0
        for _ in range(MOST_CORRECTIONS_TO_PLACE):
            q: Array | None = curve.ahead(point, length)
            if q is None:
                return None
            gap = target - self._at(curve.evaluation, q)
            change = float(np.sum(gap * along) / np.sum(along * along))
            if abs(change) < TOLERANCES.tight:
                break
            length += change
        if q is None or np.abs(gap).max() > TOLERANCES.half_precision:
            return None
        size = float(system.scale[system.driven[0].v])
        return length, curve.value(q), curve.slope(curve.direction(q, point.t)[0]) / size

    def _numbered(self, crossed: NDArray[np.intp], values: Array) -> tuple[NDArray[np.intp], Array]:
        """Return numbers of branches from how many borders were crossed, and values along them.

        The last piece of a closed curve is the beginning of the first branch.
        """
        n = len(self.borders)
        if not self.is_closed or not n:
            return crossed, values
        return crossed % n, np.where(crossed == n, values - self.turn, values)
