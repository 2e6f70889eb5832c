"""Published problems of dimensional synthesis: what `sp.design` finds, beside what is published.

    python scripts/compare_design.py [NAME ...] [--seed 0] [--starts 20] [--pylinkage PYTHON]
    python scripts/compare_design.py --page docs/design.md

The problems stand in `benchmark/designs.py`, their sources in `tests/data/synthesis`. The tutorial
problems of pylinkage are solved by pylinkage as well, in the same run: by this interpreter if it
has pylinkage, by the one that is named, or by that of `bench.py --peers`; else that is left out.
Evaluations are sets of dimensions at which loops are closed, or fitted to goals; for derivatives
`sp.design` looks at dimensions beside them as well, where nothing is solved. Times are those of the
processor. `--page` writes the tables of a page of the documentation, all problems solved anew.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only get in the way
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from benchmark import designs, pages, tools

TUTORIALS = Path(__file__).parent / "benchmark" / "tutorials_of_pylinkage.py"


def solved(name: str, **keywords: Any) -> dict[str, Any]:
    """Return a row of the table: the best design of a problem."""
    problem = designs.PROBLEMS[name]
    begin = time.process_time()
    found = problem.solve(**keywords)
    seconds = time.process_time() - begin
    best = found[0] if len(found) else None
    return {"problem": name, "published": problem.published,
            "error": problem.error(best) if best else None, "designs": len(found),
            "evaluations": found.evaluations, "seconds": seconds,
            "dimensions": best.dimensions if best else {},
            "defects": sorted({d.kind for d in best.defects}) if best else []}


def interpreter(named: str | None) -> str | None:
    """Return a Python that has pylinkage."""
    if named:
        return named
    if find_spec("pylinkage"):
        return sys.executable
    tool = next(tool for tool in tools.PEERS if tool.title == "pylinkage")
    there = tools.is_there(tool, tools.FOLDER)
    return str(tools.environment(tool, tools.FOLDER)) if there else None


def tutorials(
    python: str | None, links: Sequence[float] = ()
) -> tuple[list[dict[str, Any]], str]:
    """Return what pylinkage finds for its own problems, or why there is nothing.

    Args:
        python: its interpreter.
        links: crank, coupler and rocker that its measure of the quarter of a circle judges, too.
    """
    if python is None:
        return [], "pylinkage is not installed, so not compared; name an interpreter by --pylinkage"
    try:
        done = subprocess.run([python, str(TUTORIALS), *map(str, links)],
                              capture_output=True, text=True)
    except OSError as error:
        return [], f"pylinkage is not compared: {error}"
    if done.returncode:
        return [], f"pylinkage is not compared: {done.stderr.strip().splitlines()[-1]}"
    return list(json.loads(done.stdout.splitlines()[-1])["rows"]), ""


def number(x: float | None) -> str:
    return "-" if x is None else f"{x:.3g}" if isinstance(x, float) else str(x)


def line(words: Sequence[Any]) -> str:
    return "| " + " | ".join(str(w) for w in words) + " |"


def said(table: list[str], words: Sequence[Any]) -> list[str]:
    """Print and add a line to a table, behind its first one the rule; return the table."""
    new = [line(words)] if table else [line(words), line(["---"] * len(words))]
    print("\n".join(new), flush=True)
    table += new
    return table


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(designs.PROBLEMS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--starts", type=int)
    parser.add_argument("--pylinkage", metavar="PYTHON")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write its tables anew")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(designs.PROBLEMS))
    if unknown:
        parser.error(f"no problem {', '.join(unknown)}; there are {', '.join(designs.PROBLEMS)}")
    if options.page and set(options.names) != set(designs.PROBLEMS):
        parser.error("--page is of all problems: name none")
    keywords = {} if options.starts is None else {"starts": options.starts}
    links: list[float] = []
    table = said([], ["problem", "published", "sp.design", "designs", "evaluations", "s",
                      "defects"])
    for name in options.names:
        row = solved(name, seed=options.seed, **keywords)
        if name == "tutorial_quadrant":
            links = [row["dimensions"][link] for link in ("r2", "r3", "r4") if row["designs"]]
        said(table, [designs.PROBLEMS[name].title, *map(number, (
            row["published"], row["error"], row["designs"], row["evaluations"], row["seconds"])),
            ", ".join(row["defects"]) or "none"])
    rows, reason = tutorials(interpreter(options.pylinkage), links)
    if not rows:
        print(f"\n{reason}")
    print()
    others = said([], ["pylinkage, its own tutorials", "error", "evaluations", "s"]) if rows else []
    for row in rows:
        name, comma, what = row["problem"].partition(",")
        said(others, [designs.PROBLEMS[name].title + comma + what, *map(number, (
            row["error"], row["evaluations"], row["seconds"]))])
    if options.page:
        pages.put(options.page, "designs", table)
        if others:
            pages.put(options.page, "tutorials", others)


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
