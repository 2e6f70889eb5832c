"""The tree of a xacro file with its numbers as functions of dimensions.

The file is expanded once with its dimensions traced (`formats.xacro.tracing`): geometry at many
sets of dimensions is then worked out together. A mechanism there is a copy with other placements of
joints and frames, equal to a loaded one to a last digit or two. Masses are traced likewise. Shapes
cost as much as reading the expanded text: they come from the text with other numbers.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.file_access import parse_urdf
from spatial_pin.formats.importers import Request
from spatial_pin.formats.xacro.expansion import traced
from spatial_pin.formats.xacro.tracing import depends
from spatial_pin.formats.xacro.xacro_arguments import worked_out, written_dimensions
from spatial_pin.mechanism.inertia import inertia_as_given, put_inertias
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array

PLACEMENT_ROUND_OFF = 64 * EPS  # of the largest length: round-off of placements
IDLE_STEP = 0.01  # relative step of a dimension, to find out whether its file changes
WITHOUT_MOTION = ("visual", "collision", "dynamics", "safety_controller", "mass", "inertia")
FIELDS = [field.name for field in fields(Mechanism) if field.init]


def copied(mechanism: Mechanism, **changed: Any) -> Mechanism:
    """Return a mechanism with the same parts except the changed ones."""
    own = mechanism.__dict__  # geometry is left unread
    given = {name: own[name] if name[-6:] == "_model" else getattr(mechanism, name)
             for name in FIELDS}
    return Mechanism(**{**given, **changed})


@made_once
def traced_tree(mechanism: Mechanism, names: tuple[str, ...]) -> TracedTree | None:
    """Return the traced tree of a mechanism; None if its file cannot be traced."""
    try:
        return TracedTree(mechanism, names)
    except (_Untraced, SpatialPinError, ValueError):  # a reference within a longer word
        return None


def near_values(own: float) -> list[float]:
    """Return a dimension, and a value on either side of it."""
    return [own + k * IDLE_STEP * (abs(own) or 1.0) for k in (0, -1, 1)]


class _Untraced(Exception):
    """A part of a mechanism does not follow from the dimensions."""


class PlacementBatch(NamedTuple):
    """Placements at m sets of dimensions, or a constant one."""

    rotation: Array  # (m or 1, 3, 3)
    translation: Array  # (m or 1, 3) [m]

    @classmethod
    def of(cls, placement: pin.SE3) -> PlacementBatch:
        """Return a constant placement."""
        return cls(placement.rotation[None], placement.translation[None])

    @classmethod
    def from_origin(cls, xyz: Array, rpy: Array) -> PlacementBatch:
        """Return placements from origins (m or 1, 3) and roll, pitch, yaw (m or 1, 3)."""
        (a, b, c), (s, t, u) = np.cos(rpy.T), np.sin(rpy.T)  # yaw after pitch after roll
        return cls(np.array([[c * b, c * t * s - u * a, c * t * a + u * s],
                             [u * b, u * t * s + c * a, u * t * a - c * s],
                             [-t, b * s, b * a]]).transpose(2, 0, 1), xyz)

    def at(self, k: int) -> pin.SE3:
        """Return the placement at one set of dimensions."""
        return pin.SE3(*(x[k if len(x) > 1 else 0] for x in self))

    def act(self, points: Array) -> Array:
        """Return points (m or 1, 3) in the parent's axes, from its own axes."""
        m = max(len(self.rotation), len(points))
        turned = np.einsum("mij,mj->mi", np.broadcast_to(self.rotation, (m, 3, 3)),
                           np.broadcast_to(points, (m, 3)))
        return turned + self.translation

    def __matmul__(self, other: PlacementBatch) -> PlacementBatch:
        return PlacementBatch(self.rotation @ other.rotation, self.act(other.translation))


class TracedGeometry(NamedTuple):
    """Geometry at m sets of dimensions; constant parts are left out."""

    holds: NDArray[np.bool_]  # (m,) whether the file's decisions are the same there
    joints: dict[int, PlacementBatch]  # by number in the model, placements in their parents
    frames: dict[int, PlacementBatch]
    turns: dict[int, PlacementBatch]  # by joint, the least rotations from its nominal axis
    levers: dict[str, Array]  # (m or 1, 3) by link, its centre of mass [m]
    limits: dict[tuple[str, int], Array]  # (m,) by bound ("lower" or "upper") and index in q
    inertials: Array  # (k, m) numbers of the inertias of links; empty if not requested

    def joint(self, model: pin.Model, i: int) -> PlacementBatch:
        """Return the placements of a joint in its parent."""
        return self.joints.get(i, PlacementBatch.of(model.jointPlacements[i]))

    def frame(self, model: pin.Model, k: int) -> PlacementBatch:
        """Return the placements of a frame in its joint."""
        return self.frames.get(k, PlacementBatch.of(model.frames[k].placement))

    def idle_axis(self, mechanism: Mechanism, joint: int, ends: Iterable[str]) -> Array:
        """Return the unit axis (m or 1, 3) of an idle rotation between two points on a joint."""
        model, points = mechanism.model, []
        for name in ends:  # as `mechanism.point_on_body`
            k = mechanism.frame_id(name)
            own = model.frames[k].parentJoint
            points.append(self.frame(model, k) if own == joint else self.joint(model, own))
        axis = points[1].translation - points[0].translation
        return axis / np.linalg.norm(axis, axis=1, keepdims=True)


class _Words(NamedTuple):
    """Numbers of an attribute."""

    values: Array  # (k,) at nominal dimensions
    indices: NDArray[np.intp]  # (k,) index of each among the traced numbers, -1 for a constant

    def at(self, numbers: Array) -> Array:
        """Return the numbers (m or 1, k) from traced numbers (n, m)."""
        if not self.vary:
            return self.values[None]
        return np.where(self.indices >= 0, numbers[self.indices].T, self.values)

    @property
    def vary(self) -> bool:
        """Whether one of them depends on dimensions."""
        return bool(np.any(self.indices >= 0))


class TracedText:
    """The expanded text of a tree, with its numbers as functions of dimensions.

    Attributes:
        dimensions: nominal values of the traced dimensions.
    """

    def __init__(self, mechanism: Mechanism, names: Iterable[str]) -> None:
        m, file = mechanism, mechanism.tree
        self.dimensions = {name: m.dimensions[name] for name in names}
        if file is None or file.suffix != ".xacro" or not self.dimensions or written_dimensions(
                m.content, self.dimensions):
            raise _Untraced
        text, self._tape = traced(Request.of(m, file), self.dimensions)
        self._mechanism, self._tape_rows = mechanism, [0]
        self._origins: dict[str, tuple[_Words, _Words]] = {}
        self._axes: dict[int, _Words] = {}
        self._levers: dict[str, _Words] = {}
        self._inertial_tape_rows = [0]
        self._inertials: dict[str, dict[tuple[str, str], _Words]] = {}  # by tag and attribute
        self._limits: dict[str, list[_Words]] = {}
        self._pieces = self._tape.pieces(text)
        for element in parse_urdf(text, file):
            name = element.get("name", "")
            rest = [part for part in element if not self._read_part(element.tag, name, part)]
            if depends(name) or any(depends(
                    [text for x in one.iter() for text in (x.text or "", x.tail or "",
                                                           *x.attrib.values())]) for one in rest):
                raise _Untraced
        if not self._tape.is_whole:
            raise _Untraced

    def _read_part(self, of: str, name: str, part: ET.Element) -> bool:
        """Read a part of a link or joint; return whether it is fully known."""
        if (of, part.tag) == ("joint", "origin"):
            self._origins[name] = self._words(part, "xyz"), self._words(part, "rpy")
        elif (of, part.tag) == ("joint", "axis"):
            self._read_axis(name, self._words(part, "xyz"))
        elif (of, part.tag) == ("joint", "limit"):
            self._limits[name] = [self._words(part, key) for key in ("lower", "upper")]
        elif (of, part.tag) == ("link", "inertial"):
            if name in self._mechanism.content.get("masses", ()):
                return True  # that of the mechanism file counts
            self._inertials[name] = {
                (element.tag, key): self._words(element, key, self._inertial_tape_rows)
                for element in part.iter() for key in element.attrib}
            origin = part.find("origin")
            if origin is not None:
                self._levers[name] = self._words(origin, "xyz")
        else:
            return part.tag in WITHOUT_MOTION
        return True

    def _read_axis(self, joint: str, words: _Words) -> None:
        """Record a traced axis; refuse one that is not the joint's axis."""
        if not words.vary:
            return
        model = self._mechanism.model
        i = model.getJointId(joint) if model.existJointName(joint) else 0
        name = model.joints[i].shortname().removeprefix("JointModel")
        if model.joints[i].nv != 1 or name[0] not in "RP":  # it turns about none, and slides so
            raise _Untraced
        own = model.joints[i].extract()
        axis = np.array(own.axis) if hasattr(own, "axis") else np.eye(3)["XYZ".index(name[-1])]
        if np.abs(axis - _unit(words.values)).max() > PLACEMENT_ROUND_OFF:
            raise _Untraced
        self._axes[i] = words

    def _words(self, element: ET.Element, key: str, at: list[int] | None = None) -> _Words:
        known = self._tape_rows if at is None else at
        words = element.get(key, "0 0 0" if key in ("xyz", "rpy") else "0").split()
        values, indices = [], []
        for word in words:
            number = self._tape.read(word)
            values.append(float(word if number is None else number))
            indices.append(-1 if number is None else len(known))
            known += [] if number is None else [number.row]
        return _Words(np.array(values), np.array(indices, dtype=np.intp))

    def text_at(self, dimensions: Mapping[str, float]) -> str | None:
        """Return the expanded text at other dimensions.

        Returns:
            None if it is not known: the file decides otherwise there, or they are not its
            dimensions.
        """
        if self._pieces is None or not dimensions.keys() <= self.dimensions.keys():
            return None
        between, rows = self._pieces
        given = np.array([[dimensions.get(name, x)] for name, x in self.dimensions.items()])
        numbers, holds = self._tape.at(given, rows)
        if not holds[0]:
            return None
        words = [repr(x) for x in numbers[:, 0].tolist()]
        return "".join(x for pair in zip(between, [*words, ""], strict=True) for x in pair)

    def texts_change(self, names: Sequence[str]) -> dict[str, bool] | None:
        """Return by dimension whether the expanded text changes near its value.

        Returns:
            None if that is not known.
        """
        if self._pieces is None:
            return None
        own = [*self.dimensions.values()]
        given = np.array([[own] * 3] * len(names), dtype=float).reshape(len(names), 3, len(own))
        for k, name in enumerate(names):
            given[k, :, [*self.dimensions].index(name)] = near_values(self.dimensions[name])
        numbers, holds = self._tape.at(given.reshape(-1, len(own)).T, self._pieces[1])
        several = numbers.reshape(-1, len(names), 3)
        changes = np.any(several != several[:, :, :1], axis=(0, 2)) | ~holds.reshape(-1, 3).all(1)
        return dict(zip(names, changes.tolist(), strict=True))


class TracedTree(TracedText):
    """A mechanism's tree at other dimensions.

    Attributes:
        has_masses: whether masses are traced too.
    """

    def __init__(self, mechanism: Mechanism, names: Iterable[str]) -> None:
        super().__init__(mechanism, names)
        # a model that the text alone does not give, such as one with turned joints, is refused
        model, own = mechanism.model, self.own()
        old = [*model.jointPlacements], [frame.placement for frame in model.frames]
        size = max(float(np.abs(x.translation).max()) for x in (*old[0], *old[1]))
        if not own.holds[0] or any(
                np.abs(new.translation - was[i].translation).max() > PLACEMENT_ROUND_OFF * size
                or np.abs(new.rotation - was[i].rotation).max() > PLACEMENT_ROUND_OFF
                for was, new_ones in zip(old, (own.joints, own.frames), strict=True)
                for i, new in new_ones.items()):
            raise _Untraced
        known = mechanism.inertias
        self.has_masses = all(
            name in known and several[0].isApprox(known[name], PLACEMENT_ROUND_OFF)
            for name, several in self.inertias_at(own.inertials).items())

    @property
    def turns_axes(self) -> bool:
        """Whether axes of joints depend on dimensions, which a copy of a model cannot have."""
        return bool(self._axes)

    def own(self) -> TracedGeometry:
        """Return the nominal geometry."""
        return self.at(np.array([[*self.dimensions.values()]]).T, with_masses=True)

    def at(self, given: Array, with_masses: bool = False) -> TracedGeometry:
        """Return the geometry at dimensions (k, m), in the order of `dimensions`."""
        n, heavy = len(self._tape_rows), self._inertial_tape_rows if with_masses else []
        numbers, holds = self._tape.at(np.asarray(given, np.float64), [*self._tape_rows, *heavy])
        numbers, inertials = numbers[:n], numbers[n:]
        model, limits = self._mechanism.model, dict[tuple[str, int], Array]()
        for name, ends in self._limits.items():
            joint = model.joints[model.getJointId(name)] if model.existJointName(name) else None
            for bound, word in zip(("lower", "upper"), ends, strict=True):
                if word.vary and joint is not None and joint.nq == 1 and (
                        getattr(model, f"{bound}PositionLimit")[joint.idx_q] == word.values[0]):
                    limits[bound, joint.idx_q] = word.at(numbers)[:, 0]
        return TracedGeometry(
            holds, *self._placed(numbers),
            {i: _turning(_unit(words.values), _unit(words.at(numbers)))
             for i, words in self._axes.items()},
            {name: words.at(numbers) for name, words in self._levers.items() if words.vary},
            limits, inertials)

    def inertias_at(self, numbers: Array) -> dict[str, list[pin.Inertia]]:
        """Return the inertias of links that depend on dimensions, from traced numbers (k, m).

        There are m of each, or one.
        """
        inertias = {}
        for name, words in self._inertials.items():
            if not any(x.vary for x in words.values()):
                continue
            known = {key: x.at(numbers) for key, x in words.items()}
            xyz, rpy = (known.get(("origin", key), np.zeros((1, 3))) for key in ("xyz", "rpy"))
            mass, *entries = (known.get(key, np.zeros((1, 1)))[:, 0] for key in (
                ("mass", "value"), *(("inertia", f"i{k}") for k in SYMMETRIC)))
            matrix = np.empty((max(map(len, entries)), 3, 3))
            for (i, j), x in zip(SYMMETRIC.values(), entries, strict=True):
                matrix[:, i, j] = matrix[:, j, i] = x
            turn = PlacementBatch.from_origin(xyz, rpy).rotation
            parts = mass, xyz, turn @ matrix @ turn.transpose(0, 2, 1)
            inertias[name] = [inertia_as_given(*(x[k % len(x)] for x in parts))
                              for k in range(max(map(len, parts)))]
        return inertias

    def mechanism_at(
        self, dimensions: Mapping[str, float], geometry: TracedGeometry, k: int
    ) -> Mechanism:
        """Return the mechanism at the k-th of several sets of dimensions."""
        m = self._mechanism
        model, inertias = m.model.copy(), dict(m.inertias)
        for i, pose in geometry.joints.items():
            model.jointPlacements[i] = pose.at(k)
        for i, pose in geometry.frames.items():
            model.frames[i].placement = pose.at(k)
        for (bound, index), values in geometry.limits.items():
            getattr(model, f"{bound}PositionLimit")[index] = values[k]
        for name, lever in geometry.levers.items():
            if name in inertias:
                inertias[name] = inertia_as_given(
                    inertias[name].mass, lever[k], inertias[name].inertia)
        if self.has_masses:
            inertias |= {name: x[0] for name, x in self.inertias_at(
                geometry.inertials[:, k : k + 1]).items()}
            put_inertias(model, inertias)
        other = copied(m, model=model, inertias=inertias,
                       parameters={**m.parameters, **dimensions})
        other.__dict__["dimensions"] = {**m.dimensions, **dimensions}
        written = m.content.get("guess", {})
        if m.path and m.tree and written and written.keys() == m.guess.keys():
            other.__dict__["guess"] = partial(worked_out, written, m.path, "guess",
                                              Request.of(other, m.tree))
        return other

    def _placed(
        self, numbers: Array
    ) -> tuple[dict[int, PlacementBatch], dict[int, PlacementBatch]]:
        """Return placements of joints in their parents, and of frames in their joints."""
        model, joints, frames = self._mechanism.model, {}, dict[int, PlacementBatch]()
        was = [frame.placement for frame in model.frames]
        for i, frame in enumerate(model.frames):
            above, is_joint = frame.parentFrame, frame.type == pin.FrameType.JOINT
            words = self._origins.get(frame.name, ()) if frame.type in ORIGINS else ()
            if not any(w.vary for w in words) and (above not in frames or not i):
                continue
            old = model.jointPlacements[frame.parentJoint] if is_joint else was[i]
            own = (PlacementBatch.from_origin(*(w.at(numbers) for w in words)) if words
                   else PlacementBatch.of(was[above].actInv(old)))
            pose = frames.get(above, PlacementBatch.of(was[above])) @ own
            if is_joint:
                joints[frame.parentJoint] = pose
            else:
                frames[i] = pose
        return joints, frames


# entries of an inertia
SYMMETRIC = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1), "xz": (0, 2), "yz": (1, 2), "zz": (2, 2)}
ORIGINS = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)


def _turning(axis: Array, others: Array) -> PlacementBatch:
    """Return the least rotations from a unit axis (3,) to others (m, 3)."""
    across = np.cross(axis, others)
    x, y, z = across.T
    skew = np.zeros((len(others), 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -z, y, -x
    skew -= skew.transpose(0, 2, 1)
    part = 1.0 / (1.0 + others @ axis)
    return PlacementBatch(np.eye(3) + skew + part[:, None, None] * (skew @ skew), np.zeros((1, 3)))


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
