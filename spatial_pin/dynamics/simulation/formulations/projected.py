"""The equations of motion in all joint coordinates, the loops kept closed by projection [Eich1993].

Accelerations are those of the independent coordinates' engine, at the nearest configuration with
closed loops; after every step the unknowns are taken there by the shortest way, and velocities to
what the loops allow. Dearer than independent coordinates, which are only used to solve the
equations: what is integrated does not depend on their choice.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.formulations.independent import Independent
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Projection
from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.linalg import Array

# Rotation vector at which coordinates of joints that turn in space are begun anew [rad].
TURNED_END = 0.5
LEFT_OPEN = 1e-6  # closure residual that a step may leave to be projected away, at tight tolerances
LOOSE = 10.0  # the same relative to the tolerance of a step, at loose ones
WIDE = 1e-2  # the same at any tolerance: from there Newton's method finds the same branch


class Projected(Independent):
    """The right-hand side for the unknowns y: coordinates x of all joints, rates u, work done.

    Args:
        problem: what acts; nothing is prescribed.
        state: what the coordinates count from.
        held: velocity entries that determine the motion there.

    Raises:
        SpatialPinError: drivers are prescribed, which this formulation does not know.
        SingularError: the loops have lost rank at the state.
    """

    projects = True

    def __init__(self, problem: Problem, state: State, held: Sequence[int]) -> None:
        if problem.drives:
            raise SpatialPinError(
                f"mechanism {problem.mechanism.name!r}: the projected formulation prescribes no "
                "drivers; use the independent one")
        super().__init__(problem, state, held)
        self.free = list(range(problem.model.nv))
        table = problem.mechanism.coordinate_table.values()
        self._turning = [c.v for c in table if c.q < 0]  # those of balls and free joints
        self.projection = Projection(0, 0, 0.0, 0.0, 0.0)

    @property
    def is_fresh_the_same(self) -> bool:
        """Whether coordinates begun anew would be no better."""
        return not self._turning

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y where the coordinates are 0, at joint velocities v (nv,)."""
        return self.problem.unknowns(v / self.problem.scale, work)

    def renewed(self, t: float, y: Array, state: State) -> Array | None:
        """Let the coordinates count from y; return the unknowns there, None where they cannot."""
        found = self.kernel.renew(t, y)
        return None if found is None else found[1]

    def settle(self, solver: Any) -> float:
        """Take the solver's state back to closed loops and to velocities that they allow.

        Returns the residual that the step had left, relative to what is allowed; above 1 nothing
        has been done.
        """
        began = time.perf_counter()
        allowed = min(max(LEFT_OPEN, LOOSE * getattr(solver, "rtol", 0.0)), WIDE)
        found = self.kernel.settle(np.array(solver.y), allowed)
        if found is None:
            return np.inf
        solver.y, opened, corrections = found
        solver.f = self(solver.t, solver.y)
        self.kernel.keep()
        steps, before, most, seconds, share = self.projection
        self.projection = Projection(
            steps + 1, before + corrections, max(most, opened),
            seconds + time.perf_counter() - began, share)
        return opened / allowed

    def needs_new_coordinates(self, t: float, y: Array) -> bool:
        """Whether the coordinates should be begun anew."""
        return float(np.abs(y[self._turning]).max(initial=0.0)) > TURNED_END

    def crossings(self, y: Array, to: Array) -> list[tuple[float, float]]:
        """Return nothing: where branches cross the loops lose rank."""
        return []
