"""Search of an assembly: attempts from several starts, and the best result."""

from __future__ import annotations

from itertools import islice

from spatial_pin._support.lazy import cached_property
from spatial_pin.assembly.search.assembly_problem import (
    ACCEPTED,
    AssemblyProblem,
    deviations,
    is_nearer,
)
from spatial_pin.assembly.search.guesses import MAX_STARTS, NEAR_GUESS, starts_from
from spatial_pin.assembly.search.loop_groups import LoopGroup, configuration_indices
from spatial_pin.assembly.search.release import (
    can_be_fixed,
    can_move,
    least_motion,
    violated_limit,
    within_limits,
)
from spatial_pin.kernel.closer import AT_ONCE, Examined, Reached
from spatial_pin.numerics.linalg import Array

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
        is_beyond_gap: whether a nearer branch than others needs a wider gap for the file's numbers.
    """

    is_beyond_gap = _guess_is_beyond = False

    def __init__(self, problem: AssemblyProblem, limits: bool) -> None:
        self.problem, self.limits, self.mechanism = problem, limits, problem.mechanism
        self.best: tuple[float, Array] | None = None
        self.nearest_miss: tuple[float, Array, str] | None = None
        self._beyond_gap: tuple[float, tuple[float, Array, str]] | None = None  # distance and miss
        self._known: Examined | None = None
        self._first_success = -1
        self._worst: Search | None = None

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

        Args:
            q: (nq,) the first one, with the fixed values; default: the guess.
            release: whether to stop early if fixed drivers cannot work.
            before: the search with fixed drivers before their release: its closed loops stay.
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
            if before is not None and before.has_closed(group):
                part.keep(part.problem.judged_at(before.put_together(self.problem.goal)))
            else:
                part.run(q, release)
        self._join()

    @property
    def worst(self) -> Search:
        """The search with the largest error, of a group of loops or this one."""
        return self._worst or self

    def has_closed(self, group: LoopGroup) -> bool:
        """Whether all loops of a group were closed in the searches of groups."""
        return bool(self.parts) and all(
            part.best is not None for own, part in self.parts
            if not set(own.closures).isdisjoint(group.closures))

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
            error, there, fault, group, self._worst = max(misses, key=lambda x: x[0])
            own = configuration_indices(self.mechanism, group)
            q[own] = there[own]
            self.nearest_miss = error, q, fault

    def _run(self, first: Array, release: bool) -> None:
        problem, most = self.problem, MAX_STARTS
        compared = self.attempt(first, not self.limits and problem.can_perturb())
        self._guess_is_beyond = self._beyond_gap is not None
        if compared or self._done(0):
            return
        if self.best is None and release and problem.standing:
            most = _starts_worth_trying(problem, first)
        if problem.spread is None:
            return
        starts = starts_from(self.mechanism, first, problem.held, problem.named, problem.spread)
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

        Returns:
            Whether the perturbed starts were tried too, see `AssemblyProblem.reached`.
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
        return shaken and self.problem.is_sound(results[0])

    def keep(self, result: Reached) -> None:
        """Keep a result if it is the best so far."""
        problem, free = self.problem, self.problem.free_set.free
        if problem.let_go and result.error <= ACCEPTED and not self.parts:
            least, _ = problem.least(result.q, free)
            if problem.given or can_move(
                    problem.evaluation, free, problem.let_go, problem.pinned):
                result = problem.judged_at(least)
        error, fault = problem.judged(result)

        def broken(q: Array) -> str:
            return violated_limit(self.mechanism, q, problem.entries)

        violated = broken(result.q) if self.limits and not fault else ""
        if violated:
            q, loose_ones = within_limits(problem.evaluation, result.q, free, problem.let_go)
            bounded = problem.judged_at(problem.least(q, loose_ones, True)[0] if problem.let_go else
                                   problem.closed(q, loose_ones, problem.pinned).q)
            if problem.judged(bounded)[1] or broken(bounded.q):
                fault = violated
            else:
                result = bounded
        q = result.q
        if fault:
            nearest = self._beyond_gap
            if problem.misses_gap(q, error) and (
                    nearest is None or is_nearer(problem.distance(result), nearest[0])):
                self._beyond_gap = problem.distance(result), (error, q, fault)
            if self.nearest_miss is None or error < self.nearest_miss[0]:
                self.nearest_miss = (error, q, fault)
            return
        distance = problem.distance(result)
        if self.best is None or is_nearer(distance, self.best[0]):
            self.best, self._known = (distance, q), result.examined

    def examined(self) -> Examined:
        """Return the properties of the best closed configuration."""
        if self._known is None:
            assert self.best is not None
            self._known = self.problem.examined(self.best[1])
        return self._known

    def _done(self, k: int) -> bool:
        """Whether no more starts are needed after start number `k`."""
        if self.best is None:
            return False
        if self._first_success < 0:
            self._first_success = k
        near = OUT_OF_REACH if self.problem.let_go else NEAR_GUESS
        return self.best[0] < near or k - self._first_success >= MORE_STARTS


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
    there, error, _ = problem.closed(q, free, pinned)
    if not error <= ACCEPTED:
        return MAX_STARTS
    problem.evaluation.update(there)
    if not can_be_fixed(problem.evaluation, free, problem.standing, pinned):
        return 1
    there, _ = least_motion(
        problem.evaluation, there, free, problem.standing, problem.tolerance, pinned)
    moved = deviations(problem.mechanism, there, problem.standing)
    far = max((abs(by) / sizes[table[name].v] for name, by in moved.items()), default=0.0)
    return FEW_STARTS if far < OUT_OF_REACH else MAX_STARTS
