"""What tells assembly modes apart: where the links stand, as far as the mechanism knows it.

Of a rod that is its line; of a link with a passive freedom, what the freedom leaves at rest; of
any other link its whole placement. All of it is linear in the joint placements.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.passive_freedoms import moved_bodies
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mobility.idle_freedoms import IDLE
from spatial_pin.mobility.modes.rods import Line
from spatial_pin.numerics.linalg import Array, row_space


class Mark(NamedTuple):
    """What of a body counts: points (k, 3) [m] and directions (l, 3), in its joint's axes."""

    points: Array
    directions: Array


WHOLE = Mark(np.zeros((1, 3)), np.eye(3))
NOTHING = Mark(np.zeros((0, 3)), np.zeros((0, 3)))


def of_line(line: Line) -> Mark:
    """Return the mark of a rod's body."""
    return Mark(line.point[None], line.direction[None])


def rows_of(marks: Mapping[int, Mark], n_joints: int, length: float) -> Array:
    """Return coefficients (rows, 4 n_joints) of marks on joint placements, lengths divided."""
    rows = []
    for body, mark in marks.items():
        for vectors, flag, unit in ((mark.points, 1.0, length), (mark.directions, 0.0, 1.0)):
            for x in vectors:
                row = np.zeros((n_joints, 4))
                row[body] = np.array([*x, flag]) / unit
                rows.append(row.reshape(-1))
    return np.array(rows).reshape(len(rows), 4 * n_joints)


# ---------------------------------------------------------------- passive freedoms


def resting(evaluation: Evaluation, idle: list[tuple[str, Array]]) -> dict[int, Mark]:
    """Return what passive freedoms leave at rest of the bodies that they move."""
    mechanism, marks = evaluation.mechanism, {}
    for _, velocities in idle:
        for body in moved_bodies(evaluation, velocities):
            points = _points(mechanism, body)
            speeds = _speeds(evaluation, body, points, velocities)
            speeds = np.abs(speeds.reshape(len(velocities), len(points), 3)).max(axis=(0, 2))
            fastest = _fastest(evaluation, body, velocities)
            kept = points[speeds <= IDLE * fastest]
            marks[body] = Mark(kept, _steady(evaluation, body, velocities, fastest))
    return marks


def _twists(evaluation: Evaluation, body: int, velocities: Array) -> Array:
    """Return (k, 6) twists of a body about the world origin for joint velocities (k, nv)."""
    columns = joint_jacobian(evaluation.data, evaluation.model.nv)
    return velocities @ (columns * evaluation.constraints.support(body)).T


def _speeds(evaluation: Evaluation, body: int, points: Array, velocities: Array) -> Array:
    """Return (k, 3 points) velocities of points of a body [characteristic lengths]."""
    placement = evaluation.data.oMi[body]
    places = points @ placement.rotation.T + placement.translation
    twists = _twists(evaluation, body, velocities)
    speeds = twists[:, None, :3] + np.cross(twists[:, None, 3:], places[None])
    return speeds.reshape(len(velocities), -1) * evaluation.constraints.scale


def _fastest(evaluation: Evaluation, body: int, velocities: Array) -> float:
    twists = _twists(evaluation, body, velocities)
    slide = _speeds(evaluation, body, np.zeros((1, 3)), velocities)
    return float(max(np.abs(twists[:, 3:]).max(), np.abs(slide).max()))


def _steady(evaluation: Evaluation, body: int, velocities: Array, fastest: float) -> Array:
    """Return the directions (l, 3) in a body that its passive freedoms leave as they are."""
    spins = _twists(evaluation, body, velocities)[:, 3:]
    axes = row_space(spins[np.abs(spins).max(axis=1) > IDLE * fastest], IDLE)
    if not len(axes):
        return np.eye(3)
    rotation = evaluation.data.oMi[body].rotation
    return axes @ rotation if len(axes) == 1 else np.empty((0, 3))


def _points(mechanism: Mechanism, body: int) -> Array:
    """Return the centres (k, 3) of a body's pairs."""
    model = mechanism.centred_model
    points = [np.zeros(3)]
    points += [model.jointPlacements[i].translation for i in range(1, model.njoints)
               if model.parents[i] == body]
    for closure in mechanism.closures:
        placed = map(mechanism.centred_frame, (*closure.frames, *closure.between))
        points += [M.translation for joint, M in placed if joint == body]
    return np.array(points)
