"""Relations that replace a link with two pairs.

A link with two pairs keeps its neighbours in a relation. If that relation is a closure type, fewer
equations replace the link's coordinates and its loop's equations [Haug1989, 9.4: composite joints]:

====================  ========================================================================
pairs                 relation of the two neighbours
====================  ========================================================================
ball, ball            distance (a universal joint instead of one ball: the same)
ball, revolute        point on a circle: in a plane, at a distance from its centre
ball, prismatic       point on a line (ball, cylindrical with the ball on the axis: the same)
ball, planar          point in a plane
revolute, revolute    in a plane: distance; axes that meet in a point fixed in both: distance of
                      points on them; meeting at right angles: universal
revolute, prismatic   in a plane: point in a plane along the slide
prismatic, prismatic  in a plane: no relative turn
any, weld             the same pair as a closure
====================  ========================================================================

To add a relation, add a function of two `Pin`s to `RELATIONS`. It returns the closures, or None if
it does not apply; the first pair's kind is the first of the key.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.formats.mechanism_writer import tree_axes
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array, least_squares
from spatial_pin.numerics.tolerances import TOLERANCES

# Least sine of the angle of two axes in a distance of points on them: the equation is as well
# conditioned as the sine, and a quarter loses no digit.
FLAT_ANGLE = 0.25

# Random configurations of the open tree for derivatives: four do not all vanish by chance.
OPEN_CONFIGURATIONS = 4


class Pin(NamedTuple):
    """A pair of a link."""

    kind: str  # type of the pair
    body: int  # joint of the neighbour
    centre: Array  # (3,) of the pair, in the axes of the neighbour
    axis: Array
    own_centre: Array  # (3,) the same in the axes of the link (universal: the other axis)
    own_axis: Array
    turn: Array  # (3, 3) from the link's axes to the neighbour's, if the pair fixes it

    def seen_from(self, placement: pin.SE3) -> Pin:
        """Return the pin for a body against which its link has this placement."""
        return self._replace(own_centre=placement.act(self.own_centre),
                             own_axis=placement.rotation @ self.own_axis,
                             turn=self.turn @ placement.rotation.T)


class BodyFrame(NamedTuple):
    """A frame on the body of a joint: origin (3,), z axis (3,), and a direction near x."""

    body: int
    origin: Array
    z: Array = np.array([0.0, 0.0, 1.0])
    x: Array | None = None

    @property
    def placement(self) -> pin.SE3:
        """In the axes of the joint."""
        if self.x is None:
            return pin.SE3(axes_from_z(self.z), self.origin)
        x = self.x - (self.x @ self.z) * self.z
        x = x / np.linalg.norm(x)
        return pin.SE3(np.column_stack([x, np.cross(self.z, x), self.z]), self.origin)


class Relation(NamedTuple):
    """A new closure: of the pair `type` between z axes (or origins) of two frames."""

    type: str
    frames: tuple[BodyFrame, BodyFrame]
    length: float = 0.0  # of a distance [m]
    ends: tuple[Array, ...] = ()  # (3,) its two ends on the link, in the axes of the link
    between: tuple[BodyFrame, ...] = ()  # frames with the same distance, if it varies


class Surroundings:
    """The mechanism without a link, at random configurations with all loops open.

    Args:
        mechanism: the mechanism.
        configurations: (k, nq) random values of what moves.
    """

    def __init__(self, mechanism: Mechanism, configurations: list[Array]) -> None:
        self.mechanism = mechanism
        self.length = mechanism.characteristic_length
        data = mechanism.model.createData()
        self._placements = []
        for q in configurations:
            pin.forwardKinematics(mechanism.model, data, q)
            self._placements.append([placement.copy() for placement in data.oMi])

    def keep_plane(self, first: Pin, second: Pin, normal1: Array, normal2: Array) -> bool:
        """Whether two bodies keep these normals parallel and their distance along them."""
        offsets = []
        for placements in self._placements:
            m1, m2 = placements[first.body], placements[second.body]
            n = m1.rotation @ normal1
            if np.abs(n - m2.rotation @ normal2).max() > TOLERANCES.closed:
                return False
            offsets.append(n @ (m2.act(second.centre) - m1.act(first.centre)))
        return float(np.ptp(offsets)) <= TOLERANCES.closed * self.length

    def placements(self, first: int, second: int) -> list[pin.SE3]:
        """Return placements of the body of a joint, relative to another one's."""
        return [at[first].actInv(at[second]) for at in self._placements]

    def keep_point(self, first: int, point1: Array, second: int, point2: Array) -> bool:
        """Whether two points of two bodies always coincide."""
        return all(np.abs(at[first].act(point1) - at[second].act(point2)).max()
                   <= TOLERANCES.tight * self.length for at in self._placements)


def open_configurations(mechanism: Mechanism, q: Array, free: Array | float = 1.0) -> list[Array]:
    """Return random configurations about q, with all loops open."""
    model, scale, rng = mechanism.model, mechanism.velocity_scale, np.random.default_rng(13)
    return [pin.integrate(model, q, rng.uniform(-2.0, 2.0, model.nv) * scale * free)
            for _ in range(OPEN_CONFIGURATIONS)]


class WeldedBodies:
    """The rigid bodies of a tree with some welded joints."""

    def __init__(self, mechanism: Mechanism, q: Array, welded: frozenset[int]) -> None:
        self.mechanism, self.welded = mechanism, welded
        self._data = mechanism.model.createData()
        pin.forwardKinematics(mechanism.model, self._data, q)

    def of(self, joint: int) -> tuple[int, pin.SE3]:
        """Return the joint that moves the body of a joint, and that body's placement on it."""
        mover = joint
        while mover in self.welded:
            mover = int(self.mechanism.model.parents[mover])
        return mover, self._data.oMi[mover].actInv(self._data.oMi[joint])

    def frame(self, name: str) -> tuple[int, pin.SE3]:
        """Return the joint that moves a frame, and its placement on that."""
        joint, placement = self.mechanism.frame_on_joint(name)
        mover, on = self.of(joint)
        return mover, on * placement

    def tree_pin(self, i: int) -> Pin:
        """Return the pair by which the body of joint i hangs on its parent."""
        mechanism = self.mechanism
        body, on = self.of(int(mechanism.model.parents[i]))
        placement = on * mechanism.model.jointPlacements[i]
        axis, axis2, _ = tree_axes(mechanism, i)
        kind = mechanism.pairs[i - 1]
        return Pin(kind, body, placement.translation, placement.rotation @ axis, np.zeros(3),
                   axis2 if kind == "universal" else axis, placement.rotation)

    def closing_pin(self, closure: Closure, i: int) -> Pin:
        """Return the pair of a closure as seen from the body of joint i."""
        sides = [self.frame(f) for f in closure.frames]
        geometry = closure.geometry
        axes = [m.rotation @ a for (_, m), a in zip(sides, (geometry.axes1, geometry.axes2),
                                                    strict=True)]
        own = 0 if sides[0][0] == i else 1
        (_, m), (body, other) = sides[own], sides[1 - own]
        return Pin(closure.type, body, other.translation, axes[1 - own][:, 2], m.translation,
                   axes[own][:, 2], axes[1 - own] @ axes[own].T)


def _balls(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    length = float(np.linalg.norm(b.own_centre - a.own_centre))
    if length <= TOLERANCES.tight * around.length:
        return None
    return [Relation("distance", (BodyFrame(a.body, a.centre), BodyFrame(b.body, b.centre)), length,
                     (a.own_centre, b.own_centre))]


def _ball_revolute(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    d = a.own_centre - b.own_centre
    along = float(d @ b.own_axis)
    centre = BodyFrame(b.body, b.centre + along * b.axis, b.axis)
    point = BodyFrame(a.body, a.centre)
    radius = float(np.linalg.norm(d - along * b.own_axis))
    if radius <= TOLERANCES.tight * around.length:
        return [Relation("spherical", (centre, point))]
    return [Relation("point_on_plane", (centre, point)),
            Relation("distance", (centre, point), radius,
                     (b.own_centre + along * b.own_axis, a.own_centre))]


def _ball_on_line(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    away, origin = a.own_centre - b.own_centre, b.centre
    if b.kind == "prismatic":
        origin = b.centre + b.turn @ away
    elif np.linalg.norm(np.cross(away, b.own_axis)) > TOLERANCES.tight * around.length:
        return None
    line = BodyFrame(b.body, origin, b.axis)
    return [Relation("point_on_line", (line, BodyFrame(a.body, a.centre)))]


def _ball_planar(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    height = float((a.own_centre - b.own_centre) @ b.own_axis)
    plane = BodyFrame(b.body, b.centre + height * b.axis, b.axis)
    return [Relation("point_on_plane", (plane, BodyFrame(a.body, a.centre)))]


def _revolutes(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    if np.linalg.norm(np.cross(a.own_axis, b.own_axis)) > TOLERANCES.tight:
        return _meeting_revolutes(a, b, around)
    if not around.keep_plane(a, b, a.axis, np.sign(float(a.own_axis @ b.own_axis)) * b.axis):
        return None
    d = b.own_centre - a.own_centre
    along = float(d @ b.own_axis)
    length = float(np.linalg.norm(d - along * b.own_axis))
    if length <= TOLERANCES.tight * around.length:
        return None
    other = BodyFrame(b.body, b.centre - along * b.axis)
    return [Relation("distance", (BodyFrame(a.body, a.centre), other), length,
                     (a.own_centre, b.own_centre - along * b.own_axis))]


def _meeting_revolutes(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    u, w, d = a.own_axis, b.own_axis, b.own_centre - a.own_centre
    s, t = least_squares(np.column_stack([u, -w]), d)
    if np.linalg.norm(s * u - t * w - d) > TOLERANCES.tight * around.length:
        return None
    meeting = a.centre + s * a.axis, b.centre + t * b.axis
    if abs(u @ w) <= TOLERANCES.tight:
        return [Relation("universal", (BodyFrame(a.body, meeting[0], a.axis),
                                       BodyFrame(b.body, meeting[1], b.axis)))]
    if np.linalg.norm(np.cross(u, w)) < FLAT_ANGLE or not around.keep_point(
            a.body, meeting[0], b.body, meeting[1]):
        return None
    reach = 0.5 * around.length
    chord = reach * float(np.linalg.norm(u - w))
    return [Relation("distance", (BodyFrame(a.body, meeting[0] + reach * a.axis),
                                  BodyFrame(b.body, meeting[1] + reach * b.axis)), chord,
                     (a.own_centre + (s + reach) * u, b.own_centre + (t + reach) * w))]


def _revolute_prismatic(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    if abs(a.own_axis @ b.own_axis) > TOLERANCES.tight:
        return None
    normal = b.turn @ a.own_axis
    if not around.keep_plane(a, b, a.axis, normal):
        return None
    origin = b.centre + b.turn @ (a.own_centre - b.own_centre)
    across = BodyFrame(b.body, origin, np.cross(normal, b.axis))
    return [Relation("point_on_plane", (across, BodyFrame(a.body, a.centre)))]


def _prismatics(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    normal = np.cross(a.own_axis, b.own_axis)
    if np.linalg.norm(normal) < TOLERANCES.tight:
        return None
    normal /= np.linalg.norm(normal)
    normals = a.turn @ normal, b.turn @ normal
    if not around.keep_plane(a, b, *normals):
        return None
    slide = BodyFrame(a.body, a.centre, a.axis, normals[0])
    return [Relation("parallel", (slide, BodyFrame(b.body, b.centre, b.turn @ a.own_axis)))]


def _welded(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    """The link is part of the body that it is welded to."""
    x = np.eye(3)[int(np.argmin(np.abs(a.own_axis)))]
    centre = b.centre + b.turn @ (a.own_centre - b.own_centre)
    is_slide = a.kind == "prismatic"
    first = BodyFrame(a.body, a.centre, a.axis, a.turn @ x if is_slide else None)
    second = BodyFrame(b.body, centre, b.turn @ a.own_axis, b.turn @ x if is_slide else None)
    if a.kind == "spherical":
        first, second = BodyFrame(a.body, a.centre), BodyFrame(b.body, centre)
    return [Relation(a.kind, (first, second))]


_Rule = Callable[[Pin, Pin, Surroundings], "list[Relation] | None"]

RELATIONS: dict[tuple[str, str], _Rule] = {
    ("spherical", "spherical"): _balls,
    ("spherical", "universal"): _balls,
    ("spherical", "revolute"): _ball_revolute,
    ("spherical", "prismatic"): _ball_on_line,
    ("spherical", "cylindrical"): _ball_on_line,
    ("spherical", "planar"): _ball_planar,
    ("revolute", "revolute"): _revolutes,
    ("revolute", "prismatic"): _revolute_prismatic,
    ("prismatic", "prismatic"): _prismatics,
    **{(kind, "weld"): _welded for kind in (
        "revolute", "prismatic", "cylindrical", "universal", "spherical", "planar")},
}


def reach(a: Pin, b: Pin) -> str:
    """Return a note on a rod whose universal joint cannot take all directions.

    It can if the ball lies in the plane through its centre normal to its pin in the rod.
    """
    for joint, ball in ((a, b), (b, a)):
        d = ball.own_centre - joint.own_centre
        if (joint.kind, ball.kind) == ("universal", "spherical") and abs(
                joint.own_axis @ d) > TOLERANCES.tight * np.linalg.norm(d):
            return "; where its universal joint cannot point, the full mechanism stops"
    return ""


def relation(a: Pin, b: Pin, around: Surroundings) -> list[Relation] | None:
    """Return the closures that replace a link with pairs a and b; None if there are none."""
    for first, second in ((a, b), (b, a)):
        rule = RELATIONS.get((first.kind, second.kind))
        if rule is not None:
            return rule(first, second, around)
    return None
