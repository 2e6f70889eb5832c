"""Jacobians of closed mechanisms, and their second order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.kinematics.constraints import Evaluation, constraints_of
from spatial_pin.kinematics.rates import square_system
from spatial_pin.kinematics.state import WORLD_AXES, State, of_mechanism
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import finite_array
from spatial_pin.mechanism.mechanism import Mechanism


def closure_jacobian(mechanism: Mechanism, q: Array | State) -> Array:
    """Return the derivative (rows, nv) of all closure rows with respect to joint velocities.

    Rows come closure by closure, couplings last, lengths divided by the characteristic length.

    Args:
        mechanism: the mechanism.
        q: (nq,) configuration, closed or not, or a State.

    Raises:
        ValueError: q has another shape, or is not finite.
    """
    evaluation = Evaluation(constraints_of(mechanism))
    x = q.q if isinstance(q, State) else q
    evaluation.update(finite_array(x, (mechanism.model.nq,), "q"))
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
    state = of_mechanism(mechanism, state)
    rates = square_system(state, ()).driver_rates()
    data = state.data
    pin.computeJointJacobians(mechanism.model, data, state.q)
    return pin.getFrameJacobian(mechanism.model, data, frame, WORLD_AXES) @ rates


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


def influence(mechanism: Mechanism, state: State) -> Influence:
    """Return the influence coefficients of a closed state with respect to all drivers.

    The second order is the closure's acceleration bias, a quadratic form in the joint velocities,
    polarised: B(u, w) = (b(u + w) - b(u - w))/4 [BenedictTesar1978].

    Raises:
        SingularError: the drivers do not determine the velocities there.
    """
    state = of_mechanism(mechanism, state)
    system = square_system(state, ())
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
