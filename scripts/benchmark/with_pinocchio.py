"""Pinocchio by hand: the loop tuned for the RSSR alone, and the loop as one writes it first."""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg.blas import daxpy, dgemv
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

from benchmark import rssr
from benchmark.case import Absent, Case
from benchmark.rssr import MAX_CORRECTIONS, Answer, Array, Problem


def point(x: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))


def add_frame(model: pin.Model, name: str, joint: int, x: float) -> int:
    return model.addFrame(pin.Frame(name, joint, point(x), pin.FrameType.OP_FRAME))


def setup_tuned(problem: Problem) -> SimpleNamespace:
    """Cut the loop at A: the crank is driven, so A moves along a path that is known beforehand."""
    model = pin.Model()
    crank = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "crank")
    axis = np.array([0.0, 0.0, -1.0])
    rocker = model.addJoint(0, pin.JointModelRevoluteUnaligned(axis), point(-problem.d), "rocker")
    ball = model.addJoint(rocker, pin.JointModelSpherical(), point(-problem.c), "ball")
    ends = (
        add_frame(model, "coupler_a", ball, -problem.b),
        add_frame(model, "crank_a", crank, -problem.a),
    )
    relative = pin.exp3(-problem.guess * axis) @ problem.guessed_coupler()
    q0 = np.concatenate([[0.0, problem.guess], pin.Quaternion(relative).coeffs()])
    tool = SimpleNamespace(model=model, data=model.createData(), q0=q0, problem=problem)
    tool.ends, tool.coupler, tool.rocker = ends, ends[0], (1, 1)
    return tool


def run_tuned(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """Four rows of one frame Jacobian are the whole problem.

    In the axes of the coupler (x along it) they are the velocity of its end A and its spin: the
    loop and the passive freedom at once, nothing to assemble. The predictor integrates the cubic
    through the last two velocities and accelerations, the corrector is Newton, the last factors
    serve both rates. Everything is written in place: views on Pinocchio's data, BLAS and LAPACK
    called directly with positional arguments (keywords cost as much as the work).
    """
    model, data, tip, problem = tool.model, tool.data, tool.coupler, tool.problem
    kinematics, integrate = pin.forwardKinematics, pin.integrate
    placement = pin.updateFramePlacement
    jacobians, get_jacobian = pin.computeJointJacobians, pin.getFrameJacobian
    get_acceleration, axes = pin.getFrameClassicalAcceleration, pin.LOCAL
    h, small, nv = problem.time_step, problem.tolerance**2, model.nv
    positions = np.empty((problem.steps, model.nq))
    rates = np.zeros((problem.steps, 2, nv))  # velocity and acceleration of each step
    rates[:, 0, 0] = problem.speed
    history = rates.reshape(-1, nv).T
    predictor = np.array([1.5 * h, 7 / 12 * h * h, -0.5 * h, 17 / 12 * h * h])
    p, rotation = data.oMf[tip].translation, data.oMf[tip].rotation
    rhs, step, zero = np.zeros(4), np.zeros(nv), np.zeros(nv)
    correction = step[1:]
    path = problem.crank_path().transpose(1, 0, 2)
    samples = rates[:, 0], rates[:, 0, 1:], rates[:, 1, 1:]
    q = tool.q0
    for i, (phi, target, velocity, acceleration, v, v_others, a_others) in enumerate(
        zip(problem.phi.tolist(), *path, *samples, strict=True)
    ):
        if i > 1:
            q = integrate(model, q, dgemv(1.0, history[:, 2 * i - 4 : 2 * i], predictor))
        elif i == 1:
            q = integrate(model, q, h * rates[0, 0] + h * h / 2 * rates[0, 1])
        q[0] = phi
        for _ in range(MAX_CORRECTIONS):
            jacobians(model, data, q)
            placement(model, data, tip)
            jacobian = get_jacobian(model, data, tip, axes)[:4, 1:]
            gap = target - p
            x, y, z = gap.tolist()
            if x * x + y * y + z * z <= small:
                break
            rhs[3] = 0.0
            dgemv(1.0, rotation, gap, 0.0, rhs, 0, 1, 0, 1, 1, 1)  # rhs[:3] = rotation.T @ gap
            correction[:] = dgesv(jacobian, rhs, 0, 1)[2]
            q = integrate(model, q, step)
        else:
            raise RuntimeError(f"loop open by {math.hypot(x, y, z):.1e} m at {phi} rad")
        positions[i] = q
        lu, pivots, _ = dgetrf(jacobian)
        dgemv(1.0, rotation, velocity, 0.0, v_others, 0, 1, 0, 1, 1, 1)
        dgetrs(lu, pivots, v_others, 0, 1)
        kinematics(model, data, q, v, zero)
        bias = get_acceleration(model, data, tip, axes).vector
        dgemv(1.0, rotation, acceleration, 0.0, a_others, 0, 1, 0, 1, 1, 1)
        daxpy(bias, a_others, 4, -1.0)
        dgetrs(lu, pivots, a_others, 0, 1)
    return positions, rates[:, 0], rates[:, 1]


def setup_plain(problem: Problem) -> SimpleNamespace:
    """Cut the loop at B, as a URDF does, and close it with a 3-D contact constraint."""
    model = pin.Model()
    crank = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "crank")
    ball = model.addJoint(crank, pin.JointModelSpherical(), point(-problem.a), "ball")
    axis = np.array([0.0, 0.0, -1.0])
    rocker = model.addJoint(0, pin.JointModelRevoluteUnaligned(axis), point(-problem.d), "rocker")
    ends = (
        add_frame(model, "coupler_b", ball, problem.b),
        add_frame(model, "rocker_b", rocker, -problem.c),
    )
    kind, at = pin.ContactType.CONTACT_3D, (ball, point(problem.b), rocker, point(-problem.c))
    contact = pin.RigidConstraintModel(kind, model, *at, pin.LOCAL)
    coupler = pin.Quaternion(problem.guessed_coupler()).coeffs()
    q0 = np.concatenate([[0.0], coupler, [problem.guess]])
    tool = SimpleNamespace(model=model, data=model.createData(), q0=q0, problem=problem)
    tool.contact, tool.contact_data = contact, contact.createData()
    tool.ends, tool.coupler, tool.rocker = ends, ends[0], (5, 4)
    return tool


def system(tool: SimpleNamespace, q: Array) -> tuple[Array, Array]:
    """Return loop and spin, in the axes of the coupler: (4, nv) rows, and what is left of them."""
    model, data, contact, contact_data = tool.model, tool.data, tool.contact, tool.contact_data
    rows, rhs = np.empty((4, model.nv)), np.zeros(4)
    pin.computeJointJacobians(model, data, q)
    contact.calc(model, data, contact_data)
    rows[:3] = pin.getConstraintJacobian(model, data, contact, contact_data)
    rows[3] = pin.getFrameJacobian(model, data, tool.coupler, pin.LOCAL)[3]
    rhs[:3] = contact_data.c1Mc2.translation
    return rows, rhs


def close(tool: SimpleNamespace, q: Array) -> tuple[Array, Array]:
    """Return the closed configuration and its rows: Newton, as the documentation suggests."""
    step = np.zeros(tool.model.nv)
    for _ in range(MAX_CORRECTIONS):
        rows, rhs = system(tool, q)
        if np.linalg.norm(rhs) <= tool.problem.tolerance:
            return q, rows
        step[1:] = np.linalg.solve(rows[:, 1:], rhs)
        q = pin.integrate(tool.model, q, step)
    raise RuntimeError(f"loop open at {q[0]} rad")


def rates(tool: SimpleNamespace, q: Array, rows: Array) -> tuple[Array, Array]:
    """Return velocities and accelerations at the crank's constant speed."""
    model, data, speed = tool.model, tool.data, tool.problem.speed
    v, a, rhs = np.zeros(model.nv), np.zeros(model.nv), np.empty(4)
    v[0] = speed
    v[1:] = np.linalg.solve(rows[:, 1:], -rows[:, 0] * speed)
    pin.forwardKinematics(model, data, q, v, a)
    one, other = (pin.getFrameClassicalAcceleration(model, data, f, pin.LOCAL) for f in tool.ends)
    rhs[:3] = tool.contact_data.c1Mc2.rotation @ other.linear - one.linear
    rhs[3] = -one.angular[0]
    a[1:] = np.linalg.solve(rows[:, 1:], rhs)
    return v, a


def run_plain(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """Start each angle from the last position moved on by its velocity."""
    problem, q, v, samples = tool.problem, tool.q0, np.zeros(tool.model.nv), []
    for phi in problem.phi:
        q = pin.integrate(tool.model, q, v * problem.time_step)
        q[0] = phi
        q, rows = close(tool, q)
        v, a = rates(tool, q, rows)
        samples.append((q, v, a))
    positions, velocities, accelerations = (np.array(x) for x in zip(*samples, strict=True))
    return positions, velocities, accelerations


def read_pinocchio(tool: SimpleNamespace, result: tuple[Array, Array, Array]) -> Answer:
    model, data, axes = tool.model, tool.data, pin.LOCAL_WORLD_ALIGNED
    closure, omega, alpha = [], [], []
    for q, v, a in zip(*result, strict=True):
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        one, other = (data.oMf[i].translation for i in tool.ends)
        closure.append(np.linalg.norm(one - other))
        omega.append(pin.getFrameVelocity(model, data, tool.coupler, axes).angular.copy())
        alpha.append(pin.getFrameAcceleration(model, data, tool.coupler, axes).angular.copy())
    iq, iv = tool.rocker
    q, v, a = result
    return Answer(np.array(closure), q[:, iq], v[:, iv], a[:, iv], np.array(omega), np.array(alpha))


def judge(tool: SimpleNamespace, result: Any) -> dict[str, float | None]:
    return rssr.judge(tool.problem, read_pinocchio(tool, result))


# One state


def at_one_angle() -> SimpleNamespace:
    tool = setup_plain(Problem(steps=rssr.FEW))
    tool.closed = run_plain(tool)[0][1]
    return tool


def run_rates(tool: SimpleNamespace) -> tuple[Array, Array]:
    return rates(tool, tool.closed, system(tool, tool.closed)[0])


def run_jacobian(tool: SimpleNamespace) -> Array:
    rows = system(tool, tool.closed)[0]
    v = np.concatenate([[1.0], np.linalg.solve(rows[:, 1:], -rows[:, 0])])
    axes = pin.LOCAL_WORLD_ALIGNED
    return pin.getFrameJacobian(tool.model, tool.data, tool.coupler, axes) @ v


def judge_one(tool: SimpleNamespace, result: tuple[Array, ...]) -> dict[str, float | None]:
    """Judge one row (q, v, a), or a part of it."""
    q, v, a = (np.array([x]) for x in result)
    return rssr.judge_row(tool.problem, read_pinocchio(tool, (q, v, a)), 1)


def judge_rates(tool: SimpleNamespace, result: tuple[Array, Array]) -> dict[str, float | None]:
    return judge_one(tool, (tool.closed, *result))


def judge_jacobian(tool: SimpleNamespace, result: Array) -> dict[str, float | None]:
    return {"ω": rssr.spin_error(tool.problem, result[3:], 1)}


def judge_assembly(tool: SimpleNamespace, result: tuple[Array, Array]) -> dict[str, float | None]:
    zero = np.zeros((1, tool.model.nv))
    read = read_pinocchio(tool, (result[0][None], zero, zero))
    return rssr.judge_row(tool.problem, read, 0)


BY_HAND = "Pinocchio by hand"
CASES = (
    *(Case("sweep", BY_HAND, "tuned", partial(setup_tuned, Problem(steps=n)), run_tuned, judge,
           n, n) for n in (*rssr.SHORT, *rssr.STEPS)),
    *(Case("sweep", BY_HAND, "plain", partial(setup_plain, Problem(steps=n)), run_plain, judge,
           n, n) for n in rssr.STEPS),
    Case("rates", BY_HAND, "rows, two solves", at_one_angle, run_rates, judge_rates),
    Case("jacobian", BY_HAND, "rows, one solve", at_one_angle, run_jacobian, judge_jacobian),
    Case("assembly", BY_HAND, "Newton from the guess", partial(setup_plain, Problem()),
         lambda tool: close(tool, tool.q0), judge_assembly),
)
ABSENT = (
    Absent("mobility", BY_HAND, "a rank of the closure Jacobian gives the instantaneous count "
           "alone; Pinocchio has no analysis of it"),
)
