"""SDFormat links in the `<gazebo>` extension of a URDF: a joint hangs them on the tree.

    <gazebo>
      <link name> <pose>x y z r p y</pose> <inertial/> <visual/> <collision/> </link>
      <joint name type> <parent>LINK</parent> <child>LINK</child> ... </joint>

The pose is in the axes of the model, which are those of the root link, or of what `relative_to`
names. The first joint between such a link and one of the tree becomes a joint of the tree, whose
coordinate turns the joint's child against its parent; further joints are loops.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pinocchio as pin

from spatial_pin.formats.dialects import gazebo
from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.formats.sdf.links import link_elements
from spatial_pin.formats.sdf.poses import pose
from spatial_pin.formats.urdf.elements import joint_element
from spatial_pin.mechanism.pairs import PAIRS


def hang_links(reading: Reading) -> None:
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
                ends = [gazebo.linked(joint, role) for role in ("parent", "child")]
                new = [end for end in ends if end in loose]
                if len(new) == 1 and all(end in reading.links for end in ends if end not in new):
                    _hang(loose.pop(new[0]), joint, ends, reading)
                    holder.remove(joint)
                    hung = True


def _hang(link: ET.Element, joint: ET.Element, ends: list[str], reading: Reading) -> None:
    """Put a link, and the joint that carries it, into the tree."""
    name, where = link.get("name", ""), reading.where(link)
    place = link.find("pose")
    base = gazebo.frame(place.get("relative_to") or gazebo.MODEL, link, reading) \
        if place is not None else pin.SE3.Identity()
    stands = base * pose(place, where)
    reading.put_link(name, link_elements(link, lambda e, at: pose(e, at), where, reading.notices))
    reading.world[name] = stands
    kind, at, axes, more = gazebo.geometry(joint, ends, reading)
    carried, carrier = (ends[1], ends[0]) if ends[1] == name else (ends[0], ends[1])
    between = reading.names["frames"].free(f"{name}_carrier")
    tree_joint = reading.names["frames"].free(reading.name_of(joint))
    _join(between, tree_joint, carrier, reading.world[carrier].actInv(at), reading)
    _join(carried, reading.names["frames"].free(f"{name}_fixed"), between, at.actInv(stands),
          reading)
    sense = 1.0 if carried == ends[1] else -1.0  # the coordinate is the child's against the parent
    if kind != "weld":
        if PAIRS[kind].uses_axis:
            more["axis"] = (sense * axes[0]).tolist()
        for key in ("damping", "friction"):
            found = joint.find(f"axis/dynamics/{key}")
            if found is not None:
                more[key] = reading.number(found, joint, 0.0)
        reading.refine(tree_joint, type=kind, **more)


def _join(child: str, name: str, parent: str, placement: pin.SE3, reading: Reading) -> None:
    if child not in reading.links:
        reading.put_link(child, ())
    reading.put_joint(joint_element(reading.robot, name, "fixed", parent, child, placement))
