"""This library, through its public interface: kinematics."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import spatial_pin as sp
from benchmark import excavator, four_bar, rspc, rssr, stewart
from benchmark.case import Absent, Case
from benchmark.rssr import Array, Problem

NAME = "spatial_pin"


# The RSSR


def setup_sweep(steps: int, accuracy: sp.Accuracy | None = None) -> SimpleNamespace:
    return SimpleNamespace(mechanism=sp.load("rssr"), problem=Problem(steps=steps),
                           accuracy=accuracy)


def run_sweep(tool: SimpleNamespace) -> sp.Motion:
    motion = sp.sweep(tool.mechanism, "crank", tool.problem.phi, speed=tool.problem.speed,
                      accuracy=tool.accuracy)
    motion.coordinate("rocker_pin")
    return motion


def run_sweep_bodies(tool: SimpleNamespace) -> sp.Motion:
    motion = run_sweep(tool)
    motion.frame("coupler")
    for link in ("crank", "coupler", "rocker"):
        motion.com(link)
    return motion


def judge_sweep(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    gap = motion.frame("coupler_b").position - motion.frame("rocker_b").position
    coupler = motion.frame("coupler")
    return rssr.judge(tool.problem, (
        np.linalg.norm(gap, axis=1), *motion.coordinate("rocker_pin"), coupler.angular_velocity,
        coupler.angular_acceleration))


def setup_reduced(steps: int) -> SimpleNamespace:
    reduced = sp.reduce(sp.load("rssr"), ["rocker_pin"])  # type: ignore[attr-defined]
    return SimpleNamespace(mechanism=reduced, problem=Problem(steps=steps), accuracy=None)


def judge_reduced(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    found = rssr.judge(tool.problem, (None, *motion.coordinate("rocker_pin"), None, None))
    return {name: found[name] for name in ("ψ", "ψ'", "ψ''")}


# One state


def one_state() -> SimpleNamespace:
    problem, mechanism = Problem(steps=rssr.FEW), sp.load("rssr")
    state = sp.sweep(mechanism, "crank", problem.phi[:2]).state(1)
    return SimpleNamespace(mechanism=mechanism, state=state, problem=problem)


def run_rates(tool: SimpleNamespace) -> sp.State:
    return sp.solve_rates(tool.mechanism, tool.state, {"crank": tool.problem.speed})


def judge_rates(tool: SimpleNamespace, state: sp.State) -> dict[str, float | None]:
    at = tool.mechanism.coordinate("rocker_pin").v
    omega = state.velocity("coupler").angular
    alpha = state.acceleration("coupler").angular
    fields = (None, None, state.v[at:at + 1], state.a[at:at + 1], omega[None], alpha[None])
    return rssr.judge_row(tool.problem, fields, 1)


def run_jacobian(tool: SimpleNamespace) -> Array:
    return sp.jacobian(tool.mechanism, tool.state, "coupler")


def judge_jacobian(tool: SimpleNamespace, columns: Array) -> dict[str, float | None]:
    return {"ω": rssr.spin_error(tool.problem, columns[3:, 0], 1)}


def run_assembly(tool: SimpleNamespace) -> sp.State:
    return sp.assemble(tool.mechanism, {"crank": 0.0})


def run_assembly_elsewhere(tool: SimpleNamespace) -> sp.State:
    return sp.assemble(tool.mechanism, {"crank": tool.problem.phi[1]})


def setup_assembly_from_state() -> SimpleNamespace:
    tool = one_state()
    tool.near = sp.assemble(tool.mechanism, {"crank": tool.problem.phi[1]})
    return tool


def run_assembly_from_state(tool: SimpleNamespace) -> sp.State:
    return sp.assemble(tool.mechanism, {"crank": tool.problem.phi[1]}, tool.near)


def judge_assembly(
    tool: SimpleNamespace, state: sp.State, row: int = 0
) -> dict[str, float | None]:
    gap = state.placement("coupler_b").translation - state.placement("rocker_b").translation
    at = tool.mechanism.coordinate("rocker_pin").q
    fields = (np.array([np.linalg.norm(gap)]), state.q[at:at + 1], None, None, None, None)
    return rssr.judge_row(tool.problem, fields, row)


def closed_bricard() -> SimpleNamespace:
    mechanism = sp.load("bricard")
    return SimpleNamespace(mechanism=mechanism, state=sp.assemble(mechanism))


def run_mobility(tool: SimpleNamespace) -> int:
    return sp.mobility(tool.mechanism, tool.state).dof


# Other mechanisms


def setup_other(name: str, driver: str, values: Array, speed: float) -> SimpleNamespace:
    return SimpleNamespace(mechanism=sp.load(name), driver=driver, values=values, speed=speed)


def run_other(tool: SimpleNamespace) -> sp.Motion:
    return sp.sweep(tool.mechanism, tool.driver, tool.values, speed=tool.speed)


def judge_rspc(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    gap = motion.frame("crank_b").position - motion.frame("rod_b").position
    found = [motion.coordinate(name) for name in rspc.COORDINATES]
    errors = rspc.judge(tool.values, tool.speed, np.array([tuple(c) for c in found]))
    return {"closure": float(np.linalg.norm(gap, axis=1).max()), **errors}


def judge_four_bar(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    found = np.array(tuple(motion.coordinate("rocker_pin")))
    return four_bar.judge(tool.values, tool.speed, found)


def judge_stewart(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    gaps = [motion.frame(f"piston_{k}").position - motion.frame(f"platform_{k}").position
            for k in range(1, 7)]
    centre = np.array([tuple(motion.coordinate(f"pose.{axis}")) for axis in "xyz"])
    centre[2, 0] += stewart.HEIGHT  # the coordinates count from home
    errors = stewart.judge(tool.values, tool.speed, centre)
    return {"closure": float(np.linalg.norm(gaps, axis=-1).max()), **errors}


# Several drivers


def setup_excavator(samples: int) -> SimpleNamespace:
    times = np.linspace(excavator.SECONDS[0], excavator.SECONDS[-1], samples)
    tables = {name: CubicSpline(excavator.SECONDS, x, bc_type="clamped")(times)
              for name, x in excavator.DIG.items()}
    return SimpleNamespace(mechanism=sp.load("excavator"), times=times, tables=tables)


def run_excavator(tool: SimpleNamespace) -> sp.Motion:
    return sp.follow(tool.mechanism, tool.tables, tool.times)


def judge_excavator(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    angles = np.array([motion.coordinate(name).value for name in excavator.ANGLES])
    errors = excavator.judge(angles, np.array(list(tool.tables.values())))
    return {"closure": float(motion.closure_error.max()), **errors}


# A fresh process


def fresh(statement: str) -> None:
    subprocess.run([sys.executable, "-c", statement], check=True)


def nothing(*_: Any) -> dict[str, float | None]:
    return {}


CASES = (
    *(Case("sweep", NAME, "sweep", partial(setup_sweep, n), run_sweep, judge_sweep, n, n)
      for n in (*rssr.SHORT, *rssr.STEPS)),
    *(Case("sweep", NAME, f"sweep, for_error({error:g})",
           partial(setup_sweep, n, sp.Accuracy.for_error(error)), run_sweep, judge_sweep, n, n)
      for n in rssr.STEPS for error in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)),
    *(Case("sweep", NAME, "sweep + states of all bodies", partial(setup_sweep, n),
           run_sweep_bodies, judge_sweep, n, n) for n in rssr.STEPS),
    *(Case("rspc", NAME, "sweep", partial(setup_other, "rspc", "crank", rspc.angles(n), rspc.SPEED),
           run_other, judge_rspc, n, n) for n in rssr.STEPS),
    *(Case("stewart", NAME, "sweep",
           partial(setup_other, "stewart", "leg_1", stewart.lengths(n), stewart.SPEED),
           run_other, judge_stewart, n, n) for n in rssr.STEPS),
    *(Case("four_bar", NAME, "sweep",
           partial(setup_other, "four_bar", "crank", four_bar.angles(n), four_bar.SPEED),
           run_other, judge_four_bar, n, n) for n in four_bar.STEPS),
    Case("excavator", NAME, "follow", partial(setup_excavator, 1000), run_excavator,
         judge_excavator, 1000, 1000),
    Case("rates", NAME, "solve_rates", one_state, run_rates, judge_rates),
    Case("jacobian", NAME, "jacobian", one_state, run_jacobian, judge_jacobian),
    Case("mobility", NAME, "mobility: ranks, finite freedom, loops' orders, rows to spare",
         closed_bricard, run_mobility, lambda _, n: {"count": abs(n - 1)}),
    Case("assembly", NAME, "assemble", partial(setup_sweep, 1), run_assembly, judge_assembly),
    Case("assembly", NAME, "assemble, 40° from the guess of the file", one_state,
         run_assembly_elsewhere, partial(judge_assembly, row=1)),
    Case("assembly", NAME, "assemble, from a State there", setup_assembly_from_state,
         run_assembly_from_state, partial(judge_assembly, row=1)),
    Case("start", NAME, "import spatial_pin, load('rssr')",
         lambda: "import spatial_pin; spatial_pin.load('rssr')", fresh, nothing),
    Case("start", "Pinocchio by hand", "import pinocchio", lambda: "import pinocchio", fresh,
         nothing),
)
ABSENT: tuple[Absent, ...] = ()
if hasattr(sp, "reduce"):
    CASES += tuple(Case("reduced", NAME, "sweep of reduce(mechanism, outputs)",
                        partial(setup_reduced, n), run_sweep, judge_reduced, n, n)
                   for n in rssr.STEPS)
else:
    ABSENT += (Absent("reduced", NAME, "this version has no `reduce`"),)
