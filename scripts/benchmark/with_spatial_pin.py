"""This library, through its public interface: kinematics."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import spatial_pin as sp
from benchmark import excavator, four_bar, rssr, stewart
from benchmark.case import Case
from benchmark.rssr import Array, Problem
from spatial_pin.view.page.jog import Jog

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
    reduced = sp.reduce(sp.load("rssr"), ["rocker_pin"])
    return SimpleNamespace(mechanism=reduced, problem=Problem(steps=steps), accuracy=None)


def judge_reduced(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    errors = rssr.judge(tool.problem, (None, *motion.coordinate("rocker_pin"), None, None))
    return {name: errors[name] for name in ("ψ", "ψ'", "ψ''")}


# Full and reduced models


LEGS = {f"leg_{k}": f"slide_{k}" for k in range(2, 7)}
REDUCED = {  # title: mechanism, outputs, what is locked, driver, first and last value
    "RSSR: rocker": ("rssr", ["rocker_pin"], [], "crank", 0.0, 2 * np.pi),
    "RSPC: guide": ("rspc", ["guide.slide"], [], "crank", 0.0, 2 * np.pi),
    "RSPC: slide": ("rspc", ["slide"], [], "crank", 0.0, 2 * np.pi),
    "Gough platform, one leg moves": ("stewart", ["platform"], list(LEGS), "leg_1", 0.385, 0.41),
    "Gough platform, six legs": ("stewart", ["platform"], [], "leg_1", 0.385, 0.41),
    "Delta: platform": ("delta", ["platform"], [], "arm_1", -0.2, 0.2),
    "four-bar: rocker": ("four_bar", ["rocker_pin"], [], "crank", 0.0, 2 * np.pi),
    "Watt six-bar: first rocker": ("watt_six_bar", ["rocker_pin"], [], "crank", 0.0, 2 * np.pi),
    "Peaucellier: inner pin": ("peaucellier", ["upper_inner_pin"], [], "crank", -0.5, 0.5),
}


def setup_smaller(title: str, is_reduced: bool, values: int) -> SimpleNamespace:
    name, outputs, lock, driver, first, last = REDUCED[title]
    full = sp.load(name)
    reduced = sp.reduce(full, outputs, lock=lock)
    hold = {} if is_reduced else {LEGS[leg]: reduced.welds[LEGS[leg]] for leg in lock}
    return SimpleNamespace(mechanism=reduced if is_reduced else full, reduced=reduced, hold=hold,
                           driver=driver, values=np.linspace(first, last, values))


def run_smaller(tool: SimpleNamespace) -> sp.Motion:
    return sp.sweep(tool.mechanism, tool.driver, tool.values, hold=tool.hold)


def judge_smaller(tool: SimpleNamespace, _: sp.Motion) -> dict[str, float | None]:
    mechanism = tool.mechanism
    rows = sp.closure_jacobian(mechanism, mechanism.neutral).shape[0]
    worst = tool.reduced.verify(tool.driver, tool.values[::len(tool.values) // 360]).worst
    return {"coordinates": len(mechanism.coordinates), "equations": rows, "difference": worst}


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


def setup_samples(steps: int) -> SimpleNamespace:
    tool = setup_sweep(steps)
    return SimpleNamespace(**vars(tool), motion=run_sweep(tool))


def run_samples(tool: SimpleNamespace) -> Array:
    return sp.jacobian(tool.mechanism, tool.motion, "coupler")


def judge_samples(tool: SimpleNamespace, found: Array) -> dict[str, float | None]:
    rows = range(0, len(tool.motion), 100)
    return {"difference": max(float(np.abs(found[k] - sp.jacobian(
        tool.mechanism, tool.motion[k], "coupler")).max()) for k in rows)}


def no_difference(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    return {"difference": None}


def setup_scattered(n: int) -> SimpleNamespace:
    mechanism, rng = sp.load("delta"), np.random.default_rng(0)
    return SimpleNamespace(mechanism=mechanism, values={
        driver: rng.uniform(0.0, 0.5, n) for driver in mechanism.drivers})


def run_scattered(tool: SimpleNamespace) -> sp.Motion:
    return sp.states(tool.mechanism, tool.values)


def judge_scattered(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    rows = range(0, len(motion), len(motion) // 7)
    states = [sp.assemble(tool.mechanism, {d: x[k] for d, x in tool.values.items()}, motion[k])
              for k in rows]
    return {"closure": float(motion.closure_error.max()), "difference": max(
        float(np.abs(state.q - motion.q[k]).max()) for state, k in zip(states, rows, strict=True))}


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


def judge_four_bar(tool: SimpleNamespace, motion: sp.Motion) -> dict[str, float | None]:
    values = np.array(tuple(motion.coordinate("rocker_pin")))
    return four_bar.judge(tool.values, tool.speed, values)


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


# Pages


MOVES = 60  # of one slider
MOVED = {"rssr": 0.0175, "delta": 0.0175, "stewart": 0.0002}  # by one move [rad, m]


def run_page(motion: sp.Motion) -> None:
    with tempfile.TemporaryDirectory() as folder:
        sp.export_html(motion, Path(folder) / "page.html")


def setup_slider(name: str) -> Jog:
    state = sp.assemble(sp.load(name))
    return Jog(state, state.mechanism.drivers)


def run_slider(drive: Jog, step: float) -> float:
    """Drag one slider to and fro; return the largest closure error."""
    driver = next(iter(drive.state.mechanism.drivers))
    start, worst = drive.value(driver), 0.0
    for k in range(MOVES):
        assert drive.move(driver, start + step * min(k + 1, MOVES - 1 - k)) is None
        worst = max(worst, drive.state.closure_error)
    return worst


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
    *(Case("stewart", NAME, "sweep",
           partial(setup_other, "stewart", "leg_1", stewart.lengths(n), stewart.SPEED),
           run_other, judge_stewart, n, n) for n in rssr.STEPS),
    *(Case("four_bar", NAME, "sweep",
           partial(setup_other, "four_bar", "crank", four_bar.angles(n), four_bar.SPEED),
           run_other, judge_four_bar, n, n) for n in four_bar.STEPS),
    Case("excavator", NAME, "follow", partial(setup_excavator, 1000), run_excavator,
         judge_excavator, 1000, 1000),
    *(Case("reduced", NAME, "sweep of reduce(mechanism, outputs)", partial(setup_reduced, n),
           run_sweep, judge_reduced, n, n) for n in rssr.STEPS),
    *(Case("smaller", NAME, f"{title}, {'reduced' if is_reduced else 'full'}",
           partial(setup_smaller, title, is_reduced, n), run_smaller, judge_smaller, n, n)
      for n in (361, 3600) for title in REDUCED for is_reduced in (False, True)),
    Case("page", NAME, "export_html", lambda: run_sweep(setup_sweep(361)), run_page, nothing),
    *(Case("slider", NAME, f"live, {name}", partial(setup_slider, name),
           partial(run_slider, step=step), lambda _, worst: {"closure": worst}, MOVES)
      for name, step in MOVED.items()),
    Case("rates", NAME, "solve_rates", one_state, run_rates, judge_rates),
    Case("jacobian", NAME, "jacobian", one_state, run_jacobian, judge_jacobian),
    Case("samples", NAME, "sweep", partial(setup_sweep, 2001), run_sweep, no_difference,
         2001, 2001),
    Case("samples", NAME, "jacobian of the motion", partial(setup_samples, 2001), run_samples,
         judge_samples, 2001, 2001),
    Case("scattered", NAME, "states", partial(setup_scattered, 10000), run_scattered,
         judge_scattered, 10000, 10000),
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
