"""Goals of precision: a frame at points or placements, a coordinate at values.

A goal of precision asks for something at k configurations, its samples: where a frame is, what a
coordinate is. Its residual has no unit: lengths are divided by the characteristic length of the
mechanism at its own dimensions, angles are in radians. A goal may have numbers of its own that are
found with the dimensions: where the drawing of a path is put, from where an output counts.

To add one: a class with `_words`, `_unit`, `width` and `residual`, and its constructor in `goals`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.dimensions.variants import EvaluatedBatch
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, whole_turns

FAR = 10.0  # ratio to the mechanism's size: beyond, a drawing is in pixels or another unit
Slopes = tuple[Array, Array, Array]  # residual (m, r), derivatives (m, r, nv) and (m, r, n_own)


@dataclass(frozen=True, eq=False, kw_only=True)
class Goal(ABC):
    """A goal of `design`.

    Attributes:
        weight: None: it is to be met exactly; else how much it counts [-]: it is met as well as
            those that are to be met exactly leave freedom for, with the least sum of weight²
            residual².

    Example:
        >>> sp.goals.turns("crank").name, sp.goals.path("tip", [0.1, 0.0, 0.2], weight=2.0).weight
        ('full turn of crank', 2.0)
    """

    weight: float | None = None
    _words: ClassVar[str]  # its name, with the wanted number at {0.KEY}
    _unit: ClassVar[str]

    @property
    def name(self) -> str:
        """Name in reports."""
        return self._words.format(self)

    def unit_of(self, mechanism: Mechanism) -> str:
        """Return the unit of its error."""
        return self._unit

    @abstractmethod
    def check(self, mechanism: Mechanism) -> None:
        """Check the goal's names and values on a mechanism.

        Raises:
            UnknownNameError: the mechanism has no frame, coordinate or driver of that name.
            ValueError: the goal does not fit the mechanism.
        """


@dataclass(frozen=True, eq=False, kw_only=True)
class Precision(Goal):
    """A goal at k configurations."""

    # values (k,) of coordinates at the samples; empty: the timing is free
    drivers: Mapping[str, Array] = field(default_factory=dict)
    input_offset: bool = False  # whether the drivers have free zeros
    width: ClassVar[int]  # residuals of a sample

    def __len__(self) -> int:
        """Return the number of configurations."""
        return self.count

    @property
    @abstractmethod
    def count(self) -> int:
        """The number of configurations."""

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of the goal's own unknowns, without zeros of drivers."""
        return ()

    def own_start(self, mechanism: Mechanism) -> Array:
        """Return start values of its own unknowns (n_own,)."""
        return np.zeros(len(self.own_names))

    @abstractmethod
    def residual(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Array:
        """Return residuals (m, r).

        Args:
            bodies: m configurations.
            at: (m,) sample of each.
            own: (n_own,) numbers of its own.
        """

    @abstractmethod
    def slopes(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Slopes:
        """Return residuals and their derivatives for v / `velocity_scale` and for own numbers."""

    @abstractmethod
    def errors(self, residual: Array, mechanism: Mechanism, own: Array) -> Array:
        """Return the error (k,) at each sample in `unit`, from residuals (k, r)."""

    @abstractmethod
    def targets(self, mechanism: Mechanism, own: Array) -> Array:
        """Return the targets in the world, as `Met` has them."""

    def natural(self, mechanism: Mechanism, name: str, value: float) -> float:
        """Return one of its unknowns in its unit; a scale is a factor."""
        if name == "scale":
            return float(np.exp(value))
        if name.startswith("placement."):
            return value * (1.0 if "r" in name[-2:] else mechanism.characteristic_length)
        output = getattr(self, "output", "") if name == "offset" else name.removesuffix(".zero")
        return value * float(mechanism.velocity_scale[mechanism.prescribed_coordinate(output).v])


@dataclass(frozen=True, eq=False, kw_only=True)
class DrawnGoal(Precision):
    """Points or placements in axes of their own, those of the drawing.

    With a free scale, residuals are lengths of the drawing. In lengths of the world, a drawing that
    shrinks to a point would have no error.
    """

    frame: str  # what goes through them
    points: Array  # (k, 3) [m]
    # whether the drawing may be placed anywhere; its numbers are shifts along the axes of the
    # world, relative to the characteristic length, and a rotation vector about the points' centroid
    placement: bool = False
    scale: bool = False  # whether it may have any size; its number is the logarithm of that

    def check(self, mechanism: Mechanism) -> None:
        """See `Goal`."""
        mechanism.frame_id(self.frame)

    @property
    def count(self) -> int:
        """See `Precision`."""
        return len(self.points)

    @property
    def own_names(self) -> tuple[str, ...]:
        """See `Precision`."""
        placed = tuple(f"placement.{x}" for x in ("x", "y", "z", "rx", "ry", "rz"))
        return (*(placed if self.placement else ()), *(("scale",) if self.scale else ()))

    def own_start(self, mechanism: Mechanism) -> Array:
        """See `Precision`: scale 1, or about the mechanism's size if the drawing is far off it."""
        numbers = np.zeros(len(self.own_names))
        if self.scale:
            radius = float(np.linalg.norm(np.std(self.points, axis=0)))
            ratio = 0.5 * mechanism.characteristic_length / (radius or 1.0)
            if radius > 0.0 and not 1.0 / FAR < ratio < FAR:
                numbers[-1] = np.log(ratio)
        return numbers

    def _split(self, own: Array) -> tuple[Array, Array, float]:
        """Return shift (3,), rotation vector (3,) and logarithm of the scale."""
        placed = own[:6] if self.placement else np.zeros(6)
        return placed[:3], placed[3:], float(own[-1]) if self.scale else 0.0

    def drawn(self, mechanism: Mechanism, own: Array) -> tuple[Array, Array]:
        """Return the points (k, 3) in the world [m], and the rotation (3, 3) of the drawing."""
        shift, turn, size = self._split(own)
        centre, rotation = self.points.mean(axis=0), pin.exp3(turn)
        away = np.exp(size) * (self.points - centre) @ rotation.T
        return centre + mechanism.characteristic_length * shift + away, rotation

    def _away(
        self, mechanism: Mechanism, origins: Array, at: NDArray[np.intp], own: Array
    ) -> Array:
        """Return displacements (m, 3) of origins from their points, without unit."""
        points, _ = self.drawn(mechanism, own)
        return (origins - points[at]) / self._size(mechanism, own)

    def _away_slopes(
        self, mechanism: Mechanism, away: Array, moved: Array, at: NDArray[np.intp], own: Array
    ) -> tuple[Array, Array]:
        """Return derivatives of `_away` (m, 3); `moved` (m, 3, nv) are those of the origins."""
        size, (shift, turn, _) = self._size(mechanism, own), self._split(own)
        points, _ = self.drawn(mechanism, own)
        arms = points - self.points.mean(axis=0) - mechanism.characteristic_length * shift
        columns = [np.empty((len(points), 3, 0))]  # of the points, for the own numbers
        if self.placement:
            along = np.broadcast_to(mechanism.characteristic_length * np.eye(3),
                                    (len(points), 3, 3))
            jacobian = pin.Jexp3(-turn)  # of exp(w) for w: the turn that is added, from the left
            spun = np.stack([np.cross(axis, arms) for axis in jacobian.T], axis=2)
            columns += [along, spun]
        if self.scale:
            columns.append(arms[:, :, None])
        drawn = -np.concatenate(columns, axis=2)[at] / size
        if self.scale:
            drawn[:, :, -1] -= away
        return moved / size, drawn

    def _size(self, mechanism: Mechanism, own: Array) -> float:
        return mechanism.characteristic_length * float(np.exp(self._split(own)[2]))


@dataclass(frozen=True, eq=False, kw_only=True)
class PathGoal(DrawnGoal):
    """The origin of a frame at points, in their order."""

    closed: bool = False
    _words, _unit, width = "path of {0.frame}", "m", 3

    def residual(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Array:
        """See `Precision`."""
        return self._away(bodies.mechanism, bodies.origin(self.frame), at, own)

    def slopes(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Slopes:
        """See `Precision`."""
        origin = bodies.origin(self.frame)
        away = self._away(bodies.mechanism, origin, at, own)
        moved = bodies.frame_jacobian(self.frame, origin)[:, :3]
        return (away, *self._away_slopes(bodies.mechanism, away, moved, at, own))

    def targets(self, mechanism: Mechanism, own: Array) -> Array:
        """See `Precision`."""
        return self.drawn(mechanism, own)[0]

    def errors(self, residual: Array, mechanism: Mechanism, own: Array) -> Array:
        """See `Precision`: lengths of the world."""
        return np.linalg.norm(residual, axis=1) * self._size(mechanism, own)


@dataclass(frozen=True, eq=False, kw_only=True)
class PosesGoal(DrawnGoal):
    """A frame at placements, in their order."""

    rotations: Array
    _words, _unit, width = "poses of {0.frame}", "m, rad", 6

    def residual(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Array:
        """See `Precision`: places, then rotation vectors from the target, in its axes."""
        _, rotation = self.drawn(bodies.mechanism, own)
        turned, origin = bodies.frame(self.frame)
        away = self._away(bodies.mechanism, origin, at, own)
        targets = rotation @ self.rotations[at]
        return np.hstack([away, logarithms(targets.transpose(0, 2, 1) @ turned)])

    def slopes(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Slopes:
        """See `Precision`."""
        residual = self.residual(bodies, at, own)
        turned, origin = bodies.frame(self.frame)
        moved = bodies.frame_jacobian(self.frame, origin)
        slopes = np.array([pin.Jlog3(pin.exp3(w)) for w in residual[:, 3:]])
        into = slopes @ turned.transpose(0, 2, 1)  # world axes to those of the frame, and the log
        away, drawn = self._away_slopes(bodies.mechanism, residual[:, :3], moved[:, :3], at, own)
        spun = np.zeros_like(drawn)
        if self.placement:
            spun[:, :, 3:6] = pin.Jexp3(-self._split(own)[1])
        return (residual, np.concatenate([away, into @ moved[:, 3:]], axis=1),
                np.concatenate([drawn, -into @ spun], axis=1))

    def targets(self, mechanism: Mechanism, own: Array) -> Array:
        """See `Precision`."""
        points, rotation = self.drawn(mechanism, own)
        return np.array([pin.SE3(rotation @ turned, point).homogeneous
                         for turned, point in zip(self.rotations, points, strict=True)])

    def errors(self, residual: Array, mechanism: Mechanism, own: Array) -> Array:
        """See `Precision`: lengths of the world in m and angles in rad, the larger of both."""
        distances = np.linalg.norm(residual[:, :3], axis=1) * self._size(mechanism, own)
        return np.maximum(distances, np.linalg.norm(residual[:, 3:], axis=1))


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionGoal(Precision):
    """A coordinate at values, in their order."""

    output: str
    values: Array
    offset: bool = False
    _words, width = "function of {0.output}", 1

    def unit_of(self, mechanism: Mechanism) -> str:
        """See `Goal`."""
        return str(mechanism.prescribed_coordinate(self.output).unit)

    @property
    def count(self) -> int:
        """See `Precision`."""
        return len(self.values)

    @property
    def own_names(self) -> tuple[str, ...]:
        """See `Precision`."""
        return ("offset",) if self.offset else ()

    def residual(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Array:
        """See `Precision`: relative to the coordinate's size, angles without whole turns."""
        coordinate = bodies.mechanism.prescribed_coordinate(self.output)
        zero = own[0] if self.offset else 0.0
        size = bodies.mechanism.velocity_scale[coordinate.v]
        away = bodies.q[:, coordinate.q] - self.values[at] - zero * size
        if coordinate.unit == "rad":
            away = away - whole_turns(away)
        return away[:, None] / size

    def slopes(self, bodies: EvaluatedBatch, at: NDArray[np.intp], own: Array) -> Slopes:
        """See `Precision`."""
        coordinate, m = bodies.mechanism.prescribed_coordinate(self.output), len(bodies.q)
        moved = np.zeros((m, 1, bodies.mechanism.model.nv))
        moved[:, 0, coordinate.v] = 1.0
        return (self.residual(bodies, at, own), moved,
                -np.ones((m, 1, 1)) if self.offset else np.empty((m, 1, 0)))

    def targets(self, mechanism: Mechanism, own: Array) -> Array:
        """See `Precision`."""
        size = mechanism.velocity_scale[mechanism.prescribed_coordinate(self.output).v]
        return self.values + (own[0] * size if self.offset else 0.0)

    def errors(self, residual: Array, mechanism: Mechanism, own: Array) -> Array:
        """See `Precision`."""
        size = mechanism.velocity_scale[mechanism.prescribed_coordinate(self.output).v]
        return np.abs(residual[:, 0]) * size

    def check(self, mechanism: Mechanism) -> None:
        """See `Precision`."""
        own = simple(mechanism, self.output)
        if own in [simple(mechanism, name) for name in self.drivers]:
            raise ValueError(f"function: {self.output!r} is its own driver; name another output")


def simple(mechanism: Mechanism, name: str) -> Any:
    """Return a coordinate with a single entry in q."""
    coordinate = mechanism.prescribed_coordinate(name)
    if coordinate.q < 0:
        raise SpatialPinError(
            f"{name!r} is a component of a ball or floating joint; a goal takes coordinates of "
            "other joints: give poses of the link instead")
    return coordinate


def logarithms(rotations: Array) -> Array:
    """Return rotation vectors (m, 3) of rotations (m, 3, 3)."""
    return np.array([pin.log3(r) for r in rotations]).reshape(-1, 3)
