"""Where a simulation passes effort and velocity limits of the URDF."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.forces import joint_efforts
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.running.step import IntegrationStep
from spatial_pin.motion.motion import Event
from spatial_pin.motion.rated_limits import RatedLimit, effort_limits, velocity_limits
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.roots import sign_change

NEAR_LIMIT = 0.5  # of a limit, from which on it is looked for between the ends of a step too
BETWEEN = (0.25, 0.5, 0.75)  # parts of a step


class RatedLimits:
    """The limits that a simulation may pass.

    Efforts are those of prescribed drivers and those that a function gives. What constant efforts
    are beyond is told at the start.

    Args:
        problem: what is simulated.
        state: where it starts.

    Attributes:
        at_start: events of limits that it is beyond from the start.
        velocities: the limits of velocities.
        efforts_are_looked_at: whether efforts change that have limits.
    """

    def __init__(self, problem: Problem, state: State) -> None:
        self.problem = problem
        by_v = {limit.v: limit for limit in effort_limits(problem.mechanism)}
        self.velocities = velocity_limits(problem.mechanism)
        self._given = list(by_v.values()) if problem.law is not None else []
        drives = enumerate(c.v for c, _ in problem.drives)
        self._driven = [(k, by_v[v]) for k, v in drives if v in by_v]
        self.efforts_are_looked_at = bool(self._given or self._driven)
        constant = [(limit, problem.constant[limit.v]) for limit in by_v.values()]
        moving = [(limit, state.v[limit.v]) for limit in self.velocities]
        self.at_start = [Event(limit.kind, 0.0, 0, f"beyond the {limit.words} from the start")
                         for limit, x in (*constant, *moving) if limit.excess(x) > 0.0]

    def passed(self, step: IntegrationStep) -> list[tuple[float, RatedLimit]]:
        """Return the limits passed outwards in a step, with the times, in their order."""
        limits = [*self.velocities, *self._given, *(limit for _, limit in self._driven)]
        if not limits:
            return []
        found = []
        before, after = self._excesses(step, step.first), self._excesses(step, step.last)
        for k, limit in enumerate(limits):
            t = self._passing(lambda t, k=k: float(self._excesses(step, t)[k]),  # type: ignore[misc]
                              (step.first, step.last), float(before[k]), float(after[k]))
            if t is not None:
                found.append((t, limit))
        return sorted(found, key=lambda pair: pair[0])

    def _passing(
        self, excess: Callable[[float], float], span: tuple[float, float], before: float,
        after: float,
    ) -> float | None:
        """Return when an excess first becomes positive in a span of time, if it does."""
        if before > 0.0:
            return None
        first, last = span
        if not after > 0.0 and max(before, after) > -NEAR_LIMIT:
            inside = ((t, excess(t)) for t in (first + part * (last - first) for part in BETWEEN))
            last, after = next(((t, x) for t, x in inside if x > 0.0), (last, after))
        return sign_change(excess, first, last, before, after) if after > 0.0 else None

    def _excesses(self, step: IntegrationStep, t: float) -> Array:
        """Return how far all are beyond their limits, relative to these."""
        v = step.place(t)[1]
        pairs = [(limit, v[limit.v]) for limit in self.velocities]
        if self._given and self.problem.law is not None:
            given = joint_efforts(self.problem.mechanism, self.problem.law(t, step.state(t)))
            pairs += [(limit, given[limit.v]) for limit in self._given]
        if self._driven:
            efforts = step.efforts(t)
            pairs += [(limit, efforts[k]) for k, limit in self._driven]
        return np.array([float(limit.excess(x)) / limit.value for limit, x in pairs])
