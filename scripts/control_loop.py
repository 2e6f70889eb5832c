"""Times of a control loop: one update of each mechanism, and what it keeps of memory.

    python scripts/control_loop.py [--ticks 2000]

Prints the median, the 99.9th percentile and the worst time of an update [µs of processor time],
beside `assemble`, `jacobian`, `influence` and `inverse_dynamics` called one by one, and how much
memory has grown over all ticks.
"""

from __future__ import annotations

import argparse
import gc
import time
import tracemalloc
from collections.abc import Callable

import numpy as np

import spatial_pin as sp

NAMES = ("four_bar", "rssr", "delta", "stewart", "excavator")


def times(work: Callable[[np.ndarray, np.ndarray], object], home: np.ndarray, scale: np.ndarray,
          ticks: int) -> np.ndarray:
    """Return the times (ticks,) of updates along a slow motion [µs of processor time]."""
    spent = np.empty(ticks)
    for k in range(-20, ticks):
        x, v = home + 0.02 * scale * np.sin(0.01 * k), 0.2 * scale * np.cos(0.01 * k)
        begin = time.process_time_ns()
        work(x, v)
        spent[max(k, 0)] = 1e-3 * (time.process_time_ns() - begin)
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--only", nargs="+", default=NAMES)
    given = parser.parse_args()
    print("| mechanism | median | 99.9 % | worst | one by one | grown |\n|---|---|---|---|---|---|")
    for name in given.only:
        mech = sp.load(name)
        drivers, frame = list(mech.drivers), mech.links[-1]
        loop = sp.ControlLoop(mech, frames=[frame])
        scale = mech.velocity_scale[[mech.coordinate(d).v for d in drivers]]
        state = [loop.state]
        home = np.array([state[0].coordinate(d).value for d in drivers])

        def one_by_one(
            x: np.ndarray, v: np.ndarray, mech: sp.Mechanism = mech, drivers: list[str] = drivers,
            frame: str = frame, state: list[sp.State] = state,
        ) -> None:
            at = sp.assemble(mech, dict(zip(drivers, x.tolist(), strict=True)), guess=state[0])
            state[0] = at = sp.solve_rates(mech, at, dict(zip(drivers, v.tolist(), strict=True)))
            sp.jacobian(mech, at, frame)
            sp.influence(mech, at)
            sp.inverse_dynamics(mech, at)

        gc.collect()
        gc.disable()
        ours = times(loop.update, home, scale, given.ticks)
        theirs = times(one_by_one, home, scale, given.ticks // 10)
        tracemalloc.start()
        times(loop.update, home, scale, 100)
        before = tracemalloc.get_traced_memory()[0]
        times(loop.update, home, scale, given.ticks)
        grown = tracemalloc.get_traced_memory()[0] - before - 8 * given.ticks
        tracemalloc.stop()
        gc.enable()
        print(f"| {name} | {np.median(ours):.0f} µs | {np.quantile(ours, 0.999):.0f} µs | "
              f"{ours.max():.0f} µs | {np.median(theirs):.0f} µs | {max(grown, 0)} bytes |",
              flush=True)


if __name__ == "__main__":
    main()
