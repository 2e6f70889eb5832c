"""Joints that turn two frames relative to each other about an axis, and count its turns.

Two frames tell their angle within a turn. Hinges next to either frame, but for slides, whose axes
are that of the screw turn it by their own coordinates. Where the hinges between these are parallel
to each other, as those of a linkage that a spindle drives, nothing else turns it: the coordinates
tell the angle. Other trees may wind about the axis; there turns are counted along a path.
"""

from __future__ import annotations

import math
from itertools import takewhile
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.composite_joints import split_of
from spatial_pin.mechanism.equations import Angle, Bearing, Parameter
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array

# Sine of an angle of two axes that are one direction: files have some digits, and turns are whole
NEARLY_PARALLEL = 0.05
HALF_TURN_NOISE = 1e-9  # rad by which half a turn may be missed and is still +pi, not -pi


class Turns(NamedTuple):
    """Coordinates that count the turns of a screw closure.

    Attributes:
        row: (nq,) coefficients of coordinates in the angle of its frames.
        offset: the angle where these are zero [rad].
        are_all: whether the angle depends on these coordinates alone.
    """

    row: Array
    offset: float
    are_all: bool


class _Hinge(NamedTuple):
    """A joint between two bodies, at neutral.

    Attributes:
        q: its index in the configuration.
        axes: (k, 3) that it turns about, world axes; none of a slide.
        sense: 1 if it moves body 2, -1 if it moves body 1.
    """

    q: int
    axes: Array
    sense: int

    def is_about(self, axis: Array) -> bool:
        """Whether it turns about an axis (3,) alone."""
        sines = np.linalg.norm(np.cross(self.axes, axis), axis=1)
        return len(sines) == 1 and sines[0] < NEARLY_PARALLEL


def turns_of(
    mechanism: Mechanism, closure: Closure, angle: Angle | Bearing | Parameter
) -> Turns:
    """Return the coordinates that count the turns of an angle of a closure."""
    if not isinstance(angle, Angle):  # of a point that moves: turns are counted along a path
        return Turns(np.zeros(mechanism.model.nq), 0.0, False)
    model, carriers = split_of(mechanism)
    ends, frames = [], []
    for name in (closure.frames[k] for k in angle.frames):
        joint, placement = mechanism.frame_on_joint(name)
        ends.append(int(carriers[joint]))
        frames.append(_placement(model, ends[-1]).rotation @ placement.rotation)
    one, two = frames[0] @ angle.axes1, frames[1] @ angle.axes2
    hinges = _between(model, *ends)
    first = list(takewhile(lambda x: x.is_about(one[:, 2]), hinges))
    rest = hinges[len(first) :][::-1]
    last = list(takewhile(lambda x: x.is_about(two[:, 2]), rest))
    row = np.zeros(mechanism.model.nq)
    for hinge, axis in [*((x, one[:, 2]) for x in first), *((x, two[:, 2]) for x in last)]:
        row[hinge.q] += hinge.sense * math.copysign(1.0, float(hinge.axes[0] @ axis))
    middle = rest[len(last) :]
    are_all = bool(first or last) and all(x.is_about(middle[0].axes[0]) for x in middle)
    if middle and are_all:
        axis, u, w = middle[0].axes[0], two[:, 2], one[:, 2]  # takes u nearest to w about it
        sine, cosine = axis @ np.cross(u, w), u @ w - (axis @ u) * (axis @ w)
        two = pin.exp3(axis * math.atan2(sine, cosine)) @ two
    at_zero = math.atan2(one[:, 1] @ two[:, 0], one[:, 0] @ two[:, 0])
    return Turns(row, at_zero if at_zero > HALF_TURN_NOISE - math.pi else at_zero + 2.0 * math.pi,
                 are_all)


def _placement(model: pin.Model, joint: int) -> pin.SE3:
    """Return the placement of a joint at neutral, without a `pin.Data`, which may be large."""
    placement = pin.SE3.Identity()
    for i in list(model.supports[joint])[1:]:
        placement = placement * model.jointPlacements[i]
    return placement


def _between(model: pin.Model, one: int, two: int) -> list[_Hinge]:
    """Return the joints that turn a body relative to another, from body 1 to body 2."""
    ways = [list(model.supports[body]) for body in (one, two)]
    shared = sum(1 for a, b in zip(*ways, strict=False) if a == b)
    up = [_hinge(model, i, -1) for i in ways[0][shared:][::-1]]
    down = [_hinge(model, i, 1) for i in ways[1][shared:]]
    return [hinge for hinge in [*up, *down] if len(hinge.axes)]


def _hinge(model: pin.Model, i: int, sense: int) -> _Hinge:
    joint = model.joints[i]
    data = joint.createData()
    joint.calc(data, pin.neutral(model))
    turns = np.array(data.S).reshape(6, -1)[3:].T
    axes = turns[turns.any(axis=1)] @ _placement(model, i).rotation.T
    return _Hinge(int(model.idx_qs[i]), axes, sense)
