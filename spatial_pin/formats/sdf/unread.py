"""SDFormat: what joins links and is not read is refused by name; the rest is told."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.sdf.poses import MODEL
from spatial_pin.formats.urdf.elements import is_prefixed, local
from spatial_pin.formats.urdf.leaving_out import without_it

OF_MODEL = ("static", "self_collide", "allow_auto_disable", "enable_wind", "frame", "pose", "link",
            "joint", "plugin", "include", "model", "name")
OF_JOINT = ("parent", "child", "pose", "axis", "axis2", "physics", "sensor", "gearbox_ratio",
            "gearbox_reference_body", "thread_pitch", "screw_thread_pitch")
OF_DRAKE = ("weld_constraint", "ball_constraint", "distance_constraint")
JOINERS = re.compile(r"mimic|detachable|attacher|grasp", re.I)  # plugins that join links
DETACHABLE = "detachable"  # in the name or file of the one that holds two links together
OWN = ("", MODEL)  # what it may call the model that it is in
APART = re.compile(r"collision|filter|friction|gripper|sensor")  # elements that join none


def is_detachable(plugin: ET.Element) -> bool:
    """Return whether a plugin is Gazebo's DetachableJoint."""
    called = f"{plugin.get('name', '')} {plugin.get('filename', '')}".lower()
    return DETACHABLE in called and plugin.find("parent_link") is not None


def refuse_include(where: str, uri: str) -> None:
    """Refuse an <include>.

    Raises:
        MechanismFileError: always.
    """
    raise MechanismFileError(f"{where}: <include> of {uri!r}: models that include others are not "
                             "read; write the included one in its place ('gz sdf -p' does so)")


def unread(model: ET.Element, where: str) -> list[str]:
    """Return the elements of a model that are not read and join nothing.

    Raises:
        MechanismFileError: one joins links, or includes a model.
    """
    for include in model.findall("include"):
        refuse_include(where, (include.findtext("uri") or "").strip())
    found = [_plugin(plugin, where) for plugin in model.iter("plugin")
             if not is_detachable(plugin)]
    names = {x.get("name", "") for tag in ("link", "frame", "joint") for x in model.findall(tag)}
    found += [_unknown(element, names, 2, where) for element in model
              if element.tag not in OF_MODEL and not _is_drakes(element, OF_DRAKE)]
    found += [_unknown(element, names, 1, where) for joint in model.findall("joint")
              for element in joint
              if element.tag not in OF_JOINT and not _is_drakes(element, ("mimic",))]
    return list(dict.fromkeys(found))


def _is_drakes(element: ET.Element, names: tuple[str, ...]) -> bool:
    return is_prefixed(element) and local(element) in names


def _plugin(plugin: ET.Element, where: str) -> str:
    name, file = plugin.get("name", ""), plugin.get("filename", "")
    shown = f"<plugin name={name!r} filename={file!r}>"
    if JOINERS.search(f"{name} {file}"):
        raise MechanismFileError(f"{where}: {shown} joins links or joints when it runs, which is "
                                 "not read here; write a <joint>, or <mimic>, in its place, or "
                                 f"{without_it(plugin)}")
    return shown


def _unknown(element: ET.Element, names: set[str], joins: int, where: str) -> str:
    """Refuse an element of another program that names so many links, frames or joints."""
    tag = local(element)
    texts = {word for x in element.iter() for word in ((x.text or "").strip(), *x.attrib.values())}
    named = sorted(texts & names)
    if len(named) >= joins and not APART.search(tag):
        raise MechanismFileError(f"{where}: <{tag}> joins {', '.join(map(repr, named))} and is not "
                                 f"read; write a <joint> in its place, or {without_it(element)}")
    return f"<{tag}>"
