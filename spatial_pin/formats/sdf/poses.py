"""SDFormat: numbers, poses, and the frames that they are relative to."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.graph.joints import WORLD
from spatial_pin.formats.urdf.elements import finite_numbers
from spatial_pin.numerics.linalg import Array

MODEL = "__model__"  # a model's own frame
WORLDS = ("world",)
NO_LIMIT = 1e16  # SDFormat's number for a limit that is none
TRUE = ("1", "true")


def number_list(text: str | None, count: int, where: str) -> Array:
    """Return the `count` finite numbers of a text.

    Raises:
        MechanismFileError: there are more or fewer, or no numbers.
    """
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
    """Return whether a child element says so."""
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


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a model, which other frames may be placed by.

    Attributes:
        relative_to: the frame it is placed by.
        placement: in that.
        attached_to: link, frame or joint that it moves with; itself for a link.
    """

    relative_to: str
    placement: pin.SE3
    attached_to: str


@dataclass
class Frames:
    """The frames of a model, links, joints and the model's own among them.

    Attributes:
        where: the file and model, for errors.
        of_model: the model's own frame in the world.
        table: by name.
    """

    where: str
    of_model: pin.SE3
    table: dict[str, Frame] = field(default_factory=dict)
    _known: dict[str, pin.SE3] = field(default_factory=dict)

    def relative_to(self, element: ET.Element | None, default: str) -> str:
        """Return the name of the frame that a <pose> is relative to."""
        if element is None:
            return default
        return element.get("relative_to") or element.get("frame") or default

    def _named(self, name: str, asking: str) -> Frame:
        if name not in self.table:
            raise MechanismFileError(f"{self.where}: {asking}: no link, joint or frame {name!r}; "
                                     f"{suggestion(name, self.table)}")
        return self.table[name]

    def in_world(self, name: str, asking: str) -> pin.SE3:
        """Return where a frame stands in the world.

        Args:
            name: of the frame.
            asking: the element that asks, for errors.

        Raises:
            MechanismFileError: there is no such frame, or it is placed by itself.
        """
        way: dict[str, Frame] = {}
        while name not in self._known and name not in (MODEL, *WORLDS):
            if name in way:
                raise MechanismFileError(
                    f"{self.where}: the poses of {', '.join(way)} are relative to each other")
            way[name] = self._named(name, asking)
            asking, name = f"<pose> of {name!r}", way[name].relative_to
        ground = {MODEL: self.of_model, **dict.fromkeys(WORLDS, pin.SE3.Identity())}
        at = ground[name] if name in ground else self._known[name]
        for link, frame in reversed(way.items()):
            at = self._known[link] = at * frame.placement
        return at

    def link(self, name: str, asking: str, canonical: str) -> str:
        """Return the link that a frame moves with, `WORLD` for the world's.

        Raises:
            MechanismFileError: there is none.
        """
        way: dict[str, None] = {}
        while name not in WORLDS:
            if name == MODEL:
                name = canonical
            frame = self._named(name, asking)
            if frame.attached_to == name:
                return name
            if name in way:
                raise MechanismFileError(
                    f"{self.where}: the frames {', '.join(way)} are attached to each other")
            way[name] = None
            asking, name = f"attached_to of {name!r}", frame.attached_to
        return WORLD
