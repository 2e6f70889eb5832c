"""What a URDF must be before Pinocchio reads it: a tree, with possible numbers.

URDF readers drop joints, shapes and bounds without a word, or say only that the file is not valid.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion, warn
from spatial_pin.linalg import Array

LIGHTEST = 1e-200  # kg

# ---------------------------------------------------------------- structure


def check_structure(robot: ET.Element, path: Path) -> None:
    """Refuse what is not a tree: URDF readers drop and duplicate joints without a word."""
    if robot.tag != "robot":
        raise MechanismFileError(f"{path}: the root element is <{robot.tag}>, not <robot>")
    links = _names(robot.findall("link"), "link", path)
    if not links:
        raise MechanismFileError(f"{path}: no <link>")
    joints = robot.findall("joint")
    _names(joints, "joint", path)
    parent_joint: dict[str, ET.Element] = {}
    for joint in joints:
        for role in ("parent", "child"):
            link = end_of(joint, role)
            if link not in links:
                raise MechanismFileError(
                    f"{path}: joint {joint.get('name')!r}: {role} link {link!r} does not exist; "
                    f"{suggestion(link, links)}"
                )
        child = end_of(joint, "child")
        if child in parent_joint:
            first = parent_joint[child]
            raise MechanismFileError(
                f"{path}: link {child!r} has two parents: joint {first.get('name')!r} from "
                f"{end_of(first, 'parent')!r} and joint {joint.get('name')!r} from "
                f"{end_of(joint, 'parent')!r}. URDF holds trees only: cut the loop at one of the "
                "two joints: delete it here, put an empty link on a fixed joint at its place on "
                "either side, and write a [[closures]] entry with those two frames in a .toml file"
            )
        parent_joint[child] = joint
    roots = [link for link in links if link not in parent_joint]
    if len(roots) != 1:
        found = f"{len(roots)} root links ({', '.join(roots)})" if roots else "no root link"
        raise MechanismFileError(f"{path}: {found}; a tree has exactly one link without a parent")
    _check_connected(roots[0], links, parent_joint, path)


def _check_connected(
    root: str, links: Iterable[str], parent_joint: Mapping[str, ET.Element], path: Path
) -> None:
    connected = {root}
    for link in links:
        way: dict[str, None] = {}
        at = link
        while at not in connected:
            way[at] = None
            at = end_of(parent_joint[at], "parent")
            if at in way:
                raise MechanismFileError(f"{path}: the links {sorted(way)} hang in a cycle")
        connected.update(way)


def _names(elements: list[ET.Element], kind: str, path: Path) -> dict[str, ET.Element]:
    names: dict[str, ET.Element] = {}
    for element in elements:
        name = element.get("name", "")
        if not name or name in names:
            what = f"two {kind}s are named {name!r}" if name else f"a <{kind}> has no name"
            raise MechanismFileError(f"{path}: {what}")
        names[name] = element
    return names


def end_of(joint: ET.Element, role: str) -> str:
    """Return the link at one end of a joint, its "parent" or "child"; "" where there is none."""
    element = joint.find(role)
    return element.get("link", "") if element is not None else ""


# ---------------------------------------------------------------- numbers


def numbers(element: ET.Element, attribute: str, count: int, where: str) -> Array:
    """Return the `count` numbers of an attribute.

    Raises:
        MechanismFileError: they are not finite numbers, or not so many.
    """
    text = element.get(attribute, "")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if values.size != count or not np.all(np.isfinite(values)):
        wanted = "one finite number" if count == 1 else f"{count} finite numbers"
        raise MechanismFileError(
            f"{where}: <{element.tag} {attribute}={text!r}> needs {wanted}"
        )
    return values


def _placement(element: ET.Element | None, where: str) -> pin.SE3:
    if element is None:
        return pin.SE3.Identity()
    xyz = numbers(element, "xyz", 3, where) if "xyz" in element.attrib else np.zeros(3)
    rpy = numbers(element, "rpy", 3, where) if "rpy" in element.attrib else np.zeros(3)
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def check_links(robot: ET.Element, path: Path) -> dict[str, pin.Inertia]:
    """Refuse impossible shapes and inertias; return the own inertia of the links that have one."""
    inertias = {}
    for link in robot.findall("link"):
        where = f"{path}: link {link.get('name')!r}"
        for shape in (*link.findall("visual"), *link.findall("collision")):
            _placement(shape.find("origin"), where)
            _check_shape(shape, where)
        inertial = link.find("inertial")
        if inertial is not None:
            inertias[link.get("name", "")] = _inertia(inertial, where)
    return inertias


SHAPE_SIZES = {  # shape -> its attributes with their number of entries
    "box": {"size": 3}, "sphere": {"radius": 1}, "mesh": {},
    "cylinder": {"radius": 1, "length": 1}, "capsule": {"radius": 1, "length": 1},
}


def _check_shape(shape: ET.Element, where: str) -> None:
    """Refuse what the URDF reader would leave out."""
    geometry = shape.find("geometry")
    solid = next(iter(geometry), None) if geometry is not None else None
    if solid is None or solid.tag not in SHAPE_SIZES:
        raise MechanismFileError(
            f"{where}: <{shape.tag}> needs a <geometry> with one of: {', '.join(SHAPE_SIZES)}"
        )
    for attribute, count in SHAPE_SIZES[solid.tag].items():
        if np.any(numbers(solid, attribute, count, where) < 0.0):
            raise MechanismFileError(f"{where}: <{solid.tag}> has a negative {attribute}")
    if "scale" in solid.attrib:
        numbers(solid, "scale", 3, where)
    colour = shape.find("material/color")
    if colour is not None:
        numbers(colour, "rgba", 4, where)


def check_joint(joint: ET.Element, where: str) -> None:
    """Refuse numbers that the URDF reader refuses without saying where, or takes as they are."""
    _placement(joint.find("origin"), where)
    axis, limit, dynamics = (joint.find(tag) for tag in ("axis", "limit", "dynamics"))
    kind = joint.get("type", "")
    if axis is not None:
        numbers(axis, "xyz", 3, where)
    if limit is None and kind in ("revolute", "prismatic"):
        raise MechanismFileError(
            f"{where}: a {kind} joint needs <limit lower upper effort velocity> in URDF"
            + (" (or type=\"continuous\")" if kind == "revolute" else "")
        )
    if limit is not None:
        for attribute in ("effort", "velocity"):
            if numbers(limit, attribute, 1, where)[0] < 0.0:
                raise MechanismFileError(f"{where}: <limit {attribute}> is negative")
        lower, upper = (float(numbers(limit, key, 1, where)[0]) if key in limit.attrib else 0.0
                        for key in ("lower", "upper"))
        if lower > upper:
            raise MechanismFileError(f"{where}: limit: lower {lower} is above upper {upper}")
    for attribute in ("damping", "friction"):
        if dynamics is not None and attribute in dynamics.attrib \
                and numbers(dynamics, attribute, 1, where)[0] < 0.0:
            raise MechanismFileError(f"{where}: <dynamics {attribute}> is negative")


def _inertia(inertial: ET.Element, where: str) -> pin.Inertia:
    placement = _placement(inertial.find("origin"), where)
    mass_element, matrix_element = inertial.find("mass"), inertial.find("inertia")
    if mass_element is None or matrix_element is None:
        raise MechanismFileError(f"{where}: <inertial> needs <mass> and <inertia>")
    mass = float(numbers(mass_element, "value", 1, where)[0])
    if mass < 0.0:
        raise MechanismFileError(f"{where}: mass {mass} kg is negative")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (float(numbers(matrix_element, k, 1, where)[0]) for k in keys)
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    a, b, c = np.linalg.eigvalsh(matrix)
    if a < -1e-12 * abs(c):
        raise MechanismFileError(
            f"{where}: a principal moment of inertia is negative: {a:.4g} kg·m²"
        )
    if a + b < c * (1.0 - 1e-9):
        warn(f"{where}: no body has the principal moments of inertia {a:.4g}, {b:.4g}, {c:.4g} "
             "kg·m² (each must be at most the sum of the other two)")
    rotation = placement.rotation
    if mass and not LIGHTEST <= mass <= 1.0 / LIGHTEST:
        raise MechanismFileError(
            f"{where}: a mass of {mass:.3g} kg; only 0 and masses from {LIGHTEST:g} to "
            f"{1.0 / LIGHTEST:g} kg can be worked with")
    return pin.Inertia(mass, placement.translation, rotation @ matrix @ rotation.T)
