"""Other configurations of the same mechanism, in the same place or side by side."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.film import driver_readings
from spatial_pin.view.scene.framing import axes_of_view, occupied
from spatial_pin.view.scene.layers.bodies import body_items
from spatial_pin.view.scene.stage import Colour, Entry, Item, Label, Layer, Stage

OPACITY = 0.28  # of four that lie on each other a body behind is still seen
SPACING = 1.12  # from one picture to the next relative to their width and height
LABEL_COLOUR = (0.75, 0.78, 0.81, 1.0)


def in_view(state: State, stage: Stage) -> Array:
    """Return the joint placements of a state in the view, shape (n_joints, 4, 4).

    Raises:
        SpatialPinError: it is a state of another mechanism.
    """
    model = stage.film.mechanism.model
    if state.mechanism.coordinates != stage.film.mechanism.coordinates:
        raise SpatialPinError(
            f"a ghost is a state of mechanism {state.mechanism.name!r}; "
            f"the picture is of {stage.film.mechanism.name!r}"
        )
    data = model.createData()
    pin.forwardKinematics(model, data, state.q)
    turn = np.eye(4)
    turn[:3, :3] = stage.upright
    return np.array([turn @ M.homogeneous for M in data.oMi])


def words(state: State) -> str:
    """Return what tells a state from the others: its branch, and the values of its drivers."""
    branch = [f"branch {state.branch}"] if state.branch else []
    values = [reading.text(0) for reading in driver_readings(state)]
    return ", ".join(branch + values) or "another configuration"


def _copies(
    stage: Stage, parts: tuple[Item, ...], joints: Array, name: str, fade: float, shift: Array
) -> list[Item]:
    """Return the bodies at other joint placements (n_joints, 4, 4), moved by shift (3,) [m]."""
    move = np.eye(4)
    move[:3, 3] = shift
    return [
        replace(
            part,
            name=f"{name} {part.name}",
            joint=None,
            colour=_faded(part.colour, fade),
            placement=move @ joints[part.joint] @ part.placement,
        )
        for part in parts
    ]


def _faded(colour: Colour, fade: float) -> Colour:
    return (*colour[:3], fade * colour[3])


def _held(stage: Stage, joints: Array) -> Array:
    """Return the corners (K, 3) [m] of the bodies at joint placements (n_joints, 4, 4)."""
    poses = np.array([pin.SE3ToXYZQUAT(pin.SE3(M)) for M in joints])[None]
    return occupied(list(stage.visuals), poses)


def ghosts(stage: Stage, states: tuple[State, ...]) -> Layer:
    """Return other configurations in the same place, half transparent.

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    everything = body_items(stage.visuals, stage)
    parts = tuple(part for part in everything if part.joint != 0)  # the ground is there already
    items: list[Item] = []
    legend: list[Entry] = []
    points: list[Array] = [np.zeros((0, 3))]
    for k, state in enumerate(states, start=1):
        joints = in_view(state, stage)
        items += _copies(stage, parts, joints, f"ghost {k}", OPACITY, np.zeros(3))
        points.append(_held(stage, joints))
        legend.append(Entry(LABEL_COLOUR, f"faint: {words(state)}"))
    return Layer(tuple(items), np.concatenate(points), tuple(legend))


def _steps(points: Array, direction: Array, n: int) -> Array:
    """Return where n pictures stand in rows and columns, shape (n, 3) [m], the first at 0."""
    axes = axes_of_view(direction)
    wide, high = SPACING * np.ptp(points @ axes.T, axis=0)
    columns = min(range(1, n + 1), key=lambda c: max(c * wide / 4, math.ceil(n / c) * high / 3))
    row, column = np.divmod(np.arange(n), columns)
    return column[:, None] * wide * axes[0] - row[:, None] * high * axes[1]


def beside(stage: Stage, states: tuple[State, ...], direction: Array) -> Layer:
    """Return other configurations side by side with the first, which is the film itself.

    Args:
        stage: the film.
        states: what stands beside it.
        direction: unit vector from the middle to the camera, shape (3,).

    Raises:
        SpatialPinError: one is a state of another mechanism.
    """
    parts = body_items(stage.visuals, stage)
    placed = [in_view(state, stage) for state in states]
    corners = [occupied(list(stage.visuals), stage.poses), *(_held(stage, M) for M in placed)]
    steps = _steps(np.concatenate(corners), direction, len(corners))
    items: list[Item] = []
    for k, (joints, step) in enumerate(zip(placed, steps[1:], strict=True), start=1):
        items += _copies(stage, parts, joints, f"beside {k}", 1.0, step)
    moved = [points + step for points, step in zip(corners, steps, strict=True)]
    names = [_first_words(stage), *map(words, states)]
    labels = [
        Label(name, _foot(points, direction)) for name, points in zip(names, moved, strict=True)
    ]
    return Layer(tuple(items), np.concatenate(moved), labels=tuple(labels))


def _first_words(stage: Stage) -> str:
    source = stage.film.source
    return words(source) if isinstance(source, State) else "the motion"


def _foot(points: Array, direction: Array) -> Array:
    """Return the point (3,) in the middle below points (K, 3), as the camera sees them."""
    axes = axes_of_view(direction)
    seen = points @ axes.T
    middle = (seen[:, 0].min() + seen[:, 0].max()) / 2
    return np.array([middle, seen[:, 1].min()]) @ axes + (points @ direction).mean() * direction
