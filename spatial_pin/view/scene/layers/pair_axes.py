"""Axes of joints and closures: their places on the bodies, and the centre lines of drawings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.shapes import turned
from spatial_pin.view.scene.stage import Item, Layer, Stage

AXIAL_FREEDOMS = {  # which of a joint's freedoms turn about its axis, or slide along it
    "revolute": (0,),
    "prismatic": (0,),
    "screw": (0,),
    "cylindrical": (0,),
    "planar": (2,),
    "universal": (0, 1),
}
AXIAL = (*AXIAL_FREEDOMS, "point_on_line", "point_on_plane", "parallel", "perpendicular")
COLOUR = (0.10, 0.11, 0.13, 1.0)
RADIUS, LENGTH = 0.0035, 0.35  # half the length; by the size of the scene
DASHES = (9.0, 2.0, 1.5, 2.0)  # lengths of dash, space, dot, space of an axis


class PairAxes(NamedTuple):
    """A pair between two bodies."""

    name: str  # name, kind: of the joint or closure
    kind: str
    joints: tuple[int, int]  # the bodies
    frames: tuple[Array, Array]  # of the pair in each body, z along its axis, shape (4, 4) each


def _framed(placement: pin.SE3, axes: Array) -> Array:
    M = placement.homogeneous.copy()
    M[:3, :3] = M[:3, :3] @ axes
    return M


def _outward(placement: pin.SE3) -> Array:
    """Return the direction (3,), in its own axes, in which a frame lies from its joint; else z."""
    p = placement.rotation.T @ placement.translation
    length = np.linalg.norm(p)
    return p / length if length > 0 else np.array([0.0, 0.0, 1.0])


def pairs_of(mechanism: Mechanism) -> list[PairAxes]:
    """Return every joint of the tree, and every closure that joins two frames, as a pair."""
    model, pairs = mechanism.model, list[PairAxes]()
    data = model.createData()
    J = pin.computeJointJacobians(model, data, mechanism.neutral).reshape(6, model.nv)
    for j, kind in enumerate(mechanism.pairs, start=1):
        columns = J[:, [model.idx_vs[j] + column for column in AXIAL_FREEDOMS.get(kind, ())]].T
        vectors = [c[3:] if np.any(c[3:]) else c[:3] for c in columns]
        axes = [data.oMi[j].rotation.T @ v / np.linalg.norm(v) for v in vectors]
        on_parent, bodies = model.jointPlacements[j], (int(model.parents[j]), j)
        axes = axes or [_outward(on_parent)]
        turn1, turn2 = axes_from_z(axes[0]), axes_from_z(axes[-1])
        frames = _framed(on_parent, turn1), _framed(pin.SE3.Identity(), turn2)
        pairs.append(PairAxes(model.names[j], kind, bodies, frames))
    joined = [(c, ends) for c in mechanism.closures if c.frames
              for ends in (c.joined if c.pair.has_more else [c.frames[:2]])]
    for closure, ends in joined:
        (i1, m1), (i2, m2) = (mechanism.frame_on_joint(name) for name in ends)
        turn1, turn2 = closure.geometry.axes1, closure.geometry.axes2
        if closure.type == "spherical":
            turn1 = axes_from_z(_outward(m1))
        frames = _framed(m1, turn1), _framed(m2, turn2)
        pairs.append(PairAxes(closure.name, closure.type, (i1, i2), frames))
    return pairs


def axes(stage: Stage) -> Layer:
    """Return the axis of every joint and closure that has one; both pins of a universal one."""
    length, ends = LENGTH * stage.size, [0.0]
    for part in (*(DASHES * 3), DASHES[0]):
        ends.append(ends[-1] + part)
    z = length * (2 * np.array(ends) / ends[-1] - 1)
    radius = RADIUS * stage.size
    line = turned(*((r, x) for a, b in zip(z[::2], z[1::2], strict=True)
                    for r, x in ((0.0, a), (radius, a), (radius, b), (0.0, b))), segments=12)
    items: list[Item] = []
    points: list[Array] = [np.zeros((0, 3))]
    for pair in pairs_of(stage.film.mechanism):
        sides = (0, 1) if pair.kind in ("universal", "perpendicular") else (1,)
        for side in sides if pair.kind in AXIAL else ():
            joint, frame = pair.joints[side], pair.frames[side]
            items.append(Item(f"axis {pair.name} {side}", line, COLOUR, joint, frame, through=True,
                              called=f"axis of {pair.name}", axial=True))
            points += [stage.points(joint, frame[:3, 3] + end * length * frame[:3, 2])
                       for end in (-1, 1)]
    return Layer(tuple(items), np.concatenate(points))
