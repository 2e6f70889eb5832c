"""What acts on a mechanism, as the kernel reads it: numbers, and functions that it calls."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.forces import Forces
from spatial_pin.dynamics.simulation.coordinate_partitioning import Lost
from spatial_pin.dynamics.simulation.formulations.free_rotation import Spins
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.solvers.independent_coordinates import (
    ROUNDING,
    Bounded,
    IndependentCoordinates,
)
from spatial_pin.kernel.dynamics import Callbacks
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.kernel.packing import Ints
from spatial_pin.numerics.linalg import Array


def forces_as_arrays(
    problem: Problem, n_free: int, spins: Spins, projects: bool, tolerance: float
) -> tuple[Ints, Array]:
    """Return what `read_arrays` in creating.c reads.

    Args:
        problem: what acts.
        n_free: number of independent coordinates.
        spins: bodies that spin freely besides.
        projects: whether all joint coordinates are unknowns.
        tolerance: closure residual to reach.
    """
    prescribed, bodies = [c.v for c, _ in problem.drives], spins.bodies
    resistance, carriers = problem.forces.resistance, problem.packed.carriers
    frames, lines, turns = problem.packed.frames, problem.forces.lines, problem.forces.turns
    springs = {s.name: (s.stiffness, s.damping, s.free) for s in problem.mechanism.springs}
    ends = [(carriers[j], x[:3]) for line in lines
            for j, x in zip(line.bodies, line.points, strict=True)]
    ints: list[Any] = [
        [n_free, len(prescribed), len(bodies), len(lines), len(turns), problem.works, projects],
        prescribed, [carriers[body.joint] for body in bodies], [j for j, _ in ends],
        [x.energy is None for x in lines], [x.q for x in turns], [x.v for x in turns],
        [x.energy is None for x in turns]]
    reals: list[Any] = [
        [tolerance], resistance.damping, resistance.friction,
        resistance.slip_speed, problem.model.armature, problem.constant,
        [body.axis for body in bodies], [frames[j].T @ x for j, x in ends],
        [springs[x.name] for x in lines], [springs[x.name] for x in turns]]
    return (np.concatenate([np.asarray(x, np.int64).ravel() for x in ints]),
            np.concatenate([np.asarray(x, float).ravel() for x in reals]))


class Answers:
    """What only Python knows: efforts and laws that are functions, accelerations for any masses.

    Args:
        problem: what acts.
        spins: bodies that spin freely.
        free: returns the velocity entries that are independent now.

    Attributes:
        begun_at: what the present coordinates count from.
    """

    begun_at: State

    def __init__(self, problem: Problem, spins: Spins, free: Callable[[], list[int]]) -> None:
        self._problem, self._spins, self._free = problem, spins, free

    def asked(self) -> Callbacks:
        """Return the functions, None where the kernel need not ask."""
        problem = self._problem
        return Callbacks(self._efforts if problem.law or problem.external else None,
                     _laws(problem.forces),
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
        """Return free accelerations by `LeastConstraint`, where masses differ much or are none."""
        problem, evaluation = self._problem, self._evaluated(q, angles)
        held = np.eye(len(v))[[c.v for c, _ in problem.drives]]
        rows = evaluation.jacobian[problem.freedoms.equations(self.begun_at)]
        columns = IndependentCoordinates(
            np.vstack([rows, held, self._spins.rows * problem.scale]), problem.scale,
            evaluation.closure_error, self._free()).columns
        given = problem.given(t, q, v, evaluation)
        try:
            return problem.least(q, v, Bounded(a, ROUNDING * np.abs(a)), columns, given).z
        except Lost:
            return None


def _laws(forces: Forces) -> Any:
    """Return the force of a spring by its number, if any has a law of its own."""
    laws = [line.law for line in forces.lines] + [turn.law for turn in forces.turns]
    if all(x.energy for x in forces.lines) and all(x.energy for x in forces.turns):
        return None
    return lambda which, length, rate: float(laws[which](length, rate))
