"""pylinkage: plane linkages of dyads, each solved in closed form by code that numba compiles."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
from pylinkage import Crank, Ground, RRRDyad
from pylinkage.simulation import Linkage

from benchmark import four_bar
from benchmark.case import Case
from benchmark.rssr import Array


def setup(steps: int) -> SimpleNamespace:
    """Begin one step before the first angle: every step turns the crank, then solves."""
    values = four_bar.angles(steps)
    step = float(values[1])
    left, right = Ground(0.0, 0.0), Ground(four_bar.GROUND, 0.0)
    crank = Crank(anchor=left, radius=four_bar.CRANK, angular_velocity=step, initial_angle=-step)
    rocker = RRRDyad(anchor1=crank.output, anchor2=right, distance1=four_bar.COUPLER,
                     distance2=four_bar.ROCKER, x=four_bar.GROUND, y=four_bar.ROCKER)
    linkage = Linkage([left, right, crank, rocker])
    linkage.compile()
    linkage.set_input_velocity(crank, omega=four_bar.SPEED)
    tool = SimpleNamespace(values=values, linkage=linkage)
    run(tool)  # numba compiles
    return tool


def run(tool: SimpleNamespace) -> tuple[Array, ...]:
    return tuple(tool.linkage.step_fast_with_kinematics(len(tool.values), 1.0))


def judge(tool: SimpleNamespace, result: tuple[Array, ...]) -> dict[str, float]:
    """Read the rocker's angle and rates from the plane vectors of its tip."""
    arm, velocity, acceleration = (x[:, 3] for x in result)
    arm = arm - [four_bar.GROUND, 0.0]
    turning = [(arm[:, 0] * x[:, 1] - arm[:, 1] * x[:, 0]) / four_bar.ROCKER**2
               for x in (velocity, acceleration)]
    angle = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    return four_bar.judge(tool.values, four_bar.SPEED, np.array([angle, *turning]))


CASES = tuple(Case("four_bar", "pylinkage", "numba steps with rates", partial(setup, n), run,
                   judge, n, n) for n in four_bar.STEPS)
