"""Motors: the joints of `<transmission>` and of `<ros2_control>` are drivers of their own names.

A joint of `<ros2_control>` with `<param name="mimic">` follows another instead, as with `<mimic>`.
Few robots state all their motors: joints in no loop are drivers too, and joints that others follow.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from spatial_pin.formats.dialects import drake
from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.formats.urdf.elements import local

ACTUATED = ("joint", "flexJoint", "rollJoint")  # the latter of PR2's wrist
DRIVABLE = ("revolute", "continuous", "prismatic")  # one coordinate


def read_transmission(element: ET.Element, reading: Reading) -> None:
    """Read a `<transmission>`: its joints by their names, as attributes or text."""
    for joint in element.iter():
        if local(joint) in ACTUATED:
            _drive(joint.get("name") or (joint.text or "").strip(), reading)
    drake.read_armatures(element, reading)


def read_ros2_control(element: ET.Element, reading: Reading) -> None:
    """Read a `<ros2_control>`: what takes commands is driven."""
    for joint in element.findall("joint"):
        given = {param.get("name", ""): param for param in joint.findall("param")}
        if "mimic" in given:
            ratio, offset = (reading.number(given.get(key), joint, default)
                             for key, default in (("multiplier", 1.0), ("offset", 0.0)))
            reading.couple((given["mimic"].text or "").strip(), joint.get("name", ""), ratio,
                           offset, "<ros2_control> with mimic")
        elif joint.find("command_interface") is not None:
            _drive(joint.get("name", ""), reading)


def drive_the_rest(reading: Reading) -> None:
    """Make drivers of the joints that no loop moves, and of those that others follow."""
    coupled = {closure["joints"][1] for closure in reading.content["closures"]
               if "joints" in closure}
    in_loops = reading.in_loops() | coupled
    leaders = {mimic.get("joint", "") for joint in reading.joints.values()
               for mimic in joint.findall("mimic")}
    for name in reading.joints:
        if name not in in_loops or name in leaders | reading.leaders:
            _drive(name, reading)


def _drive(name: str, reading: Reading) -> None:
    """Make a joint a driver, if it is one that a motor can drive by itself."""
    joint = reading.joints.get(name)
    if joint is not None and joint.get("type") in DRIVABLE and joint.find("mimic") is None:
        reading.drive(name)
