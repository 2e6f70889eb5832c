"""Time and error in one table: this library and others at the tasks of mechanisms.

    python scripts/bench.py [--tasks sweep a02] [--quick]
    python scripts/bench.py --peers --json new.json --compare old.json
    python scripts/bench.py --bars
    python scripts/bench.py --peers --clock cpu --page docs/accuracy.md

Rows of a task take turns within one run, so that noise hits all alike; every error is measured
outside the clock, against closed forms or values of high precision. With `--peers` MuJoCo, Drake,
Exudyn, placo and pink are installed from PyPI into environments of their own, and run there in
processes of their own. Tasks that a tool cannot do are named below the rows.

`--bars` measures only what has a bar (`benchmark/bars.py`), by processor time, beside the peers
that are installed, and prints how far each task is from its bar; a star is one not met.

`--page` measures what the tables of a page of the documentation (`benchmark/pages.py`) show and
writes them anew, or those of a run that was saved (`--read new.json`).
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only get in the way
sys.path.insert(0, str(Path(__file__).parent))

import control_loop
from benchmark import bars, measure, pages, report, tools, workers
from benchmark.case import TASKS

import spatial_pin as sp


def start(options: argparse.Namespace) -> tuple[list[Any], dict[str, str], list[list[str]]]:
    """Return workers, versions of what they measure, and tools that could not be had."""
    own = workers.Worker(tools.OWN.modules)
    running: list[Any] = [own]
    versions = {"spatial_pin": sp.__version__, **own.versions(tools.OWN.versions)}
    missing = []
    for tool in tools.selected(options.peers, options.bars):
        if not options.peers and not tools.is_there(tool, options.environments):
            missing += [[task, tool.title, "not installed, so not measured; --peers installs it"]
                        for task in tool.bars if task in options.tasks]
            continue
        worker = None
        try:
            python = tools.environment(tool, options.environments, note)
            worker = workers.Remote(python, tool.modules)
            worker.rows()
            versions |= worker.versions([*tool.versions])
            running.append(worker)
        except (subprocess.CalledProcessError, OSError, workers.Failed) as error:
            why = (getattr(error, "stderr", "") or str(error)).strip().splitlines()[-1]
            missing += [[task, tool.title, f"could not be had: {why}"] for task in options.tasks]
            if worker:
                worker.close()
    return running, versions, missing


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Return the report of one run."""
    workers, versions, missing = start(options)
    try:
        cases, absent = measure.rows_of(workers)
        wanted = {key: (worker, row) for key, (worker, row) in cases.items()
                  if row["task"] in options.tasks and not (options.quick and row["slow"])
                  and (not options.bars or bars.wanted(row))}
        effort = measure.QUICK if options.quick else measure.Effort(
            options.repeats, options.budget)
        effort = effort._replace(clock=options.clock)
        rows, failed = measure.measure(wanted, effort, note)
    finally:
        for worker in workers:
            worker.close()
    absent = [a for a in absent if a[0] in options.tasks and not options.bars]
    return {"date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
            "machine": report.machine(), "versions": versions, "effort": effort._asdict(),
            "tools": [t.title for t in tools.PEERS] if options.peers else [],
            "rows": rows, "absent": [*missing, *absent, *failed]}


def note(text: str) -> None:
    """Say what goes on, beside the table."""
    print(text, file=sys.stderr, flush=True)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", nargs="+", metavar="TASK",
                        help=f"only these: {', '.join(TASKS)} (all, or what --page shows)")
    parser.add_argument("--bars", action="store_true",
                        help="only what has a bar, and how far it is from it")
    parser.add_argument("--peers", action="store_true", help="measure the other tools too")
    parser.add_argument("--environments", type=Path, default=tools.FOLDER, metavar="FOLDER",
                        help="where the peers are installed (.venv-peers)")
    parser.add_argument("--repeats", type=int, default=15, help="samples of each row (15)")
    parser.add_argument("--budget", type=float, default=6.0,
                        help="longest time for one row's samples, of which there are two [s] (6)")
    parser.add_argument("--clock", choices=sorted(workers.CLOCKS), default="wall",
                        help="wall, or time on the processor, for a busy machine (wall)")
    parser.add_argument("--quick", action="store_true", help="few samples, no slow rows")
    parser.add_argument("--json", type=Path, metavar="FILE", help="save the results")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write its tables anew")
    parser.add_argument("--read", type=Path, metavar="FILE",
                        help="take saved results, measure nothing")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="put old results beside")
    options = parser.parse_args(arguments)
    if options.tasks:
        options.tasks = [name for text in options.tasks for name in text.split(",") if name]
    else:
        shown = options.page and options.page.name in pages.PAGES
        options.tasks = pages.tasks(options.page) if shown else list(TASKS)
    if options.bars:
        options.clock = "cpu"
        options.tasks = [task for task in bars.tasks() if task in options.tasks]
    unknown = sorted(set(options.tasks) - set(TASKS))
    if unknown:
        parser.error(f"no such task: {', '.join(unknown)}; there are {', '.join(TASKS)}")
    if options.repeats < 1 or not options.budget > 0.0:
        parser.error("--repeats and --budget must be positive")
    return options


def read(path: Path) -> dict[str, Any]:
    """Return saved results.

    Raises:
        SystemExit: the file is not there, or is something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SystemExit(f"{path}: {error}") from None
    wanted = {"date", "machine", "effort", "rows"}
    if not isinstance(content, dict) or not wanted <= content.keys():
        raise SystemExit(f"{path}: no results of this script")
    return content


def tell(options: argparse.Namespace, results: dict[str, Any]) -> None:
    """Print the measurements."""
    if options.bars:
        for line in bars.table(results):
            print(line)
        for line in bars.growing() if "ladder" in options.tasks else ():
            print(line, flush=True)
        for line in control_loop.pauses() if "control" in options.tasks else ():
            print(line, flush=True)
        return
    print("\n".join(report.table(results)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, save."""
    options = parse(arguments)
    old = read(options.compare) if options.compare else None
    results = read(options.read) if options.read else run(options)
    if options.page:
        pages.put_all(options.page, results)
    else:
        tell(options, results)
    if old:
        print("\n".join(report.changes(old, results)))
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
