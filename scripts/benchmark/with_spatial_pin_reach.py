"""This library, through its public interface: targets in space."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from benchmark import closed
from benchmark.case import Case
from benchmark.closed import Robot, Target, Tool, Values

NAME = "spatial_pin"


def goal(robot: Robot, target: Target) -> dict[str, Any]:
    """Return a target as this library takes it."""
    if robot.kind == "joints":
        return dict(target.values)
    point = target.pose[:3, 3]
    turned = robot.kind == "placement"
    return {f"{robot.frame}_link": pin.SE3(target.pose[:3, :3], point) if turned else point}


def make(robot: Robot) -> tuple[Any, Any, Any]:
    with tempfile.TemporaryDirectory() as folder:
        mechanism = sp.load(robot.write(Path(folder)))

    def solve(target: Target, state: sp.State) -> sp.State:
        return sp.reach(mechanism, goal(robot, target), state)

    def values(state: sp.State) -> Values:
        return {name: state.coordinate(name).value for name in robot.moving}

    return sp.assemble(mechanism), solve, values


def run_path(tool: Tool) -> sp.Motion:
    goals = [goal(tool.robot, target) for target in tool.targets]
    tables = {name: [x[name] for x in goals] for name in goals[0]}
    if tool.robot.kind == "point":
        tables = {name: np.array(x) for name, x in tables.items()}
    return sp.reach_path(tool.home.mechanism, tables, None, tool.home)


def judge_path(tool: Tool, motion: sp.Motion) -> dict[str, float | None]:
    return closed.judge(tool, [motion.state(k) for k in range(len(motion))])


def paths(cases: tuple[Case, ...]) -> tuple[Case, ...]:
    """Return the cases, paths by `reach_path` instead of one target after the other."""
    return tuple(Case(c.task, c.tool, "reach_path, with rates", c.setup, run_path, judge_path,
                      c.count) if c.task.startswith("path") else c for c in cases)


CASES = paths(closed.cases(NAME, "reach", make))
