"""MJCF, MuJoCo's models, read through the `mujoco` package: the model, its drivers and springs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from spatial_pin.formats.file_access import shown
from spatial_pin.formats.importers import Imported, Request
from spatial_pin.formats.mjcf.compiling import compiled, some
from spatial_pin.formats.mjcf.equalities import read_closures
from spatial_pin.formats.mjcf.model_tree import (
    MjcfReading,
    fixed_lengths,
    moves_joint,
    site_frames,
    straight_sites,
)
from spatial_pin.mechanism.coordinates import rotation_vectors
from spatial_pin.numerics.linalg import Array

HOME = "home"  # the key that is the guess, if there is one
UNNAMED = "MuJoCo Model"  # what MuJoCo calls a model without a name

# ---------------------------------------------------------------- drivers


def read_drivers(reading: MjcfReading, closures: list[dict[str, Any]]) -> dict[str, dict[str, str]]:
    """Return a driver for every joint that an actuator moves, by name of the actuator.

    Of joints that are coupled the first has one.
    """
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


# ---------------------------------------------------------------- springs and guess


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
    guess = {placed.name: _value(reading, joint, q) for joint, placed in enumerate(reading.joints)}
    return {name: x for name, x in guess.items() if names or np.any(x)}


def _value(reading: MjcfReading, joint: int, q: Array) -> Any:
    at = int(reading.model.jnt_qposadr[joint])
    if reading.is_single(joint):
        return float(q[at])
    is_free = reading.model.jnt_type[joint] == reading.mujoco.mjtJoint.mjJNT_FREE
    turn = at + 3 if is_free else at
    vector = rotation_vectors(q[turn:turn + 4][[1, 2, 3, 0]][None])[0]
    return [*q[at:turn].tolist(), *vector.tolist()]


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
