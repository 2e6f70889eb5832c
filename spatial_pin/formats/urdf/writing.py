"""Writing an open tree as plain URDF text, every number with all its digits."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import pinocchio as pin

from spatial_pin.formats.urdf.elements import UNBOUNDED, joint_element, numbers_text, origin
from spatial_pin.numerics.linalg import Array


class UrdfText:
    """A URDF that grows link by link and joint by joint; names are made unique.

    Args:
        name: of the robot.
        root: name of the first link.
        reserved: names that no frame may take.
    """

    def __init__(self, name: str, root: str, reserved: Iterable[str] = ()) -> None:
        self._robot = ET.Element("robot", name=name)
        self._reserved = set(reserved)
        self._links: dict[str, ET.Element] = {}
        self._joints: set[str] = set()
        self._link(root)

    def _link(self, wanted: str) -> str:
        name = unique(wanted, self._links)
        self._links[name] = ET.SubElement(self._robot, "link", name=name)
        return name

    def joint(
        self, wanted: str, kind: str, parent: str, child: str, placement: pin.SE3,
        axis: Array | None = None, limits: Array | None = None,
    ) -> tuple[str, str]:
        """Add a joint and the link that it carries.

        Args:
            wanted: name of the joint; a number is added where it is taken.
            kind: its URDF type.
            parent: name of the link that carries it.
            child: name of the new link; a number is added where it is taken.
            placement: of the joint in the parent link.
            axis: (3,) unit vector in the joint's frame.
            limits: (2,) lower and upper value [rad or m].

        Returns:
            The names of the joint and of the new link.
        """
        name, link = unique(wanted, self._joints), self._link(child)
        self._joints.add(name)
        joint = joint_element(self._robot, name, kind, parent, link, placement)
        if axis is not None:
            ET.SubElement(joint, "axis", xyz=numbers_text(axis))
        if limits is not None:
            ET.SubElement(joint, "limit", lower=repr(float(limits[0])),
                          upper=repr(float(limits[1])), effort=repr(UNBOUNDED),
                          velocity=repr(UNBOUNDED))
        return name, link

    def frame(self, wanted: str, parent: str, placement: pin.SE3) -> str:
        """Add a link on a fixed joint and return its name."""
        name = unique(wanted, self._reserved)
        return self.fixed(parent, name, placement)

    def fixed(self, parent: str, child: str, placement: pin.SE3) -> str:
        """Add a link of a name that may be reserved on a fixed joint, and return its name."""
        joint = unique(f"{child}_fixed", self._reserved)
        return self.joint(joint, "fixed", parent, child, placement)[1]

    def inertia(self, link: str, mass: float, placement: pin.SE3, moments: Array) -> None:
        """Give a link a mass [kg] and moments (3,) [kg·m²] about the axes of a central frame."""
        inertial = ET.SubElement(self._links[link], "inertial")
        inertial.append(origin(placement))
        ET.SubElement(inertial, "mass", value=repr(float(mass)))
        xx, yy, zz = (repr(float(x)) for x in moments)
        ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")

    def shape(
        self, link: str, kind: str, placement: pin.SE3, solid: str, sizes: dict[str, str],
        rgba: Array | None = None,
    ) -> None:
        """Give a link a shape.

        Args:
            link: its name.
            kind: "visual" or "collision".
            placement: of the shape in the link.
            solid: the URDF element, such as "box".
            sizes: its attributes.
            rgba: (4,) its colour.
        """
        shape = ET.SubElement(self._links[link], kind)
        shape.append(origin(placement))
        ET.SubElement(ET.SubElement(shape, "geometry"), solid, sizes)
        if rgba is not None:
            material = ET.SubElement(shape, "material", name=f"rgba {numbers_text(rgba)}",
                                     override="true")
            ET.SubElement(material, "color", rgba=numbers_text(rgba))

    def text(self) -> str:
        """Return the URDF."""
        return ET.tostring(self._robot, encoding="unicode")


def unique(wanted: str, taken: Iterable[str]) -> str:
    """Return a name that is not taken: the wanted one, or that with a number."""
    known = set(taken)
    name, k = wanted, 2
    while name in known:
        name, k = f"{wanted}_{k}", k + 1
    return name


def fresh(wanted: str, taken: set[str]) -> str:
    """Return a name that is not taken as `unique` does, and take it."""
    name = unique(wanted, taken)
    taken.add(name)
    return name
