"""The angle of a link in the world: the direction of its x axis, seen along an axis.

If all hinges between the ground and the link are parallel to the axis, as in a plane mechanism, the
angle is a sum of theirs and counts turns, however far apart samples are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spatial_pin._support.columns import XYZ
from spatial_pin._support.lazy import made_once
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

ANGLE = "angle"
NEARLY_ALONG = 0.99  # cosine beyond which an x axis along the axis has no direction about it
HALF_TURN_NOISE = 1e-9  # round-off of half a turn, which is +pi and not -pi [rad]


class LinkAngle(NamedTuple):
    """The angle of a frame about an axis of the world.

    Attributes:
        frame: index in Pinocchio's model.
        label: in words.
        axis: (3,) unit vector.
        arm: (3,) axis of the frame whose direction counts: x, or y if x lies along the axis.
        aside: (2, 3) directions of the world at zero and at a quarter of a turn.
        sums: (nq,) coefficients of the coordinates, if hinges are parallel to the axis; else None.
        zero: angle at zero coordinates [rad].
    """

    frame: int
    label: str
    axis: Array
    arm: Array
    aside: Array
    sums: Array | None
    zero: float

    def directed(self, rotations: Array) -> Array:
        """Return the angle (N,) of rotations (N, 3, 3) of the frame, within half a turn [rad]."""
        x, y = np.moveaxis((rotations @ self.arm) @ self.aside.T, -1, 0)
        angle: Array = np.arctan2(y.real, x.real)
        if np.iscomplexobj(x):  # imaginary parts are derivatives
            angle = angle + 1j * (x.real * y.imag - y.real * x.imag) / (x.real**2 + y.real**2)
        return np.where(angle < HALF_TURN_NOISE - np.pi, angle + 2.0 * np.pi, angle)

    def along(self, rotations: Array, q: Array) -> Array:
        """Return the angle (N,) of samples that follow each other, without jumps [rad].

        Given are rotations (N, 3, 3) of the frame and configurations (N, nq).
        """
        if np.iscomplexobj(rotations):  # with derivatives, each sample by itself
            return self.directed(rotations)
        if self.sums is not None:
            return self.zero + q @ self.sums
        angle: Array = np.unwrap(self.directed(rotations))
        return angle

    def slope(self, evaluation: LoopEquations) -> Array:
        """Return the derivative (nv,) for joint velocities at the last `update`."""
        arm = evaluation.frame(self.frame).rotation @ self.arm
        along = float(self.axis @ arm)
        turned: Array = (self.axis - along * arm) / max(1.0 - along * along, TOLERANCES.zero)
        return turned @ evaluation.frame_jacobian(self.frame)[3:]


def link_angle(mechanism: Mechanism, spec: str) -> LinkAngle | None:
    """Return the angle for `LINK.angle`, or `LINK.angle.x`, `.y` or `.z`; None for other names.

    Without an axis it is the common direction of all hinges from the ground to the link, or, for a
    link that only slides, of all hinges of the mechanism.

    Raises:
        SpatialPinError: no axis is named, and its hinges are not parallel.
    """
    name, _, last = spec.rpartition(".")
    letter = last if last in XYZ else ""
    name = name.removesuffix(f".{ANGLE}") if letter else name
    if spec != f"{name}.{ANGLE}{f'.{letter}' * bool(letter)}" or name not in mechanism.frame_ids:
        return None
    return _named(mechanism, name, letter, spec)


@made_once
def _named(mechanism: Mechanism, name: str, letter: str, spec: str) -> LinkAngle:
    frame = mechanism.frame_id(mechanism.placed(name))
    with loops_of(mechanism) as evaluation:
        evaluation.update(mechanism.neutral)
        turns, every = evaluation.frame_jacobian(frame)[3:].copy(), _turns(evaluation)
        rotation = evaluation.frame(frame).rotation.copy()
    own = turns if turns.any() else every
    own = own[:, own.any(axis=0)]
    if letter:
        axis = np.eye(3)[XYZ.index(letter)]
    elif own.size and np.abs(np.cross(own.T, own[:, 0])).max() <= TOLERANCES.nothing:
        axis = next(x for x in every.T if x.any() and np.abs(np.cross(x, own[:, 0])).max()
                    <= TOLERANCES.nothing)  # the sense of the first parallel hinge of all
        axis = axis / np.linalg.norm(axis)
    else:
        raise SpatialPinError(
            f"{spec}: the hinges that carry {name!r} are not parallel, so that it turns about no "
            f"axis of its own; say about which: {spec}.x, {spec}.y or {spec}.z")
    arm = np.eye(3)[int(abs(float(axis @ rotation[:, 0])) > NEARLY_ALONG)]
    first = np.eye(3)[int(abs(axis[0]) > NEARLY_ALONG)]
    first = first - (axis @ first) * axis
    first /= np.linalg.norm(first)
    label = f"{spec[: -2 * bool(letter) or None].replace('.' + ANGLE, ' ' + ANGLE)}"
    angle = LinkAngle(frame, label + f" about {letter}" * bool(letter), axis, arm,
                      np.array([first, np.cross(axis, first)]), None, 0.0)
    sums = _sums(mechanism, axis, turns)
    if sums is None:
        return angle
    zero = float(angle.directed(rotation[None])[0] - mechanism.neutral @ sums)
    return angle._replace(sums=sums, zero=zero)


def _turns(evaluation: LoopEquations) -> Array:
    """Return the rotation axes (3, nv) of all joints relative to their parents."""
    model = evaluation.mechanism.model
    turns = np.zeros((3, model.nv))
    for j in range(1, model.njoints):
        own = slice(model.idx_vs[j], model.idx_vs[j] + model.nvs[j])
        turns[:, own] = evaluation.body_jacobian(j)[3:, own]
    return turns


def _sums(mechanism: Mechanism, axis: Array, turns: Array) -> Array | None:
    """Return the coefficients (nq,) of coordinates in a turn about an axis; None if incomplete."""
    parts = axis @ turns
    if np.abs(turns - np.outer(axis, parts)).max(initial=0.0) > TOLERANCES.nothing:
        return None
    sums = np.zeros(mechanism.model.nq)
    index_of = {c.v: c.q for c in mechanism.coordinate_table.values()}
    for v in np.flatnonzero(parts):
        if index_of.get(int(v), -1) < 0:
            return None
        sums[index_of[int(v)]] = parts[v]
    return sums
