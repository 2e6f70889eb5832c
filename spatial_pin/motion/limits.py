"""How far a driver can go, and the whole curve of closed configurations through its limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import BASE, Hold, divided
from spatial_pin.assembly.newton import SquareSystem
from spatial_pin.assembly.passive_freedoms import moved_bodies
from spatial_pin.assembly.state import State
from spatial_pin.checks import checked, positive_number
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.continuation.branch_points import straight_on
from spatial_pin.continuation.pseudo_arclength import Arrival, march, turning_point
from spatial_pin.continuation.singular_points import located, room_after, room_ahead
from spatial_pin.continuation.solution_curve import Curve, CurvePoint
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.motion.joint_range import within_joint_limits
from spatial_pin.motion.motion import Event, Motion
from spatial_pin.motion.ranges import Bound, Range
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import prescribed_at
from spatial_pin.settings import Accuracy

TURN = 2.0 * np.pi
FARTHEST_SLIDE = 20.0  # characteristic lengths; a slide that goes further has no limit
REPEATED = 1e-6  # difference of placements that are the same again
MOST_TURNS = 100  # turns of a driver that leads elsewhere with every turn
SAME = 1e-6  # difference of crossings seen from either side that are one [rad or m]
BESIDE = 0.05  # arc length that a start on a dead centre is moved by
# Steps that the bodies may still be away by where a curve closes: one, if they moved as fast all
# along the last step as in the first; two and a half, as they do not.
STEPS_NEAR = 2.5


@checked
def limits(
    mechanism: Mechanism,
    driver: str,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    joints: bool = False,
    hold: Hold = BASE,
) -> Range:
    """Find how far a driver can go either way on the branch of a guess.

    Dead centres are located by arc length, where the driver turns back, to about 1e-14.

    Args:
        mechanism: the mechanism; other drivers stay where the guess has them.
        driver: a driver or coordinate.
        guess: where to start, as for `assemble`.
        joints: end the range where a joint, the driver's own among them, reaches a limit of the
            URDF: the bound is then of kind "upper limit of" or "lower limit of" that joint.
        hold: names of what stands still besides, as for `sweep`.

    Raises:
        AssemblyError: the guess does not close.
        SingularError: the guess closes in a singular configuration.
        SpatialPinError: with `joints`, the guess closes beyond a joint limit.
    """
    system, state = _system(mechanism, driver, guess, hold)
    coordinate = system.driven[0]
    start = float(state.q[coordinate.q])
    span = TURN if coordinate.unit == "rad" else FARTHEST_SLIDE * mechanism.characteristic_length
    direction = _direction(system)
    ends = [_bound(system, state, start, sense, span, direction) for sense in (-1.0, 1.0)]
    turns = coordinate.unit == "rad" and all(end.kind == "none" for end in ends)
    found = Range(driver, ends[0], ends[1], coordinate.unit, turns)
    return within_joint_limits(state.mechanism, state, found, span, hold) if joints else found


def _bound(
    system: SquareSystem, state: State, start: float, sense: float, span: float, direction: Array
) -> Bound:
    """Go one span after the other until a limit, or until a turn ends where it began."""
    tolerance = Accuracy.named("engineering").tolerance
    evaluation = system.evaluation
    evaluation.turns[:] = state.angles
    evaluation.update(state.q)
    bodies = _not_spinning(system)
    place, angles, q = _body_places(evaluation, bodies), evaluation.angles.copy(), state.q
    for k in range(1, MOST_TURNS + 1):
        arrival = march(system, q, start + sense * k * span, direction, tolerance)
        if arrival.kind == "lost":
            return Bound(arrival.value, "not followed further")
        if arrival.kind != "reached":
            return Bound(arrival.value, arrival.kind)
        evaluation.update(arrival.q)
        repeats = np.abs(_body_places(evaluation, bodies) - place).max(initial=0.0) < REPEATED
        if system.driven[0].unit != "rad" or (repeats and np.allclose(evaluation.angles, angles)):
            return Bound(sense * np.inf, "none")
        q = arrival.q
        evaluation.turns[:] = evaluation.angles
        system.select(q)
        direction = _direction(system)
    return Bound(start + sense * MOST_TURNS * span, "not followed further")


@checked
def trace(
    mechanism: Mechanism,
    driver: str,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    step: float = 0.02,
    most_rows: int = 20_000,
    hold: Hold = BASE,
) -> Motion:
    """Follow the curve of closed configurations by arc length, through limits, until it closes.

    Args:
        mechanism: the mechanism; other drivers stay where the guess has them.
        driver: the driver or coordinate that is set free; its values are `Motion.driver`.
        guess: where to start, as for `assemble`.
        step: arc length from row to row [rad, characteristic lengths].
        most_rows: where to stop in any case.
        hold: names of what stands still besides, as for `sweep`.

    Returns:
        A Motion whose rates are with respect to the arc length; limit positions, and crossings
        with other branches that are passed straight on, are its events.
        The last row is the first one again, in which bodies that spin freely jump back; if the
        curve was not closed within `most_rows`, the last event is of kind "not closed".

    Raises:
        AssemblyError: the guess does not close.
        SingularError: branches cross and none goes straight on; `.motion` holds what came before.
    """
    step = positive_number(step, "step")
    system, state = _system(mechanism, driver, guess, hold)
    curve = Curve(system, Accuracy.named("engineering").tolerance)
    first = curve.settle(state.q, _direction(system) / system.scale)
    if first is None:
        raise SingularError(f"mechanism {mechanism.name!r}: branches cross at the start, {state}",
                            state=state)
    rows = _TracedRows(curve, driver, state.mechanism)
    rows.add(first)
    rows.room = room_ahead(curve, first)
    point = first
    while len(rows.points) < most_rows:
        ahead = _advance(curve, point, step, rows)
        if isinstance(ahead, Arrival):
            beyond = straight_on(curve, point)
            if beyond is not None:
                rows.note_crossings(point, beyond)
                point = beyond
                rows.add(point)
                continue
            motion = rows.motion()
            raise SingularError(
                f"mechanism {mechanism.name!r}: the curve cannot be followed beyond {driver} = "
                f"{ahead.value:.12g}: {ahead.kind}", motion=motion,
            )
        point = ahead
        if rows.is_back(point, step):
            rows.add_first_again()
            break
        rows.add(point)
    else:
        rows.note("not closed", float(point.q[curve.driver.q]))
    return rows.motion()


def _system(
    mechanism: Mechanism, driver: str, guess: Mapping[str, Any] | State | Array | None, hold: Hold
) -> tuple[SquareSystem, State]:
    """Return the square system with `driver` prescribed first, at the assembled guess or near it.

    Where the guess is just a dead centre of the driver, a point a little further on is taken.
    """
    state = assembled(mechanism, {}, guess)
    mechanism = state.mechanism  # of a rounded file one without the equations that it contradicts
    driven = [mechanism.driven_coordinate(c.name) for c in prescribed_at(state, [driver], hold)]
    still = divided(mechanism, driven, hold)[1]
    try:
        return _square(mechanism, driven, state, still), state
    except SingularError as error:
        beside = _beside(mechanism, driven, state, still)
        if beside is None:
            raise error
    return _square(mechanism, driven, beside, still), beside


def _square(
    mechanism: Mechanism, driven: Sequence[Coordinate], state: State, still: Sequence[int]
) -> SquareSystem:
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.turns[:] = state.angles
    system = SquareSystem(evaluation, driven, state.q, still)
    system.check_regular(state.q)
    return system


def _beside(
    mechanism: Mechanism, driven: Sequence[Coordinate], state: State, still: Sequence[int]
) -> State | None:
    """Return a closed state a little further along the curve, found with another driver."""
    for other in mechanism.coordinate_table.values():
        if other.q < 0 or other in driven or other.v in still:
            continue
        try:
            system = _square(mechanism, [other, *driven[1:]], state, still)
        except SingularError:
            continue
        curve = Curve(system, Accuracy.named("engineering").tolerance)
        point = curve.settle(state.q, _direction(system) / system.scale)
        q = curve.ahead(point, BESIDE) if point is not None else None
        if q is not None:
            return State(mechanism, q, closure_error=curve.evaluation.closure_error,
                         angles=curve.evaluation.angles)
    return None


def _direction(system: SquareSystem) -> Array:
    """Return dq/d(driver) (nv,) at the system's configuration."""
    return system.driver_rates()[:, 0]


def _advance(
    curve: Curve, point: CurvePoint, step: float, rows: _TracedRows
) -> CurvePoint | Arrival:
    """Go one row further, by smaller steps where the curve bends, noting limits on the way."""
    left, length = step, step
    at = curve.driver.q
    while left > 1e-12 * step:
        length = min(length, left, 0.5 * rows.room)  # two crossings in one step are not noticed
        ahead = curve.ahead(point, length)
        t, sign = curve.direction(ahead, point.t) if ahead is not None else (point.t, 0)
        if length < min(1e-6 * step, left):
            return Arrival("branch point", point.q, float(point.q[at]))
        if ahead is None or t @ point.t < 0.98 or sign != point.sign:
            length *= 0.5
            continue
        if curve.slope(t) * curve.slope(point.t) < 0.0:
            limit = curve.ahead(point, turning_point(curve, point, length))
            if limit is not None:
                rows.note("limit", float(limit[at]))
        settled = curve.settle(ahead, t)
        if settled is None:
            return Arrival("branch point", ahead, float(ahead[at]))
        rows.room = room_after(point, settled, length)
        point, left = settled, left - length
    return point


def _not_spinning(system: SquareSystem) -> list[int]:
    """Return the bodies without passive freedoms, resolved or not, where the system stands.

    The others need not come back with the loops: what they spin over a turn is no whole one.
    """
    evaluation, mechanism = system.evaluation, system.evaluation.mechanism
    spinning = {joint for joint, _ in evaluation.constraints.spins}
    if len(system.passive):
        spinning |= set(moved_bodies(evaluation, system.passive * system.scale))
    return [i for i in range(mechanism.model.njoints) if i not in spinning]


def _body_places(evaluation: Evaluation, bodies: list[int]) -> Array:
    """Return the placements of bodies, lengths scaled."""
    scale = np.array([1.0, 1.0, 1.0, evaluation.mechanism.characteristic_length])[:, None]
    return evaluation.placements[bodies] / scale


class _TracedRows:
    """Rows of a traced curve."""

    def __init__(self, curve: Curve, driver: str, mechanism: Mechanism) -> None:
        self.curve, self.driver, self.mechanism = curve, driver, mechanism
        self.points: list[CurvePoint] = []
        self.accelerations: list[Array] = []
        self.errors: list[float] = []
        self.places: list[Array] = []
        self.events: list[Event] = []
        self.room = np.inf  # arc length ahead to where the closure rows would lose their rank
        self.near, self.has_left = np.inf, False  # how near to the first place counts as back there

    def add(self, point: CurvePoint) -> None:
        """Keep a point, with the second derivative of the curve there."""
        model = self.curve.model
        self.points.append(point)
        self.accelerations.append(self.curve.curvature(point))
        self.errors.append(self.curve.evaluation.closure_error)
        if len(self.points) < 2:
            self.bodies = _not_spinning(self.curve.system)
            self.own = np.isin(np.repeat(np.arange(model.njoints), model.nvs), self.bodies)
            self.first_place = _body_places(self.curve.evaluation, self.bodies)

    def is_back(self, point: CurvePoint, step: float) -> bool:
        """Whether all bodies are within a step of where they began, moving the same way.

        But for those that spin freely, whose joints have other axes then. Where many joints share
        a step of arc length, bodies move by a small part of it only.
        """
        self.curve.rows(point.q)
        places = _body_places(self.curve.evaluation, self.bodies)
        gap = float(np.abs(places - self.first_place).max())
        if len(self.points) == 1:
            self.near = min(step, STEPS_NEAR * gap)
        if gap >= self.near:
            self.has_left = True
        now, first = (x.t[self.own] for x in (point, self.points[0]))
        same_way = now @ first > 0.5 * np.sqrt((now @ now) * (first @ first))
        return bool(self.has_left and gap < self.near and same_way)

    def add_first_again(self) -> None:
        """End with the first configuration, angles counted on."""
        first, last = self.points[0], self.points[-1]
        q = first.q.copy()
        for c in self.mechanism.coordinate_table.values():
            if c.q >= 0 and c.unit == "rad":
                q[c.q] += TURN * np.round((last.q[c.q] - q[c.q]) / TURN)
        self.points.append(first._replace(q=q))
        self.accelerations.append(self.accelerations[0])
        self.errors.append(self.errors[0])

    def note(self, kind: str, value: float) -> None:
        """Keep a limit position, a crossing, or an end before the curve is closed, as an event."""
        unit = self.mechanism.coordinate(self.driver).unit
        words = {"limit": "limit position (dead centre)",
                 "branch point": "branch point, passed straight on,",
                 "not closed": f"not closed within {len(self.points)} rows: left off"}
        text = f"{words[kind]} at {self.driver} = {value:.12g} {unit}"
        self.events.append(Event(kind, value, len(self.points), text))

    def note_crossings(self, point: CurvePoint, beyond: CurvePoint) -> None:
        """Keep the crossings between two points: as seen from both, there may be more than one."""
        back = beyond._replace(t=-beyond.t, sign=-beyond.sign)
        seen = [located(self.curve, x) for x in (point, back)]
        values = [found[1] for found in seen if found is not None]
        for k, value in enumerate(values):
            if not k or abs(value - values[0]) > SAME:
                self.note("branch point", value)
        self.room = room_ahead(self.curve, beyond)

    def motion(self) -> Motion:
        """Return the rows as a Motion over the arc length."""
        scale = self.curve.scale
        q = np.array([p.q for p in self.points])
        v = np.array([scale * p.t for p in self.points])
        driver = self.curve.driver
        return Motion(
            mechanism=self.mechanism, driver=q[:, driver.q].copy(), driver_name=self.driver,
            time=None, q=q, v=v, a=np.array(self.accelerations),
            closure_error=np.array(self.errors), driver_speed=v[:, driver.v].copy(),
            events=self.events, angles=np.array([p.angles for p in self.points]), per="length",
        )
