"""A million steps of fixed length: do the loops stay closed, does the energy stay?

A four-bar swings from rest under gravity (RK4), and turns with its crank. What a coordinate of
many turns loses in the last digits is told beside it: the closure error cannot be below. Usage:

    python scripts/million_steps.py [steps]
"""

from __future__ import annotations

import sys
import time

import numpy as np

import spatial_pin as sp

STEP = 1e-3  # [s]
ROWS = 1001
WAYS = {"swinging from rest": 0.0, "turning": 20.0}  # first speed of the crank [rad/s]


def simulate(speed: float, steps: int) -> tuple[sp.Simulation, float]:
    """Return the motion, and the time it took [s]."""
    mechanism = sp.load("four_bar")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.5}), {"crank": speed})
    duration = steps * STEP
    start = time.perf_counter()
    motion = sp.simulate(mechanism, state, duration, times=np.linspace(0.0, duration, ROWS),
                         accuracy=sp.Accuracy(integrator="RK4", step=STEP))
    return motion, time.perf_counter() - start


def main() -> None:
    """Print one paragraph for each way."""
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    for name, speed in WAYS.items():
        motion, seconds = simulate(speed, steps)
        parts = np.array_split(motion.closure_error, 10)
        turned = float(np.abs(motion.q).max())
        print(f"{name}: {motion.steps} steps of {STEP:g} s in {seconds:.0f} s\n"
              f"  closure error: first tenth {parts[0].max():.1e}, last tenth {parts[-1].max():.1e}"
              f"; last digit of the largest coordinate, {turned:.0f} rad: "
              f"{np.spacing(turned):.1e}\n"
              f"  energy drift {motion.energy_drift:.1e}", flush=True)


if __name__ == "__main__":
    main()
