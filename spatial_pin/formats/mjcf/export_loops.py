"""Closures as MuJoCo's equalities, springs between frames as tendons, drivers as motors."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from spatial_pin.errors import ClosureTypeError, warn
from spatial_pin.formats.mjcf.export_joints import add_parts, parts_of, tie_screw
from spatial_pin.formats.mjcf.writing import Writing, placed
from spatial_pin.formats.urdf.elements import numbers_text
from spatial_pin.formats.urdf.writing import unique
from spatial_pin.mechanism.mechanism import rigid_distance
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array

WELDED = ("weld", "fixed")
COMPOSED = ("prismatic", "cylindrical", "planar", "universal", "screw")


def add_closures(writing: Writing, q: Array) -> None:
    """Add an equality for every closure.

    Args:
        writing: the document, its bodies in place.
        q: (nq,) where the key is.

    Raises:
        ClosureTypeError: MuJoCo has no equality that is exactly that closure.
    """
    for closure in writing.mechanism.closures:
        if closure.type == COUPLING:
            first, second = (writing.mechanism.coordinate(name).name for name in closure.joints)
            writing.tie(closure.name, second, first, closure.ratio, closure.offset)
        elif closure.type == "spherical":
            _equality(writing, "connect", closure.name, *_sites(writing, closure, closure.name))
        elif closure.type in WELDED:
            _equality(writing, "weld", closure.name, *_sites(writing, closure, closure.name))
        elif closure.type == "revolute":
            _hinge(writing, closure)
        elif closure.type == "distance":
            _rope(writing, closure)
        elif closure.type in COMPOSED:
            _compose(writing, closure, q)
        else:
            raise ClosureTypeError(
                f"mechanism {writing.mechanism.name!r}: closure {closure.name!r} is "
                f"{closure.type}; MuJoCo has no equality that is exactly this")


def _equality(writing: Writing, kind: str, name: str, site1: str, site2: str) -> None:
    ET.SubElement(writing.part("equality"), kind, name=name, site1=site1, site2=site2)


def _axes(closure: Closure) -> tuple[pin.SE3, pin.SE3]:
    """Return the pair's axes in frame 1 and in frame 2, z its axis."""
    return (pin.SE3(closure.geometry.axes1, np.zeros(3)),
            pin.SE3(closure.geometry.axes2, np.zeros(3)))


def _sites(
    writing: Writing, closure: Closure, name: str, shift: pin.SE3 | None = None
) -> tuple[str, str]:
    """Return sites at a closure's frames, turned to the pair's axes and shifted then."""
    shift = pin.SE3.Identity() if shift is None else shift
    names = []
    for k, (frame, axes) in enumerate(zip(closure.frames, _axes(closure), strict=True), start=1):
        joint, placement = writing.mechanism.frame_on_joint(frame)
        moved = axes * shift
        names.append(writing.frame(frame) if moved.isIdentity(0.0)
                     else writing.site(f"{name}_{k}", joint, placement * moved))
    return names[0], names[1]


def _hinge(writing: Writing, closure: Closure) -> None:
    """A hinge is two points of its axis, as far apart as the mechanism is large."""
    along = pin.SE3(np.eye(3), np.array([0.0, 0.0, writing.mechanism.characteristic_length]))
    _equality(writing, "connect", closure.name, *_sites(writing, closure, closure.name))
    end = f"{closure.name}_end"
    _equality(writing, "connect", end, *_sites(writing, closure, end, along))


def _rope(writing: Writing, closure: Closure) -> None:
    """A distance is a straight tendon whose length is held, or is that of another."""
    rest = _tendon(writing, closure.name, closure.frames)
    attributes = {"name": closure.name, "tendon1": closure.name}
    length: float | None = closure.geometry.length
    if closure.between:
        length = rigid_distance(*map(writing.mechanism.frame_on_joint, closure.between))
    if length is not None:
        offset, ratio = length - rest, 0.0
    else:
        attributes["tendon2"] = f"{closure.name}_other"
        offset, ratio = _tendon(writing, attributes["tendon2"], closure.between) - rest, 1.0
    attributes["polycoef"] = numbers_text(np.array([offset, ratio, 0.0, 0.0, 0.0]))
    ET.SubElement(writing.part("equality"), "tendon", attributes)


def _tendon(writing: Writing, name: str, frames: tuple[str, ...]) -> float:
    """Add a straight tendon between two frames; return its length [m] where joints are at zero."""
    mech = writing.mechanism
    tendon = ET.SubElement(writing.part("tendon"), "spatial", name=name)
    data = mech.model.createData()
    pin.forwardKinematics(mech.model, data, mech.neutral)
    points = []
    for frame in frames:
        ET.SubElement(tendon, "site", site=writing.frame(frame))
        joint, placement = mech.frame_on_joint(frame)
        points.append(data.oMi[joint].act(placement.translation))
    return float(np.linalg.norm(points[1] - points[0]))


def _compose(writing: Writing, closure: Closure, q: Array) -> None:
    """Add a body that moves on frame 1 as the pair does, and weld it to frame 2."""
    mech, geometry = writing.mechanism, closure.geometry
    (joint1, at1), (joint2, at2) = (
        (joint, place * axes) for (joint, place), axes in
        zip(map(mech.frame_on_joint, closure.frames), _axes(closure), strict=True))
    x, y, z = np.eye(3)
    if closure.type == "universal":  # the second pin, z of frame 2, is the body's x
        at2 = at2 * pin.SE3(np.column_stack([z, x, y]), np.zeros(3))
    name = unique(closure.name, [*mech.model.names, *writing.links])
    body = ET.SubElement(writing.bodies[joint1], "body", placed(at1, name=name))
    data = mech.model.createData()
    pin.forwardKinematics(mech.model, data, q)
    moved = (data.oMi[joint1] * at1).inverse() * data.oMi[joint2] * at2
    parts = parts_of(name, closure.type, z, x)
    add_parts(writing, body, parts, _values(closure.type, moved))
    if closure.type == "screw":
        tie_screw(writing, parts, geometry.lead)
    writing.least_inertia(name, body)
    site1 = writing.new_site(f"{closure.name}_1", -1, pin.SE3.Identity(), body)
    _equality(writing, "weld", closure.name, site1,
              writing.site(f"{closure.name}_2", joint2, at2))


def _values(pair: str, moved: pin.SE3) -> Array:
    """Return the coordinates of the parts of a pair about z at a relative placement."""
    turn = np.arctan2(moved.rotation[1, 0], moved.rotation[0, 0])
    x, y, z = moved.translation
    if pair == "planar":
        return np.array([x, y, turn])
    if pair == "universal":
        return np.array([turn, np.arctan2(moved.rotation[2, 1], moved.rotation[2, 2])])
    return np.array([z]) if pair == "prismatic" else np.array([turn, z])


# ---------------------------------------------------------------- springs and drivers


def add_springs(writing: Writing) -> None:
    """Add a straight tendon for every spring between two frames."""
    mech = writing.mechanism
    for spring in mech.springs:
        if not spring.frames:
            continue
        tendon = ET.SubElement(writing.part("tendon"), "spatial", {
            "name": spring.name, "stiffness": repr(float(spring.stiffness)),
            "damping": repr(float(spring.damping)),
            "springlength": repr(float(spring.free_length))})
        for frame in spring.frames:
            ET.SubElement(tendon, "site", site=writing.frame(frame))


def add_drivers(writing: Writing) -> None:
    """Add a motor for every driver; tell which has none."""
    mech, lost = writing.mechanism, []
    for driver in mech.drivers.values():
        name = mech.coordinate(driver.joint).name
        if name in writing.joints:
            ET.SubElement(writing.part("actuator"), "motor", name=driver.name, joint=name)
        else:
            lost.append(driver.name)
    if lost:
        warn(f"mechanism {mech.name!r}: drivers {', '.join(lost)} turn components of a joint that "
             "has no motor in MuJoCo: left out")
