"""Assembly: from a rough guess to a closed configuration; start states of verbs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import checked, mapping
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.assembly_problem import ACCEPTED, AssemblyProblem, deviations
from spatial_pin.assembly.close import beyond_words, closed
from spatial_pin.assembly.holding import Hold, fixed_base_entries, free_velocities, held_by
from spatial_pin.assembly.redundant_equations import (
    allowed_from,
    gap_allowed,
    without_rounded_equations,
)
from spatial_pin.assembly.search import Search, closed_at_once, failure
from spatial_pin.assembly.start_values import (
    Guess,
    read_guess,
    turn_free_difference,
    with_followed_turns,
)
from spatial_pin.assembly.state import NO_ANGLES, State, made, of_mechanism
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.errors import AssemblyError, SingularError, warn
from spatial_pin.kernel.closer import Examined
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import (
    coordinate_value,
    driver_coordinates,
    finite_number,
    joint_values,
    require_mechanism,
    with_values,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy, accuracy_of

_WARNED: WeakSet[Mechanism] = WeakSet()  # mechanisms with a warning by `warn_of_rounding` already
# Largest motion on one branch [rad, characteristic lengths]; near a singular configuration branches
# are as near as that.
SAME_BRANCH = 0.3
LEAST_PART = 2.0**-10  # shortest step, as a part of the motion, that is still tried
# distance of two branches [rad, characteristic lengths]: above round-off near a dead centre
BRANCHES_APART = 1e-3


@checked
def assemble(
    mechanism: Mechanism,
    drivers: Mapping[str, float] | None = None,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    limits: bool = False,
    release: bool = True,
    free: Iterable[str] = (),
    gap: float | None = None,
    accuracy: Accuracy | None = None,
) -> State:
    """Close the loops of a mechanism.

    A driver with a value has it exactly. A driver without a value keeps its value from the guess,
    or its neutral value if the guess does not name it. (If the guess names other joints only, and
    the loops do not close with the drivers at neutral, the loops move these drivers; with
    `release=False` they do not.)

    The guess decides the branch. First its named coordinates are held and the rest is solved; then
    all are solved together. If several branches are close, the one nearest to the named values is
    returned. A free base (a floating joint that alone carries a whole machine) stays where the
    guess has it.

    If the loops cannot close with these values, the drivers without a value are released and move
    as little as possible: the sum of the squares of their moves is the least on the branch (angles
    in rad, slides in characteristic lengths). `State.released` names each driver and its move. This
    usually ends at a dead centre of these drivers, where they could not move on. Therefore, if no
    driver has a value at all, the guess as a whole is closed instead.

    Args:
        mechanism: the mechanism.
        drivers: values of drivers or coordinates to hold exactly [rad, m].
        guess: values by joint or coordinate as in the mechanism file [rad, m], a State, or q (nq,);
            default the file's guess; neutral for all others. Whole turns are taken off angles so
            large that their round-off would open the loops. Where couplings or screws count turns
            that other loops do not, these are followed from the guess to values set further off
            than a quarter of a turn.
        limits: keep the joint limits of the URDF.
        release: let drivers without a value move if the loops cannot close otherwise; False raises
            instead.
        free: names of drivers that move with the loops from the first; not among `released`.
        gap: largest closure error that redundant equations may keep where the file's numbers are
            rounded [-], default that of the mechanism, else of `accuracy`; 0 refuses them. A
            `SpatialPinWarning` tells of
            it once, `State.gap` always.
        accuracy: tolerance to reach; default "engineering".

    Returns:
        The closed State; its v and a are zero, see `solve_rates`. A `SpatialPinWarning` tells of
        joint limits that it breaks, as `State.beyond_limits` does, and of turns that may be lost,
        as `State.lost_turns` does; another, where the guess is a State, of loops that are on
        another branch than there.

    Raises:
        AssemblyError: no closed configuration found; keeps the best attempt.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite, or `free` names a held driver, or no driver at all.

    Example:
        >>> mech = sp.load("rssr")
        >>> state = sp.assemble(mech, {"crank": np.pi / 2})  # [rad]
        >>> print(f"{state.coordinate('rocker_pin').value:.4f} rad")
        1.7495 rad
        >>> state.closure_error < 1e-13
        True
    """
    state = assembled(mechanism, drivers, guess, limits=limits, release=release, free=free,
                      accuracy=accuracy, gap=gap)
    if state.beyond_limits:
        words = "; ".join(beyond_words(mechanism, state.q, name) for name in state.beyond_limits)
        warn(f"mechanism {mechanism.name!r} stands beyond joint limits: {words} "
             "(assemble(limits=True) keeps them)")
    if isinstance(guess, State) and guess.mechanism is state.mechanism and not state.released:
        changed = branch_changed(guess, state, drivers or (), free)
        if changed:
            warn(changed)
    return state


def assembled(
    mechanism: Mechanism,
    drivers: Mapping[str, float] | None = None,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    limits: bool = False,
    release: bool = True,
    free: Iterable[str] = (),
    accuracy: Accuracy | None = None,
    gap: float | None = None,
) -> State:
    """Close loops like `assemble`, for verbs whose results report joint limits themselves."""
    require_mechanism(mechanism)
    accuracy = accuracy_of(accuracy)
    gap = gap_allowed(mechanism, accuracy) if gap is None else gap
    problem = assembly_problem(mechanism, held_values(mechanism, drivers), guess,
                               accuracy.tolerance, gap, free, release)
    return solved(problem, limits, release, together=free == ())


def held_values(
    mechanism: Mechanism, drivers: Mapping[str, float] | None
) -> dict[str, float]:
    """Return values by coordinate, from values by driver, joint or coordinate [rad, m].

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite, or a coordinate has two values.
    """
    held: dict[str, float] = {}
    for name, value in mapping(drivers, "drivers").items():
        coordinate = mechanism.prescribed_coordinate(name).name
        if coordinate in held:
            raise ValueError(f"{coordinate!r} is given two values")
        held[coordinate] = finite_number(value, f"driver {name!r}")
    return held


def assembly_problem(
    mechanism: Mechanism, held: Mapping[str, float], guess: Any, tolerance: float, gap: float,
    free: Iterable[str] = (), release: bool = True,
) -> AssemblyProblem:
    """Return the assembly problem: equations, fixed coordinates and start.

    `free` are drivers that are not fixed. `release`: whether drivers without a value may move.
    """
    whole = mechanism.whole or mechanism
    if gap and isinstance(guess, State) and guess.mechanism.whole is whole:
        if mechanism is whole:
            mechanism = guess.mechanism  # it goes on with the equations that were chosen for it
        gap = allowed_from(guess, gap)
    elif (exact := without_rounded_equations(mechanism, gap)) is not None:
        mechanism = exact
    start = read_guess(mechanism, guess)
    driver_values = standing = default_driver_values(
        mechanism, held, start, free, taken_along=release)
    beginning = mechanism.start(held) if guess is None else None
    if beginning is not None:
        start, table = read_guess(mechanism, beginning), mechanism.coordinate_table
        standing = {name: coordinate_value(mechanism, table[name], start.q)
                    for name in driver_values}
    angles, lost = NO_ANGLES, tuple[str, ...]()
    constraints = constraints_of(mechanism)
    if constraints.angles or constraints.coordinates:  # what counts turns
        start, angles, lost = with_followed_turns(mechanism, held, start, standing)
    return AssemblyProblem(mechanism, held, standing, start, tolerance, gap, angles,
                           driver_values=driver_values, lost=lost)


def solved(
    problem: AssemblyProblem, limits: bool = False, release: bool = True, together: bool = True
) -> State:
    """Return the closed State of an assembly problem; raises like `assemble`.

    `release`: whether drivers without a value may move if the loops cannot close otherwise.
    `together`: whether all groups of loops are closed in one call, if no result needs a judgement;
    if drivers are free, each group must move least by itself.
    """
    mechanism, driver_values = problem.mechanism, problem.driver_values
    result = None
    if not limits and (together or len(problem.free_set.groups) < 2):
        result = closed_at_once(problem)
    q, seen = result or _searched(problem, limits, release)
    lost = problem.lost
    if with_turns := problem.with_turns():
        q, others = with_turns(q)
        seen, lost = problem.examined(q), tuple(dict.fromkeys((*lost, *others)))
    if problem.lost:
        warn(f"mechanism {mechanism.name!r}: turns of {', '.join(problem.lost)} may be lost: "
             "couplings or screws count them, but not the loops between, which cannot be followed "
             "there from the guess (sweep there, or name what they count in the guess)")
    released = deviations(mechanism, q, driver_values) if driver_values else {}
    if released:
        names = {d.joint: d.name for d in mechanism.drivers.values()}
        released = {names[c]: x for c, x in released.items()}
    state = made(mechanism, q, None, None, closure_error=seen.error, angles=seen.angles,
                 released=released, lost_turns=lost)
    if mechanism.whole is not None:
        warn_of_rounding(state)
    return state


def _searched(problem: AssemblyProblem, limits: bool, release: bool) -> tuple[Array, Examined]:
    """Return the closed configuration from a search, and its properties."""
    with problem.workspaces:
        search = Search(problem, limits)
        search.run(release=release)
        if search.best is None and problem.standing and release and not search.is_beyond_gap:
            before, search = search, Search(problem.released(), limits)
            search.run(with_values(problem.mechanism, problem.guess.q, problem.given),
                       before=before)
        if search.best is None:
            raise failure(search)
        q = search.best[1]
        return q, search.known or search.problem.examined(q)


def warn_of_rounding(state: State) -> None:
    """Warn once for a mechanism of equations that the numbers of its file contradict."""
    mechanism, whole = state.mechanism, state.mechanism.whole
    assert whole is not None and mechanism.selection is not None
    if whole in _WARNED:
        return
    _WARNED.add(whole)
    opened = dict(mechanism.selection.opened)
    counts = zip(whole.closures, mechanism.selection.counts(), strict=True)
    texts = [f"{c.n_rows - n} of {c.n_rows} equations of {c.name!r} hold to {opened[c.name]:.0e} "
             "only" for c, n in counts if n < c.n_rows]
    warn(f"mechanism {whole.name!r}: {'; '.join(texts)}: the file's numbers are rounded "
         "(see State.gap; assemble(gap=0) refuses them)")


def default_driver_values(
    mechanism: Mechanism, held: Iterable[str], start: Guess, free: Iterable[str] = (),
    taken_along: bool = True,
) -> dict[str, float]:
    """Return values of the drivers without a given value, from a guess, by coordinate [rad, m].

    Drivers in `free` are not fixed. With `taken_along`, other joints of the guess move drivers that
    it does not name.

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: `free` names something other than a driver, or a fixed driver.
    """
    drivers, loose = driver_coordinates(mechanism).values(), list[str]()
    for name in (free,) if isinstance(free, str) else free:
        coordinate = mechanism.prescribed_coordinate(name)
        if coordinate not in drivers:
            raise ValueError(f"free: {name!r} is no driver of mechanism {mechanism.name!r}; only "
                             f"drivers stand: {', '.join(mechanism.drivers) or 'there is none'}")
        if coordinate.name in held:
            raise ValueError(f"free: {name!r} is given a value too")
        loose.append(coordinate.name)
    standing = [c for c in drivers if c.name not in held and c.name not in loose]
    if not standing:
        return {}
    values = {c.name: coordinate_value(mechanism, c, start.q) for c in standing}
    if taken_along and not values.keys() <= {*start.names} and (home := _at_home(start)):
        values |= {name: x for name, x in home.items() if name in values}
    return values


@made_once
def _at_home(start: Guess) -> dict[str, float]:
    """Return values of the drivers that a guess does not name: neutral, if the loops close.

    Otherwise the loops give them: the guess may name the platform and not the legs.
    """
    mechanism = start.mechanism
    drivers = {c.name: coordinate_value(mechanism, c, start.q)
               for c in driver_coordinates(mechanism).values()}
    spoken = {*joint_values(mechanism, mechanism.guess), *start.names}
    silent = [name for name in drivers if name not in spoken]
    if not silent or spoken <= drivers.keys():
        return {}
    accuracy, angles = accuracy_of(None), np.zeros(constraints_of(mechanism).n_angles)
    problem = AssemblyProblem(
        mechanism, {}, drivers, start, accuracy.tolerance, accuracy.gap, angles)
    with problem.workspaces:
        search = Search(problem, False)
        search.attempt(start.q)
    if search.best is not None:
        return {}
    try:
        home = assembled(mechanism, {}, start.given, free=silent)
    except AssemblyError:
        return {}
    return {name: home.coordinate(name).value for name in silent}


def branch_changed(
    guess: State, reached: State, drivers: Iterable[str], free: Iterable[str]
) -> str:
    """Return a sentence if loops have left the branch of a guess; else "".

    The fixed coordinates, these and drivers that are not `free`, move straight from their values in
    the guess to the new ones, with loops closed in short steps. Loops that end elsewhere are on
    another branch. Small motions are not checked.
    """
    mechanism, change = reached.mechanism, reached.q - guess.q
    size = SAME_BRANCH * min(mechanism.characteristic_length, 1.0)
    # a joint moves by twice the change of its quaternion, and a bit more
    if 9.0 * float(change @ change) <= size * size or np.abs(turn_free_difference(
            mechanism, guess.q, reached.q)).max(initial=0.0) <= SAME_BRANCH:
        return ""
    standing = set(mechanism.drivers) - set((free,) if isinstance(free, str) else free)
    held = [*drivers, *sorted(standing)]
    table = mechanism.coordinate_table
    names = list(dict.fromkeys(mechanism.prescribed_coordinate(name).name for name in held))
    still = fixed_base_entries(mechanism, (table[name] for name in names))
    free = free_velocities(mechanism, still, (name for name in names if table[name].q >= 0))
    q, done = _straight_motion(guess, reached, names, free)
    apart = np.abs(turn_free_difference(mechanism, q, reached.q))
    with loops_of(mechanism, reached.angles) as evaluation:
        evaluation.update(reached.q)
        rows, closure_of = evaluation.jacobian, evaluation.constraints.closure_of
        rows = rows[: evaluation.constraints.n_closure]
        loose = np.zeros(len(free), dtype=bool)
        loose[free] = np.abs(decompose(rows[:, free]).null_space).max(
            axis=0, initial=0.0) > TOLERANCES.half_precision
        elsewhere = (apart > BRANCHES_APART) & free & ~loose  # though the loops determine where
        moved = np.abs(rows[:, elsewhere]).max(axis=1, initial=0.0) > 0.0
    loops = list(dict.fromkeys(closure_of[k] for k in np.flatnonzero(moved)))
    if not loops:
        return ""
    what = "are on another branch than those of the guess" if done == 1.0 else (
        f"do not go straight from the guess to where they are: {100.0 * done:.3g} % of the way is "
        "all they can go")
    return (f"mechanism {mechanism.name!r}: the loops of {', '.join(loops)} {what}; `sweep` and "
            "`follow` stay on a branch")


def _straight_motion(
    guess: State, reached: State, names: list[str], free: NDArray[np.bool_]
) -> tuple[Array, float]:
    """Return the end of a straight motion of coordinates from a guess, and the completed part."""
    mechanism = reached.mechanism
    ends = {name: [coordinate_value(mechanism, mechanism.coordinate_table[name], state.q)
                   for state in (guess, reached)] for name in names}
    pinned = [name for name in names if mechanism.coordinate_table[name].q < 0]
    n = constraints_of(mechanism).n_angles
    reference = guess.angles if guess.angles.size == n else np.zeros(n)
    q, done, step = guess.q, 0.0, 1.0
    while done < 1.0 and step >= LEAST_PART:
        part = min(done + step, 1.0)
        values = {name: (1.0 - part) * a + part * b for name, (a, b) in ends.items()}
        try:
            there = closed(mechanism, with_values(mechanism, q, values), free, reference,
                           TOLERANCES.tight, pinned={name: values[name] for name in pinned})
            is_near = there.error <= ACCEPTED and np.abs(
                turn_free_difference(mechanism, q, there.q)).max(initial=0.0) <= SAME_BRANCH
        except SingularError:
            is_near = False
        if is_near:
            q, done, step = there.q, part, 2.0 * step
        else:
            step *= 0.5
    return q, done


StartGuess = Mapping[str, Any] | State | Array | None


def starting_state(mechanism: Mechanism, guess: StartGuess, state: StartGuess = None) -> State:
    """Return the state of a guess, closed if it is not a State.

    `state` is another name of `guess`.

    Raises:
        AssemblyError: the guess does not close.
        TypeError: both are given.
    """
    if guess is not None and state is not None:
        raise TypeError("guess and state are two words for where to start: give one of them")
    start = state if guess is None else guess
    if isinstance(start, State):
        return of_mechanism(mechanism, start)
    return assembled(mechanism, {}, start)


def held_start(
    mechanism: Mechanism, values: Mapping[str, float],
    guess: Mapping[str, Any] | State | Array | None, hold: Hold, accuracy: Accuracy,
) -> tuple[State, list[str]]:
    """Assemble a State at driver values, with `hold` at the values of the guess.

    These values are exact if the guess is a State and the loops close so; otherwise the coordinates
    are released, after the drivers without a value. With another guess, they keep their assembled
    values. `values` are those of drivers or coordinates [rad or m]; for `hold` see
    `holding.held_by`.

    Returns:
        The State, and a sentence for each joint that is not at the value of the guess.

    Raises:
        AssemblyError: the values cannot be assembled.
    """
    if not isinstance(guess, State):
        return assembled(mechanism, values, guess, accuracy=accuracy), []
    held = {c.name: guess.coordinate(c.name).value
            for c in held_coordinates(mechanism, values, hold)
            if c.name in guess.mechanism.coordinate_table}
    if held:
        try:
            return assembled(mechanism, {**values, **held}, guess, accuracy=accuracy), []
        except AssemblyError:
            pass  # they are released, and the result says how far they went
    state = assembled(mechanism, values, guess, accuracy=accuracy)
    drivers = driver_coordinates(mechanism)
    texts, released = [], {drivers[name].name for name in state.released}
    for name in [name for name in held if name not in released]:
        coordinate = state.mechanism.coordinate(name)
        by = state.coordinate(name).value - held[name]
        if abs(by) > TOLERANCES.half_precision * state.mechanism.velocity_scale[coordinate.v]:
            texts.append(f"{name} is held {by:+.9g} {coordinate.unit} from where the guess has it, "
                         "as the loops would not close otherwise")
    return state, texts


def held_coordinates(
    mechanism: Mechanism, values: Iterable[str], hold: Hold
) -> list[Coordinate]:
    """Return the coordinates of `hold`, except free bases and coordinates with a value."""
    given = [mechanism.prescribed_coordinate(name) for name in values]
    held, base = held_by(mechanism, hold, given), fixed_base_entries(mechanism, given)
    return [c for c in mechanism.coordinate_table.values()
            if ((c.q >= 0 and c.v in held.entries and c.v not in base) or c in held.coordinates)
            and c not in given]
