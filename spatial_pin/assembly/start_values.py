"""Start values: the guess, further starts around it, and whole turns of angles.

A coupling and a screw count the turns of their joints; a weld or a ball is the same after a turn.
So a gear behind a loop has made several turns only if the loop was followed through them. Hinges
that no closure counts at all have the turns of hinges that they turn with; other ones are followed
if they are set more than a turn from the guess.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import cached_property, made_anew, made_once
from spatial_pin.assembly.close import closed
from spatial_pin.assembly.holding import LoopGroup, fixed_base_entries, free_velocities, loop_groups
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import NEARLY_PARALLEL, constraints_of
from spatial_pin.constraints.composite_joints import AXES, SCREW, SLIDE, TURN, single_joints
from spatial_pin.errors import SingularError
from spatial_pin.kernel.closer import (
    AT_ONCE,
    FIXED,
    MOST_GROUPS,
    NAMED,
    TURNS,
    NamedCoordinates,
    PerturbedStarts,
    closer_of,
)
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.mechanism.coordinates import (
    by_joint,
    coordinate_value,
    finite_array,
    joint_values,
    rotation_components,
    with_values,
)
from spatial_pin.mechanism.joint_limits import position_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import EPS, Array, whole_turns
from spatial_pin.numerics.tolerances import TOLERANCES

# Most starts with other values of open coordinates. A branch that one start in ten reaches is
# missed by all in 0.2 % of cases.
MAX_STARTS = 60
OPEN = EPS**0.5  # closure error that no round-off explains: half of the digits
# round-off of a coordinate relative to its size: as in `coordinate_round_off`
COORDINATE_ERROR = 4.0 * EPS
# Distance of a branch that is surely the guess's [rad, characteristic lengths]: guesses have two or
# three digits.
NEAR_GUESS = 1e-2
# A named length beyond this may be in another unit [characteristic lengths]: joints move one or
# two, and millimetres for metres are a thousand.
ANOTHER_SIZE = 10.0
PERIODIC = ("revolute", "cylindrical", "universal", "planar")
# first of the equations that make a closure's frames parallel
PARALLEL_FRAMES = {"weld": 3, "prismatic": 2}
# Change of fixed coordinates beyond which loops are followed [rad]: with less, a loop usually turns
# by less than half a turn, which is unique.
FAR = 0.5 * math.pi
# step, and largest joint motion in a step without a change of branch [rad, characteristic lengths]
LEADING_STEP, LEAP = 0.2, 1.0
MOST_STEPS = 2000  # a hundred turns
# Change of a fixed angle beyond which hinges are followed that no closure counts [rad]: one turn,
# which the last value of a sweep over a turn has
OVER_A_TURN = 2.0 * math.pi * (1.0 + 1e-9)
SAME_CONFIGURATION = 1e-6  # rad, characteristic lengths


class Guess:
    """A start: a configuration, and its named coordinates.

    Without values all coordinates are named, at their values in q.

    Attributes:
        names: of these coordinates.
        given: what the caller gave; None: nothing.
        explicit: coordinates that the caller gave a value, turns included.
    """

    def __init__(
        self, mechanism: Mechanism, q: Array, values: Mapping[str, float] | None = None,
        given: Mapping[str, Any] | State | Array | None = None, explicit: tuple[str, ...] = (),
    ) -> None:
        self.mechanism, self.q = mechanism, q
        self.names = mechanism.coordinates if values is None else tuple(values)
        self.given, self.explicit = given, explicit
        if values is not None:
            self.values = values

    @property
    def angles(self) -> Array | None:
        """(n_angles,) of screws there [rad]; None: from the joints."""
        return self.given.angles if isinstance(self.given, State) else None

    @cached_property
    def values(self) -> Mapping[str, float]:
        """Named values, by coordinate [rad, m]."""
        entries, mechanism = self.q.tolist(), self.mechanism
        named = {c.name: entries[c.q] for c in mechanism.coordinate_table.values() if c.q >= 0}
        for joint, components in by_joint(mechanism).items():
            if components[0].q < 0:  # it turns in space: the quaternion comes last
                at = int(mechanism.model.idx_qs[mechanism.joint_id(joint)])
                turns = at + len(components) - 3
                values = entries[at:turns] + rotation_components(*entries[turns : turns + 4])
                named |= zip((c.name for c in components), values, strict=True)
        return named


def read_guess(
    mechanism: Mechanism, guess: Mapping[str, Any] | State | Array | None
) -> Guess:
    """Return the guess, by default the file's; angles with too many turns are reduced."""
    named: dict[str, float] | None = None
    if guess is None:
        return _guess_of_file(mechanism, dict(mechanism.guess))
    if isinstance(guess, State):
        own = guess.mechanism
        if own is not mechanism and own.coordinates != mechanism.coordinates:
            raise ValueError(
                f"the guess is a state of mechanism {own.name!r}, which has other coordinates than "
                f"{mechanism.name!r}")
        turns_in_space = mechanism.model.nq != mechanism.model.nv
        q = pin.normalize(mechanism.model, guess.q) if turns_in_space else guess.q
    elif isinstance(guess, Mapping):
        base, named = joint_values(mechanism, mechanism.guess), joint_values(mechanism, guess)
        q = with_values(mechanism, mechanism.neutral, base | named)
    else:
        q = finite_array(guess, (mechanism.model.nq,), "guess q")
        if not pin.isNormalized(mechanism.model, q, 0.5):
            raise ValueError("guess q has a quaternion whose length is far from 1")
        q = pin.normalize(mechanism.model, q)
    entries = q.tolist()
    if entries and max(max(entries), -min(entries)) * COORDINATE_ERROR > OPEN:
        q = q.copy()
        for c in periodic(mechanism):
            if COORDINATE_ERROR * abs(entries[c.q]) > OPEN:
                q[c.q] = math.atan2(math.sin(entries[c.q]), math.cos(entries[c.q]))
                if named and c.name in named:
                    named[c.name] = float(q[c.q])
    return Guess(mechanism, q, named, guess, tuple(named or ()))


@made_anew  # as anybody may change it
def _guess_of_file(mechanism: Mechanism, guess: Mapping[str, Any]) -> Guess:
    start = read_guess(mechanism, guess)
    start.q.flags.writeable = False
    return Guess(mechanism, start.q, start.values)


class StartSpread(NamedTuple):
    """Spread of further starts around the guess.

    Attributes:
        is_near: (MAX_STARTS - 1,) whether named coordinates are perturbed in each.
        steps: (MAX_STARTS - 1, nv) joint displacements.
        first: the first starts of each group of loops, if groups are few; else none.
        lengths: names of named lengths.
    """

    is_near: NDArray[np.bool_]
    steps: Array
    first: PerturbedStarts
    lengths: list[str]


def start_spread(
    mechanism: Mechanism, held: Sequence[str], named: Sequence[str], still: Sequence[int],
    groups: Sequence[LoopGroup],
) -> StartSpread | None:
    """Return the spread of further starts; None if all is fixed.

    Coordinates in `named` are fixed in half of the starts. Then they are perturbed too, first by up
    to a radian, at last by any angle, and lengths in proportion.
    """
    table = mechanism.coordinate_table
    is_held = np.array([name in held or c.v in still for name, c in table.items()], dtype=bool)
    if is_held.all():
        return None
    is_named = ~is_held & np.array([name in named for name in table], dtype=bool)
    is_angle = np.array([c.unit == "rad" for c in table.values()], dtype=bool)
    open_ones = ~is_held & ~is_named
    sizes = np.where(is_angle, 1.0, mechanism.velocity_scale * 0.2)
    reach = np.where(open_ones, np.pi, 0.0)
    n, late = MAX_STARTS // 2 if open_ones.any() else 0, 3 * MAX_STARTS // 4 - 1
    phase = np.repeat([0, 1, 2], [n, late - n, MAX_STARTS - 1 - late])
    size = np.array([np.where(is_named, shake, reach) * sizes for shake in (0.0, 1.0, np.pi)])
    steps = np.random.default_rng(20110).uniform(-1.0, 1.0, (MAX_STARTS - 1, len(sizes)))
    steps *= size[phase]
    first, group, n = steps[:AT_ONCE], np.zeros(len(sizes), np.int64), max(len(groups), 1)
    if n > MOST_GROUPS:  # not each by itself
        n = 0
    elif n > 1:
        first = np.concatenate([first * own.entries for own in groups])
        for k, own in enumerate(groups):
            group[own.entries] = k
    starts = PerturbedStarts(NEAR_GUESS, first[: n * AT_ONCE].copy(),
                             np.repeat(np.arange(n), AT_ONCE), group)
    return StartSpread(phase > 0, steps, starts, [x for x in named if table[x].unit == "m"])


def starts_from(
    mechanism: Mechanism, fixed: Array, held: Mapping[str, float], named: Mapping[str, float],
    spread: StartSpread,
) -> Iterator[Array]:
    """Yield start configurations with the named values of `fixed` (nq,).

    Named lengths far beyond the mechanism's size are reduced in perturbed starts.
    """
    far = far_lengths(mechanism, named, spread)
    near = with_values(mechanism, fixed, {**far, **held}) if far else fixed
    for i in range(0, MAX_STARTS - 1, AT_ONCE):
        some = slice(i, i + AT_ONCE)
        starts = np.where(spread.is_near[some, None], near, fixed)
        with kernel_of(mechanism) as kernel:
            moved = kernel.displaced(starts, spread.steps[some])
        yield from moved


def far_lengths(
    mechanism: Mechanism, named: Mapping[str, float], spread: StartSpread
) -> dict[str, float]:
    """Return the named lengths far beyond the mechanism's size, reduced."""
    far = ANOTHER_SIZE * mechanism.characteristic_length
    return {name: math.copysign(far, named[name])
            for name in spread.lengths if abs(named[name]) > far}


@made_once
def periodic(mechanism: Mechanism) -> list[Coordinate]:
    """Return the periodic angles: no closure counts their turns."""
    coupled = [mechanism.coordinate(j).name for c in mechanism.closures for j in c.joints]
    counted = np.zeros(mechanism.model.nq, dtype=bool)
    for angle in constraints_of(mechanism).angles:
        counted |= angle.is_of_joints & (angle.row != 0.0)
    return [
        c for c in mechanism.coordinate_table.values()
        if c.unit == "rad" and c.q >= 0 and c.name not in coupled and not counted[c.q]
        and mechanism.pair_of(c.joint) in PERIODIC
    ]


def turn_free_difference(mechanism: Mechanism, q: Array, other: Array) -> Array:
    """Return the difference (nv,) of two configurations without whole turns of periodic angles.

    In radians and characteristic lengths.
    """
    difference: Array = pin.difference(mechanism.model, q, other)
    turning = [c.v for c in periodic(mechanism)]
    difference[turning] -= whole_turns(difference[turning])
    return difference / mechanism.velocity_scale


def entry_kinds(
    mechanism: Mechanism, held: Iterable[str], named: Iterable[str]
) -> NDArray[np.int64]:
    """Return (nq,) flags of the entries of q, for `NamedCoordinates`; 0 for balls."""
    kinds = np.zeros(mechanism.model.nq, np.int64)
    kinds[[c.q for c in periodic(mechanism)]] = TURNS
    for names, bit in ((held, FIXED), (named, NAMED)):
        kinds[[c.q for name in names if (c := mechanism.coordinate_table[name]).q >= 0]] |= bit
    return kinds


def nearest_turn(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> Array:
    """Take whole turns off the angles: nearest to the named value, else to zero, in limits."""
    table = mechanism.coordinate_table
    value = q.copy()
    for name, x in {**named, **held}.items():
        if table[name].q >= 0:
            value[table[name].q] = x
    reference = NamedCoordinates(
        value, entry_kinds(mechanism, held, named), *position_limits(mechanism))
    with closer_of(mechanism) as closer:
        return closer.judge(q, 0.0, reference).q


def turning_with(
    mechanism: Mechanism, fixed: tuple[str, ...]
) -> tuple[NDArray[np.intp], Array]:
    """Return the periodic angles that turn with others whose turns are known.

    Hinges about one axis, whose bodies are welded together or slide in each other, turn alike.
    `fixed` are coordinates with known values, besides those whose turns are counted.

    Returns:
        Indices in q (m,); and (m, nq) by how much each turns as the others do.
    """
    given = [mechanism.coordinate_table[name].q for name in fixed]
    unknown = [c.q for c in periodic(mechanism) if c.q not in given]
    hinges, nq = _hinges(mechanism) if unknown else [], mechanism.model.nq
    known = [link for q, one, two, axis1, axis2 in hinges if q not in unknown
             for link in ((q, 1.0, one, two, axis1, axis2), (q, -1.0, two, one, axis2, axis1))]
    alike, rows = list[int](), list[Array]()
    for q, one, two, axis1, axis2 in hinges:
        turned, queue = {one: (axis1, np.zeros(nq))}, [one] if q in unknown else []
        for body in queue:
            axis, row = turned[body]
            for other, sense, here, there, at_here, at_there in known:
                if here == body and there not in turned and (
                        np.linalg.norm(np.cross(at_here, axis)) <= NEARLY_PARALLEL):
                    along = float(np.sign(at_here @ axis))
                    turned[there] = along * at_there, row.copy()
                    turned[there][1][other] += along * sense
                    queue.append(there)
        if two in turned and turned[two][0] @ axis2 > 1.0 - NEARLY_PARALLEL:
            alike.append(q)
            rows.append(turned[two][1])
    return np.array(alike, dtype=np.intp), np.array(rows).reshape(len(rows), nq)


def _hinges(mechanism: Mechanism) -> list[tuple[int, int, int, Array, Array]]:
    """Return the joints about an axis between bodies that are not parallel to each other.

    Of each its index in q, the numbers of the two bodies, or of others parallel to them, and the
    axis (3,) in the axes of each.
    """
    tree = single_joints(mechanism)
    parallel: list[tuple[int, int, Array]] = []  # two joints' bodies, rotation of 2 relative to 1
    hinges = []
    for i, (kind, parent) in enumerate(zip(tree.kind.tolist(), tree.parent.tolist(), strict=True)):
        rotation = tree.rotation[i].T
        if kind == SLIDE:
            parallel.append((parent, i, rotation))
        elif kind in (TURN, SCREW):
            hinges.append((int(tree.iq[i]), parent, i, rotation[:, 2], AXES[2]))
    for c in (mechanism.whole or mechanism).closures:
        first = PARALLEL_FRAMES.get(c.type)
        if first is None or max(c.equations or (first,)) < first:
            continue
        (one, at_one), (two, at_two) = (mechanism.frame_on_joint(name) for name in c.frames)
        one, two = int(tree.carriers[one]), int(tree.carriers[two])
        parallel.append((one, two, tree.frames[one].T @ at_one.rotation @ c.geometry.axes1
                         @ (tree.frames[two].T @ at_two.rotation @ c.geometry.axes2).T))
    body, turned = np.arange(len(tree.kind)), [AXES] * len(tree.kind)
    for one, two, rotation in parallel:
        joined, onto = turned[one] @ rotation @ turned[two].T, body[one]
        for i in np.flatnonzero(body == body[two]).tolist() if body[two] != onto else ():
            body[i], turned[i] = onto, joined @ turned[i]
    return [(q, int(body[one]), int(body[two]), turned[one] @ a, turned[two] @ b)
            for q, one, two, a, b in hinges if body[one] != body[two]]


@made_once
def uncounted(
    mechanism: Mechanism, held: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return fixed coordinates whose turns loops hide from joints that count them.

    Returns:
        Fixed angles with that property, and the other coordinates of these loops.
    """
    constraints, table = constraints_of(mechanism), mechanism.coordinate_table
    fixed = {table[name].v for name in held if table[name].q >= 0}
    tied = [{mechanism.coordinate(name).v for name in c.joints} for c in mechanism.closures]
    entry_of = {c.q: c.v for c in table.values() if c.q >= 0}
    tied += [{entry_of[q] for q in np.flatnonzero(angle.row).tolist()}
             for angle in constraints.angles if angle.is_of_joints]
    known = set(fixed)
    for _ in tied:  # coordinates that a counting closure ties to a known one
        for ends in tied:
            known |= ends if ends & known else set()
    angles = {c.v for c in table.values() if c.unit == "rad"}
    hidden = set().union(*tied) & angles - known
    by_path = {constraints.closure_of[x.equation] for x in constraints.angles
               if not x.is_of_joints}
    entries: set[int] = set()
    for group in loop_groups(mechanism, tuple(sorted(fixed))):
        own = set(np.flatnonzero(group.entries).tolist())
        if (own & hidden or by_path.intersection(group.closures)) and own & fixed & angles:
            entries |= own
    return (tuple(name for name, c in table.items() if c.v in entries & fixed & angles),
            tuple(name for name, c in table.items() if c.v in entries - fixed))


def with_followed_turns(
    mechanism: Mechanism, held: Mapping[str, float], start: Guess, standing: Iterable[str]
) -> tuple[Guess, Array, tuple[str, ...]]:
    """Return the guess, or the configuration followed from it if turns would be lost otherwise.

    Coordinates in `held` have given values, those in `standing` are fixed at the guess.

    Returns:
        The start of an assembly; the unwrapping reference (n_angles,) of screws [rad]; and
        coordinates changed by more than half a turn that could not be followed.
    """
    table = mechanism.coordinate_table
    fixed = tuple(name for name in (*held, *standing) if table[name].q >= 0)
    hidden, others = uncounted(mechanism, fixed)
    goal = with_values(mechanism, start.q, held)
    first, turned = _screws(mechanism, start.q, start.angles)
    direct = first + turned @ (goal - start.q)
    by = {name: abs(float(goal[table[name].q] - start.q[table[name].q])) for name in hidden}
    if max(by.values(), default=0.0) < FAR:
        return start, direct, ()
    still = fixed_base_entries(mechanism, (table[name] for name in held))
    free = free_velocities(mechanism, still, fixed)
    if not set(start.explicit).isdisjoint(others):  # it says how often each joint has turned
        fitting = _closed(mechanism, goal, free, direct)
        if fitting is not None and _moved(mechanism, goal, fitting[0]) < FAR:
            return start, direct, ()
    there = _followed(mechanism, start.q, goal, free, first)
    if there is None:
        return start, direct, tuple(name for name, x in by.items() if x > math.pi)
    q, reference = there
    names = dict.fromkeys((*start.names, *others))
    values = {name: coordinate_value(mechanism, table[name], q) for name in names}
    return Guess(mechanism, q, values, start.given, start.explicit), reference, ()


def _screws(mechanism: Mechanism, q: Array, angles: Array | None) -> tuple[Array, Array]:
    """Return the angles of screws at a guess (nq,), and (n_angles, nq) their coefficients."""
    counted = constraints_of(mechanism).angles
    turned = np.array([angle.row for angle in counted]).reshape(len(counted), len(q))
    return (turned @ q if angles is None or len(angles) != len(counted) else angles), turned


@made_once
def _winding(
    mechanism: Mechanism, fixed: tuple[str, ...], named: tuple[str, ...]
) -> tuple[tuple[str, ...], NDArray[np.intp], NDArray[np.intp], Array, bool]:
    """Return fixed angles that may wind periodic ones round.

    Returns:
        Fixed angles of loops with such ones; the indices in q of these (n,); what `turning_with`
        returns of the others, those with names left out; and whether these turn with others too
        than the fixed ones.
    """
    table = mechanism.coordinate_table
    explicit = [table[name].q for name in named]
    alike, rows = turning_with(mechanism, fixed)
    lower, upper = position_limits(mechanism)
    free = [c for c in periodic(mechanism) if c.q not in (*explicit, *alike) and c.name not in fixed
            and not lower[c.q] < upper[c.q] < math.inf]
    groups = loop_groups(mechanism, tuple(sorted(table[name].v for name in fixed)))
    wound = [x.entries for x in groups if any(x.entries[c.v] for c in free)]
    angles = tuple(name for name in fixed if table[name].unit == "rad" and any(
        entries[table[name].v] for entries in wound))
    is_open = np.array([q not in explicit for q in alike], dtype=bool)
    alike, rows = alike[is_open], rows[is_open]
    known = [table[name].q for name in fixed]  # counted ones only when the loops are closed
    waits = bool(np.delete(rows, known, axis=1).any())
    return angles, np.array([c.q for c in free], dtype=np.intp), alike, rows, waits


def turns_of_others(
    mechanism: Mechanism, guess: Guess, goal: Array, fixed: tuple[str, ...]
) -> Callable[[Array], tuple[Array, tuple[str, ...]]] | None:
    """Return a function that gives hinges the turns that no closure counts.

    `goal` (nq,) is the guess with the fixed coordinates at their values.

    Returns:
        A function of a closed configuration (nq,): the same with turns, and fixed angles whose
        turns others may have lost. None if nothing is set so far from the guess.
    """
    table, start = mechanism.coordinate_table, guess.q
    followed, winding, alike, rows, waits = _winding(mechanism, fixed, guess.explicit)
    far = tuple([name for name in followed if abs(
        goal.item(table[name].q) - start.item(table[name].q)) > OVER_A_TURN])
    if not (far or waits or (
            len(rows) and np.abs(rows @ (goal - start)).max() > math.pi)):
        return None
    lower, upper = position_limits(mechanism)

    def with_turns(q: Array) -> tuple[Array, tuple[str, ...]]:
        lost: tuple[str, ...] = ()
        turned, q = rows @ (q - start), q.copy()
        for at, row, x in zip(alike.tolist(), rows, turned.tolist(), strict=True):
            value = q[at] + whole_turns(start[at] + x - q[at])
            if abs(x) > math.pi and lower[at] < upper[at] and not lower[at] <= value <= upper[at]:
                lost += tuple(name for name in fixed if row[table[name].q])
            elif abs(x) > math.pi:
                q[at] = value
        if far:
            free = free_velocities(mechanism, fixed_base_entries(
                mechanism, (table[name] for name in fixed)), fixed)
            there = _followed(
                mechanism, start, q, free, _screws(mechanism, start, guess.angles)[0])
            if there is None or np.abs(
                    turn_free_difference(mechanism, there[0], q)).max() > SAME_CONFIGURATION:
                lost += far
            else:
                q[winding] += whole_turns(there[0][winding] - q[winding])
        return q, tuple(dict.fromkeys(lost))

    return with_turns


def _followed(
    mechanism: Mechanism, q: Array, goal: Array, free: NDArray[np.bool_], angles: Array
) -> tuple[Array, Array] | None:
    """Follow the loops from q (nq,) in steps until fixed coordinates are as in a goal (nq,)."""
    model, scale = mechanism.model, mechanism.velocity_scale
    change = np.where(free, 0.0, pin.difference(model, q, goal))
    n = math.ceil(float(np.abs(change / scale).max()) / LEADING_STEP)
    here, before = _closed(mechanism, q, free, angles), None
    if here is None or n > MOST_STEPS:
        return None
    for _ in range(n):
        at, angles = here
        ahead = np.where(free, 0.0 if before is None else pin.difference(model, before, at),
                         change / n)
        there = _closed(mechanism, pin.integrate(model, at, ahead), free, angles)
        if there is None or _moved(mechanism, at, there[0]) > LEAP:
            return None
        before, here = at, there
    return here


def _closed(
    mechanism: Mechanism, q: Array, free: NDArray[np.bool_], angles: Array
) -> tuple[Array, Array] | None:
    """Return the closed configuration from q (nq,), and the angles of screws; None if open."""
    try:
        result = closed(mechanism, q, free, angles, TOLERANCES.tight)
    except SingularError:
        return None
    if result.error > TOLERANCES.closed:
        return None
    if not len(angles):
        return result.q, angles
    with closer_of(mechanism) as closer:
        return result.q, closer.examine(result.q, angles).angles


def _moved(mechanism: Mechanism, q: Array, other: Array) -> float:
    """Return the largest joint displacement [rad, characteristic lengths]."""
    difference = pin.difference(mechanism.model, q, other) / mechanism.velocity_scale
    return float(np.abs(difference).max(initial=0.0))
