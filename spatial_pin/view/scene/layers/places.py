"""Where the joints and closures of a mechanism are, and which way their axes point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import axes_from_z
from spatial_pin.numerics.linalg import Array

AXIS_PLACES = {  # which of a joint's freedoms turn about its axis, or slide along it
    "revolute": (0,),
    "prismatic": (0,),
    "screw": (0,),
    "cylindrical": (0,),
    "planar": (2,),
    "universal": (0, 1),
}


class PairPlace(NamedTuple):
    """A pair between two bodies.

    Attributes:
        name, kind: of the joint or closure.
        joints: the bodies.
        frames: of the pair in each body, z along its axis, shape (4, 4) each.
    """

    name: str
    kind: str
    joints: tuple[int, int]
    frames: tuple[Array, Array]


def _framed(placement: pin.SE3, axes: Array) -> Array:
    M = placement.homogeneous.copy()
    M[:3, :3] = M[:3, :3] @ axes
    return M


def _outward(placement: pin.SE3) -> Array:
    """Return the direction (3,), in its own axes, in which a frame lies from its joint; else z."""
    p = placement.rotation.T @ placement.translation
    length = np.linalg.norm(p)
    return p / length if length > 0 else np.array([0.0, 0.0, 1.0])


def places(mechanism: Mechanism) -> list[PairPlace]:
    """Return every joint of the tree, and every closure that joins two frames, as a pair."""
    model, found = mechanism.model, list[PairPlace]()
    data = model.createData()
    J = pin.computeJointJacobians(model, data, mechanism.neutral).reshape(6, model.nv)
    for j, kind in enumerate(mechanism.pairs, start=1):
        columns = J[:, [model.idx_vs[j] + place for place in AXIS_PLACES.get(kind, ())]].T
        vectors = [c[3:] if np.any(c[3:]) else c[:3] for c in columns]
        axes = [data.oMi[j].rotation.T @ v / np.linalg.norm(v) for v in vectors]
        on_parent, bodies = model.jointPlacements[j], (int(model.parents[j]), j)
        axes = axes or [_outward(on_parent)]
        turn1, turn2 = axes_from_z(axes[0]), axes_from_z(axes[-1])
        frames = _framed(on_parent, turn1), _framed(pin.SE3.Identity(), turn2)
        found.append(PairPlace(model.names[j], kind, bodies, frames))
    joined = [(c, ends) for c in mechanism.closures if c.frames
              for ends in (c.joined if c.pair.has_more else [c.frames[:2]])]
    for closure, ends in joined:
        (i1, m1), (i2, m2) = (mechanism.frame_on_joint(name) for name in ends)
        turn1, turn2 = closure.geometry.axes1, closure.geometry.axes2
        if closure.type == "spherical":
            turn1 = axes_from_z(_outward(m1))
        frames = _framed(m1, turn1), _framed(m2, turn2)
        found.append(PairPlace(closure.name, closure.type, (i1, i2), frames))
    return found
