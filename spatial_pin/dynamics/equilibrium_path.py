"""Poses at rest as a load grows: the load-displacement curve, through its limit points.

The path of poses q at load factors x is followed by its pseudo-arclength [AllgowerGeorg2003, 4]:
a step along the tangent, then Newton steps that bring the forces into balance at a constant
distance along it. At limit points (snap-through) the load factor turns back, at branch points
(buckling) a second path crosses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from spatial_pin._support.checks import as_array, checked, finite_array, names_of, whole_number
from spatial_pin._support.columns import Quantity
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.start_values import turn_free_difference
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.derivatives.derivatives import exact_mechanism
from spatial_pin.dynamics.derivatives.small_motions import AppliedLoads, SmallMotions
from spatial_pin.dynamics.equilibrium import BALANCED, NEUTRAL, Guess, displaced_state, rest_pose
from spatial_pin.dynamics.forces import Law, external_wrenches, generalised, joint_efforts
from spatial_pin.errors import LimitError, SingularError, SpatialPinError
from spatial_pin.kernel.loop_equations import loops_at
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.limit_events import joint_limits_passed
from spatial_pin.motion.motion import Event, Motion, Output
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy, accuracy_of

# Steps of the path [rad, characteristic lengths, load factors in their unit]. Where the smallest
# one fails, the path ends.
FIRST_LENGTH, LARGEST_LENGTH, SMALLEST_LENGTH = 0.02, 0.1, 1e-7
MOST_POSES = 5000  # poses of a path: a snap-through takes fifty
MOST_RANGES = 11.0  # a load factor that leaves its range by this many ranges does not come back
POSE_CORRECTIONS = 12  # Newton steps: beyond, a shorter step of the path costs less
# After fewer corrections the next step is longer, after more it is shorter.
FEW_CORRECTIONS, MANY_CORRECTIONS = 4, 7
AT_ORIGIN = 1e-3  # distance at which a path is where it began: at a branch point half of the digits
LOAD_FACTOR = "load_factor"  # an output
BENT = 0.95  # least cosine between two tangents: with less the step is halved
# Correction that ends a search, and largest last one that is accepted where round-off is larger.
POSE_EXACT, POSE_NEARLY = 1e-13, 1e-9


@dataclass(eq=False, repr=False)
class EquilibriumPath(Motion):
    """Poses at rest along a path, one sample per pose.

    Attributes:
        load_factor: (N,) factor of the loads that grow.
        stable: (N,) whether no motion leads away from the pose.

    `v` are the changes of the joints per unit of the driven coordinate, or from sample to sample
    where a load is followed; `a` are those of `v`, interpolated.

    Example:
        >>> mech = sp.load("four_bar")
        >>> path = sp.equilibrium_path(mech, efforts={"crank": 1.0}, factors=(0.0, 0.1))
        >>> path.load_factor[[0, -1]].tolist(), bool(path.stable.all())
        ([0.0, 0.1], True)
    """

    load_factor: Array = field(default_factory=lambda: np.empty(0))
    stable: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, bool))

    @checked
    def output(self, spec: str) -> Output:
        """Return a quantity by its name, as any Motion, or `load_factor`.

        Args:
            spec: name of the quantity.

        Raises:
            UnknownNameError: it names nothing of this motion.
            SpatialPinError: it is a force.

        Example:
            >>> mech = sp.load("four_bar")
            >>> path = sp.equilibrium_path(mech, efforts={"crank": 1.0}, factors=(0.0, 0.1))
            >>> path.output("load_factor").values[[0, -1]].tolist()
            [0.0, 0.1]
        """
        if spec == LOAD_FACTOR and spec not in self.mechanism.coordinate_table:
            return Output(self.load_factor, "load factor", "1")
        return super().output(spec)

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name, as any Motion, with load factors and stability.

        Args:
            outputs: names as `output` takes them; these are returned alone.

        Raises:
            UnknownNameError: there is no such output.

        Example:
            >>> mech = sp.load("four_bar")
            >>> path = sp.equilibrium_path(mech, efforts={"crank": 1.0}, factors=(0.0, 0.1))
            >>> list(path.quantities())[-2:]
            ['load factor', 'stable']
        """
        columns = super().quantities(outputs)
        if outputs is None:
            columns |= {"load factor": Quantity(self.load_factor, "-"),
                      "stable": Quantity(self.stable)}
        return columns


class LoadPoint(NamedTuple):
    """A pose at rest on the path.

    Attributes:
        state, factor: the pose and the load factor.
        tangent: (nv + 1,) unit tangent of scaled velocities and the scaled factor.
        stiffnesses: eigenvalues of the stiffness, ascending.
        least: stiffness that is none.
        modes: (k, nv) scaled motions of these eigenvalues.
        corrections: how many Newton steps it took.
    """

    state: State
    factor: float
    tangent: Array
    stiffnesses: Array
    least: float
    modes: Array
    corrections: int

    @property
    def negatives(self) -> int:
        """Number of negative stiffnesses."""
        return int(np.count_nonzero(self.stiffnesses < -self.least))


class LoadPath:
    """The path of poses at rest of a mechanism whose loads grow."""

    def __init__(
        self, mechanism: Mechanism, hold: Iterable[str], laws: Mapping[str, Law] | None,
        efforts: Mapping[str, float] | None, external: Mapping[str, pin.Force] | None,
        accuracy: Accuracy, span: float,
    ) -> None:
        self.mechanism, self.accuracy = mechanism, accuracy
        self.hold, self.laws = tuple(hold), laws
        self._efforts, self._external = dict(efforts or {}), dict(external or {})
        self._scale = mechanism.velocity_scale
        self._effort = joint_efforts(mechanism, efforts)
        self._span = span
        self._unloaded = self.loads(0.0)
        self.unit = span or 1.0  # factor that counts as much as a rad or a characteristic length

    def loads(self, factor: float) -> AppliedLoads:
        """Return the loads at a load factor."""
        return AppliedLoads(
            self.mechanism, self.hold, None,
            {name: factor * x for name, x in self._efforts.items()},
            {name: force * factor for name, force in self._external.items()}, self.laws)

    def start(self, state: State, factor: float, along: Array) -> LoadPoint:
        """Return the point at a pose at rest; the tangent has a positive product with `along`."""
        at = SmallMotions(self.loads(factor), state)
        matrix = self._bordered(at, np.zeros(len(self._scale) + 1))[0]
        pull = np.abs(matrix[:-1, -1]).max(initial=0.0)
        if pull > TOLERANCES.nothing:
            # as strong as all forces: the stiffness may be any less, where they balance
            self.unit = min(self._span or np.inf, self.unit / float(pull))
        return self._point(at, factor, along, 0)

    def _point(
        self, at: SmallMotions, factor: float, along: Array, corrections: int
    ) -> LoadPoint:
        """Return the point at a pose at rest, its tangent continued from `along` (nv + 1,)."""
        matrix, freedoms = self._bordered(at, along)
        balanced, before = decompose(matrix[:-1], NEUTRAL).null_space, matrix[-1]
        direction = balanced.T @ (balanced @ before)
        if np.abs(direction).max() <= TOLERANCES.half_precision * np.abs(before).max():
            direction = balanced[0]  # nothing is stiff: the loads move it as they push
            direction = direction * np.sign(-matrix[:-1, -1] @ direction[:-1] * before[-1] or 1.0)
        tangent = np.append(direction[:-1] @ freedoms, direction[-1])
        reduced = at.orthonormal
        values, modes = np.linalg.eigh(0.5 * (reduced.stiffness + reduced.stiffness.T))
        return LoadPoint(at.state, factor, tangent / np.linalg.norm(tangent), values,
                         NEUTRAL * float(reduced.sizes[1].max(initial=0.0)), modes.T @ freedoms,
                         corrections)

    def _bordered(self, at: SmallMotions, row: Array) -> tuple[Array, Array]:
        """Return the matrix of the balance of forces with a last row, and the freedoms (k, nv)."""
        reduced, freedoms, k = at.orthonormal, at.freedoms, len(at.freedoms)
        size, loops = at.size or 1.0, loops_at(self.mechanism, at.state.q)
        growing = self._effort + generalised(
            loops, external_wrenches(self.mechanism, loops, self._external))
        matrix = np.zeros((k + 1, k + 1))
        matrix[:k, :k] = reduced.stiffness / size
        matrix[:k, k] = -self.unit * (freedoms @ (self._scale * growing)) / size
        matrix[k, :k], matrix[k, k] = freedoms @ row[:-1], row[-1]
        return matrix, freedoms

    def corrected(
        self, start: LoadPoint, row: Array, target: float, along: Array
    ) -> LoadPoint | None:
        """Return the pose at rest where a linear function of the displacement has a value.

        Args:
            start: the point.
            row: (nv + 1,) the function of scaled joint motions and the scaled factor.
            target: its value.
            along: (nv + 1,) direction of the first step.

        Returns:
            None where the loops do not close, or forces do not balance near the start.
        """
        state, factor, step = start.state, start.factor, along * target / float(row @ along)
        displacement, length = np.zeros(len(row)), np.inf
        for k in range(POSE_CORRECTIONS):
            there = displaced_state(self._unloaded, state, step[:-1], self.accuracy)
            if there is None:
                return None
            displacement[:-1] += turn_free_difference(self.mechanism, state.q, there.q)
            displacement[-1] += step[-1]
            state, factor = there, start.factor + self.unit * float(displacement[-1])
            at = SmallMotions(self.loads(factor), state)
            matrix, freedoms = self._bordered(at, row)
            load = at.orthonormal.load / (at.size or 1.0)
            rhs = np.append(load, target - float(row @ displacement))
            # minimum norm: idle rotations have no stiffness, and do not move
            solution = decompose(matrix, NEUTRAL).minimum_norm(rhs)
            if np.abs(matrix @ solution - rhs).max() > BALANCED:
                return None  # neither pose nor load factor balances it
            step = np.append(solution[:-1] @ freedoms, solution[-1])
            before, length = length, float(np.abs(step).max())
            if length <= POSE_EXACT or (before <= POSE_NEARLY and length >= 0.5 * before):
                return self._point(at, factor, row if np.any(row[:-1]) else along, k + 1)
            if np.abs(step[:-1]).max(initial=0.0) > 2.0 * LARGEST_LENGTH:
                return None
        return None

    def displacement(self, start: LoadPoint, end: LoadPoint) -> Array:
        """Return how far (nv + 1,) one point is from another, whole turns of angles apart."""
        return np.append(turn_free_difference(self.mechanism, start.state.q, end.state.q),
                         (end.factor - start.factor) / self.unit)


def steps(path: LoadPath, first: LoadPoint, ends: tuple[float, float]) -> Iterator[LoadPoint]:
    """Yield the points of the path until the factor is the last one, and there exactly.

    Or until it is far from its range.

    Raises:
        SingularError: the path cannot be followed further.
    """
    point, length = first, FIRST_LENGTH
    while True:
        there = path.corrected(point, point.tangent, length, point.tangent)
        if there is None or there.tangent @ point.tangent < BENT:
            length *= 0.5
            if length < SMALLEST_LENGTH:
                raise SingularError(
                    f"mechanism {path.mechanism.name!r}: the poses at rest cannot be followed "
                    f"beyond load factor {point.factor:.6g}, {point.state}", state=point.state)
            continue
        if (there.factor - ends[1]) * (ends[0] - ends[1]) <= 0.0:
            row = np.append(np.zeros(len(point.tangent) - 1), 1.0)
            last = path.corrected(
                point, row, (ends[1] - point.factor) / path.unit, there.tangent)
            yield there if last is None else last._replace(factor=ends[1])
            return
        yield there
        point = there
        if abs(there.factor - ends[1]) > MOST_RANGES * abs(ends[0] - ends[1]):
            return
        if there.corrections <= FEW_CORRECTIONS:
            length = min(1.5 * length, LARGEST_LENGTH)
        elif there.corrections > MANY_CORRECTIONS:
            length *= 0.6


def comes_back(path: LoadPath, origin: LoadPoint, before: LoadPoint, after: LoadPoint) -> bool:
    """Whether a path passes a pose again between two points, in the sense that it had there."""
    if origin.tangent @ before.tangent < BENT:
        return False
    length = float(path.displacement(before, origin) @ before.tangent)
    if not 0.0 <= length <= float(path.displacement(before, after) @ before.tangent):
        return False
    there = path.corrected(before, before.tangent, length, before.tangent)
    return there is not None and float(
        np.abs(path.displacement(there, origin)).max()) < AT_ORIGIN


def critical_point(
    path: LoadPath, before: LoadPoint, after: LoadPoint, row: int
) -> tuple[Event, LoadPoint] | None:
    """Return the limit or branch point between two points, and the pose there."""
    turns = before.tangent[-1] * after.tangent[-1] < 0.0
    if not turns and before.negatives == after.negatives:
        return None
    which = min(before.negatives, after.negatives)
    whole = float(before.tangent @ path.displacement(before, after))

    def at(part: float) -> LoadPoint:
        point = path.corrected(before, before.tangent, part * whole, before.tangent)
        return after if point is None else point

    def value(point: LoadPoint) -> float:
        return float(point.tangent[-1] if turns else point.stiffnesses[which])

    part = sign_change(lambda x: value(at(x)) if x else value(before), 0.0, 1.0,
                       value(before), value(after))
    there = at(part) if 0.0 < part < 1.0 else after if part else before
    kind = "limit point" if turns else "branch point"
    text = ("the load factor turns back" if turns else
            "another path of poses at rest crosses: the mechanism buckles")
    return Event(kind, float(there.factor), row, f"{text} at {there.factor:.9g}"), there


@checked
def equilibrium_path(
    mechanism: Mechanism,
    guess: Guess = None,
    *,
    efforts: Mapping[str, float] | None = None,
    external: Mapping[str, pin.Force] | None = None,
    factors: ArrayLike = (0.0, 1.0),
    over: str | None = None,
    values: ArrayLike | None = None,
    branch: int = 0,
    hold: str | Iterable[str] | None = None,
    laws: Mapping[str, Law] | None = None,
    accuracy: Accuracy | None = None,
) -> EquilibriumPath:
    """Follow the poses at rest as a load grows, through snap-through, snap-back and buckling.

    The path begins at the pose at rest to which the guess leads at the first factor, and ends at
    the last factor; on the way it may turn back any number of times. It also ends where it is
    closed. With `over` a coordinate goes through values, and the load factor is what holds it
    there (displacement control).

    Args:
        mechanism: the mechanism.
        guess: where the search for the first pose starts, as for `equilibrium`.
        efforts: by driver, joint or coordinate, the efforts that grow, at factor 1 [N·m, N].
        external: by link, frame or joint, the forces that grow, at factor 1, world axes.
        factors: (2,) the first load factor, and the last.
        over: a coordinate that goes through `values` instead.
        values: (N,) its values [rad, m].
        branch: number of the branch point, from 1, at which the path that crosses is taken;
            negative for its other direction. 0 goes straight on.
        hold: names of joints, coordinates or drivers that stand still; "base" for a free base.
        laws: of springs, as for `equilibrium`.
        accuracy: of closing; default "engineering".

    Returns:
        The EquilibriumPath, a Motion with load factors and stability. Events are of kind "limit
        point", "branch point" and "joint limit"; their value is the load factor. Where a load is
        followed, the row of the first two is the pose there.

    Raises:
        SpatialPinError: there is no pose at rest to begin with, or the loads move nothing.
        LimitError: the coordinate cannot reach a value.
        SingularError: the path cannot be followed further.
        UnknownNameError: a name does not exist.

    Example:
        >>> mech = sp.load("four_bar")
        >>> path = sp.equilibrium_path(mech, efforts={"crank": 1.0}, over="crank",
        ...                            values=np.linspace(-1.8, 1.8, 19))
        >>> event = path.events[0]  # the largest effort that it takes, and where
        >>> event.kind, round(event.value, 4), event.row  # [N·m]
        ('limit point', 1.3326, 7)
    """
    setting = accuracy_of(accuracy)
    lo, hi = finite_array(factors, (2,), "factors").tolist()
    whole_number(branch, "branch")
    state = assembled(mechanism, None, guess, accuracy=setting)
    path = LoadPath(exact_mechanism(state), () if hold is None else names_of(hold, "hold"), laws,
                    efforts, external, setting, abs(hi - lo) if over is None else 0.0)
    mechanism = path.mechanism
    if over is None:
        at, _ = rest_pose(path.loads(lo), state, True, setting)
        along = np.append(np.zeros(mechanism.model.nv), np.sign(hi - lo) or 1.0)
        points, events = _along(path, path.start(at.state, lo, along), (lo, hi), branch)
    else:
        if values is None:
            raise SpatialPinError("over needs values, those that the coordinate goes through")
        points, events = _over(path, state, over, as_array(values, "values"))
    return _motion(path, points, events, over)


def _along(
    path: LoadPath, first: LoadPoint, ends: tuple[float, float], branch: int
) -> tuple[list[LoadPoint], list[Event]]:
    points, events, crossed = [first], list[Event](), 0
    going, origin, since, end = steps(path, first, ends), first, 1, ""
    while (there := next(going, None)) is not None and len(points) < MOST_POSES:
        if len(points) > since + 1 and comes_back(path, origin, points[-1], there):
            points.append(origin)
            end = ": the path is closed, and is where it began"
            break
        leaves = crossed and points[-1] is origin  # the branch point itself has been met
        met = None if leaves else critical_point(path, points[-1], there, len(points))
        if met is not None:
            event, at = met
            events.append(event)
            points += [at] if at is not points[-1] and at is not there else []
            crossed += event.kind == "branch point"
            if crossed == abs(branch) and event.kind == "branch point":
                mode = at.modes[int(np.argmin(np.abs(at.stiffnesses)))]
                mode = np.append(mode / np.linalg.norm(mode), 0.0)
                mode *= np.sign(branch) * np.sign(mode[np.argmax(np.abs(mode))])
                origin = at._replace(tangent=mode)
                points = [x for x in points if x is not at] + [origin]
                since = len(points)
                going = steps(path, origin, ends)
                continue
        points.append(there)
    if points[-1].factor != ends[1]:
        events.append(Event("stopped", points[-1].factor, len(points),
                            f"the load factor does not come to {ends[1]:.6g}: after "
                            f"{len(points)} poses it is {points[-1].factor:.6g}{end}"))
    return points, events


def _over(
    path: LoadPath, state: State, over: str, values: Array
) -> tuple[list[LoadPoint], list[Event]]:
    """Return the poses at which a coordinate has values, and the events between them."""
    mechanism = path.mechanism
    coordinate = mechanism.driven_coordinate(over)
    held = assembled(mechanism, {over: float(values[0])}, state, accuracy=path.accuracy)
    at, _ = rest_pose(AppliedLoads(mechanism, [*path.hold, over], laws=path.laws), held, True,
                    path.accuracy)
    row = np.zeros(mechanism.model.nv + 1)
    row[coordinate.v] = 1.0
    first = path.start(at.state, 0.0, row)
    start = path.corrected(first, row, 0.0, first.tangent + row)
    if start is None:
        raise SpatialPinError(f"mechanism {mechanism.name!r}: no load factor holds {over} = "
                              f"{float(values[0]):.6g}: at {at.state} nothing balances")
    points, events = [start], list[Event]()
    size = mechanism.velocity_scale[coordinate.v]
    for value in values[1:].tolist():
        point, parts = points[-1], 1.0
        while abs(value - float(point.state.q[coordinate.q])) > TOLERANCES.tight * size:
            distance = (value - float(point.state.q[coordinate.q])) / size
            step = parts * np.sign(distance) * min(abs(distance), LARGEST_LENGTH)
            moves = float(point.tangent[coordinate.v])
            there = path.corrected(point, row, step, point.tangent / moves if moves else row)
            if there is None:
                parts *= 0.5
                if parts < SMALLEST_LENGTH:
                    raise LimitError(
                        f"mechanism {mechanism.name!r}: {over} = {value:.6g} cannot be reached at "
                        f"rest: from {point.state} on nothing balances",
                        limit=float(point.state.q[coordinate.q]),
                        motion=_motion(path, points, events, over))
                continue
            met = critical_point(path, point, there, len(points))
            if met is not None:
                event, passed = met
                events.append(event._replace(
                    text=f"{event.text}, {over} = {passed.state.q[coordinate.q]:.9g}"))
            point, parts = there, min(2.0 * parts, 1.0)
        points.append(point)
    return points, events


def _motion(
    path: LoadPath, points: list[LoadPoint], events: list[Event], over: str | None
) -> EquilibriumPath:
    """Return the motion through some poses."""
    from scipy.interpolate import CubicSpline  # on use: it takes a tenth of a second

    mechanism = path.mechanism
    q = np.array([x.state.q for x in points])
    factor = np.array([x.factor for x in points])
    tangents = np.array([x.tangent[:-1] for x in points]) * mechanism.velocity_scale
    if over is None:
        abscissa = np.arange(len(points), dtype=float)
        if len(points) > 1:  # times how fast the path's length grows from sample to sample
            poses = [np.linalg.norm(turn_free_difference(mechanism, x.state.q, y.state.q))
                     for x, y in pairwise(points)]
            length = np.append(0.0, np.cumsum(np.hypot(poses, np.diff(factor) / path.unit)))
            tangents = tangents * np.gradient(length)[:, None]
        driver, name, per = None, "", "sample"
    else:
        coordinate = mechanism.driven_coordinate(over)
        driver = abscissa = q[:, coordinate.q]
        name, per = over, coordinate.unit
        tangents = tangents / tangents[:, [coordinate.v]]
    steps = np.diff(abscissa)
    rising = len(abscissa) > 1 and (np.all(steps > 0.0) or np.all(steps < 0.0))
    sense = 1.0 if not rising or abscissa[-1] > abscissa[0] else -1.0
    a = np.zeros_like(tangents)
    if rising:
        a = np.array(CubicSpline(sense * abscissa, sense * tangents)(sense * abscissa, 1))
    motion = EquilibriumPath(
        mechanism, driver, name, None, q, tangents, a,
        np.array([x.state.closure_error for x in points]), np.ones(len(points)), events,
        np.array([x.state.angles for x in points]), per, (),
        load_factor=factor, stable=np.array([x.negatives == 0 for x in points]))
    passed = [p.event for p in joint_limits_passed(motion)]
    rows = np.arange(len(points), dtype=float)
    motion.events = sorted([*events, *(
        e._replace(value=float(np.interp(e.value if over is None else e.row, rows, factor)))
        for e in passed)], key=lambda e: e.row)
    return motion
