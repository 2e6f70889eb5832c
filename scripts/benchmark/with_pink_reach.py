"""pink: closures as relative frame tasks, positions only, and the target as a task beside them.

`solve_ik` is called with a gain and a step of 1, which makes it Gauss's and Newton's step, until
all is met or the steps run out. Its `constraints=` would take a relative frame task as a weld, all
six rows; here points are to coincide.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pink
import pinocchio as pin
from pink.tasks import FrameTask, PostureTask, RelativeFrameTask

from benchmark import closed
from benchmark.closed import STEPS_AT_MOST, TOLERANCE, Array, Robot, Target, Values

NAME = "pink"


def make(robot: Robot) -> tuple[Any, Any, Any]:
    model = pin.buildModelFromXML(robot.urdf())
    data = model.createData()
    cost = [float(axis in robot.axes) for axis in "xyz"]
    closings = [RelativeFrameTask(f"{b}_link", f"{a}_link", cost, 0.0)
                for a, b in robot.closures]
    for task in closings:
        task.set_target(pin.SE3.Identity())
    places = {name: model.joints[model.getJointId(name)].idx_q for name in robot.moving}
    wanted, aim = target_task(robot, model, places)
    start = pin.neutral(model)
    for name, value in robot.home().items():
        start[places[name]] = value

    def solve(target: Target, q: Array) -> Array:
        aim(target)
        configuration = pink.Configuration(model, data, q.copy())
        for _ in range(STEPS_AT_MOST):
            if worst(configuration, closings, wanted) < TOLERANCE:
                break
            velocity = pink.solve_ik(configuration, [*closings, wanted], 1.0, solver="daqp",
                                     limits=[])
            configuration.integrate_inplace(velocity, 1.0)
        return configuration.q.copy()

    def values(q: Array) -> Values:
        return {name: float(q[at]) for name, at in places.items()}

    return start, solve, values


def target_task(robot: Robot, model: pin.Model, places: dict[str, int]) -> tuple[Any, Any]:
    """Return the task of a target, and what aims it at one."""
    if robot.kind == "joints":
        cost = np.zeros(model.nv)
        cost[[places[name] for name in robot.leading]] = 1.0
        posture = PostureTask(cost)

        def aim(target: Target) -> None:
            q = pin.neutral(model)
            for name, value in target.values.items():
                q[places[name]] = value
            posture.set_target(q)

        return posture, aim
    turned = float(robot.kind == "placement")
    task = FrameTask(f"{robot.frame}_link", 1.0, turned)
    return task, lambda target: task.set_target(pin.SE3(target.pose))


def worst(configuration: pink.Configuration, closings: list[Any], wanted: Any) -> float:
    """Return the largest weighted error."""
    return max(float(np.abs(task.cost * task.compute_error(configuration)).max())
               for task in (*closings, wanted))


CASES = closed.cases(NAME, "tasks for closures and target, daqp, q only", make)
