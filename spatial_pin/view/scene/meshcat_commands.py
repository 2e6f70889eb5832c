"""A film as meshcat commands: bodies, extras, ground grid, camera, tracks."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import umsgpack

from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.film import Film
from spatial_pin.view.scene.framing import FIELD_OF_VIEW, Framing, direction, frame, occupied
from spatial_pin.view.scene.layers.arrows import arrows, traces
from spatial_pin.view.scene.layers.gaps import gaps
from spatial_pin.view.scene.layers.glyphs import axes, glyphs
from spatial_pin.view.scene.layers.overlays import (
    clearances,
    designs,
    ghosts,
    side_by_side,
    workspaces,
)
from spatial_pin.view.scene.layers.visuals import (
    bodies,
    centres,
    colour,
    contacts,
    springs,
    with_skeleton,
)
from spatial_pin.view.scene.look import Look
from spatial_pin.view.scene.shapes import meshcat, mg
from spatial_pin.view.scene.stage import Item, Layer, Stage, Track, joined, joint_poses, upright

__all__ = ["MeshcatScene", "colour", "grid_lines", "item_path", "joint_paths", "scene"]

GROUP = "/mechanism"
GRID = f"{GROUP}/ground grid"
GRID_COLOUR = 0xDFE3E8  # a light grey, on white
LIGHTS = {  # intensities of meshcat's; white is as white as the paper only where they fall straight
    "AmbientLight": 0.52,
    "PointLightPositiveX": 0.5,  # from the front left, near the first position of the camera
    "PointLightNegativeX": 0.3,
    "FillLight": 0.12,
}
GLOSS = 0x222222  # a little: faces of black links differ by it
FLOAT32 = 0x17  # meshcat's MessagePack extension for a Float32Array
FRONT_SIDE, BOTH_SIDES = 0, 2  # of faces, as three.js numbers them


class MeshcatScene(NamedTuple):
    """A picture."""

    commands: list[bytes]  # meshcat's, packed
    framing: Framing  # the camera
    layer: Layer  # legend, alarms and labels; `labels` are in the scaled scene
    extras: list[bytes]  # commands of further layers, hidden at first
    parts: list[dict[str, Any]]  # that can be pointed at, shown and hidden
    extent: Array  # points that the picture holds, those farthest out, shape (K, 3) [m]
    hidden: list[str]  # groups that are hidden at first
    shadow: bool | None  # as `Look` has it


@dataclass(frozen=True)
class Recorder:
    """A meshcat window that keeps the commands it is sent instead of sending them on."""

    commands: list[bytes] = field(default_factory=list)

    def send(self, command: Any) -> None:
        """Keep a command, packed."""
        self.commands.append(umsgpack.packb(command.lower()))


def animation(seconds: Array, tracks: dict[str, Track]) -> bytes:
    """Return the command of an animation, by meshcat path, that repeats for ever.

    Meshcat's own `Animation` keeps every key apart; arrays make the page five times smaller.
    """
    clips = []
    for path, track in tracks.items():
        poses = track.poses
        parts = [("position", "vector3", poses[:, :3]), ("quaternion", "quaternion", poses[:, 3:])]
        if track.scales is not None:
            parts.append(("scale", "vector3", track.scales))
        times = _float32(seconds if track.seconds is None else track.seconds)
        keys = [{"name": f".{name}", "type": kind, "times": times, "values": _float32(x)}
                for name, kind, x in parts]
        clips.append({"path": path, "clip": {"fps": 1, "name": "default", "tracks": keys}})
    options = {"play": True, "repetitions": math.inf}
    return umsgpack.packb({"type": "set_animation", "animations": clips, "options": options,
                           "path": ""})


def _float32(x: Array) -> Any:
    return umsgpack.Ext(FLOAT32, np.asarray(x, "<f4").tobytes())


def joint_paths(model: pin.Model) -> list[str]:
    """Return the meshcat path of every joint."""
    return [f"{GROUP}/{_plain(name)}" for name in model.names]


def item_path(item: Item, model: pin.Model) -> str:
    """Return the meshcat path of a solid."""
    parent = GROUP if item.joint is None else f"{GROUP}/{_plain(model.names[item.joint])}"
    return f"{parent}/{_plain(item.name)}"


def _plain(name: str) -> str:
    """Return a name that is one step of a path."""
    return name.replace("/", "_")


def _add_items(viewer: Any, film: Film, items: tuple[Item, ...]) -> dict[str, Track]:
    """Send the solids; return the tracks of those that move on their own."""
    tracks = {}
    for item in items:
        path = item_path(item, film.mechanism.model)
        if item.track is not None:
            start = pin.XYZQUATToSE3(item.track.poses[0]).homogeneous
            if item.track.scales is not None:  # a matrix of 0 has no rotation
                start[:3, :3] *= np.maximum(item.track.scales[0], 1e-9)
            viewer[path].set_transform(start)
            tracks[path] = item.track
            path += "/solid"
        *rgb, opacity = item.colour
        red, green, blue = (round(255 * x) for x in rgb)
        node = viewer[path]
        node.set_object(item.solid.geometry, mg.MeshPhongMaterial(
            color=(red << 16) + (green << 8) + blue,
            opacity=opacity,
            flatShading=item.solid.faceted,
            specular=GLOSS,
            transparent=item.through or opacity != 1.0,
            depthTest=not item.through,
            side=FRONT_SIDE if item.through else BOTH_SIDES,
        ))
        node.set_transform(item.placement @ item.solid.placement)
    return tracks


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
    for light, intensity in LIGHTS.items():
        viewer[f"/Lights/{light}/<object>"].set_property("intensity", intensity)
    lines = mg.PointsGeometry(grid_lines(framing).T)
    grid = mg.LineSegments(lines, mg.LineBasicMaterial(color=GRID_COLOUR))
    viewer[GRID].set_object(grid)
    scale = np.diag([*[1 / framing.radius] * 3, 1.0])
    scale[:3, 3] = -framing.centre / framing.radius
    viewer[GROUP].set_transform(scale)
    x, y, z = (float(c) for c in framing.camera)
    camera = viewer["/Cameras/default/rotated/<object>"]
    camera.set_property("position", [x, z, -y])
    camera.set_property("fov", FIELD_OF_VIEW)


def _layers(stage: Stage, look: Look, bare: bool, towards: Array) -> dict[str, list[Layer]]:
    """Return all layers by groups; `bare` where the model has no visuals."""
    layers = {"links": [bodies(stage)], "springs": [springs(stage)], "gaps": [gaps(stage)],
              "contacts": [contacts(stage)]}
    if bare if look.pairs is None else look.pairs:
        layers["pairs"] = [glyphs(stage, through=not bare)]
    if look.axes:
        layers["axes"] = [axes(stage)]
    if look.centres:
        layers["centres"] = [centres(stage)]
    if look.clearance is not None:
        layers["clearance"] = [clearances(stage, look.clearance)]
    if look.workspace is not None:
        layers["workspace"] = [workspaces(stage, look.workspace)]
    if look.design is not None:
        layers["design"] = [designs(stage, look.design, look.traces)]
    layers |= {"traces": [traces(stage, look.traces)], "arrows": arrows(stage, look.arrows)}
    if look.ghosts:
        layers["ghosts"] = [side_by_side(stage, look.ghosts, towards) if look.side_by_side
                            else ghosts(stage, look.ghosts)]
    return layers


def _in_groups(layers: dict[str, list[Layer]]) -> Layer:
    return joined([joined(some, group) for group, some in layers.items()])


def scene(film: Film, look: Look | None = None) -> MeshcatScene:
    """Return the scene of a film.

    The scene is centred and scaled to a radius of 1, so that the viewer's lights and clipping
    planes fit a watch and a crane alike. Links without visuals are shown as a skeleton.
    """
    model, geometry = film.mechanism.model, film.mechanism.visual_model
    bare = geometry is None or geometry.ngeoms == 0
    look = look or Look()
    visuals = with_skeleton(model, geometry, look.skeleton)
    poses = joint_poses(model, film.q)
    held = occupied(visuals, poses)
    towards = direction(np.ptp(held.T.copy(), axis=1)) if len(held) else np.array([0.5, -0.7, 0.5])
    bodies_alone = frame(held, towards)
    stage = Stage(film, tuple(visuals), poses, upright(model), bodies_alone.radius)
    shown = _layers(stage, look, bare, towards)
    on_demand = {"pairs": [glyphs(stage, through=True)], "axes": [axes(stage)]}
    layer = _in_groups(shown)
    hidden = _in_groups({name: x for name, x in on_demand.items() if name not in shown})
    points = np.concatenate([held, layer.points])
    framing = frame(points, towards) if len(layer.points) else bodies_alone
    recorder, extras = Recorder(), Recorder()
    viewer = meshcat.Visualizer(window=recorder)
    _add_surroundings(viewer, framing)
    tracks = {}
    for j, path in enumerate(joint_paths(model)):
        viewer[path].set_transform(pin.XYZQUATToSE3(poses[0, j]).homogeneous)
        if np.ptp(poses[:, j], axis=0).max() > 0:
            tracks[path] = Track(poses[:, j])
    tracks |= _add_items(viewer, film, layer.items)
    tracks |= _add_items(meshcat.Visualizer(window=extras), film, hidden.items)
    if film.seconds[-1] > 0:
        recorder.commands.append(animation(film.seconds, tracks))
    parts = []
    for item in (*layer.items, *hidden.items):
        is_sign = item.group == "pairs" and item.joint is not None
        parts.append({
            "path": item_path(item, model), "group": item.group, "name": item.called or item.name,
            # middle and axis of the sign of a pair in its joint's frame [m]
            "at": item.placement[:3, 3].tolist() if is_sign else None,
            "along": item.placement[:3, 2].tolist() if item.axial else None})
    if len(points):  # those that are the farthest in any of 27 directions
        steps = [-1.0, 0.0, 1.0]
        directions = np.array([(x, y, z) for x in steps for y in steps for z in steps])
        points = points[np.unique((directions @ points.T).argmax(axis=1))]
    groups = list(dict.fromkeys(item.group for item in hidden.items))
    return MeshcatScene(recorder.commands, framing, layer, extras.commands, parts, points, groups,
                 look.shadow)
