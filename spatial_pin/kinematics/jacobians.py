"""Jacobians of closed mechanisms, and their second order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.checks import checked
from spatial_pin.kinematics.constraints import Constraints, Evaluation, evaluation_of
from spatial_pin.kinematics.rates import square_system
from spatial_pin.kinematics.state import WORLD_AXES, State, of_mechanism
from spatial_pin.kinematics.views import frame_jacobian, own_jacobian
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import finite_array, needed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS


@checked
def closure_jacobian(mechanism: Mechanism, q: Array | State) -> Array:
    """Return the derivative (rows, nv) of all closure rows with respect to joint velocities.

    Rows come closure by closure, couplings last, lengths divided by the characteristic length.

    Args:
        mechanism: the mechanism.
        q: (nq,) configuration, closed or not, or a State.

    Raises:
        ValueError: q has another shape, or is not finite.
    """
    needed(mechanism)
    x = finite_array(q.q if isinstance(q, State) else q, (mechanism.model.nq,), "q")
    with evaluation_of(mechanism) as evaluation:
        evaluation.update(x)
        rows = evaluation.jacobian[: evaluation.constraints.n_rows]
        return rows / mechanism.velocity_scale


@checked
def jacobian(mechanism: Mechanism, state: State, name: str) -> Array:
    """Return the closed-loop Jacobian (6, n_drivers) of a link, frame or joint.

    Column k is the frame's twist at its origin, world axes, linear above angular, per unit speed
    of driver k of `mechanism.drivers` [m/s and rad/s per rad/s or m/s].

    Raises:
        SingularError: the drivers do not determine the velocities there.
        UnknownNameError: there is no such frame.
    """
    frame = mechanism.frame_id(mechanism.placed(name))
    state = of_mechanism(mechanism, state)
    with square_system(state, ()) as system:
        data = system.evaluation.data  # where the joints' Jacobians are known
        pin.updateFramePlacement(mechanism.model, data, frame)
        own = frame_jacobian(mechanism.model, data, frame)
        return own @ system.driver_rates()


@checked
def jacobian_rate(mechanism: Mechanism, state: State, name: str) -> Array:
    """Return the time derivative (6, n_drivers) of `jacobian` as the state moves with its v.

    With s the driver speeds, the frame's acceleration is jacobian @ s' + jacobian_rate @ s.

    Derivatives D_u of a Jacobian A along joint velocities u come from accelerations, which are
    quadratic in them: D_u A w + D_w A u is their polar form, and D_u A w - D_w A u follows from
    the bracket of the joints' velocities and that of angular velocities [MurrayLiSastry1994, A].

    Args:
        mechanism: the mechanism.
        state: from `solve_rates`.
        name: link, frame or joint.

    Raises:
        SingularError: the drivers do not determine the velocities there.
        UnknownNameError: there is no such frame.
    """
    frame = mechanism.frame_id(mechanism.placed(name))
    state = of_mechanism(mechanism, state)
    with square_system(state, ()) as system:
        moving = _Moving(mechanism, state, frame)
        still = np.zeros(len(system.driven))
        columns = []
        for w in system.driver_rates().T:
            turned = _bracket(mechanism, state.v, w)
            polar = [system.acceleration(state.q, v, still) for v in (state.v + w, state.v - w)]
            system.evaluation.update(state.q)
            skew = _row_brackets(system.evaluation, turned, state.v, w)
            spread = system.rates_of(skew, turned[system.drive_at])
            rate = 0.25 * (polar[0] - polar[1]) + 0.5 * spread
            columns.append(moving.rate(w, turned) + moving.jacobian @ rate)
    return np.array(columns).reshape(-1, 6).T


class _Moving:
    """The tree's Jacobian of a frame, and how it changes as a state moves."""

    def __init__(self, mechanism: Mechanism, state: State, frame: int) -> None:
        self.model, self.q, self.v, self.frame = mechanism.model, state.q, state.v, frame
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
    """Return the bracket (nv,) of two joint velocities: zero but where joints turn in space."""
    out = np.zeros_like(u)
    for i, pair in enumerate(mechanism.pairs, start=1):
        if not PAIRS[pair].is_linear:
            at, n = mechanism.model.idx_vs[i], mechanism.model.nvs[i]
            first, second = (pin.Motion(np.concatenate([np.zeros(6 - n), x[at : at + n]]))
                             for x in (u, w))
            out[at : at + n] = first.cross(second).vector[6 - n :]
    return out


def _row_brackets(evaluation: Evaluation, turned: Array, u: Array, w: Array) -> Array:
    """Return what the rows' Jacobians at u differ by from symmetry, (n_rows + n_passive,).

    The spin about a line fixed in a body is no function of the configuration: the body's angular
    velocities have a bracket of their own.
    """
    c: Constraints = evaluation.constraints
    out = evaluation.jacobian @ (turned / evaluation.mechanism.velocity_scale)
    for k, (joint, axis) in enumerate(c.spins):
        columns = own_jacobian(evaluation.model, evaluation.data, joint)[3:]
        out[c.n_rows + k] -= axis @ np.cross(columns @ u, columns @ w)
    return out


class Influence(NamedTuple):
    """First and second-order influence coefficients of the joints.

    With driver speeds s and accelerations s', v = first @ s and
    a = first @ s' + s @ second @ s (z' and z'' where there is one driver).

    Attributes:
        first: (nv, n) joint velocities per unit driver speed.
        second: (nv, n, n) symmetric in the drivers.
    """

    first: Array
    second: Array


@checked
def influence(mechanism: Mechanism, state: State) -> Influence:
    """Return the influence coefficients of a closed state with respect to all drivers.

    The second order is the closure's acceleration bias, a quadratic form in the joint velocities,
    polarised: B(u, w) = (b(u + w) - b(u - w))/4 [BenedictTesar1978].

    Raises:
        SingularError: the drivers do not determine the velocities there.
    """
    state = of_mechanism(mechanism, state)
    with square_system(state, ()) as system:
        first = system.driver_rates()
        n = first.shape[1]
        still = np.zeros(n)
        second = np.empty((len(first), n, n))
        for i in range(n):
            for j in range(i + 1):
                plus, minus = (system.acceleration(state.q, first[:, i] + sign * first[:, j], still)
                               for sign in (1.0, -1.0))
                second[:, i, j] = second[:, j, i] = 0.25 * (plus - minus)
    return Influence(first, second)
