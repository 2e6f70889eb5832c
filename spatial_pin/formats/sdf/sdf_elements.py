"""SDFormat: numbers, poses, the frames that these are relative to, and what links hold."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.graph.joint_graph import WORLD
from spatial_pin.formats.urdf.elements import (
    finite_numbers,
    inertial as inertial_element,
    numbers_text,
    origin,
    shape_element,
)
from spatial_pin.numerics.linalg import Array

MODEL = "__model__"  # a model's own frame
SCOPE = "::"  # between the names of a model and of its parts
WORLDS = ("world",)
NO_LIMIT = 1e16  # SDFormat's number for a limit that is none
TRUE = ("1", "true")
MOMENTS = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}  # by default
SIZES = {  # of shapes, with SDFormat's defaults
    "box": {"size": "1 1 1"}, "sphere": {"radius": "1"}, "cylinder": {"radius": "1", "length": "1"},
    "capsule": {"radius": "0.5", "length": "1"}, "ellipsoid": {"radii": "1 1 1"},
}
WATER = 1000.0  # kg/m³, SDFormat's density of a shape
SOLIDS: dict[str, Callable[..., tuple[float, pin.Inertia]]] = {  # volume, inertia of 1 kg
    "box": lambda x, y, z: (x * y * z, pin.Inertia.FromBox(1.0, x, y, z)),
    "sphere": lambda r: (4.0 / 3.0 * math.pi * r**3, pin.Inertia.FromSphere(1.0, r)),
    "cylinder": lambda r, h: (math.pi * r**2 * h, pin.Inertia.FromCylinder(1.0, r, h)),
    "capsule": lambda r, h: (math.pi * r**2 * (h + 4.0 / 3.0 * r),
                             pin.Inertia.FromCapsule(1.0, r, h)),
    "ellipsoid": lambda x, y, z: (4.0 / 3.0 * math.pi * x * y * z,
                                  pin.Inertia.FromEllipsoid(1.0, x, y, z)),
}


def number_list(text: str | None, count: int, where: str) -> Array:
    """Return the `count` finite numbers of a text."""
    try:
        return finite_numbers(text or "", count)
    except ValueError as wanted:
        shown = " ".join((text or "").split())[:80]
        raise MechanismFileError(f"{where} is {shown!r}; it must be {wanted}") from None


def number(parent: ET.Element | None, tag: str, default: float, where: str) -> float:
    """Return the number in a child element, the default where there is none."""
    element = parent.find(tag) if parent is not None else None
    if element is None:
        return default
    return float(number_list(element.text, 1, f"{where}: <{tag}>")[0])


def bound(parent: ET.Element | None, tag: str, none: float, where: str) -> float:
    """Return a limit, `none` (plus or minus infinity) where there is none."""
    element = parent.find(tag) if parent is not None else None
    text = (element.text or "").strip().lower() if element is not None else ""
    if element is None or text.lstrip("+-") in ("inf", "infinity"):
        return none
    value = float(number_list(text, 1, f"{where}: <{tag}>")[0])
    return none if abs(value) >= NO_LIMIT else value


def is_true(parent: ET.Element, tag: str) -> bool:
    """Return whether a child element is true."""
    return (parent.findtext(tag) or "").strip().lower() in TRUE


def pose(element: ET.Element | None, where: str) -> pin.SE3:
    """Return the placement that a <pose> states; the identity where it is missing or empty."""
    text = (element.text or "").strip() if element is not None else ""
    if element is None or not text:
        return pin.SE3.Identity()
    where = f"{where}: <pose>"
    if element.get("rotation_format", "euler_rpy") == "quat_xyzw":
        values = number_list(text, 7, where)
        size = float(np.linalg.norm(values[3:]))
        if size < 1e-6:
            raise MechanismFileError(f"{where}: its quaternion is zero")
        return pin.SE3(pin.Quaternion(values[3:] / size).matrix(), values[:3])
    values = number_list(text, 6, where)
    angles = values[3:]
    if element.get("degrees", "").strip().lower() in TRUE:
        angles = np.radians(angles)
    return pin.SE3(pin.rpy.rpyToMatrix(angles), values[:3])


# A frame of a model: the frame it is placed by, its placement in that, and the link, frame or joint
# that it moves with, itself for a link.
SdfFrame = tuple[str, pin.SE3, str]


@dataclass
class SdfFrames:
    """The frames of a model, links, joints and the model's own among them.

    Attributes:
        where: the file and model, for errors.
        of_model: the model's own frame in the world.
        table: by name.
    """

    where: str
    of_model: pin.SE3
    table: dict[str, SdfFrame] = field(default_factory=dict)
    _known: dict[str, pin.SE3] = field(default_factory=dict)

    def relative_to(self, element: ET.Element | None, default: str) -> str:
        """Return the name of the frame that a <pose> is relative to."""
        if element is None:
            return default
        return element.get("relative_to") or element.get("frame") or default

    def _named(self, name: str, asking: str) -> SdfFrame:
        if name not in self.table:
            raise MechanismFileError(f"{self.where}: {asking}: no link, joint or frame {name!r}; "
                                     f"{suggestion(name, self.table)}")
        return self.table[name]

    def in_world(self, name: str, asking: str) -> pin.SE3:
        """Return the placement of a frame in the world."""
        chain: dict[str, SdfFrame] = {}
        while name not in self._known and name not in (MODEL, *WORLDS):
            if name in chain:
                raise MechanismFileError(
                    f"{self.where}: the poses of {', '.join(chain)} are relative to each other")
            chain[name] = self._named(name, asking)
            asking, name = f"<pose> of {name!r}", chain[name][0]
        ground = {MODEL: self.of_model, **dict.fromkeys(WORLDS, pin.SE3.Identity())}
        at = ground[name] if name in ground else self._known[name]
        for link, frame in reversed(chain.items()):
            at = self._known[link] = at * frame[1]
        return at

    def link(self, name: str, asking: str, canonical: str) -> str:
        """Return the link that a frame moves with, `WORLD` for the world's."""
        chain: dict[str, None] = {}
        while name not in WORLDS:
            if name == MODEL:
                name = canonical
            _, _, attached = self._named(name, asking)
            if attached == name:
                return name
            if name in chain:
                raise MechanismFileError(
                    f"{self.where}: the frames {', '.join(chain)} are attached to each other")
            chain[name] = None
            asking, name = f"attached_to of {name!r}", attached
        return WORLD


PlacementOf = Callable[[ET.Element | None, str], pin.SE3]  # <pose>, where -> placement on the link


def link_elements(link: ET.Element, placement_of: PlacementOf, where: str, omitted: list[str]
                  ) -> tuple[ET.Element, ...]:
    """Return <inertial>, <visual> and <collision> of a link; `omitted` gets what URDF lacks."""
    inertial, inside = link.find("inertial"), f"{where}: <inertial>"
    if inertial is not None and inertial.get("auto", "").lower() in TRUE:
        elements = [inertial_element(_of_shapes(link, inertial, placement_of, where, omitted))]
    else:  # a link that has none has one kilogram in SDFormat
        inertia = link.find("inertial/inertia")
        elements = [ET.Element("inertial")]
        elements[0].append(origin(pose(link.find("inertial/pose"), inside)))
        mass = number(inertial, "mass", 1.0, inside)
        ET.SubElement(elements[0], "mass", value=repr(mass))
        ET.SubElement(elements[0], "inertia", {
            key: repr(number(inertia, key, default, inside)) for key, default in MOMENTS.items()})
    for kind in ("visual", "collision"):
        for shape in link.findall(kind):
            name = f"{kind} {shape.get('name', '')!r}"
            stated = shape.find("geometry/*")
            solid = _solid(stated, f"{where}: {name}")
            if solid is None:
                kind_of = "no shape" if stated is None else f"{stated.tag}: URDF has no such shape"
                omitted.append(f"{name} of link {link.get('name')!r} ({kind_of})")
                continue
            colour = _colour(shape, f"{where}: {name}")
            elements.append(shape_element(
                kind, placement_of(shape.find("pose"), f"{where}: {name}"), solid,
                colour if kind == "visual" else None, overrides=True,
                name=shape.get("name", "")))
    return tuple(elements)


def is_massless(link: ET.Element, where: str) -> bool:
    """Return whether a link states that it has neither mass nor moments of inertia."""
    inertial, inertia = link.find("inertial"), link.find("inertial/inertia")
    moments = [number(inertia, key, default, where) for key, default in MOMENTS.items()]
    return number(inertial, "mass", 1.0, where) == 0.0 and not any(moments)


def _of_shapes(
    link: ET.Element, inertial: ET.Element, placement_of: PlacementOf, where: str,
    omitted: list[str],
) -> pin.Inertia:
    """Return the inertia of a link's collision shapes, of 1000 kg/m³ by default."""
    whole = pin.Inertia.Zero()
    if link.find("collision") is None:
        omitted.append(f"the mass of link {link.get('name')!r} (it has no collision shape)")
    by_default = number(inertial, "density", WATER, where)
    for shape in link.findall("collision"):
        name = f"{where}: collision {shape.get('name', '')!r}"
        stated = shape.find("geometry/*")
        make = SOLIDS.get("" if stated is None else str(stated.tag))
        if make is None or stated is None:
            omitted.append(f"the mass of collision {shape.get('name', '')!r} of link "
                            f"{link.get('name')!r} (its volume is not known)")
            continue
        volume, inertia = make(*np.concatenate(list(_sizes(stated, name).values())).tolist())
        density = number(shape, "density", by_default, name)
        part = pin.Inertia(density * volume, inertia.lever, density * volume * inertia.inertia)
        whole += placement_of(shape.find("pose"), name).act(part)
    return whole


def _sizes(solid: ET.Element, where: str) -> dict[str, Array]:
    """Return the numbers of a simple shape, by their names."""
    return {key: number_list(solid.findtext(key, default), len(default.split()),
                             f"{where}: <{key}>") for key, default in SIZES[solid.tag].items()}


def _solid(solid: ET.Element | None, where: str) -> ET.Element | None:
    """Return the shape, None where URDF has none."""
    if solid is None or solid.tag == "ellipsoid":
        return None
    if solid.tag in SIZES:
        sizes = _sizes(solid, where).items()
        return ET.Element(solid.tag, {key: numbers_text(x) for key, x in sizes})
    if solid.tag == "mesh" and solid.find("submesh") is None:
        uri = (solid.findtext("uri") or "").strip()
        element = ET.Element("mesh", filename=uri)
        if solid.find("scale") is not None:
            scale = number_list(solid.findtext("scale"), 3, f"{where}: <scale>")
            element.set("scale", numbers_text(scale))
        return element
    return None


def _colour(shape: ET.Element, where: str) -> Array | None:
    stated = shape.find("material/diffuse")
    if stated is None:
        stated = shape.find("material/ambient")
    if stated is None:
        return None
    words = (stated.text or "").split()
    values = number_list(" ".join([*words, "1"] if len(words) == 3 else words), 4,
                         f"{where}: <{stated.tag}>")
    return np.clip(values, 0.0, 1.0)
