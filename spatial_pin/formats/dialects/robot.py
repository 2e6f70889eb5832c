"""A URDF being read: its tree, numbers of its elements, and what its loops become."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.file_access import shown
from spatial_pin.formats.urdf.elements import URDF_AXIS, end_of, local, numbers, placement
from spatial_pin.mechanism.pairs import PAIRS, axes_from_z
from spatial_pin.numerics.linalg import Array

PAIR_OF = {  # what dialects call a joint -> our pair
    "revolute": "revolute", "continuous": "revolute", "hinge": "revolute",
    "spherical": "spherical", "ball": "spherical", "fixed": "weld", "weld": "weld",
    "prismatic": "prismatic", "slider": "prismatic", "cylindrical": "cylindrical",
    "planar": "planar", "universal": "universal", "screw": "screw",
}


class RobotTree:
    """A <robot> and where it comes from; its errors name the file and the element."""

    def __init__(self, robot: ET.Element, path: Path) -> None:
        self.robot, self.path = robot, path

    def fail(self, element: ET.Element | str, complaint: str) -> MechanismFileError:
        """Return the error about an element of the file."""
        return MechanismFileError(f"{self.where(element)}: {complaint}")

    def where(self, element: ET.Element | str) -> str:
        """Return file and element for errors."""
        return f"{shown(self.path)}: {element if isinstance(element, str) else words(element)}"

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
        """The placement of every link when all joints are at zero, in the root's axes."""
        placed: dict[str, pin.SE3] = {}
        for link in self.links:
            chain: list[str] = []
            seen: set[str] = set()
            while link not in placed and link in self.above and link not in seen:
                chain.append(link)
                seen.add(link)
                link = end_of(self.above[link][1], "parent")
            at = placed.setdefault(link, pin.SE3.Identity())
            for child in reversed(chain):
                joint = self.above[child][1]
                at = placed[child] = at * placement(joint.find("origin"), self.where(joint))
        return placed

    def between(self, links: Sequence[str]) -> list[list[str]]:
        """Return the joints that move each of two links against the link that carries both."""
        ways: list[dict[str, ET.Element]] = []
        for link in links:
            chain: dict[str, ET.Element] = {}
            while link in self.above and self.above[link][0] not in chain:
                name, joint = self.above[link]
                chain[name] = joint
                link = end_of(joint, "parent")
            ways.append(chain)
        common = ways[0].keys() & ways[1].keys()
        return [[name for name, joint in chain.items()
                 if name not in common and joint.get("type") != "fixed"] for chain in ways]


def words(element: ET.Element) -> str:
    """Return how an element is named in messages."""
    name = element.get("name")
    return f"<{local(element)} name={name!r}>" if name else f"<{local(element)}>"


class NumberedNames:
    """Names that must differ."""

    def __init__(self) -> None:
        self.taken: set[str] = set()
        self.last: Counter[str] = Counter()

    def free(self, name: str) -> str:
        """Take a name, with a number behind it if another has it already."""
        candidate = name
        if name in self.taken:
            self.last[name] = max(self.last[name], 1)
            candidate = self.numbered(name)
        self.taken.add(candidate)
        return candidate

    def numbered(self, name: str) -> str:
        """Return the next name with a number behind it that is not taken."""
        while True:
            self.last[name] += 1
            if f"{name}_{self.last[name]}" not in self.taken:
                return f"{name}_{self.last[name]}"


class RobotReading(RobotTree):
    """A robot element and its loops; the readers of the dialects add to it.

    Attributes:
        content: further tables of a mechanism file.
        names: those that are taken, of each list of the content, and of frames.
        notices: of changes and omissions, a sentence each.
        followers: joints that follow another, by files beside the tree.
        leaders: joints that others followed, before loops took the place of <mimic>.
        all_driven: whether the drivers are all that there are, by whoever stated them.
    """

    def __init__(self, robot: ET.Element, path: Path, notices: Iterable[str] = ()) -> None:
        super().__init__(robot, path)
        self.content: dict[str, Any] = {}
        self.notices = list(notices)
        self.followers: set[str] = set()
        self.leaders: set[str] = set()
        self.all_driven = False
        self.names: defaultdict[str, NumberedNames] = defaultdict(NumberedNames)
        self.names["frames"].taken.update(self.links, self.joints)

    def link_of(self, frame: str) -> str:
        """Return the link that a frame, or a joint's frame, is fixed to."""
        frame = self.content.get("frames", {}).get(frame, {}).get("link", frame)
        return end_of(self.joints[frame], "child") if frame not in self.links else frame

    def in_loops(self) -> set[str]:
        """Return the joints that the loops stated so far move."""
        loops: set[str] = set()
        for closure in self.content.get("closures", ()):
            if "frames" in closure:
                ends = [self.link_of(frame) for frame in closure["frames"]]
                loops.update(name for chain in self.between(ends) for name in chain)
        return loops

    def frame(self, link: str, placement: pin.SE3, name: str) -> str:
        """Put a frame on a link, under a name that nothing has yet; return the name."""
        name = self.names["frames"].free(name)
        self.content.setdefault("frames", {})[name] = {
            "link": link, "xyz": placement.translation.tolist(),
            "rpy": pin.rpy.matrixToRpy(placement.rotation).tolist()}
        return name

    def close(self, name: str, kind: str, source: str, ends: Sequence[tuple[str, pin.SE3]],
              axes: tuple[Array, Array] | None = None, **more: Any) -> None:
        """State a loop between two frames, each a link and a placement on it.

        The pair's axis is given in either frame, if it has one; `more` are further keys of the
        closure.
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
        """Add an entry to a list of the content, under a name that no other there has."""
        name = self.names[key].free(entry["name"])
        self.content.setdefault(key, []).append({**entry, "name": name})

    def put_link(self, name: str, elements: Iterable[ET.Element]) -> None:
        """Put a link with these elements beside the others."""
        link = ET.SubElement(self.robot, "link", name=name)
        link.extend(list(elements))
        self.links[name] = link
        self.names["frames"].taken.add(name)

    def put_joint(self, joint: ET.Element) -> None:
        """Make a joint of the robot one of the tree."""
        name = joint.get("name", "")
        self.joints[name] = joint
        self.names["frames"].taken.add(name)
        for made in ("above", "root", "world"):
            self.__dict__.pop(made, None)

    def couple(self, source: str, joint: str, ratio: float, offset: float, by: str) -> None:
        """Make a joint follow another, where the URDF itself or something before does not."""
        known = source in self.joints and joint in self.joints
        if known and joint not in self.followers and self.joints[joint].find("mimic") is None:
            self.followers.add(joint)
            self.content.get("drivers", {}).pop(joint, None)
            self.add("closures", {"name": f"mimic_{joint}", "type": "coupling", "source": by,
                                  "joints": [source, joint], "ratio": ratio, "offset": offset})

    def refine(self, joint: str, **keys: Any) -> None:
        """Add keys to the table of a tree joint; one with a `type` becomes floating in the URDF."""
        self.content.setdefault("joints", {}).setdefault(joint, {}).update(keys)
        if "type" in keys:
            element = self.joints[joint]
            element.set("type", "floating")
            for tag in ("axis", "limit", "mimic"):
                for child in element.findall(tag):
                    element.remove(child)

    def drop_mimics(self, joints: Iterable[str], why: str) -> None:
        """Remove the <mimic> of joints, with a notice."""
        dropped = {name: mimic for name in joints
                   if (mimic := self.joints[name].find("mimic")) is not None}
        for name, mimic in dropped.items():
            self.joints[name].remove(mimic)
            self.leaders.add(mimic.get("joint", ""))
        if dropped:
            self.notices.append(f"the <mimic> of {', '.join(dropped)} is left out: {why}")

    def drive(self, joint: str) -> None:
        """Make a joint a driver of its own name, unless it follows another."""
        if joint in self.followers:
            return
        self.content.setdefault("drivers", {})[joint] = {"joint": joint}

    def name_of(self, element: ET.Element, among: str = "closures") -> str:
        """Return an element's name, or one made of its tag and number."""
        tag = local(element)
        return element.get("name") or self.names[among].numbered(tag)

    def take(self, chosen: Callable[[ET.Element], bool]) -> Iterator[ET.Element]:
        """Yield the elements directly in the robot that are chosen, and take them out."""
        taken = [e for e in self.robot if isinstance(e.tag, str) and chosen(e)]
        if taken:
            self.robot[:] = [e for e in self.robot if not (isinstance(e.tag, str) and chosen(e))]
        yield from taken
