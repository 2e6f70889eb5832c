"""The coordinates of joints at the placements in which a file draws its links."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.formats.graph.joints import WORLD, Joint
from spatial_pin.formats.graph.spanning import SpanningTree
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.angles import whole_turns
from spatial_pin.numerics.linalg import Array

DRAWN = 100.0  # roundings of the file that links may be drawn away from their joints
_Coordinates = Callable[[Joint, pin.SE3], tuple[list[float], pin.SE3]]


def drawn(tree: SpanningTree) -> tuple[dict[str, Any], list[str]]:
    """Return the coordinates at which a file draws its links, and a notice of joints off there."""
    rounding, links = tree.graph.rounding, tree.graph.links
    at = {WORLD: pin.SE3.Identity(), **{link.name: link.placement for link in links}}
    places = [x.translation for x in at.values() if x is not None]
    size = float(np.ptp(places, axis=0).max()) or 1.0
    guess: dict[str, Any] = {}
    off: dict[str, float] = {}
    for joint in tree.joints:
        one, two = at[joint.parent], at[joint.child]
        if one is None or two is None:
            continue
        relative = (one * joint.on_parent).inverse() * two * joint.on_child
        values, reached = coordinates_at(joint, relative)
        gap = reached.inverse() * relative
        away = max(np.abs(gap.translation).max() / size, np.abs(pin.log3(gap.rotation)).max())
        if away > DRAWN * rounding:
            off[joint.name] = float(away)
        if max(map(abs, values), default=0.0) > 10.0 * rounding:
            guess[joint.name] = values if len(values) > 1 else values[0]
    if not off:
        return guess, []
    name = max(off, key=off.__getitem__)
    return guess, [f"links are not drawn where their joints hold them, at {len(off)} joints, most "
                   f"at {name!r}, by {off[name]:.2g} of the size or rad: the joints count"]


def coordinates_at(joint: Joint, relative: pin.SE3) -> tuple[list[float], pin.SE3]:
    """Return a joint's coordinates nearest to a placement of its frames, and that they give.

    Args:
        joint: the joint, of a pair that a tree can have.
        relative: placement of its frame on the child in its frame on the parent.
    """
    values, reached = _OF_PAIR[joint.type](joint, relative)
    return [float(x) for x in values], reached


def _turn(axis: Array, relative: pin.SE3) -> float:
    """Return the angle about an axis that comes nearest to a rotation."""
    across = axes_from_z(axis)
    turned = across.T @ relative.rotation @ across
    return math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])


def _placed(rotation: Array, translation: Array) -> pin.SE3:
    return pin.SE3(pin.exp3(rotation), translation)


def _on_axis(turns: bool, slides: bool) -> _Coordinates:
    """Return the coordinates of a pair that may turn about its axis, slide along it, or both."""

    def found(joint: Joint, relative: pin.SE3) -> tuple[list[float], pin.SE3]:
        angle = _turn(joint.axis, relative) if turns else 0.0
        slide = joint.axis @ relative.translation if slides else 0.0
        return [angle] * turns + [slide] * slides, _placed(angle * joint.axis, slide * joint.axis)

    return found


def _screw(joint: Joint, relative: pin.SE3) -> tuple[list[float], pin.SE3]:
    angle = _turn(joint.axis, relative)
    if joint.lead:  # the slide tells how many turns
        slide = joint.axis @ relative.translation
        angle += whole_turns(2.0 * math.pi * slide / joint.lead - angle)
    return [angle], _placed(angle * joint.axis, angle / (2.0 * math.pi) * joint.lead * joint.axis)


def _planar(joint: Joint, relative: pin.SE3) -> tuple[list[float], pin.SE3]:
    angle = _turn(joint.axis, relative)
    x, y, _ = axes_from_z(joint.axis).T
    at = [x @ relative.translation, y @ relative.translation]
    return [*at, angle], _placed(angle * joint.axis, at[0] * x + at[1] * y)


def _universal(joint: Joint, relative: pin.SE3) -> tuple[list[float], pin.SE3]:
    one, two, third = joint.axis, joint.axis2, np.cross(joint.axis, joint.axis2)
    pin2, pin1 = relative.rotation @ two, relative.rotation.T @ one
    first = math.atan2(pin2 @ third, pin2 @ two)
    second = math.atan2(pin1 @ third, pin1 @ one)
    return [first, second], pin.SE3(pin.exp3(first * one) @ pin.exp3(second * two), np.zeros(3))


def _spherical(joint: Joint, relative: pin.SE3) -> tuple[list[float], pin.SE3]:
    vector = pin.log3(relative.rotation)
    return list(vector), _placed(vector, np.zeros(3))


_OF_PAIR: dict[str, _Coordinates] = {
    "fixed": _on_axis(False, False), "revolute": _on_axis(True, False),
    "prismatic": _on_axis(False, True), "cylindrical": _on_axis(True, True),
    "screw": _screw, "planar": _planar, "universal": _universal,
    "spherical": _spherical,
    "floating": lambda _, placed: ([*placed.translation, *pin.log3(placed.rotation)], placed),
}
