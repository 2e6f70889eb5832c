"""SDFormat joints in the `<gazebo>` extension of a URDF, as Gazebo's own tutorial closes a loop.

    <gazebo>
      <joint name type>
        <parent>LINK</parent> <child>LINK</child>
        <pose relative_to="...">x y z r p y</pose>
        <axis> <xyz expressed_in="...">x y z</xyz> </axis>

SDFormat's rules: the pose is that of the joint's frame when all joints of the tree are at zero, in
the axes of the child link unless `relative_to` names another link (or joint, or `__model__`); the
axis is in the joint's frame unless `expressed_in` names another. The joint is attached to both
links where it stands then.

Gazebo before SDFormat (PR2) has `<joint:hinge>`, `<joint:slider>` and `<joint:ball>` with `body1`,
`body2`, `anchor` (the link in whose axes the point `anchorOffset` and `axis` are given). RViz
needed `<mimic>` for the same loops, which says them twice, or wrongly: it gives way to the loops.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from spatial_pin.formats.dialects.reading import Reading, end, local, said
from spatial_pin.linalg import Array
from spatial_pin.mechanism.sources import shown
from spatial_pin.mechanism.urdf_checks import numbers

WORLD, MODEL = "world", "__model__"
OLD = {"hinge": "revolute", "slider": "prismatic", "ball": "spherical"}


def read_gazebo(element: ET.Element, reading: Reading) -> None:
    """Read the joints of a `<gazebo>` element."""
    for joint in element.findall("joint"):
        if joint.find("parent") is not None or joint.find("child") is not None:
            _read_joint(joint, reading)
            element.remove(joint)
    for joint in [e for e in element if "}" in str(e.tag) and local(e) in OLD]:
        if joint.find("body1") is not None and joint.find("body2") is not None:
            _read_old_joint(joint, reading)
            element.remove(joint)


def _read_joint(joint: ET.Element, reading: Reading) -> None:
    root = reading.root()
    links = [root if name == WORLD and name not in reading.links else reading.link(name, joint)
             for name in (_text(joint, "parent"), _text(joint, "child"))]
    if links[0] == links[1] and joint.get("type") == "fixed":
        return  # the base stands on the ground anyway
    kind, world = reading.pair(joint), reading.world()
    frames = {**world, MODEL: pin.SE3.Identity(), WORLD: pin.SE3.Identity(),
              **{name: world[end(e, "child")] for name, e in reading.joints.items()
                 if name not in world}}
    stands = _pose(joint, links[1], frames, reading)
    axes, more = _axes(joint, kind, stands, frames, reading), {}
    if kind == "universal":
        more = {"axis2": axes[1].tolist()}
    elif kind == "screw":
        more = {"lead": _lead(joint, reading)}
    ends = [(link, world[link].actInv(stands)) for link in links]
    reading.close(reading.name_of(joint), kind, "<gazebo><joint>", ends, (axes[0], axes[0]), **more)


def _read_old_joint(joint: ET.Element, reading: Reading) -> None:
    links = [reading.link(_text(joint, key), joint) for key in ("body1", "body2")]
    anchor = reading.link(_text(joint, "anchor") or links[1], joint)
    world, stands = reading.world(), pin.SE3.Identity()
    offset, along = joint.find("anchorOffset"), joint.find("axis")
    if offset is not None:
        stands.translation = _numbers(joint, offset, 3, reading)
    axis = np.array([0.0, 0.0, 1.0])
    if along is not None:
        axis = reading.unit(_numbers(joint, along, 3, reading), joint)
    ends = [(link, world[link].actInv(world[anchor] * stands)) for link in links]
    reading.close(reading.name_of(joint), OLD[local(joint)], "<gazebo><joint:" + local(joint) + ">",
                  ends, (axis, axis))
    _drop_mimics(joint, reading.between(links), reading)


def _drop_mimics(joint: ET.Element, chains: list[list[str]], reading: Reading) -> None:
    dropped = []
    for name in (name for chain in chains for name in chain):
        mimic = reading.joints[name].find("mimic")
        if mimic is not None:
            reading.joints[name].remove(mimic)
            dropped.append(name)
    if dropped:
        reading.notices.append(f"the <mimic> of {', '.join(dropped)} is left out: {said(joint)} "
                               "closes that loop itself")


def _pose(joint: ET.Element, child: str, frames: Mapping[str, pin.SE3],
          reading: Reading) -> pin.SE3:
    pose = joint.find("pose")
    if pose is None:
        return frames[child]
    base = _frame(pose.get("relative_to") or child, joint, frames, reading)
    values = _numbers(joint, pose, 6, reading) if (pose.text or "").strip() else np.zeros(6)
    if pose.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise reading.fail(joint, f"<pose rotation_format={pose.get('rotation_format')!r}> cannot "
                                  "be read; write roll, pitch and yaw")
    turn = values[3:] * (math.pi / 180.0 if pose.get("degrees") in ("true", "1") else 1.0)
    return base * pin.SE3(pin.rpy.rpyToMatrix(turn), values[:3])


def _axes(joint: ET.Element, kind: str, stands: pin.SE3, frames: Mapping[str, pin.SE3],
          reading: Reading) -> list[Array]:
    """Return the unit vectors of <axis> and <axis2> in the joint's frame, z by default."""
    axes = []
    for tag in ("axis", "axis2"):
        xyz, axis = joint.find(f"{tag}/xyz"), np.array([0.0, 0.0, 1.0])
        if xyz is not None:
            axis = reading.unit(_numbers(joint, xyz, 3, reading), joint)
            flag = joint.find(f"{tag}/use_parent_model_frame")
            parent_model = flag is not None and (flag.text or "").strip() in ("1", "true")
            other = xyz.get("expressed_in") or (MODEL if parent_model else None)
            if other:
                turn = _frame(other, joint, frames, reading).rotation
                axis = stands.rotation.T @ turn @ axis
        elif kind == "universal":
            raise reading.fail(joint, f"a universal joint needs <{tag}><xyz>")
        axes.append(axis)
    return axes


def _lead(joint: ET.Element, reading: Reading) -> float:
    """Return the translation of a screw per turn [m]."""
    pitch, old = joint.find("screw_thread_pitch"), joint.find("thread_pitch")
    if pitch is not None:
        return float(_numbers(joint, pitch, 1, reading)[0])
    if old is not None:  # turns per metre, against the right-handed sense
        value = float(_numbers(joint, old, 1, reading)[0])
        if value:
            return -2.0 * math.pi / value
    raise reading.fail(joint, "a screw needs <screw_thread_pitch>, in metres per turn")


def _frame(name: str, joint: ET.Element, frames: Mapping[str, pin.SE3],
           reading: Reading) -> pin.SE3:
    if name not in frames:
        raise reading.fail(joint, f"frame {name!r} does not exist")
    return frames[name]


def _text(joint: ET.Element, tag: str) -> str:
    """Return the link of <parent> or <child>, which SDFormat writes as text."""
    found = joint.find(tag)
    return ((found.text or "").strip() or found.get("link", "")) if found is not None else ""


def _numbers(joint: ET.Element, element: ET.Element, count: int, reading: Reading) -> Array:
    holder = ET.Element(local(element), text=(element.text or "").strip())
    return numbers(holder, "text", count, f"{shown(reading.path)}: {said(joint)}")
