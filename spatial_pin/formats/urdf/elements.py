"""Elements of URDF: reading, writing with all digits, leaving out."""

from __future__ import annotations

import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.numerics.linalg import Array

URDF_AXIS = (1.0, 0.0, 0.0)  # of a joint without <axis>, in URDF and what extends it
UNBOUNDED = sys.float_info.max  # of a limit: URDF readers take no infinite one
BODIES = ("link", "body", "model", "robot", "world")  # which joints of the same name are not


def local(element: ET.Element) -> str:
    """Return an element's name without its namespace."""
    return str(element.tag).rpartition("}")[2]


def is_prefixed(element: ET.Element) -> bool:
    """Return whether an element's name carries a prefix, as that of Drake's elements does."""
    return "}" in str(element.tag)


def finite_numbers(text: str, count: int) -> Array:
    """Return the `count` finite numbers of a text."""
    try:  # 1_0, and digits of other scripts, are numbers to Python only
        values = np.array([float(word) if word.isascii() and "_" not in word else math.nan
                           for word in text.split()])
    except ValueError:
        values = np.array([math.nan])
    if values.size != count or not np.all(np.isfinite(values)):
        raise ValueError("one finite number" if count == 1 else f"{count} finite numbers")
    return values


def numbers_text(values: Array) -> str:
    """Return numbers as URDF has them, with all digits."""
    return " ".join(repr(float(x) + 0.0) for x in values)


def finite_text(value: float) -> str:
    """Return a limit; URDF has no infinity."""
    return repr(math.copysign(min(abs(float(value)), UNBOUNDED), value))


def origin(placement: pin.SE3) -> ET.Element:
    """Return the <origin> of a placement."""
    return ET.Element("origin", xyz=numbers_text(placement.translation),
                      rpy=numbers_text(pin.rpy.matrixToRpy(placement.rotation)))


def inertial(inertia: pin.Inertia) -> ET.Element:
    """Return the <inertial> of an inertia in its link's frame."""
    element = ET.Element("inertial")
    element.append(origin(pin.SE3(np.eye(3), inertia.lever)))
    ET.SubElement(element, "mass", value=repr(float(inertia.mass)))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia.tolist()
    parts = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ET.SubElement(element, "inertia", {key: repr(x) for key, x in parts.items()})
    return element


def shape_element(
    kind: str, placement: pin.SE3, solid: ET.Element, rgba: Array | None = None, material: str = "",
    *, overrides: bool = False, **attributes: str,
) -> ET.Element:
    """Return a <visual> or <collision>; a colour (4,) that overrides goes before a mesh's."""
    shape = ET.Element(kind, attributes)
    shape.append(origin(placement))
    ET.SubElement(shape, "geometry").append(solid)
    if rgba is not None:
        more = {"override": "true"} if overrides else {}
        painted = ET.SubElement(shape, "material", {"name": material, **more})
        ET.SubElement(painted, "color", rgba=numbers_text(rgba))
    return shape


def joint_element(
    robot: ET.Element, name: str, kind: str, parent: str, child: str,
    placement: pin.SE3 | None = None,
) -> ET.Element:
    """Add a joint between two links to a <robot>, and return it."""
    element = ET.SubElement(robot, "joint", name=name, type=kind)
    if placement is not None:
        element.append(origin(placement))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    return element


class UrdfTree:
    """A URDF, its `robot`, that grows link by link and joint by joint; names are made unique."""

    def __init__(self, name: str, root: str, reserved: Iterable[str] = ()) -> None:
        self.robot = ET.Element("robot", name=name)
        self._reserved = set(reserved)
        self._links: dict[str, ET.Element] = {}
        self._joints: set[str] = set()
        self._link(root)

    def _link(self, wanted: str) -> str:
        name = unique(wanted, self._links)
        self._links[name] = ET.SubElement(self.robot, "link", name=name)
        return name

    def joint(
        self, wanted: str, kind: str, parent: str, child: str, placement: pin.SE3,
        axis: Array | None = None, limits: Array | None = None,
    ) -> tuple[str, str]:
        """Add a joint of a URDF type and the link that it carries; return the names of both.

        A number is added to a name that is taken. The axis is a unit vector in the joint's frame;
        limits are (2,) [rad or m].
        """
        name, link = unique(wanted, self._joints), self._link(child)
        self._joints.add(name)
        joint = joint_element(self.robot, name, kind, parent, link, placement)
        if axis is not None:
            ET.SubElement(joint, "axis", xyz=numbers_text(axis))
        if limits is not None:
            ET.SubElement(joint, "limit", lower=repr(float(limits[0])),
                          upper=repr(float(limits[1])), effort=repr(UNBOUNDED),
                          velocity=repr(UNBOUNDED))
        return name, link

    def frame(self, wanted: str, parent: str, placement: pin.SE3) -> str:
        """Add a link on a fixed joint and return its name."""
        name = unique(wanted, self._reserved)
        return self.fixed(parent, name, placement)

    def fixed(self, parent: str, child: str, placement: pin.SE3) -> str:
        """Add a link of a name that may be reserved on a fixed joint, and return its name."""
        joint = unique(f"{child}_fixed", self._reserved)
        return self.joint(joint, "fixed", parent, child, placement)[1]

    def add(self, link: str, element: ET.Element) -> None:
        """Give a link an inertia or a shape."""
        self._links[link].append(element)


def unique(wanted: str, taken: Collection[str]) -> str:
    """Return a name that is not taken: the wanted one, or that with a number."""
    name, k = wanted, 2
    while name in taken:
        name, k = f"{wanted}_{k}", k + 1
    return name


def fresh(wanted: str, taken: set[str]) -> str:
    """Return a name that is not taken as `unique` does, and take it."""
    name = unique(wanted, taken)
    taken.add(name)
    return name


def without_it(element: ET.Element) -> str:
    """Return the remedy of a message that an element cannot be read."""
    return go_on(element.get("name") or local(element))


def go_on(name: str) -> str:
    """Return the remedy of a message that an element of a name cannot be read."""
    return f"load(..., without=[{name!r}]) goes on without it"


def leave_out(root: ET.Element, names: Iterable[str], where: str) -> list[str]:
    """Take elements out of XML by names or tags, not links and bodies; return a notice."""
    wanted = dict.fromkeys(names)
    matches: dict[str, list[str]] = {name: [] for name in wanted}
    known: dict[str, None] = {}
    for parent in list(root.iter()) if wanted else ():
        for element in list(parent):
            if not isinstance(element.tag, str) or local(element) in BODIES:
                continue
            own = [x for x in (element.get("name"), local(element)) if x]
            known.update(dict.fromkeys(own))
            for name in set(own) & wanted.keys():
                matches[name].append(local(element))
                if element in list(parent):
                    parent.remove(element)
    return notice_of(matches, known, where)


def notice_of(matches: dict[str, list[str]], known: Iterable[str], where: str) -> list[str]:
    """Return a notice of the elements that were left out; none without any."""
    for name, kinds in matches.items():
        if not kinds:
            raise MechanismFileError(f"{where}: without: there is no element or joint {name!r}; "
                                     f"{suggestion(name, known)}")
    parts = [f"{name!r} ({', '.join(sorted(set(kinds)))})" for name, kinds in matches.items()]
    return [f"left out by load(..., without=...): {', '.join(parts)}"] if parts else []


def by_name(elements: list[ET.Element], kind: str, where: Path | str) -> dict[str, ET.Element]:
    """Return elements by their names."""
    names: dict[str, ET.Element] = {}
    for element in elements:
        name = element.get("name", "")
        if not name or name in names:
            what = f"two {kind}s are named {name!r}" if name else f"a <{kind}> has no name"
            raise MechanismFileError(f"{where}: {what}")
        names[name] = element
    return names


def end_of(joint: ET.Element, role: str) -> str:
    """Return the link at one end of a joint, its "parent" or "child"; "" where there is none."""
    element = joint.find(role)
    return element.get("link", "") if element is not None else ""


def numbers(element: ET.Element, attribute: str, count: int, where: str) -> Array:
    """Return the `count` numbers of an attribute."""
    text = element.get(attribute, "")
    try:
        return finite_numbers(text, count)
    except ValueError as wanted:
        used = next((x for x in ("${...}", "$(...)") if x[:2] in text), "")
        hint = f"; {used} is xacro's: name the file .urdf.xacro" if used else ""
        raise MechanismFileError(
            f"{where}: <{local(element)} {attribute}={text!r}> needs {wanted}{hint}") from None


def placement(element: ET.Element | None, where: str) -> pin.SE3:
    """Return the placement that an <origin> gives; none is the identity."""
    if element is None:
        return pin.SE3.Identity()
    xyz = numbers(element, "xyz", 3, where) if "xyz" in element.attrib else np.zeros(3)
    rpy = numbers(element, "rpy", 3, where) if "rpy" in element.attrib else np.zeros(3)
    (sa, ca), (sb, cb), (sc, cc) = ((math.sin(x), math.cos(x)) for x in (0.5 * rpy).tolist())
    w, x = ca * cb * cc + sa * sb * sc, sa * cb * cc - ca * sb * sc
    y, z = ca * sb * cc + sa * cb * sc, ca * cb * sc - sa * sb * cc
    norm = math.sqrt(x * x + y * y + z * z + w * w)  # as URDF readers add up
    return pin.SE3(pin.Quaternion(w / norm, x / norm, y / norm, z / norm).matrix(), xyz)
