"""The table, the bars, and old results beside new ones."""

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
        told = {row["tool"] for row in rows} | {tool for _, tool, _ in absent}
        silent = [tool for tool in report["tools"] if tool not in told]
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


# ---------------------------------------------------------------- the bars


def bars(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield what was promised beside what was measured, by medians of one run."""
    rows = report["rows"]
    measured = {row["task"] for row in rows.values()}
    found = [text for task, text in promised(rows) if task in measured]
    if found:
        yield from ("", "bars, by medians (least times in brackets)", *found)


def promised(rows: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield task and line of each bar."""
    ours, tuned = key("sweep", 360, "sweep"), key("sweep", 360, "tuned", HAND)
    yield "sweep", ratio(rows, "RSSR, 360 values, to the hand-tuned Pinocchio loop", 1.5,
                         ours, tuned)
    many = key("sweep", 3600, "sweep")
    yield "sweep", at_most(rows, "RSSR, 3600 values with rates [µs a value]", 5.0, many, 1e6)
    yield "sweep", ahead(rows, "sweep", 3600)
    for n in (360, 3600):
        ours = key("reduced", n, "sweep of reduce(mechanism, outputs)")
        tuned = key("reduced", n, "the distance equation, tuned", "by hand")
        yield "reduced", ratio(rows, f"reduced RSSR to its one equation by hand, {n} values", 1.5,
                               ours, tuned)
    ours = key("a02", 0, "simulate, engineering")
    tuned = key("a02", 0, "one equation, SciPy DOP853 at 4e-12", "by hand")
    yield "a02", ratio(rows, "A02 to one equation by DOP853 at the same error", 5.0, ours, tuned)
    yield "forward", ratio(rows, "forward dynamics, 200 loops to 1", 300.0,
                           forward(200), forward(1))
    yield "forward", exponent(rows)


def key(task: str, size: int, how: str, tool: str = OWN) -> str:
    """Return the key of a row."""
    return " / ".join((task, str(size), tool, how))


def forward(loops: int) -> str:
    """Return the key of our forward dynamics."""
    return key("forward", loops, "forward_dynamics, reactions too")


def verdict(value: float, bar: float) -> str:
    """Return a value beside its bar."""
    return f"{value:.3g} (bar {bar:g}) {'met' if value <= bar else 'NOT MET'}"


def ratio(rows: Mapping[str, Any], title: str, bar: float, one: str, other: str) -> str:
    """Return a line with the ratio of two rows."""
    missing = [k for k in (one, other) if k not in rows]
    if missing:
        return f"  {title}: not measured: {missing[0]}"
    median, least = (rows[one][w] / rows[other][w] for w in ("median", "least"))
    return f"  {title}: {verdict(median, bar)} [{least:.3g}]"


def at_most(rows: Mapping[str, Any], title: str, bar: float, row: str, factor: float) -> str:
    """Return a line with the time of a row."""
    if row not in rows:
        return f"  {title}: not measured"
    return (f"  {title}: {verdict(factor * rows[row]['median'], bar)} "
            f"[{factor * rows[row]['least']:.3g}]")


def ahead(rows: Mapping[str, Any], task: str, size: int) -> str:
    """Return a line that names the fastest other row that gives rates too, and how we stand."""
    own = key(task, size, "sweep")
    others = [r for r in rows.values() if r["task"] == task and r["size"] == size
              and r["tool"] != OWN and r["errors"].get("ψ''") is not None]
    if own not in rows or not others:
        return "  sweep against peers: not measured"
    best = min(others, key=lambda r: r["median"])
    value = rows[own]["median"] / best["median"]
    return (f"  {size} values to the fastest other, {best['tool']}, {best['how']}: "
            f"{verdict(value, 1.0)} [{rows[own]['least'] / best['least']:.3g}]")


def exponent(rows: Mapping[str, Any]) -> str:
    """Return a line with the growth of forward dynamics from 50 loops to 500."""
    title = "forward dynamics, growth exponent from 50 to 500 loops"
    few, many = forward(50), forward(500)
    if few not in rows or many not in rows:
        return f"  {title}: not measured"
    grown = {w: math.log(rows[many][w] / rows[few][w]) / math.log(10.0) for w in (
        "median", "least")}
    return f"  {title}: {verdict(grown['median'], 1.2)} [{grown['least']:.3g}]"


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
    others = {task: statistics.median(found) for task in TASKS if (found := [
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
