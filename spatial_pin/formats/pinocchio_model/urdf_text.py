"""The URDF text of a mechanism that was made in code.

Every joint hangs on the link of its parent joint, and every other link on the link of its joint,
so that all numbers but angles of rotation are in the text as in the model.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import warn
from spatial_pin.formats.file_access import is_file
from spatial_pin.formats.pinocchio_model.pair_tree import joint_axis
from spatial_pin.formats.urdf.elements import (
    finite_text,
    fresh,
    inertial,
    joint_element,
    numbers_text,
    origin,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS

GROUND = "world"  # the link for the world


class LinkTree:
    """The links of a model; missing ones are added to it.

    Then every joint has its frame and a link, and every other link a fixed joint.

    Attributes:
        mains: by joint, the link whose axes are the joint's; of the universe the root.
        mounts: by link, the fixed joint that carries it; of all other links.
    """

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        frames = list(model.frames)
        self._taken = {f.name for f in frames} | set(model.names)
        self._not_joints = {f.name for f in frames if f.type != pin.FrameType.JOINT}
        self._joint_frames = {f.name: k for k, f in enumerate(frames)
                              if f.type == pin.FrameType.JOINT}
        self._used = {0}
        links: list[list[int]] = [[] for _ in model.names]
        for k, frame in enumerate(frames):
            if frame.type == pin.FrameType.BODY:
                links[frame.parentJoint].append(k)
        self.mounts: dict[str, str] = {}
        self.mains = tuple(self._complete(i, own) for i, own in enumerate(links))

    def _add(self, name: str, joint: int, above: int, placement: pin.SE3,
             kind: pin.FrameType) -> int:
        return int(self._model.addFrame(pin.Frame(name, joint, above, placement, kind), False))

    def _complete(self, i: int, links: Iterable[int]) -> str:
        """Return the link whose axes are those of joint i; a new one is named as the joint."""
        model, here = self._model, pin.SE3.Identity()
        joint = str(model.names[i])
        above = self._joint_frames.get(joint) if i else 0
        if above is None:
            above = self._add(joint, i, 0, here, pin.FrameType.JOINT)
        main = next((k for k in links if model.frames[k].placement.isIdentity(0.0)), None)
        if main is None:
            name = joint if i and joint not in self._not_joints else fresh(
                f"{joint}_link" if i else GROUND, self._taken)
            main = self._add(name, i, above, here, pin.FrameType.BODY)
        for link in (model.frames[k] for k in links if k != main):
            mount, named = model.frames[link.parentFrame], str(link.name)  # new frames move these
            if link.parentFrame in self._used or mount.type != pin.FrameType.FIXED_JOINT \
                    or mount.parentJoint != link.parentJoint or mount.name in self._joint_frames \
                    or mount.placement != link.placement:
                self.mounts[named] = fresh(f"{named}_mount", self._taken)
                self._add(self.mounts[named], i, 0, link.placement, pin.FrameType.FIXED_JOINT)
            else:
                self._used.add(link.parentFrame)
                self.mounts[named] = str(mount.name)
        return str(model.frames[main].name)


def urdf_of(mechanism: Mechanism, bodies: LinkTree) -> str:
    """Return the open tree as URDF text.

    Shapes that URDF does not have are left out, with a warning.
    """
    model = mechanism.model
    robot = ET.Element("robot", name=mechanism.name)
    links = {name: ET.SubElement(robot, "link", name=name) for name in mechanism.links}
    for name, inertia in mechanism.inertias.items():
        links[name].append(inertial(inertia))
    for kind, shapes in (("visual", mechanism.visual_model),
                         ("collision", mechanism.collision_model)):
        for shape in shapes.geometryObjects:
            solid = _solid(shape)
            if solid is None:
                warn(f"mechanism {mechanism.name!r}: {kind} {shape.name!r} is a "
                     f"{type(shape.geometry).__name__} without a file, which URDF does not have: "
                     "it is drawn, but `save` leaves it out")
                continue
            link = bodies.mains[shape.parentJoint]
            frame = model.frames[shape.parentFrame] if shape.parentFrame < model.nframes else None
            if frame is not None and frame.type == pin.FrameType.BODY \
                    and frame.parentJoint == shape.parentJoint:
                link = frame.name
            element = ET.SubElement(links[link], kind)
            element.append(origin(mechanism.frame_on_joint(link)[1].actInv(shape.placement)))
            ET.SubElement(element, "geometry").append(solid)
            if kind == "visual":
                material = ET.SubElement(element, "material", name=f"{shape.name}_colour")
                rgba = numbers_text(np.clip(shape.meshColor, 0.0, 1.0))
                ET.SubElement(material, "color", rgba=rgba)
    for i in range(1, model.njoints):
        _add_joint(mechanism, bodies, robot, i)
    for link, mount in bodies.mounts.items():
        joint, placement = mechanism.frame_on_joint(link)
        joint_element(robot, mount, "fixed", bodies.mains[joint], link, placement)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode")


def _add_joint(mechanism: Mechanism, bodies: LinkTree, robot: ET.Element, i: int) -> None:
    model, pair = mechanism.model, mechanism.pairs[i - 1]
    q, v = model.idx_qs[i], model.idx_vs[i]
    low, high = float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q])
    kind = pair if pair in ("revolute", "prismatic") else "floating"
    if pair == "revolute" and np.isinf([low, high]).all():
        kind = "continuous"
    element = joint_element(robot, model.names[i], kind, bodies.mains[model.parents[i]],
                            bodies.mains[i], model.jointPlacements[i])
    if PAIRS[pair].freedom != 1:
        return
    if kind != "floating":
        joint = model.joints[i].extract()
        ET.SubElement(element, "axis", xyz=numbers_text(joint_axis(joint)))
    bounds = {} if kind == "continuous" else {"lower": low, "upper": high}
    bounds |= {"effort": model.upperEffortLimit[v], "velocity": model.upperVelocityLimit[v]}
    if kind != "continuous" or np.isfinite(list(bounds.values())).any():
        ET.SubElement(element, "limit", {key: finite_text(x) for key, x in bounds.items()})
    resisting = {"damping": model.damping[v], "friction": model.upperDryFrictionLimit[v]}
    if any(resisting.values()):
        ET.SubElement(element, "dynamics", {k: repr(float(x)) for k, x in resisting.items()})


def _solid(shape: Any) -> ET.Element | None:
    """Return a shape as URDF has it, None where it does not."""
    geometry, kind = shape.geometry, type(shape.geometry).__name__
    if kind == "Box":
        return ET.Element("box", size=numbers_text(2.0 * geometry.halfSide))
    if kind == "Sphere":
        return ET.Element("sphere", radius=repr(float(geometry.radius)))
    if kind in ("Cylinder", "Capsule"):
        return ET.Element(kind.lower(), radius=repr(float(geometry.radius)),
                          length=repr(2.0 * float(geometry.halfLength)))
    if shape.meshPath and is_file(Path(shape.meshPath)):
        return ET.Element("mesh", filename=str(Path(shape.meshPath).resolve()),
                          scale=numbers_text(shape.meshScale))
    return None
