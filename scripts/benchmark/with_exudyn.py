"""Exudyn: rigid bodies in redundant coordinates, joints as constraints, implicit integration.

Used as its own example of the IFToMM four-bars does: 2-D bodies and joints, generalized-α on the
constraints of position, spectral radius 0.95, modified Newton.
"""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace

import exudyn as exu
import numpy as np
from exudyn import itemInterface as items

from benchmark import ladder
from benchmark.case import Absent, Case
from benchmark.rssr import Array

NAME = "Exudyn"


def settings(
    steps: int, duration: float, radius: float, solver: exu.LinearSolverType
) -> exu.SimulationSettings:
    """Return settings without output; modified Newton, as the examples use for speed."""
    made = exu.SimulationSettings()
    made.timeIntegration.numberOfSteps = steps
    made.timeIntegration.endTime = duration
    made.timeIntegration.verboseMode = 0
    made.timeIntegration.newton.useModifiedNewton = True
    made.timeIntegration.newton.relativeTolerance = 1e-10
    made.timeIntegration.newton.absoluteTolerance = 1e-12
    made.timeIntegration.generalizedAlpha.spectralRadius = radius
    made.timeIntegration.generalizedAlpha.computeInitialAccelerations = True
    made.solutionSettings.writeSolutionToFile = False
    made.solutionSettings.sensorsWritePeriod = duration
    made.linearSolverType = solver
    return made


def setup_ladder(n: int, turn: float, rate: float, steps: int, duration: float) -> SimpleNamespace:
    """Rods as 2-D bodies with their middles as reference points."""
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    s, c = math.sin(turn), math.cos(turn)

    def bar(x: float, y: float, angle: float, vx: float, vy: float, spin: float) -> SimpleNamespace:
        node = mbs.AddNode(items.NodeRigidBody2D(
            referenceCoordinates=[x, y, angle], initialVelocities=[vx, vy, spin]))
        body = mbs.AddObject(items.RigidBody2D(nodeNumber=node, physicsMass=1.0,
                                               physicsInertia=ladder.ROD))
        mass = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
        mbs.AddLoad(items.LoadMassProportional(markerNumber=mass,
                                               loadVector=[0.0, -ladder.G, 0.0]))
        near, far = (mbs.AddMarker(items.MarkerBodyPosition(
            bodyNumber=body, localPosition=[side, 0.0, 0.0])) for side in (-0.5, 0.5))
        return SimpleNamespace(node=node, body=body, near=near, far=far)

    def join(one: int, other: int) -> None:
        mbs.AddObject(items.RevoluteJoint2D(markerNumbers=[one, other]))

    ground, upright = mbs.AddObject(items.ObjectGround()), math.pi / 2
    rods = [bar(i + s / 2, c / 2, upright - turn, rate * c / 2, -rate * s / 2, -rate)
            for i in range(n + 1)]
    bars = [bar(i + 0.5 + s, c, 0.0, rate * c, -rate * s, 0.0) for i in range(n)]
    for i, rod in enumerate(rods):
        foot = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=ground,
                                                      localPosition=[i, 0.0, 0.0]))
        join(foot, rod.near)
    for i, top in enumerate(bars):
        join(rods[i].far, top.near)
        join(top.far, rods[i + 1].far)
    mbs.Assemble()
    solver = exu.LinearSolverType.EigenSparse if n > 2 else exu.LinearSolverType.EXUdense
    return SimpleNamespace(container=container, mbs=mbs, rods=rods, bars=bars, loops=n, turn=turn,
                           settings=settings(steps, duration, 0.95, solver), steps=steps,
                           start=mbs.systemData.GetSystemState())


def run(tool: SimpleNamespace) -> Array:
    """Return the coordinates at the end."""
    tool.mbs.systemData.SetSystemState(tool.start)
    if not tool.mbs.SolveDynamic(tool.settings):
        raise RuntimeError("the integration failed")
    return tool.mbs.systemData.GetODE2Coordinates()


def opening(tool: SimpleNamespace) -> float:
    """Return the distance between the coupler's end and the second rod's [m]."""
    where = exu.OutputVariableType.Position
    ends = [tool.mbs.GetObjectOutputBody(b.body, where, localPosition=[0.5, 0.0, 0.0])
            for b in (tool.bars[0], tool.rods[1])]
    return float(np.linalg.norm(np.subtract(*ends)))


def judge_a02(tool: SimpleNamespace, q: Array) -> dict[str, float | None]:
    return ladder.judge_end(tool.turn - float(q[2]), opening(tool))


def judge_forward(tool: SimpleNamespace, _: Array) -> dict[str, float | None]:
    """Judge the acceleration at the end by the angle there."""
    turned = tool.turn - tool.mbs.systemData.GetODE2Coordinates()[2]
    found = -tool.mbs.systemData.GetODE2Coordinates_tt()[2]
    return {"acceleration": abs(found - ladder.growth(tool.loops) * math.sin(turned))}


STEPS = (5e-3, 1e-3, 1e-4)
CASES = (
    *(Case("forward", NAME, "an implicit step of 1 ms, mean of 50",
           partial(setup_ladder, n, ladder.ANGLE, ladder.RATE, 50, 0.05), run, judge_forward, 50,
           n) for n in ladder.SIZES),
    *(Case("a02", NAME, f"generalized-α, index 3, {h:g} s",
           partial(setup_ladder, 1, 0.0, ladder.START, round(ladder.DURATION / h),
                   ladder.DURATION), run, judge_a02, slow=h < 1e-3) for h in STEPS),
)
ABSENT = (
    Absent("sweep", NAME, "has no kinematic solver with rates, so the motion is integrated"),
    *(Absent(task, NAME, "has no kinematic solver") for task in ("rates", "jacobian", "assembly")),
    Absent("mobility", NAME, "has no such analysis of the configuration"),
    Absent("forward", NAME, "accelerations at a state are not offered, only steps in time"),
)
