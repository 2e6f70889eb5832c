"""A spanning tree as a URDF, and its cut joints as the closures of a mechanism file.

So is a URDF whose links have several parents: a URDF holds a tree.
"""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import texts_in
from spatial_pin.formats.graph.joint_graph import WORLD, GraphJoint, JointGraph, Link, SpanningTree
from spatial_pin.formats.importers import Faults, Imported
from spatial_pin.formats.urdf.elements import (
    end_of,
    finite_text,
    fresh,
    joint_element,
    numbers_text,
    placement,
    unique,
)
from spatial_pin.formats.urdf.urdf_model import (
    CONTAINED_PAIRS,
    PAIR_OF_URDF_TYPE,
    JointRefinement,
    check_joint,
    check_structure,
    joint_axes,
    urdf_order,
)
from spatial_pin.mechanism.pairs import PAIRS, axes_from_z
from spatial_pin.numerics.linalg import whole_turns

LIMITED = ("revolute", "prismatic")  # URDF types that have limits of position
DRAWN = 100.0  # roundings of the file that links may be drawn away from their joints
BASE = "root_joint"  # the joint that lets a base float, as Pinocchio names it
GROUND = "world"  # the link for the world
SYMMETRIC = ("spherical", "planar", "floating", "universal")  # their coordinates have a direction
TWIN = 1e-9  # relative gap between two links that two fixed joints place
PLACED = ("origin", "parent", "child", "axis")  # children of a joint element that place it
RESISTANCES = ("damping", "friction", "armature")


def drawn(tree: SpanningTree) -> tuple[dict[str, Any], list[str]]:
    """Return the coordinates at which a file draws its links, and a notice of joints off there."""
    rounding, links = tree.graph.rounding, tree.graph.links
    at = {WORLD: pin.SE3.Identity(), **{link.name: link.placement for link in links}}
    positions = [x.translation for x in at.values() if x is not None]
    size = float(np.ptp(positions, axis=0).max()) or 1.0
    guess: dict[str, Any] = {}
    off: dict[str, float] = {}
    for joint in tree.joints:
        one, two = at[joint.parent], at[joint.child]
        if one is None or two is None:
            continue
        relative = (one * joint.on_parent).inverse() * two * joint.on_child
        values, reached = coordinates_at(joint, relative)
        gap = reached.inverse() * relative
        away = max(np.abs(gap.translation).max() / size, np.abs(pin.log3(gap.rotation)).max())
        if away > DRAWN * rounding:
            off[joint.name] = float(away)
        if max(map(abs, values), default=0.0) > 10.0 * rounding:
            guess[joint.name] = values if len(values) > 1 else values[0]
    if not off:
        return guess, []
    name = max(off, key=off.__getitem__)
    return guess, [f"links are not drawn where their joints hold them, at {len(off)} joints, most "
                   f"at {name!r}, by {off[name]:.2g} of the size or rad: the joints count"]


def coordinates_at(joint: GraphJoint, relative: pin.SE3) -> tuple[list[float], pin.SE3]:
    """Return a joint's coordinates nearest to a placement, and the placement that they give."""
    pair, shift = joint.type, relative.translation
    if pair in ("spherical", "floating"):
        vector = pin.log3(relative.rotation)
        if pair == "floating":
            return [*shift.tolist(), *vector.tolist()], relative
        return vector.tolist(), pin.SE3(pin.exp3(vector), np.zeros(3))
    if pair == "universal":
        one, two, third = joint.axis, joint.axis2, np.cross(joint.axis, joint.axis2)
        pin2, pin1 = relative.rotation @ two, relative.rotation.T @ one
        first = math.atan2(pin2 @ third, pin2 @ two)
        second = math.atan2(pin1 @ third, pin1 @ one)
        turn = pin.exp3(first * one) @ pin.exp3(second * two)
        return [first, second], pin.SE3(turn, np.zeros(3))
    across = axes_from_z(joint.axis)  # its z is the axis that all others turn about or slide along
    turned = across.T @ relative.rotation @ across
    x, y, slide = across.T @ shift
    angle = 0.0
    if pair not in ("fixed", "prismatic"):
        angle = math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
    if pair == "screw":
        if joint.lead:  # whole turns follow from the slide
            angle += whole_turns(2.0 * math.pi * slide / joint.lead - angle)
        slide = angle / (2.0 * math.pi) * joint.lead
    coordinates = {"fixed": [], "revolute": [angle], "screw": [angle], "prismatic": [slide],
                   "cylindrical": [angle, slide], "planar": [x, y, angle]}[pair]
    along = {"planar": [x, y, 0.0], "fixed": [0.0] * 3, "revolute": [0.0] * 3}.get(
        pair, [0.0, 0.0, slide])
    reached = pin.SE3(pin.exp3(angle * joint.axis), across @ np.array(along))
    return [float(value) for value in coordinates], reached


def open_tree(
    graph: JointGraph, where: str, content: Mapping[str, Any], notices: Iterable[str] = (),
    robot: ET.Element | None = None,
) -> Imported:
    """Return a joint graph as an open tree and closures.

    Tables are added to the `content` of a mechanism file, which has its name. Elements other than
    links and joints stay from the <robot> that the graph comes from, if any.
    """
    writer = _Writer(SpanningTree(graph), where, content)
    if robot is not None:
        writer.robot.attrib.update(robot.attrib)
        writer.robot.extend(x for x in robot if x.tag not in ("link", "joint"))
    writer.write()
    guess, off = drawn(writer.tree)
    ET.indent(writer.robot)
    gone = {joint.name for joint in writer.tree.cut}
    joints = {k: x for k, x in content.get("joints", {}).items() if k not in gone}
    joints |= {k: {**joints.get(k, {}), **x} for k, x in writer.joints.items()}
    merged = {**content, "joints": joints,
              "closures": [*content.get("closures", []), *writer.closures],
              "springs": [*content.get("springs", []), *writer.springs],
              "guess": {**guess, **content.get("guess", {})}}
    return Imported(writer.robot, merged,
                    (*notices, *writer.notices, *notices_of(writer, off)))


class _Writer:
    """Writes one spanning tree."""

    def __init__(self, tree: SpanningTree, where: str, given: Mapping[str, Any]) -> None:
        self.tree, self.graph, self.where, self.given = tree, tree.graph, where, given
        self.robot = ET.Element("robot", name=given["name"])
        self.links = {link.name: link for link in self.graph.links}
        self.taken = {"universe", *self.links, *(joint.name for joint in self.graph.joints),
                      *given.get("frames", {})}
        self.notices = list(tree.notices)
        self.joints: dict[str, dict[str, Any]] = {}
        self.closures: list[dict[str, Any]] = []
        self.springs: list[dict[str, Any]] = []
        self.bodies: dict[str, tuple[str, pin.SE3]] = {}  # link -> first link fixed to it, place
        self.ground = fresh(GROUND, self.taken)
        self.bases: list[str] = []
        self.lost: list[str] = []

    def write(self) -> None:
        """Write all of it."""
        if self.graph.loose:
            ET.SubElement(self.robot, "link", name=self.ground)
        self.bodies[WORLD] = ground = WORLD, pin.SE3.Identity()
        for link in self.graph.links:
            ET.SubElement(self.robot, "link", name=link.name).extend(link.elements)
        for root in self.tree.roots:
            self.bodies[root] = (root, ground[1]) if self.graph.loose else ground
            if self.graph.loose:
                self.base(self.links[root])
        for joint in self.tree.joints:
            self.joint(joint)
        for joint in self.tree.cut:
            self.closure(joint)

    def link_of(self, link: str) -> str:
        """Return the name of a link in the URDF."""
        return self.ground if link == WORLD else link

    def frame(self, wanted: str, link: str, placement: pin.SE3) -> str:
        """Return the name of a link at a placement on another, or of that link itself."""
        if placement.isIdentity(0.0):
            return self.link_of(link)
        name = fresh(wanted, self.taken)
        ET.SubElement(self.robot, "link", name=name)
        mount = fresh(f"{name}_mount", self.taken)
        joint_element(self.robot, mount, "fixed", self.link_of(link), name, placement)
        return name

    def base(self, root: Link) -> None:
        """Let a root float in the world, or hold it, where the file draws it."""
        name = fresh(BASE if root.name == self.tree.roots[0] else f"{BASE}_{root.name}", self.taken)
        placement = root.placement if root.placement is not None else pin.SE3.Identity()
        if self.graph.held:
            self.bodies[root.name] = WORLD, placement
        else:
            self.bases.append(f"link {root.name!r} (joint {name!r})")
        kind = "fixed" if self.graph.held else "floating"
        joint_element(self.robot, name, kind, self.ground, root.name, placement)

    def joint(self, joint: GraphJoint) -> None:
        """Write a joint of the tree, and what hangs on it."""
        turned = joint.name in self.tree.turned
        if turned and joint.type in SYMMETRIC:
            self.notices.append(
                f"joint {joint.name!r} is walked from {joint.parent!r} to {joint.child!r}, against "
                f"the file: its coordinates are those of the inverse motion")
        if joint.type == "fixed":
            body, on_body = self.bodies[joint.parent]
            on_parent = joint.on_parent * joint.on_child.inverse()
            self.bodies[joint.child] = body, on_body * on_parent
        else:
            on_parent = joint.on_parent
            self.bodies[joint.child] = joint.child, pin.SE3.Identity()
        if joint.element is not None and not turned:
            self.robot.append(copy.deepcopy(joint.element))
            return
        child = joint.child
        if joint.type != "fixed" and not joint.on_child.isIdentity(0.0):
            child = fresh(f"{joint.name}_frame", self.taken)
            ET.SubElement(self.robot, "link", name=child)
            mount = fresh(f"{child}_mount", self.taken)
            joint_element(self.robot, mount, "fixed", child, joint.child, joint.on_child.inverse())
        kind = _urdf_type(joint) if joint.element is None else joint.element.get("type", "")
        element = joint_element(self.robot, joint.name, kind, self.link_of(joint.parent), child,
                                on_parent)
        if kind == "floating" and joint.type != "floating":
            self.joints[joint.name] = _pair_table(joint)
        elif PAIRS[joint.type].uses_axis:
            ET.SubElement(element, "axis", xyz=numbers_text(joint.axis))
        if joint.element is None:
            self.describe(joint, element)
        else:
            element.extend(copy.deepcopy(x) for x in joint.element if x.tag not in PLACED)

    def describe(self, joint: GraphJoint, element: ET.Element) -> None:
        """Write limits, resistance and spring of a joint of the tree."""
        stated = (joint.lower, joint.upper, joint.effort, joint.velocity)
        if PAIRS[joint.type].freedom == 1 and any(map(math.isfinite, stated)):
            values = zip(("lower", "upper", "effort", "velocity"), stated, strict=True)
            ET.SubElement(element, "limit", {key: finite_text(x) for key, x in values})
        table = {key: getattr(joint, key) for key in RESISTANCES if getattr(joint, key)}
        if table:
            self.joints[joint.name] = {**self.joints.get(joint.name, {}), **table}
        if joint.stiffness:
            free = "free_length" if joint.type == "prismatic" else "free_angle"
            self.springs.append({"name": f"{joint.name}_spring", "joint": joint.name,
                                 "stiffness": joint.stiffness, free: joint.reference})

    def closure(self, joint: GraphJoint) -> None:
        """Write the closure that a cut joint becomes."""
        (one, on1), (two, on2) = self.bodies[joint.parent], self.bodies[joint.child]
        if one == two:
            self.check_redundant(joint, on1 * joint.on_parent, on2 * joint.on_child)
            self.notices.append(f"joint {joint.name!r} joins links that are fixed to each other "
                                "already: it is left out")
            return
        if joint.type == "floating":
            self.notices.append(f"joint {joint.name!r} is floating and closes a loop: it holds "
                                "nothing and is left out")
            return
        if joint.name in self.graph.needed:
            raise MechanismFileError(
                f"{self.where}: joint {joint.name!r} closes a loop and would be cut, but a driver, "
                "spring, coupling, mimic, transmission or guess refers to its coordinate, as to "
                "those of all other joints of the loop that could be cut; take one of them out")
        known = [table.get("name", "") for table in self.given.get("closures", ())
                 if isinstance(table, dict)]
        table: dict[str, Any] = {
            "name": unique(joint.name, known), "frames": [
                self.frame(f"{joint.name}_on_{self.link_of(link)}", link, placement)
                for link, placement in ((joint.parent, joint.on_parent),
                                        (joint.child, joint.on_child))
            ], **_pair_table(joint)}
        self.closures.append(table)
        lost = [f"{key} {getattr(joint, key):g}" for key in (*RESISTANCES, "stiffness")
                if getattr(joint, key)]
        if joint.is_limited:
            lost.append(f"limits {joint.lower:g} to {joint.upper:g}")
        if lost:
            self.lost.append(f"{joint.name!r} ({', '.join(lost)})")

    def check_redundant(self, joint: GraphJoint, one: pin.SE3, two: pin.SE3) -> None:
        """Refuse a fixed joint, its frame at `one` and `two`, that others hold otherwise."""
        gap = one.inverse() * two
        size = float(np.abs([one.translation, two.translation]).max()) or 1.0
        most = max(np.abs(gap.translation).max() / size, np.abs(gap.rotation - np.eye(3)).max())
        if joint.type == "fixed" and most > max(TWIN, 10.0 * self.graph.rounding):
            raise MechanismFileError(
                f"{self.where}: fixed joint {joint.name!r} holds {joint.child!r} on "
                f"{joint.parent!r} in another place than the other fixed joints do, by {most:.3g}")


def notices_of(writer: _Writer, off: Iterable[str]) -> Iterator[str]:
    """Yield notices of parallel joints, links that are drawn `off`, floating bases, and loops."""
    between: dict[frozenset[str], list[str]] = {}
    for joint in writer.graph.joints:
        between.setdefault(frozenset((joint.parent, joint.child)), []).append(joint.name)
    several = "; ".join(", ".join(x) for x in between.values() if len(x) > 1)
    if several:
        yield f"several joints join the same two links, and each of them holds: {several}"
    yield from off
    if writer.bases:
        yield f"not joined to the world, so that it floats there: {', '.join(writer.bases)}"
    yield from cut_notice(writer.closures)
    if writer.lost:
        yield f"a closure has no coordinate, so that this does not act: {', '.join(writer.lost)}"


def cut_notice(closures: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a notice of the joints that became closures, if there are any."""
    cut = [f"{table['name']!r} ({table['type']})" for table in closures]
    if len(cut) == 1:
        yield f"a loop is cut at joint {cut[0]}, which becomes a closure"
    elif cut:
        yield f"{len(cut)} loops are cut at the joints {', '.join(cut)}, which become closures"


def _urdf_type(joint: GraphJoint) -> str:
    """Return the URDF type that a joint is written with; "floating" for what URDF cannot say."""
    bounded = math.isfinite(joint.lower) or math.isfinite(joint.upper)
    if joint.type == "revolute":
        return "revolute" if bounded else "continuous"
    if joint.type == "prismatic":
        return "prismatic" if bounded else "floating"
    return joint.type if joint.type in ("fixed", "floating") else "floating"


def _pair_table(joint: GraphJoint) -> dict[str, Any]:
    """Return the table of a joint's pair in a mechanism file."""
    return {"type": "weld" if joint.type == "fixed" else joint.type,
            **PAIRS[joint.type].file_entries(joint.axis, joint.axis2, joint.lead, joint.length)}


def without_loops(
    robot: ET.Element, content: Mapping[str, Any], refinements: Mapping[str, JointRefinement],
    path: Path, faults: Faults,
) -> Imported | None:
    """Return a URDF with its loops cut, and their tables; None without loops or for other faults.

    Raises:
        MechanismFileError: links and joints are no graph, or something refers to the coordinate of
            every joint at which a loop could be cut.
    """
    check_structure(robot, path)
    elements = robot.findall("joint")
    children = {end_of(joint, "child") for joint in elements}
    if len(children) == len(elements) == len(urdf_order(robot)):
        return None  # no link has two parents, and each hangs on a root: a tree
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
    needed = frozenset(_named(robot, content)) & {joint.name for joint in joints}
    bodies = tuple(_link(element, set(texts_in(content))) for element in robot.findall("link"))
    graph = JointGraph(bodies, tuple(joints), loose=False, needed=needed)
    return open_tree(graph, str(path), content, robot=robot)


def _joint(
    element: ET.Element, pair: str, refined: JointRefinement | None, where: str
) -> GraphJoint:
    axis, axis2 = joint_axes(PAIRS[pair], element, refined, where)
    dynamics, resistance = element.find("dynamics"), dict[str, Any]()
    if dynamics is not None:
        resistance = {key: float(dynamics.get(key, 0.0)) for key in ("damping", "friction")}
    for key, values in refined.numbers.items() if refined else ():
        if key in RESISTANCES:
            resistance[key] = float(np.max(values))  # the largest of several
    joint = GraphJoint(
        element.get("name", ""), pair, end_of(element, "parent"), end_of(element, "child"),
        placement(element.find("origin"), where), axis=axis, axis2=axis2,
        lead=refined.lead if refined else 0.0, element=element, **resistance)
    limit = element.find("limit")
    if limit is None or element.get("type") not in LIMITED:
        return joint
    return replace(joint,
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
             for text in texts_in(table.get(key) if isinstance(table, dict) else None)]
    for text in (*texts, *content.get("guess", {})):
        yield from (text, text.rpartition(".")[0])
