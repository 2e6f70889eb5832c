"""Kinematic pairs, each as a tree joint and as a loop closure.

To add a pair, add one entry to `PAIRS`:

1. `freedom`: relative freedoms it leaves between its two bodies.
2. `rows`: a function of a `Closure` that returns its equations, 6 - freedom of them, independent
   wherever they hold. They are sums of quantities, see `spatial_pin.mechanism.equations`.
3. `joint`: a function (axis, axis2, lead) to a Pinocchio joint model, None where the pair only
   closes loops, with `coordinates` (suffix, unit) in the order of its velocity vector.
4. `aligned`: which axes ("z", "xyz"; "tangent": z along that of a curve) must point the same way
   when closed: product equations have mirror roots, and assembly refuses them.
5. `n_frames`, `n_joints`: how many frames it joins, two as a rule, and of how many joints it has
   the coordinates; at least, if it `has_more` of them.
6. `keys`: its own numbers in a mechanism file, which a `Closure` has in `numbers`, and `fault`: a
   function of a `Closure` that returns a key and its fault, or None.
7. `at_guess`: a function of a `Closure`, the placement of frame 2 on frame 1 in the guess, and
   whether there is a guess; returns numbers that this decides, as on which side a cam touches.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.curve_rows import along_curve, follows, on_curve, touching
from spatial_pin.mechanism.curves import CurveShape, follower_of, named_curve, two_curves
from spatial_pin.mechanism.equations import (
    Angle,
    ConstraintEquation,
    Cosine,
    Displacement,
    FunctionOf,
    JointCoordinate,
    PointDistance,
    Square,
)
from spatial_pin.mechanism.force_paths import strands_of, teeth_of
from spatial_pin.mechanism.functions import function_of
from spatial_pin.numerics.linalg import EPS, Array
from spatial_pin.numerics.taylor import Taylor
from spatial_pin.numerics.tolerances import TOLERANCES

X, Y, Z = np.eye(3)


@dataclass(frozen=True, eq=False)
class PairGeometry:
    """Axes of a pair in its two frames, its length and its lead.

    Attributes:
        axes1: (3, 3) the pair's x, y, z in columns, in the axes of frame 1; z is the pair's axis.
        axes2: (3, 3) the same in the axes of frame 2.
        length: distance between the origins [m] (distance; 0 where two other frames give it).
        lead: translation per turn [m] (screw).
    """

    axes1: Array
    axes2: Array
    length: float = 0.0
    lead: float = 0.0


class ClosureData(Protocol):
    """The data of a closure's equations; `Closure` has them."""

    @property
    def geometry(self) -> PairGeometry:
        """Axes, length and lead."""

    @property
    def numbers(self) -> Mapping[str, Any]:
        """Its numbers, or (n,) of lists, by their keys in a mechanism file."""

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of frames."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of joint coordinates."""


@dataclass(frozen=True)
class Key:
    """A key of a closure type in a mechanism file: a number, a list, or a table.

    Attributes:
        name: the key.
        default: where it is left out; None: it must be there.
        no_zero: what to do instead of zero; "": it may be zero.
        is_list: whether it is a list of numbers.
        read: makes what it is from its table, which that has in `form`; None: numbers.
        instead_of: keys that it takes the place of; it may be left out.
        is_optional: whether it may be left out anyway.
    """

    name: str
    default: float | None = None
    no_zero: str = ""
    is_list: bool = False
    read: Callable[[Any, Any], Any] | None = None
    instead_of: tuple[str, ...] = ()
    is_optional: bool = False


@dataclass(frozen=True)
class Pair:
    """One entry of `PAIRS`; see the module's docstring."""

    freedom: int
    rows: Callable[[ClosureData], tuple[ConstraintEquation, ...]] | None
    joint: Callable[[Array, Array, float], pin.JointModel] | None = None
    coordinates: tuple[tuple[str, str], ...] = ()
    aligned: str = ""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    uses_axis: bool = True
    uses_axis2: bool = False
    uses_lead: bool = False
    uses_length: bool = False
    native: pin.ContactType | None = None
    n_frames: int = 2
    n_joints: int = 0  # whose coordinates are in its equations
    has_more: bool = False  # frames, or joints where it has no frames
    keys: tuple[Key, ...] = ()  # besides axes, length and lead
    fault: Callable[[ClosureData], tuple[str, str] | None] = lambda _: None
    at_guess: Callable[[ClosureData, pin.SE3, bool], dict[str, Any]] | None = None

    @cached_property
    def is_linear(self) -> bool:
        """Whether the velocity vector is the time derivative of the coordinates."""
        return not any(suffix in ("z", "rz") for suffix, _ in self.coordinates)

    def file_entries(
        self, axis: Array, axis2: Array, lead: float = 0.0, length: float = 0.0
    ) -> dict[str, Any]:
        """Return the keys and values of its geometry in a mechanism file."""
        known = {"axis": axis.tolist(), "axis2": axis2.tolist(), "lead": lead, "length": length}
        return {key: x for key, x in known.items() if getattr(self, f"uses_{key}")}


def unit(axis: Array) -> Array:
    """Return a direction (3,) as a unit vector; one that is one to round-off stays as it is."""
    norm = math.hypot(*axis)  # of numbers of any size
    if math.isinf(norm):
        axis = axis / np.abs(axis).max()
        norm = math.hypot(*axis)
    return axis if abs(norm - 1.0) <= 4.0 * EPS else axis / norm


def axes_from_z(axis: Array) -> Array:
    """Return the rotation (3, 3) that takes z to the unit vector `axis` by the shortest way."""
    if axis[2] <= -1.0 + TOLERANCES.last_digit:
        return np.diag([1.0, -1.0, -1.0])
    axes: Array = pin.Quaternion.FromTwoVectors(Z, axis).normalized().matrix()
    axes[:, 2] = axis  # as it was given, so that a written file equals the file read
    return axes


def closure_geometry(
    pair: Pair, axis: Array | None = None, axis2: Array | None = None, *, length: float = 0.0,
    lead: float = 0.0,
) -> PairGeometry:
    """Return the geometry of a closure; axes that are not given are the pair's own.

    The axis, a unit vector (3,), is that in frame 1, and in frame 2 unless there is another. The
    length is in [m], the lead in [m per turn].
    """
    if not pair.uses_axis:
        return PairGeometry(np.eye(3), np.eye(3), length, lead)
    first = np.array(pair.axis) if axis is None else axis
    second = first
    if pair.uses_axis2:
        second = (Y if pair.axis[0] else first) if axis2 is None else axis2
    return PairGeometry(axes_from_z(first), axes_from_z(second), length, lead)


def revolute_joint(axis: Array, *_: object) -> pin.JointModel:
    """Return the cheapest one-coordinate revolute joint about the unit vector `axis`."""
    return _along_an_axis(axis, (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
                          pin.JointModelRevoluteUnaligned)


def prismatic_joint(axis: Array, *_: object) -> pin.JointModel:
    """Return the cheapest prismatic joint along the unit vector `axis`."""
    return _along_an_axis(axis, (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
                          pin.JointModelPrismaticUnaligned)


def _along_an_axis(axis: Array, aligned: tuple[Any, ...], other: Any) -> pin.JointModel:
    """Return the joint of x, y or z, if the axis is that as nearly as Pinocchio's readers ask."""
    for e, model in zip((X, Y, Z), aligned, strict=True):
        if np.abs(axis - e).max() <= TOLERANCES.tight:
            return model()
    return other(axis)


def _composite(*joints: pin.JointModel) -> pin.JointModel:
    composite = pin.JointModelComposite()
    for joint in joints:
        composite.addJoint(joint)
    return composite


def _planar_joint(axis: Array, *_: object) -> pin.JointModel:
    x, y, z = axes_from_z(axis).T
    return _composite(prismatic_joint(x), prismatic_joint(y), revolute_joint(z))


Rows = tuple[ConstraintEquation, ...]


def _in_planes(*normals: Array) -> Rows:
    """Return equations u . d = 0: origin 2 in planes through origin 1."""
    return tuple(ConstraintEquation(((1.0, (Displacement(u),)),), is_length=True) for u in normals)


def _at_right_angles(*directions: tuple[Array, Array]) -> Rows:
    """Return equations u . w = 0 of directions in frame 1 and in frame 2."""
    return tuple(ConstraintEquation(((1.0, (Cosine(u, w),)),)) for u, w in directions)


def _coincident(c: ClosureData) -> Rows:
    return _in_planes(*c.geometry.axes1.T)


def _on_line(c: ClosureData) -> Rows:
    return _in_planes(*c.geometry.axes1.T[:2])


def _on_plane(c: ClosureData) -> Rows:
    return _in_planes(c.geometry.axes1[:, 2])


def _parallel(c: ClosureData) -> Rows:
    (x1, y1, _), z2 = c.geometry.axes1.T, c.geometry.axes2[:, 2]
    return _at_right_angles((x1, z2), (y1, z2))


def _same_orientation(c: ClosureData) -> Rows:
    (x1, y1, z1), (x2, y2, z2) = c.geometry.axes1.T, c.geometry.axes2.T
    return _at_right_angles((x1, y2), (y1, z2), (z1, x2))


def _perpendicular(c: ClosureData) -> Rows:
    return _at_right_angles((c.geometry.axes1[:, 2], c.geometry.axes2[:, 2]))


def _distance(c: ClosureData) -> Rows:
    """(d . d - L^2) / 2L = 0; L = 0: the distance of the other two frames."""
    length = c.geometry.length
    other = (-0.5 * length, ()) if length else (-1.0, (Square(None, (2, 3)),))
    return (ConstraintEquation(((1.0, (Square(length or None),)), other), is_length=True),)


def _screw(c: ClosureData) -> Rows:
    """The slide is what the pitch [m/rad] makes of the angle about z."""
    one, two = c.geometry.axes1, c.geometry.axes2
    turning = (-c.geometry.lead / (2.0 * np.pi), (Angle(one, two),))
    return (ConstraintEquation(((1.0, (Displacement(one[:, 2]),)), turning), is_length=True),)


def _coupling(c: ClosureData) -> Rows:
    """Equations of the unit of the last coordinate."""
    if "function" in c.numbers:
        of = FunctionOf(c.numbers["function"].curve, JointCoordinate(0))
        return (ConstraintEquation(((1.0, (JointCoordinate(1),)), (-1.0, (of,)))),)
    if "ratios" in c.numbers:
        last = c.numbers["ratios"][-1]
        ratios, offset = c.numbers["ratios"] / last, c.numbers["offset"] / last
    else:
        ratios, offset = [-c.numbers["ratio"], 1.0], -c.numbers["offset"]
    terms = ((float(ratio), (JointCoordinate(k),)) for k, ratio in enumerate(ratios))
    return (ConstraintEquation((*terms, (offset, ()))),)


def _fault_of_coupling(c: ClosureData) -> tuple[str, str] | None:
    n, ratios = len(c.joints), c.numbers.get("ratios")
    if ratios is None:
        one = "function" if "function" in c.numbers else "ratio"
        return None if n == 2 else (
            "joints", f"are {n}; a coupling by a {one} has two (more have ratios)")
    if len(ratios) != n:
        return "ratios", f"are {len(ratios)} for {n} joints; each joint has one"
    if not np.all(ratios):
        return "ratios", "has a zero; leave that joint out"
    return None


def _frame_on_curve(c: ClosureData) -> Rows:
    curve = c.numbers["curve"]
    return *on_curve(curve), *along_curve(curve, Z)


def _cam(c: ClosureData) -> Rows:
    follower = c.numbers["follower"]
    across = Z if follower.flat is None else axes_from_z(follower.flat)[:, 0]
    return follows(c.numbers["curve"], follower, across)


def _fault_of_cam(c: ClosureData) -> tuple[str, str] | None:
    """Whether a cam is a profile that its follower fits."""
    fault = _fault_of_profile(c.numbers["curve"])
    if fault:
        return "curve", fault
    try:
        _cam(c)
    except ValueError as error:
        return "follower", str(error)
    return None


def _fault_of_profiles(c: ClosureData) -> tuple[str, str] | None:
    """Whether both curves are profiles."""
    curves = c.numbers["curves"]
    fault = _fault_of_profile(curves.one) or _fault_of_profile(curves.two)
    return ("curves", fault) if fault else None


def _fault_of_profile(curve: CurveShape) -> str:
    if not (curve.is_closed and curve.is_plane):
        return "of a cam is closed and in a plane: a circle, an ellipse or points"
    return "of a cam crosses itself" if curve.path is not None and curve.crosses_itself() else ""


def _sided_follower(c: ClosureData, placed: pin.SE3, has_guess: bool) -> dict[str, Any]:
    """Return the follower on the side of its cam that the guess shows, a roller without outside."""
    curve, follower = c.numbers["curve"], c.numbers["follower"]
    apart, side = placed.translation - curve.centre, 1
    x, y, _ = curve.axes.T @ apart
    if follower.flat is not None:
        side = -1 if float(apart @ (placed.rotation @ follower.flat)) < 0.0 else 1
    elif has_guess and (x or y):
        if curve.at is None:
            side = -1 if curve.part_inside(placed.translation[None]) else 1
        else:
            square = curve.radial(0.0)[0](Taylor([np.array([np.arctan2(y, x)])])).values[0][0]
            side = 1 if x * x + y * y >= square else -1
    return {"follower": replace(follower, side=side)}


def _sided_profiles(c: ClosureData, placed: pin.SE3, has_guess: bool) -> dict[str, Any]:
    """Return two profiles, one inside the other where the guess shows most of it there."""
    both, back = c.numbers["curves"], placed.inverse()
    nested = has_guess and max(
        curve.part_inside(other.points() @ seen.rotation.T + seen.translation)
        for curve, other, seen in ((both.one, both.two, placed), (both.two, both.one, back))) > 0.5
    return {"curves": replace(both, side=-1 if nested else 1)} if has_guess else {}


def _rope(c: ClosureData) -> Rows:
    parts = ((1.0, (PointDistance((k, k + 1)),)) for k in range(len(c.frames) - 1))
    return (ConstraintEquation((*parts, (-c.numbers["length"], ())), is_length=True),)


def _fault_of_rope(c: ClosureData) -> tuple[str, str] | None:
    return None if c.numbers["length"] > 0.0 else (
        "length", f"is {c.numbers['length']} m; it must be positive")


def _stack(*parts: Callable[[ClosureData], Rows]) -> Callable[[ClosureData], Rows]:
    return lambda c: tuple(row for part in parts for row in part(c))


_TRANSLATIONS = (("x", "m"), ("y", "m"), ("z", "m"))
_ROTATION_VECTOR = (("x", "rad"), ("y", "rad"), ("z", "rad"))

_WELD = Pair(0, _stack(_coincident, _same_orientation), aligned="xyz", uses_axis=False,
             native=pin.ContactType.CONTACT_6D)

PAIRS: dict[str, Pair] = {
    "revolute": Pair(1, _stack(_coincident, _parallel), revolute_joint, (("", "rad"),), "z"),
    "prismatic": Pair(1, _stack(_on_line, _same_orientation), prismatic_joint, (("", "m"),), "xyz"),
    "screw": Pair(1, _stack(_on_line, _parallel, _screw),
                  lambda axis, _, lead: pin.JointModelHelicalUnaligned(axis, lead / (2.0 * np.pi)),
                  (("", "rad"),), "z", uses_lead=True),
    "cylindrical": Pair(2, _stack(_on_line, _parallel),
                        lambda axis, *_: _composite(revolute_joint(axis), prismatic_joint(axis)),
                        (("angle", "rad"), ("slide", "m")), "z"),
    "universal": Pair(2, _stack(_coincident, _perpendicular),
                      lambda axis, axis2, _: pin.JointModelUniversal(axis, axis2),
                      (("first", "rad"), ("second", "rad")), axis=(1.0, 0.0, 0.0),
                      uses_axis2=True),
    "spherical": Pair(3, _coincident, lambda *_: pin.JointModelSpherical(), _ROTATION_VECTOR,
                      uses_axis=False, native=pin.ContactType.CONTACT_3D),
    "planar": Pair(3, _stack(_on_plane, _parallel), _planar_joint,
                   (("x", "m"), ("y", "m"), ("angle", "rad")), "z"),
    "floating": Pair(6, None, lambda *_: pin.JointModelFreeFlyer(),
                     (*_TRANSLATIONS, ("rx", "rad"), ("ry", "rad"), ("rz", "rad")),
                     uses_axis=False),
    "fixed": _WELD,
    "weld": _WELD,
    "distance": Pair(5, _distance, uses_axis=False, uses_length=True),
    "point_on_line": Pair(4, _on_line),
    "point_on_plane": Pair(5, _on_plane),
    "parallel": Pair(4, _parallel, aligned="z"),
    "perpendicular": Pair(5, _perpendicular, uses_axis2=True),
    "point_on_curve": Pair(4, lambda c: on_curve(c.numbers["curve"]), uses_axis=False,
                           keys=(Key("curve", read=named_curve),)),
    "frame_on_curve": Pair(2, _frame_on_curve, uses_axis=False, aligned="tangent",
                           keys=(Key("curve", read=named_curve),)),
    "curve_on_curve": Pair(5, lambda c: touching(c.numbers["curves"]), uses_axis=False,
                           keys=(Key("curves", read=two_curves),), fault=_fault_of_profiles,
                           at_guess=_sided_profiles),
    "cam": Pair(5, _cam, uses_axis=False, keys=(
        Key("curve", read=named_curve), Key("follower", read=follower_of)), fault=_fault_of_cam,
        at_guess=_sided_follower),
    "rope": Pair(5, _rope, uses_axis=False, has_more=True, keys=(Key("length"),),
                 fault=_fault_of_rope),
    "coupling": Pair(
        5, _coupling, uses_axis=False, n_frames=0, n_joints=2, has_more=True, keys=(
            Key("function", read=function_of,
                instead_of=("ratio", "ratios", "offset", "teeth", "strands")),
            Key("ratios", is_list=True, instead_of=("ratio",)),
            Key("ratio", 1.0, "lock the joint instead"), Key("offset", 0.0),
            Key("teeth", read=teeth_of, instead_of=("strands",)),
            Key("strands", read=strands_of, is_optional=True)),
        fault=_fault_of_coupling),
}

COUPLING = "coupling"
JOINT_TYPES = tuple(name for name, pair in PAIRS.items() if pair.joint or name == "fixed")


def closure_types() -> tuple[str, ...]:
    """Return the names of pairs that can close loops."""
    return tuple(name for name, pair in PAIRS.items() if pair.rows)


# Other words for types, in files, books and other tools; for a word that is no type, the remedy.
TIES = ('gears, belts, racks and tendons tie joints: [[closures]] with type = "coupling", joints = '
        '["a", "b"] and a ratio')
SPRING = "springs and dampers have tables of their own: [[springs]]"
CONTACT = ("contact between bodies is not modelled: `clearance` tells where links touch, and the "
           "page on other tools which of them model it")
OTHER_WORDS: dict[str, str] = {
    **dict.fromkeys(("hinge", "pin", "pivot", "continuous", "rotary", "rotational", "rotation",
                     "turning"), "revolute"),
    **dict.fromkeys(("slide", "slider", "sliding", "linear", "translational", "translation"),
                    "prismatic"),
    **dict.fromkeys(("ball", "ball_and_socket", "socket", "globular"), "spherical"),
    **dict.fromkeys(("cardan", "hooke", "u"), "universal"),
    **dict.fromkeys(("helical", "helix"), "screw"),
    **dict.fromkeys(("free", "free_flyer", "freeflyer", "6dof"), "floating"),
    **dict.fromkeys(("rigid", "welded", "lock"), "fixed"),
    **dict.fromkeys(("rod", "tie_rod"), "distance"),
    "slot": "point_on_line",
    **dict.fromkeys(("gear", "gears", "gearbox", "belt", "chain", "pulley", "rack", "rack_pinion",
                     "rack_and_pinion", "mimic", "differential", "tendon", "planetary"), TIES),
    **dict.fromkeys(("cable", "string", "pulleys"), "rope"),
    **dict.fromkeys(("spring", "damper"), SPRING),
    **dict.fromkeys(("contact", "collision", "rolling", "wheel"), CONTACT),
    **dict.fromkeys(("cam_follower", "follower"), "cam"),
    **dict.fromkeys(("guide_curve", "curve"), "point_on_curve"),
    **dict.fromkeys(("track", "rail", "carriage", "roller_coaster"), "frame_on_curve"),
    **dict.fromkeys(("two_cams", "conjugate_profiles"), "curve_on_curve"),
}


def hint_at_type(word: str, valid: Collection[str]) -> str:
    """Return a hint for an unknown type among the valid ones; "" if there is none."""
    plain = re.sub(r"[\s_-]+", "_", word.strip().lower()).removesuffix("joint").rstrip("_")
    pair = OTHER_WORDS.get(plain, plain if plain in PAIRS else "")
    if pair in valid:
        return f"did you mean {pair!r}?"
    if pair in PAIRS:
        table = "[joints.NAME]" if pair in JOINT_TYPES else "[[closures]]"
        return f"did you mean {pair!r}? a mechanism file has that below {table}"
    return pair
