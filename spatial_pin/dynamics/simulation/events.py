"""What a simulation looks for in every step: joint limits, and where it is to stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.checks import finite_number
from spatial_pin.dynamics.simulation.problem import Problem, System
from spatial_pin.dynamics.simulation.rated_limits import RatedLimits
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import JointLimit, joint_limits
from spatial_pin.motion.joint_limits import (
    NOISE,
    Passing,
    falls,
    first_passing,
    passed_at_start,
)
from spatial_pin.motion.rated_limits import RatedLimit
from spatial_pin.numerics.linalg import Array

StopFunction = Callable[[float, State], float]
AT_LIMITS = ("report", "stop", "ignore")


class Found(NamedTuple):
    """What a step has met.

    Attributes:
        passed: joint limits, with the times.
        stop: when the simulation ends, if it does in this step.
        text: why.
        rated: effort and velocity limits, with the times.
    """

    passed: list[tuple[float, JointLimit]]
    stop: float | None = None
    text: str = ""
    rated: Sequence[tuple[float, RatedLimit]] = ()


def _stop_value(stop_when: StopFunction, t: float, state: State) -> float:
    value: Any = stop_when(t, state)
    return finite_number(value.item() if np.size(value) == 1 and isinstance(value, np.ndarray)
                         else value, f"what stop_when returns at {t:.6g} s")


class Watch:
    """Looks at every step of a simulation.

    Args:
        problem: what is simulated.
        state: where it starts.
        stop_when: function whose zeros end it.
        on_joint_limit: "report", "stop" or "ignore".

    Attributes:
        at_start: joint limits beyond which it starts.

    Raises:
        SpatialPinError: it is to stop at joint limits but starts beyond one.
        ValueError: `stop_when` returns no number.
    """

    def __init__(
        self, problem: Problem, state: State, stop_when: StopFunction | None, on_joint_limit: str
    ) -> None:
        self.stop_when, self.on_joint_limit = stop_when, on_joint_limit
        self._scale = problem.mechanism.velocity_scale
        ignored = on_joint_limit == "ignore"
        self.limits = [] if ignored else joint_limits(problem.mechanism)
        self.at_start: list[Passing] = (
            [] if ignored else passed_at_start(problem.mechanism, state.q, 0.0))
        if on_joint_limit == "stop" and self.at_start:
            raise SpatialPinError(
                f"mechanism {problem.mechanism.name!r}: the state is beyond the "
                f"{self.at_start[0].limit.words}, where the simulation is to stop: start inside "
                "(assemble(limits=True)), or give on_joint_limit=\"report\"")
        self.rated = None if ignored else RatedLimits(problem, state)
        self._last = 0.0 if stop_when is None else _stop_value(stop_when, 0.0, state)
        self._end: tuple[Array, Array] = state.q, state.v

    @property
    def is_needed(self) -> bool:
        """Whether there is anything to be looked for."""
        return bool(self.limits or self.stop_when or (self.rated and self.rated.limits))

    def look(self, system: System, solver: Any) -> Found:
        """Return what the solver's last step has met."""
        passed = self._passed(system, solver)
        rated = self.rated.passed(system, solver) if self.rated else []
        stop = self._crossed(system, solver)
        text = "" if stop is None else f"stopped at {stop:.12g} s"
        if passed and self.on_joint_limit == "stop" and (stop is None or passed[0][0] <= stop):
            stop, limit = passed[0]
            text = f"stopped at {stop:.12g} s by the {limit.words}"
        return Found([p for p in passed if stop is None or p[0] <= stop], stop, text,
                     [p for p in rated if stop is None or p[0] <= stop])

    def _passed(self, system: System, solver: Any) -> list[tuple[float, JointLimit]]:
        """Return the joint limits passed in the last step, in the order of the times."""
        if not self.limits:
            return []
        before, self._end = self._end, system.place(solver.t, solver.y)
        dense: list[Any] = []

        def at(t: float) -> tuple[Array, Array]:
            if not dense:
                dense.append(solver.dense_output())
            return system.place(t, dense[0](t))

        span, found = (solver.t_old, solver.t), []
        noise = NOISE * float(np.abs(np.array([before[1], self._end[1]]) / self._scale).max())
        for limit in self.limits:
            t = first_passing(limit, at, span, (before, self._end), noise)
            if t is not None:
                found.append((t, limit))
        return sorted(found, key=lambda pair: pair[0])

    def _crossed(self, system: System, solver: Any) -> float | None:
        """Return when `stop_when` has crossed zero in the last step, if it has."""
        function = self.stop_when
        if function is None:
            return None
        before, self._last = self._last, _stop_value(
            function, solver.t, system.state(solver.t, solver.y))
        if before == 0.0 or before * self._last > 0.0:
            return None
        dense, sign = solver.dense_output(), float(np.sign(before))
        return falls(lambda t: sign * function(t, system.state(t, dense(t))), solver.t_old,
                     solver.t)
