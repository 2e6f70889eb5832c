"""Angles that mean the same after a whole turn, taken to where they are meant."""

from __future__ import annotations

import math
from collections.abc import Mapping

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array

PERIODIC = ("revolute", "cylindrical", "universal", "planar")


def periodic(mechanism: Mechanism) -> list[Coordinate]:
    """Return the angles that mean the same after a whole turn."""
    if "periodic" not in mechanism.memo:
        mechanism.memo["periodic"] = _periodic(mechanism)
    found: list[Coordinate] = mechanism.memo["periodic"]
    return found


def _periodic(mechanism: Mechanism) -> list[Coordinate]:
    coupled = {mechanism.coordinate(j).name for c in mechanism.closures if c.type == COUPLING
               for j in c.joints}
    return [
        c for c in mechanism.coordinate_table.values()
        if c.unit == "rad" and c.q >= 0 and c.name not in coupled
        and mechanism.pair_of(c.joint) in PERIODIC
    ]


def nearest_turn(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> Array:
    """Take whole turns off the angles: nearest to the named value, else to zero, in limits."""
    return with_places(q, turned_angles(mechanism, q, held, named))


def with_places(q: Array, values: Mapping[int, float]) -> Array:
    """Return a copy of q (nq,) with values by place."""
    q = q.copy()
    for at, value in values.items():
        q[at] = value
    return q


def turned_angles(
    mechanism: Mechanism, q: Array, held: Mapping[str, float], named: Mapping[str, float]
) -> dict[int, float]:
    """Return the angles, by place in q (nq,), that `nearest_turn` changes."""
    turn, changed = 2.0 * math.pi, {}
    lower, upper = mechanism.model.lowerPositionLimit, mechanism.model.upperPositionLimit
    for c in periodic(mechanism):
        before = angle = float(q[c.q])
        if c.name in held:
            angle = held[c.name]
        else:
            target = named.get(c.name, 0.0)
            angle -= turn * math.ceil((angle - target) / turn - 0.5 - 1e-9)  # half a turn is +pi
            if angle > upper[c.q] and angle - turn >= lower[c.q]:
                angle -= turn
            elif angle < lower[c.q] and angle + turn <= upper[c.q]:
                angle += turn
        if angle != before:
            changed[c.q] = angle
    return changed
