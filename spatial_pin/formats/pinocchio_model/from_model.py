"""Mechanisms made in code: a Pinocchio model and closures between its frames.

In their URDF text every joint hangs on the link of its parent joint, and every other link on the
link of its joint, so that all numbers but angles of rotation are in the text as in the model.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from spatial_pin._support.checks import finite_array, number_from_zero
from spatial_pin.errors import SpatialPinError, warn
from spatial_pin.formats.file_access import is_file
from spatial_pin.formats.pinocchio_model.pair_tree import (
    check_placement,
    joint_axis,
    own_configuration,
    pair_tree,
)
from spatial_pin.formats.urdf.elements import (
    finite_text,
    fresh,
    inertial,
    joint_element,
    numbers_text,
    shape_element,
)
from spatial_pin.mechanism.closures import FrameSpec, of_native
from spatial_pin.mechanism.coordinates import check_guess, joint_vector
from spatial_pin.mechanism.inertia import remainder
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.mechanism_checks import check_mechanism, sided
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.mechanism.parts import (
    Closure,
    Driver,
    Frame,
    Passive,
    Spring,
    add_frames,
    drivers_of_tree,
    frames_by_name,
)

GROUND = "world"  # the link for the world
UNIVERSE = "universe"  # what Pinocchio calls it
WHERE = "from_model"


class LinkTree:
    """The links of a model; missing ones are added to it.

    Then every joint has its frame and a link, and every other link a fixed joint.

    Attributes:
        mains: by joint, the link whose axes are the joint's; of the universe the root.
        mounts: by link, the fixed joint that carries it; of all other links.
    """

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        frames = list(model.frames)
        self._taken = {f.name for f in frames} | set(model.names)
        self._not_joints = {f.name for f in frames if f.type != pin.FrameType.JOINT}
        self._joint_frames = {f.name: k for k, f in enumerate(frames)
                              if f.type == pin.FrameType.JOINT}
        self._used = {0}
        links: list[list[int]] = [[] for _ in model.names]
        for k, frame in enumerate(frames):
            if frame.type == pin.FrameType.BODY:
                links[frame.parentJoint].append(k)
        self.mounts: dict[str, str] = {}
        self.mains = tuple(self._complete(i, own) for i, own in enumerate(links))

    def _add(self, name: str, joint: int, above: int, placement: pin.SE3,
             kind: pin.FrameType) -> int:
        return int(self._model.addFrame(pin.Frame(name, joint, above, placement, kind), False))

    def _complete(self, i: int, links: Iterable[int]) -> str:
        """Return the link whose axes are those of joint i; a new one is named as the joint."""
        model, here = self._model, pin.SE3.Identity()
        joint = str(model.names[i])
        above = self._joint_frames.get(joint) if i else 0
        if above is None:
            above = self._add(joint, i, 0, here, pin.FrameType.JOINT)
        main = next((k for k in links if model.frames[k].placement.isIdentity(0.0)), None)
        if main is None:
            name = joint if i and joint not in self._not_joints else fresh(
                f"{joint}_link" if i else GROUND, self._taken)
            main = self._add(name, i, above, here, pin.FrameType.BODY)
        for link in (model.frames[k] for k in links if k != main):
            mount, named = model.frames[link.parentFrame], str(link.name)  # new frames move these
            if link.parentFrame in self._used or mount.type != pin.FrameType.FIXED_JOINT \
                    or mount.parentJoint != link.parentJoint or mount.name in self._joint_frames \
                    or mount.placement != link.placement:
                self.mounts[named] = fresh(f"{named}_mount", self._taken)
                self._add(self.mounts[named], i, 0, link.placement, pin.FrameType.FIXED_JOINT)
            else:
                self._used.add(link.parentFrame)
                self.mounts[named] = str(mount.name)
        return str(model.frames[main].name)


def urdf_of(mechanism: Mechanism, bodies: LinkTree) -> str:
    """Return the open tree as URDF text; shapes that URDF lacks are left out, with a warning."""
    model = mechanism.model
    robot = ET.Element("robot", name=mechanism.name)
    links = {name: ET.SubElement(robot, "link", name=name) for name in mechanism.links}
    for name, inertia in mechanism.inertias.items():
        links[name].append(inertial(inertia))
    for kind, shapes in (("visual", mechanism.visual_model),
                         ("collision", mechanism.collision_model)):
        for shape in shapes.geometryObjects:
            solid = _solid(shape)
            if solid is None:
                warn(f"mechanism {mechanism.name!r}: {kind} {shape.name!r} is a "
                     f"{type(shape.geometry).__name__} without a file, which URDF does not have: "
                     "it is drawn, but `save` leaves it out")
                continue
            link = bodies.mains[shape.parentJoint]
            frame = model.frames[shape.parentFrame] if shape.parentFrame < model.nframes else None
            if frame is not None and frame.type == pin.FrameType.BODY \
                    and frame.parentJoint == shape.parentJoint:
                link = frame.name
            at = mechanism.frame_on_joint(link)[1].actInv(shape.placement)
            colour = np.clip(shape.meshColor, 0.0, 1.0) if kind == "visual" else None
            links[link].append(shape_element(kind, at, solid, colour, f"{shape.name}_colour"))
    for i in range(1, model.njoints):
        _add_joint(mechanism, bodies, robot, i)
    for link, mount in bodies.mounts.items():
        joint, placement = mechanism.frame_on_joint(link)
        joint_element(robot, mount, "fixed", bodies.mains[joint], link, placement)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode")


def _add_joint(mechanism: Mechanism, bodies: LinkTree, robot: ET.Element, i: int) -> None:
    model, pair = mechanism.model, mechanism.pairs[i - 1]
    q, v = model.idx_qs[i], model.idx_vs[i]
    low, high = float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q])
    kind = pair if pair in ("revolute", "prismatic") else "floating"
    if pair == "revolute" and np.isinf([low, high]).all():
        kind = "continuous"
    element = joint_element(robot, model.names[i], kind, bodies.mains[model.parents[i]],
                            bodies.mains[i], model.jointPlacements[i])
    if PAIRS[pair].freedom != 1:
        return
    if kind != "floating":
        joint = model.joints[i].extract()
        ET.SubElement(element, "axis", xyz=numbers_text(joint_axis(joint)))
    bounds = {} if kind == "continuous" else {"lower": low, "upper": high}
    bounds |= {"effort": model.upperEffortLimit[v], "velocity": model.upperVelocityLimit[v]}
    if kind != "continuous" or np.isfinite(list(bounds.values())).any():
        ET.SubElement(element, "limit", {key: finite_text(x) for key, x in bounds.items()})
    resisting = {"damping": model.damping[v], "friction": model.upperDryFrictionLimit[v]}
    if any(resisting.values()):
        ET.SubElement(element, "dynamics", {k: repr(float(x)) for k, x in resisting.items()})


def _solid(shape: Any) -> ET.Element | None:
    """Return a shape as URDF has it, None where it does not."""
    geometry, kind = shape.geometry, type(shape.geometry).__name__
    if kind == "Box":
        return ET.Element("box", size=numbers_text(2.0 * geometry.halfSide))
    if kind == "Sphere":
        return ET.Element("sphere", radius=repr(float(geometry.radius)))
    if kind in ("Cylinder", "Capsule"):
        return ET.Element(kind.lower(), radius=repr(float(geometry.radius)),
                          length=repr(2.0 * float(geometry.halfLength)))
    if shape.meshPath and is_file(Path(shape.meshPath)):
        return ET.Element("mesh", filename=str(Path(shape.meshPath).resolve()),
                          scale=numbers_text(shape.meshScale))
    return None


def mechanism_of(
    given: pin.Model, closures: Iterable[Any], drivers: Mapping[str, str] | Iterable[str] | None,
    springs: Iterable[Spring], passives: Iterable[Passive], guess: Mapping[str, Any] | ArrayLike,
    frames: Mapping[str, tuple[str, pin.SE3]], name: str | None,
    visual: pin.GeometryModel | None, collision: pin.GeometryModel | None, gap: float | None,
) -> Mechanism:
    """Return the mechanism of a model; see `Mechanism.from_model`."""
    if not isinstance(given, pin.Model):
        raise TypeError(f"a pin.Model is needed, not {type(given).__name__}")
    title = given.name if name is None else name
    if not isinstance(title, str) or not title.isprintable():
        raise TypeError(f"name is text that can be read, not {title!r}")
    title = title or "mechanism"
    where = f"{WHERE} {title!r}"
    model, pairs, mimics = pair_tree(given, where)
    bodies = LinkTree(model)
    names = _FrameNames(model, bodies, where)
    names.keep_frames()
    if frames is not None and not isinstance(frames, Mapping):
        raise TypeError(f"frames is a dict by name, not {type(frames).__name__}")
    for key, frame in (frames or {}).items():
        names.add(key, frame)
    closed = names.closures([*_several(closures, "closures"), *mimics])
    sprung = [replace(s, frames=names.named(s.frames, s.name))
              for s in _all(springs, Spring, "springs")]
    resolved = [replace(p, axis=names.named(p.axis, p.name))
                for p in _all(passives, Passive, "passives")]
    names.put()
    by_joint = dict(zip(list(model.names)[1:], pairs, strict=True))
    driven = drivers_of_tree(by_joint, closed) if drivers is None else _drivers(drivers)
    made = Mechanism(
        name=title, model=model, visual_model=_shapes(visual, model, "visual_model"),
        collision_model=_shapes(collision, model, "collision_model"), pairs=pairs,
        closures=closed, drivers=driven, springs=tuple(sprung),
        passives=tuple(resolved), inertias=_inertias(model), frames=names.frames,
        gap=None if gap is None else number_from_zero(gap, "gap"))
    made.characteristic_length  # noqa: B018 - refused here where it is no number
    check_mechanism(made, where)
    made = made.with_fields(guess=_guess(given, made, guess), urdf=urdf_of(made, bodies))
    check_guess(made, where)
    return sided(made)


def _guess(
    given: pin.Model, made: Mechanism, guess: Mapping[str, Any] | ArrayLike
) -> dict[str, Any]:
    """Return a guess by joint; it may be a configuration of the model."""
    if isinstance(guess, Mapping):
        for key, value in guess.items():
            finite_array(value, np.shape(value), f"guess: {key!r}")
        return dict(guess)
    q = own_configuration(given, made.model, finite_array(guess, (given.nq,), "guess"))
    vectors = {name: joint_vector(made, q, name) for name in list(made.model.names)[1:]}
    return {name: float(x[0]) if len(x) == 1 else x.tolist() for name, x in vectors.items()}


def _several(values: Any, what: str) -> list[Any]:
    if values is None:
        return []
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise TypeError(f"{what} is a list, not {str(values)[:40]!r}")
    return list(values)


def _all(values: Any, kind: type, what: str) -> list[Any]:
    entries = _several(values, what)
    for value in entries:
        if not isinstance(value, kind):
            raise TypeError(f"{what} is a list of sp.{kind.__name__}, not of "
                            f"{type(value).__name__}")
    return entries


def _drivers(given: Any) -> dict[str, Driver]:
    if not isinstance(given, Mapping):
        given = {joint: joint for joint in _several(given, "drivers")}
    for name, joint in given.items():
        if not (isinstance(name, str) and isinstance(joint, str)):
            raise TypeError(f"drivers is a dict of joints by name, or a list of joints, not of "
                            f"{name!r}: {joint!r}")
    return {name: Driver(name, joint) for name, joint in given.items()}


def _shapes(given: pin.GeometryModel | None, model: pin.Model, what: str) -> pin.GeometryModel:
    if given is None:
        return pin.GeometryModel()
    if not isinstance(given, pin.GeometryModel):
        raise TypeError(f"{what} is a pin.GeometryModel, not {type(given).__name__}")
    for shape in given.geometryObjects:
        if shape.parentJoint >= model.njoints:
            raise SpatialPinError(f"{what}: {shape.name!r} is on joint {shape.parentJoint}, which "
                                  "the model does not have")
    return given.copy()


def _inertias(model: pin.Model) -> dict[str, pin.Inertia]:
    """Return the own inertia of every link that has one.

    Frames keep the inertia that they were added with; the rest of a joint's inertia, as after
    `appendBodyToJoint`, belongs to its first link. What a joint carries is what counts.
    """
    links: list[list[pin.Frame]] = [[] for _ in range(model.njoints)]
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links[frame.parentJoint].append(frame)
    inertias = {}
    for total, own in zip(model.inertias, links, strict=True):
        first = own[0]
        parts = {f.name: f.inertia for f in own if f.inertia.mass or np.any(f.inertia.inertia)}
        placed = [f.placement.act(parts[f.name]) for f in own if f.name in parts]
        rest = remainder(total, placed)
        if rest is None:
            parts, rest = {}, total
        if rest.mass or np.any(rest.inertia):
            mine = first.placement.actInv(rest) if not first.placement.isIdentity(0.0) else rest
            parts[first.name] = parts[first.name] + mine if first.name in parts else mine
        inertias.update({k: pin.Inertia(x) for k, x in parts.items()})
    return inertias


class _FrameNames:
    """Gives names to frames that are given by a placement, and to closures that have none."""

    def __init__(self, model: pin.Model, bodies: LinkTree, where: str) -> None:
        self.model, self.bodies, self.where = model, bodies, where
        self.taken = {f.name for f in model.frames} | set(model.names)
        self.frames: dict[str, Frame] = {}
        self.new: dict[str, Frame] = {}

    def keep_frames(self) -> None:
        """List the frames of the model that are neither links nor joints."""
        known = frames_by_name(self.model)
        own = {*self.bodies.mains, *self.bodies.mounts.values(), *self.model.names}
        for k, frame in enumerate(self.model.frames):
            is_part = k == 0 or frame.type == pin.FrameType.BODY or frame.name in own
            other = self.model.frames[known[frame.name]] if k else frame
            if (other.parentJoint, other.placement) != (frame.parentJoint, frame.placement) \
                    and frame.type not in (pin.FrameType.BODY, pin.FrameType.JOINT):
                raise SpatialPinError(f"{self.where}: two frames are named {frame.name!r} and "
                                      "have different placements; rename one")
            if not is_part:
                self.frames[frame.name] = _frame(
                    frame.name, self.bodies.mains[frame.parentJoint], frame.placement)

    def add(self, name: str, frame: Any) -> None:
        """Add a frame of the caller by its name."""
        is_pair = isinstance(frame, tuple | list) and len(frame) == 2
        link, placement = frame if is_pair else (frame, pin.SE3.Identity())
        if not (isinstance(name, str) and isinstance(link, str) and isinstance(placement, pin.SE3)):
            raise TypeError(f"frames: {name!r} is given as (link or joint, pin.SE3), not "
                            f"{str(frame)[:60]!r}")
        self.new[name] = _frame(name, self.link(link), placement)
        self.taken.add(name)

    def link(self, name: str) -> str:
        """Return the name of a link or joint; the universe's is that of the root link."""
        return self.bodies.mains[0] if name == UNIVERSE else name

    def named(self, frames: Iterable[FrameSpec], owner: str) -> tuple[str, ...]:
        """Return the names of frames; those that have none are called after their owner."""
        names = []
        for k, frame in enumerate(frames, 1):
            on, placement = (frame, None) if isinstance(frame, str) else frame
            names.append(self.link(on))
            if placement is not None and not placement.isIdentity(0.0):
                names[-1] = fresh(f"{owner}_{k}", self.taken)
                self.new[names[-1]] = _frame(names[-1], self.link(on), placement)
        return tuple(names)

    def closures(self, given: Iterable[Any]) -> tuple[Closure, ...]:
        """Return closures between frames that have names, each with a name of its own."""
        taken, named = set(self.model.names), []
        for one in given:
            closure = one if isinstance(one, Closure) else of_native(one, self.bodies.mains)
            name = fresh(closure.name or closure.type, taken)
            ends = self.named(closure.frames, name)
            between = self.named(closure.between, f"{name}_between")
            numbers = {key: replace(x, frame=self.link(x.frame))
                       if x is closure.acts_at and x is not None else x
                       for key, x in closure.numbers.items()}
            named.append(replace(closure, name=name, frames=ends, between=between,
                                 numbers=numbers))
        return tuple(named)

    def put(self) -> None:
        """Put the new frames into the model."""
        add_frames(self.model, self.new, self.where)
        self.frames.update(self.new)


def _frame(name: str, link: str, placement: pin.SE3) -> Frame:
    check_placement(placement, f"frame {name!r}: its placement")
    x, y, z = (placement.translation + 0.0).tolist()  # no -0.0
    roll, pitch, yaw = (pin.rpy.matrixToRpy(placement.rotation) + 0.0).tolist()
    return Frame(name, link, (x, y, z), (roll, pitch, yaw))
