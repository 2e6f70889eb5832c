"""Attempts from several starts, and the best of what they found."""

from __future__ import annotations

from itertools import islice

from spatial_pin._support.lazy import cached_property
from spatial_pin.assembly.search.assembly_problem import (
    ACCEPTED,
    AssemblyProblem,
    gone_from,
    is_nearer,
)
from spatial_pin.assembly.search.guesses import MAX_STARTS, NEAR_GUESS, starts_from
from spatial_pin.assembly.search.loop_groups import LoopGroup, places_of
from spatial_pin.assembly.search.release import (
    can_move,
    can_stand,
    least_motion,
    violated_limit,
    within_limits,
)
from spatial_pin.kernel.closer import AT_ONCE, Examined, Reached
from spatial_pin.numerics.linalg import Array

# Starts of drivers that stand, where they need go a little only for the loops to close: a place
# beside where they stand is found from there, and other starts seldom find a nearer one.
FEW_STARTS = 4
# Starts after the first success, to find the branch nearest to the guess: of two branches that as
# many starts end at, the nearer is missed in one of 256 cases. They are closed in one call.
MORE_STARTS = AT_ONCE
# Times that drivers go for the loops that do not close where they stand: the first ones may take
# them to where others do not.
ROUNDS = 3
# rad, characteristic lengths; drivers that go no further are just out of reach: by rounding of what
# one reads off a drawing, not by a wrong value.
OUT_OF_REACH = 0.05


class Search:
    """Attempts from several starts, and the best of what they found.

    Groups of loops that share nothing that may move are searched one by one.

    Args:
        problem: what is to be closed.
        limits: whether joint limits are kept.

    Attributes:
        worst: the search that has failed the most, of those of groups of loops or this one.
        best: the nearest closed configuration, after its distance from what is named.
        nearest_miss: closure error, configuration and what is at fault, of the best attempt else.
    """

    def __init__(self, problem: AssemblyProblem, limits: bool) -> None:
        self.problem, self.limits, self.mechanism = problem, limits, problem.mechanism
        self.best: tuple[float, Array] | None = None
        self.nearest_miss: tuple[float, Array, str] | None = None
        self._known: Examined | None = None
        self._found_at = -1
        self.worst: Search = self

    @cached_property
    def parts(self) -> list[tuple[LoopGroup, Search]]:
        """Groups of loops, where there are several, and the search of each."""
        groups = self.problem.free_set.groups
        return [(group, Search(self.problem.part(group), self.limits))
                for group in (groups if len(groups) > 1 else ())]

    def run(
        self, q: Array | None = None, release: bool = False, before: Search | None = None
    ) -> None:
        """Try starts until one is surely the nearest, or all have failed.

        Args:
            q: (nq,) the first one, where what is held has its values; default: the guess.
            release: whether to give up where the drivers that stand cannot.
            before: the search in which drivers stood that may go now: what it has closed stays.
        """
        if before is not None and before.parts:
            q = self._beside(before, q)
        if not self.parts:
            self._run(self.problem.goal if q is None else q, release)
            return
        for group, part in self.parts:
            if before is not None and before.has_closed(group):
                part.keep(part.problem.seen(before.put_together(self.problem.goal)))
            else:
                part.run(q, release)
        self._join()

    def _beside(self, before: Search, q: Array | None) -> Array:
        """Return a start (nq,) for where drivers may go that stood in the search before.

        Groups of loops that were not closed are closed by themselves. Drivers stand where that
        takes them, and the others are closed there.
        """
        q = before.put_together(self.problem.goal if q is None else q)
        for _ in range(ROUNDS):
            if before.best is not None:
                break
            for group in [group for group, part in before.parts if part.best is None]:
                alone = Search(self.problem.part(group), self.limits)
                alone.run(q)
                if alone.best is None:
                    return q
                own = places_of(self.mechanism, group)
                q[own] = alone.best[1][own]
            before = Search(self.problem.standing_at(q), self.limits)
            before.run(q)
            q = before.put_together(q)
        return q

    def has_closed(self, group: LoopGroup) -> bool:
        """Whether all loops of a group are closed, which were searched group by group."""
        return bool(self.parts) and all(
            part.best is not None for own, part in self.parts
            if not set(own.closures).isdisjoint(group.closures))

    def put_together(self, q: Array) -> Array:
        """Return q (nq,) with each group of loops that is closed where it is then."""
        q = q.copy()
        for group, part in self.parts:
            if part.best is not None:
                own = places_of(self.mechanism, group)
                q[own] = part.best[1][own]
        return q

    def _join(self) -> None:
        """Put together what the groups of loops have led to."""
        q = self.put_together(self.problem.goal)
        failed = [(group, part) for group, part in self.parts if part.best is None]
        misses = [(*part.nearest_miss, group, part) for group, part in failed if part.nearest_miss]
        if not failed:
            self.keep(self.problem.seen(q))
        elif len(misses) == len(failed):
            error, there, fault, group, self.worst = max(misses, key=lambda x: x[0])
            own = places_of(self.mechanism, group)
            q[own] = there[own]
            self.nearest_miss = error, q, fault

    def _run(self, first: Array, release: bool) -> None:
        problem, most = self.problem, MAX_STARTS
        compared = self.attempt(first, not self.limits and problem.may_be_shaken())
        if compared or self._done(0):
            return
        if self.best is None and release and problem.standing:
            most = self._worth_trying(first)
        if problem.further is None:
            return
        starts = starts_from(self.mechanism, first, problem.held, problem.named, problem.further)
        for k in range(1, most):
            if self.best is None:
                self.attempt(next(starts))
                if self._done(k):
                    break
                continue
            more = list(islice(starts, min(MORE_STARTS, most - k)))  # mostly all of them count
            for number, found in enumerate(problem.reached(more), start=k):
                self.keep(found)
                if self._done(number):
                    break
            break

    def _worth_trying(self, q: Array) -> int:
        """Return how many starts the drivers that stand are worth, the first having failed at q.

        None more where the loops near q would move them, and a few where they need go a little only
        for the loops to close: their values are just out of reach then.
        """
        problem = self.problem
        table = self.mechanism.coordinate_table
        pinned = {name: x for name, x in problem.given.items() if table[name].q < 0}
        free = problem.left_by(name for name in problem.given if name not in pinned)
        if not problem.has_digits(q):
            return MAX_STARTS
        there, error, _ = problem.closed(q, free, pinned)
        if not error <= ACCEPTED:
            return MAX_STARTS
        problem.evaluation.update(there)
        if not can_stand(problem.evaluation, free, problem.standing, pinned):
            return 1
        there, _ = least_motion(
            problem.evaluation, there, free, problem.standing, problem.tolerance, pinned)
        gone = gone_from(self.mechanism, there, problem.standing)
        sizes = self.mechanism.velocity_scale
        far = max((abs(by) / sizes[table[name].v] for name, by in gone.items()), default=0.0)
        return FEW_STARTS if far < OUT_OF_REACH else MAX_STARTS

    def attempt(self, q: Array, shaken: bool = False) -> bool:
        """Solve from one start and keep the result if it is the best so far.

        Returns:
            Whether the further starts have been tried with it, see `AssemblyProblem.reached`.
        """
        if self.parts:
            for _, part in self.parts:
                part.attempt(q)
            self._join()
            return False
        if not self.problem.has_digits(q):
            return False
        found = list(self.problem.reached([q], shaken))
        for place in found:
            self.keep(place)
        return shaken and self.problem.is_sound(found[0])

    def keep(self, found: Reached) -> None:
        """Keep where closing has led if it is the best so far."""
        problem, free = self.problem, self.problem.free_set.free
        if problem.let_go and found.error <= ACCEPTED and not self.parts:
            least, _ = problem.least(found.q, free)
            if problem.given or can_move(
                    problem.evaluation, free, problem.let_go, problem.pinned):
                found = problem.seen(least)
        error, fault = problem.judged(found)
        violated = self._violated(found.q) if self.limits and not fault else ""
        if violated:
            q, loose_ones = within_limits(problem.evaluation, found.q, free, problem.let_go)
            bounded = problem.seen(problem.least(q, loose_ones, True)[0] if problem.let_go else
                                   problem.closed(q, loose_ones, problem.pinned).q)
            if problem.judged(bounded)[1] or self._violated(bounded.q):
                fault = violated
            else:
                found = bounded
        q = found.q
        if fault:
            if self.nearest_miss is None or error < self.nearest_miss[0]:
                self.nearest_miss = (error, q, fault)
            return
        distance = problem.distance(found)
        if self.best is None or is_nearer(distance, self.best[0]):
            self.best, self._known = (distance, q), found.examined

    def _violated(self, q: Array) -> str:
        """Return which joint limit q (nq,) breaks, as text: of what the loops depend on."""
        return violated_limit(self.mechanism, q, self.problem.entries)

    def examined(self) -> Examined:
        """Return what the best closed configuration is like, once there is one."""
        if self._known is None:
            assert self.best is not None
            self._known = self.problem.examined(self.best[1])
        return self._known

    def _done(self, k: int) -> bool:
        """Whether further starts can be spared after start number `k`."""
        if self.best is None:
            return False
        if self._found_at < 0:
            self._found_at = k
        near = OUT_OF_REACH if self.problem.let_go else NEAR_GUESS
        return self.best[0] < near or k - self._found_at >= MORE_STARTS
