"""What a simulation looks for in its steps: limits of joints, and where it is to stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import finite_number
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.running.limit_events import RatedLimits
from spatial_pin.dynamics.simulation.running.step import IntegrationStep
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import SLACK, JointLimit, joint_limits
from spatial_pin.motion.joint_limit_events import NOISE, Passing, first_passing, passed_at_start
from spatial_pin.motion.rated_limits import RatedLimit
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.roots import sign_change

StopFunction = Callable[[float, State], float]
AT_LIMITS = ("report", "stop", "ignore")


class Found(NamedTuple):
    """What a step has met.

    Attributes:
        passed: joint limits, with the times.
        stop: when the simulation ends, if it does in this step.
        text: why.
        rated: effort and velocity limits, with the times.
        kind: of the event that says so.
    """

    passed: list[tuple[float, JointLimit]]
    stop: float | None = None
    text: str = ""
    rated: Sequence[tuple[float, RatedLimit]] = ()
    kind: str = "stopped"


class Bounds(NamedTuple):
    """Limits of coordinates, as the kernel's steps heed them: `meets_limit` in running.c.

    Attributes:
        q, v: entries of the configuration and of the velocity.
        side: 1 above, -1 below, 0 of the velocity.
        value: from which on a coordinate is beyond.
        before: (n, 2) room and how fast it closes, where the last step ended.
    """

    q: NDArray[np.int64]
    v: NDArray[np.int64]
    side: NDArray[np.int64]
    value: Array
    before: Array


def _bounds(joints: Sequence[JointLimit], rated: Sequence[RatedLimit], state: State) -> Bounds:
    table = [(x.q, x.v, x.side, x.value + x.side * SLACK * x.size,
              float(x.room(state.q)) + SLACK * x.size, float(x.closing(state.v))) for x in joints]
    table += [(0, x.v, 0, x.value * (1.0 + SLACK), -float(x.excess(state.v[x.v])), 0.0)
              for x in rated]
    columns = np.array(table, float).reshape(-1, 6)
    q, v, side = (x.astype(np.int64) for x in columns[:, :3].T)  # each contiguous, as C reads it
    return Bounds(q, v, side, columns[:, 3].copy(), columns[:, 4:].copy())


def _stop_value(stop_when: StopFunction, t: float, state: State) -> float:
    value: Any = stop_when(t, state)
    return finite_number(value.item() if np.size(value) == 1 and isinstance(value, np.ndarray)
                         else value, f"what stop_when returns at {t:.6g} s")


class Watch:
    """Looks at the steps of a simulation.

    Args:
        problem: what is simulated.
        state: where it starts.
        stop_when: function whose zeros end it.
        on_joint_limit: "report", "stop" or "ignore".

    Attributes:
        at_start: joint limits beyond which it starts.
        bounds: what the kernel looks for by itself.
        always: whether every step is to be looked at.

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
        self.bounds = _bounds(self.limits, self.rated.velocities if self.rated else (), state)
        self.always = bool(stop_when or (self.rated and self.rated.efforts_are_looked_at))
        self._last = 0.0 if stop_when is None else _stop_value(stop_when, 0.0, state)

    def look(self, step: IntegrationStep, times: Array) -> Found:
        """Return what a step has met, which has samples at times (N,)."""
        passed = self._passed(step)
        rated = self.rated.passed(step) if self.rated else []
        stop = self._crossed(step, times)
        text = "" if stop is None else f"stopped at {stop:.12g} s"
        if passed and self.on_joint_limit == "stop" and (stop is None or passed[0][0] <= stop):
            stop, limit = passed[0]
            text = f"stopped at {stop:.12g} s by the {limit.words}"
        return Found([p for p in passed if stop is None or p[0] <= stop], stop, text,
                     [p for p in rated if stop is None or p[0] <= stop])

    def _passed(self, step: IntegrationStep) -> list[tuple[float, JointLimit]]:
        """Return the joint limits passed in a step, in the order of the times."""
        if not self.limits:
            return []
        ends = step.place(step.first), step.place(step.last)
        noise = NOISE * float(np.abs(np.array([v for _, v in ends]) / self._scale).max())
        found = [(first_passing(limit, step.place, (step.first, step.last), ends, noise), limit)
                 for limit in self.limits]
        return sorted(((t, limit) for t, limit in found if t is not None), key=lambda x: x[0])

    def _crossed(self, step: IntegrationStep, times: Array) -> float | None:
        """Return when `stop_when` has first crossed zero in a step, as its samples and end tell."""
        function = self.stop_when
        if function is None:
            return None
        before, since, found = self._last, step.first, None
        for t in sorted({*times.tolist(), step.last}):
            value = _stop_value(function, t, step.state(t))
            if before != 0.0 and before * value <= 0.0:
                found = sign_change(lambda t: _stop_value(function, t, step.state(t)),
                                    since, t, before, value)
                break
            before, since = value, t
        self._last = value
        return found

    def forget(self) -> None:
        """Look at the next step whatever the kernel has seen: the last one is taken again."""
        self.bounds.before[:] = np.inf
