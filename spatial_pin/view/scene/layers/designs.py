"""What a design was to do: points and placements of its goals, beside the paths that it goes."""

from __future__ import annotations

import numpy as np

from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.goals import PathGoal, PosesGoal
from spatial_pin.synthesis.ranked_designs import Design
from spatial_pin.view.scene.layers.traces import traces
from spatial_pin.view.scene.shapes import ball, moved, rod
from spatial_pin.view.scene.stage import Entry, Item, Layer, Stage, joined

# radii, and a length, relative to the size of the scene
DESIGN_BALL, DESIGN_ROD, DESIGN_ARM = 0.014, 0.005, 0.10
TARGET = (0.08, 0.08, 0.10, 1.0)  # no part is black
AXES = ((0.80, 0.12, 0.12, 1.0), (0.10, 0.55, 0.15, 1.0), (0.12, 0.30, 0.80, 1.0))  # x, y, z
# a rod along z is turned so that z is x, y, z
TURNS = (np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=float),
         np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], dtype=float), np.eye(3))


def designs(stage: Stage, design: Design, drawn: tuple[str, ...]) -> Layer:
    """Return balls at target points, triads at target placements, and paths of their frames.

    Args:
        stage: what is shown.
        design: whose goals are drawn.
        drawn: frames whose paths are drawn anyway.

    Raises:
        SpatialPinError: something else is shown than the design's mechanism.
    """
    shown = stage.film.mechanism
    if shown.name != design.mechanism.name or shown.dimensions != design.mechanism.dimensions:
        raise SpatialPinError(f"mechanism {shown.name!r}: the design has other dimensions than the "
                              "mechanism shown; show design.motion() or one of design.states")
    layers, frames = list[Layer](), list[str]()
    for k, met in enumerate(design.met):
        if isinstance(met.goal, PathGoal):
            layers.append(_points(stage, f"design {k}", met.goal, met.targets))
        elif isinstance(met.goal, PosesGoal):
            layers.append(_triads(stage, f"design {k}", met.goal, met.targets))
        else:
            continue
        frames.append(met.goal.frame)
    if len(stage.film.rows) > 1:
        layers.append(traces(stage, tuple(x for x in dict.fromkeys(frames) if x not in drawn)))
    return joined(layers)


def _points(stage: Stage, name: str, goal: PathGoal, points: Array) -> Layer:
    """Return a ball at every point."""
    seen = stage.seen(points)
    items = [Item(f"{name} point {i}", ball(DESIGN_BALL * stage.size), TARGET,
                  placement=moved(point), through=True) for i, point in enumerate(seen)]
    return Layer(tuple(items), seen, (Entry(TARGET, f"points asked of {goal.frame}"),))


def _triads(stage: Stage, name: str, goal: PosesGoal, placements: Array) -> Layer:
    """Return three rods at every placement, in the colours of x, y and z."""
    items = []
    for i, placement in enumerate(placements):
        for axis, colour, turn in zip("xyz", AXES, TURNS, strict=True):
            place = moved(stage.seen(placement[:3, 3]))
            place[:3, :3] = stage.upright @ placement[:3, :3] @ turn
            items.append(Item(f"{name} placement {i} {axis}",
                              rod(DESIGN_ROD * stage.size, 0.0, DESIGN_ARM * stage.size), colour,
                              placement=place, through=True))
    legend = tuple(Entry(colour, f"{axis} of placements asked of {goal.frame}")
                   for axis, colour in zip("xyz", AXES, strict=True))
    return Layer(tuple(items), stage.seen(placements[:, :3, 3]), legend)
