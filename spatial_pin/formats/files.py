"""Mechanism files: TOML beside a URDF, checked key by key; and `load`, the one door."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from spatial_pin.errors import MechanismFileError, suggestion, warn
from spatial_pin.formats import urdf_importer
from spatial_pin.formats.faults import Faults
from spatial_pin.formats.free_flyer import with_free_flyer
from spatial_pin.formats.graph.urdf import without_loops
from spatial_pin.formats.imported import Imported, Request
from spatial_pin.formats.merging import merged
from spatial_pin.formats.sources import check_file, is_file, read_text, shown
from spatial_pin.formats.table import endings, importer_of
from spatial_pin.formats.toml_files import parse_toml
from spatial_pin.formats.urdf.model import LIMITS, RESISTANCES, JointRefinement, Tree, tree_of
from spatial_pin.formats.xacro.expansion import dimensions
from spatial_pin.mechanism.checks import check_mechanism, impossible_inertias
from spatial_pin.mechanism.coordinates import check_guess
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.named_frames import Frame, add_frames
from spatial_pin.mechanism.pairs import (
    CLOSURE_TYPES,
    COUPLING,
    JOINT_TYPES,
    PAIRS,
    Pair,
    PairGeometry,
    closure_geometry,
    unit,
)
from spatial_pin.mechanism.parts import Closure, Driver, Passive, Spring, drivers_of_tree
from spatial_pin.numerics.linalg import Array

_REQUIRED: Any = object()
BETWEEN = "length_between"
TOP = "at the top of the file, before the first [table]"
BELONGS = {  # where in a file each key has its place
    TOP: ("name", "title", "source", "tree", "gravity", "order", "joints", "closures", "drivers",
          "springs", "passive", "frames", "guess"),
    "in [joints.NAME]": ("type", "axis", "axis2", "lead", *RESISTANCES, *LIMITS),
    "in [[closures]]": ("name", "type", "frames", "joints", "ratio", "offset", "length", BETWEEN,
                        "equations", "axis", "axis2", "lead", "source"),
    "in [drivers.NAME]": ("joint",),
    "in [[springs]]": ("name", "frames", "joint", "stiffness", "damping", "free_length",
                       "free_angle"),
    "in [passive.NAME]": ("body", "axis"),
    "in [frames.NAME]": ("link", "xyz", "rpy"),
}
SPRING = ("stiffness", "damping", "free_length", "free_angle")
LONGEST = 80  # letters of a value in a message


def library_folder() -> Path:
    """Return the folder of the mechanisms that come with the library."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "urdf"
    return shipped if shipped.is_dir() else package.parent / "urdf"


def list_mechanisms() -> list[str]:
    """Return the names of the mechanisms that come with the library, sorted."""
    return sorted(path.stem for path in library_folder().glob("*.toml"))


def library_titles() -> dict[str, tuple[str, str]]:
    """Return title and source of every library mechanism by name, without loading any."""
    found = {}
    for name in list_mechanisms():
        table = tomllib.loads((library_folder() / f"{name}.toml").read_text(encoding="utf-8"))
        found[name] = table.get("title", ""), table.get("source", "")
    return found


def load(
    source: str | Path, *, trusted: bool = False, free_flyer: bool = False,
    packages: Mapping[str, str | Path] | None = None, **parameters: float,
) -> Mechanism:
    """Load a mechanism.

    A file need not be trusted to be loaded: nothing in it is run as a program. In a xacro file
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
            JointModelFreeFlyer does; what stands still is then the link `world`.
        packages: folders of ROS packages by name, such as {"talos_data": "robots/talos_data"}, in
            which `package://NAME/...` and `$(find NAME)` lie; they go before ROS_PACKAGE_PATH,
            AMENT_PREFIX_PATH, the folders round the file, and installed packages of data.
        **parameters: values of the xacro arguments of its tree [SI, rad].

    Returns:
        The mechanism; its loops are not yet closed, see `assemble`. A warning tells of faults in
        the file that it could be loaded with; `Mechanism.notices` has them all. Meshes are read
        when `visual_model` or `collision_model` is first asked for.

    Raises:
        MechanismFileError: a file cannot be used; says which key, joint or closure, and why. Or
            its root floats already where it is to be made floating.
        TypeError: the source is neither a name nor a path, or `trusted` or `free_flyer` neither
            True nor False, or `packages` no dictionary of paths, or a parameter is neither a
            number nor a text.
        ValueError: a parameter is NaN or infinite.
    """
    if not isinstance(source, str | PathLike) or isinstance(fspath(source), bytes):
        raise TypeError(f"a mechanism is loaded by its name or path, not {source!r}")
    for key, given in (("trusted", trusted), ("free_flyer", free_flyer)):
        if not isinstance(given, bool | np.bool_):
            raise TypeError(f"{key} is True or False, not {given!r}")
    folders = _folders(packages or {})
    request = Request(_find(source), parameters, trusted, folders, free_flyer)
    if request.path.suffix == ".toml":
        return _load_toml(request)
    importer = importer_of(request.path)
    assert importer is not None  # otherwise it was not found
    return _imported(importer.read(request), request)


def _folders(packages: Mapping[str, str | Path]) -> dict[str, Path]:
    """Return the folders of packages, absolute.

    Raises:
        TypeError: they are no folders by name.
        MechanismFileError: one is not there.
    """
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
    path = Path(source)
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


def _imported(imported: Imported, request: Request) -> Mechanism:
    """Return the mechanism of what an importer read."""
    path, faults = request.path, Faults()
    for notice in imported.notices:
        faults.note(notice)
    name = path.name.removesuffix(".xacro").removesuffix(".urdf")
    content = {"name": name, "tree": path.name, **imported.content}
    return _told(content, path, imported.urdf, request, faults)


def _load_toml(request: Request) -> Mechanism:
    path, faults = request.path, Faults()
    top = _Table(parse_toml(read_text(path), path), str(path))
    top.text("name")
    file = path.parent / top.text("tree")
    try:
        check_file(file)
    except MechanismFileError as error:
        top.fail("tree", f"is {shown(top.text('tree'))!r}: {error}")
    read = (importer_of(file) or urdf_importer.IMPORTER).read
    tree = read(replace(request, path=file, alone="closures" not in top))
    content, left_out = merged(top.content, tree.content)
    for notice in (*tree.notices, *left_out):
        faults.note(notice)
    return _told(content, file, tree.urdf, request, faults)


def _told(
    content: dict[str, Any], file: Path, urdf: str, request: Request, faults: Faults
) -> Mechanism:
    """Return the mechanism of a file's content and the tree of `file`; its faults are told."""
    text = _floated(urdf, file, content) if request.free_flyer else urdf
    made = _of_table(_Table(content, str(request.path)), file, text, request, faults)
    _tell(request.path, faults)
    return made


def _tell(path: Path, faults: Faults) -> None:
    told = faults.told()
    if told:
        warn(f"{shown(path)}: {told}")


def _floated(urdf: str, path: Path, content: Mapping[str, Any]) -> str:
    """Return URDF text with a floating joint below its root."""
    joints = content.get("joints")
    tables = joints if isinstance(joints, dict) else {}
    refined = [name for name, x in tables.items() if isinstance(x, dict) and "type" in x]
    return with_free_flyer(urdf, path, refined)


def from_text(urdf: str, content: Mapping[str, Any], name: str) -> Mechanism:
    """Return the mechanism of plain URDF text and what a mechanism file says beside it.

    Args:
        urdf: the open tree; mesh files are named by absolute paths.
        content: as `tomllib` reads a mechanism file.
        name: stands for the file in errors.

    Raises:
        MechanismFileError: as `load`.
    """
    path = Path(name)
    made = _of_table(_Table(dict(content), name), path, urdf, Request(path), Faults())
    return made.with_fields(path=None, tree=None, dimensions={})


def _of_table(
    top: _Table, file: Path, urdf: str, request: Request, faults: Faults
) -> Mechanism:
    """Return the mechanism of the expanded URDF of `file` and the table of the file asked for."""
    name, _ = top.text("name"), top.text("tree")
    refinements = {joint: _refinement(table) for joint, table in top.tables("joints").items()}
    cut = without_loops(urdf, top.content, refinements, file, faults)
    if cut is not None:
        for notice in cut.notices:
            faults.note(notice)
        urdf, top = cut.urdf, _Table(cut.content, top.where)
        name, _ = top.text("name"), top.text("tree")
        refinements = {joint: _refinement(table) for joint, table in top.tables("joints").items()}
    tree = tree_of(urdf, file, refinements, faults, request.packages, top.names("order"))
    if "gravity" in top:
        tree.model.gravity.linear = top.vector("gravity")
    if isinstance(top.get("frames", {}), list):
        top.fail("frames", "is not a list here; two names of frames belong in [[closures]] or in "
                           "[[springs]], and frames of the file's own are written [frames.NAME]")
    frames = {key: _frame(key, table) for key, table in top.tables("frames").items()}
    parts = {
        "tree": file,
        "dimensions": partial(dimensions, file, dict(request.parameters), request.trusted,
                              request.packages),  # read when they are asked for
        "title": top.text("title", ""),
        "source": top.text("source", ""),
        "closures": tuple(_closure(table) for table in top.array("closures")),
        "drivers": {key: Driver(key, t.closed_text("joint"))
                    for key, t in top.tables("drivers").items()},
        "springs": tuple(_spring(table) for table in top.array("springs")),
        "passives": tuple(_passive(key, t) for key, t in top.tables("passive").items()),
        "frames": frames,
        "guess": top.table("guess").values(),
    }
    top.close()
    add_frames(tree.model, frames, str(request.path))
    return _build(name, tree, parts, request, faults, "drivers" in top)


def _build(
    name: str, tree: Tree, parts: dict[str, Any], request: Request, faults: Faults,
    states_drivers: bool,
) -> Mechanism:
    where = str(request.path)
    mimics = tuple(
        Closure(f"mimic_{joint}", COUPLING, joints=(source, joint), ratio=ratio, offset=offset)
        for joint, source, ratio, offset in tree.mimics
    )
    parts["closures"] = (*parts.get("closures", ()), *mimics)
    if not states_drivers:
        joints = dict(zip(list(tree.model.names)[1:], tree.pairs, strict=True))
        parts["drivers"] = drivers_of_tree(joints, parts["closures"])
    mechanism = Mechanism(
        name=name, model=tree.model, visual_model=tree.shapes.visual,
        collision_model=tree.shapes.collision, pairs=tree.pairs, inertias=tree.inertias,
        parameters=dict(request.parameters), path=request.path, urdf=tree.urdf,
        slip_speeds=tree.slip_speeds, trusted=request.trusted, packages=request.packages,
        free_flyer=request.free_flyer,
        **parts,
    )
    mechanism.characteristic_length  # noqa: B018 - refused here where it is no number
    check_mechanism(mechanism, where)
    _check_guess(mechanism, where)
    _judge_inertias(mechanism, faults)
    return mechanism.with_fields(notices=faults.notices())


def _judge_inertias(mechanism: Mechanism, faults: Faults) -> None:
    found = impossible_inertias(mechanism)
    for kind, links in (
        ("below zero, which no body has: motion is computed, forces are refused", found.negative),
        ("no body has these moments of inertia, one is above the sum of the other two",
         found.lopsided),
    ):
        for link, words in links.items():
            faults.note(kind, f"link {link!r}: {words}")


def _check_guess(mechanism: Mechanism, where: str) -> None:
    for key in mechanism.guess:
        if key in BELONGS[TOP] and key not in (*mechanism.model.names, *mechanism.drivers):
            raise MechanismFileError(
                f"{where}: guess: {key} is no joint, coordinate or driver; it belongs {TOP}")
    check_guess(mechanism, where)


# ---------------------------------------------------------------- tables


def _refinement(table: _Table) -> JointRefinement:
    resistances = {key: table.numbers(key, least=0.0) for key in RESISTANCES if key in table}
    if np.any(resistances.get("slip_speed", 1.0) == 0.0):
        table.fail("slip_speed", "is 0; dry friction needs a speed at which it is nearly whole")
    limits = {key: table.bounds(key) for key in LIMITS if key in table}
    needs_type = not table.content or any(key in table for key in ("type", "axis", "axis2", "lead"))
    if not needs_type:
        table.close()
        return JointRefinement(resistances=resistances, limits=limits, where=table.where)
    kind = table.choice("type", JOINT_TYPES)
    pair = PAIRS[kind]
    refinement = JointRefinement(
        kind,
        axis=table.axis("axis") if pair.uses_axis and "axis" in table else None,
        axis2=table.axis("axis2") if pair.uses_axis2 and "axis2" in table else None,
        lead=table.number("lead") if pair.uses_lead else 0.0,
        resistances=resistances, limits=limits, where=table.where,
    )
    table.close()
    return refinement


def _closure(table: _Table) -> Closure:
    name = table.text("name")
    table.where += f" ({name!r})"
    kind, source = table.choice("type", CLOSURE_TYPES), table.text("source", "")
    if kind == COUPLING:
        closure = Closure(name, kind, source=source, joints=table.two_names("joints"),
                          ratio=table.number("ratio", 1.0), offset=table.number("offset", 0.0))
        if closure.ratio == 0.0:
            table.fail("ratio", "is zero; lock the joint instead")
    else:
        is_distance = PAIRS[kind].uses_length
        closure = Closure(name, kind, source=source, frames=table.two_names("frames"),
                          between=_between(table) if is_distance else (),
                          geometry=_geometry(table, PAIRS[kind]))
        if "equations" in table:
            closure = replace(closure, equations=table.places("equations", closure.n_rows))
    table.close()
    return closure


def _between(table: _Table) -> tuple[str, ...]:
    """The two frames whose distance is the length of a distance, if it has no other."""
    if BETWEEN not in table:
        return ()
    if "length" in table:
        table.fail("length", f"or {BETWEEN}: a distance has one of the two")
    return table.two_names(BETWEEN)


def _geometry(table: _Table, pair: Pair) -> PairGeometry:
    axis = table.axis("axis") if pair.uses_axis and "axis" in table else None
    axis2 = table.axis("axis2") if pair.uses_axis2 and "axis2" in table else None
    length = 0.0
    if pair.uses_length and BETWEEN not in table:
        length = table.number("length")
        if length <= 0.0:
            table.fail("length",
                       f"is {length} m; it must be positive (for 0 use type = \"spherical\")")
    lead = table.number("lead") if pair.uses_lead else 0.0
    return closure_geometry(pair, axis, axis2, length=length, lead=lead)


def _spring(table: _Table) -> Spring:
    name = table.text("name")
    if ("joint" in table) == ("frames" in table):
        table.fail("frames", "or joint: a spring needs exactly one of the two")
    about_joint = "joint" in table
    if about_joint and "free_length" in table and "free_angle" in table:
        table.fail("free_length", "or free_angle: a spring has one of the two")
    spring = Spring(
        name,
        frames=() if about_joint else table.two_names("frames"),
        joint=table.text("joint") if about_joint else None,
        stiffness=table.number("stiffness", 0.0, least=0.0),
        damping=table.number("damping", 0.0, least=0.0),
        free_length=table.number("free_length", 0.0, least=-math.inf if about_joint else 0.0),
        free_angle=table.number("free_angle", 0.0) if about_joint else 0.0,
    )
    table.close()
    return spring


def _passive(name: str, table: _Table) -> Passive:
    passive = Passive(name, table.text("body"), table.two_names("axis"))
    table.close()
    return passive


def _frame(name: str, table: _Table) -> Frame:
    link = table.text("link")
    given = {key: tuple(table.vector(key).tolist()) for key in ("xyz", "rpy") if key in table}
    table.close()
    return Frame(name, link, **given)


def _is_finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond float
        return False


def _said(value: Any) -> str:
    """Return a value of the file for a message."""
    try:
        text = repr(value)
    except ValueError:  # Python does not write numbers of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


class _Table:
    """A TOML table that is read key by key; every complaint names file, table and key."""

    def __init__(self, content: Any, where: str, place: str = TOP) -> None:
        if not isinstance(content, dict):
            key = where.rpartition(".")[2]
            hint = f"; {key} belongs {TOP}" if place != TOP and key in BELONGS[TOP] else ""
            raise MechanismFileError(f"{where}: must be a table of key = value lines{hint}")
        self.content, self.where, self.place = content, where, place
        self.known: list[str] = []

    def __contains__(self, key: str) -> bool:
        self.known.append(key)
        return key in self.content

    def fail(self, key: str, complaint: str) -> NoReturn:
        """Raise the error for one key."""
        raise MechanismFileError(f"{self.where}: {key} {complaint}")

    def get(self, key: str, default: Any = _REQUIRED) -> Any:
        self.known.append(key)
        if key not in self.content and default is _REQUIRED:
            unknown = [k for k in self.content if k not in self.known]
            near = [k for k in unknown if suggestion(k, [key]).startswith("did you mean")]
            hint = f" (there is an unknown key {near[0]!r})" if near else ""
            self.fail(key, f"is missing{hint}")
        return self.content.get(key, default)

    def text(self, key: str, default: Any = _REQUIRED) -> str:
        value = self.get(key, default)
        if not isinstance(value, str) or (default is _REQUIRED and not value):
            self.fail(key, f"must be text, not {_said(value)}")
        return value

    def choice(self, key: str, valid: tuple[str, ...]) -> str:
        value = self.text(key)
        if value not in valid:
            self.fail(key, f"is {_said(value)}; {suggestion(value, valid)}")
        return value

    def number(self, key: str, default: Any = _REQUIRED, least: float = -math.inf) -> float:
        value = self.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.fail(key, f"must be a number, not {_said(value)}")
        if not _is_finite(value) or value < least:
            self.fail(key, f"is {_said(value)}; it must be finite" +
                      (f" and at least {least:g}" if least > -math.inf else ""))
        return float(value)

    def numbers(self, key: str, least: float = -math.inf) -> Array:
        """One number, or a list of them."""
        value = self.get(key)
        if not isinstance(value, list):
            return np.array([self.number(key, least=least)])
        parts = [_Table({key: x}, self.where).number(key, least=least) for x in value]
        if not parts:
            self.fail(key, "is an empty list")
        return np.array(parts)

    def bounds(self, key: str) -> Array:
        """One number, or a list of them; inf and -inf are none."""
        value = self.get(key)
        values = value if isinstance(value, list) else [value]
        for x in values:
            is_number = isinstance(x, int | float) and not isinstance(x, bool)
            if not is_number or not (_is_finite(x) or x in (math.inf, -math.inf)):
                self.fail(key, f"must be a number, or a list of them, not {_said(value)}")
        if not values:
            self.fail(key, "is an empty list")
        return np.array(values, dtype=float)

    def names(self, key: str) -> tuple[str, ...]:
        """A list of names, of any length; none where there is no such key."""
        value = self.get(key, [])
        if not (isinstance(value, list) and all(isinstance(x, str) for x in value)):
            self.fail(key, f"must be a list of names, not {_said(value)}")
        return tuple(value)

    def vector(self, key: str) -> Array:
        value = self.get(key)
        numbers = isinstance(value, list) and len(value) == 3 and all(
            isinstance(x, int | float) and not isinstance(x, bool) and _is_finite(x)
            for x in value
        )
        if not numbers:
            self.fail(key, f"must be three finite numbers, not {_said(value)}")
        return np.array(value, dtype=float)

    def axis(self, key: str) -> Array:
        """A direction; written with a few digits it is normalised, else refused."""
        value = self.vector(key)
        norm = math.hypot(*value)  # of numbers of any size
        if abs(norm - 1.0) > 1e-3:
            self.fail(key, f"has length {norm:.6g}; an axis is a unit vector")
        return unit(value)

    def two_names(self, key: str) -> tuple[str, str]:
        value = self.get(key)
        if not (isinstance(value, list) and len(value) == 2
                and all(isinstance(x, str) for x in value)):
            self.fail(key, f"must be a list of two names, not {_said(value)}")
        return value[0], value[1]

    def places(self, key: str, count: int) -> tuple[int, ...]:
        """Some of the numbers 0 to count - 1, ascending."""
        value = self.get(key)
        valid = isinstance(value, list) and value and all(
            isinstance(x, int) and not isinstance(x, bool) and 0 <= x < count for x in value)
        if not valid or sorted(set(value)) != value:
            self.fail(key, f"must be a list of some of the numbers 0 to {count - 1}, ascending, "
                           f"not {_said(value)}")
        return tuple(value)

    def closed_text(self, key: str) -> str:
        """The one key of a table that has no other."""
        value = self.text(key)
        self.close()
        return value

    def table(self, key: str) -> _Table:
        return _Table(self.get(key, {}), f"{self.where}: {key}")

    def tables(self, key: str) -> dict[str, _Table]:
        inner = self.table(key)
        place = f"in [{key}.NAME]"
        return {k: _Table(v, f"{inner.where}.{k}", place) for k, v in inner.content.items()}

    def array(self, key: str) -> list[_Table]:
        value = self.get(key, [])
        if not isinstance(value, list):
            self.fail(key, f"must be written as [[{key}]]")
        place = f"in [[{key}]]"
        return [_Table(v, f"{self.where}: {key}[{i}]", place) for i, v in enumerate(value)]

    def values(self) -> dict[str, Any]:
        return dict(self.content)

    def close(self) -> None:
        """Refuse keys that nothing has asked for."""
        for key in self.content:
            if key not in self.known:
                self.fail(_said(key)[1:-1], self.misplaced(key))

    def misplaced(self, key: str) -> str:
        """Return why a key is none of this table, and where it belongs."""
        places = [place for place, keys in BELONGS.items() if key in keys]
        if self.place in places:
            kind = self.content.get("type")
            return (f"is not a key of this table of type {_said(kind)}; "
                    f"{suggestion(key, self.known)}")
        if self.place == "in [[closures]]" and key in SPRING:
            return ("is not a key of this table: closures carry neither springs nor dampers; write "
                    "[[springs]] with name, frames (the same two) and stiffness or damping")
        if places:
            return f"is not a key of this table; it belongs {' or '.join(places)}"
        return f"is not a key of this table; {suggestion(key, self.known)}"
