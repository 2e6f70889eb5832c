"""Dimensional synthesis: the dimensions with which a mechanism does what is asked of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from spatial_pin._support.checks import checked, whole_number
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.bounds import bounds_of
from spatial_pin.dimensions.variants import tell_idle
from spatial_pin.errors import unless_cut
from spatial_pin.mechanism.coordinates import needed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.contradictions import (
    exact_points,
    refuse_contradictions,
    refuse_off_plane,
)
from spatial_pin.synthesis.precision import Goal
from spatial_pin.synthesis.problem import ProblemSpec
from spatial_pin.synthesis.results import Designs, designs_of
from spatial_pin.synthesis.search import searched


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
    """Find dimensions with which a mechanism does what is asked of it.

    Dimensions and the configurations at the samples of every goal are fitted together: first with
    loops that may stay open, so that a start at which nothing closes is no obstacle, then with
    closed loops, by SciPy's `least_squares` with the derivatives of variable projection
    [GolubPereyra1973; Kaufman1975]. Goals with a weight are met in the sense of least squares,
    those without one exactly, and demands as inequalities, by augmented Lagrangians
    [Hestenes1969; Powell1969]. Local solutions depend on where they begin: there are many starts,
    and what comes out is ranked.

    Args:
        mechanism: a mechanism of that kind, which closes at its own dimensions; it need not do what
            is asked.
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
        resume: a file in which what is found is kept as it comes: a search that was cut short goes
            on from there.
        most: designs to return.

    Returns:
        Distinct Designs, the best first, with the defects of each; none if no start led to one that
        meets what is to be met exactly.

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
    needed(mechanism)
    asked = _asked(goals)
    bounds = bounds_of(mechanism, dimensions)
    if not bounds:
        raise ValueError("dimensions names none: nothing may change")
    if whole_number(most, "most") < 1:
        raise ValueError(f"most is {most}; it is 1 at least")
    tell_idle(mechanism, bounds)
    for goal in asked:
        goal.check(mechanism)
    refuse_contradictions(mechanism, asked)
    nominal = assembled(mechanism, {}, guess)
    spec = ProblemSpec(mechanism.path, mechanism.loading, asked, bounds,
                       (nominal.q, nominal.angles))
    problem = spec.make()
    if exact_points(asked):
        refuse_off_plane(problem.anywhere(), asked)
    found = searched(spec, method, starts, seed, executor, progress, resume)
    return unless_cut(designs_of(problem, found, most))


def _asked(goals: Any) -> tuple[Goal, ...]:
    asked = tuple(goals) if isinstance(goals, Iterable) else (goals,)
    if not asked:
        raise ValueError("goals is empty: ask for something of sp.goals")
    for goal in asked:
        if not isinstance(goal, Goal):
            raise TypeError(f"goals are of sp.goals, as goals.path(...), not {goal!r:.60}")
    return asked
