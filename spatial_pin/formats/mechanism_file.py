"""The tables of a mechanism file, and an open tree, as a Mechanism."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import numbers_or_none
from spatial_pin.errors import MechanismFileError, Mistakes, suggestion
from spatial_pin.formats.checked_tables import BELONGS, BETWEEN, TOP, TomlTable, key_hint
from spatial_pin.formats.file_access import Trust, read_text
from spatial_pin.formats.graph.open_tree import without_loops
from spatial_pin.formats.importers import Faults, Request
from spatial_pin.formats.urdf.elements import inertial
from spatial_pin.formats.urdf.urdf_model import (
    LIMITS,
    NUMBERS,
    JointRefinement,
    tree_of,
)
from spatial_pin.formats.xacro.xacro_arguments import dimensions, with_numbers, worked_out
from spatial_pin.mechanism.coordinates import check_guess
from spatial_pin.mechanism.curves import CurveShape, curve_of
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.mechanism_checks import check_mechanism, impossible_inertias, sided
from spatial_pin.mechanism.pairs import (
    JOINT_TYPES,
    PAIRS,
    Pair,
    closure_geometry,
    closure_types,
    hint_at_type,
)
from spatial_pin.mechanism.parts import (
    Closure,
    Driver,
    Frame,
    Passive,
    Spring,
    add_frames,
    drivers_of_tree,
)
from spatial_pin.numerics.linalg import Array

SYMMETRY = 1e-9  # of the largest moment of inertia: what rounded matrices differ by
BUSHING = ("stiffness", "damping", "preload")  # keys of six numbers, or of 6 x 6


class MechanismSpec:
    """The content of a mechanism file, read key by key; mistakes are collected.

    Attributes:
        curves: by name; closures are read with them, and with the `rows` of files.
        refinements: of the tree's joints.
        parts: of the mechanism: closures, drivers, springs and so on that could be read.
        is_whole: by key, whether all under it could be read.
    """

    def __init__(self, top: TomlTable, mistakes: Mistakes, trust: Trust) -> None:
        self._mistakes, self._trust = mistakes, trust
        self.is_whole: dict[str, bool] = {}
        for key in ("name", "tree"):
            with mistakes.each():
                top.text(key)
        self.refinements: dict[str, JointRefinement] = self._tables(
            top, "joints", lambda _, table: _refinement(table))
        self.gravity = self._value(top, "gravity", top.vector, None)
        self.parts: dict[str, Any] = {"frames": self._frames(top)}
        self.curves: dict[str, CurveShape] = self._tables(top, "curves", partial(_curve, self))
        self.parts |= {
            "closures": self._array(top, "closures", partial(_closure, self)),
            "drivers": self._tables(top, "drivers",
                                    lambda key, table: Driver(key, table.text("joint"))),
            "springs": self._array(top, "springs", partial(_spring, self)),
            "passives": tuple(self._tables(
                top, "passive", lambda key, table: Passive(
                    key, table.text("body"), table.two_names("axis"))).values()),
        }
        self.masses: dict[str, pin.Inertia] = self._tables(top, "masses", _mass)
        optional = partial(top.text, default="")
        self.parts |= {
            "title": self._value(top, "title", optional, ""),
            "source": self._value(top, "source", optional, ""),
            "gap": self._value(top, "gap", partial(top.number, least=0.0), None),
            "guess": self._value(top, "guess", lambda key: dict(top.table(key).content), {})}
        self.order: tuple[str, ...] = self._value(top, "order", top.names, ())
        top.note_unknown_keys(mistakes)

    def _value(self, top: TomlTable, key: str, read: Callable[[str], Any], default: Any) -> Any:
        """Return the value of a key; the default where there is none, or a mistake."""
        with self._mistakes.each():
            return read(key) if key in top else default
        return default

    def rows(self, name: str) -> list[list[float | None]]:
        """Return the numbers of a table's file, row by row, without its heading; None for text."""
        text = read_text(self._trust.checked(self._trust.home / name))
        rows = [line.replace(";", ",").split(",") for line in text.splitlines()
                if line.strip() and not line.lstrip().startswith("#")]
        values = [[_as_number(x) for x in row] for row in rows]
        return values[1:] if values and None in values[0] else values

    def _frames(self, top: TomlTable) -> dict[str, Frame]:
        with self._mistakes.each():
            if not isinstance(top.get("frames", {}), list):
                return self._tables(top, "frames", _frame)
            top.fail("frames", "is not a list here; two names of frames belong in [[closures]] or "
                               "in [[springs]], and frames of the file's own are written "
                               "[frames.NAME]")
        self.is_whole["frames"] = False
        return {}

    def _tables(
        self, top: TomlTable, key: str, read: Callable[[str, TomlTable], Any]
    ) -> dict[str, Any]:
        """Return the content of the readable tables `[KEY.NAME]`, by name."""
        tables: dict[str, Any] = {}
        before, names = len(self._mistakes), list[str]()
        with self._mistakes.each():
            names = list(top.table(key).content)
        for name in names:
            with self._mistakes.each():
                table = top.one_of(key, name)
                for one in self._read(table, partial(read, name)):
                    tables[name] = one
        self.is_whole[key] = len(self._mistakes) == before
        return tables

    def _read(self, table: TomlTable, read: Callable[[TomlTable], Any]) -> list[Any]:
        """Return [content] of a table, also with stand-ins for wrong numbers; else []."""
        again: TomlTable | None = table
        while again is not None:
            table = again
            with self._mistakes.each():
                entry = read(table)
                table.close()
                return [entry] if table.has_own_names else []
            again = table.with_replacements()
        table.note_unknown_keys(self._mistakes)
        return []

    def _array(self, top: TomlTable, key: str, read: Callable[[TomlTable], Any]) -> tuple[Any, ...]:
        """Return the content of the readable tables `[[KEY]]`."""
        entries: list[Any] = []
        before, tables = len(self._mistakes), 0
        with self._mistakes.each():
            tables = top.count(key)
        for k in range(tables):
            with self._mistakes.each():
                entries += self._read(top.item_of(key, k), read)
        self.is_whole[key] = len(self._mistakes) == before
        return tuple(entries)


def put_masses(robot: ET.Element, masses: Mapping[str, pin.Inertia], where: str) -> None:
    """Give the links of a URDF the masses that a mechanism file states."""
    links = {link.get("name", ""): link for link in robot.findall("link")}
    for name, mass in masses.items():
        if name not in links:
            raise MechanismFileError(f"{where}: masses.{name}: the tree has no such link; "
                                     f"{suggestion(name, links)}")
        for own in links[name].findall("inertial"):
            links[name].remove(own)
        links[name].append(inertial(mass))


def mechanism_of(
    top: TomlTable, file: Path, robot: ET.Element, request: Request, faults: Faults
) -> Mechanism:
    """Return the mechanism of the expanded URDF of `file` and the table of the mechanism file."""
    mistakes, written = Mistakes(top.where), top.content
    of_tree = replace(request, path=file, parameters=dict(request.parameters))
    trust = of_tree.trust
    with mistakes.each():
        top = TomlTable(with_numbers(written, request.path, of_tree), top.where)
    spec = MechanismSpec(top, mistakes, trust)
    if not spec.is_whole["joints"]:
        mistakes.raise_all()  # what the tree is, is not known
    with mistakes.each():
        put_masses(robot, spec.masses, top.where)
        cut = without_loops(robot, top.content, spec.refinements, file, faults)
        if cut is not None:
            mistakes.raise_all()
            for notice in cut.notices:
                faults.note(notice)
            robot, top = cut.robot(file), TomlTable(cut.content, top.where)
            spec = MechanismSpec(top, mistakes, trust)
        tree, mimics = tree_of(robot, file, spec.refinements, faults, trust, spec.order, top.where)
        if spec.gravity is not None:
            tree["model"].gravity.linear = spec.gravity
        spec.parts["closures"] += mimics
        spec.parts["content"] = written
        return _build(top, tree, spec, request, of_tree, faults, mistakes)
    mistakes.raise_all()
    raise AssertionError  # a mistake was kept


def _build(
    top: TomlTable, tree: dict[str, Any], spec: MechanismSpec, request: Request, of_tree: Request,
    faults: Faults, mistakes: Mistakes,
) -> Mechanism:
    where, parts = str(request.path), spec.parts
    if spec.is_whole["frames"]:
        add_frames(tree["model"], parts["frames"], where)
    if "drivers" not in top:
        joints = dict(zip(list(tree["model"].names)[1:], tree["pairs"], strict=True))
        parts["drivers"] = drivers_of_tree(joints, parts["closures"])
    parts["dimensions"] = partial(dimensions, of_tree)  # read at first use
    guess = parts.pop("guess")
    with mistakes.each():
        parts["guess"] = worked_out(guess, request.path, "guess", of_tree)
    mechanism = Mechanism(
        name=top.content.get("name", ""), tree=of_tree.path, path=request.path,
        parameters=of_tree.parameters, trusted=request.trusted, packages=request.packages,
        free_flyer=request.free_flyer, model_of_file=request.model, without=request.without,
        **tree, **parts,
    )
    mechanism.characteristic_length  # noqa: B018 - refused here where it is no number
    if spec.is_whole["frames"]:  # else names of those are missing
        check_mechanism(mechanism, where, mistakes)
        if spec.is_whole["drivers"]:
            _check_guess(mechanism, where, mistakes)
    mistakes.raise_all()
    negative, lopsided = impossible_inertias(mechanism)
    for kind, links in (
        ("below zero, which no body has: motion is computed, forces are refused", negative),
        ("no body has these moments of inertia, one is above the sum of the other two",
         lopsided),
    ):
        for link, words in links.items():
            faults.note(kind, f"link {link!r}: {words}")
    return sided(mechanism).with_fields(notices=faults.notices())


def _check_guess(mechanism: Mechanism, where: str, mistakes: Mistakes) -> None:
    lost = {d.name for d in mechanism.drivers.values()  # already an error of the driver
            if d.joint not in (*mechanism.coordinate_table, *mechanism.model.names)}
    for key, value in mechanism.guess.items():
        if key in lost:
            continue
        with mistakes.each():
            if key in BELONGS[TOP] and key not in (*mechanism.model.names, *mechanism.drivers):
                raise MechanismFileError(f"{where}: guess: {key} is no joint, coordinate or "
                                         f"driver; {key_hint(key, value)}")
            check_guess(mechanism, where, {key: value})


def _refinement(table: TomlTable) -> JointRefinement:
    numbers = {key: table.bounds(key) if key in LIMITS else table.numbers(key, least=0.0)
               for key in NUMBERS if key in table}
    if np.any(numbers.get("slip_speed", 1.0) == 0.0):
        table.fail("slip_speed", "is 0; dry friction needs a speed at which it is nearly whole")
    needs_type = not table.content or any(key in table for key in ("type", "axis", "axis2", "lead"))
    if not needs_type:
        return JointRefinement(numbers=numbers, where=table.where)
    kind = table.choice("type", JOINT_TYPES, hint_at_type)
    return JointRefinement(kind, *_axes(table, PAIRS[kind]), numbers, table.where)


def _axes(table: TomlTable, pair: Pair) -> tuple[Array | None, Array | None, float]:
    """Return the axes (3,) of a pair, None for the default, and the lead of a screw."""
    axis = table.axis("axis") if pair.uses_axis and "axis" in table else None
    axis2 = table.axis("axis2") if pair.uses_axis2 and "axis2" in table else None
    lead = table.number("lead") if pair.uses_lead else 0.0
    if pair.uses_lead and lead == 0.0:
        table.fail("lead", 'is 0; a screw advances as it turns (one that does not is of type = '
                   '"revolute")')
    return axis, axis2, lead


def _curve(spec: MechanismSpec, name: str, table: TomlTable) -> CurveShape:
    table.known += table.content
    try:
        return curve_of(name, table.content, spec.rows)
    except ValueError as error:
        raise MechanismFileError(f"{table.where}: {error}") from error


def _closure(spec: MechanismSpec, table: TomlTable) -> Closure:
    name = table.text("name")
    table.where += f" ({name!r})"
    kind = table.choice("type", closure_types(), hint_at_type)
    pair, parts = PAIRS[kind], dict[str, Any](source=table.text("source", ""))
    if pair.n_frames:
        more = pair.has_more
        parts["frames"] = table.some_names("frames", pair.n_frames, more)
    if pair.n_joints:
        more = pair.has_more and not pair.n_frames
        parts["joints"] = table.some_names("joints", pair.n_joints, more)
    numbers, (axis, axis2, lead) = _numbers(table, pair, spec), _axes(table, pair)
    length = table.number("length") if pair.uses_length and BETWEEN not in table else 0.0
    if pair.uses_length and BETWEEN in table:
        if "length" in table:
            table.fail("length", f"or {BETWEEN}: a distance has one of the two")
        parts["between"] = table.two_names(BETWEEN)
    elif pair.uses_length and length <= 0.0:
        table.fail("length",
                   f"is {length} m; it must be positive (for 0 use type = \"spherical\")")
    closure = Closure(name, kind, numbers=numbers, **parts, geometry=closure_geometry(
        pair, axis, axis2, length=length, lead=lead))
    fault = pair.fault(closure)
    if fault:
        table.fail(*fault)
    if pair.n_frames and "equations" in table:
        closure = replace(closure, equations=table.indices("equations", closure.n_rows))
    return closure


def _numbers(table: TomlTable, pair: Pair, spec: MechanismSpec) -> dict[str, Any]:
    """Return the numbers of a closure, lists of numbers (n,) and functions, by their keys."""
    numbers: dict[str, Any] = {}
    taken: dict[str, str] = {}  # keys that another one is in the place of
    for key in pair.keys:
        if key.name in taken:
            if key.name in table:
                table.fail(key.name, f"or {taken[key.name]}: a {table.get('type')} has one of the "
                                     "two")
            continue
        if (key.instead_of or key.is_optional) and key.name not in table:
            continue
        taken.update(dict.fromkeys(key.instead_of, key.name))
        if key.read is not None:
            try:
                numbers[key.name] = key.read(table.get(key.name), spec)
            except ValueError as error:
                table.end(key.name, str(error))
        elif key.is_list:
            numbers[key.name] = table.numbers(key.name)
        else:
            value = (table.number(key.name) if key.default is None
                     else table.number(key.name, key.default))
            if value == 0.0 and key.no_zero:
                table.fail(key.name, f"is zero; {key.no_zero}")
            numbers[key.name] = value
    return numbers


def _as_number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _spring(spec: MechanismSpec, table: TomlTable) -> Spring:
    """Return a spring; what its numbers must be is checked by `Spring`."""
    name = table.text("name")
    if ("joint" in table) == ("frames" in table):
        table.end("frames", "or joint: a spring needs exactly one of the two")
    about_joint = "joint" in table
    if about_joint and "free_length" in table and "free_angle" in table:
        table.fail("free_length", "or free_angle: a spring has one of the two")
    if any(isinstance(table.content.get(key), list) for key in BUSHING):
        if about_joint:
            table.fail("joint", "is not for a bushing, which joins two frames: give frames")
        parts = {key: table.get(key) for key in BUSHING if key in table}
    else:
        parts = {
            "law": _law(table, spec), **{key: table.number(key, 0.0, least=0.0)
                                         for key in ("stiffness", "damping")},
            **{key: table.flag(key) for key in ("tension_only", "compression_only")},
            "free_length": table.number(
                "free_length", 0.0, least=-math.inf if about_joint else 0.0),
            "free_angle": table.number("free_angle", 0.0) if about_joint else 0.0}
    ends = {"joint": table.text("joint")} if about_joint else {"frames": table.two_names("frames")}
    try:
        return Spring(name, **ends, **parts)
    except ValueError as error:
        raise MechanismFileError(f"{table.where}: {error}") from error


def _law(table: TomlTable, spec: MechanismSpec) -> Any:
    """Return the points of a spring's characteristic: written out, or of a file of two columns."""
    given = table.get("law", None)
    if given is None:
        return ()
    if not isinstance(given, dict) or ("points" in given) == ("table" in given):
        table.fail("law", 'is {points = [[0.0, 0.0], [0.01, 40.0]]} or {table = "gas.csv"}')
    inner = table.table("law")
    points = spec.rows(inner.text("table")) if "table" in inner else inner.get("points")
    inner.close()
    return points


def _mass(name: str, table: TomlTable) -> pin.Inertia:
    mass, given = table.number("mass", least=0.0), table.get("inertia", 0.0)
    com = table.vector("com") if "com" in table else np.zeros(3)
    array = numbers_or_none(given)
    if array.shape not in ((), (3,), (3, 3)) or not np.isfinite(array).all():
        table.fail("inertia", "is one number, three, or three lists of three [kg·m²]")
    matrix = array if array.ndim == 2 else np.diag(np.broadcast_to(array, 3))
    if np.abs(matrix - matrix.T).max() > SYMMETRY * np.abs(matrix).max():
        table.fail("inertia", "is not symmetric")
    return inertia_as_given(mass, com, 0.5 * (matrix + matrix.T))


def _frame(name: str, table: TomlTable) -> Frame:
    link = table.text("link")
    given = {key: tuple(table.vector(key).tolist()) for key in ("xyz", "rpy") if key in table}
    return Frame(name, link, **given)
