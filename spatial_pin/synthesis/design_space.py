"""Unknowns of a synthesis problem with their bounds and start values."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.variants import STEP, DimensionBatch, EvaluatedBatch, Variants
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.sweep import sweep
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.demand import Demand, MotionDemand
from spatial_pin.synthesis.inner_problem import GoalStates, InnerProblem, spread
from spatial_pin.synthesis.precision import Goal, Precision

# Weights of open loops relative to goal errors, used one after the other. At the last weight, loops
# are open by 1e-4 of the goal errors: near enough for exact closing. Drawn starts begin with the
# first or the second weight: each finds solutions that the other one misses.
WEIGHTS = (1.0, 10.0, 100.0)
BATCH = 32  # starts that are fitted together: more save no time per start
DRAWN_TRIES = 8  # configurations tried for a drawn start
Guess = Mapping[str, Any] | State | Array | None


class DesignSpace:
    """The unknowns of a synthesis problem: dimensions, then numbers of the goals.

    Attributes:
        names: of the unknowns.
        lower, upper: (n,) their bounds.
        start: (n,) their values at the first start.
        inner_problems: one for each goal of precision; own: their unknowns, as slices.
        demands: the other goals.
        tried: number of sets of dimensions that were tried until now.
    """

    def __init__(
        self, mechanism: Mechanism, goals: Sequence[Goal],
        bounds: Mapping[str, tuple[float, float]], guess: Guess = None,
    ) -> None:
        self.mechanism, self.goals = mechanism, tuple(goals)
        self.family = Variants(mechanism, bounds)
        self.inner_problems = [InnerProblem(self.family, g) for g in goals
                               if isinstance(g, Precision)]
        self.demands = [g for g in goals if isinstance(g, Demand)]
        self._guess, self.tried = guess, 0
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
        """Return a random start (n,): dimensions between their bounds, goals placed anywhere.

        A dimension without bounds is drawn between half and twice its own value. With one bound,
        its distance to the bound is half to twice the nominal distance, or up to its size if it is
        at the bound.
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
        """Return dimensions (n,) at fractions (n,) from 0 to 1 of their ranges."""
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
        """Return mechanisms at random dimensions and random configurations, with open loops."""
        rng = np.random.default_rng(0)
        x = np.array([self._between(rng.uniform(size=self.n)) for _ in range(BATCH)]).T
        members = self.family.batch(x)
        members = members.taken(np.flatnonzero(members.holds))
        state = self.nominal()
        q = spread(self.mechanism, state.q, len(members.holds), rng)
        return self.family.bodies(members, q, np.repeat(state.angles[None], len(q), axis=0))

    def nominal(self) -> State:
        """Return the closed state at the nominal dimensions, or one next to a singular one.

        No motion can be followed from a branch point. At changed dimensions it is not there.
        """
        if self._nominal is not None:
            return self._nominal
        mechanism, states = self.mechanism, [assembled(self.mechanism, {}, self._guess)]
        for name in [d.moved_by(mechanism) for d in self.demands if isinstance(d, MotionDemand)]:
            driver = mechanism.driven_coordinate(name)
            own = states[0].coordinate(driver.name).value
            try:
                sweep(mechanism, name, [own], guess=states[0])
            except SpatialPinError:
                size = TOLERANCES.moved * mechanism.velocity_scale[driver.v]
                for value in (own + size, own - size):
                    with suppress(SpatialPinError):
                        states.append(assembled(mechanism, {name: value}, states[0].q))
                        break
            if len(states) > 1:
                break
        self._nominal = states[-1]
        return self._nominal

    def start_states(self, x: Array, rng: np.random.Generator | None) -> list[GoalStates]:
        """Return start configurations of every goal; each sample starts from the one before."""
        members, state, states = self.members(x), self.nominal(), []

        def best(inner: InnerProblem, tries: GoalStates, own: Array) -> GoalStates:
            settled = inner.loosely(members, inner.placed(tries, own), own, WEIGHTS[0])
            residual = inner.loose_residual(members, settled, own, WEIGHTS[0])
            k = int(np.argmin(np.einsum("mi,mi->m", residual, residual)))
            return settled.taken(slice(k, k + 1))

        for inner, own in zip(self.inner_problems, self.own, strict=True):
            k = 1 if rng is None else DRAWN_TRIES
            q = (state.q[None] if rng is None else
                 np.concatenate([state.q[None], spread(self.mechanism, state.q, k - 1, rng)]))
            tries = GoalStates(
                q, np.repeat(state.angles[None], k, axis=0), np.zeros(k, dtype=np.intp))
            chain = [best(inner, tries, x[own])]
            for i in range(1, inner.goal.count):
                chain.append(best(inner, chain[-1]._replace(at=np.array([i])), x[own]))
            states.append(GoalStates.joined(chain))
        return states

    def members(self, x: Array) -> DimensionBatch:
        """Return the mechanism of x."""
        return self._together(x)[0]

    def around(self, x: Array) -> tuple[DimensionBatch, Array]:
        """Return mechanisms ahead of and behind each dimension, and the step widths (n,)."""
        steps = STEP * self.sizes[: self.n]
        return self._together(x)[1], (x[: self.n] + steps) - (x[: self.n] - steps)

    def _together(self, x: Array) -> tuple[DimensionBatch, DimensionBatch]:
        """Return the mechanism of x and its neighbours, evaluated together, with the last cached.

        Many cost little more than one.
        """
        here = x[: self.n, None]
        if self._last is None or self._last[0] != here.tobytes():
            steps = np.diag(STEP * self.sizes[: self.n])
            every = self.family.batch(np.concatenate([here, here + steps, here - steps], axis=1))
            self._last = here.tobytes(), (every.taken(np.array([0])),
                                          every.taken(np.arange(1, 2 * self.n + 1)))
        return self._last[1]


def weight_of(goal: Goal) -> float:
    """Return the weight of a goal; 1 for an exact goal."""
    return 1.0 if goal.weight is None else goal.weight
