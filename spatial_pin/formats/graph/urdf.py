"""URDF whose links have several parents: its loops are cut, for a URDF holds a tree."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spatial_pin.formats.graph.joint_graph import GraphJoint, JointGraph, Link
from spatial_pin.formats.graph.open_tree import open_tree
from spatial_pin.formats.importers import Faults, Imported
from spatial_pin.formats.urdf.urdf_model import (
    CONTAINED_PAIRS,
    PAIR_OF_URDF_TYPE,
    JointRefinement,
    joint_axes,
)
from spatial_pin.formats.urdf.validation import check_joint, end_of, placement
from spatial_pin.mechanism.pairs import PAIRS

LIMITED = ("revolute", "prismatic")  # URDF types that have limits of position


def without_loops(
    robot: ET.Element, content: Mapping[str, Any], refinements: Mapping[str, JointRefinement],
    path: Path, faults: Faults,
) -> Imported | None:
    """Return a URDF with its loops cut, and the tables of a mechanism file for them.

    Returns:
        None where there is no loop, or where the URDF cannot be used for other reasons.

    Raises:
        MechanismFileError: a joint has impossible numbers, or something refers to the coordinate
            of every joint at which a loop could be cut.
    """
    elements, names = robot.findall("joint"), [x.get("name", "") for x in robot.findall("link")]
    ends = [(end_of(joint, "parent"), end_of(joint, "child")) for joint in elements]
    named = {joint.get("name", "") for joint in elements}
    known, roots = set(names), set(names) - {child for _, child in ends}
    if robot.tag != "robot" or len(known) < len(names) or len(named) < len(elements) or any(
            parent == child or not {parent, child} <= known for parent, child in ends):
        return None  # other faults, which the reader of URDF refuses by name
    below: dict[str, list[str]] = {}
    for parent, child in ends:
        below.setdefault(parent, []).append(child)
    reached = list(roots)
    for link in reached:
        reached += below.get(link, [])
        if len(reached) > len(known):
            break
    if sorted(reached) == sorted(known):
        return None  # one path from the ground to every link: a tree
    joints = []
    for element in elements:
        where = f"{path}: joint {element.get('name')!r}"
        check_joint(element, path, faults)
        kind = element.get("type", "")
        refined = refinements.get(element.get("name", ""))
        pair = (refined.type if refined else None) or PAIR_OF_URDF_TYPE.get(kind, kind)
        if pair not in CONTAINED_PAIRS.get(kind, ()):
            return None  # which the reader of URDF refuses by name
        joints.append(_joint(element, pair, refined, where))
    needed = frozenset(named & set(_named(robot, content)))
    links = tuple(_link(element, set(_texts(content))) for element in robot.findall("link"))
    graph = JointGraph(links, tuple(joints), loose=False, needed=needed)
    return open_tree(graph, str(path), content, robot=robot)


def _joint(
    element: ET.Element, pair: str, refined: JointRefinement | None, where: str
) -> GraphJoint:
    axis, axis2 = joint_axes(PAIRS[pair], element, refined, where)
    dynamics, resistance = element.find("dynamics"), dict[str, Any]()
    if dynamics is not None:
        resistance = {key: float(dynamics.get(key, 0.0)) for key in ("damping", "friction")}
    for key, values in refined.resistances.items() if refined else ():
        if key != "slip_speed":
            resistance[key] = float(np.max(values))  # the largest of several
    joint = GraphJoint(
        element.get("name", ""), pair, end_of(element, "parent"), end_of(element, "child"),
        placement(element.find("origin"), where), axis=axis, axis2=axis2,
        lead=refined.lead if refined else 0.0, element=element, **resistance)
    limit = element.find("limit")
    if limit is None or element.get("type") not in LIMITED:
        return joint
    return joint.with_changes(
        lower=float(limit.get("lower", 0.0)), upper=float(limit.get("upper", 0.0)))


def _link(element: ET.Element, named: set[str]) -> Link:
    """Return a link; one that something refers to counts as a body, which stays."""
    values = [x.get(key, "0") for x in element.iterfind("inertial/*")
              for key in ("value", "ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    try:
        massless = element.get("name") not in named and not any(map(float, values))
    except ValueError:  # refused later
        massless = False
    return Link(element.get("name", ""), None, tuple(element), massless)


def _named(robot: ET.Element, content: Mapping[str, Any]) -> Iterator[str]:
    """Yield the joints whose coordinates something refers to."""
    for joint in robot.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            yield from (joint.get("name", ""), mimic.get("joint", ""))
    for transmission in robot.iterfind("transmission/joint"):
        yield transmission.get("name", "")
    yield from named_coordinates(content)


def named_coordinates(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield the joints whose coordinates a mechanism file refers to."""
    tables = [*content.get("closures", ()), *content.get("springs", ()),
              *content.get("drivers", {}).values()]
    texts = [text for table in tables for key in ("joint", "joints")
             for text in _texts(table.get(key) if isinstance(table, dict) else None)]
    for text in (*texts, *content.get("guess", {})):
        yield from (text, text.rpartition(".")[0])


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts in tables, lists and texts."""
    waiting = [value]
    while waiting:
        element = waiting.pop()
        if isinstance(element, str):
            yield element
        elif isinstance(element, dict | list | tuple):
            waiting += element.values() if isinstance(element, dict) else element
