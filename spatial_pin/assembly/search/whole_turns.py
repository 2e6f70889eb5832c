"""Whole turns of periodic angles, reduced to the reference configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.closer import FIXED, NAMED, TURNS, NamedCoordinates, closer_of
from spatial_pin.mechanism.joint_limits import position_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.angles import whole_turns
from spatial_pin.numerics.linalg import Array

PERIODIC = ("revolute", "cylindrical", "universal", "planar")


@made_once
def periodic(mechanism: Mechanism) -> list[Coordinate]:
    """Return the periodic angles: no closure counts their turns."""
    coupled = [mechanism.coordinate(j).name for c in mechanism.closures for j in c.joints]
    counted = np.zeros(mechanism.model.nq, dtype=bool)
    for turns in constraints_of(mechanism).turns:
        counted |= turns.are_all & (turns.row != 0.0)
    return [
        c for c in mechanism.coordinate_table.values()
        if c.unit == "rad" and c.q >= 0 and c.name not in coupled and not counted[c.q]
        and mechanism.pair_of(c.joint) in PERIODIC
    ]


def turn_free_difference(mechanism: Mechanism, q: Array, other: Array) -> Array:
    """Return the difference (nv,) of two configurations without whole turns of periodic angles.

    In radians and characteristic lengths.
    """
    difference: Array = pin.difference(mechanism.model, q, other)
    turning = [c.v for c in periodic(mechanism)]
    difference[turning] -= whole_turns(difference[turning])
    return difference / mechanism.velocity_scale


def entry_kinds(
    mechanism: Mechanism, held: Iterable[str], named: Iterable[str]
) -> NDArray[np.int64]:
    """Return (nq,) flags of the entries of q, for `NamedCoordinates`; 0 for balls."""
    kinds = np.zeros(mechanism.model.nq, np.int64)
    kinds[[c.q for c in periodic(mechanism)]] = TURNS
    for names, bit in ((held, FIXED), (named, NAMED)):
        kinds[[c.q for name in names if (c := mechanism.coordinate_table[name]).q >= 0]] |= bit
    return kinds


def nearest_turn(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> Array:
    """Take whole turns off the angles: nearest to the named value, else to zero, in limits."""
    table = mechanism.coordinate_table
    value = q.copy()
    for name, x in {**named, **held}.items():
        if table[name].q >= 0:
            value[table[name].q] = x
    reference = NamedCoordinates(
        value, entry_kinds(mechanism, held, named), *position_limits(mechanism))
    with closer_of(mechanism) as closer:
        return closer.judge(q, 0.0, reference).q
