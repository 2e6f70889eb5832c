"""Other states and motions, in the same place as the film or side by side with it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.film import driver_readings, film, moments
from spatial_pin.view.scene.framing import axes_of_view, occupied
from spatial_pin.view.scene.layers.visuals import body_items, with_skeleton
from spatial_pin.view.scene.shapes import moved
from spatial_pin.view.scene.stage import Entry, Item, Label, Layer, Stage, Track, joint_poses

OPACITY = 0.28  # of four that lie on each other a body behind is still seen
SPACING = 1.12  # from one picture to the next relative to their width and height
LABEL_COLOUR = (0.75, 0.78, 0.81, 1.0)


class Other(NamedTuple):
    """Something else of a mechanism that stands or moves in the picture.

    Attributes:
        items: its solids.
        points: corners of its bodies, shape (K, 3) [m].
        words: what tells it from others.
    """

    items: list[Item]
    points: Array
    words: str


def words(state: State) -> str:
    """Return what tells a state from the others: its branch, and the values of its drivers."""
    branch = [f"branch {state.branch}"] if state.branch else []
    values = [reading.text(0) for reading in driver_readings(state)]
    return ", ".join(branch + values) or "another configuration"


def others_of(stage: Stage, shown: Iterable[State | Motion], name: str) -> list[Other]:
    """Return other states and motions, each with the bodies of its own mechanism.

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    return [_other(stage, one, f"{name} {k}") for k, one in enumerate(shown, start=1)]


def _other(stage: Stage, shown: State | Motion, name: str) -> Other:
    own, mechanism = film(shown), shown.mechanism
    visuals = tuple(with_skeleton(mechanism.model, mechanism.visual_model, None))
    poses = joint_poses(mechanism.model, own.q)
    there = Stage(own, visuals, poses, stage.upright, stage.size)
    parts = [replace(part, name=f"{name} {part.name}") for part in body_items(visuals, there)]
    points = occupied(list(visuals), poses)
    if isinstance(shown, State):
        if mechanism.coordinates != stage.film.mechanism.coordinates:
            raise SpatialPinError(
                f"a ghost is a state of mechanism {mechanism.name!r}; "
                f"the picture is of {stage.film.mechanism.name!r}"
            )
        items = [part if part.joint == 0 else replace(part, joint=None, placement=pin.XYZQUATToSE3(
            poses[0, part.joint]).homogeneous @ part.placement) for part in parts]
        return Other(items, points, words(shown))
    seconds, rows, how = moments(stage.film, own)
    items = [part if part.joint == 0 else replace(part, joint=None, track=Track(
        poses[rows, part.joint], None, seconds)) for part in parts]
    return Other(items, points, f"another motion, {how}")


def _shifted(item: Item, shift: Array) -> Item:
    """Return an item moved by shift (3,) [m] in the view."""
    if item.track is not None:
        poses = item.track.poses + np.concatenate([shift, np.zeros(4)])
        return replace(item, track=item.track._replace(poses=poses))
    return replace(item, joint=None, placement=moved(shift) @ item.placement)


def ghosts(stage: Stage, shown: tuple[State | Motion, ...]) -> Layer:
    """Return other states and motions in the same place, half transparent.

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    others = others_of(stage, shown, "ghost")
    items = [replace(item, colour=(*item.colour[:3], OPACITY * item.colour[3]))
             for other in others for item in other.items
             if item.joint is None]  # the ground is there already
    points = np.concatenate([np.zeros((0, 3)), *(other.points for other in others)])
    legend = tuple(Entry(LABEL_COLOUR, f"faint: {other.words}") for other in others)
    return Layer(tuple(items), points, legend)


def _steps(points: Array, direction: Array, n: int) -> Array:
    """Return where n pictures stand in rows and columns, shape (n, 3) [m], the first at 0."""
    axes = axes_of_view(direction)
    wide, high = SPACING * np.ptp(points @ axes.T, axis=0)
    columns = min(range(1, n + 1), key=lambda c: max(c * wide / 4, math.ceil(n / c) * high / 3))
    row, column = np.divmod(np.arange(n), columns)
    return column[:, None] * wide * axes[0] - row[:, None] * high * axes[1]


def beside(stage: Stage, shown: tuple[State | Motion, ...], direction: Array) -> Layer:
    """Return other states and motions side by side with the first, which is the film itself.

    Args:
        stage: the film.
        shown: what stands beside it.
        direction: unit vector from the middle to the camera, shape (3,).

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    others = others_of(stage, shown, "beside")
    corners = [occupied(list(stage.visuals), stage.poses), *(other.points for other in others)]
    steps = _steps(np.concatenate(corners), direction, len(corners))
    items = [_shifted(item, step) for other, step in zip(others, steps[1:], strict=True)
             for item in other.items]
    placed = [points + step for points, step in zip(corners, steps, strict=True)]
    source = stage.film.source
    first = words(source) if isinstance(source, State) else "the motion"
    names = [first, *(other.words for other in others)]
    labels = [
        Label(name, _foot(points, direction)) for name, points in zip(names, placed, strict=True)
    ]
    return Layer(tuple(items), np.concatenate(placed), labels=tuple(labels))


def _foot(points: Array, direction: Array) -> Array:
    """Return the point (3,) in the middle below points (K, 3), as the camera sees them."""
    axes = axes_of_view(direction)
    seen = points @ axes.T
    middle = (seen[:, 0].min() + seen[:, 0].max()) / 2
    return np.array([middle, seen[:, 1].min()]) @ axes + (points @ direction).mean() * direction
