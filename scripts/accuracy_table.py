"""The table behind `Accuracy.for_error`: what settings reach on every mechanism of the library.

    python scripts/accuracy_table.py                  # both tasks, some ten minutes
    python scripts/accuracy_table.py --task sweep --only rssr stewart

Every mechanism with loops does its usual move (`sp.tradeoff(mech, "sweep")`: one turn of the first
driver, 361 values) and swings a few seconds under gravity (`"simulate"`). Only settings that watch
their error themselves are tried: corrections to a tolerance, integrators that choose their step.
Of each, the largest error over all mechanisms is taken, times `MARGIN`, and the time by that of
"engineering", in geometric mean. Settings that fail on a mechanism are left out, and so are those
that another one beats in both. What is left is printed as `MEASURED` in `spatial_pin/settings.py`.
Sweeps that pass so near a singular configuration that no setting is better than `HOPELESS` are
left out; they are named.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import spatial_pin as sp
from spatial_pin.accuracy.grid import describe, simulation_settings, sweep_settings
from spatial_pin.accuracy.tradeoff import Tradeoff, pareto, tradeoff

MARGIN = 10.0  # by which the promised error exceeds the largest that was measured
HOPELESS = 1e-11  # least error of a sweep above which it is the mechanism, not the setting
BASE = sp.Accuracy.named("engineering")


class Entry(NamedTuple):
    """A setting over all mechanisms.

    Attributes:
        accuracy: the setting.
        error: largest error that was measured.
        where: on which mechanism.
        time: time by that of BASE, geometric mean.
        failed: mechanisms on which it fails.
    """

    accuracy: sp.Accuracy
    error: float
    where: str
    time: float
    failed: list[str]


def candidates(task: str) -> list[sp.Accuracy]:
    """Return the settings that watch their own error."""
    if task == "sweep":
        return [a for a in sweep_settings() if a.corrections is None and a.order]
    return [a for a in simulation_settings(1.0) if a.step is None]


def measured(task: str, names: Iterable[str], budget: float) -> list[Tradeoff]:
    """Return the trade-offs of mechanisms; says which have no such task."""
    found = []
    for name in names:
        mechanism = sp.load(name)
        if not mechanism.closures:
            continue
        try:
            one = tradeoff(mechanism, task, settings=candidates(task), repeats=3, budget=budget,
                           progress=True)
        except sp.SpatialPinError as error:
            print(f"# {name} left out: {error}")
            continue
        best = min(one.known_error(row) for row in one.front)
        if task == "sweep" and best > HOPELESS:
            print(f"# {name} left out: near a singular configuration, best error {best:.1e}")
            continue
        found.append(one)
    return found


def entries(task: str, found: list[Tradeoff]) -> list[Entry]:
    """Return every setting over all mechanisms, the fastest first."""
    table = []
    for accuracy in candidates(task):
        rows = {t.mechanism: (t, row) for t in found for row in t.rows if row.accuracy == accuracy}
        failed = [name for name, (_, row) in rows.items() if row.errors is None]
        errors = {name: t.known_error(row) for name, (t, row) in rows.items() if row.errors}
        bases = {t.mechanism: row.time_per_step for t in found for row in t.rows
                 if row.accuracy == BASE and row.errors}
        ratios = [row.time_per_step / bases[name] for name, (_, row) in rows.items()
                  if row.errors and name in bases]
        where = max(errors, key=lambda name: errors[name], default="")
        time = float(np.exp(np.mean(np.log(ratios)))) if ratios else math.inf
        table.append(Entry(accuracy, errors.get(where, math.inf), where, time, failed))
    return sorted(table, key=lambda entry: entry.time)


def promised(error: float) -> float:
    """Return the margin times an error, rounded up to one digit."""
    size = 10.0 ** math.floor(math.log10(MARGIN * error))
    return float(f"{math.ceil(MARGIN * error / size * (1 - 1e-12)) * size:.0e}")


def chosen(table: list[Entry]) -> list[Entry]:
    """Return the entries that work everywhere and are not beaten."""
    good = [entry for entry in table if not entry.failed and math.isfinite(entry.error)]
    flags = pareto([e.time for e in good], [promised(e.error) for e in good])
    return [entry for entry, flag in zip(good, flags, strict=True) if flag]


def literal(accuracy: sp.Accuracy) -> str:
    """Return the setting as Python text, without its defaults."""
    said = [f"{f.name}={getattr(accuracy, f.name)!r}" for f in fields(accuracy)
            if getattr(accuracy, f.name) != f.default]
    return f"Accuracy({', '.join(said)})"


def report(task: str, found: list[Tradeoff], table: list[Entry]) -> list[str]:
    """Return all settings as text, then the entries of MEASURED."""
    lines = [f"# {task}: {len(found)} mechanisms; the references are good to "
             f"{max(t.reference_error for t in found):.0e} at least"]
    for entry in table:
        bad = f"  fails on {', '.join(entry.failed)}" if entry.failed else ""
        lines.append(f"# {describe(entry.accuracy, task):40} time {entry.time:5.2f}  error "
                     f"{entry.error:.1e} ({entry.where}){bad}")
    lines.append(f'    "{task}": (')
    lines += [f"        ({promised(entry.error)!r}, {literal(entry.accuracy)}),"
              for entry in chosen(table)]
    return [*lines, "    ),"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=("sweep", "simulate"))
    parser.add_argument("--only", nargs="+", metavar="M", help="mechanisms (all with loops)")
    parser.add_argument("--budget", type=float, default=15.0,
                        help="seconds a mechanism and task after which no run is repeated (15)")
    parser.add_argument("--json", metavar="F", help="write all trade-offs")
    options = parser.parse_args()
    everything: dict[str, Any] = {}
    for task in [options.task] if options.task else ["sweep", "simulate"]:
        found = measured(task, options.only or sp.list_mechanisms(), options.budget)
        print("\n".join(report(task, found, entries(task, found))), flush=True)
        everything[task] = [t.as_dict() for t in found]
    if options.json:
        Path(options.json).write_text(json.dumps(everything, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
