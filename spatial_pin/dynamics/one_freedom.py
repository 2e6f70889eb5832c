"""The equation of motion of one freedom, from a table along its branch."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatial_pin.dynamics.embedding import Lost
from spatial_pin.dynamics.freedoms import FAST
from spatial_pin.dynamics.path import Path
from spatial_pin.dynamics.problem import Problem, Row
from spatial_pin.dynamics.table import Table
from spatial_pin.kinematics.state import State
from spatial_pin.linalg import Array
from spatial_pin.mechanism.mechanism import Coordinate


class OneFreedom:
    """The right-hand side for the unknowns y: the coordinate's change, its rate, work done.

    Attributes:
        rows_at_once: how many rows are worth being worked out in one go.

    Args:
        problem: what acts; nothing is prescribed.
        state: where the coordinate begins.
        coordinate: the independent coordinate.

    Raises:
        SingularError: it does not determine the motion there.
    """

    rows_at_once = 1000
    projection = None

    def __init__(self, problem: Problem, state: State, coordinate: Coordinate) -> None:
        self.problem, self.n, self.free = problem, 1, [coordinate.v]
        self.path = Path(state, coordinate)
        self.evaluation = self.path.evaluation
        self.unit, self.start = self.path.unit, self.path.start
        self._seen = self.start
        self.table = Table(problem.mechanism, self.path, coordinate, problem.forces)
        self.forced = problem.forces.exist or problem.constant.any() or problem.law is not None
        self.evaluations, self.patience = 0, FAST
        self.is_fresh_the_same = True
        self.pivot = 1.0  # the path itself watches what it meets

    def crossings_to(self, y: Array) -> list[tuple[float, float]]:
        """Return where branches crossed since the last call: the coordinate, and the unknown y0."""
        before, self._seen = self._seen, self.start + self.unit * float(y[0])
        low, high = sorted((before, self._seen))
        found = {round(value, 6): value for crossing in self.path.crossings
                 for value in self.table.images(crossing, low, high)}
        return [(value, (value - self.start) / self.unit)
                for value in sorted(found.values(), reverse=before > self._seen)]

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y at the coordinate's start, at joint velocities v (nv,)."""
        return self.problem.unknowns(v[self.free] / self.unit, work)

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt; NaN where the branch does not go."""
        self.evaluations += 1
        rate = float(y[1])
        try:
            acceleration, power = self._accelerate(t, y)
        except Lost:
            return np.full(len(y), np.nan)
        rates = [rate, acceleration / self.unit]
        return np.array([*rates, power] if self.problem.works else rates)

    def _accelerate(self, t: float, y: Array) -> tuple[float, float]:
        """Return the coordinate's acceleration, and the power of what is not stored."""
        s, rate = self.start + self.unit * float(y[0]), self.unit * float(y[1])
        m, h, g, _ = self.table.reduced(s)
        force = power = 0.0
        if self.forced:
            force, power = self._forces(t, s, rate, self.table.columns_at(s))
        force -= h * rate * rate + g
        if m:
            return force / m, power
        still = self.problem.accelerations(np.zeros((1, 1)), np.array([force]), self.free)
        return float(still[0]), power

    def _forces(self, t: float, s: float, rate: float, values: Array) -> tuple[float, float]:
        """Return the force of efforts and springs on the coordinate, and their lasting power."""
        t1 = values[self.table.columns.t]
        efforts = self.problem.constant
        if self.problem.law is not None:
            efforts = self.problem.efforts(t, self._stand(s, values), t1 * rate, self.evaluation)
        springs, stored = self.table.springs(values, rate)
        effort = float(efforts @ t1)
        return effort + springs, (effort + springs + stored) * rate

    def _stand(self, s: float, values: Array) -> Array:
        """Return q at s, with these values of the columns, and let the evaluation stand there."""
        q = self.table.configuration(s, values)
        self.evaluation.turns[:] = values[self.table.columns.angles]
        self.evaluation.update(q)
        return q

    def place(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at y.

        Raises:
            Lost: the branch does not go there.
        """
        s = self.start + self.unit * float(y[0])
        values = self.table.columns_at(s)
        return (self.table.configuration(s, values),
                values[self.table.columns.t] * (self.unit * float(y[1])))

    def state(self, t: float, y: Array) -> State:
        """Return the State at y, with velocities.

        Raises:
            Lost: the branch does not go there.
        """
        s = self.start + self.unit * float(y[0])
        values = self.table.columns_at(s)
        v = values[self.table.columns.t] * (self.unit * float(y[1]))
        return self.problem.state(self._stand(s, values), v, self.evaluation)

    def rows(self, times: Array, unknowns: Array) -> list[Row]:
        """Return everything at times (N,) and unknowns (N, n).

        Raises:
            Lost: the branch does not go to one of them.
        """
        places, rates = self.start + self.unit * unknowns[:, 0], self.unit * unknowns[:, 1]
        values = self.table.columns_of(places)
        columns, rates = self.table.columns, rates[:, None]
        m, h, g, _ = values[:, columns.reduced].T
        forces = np.zeros(len(times))
        if self.forced:
            forces[:] = [self._forces(*row)[0] for row in zip(
                times.tolist(), places.tolist(), rates[:, 0].tolist(), values, strict=True)]
        free = forces - h * rates[:, 0] ** 2 - g
        second = np.divide(free, m, out=np.zeros(len(m)), where=m != 0.0)[:, None]
        v = values[:, columns.t] * rates
        a = values[:, columns.t] * second + values[:, columns.c] * rates**2
        return [self._row(*row) for row in zip(places.tolist(), values, v, a, strict=True)]

    def _row(self, s: float, values: Array, v: Array, a: Array) -> Row:
        q, evaluation = self._stand(s, values), self.evaluation
        return Row(q, v, a, evaluation.closure_error, self.problem.energy(q, v, evaluation),
                   np.empty(0), evaluation.angles.copy())

    def settle(self, solver: Any) -> None:
        """Do nothing: every evaluation closes the loops."""

    def is_worn(self, t: float, y: Array) -> bool:
        """Whether another independent coordinate would be better."""
        values = self.table.columns_at(self.start + self.unit * float(y[0]))
        t1 = values[self.table.columns.t]
        pace = float(np.abs(t1 / self.problem.scale).max()) * self.unit
        return pace > self.patience
