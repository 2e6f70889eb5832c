"""SDFormat, read with standard XML: one model, or a world with one, as a joint graph.

Models within a model are put into the outer one under names such as "inner::link". What an inner
model places by its own frame, `__model__`, is placed by a frame of the outer model that has the
inner model's name. Poses stay relative to the same frames.

What holds links together beside joints closes loops, so that it is cut. Gearboxes and mimicking
axes, Drake's too, are couplings of joint coordinates.

| element | becomes |
|---|---|
| Gazebo's plugin DetachableJoint | a weld of two links where the file draws them |
| `<drake:weld_constraint>` | a weld of two frames |
| `<drake:ball_constraint>` | a ball between two points |
| `<drake:distance_constraint>` | a distance between two points |
"""

from __future__ import annotations

import copy
import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.file_access import parse_xml, read_text, shown, without as without_parts
from spatial_pin.formats.graph.joint_graph import GraphJoint
from spatial_pin.formats.graph.open_tree import open_tree
from spatial_pin.formats.importers import Imported, Request
from spatial_pin.formats.sdf.sdf_elements import (
    MODEL,
    SCOPE,
    WORLDS,
    is_true,
    number,
    number_list,
    pose,
)
from spatial_pin.formats.sdf.sdf_model import (
    AXES,
    GEARBOX,
    OF_DRAKE,
    OWN,
    PAIR_OF,
    SdfModel,
    is_detachable,
    refuse_include,
)
from spatial_pin.formats.urdf.elements import (
    is_prefixed,
    leave_out,
    local,
    numbers_text,
    unique,
    without_it,
)
from spatial_pin.numerics.linalg import Array

BODIES = ("A", "AP"), ("B", "BQ")  # of Drake's constraints: body and point on it
PARALLEL_AXES = 1e-2  # sine of the angle of two axes: files write 1.57 for a right angle
ATTRIBUTES = ("relative_to", "frame", "attached_to", "expressed_in")  # that name a frame
TEXTS = ("parent", "child", "gearbox_reference_body")  # elements whose text names one
ENDS = ("_body_A", "_body_B")  # of the names of Drake's elements that do
NAMED = ("link", "joint", "frame", "plugin")  # elements that an inner model brings along
OLDEST, NEWEST = (1, 4), (1, 12)
SCENERY = ("model://sun", "model://ground_plane")


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
            joints[name] = replace(joint, name=name, cut=True)
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


def with_nested(model: ET.Element, where: str, version: tuple[int, int]) -> ET.Element:
    """Return a model with the models within it, as one."""
    if model.find("model") is None:
        return model
    whole = ET.Element(model.tag, model.attrib)
    whole.extend(x for x in model if x.tag != "model")
    for inner in model.findall("model"):
        whole.extend(_parts(with_nested(inner, where, version), where, version))
    return whole


def _parts(inner: ET.Element, where: str, version: tuple[int, int]) -> list[ET.Element]:
    """Return the elements of an inner model, itself without inner ones, for the outer one."""
    name = inner.get("name", "")
    where = f"{where}: nested model {name!r}"
    if not name:
        raise MechanismFileError(f"{where} has no name")
    alone = ET.Element(inner.tag, {k: x for k, x in inner.attrib.items() if k != "placement_frame"})
    alone.extend(x for x in inner if x.tag != "pose")
    reader = SdfModel(alone, where, version)  # which refuses what cannot be read
    frame = ET.Element("frame", name=name, attached_to=f"{name}{SCOPE}{reader.canonical}")
    stated, by = inner.find("pose"), inner.get("placement_frame")
    placement = pose(stated, where)
    if by:
        placement = placement * reader.frames.in_world(by, "placement_frame").inverse()
    turn = pin.Quaternion(placement.rotation).coeffs()
    at = ET.SubElement(frame, "pose", rotation_format="quat_xyzw",
                       relative_to=reader.frames.relative_to(stated, MODEL))
    at.text = numbers_text(np.concatenate([placement.translation, turn]))
    return [frame, *(_scoped(x, name) for x in inner if x.tag in NAMED or "}" in str(x.tag))]


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
    _move_into(moved, scope)
    return moved


def _name(name: str, scope: str) -> str:
    """Return the outer model's name of a link, joint or frame of an inner one."""
    if name in WORLDS:
        return name
    return scope if name in ("", MODEL) else f"{scope}{SCOPE}{name}"


def _move_into(moved: ET.Element, scope: str) -> None:
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


def read(request: Request) -> Imported:
    """Read an SDFormat file."""
    path = request.path
    # in SDFormat comments and declaration may be anywhere
    text = without_parts(without_parts(read_text(path), "<!--", "-->"), "<?xml", "?>")
    root = parse_xml(text.lstrip(" \t\ufeff"), path)
    version = _version(root, path)
    without = leave_out(root, request.without, shown(path))
    model, content, notices = _one_model(root, path, request.model)
    where = f"{path}: model {model.get('name', '')!r}"
    reader = SdfModel(with_nested(model, where, version), where, version)
    graph = reader.graph()
    graph = replace(graph, joints=(*graph.joints, *constraints(reader)))
    content["closures"] = couplings(reader, graph.joints)
    coupled = {name for table in content["closures"] for name in table["joints"]}
    graph = replace(graph, needed=frozenset(coupled | {x.rpartition(".")[0] for x in coupled}))
    content = {"name": model.get("name") or path.stem, **content}
    return open_tree(graph, str(path), content, (*without, *notices, *reader.notices))


def _version(root: ET.Element, path: Path) -> tuple[int, int]:
    if root.tag != "sdf":
        raise MechanismFileError(f"{path}: the root element is <{root.tag}>, not <sdf>")
    match = re.fullmatch(r"\s*(\d+)\.(\d+)(\.\d+)?\s*", root.get("version", ""))
    version = (int(match[1]), int(match[2])) if match else (0, 0)
    if not OLDEST <= version <= NEWEST:
        raise MechanismFileError(
            f"{path}: SDFormat version {root.get('version', '')!r}; versions "
            f"{'.'.join(map(str, OLDEST))} to {'.'.join(map(str, NEWEST))} are read")
    return version


def _one_model(
    root: ET.Element, path: Path, name: str | None
) -> tuple[ET.Element, dict[str, Any], list[str]]:
    """Return the one model of a file, or that of the name, content of its world, and notices."""
    models, content, notices = root.findall("model"), {}, []
    for world in root.findall("world"):
        where = f"{path}: world {world.get('name', '')!r}"
        for include in world.findall("include"):
            uri = (include.findtext("uri") or "").strip()
            if uri not in SCENERY:
                refuse_include(where, uri)
        for joint in world.findall("joint"):
            raise MechanismFileError(f"{where}: <joint name={joint.get('name', '')!r}> joins "
                                     "models; only joints within one model are read")
        gravity = world.find("gravity")
        if gravity is None:
            gravity = world.find("physics/gravity")  # up to version 1.5
        if gravity is not None:
            content["gravity"] = number_list(gravity.text, 3, f"{where}: <gravity>").tolist()
        models += world.findall("model")
    if name is not None:
        chosen = _named(models, name, path)
        others = [x.get("name", "") for x in models if x is not chosen]
        if others and SCOPE not in name:
            notices.append(f"of {len(models)} models only {name!r} is read")
        return chosen, content, notices
    moving = [model for model in models if not is_true(model, "static")] or models
    if len(moving) != 1:
        names = [repr(model.get("name", "")) for model in moving]
        choice = f"; load(..., model={names[0]}) takes one of them" if names else ""
        raise MechanismFileError(f"{path}: it needs exactly one model that is not static; it has "
                                 f"{', '.join(names) or 'none'}{choice}")
    notices += [f"the static model {model.get('name', '')!r} is left out" for model in models
                if model is not moving[0]]
    return moving[0], content, notices


def _named(models: list[ET.Element], name: str, path: Path) -> ET.Element:
    """Return the model of a name, of an inner one "outer::inner"."""
    chosen, inner = None, models
    for part in name.split(SCOPE):
        named = {x.get("name", ""): x for x in inner}
        if part not in named:
            raise MechanismFileError(f"{shown(path)}: there is no model {name!r}; "
                                     f"{suggestion(part, named)}")
        chosen = named[part]
        inner = chosen.findall("model")
    assert chosen is not None
    if SCOPE not in name:
        return chosen
    alone = ET.Element(chosen.tag, chosen.attrib)  # without an outer model
    alone.extend(x for x in chosen if x.tag != "pose")
    return alone
