"""pink: the loop closed by a frame task, solved to the end at each crank angle.

The crank's end A moves along a path that is known, so the model is rocker and coupler, and A a
position target. `solve_ik` gives velocities towards it; a gain and step of 1 make it Newton's
step. Positions only: it knows no accelerations.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pink
import pinocchio as pin

from benchmark import rssr
from benchmark.case import Absent, Case
from benchmark.rssr import MAX_CORRECTIONS, Array, Problem

NAME = "pink"


def setup(problem: Problem) -> SimpleNamespace:
    model = pin.Model()
    axis, eye = np.array([0.0, 0.0, -1.0]), np.eye(3)

    def at(x: float) -> pin.SE3:
        return pin.SE3(eye, np.array([x, 0.0, 0.0]))

    rocker = model.addJoint(0, pin.JointModelRevoluteUnaligned(axis), at(-problem.d), "rocker")
    ball = model.addJoint(rocker, pin.JointModelSpherical(), at(-problem.c), "ball")
    model.addFrame(pin.Frame("coupler_a", ball, at(-problem.b), pin.FrameType.OP_FRAME))
    task = pink.FrameTask("coupler_a", position_cost=1.0, orientation_cost=0.0, gain=1.0)
    start = pin.Quaternion(problem.rocker_to_coupler()).coeffs()
    return SimpleNamespace(model=model, data=model.createData(), task=task, problem=problem,
                           q0=np.concatenate([[problem.guess], start]))


def run(tool: SimpleNamespace) -> tuple[Array, Array]:
    """Return rocker angles and closure errors; start from the last position."""
    problem, task = tool.problem, tool.task
    configuration = pink.Configuration(tool.model, tool.data, tool.q0, forward_kinematics=True)
    angles, closures = [], []
    for target in problem.crank_path()[:, 0]:
        for _ in range(MAX_CORRECTIONS):
            pose = configuration.get_transform_frame_to_world("coupler_a")
            closure = float(np.linalg.norm(target - pose.translation))
            if closure <= problem.tolerance:
                break
            task.set_target(pin.SE3(pose.rotation, target))
            velocity = pink.solve_ik(configuration, [task], 1.0, solver="daqp", damping=1e-12,
                                     limits=[])
            configuration.integrate_inplace(velocity, 1.0)
        angles.append(configuration.q[0])
        closures.append(closure)
    return np.array(angles), np.array(closures)


CASES = tuple(Case("sweep", NAME, "FrameTask to the end with daqp, q only",
                   partial(setup, Problem(steps=n)), run, rssr.judge_positions, n, n)
              for n in rssr.STEPS)
ABSENT = (
    Absent("rates", NAME, "solve_ik gives velocities towards a target, no accelerations"),
    Absent("jacobian", NAME, "gives Jacobians of the open tree only"),
    Absent("assembly", NAME, "the first angle of the sweep is one; not timed by itself"),
    Absent("mobility", NAME, "has no such analysis"),
    *(Absent(task, NAME, "inverse kinematics only: no constrained motion")
      for task in ("forward", "a02", "a04")),
)
