"""Search of an assembly: attempts from several starts, the best result, or why there is none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import islice

import numpy as np

from spatial_pin._support.lazy import cached_property
from spatial_pin.assembly.assembly_problem import (
    ACCEPTED,
    AssemblyProblem,
    coordinate_sizes,
    deviations,
    size_of,
)
from spatial_pin.assembly.close import (
    can_be_fixed,
    can_move,
    least_motion,
    violated_limit,
    within_limits,
)
from spatial_pin.assembly.holding import LoopGroup, configuration_indices
from spatial_pin.assembly.redundant_equations import NEARLY_OPEN, clearly_above, gap_words
from spatial_pin.assembly.start_values import (
    COORDINATE_ERROR,
    MAX_STARTS,
    NEAR_GUESS,
    OPEN,
    periodic,
    starts_from,
    turn_free_difference,
)
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.errors import AssemblyError
from spatial_pin.kernel.closer import AT_ONCE, MOST_GROUPS, ClosureResult, Examined, opposite_axes
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_round_off, coordinate_value, with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# Starts of fixed drivers if a small motion of them closes the loops: a nearby result is found from
# there, and other starts seldom find a nearer one.
FEW_STARTS = 4
# Starts after the first success, for the branch nearest to the guess: if half of the starts end at
# each of two branches, the nearer one is missed in one of 256 cases. They are closed in one call.
MORE_STARTS = AT_ONCE
ROUNDS = 3  # Repetitions for loops that stay open: the first released drivers may help the others.
# Motion of drivers that are just out of reach [rad, characteristic lengths]: by rounded readings,
# not by wrong values.
OUT_OF_REACH = 0.05


class Search:
    """Attempts from several starts, and the best result.

    Groups of loops without common free coordinates are searched one by one.

    Attributes:
        best: the nearest closed configuration, with its distance from the named values.
        nearest_miss: closure error, configuration and fault of the best failed attempt.
        known: properties of the best configuration, if its result had them.
        worst: of a group of loops, the search with the largest error; None of them all.
        is_beyond_gap: whether a nearer branch than others needs a wider gap for the file's numbers.
    """

    is_beyond_gap = _guess_is_beyond = False

    def __init__(self, problem: AssemblyProblem, limits: bool) -> None:
        self.problem, self.limits, self.mechanism = problem, limits, problem.mechanism
        self.best: tuple[float, Array] | None = None
        self.nearest_miss: tuple[float, Array, str] | None = None
        self._beyond_gap: tuple[float, tuple[float, Array, str]] | None = None  # distance and miss
        self.known: Examined | None = None
        self._first_success = -1
        self.worst: Search | None = None

    @cached_property
    def parts(self) -> list[tuple[LoopGroup, Search]]:
        """Groups of loops, if there are several, and the search of each."""
        groups = self.problem.free_set.groups
        return [(group, Search(self.problem.part(group), self.limits))
                for group in (groups if len(groups) > 1 else ())]

    def run(
        self, q: Array | None = None, release: bool = False, before: Search | None = None
    ) -> None:
        """Try starts until one is surely the nearest, or all have failed.

        q (nq,) is the first one, with the fixed values, default the guess. `release`: whether to
        stop early if fixed drivers cannot work. Loops that the search `before`, with fixed drivers,
        has closed stay.
        """
        if before is not None and before.parts:
            q = _start_after(self, before, self.problem.goal if q is None else q)
        if not self.parts:
            self._run(self.problem.goal if q is None else q, release)
            miss = self._beyond_gap
            if miss and self.best and (is_nearer(miss[0], self.best[0]) or (
                    self._guess_is_beyond and not is_nearer(self.best[0], miss[0]))):
                self.best, self.nearest_miss, self.is_beyond_gap = None, miss[1], True
            return
        for group, part in self.parts:
            if before is not None and before.parts and all(  # they stay closed
                    own.best is not None for other, own in before.parts
                    if not set(other.closures).isdisjoint(group.closures)):
                part.keep(part.problem.judged_at(before.put_together(self.problem.goal)))
            else:
                part.run(q, release)
        self._join()

    def put_together(self, q: Array) -> Array:
        """Return q (nq,) with the configurations of all closed groups of loops."""
        q = q.copy()
        for group, part in self.parts:
            if part.best is not None:
                own = configuration_indices(self.mechanism, group)
                q[own] = part.best[1][own]
        return q

    def _join(self) -> None:
        """Combine the results of the groups of loops."""
        q = self.put_together(self.problem.goal)
        failed = [(group, part) for group, part in self.parts if part.best is None]
        self.is_beyond_gap = any(part.is_beyond_gap for _, part in failed)
        misses = [(*part.nearest_miss, group, part) for group, part in failed if part.nearest_miss]
        if not failed:
            self.keep(self.problem.judged_at(q))
        elif len(misses) == len(failed):
            error, there, fault, group, self.worst = max(misses, key=lambda x: x[0])
            own = configuration_indices(self.mechanism, group)
            q[own] = there[own]
            self.nearest_miss = error, q, fault

    def _run(self, first: Array, release: bool) -> None:
        problem, most = self.problem, MAX_STARTS
        compared = self.attempt(first, not self.limits and problem.can_perturb())
        self._guess_is_beyond = self._beyond_gap is not None
        if compared or self._done(0) or (spread := problem.free_set.spread) is None:
            return
        if self.best is None and release and problem.standing:
            most = _starts_worth_trying(problem, first)
        starts = starts_from(self.mechanism, first, problem.held, problem.named, spread)
        for k in range(1, most):
            if self.best is None:
                self.attempt(next(starts))
                if self._done(k):
                    break
                continue
            more = list(islice(starts, min(MORE_STARTS, most - k)))  # mostly all of them count
            for number, result in enumerate(problem.reached(more), start=k):
                self.keep(result)
                if self._done(number):
                    break
            break

    def attempt(self, q: Array, shaken: bool = False) -> bool:
        """Solve from one start and keep the result if it is the best so far.

        Returns whether the perturbed starts were tried too, see `AssemblyProblem.reached`.
        """
        if self.parts:
            for _, part in self.parts:
                part.attempt(q)
            self._join()
            return False
        if not self.problem.has_digits(q):
            return False
        results = list(self.problem.reached([q], shaken))
        for result in results:
            self.keep(result)
        return shaken and _is_sound(self.problem, results[0])

    def keep(self, result: ClosureResult) -> None:
        """Keep a result if it is the best so far."""
        problem, free = self.problem, self.problem.settings.free
        if problem.let_go and result.error <= ACCEPTED and not self.parts:
            least, _ = problem.least(result.q, free)
            if problem.given or can_move(
                    problem.evaluation, free, problem.let_go, problem.pinned):
                result = problem.judged_at(least)
        error, fault, misses_gap = _judged(problem, result)
        if self.limits and not fault:
            result, fault = _moved_within_limits(problem, result)
        q, distance = result.q, _distance(problem, result)
        if fault:
            if misses_gap and (
                    self._beyond_gap is None or is_nearer(distance, self._beyond_gap[0])):
                self._beyond_gap = distance, (error, q, fault)
            if self.nearest_miss is None or error < self.nearest_miss[0]:
                self.nearest_miss = (error, q, fault)
            return
        if self.best is None or is_nearer(distance, self.best[0]):
            self.best, self.known = (distance, q), result.examined

    def _done(self, k: int) -> bool:
        """Whether no more starts are needed after start number `k`."""
        if self.best is None:
            return False
        if self._first_success < 0:
            self._first_success = k
        near = OUT_OF_REACH if self.problem.let_go else NEAR_GUESS
        return self.best[0] < near or k - self._first_success >= MORE_STARTS


def closed_at_once(problem: AssemblyProblem) -> tuple[Array, Examined] | None:
    """Return the result of the kernel for all loops at once, and its properties.

    None if a result needs a judgement.
    """
    is_compared = problem.can_perturb()  # else its distance is not that of the kernel
    if problem.pinned or not problem.has_digits(problem.goal) or not (is_compared or (
            problem.mechanism.whole is None and problem.settings.are_all_named)):
        return None
    results = problem.from_goal()
    best = results[0]
    if not best.is_unique:
        if not is_compared:
            return None
        for result in results:
            if _is_sound(problem, result):
                best = result if is_nearer(result.distance, best.distance) else best
            elif result is best or result.error <= max(problem.gap, OPEN):
                return None  # no rounding is more
        if len(problem.free_set.groups) > MOST_GROUPS and best.distance > NEAR_GUESS:
            return None  # each group of loops may have a nearer place
    return best.q, best.examined or problem.examined(best.q)


def is_nearer(distance: float, best: float) -> bool:
    """Whether a distance is clearly below the best one, beyond the error of closing."""
    return distance < best * (1.0 - 1e-6) - 1e-9


def _is_sound(problem: AssemblyProblem, result: ClosureResult) -> bool:
    """Whether a result is surely correct, without a comparison with others."""
    return (result.error <= ACCEPTED and not result.may_be_mirrored
            and problem.mechanism.whole is None)


def _judged(problem: AssemblyProblem, result: ClosureResult) -> tuple[float, str, bool]:
    """Return the closure error of a result, and the closure at fault or "".

    And whether all that is wrong is a gap of the file's numbers somewhat wider than allowed.
    """
    if _is_sound(problem, result):
        return result.error, "", False
    evaluation, whole, q = problem.evaluation, problem.whole, result.q.copy()
    evaluation.update(result.q)
    error = evaluation.closure_error
    # its own round-off is allowed; the turns of a fixed angle do not make its sine less exact
    q[[c.q for c in periodic(problem.mechanism) if c.name in problem.held]] = 0.0
    if not error <= min(max(ACCEPTED, coordinate_round_off(problem.mechanism, q)), OPEN):
        return error, evaluation.worst_closure(), False
    mirrored = evaluation.mirrored()
    if whole is not None:
        whole.update(result.q)
        if (opened := whole.closure_error) > problem.gap:
            is_near = opened <= NEARLY_OPEN * problem.gap and not mirrored
            return opened, whole.worst_closure(), is_near
    return error, mirrored, False


def _distance(problem: AssemblyProblem, result: ClosureResult) -> float:
    """Return the distance of a result from the named values."""
    if problem.free_set.is_whole:
        return result.distance
    there = with_values(problem.mechanism, result.q, problem.named)
    return math.hypot(*turn_free_difference(problem.mechanism, result.q, there).tolist())


def _moved_within_limits(
    problem: AssemblyProblem, result: ClosureResult
) -> tuple[ClosureResult, str]:
    """Return a result within the joint limits near a closed one, or this one and its violation."""
    mechanism, entries = problem.mechanism, problem.entries
    violated = violated_limit(mechanism, result.q, entries)
    if not violated:
        return result, ""
    q, free = within_limits(problem.evaluation, result.q, problem.settings.free, problem.let_go)
    bounded = problem.judged_at(problem.least(q, free, True)[0] if problem.let_go else
                                problem.closed(q, free, problem.pinned).q)
    if _judged(problem, bounded)[1] or violated_limit(mechanism, bounded.q, entries):
        return result, violated
    return bounded, ""


def _start_after(search: Search, before: Search, q: Array) -> Array:
    """Return a start (nq,) for drivers that may move now, from a search with fixed drivers.

    Groups of open loops are closed alone. Drivers take the values of that, and the other groups are
    closed with them.
    """
    q = before.put_together(q)
    for _ in range(ROUNDS):
        if before.best is not None:
            break
        for group in [group for group, part in before.parts if part.best is None]:
            alone = Search(search.problem.part(group), search.limits)
            alone.run(q)
            if alone.best is None:
                return q
            own = configuration_indices(search.mechanism, group)
            q[own] = alone.best[1][own]
        before = Search(search.problem.fixed_at(q), search.limits)
        before.run(q)
        q = before.put_together(q)
    return q


def _starts_worth_trying(problem: AssemblyProblem, q: Array) -> int:
    """Return the number of starts with fixed drivers, after the first one failed at q (nq,).

    It is 1 if loops near q would move the drivers, and small if a small motion of the drivers
    closes the loops: their values are then just out of reach.
    """
    table, sizes = problem.mechanism.coordinate_table, problem.mechanism.velocity_scale
    pinned = {name: x for name, x in problem.given.items() if table[name].q < 0}
    free = problem.free_without(name for name in problem.given if name not in pinned)
    if not problem.has_digits(q):
        return MAX_STARTS
    result = problem.closed(q, free, pinned)
    if not result.error <= ACCEPTED:
        return MAX_STARTS
    problem.evaluation.update(result.q)
    if not can_be_fixed(problem.evaluation, free, problem.standing, pinned):
        return 1
    there, _ = least_motion(
        problem.evaluation, result.q, free, problem.standing, problem.tolerance, pinned)
    moved = deviations(problem.mechanism, there, problem.standing)
    far = max((abs(by) / sizes[table[name].v] for name, by in moved.items()), default=0.0)
    return FEW_STARTS if far < OUT_OF_REACH else MAX_STARTS


NO_LENGTH = 30.0  # ratio to the mechanism's size beyond which a length is probably in another unit


def failure(search: Search) -> AssemblyError:
    """Return the error of a failed search, with its best attempt."""
    problem, mechanism = search.problem, search.mechanism
    where = f"mechanism {mechanism.name!r}"
    if problem.given:
        where += f" with {_values(problem.given)}"
    if search.nearest_miss is None:
        q = with_values(mechanism, mechanism.neutral, {**problem.named, **problem.held})
        return AssemblyError(f"{where} cannot be closed: {_too_large(mechanism, q)}",
                             closure_error=np.inf, worst_closure="")
    of, (error, q, worst) = search.worst or search, search.nearest_miss
    problem.evaluation.update(q)
    state = State(mechanism, q, closure_error=error, angles=problem.evaluation.angles)
    if not error <= ACCEPTED:
        message = f"{where} cannot be closed: {_gap_words(of, error, q, worst)}"
    elif worst.startswith("limit of "):
        own = any(worst.startswith(f"limit of {name}:") for name in problem.held)
        message = (f"{where} closes only outside the joint limits ({worst}); " + (
            "that is the value given: give one within its limits" if own else
            "give values of the drivers at which it stays inside"))
    else:
        message = f"{where} {_mirror_words(of, q)}"
    if problem.standing:
        message += (f"; drivers that were given no value stand at {_values(problem.standing)}: "
                    "give them values, or let them go with release=True or free=[...]")
    return AssemblyError(message, closure_error=error, worst_closure=worst, state=state)


def _values(given: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in given.items())


def _gap_words(search: Search, error: float, q: Array, worst: str) -> str:
    """Return how far closure `worst` stays open at the best attempt q (nq,), and why."""
    mechanism, whole = search.mechanism, search.problem.whole or search.problem.evaluation
    whole.update(q)
    gap = open_gap(whole.mechanism, whole, worst)
    if search.problem.whole is not None and search.problem.evaluation.closure_error <= ACCEPTED:
        return (f"the file's numbers are rounded, and redundant equations of closure {worst!r} "
                f"open by {gap} there (closure error {error:.1e}), beyond the gap of "
                f"{search.problem.gap:.0e} (gap={clearly_above(error):.0e} allows it)")
    large = size_of(mechanism, q) * COORDINATE_ERROR > ACCEPTED
    words = (f"closure {worst!r} stays open by {gap} (closure error {error:.1e}), the smallest gap "
             "found; ") + (_too_large(mechanism, q) if large else _open_words(search, q, worst))
    constraints = constraints_of(mechanism)
    by_path = [constraints.closure_of[x.equation] for x in constraints.angles
               if not x.is_of_joints]
    if worst in by_path and next(c for c in mechanism.closures if c.name == worst).type == "screw":
        words += ("; its joints do not tell how often this screw has turned, so that it is "
                  "assembled within half a turn of the guess: sweep to further turns, or put the "
                  "screw into the tree")
    return words


def _mirror_words(search: Search, q: Array) -> str:
    """Return why loops close only with opposite axes of closures, the evaluation at q (nq,).

    If they close with other driver values, these are the cause; else the frames are.
    """
    problem = search.problem
    opposite = opposite_axes(problem.evaluation.mechanism, problem.evaluation.data)
    names = " and ".join(map(repr, opposite))
    words = (f"closes only with the axes of closure {names} pointing opposite ways, which is "
             "no assembly of it; ")
    elsewhere = _closed_elsewhere(search, q) if problem.held else {}
    if elsewhere:
        values = _values(elsewhere)
        return (f"{words}the values are out of reach: left free, the loops close at "
                f"{values}")
    if not all(opposite.values()):
        return (f"{words}its three axes are interchanged, too: give its two frames "
                "the same orientation where the loop is closed")
    some = "one of its frames" if len(opposite) == 1 else "one frame of each"
    return f"{words}turn {some} round, by half a turn about its x axis"


def _open_words(search: Search, q: Array, worst: str) -> str:
    """Return why loops stay open at the best attempt q (nq,), closure `worst` the most."""
    problem = search.problem
    elsewhere = _closed_elsewhere(search, q) if problem.held else {}
    if not elsewhere:
        return (f"no assembly was found from here, nor does any of {MAX_STARTS} starts close "
                "the loops" + " at other values of the drivers" * bool(problem.held)
                + f": check {suspect_data(search.mechanism, worst)}; if they "
                "are right, give a guess nearer to a closed configuration"
                + ("" if problem.whole else gap_words(search.mechanism)))
    values = _values(elsewhere)
    n, entries = problem.evaluation.constraints.n_closure, problem.entries
    freedoms = int(entries.sum()) - decompose(problem.evaluation.jacobian[:n]).rank
    given = sum(problem.is_relevant(name) for name in problem.given)
    if given > freedoms:
        return (f"{given} coordinates have a value, but the mechanism has {freedoms} "
                f"freedom{'s' * (freedoms != 1)}: leave out {given - freedoms} "
                f"(the nearest values that fit are {values})")
    return ("a value is out of reach: left free, the loops close at "
            f"{values}")


def suspect_data(mechanism: Mechanism, worst: str) -> str:
    """Return the data of the most open closure that may be wrong, as text."""
    closure = {c.name: c for c in mechanism.closures}.get(worst)
    if closure and closure.joints:
        return f"ratio and offset of coupling {worst!r}, and the other closures"
    length = closure.geometry.length if closure else 0.0
    times = length / mechanism.characteristic_length
    hint = "" if times < NO_LENGTH else (
        f" (length = {length:g} m is {times:.3g} times the mechanism's size: {length:g} mm are "
        f"{length / 1e3:g})")
    return f"the frames of {worst!r} and the lengths between them{hint}"


def _closed_elsewhere(search: Search, q: Array) -> dict[str, float]:
    """Return values near the given ones at which the loops close, if there are any.

    The evaluation is then at that configuration.
    """
    problem = search.problem
    other = Search(problem.nearest_to(q), search.limits)
    other.run()
    if other.best is None:
        return {}
    problem.evaluation.update(other.best[1])
    table = problem.mechanism.coordinate_table
    return {name: coordinate_value(problem.mechanism, table[name], other.best[1])
            for name in problem.held if problem.is_relevant(name)}


def _too_large(mechanism: Mechanism, q: Array) -> str:
    """Return which coordinate of q is too large for closing the loops."""
    names, indices, sizes = coordinate_sizes(mechanism)
    name = max(zip(np.abs(q[indices] / sizes).tolist(), names, strict=True))[1]
    value = float(q[mechanism.index_of(mechanism.coordinate_table[name])])
    return (f"{name} = {value:.3g} {mechanism.coordinate_table[name].unit} is so large that its "
            "round-off alone opens the loops; give a value nearer to the mechanism's size of "
            f"{mechanism.characteristic_length:.3g} m (angles: fewer turns)")


def open_gap(mechanism: Mechanism, evaluation: LoopEquations, closure: str) -> str:
    """Return the error of a closure at the evaluation, in m or rad, as text."""
    constraints = evaluation.constraints
    rows = [i for i, name in enumerate(constraints.closure_of) if name == closure]
    kinds = {c.name: c for c in mechanism.closures}[closure]
    is_length = [row.is_length or (bool(kinds.joints)
                 and mechanism.coordinate(kinds.joints[-1]).unit == "m") for row in kinds.rows]
    values = evaluation.residual[rows]
    lengths = float(np.linalg.norm(values[np.array(is_length)]))
    angles = float(np.linalg.norm(values[~np.array(is_length)]))
    parts, least = [], TOLERANCES.half_precision * max(lengths, angles)
    if lengths > least:
        parts.append(f"{lengths * mechanism.characteristic_length:.1e} m")
    if angles > least:
        parts.append(f"{angles:.1e} rad")
    return " and ".join(parts) or "0"
