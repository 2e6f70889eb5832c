"""placo: the loop closed by a hard relative-position task of its kinematics solver.

As its examples for loop closures do. URDF has no ball, so the coupler hangs on the rocker by two
hinges, which leaves its spin out; the crank is a joint task, hard too. The solver gives
displacements: positions only.
"""

from __future__ import annotations

import math
import tempfile
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import placo

from benchmark import rssr
from benchmark.case import Absent, Case
from benchmark.rssr import MAX_CORRECTIONS, Array, Problem

NAME = "placo"
LINK = ('<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>')
JOINT = ('<joint name="{0}" type="{4}"><parent link="{1}"/><child link="{0}_link"/>'
         '<origin xyz="{2}" rpy="{5}"/><axis xyz="{3}"/>'
         '<limit lower="-10" upper="10" effort="1" velocity="1e9"/></joint>')


def urdf(problem: Problem) -> str:
    """Return the tree; the coupler lies along its own x, its hinges about y and z."""
    x = problem.rocker_to_coupler()[:, 0]
    along = f"0 {-math.asin(x[2])!r} {math.atan2(x[1], x[0])!r}"
    joints = (
        ("crank", "ground", "0 0 0", "0 1 0", "revolute", "0 0 0"),
        ("crank_a", "crank_link", f"{-problem.a} 0 0", "1 0 0", "fixed", "0 0 0"),
        ("rocker", "ground", f"{-problem.d} 0 0", "0 0 -1", "revolute", "0 0 0"),
        ("turn", "rocker_link", f"{-problem.c} 0 0", "0 0 1", "revolute", along),
        ("rise", "turn_link", "0 0 0", "0 1 0", "revolute", "0 0 0"),
        ("coupler_a", "rise_link", f"{-problem.b} 0 0", "1 0 0", "fixed", "0 0 0"),
    )
    parts = [LINK.format("ground")]
    for entry in joints:
        parts += [LINK.format(f"{entry[0]}_link"), JOINT.format(*entry)]
    return f'<robot name="rssr">{"".join(parts)}</robot>'


def setup(problem: Problem) -> SimpleNamespace:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(urdf(problem))
        robot = placo.RobotWrapper(str(path), placo.Flags.ignore_collisions)
    solver = placo.KinematicsSolver(robot)
    solver.mask_fbase(True)
    solver.enable_joint_limits(False)
    solver.enable_velocity_limits(False)
    closing = solver.add_relative_position_task("crank_a_link", "coupler_a_link", np.zeros(3))
    closing.configure("closing", "hard")
    crank = solver.add_joints_task()
    crank.configure("crank", "hard")
    at = robot.get_joint_offset("rocker")
    return SimpleNamespace(robot=robot, solver=solver, closing=closing, crank=crank,
                           problem=problem, at=at)


def run(tool: SimpleNamespace) -> tuple[Array, Array]:
    """Return rocker angles and closure errors; start from the last position."""
    robot, solver, crank, problem = tool.robot, tool.solver, tool.crank, tool.problem
    for name in ("crank", "turn", "rise"):
        robot.set_joint(name, 0.0)
    robot.set_joint("rocker", problem.guess)
    angles, closures = [], []
    robot.update_kinematics()
    for phi in problem.phi.tolist():
        crank.set_joint("crank", phi)
        for _ in range(MAX_CORRECTIONS):
            solver.solve(True)
            robot.update_kinematics()
            tool.closing.update()
            closure = float(tool.closing.error_norm())
            if closure <= problem.tolerance and abs(robot.get_joint("crank") - phi) < 1e-14:
                break
        angles.append(robot.state.q[tool.at])
        closures.append(closure)
    return np.array(angles), np.array(closures)


CASES = tuple(Case("sweep", NAME, "hard closing task, q only",
                   partial(setup, Problem(steps=n)), run, rssr.judge_positions, n, n)
              for n in rssr.STEPS)
ABSENT = (
    Absent("rates", NAME, "its kinematics solver gives displacements, no accelerations"),
    Absent("jacobian", NAME, "gives Jacobians of the open tree only"),
    Absent("assembly", NAME, "the first angle of the sweep is one; not timed by itself"),
    Absent("mobility", NAME, "has no such analysis"),
    *(Absent(task, NAME, "its dynamics solver is inverse dynamics by QP: no constrained motion")
      for task in ("forward", "a02", "a04")),
)
