"""SDFormat: what joins links and is not read is refused by name; the rest is told."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.urdf.elements import local

OF_MODEL = ("static", "self_collide", "allow_auto_disable", "enable_wind", "frame", "pose", "link",
            "joint", "plugin", "include", "model", "name")
OF_JOINT = ("parent", "child", "pose", "axis", "axis2", "physics", "sensor", "gearbox_ratio",
            "gearbox_reference_body", "thread_pitch", "screw_thread_pitch")
JOINERS = re.compile(r"mimic|detachable|attacher|grasp", re.I)  # plugins that join links
APART = re.compile(r"collision|filter|friction|gripper|sensor")  # elements that join none


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
        MechanismFileError: one joins links, or holds a model in it.
    """
    for include in model.findall("include"):
        refuse_include(where, (include.findtext("uri") or "").strip())
    for nested in model.findall("model"):
        raise MechanismFileError(f"{where}: the nested <model name={nested.get('name', '')!r}> is "
                                 "not read; put its links and joints in the model itself")
    found = [_plugin(plugin, where) for plugin in model.iter("plugin")]
    names = {x.get("name", "") for tag in ("link", "frame", "joint") for x in model.findall(tag)}
    found += [_unknown(element, names, 2, where) for element in model
              if element.tag not in OF_MODEL]
    found += [_unknown(element, names, 1, where) for joint in model.findall("joint")
              for element in joint if element.tag not in OF_JOINT]
    return list(dict.fromkeys(found))


def _plugin(plugin: ET.Element, where: str) -> str:
    name, file = plugin.get("name", ""), plugin.get("filename", "")
    shown = f"<plugin name={name!r} filename={file!r}>"
    if JOINERS.search(f"{name} {file}"):
        raise MechanismFileError(f"{where}: {shown} joins links or joints when it runs, which is "
                                 "not read here; write a <joint>, or <mimic>, in its place")
    return shown


def _unknown(element: ET.Element, names: set[str], joins: int, where: str) -> str:
    """Refuse an element of another program that names so many links, frames or joints."""
    tag = local(element)
    texts = {word for x in element.iter() for word in ((x.text or "").strip(), *x.attrib.values())}
    named = sorted(texts & names)
    if len(named) >= joins and not APART.search(tag):
        raise MechanismFileError(f"{where}: <{tag}> joins {', '.join(map(repr, named))} and is not "
                                 "read; write a <joint> in its place")
    return f"<{tag}>"
