"""USD: a stage as a joint graph: rigid bodies with inertias and shapes, and their joints."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from pxr import Gf, UsdGeom, UsdPhysics

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.graph.joint_graph import WORLD, GraphJoint, JointGraph, Link, SpanningTree
from spatial_pin.formats.graph.open_tree import open_tree
from spatial_pin.formats.importers import Imported, Request
from spatial_pin.formats.urdf.elements import go_on, inertial, numbers_text, shape_element
from spatial_pin.formats.urdf.geometry import SOLIDS
from spatial_pin.formats.usd.usd_stage import (
    DEGREE,
    UsdStage,
    applied,
    brief_names,
    leave_out,
    quietly,
    rotation_of,
)
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

AXES = {"X": pin.utils.rotate("y", np.pi / 2), "Y": pin.utils.rotate("x", -np.pi / 2),
        "Z": np.eye(3)}  # rotations that take z to an axis
SINGLE_PRECISION = 1e-6  # of numbers of 32 bits, after a few of them were put together
PHYSX, NEWTON, EQUALITY = "PhysxMimicJointAPI", "NewtonMimicAPI", "MjcEqualityJointAPI"
MUJOCO = "MjcJointAPI"
ACTUATOR = "MjcActuator"
DIRECTIONS = {"X": np.eye(3)[0], "Y": np.eye(3)[1], "Z": np.eye(3)[2]}
FREEDOMS = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")
PAIR_OF_FREEDOMS = {  # by the axes that several coordinates slide along and turn about
    **{("", turns): "universal" for turns in ("XY", "XZ", "YZ")}, ("", "XYZ"): "spherical",
    **{(axis, axis): "cylindrical" for axis in "XYZ"},
    ("XY", "Z"): "planar", ("XZ", "Y"): "planar", ("YZ", "X"): "planar"}
UNREAD = ("Joint", "Attachment", "Constraint")  # endings of types that join bodies
LARGEST_FLOAT = 3.4e38  # of a 32-bit number: USD's own for a force without limit


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body: prim, link's name, placement in the world [m], scale (3,); `held` there."""

    prim: Any
    name: str
    placement: pin.SE3
    scale: Array
    held: bool


def read_bodies(stage: UsdStage) -> dict[str, Body]:
    """Return the rigid bodies of a stage by path; they are named as briefly as is unambiguous."""
    prims = [prim for prim in stage.prims() if prim.HasAPI(UsdPhysics.RigidBodyAPI)
             and UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get() is not False]
    bodies = {}
    for path, name in brief_names(prims).items():
        prim = stage.usd.GetPrimAtPath(path)
        held = UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr().Get() is True
        placement, scale = stage.placement(prim)
        bodies[path] = Body(prim, name, placement, scale, held)
    return bodies


def body_of(prim: Any, bodies: dict[str, Body]) -> Body | None:
    """Return the body of a prim; None for a prim of the world."""
    while prim and not prim.IsPseudoRoot():
        body = bodies.get(str(prim.GetPath()))
        if body is not None:
            return body
        prim = prim.GetParent()
    return None


UsdSolid = tuple[ET.Element, pin.SE3, pin.CollisionGeometry]  # of URDF, on its body [m], itself


def solid_of(stage: UsdStage, prim: Any, body: Body) -> UsdSolid | None:
    """Return the shape of a prim on a body; None where URDF has none such."""
    size = _size(stage, prim)
    if size is None:
        return None
    placement, scale = stage.placement(prim, mirrored=True)  # each of these is its own image
    on_body = body.placement.actInv(placement)
    kind, numbers = size
    numbers = {key: stage.metre * value for key, value in numbers.items()}
    if kind == "box":
        sides = numbers["size"] * scale
        return ET.Element("box", size=numbers_text(sides)), on_body, SOLIDS["box"](*sides)
    if np.ptp(scale) > TOLERANCES.half_precision * scale.max():
        return None
    numbers = {key: value * float(scale.mean()) for key, value in numbers.items()}
    axis = "Z" if kind == "sphere" else stage.word(prim.GetAttribute("axis"), AXES)
    turn = pin.SE3(AXES[axis], np.zeros(3))
    element = ET.Element(kind, {key: repr(value) for key, value in numbers.items()})
    return element, on_body * turn, SOLIDS[kind](*numbers.values())


def _size(stage: UsdStage, prim: Any) -> tuple[str, dict[str, float]] | None:
    """Return URDF's name of a shape and its sizes in the prim's units."""
    if prim.IsA(UsdGeom.Cube):
        return "box", {"size": stage.number(UsdGeom.Cube(prim).GetSizeAttr())}
    if prim.IsA(UsdGeom.Sphere):
        return "sphere", {"radius": stage.number(UsdGeom.Sphere(prim).GetRadiusAttr())}
    for kind, schema in (("cylinder", UsdGeom.Cylinder), ("capsule", UsdGeom.Capsule)):
        if prim.IsA(schema):
            shape = schema(prim)
            return kind, {"radius": stage.number(shape.GetRadiusAttr()),
                          "length": stage.number(shape.GetHeightAttr())}
    return None


def link_elements(stage: UsdStage, body: Body, bodies: dict[str, Body]
                  ) -> tuple[tuple[ET.Element, ...], bool]:
    """Return the elements of the URDF link of a body, and whether it is massless."""
    elements, omitted = [], 0
    for prim in stage.prims(body.prim):
        if not prim.IsA(UsdGeom.Gprim) or body_of(prim, bodies) is not body:
            continue
        drawn = str(UsdGeom.Imageable(prim).ComputePurpose()) in ("default", "render") and str(
            UsdGeom.Imageable(prim).ComputeVisibility()) != "invisible"
        kinds = ["visual"] * drawn + ["collision"] * prim.HasAPI(UsdPhysics.CollisionAPI)
        solid = solid_of(stage, prim, body) if kinds else None
        if solid is None:
            omitted += bool(kinds)
            continue
        elements += [shape_element(kind, solid[1], solid[0],
                                   _colour(prim) if kind == "visual" else None,
                                   name=prim.GetName()) for kind in kinds]
    if omitted:
        stage.notices.append(f"{omitted} shape(s) of {body.name!r} are not drawn: meshes and "
                             "others that URDF has no shape for")
    inertia = inertia_of(stage, body, bodies)
    if inertia is not None:
        elements.insert(0, inertial(inertia))
    return tuple(elements), inertia is None


def _colour(prim: Any) -> Array | None:
    colours = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get()
    opacities = UsdGeom.Gprim(prim).GetDisplayOpacityAttr().Get()
    try:
        rgba = np.array([*colours[0], opacities[0] if opacities else 1.0], dtype=float)
    except (TypeError, ValueError, IndexError):
        return None  # none is stated
    return np.clip(np.nan_to_num(rgba), 0.0, 1.0)


def inertia_of(stage: UsdStage, body: Body, bodies: dict[str, Body]) -> pin.Inertia | None:
    """Return the inertia of a body [kg, m]; None where it has no mass."""
    api = UsdPhysics.MassAPI(body.prim)
    stated = body.prim.HasAPI(UsdPhysics.MassAPI)
    mass: float = 0.0
    centre: Array = np.full(3, -np.inf)
    moments: Array = np.zeros(3)
    turn: Array = np.eye(3)
    if stated:
        mass = float(stage.numbers(api.GetMassAttr())[0])
        centre = stage.numbers(api.GetCenterOfMassAttr(), 3, infinite=True)
        moments = stage.numbers(api.GetDiagonalInertiaAttr(), 3)
        turn = stage.rotation(api.GetPrincipalAxesAttr())
    known = bool(np.all(np.isfinite(centre)))
    at = stage.metre * body.scale * (centre if known else np.zeros(3))
    if not (mass > 0.0 and np.any(moments) and known):
        inertia = _from_shapes(stage, body, bodies)
        if inertia is not None:
            mass, moments, at, turn = inertia
        elif not np.any(moments) and mass > 0.0:
            stage.notices.append(f"{body.name!r} has a mass, but no moments of inertia and no "
                                 "shape whose volume is known: it is a point mass")
    if mass <= 0.0:
        if np.any(moments):
            stage.notices.append(f"{body.name!r} has moments of inertia, but no mass: they are "
                                 "left out")
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        matrix = turn @ np.diag(moments * stage.kilogram * stage.metre ** 2) @ turn.T
    return inertia_as_given(stage.kilogram * mass, at, matrix)


def _from_shapes(
    stage: UsdStage, body: Body, bodies: dict[str, Body]
) -> tuple[float, Array, Array, Array] | None:
    """Return the mass properties that USD computes from shapes, masses and densities, or None.

    They are mass, principal moments (3,) in the stage's units, centre (3,) [m] and axes (3, 3).
    """
    unknown: list[str] = []
    unit = 1.0 / stage.metre

    def of_shape(prim: Any) -> Any:
        info = UsdPhysics.RigidBodyAPI.MassInformation()
        solid = solid_of(stage, prim, body)
        volume, moments, placement = 0.0, np.zeros((3, 3)), pin.SE3.Identity()
        if solid is None:
            unknown.append(prim.GetName())
        else:  # at density 1
            _, placement, shape = solid
            volume, moments = shape.computeVolume(), shape.computeMomentofInertia()
        turn = pin.Quaternion(placement.rotation)
        info.volume = volume * unit ** 3
        info.inertia = Gf.Matrix3f(*(moments * unit ** 5).ravel().tolist())
        info.centerOfMass = Gf.Vec3f(0.0)
        info.localPos = Gf.Vec3f(*(placement.translation * unit).tolist())
        info.localRot = Gf.Quatf(turn.w, turn.x, turn.y, turn.z)
        return info

    shapes = [prim for prim in stage.prims(body.prim) if prim.HasAPI(UsdPhysics.CollisionAPI)
              and body_of(prim, bodies) is body]
    if not any(solid_of(stage, prim, body) for prim in shapes):
        return None
    api = UsdPhysics.RigidBodyAPI(body.prim)
    mass, moments, centre, axes = api.ComputeMassProperties(of_shape)
    if unknown:
        stage.notices.append(f"the inertia of {body.name!r} is that of its simple shapes; "
                             f"{', '.join(unknown)} count for nothing")
    return (float(mass), np.array(moments, dtype=float),
            stage.metre * np.array(centre, dtype=float), rotation_of(axes))


def mimics(
    stage: UsdStage, prim: Any, name: str, of_path: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return the mimics that a joint states, as a mechanism file has couplings."""
    entries = []
    for schema in applied(prim):
        kind, _, freedom = schema.partition(":")
        if kind == PHYSX:  # coordinate + gearing * other's + offset = 0
            start = f"physxMimicJoint:{freedom}"
            sign, words = -1.0, (f"{start}:referenceJoint", f"{start}:gearing", f"{start}:offset")
        elif kind == NEWTON:  # coordinate = coef0 + coef1 * other's
            if prim.GetAttribute("newton:mimicEnabled").Get() is False:
                continue
            sign, words = 1.0, ("newton:mimicJoint", "newton:mimicCoef1", "newton:mimicCoef0")
        elif kind == EQUALITY:  # the same, its offset in radians
            if any(stage.optional(prim, f"mjc:coef{k}", 0.0) for k in (2, 3, 4)):
                stage.fail(prim, f"{schema}: a coupling of higher order than one is not read")
            if NEWTON in applied(prim):  # which has the rest
                continue
            sign, words = 1.0, ("mjc:target", "mjc:coef1", "mjc:coef0")
        elif "Mimic" in kind:
            stage.fail(prim, f"{schema} couples joints and is not read; {go_on(prim.GetName())}")
        else:
            continue
        other, unit = _leader(stage, prim, schema, words[0])
        unit = 1.0 if kind == EQUALITY and unit == DEGREE else unit
        if str(other.GetPath()) not in of_path:
            stage.fail(prim, f"{schema}: {other.GetPath()} is no joint")
        entries.append({
            "name": f"mimic_{name}", "type": "coupling",
            "joints": [of_path[str(other.GetPath())], name],
            "ratio": sign * stage.optional(prim, words[1], 1.0),
            "offset": sign * stage.optional(prim, words[2], 0.0) * unit})
    return entries


def _leader(stage: UsdStage, prim: Any, schema: str, relationship: str) -> tuple[Any, float]:
    """Return the joint that is mimicked, and the unit of both coordinates [rad, m]."""
    targets = prim.GetRelationship(relationship).GetTargets()
    other = stage.usd.GetPrimAtPath(targets[0]) if len(targets) == 1 else None
    if not other:
        stage.fail(prim, f"{schema}: {relationship} must be one joint")
    units = ((UsdPhysics.RevoluteJoint, DEGREE), (UsdPhysics.PrismaticJoint, stage.metre))
    for kind, unit in units:
        if prim.IsA(kind) and other.IsA(kind):
            return other, unit
    stage.fail(prim, f"{schema}: it couples a joint that turns with one that slides, or other "
                     "joints than these; that is not read")


def with_resistance(stage: UsdStage, prim: Any, joint: GraphJoint) -> GraphJoint:
    """Return a joint with damping, dry friction, armature and spring, in SI units."""
    turns = joint.type != "prismatic"
    mass = stage.kilogram * (stage.metre ** 2 if turns else 1.0)
    stiffness = stage.optional(prim, "mjc:stiffness", 0.0) * mass
    if stiffness and (stage.optional(prim, "mjc:springref", 0.0) or joint.type == "spherical"):
        stage.notices.append(f"the spring of joint {joint.name!r} is left out: where it is at rest "
                             "has no unit, or it has several coordinates")
        stiffness = 0.0
    force = mass if turns else stage.kilogram * stage.metre
    return replace(joint,
        damping=stage.optional(prim, "mjc:damping", 0.0) * mass,
        friction=stage.optional(prim, "mjc:frictionloss", 0.0) * force,
        armature=stage.optional(prim, "mjc:armature", 0.0) * mass, stiffness=stiffness)


def actuated(stage: UsdStage, of_path: Mapping[str, str]) -> list[str]:
    """Return the joints that actuators move."""
    driven, others = [], []
    for prim in stage.prims():
        if str(prim.GetTypeName()) == ACTUATOR:
            targets = prim.GetRelationship("mjc:target").GetTargets()
            names = [of_path[str(target)] for target in targets if str(target) in of_path]
            driven += names
            others += [] if names else [prim.GetName()]
    if others:
        stage.notices.append(f"actuators of no joint are left out: {', '.join(others)}")
    return list(dict.fromkeys(driven))


def in_series(
    joints: Iterable[GraphJoint], named: Collection[str]
) -> tuple[list[Link], list[GraphJoint]]:
    """Return massless links between joints in series, and all joints.

    Those that MuJoCo's schemas describe, `named`, between the same two bodies are in series.
    """
    groups: dict[tuple[str, str], list[GraphJoint]] = {}
    for joint in joints:
        key = (joint.parent, joint.child) if joint.name in named else (joint.name, "")
        groups.setdefault(key, []).append(joint)
    links, series = [], []
    for chain in groups.values():
        for k in range(len(chain) - 1):
            this, after = chain[k], chain[k + 1]
            link = f"{this.name}/{after.name}"  # at zero it has the pose of the second body
            links.append(Link(link))
            chain[k] = replace(this, child=link)
            chain[k + 1] = replace(after, parent=link, on_parent=after.on_child)
        series += chain
    return links, series


def read_joints(
    stage: UsdStage, bodies: dict[str, Body]
) -> tuple[list[GraphJoint], list[Link], list[str], list[dict[str, Any]]]:
    """Return joints, massless links between those in series, names of driven ones, couplings."""
    of_path = _names(stage)
    tendons = [str(prim.GetPath()) for prim in stage.prims()
               if any("Tendon" in schema for schema in applied(prim))]
    if tendons:
        stage.notices.append(f"tendons pull on {', '.join(tendons)}: they are left out")
    joints, driven, passive, series = list[GraphJoint](), list[str](), list[str](), list[str]()
    couplings: list[dict[str, Any]] = []
    for path, name in of_path.items():
        prim = stage.usd.GetPrimAtPath(path)
        joint = _joint(stage, prim, name, bodies)
        if joint is None:
            continue
        if MUJOCO in applied(prim):
            joint = with_resistance(stage, prim, joint)
            series.append(name)
        joints.append(joint)
        drives = _drives(stage, prim)
        if any(drive["stiffness"] or drive["damping"] for drive in drives.values()):
            driven.append(name)
        elif drives:
            passive.append(name)
        couplings += mimics(stage, prim, name, of_path)
    driven += [x for x in actuated(stage, of_path) if x not in driven]
    links, joints = in_series(joints, series)
    if driven:
        stage.notices.append("drives move joints as drivers; their stiffness and damping are no "
                             f"springs here: {', '.join(driven)}")
    if passive:
        stage.notices.append("drives without stiffness and damping are no drivers: "
                             f"{', '.join(passive)}")
    return joints, links, driven, couplings


def _names(stage: UsdStage) -> dict[str, str]:
    """Return a name for every joint by path, as brief as is unambiguous."""
    prims = []
    for prim in stage.prims():
        kind = str(prim.GetTypeName())
        if prim.IsA(UsdPhysics.Joint):
            prims.append(prim)
        elif kind.endswith(UNREAD):
            stage.fail(prim, f"a {kind} is not read; write a joint of UsdPhysics in its place")
    return brief_names(prims)


def _joint(stage: UsdStage, prim: Any, name: str, bodies: dict[str, Body]) -> GraphJoint | None:
    """Return a joint, None for one that holds nothing."""
    api = UsdPhysics.Joint(prim)
    if api.GetJointEnabledAttr().Get() is False:
        stage.notices.append(f"joint {name!r} is not enabled: it is left out")
        return None
    ends, frames = [], []
    for side, rel, position, rotation in (
            (0, api.GetBody0Rel(), api.GetLocalPos0Attr(), api.GetLocalRot0Attr()),
            (1, api.GetBody1Rel(), api.GetLocalPos1Attr(), api.GetLocalRot1Attr())):
        link, frame = _end(stage, prim, side, rel, position, rotation, bodies)
        ends.append(link)
        frames.append(frame)
    if ends[0] == ends[1]:
        what = "the world" if ends[0] == WORLD else repr(ends[0])
        stage.notices.append(f"joint {name!r} joins {what} with itself: it is left out")
        return None
    joint = GraphJoint(name, "fixed", ends[0], ends[1], frames[0], frames[1],
                       cut=api.GetExcludeFromArticulationAttr().Get() is True)
    if prim.IsA(UsdPhysics.FixedJoint):
        return joint
    if prim.IsA(UsdPhysics.RevoluteJoint):
        return _about(stage, prim, joint, "revolute", UsdPhysics.RevoluteJoint)
    if prim.IsA(UsdPhysics.PrismaticJoint):
        return _about(stage, prim, joint, "prismatic", UsdPhysics.PrismaticJoint)
    if prim.IsA(UsdPhysics.SphericalJoint):
        return _spherical(stage, prim, joint)
    if prim.IsA(UsdPhysics.DistanceJoint):
        return _distance(stage, prim, joint)
    return _generic(stage, prim, joint)


def _end(
    stage: UsdStage, prim: Any, side: int, rel: Any, position: Any, rotation: Any,
    bodies: dict[str, Body],
) -> tuple[str, pin.SE3]:
    """Return the link at an end of a joint, and the joint's frame on it."""
    targets = rel.GetTargets()
    if len(targets) > 1:
        stage.fail(prim, f"body{side} names {len(targets)} prims; it must be one")
    at, turn = stage.numbers(position, 3), stage.rotation(rotation)
    if not targets:
        return WORLD, pin.SE3(turn, stage.metre * at)
    target = stage.usd.GetPrimAtPath(targets[0])
    if not target:
        stage.fail(prim, f"body{side} is {targets[0]}, which does not exist")
    body = body_of(target, bodies)
    if body is not None and body.prim == target:
        return body.name, pin.SE3(turn, stage.metre * at * body.scale)
    placement, scale = stage.placement(target)
    frame = placement * pin.SE3(turn, stage.metre * at * scale)
    return (WORLD, frame) if body is None else (body.name, body.placement.actInv(frame))


def _about(stage: UsdStage, prim: Any, joint: GraphJoint, pair: str, schema: Any) -> GraphJoint:
    """Return a joint of a pair about or along an axis that it states."""
    api = schema(prim)
    lower, upper = (stage.number(x) for x in (api.GetLowerLimitAttr(), api.GetUpperLimitAttr()))
    axis = DIRECTIONS[stage.word(api.GetAxisAttr(), DIRECTIONS)]
    return _one(stage, prim, replace(joint, type=pair, axis=axis), lower, upper)


def _one(stage: UsdStage, prim: Any, joint: GraphJoint, lower: float, upper: float) -> GraphJoint:
    """Return a joint of one coordinate with limits and what its drive and simulator say."""
    turns = joint.type == "revolute"
    unit = DEGREE if turns else stage.metre
    if not lower <= upper:
        stage.fail(prim, f"its lower limit {lower} is above its upper limit {upper}")
    force = stage.kilogram * stage.metre ** (2 if turns else 1)
    drives = _drives(stage, prim)
    most = max((drive["most"] for drive in drives.values()), default=math.inf)
    fastest = stage.optional(prim, "physxJoint:maxJointVelocity", math.inf)
    armature = stage.optional(prim, "physxJoint:armature", 0.0)
    if stage.optional(prim, "physxJoint:jointFriction", 0.0):
        stage.notices.append(f"the friction coefficient of joint {joint.name!r} is left out")
    return replace(joint,
        lower=_limit(lower, unit), upper=_limit(upper, unit),
        effort=math.inf if most >= LARGEST_FLOAT else most * force,
        velocity=math.inf if fastest >= LARGEST_FLOAT else fastest * unit,
        armature=armature * stage.kilogram * stage.metre ** (2 if turns else 0))


def _limit(value: float, unit: float) -> float:
    return math.copysign(math.inf, value) if abs(value) >= LARGEST_FLOAT else float(value) * unit


def _spherical(stage: UsdStage, prim: Any, joint: GraphJoint) -> GraphJoint:
    api = UsdPhysics.SphericalJoint(prim)
    cone = [stage.number(x) for x in (api.GetConeAngle0LimitAttr(), api.GetConeAngle1LimitAttr())]
    if any(0.0 <= angle < LARGEST_FLOAT for angle in cone):
        stage.notices.append(f"the cone limit of joint {joint.name!r} is left out")
    return replace(joint, type="spherical")


def _distance(stage: UsdStage, prim: Any, joint: GraphJoint) -> GraphJoint | None:
    api = UsdPhysics.DistanceJoint(prim)
    least, most = (stage.number(x) for x in (api.GetMinDistanceAttr(), api.GetMaxDistanceAttr()))
    if least != most or least < 0.0:
        stage.notices.append(f"joint {joint.name!r} bounds a distance and holds none: it is left "
                             "out")
        return None
    if least == 0.0:
        return replace(joint, type="spherical")
    return replace(joint, type="distance", length=least * stage.metre)


def _generic(stage: UsdStage, prim: Any, joint: GraphJoint) -> GraphJoint | None:
    """Return the pair that a joint with six freedoms is; reversed limits lock a freedom."""
    limits = {}
    for schema in applied(prim):
        kind, _, freedom = schema.partition(":")
        if kind == "PhysicsLimitAPI":
            api = UsdPhysics.LimitAPI(prim, freedom)
            limits[freedom] = stage.number(api.GetLowAttr()), stage.number(api.GetHighAttr())
    if "distance" in limits:
        stage.fail(prim, "a limit of distance is not read; write a PhysicsDistanceJoint")
    free = [x for x in FREEDOMS if x not in limits or not limits[x][0] > limits[x][1]]
    slides = [x[-1] for x in free if x.startswith("trans")]
    turns = [x[-1] for x in free if x.startswith("rot")]
    if not free:
        return joint
    if len(free) == 6:
        stage.notices.append(f"joint {joint.name!r} holds nothing: it is left out")
        return None
    if len(free) == 1:
        kind = "revolute" if turns else "prismatic"
        joint = replace(joint, type=kind, axis=DIRECTIONS[free[0][-1]])
        return _one(stage, prim, joint, *limits.get(free[0], (-math.inf, math.inf)))
    pair = PAIR_OF_FREEDOMS.get(("".join(slides), "".join(turns)))
    if pair is None:
        stage.fail(prim, f"a joint free in {', '.join(free)} is no pair that is known here; "
                           "write it as several joints with bodies between them")
    if any(abs(x) < LARGEST_FLOAT for name in free for x in limits.get(name, ())):
        stage.notices.append(f"the limits of joint {joint.name!r} are left out: it has "
                             f"{len(free)} coordinates")
    if pair == "universal":
        stage.notices.append(f"joint {joint.name!r} is a universal joint: it turns about "
                             f"{turns[0]} of body0 first, then about {turns[1]} of body1")
    return replace(joint, type=pair, axis=DIRECTIONS[turns[0]], axis2=DIRECTIONS[turns[-1]])


def _drives(stage: UsdStage, prim: Any) -> dict[str, dict[str, float]]:
    """Return stiffness, damping and largest force of the drives of a joint."""
    drives = {}
    for schema in applied(prim):
        kind, _, freedom = schema.partition(":")
        if kind == "PhysicsDriveAPI":
            api = UsdPhysics.DriveAPI(prim, freedom)
            drives[freedom] = {"stiffness": stage.number(api.GetStiffnessAttr()),
                              "damping": stage.number(api.GetDampingAttr()),
                              "most": stage.number(api.GetMaxForceAttr())}
    return drives


def read_stage(request: Request) -> Imported:
    """Read a stage."""
    with quietly(request.path):
        stage = UsdStage(request.path, request.trust)
        stage.notices += leave_out(stage, request.without)
        bodies = read_bodies(stage)
        if not bodies:
            raise MechanismFileError(f"{stage.where}: no rigid body (PhysicsRigidBodyAPI) in it")
        joints, between, driven, couplings = read_joints(stage, bodies)
        links = []
        for body in bodies.values():
            elements, massless = link_elements(stage, body, bodies)
            links.append(Link(body.name, body.placement, elements, massless))
        gravity = stage.gravity().tolist()
    held = [GraphJoint(f"{body.name}_held", "fixed", WORLD, body.name, body.placement)
            for body in bodies.values() if body.held]  # the kinematic bodies
    coupled = frozenset(name for table in couplings for name in table["joints"])
    graph = JointGraph((*links, *between), (*held, *joints), rounding=SINGLE_PRECISION,
                       needed=coupled | set(driven))
    pairs = {joint.name: joint.type for joint in SpanningTree(graph).joints}
    drivers = {x: {"joint": x} for x in driven if pairs.get(x) in ("revolute", "prismatic")}
    others = [x for x in driven if x not in drivers]
    if others:
        stage.notices.append("no driver, as it has no single coordinate or closes a loop: "
                             f"{', '.join(others)}")
    content: dict[str, Any] = {
        "name": request.path.stem, "gravity": gravity, "closures": couplings,
        **({"drivers": drivers} if driven else {})}
    graph = replace(graph, needed=coupled | set(drivers))
    return open_tree(graph, stage.where, content, stage.notices)
