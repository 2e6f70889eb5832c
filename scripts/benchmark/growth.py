"""How time and memory grow with the number of loops: a ladder, each size in a process of its own.

    python -m benchmark.growth 100

prints a JSON line after every stage: load, assemble, reactions of the state, sweep 100 values,
simulate 1 s. The ladder leans from upright and does not come to where its windows are flat.
"""

from __future__ import annotations

import json
import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

SIZES = (50, 100, 200, 500, 1000)
SECONDS = 120  # of the processor that a size may take
MEMORY = 8 << 30  # address space that it may take [bytes]
LEAN, FAR = -0.02, -0.5  # of the first rod [rad]
STAGES = ("load", "assemble", "reactions", "sweep 100 values", "simulate 1 s")


def stages(n: int) -> Iterator[str]:
    """Yield the name of every stage when it is done."""
    import numpy as np
    import published_models as models

    import spatial_pin as sp

    mechanism = models.ladder(n)
    yield STAGES[0]
    state = sp.assemble(mechanism, {"pin_0": LEAN})
    yield STAGES[1]
    assert sp.forward_dynamics(mechanism, state).reactions
    yield STAGES[2]
    sp.sweep(mechanism, "pin_0", np.linspace(LEAN, FAR, 100), guess=state)
    yield STAGES[3]
    sp.simulate(mechanism, state, 1.0)
    yield STAGES[4]


def serve(n: int) -> None:
    """Work, and print seconds of the processor and the largest memory [MB] so far."""
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import spatial_pin  # noqa: F401 - not a part of loading

    start = time.process_time()
    for stage in stages(n):
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps([stage, time.process_time() - start, memory]), flush=True)
        start = time.process_time()


def measure(n: int) -> tuple[dict[str, tuple[float, float]], str]:
    """Return seconds and memory [MB] of the stages that a size came through, and its last words."""
    scripts = Path(__file__).parent.parent
    path = os.pathsep.join(filter(None, (str(scripts), os.environ.get("PYTHONPATH"))))
    done = subprocess.run([sys.executable, "-W", "ignore", "-m", "benchmark.growth", str(n)],
                          capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": path})
    stages = {stage: (seconds, memory)
             for stage, seconds, memory in map(json.loads, done.stdout.splitlines())}
    words = done.stderr.strip().splitlines() or [f"ended by signal {-done.returncode}"]
    return stages, "" if len(stages) == len(STAGES) else words[-1]


def power(measured: Mapping[int, Mapping[str, Any]], stage: str) -> tuple[float, int, int]:
    """Return the power with which a stage's time grows, from which size to which."""
    sizes = [n for n, done in measured.items() if stage in done]
    if len(sizes) < 2:
        return math.nan, 0, 0
    few, many = sizes[0], sizes[-1]
    return (math.log(measured[many][stage][0] / measured[few][stage][0]) / math.log(many / few),
            few, many)


if __name__ == "__main__":
    serve(int(sys.argv[1]))
