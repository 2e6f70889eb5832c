"""Rates where what is driven determines them clearly: by the kernel, in a tenth of the time.

`assembly.square_system.SquareSystem` is the specification. It works on where it is not clear which
equations depend on each other, and where passive freedoms take the least rates; it says what is
wrong where nothing determines the rates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

from spatial_pin.assembly.holding import Hold, divided, held_by
from spatial_pin.assembly.state import State
from spatial_pin.checks import finite_number
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.rates import Solved, rates_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.prescribed import rate_coordinates, siblings

Made = TypeVar("Made")


class Prescription(NamedTuple):
    """What is prescribed.

    Attributes:
        driven: places in the velocity vector, those that stand still last; nv and that of a
            component of a ball or a floating joint.
        n_moving: how many of them do not.
    """

    driven: tuple[int, ...]
    n_moving: int


def solved(
    state: State, speeds: Mapping[str, Any], accelerations: Mapping[str, Any], hold: Hold,
    drivers: Callable[[], list[Coordinate]],
) -> Solved | None:
    """Return the rates of a closed state; None where the kernel finds none.

    Args:
        state: the state.
        speeds: by driver [rad/s, m/s].
        accelerations: likewise [rad/s², m/s²].
        hold: what stands still, as for `solve_rates`.
        drivers: returns the coordinates of the mechanism's drivers.

    Raises:
        ValueError: a rate is no finite number.
    """
    mechanism = state.mechanism
    names = tuple(speeds), tuple(accelerations)
    plan = _once(mechanism, ("rates of", *names), hold,
                 lambda: _plan(mechanism, names, hold, drivers()))
    if plan is None:
        return None
    given, places = plan
    values = [[finite_number(x, f"{what} of {name!r}") for name, x in rates.items()]
              for what, rates in (("speed", speeds), ("acceleration", accelerations))]
    with kernel_of(mechanism) as kernel:
        rates = rates_of(kernel, *given)
        for target, own, numbers in zip((rates.speeds, rates.accelerations), places, values,
                                        strict=True):
            target[:] = 0.0
            for place, value in zip(own, numbers, strict=True):
                target[place] = value
        return rates.solve(state.q, state.angles)


def point_jacobian(
    state: State, frame: int, names: tuple[str, ...] | None, hold: Hold,
    moving: Callable[[], list[Coordinate]],
) -> Array | None:
    """Return the closed-loop Jacobian (6, n) of a frame; None where the kernel finds none.

    Args:
        state: the state.
        frame: Pinocchio's index.
        names: of what moves it, as for `jacobian`.
        hold: what stands still.
        moving: returns the coordinates that its columns belong to.
    """
    mechanism = state.mechanism
    given = _once(mechanism, ("jacobian of", names), hold,
                  lambda: _prescription(mechanism, moving(), hold))
    if given is None:
        return None
    with kernel_of(mechanism) as kernel:
        own = mechanism.model.frames[frame]
        joint = int(kernel.packed.carriers[own.parentJoint])
        local = kernel.packed.frames[joint].T @ own.placement.translation
        return rates_of(kernel, *given).jacobian(state.q, state.angles, joint, local)


def _once(
    mechanism: Mechanism, key: tuple[Any, ...], hold: Hold, make: Callable[[], Made | None]
) -> Made | None:
    """Return what is made once for names; None where they do not determine it, or it fails."""
    if not (hold is None or isinstance(hold, str)):
        return None
    whole = *key, hold
    if whole not in mechanism.memo:
        try:
            mechanism.memo[whole] = make()
        except (SpatialPinError, ValueError):
            return None  # the full way says what is wrong
    found: Made | None = mechanism.memo[whole]
    return found


def _plan(
    mechanism: Mechanism, names: tuple[tuple[str, ...], ...], hold: Hold, drivers: list[Coordinate]
) -> tuple[Prescription, list[list[int]]] | None:
    """Return what is prescribed, and the places of names; None where it has to be tried.

    The drivers if all names are of them, or the named ones where nothing stands still beside them.
    """
    chosen = [[c for name in some for c in rate_coordinates(mechanism, name)] for some in names]
    if any(len(set(own)) != len(some) for some, own in zip(names, chosen, strict=True)):
        return None
    named = list(dict.fromkeys(c for own in chosen for c in own))
    if not set(named) <= set(drivers):
        if set(drivers) - set(named) or siblings(mechanism, named):
            return None
        drivers = named
    given = _prescription(mechanism, drivers, hold)
    if given is None:
        return None
    nv = mechanism.model.nv
    return given, [[given.driven.index(_place(c, nv)) for c in some] for some in chosen]


def _prescription(
    mechanism: Mechanism, driven: list[Coordinate], hold: Hold
) -> Prescription | None:
    """Return where coordinates are prescribed; None where some of them are held."""
    moving, still = divided(mechanism, driven, hold)
    if len(moving) - len(held_by(mechanism, hold, driven).coordinates) != len(driven):
        return None
    nv = mechanism.model.nv
    return Prescription((*(_place(c, nv) for c in moving), *still), len(driven))


def _place(c: Coordinate, nv: int) -> int:
    """Return the velocity entry of a coordinate, or that and nv of a component that has none."""
    return c.v + nv * (c.q < 0 and not isinstance(c, VelocityEntry))
