"""A controller's cycle, again and again: how long slow ones take, and how long the machine's do.

The delta robot is assembled from the state before, at three motor angles a little further on; its
influence and the efforts of its motors follow. After each cycle comes a bare loop of NumPy of about
the same length, which makes no object that stays and no array: what of slow cycles is the machine's
(its caches, interrupts, other processes) it has too. Times are of the thread on the processor.
"""

from __future__ import annotations

import gc
import resource
import time
from collections.abc import Callable, Iterator

import numpy as np

import spatial_pin as sp

CYCLES, WARM = 100_000, 1000  # and how many before that are not counted
TURN = 500  # cycles of one turn of the motors' angles
MOST_RATIO, WORST = 3.0, 1e-3  # of the 99.9th percentile to the median; of the worst [s]
SIZE, ROOM = 12, 4_000  # of the bare loop: a matrix, and how many of them it goes through


def bare_loop() -> Callable[[int], None]:
    """Return a loop of so many products of small matrices, over as much memory as the library."""
    matrices = np.ones((ROOM, SIZE, SIZE))
    out = np.empty((SIZE, SIZE))

    def work(n: int) -> None:
        for k in range(n):
            np.matmul(matrices[37 * k % ROOM], matrices[k], out=out)

    return work


def measure(cycles: int = CYCLES) -> tuple[np.ndarray, int, int]:
    """Return times (2, cycles) of cycles and of the bare loop [s], collections and page faults."""
    mechanism = sp.load("delta")
    state = sp.assemble(mechanism)
    home = {d: state.coordinate(d).value for d in mechanism.drivers}
    seconds, before, bare, n = np.empty((2, cycles)), (0, 0), bare_loop(), 10
    for k in range(-WARM, cycles):
        if k == 0:
            gc.collect()
            before = counted()
        angle = 2.0 * np.pi * k / TURN
        values = {d: x + 0.15 * float(np.sin(angle + i)) for i, (d, x) in enumerate(home.items())}
        begun = time.thread_time_ns()
        state = sp.assemble(mechanism, values, state)
        sp.influence(mechanism, state)
        sp.inverse_dynamics(mechanism, state)
        between = time.thread_time_ns()
        bare(n)
        end = time.thread_time_ns()
        if k >= 0:
            seconds[:, k] = 1e-9 * (between - begun), 1e-9 * (end - between)
        elif k > -WARM // 2:  # it takes as long as a cycle
            n = max(1, round(n * ((between - begun) / (end - between)) ** 0.1))
    collections, faults = (x - y for x, y in zip(counted(), before, strict=True))
    return seconds, collections, faults


def counted() -> tuple[int, int]:
    """Return how often the collector has looked for garbage, and memory was mapped."""
    return (sum(x["collections"] for x in gc.get_stats()),
            resource.getrusage(resource.RUSAGE_SELF).ru_minflt)


def lines(cycles: int = CYCLES) -> Iterator[str]:
    """Measure and yield the lines about pauses."""
    seconds, collections, faults = measure(cycles)
    yield (f"delta robot, warm assemble, influence, inverse_dynamics, {cycles} times, a bare loop "
           f"of NumPy after each ({collections} collections of garbage, {faults} page faults)")
    for name, times in zip(("cycle", "bare loop"), seconds, strict=True):
        median, slow, worst = np.quantile(times, [0.5, 0.999, 1.0]).tolist()
        ratio, is_ours = slow / median, name == "cycle"
        yield (f"{name:>10}: median {1e6 * median:.0f} µs, 99.9th percentile {ratio:.2g}"
               f"{'*' * (is_ours and ratio > MOST_RATIO)} times that (bar {MOST_RATIO:g}), worst "
               f"{1e6 * worst:.0f} µs{'*' * (is_ours and worst > WORST)} (bar {1e6 * WORST:.0f})")
