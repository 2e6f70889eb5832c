"""What names prescribe when rates are given, and what determines the rates of a closed state.

A coordinate's rate is its derivative, that of a rotation vector too: `ball.x` is phi_x', as
`State.coordinate` tells it. A joint of several freedoms is given its whole velocity, as Pinocchio
orders and means it: of a spherical joint the angular velocity of the child in the child's axes, of
a floating one the child's linear velocity before that; of the others their coordinates' rates.

The kernel chooses the equations where it is clear which are independent. Elsewhere, and where
passive freedoms take the least rates, the square system chooses, or says why nothing determines
the rates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import finite_array, finite_number
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import FixedHold, Hold, divided, fixed, held_by
from spatial_pin.assembly.square_system import SINGULAR_PIVOT, SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import prescribed_places
from spatial_pin.kernel.rate_solver import Chosen, RateSolver, rates_of
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


class Prescription(NamedTuple):
    """What is prescribed.

    Attributes:
        driven: coordinates, those that are held last.
        n_moving: how many of them are not.
        still: places in the velocity vector that stand still.
    """

    driven: list[Coordinate]
    n_moving: int
    still: tuple[int, ...]

    @classmethod
    def of(cls, mechanism: Mechanism, driven: Iterable[Coordinate], hold: Hold) -> Prescription:
        """Return what is prescribed when coordinates are, and some are held."""
        driven = list(driven)
        moving, still = divided(mechanism, driven, hold)
        return cls(moving, len(moving) - len(held_by(mechanism, hold, driven).coordinates), still)

    def rates(self, kernel: Kernel) -> RateSolver:
        """Return what solves for the rates in a kernel."""
        return rates_of(
            kernel, tuple(prescribed_places(kernel.nv, self.driven, self.still)), self.n_moving)


def placed(kernel: Kernel, state: State, given: Prescription) -> RateSolver:
    """Return what solves for the rates of a closed state, where something is prescribed.

    Args:
        kernel: of the state's mechanism.
        state: the state.
        given: what is prescribed.

    Raises:
        SingularError: the rates are not determined there.
    """
    rates = given.rates(kernel)
    if not rates.factor(state.q, state.angles):
        rates.factor(state.q, state.angles, chosen_at(state, given))
    return rates


def chosen_at(state: State, given: Prescription, frame: int | None = None) -> Chosen:
    """Return the equations that determine the rates of a closed state.

    Args:
        state: the state.
        given: what is prescribed.
        frame: whose velocity alone is to be determined; default: all.

    Raises:
        SingularError: the rates are not determined there.
    """
    mechanism = state.mechanism
    with loops_of(mechanism, state.angles) as evaluation:
        try:
            system = SquareSystem(evaluation, given.driven, state.q, given.still, frame)
            system.check_regular(state.q)
        except SingularError as error:
            raise SingularError(str(error), state=state) from None
        if system.pivot < SINGULAR_PIVOT:
            raise SingularError(
                f"mechanism {mechanism.name!r}: singular configuration, {state}: smallest pivot "
                f"{system.pivot:.1e} of the largest; the rates have no reliable digit there",
                state=state)
        return system.chosen


@made_once
def prescription_by(mechanism: Mechanism, driver: str, hold: FixedHold) -> Prescription:
    """Return what is prescribed when a driver is, and some coordinates are held."""
    return Prescription.of(mechanism, driven_coordinates(mechanism, [driver]), hold)


def plan_of(
    mechanism: Mechanism, speeds: Mapping[str, Any], accelerations: Mapping[str, Any], hold: Hold
) -> tuple[Prescription, list[int], list[int]] | None:
    """Return what is prescribed where rates are given; None where it has to be tried.

    The drivers if all names are of them, or the named ones where nothing stands still beside them.

    Args:
        mechanism: the mechanism.
        speeds: numbers by name.
        accelerations: likewise.
        hold: what stands still, as for `solve_rates`.

    Returns:
        The prescription, and its places that the names of speeds and of accelerations stand for.
    """
    try:
        return _plan(mechanism, (tuple(speeds), tuple(accelerations)), fixed(hold))
    except (SpatialPinError, ValueError):
        return None  # what is tried says what is wrong


@made_once
def _plan(
    mechanism: Mechanism, names: tuple[tuple[str, ...], ...], hold: FixedHold
) -> tuple[Prescription, list[int], list[int]] | None:
    drivers = driven_coordinates(mechanism, mechanism.drivers)
    chosen = [[c for name in some for c in rate_coordinates(mechanism, name)] for some in names]
    if any(len(set(own)) != len(some) for some, own in zip(names, chosen, strict=True)):
        return None
    named = list(dict.fromkeys(c for own in chosen for c in own))
    if not set(named) <= set(drivers):
        if set(drivers) - set(named) or siblings(mechanism, named):
            return None
        drivers = named
    given = Prescription.of(mechanism, drivers, hold)
    if given.driven[: given.n_moving] != drivers:
        return None  # some of them are held
    speeds, accelerations = ([given.driven.index(c) for c in own] for own in chosen)
    return given, speeds, accelerations


def refuse_components(mechanism: Mechanism, driven: Iterable[Coordinate]) -> None:
    """Refuse components of balls and floating joints, whose rates are no entries of the velocity.

    Raises:
        MechanismFileError: names one.
    """
    for c in driven:
        if c.q < 0 and not isinstance(c, VelocityEntry):
            mechanism.driven_coordinate(c.name)
