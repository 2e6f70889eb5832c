"""Rows of a branch at driver values asked for: one after the other, run by run, or in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from spatial_pin.continuation import branch_points, vectorised_path
from spatial_pin.continuation.branch import Branch, Stopped
from spatial_pin.continuation.evaluation_order import there_and_back
from spatial_pin.errors import SpatialPinError
from spatial_pin.numerics.linalg import Array


@dataclass
class Record:
    """Rows of a sweep, filled one by one."""

    q: Array
    t: Array
    c: Array
    residual: Array
    angles: Array

    @classmethod
    def empty(cls, n: int, branch: Branch) -> Record:
        """Return one for n rows."""
        model = branch.model
        rows = branch.evaluation.constraints.n_rows
        return cls(np.empty((n, model.nq)), np.empty((n, model.nv)), np.empty((n, model.nv)),
                   np.empty((n, rows)), np.empty((n, len(branch.angles))))

    def put(self, k: int, branch: Branch) -> None:
        """Write where a branch stands into row k."""
        self.q[k] = branch.q
        self.t[k] = branch.t
        self.c[k] = branch.c
        self.residual[k] = branch.residual
        self.angles[k] = branch.angles

    def put_rows(self, k: int, rows: vectorised_path.Rows) -> None:
        """Write rows from row k on."""
        end = k + len(rows.t)
        self.q[k:end], self.t[k:end], self.c[k:end] = rows.q, rows.t, rows.c
        self.residual[k:end], self.angles[k:end] = rows.residual, rows.angles


def followed_in_order(start: Callable[[], Branch], values: Array, bar: tqdm[Any]) -> Record | None:
    """Return the rows, followed in the order of their values from the first on, both ways.

    None where the order asked for is no detour, or anything lies in the way: what it is, and which
    rows come before it, is told by the order asked for.
    """
    ways = there_and_back(values)
    if ways is None:
        return None
    record = Record.empty(len(values), start())
    for rows in ways:
        branch = start()
        own = Record.empty(len(rows), branch)
        try:
            for _ in follow(branch, values[rows], own, None):
                pass
        except (Stopped, SpatialPinError):
            bar.reset()
            return None
        for name, column in vars(own).items():
            getattr(record, name)[rows] = column
        bar.update(len(rows))
    return record


def follow(
    branch: Branch, values: Array, record: Record, crossed: list[tuple[float, int]] | None
) -> Iterator[int]:
    """Fill the record row by row, or run by run; yields the number of rows done.

    Crossings that are passed are added to `crossed`, if that is a list, as (value, row).
    """
    runner = vectorised_path.Runner(branch, values) if vectorised_path.is_possible(branch) else None
    k, careful_until = 0, 0
    while k < len(values):
        end = runner.pays(k) if runner and k >= careful_until else k
        if runner and end > k:
            for first, rows in runner.follow(k, end):
                record.put_rows(first, rows)
                k = first + len(rows.q)
                yield k
            if k < end:
                careful_until = k + runner.rest
            continue
        try:
            branch.reach(float(values[k]))
        except Stopped as stopped:
            before = k
            k = _pass_crossing(branch, values, k, record, stopped, crossed)
            careful_until = max(careful_until, k + vectorised_path.REST)
            if k > before:
                yield k
            continue
        record.put(k, branch)
        k += 1
        yield k


def _pass_crossing(
    branch: Branch, values: Array, k: int, record: Record, stopped: Stopped,
    crossed: list[tuple[float, int]] | None,
) -> int:
    """Go straight on at a crossing before row k; return the first row behind its strip.

    Rows before the crossing that lie on the strip are taken from it too: it is the more exact.

    Raises:
        Stopped: it is no crossing, or one that is not to be passed.
    """
    stopped.row = k
    if crossed is None or stopped.arrival.kind not in ("branch point", "singular"):
        raise stopped
    found = branch_points.strip(branch, stopped.arrival.value)
    if found is None:
        raise stopped
    while k > 0 and found.holds(float(values[k - 1])):
        k -= 1
    crossed[:] = [(x, row) for x, row in crossed if row < k or not found.holds(x)]
    for row in range(k, len(values)):
        value = float(values[row])
        crossed += [(x, row) for x in found.crossed(float(values[max(row - 1, 0)]), value)]
        if not found.holds(value):
            found.leave(branch, value)
            if row == stopped.row and not abs(value - branch.s) < abs(
                    value - stopped.arrival.value):  # no nearer than before
                raise stopped
            return row
        found.put(branch, value)
        record.put(row, branch)
    return len(values)
