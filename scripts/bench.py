"""Time and error in one table: the RSSR four-bar turned once, solved by this library and others.

Every row solves the same 360 crank angles of one full turn at constant crank speed, closes the loop
to 1e-12 m and keeps position, velocity and acceleration of every coordinate. The rows take turns
within one run, so that noise hits all alike, and every error is measured outside the clock: the
closure from the placements that belong to the kept coordinates, the rest against the closed form.

    python scripts/bench.py --repeats 50
    python scripts/bench.py --peers --json new.json --compare old.json

To add a row: three functions (or two, where one serves several rows) and one entry in `CASES`.

1. `setup(problem)` builds what a user builds once, and is not timed.
2. `run(tool)` does the work of one turn, and is timed. It starts from the rough guess each time.
3. `read(tool, result)` turns the result into an `Answer` (or the tuple of its fields), not timed.
"""

from __future__ import annotations

import argparse
import gc
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import bench_peers
import numpy as np
import pinocchio as pin
import scipy.optimize
from numpy.typing import NDArray
from scipy.linalg.blas import daxpy, dgemv
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

import spatial_pin as sp

Array = NDArray[np.float64]

STEPS = 360  # crank angles in one turn
MAX_CORRECTIONS = 30  # Newton steps from the rough guess; two suffice after the first angle
REFERENCES = ("tuned", "fsolve")  # every row is also given as a multiple of these
STARTS = {
    "import pinocchio": "import pinocchio",
    "import spatial_pin, load": "import spatial_pin; spatial_pin.load('rssr')",
}
PACKAGES = ("spatial_pin", "pin", "numpy", "scipy", "mujoco", "drake")


# The problem and its closed form


class Answer(NamedTuple):
    """What one row found, one entry per crank angle; None where the row does not solve for it.

    Attributes:
        closure: (N,) distance between the two halves of the cut joint [m].
        angle: (N,) rocker angle [rad].
        rate: (N,) [rad/s].
        acceleration: (N,) [rad/s²].
        omega: (N, 3) angular velocity of the coupler, world axes [rad/s].
        alpha: (N, 3) angular acceleration of the coupler, world axes [rad/s²].
    """

    closure: Array | None = None
    angle: Array | None = None
    rate: Array | None = None
    acceleration: Array | None = None
    omega: Array | None = None
    alpha: Array | None = None


@dataclass(frozen=True)
class Problem:
    """Crank about +y at the origin, rocker about -z at (-d, 0, 0), coupler of length b between.

    A = (-a cos φ, 0, a sin φ), B = (-d - c cos ψ, c sin ψ, 0). The coupler does not spin about AB.
    """

    a: float = 0.102
    b: float = 0.381
    c: float = 0.254
    d: float = 0.314
    speed: float = 25.13  # [rad/s]
    guess: float = 1.23  # rocker angle near the first closed position [rad]
    tolerance: float = 1e-12  # [m]

    @cached_property
    def phi(self) -> Array:
        """(N,) crank angles [rad]."""
        return np.linspace(0.0, 2.0 * np.pi, STEPS + 1)[:STEPS]

    @property
    def time_step(self) -> float:
        """Time between two crank angles [s]."""
        return 2.0 * math.pi / STEPS / self.speed

    def crank_path(self) -> Array:
        """Return (N, 3, 3): position, velocity and acceleration of A at every crank angle."""
        s, c, w = self.a * np.sin(self.phi), self.a * np.cos(self.phi), self.speed
        path = np.zeros((STEPS, 3, 3))
        path[:, 0, 0], path[:, 0, 2] = -c, s
        path[:, 1, 0], path[:, 1, 2] = w * s, w * c
        path[:, 2] = -w * w * path[:, 0]
        return path

    def guessed_coupler(self) -> Array:
        """Return a (3, 3) rotation whose first column points from A to B at the guess."""
        rocker = np.array([-math.cos(self.guess), math.sin(self.guess), 0.0])
        x = np.array([self.a - self.d, 0.0, 0.0]) + self.c * rocker
        x /= np.linalg.norm(x)
        y = np.array([-x[1], x[0], 0.0])
        return np.column_stack([x, y, np.cross(x, y)])

    def exact(self) -> Answer:
        """Return the closed form.

        cos ψ = n/m with n = b² - a² - c² - d² + 2ad cos φ and m = 2c(d - a cos φ); the rates follow
        from differentiating m cos ψ = n twice.
        """
        a, b, c, d, w = self.a, self.b, self.c, self.d, self.speed
        sin, cos = np.sin(self.phi), np.cos(self.phi)
        n, n1, n2 = (
            b * b - a * a - c * c - d * d + 2 * a * d * cos,
            -2 * a * d * w * sin,
            -2 * a * d * w * w * cos,
        )
        m, m1, m2 = 2 * c * (d - a * cos), 2 * a * c * w * sin, 2 * a * c * w * w * cos
        u = n / m
        u1 = (n1 - u * m1) / m
        u2 = (n2 - 2 * u1 * m1 - u * m2) / m
        psi = np.arccos(u)
        rate = -u1 / np.sin(psi)
        acceleration = -(u2 + u * rate**2) / np.sin(psi)
        return Answer(None, psi, rate, acceleration, *self._coupler(psi, rate, acceleration))

    def _coupler(self, psi: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
        zero = np.zeros(STEPS)
        radial = self.c * np.column_stack([-np.cos(psi), np.sin(psi), zero])
        tangent = self.c * np.column_stack([np.sin(psi), np.cos(psi), zero])
        path = self.crank_path()
        r = radial - [self.d, 0.0, 0.0] - path[:, 0]
        r1 = tangent * rate[:, None] - path[:, 1]
        r2 = tangent * acceleration[:, None] - radial * rate[:, None] ** 2 - path[:, 2]
        return np.cross(r, r1) / self.b**2, np.cross(r, r2) / self.b**2


def check_closed_form(problem: Problem) -> str:
    """Compare the closed form with its 40-digit numerical derivatives, where mpmath is there."""
    if importlib.util.find_spec("mpmath") is None:
        return "closed form not checked (mpmath is not installed)"
    import mpmath

    lengths = problem.a, problem.b, problem.c, problem.d
    a, b, c, d, w = (mpmath.mpf(x) for x in (*lengths, problem.speed))
    rest = b**2 - a**2 - c**2 - d**2
    exact, worst = problem.exact(), 0.0
    with mpmath.workdps(40):
        for i in range(0, STEPS, 15):

            def psi(t: Any, phi: float = problem.phi[i]) -> Any:
                u = mpmath.cos(phi + w * t)
                return mpmath.acos((rest + 2 * a * d * u) / (2 * c * (d - a * u)))

            for order, value in enumerate((exact.angle, exact.rate, exact.acceleration)):
                scale = problem.speed**order
                worst = max(worst, abs(float(mpmath.diff(psi, 0, order) - value[i])) / scale)
    return f"closed form against 40-digit differentiation: {worst:.0e} (per unit crank speed)"


# This library, through its public interface


def setup_sweep(problem: Problem) -> SimpleNamespace:
    return SimpleNamespace(mechanism=sp.load("rssr"), problem=problem)


def run_sweep(tool: SimpleNamespace) -> tuple[sp.Motion, Any]:
    motion = sp.sweep(tool.mechanism, "crank", tool.problem.phi, speed=tool.problem.speed)
    return motion, motion.coordinate("rocker_pin")


def run_sweep_bodies(tool: SimpleNamespace) -> tuple[sp.Motion, Any]:
    motion, rocker = run_sweep(tool)
    motion.frame("coupler")
    for link in ("crank", "coupler", "rocker"):
        motion.com(link)
    return motion, rocker


def read_sweep(_: SimpleNamespace, result: tuple[sp.Motion, Any]) -> Answer:
    motion, rocker = result
    gap = motion.frame("coupler_b").position - motion.frame("rocker_b").position
    coupler = motion.frame("coupler")
    omega, alpha = coupler.angular_velocity, coupler.angular_acceleration
    return Answer(np.linalg.norm(gap, axis=1), *rocker, omega, alpha)


# Pinocchio by hand: tuned, and plain


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
    kinematics, integrate, place = pin.forwardKinematics, pin.integrate, pin.updateFramePlacement
    jacobians, get_jacobian = pin.computeJointJacobians, pin.getFrameJacobian
    get_acceleration, axes = pin.getFrameClassicalAcceleration, pin.LOCAL
    h, small, nv = problem.time_step, problem.tolerance**2, model.nv
    positions = np.empty((STEPS, model.nq))
    rates = np.zeros((STEPS, 2, nv))  # velocity and acceleration of each step
    rates[:, 0, 0] = problem.speed
    history = rates.reshape(-1, nv).T
    predictor = np.array([1.5 * h, 7 / 12 * h * h, -0.5 * h, 17 / 12 * h * h])
    p, rotation = data.oMf[tip].translation, data.oMf[tip].rotation
    rhs, step, zero = np.zeros(4), np.zeros(nv), np.zeros(nv)
    correction = step[1:]
    path = problem.crank_path().transpose(1, 0, 2)
    kept = rates[:, 0], rates[:, 0, 1:], rates[:, 1, 1:]
    q = tool.q0
    for i, (phi, target, velocity, acceleration, v, v_left, a_left) in enumerate(
        zip(problem.phi.tolist(), *path, *kept, strict=True)
    ):
        if i > 1:
            q = integrate(model, q, dgemv(1.0, history[:, 2 * i - 4 : 2 * i], predictor))
        elif i == 1:
            q = integrate(model, q, h * rates[0, 0] + h * h / 2 * rates[0, 1])
        q[0] = phi
        for _ in range(MAX_CORRECTIONS):
            jacobians(model, data, q)
            place(model, data, tip)
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
        dgemv(1.0, rotation, velocity, 0.0, v_left, 0, 1, 0, 1, 1, 1)
        dgetrs(lu, pivots, v_left, 0, 1)
        kinematics(model, data, q, v, zero)
        bias = get_acceleration(model, data, tip, axes).vector
        dgemv(1.0, rotation, acceleration, 0.0, a_left, 0, 1, 0, 1, 1, 1)
        daxpy(bias, a_left, 4, -1.0)
        dgetrs(lu, pivots, a_left, 0, 1)
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
    tool.contact, tool.ends, tool.coupler, tool.rocker = contact, ends, ends[0], (5, 4)
    return tool


def run_plain(tool: SimpleNamespace) -> tuple[Array, Array, Array]:
    """Newton as the documentation suggests, from the last position moved on by its velocity."""
    model, data, contact, problem = tool.model, tool.data, tool.contact, tool.problem
    kept, (coupler, rocker) = contact.createData(), tool.ends
    rows, rhs = np.zeros((4, model.nv)), np.zeros(4)  # loop and spin, in the axes of the coupler
    q, v, step, zero = tool.q0, np.zeros(model.nv), np.zeros(model.nv), np.zeros(model.nv)
    positions, velocities, accelerations = [], [], []
    for phi in problem.phi:
        q = pin.integrate(model, q, v * problem.time_step)
        q[0] = phi
        while True:
            pin.computeJointJacobians(model, data, q)
            contact.calc(model, data, kept)
            rows[:3] = pin.getConstraintJacobian(model, data, contact, kept)
            rows[3] = pin.getFrameJacobian(model, data, coupler, pin.LOCAL)[3]
            rhs[:3], rhs[3] = kept.c1Mc2.translation, 0.0
            if np.linalg.norm(rhs) <= problem.tolerance:
                break
            step[1:] = np.linalg.solve(rows[:, 1:], rhs)
            q = pin.integrate(model, q, step)
        v, a = np.zeros(model.nv), np.zeros(model.nv)
        v[0] = problem.speed
        v[1:] = np.linalg.solve(rows[:, 1:], -rows[:, 0] * problem.speed)
        pin.forwardKinematics(model, data, q, v, zero)
        one = pin.getFrameClassicalAcceleration(model, data, coupler, pin.LOCAL)
        other = pin.getFrameClassicalAcceleration(model, data, rocker, pin.LOCAL)
        rhs[:3] = kept.c1Mc2.rotation @ other.linear - one.linear
        rhs[3] = -one.angular[0]
        a[1:] = np.linalg.solve(rows[:, 1:], rhs)
        positions.append(q)
        velocities.append(v)
        accelerations.append(a)
    return np.array(positions), np.array(velocities), np.array(accelerations)


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


# SciPy on hand-written equations


def run_fsolve(problem: Problem) -> Array:
    """Solve the vector loop for the rocker angle and the two angles of the coupler's direction."""
    a, b, c, d = problem.a, problem.b, problem.c, problem.d

    def loop(x: Array, phi: float) -> list[float]:
        psi, turn, rise = x.tolist()
        return [
            -a * math.cos(phi) + b * math.cos(rise) * math.cos(turn) + d + c * math.cos(psi),
            b * math.cos(rise) * math.sin(turn) - c * math.sin(psi),
            a * math.sin(phi) + b * math.sin(rise),
        ]

    x, y, _ = problem.guessed_coupler()[:, 0]
    unknown, answers = np.array([problem.guess, math.atan2(y, x), 0.0]), []
    for phi in problem.phi.tolist():
        unknown = scipy.optimize.fsolve(loop, unknown, args=(phi,), xtol=1e-10)
        answers.append(unknown)
    return np.array(answers)


def run_fsolve_one(problem: Problem) -> Array:
    """Solve |AB| = b for the rocker angle; the coupler's direction is eliminated by hand."""
    a, b, c, d = problem.a, problem.b, problem.c, problem.d

    def squared_gap(x: Array, phi: float) -> float:
        psi = x.item()
        along = d + c * math.cos(psi) - a * math.cos(phi)
        return along**2 + (c * math.sin(psi)) ** 2 + (a * math.sin(phi)) ** 2 - b * b

    psi, answers = np.array([problem.guess]), []
    for phi in problem.phi.tolist():
        psi = scipy.optimize.fsolve(squared_gap, psi, args=(phi,), xtol=1e-10)
        answers.append(psi)
    return np.array(answers)


def read_fsolve(problem: Problem, unknowns: Array) -> Answer:
    psi, zero = unknowns[:, 0], np.zeros(STEPS)
    rocker = problem.c * np.column_stack([-np.cos(psi), np.sin(psi), zero])
    coupler = rocker - [problem.d, 0.0, 0.0] - problem.crank_path()[:, 0]
    if unknowns.shape[1] == 1:
        return Answer(abs(np.linalg.norm(coupler, axis=1) - problem.b), psi)
    turn, rise = unknowns[:, 1:].T
    flat = np.cos(rise)
    direction = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(rise)])
    return Answer(np.linalg.norm(coupler - problem.b * direction, axis=1), psi)


# Measuring


@dataclass(frozen=True)
class Case:
    """One row of the table: what to build, what to time, how to read the result.

    Attributes:
        key: short name, for `--rows` and in the saved file.
        title: what the table says.
        setup: called once with the problem, returns the tool.
        run: called with the tool, timed.
        read: called with the tool and the result of `run`, returns the fields of an `Answer`.
        needs: module that must be installed, where it is not one of the library's own.
    """

    key: str
    title: str
    setup: Callable[[Problem], Any]
    run: Callable[[Any], Any]
    read: Callable[[Any, Any], Iterable[Array | None]]
    needs: str = "pinocchio"


class Row(NamedTuple):
    """Times [µs per step] and largest errors of one case."""

    median: float
    least: float
    quartiles: tuple[float, float]
    relative: dict[str, float]
    errors: dict[str, float | None]


def time_in_turns(cases: list[Case], tools: list[Any], repeats: int) -> Array:
    """Return (cases, repeats) seconds of one run; the cases take turns."""
    seconds = np.empty((len(cases), repeats))
    for k in range(-1, repeats):  # the first round warms up
        gc.collect()
        gc.disable()
        for i, (case, tool) in enumerate(zip(cases, tools, strict=True)):
            start = time.perf_counter()
            case.run(tool)
            if k >= 0:
                seconds[i, k] = time.perf_counter() - start
        gc.enable()
    return seconds


def largest_errors(answer: Answer, exact: Answer) -> dict[str, float | None]:
    """Return the largest absolute error of each field; the closure is an error itself."""
    errors = {}
    for name, got, wanted in zip(Answer._fields, answer, exact, strict=True):
        difference = None if got is None else got if wanted is None else got - wanted
        errors[name] = None if difference is None else float(np.abs(difference).max())
    return errors


def measure(cases: list[Case], problem: Problem, repeats: int) -> dict[str, Row]:
    """Return one row per case."""
    tools = [case.setup(problem) for case in cases]
    micro = time_in_turns(cases, tools, repeats) / STEPS * 1e6
    exact, rows = problem.exact(), {}
    by_key = {case.key: times for case, times in zip(cases, micro, strict=True)}
    for case, tool, times in zip(cases, tools, micro, strict=True):
        answer = Answer(*case.read(tool, case.run(tool)))
        low, median, high = (float(x) for x in np.percentile(times, (25, 50, 75)))
        relative = {k: float(np.median(times / by_key[k])) for k in REFERENCES if k in by_key}
        errors = largest_errors(answer, exact)
        rows[case.key] = Row(median, float(times.min()), (low, high), relative, errors)
    return rows


def start_times(repeats: int) -> dict[str, float]:
    """Return the median seconds of a fresh process for each statement of `STARTS`."""
    seconds: dict[str, list[float]] = {title: [] for title in STARTS}
    for k in range(-1, repeats):
        for title, code in STARTS.items():
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            if k >= 0:
                seconds[title].append(time.perf_counter() - start)
    return {title: float(np.median(times)) for title, times in seconds.items()}


# Output


def machine() -> dict[str, Any]:
    """Return processor, cores and Python."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [x for x in info.read_text().splitlines() if x.startswith("model name")]
        model = lines[0].partition(":")[2].strip() if lines else model
    return {"cpu": model, "cores": os.cpu_count(), "python": platform.python_version()}


def versions() -> dict[str, str]:
    """Return the versions of the installed packages."""
    found = {"spatial_pin": sp.__version__}
    for name in PACKAGES[1:]:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def format_row(title: str, row: dict[str, Any]) -> str:
    """Return one line of the table."""
    low, high = row["quartiles"]
    times = f"{row['median']:8.2f} {row['least']:8.2f} {low:8.2f}-{high:<7.2f}"
    relative = " ".join(f"{row['relative'].get(k, math.nan):7.2f}" for k in REFERENCES)
    errors = " ".join("      -" if e is None else f"{e:7.0e}" for e in row["errors"].values())
    return f"{title:<38}{times} {relative}  {errors}"


def print_table(report: dict[str, Any], missing: list[Case]) -> None:
    """Print a saved or fresh report."""
    host = report["machine"]
    print(f"{host['cpu']}, {host['cores']} cores, Python {host['python']}; ", end="")
    print(", ".join(f"{name} {version}" for name, version in report["versions"].items()))
    print(f"µs per step, {report['repeats']} interleaved repeats; errors in m, rad, rad/s, rad/s²")
    head = f"{'':<38}{'median':>8} {'min':>8} {'middle half':>16} {'/tuned':>7} {'/fsolve':>7}  "
    print(head + " ".join(f"{x:>7}" for x in ("closure", "ψ", "ψ'", "ψ''", "ω", "α")))
    for row in report["rows"].values():
        print(format_row(row["title"], row))
    for case in missing:
        print(f"{case.title:<38}not installed")
    starts = report["seconds"].items()
    print("fresh process: " + ", ".join(f"{title} {seconds:.3f} s" for title, seconds in starts))


def print_changes(old: dict[str, Any], new: dict[str, Any]) -> None:
    """Print the ratio of the medians of two reports, row by row."""
    print("\nnew median / old median, and the same relative to the hand-tuned loop")
    for key, row in new["rows"].items():
        if key in old["rows"]:
            was = old["rows"][key]
            change = row["median"] / was["median"]
            now, before = (x["relative"].get("tuned", math.nan) for x in (row, was))
            print(f"{row['title']:<38}{change:8.2f} {now / before:8.2f}")


CASES = (
    Case("sweep", "spatial_pin.sweep", setup_sweep, run_sweep, read_sweep),
    Case("bodies", "spatial_pin.sweep + body states", setup_sweep, run_sweep_bodies, read_sweep),
    Case("tuned", "Pinocchio by hand, tuned", setup_tuned, run_tuned, read_pinocchio),
    Case("plain", "Pinocchio by hand, plain", setup_plain, run_plain, read_pinocchio),
    Case("fsolve", "SciPy fsolve, vector loop, q only", lambda p: p, run_fsolve, read_fsolve),
    Case("fsolve_one", "SciPy fsolve, ψ alone, q only", lambda p: p, run_fsolve_one, read_fsolve),
)

PEERS = (
    Case(
        "mujoco_tuned",
        "Newton on MuJoCo's mj_jac, tuned",
        bench_peers.setup_mujoco,
        bench_peers.run_mujoco_tuned,
        bench_peers.read_mujoco,
        "mujoco",
    ),
    Case(
        "mujoco",
        "Newton on MuJoCo's mj_jac, plain",
        bench_peers.setup_mujoco,
        bench_peers.run_mujoco,
        bench_peers.read_mujoco,
        "mujoco",
    ),
    Case(
        "drake_tuned",
        "Newton on Drake's Jacobians, tuned",
        bench_peers.setup_drake,
        bench_peers.run_drake_tuned,
        bench_peers.read_drake,
        "pydrake",
    ),
    Case(
        "drake",
        "Newton on Drake's Jacobians, plain",
        bench_peers.setup_drake,
        bench_peers.run_drake,
        bench_peers.read_drake,
        "pydrake",
    ),
)


def parse() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=30, help="runs of each row (30)")
    parser.add_argument("--starts", type=int, default=5, help="fresh processes of each kind (5)")
    parser.add_argument("--peers", action="store_true", help="add MuJoCo and Drake")
    parser.add_argument("--rows", nargs="+", metavar="KEY", help="only these rows")
    parser.add_argument("--json", metavar="FILE", help="save the results")
    parser.add_argument("--compare", metavar="FILE", help="print saved results beside the new ones")
    return parser.parse_args()


def main() -> None:
    """Measure, print, save."""
    options, problem = parse(), Problem()
    cases = [*CASES, *(PEERS if options.peers else ())]
    unknown = set(options.rows or ()) - {case.key for case in cases}
    if unknown:
        known = " ".join(case.key for case in cases)
        sys.exit(f"no such row: {' '.join(sorted(unknown))}; rows: {known}")
    cases = [case for case in cases if not options.rows or case.key in options.rows]
    missing = [case for case in cases if importlib.util.find_spec(case.needs) is None]
    cases = [case for case in cases if case not in missing]
    titles = {case.key: case.title for case in cases}
    rows = measure(cases, problem, options.repeats)
    report = {
        "machine": machine(),
        "versions": versions(),
        "repeats": options.repeats,
        "rows": {key: {"title": titles[key], **row._asdict()} for key, row in rows.items()},
        "seconds": start_times(options.starts),
    }
    print(check_closed_form(problem))
    print_table(report, missing)
    if options.compare:
        old = json.loads(Path(options.compare).read_text())
        print("\nbefore:")
        print_table(old, [])
        print_changes(old, report)
    if options.json:
        Path(options.json).write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
