"""Prescribed rates: coordinates behind names, and the equations for the other rates.

A coordinate's rate is its derivative, also for a rotation vector: `ball.x` is phi_x', as in
`State.coordinate`. A joint of several freedoms is given its whole velocity in Pinocchio's order: a
spherical joint the angular velocity of the child in the child's axes, a floating one the child's
linear velocity before that; others their coordinates' rates.

The kernel chooses the equations if their independence is clear. Otherwise, and for passive freedoms
with least rates, the square system chooses, or reports why the rates are not determined.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import finite_array, finite_number
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import Hold, divided, held_by
from spatial_pin.assembly.square_system import SINGULAR_PIVOT, SquareSystem
from spatial_pin.assembly.state import State, angles_of, at_sample, pieces
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.kernel import FrameInKernel, Kernel, kernel_of
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import prescribed_indices
from spatial_pin.kernel.rate_solver import Chosen, RateRows, RateSolver, rates_of
from spatial_pin.mechanism.coordinates import coordinates_of, driver_coordinates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import Array

if TYPE_CHECKING:
    import spatial_pin as sp


def rate_coordinates(mechanism: Mechanism, name: str) -> list[Coordinate]:
    """Return the coordinates prescribed by a rate of a joint, a coordinate or a driver.

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
    """Return the coordinates prescribed by names.

    These are the mechanism's drivers if all names are drivers; otherwise exactly the named
    coordinates.
    """
    wanted = [c for name in names for c in rate_coordinates(mechanism, name)]
    drivers = [*driver_coordinates(mechanism).values()]
    chosen = drivers if all(c in drivers for c in wanted) else wanted
    return list(dict.fromkeys(chosen))


def siblings(mechanism: Mechanism, named: Iterable[Coordinate]) -> list[Coordinate]:
    """Return the other coordinates of the joints of named coordinates."""
    named = list(named)
    joints = dict.fromkeys(c.joint for c in named)
    return [c for joint in joints for c in coordinates_of(mechanism, joint) if c not in named]


def rates_by_coordinate(
    mechanism: Mechanism, given: Mapping[str, Any], what: str, n: int | None = None
) -> dict[Coordinate, Any]:
    """Return rates, by prescribed coordinate.

    `what` names the rates in messages. Of n samples each may have a value.

    Returns:
        Numbers; of samples arrays (n,).

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: no finite number, not one for each freedom of the joint, or given twice.
    """
    rates: dict[Coordinate, Any] = {}
    for name, value in given.items():
        chosen = rate_coordinates(mechanism, name)
        k, words = len(chosen), f"{what} of {name!r}"
        if k > 1:
            words += " (" + ", ".join(c.name for c in chosen) + ")"
        if is_each := n is not None and np.ndim(value) > (k > 1):
            m = n or 0
            values: Any = finite_array(value, (m, k) if k > 1 else (m,), words).reshape(m, k).T
        else:
            values = [finite_number(value, words)] if k == 1 else finite_array(
                value, (k,), words).tolist()
        for c, x in zip(chosen, values, strict=True):
            if c in rates:
                raise ValueError(f"{what} of {c.name!r} is given twice")
            rates[c] = x if n is None or is_each else np.full(n, x)
    return rates


def check_unambiguous(mechanism: Mechanism, chosen: Iterable[Coordinate]) -> None:
    """Refuse a joint that is named whole and also by its components.

    Raises:
        ValueError: with its name.
    """
    whole = {c.joint for c in chosen if isinstance(c, VelocityEntry)}
    for c in chosen:
        if c.joint in whole and not isinstance(c, VelocityEntry):
            raise ValueError(
                f"mechanism {mechanism.name!r}: {c.joint!r} is given whole (its angular velocity) "
                f"and by its component {c.name!r} (a rate of its rotation vector): choose one")


class Prescription(NamedTuple):
    """Prescribed coordinates and fixed velocities.

    Attributes:
        driven: coordinates, fixed ones last.
        n_moving: number of those that are not fixed.
        still: indices of zero entries in the velocity vector.
    """

    driven: list[Coordinate]
    n_moving: int
    still: tuple[int, ...]

    @classmethod
    def of(cls, mechanism: Mechanism, driven: Iterable[Coordinate], hold: Hold) -> Prescription:
        """Return the prescription of driven coordinates, with fixed ones from `hold`."""
        driven = list(driven)
        moving, still = divided(mechanism, driven, hold)
        return cls(moving, len(moving) - len(held_by(mechanism, hold, driven).coordinates), still)

    def rates(self, kernel: Kernel) -> RateSolver:
        """Return the solver for the rates in a kernel."""
        return rates_of(
            kernel, tuple(prescribed_indices(kernel.nv, self.driven, self.still)), self.n_moving)


def solved_at(
    state: State, given: Prescription, wanted: tuple[str, ...],
    frame: FrameInKernel | None = None, chosen: Chosen | None = None, v: Array | None = None,
) -> list[Array] | None:
    """Return results of `RateRows` at a state; None where its equations are not clear.

    Joint velocities v (nv,) are the state's own by default.
    """
    v = state.v if v is None else v
    with kernel_of(state.mechanism) as kernel:
        return given.rates(kernel).solve(
            state.q, state.angles, wanted, frame=frame, v=v, chosen=chosen)


def solved_by(
    samples: State | sp.Motion, given: Prescription, wanted: tuple[str, ...],
    otherwise: Callable[[State, int], Sequence[Array] | None], frame: FrameInKernel | None = None,
    rates: tuple[Array, Array] | None = None,
) -> list[Array]:
    """Return results of `RateRows` at a State, or at all samples of a Motion.

    `otherwise` returns the same of a State, and its number, where equations are not clear. `rates`
    are speeds and accelerations (N, k) of the prescribed coordinates of a Motion.

    Raises:
        SingularError: they are not determined; of a Motion says at which sample.
    """
    if isinstance(samples, State):
        return solved_at(samples, given, wanted, frame) or list(otherwise(samples, 0) or ())
    parts, angles = list[RateRows](), angles_of(samples)
    with kernel_of(samples.mechanism) as kernel:
        solver = given.rates(kernel)
        for piece in pieces(samples):
            own = None if rates is None else (rates[0][piece], rates[1][piece])
            parts.append(solver.rows(samples.q[piece], angles[piece], wanted, frame=frame,
                                     v=samples.v[piece], rates=own))
    results = [np.concatenate([getattr(rows, name) for rows in parts]) for name in wanted]
    for row in np.flatnonzero(np.concatenate([rows.codes for rows in parts])).tolist():
        with at_sample(row):
            solution = otherwise(samples.state(row), row) or ()
            for result, own_result in zip(results, solution, strict=True):
                result[row] = own_result
    return results


def chosen_at(state: State, given: Prescription, frame: int | None = None) -> Chosen:
    """Return the equations that determine the rates of a closed state.

    `frame` is one whose velocity alone must be determined; default: all.

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
def prescription_by(mechanism: Mechanism, driver: str, hold: tuple[str, ...]) -> Prescription:
    """Return the prescription of a driver, with fixed coordinates."""
    return Prescription.of(mechanism, driven_coordinates(mechanism, [driver]), hold)


@made_once
def rates_prescription(
    mechanism: Mechanism, speeds: tuple[str, ...], accelerations: tuple[str, ...],
    hold: tuple[str, ...],
) -> tuple[Prescription, list[int], list[int]] | None:
    """Return the prescription of rates by name; None if trials are needed.

    It has all drivers if all names are drivers, or the named coordinates if no others must be
    fixed. The indices in it of the names of speeds and of accelerations come with it.
    """
    drivers = driven_coordinates(mechanism, mechanism.drivers)
    try:
        chosen = [[c for name in some for c in rate_coordinates(mechanism, name)]
                  for some in (speeds, accelerations)]
        named = list(dict.fromkeys(c for own in chosen for c in own))
        wanted = drivers if set(named) <= set(drivers) else named
        given = Prescription.of(mechanism, wanted, hold)
    except (SpatialPinError, ValueError):
        return None  # the solver refuses it in words
    if any(len(set(own)) != len(some) for some, own in zip((speeds, accelerations), chosen,
                                                         strict=True)):
        return None
    if wanted is named and (set(drivers) - set(named) or siblings(mechanism, named)):
        return None
    if given.driven[: given.n_moving] != wanted:
        return None  # some of them are held
    of_speeds, of_accelerations = ([given.driven.index(c) for c in own] for own in chosen)
    return given, of_speeds, of_accelerations


def refuse_components(mechanism: Mechanism, driven: Iterable[Coordinate]) -> None:
    """Refuse components of balls and floating joints, whose rates are not velocity entries.

    Raises:
        MechanismFileError: with its name.
    """
    for c in driven:
        if c.q < 0 and not isinstance(c, VelocityEntry):
            mechanism.driven_coordinate(c.name)
