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

# Lengths in radians and characteristic lengths. How far a way out of q is followed: what opens
# loops by the eighth power only, and by a thousandth of it, opens them by 7e-8 there.
WAY_OUT = 0.3
# Its first step: where links turn back, a longer one leads past all closed configurations, and
# near where branches cross they are as straight as this is short.
SETTING_OUT = 0.005
# Of a way in such steps, from which its direction is read: bends are slight so far.
STRAIGHT_SO_FAR = 0.1
STEP_GROWTH = 4.0  # of steps: four from the first reach out
# The shortest step: a four-bar with a play of 1e-6 of its size goes round an oval of 2e-3.
SHORTEST_STEP = 2e-5
AFTER_A_BEND = 1.5  # growth of steps once one has failed
# Part of a short step that may lead aside: where loops open by a high power, closing takes off what
# opens them, however short the step is.
MOST_ASIDE = 0.1
# A way that comes round within this length is an oval only if it closes to the last digits: loops
# that open by a high power stay closed to some digits round q, and a way may turn at their border.
SMALL_OVAL = 0.05
# Closure error all the way: ten times `closed`, for Bennett's loop with a wrong ninth digit opens
# by 5e-11, and sweeps follow it; hinges of robots, parallel to ten digits, open loops by 2e-11.
STAYS_CLOSED = 10.0 * TOLERANCES.closed
BEND = 0.5  # cosine between a way and its first step: up to it bends leave most of their direction
MOST_PARTS = 100  # where links turn back again and again
# Random directions for each instantaneous freedom, each tried both ways: a cusp leads to one side
DIRECTIONS = 6
MOST_SLIDES = 20  # at most: each leaves a third of the residual, all of them 3e-10
# Part of a residual that is left by Newton's step towards a root of any order k: (1 - 1/k)^k < 1/e
SLID = 0.5


def finite_freedom(evaluation: LoopEquations, q: Array, tangents: Array) -> int:
    """Return the largest dimension of the closed configurations near q.

    Where a way leads out of q along a random tangent, its end is a generic configuration, and what
    moves there is counted, in one step where it can be; where no way does, the freedoms are
    instantaneous only. (Where no equation is redundant, there is nothing to try: the nullity at q
    is the dimension.)
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
            evaluation, path[1], there, steps=(WAY_OUT, SETTING_OUT))))
        if best == len(tangents):
            break
    return best


def finite_motions(
    evaluation: LoopEquations, q: Array, tangents: Array, free: NDArray[np.bool_] | None = None,
    steps: tuple[float, ...] = (SETTING_OUT,),
) -> Array:
    """Return orthonormal scaled velocities (d, nv) that span the ways out of q along tangents.

    The number of `tangents` is only a bound on d: a part that is shaky in every configuration adds
    to it.

    Args:
        evaluation: the closure equations; left anywhere.
        q: (nq,) closed configuration.
        tangents: (k, nv) orthonormal scaled velocities that open no loop at q.
        free: (nv,) which velocities may close the loops again; default all.
        steps: the first of a way, one after the other until one leads out.
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
    """Return the way out of q along a tangent or against it; None where neither leads out."""
    return (_followed(evaluation, q, tangent, free, step)
            or _followed(evaluation, q, -tangent, free, step))


def _followed(
    evaluation: LoopEquations, q: Array, direction: Array, free: NDArray[np.bool_], step: float
) -> tuple[Array, Array] | None:
    """Follow closed configurations from q; None where they end.

    Returned are the direction (nv,) of the first part, up to a bend, a scaled velocity of length 1,
    and the configuration (nq,) where they are left.

    Loops that open by a high power of the distance stay closed to round-off over short steps, so
    these grow until the way is long, or has come round a bend.
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
        if length >= WAY_OUT or is_round:
            return chord / np.linalg.norm(chord), at
    return None


def _tangent(evaluation: LoopEquations, q: Array, direction: Array) -> Array:
    """Return the part of a direction that opens no loop at q (nq,), or all of it if there is none.

    Where a way bends sharply the last step says little of the next one.
    """
    evaluation.update(q)
    tangents = null_space(evaluation.jacobian[: evaluation.constraints.n_closure],
                          TOLERANCES.half_precision)
    along = tangents.T @ (tangents @ direction)
    size = float(np.linalg.norm(along))
    return along / size if size > TOLERANCES.half_precision else direction


def _closed(evaluation: LoopEquations, q: Array, free: NDArray[np.bool_]) -> tuple[Array, float]:
    """Close the loops from q, also along the valleys of what opens them by a high power only.

    There Newton's method takes a part of the way back each time; what other equations say is
    restored after each step. The evaluation is left anywhere.
    """
    mechanism, reference = evaluation.mechanism, evaluation.angle_reference
    result, error, _ = closed(mechanism, q, free, reference, TOLERANCES.round_off)
    n, scale = evaluation.constraints.n_closure, mechanism.velocity_scale
    for _ in range(MOST_SLIDES):
        if error <= STAYS_CLOSED:
            break
        evaluation.update(result)
        svd = decompose(evaluation.jacobian[:n, free])
        weak = np.flatnonzero(svd.s[: svd.rank] < TOLERANCES.well_conditioned * svd.s[0])
        back = np.zeros(len(scale))
        back[free] = -svd.vt[weak].T @ (svd.u[:, weak].T @ evaluation.residual / svd.s[weak])
        if not 0.0 < np.linalg.norm(back) < WAY_OUT:
            break
        slid, remaining, _ = closed(
            mechanism, pin.integrate(evaluation.model, result, scale * back), free, reference,
            TOLERANCES.round_off, cut=TOLERANCES.well_conditioned)
        if remaining > SLID * error:
            break
        result, error = slid, remaining
    return result, error
