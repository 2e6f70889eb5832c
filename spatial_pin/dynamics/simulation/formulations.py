"""The equations of motion of a simulation, evaluated in the kernel, in one of two formulations.

"independent": in independent coordinates [Wehage1982]. One freedom passes change points (branches
that cross) straight on; bodies that spin freely about a line of symmetry are no freedoms then,
their angular velocity about it is constant.

"projected": in all joint coordinates, the loops kept closed by projection [Eich1993].
Accelerations are those of the independent coordinates' engine, at the nearest configuration with
closed loops; after every step the unknowns are taken there by the shortest way, and velocities to
what the loops allow. Dearer than independent coordinates, which are only used to solve the
equations: the integrated motion does not depend on their choice.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence, Set
from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dynamics.bushings import Bushing
from spatial_pin.dynamics.forces import JointSpring, LineSpring
from spatial_pin.dynamics.simulation.problem import Problem, Spins, free_spins
from spatial_pin.dynamics.simulation.result import Energies, Projection
from spatial_pin.dynamics.solvers.equations_of_motion import no_inertia_error
from spatial_pin.dynamics.solvers.least_constraint import ROUNDING, Bounded, IndependentCoordinates
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.dynamics import Callbacks, KernelDynamics
from spatial_pin.kernel.integrating import SimulationSamples
from spatial_pin.kernel.kernel import Ints
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

GivenUp = Set[tuple[type, tuple[int, ...]]]  # formulations, and their independent coordinates

# A joint this much faster than the independent coordinates replaces one of them: it costs half a
# digit of the joint.
FASTER_THAN_CHOSEN = 4.0
# Closure residual of projected points. Two points are one if they agree to 1e-6 (SAME_PLACE in
# projected.c).
PROJECTED_RESIDUAL = 1e-8
# Rotation vector at which coordinates of joints that turn in space start again from a new
# reference [rad].
COORDINATES_END = 1.0
TURNED_END = 0.5  # the same where all joint coordinates are unknowns [rad]
LEFT_OPEN = 1e-6  # closure residual after a step, before projection, at tight tolerances
LOOSE = 10.0  # the same relative to the tolerance of a step, at loose tolerances
WIDE = 1e-2  # the same at most: from there Newton's method converges to the same branch


class OpenLoopsError(Exception):
    """The loops cannot be closed at some coordinates, or not surely on the branch."""


def force_arrays(
    problem: Problem, n_free: int, spins: Spins, projects: bool, tolerance: float
) -> tuple[Ints, Array]:
    """Return all forces as integers and numbers, for `read_arrays` in creating.c."""
    prescribed = [c.v for c, _ in problem.drives]
    resistance, carriers = problem.forces.resistance, problem.packed.carriers
    lines, turns, bushings = (
        problem.forces.lines, problem.forces.turns, problem.forces.bushings)
    (line_bodies, line_laws, *of_bushings), (points, line_numbers, bushing_numbers) = (
        problem.forces.packed(carriers, problem.packed.frames))
    ints: list[Any] = [
        [n_free, len(prescribed), len(spins.joints), len(lines), len(turns), problem.works,
         projects, len(bushings)],
        prescribed, [carriers[joint] for joint in spins.joints], line_bodies, line_laws,
        [x.q for x in turns], [x.v for x in turns], [not x.is_linear for x in turns], *of_bushings]
    reals: list[Any] = [
        [tolerance], resistance.damping, resistance.friction,
        resistance.slip_speed, problem.model.armature, problem.constant,
        spins.axes, points, line_numbers, [problem.forces.numbers[x.name] for x in turns],
        bushing_numbers]
    return (np.concatenate([np.asarray(x, np.int64).ravel() for x in ints]),
            np.concatenate([np.asarray(x, float).ravel() for x in reals]))


class ForceFunctions:
    """Force functions for the kernel: efforts, laws, and accelerations for any masses.

    Attributes:
        reference: reference state of the coordinates in use.
        callbacks: the functions, None where the kernel need not call one.
    """

    reference: State

    def __init__(self, problem: Problem, spins: Spins, free: Callable[[], list[int]]) -> None:
        self._problem, self._spins, self._free = problem, spins, free
        springs: list[LineSpring | JointSpring | Bushing] = [
            *problem.forces.lines, *problem.forces.turns, *problem.forces.bushings]
        has_laws = not all(spring.is_linear for spring in springs)
        self.callbacks: Callbacks = (
            self._efforts if problem.law or problem.external else None,
            (lambda which, length, rate: float(springs[which].law(length, rate)))  # type: ignore[misc]
            if has_laws else None,
            self._drives if problem.drives else None, self._least)

    @cached_property
    def _evaluation(self) -> LoopEquations:
        return LoopEquations(self._problem.mechanism)

    def _evaluated(self, q: Array, angles: Array) -> LoopEquations:
        self._evaluation.angle_reference[:] = angles
        self._evaluation.update(q)
        return self._evaluation

    def _efforts(self, t: float, q: Array, v: Array, angles: Array) -> Array:
        return self._problem.efforts(t, q, v, self._evaluated(q, angles))

    def _drives(self, t: float) -> Array:
        return np.array([law(t) for _, law in self._problem.drives], float)

    def _least(self, t: float, q: Array, v: Array, a: Array, angles: Array) -> Array | None:
        """Return free accelerations by `LeastConstraint`, for masses that differ much or are zero.

        Motions without inertia have no acceleration, if no force works on them. None if masses
        differ too much for any correct digit.

        Raises:
            SingularError: a force works on a freedom without inertia.
        """
        problem, evaluation = self._problem, self._evaluated(q, angles)
        held = np.eye(len(v))[[c.v for c, _ in problem.drives]]
        rows = evaluation.jacobian[problem.freedoms.equations(self.reference)]
        columns = IndependentCoordinates(
            np.vstack([rows, held, self._spins.rows * problem.scale]), problem.scale,
            evaluation.closure_error, self._free()).columns
        least = problem.least_constraint.solve(
            q, v, Bounded(a, ROUNDING * np.abs(a)), columns,
            problem.joint_forces(t, q, v, evaluation))
        if least.pulled:
            moving = np.abs(least.still / problem.scale).max(axis=0)
            names = problem.mechanism.coordinates
            moved = np.flatnonzero(moving > TOLERANCES.half_precision * moving.max())
            raise no_inertia_error(problem.mechanism, [names[v] for v in moved.tolist()])
        return None if least.lost else least.z


class IndependentFormulation:
    """The right-hand side for the unknowns y.

    These are independent coordinates x, rates u of their joints, quaternions (x, y, z, w) of
    bodies that spin freely, and the work done if any is.

    Args:
        problem: what acts.
        state: reference of the coordinates.
        free: velocity entries that are independent.
        spins: bodies that spin freely besides.

    Raises:
        SingularError: the coordinates do not determine the motion there.
    """

    # whether all joint coordinates are unknowns, and steps are projected: `ProjectedFormulation`
    projects = False

    def __init__(
        self, problem: Problem, state: State, free: Sequence[int], spins: Spins | None = None
    ) -> None:
        self.problem, self.free, self.n = problem, list(free), len(free)
        self.spins = spins or Spins(problem.model, {})
        mechanism = problem.mechanism
        rows = problem.freedoms.equations(state)
        self._is_whole = len(rows) == constraints_of(mechanism).n_closure
        # where others lie between, what a residual leaves open in those left out is magnified
        wanted = problem.closure_of_steps if self._is_whole else TOLERANCES.round_off
        if self.projects:
            wanted = min(wanted, PROJECTED_RESIDUAL)
        self._functions = ForceFunctions(problem, self.spins, lambda: self.kernel.free)
        arrays = force_arrays(
            problem, self.n, self.spins, self.projects, max(wanted, TOLERANCES.round_off))
        held = self.n + len(self.problem.drives) + len(self.spins.joints)
        if len(rows) + held != mechanism.model.nv:
            raise SingularError(
                f"mechanism {mechanism.name!r}: {mechanism.model.nv - len(rows)} freedoms at "
                f"{state.q}, but {held} independent coordinates")
        self.kernel = KernelDynamics(
            mechanism, problem.packed, *arrays, self._functions.callbacks, (
                state.q, state.angles, self.spins.rates(state.q, state.v), self.free, rows))
        self.kernel_handle, self.errors = self.kernel.handle, self.kernel.errors
        if not self.kernel.save_position() or self.kernel.pivot < TOLERANCES.singular:
            raise SingularError(f"mechanism {mechanism.name!r}: singular configuration")
        if self.projects:
            self.free = list(range(mechanism.model.nv))
        self._count_from(state)

    def _count_from(self, state: State) -> None:
        table = list(self.problem.mechanism.coordinate_table.values())
        entries = [table[v].q for v in self.free]
        self._functions.reference, self._scale = state, self.problem.scale[self.free]
        self._is_linear, self.patience = min(entries, default=0) >= 0, FASTER_THAN_CHOSEN
        self._start = float(state.q[entries[0]]) if self.n and self._is_linear else 0.0

    def __call__(self, t: float, y: Array) -> Array:
        """Return dy/dt; NaN where the loops cannot be closed."""
        return self.kernel.rates(t, y)

    def unknowns(self, v: Array, work: float) -> Array:
        """Return y where the coordinates are 0, at joint velocities v (nv,)."""
        q, starts = self._functions.reference.q, self.problem.model.idx_qs
        return np.concatenate([
            np.zeros(len(self.free)), v[self.free] / self._scale,
            *(q[starts[joint]:][:4] for joint in self.spins.joints), [work] * self.problem.works])

    def renewed(self, t: float, y: Array, state: State) -> Array | None:
        """Change to the best independent coordinates at y, which is a state.

        Returns:
            The new unknowns; None if no coordinates determine the motion.
        """
        new = self.kernel.renew(t, y)
        if new is None:
            return None
        self.free, fresh, is_same = new
        if is_same:
            self.patience *= 2.0
        else:
            self._count_from(state)
        return fresh

    def motion_at(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return configuration (nq,) and velocity (nv,) at y.

        Raises:
            OpenLoopsError: the loops cannot be closed there.
        """
        return self._closed(t, y)[:2]

    def state(self, t: float, y: Array) -> State:
        """Return the State at y, with velocities.

        Raises:
            OpenLoopsError: the loops cannot be closed there.
        """
        q, v, angles, error = self._closed(t, y)
        return State(self.problem.mechanism, q, v, closure_error=error, angles=angles)

    def _closed(self, t: float, y: Array) -> tuple[Array, Array, Array, float]:
        closed = self.kernel.motion_at(t, y)
        if closed is None:
            raise OpenLoopsError
        return closed

    def samples(self, times: Array, unknowns: Array) -> SimulationSamples:
        """Return samples at times (N,) and unknowns (N, n), loops closed.

        Raises:
            OpenLoopsError: they cannot be at one of them.
        """
        rows = self.kernel.samples(times, unknowns)
        if rows is None:
            raise OpenLoopsError
        return rows

    def energies(self, t: float, y: Array) -> Energies:
        """Return the energies at y."""
        _, kinetic, total, work = self.samples(np.array([t]), y[None]).numbers[0].tolist()
        return Energies(kinetic, total, work)

    def needs_new_coordinates(self, t: float, y: Array) -> bool:
        """Whether other independent coordinates, or a new reference for these, are better."""
        if not self._is_linear and np.abs(y[: self.n]).max(initial=0.0) > COORDINATES_END:
            return True
        if self.kernel.motion_at(t, y) is None:
            return True
        return self.kernel.save_position() > self.patience

    def crossings(self, y: Array, to: Array) -> list[tuple[float, float]]:
        """Return the branch points between unknowns: coordinate value, and unknown.

        If all joints are unknowns there are none: the loops lose rank at them.
        """
        if self.n != 1 or self.projects:
            return []
        return [(self.coordinate_at(x), x) for x in self.kernel.crossed(float(y[0]), float(to[0]))]

    def coordinate_at(self, x: float) -> float:
        """Return the value of the first independent coordinate at an unknown x."""
        return self._start + float(self._scale[0]) * x

    @property
    def is_unchanged_by_restart(self) -> bool:
        """Whether a restart with the same coordinates changes nothing."""
        return self._is_linear and (self._is_whole or self.projects)


class ProjectedFormulation(IndependentFormulation):
    """The right-hand side for the unknowns y: coordinates x of all joints, rates u, work done.

    Raises:
        SingularError: the loops have lost rank at the state.
    """

    projects = True

    def __init__(self, problem: Problem, state: State, held: Sequence[int]) -> None:
        super().__init__(problem, state, held)
        table = problem.mechanism.coordinate_table.values()
        self._turning = [c.v for c in table if c.q < 0]  # those of balls and free joints
        self.projection = Projection(0, 0, 0.0, 0.0, 0.0)

    def renewed(self, t: float, y: Array, state: State) -> Array | None:
        """Make y the reference of the coordinates; return the unknowns, None if it fails."""
        result = self.kernel.renew(t, y)
        return None if result is None else result[1]

    def settle(self, solver: Any) -> float:
        """Project the solver's state to closed loops and compatible velocities.

        Returns the residual before, relative to the allowed one; above 1 nothing is changed.
        """
        began = time.perf_counter()
        allowed = min(max(LEFT_OPEN, LOOSE * getattr(solver, "rtol", 0.0)), WIDE)
        settled = self.kernel.settle(np.array(solver.y), allowed)
        if settled is None:
            return np.inf
        solver.y, opened, corrections = settled
        solver.f = self(solver.t, solver.y)
        self.kernel.save_position()
        steps, before, most, seconds, share = self.projection
        self.projection = Projection(
            steps + 1, before + corrections, max(most, opened),
            seconds + time.perf_counter() - began, share)
        return opened / allowed

    def needs_new_coordinates(self, t: float, y: Array) -> bool:
        """Whether the coordinates need a new reference."""
        return float(np.abs(y[self._turning]).max(initial=0.0)) > TURNED_END


def independent(
    problem: Problem, state: State, given_up: GivenUp = frozenset()
) -> IndependentFormulation:
    """Return the equations of motion in the independent coordinates that fit a state best.

    For one freedom, free spins not counted, this is the fastest joint with one coordinate that
    has not failed before.

    Raises:
        SingularError: the motion is not determined there.
    """
    free = problem.freedoms.best(state, [c.v for c, _ in problem.drives])
    if not problem.drives:
        spins = Spins(problem.model, {})
        if len(free) > 1 and not problem.external:  # forces from outside may turn bodies
            spins = free_spins(problem.mechanism, state, problem.forces)
        if len(free) - len(spins.joints) == 1:
            for v in problem.freedoms.plain(state, spins.rows):
                if (IndependentFormulation, (v,)) not in given_up:
                    return IndependentFormulation(problem, state, [v], spins)
    return IndependentFormulation(problem, state, free)


def projected(
    problem: Problem, state: State, given_up: GivenUp = frozenset()
) -> IndependentFormulation:
    """Return the equations of motion in all joint coordinates, whatever was given up.

    Raises:
        SpatialPinError: drivers are prescribed, which this formulation does not know.
        SingularError: the motion is not determined there.
    """
    if problem.drives:
        raise SpatialPinError(
            f"mechanism {problem.mechanism.name!r}: the projected formulation prescribes no "
            "drivers; use the independent one")
    return ProjectedFormulation(problem, state, problem.freedoms.best(state, []))


Formulate = Callable[[Problem, State, GivenUp], IndependentFormulation]
FORMULATIONS: dict[str, Formulate] = {
    "independent": independent,
    "projected": projected,
}
