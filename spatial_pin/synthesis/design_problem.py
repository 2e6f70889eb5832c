"""A problem of dimensional synthesis and its local solutions.

Dimensions and configurations are fitted together: first with penalised open loops, the penalty
growing, at last with closed loops. Exact goals beside goals with a weight are met by augmented
Lagrangians [Hestenes1969; Powell1969].
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.state import State
from spatial_pin.dimensions.variants import STEP
from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.least_squares import LeastSquares, minimised
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.demand import Candidate, Demand
from spatial_pin.synthesis.design_space import BATCH, WEIGHTS, DesignSpace, Guess, weight_of
from spatial_pin.synthesis.inner_problem import GoalStates
from spatial_pin.synthesis.multistart import BatchedStarts
from spatial_pin.synthesis.precision import Goal

LOOSE_EVALUATIONS = 50  # for each penalty of open loops: about 20 are usual
EXACT_EVALUATIONS = 200  # with closed loops: 10 are usual, 100 along curved valleys
LOOSE_GAIN = 1e-4  # relative decrease of the cost in a step below which the next penalty follows
FIRST_PENALTY = 100.0  # weight² of exact goals beside others, whose weights are about 1
MOST_PENALTIES = 12  # updates of the multipliers: each gains about a factor of the penalty
IDLE_PENALTIES = 3  # updates without halving the error after which exact goals cannot be met
# Longest step with demands, in widths of bounds. Met demands have no gradient, and a long step can
# leave a design whose driver turns fully.
DEMANDED_STEP = 0.1
OPEN = "the loops do not close"


@dataclass(frozen=True, eq=False)
class LocalSolution:
    """A local solution."""

    x: Array  # (n,) unknowns, dimensions first
    # sum of squares of weighted residuals, exact goals excepted; infinite without a solution
    cost: float
    hard: float  # largest residual of exact goals
    samples: tuple[GoalStates, ...]  # configurations of every goal of precision
    evaluations: int = 0  # sets of dimensions tried
    why: str = ""  # error message if nothing closes or a demand cannot be judged
    others: tuple[LocalSolution, ...] = ()  # other solutions from the same start

    @property
    def is_one(self) -> bool:
        """Whether the exact goals are met."""
        return bool(np.isfinite(self.cost)) and self.hard <= TOLERANCES.nothing


@dataclass(frozen=True, eq=False)
class ProblemSpec:
    """The data of a problem, which can be sent to other processes."""

    path: Any  # the mechanism's file, and its parameters
    loading: Mapping[str, Any]
    goals: tuple[Goal, ...]
    bounds: Mapping[str, tuple[float, float]]  # by dimension, infinite if there are none
    # branch of the first start, as for `assemble`; or q (nq,) and screw angles of its closed state
    guess: Guess | tuple[Array, Array] = None

    def make(self) -> DesignProblem:
        """Return the problem."""
        from spatial_pin.formats.files import load

        mechanism, guess = load(self.path, **self.loading), self.guess
        if isinstance(guess, tuple):
            guess = State(mechanism, guess[0], closure_error=np.nan, angles=guess[1])
        return DesignProblem(mechanism, self.goals, self.bounds, guess)


class DesignProblem(DesignSpace):
    """A synthesis problem with its local solver."""

    def solve_from(
        self, x: Array, near: list[GoalStates], weights: Sequence[float]
    ) -> LocalSolution:
        """Return the local solution near configurations, with penalties of open loops."""
        before, here = self.tried, x
        try:
            for weight in weights if self.inner_problems else ():
                here, near = LooseFit(self, near, weight).solved(here)
            solution = ExactFit(self, near, here).solution()
        except SpatialPinError as error:  # nothing closes there, or a demand cannot be judged
            solution = LocalSolution(x, np.inf, np.inf, (), 0, str(error))
        return replace(solution, evaluations=self.tried - before)

    def solve(self, x: Array, rng: np.random.Generator | None = None) -> LocalSolution:
        """Return the local solution from a start: random configurations, or those of the guess.

        If all goals are exact and missed, a batch of random starts is fitted together. The result
        is then the first of their distinct solutions, with the others.
        """
        before = self.tried
        try:
            near = self.start_states(x, rng)
        except SpatialPinError as error:
            return LocalSolution(x, np.inf, np.inf, (), 0, str(error))
        if rng is None:
            return self.solve_from(x, near, WEIGHTS)
        solution = self.solve_from(x, near, WEIGHTS[rng.integers(2) :])
        exact = [s.goal.weight is None for s in self.inner_problems]
        if solution.is_one or not any(exact) or not all(exact):
            return solution
        starts = BatchedStarts(self, np.array([self.draw(rng) for _ in range(BATCH)]), rng)
        starts.fit()
        tried = [self.solve_from(starts.x[i], starts.of(i), ()) for i in starts.best()]
        good = [one for one in tried if one.is_one]
        first = good[0] if good else min([solution, *tried], key=lambda one: one.hard)
        return replace(first, others=tuple(good[1:]), evaluations=self.tried - before)

    def value(self, x: Array) -> float:
        """Return the cost at x with penalised open loops, from the nominal state.

        Demands count if there is no goal of precision.
        """
        members, total = self.members(x), 0.0
        if not members.holds.all():
            return np.inf
        for inner, samples, own in zip(self.inner_problems, self.start_states(x, None),
                                       self.own, strict=True):
            residual = inner.loose_residual(members, samples, x[own], WEIGHTS[-1])
            total += float(np.sum(residual**2)) * weight_of(inner.goal) ** 2
        if not self.inner_problems:
            candidate = Candidate.of(self.family, x[: self.n], self.nominal(), [])
            for demand in self.demands:
                values = demand.values(candidate)
                missed = np.maximum(values, 0.0) if demand.is_one_sided else values
                total += float(np.sum(missed**2)) * weight_of(demand) ** 2
        return total


class LocalFit(LeastSquares):
    """A fit of the unknowns of a problem, between their bounds.

    Attributes:
        near: configurations by goal, from which those at other unknowns are found.
    """

    bends, tolerance = False, TOLERANCES.last_digit

    def __init__(self, problem: DesignSpace, near: list[GoalStates]) -> None:
        self.p, self.near = problem, near
        self.parts = list(zip(problem.inner_problems, problem.own, strict=True))
        self.moves, self.sizes = np.ones(len(problem.sizes), dtype=bool), problem.sizes
        self.ends = np.stack([problem.lower, problem.upper])
        if problem.demands:
            self.longest = DEMANDED_STEP

    @abstractmethod
    def slopes(self, x: Array) -> Array:
        """Return the derivatives of the residuals; later configurations are found from here."""

    def jacobian(self, x: Array) -> Array:
        """See `LeastSquares`."""
        return self.slopes(x) * self.sizes

    def columns(self, own: slice, slopes: Array) -> Array:
        """Return derivatives (k r, n) for all unknowns, from (k, r, .) for those of a goal."""
        n, out = self.p.n, np.zeros((slopes.shape[0] * slopes.shape[1], len(self.p.names)))
        flat = slopes.reshape(len(out), -1)
        out[:, :n], out[:, own] = flat[:, :n], flat[:, n:]
        return out


class LooseFit(LocalFit):
    """The fit with a penalty of open loops."""

    most, gain = LOOSE_EVALUATIONS, LOOSE_GAIN

    def __init__(self, problem: DesignSpace, near: list[GoalStates], weight: float) -> None:
        super().__init__(problem, near)
        self._weights = [weight_of(inner.goal) for inner in problem.inner_problems]
        self._penalties = [weight / own for own in self._weights]
        self._last: tuple[bytes, list[GoalStates]] = b"", []

    def _states(self, x: Array) -> list[GoalStates]:
        """Return the best configurations at x by goal."""
        if self._last[0] != x.tobytes():
            self.p.tried += 1
            members = self.p.members(x)
            self._last = x.tobytes(), [
                inner.loosely(members, near, x[own], penalty) for (inner, own), near, penalty in
                zip(self.parts, self.near, self._penalties, strict=True)]
        return self._last[1]

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`."""
        members = self.p.members(x)
        if not members.holds.all():
            return np.array([np.inf])
        return np.concatenate([
            (weight * inner.loose_residual(members, states, x[own], penalty)).ravel()
            for (inner, own), states, weight, penalty in zip(
                self.parts, self._states(x), self._weights, self._penalties, strict=True)])

    def slopes(self, x: Array) -> Array:
        """See `LocalFit`."""
        self.near = self._states(x)
        members, (around, widths) = self.p.members(x), self.p.around(x)
        return np.concatenate([
            weight * self.columns(own, inner.loose_slopes(
                members, around, widths, states, x[own], penalty))
            for (inner, own), states, weight, penalty in zip(
                self.parts, self.near, self._weights, self._penalties, strict=True)])

    def solved(self, x: Array) -> tuple[Array, list[GoalStates]]:
        """Return x with the least sum of penalised open loops and goal errors, and its states."""
        x = minimised(self, x, {}).at.x
        return x, self._states(x)


class ExactFit(LocalFit):
    """The fit with closed loops, from x (n,).

    Residuals are those of goals of precision, then of demands. An exact residual r adds
    penalty r² / 2 + multiplier r to the cost. Demands are inequalities r <= 0.
    """

    most = EXACT_EVALUATIONS

    def __init__(self, problem: DesignSpace, near: list[GoalStates], x: Array) -> None:
        super().__init__(problem, near)
        self.x = x
        self._last: tuple[bytes, tuple[list[GoalStates], Array] | None] = b"", None
        self._counts: list[int] = []
        self._state = problem.nominal()  # where the mechanisms of demands are followed from
        self._why = ""  # the last configurations were none
        if self._at(x) is None:
            raise SpatialPinError(self._why)
        goals = [inner.goal for inner in problem.inner_problems]
        every = [*goals, *self.p.demands]
        repeats = [g.count * g.width for g in goals] + self._counts
        self.weights = np.repeat([weight_of(g) for g in every], repeats)
        self.exact = np.repeat([g.weight is None for g in every], repeats).astype(bool)
        self.one_sided = np.repeat([isinstance(g, Demand) and g.is_one_sided for g in every],
                                   repeats).astype(bool)
        self.multipliers = np.zeros(len(self.weights))
        self.penalty = FIRST_PENALTY if (~self.exact).any() else 1.0

    def _at(self, x: Array) -> tuple[list[GoalStates], Array] | None:
        """Return configurations and residuals of x; None if loops do not close."""
        if self._last[0] != x.tobytes():
            self._last = x.tobytes(), self._evaluated(x)
        return self._last[1]

    def _evaluated(self, x: Array) -> tuple[list[GoalStates], Array] | None:
        p, samples, residuals = self.p, list[GoalStates](), list[Array]()
        p.tried += 1
        members = p.members(x)
        if not members.holds.all():
            self._why = OPEN
            return None
        for (inner, own), near in zip(self.parts, self.near, strict=True):
            there, residual, is_closed = inner.exactly(members, near, x[own])
            if not is_closed.all():
                self._why = OPEN
                return None
            samples.append(there)
            residuals.append(residual.ravel())
        demanded: list[Array] = []
        try:
            if p.demands:
                candidate = Candidate.of(p.family, x[: p.n], self._state, samples)
                self._state = candidate.states[0]
                demanded = [demand.values(candidate) for demand in p.demands]
        except SpatialPinError as error:
            self._why = str(error)
            return None
        counts = [len(values) for values in demanded]
        self._counts = self._counts or counts
        if counts != self._counts:  # links that have no shape there, say
            return None
        return samples, np.concatenate([np.empty(0), *residuals, *demanded])

    def _shaped(self, raw: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the residuals of the least-squares problem, and which are active."""
        shifted = raw + np.where(self.exact, self.multipliers / self.penalty, 0.0)
        counts = ~self.one_sided | (shifted > 0.0)
        factor = np.where(self.exact, np.sqrt(self.penalty), self.weights)
        return np.where(counts, factor * shifted, 0.0), counts

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`; infinite if loops do not close."""
        here = self._at(x)
        return np.full(len(self.weights), np.inf) if here is None else self._shaped(here[1])[0]

    def slopes(self, x: Array) -> Array:
        """See `LocalFit`; those of demands by differences of closed configurations."""
        here = self._at(x)
        assert here is not None
        (samples, raw), first = here, len(here[1]) - sum(self._counts)
        self.near, members, (around, widths) = samples, self.p.members(x), self.p.around(x)
        rows = [self.columns(own, s.slopes(members, around, widths, at, x[own]))
                for (s, own), at in zip(self.parts, samples, strict=True)]
        columns = []
        for i, step in enumerate(STEP * self.p.sizes if self.p.demands else ()):
            there = step * np.eye(len(x))[i]
            ends = [(sign * step, self._evaluated(x + sign * there)) for sign in (1.0, -1.0)]
            known = [(at, end[1][first:]) for at, end in ends if end is not None]
            if not known:
                raise SpatialPinError("the loops open next to these dimensions")
            (at, ahead), (back, behind) = known[0], (
                known[1] if len(known) > 1 else (0.0, raw[first:]))
            columns.append((ahead - behind) / (at - back))
        rows += [np.array(columns).T] if self.p.demands else []
        factor = np.where(self.exact, np.sqrt(self.penalty), self.weights) * self._shaped(raw)[1]
        return np.concatenate([np.empty((0, len(x))), *rows]) * factor[:, None]

    def solution(self) -> LocalSolution:
        """Return the solution.

        If all goals are exact, a first fit with a coarse tolerance drops starts with slow
        convergence; only a good one is refined.
        """
        if self.penalty > 1.0:
            samples, raw = self._weighed()
        else:
            samples, raw = self._fitted(LOOSE_GAIN)
            missed = np.where(self.one_sided, np.maximum(raw, 0.0), raw)
            if np.abs(missed).max(initial=0.0) <= TOLERANCES.half_precision:
                samples, raw = self._fitted(TOLERANCES.tight)
        missed = np.where(self.one_sided, np.maximum(raw, 0.0), raw)
        cost = float(np.sum((self.weights * missed)[~self.exact] ** 2))
        return LocalSolution(self.x, cost, float(np.abs(missed[self.exact]).max(initial=0.0)),
                             tuple(samples))

    def _fitted(self, gain: float) -> tuple[list[GoalStates], Array]:
        self.gain = gain
        self.x = minimised(self, self.x, {}).at.x
        here = self._at(self.x)
        if here is None:
            raise SpatialPinError(self._why)
        return here

    def _weighed(self) -> tuple[list[GoalStates], Array]:
        """Return the fit by augmented Lagrangians, for exact and weighted goals together."""
        misses = [np.inf] * IDLE_PENALTIES
        for _ in range(MOST_PENALTIES):
            here = self._fitted(TOLERANCES.tight)
            least = -self.multipliers / self.penalty
            missed = np.where(self.one_sided, np.maximum(here[1], least), here[1])[self.exact]
            misses.append(float(np.abs(missed).max(initial=0.0)))
            if misses[-1] <= TOLERANCES.tight or misses[-1] > 0.5 * misses[-1 - IDLE_PENALTIES]:
                break
            self.multipliers[self.exact] += self.penalty * missed
            self.penalty *= 4.0
        return here
