"""The tables of a drawing in a mechanism file: bodies, and joints at places of the world.

Instead of `tree` such a file has `[bodies.NAME]` and `[joints.NAME]` with `between` and `at`. All
numbers are those of the drawn pose, in the axes of the world. A number may be an expression of
`[dimensions]`, such as "${b * cos(phi)}", which `drawn_tree` hands on to a xacro file.
"""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.errors import MechanismFileError, Mistakes, suggestion
from spatial_pin.formats.checked_tables import TomlTable
from spatial_pin.formats.urdf.urdf_model import NUMBERS
from spatial_pin.formats.xacro.expressions import GLOBALS, Budget, evaluate
from spatial_pin.mechanism.pairs import JOINT_TYPES, PAIRS, hint_at_type, unit
from spatial_pin.numerics.linalg import Array

GROUND = "ground"  # the body that stands still
BAR_RADIUS = "bar_radius"  # a property of the xacro text
# What no dimension can be called: arguments of `load` and of `Drawing.mechanism`, and what the text
# of a drawing calls. Others of xacro's functions, such as e or gamma, give way to a dimension.
RESERVED = ("source", "trusted", "free_flyer", "packages", "gap", "model", "without", "keep",
            "density", BAR_RADIUS, "sqrt", "sin", "cos", "tan", "atan2", "hypot", "pi", "math",
            "python", "range", "xacro")
ROUNDED = 1e-6  # cosine, and part of an inertia, that numbers of a drawing are rounded to
Number = float | str  # a constant, or an expression of dimensions
Vector = Sequence[Number]


class DrawnJoint(NamedTuple):
    """A joint at a place of the world.

    Attributes:
        type: a pair.
        between: its two bodies.
        at: (3,) its place [m].
        axis, axis2: (3,) directions; unit vectors where they are constant.
        more: lead, limits and resistances, as in a mechanism file.
    """

    type: str
    between: tuple[str, str]
    at: Vector
    axis: Vector
    axis2: Vector
    more: dict[str, Any]


def is_varied(vector: Sequence[Number]) -> bool:
    """Whether a number depends on dimensions."""
    return any(isinstance(x, str) for x in vector)


def is_dimension_name(name: str) -> bool:
    """Whether a dimension can be called so: no function of drawings, no argument of `load`."""
    return name.isidentifier() and name.isascii() and not keyword.iskeyword(name) and (
        name not in RESERVED and not name.startswith("_"))


class DrawnNumbers:
    """The numbers of a drawing; some are expressions of its dimensions [m, rad]."""

    def __init__(self) -> None:
        self.dimensions: dict[str, float] = {}
        self._budget = Budget()

    @property
    def symbols(self) -> dict[str, float]:
        """The dimensions by their names in expressions: not those of xacro's own symbols."""
        return {f"dimension_{name}" if name in GLOBALS else name: x
                for name, x in self.dimensions.items()}

    def _value(self, text: str) -> Any:
        return evaluate(text, {**GLOBALS, **self.symbols, **self.dimensions}, self._budget)

    def values(self, vector: Sequence[Number]) -> Array:
        """Return numbers as they are drawn."""
        return np.array([self._value(x) if isinstance(x, str) else x for x in vector], dtype=float)

    def number(self, table: TomlTable, key: str, above: float = -math.inf) -> Number:
        """Return the number of a key."""
        return self.checked(table, key, table.get(key), above)

    def checked(self, table: TomlTable, key: str, value: Any, above: float = -math.inf) -> Number:
        """Return a finite number, or an expression whose value is one."""
        text = re.fullmatch(r"\s*\$\{([^{}$]*)\}\s*", value) if isinstance(value, str) else None
        number = value
        if text is not None:
            try:
                number = self._value(text[1])
            except Exception as error:  # of xacro's, or as Python's operators raise it
                table.fail(key, f"is {value!r}: {error} (dimensions are: "
                                f"{', '.join(self.dimensions) or 'none'})")
        if isinstance(number, bool) or not isinstance(number, int | float):
            table.fail(key, f"has {str(value)[:60]!r}; a number is needed, or an expression of "
                            'dimensions such as "${2 * b}"')
        if not math.isfinite(number) or not number > above:
            least = f" above {above:g}" if above > -math.inf else ""
            table.fail(key, f"has {number}; a finite number{least} is needed")
        if text is None or not set(re.findall(r"\w+", text[1])) & self.dimensions.keys():
            return float(number)
        expression = text[1].strip()
        for name in GLOBALS.keys() & self.dimensions.keys():
            expression = re.sub(rf"(?<![.\w]){name}\b", f"dimension_{name}", expression)
        return expression

    def vector(self, table: TomlTable, key: str) -> Vector:
        """Return three numbers."""
        value = table.get(key)
        if not isinstance(value, list) or len(value) != 3:
            table.fail(key, f"must be a list of three numbers, not {str(value)[:60]}")
        return [self.checked(table, key, x) for x in value]

    def axis(self, table: TomlTable, key: str, default: Sequence[float]) -> Vector:
        """Return a direction of any length, a unit vector if it is constant."""
        axis = self.vector(table, key) if key in table else default
        numbers = self.values(axis)
        if not np.any(numbers):
            table.fail(key, "is zero; a direction is needed")
        return axis if is_varied(axis) else [float(x) for x in unit(numbers)]

    def inertia(self, table: TomlTable, key: str) -> Sequence[Vector]:
        """Return the matrix (3, 3) that one number, three, or three lists of three are."""
        given = table.get(key)
        rows = given if isinstance(given, list) else [given] * 3
        if len(rows) == 3 and all(isinstance(row, list) and len(row) == 3 for row in rows):
            matrix = [[self.checked(table, key, x) for x in row] for row in rows]
            numbers = np.array([self.values(row) for row in matrix])
            if np.abs(numbers - numbers.T).max() > ROUNDED * np.abs(numbers).max():
                table.fail(key, "is not symmetric")
            return matrix
        if len(rows) != 3:
            table.fail(key, "is one number, three, or three lists of three [kg·m²]")
        return [[self.checked(table, key, x) if i == j else 0.0 for j in range(3)]
                for i, x in enumerate(rows)]


class DrawnFile:
    """The tables of a drawing, sorted by name, read key by key; mistakes are collected."""

    def __init__(self, top: TomlTable) -> None:
        self.top, self.mistakes, self.numbers = top, Mistakes(top.where), DrawnNumbers()
        with self.mistakes.each():
            if "tree" in top:
                top.fail("tree", "or bodies: the tree is read from a file, or it is drawn")
        with self.mistakes.each():
            table = top.table("dimensions")
            for name in table.content:
                with self.mistakes.each():
                    if not is_dimension_name(name):
                        table.fail(name, "cannot be a dimension's name: letters, digits and _ make "
                                         "one that is no function and no argument of load")
                    self.numbers.dimensions[name] = table.number(name)
        self.bodies: dict[str, dict[str, Any]] = self._tables("bodies", self._body)
        self.joints: dict[str, DrawnJoint] = self._tables("joints", self._joint)
        self.points: dict[str, tuple[str, Vector]] = self._tables("points", lambda table: (
            self._known_body(table, "body", table.text("body")), self.numbers.vector(table, "at")))
        self.rods: dict[str, tuple[str, str]] = self._tables("rods", self._rod)
        self.gears: dict[str, dict[str, Any]] = self._tables(
            "gears", lambda table: read_gear(self, table))
        self.keep: tuple[str, ...] = ()
        self.density: Number | None = None
        self.radius: Number | None = None
        with self.mistakes.each():
            self.keep = top.names("keep")
            for name in self.keep:
                if name not in self.joints:
                    top.fail("keep", f"has {name!r}, which is no joint of the drawing; "
                                     f"{suggestion(name, self.joints)}")
        for key in ("density", "radius"):
            with self.mistakes.each():
                if key in top:
                    setattr(self, key, self.numbers.number(top, key, above=0.0))
        with self.mistakes.each():
            if not top.content["bodies"] or not any(top.get(key, 0) for key in ("joints", "rods")):
                raise MechanismFileError(f"{top.where}: a drawing needs a body, and a joint or a "
                                         f"rod between it and {GROUND!r}")
        for several in ((GROUND, *self.bodies, *self.points),
                        (*self.joints, *self.rods, *self.gears)):
            self._check_names(several)

    def _check_names(self, names: Collection[str]) -> None:
        """Refuse names that cannot be, and those that two things have."""
        for name in dict.fromkeys(names):
            with self.mistakes.each():
                if not name or not name.isprintable() or "$" in name:
                    raise MechanismFileError(f"{self.top.where}: {name!r} is no name in a drawing: "
                                             "it is empty, or has $ or what cannot be read")
                if list(names).count(name) > 1:
                    raise MechanismFileError(f"{self.top.where}: two things have the name {name!r}")

    def _tables(self, key: str, read: Callable[[TomlTable], Any]) -> dict[str, Any]:
        tables: dict[str, Any] = {}
        with self.mistakes.each():
            for name in sorted(self.top.table(key).content):
                with self.mistakes.each():
                    table = self.top.one_of(key, name)
                    tables[name] = read(table)
                    table.close()
        return tables

    def _known_body(self, table: TomlTable, key: str, name: str) -> str:
        known = (GROUND, *self.top.table("bodies").content)
        if name not in known:
            table.fail(key, f"has {name!r}, which is no body of the drawing; "
                            f"{suggestion(name, known)}")
        return name

    def _body(self, table: TomlTable) -> dict[str, Any]:
        """Return mass [kg], com (3,) [m], inertia (3, 3), density [kg/m³]; None without them."""
        numbers, above = self.numbers, partial(self.numbers.number, above=0.0)
        readers: dict[str, Callable[[TomlTable, str], Any]] = {
            "mass": numbers.number, "density": above, "com": numbers.vector,
            "inertia": numbers.inertia}
        body = {key: read(table, key) if key in table else None for key, read in readers.items()}
        mass = body["mass"]
        if mass is None and (body["com"] is not None or body["inertia"] is not None):
            table.fail("mass", "is missing: com and inertia are those of a mass")
        if mass is not None and body["density"] is not None:
            table.fail("density", "or mass: a body has one of the two")
        if mass is not None and numbers.values([mass])[0] < 0.0:
            table.fail("mass", "is below zero, which no body has")
        return body

    def _joint(self, table: TomlTable) -> DrawnJoint:
        kind, numbers = table.choice("type", JOINT_TYPES, hint_at_type), self.numbers
        pair = PAIRS[kind]
        one, two = (self._known_body(table, "between", x) for x in table.two_names("between"))
        if one == two:
            table.fail("between", f"has {one!r} twice: a joint joins two bodies")
        anywhere = kind in ("floating", "fixed") and "at" not in table
        at: Vector = [0.0] * 3 if anywhere else numbers.vector(table, "at")
        axis: Vector = [0.0, 0.0, 1.0]
        axis2: Vector = [0.0, 1.0, 0.0]
        if pair.uses_axis:
            axis = numbers.axis(table, "axis", pair.axis)
        if pair.uses_axis2:
            axis2 = numbers.axis(table, "axis2", (0.0, 1.0, 0.0))
            if abs(unit(numbers.values(axis)) @ unit(numbers.values(axis2))) > ROUNDED:
                table.fail("axis2", "is not perpendicular to axis, as the pins of a universal "
                                    "joint are")
        more = {key: table.get(key) for key in NUMBERS if key in table}
        if pair.uses_lead:
            more["lead"] = table.get("lead")
        return DrawnJoint(kind, (one, two), at, axis, axis2, more)

    def _rod(self, table: TomlTable) -> tuple[str, str]:
        ends = table.two_names("between")
        for name in ends:
            if name not in self.points:
                table.fail("between", f"has {name!r}, which is no point of the drawing; "
                                      f"{suggestion(name, self.points)}")
        (body, one), (other, two) = (self.points[name] for name in ends)
        if body == other:
            table.fail("between", f"has two points of {body!r}: a rod joins two bodies")
        if not np.any(self.numbers.values(one) - self.numbers.values(two)):
            table.fail("between", "has two points at the same place: a rod has a length; for none "
                                  'use a joint of type = "spherical"')
        return ends


def read_gear(file: DrawnFile, table: TomlTable) -> dict[str, Any]:
    """Return the coupling of two hinges that gears turn on, and of those of their carrier."""
    ends, joints = table.two_names("joints"), file.joints
    hinges = [name for name, joint in joints.items() if joint.type == "revolute"]
    for name in ends:
        if name not in hinges:
            table.fail("joints", f"has {name!r}, which is no hinge of the drawing; "
                                 f"{suggestion(name, hinges)}")
    teeth = table.get("teeth")
    if not isinstance(teeth, list) or len(teeth) != 2:
        table.fail("teeth", "must be a list of two numbers")
    counts = [file.numbers.checked(table, "teeth", x, above=0.0) for x in teeth]
    other = -1.0 if table.flag("internal") else 1.0
    for first, second, (one, two) in ((*ends, counts), (*ends[::-1], counts[::-1])):
        for carrier, sign in zip(joints[second].between, (1.0, -1.0), strict=True):
            turns = _turns(file, carrier, first, second)
            if not turns or _same_line(file, first, second):
                continue
            last = other * sign * _sense(file, table, first, second)
            names = [*(name for name, _ in turns), second]
            if len(turns) == 1:
                return {"type": "coupling", "joints": names,
                        "ratio": _product(-turns[0][1] * last, one, two)}
            return {"type": "coupling", "joints": names, "ratios": [
                *(_product(turn, one) for _, turn in turns), _product(last, two)]}
    table.fail("joints", f"{ends[0]!r} and {ends[1]!r} must have one body in common, which "
                         "carries both gears, or one that turns about the axis of the other gear")


def _cosine(file: DrawnFile, one: str, two: str) -> float:
    """Return the cosine between the axes of two joints."""
    x, y = (unit(file.numbers.values(file.joints[name].axis)) for name in (one, two))
    return float(x @ y)


def _sense(file: DrawnFile, table: TomlTable, one: str, two: str) -> float:
    """Return 1 if gears turn against each other about the axes of their hinges, as stated; else -1.

    Their cones roll on each other, seen from where the axes meet, from which each lies ahead or
    behind along its axis; of parallel axes this is far away. Where axes pass each other, as of a
    worm, it is 1.
    """
    values, joints = file.numbers.values, file.joints
    a, b = (unit(values(joints[name].axis)) for name in (one, two))
    apart, across = values(joints[two].at) - values(joints[one].at), np.cross(a, b)
    if abs(_cosine(file, one, two)) > 1.0 - ROUNDED:
        return math.copysign(1.0, float(a @ b))
    distance, square = float(np.linalg.norm(apart)), float(across @ across)
    if abs(float(apart @ across)) > ROUNDED * distance * math.sqrt(square):
        return 1.0
    behind = {name: float(np.cross(apart, axis) @ across) / square
              for name, axis in ((one, b), (two, a))}
    for name, x in behind.items():
        if abs(x) <= ROUNDED * distance:
            table.fail("joints", f"has {name!r} where the axes of the gears meet, which does not "
                                 "tell on which side its gear is: place the hinge at its gear")
    return math.copysign(1.0, behind[one] * behind[two])


def _same_line(file: DrawnFile, one: str, two: str) -> bool:
    """Whether two hinges turn about one line."""
    values, joints = file.numbers.values, file.joints
    axis, apart = unit(values(joints[one].axis)), values(joints[two].at) - values(joints[one].at)
    return abs(_cosine(file, one, two)) > 1.0 - ROUNDED and float(np.linalg.norm(
        np.cross(axis, apart))) <= ROUNDED * float(np.linalg.norm(apart))


def _turns(file: DrawnFile, carrier: str, axle: str, without: str) -> list[tuple[str, float]]:
    """Return the hinges whose turns add up to that of the gear on an axle to its carrier.

    They are about one line, the axle the last, each with the sign of its turn about the axle's
    axis.
    """
    waiting: list[tuple[str, list[tuple[str, float]]]] = [(carrier, [])]
    for body, turns in waiting:  # it grows: the shortest way is the first
        for name, joint in file.joints.items():
            if name == without or body not in joint.between or joint.type != "revolute" or (
                    name in dict(turns) or not _same_line(file, axle, name)):
                continue
            is_first = joint.between[0] == body
            sign = math.copysign(1.0, _cosine(file, axle, name)) * (1.0 if is_first else -1.0)
            path = [*turns, (name, sign)]
            if name == axle:
                return path
            waiting.append((joint.between[1 if is_first else 0], path))
    return []


def _product(sign: float, one: Number, over: Number = 1.0) -> Any:
    """Return a number of a mechanism file: sign times one over another."""
    if is_varied([one, over]):
        return f"${{{sign} * ({one}) / ({over})}}"
    return sign * float(one) / float(over)
