"""Timing in turns: all rows of a task are run one after another, again and again."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from benchmark.case import TASKS
from benchmark.workers import Failed, sentence


class Effort(NamedTuple):
    """How long to measure.

    Attributes:
        repeats: samples of each row, fewer where that takes longer than `budget`.
        budget: for all samples of one row [s].
        least: of one sample; shorter runs are repeated within it [s].
        clock: a key of `workers.CLOCKS`; processor time is calmer on a busy machine.
    """

    repeats: int = 15
    budget: float = 6.0
    least: float = 0.02
    clock: str = "wall"


QUICK = Effort(repeats=3, budget=0.5, least=0.002)


def rows_of(workers: Iterable[Any]) -> tuple[dict[str, tuple[Any, dict]], list[list[str]]]:
    """Return (worker, row) of every case by its key, and the absent ones."""
    cases: dict[str, tuple[Any, dict]] = {}
    absent: list[list[str]] = []
    for worker in workers:
        own = worker.rows()
        cases |= {key: (worker, row) for key, row in own["cases"].items()}
        absent += own["absent"]
    return cases, absent


def measure(
    cases: Mapping[str, tuple[Any, dict]], effort: Effort, say: Callable[[str], None]
) -> tuple[dict[str, dict], list[list[str]]]:
    """Return rows with samples and errors by key, and those that failed: task, tool, why."""
    done: dict[str, dict] = {}
    failed: list[list[str]] = []
    for group in groups(cases):
        say(f"{group[0].partition(' / ')[0]}: {len(group)} rows")
        samples = in_turns({key: cases[key] for key in group}, effort, failed)
        for key, seconds in samples.items():
            worker, row = cases[key]
            try:
                errors = worker.judge(key)
            except Exception as error:
                failed.append([row["task"], row["tool"], f"{row['how']}: {words(error)}"])
                continue
            done[key] = {**row, "seconds": seconds, "errors": errors,
                         "least": min(seconds), "median": statistics.median(seconds)}
    return done, failed


def groups(cases: Mapping[str, tuple[Any, dict]]) -> list[list[str]]:
    """Return the keys task by task: those that take turns."""
    return [keys for task in TASKS
            if (keys := [k for k, (_, row) in cases.items() if row["task"] == task])]


def in_turns(
    cases: Mapping[str, tuple[Any, dict]], effort: Effort, failed: list[list[str]]
) -> dict[str, list[float]]:
    """Return the samples [s per value] of each row; rows that fail go to `failed`."""
    samples: dict[str, list[float]] = {}
    numbers, turns = {}, {}
    for key, (worker, row) in cases.items():
        try:
            worker.setup(key)
            first = worker.run(key, 1, effort.clock)  # warms up
            if first > effort.budget:  # nothing of it is warming up
                samples[key], numbers[key], turns[key] = [first / row["count"]], 1, set()
                continue
            once = max(worker.run(key), 1e-9)
        except Exception as error:
            failed.append([row["task"], row["tool"], f"{row['how']}: {words(error)}"])
            continue
        numbers[key] = max(1, math.ceil(effort.least / once))
        wanted = round(effort.budget / (once * numbers[key]))
        turns[key] = set(spread(min(max(wanted, 2), effort.repeats), effort.repeats))
        samples[key] = []
    for turn in range(effort.repeats):
        for key in list(samples):
            if turn in turns[key]:
                worker, row = cases[key]
                try:
                    seconds = run(worker, key, numbers[key], effort.clock)
                    samples[key].append(seconds / row["count"])
                except Exception as error:
                    failed.append([row["task"], row["tool"], f"{row['how']}: {words(error)}"])
                    del samples[key]
    return samples


def run(worker: Any, key: str, number: int, clock: str) -> float:
    """Return the seconds of a run; build anew where another row has ended the process."""
    try:
        return worker.run(key, number, clock)
    except Failed:
        worker.setup(key)
        worker.run(key)
        return worker.run(key, number, clock)


def spread(few: int, many: int) -> Sequence[int]:
    """Return `few` of the turns 0 to many - 1, evenly."""
    return [many * i // few for i in range(few)]


def words(error: BaseException) -> str:
    """Return an error in one line."""
    return str(error) if isinstance(error, Failed) else sentence(error)
