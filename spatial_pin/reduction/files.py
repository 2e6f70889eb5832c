"""A reduced mechanism as files: the URDF of the full one with parts taken out, frames put in."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pinocchio as pin

from spatial_pin.formats.export import robot_of
from spatial_pin.formats.urdf.checks import end_of
from spatial_pin.formats.urdf.elements import joint_element, origin
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.reduction.links import Place, Relation


@dataclass
class Tree:
    """What is to become of the open tree.

    Attributes:
        mechanism: the full mechanism.
        q: (nq,) configuration in which joints are welded.
        moving: joints that stay.
        welded: joints that become fixed.
        links: links and frames that something refers to.
        weighed: links that keep their inertia; None for all.
    """

    mechanism: Mechanism
    q: Array
    moving: frozenset[int]
    welded: frozenset[int]
    links: set[str]
    weighed: frozenset[str] | None
    _added: list[tuple[str, int, pin.SE3, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._data = self.mechanism.model.createData()
        pin.forwardKinematics(self.mechanism.model, self._data, self.q)
        self.robot = robot_of(self.mechanism)
        self._joint_above = {end_of(j, "child"): j for j in self.robot.findall("joint")}
        self._taken = {e.get("name", "") for tag in ("link", "joint")
                       for e in self.robot.findall(tag)}
        self._body = {j.get("name", ""): end_of(j, "child") for j in self.robot.findall("joint")}
        links = [link.get("name", "") for link in self.robot.findall("link")]
        self.root = next(link for link in links if link not in self._joint_above)

    def add(self, wanted: str, place: Place, mass: float = 0.0) -> str:
        """Put a frame on a body, with a point mass if there is one; return its name."""
        name, k = wanted, 2
        while {name, f"{name}_mount"} & self._taken:
            name, k = f"{wanted}_{k}", k + 1
        self._taken |= {name, f"{name}_mount"}
        self._added.append((name, place.body, place.placement, mass))
        return name

    def body(self, joint: int) -> str:
        """Return the link that hangs on a joint of the tree, the root for 0."""
        return self._body[self.mechanism.model.names[joint]] if joint else self.root

    def kept_links(self) -> set[str]:
        """Return the links that stay: bodies, what is referred to, and what carries these."""
        wanted = {self.root, *self.links}
        wanted |= {self.body(i) for i in (*self.moving, *self.welded)}
        if self.weighed is None:
            on = {0, *self.moving, *self.welded}
            wanted |= {name for name in self.mechanism.inertias
                       if self.mechanism.frame_on_joint(name)[0] in on}
        wanted |= {self.body(place) for _, place, _, _ in self._added}
        kept: set[str] = set()
        for link in wanted:
            while link not in kept:
                kept.add(link)
                above = self._joint_above.get(link)
                if above is None:
                    break
                link = end_of(above, "parent")
        return kept

    def text(self) -> str:
        """Return the URDF."""
        kept = self.kept_links()
        robot = ET.Element("robot", name=self.robot.get("name", self.mechanism.name))
        for link in self.robot.findall("link"):
            if link.get("name") in kept:
                robot.append(self._link(link))
        for joint in self.robot.findall("joint"):
            if end_of(joint, "child") in kept:
                robot.append(self._joint(joint))
        for name, body, placement, mass in self._added:
            robot.extend(_frame(name, self.body(body), placement, mass))
        ET.indent(robot)
        return ET.tostring(robot, encoding="unicode")

    def _link(self, link: ET.Element) -> ET.Element:
        name = link.get("name", "")
        out = ET.Element("link", name=name)
        inertial = link.find("inertial")
        if inertial is not None and (self.weighed is None or name in self.weighed):
            out.append(copy.deepcopy(inertial))
        return out

    def _joint(self, joint: ET.Element) -> ET.Element:
        model, name = self.mechanism.model, joint.get("name", "")
        out = copy.deepcopy(joint)
        for mimic in out.findall("mimic"):
            out.remove(mimic)
        if not model.existJointName(name) or model.getJointId(name) in self.moving:
            return out
        i = model.getJointId(name)
        parent, child = end_of(joint, "parent"), end_of(joint, "child")
        _, on = self.mechanism.frame_on_joint(parent)
        return joint_element(ET.Element("robot"), name, "fixed", parent, child,
                             on.actInv(self._data.liMi[i]))


def _frame(name: str, on: str, placement: pin.SE3, mass: float) -> Sequence[ET.Element]:
    link = ET.Element("link", name=name)
    if mass > 0.0:
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value=repr(mass))
        zeros = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0.0")
        ET.SubElement(inertial, "inertia", zeros)
    joint = ET.Element("joint", name=f"{name}_mount", type="fixed")
    ET.SubElement(joint, "parent", link=on)
    ET.SubElement(joint, "child", link=name)
    joint.append(origin(placement))
    return link, joint


def relation_table(
    name: str, made: Relation, frames: Sequence[str], between: Sequence[str]
) -> Mapping[str, Any]:
    """Return a relation as the closure of a mechanism file, between z axes of its frames."""
    table: dict[str, Any] = {"name": name, "type": made.type, "frames": list(frames)}
    if made.type == "universal":
        table.update(axis=[0.0, 0.0, 1.0], axis2=[0.0, 0.0, 1.0])
    if between:
        table["length_between"] = list(between)
    elif made.type == "distance":
        table["length"] = made.length
    return table
