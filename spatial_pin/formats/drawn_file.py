"""A drawing in a mechanism file: bodies, and joints at places of the world, to a tree and closures.

Instead of `tree` the file has `[bodies.NAME]` and `[joints.NAME]` with `between` and `at`. All
numbers are those of the drawn pose, in the axes of the world, and every coordinate is zero there.
The frame of a body is that of the world in the drawn pose: so it does not depend on which joints
are cut. Numbers may be expressions of `[dimensions]`, such as "${b * cos(phi)}"; the tree is xacro
text with the same expressions, whose arguments are the dimensions.
"""

from __future__ import annotations

import keyword
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.errors import MechanismFileError, Mistakes, suggestion
from spatial_pin.formats.checked_tables import TomlTable
from spatial_pin.formats.graph.joint_graph import WORLD, GraphJoint, JointGraph, Link
from spatial_pin.formats.graph.open_tree import cut_notice
from spatial_pin.formats.graph.spanning import SpanningTree
from spatial_pin.formats.graph.urdf import named_coordinates
from spatial_pin.formats.urdf.elements import UNBOUNDED, fresh, joint_element
from spatial_pin.formats.urdf.urdf_model import LIMITS, RESISTANCES
from spatial_pin.formats.xacro.expressions import GLOBALS, Budget, evaluate
from spatial_pin.mechanism.pairs import JOINT_TYPES, PAIRS, hint_at_type, unit
from spatial_pin.numerics.linalg import Array

GROUND = "ground"  # the body that stands still
OWN = ("dimensions", "bodies", "joints", "points", "rods", "gears", "density", "radius", "keep")
# arguments of `load` and of `Drawing.mechanism`, which no dimension can be called
RESERVED = ("source", "trusted", "free_flyer", "packages", "gap", "model", "without", "keep",
            "density")
THICKNESS = 0.04  # radius of bars, of the root mean square distance of the drawing from its centre
SAME = 1e-9  # of the size of a drawing: places nearer than this are one
SLANT = 1e-6  # cosine between pins of a universal joint that are taken as perpendicular
MOST_PAIRS = 3  # ends of a body that bars join two by two; more are joined to their mean
COLOURS = ("0.835 0.369 0 1", "0 0.447 0.698 1", "0 0.620 0.451 1", "0.902 0.624 0 1",
           "0.800 0.475 0.655 1", "0.337 0.706 0.914 1")  # of Okabe and Ito, as in parts.xacro
MACROS = """
  <!-- a bar from p to q -->
  <xacro:macro name="bar" params="p q r rgba">
    <xacro:property name="v" value="${[b - a for a, b in python.zip(p, q)]}"/>
    <visual>
      <origin xyz="${(p[0] + q[0]) / 2} ${(p[1] + q[1]) / 2} ${(p[2] + q[2]) / 2}"
              rpy="0 ${atan2(hypot(v[0], v[1]), v[2])} ${atan2(v[1], v[0])}"/>
      <geometry><cylinder radius="${r}" length="${hypot(v[0], v[1], v[2])}"/></geometry>
      <material name="${rgba}"><color rgba="${rgba}"/></material>
    </visual>
  </xacro:macro>
  <!-- the mass of bars [p, q, length]: thin ones, and what their thickness adds -->
  <xacro:macro name="bars_mass" params="bars r density">
    <xacro:property name="k" value="${density * pi * r * r}"/>
    <xacro:property name="m" value="${k * python.sum([l for p, q, l in bars])}"/>
    <xacro:property name="c" value="${[
      k * python.sum([l * (p[i] + q[i]) / 2 for p, q, l in bars]) / m for i in range(3)]}"/>
    <xacro:property name="s" value="${[[k * python.sum([l * (
      (q[i] - p[i]) * (q[j] - p[j]) / 12 - (q[i] - p[i]) * (q[j] - p[j]) * r * r / (4 * l * l)
      + ((p[i] + q[i]) / 2 - c[i]) * ((p[j] + q[j]) / 2 - c[j])
      + (r * r / 4 if i == j else 0)) for p, q, l in bars])
      for j in range(3)] for i in range(3)]}"/>
    <inertial>
      <origin xyz="${c[0]} ${c[1]} ${c[2]}"/>
      <mass value="${m}"/>
      <inertia ixx="${s[1][1] + s[2][2]}" iyy="${s[0][0] + s[2][2]}" izz="${s[0][0] + s[1][1]}"
               ixy="${-s[0][1]}" ixz="${-s[0][2]}" iyz="${-s[1][2]}"/>
    </inertial>
  </xacro:macro>
"""
Number = float | str  # a constant, or an expression of dimensions
Vector = list[Number]


class DrawnTree(NamedTuple):
    """What a drawing becomes.

    Attributes:
        xacro: the text of the open tree; its arguments are the dimensions.
        content: what a mechanism file says beside it.
        notices: what was cut, a sentence each.
    """

    xacro: str
    content: dict[str, Any]
    notices: tuple[str, ...]


class _Body(NamedTuple):
    mass: Number | None
    com: Vector | None
    inertia: list[Vector] | None  # about the centre of mass, in the world's axes [kg·m²]
    density: Number | None


class _Joint(NamedTuple):
    type: str
    between: tuple[str, str]
    at: Vector
    axis: Vector
    axis2: Vector
    more: dict[str, Any]  # lead, limits and resistances


def drawn_tree(content: Mapping[str, Any], where: str) -> DrawnTree:
    """Return the tree of a drawing, and what is cut of it.

    Args:
        content: of the mechanism file, as `tomllib` reads it; it has `bodies`.
        where: the file, for errors.

    Raises:
        MechanismFileError: says which body, joint, point or number cannot be, all together.
    """
    drawing = _Drawing(TomlTable(dict(content), where))
    drawing.mistakes.tell()
    return _Writer(drawing, content, where).drawn()


# ---------------------------------------------------------------- reading


class _Drawing:
    """The tables of a drawing, read key by key; mistakes are collected."""

    def __init__(self, top: TomlTable) -> None:
        self.mistakes = Mistakes(top.where)
        self.top = top
        self.dimensions: dict[str, float] = {}
        with self.mistakes.each():
            if "tree" in top:
                top.fail("tree", "or bodies: the tree is read from a file, or is drawn")
        with self.mistakes.each():
            for name in top.table("dimensions").content:
                with self.mistakes.each():
                    self._dimension(name)
        self.bodies = self._tables("bodies", self._body)
        self.joints = self._tables("joints", self._joint)
        self.points = self._tables("points", lambda table: (
            self._body_name(table, "body"), self._vector(table, "at")))
        self.rods = self._tables("rods", self._rod)
        self.gears = self._tables("gears", self._gear)
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
                    setattr(self, key, self._number(top, key, above=0.0))
        self._check_names()

    def _dimension(self, name: str) -> None:
        table = self.top.table("dimensions")
        if not name.isidentifier() or keyword.iskeyword(name) or name in (*GLOBALS, *RESERVED):
            table.fail(name, "cannot be a dimension's name: letters, digits and _ make one, which "
                             "is no function of xacro and no argument of load")
        self.dimensions[name] = table.number(name)

    def _tables(self, key: str, read: Any) -> dict[str, Any]:
        """Return what the tables `[KEY.NAME]` say, sorted by name: their order means nothing."""
        found: dict[str, Any] = {}
        with self.mistakes.each():
            for name in sorted(self.top.table(key).content):
                with self.mistakes.each():
                    table = self.top.one_of(key, name)
                    found[name] = read(table)
                    table.close()
        return found

    def _number(self, table: TomlTable, key: str, above: float = -math.inf) -> Number:
        return self._checked(table, key, table.get(key), above)

    def _checked(self, table: TomlTable, key: str, value: Any, above: float = -math.inf) -> Number:
        """Return a finite number, or an expression whose value is one."""
        text = re.fullmatch(r"\s*\$\{([^{}$]*)\}\s*", value) if isinstance(value, str) else None
        number = value
        if text is not None:
            try:
                number = evaluate(text[1], {**GLOBALS, **self.dimensions}, Budget())
            except Exception as error:  # as Python's operators raise it
                table.fail(key, f"is {value!r}: {error}; dimensions are: "
                                f"{', '.join(self.dimensions) or 'none'}")
        if isinstance(number, bool) or not isinstance(number, int | float):
            table.fail(key, f"has {str(value)[:60]!r}: a number is needed, or an expression of "
                            'dimensions such as "${2 * b}"')
        if not math.isfinite(number) or not number > above:
            least = f" above {above:g}" if above > -math.inf else ""
            table.fail(key, f"is {number}; a finite number{least} is needed")
        if text is None or not any(re.search(rf"\b{name}\b", text[1]) for name in self.dimensions):
            return float(number)
        return text[1].strip()

    def _vector(self, table: TomlTable, key: str) -> Vector:
        value = table.get(key)
        if not isinstance(value, list) or len(value) != 3:
            table.fail(key, f"must be a list of three numbers, not {str(value)[:60]}")
        return [self._checked(table, key, x) for x in value]

    def _axis(self, table: TomlTable, key: str, default: Sequence[float]) -> Vector:
        """Return a direction: constants as a unit vector."""
        axis = self._vector(table, key) if key in table else [float(x) for x in default]
        numbers = self.values(axis)
        if not np.any(numbers):
            table.fail(key, "is zero: a direction is needed")
        return axis if is_varied(axis) else unit(numbers).tolist()

    def values(self, vector: Sequence[Number]) -> Array:
        """Return the numbers of a vector at the drawn dimensions."""
        names = {**GLOBALS, **self.dimensions}
        return np.array([x if isinstance(x, float) else evaluate(x, names, Budget())
                         for x in vector], dtype=float)

    def _body_name(self, table: TomlTable, key: str) -> str:
        return self._checked_body(table, key, table.text(key))

    def _checked_body(self, table: TomlTable, key: str, name: str) -> str:
        known = (GROUND, *self.top.table("bodies").content)
        if name not in known:
            table.fail(key, f"has {name!r}, which is no body of the drawing; "
                            f"{suggestion(name, known)}")
        return name

    def _body(self, table: TomlTable) -> _Body:
        mass = self._number(table, "mass") if "mass" in table else None
        density = self._number(table, "density", above=0.0) if "density" in table else None
        com = self._vector(table, "com") if "com" in table else None
        given = table.get("inertia", None)
        if mass is None and (com is not None or given is not None):
            table.fail("mass", "is missing: com and inertia are those of a mass")
        if mass is not None and density is not None:
            table.fail("density", "or mass: a body has one of the two")
        if mass is not None and self.values([mass])[0] < 0.0:
            table.fail("mass", "is below zero, which no body has")
        return _Body(mass, com, None if given is None else self._inertia(table, given), density)

    def _inertia(self, table: TomlTable, given: Any) -> list[Vector]:
        """Return the matrix of one, three, or three times three numbers."""
        rows = given if isinstance(given, list) else [given] * 3
        if len(rows) == 3 and all(isinstance(row, list) and len(row) == 3 for row in rows):
            matrix = [[self._checked(table, "inertia", x) for x in row] for row in rows]
            numbers = np.array([self.values(row) for row in matrix])
            if np.abs(numbers - numbers.T).max() > SAME * np.abs(numbers).max():
                table.fail("inertia", "is not symmetric")
            return matrix
        if len(rows) != 3:
            table.fail("inertia", "is one number, three, or three lists of three [kg·m²]")
        return [[self._checked(table, "inertia", x) if i == j else 0.0 for j in range(3)]
                for i, x in enumerate(rows)]

    def _joint(self, table: TomlTable) -> _Joint:
        kind = table.choice("type", JOINT_TYPES, hint_at_type)
        kind = "fixed" if kind == "weld" else kind
        pair = PAIRS[kind]
        one, two = (self._checked_body(table, "between", x) for x in table.two_names("between"))
        if one == two:
            table.fail("between", f"has {one!r} twice: a joint joins two bodies")
        free = kind in ("floating", "fixed", "prismatic")  # held alike wherever they are drawn
        at = self._vector(table, "at") if "at" in table or not free else [0.0, 0.0, 0.0]
        axis = self._axis(table, "axis", pair.axis) if pair.uses_axis else [0.0, 0.0, 1.0]
        axis2 = [0.0, 1.0, 0.0]
        if pair.uses_axis2:
            axis2 = self._axis(table, "axis2", (0.0, 1.0, 0.0))
            x, y = (unit(self.values(v)) for v in (axis, axis2))
            if abs(x @ y) > SLANT:
                table.fail("axis2", "is not perpendicular to axis: the pins of a universal joint "
                                    "are")
        more = {key: table.get(key) for key in (*RESISTANCES, *LIMITS) if key in table}
        if pair.uses_lead:
            more["lead"] = expression_text(self._number(table, "lead"))
        return _Joint(kind, (one, two), at, axis, axis2, more)

    def _rod(self, table: TomlTable) -> tuple[str, str]:
        ends = table.two_names("between")
        for name in ends:
            if name not in self.points:
                table.fail("between", f"has {name!r}, which is no point of the drawing; "
                                      f"{suggestion(name, self.points)}")
        (body, one), (other, two) = (self.points[name] for name in ends)
        if body == other:
            table.fail("between", f"has two points of {body!r}: a rod joins two bodies")
        if not np.any(self.values(one) - self.values(two)):
            table.fail("between", "has two points at the same place: a rod has a length; for none "
                                  'use a joint of type = "spherical"')
        return ends

    def _gear(self, table: TomlTable) -> dict[str, Any]:
        """Return the coupling of two hinges of gears on one carrier."""
        ends = table.two_names("joints")
        for name in ends:
            if name not in self.joints or self.joints[name].type != "revolute":
                hinges = [k for k, x in self.joints.items() if x.type == "revolute"]
                table.fail("joints", f"has {name!r}, which is no hinge of the drawing; "
                                     f"{suggestion(name, hinges)}")
        teeth = table.get("teeth")
        if not isinstance(teeth, list) or len(teeth) != 2:
            table.fail("teeth", "must be a list of two numbers")
        one, two = (self._checked(table, "teeth", x, above=0.0) for x in teeth)
        internal = table.flag("internal")
        between = [self.joints[name].between for name in ends]
        carriers = set(between[0]) & set(between[1])
        if ends[0] == ends[1] or len(carriers) != 1:
            table.fail("joints", f"{ends[0]!r} and {ends[1]!r} must have one body in common, which "
                                 "carries both gears")
        carrier = carriers.pop()
        axes = [unit(self.values(self.joints[name].axis)) for name in ends]
        signs = [1.0 if pair[0] == carrier else -1.0 for pair in between]
        sign = signs[0] * signs[1] * (1.0 if internal else -1.0) * (
            -1.0 if axes[0] @ axes[1] < -1.0 + SLANT else 1.0)
        ratio: Any = sign * one / two if isinstance(one, float) and isinstance(two, float) else (
            f"${{{sign} * ({one}) / ({two})}}")
        return {"type": "coupling", "joints": list(ends), "ratio": ratio}

    def _check_names(self) -> None:
        """Refuse names that cannot be, and those that several things have."""
        seen: dict[str, str] = {GROUND: "the ground"}
        for kind, names in (("body", self.bodies), ("point", self.points)):
            for name in names:
                with self.mistakes.each():
                    if name in seen and not (kind == "body" and name == GROUND):
                        raise MechanismFileError(f"{self.top.where}: {kind} {name!r} has the name "
                                                 f"of {seen[name]}")
                    seen[name] = f"a {kind}"
        for name in (*self.bodies, *self.points, *self.joints, *self.rods, *self.gears):
            with self.mistakes.each():
                if not name or not name.isprintable() or "$" in name:
                    raise MechanismFileError(f"{self.top.where}: {name!r} is no name: it is empty, "
                                             "or has $ or what cannot be read")


# ---------------------------------------------------------------- expressions


def is_varied(vector: Sequence[Number]) -> bool:
    """Whether a number depends on dimensions."""
    return any(isinstance(x, str) for x in vector)


def expression_text(number: Number) -> Any:
    """Return a number as a mechanism file has it: as it is, or `${...}`."""
    return f"${{{number}}}" if isinstance(number, str) else number


def _texts(vector: Sequence[Number]) -> str:
    """Return numbers as xacro has them."""
    return " ".join(f"${{{x}}}" if isinstance(x, str) else repr(x + 0.0) for x in vector)


def _negative(vector: Sequence[Number]) -> Vector:
    return [f"-({x})" if isinstance(x, str) else -x for x in vector]


def _mean(vectors: Sequence[Vector]) -> Vector:
    columns = zip(*vectors, strict=True)
    return [f"({' + '.join(f'({x})' for x in column)}) / {len(vectors)}" if is_varied(column)
            else float(np.mean(column)) for column in columns]


def _along(axis: Vector) -> tuple[Vector, Vector]:
    """Return the rpy of axes whose z is along a direction, and the rpy of their inverse.

    The rotation is Rz(yaw) Ry(pitch), R' its inverse, read off row by row.
    """
    x, y, z = (f"({c})" for c in axis)
    length = f"hypot({x}, {y}, {z})"
    return ([0.0, f"atan2(hypot({x}, {y}), {z})", f"atan2({y}, {x})"],
            [f"atan2({y}, {z})", f"atan2(-{x}, hypot({y}, {z}))",
             f"atan2(-{y} * {length}, {z} * {x})"])


def _across(axis: Vector, axis2: Vector) -> tuple[Vector, Vector]:
    """Return the rpy of axes whose x and y are along two directions, and that of their inverse."""
    (a, b, c), (d, e, f) = ([f"({u})" for u in v] for v in (axis, axis2))
    p, q, r = f"({b} * {f} - {c} * {e})", f"({c} * {d} - {a} * {f})", f"({a} * {e} - {b} * {d})"
    one, two = f"hypot({a}, {b}, {c})", f"hypot({d}, {e}, {f})"
    return ([f"atan2({f} * {one}, {r})", f"atan2(-{c}, hypot({a}, {b}))", f"atan2({b}, {a})"],
            [f"atan2({q}, {r})", f"atan2(-{p}, hypot({a} * {two}, {d} * {one}))",
             f"atan2({d} * {one}, {a} * {two})"])


# ---------------------------------------------------------------- writing


class _Writer:
    """Writes a drawing as xacro text and closures."""

    def __init__(self, drawing: _Drawing, content: Mapping[str, Any], where: str) -> None:
        self.drawing, self.where = drawing, where
        self.rest = {key: x for key, x in content.items() if key not in OWN}
        self.taken = {"universe", GROUND, *drawing.bodies, *drawing.points, *drawing.joints}
        self.robot = ET.Element("robot", {"name": str(content.get("name", "")),
                                          "xmlns:xacro": "http://www.ros.org/wiki/xacro"})
        self.joints: dict[str, dict[str, Any]] = {}
        self.closures: list[dict[str, Any]] = []
        self.floating: list[str] = []
        self.lost: list[str] = []

    def drawn(self) -> DrawnTree:
        """Write all of it."""
        drawing, robot = self.drawing, self.robot
        self.tree = tree = self._tree()
        for name, value in drawing.dimensions.items():
            ET.SubElement(robot, "xacro:arg", name=name, default=repr(value))
            ET.SubElement(robot, "xacro:property", name=name, value=f"$(arg {name})")
        ET.SubElement(robot, "link", name=GROUND)
        shapes = _Shapes(drawing, robot)
        for name in drawing.bodies:
            if name != GROUND:
                shapes.link(name)
        for name, (body, at) in drawing.points.items():
            ET.SubElement(robot, "link", name=name)
            self._fixed(f"{name}_mount", body, name, at)
        for root in tree.roots:
            self._float(root)
        for joint in tree.joints:
            self._tree_joint(joint)
        for joint in tree.cut:
            self._rod(joint) if joint.name in drawing.rods else self._closure(joint)
        ET.indent(robot)
        text = ET.tostring(robot, encoding="unicode")
        head, bracket, tail = text.partition(">")
        gears = [{"name": name, **table} for name, table in drawing.gears.items()]
        given = {"closures": [*self.closures, *gears, *self.rest.get("closures", [])],
                 "joints": self.joints}
        stem = re.sub(r"[^\w.+-]+", "_", str(self.rest.get("name", ""))).strip("._") or "drawing"
        beside = {"name": "", **self.rest, "tree": f"{stem}.urdf.xacro",
                  **{key: x for key, x in given.items() if x}}
        return DrawnTree(f"{head}{bracket}{MACROS}{tail}\n", beside, tuple(self._notices()))

    def _tree(self) -> SpanningTree:
        """Return the spanning tree, refused where it is none of the drawing's."""
        drawing = self.drawing
        links = [Link(name, massless=False) for name in drawing.bodies if name != GROUND]
        joints = [self._graph_joint(name, joint) for name, joint in drawing.joints.items()]
        held = [GraphJoint(name, "distance", *(_world(drawing.points[x][0]) for x in ends))
                for name, ends in drawing.rods.items()]
        with drawing.mistakes.each():
            self._check_joined([*joints, *held], [link.name for link in links])
        drawing.mistakes.tell()
        wanted = {*drawing.keep, *named_coordinates(self.rest)}
        wanted |= {name for gear in drawing.gears.values() for name in gear["joints"]}
        needed = frozenset(wanted & drawing.joints.keys())
        tree = SpanningTree(JointGraph(tuple(links), (*joints, *held), needed=needed))
        for joint in tree.cut:
            if joint.name in needed:
                raise MechanismFileError(
                    f"{self.where}: joint {joint.name!r} closes a loop and would be cut, but keep, "
                    "a driver, gear, spring, coupling or guess refers to its coordinate, as to "
                    "those of all other joints of the loop; take one of them out")
        return tree

    def _graph_joint(self, name: str, joint: _Joint) -> GraphJoint:
        bounds = {key: float(np.min(joint.more[key])) for key in ("lower", "upper")
                  if isinstance(joint.more.get(key), int | float)}
        resists = float(any(key in joint.more for key in RESISTANCES))
        return GraphJoint(name, joint.type, *map(_world, joint.between), damping=resists, **bounds)

    def _check_joined(self, joints: Sequence[GraphJoint], names: Sequence[str]) -> None:
        """Refuse bodies without joint or rod, and those that nothing joins to the ground."""
        joined = {end for joint in joints for end in (joint.parent, joint.child)}
        alone = [name for name in names if name not in joined]
        if alone:
            raise MechanismFileError(f"{self.where}: bodies.{alone[0]}: no joint and no rod joins "
                                     "it to another body")
        reached, waiting = {WORLD}, [WORLD]
        while waiting:
            link = waiting.pop()
            for joint in joints:
                if link in (joint.parent, joint.child) and joint.other(link) not in reached:
                    reached.add(joint.other(link))
                    waiting.append(joint.other(link))
        loose = [name for name in names if name not in reached]
        if loose:
            raise MechanismFileError(
                f"{self.where}: nothing joins {', '.join(loose)} to the ground; what is free to "
                f'move in space has a joint of type = "floating" between {GROUND!r} and it')

    def _fixed(self, wanted: str, parent: str, child: str, at: Vector,
               rpy: Vector | None = None) -> None:
        joint = joint_element(self.robot, fresh(wanted, self.taken), "fixed", parent, child)
        _origin(joint, at, rpy)

    def _float(self, body: str) -> None:
        """Let a body that only rods hold float, about the mean of their ends."""
        ends = [at for name, (on, at) in self.drawing.points.items() if on == body]
        name = body if body not in self.drawing.joints else fresh(f"{body}_floating", self.taken)
        self.floating.append(f"body {body!r} (joint {name!r})")
        self._carried(name, "floating", GROUND, body, _mean(ends) if ends else [0.0] * 3)

    def _carried(self, name: str, kind: str, parent: str, child: str, at: Vector,
                 turns: tuple[Vector, Vector] | None = None) -> ET.Element:
        """Add a joint at a place of the world, whose child has the frame of the world there."""
        carrier = fresh(f"{name}_on_{child}", self.taken)
        ET.SubElement(self.robot, "link", name=carrier)
        first = carrier
        if turns is not None:  # its own axes before those of the world
            first = fresh(f"{name}_axes", self.taken)
            ET.SubElement(self.robot, "link", name=first)
            self._fixed(f"{carrier}_mount", first, carrier, [0.0] * 3, turns[1])
        joint = joint_element(self.robot, name, kind, parent, first)
        _origin(joint, at, None if turns is None else turns[0])
        self._fixed(f"{child}_mount", carrier, child, _negative(at))
        return joint

    def _oriented(self, joint: _Joint, turned: bool) -> tuple[Vector, Vector, Any]:
        """Return the axes of a joint, and the rpy of frames along them if they are varied."""
        axis, axis2 = joint.axis, joint.axis2
        if turned:  # see GraphJoint.turned
            first, second = (axis2, axis) if joint.type == "universal" else (axis, axis2)
            axis, axis2 = _negative(first), _negative(second)
        pair = PAIRS[joint.type]
        if pair.uses_axis2 and is_varied([*axis, *axis2]):
            return [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], _across(axis, axis2)
        if pair.uses_axis and is_varied(axis):
            return [0.0, 0.0, 1.0], axis2, _along(axis)
        return axis, axis2, None

    def _tree_joint(self, found: GraphJoint) -> None:
        name, joint = found.name, self.drawing.joints[found.name]
        axis, axis2, turns = self._oriented(joint, name in self.tree.turned)
        told = PAIRS[joint.type].told(np.array(axis, float), np.array(axis2, float))
        told.pop("lead", None)
        kind = {"revolute": "continuous", "prismatic": "prismatic", "fixed": "fixed"}.get(
            joint.type, "floating")
        parent, child = (x or GROUND for x in (found.parent, found.child))
        element = self._carried(name, kind, parent, child, joint.at, turns)
        table = dict(joint.more)
        if kind in ("continuous", "prismatic"):
            ET.SubElement(element, "axis", xyz=_texts(axis))
        elif kind == "floating" and joint.type != "floating":
            table = {"type": joint.type, **told, **table}
        if kind == "prismatic":
            ET.SubElement(element, "limit", lower=repr(-UNBOUNDED), upper=repr(UNBOUNDED),
                          effort=repr(UNBOUNDED), velocity=repr(UNBOUNDED))
        if table:
            self.joints[name] = table

    def _frame(self, wanted: str, body: str, at: Vector, rpy: Vector | None = None) -> str:
        name = fresh(wanted, self.taken)
        ET.SubElement(self.robot, "link", name=name)
        self._fixed(f"{name}_mount", body, name, at, rpy)
        return name

    def _closure(self, found: GraphJoint) -> None:
        name, joint = found.name, self.drawing.joints[found.name]
        if joint.type == "floating":
            return
        axis, axis2, turns = self._oriented(joint, False)
        pair, more = PAIRS[joint.type], dict(joint.more)
        told = pair.told(np.array(axis, float), np.array(axis2, float)) if turns is None else {}
        told |= {"lead": more.pop("lead")} if "lead" in more else {}
        frames = [self._frame(f"{name}_on_{body}", body, joint.at, turns and turns[0])
                  for body in joint.between]
        kind = "weld" if joint.type == "fixed" else joint.type
        self.closures.append({"name": name, "type": kind, "frames": frames, **told})
        if more:
            self.lost.append(f"{name!r} ({', '.join(f'{key} {x}' for key, x in more.items())})")

    def _rod(self, found: GraphJoint) -> None:
        ends = self.drawing.rods[found.name]
        places = [self.drawing.points[x][1] for x in ends]
        table: dict[str, Any] = {"name": found.name, "type": "distance", "frames": list(ends)}
        if is_varied([*places[0], *places[1]]):
            table["length_between"] = [
                self._frame(f"{end}_as_drawn", GROUND, at)
                for end, at in zip(ends, places, strict=True)]
        else:
            table["length"] = math.dist(*(self.drawing.values(at) for at in places))
        self.closures.append(table)

    def _notices(self) -> Iterator[str]:
        if self.floating:
            yield f"held by rods alone, so that it floats in the tree: {', '.join(self.floating)}"
        yield from cut_notice(self.closures)
        if self.lost:
            yield f"a closure has no coordinate, so that this does not act: {', '.join(self.lost)}"


def _world(body: str) -> str:
    return WORLD if body == GROUND else body


def _origin(joint: ET.Element, at: Vector, rpy: Vector | None) -> None:
    """Put the <origin> of a joint first."""
    joint.insert(0, ET.Element("origin", xyz=_texts(at), rpy=_texts(rpy or [0.0] * 3)))


class _Shapes:
    """Links of bodies: bars between their joints and points, and masses."""

    def __init__(self, drawing: _Drawing, robot: ET.Element) -> None:
        self.drawing, self.robot, self.count = drawing, robot, 0
        self.joints: dict[str, list[Vector]] = {name: [] for name in drawing.bodies}
        self.points: dict[str, list[Vector]] = {name: [] for name in drawing.bodies}
        for joint in drawing.joints.values():
            for body in set(joint.between) & self.joints.keys():
                self.joints[body].append(joint.at)
        for body, at in drawing.points.values():
            self.points.get(body, []).append(at)
        places = [joint.at for joint in drawing.joints.values() if joint.type != "floating"]
        places += [at for _, at in drawing.points.values()]
        numbers = np.array([drawing.values(x) for x in places]).reshape(-1, 3)
        self.size = float(np.ptp(numbers, axis=0).max(initial=0.0)) or 1.0
        ET.SubElement(robot, "xacro:property", name="bar_radius", value=_texts([self._radius(
            places)]))

    def _radius(self, places: Sequence[Vector]) -> Number:
        """Return the radius of bars: given, or a part of how far places are from their mean."""
        if self.drawing.radius is not None:
            return self.drawing.radius
        distinct = list({_texts(x): x for x in places}.values())
        centre = _mean(distinct) if distinct else [0.0] * 3
        squares = [f"(({x}) - ({c}))**2" for place in distinct
                   for x, c in zip(place, centre, strict=True)]
        root: Number = f"{THICKNESS} * sqrt(({' + '.join(squares)}) / {len(distinct)})" * bool(
            squares)
        if not is_varied([x for place in distinct for x in place]):
            root = float(self.drawing.values([root])[0]) if squares else 0.0
        return root if self.drawing.values([root])[0] > SAME * self.size else THICKNESS

    def link(self, name: str) -> None:
        """Write the link of a body."""
        body = self.drawing.bodies[name]
        link = ET.SubElement(self.robot, "link", name=name)
        ends = self._distinct([*self.joints[name], *self.points[name]])
        colour = COLOURS[self.count % len(COLOURS)]
        self.count += 1
        bars = [(p, q) for k, p in enumerate(ends) for q in ends[k + 1:]]
        if len(ends) > MOST_PAIRS:
            bars = [(p, q) for p in [_mean(ends)] for q in self._distinct([p, *ends])[1:]]
        for p, q in bars:
            ET.SubElement(link, "xacro:bar", p=_list(p), q=_list(q), r="${bar_radius}",
                          rgba=colour)
        if not bars and ends:
            visual = ET.SubElement(link, "visual")
            ET.SubElement(visual, "origin", xyz=_texts(ends[0]), rpy="0.0 0.0 0.0")
            ET.SubElement(ET.SubElement(visual, "geometry"), "sphere", radius="${2 * bar_radius}")
            material = ET.SubElement(visual, "material", name=colour)
            ET.SubElement(material, "color", rgba=colour)
        density = self.drawing.density if body.density is None else body.density
        if body.mass is not None:
            at = body.com or _mean(self.joints[name] or self.points[name] or [[0.0] * 3])
            _inertial(link, body.mass, at, body.inertia or [[0.0] * 3] * 3)
        elif density is not None and bars:
            listed = ", ".join(f"[{_plain(p)}, {_plain(q)}, math.dist({_plain(p)}, {_plain(q)})]"
                               for p, q in bars)
            ET.SubElement(link, "xacro:bars_mass", bars=f"${{[{listed}]}}", r="${bar_radius}",
                          density=_texts([density]))
        elif density is not None and ends:
            mass = f"({density}) * 4 / 3 * pi * (2 * bar_radius)**3"
            moment: Number = f"{mass} * 0.4 * (2 * bar_radius)**2"
            _inertial(link, mass, ends[0], [[moment if i == j else 0.0 for j in range(3)]
                                            for i in range(3)])

    def _distinct(self, places: Sequence[Vector]) -> list[Vector]:
        """Return places that are not at the same place as another."""
        found: list[Vector] = []
        for place in sorted(places[1:], key=_texts) if len(places) > 1 else ():
            found.append(place)
        kept: list[Vector] = []
        for place in [*places[:1], *found]:
            here = self.drawing.values(place)
            if all(math.dist(here, self.drawing.values(x)) > SAME * self.size for x in kept):
                kept.append(place)
        return kept


def _plain(vector: Vector) -> str:
    return f"[{', '.join(str(x) for x in vector)}]"


def _list(vector: Vector) -> str:
    return f"${{{_plain(vector)}}}"


def _inertial(link: ET.Element, mass: Number, com: Vector, inertia: list[Vector]) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_texts(com), rpy="0.0 0.0 0.0")
    ET.SubElement(inertial, "mass", value=_texts([mass]))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    parts = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ET.SubElement(inertial, "inertia", {key: _texts([x]) for key, x in parts.items()})

