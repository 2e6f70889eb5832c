"""Closures made in code: a constructor for every type, for `Mechanism.from_model`.

Each takes the two frames that it joins, by name or as (link or joint, `pin.SE3` on it), and a name
for reports; without one, the name is the type. The arguments are explained with the closures of
mechanism files: `axis` is the pair's axis in frame 1 and in frame 2, unit vectors (3,), default z.

Example:
    >>> rod = sp.closures.distance("crank_a", "rocker_b", 0.381, "rod")  # [m]
    >>> rod.name, rod.type
    ('rod', 'distance')
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from spatial_pin._support.checks import finite_array, finite_number, positive_number, unit_vector
from spatial_pin.errors import ClosureTypeError, suggestion
from spatial_pin.mechanism.curves import CurveShape, TouchingCurves, follower_of
from spatial_pin.mechanism.force_paths import strands_of, teeth_of
from spatial_pin.mechanism.functions import function_of
from spatial_pin.mechanism.pairs import (
    COUPLING,
    PAIRS,
    closure_geometry,
    closure_types,
    hint_at_type,
    unit,
)
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array

__all__ = [
    "cam", "coupling", "curve_on_curve", "cylindrical", "distance", "fixed", "frame_on_curve",
    "parallel", "perpendicular", "planar", "point_on_curve", "point_on_line", "point_on_plane",
    "prismatic", "revolute", "rope", "screw", "spherical", "universal", "weld",
]
FrameSpec = str | tuple[str, pin.SE3]  # a frame by name, or as a placement on a link or joint
NATIVE = {  # Pinocchio's constraints that hold two bodies together
    "PointAnchorConstraintModel": "spherical", "FrameAnchorConstraintModel": "weld",
    pin.ContactType.CONTACT_3D: "spherical", pin.ContactType.CONTACT_6D: "weld",
}
DESIRED = ("desired_contact_placement", "desired_contact_velocity", "desired_contact_acceleration",
           "desired_constraint_offset", "desired_constraint_velocity",
           "desired_constraint_acceleration")


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    """Raise an error that names the closure for another word."""
    hint = hint_at_type(name, closure_types()) or suggestion(name, closure_types())
    raise AttributeError(f"there is no closure {name!r}; {hint}")


def _closure(
    kind: str, frames: tuple[FrameSpec, FrameSpec], name: str | None,
    equations: Sequence[int] | None, axis: ArrayLike | None = None,
    axis2: ArrayLike | None = None, *, length: float = 0.0, lead: float = 0.0,
) -> Closure:
    axes = [_axis(x, what) for x, what in ((axis, "axis"), (axis2, "axis2"))]
    made = Closure(_name(name), kind, frames=_frame_pair(frames),
                   geometry=closure_geometry(PAIRS[kind], *axes, length=length, lead=lead))
    if equations is None:
        return made
    chosen, count = list(equations), made.n_rows
    whole = all(isinstance(x, int | np.integer) and 0 <= x < count for x in chosen)
    if not chosen or not whole or sorted(set(chosen)) != chosen:
        raise ValueError(f"equations must be some of the numbers 0 to {count - 1}, ascending, not "
                         f"{chosen}")
    return replace(made, equations=tuple(int(x) for x in chosen))


def _possible(closure: Closure) -> Closure:
    """Return a closure whose numbers fit together."""
    fault = closure.pair.fault(closure)
    if fault:
        raise ValueError(" ".join(fault))
    return closure


def _axis(values: ArrayLike | None, what: str) -> Array | None:
    if values is None:
        return None
    unit_vector(values, what)
    return unit(np.array(values, dtype=float))


def _name(name: str | None) -> str:
    if name is not None and (not isinstance(name, str) or not name or not name.isprintable()):
        raise TypeError(f"the name of a closure is text that can be read, not {name!r}")
    return name or ""  # it is given one with the others


def _frames(frames: Sequence[FrameSpec]) -> Any:
    """Return frames; placements get a name in `Mechanism.from_model`."""
    if isinstance(frames, str):
        raise TypeError(f"frames are several, not {frames!r}")
    for frame in frames:
        is_placement = (isinstance(frame, tuple | list) and len(frame) == 2
                    and isinstance(frame[0], str) and isinstance(frame[1], pin.SE3))
        if not is_placement and not isinstance(frame, str):
            raise TypeError(f"a frame is given by its name, or as (link or joint, pin.SE3), not "
                            f"{str(frame)[:60]!r}")
    if len(frames) < 2:
        raise ValueError(f"two frames are needed, not {len(frames)}")
    return tuple(frames)


def _frame_pair(frames: Sequence[FrameSpec]) -> Any:
    if len(frames) != 2:
        raise ValueError(f"two frames are needed, not {len(frames)}")
    return _frames(frames)


def spherical(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
              equations: Sequence[int] | None = None) -> Closure:
    """Return a ball joint: the two origins coincide (3 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> ball = sp.closures.spherical("coupler_b", "rocker_b", "ball_b")
        >>> ball.type, ball.frames, ball.n_rows  # equations
        ('spherical', ('coupler_b', 'rocker_b'), 3)
    """
    return _closure("spherical", (frame_1, frame_2), name, equations)


def revolute(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
             axis: ArrayLike | None = None, equations: Sequence[int] | None = None) -> Closure:
    """Return a hinge: the two origins coincide, and the two axes (5 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: direction of the pair, a unit vector (3,) in both frames; default z.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.revolute("a", "b", axis=[0.0, 1.0, 0.0]).n_rows  # equations
        5
    """
    return _closure("revolute", (frame_1, frame_2), name, equations, axis)


def prismatic(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
              axis: ArrayLike | None = None, equations: Sequence[int] | None = None) -> Closure:
    """Return a slide: frame 2 moves along the axis and does not turn (5 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: direction of the pair, a unit vector (3,) in both frames; default z.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.prismatic("rail", "slider", axis=[1.0, 0.0, 0.0]).n_rows  # equations
        5
    """
    return _closure("prismatic", (frame_1, frame_2), name, equations, axis)


def screw(frame_1: FrameSpec, frame_2: FrameSpec, lead: float, name: str | None = None, *,
          axis: ArrayLike | None = None, equations: Sequence[int] | None = None) -> Closure:
    """Return a screw: frame 2 turns about the axis and advances with it (5 equations).

    The slide is zero at angle zero; the angle counts turns from the assembled state.

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        lead: advance per turn [m], not zero; positive of a right-handed thread.
        name: for reports; default its type.
        axis: direction of the pair, a unit vector (3,) in both frames; default z.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, the lead is zero, or an axis is no unit vector.

    Example:
        >>> sp.closures.screw("nut", "spindle", 0.005).n_rows  # a lead of 5 mm per turn
        5
    """
    lead = finite_number(lead, "lead")
    if lead == 0.0:
        raise ValueError("lead is 0; a screw advances as it turns: for one that does not take "
                         "closures.revolute")
    return _closure("screw", (frame_1, frame_2), name, equations, axis, lead=lead)


def cylindrical(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
                axis: ArrayLike | None = None, equations: Sequence[int] | None = None) -> Closure:
    """Return a sleeve: frame 2 slides along the axis and turns about it (4 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: direction of the pair, a unit vector (3,) in both frames; default z.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.cylindrical("shaft", "collar").n_rows  # equations
        4
    """
    return _closure("cylindrical", (frame_1, frame_2), name, equations, axis)


def universal(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
              axis: ArrayLike | None = None, axis2: ArrayLike | None = None,
              equations: Sequence[int] | None = None) -> Closure:
    """Return a Hooke joint: origins coincide, two pins stay perpendicular (4 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: pin that is fixed in frame 1, a unit vector (3,); default x.
        axis2: pin that is fixed in frame 2, likewise; default y.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> cross = sp.closures.universal("fork_1", "fork_2", axis=[1, 0, 0], axis2=[0, 1, 0])
        >>> cross.n_rows  # equations
        4
    """
    return _closure("universal", (frame_1, frame_2), name, equations, axis, axis2)


def planar(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
           axis: ArrayLike | None = None, equations: Sequence[int] | None = None) -> Closure:
    """Return two planes on each other: origin 2 stays in the plane of frame 1 (3 equations).

    The normals stay parallel.

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: normal of the plane, a unit vector (3,) in both frames; default z.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.planar("table", "foot", axis=[0.0, 0.0, 1.0]).n_rows  # equations
        3
    """
    return _closure("planar", (frame_1, frame_2), name, equations, axis)


def fixed(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
          equations: Sequence[int] | None = None) -> Closure:
    """Return a weld (6 equations), by the name that it has as a joint; see `weld`.

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.fixed("flange", "tool").type
        'fixed'
    """
    return _closure("fixed", (frame_1, frame_2), name, equations)


def weld(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
         equations: Sequence[int] | None = None) -> Closure:
    """Return a weld: the two frames coincide (6 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.weld("flange", "tool").n_rows  # equations
        6
    """
    return _closure("weld", (frame_1, frame_2), name, equations)


def distance(frame_1: FrameSpec, frame_2: FrameSpec, length: float | None = None,
             name: str | None = None, *,
             length_between: tuple[FrameSpec, FrameSpec] | None = None) -> Closure:
    """Return a rod with balls at its ends: the two origins stay `length` apart (1 equation).

    Args:
        frame_1: frame at one end: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame at the other end, likewise.
        length: of the rod, positive [m].
        name: for reports; default its type.
        length_between: instead of a length two other frames that are as far apart: a rod of
            variable length, or, where both are on one body, as long as a dimension says.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: there is neither length, or both.

    Example:
        >>> sp.closures.distance("crank_a", "rocker_b", 0.381).n_rows  # a rod of 0.381 m
        1
    """
    if (length is None) == (length_between is None):
        raise ValueError("a distance has a length or length_between, one of the two")
    metres = 0.0 if length is None else positive_number(length, "length")
    made = _closure("distance", (frame_1, frame_2), name, None, length=metres)
    return made if length_between is None else replace(made, between=_frame_pair(length_between))


def point_on_line(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
                  axis: ArrayLike | None = None,
                  equations: Sequence[int] | None = None) -> Closure:
    """Return a ball in a groove: origin 2 stays on the axis of frame 1 (2 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: direction of the line, a unit vector (3,) in frame 1; default z.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.point_on_line("groove", "ball", axis=[1.0, 0.0, 0.0]).n_rows  # equations
        2
    """
    return _closure("point_on_line", (frame_1, frame_2), name, equations, axis)


def point_on_plane(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
                   axis: ArrayLike | None = None) -> Closure:
    """Return a point on a plane: origin 2 stays in the plane of frame 1 (1 equation).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: normal of the plane, a unit vector (3,) in frame 1; default z.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.point_on_plane("floor", "foot", axis=[0.0, 0.0, 1.0]).n_rows  # equations
        1
    """
    return _closure("point_on_plane", (frame_1, frame_2), name, None, axis)


def parallel(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
             axis: ArrayLike | None = None, equations: Sequence[int] | None = None) -> Closure:
    """Return axes that stay parallel, wherever the origins are (2 equations).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: direction of the pair, a unit vector (3,) in both frames; default z.
        equations: numbers of the equations to use, from 0, rising; default all.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.parallel("deck", "ground", axis=[0.0, 0.0, 1.0]).n_rows  # equations
        2
    """
    return _closure("parallel", (frame_1, frame_2), name, equations, axis)


def perpendicular(frame_1: FrameSpec, frame_2: FrameSpec, name: str | None = None, *,
                  axis: ArrayLike | None = None, axis2: ArrayLike | None = None) -> Closure:
    """Return axes that stay perpendicular, wherever the origins are (1 equation).

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        name: for reports; default its type.
        axis: direction in frame 1, a unit vector (3,); default z.
        axis2: direction in frame 2, likewise; default that of `axis`.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: a number is none, or an axis is no unit vector.

    Example:
        >>> sp.closures.perpendicular("a", "b", axis=[1, 0, 0], axis2=[0, 1, 0]).n_rows
        1
    """
    return _closure("perpendicular", (frame_1, frame_2), name, None, axis, axis2)


def coupling(joint_1: str | None = None, joint_2: str | None = None, ratio: float | None = None,
             offset: float = 0.0, name: str | None = None, *, joints: Sequence[str] | None = None,
             ratios: ArrayLike | None = None, function: Any = None,
             teeth: Mapping[str, Any] | None = None,
             strands: Mapping[str, Any] | None = None) -> Closure:
    """Return an equation of joint coordinates: gears, a rack, a differential, a cam, a tendon.

    By a ratio: coordinate 2 = ratio * coordinate 1 + offset. By ratios, of any number of
    coordinates: the sum of ratios * coordinates + offset is zero, as of a planetary train
    z_sun * sun + z_ring * ring - (z_sun + z_ring) * carrier = 0 [Willis]. By a function:
    coordinate 2 = f(coordinate 1). Turns are counted.

    Args:
        joint_1: joint of one freedom, or coordinate, that leads.
        joint_2: the one that follows.
        ratio: of their values: rad/rad, m/rad (a rack: the pinion's radius), ...; not zero;
            default 1.
        offset: of coordinate 2 where coordinate 1 is zero [rad or m]; of ratios, in the unit of
            ratio times coordinate.
        name: for reports; default its type.
        joints: instead of the first two: two of them, or as many as there are ratios.
        ratios: (n,) one for each of the joints, none zero.
        function: a -> (f, f', f'', f'''), rates by a; or, as in a mechanism file,
            {"polynomial": [c0, c1, ...]} of ascending powers or {"points": [[a, b], ...],
            "periodic": True}, a quintic spline.
        teeth: where two gears touch, as in a mechanism file: `point` [m], `pressure_angle`,
            `helix_angle` [rad], `pitch_line`, in the axes of `frame`. Reactions of their bearings
            contain the tooth force then.
        strands: where a belt pulls, likewise: `points` of its strands [m], `pretension` [N].

    Raises:
        TypeError: a joint is no name, or none or too much is given.
        ValueError: a ratio is zero, a number not finite, or the function, teeth or strands none.

    Example:
        >>> teeth = sp.closures.coupling("left_pin", "right_pin", ratio=-1.0)  # equal gears
        >>> teeth.joints, teeth.ratio, teeth.offset
        (('left_pin', 'right_pin'), -1.0, 0.0)
        >>> train = sp.closures.coupling(joints=["sun", "ring", "arm"], ratios=[20, 60, -80])
        >>> train.ratios
        (20.0, 60.0, -80.0)
        >>> cam = sp.closures.coupling(joints=["cam", "rod"], function={"polynomial": [0, 0, 0.1]})
        >>> print(cam.numbers["function"])
        a polynomial of degree 2
    """
    if (joints is None) != isinstance(joint_1, str) or (joint_1 is None) != (joint_2 is None):
        raise TypeError("a coupling joins two joints by name, or joints=[...], not "
                        f"{joint_1!r}, {joint_2!r}, joints={joints!r}")
    names = (joint_1, joint_2) if joints is None else tuple(joints)
    for joint in names:
        if not isinstance(joint, str):
            raise TypeError(f"a coupling joins two joints by name, not {joint!r}")
    numbers = _coupling_numbers(len(names), ratio, ratios, offset, function)
    for key, path, read in (("teeth", teeth, teeth_of), ("strands", strands, strands_of)):
        if path is not None:
            if function is not None or len(numbers) > 2:
                raise TypeError("a coupling by ratios has teeth or strands, one of the two")
            numbers[key] = read(path)
    return _possible(Closure(
        _name(name), COUPLING, joints=tuple(map(str, names)), numbers=numbers))


def _coupling_numbers(
    n: int, ratio: float | None, ratios: ArrayLike | None, offset: float, function: Any
) -> dict[str, Any]:
    if sum(x is not None for x in (ratio, ratios, function)) > 1:
        raise TypeError("a coupling has a ratio, ratios or a function: one of the three")
    numbers: dict[str, Any] = {"offset": finite_number(offset, "offset")}
    if function is not None:
        if numbers.pop("offset"):
            raise TypeError("offset is a part of the function")
        numbers["function"] = function_of(function)
    elif ratios is not None:
        numbers["ratios"] = finite_array(ratios, (n,), "ratios")
    else:
        numbers["ratio"] = finite_number(1.0 if ratio is None else ratio, "ratio")
        if numbers["ratio"] == 0.0:
            raise ValueError("ratio is zero; lock the joint instead")
    return numbers


def rope(frames: Sequence[FrameSpec], length: float, name: str | None = None) -> Closure:
    """Return a rope over points: the sum of the distances from each to the next is constant.

    Pulleys have no size; the rope is always taut, and pushes where its force is negative.

    Args:
        frames: two or more, in the order of the rope: names, or (link or joint, `pin.SE3` on it)
            [m].
        length: of the rope, positive [m].
        name: for reports; default its type.

    Raises:
        TypeError: a frame is neither a name nor a placement.
        ValueError: the length is not positive, or there are fewer than two frames.

    Example:
        >>> sp.closures.rope(["winch", "pulley", "hook"], 2.5).n_rows  # of 2.5 m
        1
    """
    length = positive_number(length, "length")
    return Closure(_name(name), "rope", frames=_frames(frames), numbers={"length": length})


def point_on_curve(frame_1: FrameSpec, frame_2: FrameSpec, curve: CurveShape,
                   name: str | None = None) -> Closure:
    """Return a point on a curve: origin 2 stays on a curve that frame 1 carries (2 equations).

    Where it is on the curve is the coordinate `NAME.s` of states and motions, the arc length from
    the curve's first point, counting turns [m].

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        curve: in the axes of frame 1, see `spatial_pin.curves`.
        name: for reports; default its type.

    Raises:
        TypeError: a frame is neither a name nor a placement, or the curve is none.

    Example:
        >>> track = sp.curves.ellipse([0.4, 0.2])
        >>> sp.closures.point_on_curve("ground", "slider", track).n_rows
        2
    """
    return Closure(_name(name), "point_on_curve", frames=_frame_pair((frame_1, frame_2)),
                   numbers={"curve": _curve(curve)})


def cam(frame_1: FrameSpec, frame_2: FrameSpec, curve: CurveShape, follower: Mapping[str, Any],
        name: str | None = None) -> Closure:
    """Return a cam and its follower, which touch each other in the plane of the cam (1 equation).

    The follower is on the side of the cam where the guess has it, a roller without a guess outside.
    The place of contact is the coordinate `NAME.s`, as of `point_on_curve`.

    Args:
        frame_1: frame on the cam: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the follower, likewise.
        curve: a closed one, in the axes of frame 1, see `spatial_pin.curves`.
        follower: {"roller": radius}, its centre at the origin of frame 2 [m]; {"knife": True}; or
            {"flat": (3,)}, normal in frame 2 of a face through its origin.
        name: for reports; default its type.

    Raises:
        TypeError: a frame is neither a name nor a placement, or the curve is none.
        ValueError: the follower is none, or does not fit the curve: a roller into a hollow, a face
            on a curve that is not convex.

    Example:
        >>> profile = sp.curves.circle(0.03, centre=[0.01, 0.0, 0.0])
        >>> sp.closures.cam("cam", "rod", profile, {"roller": 0.008}).n_rows
        1
    """
    return _possible(Closure(_name(name), "cam", frames=_frame_pair((frame_1, frame_2)), numbers={
        "curve": _curve(curve), "follower": follower_of(follower)}))


def frame_on_curve(frame_1: FrameSpec, frame_2: FrameSpec, curve: CurveShape,
                   name: str | None = None) -> Closure:
    """Return a carriage on a track: origin 2 on a curve of frame 1, z of frame 2 along its tangent.

    It has 4 equations and leaves the place on the curve, the coordinate `NAME.s` as of
    `point_on_curve`, and the turn about the tangent.

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        curve: in the axes of frame 1, see `spatial_pin.curves`.
        name: for reports; default its type.

    Raises:
        TypeError: a frame is neither a name nor a placement, or the curve is none.

    Example:
        >>> track = sp.curves.helix(0.4, 0.2)
        >>> sp.closures.frame_on_curve("ground", "carriage", track).n_rows
        4
    """
    return Closure(_name(name), "frame_on_curve", frames=_frame_pair((frame_1, frame_2)),
                   numbers={"curve": _curve(curve)})


def curve_on_curve(frame_1: FrameSpec, frame_2: FrameSpec, curves: Sequence[CurveShape],
                   name: str | None = None) -> Closure:
    """Return two profiles that touch in their plane: point and normal are the same (1 equation).

    They are outside each other, or one inside the other where the guess has it so. The places of
    contact are the coordinates `NAME.s` on the first curve and `NAME.s2` on the second, arc
    lengths from their first points, counting turns [m].

    Args:
        frame_1: frame on the first body: its name, or (link or joint, `pin.SE3` on it) [m].
        frame_2: frame on the second body, likewise.
        curves: two closed ones in planes, in the axes of frame 1 and of frame 2, whose normals stay
            parallel.
        name: for reports; default its type.

    Raises:
        TypeError: a frame is neither a name nor a placement, or a curve is none.
        ValueError: there are not two, or one is open, crosses itself, or is not in a plane.

    Example:
        >>> oval = sp.curves.ellipse([0.04, 0.03])
        >>> sp.closures.curve_on_curve("cam", "lever", [oval, oval]).n_rows
        1
    """
    if len(curves) != 2:
        raise ValueError(f"curves: two curves touch, not {len(curves)}")
    return _possible(Closure(
        _name(name), "curve_on_curve", frames=_frame_pair((frame_1, frame_2)),
        numbers={"curves": TouchingCurves(_curve(curves[0]), _curve(curves[1]))}))


def _curve(curve: Any) -> CurveShape:
    if not isinstance(curve, CurveShape):
        raise TypeError(f"a curve is made by sp.curves, not {str(curve)[:60]!r}")
    return curve


def of_native(constraint: Any, bodies: Sequence[str]) -> Closure:
    """Return the closure of a constraint of Pinocchio that holds two bodies together.

    Args:
        constraint: `pin.RigidConstraintModel` (3-D or 6-D, in any reference frame),
            `pin.PointAnchorConstraintModel`, `pin.FrameAnchorConstraintModel`, or a
            `pin.ConstraintModel` that is one of these.
        bodies: by joint of the model, the name of a link whose axes are the joint's.

    Raises:
        ClosureTypeError: it is another constraint, or not at rest where the frames coincide.

    Example:
        >>> mech = sp.load("rssr")
        >>> native = mech.constraint_models()[0]
        >>> sp.closures.of_native(native, list(mech.model.names)).type
        'spherical'
    """
    if isinstance(constraint, pin.ConstraintModel):
        constraint = constraint.extract()
    kind = NATIVE.get(getattr(constraint, "type", type(constraint).__name__))
    name = getattr(constraint, "name", "")
    if kind is None:
        raise ClosureTypeError(
            f"closures: {type(constraint).__name__} {name!r} does not hold two bodies together; "
            "pin.RigidConstraintModel (3-D, 6-D), pin.PointAnchorConstraintModel and "
            "pin.FrameAnchorConstraintModel do, and so does what sp.closures makes")
    for key in DESIRED:
        wanted = getattr(constraint, key, None)
        if isinstance(wanted, pin.SE3):
            wanted = wanted.homogeneous - np.eye(4)
        if wanted is not None and np.any(getattr(wanted, "vector", wanted)):
            raise ClosureTypeError(f"closures: {name!r}: its {key} is not zero: a closure holds "
                                   "frames together; put an offset into joint2_placement")
    ids = int(constraint.joint1_id), int(constraint.joint2_id)
    if max(ids) >= len(bodies):
        raise ClosureTypeError(f"closures: {name!r} is of another model: it has joint {max(ids)}, "
                               f"the model has {len(bodies)} with the universe")
    placements = constraint.joint1_placement, constraint.joint2_placement
    frames = tuple((bodies[i], x.copy()) for i, x in zip(ids, placements, strict=True))
    return _closure(kind, frames, name or None, None)  # type: ignore[arg-type]
