"""One problem of dimensional synthesis, and its local solutions.

From a start, dimensions and configurations are fitted together: first loosely, open loops being
weighed against missed goals, then ever more closed, at last exactly, by SciPy's trust region. Goals
that are to be met exactly, beside others that are met as well as can be, are kept by augmented
Lagrangians [Hestenes1969; Powell1969].
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.dimension_batch import DimensionBatch, DimensionFamily, EvaluatedBatch
from spatial_pin.dimensions.predictions import STEP
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.candidate import Candidate
from spatial_pin.synthesis.demand import Demand, MotionDemand
from spatial_pin.synthesis.inner_problem import GoalStates, InnerProblem, spread
from spatial_pin.synthesis.multistart import BatchedStarts
from spatial_pin.synthesis.precision import Goal, Precision

# Weights of open loops relative to missed goals, one after the other: what is left open at last is
# a ten-thousandth of what is missed, from which exact closing goes on. Drawn starts begin with the
# first or the second: either leads to solutions, of other problems, that the other one misses.
WEIGHTS = (1.0, 10.0, 100.0)
LOOSE_EVALUATIONS = 50  # of each of these: some twenty are usual
EXACT_EVALUATIONS = 200  # of exact ones: ten are usual, a hundred along curved valleys
LOOSE_GAIN = 1e-4  # of the cost in a step, at which the next weight is gone on to
FIRST_PENALTY = 100.0  # weight² of exact goals beside others, which have about one
MOST_PENALTIES = 12  # rounds of multipliers: each gains a factor of the penalty as a rule
IDLE_PENALTIES = 3  # rounds that do not halve what is missed: it cannot be met
FIRST_GAIN = 1e-6  # of the cost in a step, at which numbers close to bounds are put there
NEAR_BOUND = 1e-3  # part of the width of the bounds: a trust region of interior points ends as far
START_MARGIN = 1e-9  # likewise: SciPy wants starts inside of the bounds
CROWD = 32  # starts that are fitted together: more cost as much each
DRAWN_TRIES = 8  # configurations that a drawn start is looked for from


Guess = Mapping[str, Any] | State | Array | None
OfNumbers = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class LocalSolution:
    """A local solution.

    Attributes:
        x: (n,) the numbers that are looked for, dimensions first.
        cost: sum of squares of weighted residuals of goals with a weight; infinite if no solution
            was found from that start.
        hard: the largest residual of goals that are to be met exactly.
        samples: configurations of every goal of precision.
        evaluations: sets of dimensions that were tried.
        why: what was said where nothing closes, or a demand cannot be judged.
        others: further solutions from the same start.
    """

    x: Array
    cost: float
    hard: float
    samples: tuple[GoalStates, ...]
    evaluations: int
    why: str = ""
    others: tuple[LocalSolution, ...] = ()

    @property
    def is_one(self) -> bool:
        """Whether it is a solution: exact goals are met."""
        return bool(np.isfinite(self.cost)) and self.hard <= TOLERANCES.nothing


@dataclass(frozen=True, eq=False)
class ProblemSpec:
    """What a problem is made of; it can be sent to other processes.

    Attributes:
        path, loading: the mechanism's file, and what it was loaded with.
        goals: what it should do.
        bounds: by dimension, infinite where there are none.
        guess: which branch the first start is on, as for `assemble`; or q (nq,) and angles of
            screws of its closed state.
    """

    path: Any
    loading: Mapping[str, Any]
    goals: tuple[Goal, ...]
    bounds: Mapping[str, tuple[float, float]]
    guess: Guess | tuple[Array, Array] = None

    def make(self) -> DesignProblem:
        """Return the problem."""
        from spatial_pin.formats.files import load

        mechanism, guess = load(self.path, **self.loading), self.guess
        if isinstance(guess, tuple):
            guess = State(mechanism, guess[0], closure_error=np.nan, angles=guess[1])
        return DesignProblem(mechanism, self.goals, self.bounds, guess)


class DesignProblem:
    """Dimensions with which a mechanism meets goals.

    Args:
        mechanism: at the dimensions of the first start.
        goals: what it should do.
        bounds: by dimension that may change, infinite where there are none.
        guess: which branch the first start is on, as for `assemble`.

    Attributes:
        names: of the numbers that are looked for: dimensions, then numbers of the goals.
        lower, upper: (n,) their bounds.
        start: (n,) where the first start is.
        settlings: of the goals of precision; own: which numbers are their own.
        demands: the other goals.
    """

    def __init__(
        self, mechanism: Mechanism, goals: Sequence[Goal],
        bounds: Mapping[str, tuple[float, float]], guess: Guess = None,
    ) -> None:
        self.mechanism, self.goals = mechanism, tuple(goals)
        self.family = DimensionFamily(mechanism, bounds)
        self.settlings = [InnerProblem(self.family, g) for g in goals if isinstance(g, Precision)]
        self.demands = [g for g in goals if isinstance(g, Demand)]
        self._guess = guess
        self._nominal: State | None = None
        self._last: tuple[bytes, tuple[DimensionBatch, DimensionBatch]] | None = None
        own = [f"{s.goal.name}: {name}" for s in self.settlings for name in s.names]
        self.n = len(bounds)
        self.names = (*bounds, *own)
        low, high = np.array([*bounds.values()], dtype=float).reshape(-1, 2).T
        free = np.full(len(own), np.inf)
        self.lower, self.upper = np.concatenate([low, -free]), np.concatenate([high, free])
        first = [x for s in self.settlings for x in s.own_start()]
        self.start = np.array([*(mechanism.dimensions[name] for name in bounds), *first])
        self.start[: self.n] = np.clip(self.start[: self.n], low, high)
        length = mechanism.characteristic_length
        widths = np.where(np.isfinite(high - low), high - low,
                          np.maximum(np.abs(self.start[: self.n]), min(length, 1.0)))
        self.sizes = np.concatenate([widths, np.ones(len(own))])
        ends = np.cumsum([self.n, *(len(s.names) for s in self.settlings)])
        self.own = [slice(*x) for x in itertools.pairwise(ends.tolist())]

    # ------------------------------------------------------------ starts

    def draw(self, rng: np.random.Generator) -> Array:
        """Return a start (n,): dimensions anywhere between their bounds, goals placed anywhere.

        Dimensions without bounds are within half and twice their own values, those with one are
        half to twice as far from it as they are; where that is nothing, up to their size away.
        """
        x = self.start.copy()
        x[: self.n] = self._between(rng.uniform(size=self.n))
        for settling, own in zip(self.settlings, self.own, strict=True):
            x[own] += [_drawn(name, rng) for name in settling.names]
        return x

    def _between(self, part: Array) -> Array:
        """Return dimensions (n,) at parts (n,) from 0 to 1 of where they are drawn."""
        low, high, size = self.lower[: self.n], self.upper[: self.n], self.sizes[: self.n]
        bound = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high, 0.0))
        away = self.start[: self.n] - bound
        inward = np.where(np.isfinite(low), part, np.where(np.isfinite(high), -part,
                                                           2.0 * part - 1.0))
        free = bound + np.where(away != 0.0, away * 2.0 ** (2.0 * part - 1.0), size * inward)
        with np.errstate(invalid="ignore"):
            inside = low + part * (high - low)
        return np.clip(np.where(np.isfinite(high - low), inside, free), low, high)

    def anywhere(self) -> EvaluatedBatch:
        """Return mechanisms at dimensions and configurations drawn anywhere, their loops open."""
        rng = np.random.default_rng(0)
        x = np.array([self._between(rng.uniform(size=self.n)) for _ in range(CROWD)]).T
        members = self.family.at(x)
        members = members.taken(np.flatnonzero(members.holds))
        state = self.nominal()
        q = spread(self.mechanism, state.q, len(members.holds), rng)
        return self.family.bodies(members, q, np.repeat(state.angles[None], len(q), axis=0))

    def nominal(self) -> State:
        """Return the closed state at the mechanism's own dimensions, or one next to a singular one.

        Raises:
            AssemblyError: it does not close.
        """
        if self._nominal is None:
            moved = [d.moved_by(self.mechanism) for d in self.demands
                     if isinstance(d, MotionDemand)]
            self._nominal = _beside(assembled(self.mechanism, {}, self._guess), moved)
        return self._nominal

    def begun(self, x: Array, rng: np.random.Generator | None) -> list[GoalStates]:
        """Return configurations to start from, each sample from the one before.

        Args:
            x: dimensions and own numbers.
            rng: None: from the closed state; else from the best of some that are drawn.
        """
        members, found = self.members(x), []
        state = self.nominal()
        for settling, own in zip(self.settlings, self.own, strict=True):
            k = 1 if rng is None else DRAWN_TRIES
            q = (state.q[None] if rng is None else
                 np.concatenate([state.q[None], spread(self.mechanism, state.q, k - 1, rng)]))
            tries = GoalStates(
                q, np.repeat(state.angles[None], k, axis=0), np.zeros(k, dtype=np.intp))
            last = self._best(settling, members, tries, x[own])
            chain = [last]
            for i in range(1, settling.goal.count):
                last = self._best(settling, members, last._replace(at=np.array([i])), x[own])
                chain.append(last)
            found.append(GoalStates.joined(chain))
        return found

    @staticmethod
    def _best(
        settling: InnerProblem, members: DimensionBatch, tries: GoalStates, own: Array
    ) -> GoalStates:
        """Return that of some configurations from which the goal is met best."""
        settled = settling.loosely(members, settling.placed(tries, own), own, WEIGHTS[0])
        left = settling.loose_residual(members, settled, own, WEIGHTS[0])
        best = int(np.argmin(np.einsum("mi,mi->m", left, left)))
        return settled.taken(slice(best, best + 1))

    def members(self, x: Array) -> DimensionBatch:
        """Return the mechanism of x."""
        return self._together(x)[0]

    def around(self, x: Array) -> tuple[DimensionBatch, Array]:
        """Return mechanisms ahead of and behind each dimension, and the widths between (n,)."""
        steps = STEP * self.sizes[: self.n]
        return self._together(x)[1], (x[: self.n] + steps) - (x[: self.n] - steps)

    def _together(self, x: Array) -> tuple[DimensionBatch, DimensionBatch]:
        """Return the mechanism of x and those around it; the last ones are kept.

        Many cost little more than one.
        """
        here = x[: self.n, None]
        if self._last is None or self._last[0] != here.tobytes():
            steps = np.diag(STEP * self.sizes[: self.n])
            every = self.family.at(np.concatenate([here, here + steps, here - steps], axis=1))
            self._last = here.tobytes(), (every.taken(np.array([0])),
                                          every.taken(np.arange(1, 2 * self.n + 1)))
        return self._last[1]

    # ------------------------------------------------------------ solutions

    def value(self, x: Array) -> float:
        """Return the loose cost at x, from the closed state: for a global search.

        Demands count where there are no goals of precision.
        """
        members = self.members(x)
        if not members.holds.all():
            return np.inf
        total = 0.0
        for settling, samples, own in zip(self.settlings, self.begun(x, None), self.own,
                                          strict=True):
            left = settling.loose_residual(members, samples, x[own], WEIGHTS[-1])
            total += float(np.sum(left**2)) * _size(settling.goal) ** 2
        if not self.settlings:
            candidate = self.candidate(x, [])
            for demand in self.demands:
                left = demand.values(candidate)
                missed = np.maximum(left, 0.0) if demand.is_one_sided else left
                total += float(np.sum(missed**2)) * _size(demand) ** 2
        return total

    def candidate(
        self, x: Array, samples: Sequence[GoalStates], near: State | None = None
    ) -> Candidate:
        """Return the mechanism of x with closed configurations, for demands."""
        return Candidate.of(self.family, x[: self.n], near or self.nominal(), samples)

    def solve_from(
        self, x: Array, near: list[GoalStates], weights: Sequence[float]
    ) -> LocalSolution:
        """Return the local solution from configurations.

        Args:
            x: (n,) dimensions and own numbers.
            near: configurations of each goal of precision.
            weights: of open loops, one after the other; none where loops are closed.
        """
        fit = LocalFit(self)
        try:
            return fit.solved(x, near, weights)
        except SpatialPinError as error:  # nothing closes there, or a demand cannot be judged
            return LocalSolution(x, np.inf, np.inf, (), fit.evaluations, str(error))

    def solve(self, x: Array, rng: np.random.Generator | None = None) -> LocalSolution:
        """Return the local solution from a start; where it misses exact goals, those of a crowd.

        Args:
            x: (n,) dimensions and own numbers.
            rng: None: from the closed state of the guess; else configurations are drawn too.
        """
        try:
            near = self.begun(x, rng)
        except SpatialPinError as error:
            return LocalSolution(x, np.inf, np.inf, (), 0, str(error))
        if rng is None:
            return self.solve_from(x, near, WEIGHTS)
        found = self.solve_from(x, near, WEIGHTS[rng.integers(2) :])
        exact = [s.goal.weight is None for s in self.settlings]
        return self._best_of_crowd(found, rng) if any(exact) and all(
            exact) and not found.is_one else found

    def _best_of_crowd(self, missed: LocalSolution, rng: np.random.Generator) -> LocalSolution:
        """Return the distinct solutions of a crowd, the first with the others, or what missed."""
        crowd = BatchedStarts(self, np.array([self.draw(rng) for _ in range(CROWD)]), rng)
        crowd.fit()
        tried = [self.solve_from(crowd.x[i], crowd.of(i), ()) for i in crowd.best()]
        good = [one for one in tried if one.is_one]
        first = good[0] if good else min([missed, *tried], key=lambda one: one.hard)
        evaluations = crowd.evaluations + sum(one.evaluations for one in (missed, *tried))
        return replace(first, others=tuple(good[1:]), evaluations=evaluations)


def _beside(state: State, drivers: Sequence[str]) -> State:
    """Return a closed state, or, if branches cross there, one on a branch that drivers lead along.

    Dimensions that are changed leave such a place: from it no motion is followed, and none that
    begins at other dimensions.
    """
    for name in drivers:
        driver = state.mechanism.driven_coordinate(name)
        own = state.coordinate(driver.name).value
        try:
            sweep(state.mechanism, name, [own], guess=state)
        except SpatialPinError:
            size = TOLERANCES.moved * state.mechanism.velocity_scale[driver.v]
            for value in (own + size, own - size):
                with suppress(SpatialPinError):
                    return assembled(state.mechanism, {name: value}, state.q)
    return state


def _drawn(name: str, rng: np.random.Generator) -> float:
    """Return an own number: zeros and turns up to half a turn, shifts and sizes of about one."""
    if name == "scale" or name in ("placement.x", "placement.y", "placement.z"):
        return float(0.5 * rng.standard_normal())
    if name.startswith("placement.r"):
        return float(rng.uniform(-np.pi, np.pi) / np.sqrt(3.0))
    return float(rng.uniform(-np.pi, np.pi))


class LocalFit:
    """Fits the numbers of a problem from one start.

    Attributes:
        evaluations: sets of dimensions that were tried.

    Args:
        problem: what is asked for.
    """

    def __init__(self, problem: DesignProblem) -> None:
        self.p, self.evaluations = problem, 0
        self._near: list[GoalStates] = []
        self._parts = list(zip(problem.settlings, problem.own, strict=True))

    def solved(self, x: Array, near: list[GoalStates], weights: Sequence[float]) -> LocalSolution:
        """Return the solution from x and configurations nearby, by weights of open loops."""
        self._near = near
        if self._parts:
            for weight in weights:
                x, _ = self.loosely(x, self._near, weight)
        return _Exactly(self, x).found()

    def minimum(
        self, residual: OfNumbers, slopes: OfNumbers, x: Array, most: int, gain: float
    ) -> Array:
        """Return where the sum of squares is least, by SciPy's trust region.

        That keeps off the bounds, and comes near them slowly: numbers that it ends close to one are
        put there, and the others are fitted again.
        """
        p, every = self.p, np.ones(len(x), dtype=bool)
        first = self._descended(residual, slopes, x, every, most, max(gain, FIRST_GAIN))
        near = NEAR_BOUND * p.sizes
        x = np.where(first - p.lower < near, p.lower,
                     np.where(p.upper - first < near, p.upper, first))
        free = (x != p.lower) & (x != p.upper)
        if gain >= FIRST_GAIN or not np.isfinite(residual(x)).all():
            return first
        second = self._descended(residual, slopes, x, free, most, gain)
        squares = [float(np.sum(residual(there) ** 2)) for there in (first, second)]
        return second if squares[1] <= squares[0] else first

    def _descended(
        self, residual: OfNumbers, slopes: OfNumbers, x: Array, free: NDArray[np.bool_],
        most: int, gain: float,
    ) -> Array:
        """Return where the sum of squares is least, some numbers being free."""
        from scipy.optimize import least_squares  # takes a quarter of a second

        p, x = self.p, x.copy()
        if not free.any():
            return x
        low, high, size = p.lower[free], p.upper[free], p.sizes[free]

        def whole(part: Array) -> Array:
            there = x.copy()
            there[free] = part
            return there

        start = np.clip(x[free], low + START_MARGIN * size, high - START_MARGIN * size)
        if not np.isfinite(residual(whole(start))).all():
            return x  # loops that close at a bound open beside it
        found = least_squares(
            lambda part: residual(whole(part)), start, lambda part: slopes(whole(part))[:, free],
            bounds=(low, high), x_scale=size, ftol=gain, xtol=TOLERANCES.round_off,
            gtol=TOLERANCES.last_digit, max_nfev=most)
        return whole(found.x)

    # ------------------------------------------------------------ loosely

    def loosely(
        self, x: Array, near: list[GoalStates], weight: float
    ) -> tuple[Array, list[GoalStates]]:
        """Return where open loops and missed goals are least together, from x and configurations.

        Args:
            x: (n,) numbers.
            near: configurations of each goal of precision.
            weight: of open loops relative to missed goals.
        """
        p, self._near = self.p, near
        settled: dict[bytes, list[GoalStates]] = {}

        def at(x: Array) -> list[GoalStates]:
            if x.tobytes() not in settled:
                settled.clear()
                self.evaluations += 1
                members = p.members(x)
                settled[x.tobytes()] = [
                    s.loosely(members, near, x[own], weight / _size(s.goal))
                    for (s, own), near in zip(self._parts, self._near, strict=True)]
            return settled[x.tobytes()]

        def residual(x: Array) -> Array:
            members = p.members(x)
            if not members.holds.all():
                return np.full(n_rows, np.inf)
            return np.concatenate([
                (_size(s.goal) * s.loose_residual(members, samples, x[own],
                                                  weight / _size(s.goal))).ravel()
                for (s, own), samples in zip(self._parts, at(x), strict=True)])

        def slopes(x: Array) -> Array:
            self._near = at(x)
            members, (around, widths) = p.members(x), p.around(x)
            return np.concatenate([
                _size(s.goal) * self._columns(own, s.loose_slopes(
                    members, around, widths, samples, x[own], weight / _size(s.goal)))
                for (s, own), samples in zip(self._parts, self._near, strict=True)])

        n_rows = 0
        n_rows = len(residual(x))
        x = self.minimum(residual, slopes, x, LOOSE_EVALUATIONS, LOOSE_GAIN)
        self._near = at(x)
        return x, self._near

    def _columns(self, own: slice, slopes: Array) -> Array:
        """Return derivatives (k r, n) from those (k, r, .) for dimensions and own numbers."""
        n, out = self.p.n, np.zeros((slopes.shape[0] * slopes.shape[1], len(self.p.names)))
        flat = slopes.reshape(len(out), -1)
        out[:, :n], out[:, own] = flat[:, :n], flat[:, n:]
        return out

    # ------------------------------------------------------------ exactly

    def settle(self, x: Array) -> tuple[list[GoalStates], list[Array]] | None:
        """Return closed configurations of x and residuals; None where they do not close."""
        members = self.p.members(x)
        self.evaluations += 1
        if not members.holds.all():
            return None
        found, residuals = [], []
        for (settling, own), near in zip(self._parts, self._near, strict=True):
            samples, residual, is_closed = settling.exactly(members, near, x[own])
            if not is_closed.all():
                return None
            found.append(samples)
            residuals.append(residual)
        return found, residuals

    def goal_slopes(self, x: Array, samples: list[GoalStates]) -> list[Array]:
        """Return their derivatives, each (k r, n)."""
        self._near = samples
        members, (around, widths) = self.p.members(x), self.p.around(x)
        return [self._columns(own, s.slopes(members, around, widths, at, x[own]))
                for (s, own), at in zip(self._parts, samples, strict=True)]


def _size(goal: Goal) -> float:
    """Return the weight of a goal; one of those that are to be met exactly."""
    return 1.0 if goal.weight is None else goal.weight


class _Exactly:
    """The fit with closed loops: goals of precision, and what else is demanded.

    Residuals are those of goals of precision, then of demands. Of those that are to be exact, r,
    the sum of r² penalty / 2 + multiplier r belongs to what is made least; demands are inequalities
    r <= 0.
    """

    def __init__(self, fit: LocalFit, x: Array) -> None:
        self.fit, self.p, self.x = fit, fit.p, x
        self._memo: dict[bytes, tuple[list[GoalStates], Array] | None] = {}
        self._counts: list[int] = []
        self._state = fit.p.nominal()  # where the mechanisms of demands are followed from
        self._why = ""  # the last configurations were none
        first = self._at(x)
        if first is None:
            raise SpatialPinError(self._why)
        goals = [s.goal for s, _ in fit._parts]
        every = [*goals, *self.p.demands]
        repeats = [g.count * g.width for g in goals] + self._counts
        self.weights = np.repeat([_size(g) for g in every], repeats)
        self.exact = np.repeat([g.weight is None for g in every], repeats).astype(bool)
        self.one_sided = np.repeat([isinstance(g, Demand) and g.is_one_sided for g in every],
                                   repeats).astype(bool)
        self.multipliers = np.zeros(len(self.weights))
        self.penalty = FIRST_PENALTY if (~self.exact).any() else 1.0

    def _at(self, x: Array) -> tuple[list[GoalStates], Array] | None:
        """Return configurations and residuals of x; None where they do not close."""
        key = x.tobytes()
        if key not in self._memo:
            self._memo.clear()
            self._memo[key] = self._evaluated(x)
        return self._memo[key]

    def _evaluated(self, x: Array) -> tuple[list[GoalStates], Array] | None:
        found = self.fit.settle(x)
        if found is None:
            self._why = "the loops do not close"
            return None
        samples, residuals = found
        parts = [r.ravel() for r in residuals]
        try:
            demanded = self._demanded(x, samples)
        except SpatialPinError as error:
            self._why = str(error)
            return None
        counts = [len(values) for values in demanded]
        self._counts = self._counts or counts
        if counts != self._counts:  # links that have no shape there, say
            return None
        return samples, np.concatenate([np.empty(0), *parts, *demanded])

    def _demanded(self, x: Array, samples: list[GoalStates]) -> list[Array]:
        if not self.p.demands:
            return []
        candidate = self.p.candidate(x, samples, self._state)
        self._state = candidate.states[0]
        return [demand.values(candidate) for demand in self.p.demands]

    def _shaped(self, raw: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return what is squared, and which numbers count in it."""
        shifted = raw + np.where(self.exact, self.multipliers / self.penalty, 0.0)
        counts = ~self.one_sided | (shifted > 0.0)
        factor = np.where(self.exact, np.sqrt(self.penalty), self.weights)
        return np.where(counts, factor * shifted, 0.0), counts

    def residual(self, x: Array) -> Array:
        """Return what is squared; infinite where loops do not close."""
        found = self._at(x)
        return np.full(len(self.weights), np.inf) if found is None else self._shaped(found[1])[0]

    def slopes(self, x: Array) -> Array:
        """Return its derivatives."""
        found = self._at(x)
        assert found is not None
        samples, raw = found
        rows = [*self.fit.goal_slopes(x, samples), *self._demand_slopes(x, raw)]
        factor = np.where(self.exact, np.sqrt(self.penalty), self.weights) * self._shaped(raw)[1]
        return np.concatenate([np.empty((0, len(x))), *rows]) * factor[:, None]

    def _demand_slopes(self, x: Array, raw: Array) -> list[Array]:
        """Return derivatives of demands, by differences of closed configurations."""
        if not self.p.demands:
            return []
        n = sum(self._counts)
        own, columns = raw[len(raw) - n :], []
        for i, step in enumerate(STEP * self.p.sizes):
            there = step * np.eye(len(x))[i]
            ends = [(sign * step, self._evaluated(x + sign * there)) for sign in (1.0, -1.0)]
            known = [(at, found[1][len(raw) - n :]) for at, found in ends if found is not None]
            if not known:
                raise SpatialPinError("the loops open next to these dimensions")
            (at, ahead), (back, behind) = known[0], known[1] if len(known) > 1 else (0.0, own)
            columns.append((ahead - behind) / (at - back))
        return [np.array(columns).T]

    def found(self) -> LocalSolution:
        """Return the solution."""
        samples, raw = self._weighed() if self.penalty > 1.0 else self._met()
        left = np.where(self.one_sided, np.maximum(raw, 0.0), raw)
        cost = float(np.sum((self.weights * left)[~self.exact] ** 2))
        return LocalSolution(self.x, cost, float(np.abs(left[self.exact]).max(initial=0.0)),
                     tuple(samples), self.fit.evaluations)

    def _fitted(self, gain: float) -> tuple[list[GoalStates], Array]:
        """Return configurations and residuals where least squares end."""
        self.x = self.fit.minimum(self.residual, self.slopes, self.x, EXACT_EVALUATIONS, gain)
        found = self._at(self.x)
        if found is None:
            raise SpatialPinError(self._why)
        return found

    def _met(self) -> tuple[list[GoalStates], Array]:
        """Return the same of goals that are all to be met exactly.

        Where they can be, steps gain ever more: a start whose steps gain little before that is
        given up.
        """
        found = self._fitted(LOOSE_GAIN)
        left = np.where(self.one_sided, np.maximum(found[1], 0.0), found[1])
        is_far = np.abs(left).max(initial=0.0) > TOLERANCES.half_precision
        return found if is_far else self._fitted(TOLERANCES.tight)

    def _weighed(self) -> tuple[list[GoalStates], Array]:
        """Return the same of goals some of which have a weight."""
        misses = [np.inf] * IDLE_PENALTIES
        for _ in range(MOST_PENALTIES):
            found = self._fitted(TOLERANCES.tight)
            least = -self.multipliers / self.penalty
            missed = np.where(self.one_sided, np.maximum(found[1], least), found[1])[self.exact]
            misses.append(float(np.abs(missed).max(initial=0.0)))
            if misses[-1] <= TOLERANCES.tight or misses[-1] > 0.5 * misses[-1 - IDLE_PENALTIES]:
                break
            self.multipliers[self.exact] += self.penalty * missed
            self.penalty *= 4.0
        return found
