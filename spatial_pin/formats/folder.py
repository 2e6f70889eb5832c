"""Robots that are a folder, or a YAML file beside their URDF: found, and read as that URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.dialects.beside import gepetto, loop_closures
from spatial_pin.formats.imported import Imported, Importer, Request
from spatial_pin.formats.sources import Trust, shown
from spatial_pin.formats.urdf_importer import read_urdf
from spatial_pin.formats.xacro.parsing import parse_xml

PLACES = ("", "urdf", "robots")  # where in a folder, or package, its URDF lies


def is_statement(path: Path) -> bool:
    """Return whether a YAML file states the loops of a URDF."""
    return loop_closures.is_closures(path) or gepetto.is_robot(path)


def read_folder(request: Request) -> Imported:
    """Read the robot of a folder: that of its `robot.yaml`, or of its only one, or its only URDF.

    Raises:
        MechanismFileError: there is none, or several and none is named `robot` or as the folder.
    """
    folder, trust = request.path, _trust(request)
    stated = [p for ending in gepetto.ENDINGS for p in sorted(folder.glob(f"*{ending}"))
              if trust.allows(p) and gepetto.is_robot(p)]
    chosen = stated if len(stated) == 1 else [p for p in stated if p.stem == "robot"][:1]
    urdf = gepetto.urdf_of(chosen[0], trust) if chosen else _only(folder, trust)
    return _read(urdf, request, folder.resolve().name, chosen[0] if chosen else None)


def read_statement(request: Request) -> Imported:
    """Read the robot of a YAML file.

    Raises:
        MechanismFileError: it is about no file that is there.
    """
    path = request.path
    if loop_closures.is_closures(path):
        folder = path.parent.parent if path.parent.name == "config" else path.parent
        trust = Trust.of(folder, request.packages, request.trusted)
        urdf, name = _only(folder, trust), folder.resolve().name
    else:
        urdf = gepetto.urdf_of(path, _trust(request))
        name = path.resolve().parent.name if path.stem == "robot" else path.stem
    return _read(urdf, request, name, path)


def _read(urdf: Path, request: Request, name: str, statement: Path | None = None) -> Imported:
    imported = read_urdf(replace(request, path=urdf), statement)
    robot = parse_xml(imported.urdf, urdf)
    for mesh in robot.iter("mesh"):
        file = mesh.get("filename", "")
        if file and "://" not in file:  # relative to the URDF, not to what was asked for
            mesh.set("filename", str(urdf.resolve().parent / file))
    return Imported(ET.tostring(robot, encoding="unicode"), {"name": name, **imported.content},
                    imported.notices)


def _trust(request: Request) -> Trust:
    return Trust.of(request.path, request.packages, request.trusted)


def _candidates(folder: Path, trust: Trust) -> list[Path]:
    """Return the URDFs of a folder, those of the first place that has any."""
    for place in PLACES:
        found = sorted(p for p in (folder / place).glob("*.urdf") if trust.allows(p))
        if found:
            return found
    return []


def _only(folder: Path, trust: Trust) -> Path:
    """Return the URDF that is meant by a folder."""
    found = _candidates(folder, trust)
    names = ("robot", folder.resolve().name)
    chosen = found if len(found) == 1 else [p for p in found if p.stem in names][:1]
    if not chosen:
        listed = ", ".join(p.name for p in found) or "none"
        raise MechanismFileError(f"{shown(folder)}: which .urdf is meant? There are: {listed}; "
                                 "load one of them by its own path")
    return chosen[0]


FOLDER = Importer("a folder with a URDF", ("/",),
                  lambda path: bool(_candidates(path, Trust.of(path))), read_folder)
STATEMENT = Importer("robot.yaml or loop_closures.yaml beside a URDF", (".yaml", ".yml"),
                     is_statement, read_statement)
