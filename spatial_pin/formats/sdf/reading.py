"""SDFormat, read with standard XML: one model, or a world with one, as a joint graph."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.graph.open_tree import open_tree
from spatial_pin.formats.imported import Imported, Request
from spatial_pin.formats.sdf.constraints import constraints
from spatial_pin.formats.sdf.couplings import couplings
from spatial_pin.formats.sdf.model import Model
from spatial_pin.formats.sdf.nested import SCOPE, with_nested
from spatial_pin.formats.sdf.poses import is_true, number_list
from spatial_pin.formats.sdf.unread import refuse_include
from spatial_pin.formats.sources import read_text, shown
from spatial_pin.formats.urdf.leaving_out import leave_out
from spatial_pin.formats.xacro.parsing import parse_xml, without

OLDEST, NEWEST = (1, 4), (1, 12)
SCENERY = ("model://sun", "model://ground_plane")


def read(request: Request) -> Imported:
    """Read an SDFormat file.

    Raises:
        MechanismFileError: it cannot be used; says which element and why.
    """
    path = request.path
    if request.parameters:
        raise MechanismFileError(f"{path}: parameters {sorted(request.parameters)} given, but only "
                                 ".xacro files have any")
    root = parse_xml(_plain(read_text(path)), path)
    version = _version(root, path)
    without = leave_out(root, request.without, shown(path))
    model, content, notices = _one_model(root, path, request.model)
    where = f"{path}: model {model.get('name', '')!r}"
    reader = Model(with_nested(model, where, version), where, version)
    graph = reader.graph()
    graph = replace(graph, joints=(*graph.joints, *constraints(reader)))
    content["closures"] = couplings(reader, graph.joints)
    coupled = {name for table in content["closures"] for name in table["joints"]}
    graph = replace(graph, needed=frozenset(coupled | {x.rpartition(".")[0] for x in coupled}))
    content = {"name": model.get("name") or path.stem, **content}
    return open_tree(graph, str(path), content, (*without, *notices, *reader.notices))


def _plain(text: str) -> str:
    """Return XML text without comments and declaration: in SDFormat these may stand as they like.

    Lines keep their numbers.
    """
    return without(without(text, "<!--", "-->"), "<?xml", "?>").lstrip(" \t\ufeff")


def _version(root: ET.Element, path: Path) -> tuple[int, int]:
    if root.tag != "sdf":
        raise MechanismFileError(f"{path}: the root element is <{root.tag}>, not <sdf>")
    found = re.fullmatch(r"\s*(\d+)\.(\d+)(\.\d+)?\s*", root.get("version", ""))
    version = (int(found[1]), int(found[2])) if found else (0, 0)
    if not OLDEST <= version <= NEWEST:
        raise MechanismFileError(
            f"{path}: SDFormat version {root.get('version', '')!r}; versions "
            f"{'.'.join(map(str, OLDEST))} to {'.'.join(map(str, NEWEST))} are read")
    return version


def _one_model(
    root: ET.Element, path: Path, name: str | None
) -> tuple[ET.Element, dict[str, Any], list[str]]:
    """Return the one model of a file, or that of the name, what its world says, and notices."""
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
    alone = ET.Element(chosen.tag, chosen.attrib)  # it stands in no outer model here
    alone.extend(x for x in chosen if x.tag != "pose")
    return alone

