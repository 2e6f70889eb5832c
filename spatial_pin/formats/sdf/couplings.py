"""SDFormat: gearboxes and mimicking axes, Drake's too, as couplings of joint coordinates."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.graph.joints import Joint
from spatial_pin.formats.sdf.model import AXES, GEARBOX, PAIR_OF, Model
from spatial_pin.formats.sdf.poses import number, number_list
from spatial_pin.formats.urdf.elements import is_prefixed, local
from spatial_pin.numerics.linalg import Array

PARALLEL_AXES = 1e-2  # sine of the angle of two axes: files write 1.57 for a right angle


def couplings(model: Model, joints: tuple[Joint, ...]) -> list[dict[str, Any]]:
    """Return the gearboxes and mimicking axes as couplings of coordinates."""
    found = []
    for name, element in model.joints.items():
        if element.get("type") == GEARBOX:
            found.append(_gearbox(model, name, element, joints))
        for tag in AXES:
            mimic = element.find(f"{tag}/mimic")
            if mimic is not None:
                found.append(_mimic(model, name, tag, mimic))
        found += [_mimic(model, name, "axis", x) for x in element
                  if is_prefixed(x) and local(x) == "mimic"]
    return found


def _gearbox(
    model: Model, name: str, element: ET.Element, joints: tuple[Joint, ...]
) -> dict[str, Any]:
    """Return a gearbox: angle of the child = -ratio * angle of the parent, from a body."""
    where = f"{model.where}: gearbox {name!r}"
    body = model.link_of((element.findtext("gearbox_reference_body") or "").strip(),
                        f"<gearbox_reference_body> of joint {name!r}")
    ratio = -number(element, "gearbox_ratio", 1.0, where)
    names = []
    for end, tag in (("parent", "axis"), ("child", "axis2")):
        link = model.link_of((element.findtext(end) or "").strip(), f"<{end}> of {name!r}")
        axis = element.find(tag)
        if axis is None:
            raise MechanismFileError(f"{where} needs <{tag}>")
        turned = model.frames.in_world(model.frame_of[name], "gearbox").rotation
        about = turned @ model.direction(name, axis, where)
        joint, sense = _turning(model, body, link, about, joints, where)
        names.append(joint.name)
        ratio *= sense
    return {"name": name, "type": "coupling", "joints": names, "ratio": ratio}


def _turning(
    model: Model, body: str, link: str, about: Array, joints: tuple[Joint, ...], where: str
) -> tuple[Joint, float]:
    """Return the joint by which a link turns against a body about a direction, and its sign."""
    for joint in joints:
        if joint.type == "revolute" and {joint.parent, joint.child} == {body, link}:
            frame = model.frame_of[joint.name]
            at = model.frames.in_world(frame, "gearbox").rotation @ joint.axis
            if np.linalg.norm(np.cross(at, about)) < PARALLEL_AXES:
                return joint, math.copysign(1.0, at @ about) * (
                    1.0 if joint.parent == body else -1.0)
    raise MechanismFileError(
        f"{where}: no revolute joint joins {link!r} to the reference body {body!r} about its "
        "axis: the angle that it couples is no coordinate")


def _mimic(model: Model, name: str, tag: str, mimic: ET.Element) -> dict[str, Any]:
    where = f"{model.where}: joint {name!r}: <mimic>"
    leader = mimic.get("joint", "")
    if leader not in model.joints:
        raise MechanismFileError(
            f"{where}: no joint {leader!r}; {suggestion(leader, model.joints)}")
    ratio, offset, reference = (
        float(number_list(mimic.get(key), 1, f"{where}: {key}")[0]) if key in mimic.attrib
        else number(mimic, key, default, where)
        for key, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0)))
    names = [_coordinate(model, leader, mimic.get("axis") or "axis"), _coordinate(model, name, tag)]
    return {"name": f"mimic_{names[1]}", "type": "coupling", "joints": names, "ratio": ratio,
            "offset": offset - ratio * reference}


def _coordinate(model: Model, joint: str, tag: str) -> str:
    two = PAIR_OF.get(model.joints[joint].get("type", "")) == "universal"
    return f"{joint}.{AXES.get(tag, tag)}" if two else joint
