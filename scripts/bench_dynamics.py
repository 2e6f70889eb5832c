"""Simulation of the IFToMM problem A02 and forward dynamics of its ladders: time and error.

A02 is N square windows side by side, N + 1 upright rods and N couplers of 1 m and 1 kg, moved by
gravity for 10 s through the flat configurations where branches cross [IFToMM benchmark library].
On the parallelogram branch I theta'' = c sin(theta), which is the reference.

    python scripts/bench_dynamics.py [--repeats 5] [--loops 1 10 50 200] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only get in the way

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

import spatial_pin as sp

DURATION = 10.0
G = 9.81


def ladder(windows: int, folder: Path) -> sp.Mechanism:
    """Write and load the ladder of that many windows, closed by revolute pairs."""
    quarter = repr(math.pi / 2)
    rod = ('<link name="{}"><inertial><origin xyz="0.5 0 0"/><mass value="1"/><inertia ixx="1e-9" '
           f'iyy="{1 / 12!r}" izz="{1 / 12!r}" ixy="0" ixz="0" iyz="0"/></inertial></link>')
    hinge = ('<joint name="{}" type="continuous"><parent link="{}"/><child link="{}"/>'
             '<origin xyz="{} 0 0" rpy="0 0 {}"/><axis xyz="0 0 1"/></joint>')
    end = ('<link name="{0}"/><joint name="{0}_mount" type="fixed"><parent link="{1}"/>'
           '<child link="{0}"/><origin xyz="1 0 0"/></joint>')
    parts = ['<robot name="ladder"><link name="ground"/>']
    for i in range(windows + 1):
        parts += [rod.format(f"rod_{i}"),
                  hinge.format(f"pin_{i}", "ground", f"rod_{i}", i, quarter)]
    for i in range(windows):
        parts += [rod.format(f"bar_{i}"),
                  hinge.format(f"top_{i}", f"rod_{i}", f"bar_{i}", 1, f"-{quarter}"),
                  end.format(f"end_{i}", f"bar_{i}"), end.format(f"tip_{i}", f"rod_{i + 1}")]
    (folder / "ladder.urdf").write_text("\n".join([*parts, "</robot>"]))
    closures = "".join(f'[[closures]]\nname = "corner_{i}"\ntype = "revolute"\n'
                       f'frames = ["end_{i}", "tip_{i}"]\n' for i in range(windows))
    (folder / "ladder.toml").write_text(
        f'name = "ladder"\ntree = "ladder.urdf"\ngravity = [0.0, -{G}, 0.0]\n{closures}'
        '[drivers.pin_0]\njoint = "pin_0"\n')
    return sp.load(folder / "ladder.toml")


def moving(mechanism: sp.Mechanism) -> sp.State:
    """Return the upright ladder, its first top moving at 1 m/s towards +x."""
    return sp.solve_rates(mechanism, sp.assemble(mechanism, {"pin_0": 0.0}), {"pin_0": -1.0})


def theta(windows: int, tolerance: float, times: Any = None) -> Any:
    """Solve the one equation by hand: the reference, and what to be measured against."""
    inertia, moment = (windows + 1) / 3 + windows, ((windows + 1) / 2 + windows) * G
    return solve_ivp(lambda t, y: [y[1], moment / inertia * math.sin(y[0])], (0.0, DURATION),
                     [0.0, 1.0], method="DOP853", rtol=tolerance, atol=tolerance, t_eval=times)


def by_hand(tolerance: float) -> Callable[[sp.Mechanism, int], tuple[Any, float]]:
    def run(_: sp.Mechanism, windows: int) -> tuple[Any, float]:
        rows = np.linspace(0.0, DURATION, 1001)  # as many as `simulate` keeps
        return theta(windows, tolerance, rows).y[0, -1], 0.0
    return run


def by_simulate(level: str) -> Callable[[sp.Mechanism, int], tuple[Any, float]]:
    def run(mechanism: sp.Mechanism, _: int) -> tuple[Any, float]:
        motion = sp.simulate(mechanism, moving(mechanism), DURATION,
                             accuracy=sp.Accuracy.named(level))
        return -motion.coordinate("pin_0").value[-1], motion.closure_error.max()
    return run


def by_pinocchio(step: float) -> Callable[[sp.Mechanism, int], tuple[Any, float]]:
    """Pinocchio's constraintDynamics with Baumgarte terms and a Runge-Kutta loop, by hand."""
    def run(mechanism: sp.Mechanism, _: int) -> tuple[Any, float]:
        model, data = mechanism.model, mechanism.model.createData()
        models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for closure in mechanism.closures:
            (i1, m1), (i2, m2) = (mechanism.frame_on_joint(f) for f in closure.frames)
            point = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, i1, m1, i2, m2,
                                             pin.ReferenceFrame.LOCAL)
            point.m_baumgarte_parameters.Kp = 100.0
            point.m_baumgarte_parameters.Kd = 20.0
            models.append(point)
            datas.append(point.createData())
        pin.initConstraintDynamics(model, data, models, datas)
        settings = pin.ProximalSettings(1e-12, 1e-10, 20)
        none = np.zeros(model.nv)

        def acceleration(q: Any, v: Any) -> Any:
            return pin.constraintDynamics(model, data, q, v, none, models, datas, settings).copy()

        state, h = moving(mechanism), step
        q, v = state.q.copy(), state.v.copy()
        for _ in range(round(DURATION / h)):
            k1 = acceleration(q, v)
            k2 = acceleration(q + 0.5 * h * v, v + 0.5 * h * k1)
            k3 = acceleration(q + 0.5 * h * v + 0.25 * h * h * k1, v + 0.5 * h * k2)
            k4 = acceleration(q + h * v + 0.5 * h * h * k2, v + h * k3)
            q = q + h * v + h * h / 6.0 * (k1 + k2 + k3)
            v = v + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        pin.forwardKinematics(model, data, q)
        gaps = [np.linalg.norm(data.oMi[c.joint1_id].act(c.joint1_placement.translation)
                               - data.oMi[c.joint2_id].act(c.joint2_placement.translation))
                for c in models]
        return -q[mechanism.coordinate("pin_0").q], max(gaps)
    return run


SIMULATIONS = {
    "simulate, draft": by_simulate("draft"),
    "simulate, engineering": by_simulate("engineering"),
    "simulate, reference": by_simulate("reference"),
    "one equation by hand, DOP853 at 4e-12": by_hand(4e-12),
    "Pinocchio by hand, RK4 at 1 ms": by_pinocchio(1e-3),
}


def measure(repeats: int) -> list[dict[str, Any]]:
    """Time every way of solving A02 with one window, in turns."""
    exact = float(theta(1, 1e-13).y[0, -1])
    with tempfile.TemporaryDirectory() as folder:
        mechanism = ladder(1, Path(folder))
        seconds: dict[str, list[float]] = {name: [] for name in SIMULATIONS}
        answers = {}
        for _ in range(repeats):
            for name, run in SIMULATIONS.items():
                begin = time.perf_counter()
                answers[name] = run(mechanism, 1)
                seconds[name].append(time.perf_counter() - begin)
    return [{"name": name, "seconds": float(np.median(seconds[name])),
             "error": abs(float(answer) - exact), "closure": float(closure)}
            for name, (answer, closure) in answers.items()]


def loops(counts: list[int], repeats: int) -> list[dict[str, Any]]:
    """Time `forward_dynamics` of longer and longer ladders, and compare with the closed form."""
    found = []
    for n in counts:
        with tempfile.TemporaryDirectory() as folder:
            mechanism = ladder(n, Path(folder))
        angle = 0.5
        guess = {f"pin_{i}": -angle for i in range(n + 1)} | {f"top_{i}": angle for i in range(n)}
        state = sp.assemble(mechanism, {"pin_0": -angle}, guess)
        state = sp.solve_rates(mechanism, state, {"pin_0": -1.0})
        times = []
        for _ in range(max(3, repeats)):
            begin = time.perf_counter()
            answer = sp.forward_dynamics(mechanism, state)
            times.append(time.perf_counter() - begin)
        inertia, moment = (n + 1) / 3 + n, ((n + 1) / 2 + n) * G
        exact = -moment / inertia * math.sin(angle)
        at = mechanism.coordinate("pin_0").v
        found.append({"loops": n, "seconds": float(np.median(times)),
                      "error": abs(float(answer.a[at]) - exact)})
    return found


def main() -> None:
    """Measure, print, save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--loops", type=int, nargs="*", default=[1, 10, 50, 200])
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    simulated = measure(options.repeats)
    print(f"A02, one window, {DURATION:g} s: error of the angle at the end [rad]")
    for row in simulated:
        print(f"  {row['name']:40s} {row['seconds']:8.3f} s  {row['error']:8.1e}"
              f"  closure {row['closure']:.1e}")
    ladders = loops(options.loops, options.repeats)
    print("forward dynamics of the ladder: error of the acceleration [rad/s²]")
    for row in ladders:
        print(f"  {row['loops']:4d} loops {1e3 * row['seconds']:10.3f} ms  {row['error']:8.1e}")
    if options.json:
        Path(options.json).write_text(json.dumps({"A02": simulated, "ladder": ladders}, indent=2))


if __name__ == "__main__":
    main()
