"""What an assembly closes with what it holds, and how it judges what that has led to."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import cached_property, made_once
from spatial_pin.assembly.close import NOTHING, close, closed, finite
from spatial_pin.assembly.search.closure_settings import asked_of, free_but, left_of
from spatial_pin.assembly.search.guesses import NEAR_GUESS, OPEN, Guess, far_ones
from spatial_pin.assembly.search.loop_groups import LoopGroup, part_of
from spatial_pin.assembly.search.release import least_motion
from spatial_pin.assembly.search.whole_turns import periodic, turned_apart
from spatial_pin.assembly.state import all_angles
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.closer import LOOSE, Closed, Examined, Meant, Reached, closer_of
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.coordinates import coordinate_round_off, coordinate_value, with_values
from spatial_pin.mechanism.joint_limits import position_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

ACCEPTED = TOLERANCES.closed


class AcquiredEquations:  # with Equations(...) as equations
    """The equations of a mechanism, acquired when they are first evaluated, and released.

    Args:
        mechanism: the mechanism.
        angles: (n_angles,) that its screws count turns from [rad]; default: none.

    Attributes:
        reference: (n_angles,) these angles.
        whole: those of the mechanism with all equations, where the file's numbers are rounded.
    """

    def __init__(self, mechanism: Mechanism, angles: Array | None = None) -> None:
        self.mechanism = mechanism
        self._acquired: list[loops_of] = []
        n = constraints_of(mechanism).n_angles
        self.reference = angles if angles is not None and len(angles) == n else np.zeros(n)
        self.whole: LoopEquations | None = None

    def __enter__(self) -> AcquiredEquations:
        """Return this."""
        if self.mechanism.whole is not None:
            self.whole = self._loops_of(
                self.mechanism.whole, all_angles(self.mechanism, self.reference))
        return self

    def __exit__(self, *error: Any) -> None:
        """Release what was acquired."""
        for acquired in self._acquired:
            acquired.__exit__(*error)

    def part(self, group: LoopGroup) -> AcquiredEquations:
        """Return the equations of a group of loops; they are released with these."""
        own = AcquiredEquations(part_of(self.mechanism, group.closures),
                                self.reference[group.angles])
        own._acquired = self._acquired
        return own.__enter__()

    @cached_property
    def evaluation(self) -> LoopEquations:
        """The equations of the mechanism."""
        return self._loops_of(self.mechanism, self.reference)

    def _loops_of(self, mechanism: Mechanism, angles: Array) -> LoopEquations:
        acquired = loops_of(mechanism, angles)
        found = acquired.__enter__()
        self._acquired.append(acquired)
        return found


class Closing:
    """The equations to close, what is held meanwhile, and what counts as closed.

    Where the file's numbers are rounded all equations lead, and stay closed to the gap.

    Args:
        equations: of the mechanism.
        held: coordinates that were given values.
        standing: drivers that stand, by coordinate.
        guess: where to start, and what is named; what is held need not have its value there.
        accuracy: the tolerance to reach.
        let_go: drivers that go as little as possible from these values.
        still: velocity entries that stand besides; default those of the free bases.

    Attributes:
        entries: (nv,) the velocities that are looked at: of a group of loops those of its joints.
    """

    def __init__(
        self,
        equations: AcquiredEquations,
        held: Mapping[str, float],
        standing: Mapping[str, float],
        guess: Guess,
        accuracy: Accuracy,
        let_go: Mapping[str, float] | None = None,
        still: tuple[int, ...] | None = None,
    ) -> None:
        self.mechanism, self.equations, self.whole = equations.mechanism, equations, equations.whole
        self.given, self.standing = held, standing
        self.held, self.let_go = {**held, **standing}, let_go or {}
        self.accuracy, self.tolerance = accuracy, accuracy.tolerance
        self.gap = accuracy.gap
        self._cut = self.mechanism.kept.cut if self.mechanism.kept else 0.0
        left = left_of(self.mechanism, tuple(self.held), tuple(self.let_go), guess.names, still)
        self.pinned = {name: self.held[name] for name in left.pinned} if left.pinned else NOTHING
        self.still, self.free, self.first = left.still, left.free, left.first
        self.further, self._is_whole, self._guess = left.further, left.is_whole, guess
        self._left = left
        self.entries = free_but(self.mechanism, still or (), ())
        self.goal = with_values(self.mechanism, guess.q, self.held)

    @property
    def groups(self) -> tuple[LoopGroup, ...]:
        """The groups of loops that share nothing that may move."""
        return self._left.groups

    def part(self, group: LoopGroup) -> Closing:
        """Return what closes a group of loops while all else stands at the guess."""
        still = {*self.still, *np.flatnonzero(~group.entries).tolist()}
        table = self.mechanism.coordinate_table
        standing, let_go = ({name: x for name, x in some.items() if group.entries[table[name].v]}
                            for some in (self.standing, self.let_go))
        part = Closing(self.equations.part(group), self.given, standing, self._guess,
                       self.accuracy, let_go, tuple(sorted(still)))
        part._cut = self._cut
        return part

    def standing_at(self, q: Array) -> Closing:
        """Return the same where the drivers let go stand as at q (nq,)."""
        table = self.mechanism.coordinate_table
        standing = {name: coordinate_value(self.mechanism, table[name], q) for name in self.let_go}
        return Closing(self.equations, self.given, standing, self._guess, self.accuracy,
                       still=self.still)

    def is_looked_at(self, name: str) -> bool:
        """Whether a coordinate is one of the `entries`."""
        return bool(self.entries[self.mechanism.coordinate_table[name].v])

    @cached_property
    def named(self) -> dict[str, float]:
        """What else the guess names, by coordinate."""
        return {k: x for k, x in self._guess.values.items() if k not in self.held}

    @property
    def evaluation(self) -> LoopEquations:
        """The equations of the mechanism."""
        return self.equations.evaluation

    def left_by(self, held: Iterable[str]) -> NDArray[np.bool_]:
        """Return (nv,) which velocities are left where coordinates and free bases are held."""
        return free_but(self.mechanism, self.still, held)

    def closed(
        self, q: Array, free: NDArray[np.bool_], pinned: Mapping[str, float],
        tolerance: float | None = None,
    ) -> Closed:
        """Close the loops from q (nq,), all equations first as well as they can be."""
        tolerance = tolerance or self.tolerance
        if self.whole is not None:
            q = closed(self.whole.mechanism, q, free, self.whole.angle_reference, tolerance,
                       pinned=pinned, cut=self._cut).q
        return closed(self.mechanism, q, free, self.equations.reference, tolerance,
                      pinned=pinned)

    def reached(self, starts: Sequence[Array], shaken: bool = False) -> Iterable[Reached]:
        """Return where starts (nq,) lead, first while what is named is held too.

        Of starts `AT_ONCE` at most; where it is `shaken` see `Closer.reach`.
        """
        if self.whole is not None:
            return map(self._reached_by_all, starts)
        if not starts:
            return ()
        asked = asked_of(self.mechanism, self._left, self.tolerance)
        with closer_of(self.mechanism, self.pinned) as closer:
            found = closer.reach(starts, asked, self.goal, self.equations.reference,
                                 self.pinned.values(), shaken)
        return map(finite, found)

    def _reached_by_all(self, q: Array) -> Reached:
        """Return where a start (nq,) leads, all equations first."""
        if self.first is not None:
            q = self.closed(q, self.first, self.pinned, max(self.tolerance, LOOSE)).q
        return self.seen(self.closed(q, self.free, self.pinned).q)

    def may_be_shaken(self) -> bool:
        """Whether `reached` can try further starts with the first one, in one call."""
        further = self.further
        if self.whole is not None or self.let_go or not self._is_whole or further is None:
            return False
        return not (further.lengths and far_ones(self.mechanism, self.named, further))

    def seen(self, q: Array) -> Reached:
        """Return what q (nq,) is, whole turns taken off its angles."""
        with closer_of(self.mechanism) as closer:
            return closer.judge(q, self.equations.reference, Meant(
                self.goal, self._left.said, *position_limits(self.mechanism)))

    def examined(self, q: Array) -> Examined:
        """Return what the equations, of the mechanism alone, are like at q (nq,)."""
        with closer_of(self.mechanism) as closer:
            return closer.examine(q, self.equations.reference)

    def is_sound(self, found: Reached) -> bool:
        """Whether nothing is at fault where closing has led, as far as that tells by itself."""
        return self.whole is None and found.error <= ACCEPTED and not found.may_be_mirrored

    def judged(self, found: Reached) -> tuple[float, str]:
        """Return the closure error of what was found, and the closure at fault or nothing."""
        if self.is_sound(found):
            return found.error, ""
        evaluation = self.evaluation
        evaluation.update(found.q)
        error = evaluation.closure_error
        fault = "" if error <= self.accepted(found.q) else evaluation.worst_closure()
        if self.whole is not None and not fault:
            self.whole.update(found.q)
            if self.whole.closure_error > self.gap:
                return self.whole.closure_error, self.whole.worst_closure()
        return error, fault or evaluation.mirrored()

    def distance(self, found: Reached) -> float:
        """Return how far what was found is from what is named."""
        if self._is_whole:
            return found.distance
        there = with_values(self.mechanism, found.q, self.named)
        return math.hypot(*turned_apart(self.mechanism, found.q, there).tolist())

    def accepted(self, q: Array) -> float:
        """Return the closure error that q (nq,) may have, round-off of its own included.

        An angle that is held counts turns without making its sine any worse.
        """
        q = q.copy()
        q[[c.q for c in periodic(self.mechanism) if c.name in self.held]] = 0.0
        return min(max(ACCEPTED, coordinate_round_off(self.mechanism, q)), OPEN)

    def least(
        self, q: Array, free: NDArray[np.bool_], limits: bool = False
    ) -> tuple[Array, float]:
        """Return the closed configuration near q in which the drivers let go have gone the least.

        Those that need not go at all stand exactly. Where limits are kept, what is not free to
        close the loops at first, since it stands at a limit, may leave it.
        """
        q = self.closed(q, free, self.pinned).q
        free = self.free if limits else free
        q, error = least_motion(self.evaluation, q, free, self.let_go, self.tolerance,
                                self.pinned, limits)
        kept = {name: self.let_go[name] for name in self.let_go
                if name not in gone_from(self.mechanism, q, self.let_go)}
        if not kept:
            return q, error
        table = self.mechanism.coordinate_table
        entries = [name for name in kept if table[name].q >= 0]
        pinned = {name: x for name, x in kept.items() if table[name].q < 0}
        there, open_by = close(self.evaluation, with_values(self.mechanism, q, kept),
                               free & self.left_by(entries), self.tolerance,
                               pinned={**self.pinned, **pinned})
        moved = pin.difference(self.mechanism.model, q, there) / self.mechanism.velocity_scale
        near = bool(np.abs(moved).max(initial=0.0) < NEAR_GUESS)
        return (there, open_by) if open_by <= ACCEPTED and near else (q, error)


def gone_from(mechanism: Mechanism, q: Array, said: Mapping[str, float]) -> dict[str, float]:
    """Return how far coordinates are from values, those that are there left out [rad, m]."""
    gone: dict[str, float] = {}
    table = mechanism.coordinate_table
    for name, value in said.items():
        by = coordinate_value(mechanism, table[name], q) - value
        if abs(by) > TOLERANCES.nothing * mechanism.velocity_scale[table[name].v]:
            gone[name] = by
    return gone


@made_once
def coordinate_sizes(mechanism: Mechanism) -> tuple[list[str], NDArray[np.intp], Array]:
    """Return names, places in q, and sizes of coordinates, but of periodic angles."""
    turning = {c.name for c in periodic(mechanism)}
    found = [(name, at, mechanism.velocity_scale[c.v])
             for name, c in mechanism.coordinate_table.items()
             if (at := mechanism.place_of(c)) >= 0 and name not in turning]
    return ([x[0] for x in found], np.array([x[1] for x in found], dtype=np.intp),
            np.array([x[2] for x in found], dtype=float))


def size_of(mechanism: Mechanism, q: Array) -> Any:
    """Return the largest coordinate of q (nq,) or (m, nq), relative to the mechanism's size.

    Angles that mean the same after a turn do not count.
    """
    _, places, sizes = coordinate_sizes(mechanism)
    if not places.size:
        return 0.0 if q.ndim == 1 else np.zeros(len(q))
    return np.abs(q[..., places] / sizes).max(axis=-1)
