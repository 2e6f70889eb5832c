"""A drawing to an open tree, as xacro text, and the closures of its loops.

Every coordinate is zero in the drawn pose, where the frame of every body is that of the world. So
points in the frame of a body do not depend on which joints are cut. The text has the
expressions of the drawing, and its dimensions as arguments.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.checked_tables import TomlTable
from spatial_pin.formats.drawn_file import (
    BAR_RADIUS,
    GROUND,
    DrawnFile,
    DrawnJoint,
    Number,
    Vector,
    is_varied,
)
from spatial_pin.formats.graph.joint_graph import WORLD, GraphJoint, JointGraph, Link, SpanningTree
from spatial_pin.formats.graph.open_tree import cut_notice, named_coordinates
from spatial_pin.formats.urdf.elements import UNBOUNDED, fresh, joint_element
from spatial_pin.formats.urdf.urdf_model import RESISTANCES
from spatial_pin.mechanism.pairs import PAIRS

OWN = ("dimensions", "bodies", "joints", "points", "rods", "gears", "density", "radius", "keep")
BAR_THICKNESS = 0.03  # radius of bars, by the root mean square distance from the drawing's centre
SAME = 1e-9  # of the size of a drawing: places nearer than this are one
MOST_PAIRS = 3  # ends of a body that bars join two by two; more are joined to their mean
URDF_TYPES = {"revolute": "continuous", "prismatic": "prismatic", "fixed": "fixed"}
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


def drawn_tree(
    content: Mapping[str, Any], where: str
) -> tuple[str, dict[str, Any], tuple[str, ...]]:
    """Return a drawing's xacro text, a mechanism file's content for it, and notices of cut joints.

    Raises:
        MechanismFileError: a body, joint, point or number cannot be; says all of them.
    """
    drawing = DrawnFile(TomlTable(dict(content), where))
    drawing.mistakes.raise_all()
    rest = {key: x for key, x in content.items() if key not in OWN}
    tree = spanning_tree(drawing, rest, where)
    text = TreeText(drawing, str(content.get("name", "")))
    text.write(tree)
    gears = [{"name": name, **table} for name, table in drawing.gears.items()]
    added = {"closures": [*text.closures, *gears, *rest.get("closures", [])], "joints": text.joints}
    stem = re.sub(r"[^\w.+-]+", "_", str(rest.get("name", ""))).strip("._") or "drawing"
    mechanism_file = {"name": "", **rest, "tree": f"{stem}.urdf.xacro",
              **{key: x for key, x in added.items() if x}}
    return text.xacro(), mechanism_file, tuple(text.notices())


def spanning_tree(drawing: DrawnFile, rest: Mapping[str, Any], where: str) -> SpanningTree:
    """Return a drawing's spanning tree, in which coordinates are that something refers to."""
    links = [Link(name, massless=False) for name in drawing.bodies]
    joints = []
    for name, drawn in drawing.joints.items():  # of limits and resistances only that there are any
        (one, two), more = drawn.between, drawn.more
        joints.append(GraphJoint(
            name, drawn.type, _world(one), _world(two),
            lower=0.0 if "lower" in more else -math.inf, upper=0.0 if "upper" in more else math.inf,
            damping=float(any(key in more for key in RESISTANCES))))
    joints += [GraphJoint(name, "distance", _world(drawing.points[one][0]),
                          _world(drawing.points[two][0]))
               for name, (one, two) in drawing.rods.items()]
    _check_joined(joints, [link.name for link in links], where)
    wanted = {*drawing.keep, *named_coordinates(rest)}
    wanted |= {name for gear in drawing.gears.values() for name in gear["joints"]}
    needed = frozenset(wanted & drawing.joints.keys())
    tree = SpanningTree(JointGraph(tuple(links), tuple(joints), needed=needed))
    for joint in tree.cut:
        if joint.name in needed:
            raise MechanismFileError(
                f"{where}: joint {joint.name!r} closes a loop and would be cut, but keep, a "
                "driver, gear, spring, coupling or guess refers to its coordinate, as to those of "
                "all other joints of the loop; take one of them out")
    return tree


def _check_joined(joints: Sequence[GraphJoint], bodies: Sequence[str], where: str) -> None:
    """Refuse bodies without joint or rod, and those that nothing joins to the ground."""
    joined = {end for joint in joints for end in (joint.parent, joint.child)}
    for name in bodies:
        if name not in joined:
            raise MechanismFileError(f"{where}: bodies.{name}: no joint and no rod joins it to "
                                     "another body")
    reached, waiting = {WORLD}, [WORLD]
    while waiting:
        link = waiting.pop()
        beyond = {joint.other(link) for joint in joints if link in (joint.parent, joint.child)}
        waiting += beyond - reached
        reached |= beyond
    loose = [name for name in bodies if name not in reached]
    if loose:
        raise MechanismFileError(
            f"{where}: nothing joins {', '.join(loose)} to {GROUND!r}; a body that moves freely in "
            f'space has a joint of type = "floating" between {GROUND!r} and it')


def _world(body: str) -> str:
    return WORLD if body == GROUND else body


def _texts(vector: Sequence[Number]) -> str:
    """Return numbers as xacro has them."""
    return " ".join(f"${{{x}}}" if isinstance(x, str) else repr(x + 0.0) for x in vector)


def _negative(vector: Sequence[Number]) -> Vector:
    return [f"-({x})" if isinstance(x, str) else -x for x in vector]


def _mean(vectors: Sequence[Vector]) -> Vector:
    columns = zip(*vectors, strict=True)
    return [f"({' + '.join(f'({x})' for x in column)}) / {len(vectors)}" if is_varied(column)
            else float(np.mean([float(x) for x in column])) for column in columns]


def _along(axis: Vector) -> tuple[Vector, Vector]:
    """Return the rpy Rz(yaw) Ry(pitch) of axes with z along a direction, and of their inverse."""
    x, y, z = (f"({c})" for c in axis)
    length = f"hypot({x}, {y}, {z})"
    return ([0.0, f"atan2(hypot({x}, {y}), {z})", f"atan2({y}, {x})"],
            [f"atan2({y}, {z})", f"atan2(-{x}, hypot({y}, {z}))",
             f"atan2(-{y} * {length}, {z} * {x})"])


def _facing(x: Sequence[str], y: Sequence[str]) -> Vector:
    """Return the rpy of axes whose x and y are along two directions; x may point up or down."""
    (a, b, c), (d, e, f) = x, y
    yaw, pitch = f"atan2({b}, {a})", f"atan2(-{c}, hypot({a}, {b}))"
    return [f"atan2(({d} * cos({yaw}) + {e} * sin({yaw})) * sin({pitch}) + {f} * cos({pitch}), "
            f"{e} * cos({yaw}) - {d} * sin({yaw}))", pitch, yaw]


def _across(axis: Vector, axis2: Vector) -> tuple[Vector, Vector]:
    """Return the rpy of axes whose x and y are along two directions, and that of their inverse."""
    x, y = ([f"({u})" for u in v] for v in (axis, axis2))
    (a, b, c), (d, e, f) = x, y
    one, two = f"hypot({a}, {b}, {c})", f"hypot({d}, {e}, {f})"
    return _facing(x, y), _facing(
        [f"({a} * {two})", f"({d} * {one})", f"({b} * {f} - {c} * {e})"],
        [f"({b} * {two})", f"({e} * {one})", f"({c} * {d} - {a} * {f})"])


class TreeText:
    """The xacro text of a drawing's spanning tree, and tables of joints and closures beside it."""

    def __init__(self, drawing: DrawnFile, name: str) -> None:
        self.drawing = drawing
        self.joints: dict[str, dict[str, Any]] = {}
        self.closures: list[dict[str, Any]] = []
        self._taken = {"universe", GROUND, *drawing.bodies, *drawing.points, *drawing.joints}
        self._robot = ET.Element("robot", {
            "name": name, "xmlns:xacro": "http://www.ros.org/wiki/xacro"})
        self._floating: list[str] = []
        self._lost: list[str] = []

    def xacro(self) -> str:
        """Return the text."""
        ET.indent(self._robot)
        head, bracket, rest = ET.tostring(self._robot, encoding="unicode").partition(">")
        return f"{head}{bracket}{MACROS}{rest}\n"

    def notices(self) -> Iterator[str]:
        """Yield sentences: which joints were cut, and what the tree loses by that."""
        if self._floating:
            yield ("held by rods alone, so that it floats in the tree: "
                   f"{', '.join(self._floating)}")
        rods = list(self.drawing.rods)
        yield from cut_notice(x for x in self.closures if x["name"] not in rods)
        if rods:
            yield f"rods are closures that hold distances: {', '.join(rods)}"
        if self._lost:
            yield f"a closure has no coordinate, so that this does not act: {', '.join(self._lost)}"

    def write(self, tree: SpanningTree) -> None:
        """Write all of it."""
        drawing = self.drawing
        numbers = drawing.numbers
        for name, symbol in zip(numbers.dimensions, numbers.symbols, strict=True):
            default = repr(numbers.dimensions[name])
            ET.SubElement(self._robot, "xacro:arg", name=name, default=default)
            ET.SubElement(self._robot, "xacro:property", name=symbol, value=f"$(arg {name})")
        ET.SubElement(self._robot, "link", name=GROUND)
        shapes = DrawnShapes(drawing, self._robot)
        for k, name in enumerate(drawing.bodies):
            shapes.link(name, COLOURS[k % len(COLOURS)])
        for name, (body, at) in drawing.points.items():
            self._frame(name, body, at)
        for root in tree.roots:
            ends = [at for on, at in drawing.points.values() if on == root]
            name = root if root not in drawing.joints else fresh(root, self._taken)
            self._floating.append(f"body {root!r} (joint {name!r})")
            self._carry(name, "floating", GROUND, root, _mean(ends) if ends else [0.0] * 3)
        for joint in tree.joints:
            self._tree_joint(joint, joint.name in tree.turned)
        for joint in tree.cut:
            if joint.name in drawing.rods:
                self._rod(joint.name)
            elif joint.type != "floating":  # which holds nothing
                self._closure(joint.name)

    def _fixed(self, child: str, parent: str, at: Vector, rpy: Vector | None = None) -> None:
        mount = fresh(f"{child}_mount", self._taken)
        _put_origin(joint_element(self._robot, mount, "fixed", parent, child), at, rpy)

    def _frame(self, name: str, body: str, at: Vector, rpy: Vector | None = None) -> str:
        """Add a link at a place of a body, and return its name."""
        ET.SubElement(self._robot, "link", name=name)
        self._fixed(name, body, at, rpy)
        return name

    def _carry(self, name: str, kind: str, parent: str, body: str, at: Vector,
               turns: tuple[Vector, Vector] | None = None) -> ET.Element:
        """Add a joint at a place of the world, and the body that it carries."""
        carrier = first = fresh(f"{name}_on_{body}", self._taken)
        if turns is not None:  # its own axes, then those of the world
            first = fresh(f"{name}_axes", self._taken)
            ET.SubElement(self._robot, "link", name=first)
        ET.SubElement(self._robot, "link", name=carrier)
        joint = joint_element(self._robot, name, kind, parent, first)
        _put_origin(joint, at, None if turns is None else turns[0])
        if turns is not None:
            self._fixed(carrier, first, [0.0] * 3, turns[1])
        self._fixed(body, carrier, _negative(at))
        return joint

    def _tree_joint(self, edge: GraphJoint, turned: bool) -> None:
        joint = self.drawing.joints[edge.name]
        axis, axis2, turns = _oriented(joint, turned)
        kind, table = URDF_TYPES.get(joint.type, "floating"), dict(joint.more)
        element = self._carry(edge.name, kind, edge.parent or GROUND, edge.child or GROUND,
                              joint.at, turns)
        if kind in ("continuous", "prismatic"):
            ET.SubElement(element, "axis", xyz=_texts(axis))
        elif kind == "floating" and joint.type != kind:
            table = {"type": joint.type, **_entries(joint.type, axis, axis2), **table}
        if kind == "prismatic":
            none = repr(UNBOUNDED)
            ET.SubElement(element, "limit", lower=f"-{none}", upper=none, effort=none,
                          velocity=none)
        if table:
            self.joints[edge.name] = table

    def _closure(self, name: str) -> None:
        joint = self.drawing.joints[name]
        axis, axis2, turns = _oriented(joint, False)
        entries, more = {} if turns else _entries(joint.type, axis, axis2), dict(joint.more)
        entries |= {"lead": more.pop("lead")} if "lead" in more else {}
        frames = [self._frame(fresh(f"{name}_on_{body}", self._taken), body, joint.at,
                              turns and turns[0]) for body in joint.between]
        kind = "weld" if joint.type == "fixed" else joint.type
        self.closures.append({"name": name, "type": kind, "frames": frames, **entries})
        if more:
            self._lost.append(f"{name!r} ({', '.join(f'{key} {x}' for key, x in more.items())})")

    def _rod(self, name: str) -> None:
        ends, table = self.drawing.rods[name], dict[str, Any]()
        ends_at = [self.drawing.points[x][1] for x in ends]
        if is_varied([*ends_at[0], *ends_at[1]]):  # the distance of two places on the ground
            table["length_between"] = [
                self._frame(fresh(f"{end}_as_drawn", self._taken), GROUND, at)
                for end, at in zip(ends, ends_at, strict=True)]
        else:
            table["length"] = math.dist(*map(self.drawing.numbers.values, ends_at))
        self.closures.append({"name": name, "type": "distance", "frames": list(ends), **table})


def _put_origin(joint: ET.Element, at: Vector, rpy: Vector | None) -> None:
    joint.insert(0, ET.Element("origin", xyz=_texts(at), rpy=_texts(rpy or [0.0] * 3)))


def _entries(kind: str, axis: Vector, axis2: Vector) -> dict[str, Any]:
    """Return what a mechanism file says of constant axes."""
    entries = PAIRS[kind].file_entries(np.array(axis, float), np.array(axis2, float))
    return {key: x for key, x in entries.items() if key != "lead"}


def _oriented(
    joint: DrawnJoint, turned: bool
) -> tuple[Vector, Vector, tuple[Vector, Vector] | None]:
    """Return the axes of a joint; of varied ones those of frames along them, and their rpy."""
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


class DrawnShapes:
    """The links of bodies: bars between their joints and points, and masses."""

    def __init__(self, drawing: DrawnFile, robot: ET.Element) -> None:
        self._drawing, self._robot = drawing, robot
        self._joints: dict[str, list[Vector]] = {name: [] for name in (GROUND, *drawing.bodies)}
        self._points: dict[str, list[Vector]] = {name: [] for name in (GROUND, *drawing.bodies)}
        for joint in drawing.joints.values():
            for body in joint.between if joint.type != "floating" else ():
                self._joints[body].append(joint.at)
        for body, at in drawing.points.values():
            self._points[body].append(at)
        points = [x for at in (self._joints, self._points) for some in at.values() for x in some]
        numbers = np.array([drawing.numbers.values(x) for x in points]).reshape(-1, 3)
        self._size = float(np.ptp(numbers, axis=0).max()) if points else 0.0
        ET.SubElement(robot, "xacro:property", name=BAR_RADIUS, value=_texts([self._radius(
            self._distinct(points))]))

    def _radius(self, points: Sequence[Vector]) -> Number:
        """Return the radius of bars: given, or a part of how far places are from their mean."""
        if self._drawing.radius is not None:
            return self._drawing.radius
        if len(points) < 2:
            return BAR_THICKNESS
        centre = _mean(points)
        squares = " + ".join(f"(({x}) - ({c}))**2" for point in points
                             for x, c in zip(point, centre, strict=True))
        radius = f"{BAR_THICKNESS} * sqrt(({squares}) / {len(points)})"
        return radius if is_varied([x for point in points for x in point]) else float(
            self._drawing.numbers.values([radius])[0])

    def _distinct(self, points: Sequence[Vector]) -> list[Vector]:
        """Return places without those at the place of another, sorted."""
        distinct: list[Vector] = []
        numbers: list[Any] = []
        for point in sorted(points, key=_texts):
            here = self._drawing.numbers.values(point)
            if all(math.dist(here, x) > SAME * self._size for x in numbers):
                distinct.append(point)
                numbers.append(here)
        return distinct

    def link(self, name: str, colour: str) -> None:
        """Write the link of a body."""
        body = self._drawing.bodies[name]
        link = ET.SubElement(self._robot, "link", name=name)
        ends = self._distinct([*self._joints[name], *self._points[name]])
        bars = [(p, q) for k, p in enumerate(ends) for q in ends[k + 1:]]
        if len(ends) > MOST_PAIRS:
            centre = _mean(ends)
            bars = [(centre, q) for q in ends if len(self._distinct([centre, q])) > 1]
        radius = f"${{{BAR_RADIUS}}}"
        for p, q in bars:
            ET.SubElement(link, "xacro:bar", p=f"${{{_plain(p)}}}", q=f"${{{_plain(q)}}}", r=radius,
                          rgba=colour)
        if not bars and ends:
            visual = ET.SubElement(link, "visual")
            ET.SubElement(visual, "origin", xyz=_texts(ends[0]), rpy="0.0 0.0 0.0")
            ET.SubElement(ET.SubElement(visual, "geometry"), "sphere",
                          radius=f"${{2 * {BAR_RADIUS}}}")
            material = ET.SubElement(visual, "material", name=colour)
            ET.SubElement(material, "color", rgba=colour)
        mass, density = body["mass"], body["density"] or self._drawing.density
        if mass is not None:
            centre = _mean(self._joints[name] or self._points[name] or [[0.0] * 3])
            _put_inertial(link, mass, body["com"] or centre, body["inertia"] or [[0.0] * 3] * 3)
        elif density is not None and bars:
            listed = ", ".join(f"[{_plain(p)}, {_plain(q)}, math.dist({_plain(p)}, {_plain(q)})]"
                               for p, q in bars)
            ET.SubElement(link, "xacro:bars_mass", bars=f"${{[{listed}]}}", r=radius,
                          density=_texts([density]))
        elif density is not None and ends:  # a ball
            mass = f"({density}) * 4 / 3 * pi * (2 * {BAR_RADIUS})**3"
            moment = f"{mass} * 0.4 * (2 * {BAR_RADIUS})**2"
            _put_inertial(link, mass, ends[0], [[moment if i == j else 0.0 for j in range(3)]
                                                for i in range(3)])


def _plain(vector: Vector) -> str:
    return f"[{', '.join(str(x) for x in vector)}]"


def _put_inertial(link: ET.Element, mass: Number, com: Vector, inertia: Sequence[Vector]) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_texts(com), rpy="0.0 0.0 0.0")
    ET.SubElement(inertial, "mass", value=_texts([mass]))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    parts = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ET.SubElement(inertial, "inertia", {key: _texts([x]) for key, x in parts.items()})
