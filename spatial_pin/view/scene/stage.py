"""The parts of a picture: stage, layers, items, tracks.

A layer is a function from a `Stage` and its options to a `Layer`; `scene` lists them.
It knows nothing of meshcat's tree, of the camera, or of the other layers. All lengths of signs,
arrows and markers are fractions of `Stage.size`, so that a watch and a crane look alike.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from spatial_pin.constraints.pinocchio_views import placements
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.film import Film, Readout
from spatial_pin.view.scene.framing import rotate
from spatial_pin.view.scene.shapes import Solid

Colour = tuple[float, ...]

IDENTITY = np.eye(4)


class Track(NamedTuple):
    """Where something is in every sample."""

    poses: Array  # x y z [m] and quaternion x y z w in the view, shape (N, 7)
    scales: Array | None = None  # along its own axes, shape (N, 3); None for 1
    # when each sample is shown, shape (N,) [s]; None: as those of the film
    seconds: Array | None = None


@dataclass(frozen=True, eq=False)
class Item:
    """One solid of a picture."""

    name: str  # unique in the picture
    solid: Solid  # its shape
    colour: Colour  # red, green, blue, opacity, 0 to 1 each
    # it is fixed to; None: it is fixed in the view, or moves along its track
    joint: int | None = None
    # in the joint's frame or the view, shape (4, 4)
    placement: Array = field(default_factory=lambda: IDENTITY)
    track: Track | None = None  # of what moves on its own
    through: bool = False  # whether it is seen through other solids
    called: str = ""  # its title when it is pointed at; its name if empty
    group: str = ""  # of the parts that are shown and hidden together
    axial: bool = False  # whether z of its placement is the axis of a pair


class Entry(NamedTuple):
    """A line of the legend."""

    colour: Colour
    text: str


@dataclass(frozen=True, eq=False)
class Layer:
    """What a picture has of one kind."""

    items: tuple[Item, ...] = ()  # the solids
    # that the picture must hold besides the bodies, shape (K, 3) [m]
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    legend: tuple[Entry, ...] = ()  # meaning of its colours
    alarms: tuple[Readout, ...] = ()  # a number for each sample; 0 is no alarm
    # words in the picture, and their points, shape (3,) [m]
    labels: tuple[tuple[str, Array], ...] = ()


@dataclass(frozen=True, eq=False)
class Stage:
    """A film with its bodies in place; the view is the world, with gravity downwards."""

    film: Film
    visuals: tuple[pin.GeometryObject, ...]  # the geometry of the bodies
    poses: Array  # of the joints in the view, shape (N, n_joints, 7), x y z and quaternion x y z w
    upright: Array  # rotation from the world to the view, shape (3, 3)
    size: float  # radius of the sphere that holds the bodies in all samples [m]

    def points(self, joint: int, p: Array) -> Array:
        """Return a point p (3,) of a joint's frame [m] in the view, shape (N, 3)."""
        pose = self.poses[:, joint]
        return pose[:, :3] + rotate(pose[:, 3:], np.broadcast_to(p, (len(pose), 3)))

    def origins(self, frames: Iterable[str]) -> list[Array]:
        """Return the origins of frames by their names in the view, shape (N, 3) each."""
        placed = map(self.film.mechanism.frame_on_joint, frames)
        return [self.points(joint, M.translation) for joint, M in placed]

    def rotations(self, joint: int, axes: Array) -> Array:
        """Return axes (3, 3) of a joint's frame, in columns, in the view, shape (N, 3, 3)."""
        return Rotation.from_quat(self.poses[:, joint, 3:]).as_matrix() @ axes

    def seen(self, world: Array) -> Array:
        """Return vectors (..., 3) of the world in the view."""
        return world @ self.upright.T


def joint_poses(model: pin.Model, q: Array) -> Array:
    """Return the placements of all joints, shape (N, n_joints, 7), x y z and quaternion x y z w.

    The scene is upright: gravity points down the z axis of the view.
    """
    data = model.createData()
    view = placements(data)
    rows = np.empty((len(q), *view.shape))
    for row, configuration in zip(rows, q, strict=True):
        pin.forwardKinematics(model, data, configuration)
        row[:] = view
    rows = rows @ upright(model).T
    turns = Rotation.from_matrix(rows[..., :3, :].swapaxes(-1, -2).reshape(-1, 3, 3)).as_quat()
    return np.concatenate([rows[..., 3, :], turns.reshape(*rows.shape[:2], 4)], axis=-1)


def upright(model: pin.Model) -> Array:
    """Return the rotation (3, 3) from the world to a view in which gravity points down."""
    gravity = model.gravity.linear
    if not np.any(gravity) or (np.allclose(gravity[:2], 0.0) and gravity[2] < 0.0):
        return np.eye(3)
    return pin.Quaternion.FromTwoVectors(-gravity, np.array([0.0, 0.0, 1.0])).matrix()


def quaternions_along(v: Array) -> Array:
    """Return quaternions (N, 4) that take z to vectors v (N, 3), the last one's for those of 0."""
    length = np.linalg.norm(v, axis=1)
    given = np.maximum.accumulate(np.where(length > 0, np.arange(len(v)), 0))
    e = np.where(length[given, None] > 0, v[given], [0.0, 0.0, 1.0])
    e = e / np.linalg.norm(e, axis=1, keepdims=True)
    # z x e, 1 + z . e: half way round; any axis normal to z where e is opposite
    q = np.stack([-e[:, 1], e[:, 0], np.zeros(len(e)), 1.0 + e[:, 2]], axis=1)
    q[1.0 + e[:, 2] < 1e-12] = [1.0, 0.0, 0.0, 0.0]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def rod_between(a: Array, b: Array) -> Track:
    """Return the track of a solid from 0 to 1 along z that is to reach from a to b (N, 3) [m]."""
    along = b - a
    length = np.linalg.norm(along, axis=1)
    scales = np.stack([(length > 0).astype(float)] * 2 + [length], axis=1)
    return Track(np.concatenate([a, quaternions_along(along)], axis=1), scales)


def ball_at(points: Array, scale: Array | None = None) -> Track:
    """Return the track of a ball at points (N, 3) [m] that is `scale` (N,) times as large."""
    still = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(points), 4))
    scales = None if scale is None else np.repeat(scale[:, None], 3, axis=1)
    return Track(np.concatenate([points, still], axis=1), scales)


def joined(layers: list[Layer], group: str = "") -> Layer:
    """Return all layers as one, whose solids are shown and hidden together if they have a group."""
    return Layer(
        tuple(replace(item, group=group or item.group) for layer in layers for item in layer.items),
        np.concatenate([np.zeros((0, 3)), *(layer.points for layer in layers)]),
        tuple(entry for layer in layers for entry in layer.legend),
        tuple(alarm for layer in layers for alarm in layer.alarms),
        tuple(label for layer in layers for label in layer.labels),
    )
