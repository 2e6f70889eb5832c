"""SDFormat: the links, joints and frames of one model as a joint graph."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from spatial_pin.errors import MechanismFileError, suggestion
from spatial_pin.formats.graph.joint_graph import WORLD, GraphJoint, JointGraph, Link
from spatial_pin.formats.sdf.sdf_elements import (
    MODEL,
    TRUE,
    WORLDS,
    SdfFrames,
    bound,
    is_massless,
    is_true,
    link_elements,
    number,
    number_list,
    pose,
)
from spatial_pin.formats.urdf.elements import by_name, is_prefixed, local, without_it
from spatial_pin.numerics.linalg import Array

OF_MODEL = ("static", "self_collide", "allow_auto_disable", "enable_wind", "frame", "pose", "link",
            "joint", "plugin", "include", "model", "name")
OF_JOINT = ("parent", "child", "pose", "axis", "axis2", "physics", "sensor", "gearbox_ratio",
            "gearbox_reference_body", "thread_pitch", "screw_thread_pitch")
OF_DRAKE = ("weld_constraint", "ball_constraint", "distance_constraint")
JOINERS = re.compile(r"mimic|detachable|attacher|grasp", re.I)  # plugins that join links
DETACHABLE = "detachable"  # in the name or file of the one that holds two links together
OWN = ("", MODEL)  # names of the model that it is in
APART = re.compile(r"collision|filter|friction|gripper|sensor")  # elements that join none
PAIR_OF = {
    "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "screw": "screw",
    "ball": "spherical", "universal": "universal", "revolute2": "universal", "fixed": "fixed",
}
GEARBOX = "gearbox"
AXES = {"axis": "first", "axis2": "second"}  # of joints with two, and how they are called here


def is_detachable(plugin: ET.Element) -> bool:
    """Return whether a plugin is Gazebo's DetachableJoint."""
    called = f"{plugin.get('name', '')} {plugin.get('filename', '')}".lower()
    return DETACHABLE in called and plugin.find("parent_link") is not None


def refuse_include(where: str, uri: str) -> None:
    """Refuse an <include>."""
    raise MechanismFileError(f"{where}: <include> of {uri!r}: models that include others are not "
                             "read; write the included one in its place ('gz sdf -p' does so)")


def unread(model: ET.Element, where: str) -> list[str]:
    """Return the elements of a model that are not read and join nothing."""
    for include in model.findall("include"):
        refuse_include(where, (include.findtext("uri") or "").strip())
    words = []
    for plugin in model.iter("plugin"):
        if is_detachable(plugin):
            continue
        name, file = plugin.get("name", ""), plugin.get("filename", "")
        words.append(f"<plugin name={name!r} filename={file!r}>")
        if JOINERS.search(f"{name} {file}"):
            raise MechanismFileError(f"{where}: {words[-1]} joins links or joints when it runs, "
                                     "which is not read here; write a <joint>, or <mimic>, in its "
                                     f"place, or {without_it(plugin)}")
    names = {x.get("name", "") for tag in ("link", "frame", "joint") for x in model.findall(tag)}
    words += [_unknown(element, names, 2, where) for element in model
              if element.tag not in OF_MODEL and not _is_drakes(element, OF_DRAKE)]
    words += [_unknown(element, names, 1, where) for joint in model.findall("joint")
              for element in joint
              if element.tag not in OF_JOINT and not _is_drakes(element, ("mimic",))]
    return list(dict.fromkeys(words))


def _is_drakes(element: ET.Element, names: tuple[str, ...]) -> bool:
    return is_prefixed(element) and local(element) in names


def _unknown(element: ET.Element, names: set[str], joins: int, where: str) -> str:
    """Refuse an element of another program that names several links, frames or joints."""
    tag = local(element)
    texts = {word for x in element.iter() for word in ((x.text or "").strip(), *x.attrib.values())}
    named = sorted(texts & names)
    if len(named) >= joins and not APART.search(tag):
        raise MechanismFileError(f"{where}: <{tag}> joins {', '.join(map(repr, named))} and is not "
                                 f"read; write a <joint> in its place, or {without_it(element)}")
    return f"<{tag}>"


class SdfModel:
    """Reads one <model>.

    Attributes:
        model: its element.
        where: file and model, for errors.
        version: of SDFormat.
        notices: of changes and omissions.
        links, joints, named: the elements of its links, joints and frames, by name.
        canonical: the link that its own frame moves with.
        frames: all frames.
        frame_of: the name in `frames` of every joint's.
    """

    def __init__(self, model: ET.Element, where: str, version: tuple[int, int]) -> None:
        self.model, self.where, self.version = model, where, version
        self.notices: list[str] = []
        omitted = unread(model, where)
        if omitted:
            self.notices.append(f"not read: {', '.join(omitted)}")
        self.links = by_name(model.findall("link"), "link", where)
        self.joints = by_name(model.findall("joint"), "joint", where)
        self.named = by_name(model.findall("frame"), "frame", where)
        if not self.links:
            raise MechanismFileError(f"{where}: no <link>")
        self.canonical = model.get("canonical_link") or next(iter(self.links))
        if self.canonical not in self.links and "::" not in self.canonical:
            raise MechanismFileError(f"{where}: canonical_link={self.canonical!r}: no such link; "
                                     f"{suggestion(self.canonical, self.links)}")
        self.frames = SdfFrames(where, pin.SE3.Identity())
        self.frame_of: dict[str, str] = {}  # joint -> its frame
        self._put_frames()
        stated = model.find("pose")  # of the model's own frame in the world, or another's
        relative = self.frames.relative_to(stated, "world")
        if relative not in WORLDS:
            raise MechanismFileError(f"{where}: its <pose> is relative to {relative!r}; only to "
                                     "the world can it be read")
        placement = pose(stated, where)
        if by := model.get("placement_frame"):
            placement = placement * self.frames.in_world(by, "placement_frame").inverse()
        self.frames = SdfFrames(where, placement, self.frames.table)

    def _put_frames(self) -> None:
        """Put all frames in one table."""
        groups: tuple[tuple[str, Iterable[tuple[str, ET.Element]]], ...] = (
            ("link", self.links.items()), ("joint", self.joints.items()),
            ("frame", self.named.items()))
        for kind, group in groups:
            for name, element in group:
                key = name
                while key in self.frames.table or key in (MODEL, *WORLDS):
                    if kind != "joint":
                        raise MechanismFileError(
                            f"{self.where}: {kind} {name!r}: another has that name")
                    key += "_joint"  # as SDFormat's own reader calls it
                if kind == "joint":
                    self.frame_of[name] = key
                attached = {
                    "link": name, "joint": (element.findtext("child") or "").strip(),
                    "frame": element.get("attached_to") or MODEL}[kind]
                default = MODEL if kind == "link" else attached
                stated = element.find("pose")
                self.frames.table[key] = (
                    self.frames.relative_to(stated, default),
                    pose(stated, f"{self.where}: {kind} {name!r}"), attached)

    def link_of(self, name: str, asking: str) -> str:
        """Return the link that a link, joint or frame moves with."""
        return self.frames.link(name, asking, self.canonical)

    def graph(self) -> JointGraph:
        """Return links, frames and joints."""
        omitted: list[str] = []
        links, joints = [], []
        links += [self._link(name, element, omitted) for name, element in self.links.items()]
        for name, element in self.joints.items():
            between, several = _joints_of(self, name, element)
            links += between
            joints += several
        for name in self.named:
            links.append(Link(name, self.frames.in_world(name, "frame")))
            at = self.link_of(name, f"frame {name!r}")
            joints.append(GraphJoint(f"{name}_frame", "fixed", at, name, self.on_link(name, at)))
        if omitted:
            self.notices.append(f"not drawn or not weighed: {', '.join(omitted)}")
        bare = [name for name, link in self.links.items() if link.find("inertial") is None]
        if bare:
            self.notices.append(
                f"no <inertial>: {', '.join(bare)}; SDFormat gives them 1 kg and 1 kg·m²")
        weightless = [name for name, link in self.links.items()
                      if (link.findtext("gravity") or "1").strip().lower() not in TRUE]
        if weightless:
            self.notices.append(f"gravity acts on {', '.join(weightless)}, too; the file "
                                "excludes it")
        if is_true(self.model, "static"):
            self.notices.append("the model is static: it is fixed to the world; its joints can "
                                "move all the same")
        return JointGraph(tuple(links), tuple(joints), held=is_true(self.model, "static"))

    def _link(self, name: str, element: ET.Element, omitted: list[str]) -> Link:
        where = f"{self.where}: link {name!r}"

        def placement_of(stated: ET.Element | None, asking: str) -> pin.SE3:
            relative = self.frames.relative_to(stated, name)
            at = pose(stated, asking)
            return at if relative == name else self.on_link(relative, name) * at

        elements = link_elements(element, placement_of, where, omitted)
        massless = is_massless(element, where)
        return Link(name, self.frames.in_world(name, "link"), elements[massless:], massless)

    def on_link(self, name: str, link: str) -> pin.SE3:
        """Return the placement of a frame on a link."""
        relative_to, placement, _ = self.frames.table.get(name, ("", pin.SE3.Identity(), ""))
        if name in self.frames.table and relative_to == link:
            return placement  # every digit of it
        at = self.frames.in_world(name, "pose")
        return at if link == WORLD else self.frames.in_world(link, "pose").inverse() * at

    def direction(self, joint: str, axis: ET.Element, where: str) -> Array:
        """Return an axis (3,) of a joint in the joint's frame."""
        element = axis.find("xyz")
        text = element.text if element is not None else "0 0 1"
        given = number_list(text, 3, f"{where}: <xyz>")
        size = float(np.linalg.norm(given))
        if size < 1e-12:
            raise MechanismFileError(f"{where}: <xyz> is zero")
        own = self.frame_of[joint]
        frame = (element.get("expressed_in") if element is not None else None) or own
        if is_true(axis, "use_parent_model_frame") or self.version < (1, 5):
            frame = MODEL
        if frame != own:
            here, there = (self.frames.in_world(x, f"axis of joint {joint!r}").rotation
                           for x in (own, frame))
            given = here.T @ there @ given
        return given / size


def _joints_of(
    model: SdfModel, name: str, element: ET.Element
) -> tuple[list[Link], list[GraphJoint]]:
    """Return a joint; one with two axes that have limits as two, with a link between."""
    where = f"{model.where}: joint {name!r}"
    kind = element.get("type", "")
    if kind == GEARBOX:
        return [], []
    if kind not in PAIR_OF:
        raise MechanismFileError(f"{where}: SDFormat has no joint type {kind!r}; "
                                 f"{suggestion(kind, (*PAIR_OF, GEARBOX))}")
    ends = [model.link_of((element.findtext(tag) or "").strip(), f"<{tag}> of joint {name!r}")
            for tag in ("parent", "child")]
    if ends[0] == ends[1]:
        raise MechanismFileError(f"{where} joins {ends[0] or 'the world'!r} with itself")
    joint = GraphJoint(name, PAIR_OF[kind], ends[0], ends[1],
                       *(model.on_link(model.frame_of[name], end) for end in ends))
    if kind == "fixed":
        return [], [joint]
    if joint.type == "universal":
        # a universal joint, or two revolute joints where these have limits or springs
        cross = f"{joint.name}.cross"
        first, second = (
            _about(model, replace(joint, name=f"{joint.name}.{AXES[tag]}", type="revolute"),
                   joint.name, element.find(tag), where, tag) for tag in AXES)
        square = abs(first.axis @ second.axis) < 1e-9
        if kind == "universal" and not square:
            raise MechanismFileError(f"{where}: the axes of a universal joint must be "
                                     "perpendicular; \"revolute2\" need not have them so")
        same = first.damping == second.damping and first.friction == second.friction
        if square and same and not any(
                x.is_limited or x.stiffness or math.isfinite(min(x.effort, x.velocity))
                for x in (first, second)):
            return [], [replace(joint, axis=first.axis, axis2=second.axis,
                                           damping=first.damping, friction=first.friction)]
        between = Link(cross, model.frames.in_world(model.frame_of[joint.name], "joint"))
        return [between], [replace(first, child=cross, on_child=pin.SE3.Identity()),
                           replace(second, parent=cross, on_parent=pin.SE3.Identity())]
    joint = _about(model, joint, name, element.find("axis"), where, "axis")
    if joint.type == "screw":
        joint = replace(joint, lead=_lead(element, where))
    if kind == "continuous":
        joint = replace(joint, lower=-math.inf, upper=math.inf)
    return [], [joint]


def _about(
    model: SdfModel, joint: GraphJoint, name: str, axis: ET.Element | None, where: str, tag: str
) -> GraphJoint:
    """Return a joint with the numbers of an <axis> of the file's joint of that name."""
    if joint.type == "spherical":
        dynamics = axis.find("dynamics") if axis is not None else None
        return replace(joint, damping=number(dynamics, "damping", 0.0, where),
                       friction=number(dynamics, "friction", 0.0, where))
    if axis is None:
        raise MechanismFileError(f"{where} needs <{tag}>")
    where = f"{where}: <{tag}>"
    limit, dynamics = axis.find("limit"), axis.find("dynamics")
    effort, velocity = (bound(limit, key, math.inf, where) for key in ("effort", "velocity"))
    return replace(
        joint, axis=model.direction(name, axis, where),
        lower=bound(limit, "lower", -math.inf, where),
        upper=bound(limit, "upper", math.inf, where),
        effort=effort if effort >= 0.0 else math.inf,  # -1 for none
        velocity=velocity if velocity >= 0.0 else math.inf,
        damping=number(dynamics, "damping", 0.0, where),
        friction=number(dynamics, "friction", 0.0, where),
        stiffness=number(dynamics, "spring_stiffness", 0.0, where),
        reference=number(dynamics, "spring_reference", 0.0, where))


def _lead(element: ET.Element, where: str) -> float:
    """Return the lead of a screw [m/turn]; `thread_pitch` is the negative angle per metre."""
    if element.find("screw_thread_pitch") is not None:
        return number(element, "screw_thread_pitch", 1.0, where)
    if element.find("thread_pitch") is None:
        return 1.0
    pitch = number(element, "thread_pitch", 1.0, where)
    if pitch == 0.0:
        raise MechanismFileError(f"{where}: <thread_pitch> is 0 rad/m, a translation without end")
    return -2.0 * math.pi / pitch
