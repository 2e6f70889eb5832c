"""Measurements of a mechanism: poses with encoder readings and measured values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import finite_number, mapping, positive_number, rows_of
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.named_targets import read_targets
from spatial_pin.inverse_kinematics.targets import (
    CoordinateValue,
    Distance,
    Orientation,
    Pose,
    Position,
    Target,
)
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_value
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose

UNITS = {"position": "m", "rotation": "rad", "angle": "rad", "length": "m"}  # by kind
ENCODER = ".encoder"  # suffix of encoders in sigma and labels


class MeasuredPose(NamedTuple):
    """A pose with measurements."""

    drivers: Mapping[str, float]  # encoder readings, by driver [rad or m]
    measured: Mapping[str, Any]  # measured values, by name of a frame or coordinate


class Encoder(NamedTuple):
    """An encoder with a reading error, at one pose."""

    pose: int  # number of the pose, from 0
    coordinate: str  # the coordinate that it reads
    sigma: float  # standard deviation [rad or m]
    unit: str  # "rad" or "m"

    @property
    def label(self) -> str:
        """Its name among the measured values."""
        return self.coordinate + ENCODER


@dataclass(frozen=True, eq=False)
class MeasuredQuantity:
    """One measured quantity at one pose."""

    target: Target
    kind: str  # "position", "rotation", "angle" or "length"
    sigma: float  # standard deviation [m or rad]; without one, the unit of the residual

    @classmethod
    def of(
        cls, mechanism: Mechanism, target: Target, sigma: Mapping[str, float] | None
    ) -> MeasuredQuantity:
        """Return a quantity with the given standard deviation, or the unit of its residual."""
        kind = ("position" if isinstance(target, Position) else
                "rotation" if isinstance(target, Orientation) else "length")
        if isinstance(target, CoordinateValue):
            unit = mechanism.prescribed_coordinate(target.name).unit
            kind = "angle" if unit == "rad" else "length"
        quantity = cls(target, kind, 1.0)
        if sigma is None:
            size = mechanism.characteristic_length if UNITS[kind] == "m" else 1.0
            return replace(quantity, sigma=size)
        for name in (*_names(quantity), kind):
            if name in sigma:
                return replace(quantity, sigma=sigma[name])
        raise ValueError(f"sigma says nothing of {target.name!r}: add {kind!r} [{UNITS[kind]}]")

    def error(self, evaluation: LoopEquations, base: pin.SE3 | None) -> tuple[Array, Array]:
        """Return model less measurement (k,) [m, rad], and its derivative (k, nv)."""
        mechanism, size = evaluation.mechanism, 1.0  # what one of the residual stands for
        if isinstance(self.target, CoordinateValue):
            coordinate = mechanism.prescribed_coordinate(self.target.name)
            size = float(mechanism.velocity_scale[coordinate.v])
        elif not isinstance(self.target, Orientation):
            size = mechanism.characteristic_length
        error, slope = in_world(self.target, base).residual(evaluation)
        if base is not None and isinstance(self.target, Position):
            # in the axes of what measures, where moving all together changes nothing
            error, slope = base.rotation @ error, base.rotation @ slope
        return size * error, size * slope

    def base_slope(self, evaluation: LoopEquations, base: pin.SE3) -> Array:
        """Return the derivative (k, 6) of `error` for moving the base: shifts, then turns.

        Both are along the measuring axes; turns are about the base's own origin.
        """
        t = self.target
        if isinstance(t, Position):
            mechanism = evaluation.mechanism
            at = evaluation.frame(mechanism.frame_id(t.name)).translation + mechanism.centre
            return np.hstack([np.eye(3), -pin.skew(base.rotation @ at)])
        if isinstance(t, Orientation):
            there = base.rotation @ evaluation.frame(evaluation.mechanism.frame_id(t.name)).rotation
            slope = pin.Jlog3(t.rotation.T @ there) @ there.T
            return np.hstack([np.zeros((3, 3)), slope])
        return np.zeros((1, 6))

    def labels(self) -> list[str]:
        """Return the names of its numbers."""
        if self.kind in ("position", "rotation"):
            return [f"{self.target.name}.{self.kind}.{x}" for x in "xyz"]
        other = f"-{self.target.other}" if isinstance(self.target, Distance) else ""
        return [self.target.name + other]

    def turned_to(self, mechanism: Mechanism, q: Array) -> MeasuredQuantity:
        """Return the same with an angle in the turn nearest to a configuration's."""
        target = self.target
        if self.kind != "angle" or not isinstance(target, CoordinateValue):
            return self
        here = coordinate_value(mechanism, mechanism.prescribed_coordinate(target.name), q)
        turn = 2.0 * np.pi
        value = target.value + turn * round((here - target.value) / turn)
        return replace(self, target=replace(target, value=value))


def in_world(target: Target, base: pin.SE3 | None) -> Target:
    """Return a target in the axes of the mechanism's world, from the measuring axes."""
    if base is not None and isinstance(target, Position):
        return replace(target, point=base.actInv(target.point))
    if base is not None and isinstance(target, Orientation):
        return replace(target, rotation=base.rotation.T @ target.rotation)
    return target


def read_measurements(
    mechanism: Mechanism, measurements: Iterable[Any], sigma: Mapping[str, float] | None
) -> tuple[list[dict[str, float]], list[list[MeasuredQuantity]]]:
    """Return the drivers' values and the quantities of all poses."""
    if isinstance(measurements, str | Mapping):
        raise TypeError("measurements must be a list [({driver: value}, {frame: what}), ...], not "
                        f"{repr(measurements)[:60]}; `spatial-pin calibrate` reads tables")
    poses = rows_of(measurements, MeasuredPose, "measurement")
    if not poses:
        raise ValueError("measurements is empty: give [({driver: value}, {frame: what}), ...]")
    given = None if sigma is None else {
        name: positive_number(x, f"sigma of {name!r}")
        for name, x in mapping(sigma, "sigma").items()}
    drivers, quantities = [], []
    for i, (read, measured) in enumerate(poses, start=1):
        where = f"measurement {i}"
        drivers.append(_drivers(mechanism, mapping(read, f"the drivers of {where}"), where))
        if not mapping(measured, f"the measured values in {where}"):
            raise ValueError(f"{where}: nothing was measured there")
        targets = [part for t in read_targets(mechanism, measured) for part in _parts(t, where)]
        quantities.append([MeasuredQuantity.of(mechanism, t, given) for t in targets])
    known = {*UNITS, ENCODER[1:], *(n for some in quantities for x in some for n in _names(x)),
             *(name + ENCODER for read in drivers for name in _called(mechanism, read))}
    for name in given or {}:
        if name not in known:
            raise ValueError(f"sigma has {name!r}, which was not measured: it may have "
                             f"{', '.join(sorted(known))}")
    return drivers, quantities


def _called(mechanism: Mechanism, coordinates: Iterable[str]) -> dict[str, str]:
    """Return the coordinate for every name of it, those of its drivers too."""
    own = {name: name for name in coordinates}
    return own | {driver.name: name for driver in mechanism.drivers.values()
                  for name in own if mechanism.coordinate(driver.joint).name == name}


def encoders_of(
    mechanism: Mechanism, drivers: Sequence[Mapping[str, float]],
    sigma: Mapping[str, float] | None,
) -> tuple[Encoder, ...]:
    """Return the encoders that have a standard deviation, pose by pose."""
    encoders = []
    for i, read in enumerate(drivers):
        of: dict[str, float] = dict.fromkeys(read, (sigma or {}).get(ENCODER[1:], 0.0))
        for name, coordinate in _called(mechanism, read).items():
            of[coordinate] = (sigma or {}).get(name + ENCODER, of[coordinate])
        encoders += [Encoder(i, name, float(x), mechanism.coordinate(name).unit)
                  for name, x in of.items() if x]
    return tuple(encoders)


def _drivers(mechanism: Mechanism, read: Mapping[str, Any], where: str) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, value in read.items():
        coordinate = mechanism.driven_coordinate(name).name
        if coordinate in values:
            raise ValueError(f"{where}: {coordinate!r} is given two values")
        values[coordinate] = finite_number(value, f"{where}: driver {name!r}")
    for name, driver in mechanism.drivers.items():
        if mechanism.coordinate(driver.joint).name not in values:
            raise ValueError(f"{where}: driver {name!r} has no value; give what its encoder read")
    return values


def _parts(target: Target, where: str) -> list[Target]:
    """Return a target as parts with one kind of number each."""
    if target.weight is not None:
        raise ValueError(f"{where}: {target.name!r} has a weight; say how well it was measured in "
                         "sigma")
    if isinstance(target, Pose):
        at = target.placement
        return [Position(target.name, point=at.translation),
                Orientation(target.name, rotation=at.rotation)]
    if isinstance(target, Position | Orientation | CoordinateValue | Distance):
        return [target]
    raise TypeError(f"{where}: {target.name!r} is a {type(target).__name__}, which calibration "
                    "does not take: measure points, placements, coordinates or distances")


def _names(quantity: MeasuredQuantity) -> tuple[str, str]:
    """Return the keys of a quantity's own standard deviation."""
    return f"{quantity.target.name}.{quantity.kind}", quantity.target.name


def base_from(pairs: Sequence[tuple[Target, pin.SE3]]) -> pin.SE3:
    """Return a start value of the base, from measured and predicted frames.

    Its rotation is a measured one, else the best of the points [GolubVanLoan2013, 6.4.1]; its
    translation is that of the points' means.
    """
    points = [(t.point, at.translation) for t, at in pairs if isinstance(t, Position)]
    turns = [t.rotation @ at.rotation.T for t, at in pairs if isinstance(t, Orientation)]
    if not points and not turns:
        raise SpatialPinError("base: neither a point nor a placement was measured, so that nothing "
                              "tells where the base is")
    if not points:
        return pin.SE3(turns[0], np.zeros(3))
    seen, own = (np.array(x) for x in zip(*points, strict=True))
    if turns:
        rotation = turns[0]
    else:
        svd = decompose((own - own.mean(axis=0)).T @ (seen - seen.mean(axis=0)))
        v = svd.vt.T
        mirror = np.diag([1.0, 1.0, np.linalg.det(v @ svd.u.T)])
        rotation = v @ mirror @ svd.u.T
    return pin.SE3(rotation, seen.mean(axis=0) - rotation @ own.mean(axis=0))
