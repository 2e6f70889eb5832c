"""Tables of the documentation, from one run of the benchmark.

A page has `<!-- table: NAME -->` above a table; `put` writes the table of that name there. Times
are the least of a row's samples; errors are the largest of the rows that a line is of.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmark.bars import FORWARD
from benchmark.case import FACTORS, ROBOTS, TASKS
from benchmark.report import HAND, OWN, key

Rows = Mapping[str, Any]
RK4 = "RK4 at {} s"
BAUMGARTE, SOFT = f"constraintDynamics + Baumgarte, {RK4}", f"`connect` at its stiffest, {RK4}"


class Line(NamedTuple):
    """A line of a table: one tool, by one way or by two.

    Attributes:
        title: in its first column.
        tool: whose rows.
        hows: the ways, as the benchmark calls them.
    """

    title: str
    tool: str
    hows: tuple[str, ...]


SWEEPS = (
    Line("`spatial_pin.sweep`", OWN, ("sweep",)),
    Line("the same, `for_error(1e-4)`", OWN, ("sweep, for_error(0.0001)",)),
    Line("`spatial_pin.sweep` and the states of all bodies", OWN,
         ("sweep + states of all bodies",)),
    Line("Pinocchio by hand, tuned for this one mechanism", HAND, ("tuned",)),
    Line("Pinocchio by hand, plainly written", HAND, ("plain",)),
    Line("Newton on MuJoCo's Jacobians, tuned", "MuJoCo", ("Newton on mj_jac, tuned",)),
    Line("Newton on Drake's Jacobians, tuned", "Drake", ("Newton on its Jacobians, tuned",)),
    Line("SciPy `fsolve`, three equations / one by hand, positions only", "by hand",
         ("SciPy fsolve, vector loop, q only", "SciPy fsolve, ψ alone, q only")),
)
OURS = Line("`spatial_pin.simulate`, `for_error(1e-4)` / engineering", OWN,
            ("simulate, for_error(1e-4)", "simulate, engineering"))
SIMULATIONS = {
    "a02": ("angle", (
        OURS,
        Line("one pendulum equation by hand, SciPy's DOP853", "by hand",
             ("one equation, SciPy DOP853 at 1e-09", "one equation, SciPy DOP853 at 4e-12")),
        Line("Pinocchio's constrained dynamics by hand, RK4 at 5 / 2 ms", HAND,
             (BAUMGARTE.format(0.005), BAUMGARTE.format(0.002))),
        Line("MuJoCo, `connect`, RK4 at 1 / 0.1 ms", "MuJoCo",
             (SOFT.format(0.001), SOFT.format(0.0001))),
        Line("Drake, SAP at 5 / 1 ms", "Drake",
             ("SAP, ball constraint, 0.005 s", "SAP, ball constraint, 0.001 s")),
        Line("Exudyn, generalised α at 1 / 0.1 ms", "Exudyn",
             ("generalized-α, index 3, 0.001 s", "generalized-α, index 3, 0.0001 s")))),
    "a04": ("position", (
        OURS,
        Line("Pinocchio's constrained dynamics by hand, RK4 at 5 / 2 ms", HAND,
             (BAUMGARTE.format(0.005), BAUMGARTE.format(0.002))),
        Line("MuJoCo, `connect`, RK4 at 5 / 1 ms", "MuJoCo",
             (SOFT.format(0.005), SOFT.format(0.001))),
        Line("Drake, SAP at 5 / 1 ms", "Drake",
             ("SAP, two ball constraints, 0.005 s", "SAP, two ball constraints, 0.001 s")),
        Line("Exudyn, generalised α at 5 / 1 ms", "Exudyn",
             ("generalized-α, index 3, one equation left out, 0.005 s",
              "generalized-α, index 3, one equation left out, 0.001 s")))),
}
REACHES = {  # task: its lines
    "reach": (
        Line("`sp.reach`", OWN, ("reach",)),
        Line("pink: closures and target as tasks", "pink",
             ("tasks for closures and target, daqp, q only",)),
        Line("placo: closures as hard tasks", "placo",
             ("hard closing tasks, soft target, q only",)),
        Line("Drake's InverseKinematics, SNOPT", "Drake", ("InverseKinematics, SNOPT, q only",))),
}
REACHES["path"] = (Line("`sp.reach_path`, with rates", OWN, ("reach_path, with rates",)),
                   *REACHES["reach"][1:])
ERRORS = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)  # errors
SINGLE = (  # title, our row, title of the other, its row
    ("`sweep` of 1 value", key("sweep", 1, "sweep"), "Pinocchio by hand, tuned",
     key("sweep", 1, "tuned", HAND)),
    ("`sweep` of 36 values", key("sweep", 36, "sweep"), "Pinocchio by hand, tuned",
     key("sweep", 36, "tuned", HAND)),
    ("`sweep` of a plane four-bar, 360 values", key("four_bar", 360, "sweep"),
     "pylinkage, compiled steps", key("four_bar", 360, "numba steps with rates", "pylinkage")),
    ("`forward_dynamics`, every reaction, one loop", key("forward", 1, FORWARD),
     "`pin.constraintDynamics`, no reactions of tree joints",
     key("forward", 1, "constraintDynamics", HAND)),
    ("`forward_dynamics`, every reaction, 200 loops", key("forward", 200, FORWARD),
     "`pin.constraintDynamics`", key("forward", 200, "constraintDynamics", HAND)),
    ("`solve_rates`", key("rates", 0, "solve_rates"), "Pinocchio by hand",
     key("rates", 0, "rows, two solves", HAND)),
    ("`jacobian`", key("jacobian", 0, "jacobian"), "Pinocchio by hand",
     key("jacobian", 0, "rows, one solve", HAND)),
    ("`assemble` from the file's guess", key("assembly", 0, "assemble"),
     "Newton by hand from the guess", key("assembly", 0, "Newton from the guess", HAND)),
    ("`assemble`, 40° from the guess",
     key("assembly", 0, "assemble, 40° from the guess of the file"), "", ""),
    ("`assemble` from a State there", key("assembly", 0, "assemble, from a State there"), "", ""),
)


def rounded(value: float) -> str:
    """Return a number in two digits, without an exponent."""
    return f"{float(f'{value:.2g}'):g}"


def time(seconds: float) -> str:
    """Return a time in two digits, with its unit."""
    unit = "ms" if seconds >= 1e-3 else "µs"
    return f"{rounded(FACTORS[unit] * seconds)} {unit}"


def power(value: float) -> str:
    """Return a number in one digit and a power of ten."""
    return f"{value:.0e}".replace("e-0", "e-")


def number(value: float | None) -> str:
    """Return a number in three digits, whole ones in all."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 1.0 and value == int(value) else f"{value:.3g}"


def joined(rows: Rows, keys: Sequence[str], word: Callable[[Any], str]) -> str:
    """Return a word of each row, with slashes between; nothing where none was measured."""
    return " / ".join(word(rows[k]) for k in keys if k in rows)


def largest(rows: Rows, keys: Sequence[str], error: str) -> str:
    """Return the largest error of rows; nothing where they do not have it."""
    errors = [e for k in keys if k in rows and (e := rows[k]["errors"].get(error)) is not None]
    return power(max(errors)) if errors else ""


def cells(*words: str) -> str:
    """Return a line of a table."""
    return re.sub(r"  +\|", " |", f"| {' | '.join(words)} |")


def sweeps(rows: Rows) -> Iterator[str]:
    """Yield the table of one turn of the RSSR four-bar [µs a value]."""
    errors = ("closure", "ψ", "ψ'", "ψ''")
    yield "| | 360 values | 3600 | closure | ψ | ψ′ | ψ″ |"
    yield "|---|---|---|---|---|---|---|"
    for line in SWEEPS:
        of = {n: [key("sweep", n, how, line.tool) for how in line.hows] for n in (360, 3600)}
        times = [joined(rows, of[n], lambda row: rounded(1e6 * row["least"])) for n in of]
        both = [*of[360], *of[3600]]
        yield cells(line.title, *times, *(largest(rows, both, error) for error in errors))


def simulations(rows: Rows, task: str) -> Iterator[str]:
    """Yield the table of ten seconds of a mechanism: time and error at two settings."""
    error, lines = SIMULATIONS[task]
    yield "| | at a loose setting | | at a tight one | |"
    yield "|---|---|---|---|---|"
    for line in lines:
        keys = [key(task, 0, how, line.tool) for how in line.hows]
        yield cells(line.title, *(word for k in keys for word in (
            joined(rows, [k], lambda row: time(row["least"])), largest(rows, [k], error))))


def dial(rows: Rows) -> Iterator[str]:
    """Yield the table of what an error that is accepted saves."""
    yield "| allowed error | 360 values | 3600 | ψ | ψ″ | A02 | angle |"
    yield "|---|---|---|---|---|---|---|"
    for error in (*ERRORS, None):
        word = "engineering" if error is None else power(error)
        sweep = "sweep" if error is None else f"sweep, for_error({error:g})"
        run = f"simulate, for_error({word})" if error else "simulate, engineering"
        of = [key("sweep", n, sweep) for n in (360, 3600)]
        times = [joined(rows, [k], lambda row: f"{rounded(1e6 * row['least'])} µs") for k in of]
        a02 = [key("a02", 0, run)]
        yield cells(word, *times, largest(rows, of, "ψ"), largest(rows, of, "ψ''"),
                    joined(rows, a02, lambda row: time(row["least"])), largest(rows, a02, "angle"))


def reaches(rows: Rows, kind: str) -> Iterator[str]:
    """Yield the table of targets of closed mechanisms: time and error of one, and those missed."""
    yield f"| | {' | '.join(ROBOTS.values())} |"
    yield f"|---|{'---|' * len(ROBOTS)}"

    def cell(row: Any) -> str:
        errors = row["errors"]
        missed = int(errors["missed"])
        worst = power(max(errors["closure"], errors["target"]))
        return f"{time(row['least'])}, {worst}" + f", {missed} not met" * bool(missed)

    for line in REACHES[kind]:
        yield cells(line.title, *(
            joined(rows, [key(f"{kind}-{robot}", 0, how, line.tool) for how in line.hows], cell)
            for robot in ROBOTS))


def reduced(rows: Rows) -> Iterator[str]:
    """Yield the table of sweeps of full and reduced models [µs a value]."""
    own = {(row["how"], row["size"]): row for row in rows.values() if row["task"] == "smaller"}
    yield cells("asked for", "coordinates", "equations", "361 values, µs each",
                "3600 values, µs each", "difference")
    yield cells(*["---"] * 6)
    for title in dict.fromkeys(how.rpartition(", ")[0] for how, _ in own):
        few, many = ([own[f"{title}, {which}", n] for which in ("full", "reduced")]
                     for n in (361, 3600))
        sizes = (" → ".join(f"{row['errors'][what]:g}" for row in few)
                 for what in ("coordinates", "equations"))
        times = (" → ".join(rounded(1e6 * row["least"]) for row in pair) for pair in (few, many))
        yield cells(title, *sizes, *times, power(few[1]["errors"]["difference"]))


def chains(rows: Rows) -> Iterator[str]:
    """Yield the table of forces on open chains: one whole call."""
    yield "| hinges | `forward_dynamics` | `pin.aba` | `inverse_dynamics` | `pin.rnea` | error |"
    yield "|---|---|---|---|---|---|"
    for n in sorted({row["size"] for row in rows.values() if row["task"] == "chain"}):
        keys = [key("chain", n, how, tool) for how, tool in (
            ("forward_dynamics", OWN), ("aba", HAND), ("inverse_dynamics", OWN), ("rnea", HAND))]
        yield cells(str(n), *(joined(rows, [k], lambda row: time(row["least"])) for k in keys),
                    largest(rows, keys[:1], "acceleration"))


NUMBERS = ("published", "error", "designs", "evaluations")  # of a design; its others are defects


def designed(rows: Rows) -> Iterator[str]:
    """Yield the table of published problems of synthesis."""
    yield cells("problem", "published", "sp.design", "designs", "evaluations", "s", "defects")
    yield cells(*["---"] * 7)
    for row in rows.values():
        if row["task"] == "design" and row["tool"] == OWN:
            defects = ", ".join(name for name in row["errors"] if name not in NUMBERS)
            yield cells(row["how"], *(number(row["errors"][name]) for name in NUMBERS),
                        number(row["least"]), defects or "none")


def tutorials(rows: Rows) -> Iterator[str]:
    """Yield the table of what pylinkage finds for the problems of its own tutorials."""
    yield cells("pylinkage, its own tutorials", "error", "evaluations", "s")
    yield cells(*["---"] * 4)
    for row in rows.values():
        if row["task"] == "design" and row["tool"] == "pylinkage":
            yield cells(row["how"], *(number(row["errors"][x]) for x in ("error", "evaluations")),
                        number(row["least"]))


def excavated(rows: Rows) -> Iterator[str]:
    """Yield the table of an excavator's three cylinders along a dig."""
    yield "| | 1000 samples | closure | lengths [m] |"
    yield "|---|---|---|---|"
    own = [key("excavator", 1000, "follow")]
    yield cells("`sp.follow`", joined(rows, own, lambda row: time(row["count"] * row["least"])),
                *(largest(rows, own, error) for error in ("closure", "length")))


def single(rows: Rows) -> Iterator[str]:
    """Yield the table of single states and short sweeps: one whole call."""
    yield "| | spatial_pin | beside |"
    yield "|---|---|---|"
    for title, ours, other, unit in SINGLE:
        own, theirs = (f"{time(row['count'] * row['least'])}" if (row := rows.get(k)) else ""
                       for k in (ours, unit))
        yield cells(title, own, f"{other}: {theirs}" if theirs else "")
    few, many = (rows.get(key("forward", n, FORWARD)) for n in (50, 500))
    if few and many:
        grown = math.log10(many["least"] / few["least"])
        yield cells("`forward_dynamics`, 50 to 500 loops", f"grows with the power {grown:.2f}", "")


TABLES: dict[str, Callable[[Rows], Iterator[str]]] = {
    "sweep": sweeps,
    "a02": lambda rows: simulations(rows, "a02"),
    "a04": lambda rows: simulations(rows, "a04"),
    "dial": dial,
    "single": single,
    "reach": lambda rows: reaches(rows, "reach"),
    "path": lambda rows: reaches(rows, "path"),
    "chain": chains,
    "reduce": reduced,
    "designs": designed,
    "tutorials": tutorials,
    "excavator": excavated,
}
PAGES = {  # of docs/, with the tables that they have
    "accuracy.md": ("sweep", "a02", "a04", "dial", "single", "chain", "reduce"),
    "design.md": ("designs", "tutorials"), "reach.md": ("reach",),
    "reach_path.md": ("path",), "follow.md": ("excavator",),
}

NEEDS = {  # table: tasks whose rows it shows
    "sweep": ("sweep",), "a02": ("a02",), "a04": ("a04",), "dial": ("sweep", "a02"),
    "single": ("sweep", "four_bar", "forward", "rates", "jacobian", "assembly"),
    "reach": tuple(f"reach-{robot}" for robot in ROBOTS),
    "path": tuple(f"path-{robot}" for robot in ROBOTS),
    "chain": ("chain",), "reduce": ("smaller",), "designs": ("design",), "tutorials": ("design",),
    "excavator": ("excavator",),
}


def tasks(page: Path) -> list[str]:
    """Return the tasks whose rows the tables of a page show."""
    wanted = {task for name in PAGES[page.name] for task in NEEDS[name]}
    return [task for task in TASKS if task in wanted]


def put(page: Path, name: str, lines: Sequence[str]) -> None:
    """Write a table below its mark in a page.

    Raises:
        ValueError: the page has no such mark.
    """
    text = page.read_text(encoding="utf-8")
    match = re.search(rf"^<!-- table: {name} -->\n((?:\|.*\n)*)", text, flags=re.MULTILINE)
    if match is None:
        raise ValueError(f"{page} has no <!-- table: {name} -->")
    table = "".join(f"{line}\n" for line in lines)
    page.write_text(text[:match.start(1)] + table + text[match.end(1):], encoding="utf-8")


def put_all(page: Path, report: Mapping[str, Any]) -> None:
    """Write the tables that a page has a mark for.

    Raises:
        ValueError: it has none.
    """
    text = page.read_text(encoding="utf-8")
    marked = [name for name in TABLES if f"<!-- table: {name} -->" in text]
    if not marked:
        raise ValueError(f"{page} has no <!-- table: NAME -->")
    for name in marked:
        lines = list(TABLES[name](report["rows"]))
        print("\n".join(["", *lines]))
        put(page, name, lines)
