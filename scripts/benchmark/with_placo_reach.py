"""placo: closures as hard relative position tasks, as its loop closing examples have them.

The target is a soft task, as in its getting started; `solve` is called until all is met or the
steps run out.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import placo

from benchmark import closed
from benchmark.closed import STEPS_AT_MOST, TOLERANCE, Array, Robot, Target, Values

NAME = "placo"


def make(robot: Robot) -> tuple[Any, Any, Any]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(robot.urdf())
        wrapper = placo.RobotWrapper(str(path), placo.Flags.ignore_collisions)
    solver = placo.KinematicsSolver(wrapper)
    solver.mask_fbase(True)
    solver.enable_joint_limits(False)
    solver.enable_velocity_limits(False)
    tasks = []
    for a, b in robot.closures:
        tasks.append(solver.add_relative_position_task(f"{a}_link", f"{b}_link", np.zeros(3)))
        tasks[-1].configure(a, "hard")
        tasks[-1].mask.set_axises(robot.axes)
    aim = target_task(robot, solver, tasks)
    places = {name: wrapper.get_joint_offset(name) for name in robot.moving}
    start = wrapper.state.q.copy()
    for name, value in robot.home().items():
        start[places[name]] = value

    def solve(target: Target, q: Array) -> Array:
        aim(target)
        wrapper.state.q = q
        wrapper.update_kinematics()
        for _ in range(STEPS_AT_MOST):
            solver.solve(True)
            wrapper.update_kinematics()
            for task in tasks:
                task.update()
            if max(task.error_norm() for task in tasks) < TOLERANCE:
                break
        return wrapper.state.q.copy()

    def values(q: Array) -> Values:
        return {name: float(q[at]) for name, at in places.items()}

    return start, solve, values


def target_task(robot: Robot, solver: placo.KinematicsSolver, tasks: list[Any]) -> Any:
    """Add the tasks of a target to all tasks; return what aims them at one."""
    if robot.kind == "joints":
        joints = solver.add_joints_task()
        joints.configure("target", "soft", 1.0)
        tasks.append(joints)
        return lambda target: joints.set_joints(target.values)
    if robot.kind == "point":
        point = solver.add_position_task(f"{robot.frame}_link", np.zeros(3))
        point.configure("target", "soft", 1.0)
        tasks.append(point)

        def move(target: Target) -> None:
            point.target_world = target.pose[:3, 3]

        return move
    frame = solver.add_frame_task(f"{robot.frame}_link", np.eye(4))
    frame.configure("target", "soft", 1.0, 1.0)
    tasks += [frame.position(), frame.orientation()]

    def turn(target: Target) -> None:
        frame.T_world_frame = target.pose

    return turn


CASES = closed.cases(NAME, "hard closing tasks, soft target, q only", make)
