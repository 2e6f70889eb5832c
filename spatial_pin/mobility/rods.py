"""Rods: links that balls and universal joints hold on one line.

The rest of a mechanism depends on a rod only through that line. So configurations that differ only
by rods turned about their own lines, such as the two readings of a universal joint, are one. A rod
of given length between two points is one distance equation; the core of a mechanism has these
equations instead of its rods.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.compiled_equations import SHORT
from spatial_pin.mechanism.coordinates import with_values
from spatial_pin.mechanism.equations import ConstraintEquation, Cosine
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PairGeometry
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

POINTS = ("spherical", "universal", "distance")  # pairs that hold a link at a point
SLIDES = ("prismatic", "cylindrical")  # pairs that join two links of one rod along its line


class RodLine(NamedTuple):
    """A line fixed in a body: a point (3,) [m] and a unit direction (3,) in its joint's axes."""

    point: Array
    direction: Array


class RodEnd(NamedTuple):
    """A pair on a body, with the other body that it joins.

    Attributes:
        kind: of the pair.
        closure: its name, empty for a joint of the tree.
        joint: that joint, 0 for a closure.
        own, other: bodies by their joints.
        at, there: placement of the pair on them.
    """

    kind: str
    closure: str
    joint: int
    own: int
    other: int
    at: pin.SE3
    there: pin.SE3


class Rod(NamedTuple):
    """A rod, of one link or of several that slide along its line.

    Attributes:
        lines: the line in each of its bodies, by joint.
        ends: the pairs that join it to other bodies.
        slides: the pairs between its own.
    """

    lines: Mapping[int, RodLine]
    ends: tuple[RodEnd, ...]
    slides: tuple[RodEnd, ...]


def rods_of(mechanism: Mechanism) -> list[Rod]:
    """Return the rods of a mechanism."""
    ends = _ends(mechanism)
    rods: list[Rod] = []
    for body in range(1, mechanism.model.njoints):
        if not any(body in rod.lines for rod in rods):
            rod = _rod(ends, body, TOLERANCES.nothing * mechanism.characteristic_length)
            if rod is not None:
                rods.append(rod)
    return rods


def _ends(mechanism: Mechanism) -> list[list[RodEnd]]:
    """Return the pairs of every body, without floating joints."""
    model, free = mechanism.model, pin.SE3.Identity()
    ends: list[list[RodEnd]] = [[] for _ in range(model.njoints)]

    def add(kind: str, closure: str, joint: int, *sides: tuple[int, pin.SE3]) -> None:
        for (own, at), (other, there) in (sides, sides[::-1]):
            ends[own].append(RodEnd(kind, closure, joint, own, other, at, there))

    for i, kind in enumerate(mechanism.pairs, start=1):
        if kind != "floating":
            add(kind, "", i, (i, free), (int(model.parents[i]), model.jointPlacements[i]))
    for closure in mechanism.closures:
        for name in closure.joints:
            i = mechanism.joint_id(mechanism.coordinate(name).joint)
            add("coordinate", closure.name, 0, (i, free), (int(model.parents[i]), free))
        whole = closure.equations is None and not closure.joints and len(closure.joined) == 1
        for frames in closure.joined:
            add(closure.type if whole else "part", closure.name, 0,
                *(mechanism.frame_on_joint(f) for f in frames))
    return [[_aligned(mechanism, end) for end in own] for own in ends]


def _aligned(mechanism: Mechanism, end: RodEnd) -> RodEnd:
    """Return a slide with z along its axis on both sides; other ends as they are."""
    if end.kind not in SLIDES:
        return end
    if end.closure:
        geometry = next(c for c in mechanism.closures if c.name == end.closure).geometry
        frames = next(c for c in mechanism.closures if c.name == end.closure).frames
        axes = [geometry.axes1, geometry.axes2]
        if mechanism.frame_on_joint(frames[0])[0] != end.own:
            axes.reverse()
    else:
        joint = mechanism.model.joints[end.joint]
        own = joint.createData()
        joint.calc(own, mechanism.neutral)
        subspace = np.array(own.S).reshape(6, -1)
        axis = subspace[:3, np.linalg.norm(subspace[:3], axis=0).argmax()]
        axes = [pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()] * 2
    turned = [pin.SE3(rotation, np.zeros(3)) for rotation in axes]
    return end._replace(at=end.at * turned[0], there=end.there * turned[1])


def _rod(ends: list[list[RodEnd]], body: int, limit: float) -> Rod | None:
    """Return the rod of a body; None if it is not in one."""
    bodies, outer, inner = [body], [], []
    for own in bodies:  # grows
        for end in ends[own]:
            if end.kind in SLIDES and end.other:
                inner.append(end)
                if end.other not in bodies:
                    bodies.append(end.other)
            elif end.kind in POINTS:
                outer.append(end)
            else:
                return None
    if not outer or any(end.other in bodies for end in outer):
        return None
    lines = _lines(outer, inner, limit)
    if lines is None or any(_off(lines[end.own], end.at.translation) > limit for end in outer):
        return None
    return Rod(lines, tuple(outer), tuple(inner))


def _lines(outer: list[RodEnd], inner: list[RodEnd], limit: float) -> dict[int, RodLine] | None:
    """Return the line in every body of a rod; None without such a line."""
    first, point = outer[0].own, outer[0].at.translation
    if inner:
        along = next(end.at.rotation[:, 2] for end in inner if end.own == first)
    else:
        arms = [end.at.translation - point for end in outer]
        arm = max(arms, key=lambda x: float(np.linalg.norm(x)))
        if np.linalg.norm(arm) <= limit:
            return None
        along = arm / np.linalg.norm(arm)
    lines = {first: RodLine(point, along)}
    for end in inner * len(inner):  # from body to body
        if end.own not in lines:
            continue
        line, over = lines[end.own], end.there * end.at.inverse()
        there = RodLine(over.act(line.point), over.rotation @ line.direction)
        if (np.linalg.norm(np.cross(end.at.rotation[:, 2], line.direction)) > TOLERANCES.nothing
                or (end.kind == "cylindrical" and _off(line, end.at.translation) > limit)
                or _off(lines.setdefault(end.other, there), there.point) > limit):
            return None
    return lines


def _off(line: RodLine, point: Array) -> float:
    return float(np.linalg.norm(np.cross(point - line.point, line.direction)))


# ---------------------------------------------------------------- the core of a mechanism


class Aligned(Closure):
    """A closure whose axes must point the same way: a mirror image leaves its last rows open.

    Where axes point the same way these rows have no derivative; they change nothing there.
    """

    @cached_property
    def rows(self) -> tuple[ConstraintEquation, ...]:
        """Its scalar equations, and cosine one for each pair of axes."""
        axes = ["xyz".index(axis) for axis in self.pair.aligned]
        both = ((self.geometry.axes1[:, k], self.geometry.axes2[:, k]) for k in axes)
        return (*super().rows, *(ConstraintEquation(((1.0, (Cosine(u, w),)), (-1.0, ())))
                                 for u, w in both))


class Core(NamedTuple):
    """A mechanism without its rods of given length, and without fixed joints.

    Attributes:
        mechanism: with a distance for each of these rods.
        rods: these rods.
        joints: the remaining joints, by their numbers in the whole mechanism.
    """

    mechanism: Mechanism
    rods: tuple[Rod, ...]
    joints: tuple[int, ...]

    def whole(self, mechanism: Mechanism, base: Array, q: Array) -> Array:
        """Return `base` (nq,) of the whole mechanism with the core's joints as in q."""
        whole, model, core = base.copy(), mechanism.model, self.mechanism.model
        for k, i in enumerate(self.joints, start=1):
            whole[model.idx_qs[i] : model.idx_qs[i] + model.nqs[i]] = (
                q[core.idx_qs[k] : core.idx_qs[k] + core.nqs[k]])
        return whole


def core_of(mechanism: Mechanism, held: Mapping[str, float], rods: list[Rod]) -> Core:
    """Return the core of a mechanism with fixed coordinates.

    Rods, from `rods_of`, are removed if their length is given.
    """
    model = mechanism.model
    q = with_values(mechanism, mechanism.neutral, held)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    shortest = SHORT * mechanism.characteristic_length
    out, distances = [], []
    for rod in rods:
        ends = _of_given_length(mechanism, rod, held)
        if ends:
            one, two = (data.oMi[end.own].act(end.at.translation) for end in ends)
            if (length := float(np.linalg.norm(two - one))) > shortest:
                out.append(rod)
                distances.append((ends, length))
    gone = {i for rod in out for i in rod.lines}
    # joints whose coordinates are all held, those of couplings apart
    coupled = {mechanism.coordinate(name).joint for c in mechanism.closures for name in c.joints}
    free = {c.joint for c in mechanism.coordinate_table.values() if c.name not in held}
    locked = {i for i, name in enumerate(model.names)
              if i and name not in free and name not in coupled and i not in gone}
    small, poses, joints = _without(model, data, locked, gone)
    names = {f for c in mechanism.closures for f in (*c.frames, *c.between)}
    for name in sorted(names):
        body, placement = mechanism.frame_on_joint(name)
        if body not in gone:
            at, on = poses[body]
            small.addFrame(pin.Frame(name, at, 0, on * placement, pin.FrameType.OP_FRAME))
    removed = {end.closure for rod in out for end in rod.ends}
    is_rounded = mechanism.whole is not None  # its axes are parallel to some digits only
    closures = [c if is_rounded or not c.pair.aligned or c.numbers else Aligned(
        c.name, c.type, c.frames, c.geometry, equations=c.equations)
        for c in mechanism.closures if c.name not in removed]
    for k, (ends, length) in enumerate(distances):
        frames = (f"{k} of rods", f"{k} of rods, other end")
        for name, end in zip(frames, ends, strict=True):
            at, on = poses[end.other]
            small.addFrame(pin.Frame(name, at, 0, on * end.there, pin.FrameType.OP_FRAME))
        closures.append(Closure(f"rod {k}", "distance", frames,
                                PairGeometry(np.eye(3), np.eye(3), length)))
    core = Mechanism(mechanism.name, small, pin.GeometryModel(), pin.GeometryModel(),
                     tuple(mechanism.pairs[i - 1] for i in joints), tuple(closures))
    # lengths are divided as in the whole mechanism
    vars(core)["extent"] = mechanism.extent
    return Core(core, tuple(out), tuple(joints))


def _of_given_length(
    mechanism: Mechanism, rod: Rod, held: Mapping[str, float]
) -> tuple[RodEnd, ...]:
    """Return the two ends of a rod that is one distance equation, else ().

    At least one end is a ball: the rod may take any direction, and turn freely.
    """
    ends, model = rod.ends, mechanism.model
    kinds = sorted(end.kind for end in ends)
    if kinds not in (["spherical", "spherical"], ["spherical", "universal"]):
        return ()
    if ends[0].other == ends[1].other or not all(
            end.kind == "prismatic" and end.joint and model.names[end.joint] in held
            for end in rod.slides):
        return ()
    names = {model.names[i] for i in rod.lines} - {model.names[end.joint] for end in rod.slides}
    if any(mechanism.coordinate_table[name].joint in names for name in held):
        return ()
    roots = [i for i in rod.lines if int(model.parents[i]) not in rod.lines]
    hanging = [end for end in ends if end.joint]
    if len(roots) != 1 or any(end.joint != end.own for end in hanging):
        return ()  # it carries something, or hangs together by a closure
    is_loose = mechanism.pairs[roots[0] - 1] == "floating"
    return ends if is_loose != bool(hanging) else ()


def _without(
    model: pin.Model, data: pin.Data, locked: set[int], gone: set[int]
) -> tuple[pin.Model, dict[int, tuple[int, pin.SE3]], list[int]]:
    """Return a tree without some joints, the place of each body in it, and the remaining joints."""
    out, joints = pin.Model(), []
    poses = {0: (0, pin.SE3.Identity())}
    for i in (i for i in range(1, model.njoints) if i not in gone):
        at, on = poses[int(model.parents[i])]
        on = on * model.jointPlacements[i]
        if i in locked:
            own = data.oMi[int(model.parents[i])] * model.jointPlacements[i]
            poses[i] = at, on * own.actInv(data.oMi[i])
            continue
        joints.append(i)
        k = out.addJoint(at, model.joints[i].extract(), on, model.names[i])
        poses[i] = k, pin.SE3.Identity()
    return out, poses, joints
