"""Designs: ranked results of a search for dimensions, with errors and defects."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, overload

import numpy as np

from spatial_pin._support.brief import brief, counted
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.follow import follow
from spatial_pin.motion.limits import limits
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.sweep import sweep
from spatial_pin.motion.trace import trace
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.defects import Defect, defects, limits_passed
from spatial_pin.synthesis.demand import Candidate, MotionDemand, in_own_turn
from spatial_pin.synthesis.design_problem import DesignProblem, LocalSolution
from spatial_pin.synthesis.global_search import Searched
from spatial_pin.synthesis.precision import FunctionGoal, Goal, PathGoal, Precision

TURN_SAMPLES, PART_SAMPLES = 361, 30  # of a turn, and between two samples of a goal
MOST_TRACED = 4000  # samples of a curve: thirteen turns of one driver
REPORT_WIDTH = 100  # characters of a line of the report
EQUAL = 1e-9  # errors with a smaller difference are equal: least squares end at some 1e-12
AT_BOUND = 1e-6  # relative to the width of the bounds: least squares stay some 1e-9 inside


class GoalError(NamedTuple):
    """How far a goal is missed.

    Attributes:
        rms: root mean square over its samples [`unit`].
        most: the largest of them [`unit`].
        unit: of both: "m", "rad", "m, rad" (of poses, whichever is larger), or "" of a demand.
        samples: how many there are.

    Example:
        >>> mech = sp.load("four_bar")
        >>> goal = sp.goals.swing("rocker_pin", 1.0)  # [rad]
        >>> best = sp.design(mech, goal, {"r2": (0.05, 0.15)}, method="local")[0]
        >>> [(name, missed.most < 1e-6) for name, missed in best.errors.items()]
        [('swing of rocker_pin', True)]
    """

    rms: float
    most: float
    unit: str
    samples: int

    def __str__(self) -> str:
        if not self.most:
            return "met"
        unit = f" {self.unit}" * bool(self.unit)
        if self.samples == 1:
            return f"{self.most:.3g}{unit}"
        return f"{self.rms:.3g}{unit} rms, {self.most:.3g}{unit} at most ({self.samples} samples)"


class Met(NamedTuple):
    """A goal of precision, and the values of a design at its samples.

    Attributes:
        goal: the goal.
        states: (k,) closed states.
        targets: (k, 3) points of a path in the world [m], (k, 4, 4) placements of poses, or (k,)
            values of a function's output; moved as the goal's free numbers say.

    Example:
        >>> mech = sp.load("four_bar")
        >>> goal = sp.goals.function("rocker_pin", [1.6, 1.8], {"crank": [1.0, 1.5]})  # [rad]
        >>> best = sp.design(mech, goal, {"r3": (0.2, 0.4), "r4": (0.2, 0.4)}, method="local")[0]
        >>> met = best.met[0]
        >>> met.targets, len(met.states), met.driver  # (k,) [rad], k
        (array([1.6, 1.8]), 2, 'crank')
    """

    goal: Precision
    states: tuple[State, ...]
    targets: Array

    @property
    def driver(self) -> str | None:
        """The driver that moves it from sample to sample; None if that is not one alone."""
        names = list(self.goal.drivers) or list(self.states[0].mechanism.drivers)
        return names[0] if len(names) == 1 else None

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, eq=False)
class Design:
    """One design: dimensions, and the errors of its goals.

    Attributes:
        mechanism: with these dimensions; `mechanism.save(folder)` writes it.
        dimensions: their values by name [m or rad].
        bounds: (least, most) by name, infinite where there are none.
        error: root of the sum of squares of the goals' weighted residuals [characteristic lengths,
            rad]; those of a drawing of free size count as large as it is given. Goals to be met
            exactly have no part in it.
        errors: by goal.
        states: closed states at the samples of every goal, one goal after the other.
        numbers: what else was found, by goal and name: how a drawing is placed [m, a rotation
            vector in rad] and scaled, zeros of outputs and drivers [m or rad].
        met: the goals of precision, their states and targets.
        evaluations: sets of dimensions that were tried on the way to it.
        demands: requirements on the mechanism as a whole.

    Example:
        >>> mech = sp.load("four_bar")
        >>> goal = sp.goals.swing("rocker_pin", 1.0)  # [rad]
        >>> best = sp.design(mech, goal, {"r2": (0.05, 0.15)}, method="local")[0]
        >>> print(f"r2 = {best.dimensions['r2']:.4f} m")
        r2 = 0.1100 m
        >>> best.defects, best.at_bounds
        ((), {})
    """

    mechanism: Mechanism
    dimensions: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    error: float
    errors: dict[str, GoalError]
    states: tuple[State, ...]
    numbers: dict[str, float]
    met: tuple[Met, ...]
    evaluations: int
    demands: tuple[Goal, ...] = ()

    @cached_property
    def defects(self) -> tuple[Defect, ...]:
        """Circuit, branch, order, joint limits and transmission, as far as they are not right."""
        result = list[Defect]()
        for met in self.met:
            output = met.goal.output if isinstance(met.goal, FunctionGoal) else None
            own = defects(self.mechanism, met.states, met.driver, output=output,
                          ordered=not met.goal.drivers,
                          cyclic=isinstance(met.goal, PathGoal) and met.goal.closed)
            which = f"{met.goal.name}: " if len(self.met) > 1 else ""
            result += [defect._replace(text=which + defect.text) for defect in own]
        candidate, seen = Candidate(self.mechanism, self.states), set[Defect]()
        for demand in self.demands if joint_limits(self.mechanism) else ():
            if isinstance(demand, MotionDemand):
                passed = limits_passed(demand.motion(candidate)[0])
                result += [x._replace(text=f"{demand.name}: {x.text}")
                          for x in passed if x not in seen]
                seen.update(passed)
        return tuple(result)

    @property
    def at_bounds(self) -> dict[str, str]:
        """Dimensions at a bound: "least" or "most"."""
        ends = {}
        for name, (low, high) in self.bounds.items():
            near = AT_BOUND * min(high - low, max(abs(self.dimensions[name]), 1e-9))
            for end, words in ((low, "least"), (high, "most")):
                if abs(self.dimensions[name] - end) <= near:
                    ends[name] = words
        return ends

    def motion(self, goal: int = 0) -> Motion:
        """Return the motion that leads through the samples of a goal of precision, to be shown.

        A driver that turns fully goes round once from the first sample; else the whole curve is
        followed through its limits (`trace`). Several drivers go from sample to sample. Where no
        goal has samples the only driver moves from the state as it is drawn.

        Args:
            goal: its number among `met`.

        Returns:
            The Motion.

        Raises:
            SpatialPinError: there is no such goal, or no driver; the samples are on branches that
                do not hang together.

        Example:
            >>> mech = sp.load("four_bar")
            >>> goal = sp.goals.swing("rocker_pin", 1.0)  # [rad]
            >>> best = sp.design(mech, goal, {"r2": (0.05, 0.15)}, method="local")[0]
            >>> angle = best.motion().coordinate("rocker_pin").value
            >>> print(f"{angle.max() - angle.min():.3f} rad")
            1.000 rad
        """
        if not self.met and goal == 0 and len(self.mechanism.drivers) == 1:
            return _round(self.mechanism, next(iter(self.mechanism.drivers)), self.states[0])
        if not 0 <= goal < len(self.met):
            raise SpatialPinError(f"there is no goal {goal} with samples: the design has "
                                  f"{len(self.met)}, from 0")
        met = self.met[goal]
        if met.driver is not None:
            return _round(self.mechanism, met.driver, met.states[0])
        names = list(met.goal.drivers) or list(self.mechanism.drivers)
        if not names:
            raise SpatialPinError(f"mechanism {self.mechanism.name!r} has no driver that leads "
                                  f"through the samples of {met.goal.name!r}")
        at = np.array([[state.coordinate(name).value for name in names] for state in met.states])
        rows = np.arange(len(at))
        parts = np.linspace(0.0, len(at) - 1.0, (len(at) - 1) * PART_SAMPLES + 1)
        return follow(self.mechanism, {name: np.interp(parts, rows, x)
                                       for name, x in zip(names, at.T, strict=True)},
                      guess=met.states[0])

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain numbers and lists, as JSON has them; None for no bound.

        Example:
            >>> mech = sp.load("four_bar")
            >>> goal = sp.goals.swing("rocker_pin", 1.0)  # [rad]
            >>> best = sp.design(mech, goal, {"r2": (0.05, 0.15)}, method="local")[0]
            >>> print(f"{best.as_dict()['dimensions']['r2']:.4f} m")
            0.1100 m
        """
        bounds = {name: [x if np.isfinite(x) else None for x in ends]
                  for name, ends in self.bounds.items()}
        return {"error": self.error, "dimensions": self.dimensions, "bounds": bounds,
                "errors": {name: error._asdict() for name, error in self.errors.items()},
                "numbers": self.numbers, "states": [state.q.tolist() for state in self.states],
                "defects": [defect._asdict() for defect in self.defects],
                "evaluations": self.evaluations}

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {x:.6g}" for name, x in self.dimensions.items())
        return f"Design({self.mechanism.name!r}: error {self.error:.3g}, {values})"

    def __str__(self) -> str:
        on = self.at_bounds
        values = [f"{name} = {x:.6g}" + (f" (its {on[name]})" if name in on else "")
                  for name, x in self.dimensions.items()]
        lines = [f"error {self.error:.3g}", *_wrapped("dimensions [m, rad]: ", values)]
        lines += [line for name, error in self.errors.items()
                  for line in _wrapped(f"{name}: ", [str(error)])]
        for goal in self.errors:
            free = [f"{name.removeprefix(goal + ': ')} = {x:.6g}"
                    for name, x in self.numbers.items() if name.startswith(goal + ": ")]
            lines += _wrapped(f"{goal}, found with it: ", free) if free else []
        for defect in self.defects:
            lines += _wrapped(f"{defect.kind}: ", [defect.text])
        return "\n  ".join([*lines, f"{self.evaluations} sets of dimensions were tried for it"])


@dataclass(frozen=True, eq=False)
class Designs(Sequence[Design]):
    """Distinct designs, the best first; `print` them for a report.

    Attributes:
        designs: what it is a sequence of.
        name: of the mechanism.
        is_whole: whether all starts were tried, and nothing cut it short (Ctrl-C).
        starts: how many local solutions were tried.
        failed: how many of them led to no design.
        evaluations: sets of dimensions that were tried in all.
        nearest: of those that led to no design, the least by which an exact goal was
            missed [characteristic lengths, rad, or fractions of the allowed value]; infinite if
            the loops closed at none, or nothing could be judged.
        why: error text of the first start that led nowhere at all; empty if there is none.

    Example:
        >>> mech = sp.load("four_bar")
        >>> goal = sp.goals.swing("rocker_pin", 1.0)  # [rad]
        >>> found = sp.design(mech, goal, {"r2": (0.05, 0.15)}, starts=2)
        >>> len(found), found.starts, found.is_whole
        (1, 2, True)
    """

    designs: tuple[Design, ...]
    name: str
    is_whole: bool
    starts: int
    failed: int
    evaluations: int
    nearest: float = np.inf
    why: str = ""

    def __len__(self) -> int:
        return len(self.designs)

    @overload
    def __getitem__(self, k: int) -> Design: ...

    @overload
    def __getitem__(self, k: slice) -> tuple[Design, ...]: ...

    def __getitem__(self, k: int | slice) -> Design | tuple[Design, ...]:
        if isinstance(k, int) and not -len(self) <= k < len(self):
            raise IndexError(f"{self.name}: there is no design {k}; {len(self)} were found, "
                             f"from {counted(self.starts, 'start')}{self._why}")
        return self.designs[k]

    def __iter__(self) -> Iterator[Design]:
        return iter(self.designs)

    def as_dict(self) -> dict[str, Any]:
        """Return all as plain numbers and lists, as JSON has them.

        Example:
            >>> mech = sp.load("four_bar")
            >>> goal = sp.goals.swing("rocker_pin", 1.0)  # [rad]
            >>> found = sp.design(mech, goal, {"r2": (0.05, 0.15)}, method="local").as_dict()
            >>> len(found["designs"])
            1
        """
        return {"mechanism": self.name, "is_whole": self.is_whole, "starts": self.starts,
                "failed": self.failed, "evaluations": self.evaluations,
                "why": self._why.removeprefix("; "),
                "designs": [design.as_dict() for design in self.designs]}

    @property
    def _why(self) -> str:
        """Why there is no design, in words that go on a sentence; empty if there is one."""
        if self.designs or not self.failed:
            return ""
        if not np.isfinite(self.nearest):
            return f"; {self.why or 'the loops closed at none of them'}"
        return ("; the nearest misses an exact goal by "
                f"{self.nearest:.2g} characteristic lengths, rad, or fractions of allowed values")

    def __repr__(self) -> str:
        best = f", errors from {self.designs[0].error:.3g}" if self.designs else ""
        cut = "" if self.is_whole else "; cut short"
        return f"Designs({self.name!r}: {len(self)} from {self.starts} starts{best}{cut})"

    def __str__(self) -> str:
        none = f", {self.failed} of them without one" if self.failed else ""
        head = (f"{self.name}: {counted(len(self), 'design')} from "
                f"{counted(self.starts, 'start')}{none}; "
                f"{self.evaluations} sets of dimensions tried"
                f"{'' if self.is_whole else '; cut short'}{self._why}")
        return "\n".join([*textwrap.wrap(head, REPORT_WIDTH),
                          *(f"{k}. {design}" for k, design in enumerate(self.designs, start=1))])


def _wrapped(head: str, parts: Sequence[str]) -> list[str]:
    """Return lines with a hanging indent under their head."""
    return textwrap.wrap(head + ", ".join(parts), REPORT_WIDTH - 2, subsequent_indent="    ",
                         break_long_words=False)


def _round(mechanism: Mechanism, driver: str, state: State) -> Motion:
    """Return a full turn of a driver, or the curve through its limits."""
    if limits(mechanism, driver, state).full_turn:
        start = float(state.coordinate(driver).value)
        return sweep(mechanism, driver, start + np.linspace(0.0, 2.0 * np.pi, TURN_SAMPLES),
                     guess=state)
    return trace(mechanism, driver, state, most_rows=MOST_TRACED)


def designs_of(problem: DesignProblem, searched: Searched, most: int) -> Designs:
    """Return the best solutions of a search as designs."""
    made, why = list[Design](), searched.why
    failed = searched.failed
    for solution in searched.solutions:
        if len(made) == most:
            break
        try:
            made.append(design_of(problem, solution))
        except SpatialPinError as error:  # its loops close, but its file makes no such mechanism
            failed, why = failed + 1, why or str(error)
    if searched.is_whole:  # after Ctrl-C defects are computed at first use
        made = _ranked(made)
    return Designs(tuple(made), problem.mechanism.name, searched.is_whole,
                   searched.starts, failed, searched.evaluations, searched.nearest, why)


def _ranked(designs: Sequence[Design]) -> list[Design]:
    """Return designs in order; among equal errors, those with fewer defects first.

    Defects that stop the motion count first.
    """
    def flaws(design: Design) -> tuple[int, int]:
        grave = sum(defect.kind in ("circuit", "branch", "order", "joint limit")
                    for defect in design.defects)
        return grave, len(design.defects) - grave

    ranked: list[Design] = []
    rest = list(designs)
    while rest:
        equal = [x for x in rest if abs(x.error - rest[0].error) <= EQUAL * (1.0 + rest[0].error)]
        ranked += equal if len(equal) == 1 else sorted(equal, key=flaws)
        rest = [x for x in rest if all(x is not y for y in equal)]
    return ranked


def design_of(problem: DesignProblem, solution: LocalSolution) -> Design:
    """Return a solution as a design, its mechanism loaded and closed."""
    n = problem.n
    dimensions = dict(zip(problem.names[:n], solution.x[:n].tolist(), strict=True))
    there = problem.family.whole(dimensions) if dimensions else problem.mechanism
    met, errors, numbers = list[Met](), dict[str, GoalError](), dict[str, float]()
    members, end = problem.members(solution.x), n
    for inner, samples in zip(problem.inner_problems, solution.samples, strict=True):
        own = solution.x[end : end + len(inner.names)]
        end += len(own)
        goal = inner.goal
        drawn = own[: len(goal.own_names)]
        # configurations of the family leave out a last digit
        states = tuple(
            assembled(there, {}, State(there, in_own_turn(there, q, goal.drivers),
                                       closure_error=np.nan, angles=angles))
            for q, angles in zip(samples.q, samples.angles, strict=True))
        met.append(Met(goal, states, goal.targets(problem.mechanism, drawn)))
        missed = goal.errors(inner.residual(members, samples, own), problem.mechanism, drawn)
        name = _free_name(goal.name, errors)
        errors[name] = _error(missed, goal.unit_of(problem.mechanism))
        numbers |= {f"{name}: {key}": goal.natural(problem.mechanism, key, x)
                    for key, x in zip(inner.names, own.tolist(), strict=True)}
    states = tuple(state for one in met for state in one.states) or (
        followed(there, {}, problem.nominal()),)
    for demand in problem.demands:
        values = demand.values(Candidate(there, states))
        if demand.is_one_sided:  # at its limit, to round-off, is met
            values = np.where(values > TOLERANCES.round_off, values, np.minimum(values, 0.0))
        missed = demand.errors(values, problem.mechanism)
        errors[_free_name(demand.name, errors)] = _error(missed, demand.unit_of(problem.mechanism))
    ends = zip(problem.lower[:n].tolist(), problem.upper[:n].tolist(), strict=True)
    bounds = dict(zip(problem.names[:n], ends, strict=True))
    return Design(there, dimensions, bounds,
        float(np.sqrt(solution.cost)), errors, states, numbers, tuple(met), solution.evaluations,
        tuple(problem.demands))


def _error(values: Array, unit: str) -> GoalError:
    missed = np.abs(values)
    return GoalError(float(np.sqrt(np.mean(missed**2))), float(missed.max()), unit, len(missed))


def _free_name(name: str, taken: Mapping[str, Any]) -> str:
    names = [name, *(f"{name} ({k})" for k in range(2, len(taken) + 3))]
    return next(x for x in names if x not in taken)
