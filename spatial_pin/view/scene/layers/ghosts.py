"""Other states and motions, in the same place as the film or side by side with it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

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
from spatial_pin.view.scene.stage import Entry, Item, Layer, Stage, Track, joint_poses

OPACITY = 0.28  # of four that lie on each other a body behind is still seen
SPACING = 1.12  # from one picture to the next relative to their width and height
LABEL_COLOUR = (0.75, 0.78, 0.81, 1.0)


def words(state: State) -> str:
    """Return the branch of a state, and the values of its drivers, in words."""
    branch = [f"branch {state.branch}"] if state.branch else []
    values = [reading.text(0) for reading in driver_readings(state)]
    return ", ".join(branch + values) or "another configuration"


def others_of(
    stage: Stage, shown: Iterable[State | Motion], name: str
) -> list[tuple[list[Item], Array, str]]:
    """Return solids, corners (K, 3) [m] and names of other states and motions.

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    others = []
    for k, one in enumerate(shown, start=1):
        own, mechanism = film(one), one.mechanism
        visuals = tuple(with_skeleton(mechanism.model, mechanism.visual_model, None))
        poses = joint_poses(mechanism.model, own.q)
        there = Stage(own, visuals, poses, stage.upright, stage.size)
        parts = [replace(x, name=f"{name} {k} {x.name}") for x in body_items(visuals, there)]
        if isinstance(one, State):
            if mechanism.coordinates != stage.film.mechanism.coordinates:
                raise SpatialPinError(
                    f"a ghost is a state of mechanism {mechanism.name!r}; "
                    f"the picture is of {stage.film.mechanism.name!r}"
                )
            text = words(one)
            items = [x if x.joint == 0 else replace(x, joint=None, placement=pin.XYZQUATToSE3(
                poses[0, x.joint]).homogeneous @ x.placement) for x in parts]
        else:
            seconds, rows, how = moments(stage.film, own)
            text = f"another motion, {how}"
            items = [x if x.joint == 0 else replace(x, joint=None, track=Track(
                poses[rows, x.joint], None, seconds)) for x in parts]
        others.append((items, occupied(list(visuals), poses), text))
    return others


def ghosts(stage: Stage, shown: tuple[State | Motion, ...]) -> Layer:
    """Return other states and motions in the same place, half transparent.

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    others = others_of(stage, shown, "ghost")
    items = [replace(item, colour=(*item.colour[:3], OPACITY * item.colour[3]))
             for solids, _, _ in others for item in solids
             if item.joint is None]  # the ground is there already
    points = np.concatenate([np.zeros((0, 3)), *(corners for _, corners, _ in others)])
    legend = tuple(Entry(LABEL_COLOUR, f"faint: {text}") for _, _, text in others)
    return Layer(tuple(items), points, legend)


def side_by_side(stage: Stage, shown: tuple[State | Motion, ...], direction: Array) -> Layer:
    """Return other states and motions side by side with the first, which is the film itself.

    Args:
        stage: the film.
        shown: the other states and motions.
        direction: unit vector from the middle to the camera, shape (3,).

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    others = others_of(stage, shown, "beside")
    corners = [occupied(list(stage.visuals), stage.poses), *(points for _, points, _ in others)]
    axes, n = axes_of_view(direction), len(corners)  # in rows and columns
    wide, high = SPACING * np.ptp(np.concatenate(corners) @ axes.T, axis=0)
    columns = min(range(1, n + 1), key=lambda c: max(c * wide / 4, math.ceil(n / c) * high / 3))
    row, column = np.divmod(np.arange(n), columns)
    steps = column[:, None] * wide * axes[0] - row[:, None] * high * axes[1]
    items = []
    for (solids, _, _), step in zip(others, steps[1:], strict=True):
        for item in solids:
            if item.track is None:
                items.append(replace(item, joint=None, placement=moved(step) @ item.placement))
                continue
            poses = item.track.poses + np.concatenate([step, np.zeros(4)])
            items.append(replace(item, track=item.track._replace(poses=poses)))
    placed = [points + step for points, step in zip(corners, steps, strict=True)]
    source = stage.film.source
    first = words(source) if isinstance(source, State) else "the motion"
    names = [first, *(text for _, _, text in others)]
    labels = []
    for name, points in zip(names, placed, strict=True):  # in the middle below each, as it is seen
        seen = points @ axes.T
        middle = (seen[:, 0].min() + seen[:, 0].max()) / 2
        depth = (points @ direction).mean()
        foot = np.array([middle, seen[:, 1].min()]) @ axes + depth * direction
        labels.append((name, foot))
    return Layer(tuple(items), np.concatenate(placed), labels=tuple(labels))
