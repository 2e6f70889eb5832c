"""Where loops lose independent equations: how many, and why that leaves a motion undetermined."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.kernel.regular import step_beside
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array, decompose, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES

STEP = TOLERANCES.trial_step
REGULAR_TRIALS = 4  # of which one nearly always closes, as each is short
# Estimated from how equations turn over a trial step, they would become dependent after some way.
# Lost rank is not looked for again within this part of it: they may turn faster farther on, but not
# four times as fast.
SURE_WAY = 0.25
LONGEST_SURE = 0.1  # rad, characteristic lengths, of it at most: ten trial steps


class Regular(NamedTuple):
    """A configuration at which the loops lose no equation, and none near it.

    Attributes:
        q: the configuration (nq,).
        rank: of its closure equations.
        radius: how far off others with that rank are regular too [rad, characteristic lengths]:
            rows turn by so little on the way that those chosen here stay independent.
    """

    q: Array
    rank: int
    radius: float

    def holds(self, mechanism: Mechanism, q: Array, rank: int) -> bool:
        """Whether q (nq,), where the rows have this rank, is so near that it is regular too."""
        if rank != self.rank:
            return False
        away = pin.difference(mechanism.model, self.q, q) / mechanism.velocity_scale
        return bool(np.abs(away).max(initial=0.0) <= self.radius)


def rank_loss(evaluation: LoopEquations, q: Array, rank: int) -> int:
    """Return how many independent equations the loops lose at q, where their rank is `rank`.

    As many independent rows as that leave a surface through q of as many dimensions as there are
    freedoms at q. Where no equation is lost, the loops are closed on all of it; where branches
    cross, or a freedom is instantaneous only, the other rows open on it: with the second power of
    the way, as a rule [ConnellyWhiteley1996], but a step shows any.

    Args:
        evaluation: the closure equations, their turns at q; it comes back to q.
        q: (nq,) closed configuration.
        rank: of the closure equations there.
    """
    n, nv = evaluation.constraints.n_closure, evaluation.model.nv
    if rank in (n, nv):
        return 0
    known: Regular | None = evaluation.regular
    if known is not None and known.holds(evaluation.mechanism, q, rank):
        return 0
    evaluation.update(q)
    jacobian = evaluation.jacobian[:n].copy()
    rows = independent_rows(jacobian)
    svd = decompose(jacobian[rows])
    freedoms = svd.vt[len(rows) :]
    beside = step_beside(evaluation.mechanism, q, evaluation.angle_reference, rows, freedoms)
    if beside is not None and beside.is_closed:
        evaluation.update(beside.q)
        turned = np.linalg.norm(evaluation.jacobian[:n] - jacobian) / STEP
        radius = SURE_WAY * svd.s[-1] / max(turned, EPS) if rank else 0.0
        evaluation.regular = Regular(q.copy(), rank, min(float(radius), LONGEST_SURE))
        evaluation.update(q)
        return 0
    lost = _generic_rank(evaluation, q) - rank
    evaluation.update(q)
    return max(lost, int(beside is not None))


def _generic_rank(evaluation: LoopEquations, q: Array) -> int:
    """Return the closure rank at closed configurations near q."""
    n, model = evaluation.constraints.n_closure, evaluation.model
    free = np.ones(model.nv, dtype=bool)
    rng = np.random.default_rng(3)
    best = 0
    for _ in range(REGULAR_TRIALS):
        step = evaluation.mechanism.velocity_scale * rng.uniform(-0.02, 0.02, model.nv)
        _, error = close(evaluation, pin.integrate(model, q, step), free, TOLERANCES.zero)
        if error <= TOLERANCES.closed:
            best = max(best, len(independent_rows(evaluation.jacobian[:n])))
    return best


def _ways(evaluation: LoopEquations, q: Array) -> int:
    """Return in how many independent ways steps from q go on when loops are closed again."""
    evaluation.update(q)
    n, scale = evaluation.constraints.n_closure, evaluation.mechanism.velocity_scale
    freedoms = decompose(evaluation.jacobian[:n]).null_space
    free, rng = np.ones(len(scale), dtype=bool), np.random.default_rng(3)
    left = []
    for _ in range(REGULAR_TRIALS * len(freedoms)):
        v = rng.standard_normal(len(freedoms)) @ freedoms
        start = pin.integrate(evaluation.model, q, scale * v * (STEP / float(np.linalg.norm(v))))
        there, error = close(evaluation, start, free, TOLERANCES.zero)
        moved = pin.difference(evaluation.model, q, there) / (scale * STEP)
        if error <= TOLERANCES.closed and np.linalg.norm(moved) > TOLERANCES.moved:
            left.append(moved / np.linalg.norm(moved))
    evaluation.update(q)
    return int(np.count_nonzero(decompose(np.array(left)).s > TOLERANCES.moved)) if left else 0


def lost_rank(evaluation: LoopEquations, q: Array, lost: int, motion: str) -> str:
    """Return why nothing determines the motion at q, in words, where the loops lose equations.

    Args:
        evaluation: the closure equations; it comes back to q.
        q: (nq,) closed configuration.
        lost: how many equations.
        motion: what would determine the motion elsewhere.
    """
    n, ways = evaluation.constraints.n_closure, _ways(evaluation, q)
    freedoms = evaluation.model.nv - len(independent_rows(evaluation.jacobian[:n]))
    equations = f"{lost} independent equation{'s' * (lost != 1)}"
    text = f"singular configuration: the loops lose {equations} there, and "
    if ways <= freedoms - lost:
        nothing = "nothing can move: " * (not ways)
        shaken = f"{lost} freedom{' is' if lost == 1 else 's are'} instantaneous only"
        return f"{text}{nothing}{shaken}: it shakes, but goes nowhere (see sp.mobility)"
    return (f"{text}branches cross, so that the {motion} do not determine the motion; start "
            "beside this configuration")
