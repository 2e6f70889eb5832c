"""Tables of targets: values of frames and coordinates at the samples, and between them.

Positions and coordinates follow cubic splines, orientations the cubic spline of their rotation
vectors from the first one. Every target coordinate has at the samples its value, rate and second
derivative from these. Between samples it follows the polynomial of fifth degree through them, which
is the cubic itself for a position or coordinate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import finite_array, finite_number, mapping
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.named_targets import output_target
from spatial_pin.inverse_kinematics.targets import Position, Target, check_rotations
from spatial_pin.mechanism.coordinates import continued_rotation_vectors
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.outputs import component
from spatial_pin.numerics.linalg import Array

STEEP = 10.0  # ratio of a rotation vector's change to the turn: larger only near a whole turn


@dataclass(frozen=True, eq=False)
class TargetCourse:
    """Values at the samples and their derivatives."""

    value: Array  # (N, k), by the parameter
    rate: Array
    bend: Array

    @classmethod
    def along(cls, s: Array, value: Array) -> TargetCourse:
        """Return the cubic spline through values (N, k); one sample is constant."""
        from scipy.interpolate import CubicSpline  # imported on use: it takes a tenth of a second

        if len(s) == 1:
            return cls(value, np.zeros_like(value), np.zeros_like(value))
        spline = CubicSpline(s, value)
        return cls(value, spline(s, 1), spline(s, 2))

    def turned(self, matrix: Array) -> TargetCourse:
        """Return linear combinations of the values, by the columns of a matrix (k, m)."""
        return TargetCourse(self.value @ matrix, self.rate @ matrix, self.bend @ matrix)


@dataclass(frozen=True, eq=False)
class TargetTable:
    """The targets of a frame or coordinate at all samples."""

    name: str  # of the frame, coordinate or output
    points: Array | None = None  # (N, 3) origins of the frame [m]; None for a coordinate or output
    rotations: Array | None = None  # (N, 3, 3) of the frame; None without an orientation
    # (N,) of a coordinate or output [rad or m], (N, 3) of a centre of mass
    values: Array | None = None
    first: Target | None = None  # of an output, its target at the first sample

    @classmethod
    def of_output(
        cls, mechanism: Mechanism, name: str, given: Any, shape: tuple[int, ...]
    ) -> TargetTable | None:
        """Return the table of an output; None if the name is not an output."""
        is_vector = shape == (3,) and component(name)[1] is None and name.endswith(".position")
        full = np.asarray(given, dtype=float)
        full = full[None] if is_vector or not shape else full
        first = output_target(mechanism, name, full[0])
        if first is None:
            return None
        full = finite_array(full, full.shape, f"target {name!r}")
        if isinstance(first, Position):  # of a frame's origin, by its full name
            return cls(first.name, full)
        return cls(name, values=full, first=first)

    @property
    def is_coordinate(self) -> bool:
        """Whether it belongs to a coordinate."""
        return self.points is None and self.first is None

    def __len__(self) -> int:
        return len(self.points if self.points is not None else self.values)  # type: ignore[arg-type]

    def target(self, k: int) -> Any:
        """Return the target of a sample, for `reach`."""
        if self.points is None:
            assert self.values is not None
            return self.values[k] if self.values.ndim > 1 else float(self.values[k])
        if self.rotations is None:
            return self.points[k]
        return pin.SE3(self.rotations[k], self.points[k])

    def repeated(self, n: int) -> TargetTable:
        """Return it repeated over n samples."""
        points, rotations, values = (None if x is None else np.repeat(x, n, axis=0)
                                     for x in (self.points, self.rotations, self.values))
        return replace(self, points=points, rotations=rotations, values=values)

    def turns(self) -> Array:
        """Return continuous rotation vectors (N, 3) from the first orientation to each."""
        from scipy.spatial.transform import Rotation

        assert self.rotations is not None
        phi = continued_rotation_vectors(
            Rotation.from_matrix(self.rotations[0].T @ self.rotations).as_quat())
        gone = np.linalg.norm(np.diff(phi, axis=0), axis=1)
        if np.any(gone > 0.1) and len(phi) > 1:
            between = self.rotations[:-1].transpose(0, 2, 1) @ self.rotations[1:]
            angles = Rotation.from_matrix(between).magnitude()
            steep = np.flatnonzero((gone > STEEP * angles) & (gone > 0.1))
            if len(steep):
                raise SpatialPinError(
                    f"target {self.name!r}: at sample {steep[0] + 1} it has turned a whole turn "
                    "from its first orientation, and not about one axis, where rotation vectors "
                    "jump; ask for the path in two parts")
        return phi


def targets_at(tables: Iterable[TargetTable], k: int) -> dict[str, Any]:
    """Return the targets of a sample by name, for `reach`."""
    return {table.name: table.target(k) for table in tables}


def tables_of(mechanism: Mechanism, targets: Mapping[str, Any], n_times: int) -> list[TargetTable]:
    """Return tables by name, of equal lengths; single placements and numbers are constant."""
    given = mapping(targets, "targets")
    tables = [_table(mechanism, name, x) for name, x in given.items()]
    if not tables:
        raise ValueError("targets is empty: say where something should be, as {'tip': points}, "
                         "points (N, 3)")
    lengths = {}
    for t, x in zip(tables, given.values(), strict=True):
        is_one = isinstance(x, pin.SE3) if t.rotations is not None else (
            np.ndim(x) == np.ndim(t.target(0)))
        if len(t) > 1 or not is_one:  # else it was given as one placement, point or number
            lengths[t.name] = len(t)
    if len(set(lengths.values())) > 1:
        words = ", ".join(f"{name!r} {n}" for name, n in lengths.items())
        raise ValueError(f"tables of targets differ in length: {words}")
    n = next(iter(lengths.values()), n_times)
    if n == 0:
        raise ValueError("tables of targets have no sample")
    return [t if len(t) == n else t.repeated(n) for t in tables]


def _table(mechanism: Mechanism, name: str, given: Any) -> TargetTable:
    what = f"target {name!r}"
    is_list = np.iterable(given) and not isinstance(given, np.ndarray | str | bytes)
    placements = [given] if isinstance(given, pin.SE3) else list(given) if is_list else []
    if placements and all(isinstance(x, pin.SE3) for x in placements):
        mechanism.frame_id(name)
        full = finite_array([x.homogeneous for x in placements], (len(placements), 4, 4), what)
        check_rotations(full[:, :3, :3], f"a rotation of {what}")
        return TargetTable(name, full[:, :3, 3].copy(), full[:, :3, :3].copy())
    shape = _shape(given)
    if shape and not shape[0]:
        raise ValueError(f"{what} has no sample")
    if shape is None or (len(shape) < 2 and shape != (3,) and _is_point(mechanism, name)):
        raise TypeError(f"{what} is no table: it is points (N, 3), a list of pinocchio.SE3, or "
                        "numbers (N,) of a coordinate or another output")
    of_output = TargetTable.of_output(mechanism, name, given, shape)
    if of_output is not None:
        return of_output
    if shape == (3,) and _is_point(mechanism, name):
        return TargetTable(name, finite_array(given, (3,), what)[None])
    if len(shape) == 2:
        mechanism.frame_id(name)
        return TargetTable(name, finite_array(given, shape, what))
    mechanism.prescribed_coordinate(name)
    values = finite_array(given, shape, what) if shape else [finite_number(given, what)]
    return TargetTable(name, values=np.asarray(values))


def _is_point(mechanism: Mechanism, name: str) -> bool:
    """Whether three numbers of that name are a point: it is a frame, and no coordinate."""
    return name in mechanism.frame_ids and name not in mechanism.coordinate_table and (
        name not in mechanism.drivers)


def _shape(given: Any) -> tuple[int, ...] | None:
    """Return the shape of a number, numbers (N,) or points (N, 3); None for other input."""
    try:
        numbers = np.asarray(given)
    except ValueError:
        return None
    shape = numbers.shape
    if numbers.dtype.kind not in "biuf":  # words and objects are none
        return None
    return shape if len(shape) < 2 or (len(shape) == 2 and shape[1] == 3) else None


def cardan_course(rotations: Array, omega: Array, alpha: Array) -> TargetCourse:
    """Return angles a, b, c (N, 3) of rotations Rx(a) Ry(b) Rz(c) (N, 3, 3), and derivatives.

    Args:
        rotations: from the zero position of the angles.
        omega: (N, 3) angular velocity in body axes.
        alpha: (N, 3) angular acceleration in body axes.
    """
    r = rotations
    a = np.unwrap(np.arctan2(-r[:, 1, 2], r[:, 2, 2]))
    b = np.arctan2(r[:, 0, 2], np.hypot(r[:, 0, 0], r[:, 0, 1]))
    c = np.unwrap(np.arctan2(-r[:, 0, 1], r[:, 0, 0]))
    zero, one = np.zeros_like(a), np.ones_like(a)
    cb, sb, cc, sc = np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    axes = np.array([[cc * cb, sc, zero], [-sc * cb, cc, zero], [sb, zero, one]])
    axes = axes.transpose(2, 0, 1)  # of the turns, in body axes
    rate = np.linalg.solve(axes, omega[..., None])[..., 0]
    _, db, dc = rate.T
    moved = np.array([[-sc * cb * dc - cc * sb * db, cc * dc, zero],
                      [-cc * cb * dc + sc * sb * db, -sc * dc, zero], [cb * db, zero, zero]])
    rest = alpha - (moved.transpose(2, 0, 1) @ rate[..., None])[..., 0]
    bend = np.linalg.solve(axes, rest[..., None])[..., 0]
    return TargetCourse(np.column_stack([a, b, c]), rate, bend)


def law_of(s: Array, course: TargetCourse) -> Any:
    """Return the piecewise polynomial through values, rates and second derivatives."""
    from scipy.interpolate import PPoly  # imported on use: it takes a tenth of a second

    if len(s) == 1:
        still = np.zeros((1, 1, course.value.shape[1])) + course.value
        return PPoly(still, np.append(s, s[0] + 1.0))
    h = np.diff(s)[:, None]
    y, v, a = course.value, course.rate, 0.5 * course.bend
    gone = np.diff(y, axis=0) - h * (v[:-1] + h * a[:-1])
    faster = h * (np.diff(v, axis=0) - 2.0 * h * a[:-1])
    bent = h * h * np.diff(a, axis=0)
    c = [(6.0 * gone - 3.0 * faster + bent) / h**5,
         (7.0 * faster - 15.0 * gone - 2.0 * bent) / h**4,
         (10.0 * gone - 4.0 * faster + bent) / h**3, a[:-1], v[:-1], y[:-1]]
    return PPoly(np.array(c), s)
