"""`load`, the one door for files of all formats, and the library of mechanisms."""

from __future__ import annotations

import os
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from spatial_pin._support.checks import number_from_zero
from spatial_pin.errors import MechanismFileError, Mistakes, suggestion, warn
from spatial_pin.formats.checked_tables import TomlTable
from spatial_pin.formats.drawn_tree import drawn_tree
from spatial_pin.formats.file_access import (
    HeldFile,
    Trust,
    check_file,
    is_file,
    library_folder,
    parse_toml,
    parse_urdf,
    read_text,
    shown,
)
from spatial_pin.formats.importers import IMPORTERS, Faults, Importer, Request, endings, importer_of
from spatial_pin.formats.mechanism_file import MechanismSpec, mechanism_of
from spatial_pin.formats.urdf.elements import end_of
from spatial_pin.formats.xacro.expansion import expand
from spatial_pin.formats.xacro.xacro_arguments import arguments
from spatial_pin.mechanism.mechanism import Mechanism

LISTS = ("closures", "springs")
TABLES = ("joints", "frames", "guess")
SAME = "that is the same"
ROOT_JOINT = "root_joint"  # as Pinocchio names it
GROUNDS = ("world", "ground")  # names of the fixed link, the first that is free


def merged(own: Mapping[str, Any], stated: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return the content of a mechanism file and its tree's file, and notices of what was replaced.

    The mechanism file's keys go first. A loop of the tree's file stays, unless the mechanism file
    has a closure of that name or between the same frames; its drivers stay, unless there are
    others.
    """
    both, notices = {**stated, **own}, []
    for key in LISTS:
        mine = own.get(key, [])
        others = []
        for entry in stated.get(key, ()):
            reason = _replaced(entry, mine)
            if reason == SAME:
                continue
            if reason:
                notices.append(f"{key}: {entry['name']!r} ({entry.get('source') or 'of the tree'}) "
                               f"is left out: the mechanism file has one {reason}")
            else:
                others.append(entry)
        if others and isinstance(mine, list):
            both[key] = [*mine, *others]
    for key in TABLES:
        mine = own.get(key, {})
        if isinstance(mine, dict) and stated.get(key):
            both[key] = {**stated[key], **mine}
    for name, table in stated.get("joints", {}).items():
        mine = both["joints"].get(name) if isinstance(both.get("joints"), dict) else None
        if isinstance(mine, dict) and "type" not in mine:
            both["joints"][name] = {**table, **mine}
    return both, notices


def _replaced(entry: Mapping[str, Any], mine: Any) -> str:
    """Return why an entry gives way to one of the mechanism file's, "" where it does not."""
    for other in mine if isinstance(mine, list) else ():
        if isinstance(other, dict) and other.get("name") == entry["name"]:
            same = all(other.get(key) == entry.get(key) for key in ("type", "frames", "joints"))
            return SAME if same else "of that name"
        frames = other.get("frames") if isinstance(other, dict) else None
        if isinstance(frames, list) and frames in (entry.get("frames"),
                                                   entry.get("frames", [])[::-1]) and frames:
            return f"between the same frames: {other.get('name')!r}"
    return ""


def add_free_flyer(robot: ET.Element, path: Path, refined: Container[str] = ()) -> None:
    """Let a floating joint carry the root link of a URDF.

    A new link, `world`, becomes the root (`ground` where a link has that name): closures to what
    stands still name it.
    """
    joints, links = robot.findall("joint"), robot.findall("link")
    children = {end_of(joint, "child") for joint in joints}
    roots = [link for link in links if link.get("name", "") not in children]
    where = f"{shown(path)}: free_flyer=True"
    if not roots:
        return  # no tree: its reader refuses it
    root = roots[0].get("name", "")
    if len(roots) > 1:
        names = ", ".join(link.get("name", "") for link in roots)
        raise MechanismFileError(f"{where}: several links have no parent: {names}; join those that "
                                 "float together by a fixed joint")
    on_root = [joint for joint in joints if end_of(joint, "parent") == root]
    if on_root and roots[0].find("inertial") is None and all(
            x.get("type") == "floating" and x.get("name", "") not in refined for x in on_root):
        link, name = end_of(on_root[0], "child"), on_root[0].get("name")
        raise MechanismFileError(
            f"{where}: link {link!r} floats on joint {name!r} already; leave free_flyer out")
    if ROOT_JOINT in {joint.get("name") for joint in joints}:
        raise MechanismFileError(f"{where}: there is a joint {ROOT_JOINT!r} already; rename it")
    taken = {link.get("name") for link in links}
    numbered = (f"{GROUNDS[-1]}_{k}" for k in range(len(taken) + 1))
    ground = next(name for name in (*GROUNDS, *numbered) if name not in taken)
    joint = ET.Element("joint", name=ROOT_JOINT, type="floating")
    ET.SubElement(joint, "parent", link=ground)
    ET.SubElement(joint, "child", link=root)
    robot.insert(0, ET.Element("link", name=ground))
    robot.insert(1, joint)


def list_mechanisms() -> list[str]:
    """Return the names of the mechanisms that come with the library, sorted.

    Example:
        >>> sp.list_mechanisms()[:4]
        ['bennett', 'bricard', 'crane', 'crank_collar']
    """
    return sorted(path.stem for path in library_folder().glob("*.toml"))


def library_titles() -> dict[str, tuple[str, str]]:
    """Return title and source of every library mechanism by name, without loading any."""
    titles = {}
    for name in list_mechanisms():
        table = tomllib.loads((library_folder() / f"{name}.toml").read_text(encoding="utf-8"))
        titles[name] = table.get("title", ""), table.get("source", "")
    return titles


def load(
    source: str | Path, *, trusted: bool = False, free_flyer: bool = False,
    packages: Mapping[str, str | Path] | None = None, gap: float | None = None,
    model: str | None = None, without: Sequence[str] = (), **parameters: float,
) -> Mechanism:
    """Load a mechanism.

    You may load a file that you do not trust: nothing in it is run as a program. In a xacro file
    `${...}` may hold numbers, texts, names, arithmetic, comparisons, `and`, `or`, `not`, `in`,
    `a if b else c`, lists, tuples, entries `a[i]` and `a.b`, list comprehensions, `%` of texts,
    the functions that xacro offers (those of `math`, and `len`, `min`, `python.sum`,
    `xacro.load_yaml`, ...) and the methods of texts, lists and dictionaries; everything else is
    refused by name, and so is what would take too long or too much memory.

    Args:
        source: name of a library mechanism (`list_mechanisms`), or path of a `.toml` mechanism
            file, or of a `.urdf` or `.urdf.xacro` tree with the loops that are stated inside it or
            in a `robot.yaml` or `loop_closures.yaml` beside it, or of a folder with these, or of an
            MJCF, SDFormat (`.sdf`, `.world`) or USD file.
        trusted: whether a xacro file may include xacro files and load YAML files from anywhere, and
            a USD stage be composed of files from anywhere; otherwise only from below its own folder
            and, xacro, from ROS packages (folders with a `package.xml`, or below those of
            ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and `packages`).
        free_flyer: whether a floating joint, `root_joint`, carries the root link, as Pinocchio's
            JointModelFreeFlyer does; the fixed link is then `world`.
        packages: folders of ROS packages by name, such as {"talos_data": "robots/talos_data"}, in
            which `package://NAME/...` and `$(find NAME)` lie; they go before ROS_PACKAGE_PATH,
            AMENT_PREFIX_PATH, the folders round the file, and installed packages of data.
        gap: largest closure error that redundant equations may keep where the file's numbers are
            rounded: part of the characteristic length, or rad; 0 if the numbers are exact. Default:
            as the file says, else 1e-4. See `State.gap`.
        model: which model of an SDFormat file that has several, by its name; of a nested one
            "outer::inner".
        without: names or tags of elements and joints of the tree's file (not of links) that are
            left out, such as ["tendon_constraint"], where one of them cannot be read;
            `Mechanism.notices` names them.
        **parameters: values of the xacro arguments of its tree [SI, rad].

    Returns:
        The mechanism; its loops are not yet closed, see `assemble`. A warning lists faults of the
        file that do not prevent loading; `Mechanism.notices` has them all. Meshes are read when
        `visual_model` or `collision_model` is first used.

    Raises:
        MechanismFileError: a file cannot be used; names the key, joint or closure. Or
            `free_flyer` is True and the root floats already.
        TypeError: the source is neither a name nor a path, or `trusted` or `free_flyer` neither
            True nor False, or `packages` no dictionary of paths, or `model` no name, or `without`
            no list of names, or a parameter is neither a number nor a text.
        ValueError: a parameter is NaN or infinite.

    Example:
        >>> mech = sp.load("rssr", d=0.315)  # of the library, with a dimension changed [m]
        >>> mech.coordinates
        ('crank_pin', 'ball_a.x', 'ball_a.y', 'ball_a.z', 'rocker_pin')
        >>> list(mech.drivers), round(mech.dimensions["d"], 3)
        (['crank'], 0.315)
    """
    if not isinstance(source, str | PathLike) or isinstance(fspath(source), bytes):
        raise TypeError(f"a mechanism is loaded by its name or path, not {source!r}")
    for key, given in (("trusted", trusted), ("free_flyer", free_flyer)):
        if not isinstance(given, bool | np.bool_):
            raise TypeError(f"{key} is True or False, not {given!r}")
    if not (model is None or isinstance(model, str)):
        raise TypeError(f"model is the name of one, not {model!r}")
    if not isinstance(without, list | tuple) or not all(isinstance(x, str) for x in without):
        raise TypeError(f"without is a list of names, not {without!r}")
    path, folders = _find(source), _folders(packages) if packages else {}
    request = Request(path, parameters, trusted, folders, model=model, without=tuple(without),
                      free_flyer=free_flyer)
    try:
        mechanism = _loaded(request)
    except MechanismFileError as error:
        empty = _empty_arguments(request)
        if not empty:
            raise
        raise MechanismFileError(f"{error} (empty xacro arguments: {', '.join(empty)}; "
                                 f"load(..., {empty[0]}=...) gives a value)") from error
    return mechanism if gap is None else mechanism.with_fields(gap=number_from_zero(gap, "gap"))


def load_expanded(mechanism: Mechanism, parameters: Mapping[str, float], urdf: str) -> Mechanism:
    """Return a mechanism of other parameters, for which its xacro file is expanded to `urdf`."""
    m = mechanism
    assert m.path is not None
    made = _loaded(replace(Request.of(m, m.path, parameters), without=m.without,
                           free_flyer=m.free_flyer, expanded=urdf))
    return made.with_fields(gap=m.gap)


def _loaded(request: Request) -> Mechanism:
    """Return the mechanism of a request."""
    if request.path.suffix == ".toml":
        return _load_toml(request)
    importer = importer_of(request.path)
    assert importer is not None  # else there is no such file
    request = _for_file(request, request.path, importer)
    imported, path = importer.read(request), request.path
    name = path.name.removesuffix(".xacro").removesuffix(".urdf")
    content = {"name": name, "tree": path.name, **imported.content}
    return made_of(content, path, imported.robot(path), request, imported.notices)


def _folders(packages: Mapping[str, str | Path]) -> dict[str, Path]:
    """Return the folders of packages, absolute."""
    if not isinstance(packages, Mapping):
        raise TypeError(f"packages are folders by name, not {packages!r}")
    folders = {}
    for name, folder in packages.items():
        if not isinstance(name, str) or not isinstance(folder, str | Path):
            raise TypeError(f"packages are folders by name, not {name!r}: {folder!r}")
        if not os.path.isdir(folder):  # unlike Path.is_dir, false for names that are too long
            raise MechanismFileError(f"packages: {name!r}: there is no folder {shown(folder)!r}")
        folders[name] = Path(folder).resolve()
    return folders


def _find(source: str | Path) -> Path:
    path = source if isinstance(source, Path) else Path(source)
    if path.suffix == ".toml":
        check_file(path)
        return path
    shipped = library_folder() / f"{source}.toml"
    if path.name == str(source) and is_file(shipped):
        return shipped
    if fspath(source) and importer_of(path) is not None:
        return path
    raise MechanismFileError(
        f"no mechanism {shown(path)!r}: neither a file ({', '.join(endings())}) nor in the "
        f"library; {suggestion(shown(path), list_mechanisms())}"
    )


def _load_toml(request: Request) -> Mechanism:
    path = request.path
    top = TomlTable(parse_toml(read_text(path), path), str(path))
    if "bodies" in top:  # cuts of a drawing are no faults, so no warning
        xacro, content, notices = drawn_tree(top.content, top.where)
        held = HeldFile.of(path.parent / content["tree"], xacro)
        text = request.expanded or expand(replace(request, path=held))
        made = made_of(content, held, parse_urdf(text, held), request, ())
        return made.with_fields(notices=(*notices, *made.notices))
    mistakes = Mistakes(str(path))
    with mistakes.each():
        file = _tree_of(top, request)
        importer = importer_of(file) or IMPORTERS["urdf"]
        complete = top.flag("complete")
        request = _for_file(request, file, importer)
        tree = importer.read(replace(request, path=file, complete=complete,
                                     alone=not complete and "closures" not in top))
        stated = {key: x for key, x in tree.content.items()
                  if not complete or key not in (*LISTS, "drivers", "passive", "guess")}
        content, replaced = merged(top.content, stated)
    if mistakes:
        MechanismSpec(top, mistakes, Trust.of(path, request.packages, request.trusted))
        mistakes.raise_all()
    return made_of(content, file, tree.robot(file), request, (*tree.notices, *replaced))


def _for_file(request: Request, file: Path, importer: Importer) -> Request:
    """Return a request for a file: `model` chooses among several, or is a xacro argument."""
    if file.suffix == ".xacro" and request.model is not None:
        own: dict[str, Any] = {**request.parameters, "model": request.model}
        return replace(request, parameters=own, model=None)
    if file.suffix != ".xacro" and request.parameters:
        raise MechanismFileError(f"{shown(file)}: parameters {sorted(request.parameters)} given, "
                                 "but only .xacro files have any")
    if request.model is not None and not importer.has_models:
        raise MechanismFileError(f"{shown(file)}: only a file of SDFormat may hold several models, "
                                 f"one of them {request.model!r}; leave `model` out")
    return request


def _empty_arguments(request: Request) -> list[str]:
    """Return the arguments of a xacro file that have no value, where that is known."""
    file = request.path
    try:
        if file.suffix == ".toml":
            top = TomlTable(parse_toml(read_text(file), file), str(file))
            if "bodies" in top:
                return []
            file = _tree_of(top, request)
        if file.suffix != ".xacro":
            return []
        texts = arguments(replace(request, path=file))
    except (MechanismFileError, TypeError, ValueError):
        return []
    return [name for name, text in texts.items() if not text.strip()]


def _tree_of(top: TomlTable, request: Request) -> Path:
    """Return the file of the tree."""
    name = top.text("tree")
    file = request.path.parent / name
    try:
        request.trust.checked(file)
    except MechanismFileError as error:
        top.fail("tree", f"is {shown(name)!r}: {error}")
    return file


def made_of(
    content: dict[str, Any], file: Path, robot: ET.Element, request: Request,
    notices: Iterable[str],
) -> Mechanism:
    """Return the mechanism of a file's content and the tree of `file`; a warning names faults."""
    faults = Faults()
    for notice in notices:
        faults.note(notice)
    if request.free_flyer:
        joints = content.get("joints")
        tables = joints if isinstance(joints, dict) else {}
        refined = [name for name, x in tables.items() if isinstance(x, dict) and "type" in x]
        add_free_flyer(robot, file, refined)
    made = mechanism_of(TomlTable(content, str(request.path)), file, robot, request, faults)
    if summary := faults.summary():
        warn(f"{shown(request.path)}: {summary}")
    return made
