"""A controller's cycle, again and again: how long the slow ones take.

The delta robot is assembled from the state before, at three motor angles a little further on; its
influence and the efforts of its motors follow. Times are of the processor.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator

import numpy as np

import spatial_pin as sp

CYCLES, WARM = 100_000, 1000  # and how many before that are not counted
TURN = 500  # cycles of one turn of the motors' angles
MOST_RATIO, WORST = 3.0, 1e-3  # of the 99.9th percentile to the median; of the worst [s]


def measure(cycles: int = CYCLES) -> tuple[np.ndarray, int]:
    """Return the times of cycles [s], and how often the collector has looked for garbage."""
    mechanism = sp.load("delta")
    state = sp.assemble(mechanism)
    home = {d: state.coordinate(d).value for d in mechanism.drivers}
    seconds, before = np.empty(cycles), 0
    for k in range(-WARM, cycles):
        if k == 0:
            gc.collect()
            before = sum(x["collections"] for x in gc.get_stats())
        angle = 2.0 * np.pi * k / TURN
        values = {d: x + 0.15 * float(np.sin(angle + i)) for i, (d, x) in enumerate(home.items())}
        begun = time.process_time_ns()
        state = sp.assemble(mechanism, values, state)
        sp.influence(mechanism, state)
        sp.inverse_dynamics(mechanism, state)
        if k >= 0:
            seconds[k] = 1e-9 * (time.process_time_ns() - begun)
    return seconds, sum(x["collections"] for x in gc.get_stats()) - before


def lines(cycles: int = CYCLES) -> Iterator[str]:
    """Measure and yield the lines about pauses."""
    seconds, collections = measure(cycles)
    median, slow, worst = np.quantile(seconds, [0.5, 0.999, 1.0]).tolist()
    ratio = slow / median
    yield (f"delta robot, warm assemble, influence, inverse_dynamics, {cycles} times: median "
           f"{1e6 * median:.0f} µs, 99.9th percentile {ratio:.2g}{'*' * (ratio > MOST_RATIO)} "
           f"times that (bar {MOST_RATIO:g}), worst {1e6 * worst:.0f} µs{'*' * (worst > WORST)} "
           f"(bar {1e6 * WORST:.0f}), {collections} collections of garbage")
