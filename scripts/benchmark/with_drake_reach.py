"""Drake's InverseKinematics: closures as position constraints between frames.

A placement is asked for by the positions of three points: with a bound of zero its orientation
constraint has no gradient at the solution. A program is made for each target and solved by SNOPT,
the solver that Drake chooses, at its own tolerances.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.solvers import Solve

from benchmark import closed
from benchmark.closed import Array, Robot, Target, Values

NAME = "Drake"


def make(robot: Robot) -> tuple[Any, Any, Any]:
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(robot.urdf(), "urdf")
    ground = plant.GetFrameByName("ground")
    plant.WeldFrames(plant.world_frame(), ground)
    plant.Finalize()
    places = {name: plant.GetJointByName(name).position_start() for name in robot.moving}
    ends = [[plant.GetFrameByName(f"{name}_link") for name in pair] for pair in robot.closures]
    frame, zero = plant.GetFrameByName(f"{robot.frame}_link"), np.zeros(3)
    open_ = np.array([0.0 if axis in robot.axes else np.inf for axis in "xyz"])
    arms = [zero, *np.eye(3)[:2]] if robot.kind == "placement" else [zero]
    start = np.zeros(plant.num_positions())
    for name, value in robot.home().items():
        start[places[name]] = value

    def solve(target: Target, q: Array) -> Array:
        problem = InverseKinematics(plant, with_joint_limits=False)
        program, unknown = problem.prog(), problem.q()
        for a, b in ends:
            problem.AddPositionConstraint(b, zero, a, -open_, open_)
        if robot.kind == "joints":
            for name, value in target.values.items():
                program.AddBoundingBoxConstraint(value, value, unknown[places[name]])
        else:
            for arm in arms:
                point = (target.pose @ [*arm, 1.0])[:3]
                problem.AddPositionConstraint(frame, arm, plant.world_frame(), point, point)
        program.SetInitialGuess(unknown, q)
        solution: Array = Solve(program).GetSolution(unknown)
        return solution

    def values(q: Array) -> Values:
        return {name: float(q[at]) for name, at in places.items()}

    return start, solve, values


CASES = closed.cases(NAME, "InverseKinematics, SNOPT, q only", make)
