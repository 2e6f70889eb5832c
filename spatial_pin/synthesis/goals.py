"""What to ask of a mechanism in `design`: each a function that returns a goal.

With a weight (the default is 1) a goal is met as well as can be: the sum of weight² residual² is
least, lengths relative to the characteristic length, angles in rad. With `weight=None` it is met
exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.checks import checked, finite_array, finite_number, finite_points, mapping
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.precision import Function, Path, Poses


def _weight(weight: float | None) -> float | None:
    if weight is None:
        return None
    if not finite_number(weight, "weight") > 0.0:
        raise ValueError(f"weight is {weight:g}; it is larger than 0, or None for a goal that is "
                         "to be met exactly")
    return float(weight)


def _timed(drivers: Mapping[str, Any] | None, k: int) -> dict[str, Array]:
    found = {}
    for name, values in mapping({} if drivers is None else drivers, "drivers").items():
        found[name] = finite_array(values, (k,), f"drivers: values of {name!r}")
    return found


@checked
def path(
    frame: str, points: Any, drivers: Mapping[str, Any] | None = None, *, closed: bool = False,
    scale: bool = False, placement: bool = False, input_offset: bool = False,
    weight: float | None = 1.0,
) -> Path:
    """Ask that the origin of a frame goes through points.

    Args:
        frame: name of a link, frame or joint.
        points: (k, 3), or (k, 2) in the x-y plane of the world [m]; one alone may be (3,).
        drivers: {name: (k,)} values of drivers at the points [rad or m]; None: the timing is free.
        closed: whether the path comes back to its first point.
        scale: whether the points may be scaled together.
        placement: whether the points may be moved and turned together.
        input_offset: whether the drivers count from a zero that is found with the dimensions.
        weight: as for all goals: None is exact.

    Raises:
        ValueError: points or values are not numbers, or not as many.
    """
    array = np.asarray(points)
    flat = array.shape[-1:] == (2,)
    found = np.atleast_2d(finite_points(points, 2 if flat else 3, "points"))
    if flat:
        found = np.hstack([found, np.zeros((len(found), 1))])
    if not len(found):
        raise ValueError("path: there are no points")
    return Path(weight=_weight(weight), frame=frame, points=found, placement=placement, scale=scale,
                drivers=_timed(drivers, len(found)), input_offset=input_offset, closed=closed)


@checked
def poses(
    frame: str, placements: Sequence[Any], drivers: Mapping[str, Any] | None = None, *,
    scale: bool = False, placement: bool = False, input_offset: bool = False,
    weight: float | None = 1.0,
) -> Poses:
    """Ask that a frame goes through placements.

    Args:
        frame: name of a link, frame or joint.
        placements: `pinocchio.SE3` or (4, 4) of the frame in the world.
        drivers: as for `path`.
        scale: whether the places may be scaled together.
        placement: whether the placements may be moved and turned together.
        input_offset: as for `path`.
        weight: as for all goals: None is exact.

    Raises:
        ValueError: a placement is none.
    """
    found = [_placement(x, i) for i, x in enumerate(placements)]
    if not found:
        raise ValueError("poses: there are no placements")
    return Poses(
        weight=_weight(weight), frame=frame, points=np.array([x.translation for x in found]),
        rotations=np.array([x.rotation for x in found]), placement=placement, scale=scale,
        drivers=_timed(drivers, len(found)), input_offset=input_offset)


def _placement(given: Any, i: int) -> pin.SE3:
    if isinstance(given, pin.SE3):
        return given
    array = finite_array(given, (4, 4), f"placement {i}")
    rotation = array[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0.0:
        raise ValueError(f"placement {i} has no rotation in its first three rows and columns")
    return pin.SE3(rotation, array[:3, 3])


@checked
def function(
    output: str, values: Any, drivers: Mapping[str, Any], *, offset: bool = False,
    input_offset: bool = False, weight: float | None = 1.0,
) -> Function:
    """Ask that a coordinate follows drivers.

    Args:
        output: name of a coordinate of a joint of one freedom, or of a cylinder's or the like.
        values: (k,) of it [rad or m]; angles are met but for whole turns.
        drivers: {name: (k,)} values of drivers at the same configurations.
        offset: whether the output counts from a zero that is found with the dimensions.
        input_offset: whether the drivers do.
        weight: as for all goals: None is exact.

    Raises:
        ValueError: values are not numbers, or not as many; there are no drivers.
    """
    array = finite_array(values, np.shape(values), "values")
    if array.ndim != 1 or not len(array):
        raise ValueError(f"function: values of {output!r} are a list of numbers")
    found = _timed(drivers, len(array))
    if not found:
        raise ValueError("function: drivers names no driver; give {name: values}")
    return Function(weight=_weight(weight), output=output, values=array, offset=offset,
                    drivers=found, input_offset=input_offset)
