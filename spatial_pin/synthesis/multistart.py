"""Batched multistart for exact goals: many random starts, fitted together.

Newton's method meets exact goals from few starts in a hundred and stalls elsewhere. So dimensions
and configurations of all samples are drawn at random, with open loops. Levenberg's method changes
them together. This finds more than a search with closed loops or best configurations, whose curves
end and jump. Configurations are eliminated sample by sample, and many starts cost little more than
one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.dimensions.variants import DimensionBatch
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.stacked import levenberg
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.design_space import DesignSpace
from spatial_pin.synthesis.inner_problem import GoalStates, spread

BATCH_STEPS = 120  # Levenberg steps: half of the successful starts need 70
BATCH_DAMPING = 1e-2  # relative to equations of order one
# factors of the damping after a step that helped, and after one that did not
BATCH_EASING, BATCH_HARDENING = 0.3, 4.0
LEAST_BATCH_DAMPING = 1e-15  # round-off of the equations
# sums of squares below which goals are met, and nearly met
MET, NEAR = TOLERANCES.nothing**2, TOLERANCES.nothing
MOST_NEAR = 2  # nearly met starts that are continued
TOGETHER = 1e-4  # distance, relative to the sizes, below which two ends are equal
# Step of forward differences, relative to the size of a number: their error is of this order, and
# round-off is eps over it.
AHEAD = TOLERANCES.singular


class StartEquations(NamedTuple):
    """Equations of M starts with k samples of a goal, and their derivatives."""

    value: Array  # (M, k, r)
    moves: Array  # (M, k, r, nv) derivatives for v / `velocity_scale`
    numbers: Array  # (M, k, r, n) derivatives for the unknowns, relative to their sizes


class BatchedStarts:
    """Starts that are fitted together.

    Attributes:
        x: (M, n) unknowns.
        samples: configurations by goal, those (M k, .) of the first start first.
        cost: (M,) sum of squares of loop and goal errors.
    """

    def __init__(self, problem: DesignSpace, x: Array, rng: np.random.Generator) -> None:
        self._p, self.x = problem, x
        state, mechanism, m = problem.nominal(), problem.mechanism, len(x)
        self._counts = [s.goal.count for s in problem.inner_problems]
        self.samples = []
        for inner, own, k in zip(problem.inner_problems, problem.own, self._counts, strict=True):
            some = GoalStates(spread(mechanism, state.q, m * k, rng),
                           np.repeat(state.angles[None], m * k, axis=0), np.tile(np.arange(k), m))
            self.samples.append(GoalStates.joined([
                inner.placed(some.taken(slice(i * k, i * k + k)), x[i, own])
                for i in range(m)]))
        values, self.samples = self._values(x, self.samples)
        self.cost = _cost(values)

    def fit(self) -> None:
        """Change all starts until each converges or meets its goals."""
        p, every = self._p, self._equations(np.arange(len(self.x)))

        def tries(
            rows: NDArray[np.intp], damping: Array
        ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
            damping = np.maximum(damping, LEAST_BATCH_DAMPING)
            steps, moved = _steps([StartEquations(*(part[rows] for part in e)) for e in every],
                                  damping)
            there = np.clip(self.x[rows] + p.sizes * steps, p.lower, p.upper)
            samples = []
            for s, k, part in zip(self.samples, self._counts, moved, strict=True):
                some = s.taken(_rows(rows, k))
                turned = part.reshape(len(some.q), -1) * p.mechanism.velocity_scale
                samples.append(some._replace(q=p.family.displaced(
                    some.q, np.ascontiguousarray(turned))))
            values, samples = self._values(there, samples)
            cost = _cost(values)
            better = cost < self.cost[rows]
            self.x[rows[better]], self.cost[rows[better]] = there[better], cost[better]
            for old, k, new in zip(self.samples, self._counts, samples, strict=True):
                at, where = _rows(rows[better], k), np.repeat(better, k)
                old.q[at], old.angles[at] = new.q[where], new.angles[where]
            if better.any():
                for e, fresh in zip(every, self._equations(rows[better]), strict=True):
                    for part, renewed in zip(e, fresh, strict=True):
                        part[rows[better]] = renewed
            return better, self.cost[rows] < TOLERANCES.tight**2

        levenberg(tries, np.flatnonzero(np.isfinite(self.cost)), first=BATCH_DAMPING,
                  easing=BATCH_EASING, hardening=BATCH_HARDENING, least=LEAST_BATCH_DAMPING,
                  most=BATCH_STEPS)

    def best(self) -> list[int]:
        """Return distinct starts that meet their goals; else the best one.

        A few nearly met ones are included: they converge slowly.
        """
        cost = np.where(self.cost < MET, 0.0, self.cost)
        chosen = list[int]()
        for i in np.argsort(cost, kind="stable").tolist():
            apart = np.abs(self.x[chosen] - self.x[i]) / self._p.sizes
            is_new = bool(np.all(apart.max(axis=1, initial=0.0) > TOGETHER))
            n_near = sum(cost[j] > 0.0 for j in chosen)
            if is_new and (cost[i] == 0.0 or not chosen or (
                    cost[i] < NEAR and n_near < MOST_NEAR)):
                chosen.append(i)
        return chosen

    def of(self, i: int) -> list[GoalStates]:
        """Return the configurations of a start by goal."""
        return [s.taken(slice(i * k, i * k + k))
                for s, k in zip(self.samples, self._counts, strict=True)]

    def _values(self, x: Array, samples: list[GoalStates]) -> tuple[list[Array], list[GoalStates]]:
        """Return residuals (m, k, r) by goal at unknowns (m, n), and configurations."""
        self._p.tried += len(x)
        members = self._p.family.batch(x[:, : self._p.n].T)
        residuals, there = [], []
        for inner, own, k, some in zip(
                self._p.inner_problems, self._p.own, self._counts, samples, strict=True):
            each = members.taken(np.repeat(np.arange(len(x)), k))
            values, angles = _all(inner.equations, each, some, x[:, own], k)
            values = values.reshape(len(x), k, -1)
            values[~members.holds] = np.inf
            residuals.append(values)
            there.append(some._replace(angles=angles))
        return residuals, there

    def _equations(self, rows: NDArray[np.intp]) -> list[StartEquations]:
        p, x, n = self._p, self.x[rows], self._p.n
        sizes = p.sizes[:n]
        ahead = np.repeat(x[:, :n], n + 1, axis=0).reshape(len(x), n + 1, n)
        inward = np.where(x[:, :n] + AHEAD * sizes > p.upper[:n], -AHEAD, AHEAD)
        ahead[:, np.arange(1, n + 1), np.arange(n)] += inward * sizes
        members = p.family.batch(ahead.reshape(-1, n).T)
        here = np.arange(len(x)) * (n + 1)
        around = (here[:, None] + np.arange(1, n + 1)).ravel()
        equations = []
        for inner, own, k, every_one in zip(
                p.inner_problems, p.own, self._counts, self.samples, strict=True):
            some = every_one.taken(_rows(rows, k))
            value, moves, by_own = _all(
                lambda *a, s=inner: s.rows(*a)[0].together(1.0),
                members.taken(np.repeat(here, k)), some, x[:, own], k)
            value = value.reshape(len(x), k, -1)
            every = (np.arange(len(x))[:, None, None] * k + np.zeros((n, 1), np.intp)
                     + np.arange(k)).ravel()
            shifted, _ = _all(inner.equations, members.taken(np.repeat(around, k)),
                             some.taken(every), x[:, own], n * k)
            rise = shifted.reshape(len(x), n, k, -1) - value[:, None]
            numbers = np.zeros((*value.shape, len(p.names)))
            numbers[..., :n] = (rise / inward[:, :, None, None]).transpose(0, 2, 3, 1)
            numbers[..., own] = by_own.reshape(*value.shape, -1)
            equations.append(StartEquations(value, moves.reshape(*value.shape, -1), numbers))
        rise = sum(np.einsum("mkrn,mkr->mn", e.numbers, e.value) for e in equations)
        held = ((x <= p.lower) & (rise > 0.0)) | ((x >= p.upper) & (rise < 0.0))
        return [e._replace(numbers=np.where(held[:, None, None], 0.0, e.numbers))
                for e in equations]


def _cost(values: list[Array]) -> Array:
    total = sum(np.einsum("mkr,mkr->m", v, v) for v in values)
    return np.where(np.isfinite(total), total, np.inf)


def _steps(equations: list[StartEquations], damping: Array) -> tuple[Array, list[Array]]:
    """Return Levenberg steps (m, n) of the unknowns, and (m, k, nv) of configurations by goal.

    The configurations are eliminated by the Schur complement. The longest component is one at most.
    """
    n = equations[0].numbers.shape[-1]
    square = damping[:, None, None] * np.eye(n)
    right = np.zeros((len(damping), n))
    eliminated = []
    for e in equations:
        back = e.moves.transpose(0, 1, 3, 2)
        own = back @ e.moves + damping[:, None, None, None] * np.eye(e.moves.shape[-1])
        both = np.concatenate([back @ e.numbers, back @ e.value[..., None]], axis=-1)
        along = np.linalg.solve(own, both)
        rest = np.concatenate([e.numbers, e.value[..., None]], axis=-1)
        schur = np.einsum("mkri,mkrj->mij", e.numbers, rest) - np.einsum(
            "mkvi,mkvj->mij", both[..., :n], along)
        square, right = square + schur[..., :n], right + schur[..., n]
        eliminated.append(along)
    steps = -np.linalg.solve(square, right[..., None])[..., 0]
    moved = [-a[..., n] - np.einsum("mkvi,mi->mkv", a[..., :n], steps) for a in eliminated]
    longest = np.max([np.abs(steps).max(axis=1, initial=0.0),
                      *(np.abs(x).max(axis=(1, 2), initial=0.0) for x in moved)], axis=0)
    shorter = 1.0 / np.maximum(longest, TOLERANCES.longest_step)
    return steps * shorter[:, None], [x * shorter[:, None, None] for x in moved]


def _all(
    work: Callable[[DimensionBatch, GoalStates, Array], Sequence[Array]], members: DimensionBatch,
    samples: GoalStates, own: Array, k: int,
) -> list[Array]:
    """Return the results of a function for configurations, k for each row of own (m, n_own)."""
    if not own.shape[1]:
        return list(work(members, samples, np.empty(0)))
    parts = [work(members.taken(np.arange(i * k, i * k + k)), samples.taken(
        slice(i * k, i * k + k)), numbers) for i, numbers in enumerate(own)]
    return [np.concatenate(part) for part in zip(*parts, strict=True)]


def _rows(starts: NDArray[np.intp], k: int) -> NDArray[np.intp]:
    """Return the places of the configurations of starts, k for each."""
    return (starts[:, None] * k + np.arange(k)).ravel()
