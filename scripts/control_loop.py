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


def bare_loop() -> Callable[[int], None]:
    """Return a loop of products of small matrices, over as much memory as the library uses."""
    matrices, out = np.ones((4000, 12, 12)), np.empty((12, 12))

    def work(n: int) -> None:
        for k in range(n):
            np.matmul(matrices[37 * k % len(matrices)], matrices[k], out=out)

    return work


def pauses(cycles: int = CYCLES) -> Iterator[str]:
    """Measure how long the slow ones of a controller's cycles take, and yield lines about it.

    The delta robot is assembled from the state before; its influence and efforts follow. After each
    cycle comes a bare loop of NumPy of about the same length, which makes no array: what of slow
    cycles is the machine's (caches, interrupts, other processes) it has too.
    """
    delta, bare, n, spent = Controlled("delta"), bare_loop(), 10, np.empty((2, cycles))
    for k in range(-WARM, cycles):
        if k == 0:
            gc.collect()
            before = sum(x["collections"] for x in gc.get_stats())
        x = delta.home + 0.15 * np.sin(0.0126 * k + np.arange(len(delta.home)))
        values, begin = dict(zip(delta.drivers, x.tolist(), strict=True)), time.thread_time_ns()
        delta.state = sp.assemble(delta.mech, values, guess=delta.state)
        sp.influence(delta.mech, delta.state)
        sp.inverse_dynamics(delta.mech, delta.state)
        between = time.thread_time_ns()
        bare(n)
        end = time.thread_time_ns()
        if k >= 0:
            spent[:, k] = 1e-3 * (between - begin), 1e-3 * (end - between)
        elif k > -WARM // 2:  # the bare loop is to take as long
            n = max(1, round(n * ((between - begin) / (end - between)) ** 0.1))
    collections = sum(x["collections"] for x in gc.get_stats()) - before
    yield (f"delta robot, assemble, influence, inverse_dynamics, {cycles} times, {collections} "
           "collections of garbage; a bare loop of NumPy after each")
    for name, times in zip(("cycle", "bare loop"), spent, strict=True):
        median, slow, worst = np.quantile(times, [0.5, 0.999, 1.0]).tolist()
        ratio, is_ours = slow / median, name == "cycle"
        yield (f"{name:>10}: median {median:.0f} µs, 99.9th percentile {ratio:.2g}"
               f"{'*' * (is_ours and ratio > MOST_RATIO)} times that (bar {MOST_RATIO:g}), worst "
               f"{worst:.0f} µs{'*' * (is_ours and worst > WORST)} (bar {WORST:.0f})")


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
