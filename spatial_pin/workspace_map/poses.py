"""Poses of a frame as coordinates of a grid: a copy of the mechanism in which slides carry it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import Hold, held_by
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, evaluation_of
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics.target_coordinates import ALL, Chain, Stretch, copy_at
from spatial_pin.inverse_kinematics.target_tables import Course, Table
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose, rank
from spatial_pin.numerics.tolerances import TOLERANCES

SLIDES, TURNS = ("x", "y", "z"), ("turn_x", "turn_y", "turn_z")
PARTS = (*SLIDES, *TURNS)  # of a pose: of the origin [m], and Cardan angles from the start [rad]


class Posed(NamedTuple):
    """A mechanism in which the pose of a frame is given by coordinates.

    Attributes:
        state: of the copy: absolute positions [m], angles zero.
        coordinates: by part of the pose, the copy's name for it.
        standing: parts that stand still besides those of the grid.
        task: "position" or "pose".
    """

    state: State
    coordinates: dict[str, str]
    standing: tuple[str, ...]
    task: str


def pose_parts(mechanism: Mechanism, frame: str, names: Iterable[str]) -> tuple[str, ...] | None:
    """Return what parts of a frame's pose names are; None where they are drivers or coordinates.

    Raises:
        ValueError: some are the one, some the other, or one is named twice.
    """
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
) -> Posed:
    """Return the copy of a mechanism in which the pose of a frame is given by coordinates.

    Args:
        start: closed.
        frame: link, frame or joint.
        parts: of its pose that span a grid.
        task: "position": its orientation is free; "pose": it is kept, as far as it is free to
            change. None: position, if that determines the mechanism.
        hold: what stands still in any case.

    Raises:
        SpatialPinError: the pose does not determine where the mechanism is.
        ValueError: the parts cannot change each for itself, or turn while only the position is
            asked for.
    """
    if task is None:
        is_placed = not set(parts) & set(TURNS) and _is_placed(start, frame, hold)
        task = "position" if is_placed else "pose"
    if task == "position" and set(parts) & set(TURNS):
        raise ValueError("task is 'position', whose orientation is free, but ranges have angles")
    at = start.placement(frame)
    is_turned = task == "pose"
    table = Table(frame, np.zeros((1, 3)), at.rotation[None] if is_turned else None)
    n = 3 + 3 * is_turned
    values = np.zeros((1, n))
    values[0, :3] = at.translation
    course = Course(values, 0.0 * values, 0.0 * values)
    state, names = copy_at(start, [Chain(table, ALL, course, n - 3)], Stretch(0, 0, course))
    coordinates = dict(zip(PARTS, names, strict=False))
    return Posed(state, coordinates, _standing(state, frame, coordinates, parts, hold), task)


def tangent(evaluation: Evaluation, q: Array, hold: Hold) -> Array:
    """Return orthonormal rows (m, nv) of scaled velocities that loops and what is held allow."""
    evaluation.update(q)
    held = held_by(evaluation.mechanism, hold)
    moves = np.ones(evaluation.model.nv, dtype=bool)
    moves[list(held.entries)] = False
    rows = [scaled_row(evaluation.mechanism, c, q) for c in held.coordinates]
    basis = decompose(np.vstack([evaluation.jacobian, *rows])[:, moves]).null_space
    found = np.zeros((len(basis), len(moves)))
    found[:, moves] = basis
    return found


def _is_placed(start: State, frame: str, hold: Hold) -> bool:
    """Whether the position of a frame determines where a mechanism is, near a state."""
    mechanism = start.mechanism
    with evaluation_of(mechanism, start.angles) as evaluation:
        motions = tangent(evaluation, start.q, hold)
        rows = evaluation.frame_jacobian(mechanism.frame_id(mechanism.placed(frame)))[:3]
        moved = rows * mechanism.velocity_scale / mechanism.characteristic_length @ motions.T
    return rank(moved, TOLERANCES.half_precision) == len(motions)


def _standing(
    state: State, frame: str, coordinates: dict[str, str], parts: Sequence[str], hold: Hold
) -> tuple[str, ...]:
    """Return the parts that stand still: in their order, those that are free to change."""
    mechanism = state.mechanism
    with evaluation_of(mechanism, state.angles) as evaluation:
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
