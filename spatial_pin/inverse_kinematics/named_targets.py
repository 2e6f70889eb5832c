"""Targets by name: frames, coordinates, and outputs that say where links are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import finite_array, finite_number
from spatial_pin._support.columns import XYZ
from spatial_pin.assembly.link_angle import ANGLE, LinkAngle, link_angle
from spatial_pin.assembly.state import center_of_mass
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.inverse_kinematics.targets import (
    CentreOfMass,
    CoordinateValue,
    Position,
    Residual,
    Target,
    pose,
)
from spatial_pin.kernel.closer import LINK_ANGLE, POINT, KernelTarget
from spatial_pin.kernel.kernel import frame_in_kernel
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import FRAME_UNITS
from spatial_pin.motion.outputs import (
    COORDINATE_OUTPUTS,
    MASS,
    WHOLE,
    component,
    is_force,
    is_of_whole,
)
from spatial_pin.numerics.linalg import Array, whole_turns
from spatial_pin.numerics.tolerances import TOLERANCES


@dataclass(frozen=True, eq=False, kw_only=True)
class PointPart(Target):
    """Components of the position of a frame's origin, or of a point fixed to it."""

    frame: int  # index in Pinocchio's model
    offset: Array  # (3,) of the point in the frame's axes [m]
    axes: tuple[int, ...]  # numbers of the world's axes
    values: Array  # wanted components [m]

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`."""
        joint, columns, origin = frame_in_kernel(mechanism, self.frame)
        point, wanted = origin + self.offset @ np.reshape(columns, (3, 3)), np.zeros(3)
        wanted[[*self.axes]] = self.values
        return [((POINT, joint, 0, sum(1 << axis for axis in self.axes)),
                 [*point, *(wanted - mechanism.centre)])]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`."""
        mechanism = evaluation.mechanism
        size = mechanism.characteristic_length
        at, moved = evaluation.frame(self.frame), evaluation.frame_jacobian(self.frame)
        arm = at.rotation @ self.offset
        slope = moved[:3] - pin.skew(arm) @ moved[3:]
        axes = list(self.axes)
        values = self.values - mechanism.centre[axes]
        return ((at.translation + arm)[axes] - values) / size, slope[axes] / size

    def check(self, mechanism: Mechanism) -> None:
        """See `Target`: its frame is known."""

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        point = component(self.name)[0].removesuffix(".position")
        whose = point.removesuffix(".com")
        what = "the origin" if whose == point else "the centre of mass"
        for axis, value in zip(self.axes, self.values.tolist(), strict=True):
            yield f"{XYZ[axis]} of {what} of {whose!r}", value


@dataclass(frozen=True, eq=False, kw_only=True)
class AngleValue(Target):
    """The angle of a link about an axis; whole turns do not count."""

    angle: LinkAngle
    value: float  # wanted angle [rad]

    def for_kernel(self, mechanism: Mechanism) -> list[KernelTarget] | None:
        """See `Target`."""
        joint, columns, _ = frame_in_kernel(mechanism, self.angle.frame)
        arm = self.angle.arm @ np.reshape(columns, (3, 3))
        return [((LINK_ANGLE, joint, 0, 0), [*arm, *self.angle.aside.ravel(), self.value])]

    def residual(self, evaluation: LoopEquations) -> Residual:
        """See `Target`: within half a turn."""
        rotation = evaluation.frame(self.angle.frame).rotation
        off = float(self.angle.directed(rotation[None])[0]) - self.value
        off -= whole_turns(off)
        return np.array([off]), self.angle.slope(evaluation)[None]

    def check(self, mechanism: Mechanism) -> None:
        """See `Target`: its frame is known."""

    def wishes(self, mechanism: Mechanism) -> Iterable[tuple[str, Any]]:
        """See `Target`."""
        yield self.name, self.value

    def lengths(self, mechanism: Mechanism) -> int:
        """See `Target`."""
        return 0


def output_target(
    mechanism: Mechanism, name: str, given: Any, weight: float | None = None
) -> Target | None:
    """Return the target for the value of an output; None if the name is not an output.

    Args:
        mechanism: the mechanism.
        name: `NAME.position`, `LINK.com.position`, `com.position`, each alone or followed by `.x`,
            `.y` or `.z`, or `LINK.angle`, `LINK.angle.x`, `.y` or `.z`.
        given: (3,) [m], or a number for one component or an angle [m or rad].
        weight: as for every target.
    """
    if is_coordinate(mechanism, name) or name in mechanism.frame_ids:
        return None
    what = f"target {name!r}"
    angle = link_angle(mechanism, name)
    if angle is not None:
        return AngleValue(name, weight, angle=angle, value=finite_number(given, what))
    point, k = component(name)
    stem, _, kind = point.rpartition(".")
    if kind != "position":
        _check_name(mechanism, name, kind)
        return None
    values = finite_array(given, (3,) if k is None else (), what).reshape(-1)
    axes = (0, 1, 2) if k is None else (k,)
    if is_of_whole(mechanism, name):
        parts = dict(zip(axes, values.tolist(), strict=True))
        return CentreOfMass(name, weight, point=tuple(parts.get(i) for i in range(3)))
    frame = stem.removesuffix(".com")
    if frame == stem and k is None:
        return Position(stem, weight, point=values)
    offset = np.zeros(3) if frame == stem else center_of_mass(mechanism, frame)
    return PointPart(name, weight, frame=mechanism.frame_id(mechanism.placed(frame)),
                     offset=offset, axes=axes, values=values)


def _check_name(mechanism: Mechanism, name: str, kind: str) -> None:
    """Refuse the name of an output without a position or angle, or of an unknown thing."""
    if kind in (*FRAME_UNITS, *COORDINATE_OUTPUTS) or is_force(name) or name == MASS:
        raise SpatialPinError(f"target {name!r}: a target says where something is, as a position, "
                              "an angle or a coordinate; rates are given by solve_rates or times")
    if "." in name:
        known = [f"{n}.{k}" for n in (*mechanism.frame_ids, WHOLE)
                 for k in ("position", ANGLE, *(f"position.{x}" for x in XYZ))]
        raise UnknownNameError("coordinate, driver or output", name,
                               [*mechanism.coordinate_table, *mechanism.drivers, *known],
                               f"mechanism {mechanism.name!r}: ")


def is_coordinate(mechanism: Mechanism, name: str) -> bool:
    """Whether a name is that of a coordinate or driver."""
    return name in mechanism.coordinate_table or name in mechanism.drivers


def is_angle(mechanism: Mechanism, name: str) -> bool:
    """Whether a name is that of the angle of a link."""
    return not is_coordinate(mechanism, name) and link_angle(mechanism, name) is not None


def is_part(mechanism: Mechanism, name: str) -> bool:
    """Whether a name is an output of one number that a target can have."""
    point, k = component(name)
    is_component = k is not None and point.endswith(".position")
    return name not in mechanism.frame_ids and (is_component or is_angle(mechanism, name))


def read_targets(mechanism: Mechanism, targets: Mapping[str, Any]) -> list[Target]:
    """Return targets by name, from Targets, lists of them, points (3,), placements or numbers."""
    if not targets:
        raise ValueError("targets is empty: say where something should be, as {'tip': [x, y, z]}")
    read, wanted = [], dict[str, Any]()
    for name, given in targets.items():
        is_list = isinstance(given, list | tuple) and any(isinstance(x, Target) for x in given)
        for one in given if is_list else [given]:
            target = _named(mechanism, name, one)
            target.check(mechanism)
            read.append(target)
    for target in read if len(read) > 1 else ():
        for words, value in target.wishes(mechanism) if target.weight is None else ():
            before = wanted.setdefault(words, value)
            if before is not value and np.abs(np.subtract(value, before)).max() > (
                    TOLERANCES.closed * (1.0 + np.abs(before).max())):
                raise ValueError(f"targets contradict each other: {words} is wanted at {before} "
                                 f"and at {value}; leave one out, or give one a weight")
    return read


def _named(mechanism: Mechanism, name: str, given: Any) -> Target:
    """Return a target with its name; that of an output with the name of its frame."""
    if isinstance(given, Target):
        target = given if given.name else replace(given, name=name)
        if isinstance(target, CoordinateValue | Position):
            numbers = target.value if isinstance(target, CoordinateValue) else target.point
            return output_target(mechanism, target.name, numbers, target.weight) or target
        return target
    if isinstance(given, pin.SE3):
        return replace(pose(given), name=name)
    is_text, what = isinstance(given, str | bytes), f"target {name!r}"
    shape = () if isinstance(given, float) else np.shape(given)
    if not is_text and shape in ((), (3,)):
        output = output_target(mechanism, name, given)
        if output is not None:
            return output
    is_frame = name in mechanism.frame_ids and not is_coordinate(mechanism, name)
    if shape == () and not (is_frame or is_text):
        return CoordinateValue(name, value=finite_number(given, what))
    if shape == (3,):
        return Position(name, point=finite_array(given, (3,), what))
    raise TypeError(f"target {name!r}: {given!r} is none; a frame has a point (3,) or a "
                    "pinocchio.SE3, a coordinate or another output a number; or give one of "
                    "spatial_pin.targets")
