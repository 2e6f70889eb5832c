"""MuJoCo's constrained dynamics: `connect` at its stiffest.

Closures are soft in MuJoCo by design. Its documentation's way to stiffen them is used: impedance at
its highest (0.9999), time constant of two steps, the Newton solver to 1e-12.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import mujoco
import numpy as np

from benchmark import cube, ladder
from benchmark.case import Case
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
CASES = tuple(
    Case(task, NAME, f"`connect` at its stiffest, RK4 at {h:g} s", partial(setup, h),
         partial(run, duration=duration), judge, slow=h < 1e-3)
    for task, setup, duration, judge in (("a02", setup_ladder, ladder.DURATION, judge_a02),
                                         ("a04", setup_cube, cube.DURATION, judge_a04))
    for h in STEPS)
