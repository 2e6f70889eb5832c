"""What a grid is spanned by: ranges of drivers, or of parts of a frame's pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatial_pin._support.checks import finite_array, mapping, whole_number
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.workspace_map.poses import pose_parts

# points of a grid: each keeps a configuration and a Jacobian, some 200 MB in all
MOST_GRID_POINTS = 200_000
# points of a grid where none are asked for, and of one coordinate
USUAL_POINTS, FINEST_GRID = 10_000, 41


def read_ranges(
    mechanism: Mechanism, frame: str, ranges: Mapping[str, Any],
    points: int | Mapping[str, int] | None,
) -> tuple[tuple[str, ...], list[Array], bool]:
    """Return names of coordinates, the values of each, and whether they are parts of a pose.

    Raises:
        UnknownNameError: there is no such driver or coordinate.
        ValueError: as `workspace` says.
    """
    given = mapping(ranges, "ranges")
    parts = pose_parts(mechanism, frame, given)
    spans: dict[str, tuple[str, float, float]] = {}
    for k, (name, span) in enumerate(given.items()):
        coordinate = parts[k] if parts else mechanism.prescribed_coordinate(name).name
        if coordinate in spans:
            raise ValueError(f"{coordinate!r} is given two ranges")
        low, high = finite_array(span, (2,), f"range of {name!r}").tolist()
        if not low < high:
            raise ValueError(f"range of {name!r} is {low:.9g} to {high:.9g}: the first is to be "
                             "the smaller one")
        spans[coordinate] = name, low, high
    if not spans:
        raise ValueError("ranges is empty: give (least, largest) for every driver that moves")
    counts = _counts([name for name, *_ in spans.values()], points)
    total = int(np.prod([float(n) for n in counts]))
    if total > MOST_GRID_POINTS:
        raise ValueError(f"the grid has {' x '.join(map(str, counts))} = {total} points; "
                         f"{MOST_GRID_POINTS} at most: give fewer `points`")
    ticks: list[Array] = [np.linspace(low, high, n)
             for (_, low, high), n in zip(spans.values(), counts, strict=True)]
    return parts or tuple(name for name, *_ in spans.values()), ticks, parts is not None


def _counts(names: list[str], points: int | Mapping[str, int] | None) -> list[int]:
    if points is None:
        return [min(FINEST_GRID, int(USUAL_POINTS ** (1.0 / len(names)) + 1e-9))] * len(names)
    if isinstance(points, Mapping):
        if set(points) != set(names):
            raise ValueError(f"points are given of {', '.join(map(repr, points)) or 'nothing'}; "
                             f"they are wanted of {', '.join(map(repr, names))}")
        counts = [whole_number(points[name], f"points of {name!r}") for name in names]
    else:
        counts = [whole_number(points, "points")] * len(names)
    if min(counts) < 2:
        raise ValueError(f"points is {min(counts)}; a range needs 2 at least")
    return counts
