"""How fast steps lead on, and when they lead nowhere."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.errors import StepLimitError
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import INTEGRATORS, Accuracy

NEAR = 1e-3  # pivot, and step, relative to the largest so far, below which the motion creeps
TRIED = 1000  # steps of a motion without damping, which go on as long as they are
HOPELESS = 10.0  # steps needed relative to those allowed: beyond, the duration is a mistake
CREEPING = 60  # such steps in a row that show a singular configuration just ahead
NOWHERE = 1e-2  # of the longest step: farther than all allowed steps would lead if as short
STANDING = 200  # such steps in a row that lead nowhere: stiff motions soon take longer ones


class Pace:
    """Looks at the lengths of steps.

    Args:
        problem: what acts.
        accuracy: how many steps may be taken.
        end: until when [s].

    Attributes:
        largest: (2,) pivot of the equations and step [s], the largest so far.
    """

    def __init__(self, problem: Problem, accuracy: Accuracy, end: float) -> None:
        self._problem, self._accuracy, self._end = problem, accuracy, end
        self.largest: Array = np.zeros(2)
        self._creeping = self._standing = 0

    def leapt(self, steps: int, largest: Array) -> None:
        """Take note of steps in the kernel, which looks at them by itself."""
        if steps > 1:
            self._creeping = self._standing = 0
        self.largest = largest

    def creeps(self, pivot: float, step: float) -> bool:
        """Whether steps shorten towards a singular configuration, or are too short to end."""
        sizes = np.array([pivot, step])
        self.largest = np.maximum(self.largest, sizes)
        creeps = bool(np.all(sizes < NEAR * self.largest))
        self._creeping = self._creeping + 1 if creeps else 0
        stands = step * self._accuracy.most_steps < NOWHERE * self.largest[1]
        self._standing = self._standing + 1 if stands else 0
        return self._creeping > CREEPING or self._standing > STANDING

    def is_short(self, time: float) -> bool:
        """Whether a time [s] is negligible relative to the longest step so far."""
        return bool(time <= NEAR**2 * self.largest[1])

    def most(self, steps: int) -> int:
        """Return how many steps may follow before they are looked at again."""
        return min(TRIED - steps % TRIED, max(self._accuracy.most_steps - steps, 1))

    def refuse_to_go_on_for_ever(self, t: float, steps: int, solver: Any) -> None:
        """Refuse more steps than are allowed, early where there would be far more.

        How many fixed ones there are was known before.

        Raises:
            StepLimitError: there would be more.
        """
        most = self._accuracy.most_steps
        if solver.status != "running" or INTEGRATORS[self._accuracy.integrator].is_fixed:
            return
        is_hopeless = (self._problem.is_steady and not self._problem.is_damped
                       and steps % TRIED == 0 and t * HOPELESS * most < self._end * steps)
        if steps < most and not is_hopeless:
            return
        raise StepLimitError(
            f"mechanism {self._problem.mechanism.name!r}: {steps} steps have led to "
            f"{t:.6g} s of {self._end:.6g} s, the last of {solver.t - solver.t_old:.2g} s: "
            "take a shorter duration, a larger time_tolerance, integrator='Radau' where strong "
            f"springs or dampers make steps short, or Accuracy(most_steps={10 * most})")
