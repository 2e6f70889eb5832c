"""This library, through its public interface: dynamics."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import published_models as models
from published_cases import CASES as PUBLISHED
from recursion import accelerations

import spatial_pin as sp
from benchmark import cube, falling, ladder
from benchmark.case import MECHANISMS, Case
from benchmark.rssr import Array

NAME = "spatial_pin"
SIZES = (1, 20, 50, 200, 500)  # the peers have those of `ladder`
HINGES = (10, 100, 300, 1000, 2000)  # of open chains


# Forward dynamics


def setup_forward(n: int) -> SimpleNamespace:
    """Every rod turned by the same angle; the mechanism's Data would not fit for 500 loops."""
    mechanism = models.ladder(n)
    q, v = np.zeros(mechanism.model.nq), np.zeros(mechanism.model.nv)
    for name in mechanism.coordinates:
        coordinate = mechanism.coordinate(name)
        sign = -1.0 if name.startswith("pin_") else 1.0
        q[coordinate.q], v[coordinate.v] = sign * ladder.ANGLE, sign * ladder.RATE
    state = sp.State(mechanism, q, v, closure_error=0.0)
    return SimpleNamespace(mechanism=mechanism, state=state, loops=n)


def run_forward(tool: SimpleNamespace) -> float:
    answer = sp.forward_dynamics(tool.mechanism, tool.state)
    return float(-answer.a[tool.mechanism.coordinate("pin_0").v])


def judge_forward(tool: SimpleNamespace, result: float) -> dict[str, float | None]:
    return ladder.judge_acceleration(tool.loops, result)


# Inverse dynamics and derivatives

SPEED = 0.7  # of every driver [rad/s, m/s]
SOLVES, UNKNOWNS = 9, 5  # systems that NumPy solves in the time that inverse dynamics may take


def setup_moving(name: str) -> SimpleNamespace:
    mechanism = sp.load(name)
    speeds = dict.fromkeys(mechanism.drivers, SPEED)
    return SimpleNamespace(mechanism=mechanism, state=sp.solve_rates(
        mechanism, sp.assemble(mechanism, {}), speeds))


def run_inverse(tool: SimpleNamespace) -> dict[str, float]:
    return sp.inverse_dynamics(tool.mechanism, tool.state).efforts


def judge_inverse(tool: SimpleNamespace, efforts: dict[str, float]) -> dict[str, float | None]:
    a, wanted = sp.forward_dynamics(tool.mechanism, tool.state, efforts).a, tool.state.a
    return {"acceleration": float(np.abs(a - wanted).max() / np.abs(wanted).max())}


def setup_solves() -> tuple[Array, Array]:
    return np.random.default_rng(0).standard_normal((UNKNOWNS, UNKNOWNS)), np.ones(UNKNOWNS)


def run_solves(system: tuple[Array, Array]) -> None:
    for _ in range(SOLVES):
        np.linalg.solve(*system)


def run_derivatives(tool: SimpleNamespace) -> Array:
    return sp.dynamics_derivatives(tool.mechanism, tool.state).a_by_effort


def judge_derivatives(_: SimpleNamespace, by_effort: Array) -> dict[str, float | None]:
    return {"symmetry": float(np.abs(by_effort - by_effort.T).max() / np.abs(by_effort).max())}


# Open chains


def setup_chain(n: int) -> SimpleNamespace:
    """Return hinges about y and x in turn, 0.1 m apart, anyhow placed and moving."""
    rng, model = np.random.default_rng(0), pin.Model()
    body = pin.Inertia(1.0, np.array([0.05, 0.01, -0.02]), np.diag([1e-3, 2e-3, 2.5e-3]))
    for k in range(n):
        turned = pin.rpy.rpyToMatrix(*rng.uniform(-0.4, 0.4, 3))
        hinge = (pin.JointModelRY(), pin.JointModelRX())[k % 2]
        joint = model.addJoint(k, hinge, pin.SE3(turned, np.array([0.1, 0.0, 0.0])), f"j{k}")
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    mechanism = sp.Mechanism.from_model(model)
    q, v, a = rng.uniform(-0.5, 0.5, n), *rng.uniform(-1.0, 1.0, (2, n))
    return SimpleNamespace(mechanism=mechanism,
                           state=sp.State(mechanism, q, v, a, closure_error=0.0))


def run_chain(tool: SimpleNamespace) -> Array:
    return sp.forward_dynamics(tool.mechanism, tool.state).a


def run_chain_inverse(tool: SimpleNamespace) -> None:
    sp.inverse_dynamics(tool.mechanism, tool.state)


def judge_chain(tool: SimpleNamespace, result: Array | None) -> dict[str, float | None]:
    if result is None:
        return {"acceleration": None}
    q, v = tool.state.q, tool.state.v
    exact = accelerations(tool.mechanism.model, q, v, np.zeros(len(q)))
    return {"acceleration": float(np.abs(result - exact).max() / np.abs(exact).max())}


# Simulation


def setup_simulation(name: str, accuracy: sp.Accuracy) -> SimpleNamespace:
    case = PUBLISHED[name]
    mechanism = case.build()
    return SimpleNamespace(mechanism=mechanism, state=case.begin(mechanism), accuracy=accuracy,
                           duration=case.duration)


def run_simulation(tool: SimpleNamespace) -> sp.Simulation:
    return sp.simulate(tool.mechanism, tool.state, tool.duration, accuracy=tool.accuracy)


def judge_a02(_: SimpleNamespace, motion: sp.Simulation) -> dict[str, float | None]:
    angle = -motion.coordinate("pin_0").value[-1]
    gap = motion.frame("end_0").position - motion.frame("top_1").position
    closure = np.linalg.norm(gap, axis=1)
    return ladder.judge_end(float(angle), float(closure.max()))


def judge_a04(_: SimpleNamespace, motion: sp.Simulation) -> dict[str, float | None]:
    closure = np.linalg.norm(motion.frame("last").position - cube.POST, axis=1)
    return cube.judge(motion.frame("p3").position[-1], float(closure.max()))


def setup_falling(make: Callable[[], sp.State], accuracy: sp.Accuracy) -> SimpleNamespace:
    state = make()
    return SimpleNamespace(mechanism=state.mechanism, state=state, accuracy=accuracy,
                           duration=falling.DURATION)


def judge_falling(tool: SimpleNamespace, motion: sp.Simulation) -> dict[str, float | None]:
    gaps = [motion.frame(one).position - motion.frame(other).position
            for one, other in (closure.frames for closure in tool.mechanism.closures)]
    closure = np.linalg.norm(gaps, axis=-1)
    gained = float(motion.energy[-1] - motion.energy[0])
    return falling.judge(tool.mechanism, gained, float(closure.max()))


def setup_platform(accuracy: sp.Accuracy) -> SimpleNamespace:
    """Let the Gough platform fall, each of its legs with a speed of its own."""
    mechanism = sp.load("stewart")
    speeds = {f"leg_{k}": 0.02 * k - 0.05 for k in range(1, 7)}
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), speeds)
    return SimpleNamespace(mechanism=mechanism, state=state, accuracy=accuracy, duration=0.15)


def judge_platform(tool: SimpleNamespace, motion: sp.Simulation) -> dict[str, float | None]:
    """Compare the centre at the end with a simulation of reference accuracy."""
    exact = sp.simulate(tool.mechanism, tool.state, tool.duration, times=[tool.duration],
                        accuracy=sp.Accuracy.named("reference"))
    off = motion.frame("platform").position[-1] - exact.frame("platform").position[-1]
    return {"position": float(np.abs(off).max()), "closure": float(motion.closure_error.max())}


SETTINGS = {
    "draft": sp.Accuracy.named("draft"),
    "engineering": sp.Accuracy.named("engineering"),
    "reference": sp.Accuracy.named("reference"),
    "DOP853 at 1e-9": sp.Accuracy(time_tolerance=1e-9),
    **{f"for_error({error})": sp.Accuracy.for_error(float(error), "simulate")
       for error in ("1e-2", "1e-4", "1e-6", "1e-8")},
    "RK4, 10 ms": sp.Accuracy(integrator="RK4", step=0.01),
}
FEW = "engineering", "for_error(1e-4)"

CASES = (
    *(Case("forward", NAME, "forward_dynamics, reactions too", partial(setup_forward, n),
           run_forward, judge_forward, size=n) for n in SIZES),
    Case("inverse", NAME, "inverse_dynamics", partial(setup_moving, "delta"), run_inverse,
         judge_inverse),
    Case("inverse", "NumPy", f"{SOLVES} solves of a {UNKNOWNS} x {UNKNOWNS}", setup_solves,
         run_solves, lambda *_: {"acceleration": None}),
    *(Case(f"derivatives-{name}", NAME, "dynamics_derivatives", partial(setup_moving, name),
           run_derivatives, judge_derivatives) for name in MECHANISMS),
    *(Case("chain", NAME, how, partial(setup_chain, n), run, judge_chain, size=n, slow=n > 300)
      for how, run in (("forward_dynamics", run_chain), ("inverse_dynamics", run_chain_inverse))
      for n in HINGES),
    *(Case(task, NAME, f"simulate, {name}", partial(setup_simulation, entry, accuracy),
           run_simulation, judge)
      for task, entry, judge in (("a02", "ladder_1", judge_a02), ("a04", "bricard", judge_a04))
      for name, accuracy in SETTINGS.items()),
    Case("platform", NAME, "simulate, engineering",
         partial(setup_platform, SETTINGS["engineering"]), run_simulation, judge_platform),
    *(Case(task, NAME, f"simulate, {name}", partial(setup_falling, make, SETTINGS[name]),
           run_simulation, judge_falling)
      for task, make in falling.ROBOTS.items() for name in FEW),
)
