"""Jacobians of closed mechanisms, and their derivatives."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import checked, names_of
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import BASE, Hold, free_bases, hold_names, is_base
from spatial_pin.assembly.state import State, angles_of, is_motion, pieces, samples_of
from spatial_pin.kernel.kernel import frame_in_kernel, kernel_of
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import finite_array, require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import Coordinate, drivers_of_tree
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.depending import solved_for_frame
from spatial_pin.rates.prescribed import (
    Prescription,
    chosen_at,
    driven_coordinates,
    rate_coordinates,
    refuse_components,
    solved_at,
    solved_by,
)

if TYPE_CHECKING:
    import spatial_pin as sp


@checked
def closure_jacobian(mechanism: Mechanism, q: Array | State | sp.Motion) -> Array:
    """Return the derivative of all closure equations with respect to joint velocities.

    Equations come closure by closure, couplings last; lengths are divided by the characteristic
    length. Velocities v (nv,) at which the loops stay closed have closure_jacobian @ v = 0.

    Args:
        mechanism: the mechanism.
        q: (nq,) configuration, closed or not, or a State; or a Motion.

    Returns:
        The matrix (equations, nv); of a Motion (N, equations, nv).

    Raises:
        ValueError: q has another shape, or is not finite.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> sp.closure_jacobian(mech, state).shape  # (equations, nv)
        (5, 3)
    """
    require_mechanism(mechanism)
    if is_motion(q):
        x, angles = finite_array(q.q, (len(q), mechanism.model.nq), "q"), angles_of(q)
        with kernel_of(mechanism) as kernel:
            return np.concatenate([
                kernel.jacobians_and_columns(x[piece], angles[piece])[0][:, : kernel.n_closure]
                / mechanism.velocity_scale for piece in pieces(q)])
    x = finite_array(q.q if isinstance(q, State) else q, (mechanism.model.nq,), "q")
    with loops_of(mechanism, q.angles if isinstance(q, State) else 0.0) as evaluation:
        evaluation.update(x)
        rows = evaluation.jacobian[: evaluation.constraints.n_closure]
        return rows / mechanism.velocity_scale


@checked
def jacobian(
    mechanism: Mechanism, state: State | sp.Motion, name: str,
    drivers: Iterable[str] | None = None, *, hold: Hold = BASE,
) -> Array:
    """Return the closed-loop Jacobian (6, n) of a link, frame or joint.

    Column k is the frame's twist at its origin, world axes, linear above angular, per unit speed of
    driver k [m/s and rad/s per rad/s or m/s]. A joint of several freedoms has a column for each
    entry of its velocity, as Pinocchio has it. Parts that do not move the frame may be
    undetermined.

    Args:
        mechanism: the mechanism.
        state: a closed configuration; or a Motion, for all its samples at a time.
        name: link, frame or joint.
        drivers: the drivers, joints or coordinates that move it, in the order of the columns; the
            rest follows. By default `mechanism.drivers`; in an open tree that names none, all
            joints but free bases. Where there are more drivers than freedoms some must be chosen.
        hold: names of joints that stand still, as for `solve_rates`; they have no column. A free
            base that is not held has six more, the last: per unit of its velocity, as Pinocchio has
            it.

    Returns:
        The matrix (6, n); of a Motion (N, 6, n).

    Raises:
        SingularError: the drivers do not determine the frame's velocity there; says which depend on
            others, or which freedoms are left, and of a Motion at which sample.
        UnknownNameError: a name does not exist.
        ValueError: a driver is named twice.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> found = sp.jacobian(mech, state, "rocker_b")
        >>> found.shape, found[:3, 0].round(4)  # (6, drivers); m/s per rad/s, world axes
        ((6, 1), array([-0.0464,  0.    , -0.0025]))
    """
    frame = mechanism.frame_id(mechanism.placed(name))
    names = None if drivers is None else tuple(names_of(drivers, "drivers"))
    samples = samples_of(mechanism, state)
    own = samples.mechanism
    given, point = _prescribed(own, names, hold_names(hold)), frame_in_kernel(own, frame)
    if not isinstance(samples, State):
        return solved_by(samples, given, ("jacobian",), lambda at, _: solved_for_frame(
            at, given, frame, "jacobian"), point)[0]
    with kernel_of(own) as kernel:
        found = given.rates(kernel).solve(samples.q, samples.angles, ("jacobian",), frame=point)
    return (found or solved_for_frame(samples, given, frame, "jacobian"))[0]


@made_once
def _prescribed(
    mechanism: Mechanism, drivers: tuple[str, ...] | None, hold: tuple[str, ...]
) -> Prescription:
    """Return the prescribed coordinates of a Jacobian with these drivers."""
    return Prescription.of(mechanism, moving_coordinates(mechanism, drivers, hold), hold)


def moving_coordinates(
    mechanism: Mechanism, drivers: Iterable[str] | None, hold: Hold
) -> list[Coordinate]:
    """Return the coordinates of the columns of a Jacobian, those of free bases last.

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: a driver is named twice.
    """
    if drivers is None:  # the drivers; in an open tree without any, all velocities except bases
        chosen = driven_coordinates(mechanism, ())
        joints = dict(zip(list(mechanism.model.names)[1:], mechanism.pairs, strict=True))
        if chosen == [mechanism.coordinate(name)
                      for name in drivers_of_tree(joints, mechanism.closures)]:
            loose = [c for joint, pair in joints.items()
                     if not PAIRS[pair].is_linear and joint not in free_bases(mechanism)
                     for c in rate_coordinates(mechanism, joint)]
            chosen = sorted([*chosen, *loose], key=lambda c: c.v)
    else:
        chosen = [c for name in names_of(drivers, "drivers")
                  for c in rate_coordinates(mechanism, name)]
    for c in chosen:
        if chosen.count(c) > 1:
            raise ValueError(f"drivers: {c.name!r} is named twice")
    moved = {c.joint for c in chosen}
    if any(is_base(mechanism, name) for name in hold_names(hold)):
        return chosen
    bases = [joint for joint in free_bases(mechanism) if joint not in moved]
    return [*chosen, *(c for joint in bases for c in rate_coordinates(mechanism, joint))]


@checked
def jacobian_rate(
    mechanism: Mechanism, state: State | sp.Motion, name: str,
    drivers: Iterable[str] | None = None, *, hold: Hold = BASE,
) -> Array:
    """Return the time derivative (6, n) of `jacobian` as the state moves with its v.

    With s the driver speeds, the frame's acceleration is jacobian @ s' + jacobian_rate @ s.

    Derivatives D_u of a Jacobian A along joint velocities u come from accelerations, which are
    quadratic in them: D_u A w + D_w A u is their polar form, and D_u A w - D_w A u follows from
    the bracket of the joints' velocities and that of angular velocities [MurrayLiSastry1994, A].

    Args:
        mechanism: the mechanism.
        state: from `solve_rates`; or a Motion, for all its samples at a time.
        name: link, frame or joint.
        drivers: as for `jacobian`.
        hold: as for `jacobian`.

    Returns:
        The matrix (6, n) [those of `jacobian`, per s]; of a Motion (N, 6, n) [per its `per`].

    Raises:
        SingularError: the drivers do not determine the velocities there, or at a sample.
        UnknownNameError: there is no such frame.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
        >>> rate = sp.jacobian_rate(mech, state, "rocker_b")  # (6, drivers)
        >>> (rate[:3, 0] * 10.0).round(3)  # [m/s²], as the crank's acceleration is zero
        array([-11.971,   0.   ,  -1.555])
        >>> state.acceleration("rocker_b").linear.round(3)
        array([-11.971,   0.   ,  -1.555])
    """
    frame = mechanism.frame_id(mechanism.placed(name))
    samples = samples_of(mechanism, state)
    own = samples.mechanism
    names = None if drivers is None else tuple(names_of(drivers, "drivers"))
    given = _prescribed(own, names, hold_names(hold))
    refuse_components(own, given.driven)
    return solved_by(samples, given, ("jacobian_rate",), lambda at, _: solved_for_frame(
        at, given, frame, "jacobian_rate"), frame_in_kernel(own, frame))[0]


class Influence(NamedTuple):
    """First and second-order influence coefficients of the joints; of a Motion a row each.

    With driver speeds s and accelerations s', v = first @ s and
    a = first @ s' + s @ second @ s (z' and z'' where there is one driver).

    Attributes:
        first: (nv, n) joint velocities per unit driver speed [rad or m per rad or m].
        second: (nv, n, n) joint accelerations per product of two driver speeds, symmetric in them
            [rad or m per rad², rad m or m²].

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.influence(mech, sp.assemble(mech, {"crank": 1.0}))
        >>> found.first.shape, found.second.shape  # (nv, n), (nv, n, n)
        ((3, 1), (3, 1, 1))
    """

    first: Array
    second: Array

    def __repr__(self) -> str:
        return brief(self)


@checked
def influence(
    mechanism: Mechanism, state: State | sp.Motion, drivers: Iterable[str] | None = None, *,
    hold: Hold = BASE,
) -> Influence:
    """Return the influence coefficients of a closed state with respect to its drivers.

    The second order is the closure's acceleration bias, a quadratic form in the joint velocities,
    polarised: B(u, w) = (b(u + w) - b(u) - b(w))/2 [BenedictTesar1978].

    Args:
        mechanism: the mechanism.
        state: a closed configuration; or a Motion, for all its samples at a time.
        drivers: as for `jacobian`.
        hold: as for `jacobian`.

    Returns:
        The Influence: `first` (nv, n) and `second` (nv, n, n); of a Motion (N, nv, n) and
        (N, nv, n, n).

    Raises:
        SingularError: the drivers do not determine the velocities there, or at a sample.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.influence(mech, sp.assemble(mech, {"crank": 1.0}))
        >>> mech.coordinates
        ('crank_pin', 'coupler_pin', 'rocker_pin')
        >>> found.first[:, 0].round(4)  # rad/s of each joint per rad/s of the crank
        array([ 1.    , -1.2429,  0.1935])
        >>> found.second[:, 0, 0].round(4)  # rad/s² per (rad/s)²
        array([0.    , 0.334 , 0.5016])
        >>> motion = sp.sweep(mech, "crank", np.linspace(1.0, 2.0, 101))
        >>> sp.influence(mech, motion).second.shape  # (N, nv, n, n)
        (101, 3, 1, 1)
    """
    samples = samples_of(mechanism, state)
    own = samples.mechanism
    names = None if drivers is None else tuple(names_of(drivers, "drivers"))
    given, wanted = _prescribed(own, names, hold_names(hold)), ("columns", "second")
    return Influence(*solved_by(samples, given, wanted, lambda at, _: solved_at(
        at, given, wanted, chosen=chosen_at(at, given))))
