"""Paths of points over the whole motion, as thin tubes."""

from __future__ import annotations

import numpy as np

from spatial_pin.motion.motion import FrameMotion, Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.shapes import Solid, ball, moved, tube
from spatial_pin.view.scene.stage import Entry, Item, Layer, Stage

TUBE = 0.006  # radius of a tube relative to the size of the scene
BEHIND = 0.35  # opacity where bodies stand before it
COLOURS = (
    (0.55, 0.08, 0.45, 1.0),
    (0.10, 0.13, 0.17, 1.0),
    (0.00, 0.38, 0.45, 1.0),
    (0.48, 0.30, 0.05, 1.0),
)


def point_motion(motion: Motion, name: str) -> FrameMotion:
    """Return the motion of a link, frame or joint, or of a link's centre of mass (`NAME.com`).

    Raises:
        UnknownNameError: there is none of that name.
        SpatialPinError: the link has no mass.
    """
    if name.endswith(".com"):
        return motion.com(name.removesuffix(".com"))
    return motion.frame(name)


def _solid(path: Array, radius: float) -> Solid:
    """Return the tube of a path, or a ball where it is a single point."""
    if np.ptp(path, axis=0).max() < 1e-3 * radius:
        return Solid(ball(radius).geometry, moved(path[0]))
    return Solid(tube(path, radius))


def traces(stage: Stage, names: tuple[str, ...]) -> Layer:
    """Return the paths of named points.

    Raises:
        UnknownNameError: there is none of that name.
        SpatialPinError: a link asked for its centre of mass has none.
    """
    paths = [stage.seen(point_motion(stage.film.motion, name).position) for name in names]
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(names))]
    items: list[Item] = []
    for name, path, colour in zip(names, paths, colours, strict=True):
        drawn, title = _solid(path, TUBE * stage.size), f"path of {name}"
        items.append(Item(title, drawn, colour))
        items.append(Item(f"{title}, behind", drawn, (*colour[:3], BEHIND), through=True,
                          called=title))
    legend = tuple(Entry(c, f"path of {n}") for c, n in zip(colours, names, strict=True))
    return Layer(tuple(items), np.concatenate([np.zeros((0, 3)), *paths]), legend)
