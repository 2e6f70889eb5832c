"""The tutorial problems of pylinkage's documentation, solved by pylinkage; prints JSON.

    python tutorials_of_pylinkage.py [CRANK COUPLER ROCKER]

Evaluations are sets of dimensions: mechanisms that its swarm moved, four-bars that its search made
of dyads, solutions of linear equations. Of links that are named, its measure of the quarter of a
circle is told too. Run by the interpreter of an environment with pylinkage. Its documentation:
"Complete example" (docs/examples/fourbar_linkage.py), notebook 06 on functions, tutorial "Linkage
synthesis".
"""

from __future__ import annotations

import json
import math
import sys
import time
import warnings
from collections.abc import Callable

import numpy as np
import pylinkage as pl
from pylinkage.actuators import Crank
from pylinkage.components import Ground
from pylinkage.dyads import RRRDyad
from pylinkage.simulation import Linkage
from pylinkage.synthesis import function_generation, path_generation
from scipy.optimize import minimize_scalar

PAIRS = ((30, 75), (75, 90), (135, 135))
FIVE = ((30, 75), (60, 85), (75, 90), (110, 118), (135, 135))
POINTS = ((0.0, 1.0), (1.0, 2.0), (2.0, 1.5), (3.0, 0.5))
CORNER = (0, 5, 2, 3)  # bounding box of a quarter of a circle: least y, most x, most y, least x


def clocked(work: Callable) -> tuple:
    begin = time.process_time()
    found = work()
    return found, time.process_time() - begin


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


def swarm() -> dict:
    tried = []

    def counted(*given, **named):
        tried.append(1)
        return quadrant(*given, **named)

    linkage = four_bar()
    bounds = pl.generate_bounds(linkage.get_constraints())
    found, seconds = clocked(lambda: pl.particle_swarm_optimization(
        eval_func=counted, linkage=linkage, bounds=bounds, order_relation=min, verbose=False)[0])
    return {"problem": "tutorial_quadrant", "error": float(found.score), "evaluations": len(tried),
            "seconds": seconds, "dimensions": [float(x) for x in found.dimensions]}


def rocker_angles(solution, inputs) -> np.ndarray:
    """Return the rocker's angles (2, k) on both branches, from the links that were found."""
    tip = solution.crank_length * np.exp(1j * np.asarray(inputs))
    rest = tip - solution.ground_length
    inner = np.arccos((solution.rocker_length**2 + abs(rest) ** 2 - solution.coupler_length**2)
                      / (2 * solution.rocker_length * abs(rest)))
    return np.angle(rest) + np.array([inner, -inner])


def function(name: str, pairs) -> dict:
    given = [(math.radians(a), math.radians(b)) for a, b in pairs]
    found, seconds = clocked(lambda: function_generation(
        angle_pairs=given, ground_length=1.0, require_grashof=False))
    best = []
    for solution in found.raw_solutions:
        away = rocker_angles(solution, [a for a, _ in given]) - np.array([b for _, b in given])
        away = abs(np.angle(np.exp(1j * away)))
        best.append(float(np.min(np.linalg.norm(away, axis=1))) / math.sqrt(len(pairs)))
    return {"problem": name, "error": min(best, default=None),
            "evaluations": len(found.raw_solutions), "seconds": seconds}


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


def path() -> dict:
    module, tried = sys.modules[path_generation.__module__], []
    made = module._dyads_to_fourbar

    def counted(*given, **named):
        tried.append(1)
        return made(*given, **named)

    module._dyads_to_fourbar = counted
    found, seconds = clocked(lambda: path_generation(list(POINTS)))
    best = min(map(missed, found.raw_solutions), default=None)
    return {"problem": "tutorial_path", "error": best, "evaluations": len(tried),
            "seconds": seconds}


def judged(links: list[str]) -> dict:
    """Return what the tutorial's own measure says of links that somebody else found."""
    found, seconds = clocked(lambda: quadrant(four_bar(), [float(x) for x in links]))
    return {"problem": "tutorial_quadrant, links of sp.design", "error": float(found),
            "evaluations": None, "seconds": seconds}


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    rows = [swarm() for _ in range(3)]  # its swarm is not seeded
    rows += [function("tutorial_function", PAIRS),
             function("tutorial_function_of_five", FIVE), path()]
    rows += [judged(sys.argv[1:])] if sys.argv[1:] else []
    print(json.dumps({"version": pl.__version__, "rows": rows}))
