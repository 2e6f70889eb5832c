"""URDF and xacro: an open tree, and the loops that dialects state inside it or beside it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.dialects import yaml_loops
from spatial_pin.formats.dialects.registry import read_dialects, refuse_unread
from spatial_pin.formats.dialects.robot import RobotReading
from spatial_pin.formats.file_access import Trust, read_text, shown
from spatial_pin.formats.importers import Imported, Request
from spatial_pin.formats.parsing import ROOT, parse_urdf
from spatial_pin.formats.urdf.elements import leave_out, local
from spatial_pin.formats.urdf.validation import end_of
from spatial_pin.formats.xacro.expansion import expand

WORLD = "world"
FOLDERS = ("", "urdf", "robots")  # where in a folder, or package, its URDF lies


def is_urdf(path: Path) -> bool:
    """Return whether a file is a URDF, by its name or the name of its root element."""
    if path.suffix.lower() != ".xml":
        return True
    try:
        root = ROOT.match(read_text(path))
    except MechanismFileError:  # in an encoding that other formats may know
        return False
    return root is not None and root[0].endswith("<robot")


def read_urdf(request: Request, loops_file: Path | None = None) -> Imported:
    """Read a URDF or xacro file.

    Args:
        request: the file.
        loops_file: the file that states its loops, if that is known; else it is looked for.
    """
    text = request.expanded
    if text is None:
        text = expand(request.path, request.parameters, request.trusted, request.packages)
    robot = parse_urdf(text, request.path)
    notices = []
    if request.path.suffix != ".xacro" and "${" in text and (written := re.search(
            r"\$\{[^}]*\}", ET.tostring(robot, encoding="unicode"))):
        notices.append(f"{written[0]} is in it as text: xacro puts values in, where "
                       "the file's name ends in .urdf.xacro")
    notices += leave_out(robot, request.without, str(request.path)) if request.without else []
    links = {link.get("name") for link in robot.findall("link")}
    named = {end_of(x, "parent") for x in robot.iter() if local(x) == "joint"}
    named |= {x.get("name", "") for x in robot.iter() if local(x).endswith(("_body_A", "_body_B"))}
    if WORLD in named - links:  # as Drake has it
        robot.insert(0, ET.Element("link", name=WORLD))
        notices.append(f"link {WORLD!r} is not defined: it is the ground")
    reading = RobotReading(robot, request.path, notices=notices)
    if request.complete:
        refuse_unread(reading)
    else:
        read_dialects(reading, loops_file)
    if request.alone and not reading.content.get("closures"):
        yaml_loops.note_unstated(reading)
    return Imported(reading.robot, reading.content, tuple(reading.notices))


def is_statement(path: Path) -> bool:
    """Return whether a YAML file states the loops of a URDF."""
    return yaml_loops.is_closures(path) or yaml_loops.is_robot(path)


def read_folder(request: Request) -> Imported:
    """Read the robot of a folder: that of its `robot.yaml`, or its only URDF."""
    folder, trust = request.path, request.trust
    stated = [p for ending in yaml_loops.ENDINGS for p in sorted(folder.glob(f"*{ending}"))
              if trust.allows(p) and yaml_loops.is_robot(p)]
    chosen = stated if len(stated) == 1 else [p for p in stated if p.stem == "robot"][:1]
    urdf = yaml_loops.urdf_of(chosen[0], trust) if chosen else _only(folder, trust)
    return _read(urdf, request, folder.resolve().name, chosen[0] if chosen else None)


def read_statement(request: Request) -> Imported:
    """Read the robot of a YAML file."""
    path = request.path
    if yaml_loops.is_closures(path):
        folder = path.parent.parent if path.parent.name == "config" else path.parent
        trust = Trust.of(folder, request.packages, request.trusted)
        urdf, name = _only(folder, trust), folder.resolve().name
    else:
        urdf = yaml_loops.urdf_of(path, request.trust)
        name = path.resolve().parent.name if path.stem == "robot" else path.stem
    return _read(urdf, request, name, path)


def _read(urdf: Path, request: Request, name: str, statement: Path | None = None) -> Imported:
    imported = read_urdf(replace(request, path=urdf), statement)
    robot = imported.robot(urdf)
    for mesh in robot.iter("mesh"):
        file = mesh.get("filename", "")
        if file and "://" not in file:  # relative to the URDF, not to the file that was loaded
            mesh.set("filename", str(urdf.resolve().parent / file))
    return replace(imported, urdf=robot, content={"name": name, **imported.content})


def _candidates(folder: Path, trust: Trust) -> list[Path]:
    """Return the URDFs of a folder, those of the first place that has any."""
    for part in FOLDERS:
        files = sorted(p for p in (folder / part).glob("*.urdf") if trust.allows(p))
        if files:
            return files
    return []


def _only(folder: Path, trust: Trust) -> Path:
    """Return the URDF of a folder."""
    files = _candidates(folder, trust)
    names = ("robot", folder.resolve().name)
    chosen = files if len(files) == 1 else [p for p in files if p.stem in names][:1]
    if not chosen:
        listed = ", ".join(p.name for p in files) or "none"
        raise MechanismFileError(f"{shown(folder)}: which .urdf is meant? There are: {listed}; "
                                 "load one of them by its own path")
    return chosen[0]


def has_urdf(folder: Path) -> bool:
    """Return whether there is a URDF in a folder."""
    return bool(_candidates(folder, Trust.of(folder)))
