"""Targets as coordinates: a copy of a mechanism with chains of driven joints to its frames.

A massless chain from the ground to the frame turns a target in space into coordinates. It has
slides along the directions of the frame's motion and, for an orientation, hinges behind them. A
closure joins its end to the frame. Slides and hinges have the values of the target. A component of
a position is one slide with a plane on the point; the angle of a link is one hinge with an axis
perpendicular to the link's.

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
from spatial_pin.assembly.close import close
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.named_targets import AngleValue, PointPart, output_target
from spatial_pin.inverse_kinematics.targets import Position, Target, check_rotations
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import continued_rotation_vectors, spin_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS, closure_geometry, prismatic_joint, revolute_joint
from spatial_pin.mechanism.parts import Closure
from spatial_pin.motion.outputs import component
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# angle of the middle hinge at which a new chain begins [rad]: at pi/2 it is singular, and here the
# outer hinges turn three times as fast as the frame
LEANING = 1.2
ALL = np.eye(3)  # directions of slides along all axes


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints of one target. Courses (3, N, k) are values at the samples and two derivatives."""

    table: TargetTable
    directions: Array  # (3, k) unit vectors of the slides in the world, in columns
    slides: Array  # (3, N, k) course
    hinges: int = 0  # 3 hinges, 1 or none
    axis: Array | None = None  # (3,) of a single hinge, in the axes of the first orientation
    # (3, N, 3) rotation vectors from the first orientation, angular velocities and accelerations in
    # body axes; None without an orientation
    turns: Array | None = None

    @property
    def n(self) -> int:
        """The number of its coordinates."""
        return self.directions.shape[1] + self.hinges

    @property
    def has_closure(self) -> bool:
        """Whether the target can be a coordinate: that of a centre of mass cannot."""
        first = self.table.first
        return first is None or (self.n == 1 and isinstance(first, PointPart | AngleValue))


def chain_of(table: TargetTable, s: Array, rows: Array, mechanism: Mechanism) -> Chain:
    """Return the chain of a target.

    `rows` (r, k) are velocities of the target, in world axes, for the motions at the start.
    """
    length, known = mechanism.characteristic_length, 2.0 * mechanism.extent.resolution
    if table.points is None:
        assert table.values is not None
        values = table.values.reshape(len(s), -1)
        if table.values.ndim > 1:  # of a centre of mass, which may stay in a plane
            directions = _directions(rows, (values - values[0]) / length, known)
            return Chain(table, directions, _course(s, values @ directions))
        if isinstance(table.first, PointPart):
            values = values - mechanism.centre[list(table.first.axes)]
        return Chain(table, np.ones((1, 1)), _course(s, values))
    away = table.points - table.points[0]
    directions = _directions(rows[:3], away / length, known)
    slides = _course(s, away) @ directions
    if table.rotations is None:
        return Chain(table, directions, slides)
    phi = table.turns()
    axes = _directions(rows[3:], phi @ table.rotations[0].T, 0.0)
    hinges = axes.shape[1] if axes.shape[1] < 2 else 3
    axis = table.rotations[0].T @ axes[:, 0] if hinges == 1 else None
    _, rate, bend = _course(s, phi)  # body angular velocity and acceleration follow from it
    return Chain(table, directions, slides, hinges, axis,
                 np.array([phi, *spin_of(phi, rate, bend)]))


def _course(s: Array, values: Array) -> Array:
    """Return the course (3, N, k) of the cubic spline of values (N, k); one sample is constant."""
    from scipy.interpolate import CubicSpline  # imported on use: it takes a tenth of a second

    if len(s) == 1:
        return np.array([values, 0.0 * values, 0.0 * values])
    spline = CubicSpline(s, values)
    return np.array([values, spline(s, 1), spline(s, 2)])


def _directions(rows: Array, away: Array, known: float) -> Array:
    """Return unit vectors (3, k) that velocities span; all three if these do not contain `away`."""
    turned = decompose(rows.T, TOLERANCES.half_precision)
    if turned.rank == 3:
        return ALL
    out = away @ turned.null_space.T
    if np.abs(out).max(initial=0.0) > TOLERANCES.closed + known:
        return ALL
    return turned.vt[: turned.rank].T


def stretches_of(chains: list[Chain], n: int) -> list[tuple[int, Array]]:
    """Return consecutive parts of n samples, each for one copy of the mechanism.

    They have the last sample of one and the first of the next in common.

    Returns:
        The first sample of each, and the course (3, m, k) of all target coordinates over it.
    """
    stretches: list[tuple[int, Array]] = []
    first = 0
    while not stretches or first < n - 1:
        courses = [_joint_course(chain, first) for chain in chains]
        last = n - 1
        for chain, course in zip(chains, courses, strict=True):
            rotations = chain.table.rotations
            if chain.hinges != 3 or rotations is None:
                continue
            # One that leans by more than a right angle seems to lean less; what turns between two
            # samples tells.
            leaning = np.abs(course[0, :, -2])  # of the middle hinge
            turned = rotations[first:-1].transpose(0, 2, 1) @ rotations[first + 1 :]
            cosines = 0.5 * (np.trace(turned, axis1=1, axis2=2) - 1.0)
            steps = np.arccos(np.clip(cosines, -1.0, 1.0))
            beyond = (leaning[1:] > LEANING) | (leaning[:-1] + steps > np.pi - LEANING)
            if beyond.any() and not beyond.argmax():
                raise SpatialPinError(
                    f"target {chain.table.name!r} turns by {steps[0]:.3g} rad from sample {first} "
                    f"to {first + 1}: give placements nearer to each other")
            last = min(last, first + (int(beyond.argmax()) if beyond.any() else len(steps)))
        stretches.append((first, np.concatenate(courses, axis=2)[:, : last - first + 1]))
        first = last
    return stretches


def _joint_course(chain: Chain, first: int) -> Array:
    """Return the course (3, m, k) of the joints of a chain from a sample on, hinges zero there."""
    slides = chain.slides[:, first:]
    if not chain.hinges or chain.turns is None:
        return slides
    turns = chain.turns[:, first:]
    if chain.axis is not None:
        hinges: Array = turns @ chain.axis[:, None]
    else:
        rotations = chain.table.rotations
        assert rotations is not None
        hinges = cardan_course(rotations[first].T @ rotations[first:], turns[1], turns[2])
    return np.concatenate([slides, hinges], axis=2)


def copy_at(
    state: State, chains: list[Chain], first: int, values: Array
) -> tuple[State, list[str]]:
    """Return the closed state of a copy with targets as coordinates, and their names.

    The state is at values (k,) of these, those of the sample `first`.
    """
    mechanism = state.mechanism
    model, names, pairs, closures = mechanism.model.copy(), list[str](), list[str](), []
    for chain in chains:
        name = chain.table.name
        if chain.table.is_coordinate:
            names.append(mechanism.prescribed_coordinate(name).name)
            continue
        if chain.table.first is not None:
            names.append(_free_name(mechanism, model, name))
            pairs += ["revolute" if isinstance(chain.table.first, AngleValue) else "prismatic"]
            closures.append(_output_closure(mechanism, model, chain.table.first, names[-1]))
            continue
        added, end = _joints(mechanism, model, chain, first)
        names += added
        pairs += ["prismatic"] * chain.directions.shape[1] + ["revolute"] * chain.hinges
        kind = "spherical" if chain.table.rotations is None else "weld"
        geometry = closure_geometry(PAIRS[kind])
        closures.append(Closure(f"target of {name}", kind, (end, name), geometry))
    copy = Mechanism(
        mechanism.name, model, pin.GeometryModel(), pin.GeometryModel(), (*mechanism.pairs, *pairs),
        (*mechanism.closures, *closures), springs=mechanism.springs, passives=mechanism.passives)
    # lengths are divided as in the mechanism
    vars(copy)["extent"] = mechanism.extent
    return _closed(copy, state, names, values), names


def _output_closure(
    mechanism: Mechanism, model: pin.Model, target: Target, name: str
) -> Closure:
    """Add the joint of a target of one number; return its closure."""
    at = pin.SE3.Identity()
    end, frame = (_free_name(mechanism, model, f"{x} of {name}") for x in ("target", "point"))
    if isinstance(target, AngleValue):
        angle = target.angle
        kind, moved, offset = "perpendicular", angle.frame, at
        geometry = closure_geometry(PAIRS[kind], angle.aside[1], angle.arm)
        joint = model.addJoint(0, revolute_joint(angle.axis), at, name)
    else:
        assert isinstance(target, PointPart)
        axis = ALL[target.axes[0]]
        kind, moved, offset = "point_on_plane", target.frame, pin.SE3(ALL, target.offset)
        geometry = closure_geometry(PAIRS[kind], axis)
        joint = model.addJoint(0, prismatic_joint(axis), pin.SE3(ALL, mechanism.centre), name)
    model.addFrame(pin.Frame(end, joint, 0, at, pin.FrameType.OP_FRAME))
    own = model.frames[moved]
    model.addFrame(pin.Frame(frame, own.parentJoint, 0, own.placement * offset,
                             pin.FrameType.OP_FRAME))
    return Closure(f"target of {name}", kind, (end, frame), geometry)


def _joints(
    mechanism: Mechanism, model: pin.Model, chain: Chain, first: int
) -> tuple[list[str], str]:
    """Add the joints of a chain and a frame at its end; return their names, and the frame's."""
    table, names, parent = chain.table, list[str](), 0
    assert table.points is not None

    def add(joint: pin.JointModel, placement: pin.SE3, name: str) -> int:
        names.append(_free_name(mechanism, model, f"{table.name}.{name}"))
        return int(model.addJoint(parent, joint, placement, names[-1]))

    here = pin.SE3(np.eye(3), table.points[0])
    letters = "xyz" if chain.directions.shape[1] == 3 else "12"
    for letter, direction in zip(letters, chain.directions.T, strict=False):
        parent, here = add(prismatic_joint(direction), here, letter), pin.SE3.Identity()
    if table.rotations is not None:
        base = first if chain.hinges == 3 else 0
        here = here * pin.SE3(table.rotations[base], np.zeros(3))
    axes = [chain.axis] if chain.hinges == 1 else ALL[: chain.hinges]
    for letter, axis in zip("xyz", axes, strict=False):
        parent, here = add(revolute_joint(axis), here, f"turn_{letter}"), pin.SE3.Identity()
    end = _free_name(mechanism, model, f"target of {table.name}")
    model.addFrame(pin.Frame(end, parent, 0, here, pin.FrameType.OP_FRAME))
    return names, end


def _free_name(mechanism: Mechanism, model: pin.Model, name: str) -> str:
    while (model.existFrame(name) or model.existJointName(name)
           or name in mechanism.coordinate_table or name in mechanism.drivers):
        name += "'"
    return name


def _closed(copy: Mechanism, state: State, names: list[str], values: Array) -> State:
    """Return the state of a copy, closed to round-off at the values of the targets."""
    q = np.append(state.q, np.zeros(copy.model.nq - len(state.q)))
    free = np.ones(copy.model.nv, dtype=bool)
    for name, value in zip(names, values, strict=True):
        coordinate = copy.coordinate_table[name]
        if coordinate.q >= 0:
            q[coordinate.q], free[coordinate.v] = value, False
    with loops_of(copy, state.angles) as evaluation:
        q, error = close(evaluation, q, free, TOLERANCES.round_off)
        return State(copy, q, closure_error=error, angles=evaluation.angles.copy())


STEEP = 10.0  # ratio of a rotation vector's change to the turn: larger only near a whole turn


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


def cardan_course(rotations: Array, omega: Array, alpha: Array) -> Array:
    """Return the course (3, N, 3) of angles a, b, c of rotations Rx(a) Ry(b) Rz(c) (N, 3, 3).

    Angular velocities and accelerations (N, 3) are in body axes.
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
    return np.array([np.column_stack([a, b, c]), rate, bend])


def law_of(s: Array, course: Array) -> Any:
    """Return the piecewise polynomial through a course (3, N, k)."""
    from scipy.interpolate import PPoly  # imported on use: it takes a tenth of a second

    if len(s) == 1:
        return PPoly(course[None, 0], np.append(s, s[0] + 1.0))
    h = np.diff(s)[:, None]
    y, v, a = course[0], course[1], 0.5 * course[2]
    gone = np.diff(y, axis=0) - h * (v[:-1] + h * a[:-1])
    faster = h * (np.diff(v, axis=0) - 2.0 * h * a[:-1])
    bent = h * h * np.diff(a, axis=0)
    c = [(6.0 * gone - 3.0 * faster + bent) / h**5,
         (7.0 * faster - 15.0 * gone - 2.0 * bent) / h**4,
         (10.0 * gone - 4.0 * faster + bent) / h**3, a[:-1], v[:-1], y[:-1]]
    return PPoly(np.array(c), s)
