"""The equation of motion of one freedom, from a table along its branch."""

from __future__ import annotations

from itertools import repeat
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.formulations.free_rotation import Spins
from spatial_pin.dynamics.simulation.formulations.independent import FAST
from spatial_pin.dynamics.simulation.formulations.one_freedom_path import Path
from spatial_pin.dynamics.simulation.formulations.one_freedom_table import Table
from spatial_pin.dynamics.simulation.formulations.sample_energies import PlacedRows
from spatial_pin.dynamics.simulation.independent_coordinates import Lost, plain_coordinates
from spatial_pin.dynamics.simulation.problem import LIGHT, Problem, Row
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array

SURELY = 1.5  # joints move no faster between the nodes of a piece than this times at them


class OneFreedom:
    """The right-hand side for the unknowns y: the coordinate's change, its rate, spins, work done.

    Spins are the quaternions (x, y, z, w) of bodies that spin freely.

    Attributes:
        rows_at_once: how many rows are worth being worked out in one go.

    Args:
        problem: what acts; nothing is prescribed.
        state: where the coordinate begins.
        coordinate: the independent coordinate.
        spins: bodies that spin freely besides.

    Raises:
        SingularError: it does not determine the motion there.
    """

    rows_at_once = 1000
    projection = None

    def __init__(
        self, problem: Problem, state: State, coordinate: Coordinate, spins: Spins
    ) -> None:
        self.problem, self.n, self.free = problem, 1, [coordinate.v]
        self.path = Path(state, coordinate)
        self.evaluation = self.path.evaluation
        self.unit, self.start = self.path.unit, self.path.start
        self._seen = self.start
        self.spins, self.q0 = spins, state.q
        self._sigmas: list[float] = []
        self._turns = slice(2, 2 + 4 * len(spins))  # of the unknowns
        self.table = Table(problem.mechanism, self.path, coordinate, problem.forces, spins,
                           problem.tolerance)
        self.placed = PlacedRows(problem, self.evaluation)
        self.forced = problem.forces.exist or problem.constant.any() or problem.law is not None
        inertias = problem.mass(state.q).diagonal() * problem.scale**2
        self._light = LIGHT * float(inertias.max(initial=0.0)) / self.unit**2
        self.evaluations, self.patience = 0, FAST
        self.is_fresh_the_same = True
        self.pivot = 1.0  # the path itself watches what it meets

    @property
    def is_light(self) -> bool:
        """Whether its inertia at the start may be round-off of that of the heaviest joint."""
        inertia = self.table.rows.at(self.start)[self.table.columns.reduced][0]
        return not inertia > self._light

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
        turns = [self.q0[body.q] for body in self.spins.bodies]
        self._sigmas = self.spins.rates(self.q0, v)
        y = self.problem.unknowns(v[self.free] / self.unit, work)
        return np.concatenate([y[:2], *turns, y[2:]])

    def choice(self, state: State) -> list[int]:
        """Return the velocity entry that would be the best coordinate at a state."""
        return plain_coordinates(state, self.spins.rows)[:1]

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt; NaN where the branch does not go, or inertia is none but for round-off."""
        self.evaluations += 1
        rate = float(y[1])
        s, speed = self.start + self.unit * float(y[0]), self.unit * rate
        try:
            m, h, g, *spinning = self.table.reduced(s)
            force, power = self._forces(t, s, y) if self.forced else (0.0, 0.0)
        except Lost:
            return np.full(len(y), np.nan)
        if not m > self._light:
            return np.full(len(y), np.nan)
        rates = [rate, (force - h * speed * speed - g) / m / self.unit]
        if spinning:
            rates += self.spins.turning(spinning, speed, self._sigmas, y[self._turns].tolist())
        return np.array([*rates, power] if self.problem.works else rates)

    def _forces(self, t: float, s: float, y: Array) -> tuple[float, float]:
        """Return the force of efforts and springs on the coordinate, and their lasting power."""
        values, rate = self.table.columns_at(s), self.unit * float(y[1])
        t1 = values[self.table.columns.t]
        efforts = self.problem.constant
        if self.problem.law is not None:
            q, v, _ = self._moving(s, values, y, t1 * rate)
            efforts = self.problem.efforts(t, self._stand(q, values), v, self.evaluation)
        springs, stored = self.table.springs(values, rate)
        effort = float(efforts @ t1)
        return effort + springs, (effort + springs + stored) * rate

    def _moving(
        self, s: float, values: Array, y: Array, v: Array, a: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return q, v and a at unknowns y, where the columns have these values.

        v and a, (nv,), are those of the columns, which leave spins out.
        """
        q = self.table.configuration(s, values)
        a = np.zeros(len(v)) if a is None else a
        self.spins.restore(q, y[self._turns], v, a, self._sigmas)
        return q, v, a

    def _stand(self, q: Array, values: Array) -> Array:
        """Let the evaluation stand at q, where the columns have these values; returns q."""
        self.evaluation.turns[:] = values[self.table.columns.angles]
        self.evaluation.update(q)
        return q

    def _at(self, y: Array) -> tuple[Array, Array, Array]:
        """Return q, v and the values of the columns at y."""
        s = self.start + self.unit * float(y[0])
        values = self.table.columns_at(s)
        q, v, _ = self._moving(
            s, values, y, values[self.table.columns.t] * (self.unit * float(y[1])))
        return q, v, values

    def place(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at y.

        Raises:
            Lost: the branch does not go there.
        """
        q, v, _ = self._at(y)
        return q, v

    def state(self, t: float, y: Array) -> State:
        """Return the State at y, with velocities.

        Raises:
            Lost: the branch does not go there.
        """
        q, v, values = self._at(y)
        return self.problem.state(self._stand(q, values), v, self.evaluation)

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
                times.tolist(), places.tolist(), unknowns, strict=True)]
        free = forces - h * rates[:, 0] ** 2 - g
        second = np.divide(free, m, out=np.zeros(len(m)), where=m != 0.0)[:, None]
        v = values[:, columns.t] * rates
        a = values[:, columns.t] * second + values[:, columns.c] * rates**2
        q = values[:, columns.q].copy()
        self.table.finish(places, q)
        if len(self.spins):
            for row in zip(q, unknowns[:, self._turns], v, a, strict=True):
                self.spins.restore(*row, self._sigmas)
        energy, error, angles = self.placed(q, v, values[:, columns.angles])
        none = np.empty(0)
        return list(map(Row, q, v, a, error.tolist(), energy.tolist(), repeat(none), angles))

    def settle(self, solver: Any) -> None:
        """Do nothing: every evaluation closes the loops."""

    def is_worn(self, t: float, y: Array) -> bool:
        """Whether another independent coordinate would be better."""
        s = self.start + self.unit * float(y[0])
        if SURELY * self.table.pace_near(s) * self.unit <= self.patience:
            return False
        t1 = self.table.columns_at(s)[self.table.columns.t]
        pace = float(np.abs(t1 / self.problem.scale).max()) * self.unit
        return pace > self.patience
