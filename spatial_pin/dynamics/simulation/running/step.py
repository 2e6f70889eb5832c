"""The last step of an integrator over equations of motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.numerics.linalg import Array


class IntegrationStep:
    """The last step of an integrator, with the interpolant between its ends.

    Args:
        system: the equations of motion.
        solver: the integrator.

    Attributes:
        system: as given.
        first, last: when it begins and ends [s].
        end: (n,) unknowns there.
    """

    def __init__(self, system: Independent, solver: Any) -> None:
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
        return self.system.samples(np.array([t]), self._at(t)[None]).efforts[0]
