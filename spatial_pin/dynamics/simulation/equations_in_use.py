"""The equations of motion in use: in some coordinates, and in others where these end.

Where none can be followed the error says why: one cause, with the number that shows it and a
remedy.
"""

from __future__ import annotations

import time

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.coordinate_partitioning import Lost
from spatial_pin.dynamics.simulation.formulations import (
    Formulate,
    GivenUp,
    Independent,
    Projected,
)
from spatial_pin.dynamics.simulation.integrators import Stepping
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.record import Record
from spatial_pin.dynamics.simulation.result import Projection
from spatial_pin.dynamics.solvers.independent_coordinates import IndependentCoordinates
from spatial_pin.errors import SingularError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at
from spatial_pin.numerics.linalg import Array, decompose, independent_rows
from spatial_pin.settings import Accuracy

FALLEN = 1e-3  # of what it was at the start: a singular value is on its way to zero


class EquationsInUse:
    """Takes one formulation and its coordinates after the other.

    Args:
        problem: what acts.
        accuracy: that was asked for.
        formulate: makes the equations of motion for a state, of no kind that was given up.
        record: where the coordinates are noted.
        stepping: the lengths of the steps.

    Attributes:
        system: the equations in use, once there are some.
    """

    def __init__(
        self, problem: Problem, accuracy: Accuracy, formulate: Formulate, record: Record,
        stepping: Stepping,
    ) -> None:
        self._problem, self._accuracy, self._formulate = problem, accuracy, formulate
        self._record, self._stepping = record, stepping
        self.system: Independent | None = None
        self._first: State | None = None
        self._projections: list[Projection] = []  # of the equations of motion used before
        self._begun_at, self._failed_at = 0.0, -1.0
        self._given_up: set[tuple[type, tuple[int, ...]]] = set()  # at the time of the failure
        self._began = time.perf_counter()

    def begin(self, t: float, state: State, given_up: GivenUp = frozenset()) -> Independent:
        """Return equations of motion that begin at a state.

        Raises:
            SingularError: there are none.
        """
        if self._first is None:
            self._first = state
        if isinstance(self.system, Projected):
            self._projections.append(self.system.projection)
        self.system = system = self._formulate(self._problem, state, given_up)
        if (type(system), tuple(system.free)) in given_up:
            raise self.singular(t, state)
        self._note_begun(system, t)
        return system

    def begin_again(
        self, system: Independent, t: float, y: Array, failed: bool
    ) -> tuple[Independent, Array]:
        """Choose other independent coordinates, or begin anew; return them and the unknowns there.

        Raises:
            SingularError: none can be followed.
        """
        state = system.state(t, y)
        renewed = None if failed else system.renewed(t, y, state)
        if renewed is not None:
            self._note_begun(system, t)
            return system, renewed
        if failed:  # what has failed at the present time is given up
            if not self._stepping.is_short(t - self._failed_at):
                self._failed_at = t
                self._given_up.clear()
            if system.is_fresh_the_same or self._stepping.is_short(t - self._begun_at):
                self._given_up.add((type(system), tuple(system.free)))
        try:
            fresh = self.begin(t, state, self._given_up if failed else frozenset())
        except SingularError as error:
            if self._stepping.is_short(t):  # what is said of a start
                raise
            raise self.singular(t, state) from error
        return fresh, fresh.unknowns(state.v, self._problem.work(y))

    def singular(self, t: float, state: State) -> SingularError:
        """Return the error of a motion that cannot be followed beyond a time [s]."""
        return SingularError(
            f"mechanism {self._problem.mechanism.name!r}: the motion cannot be followed beyond "
            f"{t:.9g} s: {self._why(t, state)}; it is at {state}", state=state)

    def why(self, t: float, y: Array) -> str:
        """Return why the motion cannot be followed beyond unknowns y at a time [s]."""
        assert self._first is not None
        if self.system is None:
            return self._why(t, self._first)
        try:
            return self._why(t, self.system.state(t, y))
        except Lost:
            return "the loops cannot be closed there as on the way to it"

    def _why(self, t: float, state: State) -> str:
        return why_it_ends(self._problem, self._accuracy, self._first or state, t, state)

    def _note_begun(self, system: Independent, t: float) -> None:
        self._record.note_coordinates(system.free)
        self._begun_at = t

    def projection(self) -> Projection | None:
        """Return what projecting has taken, if anything was projected."""
        if not isinstance(self.system, Projected):
            return None
        parts = [*self._projections, self.system.projection]
        seconds = sum(part.seconds for part in parts)
        return Projection(
            sum(part.steps for part in parts), sum(part.corrections for part in parts),
            max(part.opened for part in parts), seconds,
            seconds / (time.perf_counter() - self._began))


def why_it_ends(problem: Problem, accuracy: Accuracy, first: State, t: float, last: State) -> str:
    """Return the cause, in words.

    The loops are looked at first, then the forces, then the masses: each makes what comes after
    it look bad too.

    Args:
        problem: what acts.
        accuracy: that was asked for.
        first: where the simulation began, at time 0.
        t: when it ends [s].
        last: the last good state.
    """
    lost = _lost_rank(problem, first, last)
    if lost:
        return lost
    with np.errstate(all="ignore"):
        start, _, _ = _accelerations(problem, 0.0, first)
        a, error, given = _accelerations(problem, t, last)
        found = (_forces(problem, start, last.q, a, given)
                 or _masses(problem, accuracy, start, a, error))
    return found or (
        f"steps however short miss the time_tolerance of {accuracy.time_tolerance:.1e}, though "
        "loops, masses and the size of forces are well there: a force law that jumps or is "
        "not smooth does that; make it smooth, or take Accuracy(integrator='RK4', step=...)")


def _accelerations(problem: Problem, t: float, state: State) -> tuple[Array, float, Array]:
    """Return the accelerations (nv,) of least constraint, which hold for any masses.

    With their round-off, relative to the largest of them, and the joint forces (nv,) given.
    """
    evaluation, loops, rows = _rows(problem, state)
    picked = independent_rows(rows)
    motions = IndependentCoordinates(rows[picked], problem.scale, evaluation.closure_error)
    q, v = state.q, state.v
    bias = np.array([*evaluation.bias(q, v)[: len(loops)],
                     *(-law(t)[2] / problem.scale[c.v] for c, law in problem.drives)])
    given = problem.given(t, q, v, evaluation)
    found = problem.least_constraint.solve(
        q, v, motions.carried(bias[picked], v), motions.columns, given)
    return found.a, 1.0 if found.lost else found.error, given


def _rows(problem: Problem, state: State) -> tuple[LoopEquations, Array, Array]:
    """Return an evaluation at a state, the loops' rows, and those with the prescribed ones."""
    evaluation = loops_at(problem.mechanism, state.q, state.angles)
    loops = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
    drives = np.eye(problem.model.nv)[[c.v for c, _ in problem.drives]]
    return evaluation, loops, np.vstack([loops, drives])


def _lost_rank(problem: Problem, first: State, last: State) -> str:
    before, now = (_rows(problem, state)[1:] for state in (first, last))
    fallen = []
    for rows, there, part in zip(before, now, (FALLEN, FALLEN**0.5), strict=True):
        # at a limit position of a coordinate, a singular value falls as the root of what is left
        rank = len(independent_rows(rows))
        least = _least(rows, rank), _least(there, rank)
        fallen.append(least[1] < part * least[0])
        numbers = (f"the smallest singular value has fallen from {least[0]:.1e} to "
                   f"{least[1]:.1e} of the largest")
        if fallen == [True]:
            return (f"just ahead the loops lose rank ({numbers}), and forces do not determine how "
                    "it goes on there; end before it, or start so that it is not met; "
                    "sp.mobility tells about it")
    if not fallen[1]:
        return ""
    names = ", ".join(c.name for c, _ in problem.drives)
    return (f"just ahead is a limit position of the prescribed {names}: with it held the loops "
            f"lose rank ({numbers}); end before it, or prescribe another coordinate")


def _least(rows: Array, rank: int) -> float:
    """Return the smallest of as many singular values as there are independent rows, 1 if none."""
    s = decompose(rows).s
    return float(s[rank - 1] / s[0]) if rank else 1.0


def _masses(
    problem: Problem, accuracy: Accuracy, start: Array, a: Array, error: float
) -> str:
    if error > accuracy.time_tolerance:
        grown = f"accelerations are known to {error:.1e} of their size only"
    elif _have_grown(problem, start, a):  # not by forces
        at = int(np.abs(a / problem.scale).argmax())
        c = {c.v: c for c in problem.mechanism.coordinate_table.values()}[at]
        grown = (f"{c.name} is accelerated by {a[at]:.3g} {c.unit}/s² (at the start "
                 f"{start[at]:.3g}), though no effort or spring pulls")
    else:
        return ""
    model = problem.model
    moved = sorted((body.mass, joint) for joint, body in enumerate(model.inertias)
                   if joint and body.mass > 0.0)
    words = [f"{mass:.3g} kg (moved by joint {model.names[joint]!r})" for mass, joint in moved]
    light, heavy = (words[0], words[-1]) if words else ("no mass", "no mass")
    if light == heavy:
        return (f"links have no inertia: {grown}; the only body with a mass has {light}; give the "
                "links that it moves some")
    return (f"masses differ too much: {grown}; the lightest body has {light}, the heaviest "
            f"{heavy}; make the masses more alike, or the light ones zero")


def _have_grown(problem: Problem, start: Array, a: Array) -> bool:
    """Whether accelerations are far beyond those at the start."""
    before, now = (np.abs(x / problem.scale).max(initial=0.0) for x in (start, a))
    return bool(FALLEN * now > before)


def _forces(problem: Problem, start: Array, q: Array, a: Array, given: Array) -> str:
    units = problem.scale
    if not np.isfinite(a).all():
        return ("the accelerations there are no finite numbers: look at the force laws and at how "
                "fast it moves")
    needed = problem.bodies.matrix(q) @ a * units
    have_part = np.abs(given * units).max(initial=0.0) > FALLEN * np.abs(needed).max(initial=0.0)
    if not (_have_grown(problem, start, a) and have_part):
        return ""
    at, pulled = int(np.abs(a / units).argmax()), int(np.abs(given * units).argmax())
    by_v = {c.v: c for c in problem.mechanism.coordinate_table.values()}
    moves, pulls = by_v[at], by_v[pulled]
    force = f"a force of {given[pulled]:.3g} {'N' if pulls.unit == 'm' else 'N·m'} at {pulls.name}"
    return (f"forces grow without bound: {moves.name} is accelerated by {a[at]:.3g} "
            f"{moves.unit}/s² (at the start {start[at]:.3g}), and efforts, springs and friction "
            f"make {force}; bound the force law there, or end before with stop_when=")
