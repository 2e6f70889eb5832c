"""A picture of a model that brings none: sticks between its joints and out to its frames."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

THICKNESS = 0.02  # of a stick, by the size of the mechanism


def _segments(model: pin.Model) -> list[tuple[int, NDArray[np.float64]]]:
    """Return (joint, end point in that joint's frame (3,) [m]) of every stick from its origin."""
    ends = [(model.parents[j], model.jointPlacements[j]) for j in range(1, model.njoints)]
    ends += [(f.parentJoint, f.placement) for f in model.frames]
    return [(j, M.translation.copy()) for j, M in ends if np.any(M.translation)]


def skeleton(model: pin.Model) -> pin.GeometryModel:
    """Return a geometry model of balls at the joints and sticks from each to the next ones."""
    sticks = _segments(model)
    thickness = THICKNESS * max((np.linalg.norm(p) for _, p in sticks), default=1.0)
    geometry = pin.GeometryModel()
    for j in range(model.njoints):
        ball = coal.Sphere(1.5 * thickness)
        name = f"{model.names[j]} joint"
        geometry.addGeometryObject(pin.GeometryObject(name, j, 0, pin.SE3.Identity(), ball))
    for k, (j, p) in enumerate(sticks):
        turn = pin.Quaternion.FromTwoVectors(pin.ZAxis, p / np.linalg.norm(p)).matrix()
        stick = coal.Capsule(thickness, float(np.linalg.norm(p)))
        name = f"{model.names[j]} stick {k}"
        geometry.addGeometryObject(pin.GeometryObject(name, j, 0, pin.SE3(turn, p / 2), stick))
    return geometry
