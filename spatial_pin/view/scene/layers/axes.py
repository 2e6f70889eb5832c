"""The axes of joints and closures, as the centre lines of drawings."""

from __future__ import annotations

import numpy as np

from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.layers.places import AXIS_PLACES, places
from spatial_pin.view.scene.shapes import Solid, turned
from spatial_pin.view.scene.stage import Item, Layer, Stage

COLOUR = (0.10, 0.11, 0.13, 1.0)
RADIUS, LENGTH = 0.0035, 0.35  # half the length; by the size of the scene
DASHES = (9.0, 2.0, 1.5, 2.0)  # lengths of dash, space, dot, space of an axis
AXIAL = (
    *AXIS_PLACES,
    "point_on_line",
    "point_on_plane",
    "parallel",
    "perpendicular",
)  # pairs that have one


def _centre_line(length: float, radius: float) -> Solid:
    """Return the dash-dotted line of drawings, along z from -length to length [m]."""
    ends = [0.0]
    for part in (*(DASHES * 3), DASHES[0]):
        ends.append(ends[-1] + part)
    z = length * (2 * np.array(ends) / ends[-1] - 1)
    corners = [
        (r, x)
        for a, b in zip(z[::2], z[1::2], strict=True)
        for r, x in ((0.0, a), (radius, a), (radius, b), (0.0, b))
    ]
    return turned(*corners, segments=12)


def axes(stage: Stage) -> Layer:
    """Return the axis of every joint and closure that has one; both pins of a universal one."""
    length = LENGTH * stage.size
    line = _centre_line(length, RADIUS * stage.size)
    items: list[Item] = []
    points: list[Array] = [np.zeros((0, 3))]
    for pair in places(stage.film.mechanism):
        sides = (0, 1) if pair.kind in ("universal", "perpendicular") else (1,)
        for side in sides if pair.kind in AXIAL else ():
            joint, frame = pair.joints[side], pair.frames[side]
            items.append(
                Item(f"axis {pair.name} {side}", line, COLOUR, joint, frame, through=True,
                     called=f"axis of {pair.name}", axial=True)
            )
            points += [
                stage.points(joint, frame[:3, 3] + z * length * frame[:3, 2]) for z in (-1, 1)
            ]
    return Layer(tuple(items), np.concatenate(points))
