"""Loops and motors that elements of a URDF, or the names of its links, state.

URDF+ (Chignoli et al., 2024):

    <loop name type>                      <coupling name>
      <predecessor link><origin/>           <predecessor link/>
      <successor link><origin/>             <successor link/>
      <axis xyz/>                           <ratio value/>

An origin is the loop's frame in the axes of its link, the axis holds in both frames. A coupling
means ratio * (angle of the predecessor) = angle of the successor, each counted from the nearest
link that carries both. Before 2024 both were `<constraint type="position">` (a common point) and
`<constraint type="rolling">`. A joint with `independent="true"` is a driver.

`<constraint>` with parent and child, each with an origin and an axis of its own:

    <constraint name type>
      <parent link/> <parent_origin xyz rpy/> <parent_axis xyz/>
      <child link/> <child_origin xyz rpy/> <child_axis xyz/>

The type is that of a joint, with or without "_joint" behind it; of a cut link it is "link", which
holds both frames together. The child's axis is the parent's where it is not stated; of a universal
joint the axes are the pin in the parent and the pin in the child. An older form,
`<loop_constraint>`, has no type: a common point.

`<loop_joint>` of Isaac Sim's URDF importer, and of Drake and RigidBodyDynamics.jl before it:

    <loop_joint name type>
      <link1 link xyz rpy/>
      <link2 link xyz rpy/>
      <axis xyz/>

The joint's frame in the axes of either link; Isaac itself keeps the spherical ones only. Its
manual writes `<link1>` twice.

onshape-to-robot makes the mate `closing_NAME` a link on either part, `closing_NAME_1` and
`closing_NAME_2`, whose origins coincide. A revolute mate writes also `closing_NAME_1_z` and
`closing_NAME_2_z`, 0.1 m along the mate's axis, which coincide too. The kinds of all other mates
(ball, fastened, slider) are not written: they are balls. A closure of the same name in a mechanism
file states another.

Motors: the joints of `<transmission>` and of `<ros2_control>` are drivers of their own names. A
joint of `<ros2_control>` with `<param name="mimic">` follows another instead, as with `<mimic>`.
Few robots state all their motors: joints in no loop are drivers too, and joints that others follow.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from spatial_pin.formats.dialects.drake import read_armatures
from spatial_pin.formats.dialects.robot import RobotReading
from spatial_pin.formats.urdf.elements import local, placement
from spatial_pin.numerics.linalg import Array

ENDS = (("predecessor",), ("successor", "sucessor"))  # one exporter writes it so
SIDES = ("parent", "child")
OTHERS = {None: "spherical", "position": "spherical", "link": "weld"}  # types that are no joints
ONSHAPE = "onshape-to-robot closing frames"
FRAME = re.compile(r"closing_(?P<name>.+)_(?P<side>[12])")
ROUNDED_ANGLE = 1e-5  # rad; of a mate's z axis to the point on it where files have six digits
ACTUATED = ("joint", "flexJoint", "rollJoint")  # the latter of PR2's wrist
DRIVABLE = ("revolute", "continuous", "prismatic")  # one coordinate


def read_loop(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<loop>`."""
    axis = reading.axis(element.find("axis"), element)
    reading.close(reading.name_of(element), reading.pair(element), "URDF+ <loop>",
                  _ends(element, reading), (axis, axis))


def read_coupling(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<coupling>` of two joints."""
    ratio = element.find("ratio")
    value = reading.value(ratio, element) if ratio is not None else 1.0
    links = [link for link, _ in _ends(element, reading)]
    chains = reading.between(links)
    if [len(chain) for chain in chains] != [1, 1]:
        joints = " and ".join(f"{len(chain)} ({', '.join(chain) or 'none'})" for chain in chains)
        raise reading.fail(element, f"couples {links[0]!r} and {links[1]!r}, with {joints} joints "
                                    "between them and the link that carries both; only one and "
                                    "one can be coupled")
    reading.add("closures", {"name": reading.name_of(element), "type": "coupling", "ratio": value,
                             "joints": [chain[0] for chain in chains],
                             "source": "URDF+ <coupling>"})


def _ends(element: ET.Element, reading: RobotReading) -> list[tuple[str, pin.SE3]]:
    ends = []
    for names in ENDS:
        end = next((e for e in element if e.tag in names), None)
        if end is None:
            raise reading.fail(element, f"has no <{names[0]} link=...>")
        link = reading.link(end.get("link") or end.get("name"), element)
        ends.append((link, placement(end.find("origin"), reading.where(element))))
    return ends


def read_constraint(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<constraint>`; one with predecessor and successor is URDF+."""
    stated = element.get("type")
    if element.find("predecessor") is not None:
        if stated == "rolling":
            read_coupling(element, reading)
        elif stated == "position":
            reading.close(reading.name_of(element), "spherical", "URDF+ <constraint>",
                          _ends(element, reading))
        else:
            read_loop(element, reading)
        return
    kind = OTHERS[stated] if stated in OTHERS else reading.pair(element)
    ends, axes = [], list[Array]()
    for side in SIDES:
        named = element.find(side)
        if named is None:
            raise reading.fail(element, f"has no <{side} link=...>")
        link = reading.link(named.get("link"), element)
        ends.append((link, placement(element.find(f"{side}_origin"), reading.where(element))))
        own = element.find(f"{side}_axis")
        own = own if own is not None else element.find("axis")
        follows = own is None and axes and kind != "universal"
        axes.append(axes[0] if follows else reading.axis(own, element))
    name, source = reading.name_of(element), "URDF <constraint>"
    if kind == "universal":
        reading.close(name, kind, source, ends, axis=axes[0].tolist(), axis2=axes[1].tolist())
    else:
        reading.close(name, kind, source, ends, (axes[0], axes[1]))


def read_loop_joint(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<loop_joint>`."""
    links_named = [e for e in element if e.tag in ("link1", "link2")]
    if len(links_named) != 2:
        raise reading.fail(element, f"joins {len(links_named)} links; it needs <link1> and <link2>")
    links_named.sort(key=lambda e: str(e.tag))  # <link1> first, the order of two alike stays
    axis = reading.axis(element.find("axis"), element)
    where = reading.where(element)
    ends = [(reading.link(e.get("link"), element), placement(e, where)) for e in links_named]
    reading.close(reading.name_of(element), reading.pair(element), "Isaac <loop_joint>", ends,
                  (axis, axis))


def read_closing_frames(reading: RobotReading) -> None:
    """Read the closing frames of a robot."""
    links = reading.links
    names = dict.fromkeys(match["name"] for match in map(FRAME.fullmatch, links) if match)
    world = reading.world if names else {}
    for name in names:
        pair = [f"closing_{name}_{side}" for side in (1, 2)]
        for frame, other in (pair, pair[::-1]):
            if frame not in links:
                raise reading.fail(f"closing frame {other!r}", f"there is no {frame!r}, with which "
                                                               "it would coincide")
        on_axis = [f"{frame}_z" for frame in pair]
        present = [frame in links for frame in on_axis]
        if any(present) and not all(present):
            raise reading.fail(f"closing frame {on_axis[present.index(True)]!r}",
                               f"there is no {on_axis[present.index(False)]!r}, with which it "
                               "would coincide")
        kind = "revolute" if all(present) else "spherical"
        axes = [reading.unit(np.array(world[frame].actInv(world[tip]).translation),
                             f"closing frame {tip!r}")
                for frame, tip in zip(pair, on_axis, strict=True) if all(present)]
        if any(abs(axis[:2]).max() >= ROUNDED_ANGLE or axis[2] <= 0.0 for axis in axes):
            ends = [(frame, pin.SE3.Identity()) for frame in pair]
            reading.close(f"closing_{name}", kind, ONSHAPE, ends, (axes[0], axes[1]))
        else:
            reading.add("closures", {"name": f"closing_{name}", "type": kind, "frames": pair,
                                     "source": ONSHAPE})


def read_transmission(element: ET.Element, reading: RobotReading) -> None:
    """Read a `<transmission>`: its joints by their names, as attributes or text."""
    for joint in element.iter():
        if local(joint) in ACTUATED:
            _drive(joint.get("name") or (joint.text or "").strip(), reading)
    read_armatures(element, reading)


def read_ros2_control(element: ET.Element, reading: RobotReading) -> None:
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


def note_copies(reading: RobotReading) -> None:
    """Note the <mimic> of joints in loops: viewers need it, the loop makes it redundant."""
    copies = [name for name in sorted(reading.in_loops())
              if reading.joints[name].find("mimic") is not None]
    if copies:
        reading.notices.append(f"{', '.join(copies)}: moved by a loop, with a <mimic> too; where "
                               "that only copies the loop, and not to the last digit, nothing can "
                               "move: take the <mimic> out then")


def drive_the_rest(reading: RobotReading) -> None:
    """Make drivers of the joints that no loop moves, and of those that others follow."""
    if reading.all_driven:
        return
    coupled = {closure["joints"][1] for closure in reading.content["closures"]
               if "joints" in closure}
    in_loops = reading.in_loops() | coupled
    leaders = {mimic.get("joint", "") for joint in reading.joints.values()
               for mimic in joint.findall("mimic")}
    for name in reading.joints:
        if name not in in_loops or name in leaders | reading.leaders:
            _drive(name, reading)


def _drive(name: str, reading: RobotReading) -> None:
    """Make a joint a driver, if it is one that a motor can drive by itself."""
    joint = reading.joints.get(name)
    if joint is not None and joint.get("type") in DRIVABLE and joint.find("mimic") is None:
        reading.drive(name)
