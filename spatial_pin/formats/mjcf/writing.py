"""An MJCF document that is being written."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.formats.urdf.elements import numbers_text
from spatial_pin.formats.urdf.writing import unique
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

LEAST_MASS = 1e-9  # of the whole mass: that of a body without mass at an end of the tree
THIN = 1e-6  # of the characteristic length: its radius of gyration
LEAST_MOMENT = 1e-14  # kg·m² and kg: below 1e-15 MuJoCo refuses a body that moves


@dataclass(eq=False)
class Writing:
    """What is written so far.

    Attributes:
        mechanism: what is written.
        root: <mujoco>; parts: its children by tag.
        bodies: element of the body of every tree joint, the world's first.
        links: element of the body of every link.
        joints: names of the joints of one coordinate.
        home: values of the key of every joint, by name.
        sites: body and placement of every site, by name.
        light: names of bodies that have got a mass.
    """

    mechanism: Mechanism
    root: ET.Element
    parts: dict[str, ET.Element] = field(default_factory=dict)
    bodies: dict[int, ET.Element] = field(default_factory=dict)
    links: dict[str, ET.Element] = field(default_factory=dict)
    joints: set[str] = field(default_factory=set)
    home: dict[str, list[float]] = field(default_factory=dict)
    sites: dict[str, tuple[int, pin.SE3]] = field(default_factory=dict)
    light: list[str] = field(default_factory=list)

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
        """Return the name of a site on the body of a tree joint, that of the wanted name if it is.

        Args:
            wanted: its name; a number is added where another site has it.
            joint: of the body.
            placement: in the body.
        """
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
        placement = pin.SE3(axes, inertia.lever)
        ET.SubElement(body, "inertial", placed(placement, mass=repr(float(inertia.mass)),
                                               diaginertia=numbers_text(possible(moments))))

    def least_inertia(
        self, name: str, body: ET.Element, inertia: pin.Inertia | None = None, *,
        carries: bool = False,
    ) -> None:
        """Give a body as little mass and moments of inertia as MuJoCo asks for.

        A body at an end gets so much that MuJoCo can work with it, which is told later.

        Args:
            name: of the body.
            body: its element.
            inertia: what it has, too little.
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


def possible(moments: Array) -> Array:
    """Return principal moments (3,), ascending, with the least change that bodies may have."""
    a, b, c = np.maximum(moments, 0.0)
    lack = c * (1.0 + 4.0 * np.finfo(float).eps) - a - b
    return np.array([a, b, c]) + max(lack, 0.0) / 2.0 * np.array([1.0, 1.0, 0.0])


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
