"""URDF and xacro to a Pinocchio model whose joints are the pairs that URDF cannot name.

Bad numbers (mass below zero, NaN) are refused before, and loops are cut by then. Joints and frames
are numbered as Pinocchio's own reader of URDF numbers them. Angles of `continuous` joints are one
coordinate, so that they count turns.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, Mistakes, suggestion
from spatial_pin.formats.file_access import Trust
from spatial_pin.formats.importers import Faults
from spatial_pin.formats.urdf.elements import (
    UNBOUNDED,
    URDF_AXIS,
    by_name,
    end_of,
    joint_element,
    numbers,
    placement,
)
from spatial_pin.formats.urdf.geometry import geometry_of, take_shapes
from spatial_pin.mechanism.inertia import inertia_as_given, put_inertias
from spatial_pin.mechanism.pairs import COUPLING, JOINT_TYPES, PAIRS, Pair, hint_at_type, unit
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array

LIGHTEST = 1e-200  # kg
ONCE = {  # of a link or joint, or of an element in it, allowed once
    ".": ("inertial", "origin", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"), "collision": ("origin", "geometry"),
}
UNIVERSE = "universe"  # the joint that all joints of a Pinocchio model hang on
INERTIAL = (("mass", "value"),
            *(("inertia", key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")))
CONTAINED_PAIRS = {  # URDF type -> pairs that a refinement may make of it
    "floating": JOINT_TYPES,
    "planar": ("planar", "revolute", "prismatic", "fixed"),
    "continuous": ("revolute", "fixed"),
    "revolute": ("revolute", "fixed"),
    "prismatic": ("prismatic", "fixed"),
    "fixed": ("fixed",),
}
PAIR_OF_URDF_TYPE = {"continuous": "revolute"}
# Numbers of `[joints.X]`: the arrays of `pin.Model` that each sets, and by which factor.
RESISTANCES: dict[str, dict[str, float]] = {
    "damping": {"damping": 1.0}, "armature": {"armature": 1.0},
    "friction": {"upperDryFrictionLimit": 1.0, "lowerDryFrictionLimit": -1.0},
    "slip_speed": {},  # which Pinocchio does not have
}
LIMITS: dict[str, dict[str, float]] = {
    "lower": {"lowerPositionLimit": 1.0}, "upper": {"upperPositionLimit": 1.0},
    "velocity": {"upperVelocityLimit": 1.0, "lowerVelocityLimit": -1.0},
    "lower_velocity": {"lowerVelocityLimit": 1.0},
    "effort": {"upperEffortLimit": 1.0, "lowerEffortLimit": -1.0},
    "lower_effort": {"lowerEffortLimit": 1.0},
}
NUMBERS = {**RESISTANCES, **LIMITS}


def check_structure(robot: ET.Element, path: Path) -> None:
    """Refuse links and joints that do not make a graph, or have names that nothing can ask for."""
    if robot.tag != "robot":
        raise MechanismFileError(f"{path}: the root element is <{robot.tag}>, not <robot>")
    links = by_name(robot.findall("link"), "link", path)
    if not links:
        raise MechanismFileError(f"{path}: no <link>")
    joints = robot.findall("joint")
    by_name(joints, "joint", path)
    named = [("joint", joint.get("name", "")) for joint in joints] + [("link", x) for x in links]
    odd = [(len(name), kind, name) for kind, name in named if not name.isprintable()]
    if odd:  # the shortest: importers call others after it
        _, kind, name = min(odd)
        raise MechanismFileError(f"{path}: a {kind} is named {name!r}; a name is text that can be "
                                 "read")
    if any(joint.get("name") == UNIVERSE and joint.get("type") != "fixed" for joint in joints):
        raise MechanismFileError(f"{path}: a joint is named {UNIVERSE!r}, which is Pinocchio's "
                                 "name of the ground; rename it")
    for joint in joints:
        for role in ("parent", "child"):
            link = end_of(joint, role)
            if link not in links:
                raise MechanismFileError(
                    f"{path}: joint {joint.get('name')!r}: {role} link {link!r} does not exist; "
                    f"{suggestion(link, links)}"
                )
        if end_of(joint, "child") == end_of(joint, "parent"):
            raise MechanismFileError(f"{path}: joint {joint.get('name')!r} joins link "
                                     f"{end_of(joint, 'child')!r} with itself")


def _make_one_tree(robot: ET.Element, faults: Faults) -> str:
    """Note repeated elements, of which the first count; fix all roots to one, and return that."""
    joints = robot.findall("joint")
    children = {end_of(joint, "child") for joint in joints}
    links = [link.get("name", "") for link in robot.findall("link")]
    roots = [link for link in links if link not in children]
    elements = [(kind, x) for kind in ("link", "joint") for x in robot.findall(kind)]
    for below, tags in ONCE.items():
        for kind, element in elements:
            for part, tag in product(element.iterfind(below), tags):
                if len(part.findall(tag)) > 1:
                    faults.note("stated more than once, the first counts",
                                f"{kind} {element.get('name')!r}: <{tag}>")
    if len(roots) == 1:
        return roots[0]
    taken = {*links, *(joint.get("name", "") for joint in joints)} - set(roots)
    world = _free("world", taken)
    if world not in roots:
        ET.SubElement(robot, "link", name=world)
    for root in roots:
        if root != world:
            joint_element(robot, _free(f"{world}_to_{root}", taken), "fixed", world, root)
            faults.note("no parent, fixed to the ground at its origin", f"link {root!r}")
    return world


def _free(name: str, taken: Container[str]) -> str:
    while name in taken:
        name += "_"
    return name


def check_links(robot: ET.Element, path: Path, faults: Faults) -> dict[str, pin.Inertia]:
    """Return the own inertia of the links that have one."""
    inertias = {}
    for link in robot.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if inertial is None:
            continue
        where = f"{path}: link {name!r}"
        centre = placement(inertial.find("origin"), where)
        given = {key: inertial.find(tag) for tag, key in INERTIAL}
        values = {key: float(numbers(x, key, 1, where)[0])
                  for key, x in given.items() if x is not None and key in x.attrib}
        missing = ["mass" if key == "value" else key for key in given if key not in values]
        if missing and len(inertial):
            faults.note("of <inertial> missing, counts as 0", f"link {name!r}: {' '.join(missing)}")
        mass, xx, xy, xz, yy, yz, zz = (values.get(key, 0.0) for key in given)
        if mass and not LIGHTEST <= abs(mass) <= 1.0 / LIGHTEST:
            raise MechanismFileError(
                f"{where}: a mass of {mass:.3g} kg; only 0 and masses from {LIGHTEST:g} to "
                f"{1.0 / LIGHTEST:g} kg can be worked with")
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        with np.errstate(over="ignore", invalid="ignore"):
            turned = centre.rotation @ matrix @ centre.rotation.T
        if not np.all(np.abs(turned) <= 1.0 / LIGHTEST):
            raise MechanismFileError(f"{where}: its moments of inertia are above "
                                     f"{1.0 / LIGHTEST:g} kg·m², more than can be worked with")
        inertias[name] = inertia_as_given(mass, centre.translation, turned)
    return inertias


def check_joint(joint: ET.Element, path: Path, faults: Faults) -> None:
    """Refuse numbers that the URDF reader refuses without saying where, or takes as they are."""
    name = joint.get("name")
    where = f"{path}: joint {name!r}"
    placement(joint.find("origin"), where)
    axis, limit, dynamics = (joint.find(tag) for tag in ("axis", "limit", "dynamics"))
    kind = joint.get("type", "")
    if axis is not None and kind != "fixed":
        numbers(axis, "xyz", 3, where)
    if kind in ("revolute", "prismatic"):
        missing = [key for key in ("effort", "velocity")
                   if limit is None or key not in limit.attrib]
        if missing:
            faults.note("no <limit>, counts as unlimited" if limit is None else
                        f"no {' and no '.join(missing)} in <limit>, counts as unlimited in that",
                        f"joint {name!r}")
    if limit is not None:
        for attribute in ("effort", "velocity"):
            if attribute in limit.attrib and numbers(limit, attribute, 1, where)[0] < 0.0:
                raise MechanismFileError(f"{where}: <limit {attribute}> is negative")
        lower, upper = (float(numbers(limit, key, 1, where)[0]) if key in limit.attrib else 0.0
                        for key in ("lower", "upper"))
        if lower > upper and kind in ("revolute", "prismatic"):
            faults.note("lower limit above the upper one, counts as no limit", f"joint {name!r}")
            limit.attrib.update(lower=repr(-UNBOUNDED), upper=repr(UNBOUNDED))
    for attribute in ("damping", "friction"):
        if dynamics is not None and attribute in dynamics.attrib \
                and numbers(dynamics, attribute, 1, where)[0] < 0.0:
            raise MechanismFileError(f"{where}: <dynamics {attribute}> is negative")


@dataclass(frozen=True, eq=False)
class JointRefinement:
    """The table of a URDF joint in a mechanism file.

    Attributes:
        type: a name of `PAIRS`; None for that of the URDF.
        axis: (3,) unit vector in the joint frame, None for the default.
        axis2: (3,) unit vector, second pin of a universal joint.
        lead: translation per turn of a screw [m].
        numbers: some of `NUMBERS`, in their order, a number for all coordinates or one for each;
            of positions one for each entry of q.
        where: file and table, for errors.
    """

    type: str | None = None
    axis: Array | None = None
    axis2: Array | None = None
    lead: float = 0.0
    numbers: Mapping[str, Array] = field(default_factory=dict)
    where: str = ""


def tree_of(
    robot: ET.Element, path: Path, refinements: Mapping[str, JointRefinement], faults: Faults,
    trust: Trust, order: Sequence[str] = (), order_of: str = "",
) -> tuple[dict[str, Any], tuple[Closure, ...]]:
    """Return the fields of a `Mechanism` for the open tree of a URDF, which changes, and mimics.

    Coordinates are in the `order` of joints, which the file `order_of` states: joints that it lacks
    go first, in the order of Pinocchio's reader: joint by joint upwards, alphabetically at each
    link.
    """
    for parent in list(robot.iter()):  # elements of other namespaces, from xacro
        for key in [key for key in parent.attrib if "}" in key]:
            del parent.attrib[key]
        for child in [child for child in parent if "}" in child.tag]:
            parent.remove(child)
    root = _make_one_tree(robot, faults)
    mistakes = Mistakes(str(path))
    with mistakes.each():
        inertias = check_links(robot, path, faults)
    with mistakes.each():
        pairs = _joint_pairs(robot, refinements, path)
        mimics = _mimics(robot, pairs, path, faults)
    for joint in robot.findall("joint"):
        with mistakes.each():
            check_joint(joint, path, faults)
    mistakes.raise_all()
    shapes = take_shapes(robot, path, trust, faults)
    whole = ET.tostring(robot, encoding="unicode")  # with absolute paths of meshes
    model = _model_of(robot, root, pairs, refinements, inertias, order, order_of, path)
    slip_speeds = _put_numbers(model, refinements)
    try:
        put_inertias(model, inertias)
    except (RuntimeError, ValueError) as error:
        raise MechanismFileError(
            f"{path}: inertias leave the range of numbers: it is too large or too heavy"
        ) from error
    geometry = partial(geometry_of, model, shapes, str(path))
    return {"model": model, "visual_model": partial(geometry, "visual"),
            "collision_model": partial(geometry, "collision"), "inertias": inertias,
            "pairs": tuple(pairs[name] for name in list(model.names)[1:]), "urdf": whole,
            "slip_speeds": slip_speeds}, mimics


def _joint_pairs(
    robot: ET.Element, refinements: Mapping[str, JointRefinement], path: Path
) -> dict[str, str]:
    """Return the pair of every joint; refinements URDF can express are written into `robot`."""
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    for name, refined in refinements.items():
        if name not in joints:
            raise MechanismFileError(
                f"{refined.where}: the URDF has no such joint; {suggestion(name, joints)}")
    pairs = {}
    for name, joint in joints.items():
        kind = joint.get("type", "")
        if kind not in CONTAINED_PAIRS:
            hint = hint_at_type(kind, CONTAINED_PAIRS) or suggestion(kind, CONTAINED_PAIRS)
            raise MechanismFileError(
                f"{path}: joint {name!r}: URDF has no joint type {kind!r}; {hint} (write "
                "type=\"floating\" and name the pair in the .toml file for spherical, universal, "
                "cylindrical and screw)"
            )
        given = refinements.get(name)
        pair = given.type if given else None
        if pair and pair not in CONTAINED_PAIRS[kind]:
            raise MechanismFileError(
                f"{given.where if given else path}: joint {name!r} is {kind} in the URDF, which "
                f"does not contain a {pair} pair; make it \"floating\" there"
            )
        pairs[name] = pair or PAIR_OF_URDF_TYPE.get(kind, kind)
        if given and pairs[name] == "fixed" and given.numbers:
            raise MechanismFileError(
                f"{given.where}: {next(iter(given.numbers))}: joint {name!r} is fixed and has "
                "nothing that could resist or be limited; take the key out")
        if pairs[name] == "fixed":
            joint.set("type", "fixed")
    return pairs


def _model_of(
    robot: ET.Element, root: str, pairs: Mapping[str, str],
    refinements: Mapping[str, JointRefinement], inertias: Mapping[str, pin.Inertia],
    order: Sequence[str], order_of: str, path: Path,
) -> pin.Model:
    """Return the open tree, its frames numbered as Pinocchio's reader of URDF numbers them."""
    elements = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    hangs = _hanging(robot, root, pairs, path)
    model, ids = pin.Model(), {UNIVERSE: 0}
    model.name = robot.get("name") or path.stem
    above = {name: on for name, (on, _) in hangs.items() if pairs[name] != "fixed"}
    for name in _ordered(above, order, order_of):
        pair, refined = PAIRS[pairs[name]], refinements.get(name, JointRefinement())
        axis, axis2 = joint_axes(pair, elements[name], refined, f"{path}: joint {name!r}")
        assert pair.joint is not None
        joint = pair.joint(axis, axis2, refined.lead)
        ids[name] = model.addJoint(ids[above[name]], joint, hangs[name][1], name,
                                   *stated_limits(elements[name], joint.nq, joint.nv).values())
    model.lowerVelocityLimit = -model.upperVelocityLimit  # Pinocchio 4.1 stores the upper one
    here, none = pin.SE3.Identity(), pin.Inertia.Zero()
    frames = {root: model.addFrame(pin.Frame(
        root, 0, 0, here, pin.FrameType.BODY, inertias.get(root, none)), False)}
    for name, hung in hangs.items():
        element, is_fixed = elements[name], pairs[name] == "fixed"
        on, at = hung if is_fixed else (name, here)
        kind = pin.FrameType.FIXED_JOINT if is_fixed else pin.FrameType.JOINT
        parent, child = frames[end_of(element, "parent")], end_of(element, "child")
        fixed = inertias.get(child, none) if is_fixed else none  # as Pinocchio notes them
        own = model.addFrame(pin.Frame(name, ids[on], parent, at, kind, fixed), False)
        frames[child] = model.addFrame(
            pin.Frame(child, ids[on], own, at, pin.FrameType.BODY), False)
    return model


def _hanging(
    robot: ET.Element, root: str, pairs: Mapping[str, str], path: Path
) -> dict[str, tuple[str, pin.SE3]]:
    """Return for each joint the next one above it that moves, and its placement there."""
    elements = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    links = {root: (UNIVERSE, pin.SE3.Identity())}
    hangs = {}
    for name in urdf_order(robot):
        on, at = links[end_of(elements[name], "parent")]
        at = at * placement(elements[name].find("origin"), f"{path}: joint {name!r}")
        hangs[name] = on, at
        links[end_of(elements[name], "child")] = hangs[name] if pairs[name] == "fixed" else (
            name, pin.SE3.Identity())
    return hangs


def urdf_order(robot: ET.Element) -> list[str]:
    """Return the joints of a URDF, fixed ones too, in the order of Pinocchio's reader."""
    above: dict[str, list[ET.Element]] = {}
    for joint in sorted(robot.findall("joint"), key=lambda j: j.get("name", "").encode(),
                        reverse=True):
        above.setdefault(end_of(joint, "parent"), []).append(joint)
    children = {end_of(joint, "child") for joint in robot.findall("joint")}
    todo = [joint for link, joints in above.items() if link not in children for joint in joints]
    names = []
    while todo:
        joint = todo.pop()
        names.append(joint.get("name", ""))
        todo += above.get(end_of(joint, "child"), [])
    return names


def _ordered(above: Mapping[str, str], order: Sequence[str], where: str) -> list[str]:
    """Return the joints that move, by the one that each hangs on, in the given order."""
    wanted = {name: k for k, name in enumerate(order)}
    if len(wanted) < len(order):
        raise MechanismFileError(f"{where}: order: a joint is named twice")
    for name in order:
        if name not in above:
            raise MechanismFileError(f"{where}: order: no joint that moves is named {name!r}; "
                                     f"{suggestion(name, above)}")
    names = sorted(above, key=lambda name: wanted.get(name, -1))
    positions = {name: k for k, name in enumerate(names)}
    for name in names:
        if positions.get(above[name], -1) > positions[name]:
            raise MechanismFileError(f"{where}: order: {name!r} comes before {above[name]!r}, on "
                                     "which it hangs")
    return names


def joint_axes(
    pair: Pair, element: ET.Element, refined: JointRefinement | None, where: str
) -> tuple[Array, Array]:
    """Return the unit axes of a tree joint: the mechanism file's, else the URDF's, else default."""
    tag = element.find("axis")
    if refined is not None and refined.axis is not None:
        axis = refined.axis
    elif tag is not None and pair.uses_axis:
        axis = numbers(tag, "xyz", 3, where)
        if math.hypot(*axis) < 1e-12:
            raise MechanismFileError(f"{where}: <axis> is zero")
    elif pair.uses_axis and element.get("type") != "floating":
        axis = np.array(URDF_AXIS)
    else:
        axis = np.array(pair.axis)
    axis2 = refined.axis2 if refined and refined.axis2 is not None else np.array([0.0, 1.0, 0.0])
    axis = unit(axis)
    kind = refined.type if refined is not None else None
    source = refined.where if refined and refined.where else where
    if element.get("type") == "planar" and kind not in (None, "planar"):
        normal = numbers(tag, "xyz", 3, where) if tag is not None else np.array(URDF_AXIS)
        cosine, turns = abs(float(axis @ unit(normal))), kind == "revolute"
        if abs(cosine - turns) > 1e-9:
            raise MechanismFileError(
                f"{source} is planar in the URDF: a {kind} pair in it must have its axis "
                f"{'about' if turns else 'square to'} the plane's normal; make it \"floating\" "
                "there")
    if pair.uses_axis2:
        axis2 = unit(axis2)
        if abs(axis @ axis2) > 1e-9:
            raise MechanismFileError(
                f"{source}: the pins {axis} and {axis2} of a universal joint must be perpendicular"
            )
    return axis, axis2


def stated_limits(element: ET.Element, nq: int, nv: int) -> dict[str, Array]:
    """Return what a URDF states for a joint's arrays in `pin.Model`, in the order of `addJoint`.

    A number holds for every coordinate; positions of several, or of a continuous joint, have none.
    """
    limit, dynamics, kind = element.find("limit"), element.find("dynamics"), element.get("type")

    def scalar(source: ET.Element | None, key: str, default: float) -> float:
        value = float(source.get(key, default)) if source is not None else default
        return value if abs(value) < UNBOUNDED else math.copysign(math.inf, value)

    effort, velocity = scalar(limit, "effort", math.inf), scalar(limit, "velocity", math.inf)
    bounded = nq == 1 and kind != "continuous"
    stated = limit is not None and kind in ("revolute", "prismatic")
    free = 0.0 if stated else math.inf  # URDF's defaults
    lower = scalar(limit, "lower", 0.0 - free) if bounded else -math.inf
    upper = scalar(limit, "upper", free) if bounded else math.inf
    friction, damping = scalar(dynamics, "friction", 0.0), scalar(dynamics, "damping", 0.0)
    return {
        "lowerEffortLimit": np.full(nv, -effort), "upperEffortLimit": np.full(nv, effort),
        "lowerVelocityLimit": np.full(nv, -velocity), "upperVelocityLimit": np.full(nv, velocity),
        "lowerPositionLimit": np.full(nq, lower), "upperPositionLimit": np.full(nq, upper),
        "positionLimitMargin": np.zeros(nq), "lowerDryFrictionLimit": np.full(nv, -friction),
        "upperDryFrictionLimit": np.full(nv, friction), "damping": np.full(nv, damping)}


def own_entries(model: pin.Model, joint: int, key: str) -> slice:
    """Return the slice of a joint in an array that a number of `NUMBERS` sets."""
    of_q = key in ("lower", "upper")
    at, count = ((model.idx_qs, model.nqs) if of_q else (model.idx_vs, model.nvs))
    return slice(at[joint], at[joint] + count[joint])


def _put_numbers(model: pin.Model, refinements: Mapping[str, JointRefinement]) -> Array:
    """Put the numbers of a mechanism file into a model.

    Returns:
        (nv,) slip speeds, NaN where there are none.
    """
    slip_speeds = np.full(model.nv, math.nan)
    for name, refined in refinements.items():
        joint = model.getJointId(name)
        for key, values in refined.numbers.items():
            own = own_entries(model, joint, key)
            count = own.stop - own.start
            if values.size not in (1, count):
                raise MechanismFileError(
                    f"{refined.where}: {key} has {values.size} numbers; give one for all, or one "
                    f"for each of the {count} coordinate(s) of the joint")
            if key == "slip_speed":
                slip_speeds[own] = values
            for array, factor in NUMBERS[key].items():
                getattr(model, array)[own] = factor * values
        if not refined.numbers.keys() & LIMITS.keys():
            continue
        for kind, key in (("Position", "lower"), ("Velocity", "velocity"), ("Effort", "effort")):
            own = own_entries(model, joint, key)
            if np.any(getattr(model, f"lower{kind}Limit")[own]
                      > getattr(model, f"upper{kind}Limit")[own]):
                raise MechanismFileError(
                    f"{refined.where}: a lower {kind.lower()} limit is above the upper one")
    return slip_speeds


def _mimics(
    robot: ET.Element, pairs: Mapping[str, str], path: Path, faults: Faults
) -> tuple[Closure, ...]:
    mimics = []
    for joint in robot.findall("joint"):
        mimic, name = joint.find("mimic"), joint.get("name", "")
        if mimic is None:
            continue
        source, where = mimic.get("joint", ""), f"{path}: joint {name!r}"
        ratio = numbers(mimic, "multiplier", 1, where)[0] if "multiplier" in mimic.attrib else 1.0
        offset = numbers(mimic, "offset", 1, where)[0] if "offset" in mimic.attrib else 0.0
        if pairs[name] == "fixed":
            faults.note("fixed, its <mimic> has no effect", f"joint {name!r}")
        elif source not in pairs:
            faults.note("mimics a joint that does not exist, moves on its own",
                        f"joint {name!r} (of {source!r}, {suggestion(source, pairs)})")
        elif pairs[source] == "fixed" or source == name:
            faults.note("mimics a fixed joint or itself, moves on its own", f"joint {name!r}")
        else:
            mimics.append(Closure(f"mimic_{name}", COUPLING, joints=(source, name),
                                  numbers={"ratio": float(ratio), "offset": float(offset)}))
    return tuple(mimics)
