"""The tutorial problems of pylinkage's documentation, solved by pylinkage.

Evaluations are sets of dimensions: mechanisms that its swarm moved, four-bars that its search made
of dyads, solutions of linear equations. Its documentation: "Complete example"
(docs/examples/fourbar_linkage.py), notebook 06 on functions, tutorial "Linkage synthesis".
"""

from __future__ import annotations

import math
import sys
from unittest.mock import patch

import numpy as np
import pylinkage as pl
from pylinkage.actuators import Crank
from pylinkage.components import Ground
from pylinkage.dyads import RRRDyad
from pylinkage.simulation import Linkage
from pylinkage.synthesis import function_generation, path_generation
from scipy.optimize import minimize_scalar

from benchmark.case import Case

Pairs = tuple[tuple[float, float], ...]
PAIRS = ((30, 75), (75, 90), (135, 135))
FIVE = ((30, 75), (60, 85), (75, 90), (110, 118), (135, 135))
POINTS = ((0.0, 1.0), (1.0, 2.0), (2.0, 1.5), (3.0, 0.5))
CORNER = (0, 5, 2, 3)  # bounding box of a quarter of a circle: least y, most x, most y, least x


def four_bar() -> Linkage:
    A, D = Ground(0.0, 0.0, name="A"), Ground(3.0, 0.0, name="D")
    crank = Crank(anchor=A, radius=1.0, angular_velocity=0.31, name="B")
    pin = RRRDyad(anchor1=crank.output, anchor2=D, distance1=3.0, distance2=1.0, name="C")
    return Linkage([A, D, crank, pin], name="My four-bar linkage")


@pl.kinematic_minimization
def quadrant(loci, **_):
    """Return how far the pin is from drawing a quarter of a circle, by bounding boxes."""
    box = pl.bounding_box([x[-1] for x in loci])
    return sum((a - b) ** 2 for a, b in zip(box, CORNER, strict=True))


def swarm(_: None) -> tuple[float, int]:
    """Return the least error that its swarm, which is not seeded, finds, and how many it moved."""
    tried = []

    def counted(*given, **named):
        tried.append(1)
        return quadrant(*given, **named)

    linkage = four_bar()
    bounds = pl.generate_bounds(linkage.get_constraints())
    best = pl.particle_swarm_optimization(
        eval_func=counted, linkage=linkage, bounds=bounds, order_relation=min, verbose=False)[0]
    return float(best.score), len(tried)


def judge(_: object, result: tuple[float | None, int]) -> dict[str, float | None]:
    return {"error": result[0], "evaluations": result[1]}


def rocker_angles(solution, inputs) -> np.ndarray:
    """Return the rocker's angles (2, k) on both branches, from the links that were found."""
    tip = solution.crank_length * np.exp(1j * np.asarray(inputs))
    rest = tip - solution.ground_length
    inner = np.arccos((solution.rocker_length**2 + abs(rest) ** 2 - solution.coupler_length**2)
                      / (2 * solution.rocker_length * abs(rest)))
    return np.angle(rest) + np.array([inner, -inner])


def function(pairs: Pairs) -> list:
    given = [(math.radians(a), math.radians(b)) for a, b in pairs]
    return function_generation(angle_pairs=given, ground_length=1.0,
                               require_grashof=False).raw_solutions


def judge_function(pairs: Pairs, solutions: list) -> dict[str, float | None]:
    """Return the root mean square by which the best solution misses the angles."""
    inputs, outputs = np.radians(pairs).T
    best = []
    for solution in solutions:
        away = rocker_angles(solution, inputs) - outputs
        away = abs(np.angle(np.exp(1j * away)))
        best.append(float(np.min(np.linalg.norm(away, axis=1))) / math.sqrt(len(pairs)))
    return judge(pairs, (min(best, default=None), len(solutions)))


def missed(solution) -> float:
    """Return by how much the coupler curve misses the points: the sum of squared distances."""
    a, d, b, c = (complex(*x) for x in (solution.ground_pivot_a, solution.ground_pivot_d,
                                        solution.crank_pivot_b, solution.coupler_pivot_c))
    tracer = (complex(*solution.coupler_point) - b) / (c - b)

    def curve(angle, side):
        tip = a + solution.crank_length * np.exp(1j * angle)
        rest, r3 = d - tip, solution.coupler_length
        cosine = (r3**2 + abs(rest) ** 2 - solution.rocker_length**2) / (2 * r3 * abs(rest))
        with np.errstate(invalid="ignore"):
            turn = np.angle(rest) + side * np.arccos(cosine)
        return tip + tracer * r3 * np.exp(1j * turn)

    grid, total = np.linspace(0, 2 * np.pi, 20001), 0.0
    for z in (complex(*p) for p in POINTS):
        best = np.inf
        for side in (1, -1):
            near = grid[np.nanargmin(abs(curve(grid, side) - z))]
            end = minimize_scalar(
                lambda t, z=z, side=side: np.nan_to_num(abs(curve(t, side) - z), nan=1e3),
                bounds=(near - 1e-3, near + 1e-3), method="bounded", options={"xatol": 1e-13})
            best = min(best, float(end.fun))
        total += best**2
    return total


def path(_: None) -> tuple[list, int]:
    """Return the solutions, and how many four-bars its search made."""
    module, tried = sys.modules[path_generation.__module__], []
    made = module._dyads_to_fourbar

    def counted(*given, **named):
        tried.append(1)
        return made(*given, **named)

    with patch.object(module, "_dyads_to_fourbar", counted):
        return path_generation(list(POINTS)).raw_solutions, len(tried)


def judge_path(_: None, result: tuple[list, int]) -> dict[str, float | None]:
    return judge(None, (min(map(missed, result[0]), default=None), result[1]))


NAME = "pylinkage"
CASES = (
    *(Case("design", NAME, f"pylinkage complete example: quarter of a circle, run {k}",
           lambda: None, swarm, judge, slow=True) for k in (1, 2, 3)),
    *(Case("design", NAME, f"pylinkage 06: function at {words} pairs",
           lambda pairs=pairs: pairs, function, judge_function)
      for words, pairs in (("three", PAIRS), ("five", FIVE))),
    Case("design", NAME, "pylinkage synthesis: path through four points", lambda: None, path,
         judge_path, slow=True),
)
