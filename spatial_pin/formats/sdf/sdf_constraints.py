"""SDFormat: what holds links together beside joints, and what couples joints.

What holds links together closes loops, so that it is cut. Gearboxes and mimicking axes, Drake's
too, are couplings of joint coordinates.

| element | becomes |
|---|---|
| Gazebo's plugin DetachableJoint | a weld of two links where the file draws them |
| `<drake:weld_constraint>` | a weld of two frames |
| `<drake:ball_constraint>` | a ball between two points |
| `<drake:distance_constraint>` | a distance between two points |
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.graph.joint_graph import GraphJoint
from spatial_pin.formats.sdf.sdf_elements import SCOPE, number, number_list
from spatial_pin.formats.sdf.sdf_model import (
    AXES,
    GEARBOX,
    OF_DRAKE,
    OWN,
    PAIR_OF,
    SdfModel,
    is_detachable,
)
from spatial_pin.formats.urdf.elements import is_prefixed, local, unique, without_it
from spatial_pin.numerics.linalg import Array

BODIES = ("A", "AP"), ("B", "BQ")  # of Drake's constraints: body and point on it
PARALLEL_AXES = 1e-2  # sine of the angle of two axes: files write 1.57 for a right angle


def constraints(model: SdfModel) -> list[GraphJoint]:
    """Return what holds links together beside joints."""
    joints: dict[str, GraphJoint] = {}
    for element in model.model:
        joint = None
        if element.tag == "plugin" and is_detachable(element):
            joint = _detachable(model, element)
        elif is_prefixed(element) and local(element) in OF_DRAKE:
            joint = _of_drake(model, element)
        if joint is not None:
            name = unique(joint.name, [*model.joints, *joints])
            joints[name] = joint.with_changes(name=name, cut=True)
    return list(joints.values())


def _detachable(model: SdfModel, plugin: ET.Element) -> GraphJoint | None:
    """Return a weld of two links where they are drawn; None where one is of another model."""
    parent, child, other = (plugin.findtext(tag, "").strip()
                            for tag in ("parent_link", "child_link", "child_model"))
    scope = plugin.get("scope", "")
    own = (*OWN, scope.rpartition(SCOPE)[2] or model.model.get("name", ""))
    inner = SCOPE.join(filter(None, (scope, "" if other in own else other)))
    if inner and inner not in model.frames.table:
        inner = inner.removeprefix(f"{model.model.get('name', '')}{SCOPE}")
    if inner and inner not in model.frames.table:
        if child in model.links:
            raise MechanismFileError(
                f"{model.where}: <plugin name={plugin.get('name', '')!r}> holds link {child!r} of "
                f"the model {other!r}, and this model has a link of that name: if it is the same, "
                f"give it that name; if not, {without_it(plugin)}")
        model.notices.append(f"<plugin name={plugin.get('name', '')!r}> takes hold of the model "
                             f"{other!r}, which is not here: left out")
        return None
    names = [SCOPE.join(filter(None, pair)) for pair in ((scope, parent), (inner, child))]
    asking = f"<plugin name={plugin.get('name', '')!r}>"
    one, two = (model.link_of(name, asking) for name in names)
    return GraphJoint("__".join(names), "fixed", one, two,
                      *(model.on_link(names[1], x) for x in (one, two)))


def _of_drake(model: SdfModel, element: ET.Element) -> GraphJoint:
    """Return the joint that a constraint of Drake's is."""
    kind, where = local(element), f"{model.where}: <{local(element)}>"
    name = element.get("name") or kind
    if kind == "weld_constraint":
        names = [element.findtext(tag, "").strip() for tag in ("parent", "child")]
        one, two = (model.link_of(frame, f"<{kind}>") for frame in names)
        return GraphJoint(name, "fixed", one, two, model.on_link(names[0], one),
                          model.on_link(names[1], two))
    if kind == "ball_constraint":
        return GraphJoint(name, "spherical", *_points(model, element))
    values = {local(x).removeprefix(f"{kind}_"): (x.text or "").strip() for x in element}
    if values.get("stiffness", "inf").lstrip("+").lower() not in ("inf", "infinity"):
        raise MechanismFileError(f"{where} yields: it is a spring, which is not read here; write "
                                 f"[[springs]] in a .toml file for it, and {without_it(element)}")
    length = float(number_list(values.get("distance"), 1, f"{where}: <{kind}_distance>")[0])
    if not 0.0 < length < math.inf:
        raise MechanismFileError(f"{where}: <{kind}_distance> is {length}; it must be positive")
    return GraphJoint(name, "distance", *_points(model, element), length=length)


def _points(model: SdfModel, element: ET.Element) -> tuple[str, str, pin.SE3, pin.SE3]:
    """Return the two links of a constraint of Drake's, and the placements of its points on them."""
    kind, where = local(element), f"{model.where}: <{local(element)}>"
    texts = {local(x): x.text or "" for x in element}
    links, placements = [], []
    for body, point in BODIES:
        name = texts.get(f"{kind}_body_{body}", "").strip()
        if name not in model.links:
            raise MechanismFileError(f"{where}: no link {name!r}; {suggestion(name, model.links)}")
        links.append(name)
        at = number_list(texts.get(f"{kind}_p_{point}"), 3, f"{where}: <{kind}_p_{point}>")
        placements.append(pin.SE3(np.eye(3), at))
    return links[0], links[1], placements[0], placements[1]


def couplings(model: SdfModel, joints: tuple[GraphJoint, ...]) -> list[dict[str, Any]]:
    """Return the gearboxes and mimicking axes as couplings of coordinates."""
    entries = []
    for name, element in model.joints.items():
        if element.get("type") == GEARBOX:
            entries.append(_gearbox(model, name, element, joints))
        for tag in AXES:
            mimic = element.find(f"{tag}/mimic")
            if mimic is not None:
                entries.append(_mimic(model, name, tag, mimic))
        entries += [_mimic(model, name, "axis", x) for x in element
                  if is_prefixed(x) and local(x) == "mimic"]
    return entries


def _gearbox(
    model: SdfModel, name: str, element: ET.Element, joints: tuple[GraphJoint, ...]
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
    model: SdfModel, body: str, link: str, about: Array, joints: tuple[GraphJoint, ...], where: str
) -> tuple[GraphJoint, float]:
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


def _mimic(model: SdfModel, name: str, tag: str, mimic: ET.Element) -> dict[str, Any]:
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


def _coordinate(model: SdfModel, joint: str, tag: str) -> str:
    two = PAIR_OF.get(model.joints[joint].get("type", "")) == "universal"
    return f"{joint}.{AXES.get(tag, tag)}" if two else joint
