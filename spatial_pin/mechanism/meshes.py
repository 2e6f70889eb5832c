"""Shapes of an open tree; meshes are read when shapes are asked for, in a process of their own.

Loading a mechanism only looks whether a mesh is there and begins as its format does.
"""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, warn
from spatial_pin.linalg import Array
from spatial_pin.mechanism import mesh_reader
from spatial_pin.mechanism.sources import is_file, package_folders, shown

LEAST_TIME = 20.0  # s for meshes to be read, the start of the process with it
TIME_OF_A_BYTE = 2e-6  # s, ten times what was seen
KINDS = {"visual": pin.GeometryType.VISUAL, "collision": pin.GeometryType.COLLISION}
STAND_IN = {"radius": "1"}  # the sphere that stands where a mesh is not yet read


@dataclass(frozen=True)
class Mesh:
    """A mesh in a URDF.

    Attributes:
        where: file, link and mesh, for messages.
        kind: "visual" or "collision".
        shape: name of the geometry object that Pinocchio makes of it.
        file: the mesh file.
        scale: along x, y and z.
    """

    where: str
    kind: str
    shape: str
    file: str
    scale: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Shapes:
    """The shapes of an open tree.

    Attributes:
        model: the open tree.
        urdf: its URDF text, spheres in place of meshes.
        meshes: what belongs in their place.
        where: the file, for messages.
    """

    model: pin.Model
    urdf: str
    meshes: tuple[Mesh, ...]
    where: str

    def visual(self) -> pin.GeometryModel:
        """What is drawn.

        Raises:
            MechanismFileError: Pinocchio cannot make it.
        """
        return self._made("visual")

    def collision(self) -> pin.GeometryModel:
        """What bodies collide with.

        Raises:
            MechanismFileError: Pinocchio cannot make it.
        """
        return self._made("collision")

    def _made(self, kind: str) -> pin.GeometryModel:
        try:
            geometry = pin.buildGeomFromUrdfString(self.model, self.urdf, KINDS[kind])
        except Exception as error:
            reason = " ".join(str(error).split())
            raise MechanismFileError(f"{self.where}: Pinocchio cannot read it: {reason}") from error
        wanted = [mesh for mesh in self.meshes if mesh.kind == kind]
        read = read_meshes(mesh.file for mesh in wanted)
        for mesh in wanted:
            found = read[mesh.file]
            if isinstance(found, str):
                _tell(mesh.where, f"cannot be read ({found})")
                geometry.removeGeometryObject(mesh.shape)
                continue
            shape = geometry.geometryObjects[geometry.getGeometryId(mesh.shape)]
            points, corners = found
            shape.geometry = _solid(points * np.array(mesh.scale), corners)
            shape.meshPath, shape.meshScale = mesh.file, np.array(mesh.scale)
        return geometry


def _tell(where: str, why: str) -> None:
    warn(f"{where} {why}, left out")


def _solid(points: Array, corners: Array) -> pin.CollisionGeometry:
    import coal

    solid = coal.BVHModelOBBRSS()
    solid.beginModel(len(corners), len(points))
    solid.addVertices(points)
    solid.addTriangles(corners)
    solid.endModel()
    solid.computeLocalAABB()
    return solid


def read_meshes(files: Iterable[str]) -> dict[str, tuple[Array, Array] | str]:
    """Return points (N, 3) and triangles (M, 3) of mesh files, or why one cannot be read."""
    names = list(dict.fromkeys(files))
    if not names:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-P", mesh_reader.__file__, folder, *names]
        time = LEAST_TIME + TIME_OF_A_BYTE * sum(map(os.path.getsize, names))
        for _ in names:  # each run that ends too soon has at least begun one more
            if not _ended_too_soon(command, time):
                break
        return {name: _outcome(Path(folder), k) for k, name in enumerate(names)}


def _ended_too_soon(command: list[str], time: float) -> bool:
    paths = os.pathsep.join(path for path in sys.path if path)
    try:
        run = subprocess.run(
            command, timeout=time, check=False, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": paths})
    except subprocess.TimeoutExpired:
        return True
    except OSError as error:
        raise MechanismFileError(f"no process can be started that reads meshes: {error}") from error
    return run.returncode != 0


def _outcome(folder: Path, k: int) -> tuple[Array, Array] | str:
    target, report = folder / f"{k}.npz", folder / f"{k}.txt"
    try:
        if report.is_file():
            return _reason(report.read_text(encoding="utf-8"))
        with np.load(target) as found:
            points, corners = found["points"], found["corners"]
    except (OSError, ValueError, zipfile.BadZipFile):
        return "reading it does not end, or ends the process that reads it"
    if not np.all(np.isfinite(points)):
        return "it has points that are NaN or infinite"
    if corners.min() < 0 or corners.max() >= len(points):
        return "it has triangles of points that it does not have"
    return points, corners


def _reason(text: str) -> str:
    """Return what the reader says, without where in its sources it says it."""
    lines = text.split("message:")[-1].strip().splitlines() or ["for no reason that it tells"]
    return " ".join(lines[0].split())[:200]


# ---------------------------------------------------------------- in a URDF


def take_meshes(robot: ET.Element, path: Path) -> tuple[Mesh, ...]:
    """Make mesh paths absolute; report and leave out those that are not there.

    Returns:
        The meshes that stay.
    """
    meshes = []
    for link in robot.findall("link"):
        for kind in KINDS:
            kept = 0
            for shape in link.findall(kind):
                mesh = shape.find("geometry/mesh")
                if mesh is not None:
                    name = mesh.get("filename", "")
                    where = f"{path}: link {link.get('name')!r}: mesh {shown(name)!r}"
                    file = _mesh_file(name, path.parent)
                    reason = "not found" if file is None else fault(file)
                    if reason:
                        _tell(where, reason)
                        link.remove(shape)
                        continue
                    mesh.set("filename", str(file))
                    scale = tuple(map(float, mesh.get("scale", "1 1 1").split()))
                    meshes.append(Mesh(where, kind, f"{link.get('name')}_{kept}", str(file), scale))
                kept += 1
    return tuple(meshes)


def put_stand_ins(robot: ET.Element) -> None:
    """Put spheres in the place of meshes."""
    for geometry in robot.iterfind("link/*/geometry"):
        mesh = geometry.find("mesh")
        if mesh is not None:
            geometry.remove(mesh)
            ET.SubElement(geometry, "sphere", STAND_IN)


def _mesh_file(name: str, folder: Path) -> Path | None:
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        candidates = [found / rest for found in package_folders(package, folder)]
    else:
        candidates = [folder / name.removeprefix("file://")]
    return next((file.resolve() for file in candidates if is_file(file)), None)


# ---------------------------------------------------------------- how formats begin


def fault(file: Path) -> str:
    """Return why a mesh file cannot be one of its format, "" if it can."""
    kind = file.suffix.lower()
    try:
        with file.open("rb") as stream:
            size, head = os.fstat(stream.fileno()).st_size, stream.read(1 << 16)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if not head:
        return "cannot be read (it is empty)"
    check = FORMATS.get(kind)
    return "" if check is None or check(head, size) else f"cannot be read (it is no {kind} file)"


def _is_stl(head: bytes, size: int) -> bool:
    if head.lstrip()[:5].lower() == b"solid" and b"facet" in head.lower():
        return True
    return len(head) >= 84 and 0 < struct.unpack_from("<I", head, 80)[0] <= (size - 84) / 50


def _is_ply(head: bytes, size: int) -> bool:
    """Whether the file is as long as its points, of three numbers at least, must be."""
    end = head.find(b"end_header")
    points = re.search(rb"element\s+vertex\s+(\d{1,18})\s", head[:end])
    least = 12 if b"format binary" in head[:end] else 6  # bytes of a point
    return (head[:3] == b"ply" and end > 0 and points is not None
            and 0 < int(points[1]) * least <= size - end)


def _is_obj(head: bytes, size: int) -> bool:
    return re.search(rb"^[ \t]*v[ \t]", head, re.M) is not None or size > len(head)


FORMATS: dict[str, Callable[[bytes, int], bool]] = {
    ".stl": _is_stl, ".ply": _is_ply, ".obj": _is_obj,
    ".dae": lambda head, size: b"<COLLADA" in head,
    ".glb": lambda head, size: head[:4] == b"glTF",
}
