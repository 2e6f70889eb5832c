"""Writing a mechanism as MJCF, its closures as equalities between sites.

A body stands for every link, its frame the link's. Joints keep their names and coordinates; those
of several coordinates become several joints, named as the coordinates. MuJoCo is not needed.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from spatial_pin._support.outputs import named_path, write_text
from spatial_pin.errors import SpatialPinError, warn
from spatial_pin.formats.mjcf.compiling import some
from spatial_pin.formats.mjcf.export_joints import add_joints
from spatial_pin.formats.mjcf.export_loops import add_closures, add_drivers, add_springs
from spatial_pin.formats.mjcf.export_shapes import add_shapes
from spatial_pin.formats.mjcf.tree import WORLD
from spatial_pin.formats.mjcf.writing import Writing, is_movable, placed
from spatial_pin.formats.urdf.elements import numbers_text
from spatial_pin.mechanism.checks import refuse_negative_inertias
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

SUFFIXES = (".xml", ".mjcf")
HOME = "home"  # the name of the key


def write_mjcf(mechanism: Mechanism, path: str | Path, q: Array | None = None) -> Path:
    """Write a mechanism as MJCF, see `spatial_pin.export_mjcf`.

    Args:
        mechanism: the mechanism.
        path: the file; its name ends in .xml or .mjcf.
        q: (nq,) where the key "home" is; default the guess.

    Raises:
        ClosureTypeError: MuJoCo has no equality that is exactly one of its closures.
        SpatialPinError: something else has no counterpart, or the file cannot be written.
    """
    path = named_path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise SpatialPinError(f"{path}: the name of an MJCF file ends in .xml or .mjcf")
    if mechanism.path is not None and path.resolve() == mechanism.path.resolve():
        raise SpatialPinError(f"{path} is a file of the mechanism itself; choose another")
    if q is None:
        guess = joint_values(mechanism, mechanism.guess)
        q = with_values(mechanism, mechanism.neutral, guess)
    text = mjcf_text(mechanism, q)
    try:
        write_text(path, text)
    except OSError as error:
        raise SpatialPinError(f"cannot write {error.filename}: {error.strerror}") from error
    return path


def mjcf_text(mechanism: Mechanism, q: Array) -> str:
    """Return a mechanism as MJCF text, its key at q (nq,)."""
    refuse_negative_inertias(mechanism)
    root = ET.Element("mujoco", model=mechanism.name)
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    ET.SubElement(root, "option", gravity=numbers_text(mechanism.model.gravity.linear))
    writing = Writing(mechanism, root)
    writing.part("asset")
    writing.bodies[0] = writing.part("worldbody")
    _add_links(writing, 0, writing.bodies[0])
    for i in _children(mechanism.model, 0):
        _add_tree(writing, i, q)
    add_shapes(writing)
    _add_points(writing)
    add_closures(writing, q)
    add_springs(writing)
    add_drivers(writing)
    _add_key(writing)
    _tell(writing)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _children(model: pin.Model, i: int) -> Iterator[int]:
    return (k for k in range(1, model.njoints) if model.parents[k] == i)


def _add_tree(writing: Writing, i: int, q: Array) -> None:
    """Add tree joint i and all that it carries."""
    model, waiting = writing.mechanism.model, [i]
    for k in waiting:
        body = ET.SubElement(writing.bodies[model.parents[k]], "body",
                             placed(model.jointPlacements[k]))
        writing.bodies[k] = body
        add_joints(writing, k, body, q)
        _add_links(writing, k, body)
        waiting += _children(model, k)


def _add_links(writing: Writing, i: int, body: ET.Element) -> None:
    """Add the links of tree joint i: one is its body, the others are fixed in that."""
    mech = writing.mechanism
    frames = [f for f in mech.model.frames
              if f.type == pin.FrameType.BODY and f.parentJoint == i]
    own = [f.name for f in frames if _is_body(f)][:1]
    name = own[0] if own else mech.model.names[i]
    if i > 0:
        body.set("name", _unlike_world(name))
    inertias = {}
    for frame in frames:
        writing.links[frame.name] = body if [frame.name] == own else ET.SubElement(
            body, "body", placed(frame.placement, name=_unlike_world(frame.name)))
        inertias[frame.name] = mech.inertias.get(frame.name, pin.Inertia.Zero())
    if i > 0 and not any(map(is_movable, inertias.values())):
        carries = any(mech.model.inertias[k].mass for k in mech.model.subtrees[i].tolist()[1:])
        writing.least_inertia(name, body, inertias.pop(name, None), carries=carries)
    for link, inertia in inertias.items():
        element = writing.links[link]
        if element.tag == "body" and (inertia.mass or np.any(inertia.inertia)):
            writing.inertia(element, inertia)


def _is_body(frame: pin.Frame) -> bool:
    """Whether a link is the body of its joint; the world's only where it has its name."""
    at_joint = bool(np.array_equal(frame.placement.homogeneous, np.eye(4)))
    return at_joint if frame.parentJoint > 0 else frame.name == WORLD


def _unlike_world(name: str) -> str:
    return f"{name}_link" if name == WORLD else name  # MuJoCo keeps that name for itself


def _add_points(writing: Writing) -> None:
    """Add a site for every named frame that is no link."""
    mech = writing.mechanism
    points = [f.name for f in mech.model.frames if f.type == pin.FrameType.OP_FRAME]
    for name in dict.fromkeys([*mech.frames, *points]):
        writing.frame(name)


def _add_key(writing: Writing) -> None:
    values = [x for joint in writing.parts["worldbody"].iter("joint")
              for x in writing.home[joint.get("name", "")]]
    if values:
        ET.SubElement(writing.part("keyframe"), "key", name=HOME,
                      qpos=numbers_text(np.array(values)))


def _tell(writing: Writing) -> None:
    mech = writing.mechanism
    if writing.light:
        warn(f"mechanism {mech.name!r}: MuJoCo moves no body without mass and moments of inertia: "
             f"{some(writing.light)} have got as much as nobody feels")
    if mech.passives:
        spins = some(passive.name for passive in mech.passives)
        warn(f"mechanism {mech.name!r}: passive spins ({spins}) are free in MuJoCo")
