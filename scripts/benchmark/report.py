"""The table, and old results beside new ones."""

from __future__ import annotations

import math
import os
import platform
import statistics
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmark.case import FACTORS, TASKS

WIDTH = 78  # of a row's name
OWN, HAND = "spatial_pin", "Pinocchio by hand"


def machine() -> dict[str, Any]:
    """Return processor, cores and Python."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [x for x in info.read_text().splitlines() if x.startswith("model name")]
        model = lines[0].partition(":")[2].strip() if lines else model
    return {"cpu": model, "cores": os.cpu_count(), "python": platform.python_version(),
            "system": platform.platform()}


def table(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a report."""
    host = report["machine"]
    yield (f"{report['date']}; {host['cpu']}, {host['cores']} cores, Python {host['python']}; "
           + ", ".join(f"{name} {version}" for name, version in report["versions"].items()))
    yield ("rows of a task took turns; times: least and median, by the "
           f"{report['effort']['clock']} clock; errors: the largest")
    for name, task in TASKS.items():
        rows = [r for r in report["rows"].values() if r["task"] == name]
        sizes = sorted({row["size"] for row in rows})
        for size in sizes:
            yield ""
            yield (f"{task.title.format(size)} [{task.unit}]".ljust(WIDTH)
                   + f"{'least':>9} {'median':>9} {'n':>3}  "
                   + " ".join(f"{e:>8}" for e in task.errors))
            yield from (line(row) for row in rows if row["size"] == size)
        if rows and task.note:
            yield f"  errors: {task.note}"
        absent = [a for a in report["absent"] if a[0] == name]
        yield from (f"  {tool}: {why}" for _, tool, why in absent)
        reported = {row["tool"] for row in rows} | {tool for _, tool, _ in absent}
        silent = [tool for tool in report["tools"] if tool not in reported]
        if rows and silent and task.errors:
            yield f"  no row written: {', '.join(silent)}"


def line(row: Mapping[str, Any]) -> str:
    """Return one row."""
    task, factor = TASKS[row["task"]], FACTORS[TASKS[row["task"]].unit]
    errors = (row["errors"].get(name) for name in task.errors)
    return (f"  {row['tool']}: {row['how']}".ljust(WIDTH)
            + f"{factor * row['least']:9.4g} {factor * row['median']:9.4g} "
            + f"{len(row['seconds']):3d}  "
            + " ".join(f"{'-':>8}" if e is None else f"{e:8.0e}" for e in errors))


def key(task: str, size: int, how: str, tool: str = OWN) -> str:
    """Return the key of a row."""
    return " / ".join((task, str(size), tool, how))


# ---------------------------------------------------------------- old beside new


def changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """Yield old and new times, row by row; mark what moved beyond the spread of both.

    The last number is the change of the least time by that of the task's other tools, which tells
    the code from the machine.
    """
    clocks = [report["effort"]["clock"] for report in (old, new)]
    yield ""
    yield (f"new / old ({old['date']}, {old['machine']['cpu']})".ljust(WIDTH)
           + f"{'least':>9} {'median':>9} {'to others':>9}")
    if clocks[0] != clocks[1]:
        yield f"  the old times are by the {clocks[0]} clock, the new by the {clocks[1]} clock"
    both = {name: (old["rows"][name], row) for name, row in new["rows"].items()
            if name in old["rows"]}
    others = {task: statistics.median(ratios) for task in TASKS if (ratios := [
        row["least"] / was["least"] for was, row in both.values()
        if row["task"] == task and row["tool"] != OWN])}
    for name, (was, row) in both.items():
        least, median = (row[w] / was[w] for w in ("least", "median"))
        relative = least / others[row["task"]] if row["task"] in others else math.nan
        yield (f"  {name}".ljust(WIDTH) + f"{least:9.2f} {median:9.2f} {relative:9.2f}  "
               + moved(was["seconds"], row["seconds"]) + worse(was["errors"], row["errors"])
               ).rstrip()
    yield from (f"  {name}".ljust(WIDTH) + "  new" for name in new["rows"] if name not in both)
    yield from (f"  {name}".ljust(WIDTH) + "  gone" for name in old["rows"] if name not in both)


def quartiles(samples: list[float]) -> tuple[float, float]:
    """Return the ends of the middle half of samples."""
    if len(samples) < 2:
        return samples[0], samples[0]
    low, _, high = statistics.quantiles(samples, n=4, method="inclusive")
    return low, high


def moved(old: list[float], new: list[float]) -> str:
    """Return "SLOWER" or "faster" where the middle halves lie apart and the least times agree."""
    (old_low, old_high), (new_low, new_high) = quartiles(old), quartiles(new)
    if new_low > old_high and min(new) > 1.05 * min(old):
        return "SLOWER "
    if new_high < old_low and min(new) < 0.95 * min(old):
        return "faster "
    return ""


def worse(old: Mapping[str, float | None], new: Mapping[str, float | None]) -> str:
    """Return which errors grew tenfold, above round-off."""
    grown = []
    for name, value in new.items():
        before = old.get(name)
        if value is not None and before is not None and value > max(10.0 * before, 1e-13):
            grown.append(f"{name} {before:.0e} -> {value:.0e}")
    return f"LESS EXACT: {', '.join(grown)}" if grown else ""
