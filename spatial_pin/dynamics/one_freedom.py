"""The equation of motion of one freedom, from a table along its branch."""

from __future__ import annotations

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

    Args:
        problem: what acts; nothing is prescribed.
        state: where the coordinate begins.
        coordinate: the independent coordinate.

    Raises:
        SingularError: it does not determine the motion there.
    """

    def __init__(self, problem: Problem, state: State, coordinate: Coordinate) -> None:
        self.problem, self.n, self.free = problem, 1, [coordinate.v]
        self.path = Path(state, coordinate)
        self.evaluation = self.path.evaluation
        self.unit, self.start = self.path.unit, self.path.start
        self.table = Table(problem.mechanism, self.path, coordinate, problem.forces)
        self.forced = problem.forces.exist or problem.constant.any() or problem.law is not None
        self.evaluations, self.patience = 0, FAST
        self.is_fresh_the_same = True

    @property
    def crossings(self) -> list[float]:
        """Values of the coordinate at which branches were crossed, to be cleared by who reads."""
        return self.path.crossings

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
            force, power = self._forces(t, s, rate)
        return (force - h * rate * rate - g) / m if m else 0.0, power

    def _forces(self, t: float, s: float, rate: float) -> tuple[float, float]:
        """Return the force of efforts and springs on the coordinate, and their lasting power."""
        values = self.table.columns_at(s)
        t1 = values[self.table.columns.t]
        efforts = self.problem.constant
        if self.problem.law is not None:
            q = self._stand(s)[0]
            efforts = self.problem.efforts(t, q, t1 * rate, self.evaluation)
        springs, stored = self.table.springs(values, rate)
        effort = float(efforts @ t1)
        return effort + springs, (effort + springs + stored) * rate

    def _stand(self, s: float) -> tuple[Array, Array, Array]:
        """Return q, dq/ds, d²q/ds² at s, the evaluation standing there."""
        q, t1, t2, angles = self.table.place(s)
        self.evaluation.turns[:] = angles
        self.evaluation.update(q)
        return q, t1, t2

    def state(self, t: float, y: Array) -> State:
        """Return the State at y, with velocities.

        Raises:
            Lost: the branch does not go there.
        """
        q, t1, _ = self._stand(self.start + self.unit * float(y[0]))
        return self.problem.state(q, t1 * (self.unit * float(y[1])), self.evaluation)

    def row(self, t: float, y: Array) -> Row:
        """Return everything at y.

        Raises:
            Lost: the branch does not go there.
        """
        acceleration, _ = self._accelerate(t, y)
        q, t1, t2 = self._stand(self.start + self.unit * float(y[0]))
        rate = self.unit * float(y[1])
        v = t1 * rate
        return Row(q, v, t1 * acceleration + t2 * (rate * rate), self.evaluation.closure_error,
                   self.problem.energy(q, v, self.evaluation), np.empty(0),
                   self.evaluation.angles.copy())

    def is_worn(self, t: float, y: Array) -> bool:
        """Whether another independent coordinate would be better."""
        t1 = self.table.place(self.start + self.unit * float(y[0]))[1]
        pace = float(np.abs(t1 / self.problem.scale).max()) * self.unit
        return pace > self.patience
