"""A Monte Carlo over dimensions: all samples together against load and assemble, one by one.

Both take turns in one run. The time of the samples is that of `tolerance` with them less that of
`tolerance` without.

    python scripts/monte_carlo.py rssr four_bar rspc --samples 10000
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

import spatial_pin as sp

RELATIVE = 3e-4  # standard deviation of every dimension
ALONE = 12  # samples solved one by one in every turn


def seconds(action) -> tuple[float, object]:
    """Time a call; return its result too."""
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def measure(name: str, samples: int, turns: int) -> str:
    """Return the line of one mechanism: every coordinate is an output."""
    mechanism = sp.load(name)
    state = sp.assemble(mechanism)
    drivers = {d.joint: state.coordinate(d.joint).value for d in mechanism.drivers.values()}
    deviations = {k: RELATIVE * (abs(x) or mechanism.characteristic_length)
                  for k, x in mechanism.dimensions.items()}
    drawn = np.random.default_rng(0).normal(size=(samples, len(deviations)))
    outputs, together, alone, worst = list(mechanism.coordinates), [], [], 0.0
    for turn in range(turns):
        linear, _ = seconds(lambda: sp.tolerance(mechanism, outputs, deviations, state))
        both, found = seconds(lambda: sp.tolerance(mechanism, outputs, deviations, state,
                                                   samples=samples))
        together.append(both - linear)
        for k in range(turn * ALONE, (turn + 1) * ALONE):
            dimensions = {n: mechanism.dimensions[n] + s * float(x)
                          for (n, s), x in zip(deviations.items(), drawn[k], strict=True)}
            time_alone, own = seconds(
                lambda d=dimensions: sp.assemble(sp.load(name, **d), drivers, state))
            alone.append(time_alone)
            worst = max(worst, *(abs(found.samples[c][k] - own.coordinate(c).value)
                                 for c in outputs))
    one = statistics.median(alone)
    return (f"{name:22s} {len(deviations):10d} {statistics.median(together):11.2f} "
            f"{one * samples:11.0f} {worst:12.1e}")


def main() -> None:
    """Print one line per mechanism."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mechanisms", nargs="*", default=["rssr", "four_bar", "rspc"])
    parser.add_argument("--samples", type=int, default=10000)
    parser.add_argument("--turns", type=int, default=3)
    given = parser.parse_args()
    print(f"{given.samples} samples\n"
          f"{'mechanism':22s} dimensions together[s] one by one[s]  largest difference")
    for name in given.mechanisms:
        print(measure(name, given.samples, given.turns), flush=True)


if __name__ == "__main__":
    main()
