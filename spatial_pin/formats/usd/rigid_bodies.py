"""USD: rigid bodies, their inertias and their shapes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from pxr import Gf, UsdGeom, UsdPhysics

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.urdf.elements import inertial, numbers_text, origin, paint
from spatial_pin.formats.urdf.geometry import SOLIDS
from spatial_pin.formats.urdf.urdf_model import LIGHTEST
from spatial_pin.formats.usd.usd_stage import UsdStage, brief_names, rotation_of
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

AXES = {"X": pin.utils.rotate("y", np.pi / 2), "Y": pin.utils.rotate("x", -np.pi / 2),
        "Z": np.eye(3)}  # rotations that take z to an axis


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
        for kind in kinds:
            element = ET.Element(kind, name=prim.GetName())
            element.append(origin(solid[1]))
            ET.SubElement(element, "geometry").append(solid[0])
            colour = _colour(prim) if kind == "visual" else None
            if colour is not None:
                paint(element, colour)
            elements.append(element)
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
    if not np.all(np.abs(matrix) <= 1.0 / LIGHTEST):
        raise MechanismFileError(f"{stage.where}: {body.prim.GetPath()}: its moments of inertia "
                                 "leave the range of numbers")
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
