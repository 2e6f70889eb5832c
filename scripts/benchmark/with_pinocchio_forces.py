"""Pinocchio's constrained dynamics by hand: one evaluation, and Runge-Kutta of fourth order."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from benchmark import cube, falling, ladder
from benchmark.case import Case
from benchmark.rssr import Array

NAME = "Pinocchio by hand"
STIFFNESS, DAMPING = 100.0, 20.0  # of Baumgarte's terms, critically damped [1/s², 1/s]
STEPS = (5e-3, 2e-3, 1e-3)  # [s]


def translation(at: ArrayLike) -> pin.SE3:
    return pin.SE3(np.eye(3), np.asarray(at, dtype=float))


def contact(
    model: pin.Model, one: tuple[int, Array], other: tuple[int, Array]
) -> pin.RigidConstraintModel:
    """Return a closure of two points, kept closed by Baumgarte's terms."""
    made = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D, model, one[0], translation(one[1]), other[0],
        translation(other[1]), pin.ReferenceFrame.LOCAL)
    made.m_baumgarte_parameters.Kp = STIFFNESS
    made.m_baumgarte_parameters.Kd = DAMPING
    return made


def ready(model: pin.Model, closures: list, q: Array, v: Array) -> SimpleNamespace:
    """Return all that `constraintDynamics` takes, in the containers that cost least."""
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for closure in closures:
        models.append(closure)
        datas.append(closure.createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    return SimpleNamespace(model=model, data=data, models=models, datas=datas, q=q, v=v,
                           settings=pin.ProximalSettings(1e-12, 1e-10, 20),
                           none=np.zeros(model.nv))


def setup_ladder(n: int, turn: float, rate: float) -> SimpleNamespace:
    """Rods along their x: pins on the ground, each coupler on its rod, its end on the next."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -ladder.G, 0.0])
    bar = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.0, ladder.ROD, ladder.ROD]))
    hinge, rods, bars = pin.JointModelRZ(), [], []
    for i in range(n + 1):
        rods.append(model.addJoint(0, hinge, translation((i, 0.0, 0.0)), f"rod_{i}"))
        model.appendBodyToJoint(rods[-1], bar, pin.SE3.Identity())
        if i < n:
            bars.append(model.addJoint(rods[-1], hinge, translation((1.0, 0.0, 0.0)), f"bar_{i}"))
            model.appendBodyToJoint(bars[-1], bar, pin.SE3.Identity())
    tip = np.array([1.0, 0.0, 0.0])
    closures = [contact(model, (bars[i], tip), (rods[i + 1], tip)) for i in range(n)]
    upright = np.pi / 2 - turn
    q, v = np.empty(model.nq), np.empty(model.nv)
    at = [model.idx_qs[j] for j in rods], [model.idx_qs[j] for j in bars]
    q[at[0]], q[at[1]], v[at[0]], v[at[1]] = upright, -upright, -rate, rate
    tool = ready(model, closures, q, v)
    tool.loops, tool.upright = n, np.pi / 2
    return tool


def acceleration(tool: SimpleNamespace, q: Array, v: Array) -> Array:
    """Return a copy of the constrained acceleration."""
    return pin.constraintDynamics(tool.model, tool.data, q, v, tool.none, tool.models, tool.datas,
                                  tool.settings).copy()


def run_forward(tool: SimpleNamespace) -> float:
    return float(-acceleration(tool, tool.q, tool.v)[0])


def judge_forward(tool: SimpleNamespace, found: float) -> dict[str, float | None]:
    return ladder.judge_acceleration(tool.loops, found)


# Simulation


def rk4(
    acceleration: Callable[[Array, Array], Array], q: Array, v: Array, step: float, duration: float
) -> tuple[Array, Array]:
    """Return coordinates and velocities at the end; all joints are hinges, q' = v."""
    h = step
    for _ in range(round(duration / h)):
        k1 = acceleration(q, v)
        k2 = acceleration(q + 0.5 * h * v, v + 0.5 * h * k1)
        k3 = acceleration(q + 0.5 * h * v + 0.25 * h * h * k1, v + 0.5 * h * k2)
        k4 = acceleration(q + h * v + 0.5 * h * h * k2, v + h * k3)
        q = q + h * v + h * h / 6.0 * (k1 + k2 + k3)
        v = v + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return q, v


def setup_cube() -> SimpleNamespace:
    """Close the last hinge by two points on its axis, one equation too many."""
    model, parent, at = pin.Model(), 0, cube.CORNERS[0]
    model.gravity.linear = np.array([0.0, -cube.G, 0.0])
    for axis, edge in zip(cube.AXES, cube.edges(), strict=False):
        hinge = pin.JointModelRevoluteUnaligned(cube.unit(axis))
        parent = model.addJoint(parent, hinge, translation(at), f"rod_{model.njoints}")
        rod = pin.Inertia(cube.MASS, edge / 2.0, np.diag(cube.moments(edge)))
        model.appendBodyToJoint(parent, rod, pin.SE3.Identity())
        at = edge
    last = cube.unit(cube.AXES[-1])
    closures = [contact(model, (parent, at + s * last), (0, cube.POST + s * last))
                for s in (-0.5, 0.5)]
    return ready(model, closures, np.zeros(model.nq), np.zeros(model.nv))


def run_rk4(tool: SimpleNamespace, step: float, duration: float) -> tuple[Array, float]:
    """Return the last configuration, and the largest closure error there [m]."""
    q, _ = rk4(partial(acceleration, tool), tool.q, tool.v, step, duration)
    return q, opening(tool, q)


def opening(tool: SimpleNamespace, q: Array) -> float:
    """Return the largest closure error [m]."""
    pin.forwardKinematics(tool.model, tool.data, q)
    gaps = [tool.data.oMi[c.joint1_id].act(c.joint1_placement.translation)
            - tool.data.oMi[c.joint2_id].act(c.joint2_placement.translation) for c in tool.models]
    return max(float(np.linalg.norm(gap)) for gap in gaps)


def judge_a02(tool: SimpleNamespace, result: tuple[Array, float]) -> dict[str, float | None]:
    return ladder.judge_end(float(tool.upright - result[0][0]), result[1])


def judge_a04(tool: SimpleNamespace, result: tuple[Array, float]) -> dict[str, float | None]:
    pin.forwardKinematics(tool.model, tool.data, result[0])
    corner = tool.data.oMi[cube.P3_ROD + 1].act(cube.edges()[cube.P3_ROD])
    return cube.judge(corner, result[1])


def setup_falling(make: Callable[[], falling.Robot]) -> SimpleNamespace:
    """Hinges about z; each closure is two points in space, which keeps the plane too."""
    robot, model = make(), pin.Model()
    model.gravity.linear = np.array([0.0, -falling.G, 0.0])
    for rod in robot.rods:
        body = model.addJoint(rod.parent + 1, pin.JointModelRZ(), translation((*rod.at, 0.0)),
                              rod.name)
        moments = np.diag([0.5 * rod.inertia, 0.5 * rod.inertia, rod.inertia])
        inertia = pin.Inertia(rod.mass, np.array([*rod.com, 0.0]), moments)
        model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
    closures = [contact(model, (one + 1, np.array([*at, 0.0])),
                        (other + 1, np.array([*there, 0.0])))
                for one, at, other, there in robot.closures]
    tool = ready(model, closures, np.array([rod.angle for rod in robot.rods]),
                 np.zeros(model.nv))
    tool.robot = robot
    return tool


def run_falling(tool: SimpleNamespace, step: float) -> tuple[Array, Array]:
    return rk4(partial(acceleration, tool), tool.q, tool.v, step, falling.DURATION)


def judge_falling(tool: SimpleNamespace, result: tuple[Array, Array]) -> dict[str, float | None]:
    model, data = tool.model, tool.data
    start, end = (pin.computeMechanicalEnergy(model, data, q, v)
                  for q, v in ((tool.q, tool.v), result))
    return falling.judge(tool.robot, end - start, opening(tool, result[0]))


CASES = (
    *(Case("forward", NAME, "constraintDynamics", partial(setup_ladder, n, ladder.ANGLE,
           ladder.RATE), run_forward, judge_forward, size=n) for n in ladder.SIZES),
    *(Case("a02", NAME, f"constraintDynamics + Baumgarte, RK4 at {h:g} s",
           partial(setup_ladder, 1, 0.0, ladder.START),
           partial(run_rk4, step=h, duration=ladder.DURATION), judge_a02) for h in STEPS),
    *(Case("a04", NAME, f"constraintDynamics + Baumgarte, RK4 at {h:g} s", setup_cube,
           partial(run_rk4, step=h, duration=cube.DURATION), judge_a04) for h in STEPS),
    *(Case(task, NAME, f"constraintDynamics + Baumgarte, RK4 at {h:g} s",
           partial(setup_falling, make), partial(run_falling, step=h), judge_falling)
      for task, make in falling.ROBOTS.items() for h in STEPS),
)
