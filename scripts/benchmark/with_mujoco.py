"""MuJoCo: the RSSR on its Jacobians, tuned, and its constrained dynamics.

For the RSSR the engine is used as its documentation says: kinematics, Jacobian of a point, bias of
its acceleration; Newton and the linear algebra are ours, for MuJoCo's own closure is soft. The
coupler hangs on the rocker and the loop is cut at A. The loop is tuned like that of Pinocchio: A
moves along the known path of the crank, views kept, a predictor, LAPACK called directly, results
written in place.

Under forces it closes loops by `connect`, which is soft by design. Its documentation's way to
stiffen it is used: impedance at its highest (0.9999), time constant of two steps, the Newton solver
to 1e-12.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
from scipy.linalg.blas import daxpy, dcopy, dgemv
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

from benchmark import cube, ladder, rssr
from benchmark.case import Absent, Case
from benchmark.rssr import MAX_CORRECTIONS, Array, Problem

NAME = "MuJoCo"
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
    return tool


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


def judge_sweep(tool: SimpleNamespace, result: Any) -> dict[str, float | None]:
    return rssr.judge(tool.problem, read_mujoco(tool, result))


# ---------------------------------------------------------------- forces


STIFFEST = 'solimp="0.9999 0.9999 0.001 0.5 2" solref="{} 1"'
FRAME = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{h!r}" gravity="0 {g!r} 0" integrator="RK4" solver="Newton" iterations="50"
          tolerance="1e-12"><flag contact="disable"/></option>
  <worldbody>{bodies}</worldbody>
  <equality>{closures}</equality>
</mujoco>
"""


def words(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def load(h: float, g: float, bodies: str, closures: str) -> SimpleNamespace:
    text = FRAME.format(h=h, g=-g, bodies=bodies, closures=closures)
    model = mujoco.MjModel.from_xml_string(text)
    return SimpleNamespace(model=model, data=mujoco.MjData(model), step=h)


def setup_ladder(h: float) -> SimpleNamespace:
    """Two rods along their x, upright at qpos 0, and a level coupler; hinges about z."""
    inertial = (f'<inertial pos="0.5 0 0" mass="1" diaginertia="1e-12 {ladder.ROD!r} '
                f'{ladder.ROD!r}"/><joint type="hinge" axis="0 0 1"/>')
    right = repr(np.pi / 2)
    bodies = (f'<body euler="0 0 {right}">{inertial}<body pos="1 0 0" euler="0 0 -{right}">'
              f'{inertial}<site name="end" pos="1 0 0"/></body></body>'
              f'<body pos="1 0 0" euler="0 0 {right}">{inertial}<site name="top" pos="1 0 0"/>'
              "</body>")
    tool = load(h, ladder.G, bodies, f'<connect site1="end" site2="top" {STIFFEST.format(2 * h)}/>')
    tool.q, tool.v = np.zeros(3), ladder.START * np.array([-1.0, 1.0, -1.0])
    tool.pairs = [(tool.model.site("end").id, tool.model.site("top").id)]
    return tool


def setup_cube(h: float) -> SimpleNamespace:
    """Close the last hinge by two points on its axis."""
    bodies, ends = "", ""
    at, axis = cube.CORNERS[0], 0.5 * cube.unit(cube.AXES[-1])
    for i, (hinge, edge) in enumerate(zip(cube.AXES, cube.edges(), strict=False)):
        bodies += (
            f'<body pos="{words(at)}"><inertial pos="{words(edge / 2)}" mass="{cube.MASS}" '
            f'diaginertia="{words(cube.moments(edge))}"/>'
            f'<joint type="hinge" axis="{words(cube.unit(hinge))}"/>')
        if i == cube.P3_ROD:
            bodies += f'<site name="p3" pos="{words(edge)}"/>'
        at, ends = edge, ends + "</body>"
    for k, side in enumerate((-axis, axis)):
        bodies += f'<site name="last_{k}" pos="{words(at + side)}"/>'
        ends += f'<site name="post_{k}" pos="{words(cube.POST + side)}"/>'
    closures = "".join(f'<connect site1="last_{k}" site2="post_{k}" {STIFFEST.format(2 * h)}/>'
                       for k in range(2))
    tool = load(h, cube.G, bodies + ends, closures)
    tool.q, tool.v = np.zeros(tool.model.nq), np.zeros(tool.model.nv)
    tool.pairs = [(tool.model.site(f"last_{k}").id, tool.model.site(f"post_{k}").id)
                  for k in range(2)]
    return tool


def run(tool: SimpleNamespace, duration: float) -> Array:
    """All steps in one call."""
    mujoco.mj_resetData(tool.model, tool.data)
    tool.data.qpos, tool.data.qvel = tool.q, tool.v
    mujoco.mj_step(tool.model, tool.data, round(duration / tool.step))
    return tool.data.qpos.copy()


def opening(tool: SimpleNamespace) -> float:
    mujoco.mj_kinematics(tool.model, tool.data)
    at = tool.data.site_xpos
    return max(float(np.linalg.norm(at[i] - at[j])) for i, j in tool.pairs)


def judge_a02(tool: SimpleNamespace, q: Array) -> dict[str, float | None]:
    return ladder.judge_end(float(-q[0]), opening(tool))


def judge_a04(tool: SimpleNamespace, _: Array) -> dict[str, float | None]:
    closure = opening(tool)
    return cube.judge(tool.data.site_xpos[tool.model.site("p3").id], closure)


STEPS = (5e-3, 1e-3, 1e-4)
CASES = (
    *(Case("sweep", NAME, "Newton on mj_jac, tuned", partial(setup_mujoco, Problem(steps=n)),
           run_mujoco_tuned, judge_sweep, n, n) for n in rssr.STEPS),
    *(Case(task, NAME, f"`connect` at its stiffest, RK4 at {h:g} s", partial(setup, h),
           partial(run, duration=duration), judge, slow=h < 1e-3)
      for task, setup, duration, judge in (("a02", setup_ladder, ladder.DURATION, judge_a02),
                                           ("a04", setup_cube, cube.DURATION, judge_a04))
      for h in STEPS),
)
ABSENT = (
    Absent("sweep", NAME, "its own closure, `connect`, is soft and gives no accelerations at given "
           "drivers; so Newton on its Jacobians"),
)
