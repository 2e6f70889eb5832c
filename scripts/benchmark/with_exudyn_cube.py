"""Exudyn on the overconstrained Bricard cube: 3-D bodies, revolute joints, one equation left out.

Its solvers need independent constraints; of the six hinges the last keeps four of its five
equations, those that leave one freedom at the start.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import exudyn as exu
import numpy as np
from exudyn.utilities import RigidBodyInertia

from benchmark import cube
from benchmark.case import Case
from benchmark.rssr import Array
from benchmark.with_exudyn import NAME, run, settings

LAST = [1, 1, 1, 0, 1, 0]  # constrained translations and rotations of the last hinge, its axis z


def turned(axis: Array) -> Array:
    """Return a rotation (3, 3) whose z is `axis`."""
    x = np.roll(axis, 1)
    return np.column_stack([x, np.cross(axis, x), axis])


def setup(steps: int) -> SimpleNamespace:
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
    mbs.CreateGenericJoint(bodyNumbers=[before, ground], position=cube.POST,
                           rotationMatrixAxes=turned(cube.unit(cube.AXES[-1])),
                           constrainedAxes=LAST, useGlobalFrame=True)
    mbs.Assemble()
    made = settings(steps, cube.DURATION, 0.95, exu.LinearSolverType.EXUdense)
    return SimpleNamespace(container=container, mbs=mbs, bodies=bodies, settings=made,
                           start=mbs.systemData.GetSystemState())


def place(tool: SimpleNamespace, body: int, at: Array) -> Array:
    where = exu.OutputVariableType.Position
    return np.array(tool.mbs.GetObjectOutputBody(tool.bodies[body], where, localPosition=at))


def judge(tool: SimpleNamespace, _: Array) -> dict[str, float | None]:
    edges = cube.edges()
    gap = place(tool, -1, edges[-1] / 2) - cube.POST
    return cube.judge(place(tool, cube.P3_ROD, edges[cube.P3_ROD] / 2), float(np.linalg.norm(gap)))


CASES = tuple(Case("a04", NAME, f"generalized-α, index 3, one equation left out, {h:g} s",
                   partial(setup, round(cube.DURATION / h)), run, judge) for h in (5e-3, 1e-3))
