"""Exudyn: rigid bodies in redundant coordinates, joints as constraints, implicit integration.

Used as its own example of the IFToMM four-bars does: generalized-α on the constraints of position,
spectral radius 0.95, modified Newton; the ladder of 2-D bodies and joints. Its solvers need
independent constraints: of the cube's six hinges the last keeps four of its five equations, those
that leave one freedom at the start.
"""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace

import exudyn as exu
import numpy as np
from exudyn import itemInterface as items
from exudyn.utilities import RigidBodyInertia

from benchmark import cube, ladder
from benchmark.case import Absent, Case
from benchmark.rssr import Array

NAME = "Exudyn"
WHERE = exu.OutputVariableType.Position
LAST = [1, 1, 1, 0, 1, 0]  # constrained translations and rotations of the last hinge, its axis z


def ready(mbs: exu.MainSystem, container: exu.SystemContainer, h: float, duration: float,
          bodies: list[int]) -> SimpleNamespace:
    """Assemble, with settings without output; modified Newton, as the examples use for speed."""
    mbs.Assemble()
    made = exu.SimulationSettings()
    made.timeIntegration.numberOfSteps = round(duration / h)
    made.timeIntegration.endTime = duration
    made.timeIntegration.verboseMode = 0
    made.timeIntegration.newton.useModifiedNewton = True
    made.timeIntegration.newton.relativeTolerance = 1e-10
    made.timeIntegration.newton.absoluteTolerance = 1e-12
    made.timeIntegration.generalizedAlpha.spectralRadius = 0.95
    made.timeIntegration.generalizedAlpha.computeInitialAccelerations = True
    made.solutionSettings.writeSolutionToFile = False
    made.solutionSettings.sensorsWritePeriod = duration
    made.linearSolverType = exu.LinearSolverType.EXUdense
    return SimpleNamespace(container=container, mbs=mbs, bodies=bodies, settings=made,
                           start=mbs.systemData.GetSystemState())


def setup_ladder(h: float) -> SimpleNamespace:
    """Two rods and a coupler as 2-D bodies with their middles as reference points."""
    container = exu.SystemContainer()
    mbs, rate = container.AddSystem(), ladder.START
    ground = mbs.AddObject(items.ObjectGround())

    def marker(body: int, x: float) -> int:
        return mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=body, localPosition=[x, 0.0, 0.0]))

    def bar(x: float, y: float, angle: float, vx: float, spin: float) -> int:
        node = mbs.AddNode(items.NodeRigidBody2D(
            referenceCoordinates=[x, y, angle], initialVelocities=[vx, 0.0, spin]))
        body = mbs.AddObject(items.RigidBody2D(nodeNumber=node, physicsMass=1.0,
                                               physicsInertia=ladder.ROD))
        mass = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
        mbs.AddLoad(items.LoadMassProportional(markerNumber=mass,
                                               loadVector=[0.0, -ladder.G, 0.0]))
        return body

    rods = [bar(float(i), 0.5, math.pi / 2, rate / 2, -rate) for i in range(2)]
    coupler = bar(0.5, 1.0, 0.0, rate, 0.0)
    for pair in (((ground, 0.0), (rods[0], -0.5)), ((ground, 1.0), (rods[1], -0.5)),
                 ((rods[0], 0.5), (coupler, -0.5)), ((coupler, 0.5), (rods[1], 0.5))):
        mbs.AddObject(items.RevoluteJoint2D(markerNumbers=[marker(*end) for end in pair]))
    return ready(mbs, container, h, ladder.DURATION, [rods[0], coupler, rods[1]])


def setup_cube(h: float) -> SimpleNamespace:
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    ground = mbs.CreateGround()
    before, bodies = ground, []
    for axis, edge, corner in zip(cube.AXES, cube.edges(), cube.CORNERS, strict=False):
        moments = np.diag(cube.moments(edge))
        inertia = RigidBodyInertia(mass=cube.MASS, com=np.zeros(3), inertiaTensor=moments,
                                   inertiaTensorAtCOM=True)
        body = mbs.CreateRigidBody(referencePosition=corner + edge / 2, inertia=inertia,
                                   gravity=[0.0, -cube.G, 0.0])
        mbs.CreateRevoluteJoint(bodyNumbers=[before, body], position=corner, axis=cube.unit(axis),
                                useGlobalFrame=True)
        before = body
        bodies.append(body)
    axis = cube.unit(cube.AXES[-1])
    x = np.roll(axis, 1)
    mbs.CreateGenericJoint(bodyNumbers=[before, ground], position=cube.POST,
                           rotationMatrixAxes=np.column_stack([x, np.cross(axis, x), axis]),
                           constrainedAxes=LAST, useGlobalFrame=True)
    return ready(mbs, container, h, cube.DURATION, bodies)


def run(tool: SimpleNamespace) -> Array:
    """Return the coordinates at the end."""
    tool.mbs.systemData.SetSystemState(tool.start)
    if not tool.mbs.SolveDynamic(tool.settings):
        raise RuntimeError("the integration failed")
    return tool.mbs.systemData.GetODE2Coordinates()


def position(tool: SimpleNamespace, body: int, at: Array) -> Array:
    """Return where a point of a body is."""
    return np.array(tool.mbs.GetObjectOutputBody(tool.bodies[body], WHERE, localPosition=at))


def judge_a02(tool: SimpleNamespace, q: Array) -> dict[str, float | None]:
    end = np.array([0.5, 0.0, 0.0])
    gap = position(tool, 1, end) - position(tool, 2, end)
    return ladder.judge_end(-float(q[2]), float(np.linalg.norm(gap)))


def judge_a04(tool: SimpleNamespace, _: Array) -> dict[str, float | None]:
    edges = cube.edges()
    gap = position(tool, -1, edges[-1] / 2) - cube.POST
    end = position(tool, cube.P3_ROD, edges[cube.P3_ROD] / 2)
    return cube.judge(end, float(np.linalg.norm(gap)))


CASES = (
    *(Case("a02", NAME, f"generalized-α, index 3, {h:g} s", partial(setup_ladder, h), run,
           judge_a02, slow=h < 1e-3) for h in (5e-3, 1e-3, 1e-4)),
    *(Case("a04", NAME, f"generalized-α, index 3, one equation left out, {h:g} s",
           partial(setup_cube, h), run, judge_a04) for h in (5e-3, 1e-3)),
)
ABSENT = (
    *(Absent(task, NAME, "has no kinematic solver")
      for task in ("sweep", "rates", "jacobian", "assembly")),
    Absent("forward", NAME, "accelerations at a state are not offered, only steps in time"),
)
