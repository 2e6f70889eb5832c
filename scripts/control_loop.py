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
from collections.abc import Callable, Iterator

import numpy as np

import spatial_pin as sp

NAMES = ("four_bar", "rssr", "delta", "stewart", "excavator")
CYCLES, WARM = 100_000, 1000  # of the pauses, and how many before that are not counted
MOST_RATIO, WORST = 3.0, 1e3  # bars of the 99.9th percentile to the median; of the worst [µs]
Work = Callable[[np.ndarray, np.ndarray], object]


class Controlled:
    """A mechanism whose drivers go to and fro: each tick by one update, or call by call."""

    def __init__(self, name: str) -> None:
        self.mech = sp.load(name)
        self.drivers, self.frame = list(self.mech.drivers), self.mech.links[-1]
        self.loop = sp.ControlLoop(self.mech, frames=[self.frame])
        self.scale = self.mech.velocity_scale[[self.mech.coordinate(d).v for d in self.drivers]]
        self.state = self.loop.state
        self.home = np.array([self.state.coordinate(d).value for d in self.drivers])

    def one_by_one(self, x: np.ndarray, v: np.ndarray) -> None:
        """Do what an update does, by public calls."""
        mech, values, speeds = self.mech, *(dict(zip(self.drivers, some.tolist(), strict=True))
                                            for some in (x, v))
        self.state = sp.solve_rates(mech, sp.assemble(mech, values, guess=self.state), speeds)
        sp.jacobian(mech, self.state, self.frame)
        sp.influence(mech, self.state)
        sp.inverse_dynamics(mech, self.state)

    def times(self, work: Work, ticks: int, warm: int = 20) -> np.ndarray:
        """Return the times (ticks,) of updates along a slow motion [µs of processor time]."""
        spent = np.empty(ticks)
        for k in range(-warm, ticks):
            x = self.home + 0.02 * self.scale * np.sin(0.01 * k)
            v = 0.2 * self.scale * np.cos(0.01 * k)
            begin = time.process_time_ns()
            work(x, v)
            spent[max(k, 0)] = 1e-3 * (time.process_time_ns() - begin)
        return spent


def pauses(cycles: int = CYCLES) -> Iterator[str]:
    """Measure how long the slow ones of a controller's cycles take, and yield a line about it."""
    delta, before = Controlled("delta"), sum(x["collections"] for x in gc.get_stats())
    spent = delta.times(delta.one_by_one, cycles, WARM)
    collections = sum(x["collections"] for x in gc.get_stats()) - before
    median, slow, worst = np.quantile(spent, [0.5, 0.999, 1.0]).tolist()
    ratio = slow / median
    yield (f"delta robot, one by one, {cycles} times: median {median:.0f} µs, 99.9th percentile "
           f"{ratio:.2g}{'*' * (ratio > MOST_RATIO)} times that (bar {MOST_RATIO:g}), worst "
           f"{worst:.0f} µs{'*' * (worst > WORST)} (bar {WORST:.0f}), {collections} collections "
           "of garbage")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--only", nargs="+", default=NAMES)
    given = parser.parse_args()
    print("| mechanism | median | 99.9 % | worst | one by one | grown |\n|---|---|---|---|---|---|")
    for name in given.only:
        one = Controlled(name)
        gc.collect()
        gc.disable()
        ours = one.times(one.loop.update, given.ticks)
        theirs = one.times(one.one_by_one, given.ticks // 10)
        tracemalloc.start()
        one.times(one.loop.update, 100)
        before = tracemalloc.get_traced_memory()[0]
        one.times(one.loop.update, given.ticks)
        grown = tracemalloc.get_traced_memory()[0] - before - 8 * given.ticks
        tracemalloc.stop()
        gc.enable()
        print(f"| {name} | {np.median(ours):.0f} µs | {np.quantile(ours, 0.999):.0f} µs | "
              f"{ours.max():.0f} µs | {np.median(theirs):.0f} µs | {max(grown, 0)} bytes |",
              flush=True)


if __name__ == "__main__":
    main()
