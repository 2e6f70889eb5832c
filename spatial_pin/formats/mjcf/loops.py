"""MuJoCo's equalities, actuators, springs and keys to what a mechanism file says beside a tree."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.mjcf.tree import Reading, pose, shift
from spatial_pin.formats.urdf_text import unique
from spatial_pin.linalg import Array
from spatial_pin.mechanism.configuration import rotation_vectors
from spatial_pin.mechanism.pairs import axes_from_z

HOME = "home"  # the key that is the guess, if there is one
SAME_SHAPE = 1e-3  # of a distance: anchors of the same two points, written with a few digits
ALIGNED = 1e-14  # of two unit vectors, by round-off
TORQUE_SCALE = 10  # of the data of a weld: the weight of its turns, 0 for a ball
TURN, SLIDE = 3, 2  # equations of a weld: no turn about its z, no slide along it


class End(NamedTuple):
    """One end of a closure: number of its body, its frame there, and the link that is this frame.

    The link is "" where the file has no site for it.
    """

    body: int
    at: pin.SE3
    link: str = ""


class Connect(NamedTuple):
    """A ball between two bodies: its number, name and ends."""

    eq: int
    name: str
    ends: tuple[End, End]


def read_closures(reading: Reading, where: str) -> list[dict[str, Any]]:
    """Return the loops of a model, and add their frames to its tree.

    Args:
        reading: the model.
        where: the file, for errors.

    Raises:
        MechanismFileError: an equality has no exact counterpart; it is named.
    """
    model, closures = reading.model, []
    connects: dict[frozenset[int], list[Connect]] = {}
    for eq in _active(reading):
        kind, name = _kind(reading, eq), model.equality(eq).name
        if kind == "joint":
            closures.append((eq, _coupling(reading, eq, name, where)))
            continue
        if kind not in ("connect", "weld"):
            raise MechanismFileError(
                f"{where}: equality {_called(reading, eq)} is of type {kind}, for which there is "
                "no closure; take it out or set active=\"false\"")
        ends = _ends(reading, eq, kind)
        rigid = frozenset(int(model.body_weldid[end.body]) for end in ends)
        if len(rigid) == 1:
            reading.notices.append(f"equality {_called(reading, eq)} joins two bodies that are "
                                   "fixed to each other: left out")
        elif kind == "weld":
            holds = "weld" if model.eq_data[eq, TORQUE_SCALE] else "spherical"
            closures.append((eq, _closure(reading, name, holds, *ends)))
        else:
            connects.setdefault(rigid, []).append(Connect(eq, name, ends))
    for group in connects.values():
        closures += [(group[0].eq, closure) for closure in _balls(reading, group)]
    closures.sort(key=lambda pair: pair[0])  # as in the file
    return _uniquely_named([closure for _, closure in closures])


def _active(reading: Reading) -> list[int]:
    """Return the numbers of the equalities that hold; tell the others."""
    model = reading.model
    off = reading.is_off("EQUALITY") or reading.is_off("CONSTRAINT")
    active = [eq for eq in range(model.neq) if model.eq_active0[eq] and not off]
    reading.notices += [f"equality {_called(reading, eq)} is not active: left out"
                        for eq in range(model.neq) if eq not in active]
    return active


def _kind(reading: Reading, eq: int) -> str:
    name: str = reading.mujoco.mjtEq(reading.model.eq_type[eq]).name
    return name.removeprefix("mjEQ_").lower()


def _called(reading: Reading, eq: int) -> str:
    name = reading.model.equality(eq).name
    return repr(name) if name else f"number {eq} (a {_kind(reading, eq)} without name)"


def _uniquely_named(closures: list[dict[str, Any]]) -> list[dict[str, Any]]:
    taken: list[str] = []
    for closure in closures:
        closure["name"] = unique(closure["name"], taken)
        taken.append(closure["name"])
    return closures


def _ends(reading: Reading, eq: int, kind: str) -> tuple[End, End]:
    """Return the ends of a connect or weld."""
    model, data = reading.model, reading.model.eq_data[eq]
    one, two = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
    if model.eq_objtype[eq] == reading.mujoco.mjtObj.mjOBJ_SITE:
        return _site(reading, one), _site(reading, two)
    if kind == "connect":
        return End(one, shift(data[:3])), End(two, shift(data[3:6]))
    return End(one, pose(data[3:6], data[6:10])), End(two, shift(data[:3]))


def _site(reading: Reading, site: int) -> End:
    model = reading.model
    return End(int(model.site_bodyid[site]), pose(model.site_pos[site], model.site_quat[site]),
               reading.sites.get(site, ""))


def _closure(reading: Reading, name: str, kind: str, *ends: End) -> dict[str, Any]:
    links = [reading.links[end.body] for end in ends]
    name = name or "_".join(links)
    frames = [end.link or reading.urdf.frame(f"{name}_{k}", link, end.at)
              for k, (link, end) in enumerate(zip(links, ends, strict=True), start=1)]
    return {"name": name, "type": kind, "frames": frames}


# ---------------------------------------------------------------- balls, hinges of two balls


def _balls(reading: Reading, group: list[Connect]) -> list[dict[str, Any]]:
    """Return the closures of all connects between two rigid bodies.

    Two points of an axis are a hinge; three that are not on a line are a weld. Points whose
    distances differ between the bodies stay what they are.
    """
    first, *others = group
    points = [np.array([end.at.translation]) for end in first.ends]
    for other in others:
        moved = [_seen_from(reading, end.body, other.ends) for end in first.ends]
        points = [np.vstack([p, q]) for p, q in zip(points, moved, strict=True)]
    axes = [_axes(p - p[0]) for p in points]
    kinds = {kind for kind, _ in axes}
    if kinds == {"spherical"} or len(kinds) > 1 or not _is_same_shape(*points):
        return [_closure(reading, c.name, "spherical", *c.ends) for c in group]
    kind = kinds.pop()
    ends = [_turned(end, turn, kind) for end, (_, turn) in zip(first.ends, axes, strict=True)]
    return [_closure(reading, first.name, kind, *ends)]


def _turned(end: End, axes: Array, kind: str) -> End:
    """Return an end with axes (3, 3) of its own; of a hinge only z counts."""
    gap = end.at.rotation[:, 2] - axes[:, 2]
    if kind == "revolute" and end.link and np.abs(gap).max() < ALIGNED:
        return end
    return End(end.body, pin.SE3(axes, end.at.translation))


def _seen_from(reading: Reading, body: int, ends: tuple[End, End]) -> Array:
    """Return the point (3,) of that of two ends which is fixed to a body, in the body's frame."""
    model = reading.model
    end = next(e for e in ends if model.body_weldid[e.body] == model.body_weldid[body])
    seen: Array = (_in_rigid(reading, body).inverse() * _in_rigid(reading, end.body)).act(
        end.at.translation)
    return seen


def _in_rigid(reading: Reading, body: int) -> pin.SE3:
    """Return the placement of a body in the first of the bodies that are fixed together with it."""
    model, placement = reading.model, pin.SE3.Identity()
    while body != model.body_weldid[body]:
        placement = pose(model.body_pos[body], model.body_quat[body]) * placement
        body = int(model.body_parentid[body])
    return placement


def _is_same_shape(first: Array, second: Array) -> bool:
    """Whether points (n, 3) of one body can all be on those of the other."""
    gaps = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in (first, second)]
    return bool(np.all(np.abs(gaps[0] - gaps[1]) <= SAME_SHAPE * gaps[0].max(initial=0.0)))


def _axes(points: Array) -> tuple[str, Array]:
    """Return what points (n, 3), the first at zero, hold together, and axes (3, 3) for it."""
    lengths = np.linalg.norm(points, axis=1)
    far = int(np.argmax(lengths))
    if lengths[far] == 0.0:
        return "spherical", np.eye(3)
    z = points[far] / lengths[far]
    beside = points - np.outer(points @ z, z)
    widths = np.linalg.norm(beside, axis=1)
    wide = int(np.argmax(widths))
    if widths[wide] <= SAME_SHAPE * lengths[far]:
        return "revolute", axes_from_z(z)
    x = beside[wide] / widths[wide]
    return "weld", np.column_stack([x, np.cross(z, x), z])


# ---------------------------------------------------------------- couplings


def _coupling(reading: Reading, eq: int, name: str, where: str) -> dict[str, Any]:
    """Return joint1 - ref1 = c0 + c1 (joint2 - ref2); without joint2, or c1, joint1 is held."""
    model, data = reading.model, reading.model.eq_data[eq]
    driven, driving = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
    place, refs = reading.joints[driven], model.qpos0[model.jnt_qposadr]
    value = refs[driven] + data[0]
    if driving < 0 or not np.any(data[1:5]):
        return _held(reading, driven, float(value), name or f"{place.name}_held")
    source = reading.joints[driving].name
    if np.any(data[2:5]):
        raise MechanismFileError(
            f"{where}: equality {_called(reading, eq)}: {place.name!r} is a polynomial of "
            f"higher order of {source!r} (polycoef {data[:5].tolist()}); a coupling is linear")
    return {"name": name or f"{place.name}_{source}", "type": "coupling",
            "joints": [source, place.name], "ratio": float(data[1]),
            "offset": float(value - data[1] * refs[driving])}


def _held(reading: Reading, joint: int, value: float, name: str) -> dict[str, Any]:
    """Return the one equation that holds a coordinate: one of a weld whose z is the axis."""
    place, model = reading.joints[joint], reading.model
    turns = model.jnt_type[joint] == reading.mujoco.mjtJoint.mjJNT_HINGE
    axes = pin.SE3(axes_from_z(place.axis), np.zeros(3))
    moved = (pin.SE3(pin.exp3(value * place.axis), np.zeros(3)) if turns
             else shift(value * place.axis))
    frames = [reading.urdf.frame(f"{name}_1", place.parent, place.placement * moved * axes),
              reading.urdf.frame(f"{name}_2", place.child, axes)]
    return {"name": name, "type": "weld", "frames": frames,
            "equations": [TURN if turns else SLIDE]}


# ---------------------------------------------------------------- drivers


def read_drivers(
    reading: Reading, closures: list[dict[str, Any]]
) -> dict[str, dict[str, str]]:
    """Return a driver for every joint that an actuator moves, by name of the actuator."""
    model, drivers = reading.model, {}
    joints = {place.name for place in reading.joints}
    driven: set[str] = set()
    for actuator in range(len(model.actuator_trntype)):  # some have several controls
        name = model.actuator(actuator).name
        joint, why = _driven_joint(reading, actuator, closures)
        if joint is None:
            called = repr(name) if name else f"number {actuator}"
            reading.notices.append(f"actuator {called} is no driver: {why}")
        elif joint not in driven:
            driven.add(joint)
            taken = name in drivers or (name in joints and name != joint)
            drivers[joint if taken or not name else name] = {"joint": joint}
    return drivers


def _driven_joint(
    reading: Reading, actuator: int, closures: list[dict[str, Any]]
) -> tuple[str | None, str]:
    """Return the joint that an actuator moves, or None and why it is none."""
    model, kinds = reading.model, reading.mujoco.mjtTrn
    kind = kinds(model.actuator_trntype[actuator])
    target = int(model.actuator_trnid[actuator, 0])
    if kind in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
        joint = reading.joints[target].name
        single = model.jnt_type[target] in _single(reading)
        return (joint, "") if single else (None, f"joint {joint!r} has several coordinates")
    if kind == kinds.mjTRN_TENDON:
        name = model.tendon(target).name
        joints = _tendon_joints(reading, target)
        if len(joints) == 1 or (joints and joints <= _coupled(joints, closures)):
            return next(x.name for x in reading.joints if x.name in joints), ""
        return None, f"tendon {name!r} moves more than one coordinate"
    word = kind.name.removeprefix("mjTRN_").lower()
    return None, f"its transmission is of type {word}"


def _single(reading: Reading) -> tuple[int, int]:
    """Return the numbers of the kinds of joint with one coordinate: a hinge and a slide."""
    kinds = reading.mujoco.mjtJoint
    return int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)


def _tendon_joints(reading: Reading, tendon: int) -> set[str]:
    """Return the joints of a fixed tendon; none of a spatial one."""
    model = reading.model
    wraps = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    kinds, objects = model.wrap_type[wraps], model.wrap_objid[wraps]
    if np.any(kinds != reading.mujoco.mjtWrap.mjWRAP_JOINT):
        return set()
    return {reading.joints[j].name for j in objects}


def _coupled(joints: set[str], closures: list[dict[str, Any]]) -> set[str]:
    """Return the joints that move with one of the given ones."""
    found, pairs = {min(joints)}, [set(c["joints"]) for c in closures if "joints" in c]
    while True:
        more = {j for pair in pairs if pair & found for j in pair}
        if more <= found:
            return found
        found |= more


# ---------------------------------------------------------------- springs and guess


def read_springs(reading: Reading) -> list[dict[str, Any]]:
    """Return the springs of joints and of tendons that are straight."""
    if reading.is_off("SPRING"):
        return []
    model = reading.model
    springs = [x for k in range(model.ntendon) if (x := _straight_tendon(reading, k)) is not None]
    for joint, place in enumerate(reading.joints):
        if not model.jnt_stiffness[joint]:
            continue
        kind = model.jnt_type[joint]
        if kind not in _single(reading):
            reading.notices.append(f"joint {place.name!r}: a stiffness of several coordinates is "
                                   "left out")
            continue
        free = "free_angle" if kind == _single(reading)[0] else "free_length"
        at_rest = model.qpos_spring[model.jnt_qposadr[joint]]
        springs.append({"name": f"{place.name}_spring", "joint": place.name, free: float(at_rest),
                        "stiffness": float(model.jnt_stiffness[joint])})
    return springs


def _straight_tendon(reading: Reading, tendon: int) -> dict[str, Any] | None:
    """Return the spring between two sites that a tendon is; None for any other."""
    model = reading.model
    stiffness, damping = model.tendon_stiffness[tendon], model.tendon_damping[tendon]
    wraps = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    low, high = model.tendon_lengthspring[tendon]
    straight = (model.tendon_num[tendon] == 2 and low == high
                and np.all(model.wrap_type[wraps] == int(reading.mujoco.mjtWrap.mjWRAP_SITE)))
    if not straight or not (stiffness or damping):
        return None
    sites = [model.site(s) for s in model.wrap_objid[wraps]]
    if len({int(model.body_weldid[s.bodyid[0]]) for s in sites}) == 1:
        return None
    name = model.tendon(tendon).name or f"tendon_{tendon}"
    reading.tendons.add(tendon)
    frames = [reading.urdf.frame(f"{name}_{k}", reading.links[s.bodyid[0]], pose(s.pos, s.quat))
              for k, s in enumerate(sites, start=1)]
    return {"name": name, "frames": frames, "stiffness": float(stiffness),
            "damping": 0.0 if reading.is_off("DAMPER") else float(damping),
            "free_length": float(low)}


def read_guess(reading: Reading) -> dict[str, Any]:
    """Return the configuration of the key "home", else of the first key, else the file's pose."""
    model = reading.model
    names = [model.key(k).name for k in range(model.nkey)]
    key = names.index(HOME) if HOME in names else 0
    q = model.key_qpos[key] if names else model.qpos0
    guess = {place.name: _value(reading, joint, q) for joint, place in enumerate(reading.joints)}
    return {name: x for name, x in guess.items() if names or np.any(x)}


def _value(reading: Reading, joint: int, q: Array) -> Any:
    kinds, kind = reading.mujoco.mjtJoint, reading.model.jnt_type[joint]
    at = int(reading.model.jnt_qposadr[joint])
    if kind in _single(reading):
        return float(q[at])
    turn = at + 3 if kind == kinds.mjJNT_FREE else at
    vector = rotation_vectors(q[turn:turn + 4][[1, 2, 3, 0]][None])[0]
    return [*q[at:turn].tolist(), *vector.tolist()]
