"""Targets as coordinates: a copy of a mechanism with chains of driven joints to its frames.

A massless chain from the ground to the frame turns a target in space into coordinates. It has
slides along the directions of the frame's motion and, for an orientation, hinges behind them. A
closure joins its end to the frame. Slides and hinges have the values of the target. A component of
a position is one slide with a plane on the point; the angle of a link is one hinge with an axis
perpendicular to the link's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.named_targets import AngleValue, PointPart
from spatial_pin.inverse_kinematics.target_tables import (
    TargetCourse,
    TargetTable,
    cardan_course,
)
from spatial_pin.inverse_kinematics.targets import Target
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import spin_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS, closure_geometry, prismatic_joint, revolute_joint
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# angle of the middle hinge at which a new chain begins [rad]: at pi/2 it is singular, and here the
# outer hinges turn three times as fast as the frame
LEANING = 1.2
# here rates of the outer hinges are three times those of what turns
ALL = np.eye(3)


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints of one target."""

    table: TargetTable
    directions: Array  # (3, k) unit vectors of the slides in the world, in columns
    slides: TargetCourse
    hinges: int = 0  # 3 hinges, 1 or none
    axis: Array | None = None  # (3,) of a single hinge, in the axes of the first orientation
    # (N, 3) rotation vectors from the first orientation, and rates in body axes; None without an
    # orientation
    phi: Array | None = None
    omega: Array | None = None
    alpha: Array | None = None

    @property
    def n(self) -> int:
        """The number of its coordinates."""
        return self.directions.shape[1] + self.hinges

    @property
    def has_closure(self) -> bool:
        """Whether the target can be a coordinate: that of a centre of mass cannot."""
        first = self.table.first
        return first is None or (self.n == 1 and isinstance(first, PointPart | AngleValue))


class ChainSegment(NamedTuple):
    """Consecutive samples on one copy of the mechanism."""

    first: int  # samples, both inclusive
    last: int
    course: TargetCourse  # of all target coordinates, over these samples


def chain_of(table: TargetTable, s: Array, rows: Array, mechanism: Mechanism) -> Chain:
    """Return the chain of a target.

    Args:
        table: the target.
        s: (N,) parameter.
        rows: (r, k) velocities of the target, in world axes, for the motions at the start.
        mechanism: the mechanism of the frame.
    """
    length, known = mechanism.characteristic_length, 2.0 * mechanism.extent.resolution
    if table.points is None:
        assert table.values is not None
        values = table.values.reshape(len(s), -1)
        if table.values.ndim > 1:  # of a centre of mass, which may stay in a plane
            directions = _directions(rows, (values - values[0]) / length, known)
            return Chain(table, directions, TargetCourse.along(s, values @ directions))
        if isinstance(table.first, PointPart):
            values = values - mechanism.centre[list(table.first.axes)]
        return Chain(table, np.ones((1, 1)), TargetCourse.along(s, values))
    away = table.points - table.points[0]
    directions = _directions(rows[:3], away / length, known)
    slides = TargetCourse.along(s, away).turned(directions)
    if table.rotations is None:
        return Chain(table, directions, slides)
    phi = table.turns()
    axes = _directions(rows[3:], phi @ table.rotations[0].T, 0.0)
    hinges = axes.shape[1] if axes.shape[1] < 2 else 3
    axis = table.rotations[0].T @ axes[:, 0] if hinges == 1 else None
    spun = TargetCourse.along(s, phi)  # body angular velocity and acceleration follow from it
    return Chain(table, directions, slides, hinges, axis, phi, *spin_of(phi, spun.rate, spun.bend))


def _directions(rows: Array, away: Array, known: float) -> Array:
    """Return unit vectors (3, k) that velocities span; all three if these do not contain `away`."""
    turned = decompose(rows.T, TOLERANCES.half_precision)
    if turned.rank == 3:
        return ALL
    out = away @ turned.null_space.T
    if np.abs(out).max(initial=0.0) > TOLERANCES.closed + known:
        return ALL
    return turned.vt[: turned.rank].T


def stretches_of(chains: list[Chain], n: int) -> list[ChainSegment]:
    """Return the segments of n samples."""
    segments: list[ChainSegment] = []
    first = 0
    while not segments or first < n - 1:
        courses = [_course(chain, first) for chain in chains]
        last = n - 1
        for chain, course in zip(chains, courses, strict=True):
            rotations = chain.table.rotations
            if chain.hinges != 3 or rotations is None:
                continue
            # One that leans by more than a right angle seems to lean less; what turns between two
            # samples tells.
            leaning = np.abs(course.value[:, -2])  # of the middle hinge
            turned = rotations[first:-1].transpose(0, 2, 1) @ rotations[first + 1 :]
            cosines = 0.5 * (np.trace(turned, axis1=1, axis2=2) - 1.0)
            steps = np.arccos(np.clip(cosines, -1.0, 1.0))
            beyond = (leaning[1:] > LEANING) | (leaning[:-1] + steps > np.pi - LEANING)
            if beyond.any() and not beyond.argmax():
                raise SpatialPinError(
                    f"target {chain.table.name!r} turns by {steps[0]:.3g} rad from sample {first} "
                    f"to {first + 1}: give placements nearer to each other")
            last = min(last, first + (int(beyond.argmax()) if beyond.any() else len(steps)))
        own = slice(0, last - first + 1)
        segments.append(ChainSegment(first, last, TargetCourse(*(
            np.hstack([getattr(c, part)[own] for c in courses])
            for part in ("value", "rate", "bend")))))
        first = last
    return segments


def _course(chain: Chain, first: int) -> TargetCourse:
    """Return the course of all coordinates of a chain with zero hinges at a sample, from there."""
    slides = TargetCourse(chain.slides.value[first:], chain.slides.rate[first:],
                    chain.slides.bend[first:])
    if not chain.hinges:
        return slides
    assert chain.phi is not None and chain.omega is not None and chain.alpha is not None
    if chain.hinges == 1:
        assert chain.axis is not None
        turns = [x[first:] @ chain.axis[:, None] for x in (chain.phi, chain.omega, chain.alpha)]
        hinges = TargetCourse(*turns)
    else:
        assert chain.table.rotations is not None
        rotations = chain.table.rotations
        hinges = cardan_course(rotations[first].T @ rotations[first:], chain.omega[first:],
                               chain.alpha[first:])
    return TargetCourse(*(np.hstack([getattr(slides, part), getattr(hinges, part)])
                    for part in ("value", "rate", "bend")))


def copy_at(
    state: State, chains: list[Chain], stretch: ChainSegment
) -> tuple[State, list[str]]:
    """Return the closed state of a copy with targets as coordinates, and their names.

    Args:
        state: at the first sample of the segment.
        chains: the targets.
        stretch: the segment.
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
        added, end = _joints(mechanism, model, chain, stretch.first)
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
    return _closed(copy, state, names, stretch.course.value[0]), names


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
