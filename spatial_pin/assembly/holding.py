"""Fixed coordinates of a motion, and groups of loops without common free coordinates.

Fixed are free bases, and joints named by `hold`. Groups of loops are closed one by one: if each of
two dozen loops closes from one start in ten, they would hardly all close from the same one.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import compress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import names_of
from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.mechanism.coordinates import by_joint
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry


class Word(str):
    """A keyword; a joint may have the same name."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Word) and str.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = str.__hash__


BASE, SPRINGS = Word("base"), "springs"  # keywords of `hold`; the first is its default
Hold = str | Iterable[str] | None
# parts of a floating joint's velocity
PARTS = {"translation": slice(0, 3), "rotation": slice(-3, None)}


class Held(NamedTuple):
    """Fixed velocities and coordinates.

    Attributes:
        entries: indices of zero entries in the velocity vector.
        coordinates: components of balls and floating joints, which are no such entries.
    """

    entries: tuple[int, ...] = ()
    coordinates: tuple[Coordinate, ...] = ()


def hold_names(hold: Hold) -> tuple[str, ...]:
    """Return the names of `hold`; None has none."""
    return () if hold is None else tuple(names_of(hold, "hold"))


def free_bases(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the free bases: floating joints that carry a machine without a tie to the ground.

    If every body has a floating joint of its own, there is none.
    """
    floating = mechanism.pairs.count("floating")
    return untied(mechanism) if 0 < floating < len(mechanism.pairs) else ()


@made_once
def untied(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the floating joints that alone carry all bodies connected with their link.

    Such a link and its machine can move anywhere as one body. A floating joint is not among them if
    closures tie its link to the ground or to bodies on other joints.
    """
    model = mechanism.model
    floating = [i for i, pair in enumerate(mechanism.pairs, start=1)
                if pair == "floating" and model.parents[i] == 0]
    if not floating:
        return ()
    ties = [(int(model.parents[i]), i) for i in range(1, model.njoints) if i not in floating]
    for closure in mechanism.closures:
        bodies = [mechanism.frame_on_joint(f)[0] for f in (*closure.frames, *closure.between)]
        ties += [(bodies[0], other) for other in bodies[1:]]
    groups = list(range(model.njoints))
    for one, other in ties:
        low, high = sorted((groups[one], groups[other]))
        groups = [low if g == high else g for g in groups]
    return tuple(model.names[i] for i in floating
                 if groups[i] and [groups[k] for k in floating].count(groups[i]) == 1)


def fixed_base_entries(mechanism: Mechanism, driven: Iterable[Coordinate]) -> tuple[int, ...]:
    """Return the velocity entries of the free bases that are not driven."""
    moved = [c.joint for c in driven]
    return tuple(v for joint in free_bases(mechanism) if joint not in moved
                 for v in velocity_entries(mechanism, joint))


def velocity_entries(mechanism: Mechanism, joint: str) -> range:
    """Return the indices of a joint in the velocity vector."""
    i = mechanism.joint_id(joint)
    at = int(mechanism.model.idx_vs[i])
    return range(at, at + int(mechanism.model.nvs[i]))


def hold_to_file(names: Iterable[str]) -> list[str]:
    """Return the names of `hold` for a file; the keyword of the free bases gets asterisks."""
    return [f"*{name}*" if isinstance(name, Word) else name for name in names]


def hold_from_file(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of `hold` from a file, see `hold_to_file`."""
    return tuple(BASE if name == f"*{BASE}*" else name for name in names)


def is_base(mechanism: Mechanism, name: str) -> bool:
    """Whether a name means the free bases; a joint may have the name "base"."""
    return name == BASE or (name == str(BASE) and name not in list(mechanism.model.names)[1:] and (
        name not in mechanism.coordinate_table) and name not in mechanism.drivers)


def held_by(mechanism: Mechanism, hold: Hold, driven: Iterable[Coordinate] = ()) -> Held:
    """Return the fixed entries and coordinates.

    Args:
        mechanism: the mechanism.
        hold: names of joints, coordinates or drivers; "base" for the free bases, "springs" for the
            coordinates of springs in the file, "NAME.rotation" and "NAME.translation" for these
            parts of a floating joint. None: nothing.
        driven: driven coordinates: a free base without one is fixed.

    Raises:
        UnknownNameError: a name does not exist.
    """
    return _held_by(mechanism, hold_names(hold), tuple(driven))


@made_once
def _held_by(
    mechanism: Mechanism, names: tuple[str, ...], driven: tuple[Coordinate, ...]
) -> Held:
    entries: list[int] = []
    single: list[Coordinate] = []
    joints = list(mechanism.model.names)[1:]
    for name in names:
        joint, _, part = name.rpartition(".")
        known = name in mechanism.coordinate_table or name in mechanism.drivers
        is_word = not known and name not in joints
        if is_base(mechanism, name):
            entries += fixed_base_entries(mechanism, driven)
        elif name == SPRINGS and is_word:
            sprung = [mechanism.coordinate(x.joint) for x in mechanism.springs if x.joint]
            entries += [c.v for c in sprung if c.q >= 0]
            single += [c for c in sprung if c.q < 0]
        elif part in PARTS and joint in joints and (
                mechanism.pair_of(joint) == "floating"):
            entries += velocity_entries(mechanism, joint)[PARTS[part]]
        elif not known and name in joints:
            entries += velocity_entries(mechanism, name)
        elif (coordinate := mechanism.coordinate(name)).q < 0:
            single.append(coordinate)
        else:
            entries.append(coordinate.v)
    return Held(tuple(dict.fromkeys(entries)), tuple(dict.fromkeys(single)))


def divided(
    mechanism: Mechanism, driven: Iterable[Coordinate], hold: Hold
) -> tuple[list[Coordinate], tuple[int, ...]]:
    """Return the prescribed coordinates, and the fixed velocity entries.

    Fixed coordinates are not driven; components of balls and floating joints are prescribed after
    the driven coordinates.
    """
    driven = list(driven)
    held = held_by(mechanism, hold, driven)
    moving = [c for c in driven if c not in held.coordinates
              and not (c.v in held.entries and (c.q >= 0 or isinstance(c, VelocityEntry)))]
    return [*moving, *held.coordinates], held.entries


def free_velocities(
    mechanism: Mechanism, still: Iterable[int], held: Iterable[str]
) -> NDArray[np.bool_]:
    """Return (nv,) the free velocities, without fixed entries and coordinates."""
    free = np.ones(mechanism.model.nv, dtype=bool)
    free[list(still)] = False
    free[[mechanism.coordinate_table[name].v for name in held]] = False
    return free


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

    Closures with no common entries but `held`, the fixed velocity entries, are independent.
    """
    constraints, names = constraints_of(mechanism), list(
        dict.fromkeys(c.name for c in mechanism.closures))  # one may have two parts
    entries = np.zeros((len(names), mechanism.model.nv), dtype=bool)
    row = dict(zip(names, entries, strict=True))
    for name, own in zip(constraints.closure_of, constraints.occurring, strict=False):
        row[name] |= own
    moved, group = entries.copy(), np.arange(len(names))
    moved[:, list(held)] = False
    for column in moved.T:
        joined = group[column]
        if joined.size:
            group[np.isin(group, joined)] = joined.min()
    groups = []
    for number in np.unique(group):
        chosen = np.flatnonzero(group == number)
        closures = tuple(names[k] for k in chosen)
        angles = [k for k, x in enumerate(constraints.angles)
                  if constraints.closure_of[x.equation] in closures]
        groups.append(LoopGroup(closures, np.any(entries[chosen], axis=0), angles))
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
def part_of(mechanism: Mechanism, closures: tuple[str, ...]) -> Mechanism:
    """Return a mechanism with some of its closures only, and all coordinates."""
    whole, selection = mechanism.whole, mechanism.selection
    if whole is None or selection is None:
        return mechanism.with_fields(passives=(), closures=tuple(
            c for c in mechanism.closures if c.name in closures))
    is_own = [c.name in closures for c in whole.closures]
    return part_of(whole, closures).with_equations(selection._replace(
        own=tuple(compress(selection.own, is_own)),
        turned=tuple(compress(selection.turned, is_own))))
