"""MJCF, MuJoCo's models, read through the `mujoco` package: closures, drivers and springs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import shown
from spatial_pin.formats.importers import Imported, Request
from spatial_pin.formats.mjcf.compiling import compiled, some
from spatial_pin.formats.mjcf.model_tree import (
    MjcfReading,
    fixed_lengths,
    moves_joint,
    pose,
    shift,
    site_frames,
    straight_sites,
)
from spatial_pin.formats.urdf.elements import fresh, go_on
from spatial_pin.mechanism.coordinates import rotation_vectors
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

SAME_SHAPE = 1e-3  # of a distance: anchors of the same two points, written with a few digits
TORQUE_SCALE = 10  # of the data of a weld: the weight of its turns, 0 for a ball
TURN_ROW, SLIDE_ROW = 3, 2  # equations of a weld: no turn about its z, no slide along it
HOME = "home"  # the key that is the guess, if there is one
UNNAMED = "MuJoCo Model"  # what MuJoCo calls a model without a name


class EqualityEnd(NamedTuple):
    """An end of a closure: body, frame there, and its link, "" where the file has no site."""

    body: int
    at: pin.SE3
    link: str = ""


Connect = tuple[int, str, tuple[EqualityEnd, EqualityEnd]]  # a ball: its number, name and ends


def read_closures(reading: MjcfReading, where: str) -> list[dict[str, Any]]:
    """Return the loops of a model, and add their frames to its tree."""
    model, closures = reading.model, []
    connects: dict[frozenset[int], list[Connect]] = {}
    off = reading.is_off("EQUALITY") or reading.is_off("CONSTRAINT")
    active = [eq for eq in range(model.neq) if model.eq_active0[eq] and not off]
    reading.notices += [f"equality {_called(reading, eq)} is not active: left out"
                        for eq in range(model.neq) if eq not in active]
    for eq in active:
        kind, name = _kind(reading, eq), model.equality(eq).name
        if kind in ("joint", "tendon"):
            closures.append((eq, _coupling(reading, eq, name) if kind == "joint" else
                             _tendon_coupling(reading, eq, name, where)))
            continue
        if kind not in ("connect", "weld"):
            raise MechanismFileError(
                f"{where}: equality {_called(reading, eq)} is of type {kind}, for which there is "
                "no closure; take it out or set active=\"false\"; "
                f"{go_on(model.equality(eq).name or kind)}")
        ends = _ends(reading, eq, kind)
        rigid = frozenset(int(model.body_weldid[end.body]) for end in ends)
        if len(rigid) == 1:
            reading.notices.append(f"equality {_called(reading, eq)} joins two bodies that are "
                                   "fixed to each other: left out")
        elif kind == "weld":
            holds = "weld" if model.eq_data[eq, TORQUE_SCALE] else "spherical"
            closures.append((eq, _closure(reading, name, holds, *ends)))
        else:
            connects.setdefault(rigid, []).append((eq, name, ends))
    for group in connects.values():
        closures += [(group[0][0], closure) for closure in _balls(reading, group)]
    closures.sort(key=lambda pair: pair[0])  # as in the file
    taken: set[str] = set()
    return [{**closure, "name": fresh(closure["name"], taken)} for _, closure in closures]


def _kind(reading: MjcfReading, eq: int) -> str:
    name: str = reading.mujoco.mjtEq(reading.model.eq_type[eq]).name
    return name.removeprefix("mjEQ_").lower()


def _called(reading: MjcfReading, eq: int) -> str:
    name = reading.model.equality(eq).name
    return repr(name) if name else f"number {eq} (a {_kind(reading, eq)} without name)"


def _ends(reading: MjcfReading, eq: int, kind: str) -> tuple[EqualityEnd, EqualityEnd]:
    """Return the ends of a connect or weld."""
    model, data = reading.model, reading.model.eq_data[eq]
    one, two = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
    if model.eq_objtype[eq] == reading.mujoco.mjtObj.mjOBJ_SITE:
        return _site(reading, one), _site(reading, two)
    if kind == "connect":
        return EqualityEnd(one, shift(data[:3])), EqualityEnd(two, shift(data[3:6]))
    return EqualityEnd(one, pose(data[3:6], data[6:10])), EqualityEnd(two, shift(data[:3]))


def _site(reading: MjcfReading, site: int) -> EqualityEnd:
    model = reading.model
    at = pose(model.site_pos[site], model.site_quat[site])
    return EqualityEnd(int(model.site_bodyid[site]), at, reading.sites.get(site, ""))


def _closure(reading: MjcfReading, name: str, kind: str, *ends: EqualityEnd) -> dict[str, Any]:
    links = [reading.links[end.body] for end in ends]
    name = name or "_".join(links)
    frames = [end.link or reading.urdf.frame(f"{name}_{k}", link, end.at)
              for k, (link, end) in enumerate(zip(links, ends, strict=True), start=1)]
    return {"name": name, "type": kind, "frames": frames}


def _balls(reading: MjcfReading, group: list[Connect]) -> list[dict[str, Any]]:
    """Return the closures of all connects between two rigid bodies.

    Two points of an axis are a hinge; three that are not on a line are a weld.
    """
    _, name, ends = group[0]
    points = [np.array([end.at.translation]) for end in ends]
    rigid = reading.model.body_weldid
    for _, _, others in group[1:]:
        for k, end in enumerate(ends):  # the point that is fixed to the same body, in its frame
            other = next(x for x in others if rigid[x.body] == rigid[end.body])
            moved = _in_rigid(reading, end.body).inverse() * _in_rigid(reading, other.body)
            points[k] = np.vstack([points[k], moved.act(other.at.translation)])
    axes = [_axes(p - p[0]) for p in points]
    kinds = {kind for kind, _ in axes}
    gaps = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in points]
    fit = np.all(np.abs(gaps[0] - gaps[1]) <= SAME_SHAPE * gaps[0].max(initial=0.0))
    if kinds == {"spherical"} or len(kinds) > 1 or not fit:
        return [_closure(reading, own, "spherical", *both) for _, own, both in group]
    kind = kinds.pop()
    turned = [_turned(end, turn, kind) for end, (_, turn) in zip(ends, axes, strict=True)]
    return [_closure(reading, name, kind, *turned)]


def _turned(end: EqualityEnd, axes: Array, kind: str) -> EqualityEnd:
    """Return an end with axes (3, 3) of its own; of a hinge only z counts."""
    gap = end.at.rotation[:, 2] - axes[:, 2]
    if kind == "revolute" and end.link and np.abs(gap).max() < TOLERANCES.round_off:
        return end
    return EqualityEnd(end.body, pin.SE3(axes, end.at.translation))


def _in_rigid(reading: MjcfReading, body: int) -> pin.SE3:
    """Return the placement of a body in the first of the bodies that are fixed together with it."""
    model, placement = reading.model, pin.SE3.Identity()
    while body != model.body_weldid[body]:
        placement = pose(model.body_pos[body], model.body_quat[body]) * placement
        body = int(model.body_parentid[body])
    return placement


def _axes(points: Array) -> tuple[str, Array]:
    """Return what points (n, 3), the first at zero, hold together, and axes (3, 3) for it."""
    lengths = np.linalg.norm(points, axis=1)
    far = int(np.argmax(lengths))
    if lengths[far] == 0.0:
        return "spherical", np.eye(3)
    z = points[far] / lengths[far]
    across = points - np.outer(points @ z, z)
    widths = np.linalg.norm(across, axis=1)
    wide = int(np.argmax(widths))
    if widths[wide] <= SAME_SHAPE * lengths[far]:
        return "revolute", axes_from_z(z)
    x = across[wide] / widths[wide]
    return "weld", np.column_stack([x, np.cross(z, x), z])


def _coupling(reading: MjcfReading, eq: int, name: str) -> dict[str, Any]:
    """Return joint1 - ref1 = c0 + c1 (joint2 - ref2); without joint2, or c1, joint1 is held."""
    model, data = reading.model, reading.model.eq_data[eq]
    driven, driving = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
    joint, refs = reading.joints[driven], model.qpos0[model.jnt_qposadr]
    value = refs[driven] + data[0]
    if driving < 0 or not np.any(data[1:5]):
        return _held(reading, driven, float(value), name or f"{joint.name}_held")
    source = reading.joints[driving].name
    closure = {"name": name or f"{joint.name}_{source}", "type": "coupling",
               "joints": [source, joint.name]}
    if np.any(data[2:5]):
        moved = Polynomial(data[:5])(Polynomial([-refs[driving], 1.0])) + refs[driven]
        return {**closure, "function": {"polynomial": moved.trim().coef.tolist()}}
    return {**closure, "ratio": float(data[1]), "offset": float(value - data[1] * refs[driving])}


def _tendon_coupling(reading: MjcfReading, eq: int, name: str, where: str) -> dict[str, Any]:
    """Return a coupling, rope or distance: length1 - rest1 = c0 + c1 (length2 - rest2)."""
    model, data = reading.model, reading.model.eq_data[eq]
    first, second = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
    distance = _distance(reading, eq, name or f"tendon_{first}")
    if distance is not None:
        return distance
    terms = fixed_lengths(reading, first)
    rest = model.tendon_length0[first] + data[0]
    if second >= 0:
        rest -= data[1] * model.tendon_length0[second]
        for joint, weight in fixed_lengths(reading, second).items():
            terms[joint] = terms.get(joint, 0.0) - data[1] * weight
    terms = {joint: weight for joint, weight in terms.items() if weight}
    if not terms or (second >= 0 and np.any(data[2:5])):
        raise MechanismFileError(
            f"{where}: equality {_called(reading, eq)} of tendons is neither a coupling of joints "
            "nor a rope over sites, for which there are closures; take it out or set "
            "active=\"false\"")
    (driven, weight), *others = terms.items()
    if len(others) > 1:
        joints = [reading.joints[joint].name for joint in terms]
        return {"name": name or "_".join(joints), "type": "coupling", "joints": joints,
                "ratios": list(map(float, terms.values())), "offset": float(-rest)}
    if not others:
        name = name or f"{reading.joints[driven].name}_held"
        return _held(reading, driven, float(rest / weight), name)
    (driving, other), = others
    joints = [reading.joints[driving].name, reading.joints[driven].name]
    return {"name": name or "_".join(reversed(joints)), "type": "coupling", "joints": joints,
            "ratio": float(-other / weight), "offset": float(rest / weight)}


def _distance(reading: MjcfReading, eq: int, name: str) -> dict[str, Any] | None:
    """Return the distance, or rope, of a straight tendon of constant or equal length; else None."""
    model, data = reading.model, reading.model.eq_data[eq]
    first, second = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
    sites, rest = straight_sites(reading, first), float(model.tendon_length0[first])
    if not sites or (len(sites) > 2 and second >= 0):
        return None
    closure = {"name": name, "type": "rope" if len(sites) > 2 else "distance",
               "frames": site_frames(reading, name, sites)}
    if second < 0:
        return {**closure, "length": rest + float(data[0])} if rest + data[0] > 0.0 else None
    others, other = straight_sites(reading, second), float(model.tendon_length0[second])
    same = abs(rest + data[0] - other) <= TOLERANCES.tight * max(rest, other)
    if len(others) != 2 or data[1] != 1.0 or np.any(data[2:5]) or not same:
        return None
    return {**closure, "length_between": site_frames(reading, f"{name}_other", others)}


def _held(reading: MjcfReading, joint: int, value: float, name: str) -> dict[str, Any]:
    """Return the one equation that holds a coordinate: one of a weld whose z is the axis."""
    follower, model = reading.joints[joint], reading.model
    turns = model.jnt_type[joint] == reading.mujoco.mjtJoint.mjJNT_HINGE
    axes = pin.SE3(axes_from_z(follower.axis), np.zeros(3))
    moved = (pin.SE3(pin.exp3(value * follower.axis), np.zeros(3)) if turns
             else shift(value * follower.axis))
    frames = [reading.urdf.frame(f"{name}_1", follower.parent, follower.placement * moved * axes),
              reading.urdf.frame(f"{name}_2", follower.child, axes)]
    return {"name": name, "type": "weld", "frames": frames,
            "equations": [TURN_ROW if turns else SLIDE_ROW]}


def read_drivers(reading: MjcfReading, closures: list[dict[str, Any]]) -> dict[str, dict[str, str]]:
    """Return a driver for every joint that an actuator moves, and for the first of coupled ones."""
    model, drivers = reading.model, {}
    joints = {placed.name for placed in reading.joints}
    driven: set[str] = set()
    for actuator in range(len(model.actuator_trntype)):  # some have several controls
        name = model.actuator(actuator).name
        joint, why = _driven_joint(reading, actuator, closures)
        if joint is not None and joint not in driven and joint in _coupled(driven, closures):
            joint, why = None, f"joint {joint!r} is coupled to one that has a driver"
        if joint is None:
            called = repr(name) if name else f"number {actuator}"
            reading.notices.append(f"actuator {called} is no driver: {why}")
        elif joint not in driven:
            driven.add(joint)
            taken = name in drivers or (name in joints and name != joint)
            drivers[joint if taken or not name else name] = {"joint": joint}
    return drivers


def _driven_joint(
    reading: MjcfReading, actuator: int, closures: list[dict[str, Any]]
) -> tuple[str | None, str]:
    """Return the joint that an actuator moves, or None and why it is none."""
    model, kinds = reading.model, reading.mujoco.mjtTrn
    kind = kinds(model.actuator_trntype[actuator])
    target = int(model.actuator_trnid[actuator, 0])
    if kind in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
        joint = reading.joints[target].name
        if reading.is_single(target):
            return joint, ""
        return None, f"joint {joint!r} has several coordinates"
    if kind == kinds.mjTRN_TENDON:
        name = model.tendon(target).name
        joints = {reading.joints[joint].name for joint in fixed_lengths(reading, target)}
        if len(joints) == 1 or (joints and joints <= _coupled({min(joints)}, closures)):
            return next(x.name for x in reading.joints if x.name in joints), ""
        return None, f"tendon {name!r} moves more than one coordinate"
    word = kind.name.removeprefix("mjTRN_").lower()
    return None, f"its transmission is of type {word}"


def _coupled(joints: set[str], closures: list[dict[str, Any]]) -> set[str]:
    """Return the joints that are coupled to the given ones, and to no others that are free."""
    group, tied = set(joints), [set(c["joints"]) for c in closures if "joints" in c]
    while True:
        more = {j for ends in tied if len(ends - group) == 1 for j in ends}
        if more <= group:
            return group
        group |= more


def read_springs(reading: MjcfReading) -> list[dict[str, Any]]:
    """Return the springs of joints and of tendons that are straight."""
    if reading.is_off("SPRING"):
        return []
    model, springs = reading.model, list[dict[str, Any]]()
    for tendon in range(model.ntendon):
        stiffness, damping = model.tendon_stiffness[tendon], model.tendon_damping[tendon]
        low, high = model.tendon_lengthspring[tendon]
        sites = straight_sites(reading, tendon)
        if len(sites) == 2 and low == high and (stiffness or damping):
            reading.tendons.add(tendon)
            name = model.tendon(tendon).name or f"tendon_{tendon}"
            springs.append({"name": name, "frames": site_frames(reading, name, sites),
                            "stiffness": float(stiffness), "free_length": float(low),
                            "damping": 0.0 if reading.is_off("DAMPER") else float(damping)})
    for joint, placed in enumerate(reading.joints):
        if not model.jnt_stiffness[joint]:
            continue
        if not reading.is_single(joint):
            reading.notices.append(f"joint {placed.name!r}: a stiffness of several coordinates is "
                                   "left out")
            continue
        turns = model.jnt_type[joint] == reading.mujoco.mjtJoint.mjJNT_HINGE
        free = "free_angle" if turns else "free_length"
        at_rest = model.qpos_spring[model.jnt_qposadr[joint]]
        springs.append({"name": f"{placed.name}_spring", "joint": placed.name, free: float(at_rest),
                        "stiffness": float(model.jnt_stiffness[joint])})
    return springs


def read_guess(reading: MjcfReading) -> dict[str, Any]:
    """Return the configuration of the key "home", else of the first key, else the file's pose."""
    model = reading.model
    names = [model.key(k).name for k in range(model.nkey)]
    key = names.index(HOME) if HOME in names else 0
    q = model.key_qpos[key] if names else model.qpos0
    guess: dict[str, Any] = {}
    for joint, placed in enumerate(reading.joints):
        at = int(model.jnt_qposadr[joint])
        turn = at + 3 * int(model.jnt_type[joint] == reading.mujoco.mjtJoint.mjJNT_FREE)
        value: Any = float(q[at])
        if not reading.is_single(joint):
            vector = rotation_vectors(q[turn:turn + 4][[1, 2, 3, 0]][None])[0]
            value = [*q[at:turn].tolist(), *vector.tolist()]
        if names or np.any(value):
            guess[placed.name] = value
    return guess


def read(request: Request) -> Imported:
    """Read an MJCF file."""
    model, meshes, massless, notices = compiled(request.path, request.trust, request.without)
    import mujoco

    names = model.names
    text = names[:names.index(b"\0")].decode()
    name = text if text and text != UNNAMED else request.path.stem
    reading = MjcfReading(mujoco, model, meshes, massless, name)
    closures = read_closures(reading, shown(request.path))
    content: dict[str, Any] = {
        "name": name,
        "gravity": [0.0] * 3 if reading.is_off("GRAVITY") else model.opt.gravity.tolist(),
        "order": [placed.name for placed in reading.joints], "joints": reading.refined,
        "closures": closures,
        "springs": read_springs(reading), "guess": read_guess(reading),
    }
    if reading.model.nu:
        content["drivers"] = read_drivers(reading, closures)
    notices += [*reading.notices, *_unread_of(reading)]
    return Imported(reading.urdf.robot, content, tuple(notices))


def _unread_of(reading: MjcfReading) -> Iterator[str]:
    """Yield a notice for everything of a model that acts on it and is not read."""
    model = reading.model
    for tendon in range(model.ntendon):
        lost = {} if tendon in reading.tendons else {
            "tendon_stiffness": "stiffness", "tendon_damping": "damping"}
        lost |= {"tendon_frictionloss": "friction", "tendon_limited": "range",
                 "tendon_armature": "armature"}
        if words := _nonzero(reading, tendon, lost):
            name = repr(model.tendon(tendon).name or tendon)
            yield f"tendon {name}: its {', '.join(words)} is left out"
    yield from (f"flex number {k}: its elasticity is left out" for k in range(model.nflex))
    for actuator in range(len(model.actuator_trntype)):
        lost = {"actuator_dampingpoly": "damping of higher order"}
        if not (moves_joint(reading)[actuator]
                and reading.is_single(model.actuator_trnid[actuator, 0])):
            lost = {"actuator_armature": "armature", "actuator_damping": "damping", **lost}
        if words := _nonzero(reading, actuator, lost):
            name = repr(model.actuator(actuator).name or actuator)
            yield f"actuator {name}: its {', '.join(words)} is left out"
    floats = [model.body(b).name for b in np.flatnonzero(model.body_gravcomp)]
    if floats:
        yield f"the gravity compensation of bodies ({some(floats)}) is left out"
    if model.opt.density or model.opt.viscosity:
        yield "the fluid around the bodies (density, viscosity) is left out"
    for joint, placed in enumerate(reading.joints):
        of_dof = {"dof_dampingpoly": "damping of higher order"}
        of_joint = {"jnt_stiffnesspoly": "stiffness of higher order",
                    "jnt_springyield": "yielding spring"}
        words = [*_nonzero(reading, int(model.jnt_dofadr[joint]), of_dof),
                 *_nonzero(reading, joint, of_joint)]
        if words:
            yield f"joint {placed.name!r}: its {', '.join(words)} is left out"


def _nonzero(reading: MjcfReading, row: int, words: dict[str, str]) -> list[str]:
    """Return the words of the arrays of a model; older MuJoCo lacks some."""
    arrays = {key: getattr(reading.model, key, None) for key in words}
    return [words[key] for key, x in arrays.items() if x is not None and np.any(x[row])]
