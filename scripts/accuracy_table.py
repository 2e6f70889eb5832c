"""The table behind `Accuracy.for_error`: errors and times of settings on every mechanism.

    python scripts/accuracy_table.py                  # both tasks, some ten minutes
    python scripts/accuracy_table.py --task sweep --only rssr stewart

Every mechanism with loops does its usual move (`sp.tradeoff(mech, "sweep")`: one turn of the first
driver, 361 values) and swings a few seconds under gravity (`"simulate"`). Only settings that watch
their error themselves are tried, and none that creeps where a motion is stiff: corrections to a
tolerance, and the integrator that takes another one there; implicit ones alone take ten times as
long. Of each, the largest error over all mechanisms is
taken, times `MARGIN` (`MARGIN_LEAST` where only round-off of a sweep is left), and the shortest
time that it has taken, by that of "engineering", in geometric mean. Settings that fail on a
mechanism are left out, and so are those that another one beats in both. What is left is printed as
`MEASURED` in `spatial_pin/settings.py`.
Motions that no setting is known to follow to `HOPELESS` (through singular configurations) are left
out, and named, and so are those whose errors grow by more than `UNSTABLE` in time: that of
"engineering" relative to its tolerance.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import spatial_pin as sp
from spatial_pin.accuracy.tasks import describe, simulation_settings, sweep_settings
from spatial_pin.accuracy.tradeoff import ROUND_OFF, pareto, tradeoff

REPEATS = 15  # runs of each setting, of which the shortest counts, if the budget allows them
MARGIN = {"sweep": 10.0, "simulate": 2.0}  # by which a promise exceeds the largest error
MARGIN_LEAST = 3.0  # the same of a sweep's that no setting makes smaller: round-off
LARGEST = 0.1  # error that is worth a promise
HOPELESS = {"sweep": 1e-11, "simulate": 1e-9}  # best error above which the motion is to blame
UNSTABLE = 1e3  # growth of errors in a simulation above which it is, too
BASE = sp.Accuracy.named("engineering")
SAME = {"sweep": ("order", "corrections", "tolerance"),
        "simulate": tuple(f.name for f in fields(sp.Accuracy))}  # fields that distinguish settings

Table = dict[str, Any]  # a trade-off as plain data


class Entry(NamedTuple):
    """A setting over all mechanisms.

    Attributes:
        accuracy: the setting.
        error: largest error that was measured.
        where: on which mechanism.
        time: shortest time by that of BASE, geometric mean.
        failed: mechanisms on which it fails.
    """

    accuracy: sp.Accuracy
    error: float
    where: str
    time: float
    failed: list[str]


def candidates(task: str) -> list[sp.Accuracy]:
    """Return the settings that watch their own error; none that creeps where a motion is stiff."""
    if task == "sweep":
        return [a for a in sweep_settings() if a.corrections is None and a.order]
    return list(dict.fromkeys(
        replace(a, integrator="automatic") for a in simulation_settings(1.0)
        if a.integrator in ("automatic", "DOP853") and a.formulation == "independent"))


def measured(task: str, names: Iterable[str], budget: float) -> list[Table]:
    """Return the trade-offs of mechanisms with loops; prints those without such a task."""
    rows = []
    for name in names:
        mechanism = sp.load(name)
        if not mechanism.closures:
            continue
        try:
            rows.append(tradeoff(mechanism, task, settings=candidates(task), repeats=REPEATS,
                                 budget=budget, progress=True).as_dict())
        except sp.SpatialPinError as error:
            print(f"# {name} left out: {error}")
    return rows


def known_error(table: Table, row: Table) -> float:
    """Return the error of a row as far as it is known; infinite where it failed."""
    if row["error"] is None:
        return math.inf
    return max(row["error"], table["reference_error"], ROUND_OFF)


def shortest(row: Table) -> float:
    """Return the time of the run that other programs have delayed least; infinite if it failed."""
    return math.inf if row["error"] is None else min(row["seconds"])


def base_row(task: str, table: Table) -> Table:
    """Return the row of BASE."""
    return next(row for row in table["rows"]
                if all(row["accuracy"][key] == getattr(BASE, key) for key in SAME[task]))


def is_hopeless(task: str, table: Table) -> bool:
    """Whether the motion, not the settings, is to blame for the errors."""
    best = min(known_error(table, row) for row in table["rows"])
    grown = known_error(table, base_row(task, table)) / BASE.time_tolerance
    return best > HOPELESS[task] or (task == "simulate" and grown > UNSTABLE)


def useful(task: str, tables: list[Table]) -> list[Table]:
    """Return the tables of motions that any setting can follow; prints the others."""
    for table in tables:
        if is_hopeless(task, table):
            print(f"# {table['mechanism']} left out: unstable, or near a singular configuration")
    return [table for table in tables if not is_hopeless(task, table)]


def entries(task: str, tables: list[Table]) -> list[Entry]:
    """Return every setting over all mechanisms, the fastest first."""
    rows: dict[sp.Accuracy, dict[str, tuple[float, float]]] = {}
    for table in tables:
        base = shortest(base_row(task, table))
        for row in table["rows"]:
            rows.setdefault(sp.Accuracy(**row["accuracy"]), {})[table["mechanism"]] = (
                known_error(table, row), shortest(row) / base)
    lines = []
    for accuracy, by_name in rows.items():
        good = {name: x for name, x in by_name.items() if math.isfinite(x[0])}
        where = max(good, key=lambda name: good[name][0], default="")
        time = float(np.exp(np.mean([math.log(x[1]) for x in good.values()] or [math.inf])))
        lines.append(Entry(accuracy, good[where][0] if where else math.inf, where, time,
                           sorted(set(by_name) - set(good))))
    return sorted(lines, key=lambda entry: entry.time)


def promised(task: str, error: float, least: float) -> float:
    """Return the margin times an error, rounded up to one digit, with the least of all settings."""
    most = (MARGIN_LEAST if error <= least else MARGIN[task]) * error
    size = 10.0 ** math.floor(math.log10(most))
    return float(f"{math.ceil(most / size * (1 - 1e-12)) * size:.0e}")


def chosen(task: str, table: list[Entry]) -> list[tuple[float, sp.Accuracy]]:
    """Return promise and setting where it works everywhere, is not beaten, and worth a promise."""
    good = [entry for entry in table if not entry.failed]
    least = min((entry.error for entry in good), default=0.0) if task == "sweep" else 0.0
    choices = [(entry.time, promised(task, entry.error, least), entry.accuracy) for entry in good]
    choices = [entry for entry in choices if entry[1] <= LARGEST]
    flags = pareto([time for time, *_ in choices], [error for _, error, _ in choices])
    return [(error, accuracy) for (_, error, accuracy), flag in zip(choices, flags, strict=True)
            if flag]


def literal(accuracy: sp.Accuracy) -> str:
    """Return the setting as Python text, without its defaults."""
    arguments = [f"{f.name}={getattr(accuracy, f.name)!r}" for f in fields(accuracy)
                 if getattr(accuracy, f.name) != f.default]
    return f"Accuracy({', '.join(arguments)})".replace("'", '"')


def report(task: str, tables: list[Table]) -> list[str]:
    """Return all settings as text, then the entries of MEASURED."""
    table = entries(task, tables)
    lines = [f"# {task}: {len(tables)} mechanisms; the references are good to "
             f"{max(t['reference_error'] for t in tables):.0e} at least"]
    for entry in table:
        bad = f"  fails on {', '.join(entry.failed)}" if entry.failed else ""
        lines.append(f"# {describe(entry.accuracy, task):30} time {entry.time:5.2f}  error "
                     f"{entry.error:.1e} ({entry.where}){bad}")
    lines.append(f'    "{task}": (')
    lines += [f"        ({error!r}, {literal(setting)})," for error, setting in chosen(task, table)]
    return [*lines, "    ),"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=("sweep", "simulate"))
    parser.add_argument("--only", nargs="+", metavar="M", help="mechanisms (all with loops)")
    parser.add_argument("--budget", type=float, default=15.0,
                        help="seconds a mechanism and task after which no run is repeated (15)")
    parser.add_argument("--json", metavar="F", help="write all trade-offs")
    parser.add_argument("--read", metavar="F", help="read what --json wrote instead of measuring")
    options = parser.parse_args()
    known = json.loads(Path(options.read).read_text(encoding="utf-8")) if options.read else {}
    for task in [options.task] if options.task else ["sweep", "simulate"]:
        if not options.read:
            known[task] = measured(task, options.only or sp.list_mechanisms(), options.budget)
        print("\n".join(report(task, useful(task, known[task]))), flush=True)
    if options.json:
        Path(options.json).write_text(json.dumps(known, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
