"""Redundant equations of loops with rounded numbers in the file.

A plane loop from a CAD program has hinges that are parallel to five to eight digits. Taken exactly,
its links could hardly move: equations that are redundant in the exact mechanism stay open by the
rounding, or hold at the drawn pose alone. Such equations are left out. The mechanism then has the
freedoms and motions of its drawing, to the digits of the file, and the remaining error is reported
as a `Gap`.

To distinguish rounding from a wrong loop, configurations are sampled along the motion, once for a
mechanism. The strong equations, with singular values far above the gap allowed, are followed along
their free directions. Equations that stay closed to the gap everywhere are redundant. If they open
beyond it they are not: the mechanism is rigid, or moves within the gap only. If as many freedoms
remain with all equations, the numbers contradict nothing, and all equations stay.

The remaining equations are those that are independent at all samples, as well as possible; else
those that are so as far as possible from the guess.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import accumulate, combinations, takewhile
from math import comb
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.close import DAMPED_STEPS, close
from spatial_pin.assembly.start_values import read_guess
from spatial_pin.assembly.state import State, carried_angles, gap_of
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.kernel.closer import ClosureSettings, closer_of
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import SelectedEquations
from spatial_pin.numerics.linalg import (
    Array,
    column_spaces,
    decompose,
    mean_subspace,
    null_space,
    null_spaces,
    singular_values,
    weighty_rows,
)
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.settings import Accuracy

CLOSED = TOLERANCES.closed
FITS = 0.1 * CLOSED  # closure error along the motion of equations that are redundant everywhere
# Singular values of equations that a gap opens, relative to the gap: a gap is the rounding of one
# number, an equation has about ten numbers.
GAPS_WIDE, WIDEST_GAP = 10.0, 0.02
# Every fourth sample is tried for closing all equations: a dozen of 48, each as costly as a start.
EVERY = 4
# Length of the last independent equation above which all are clearly independent. It is above the
# least singular value, seldom by more than ten times.
INDEPENDENT = 1e-2
CLEAR_OF_CUT = 3.0  # ratio to the cut of all singular values of a regular mechanism
NEARLY_OPEN = 10.0  # gaps by which loops are open that a wider gap closes: a digit less
MOTION_SAMPLES = 48  # samples of the motion; half must be reached: more than one turn
STRIDE = 0.4  # distance between samples [rad, characteristic lengths]: three turns in all
START_SAMPLES = 8  # starts if the guess of the file does not close: usually one in two closes
# Factor on singular values and gaps of the samples for other configurations: rounding is the same
# there, and levers differ by less.
ABOVE = 10.0
# Independence, relative to that of all equations, of a good choice: a better one gains less than a
# digit.
GOOD = 0.2
# Independence, relative to that of all equations, of a useless choice: rates lose two digits, and a
# tenth of a radian ahead the equations may be dependent.
USELESS = 0.05
# The same, with which a choice made for a path is left at that: errors are a few times those of all
# equations; and how many times as independent another one is to be.
FAIR, TWICE = 0.3, 2.0
# of motion from the guess, over which equations stay within the gap
HALF_RADIAN, PARTS_OF_MOTION = 0.5, 4
PART = HALF_RADIAN / PARTS_OF_MOTION  # [rad, characteristic lengths]
MOST_SAMPLED = 400  # configurations of a path: eight turns, in a tenth of a second
DIRECTIONS = 6  # of that motion, each taken both ways
LONGER_MOTION = 4  # such motions in a row, over which it is seen how long equations are independent
ALONG_PROBES, STEPS_TO_POSE = 4, 3  # other poses, and steps to each
STEP_TO_POSE = 0.1  # length of a step [rad, characteristic lengths]
# Of files with three digits, and with two; then others, as a gap far above the rounding may hide a
# real equation.
GAPS_TRIED = (1e-3, 1e-2, 2e-4, 5e-4, 2e-3, 5e-3)
FEW_CHOICES = 300  # of equations, that are all looked at: in a fraction of a second
# Samples from the guess on, in which sums of equations are to be independent where none are all
# through: two radians, one and a half, one, half a radian; of ways ahead, none.
HORIZONS = 17, 13, 9, 5, 1
CHOICE_ROUNDS = 30  # of weights, after which the least independent sample gains no digit more
# Weight of the equations of screws and couplings, which are preferred: no other is as well
# conditioned as to outweigh it.
PREFERRED = 1e3


class Sample(NamedTuple):
    """A configuration closed as well as possible.

    Attributes:
        q: the configuration (nq,).
        jacobian: of the closure equations.
        s: its singular values.
        error: closure error.
        rows: orthonormal rows (rank, nv) of its row space, oriented like those of the sample
            before; empty if not needed.
    """

    q: Array
    jacobian: Array
    s: Array
    error: float
    rows: Array = np.empty((0, 0))


@made_once
def without_rounded_equations(mechanism: Mechanism, gap: float) -> Mechanism | None:
    """Return a mechanism without the equations that the rounding of its numbers contradicts.

    `gap` is the largest closure error that these may keep.

    Returns:
        None where there are no such equations, or the numbers are further off than that.
    """
    if mechanism.whole is not None or not gap or not mechanism.closures:
        return None
    free, scale = np.ones(mechanism.model.nv, dtype=bool), mechanism.velocity_scale
    rng = np.random.default_rng(20113)
    how = ClosureSettings(free, None, CLOSED, DAMPED_STEPS, TOLERANCES.rank)
    with closer_of(mechanism) as closer:
        if not closer.kernel.n_closure or not len(free):
            return None
        # are equations clearly independent, or do they follow from others, at a pose near the
        # guess? not at the guess: loops that fit as drawn fit there however rounded numbers are
        start = closer.solve([read_guess(mechanism, None).q], how)[0].q
        for _ in range(ALONG_PROBES):
            q, ahead = start, rng.uniform(-1.0, 1.0, len(free))
            for _ in range(STEPS_TO_POSE):  # the first finds a direction that the loops leave free
                step = STEP_TO_POSE * scale * ahead / np.abs(ahead).max()
                there = closer.solve([pin.integrate(mechanism.model, q, step)], how)[0]
                q, ahead = there.q, pin.difference(mechanism.model, q, there.q) / scale
                if there.error > CLOSED or np.abs(ahead).max() < TOLERANCES.half_precision:
                    break
            else:
                seen = closer.examine(q, 0.0)
                if seen.least > INDEPENDENT and seen.dependent < TOLERANCES.tight:
                    return None
    with loops_of(mechanism) as evaluation:
        selected = _selected(evaluation, gap)
    return None if selected is None else mechanism.with_equations(selected)


def gap_allowed(mechanism: Mechanism, accuracy: Accuracy | None = None) -> float:
    """Return the gap for redundant equations: that of the mechanism's file, else of `accuracy`."""
    return (accuracy or Accuracy()).gap if mechanism.gap is None else mechanism.gap


@made_once
def gap_needed(mechanism: Mechanism) -> float | None:
    """Return a gap, with one digit, with which a locked mechanism would move; or None."""
    for gap in (Accuracy().gap, *GAPS_TRIED):
        if gap <= gap_allowed(mechanism):
            continue
        if (exact := without_rounded_equations(mechanism, gap)) is not None:
            assert exact.selection is not None
            less = clearly_above(max(open_by for _, open_by in exact.selection.opened))
            while less < gap and without_rounded_equations(mechanism, less) is None:
                less = clearly_above(less)
            return min(gap, less)
    return None


def clearly_above(gap: float) -> float:
    """Return a number with one digit, half as large again or a little more."""
    digit = 10.0 ** math.floor(math.log10(1.5 * gap))
    return math.ceil(1.5 * gap / digit) * digit


def gap_words(mechanism: Mechanism) -> str:
    """Return a remedy for a mechanism locked by rounded numbers, as text; else ""."""
    gap = gap_needed(mechanism.whole or mechanism)
    return "" if gap is None else (
        f"; if its file's numbers are rounded as far as that, load(..., gap={gap:.0e}) leaves out "
        "redundant equations that hold to this part of its size only")


def with_independent_equations(mechanism: Mechanism, accuracy: Accuracy | None = None) -> Mechanism:
    """Return `without_rounded_equations` at the allowed gap, or the mechanism itself."""
    return without_rounded_equations(mechanism, gap_allowed(mechanism, accuracy)) or mechanism


def allowed_from(state: State, gap: float) -> float:
    """Return the gap for motions from a state: `gap`, or more if the state has it already."""
    return max(gap, GAPS_WIDE * float(state.gap))


def rounding_of(mechanism: Mechanism) -> float:
    """Return the round-off of a file, relative to 1: 0 for a mechanism with all equations."""
    return 0.0 if mechanism.selection is None else mechanism.selection.cut


def _selected(evaluation: LoopEquations, gap: float) -> SelectedEquations | None:
    """Return the remaining equations if the numbers of others are rounded; None: all."""
    cut = min(GAPS_WIDE * gap, WIDEST_GAP)
    mechanism, rng = evaluation.mechanism, np.random.default_rng(20111)
    guess, scale = read_guess(mechanism, None).q, mechanism.velocity_scale
    starts = (pin.integrate(evaluation.model, guess, min(k, 3) * scale * rng.uniform(
        -1.0, 1.0, len(scale))) for k in range(START_SAMPLES))  # the guess of the file, and others
    first = next(filter(None, (_sample(evaluation, q, cut, gap) for q in starts)), None)
    if first is None:
        return None
    # another branch may have a smaller gap than the guess, but the loops are not drawn there
    missed = _sample(evaluation, guess, cut, NEARLY_OPEN * gap)
    if missed is not None and missed.error > gap:
        return None
    reached = [first, *_motion_samples(evaluation, first, cut, gap)]
    rank = max(_rank(x.s, cut) for x in reached)
    samples = [x for x in reached if _rank(x.s, CLEAR_OF_CUT * cut) == rank]
    if not samples or (len(samples) <= MOTION_SAMPLES // 2 and rank < evaluation.model.nv):
        return None
    soft = max(float(x.s[rank:].max(initial=0.0)) / x.s[0] for x in samples)
    worst = max(samples, key=lambda x: x.error)
    if (soft <= TOLERANCES.rank and worst.error <= FITS) or soft >= cut:
        return None
    if _moves_with_all(evaluation, samples, rank, soft):
        return None
    near = [_regular(_oriented(first, x, rank), rank, cut)
            for x in _nearby(evaluation, first, cut, gap)]
    selected = (_independent(mechanism, near, _oriented(first, samples, rank))[0] if rank else
            SelectedEquations(((),) * len(mechanism.closures), ((),) * len(mechanism.closures)))
    reduced = mechanism.with_equations(selected)
    if _opens_nearby(evaluation, reduced, _oriented(first, [first], rank)[0], gap):
        return None
    least = max(ABOVE * max(soft, worst.error), TOLERANCES.rank)
    opened = gap_of(reduced, worst.q, np.zeros(constraints_of(reduced).n_angles)).closures
    return selected._replace(cut=min(least, cut), opened=tuple(opened.items()))


def _moves_with_all(
    evaluation: LoopEquations, samples: list[Sample], rank: int, soft: float
) -> bool:
    """Whether a mechanism has as many freedoms with all its equations as with `rank` of them.

    Then its numbers contradict nothing, however small some singular values are. Links as short as
    these values are no rounding either: with them fewer freedoms are enough, if all that moves
    without some equations moves with all of them. From a sample all equations are closed, which may
    lead far away, and followed from there.
    """
    mechanism, free = evaluation.mechanism, np.ones(evaluation.model.nv, dtype=bool)
    for x in samples[::EVERY]:
        q, error = close(evaluation, x.q, free, CLOSED)
        if error > FITS:
            continue
        first = _sample(evaluation, q, TOLERANCES.rank, FITS)
        if first is not None:
            reached = list(_motion_samples(evaluation, first, TOLERANCES.rank, FITS))
            if len(reached) <= MOTION_SAMPLES // 2:
                return False
            if max(_rank(y.s, TOLERANCES.rank) for y in reached) <= rank:
                return True
            lengths = [float(np.linalg.norm(at.translation)) / mechanism.characteristic_length
                       for at in list(mechanism.model.jointPlacements)[1:]]
            shortest = min((length for length in lengths  # of links; 0 if none is that short
                            if TOLERANCES.nothing < length < WIDEST_GAP), default=0.0)
            return bool(shortest > soft / ABOVE and not np.any(
                _moving(samples, rank) & ~_moving(reached, None)))
    return False


def _moving(samples: list[Sample], rank: int | None) -> NDArray[np.bool_]:
    """Return (nv,) which velocities are not zero in some motion, with `rank` equations closed."""
    moves = np.zeros(samples[0].jacobian.shape[1], dtype=bool)
    for x in samples[::EVERY]:
        cut = TOLERANCES.rank if rank is None else 2.0 * x.s[rank] / x.s[0] + TOLERANCES.rank
        tangents = null_space(x.jacobian, min(cut, WIDEST_GAP))
        moves |= np.abs(tangents).max(axis=0, initial=0.0) > TOLERANCES.rank
    return moves


def _rank(s: Array, cut: float) -> int:
    return int(np.count_nonzero(s > cut * s[0])) if s.size else 0


def _regular(path: list[Sample], rank: int, cut: float) -> list[Sample]:
    """Return the samples of a path up to the first whose equations lose their rank."""
    return list(takewhile(lambda x: _rank(x.s, CLEAR_OF_CUT * cut) == rank, path))


def _sample(evaluation: LoopEquations, q: Array, cut: float, gap: float) -> Sample | None:
    """Close the loops from q (nq,) as well as possible; None if the gap remains exceeded."""
    q, error = close(evaluation, q, np.ones(evaluation.model.nv, dtype=bool), CLOSED, cut=cut)
    return None if error > gap or evaluation.mirrored() else _sample_at(evaluation, q)


def _sample_at(evaluation: LoopEquations, q: Array) -> Sample:
    """Return the sample of a configuration (nq,), as it is."""
    evaluation.update(q)
    jacobian = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
    return Sample(q, jacobian, singular_values(jacobian), evaluation.closure_error)


def _nearby(
    evaluation: LoopEquations, first: Sample, cut: float, gap: float
) -> Iterator[list[Sample]]:
    """Yield paths from a configuration, closed to the gap, that one included.

    They are half a radian long; of a mechanism of one freedom two radians.
    """
    rng, tangents = np.random.default_rng(20115), null_space(first.jacobian, cut)
    parts = PARTS_OF_MOTION * (LONGER_MOTION if len(tangents) == 1 else 1)
    for _ in range(min(DIRECTIONS, len(tangents) ** 2)):
        direction = rng.standard_normal(len(tangents)) @ tangents
        for ahead in (direction, -direction):
            yield [first, *_walk(evaluation.mechanism, first.q, ahead, parts,
                                 lambda q: _sample(evaluation, q, cut, gap))]


def _oriented(first: Sample, path: list[Sample], rank: int = 0) -> list[Sample]:
    """Return samples along a path, the rows of each turned as those of the one before.

    The first sample before them has rows, or there are `rank` of them.
    """
    oriented, before = [], first.rows if first.rows.size else decompose(first.jacobian).vt[:rank]
    for x in path:
        rows = decompose(x.jacobian).vt[: len(before)]
        if np.linalg.det(rows @ before.T) < 0.0:
            rows[0] = -rows[0]
        oriented.append(x._replace(rows=rows))
        before = rows
    return oriented


def _opens_nearby(whole: LoopEquations, reduced: Mechanism, first: Sample, gap: float) -> bool:
    """Whether equations left out open beyond the gap within half a radian of motion from a sample.

    The equations that stay are followed along random directions of their freedom, both ways, as far
    as they are independent: where they are not, the others open though nothing contradicts them.
    Equations that hardly are so at the first sample determine no motion at all.
    """
    rng, free = np.random.default_rng(20114), np.ones(whole.model.nv, dtype=bool)
    with loops_of(reduced) as evaluation:
        n = evaluation.constraints.n_closure

        def closed(q: Array) -> Sample | None:
            q, error = close(evaluation, q, free, CLOSED)
            return None if error > CLOSED else _sample_at(whole, q)

        start, _ = close(evaluation, first.q, free, CLOSED)
        tangents = null_space(evaluation.jacobian[:n], TOLERANCES.rank)
        independence = float(_independence([evaluation.jacobian[:n]], [first])[0])
        if abs(independence) < USELESS:
            return True
        sign = math.copysign(1.0, independence)
        for _ in range(DIRECTIONS if len(tangents) else 0):
            direction = rng.standard_normal(len(tangents)) @ tangents
            for ahead in (direction, -direction):
                seen = first
                for x in _walk(reduced, start, ahead, PARTS_OF_MOTION, closed):
                    seen, = _oriented(seen, [x])
                    if sign * _independence([evaluation.jacobian[:n]], [seen])[0] < USELESS:
                        break
                    if seen.error > gap:
                        return True
    return False


def _dense(mechanism: Mechanism, q: Array) -> Iterator[tuple[int, Array]]:
    """Yield configurations (nq,) along a path of some (n, nq), none far from the one before.

    Before each stands how many of those that are given come before it.
    """
    last, model = q[0], mechanism.model
    yield 0, last
    for k, x in enumerate(q[1:], start=1):
        difference = pin.difference(model, last, x)
        parts = float(np.abs(difference / mechanism.velocity_scale).max()) / PART
        if parts >= 0.5 or k + 1 == len(q):
            for i in range(1, math.ceil(parts)):
                yield k, pin.integrate(model, last, difference * (i / math.ceil(parts)))
            yield k, x
            last = x


def independent_along(
    mechanism: Mechanism, q: Array, angles: Array, ahead: Array, gap: float, opens: bool = False
) -> tuple[Mechanism, int | None]:
    """Return the mechanism of a rounded file with equations that are independent along a path.

    Those that are so near the guess may depend on each other elsewhere, at what seems a limit
    position then, or a singular one. q (n, nq) are closed configurations along the path, `angles`
    those of screw closures at the first one; `ahead` (nv,) is the scaled direction in which it goes
    on from the last. Other equations may keep a closure error up to `gap`. `opens`: whether they
    open beyond it just ahead of the last.

    Returns:
        The same one where its equations do, or no others do better; else one with equations that
        are independent for some way ahead as well. And how many configurations come before the
        first at which the given ones are not, which may be ahead if others open there; None: they
        are so at all.
    """
    whole, selection = mechanism.whole, mechanism.selection
    assert whole is not None and selection is not None
    rank, cut = sum(selection.counts()), min(GAPS_WIDE * gap, WIDEST_GAP)
    if not rank:
        return mechanism, None
    with loops_of(whole, carried_angles(mechanism, angles, whole)) as every, loops_of(
            mechanism, angles) as evaluation:
        dense = list(_dense(mechanism, q))[-MOST_SAMPLED:]
        path = [_sample_at(every, point) for _, point in dense]
        path = _regular(_oriented(path[0], path, rank), rank, cut)
        if not path:
            return mechanism, None
        along = _signed_independence(evaluation, path)
        bad = np.flatnonzero(along < USELESS)
        n, worth = dense[bad[0]][0] if bad.size else None, max(0.0, float(along.min()))
        if worth >= FAIR and not opens:
            return mechanism, n
        travelled = (pin.difference(whole.model, x, q[-1]) / whole.velocity_scale
                     for x in q[-2::-1])
        ahead = next((x for x in travelled if np.abs(x).max() > TOLERANCES.half_precision), ahead)
        beyond = _oriented(path[-1], list(_walk(
            whole, path[-1].q, ahead, LONGER_MOTION * PARTS_OF_MOTION,
            lambda point: _sample(every, point, cut, gap)))) if ahead.any() else []
        if opens:
            worth = max(0.0, float(_signed_independence(evaluation, [*path, *beyond]).min()))
            if worth >= FAIR:
                return mechanism, n
            n = len(q) if n is None and worth < USELESS else n
        best = max(USELESS, TWICE * worth), selection
        for some in HORIZONS:
            chosen, better = _independent(whole, [], path + beyond[: some - 1])
            best = max(best, (better, chosen), key=lambda x: x[0])
            if better >= FAIR or not beyond:
                break
    return mechanism if best[1] is selection else whole.with_equations(
        best[1]._replace(cut=selection.cut, opened=selection.opened)), n


def independence_at(mechanism: Mechanism, q: Array, angles: Array) -> tuple[float, float]:
    """Return how independent the equations of the mechanism of a rounded file are.

    Returns:
        Their least singular value on the row space of all equations, relative to that of these; and
        the closure error of all equations [-].
    """
    whole, selection = mechanism.whole, mechanism.selection
    assert whole is not None and selection is not None
    rank = sum(selection.counts())
    with loops_of(whole, carried_angles(mechanism, angles, whole)) as every, loops_of(
            mechanism, angles) as evaluation:
        sample = _sample_at(every, q)
        if not rank or not sample.s[rank - 1] > 0.0:
            return float(not rank), sample.error
        path = _oriented(sample, [sample], rank)
        return float(abs(_signed_independence(evaluation, path)[0])), sample.error


def _walk(
    mechanism: Mechanism, q: Array, ahead: Array, parts: int,
    closed: Callable[[Array], Sample | None],
) -> Iterator[Sample]:
    """Yield configurations from q (nq,) on, until a limit, one part of half a radian after another.

    The motion begins along `ahead` (nv,), scaled; `closed` closes the loops, or returns None.
    """
    model, scale = mechanism.model, mechanism.velocity_scale
    for _ in range(parts):
        step = PART * ahead / np.abs(ahead).max()
        sample = closed(pin.integrate(model, q, scale * step))
        if sample is None:
            return
        ahead = pin.difference(model, q, sample.q) / scale
        if ahead @ step < TOLERANCES.moved * (step @ step):
            return
        yield sample
        q = sample.q


def _motion_samples(
    evaluation: LoopEquations, first: Sample, cut: float, gap: float
) -> Iterator[Sample]:
    """Yield configurations along the motion of the mechanism, closed to the gap."""
    model, scale = evaluation.model, evaluation.mechanism.velocity_scale
    rng, here, ahead = np.random.default_rng(20112), first, np.zeros(model.nv)
    for _ in range(MOTION_SAMPLES):
        tangents = null_space(here.jacobian, cut)
        if not len(tangents):
            return
        along = tangents.T @ (tangents @ ahead) if ahead.any() else np.zeros(model.nv)
        along = along + 0.3 * (rng.standard_normal(len(tangents)) @ tangents)
        along *= STRIDE / max(float(np.abs(along).max()), 1e-300)
        sample = _sample(evaluation, pin.integrate(model, here.q, scale * along), cut, gap)
        if sample is None:
            ahead = -ahead
            continue
        moved = pin.difference(model, here.q, sample.q) / scale
        if np.abs(moved).max() < TOLERANCES.moved * STRIDE:
            ahead = -ahead
            continue
        here, ahead = sample, moved / np.linalg.norm(moved)
        yield here


def _independent(
    mechanism: Mechanism, near: list[list[Sample]], samples: list[Sample]
) -> tuple[SelectedEquations, float]:
    """Return equations, as many as are independent, that are so at all samples as well as can be.

    No choice may do everywhere: the parallel cranks of a coupler are folded by pairs, one pair here
    and another there, and each choice relies on some pair. Then one is made for the paths near the
    guess. Directions of frame 2 serve too where those of frame 1 alone would not do, and sums of a
    closure's equations where none of them would.

    Returns:
        The equations, and how independent they are on all of `samples`, as `_worth` has it.
    """
    constraints = constraints_of(mechanism)
    weights = np.ones(constraints.n_closure)
    weights[[x.equation for x in constraints.angles]] = PREFERRED
    weights[constraints.n_products :] = PREFERRED
    near = [path for path in near if path]
    paths = [*near, samples]
    everywhere = [x for path in paths for x in path]
    jacobians, names = np.array([x.jacobian for x in everywhere]), constraints.closure_of
    rows, worth = _choice(jacobians, paths, weights)
    sums: Array = np.eye(len(weights))[rows]
    if worth[1] < GOOD and any(c.can_turn for c in mechanism.closures):
        evaluation = LoopEquations(mechanism.with_fields(
            closures=tuple(c.turned() for c in mechanism.closures if c.can_turn)))
        more = []
        for x in everywhere:
            evaluation.update(x.q)
            more.append(evaluation.jacobian[: len(evaluation.residual)].copy())
        wider, n = np.concatenate([jacobians, more], axis=1), len(weights)
        weights = np.concatenate([weights, np.ones(len(more[0]))])
        sums = np.pad(sums, ((0, 0), (0, len(weights) - n)))
        rows, better = _choice(wider, paths, weights)
        if better > worth:
            sums, worth = np.eye(len(weights))[rows], better
        jacobians, names = wider, names + evaluation.constraints.closure_of
    own = [np.array([k for k, name in enumerate(names)
                     if name == c.name and (k >= constraints.n_closure) is turned], np.intp)
           for turned in (False, True) for c in mechanism.closures]
    blocks = [x for x in own if len(x) and (weights[x] < PREFERRED).all()]
    if worth[1] < GOOD and blocks:
        for some in (paths, *([path[:n] for path in near] for n in HORIZONS[:-1] if near)):
            at = [k for k, x in enumerate(everywhere)
                  if any(x is y for path in some for y in path)]
            better_sums = _sums(sums, jacobians[at], [everywhere[k] for k in at], blocks)
            if (better := _worth(better_sums @ jacobians, paths)) > worth:
                sums, worth = better_sums, better
    chosen = [tuple(tuple(row[at].tolist()) for row in sums if row[at].any()) for at in own]
    n = len(mechanism.closures)
    return SelectedEquations(tuple(chosen[:n]), tuple(chosen[n:])), worth[1]


def _sums(
    rows: Array, jacobians: Array, samples: list[Sample], blocks: list[NDArray[np.intp]]
) -> Array:
    """Return rows (rank, n); those of blocks are sums that are independent at samples.

    Of one closure they span the mean of the spaces of Jacobians' columns, with weights that bring
    the farthest nearer; closures are gone through one after the other, with the rows of others. It
    begins with `rows`, weights of all equations; `jacobians` (N, n, nv) are those of all equations
    at the samples, `blocks` the equations of each closure.
    """
    minors = jacobians @ np.array([x.rows.T for x in samples])
    columns = column_spaces(minors)
    weights, best, most = np.ones(len(samples)), rows, 0.0
    for _ in range(CHOICE_ROUNDS):
        for block in blocks:
            mine = np.flatnonzero(np.any(rows[:, block] != 0.0, axis=1))
            count = len(mine)
            if not 0 < count < len(block):
                continue
            rest = np.delete(rows, mine, axis=0) @ columns
            own = columns[:, block] @ null_spaces(rest, count).transpose(0, 2, 1)
            rows = rows.copy()
            rows[np.ix_(mine, block)] = mean_subspace(column_spaces(own), weights)
        least = singular_values(rows @ columns)[:, -1]
        if least.min() > most:
            best, most = rows, float(least.min())
        weights *= np.exp(least.max() - least)
        weights /= weights.max()
    return best


def _independence(jacobians: list[Array] | Array, samples: list[Sample]) -> Array:
    """Return how independent the rows of Jacobians are at samples (n,), relative to all equations.

    The sign changes along a path where they become dependent.
    """
    minors = np.matmul(np.asarray(jacobians), np.array([x.rows.T for x in samples]))
    sizes = np.array([x.s[len(x.rows) - 1] for x in samples])
    least: Array = singular_values(minors)[:, -1] / sizes
    return least * np.sign(np.linalg.det(minors))


def _signed_independence(evaluation: LoopEquations, samples: list[Sample]) -> Array:
    """Return `_independence` (n,) of equations at samples along a path, from a positive one on."""
    rows = []
    for x in samples:
        evaluation.update(x.q)
        rows.append(evaluation.jacobian[: evaluation.constraints.n_closure].copy())
    signed = _independence(rows, samples)
    return signed * np.sign(signed[0])


def _worth(rows: Array, paths: list[list[Sample]]) -> tuple[float, float, int, float]:
    """Return how well rows (N, rank, nv) of Jacobians at all samples are independent.

    Returns:
        Their independence relative to that of all equations: the least within half a radian of the
        guess, up to `GOOD`; the least all through, 0 if they become dependent between two samples,
        where their determinant changes sign; at how many samples in a row from the guess there is
        any; the least at the samples themselves.
    """
    first = len(rows) - len(paths[-1])
    scores = np.round(_independence(rows[first:], paths[-1]), 6)
    through = float(np.abs(scores).min()) if (np.sign(scores) == np.sign(scores[0])).all() else 0.0
    nearby, count = GOOD, 0
    if through < GOOD and first:  # looked at where the rows do not do everywhere
        ahead = np.round(_independence(rows[:first], [x for p in paths[:-1] for x in p]), 6)
        same = np.where(np.sign(ahead) == np.sign(ahead[0]), np.abs(ahead), 0.0)
        branches = np.split(same, list(accumulate(map(len, paths[:-1])))[:-1])
        nearby = min(GOOD, *(float(x[: PARTS_OF_MOTION + 1].min()) for x in branches))
        count = sum(len(list(takewhile(lambda value: value >= USELESS, x))) for x in branches)
    return nearby, through, count, float(np.abs(scores).min())


def _choice(
    jacobians: Array, paths: list[list[Sample]], weights: Array
) -> tuple[list[int], tuple[float, float, int, float]]:
    """Return the equations that are independent at all samples as well as can be; their `_worth`.

    All choices are looked at if they are few; else those that are best at one of them, or at all.
    Equations whose weight is `PREFERRED` are among them if that is good enough. `jacobians`
    (N, n, nv) are at all samples of the paths, in this order. The last path is the motion all
    through, the others are near the guess.
    """
    n, rank = len(weights), len(paths[-1][0].rows)
    if comb(n, rank) <= FEW_CHOICES:
        choices = list(combinations(range(n), rank))
    else:
        near, through = np.split(jacobians, [len(jacobians) - len(paths[-1])])
        samples = [*through, np.hstack(list(through)), *([np.hstack(list(near))] if len(near)
                                                        else [])]
        choices = sorted({tuple(weighty_rows(weights[:, None] * x, rank).tolist())
                          for x in samples})
    worths = [_worth(jacobians[:, rows], paths) for rows in choices]
    preferred = set(np.flatnonzero(weights == PREFERRED).tolist())
    best = max(range(len(choices)), key=lambda k: (
        worths[k][1] >= GOOD and preferred <= set(choices[k]), *worths[k], -k))
    return list(choices[best]), worths[best]
