"""This library, through its public interface: assembly modes, dimensions and their synthesis."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from published_designs import PROBLEMS, Problem as DesignProblem

import spatial_pin as sp
from benchmark import counted, rssr
from benchmark.case import Case
from benchmark.rssr import Array, Problem

NAME = "spatial_pin"
DIMENSIONS = ("a", "b", "c", "d")
STEP = 1e-4  # relative step of central differences of the closed form


# Assembly modes


def setup_modes(make: Callable[[], sp.Mechanism]) -> SimpleNamespace:
    return SimpleNamespace(mechanism=make())


def run_modes(tool: SimpleNamespace) -> sp.AssemblyModes:
    return sp.assembly_modes(tool.mechanism)


# Dimensions


def setup_sensitivity() -> SimpleNamespace:
    mechanism, problem = sp.load("rssr"), Problem(steps=rssr.FEW)
    state = sp.assemble(mechanism, {"crank": problem.phi[1]})
    return SimpleNamespace(mechanism=mechanism, state=state, problem=problem)


def run_sensitivity(tool: SimpleNamespace) -> Array:
    result = sp.sensitivity(tool.mechanism, tool.state, "rocker_pin", DIMENSIONS)
    return np.array([[result.derivatives[name] for name in DIMENSIONS]])


def setup_gradient() -> SimpleNamespace:
    """Take every tenth degree of a turn: of a goal over the motion this is what it is made of."""
    tool = SimpleNamespace(mechanism=sp.load("rssr"), problem=Problem(steps=36))
    tool.motion = sp.sweep(tool.mechanism, "crank", tool.problem.phi)
    return tool


def run_gradient(tool: SimpleNamespace) -> Array:
    result = sp.sensitivity(tool.mechanism, tool.motion, "rocker_pin", DIMENSIONS)
    return np.column_stack([result.derivatives[name] for name in DIMENSIONS])


def judge_derivatives(tool: SimpleNamespace, values: Array) -> dict[str, float | None]:
    """Compare with sixth-order differences of the closed form."""
    rows = slice(1, 2) if len(values) == 1 else slice(None)
    exact = [derivative(tool.problem, name)[rows] for name in DIMENSIONS]
    return {"dψ": float(np.abs(values - np.array(exact).T).max())}


def derivative(problem: Problem, name: str) -> Array:
    """Return (N,) how the rocker's angle changes with a dimension [rad/m]."""
    value = getattr(problem, name)
    h = STEP * value

    def angles(k: int) -> Array:
        shape = {**{x: getattr(problem, x) for x in DIMENSIONS}, name: value + k * h}
        return Problem(steps=problem.steps, **shape).exact().angle

    return sum(w * (angles(k) - angles(-k)) for k, w in ((1, 0.75), (2, -0.15), (3, 1 / 60))) / h


# Synthesis


def run_design(problem: DesignProblem) -> Any:
    return problem.solve(seed=0)


def judge_design(problem: DesignProblem, designs: Any) -> dict[str, float | None]:
    """Return errors, evaluations and, of each kind of defect that the best design has, 1."""
    defects = {defect.kind for defect in designs[0].defects} if len(designs) else ()
    return {"published": problem.published, "designs": len(designs),
            "error": problem.error(designs[0]) if len(designs) else None,
            "evaluations": designs.evaluations, **dict.fromkeys(sorted(defects), 1.0)}


CASES = (
    *(Case("design", NAME, problem.title, lambda problem=problem: problem, run_design, judge_design,
           slow=True) for problem in PROBLEMS.values()),
    *(Case("modes", NAME, f"assembly_modes, {name}", partial(setup_modes, make), run_modes,
           lambda _, modes, n=n: {"count": abs(len(modes) - n)}, slow=n > 2)
      for name, (make, n) in counted.COUNTS.items()),
    Case("sensitivity", NAME, "sensitivity", setup_sensitivity, run_sensitivity,
         judge_derivatives),
    Case("sensitivity", NAME, "sensitivity of a motion, 36 samples", setup_gradient, run_gradient,
         judge_derivatives, slow=True),
)
