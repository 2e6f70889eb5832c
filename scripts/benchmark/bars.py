"""The table of bars: times of tasks, their limits, and the times of other tools.

A bar is an entry of BARS: a row of the benchmark, the time it should take at most, and the rows of
others that it should be ahead of. Times are of one whole call, by medians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from benchmark import growth
from benchmark.case import MECHANISMS, TASKS
from benchmark.report import HAND, key

LOOSE = 1e-4  # error that an answer may have at loose settings
POWER, MEMORY = 1.3, 2000.0  # with which times of a ladder may grow, and what 1000 loops take [MB]
SOLVERS = HAND, "MuJoCo"  # of constrained dynamics, for any mechanism
WIDTH = 56
FORWARD = "forward_dynamics, reactions too"


class Bar(NamedTuple):
    """One line of the table.

    Attributes:
        title: the task.
        row: key of our row.
        most: seconds that it may take; None where only others are the measure.
        others: rows to compare with, by keys; the fastest counts; or the name
            of an error: of the rows of SOLVERS the fastest that is as exact as ours, or as LOOSE,
            counts, or the most exact where none is.
        ratio: that the times may have.
    """

    title: str
    row: str
    most: float | None = None
    others: Sequence[str] | str = ()
    ratio: float = 1.0


def _sweep(n: int, most: float) -> Bar:
    return Bar(f"sweep RSSR, {n} values with rates", key("sweep", n, "sweep"), most,
               [key("sweep", n, "tuned", HAND)])


BARS = (
    *(_sweep(n, most) for n, most in ((1, 1e-4), (36, 2.5e-4), (360, 7e-4), (3600, 4e-3))),
    *(Bar(f"sweep RSSR, {n} values, for_error({error:g})",
          key("sweep", n, f"sweep, for_error({error:g})"), None, [key("sweep", n, "sweep")], ratio)
      for n, error, ratio in ((360, 1e-2, 0.5), (360, 1e-4, 0.7), (3600, 1e-4, 0.33))),
    Bar("sweep four-bar, 360 values with rates", key("four_bar", 360, "sweep"), None,
        [key("four_bar", 360, "numba steps with rates", "pylinkage")]),
    Bar("sweep Gough platform, 360 values", key("stewart", 360, "sweep"), 2.5e-3),
    Bar("sweep Gough platform, 3600 values", key("stewart", 3600, "sweep"), 2e-2),
    Bar("excavator, 1000 samples of three cylinders", key("excavator", 1000, "follow"), 0.1),
    *(Bar(f"reach {name}, 20 targets", key(f"reach-{robot}", 0, "reach"), None,
          [key(f"reach-{robot}", 0, "hard closing tasks, soft target, q only", "placo")], 1.5)
      for robot, name in (("gough", "Gough platform"), ("delta", "delta robot"),
                          ("excavator", "excavator"), ("ankle", "G1's ankle"))),
    Bar("reach_path Gough platform, 200 placements", key("path-gough", 0, "reach_path, with rates"),
        1e-2),
    Bar("assemble RSSR from the file", key("assembly", 0, "assemble"), 5e-5),
    Bar("assemble RSSR from the file, crank at 40°",
        key("assembly", 0, "assemble, 40° from the guess of the file"), 5e-5),
    Bar("assemble RSSR from a State", key("assembly", 0, "assemble, from a State there"), 2e-5),
    Bar("solve_rates RSSR", key("rates", 0, "solve_rates"), 1.5e-5),
    Bar("jacobian RSSR", key("jacobian", 0, "jacobian"), 1.2e-5),
    Bar("jacobian RSSR of 2001 samples, beside their sweep",
        key("samples", 2001, "jacobian of the motion"), None, [key("samples", 2001, "sweep")], 2.0),
    Bar("states of the delta, 10000 scattered", key("scattered", 10000, "states"), 0.2),
    Bar("modes RSSR", key("modes", 0, "assembly_modes, RSSR"), 1e-2),
    Bar("modes of Dietmaier's platform, 40", key("modes", 0, "assembly_modes, six legs"), 0.5),
    Bar("modes of a general 6R, 16", key("modes", 0, "assembly_modes, six hinges"), 0.2),
    Bar("simulate A02, engineering", key("a02", 0, "simulate, engineering"), 6e-3, "angle"),
    Bar("simulate A02, for_error(1e-4)", key("a02", 0, "simulate, for_error(1e-4)"), 2.5e-3,
        "angle"),
    Bar("simulate A04, engineering", key("a04", 0, "simulate, engineering"), 6e-3, "position"),
    Bar("simulate A04, for_error(1e-4)", key("a04", 0, "simulate, for_error(1e-4)"), None,
        "position"),
    Bar("Gough platform, six freedoms, 1001 samples",
        key("platform", 0, "simulate, engineering"), 1.5e-2),
    *(Bar(f"{robot} falling 10 s, {how}", key(robot, 0, f"simulate, {how}"), None, "energy")
      for robot in ("five-bar", "3-RRR") for how in ("engineering", "for_error(1e-4)")),
    Bar("simulate A02, beside its one equation by hand", key("a02", 0, "simulate, engineering"),
        None, [key("a02", 0, "one equation, SciPy DOP853 at 4e-12", "by hand")], 5.0),
    *(Bar(f"sweep reduced RSSR, {n} values",
          key("reduced", n, "sweep of reduce(mechanism, outputs)"), None,
          [key("reduced", n, "the distance equation, tuned", "by hand")], 1.5)
      for n in (360, 3600)),
    *(Bar(f"forward_dynamics, {many} loops beside {few}", key("forward", many, FORWARD), None,
          [key("forward", few, FORWARD)], ratio)
      for many, few, ratio in ((200, 1, 300.0), (500, 50, 10.0**1.2))),
    *(Bar(f"forward_dynamics, {n} loop{'s' * (n > 1)}", key("forward", n, FORWARD), None,
          [key("forward", n, "constraintDynamics", HAND)], ratio)
      for n, ratio in ((1, 4.0), (20, 0.6))),
    Bar("inverse_dynamics, delta robot", key("inverse", 0, "inverse_dynamics"), None,
        [key("inverse", 0, "9 solves of a 5 x 5", "NumPy")], 1.6),
    *(Bar(f"dynamics_derivatives, {words}", key(f"derivatives-{name}", 0, "dynamics_derivatives"),
          None, [key(f"derivatives-{name}", 0, "computeConstraintDynamicsDerivatives", HAND)],
          6.0 if name == "rssr" else 3.3) for name, words in MECHANISMS.items()),
    Bar("import and load RSSR", key("start", 0, "import spatial_pin, load('rssr')"), 0.42),
    Bar("sensitivity RSSR, 4 dimensions", key("sensitivity", 0, "sensitivity"), 6e-2),
    Bar("gradient of a motion, 4 dimensions",
        key("sensitivity", 0, "sensitivity of a motion, 36 samples"), 0.1),
)


def tasks() -> list[str]:
    """Return the tasks that the bars are about."""
    wanted = {"ladder", "control", *(bar.row.partition(" / ")[0] for bar in BARS)}
    return [task for task in TASKS if task in wanted]


def wanted(row: Mapping[str, Any]) -> bool:
    """Whether a row of the benchmark is one of ours that has a bar, or one beside it."""
    own = key(row["task"], row["size"], row["how"], row["tool"])
    for bar in BARS:
        others = bar.others if not isinstance(bar.others, str) else ()
        if own == bar.row or own in others:
            return True
        if isinstance(bar.others, str) and row["tool"] in SOLVERS \
                and bar.row.startswith(f"{row['task']} / {row['size']} / "):
            return True
    return False


def table(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield "task".ljust(WIDTH) + f"{'now':>11} {'bar':>9} {'now/bar':>8}  beside"
    measured = {row["task"] for row in report["rows"].values()}
    for bar in BARS:
        if bar.row.partition(" / ")[0] in measured:
            yield _line(bar, report["rows"])
    yield from (f"  {tool}, {TASKS[task].title.format('N')}: {why}"
                for task, tool, why in report["absent"] if task in measured)


def _line(bar: Bar, rows: Mapping[str, Any]) -> str:
    if bar.row not in rows:
        return f"{bar.title.ljust(WIDTH)}{'-':>11}  not measured"
    own = rows[bar.row]
    seconds = own["median"] * own["count"]
    text = f"{bar.title.ljust(WIDTH)}{duration(seconds):>11}"
    text += f" {duration(bar.most):>9} {_judged(seconds / bar.most):>8}" if bar.most else " " * 19
    return (text + "  " + _ratio(bar, own, rows)).rstrip()


def _ratio(bar: Bar, own: Mapping[str, Any], rows: Mapping[str, Any]) -> str:
    """Return how the time is to the best other, and who that is."""
    if not bar.others:
        return ""
    best = _best(bar, own, rows)
    if best is None:
        return "no other was measured"
    ratio, error = own["median"] / best["median"], ""
    if isinstance(bar.others, str):
        mine, theirs = (row["errors"][bar.others] for row in (own, best))
        error = f", errors {mine:.0e} and {theirs:.0e}"
    return (f"{_judged(ratio / bar.ratio, ratio)} (bar {bar.ratio:g}) to {best['tool']}: "
            f"{best['how']}{error}")


def _best(bar: Bar, own: Mapping[str, Any], rows: Mapping[str, Any]) -> Mapping[str, Any] | None:
    if not isinstance(bar.others, str):
        there = [rows[name] for name in bar.others if name in rows]
        return min(there, key=lambda row: row["median"], default=None)

    def error(row: Mapping[str, Any]) -> float:
        return row["errors"][bar.others]

    there = [row for row in rows.values() if row["task"] == own["task"]
             and row["tool"] in SOLVERS and error(row) is not None]
    loose = LOOSE if "for_error" in bar.row else 0.0
    exact = [row for row in there if error(row) <= max(error(own), loose)]
    if exact:
        return min(exact, key=lambda row: row["median"])
    return min(there, key=error, default=None)


def _judged(value: float, shown: float | None = None) -> str:
    """Return a number; with a star where it is above 1, not met."""
    return f"{value if shown is None else shown:.2g}{'*' * (value > 1.0)}"


def duration(seconds: float) -> str:
    """Return a time with three digits."""
    for unit, size in (("µs", 1e-6), ("ms", 1e-3)):
        if seconds < 999.5 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def growing(sizes: Iterable[int] = growth.SIZES) -> Iterator[str]:
    """Measure and yield the lines about ladders."""
    times: dict[int, dict[str, tuple[float, float]]] = {}
    for n in sizes:
        times[n], why = growth.measure(n)
        done = ", ".join(f"{stage} {duration(x)}" for stage, (x, _) in times[n].items())
        memory = max((m for _, m in times[n].values()), default=0.0)
        yield f"ladder of {n} loops: {done}; {memory:.0f} MB{'*' * (memory > MEMORY)}"
        if why:
            stage = next(stage for stage in growth.STAGES if stage not in times[n])
            yield (f"  {stage} does not end within {growth.SECONDS} s and "
                   f"{growth.MEMORY >> 30} GB*: {why}; no larger one is tried")
            break
    for stage in growth.STAGES:
        value, few, many = growth.power(times, stage)
        yield (f"  {stage}: grows with power {_judged(value / POWER, value)} from {few} to "
               f"{many} (bar {POWER:g})")
