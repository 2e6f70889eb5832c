"""Groups of loops without common free coordinates, which are closed one by one.

If each of two dozen loops closes from one start in ten, they would hardly all close from the same
one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.mechanism.coordinates import by_joint
from spatial_pin.mechanism.mechanism import Mechanism


class LoopGroup(NamedTuple):
    """Closures that depend on each other, and on no others.

    Attributes:
        closures: their names.
        entries: (nv,) the velocities in their equations, fixed ones too.
        angles: numbers of their angles that count turns.
    """

    closures: tuple[str, ...]
    entries: NDArray[np.bool_]
    angles: list[int]


@made_once
def loop_groups(mechanism: Mechanism, held: tuple[int, ...]) -> tuple[LoopGroup, ...]:
    """Return the groups of closures of a mechanism, for all configurations.

    Args:
        mechanism: the mechanism.
        held: fixed velocity entries: closures with no other common entries are independent.
    """
    known, entries = _entries_of_closures(mechanism)
    moved = entries.copy()
    moved[:, list(held)] = False
    group = np.arange(len(entries))
    for column in moved.T:
        joined = group[column]
        if joined.size:
            group[np.isin(group, joined)] = joined.min()
    constraints, groups = constraints_of(mechanism), []
    for number in np.unique(group):
        chosen = np.flatnonzero(group == number)
        names = tuple(known[k] for k in chosen)
        own: NDArray[np.bool_] = np.any(entries[chosen], axis=0)
        angles = [k for k, x in enumerate(constraints.angles)
                  if constraints.labels[x.equation].closure in names]
        groups.append(LoopGroup(names, own, angles))
    return tuple(groups)


def configuration_indices(mechanism: Mechanism, group: LoopGroup) -> list[int]:
    """Return the indices in q of the velocities of a group, of a ball all."""
    model, entries = mechanism.model, group.entries
    indices = [c.q for c in mechanism.coordinate_table.values() if c.q >= 0 and entries[c.v]]
    for joint, components in by_joint(mechanism).items():
        if components[0].q < 0 and entries[components[0].v]:
            i = mechanism.joint_id(joint)
            indices += range(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
    return indices


@made_once
def _entries_of_closures(mechanism: Mechanism) -> tuple[list[str], NDArray[np.bool_]]:
    """Return names of closures, and (closures, nv) the velocities in their equations.

    Each name is there once, though a closure may have two parts.
    """
    constraints, names = constraints_of(mechanism), list(
        dict.fromkeys(c.name for c in mechanism.closures))
    entries = np.zeros((len(names), mechanism.model.nv), dtype=bool)
    row = dict(zip(names, entries, strict=True))
    for label, own in zip(constraints.labels, constraints.occurring, strict=False):
        row[label.closure] |= own
    return names, entries


@made_once
def loose_entries(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the velocities that are in no closure equation."""
    return tuple(np.flatnonzero(~_entries_of_closures(mechanism)[1].any(axis=0)).tolist())


@made_once
def part_of(mechanism: Mechanism, closures: tuple[str, ...]) -> Mechanism:
    """Return a mechanism with some of its closures only, and all coordinates."""
    whole = mechanism.whole
    return mechanism.with_fields(
        closures=tuple(c for c in mechanism.closures if c.name in closures), passives=(),
        whole=whole and part_of(whole, closures))
