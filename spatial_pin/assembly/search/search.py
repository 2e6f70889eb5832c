"""Attempts from several starts, and the best of what they found."""

from __future__ import annotations

from collections.abc import Sequence
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
from spatial_pin.assembly.search.release import can_move, can_stand, least_motion
from spatial_pin.assembly.search.within_limits import violated_limit, within_limits
from spatial_pin.kernel.closer import AT_ONCE, Examined, Reached
from spatial_pin.numerics.linalg import Array

# Starts of drivers that stand, where they need go a little only for the loops to close: a place
# beside where they stand is found from there, and other starts seldom find a nearer one.
FEW_STARTS = 4
# Starts after the first success, to find the branch nearest to the guess: of two branches that as
# many starts end at, the nearer is missed in one of 256 cases. They are closed in one call.
MORE_STARTS = AT_ONCE
# rad, characteristic lengths; drivers that go no further are just out of reach: by rounding of what
# one reads off a drawing, not by a wrong value.
OUT_OF_REACH = 0.05


def is_nearer(distance: float, best: float) -> bool:
    """Whether a place is nearer than the best one, by more than closing leaves in doubt."""
    return distance < best * (1.0 - 1e-6) - 1e-9


class Search:
    """Attempts from several starts, and the best of what they found.

    Args:
        closing: what closes the loops.
        limits: whether joint limits are kept.

    Attributes:
        best: the nearest closed configuration, after its distance from what is named.
        nearest_miss: closure error, configuration and what is at fault, of the best attempt else.
    """

    def __init__(self, closing: Closing, limits: bool) -> None:
        self.closing, self.limits, self.mechanism = closing, limits, closing.mechanism
        self.best: tuple[float, Array] | None = None
        self.nearest_miss: tuple[float, Array, str] | None = None
        self._known: Examined | None = None
        self._found_at = -1

    def run(self, q: Array | None = None, release: bool = False) -> None:
        """Try starts until one is surely the nearest, or all have failed.

        Args:
            q: (nq,) the first one, where what is held has its values; default: the guess.
            release: whether to give up where the drivers that stand cannot.
        """
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
            if self.best is not None:
                self._compare(list(islice(starts, min(MORE_STARTS, most - k))), k)
                break
            self.attempt(next(starts))
            if self._done(k):
                break

    def _compare(self, starts: Sequence[Array], first: int) -> None:
        """Try starts after one that has led to a closed configuration: mostly all of them count.

        Args:
            starts: configurations (nq,).
            first: number of the first of them.
        """
        for k, found in enumerate(self.closing.reached(starts), start=first):
            self._keep(found)
            if self._done(k):
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
        if size_of(self.mechanism, q) * COORDINATE_ERROR >= 1.0:  # it has no digit
            return False
        found = list(self.closing.reached([q], shaken))
        for place in found:
            self._keep(place)
        return shaken and self.closing.is_sound(found[0])

    def _keep(self, found: Reached) -> None:
        """Keep where closing has led if it is the best so far."""
        closing = self.closing
        if closing.let_go and found.error <= ACCEPTED:
            least, _ = closing.least(found.q, closing.free)
            if closing.given or can_move(
                    closing.evaluation, closing.free, closing.let_go, closing.pinned):
                found = closing.seen(least)
        error, problem = closing.judged(found)
        violated = violated_limit(self.mechanism, found.q) if self.limits and not problem else ""
        if violated:
            q, loose_ones = within_limits(closing.evaluation, found.q, closing.free, closing.let_go)
            bounded = closing.seen(closing.least(q, loose_ones)[0] if closing.let_go else
                                   closing.closed(q, loose_ones, closing.pinned).q)
            if closing.judged(bounded)[1] or violated_limit(self.mechanism, bounded.q):
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
