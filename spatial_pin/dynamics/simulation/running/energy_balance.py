"""Whether energy comes from nowhere while a motion is followed."""

from __future__ import annotations

import numpy as np

from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Energies
from spatial_pin.dynamics.simulation.running.record import Record
from spatial_pin.errors import EnergyError
from spatial_pin.settings import INTEGRATORS, Accuracy

LOST_SHARE = 1e-2  # of what is exchanged: beyond any error of steps of usual tolerance
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
            WORST, max(LOST_SHARE, TOLERANCES * accuracy.time_tolerance))
        self._remedy = ("take a smaller time_tolerance or step, or formulation='independent'"
                        if accuracy.formulation == "projected"
                        else "take a smaller time_tolerance or step")
        self._name, self._least_exchange = problem.mechanism.name, problem.least_exchange
        self._keeps(start)

    def refuse_to_lose(self, t: float, now: Energies) -> None:
        """Refuse a step, or a sample, at which energy is not that of the start and the work since.

        Raises:
            EnergyError: energy was lost or gained.
        """
        if self._keeps(now):
            return
        raise EnergyError(
            f"mechanism {self._name!r}: at {t:.9g} s there are "
            f"{now.total - now.work:.6g} J, the work done taken off, where "
            f"{self._start.total:.6g} J were at the start: energy came from nowhere or was lost; "
            f"{self._remedy}")

    def refuse_samples(self, record: Record) -> None:
        """Refuse samples whose energy balance is wrong; they are dropped.

        Raises:
            EnergyError: there are some.
        """
        times, samples = record.all()
        for k, (t, row) in enumerate(zip(times.tolist(), samples.numbers.tolist(), strict=True)):
            try:
                self.refuse_to_lose(t, Energies(*row[1:]))
            except EnergyError:
                record.filled = k
                raise

    def _keeps(self, now: Energies) -> bool:
        rest = now.total - now.kinetic
        self._least, self._most = min(self._least, rest), max(self._most, rest)
        self._size = max(self._size, now.kinetic, self._most - self._least, abs(now.work))
        allowed = self._part * max(
            self._size, self._least_exchange(now.total, self._start.total))
        gap = abs(now.total - now.work - self._start.total + self._start.work)
        return not self._watches or gap <= allowed
