"""The protocol of equations of motion, and the step of an integrator over them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Energies
from spatial_pin.kernel.dynamics import Samples
from spatial_pin.numerics.linalg import Array


class System(Protocol):
    """Equations of motion: `Independent` or `Projected`.

    Called with (t, y) it returns dy/dt, NaN where the loops cannot be closed. y holds the chart
    coordinates, their rates, and the work done if any is.

    Attributes:
        problem: mechanism, forces and prescribed drivers.
        free: velocity entries of the independent coordinates.
    """

    problem: Problem
    free: list[int]

    @property
    def evaluations(self) -> int:
        """Number of evaluations of dy/dt."""

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the constraint equations at the last evaluation."""

    @property
    def is_fresh_the_same(self) -> bool:
        """Whether a new chart of the same coordinates would be no better."""

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt."""

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y at the chart's origin, at joint velocities v (nv,)."""

    def renewed(self, t: float, y: Array, state: State) -> Array | None:
        """Change to better coordinates, or to a chart whose origin is at y, given the State there.

        Returns the unknowns in them, or None where no such coordinates exist.
        """

    def place(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at y."""

    def state(self, t: float, y: Array) -> State:
        """Return the State at y."""

    def energies(self, t: float, y: Array) -> Energies:
        """Return the energies at y."""

    def heaviest(self, t: float, y: Array) -> float:
        """Return the largest inertia of a joint at y, scaled, the others held."""

    def samples(self, times: Array, unknowns: Array) -> Samples:
        """Return the samples at times (N,) and unknowns (N, n)."""

    def needs_new_chart(self, t: float, y: Array) -> bool:
        """Whether other coordinates, or a new chart of these, would be better."""

    def crossings(self, y: Array, to: Array) -> list[tuple[float, float]]:
        """Return the branch points between two unknowns: the coordinate, and the unknown there."""


class Step:
    """The last step of an integrator, with the interpolant between its ends.

    Args:
        system: the equations of motion.
        solver: the integrator.

    Attributes:
        system: as given.
        first, last: when it begins and ends [s].
        end: (n,) unknowns there.
    """

    def __init__(self, system: System, solver: Any) -> None:
        self.system, self._solver, self.end = system, solver, np.array(solver.y)
        self._dense: Callable[[Any], Array] | None = None
        self.first, self.last = float(solver.t_old), float(solver.t)

    def unknowns(self, times: Array) -> Array:
        """Return the unknowns (N, n) at times (N,)."""
        if self._dense is None:
            self._dense = self._solver.dense_output()
        return self._dense(times).T

    def _at(self, t: float) -> Array:
        return self.end if t == self.last else self.unknowns(np.array([t]))[0]

    def place(self, t: float) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at a time."""
        return self.system.place(t, self._at(t))

    def state(self, t: float) -> State:
        """Return the State at a time."""
        return self.system.state(t, self._at(t))

    def efforts(self, t: float) -> Array:
        """Return the efforts of prescribed drivers at a time."""
        efforts: Array = self.system.samples(np.array([t]), self._at(t)[None]).efforts[0]
        return efforts
