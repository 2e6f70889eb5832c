"""MuJoCo's constrained dynamics: `connect` at its stiffest, and Lagrange's equations on its terms.

Closures are soft in MuJoCo by design. Its documentation's way to stiffen them is used: impedance at
its highest (0.9999), time constant of two steps, the Newton solver to 1e-12. The exact rows solve
[M J'; J 0] by LAPACK from mj_fullM, mj_jac and mj_jacDot, with Baumgarte's terms.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import mujoco
import numpy as np

from benchmark import cube, ladder
from benchmark.case import Case
from benchmark.rk4 import BY_HAND_STEPS, DAMPING, STIFFNESS, rk4
from benchmark.rssr import Array

NAME = "MuJoCo"
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


def setup_ladder(n: int, turn: float, rate: float, h: float) -> SimpleNamespace:
    """Rods along their x, upright at qpos 0; couplers level; hinges about z."""
    inertial = (f'<inertial pos="0.5 0 0" mass="1" diaginertia="1e-12 {ladder.ROD!r} '
                f'{ladder.ROD!r}"/><joint type="hinge" axis="0 0 1"/>')
    right = repr(np.pi / 2)
    bodies = ""
    for i in range(n + 1):
        bodies += (f'<body pos="{i} 0 0" euler="0 0 {right}">{inertial}'
                   f'<site name="t{i}" pos="1 0 0"/>')
        if i < n:
            bodies += (f'<body pos="1 0 0" euler="0 0 -{right}">{inertial}'
                       f'<site name="e{i}" pos="1 0 0"/></body>')
        bodies += "</body>"
    closures = "".join(f'<connect site1="e{i}" site2="t{i + 1}" {STIFFEST.format(2 * h)}/>'
                       for i in range(n))
    tool = load(h, ladder.G, bodies, closures)
    model = tool.model
    rods = np.array([model.body_parentid[model.jnt_bodyid[j]] == 0 for j in range(model.njnt)])
    tool.q, tool.v = np.where(rods, -turn, turn), np.where(rods, -rate, rate)
    tool.pairs = [(model.site(f"e{i}").id, model.site(f"t{i + 1}").id) for i in range(n)]
    tool.loops = n
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


def restart(tool: SimpleNamespace) -> None:
    mujoco.mj_resetData(tool.model, tool.data)
    tool.data.qpos, tool.data.qvel = tool.q, tool.v


# Forward dynamics


def run_forward(tool: SimpleNamespace) -> float:
    restart(tool)
    mujoco.mj_forward(tool.model, tool.data)
    return float(-tool.data.qacc[0])


def acceleration(tool: SimpleNamespace, q: Array, v: Array) -> Array:
    """Return Lagrange's; the hinges are parallel to z, so each loop has two equations."""
    model, data, nv = tool.model, tool.data, tool.model.nv
    data.qpos, data.qvel = q, v
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    m = 2 * len(tool.pairs)
    matrix, rhs = np.zeros((nv + m, nv + m)), np.zeros(nv + m)
    mass, one, other = np.empty((nv, nv)), np.zeros((3, nv)), np.zeros((3, nv))
    mujoco.mj_fullM(model, data, mass)
    matrix[:nv, :nv], rhs[:nv] = mass, -data.qfrc_bias
    for i, (first, second) in enumerate(tool.pairs):
        rows = slice(nv + 2 * i, nv + 2 * i + 2)
        for jacobian, site in ((one, first), (other, second)):
            mujoco.mj_jacSite(model, data, jacobian, None, site)
        matrix[rows, :nv] = jacobian = (one - other)[:2]
        for rate, site in ((one, first), (other, second)):
            point, body = data.site_xpos[site], model.site_bodyid[site]
            mujoco.mj_jacDot(model, data, rate, None, point, body)
        gap = (data.site_xpos[first] - data.site_xpos[second])[:2]
        rhs[rows] = -((one - other) @ v)[:2] - DAMPING * (jacobian @ v) - STIFFNESS * gap
    matrix[:nv, nv:] = matrix[nv:, :nv].T
    return np.linalg.solve(matrix, rhs)[:nv]


def run_exact(tool: SimpleNamespace) -> float:
    return float(-acceleration(tool, tool.q, tool.v)[0])


def judge_forward(tool: SimpleNamespace, found: float) -> dict[str, float | None]:
    return ladder.judge_acceleration(tool.loops, found)


# Simulation


def run_simulation(tool: SimpleNamespace, duration: float) -> Array:
    """All steps in one call."""
    restart(tool)
    mujoco.mj_step(tool.model, tool.data, round(duration / tool.step))
    return tool.data.qpos.copy()


def run_by_hand(tool: SimpleNamespace) -> Array:
    """RK4 in Python on Lagrange's accelerations."""
    q, _ = rk4(partial(acceleration, tool), tool.q, tool.v, tool.step, ladder.DURATION)
    tool.data.qpos = q
    return q


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
    *(Case("forward", NAME, "mj_forward, `connect` at its stiffest",
           partial(setup_ladder, n, ladder.ANGLE, ladder.RATE, 1e-3), run_forward, judge_forward,
           size=n) for n in ladder.SIZES),
    *(Case("forward", NAME, "its terms, Lagrange's equations by LAPACK",
           partial(setup_ladder, n, ladder.ANGLE, ladder.RATE, 1e-3), run_exact, judge_forward,
           size=n) for n in ladder.SIZES),
    *(Case("a02", NAME, f"`connect` at its stiffest, RK4 at {h:g} s",
           partial(setup_ladder, 1, 0.0, ladder.START, h),
           partial(run_simulation, duration=ladder.DURATION), judge_a02, slow=h < 1e-3)
      for h in STEPS),
    *(Case("a02", NAME, f"its terms, Lagrange + Baumgarte by LAPACK, RK4 at {h:g} s",
           partial(setup_ladder, 1, 0.0, ladder.START, h), run_by_hand, judge_a02, slow=h < 2e-3)
      for h in BY_HAND_STEPS),
    *(Case("a04", NAME, f"`connect` at its stiffest, RK4 at {h:g} s", partial(setup_cube, h),
           partial(run_simulation, duration=cube.DURATION), judge_a04, slow=h < 1e-3)
      for h in STEPS),
)
