"""A spanning tree as URDF text, and its cut joints as the closures of a mechanism file."""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.graph.joints import WORLD, Joint, JointGraph, Link
from spatial_pin.formats.graph.posture import drawn
from spatial_pin.formats.graph.spanning import SpanningTree, span
from spatial_pin.formats.imported import Imported
from spatial_pin.formats.urdf.elements import finite_text, joint_element, numbers_text
from spatial_pin.formats.urdf.writing import fresh, unique
from spatial_pin.mechanism.pairs import PAIRS

BASE = "root_joint"  # the joint that lets a base float, as Pinocchio names it
GROUND = "world"  # the link that stands for the world
SYMMETRIC = ("spherical", "planar", "floating", "universal")  # their coordinates have a direction
TWIN = 1e-9  # relative gap between two links that two fixed joints place
PLACED = ("origin", "parent", "child", "axis")  # of a joint element, what it is placed by
RESISTANCES = ("damping", "friction", "armature")


def open_tree(
    graph: JointGraph, where: str, content: Mapping[str, Any], notices: Iterable[str] = (),
    robot: ET.Element | None = None,
) -> Imported:
    """Return a joint graph as an open tree and closures.

    Args:
        graph: links and joints.
        where: the file, for errors.
        content: what a mechanism file says beside it, and its name; it is added to.
        notices: of what was read.
        robot: the <robot> that it comes from; what is neither link nor joint is kept.

    Raises:
        MechanismFileError: two fixed joints hold a link in two places, or something refers to the
            coordinate of every joint at which a loop could be cut.
    """
    writer = _Writer(span(graph), where, content)
    if robot is not None:
        writer.robot.attrib.update(robot.attrib)
        writer.robot.extend(x for x in robot if x.tag not in ("link", "joint"))
    writer.write()
    ET.indent(writer.robot)
    return Imported(ET.tostring(writer.robot, encoding="unicode"), writer.merged(),
                    (*notices, *writer.notices))


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
        self.guess: dict[str, Any] = {}
        self.bodies: dict[str, tuple[str, pin.SE3]] = {}  # link -> first link fixed to it, place
        self.ground = self.fresh(GROUND)
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
        self.tell_parallel()
        self.guess, off = drawn(self.tree)
        self.notices += off
        if self.bases:
            self.notices.append(f"not joined to the world, so that it floats there: "
                                f"{', '.join(self.bases)}")
        self.tell_cut()

    # ------------------------------------------------------------ names

    def fresh(self, wanted: str) -> str:
        """Return a name that no link or joint has."""
        return fresh(wanted, self.taken)

    def link_of(self, link: str) -> str:
        """Return the name of a link in the URDF."""
        return self.ground if link == WORLD else link

    # ------------------------------------------------------------ elements

    def frame(self, wanted: str, link: str, place: pin.SE3) -> str:
        """Return the name of a link that stands at a place on another, that itself if it does."""
        if place.isIdentity(0.0):
            return self.link_of(link)
        name = self.fresh(wanted)
        ET.SubElement(self.robot, "link", name=name)
        joint_element(self.robot, self.fresh(f"{name}_mount"), "fixed", self.link_of(link), name,
                      place)
        return name

    def base(self, root: Link) -> None:
        """Let a root float in the world, or hold it, where the file draws it."""
        name = self.fresh(BASE if root.name == self.tree.roots[0] else f"{BASE}_{root.name}")
        place = root.placement if root.placement is not None else pin.SE3.Identity()
        kind = "fixed" if self.graph.held else "floating"
        joint_element(self.robot, name, kind, self.ground, root.name, place)
        if kind == "floating":
            self.bases.append(f"link {root.name!r} (joint {name!r})")
        else:
            self.bodies[root.name] = WORLD, place

    # ------------------------------------------------------------ joints of the tree

    def joint(self, joint: Joint) -> None:
        """Write a joint of the tree, and what hangs on it."""
        turned = joint.name in self.tree.turned
        if turned and joint.type in SYMMETRIC:
            self.notices.append(
                f"joint {joint.name!r} is walked from {joint.parent!r} to {joint.child!r}, against "
                f"the file: its coordinates are those of the inverse motion")
        if joint.type == "fixed":
            body, place = self.bodies[joint.parent]
            on_parent = joint.on_parent * joint.on_child.inverse()
            self.bodies[joint.child] = body, place * on_parent
        else:
            on_parent = joint.on_parent
            self.bodies[joint.child] = joint.child, pin.SE3.Identity()
        if joint.element is not None and not turned:
            self.robot.append(copy.deepcopy(joint.element))
            return
        child = joint.child
        if joint.type != "fixed" and not joint.on_child.isIdentity(0.0):
            child = self.fresh(f"{joint.name}_frame")
            ET.SubElement(self.robot, "link", name=child)
            joint_element(self.robot, self.fresh(f"{child}_mount"), "fixed", child, joint.child,
                          joint.on_child.inverse())
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

    def describe(self, joint: Joint, element: ET.Element) -> None:
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

    # ------------------------------------------------------------ cut joints

    def closure(self, joint: Joint) -> None:
        """Write the closure that a cut joint becomes."""
        (one, place1), (two, place2) = self.bodies[joint.parent], self.bodies[joint.child]
        if one == two:
            self.redundant(joint, place1 * joint.on_parent, place2 * joint.on_child)
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
                self.frame(f"{joint.name}_on_{self.link_of(link)}", link, place)
                for link, place in ((joint.parent, joint.on_parent), (joint.child, joint.on_child))
            ], **_pair_table(joint)}
        self.closures.append(table)
        lost = _lost(joint)
        if lost:
            self.lost.append(f"{joint.name!r} ({', '.join(lost)})")

    def redundant(self, joint: Joint, one: pin.SE3, two: pin.SE3) -> None:
        """Tell of a joint between links that are fixed to each other.

        Args:
            joint: the joint.
            one: placement of its frame on the body of both, by its parent.
            two: the same by its child.

        Raises:
            MechanismFileError: it is fixed, too, and holds them otherwise.
        """
        gap = one.inverse() * two
        size = float(np.abs([one.translation, two.translation]).max()) or 1.0
        most = max(np.abs(gap.translation).max() / size, np.abs(gap.rotation - np.eye(3)).max())
        if joint.type == "fixed" and most > max(TWIN, 10.0 * self.graph.rounding):
            raise MechanismFileError(
                f"{self.where}: fixed joint {joint.name!r} holds {joint.child!r} on "
                f"{joint.parent!r} in another place than the other fixed joints do, by {most:.3g}")
        self.notices.append(f"joint {joint.name!r} joins links that are fixed to each other "
                            "already: it is left out")

    def tell_parallel(self) -> None:
        """Tell of several joints between the same two links: each of them holds."""
        between: dict[frozenset[str], list[str]] = {}
        for joint in self.graph.joints:
            between.setdefault(frozenset((joint.parent, joint.child)), []).append(joint.name)
        several = "; ".join(", ".join(x) for x in between.values() if len(x) > 1)
        if several:
            self.notices.append("several joints join the same two links, and each of them holds: "
                                f"{several}")

    def tell_cut(self) -> None:
        """Tell which joints are cut."""
        cut = [f"{table['name']!r} ({table['type']})" for table in self.closures]
        if len(cut) == 1:
            self.notices.append(f"a loop is cut at joint {cut[0]}, which becomes a closure")
        elif cut:
            self.notices.append(f"{len(cut)} loops are cut at the joints {', '.join(cut)}, which "
                                "become closures")
        if self.lost:
            self.notices.append("a closure has no coordinate, so that this does not act: "
                                f"{', '.join(self.lost)}")

    def merged(self) -> dict[str, Any]:
        """Return what a mechanism file says, with what is new."""
        gone = {joint.name for joint in self.tree.cut}
        given = {k: x for k, x in self.given.get("joints", {}).items() if k not in gone}
        joints = {**given, **{k: {**given.get(k, {}), **x} for k, x in self.joints.items()}}
        merged = {**self.given, "joints": joints}
        for key, new in (("closures", self.closures), ("springs", self.springs)):
            merged[key] = [*self.given.get(key, []), *new]
        merged["guess"] = {**self.guess, **self.given.get("guess", {})}
        return merged


def _urdf_type(joint: Joint) -> str:
    """Return the URDF type that a joint is written with; "floating" for what URDF cannot say."""
    bounded = math.isfinite(joint.lower) or math.isfinite(joint.upper)
    if joint.type == "revolute":
        return "revolute" if bounded else "continuous"
    if joint.type == "prismatic":
        return "prismatic" if bounded else "floating"
    return joint.type if joint.type in ("fixed", "floating") else "floating"


def _pair_table(joint: Joint) -> dict[str, Any]:
    """Return what a mechanism file says of a joint's pair."""
    return {"type": "weld" if joint.type == "fixed" else joint.type,
            **PAIRS[joint.type].told(joint.axis, joint.axis2, joint.lead, joint.length)}


def _lost(joint: Joint) -> list[str]:
    """Return what a closure cannot have of a joint."""
    lost = [f"{key} {getattr(joint, key):g}" for key in (*RESISTANCES, "stiffness")
            if getattr(joint, key)]
    if joint.is_limited:
        lost.append(f"limits {joint.lower:g} to {joint.upper:g}")
    return lost
