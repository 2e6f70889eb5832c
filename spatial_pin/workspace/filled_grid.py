"""Filling a grid of drivers or poses from one of its points, line by line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.progress import in_order
from spatial_pin.assembly.holding import held_by, is_base
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.coordinates import coordinate_value
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mobility.assembly_modes import assembly_modes
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.workspace.grid_lines import (
    Border,
    GridConfig,
    GridLine,
    LinePoints,
    followed,
    natural_jacobians,
    touching,
)

LINES_TOGETHER = 16  # lines that a worker gets at a time: the mechanism is sent with them
NOT_CONNECTED = "no way along the grid"
NOT_LOOKED_AT = "not looked at"
Index = tuple[int, ...]


class FilledGrid:
    """A grid with its reached points.

    Attributes:
        ticks: values by coordinate.
        reached: (n_1, ..., n_k) whether the point is reached.
        why: by index, why a point beyond an end is not reached.
        borders: ends of the branch.
        q, angles, errors, points, rotations, jacobians: at the grid's points, as in `LinePoints`;
            NaN if not reached.
    """

    def __init__(self, config: GridConfig, ticks: Sequence[Array]) -> None:
        self.config, self.ticks = config, ticks
        self.shape = tuple(map(len, ticks))
        self.reached = np.zeros(self.shape, dtype=bool)
        self.why: dict[Index, str] = {}
        self.borders: list[Border] = []
        self.data: dict[str, Array] = {}
        self._ended: set[tuple[int, int, Index]] = set()

    def enter(self, index: Index, rows: LinePoints, row: int) -> None:
        """Store a configuration at a point of the grid."""
        for name in LinePoints._fields[:-1]:
            values = getattr(rows, name)
            if name not in self.data:
                self.data[name] = np.full((*self.shape, *values.shape[1:]), np.nan)
            self.data[name][index] = values[row]
        self.reached[index] = True
        self.why.pop(index, None)

    def holds(self, index: Index, other: LinePoints) -> bool:
        """Whether a configuration is the one at a point of the grid, with equal frames."""
        if not self.reached[index]:
            return False
        mechanism, positions = self.config.mechanism, []
        for q in (self.data["q"][index], other.q[0]):  # idle rotations do not move origins
            data = mechanism.model.createData()
            pin.framesForwardKinematics(mechanism.model, data, q)
            positions.append(np.array([at.translation for at in data.oMf]))
        off = np.abs(positions[0] - positions[1]).max() / mechanism.characteristic_length
        return bool(off < TOLERANCES.half_precision)

    def at(self, index: Index) -> Array:
        """Return the values (k,) of the grid's coordinates at a point."""
        return np.array([ticks[i] for ticks, i in zip(self.ticks, index, strict=True)])

    def run(self, axis: int, index: Index, values: Array) -> GridLine:
        """Return the line from a point of the grid to values of one of its coordinates."""
        q, angles, error = (self.data[x][index] for x in ("q", "angles", "errors"))
        return GridLine(axis, self.at(index), values, q, angles, float(error))

    def fill(self, executor: Executor | None, tell: Callable[[float], Any]) -> None:
        """Follow lines along all coordinates in turn until nothing more is reached."""
        idle, axis = 0, 0
        while idle < len(self.shape):
            lines = list(self._lines(axis))
            runs = [self.run(axis, line[0], self.ticks[axis][[i[axis] for i in line[1:]]])
                    for line in lines]
            ends = spread(followed, self.config, runs, executor)
            for line, rows in zip(lines, ends, strict=False):
                tell(self._take(axis, line, rows))
            idle = 0 if lines else idle + 1
            axis = (axis + 1) % len(self.shape)

    def _lines(self, axis: int) -> Iterator[list[Index]]:
        """Yield lists of neighbours along a coordinate: a reached one, then others."""
        n = self.shape[axis]
        lines = np.moveaxis(self.reached, axis, -1)
        for rest in np.ndindex(*lines.shape[:-1]):
            line = lines[rest]
            if line.all() or not line.any():
                continue
            for i in np.flatnonzero(line).tolist():
                for step in (1, -1):
                    j = i + step
                    while 0 <= j < n and not line[j]:
                        j += step
                    line_ahead = [(*rest[:axis], x, *rest[axis:]) for x in range(i, j, step)]
                    if len(line_ahead) > 1 and (axis, step, line_ahead[0]) not in self._ended:
                        yield line_ahead

    def _take(self, axis: int, line: list[Index], rows: LinePoints) -> int:
        """Store the points of a line; return the number of new ones."""
        m, new = len(rows.q), 0
        step = line[1][axis] - line[0][axis]
        for row, index in enumerate(line[1:m + 1]):
            if not self.reached[index]:  # by the way that comes from the other side
                self.enter(index, rows, row)
                new += 1
        if (end := rows.end) is not None:
            self._ended |= {(axis, step, line[0]), (axis, step, line[m])}
            self.borders.append(end)
            for index in line[m + 1 :]:
                if not self.reached[index]:
                    self.why.setdefault(index, end.why)
        return new

    def words(self, index: Index, is_whole: bool) -> str:
        """Return why a point is not reached; empty if it is."""
        if self.reached[index]:
            return ""
        return self.why.get(index, NOT_CONNECTED if is_whole else NOT_LOOKED_AT)


def spread(
    work: Callable[[GridConfig, Sequence[Any]], list[Any]], config: GridConfig, jobs: Sequence[Any],
    executor: Executor | None,
) -> Iterator[Any]:
    """Yield the results of jobs in their order, from this process or the executor."""
    parts = [(config, jobs[k : k + LINES_TOGETHER]) for k in range(0, len(jobs), LINES_TOGETHER)]
    for results in in_order(executor, work, parts):
        yield from results


def signs(values: Array) -> NDArray[np.int8]:
    """Return 1 for values from zero up, -1 below, 0 for unknown ones."""
    return np.where(np.isnan(values), 0, np.where(values < 0.0, -1, 1)).astype(np.int8)


SEEDS_A_COORDINATE = 3  # values of each coordinate at which assembly modes are searched
MOST_LOOKED_AT = 30  # points of that search in all
PATIENCE = 200  # starts without a new mode after which the search at a point ends


def other_starts(filling: FilledGrid) -> Iterator[tuple[Index, LinePoints]]:
    """Yield configurations of other assembly modes at points of a grid, in their order.

    The first reached point of the known branch comes first, then points all over the grid.
    """
    config, mechanism = filling.config, filling.config.mechanism
    # held coordinates, but for free bases, which stand anyway
    held = held_by(mechanism, [x for x in config.hold if not is_base(mechanism, x)])
    names = [*config.names, *config.standing, *(
        c.name for c in mechanism.coordinate_table.values()
        if c in held.coordinates or c.v in held.entries)]
    first: Index = tuple(np.argwhere(filling.reached)[0].tolist())
    begin = filling.data["q"][first]
    fixed = [coordinate_value(mechanism, mechanism.prescribed_coordinate(n), begin)
             for n in names[len(config.names):]]
    distances = config.distances()
    each = [sorted({round(x) for x in np.linspace(0, n - 1, SEEDS_A_COORDINATE + 2)[1:-1]})
            for n in filling.shape]
    seeds: list[Index] = list(product(*each))
    step = -(-len(seeds) // MOST_LOOKED_AT)
    for index in dict.fromkeys([first, *seeds[::step]]):
        values = dict(zip(names, [*filling.at(index).tolist(), *fixed], strict=True))
        try:
            modes = assembly_modes(mechanism, values, patience=PATIENCE)
        except SpatialPinError:  # it cannot be closed there, or moves with all of them held
            continue
        for state in modes:
            is_beyond = config.limits and beyond_limits(mechanism, state.q)
            if not is_beyond and not touching(config, distances, state.q):
                yield index, one_of(config, state)


def one_of(config: GridConfig, state: State) -> LinePoints:
    """Return a configuration as a line of one point."""
    at = state.placement(config.frame)
    return LinePoints(state.q[None], np.asarray(state.angles)[None],
                    np.array([state.closure_error]), at.translation[None], at.rotation[None],
                    natural_jacobians(config, [state]), None)
