"""URDF and xacro: an open tree, and the loops that dialects state inside it or beside it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.dialects import Reading, read_dialects
from spatial_pin.formats.dialects.beside import gepetto
from spatial_pin.formats.dialects.unknown import refuse_unread
from spatial_pin.formats.imported import Imported, Importer, Request
from spatial_pin.formats.sources import read_text
from spatial_pin.formats.urdf.checks import end_of
from spatial_pin.formats.urdf.elements import local
from spatial_pin.formats.urdf.leaving_out import leave_out
from spatial_pin.formats.xacro.expansion import expand
from spatial_pin.formats.xacro.parsing import ROOT, parse_urdf

WORLD = "world"


def is_urdf(path: Path) -> bool:
    """Return whether a file is one: its name says so, or the name of its root element."""
    if path.suffix.lower() != ".xml":
        return True
    try:
        root = ROOT.match(read_text(path))
    except MechanismFileError:  # in an encoding that other formats may know
        return False
    return root is not None and root[0].endswith("<robot")


def _put_world(robot: ET.Element) -> list[str]:
    """Put in the link `world` where something hangs on it that nothing defines, as Drake has it."""
    links = {link.get("name") for link in robot.findall("link")}
    named = {end_of(x, "parent") for x in robot.iter() if local(x) == "joint"}
    named |= {x.get("name", "") for x in robot.iter() if local(x).endswith(("_body_A", "_body_B"))}
    if WORLD in links or WORLD not in named:
        return []
    robot.insert(0, ET.Element("link", name=WORLD))
    return [f"link {WORLD!r} is not defined: it is what stands still"]


def read_urdf(request: Request, beside: Path | None = None) -> Imported:
    """Read a URDF or xacro file.

    Args:
        request: the file.
        beside: the file that states its loops, if that is known; else it is looked for.

    Raises:
        MechanismFileError: it cannot be read, or joins links in a way that is not known.
    """
    text = request.expanded
    if text is None:
        text = expand(request.path, request.parameters, request.trusted, request.packages)
    robot = parse_urdf(text, request.path)
    before = ET.tostring(robot, encoding="unicode")
    notices = leave_out(robot, request.without, str(request.path))
    if request.path.suffix != ".xacro" and (written := re.search(r"\$\{[^}]*\}", before)):
        notices.append(f"{written[0]} stands in it as it is written: xacro puts values in, where "
                       "the file's name ends in .urdf.xacro")
    reading = Reading(robot, request.path, notices=[*notices, *_put_world(robot)])
    if request.complete:
        refuse_unread(reading)
    else:
        read_dialects(reading, beside)
    if request.alone and not reading.content.get("closures"):
        gepetto.tell_unstated(reading)
    after = ET.tostring(reading.robot, encoding="unicode")
    return Imported(text if after == before else after, reading.content, tuple(reading.notices))


IMPORTER = Importer("URDF or xacro", (".urdf", ".xacro", ".xml"), is_urdf, read_urdf)
