"""Exudyn on the RSSR: integrated with the crank's speed prescribed, for want of a kinematic solver.

Crank and rocker are 1-D rotors, the coupler a rigid body between two spherical joints; without
moments about its own axis it does not spin, as asked. A step of generalized-α for every crank
angle, from the closed first position at the right speeds.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import exudyn as exu
import numpy as np
from exudyn import itemInterface as items
from exudyn.utilities import RigidBodyInertia

from benchmark import rssr
from benchmark.case import Case
from benchmark.rssr import Array, Problem
from benchmark.with_exudyn import NAME, settings

CRANK_AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # z of it is +y
ROCKER_AXES = np.diag([1.0, -1.0, -1.0])


def setup(problem: Problem) -> SimpleNamespace:
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    exact = problem.exact()
    psi, rate = exact.angle[0], exact.rate[0]

    def rotor(axes: Array, at: list, angle: float, speed: float, end: list) -> tuple[int, int]:
        node = mbs.AddNode(items.Node1D(referenceCoordinates=[angle], initialVelocities=[speed]))
        body = mbs.AddObject(items.Rotor1D(nodeNumber=node, physicsInertia=1.0,
                                           referencePosition=at, referenceRotation=axes))
        return node, mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=body, localPosition=end))

    crank, at_a = rotor(CRANK_AXES, [0.0] * 3, 0.0, problem.speed, [0.0, -problem.a, 0.0])
    rocker, at_b = rotor(ROCKER_AXES, [-problem.d, 0.0, 0.0], psi, rate, [-problem.c, 0.0, 0.0])
    a, velocity = problem.crank_path()[0, :2]
    b = np.array([-problem.d - problem.c * np.cos(psi), problem.c * np.sin(psi), 0.0])
    x = (b - a) / problem.b
    y = np.array([-x[1], x[0], 0.0]) / np.hypot(*x[:2])
    rod = RigidBodyInertia(mass=1.0, com=np.zeros(3), inertiaTensor=np.diag([0.01, 0.1, 0.1]),
                           inertiaTensorAtCOM=True)
    coupler = mbs.CreateRigidBody(
        referencePosition=(a + b) / 2, referenceRotationMatrix=np.column_stack(
            [x, y, np.cross(x, y)]), inertia=rod, initialAngularVelocity=exact.omega[0],
        initialVelocity=velocity + np.cross(exact.omega[0], (b - a) / 2))
    for end, side in ((at_a, -0.5), (at_b, 0.5)):
        marker = mbs.AddMarker(items.MarkerBodyPosition(
            bodyNumber=coupler, localPosition=[side * problem.b, 0.0, 0.0]))
        mbs.AddObject(items.SphericalJoint(markerNumbers=[end, marker]))
    ground = mbs.AddNode(items.NodePointGround())
    driver = [mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=n, coordinate=0))
              for n in (ground, crank)]
    mbs.AddObject(items.CoordinateConstraint(markerNumbers=driver, velocityLevel=True,
                                             offset=problem.speed))
    kinds = exu.OutputVariableType
    sensors = [mbs.AddSensor(items.SensorNode(nodeNumber=rocker, outputVariableType=kind,
                                              storeInternal=True))
               for kind in (kinds.Coordinates, kinds.Coordinates_t, kinds.Coordinates_tt)]
    sensors += [mbs.AddSensor(items.SensorBody(bodyNumber=coupler, outputVariableType=kind,
                                               storeInternal=True))
                for kind in (kinds.AngularVelocity, kinds.AngularAcceleration)]
    sensors += [mbs.AddSensor(items.SensorMarker(markerNumber=m, outputVariableType=kinds.Position,
                                                 storeInternal=True)) for m in (marker, at_b)]
    mbs.Assemble()
    made = settings(problem.steps - 1, problem.time_step * (problem.steps - 1), 0.95,
                    exu.LinearSolverType.EXUdense)
    made.solutionSettings.sensorsWritePeriod = problem.time_step * 0.5
    return SimpleNamespace(container=container, mbs=mbs, sensors=sensors, settings=made,
                           problem=problem, psi=psi, start=mbs.systemData.GetSystemState())


def run(tool: SimpleNamespace) -> list[Array]:
    """Return what the sensors stored, time first."""
    tool.mbs.systemData.SetSystemState(tool.start)
    if not tool.mbs.SolveDynamic(tool.settings):
        raise RuntimeError("the integration failed")
    return [tool.mbs.GetSensorStoredData(sensor) for sensor in tool.sensors]


def judge(tool: SimpleNamespace, stored: list[Array]) -> dict[str, float | None]:
    angle, rate, acceleration, omega, alpha, one, other = (s[:, 1:] for s in stored)
    return rssr.judge(tool.problem, (
        np.linalg.norm(one - other, axis=1), tool.psi + angle[:, 0], rate[:, 0],
        acceleration[:, 0], omega, alpha))


CASES = tuple(Case("sweep", NAME, "integrated, generalized-α, index 3, a step each",
                   partial(setup, Problem(steps=n)), run, judge, n, n) for n in rssr.STEPS)
