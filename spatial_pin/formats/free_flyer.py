"""A free base: a floating joint between the world and the root of an open tree."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Container
from pathlib import Path

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.sources import shown
from spatial_pin.formats.urdf.checks import end_of
from spatial_pin.formats.xacro.parsing import parse_urdf

ROOT_JOINT = "root_joint"  # as Pinocchio names it
GROUNDS = ("world", "ground")  # names of the link that stands still, the first that is free


def with_free_flyer(urdf: str, path: Path, refined: Container[str] = ()) -> str:
    """Return URDF text in which a floating joint carries the root link.

    A new link, `world`, becomes the root (`ground` where a link has that name): closures to what
    stands still name it. What a file fixes to its root link goes with it.

    Args:
        urdf: plain URDF text of a tree.
        path: where it comes from, for errors.
        refined: names of floating joints that are another pair in truth.

    Raises:
        MechanismFileError: all that the root carries floats already.
    """
    robot = parse_urdf(urdf, path)
    joints = robot.findall("joint")
    roots = _roots(robot)
    where = f"{shown(path)}: free_flyer=True"
    if not roots:
        return urdf  # no tree: told by whoever reads it
    if len(roots) > 1:
        raise MechanismFileError(f"{where}: several links have no parent: {', '.join(roots)}; join "
                                 "those that float together by a fixed joint")
    on_root = [joint for joint in joints if end_of(joint, "parent") == roots[0]]
    if on_root and _is_bare(robot, roots[0]) and all(
            x.get("type") == "floating" and x.get("name", "") not in refined for x in on_root):
        link, name = end_of(on_root[0], "child"), on_root[0].get("name")
        raise MechanismFileError(
            f"{where}: link {link!r} floats on joint {name!r} already; leave free_flyer out")
    if ROOT_JOINT in {joint.get("name") for joint in joints}:
        raise MechanismFileError(f"{where}: there is a joint {ROOT_JOINT!r} already; rename it")
    _put_below(robot, roots[0])
    return ET.tostring(robot, encoding="unicode")


def _roots(robot: ET.Element) -> list[str]:
    children = {end_of(joint, "child") for joint in robot.findall("joint")}
    names = [link.get("name", "") for link in robot.findall("link")]
    return [name for name in names if name not in children]


def _is_bare(robot: ET.Element, link: str) -> bool:
    """Whether a link weighs nothing, as one does that stands for the world."""
    return all(x.find("inertial") is None for x in robot.findall("link") if x.get("name") == link)


def _put_below(robot: ET.Element, root: str) -> None:
    """Put a new root below the old one, with a floating joint between them."""
    taken = {link.get("name") for link in robot.findall("link")}
    free = [name for name in GROUNDS if name not in taken]
    ground = free[0] if free else next(
        name for k in range(len(taken) + 1) if (name := f"{GROUNDS[-1]}_{k}") not in taken)
    joint = ET.Element("joint", name=ROOT_JOINT, type="floating")
    ET.SubElement(joint, "parent", link=ground)
    ET.SubElement(joint, "child", link=root)
    robot.insert(0, ET.Element("link", name=ground))
    robot.insert(1, joint)
