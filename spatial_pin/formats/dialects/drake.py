"""Drake's additions to URDF, with or without a declared prefix `drake:`.

| element | becomes |
|---|---|
| `<drake:joint type="ball | universal | screw | planar">` | a joint of the tree |
| `<drake:ball_constraint>` | spherical closure |
| `<drake:distance_constraint>` | distance; with a finite stiffness a spring |
| `<drake:linear_spring_damper>` | spring |
| `<drake:rotor_inertia>` and `<drake:gear_ratio>` of a transmission | armature |

Bushings, tendons and curvilinear joints are refused by name. A universal joint turns first about x
of the joint's frame and then about the y that is turned with it; Drake reads no `<axis>` there.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import pinocchio as pin

from spatial_pin.formats.dialects.robot import RobotReading
from spatial_pin.formats.urdf.elements import is_prefixed, local, numbers, without_it

TREE_JOINTS = ("ball", "universal", "screw", "planar")


def read_joint(element: ET.Element, reading: RobotReading) -> None:
    """Make a `<drake:joint>` a joint of the tree."""
    name, kind = element.get("name", ""), element.get("type", "")
    if kind not in TREE_JOINTS:
        raise reading.fail(element, f"a joint of type {kind!r} cannot be read; there are: "
                                    f"{', '.join(TREE_JOINTS)}")
    joint = ET.SubElement(reading.robot, "joint", element.attrib)
    joint.extend(child for child in element if not is_prefixed(child))
    reading.put_joint(joint)
    axis = reading.axis(element.find("axis"), element).tolist()
    if kind == "ball":
        reading.refine(name, type="spherical")
    elif kind == "universal":
        reading.refine(name, type="universal", axis=[1.0, 0.0, 0.0], axis2=[0.0, 1.0, 0.0])
    elif kind == "screw":
        reading.refine(name, type="screw", axis=axis,
                       lead=_number(element, "screw_thread_pitch", reading))


def read_ball(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<drake:ball_constraint>`."""
    reading.close(reading.name_of(element), "spherical", "<drake:ball_constraint>",
                  _points(element, reading))


def read_distance(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<drake:distance_constraint>`, which is a spring where it yields."""
    length = _number(element, "distance_constraint_distance", reading)
    stiffness = _number(element, "distance_constraint_stiffness", reading, math.inf)
    if stiffness < math.inf:
        damping = _number(element, "distance_constraint_damping", reading, 0.0)
        _spring(element, length, stiffness, damping, reading)
        return
    reading.close(reading.name_of(element), "distance", "<drake:distance_constraint>",
                  _points(element, reading), length=length)


def read_spring(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<drake:linear_spring_damper>`."""
    length, stiffness, damping = (_number(element, f"linear_spring_damper_{key}", reading)
                                  for key in ("free_length", "stiffness", "damping"))
    _spring(element, length, stiffness, damping, reading)


def refuse(element: ET.Element, reading: RobotReading) -> None:
    """Refuse what joins links or joints in a way that closures and springs do not have."""
    raise reading.fail(element, "joins links or joints by a law that this library does not have; "
                                "take it out, or write [[closures]] or [[springs]] for it; "
                                f"{without_it(element)}")


def read_armatures(transmission: ET.Element, reading: RobotReading) -> None:
    """Read the inertia of a rotor, seen through its gear, of a `<transmission>`'s joint."""
    joint, actuator = transmission.find("joint"), transmission.find("actuator")
    inertia = _child(actuator, "rotor_inertia")
    if joint is None or inertia is None or joint.get("name", "") not in reading.joints:
        return
    gear = _child(actuator, "gear_ratio")
    ratio = reading.value(gear, transmission) if gear is not None else 1.0
    armature = reading.value(inertia, transmission) * ratio**2
    if armature:
        reading.refine(joint.get("name", ""), armature=armature)


def _spring(element: ET.Element, length: float, stiffness: float, damping: float,
            reading: RobotReading) -> None:
    name = reading.name_of(element, "springs")
    frames = [reading.frame(link, placement, f"{name}_{k}")
              for k, (link, placement) in enumerate(_points(element, reading), start=1)]
    reading.add("springs", {"name": name, "frames": frames, "stiffness": stiffness,
                            "damping": damping, "free_length": length})


def _points(element: ET.Element, reading: RobotReading) -> list[tuple[str, pin.SE3]]:
    """Return link and point of the two ends A and B."""
    ends = []
    for body, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
        placement = pin.SE3.Identity()
        link, at = (_needed(element, f"{local(element)}_{key}", reading) for key in (body, point))
        placement.translation = numbers(at, "value", 3, reading.where(element))
        ends.append((reading.link(link.get("name"), element), placement))
    return ends


def _number(
    element: ET.Element, key: str, reading: RobotReading, default: float | None = None
) -> float:
    child = _child(element, key)
    if child is None and default is not None:
        return default
    if child is not None and child.get("value", "").strip().lstrip("+").lower() in ("inf",
                                                                                   "infinity"):
        return math.inf
    return reading.value(_needed(element, key, reading), element)


def _needed(element: ET.Element, key: str, reading: RobotReading) -> ET.Element:
    child = _child(element, key)
    if child is None:
        raise reading.fail(element, f"has no <drake:{key}>")
    return child


def _child(element: ET.Element | None, key: str) -> ET.Element | None:
    """Return the child of that name, whatever its namespace."""
    return next((e for e in element if local(e) == key), None) if element is not None else None
