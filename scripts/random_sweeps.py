"""Errors and times of settings on random mechanisms: tables of docs/accuracy.md.

    python scripts/random_sweeps.py --seeds 0 4000 --rows rows.jsonl           # adds to the file
    python scripts/random_sweeps.py --rows rows.jsonl --page docs/accuracy.md  # the table
    python scripts/random_sweeps.py --simulate --seeds 0 400 --rows falls.jsonl

About every fourth seed of `fuzzing/generate.py` has a driver whose sweep is determined. One sweep
of each, short or long, of few or many values, tells at every setting whether `motion.error` is a
bound of the true error. The same sweep with 361 and with 1801 values tells times; `--bounds` leaves
them out. A thousand mechanisms take two hours, and half an hour without times. True errors are
those of samples that are refined in extended precision, which needs an x86 machine.

With `--simulate` each mechanism moves in time instead, from rest or with random speeds of its
drivers, for a part of a swing up to about three swings. True errors are those by a tight
integration, known to what others differ from it by. Two hundred mechanisms take a quarter of an
hour.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only wait
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from benchmark.pages import cells, power, put
from fuzzing.case import Case
from fuzzing.generate import make

import spatial_pin as sp
from spatial_pin.accuracy.reference import Astray, SimulationReference, SweepReference
from spatial_pin.accuracy.tasks import SHORTER, SWINGS, SimulationTask, SweepTask, Task, task_of
from spatial_pin.dynamics.simulation.result import growth_lines

ERRORS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-12)
ERRORS_IN_TIME = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
LEVELS = ("engineering", "reference")
SETTINGS = {
    kind: {**{power(e): sp.Accuracy.for_error(e, kind) for e in errors},
           **{name: sp.Accuracy.named(name) for name in levels}}
    for kind, errors, levels in (("sweep", ERRORS, LEVELS),
                                 ("simulate", ERRORS_IN_TIME, LEVELS[:1]))}
SIZES = (11, 37, 121, 361, 1801)  # numbers of values of a sweep whose bounds are judged
TIMED = (361, 1801)
RUNS = 9  # of which the least time counts
RUNS_IN_TIME = 3  # the same of simulations, which are longer
LONG = 0.5  # s that a simulation may take; longer ones are left out
GRAVITY = 9.81  # m/s², for the duration of those that have none
BETTER = 1.15  # ratio of times, and of errors, by which a setting beats another one
CURVED = 1e-6  # acceleration by the square of the velocity, below which a motion is uniform
NOTHING = 2.0**-52  # errors below it are round-off of one number

Row = dict[str, Any]


def sweep_of(seed: int, folder: Path) -> SweepTask | None:
    """Return a sweep of a random mechanism that stops short of its limits; None if it has none."""
    rng, spec = np.random.default_rng(seed + 10**7), make(seed)
    case = Case(spec, folder)
    if not spec["closures"] or not case.is_driven:
        return None
    mechanism = sp.load(str(case.path))
    state = sp.assemble(mechanism)

    def swept(driver: str, values: Any) -> sp.Motion:
        return sp.sweep(mechanism, driver, values, guess=state, on_limit="stop", on_crossing="stop")

    for driver in mechanism.drivers:
        start, is_angle = state.coordinate(driver).value, mechanism.coordinate(driver).unit == "rad"
        unit = 1.0 if is_angle else mechanism.characteristic_length
        few = swept(driver, start + np.linspace(0.0, 0.01, 3) * unit)
        v, a = (np.abs(x / mechanism.velocity_scale).max() for x in (few.v, few.a))
        if a * unit > CURVED * v * v * unit**2:
            break
    else:
        return None
    n, sense = int(rng.choice(SIZES)), rng.choice([1.0, 1.0, -1.0])
    values = start + np.linspace(0.0, sense * unit * 10 ** rng.uniform(-1.5, 0.8), n)
    reached = swept(driver, values)
    if len(reached) < 2:
        return None
    if len(reached) < n:
        part = rng.choice([0.5, 0.9, 0.99])
        values = np.linspace(start, start + part * (reached.driver[-1] - start), n)
    task = task_of(mechanism, {"driver": driver, "values": values,
                               "speed": float(10 ** rng.uniform(-1.0, 1.5))})
    assert isinstance(task, SweepTask)
    return task


def simulation_of(seed: int, folder: Path) -> SimulationTask | None:
    """Return a simulation of a random mechanism that ends by its duration; None if it stands."""
    rng, spec = np.random.default_rng(seed + 10**7), make(seed)
    case = Case(spec, folder)
    if not spec["closures"] or not case.is_driven or not any(spec["inertias"].values()):
        return None
    mechanism = sp.load(str(case.path))
    state, size = sp.assemble(mechanism), mechanism.characteristic_length
    pace = np.sqrt((np.linalg.norm(mechanism.model.gravity.linear) or GRAVITY) / size)
    speeds = {name: float(rng.choice([0.0, 0.3, 3.0]) * pace * rng.uniform(-1.0, 1.0)
                          * (1.0 if mechanism.coordinate(name).unit == "rad" else size))
              for name in mechanism.drivers}
    state = sp.solve_rates(mechanism, state, speeds)
    duration = SWINGS / pace * 10 ** rng.uniform(-1.0, 0.3)
    n = int(rng.choice(SIZES[:-1]))
    task = SimulationTask(mechanism, {"state": state})
    for part in (1.0, SHORTER):
        task.arguments.update(duration=part * duration, times=np.linspace(0.0, part * duration, n))
        clock = time.process_time()
        try:
            motion = task.run(sp.Accuracy.named("engineering"))
        except sp.SingularError as error:
            motion = error.motion
        if time.process_time() - clock > LONG:
            raise Astray(f"takes {time.process_time() - clock:.1f} s")
        if motion is None or len(motion) < 2:
            return None
        if len(motion) == n:
            break
        duration = float(motion.time[-1])
    moves = np.abs(motion.v / mechanism.velocity_scale).max() > CURVED * pace
    return task if moves and len(motion) == n else None


def judged(task: Task, runs: int) -> Row:
    """Return true errors, estimates and least times of a motion at every setting."""
    reference = (SweepReference if isinstance(task, SweepTask) else SimulationReference)(task)
    settings = SETTINGS[task.kind]
    seconds = {name: np.full(2, np.inf) for name in settings}  # of the motion, and of its error
    rng = np.random.default_rng(0)
    row: Row = {"n": reference.n, "known": reference.error, "settings": {}}
    for _ in range(runs):
        for name in rng.permutation([*settings]).tolist():
            clock = [time.process_time()]
            motion = task.run(settings[name])
            clock.append(time.process_time())
            estimate = list(motion.error[:3])
            clock.append(time.process_time())
            seconds[name] = np.minimum(seconds[name], np.diff(clock))
            if name not in row["settings"]:
                scale = task.mechanism.velocity_scale
                v, a = (float(np.abs(x / scale).max()) for x in (motion.v, motion.a))
                errors = reference.judge(motion)
                sizes = 1.0, v or 1.0, max(a, 0.01 * v * v) or 1.0  # as those of `motion.error`
                true = [x / size for x, size in zip(errors[1:4], sizes, strict=True)]
                row["settings"][name] = {"true": true, "estimate": estimate}
                if isinstance(motion, sp.Simulation):
                    row["settings"][name]["is_unstable"] = bool(growth_lines(motion))
    for name, one in row["settings"].items():
        one["seconds"], one["error_seconds"] = seconds[name].tolist()
    return row


def rows_of(seed: int, has_times: bool, in_time: bool) -> Iterable[Row]:
    """Yield what is measured of a seed: one row, and with times one of each number of values."""
    with tempfile.TemporaryDirectory() as folder:
        if in_time:
            fall = simulation_of(seed, Path(folder))
            if fall is not None:
                yield {"seed": seed, **judged(fall, RUNS_IN_TIME)}
            return
        task = sweep_of(seed, Path(folder))
        if task is None:
            return
        values = task.arguments["values"]
        yield {"seed": seed, "is_timed": False, **judged(task, 1)}
        for n in TIMED if has_times else ():
            again = np.linspace(values[0], values[-1], n)
            longer = replace(task, arguments={**task.arguments, "values": again})
            yield {"seed": seed, "is_timed": True, **judged(longer, RUNS)}


def percent(holds: Any) -> str:
    return f"{100 * np.mean(holds):.1f} %"


def compared(
    name: str, true: Any, estimate: Any, digits: int, unstable: Any = None
) -> list[str]:
    """Return cells of a setting that compare true errors (N, 3) with those allowed and estimated.

    Where motions may be unstable (N,), one cell more takes those that say so for kept.
    """
    floored = np.maximum(true, NOTHING)
    largest, allowed = floored.max(axis=1), np.nan if name in LEVELS else float(name)
    kept = [largest <= allowed]
    if unstable is not None:
        kept.append(kept[0] | unstable)
    promise = ["-"] * (1 + len(kept)) if name in LEVELS else [
        f"{np.median(allowed / largest):.0f}", *map(percent, kept)]
    told = np.median(estimate.max(axis=1) / largest)
    return [*promise, percent((true <= estimate).all(axis=1)), f"{told:.{digits}f}",
            f"{(estimate / floored).min():.2g}"]


def table_in_time(rows: Sequence[Row]) -> list[str]:
    """Return the table of simulations: a line for each setting.

    True errors are less by what the reference is off by itself.
    """
    lines = [cells("allowed error", "time", "allowed by true error", "kept", "kept, or unstable",
                   "estimate is a bound", "by true error", "least"), cells(*["---"] * 8)]
    for name in SETTINGS["simulate"]:
        ones = [row["settings"][name] for row in rows]
        known = np.array([row["known"] for row in rows])[:, None]
        true, estimate = (np.array([one[key] for one in ones]) for key in ("true", "estimate"))
        relative = [one["seconds"] / row["settings"]["engineering"]["seconds"]
                    for one, row in zip(ones, rows, strict=True)]
        lines.append(cells(name, f"{np.median(relative):.2f}", *compared(
            name, true - known, estimate, 1, np.array([one["is_unstable"] for one in ones]))))
    return [*lines, cells(f"{len(rows)} simulations", *[""] * 7)]


def times(rows: Sequence[Row], name: str) -> list[str]:
    """Return cells of sweeps of one length, for a setting.

    They are the time by that of "engineering", the part that `motion.error` takes beside it, and
    how often a setting beats it in time and error.
    """
    if not rows:
        return ["", "", ""]
    relative, beaten, more = [], 0, []
    for row in rows:
        own, base = row["settings"][name], row["settings"]["engineering"]
        relative.append(own["seconds"] / base["seconds"])
        more.append(own["error_seconds"] / own["seconds"])
        beaten += any(BETTER * x["seconds"] < own["seconds"]
                      and BETTER * max(*x["true"], NOTHING) < max(own["true"])
                      for x in row["settings"].values())
    return [f"{np.median(relative):.2f}", f"{np.median(more):.2f}",
            f"{100 * beaten / len(rows):.0f} %"]


def table(rows: Sequence[Row]) -> list[str]:
    """Return the table of the page: a line for each setting."""
    bounds = [row for row in rows if not row["is_timed"]]
    by_size = [[row for row in rows if row["is_timed"] and row["n"] == n] for n in TIMED]
    timed = [x for n in TIMED for x in (f"time, {n} values", "`error`", "beaten")]
    lines = [cells("allowed error", *timed, "allowed by true error", "kept", "estimate is a bound",
                   "by true error", "least"),
             cells(*["---"] * 12)]
    for name in SETTINGS["sweep"]:
        ones = [row["settings"][name] for row in bounds]
        true, estimate = (np.array([one[key] for one in ones]) for key in ("true", "estimate"))
        lines.append(cells(name, *(x for part in by_size for x in times(part, name)),
                           *compared(name, true, estimate, 0)))
    return [*lines, cells(f"{len(bounds)} sweeps", *[""] * 11)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", nargs=2, type=int, metavar=("FIRST", "END"), help="to measure")
    parser.add_argument("--rows", type=Path, required=True, metavar="F",
                        help="where rows are added, and the table is made from")
    parser.add_argument("--bounds", action="store_true", help="no times, which take most of it")
    parser.add_argument("--simulate", action="store_true", help="simulations instead of sweeps")
    parser.add_argument("--page", type=Path, metavar="F", help="write the table there")
    options = parser.parse_args()
    for seed in range(*options.seeds) if options.seeds else ():
        try:
            lines = [json.dumps(row) + "\n" for row in rows_of(
                seed, not options.bounds, options.simulate)]
        except (sp.SpatialPinError, Astray, ValueError) as error:
            print(f"{seed} left out: {type(error).__name__}: {error}"[:120], flush=True)
            continue
        with options.rows.open("a", encoding="utf-8") as file:
            file.writelines(lines)
    known = options.rows.read_text(encoding="utf-8").splitlines()
    lines = (table_in_time if options.simulate else table)([json.loads(line) for line in known])
    print("\n".join(lines))
    if options.page:
        put(options.page, "random in time" if options.simulate else "random", lines)


if __name__ == "__main__":
    main()
