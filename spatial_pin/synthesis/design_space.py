"""What local solutions of a synthesis problem share: dimensions that may change, goals, starts."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.dimension_batch import (
    DimensionBatch,
    DimensionFamily,
    EvaluatedBatch,
)
from spatial_pin.dimensions.predictions import STEP
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.demand import Candidate, Demand, MotionDemand
from spatial_pin.synthesis.inner_problem import GoalStates, InnerProblem, spread
from spatial_pin.synthesis.precision import Goal, Precision

# Weights of open loops relative to missed goals, one after the other: what is left open at last is
# a ten-thousandth of what is missed, from which exact closing goes on. Drawn starts begin with the
# first or the second: either leads to solutions, of other problems, that the other one misses.
WEIGHTS = (1.0, 10.0, 100.0)
BATCH = 32  # starts that are fitted together: more cost as much each
DRAWN_TRIES = 8  # configurations that a drawn start is looked for from
Guess = Mapping[str, Any] | State | Array | None


class DesignSpace:
    """Dimensions with which a mechanism meets goals.

    Attributes:
        names: of the numbers that are looked for: dimensions, then numbers of the goals.
        lower, upper: (n,) their bounds.
        start: (n,) where the first start is.
        inner_problems: of the goals of precision; own: which numbers are their own.
        demands: the other goals.
    """

    def __init__(
        self, mechanism: Mechanism, goals: Sequence[Goal],
        bounds: Mapping[str, tuple[float, float]], guess: Guess = None,
    ) -> None:
        self.mechanism, self.goals = mechanism, tuple(goals)
        self.family = DimensionFamily(mechanism, bounds)
        self.inner_problems = [InnerProblem(self.family, g) for g in goals
                               if isinstance(g, Precision)]
        self.demands = [g for g in goals if isinstance(g, Demand)]
        self._guess = guess
        self._nominal: State | None = None
        self._last: tuple[bytes, tuple[DimensionBatch, DimensionBatch]] | None = None
        own = [f"{s.goal.name}: {name}" for s in self.inner_problems for name in s.names]
        self.n = len(bounds)
        self.names = (*bounds, *own)
        low, high = np.array([*bounds.values()], dtype=float).reshape(-1, 2).T
        free = np.full(len(own), np.inf)
        self.lower, self.upper = np.concatenate([low, -free]), np.concatenate([high, free])
        first = [x for s in self.inner_problems for x in s.own_start()]
        self.start = np.array([*(mechanism.dimensions[name] for name in bounds), *first])
        self.start[: self.n] = np.clip(self.start[: self.n], low, high)
        length = mechanism.characteristic_length
        widths = np.where(np.isfinite(high - low), high - low,
                          np.maximum(np.abs(self.start[: self.n]), min(length, 1.0)))
        self.sizes = np.concatenate([widths, np.ones(len(own))])
        ends = np.cumsum([self.n, *(len(s.names) for s in self.inner_problems)])
        self.own = [slice(*x) for x in itertools.pairwise(ends.tolist())]

    def draw(self, rng: np.random.Generator) -> Array:
        """Return a start (n,): dimensions anywhere between their bounds, goals placed anywhere.

        Dimensions without bounds are within half and twice their own values, those with one are
        half to twice as far from it as they are; where that is nothing, up to their size away.
        """
        x = self.start.copy()
        x[: self.n] = self._between(rng.uniform(size=self.n))
        own = [name for s in self.inner_problems for name in s.names]
        for i, name in enumerate(own, start=self.n):
            if name == "scale" or name in ("placement.x", "placement.y", "placement.z"):
                x[i] += 0.5 * rng.standard_normal()
            else:  # zeros and turns up to half a turn
                is_turn = name.startswith("placement.r")
                x[i] += rng.uniform(-np.pi, np.pi) / (np.sqrt(3.0) if is_turn else 1.0)
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
        x = np.array([self._between(rng.uniform(size=self.n)) for _ in range(BATCH)]).T
        members = self.family.at(x)
        members = members.taken(np.flatnonzero(members.holds))
        state = self.nominal()
        q = spread(self.mechanism, state.q, len(members.holds), rng)
        return self.family.bodies(members, q, np.repeat(state.angles[None], len(q), axis=0))

    def nominal(self) -> State:
        """Return the closed state at the mechanism's own dimensions, or one next to a singular one.

        Dimensions that are changed leave a place where branches cross: from it no motion is
        followed, and none that begins at other dimensions.
        """
        if self._nominal is not None:
            return self._nominal
        mechanism, found = self.mechanism, [assembled(self.mechanism, {}, self._guess)]
        for name in [d.moved_by(mechanism) for d in self.demands if isinstance(d, MotionDemand)]:
            driver = mechanism.driven_coordinate(name)
            own = found[0].coordinate(driver.name).value
            try:
                sweep(mechanism, name, [own], guess=found[0])
            except SpatialPinError:
                size = TOLERANCES.moved * mechanism.velocity_scale[driver.v]
                for value in (own + size, own - size):
                    with suppress(SpatialPinError):
                        found.append(assembled(mechanism, {name: value}, found[0].q))
                        break
            if len(found) > 1:
                break
        self._nominal = found[-1]
        return self._nominal

    def begun(self, x: Array, rng: np.random.Generator | None) -> list[GoalStates]:
        """Return configurations to start from, each sample from the one before."""
        members, found = self.members(x), []
        state = self.nominal()
        for inner, own in zip(self.inner_problems, self.own, strict=True):
            k = 1 if rng is None else DRAWN_TRIES
            q = (state.q[None] if rng is None else
                 np.concatenate([state.q[None], spread(self.mechanism, state.q, k - 1, rng)]))
            tries = GoalStates(
                q, np.repeat(state.angles[None], k, axis=0), np.zeros(k, dtype=np.intp))
            last = self._best(inner, members, tries, x[own])
            chain = [last]
            for i in range(1, inner.goal.count):
                last = self._best(inner, members, last._replace(at=np.array([i])), x[own])
                chain.append(last)
            found.append(GoalStates.joined(chain))
        return found

    @staticmethod
    def _best(
        inner: InnerProblem, members: DimensionBatch, tries: GoalStates, own: Array
    ) -> GoalStates:
        """Return that of some configurations from which the goal is met best."""
        settled = inner.loosely(members, inner.placed(tries, own), own, WEIGHTS[0])
        left = inner.loose_residual(members, settled, own, WEIGHTS[0])
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

    def value(self, x: Array) -> float:
        """Return the loose cost at x, from the closed state: for a global search.

        Demands count where there are no goals of precision.
        """
        members = self.members(x)
        if not members.holds.all():
            return np.inf
        total = 0.0
        for inner, samples, own in zip(self.inner_problems, self.begun(x, None), self.own,
                                          strict=True):
            left = inner.loose_residual(members, samples, x[own], WEIGHTS[-1])
            total += float(np.sum(left**2)) * weight_of(inner.goal) ** 2
        if not self.inner_problems:
            candidate = self.candidate(x, [])
            for demand in self.demands:
                left = demand.values(candidate)
                missed = np.maximum(left, 0.0) if demand.is_one_sided else left
                total += float(np.sum(missed**2)) * weight_of(demand) ** 2
        return total

    def candidate(
        self, x: Array, samples: Sequence[GoalStates], near: State | None = None
    ) -> Candidate:
        """Return the mechanism of x with closed configurations, for demands."""
        return Candidate.of(self.family, x[: self.n], near or self.nominal(), samples)


def weight_of(goal: Goal) -> float:
    """Return the weight of a goal; one of those that are to be met exactly."""
    return 1.0 if goal.weight is None else goal.weight
