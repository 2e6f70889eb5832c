"""The equations of motion in any number of independent coordinates, drivers prescribed or not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.independent_coordinates import (
    Embedding,
    Lost,
    best_coordinates,
)
from spatial_pin.dynamics.simulation.problem import Problem, Row
from spatial_pin.dynamics.solvers.kkt import ROUNDING, Blurred, Motions
from spatial_pin.numerics.linalg import Array

FAST = 4.0  # speed of a joint, by the independent coordinates', at which others are taken
FAR = 1.0  # chart coordinate at which a chart of joints that turn in space is begun anew [rad]


class Freedoms:
    """The right-hand side for the unknowns y: chart coordinates x, their rates u, work done.

    Attributes:
        rows_at_once: how many rows are worth being worked out in one go: the way from the last
            place to the first is long.

    Args:
        problem: what acts.
        state: where the chart begins.
        free: velocity entries that are independent.
    """

    rows_at_once = 1
    projection = None

    def __init__(self, problem: Problem, state: State, free: list[int]) -> None:
        self.problem, self.free, self.n = problem, free, len(free)
        prescribed = [c.v for c, _ in problem.drives]
        self.embedding = Embedding(state, free, prescribed, problem.tolerance)
        self.evaluation = self.embedding.evaluation
        self.held_scale = problem.scale[self.embedding.held]
        self.starts = np.array([state.q[c.q] for c, _ in problem.drives])
        inertias = problem.mass(state.q).diagonal() * problem.scale**2
        self._heaviest = float(inertias.max(initial=0.0))
        self.evaluations, self.patience = 0, FAST
        self._placed: tuple[float, Array, Array, Array] | None = None

    def crossings_to(self, y: Array) -> list[tuple[float, float]]:
        """Return none: with several freedoms no crossing is passed."""
        return []

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y at the chart's origin, at joint velocities v (nv,)."""
        return self.problem.unknowns(v[self.free] / self.problem.scale[self.free], work)

    def choice(self, state: State) -> list[int]:
        """Return the velocity entries that would be the best independent ones at a state."""
        return best_coordinates(state, [c.v for c, _ in self.problem.drives])

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt; NaN where the loops cannot be closed."""
        self.evaluations += 1
        try:
            v, a = self._place(t, y)
        except Lost:
            return np.full(len(y), np.nan)
        acceleration, missing, given = self._accelerate(t, v, a)
        rates = self.embedding.chart_rates(v)[: self.n]
        if not self.problem.works:
            return np.concatenate([rates, acceleration])
        return np.concatenate([rates, acceleration, [self._power(v, missing, given)]])

    def _place(self, t: float, y: Array) -> tuple[Array, Array]:
        """Go where y says; return joint velocities and, at no free acceleration, accelerations."""
        if self._placed is None or self._placed[0] != t or not np.array_equal(self._placed[1], y):
            self._placed = None  # lost, until found
            self._placed = (t, y.copy(), *self._find(t, y))
        return self._placed[2], self._placed[3]

    def _find(self, t: float, y: Array) -> tuple[Array, Array]:
        n, embedding = self.n, self.embedding
        x, u = y[:n], y[n : 2 * n] * self.held_scale[:n]
        if not self.problem.drives:
            embedding.go(x)
            v = embedding.velocity(u)
            return v, embedding.bias(v)
        values = np.array([law(t) for _, law in self.problem.drives])
        scale = self.held_scale[n:]
        embedding.go(np.concatenate([x, (values[:, 0] - self.starts) / scale]))
        v = embedding.velocity(np.concatenate([u, values[:, 1]]))
        driven = self.problem.scale * (embedding.columns[:, n:] @ (values[:, 2] / scale))
        return v, embedding.bias(v) + driven

    def _accelerate(self, t: float, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return free accelerations (n,), scaled, missing joint forces and given ones (nv,)."""
        problem, q = self.problem, self.embedding.q
        given = problem.given(t, q, v, self.evaluation)
        missing = pin.rnea(problem.model, problem.data, q, v, a) - given
        if not self.n:
            return np.empty(0), missing, given
        columns = problem.scale[:, None] * self.embedding.columns[:, : self.n]
        mass = problem.mass(q)
        inertia = mass @ columns
        acceleration = problem.free_accelerations(
            columns.T @ inertia, -(columns.T @ missing), self._heaviest)
        if acceleration is None:
            acceleration = problem.least(
                q, v, Blurred(a, ROUNDING * np.abs(a)), self._surely(), given).z
        return acceleration, missing + inertia @ acceleration, given

    def _surely(self) -> Blurred:
        """Return the joint velocities (nv, n) per unit of the free ones, with their round-off."""
        rows, driven = self.embedding.rows, self.embedding.held[self.n :]
        held = np.zeros((len(driven), len(self.problem.scale)))
        held[np.arange(len(driven)), driven] = 1.0
        return Motions(np.vstack([self.evaluation.jacobian[rows], held]), self.problem.scale,
                       self.evaluation.closure_error, self.free).columns

    def _power(self, v: Array, missing: Array, given: Array) -> float:
        """Return the power of what is not stored: efforts, dampers, laws, prescribed drivers."""
        drives = self.problem.drives
        total = float(given @ v) + self.problem.forces.storing(self.evaluation, self.embedding.q, v)
        return total + float(self._drive_efforts(missing) @ np.array([v[c.v] for c, _ in drives]))

    def _drive_efforts(self, missing: Array) -> Array:
        """Return the efforts of prescribed drivers for missing joint forces (nv,)."""
        columns = self.problem.scale[:, None] * self.embedding.columns[:, self.n :]
        return (columns.T @ missing) / self.held_scale[self.n :]

    def place(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at y.

        Raises:
            Lost: the loops cannot be closed there.
        """
        v, _ = self._place(t, y)
        return self.embedding.q.copy(), v

    def state(self, t: float, y: Array) -> State:
        """Return the State at y, with velocities.

        Raises:
            Lost: the loops cannot be closed there.
        """
        v, _ = self._place(t, y)
        return self.problem.state(self.embedding.q, v, self.evaluation)

    def _row(self, t: float, y: Array) -> Row:
        v, a0 = self._place(t, y)
        acceleration, missing, _ = self._accelerate(t, v, a0)
        q = self.embedding.q.copy()
        a = a0 + self.problem.scale * (self.embedding.columns[:, : self.n] @ acceleration)
        return Row(q, v, a, self.evaluation.closure_error,
                   self.problem.energy(q, v, self.evaluation), self._drive_efforts(missing),
                   self.evaluation.angles.copy())

    def rows(self, times: Array, unknowns: Array) -> list[Row]:
        """Return everything at times (N,) and unknowns (N, n), loops closed.

        Raises:
            Lost: they cannot be at one of them.
        """
        return [self._row(t, y) for t, y in zip(times.tolist(), unknowns, strict=True)]

    def settle(self, solver: Any) -> float:
        """Return 0 and do nothing: every evaluation closes the loops."""
        return 0.0

    def is_worn(self, t: float, y: Array) -> bool:
        """Whether other independent coordinates, or a chart begun anew, would be better."""
        if not self.embedding.linear and np.abs(y[: self.n]).max(initial=0.0) > FAR:
            return True
        try:
            self._place(t, y)
        except Lost:
            return True
        self.embedding.keep()
        return self.embedding.pace > self.patience or self.embedding.has_worn_rows

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the equations at the present place."""
        return self.embedding.pivot

    @property
    def is_fresh_the_same(self) -> bool:
        """Whether the same coordinates, taken anew, would be no better."""
        return self.embedding.linear and self.embedding.whole
