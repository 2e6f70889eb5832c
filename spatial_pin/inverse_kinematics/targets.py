"""Targets in space: positions, orientations, directions, distances, coordinates, centre of mass.

Residuals of targets have no unit: lengths are divided by the characteristic length, angles are in
radians. To add a kind of target: a class with `residual`, and its line in the constructors below.

Example:
    >>> mech = sp.load("delta")
    >>> wish = sp.targets.position([0.1, 0.0, -0.9], weight=2.0)  # as near as possible [m]
    >>> state = sp.reach(mech, {"platform": wish, "arm_1": -0.3})  # exactly [rad]
    >>> print(f"{state.coordinate('arm_1').value:.3f} rad")
    -0.300 rad
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import (
    checked,
    finite_array,
    finite_number,
    positive_number,
    unit_vector,
)
from spatial_pin._support.columns import XYZ
from spatial_pin.assembly.state import mass_shares
from spatial_pin.kernel.closer import (
    DIRECTION,
    DISTANCE,
    POINT,
    TURN,
    VALUE,
    KernelTarget,
)
from spatial_pin.kernel.kernel import frame_in_kernel
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_gradient, coordinate_value
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

__all__ = [
    "centre_of_mass", "coordinate", "direction", "distance", "orientation", "pose", "position",
]
ALL_AXES = 7  # of a position, in bits
Residual = tuple[Array, Array]  # (k,), and its derivative (k, nv) for joint velocities


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True, eq=False)
class Target(ABC):
    """A target of `reach` or a measured quantity: a frame, distance or coordinate, and its value.

    Attributes:
        name: frame or coordinate; set from the key of the target.
        weight: None: exact; else its weight [-]: the sum of weight² residual² of all weighted
            targets is least, as far as the exact ones allow.

    Example:
        >>> mech = sp.load("delta")
        >>> wish = sp.targets.position([0.5, 0.0, -0.9], weight=1.0)  # [m]
        >>> state = sp.reach(mech, {"platform": wish, "arm_1": -0.4})
        >>> print(f"{state.coordinate('arm_1').value:.3f} rad")
        -0.400 rad
    """

    name: str = ""
    weight: float | None = None

    @abstractmethod
    def residual(self, evaluation: LoopEquations) -> Residual:
        """Return the error of its value, and the derivative, at the last `update`."""

    def pulled(self, evaluation: LoopEquations, forces: Array) -> tuple[Array, Array]:
        """Return the sum (nv,) of forces times derivatives, and forces of other residuals.

        Args:
            evaluation: the equations, at the last `update`.
            forces: one for each of the residuals, and those of other targets after them.
        """
        rows = self.residual(evaluation)[1]
        return forces[: len(rows)] @ rows, forces[len(rows) :]

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """Return it as the kernel takes it; None for a kind that the kernel does not know."""
        return None

    def check(self, mechanism: Mechanism) -> None:
        """Refuse names that the mechanism does not have.

        Raises:
            UnknownNameError: it has none of that name.
        """
        mechanism.frame_id(self.name)

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """Yield its quantities in words, with their values, to find contradictions."""
        return ()

    def lengths(self, mechanism: Mechanism) -> int | None:
        """Return how many residuals, the first ones, are lengths; None if all are.

        They are relative to the characteristic length; the others are in rad.
        """
        return None


def _components(what: str, point: Iterable[float | None]) -> Iterable[tuple[str, float]]:
    """Yield the components of a point in words, with their values."""
    for axis, value in zip(XYZ, point, strict=True):
        if value is not None:
            yield f"{axis} of {what}", float(value)


def _frame(evaluation: LoopEquations, name: str) -> tuple[pin.SE3, Array]:
    """Return a frame's placement, and its Jacobian (6, nv) at its origin in world axes."""
    frame = evaluation.mechanism.frame_id(name)
    return evaluation.frame(frame), evaluation.frame_jacobian(frame)


def _offset(evaluation: LoopEquations, at: pin.SE3, slope: Array, point: Array) -> Residual:
    mechanism = evaluation.mechanism
    size = mechanism.characteristic_length
    return (at.translation - (point - mechanism.centre)) / size, slope[:3] / size


def _turn(at: pin.SE3, slope: Array, rotation: Array) -> Residual:
    turned = rotation.T @ at.rotation
    return pin.log3(turned), pin.Jlog3(turned) @ at.rotation.T @ slope[3:]


def _placed_target(mechanism: Mechanism, name: str, point: Array) -> KernelTarget:
    """Return the target of the origin of a frame (3,) for the kernel."""
    joint, _, origin = frame_in_kernel(mechanism, mechanism.frame_id(name))
    return (POINT, joint, 0, ALL_AXES), origin + (point - mechanism.centre).tolist()


def _turned_target(mechanism: Mechanism, name: str, rotation: Array) -> KernelTarget:
    """Return the target of the axes of a frame (3, 3) for the kernel."""
    joint, axes, _ = frame_in_kernel(mechanism, mechanism.frame_id(name))
    return (TURN, joint, 0, 0), axes + rotation.T.ravel().tolist()


@dataclass(frozen=True, eq=False, kw_only=True)
class Position(Target):
    """The origin of a frame at a point of the world."""

    point: Array

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`."""
        return [_placed_target(mechanism, self.name, self.point)]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`."""
        return _offset(evaluation, *_frame(evaluation, self.name), self.point)

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        yield from _components(f"the origin of {self.name!r}", self.point)


@dataclass(frozen=True, eq=False, kw_only=True)
class Orientation(Target):
    """The axes of a frame along given directions of the world."""

    rotation: Array

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`."""
        return [_turned_target(mechanism, self.name, self.rotation)]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: the logarithm of the rotation from the target to the frame."""
        return _turn(*_frame(evaluation, self.name), self.rotation)

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        yield f"the orientation of {self.name!r}", self.rotation

    def lengths(self, mechanism: Mechanism) -> int:
        """See `Target`."""
        return 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Pose(Target):
    """A frame at a placement in the world."""

    placement: pin.SE3

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`."""
        at = self.placement
        return [_placed_target(mechanism, self.name, at.translation),
                _turned_target(mechanism, self.name, at.rotation)]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: those of `Position`, then those of `Orientation`."""
        at, slope = _frame(evaluation, self.name)
        parts = [_offset(evaluation, at, slope, self.placement.translation),
                 _turn(at, slope, self.placement.rotation)]
        return np.concatenate([r for r, _ in parts]), np.concatenate([j for _, j in parts])

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        yield from _components(f"the origin of {self.name!r}", self.placement.translation)
        yield f"the orientation of {self.name!r}", self.placement.rotation

    def lengths(self, mechanism: Mechanism) -> int:
        """See `Target`."""
        return 3


@dataclass(frozen=True, eq=False, kw_only=True)
class Direction(Target):
    """An axis of a frame along a direction of the world; the frame may turn about it."""

    axis: Array
    along: Array

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`."""
        joint, axes, _ = frame_in_kernel(mechanism, mechanism.frame_id(self.name))
        axis = self.axis @ np.reshape(axes, (3, 3))
        return [((DIRECTION, joint, 0, 0), [*axis, *self.along, *self._across.ravel()])]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: the angle between them, along two directions normal to the target."""
        frame = evaluation.mechanism.frame_id(self.name)
        axis = evaluation.frame(frame).rotation @ self.axis
        moved = -pin.skew(axis) @ evaluation.frame_jacobian(frame)[3:]
        aside = self._across @ axis
        cosine, sine = float(self.along @ axis), math.hypot(*aside)
        angle = math.atan2(sine, cosine)
        if sine < 1e-8:  # where angle / sine is one to round-off, unless it points the other way
            return (aside if cosine > 0.0 else np.array([np.pi, 0.0])), self._across @ moved
        part, bend = angle / sine, (cosine * angle / sine - 1.0) / (sine * sine)
        return part * aside, part * (self._across @ moved) + bend * np.outer(
            aside, self.along @ moved)

    def lengths(self, mechanism: Mechanism) -> int:
        """See `Target`."""
        return 0

    @cached_property
    def _across(self) -> Array:
        """Two directions (2, 3) normal to the target's."""
        return axes_from_z(self.along)[:, :2].T


@dataclass(frozen=True, eq=False, kw_only=True)
class CoordinateValue(Target):
    """A coordinate or driver at a value."""

    value: float

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`: not of a component of a ball or floating joint."""
        coordinate = mechanism.prescribed_coordinate(self.name)
        if coordinate.q < 0:
            return None
        return [((VALUE, coordinate.q, coordinate.v, 0), [self.value])]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: relative to the coordinate's size."""
        mechanism = evaluation.mechanism
        coordinate = mechanism.prescribed_coordinate(self.name)
        size = mechanism.velocity_scale[coordinate.v]
        value = coordinate_value(mechanism, coordinate, evaluation.q)
        gradient = coordinate_gradient(mechanism, coordinate, evaluation.q)
        return np.array([(value - self.value) / size]), gradient[None] / size

    def check(self, mechanism: Mechanism) -> None:
        """See `Target`."""
        mechanism.prescribed_coordinate(self.name)

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        yield f"coordinate {mechanism.prescribed_coordinate(self.name).name!r}", self.value

    def lengths(self, mechanism: Mechanism) -> int:
        """See `Target`."""
        return int(mechanism.prescribed_coordinate(self.name).unit == "m")


@dataclass(frozen=True, eq=False, kw_only=True)
class Distance(Target):
    """The origins of two frames at a distance from each other."""

    other: str
    length: float

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`."""
        (first, _, one), (second, _, two) = (frame_in_kernel(mechanism, mechanism.frame_id(name))
                                             for name in (self.name, self.other))
        return [((DISTANCE, first, second, 0), [*one, *two, self.length])]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`."""
        first, second = (evaluation.mechanism.frame_id(x) for x in (self.name, self.other))
        size = evaluation.mechanism.characteristic_length
        apart = evaluation.frame(second).translation - evaluation.frame(first).translation
        length = float(np.linalg.norm(apart))
        slope = evaluation.frame_jacobian(second)[:3] - evaluation.frame_jacobian(first)[:3]
        along = apart / length if length > 0.0 else np.eye(3)[0]
        return np.array([(length - self.length) / size]), along[None] @ slope / size

    def check(self, mechanism: Mechanism) -> None:
        """See `Target`."""
        if mechanism.frame_id(self.name) == mechanism.frame_id(self.other):
            raise ValueError(f"target {self.name!r} is a distance from itself: name another frame")

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        first, second = sorted([self.name, self.other])
        yield f"the distance of {first!r} and {second!r}", self.length


@dataclass(frozen=True, eq=False, kw_only=True)
class CentreOfMass(Target):
    """The centre of mass of all moving links at a point; None leaves a coordinate free."""

    point: tuple[float | None, ...]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`."""
        mechanism = evaluation.mechanism
        size = mechanism.characteristic_length
        centre, slope = np.zeros(3), np.zeros((3, mechanism.model.nv))
        for joint, share, lever in mass_shares(mechanism):
            at = evaluation.data.oMi[joint].act(lever)
            moved = evaluation.body_jacobian(joint)
            centre += share * at
            slope += share * (moved[:3] - pin.skew(at) @ moved[3:])
        axes = [k for k, x in enumerate(self.point) if x is not None]
        wanted = np.array([self.point[k] for k in axes], dtype=float) - mechanism.centre[axes]
        return (centre[axes] - wanted) / size, slope[axes] / size

    def check(self, mechanism: Mechanism) -> None:
        """See `Target`."""
        mass_shares(mechanism)

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        yield from _components("the centre of mass", self.point)


# ---------------------------------------------------------------- constructors


def _weight(weight: float | None) -> float | None:
    return None if weight is None else positive_number(weight, "weight")


@checked
def position(point: Array, weight: float | None = None) -> Target:
    """Return the target that a frame's origin is at a point of the world.

    Args:
        point: (3,) where, in the world [m].
        weight: None: exactly; else how much it counts, see `reach`.

    Raises:
        ValueError: a number is not finite, or the weight not positive.

    Example:
        >>> mech = sp.load("delta")
        >>> state = sp.reach(mech, {"platform": sp.targets.position([0.1, 0.0, -0.9])})  # [m]
        >>> state.placement("platform").translation.round(4)
        array([ 0.1,  0. , -0.9])
    """
    return Position(weight=_weight(weight), point=finite_array(point, (3,), "point"))


@checked
def orientation(rotation: Array, weight: float | None = None) -> Target:
    """Return the target that a frame is oriented as a rotation says, wherever it is.

    Args:
        rotation: (3, 3), whose columns are the frame's axes in the world.
        weight: None: exactly; else how much it counts, see `reach`.

    Raises:
        ValueError: it is no rotation, or the weight not positive.

    Example:
        >>> mech = sp.load("stewart")
        >>> tilt = sp.targets.orientation(pin.utils.rotate("x", 0.1))  # (3, 3)
        >>> state = sp.reach(mech, {"platform": tilt})
        >>> pin.rpy.matrixToRpy(state.placement("platform").rotation).round(4)  # [rad]
        array([0.1, 0. , 0. ])
    """
    matrix = finite_array(rotation, (3, 3), "rotation")
    check_rotations(matrix, "rotation")
    return Orientation(weight=_weight(weight), rotation=matrix)


def check_rotations(matrices: Array, what: str) -> None:
    """Refuse matrices (3, 3) or (N, 3, 3) that are not rotations.

    Raises:
        ValueError: one is not a rotation.
    """
    for (a, b, c), (d, e, f), (g, h, i) in matrices.reshape(-1, 3, 3).tolist():
        off = (a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, a * d + b * e + c * f,
               g * g + h * h + i * i - 1.0, a * g + b * h + c * i, d * g + e * h + f * i)
        size = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        if size > 0.0 and max(map(abs, off)) <= TOLERANCES.nothing:
            continue
        raise ValueError(f"{what} is no rotation matrix: its columns are not three axes of length "
                         "one normal to each other, right-handed")


def pose(placement: pin.SE3, weight: float | None = None) -> Pose:
    """Return the target of a frame at a placement in the world.

    Args:
        placement: `pinocchio.SE3` of the frame in the world [m].
        weight: None: exact; else its weight, see `reach`.

    Raises:
        TypeError: it is not a placement.
        ValueError: a number is not finite, or the weight not positive.

    Example:
        >>> mech = sp.load("stewart")
        >>> here = sp.assemble(mech).placement("platform")
        >>> lifted = pin.SE3(here.rotation, here.translation + np.array([0.0, 0.0, 0.02]))  # [m]
        >>> state = sp.reach(mech, {"platform": sp.targets.pose(lifted)})
        >>> print(f"{state.placement('platform').translation[2] - here.translation[2]:.4f} m")
        0.0200 m
    """
    if not isinstance(placement, pin.SE3):
        raise TypeError(f"placement must be a pinocchio.SE3, not {type(placement).__name__}")
    finite_array(placement.homogeneous, (4, 4), "placement")
    check_rotations(placement.rotation, "the rotation of a placement")
    return Pose(weight=_weight(weight), placement=placement)


@checked
def direction(axis: Array, along: Array, weight: float | None = None) -> Target:
    """Return the target that an axis of a frame points along a direction of the world.

    The frame may turn about it.

    Args:
        axis: unit vector (3,) in the frame's axes.
        along: unit vector (3,) in the world's axes.
        weight: None: exactly; else how much it counts, see `reach`.

    Raises:
        ValueError: one is no unit vector, or the weight not positive.

    Example:
        >>> mech = sp.load("stewart")
        >>> tilt = sp.targets.direction([0.0, 0.0, 1.0], [0.6, 0.0, 0.8])  # unit vectors
        >>> state = sp.reach(mech, {"platform": tilt})  # its z axis
        >>> state.placement("platform").rotation[:, 2].round(4)
        array([0.6, 0. , 0.8])
    """
    unit_vector(axis, "axis")
    unit_vector(along, "along")
    return Direction(weight=_weight(weight), axis=np.array(axis, float),
                     along=np.array(along, float))


@checked
def coordinate(value: float, weight: float | None = None) -> Target:
    """Return the target that a coordinate, driver, or other output of one number has a value.

    Args:
        value: [rad or m]; of an angle of a link whole turns more or less do not count.
        weight: None: exactly; else how much it counts, see `reach`.

    Raises:
        ValueError: it is not finite, or the weight not positive.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.reach(mech, {"rocker_pin": sp.targets.coordinate(1.8)})  # [rad]
        >>> print(f"crank at {state.coordinate('crank').value:.4f} rad")
        crank at -0.0543 rad
    """
    return CoordinateValue(weight=_weight(weight), value=finite_number(value, "value"))


@checked
def distance(other: str, length: float, weight: float | None = None) -> Target:
    """Return the target that a frame's origin is at a distance from that of another frame.

    Args:
        other: name of the other link, frame or joint.
        length: between the origins, positive [m].
        weight: None: exactly; else how much it counts, see `reach`.

    Raises:
        ValueError: the length, or the weight, is not positive.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.reach(mech, {"coupler_b": sp.targets.distance("crank", 0.25)})  # [m]
        >>> print(f"crank at {state.coordinate('crank').value:.4f} rad")
        crank at -0.8033 rad
    """
    if not finite_number(length, "length") > 0.0:
        raise ValueError("length must be positive; for frames at one place ask for a position")
    return Distance(weight=_weight(weight), other=other, length=float(length))


def centre_of_mass(
    x: float | None, y: float | None, z: float | None, weight: float | None = None
) -> Target:
    """Return the target that the centre of mass of all moving links is at a point of the world.

    Args:
        x: where [m]; None leaves it free, so that it may be above a line or a plane.
        y: likewise.
        z: likewise.
        weight: None: exactly; else how much it counts, see `reach`.

    Raises:
        ValueError: all three are free, a number is not finite, or the weight not positive.

    Example:
        >>> mech = sp.load("delta")
        >>> aside = sp.targets.centre_of_mass(0.05, 0.0, None)  # x, y, and z as it comes [m]
        >>> state = sp.reach(mech, {"": aside})
        >>> pin.centerOfMass(mech.model, state.data, state.q)[:2].round(4)
        array([0.05, 0.  ])
    """
    point = tuple(None if v is None else finite_number(v, "a coordinate") for v in (x, y, z))
    if not any(v is not None for v in point):
        raise ValueError("a target of the centre of mass has no number")
    return CentreOfMass(weight=_weight(weight), point=point)
