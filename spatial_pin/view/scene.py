"""A film as meshcat commands: solids, colours, ground grid, camera, and one track per joint."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
import umsgpack
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from spatial_pin.kinematics.views import placements
from spatial_pin.view.film import Film
from spatial_pin.view.framing import FIELD_OF_VIEW, Framing, frame, occupied
from spatial_pin.view.quiet_meshcat import meshcat, mg
from spatial_pin.view.shapes import solid
from spatial_pin.view.skeleton import skeleton

Array = NDArray[np.float64]

GROUP = "/mechanism"
GRID_COLOUR = 0xDFE3E8
AMBIENT_LIGHT = 0.55  # leaves colours as bright as they were chosen, with the other lights
FLOAT32 = 0x17  # meshcat's MessagePack extension for a Float32Array
# bodies without a colour of their own: steel grey ground, then the colours of Okabe and Ito
GROUND_COLOUR = (0.62, 0.66, 0.70, 1.0)
BODY_COLOURS = (
    (0.835, 0.369, 0.000, 1.0),
    (0.000, 0.447, 0.698, 1.0),
    (0.000, 0.620, 0.451, 1.0),
    (0.902, 0.624, 0.000, 1.0),
    (0.800, 0.475, 0.655, 1.0),
    (0.337, 0.706, 0.914, 1.0),
)


@dataclass(frozen=True)
class Recorder:
    """A meshcat window that keeps the commands it is sent instead of sending them on."""

    commands: list[bytes] = field(default_factory=list)

    def send(self, command: Any) -> None:
        """Keep a command, packed."""
        self.commands.append(umsgpack.packb(command.lower()))


@dataclass(frozen=True, eq=False)
class Tracks:
    """An animation that repeats for ever, one track per joint.

    Meshcat's own `Animation` keeps every key apart; arrays make the page five times smaller.

    Attributes:
        seconds: when each row is shown, shape (N,) [s].
        poses: joint placements by meshcat path, shape (N, 7), x y z and quaternion x y z w.
    """

    seconds: Array
    poses: dict[str, Array]

    def lower(self) -> dict[str, Any]:
        """Return the command as meshcat's viewer reads it."""
        options = {"play": True, "repetitions": math.inf}
        clips = [{"path": p, "clip": self._clip(x)} for p, x in self.poses.items()]
        return {"type": "set_animation", "animations": clips, "options": options, "path": ""}

    def _clip(self, poses: Array) -> dict[str, Any]:
        parts = (("position", "vector3", poses[:, :3]), ("quaternion", "quaternion", poses[:, 3:]))
        times = _float32(self.seconds)
        tracks = [
            {"name": f".{name}", "type": kind, "times": times, "values": _float32(x)}
            for name, kind, x in parts
        ]
        return {"fps": 1, "name": "default", "tracks": tracks}


def _float32(x: Array) -> Any:
    return umsgpack.Ext(FLOAT32, np.asarray(x, "<f4").tobytes())


def joint_poses(model: pin.Model, q: Array) -> Array:
    """Return the placements of all joints, shape (N, n_joints, 7), x y z and quaternion x y z w.

    The scene stands upright: it is turned so that gravity points down the z axis of the view.
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


def _joint_paths(model: pin.Model) -> list[str]:
    """Return the meshcat path of every joint."""
    return [f"{GROUP}/{name.replace('/', '_')}" for name in model.names]


def colour(visual: pin.GeometryObject) -> tuple[float, ...]:
    """Return the colour (red, green, blue, opacity) of a geometry object, 0 to 1 each."""
    if visual.overrideMaterial:
        return tuple(float(x) for x in np.clip(visual.meshColor, 0.0, 1.0))
    if visual.parentJoint == 0:
        return GROUND_COLOUR
    return BODY_COLOURS[(visual.parentJoint - 1) % len(BODY_COLOURS)]


def _material(visual: pin.GeometryObject, faceted: bool) -> Any:
    *rgb, opacity = colour(visual)
    red, green, blue = (round(255 * x) for x in rgb)
    return mg.MeshPhongMaterial(
        color=(red << 16) + (green << 8) + blue, opacity=opacity, flatShading=faceted
    )


def _add_solids(viewer: Any, film: Film, visuals: list[pin.GeometryObject], size: float) -> None:
    """Send every geometry object that can be drawn; warn of the others."""
    paths = _joint_paths(film.mechanism.model)
    for k, visual in enumerate(visuals):
        drawn = solid(visual, size)
        if drawn is None:
            empty = type(visual.geometry).__name__
            warnings.warn(f"{visual.name!r} is not shown: it is an empty {empty}", stacklevel=2)
            continue
        node = viewer[f"{paths[visual.parentJoint]}/{k} {visual.name.replace('/', '_')}"]
        node.set_object(drawn.geometry, _material(visual, drawn.faceted))
        node.set_transform(visual.placement.homogeneous @ drawn.placement)


def grid_lines(framing: Framing) -> Array:
    """Return both ends of the lines of a square grid under the mechanism, shape (2 K, 3) [m]."""
    reach = math.ceil(1.3 * framing.radius / framing.cell)
    step = np.repeat(np.arange(-reach, reach + 1), 2)
    end = np.tile([-reach, reach], 2 * reach + 1)
    nodes = np.concatenate([np.stack([step, end], axis=1), np.stack([end, step], axis=1)])
    xy = framing.cell * (nodes + np.round(framing.centre[:2] / framing.cell))
    z = framing.floor - 2e-3 * framing.radius
    return np.concatenate([xy, np.full((len(xy), 1), z)], axis=1)


def _add_surroundings(viewer: Any, framing: Framing) -> None:
    """Send background, ground grid, camera, and the scale that makes the scene 1 in radius."""
    for key in ("top_color", "bottom_color"):
        viewer["/Background"].set_property(key, [1.0, 1.0, 1.0])
    for default in ("/Grid", "/Axes"):
        viewer[default].set_property("visible", False)
    viewer["/Lights/AmbientLight/<object>"].set_property("intensity", AMBIENT_LIGHT)
    lines = mg.PointsGeometry(grid_lines(framing).T)
    grid = mg.LineSegments(lines, mg.LineBasicMaterial(color=GRID_COLOUR))
    viewer[f"{GROUP}/ground grid"].set_object(grid)
    scale = np.diag([*[1 / framing.radius] * 3, 1.0])
    scale[:3, 3] = -framing.centre / framing.radius
    viewer[GROUP].set_transform(scale)
    x, y, z = (float(c) for c in framing.camera)
    camera = viewer["/Cameras/default/rotated/<object>"]
    camera.set_property("position", [x, z, -y])
    camera.set_property("fov", FIELD_OF_VIEW)


def _add_motion(viewer: Any, film: Film, poses: Array) -> None:
    """Send the first row's placements, and the tracks of the joints that move."""
    tracks = {}
    for j, path in enumerate(_joint_paths(film.mechanism.model)):
        viewer[path].set_transform(pin.XYZQUATToSE3(poses[0, j]).homogeneous)
        if np.ptp(poses[:, j], axis=0).max() > 0:
            tracks[path] = poses[:, j]
    if film.seconds[-1] > 0:
        viewer.window.send(Tracks(film.seconds, tracks))


def scene(film: Film) -> tuple[list[bytes], Framing]:
    """Return the meshcat commands that show a film, and how it is framed.

    The scene is centred and scaled to a radius of 1, so that the viewer's lights and clipping
    planes fit a watch and a crane alike. A mechanism without visuals is shown as a skeleton.
    """
    model, geometry = film.mechanism.model, film.mechanism.visual_model
    if geometry is None or geometry.ngeoms == 0:
        geometry = skeleton(model)
    visuals = list(geometry.geometryObjects)
    poses = joint_poses(model, film.q)
    framing = frame(occupied(visuals, poses))
    recorder = Recorder()
    viewer = meshcat.Visualizer(window=recorder)
    _add_surroundings(viewer, framing)
    _add_solids(viewer, film, visuals, framing.radius)
    _add_motion(viewer, film, poses)
    return recorder.commands, framing
