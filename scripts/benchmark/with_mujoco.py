"""The RSSR on the Jacobians of MuJoCo, plain and tuned.

The engine is used as its documentation says: kinematics, Jacobian of a point, bias of its
acceleration; Newton and the linear algebra are ours, for MuJoCo's own closure (`connect`) is soft.
The coupler hangs on the rocker and the loop is cut at A. The plain loop takes the difference of two
Jacobians; the tuned one is tuned like the Pinocchio loop: A moves along the known path of the
crank, views kept, a predictor, LAPACK called directly, results written in place.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
from scipy.linalg.blas import daxpy, dcopy, dgemv
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

from benchmark import rssr
from benchmark.case import Absent, Case
from benchmark.rssr import MAX_CORRECTIONS, Array, Problem

FOUR_BAR = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="crank">
      <joint type="hinge" axis="0 1 0"/>
      <geom type="sphere" size="0.01"/>
      <site name="crank_a" pos="{} 0 0"/>
    </body>
    <body name="rocker" pos="{} 0 0">
      <joint type="hinge" axis="0 0 -1"/>
      <geom type="sphere" size="0.01"/>
      <body name="coupler" pos="{} 0 0">
        <joint type="ball"/>
        <geom type="sphere" size="0.01"/>
        <site name="coupler_a" pos="{} 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def setup_mujoco(problem: Problem) -> SimpleNamespace:
    lengths = -problem.a, -problem.d, -problem.c, -problem.b
    model = mujoco.MjModel.from_xml_string(FOUR_BAR.format(*lengths))
    tool = SimpleNamespace(model=model, data=mujoco.MjData(model), problem=problem)
    tool.tip, tool.pin = model.site("coupler_a").id, model.site("crank_a").id
    tool.body = model.body("coupler").id
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, problem.rocker_to_coupler().ravel())
    tool.q0 = np.concatenate([[0.0, problem.guess], quaternion])
    tool.jacobians = tuple(np.zeros((3, model.nv)) for _ in range(3))  # of tip, pin, spin
    return tool


def system(tool: SimpleNamespace) -> tuple[Array, Array]:
    """Return loop and spin at data.qpos: (4, nv) rows, and what is left of them."""
    model, data = tool.model, tool.data
    rows, rhs = np.empty((4, model.nv)), np.zeros(4)
    on_tip, on_pin, turn = tool.jacobians
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_jacSite(model, data, on_tip, turn, tool.tip)
    mujoco.mj_jacSite(model, data, on_pin, None, tool.pin)
    axis = data.xmat[tool.body].reshape(3, 3)[:, 0]
    rows[:3], rows[3] = on_tip - on_pin, axis @ turn
    rhs[:3] = data.site_xpos[tool.pin] - data.site_xpos[tool.tip]
    return rows, rhs


def close(tool: SimpleNamespace) -> Array:
    """Move data.qpos to the closed configuration by Newton, and return its rows."""
    model, data, step = tool.model, tool.data, np.zeros(tool.model.nv)
    for _ in range(MAX_CORRECTIONS):
        rows, rhs = system(tool)
        if np.linalg.norm(rhs) <= tool.problem.tolerance:
            return rows
        step[1:] = np.linalg.solve(rows[:, 1:], rhs)
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    raise RuntimeError("loop open")


def rates(tool: SimpleNamespace, rows: Array) -> tuple[Array, Array]:
    """Return velocities, put into data.qvel too, and accelerations."""
    model, data, speed = tool.model, tool.data, tool.problem.speed
    on_tip, on_pin, turn = tool.jacobians
    data.qvel[0] = speed
    data.qvel[1:] = np.linalg.solve(rows[:, 1:], -rows[:, 0] * speed)
    mujoco.mj_comVel(model, data)
    for linear, angular, site in ((on_tip, turn, tool.tip), (on_pin, None, tool.pin)):
        point, body = data.site_xpos[site], model.site_bodyid[site]
        mujoco.mj_jacDot(model, data, linear, angular, point, body)
    a, v = np.zeros(model.nv), data.qvel.copy()
    axis = data.xmat[tool.body].reshape(3, 3)[:, 0]
    bias = np.array([*((on_tip - on_pin) @ v), axis @ turn @ v])
    a[1:] = np.linalg.solve(rows[:, 1:], -bias)
    return v, a


def run_mujoco(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """Newton on the Jacobians of the two sites, from the last position moved on by its velocity."""
    model, data, problem, kept = tool.model, tool.data, tool.problem, []
    data.qpos, data.qvel = tool.q0, 0.0
    for phi in problem.phi:
        mujoco.mj_integratePos(model, data.qpos, data.qvel, problem.time_step)
        data.qpos[0] = phi
        rows = close(tool)
        v, a = rates(tool, rows)
        kept.append((data.qpos.copy(), v, a))
    positions, velocities, accelerations = (np.array(x) for x in zip(*kept, strict=True))
    return positions, velocities, accelerations


def run_mujoco_tuned(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """The tuned loop of `with_pinocchio.run_tuned` on MuJoCo's calls.

    `mj_jac` writes world axes into the buffer `full`: three rows of A's velocity, a free row that
    takes the spin, three rows of angular velocity.
    """
    model, data, problem = tool.model, tool.data, tool.problem
    mj_kinematics, mj_com_pos, mj_jac = mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_jac
    nv, body, h = model.nv, tool.body, problem.time_step
    steps, small = len(problem.phi), problem.tolerance**2
    positions, rates = np.empty((steps, model.nq)), np.zeros((steps, 2, nv))
    rates[:, 0, 0] = problem.speed
    history, unknown = rates.reshape(-1, nv).T, rates[:, :, 1:]
    predictor = np.array([1.5 * h, 7 / 12 * h * h, -0.5 * h, 17 / 12 * h * h])
    path = np.zeros((steps, 3, 4))
    path[:, :, :3] = problem.crank_path()
    full = np.zeros((7, nv))
    linear, angular, spin, system = full[:3], full[4:], full[3], full[:4, 1:]
    rows_t, angular_t = full[:4].T, full[4:].T
    q, qvel, p = data.qpos, data.qvel, data.site_xpos[tool.tip]
    axis, step, rhs = data.xmat[body].reshape(3, 3)[:, 0], np.zeros(nv), np.zeros(4)
    point, correction, bias = rhs[:3], step[1:], np.zeros(4)
    q[:] = tool.q0
    for i, phi in enumerate(problem.phi.tolist()):
        if i > 1:
            moved = dgemv(1.0, history[:, 2 * i - 4 : 2 * i], predictor)
            mujoco.mj_integratePos(model, q, moved, 1.0)
        elif i == 1:
            mujoco.mj_integratePos(model, q, rates[0, 0] + h / 2 * rates[0, 1], h)
        q[0] = phi
        target, velocity, acceleration = path[i]
        for _ in range(MAX_CORRECTIONS):
            mj_kinematics(model, data)
            mj_com_pos(model, data)
            mj_jac(model, data, linear, angular, p, body)
            dgemv(1.0, angular_t, axis, 0.0, spin, 0, 1, 0, 1, 0, 1)
            dcopy(target, rhs)
            daxpy(p, point, 3, -1.0)
            x, y, z, _ = rhs.tolist()
            if x * x + y * y + z * z <= small:
                break
            correction[:] = dgesv(system, rhs, 0, 1)[2]
            mujoco.mj_integratePos(model, q, step, 1.0)
        else:
            raise RuntimeError(f"loop open at {phi} rad")
        positions[i] = q
        lu, pivots, _ = dgetrf(system)
        solution = unknown[i, 0]
        dcopy(velocity, solution)
        dgetrs(lu, pivots, solution, 0, 1)
        qvel[:] = rates[i, 0]
        mujoco.mj_comVel(model, data)
        mujoco.mj_jacDot(model, data, linear, angular, p, body)
        dgemv(1.0, angular_t, axis, 0.0, spin, 0, 1, 0, 1, 0, 1)
        dgemv(1.0, rows_t, qvel, 0.0, bias, 0, 1, 0, 1, 1, 1)
        solution = unknown[i, 1]
        dcopy(acceleration, solution)
        daxpy(bias, solution, 4, -1.0)
        dgetrs(lu, pivots, solution, 0, 1)
    return positions, rates[:, 0], rates[:, 1]


def read_mujoco(tool: SimpleNamespace, result: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    model, data = tool.model, tool.data
    closure, omega, alpha = [], [], []
    turn, turn_rate = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for q, v, a in zip(*result, strict=True):
        data.qpos, data.qvel = q, v
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        p = data.site_xpos[tool.tip]
        mujoco.mj_jac(model, data, None, turn, p, tool.body)
        mujoco.mj_jacDot(model, data, None, turn_rate, p, tool.body)
        closure.append(np.linalg.norm(p - data.site_xpos[tool.pin]))
        omega.append(turn @ v)
        alpha.append(turn @ a + turn_rate @ v)
    q, v, a = result
    return np.array(closure), q[:, 1], v[:, 1], a[:, 1], np.array(omega), np.array(alpha)


# One state


def at_one_angle() -> SimpleNamespace:
    tool = setup_mujoco(Problem(steps=rssr.FEW))
    tool.closed = run_mujoco(tool)[0][1]
    return tool


def run_rates(tool: SimpleNamespace) -> tuple[Array, Array]:
    tool.data.qpos = tool.closed
    return rates(tool, system(tool)[0])


def run_jacobian(tool: SimpleNamespace) -> Array:
    tool.data.qpos = tool.closed
    rows = system(tool)[0]
    return tool.jacobians[2] @ np.concatenate([[1.0], np.linalg.solve(rows[:, 1:], -rows[:, 0])])


def run_assembly(tool: SimpleNamespace) -> Array:
    tool.data.qpos = tool.q0
    close(tool)
    return tool.data.qpos.copy()


def judge(tool: SimpleNamespace, result: Any) -> dict[str, float | None]:
    return rssr.judge(tool.problem, read_mujoco(tool, result))


def judge_rates(tool: SimpleNamespace, result: tuple[Array, Array]) -> dict[str, float | None]:
    q, v, a = (np.array([x]) for x in (tool.closed, *result))
    return rssr.judge_row(tool.problem, read_mujoco(tool, (q, v, a)), 1)


def judge_jacobian(tool: SimpleNamespace, result: Array) -> dict[str, float | None]:
    return {"ω": rssr.spin_error(tool.problem, result, 1)}


def judge_assembly(tool: SimpleNamespace, q: Array) -> dict[str, float | None]:
    zero = np.zeros((1, tool.model.nv))
    return rssr.judge_row(tool.problem, read_mujoco(tool, (q[None], zero, zero)), 0)


NAME = "MuJoCo"
CASES = (
    *(Case("sweep", NAME, f"Newton on mj_jac, {how}", partial(setup_mujoco, Problem(steps=n)), run,
           judge, n, n)
      for n in rssr.STEPS for how, run in (("tuned", run_mujoco_tuned), ("plain", run_mujoco))),
    Case("rates", NAME, "mj_jac, mj_jacDot, two solves", at_one_angle, run_rates, judge_rates),
    Case("jacobian", NAME, "mj_jac, one solve", at_one_angle, run_jacobian, judge_jacobian),
    Case("assembly", NAME, "Newton on mj_jac from the guess", partial(setup_mujoco, Problem()),
         run_assembly, judge_assembly),
)
ABSENT = (
    Absent("sweep", NAME, "its own closure, `connect`, is soft and gives no accelerations at given "
           "drivers; so Newton on its Jacobians"),
    Absent("mobility", NAME, "has no such analysis"),
)
