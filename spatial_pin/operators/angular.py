"""Angular velocity and acceleration from a direction-cosine matrix A and its time derivatives.

A (3, 3) maps body coordinates into fixed ones. dA/dt A^T and A^T dA/dt are the skew matrices of the
angular velocity in fixed and in body axes [Pham, eq. 19-20].
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, finite_array
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.operators.rotation import checked_rotation


@checked
def spatial_angular_velocity(cosines: Any, rate: Any) -> Array:
    """Return omega (3,) [rad/s] in fixed axes from A and dA/dt [1/s], both (3, 3).

    Args:
        cosines: (3, 3) A, body to fixed axes.
        rate: (3, 3) dA/dt [1/s].

    Raises:
        ValueError: NaN, infinite, A no rotation, or dA/dt not tangent to the rotations at A.

    Example:
        >>> from spatial_pin import operators
        >>> turn = operators.rotation_matrix("z", 0.3)
        >>> spin = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # 2 rad/s about z
        >>> operators.spatial_angular_velocity(turn, spin @ turn).round(4)  # [rad/s]
        array([0., 0., 2.])
    """
    a, b = checked_rotation(cosines), finite_array(rate, (3, 3), "rate")
    return _vector(b @ a.T)


@checked
def body_angular_velocity(cosines: Any, rate: Any) -> Array:
    """Return omega (3,) [rad/s] in body axes from A and dA/dt [1/s], both (3, 3).

    Args:
        cosines: (3, 3) A, body to fixed axes.
        rate: (3, 3) dA/dt [1/s].

    Raises:
        ValueError: NaN, infinite, A no rotation, or dA/dt not tangent to the rotations at A.

    Example:
        >>> from spatial_pin import operators
        >>> turn = operators.rotation_matrix("z", 0.3)
        >>> spin = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # 2 rad/s about z
        >>> operators.body_angular_velocity(turn, spin @ turn).round(4)  # [rad/s]
        array([0., 0., 2.])
    """
    a, b = checked_rotation(cosines), finite_array(rate, (3, 3), "rate")
    return _vector(a.T @ b)


@checked
def spatial_angular_acceleration(cosines: Any, rate: Any, acceleration: Any) -> Array:
    """Return d omega/dt (3,) [rad/s^2] in fixed axes: the vector of A'' A^T + A' A'^T.

    Args:
        cosines: (3, 3) A.
        rate: (3, 3) dA/dt [1/s].
        acceleration: (3, 3) d2A/dt2 [1/s^2].

    Raises:
        ValueError: NaN, infinite, or derivatives that do not belong to a rotation.

    Example:
        >>> from spatial_pin import operators
        >>> turn = operators.rotation_matrix("z", 0.3)
        >>> spin = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # 2 rad/s about z
        >>> operators.spatial_angular_acceleration(turn, spin @ turn, spin @ spin @ turn).round(4)
        array([0., 0., 0.])
    """
    a, b = checked_rotation(cosines), finite_array(rate, (3, 3), "rate")
    _vector(b @ a.T)
    return _vector(finite_array(acceleration, (3, 3), "acceleration") @ a.T + b @ b.T)


@checked
def body_angular_acceleration(cosines: Any, rate: Any, acceleration: Any) -> Array:
    """Return d omega/dt (3,) [rad/s^2] in body axes; see `spatial_angular_acceleration`.

    Args:
        cosines: (3, 3) A, body to fixed axes.
        rate: (3, 3) dA/dt [1/s].
        acceleration: (3, 3) d2A/dt2 [1/s^2].

    Raises:
        ValueError: NaN, infinite, or derivatives that do not belong to a rotation.

    Example:
        >>> from spatial_pin import operators
        >>> turn = operators.rotation_matrix("z", 0.3)
        >>> spin = np.array([[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # 2 rad/s about z
        >>> operators.body_angular_acceleration(turn, spin @ turn, spin @ spin @ turn).round(4)
        array([0., 0., 0.])
    """
    spatial = spatial_angular_acceleration(cosines, rate, acceleration)
    return checked_rotation(cosines).T @ spatial


def _vector(skew: Array) -> Array:
    symmetric = float(np.abs(skew + skew.T).max()) / 2.0
    if symmetric > TOLERANCES.nothing * (1.0 + float(np.abs(skew).max())):
        raise ValueError(f"symmetric part {symmetric:.3g}: not the derivative of a rotation")
    return pin.unSkew(0.5 * (skew - skew.T))
