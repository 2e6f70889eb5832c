"""URDF and xacro to a Pinocchio model whose joints are the pairs that URDF cannot name.

Pinocchio's own reader builds the model; what it accepts silently (a link with two parents, mass
below zero, NaN) is refused before, and afterwards the model is rebuilt joint by joint, same
numbering, with the refined joints in place. Angles of `continuous` joints become one coordinate,
so that they count turns.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.linalg import Array
from spatial_pin.mechanism.inertia import put_inertias
from spatial_pin.mechanism.meshes import Shapes, put_stand_ins, take_meshes
from spatial_pin.mechanism.pairs import JOINT_TYPES, PAIRS, Pair
from spatial_pin.mechanism.urdf_checks import check_joint, check_links, check_structure, numbers
from spatial_pin.mechanism.xacro_files import parse_xml

CONTAINED_PAIRS = {  # URDF type -> pairs that a refinement may make of it
    "floating": JOINT_TYPES,
    "planar": ("planar", "revolute", "prismatic", "fixed"),
    "continuous": ("revolute", "fixed"),
    "revolute": ("revolute", "fixed"),
    "prismatic": ("prismatic", "fixed"),
    "fixed": ("fixed",),
}
PAIR_OF_URDF_TYPE = {"continuous": "revolute"}
RESISTANCES = ("damping", "friction", "armature", "slip_speed")  # of `[joints.X]`


@dataclass(frozen=True, eq=False)
class JointRefinement:
    """What a mechanism file says of a URDF joint.

    Attributes:
        type: a name of `PAIRS`; None for that of the URDF.
        axis: (3,) unit vector in the joint frame, None for the default.
        axis2: (3,) unit vector, second pin of a universal joint.
        lead: translation per turn of a screw [m].
        resistances: some of `RESISTANCES`, a number for all coordinates or one for each.
        where: file and table, for errors.
    """

    type: str | None = None
    axis: Array | None = None
    axis2: Array | None = None
    lead: float = 0.0
    resistances: Mapping[str, Array] = field(default_factory=dict)
    where: str = ""


@dataclass(frozen=True, eq=False)
class Tree:
    """The open tree of a mechanism.

    Attributes:
        model: Pinocchio model with the refined joints.
        shapes: what is drawn and what collides, same joint numbering.
        pairs: pair name of every joint of the model, in the order of `model.joints[1:]`.
        inertias: inertia of every link that has one, in the link's frame.
        mimics: (mimicking joint, mimicked joint, multiplier, offset).
        urdf: the expanded URDF text.
        slip_speeds: (nv,) speeds at which dry friction is nearly whole; NaN where none is given.
    """

    model: pin.Model
    shapes: Shapes
    pairs: tuple[str, ...]
    inertias: dict[str, pin.Inertia]
    mimics: tuple[tuple[str, str, float, float], ...]
    urdf: str
    slip_speeds: Array


def tree_of(urdf: str, path: Path, refinements: Mapping[str, JointRefinement]) -> Tree:
    """Build the open tree of plain URDF text; `path` is where it comes from.

    Raises:
        MechanismFileError: it is not a tree, or has impossible numbers.
    """
    robot = parse_xml(urdf, path)
    check_structure(robot, path)
    inertias = check_links(robot, path)
    mimics = _mimics(robot, path)
    pairs = _joint_pairs(robot, refinements, path)
    for joint in robot.findall("joint"):
        check_joint(joint, f"{path}: joint {joint.get('name')!r}")
    meshes = take_meshes(robot, path)
    text = ET.tostring(robot, encoding="unicode")
    if meshes:
        urdf = text  # with absolute paths, so that it can be exported to another folder
        put_stand_ins(robot)
        text = ET.tostring(robot, encoding="unicode")
    try:
        model = pin.buildModelFromXML(text)
    except Exception as error:
        reason = " ".join(str(error).split())
        raise MechanismFileError(f"{path}: Pinocchio cannot read it: {reason}") from error
    elements = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    rebuilt = _rebuild(model, pairs, elements, refinements, path)
    slip_speeds = _resist(rebuilt, refinements)
    try:
        put_inertias(rebuilt, inertias)
    except (RuntimeError, ValueError) as error:
        raise MechanismFileError(
            f"{path}: inertias leave the range of numbers: it is too large or too heavy"
        ) from error
    order = tuple(pairs[name] for name in list(rebuilt.names)[1:])
    shapes = Shapes(rebuilt, text, meshes, str(path))
    return Tree(rebuilt, shapes, order, inertias, mimics, urdf, slip_speeds)


# ---------------------------------------------------------------- joints


def _joint_pairs(
    robot: ET.Element, refinements: Mapping[str, JointRefinement], path: Path
) -> dict[str, str]:
    """Return the pair of every joint; refinements URDF can express are written into `robot`."""
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    for name in refinements:
        if name not in joints:
            raise MechanismFileError(
                f"{path}: joints.{name}: the URDF has no such joint; {suggestion(name, joints)}"
            )
    pairs = {}
    for name, joint in joints.items():
        kind = joint.get("type", "")
        if kind not in CONTAINED_PAIRS:
            raise MechanismFileError(
                f"{path}: joint {name!r}: URDF has no joint type {kind!r}; "
                f"{suggestion(kind, CONTAINED_PAIRS)} (write type=\"floating\" and name the pair "
                "in the .toml file for spherical, universal, cylindrical and screw)"
            )
        refined = refinements.get(name)
        pair = refined.type if refined else None
        if pair and pair not in CONTAINED_PAIRS[kind]:
            raise MechanismFileError(
                f"{path}: joint {name!r} is {kind} in the URDF, which does not contain a "
                f"{pair} pair; make it \"floating\" there"
            )
        pairs[name] = pair or PAIR_OF_URDF_TYPE.get(kind, kind)
        if refined and refined.resistances and pairs[name] == "fixed":
            raise MechanismFileError(
                f"{refined.where}: {next(iter(refined.resistances))}: joint {name!r} is fixed and "
                "has nothing that could resist; take the key out"
            )
        if pairs[name] == "fixed":
            joint.set("type", "fixed")
    return pairs


def _rebuild(
    model: pin.Model,
    pairs: Mapping[str, str],
    elements: Mapping[str, ET.Element],
    refinements: Mapping[str, JointRefinement],
    path: Path,
) -> pin.Model:
    """Return a copy of `model` with every joint replaced by the model of its pair."""
    new = pin.Model()
    new.name, new.gravity = model.name, model.gravity
    for i in range(1, model.njoints):
        name = model.names[i]
        pair = PAIRS[pairs[name]]
        where = f"{path}: joint {name!r}"
        axis, axis2 = joint_axes(pair, elements[name], refinements.get(name), where)
        lead = refinements[name].lead if name in refinements else 0.0
        assert pair.joint is not None
        joint = pair.joint(axis, axis2, lead)
        same = elements[name].get("type") in ("revolute", "prismatic") and joint.nq == 1
        limits = (_copied_limits(model, i) if same
                  else _read_limits(elements[name], joint.nq, joint.nv))
        new.addJoint(model.parents[i], joint, model.jointPlacements[i], name, *limits)
    new.lowerVelocityLimit = -new.upperVelocityLimit  # addJoint of Pinocchio 4.1 stores the upper
    for frame in list(model.frames)[1:]:
        new.addFrame(frame, False)
    return new


def joint_axes(
    pair: Pair, element: ET.Element, refined: JointRefinement | None, where: str
) -> tuple[Array, Array]:
    """Return the unit axes of a tree joint: the mechanism file's, else the URDF's, else default."""
    tag = element.find("axis")
    if refined is not None and refined.axis is not None:
        axis = refined.axis
    elif tag is not None and pair.uses_axis:
        axis = numbers(tag, "xyz", 3, where)
        if np.linalg.norm(axis) < 1e-12:
            raise MechanismFileError(f"{where}: <axis> is zero")
    elif pair.uses_axis and element.get("type") != "floating":
        axis = np.array([1.0, 0.0, 0.0])  # URDF's default
    else:
        axis = np.array(pair.axis)
    axis2 = refined.axis2 if refined and refined.axis2 is not None else np.array([0.0, 1.0, 0.0])
    axis = axis / np.linalg.norm(axis)
    kind = refined.type if refined is not None else None
    if element.get("type") == "planar" and kind not in (None, "planar"):
        _check_within_plane(str(kind), axis, tag, where)
    if pair.uses_axis2:
        axis2 = axis2 / np.linalg.norm(axis2)
        if abs(axis @ axis2) > 1e-9:
            raise MechanismFileError(
                f"{where}: the pins {axis} and {axis2} of a universal joint must be perpendicular"
            )
    return axis, axis2


def _check_within_plane(kind: str, axis: Array, tag: ET.Element | None, where: str) -> None:
    normal = numbers(tag, "xyz", 3, where) if tag is not None else np.array([1.0, 0.0, 0.0])
    cosine = abs(float(axis @ normal)) / float(np.linalg.norm(normal))
    if abs(cosine - (1.0 if kind == "revolute" else 0.0)) > 1e-9:
        along = "about" if kind == "revolute" else "square to"
        raise MechanismFileError(
            f"{where} is planar in the URDF: a {kind} pair in it must have its axis {along} the "
            f"plane's normal; make it \"floating\" there"
        )


def _copied_limits(model: pin.Model, i: int) -> tuple[Array, ...]:
    """Return the bounds of joint `i` in the order that `pin.Model.addJoint` takes them."""
    q = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
    v = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
    return (
        model.lowerEffortLimit[v], model.upperEffortLimit[v],
        model.lowerVelocityLimit[v], model.upperVelocityLimit[v],
        model.lowerPositionLimit[q], model.upperPositionLimit[q],
        model.positionLimitMargin[q],
        model.lowerDryFrictionLimit[v], model.upperDryFrictionLimit[v], model.damping[v],
    )


def _read_limits(element: ET.Element, nq: int, nv: int) -> tuple[Array, ...]:
    """Return the bounds that the URDF element states for a joint that Pinocchio read otherwise.

    One scalar of the URDF holds for every coordinate of the pair, except the position limits of
    a pair with several coordinates and those of a continuous joint, which are none.
    """
    limit, dynamics = element.find("limit"), element.find("dynamics")

    def scalar(source: ET.Element | None, key: str, default: float) -> float:
        return float(source.get(key, default)) if source is not None else default

    def filled(count: int, value: float) -> Array:
        return np.full(count, value)

    effort, velocity = scalar(limit, "effort", math.inf), scalar(limit, "velocity", math.inf)
    bounded = nq == 1 and element.get("type") != "continuous"
    lower = scalar(limit, "lower", -math.inf) if bounded else -math.inf
    upper = scalar(limit, "upper", math.inf) if bounded else math.inf
    friction, damping = scalar(dynamics, "friction", 0.0), scalar(dynamics, "damping", 0.0)
    return (
        filled(nv, -effort), filled(nv, effort), filled(nv, -velocity), filled(nv, velocity),
        filled(nq, lower), filled(nq, upper), np.zeros(nq),
        filled(nv, -friction), filled(nv, friction), filled(nv, damping),
    )


def _resist(model: pin.Model, refinements: Mapping[str, JointRefinement]) -> Array:
    """Put damping, friction and armature of a mechanism file into a model; return slip speeds.

    Those of the URDF stand in it already.

    Returns:
        (nv,) slip speeds, NaN where there are none.

    Raises:
        MechanismFileError: there are more or fewer numbers than coordinates.
    """
    slip_speeds = np.full(model.nv, math.nan)
    for name, refined in refinements.items():
        joint = model.getJointId(name) if refined.resistances else 0
        at, nv = model.idx_vs[joint], model.nvs[joint]
        for key, values in refined.resistances.items():
            if values.size not in (1, nv):
                raise MechanismFileError(
                    f"{refined.where}: {key} has {values.size} numbers; give one for all, or one "
                    f"for each of the {nv} coordinate(s) of the joint")
            own = slice(at, at + nv)
            if key == "friction":
                model.lowerDryFrictionLimit[own] = -values
                model.upperDryFrictionLimit[own] = values
            else:
                {"damping": model.damping, "armature": model.armature,
                 "slip_speed": slip_speeds}[key][own] = values
    return slip_speeds


def _mimics(robot: ET.Element, path: Path) -> tuple[tuple[str, str, float, float], ...]:
    mimics = []
    for joint in robot.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        where = f"{path}: joint {joint.get('name')!r}"
        ratio = numbers(mimic, "multiplier", 1, where)[0] if "multiplier" in mimic.attrib else 1.0
        offset = numbers(mimic, "offset", 1, where)[0] if "offset" in mimic.attrib else 0.0
        mimics.append((joint.get("name", ""), mimic.get("joint", ""), float(ratio), float(offset)))
    return tuple(mimics)
