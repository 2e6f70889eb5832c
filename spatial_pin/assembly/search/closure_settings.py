"""What an assembly reads from names alone: what may move, and what is said of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.close import DAMPED_STEPS
from spatial_pin.assembly.holding import still_entries
from spatial_pin.assembly.search.guesses import Further, further_starts
from spatial_pin.assembly.search.loop_groups import LoopGroup, loop_groups, loose_entries
from spatial_pin.assembly.search.whole_turns import said_of
from spatial_pin.kernel.closer import NAMED, ClosureSettings
from spatial_pin.mechanism.coordinates import by_joint
from spatial_pin.mechanism.joint_limits import position_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.tolerances import TOLERANCES


@dataclass(frozen=True, eq=False)
class Left:
    """What may move where some coordinates are held.

    Attributes:
        pinned: held components of balls and floating joints.
        still: velocity entries of free bases that stand.
        free: (nv,) the velocities that may move.
        first: (nv,) those that may move first, while what the guess names is held too; None if
            these are none, or the same.
        said: (nq,) of the entries of q, for `Meant`.
        is_whole: whether all components are named of each joint of which some others are.
        further: starts other than the guess; None where all is held.
        groups: of loops that share nothing that may move.
    """

    pinned: tuple[str, ...]
    still: tuple[int, ...]
    free: NDArray[np.bool_]
    first: NDArray[np.bool_] | None
    said: NDArray[np.int64]
    is_whole: bool
    further: Further | None
    groups: tuple[LoopGroup, ...]


@made_once
def left_of(
    mechanism: Mechanism, held: tuple[str, ...], let_go: tuple[str, ...], said: tuple[str, ...],
    still: tuple[int, ...] | None,
) -> Left:
    """Return what may move where coordinates are held, let go and named.

    Args:
        mechanism: the mechanism.
        held: coordinates that stay.
        let_go: drivers that may go, as little as they can.
        said: coordinates that the guess names.
        still: velocity entries that stand besides; None: those of the free bases.
    """
    table, named = mechanism.coordinate_table, [name for name in said if name not in held]
    pinned = tuple(name for name in held if table[name].q < 0)
    if still is None:
        still = still_entries(mechanism, (table[name] for name in (*held, *let_go)))
    free = free_but(mechanism, still, (name for name in held if name not in pinned))
    first = free & free_but(mechanism, still, named)
    has_first = bool(first.any()) and not np.array_equal(first, free)
    is_whole, entries = _said(mechanism, held, named)
    groups = loop_groups(mechanism, tuple(np.flatnonzero(~free).tolist()))
    further = further_starts(
        mechanism, held, named, (*still, *loose_entries(mechanism)), groups)
    for array in (free, first, entries):
        array.flags.writeable = False
    return Left(pinned, still, free, first if has_first else None, entries, is_whole, further,
                groups)


@made_once
def asked_of(mechanism: Mechanism, left: Left, tolerance: float) -> ClosureSettings:
    """Return how loops are closed where so much is left to move; the same object every time."""
    lower, upper = position_limits(mechanism)
    shakes = None if left.further is None else left.further.first
    return ClosureSettings(left.free, left.first, tolerance, DAMPED_STEPS, TOLERANCES.rank,
                           left.said, lower, upper, shakes)


def _said(
    mechanism: Mechanism, held: Iterable[str], named: Sequence[str]
) -> tuple[bool, NDArray[np.int64]]:
    """Return whether named components make whole balls, and what is said of entries of q."""
    table, joints = mechanism.coordinate_table, by_joint(mechanism)
    loose = [c.name for c in table.values() if c.v in loose_entries(mechanism)]
    said = said_of(mechanism, held, [*named, *loose])  # what is loose counts the guess's turns
    balls = dict.fromkeys(table[name].joint for name in named if table[name].q < 0)
    is_whole = all(mechanism.pair_of(joint) == "spherical"
                   and all(c.name in named for c in joints[joint]) for joint in balls)
    if is_whole:
        said[[mechanism.model.idx_qs[mechanism.joint_id(joint)] for joint in balls]] = NAMED
    return is_whole, said


def free_but(
    mechanism: Mechanism, still: Iterable[int], held: Iterable[str]
) -> NDArray[np.bool_]:
    """Return (nv,) which velocities are left where entries and coordinates are held."""
    free = np.ones(mechanism.model.nv, dtype=bool)
    free[list(still)] = False
    free[[mechanism.coordinate_table[name].v for name in held]] = False
    return free
