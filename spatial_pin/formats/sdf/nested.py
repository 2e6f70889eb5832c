"""SDFormat: models within a model, put into the outer one under names such as "inner::link".

What an inner model places by its own frame, `__model__`, is placed by a frame of the outer model
that has the inner model's name. Poses stay relative to what they were relative to.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.sdf.model import Model
from spatial_pin.formats.sdf.poses import MODEL, WORLDS, pose
from spatial_pin.formats.urdf.elements import local, numbers_text

SCOPE = "::"
ATTRIBUTES = ("relative_to", "frame", "attached_to", "expressed_in")  # that name a frame
TEXTS = ("parent", "child", "gearbox_reference_body")  # elements whose text names one
ENDS = ("_body_A", "_body_B")  # of the names of Drake's elements that do
NAMED = ("link", "joint", "frame", "plugin")  # elements that an inner model brings along


def with_nested(model: ET.Element, where: str, version: tuple[int, int]) -> ET.Element:
    """Return a model with the models within it, as one.

    Raises:
        MechanismFileError: one has no name or link, or something in it cannot be read.
    """
    if model.find("model") is None:
        return model
    whole = ET.Element(model.tag, model.attrib)
    whole.extend(x for x in model if x.tag != "model")
    for inner in model.findall("model"):
        whole.extend(_parts(with_nested(inner, where, version), where, version))
    return whole


def _parts(inner: ET.Element, where: str, version: tuple[int, int]) -> list[ET.Element]:
    """Return what an inner model, itself without inner ones, brings into the outer one."""
    name = inner.get("name", "")
    where = f"{where}: nested model {name!r}"
    if not name:
        raise MechanismFileError(f"{where} has no name")
    alone = ET.Element(inner.tag, {k: x for k, x in inner.attrib.items() if k != "placement_frame"})
    alone.extend(x for x in inner if x.tag != "pose")
    reader = Model(alone, where, version)  # which refuses what cannot be read
    frame = ET.Element("frame", name=name, attached_to=f"{name}{SCOPE}{reader.canonical}")
    stated, by = inner.find("pose"), inner.get("placement_frame")
    placement = pose(stated, where)
    if by:
        placement = placement * reader.frames.in_world(by, "placement_frame").inverse()
    turn = pin.Quaternion(placement.rotation).coeffs()
    at = ET.SubElement(frame, "pose", rotation_format="quat_xyzw",
                       relative_to=reader.frames.relative_to(stated, MODEL))
    at.text = numbers_text(np.concatenate([placement.translation, turn]))
    brought = [x for x in inner if x.tag in NAMED or "}" in str(x.tag)]
    return [frame, *(_scoped(x, name) for x in brought)]


def _scoped(element: ET.Element, scope: str) -> ET.Element:
    """Return an element of an inner model with the names that it has in the outer one."""
    moved = copy.deepcopy(element)
    if "name" in moved.attrib and moved.tag != "plugin":
        moved.set("name", f"{scope}{SCOPE}{moved.get('name')}")
    if moved.tag == "plugin":
        moved.set("scope", SCOPE.join(filter(None, (scope, moved.get("scope")))))
    for part in moved.iter():
        for key in ATTRIBUTES:
            if part.get(key):
                part.set(key, _name(part.get(key, ""), scope))
        if local(part) == "mimic" and part.get("joint"):
            part.set("joint", _name(part.get("joint", ""), scope))
        if moved.tag != "plugin" and (local(part) in TEXTS or local(part).endswith(ENDS)):
            part.text = _name((part.text or "").strip(), scope)
    _place(moved, scope)
    return moved


def _name(name: str, scope: str) -> str:
    """Return what the outer model calls a link, joint or frame of an inner one."""
    if name in WORLDS:
        return name
    return scope if name in ("", MODEL) else f"{scope}{SCOPE}{name}"


def _place(moved: ET.Element, scope: str) -> None:
    """Put the inner model's frame where an element is placed or turned by it without a word."""
    if moved.tag == "frame" and not moved.get("attached_to"):
        moved.set("attached_to", scope)
    if moved.tag == "link":
        at = moved.find("pose")
        if at is None:
            at = ET.SubElement(moved, "pose")
        if not (at.get("relative_to") or at.get("frame")):
            at.set("relative_to", scope)
    for axis in (*moved.findall("axis"), *moved.findall("axis2")):
        flag, xyz = axis.find("use_parent_model_frame"), axis.find("xyz")
        if flag is not None and (flag.text or "").strip().lower() in ("1", "true"):
            axis.remove(flag)
            if xyz is None:
                xyz = ET.SubElement(axis, "xyz")
                xyz.text = "0 0 1"
            xyz.set("expressed_in", scope)
