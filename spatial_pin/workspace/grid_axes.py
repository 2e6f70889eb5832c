"""Coordinates of a grid: drivers, or parts of a frame's pose.

For poses the grid is followed on a copy of the mechanism, in which slides and hinges move the
frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from spatial_pin._support.checks import finite_array, mapping, whole_number
from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import Hold, held_by
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.target_coordinates import (
    ALL,
    Chain,
    TargetTable,
    copy_at,
)
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose, rank
from spatial_pin.numerics.tolerances import TOLERANCES

SLIDES, TURNS = ("x", "y", "z"), ("turn_x", "turn_y", "turn_z")
PARTS = (*SLIDES, *TURNS)  # of a pose: of the origin [m], and Cardan angles from the start [rad]


def pose_parts(mechanism: Mechanism, frame: str, names: Iterable[str]) -> tuple[str, ...] | None:
    """Return names as parts of a frame's pose; None for drivers or coordinates."""
    names = list(names)
    parts = [name.removeprefix(f"{frame}.") for name in names]
    known = {*mechanism.coordinate_table, *mechanism.drivers}
    is_part = [part in PARTS and name not in known
               for name, part in zip(names, parts, strict=True)]
    if not any(is_part):
        return None
    if not all(is_part):
        raise ValueError(f"ranges are of drivers or of the pose of {frame!r} ({', '.join(PARTS)}), "
                         f"not of both: {', '.join(map(repr, names))}")
    if len(set(parts)) < len(parts):
        raise ValueError(f"ranges name a part of the pose twice: {', '.join(map(repr, names))}")
    return tuple(parts)


def posed(
    start: State, frame: str, parts: Sequence[str], task: str | None, hold: Hold
) -> tuple[State, dict[str, str], tuple[str, ...], str]:
    """Return a copy of the mechanism with the pose of a frame as coordinates.

    Returns:
        A state of the copy, absolute positions [m], angles zero; its names of the parts of the
        pose; fixed parts outside the grid; the task.

    Args:
        start: closed state.
        frame: link, frame or joint.
        parts: parts of its pose that span the grid.
        task: "position": its orientation is free; "pose": it is fixed, as far as it can change.
            None: position, if that determines the mechanism.
        hold: names of other fixed coordinates.
    """
    if task is None:
        mechanism = start.mechanism
        with loops_of(mechanism, start.angles) as evaluation:
            motions = tangent(evaluation, start.q, hold)
            rows = evaluation.frame_jacobian(mechanism.frame_id(mechanism.placed(frame)))[:3]
            moved = rows * mechanism.velocity_scale / mechanism.characteristic_length @ motions.T
        is_placed = not set(parts) & set(TURNS) and (
            rank(moved, TOLERANCES.half_precision) == len(motions))
        task = "position" if is_placed else "pose"
    if task == "position" and set(parts) & set(TURNS):
        raise ValueError("task is 'position', whose orientation is free, but ranges have angles")
    at = start.placement(frame)
    is_turned = task == "pose"
    table = TargetTable(frame, np.zeros((1, 3)), at.rotation[None] if is_turned else None)
    chain = Chain(table, ALL, np.zeros((3, 1, 3)), 3 * is_turned)
    state, names = copy_at(start, [chain], 0, np.append(at.translation, np.zeros(chain.hinges)))
    coordinates = dict(zip(PARTS, names, strict=False))
    return state, coordinates, _standing(state, frame, coordinates, parts, hold), task


def tangent(evaluation: LoopEquations, q: Array, hold: Hold) -> Array:
    """Return orthonormal rows (m, nv) of scaled velocities that loops and `hold` allow."""
    evaluation.update(q)
    held = held_by(evaluation.mechanism, hold)
    moves = np.ones(evaluation.model.nv, dtype=bool)
    moves[list(held.entries)] = False
    rows = [scaled_row(evaluation.mechanism, c, q) for c in held.coordinates]
    basis = decompose(np.vstack([evaluation.jacobian, *rows])[:, moves]).null_space
    motions = np.zeros((len(basis), len(moves)))
    motions[:, moves] = basis
    return motions


def _standing(
    state: State, frame: str, coordinates: dict[str, str], parts: Sequence[str], hold: Hold
) -> tuple[str, ...]:
    """Return the fixed parts, in their order: those that could change."""
    mechanism = state.mechanism
    with loops_of(mechanism, state.angles) as evaluation:
        motions = tangent(evaluation, state.q, hold)
    taken: list[str] = []
    for part in (*parts, *(p for p in coordinates if p not in parts)):
        rows = [mechanism.coordinate_table[coordinates[p]].v for p in (*taken, part)]
        if rank(motions[:, rows], TOLERANCES.half_precision) == len(rows):
            taken.append(part)
        elif part in parts:
            raise ValueError(
                f"{part} of {frame!r} cannot change for itself where the mechanism starts"
                f"{', with ' + ' and '.join(taken) if taken else ''}: leave it out")
    if len(taken) < len(motions):
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the pose of {frame!r} leaves "
            f"{len(motions) - len(taken)} of {len(motions)} freedoms open: ask for task='pose', "
            "or for a grid of drivers")
    return tuple(taken[len(parts):])


MOST_GRID_POINTS = 200_000  # each stores a configuration and a Jacobian, about 200 MB in all
USUAL_POINTS, FINEST_GRID = 10_000, 41  # default number of points of a grid, and of one coordinate


def read_ranges(
    mechanism: Mechanism, frame: str, ranges: Mapping[str, Any],
    points: int | Mapping[str, int] | None,
) -> tuple[tuple[str, ...], list[Array], bool]:
    """Return names of coordinates, the values of each, and whether they are parts of a pose."""
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
