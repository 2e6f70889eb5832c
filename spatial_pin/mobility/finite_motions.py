"""Whether a mechanism moves by a finite amount, or to some order only: ways out of q.

What shakes without moving opens its loops by some power of the distance, the second as a rule, the
fourth or the eighth where dead centres come together. Near q that is round-off. So closed
configurations count as a motion only if they lead far enough out for such powers to be seen.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import closed
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.numerics.linalg import Array, decompose, null_space
from spatial_pin.numerics.tolerances import TOLERANCES

# Length of a followed path [rad, characteristic lengths]: loops that open by the eighth power only,
# times a thousandth, are then open by 7e-8.
PATH_LENGTH = 0.3
# First step: near turning links a longer one misses all closed configurations, and near branch
# points the error of the direction is as small as the step.
SETTING_OUT = 0.005
STRAIGHT_SO_FAR = 0.1  # length from which the direction of a path is taken: bends are small so far
STEP_GROWTH = 4.0  # factor of the steps: four steps from the first reach the end
SHORTEST_STEP = 5e-7  # a four-bar with a play of 1e-8 of its size moves on an oval of 1e-4
AFTER_A_BEND = 1.5  # factor of the steps after a failed one
# Part of a short step that closing may correct: where loops open by a high power, it removes their
# motion, however short the step.
MOST_ASIDE = 0.1
# A path that returns within this length is an oval only if it closes to the last digits: loops that
# open by a high power stay closed to some digits near q, and a path may turn at that border.
SMALL_OVAL = 0.05
# Closure error along a path, ten times `closed`: Bennett's loop with a wrong ninth digit opens by
# 5e-11, and sweeps follow it; robots with hinges parallel to ten digits open by 2e-11.
STAYS_CLOSED = 10.0 * TOLERANCES.closed
BEND = 0.5  # least cosine between a path and its first step
MOST_PARTS = 200  # for links that turn again and again
# random directions for each instantaneous freedom, each in both senses: a cusp has one side
DIRECTIONS = 6
MOST_SLIDES = 20  # each leaves a third of the residual, all of them 3e-10
SLID = 0.5  # residual after Newton's step towards a root of order k: (1 - 1/k)^k < 1/e


def finite_freedom(evaluation: LoopEquations, q: Array, tangents: Array) -> int:
    """Return the largest dimension of the closed configurations near q.

    If a path leads from q along a random tangent, its end is a generic configuration, whose finite
    motions are counted, in one step if possible. Without a path the freedoms are instantaneous
    only. (Without redundant equations the nullity at q is the dimension.)
    """
    rng = np.random.default_rng(1)
    free = np.ones(len(evaluation.mechanism.velocity_scale), dtype=bool)
    n, best = evaluation.constraints.n_closure, 0
    for _ in range(DIRECTIONS * len(tangents)):
        direction = rng.normal(size=len(tangents)) @ tangents
        path = _path_from(evaluation, q, direction / np.linalg.norm(direction), free, SETTING_OUT)
        if path is None:
            continue
        if len(tangents) == 1:
            return 1
        evaluation.update(path[1])
        there = null_space(evaluation.jacobian[:n], TOLERANCES.half_precision)
        best = max(best, len(finite_motions(
            evaluation, path[1], there, steps=(PATH_LENGTH, SETTING_OUT))))
        if best == len(tangents):
            break
    return best


def finite_motions(
    evaluation: LoopEquations, q: Array, tangents: Array, free: NDArray[np.bool_] | None = None,
    steps: tuple[float, ...] = (SETTING_OUT,),
) -> Array:
    """Return orthonormal scaled velocities (d, nv) of the finite motions from q along tangents.

    The number of `tangents` is only a bound of d: a part that is shaky in every configuration adds
    to it. `tangents` (k, nv) are orthonormal, scaled, and open no loop at q; the velocities `free`
    (nv,) close the loops again, default all. First steps of a path are tried in the order of
    `steps`. The evaluation changes.
    """
    free = np.ones(len(evaluation.mechanism.velocity_scale), dtype=bool) if free is None else free
    motions: list[Array] = [np.zeros(len(free))]
    flat: list[Array] = [np.zeros(len(tangents))]
    for tangent in tangents:
        for step in steps:
            path = _path_from(evaluation, q, tangent, free, step)
            along = np.zeros(0) if path is None else tangents @ path[0]
            size = float(np.linalg.norm(along))
            if path is not None and size > TOLERANCES.moved:
                motions.append(path[0])
                flat.append(along / size)  # bends are no motions of their own
                break
    count = np.count_nonzero(decompose(np.array(flat)).s > TOLERANCES.moved)
    return decompose(np.array(motions)).vt[:count]


def _path_from(
    evaluation: LoopEquations, q: Array, tangent: Array, free: NDArray[np.bool_], step: float
) -> tuple[Array, Array] | None:
    """Return the path from q along a tangent or against it; None if there is none."""
    return (_followed(evaluation, q, tangent, free, step)
            or _followed(evaluation, q, -tangent, free, step))


def _followed(
    evaluation: LoopEquations, q: Array, direction: Array, free: NDArray[np.bool_], step: float
) -> tuple[Array, Array] | None:
    """Follow closed configurations from q; None if they end.

    Returned are the direction (nv,) of the first part, up to a bend, a scaled velocity of length 1,
    and the last configuration (nq,).

    Loops that open by a high power of the distance stay closed to round-off over short steps, so
    steps grow until the path is long, or has come round a bend.
    """
    model, scale = evaluation.model, evaluation.mechanism.velocity_scale
    at, length, growth, worst = q, 0.0, STEP_GROWTH, 0.0
    least = step / STEP_GROWTH if step > SETTING_OUT else SHORTEST_STEP
    first = chord = direction
    for _ in range(MOST_PARTS):
        start = pin.integrate(model, at, scale * step * direction)
        closed_q, error = _closed(evaluation, start, free)
        moved = pin.difference(model, at, closed_q) / scale
        size = float(np.linalg.norm(moved))
        ahead = float(moved @ direction) if length else size  # branches may leave q at any angle
        aside = np.linalg.norm(pin.difference(model, start, closed_q) / scale)
        is_short = step < SETTING_OUT / STEP_GROWTH
        if error > STAYS_CLOSED or ahead < TOLERANCES.moved * step or aside > (
                MOST_ASIDE if is_short else 1.0) * step:
            step, growth = step / STEP_GROWTH, AFTER_A_BEND
            if step < least:
                return None
            direction = _tangent(evaluation, at, direction) if length else direction
            continue
        at, direction, worst = closed_q, moved / size, max(worst, error)
        if not length:
            first = direction
        there = pin.difference(model, q, at) / scale
        if length < STRAIGHT_SO_FAR and there @ first > BEND * np.linalg.norm(there):
            chord = there
        length, step = length + size, step * growth
        is_round = direction @ first < 0.0 and (length > SMALL_OVAL or worst < TOLERANCES.tight)
        if length >= PATH_LENGTH or is_round:
            return chord / np.linalg.norm(chord), at
    return None


def _tangent(evaluation: LoopEquations, q: Array, direction: Array) -> Array:
    """Return the part of a direction that opens no loop at q (nq,), or all of it if there is none.

    At a sharp bend the last step is a bad prediction of the next one.
    """
    evaluation.update(q)
    tangents = null_space(evaluation.jacobian[: evaluation.constraints.n_closure],
                          TOLERANCES.half_precision)
    along = tangents.T @ (tangents @ direction)
    size = float(np.linalg.norm(along))
    return along / size if size > TOLERANCES.half_precision else direction


def _closed(evaluation: LoopEquations, q: Array, free: NDArray[np.bool_]) -> tuple[Array, float]:
    """Close the loops from q, also along valleys of residuals of high order.

    There Newton's method reduces the residual by a constant factor each time; other equations are
    restored after each step. The evaluation is changed.
    """
    mechanism, reference = evaluation.mechanism, evaluation.angle_reference
    result = closed(mechanism, q, free, reference, TOLERANCES.round_off)
    n, scale = evaluation.constraints.n_closure, mechanism.velocity_scale
    for _ in range(MOST_SLIDES):
        if result.error <= STAYS_CLOSED:
            break
        evaluation.update(result.q)
        svd = decompose(evaluation.jacobian[:n, free])
        weak = np.flatnonzero(svd.s[: svd.rank] < TOLERANCES.well_conditioned * svd.s[0])
        back = np.zeros(len(scale))
        back[free] = -svd.vt[weak].T @ (svd.u[:, weak].T @ evaluation.residual / svd.s[weak])
        if not 0.0 < np.linalg.norm(back) < PATH_LENGTH:
            break
        slid = closed(mechanism, pin.integrate(evaluation.model, result.q, scale * back), free,
                      reference, TOLERANCES.round_off, cut=TOLERANCES.well_conditioned)
        if slid.error > SLID * result.error:
            break
        result = slid
    return result.q, result.error
