"""Screw displacements: a turn about any axis with a translation along it, and back.

By Chasles' theorem every displacement is one [Chasles1830].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, finite_array, finite_number, finite_points
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.operators.rotation import (
    axis_angle_from_rotation,
    axis_vector,
    checked_rotation,
    rotation_matrix,
)

SMALLEST_ANGLE = TOLERANCES.last_digit  # [rad]: less is round-off of a product of placements
PLANES = {"yz": 0, "xz": 1, "xy": 2}  # coordinate plane: the coordinate that is zero in it


class ScrewDisplacement(NamedTuple):
    """A displacement as a turn about an axis and a translation along it.

    Attributes:
        direction: (3,) unit vector of the axis.
        point: (3,) a point on the axis [m]; from `screw_from_placement` the one nearest the origin.
        angle: [rad], by the right-hand rule; from `screw_from_placement` in [0, pi].
        translation: along `direction` [m].

    Example:
        >>> from spatial_pin import operators
        >>> placement = operators.screw_displacement("z", [1.0, 0.0, 0.0], 0.5, translation=0.2)
        >>> found = operators.screw_from_placement(placement)
        >>> found.point.round(4), round(found.angle, 4), round(found.translation, 4)  # [m, rad, m]
        (array([1., 0., 0.]), 0.5, 0.2)
    """

    direction: Array
    point: Array
    angle: float
    translation: float

    @property
    def pitch(self) -> float:
        """Translation per angle [m/rad], as Pinocchio's helical joints; infinite without a turn."""
        if self.angle == 0.0:
            return 0.0 if self.translation == 0.0 else math.copysign(math.inf, self.translation)
        return self.translation / self.angle

    @property
    def lead(self) -> float:
        """Translation per turn [m], positive for a right-handed screw."""
        return 2.0 * math.pi * self.pitch

    def placement(self) -> pin.SE3:
        """Return the displacement as a placement."""
        return screw_displacement(self.direction, self.point, self.angle, self.translation)

    def axis_crosses(self, plane: str) -> Array | None:
        """Return where the axis crosses the plane "xy", "xz" or "yz" (3,) [m], None if parallel.

        Source: [EMT2431, Ex. 3.6].

        Raises:
            ValueError: another plane.
        """
        if plane not in PLANES:
            raise ValueError(f"no plane {plane!r}; there are {', '.join(PLANES)}")
        i = PLANES[plane]
        if abs(self.direction[i]) <= TOLERANCES.tight:
            return None
        crossing = self.point - self.point[i] / self.direction[i] * self.direction
        crossing[i] = 0.0
        return crossing


@checked
def screw_displacement(
    direction: Any, point: Any, angle: float, translation: float = 0.0
) -> pin.SE3:
    """Return the placement of a screw displacement about any axis.

    The rotation is R(u, angle), the translation D u + (I - R) p [EMT2431, 3.5.1]; (I - R) p is
    summed as -sin(angle) u x p - vers(angle) u x (u x p), so that small angles keep their digits.

    Args:
        direction: "x", "y", "z" or a unit vector (3,) u along the axis.
        point: (3,) any point p on the axis [m].
        angle: [rad], positive by the right-hand rule.
        translation: D along the axis [m].

    Raises:
        ValueError: NaN, infinite, or a direction that is not of length 1.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.screw_displacement("z", [1.0, 0.0, 0.0], np.pi, translation=0.2)
        >>> found.translation.round(4)  # where the origin goes [m]
        array([ 2. , -0. ,  0.2])
    """
    u, p = axis_vector(direction), finite_array(point, (3,), "point")
    angle, d = finite_number(angle, "angle"), finite_number(translation, "translation")
    arm = np.cross(u, p)
    vers = 2.0 * math.sin(0.5 * angle) ** 2
    shift = d * u - math.sin(angle) * arm - vers * np.cross(u, arm)
    return pin.SE3(rotation_matrix(u, angle), shift)


@checked
def helical_displacement(direction: Any, point: Any, angle: float, pitch: float) -> pin.SE3:
    """Return the screw displacement by `angle` [rad] with translation pitch * angle, pitch [m/rad].

    Args:
        direction: "x", "y", "z" or a unit vector (3,) along the axis.
        point: (3,) any point on the axis [m].
        angle: [rad], positive by the right-hand rule.
        pitch: translation per radian [m/rad].

    Raises:
        ValueError: see `screw_displacement`.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.helical_displacement("z", [0.0, 0.0, 0.0], 2.0, 0.01)  # [m/rad]
        >>> found.translation.round(4)  # [m]
        array([0.  , 0.  , 0.02])
    """
    translation = finite_number(pitch, "pitch") * finite_number(angle, "angle")
    return screw_displacement(direction, point, angle, translation)


@checked
def screw_from_placement(
    placement: Any, smallest_angle: float = SMALLEST_ANGLE
) -> ScrewDisplacement:
    """Return the screw displacement that a placement is.

    With u, angle from the rotation, D = u . t and p = (s + cot(angle/2) u x s)/2, where
    s = t - D u, is the point of the axis nearest the origin. A pure translation has angle 0, the
    translation's direction and length, and the origin as its point; the identity has direction z.
    At a half turn the sign of u is that of `axis_angle_from_rotation`.

    Args:
        placement: pin.SE3 or homogeneous (4, 4).
        smallest_angle: rotations by no more than this count as none [rad].

    Raises:
        ValueError: NaN, infinite, or no rigid displacement.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.screw_from_placement(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2])))
        >>> found.angle, found.direction, round(found.translation, 4)  # [rad], (3,), [m]
        (0.0, array([0., 0., 1.]), 0.2)
    """
    m = as_placement(placement)
    (u, angle), t = axis_angle_from_rotation(m.rotation), m.translation
    if angle <= max(finite_number(smallest_angle, "smallest_angle"), 0.0):
        length = math.hypot(*t)
        u = t / length if length > 0.0 else axis_vector("z").copy()
        return ScrewDisplacement(u, np.zeros(3), 0.0, length)
    d = float(u @ t)
    s = t - d * u
    p = 0.5 * (s + np.cross(u, s) / math.tan(0.5 * angle))
    return ScrewDisplacement(u, p, angle, d)


@checked
def displaced_points(placement: Any, points: Any) -> Array:
    """Return `points` (3,) or (N, 3) [m] after a displacement (pin.SE3 or (4, 4)).

    Args:
        placement: the displacement.
        points: before it.

    Raises:
        ValueError: NaN, infinite, another shape, or no rigid displacement.

    Example:
        >>> from spatial_pin import operators
        >>> turn = operators.screw_displacement("z", [0.0, 0.0, 0.0], np.pi / 2, translation=0.1)
        >>> operators.displaced_points(turn, [[1.0, 0.0, 0.0]]).round(4)  # (N, 3) [m]
        array([[0. , 1. , 0.1]])
    """
    m = as_placement(placement)
    return finite_points(points, 3, "points") @ m.rotation.T + m.translation


@checked
def displaced_frame(placement: Any, frame: Any) -> pin.SE3:
    """Return a frame (pin.SE3 or (4, 4)) after a displacement, both in the same fixed frame.

    Args:
        placement: the displacement.
        frame: where the frame is before it.

    Raises:
        ValueError: NaN, infinite, another shape, or no rigid displacement.

    Example:
        >>> from spatial_pin import operators
        >>> frame = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
        >>> turn = operators.screw_displacement("z", [0.0, 0.0, 0.0], np.pi / 2)
        >>> operators.displaced_frame(turn, frame).translation.round(4)  # [m]
        array([0., 1., 0.])
    """
    return as_placement(placement) * as_placement(frame)


@checked
def as_placement(placement: Any) -> pin.SE3:
    """Return a pin.SE3 or a homogeneous (4, 4) as pin.SE3, after checks.

    Raises:
        ValueError: NaN, infinite, another shape, or no rigid displacement.

    Example:
        >>> from spatial_pin import operators
        >>> operators.as_placement(np.eye(4)).translation  # [m]
        array([0., 0., 0.])
    """
    h = placement.homogeneous if isinstance(placement, pin.SE3) else placement
    h = finite_array(h, (4, 4), "placement")
    if not np.array_equal(h[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"the last row of a placement is {h[3]}; 0, 0, 0, 1 is needed")
    return pin.SE3(checked_rotation(h[:3, :3]), h[:3, 3].copy())
