"""Files whose numbers are rounded: redundant equations of loops that hold to a few digits only.

A plane loop in the numbers of a CAD program has hinges that are parallel to five to eight digits.
As these say, its links could hardly move: equations that follow from the others in the exact
mechanism stay open by the rounding, and their derivatives have singular values as small. Such
equations are left out: the mechanism then has the freedoms and the motions that were meant, to the
digits of the file, and what is left open is reported as a `Gap`.

They are told from a loop that is wrong, or that only shakes, on the way: closed as well as they
can be, all stay closed to the gap allowed wherever the mechanism goes, and depend on as few. Which
ones stay is chosen once for a mechanism: those that are independent on all of that way, as well as
can be.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, evaluation_of
from spatial_pin.constraints.compiled_equations import Constraints, constraints_of
from spatial_pin.constraints.workspaces import made_once
from spatial_pin.kernel.closer import Examined, closer_of
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Equations
from spatial_pin.numerics.linalg import Array, null_space, singular_values, weighty_rows
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

CLOSED, SOFT = TOLERANCES.closed, TOLERANCES.near_singular
# Singular values of equations that rounding opens by a gap are below so many gaps: a gap is the
# rounding of one number, an equation is made of about ten.
GAPS_WIDE = 10.0
# Configurations, from one of which it is seen whether all equations can be closed: a dozen of 48,
# as each takes as many steps as a start may.
EVERY = 4
# What is left of equations that are clearly independent: a thousand times `SOFT`, as what is left
# of the last one is larger than the least singular value, though hardly ever ten times.
INDEPENDENT = 1e-2
CLEAR_OF_CUT = 3.0  # cuts, above which all singular values are where a mechanism is regular
ON_THE_WAY = 48  # configurations looked at, of which half must be reached: more than one turn then
STRIDE = 0.4  # rad, characteristic lengths, from one to the next: three turns in all
# Starts where the guess of the file does not close: one in two closes elsewhere, as a rule.
BEGINNINGS = 8
# Singular values and gaps found on the way, below which those of other places are: rounding is the
# same there, and levers differ by less than that.
ABOVE = 10.0
# Independence relative to that of all equations, with which a choice is left at that: a better one
# gains less than a digit.
GOOD = 0.2
FEW_CHOICES = 300  # of equations, that are all looked at: in a fraction of a second
# Weight of equations that are kept if they can, those of screws and couplings: no other is as well
# conditioned as to outweigh it.
KEPT = 1e3


class Sample(NamedTuple):
    """A configuration closed as well as it can be.

    Attributes:
        q: the configuration (nq,).
        jacobian: of the closure equations there.
        s: its singular values.
        even: those with all its columns made alike.
        error: closure error.
    """

    q: Array
    jacobian: Array
    s: Array
    even: Array
    error: float


class Rounded(NamedTuple):
    """A mechanism without the equations that its numbers contradict.

    Attributes:
        mechanism: the one without, whose `whole` has them.
        cut: part of the largest singular value of the closure equations below which all others are
            those of such equations.
    """

    mechanism: Mechanism
    cut: float


def may_be_rounded(
    evaluation: Evaluation, q: Array, gap: float, seen: Examined | None = None
) -> bool:
    """Whether some equations at q (nq,), closed, are nearly, but not quite, others.

    Args:
        evaluation: of the mechanism, its screws counting turns as at q.
        q: the configuration.
        gap: the largest closure error that they may keep [-].
        seen: what was found at q, if something was.
    """
    if not gap or not evaluation.constraints.n_closure:
        return False
    if seen is None:
        with closer_of(evaluation.mechanism) as closer:
            seen = closer.examine(q, evaluation.angle_reference)
    if is_clear(seen.least, seen.left_out):
        return False
    evaluation.update(q)
    rows = _evened(evaluation.jacobian[: evaluation.constraints.n_closure])
    return _nearly_depend(rows, min(gap, SOFT))


def is_clear(least: float, left_out: float) -> bool:
    """Whether equations are clearly independent, or follow from others to round-off.

    Args:
        least: what is left of the last independent one, see `Examined`.
        left_out: what is left of the longest of the others.
    """
    return least > INDEPENDENT and left_out < TOLERANCES.tight


def rounded(mechanism: Mechanism, gap: float) -> Mechanism | None:
    """Return a mechanism without the equations that the rounding of its numbers contradicts.

    Args:
        mechanism: the mechanism.
        gap: the largest closure error that these may keep [-].

    Returns:
        None where there are no such equations, or the numbers are further off than that.
    """
    found = _found(mechanism, gap)
    return None if found is None else found.mechanism


def cut_of(mechanism: Mechanism, gap: float) -> float:
    """Return the part of the largest singular value below which rounding hides the others."""
    found = _found(mechanism, gap)
    return GAPS_WIDE * gap if found is None else found.cut


def as_meant(mechanism: Mechanism, gap: float) -> Mechanism:
    """Return a mechanism, or the one without what its rounded numbers contradict.

    It is looked at where it closes near the guess of its file.
    """
    free, q = np.ones(mechanism.model.nv, dtype=bool), _guess(mechanism)
    with evaluation_of(mechanism) as evaluation:
        q, error = close(evaluation, q, free, CLOSED)
        if error <= CLOSED and not may_be_rounded(evaluation, q, gap):
            return mechanism
    return rounded(mechanism, gap) or mechanism


def _guess(mechanism: Mechanism) -> Array:
    return with_values(mechanism, mechanism.neutral, joint_values(mechanism, mechanism.guess))


def closed_there(mechanism: Mechanism, q: Array) -> Mechanism:
    """Return a mechanism, or the one without what its rounded numbers contradict if q (nq,) is its.

    The gap is that of the default accuracy.
    """
    gap = Accuracy().gap
    with evaluation_of(mechanism) as evaluation:
        evaluation.update(q)
        if mechanism.whole is not None or evaluation.closure_error > gap or (
                evaluation.closure_error <= CLOSED and not may_be_rounded(evaluation, q, gap)):
            return mechanism
    return rounded(mechanism, gap) or mechanism


def allowed_from(state: State, gap: float) -> float:
    """Return the gap that motions from a state may have: `gap`, or more where it has as much."""
    return max(gap, GAPS_WIDE * float(state.gap))


def rounding_of(mechanism: Mechanism) -> float:
    """Return what is round-off of a file, relative to 1: 0 for a mechanism that is whole."""
    return 0.0 if mechanism.whole is None else cut_of(mechanism.whole, Accuracy().gap)


@made_once
def _found(mechanism: Mechanism, gap: float) -> Rounded | None:
    if mechanism.whole is not None or not gap:
        return None
    with evaluation_of(mechanism) as evaluation:
        return _rounded(evaluation, gap)


def _rounded(evaluation: Evaluation, gap: float) -> Rounded | None:
    cut = GAPS_WIDE * gap
    first = next(_beginnings(evaluation, cut, gap), None)
    if first is None or first.error <= CLOSED:  # a loop that fits at one place may hold there only
        return None
    reached = [first, *_on_the_way(evaluation, first, cut, gap)]
    rank = max(_rank(x.s, cut) for x in reached)
    samples = [x for x in reached if _rank(x.s, CLEAR_OF_CUT * cut) == rank]
    if not samples or (len(samples) <= ON_THE_WAY // 2 and rank < evaluation.model.nv):
        return None
    soft = max(float(x.s[rank:].max(initial=0.0)) / x.s[0] for x in samples)
    opened = max(x.error for x in samples)
    if (soft <= TOLERANCES.rank and opened <= CLOSED) or soft >= cut:
        return None
    softest = max(float(x.even[rank:].max(initial=0.0)) / x.even[0] for x in samples)
    if softest > SOFT and any(_closes(evaluation, x.q) for x in samples[::EVERY]):
        return None
    mechanism = evaluation.mechanism
    kept = (_independent(mechanism, samples, rank) if rank else
            Equations(*[((),) * len(mechanism.closures)] * 2))
    least = max(ABOVE * max(soft, opened), TOLERANCES.rank)
    return Rounded(mechanism.with_equations(kept), min(least, cut))


def _closes(evaluation: Evaluation, q: Array) -> bool:
    """Whether all equations can be closed from q (nq,), however far that leads."""
    return close(evaluation, q, np.ones(evaluation.model.nv, dtype=bool), CLOSED)[1] <= CLOSED


def _nearly_depend(rows: Array, part: float) -> bool:
    """Whether singular values of rows are small but not zero: below a part of the largest.

    Their cost is the cube of the number of loops: `may_be_rounded` spares them where it can.
    """
    s = singular_values(rows)
    return bool(np.any((s > TOLERANCES.rank * s[0]) & (s < part * s[0])))


def _evened(jacobian: Array) -> Array:
    """Return a Jacobian with columns made alike: short levers are none then.

    What rounding makes of equations stays as small.
    """
    sizes = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    sizes[sizes <= TOLERANCES.rank] = 1.0
    return jacobian / sizes


def _rank(s: Array, cut: float) -> int:
    return int(np.count_nonzero(s > cut * s[0])) if s.size else 0


def _sample(evaluation: Evaluation, q: Array, cut: float, gap: float) -> Sample | None:
    """Close the loops from q (nq,) as well as they can; None where that is not to the gap."""
    free = np.ones(evaluation.model.nv, dtype=bool)
    q, error = close(evaluation, q, free, CLOSED, cut=cut)
    if error > gap or evaluation.mirrored():
        return None
    jacobian = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
    return Sample(q, jacobian, singular_values(jacobian), singular_values(_evened(jacobian)), error)


def _beginnings(evaluation: Evaluation, cut: float, gap: float) -> Iterator[Sample]:
    """Yield configurations closed to the gap, from the guess of the file and from others."""
    mechanism, model = evaluation.mechanism, evaluation.model
    q = _guess(mechanism)
    rng = np.random.default_rng(20111)
    for k in range(BEGINNINGS):
        shaken = rng.uniform(-1.0, 1.0, model.nv) * mechanism.velocity_scale * min(k, 3)
        found = _sample(evaluation, pin.integrate(model, q, shaken), cut, gap)
        if found is not None:
            yield found


def _on_the_way(
    evaluation: Evaluation, first: Sample, cut: float, gap: float
) -> Iterator[Sample]:
    """Yield configurations that the mechanism goes through, closed to the gap."""
    model, scale = evaluation.model, evaluation.mechanism.velocity_scale
    rng, here, ahead = np.random.default_rng(20112), first, np.zeros(model.nv)
    for _ in range(ON_THE_WAY):
        tangents = null_space(here.jacobian, cut)
        if not len(tangents):
            return
        along = tangents.T @ (tangents @ ahead) if ahead.any() else np.zeros(model.nv)
        along = along + 0.3 * (rng.standard_normal(len(tangents)) @ tangents)
        along *= STRIDE / max(float(np.abs(along).max()), 1e-300)
        found = _sample(evaluation, pin.integrate(model, here.q, scale * along), cut, gap)
        if found is None:
            ahead = -ahead
            continue
        moved = pin.difference(model, here.q, found.q) / scale
        if np.abs(moved).max() < TOLERANCES.moved * STRIDE:
            ahead = -ahead
            continue
        here, ahead = found, moved / np.linalg.norm(moved)
        yield here


def _independent(mechanism: Mechanism, samples: list[Sample], rank: int) -> Equations:
    """Return equations, `rank` of them, that are independent at all samples as well as can be.

    Directions of frame 2 serve too where those of frame 1 alone would not do.
    """
    constraints = constraints_of(mechanism)
    weights = np.ones(constraints.n_closure)
    weights[[at for at, _, _ in constraints.screws]] = KEPT
    weights[constraints.n_products :] = KEPT
    own = [x.jacobian for x in samples]
    rows, weakest = _choice(own, samples, rank, weights)
    if weakest < GOOD and any(c.can_turn for c in mechanism.closures):
        turned = copy(mechanism)
        vars(turned).update(closures=tuple(c.turned() for c in mechanism.closures if c.can_turn))
        evaluation, more = Evaluation(Constraints(turned)), []
        for x in samples:
            evaluation.update(x.q)
            more.append(np.vstack([x.jacobian, evaluation.jacobian[: len(evaluation.residual)]]))
        weights = np.concatenate([weights, np.ones(len(more[0]) - len(weights))])
        wider, better = _choice(more, samples, rank, weights)
        if better > weakest:
            rows = wider
        labels = [*constraints.labels, *evaluation.constraints.labels]
    else:
        labels = list(constraints.labels)
    kept: list[dict[str, tuple[int, ...]]] = [{c.name: () for c in mechanism.closures}
                                              for _ in range(2)]
    for row in rows:
        kept[row >= constraints.n_closure][labels[row].closure] += (labels[row].equation,)
    return Equations(*(tuple(each.values()) for each in kept))


def _choice(
    jacobians: list[Array], samples: list[Sample], rank: int, weights: Array
) -> tuple[list[int], float]:
    """Return the rows that are independent at all samples, and how well they are at the worst.

    All choices are looked at if they are few; else those that are best at one of them, or at all.
    Rows whose weight is `KEPT` are among them if that is good enough.
    """
    n = len(weights)
    stacked = np.array(jacobians)
    if comb(n, rank) <= FEW_CHOICES:
        choices = list(combinations(range(n), rank))
    else:
        places = [*jacobians, np.hstack(jacobians)]
        choices = sorted({tuple(weighty_rows(weights[:, None] * x, rank).tolist())
                          for x in places})
    sizes = np.array([x.s[rank - 1] for x in samples])
    found = [round(float((singular_values(stacked[:, list(rows)])[:, -1]
                          / sizes).min()), 6) for rows in choices]
    kept = set(np.flatnonzero(weights == KEPT).tolist())
    best = max(range(len(choices)), key=lambda k: (
        found[k] >= GOOD and kept <= set(choices[k]), found[k], -k))
    return list(choices[best]), found[best]
