"""Dimensional synthesis: find dimensions with which a mechanism meets goals."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from spatial_pin._support.checks import checked, whole_number
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.bounds import bounds_of
from spatial_pin.dimensions.variants import EvaluatedBatch, tell_idle
from spatial_pin.errors import unless_cut
from spatial_pin.mechanism.coordinates import require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.demands import Swing
from spatial_pin.synthesis.design_problem import ProblemSpec
from spatial_pin.synthesis.global_search import searched
from spatial_pin.synthesis.precision import Goal, PathGoal, PosesGoal, Precision
from spatial_pin.synthesis.ranked_designs import Designs, designs_of


def refuse_contradictions(mechanism: Mechanism, goals: Sequence[Goal]) -> None:
    """Refuse exact goals with different targets for the same values of the drivers.

    Also two different swings of one output over one motion. Goals with a weight, a free placement
    or free zeros are not checked, nor goals with free timing.
    """
    exact = [goal for goal in goals if isinstance(goal, Precision) and goal.weight is None
             and goal.drivers and not goal.own_names and not goal.input_offset]
    for first, second in itertools.combinations_with_replacement(exact, 2):
        for i, j in _pairs(mechanism, first, second):
            raise ValueError(
                f"goals contradict: {first.name}, sample {i}, and {second.name}, sample {j}, have "
                "the same drivers and other targets; give one of them a weight, or leave it out")

    def moved(swing: Swing) -> tuple[str, str, list[float] | None]:
        return (mechanism.driven_coordinate(swing.moved_by(mechanism)).name,
                mechanism.coordinate(swing.output).name,
                None if swing.at is None else swing.at.tolist())

    swings = [goal for goal in goals if isinstance(goal, Swing) and goal.weight is None]
    for one, other in itertools.combinations(swings, 2):
        if moved(one) == moved(other) and one.angle != other.angle:
            raise ValueError(
                f"goals contradict: {one.name} is to be {one.angle:g} and {other.angle:g}; give "
                "one of them a weight, or leave it out")


def exact_points(goals: Sequence[Goal]) -> list[PathGoal | PosesGoal]:
    """Return the exact goals with points in the world."""
    return [goal for goal in goals if isinstance(goal, PathGoal | PosesGoal)
            and goal.weight is None and not goal.own_names]


def refuse_off_plane(bodies: EvaluatedBatch, goals: Sequence[Goal]) -> None:
    """Refuse exact points off the plane, or line, of the frame's motion."""
    size = bodies.mechanism.characteristic_length
    if not len(bodies.q):
        return
    for goal in exact_points(goals):
        origin = bodies.origin(goal.frame)
        moved = bodies.frame_jacobian(goal.frame, origin)[:, :3]
        ways = np.concatenate([moved.transpose(0, 2, 1).reshape(-1, 3), origin - origin[0]])
        svd = decompose(ways, TOLERANCES.half_precision)
        off = np.linalg.norm((goal.points - origin[0]) @ svd.vt[svd.rank :].T, axis=1)
        worst = int(np.argmax(off))
        if off[worst] > TOLERANCES.nothing * size:
            raise ValueError(
                f"{goal.name}: whatever the dimensions are, {goal.frame!r} stays "
                f"{('at a point', 'on a line', 'in a plane')[svd.rank]}, and sample {worst} is "
                f"{off[worst]:.3g} m off it; ask for points there, or give the goal a weight or "
                "a free placement")


def _pairs(mechanism: Mechanism, first: Precision, second: Precision) -> Iterator[tuple[int, int]]:
    """Yield numbers of samples with equal drivers and different targets."""
    names = {mechanism.driven_coordinate(name).name: name for name in first.drivers}
    others = {mechanism.driven_coordinate(name).name: name for name in second.drivers}
    if names.keys() != others.keys() or first.name != second.name:
        return
    here = np.array([first.drivers[name] for name in names.values()]).T
    there = np.array([second.drivers[others[name]] for name in names]).T
    size = max(1.0, mechanism.characteristic_length)
    wanted, other = (goal.targets(mechanism, np.empty(0)).reshape(len(goal), -1)
                     for goal in (first, second))
    for i, j in itertools.product(range(len(first)), range(len(second))):
        away = wanted[i] - other[j]
        if len(away) == 1:  # angles, the only single numbers, are the same but for whole turns
            away = 2.0 * np.sin(0.5 * away)
        if np.abs(here[i] - there[j]).max() <= TOLERANCES.round_off and (
                np.abs(away).max() > TOLERANCES.tight * size):
            yield i, j


@checked
def design(
    mechanism: Mechanism,
    goals: Goal | Iterable[Goal],
    dimensions: Iterable[str] | Mapping[str, Any],
    *,
    guess: Mapping[str, Any] | State | Array | None = None,
    starts: int = 20,
    method: str = "multistart",
    seed: int = 0,
    executor: Executor | None = None,
    progress: bool = False,
    resume: str | Path | None = None,
    most: int = 10,
) -> Designs:
    """Find dimensions of a mechanism that meet goals.

    Dimensions and the configurations at the samples of every goal are fitted together: first with
    loops that may stay open, so that a start at which nothing closes is no obstacle, then with
    closed loops, by Levenberg's method with the derivatives of variable projection
    [GolubPereyra1973; Kaufman1975]. Goals with a weight are met in the sense of least squares,
    those without one exactly, and demands as inequalities, by augmented Lagrangians
    [Hestenes1969; Powell1969]. Local solutions depend on where they begin: there are many starts,
    and what comes out is ranked.

    Args:
        mechanism: a mechanism of that kind, which closes at its own dimensions; it need not
            meet the goals.
        goals: of `sp.goals`: one or several.
        dimensions: {name: (least, most)} of those that may change [m or rad]; an end is left open
            by None, or by -inf for the least and inf for the most; None for both, or names alone,
            leave one free. Starts without a bound are drawn within half and twice a dimension's
            own value, or its distance to the other bound.
        guess: which branch the first start is on, as for `assemble`.
        starts: how many local solutions are tried, the first one from the mechanism's own
            dimensions, the others from drawn ones.
        method: "multistart"; "atlas": starts are those of thousands of drawn curves that look most
            like a path of free timing, for a mechanism whose driver turns round; "evolution":
            SciPy's differential evolution finds the starts, which pays where few starts lead
            anywhere; "local": the first start alone.
        seed: of the random numbers. The answer does not depend on anything else.
        executor: where starts are worked on (any `concurrent.futures` executor, a Dask client's
            too); default in this process.
        progress: show a bar on stderr after a second, if that is a terminal.
        resume: a file that stores solutions as they come: a search that was cut short goes
            on from there.
        most: designs to return.

    Returns:
        Distinct Designs, the best first, with the defects of each; none if no start led to one that
        meets the exact goals.

    Raises:
        UnknownNameError: there is no such dimension, frame, coordinate or driver.
        ValueError: there is no goal; bounds are the wrong way round; goals contradict each other;
            a number cannot be; the method is for other goals.
        AssemblyError: the mechanism does not close at its own dimensions.
        SpatialPinError: it has no file to change dimensions in; the file to resume from is of
            another search.
        Interrupted: after Ctrl-C; `.result` has the Designs that were found until then.

    Example:
        >>> mech = sp.load("four_bar")
        >>> goal = sp.goals.swing("rocker_pin", 1.0)  # the rocker swings by 1 rad
        >>> best = sp.design(mech, goal, {"r2": (0.05, 0.15)}, method="local")[0]  # [m]
        >>> print(f"r2 = {best.dimensions['r2']:.4f} m")
        r2 = 0.1100 m
        >>> best.defects
        ()
    """
    require_mechanism(mechanism)
    wanted = tuple(goals) if isinstance(goals, Iterable) else (goals,)
    if not wanted:
        raise ValueError("goals is empty: ask for something of sp.goals")
    for goal in wanted:
        if not isinstance(goal, Goal):
            raise TypeError(f"goals are of sp.goals, as goals.path(...), not {goal!r:.60}")
    bounds = bounds_of(mechanism, dimensions)
    if not bounds:
        raise ValueError("dimensions names none: nothing may change")
    if whole_number(most, "most") < 1:
        raise ValueError(f"most is {most}; it is 1 at least")
    tell_idle(mechanism, bounds)
    for goal in wanted:
        goal.check(mechanism)
    refuse_contradictions(mechanism, wanted)
    nominal = assembled(mechanism, {}, guess)
    spec = ProblemSpec(mechanism.path, mechanism.loading, wanted, bounds,
                       (nominal.q, nominal.angles))
    problem = spec.make()
    if exact_points(wanted):
        refuse_off_plane(problem.anywhere(), wanted)
    result = searched(spec, method, starts, seed, executor, progress, resume)
    return unless_cut(designs_of(problem, result, most))
