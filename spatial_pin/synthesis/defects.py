"""Defects of a synthesised mechanism: circuit, branch, order, transmission [ChaseMirth1993].

A circuit of one driver is a curve of closed configurations. A joint limit that the motion passes is
a defect too: the loop equations do not contain limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import checked
from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.continuation.initial_tangent import body_placements, non_spinning_bodies, system_at
from spatial_pin.continuation.solution_curve import SolutionCurve
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.dead_centres import grounded_outputs
from spatial_pin.motion.limit_events import joint_limits_passed, passed_at_start
from spatial_pin.motion.motion import Event, Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.motion.trace import trace
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.transmission import transmission_angle
from spatial_pin.settings import Accuracy

LEAST_ANGLE = float(np.radians(40.0))  # transmission angle that textbooks recommend
ALL = "circuit, branch, order and transmission"
MOST_NAMED = 4  # driver values of borders in a sentence
SAMPLE_STEP = 0.05  # between samples of a curve: about 200 are a turn of a four-bar
MOST_CURVE_SAMPLES = 4000  # of one curve: 200 rad, or 30 turns, which gears may need
BORDERS = ("limit", "branch point")  # the driver cannot cross these
# Distance from a configuration to the nearest sample, relative to the distance between samples. It
# is half a step at most, but bodies move unequally before and after.
ON_CIRCUIT = 2.0
MOST_POSITION_STEPS = 20  # corrections of the arc length: each leaves about 1% of the error


# The position of a configuration on a circuit: the driver's value, counted along the branch [rad or
# m], and the numbers of its branches, two at a border.
CircuitPosition = tuple[float, frozenset[int]]


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
        return float(counted[0]), frozenset(numbers.tolist())

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


class Defect(NamedTuple):
    """A reason why a design with correct samples may fail in motion.

    Attributes:
        kind: "circuit": the loops must be opened between samples; "branch": the driver cannot move
            from one sample to another; "order": the driver meets the samples in the wrong order;
            "joint limit": a joint passes its limit of the URDF; "transmission": a poor
            transmission angle; "not judged": a check was not possible.
        samples: numbers of the samples, from 0.
        text: the same as a sentence.

    Example:
        >>> mech = sp.load("four_bar")
        >>> goal = sp.goals.function("rocker_pin", [1.625, -2.28], {"crank": [1.0, 1.05]})  # [rad]
        >>> best = sp.design(mech, goal, {"r3": (0.27, 0.29)}, method="local")[0]
        >>> [(defect.kind, defect.samples) for defect in best.defects]
        [('circuit', (0, 1))]
    """

    kind: str
    samples: tuple[int, ...]
    text: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"


class UsedBranch(NamedTuple):
    """A branch with samples of a goal."""

    circuit: Circuit
    branch: int  # number on the circuit
    samples: tuple[int, ...]  # those on the branch, in the required order
    values: Array  # of the driver at these samples, counted along the branch

    @classmethod
    def several(cls, circuit: Circuit, positions: dict[int, CircuitPosition]) -> list[UsedBranch]:
        """Return the fewest branches with all positions, the one with most of them first."""
        rest, branches = dict(positions), list[UsedBranch]()
        while rest:
            numbers = sorted({b for _, on in rest.values() for b in on})
            best = max(numbers, key=lambda b: sum(b in on for _, on in rest.values()))
            own = [i for i, (_, on) in rest.items() if best in on]
            values = np.array([rest.pop(i)[0] for i in own])
            branches.append(cls(circuit, best, tuple(own), values))
        return branches

    def direction(self) -> tuple[float, Array, Array]:
        """Return the driver's best sense, its travel to each sample, and which are in order.

        A driver that turns fully begins at the first sample and moves by less than one turn. In
        order are the samples of the longest sequence that does not fall.
        """
        senses, n = [], len(self.values)
        for sense in (1.0, -1.0):
            offsets = sense * (self.values - self.values[0])
            if self.circuit.turns_fully:
                turn = abs(self.circuit.turn)
                offsets %= turn
                offsets[turn - offsets < TOLERANCES.half_precision] = 0.0
            length, before = np.ones(n, dtype=int), np.full(n, -1)
            for k in range(1, n):
                lower = np.flatnonzero(offsets[:k] <= offsets[k] + TOLERANCES.half_precision)
                if lower.size:
                    before[k] = lower[np.argmax(length[lower])]
                    length[k] = length[before[k]] + 1
            rising, k = np.zeros(n, dtype=bool), int(np.argmax(length))
            while k >= 0:
                rising[k] = True
                k = int(before[k])
            senses.append((int(rising.sum()), -float(np.ptp(offsets)), sense, offsets, rising))
        best = max(senses, key=lambda x: x[:3])
        return best[2], best[3], best[4]

    def rows(self, cyclic: bool) -> list[int]:
        """Return samples of the curve between the first and the last sample of the goal."""
        rows, values = self.circuit.rows_of(self.branch)
        if not self.circuit.turns_fully:
            low, high = self.values.min(), self.values.max()
            return rows[(low <= values) & (values <= high)].tolist()
        if cyclic:
            return rows.tolist()
        sense, offsets, _ = self.direction()
        on = (sense * (values - self.values[0])) % abs(self.circuit.turn)
        return rows[on <= offsets.max()].tolist()

    def order_defects(self) -> Iterator[Defect]:
        """Yield a defect if the driver meets the samples in another order."""
        _, offsets, rising = self.direction()
        if not rising.all():
            out = tuple(i for i, fits in zip(self.samples, rising, strict=True) if not fits)
            met = [self.samples[k] for k in np.argsort(offsets, kind="stable").tolist()]
            yield Defect("order", out, f"{self.circuit.driver} meets the samples in the order "
                         f"{', '.join(map(str, met))}")

    def limit_defects(self, states: Sequence[State], cyclic: bool) -> Iterator[Defect]:
        """Yield joint limits that the motion through the samples of the branch passes."""
        circuit = self.circuit
        if not joint_limits(circuit.motion.mechanism):
            return
        sense, offsets, _ = self.direction()
        most = abs(circuit.turn) if circuit.turns_fully and cyclic else float(offsets.max())
        k = int(np.argmin(offsets))
        state = states[self.samples[k]]
        values = float(state.coordinate(circuit.driver).value) + sense * np.linspace(
            0.0, most - float(offsets[k]), len(self.rows(cyclic)) + 2)
        try:
            motion = sweep(state.mechanism, circuit.driver, values, guess=state, on_limit="stop")
            yield from limits_passed(motion, self.samples)
        except SpatialPinError as error:
            yield Defect("not judged", self.samples, f"joint limits: {error}")


@checked
def defects(
    mechanism: Mechanism,
    states: Sequence[State],
    driver: str | None = None,
    *,
    output: str | None = None,
    least_angle: float = LEAST_ANGLE,
    ordered: bool = True,
    cyclic: bool = False,
) -> tuple[Defect, ...]:
    """Return the defects of a mechanism that must pass through given states.

    The curve through each state is followed as a whole (`trace`); other drivers are fixed. Two
    states are on one circuit if one curve passes through both. They are on one branch if the driver
    meets no limit and no branch point between them. Joint limits count at the states, and between
    the states of a branch. A check that is not possible, for example because several drivers move,
    is a defect of kind "not judged".

    Args:
        mechanism: the mechanism.
        states: closed states in the required order.
        driver: driver or coordinate that moves the mechanism; default the only driver.
        output: coordinate whose transmission angle counts; default the only one-freedom joint on
            the fixed link besides the driver's.
        least_angle: smallest good transmission angle [rad].
        ordered: whether the timing is free, so that the order of the states counts.
        cyclic: whether a driver that turns fully is used over the whole turn.
    """
    states = [of_mechanism(mechanism, state) for state in states]
    if not states:
        return ()
    mechanism = states[0].mechanism
    everything = tuple(range(len(states)))
    for name in (driver, output):
        if name is not None:
            mechanism.driven_coordinate(name)
    if driver is None and len(mechanism.drivers) == 1:
        driver = next(iter(mechanism.drivers))
    why = _moved_besides(mechanism, states, driver)
    beyond = [*_beyond_limits(states)]
    if driver is None or why:
        return (Defect("not judged", everything, f"{ALL}: {why}"), *beyond)
    try:
        circuits = circuits_through(mechanism, driver, states)
    except SpatialPinError as error:
        return (Defect("not judged", everything, f"{ALL}: {error}"), *beyond)
    result, branches = [*_circuit_defects(circuits)], list[UsedBranch]()
    for circuit, samples in circuits:
        own = UsedBranch.several(circuit, samples)
        result += _branch_defects(own)
        branches += own
    if ordered:
        result += [defect for one in branches for defect in one.order_defects()]
    result += beyond or [x for one in branches for x in one.limit_defects(states, cyclic)]
    return (*result, *_transmission(branches, states, output, least_angle, cyclic))


def _moved_besides(mechanism: Mechanism, states: Sequence[State], driver: str | None) -> str:
    """Return the reason why defects cannot be judged; empty if they can."""
    if driver is None:
        n = len(mechanism.drivers)
        return (f"{n} drivers move, and these are of motions by one" if n else
                "no driver moves it")
    own = mechanism.driven_coordinate(driver)
    if len(mechanism.drivers) == 1:
        return ""  # this driver, or the coordinate given in its place, moves the mechanism
    for name, other in mechanism.drivers.items():
        coordinate = mechanism.driven_coordinate(other.joint)
        values = [state.coordinate(coordinate.name).value for state in states]
        if coordinate != own and np.ptp(values) > TOLERANCES.half_precision * float(
                mechanism.velocity_scale[coordinate.v]):
            return f"driver {name!r} moves besides {driver!r}"
    return ""


def _circuit_defects(
    circuits: Sequence[tuple[Circuit, dict[int, CircuitPosition]]]
) -> Iterator[Defect]:
    """Yield the defect of samples on several curves."""
    if len(circuits) < 2:
        return
    samples = tuple(sorted(i for _, rows in circuits for i in rows))
    apart = "; ".join(f"{_named(tuple(rows))} on {'one' if not k else 'another'}"
                      for k, (_, rows) in enumerate(circuits))
    curves = [circuit for circuit, _ in circuits]
    if not all(circuit.is_closed for circuit in curves):
        yield Defect("not judged", samples, f"circuit: {apart} curve of configurations, which "
                     "could not be followed until they close")
    elif all(any(a.may_meet(b) for b in curves if b is not a) for a in curves):
        yield Defect("branch", samples, f"{apart} curve of configurations; these meet at branch "
                     f"points only, where {curves[0].driver} does not decide on the way")
    else:
        yield Defect("circuit", samples, f"{apart} circuit: the loops would have to be opened "
                     "between them")


def _branch_defects(branches: Sequence[UsedBranch]) -> Iterator[Defect]:
    """Yield the defect of samples on several branches of one circuit."""
    if len(branches) < 2:
        return
    circuit = branches[0].circuit
    borders = [event.value for event in circuit.borders]
    named = ", ".join(f"{value:.6g}" for value in borders[:MOST_NAMED])
    more = ", ..." * (len(borders) > MOST_NAMED)
    apart = "; ".join(f"{_named(s.samples)} on {'one' if not k else 'another'}"
                      for k, s in enumerate(branches))
    yield Defect("branch", tuple(sorted(i for s in branches for i in s.samples)),
                 f"{apart} branch: {circuit.driver} would have to pass its limits or branch points "
                 f"(at {named}{more} {circuit.motion.driver_unit})")


def _named(samples: tuple[int, ...]) -> str:
    return f"sample{'s' * (len(samples) > 1)} {', '.join(map(str, samples))}"


def _beyond_limits(states: Sequence[State]) -> Iterator[Defect]:
    passed: dict[str, list[int]] = {}
    for k, state in enumerate(states):
        for passing in passed_at_start(state.mechanism, state.q, 0.0):
            passed.setdefault(passing.limit.words, []).append(k)
    for words, samples in passed.items():
        are = "are" if len(samples) > 1 else "is"
        yield Defect("joint limit", tuple(samples), f"{_named(tuple(samples))} {are} beyond the "
                     f"{words}")


def limits_passed(motion: Motion, samples: tuple[int, ...] = ()) -> tuple[Defect, ...]:
    """Return a defect for each joint limit that a motion passes, at its first passage."""
    first: dict[str, Defect] = {}
    for passing in joint_limits_passed(motion):
        words, by = passing.limit.words, -float(passing.limit.room(motion.q).min())
        most = f", by up to {by:.3g} {passing.limit.unit}" * (by > 0.0)
        where = (f"the {words} is passed {passing.where}" if passing.where else
                 f"the motion begins beyond the {words}")
        first.setdefault(words, Defect("joint limit", samples, where + most))
    return tuple(first.values())


def _transmission(
    branches: Sequence[UsedBranch], states: Sequence[State], output: str | None,
    least: float, cyclic: bool,
) -> Iterator[Defect]:
    motion, driver = branches[0].circuit.motion, branches[0].circuit.driver
    mechanism, everything = motion.mechanism, tuple(range(len(states)))
    outputs = grounded_outputs(motion) if output is None else [output]
    if len(outputs) != 1:
        yield Defect("not judged", everything, f"transmission: {len(outputs)} joints on the fixed "
                     "link may be the output: name one as output")
        return

    def angle(state: State) -> float:
        return transmission_angle(mechanism, state, outputs[0], driver)

    try:
        own = [angle(state) for state in states]
        swept = [(angle(s.circuit.motion.state(row)), float(s.circuit.motion.swept[row]))
                 for s in branches for row in s.rows(cyclic)]
    except SpatialPinError as error:
        yield Defect("not judged", everything, f"transmission: {error}")
        return
    values = [state.coordinate(driver).value for state in states]
    worst, value = min([*zip(own, values, strict=True), *swept])
    if worst < least:
        poor = tuple(i for i, x in enumerate(own) if x < least)
        yield Defect("transmission", poor, f"the transmission angle of {outputs[0]} falls to "
                     f"{np.degrees(worst):.3g}° at {driver} = {value:.6g} {motion.driver_unit}; "
                     f"{np.degrees(least):.3g}° are required")
