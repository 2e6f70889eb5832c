"""What names of joints, coordinates and drivers prescribe, when rates are given for them.

A coordinate's rate is its derivative, that of a rotation vector too: `ball.x` is phi_x', as
`State.coordinate` tells it. A joint of several freedoms is given its whole velocity, as Pinocchio
orders and means it: of a spherical joint the angular velocity of the child in the child's axes, of
a floating one the child's linear velocity before that; of the others their coordinates' rates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from spatial_pin._support.checks import finite_array, finite_number
from spatial_pin.mechanism.coordinates import coordinates_of, driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry


def rate_coordinates(mechanism: Mechanism, name: str) -> list[Coordinate]:
    """Return what is prescribed when a rate is given for a joint, a coordinate or a driver.

    Raises:
        UnknownNameError: there is none.
    """
    components = coordinates_of(mechanism, name)
    if len(components) < 2 or name in mechanism.drivers:
        return [mechanism.coordinate(name)]
    if PAIRS[mechanism.pair_of(name)].is_linear:
        return components
    return [VelocityEntry(*c) for c in components]


def driven_coordinates(mechanism: Mechanism, names: Iterable[str]) -> list[Coordinate]:
    """Return the coordinates that are prescribed when `names` are.

    The mechanism's drivers when all names are drivers; otherwise exactly the named coordinates.
    """
    wanted = [c for name in names for c in rate_coordinates(mechanism, name)]
    drivers = [*driver_coordinates(mechanism).values()]
    chosen = drivers if all(c in drivers for c in wanted) else wanted
    return list(dict.fromkeys(chosen))


def siblings(mechanism: Mechanism, named: Iterable[Coordinate]) -> list[Coordinate]:
    """Return the other coordinates of the joints of which some coordinates are named."""
    named = list(named)
    joints = dict.fromkeys(c.joint for c in named)
    return [c for joint in joints for c in coordinates_of(mechanism, joint) if c not in named]


def rates_given(
    mechanism: Mechanism, given: Mapping[str, Any], what: str
) -> dict[Coordinate, float]:
    """Return rates, keyed by what they prescribe.

    Args:
        mechanism: the mechanism.
        given: a number by coordinate, driver or joint, or as many as the joint has freedoms.
        what: they are, for messages: "speed".

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: no finite number, not as many as the joint has freedoms, or given twice.
    """
    rates: dict[Coordinate, float] = {}
    for name, value in given.items():
        chosen = rate_coordinates(mechanism, name)
        if len(chosen) == 1:
            values = np.array([finite_number(value, f"{what} of {name!r}")])
        else:
            values = finite_array(value, (len(chosen),), f"{what} of {name!r} ("
                                  + ", ".join(c.name for c in chosen) + ")")
        for c, x in zip(chosen, values.tolist(), strict=True):
            if c in rates:
                raise ValueError(f"{what} of {c.name!r} is given twice")
            rates[c] = x
    return rates


def check_one_meaning(mechanism: Mechanism, chosen: Iterable[Coordinate]) -> None:
    """Refuse a joint that is named whole and by its components.

    Raises:
        ValueError: names it.
    """
    whole = {c.joint for c in chosen if isinstance(c, VelocityEntry)}
    for c in chosen:
        if c.joint in whole and not isinstance(c, VelocityEntry):
            raise ValueError(
                f"mechanism {mechanism.name!r}: {c.joint!r} is given whole (its angular velocity) "
                f"and by its component {c.name!r} (a rate of its rotation vector): choose one")
