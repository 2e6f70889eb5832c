"""Dexterity over a grid, and singular configurations between its points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.numerics.linalg import Array, row_space, singular_values
from spatial_pin.numerics.roots import sign_change
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.workspace.filled_grid import FilledGrid, Index, signs
from spatial_pin.workspace.grid_lines import (
    Border,
    GridConfig,
    GridLine,
    motion_along,
    natural_jacobians,
    restarted,
)

SINGULAR = "determinant is zero"
LOCATED = 1e-9  # accuracy of a zero of a determinant, relative to a cell of the grid
TASKS = {"position": slice(0, 3), "pose": slice(0, 6)}


class FrameTask(NamedTuple):
    """The motions of a frame that the drivers must control."""

    name: str  # "position" or "pose"
    directions: Array  # (r, 3) or (r, 6) orthonormal directions of the frame's motion
    n_drivers: int  # number of drivers that move it

    @property
    def is_square(self) -> bool:
        """Whether there is a determinant: as many drivers as directions."""
        return len(self.directions) == self.n_drivers

    def matrices(self, jacobians: Array) -> Array:
        """Return (..., r, c) Jacobians along the directions."""
        return self.directions @ jacobians[..., TASKS[self.name], :]


def task_of(jacobians: Array, wanted: str | None) -> FrameTask:
    """Return the wanted task, "position" or "pose", for Jacobians (m, 6, c) in natural units.

    None: position, unless only poses have as many directions as there are drivers.
    """
    n = jacobians.shape[-1]
    known = jacobians[~np.isnan(jacobians).any(axis=(1, 2))]

    def task(name: str) -> FrameTask:
        part = known[:, TASKS[name]]
        columns = np.moveaxis(part, 1, 2).reshape(-1, part.shape[1])
        return FrameTask(name, row_space(columns, TOLERANCES.half_precision), n)

    if wanted is not None:
        return task(wanted)
    position = task("position")
    if position.is_square:
        return position
    pose = task("pose")
    return pose if pose.is_square else position


def measures(task: FrameTask, jacobians: Array) -> tuple[Array, Array]:
    """Return the dexterity (m,), least to largest singular value, and the least one (m,)."""
    ratio, least = np.full((2, len(jacobians)), np.nan)
    known = ~np.isnan(jacobians).any(axis=(1, 2))
    if known.any() and len(task.directions):
        s = singular_values(task.matrices(jacobians[known]))
        least[known] = s[:, -1]
        ratio[known] = s[:, -1] / np.maximum(s[:, 0], TOLERANCES.nothing)
    return ratio, least


def determinant_signs(filling: FilledGrid, task: FrameTask) -> NDArray[np.int8] | None:
    """Return the determinant's sign at each point of the grid; None without a determinant."""
    if not task.is_square or "jacobians" not in filling.data:
        return None
    jacobians = filling.data["jacobians"]
    determinants = np.full(filling.shape, np.nan)
    known = ~np.isnan(jacobians).any(axis=(-2, -1))
    determinants[known] = np.linalg.det(task.matrices(jacobians[known]))
    return signs(determinants)


def aspects_of(filling: FilledGrid, task: FrameTask) -> NDArray[np.intp]:
    """Return numbers of the connected parts of the grid without a change of sign.

    Without a determinant they are connected parts of the reached points; -1 elsewhere.
    """
    from scipy.ndimage import label  # on use: it takes a while to import

    numbers = np.full(filling.shape, -1)
    sign = determinant_signs(filling, task)
    parts = [filling.reached] if sign is None else [
        filling.reached & (sign == x) for x in (1, -1, 0)]
    count = 0
    for part in parts:
        labels, n = label(part)
        numbers[part] = labels[part] - 1 + count
        count += n
    return numbers


def crossed_cells(filling: FilledGrid, task: FrameTask) -> list[tuple[GridLine, int]]:
    """Return the edges of the grid with a change of the determinant's sign."""
    sign = determinant_signs(filling, task)
    cells: list[tuple[GridLine, int]] = []
    if sign is None:
        return cells
    for axis in range(sign.ndim):
        first, last = (np.take(sign, range(k, sign.shape[axis] - 1 + k), axis=axis)
                       for k in (0, 1))
        for index in np.argwhere(first * last < 0).tolist():
            point: Index = tuple(index)
            to = filling.ticks[axis][[point[axis] + 1]]
            cells.append((filling.run(axis, point, to), int(sign[point])))
    return cells


def located(
    task: FrameTask, config: GridConfig, cells: Sequence[tuple[GridLine, int]]
) -> list[Border | None]:
    """Return zeros of the determinant along edges; None if the branch ends before.

    For a grid of poses it is the determinant of the drivers' speeds by the frame's: at its zero the
    drivers do not determine the pose. Near it, the determinant of the frame's speeds by the
    drivers' changes its sign through infinity.
    """
    config = config._replace(limits=False)
    return [_zero(task, config, *cell) for cell in cells]


def _zero(task: FrameTask, config: GridConfig, run: GridLine, sign: int) -> Border | None:
    begin, to = float(run.at[run.axis]), float(run.values[0])

    def determinant(value: float) -> float:
        motion, n, _ = motion_along(config, run, np.array([value]))
        if n < 2:
            return np.nan
        jacobians = natural_jacobians(config, [motion.state(1)])
        if np.isnan(jacobians).any():  # drivers do not determine the pose: there it is infinite
            return 0.0 if config.is_posed else np.nan
        size = float(np.linalg.det(task.matrices(jacobians)[0]))
        return sign * (1.0 / size if config.is_posed else size)

    ends = np.array([begin + LOCATED * (to - begin), to])
    first, last = map(determinant, ends)
    if np.isnan(first) or not last <= LOCATED * abs(first):
        return None
    value = ends[int(first > 0.0)]  # a point of the grid may be the place itself
    if first > 0.0 > last:
        value = sign_change(determinant, ends[0], ends[1], first, last,
                            xtol=LOCATED * abs(to - begin), rtol=1e-15)
    motion, n, _ = motion_along(config, run, np.array([value]))
    if n < 2:
        return None
    zero = restarted(run, float(value), motion, 1)
    return Border(zero.at, motion.frame(config.frame).position[1], SINGULAR, zero.q, zero.angles)


def grid_of(ticks: Sequence[Array]) -> Array:
    """Return the points (N, k) of a grid, the last coordinate fastest."""
    return np.array(list(product(*ticks))).reshape(-1, len(ticks))
