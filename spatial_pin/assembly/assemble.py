"""Assembly: from a rough guess to a closed configuration."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import MOST_STEPS, close, closed, closed_by, finite
from spatial_pin.assembly.release import can_move, can_stand, least_motion
from spatial_pin.assembly.rounding import allowed_from, cut_of, may_be_rounded, rounded
from spatial_pin.assembly.state import State, all_angles
from spatial_pin.assembly.targets import Target, free_but, left_of
from spatial_pin.checks import checked, mapping
from spatial_pin.constraints.closure_equations import Evaluation, evaluation_of
from spatial_pin.errors import AssemblyError, warn
from spatial_pin.kernel.closer import Closed, Closer, closer_of
from spatial_pin.mechanism.coordinates import (
    by_joint,
    coordinate_round_off,
    coordinate_value,
    finite_array,
    finite_number,
    joint_values,
    joint_vector,
    needed,
    with_values,
)
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import EPS, Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy, accuracy_of

# Starts from other values of what the guess leaves open, before giving up: a branch that one start
# in ten closes on is missed by all in 0.2 % of cases.
MAX_STARTS = 60
OPEN = EPS**0.5  # closure error that no round-off excuses: half of the digits
# Weight of the motion of drivers against open loops, where limits are looked for: it leaves loops
# open by its square, 1e-6 of a characteristic length or radian, which closing them takes away.
LEAST_MOTION = 1e-3
COORDINATE_ERROR = 4.0 * EPS  # of a coordinate relative to its size: as `coordinate_round_off`
# Starts of drivers that stand, where they need go a little only for the loops to close: a place
# beside where they stand is found from there, and other starts seldom find a nearer one.
FEW_STARTS = 4
# Starts after the first success, to find the branch nearest to the guess: of two branches that as
# many starts end at, the nearer is missed in one of 256 cases.
MORE_STARTS = 8
# Characteristic lengths; a length named beyond them may be that of another size: joints go one or
# two, and millimetres for metres are a thousand.
ANOTHER_SIZE = 10.0
# rad, characteristic lengths; drivers that go no further are just out of reach: by rounding of what
# one reads off a drawing, not by a wrong value.
OUT_OF_REACH = 0.05
# A branch this near to the guess [rad, characteristic lengths] is not questioned: guesses have two
# or three digits.
NEAR_GUESS = 1e-2
ACCEPTED = TOLERANCES.closed
PERIODIC = ("revolute", "cylindrical", "universal", "planar")


class _Guess(NamedTuple):
    """Where to start: the configuration, and the coordinates in it that somebody named."""

    q: Array
    named: dict[str, float]


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

    Drivers that are given a value have it exactly. Drivers that are not stand where the guess has
    them, at neutral if it says nothing of them; but where it says something of other joints and
    does not close with the drivers at neutral, where the loops take them. What else the guess
    names is held while the rest is solved first, then released; of the branches in reach the one
    nearest to the named values is returned. A free base (a floating joint that carries alone all
    that hangs together with its link) stays where the guess has it.

    Only where the loops cannot close so, the drivers that stand are let go, all by the least
    motion: the sum of squares of how far they go, angles in rad and slides by the characteristic
    length, is the least of the branch. That is mostly a dead centre of theirs: where no driver has
    a value at all, the guess as a whole is closed instead, so that they can move on.
    `State.released` tells which have gone how far.

    Args:
        mechanism: the mechanism.
        drivers: values of drivers or coordinates to hold exactly [rad, m].
        guess: values by joint or coordinate as in the mechanism file, a State, or q (nq,);
            default the file's guess, and neutral where nothing is said. Angles so large that
            their round-off would open the loops are taken to a turn.
        limits: keep the joint limits of the model.
        release: let drivers go that were given no value, where the loops cannot close otherwise.
        free: drivers that do not stand, but go where the loops take them; not among `released`.
        gap: largest closure error that redundant equations may keep where the file's numbers are
            rounded [-], default that of `accuracy`; 0 refuses them. A `SpatialPinWarning` tells of
            it once, `State.gap` always.
        accuracy: tolerance to reach; default "engineering".

    Returns:
        The closed State; its v and a are zero, see `solve_rates`. A `SpatialPinWarning` tells of
        joint limits that it breaks, as `State.beyond_limits` does.

    Raises:
        AssemblyError: no closed configuration found; keeps the best attempt.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite, or `free` names what is no driver, or is held.
    """
    if gap is not None:
        accuracy = replace(accuracy_of(accuracy), gap=gap)
    state = assembled(mechanism, drivers, guess, limits=limits, release=release, free=free,
                      accuracy=accuracy)
    if state.beyond_limits:
        words = "; ".join(_beyond_words(mechanism, state.q, name) for name in state.beyond_limits)
        warn(f"mechanism {mechanism.name!r} stands beyond joint limits: {words} "
             "(assemble(limits=True) keeps them)")
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
) -> State:
    """Do as `assemble`, for verbs whose results tell of joint limits themselves."""
    needed(mechanism)
    accuracy = accuracy_of(accuracy)
    if accuracy.gap and isinstance(guess, State) and guess.mechanism.whole is mechanism:
        mechanism = guess.mechanism  # it goes on with the equations that were chosen for it
        accuracy = replace(accuracy, gap=allowed_from(guess, accuracy.gap))
    held: dict[str, float] = {}
    for name, value in mapping(drivers, "drivers").items():
        coordinate = mechanism.prescribed_coordinate(name).name
        if coordinate in held:
            raise ValueError(f"{coordinate!r} is given two values")
        held[coordinate] = finite_number(value, f"driver {name!r}")
    start = _read_guess(mechanism, guess)
    said = _standing(mechanism, held, guess, start, free)
    beginning = mechanism.start(held) if guess is None else None
    if beginning is not None:
        start = _read_guess(mechanism, beginning)
    standing = said if beginning is None else {
        name: coordinate_value(mechanism, mechanism.coordinate_table[name], start.q)
        for name in said}
    named = {name: value for name, value in start.named.items() if name not in held}
    angles = guess.angles if isinstance(guess, State) else 0.0
    with _evaluations_of(mechanism, angles) as evaluations:
        def searched(accuracy: Accuracy) -> _Search:
            search = _Search(*evaluations, held, standing, named, limits, accuracy)
            search.run(start.q, release)
            if search.best is None and standing and release and not search.is_near:
                search = _Search(*evaluations, held, {}, standing | named, limits, accuracy, said)
                search.run(start.q)
            return search

        search = searched(accuracy)
        exact = rounded(mechanism, accuracy.gap) if search.may_be_rounded() else None
        if exact is None:
            return (searched(replace(accuracy, gap=0.0)) if search.is_near else search).result(said)
    state = assembled(exact, drivers, guess, limits=limits, release=release, free=free,
                      accuracy=accuracy)
    tell(state)
    return state


@contextmanager
def _evaluations_of(
    mechanism: Mechanism, angles: Array | float
) -> Iterator[tuple[Evaluation, Evaluation | None]]:
    """Lend the evaluations of a mechanism and of its whole, if it has one."""
    if mechanism.whole is None:
        with evaluation_of(mechanism, angles) as evaluation:
            yield evaluation, None
        return
    with evaluation_of(mechanism) as evaluation:
        own = evaluation.turns.size
        evaluation.turns[:] = angles if np.size(angles) in (1, own) else 0.0
        with evaluation_of(mechanism.whole, all_angles(mechanism, evaluation.turns)) as whole:
            yield evaluation, whole


def tell(state: State) -> None:
    """Warn, once of a mechanism, of the equations that the numbers of its file contradict."""
    mechanism, whole = state.mechanism, state.mechanism.whole
    assert whole is not None and mechanism.kept is not None
    if whole.memo.get("gap told"):
        return
    whole.memo["gap told"] = True
    counts = zip(whole.closures, mechanism.kept.counts(), strict=True)
    with evaluation_of(whole, all_angles(mechanism, state.angles)) as evaluation:
        evaluation.update(state.q)
        texts = [f"{c.n_rows - n} of {c.n_rows} equations of {c.name} hold to "
                 f"{open_gap(whole, evaluation, c.name)} only" for c, n in counts if n < c.n_rows]
    warn(f"mechanism {whole.name!r}: {'; '.join(texts)}: the file's numbers are rounded "
         "(see State.gap; assemble(gap=0) refuses them)")


def standing_drivers(
    mechanism: Mechanism,
    held: Iterable[str],
    guess: Mapping[str, Any] | State | Array | None = None,
    free: Iterable[str] = (),
) -> dict[str, float]:
    """Return where the drivers that nobody gives a value stand, by coordinate [rad, m].

    Args:
        mechanism: the mechanism.
        held: the coordinates that are given values.
        guess: as for `assemble`: the caller's, else the file's, else neutral.
        free: drivers that are not to stand.

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: `free` names what is no driver, or is held.
    """
    return _standing(mechanism, held, guess, _read_guess(mechanism, guess), free)


def _standing(
    mechanism: Mechanism, held: Iterable[str], guess: Any, start: _Guess, free: Iterable[str]
) -> dict[str, float]:
    """Do as `standing_drivers` with a guess that has been read."""
    drivers = [mechanism.prescribed_coordinate(d.joint) for d in mechanism.drivers.values()]
    loose = set()
    for name in (free,) if isinstance(free, str) else free:
        coordinate = mechanism.prescribed_coordinate(name)
        if coordinate not in drivers:
            raise ValueError(f"free: {name!r} is no driver of mechanism {mechanism.name!r}; only "
                             f"drivers stand: {', '.join(mechanism.drivers) or 'there is none'}")
        if coordinate.name in held:
            raise ValueError(f"free: {name!r} is given a value too")
        loose.add(coordinate.name)
    values = {c.name: coordinate_value(mechanism, c, start.q) for c in drivers}
    standing = [name for name in values if name not in held and name not in loose]
    if not standing:
        return {}
    spoken = set(joint_values(mechanism, mechanism.guess)) | set(start.named)
    silent = [name for name in values if name not in spoken]
    if spoken - set(values) and not set(silent).isdisjoint(standing):
        values |= _at_home(mechanism, guess, start, values, silent)
    return {name: values[name] for name in standing}


def _at_home(
    mechanism: Mechanism, guess: Any, start: _Guess, drivers: Mapping[str, float],
    silent: Sequence[str],
) -> dict[str, float]:
    """Return where drivers of which the guess says nothing stand: neutral, if it closes so.

    Else where the loops take them, as the guess may name the platform and leave out the legs.
    """
    with _evaluations_of(mechanism, 0.0) as evaluations:
        search = _Search(*evaluations, {}, drivers, start.named, False, accuracy_of(None))
        search.attempt(start.q)
    if search.best is not None:
        return {}
    try:
        home = assembled(mechanism, {}, guess, free=silent)
    except AssemblyError:
        return {}
    return {name: home.coordinate(name).value for name in silent}


class _Search:
    """Attempts from several starts, and the best of what they found.

    Args:
        evaluation: of the mechanism.
        whole: of the mechanism with all equations, where the file's numbers are rounded: these
            lead, and stay closed to the gap.
        held: coordinates that were given values.
        standing: drivers that stand, by coordinate.
        named: other coordinates that the guess names.
        limits: whether joint limits are kept.
        accuracy: the tolerance to reach.
        let_go: drivers that go as little as possible from these values.
    """

    def __init__(
        self,
        evaluation: Evaluation,
        whole: Evaluation | None,
        held: Mapping[str, float],
        standing: Mapping[str, float],
        named: Mapping[str, float],
        limits: bool,
        accuracy: Accuracy,
        let_go: Mapping[str, float] | None = None,
    ) -> None:
        self.mechanism = evaluation.mechanism
        self.evaluation, self.given, self.standing = evaluation, held, standing
        self.held = {**held, **standing}
        self.named = {name: value for name, value in named.items() if name not in self.held}
        self.let_go = let_go or {}
        self.limits, self.tolerance, self.accuracy = limits, accuracy.tolerance, accuracy
        self.whole, self.gap = whole, accuracy.gap
        self.cut = cut_of(whole.mechanism, accuracy.gap) if whole else 0.0
        self.is_near = False
        left = left_of(self.mechanism, tuple(self.held), tuple(self.let_go), tuple(self.named))
        self.pinned = {name: self.held[name] for name in left.pinned}
        self.still, self.free = left.still, left.free
        self.first, self.has_first = left.first, left.has_first
        self.target = Target(self.mechanism, self.named)
        self.best: tuple[float, Array] | None = None
        self.nearest_miss: tuple[float, Array, str] | None = None
        self.found_at = -1
        self.closer: Closer | None = None

    def _free(self, held: Iterable[str]) -> NDArray[np.bool_]:
        """Return (nv,) which velocities are left where coordinates and free bases are held."""
        return free_but(self.mechanism, self.still, held)

    def run(self, q: Array, release: bool = False) -> None:
        """Try starts, the first at q (nq,), until one is surely the nearest, or all have failed.

        Args:
            q: the guess.
            release: whether to give up where the drivers that stand cannot.
        """
        with closer_of(self.mechanism, self.pinned) as self.closer:
            self._try_starts(_starts(self.mechanism, q, self.held, self.named, self.still), release)
        self.closer = None

    def _try_starts(self, starts: Iterator[Array], release: bool) -> None:
        most = MAX_STARTS
        for k, start in enumerate(starts):
            if _size(self.mechanism, start) * COORDINATE_ERROR < 1.0:  # else no digit is left of it
                self.attempt(start)
            if self.done(k) or self.is_near:
                break
            if self.best is not None:
                self._compare(list(islice(starts, min(MORE_STARTS, most - 1 - k))), k + 1)
                break
            if k == 0 and release and self.standing:
                most = self._worth_trying(start)
            if k + 1 == most:
                break

    def _compare(self, starts: Sequence[Array], first: int) -> None:
        """Try starts after one that has led to a closed configuration: mostly all of them count.

        Args:
            starts: configurations (nq,).
            first: number of the first of them.
        """
        if not starts:
            return
        small = _size(self.mechanism, np.array(starts)) * COORDINATE_ERROR < 1.0
        reached = self._reached([x for x, ok in zip(starts, small.tolist(), strict=True) if ok])
        for k, ok in enumerate(small.tolist(), start=first):
            if ok:
                self._keep(*next(reached))
            if self.done(k) or self.is_near:
                break

    def _worth_trying(self, q: Array) -> int:
        """Return how many starts the drivers that stand are worth, the first having failed at q.

        None more where the loops near q would move them, and a few where they need go a little only
        for the loops to close: their values are just out of reach then.
        """
        table = self.mechanism.coordinate_table
        pinned = {name: x for name, x in self.given.items() if table[name].q < 0}
        free = self._free(name for name in self.given if name not in pinned)
        if _size(self.mechanism, q) * COORDINATE_ERROR >= 1.0:
            return MAX_STARTS
        there, error, _ = self._closed(q, free, pinned)
        if not error <= ACCEPTED:
            return MAX_STARTS
        self.evaluation.update(there)
        if not can_stand(self.evaluation, free, self.standing, pinned):
            return 1
        there, _ = least_motion(self.evaluation, there, free, self.standing, self.tolerance, pinned)
        gone = _gone(self.mechanism, there, self.standing)
        sizes = self.mechanism.velocity_scale
        far = max((abs(by) / sizes[table[name].v] for name, by in gone.items()), default=0.0)
        return FEW_STARTS if far < OUT_OF_REACH else MAX_STARTS

    def attempt(self, q: Array) -> None:
        """Solve from one start and keep the result if it is the best so far."""
        if self.has_first:
            q = self._closed(q, self.first, self.pinned, max(self.tolerance, TOLERANCES.nothing)).q
        self._keep(self._closed(q, self.free, self.pinned))

    def _reached(self, starts: Sequence[Array]) -> Iterator[tuple[Closed, float | None]]:
        """Yield where closing leads from starts, and how far that is from what is named, if known.

        All are closed in one go, where no other equations lead.
        """
        loose = max(self.tolerance, TOLERANCES.nothing)
        if self.whole is not None or self.closer is None:
            for q in starts:
                if self.has_first:
                    q = self._closed(q, self.first, self.pinned, loose).q
                yield self._closed(q, self.free, self.pinned), None
            return
        closer, turns, pinned = self.closer, self.evaluation.turns, self.pinned.values()
        q = np.array(starts)
        before: Sequence[Closed] = ()
        if self.has_first:
            before = closer.close_all(q, self.first, turns, loose, MOST_STEPS, pinned,
                                      TOLERANCES.rank)
            q = np.array([x.q for x in before])
        after = closer.close_all(q, self.free, turns, self.tolerance, MOST_STEPS, pinned,
                                 TOLERANCES.rank)
        distances = self.target.distances(np.array([x.q for x in after]))
        for k, found in enumerate(after):
            if before:
                finite(before[k])
            yield finite(found), distances[k]

    def _keep(self, found: Closed, distance: float | None = None) -> None:
        """Keep where closing has led if it is the best so far.

        Args:
            found: where that is.
            distance: of it from what is named, where it is known.
        """
        evaluation = self.evaluation
        q, error = found.q, found.error
        if self.let_go and error <= ACCEPTED:
            least, error = self._least(q, self.free)
            if self.given or can_move(evaluation, self.free, self.let_go, self.pinned):
                q = least
        q, error, problem = self._judged(q, found)
        violated = _violated(self.mechanism, q) if self.limits and not problem else ""
        if violated:
            bounded, loose_ones = _within_limits(evaluation, q, self.free, self.let_go)
            bounded = (self._least(bounded, loose_ones)[0] if self.let_go else
                       self._closed(bounded, loose_ones, self.pinned).q)
            bounded, _, fault = self._judged(bounded)
            if fault or _violated(self.mechanism, bounded):
                problem = violated
            else:
                q = bounded
        if problem:
            self.is_near |= self.whole is None and self._accepted(q) < error <= self.gap
            if self.nearest_miss is None or error < self.nearest_miss[0]:
                self.nearest_miss = (error, q, problem)
            return
        if distance is None or q is not found.q:
            distance = self.target.distance(q)
        if self.best is None or distance < self.best[0] * (1.0 - 1e-6) - 1e-9:
            self.best = (distance, q)

    def _closed(
        self, q: Array, free: NDArray[np.bool_], pinned: Mapping[str, float],
        tolerance: float | None = None,
    ) -> Closed:
        """Close the loops from q (nq,), all equations first as well as they can be."""
        tolerance = tolerance or self.tolerance
        if self.whole is not None:
            q = closed(self.whole.mechanism, q, free, self.whole.turns, tolerance, pinned=pinned,
                       cut=self.cut).q
        turns = self.evaluation.turns
        if self.closer is not None and pinned is self.pinned:
            return closed_by(self.closer, q, free, turns, tolerance, pinned=pinned)
        return closed(self.mechanism, q, free, turns, tolerance, pinned=pinned)

    def may_be_rounded(self) -> bool:
        """Whether loops closed nearly, or some equations nearly follow from others."""
        if self.best is None or self.whole is not None:
            return self.is_near
        self._evaluate(self.best[1])
        return may_be_rounded(self.evaluation, self.gap)

    def _judged(self, q: Array, known: Closed | None = None) -> tuple[Array, float, str]:
        """Return q with its whole turns, its closure error, and the closure at fault or nothing.

        Args:
            q: the configuration.
            known: how it was closed, which may tell without a closer look that nothing is.
        """
        evaluation = self.evaluation
        turned = _turned(self.mechanism, q, self.held, self.named)
        if (known is not None and self.whole is None and known.error <= ACCEPTED
                and not known.may_be_mirrored and q is known.q and not turned):
            return q, known.error, ""
        q = _with_places(q, turned)
        evaluation.update(q)
        error = evaluation.closure_error
        fault = "" if error <= self._accepted(q) else evaluation.worst_closure()
        if self.whole is not None and not fault:
            self.whole.update(q)
            if self.whole.closure_error > self.gap:
                return q, self.whole.closure_error, self.whole.worst_closure()
        return q, error, fault or evaluation.mirrored()

    def _accepted(self, q: Array) -> float:
        """Return the closure error that q (nq,) may have, round-off of its own included.

        An angle that is held counts turns without making its sine any worse.
        """
        q = q.copy()
        q[[c.q for c in periodic(self.mechanism) if c.name in self.held]] = 0.0
        return min(max(ACCEPTED, coordinate_round_off(self.mechanism, q)), OPEN)

    def _least(self, q: Array, free: NDArray[np.bool_]) -> tuple[Array, float]:
        """Return the closed configuration near q in which the drivers let go have gone the least.

        Those that need not go at all stand exactly.
        """
        q = self._closed(q, free, self.pinned).q
        q, error = least_motion(self.evaluation, q, free, self.let_go, self.tolerance,
                                self.pinned)
        kept = {name: self.let_go[name] for name in self.let_go
                if name not in _gone(self.mechanism, q, self.let_go)}
        if not kept:
            return q, error
        table = self.mechanism.coordinate_table
        entries = [name for name in kept if table[name].q >= 0]
        pinned = {name: x for name, x in kept.items() if table[name].q < 0}
        there, open_by = close(self.evaluation, with_values(self.mechanism, q, kept),
                               free & self._free(entries), self.tolerance,
                               pinned=self.pinned | pinned)
        moved = pin.difference(self.mechanism.model, q, there) / self.mechanism.velocity_scale
        near = bool(np.abs(moved).max(initial=0.0) < NEAR_GUESS)
        return (there, open_by) if open_by <= ACCEPTED and near else (q, error)

    def done(self, k: int) -> bool:
        """Whether further starts can be spared after start number `k`."""
        if self.best is None:
            return False
        if self.found_at < 0:
            self.found_at = k
        near = OUT_OF_REACH if self.let_go else NEAR_GUESS
        return self.best[0] < near or k - self.found_at >= MORE_STARTS

    def result(self, said: Mapping[str, float]) -> State:
        """Return the best closed State, or raise with the best attempt.

        Args:
            said: where the drivers should stand that were given no value.
        """
        evaluation = self.evaluation
        if self.best is None:
            raise self._failure()
        q = self.best[1]
        self._evaluate(q)
        names = {d.joint: d.name for d in self.mechanism.drivers.values()}
        gone = _gone(self.mechanism, q, said)
        return State(self.mechanism, q, closure_error=evaluation.closure_error,
                     angles=evaluation.angles, released={names[c]: x for c, x in gone.items()})

    def _evaluate(self, q: Array) -> None:
        """Evaluate the equations at q (nq,), which nobody changes, if they do not stand there."""
        if self.evaluation.q is not q:
            self.evaluation.update(q)

    def _failure(self) -> AssemblyError:
        held = ", ".join(f"{name} = {value:.6g}" for name, value in self.given.items())
        where = f"mechanism {self.mechanism.name!r}" + (f" with {held}" if held else "")
        if self.nearest_miss is None:
            q = with_values(self.mechanism, self.mechanism.neutral, {**self.named, **self.held})
            return AssemblyError(f"{where} cannot be closed: {_too_large(self.mechanism, q)}",
                                 closure_error=np.inf, worst_closure="")
        error, q, worst = self.nearest_miss
        self.evaluation.update(q)
        state = State(self.mechanism, q, closure_error=error, angles=self.evaluation.angles)
        if error <= ACCEPTED and worst.startswith("limit of "):
            own = any(worst.startswith(f"limit of {name}:") for name in self.held)
            message = (f"{where} closes only outside the joint limits ({worst}); " + (
                "that is the value given: give one within its limits" if own else
                "give values of the drivers at which it stays inside"))
        elif error <= ACCEPTED:
            message = f"{where} {self._mirror_words(q)}"
        else:
            whole = self.whole or self.evaluation
            whole.update(q)
            gap = open_gap(whole.mechanism, whole, worst)
            message = (f"{where} cannot be closed: closure {worst!r} stays open by {gap} "
                       f"(closure error {error:.1e}), the smallest gap found; ")
            large = _size(self.mechanism, q) * COORDINATE_ERROR > ACCEPTED
            message += _too_large(self.mechanism, q) if large else self._open_words(q, worst)
            if any(c.name == worst and c.type == "screw" for c in self.mechanism.closures):
                message += ("; a screw closure is assembled within half a turn of zero: sweep to "
                            "further turns, or put the screw into the tree")
        if self.standing:
            values = ", ".join(f"{name} = {value:.6g}" for name, value in self.standing.items())
            message += (f"; drivers that were given no value stand at {values}: give them values, "
                        "or let them go with release=True or free=[...]")
        return AssemblyError(message, closure_error=error, worst_closure=worst, state=state)


    def _mirror_words(self, q: Array) -> str:
        """Say why loops close only with the axes of closures opposite, the evaluation at q (nq,).

        Where they close with other driver values, these are the cause; else the frames are.
        """
        opposite = self.evaluation.opposite_axes()
        names = " and ".join(map(repr, opposite))
        words = (f"closes only with the axes of closure {names} pointing opposite ways, which is "
                 "no assembly of it; ")
        elsewhere = self._closed_elsewhere(q) if self.held else {}
        if elsewhere:
            values = ", ".join(f"{name} = {value:.6g}" for name, value in elsewhere.items())
            return (f"{words}the values are out of reach: left free, the loops close at "
                    f"{values}")
        if not all(opposite.values()):
            return (f"{words}its three axes are interchanged, too: give its two frames "
                    "the same orientation where the loop is closed")
        some = "one of its frames" if len(opposite) == 1 else "one frame of each"
        return f"{words}turn {some} round, by half a turn about its x axis"

    def _open_words(self, q: Array, worst: str) -> str:
        """Say why loops stay open at the best attempt q (nq,), closure `worst` the most."""
        elsewhere = self._closed_elsewhere(q) if self.held else {}
        if not elsewhere:
            return (f"no assembly was found from here, nor does any of {MAX_STARTS} starts close "
                    "the loops" + " at other values of the drivers" * bool(self.held)
                    + f": check the frames of {worst!r} and the lengths between them; if they "
                    "are right, give a guess nearer to a closed configuration")
        values = ", ".join(f"{name} = {value:.6g}" for name, value in elsewhere.items())
        n = self.evaluation.constraints.n_rows
        freedoms = self.mechanism.model.nv - decompose(self.evaluation.jacobian[:n]).rank
        if len(self.given) > freedoms:
            return (f"{len(self.given)} coordinates have a value, but the mechanism has {freedoms} "
                    f"freedom{'s' * (freedoms != 1)}: leave out {len(self.given) - freedoms} "
                    f"(the nearest values that fit are {values})")
        return ("a value is out of reach: left free, the loops close at "
                f"{values}")

    def _closed_elsewhere(self, q: Array) -> dict[str, float]:
        """Return values at which the loops close, near those given, if there are any.

        The evaluation stands there then.
        """
        search = _Search(self.evaluation, self.whole, {}, {}, {**self.named, **self.held},
                         self.limits, replace(self.accuracy, gap=self.gap if self.whole else 0.0))
        search.run(q)
        if search.best is None:
            return {}
        self.evaluation.update(search.best[1])
        table = self.mechanism.coordinate_table
        return {name: coordinate_value(self.mechanism, table[name], search.best[1])
                for name in self.held}


def _gone(mechanism: Mechanism, q: Array, said: Mapping[str, float]) -> dict[str, float]:
    """Return how far coordinates are from values, those that are there left out [rad, m]."""
    table, gone = mechanism.coordinate_table, {}
    for name, value in said.items():
        by = coordinate_value(mechanism, table[name], q) - value
        if abs(by) > TOLERANCES.nothing * mechanism.velocity_scale[table[name].v]:
            gone[name] = by
    return gone


def _sizes(mechanism: Mechanism) -> tuple[list[str], NDArray[np.intp], Array]:
    """Return names, places in q, and sizes of coordinates, but of periodic angles."""
    if "sizes" not in mechanism.memo:
        turning = {c.name for c in periodic(mechanism)}
        found = [(name, at, mechanism.velocity_scale[c.v])
                 for name, c in mechanism.coordinate_table.items()
                 if (at := mechanism.place_of(c)) >= 0 and name not in turning]
        mechanism.memo["sizes"] = (
            [x[0] for x in found], np.array([x[1] for x in found], dtype=np.intp),
            np.array([x[2] for x in found], dtype=float))
    names, places, sizes = mechanism.memo["sizes"]
    return names, places, sizes


def _size(mechanism: Mechanism, q: Array) -> Any:
    """Return the largest coordinate of q (nq,) or (m, nq) by the size of the mechanism.

    Angles that mean the same after a turn do not count.
    """
    _, places, sizes = _sizes(mechanism)
    return np.abs(q[..., places] / sizes).max(axis=-1, initial=0.0)


def _too_large(mechanism: Mechanism, q: Array) -> str:
    """Say which coordinate of q is too large for its loops to be closed."""
    names, places, sizes = _sizes(mechanism)
    name = max(zip(np.abs(q[places] / sizes).tolist(), names, strict=True))[1]
    value = float(q[mechanism.place_of(mechanism.coordinate_table[name])])
    return (f"{name} = {value:.3g} {mechanism.coordinate_table[name].unit} is so large that its "
            "round-off alone opens the loops; give a value nearer to the mechanism's size of "
            f"{mechanism.characteristic_length:.3g} m (angles: fewer turns)")


def open_gap(mechanism: Mechanism, evaluation: Evaluation, closure: str) -> str:
    """Return how far a closure is open at the evaluation, in m or rad, as text."""
    constraints = evaluation.constraints
    rows = [i for i, label in enumerate(constraints.labels) if label.closure == closure]
    kinds = {c.name: c for c in mechanism.closures}[closure]
    is_length = [row.is_length for row in kinds.rows] if kinds.type != COUPLING else [
        mechanism.coordinate(kinds.joints[1]).unit == "m"]
    values = evaluation.residual[rows]
    lengths = float(np.linalg.norm(values[np.array(is_length)]))
    angles = float(np.linalg.norm(values[~np.array(is_length)]))
    parts, least = [], TOLERANCES.half_precision * max(lengths, angles)
    if lengths > least:
        parts.append(f"{lengths * mechanism.characteristic_length:.1e} m")
    if angles > least:
        parts.append(f"{angles:.1e} rad")
    return " and ".join(parts) or "0"


def _read_guess(
    mechanism: Mechanism, guess: Mapping[str, Any] | State | Array | None
) -> _Guess:
    """Return the guess with its angles taken to a turn where they count too many."""
    q, named = _as_given(mechanism, guess)
    q = q.copy()
    for c in periodic(mechanism):
        if COORDINATE_ERROR * abs(q[c.q]) > OPEN:
            q[c.q] = math.atan2(math.sin(q[c.q]), math.cos(q[c.q]))
            if c.name in named:
                named[c.name] = float(q[c.q])
    return _Guess(q, named)


def _as_given(
    mechanism: Mechanism, guess: Mapping[str, Any] | State | Array | None
) -> _Guess:
    base = joint_values(mechanism, mechanism.guess)
    if guess is None:
        return _Guess(with_values(mechanism, mechanism.neutral, base), base)
    if isinstance(guess, State):
        if guess.mechanism.coordinates != mechanism.coordinates:
            raise ValueError(
                f"the guess is a state of mechanism {guess.mechanism.name!r}, which has other "
                f"coordinates than {mechanism.name!r}"
            )
        guess = guess.q
    if isinstance(guess, Mapping):
        named = joint_values(mechanism, guess)
        return _Guess(with_values(mechanism, mechanism.neutral, base | named), named)
    q = finite_array(guess, (mechanism.model.nq,), "guess q")
    if not pin.isNormalized(mechanism.model, q, 0.5):
        raise ValueError("guess q has a quaternion whose length is far from 1")
    q = pin.normalize(mechanism.model, q)
    named = {}
    places = q.tolist()
    for joint, coordinates in by_joint(mechanism).items():
        values = ([places[c.q] for c in coordinates] if coordinates[0].q >= 0
                  else joint_vector(mechanism, q, joint).tolist())
        named.update({c.name: x for c, x in zip(coordinates, values, strict=True)})
    return _Guess(q, named)


def _starts(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float],
    still: Sequence[int] = (),
) -> Iterator[Array]:
    """Yield start configurations: the guess, then others that keep what it names.

    The velocity entries that are `still` stay where they are, too.

    After half of the starts what is named is shaken too, first by up to a radian, in the end by
    any angle, and lengths in proportion; named lengths far beyond the mechanism's size are cut.
    """
    model, scale = mechanism.model, mechanism.velocity_scale
    fixed = with_values(mechanism, q, {**named, **held})
    yield fixed
    table, far = mechanism.coordinate_table, ANOTHER_SIZE * mechanism.characteristic_length
    nearer = {name: min(max(value, -far), far) for name, value in named.items()
              if table[name].unit == "m"}
    near = with_values(mechanism, fixed, {**nearer, **held})
    is_held = np.array([name in held or c.v in still for name, c in table.items()], dtype=bool)
    is_named = np.array([name in named for name in table], dtype=bool)
    is_angle = np.array([c.unit == "rad" for c in table.values()], dtype=bool)
    if not np.any(~is_held):
        return
    open_ones = ~is_held & ~is_named
    sizes, draws = np.where(is_angle, 1.0, scale * 0.2), _draws(mechanism)
    n, late = MAX_STARTS // 2 if open_ones.any() else 0, 3 * MAX_STARTS // 4 - 1
    reach = np.where(open_ones, np.pi, 0.0)
    for at, part, shake in ((fixed, draws[:n], 0.0), (near, draws[n:late], 1.0),
                            (near, draws[late:], np.pi)):
        for step in part * (np.where(is_named, shake, reach) * sizes):
            yield pin.integrate(model, at, step)


def _draws(mechanism: Mechanism) -> Array:
    """Return the random numbers (MAX_STARTS - 1, nv) in [-1, 1] of the further starts."""
    if "draws" not in mechanism.memo:
        shape = MAX_STARTS - 1, mechanism.model.nv
        mechanism.memo["draws"] = np.random.default_rng(20110).uniform(-1.0, 1.0, shape)
    found: Array = mechanism.memo["draws"]
    return found


def periodic(mechanism: Mechanism) -> list[Coordinate]:
    """Return the angles that mean the same after a whole turn."""
    if "periodic" not in mechanism.memo:
        mechanism.memo["periodic"] = _periodic(mechanism)
    found: list[Coordinate] = mechanism.memo["periodic"]
    return found


def _periodic(mechanism: Mechanism) -> list[Coordinate]:
    coupled = {mechanism.coordinate(j).name for c in mechanism.closures if c.type == COUPLING
               for j in c.joints}
    return [
        c for c in mechanism.coordinate_table.values()
        if c.unit == "rad" and c.q >= 0 and c.name not in coupled
        and mechanism.pair_of(c.joint) in PERIODIC
    ]


def nearest_turn(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> Array:
    """Take whole turns off the angles: nearest to the named value, else to zero, in limits."""
    return _with_places(q, _turned(mechanism, q, held, named))


def _with_places(q: Array, values: Mapping[int, float]) -> Array:
    """Return a copy of q (nq,) with values by place."""
    q = q.copy()
    for at, value in values.items():
        q[at] = value
    return q


def _turned(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> dict[int, float]:
    """Return the angles, by place in q (nq,), that `nearest_turn` changes."""
    turn, changed = 2.0 * math.pi, {}
    lower, upper = mechanism.model.lowerPositionLimit, mechanism.model.upperPositionLimit
    for c in periodic(mechanism):
        before = angle = float(q[c.q])
        if c.name in held:
            angle = held[c.name]
        else:
            target = named.get(c.name, 0.0)
            angle -= turn * math.ceil((angle - target) / turn - 0.5 - 1e-9)  # half a turn is +pi
            if angle > upper[c.q] and angle - turn >= lower[c.q]:
                angle -= turn
            elif angle < lower[c.q] and angle + turn <= upper[c.q]:
                angle += turn
        if angle != before:
            changed[c.q] = angle
    return changed


def _violated(mechanism: Mechanism, q: Array) -> str:
    """Return which joint limit q breaks, as text; empty when none."""
    for name, by in beyond_limits(mechanism, q).items():
        c = mechanism.coordinate_table[name]
        if abs(by) > 1e-9 * max(mechanism.velocity_scale[c.v], abs(q[c.q])):
            return f"limit of {_beyond_words(mechanism, q, name)}"
    return ""


def _beyond_words(mechanism: Mechanism, q: Array, name: str) -> str:
    """Return a coordinate, its value and its range."""
    c, model = mechanism.coordinate_table[name], mechanism.model
    low, high = float(model.lowerPositionLimit[c.q]), float(model.upperPositionLimit[c.q])
    return f"{name}: {q[c.q]:.6g} {c.unit} is not in [{low:.6g}, {high:.6g}]"


def _within_limits(
    evaluation: Evaluation, q: Array, free: NDArray[np.bool_], let_go: Mapping[str, float]
) -> tuple[Array, NDArray[np.bool_]]:
    """Close the loops within the joint limits by bounded least squares, nearly.

    Args:
        evaluation: of the mechanism.
        q: where to start.
        free: (nv,) the velocities that may move.
        let_go: drivers that are to go as little as possible from these values.

    Returns:
        The configuration, and the velocities that no limit stops there (nv,).
    """
    from scipy.optimize import least_squares

    mechanism, model = evaluation.mechanism, evaluation.model
    n, scale = evaluation.constraints.n_rows, mechanism.velocity_scale
    low, high = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    start = q.copy()
    for c in mechanism.coordinate_table.values():
        if c.q >= 0 and free[c.v]:
            start[c.q] = np.clip(q[c.q], model.lowerPositionLimit[c.q],
                                 model.upperPositionLimit[c.q])
            low[c.v] = model.lowerPositionLimit[c.q] - start[c.q] - 1e-12
            high[c.v] = model.upperPositionLimit[c.q] - start[c.q] + 1e-12
    gone = [mechanism.driven_coordinate(name) for name in let_go]
    pull = LEAST_MOTION * np.eye(model.nv)[[c.v for c in gone]][:, free] / scale[free]
    wanted = np.array(list(let_go.values()), dtype=float)

    def at(x: Array) -> Array:
        step = np.zeros(model.nv)
        step[free] = x
        return pin.integrate(model, start, step)

    def residual(x: Array) -> Array:
        there = at(x)
        evaluation.update(there)
        gaps = (there[[c.q for c in gone]] - wanted) / scale[[c.v for c in gone]]
        return np.concatenate([evaluation.residual, LEAST_MOTION * gaps])

    def jacobian(x: Array) -> Array:  # exact for coordinates with limits, near zero for the rest
        evaluation.update(at(x))
        return np.vstack([evaluation.jacobian[:n, free] / scale[free], pull])

    fit = least_squares(residual, np.zeros(int(free.sum())), jacobian,
                        bounds=(low[free], high[free]), x_scale=scale[free],
                        xtol=1e-15, ftol=1e-15, gtol=1e-15)
    loose = free.copy()
    loose[free] = (fit.x > low[free] + 1e-9) & (fit.x < high[free] - 1e-9)
    return at(fit.x), loose
