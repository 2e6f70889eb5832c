"""A trade-off as a table and as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatial_pin._support.output_files import literal, save_figure
from spatial_pin.accuracy.tasks import describe
from spatial_pin.accuracy.tradeoff import Measured, Tradeoff

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PARTS = ("closure", "position", "velocity", "acceleration", "spin")  # columns of parts of the error
SAID = 100  # characters of a setting's description in the figure, as many as in the table
INK, FAINT = "#2b3138", "#d5d9de"
APART = 2.5  # ratio of two errors whose labels are one line of text apart in the figure
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a939c")
MARKERS = "osD^vPX<>"  # more than colours, so that pairs repeat late


# ---------------------------------------------------------------- table


def table(tradeoff: Tradeoff, is_narrow: bool = False) -> str:
    """Return the rows in columns, the Pareto front marked with *.

    Args:
        tradeoff: the measured table.
        is_narrow: whether parts of the errors are left out, so that it fits a terminal.
    """
    good = [row for row in tradeoff.rows if row.errors is not None]
    lines = cells(tradeoff, merged(good, tradeoff.kind))
    if is_narrow:
        columns = [k for k, head in enumerate(lines[0]) if head not in PARTS]
        lines = [[line[k] for k in columns] for line in lines]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = [f"{tradeoff.mechanism}: {tradeoff.task}", f"reference: {tradeoff.reference}"]
    text += ["  ".join([line[0].ljust(widths[0]),
                        *(x.rjust(w) for x, w in zip(line[1:], widths[1:], strict=True))]).rstrip()
             for line in lines]
    runs = sorted({len(row.seconds) for row in good})
    notes = ["time: by that of engineering, the least of all runs; keeps e =: error that for_error "
             "relies on; (+n): n settings more, as fast within the scatter and less exact; "
             f"*: no other is as fast and as exact; ±: between the quartiles of "
             f"{' to '.join(map(str, runs[:: max(len(runs) - 1, 1)]))} runs; errors in rad and "
             "characteristic lengths, error: the largest, rates relative to the largest rate"]
    if any(row.error < tradeoff.reference_error for row in good):
        notes.append("<: smaller than the reference's own error")
    text += notes
    remarks = [row for row in tradeoff.rows if row.errors is None or row.note]
    text += [f"{describe(row.accuracy, tradeoff.kind)}: {'failed: ' * (row.errors is None)}"
             f"{row.note if len(row.note) <= SAID else row.note[: SAID - 3] + '...'}"
             for row in remarks]
    return "\n".join(text)


def merged(rows: list[Measured], kind: str) -> list[tuple[Measured, int]]:
    """Return rows without those as fast as a more exact one, with how many each stands for.

    Two are as fast where the quartiles of their times overlap. The front and the levels stay.
    """
    distinct: list[tuple[Measured, int]] = []
    for row in sorted(rows, key=lambda x: x.error):
        own = np.percentile(row.seconds, [25, 75])
        for k, (other, n) in enumerate(distinct):
            its = np.percentile(other.seconds, [25, 75])
            stays = row.on_front or describe(row.accuracy, kind).endswith(")")
            if own[0] <= its[1] and its[0] <= own[1] and not stays:
                distinct[k] = other, n + 1
                break
        else:
            distinct.append((row, 0))
    return sorted(distinct, key=lambda x: x[0].time_per_step)


def cells(
    tradeoff: Tradeoff, rows: list[tuple[Measured, int]] | None = None
) -> list[list[str]]:
    """Return the words of the table: a line of headings, and one of each setting that worked.

    Args:
        tradeoff: the measured table.
        rows: those that are shown, each with the number of those it stands for; default all.
    """
    if rows is None:
        rows = [(row, 0) for row in tradeoff.rows if row.errors is not None]
    lines = [list(_columns(tradeoff, None))]
    for row, more in rows:
        head, *rest = _columns(tradeoff, row).values()
        lines.append([f"{head} (+{more})" if more else head, *rest])
    return lines


def _columns(tradeoff: Tradeoff, row: Measured | None) -> dict[str, str]:
    """Return the cells of a row by their headings."""
    numbers: dict[str, Any] = {
        "closure": None, "position": None, "velocity": None, "acceleration": None, "error": None}
    simulation = tradeoff.kind == "simulate"
    spins = any(r.errors is not None and r.errors.spin for r in tradeoff.rows)
    cells = {"  setting": "", "µs/step": "", "±": "", "time": "", "keeps e =": "",
             **dict.fromkeys(numbers, "")}
    if spins:
        cells["spin"] = ""
    if simulation:
        cells |= {"energy": "", "steps": ""}
    if row is None or row.errors is None:
        return cells
    cells["  setting"] = f"{'* ' if row.on_front else '  '}{describe(row.accuracy, tradeoff.kind)}"
    cells["µs/step"] = f"{1e6 * row.time_per_step:.3g}"
    cells["±"] = "-" if row.spread is None else f"{100 * row.spread:.0f} %"
    cells["time"] = f"{tradeoff.relative_time(row):.2f}".replace("nan", "-")
    cells["keeps e ="] = f"{tradeoff.error_bound(row):.0e}"
    for key in numbers:
        value = row.error if key == "error" else getattr(row.errors, key)
        cells[key] = f"{value:.1e}"
    if row.error < tradeoff.reference_error:  # nothing is known of the parts either
        cells |= dict.fromkeys(("position", "velocity", "acceleration"), "-")
        cells["error"] = f"< {tradeoff.reference_error:.1e}"
    if spins:
        cells["spin"] = f"{row.errors.spin:.1e}"
    if simulation:
        cells["energy"] = f"{row.energy_drift:.1e}"
        cells["steps"] = str(row.solver_steps)
    return cells


# ---------------------------------------------------------------- figure


def plot(tradeoff: Tradeoff, path: str | Path | None = None) -> Figure:
    """Draw error over time per step; see `Tradeoff.plot`."""
    from spatial_pin._support.figures import ShownFigure

    figure = ShownFigure(figsize=(8.0, 5.5))
    axes = figure.subplots()
    groups: dict[str, list[Measured]] = {}
    for row in tradeoff.rows:
        if row.errors is not None:
            a, projected = row.accuracy, ", projected" * (row.accuracy.formulation == "projected")
            name = f"order {a.order}" if tradeoff.kind == "sweep" else f"{a.integrator}{projected}"
            groups.setdefault(name, []).append(row)
    for k, (name, rows) in enumerate(sorted(groups.items())):
        x, y = zip(*(_point(tradeoff, row) for row in rows), strict=True)
        times = 1e6 * np.array([np.percentile(r.seconds, [25, 75]) / r.steps for r in rows])
        bars = np.maximum(np.abs(times.T - np.array(x)), 0.0)  # between the quartiles
        axes.errorbar(x, y, xerr=bars, fmt=MARKERS[k % len(MARKERS)], markersize=5, elinewidth=0.8,
                      color=COLOURS[k % len(COLOURS)], label=name)
    points = [_point(tradeoff, row) for row in tradeoff.front]
    if points:
        x, y = zip(*points, strict=True)
        axes.step(x, y, where="post", color=INK, linewidth=1.0, zorder=1, label="Pareto front")
    last = np.inf
    for row, point in zip(tradeoff.front, points, strict=True):
        if last >= APART * point[1]:  # else it would lie on the label before
            last = point[1]
            axes.annotate(describe(row.accuracy, tradeoff.kind), point, xytext=(-5, -3),
                          textcoords="offset points", ha="right", va="top", fontsize=7, color=INK)
    axes.set(xscale="log", yscale="log", xlabel="time per step [µs]",
             ylabel="largest error [rad, characteristic lengths;\nrates relative to the largest]")
    _frame(axes, tradeoff)
    figure.suptitle(literal(f"{tradeoff.mechanism}: {tradeoff.task}"), fontsize=12)
    if path is not None:
        save_figure(figure, path)
    return figure


def _point(tradeoff: Tradeoff, row: Measured) -> tuple[float, float]:
    return 1e6 * row.time_per_step, tradeoff.known_error(row)


def _frame(axes: Axes, tradeoff: Tradeoff) -> None:
    """Set limits, grid and legend."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    points = [_point(tradeoff, row) for row in tradeoff.rows if row.errors is not None]
    if points:
        x, y = (np.array(column) for column in zip(*points, strict=True))
        axes.set_xlim(x.min() / 2.5, x.max() * 1.3)
        axes.set_ylim(y.min() / 10, min(y.max() * 10, 1e3))
        if y.min() / 10 < tradeoff.reference_error:
            axes.axhspan(y.min() / 10, tradeoff.reference_error, color=FAINT, alpha=0.6,
                         linewidth=0, label="the reference's own error")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_axisbelow(True)
    axes.grid(color=FAINT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK)
    if points:
        axes.figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=8)
