"""The camera: the space that a film takes up, and the best view of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.film import nice

FIELD_OF_VIEW = 35.0  # vertical [deg]: parallels stay nearly so, as in an engineer's drawing
ASPECT = 4 / 3  # width by height that the picture is made to fit
PICTURE_MARGIN = 1.15  # room round the picture, for the text over it
FLATTEST = 0.4  # least weight of an axis in the viewing direction: no other is seen as a point
ROWS_LOOKED_AT = 121  # samples that must all be in the picture: 3 degrees apart over a turn


class Framing(NamedTuple):
    """A view that holds a whole motion."""

    centre: Array  # of the view, shape (3,) [m]
    radius: float  # of the sphere about it that holds all [m]
    floor: float  # height of the lowest point [m]
    camera: Array  # position from the centre relative to the radius, shape (3,) [-]
    cell: float  # width of a cell of the ground grid [m]

    def scaled(self, points: Array) -> Array:
        """Return points (..., 3) [m] in the scene, whose radius is 1."""
        return (points - self.centre) / self.radius


def rotate(quaternion: Array, v: Array) -> Array:
    """Return vectors v (..., 3) turned by unit quaternions (..., 4), x y z w."""
    u, w = quaternion[..., :3], quaternion[..., 3:]
    t = 2 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def occupied(visuals: list[pin.GeometryObject], poses: Array) -> Array:
    """Return the corners (K, 3) [m] of all boxes in all samples, at poses (N, n_joints, 7)."""
    rows = np.unique(np.linspace(0, len(poses) - 1, ROWS_LOOKED_AT).astype(int))
    grid = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    points = [np.zeros((1, 0, 3))]
    for visual in visuals:
        visual.geometry.computeLocalAABB()
        box, M = visual.geometry.aabb_local, visual.placement
        lower, upper = np.asarray(box.min_), np.asarray(box.max_)
        if not np.all(np.abs([lower, upper]) < 1e100) or np.any(lower > upper):
            continue  # unbounded
        corners = (lower + grid * (upper - lower)) @ M.rotation.T + M.translation
        pose = poses[rows, None, visual.parentJoint]
        points.append((pose[..., :3] + rotate(pose[..., 3:], corners)).reshape(1, -1, 3))
    return np.concatenate(points, axis=1)[0]


def direction(extent: Array) -> Array:
    """Return the unit vector (3,) from centre to camera: flat things are seen face on, tilted."""
    thin = np.max(extent) / np.maximum(extent, 1e-3 * np.max(extent))
    weight = np.clip(thin / np.max(thin), FLATTEST, 1.0)
    v = weight * [0.7, -1.0, 0.75]
    return v / np.linalg.norm(v)


def axes_of_view(v: Array) -> Array:
    """Return right and up of the picture seen along the unit vector v (3,), shape (2, 3)."""
    right = np.cross([0.0, 0.0, 1.0], v)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(v, right)])


def _step_back(points: Array, v: Array) -> tuple[float, Array]:
    """Return from how far along v a camera sees all points (3, K), and the picture's middle (3,).

    The middle is that of the picture, in the plane through the origin normal to v.
    """
    axes = axes_of_view(v)
    picture, depth = axes @ points, v @ points
    half = math.tan(math.radians(FIELD_OF_VIEW) / 2) * np.array([ASPECT, 1.0]) / PICTURE_MARGIN
    away = float(np.max(depth + np.max(np.abs(picture) / half[:, None], axis=0)))
    seen = picture / (away - depth)
    return away, away * (seen.min(axis=1) + seen.max(axis=1)) / 2 @ axes


def frame(points: Array, v: Array | None = None) -> Framing:
    """Return the view that holds the points (K, 3) [m], in the middle of the picture.

    The camera is in direction v (3,) from the centre, by default the best one.
    """
    columns = np.ascontiguousarray(points.T)  # NumPy is ten times faster along long rows
    if len(points) == 0 or np.ptp(columns, axis=1).max() == 0:
        columns = np.concatenate([columns, [[-1, 1]] * 3], axis=1)
    lower, upper = columns.min(axis=1), columns.max(axis=1)
    v = direction(upper - lower) if v is None else v
    centre = (lower + upper) / 2
    for _ in range(5):
        centre = centre + _step_back(columns - centre[:, None], v)[1]
    away = _step_back(columns - centre[:, None], v)[0]
    radius = float(np.max(np.linalg.norm(columns - centre[:, None], axis=0)))
    return Framing(centre, radius, float(lower[2]), away / radius * v, nice(radius / 7))
