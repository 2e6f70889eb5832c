"""A picture of a model that brings none: sticks from every joint to the next and to its frames."""

from __future__ import annotations

from collections.abc import Iterable

import coal
import numpy as np
import pinocchio as pin

from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

THICKNESS = 0.013  # radius of a stick relative to the longest
SPREAD = 0.4  # how much thicker the thickest is: sticks of different bodies may coincide
FLOATING = pin.JointModelFreeFlyer().shortname()
GOLDEN = 0.5 * (5**0.5 - 1)  # multiples of it never come together again, but for whole numbers


def _ends(model: pin.Model) -> list[tuple[int, Array]]:
    """Return (joint, point in its frame (3,) [m]) of every next joint and every frame."""
    ends = [(model.parents[j], model.jointPlacements[j]) for j in range(1, model.njoints)]
    ends += [(f.parentJoint, f.placement) for f in model.frames]
    return [(int(j), M.translation.copy()) for j, M in ends]


def _distinct(points: list[Array], least: float) -> list[Array]:
    """Return the points (3,) that are further than `least` [m] from 0 and from those before."""
    kept: list[Array] = [np.zeros(3)]
    for p in points:
        if min(np.linalg.norm(p - other) for other in kept) > least:
            kept.append(p)
    return kept[1:]


def _stick(name: str, joint: int, p: Array, thickness: float) -> pin.GeometryObject:
    """Return a stick from the origin of a joint to the point p (3,) [m]."""
    length = float(np.linalg.norm(p))
    turn = pin.Quaternion.FromTwoVectors(pin.ZAxis, p / length).matrix()
    capsule = coal.Capsule(thickness, length)
    return pin.GeometryObject(name, joint, 0, pin.SE3(turn, p / 2), capsule)


def skeleton(model: pin.Model) -> pin.GeometryModel:
    """Return a geometry model of sticks; a ball stands for a body without extent."""
    return _sticks(model, range(model.njoints))


def with_skeleton(
    model: pin.Model, geometry: pin.GeometryModel | None, wanted: bool | None
) -> list[pin.GeometryObject]:
    """Return what a model brings to be drawn, and the sticks of its skeleton.

    Args:
        model: the model.
        geometry: what it brings.
        wanted: whether bodies are drawn as sticks; None: those that bring nothing of their own. Of
            these a body without extent and mass is nothing to be seen, and so is the ground below
            bases that float: no pair joins it to them.
    """
    own = [] if geometry is None else list(geometry.geometryObjects)
    if wanted or (wanted is None and not own):
        return [*own, *skeleton(model).geometryObjects]
    drawn = {int(visual.parentJoint) for visual in own}
    if all(model.joints[j].shortname() == FLOATING for j in model.children[0]):
        drawn.add(0)
    missing = [j for j in range(model.njoints) if j not in drawn]
    sticks = list(_sticks(model, missing).geometryObjects) if wanted is None else []
    return own + [s for s in sticks
                  if isinstance(s.geometry, coal.Capsule) or model.inertias[s.parentJoint].mass > 0]


def _sticks(model: pin.Model, joints: Iterable[int]) -> pin.GeometryModel:
    """Return the sticks of some joints' bodies."""
    ends = _ends(model)
    longest = max((float(np.linalg.norm(p)) for _, p in ends), default=0.0) or 1.0
    geometry = pin.GeometryModel()
    for j in joints:
        thickness = THICKNESS * longest * (1.0 + SPREAD * (GOLDEN * j % 1.0))
        points = _distinct([p for joint, p in ends if joint == j],
                           TOLERANCES.half_precision * longest)
        for k, p in enumerate(points):
            name = f"{model.names[j]} stick {k}"
            geometry.addGeometryObject(_stick(name, j, p, thickness))
        if not points:
            ball = coal.Sphere(1.6 * thickness)
            name = f"{model.names[j]} joint"
            geometry.addGeometryObject(pin.GeometryObject(name, j, 0, pin.SE3.Identity(), ball))
    return geometry
