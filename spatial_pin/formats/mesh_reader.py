"""Reads meshes in a process of its own: `python mesh_reader.py FOLDER FILE FILE ...`.

The reader of meshes (assimp, inside coal) can end the process that it runs in. What it reads is
written to FOLDER as K.npz, points (N, 3), corners of triangles (M, 3) and their colours (M, 4), or
why not as K.txt. Formats with colours are read here, for that reader keeps none: COLLADA (.dae) as
the triangles of its scene, Wavefront (.obj) with the .mtl files it names. Contents not understood
here (skins, splines, ...) are refused; that reader reads them without colours. It imports nothing
else of the library, so that it starts fast.
"""

from __future__ import annotations

import os
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import numpy as np

MEMORY = 4 << 30  # bytes of address space: the libraries alone take a quarter of it
GROWTH = 200  # bytes for a byte of the file, four times the largest measured
DEEPEST_NODE = 100  # nodes within one another: Python recurses to a thousand
MOST_NODES = 10_000  # nodes and geometries, counted as often as they are used
PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")
LARGEST_MATERIALS = 10_000_000  # bytes of a file of materials


def main(folder: str, files: list[str]) -> None:
    """Read all files; the K-th is the first that no earlier run has started."""
    limit_memory(files)
    for k, file in enumerate(files):
        started = os.path.join(folder, f"{k}.begun")
        if os.path.exists(started):
            continue
        with open(started, "w", encoding="utf-8"):
            pass
        target = os.path.join(folder, str(k))
        try:
            points, corners, colours = coloured(file) or plain(file, folder)
            np.savez(f"{target}.npz", points=points, corners=corners, colours=colours)
        except Exception as error:  # errors of any kind
            with open(f"{target}.txt", "w", encoding="utf-8", errors="replace") as report:
                report.write(str(error))


def coloured(file):
    """Return points, corners and colours of a mesh; None where it is not understood here."""
    read = COLOURED.get(os.path.splitext(file)[1].lower())
    try:
        return read(file) if read else None
    except Exception:  # the other reader has a message
        return None


def plain(file, folder):
    """Return points and corners of a mesh; files of materials that it names are not opened."""
    import coal

    if file.lower().endswith(".obj"):
        copy = os.path.join(folder, "mesh.obj")
        with open(file, "rb") as stream, open(copy, "wb") as target:
            lines = stream.read().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
            target.write(b"\n".join(x for x in lines if not x.lstrip().startswith(b"mtllib")))
        file = copy
    mesh = coal.MeshLoader().load(file, np.ones(3))
    triangles = map(mesh.tri_indices, range(mesh.num_tris))
    corners = np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.int64).reshape(-1, 3)
    if not len(corners):
        raise ValueError("it has no triangles")
    return np.array(mesh.vertices(), dtype=float), corners, np.full((len(corners), 4), np.nan)


def limit_memory(files: list[str]) -> None:
    """Let a number in a file not ask for more memory than meshes of that size can need."""
    try:
        import resource
    except ImportError:  # not on this system
        return
    most = MEMORY + GROWTH * max(os.path.getsize(file) for file in files)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


Part = tuple[Any, Any, Any]  # points (N, 3), triangles (M, 3), colour (4,)


def read_collada(file: str) -> Part:
    """Return points (N, 3) [m], triangles (M, 3) and colours (M, 4), NaN for those without."""
    root = ET.parse(file).getroot()
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    scene = _ColladaScene(root)
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


class _ColladaScene:
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
        placement = above @ _transform(node)
        for child in node:
            if child.tag == "instance_geometry":
                yield from self._of_geometry(child, placement)
            elif child.tag == "instance_controller":
                raise ValueError("it has a skin")
            elif child.tag == "node":
                yield from self._of_node(child, placement, depth + 1)
            elif child.tag == "instance_node":
                yield from self._of_node(self._named(child), placement, depth + 1)

    def _of_geometry(self, instance: ET.Element, placement: Any) -> Iterator[Part]:
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
            moved = points[used] @ placement[:3, :3].T + placement[:3, 3]
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
        for lighting in ("diffuse", "emission"):
            for kind in ("phong", "lambert", "blinn", "constant"):
                colour = effect.find(f"profile_COMMON/technique/{kind}/{lighting}/color")
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
            x, y, z, degrees = _floats(element.text)
            axis = np.array([x, y, z]) / (np.linalg.norm([x, y, z]) or 1.0)
            cross, angle = np.cross(np.eye(3), axis), np.radians(degrees)  # Rodrigues' formula
            part[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        elif element.tag in ("lookat", "skew"):
            raise ValueError(f"it has a node with <{element.tag}>")
        whole = whole @ part
    return whole


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
    blocks = [np.empty((0, 3), np.int64)]
    for face in faces:
        if primitive.tag == "tristrips":
            triangles = np.stack([face[:-2], face[1:-1], face[2:]], axis=1)
            triangles[1::2] = triangles[1::2, ::-1]
        else:  # a fan, or a polygon as one
            first = np.repeat(face[:1], max(len(face) - 2, 0))
            triangles = np.stack([first, face[1:-1], face[2:]], axis=1)
        blocks.append(triangles)
    return np.concatenate(blocks)


def read_wavefront(file: str) -> tuple[Any, Any, Any]:
    """Return points (N, 3), triangles (M, 3) and their colours (M, 4), NaN for those without."""
    points, corners, colours = [], [], []
    known: dict[str, list[float]] = {}
    none = [np.nan] * 4
    colour = none
    for key, words in _lines(file):
        if key == "v":
            points.append([float(x) for x in words[:3]])
        elif key == "f":
            face = [_index(word, len(points)) for word in words]
            corners += [(face[0], *face[k:k + 2]) for k in range(1, len(face) - 1)]
            colours += [colour] * (len(face) - 2)
        elif key == "usemtl":
            colour = known.get(" ".join(words), none)
        elif key == "mtllib":
            known.update(_materials(" ".join(words), os.path.dirname(os.path.realpath(file))))
    if not corners:
        raise ValueError("it has no triangles")
    used, corner_indices = np.unique(np.array(corners, dtype=np.int64), return_inverse=True)
    return np.array(points)[used], corner_indices.reshape(-1, 3), np.array(colours)


def _index(word: str, count: int) -> int:
    """Return the number, from 0, of a point of a face; negative ones count from the last."""
    number = int(word.partition("/")[0])
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count or not number:
        raise ValueError("it has triangles of points that it does not have")
    return index


def _lines(file: str) -> Iterator[tuple[str, list[str]]]:
    with open(file, encoding="utf-8", errors="replace") as stream:
        for line in stream:
            words = line.partition("#")[0].split()
            if words:
                if words[-1] == "\\":
                    raise ValueError("a line goes on in the next one")
                yield words[0], words[1:]


def _materials(name: str, folder: str) -> dict[str, list[float]]:
    """Return colours by the names of materials; none where no file of the folder has them."""
    file = os.path.realpath(os.path.join(folder, name))
    if not (file.startswith(os.path.join(folder, "")) and os.path.isfile(file)
            and os.path.getsize(file) <= LARGEST_MATERIALS):
        return {}
    colours: dict[str, list[float]] = {}
    colour: list[float] = []
    for key, words in _lines(file):
        if key == "newmtl":
            colour = colours.setdefault(" ".join(words), [np.nan] * 4)
        elif key == "Kd" and len(words) == 3 and colour:
            colour[:] = [*map(float, words), 1.0 if np.isnan(colour[3]) else colour[3]]
        elif key == "d" and colour and float(words[-1]) > 0.0:
            colour[3] = float(words[-1])
    return colours


COLOURED = {".dae": read_collada, ".obj": read_wavefront}  # endings, and who reads them here


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
