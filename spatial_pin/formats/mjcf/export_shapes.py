"""Shapes of a URDF as geoms: what is drawn touches nothing, what collides is not drawn."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from spatial_pin.errors import warn
from spatial_pin.formats.mjcf.writing import Writing, placed
from spatial_pin.formats.sources import is_file
from spatial_pin.formats.urdf.checks import placement
from spatial_pin.formats.urdf.elements import numbers_text
from spatial_pin.formats.urdf.writing import unique
from spatial_pin.numerics.linalg import Array

MESHES = (".obj", ".stl")  # files that MuJoCo reads
GROUPS = {"visual": {"group": "2", "contype": "0", "conaffinity": "0"},
          "collision": {"group": "3"}}


def add_shapes(writing: Writing) -> None:
    """Add the geoms of all links; tell which meshes MuJoCo cannot read."""
    robot = ET.fromstring(writing.mechanism.urdf)
    colours = {m.get("name", ""): m.find("color") for m in robot.iter("material")
               if m.find("color") is not None}
    assets: dict[tuple[str, str], str] = {}
    lost: set[str] = set()
    for link in robot.findall("link"):
        body = writing.links.get(link.get("name", ""))
        for kind in GROUPS if body is not None else ():
            for shape in link.findall(kind):
                geom = _geom(writing, shape, assets)
                if geom is None:
                    lost.add(shape.find("geometry/mesh").get("filename", ""))  # type: ignore[union-attr]
                    continue
                material = shape.find("material")
                colour = None if material is None else colours.get(material.get("name", ""))
                rgba = {} if colour is None else {"rgba": colour.get("rgba", "")}
                assert body is not None
                ET.SubElement(body, "geom", {**geom, **GROUPS[kind], **rgba})
    if lost:
        some = ", ".join(sorted(Path(x).name for x in lost)[:3])
        warn(f"mechanism {writing.mechanism.name!r}: {len(lost)} meshes are not there or in "
             f"formats that MuJoCo does not read ({some}): left out")


def _geom(
    writing: Writing, shape: ET.Element, assets: dict[tuple[str, str], str]
) -> dict[str, str] | None:
    """Return the attributes of the geom of a URDF shape; None for a mesh that is not readable."""
    solid = next(iter(shape.find("geometry")))  # type: ignore[arg-type]
    geom = placed(placement(shape.find("origin"), ""))
    if solid.tag == "mesh":
        name = _asset(writing, solid, assets)
        return None if name is None else {**geom, "type": "mesh", "mesh": name}
    if solid.tag == "box":
        size = _numbers(solid.get("size", "")) / 2.0
    elif solid.tag == "sphere":
        size = _numbers(solid.get("radius", ""))
    else:  # cylinder or capsule
        size = np.array([float(solid.get("radius", "")), float(solid.get("length", "")) / 2.0])
    return {**geom, "type": solid.tag, "size": numbers_text(size)}


def _asset(writing: Writing, mesh: ET.Element, assets: dict[tuple[str, str], str]) -> str | None:
    file, scale = mesh.get("filename", ""), mesh.get("scale", "1 1 1")
    if Path(file).suffix.lower() not in MESHES or not is_file(Path(file)):
        return None
    if (file, scale) not in assets:
        assets[file, scale] = unique(Path(file).stem, assets.values())
        ET.SubElement(writing.part("asset"), "mesh", name=assets[file, scale], file=file,
                      scale=scale, inertia="shell")
    return assets[file, scale]


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])
