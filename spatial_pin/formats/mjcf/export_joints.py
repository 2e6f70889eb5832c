"""Tree joints as MuJoCo's hinges, slides, balls and free joints."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.export import tree_axes
from spatial_pin.formats.mjcf.writing import Writing, quaternion
from spatial_pin.formats.urdf.elements import UNBOUNDED, numbers_text
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.linalg import Array

UNSET = 1e300  # Pinocchio's largest number, or infinity, where there is no limit
HINGE, SLIDE, BALL, FREE = "hinge", "slide", "ball", "free"


class Part(NamedTuple):
    """A joint of MuJoCo.

    Attributes:
        name: of the joint.
        kind: its type.
        axis: (3,) in the joint's frame, zero for none.
    """

    name: str
    kind: str
    axis: Array


def parts_of(name: str, pair: str, axis: Array, axis2: Array) -> list[Part]:
    """Return the joints that a pair is made of, in order.

    Args:
        name: of the tree joint.
        pair: its kind.
        axis: (3,) its axis, if it has one.
        axis2: (3,) its second pin, if it has one.
    """
    x, y, z = np.eye(3)
    if pair in ("revolute", "prismatic"):
        return [Part(name, HINGE if pair == "revolute" else SLIDE, axis)]
    if pair in ("cylindrical", "screw"):
        turn = f"{name}.angle" if pair == "cylindrical" else name
        return [Part(turn, HINGE, axis), Part(f"{name}.slide", SLIDE, axis)]
    if pair == "universal":
        return [Part(f"{name}.first", HINGE, axis), Part(f"{name}.second", HINGE, axis2)]
    if pair == "planar":
        along, across, normal = axes_from_z(axis).T
        return [Part(f"{name}.x", SLIDE, along), Part(f"{name}.y", SLIDE, across),
                Part(f"{name}.angle", HINGE, normal)]
    if pair == "spherical":
        return [Part(name, BALL, np.zeros(3))]
    return [*(Part(f"{name}.{k}", SLIDE, e) for k, e in (("x", x), ("y", y), ("z", z))),
            Part(f"{name}.turn", BALL, np.zeros(3))]


def add_joints(writing: Writing, i: int, body: ET.Element, q: Array) -> None:
    """Add the joints of tree joint i to its body, and their values at q (nq,) to the key.

    Raises:
        SpatialPinError: a joint resists in each of its directions otherwise.
    """
    mech, model = writing.mechanism, writing.mechanism.model
    name, pair, at = model.names[i], mech.pairs[i - 1], model.idx_qs[i]
    own = q[at:at + model.nqs[i]]
    if pair == "floating" and model.parents[i] == 0:
        ET.SubElement(body, "joint", {"name": name, "type": FREE, **_resistances(mech, i, 0, 6)})
        placement = model.jointPlacements[i] * pin.SE3(
            pin.Quaternion(own[3:]).matrix(), own[:3])
        writing.home[name] = [*placement.translation, *quaternion(placement.rotation)]
        return
    axis, axis2, lead = tree_axes(mech, i)
    parts = parts_of(name, pair, axis, axis2)
    if pair == "screw":
        own = own[[0, 0]] * [1.0, lead / (2.0 * np.pi)]
    elements = add_parts(writing, body, parts, own)
    if pair == "screw":  # its slide is tied to the turn, which carries all else
        tie_screw(writing, parts, lead)
        elements, parts = elements[:1], parts[:1]
    for k, (element, part) in enumerate(zip(elements, parts, strict=True)):
        count = 3 if part.kind == BALL else 1
        element.attrib |= _resistances(mech, i, k, count)
        if count == 1:
            element.attrib |= _limits(mech, at + k, model.idx_vs[i] + k) | _spring(mech, part.name)


def add_parts(
    writing: Writing, body: ET.Element, parts: list[Part], values: Array
) -> list[ET.Element]:
    """Add joints to a body, and their values to the key; a ball, as the last, has four."""
    elements = []
    for k, part in enumerate(parts):
        attributes = {"name": part.name, "type": part.kind}
        if part.kind == BALL:
            writing.home[part.name] = values[k:][[3, 0, 1, 2]].tolist()
        else:
            attributes["axis"] = numbers_text(part.axis)
            writing.joints.add(part.name)
            writing.home[part.name] = [float(values[k])]
        elements.append(ET.SubElement(body, "joint", attributes))
    return elements


def tie_screw(writing: Writing, parts: list[Part], lead: float) -> None:
    """Tie the slide of a screw to its turn."""
    turn, slide = (part.name for part in parts)
    writing.tie(f"{turn}.lead", slide, turn, lead / (2.0 * np.pi))


def _resistances(mech: Mechanism, i: int, k: int, count: int) -> dict[str, str]:
    """Return damping, friction and armature of `count` coordinates of joint i from the k-th on."""
    model, own = mech.model, slice(mech.model.idx_vs[i] + k, mech.model.idx_vs[i] + k + count)
    table = {"damping": model.damping, "frictionloss": model.upperDryFrictionLimit,
             "armature": model.armature}
    for key, values in table.items():
        if np.ptp(values[own]) > 0.0:
            raise SpatialPinError(
                f"mechanism {mech.name!r}: joint {model.names[i]!r} has {key} "
                f"{values[own].tolist()}; a {mech.pairs[i - 1]} joint of MuJoCo has one number")
    at = own.start
    added = _spring_damping(mech, model.names[i], k) if count == 1 else 0.0
    found = {key: float(x[at]) for key, x in table.items()}
    found["damping"] += added
    return {key: repr(x) for key, x in found.items() if x}


def _limits(mech: Mechanism, at: int, v: int) -> dict[str, str]:
    model = mech.model
    found: dict[str, str] = {}
    lower, upper = model.lowerPositionLimit[at], model.upperPositionLimit[at]
    if max(lower, -UNBOUNDED) < min(upper, UNBOUNDED) and (lower > -UNSET or upper < UNSET):
        lower, upper = max(lower, -UNBOUNDED), min(upper, UNBOUNDED)
        found |= {"limited": "true", "range": numbers_text(np.array([lower, upper]))}
    least, most = model.lowerEffortLimit[v], model.upperEffortLimit[v]
    if least < 0.0 < most and max(-least, most) < UNSET:
        found |= {"actuatorfrclimited": "true",
                  "actuatorfrcrange": numbers_text(np.array([least, most]))}
    return found


# ---------------------------------------------------------------- springs about a coordinate


def _spring(mech: Mechanism, name: str) -> dict[str, str]:
    """Return the one spring that all springs of a coordinate are together."""
    own = [s for s in mech.springs
           if s.joint is not None and mech.coordinate(s.joint).name == name]
    stiffness = sum(s.stiffness for s in own)
    if not stiffness:
        return {}
    free = sum(s.stiffness * s.free for s in own) / stiffness
    return {"stiffness": repr(float(stiffness)), "springref": repr(float(free))}


def _spring_damping(mech: Mechanism, joint: str, k: int) -> float:
    """Return what the springs of the k-th coordinate of a joint add to its damping."""
    own = ((s, mech.coordinate(s.joint)) for s in mech.springs if s.joint is not None)
    return sum(s.damping for s, c in own if (c.joint, c.place) == (joint, k))
