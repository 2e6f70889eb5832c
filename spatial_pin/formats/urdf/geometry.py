"""Shapes of an open tree, visual and collision; meshes are read when shapes are asked for.

They are made here and not by the URDF reader, which leaves out all shapes of a link that has one
it does not know.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, warn
from spatial_pin.formats.faults import Faults
from spatial_pin.formats.file_access import Trust, shown
from spatial_pin.formats.mesh_files import mesh_colours, mesh_file, package_of, read_meshes
from spatial_pin.formats.urdf.validation import numbers, placement
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
        place: in the link's frame.
        solid: a name of SIZES.
        sizes: the numbers of SIZES [m], of a mesh its scale along x, y and z.
        file: of a mesh, as the URDF names it.
        path: of a mesh, where it lies; None where it is not found.
        is_barred: whether a mesh is there and may not be read.
        colour: red, green, blue, opacity; None where the URDF gives none.
        overrides: whether it goes before the colours of a mesh, as `override="true"` at its
            material says; otherwise those of the mesh do, as other viewers of URDF have it.
    """

    kind: str
    link: str
    name: str
    place: pin.SE3
    solid: str
    sizes: tuple[float, ...]
    file: str = ""
    path: Path | None = None
    is_barred: bool = False
    colour: tuple[float, ...] | None = None
    overrides: bool = False


@dataclass(frozen=True, eq=False)
class Shapes:
    """The shapes of an open tree.

    Attributes:
        model: the open tree.
        shapes: all of them.
        where: the file, for messages.
    """

    model: pin.Model
    shapes: tuple[Shape, ...]
    where: str

    def visual(self) -> pin.GeometryModel:
        """What is drawn."""
        return self._made("visual")

    def collision(self) -> pin.GeometryModel:
        """What bodies collide with."""
        return self._made("collision")

    def _made(self, kind: str) -> pin.GeometryModel:
        by_link: dict[str, list[Shape]] = {}
        for shape in self.shapes:
            if shape.kind == kind:
                by_link.setdefault(shape.link, []).append(shape)
        read = read_meshes(str(shape.path) for shapes in by_link.values() for shape in shapes
                           if shape.path is not None)
        geometry, faults = pin.GeometryModel(), Faults()
        for k, frame in enumerate(self.model.frames):
            if frame.type != pin.FrameType.BODY:
                continue
            for shape in by_link.get(frame.name, ()):
                solid = _solid(shape, read, faults)
                if solid is not None:
                    geometry.addGeometryObject(_object(shape, solid, k, frame))
        if faults.told():
            warn(f"{self.where}: {faults.told()}")
        return geometry


def _object(shape: Shape, solid: Any, frame_id: int, frame: pin.Frame) -> pin.GeometryObject:
    is_mesh = shape.solid == "mesh"
    path = str(shape.path) if is_mesh else shape.solid.upper()
    painted = is_mesh and any(colour for _, colour in mesh_colours(path))
    return pin.GeometryObject(
        shape.name, frame.parentJoint, frame_id, frame.placement * shape.place, solid, path,
        np.array(shape.sizes) if is_mesh else np.ones(3),
        shape.colour is not None and (shape.overrides or not painted),
        np.array(shape.colour or NO_COLOUR), "")


def _solid(
    shape: Shape, read: Mapping[str, tuple[Array, Array] | str], faults: Faults
) -> pin.CollisionGeometry | None:
    if shape.solid != "mesh":
        return SOLIDS[shape.solid](*shape.sizes)
    if shape.path is None:  # as was told when it was sought
        return None
    found = read[str(shape.path)]
    if isinstance(found, str):
        faults.note("left out",
                    f"link {shape.link!r}: mesh {shown(shape.file)!r} cannot be read ({found})")
        return None
    points, corners = found
    return _surface(points * np.array(shape.sizes), corners)


def _surface(points: Array, corners: Array) -> pin.CollisionGeometry:
    solid = coal.BVHModelOBBRSS()
    solid.beginModel(len(corners), len(points))
    solid.addVertices(points)
    solid.addTriangles(corners)
    solid.endModel()
    solid.computeLocalAABB()
    return solid


# ---------------------------------------------------------------- in a URDF


def take_shapes(
    robot: ET.Element, path: Path, trust: Trust, faults: Faults
) -> tuple[Shape, ...]:
    """Take the shapes out of a URDF; no mesh is opened.

    Args:
        robot: the URDF; the paths of meshes that are there are made absolute in it.
        path: where it comes from.
        trust: which meshes may be read.
        faults: notes what is left out.

    Raises:
        MechanismFileError: a shape has impossible numbers.
    """
    materials = _Materials(robot, faults)
    folder = path if os.path.isdir(path) else path.parent
    taken = []
    for link in robot.findall("link"):
        name = link.get("name", "")
        where = f"{path}: link {name!r}"
        for kind in KINDS:
            count = 0
            for element in link.findall(kind):
                place = placement(element.find("origin"), where)
                colour = materials.of(element, where) if kind == "visual" else None
                solid = next((x for x in element.iterfind("geometry/*") if x.tag in SIZES), None)
                if solid is None:
                    faults.note(f"none of {', '.join(SIZES)}, left out",
                                f"a <{kind}> of link {name!r}")
                    continue
                tag = "capsule" if kind == "collision" and _is_capsule(element, link) else solid.tag
                overrides = element.find("material[@override='true']") is not None
                shape = Shape(kind, name, f"{name}_{count}", place, tag, _sizes(solid, where),
                              colour=colour, overrides=overrides)
                if solid.tag == "mesh":
                    shape = _sought(shape, solid, folder, trust, faults)
                taken.append(shape)
                count += 1
    _tell_lost([x for x in taken if x.solid == "mesh" and x.path is None and not x.is_barred],
               faults)
    return tuple(taken)


def _is_capsule(element: ET.Element, link: ET.Element) -> bool:
    """Return whether a cylinder stands for a capsule, as Pinocchio's users write it."""
    return element.find("geometry/cylinder") is not None and any(
        capsule.get("name") == element.get("name")
        for capsule in link.iterfind("collision_checking/capsule"))


def _sizes(solid: ET.Element, where: str) -> tuple[float, ...]:
    """Return the numbers of a shape, which must not be negative; of a mesh its scale."""
    if solid.tag == "mesh":
        return _scale(solid, where)
    found: list[float] = []
    for attribute, count in SIZES[solid.tag].items():
        values = numbers(solid, attribute, count, where)
        if np.any(values < 0.0):
            raise MechanismFileError(f"{where}: <{solid.tag}> has a negative {attribute}")
        found += values.tolist()
    return tuple(found)


def _scale(mesh: ET.Element, where: str) -> tuple[float, ...]:
    """Return the scale of a mesh along x, y and z: of one number all three, of more the first."""
    count = len(mesh.get("scale", "1 1 1").split())
    if "scale" not in mesh.attrib:
        return (1.0, 1.0, 1.0)
    given = numbers(mesh, "scale", count if count > 3 or count == 1 else 3, where).tolist()
    return tuple((given * 3)[:3])


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


def _tell_lost(meshes: Sequence[Shape], faults: Faults) -> None:
    """Note meshes that are not found, and which packages would have them."""
    packages = dict.fromkeys(
        package[0] for shape in meshes
        if (package := package_of(shape.file)) is not None and package[1])  # not beside the URDF
    named = ", ".join(f"{name!r}: FOLDER" for name in packages)
    remedy = f"; say where it lies: load(..., packages={{{named}}})" if named else ""
    for shape in meshes:
        faults.note(f"not found, left out of pictures{remedy}",
                    f"link {shape.link!r}: mesh {shown(shape.file)!r}")


class _Materials:
    """Colours by the names of materials; the first that is given for a name counts."""

    def __init__(self, robot: ET.Element, faults: Faults) -> None:
        self._colours: dict[str, ET.Element] = {}
        seen: set[str] = set()
        for material in robot.findall("material"):
            name = material.get("name", "")
            if name in seen:
                faults.note("given more than once, the first counts", f"material {name!r}")
            seen.add(name)
            self._add(material)
        for material in robot.iterfind("link/visual/material"):
            self._add(material)

    def _add(self, material: ET.Element) -> None:
        colour = material.find("color")
        if colour is not None and material.get("name"):
            self._colours.setdefault(material.get("name", ""), colour)

    def of(self, element: ET.Element, where: str) -> tuple[float, ...] | None:
        """Return the colour of a visual; None where it has none."""
        material = element.find("material")
        if material is None:
            return None
        colour = self._colours.get(material.get("name", ""), material.find("color"))
        if colour is None:
            return None
        return tuple(numbers(colour, "rgba", 4, where).astype(np.float32).tolist())
