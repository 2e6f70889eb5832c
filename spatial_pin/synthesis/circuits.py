"""Circuits of one driver: curves of closed configurations, and positions on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State
from spatial_pin.continuation.initial_tangent import body_placements, non_spinning_bodies, system_at
from spatial_pin.continuation.solution_curve import SolutionCurve
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Event
from spatial_pin.motion.trace import trace
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

SAMPLE_STEP = 0.05  # between samples of a curve: about 200 are a turn of a four-bar
MOST_CURVE_SAMPLES = 4000  # of one curve: 200 rad, or 30 turns, which gears may need
BORDERS = ("limit", "branch point")  # the driver cannot cross these
# Distance from a configuration to the nearest sample, relative to the distance between samples. It
# is half a step at most, but bodies move unequally before and after.
ON_CIRCUIT = 2.0
MOST_POSITION_STEPS = 20  # corrections of the arc length: each leaves about 1% of the error


class CircuitPosition(NamedTuple):
    """The position of a configuration on a circuit."""

    value: float  # the driver's value, counted along the branch [rad or m]
    branches: frozenset[int]  # numbers of its branches: two at a border


class Circuit:
    """One connected curve of closed configurations, with its driver's borders.

    Borders are limits and branch points of the driver. A branch lies between two borders. A closed
    curve without borders is one branch, along which the driver turns without end.

    Attributes:
        driver: name of the driver.
        motion: samples of the curve, `SAMPLE_STEP` apart.
        is_closed: whether the curve was followed back to its first sample.
        borders: limits and branch points, in the order of the curve.
        turn: change of the driver over one closed curve [rad or m].
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
        self._bodies = non_spinning_bodies(system_at(self.motion.mechanism, driver,
                                              self.motion.state(0), BASE)[0])
        with loops_of(self.motion.mechanism) as evaluation:
            self._points = np.array([self._at(evaluation, q) for q in self.motion.q[: self._n]])
        # a screw may have gone on by less than a step
        self.is_closed = ends_at_first and self._ahead(self._n - 1, self._points[0]) is not None
        self.turn = float(self.motion.swept[-1] - self.motion.swept[0]) if self.is_closed else 0.0

    @property
    def turns_fully(self) -> bool:
        """Whether the driver turns without meeting a border."""
        return self.is_closed and not self.borders

    def position(self, state: State) -> CircuitPosition | None:
        """Return the position of a configuration; None if it is not on the curve.

        The angles of links that spin freely do not matter.
        """
        with loops_of(self.motion.mechanism) as evaluation:
            target = self._at(evaluation, state.q)
        gaps = np.abs(self._points - target).reshape(len(self._points), -1).max(axis=1, initial=0.0)
        near = (k for k in np.argsort(gaps, kind="stable").tolist()
                if gaps[k] <= ON_CIRCUIT * self._spacing(k) + TOLERANCES.half_precision)
        row, point = next(((k, x) for k in near if (x := self._ahead(k, target)) is not None),
                          (0, None))
        if point is None:
            return None
        at, value, slope = row + point[0] / SAMPLE_STEP, *point[1:]
        mechanism, last = self.motion.mechanism, len(self.motion) - 1
        size = mechanism.velocity_scale[mechanism.coordinate(self.driver).v]
        if self.is_closed and at < 0.0:
            at, value = at + last, value + self.turn
        crossed, doubtful = 0, 0
        for event in self.borders:
            sense = np.sign(self.motion.driver_speed[event.row - 1])
            if not event.row - 1 <= at <= event.row:
                crossed += at > event.row
                continue
            beyond = (-slope if event.kind == "limit" else (value - event.value) / size) * sense
            is_at = abs(beyond) < TOLERANCES.half_precision
            doubtful += is_at
            crossed += beyond > 0.0 and not is_at
        numbers, counted = self._numbered(np.arange(crossed, crossed + doubtful + 1),
                                          np.full(doubtful + 1, value))
        return CircuitPosition(float(counted[0]), frozenset(numbers.tolist()))

    def rows_of(self, branch: int) -> tuple[NDArray[np.intp], Array]:
        """Return samples of a branch, and the driver's values counted along it."""
        rows = [event.row for event in self.borders]
        crossed = np.searchsorted(rows, np.arange(self._n), "right")
        numbers, values = self._numbered(crossed, self.motion.swept[: self._n])
        own = np.flatnonzero(numbers == branch)
        return own, values[own]

    def may_meet(self, other: Circuit) -> bool:
        """Whether both may have one branch point in common."""
        def branch_points(circuit: Circuit) -> list[int]:
            return [event.row - k for event in circuit.borders if event.kind == "branch point"
                    for k in (0, 1) if 0 <= event.row - k < circuit._n]

        return any(np.abs(self._points[i] - other._points[j]).max() < ON_CIRCUIT * max(
            self._spacing(i), other._spacing(j))
            for i in branch_points(self) for j in branch_points(other))

    def _at(self, evaluation: LoopEquations, q: Array) -> Array:
        evaluation.update(q)
        return body_placements(evaluation, self._bodies)

    def _spacing(self, row: int) -> float:
        """Return the largest displacement of a body to a neighbouring sample."""
        near = self._points[max(row - 1, 0) : row + 2]
        return float(np.abs(np.diff(near, axis=0)).max(initial=0.0))

    def _ahead(self, row: int, target: Array) -> tuple[float, float, float] | None:
        """Return arc length from a sample to placements, with the driver's value and slope there.

        The curve is cut by the plane through the placements and normal to the bodies' motion. None
        if the curve does not reach the placements from this sample.
        """
        mechanism, state = self.motion.mechanism, self.motion.state(row)
        system, near, _ = system_at(mechanism, self.driver, state, BASE)
        if np.abs(self._at(system.evaluation, near.q) - self._points[row]).max(
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
        for _ in range(MOST_POSITION_STEPS):
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
        """Return numbers of branches from the number of crossed borders, and values along them.

        The last piece of a closed curve belongs to the first branch.
        """
        n = len(self.borders)
        if not self.is_closed or not n:
            return crossed, values
        return crossed % n, np.where(crossed == n, values - self.turn, values)


def circuits_through(
    mechanism: Mechanism, driver: str, states: Sequence[State]
) -> list[tuple[Circuit, dict[int, CircuitPosition]]]:
    """Return circuits through states: (circuit, {number of a state: its position})."""
    circuits: list[tuple[Circuit, dict[int, CircuitPosition]]] = []
    rest = list(range(len(states)))
    while rest:
        circuit = Circuit(mechanism, driver, states[rest[0]])
        positions = {i: x for i in rest if (x := circuit.position(states[i])) is not None}
        if rest[0] not in positions:
            raise SpatialPinError(f"the curve through sample {rest[0]} cannot be followed")
        circuits.append((circuit, positions))
        rest = [i for i in rest if i not in positions]
    return circuits
