"""SDFormat, read with standard XML: one model, or a world with one, as a joint graph."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.graph.open_tree import open_tree
from spatial_pin.formats.imported import Imported, Request
from spatial_pin.formats.sdf.couplings import couplings
from spatial_pin.formats.sdf.model import Model
from spatial_pin.formats.sdf.poses import is_true, number_list
from spatial_pin.formats.sdf.unread import refuse_include
from spatial_pin.formats.sources import read_text
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
    model, content, notices = _one_model(root, path)
    reader = Model(model, f"{path}: model {model.get('name', '')!r}", version)
    graph = reader.graph()
    content["closures"] = couplings(reader, graph.joints)
    coupled = {name for table in content["closures"] for name in table["joints"]}
    graph = replace(graph, needed=frozenset(coupled | {x.rpartition(".")[0] for x in coupled}))
    content = {"name": model.get("name") or path.stem, **content}
    return open_tree(graph, str(path), content, (*notices, *reader.notices))


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


def _one_model(root: ET.Element, path: Path) -> tuple[ET.Element, dict[str, Any], list[str]]:
    """Return the one model of a file, what its world says, and notices."""
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
    moving = [model for model in models if not is_true(model, "static")] or models
    if len(moving) != 1:
        names = ", ".join(repr(model.get("name", "")) for model in moving) or "none"
        raise MechanismFileError(f"{path}: it needs exactly one model that is not static; it has "
                                 f"{names}")
    notices += [f"the static model {model.get('name', '')!r} is left out" for model in models
                if model is not moving[0]]
    return moving[0], content, notices

