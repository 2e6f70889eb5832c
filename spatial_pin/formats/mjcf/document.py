"""An MJCF document that is being written."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.mechanism_writer import tree_axes
from spatial_pin.formats.urdf.elements import UNBOUNDED, numbers_text, unique
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

LEAST_MASS = 1e-9  # of the whole mass: that of a body without mass at an end of the tree
THIN = 1e-6  # of the characteristic length: its radius of gyration
LEAST_MOMENT = 1e-14  # kg·m² and kg: below 1e-15 MuJoCo refuses a body that moves
UNSET = 1e300  # Pinocchio's largest number, or infinity, where there is no limit
HINGE, SLIDE, BALL, FREE = "hinge", "slide", "ball", "free"


class MjcfDocument:
    """An MJCF document that is being written.

    Attributes:
        mechanism: to write.
        root: <mujoco>; parts: its children by tag.
        bodies: element of the body of every tree joint, the world's first.
        links: element of the body of every link.
        joints: names of the joints of one coordinate.
        home: values of the key of every joint, by name.
        sites: body and placement of every site, by name.
        light: names of bodies that have got a mass.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.root = ET.Element("mujoco", model=mechanism.name)
        ET.SubElement(self.root, "compiler", angle="radian", inertiafromgeom="false")
        ET.SubElement(self.root, "option", gravity=numbers_text(mechanism.model.gravity.linear))
        self.parts = {tag: ET.SubElement(self.root, tag) for tag in ("asset", "worldbody")}
        self.bodies = {0: self.parts["worldbody"]}
        self.links: dict[str, ET.Element] = {}
        self.joints: set[str] = set()
        self.home: dict[str, list[float]] = {}
        self.sites: dict[str, tuple[int, pin.SE3]] = {}
        self.light: list[str] = []

    def part(self, tag: str) -> ET.Element:
        """Return the child of <mujoco> of that tag."""
        if tag not in self.parts:
            self.parts[tag] = ET.SubElement(self.root, tag)
        return self.parts[tag]

    def frame(self, name: str) -> str:
        """Return the name of the site that is a frame of the mechanism."""
        joint, placement = self.mechanism.frame_on_joint(name)
        if name in self.links and name not in self.sites:  # in the link's own body
            self.sites[name] = joint, placement
            ET.SubElement(self.links[name], "site", name=name)
        return self.site(name, joint, placement)

    def site(self, wanted: str, joint: int, placement: pin.SE3) -> str:
        """Return the name of a site on the body of a tree joint, a new one if that is elsewhere."""
        same = self.sites.get(wanted)
        if (same is not None and same[0] == joint
                and same[1].isApprox(placement, TOLERANCES.round_off)):
            return wanted
        return self.new_site(wanted, joint, placement, self.bodies[joint])

    def new_site(self, wanted: str, joint: int, placement: pin.SE3, body: ET.Element) -> str:
        """Add a site to a body and return its name."""
        name = unique(wanted, self.sites)
        self.sites[name] = joint, placement
        ET.SubElement(body, "site", placed(placement, name=name))
        return name

    def tie(self, name: str, slide: str, turn: str, ratio: float, offset: float = 0.0) -> None:
        """Add the equality slide = ratio * turn + offset of two joints."""
        ET.SubElement(self.part("equality"), "joint", name=name, joint1=slide, joint2=turn,
                      polycoef=numbers_text(np.array([offset, ratio, 0.0, 0.0, 0.0])))

    def inertia(self, body: ET.Element, inertia: pin.Inertia) -> None:
        """Give a body its inertia, in its own frame."""
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 0] *= np.linalg.det(axes)
        a, b, c = np.maximum(moments, 0.0)  # with the least change that bodies may have
        lack = max(c * (1.0 + 4.0 * np.finfo(float).eps) - a - b, 0.0)
        moments = np.array([a, b, c]) + lack / 2.0 * np.array([1.0, 1.0, 0.0])
        ET.SubElement(body, "inertial", placed(
            pin.SE3(axes, inertia.lever), mass=repr(float(inertia.mass)),
            diaginertia=numbers_text(moments)))

    def least_inertia(
        self, name: str, body: ET.Element, inertia: pin.Inertia | None = None, *,
        carries: bool = False,
    ) -> None:
        """Give a body as little mass and moments of inertia as MuJoCo asks for.

        A body at an end gets enough for MuJoCo; a warning names it later.

        Args:
            name: of the body.
            body: its element.
            inertia: its own, too small.
            carries: whether it carries a body that has mass.
        """
        mech, own = self.mechanism, inertia or pin.Inertia.Zero()
        mass = moment = LEAST_MOMENT
        if not carries:
            self.light.append(name)
            mass = max(LEAST_MASS * (sum(x.mass for x in mech.inertias.values()) or 1.0), mass)
            moment = max(mass * (THIN * mech.characteristic_length) ** 2, moment)
        mass = own.mass if own.mass >= LEAST_MOMENT else mass
        self.inertia(body, inertia_as_given(mass, own.lever, own.inertia + moment * np.eye(3)))


def is_movable(inertia: pin.Inertia) -> bool:
    """Whether MuJoCo can move a body of that inertia."""
    moments = np.linalg.eigvalsh(inertia.inertia)
    return bool(inertia.mass >= LEAST_MOMENT and moments.min() >= LEAST_MOMENT)


def quaternion(rotation: Array) -> Array:
    """Return the quaternion (4,) of a rotation (3, 3), its real part first."""
    return pin.Quaternion(rotation).normalized().coeffs()[[3, 0, 1, 2]]


def placed(placement: pin.SE3, **attributes: Any) -> dict[str, str]:
    """Return the attributes of an element with a placement."""
    return {**attributes, "pos": numbers_text(placement.translation),
            "quat": numbers_text(quaternion(placement.rotation))}


class MjcfJoint(NamedTuple):
    """A joint of MuJoCo.

    Attributes:
        name: of the joint.
        kind: its type.
        axis: (3,) in the joint's frame, zero for none.
    """

    name: str
    kind: str
    axis: Array


def parts_of(name: str, pair: str, axis: Array, axis2: Array) -> list[MjcfJoint]:
    """Return the joints that a pair is made of, in order."""
    x, y, z = np.eye(3)
    if pair in ("revolute", "prismatic"):
        return [MjcfJoint(name, HINGE if pair == "revolute" else SLIDE, axis)]
    if pair in ("cylindrical", "screw"):
        turn = f"{name}.angle" if pair == "cylindrical" else name
        return [MjcfJoint(turn, HINGE, axis), MjcfJoint(f"{name}.slide", SLIDE, axis)]
    if pair == "universal":
        return [MjcfJoint(f"{name}.first", HINGE, axis), MjcfJoint(f"{name}.second", HINGE, axis2)]
    if pair == "planar":
        along, across, normal = axes_from_z(axis).T
        return [MjcfJoint(f"{name}.x", SLIDE, along), MjcfJoint(f"{name}.y", SLIDE, across),
                MjcfJoint(f"{name}.angle", HINGE, normal)]
    if pair == "spherical":
        return [MjcfJoint(name, BALL, np.zeros(3))]
    return [*(MjcfJoint(f"{name}.{k}", SLIDE, e) for k, e in (("x", x), ("y", y), ("z", z))),
            MjcfJoint(f"{name}.turn", BALL, np.zeros(3))]


def add_joints(document: MjcfDocument, i: int, body: ET.Element, q: Array) -> None:
    """Add the joints of tree joint i to its body, and their values at q (nq,) to the key."""
    mech, model = document.mechanism, document.mechanism.model
    name, pair, at = model.names[i], mech.pairs[i - 1], model.idx_qs[i]
    own = q[at:at + model.nqs[i]]
    if pair == "floating" and model.parents[i] == 0:
        ET.SubElement(body, "joint", {"name": name, "type": FREE, **_resistances(mech, i, 0, 6)})
        placement = model.jointPlacements[i] * pin.SE3(
            pin.Quaternion(own[3:]).matrix(), own[:3])
        document.home[name] = [*placement.translation, *quaternion(placement.rotation)]
        return
    axis, axis2, lead = tree_axes(mech, i)
    parts = parts_of(name, pair, axis, axis2)
    if pair == "screw":
        own = own[[0, 0]] * [1.0, lead / (2.0 * np.pi)]
    elements = add_parts(document, body, parts, own)
    if pair == "screw":  # its slide is tied to the turn, which carries all else
        tie_screw(document, parts, lead)
        elements, parts = elements[:1], parts[:1]
    for k, (element, part) in enumerate(zip(elements, parts, strict=True)):
        count = 3 if part.kind == BALL else 1
        element.attrib |= _resistances(mech, i, k, count)
        if count == 1:
            element.attrib |= _limits(mech, at + k, model.idx_vs[i] + k) | _spring(mech, part.name)


def add_parts(
    document: MjcfDocument, body: ET.Element, parts: list[MjcfJoint], values: Array
) -> list[ET.Element]:
    """Add joints to a body, and their values to the key; a ball, as the last, has four."""
    elements = []
    for k, part in enumerate(parts):
        attributes = {"name": part.name, "type": part.kind}
        if part.kind == BALL:
            document.home[part.name] = values[k:][[3, 0, 1, 2]].tolist()
        else:
            attributes["axis"] = numbers_text(part.axis)
            document.joints.add(part.name)
            document.home[part.name] = [float(values[k])]
        elements.append(ET.SubElement(body, "joint", attributes))
    return elements


def tie_screw(document: MjcfDocument, parts: list[MjcfJoint], lead: float) -> None:
    """Tie the slide of a screw to its turn."""
    turn, slide = (part.name for part in parts)
    document.tie(f"{turn}.lead", slide, turn, lead / (2.0 * np.pi))


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
    each = {key: float(x[own.start]) for key, x in table.items()}
    if count == 1:  # springs of the coordinate damp it, too
        about = ((s, mech.coordinate(s.joint)) for s in mech.springs if s.joint is not None)
        each["damping"] += sum(s.damping for s, c in about
                               if (c.joint, c.component) == (model.names[i], k))
    return {key: repr(x) for key, x in each.items() if x}


def _limits(mech: Mechanism, at: int, v: int) -> dict[str, str]:
    model = mech.model
    words: dict[str, str] = {}
    lower, upper = model.lowerPositionLimit[at], model.upperPositionLimit[at]
    if max(lower, -UNBOUNDED) < min(upper, UNBOUNDED) and (lower > -UNSET or upper < UNSET):
        lower, upper = max(lower, -UNBOUNDED), min(upper, UNBOUNDED)
        words |= {"limited": "true", "range": numbers_text(np.array([lower, upper]))}
    least, most = model.lowerEffortLimit[v], model.upperEffortLimit[v]
    if least < 0.0 < most and max(-least, most) < UNSET:
        words |= {"actuatorfrclimited": "true",
                  "actuatorfrcrange": numbers_text(np.array([least, most]))}
    return words


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
