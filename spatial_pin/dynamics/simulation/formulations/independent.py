"""The equations of motion in independent coordinates [Wehage1982], evaluated in the kernel.

One freedom passes change points (branches that cross) straight on; bodies that spin freely about
a line of symmetry are no freedoms then, their angular velocity about it is constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.continuation.branch import TIGHT
from spatial_pin.dynamics.forces import Forces, joint_efforts
from spatial_pin.dynamics.simulation.formulations.free_rotation import Spins
from spatial_pin.dynamics.simulation.independent_coordinates import Lost
from spatial_pin.dynamics.simulation.problem import Problem, Samples
from spatial_pin.dynamics.simulation.result import Energies
from spatial_pin.dynamics.solvers.kkt import ROUNDING, Blurred, Motions
from spatial_pin.errors import SingularError
from spatial_pin.kernel.dynamics import Acting, Dynamics, Held, Line, Turn
from spatial_pin.mechanism.mechanism import Spring
from spatial_pin.numerics.linalg import Array

FAST = 4.0  # speed of a joint, by the independent coordinates', at which others are taken
FAR = 1.0  # chart coordinate at which a chart of joints that turn in space is begun anew [rad]
USELESS = 1e-7  # pivots below which no chart is begun
FINEST = 1e-14  # closure residual that can be reached anywhere
TURN = 2.0 * np.pi


class Independent:
    """The right-hand side for the unknowns y.

    These are chart coordinates x, rates u of their joints, quaternions (x, y, z, w) of bodies that
    spin freely, and the work done if any is.

    Args:
        problem: what acts.
        state: where the chart begins.
        free: velocity entries that are independent.
        spins: bodies that spin freely besides.

    Raises:
        SingularError: the coordinates do not determine the motion there.
    """

    projection = None

    def __init__(
        self, problem: Problem, state: State, free: Sequence[int], spins: Spins | None = None
    ) -> None:
        self.problem, self.free, self.n = problem, list(free), len(free)
        self.spins = spins or Spins(problem, [])
        self.patience = FAST
        mechanism = problem.mechanism
        self._prescribed = [c.v for c, _ in problem.drives]
        self._scale = problem.scale[self.free]
        self._q0 = state.q
        places = {c.v: c.q for c in mechanism.coordinate_table.values() if c.q >= 0}
        held = [*self.free, *self._prescribed]
        self._is_linear = all(v in places for v in held)
        self._start = float(state.q[places[free[0]]]) if self.n and free[0] in places else 0.0
        self._seen = 0.0
        self._rows = problem.freedoms.equations(state)
        self._is_whole = len(self._rows) == constraints_of(mechanism).n_rows
        wanted = problem.tolerance if self._is_whole else min(problem.tolerance, TIGHT)
        self.kernel = Dynamics(mechanism, problem.packed, self._held(places), self._acting(state),
                               self._least, max(wanted, FINEST))
        self.kernel_handle, self.asking = self.kernel.handle, self.kernel.asking
        self._begin(state)

    def _held(self, places: dict[int, int]) -> Held:
        table = {c.v: c for c in self.problem.mechanism.coordinate_table.values()}
        turns = self.n == 1 and table[self.free[0]].unit == "rad"
        carriers = self.problem.mechanism.model
        joints = {}
        for v in self.free:
            if v not in places:
                joint = next(i for i in range(1, carriers.njoints)
                             if 0 <= v - carriers.idx_vs[i] < carriers.nvs[i])
                joints[v] = joint, v - carriers.idx_vs[joint]
        period = TURN / float(self._scale[0]) if turns else 0.0
        return Held(self.free, self._prescribed, places, joints, period,
                    [(body.joint, body.axis) for body in self.spins.bodies])

    def _acting(self, state: State) -> Acting:
        problem, forces = self.problem, self.problem.forces
        resistance = forces.resistance
        springs = {spring.name: spring for spring in problem.mechanism.springs}
        lines = [Line(line.bodies, (line.points[0][:3], line.points[1][:3]),
                      _constants(springs[line.name]), line.energy is None)
                 for line in forces.lines]
        turns = [Turn(turn.q, turn.v, _constants(springs[turn.name]), turn.energy is None)
                 for turn in forces.turns]
        return Acting(
            resistance.damping, resistance.friction, resistance.slip_speed,
            problem.model.armature, problem.constant, lines, turns,
            self._efforts if problem.law is not None else None, _laws(forces),
            self._drives if problem.drives else None, problem.works,
            problem.heaviest(state.q))

    def _begin(self, state: State) -> None:
        mechanism = self.problem.mechanism
        held = self.n + len(self._prescribed) + len(self.spins)
        if len(self._rows) + held != mechanism.model.nv:
            raise SingularError(
                f"mechanism {mechanism.name!r}: {mechanism.model.nv - len(self._rows)} freedoms at "
                f"{state.q}, but {held} independent coordinates")
        self._sigmas = self.spins.rates(state.q, state.v)
        begun = self.kernel.begin(state.q, state.angles, np.array(self._sigmas), self._rows)
        if not begun or not self.kernel.keep() or self.kernel.pivot < USELESS:
            raise SingularError(f"mechanism {mechanism.name!r}: singular configuration")

    # ---- what the kernel asks ----

    @cached_property
    def _evaluation(self) -> Evaluation:
        return Evaluation(constraints_of(self.problem.mechanism))

    def _efforts(self, t: float, q: Array, v: Array, angles: Array) -> Array:
        problem = self.problem
        assert problem.law is not None
        state = State(problem.mechanism, q, v, closure_error=self._error_at(q, angles),
                      angles=angles)
        return joint_efforts(problem.mechanism, problem.law(t, state))

    def _error_at(self, q: Array, angles: Array) -> float:
        self._evaluation.turns[:] = angles
        self._evaluation.update(q)
        return self._evaluation.closure_error

    def _drives(self, t: float) -> Array:
        return np.array([law(t) for _, law in self.problem.drives], float)

    def _least(self, t: float, q: Array, v: Array, a: Array, angles: Array) -> Array | None:
        """Return free accelerations by `LeastConstraint`, where masses differ much or are none."""
        problem, evaluation = self.problem, self._evaluation
        evaluation.turns[:] = angles
        evaluation.update(q)
        held = np.zeros((len(self._prescribed), len(v)))
        held[np.arange(len(held)), self._prescribed] = 1.0
        spun = self.spins.rows * problem.scale
        columns = Motions(np.vstack([evaluation.jacobian[self._rows], held, spun]), problem.scale,
                          evaluation.closure_error, self.free).columns
        given = problem.given(t, q, v, evaluation)
        try:
            return problem.least(q, v, Blurred(a, ROUNDING * np.abs(a)), columns, given).z
        except Lost:
            return None

    # ---- what the simulation asks ----

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt; NaN where the loops cannot be closed."""
        return self.kernel.rates(t, y)

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y at the chart's origin, at joint velocities v (nv,)."""
        y = self.problem.unknowns(v[self.free] / self._scale, work)
        turns = [self._q0[body.q] for body in self.spins.bodies]
        return np.concatenate([y[: 2 * self.n], *turns, y[2 * self.n :]])

    def choice(self, state: State) -> list[int]:
        """Return the velocity entries that would be the best independent ones at a state."""
        if self.n == 1 and not self._prescribed:
            return self.problem.freedoms.plain(state, self.spins.rows)[:1]
        return self.problem.freedoms.best(state, self._prescribed)

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

    def rows(self, times: Array, unknowns: Array) -> Samples:
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
        _, kinetic, total, work = self.rows(np.array([t]), y[None]).numbers[0].tolist()
        return Energies(kinetic, total, work)

    def settle(self, solver: Any) -> float:
        """Return 0 and do nothing: every evaluation closes the loops."""
        return 0.0

    def is_worn(self, t: float, y: Array) -> bool:
        """Whether other independent coordinates, or a chart begun anew, would be better."""
        if not self._is_linear and np.abs(y[: self.n]).max(initial=0.0) > FAR:
            return True
        if self.kernel.place(t, y) is None:
            return True
        return self.kernel.keep() > self.patience

    def crossings_to(self, y: Array) -> list[tuple[float, float]]:
        """Return where branches crossed since the last call: the coordinate, and the unknown y0."""
        if self.n != 1:
            return []
        before, self._seen = self._seen, float(y[0])
        return [(self.coordinate_at(x), x) for x in self.kernel.crossed(before, self._seen)]

    def coordinate_at(self, x: float) -> float:
        """Return the value of the first independent coordinate at a chart coordinate."""
        return self._start + float(self._scale[0]) * x

    def seen(self, y: Array) -> None:
        """Take it that crossings on the way to y are known."""
        self._seen = float(y[0]) if self.n else 0.0

    @property
    def evaluations(self) -> int:
        """How often it was evaluated."""
        return self.kernel.evaluations

    @property
    def pivot(self) -> float:
        """Smallest over largest pivot of the equations at the present place."""
        return self.kernel.pivot

    @property
    def is_fresh_the_same(self) -> bool:
        """Whether the same coordinates, taken anew, would be no better."""
        return self._is_linear and self._is_whole


def _constants(spring: Spring) -> tuple[float, float, float]:
    return spring.stiffness, spring.damping, spring.free


def _laws(forces: Forces) -> Any:
    """Return the force of a spring by its number, if any has a law of its own."""
    laws = [line.law for line in forces.lines] + [turn.law for turn in forces.turns]
    if all(x.energy for x in forces.lines) and all(x.energy for x in forces.turns):
        return None
    return lambda which, length, rate: float(laws[which](length, rate))
