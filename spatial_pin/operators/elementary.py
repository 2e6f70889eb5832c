"""The seven elementary matrices, and links with their joints made of them.

Each is the placement of a frame that leaves coincidence with frame i, is translated along the axes
of i, and then turns or screws about one of its own axes: P_i = T P_j [EMT2431, 4-5]. Joint and link
models are products of them, read from the link's frame to the joint and on to the next link's
frame; they give what Pinocchio gives for the joint named in their docstrings.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, finite_array, finite_number
from spatial_pin.numerics.linalg import Array
from spatial_pin.operators.rotation import axis_vector, checked_rotation, rotation_matrix

ORIGIN = (0.0, 0.0, 0.0)


class Elementary(NamedTuple):
    """What one elementary matrix does after its translation.

    Attributes:
        axis: "x", "y" or "z" that it turns about; "" for none.
        screws: whether it also advances along that axis.
    """

    axis: str = ""
    screws: bool = False


class EulerAngles(NamedTuple):
    """Turns about z, then the new x, then the new z [rad].

    Example:
        >>> from spatial_pin import operators
        >>> rotation = operators.spherical_placement([0, 0, 0], 0.1, 0.2, 0.3).rotation
        >>> [round(x, 4) for x in operators.euler_zxz_from_rotation(rotation)]  # [rad]
        [0.1, 0.2, 0.3]
    """

    first: float
    second: float
    third: float


@checked
def elementary_matrix(case: int, offset: Any, angle: float = 0.0, lead: float = 0.0) -> pin.SE3:
    """Return elementary matrix 1 to 7 as a placement; `.homogeneous` is the 4x4.

    Args:
        case: 1, 2, 3: turn about x, y, z; 4, 5, 6: screw about x, y, z; 7: translation only.
        offset: (3,) translation (a, b, c) [m].
        angle: [rad]; cases 1 to 6.
        lead: translation per turn [m], positive for a right-handed screw; cases 4 to 6.

    Raises:
        ValueError: another case, NaN, infinite, or a number that the case does not have.

    Example:
        >>> from spatial_pin import operators
        >>> operators.elementary_matrix(6, [0.1, 0.0, 0.0], 2.0 * np.pi, lead=0.005).translation
        array([0.1  , 0.   , 0.005])
    """
    if case not in ELEMENTARY_MATRICES:
        raise ValueError(f"no elementary matrix {case!r}; there are 1 to 7")
    axis, screws = ELEMENTARY_MATRICES[case]
    t = finite_array(offset, (3,), "offset")
    angle, lead = finite_number(angle, "angle"), finite_number(lead, "lead")
    if (lead and not screws) or (angle and not axis):
        raise ValueError(f"elementary matrix {case} has no {'angle' if not axis else 'lead'}")
    if not axis:
        return pin.SE3(np.eye(3), t)
    advance = lead * angle / (2.0 * math.pi)
    return pin.SE3(rotation_matrix(axis, angle), t + advance * axis_vector(axis))


@checked
def revolute_placement(offset: Any, angle: float, axis: str = "z") -> pin.SE3:
    """Return link and revolute joint (`JointModelRX`, `RY`, `RZ`): offset (3,) [m], angle [rad].

    Args:
        offset: (3,) [m].
        angle: [rad], positive by the right-hand rule.
        axis: "x", "y" or "z".

    Raises:
        ValueError: NaN, infinite, or another axis.

    Example:
        >>> from spatial_pin import operators
        >>> operators.revolute_placement([0.1, 0.0, 0.0], np.pi / 2, "z").rotation.round(4)
        array([[ 0., -1.,  0.],
               [ 1.,  0.,  0.],
               [ 0.,  0.,  1.]])
    """
    return elementary_matrix(_case(axis), offset, angle)


@checked
def prismatic_placement(offset: Any, slide: float, axis: str = "z") -> pin.SE3:
    """Return link and prismatic joint (`JointModelPX`, `PY`, `PZ`): offset (3,), slide [m].

    Args:
        offset: (3,) [m].
        slide: along the axis [m].
        axis: "x", "y" or "z".

    Raises:
        ValueError: NaN, infinite, or another axis.

    Example:
        >>> from spatial_pin import operators
        >>> operators.prismatic_placement([0.1, 0.0, 0.0], 0.2, "x").translation.round(4)  # [m]
        array([0.3, 0. , 0. ])
    """
    return elementary_matrix(7, offset) * elementary_matrix(7, _along(axis, slide))


@checked
def screw_placement(offset: Any, angle: float, lead: float, axis: str = "z") -> pin.SE3:
    """Return link and screw joint (`JointModelHX`, `HY`, `HZ` of pitch lead/2pi).

    Args:
        offset: (3,) [m].
        angle: [rad].
        lead: translation per turn [m], positive for a right-handed screw.
        axis: "x", "y" or "z".

    Raises:
        ValueError: NaN, infinite, or another axis.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.screw_placement([0.0, 0.0, 0.0], np.pi, 0.01)  # half a turn
        >>> found.translation.round(4)  # [m]
        array([0.   , 0.   , 0.005])
    """
    return elementary_matrix(_case(axis) + 3, offset, angle, lead)


@checked
def cylindrical_placement(offset: Any, angle: float, slide: float, axis: str = "z") -> pin.SE3:
    """Return link and cylindrical joint (a composite of a revolute and a prismatic joint).

    Args:
        offset: (3,) [m].
        angle: [rad].
        slide: along the axis [m].
        axis: "x", "y" or "z".

    Raises:
        ValueError: NaN, infinite, or another axis.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.cylindrical_placement([0.1, 0.0, 0.0], 0.5, 0.2)
        >>> found.translation.round(4)  # [m]
        array([0.1, 0. , 0.2])
    """
    link = elementary_matrix(7, finite_array(offset, (3,), "offset") + _along(axis, slide))
    return link * elementary_matrix(_case(axis), ORIGIN, angle)


@checked
def planar_placement(offset: Any, x: float, y: float, angle: float) -> pin.SE3:
    """Return link and planar joint (`JointModelPlanar`): x, y [m] and angle [rad] about z.

    Args:
        offset: (3,) [m].
        x: along x of the plane [m].
        y: along y of the plane [m].
        angle: about z [rad].

    Raises:
        ValueError: NaN or infinite.

    Example:
        >>> from spatial_pin import operators
        >>> operators.planar_placement([0.0, 0.0, 0.1], 0.3, 0.2, 0.5).translation.round(4)  # [m]
        array([0.3, 0.2, 0.1])
    """
    return elementary_matrix(7, offset) * elementary_matrix(3, (x, y, 0.0), angle)


@checked
def universal_placement(offset: Any, first: float, second: float) -> pin.SE3:
    """Return link and universal joint (`JointModelUniversal`): turns about x, then y [rad].

    Args:
        offset: (3,) [m].
        first: turn about x [rad].
        second: turn about the new y [rad].

    Raises:
        ValueError: NaN or infinite.

    Example:
        >>> from spatial_pin import operators
        >>> operators.universal_placement([0.1, 0.0, 0.0], 0.1, 0.2).rotation.shape
        (3, 3)
    """
    return elementary_matrix(1, offset, first) * elementary_matrix(2, ORIGIN, second)


@checked
def spherical_placement(offset: Any, first: float, second: float, third: float) -> pin.SE3:
    """Return link and spherical joint (`JointModelSpherical`) as three intersecting revolutes.

    Args:
        offset: (3,) [m].
        first: turn about z [rad].
        second: turn about the new x [rad].
        third: turn about the new z [rad].

    Raises:
        ValueError: NaN or infinite.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.spherical_placement([0.1, 0.0, 0.0], 0.1, 0.2, 0.3)
        >>> found.translation, found.rotation.shape  # [m]
        (array([0.1, 0. , 0. ]), (3, 3))
    """
    return (
        elementary_matrix(3, offset, first)
        * elementary_matrix(1, ORIGIN, second)
        * elementary_matrix(3, ORIGIN, third)
    )


@checked
def euler_zxz_from_rotation(rotation: Any) -> EulerAngles:
    """Return the z-x-z Euler angles of a rotation (3, 3), `second` in [0, pi].

    `third` is read after undoing `first`, so that the product is exact to round-off also where the
    two z axes are parallel and only the sum or difference of the two counts; `first` is 0 there.

    Raises:
        ValueError: NaN, infinite, another shape, or no rotation.

    Example:
        >>> from spatial_pin import operators
        >>> rotation = operators.spherical_placement([0, 0, 0], 0.1, 0.2, 0.3).rotation
        >>> [round(x, 4) for x in operators.euler_zxz_from_rotation(rotation)]  # [rad]
        [0.1, 0.2, 0.3]
    """
    r = checked_rotation(rotation)
    sine = math.hypot(r[0, 2], r[1, 2])
    first = math.atan2(r[0, 2], -r[1, 2]) if sine > 0.0 else 0.0
    undone = rotation_matrix("z", -first) @ r
    return EulerAngles(first, math.atan2(sine, r[2, 2]), math.atan2(-undone[0, 1], undone[0, 0]))


def _case(axis: str) -> int:
    axis_vector(axis)
    return 1 + "xyz".index(axis)


def _along(axis: str, slide: float) -> Array:
    return finite_number(slide, "slide") * axis_vector(axis)


ELEMENTARY_MATRICES: dict[int, Elementary] = {
    1: Elementary("x"),
    2: Elementary("y"),
    3: Elementary("z"),
    4: Elementary("x", screws=True),
    5: Elementary("y", screws=True),
    6: Elementary("z", screws=True),
    7: Elementary(),
}
