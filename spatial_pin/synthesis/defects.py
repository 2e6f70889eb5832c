"""Defects of a synthesised mechanism: circuit, branch, order, transmission [ChaseMirth1993].

A joint limit that the motion passes is a defect too: the loop equations do not contain limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin._support.checks import checked
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.dead_centres import grounded_outputs
from spatial_pin.motion.limit_events import joint_limits_passed, passed_at_start
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.transmission import transmission_angle
from spatial_pin.synthesis.circuits import Circuit, CircuitPosition, circuits_through

LEAST_ANGLE = float(np.radians(40.0))  # transmission angle that textbooks recommend
ALL = "circuit, branch, order and transmission"
MOST_NAMED = 4  # driver values of borders in a sentence


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
            numbers = sorted({b for x in rest.values() for b in x.branches})
            best = max(numbers, key=lambda b: sum(b in x.branches for x in rest.values()))
            own = [i for i, x in rest.items() if best in x.branches]
            values = np.array([rest.pop(i).value for i in own])
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
