"""Whether energy comes from nowhere while a motion is followed."""

from __future__ import annotations

import numpy as np

from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Energies
from spatial_pin.settings import INTEGRATORS, Accuracy

LOST = 1e-2  # of what is exchanged: beyond any error of steps of usual tolerance
WORST = 0.5  # the same where steps are fixed, or their tolerance is loose
TOLERANCES = 1e6  # errors of steps, one way, that are allowed to add up to it


class Balance:
    """What is exchanged along a motion, and what of it may come from nowhere.

    Args:
        problem: what acts.
        accuracy: of the steps.
        start: energies at the start.
    """

    def __init__(self, problem: Problem, accuracy: Accuracy, start: Energies) -> None:
        self._start, self._least, self._most, self._size = start, np.inf, -np.inf, 0.0
        fixed = INTEGRATORS[accuracy.integrator].is_fixed
        creeps = fixed and problem.forces.resistance  # which is warned of: losses are not known
        self._watches = problem.is_steady and not creeps
        self._part = WORST if fixed else min(
            WORST, max(LOST, TOLERANCES * accuracy.time_tolerance))
        self._least_exchange = problem.least_exchange
        self.keeps(start)

    def keeps(self, now: Energies) -> bool:
        """Whether the energies of a moment are those of the start and the work done since."""
        rest = now.total - now.kinetic
        self._least, self._most = min(self._least, rest), max(self._most, rest)
        self._size = max(self._size, now.kinetic, self._most - self._least, abs(now.work))
        allowed = self._part * max(
            self._size, self._least_exchange(now.total, self._start.total))
        gap = abs(now.total - now.work - self._start.total + self._start.work)
        return not self._watches or gap <= allowed
