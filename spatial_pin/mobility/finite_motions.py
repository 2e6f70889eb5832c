"""Trial motions: whether a mechanism moves by a finite amount, or to first order only."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.numerics.linalg import Array, decompose, null_space
from spatial_pin.numerics.tolerances import TOLERANCES

# lengths of finite trial motions [rad, characteristic lengths], the shorter where links turn back;
# still shorter ones would take a linkage that is shaky to third order for one that moves
PROBES = (0.05, 0.005)
# trial motions for each instantaneous freedom: where half of all directions lead back, all six do
# in one of 64 cases, and then the shorter ones are tried
TRIALS = 6


def finite_freedom(evaluation: Evaluation, q: Array, tangents: Array) -> int:
    """Return the largest dimension of the closed configurations near q, by trial motions.

    A trial moves along a random tangent and closes the loops again. Where that leaves a real
    displacement, the point found is a generic one, and the nullity there is the dimension; where
    every trial falls back to q, the freedoms are instantaneous only. (Where no equation is
    redundant, there is nothing to try: the nullity at q is the dimension.)
    """
    rng = np.random.default_rng(1)
    for probe in PROBES:
        best = _trial_motions(evaluation, q, tangents, probe, rng)
        if best:
            return best
    return 0


def finite_motions(
    evaluation: Evaluation, q: Array, tangents: Array, free: NDArray[np.bool_] | None = None,
    probe: float = PROBES[1],
) -> Array:
    """Return orthonormal scaled velocities (d, nv) that span what is left of trial motions.

    The number of `tangents` is only a bound on d: a part that is shaky in every configuration adds
    to it.

    Args:
        evaluation: the closure equations; left anywhere.
        q: (nq,) closed configuration.
        tangents: (k, nv) scaled velocities that open no loop at q.
        free: (nv,) which velocities may close the loops again; default all.
        probe: length of a trial motion.
    """
    scale = evaluation.mechanism.velocity_scale
    free = np.ones(len(scale), dtype=bool) if free is None else free
    left = [np.zeros(len(scale))]
    for tangent in tangents:
        start = pin.integrate(evaluation.model, q, scale * probe * tangent)
        found, error = close(evaluation, start, free, TOLERANCES.round_off)
        if error <= TOLERANCES.closed:
            left.append(pin.difference(evaluation.model, q, found) / (scale * probe))
    svd = decompose(np.array(left))
    return svd.vt[: np.count_nonzero(svd.s > TOLERANCES.moved)]


def _trial_motions(
    evaluation: Evaluation, q: Array, tangents: Array, probe: float, rng: np.random.Generator
) -> int:
    """Return the largest dimension of the closed configurations that trial motions come to."""
    scale = evaluation.mechanism.velocity_scale
    free = np.ones(len(scale), dtype=bool)
    n = evaluation.constraints.n_closure
    best = 0
    for _ in range(TRIALS * len(tangents)):
        direction = rng.normal(size=len(tangents)) @ tangents
        step = probe * direction / np.linalg.norm(direction)
        start = pin.integrate(evaluation.model, q, scale * step)
        found, error = close(evaluation, start, free, TOLERANCES.round_off)
        moved = pin.difference(evaluation.model, q, found) / scale
        if error > TOLERANCES.closed or np.linalg.norm(moved) < TOLERANCES.moved * probe:
            continue
        there = null_space(evaluation.jacobian[:n], TOLERANCES.half_precision)
        small = probe * PROBES[1] / PROBES[0]
        best = max(best, len(finite_motions(evaluation, found, there, probe=small)))
        if best == len(tangents):
            break
    return best
