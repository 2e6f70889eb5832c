"""SciPy on equations written by hand, for one mechanism each; NumPy where that is all it takes."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import scipy.optimize
from scipy.integrate import solve_ivp

from benchmark import ladder, rssr
from benchmark.case import Case
from benchmark.rssr import Answer, Array, Problem

NAME = "by hand"


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
    psi, zero = unknowns[:, 0], np.zeros(len(unknowns))
    rocker = problem.c * np.column_stack([-np.cos(psi), np.sin(psi), zero])
    coupler = rocker - [problem.d, 0.0, 0.0] - problem.crank_path()[:, 0]
    if unknowns.shape[1] == 1:
        return Answer(abs(np.linalg.norm(coupler, axis=1) - problem.b), psi)
    turn, rise = unknowns[:, 1:].T
    flat = np.cos(rise)
    direction = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(rise)])
    return Answer(np.linalg.norm(coupler - problem.b * direction, axis=1), psi)


def judge_fsolve(problem: Problem, unknowns: Array) -> dict[str, float | None]:
    return rssr.judge(problem, read_fsolve(problem, unknowns))


# The one distance equation of the RSSR, tuned


def run_distance(problem: Problem) -> Array:
    """Follow f(φ, ψ) = (|AB|² - b²)/2 = p + q cos φ + r cos ψ + s cos φ cos ψ = 0.

    Newton from a cubic through the last two positions, velocities and accelerations, then the
    first and second derivatives of f = 0 along the motion; scalars only, cheaper than arrays here.
    """
    a, b, c, d, w = problem.a, problem.b, problem.c, problem.d, problem.speed
    p, q, r, s = (a * a + c * c + d * d - b * b) / 2.0, -a * d, c * d, -a * c
    h, small = problem.time_step, 0.1 * problem.tolerance * b
    h1, h2, old1, old2 = 1.5 * h, 17 / 12 * h * h, -0.5 * h, 7 / 12 * h * h
    cos, sin = math.cos, math.sin
    psi, rate, acceleration = problem.guess, 0.0, 0.0
    last, last_acceleration = 0.0, 0.0
    samples = []
    for i, phi in enumerate(problem.phi.tolist()):
        if i > 1:
            psi, last, last_acceleration = (
                psi + h1 * rate + h2 * acceleration + old1 * last + old2 * last_acceleration,
                rate, acceleration)
        elif i == 1:
            psi += h * rate + h * h / 2.0 * acceleration
            last, last_acceleration = rate, acceleration
        cphi, sphi = cos(phi), sin(phi)
        constant, slope = p + q * cphi, r + s * cphi
        for _ in range(rssr.MAX_CORRECTIONS):
            cpsi, spsi = cos(psi), sin(psi)
            gap, turn = constant + slope * cpsi, slope * spsi
            if -small <= gap <= small:
                break
            psi += gap / turn
        along = -w * sphi * (q + s * cpsi)
        rate = along / turn
        acceleration = (-w * w * cphi * (q + s * cpsi) + 2.0 * s * w * sphi * spsi * rate
                        - slope * cpsi * rate * rate) / turn
        samples.append((psi, rate, acceleration))
    return np.array(samples)


def judge_distance(problem: Problem, samples: Array) -> dict[str, float | None]:
    errors = rssr.judge(problem, (None, *samples.T, None, None))
    return {name: errors[name] for name in ("ψ", "ψ'", "ψ''")}


# IFToMM A02 as one equation


def run_pendulum(tolerance: float) -> Any:
    """Solve I θ'' = c sin θ; keep as many rows as `simulate`."""
    growth, times = ladder.growth(1), np.linspace(0.0, ladder.DURATION, 1001)
    return solve_ivp(lambda _, y: (y[1], growth * math.sin(y[0])), (0.0, ladder.DURATION),
                     [0.0, 1.0], method="DOP853", rtol=tolerance, atol=tolerance, t_eval=times)


def judge_pendulum(_: float, solution: Any) -> dict[str, float | None]:
    return ladder.judge_end(float(solution.y[0, -1]), None)


CASES = (
    *(Case("sweep", NAME, "SciPy fsolve, vector loop, q only", partial(Problem, steps=n),
           run_fsolve, judge_fsolve, n, n) for n in rssr.STEPS),
    *(Case("sweep", NAME, "SciPy fsolve, ψ alone, q only", partial(Problem, steps=n),
           run_fsolve_one, judge_fsolve, n, n) for n in rssr.STEPS),
    *(Case("reduced", NAME, "the distance equation, tuned", partial(Problem, steps=n),
           run_distance, judge_distance, n, n) for n in rssr.STEPS),
    *(Case("a02", NAME, f"one equation, SciPy DOP853 at {t:.0e}", partial(float, t), run_pendulum,
           judge_pendulum) for t in (1e-6, 1e-9, 4e-12, 1e-13)),
)
