"""Finite displacements in the plane: complex numbers, 2x2 rotations, homogeneous 3x3 operators.

Points are columns (x, y, 1); an operator that acts later stands further left [EMT2431, 2].
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, finite_array, finite_number, finite_points
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

SMALLEST_ANGLE = TOLERANCES.last_digit  # [rad]: less is round-off of a product of operators


@checked
def complex_rotation(angle: float) -> complex:
    """Return exp(i angle), the number that turns a complex point by `angle` [rad].

    Source: [EMT2431, eq. 10-11].

    Raises:
        ValueError: the angle is NaN or infinite.

    Example:
        >>> from spatial_pin import operators
        >>> turned = operators.complex_rotation(np.pi / 2) * (2.0 + 0.0j)  # the point (2, 0)
        >>> round(turned.real, 4), round(turned.imag, 4)
        (0.0, 2.0)
    """
    return cmath.rect(1.0, finite_number(angle, "angle"))


@checked
def complex_rotation_between(
    before: complex, after: complex, tolerance: float = TOLERANCES.nothing
) -> complex:
    """Return the unit number that turns `before` into `after` about the origin.

    Source: [EMT2431, eq. 5].

    Args:
        before: the point x + iy [m].
        after: the point that it becomes [m].
        tolerance: how much the lengths may differ, as a fraction.

    Raises:
        ValueError: a point is not finite or is the origin, or the lengths differ by more than
            `tolerance` as a fraction.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.complex_rotation_between(2.0 + 0.0j, 0.0 + 2.0j)
        >>> round(found.real, 4), round(found.imag, 4)  # a quarter turn
        (0.0, 1.0)
    """
    if not (cmath.isfinite(before) and cmath.isfinite(after)):
        raise ValueError("a point has a value that is NaN or infinite")
    lengths = abs(before), abs(after)
    if min(lengths) == 0.0 or abs(lengths[1] - lengths[0]) > tolerance * lengths[0]:
        raise ValueError(f"lengths {lengths[0]:.9g} and {lengths[1]:.9g}: a rotation keeps lengths")
    return (after / lengths[1]) / (before / lengths[0])


@checked
def planar_rotation_matrix(angle: float) -> Array:
    """Return the 2x2 rotation by `angle` [rad], counter-clockwise [EMT2431, eq. 16].

    Raises:
        ValueError: the angle is NaN or infinite.

    Example:
        >>> from spatial_pin import operators
        >>> operators.planar_rotation_matrix(np.pi / 2).round(4)
        array([[ 0., -1.],
               [ 1.,  0.]])
    """
    z = complex_rotation(angle)
    return np.array([[z.real, -z.imag], [z.imag, z.real]])


@checked
def planar_rotation(angle: float) -> Array:
    """Return the 3x3 rotation about the origin by `angle` [rad] [EMT2431, 2.4].

    Raises:
        ValueError: the angle is NaN or infinite.

    Example:
        >>> from spatial_pin import operators
        >>> operators.planar_rotation(np.pi / 2).round(4)
        array([[ 0., -1.,  0.],
               [ 1.,  0.,  0.],
               [ 0.,  0.,  1.]])
    """
    operator = np.eye(3)
    operator[:2, :2] = planar_rotation_matrix(angle)
    return operator


@checked
def planar_translation(displacement: Any) -> Array:
    """Return the 3x3 translation by `displacement` (2,) [m] [EMT2431, 2.3].

    Raises:
        ValueError: NaN, infinite, or another shape.

    Example:
        >>> from spatial_pin import operators
        >>> operators.planar_translation([0.3, 0.1])
        array([[1. , 0. , 0.3],
               [0. , 1. , 0.1],
               [0. , 0. , 1. ]])
    """
    operator = np.eye(3)
    operator[:2, 2] = finite_array(displacement, (2,), "displacement")
    return operator


@checked
def concatenated(*operators: Any) -> Array:
    """Return the 3x3 operator of several that act one after the other, in the order given.

    All are expressed in one fixed frame, so each later one premultiplies: rotation then
    translation is T R, translation then rotation R T, which differ [EMT2431, 2.4].

    Args:
        *operators: (3, 3) each.

    Raises:
        ValueError: one is NaN, infinite, or no rigid displacement in the plane.

    Example:
        >>> from spatial_pin import operators
        >>> both = operators.concatenated(operators.planar_rotation(np.pi / 2),
        ...                               operators.planar_translation([1.0, 0.0]))
        >>> operators.displaced_planar(both, [2.0, 0.0]).round(4)  # turned, then moved [m]
        array([1., 2.])
    """
    product = np.eye(3)
    for operator in operators:
        product = checked_displacement(operator) @ product
    return product


@checked
def planar_rotation_about(point: Any, angle: float) -> Array:
    """Return the 3x3 rotation by `angle` [rad] about `point` (2,) [m]: T(Q) R T(-Q).

    Source: [EMT2431, 2.5], whose intermediate product is misprinted.

    Args:
        point: (2,) that stays at rest [m].
        angle: [rad], counter-clockwise.

    Raises:
        ValueError: NaN, infinite, or another shape.

    Example:
        >>> from spatial_pin import operators
        >>> turn = operators.planar_rotation_about([1.0, 0.0], np.pi)
        >>> operators.displaced_planar(turn, [0.0, 0.0]).round(4)  # [m]
        array([ 2., -0.])
    """
    q = finite_array(point, (2,), "point")
    return concatenated(planar_translation(-q), planar_rotation(angle), planar_translation(q))


@checked
def rotation_center(displacement: Any, smallest_angle: float = SMALLEST_ANGLE) -> Array | None:
    """Return the point (2,) [m] that a 3x3 displacement leaves at rest, None for a translation.

    The inverse of `planar_rotation_about`: Q = (t + cot(angle/2) J t)/2, J a quarter turn.
    Rotations by no more than `smallest_angle` [rad] count as none.

    Args:
        displacement: (3, 3).
        smallest_angle: rotations by no more than this count as none [rad].

    Raises:
        ValueError: it is no rigid displacement in the plane.

    Example:
        >>> from spatial_pin import operators
        >>> turn = operators.planar_rotation_about([1.0, 2.0], 0.3)
        >>> operators.rotation_center(turn).round(4)  # [m]
        array([1., 2.])
    """
    d = checked_displacement(displacement)
    angle, (x, y) = rotation_angle(d), d[:2, 2]
    if abs(angle) <= max(finite_number(smallest_angle, "smallest_angle"), 0.0):
        return None
    return 0.5 * (np.array([x, y]) + np.array([-y, x]) / math.tan(0.5 * angle))


@checked
def rotation_angle(displacement: Any) -> float:
    """Return the angle [rad] in [-pi, pi] of a 3x3 displacement.

    Raises:
        ValueError: it is no rigid displacement in the plane.

    Example:
        >>> from spatial_pin import operators
        >>> operators.rotation_angle(operators.planar_rotation(0.3))  # [rad]
        0.3
    """
    d = checked_displacement(displacement)
    return math.atan2(d[1, 0], d[0, 0])


@checked
def displaced_planar(displacement: Any, points: Any) -> Array:
    """Return `points` (2,) or (N, 2) [m] after a 3x3 displacement.

    Args:
        displacement: (3, 3).
        points: before it.

    Raises:
        ValueError: NaN, infinite, or another shape.

    Example:
        >>> from spatial_pin import operators
        >>> operators.displaced_planar(operators.planar_rotation(np.pi / 2), [[1.0, 0.0]]).round(4)
        array([[0., 1.]])
    """
    d = checked_displacement(displacement)
    return finite_points(points, 2, "points") @ d[:2, :2].T + d[:2, 2]


@checked
def planar_motion_from_points(
    before: Any, after: Any, tolerance: float = TOLERANCES.nothing
) -> Array:
    """Return the 3x3 rigid displacement that takes points to their images.

    Two points determine it; with three or more [EMT2431, eq. 17] it is over-determined and the
    answer is the rigid motion of least squared misfit, angle = arg sum conj(z) z' with z, z' the
    complex points about their means [Umeyama1991, in the plane].

    Args:
        before: (N, 2) points [m], N >= 2.
        after: (N, 2) their images [m].
        tolerance: greatest change of a distance and greatest misfit accepted, as a fraction of the
            figure's largest distance; raise it for measured points.

    Raises:
        ValueError: all points coincide, distances change, or the figure is mirrored.

    Example:
        >>> from spatial_pin import operators
        >>> found = operators.planar_motion_from_points([[0, 0], [1, 0]], [[2, 0], [2, 1]])  # [m]
        >>> round(operators.rotation_angle(found), 4)  # [rad]
        1.5708
    """
    z, w = _complex_points(before, "before"), _complex_points(after, "after")
    if len(z) != len(w) or len(z) < 2:
        raise ValueError(f"{len(z)} points and {len(w)} images; as many of both, at least 2")
    apart, images = (np.abs(p[:, None] - p) for p in (z, w))
    size = float(apart.max())
    if size == 0.0:
        raise ValueError("all points coincide: the rotation is not determined")
    i, j = np.unravel_index(np.argmax(np.abs(images - apart)), apart.shape)
    if abs(images[i, j] - apart[i, j]) > tolerance * size:
        raise ValueError(f"points {i} and {j} are {apart[i, j]:.9g} apart before and "
                         f"{images[i, j]:.9g} after: the motion is not rigid")
    turned = np.vdot(z - z.mean(), w - w.mean())
    rotation = complex_rotation(cmath.phase(complex(turned)))
    shift = complex(w.mean() - rotation * z.mean())
    misfit = float(np.abs(rotation * z + shift - w).max())
    if misfit > tolerance * size:
        raise ValueError(f"images miss by {misfit:.3g}: the figure is mirrored or not rigid")
    return concatenated(planar_rotation(cmath.phase(rotation)),
                        planar_translation([shift.real, shift.imag]))


@checked
def spatial_from_planar(displacement: Any) -> pin.SE3:
    """Return the placement that a 3x3 displacement in the x-y plane is in space.

    Raises:
        ValueError: it is no rigid displacement in the plane.

    Example:
        >>> from spatial_pin import operators
        >>> plane = operators.planar_translation([0.3, 0.1])  # [m]
        >>> operators.spatial_from_planar(plane).translation
        array([0.3, 0.1, 0. ])
    """
    d = checked_displacement(displacement)
    rotation, translation = np.eye(3), np.zeros(3)
    rotation[:2, :2], translation[:2] = d[:2, :2], d[:2, 2]
    return pin.SE3(rotation, translation)


def checked_displacement(displacement: Any) -> Array:
    """Return a 3x3 operator after the checks that it is a rotation and a translation.

    Raises:
        ValueError: NaN, infinite, another shape, or no rigid motion of the plane.
    """
    d = finite_array(displacement, (3, 3), "displacement")
    (a, b), (c, e) = d[:2, :2]
    off = max(abs(a - e), abs(b + c), abs(math.hypot(a, c) - 1.0), *np.abs(d[2] - [0, 0, 1]))
    if off > TOLERANCES.nothing:
        raise ValueError(f"displacement is off a rigid motion of the plane by {off:.3g}")
    return d


def _complex_points(points: Any, what: str) -> np.ndarray[Any, Any]:
    p = np.atleast_2d(finite_points(points, 2, what))
    return p[:, 0] + 1j * p[:, 1]
