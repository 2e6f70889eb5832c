"""Elements of URDF, their numbers with all digits."""

from __future__ import annotations

import math
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from spatial_pin.numerics.linalg import Array

URDF_AXIS = (1.0, 0.0, 0.0)  # of a joint without <axis>, in URDF and what extends it
UNBOUNDED = sys.float_info.max  # of a limit: URDF readers take no infinite one


def local(element: ET.Element) -> str:
    """Return an element's name without its namespace."""
    return str(element.tag).rpartition("}")[2]


def is_prefixed(element: ET.Element) -> bool:
    """Return whether an element's name carries a prefix, as that of Drake's elements does."""
    return "}" in str(element.tag)


def finite_numbers(text: str, count: int) -> Array:
    """Return the `count` finite numbers of a text.

    Raises:
        ValueError: there are more or fewer, or no numbers; says what is wanted.
    """
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


def joint_element(
    robot: ET.Element, name: str, kind: str, parent: str, child: str, placement: pin.SE3
) -> ET.Element:
    """Add a joint between two links to a <robot>, and return it."""
    element = ET.SubElement(robot, "joint", name=name, type=kind)
    element.append(origin(placement))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    return element
