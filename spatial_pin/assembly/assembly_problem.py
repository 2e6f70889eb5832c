"""The assembly problem: equations, fixed and free coordinates, start."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import Workspaces, cached_property, made_once
from spatial_pin.assembly.close import DAMPED_STEPS, NOTHING, close, closed, least_motion
from spatial_pin.assembly.holding import (
    LoopGroup,
    fixed_base_entries,
    free_velocities,
    loop_groups,
    part_of,
)
from spatial_pin.assembly.start_values import (
    COORDINATE_ERROR,
    NEAR_GUESS,
    Guess,
    StartSpread,
    entry_kinds,
    far_lengths,
    periodic,
    start_spread,
    turns_of_others,
)
from spatial_pin.assembly.state import all_angles
from spatial_pin.kernel.closer import (
    LOOSE,
    NAMED,
    Closer,
    ClosureResult,
    ClosureSettings,
    Examined,
    NamedCoordinates,
    closer_of,
)
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.coordinates import (
    by_joint,
    coordinate_value,
    driver_coordinates,
    with_values,
)
from spatial_pin.mechanism.joint_limits import position_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

ACCEPTED = TOLERANCES.closed


@dataclass(frozen=True, eq=False)
class FreeSet:
    """Free and fixed coordinates, as far as names decide them.

    Attributes:
        settings: of the kernel: the free velocities, those free at first, while named coordinates
            are fixed too, and what is named. The same object every time.
        fixed: fixed coordinates that are entries of q.
        pinned: fixed components of balls and floating joints.
        still: velocity entries of fixed free bases.
        is_whole: whether the guess names all components of a joint or none.
        spread: starts other than the guess; None if all is fixed.
        groups: of loops without common free coordinates.
        indices: in q of fixed coordinates; -1 for components of balls and floating joints.
        largest: entry of q with at least one correct digit left.
    """

    settings: ClosureSettings
    fixed: tuple[str, ...]
    pinned: tuple[str, ...]
    still: tuple[int, ...]
    is_whole: bool
    spread: StartSpread | None
    groups: tuple[LoopGroup, ...]
    indices: list[int]
    largest: float


@made_once
def free_set(
    mechanism: Mechanism, held: tuple[str, ...], let_go: tuple[str, ...], named: tuple[str, ...],
    still: tuple[int, ...] | None, tolerance: float,
) -> FreeSet:
    """Return free and fixed coordinates.

    Drivers in `let_go` may move, as little as possible; `named` are coordinates that the guess
    names. `still` are other fixed velocity entries, by default those of the free bases.
    """
    table, model = mechanism.coordinate_table, mechanism.model
    own = [name for name in named if name not in held]
    fixed, pinned = (tuple(name for name in held if (table[name].q >= 0) is is_entry)
                     for is_entry in (True, False))
    if still is None:
        still = fixed_base_entries(mechanism, (table[name] for name in (*held, *let_go)))
    free = free_velocities(mechanism, still, fixed)
    first = free & free_velocities(mechanism, still, own)
    has_first = bool(first.any()) and not np.array_equal(first, free)
    groups = loop_groups(mechanism, tuple(np.flatnonzero(~free).tolist()))
    loose = [c for c in table.values() if not any(group.entries[c.v] for group in groups)]
    # loose ones count the guess's turns
    kinds = entry_kinds(mechanism, held, [*own, *(c.name for c in loose)])
    balls = dict.fromkeys(table[name].joint for name in own if table[name].q < 0)
    is_whole = all(c.name in own for joint in balls for c in by_joint(mechanism)[joint])
    if is_whole:
        kinds[[model.idx_qs[mechanism.joint_id(joint)]
               + 3 * (mechanism.pair_of(joint) == "floating") for joint in balls]] = NAMED
    spread = start_spread(mechanism, held, own, (*still, *(c.v for c in loose)), groups)
    for array in (free, first, kinds):
        array.flags.writeable = False
    settings = ClosureSettings(
        free, first if has_first else None, tolerance, DAMPED_STEPS, TOLERANCES.rank, kinds,
        position_limits(mechanism), spread and spread.first, not first.any())
    return FreeSet(settings, fixed, pinned, still, is_whole, spread, groups,
                   [table[name].q for name in held],
                   float(mechanism.velocity_scale.min(initial=1.0)) / COORDINATE_ERROR)


@dataclass(eq=False)
class AssemblyProblem:
    """Equations to close, with fixed coordinates and a start.

    For a file with rounded numbers, all equations are solved first in the least-squares sense, with
    a residual up to `gap`.

    Attributes:
        given: coordinates with given values.
        standing: fixed drivers, with their values.
        guess: the start, and named coordinates.
        reference: (n_angles,) what angles of screws are unwrapped from.
        let_go: drivers that move as little as possible from values.
        still: other fixed velocity entries; None: those of free bases.
        driver_values: wanted values of drivers without a given value, which stand elsewhere if a
            larger mechanism has it so.
        lost: coordinates with a warning, see `State.lost_turns`.
        held: all fixed coordinates, with their values.
        goal: (nq,) the guess with these values.
    """

    mechanism: Mechanism
    given: Mapping[str, float]
    standing: Mapping[str, float]
    guess: Guess
    tolerance: float
    gap: float
    reference: Array
    let_go: Mapping[str, float] = field(default_factory=dict)
    still: tuple[int, ...] | None = None
    driver_values: Mapping[str, float] = field(default_factory=dict)
    lost: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Determine the free coordinates, and put the fixed ones into the guess."""
        mechanism, guess = self.mechanism, self.guess
        self.held = held = {**self.given, **self.standing}
        self.free_set = free = free_set(
            mechanism, tuple(held), tuple(self.let_go), guess.names, self.still, self.tolerance)
        self.settings, self.pinned = free.settings, NOTHING
        if free.pinned:
            self.pinned = {name: held[name] for name in free.pinned}
            self.goal = with_values(mechanism, guess.q, held)
        else:
            self.goal = guess.q.copy()
            for at, value in zip(free.indices, held.values(), strict=True):
                self.goal[at] = value
        self._from_goal: list[ClosureResult] | None = None

    def _changed(self, **changes: Any) -> AssemblyProblem:
        """Return the problem with other attributes, in the same workspaces."""
        other = replace(self, **changes)
        other.workspaces = self.workspaces
        return other

    def part(self, group: LoopGroup) -> AssemblyProblem:
        """Return the problem of a group of loops, all other joints fixed at the guess."""
        still = {*self.free_set.still, *np.flatnonzero(~group.entries).tolist()}
        table = self.mechanism.coordinate_table
        standing, let_go = ({name: x for name, x in some.items() if group.entries[table[name].v]}
                            for some in (self.standing, self.let_go))
        return self._changed(
            mechanism=part_of(self.mechanism, group.closures), standing=standing,
            reference=self.reference[group.angles], let_go=let_go, still=tuple(sorted(still)))

    @property
    def _near_standing(self) -> Guess:
        """The guess with fixed drivers at their values, which are named too."""
        return Guess(self.mechanism, with_values(self.mechanism, self.guess.q, self.standing),
                     {**self.standing, **self.guess.values})

    def released(self) -> AssemblyProblem:
        """Return the same with drivers released: as near as possible to their values."""
        return self._changed(
            standing={}, guess=self._near_standing, let_go=self.driver_values, still=None)

    def without_standing(self, moving: Iterable[str]) -> AssemblyProblem:
        """Return the same with drivers free that coordinates with values surely move.

        Their values here are named in its guess: the nearest configuration is best.
        """
        moved = [driver_coordinates(self.mechanism)[name].name for name in moving]
        standing = {name: x for name, x in self.standing.items() if name not in moved}
        return self._changed(
            standing=standing, guess=self._near_standing, let_go=NOTHING, still=None)

    def fixed_at(self, q: Array) -> AssemblyProblem:
        """Return the same with released drivers fixed at their values in q (nq,)."""
        table = self.mechanism.coordinate_table
        standing = {name: coordinate_value(self.mechanism, table[name], q) for name in self.let_go}
        return self._changed(standing=standing, let_go=NOTHING, still=self.free_set.still)

    def nearest_to(self, q: Array) -> AssemblyProblem:
        """Return the same with nothing fixed: it starts at q (nq,), and nearest to it is best."""
        named = {**self.named, **self.held}
        guess = Guess(self.mechanism, with_values(self.mechanism, q, named), named)
        return self._changed(given={}, standing={}, guess=guess, let_go=NOTHING,
                             still=self.free_set.still)

    def with_turns(self) -> Callable[[Array], tuple[Array, tuple[str, ...]]] | None:
        """See `turns_of_others`; None if nothing is set far from the guess."""
        if not (self.given and self.mechanism.closures):
            return None
        return turns_of_others(self.mechanism, self.guess, self.goal, self.free_set.fixed)

    @cached_property
    def workspaces(self) -> Workspaces:
        """The acquired workspaces, for parts of the problem too."""
        return Workspaces()

    @cached_property
    def evaluation(self) -> LoopEquations:
        """The equations of the mechanism."""
        return self.workspaces.acquire(loops_of(self.mechanism, self.reference))

    @cached_property
    def whole(self) -> LoopEquations | None:
        """Equations of the mechanism with all equations, for a file with rounded numbers."""
        if self.mechanism.whole is None:
            return None
        return self.workspaces.acquire(
            loops_of(self.mechanism.whole, all_angles(self.mechanism, self.reference)))

    @cached_property
    def entries(self) -> NDArray[np.bool_]:
        """(nv,) the relevant velocities: for a group of loops those of its joints."""
        return free_velocities(self.mechanism, self.still or (), ())

    def is_relevant(self, name: str) -> bool:
        """Whether a coordinate is one of the `entries`."""
        return bool(self.entries[self.mechanism.coordinate_table[name].v])

    @cached_property
    def named(self) -> dict[str, float]:
        """Other values that the guess names, by coordinate."""
        return {k: x for k, x in self.guess.values.items() if k not in self.held}

    def free_without(self, held: Iterable[str]) -> NDArray[np.bool_]:
        """Return (nv,) the free velocities with coordinates and free bases fixed."""
        return free_velocities(self.mechanism, self.free_set.still, held)

    # ------------------------------------------------------------ closing

    def has_digits(self, q: Array) -> bool:
        """Whether round-off of coordinates q (nq,) leaves a digit of the positions."""
        entries, largest = q.tolist(), self.free_set.largest
        if not entries or (max(entries) < largest and min(entries) > -largest):
            return True
        return bool(size_of(self.mechanism, q) * COORDINATE_ERROR < 1.0)

    def can_perturb(self) -> bool:
        """Whether `reached` can try perturbed starts with the first one, in one call."""
        if self.mechanism.whole is not None or self.let_go or not self.free_set.is_whole:
            return False
        spread = self.free_set.spread
        return spread is None or not spread.lengths or not far_lengths(
            self.mechanism, self.named, spread)

    def is_for_kernel(self) -> bool:
        """Whether the kernel may judge its results from the guess by itself."""
        return not self.pinned and self.has_digits(self.goal) and self.can_perturb()

    def set_task(self, closer: Closer) -> None:
        """Set the task of a closer: all loops at once, with perturbed starts."""
        closer.set_task([self.goal], self.settings, self.goal, self.reference, perturbed=True)

    def from_goal(self) -> list[ClosureResult]:
        """Return the results from the goal, and from perturbed starts if these can be tried."""
        if self._from_goal is None:
            self._from_goal = self._solved([self.goal], self.can_perturb())
        return self._from_goal

    def reached(self, starts: Sequence[Array], shaken: bool = False) -> Iterable[ClosureResult]:
        """Return the results from starts (nq,), named coordinates fixed at first.

        There are `AT_ONCE` starts at most. `shaken`: whether perturbed starts are tried too.
        """
        settings = self.settings
        if self.mechanism.whole is not None:  # all equations first
            if settings.first is not None:
                starts = [self.closed(q, settings.first, self.pinned,
                                      max(self.tolerance, LOOSE)).q for q in starts]
            return [self.judged_at(self.closed(q, settings.free, self.pinned).q) for q in starts]
        if not starts:
            return ()
        if shaken and starts[0] is self.goal:
            return self.from_goal()
        return self._solved(starts, shaken)

    def _solved(self, starts: Sequence[Array], shaken: bool) -> list[ClosureResult]:
        with closer_of(self.mechanism, self.pinned) as closer:
            return closer.solve(starts, self.settings, self.goal, self.reference,
                                self.pinned.values(), shaken)

    def closed(
        self, q: Array, free: NDArray[np.bool_], pinned: Mapping[str, float],
        tolerance: float | None = None,
    ) -> ClosureResult:
        """Close the loops from q (nq,), first all equations as well as possible."""
        tolerance = tolerance or self.tolerance
        if self.whole is not None:
            assert self.mechanism.selection is not None
            q = closed(self.whole.mechanism, q, free, self.whole.angle_reference, tolerance,
                       pinned=pinned, cut=self.mechanism.selection.cut).q
        return closed(self.mechanism, q, free, self.reference, tolerance, pinned=pinned)

    def least(
        self, q: Array, free: NDArray[np.bool_], limits: bool = False
    ) -> tuple[Array, float]:
        """Return the closed configuration near q with the least motion of released drivers.

        Drivers that need not move have their values exactly. With limits, a joint that was fixed at
        its limit at first may leave it.
        """
        q = self.closed(q, free, self.pinned).q
        free = self.settings.free if limits else free
        q, error = least_motion(self.evaluation, q, free, self.let_go, self.tolerance,
                                self.pinned, limits)
        gone = deviations(self.mechanism, q, self.let_go)
        fixed = {name: x for name, x in self.let_go.items() if name not in gone}
        if not fixed:
            return q, error
        table = self.mechanism.coordinate_table
        entries = [name for name in fixed if table[name].q >= 0]
        pinned = {name: x for name, x in fixed.items() if table[name].q < 0}
        there, open_by = close(self.evaluation, with_values(self.mechanism, q, fixed),
                               free & self.free_without(entries), self.tolerance,
                               pinned={**self.pinned, **pinned})
        moved = pin.difference(self.mechanism.model, q, there) / self.mechanism.velocity_scale
        near = bool(np.abs(moved).max(initial=0.0) < NEAR_GUESS)
        return (there, open_by) if open_by <= ACCEPTED and near else (q, error)

    # ------------------------------------------------------------ what a configuration is

    def judged_at(self, q: Array) -> ClosureResult:
        """Return the properties of q (nq,), without whole turns."""
        settings = self.settings
        assert settings.kinds is not None
        named = NamedCoordinates(self.goal, settings.kinds, *settings.limits)
        with closer_of(self.mechanism) as closer:
            return closer.judge(q, self.reference, named)

    def examined(self, q: Array) -> Examined:
        """Return the properties of the mechanism's own equations at q (nq,)."""
        with closer_of(self.mechanism) as closer:
            return closer.examine(q, self.reference)


def deviations(mechanism: Mechanism, q: Array, values: Mapping[str, float]) -> dict[str, float]:
    """Return deviations of coordinates from values, zeros left out [rad, m]."""
    gone: dict[str, float] = {}
    table = mechanism.coordinate_table
    for name, value in values.items():
        by = coordinate_value(mechanism, table[name], q) - value
        if abs(by) > TOLERANCES.nothing * mechanism.velocity_scale[table[name].v]:
            gone[name] = by
    return gone


@made_once
def coordinate_sizes(mechanism: Mechanism) -> tuple[list[str], NDArray[np.intp], Array]:
    """Return names, indices in q, and sizes of coordinates, without periodic angles."""
    turning = {c.name for c in periodic(mechanism)}
    table = [(name, at, mechanism.velocity_scale[c.v])
             for name, c in mechanism.coordinate_table.items()
             if (at := mechanism.index_of(c)) >= 0 and name not in turning]
    return ([x[0] for x in table], np.array([x[1] for x in table], dtype=np.intp),
            np.array([x[2] for x in table], dtype=float))


def size_of(mechanism: Mechanism, q: Array) -> Any:
    """Return the largest coordinate of q (nq,) or (m, nq), relative to the mechanism's size.

    Periodic angles do not count.
    """
    _, indices, sizes = coordinate_sizes(mechanism)
    if not indices.size:
        return 0.0 if q.ndim == 1 else np.zeros(len(q))
    return np.abs(q[..., indices] / sizes).max(axis=-1)
