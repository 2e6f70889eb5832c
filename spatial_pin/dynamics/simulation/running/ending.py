"""Why a simulation cannot go on: one cause, with the number that shows it and a remedy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.solvers.independent_coordinates import IndependentCoordinates
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at
from spatial_pin.numerics.linalg import Array, decompose, independent_rows
from spatial_pin.settings import Accuracy

FALLEN = 1e-3  # of what it was at the start: a singular value is on its way to zero


class RunPoint(NamedTuple):
    """Where a simulation begins or ends.

    Attributes:
        t: when [s].
        state: configuration and velocity.
        a: (nv,) joint accelerations.
        error: their round-off, relative to the largest of them.
    """

    t: float
    state: State
    a: Array
    error: float


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
        start, end = _place(problem, 0.0, first), _place(problem, t, last)
        return (_forces(problem, start, end) or _masses(problem, accuracy, start, end)
                or _steps(accuracy))


def _place(problem: Problem, t: float, state: State) -> RunPoint:
    """Return a place with the accelerations of least constraint, which hold for any masses."""
    evaluation, loops, rows = _rows(problem, state)
    picked = independent_rows(rows)
    motions = IndependentCoordinates(rows[picked], problem.scale, evaluation.closure_error)
    q, v = state.q, state.v
    bias = np.array([*evaluation.bias(q, v)[: len(loops)],
                     *(-law(t)[2] / problem.scale[c.v] for c, law in problem.drives)])
    found = problem.least_constraint.solve(
        q, v, motions.carried(bias[picked], v), motions.columns,
        problem.given(t, q, v, evaluation))
    return RunPoint(t, state, found.a, 1.0 if found.lost else found.error)


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


def _masses(problem: Problem, accuracy: Accuracy, start: RunPoint, end: RunPoint) -> str:
    if end.error > accuracy.time_tolerance:
        grown = f"accelerations are known to {end.error:.1e} of their size only"
    elif _grown(problem, start, end):  # not by forces
        units = problem.scale
        at = int(np.abs(end.a / units).argmax())
        c = {c.v: c for c in problem.mechanism.coordinate_table.values()}[at]
        grown = (f"{c.name} is accelerated by {end.a[at]:.3g} {c.unit}/s² (at the start "
                 f"{start.a[at]:.3g}), though no effort or spring pulls")
    else:
        return ""
    light, heavy = _lightest_and_heaviest(problem)
    if light == heavy:
        return (f"links have no inertia: {grown}; the only body with a mass has {light}; give the "
                "links that it moves some")
    return (f"masses differ too much: {grown}; the lightest body has {light}, the heaviest "
            f"{heavy}; make the masses more alike, or the light ones zero")


def _grown(problem: Problem, start: RunPoint, end: RunPoint) -> bool:
    """Whether accelerations are far beyond those at the start."""
    before, now = (np.abs(place.a / problem.scale).max(initial=0.0) for place in (start, end))
    return bool(FALLEN * now > before)


def _is_pulled(problem: Problem, end: RunPoint) -> bool:
    """Whether efforts, springs and friction have a part in the accelerations."""
    q, v = end.state.q, end.state.v
    given = problem.given(end.t, q, v, _rows(problem, end.state)[0]) * problem.scale
    needed = problem.bodies.matrix(q) @ end.a * problem.scale
    return bool(np.abs(given).max(initial=0.0) > FALLEN * np.abs(needed).max(initial=0.0))


def _lightest_and_heaviest(problem: Problem) -> tuple[str, str]:
    """Return the bodies of the least and the largest mass, in words."""
    model = problem.model
    moved = sorted((body.mass, joint) for joint, body in enumerate(model.inertias)
                   if joint and body.mass > 0.0)
    if not moved:
        return "no mass", "no mass"
    return tuple(f"{mass:.3g} kg (moved by joint {model.names[joint]!r})"
                 for mass, joint in (moved[0], moved[-1]))  # type: ignore[return-value]


def _forces(problem: Problem, start: RunPoint, end: RunPoint) -> str:
    units = problem.scale
    if not np.isfinite(end.a).all():
        return ("the accelerations there are no finite numbers: look at the force laws and at how "
                "fast it moves")
    if not (_grown(problem, start, end) and _is_pulled(problem, end)):
        return ""
    given = problem.given(end.t, end.state.q, end.state.v, _rows(problem, end.state)[0])
    at, pulled = int(np.abs(end.a / units).argmax()), int(np.abs(given * units).argmax())
    by_v = {c.v: c for c in problem.mechanism.coordinate_table.values()}
    moves, pulls = by_v[at], by_v[pulled]
    force = f"a force of {given[pulled]:.3g} {'N' if pulls.unit == 'm' else 'N·m'} at {pulls.name}"
    return (f"forces grow without bound: {moves.name} is accelerated by {end.a[at]:.3g} "
            f"{moves.unit}/s² (at the start {start.a[at]:.3g}), and efforts, springs and friction "
            f"make {force}; bound the force law there, or end before with stop_when=")


def _steps(accuracy: Accuracy) -> str:
    return (f"steps however short miss the time_tolerance of {accuracy.time_tolerance:.1e}, though "
            "loops, masses and the size of forces are well there: a force law that jumps or is "
            "not smooth does that; make it smooth, or take Accuracy(integrator='RK4', step=...)")
