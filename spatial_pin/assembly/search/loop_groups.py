"""Loops that share no coordinate but those that are held: they are closed group by group.

Of loops that each close from one start in ten, two dozen would hardly close from the same one.
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
        entries: (nv,) the velocities that they depend on, held ones too.
        places: of the configuration, which these move.
        angles: which of the mechanism's angles that count turns are theirs.
    """

    closures: tuple[str, ...]
    entries: NDArray[np.bool_]
    places: list[int]
    angles: list[int]


@made_once
def loop_groups(mechanism: Mechanism, held: tuple[int, ...]) -> tuple[LoopGroup, ...]:
    """Return the groups of closures of a mechanism, whatever its configuration.

    Args:
        mechanism: the mechanism.
        held: velocity entries that stand still: closures that share no others are independent.
    """
    entries = _entries_of_closures(mechanism)
    moved = entries.copy()
    moved[:, list(held)] = False
    group = np.arange(len(entries))
    for column in moved.T:
        joined = group[column]
        if joined.size:
            group[np.isin(group, joined)] = joined.min()
    known, constraints, found = _names(mechanism), constraints_of(mechanism), []
    for number in np.unique(group):
        chosen = np.flatnonzero(group == number)
        names = tuple(known[k] for k in chosen)
        own: NDArray[np.bool_] = np.any(entries[chosen], axis=0)
        angles = [k for k, x in enumerate(constraints.angles)
                  if constraints.labels[x.equation].closure in names]
        found.append(LoopGroup(names, own, _places(mechanism, own), angles))
    return tuple(found)


def _places(mechanism: Mechanism, entries: NDArray[np.bool_]) -> list[int]:
    """Return the places in q of velocities (nv,); of a joint that turns in space all."""
    model = mechanism.model
    found = [c.q for c in mechanism.coordinate_table.values() if c.q >= 0 and entries[c.v]]
    for joint, components in by_joint(mechanism).items():
        if components[0].q < 0 and entries[components[0].v]:
            i = mechanism.joint_id(joint)
            found += range(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
    return found


def _names(mechanism: Mechanism) -> list[str]:
    """Return the names of the closures, each once: of some a part is stated the other way round."""
    return list(dict.fromkeys(c.name for c in mechanism.closures))


@made_once
def _entries_of_closures(mechanism: Mechanism) -> NDArray[np.bool_]:
    """Return (closures, nv) which velocities the equations of each closure depend on."""
    constraints = constraints_of(mechanism)
    row = {name: k for k, name in enumerate(_names(mechanism))}
    found = np.zeros((len(row), mechanism.model.nv), dtype=bool)
    for label, own in zip(constraints.labels, constraints.occurring, strict=False):
        found[row[label.closure]] |= own
    return found


@made_once
def loose_entries(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the velocities that no closure depends on: loops are closed wherever they stand."""
    return tuple(np.flatnonzero(~_entries_of_closures(mechanism).any(axis=0)).tolist())


@made_once
def part_of(mechanism: Mechanism, closures: tuple[str, ...]) -> Mechanism:
    """Return a mechanism with some of its closures only, and all coordinates."""
    whole = mechanism.whole
    return mechanism.with_fields(
        closures=tuple(c for c in mechanism.closures if c.name in closures), passives=(),
        whole=whole and part_of(whole, closures))
