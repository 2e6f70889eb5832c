"""Shapes of an open tree, visual and collision; meshes are read at the first use of shapes.

They are made here and not by the URDF reader, which leaves out all shapes of a link that has one
it does not know.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, warn
from spatial_pin.formats.file_access import Trust, shown
from spatial_pin.formats.importers import Faults
from spatial_pin.formats.mesh_files import mesh_colours, mesh_file, package_of, read_meshes
from spatial_pin.formats.urdf.elements import numbers, placement
from spatial_pin.numerics.linalg import Array

KINDS = ("visual", "collision")
SIZES = {  # shape -> its attributes with their number of entries
    "box": {"size": 3}, "sphere": {"radius": 1}, "mesh": {},
    "cylinder": {"radius": 1, "length": 1}, "capsule": {"radius": 1, "length": 1},
}
SOLIDS = {"box": coal.Box, "sphere": coal.Sphere, "cylinder": coal.Cylinder,
          "capsule": coal.Capsule}
NO_COLOUR = (0.9, 0.9, 0.9, 1.0)  # as Pinocchio has it where there is none


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape in a URDF.

    Attributes:
        kind: "visual" or "collision".
        link: whose it is.
        name: of its geometry object.
        placement: in the link's frame.
        solid: a name of SIZES.
        sizes: the numbers of SIZES [m], of a mesh its scale along x, y and z.
        file: of a mesh, as the URDF names it.
        path: of a mesh; None where there is no such file.
        is_barred: whether a mesh is there and may not be read.
        colour: red, green, blue, opacity; None where the URDF gives none.
        overrides: whether it goes before the colours of a mesh, as `override="true"` at its
            material says; otherwise those of the mesh do, as other viewers of URDF have it.
    """

    kind: str
    link: str
    name: str
    placement: pin.SE3
    solid: str
    sizes: tuple[float, ...]
    file: str = ""
    path: Path | None = None
    is_barred: bool = False
    colour: tuple[float, ...] | None = None
    overrides: bool = False


def geometry_of(
    model: pin.Model, shapes: Iterable[Shape], where: str, kind: str
) -> pin.GeometryModel:
    """Return the shapes of an open tree of one kind, "visual" or "collision"; meshes are read."""
    by_link: dict[str, list[Shape]] = {}
    for shape in shapes:
        if shape.kind == kind:
            by_link.setdefault(shape.link, []).append(shape)
    read = read_meshes(str(shape.path) for own in by_link.values() for shape in own
                       if shape.path is not None)
    geometry, faults = pin.GeometryModel(), Faults()
    for k, frame in enumerate(model.frames):
        if frame.type != pin.FrameType.BODY:
            continue
        for shape in by_link.get(frame.name, ()):
            solid = _solid(shape, read, faults)
            if solid is None:
                continue
            is_mesh = shape.solid == "mesh"
            path = str(shape.path) if is_mesh else shape.solid.upper()
            painted = is_mesh and any(colour for _, colour in mesh_colours(path))
            geometry.addGeometryObject(pin.GeometryObject(
                shape.name, frame.parentJoint, k, frame.placement * shape.placement, solid, path,
                np.array(shape.sizes) if is_mesh else np.ones(3),
                shape.colour is not None and (shape.overrides or not painted),
                np.array(shape.colour or NO_COLOUR), ""))
    if faults.summary():
        warn(f"{where}: {faults.summary()}")
    return geometry


def _solid(
    shape: Shape, read: Mapping[str, tuple[Array, Array] | str], faults: Faults
) -> pin.CollisionGeometry | None:
    if shape.solid != "mesh":
        return SOLIDS[shape.solid](*shape.sizes)
    if shape.path is None:  # a notice has named it
        return None
    mesh = read[str(shape.path)]
    if isinstance(mesh, str):
        faults.note("left out",
                    f"link {shape.link!r}: mesh {shown(shape.file)!r} cannot be read ({mesh})")
        return None
    points, corners = mesh
    solid = coal.BVHModelOBBRSS()
    solid.beginModel(len(corners), len(points))
    solid.addVertices(points * np.array(shape.sizes))
    solid.addTriangles(corners)
    solid.endModel()
    solid.computeLocalAABB()
    return solid


def take_shapes(
    robot: ET.Element, path: Path, trust: Trust, faults: Faults
) -> tuple[Shape, ...]:
    """Take the shapes out of a URDF; refuse impossible numbers. No mesh is opened."""
    colours = _colours(robot, faults)
    folder = path if os.path.isdir(path) else path.parent
    taken = []
    for link in robot.findall("link"):
        name = link.get("name", "")
        where = f"{path}: link {name!r}"
        capsules = [x.get("name") for x in link.iterfind("collision_checking/capsule")]
        for kind in KINDS:
            count = 0
            for element in link.findall(kind):
                own = placement(element.find("origin"), where)
                colour = _colour(element, colours, where) if kind == "visual" else None
                solid = next((x for x in element.iterfind("geometry/*") if x.tag in SIZES), None)
                if solid is None:
                    faults.note(f"none of {', '.join(SIZES)}, left out",
                                f"a <{kind}> of link {name!r}")
                    continue
                tag = solid.tag
                if kind == "collision" and element.find("geometry/cylinder") is not None \
                        and element.get("name") in capsules:
                    tag = "capsule"  # as Pinocchio's users write it
                overrides = element.find("material[@override='true']") is not None
                shape = Shape(kind, name, f"{name}_{count}", own, tag, _sizes(solid, where),
                              colour=colour, overrides=overrides)
                if solid.tag == "mesh":
                    shape = _sought(shape, solid, folder, trust, faults)
                taken.append(shape)
                count += 1
    lost = [x for x in taken if x.solid == "mesh" and x.path is None and not x.is_barred]
    packages = dict.fromkeys(
        package[0] for shape in lost
        if (package := package_of(shape.file)) is not None and package[1])  # not beside the URDF
    named = ", ".join(f"{name!r}: FOLDER" for name in packages)
    remedy = f"; say where it lies: load(..., packages={{{named}}})" if named else ""
    for shape in lost:
        faults.note(f"not found, left out of pictures{remedy}",
                    f"link {shape.link!r}: mesh {shown(shape.file)!r}")
    return tuple(taken)


def _sizes(solid: ET.Element, where: str) -> tuple[float, ...]:
    """Return the numbers of a shape, which must not be negative; of a mesh its scale."""
    if solid.tag == "mesh":  # one number for all three, of more the first
        count = len(solid.get("scale", "1 1 1").split())
        if "scale" not in solid.attrib:
            return (1.0, 1.0, 1.0)
        given = numbers(solid, "scale", count if count > 3 or count == 1 else 3, where).tolist()
        return tuple((given * 3)[:3])
    sizes: list[float] = []
    for attribute, count in SIZES[solid.tag].items():
        values = numbers(solid, attribute, count, where)
        if np.any(values < 0.0):
            raise MechanismFileError(f"{where}: <{solid.tag}> has a negative {attribute}")
        sizes += values.tolist()
    return tuple(sizes)


def _sought(
    shape: Shape, mesh: ET.Element, folder: Path, trust: Trust, faults: Faults
) -> Shape:
    """Return a mesh with the path where it lies, which is put in the URDF."""
    file = mesh.get("filename", "")
    path = mesh_file(file, folder, trust)
    if isinstance(path, Path):
        mesh.set("filename", str(path))
        return replace(shape, file=file, path=path)
    if path:
        faults.note(f"left out of pictures ({path})", f"link {shape.link!r}: mesh {shown(file)!r}")
    return replace(shape, file=file, is_barred=bool(path))


def _colours(robot: ET.Element, faults: Faults) -> dict[str, ET.Element]:
    """Return the <color> of materials by name; the first that is given for a name counts."""
    own, colours = robot.findall("material"), dict[str, ET.Element]()
    for name, count in Counter(material.get("name", "") for material in own).items():
        if count > 1:
            faults.note("given more than once, the first counts", f"material {name!r}")
    for material in (*own, *robot.iterfind("link/visual/material")):
        colour = material.find("color")
        if colour is not None and material.get("name"):
            colours.setdefault(material.get("name", ""), colour)
    return colours


def _colour(
    element: ET.Element, colours: Mapping[str, ET.Element], where: str
) -> tuple[float, ...] | None:
    """Return the colour of a visual; None where it has none."""
    material = element.find("material")
    if material is None:
        return None
    colour = colours.get(material.get("name", ""), material.find("color"))
    return None if colour is None else tuple(
        numbers(colour, "rgba", 4, where).astype(np.float32).tolist())
