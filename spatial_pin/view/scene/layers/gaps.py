"""Open closures: their gaps, sample by sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.equations import Displacement, Square
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.view.scene.film import Readout, unit_of_length
from spatial_pin.view.scene.shapes import ball, rod
from spatial_pin.view.scene.stage import Entry, Item, Layer, Stage, ball_at, rod_between

COLOUR = (1.0, 0.0, 0.62, 1.0)
GAP_BALL, GAP_ROD = 0.02, 0.009  # radius relative to the size of the scene
POINTER = 0.16  # length of the directions that should agree relative to the size of the scene
GAP_DIGITS = 3  # of a gap: its size matters, not its value


class ClosureGap(NamedTuple):
    """How far a closure is open, sample by sample; 0 where it is closed."""

    closure: Closure  # the closure
    lengths: Array  # between the two points that should coincide, shape (N,) [m]
    angles: Array  # between the directions that should agree, shape (N,) [rad]
    offset: Array  # from where point 2 should be to where it is, in the view, shape (N, 3) [m]


def _pair_gap(stage: Stage, closure: Closure, residual: Array) -> ClosureGap:
    """Return the gap between the frames of a closure.

    The offset is the sum of the directions of the length rows, each times its residual. It takes
    frame 2 to the nearest pose in which the closure holds.
    """
    mechanism = stage.film.mechanism
    joint, placement = mechanism.frame_on_joint(closure.frames[0])
    turn = stage.rotations(joint, placement.rotation)
    start, end = stage.origins(closure.frames[:2])
    apart = end - start
    lengths = residual * mechanism.characteristic_length
    offset, angular = np.zeros_like(apart), np.zeros(len(apart))
    for row, off in zip(closure.rows, lengths.T, strict=True):
        _, (first, *_) = row.terms[0]
        if isinstance(first, Square):  # along the line between the frames
            far, length = np.linalg.norm(apart, axis=1), closure.geometry.length
            if closure.between:  # the length is that between other frames
                length = np.linalg.norm(np.subtract(*stage.origins(closure.between)), axis=1)
            wrong = np.where(off != 0.0, far - length, 0.0)
            offset += apart * (wrong / np.where(far > 0, far, 1.0))[:, None]
        elif isinstance(first, Displacement):
            offset += off[:, None] * (turn @ first.u)
        else:
            angular = np.hypot(angular, off / mechanism.characteristic_length)
    angles = np.arcsin(np.minimum(angular, 1.0))
    return ClosureGap(closure, np.linalg.norm(offset, axis=1), angles, offset)


def gaps_of(stage: Stage) -> list[ClosureGap]:
    """Return the closures that are open in any sample."""
    mechanism, film = stage.film.mechanism, stage.film
    evaluation = LoopEquations(mechanism)
    residuals = np.zeros((len(film.rows), len(evaluation.residual)))  # 0 where all are closed
    for k in film.open_rows:
        if film.motion.angles.size:
            evaluation.angle_reference[:] = film.motion.angles[k]
        evaluation.update(film.motion.q[k])
        residuals[k] = evaluation.residual
    residuals[np.abs(residuals) <= TOLERANCES.half_precision] = 0.0
    closure_of = np.array(constraints_of(mechanism).closure_of)
    gaps = []
    for closure in mechanism.closures:
        own = residuals[:, closure_of == closure.name]
        if np.any(own):
            if closure.frames:
                gaps.append(_pair_gap(stage, closure, own))
                continue
            error, none = np.abs(own[:, 0]), np.zeros((len(own), 3))  # of the last coordinate
            is_angle = mechanism.coordinate(closure.joints[-1]).unit == "rad"
            lengths = 0 * error if is_angle else error * mechanism.characteristic_length
            gaps.append(ClosureGap(closure, lengths, error if is_angle else 0 * error, none))
    return gaps


def _length_items(stage: Stage, gap: ClosureGap) -> tuple[list[Item], Array]:
    """Return two balls and a rod from where a frame should be to where it is; and both places."""
    (there,) = stage.origins(gap.closure.frames[1:2])
    here = there - gap.offset
    is_open = (gap.lengths > 0).astype(float)
    name, size = f"gap {gap.closure.name}", stage.size
    marker = ball(GAP_BALL * size)
    items = [
        Item(name, rod(GAP_ROD * size), COLOUR, track=rod_between(here, there), through=True),
        Item(f"{name} from", marker, COLOUR, track=ball_at(here, is_open), through=True),
        Item(f"{name} to", marker, COLOUR, track=ball_at(there, is_open), through=True),
    ]
    return items, np.concatenate([here, there])


def _angle_items(stage: Stage, gap: ClosureGap) -> tuple[list[Item], Array]:
    """Return the direction of each frame that is off the most, as rods from the second frame."""
    mechanism, geometry = stage.film.mechanism, gap.closure.geometry
    (i1, m1), (i2, m2) = (mechanism.frame_on_joint(name) for name in gap.closure.frames[:2])
    axes1 = stage.rotations(i1, m1.rotation @ geometry.axes1)
    axes2 = stage.rotations(i2, m2.rotation @ geometry.axes2)
    cosines = np.sum(axes1 * axes2, axis=1)  # (N, 3), of x, y and z
    all_agree = gap.closure.pair.aligned == "xyz"
    k = int(np.argmin(cosines.min(axis=0))) if all_agree else 2
    start: Array = stage.points(i2, m2.translation)
    is_open = (gap.angles > 0)[:, None] * POINTER * stage.size
    items, points = [], [start]
    for side, e in (("first", axes1[:, :, k]), ("second", axes2[:, :, k])):
        end = start + is_open * e
        track = rod_between(start, end)
        name = f"turned {gap.closure.name} {side}"
        items.append(Item(name, rod(GAP_ROD * stage.size), COLOUR, track=track, through=True))
        points.append(end)
    return items, np.concatenate(points)


def gaps(stage: Stage) -> Layer:
    """Return a marker and an alarm of every closure that is open in any sample.

    Costs nothing where all are closed.
    """
    if not len(stage.film.open_rows):
        return Layer()
    items: list[Item] = []
    alarms: list[Readout] = []
    points: list[Array] = [np.zeros((0, 3))]
    for gap in gaps_of(stage):
        name, measures = f"closure {gap.closure.name}", []
        if np.any(gap.lengths):
            size, unit = unit_of_length(float(gap.lengths.max()))
            measures.append((gap.lengths / size, f" {unit}"))
        if np.any(gap.angles):
            measures.append((np.rad2deg(gap.angles), "°"))
        for values, unit in measures:
            digits = GAP_DIGITS - 1 - np.floor(np.log10(float(values.max())))
            alarms.append(Readout(name, values, unit, int(np.clip(digits, 0, 8)), " open by "))
        kinds = ((gap.offset, _length_items), (gap.angles, _angle_items))
        for measure, make in kinds if gap.closure.frames else ():
            if np.any(measure):
                made, held = make(stage, gap)
                items += made
                points.append(held)
    legend = (Entry(COLOUR, "open closures"),)
    return Layer(tuple(items), np.concatenate(points), legend, tuple(alarms))
