"""The equations of motion in independent coordinates [Wehage1982], evaluated in the kernel.

One freedom passes change points (branches that cross) straight on; bodies that spin freely about
a line of symmetry are no freedoms then, their angular velocity about it is constant.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dynamics.simulation.coordinate_partitioning import Lost
from spatial_pin.dynamics.simulation.formulations.forces_in_kernel import (
    Answers,
    forces_as_arrays,
)
from spatial_pin.dynamics.simulation.formulations.free_rotation import Spins
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Energies
from spatial_pin.errors import SingularError
from spatial_pin.kernel.dynamics import KernelDynamics, SimulationSamples
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Speed of a joint relative to the independent coordinates' at which others are taken: it costs half
# a digit of the joint.
FASTER_THAN_CHOSEN = 4.0
# Residual that points which samples lie between are closed to: second derivatives divide it by the
# square of the way between them.
ANCHOR_RESIDUAL = 1e-12
# Residual that projected places are closed to: whether two are one is told to 1e-6 (SAME_PLACE in
# projected.c).
PROJECTED_RESIDUAL = 1e-8
# Rotation vector at which coordinates of joints that turn in space are begun anew [rad].
COORDINATES_END = 1.0


class Independent:
    """The right-hand side for the unknowns y.

    These are independent coordinates x, rates u of their joints, quaternions (x, y, z, w) of
    bodies that spin freely, and the work done if any is.

    Args:
        problem: what acts.
        state: what the coordinates count from.
        free: velocity entries that are independent.
        spins: bodies that spin freely besides.

    Raises:
        SingularError: the coordinates do not determine the motion there.
    """

    projects = False  # whether every step is to be settled, as `Projected` does

    def __init__(
        self, problem: Problem, state: State, free: Sequence[int], spins: Spins | None = None
    ) -> None:
        self.problem, self.free, self.n = problem, list(free), len(free)
        self.spins = spins or Spins(problem, [])
        mechanism = problem.mechanism
        rows = problem.freedoms.equations(state)
        self._is_whole = len(rows) == constraints_of(mechanism).n_closure
        # where others lie between, what a residual leaves open in those left out is magnified
        wanted = problem.tolerance if self._is_whole else TOLERANCES.round_off
        if problem.between and self.n == 1 and not (problem.drives or len(self.spins)):
            wanted = min(wanted, ANCHOR_RESIDUAL)
        if self.projects:
            wanted = min(wanted, PROJECTED_RESIDUAL)
        self._answers = Answers(problem, self.spins, lambda: self.kernel.free)
        arrays = forces_as_arrays(
            problem, self.n, self.spins, self.projects, max(wanted, TOLERANCES.round_off))
        self.kernel = KernelDynamics(mechanism, problem.packed, *arrays, self._answers.asked())
        self.kernel_handle, self.asking = self.kernel.handle, self.kernel.asking
        self._begin(state, rows)

    def _begin(self, state: State, rows: NDArray[np.intp]) -> None:
        mechanism = self.problem.mechanism
        held = self.n + len(self.problem.drives) + len(self.spins)
        if len(rows) + held != mechanism.model.nv:
            raise SingularError(
                f"mechanism {mechanism.name!r}: {mechanism.model.nv - len(rows)} freedoms at "
                f"{state.q}, but {held} independent coordinates")
        sigmas = np.array(self.spins.rates(state.q, state.v))
        begun = self.kernel.begin(state.q, state.angles, sigmas, self.free, rows)
        if not begun or not self.kernel.keep() or self.kernel.pivot < TOLERANCES.singular:
            raise SingularError(f"mechanism {mechanism.name!r}: singular configuration")
        self._note_begun(state)

    def _note_begun(self, state: State) -> None:
        """Note that the coordinates count from a state."""
        by_v = {c.v: c.q for c in self.problem.mechanism.coordinate_table.values()}
        self._answers.begun_at, self._scale = state, self.problem.scale[self.free]
        self._is_linear, self.patience = all(by_v[v] >= 0 for v in self.free), FASTER_THAN_CHOSEN
        self._start = float(state.q[by_v[self.free[0]]]) if self.n and self._is_linear else 0.0

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt; NaN where the loops cannot be closed."""
        return self.kernel.rates(t, y)

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y where the coordinates are 0, at joint velocities v (nv,)."""
        y = self.problem.unknowns(v[self.free] / self._scale, work)
        turns = [self._answers.begun_at.q[body.q] for body in self.spins.bodies]
        return np.concatenate([y[: 2 * self.n], *turns, y[2 * self.n :]])

    def renewed(self, t: float, y: Array, state: State) -> Array | None:
        """Change to the best coordinates at y, where the mechanism is at a state.

        Returns:
            The unknowns in them; None where no coordinates determine it.
        """
        found = self.kernel.renew(t, y)
        if found is None:
            return None
        self.free, fresh, is_same = found
        if is_same:
            self.patience *= 2.0
        else:
            self._note_begun(state)
        return fresh

    def place(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at y.

        Raises:
            Lost: the loops cannot be closed there.
        """
        found = self.kernel.place(t, y)
        if found is None:
            raise Lost
        return found[:2]

    def state(self, t: float, y: Array) -> State:
        """Return the State at y, with velocities.

        Raises:
            Lost: the loops cannot be closed there.
        """
        found = self.kernel.place(t, y)
        if found is None:
            raise Lost
        q, v, angles, error = found
        return State(self.problem.mechanism, q, v, closure_error=error, angles=angles)

    def samples(self, times: Array, unknowns: Array) -> SimulationSamples:
        """Return everything at times (N,) and unknowns (N, n), loops closed.

        Raises:
            Lost: they cannot be at one of them.
        """
        found = self.kernel.samples(times, unknowns)
        if found is None:
            raise Lost
        return found

    def energies(self, t: float, y: Array) -> Energies:
        """Return the energies at y."""
        _, kinetic, total, work = self.samples(np.array([t]), y[None]).numbers[0].tolist()
        return Energies(kinetic, total, work)

    def heaviest(self, t: float, y: Array) -> float:
        """Return the largest inertia of a joint at y, scaled, the others held."""
        self.place(t, y)
        return self.kernel.heaviest

    def needs_new_coordinates(self, t: float, y: Array) -> bool:
        """Whether other independent coordinates, or these begun anew, would be better."""
        if not self._is_linear and np.abs(y[: self.n]).max(initial=0.0) > COORDINATES_END:
            return True
        if self.kernel.place(t, y) is None:
            return True
        return self.kernel.keep() > self.patience

    def crossings(self, y: Array, to: Array) -> list[tuple[float, float]]:
        """Return where branches cross between unknowns: the coordinate, and the unknown there."""
        if self.n != 1:
            return []
        return [(self.coordinate_at(x), x) for x in self.kernel.crossed(float(y[0]), float(to[0]))]

    def coordinate_at(self, x: float) -> float:
        """Return the value of the first independent coordinate at an unknown x."""
        return self._start + float(self._scale[0]) * x

    @property
    def is_fresh_the_same(self) -> bool:
        """Whether the same coordinates, taken anew, would be no better."""
        return self._is_linear and self._is_whole

    @property
    def evaluations(self) -> int:
        """How often it was evaluated."""
        return self.kernel.evaluations

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the equations at the present place."""
        return self.kernel.pivot
