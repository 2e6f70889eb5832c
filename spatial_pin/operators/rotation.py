"""Rotations in space: from axis and angle, back to them, one after the other, and their rates.

A direction-cosine matrix A (3, 3) maps body coordinates into fixed ones. dA/dt A^T and A^T dA/dt
are the skew matrices of the angular velocity in fixed and in body axes [Pham, eq. 19-20].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, finite_array, finite_number, rows_of, unit_vector
from spatial_pin.numerics.linalg import Array, aligned
from spatial_pin.numerics.tolerances import TOLERANCES

HALF_TURN_TOLERANCE = 2.0 * np.finfo(np.float64).eps  # cos(angle/2) of a half turn, round-off

UNIT_AXES = dict(zip("xyz", np.eye(3), strict=True))


class AxisAngle(NamedTuple):
    """Axis and angle of a rotation.

    Attributes:
        axis: (3,) unit vector; z when there is no rotation.
        angle: [rad] in [0, pi].

    Example:
        >>> from spatial_pin import operators
        >>> operators.axis_angle_from_rotation(operators.rotation_matrix("z", 0.3)).angle  # [rad]
        0.3
    """

    axis: Array
    angle: float


class Turn(NamedTuple):
    """One step of a composite rotation.

    Attributes:
        axis: "x", "y", "z" or a unit vector (3,), in the fixed or in the moving frame.
        angle: [rad], positive by the right-hand rule.
        about: "fixed" or "moving", the frame that `axis` belongs to.

    Example:
        >>> from spatial_pin import operators
        >>> operators.Turn("z", 0.3, about="moving").about
        'moving'
    """

    axis: Any
    angle: float
    about: str = "fixed"


@checked
def rotation_matrix(axis: Any, angle: float) -> Array:
    """Return R(u, angle) = I + sin(angle) [u] + vers(angle) (u u^T - I).

    Source: Rodrigues' formula [EMT2431, eq. 32], with vers = 1 - cos = 2 sin^2(angle/2), so that
    small angles keep their digits.

    Args:
        axis: "x", "y", "z" or a unit vector (3,).
        angle: [rad], positive by the right-hand rule.

    Raises:
        ValueError: NaN, infinite, or an axis that is not of length 1.

    Example:
        >>> from spatial_pin import operators
        >>> operators.rotation_matrix("z", np.pi / 2).round(4)
        array([[ 0., -1.,  0.],
               [ 1.,  0.,  0.],
               [ 0.,  0.,  1.]])
    """
    u, angle = axis_vector(axis), finite_number(angle, "angle")
    vers = 2.0 * math.sin(0.5 * angle) ** 2
    return np.eye(3) + math.sin(angle) * pin.skew(u) + vers * (np.outer(u, u) - np.eye(3))


@checked
def axis_angle_from_rotation(rotation: Any) -> AxisAngle:
    """Return axis and angle of a rotation (3, 3), to round-off at all angles.

    The unit quaternion (cos(angle/2), u sin(angle/2)) is taken from the largest of its components
    [Shepperd1978]; neither arccos of the trace [EMT2431, Ex. 3.6] nor division by sin(angle) is
    used, which lose half of the digits near 0 and all near pi. At a half turn u and -u are the
    same rotation: the first component that is not zero is made positive.

    Raises:
        ValueError: NaN, infinite, another shape, or no rotation; see `nearest_rotation`.

    Example:
        >>> from spatial_pin import operators
        >>> axis, angle = operators.axis_angle_from_rotation([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> axis.round(4), round(angle, 4)  # [rad]
        (array([0., 0., 1.]), 1.5708)
    """
    quaternion = pin.Quaternion(checked_rotation(rotation)).coeffs()
    v, w = quaternion[:3], float(quaternion[3])
    size = math.hypot(*v)
    if size == 0.0:
        return AxisAngle(UNIT_AXES["z"].copy(), 0.0)
    if abs(w) <= HALF_TURN_TOLERANCE:
        axis = v / size
        first = axis[np.argmax(np.abs(axis) > TOLERANCES.nothing)]
        return AxisAngle(axis if first > 0.0 else -axis, math.pi)
    return AxisAngle(math.copysign(1.0, w) * v / size, 2.0 * math.atan2(size, abs(w)))


@checked
def composite_rotation(turns: Iterable[Turn | tuple[Any, ...]]) -> Array:
    """Return the rotation (3, 3) of turns made one after the other from coincident frames.

    A turn about a fixed axis premultiplies, one about a moving axis postmultiplies
    [EMT2431, 3.2.4]. The result maps moving coordinates into fixed ones.

    Raises:
        ValueError: a turn has a bad axis or angle, or is about neither "fixed" nor "moving".

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.composite_rotation([("z", 0.3), ("x", 0.2, "moving")])
        >>> found.shape, found[2].round(4)
        ((3, 3), array([0.    , 0.1987, 0.9801]))
    """
    rotation: Array = np.eye(3)
    for axis, angle, about in rows_of(turns, Turn, "turn"):
        if not isinstance(about, str) or about not in COMPOSITION:
            raise ValueError(f"a turn is about {about!r}; {' or '.join(COMPOSITION)} is needed")
        rotation = COMPOSITION[about](rotation, rotation_matrix(axis, angle))
    return rotation


@checked
def nearest_rotation(matrix: Any) -> Array:
    """Return the rotation (3, 3) nearest to a matrix of few digits, in the least-squares sense.

    Raises:
        ValueError: NaN, infinite, another shape, or a matrix that mirrors or flattens space.

    Example:
        >>> from spatial_pin import operators
        >>> rough = [[0.0, -1.001, 0.0], [0.999, 0.0, 0.0], [0.0, 0.0, 1.0]]
        >>> operators.nearest_rotation(rough).round(3)
        array([[ 0., -1.,  0.],
               [ 1.,  0.,  0.],
               [ 0.,  0.,  1.]])
    """
    m = finite_array(matrix, (3, 3), "matrix")
    if not np.linalg.det(m) > 0.0:
        raise ValueError(f"the determinant is {np.linalg.det(m):.3g}: no rotation is near")
    return aligned(np.eye(3), m)


@checked
def axis_vector(axis: Any) -> Array:
    """Return "x", "y", "z" or a unit vector as (3,).

    Raises:
        ValueError: another name, or no unit vector.

    Example:
        >>> from spatial_pin import operators
        >>> operators.axis_vector("y")
        array([0., 1., 0.])
    """
    if isinstance(axis, str):
        if axis not in UNIT_AXES:
            raise ValueError(f"no axis {axis!r}; there are x, y, z and unit vectors")
        return UNIT_AXES[axis]
    return unit_vector(axis, "axis")


@checked
def direction_between(start: Any, end: Any) -> Array:
    """Return the unit vector (3,) that points from `start` (3,) to `end` (3,) [m].

    Args:
        start: (3,) [m].
        end: (3,) [m].

    Raises:
        ValueError: NaN, infinite, or points that coincide.

    Example:
        >>> from spatial_pin import operators
        >>> operators.direction_between([0.0, 0.0, 0.0], [0.3, 0.0, 0.4])
        array([0.6, 0. , 0.8])
    """
    line = finite_array(end, (3,), "end") - finite_array(start, (3,), "start")
    length = math.hypot(*line)
    if length == 0.0:
        raise ValueError("start and end coincide: no direction")
    return line / length


def checked_rotation(rotation: Any) -> Array:
    """Return a matrix (3, 3) after the checks that it is a rotation.

    Raises:
        ValueError: NaN, infinite, another shape, or not orthonormal and right-handed.
    """
    r = finite_array(rotation, (3, 3), "rotation")
    off = float(np.abs(r.T @ r - np.eye(3)).max())
    if off > TOLERANCES.nothing or np.linalg.det(r) < 0.0:
        raise ValueError(f"rotation is off orthonormal and right-handed by {off:.3g}; "
                         "nearest_rotation finds the rotation that a rounded matrix stands for")
    return r


COMPOSITION: dict[str, Callable[[Array, Array], Array]] = {
    "fixed": lambda rotation, turn: turn @ rotation,
    "moving": lambda rotation, turn: rotation @ turn,
}


# ---------------------------------------------------------------- rates


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
