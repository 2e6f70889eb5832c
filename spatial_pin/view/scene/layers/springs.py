"""Springs between two frames, as coils that stretch."""

from __future__ import annotations

import numpy as np

from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.shapes import Solid, tube
from spatial_pin.view.scene.stage import Item, Layer, Stage, rod_between

WIRE, COIL = 0.006, 0.03  # radius of wire and coil relative to the size of the scene
COIL_TURNS, COIL_POINTS = 8, 14  # turns of a coil, points to a turn
STRAIGHT_END = 0.12  # part of the length at each end that is straight
COLOUR = (0.30, 0.33, 0.37, 1.0)


def coil(length: float, size: float) -> Solid:
    """Return a coil from 0 to 1 along z, its wire round when it is stretched to a length [m]."""
    angle = 2 * np.pi * COIL_TURNS * np.linspace(0.0, 1.0, COIL_TURNS * COIL_POINTS + 1)
    z = np.linspace(STRAIGHT_END, 1.0 - STRAIGHT_END, len(angle))
    turns = np.stack([COIL * size * np.cos(angle), COIL * size * np.sin(angle), z * length], 1)
    ends = [[0.0, 0.0, 0.0], [0.0, 0.0, STRAIGHT_END * length]]
    last = [[0.0, 0.0, length - z] for z in (STRAIGHT_END * length, 0.0)]
    path = np.concatenate([ends, turns, last])
    return Solid(tube(path, WIRE * size, segments=6), np.diag([1.0, 1.0, 1.0 / length, 1.0]))


def _ends(stage: Stage, frames: tuple[str, ...]) -> tuple[Array, Array]:
    """Return the end points of a spring, shape (N, 3) each [m]."""
    found = (stage.film.mechanism.frame_on_joint(name) for name in frames)
    first, second = (stage.points(joint, M.translation) for joint, M in found)
    return first, second


def springs(stage: Stage) -> Layer:
    """Return every spring of the mechanism that is between two frames."""
    items: list[Item] = []
    points: list[Array] = [np.zeros((0, 3))]
    for spring in stage.film.mechanism.springs:
        if not spring.frames:
            continue
        a, b = _ends(stage, spring.frames)
        length = float(np.linalg.norm(b - a, axis=1).mean())
        drawn = coil(length or stage.size, stage.size)
        items.append(Item(f"spring {spring.name}", drawn, COLOUR, track=rod_between(a, b)))
        points += [a, b]
    return Layer(tuple(items), np.concatenate(points))
