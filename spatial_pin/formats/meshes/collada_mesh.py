"""COLLADA (.dae): triangles of the scene with the colours of their materials.

Runs in the process that reads meshes (`mesh_reader`): it uses nothing but NumPy and the standard
library. What it does not know (skins, splines) it refuses; then the mesh is read without colours.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import numpy as np

DEEPEST_NODE = 100  # nodes within one another: Python recurses to a thousand
MOST_NODES = 10_000  # nodes and geometries, counted as often as they are used
Part = tuple[Any, Any, Any]  # points (N, 3), triangles (M, 3), colour (4,)


def read(file: str) -> Part:
    """Return points (N, 3) [m], triangles (M, 3) and their colours (M, 4), NaN for those without.

    Raises:
        ValueError: it has what is not known here, or lacks what it needs.
        ElementTree.ParseError: it is no XML.
    """
    root = ET.parse(file).getroot()
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    scene = _Scene(root)
    parts = list(scene.parts())
    if not parts:
        raise ValueError("it has no triangles")
    starts = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    points = np.concatenate([points for points, _, _ in parts]) * scene.metre
    corners = np.concatenate([t + at for (_, t, _), at in zip(parts, starts[:-1], strict=True)])
    colours = np.concatenate([np.tile(colour, (len(t), 1)) for _, t, colour in parts])
    return points, corners, colours


def _floats(text: str | None) -> Any:
    return np.array((text or "").split(), dtype=float)


class _Scene:
    """A COLLADA document."""

    def __init__(self, root: ET.Element) -> None:
        self._root, self._used = root, 0
        self._by_id = {x.get("id"): x for x in root.iter() if x.get("id")}
        unit = root.find("asset/unit")
        self.metre = float(unit.get("meter", 1.0)) if unit is not None else 1.0

    def parts(self) -> Iterator[Part]:
        """Yield the triangles of one material after another."""
        scene = self._named(self._root.find("scene/instance_visual_scene"))
        for node in scene.findall("node"):
            yield from self._of_node(node, np.eye(4), 0)

    def _named(self, element: ET.Element | None, key: str = "url") -> ET.Element:
        name = "" if element is None else element.get(key, "").removeprefix("#")
        if name not in self._by_id:
            raise ValueError(f"it refers to {name!r}, which it does not have")
        return self._by_id[name]

    def _of_node(self, node: ET.Element, above: Any, depth: int) -> Iterator[Part]:
        self._used += 1
        if depth > DEEPEST_NODE or self._used > MOST_NODES:
            raise ValueError("its nodes have no end")
        place = above @ _transform(node)
        for child in node:
            if child.tag == "instance_geometry":
                yield from self._of_geometry(child, place)
            elif child.tag == "instance_controller":
                raise ValueError("it has a skin")
            elif child.tag == "node":
                yield from self._of_node(child, place, depth + 1)
            elif child.tag == "instance_node":
                yield from self._of_node(self._named(child), place, depth + 1)

    def _of_geometry(self, instance: ET.Element, place: Any) -> Iterator[Part]:
        bound = {x.get("symbol"): self._named(x, "target")
                 for x in instance.iterfind("bind_material/technique_common/instance_material")}
        mesh = self._named(instance).find("mesh")
        if mesh is None:
            raise ValueError("it has a geometry that is no mesh")
        for primitive in mesh:
            if primitive.tag not in PRIMITIVES:
                continue
            corners = _corners(primitive)
            if not len(corners):
                continue
            points = self._points(primitive)
            used, corners = np.unique(corners, return_inverse=True)
            if len(used) and (used[0] < 0 or used[-1] >= len(points)):
                raise ValueError("it has triangles of points that it does not have")
            moved = points[used] @ place[:3, :3].T + place[:3, 3]
            yield moved, corners.reshape(-1, 3), self._colour(bound.get(primitive.get("material")))

    def _points(self, primitive: ET.Element) -> Any:
        """Return the points (N, 3) that a primitive's vertices are numbers of."""
        vertex = next(x for x in primitive.findall("input") if x.get("semantic") == "VERTEX")
        position = next(x for x in self._named(vertex, "source").findall("input")
                        if x.get("semantic") == "POSITION")
        source = self._named(position, "source")
        accessor = source.find("technique_common/accessor")
        if accessor is None:
            raise ValueError("it has numbers without a meaning")
        values = _floats(self._named(accessor, "source").text)
        stride, start = int(accessor.get("stride", 1)), int(accessor.get("offset", 0))
        if stride < 3 or start < 0:
            raise ValueError("it has points of fewer than three numbers")
        count = min(int(accessor.get("count", 0)), (len(values) - start) // stride)
        return values[start:start + count * stride].reshape(count, stride)[:, :3]

    def _colour(self, material: ET.Element | None) -> Any:
        """Return red, green, blue and opacity of a material, NaN where it has no colour."""
        if material is None:
            return np.full(4, np.nan)
        effect = self._named(material.find("instance_effect"))
        for way in ("diffuse", "emission"):
            for kind in ("phong", "lambert", "blinn", "constant"):
                colour = effect.find(f"profile_COMMON/technique/{kind}/{way}/color")
                if colour is not None:
                    rgba = np.append(_floats(colour.text), 1.0)[:4]
                    return rgba if rgba[3] > 0.0 else np.append(rgba[:3], 1.0)
        return np.full(4, np.nan)


def _transform(node: ET.Element) -> Any:
    """Return the matrix (4, 4) of a node in the one above."""
    whole = np.eye(4)
    for element in node:
        part = np.eye(4)
        if element.tag == "matrix":
            part = _floats(element.text).reshape(4, 4)
        elif element.tag == "translate":
            part[:3, 3] = _floats(element.text)
        elif element.tag == "scale":
            part[:3, :3] = np.diag(_floats(element.text))
        elif element.tag == "rotate":
            part[:3, :3] = _turn(_floats(element.text))
        elif element.tag in ("lookat", "skew"):
            raise ValueError(f"it has a node with <{element.tag}>")
        whole = whole @ part
    return whole


def _turn(axis_angle: Any) -> Any:
    """Return the rotation (3, 3) about an axis by an angle [degrees], by Rodrigues' formula."""
    length = np.linalg.norm(axis_angle[:3])
    if length == 0.0:
        return np.eye(3)
    x, y, z = axis_angle[:3] / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.radians(axis_angle[3])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _corners(primitive: ET.Element) -> Any:
    """Return the triangles (M, 3) of a primitive, numbers of points."""
    inputs = primitive.findall("input")
    stride = 1 + max(int(x.get("offset", 0)) for x in inputs)
    at = next(int(x.get("offset", 0)) for x in inputs if x.get("semantic") == "VERTEX")
    faces = [np.array((p.text or "").split(), dtype=np.int64)[at::stride]
             for p in primitive.findall("p")]
    if primitive.tag == "triangles":
        return np.concatenate(faces).reshape(-1, 3) if faces else np.empty((0, 3), np.int64)
    if primitive.tag == "polylist":
        counts = np.array((primitive.findtext("vcount") or "").split(), dtype=np.int64)
        faces = np.split(np.concatenate(faces), np.cumsum(counts)[:-1]) if faces else []
    strip = primitive.tag == "tristrips"
    found = [_strip(face) if strip else _fan(face) for face in faces if len(face) > 2]
    return np.concatenate(found) if found else np.empty((0, 3), np.int64)


def _fan(face: Any) -> Any:
    return np.stack([np.repeat(face[:1], len(face) - 2), face[1:-1], face[2:]], axis=1)


def _strip(face: Any) -> Any:
    triangles = np.stack([face[:-2], face[1:-1], face[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")
