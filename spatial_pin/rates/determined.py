"""What determines the rates of a closed state; the kernel, which solves for them there.

The kernel chooses the equations where it is clear which are independent. Elsewhere, and where
passive freedoms take the least rates, the square system chooses, or says why nothing determines
the rates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import FixedHold, Hold, divided, fixed, held_by
from spatial_pin.assembly.square_system import SINGULAR_PIVOT, SquareSystem
from spatial_pin.assembly.state import State
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import prescribed_places
from spatial_pin.kernel.rate_solver import Chosen, RateSolver, rates_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.rates.prescribed import driven_coordinates, rate_coordinates, siblings


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
            kernel, tuple(prescribed_places(kernel, self.driven, self.still)), self.n_moving)


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
    if not rates.place(state.q, state.angles):
        rates.place(state.q, state.angles, chosen_at(state, given))
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


class RatePlan(NamedTuple):
    """What is prescribed when rates are given under some names.

    Attributes:
        given: the prescription.
        speeds, accelerations: its places that the names stand for.
    """

    given: Prescription
    speeds: list[int]
    accelerations: list[int]


def plan_of(
    mechanism: Mechanism, speeds: Mapping[str, Any], accelerations: Mapping[str, Any], hold: Hold
) -> RatePlan | None:
    """Return what is prescribed where rates are given; None where it has to be tried.

    The drivers if all names are of them, or the named ones where nothing stands still beside them.

    Args:
        mechanism: the mechanism.
        speeds: numbers by name.
        accelerations: likewise.
        hold: what stands still, as for `solve_rates`.
    """
    try:
        return _plan(mechanism, (tuple(speeds), tuple(accelerations)), fixed(hold))
    except (SpatialPinError, ValueError):
        return None  # what is tried says what is wrong


@made_once
def _plan(
    mechanism: Mechanism, names: tuple[tuple[str, ...], ...], hold: FixedHold
) -> RatePlan | None:
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
    return RatePlan(given, *([given.driven.index(c) for c in own] for own in chosen))


def refuse_components(mechanism: Mechanism, driven: Iterable[Coordinate]) -> None:
    """Refuse components of balls and floating joints, whose rates are no entries of the velocity.

    Raises:
        MechanismFileError: names one.
    """
    for c in driven:
        if c.q < 0 and not isinstance(c, VelocityEntry):
            mechanism.driven_coordinate(c.name)
