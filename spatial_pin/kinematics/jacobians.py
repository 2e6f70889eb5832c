"""Jacobians of closed mechanisms."""

from __future__ import annotations

import pinocchio as pin

from spatial_pin.kinematics.constraints import Evaluation, constraints_of
from spatial_pin.kinematics.rates import square_system
from spatial_pin.kinematics.state import WORLD_AXES, State
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import finite_array
from spatial_pin.mechanism.mechanism import Mechanism


def closure_jacobian(mechanism: Mechanism, q: Array) -> Array:
    """Return the derivative (rows, nv) of all closure rows with respect to joint velocities.

    Rows come closure by closure, couplings last, lengths divided by the characteristic length.

    Args:
        mechanism: the mechanism.
        q: (nq,) configuration, closed or not.

    Raises:
        ValueError: q has another shape, or is not finite.
    """
    evaluation = Evaluation(constraints_of(mechanism))
    evaluation.update(finite_array(q, (mechanism.model.nq,), "q"))
    rows = evaluation.jacobian[: evaluation.constraints.n_rows]
    return rows / mechanism.velocity_scale


def jacobian(mechanism: Mechanism, state: State, name: str) -> Array:
    """Return the closed-loop Jacobian (6, n_drivers) of a link, frame or joint.

    Column k is the frame's twist at its origin, world axes, linear above angular, per unit speed
    of driver k of `mechanism.drivers` [m/s and rad/s per rad/s or m/s].

    Raises:
        SingularError: the drivers do not determine the velocities there.
        UnknownNameError: there is no such frame.
    """
    frame = mechanism.frame_id(name)
    rates = square_system(state, ()).driver_rates()
    data = state.data
    pin.computeJointJacobians(mechanism.model, data, state.q)
    return pin.getFrameJacobian(mechanism.model, data, frame, WORLD_AXES) @ rates
