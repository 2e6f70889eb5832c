"""MuJoCo's actuators as drivers, its springs, and the key that is the guess."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatial_pin.formats.mjcf.tree import Reading, pose
from spatial_pin.mechanism.coordinates import rotation_vectors
from spatial_pin.numerics.linalg import Array

HOME = "home"  # the key that is the guess, if there is one

# ---------------------------------------------------------------- drivers


def read_drivers(reading: Reading, closures: list[dict[str, Any]]) -> dict[str, dict[str, str]]:
    """Return a driver for every joint that an actuator moves, by name of the actuator.

    Of joints that are coupled the first has one.
    """
    model, drivers = reading.model, {}
    joints = {place.name for place in reading.joints}
    driven: set[str] = set()
    for actuator in range(len(model.actuator_trntype)):  # some have several controls
        name = model.actuator(actuator).name
        joint, why = _driven_joint(reading, actuator, closures)
        if joint is not None and joint not in driven and _coupled({joint}, closures) & driven:
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
    reading: Reading, actuator: int, closures: list[dict[str, Any]]
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
        if len(joints) == 1 or (joints and joints <= _coupled(joints, closures)):
            return next(x.name for x in reading.joints if x.name in joints), ""
        return None, f"tendon {name!r} moves more than one coordinate"
    word = kind.name.removeprefix("mjTRN_").lower()
    return None, f"its transmission is of type {word}"


def _coupled(joints: set[str], closures: list[dict[str, Any]]) -> set[str]:
    """Return the joints that move with one of the given ones."""
    found, pairs = {min(joints)}, [set(c["joints"]) for c in closures if "joints" in c]
    while True:
        more = {j for pair in pairs if pair & found for j in pair}
        if more <= found:
            return found
        found |= more


def fixed_lengths(reading: Reading, tendon: int) -> dict[int, float]:
    """Return what each joint adds to the length of a fixed tendon; none of a spatial one."""
    model = reading.model
    found: dict[int, float] = {}
    for k in range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon]):
        if model.wrap_type[k] != int(reading.mujoco.mjtWrap.mjWRAP_JOINT):
            return {}
        joint = int(model.wrap_objid[k])
        found[joint] = found.get(joint, 0.0) + float(model.wrap_prm[k])
    return found


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
        if not reading.is_single(joint):
            reading.notices.append(f"joint {place.name!r}: a stiffness of several coordinates is "
                                   "left out")
            continue
        turns = model.jnt_type[joint] == reading.mujoco.mjtJoint.mjJNT_HINGE
        free = "free_angle" if turns else "free_length"
        at_rest = model.qpos_spring[model.jnt_qposadr[joint]]
        springs.append({"name": f"{place.name}_spring", "joint": place.name, free: float(at_rest),
                        "stiffness": float(model.jnt_stiffness[joint])})
    return springs


def _straight_tendon(reading: Reading, tendon: int) -> dict[str, Any] | None:
    """Return the spring between two sites that a tendon is; None for any other."""
    model = reading.model
    stiffness, damping = model.tendon_stiffness[tendon], model.tendon_damping[tendon]
    low, high = model.tendon_lengthspring[tendon]
    sites = straight_sites(reading, tendon)
    if not sites or low != high or not (stiffness or damping):
        return None
    name = model.tendon(tendon).name or f"tendon_{tendon}"
    reading.tendons.add(tendon)
    return {"name": name, "frames": site_frames(reading, name, sites),
            "stiffness": float(stiffness), "free_length": float(low),
            "damping": 0.0 if reading.is_off("DAMPER") else float(damping)}


def straight_sites(reading: Reading, tendon: int) -> list[int]:
    """Return the two sites of a straight tendon between bodies that can move; else none."""
    model = reading.model
    wraps = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    kinds, sites = model.wrap_type[wraps], [int(site) for site in model.wrap_objid[wraps]]
    if len(sites) != 2 or np.any(kinds != int(reading.mujoco.mjtWrap.mjWRAP_SITE)):
        return []
    bodies = {int(model.body_weldid[model.site_bodyid[site]]) for site in sites}
    return sites if len(bodies) == 2 else []


def site_frames(reading: Reading, name: str, sites: list[int]) -> list[str]:
    """Return the links that stand for sites; those of sites without a name are added."""
    model = reading.model
    return [reading.sites.get(site) or reading.urdf.frame(
        f"{name}_{k}", reading.links[model.site_bodyid[site]],
        pose(model.site_pos[site], model.site_quat[site])) for k, site in enumerate(sites, start=1)]


def read_guess(reading: Reading) -> dict[str, Any]:
    """Return the configuration of the key "home", else of the first key, else the file's pose."""
    model = reading.model
    names = [model.key(k).name for k in range(model.nkey)]
    key = names.index(HOME) if HOME in names else 0
    q = model.key_qpos[key] if names else model.qpos0
    guess = {place.name: _value(reading, joint, q) for joint, place in enumerate(reading.joints)}
    return {name: x for name, x in guess.items() if names or np.any(x)}


def _value(reading: Reading, joint: int, q: Array) -> Any:
    at = int(reading.model.jnt_qposadr[joint])
    if reading.is_single(joint):
        return float(q[at])
    is_free = reading.model.jnt_type[joint] == reading.mujoco.mjtJoint.mjJNT_FREE
    turn = at + 3 if is_free else at
    vector = rotation_vectors(q[turn:turn + 4][[1, 2, 3, 0]][None])[0]
    return [*q[at:turn].tolist(), *vector.tolist()]
