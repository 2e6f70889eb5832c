"""Jacobians of closed mechanisms, and their derivatives."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import checked, names_of
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import BASE, FixedHold, Hold, free_bases, hashable_hold, is_base
from spatial_pin.assembly.state import WORLD_AXES, State, of_mechanism
from spatial_pin.constraints.compiled_equations import Constraints
from spatial_pin.constraints.pinocchio_views import frame_jacobian
from spatial_pin.kernel.kernel import Kernel, kernel_of
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.kernel.rate_solver import RateSolver
from spatial_pin.mechanism.coordinates import finite_array, require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import Coordinate, drivers_of_tree
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.depending import equations_for_all_frames, equations_for_frame
from spatial_pin.rates.prescribed import (
    Prescription,
    driven_coordinates,
    factored_rates,
    rate_coordinates,
    refuse_components,
)


@checked
def closure_jacobian(mechanism: Mechanism, q: Array | State) -> Array:
    """Return the derivative of all closure equations with respect to joint velocities.

    Equations come closure by closure, couplings last; lengths are divided by the characteristic
    length. Velocities v (nv,) at which the loops stay closed have closure_jacobian @ v = 0.

    Args:
        mechanism: the mechanism.
        q: (nq,) configuration, closed or not, or a State.

    Returns:
        The matrix (equations, nv).

    Raises:
        ValueError: q has another shape, or is not finite.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> sp.closure_jacobian(mech, state).shape  # (equations, nv)
        (5, 3)
    """
    require_mechanism(mechanism)
    x = finite_array(q.q if isinstance(q, State) else q, (mechanism.model.nq,), "q")
    with loops_of(mechanism) as evaluation:
        evaluation.update(x)
        rows = evaluation.jacobian[: evaluation.constraints.n_closure]
        return rows / mechanism.velocity_scale


@checked
def jacobian(
    mechanism: Mechanism, state: State, name: str, drivers: Iterable[str] | None = None, *,
    hold: Hold = BASE,
) -> Array:
    """Return the closed-loop Jacobian (6, n) of a link, frame or joint.

    Column k is the frame's twist at its origin, world axes, linear above angular, per unit speed of
    driver k [m/s and rad/s per rad/s or m/s]. A joint of several freedoms has a column for each
    entry of its velocity, as Pinocchio has it. Parts that do not move the frame may be
    undetermined.

    Args:
        mechanism: the mechanism.
        state: a closed configuration.
        name: link, frame or joint.
        drivers: the drivers, joints or coordinates that move it, in the order of the columns; the
            rest follows. By default `mechanism.drivers`; in an open tree that names none, all
            joints but free bases. Where there are more drivers than freedoms some must be chosen.
        hold: names of joints that stand still, as for `solve_rates`; they have no column. A free
            base that is not held has six more, the last: per unit of its velocity, as Pinocchio has
            it.

    Returns:
        The matrix (6, n).

    Raises:
        SingularError: the drivers do not determine the frame's velocity there; says which depend on
            others, or which freedoms are left.
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
    state = of_mechanism(mechanism, state)
    names = None if drivers is None else tuple(names_of(drivers, "drivers"))
    mechanism = state.mechanism
    given = _prescribed(mechanism, names, hashable_hold(hold))
    with kernel_of(mechanism) as kernel:
        rates = given.rates(kernel)
        if rates.factor(state.q, state.angles):
            return _columns(kernel, rates, frame)
    dependence = equations_for_frame(state, given, frame)
    with kernel_of(dependence.state.mechanism) as kernel:
        columns = _columns(kernel, dependence.rates(kernel), frame)
        return dependence.among_all(columns, given.n_moving)


def _columns(kernel: Kernel, rates: RateSolver, frame: int) -> Array:
    """Return the Jacobian (6, n) of a frame for placed rates."""
    own = kernel.mechanism.model.frames[frame]
    joint = int(kernel.packed.carriers[own.parentJoint])
    return rates.jacobian(joint, kernel.packed.frames[joint].T @ own.placement.translation)


@made_once
def _prescribed(
    mechanism: Mechanism, drivers: tuple[str, ...] | None, hold: FixedHold
) -> Prescription:
    """Return the prescribed coordinates of a Jacobian with these drivers."""
    return Prescription.of(mechanism, moving_coordinates(mechanism, drivers, hold), hold)


def moving_coordinates(
    mechanism: Mechanism, drivers: Iterable[str] | None, hold: Hold
) -> list[Coordinate]:
    """Return the coordinates of the columns of a Jacobian, those of free bases last.

    Args:
        mechanism: the mechanism.
        drivers: as for `jacobian`.
        hold: as for `jacobian`.

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
    names = () if hold is None else names_of(hold, "hold")
    if any(is_base(mechanism, name) for name in names):
        return chosen
    bases = [joint for joint in free_bases(mechanism) if joint not in moved]
    return [*chosen, *(c for joint in bases for c in rate_coordinates(mechanism, joint))]


@checked
def jacobian_rate(
    mechanism: Mechanism, state: State, name: str, drivers: Iterable[str] | None = None, *,
    hold: Hold = BASE,
) -> Array:
    """Return the time derivative (6, n) of `jacobian` as the state moves with its v.

    With s the driver speeds, the frame's acceleration is jacobian @ s' + jacobian_rate @ s.

    Derivatives D_u of a Jacobian A along joint velocities u come from accelerations, which are
    quadratic in them: D_u A w + D_w A u is their polar form, and D_u A w - D_w A u follows from
    the bracket of the joints' velocities and that of angular velocities [MurrayLiSastry1994, A].

    Args:
        mechanism: the mechanism.
        state: from `solve_rates`.
        name: link, frame or joint.
        drivers: as for `jacobian`.
        hold: as for `jacobian`.

    Returns:
        The matrix (6, n) [those of `jacobian`, per s].

    Raises:
        SingularError: the drivers do not determine the velocities there.
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
    state = of_mechanism(mechanism, state)
    mechanism = state.mechanism
    given = Prescription.of(mechanism, moving_coordinates(mechanism, drivers, hold), hold)
    refuse_components(mechanism, given.driven)
    moving = _Moving(mechanism, state, frame)
    dependence = equations_for_all_frames(state, given) or equations_for_frame(state, given, frame)
    part, angles = dependence.state.mechanism, dependence.state.angles
    with kernel_of(part) as kernel, loops_of(part, angles) as evaluation:
        rates = dependence.rates(kernel)
        evaluation.update(state.q)
        columns = []
        for w in rates.columns().T:
            turned = _bracket(mechanism, state.v, w)
            polar = rates.acceleration(state.v + w) - rates.acceleration(state.v - w)
            spread = rates.answer(_equation_brackets(evaluation, turned, state.v, w))
            columns.append(moving.rate(w, turned)
                           + moving.jacobian @ (0.25 * polar + 0.5 * spread))
    return dependence.among_all(np.array(columns).reshape(-1, 6).T, given.n_moving)


class _Moving:
    """The tree's Jacobian of a frame, and its rate in a motion."""

    def __init__(self, mechanism: Mechanism, state: State, frame: int) -> None:
        self.model, self.q, self.v, self.frame = mechanism.centred_model, state.q, state.v, frame
        self.data = self.model.createData()
        pin.computeJointJacobians(self.model, self.data, self.q)
        pin.updateFramePlacements(self.model, self.data)
        self.jacobian = frame_jacobian(self.model, self.data, frame)

    def rate(self, w: Array, turned: Array) -> Array:
        """Return (6,) the derivative of jacobian @ w at fixed w; `turned` is the bracket [v, w]."""
        plus, minus = self._bias(self.v + w), self._bias(self.v - w)
        skew = self.jacobian @ turned
        skew[3:] += np.cross(self.jacobian[3:] @ self.v, self.jacobian[3:] @ w)
        return 0.25 * (plus - minus) + 0.5 * skew

    def _bias(self, v: Array) -> Array:
        """Return (6,) the frame's classical acceleration at zero joint acceleration."""
        pin.forwardKinematics(self.model, self.data, self.q, v, np.zeros_like(v))
        accel = pin.getFrameClassicalAcceleration(self.model, self.data, self.frame, WORLD_AXES)
        return accel.vector


def _bracket(mechanism: Mechanism, u: Array, w: Array) -> Array:
    """Return the Lie bracket (nv,) of joint velocities, zero except for spatial joints."""
    out = np.zeros_like(u)
    for i, pair in enumerate(mechanism.pairs, start=1):
        if not PAIRS[pair].is_linear:
            at, n = mechanism.model.idx_vs[i], mechanism.model.nvs[i]
            first, second = (pin.Motion(np.concatenate([np.zeros(6 - n), x[at : at + n]]))
                             for x in (u, w))
            out[at : at + n] = first.cross(second).vector[6 - n :]
    return out


def _equation_brackets(evaluation: LoopEquations, turned: Array, u: Array, w: Array) -> Array:
    """Return the asymmetry of the equations' second derivatives, (n_closure + n_passive,).

    The spin about a line fixed in a body is not a function of the configuration: the body's angular
    velocities have a bracket of their own.
    """
    c: Constraints = evaluation.constraints
    out = evaluation.jacobian @ (turned / evaluation.mechanism.velocity_scale)
    for k, (joint, axis) in enumerate(c.idle_axes):
        columns = evaluation.placements[joint, :3] @ evaluation.body_jacobian(joint)[3:]
        out[c.n_closure + k] -= axis @ np.cross(columns @ u, columns @ w)
    return out


class Influence(NamedTuple):
    """First and second-order influence coefficients of the joints.

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
    mechanism: Mechanism, state: State, drivers: Iterable[str] | None = None, *,
    hold: Hold = BASE,
) -> Influence:
    """Return the influence coefficients of a closed state with respect to its drivers.

    The second order is the closure's acceleration bias, a quadratic form in the joint velocities,
    polarised: B(u, w) = (b(u + w) - b(u - w))/4 [BenedictTesar1978].

    Args:
        mechanism: the mechanism.
        state: a closed configuration.
        drivers: as for `jacobian`.
        hold: as for `jacobian`.

    Returns:
        The Influence: `first` (nv, n) and `second` (nv, n, n).

    Raises:
        SingularError: the drivers do not determine the velocities there.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.influence(mech, sp.assemble(mech, {"crank": 1.0}))
        >>> mech.coordinates
        ('crank_pin', 'coupler_pin', 'rocker_pin')
        >>> found.first[:, 0].round(4)  # rad/s of each joint per rad/s of the crank
        array([ 1.    , -1.2429,  0.1935])
        >>> found.second[:, 0, 0].round(4)  # rad/s² per (rad/s)²
        array([0.    , 0.334 , 0.5016])
    """
    state = of_mechanism(mechanism, state)
    mechanism = state.mechanism
    given = Prescription.of(mechanism, moving_coordinates(mechanism, drivers, hold), hold)
    with kernel_of(mechanism) as kernel:
        rates = factored_rates(kernel, state, given)
        first = rates.columns()
        n = first.shape[1]
        second = np.empty((len(first), n, n))
        for i in range(n):
            for j in range(i + 1):
                plus, minus = (rates.acceleration(first[:, i] + sign * first[:, j])
                               for sign in (1.0, -1.0))
                second[:, i, j] = second[:, j, i] = 0.25 * (plus - minus)
    return Influence(first, second)
