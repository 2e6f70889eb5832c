"""The tree of a URDF: its links and joints, where they stand, and numbers of its elements."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.sources import shown
from spatial_pin.formats.urdf.checks import end_of, numbers, placement
from spatial_pin.formats.urdf.elements import URDF_AXIS, local
from spatial_pin.numerics.linalg import Array

PAIR_OF = {  # what dialects call a joint -> our pair
    "revolute": "revolute", "continuous": "revolute", "hinge": "revolute",
    "spherical": "spherical", "ball": "spherical", "fixed": "weld", "weld": "weld",
    "prismatic": "prismatic", "slider": "prismatic", "cylindrical": "cylindrical",
    "planar": "planar", "universal": "universal", "screw": "screw",
}


@dataclass
class Tree:
    """A robot element; what is asked of it fails with the file and the element.

    Attributes:
        robot: the URDF.
        path: where it comes from, for errors.
    """

    robot: ET.Element
    path: Path

    def fail(self, element: ET.Element | str, complaint: str) -> MechanismFileError:
        """Return the error about an element of the file."""
        return MechanismFileError(f"{self.where(element)}: {complaint}")

    def where(self, element: ET.Element | str) -> str:
        """Return file and element for errors."""
        return f"{shown(self.path)}: {element if isinstance(element, str) else said(element)}"

    @cached_property
    def links(self) -> dict[str, ET.Element]:
        """The links by name."""
        return {link.get("name", ""): link for link in self.robot.findall("link")}

    @cached_property
    def joints(self) -> dict[str, ET.Element]:
        """The joints of the tree by name."""
        return {joint.get("name", ""): joint for joint in self.robot.findall("joint")}

    @cached_property
    def above(self) -> dict[str, tuple[str, ET.Element]]:
        """Name and element of the joint that carries each link but the root."""
        return {end_of(joint, "child"): (name, joint) for name, joint in self.joints.items()}

    @cached_property
    def root(self) -> str:
        """The link without a parent."""
        return next((link for link in self.links if link not in self.above), "")

    def link(self, name: str | None, element: ET.Element | str) -> str:
        """Return the name of a link; refuse one that does not exist."""
        if not name or name not in self.links:
            raise self.fail(element, f"link {name or ''!r} does not exist; "
                                     f"{suggestion(name or '', self.links)}")
        return name

    def joint(self, name: str | None, element: ET.Element | str) -> ET.Element:
        """Return a joint of the tree; refuse a name that does not exist."""
        if not name or name not in self.joints:
            raise self.fail(element, f"joint {name or ''!r} does not exist; "
                                     f"{suggestion(name or '', self.joints)}")
        return self.joints[name]

    def placement(self, element: ET.Element | None, where: ET.Element) -> pin.SE3:
        """Return the placement that `xyz` and `rpy` of an element give, identity without."""
        return placement(element, self.where(where))

    def axis(self, element: ET.Element | None, where: ET.Element) -> Array:
        """Return the unit vector `xyz` of an element, URDF's default without."""
        if element is None or "xyz" not in element.attrib:
            return np.array(URDF_AXIS)
        return self.unit(numbers(element, "xyz", 3, self.where(where)), where)

    def texts(self, element: ET.Element, count: int, where: ET.Element) -> Array:
        """Return the `count` numbers in an element's text."""
        holder = ET.Element(local(element), text=(element.text or "").strip())
        return numbers(holder, "text", count, self.where(where))

    def number(self, element: ET.Element | None, where: ET.Element, default: float) -> float:
        """Return the number in an element's text, the default without an element."""
        return default if element is None else float(self.texts(element, 1, where)[0])

    def value(self, element: ET.Element, where: ET.Element) -> float:
        """Return the number that an element has as its `value`."""
        return float(numbers(element, "value", 1, self.where(where))[0])

    def unit(self, axis: Array, where: ET.Element | str) -> Array:
        """Return a direction at length 1; refuse one of no length."""
        norm = float(np.linalg.norm(axis))
        if not 0.0 < norm < np.inf:
            raise self.fail(where, f"its axis {axis} has no direction")
        return axis / norm

    def pair(self, element: ET.Element) -> str:
        """Return the pair of an element's `type`; refuse what closes no loop."""
        kind = element.get("type", "").removesuffix("_joint")
        if kind not in PAIR_OF:
            raise self.fail(element, f"a loop of type {kind!r} is not known; "
                                     f"{suggestion(kind, PAIR_OF)}")
        return PAIR_OF[kind]

    @cached_property
    def world(self) -> dict[str, pin.SE3]:
        """Where every link stands when every joint is at zero, in the root's axes."""
        placed: dict[str, pin.SE3] = {}
        for link in self.links:
            way: list[str] = []
            seen: set[str] = set()
            while link not in placed and link in self.above and link not in seen:
                way.append(link)
                seen.add(link)
                link = end_of(self.above[link][1], "parent")
            at = placed.setdefault(link, pin.SE3.Identity())
            for child in reversed(way):
                joint = self.above[child][1]
                at = placed[child] = at * self.placement(joint.find("origin"), joint)
        return placed

    def between(self, links: Sequence[str]) -> list[list[str]]:
        """Return the joints that move each of two links against the link that carries both."""
        ways: list[dict[str, ET.Element]] = []
        for link in links:
            way: dict[str, ET.Element] = {}
            while link in self.above and self.above[link][0] not in way:
                name, joint = self.above[link]
                way[name] = joint
                link = end_of(joint, "parent")
            ways.append(way)
        common = ways[0].keys() & ways[1].keys()
        return [[name for name, joint in way.items()
                 if name not in common and joint.get("type") != "fixed"] for way in ways]


def said(element: ET.Element) -> str:
    """Return how an element is named in messages."""
    name = element.get("name")
    return f"<{local(element)} name={name!r}>" if name else f"<{local(element)}>"
