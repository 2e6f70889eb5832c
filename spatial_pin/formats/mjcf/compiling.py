"""MJCF to MuJoCo's compiled model: MuJoCo resolves defaults, includes, frames and angles.

Meshes are read only where an inertia comes from them; elsewhere an octahedron stands in, so that a
model opens without its mesh files, and at once.
"""

from __future__ import annotations

import contextlib
import os
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import (
    PROLOGUE,
    Trust,
    check_file,
    is_file,
    parse_xml,
    shown,
    without,
)
from spatial_pin.formats.mesh_files import OUTSIDE
from spatial_pin.formats.urdf.elements import notice_of
from spatial_pin.numerics.linalg import Array

OCTAHEDRON = [1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1]
MOST_COPIES = 100_000  # of an element by <replicate> and the like: more than any mechanism has
HEAD = 1 << 16  # bytes of a file in which its root element begins
JOINING = ("equalities", "tendons", "actuators", "sensors", "flexes", "joints")  # of a spec
TREES = ("include", "model")  # elements that name a file with further bodies
COPIES = ("replicate", "composite", "flexcomp")  # elements with a count of copies


# The file of a mesh asset, None where there is none; its scale (3,) along x, y and z; the placement
# of the scaled file in the frame of a geom; and why there is no file; "" if one notice covers all.
MeshFile = tuple[Path | None, Array, pin.SE3, str]


def compiled(
    path: Path, trust: Trust, without: Iterable[str] = ()
) -> tuple[Any, dict[str, MeshFile], set[str], list[str]]:
    """Let MuJoCo compile an MJCF file.

    Returns:
        `mujoco.MjModel`; the file of every mesh asset; bodies whose inertia is not known; notices.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MechanismFileError(
            f"{shown(path)}: reading MJCF needs mujoco: pip install 'spatial_pin[mjcf]'") from error
    seen: dict[Path, None] = {}  # files that MuJoCo opens as it reads, looked at before it does
    copies = _copies(path, path.parent, trust, seen)
    if copies > MOST_COPIES:
        raise MechanismFileError(f"{shown(path)}: <replicate> and the like make {copies:.3g} "
                                 f"copies; at most {MOST_COPIES:,} are read")
    folders = list(dict.fromkeys(file.parent for file in seen))
    heard: list[str] = []
    try:
        with _collected_warnings(mujoco, heard):
            spec = mujoco.MjSpec.from_file(str(path))
            notice = _leave_out(mujoco, spec, without, shown(path))
            meshes, massless, notices = _without_meshes(mujoco, spec, folders, trust)
            model = spec.compile()
        return model, meshes, massless, [*notice, *dict.fromkeys(heard), *notices]
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise MechanismFileError(f"{shown(path)}: MuJoCo cannot read it: {reason}") from error


def _leave_out(mujoco: Any, spec: Any, names: Iterable[str], where: str) -> list[str]:
    """Delete elements of a spec that join or move bodies, by name or type; return a notice."""
    matches: dict[str, list[str]] = {name: [] for name in names}
    known: dict[str, None] = {}
    for kind in JOINING if matches else ():
        for element in list(getattr(spec, kind)):
            own = [element.name, kind]
            if kind == "equalities":
                own.append(mujoco.mjtEq(element.type).name.removeprefix("mjEQ_").lower())
            known.update(dict.fromkeys(filter(None, own)))
            wanted = [name for name in own if name in matches]
            for name in wanted:
                matches[name].append(own[-1])
            if wanted:
                spec.delete(element)
    return notice_of(matches, known, where)


@contextlib.contextmanager
def _collected_warnings(mujoco: Any, heard: list[str]) -> Iterator[None]:
    """Collect what MuJoCo warns of, which else goes to a log file in the working folder."""

    def hear(text: object) -> None:
        heard.append(f"MuJoCo: {' '.join(str(text).split())}")

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(hear)
    try:
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            yield
        for warning in seen:
            hear(warning.message)
    finally:
        mujoco.set_mju_user_warning(before)


def _copies(path: Path, main: Path, trust: Trust, seen: dict[Path, None]) -> float:
    """Return how many copies of elements a file makes, with those that it includes."""
    seen[path] = None
    total, level = 0.0, [(element, 1.0) for element in _elements(path, trust)]
    while level:
        deeper = []
        for element, times in level:
            if element.tag in COPIES:
                times *= _product(element.get("count", "1"))
                total += times
            for file in _opened_at_once(element, path, main, trust):
                if element.tag in TREES and is_file(file) and file not in seen:
                    total += times * _copies(file, main, trust, seen)
            deeper += [(child, times) for child in element]
        level = deeper
    return total


def _opened_at_once(element: ET.Element, path: Path, main: Path, trust: Trust) -> list[Path]:
    """Return the files that MuJoCo may open for an element as it reads, not when it compiles."""
    name = element.get("file", "") if element.tag in (*TREES, "flexcomp") else ""
    if element.tag == "config" and re.search(r"[/\\]|^\.\.$", element.get("value", "")):
        name = element.get("value", "")  # of a plugin, whose use of it is unknown
    files = list(dict.fromkeys(folder / name for folder in (main, path.parent))) if name else []
    for file in files:
        try:
            trust.resolved(file)
            if os.path.exists(file):  # unlike Path.exists, false for names that are too long
                check_file(file)
        except MechanismFileError as error:
            raise MechanismFileError(f"{shown(path)}: an include: {error}") from error
    return files


def _elements(path: Path, trust: Trust) -> list[ET.Element]:
    """Return the root of a file; none where MuJoCo may read it, and it can name no other files."""
    text = _text(path)
    try:
        return [parse_xml(text, path)]
    except MechanismFileError:
        names_files = not trust.trusted and re.search(r"(?:file\w*|value)\s*=", text)
        if names_files or any(f"<{tag}" in text for tag in COPIES):
            raise
        return []


def _text(path: Path, most: int = -1) -> str:
    """Return the first bytes of a file as text without comments, whatever its encoding."""
    check_file(path)
    try:
        with path.open("rb") as stream:
            text = stream.read(most).decode("utf-8", errors="replace")
    except OSError as error:
        raise MechanismFileError(f"{shown(path)}: {error.strerror}") from error
    return without(text, "<!--", "-->").removeprefix("\ufeff")


def _product(text: str) -> float:
    try:
        return float(np.prod([abs(float(word)) for word in text.split()]))
    except ValueError:
        return 1.0  # MuJoCo complains of it


def _without_meshes(
    mujoco: Any, spec: Any, folders: list[Path], trust: Trust
) -> tuple[dict[str, MeshFile], set[str], list[str]]:
    """Take from a spec all files that are not needed; return meshes, massless bodies, notices."""
    notices = _prepare(mujoco, spec)
    files, barred = _mesh_files(spec, folders, trust)
    missing = {name for name, file in files.items() if file is None}
    massless = _unknown_inertias(mujoco, spec, missing)
    fitted = {g.meshname for g in spec.geoms if g.meshname and _is_fitted(mujoco, g)} - missing
    read = fitted | {g.meshname for body in spec.bodies if body.name not in massless
                     for g in _weighed(mujoco, spec, body)}
    for geom in list(spec.geoms):
        if geom.meshname in missing and _is_fitted(mujoco, geom):
            spec.delete(geom)
    meshes = {}
    for mesh in spec.meshes:
        meshes[mesh.name] = _placed(mesh, files.get(mesh.name))
        if mesh.file and mesh.name not in read:
            mesh.file, mesh.uservert = "", OCTAHEDRON
            mesh.scale, mesh.refpos = np.ones(3), np.zeros(3)
            mesh.refquat = np.array([1.0, 0.0, 0.0, 0.0])
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    for names, why in ((barred, f"lie {OUTSIDE}, or are too large"),
                       (missing - barred, "are not there")):
        if names:
            notices.append(f"{len(names)} mesh files {why} ({some(names)}); their shapes are left "
                           "out")
    if massless:
        notices.append(f"the inertia of bodies ({some(massless)}) comes from mesh files that are "
                       f"not {'read' if barred else 'there'}: they have no mass here")
    return meshes, massless, notices


def some(names: Iterable[str]) -> str:
    """Return the first of some names, for a message."""
    listed = sorted(names)
    return ", ".join(listed[:3]) + (", ..." if len(listed) > 3 else "")


def _prepare(mujoco: Any, spec: Any) -> list[str]:
    """Name unnamed elements, and delete textures, skins and height fields; return notices."""
    taken, notices = {body.name for body in spec.bodies}, []
    for k, body in enumerate(spec.bodies):
        if not body.name:
            body.name = f"body_{k}"
            while body.name in taken:
                body.name += "_"
            taken.add(body.name)
    for mesh in spec.meshes:  # as MuJoCo does, some of it only later
        mesh.name = mesh.name or Path(mesh.file).stem
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for light in (x for x in spec.lights if hasattr(x, "texture")):
        light.texture = ""
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
            notices.append(f"height field {geom.hfieldname!r} is left out")
            spec.delete(geom)
    for element in [*spec.textures, *spec.skins, *spec.hfields]:
        spec.delete(element)
    return notices


def _mesh_files(
    spec: Any, folders: list[Path], trust: Trust
) -> tuple[dict[str, Path | None], set[str]]:
    """Return the file of every mesh asset, None without one that may be read, and which may not."""
    files, barred = dict[str, Path | None](), set[str]()
    for mesh in spec.meshes:
        if mesh.file:
            meshdir = getattr(mesh, "compiler", spec.compiler).meshdir  # MuJoCo 3 has one for all
            name = re.split(r"[/\\]", mesh.file)[-1] if spec.strippath else mesh.file
            tried = (folder / meshdir / name for folder in folders)
            there = [file.resolve() for file in tried if is_file(file)]
            if not all(map(trust.allows, there)):
                barred.add(mesh.name)
            files[mesh.name] = there[0] if there and mesh.name not in barred else None
    return files, barred


def _is_fitted(mujoco: Any, geom: Any) -> bool:
    """Whether a geom is a simple shape that takes its size from a mesh."""
    return geom.type not in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF)


def _weighed(mujoco: Any, spec: Any, body: Any) -> Iterator[Any]:
    """Yield the geoms with a mesh that the inertia of a body comes from."""
    how = spec.compiler.inertiafromgeom
    never, always = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE, \
        mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    is_world = body.name == spec.worldbody.name
    if is_world or how == never or (how != always and body.explicitinertial):
        return
    low, high = spec.compiler.inertiagrouprange
    for geom in body.geoms:
        weighs = geom.density if np.isnan(geom.mass) else geom.mass
        if geom.meshname and low <= geom.group <= high and weighs != 0.0:
            yield geom


def _unknown_inertias(mujoco: Any, spec: Any, missing: set[str]) -> set[str]:
    """Give bodies whose meshes are missing an inertia of their own; return their names."""
    massless = {body.name for body in spec.bodies
                if any(geom.meshname in missing for geom in _weighed(mujoco, spec, body))}
    if not massless:
        return massless
    always = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    for body in spec.bodies:
        if body.name in massless:
            body.explicitinertial, body.mass, body.inertia = True, 1.0, np.ones(3)
            body.fullinertia = np.full(6, np.nan)
            body.ipos, body.iquat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        elif spec.compiler.inertiafromgeom == always and body.geoms:
            body.explicitinertial = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    return massless


def _placed(mesh: Any, file: Path | None) -> MeshFile:
    """Return the placement of a mesh file in a geom: x = scale * R' (file - refpos)."""
    w, x, y, z = mesh.refquat
    turn = pin.Quaternion(w, x, y, z).normalized().matrix().T
    scale, fault = np.array(mesh.scale), ""
    if np.any(turn != np.eye(3)) and np.ptp(scale) > 0.0:
        fault = "URDF cannot say that it is turned first and stretched then"
    elif not mesh.file:
        fault = "it is in no file of its own"
    elif Path(mesh.file).suffix.lower() == ".msh":
        fault = "its format is MuJoCo's own"
    placement = pin.SE3(turn, -scale * (turn @ mesh.refpos))
    return None if fault else file, scale, placement, fault


def is_mjcf(path: Path) -> bool:
    """Return whether the root element of a file is <mujoco>."""
    if path.suffix.lower() == ".mjcf":
        return True
    try:
        head = _text(path, HEAD)
    except MechanismFileError:
        return False
    return re.match(PROLOGUE + r"<mujoco[\s/>]", head, re.DOTALL) is not None
