"""SDFormat: what holds links together beside joints. It closes loops, so that it is cut.

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

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.graph.joints import Joint
from spatial_pin.formats.sdf.model import Model
from spatial_pin.formats.sdf.nested import SCOPE
from spatial_pin.formats.sdf.poses import number_list
from spatial_pin.formats.sdf.unread import OWN, is_detachable
from spatial_pin.formats.urdf.elements import is_prefixed, local
from spatial_pin.formats.urdf.leaving_out import without_it
from spatial_pin.formats.urdf.writing import unique

BODIES = ("A", "AP"), ("B", "BQ")  # of Drake's constraints: body and point on it


def constraints(model: Model) -> list[Joint]:
    """Return what holds links together beside joints.

    Raises:
        MechanismFileError: it names a link that does not exist, or is of a kind that is not read.
    """
    joints: dict[str, Joint] = {}
    for element in model.model:
        joint = None
        if element.tag == "plugin" and is_detachable(element):
            joint = _detachable(model, element)
        elif is_prefixed(element) and local(element) in READERS:
            joint = READERS[local(element)](model, element)
        if joint is not None:
            name = unique(joint.name, [*model.joints, *joints])
            joints[name] = joint.but(name=name, cut=True)
    return list(joints.values())


def _detachable(model: Model, plugin: ET.Element) -> Joint | None:
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
    return Joint("__".join(names), "fixed", one, two, *(model.on_link(names[1], x)
                                                        for x in (one, two)))


def _weld(model: Model, element: ET.Element) -> Joint:
    names = [element.findtext(tag, "").strip() for tag in ("parent", "child")]
    one, two = (model.link_of(name, f"<{local(element)}>") for name in names)
    return Joint(_name(element), "fixed", one, two, model.on_link(names[0], one),
                 model.on_link(names[1], two))


def _ball(model: Model, element: ET.Element) -> Joint:
    return Joint(_name(element), "spherical", *_points(model, element))


def _distance(model: Model, element: ET.Element) -> Joint:
    kind, where = local(element), f"{model.where}: <{local(element)}>"
    values = {local(x).removeprefix(f"{kind}_"): (x.text or "").strip() for x in element}
    if values.get("stiffness", "inf").lstrip("+").lower() not in ("inf", "infinity"):
        raise MechanismFileError(f"{where} yields: it is a spring, which is not read here; write "
                                 f"[[springs]] in a .toml file for it, and {without_it(element)}")
    length = float(number_list(values.get("distance"), 1, f"{where}: <{kind}_distance>")[0])
    if not 0.0 < length < math.inf:
        raise MechanismFileError(f"{where}: <{kind}_distance> is {length}; it must be positive")
    return Joint(_name(element), "distance", *_points(model, element), length=length)


READERS = {"weld_constraint": _weld, "ball_constraint": _ball, "distance_constraint": _distance}


def _points(model: Model, element: ET.Element) -> tuple[str, str, pin.SE3, pin.SE3]:
    """Return the two links of a constraint of Drake's, and the placements of its points on them."""
    kind, where = local(element), f"{model.where}: <{local(element)}>"
    texts = {local(x): x.text or "" for x in element}
    links, places = [], []
    for body, point in BODIES:
        name = texts.get(f"{kind}_body_{body}", "").strip()
        if name not in model.links:
            raise MechanismFileError(f"{where}: no link {name!r}; {suggestion(name, model.links)}")
        links.append(name)
        at = number_list(texts.get(f"{kind}_p_{point}"), 3, f"{where}: <{kind}_p_{point}>")
        places.append(pin.SE3(np.eye(3), at))
    return links[0], links[1], places[0], places[1]


def _name(element: ET.Element) -> str:
    return element.get("name") or local(element)
