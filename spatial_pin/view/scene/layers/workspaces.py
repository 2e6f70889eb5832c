"""Where a frame gets to: small balls coloured by dexterity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.scene.quiet_meshcat import mg
from spatial_pin.view.scene.shapes import Solid
from spatial_pin.view.scene.stage import Colour, Entry, Item, Layer, Stage
from spatial_pin.workspace_map.workspace_result import Workspace

WORKSPACE_BALL = 0.008  # radius relative to the size of the scene
MOST_BALLS = 6000  # points that are drawn, so that a page stays small
COLOURS: tuple[Colour, ...] = (  # from singular to even
    (0.27, 0.00, 0.33, 1.0), (0.23, 0.32, 0.55, 1.0), (0.13, 0.57, 0.55, 1.0),
    (0.37, 0.79, 0.38, 1.0), (0.99, 0.91, 0.15, 1.0))
END: Colour = (0.84, 0.37, 0.00, 1.0)
CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
FACES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4],
                  [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])


def workspaces(stage: Stage, found: Workspace) -> Layer:
    """Return the points of a workspace in colours, and where the branch ends.

    Raises:
        SpatialPinError: it is that of another mechanism.
    """
    shown_one, own = stage.film.mechanism.name, found.mechanism.name
    if shown_one != own:
        raise SpatialPinError(f"mechanism {shown_one!r}: the workspace is that of another one, "
                              f"{own!r}; ask sp.workspace of this one")
    items, legend = [], []
    shown: list[Array] = [np.zeros((0, 3))]
    for name, points, colour, text in _groups(found):
        seen = stage.seen(points)
        items.append(Item(name, _balls(seen, WORKSPACE_BALL * stage.size), colour))
        legend.append(Entry(colour, text))
        shown.append(seen)
    return Layer(tuple(items), np.concatenate(shown), tuple(legend))


def _groups(found: Workspace) -> Iterator[tuple[str, Array, Colour, str]]:
    """Yield name, points, colour and words of what is drawn alike."""
    rows = np.flatnonzero(found.reached & ~np.isnan(found.dexterity))
    rows = rows[:: -(-len(rows) // MOST_BALLS) or 1]
    values = found.dexterity[rows]
    top = float(values.max(initial=0.0)) or 1.0
    level = np.minimum((values / top * len(COLOURS)).astype(int), len(COLOURS) - 1)
    for k, colour in enumerate(COLOURS):
        if (level == k).any():
            low, high = (top * x / len(COLOURS) for x in (k, k + 1))
            yield (f"workspace {k}", found.points[rows[level == k]], colour,
                   f"{found.frame}: dexterity {low:.2g} to {high:.2g}")
    ends = found.boundary.points
    ends = ends[~np.isnan(ends).any(axis=1)]
    ends = ends[:: -(-len(ends) // MOST_BALLS) or 1]
    if len(ends):
        yield "workspace ends", ends, END, f"{found.frame}: the branch ends"


def _balls(points: Array, radius: float) -> Solid:
    """Return octahedra about points (N, 3) as one solid: thousands of balls would be slow."""
    corners = points[:, None] + radius * CORNERS
    faces = FACES + 6 * np.arange(len(points))[:, None, None]
    return Solid(mg.TriangularMeshGeometry(corners.reshape(-1, 3), faces.reshape(-1, 3)),
                 faceted=True)
