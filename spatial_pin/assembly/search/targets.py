"""What an assembly reads from names alone: what may move, and how far it is from what is named."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.holding import still_entries
from spatial_pin.mechanism.coordinates import by_joint, with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class Places(NamedTuple):
    """Where coordinates are in q and v.

    Attributes:
        plain: names of those that are entries of q.
        at: these entries.
        sizes: of a unit of each.
        balls: first entry in q of each joint that others are components of, and their names.
        is_whole: whether these are balls of which all components are meant.
    """

    plain: list[str]
    at: list[int]
    sizes: list[float]
    balls: list[tuple[int, list[str]]]
    is_whole: bool


def places_of(mechanism: Mechanism, names: tuple[str, ...]) -> Places:
    """Return where coordinates are; looked up once for the same ones."""
    if ("places", names) not in mechanism.memo:
        table, known, joints = mechanism.coordinate_table, set(names), by_joint(mechanism)
        plain = [table[name] for name in names if table[name].q >= 0]
        balls = dict.fromkeys(table[name].joint for name in names if table[name].q < 0)
        mechanism.memo["places", names] = Places(
            [c.name for c in plain], [c.q for c in plain],
            [float(mechanism.velocity_scale[c.v]) for c in plain],
            [(int(mechanism.model.idx_qs[mechanism.joint_id(joint)]),
              [c.name for c in joints[joint]]) for joint in balls],
            all(mechanism.pair_of(joint) == "spherical"
                and all(c.name in known for c in joints[joint]) for joint in balls))
    found: Places = mechanism.memo["places", names]
    return found


class Left(NamedTuple):
    """What may move where some coordinates are held.

    Attributes:
        pinned: held components of balls and floating joints.
        still: velocity entries of free bases that stand.
        free: (nv,) the velocities that may move.
        first: (nv,) those that may move first, while what the guess names is held too; None if
            these are none, or the same.
    """

    pinned: tuple[str, ...]
    still: tuple[int, ...]
    free: NDArray[np.bool_]
    first: NDArray[np.bool_] | None


def left_of(
    mechanism: Mechanism, held: tuple[str, ...], let_go: tuple[str, ...], named: tuple[str, ...]
) -> Left:
    """Return what may move; looked up once for the same coordinates held, let go and named."""
    key = "left", held, let_go, named
    if key not in mechanism.memo:
        table = mechanism.coordinate_table
        pinned = tuple(name for name in held if table[name].q < 0)
        still = still_entries(mechanism, (table[name] for name in (*held, *let_go)))
        free = free_but(mechanism, still, (name for name in held if name not in pinned))
        first = free & free_but(mechanism, still, named)
        has_first = bool(first.any()) and not np.array_equal(first, free)
        mechanism.memo[key] = Left(pinned, still, free, first if has_first else None)
    found: Left = mechanism.memo[key]
    return found


def free_but(
    mechanism: Mechanism, still: Iterable[int], held: Iterable[str]
) -> NDArray[np.bool_]:
    """Return (nv,) which velocities are left where entries and coordinates are held."""
    free = np.ones(mechanism.model.nv, dtype=bool)
    free[list(still)] = False
    free[[mechanism.coordinate_table[name].v for name in held]] = False
    return free


class Target:
    """What the guess names, and how far configurations are from it.

    Args:
        mechanism: the mechanism.
        named: values by coordinate [rad, m].
    """

    def __init__(self, mechanism: Mechanism, named: Mapping[str, float]) -> None:
        self.mechanism, self.named = mechanism, named
        self._places = places = places_of(mechanism, tuple(named))
        self._values = [named[x] / size for x, size in zip(places.plain, places.sizes, strict=True)]
        # components of floating joints, and single ones of balls, have to be put in first
        self._balls = [(at, _quaternion([named[name] for name in names]))
                       for at, names in places.balls] if places.is_whole else []

    def distance(self, q: Array) -> float:
        """Return how far q (nq,) is from the named values; an orientation counts by its angle."""
        if self._places.is_whole:
            here = q.tolist()
            own = [here[at] / size for at, size in zip(
                self._places.at, self._places.sizes, strict=True)]
            return math.hypot(math.dist(own, self._values), *(
                _angle_between(here[at : at + 4], goal) for at, goal in self._balls))
        model, size = self.mechanism.model, self.mechanism.velocity_scale
        gaps = pin.difference(model, q, with_values(self.mechanism, q, self.named)) / size
        return math.hypot(*gaps.tolist())


def _quaternion(vector: Sequence[float]) -> list[float]:
    """Return the quaternion of a rotation vector."""
    angle = math.hypot(*vector)
    factor = math.sin(0.5 * angle) / angle if angle else 0.5
    return [*(factor * x for x in vector), math.cos(0.5 * angle)]


def _angle_between(one: Sequence[float], two: Sequence[float]) -> float:
    """Return the angle between orientations, quaternions (4,) [rad]."""
    apart, other = math.dist(one, two), math.dist(one, [-x for x in two])
    return 4.0 * math.atan2(min(apart, other), max(apart, other))
