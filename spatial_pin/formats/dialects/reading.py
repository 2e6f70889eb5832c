"""A URDF being read: what its loops become, and where they are attached."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.linalg import Array
from spatial_pin.mechanism.pairs import PAIRS, axes_from_z
from spatial_pin.mechanism.sources import shown
from spatial_pin.mechanism.urdf_checks import numbers

PAIR_OF = {  # what dialects call a joint -> our pair
    "revolute": "revolute", "continuous": "revolute", "hinge": "revolute",
    "spherical": "spherical", "ball": "spherical", "fixed": "weld", "weld": "weld",
    "prismatic": "prismatic", "slider": "prismatic", "cylindrical": "cylindrical",
    "planar": "planar", "universal": "universal", "screw": "screw",
}
URDF_AXIS = (1.0, 0.0, 0.0)  # of a joint without <axis>, in URDF and what extends it


@dataclass
class Reading:
    """A robot element, and what is found in it; the readers of the dialects write on it.

    Attributes:
        robot: the URDF; elements that were read are taken out.
        path: where it comes from, for errors.
        content: what a mechanism file would say beside it.
        notices: what was changed or left out, a sentence each.
    """

    robot: ET.Element
    path: Path
    content: dict[str, Any] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)

    def fail(self, element: ET.Element | str, complaint: str) -> MechanismFileError:
        """Return the error about an element of the file."""
        what = element if isinstance(element, str) else said(element)
        return MechanismFileError(f"{shown(self.path)}: {what}: {complaint}")

    # ------------------------------------------------------------ what there is

    @property
    def links(self) -> list[str]:
        """Names of all links."""
        return [link.get("name", "") for link in self.robot.findall("link")]

    @property
    def joints(self) -> dict[str, ET.Element]:
        """The joints of the tree by name."""
        return {joint.get("name", ""): joint for joint in self.robot.findall("joint")}

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

    def root(self) -> str:
        """Return the link without a parent."""
        children = {end(joint, "child") for joint in self.joints.values()}
        return next((link for link in self.links if link not in children), "")

    def placement(self, element: ET.Element | None, where: ET.Element) -> pin.SE3:
        """Return the placement that `xyz` and `rpy` of an element give, identity without."""
        if element is None:
            return pin.SE3.Identity()
        here = f"{shown(self.path)}: {said(where)}"
        xyz, rpy = (numbers(element, key, 3, here) if key in element.attrib else np.zeros(3)
                    for key in ("xyz", "rpy"))
        return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)

    def axis(self, element: ET.Element | None, where: ET.Element) -> Array:
        """Return the unit vector `xyz` of an element, URDF's default without."""
        if element is None or "xyz" not in element.attrib:
            return np.array(URDF_AXIS)
        return self.unit(numbers(element, "xyz", 3, f"{shown(self.path)}: {said(where)}"), where)

    def unit(self, axis: Array, where: ET.Element | str) -> Array:
        """Return a direction at length 1; refuse one of no length."""
        norm = float(np.linalg.norm(axis))
        if not 0.0 < norm < np.inf:
            raise self.fail(where, f"its axis {axis} has no direction")
        return axis / norm

    def pair(self, element: ET.Element) -> str:
        """Return the pair of an element's `type`; refuse what closes no loop."""
        kind = element.get("type", "")
        if kind not in PAIR_OF:
            raise self.fail(element, f"a loop of type {kind!r} is not known; "
                                     f"{suggestion(kind, PAIR_OF)}")
        return PAIR_OF[kind]

    def world(self) -> dict[str, pin.SE3]:
        """Return where every link stands when every joint is at zero, in the root's axes."""
        above = {end(joint, "child"): joint for joint in self.joints.values()}
        placed: dict[str, pin.SE3] = {}
        for link in self.links:
            way: list[str] = []
            while link not in placed and link in above and link not in way:
                way.append(link)
                link = end(above[link], "parent")
            at = placed.setdefault(link, pin.SE3.Identity())
            for child in reversed(way):
                joint = above[child]
                at = placed[child] = at * self.placement(joint.find("origin"), joint)
        return placed

    def between(self, links: Sequence[str]) -> list[list[str]]:
        """Return the joints that move each of two links against the link that carries both."""
        joints = self.joints
        above = {end(joint, "child"): (name, joint) for name, joint in joints.items()}
        ways: list[list[str]] = []
        for link in links:
            way: list[str] = []
            while link in above and above[link][0] not in way:
                name, joint = above[link]
                way.append(name)
                link = end(joint, "parent")
            ways.append(way)
        common = {name for name in ways[0] if name in ways[1]}
        return [[name for name in way if name not in common
                 and joints[name].get("type") != "fixed"] for way in ways]

    # ------------------------------------------------------------ what is made of it

    def frame(self, link: str, placement: pin.SE3, name: str) -> str:
        """Put a frame on a link, under a name that nothing has yet; return the name."""
        frames = self.content.setdefault("frames", {})
        taken = {*self.links, *self.joints, *frames}
        numbered = (f"{name}_{k}" for k in count(2))
        name = next(x for x in chain((name,), numbered) if x not in taken)
        frames[name] = {"link": link, "xyz": placement.translation.tolist(),
                        "rpy": pin.rpy.matrixToRpy(placement.rotation).tolist()}
        return name

    def close(self, name: str, kind: str, source: str, ends: Sequence[tuple[str, pin.SE3]],
              axes: tuple[Array, Array] | None = None, **more: Any) -> None:
        """State a loop.

        Args:
            name: of the closure.
            kind: its type.
            source: where it is stated, for whoever asks.
            ends: link and placement of the two frames that it joins.
            axes: the pair's axis in either frame, for pairs that have one.
            **more: further keys of the closure.
        """
        if axes is not None and PAIRS[kind].uses_axis:
            if np.array_equal(*axes):
                more["axis"] = axes[0].tolist()
            else:  # the pair's axis becomes z of either frame
                ends = [(link, placement * pin.SE3(axes_from_z(axis), np.zeros(3)))
                        for (link, placement), axis in zip(ends, axes, strict=True)]
        frames = [self.frame(link, placement, f"{name}_{k}")
                  for k, (link, placement) in enumerate(ends, start=1)]
        self.add("closures", {"name": name, "type": kind, "frames": frames, "source": source,
                              **more})

    def add(self, key: str, entry: dict[str, Any]) -> None:
        """Add an entry to a list of the content."""
        self.content.setdefault(key, []).append(entry)

    def refine(self, joint: str, **keys: Any) -> None:
        """Say more of a joint of the tree; one with a `type` becomes floating in the URDF."""
        self.content.setdefault("joints", {}).setdefault(joint, {}).update(keys)
        if "type" in keys:
            element = self.joints[joint]
            element.set("type", "floating")
            for tag in ("axis", "limit", "mimic"):
                for child in element.findall(tag):
                    element.remove(child)

    def drive(self, joint: str) -> None:
        """Make a joint a driver of its own name."""
        self.content.setdefault("drivers", {})[joint] = {"joint": joint}

    def name_of(self, element: ET.Element) -> str:
        """Return an element's name, or one that says what and the how manieth it is."""
        if element.get("name"):
            return element.get("name", "")
        tag = local(element)
        names = {closure["name"] for closure in self.content.get("closures", ())}
        return next(x for x in (f"{tag}_{k}" for k in count(1)) if x not in names)

    def take(self, chosen: Callable[[ET.Element], bool]) -> Iterator[ET.Element]:
        """Yield the elements directly in the robot that are chosen, and take them out."""
        for element in [e for e in self.robot if isinstance(e.tag, str) and chosen(e)]:
            yield element
            self.robot.remove(element)


def local(element: ET.Element) -> str:
    """Return an element's name without its namespace."""
    return str(element.tag).rpartition("}")[2]


def said(element: ET.Element) -> str:
    """Return how an element is named in messages."""
    name = element.get("name")
    return f"<{local(element)} name={name!r}>" if name else f"<{local(element)}>"


def end(joint: ET.Element, role: str) -> str:
    """Return the link of <parent> or <child>."""
    element = joint.find(role)
    return element.get("link", "") if element is not None else ""

