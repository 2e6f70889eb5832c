"""The RSSR on the Jacobians of Drake's MultibodyPlant, plain and tuned.

Drake closes loops in its discrete solver only, and softly; so Newton is ours, as for MuJoCo.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    JacobianWrtVariable,
    RevoluteJoint,
    SpatialInertia,
)
from scipy.linalg.blas import daxpy, dgemv
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

from benchmark import rssr
from benchmark.case import Absent, Case
from benchmark.rssr import MAX_CORRECTIONS, Array, Problem

ADAMS = (  # Adams-Bashforth weights of the last one to four rates, newest last
    (1.0,),
    (-1 / 2, 3 / 2),
    (5 / 12, -16 / 12, 23 / 12),
    (-9 / 24, 37 / 24, -59 / 24, 55 / 24),
)


def setup_drake(problem: Problem) -> SimpleNamespace:
    """The coupler lies along -z of its own frame: its spin and A's velocity are rows 2 to 5."""
    plant = MultibodyPlant(0.0)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.01)
    crank, rocker, coupler = (
        plant.AddRigidBody(name, inertia) for name in ("crank", "rocker", "coupler")
    )
    crank, rocker, coupler = (body.body_frame() for body in (crank, rocker, coupler))
    x, y, z = problem.rocker_to_coupler().T
    axes = RotationMatrix(np.column_stack([-z, y, x]))  # so that roll, pitch, yaw start at zero
    there = RigidTransform([-problem.d, 0.0, 0.0]), RigidTransform(axes, [-problem.c, 0.0, 0.0])
    pivot = plant.AddFrame(FixedOffsetFrame("pivot", plant.world_frame(), there[0]))
    at_b = plant.AddFrame(FixedOffsetFrame("at_b", rocker, there[1]))
    plant.AddJoint(RevoluteJoint("crank", plant.world_frame(), crank, [0, 1, 0]))
    plant.AddJoint(RevoluteJoint("rocker", pivot, rocker, [0, 0, -1]))
    plant.AddJoint(BallRpyJoint("ball", at_b, coupler))
    plant.Finalize()
    tool = SimpleNamespace(plant=plant, context=plant.CreateDefaultContext(), problem=problem)
    tool.crank, tool.coupler = crank, coupler
    tool.world, tool.wrt = plant.world_frame(), JacobianWrtVariable.kV
    tool.q0 = np.array([0.0, problem.guess, 0.0, 0.0, 0.0])
    tool.tip, tool.pin = np.array([0.0, 0.0, -problem.b]), np.array([-problem.a, 0.0, 0.0])
    tool.points = (coupler, tool.tip), (crank, tool.pin)
    order = [plant.GetJointByName(name).velocity_start() for name in ("crank", "rocker", "ball")]
    if order != [0, 1, 2]:
        raise RuntimeError(f"Drake ordered the joints differently: {order}")
    return tool


def system(tool: SimpleNamespace, q: Array) -> tuple[Array, Array]:
    """Return loop and spin at q, world axes: (4, 5) rows, and what is left of them."""
    plant, context, world = tool.plant, tool.context, tool.world
    rows, rhs = np.empty((4, 5)), np.zeros(4)
    plant.SetPositions(context, q)
    tool.axis = plant.CalcRelativeTransform(context, world, tool.coupler).rotation().matrix()[:, 2]
    one, other = (
        plant.CalcJacobianSpatialVelocity(context, tool.wrt, frame, p, world, world)
        for frame, p in tool.points
    )
    tool.turn = one[:3]
    rows[:3], rows[3] = one[3:] - other[3:], tool.axis @ one[:3]
    p_tip, p_pin = (
        plant.CalcPointsPositions(context, frame, p, world).ravel() for frame, p in tool.points
    )
    rhs[:3] = p_pin - p_tip
    return rows, rhs


def close(tool: SimpleNamespace, q: Array) -> tuple[Array, Array]:
    """Return the closed configuration and its rows, by Newton."""
    step = np.zeros(5)
    for _ in range(MAX_CORRECTIONS):
        rows, rhs = system(tool, q)
        if np.linalg.norm(rhs) <= tool.problem.tolerance:
            return q, rows
        step[1:] = np.linalg.solve(rows[:, 1:], rhs)
        q = q + tool.plant.MapVelocityToQDot(tool.context, step)
    raise RuntimeError("loop open")


def rates(tool: SimpleNamespace, rows: Array) -> tuple[Array, Array]:
    """Return velocities, put into the context too, and accelerations."""
    plant, context, world, speed = tool.plant, tool.context, tool.world, tool.problem.speed
    v, a = np.zeros(5), np.zeros(5)
    v[0] = speed
    v[1:] = np.linalg.solve(rows[:, 1:], -rows[:, 0] * speed)
    plant.SetVelocities(context, v)
    one, other = (
        plant.CalcBiasSpatialAcceleration(context, tool.wrt, frame, p, world, world)
        for frame, p in tool.points
    )
    linear = one.translational() - other.translational()
    a[1:] = np.linalg.solve(rows[:, 1:], -np.array([*linear, tool.axis @ one.rotational()]))
    return v, a


def run_drake(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """Newton on spatial velocity Jacobians, from the last position moved on by its rates."""
    problem, q, moving, kept = tool.problem, tool.q0, np.zeros(5), []
    for phi in problem.phi:
        q = q + problem.time_step * moving
        q[0] = phi
        q, rows = close(tool, q)
        v, a = rates(tool, rows)
        moving = tool.plant.MapVelocityToQDot(tool.context, v)
        kept.append((q, v, a))
    positions, velocities, accelerations = (np.array(x) for x in zip(*kept, strict=True))
    return positions, velocities, accelerations


def run_drake_tuned(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """The tuned loop of `with_pinocchio.run_tuned` on Drake: rows 2 to 5, coupler's axes.

    Drake's coordinates are a vector here (roll, pitch, yaw) and their second derivatives are not
    offered, so the predictor is Adams-Bashforth on the kept coordinate rates.
    """
    plant, context, problem = tool.plant, tool.context, tool.problem
    coupler, tip, world, wrt = tool.coupler, tool.tip, tool.world, tool.wrt
    get_jacobian, get_bias = plant.CalcJacobianSpatialVelocity, plant.CalcBiasSpatialAcceleration
    steps, small = len(problem.phi), problem.tolerance**2
    positions, velocities, accelerations = (np.zeros((steps, 5)) for _ in range(3))
    moves, solved = np.empty((steps, 5)), accelerations[:, 1:]
    history = moves.T
    weights = [problem.time_step * np.array(row) for row in ADAMS]
    path, back = problem.crank_path(), tip[2]
    rhs, step = np.zeros(4), np.zeros(5)
    rotated, correction = rhs[1:], step[1:]
    q = tool.q0
    for i, phi in enumerate(problem.phi.tolist()):
        if i:
            k = min(i, 4)
            q = q + dgemv(1.0, history[:, i - k : i], weights[k - 1])
        q[0] = phi
        target, velocity, acceleration = path[i]
        for _ in range(MAX_CORRECTIONS):
            plant.SetPositions(context, q)
            jacobian = get_jacobian(context, wrt, coupler, tip, world, coupler)[2:, 1:]
            pose = coupler.CalcPoseInWorld(context).GetAsMatrix34()
            rotation = pose[:, :3]
            gap = target - pose[:, 3] - back * pose[:, 2]
            x, y, z = gap.tolist()
            if x * x + y * y + z * z <= small:
                break
            rhs[0] = 0.0
            dgemv(1.0, rotation, gap, 0.0, rotated, 0, 1, 0, 1, 1, 1)
            correction[:] = dgesv(jacobian, rhs, 0, 1)[2]
            q = q + plant.MapVelocityToQDot(context, step)
        else:
            raise RuntimeError(f"loop open at {phi} rad")
        positions[i] = q
        lu, pivots, _ = dgetrf(jacobian)
        rhs[0] = 0.0
        dgemv(1.0, rotation, velocity, 0.0, rotated, 0, 1, 0, 1, 1, 1)
        v = velocities[i]
        v[0] = problem.speed
        v[1:] = dgetrs(lu, pivots, rhs, 0, 1)[0]
        plant.SetVelocities(context, v)
        moves[i] = plant.MapVelocityToQDot(context, v)
        bias = get_bias(context, wrt, coupler, tip, world, coupler).get_coeffs()
        rhs[0] = 0.0
        dgemv(1.0, rotation, acceleration, 0.0, rotated, 0, 1, 0, 1, 1, 1)
        daxpy(bias, rhs, 4, -1.0, 2)
        solved[i] = dgetrs(lu, pivots, rhs, 0, 1)[0]
    return positions, velocities, accelerations


def read_drake(tool: SimpleNamespace, result: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    plant, context, world = tool.plant, tool.context, tool.world
    closure, omega, alpha = [], [], []
    for q, v, a in zip(*result, strict=True):
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        one, other = (
            plant.CalcPointsPositions(context, frame, p, world).ravel()
            for frame, p in ((tool.coupler, tool.tip), (tool.crank, tool.pin))
        )
        closure.append(np.linalg.norm(one - other))
        point = tool.wrt, tool.coupler, tool.tip, world, world
        turn = plant.CalcJacobianSpatialVelocity(context, *point)[:3]
        bias = plant.CalcBiasSpatialAcceleration(context, *point).rotational()
        omega.append(turn @ v)
        alpha.append(turn @ a + bias)
    q, v, a = result
    return np.array(closure), q[:, 1], v[:, 1], a[:, 1], np.array(omega), np.array(alpha)


# One state


def at_one_angle() -> SimpleNamespace:
    tool = setup_drake(Problem(steps=rssr.FEW))
    tool.closed = run_drake(tool)[0][1]
    return tool


def run_rates(tool: SimpleNamespace) -> tuple[Array, Array]:
    return rates(tool, system(tool, tool.closed)[0])


def run_jacobian(tool: SimpleNamespace) -> Array:
    rows = system(tool, tool.closed)[0]
    return tool.turn @ np.concatenate([[1.0], np.linalg.solve(rows[:, 1:], -rows[:, 0])])


def run_assembly(tool: SimpleNamespace) -> Array:
    return close(tool, tool.q0)[0]


def judge(tool: SimpleNamespace, result: Any) -> dict[str, float | None]:
    return rssr.judge(tool.problem, read_drake(tool, result))


def judge_rates(tool: SimpleNamespace, result: tuple[Array, Array]) -> dict[str, float | None]:
    q, v, a = (np.array([x]) for x in (tool.closed, *result))
    return rssr.judge_row(tool.problem, read_drake(tool, (q, v, a)), 1)


def judge_jacobian(tool: SimpleNamespace, result: Array) -> dict[str, float | None]:
    return {"ω": rssr.spin_error(tool.problem, result, 1)}


def judge_assembly(tool: SimpleNamespace, q: Array) -> dict[str, float | None]:
    zero = np.zeros((1, 5))
    return rssr.judge_row(tool.problem, read_drake(tool, (q[None], zero, zero)), 0)


NAME = "Drake"
CASES = (
    *(Case("sweep", NAME, f"Newton on its Jacobians, {how}",
           partial(setup_drake, Problem(steps=n)), run, judge, n, n)
      for n in rssr.STEPS for how, run in (("tuned", run_drake_tuned), ("plain", run_drake))),
    Case("rates", NAME, "Jacobians, biases, two solves", at_one_angle, run_rates, judge_rates),
    Case("jacobian", NAME, "Jacobians, one solve", at_one_angle, run_jacobian, judge_jacobian),
    Case("assembly", NAME, "Newton on its Jacobians from the guess",
         partial(setup_drake, Problem()), run_assembly, judge_assembly),
)
ABSENT = (
    Absent("sweep", NAME, "AddBallConstraint closes loops in the discrete SAP solver only, softly; "
           "InverseKinematics (NLopt, IPOPT, SNOPT) gives positions only"),
    Absent("mobility", NAME, "has no such analysis"),
)
