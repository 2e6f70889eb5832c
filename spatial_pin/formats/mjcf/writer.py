"""Writing a mechanism as MJCF, its closures as equalities between sites.

A body stands for every link, its frame the link's. Joints keep their names and coordinates; those
of several coordinates become several joints, named as the coordinates. MuJoCo is not needed.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.output_files import named_path, write_text
from spatial_pin.errors import ClosureTypeError, SpatialPinError, warn
from spatial_pin.formats.file_access import is_file
from spatial_pin.formats.mechanism_writer import tree_axes
from spatial_pin.formats.mjcf.compiling import some
from spatial_pin.formats.mjcf.model_tree import WORLD
from spatial_pin.formats.urdf.elements import (
    UNBOUNDED,
    finite_numbers,
    numbers_text,
    placement,
    unique,
)
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.mechanism.mechanism import Mechanism, rigid_distance
from spatial_pin.mechanism.mechanism_checks import refuse_negative_inertias
from spatial_pin.mechanism.pairs import COUPLING, PAIRS, axes_from_z
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

LEAST_MASS = 1e-9  # of the whole mass: that of a body without mass at an end of the tree
THIN = 1e-6  # of the characteristic length: its radius of gyration
LEAST_MOMENT = 1e-14  # kg·m² and kg: below 1e-15 MuJoCo refuses a body that moves
UNSET = 1e300  # Pinocchio's largest number, or infinity, where there is no limit
HINGE, SLIDE, BALL, FREE = "hinge", "slide", "ball", "free"
MESHES = (".obj", ".stl")  # files that MuJoCo reads
GROUPS = {"visual": {"group": "2", "contype": "0", "conaffinity": "0"},
          "collision": {"group": "3"}}
EQUALITIES = {"spherical": "connect", "weld": "weld", "fixed": "weld"}
COMPOSED = ("prismatic", "cylindrical", "planar", "universal", "screw")
SUFFIXES = (".xml", ".mjcf")
HOME = "home"  # the name of the key


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
        """Give a body the least mass and moments that MuJoCo takes, its own being too small.

        One at an end, which `carries` no mass, gets more, and a warning names it later.
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
    """A joint of MuJoCo: name, type, and axis (3,) in the joint's frame, zero for none."""

    name: str
    kind: str
    axis: Array


def parts_of(name: str, pair: str, axis: Array, axis2: Array) -> list[MjcfJoint]:
    """Return the joints that a pair is made of, in order, named as its coordinates."""
    if pair == "screw":
        return [MjcfJoint(name, HINGE, axis), MjcfJoint(f"{name}.slide", SLIDE, axis)]
    if pair == "spherical":
        return [MjcfJoint(name, BALL, np.zeros(3))]
    if pair == "floating":
        slides = zip("xyz", np.eye(3), strict=True)
        return [*(MjcfJoint(f"{name}.{k}", SLIDE, e) for k, e in slides),
                MjcfJoint(f"{name}.turn", BALL, np.zeros(3))]
    axes = {"universal": [axis, axis2], "planar": list(axes_from_z(axis).T)}.get(pair, [axis, axis])
    return [MjcfJoint(f"{name}.{suffix}" if suffix else name, HINGE if unit == "rad" else SLIDE, e)
            for (suffix, unit), e in zip(PAIRS[pair].coordinates, axes, strict=False)]


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


def _spring(mech: Mechanism, name: str) -> dict[str, str]:
    """Return the one spring that all springs of a coordinate are together."""
    own = [s for s in mech.springs
           if s.joint is not None and mech.coordinate(s.joint).name == name]
    stiffness = sum(s.stiffness for s in own)
    if not stiffness:
        return {}
    free = sum(s.stiffness * s.free for s in own) / stiffness
    return {"stiffness": repr(float(stiffness)), "springref": repr(float(free))}


def add_shapes(document: MjcfDocument) -> None:
    """Add the geoms of all links; tell which meshes MuJoCo cannot read."""
    robot = ET.fromstring(document.mechanism.urdf)
    colours = {m.get("name", ""): m.find("color") for m in robot.iter("material")
               if m.find("color") is not None}
    assets: dict[tuple[str, str], str] = {}
    lost: set[str] = set()
    for link in robot.findall("link"):
        body = document.links.get(link.get("name", ""))
        for kind in GROUPS if body is not None else ():
            for shape in link.findall(kind):
                geom = _geom(document, shape, assets)
                if geom is None:
                    lost.add(shape.find("geometry/mesh").get("filename", ""))  # type: ignore[union-attr]
                    continue
                material = shape.find("material")
                colour = None if material is None else colours.get(material.get("name", ""))
                rgba = {} if colour is None else {"rgba": colour.get("rgba", "")}
                assert body is not None
                ET.SubElement(body, "geom", {**geom, **GROUPS[kind], **rgba})
    if lost:
        some = ", ".join(sorted(Path(x).name for x in lost)[:3])
        warn(f"mechanism {document.mechanism.name!r}: {len(lost)} meshes are not there or in "
             f"formats that MuJoCo does not read ({some}): left out")


def _geom(
    document: MjcfDocument, shape: ET.Element, assets: dict[tuple[str, str], str]
) -> dict[str, str] | None:
    """Return the attributes of the geom of a URDF shape; None for a mesh that is not readable."""
    solid = next(iter(shape.find("geometry")))  # type: ignore[arg-type]
    geom = placed(placement(shape.find("origin"), ""))
    if solid.tag == "mesh":
        file, scale = solid.get("filename", ""), solid.get("scale", "1 1 1")
        if Path(file).suffix.lower() not in MESHES or not is_file(Path(file)):
            return None
        if (file, scale) not in assets:
            assets[file, scale] = unique(Path(file).stem, assets.values())
            ET.SubElement(document.part("asset"), "mesh", name=assets[file, scale], file=file,
                          scale=scale, inertia="shell")
        return {**geom, "type": "mesh", "mesh": assets[file, scale]}
    if solid.tag == "box":
        size = finite_numbers(solid.get("size", ""), 3) / 2.0
    elif solid.tag == "sphere":
        size = finite_numbers(solid.get("radius", ""), 1)
    else:  # cylinder or capsule
        size = np.array([float(solid.get("radius", "")), float(solid.get("length", "")) / 2.0])
    return {**geom, "type": solid.tag, "size": numbers_text(size)}


def add_closures(document: MjcfDocument, q: Array) -> None:
    """Add an equality for every closure."""
    for closure in document.mechanism.closures:
        if closure.type == COUPLING:
            _couple(document, closure)
        elif closure.type in EQUALITIES:
            _equality(document, EQUALITIES[closure.type], closure)
        elif closure.type == "revolute":  # two points of its axis, far apart
            along = np.array([0.0, 0.0, document.mechanism.characteristic_length])
            _equality(document, "connect", closure)
            _equality(document, "connect", closure, "_end", pin.SE3(np.eye(3), along))
        elif closure.type in ("distance", "rope"):
            _rope(document, closure)
        elif closure.type in COMPOSED:
            _compose(document, closure, q)
        else:
            raise ClosureTypeError(
                f"mechanism {document.mechanism.name!r}: closure {closure.name!r} is "
                f"{closure.type}; MuJoCo has no equality that is exactly this")


def _couple(document: MjcfDocument, closure: Closure) -> None:
    """Add the equality of two joints, or a tendon of several whose length is held."""
    names = [document.mechanism.coordinate(name).name for name in closure.joints]
    numbers = closure.numbers
    if "ratio" in numbers:
        document.tie(closure.name, names[1], names[0], closure.ratio, closure.offset)
        return
    if "ratios" in numbers:
        tendon = ET.SubElement(document.part("tendon"), "fixed", name=closure.name)
        for name, ratio in zip(names, closure.ratios, strict=True):
            ET.SubElement(tendon, "joint", joint=name, coef=repr(ratio))
        ends, coefficients = {"tendon1": closure.name}, [-closure.offset]
    else:
        ends = {"joint1": names[1], "joint2": names[0]}
        coefficients = numbers["function"].form.get("polynomial", [0.0] * 6)
        if len(coefficients) > 5:
            raise ClosureTypeError(
                f"mechanism {document.mechanism.name!r}: closure {closure.name!r} is a coupling by "
                f"{numbers['function']}; MuJoCo has polynomials up to degree four")
    ET.SubElement(document.part("equality"), "joint" if "joint1" in ends else "tendon", {
        "name": closure.name, **ends,
        "polycoef": numbers_text(np.array([*coefficients, *[0.0] * (5 - len(coefficients))]))})


def _frames_of(closure: Closure) -> tuple[pin.SE3, pin.SE3]:
    """Return the pair's axes in frame 1 and in frame 2, z its axis."""
    return (pin.SE3(closure.geometry.axes1, np.zeros(3)),
            pin.SE3(closure.geometry.axes2, np.zeros(3)))


def _equality(
    document: MjcfDocument, kind: str, closure: Closure, suffix: str = "",
    shift: pin.SE3 | None = None,
) -> None:
    """Add an equality of sites at a closure's frames, turned to the pair's axes, then shifted."""
    name, sites = f"{closure.name}{suffix}", {}
    ends = zip(closure.frames, _frames_of(closure), strict=True)
    for k, (frame, axes) in enumerate(ends, start=1):
        joint, placement = document.mechanism.frame_on_joint(frame)
        moved = axes if shift is None else axes * shift
        sites[f"site{k}"] = (document.frame(frame) if moved.isIdentity(0.0)
                             else document.site(f"{name}_{k}", joint, placement * moved))
    ET.SubElement(document.part("equality"), kind, {"name": name, **sites})


def _rope(document: MjcfDocument, closure: Closure) -> None:
    """A distance or rope is a straight tendon whose length is held, or is that of another."""
    rest = _tendon(document, closure.name, closure.frames)
    attributes = {"name": closure.name, "tendon1": closure.name}
    length: float | None = closure.numbers.get("length", closure.geometry.length)
    if closure.between:
        length = rigid_distance(*map(document.mechanism.frame_on_joint, closure.between))
    if length is not None:
        offset, ratio = length - rest, 0.0
    else:
        attributes["tendon2"] = f"{closure.name}_other"
        offset, ratio = _tendon(document, attributes["tendon2"], closure.between) - rest, 1.0
    attributes["polycoef"] = numbers_text(np.array([offset, ratio, 0.0, 0.0, 0.0]))
    ET.SubElement(document.part("equality"), "tendon", attributes)


def _tendon(document: MjcfDocument, name: str, frames: tuple[str, ...]) -> float:
    """Add a straight tendon over frames; return its length [m] where joints are at zero."""
    mech = document.mechanism
    tendon = ET.SubElement(document.part("tendon"), "spatial", name=name)
    data = mech.model.createData()
    pin.forwardKinematics(mech.model, data, mech.neutral)
    points = []
    for frame in frames:
        ET.SubElement(tendon, "site", site=document.frame(frame))
        joint, placement = mech.frame_on_joint(frame)
        points.append(data.oMi[joint].act(placement.translation))
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _compose(document: MjcfDocument, closure: Closure, q: Array) -> None:
    """Add a body that moves on frame 1 as the pair does, and weld it to frame 2."""
    mech, geometry = document.mechanism, closure.geometry
    (joint1, at1), (joint2, at2) = (
        (joint, placement * axes) for (joint, placement), axes in
        zip(map(mech.frame_on_joint, closure.frames), _frames_of(closure), strict=True))
    x, y, z = np.eye(3)
    if closure.type == "universal":  # the second pin, z of frame 2, is the body's x
        at2 = at2 * pin.SE3(np.column_stack([z, x, y]), np.zeros(3))
    name = unique(closure.name, [*mech.model.names, *document.links])
    body = ET.SubElement(document.bodies[joint1], "body", placed(at1, name=name))
    data = mech.model.createData()
    pin.forwardKinematics(mech.model, data, q)
    moved = (data.oMi[joint1] * at1).inverse() * data.oMi[joint2] * at2
    parts, turned = parts_of(name, closure.type, z, x), moved.rotation
    turn, (along, across, up) = np.arctan2(turned[1, 0], turned[0, 0]), moved.translation
    coordinates = {"planar": [along, across, turn], "prismatic": [up],
                   "universal": [turn, np.arctan2(turned[2, 1], turned[2, 2])]}.get(
        closure.type, [turn, up])
    add_parts(document, body, parts, np.array(coordinates))
    if closure.type == "screw":
        tie_screw(document, parts, geometry.lead)
    document.least_inertia(name, body)
    site1 = document.new_site(f"{closure.name}_1", -1, pin.SE3.Identity(), body)
    ET.SubElement(document.part("equality"), "weld", name=closure.name, site1=site1,
                  site2=document.site(f"{closure.name}_2", joint2, at2))


def add_springs(document: MjcfDocument) -> None:
    """Add a straight tendon for every spring between two frames."""
    mech = document.mechanism
    for spring in mech.springs:
        if not spring.is_linear:
            raise SpatialPinError(
                f"mechanism {mech.name!r}: spring {spring.name!r} is a bushing, has a law, "
                "or pulls or pushes only; springs of MuJoCo have a stiffness alone: leave it out "
                "of the mechanism, or write a force of your own beside the model")
        if spring.joint is not None:  # told at the joint, if that has one coordinate
            pair = mech.pair_of(mech.coordinate(spring.joint).joint)
            if mech.coordinate(spring.joint).q < 0:
                raise SpatialPinError(
                    f"mechanism {mech.name!r}: spring {spring.name!r} is on one component of a "
                    f"{pair} joint, where MuJoCo has none: leave it out of the mechanism, or "
                    "write a force of your own beside the model")
            continue
        tendon = ET.SubElement(document.part("tendon"), "spatial", {
            "name": spring.name, "stiffness": repr(float(spring.stiffness)),
            "damping": repr(float(spring.damping)),
            "springlength": repr(float(spring.free_length))})
        for frame in spring.frames:
            ET.SubElement(tendon, "site", site=document.frame(frame))


def add_drivers(document: MjcfDocument) -> None:
    """Add a motor for every driver; tell which has none."""
    mech, lost = document.mechanism, []
    for driver in mech.drivers.values():
        name = mech.coordinate(driver.joint).name
        if name in document.joints:
            ET.SubElement(document.part("actuator"), "motor", name=driver.name, joint=name)
        else:
            lost.append(driver.name)
    if lost:
        warn(f"mechanism {mech.name!r}: drivers {', '.join(lost)} turn components of a joint that "
             "has no motor in MuJoCo: left out")


def write_mjcf(mechanism: Mechanism, path: str | Path, q: Array | None = None) -> Path:
    """Write a mechanism as MJCF, its key "home" at q (nq,), see `spatial_pin.export_mjcf`."""
    path = named_path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise SpatialPinError(f"{path}: the name of an MJCF file ends in .xml or .mjcf")
    if mechanism.path is not None and path.resolve() == mechanism.path.resolve():
        raise SpatialPinError(f"{path} is a file of the mechanism itself; choose another")
    if q is None:
        guess = joint_values(mechanism, mechanism.guess)
        q = with_values(mechanism, mechanism.neutral, guess)
    text = mjcf_text(mechanism, q)
    try:
        write_text(path, text)
    except OSError as error:
        raise SpatialPinError(f"cannot write {error.filename}: {error.strerror}") from error
    return path


def mjcf_text(mechanism: Mechanism, q: Array) -> str:
    """Return a mechanism as MJCF text, its key at q (nq,)."""
    refuse_negative_inertias(mechanism)
    document, model = MjcfDocument(mechanism), mechanism.model
    _add_links(document, 0, document.bodies[0])
    waiting = list(model.children[0])
    while waiting:
        i = waiting.pop(0)
        body = ET.SubElement(document.bodies[model.parents[i]], "body",
                             placed(model.jointPlacements[i]))
        document.bodies[i] = body
        add_joints(document, i, body, q)
        _add_links(document, i, body)
        waiting += model.children[i]
    add_shapes(document)
    points = [f.name for f in model.frames if f.type == pin.FrameType.OP_FRAME]
    for name in dict.fromkeys([*mechanism.frames, *points]):
        document.frame(name)
    add_closures(document, q)
    add_springs(document)
    add_drivers(document)
    values = [x for joint in document.parts["worldbody"].iter("joint")
              for x in document.home[joint.get("name", "")]]
    if values:
        ET.SubElement(document.part("keyframe"), "key", name=HOME,
                      qpos=numbers_text(np.array(values)))
    if document.light:
        warn(f"mechanism {mechanism.name!r}: MuJoCo moves no body without mass and moments of "
             f"inertia: {some(document.light)} have got as much as nobody feels")
    if mechanism.passives:
        spins = some(passive.name for passive in mechanism.passives)
        warn(f"mechanism {mechanism.name!r}: passive spins ({spins}) are free in MuJoCo")
    touching = [closure.name for closure in mechanism.closures if closure.acts_at is not None]
    if touching:
        warn(f"mechanism {mechanism.name!r}: forces of teeth and strands ({some(touching)}) act at "
             "joints in MuJoCo, not on bearings")
    ET.indent(document.root)
    return ET.tostring(document.root, encoding="unicode") + "\n"


def _add_links(document: MjcfDocument, i: int, body: ET.Element) -> None:
    """Add the links of tree joint i: one is its body, the others are fixed in that."""
    mech = document.mechanism
    frames = [f for f in mech.model.frames
              if f.type == pin.FrameType.BODY and f.parentJoint == i]
    own = [f.name for f in frames  # the body of the joint; the world's only where it has its name
           if (f.placement.isIdentity(0.0) if i > 0 else f.name == WORLD)][:1]
    name = own[0] if own else mech.model.names[i]
    if i > 0:
        body.set("name", _unlike_world(name))
    inertias = {}
    for frame in frames:
        document.links[frame.name] = body if [frame.name] == own else ET.SubElement(
            body, "body", placed(frame.placement, name=_unlike_world(frame.name)))
        inertias[frame.name] = mech.inertias.get(frame.name, pin.Inertia.Zero())
    if i > 0 and not any(map(is_movable, inertias.values())):
        carries = any(mech.model.inertias[k].mass for k in mech.model.subtrees[i].tolist()[1:])
        document.least_inertia(name, body, inertias.pop(name, None), carries=carries)
    for link, inertia in inertias.items():
        element = document.links[link]
        if element.tag == "body" and (inertia.mass or np.any(inertia.inertia)):
            document.inertia(element, inertia)


def _unlike_world(name: str) -> str:
    return f"{name}_link" if name == WORLD else name  # MuJoCo keeps that name for itself
