"""The equations of motion in all joint coordinates, the loops kept closed by projection.

    [M  J^T] [a      ]   [f - b  ]
    [J   0 ] [-lambda] = [-gamma ]

is solved at every evaluation; after every step the configuration is taken back to closed loops by
the shortest way, and the velocity to what they allow [Eich1993]. Dearer than independent
coordinates, but no coordinates have to be chosen.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.rank_loss import rank_loss
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.dynamics.simulation.independent_coordinates import Lost
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import Energies, Projection
from spatial_pin.dynamics.solvers.accelerations import DOUBTFUL, MotionEquations
from spatial_pin.dynamics.solvers.independent_coordinates import IndependentCoordinates
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.dynamics import Samples
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.numerics.linalg import (
    Array,
    decompose,
    determinant_sign_of,
    independent_rows,
    null_space,
)
from spatial_pin.numerics.tolerances import TOLERANCES

# Chart coordinate at which a chart of joints that turn in space is begun anew [rad].
CHART_WIDTH = 0.5
LEFT_OPEN = 1e-6  # closure residual that a step may leave to be projected away, at tight tolerances
LOOSE = 10.0  # the same relative to the tolerance of a step, at loose ones
WIDE = 1e-2  # the same at any tolerance: from there Newton's method finds the same branch
MOST_CORRECTIONS = 8  # each leaves at most a third: 1e-4 of a residual, or the step is shorter
CONTRACTION = 0.3  # a correction leaves at most this fraction of a residual
CONTRACTED = 1e-9  # residual at which round-off may end that
ILL_CONDITIONED = 1e-2  # pivot ratio below which other coordinates keep their velocities
SINGULAR = 1e-12  # smallest over largest singular value at which the loops have lost rank


class Projected:
    """The right-hand side for the unknowns y: chart coordinates x, their rates u, work done.

    Args:
        problem: what acts; nothing is prescribed.
        state: where the chart begins.

    Raises:
        SpatialPinError: drivers are prescribed, which this formulation does not know.
        SingularError: the loops have lost rank at the state.
    """

    def __init__(self, problem: Problem, state: State) -> None:
        if problem.drives:
            raise SpatialPinError(
                f"mechanism {problem.mechanism.name!r}: the projected formulation prescribes no "
                "drivers; use the independent one")
        self.problem, self.model, self.scale = problem, problem.model, problem.scale
        self.n = problem.model.nv
        self.free = list(range(self.n))
        self.evaluation = Evaluation(constraints_of(problem.mechanism))
        self.evaluation.turns[:] = state.angles
        self.curved = any(not PAIRS[pair].is_linear for pair in problem.mechanism.pairs)
        self.n_rows = self.evaluation.constraints.n_rows
        self.q0 = np.array(state.q)
        self.evaluation.update(self.q0)
        self.selected = independent_rows(self.evaluation.jacobian[: self.n_rows])
        self.tolerance = problem.tolerance
        if len(self.selected) < self.n_rows:  # open loops hide which equations depend on others
            self.tolerance = min(problem.tolerance, TOLERANCES.tight)
        if rank_loss(self.evaluation, self.q0, len(self.selected)):
            raise SingularError(
                f"mechanism {problem.mechanism.name!r}: singular configuration, {state}: the "
                "loops lose rank there", state=state)
        self.evaluations, self.pivot = 0, 1.0
        self.is_fresh_the_same = not self.curved
        self.projection = Projection(0, 0, 0.0, 0.0, 0.0)
        self._corrections, self._opened = 0, 0.0  # of the last time that loops were closed
        self._before: tuple[Array, Array] | None = None  # equations and freedoms at the last step
        self.equations = MotionEquations(problem.mechanism)
        self._uneven = self._are_uneven(self.q0)  # where the loops were closed last
        # coordinates whose motions without inertia go on as they are, the same all along a step
        self._kept: tuple[int, ...] | None = None
        self._is_ill_conditioned = False

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y at the chart's origin, at joint velocities v (nv,)."""
        return self.problem.unknowns(v / self.scale, work)

    def renewed(self, t: float, y: Array, state: State) -> Array | None:
        """Begin the chart anew at a state with closed loops; return the unknowns there."""
        self.q0 = state.q
        return self.unknowns(state.v, self.problem.work(y))

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt; NaN where the loops lose rank."""
        self.evaluations += 1
        q, v = self._place(y)
        try:
            a, given = self._accelerate(t, q, v)
        except Lost:
            return np.full(len(y), np.nan)
        rates = v / self.scale
        if self.curved:
            rates = pin.dDifference(self.model, self.q0, q, pin.ARG1) @ v / self.scale
        power = []
        if self.problem.works:
            power = [float(given @ v) + self.problem.forces.storing(self.evaluation, q, v)]
        return np.concatenate([rates, a / self.scale, power])

    def _place(self, y: Array) -> tuple[Array, Array]:
        """Return q and v of unknowns."""
        n = self.n
        return (pin.integrate(self.model, self.q0, self.scale * y[:n]),
                self.scale * y[n : 2 * n])

    def _accelerate(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return joint accelerations and given joint forces (nv,).

        Raises:
            Lost: the loops lose rank or cannot be closed.
        """
        problem = self.problem
        self._update(q)
        given = problem.given(t, q, v, self.evaluation)
        equations = self.equations
        a = equations.by_kkt(q, v, self.evaluation.turns, given, equations.bodies.needed(q, v),
                             anew=False).copy()
        if self._uneven or equations.kkt.error > DOUBTFUL:
            a = self._least(t, q, v)
        return a, given

    def _least(self, t: float, q: Array, v: Array) -> Array:
        """Return joint accelerations (nv,) where masses differ much, or there are none.

        Those of the nearest place with closed loops: where they are open, even a little, what has
        no inertia seems to have some, and forces on it.

        Raises:
            Lost: the loops lose rank or cannot be closed.
        """
        problem, evaluation = self.problem, self.evaluation
        q, v = self._closed(q, v)
        self._update(q)
        gamma = evaluation.bias(q, v)[self.selected]
        motions = self._motions()
        found = problem.least(q, v, motions.carried(gamma, v), motions.columns,
                              problem.given(t, q, v, evaluation))
        self._kept = tuple(motions.free) if len(found.still) else None
        return found.a

    def _motions(self) -> IndependentCoordinates:
        """Return how coordinates move the others where the evaluation stands.

        What has no inertia goes on in them as it is, and would go on otherwise in others: then the
        same all along a step.

        Raises:
            Lost: the loops lose rank.
        """
        evaluation = self.evaluation
        rows = evaluation.jacobian[self.selected]
        for free in dict.fromkeys((self._kept, None)):
            motions = IndependentCoordinates(rows, self.scale, evaluation.closure_error, free)
            if motions.pivot >= SINGULAR:
                self._is_ill_conditioned = motions.pivot < ILL_CONDITIONED
                return motions
        raise Lost

    def _update(self, q: Array) -> None:
        """Evaluate the loops at q, screws in the turn that closes them best: steps may be long."""
        evaluation = self.evaluation
        evaluation.update(q)
        screws = evaluation.constraints.screws
        if not screws:
            return
        for k, (at, _, pitch) in enumerate(screws):
            open_by = evaluation.residual[at] / pitch if pitch else 0.0
            evaluation.turns[k] = evaluation.angles[k] + open_by
        evaluation.update(q)

    def settle(self, solver: Any) -> float:
        """Take the solver's state back to closed loops and to velocities that they allow.

        Returns the residual that the step had left, relative to what is allowed; above 1 nothing
        has been done.
        """
        began = time.perf_counter()
        n, y = self.n, np.array(solver.y)
        q, v = self._place(y)
        self._choose(q)
        if self._is_ill_conditioned:
            self._kept = None
        allowed = min(max(LEFT_OPEN, LOOSE * getattr(solver, "rtol", 0.0)), WIDE)
        try:
            q, v = self._closed(q, v, allowed)
        except Lost:
            return np.inf
        if self._has_passed_a_singularity():
            return np.inf
        steps, corrections, opened, seconds, share = self.projection
        opened_now, corrections = self._opened, corrections + self._corrections
        y[:n] = pin.difference(self.model, self.q0, q) / self.scale
        y[n : 2 * n] = v / self.scale
        solver.y = y
        solver.f = self(solver.t, y)
        self._uneven = self._loses_digits
        self.projection = Projection(
            steps + 1, corrections, max(opened, opened_now),
            seconds + time.perf_counter() - began, share)
        return opened_now / allowed

    def _has_passed_a_singularity(self) -> bool:
        """Whether loops have lost rank since the last step, the evaluation standing at this one.

        One derivative of the loops vanishes there and comes back with the other sign: so does the
        determinant of the equations with the freedoms of before.
        """
        now, chosen = self.evaluation.jacobian[: self.n_rows].copy(), self.selected
        if self._before is not None:
            signs = [determinant_sign_of(np.vstack([jacobian[chosen], self._before[1]]))
                     for jacobian in (self._before[0], now)]
            if signs[0] * signs[1] < 0:
                return True
        self._before = now, null_space(now[chosen])
        return False

    def _choose(self, q: Array) -> None:
        """Choose the independent equations anew, where there is a choice."""
        if len(self.selected) < self.n_rows:
            self._update(q)
            found = independent_rows(self.evaluation.jacobian[: self.n_rows])
            if len(found) == len(self.selected):
                self.selected = found
            self._are_uneven(q)

    def _are_uneven(self, q: Array) -> bool:
        """Choose equations of the KKT system at q; whether it loses digits with them."""
        none = np.zeros(self.n)
        self.equations.by_kkt(q, none, self.evaluation.turns, none, none)
        return self._loses_digits

    @property
    def _loses_digits(self) -> bool:
        """Whether the KKT system did, or had not as many equations as are independent."""
        kkt = self.equations.kkt
        return kkt.error > DOUBTFUL or kkt.rank != len(self.selected)

    def _closed(self, q: Array, v: Array, allowed: float = WIDE) -> tuple[Array, Array]:
        """Return the nearest configuration with closed loops, and the nearest velocity there.

        Raises:
            Lost: they are open by more than is allowed, or do not close.
        """
        evaluation, last = self.evaluation, allowed
        for k in range(MOST_CORRECTIONS):
            self._update(q)
            worst = evaluation.closure_error
            if k == 0:
                self._opened = worst
            if not worst < last:
                if k and worst < CONTRACTED:
                    break
                raise Lost
            self._corrections, last = k, CONTRACTION * worst
            svd = decompose(evaluation.jacobian[self.selected])
            if worst <= self.tolerance:
                break
            q = pin.integrate(self.model, q,
                              -self.scale * svd.minimum_norm(evaluation.residual[self.selected]))
        if svd.s.size:
            self.pivot = float(svd.s[-1] / svd.s[0])
        violation = evaluation.jacobian[self.selected] @ (v / self.scale)
        return q, v - self.scale * svd.minimum_norm(violation)

    def place(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at y."""
        return self._closed(*self._place(y))

    def state(self, t: float, y: Array) -> State:
        """Return the State at y, with velocities."""
        q, v = self._closed(*self._place(y))
        return self.problem.state(q, v, self.evaluation)

    def energies(self, t: float, y: Array) -> Energies:
        """Return the energies at y."""
        state = self.state(t, y)
        return self.problem.energies(state.q, state.v, self.evaluation, self.problem.work(y))

    def samples(self, times: Array, unknowns: Array) -> Samples:
        """Return everything at times (N,) and unknowns (N, n), loops closed."""
        samples = [self._sample(t, y) for t, y in zip(times.tolist(), unknowns, strict=True)]
        return Samples(*map(np.array, zip(*samples, strict=True)))

    def crossings(self, y: Array, to: Array) -> list[tuple[float, float]]:
        """Return nothing: where branches cross the loops lose rank."""
        return []

    def _sample(self, t: float, y: Array) -> tuple[Array, ...]:
        q, v = self._closed(*self._place(y))
        a, _ = self._accelerate(t, q, v)
        error = self.evaluation.closure_error
        energies = self.problem.energies(q, v, self.evaluation, self.problem.work(y))
        return (q, v, a, np.array([error, *energies]), np.empty(0), self.evaluation.angles.copy())

    def heaviest(self, t: float, y: Array) -> float:
        """Return the largest inertia of a joint at y, scaled, the others held."""
        return self.problem.heaviest(self._place(y)[0])

    def needs_new_chart(self, t: float, y: Array) -> bool:
        """Whether the chart should be begun anew."""
        return self.curved and float(np.abs(y[: self.n]).max()) > CHART_WIDTH
