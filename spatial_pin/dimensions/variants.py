"""A mechanism at other dimensions, without expanding its xacro file again.

The file is expanded once with its dimensions traced (`formats.xacro.tracing`). Then a mechanism at
other dimensions is a copy of this one with the places of joints and frames that follow from them,
to a last digit or two those that loading gives. Where the file cannot be followed, or decides
otherwise at those dimensions, the mechanism is loaded.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.dimensions.homotopy import varied
from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.xacro.expansion import parse_urdf, traced
from spatial_pin.formats.xacro.tracing import depends
from spatial_pin.lazy import cached_property
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array

SAME = 64 * EPS  # of the largest length: how far placements may be off by round-off
WITHOUT_MOTION = ("visual", "collision", "dynamics", "safety_controller", "mass", "inertia")
FIELDS = [field.name for field in fields(Mechanism) if field.init]


class Variants:
    """Mechanisms that differ in some dimensions, for their motion: masses stay what they were.

    Args:
        mechanism: at its own dimensions.
        names: the dimensions.
    """

    def __init__(self, mechanism: Mechanism, names: Iterable[str]) -> None:
        self.mechanism, self.names = mechanism, list(names)

    def at(self, dimensions: Mapping[str, float]) -> Mechanism:
        """Return the mechanism at other dimensions."""
        return self.several([dimensions])[0]

    def several(self, many: Sequence[Mapping[str, float]]) -> list[Mechanism]:
        """Return the mechanisms at several sets of dimensions.

        Raises:
            SpatialPinError: one cannot be loaded.
        """
        tree = self._tree
        if tree is None or any(name not in tree.dimensions for x in many for name in x):
            return [varied(self.mechanism, x) for x in many]
        numbers, holds = tree.numbers(many)
        return [tree.mechanism_at(x, column) if good else varied(self.mechanism, x)
                for x, column, good in zip(many, numbers.T, holds, strict=True)]

    @cached_property
    def _tree(self) -> _TracedTree | None:
        try:
            return _TracedTree(self.mechanism, self.names)
        except (_Untraced, SpatialPinError, ValueError):  # a number's text was part of another's
            return None


class _Untraced(Exception):
    """Something of a mechanism cannot be followed from the dimensions."""


class _Words(NamedTuple):
    """Numbers of an attribute.

    Attributes:
        values: (k,) at the mechanism's own dimensions.
        places: (k,) of each among the traced numbers, -1 if it does not depend on dimensions.
    """

    values: Array
    places: NDArray[np.intp]

    def at(self, numbers: Array) -> Array:
        """Return the numbers (k,) for others in the place of the traced ones."""
        return np.where(self.places >= 0, numbers[self.places], self.values)


class _TracedTree:
    """Which numbers of a mechanism's tree follow from its dimensions, and how.

    Attributes:
        dimensions: those that are traced, and the mechanism's own values of them.

    Raises:
        _Untraced: something cannot be followed.
    """

    def __init__(self, mechanism: Mechanism, names: Iterable[str]) -> None:
        m, file = mechanism, mechanism.tree
        if file is None or file.suffix != ".xacro":
            raise _Untraced
        self.dimensions = {name: m.dimensions[name] for name in names}
        text, self._tape = traced(file, m.parameters, self.dimensions, m.trusted, m.packages)
        self._mechanism, self._places = mechanism, [0]
        self._origins: dict[str, tuple[_Words, _Words]] = {}
        self._levers: dict[str, _Words] = {}
        self._limits: dict[str, list[_Words]] = {}
        self._read(parse_urdf(text, file))
        self._check()

    # ------------------------------------------------------------ reading

    def _read(self, robot: ET.Element) -> None:
        """Find the traced numbers of the text that have a say in how the mechanism moves."""
        for element in robot:
            name, rest = element.get("name", ""), []
            for part in element:
                if element.tag == "joint" and part.tag == "origin":
                    self._origins[name] = self._words(part, "xyz"), self._words(part, "rpy")
                elif element.tag == "joint" and part.tag == "limit":
                    self._limits[name] = [self._words(part, key) for key in ("lower", "upper")]
                elif element.tag == "link" and part.tag == "inertial":
                    origin = part.find("origin")
                    if origin is not None:
                        self._levers[name] = self._words(origin, "xyz")
                elif part.tag not in WITHOUT_MOTION:
                    rest.append(part)
            if depends(name) or any(depends(_texts(x)) for x in rest):
                raise _Untraced
        if not self._tape.is_whole:
            raise _Untraced

    def _words(self, element: ET.Element, key: str) -> _Words:
        words = element.get(key, "0 0 0" if key in ("xyz", "rpy") else "0").split()
        found = [self._tape.read(word) for word in words]
        places = []
        for number in found:
            places.append(-1 if number is None else len(self._places))
            self._places += [] if number is None else [number.place]
        return _Words(np.array([float(word) for word in words]), np.array(places, dtype=np.intp))

    def _check(self) -> None:
        """Refuse a model that was not made of the text alone, as where a reader turns joints."""
        own, holds = self.numbers([{}])
        model, placed = self._mechanism.model, self._placed(own[:, 0])
        size = max((float(np.abs(x.translation).max()) for x in model.jointPlacements), default=1.0)
        size = max(size, *(float(np.abs(f.placement.translation).max()) for f in model.frames))
        if not holds[0] or any(
                np.abs(new.translation - old.translation).max() > SAME * size
                or np.abs(new.rotation - old.rotation).max() > SAME
                for old, new in zip((*model.jointPlacements, *(f.placement for f in model.frames)),
                                    (*placed[0], *placed[1]), strict=True)):
            raise _Untraced

    # ------------------------------------------------------------ other dimensions

    def numbers(self, many: Sequence[Mapping[str, float]]) -> tuple[Array, NDArray[np.bool_]]:
        """Return the traced numbers at several sets of dimensions, and where they hold."""
        given = np.array([[x.get(name, own) for x in many]
                          for name, own in self.dimensions.items()])
        return self._tape.at(given.reshape(len(self.dimensions), len(many)), self._places)

    def mechanism_at(self, dimensions: Mapping[str, float], numbers: Array) -> Mechanism:
        """Return the mechanism with other numbers in the place of the traced ones."""
        m = self._mechanism
        given = {name: getattr(m, name) if name[-6:] != "_model" else m.__dict__[name]
                 for name in FIELDS}
        other = Mechanism(**{**given, "model": self._model(numbers),
                             "inertias": self._inertias(numbers),
                             "parameters": {**m.parameters, **dimensions}})
        other.__dict__["dimensions"] = {**m.dimensions, **dimensions}
        return other

    def _model(self, numbers: Array) -> pin.Model:
        """Return the model with other numbers."""
        model = self._mechanism.model.copy()
        joints, frames = self._placed(numbers)
        for i, placement in enumerate(joints):
            model.jointPlacements[i] = placement
        for frame, placement in zip(model.frames, frames, strict=True):
            frame.placement = placement
        for name, words in self._limits.items():
            joint = model.joints[model.getJointId(name)] if model.existJointName(name) else None
            for bound, word in zip(("lower", "upper"), words, strict=True):
                bounds = getattr(model, f"{bound}PositionLimit")
                if joint is not None and joint.nq == 1 and bounds[joint.idx_q] == word.values[0]:
                    bounds[joint.idx_q] = word.at(numbers)[0]
        return model

    def _inertias(self, numbers: Array) -> dict[str, pin.Inertia]:
        """Return the inertias of links, moved to their centres of mass."""
        inertias = dict(self._mechanism.inertias)
        for name, words in self._levers.items():
            if name in inertias and np.any(words.places >= 0):
                inertias[name] = inertia_as_given(
                    inertias[name].mass, words.at(numbers), inertias[name].inertia)
        return inertias

    def _placed(self, numbers: Array) -> tuple[list[pin.SE3], list[pin.SE3]]:
        """Return placements of joints in their parents, and of frames in their joints."""
        model = self._mechanism.model
        joints, frames = list(model.jointPlacements), [f.placement for f in model.frames]
        was, moved = list(frames), [False] * len(frames)
        for i, frame in enumerate(model.frames):
            above, is_joint = frame.parentFrame, frame.type == pin.FrameType.JOINT
            words = self._origins.get(frame.name, ()) if frame.type in ORIGINS else ()
            if not any(np.any(w.places >= 0) for w in words) and not (moved[above] and i):
                continue
            old = joints[frame.parentJoint] if is_joint else was[i]
            own = _origin(*(w.at(numbers) for w in words)) if words else was[above].actInv(old)
            if is_joint:
                joints[frame.parentJoint] = frames[above] * own
            else:
                frames[i], moved[i] = frames[above] * own, True
        return joints, frames


ORIGINS = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)


def _origin(xyz: Array, rpy: Array) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*map(float, rpy)), xyz)


def _texts(element: ET.Element) -> list[str]:
    """Return the texts of an element and of those within."""
    return [text for x in element.iter()
            for text in (x.text or "", x.tail or "", *x.attrib.values())]
