"""Forward dynamics through Pinocchio's constraintDynamics and through our rows, side by side.

For every mechanism of the library whose closures Pinocchio can express, and for longer and longer
ladders: time of the public `forward_dynamics` both ways, of the bare call below it, and by how much
the accelerations differ. `dynamics/native.py` takes its limits from here.

    python scripts/native_dynamics.py [--repeats 60] [--loops 1 5 10 20] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only get in the way

import numpy as np
import pinocchio as pin
from bench_dynamics import ladder

import spatial_pin as sp
from spatial_pin.dynamics.equations import equations_of
from spatial_pin.dynamics.native import NativeDynamics, native_models
from spatial_pin.linalg import independent_rows

CALLS = 10  # in one measurement; the least of many is what a quiet machine takes


def seconds(call: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    for _ in range(CALLS):
        call()
    return (time.perf_counter() - begin) / CALLS


def compare(mechanism: sp.Mechanism, state: sp.State, repeats: int) -> dict[str, Any] | None:
    """Measure one mechanism, the ways in turns; None if Pinocchio cannot express it."""
    scaled = sp.closure_jacobian(mechanism, state.q) * mechanism.velocity_scale
    try:
        models = native_models(mechanism)
    except sp.ClosureTypeError:
        return None
    if not models:
        return None
    native = NativeDynamics(mechanism, models, len(independent_rows(scaled)))
    none = np.zeros(mechanism.model.nv)

    def taking(which: NativeDynamics | None) -> Callable[[], Any]:
        def run() -> Any:
            with equations_of(mechanism) as equations:
                equations.asked, equations.native = True, which
            return sp.forward_dynamics(mechanism, state)
        return run

    ways = {"bare": lambda: pin.constraintDynamics(
                native.model, native.data, state.q, state.v, none, native.models, native.datas,
                native.settings),
            "checked": lambda: native.accelerations(state.q, state.v, none),
            "public": taking(native), "rows": taking(None)}
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, call in ways.items():
            times[name].append(seconds(call))
    ours, theirs = ways["rows"]().a, ways["checked"]()
    differ = (float(np.abs(ours - theirs).max() / np.abs(ours).max(initial=1e-300))
              if theirs is not None else float("nan"))
    return {"name": mechanism.name, "freedoms": mechanism.model.nv,
            "rows": sum(m.residualSize() for m in models), "difference": differ,
            **{f"{name}_us": 1e6 * min(t) for name, t in times.items()}}


def leaning(windows: int, folder: Path) -> tuple[sp.Mechanism, sp.State]:
    mechanism, angle = ladder(windows, folder), 0.5
    guess = ({f"pin_{i}": -angle for i in range(windows + 1)}
             | {f"top_{i}": angle for i in range(windows)})
    state = sp.assemble(mechanism, {"pin_0": -angle}, guess)
    return mechanism, sp.solve_rates(mechanism, state, {"pin_0": -1.0})


def main() -> None:
    """Measure, print, save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--loops", type=int, nargs="*", default=[1, 5, 10, 20])
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    found = []
    print(f"{'':22s} freedoms  rows |     bare  checked   public | by our rows   differ   [us]")
    with tempfile.TemporaryDirectory() as folder:
        cases = [*sp.list_mechanisms(), *options.loops]
        for case in cases:
            if isinstance(case, int):
                mechanism, state = leaning(case, Path(folder))
            else:
                mechanism = sp.load(case)
                state = sp.solve_rates(mechanism, sp.assemble(mechanism, {}),
                                       dict.fromkeys(mechanism.drivers, 0.7))
            row = compare(mechanism, state, options.repeats)
            if row is None:
                continue
            found.append(row)
            name = f"{case} windows" if isinstance(case, int) else case
            print(f"{name:22s} {row['freedoms']:8d} {row['rows']:5d} | {row['bare_us']:8.1f} "
                  f"{row['checked_us']:8.1f} {row['public_us']:8.1f} | {row['rows_us']:11.1f} "
                  f"{row['difference']:8.0e}")
    if options.json:
        Path(options.json).write_text(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
