"""Attempts from several starts, and the best of what they found."""

from __future__ import annotations

from itertools import islice

from spatial_pin.assembly.search.closing import (
    ACCEPTED,
    Closing,
    gone_from,
    size_of,
)
from spatial_pin.assembly.search.guesses import (
    COORDINATE_ERROR,
    MAX_STARTS,
    NEAR_GUESS,
    starts_from,
)
from spatial_pin.assembly.search.loop_groups import LoopGroup
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


def is_nearer(distance: float, best: float) -> bool:
    """Whether a place is nearer than the best one, by more than closing leaves in doubt."""
    return distance < best * (1.0 - 1e-6) - 1e-9


class Search:
    """Attempts from several starts, and the best of what they found.

    Groups of loops that share nothing that may move are searched one by one.

    Args:
        closing: what closes the loops.
        limits: whether joint limits are kept.

    Attributes:
        parts: groups of loops, where there are several, and the search of each.
        worst: the search that has failed the most, of these or this one.
        best: the nearest closed configuration, after its distance from what is named.
        nearest_miss: closure error, configuration and what is at fault, of the best attempt else.
    """

    def __init__(self, closing: Closing, limits: bool) -> None:
        self.closing, self.limits, self.mechanism = closing, limits, closing.mechanism
        self.best: tuple[float, Array] | None = None
        self.nearest_miss: tuple[float, Array, str] | None = None
        self._known: Examined | None = None
        self._found_at = -1
        groups = closing.groups if len(closing.groups) > 1 else ()
        self.worst: Search = self
        self.parts = [(group, Search(closing.part(group), limits)) for group in groups]

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
            self._run(q, release)
            return
        for group, part in self.parts:
            if before is not None and before.has_closed(group):
                part.keep(part.closing.seen(before.put_together(self.closing.goal)))
            else:
                part.run(q, release)
        self._join()

    def _beside(self, before: Search, q: Array | None) -> Array:
        """Return a start (nq,) for where drivers may go that stood in the search before.

        Groups of loops that were not closed are closed by themselves. Drivers stand where that
        takes them, and the others are closed there.
        """
        q = before.put_together(self.closing.goal if q is None else q)
        for _ in range(ROUNDS):
            if before.best is not None:
                break
            for group in [group for group, part in before.parts if part.best is None]:
                alone = Search(self.closing.part(group), self.limits)
                alone.run(q)
                if alone.best is None:
                    return q
                q[group.places] = alone.best[1][group.places]
            before = Search(self.closing.standing_at(q), self.limits)
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
                q[group.places] = part.best[1][group.places]
        return q

    def _join(self) -> None:
        """Put together what the groups of loops have led to."""
        q = self.put_together(self.closing.goal)
        failed = [(group, part) for group, part in self.parts if part.best is None]
        misses = [(*part.nearest_miss, group, part) for group, part in failed if part.nearest_miss]
        if not failed:
            self.keep(self.closing.seen(q))
        elif len(misses) == len(failed):
            error, there, problem, group, self.worst = max(misses, key=lambda x: x[0])
            q[group.places] = there[group.places]
            self.nearest_miss = error, q, problem

    def _run(self, q: Array | None, release: bool) -> None:
        closing, most = self.closing, MAX_STARTS
        first = closing.goal if q is None else q
        compared = self.attempt(first, not self.limits and closing.may_be_shaken())
        if compared or self._done(0):
            return
        if self.best is None and release and closing.standing:
            most = self._worth_trying(first)
        if closing.further is None:
            return
        starts = starts_from(self.mechanism, first, closing.held, closing.named, closing.further)
        for k in range(1, most):
            if self.best is None:
                self.attempt(next(starts))
                if self._done(k):
                    break
                continue
            more = list(islice(starts, min(MORE_STARTS, most - k)))  # mostly all of them count
            for number, found in enumerate(closing.reached(more), start=k):
                self.keep(found)
                if self._done(number):
                    break
            break

    def _worth_trying(self, q: Array) -> int:
        """Return how many starts the drivers that stand are worth, the first having failed at q.

        None more where the loops near q would move them, and a few where they need go a little only
        for the loops to close: their values are just out of reach then.
        """
        closing = self.closing
        table = self.mechanism.coordinate_table
        pinned = {name: x for name, x in closing.given.items() if table[name].q < 0}
        free = closing.left_by(name for name in closing.given if name not in pinned)
        if size_of(self.mechanism, q) * COORDINATE_ERROR >= 1.0:
            return MAX_STARTS
        there, error, _ = closing.closed(q, free, pinned)
        if not error <= ACCEPTED:
            return MAX_STARTS
        closing.evaluation.update(there)
        if not can_stand(closing.evaluation, free, closing.standing, pinned):
            return 1
        there, _ = least_motion(
            closing.evaluation, there, free, closing.standing, closing.tolerance, pinned)
        gone = gone_from(self.mechanism, there, closing.standing)
        sizes = self.mechanism.velocity_scale
        far = max((abs(by) / sizes[table[name].v] for name, by in gone.items()), default=0.0)
        return FEW_STARTS if far < OUT_OF_REACH else MAX_STARTS

    def attempt(self, q: Array, shaken: bool = False) -> bool:
        """Solve from one start and keep the result if it is the best so far.

        Returns:
            Whether the further starts have been tried with it, see `Closing.reached`.
        """
        for _, part in self.parts:
            part.attempt(q)
        if self.parts:
            self._join()
            return False
        if size_of(self.mechanism, q) * COORDINATE_ERROR >= 1.0:  # it has no digit
            return False
        found = list(self.closing.reached([q], shaken))
        for place in found:
            self.keep(place)
        return shaken and self.closing.is_sound(found[0])

    def keep(self, found: Reached) -> None:
        """Keep where closing has led if it is the best so far."""
        closing = self.closing
        if closing.let_go and found.error <= ACCEPTED and not self.parts:
            least, _ = closing.least(found.q, closing.free)
            if closing.given or can_move(
                    closing.evaluation, closing.free, closing.let_go, closing.pinned):
                found = closing.seen(least)
        error, problem = closing.judged(found)
        violated = self._violated(found.q) if self.limits and not problem else ""
        if violated:
            q, loose_ones = within_limits(closing.evaluation, found.q, closing.free, closing.let_go)
            bounded = closing.seen(closing.least(q, loose_ones, True)[0] if closing.let_go else
                                   closing.closed(q, loose_ones, closing.pinned).q)
            if closing.judged(bounded)[1] or self._violated(bounded.q):
                problem = violated
            else:
                found = bounded
        q = found.q
        if problem:
            if self.nearest_miss is None or error < self.nearest_miss[0]:
                self.nearest_miss = (error, q, problem)
            return
        distance = closing.distance(found)
        if self.best is None or is_nearer(distance, self.best[0]):
            self.best, self._known = (distance, q), found.examined

    def _violated(self, q: Array) -> str:
        """Return which joint limit q (nq,) breaks, as text: of what the loops depend on."""
        return violated_limit(self.mechanism, q, self.closing.entries)

    def examined(self) -> Examined:
        """Return what the best closed configuration is like, once there is one."""
        if self._known is None:
            assert self.best is not None
            self._known = self.closing.examined(self.best[1])
        return self._known

    def _done(self, k: int) -> bool:
        """Whether further starts can be spared after start number `k`."""
        if self.best is None:
            return False
        if self._found_at < 0:
            self._found_at = k
        near = OUT_OF_REACH if self.closing.let_go else NEAR_GUESS
        return self.best[0] < near or k - self._found_at >= MORE_STARTS
