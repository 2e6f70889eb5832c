"""SDFormat joints in the `<gazebo>` extension of a URDF, as Gazebo's own tutorial closes a loop.

    <gazebo>
      <link name> <pose>x y z r p y</pose> <inertial/> <visual/> <collision/> </link>
      <joint name type>
        <parent>LINK</parent> <child>LINK</child>
        <pose relative_to="...">x y z r p y</pose>
        <axis> <xyz expressed_in="...">x y z</xyz> </axis>

SDFormat's rules: the pose is that of the joint's frame when all joints of the tree are at zero, in
the axes of the child link unless `relative_to` names another link (or joint, or `__model__`); the
axis is in the joint's frame unless `expressed_in` names another. The joint is attached to both
links in that pose.

The pose of a link is in the axes of the model, which are those of the root link, or of the frame
that `relative_to` names. The first joint between such a link and one of the tree becomes a joint of
the tree, whose coordinate turns the joint's child against its parent; further joints are loops.

A plugin with `<joint>` and `<mimicJoint>` couples these two; where the joint has a `<mimic>` of
its own, that is the same coupling. The plugin DetachableJoint holds `<child_link>` on
`<parent_link>` in the pose of zero coordinates: so loops are closed in today's Gazebo. A plugin
that takes hold of another model, as a gripper does, is left out with a notice.

Gazebo before SDFormat (PR2) has `<joint:hinge>`, `<joint:slider>` and `<joint:ball>` with `body1`,
`body2`, `anchor` (the link in whose axes the point `anchorOffset` and `axis` are given). RViz
needed `<mimic>` for the same loops: a second, or wrong, statement that gives way to the loops.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.formats.dialects.robot import RobotReading, words
from spatial_pin.formats.sdf.sdf_elements import MODEL, link_elements, pose
from spatial_pin.formats.sdf.sdf_model import OWN, is_detachable
from spatial_pin.formats.urdf.elements import end_of, joint_element, local, without_it
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.numerics.linalg import Array

WORLD = "world"
OLD = {"hinge": "revolute", "slider": "prismatic", "ball": "spherical"}


def read_gazebo(element: ET.Element, reading: RobotReading) -> None:
    """Read the joints of a `<gazebo>` element."""
    for joint in element.findall("joint"):
        if joint.find("parent") is None and joint.find("child") is None:
            continue
        element.remove(joint)
        names = [linked(joint, role) for role in ("parent", "child")]
        links = [reading.root if name == WORLD and WORLD not in reading.links
                 else reading.link(name, joint) for name in names]
        if links[0] == links[1] and joint.get("type") == "fixed":
            continue  # the base is fixed to the ground anyway
        kind, stands, axes, more = geometry(joint, links, reading)
        ends = [(link, reading.world[link].actInv(stands)) for link in links]
        reading.close(reading.name_of(joint), kind, "<gazebo><joint>", ends, (axes[0], axes[0]),
                      **more)
    for plugin in element.iter("plugin"):  # that couples two joints where <mimic> is passed over
        names = [plugin.findtext(tag, "").strip() for tag in ("joint", "mimicJoint")]
        if all(names):
            ratio, offset = (reading.number(plugin.find(tag), plugin, default)
                             for tag, default in (("multiplier", 1.0), ("offset", 0.0)))
            reading.couple(names[0], names[1], ratio, offset,
                           "<gazebo><plugin> with <mimicJoint>")
    for plugin in filter(is_detachable, element.findall("plugin")):
        _read_detachable(plugin, reading)
        element.remove(plugin)
    for joint in [e for e in element if "}" in str(e.tag) and local(e) in OLD]:
        if joint.find("body1") is not None and joint.find("body2") is not None:
            _read_old_joint(joint, reading)
            element.remove(joint)


def geometry(joint: ET.Element, links: list[str], reading: RobotReading
             ) -> tuple[str, pin.SE3, list[Array], dict[str, Any]]:
    """Return a joint's pair, the placement of its frame, its two axes there, and its numbers.

    The axes are unit vectors, z by default.
    """
    kind, stated = reading.pair(joint), joint.find("pose")
    base = (stated.get("relative_to") if stated is not None else None) or links[1]
    stands = frame(base, joint, reading) * pose(stated, reading.where(joint))
    axes = []
    for tag in ("axis", "axis2"):
        xyz, axis = joint.find(f"{tag}/xyz"), np.array([0.0, 0.0, 1.0])
        if xyz is not None:
            axis = reading.unit(reading.texts(xyz, 3, joint), joint)
            flag = (joint.findtext(f"{tag}/use_parent_model_frame") or "").strip()
            other = xyz.get("expressed_in") or (MODEL if flag in ("1", "true") else None)
            if other:
                axis = stands.rotation.T @ frame(other, joint, reading).rotation @ axis
        elif kind == "universal":
            raise reading.fail(joint, f"a universal joint needs <{tag}><xyz>")
        axes.append(axis)
    if kind == "universal":
        return kind, stands, axes, {"axis2": axes[1].tolist()}
    if kind != "screw":
        return kind, stands, axes, {}
    if joint.find("screw_thread_pitch") is not None:
        lead = reading.number(joint.find("screw_thread_pitch"), joint, 0.0)
    else:  # turns per metre, against the right-handed sense
        pitch = reading.number(joint.find("thread_pitch"), joint, 0.0)
        if not pitch:
            raise reading.fail(joint, "a screw needs <screw_thread_pitch>, in metres per turn")
        lead = -2.0 * math.pi / pitch
    return kind, stands, axes, {"lead": lead}


def _read_detachable(plugin: ET.Element, reading: RobotReading) -> None:
    """Read the plugin that holds a link on another in the present pose."""
    parent, child, model = (plugin.findtext(tag, "").strip()
                            for tag in ("parent_link", "child_link", "child_model"))
    if model not in (*OWN, reading.robot.get("name", "")):
        if child in reading.links:
            raise reading.fail(plugin, f"holds link {child!r} of the model {model!r}, and this "
                                       f"robot, {reading.robot.get('name', '')!r}, has a link of "
                                       "that name: if it is the same, give it that name; if not, "
                                       f"{without_it(plugin)}")
        reading.notices.append(f"{words(plugin)} takes hold of the model {model!r}, which is not "
                               "here: left out")
        return
    links = [reading.link(name, plugin) for name in (parent, child)]
    if any(reading.between(links)):  # else they are fixed to each other already
        at = reading.world[links[1]]
        reading.close("__".join(links), "weld", "<gazebo> DetachableJoint",
                      [(link, reading.world[link].actInv(at)) for link in links])


def _read_old_joint(joint: ET.Element, reading: RobotReading) -> None:
    links = [reading.link(linked(joint, key), joint) for key in ("body1", "body2")]
    stands = reading.world[reading.link(linked(joint, "anchor") or links[1], joint)]
    offset, along = joint.find("anchorOffset"), joint.find("axis")
    if offset is not None:
        stands = stands * pin.SE3(np.eye(3), reading.texts(offset, 3, joint))
    axis = np.array([0.0, 0.0, 1.0])
    if along is not None:
        axis = reading.unit(reading.texts(along, 3, joint), joint)
    ends = [(link, reading.world[link].actInv(stands)) for link in links]
    reading.close(reading.name_of(joint), OLD[local(joint)], "<gazebo><joint:" + local(joint) + ">",
                  ends, (axis, axis))
    moved = [name for chain in reading.between(links) for name in chain]
    reading.drop_mimics(moved, f"{words(joint)} closes that loop itself")


def frame(name: str, joint: ET.Element, reading: RobotReading) -> pin.SE3:
    """Return the placement of a link, a joint or the model when all joints are at zero."""
    if name not in reading.links and name in reading.joints:
        name = end_of(reading.joints[name], "child")
    if name in reading.links:
        return reading.world[name]
    if name in (MODEL, WORLD):
        return pin.SE3.Identity()
    raise reading.fail(joint, f"frame {name!r} does not exist")


def linked(joint: ET.Element, tag: str) -> str:
    """Return the link of <parent> or <child>, which SDFormat writes as text."""
    element = joint.find(tag)
    return ((element.text or "").strip() or element.get("link", "")) if element is not None else ""


def hang_links(reading: RobotReading) -> None:
    """Hang the links of all `<gazebo>` elements on the tree, as far as joints do so."""
    holders = [e for e in reading.robot if e.tag == "gazebo"]
    loose = {link.get("name", ""): link for e in holders for link in e.findall("link")}
    for name in loose.keys() & reading.links.keys():
        raise reading.fail(loose[name], "there is a link of that name in the URDF already")
    hung = bool(loose)
    while hung:
        hung = False
        for holder in holders:
            for joint in holder.findall("joint"):
                ends = [linked(joint, role) for role in ("parent", "child")]
                new = [end for end in ends if end in loose]
                if len(new) == 1 and all(end in reading.links for end in ends if end not in new):
                    _hang(loose.pop(new[0]), joint, ends, reading)
                    holder.remove(joint)
                    hung = True


def _hang(link: ET.Element, joint: ET.Element, ends: list[str], reading: RobotReading) -> None:
    """Put a link, and the joint that carries it, into the tree."""
    name, where = link.get("name", ""), reading.where(link)
    moved = link.find("pose")
    base = frame(moved.get("relative_to") or MODEL, link, reading) \
        if moved is not None else pin.SE3.Identity()
    stands = base * pose(moved, where)
    reading.put_link(name, link_elements(link, lambda e, at: pose(e, at), where, reading.notices))
    reading.world[name] = stands
    kind, at, axes, more = geometry(joint, ends, reading)
    carried, carrier = (ends[1], ends[0]) if ends[1] == name else (ends[0], ends[1])
    names = reading.names["frames"]
    between, tree_joint = names.free(f"{name}_carrier"), names.free(reading.name_of(joint))
    reading.put_link(between, ())
    for own_name, parent, child, placement in (
            (tree_joint, carrier, between, reading.world[carrier].actInv(at)),
            (names.free(f"{name}_fixed"), between, carried, at.actInv(stands))):
        reading.put_joint(joint_element(reading.robot, own_name, "fixed", parent, child, placement))
    sense = 1.0 if carried == ends[1] else -1.0  # the coordinate is the child's against the parent
    if kind != "weld":
        if PAIRS[kind].uses_axis:
            more["axis"] = (sense * axes[0]).tolist()
        for key in ("damping", "friction"):
            stated = joint.find(f"axis/dynamics/{key}")
            if stated is not None:
                more[key] = reading.number(stated, joint, 0.0)
        reading.refine(tree_joint, type=kind, **more)
