"""Pinocchio's constrained dynamics by hand: one evaluation, and Runge-Kutta of fourth order.

Its models and states are those of this library's mechanisms; closures are pairs of points that
Baumgarte's terms keep together: one for a hinge of a plane mechanism, two on the axis of another.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from types import SimpleNamespace

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from benchmark import cube, falling, ladder, with_spatial_pin_forces as ours
from benchmark.case import MECHANISMS, Case
from benchmark.rssr import Array

NAME = "Pinocchio by hand"
STIFFNESS, DAMPING = 100.0, 20.0  # of Baumgarte's terms, critically damped [1/s², 1/s]
STEPS = (5e-3, 2e-3, 1e-3)  # [s]
ON_THE_AXIS = (-0.5, 0.5)  # two points that make a hinge [m]


def setup(state: sp.State, points: Sequence[float] = (0.0,)) -> SimpleNamespace:
    """Return all that `constraintDynamics` takes, in the containers that cost least."""
    mechanism, model = state.mechanism, state.mechanism.model
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for closure in mechanism.closures:
        sides = [mechanism.frame_on_joint(frame) for frame in closure.frames]
        axes = closure.geometry.axes1[:, 2], closure.geometry.axes2[:, 2]
        for along in points:
            ends = [x for (joint, placed), axis in zip(sides, axes, strict=True)
                    for x in (joint, placed * pin.SE3(np.eye(3), along * axis))]
            made = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *ends,
                                            pin.ReferenceFrame.LOCAL)
            made.m_baumgarte_parameters.Kp = STIFFNESS
            made.m_baumgarte_parameters.Kd = DAMPING
            models.append(made)
            datas.append(made.createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    return SimpleNamespace(mechanism=mechanism, state=state, model=model, data=data,
                           models=models, datas=datas, none=np.zeros(model.nv), q=state.q,
                           v=state.v,
                           settings=pin.ProximalSettings(1e-12, 1e-10, 20))


def acceleration(tool: SimpleNamespace, q: Array, v: Array) -> Array:
    """Return a copy of the constrained acceleration."""
    return pin.constraintDynamics(tool.model, tool.data, q, v, tool.none, tool.models, tool.datas,
                                  tool.settings).copy()


def opening(tool: SimpleNamespace, q: Array) -> float:
    """Return the largest closure error [m]."""
    pin.forwardKinematics(tool.model, tool.data, q)
    gaps = [tool.data.oMi[c.joint1_id].act(c.joint1_placement.translation)
            - tool.data.oMi[c.joint2_id].act(c.joint2_placement.translation) for c in tool.models]
    return max(float(np.linalg.norm(gap)) for gap in gaps)


def setup_forward(n: int) -> SimpleNamespace:
    tool = setup(ours.setup_forward(n).state)
    tool.loops, tool.first = n, tool.mechanism.coordinate("pin_0").v
    return tool


def run_forward(tool: SimpleNamespace) -> float:
    return float(-acceleration(tool, tool.q, tool.v)[tool.first])


def setup_derivatives(name: str) -> SimpleNamespace:
    return setup(ours.setup_moving(name).state)


def run_derivatives(tool: SimpleNamespace) -> Array:
    """Return those by efforts of accelerations and their derivatives."""
    acceleration(tool, tool.q, tool.v)
    return pin.computeConstraintDynamicsDerivatives(
        tool.model, tool.data, tool.models, tool.datas, tool.settings)[2].copy()


def setup_chain(n: int) -> SimpleNamespace:
    return setup(ours.setup_chain(n).state)


def run_aba(tool: SimpleNamespace) -> Array:
    return pin.aba(tool.model, tool.data, tool.state.q, tool.state.v, tool.none).copy()


def run_rnea(tool: SimpleNamespace) -> None:
    pin.rnea(tool.model, tool.data, tool.state.q, tool.state.v, tool.state.a)


# Simulation


def setup_simulation(name: str, points: Sequence[float]) -> SimpleNamespace:
    return setup(ours.setup_simulation(name, sp.Accuracy()).state, points)


def rk4(tool: SimpleNamespace, step: float, duration: float) -> tuple[Array, Array]:
    """Return coordinates and velocities at the end; all joints are hinges, q' = v."""
    h, q, v, rates = step, tool.q, tool.v, partial(acceleration, tool)
    for _ in range(round(duration / h)):
        k1 = rates(q, v)
        k2 = rates(q + 0.5 * h * v, v + 0.5 * h * k1)
        k3 = rates(q + 0.5 * h * v + 0.25 * h * h * k1, v + 0.5 * h * k2)
        k4 = rates(q + h * v + 0.5 * h * h * k2, v + h * k3)
        q = q + h * v + h * h / 6.0 * (k1 + k2 + k3)
        v = v + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return q, v


def judge_a02(tool: SimpleNamespace, end: tuple[Array, Array]) -> dict[str, float | None]:
    angle = -end[0][tool.mechanism.coordinate("pin_0").q]
    return ladder.judge_end(float(angle), opening(tool, end[0]))


def judge_a04(tool: SimpleNamespace, end: tuple[Array, Array]) -> dict[str, float | None]:
    closure = opening(tool, end[0])
    joint, placed = tool.mechanism.frame_on_joint("p3")
    return cube.judge(tool.data.oMi[joint].act(placed.translation), closure)


def judge_falling(tool: SimpleNamespace, end: tuple[Array, Array]) -> dict[str, float | None]:
    before, after = (pin.computeMechanicalEnergy(tool.model, tool.data, q, v)
                     for q, v in ((tool.q, tool.v), end))
    return falling.judge(tool.mechanism, after - before, opening(tool, end[0]))


SIMULATED = {
    "a02": (partial(setup_simulation, "ladder_1", (0.0,)), ladder.DURATION, judge_a02),
    "a04": (partial(setup_simulation, "bricard", ON_THE_AXIS), cube.DURATION, judge_a04),
    **{task: (lambda make=make: setup(make()), falling.DURATION, judge_falling)
       for task, make in falling.ROBOTS.items()},
}
CASES = (
    *(Case("forward", NAME, "constraintDynamics", partial(setup_forward, n), run_forward,
           ours.judge_forward, size=n) for n in ladder.SIZES),
    *(Case(f"derivatives-{name}", NAME, "computeConstraintDynamicsDerivatives",
           partial(setup_derivatives, name), run_derivatives, ours.judge_derivatives)
      for name in MECHANISMS),
    *(Case("chain", NAME, how, partial(setup_chain, n), run, ours.judge_chain, size=n)
      for how, run in (("aba", run_aba), ("rnea", run_rnea)) for n in ours.HINGES if n <= 300),
    *(Case(task, NAME, f"constraintDynamics + Baumgarte, RK4 at {h:g} s", build,
           partial(rk4, step=h, duration=duration), judge)
      for task, (build, duration, judge) in SIMULATED.items() for h in STEPS),
)
