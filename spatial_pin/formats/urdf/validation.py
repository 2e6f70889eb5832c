"""What a URDF must be before Pinocchio reads it: a tree, with possible numbers.

URDF readers drop joints and bounds without a word, or say only that the file is not valid. What
can be lived with is noted, the rest is refused.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Container, Iterable, Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.importers import Faults
from spatial_pin.formats.urdf.elements import UNBOUNDED, finite_numbers, joint_element, local
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.numerics.linalg import Array

LIGHTEST = 1e-200  # kg
DEEPEST_LINK = 1500  # joints above it: readers of URDF take 2.5 kB of the stack for each, and a
                     # stack of 8 MB ends them, and all of Python, before 4000
ONCE = {  # of a link or joint, or of an element in it, allowed once
    ".": ("inertial", "origin", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"), "collision": ("origin", "geometry"),
}
UNIVERSE = "universe"  # the joint that all joints of a Pinocchio model hang on
INERTIAL = (("mass", "value"),
            *(("inertia", key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")))


def check_structure(robot: ET.Element, path: Path, faults: Faults) -> None:
    """Refuse links and joints that do not make a graph; several trees are made one.

    Loops are cut before.
    """
    if robot.tag != "robot":
        raise MechanismFileError(f"{path}: the root element is <{robot.tag}>, not <robot>")
    links = by_name(robot.findall("link"), "link", path)
    if not links:
        raise MechanismFileError(f"{path}: no <link>")
    joints = robot.findall("joint")
    names = by_name(joints, "joint", path)
    _check_names(links, joints, path)
    for joint in joints:
        for role in ("parent", "child"):
            link = end_of(joint, role)
            if link not in links:
                raise MechanismFileError(
                    f"{path}: joint {joint.get('name')!r}: {role} link {link!r} does not exist; "
                    f"{suggestion(link, links)}"
                )
        if end_of(joint, "child") == end_of(joint, "parent"):
            raise MechanismFileError(f"{path}: joint {joint.get('name')!r} joins link "
                                     f"{end_of(joint, 'child')!r} with itself")
    children = {end_of(joint, "child") for joint in joints}
    roots = [link for link in links if link not in children]
    _check_depth(roots, joints, path)
    _note_doubled(robot, faults)
    if len(roots) > 1:
        _fix_roots(robot, roots, {*links, *names} - set(roots), faults)


def _note_doubled(robot: ET.Element, faults: Faults) -> None:
    """Note repeated elements; readers of URDF take the first."""
    elements = [(kind, x) for kind in ("link", "joint") for x in robot.findall(kind)]
    for below, tags in ONCE.items():
        for kind, element in elements:
            for part, tag in product(element.iterfind(below), tags):
                if len(part.findall(tag)) > 1:
                    faults.note("stated more than once, the first counts",
                                f"{kind} {element.get('name')!r}: <{tag}>")


def _fix_roots(
    robot: ET.Element, roots: Sequence[str], taken: Container[str], faults: Faults
) -> None:
    """Fix several roots to one link, the world."""
    world = _free("world", taken)
    if world not in roots:
        ET.SubElement(robot, "link", name=world)
    for root in roots:
        if root != world:
            joint_element(robot, _free(f"{world}_to_{root}", taken), "fixed", world, root)
            faults.note("no parent, fixed to the ground at its origin", f"link {root!r}")


def _check_names(links: Iterable[str], joints: Sequence[ET.Element], path: Path) -> None:
    """Refuse names that nothing can ask for: those of control characters, and Pinocchio's own."""
    named = [("joint", joint.get("name", "")) for joint in joints] + [("link", x) for x in links]
    odd = [(len(name), kind, name) for kind, name in named if not name.isprintable()]
    if odd:  # the shortest: importers call others after it
        _, kind, name = min(odd)
        raise MechanismFileError(f"{path}: a {kind} is named {name!r}; a name is text that can be "
                                 "read")
    if any(joint.get("name") == UNIVERSE and joint.get("type") != "fixed" for joint in joints):
        raise MechanismFileError(f"{path}: a joint is named {UNIVERSE!r}, which is Pinocchio's "
                                 "name of the ground; rename it")


def _check_depth(roots: Iterable[str], joints: Iterable[ET.Element], path: Path) -> None:
    """Refuse chains on which the reader of URDF, who calls itself link by link, would die."""
    above: dict[str, list[str]] = {}
    for joint in joints:
        above.setdefault(end_of(joint, "parent"), []).append(end_of(joint, "child"))
    level, depth = list(roots), 0
    while level:
        level = [child for link in level for child in above.pop(link, ())]
        depth += 1
        if depth > DEEPEST_LINK and level:
            raise MechanismFileError(f"{path}: more than {DEEPEST_LINK} joints one after another "
                                     f"below the root, as at link {level[0]!r}; readers of URDF "
                                     "take no longer chains")


def _free(name: str, taken: Container[str]) -> str:
    while name in taken:
        name += "_"
    return name


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
    turn = pin.Quaternion(ca * cb * cc + sa * sb * sc, sa * cb * cc - ca * sb * sc,
                          ca * sb * cc + sa * cb * sc, ca * cb * sc - sa * sb * cc)
    turn.normalize()  # rounded as URDF readers round it
    return pin.SE3(turn.matrix(), xyz)


def check_links(robot: ET.Element, path: Path, faults: Faults) -> dict[str, pin.Inertia]:
    """Return the own inertia of the links that have one."""
    inertias = {}
    for link in robot.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if inertial is not None:
            inertias[name] = _inertia(inertial, f"{path}: link {name!r}", faults, name)
    return inertias


def _inertia(inertial: ET.Element, where: str, faults: Faults, name: str) -> pin.Inertia:
    centre = placement(inertial.find("origin"), where)
    values, missing = [], []
    for tag, key in INERTIAL:
        element = inertial.find(tag)
        if element is not None and key in element.attrib:
            values.append(float(numbers(element, key, 1, where)[0]))
        else:
            values.append(0.0)
            missing.append(key if tag == "inertia" else "mass")
    if missing and len(inertial):
        faults.note("of <inertial> missing, counts as 0", f"link {name!r}: {' '.join(missing)}")
    mass, xx, xy, xz, yy, yz, zz = values
    if mass and not LIGHTEST <= abs(mass) <= 1.0 / LIGHTEST:
        raise MechanismFileError(
            f"{where}: a mass of {mass:.3g} kg; only 0 and masses from {LIGHTEST:g} to "
            f"{1.0 / LIGHTEST:g} kg can be worked with")
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    with np.errstate(over="ignore", invalid="ignore"):
        turned = centre.rotation @ matrix @ centre.rotation.T
    if not np.all(np.abs(turned) <= 1.0 / LIGHTEST):
        raise MechanismFileError(f"{where}: its moments of inertia are above {1.0 / LIGHTEST:g} "
                                 "kg·m², more than can be worked with")
    return inertia_as_given(mass, centre.translation, turned)


def check_joint(joint: ET.Element, path: Path, faults: Faults) -> None:
    """Refuse numbers that the URDF reader refuses without saying where, or takes as they are."""
    name = joint.get("name")
    where = f"{path}: joint {name!r}"
    placement(joint.find("origin"), where)
    axis, limit, dynamics = (joint.find(tag) for tag in ("axis", "limit", "dynamics"))
    kind = joint.get("type", "")
    if axis is not None and kind != "fixed":
        numbers(axis, "xyz", 3, where)
    if kind in ("revolute", "prismatic"):
        missing = [key for key in ("effort", "velocity")
                   if limit is None or key not in limit.attrib]
        if missing:
            faults.note("no <limit>, counts as unlimited" if limit is None else
                        f"no {' and no '.join(missing)} in <limit>, counts as unlimited in that",
                        f"joint {name!r}")
    if limit is not None:
        for attribute in ("effort", "velocity"):
            if attribute in limit.attrib and numbers(limit, attribute, 1, where)[0] < 0.0:
                raise MechanismFileError(f"{where}: <limit {attribute}> is negative")
        lower, upper = (float(numbers(limit, key, 1, where)[0]) if key in limit.attrib else 0.0
                        for key in ("lower", "upper"))
        if lower > upper and kind in ("revolute", "prismatic"):
            faults.note("lower limit above the upper one, counts as no limit", f"joint {name!r}")
            limit.attrib.update(lower=repr(-UNBOUNDED), upper=repr(UNBOUNDED))
    for attribute in ("damping", "friction"):
        if dynamics is not None and attribute in dynamics.attrib \
                and numbers(dynamics, attribute, 1, where)[0] < 0.0:
            raise MechanismFileError(f"{where}: <dynamics {attribute}> is negative")
