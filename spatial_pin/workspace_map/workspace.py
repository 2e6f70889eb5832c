"""Where a frame can get to as drivers go over a grid, and how well they move it there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.checks import checked, finite_array, mapping, whole_number
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.mechanism.coordinates import coordinate_value, needed
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.methods import method
from spatial_pin.motion.follow import follow
from spatial_pin.motion.sweep import check_choice
from spatial_pin.numerics.linalg import Array
from spatial_pin.outputs import named_path, write_columns
from spatial_pin.progress import progress_bar
from spatial_pin.rates.jacobians import jacobian
from spatial_pin.workspace_map.dexterity import (
    TASKS,
    crossed_cells,
    grid_of,
    measures,
    task_of,
    work_of,
)
from spatial_pin.workspace_map.filling import Border, Filling, spread
from spatial_pin.workspace_map.lines import Asked, Followed, natural_jacobians

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# points of a grid: each keeps a configuration and a Jacobian, some 200 MB in all
MOST_POINTS = 200_000
USUAL, FINEST = 10_000, 41  # points of a grid where none are asked for, and of one coordinate
# points of the grid that are tried first, the nearest ones to the assembled state
STARTS_TRIED = 64


@dataclass(frozen=True, eq=False)
class Borders:
    """Places on the lines of a grid: where the branch ends, or a determinant vanishes.

    Attributes:
        drivers: (m, k) values of the grid's coordinates [rad or m].
        points: (m, 3) of the frame [m]; NaN where the branch could not be followed up to there.
        why: what each is, in words.
    """

    drivers: Array
    points: Array
    why: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.why)


@dataclass(frozen=True, eq=False)
class Workspace:
    """Where a frame gets to over a grid of drivers, on one branch.

    The N points of the grid are in rows, the last coordinate fastest.

    Attributes:
        mechanism: the mechanism.
        frame: whose points these are.
        names: the k coordinates that span the grid.
        shape: how many values each has.
        drivers: (N, k) their values [rad or m].
        reached: (N,) whether the branch gets there.
        points: (N, 3) of the frame in the world [m]; NaN where it is not reached.
        rotations: (N, 3, 3) of the frame, likewise.
        dexterity: (N,) least singular value of the closed-loop Jacobian in natural units (radians,
            characteristic lengths) relative to the largest: 1 all directions alike, 0 singular;
            NaN where it is not reached.
        least: (N,) that least singular value [-].
        why: why a point is not reached: "limit", "branch point", "singular", "lost" (the numbers
            gave out), "joint limit: " and which, "no way along the grid", "not looked at"; empty
            where it is.
        boundary: where the branch ends on lines of the grid.
        singular: where the determinant of the Jacobian vanishes on lines of the grid.
        task: "position" or "pose", what the Jacobian is of.
        directions: in how many directions the frame moves.
        n_drivers: by how many drivers; a determinant there is only if these are as many.
        is_whole: whether all was looked at, and nothing cut it short (Ctrl-C).
    """

    mechanism: Mechanism
    frame: str
    names: tuple[str, ...]
    shape: tuple[int, ...]
    drivers: Array
    reached: NDArray[np.bool_]
    points: Array
    rotations: Array
    dexterity: Array
    least: Array
    why: tuple[str, ...]
    boundary: Borders
    singular: Borders
    task: str
    directions: int
    n_drivers: int
    is_whole: bool
    _rows: Mapping[str, Array]

    @property
    def condition(self) -> Array:
        """The condition numbers (N,) of the Jacobian: 1/dexterity."""
        with np.errstate(divide="ignore"):
            return 1.0 / self.dexterity

    def state(self, row: int) -> State:
        """Return the configuration at a point of the grid.

        Raises:
            SpatialPinError: it is not reached, or there is no such point.
        """
        if not -len(self.reached) <= row < len(self.reached):
            raise SpatialPinError(f"there is no point {row}: the grid has {len(self.reached)}")
        if not self.reached[row]:
            raise SpatialPinError(f"point {row} of the grid is not reached: {self.why[row]}")
        return State(self.mechanism, self._rows["q"][row], angles=self._rows["angles"][row],
                     closure_error=float(self._rows["errors"][row]))

    def columns(self) -> dict[str, Any]:
        """Return the table that `to_csv` writes: values by heading."""
        units = [self.mechanism.prescribed_coordinate(name).unit for name in self.names]
        turns = np.array([pin.log3(r) if known else np.full(3, np.nan)
                          for r, known in zip(self.rotations, self.reached, strict=True)])
        table: dict[str, Any] = {f"{name} [{unit}]": x for name, unit, x in zip(
            self.names, units, self.drivers.T, strict=True)}
        table |= {f"{self.frame}.{x} [m]": p for x, p in zip("xyz", self.points.T, strict=True)}
        table |= {f"{self.frame}.r{x} [rad]": r for x, r in zip("xyz", turns.T, strict=True)}
        return table | {"reached": self.reached.astype(int), "dexterity [-]": self.dexterity,
                        "least singular value [-]": self.least, "why": np.array(self.why)}

    @checked
    def to_csv(self, path: str | Path) -> Path:
        """Write a row for every point of the grid; returns the path.

        Raises:
            OSError: it cannot be written; what was there before stays.
        """
        return write_columns(named_path(path), self.columns())

    @checked
    def plot(
        self, path: str | Path | None = None, *, plane: str | None = None,
        at: float | None = None, thickness: float | None = None,
    ) -> Figure:
        """Draw points in a plane, coloured by dexterity, with boundary and singular curves.

        Args:
            path: where to save it; None: not.
            plane: "xy", "xz" or "yz" of the world; default the one in which points are spread
                most.
            at: draw a cross-section: the third coordinate [m]; None: all points.
            thickness: of the cross-section [m]; default a twentieth of how far points are spread.

        Returns:
            A matplotlib figure.

        Raises:
            ValueError: there is no such plane, or the thickness is not above zero.
        """
        figure: Figure = method("Workspace.plot")(self, path, plane, at, thickness)
        return figure

    def __str__(self) -> str:
        n, total = int(self.reached.sum()), len(self.reached)
        lines = [f"{self.mechanism.name}: {self.frame} over {' x '.join(map(str, self.shape))} "
                 f"values of {', '.join(self.names)}: {n} of {total} points reached"
                 f"{'' if self.is_whole else ', cut short'}"]
        for why, count in Counter(filter(None, self.why)).most_common():
            lines.append(f"  not reached: {count} ({why})")
        low, high = (f(self.points[self.reached], axis=0) for f in (np.min, np.max))
        lines += [f"  {x} from {a:.6g} to {b:.6g} m"
                  for x, a, b in zip("xyz", low, high, strict=True)]
        if not np.isnan(self.dexterity).all():
            best, worst = int(np.nanargmax(self.dexterity)), int(np.nanargmin(self.dexterity))
            lines.append(f"  dexterity ({self.task}, {self.directions} directions by "
                         f"{self.n_drivers} drivers): {self.dexterity[worst]:.3g} at "
                         f"{self._named(worst)} to {self.dexterity[best]:.3g} at "
                         f"{self._named(best)}")
        ends = ", ".join(f"{count} {why}" for why, count in Counter(self.boundary.why).items())
        lines.append(f"  boundary on lines of the grid: {ends or 'none'}")
        lines.append(f"  the determinant vanishes at {len(self.singular)} places on them"
                     if self.directions == self.n_drivers else "  it has no determinant: "
                     "singular places between points of the grid are not looked for")
        return "\n".join(lines)

    def _named(self, row: int) -> str:
        return ", ".join(f"{name} = {x:.6g}" for name, x in zip(
            self.names, self.drivers[row].tolist(), strict=True))


@checked
def workspace(
    mechanism: Mechanism,
    frame: str,
    ranges: Mapping[str, Any],
    *,
    points: int | Mapping[str, int] | None = None,
    guess: Mapping[str, Any] | State | Array | None = None,
    task: str | None = None,
    limits: bool = True,
    on_crossing: str = "stop",
    executor: Executor | None = None,
    progress: bool = False,
) -> Workspace:
    """Return where a frame gets to as drivers go over a grid, and how well they move it there.

    The mechanism is assembled, follows its branch to the nearest point of the grid, and from
    there the lines of the grid, along all coordinates in turn, until no more is reached. Where the
    branch ends on a line (limit position, branch point, joint limit) the place is located as by
    `sweep`; where the determinant of the closed-loop Jacobian changes its sign between two
    points, to 1e-9 of their distance. Ctrl-C ends it with what was found until then.

    Args:
        mechanism: the mechanism.
        frame: link, frame or joint.
        ranges: (least, largest) by driver, or coordinate of a joint [rad or m]; other drivers stand
            where the guess has them.
        points: how many values each has, or by name; default some 10 000 in all, and 41 at most.
        guess: where to assemble, as for `assemble`: it decides on the branch.
        task: whether dexterity is of the frame's "position" or its "pose"; default the one which
            has a direction for each driver, position first.
        limits: whether joint limits are kept.
        on_crossing: "stop" where branches cross, beyond which the drivers do not determine where
            the mechanism goes, or "straight" to follow the one that goes straight on.
        executor: where lines are followed (any `concurrent.futures` executor, a Dask client's too);
            default in this process. The answer is the same.
        progress: show a bar on stderr after a second, if that is a terminal.

    Raises:
        AssemblyError: the guess does not close.
        SpatialPinError: the branch leads to no point of the grid near the assembled state.
        UnknownNameError: there is no such frame, or driver.
        ValueError: bounds are no two numbers, the first the smaller one, or there are too many
            points, 200 000 at most, or fewer than 2 of a coordinate.
    """
    needed(mechanism)
    mechanism.frame_id(mechanism.placed(frame))
    if task is not None:
        check_choice("task", task, tuple(TASKS))
    check_choice("on_crossing", on_crossing, ("stop", "straight"))
    names, ticks = _ticks(mechanism, ranges, points)
    start = assembled(mechanism, {}, guess)
    mechanism = start.mechanism
    columns = _columns(mechanism, start, frame, names)
    asked = Asked(mechanism, names, frame, columns, limits, on_crossing)
    filling = Filling(asked, ticks)
    _begin(filling, start)
    with progress_bar(filling.reached.size, f"{mechanism.name}: workspace", progress) as bar:
        bar.update(1)
        singular: list[Border] = []
        is_whole = False
        try:
            filling.fill(executor, bar.update)
            for border in _crossings(filling, task, executor):
                singular.append(border)
            is_whole = True
        except KeyboardInterrupt:  # what was found until then is the answer
            pass
    return _workspace(filling, task, singular, is_whole)


def _ticks(
    mechanism: Mechanism, ranges: Mapping[str, Any], points: int | Mapping[str, int] | None
) -> tuple[tuple[str, ...], list[Array]]:
    """Return names of coordinates, and the values of each."""
    spans: dict[str, tuple[str, float, float]] = {}
    for name, span in mapping(ranges, "ranges").items():
        coordinate = mechanism.prescribed_coordinate(name).name
        if coordinate in spans:
            raise ValueError(f"{coordinate!r} is given two ranges")
        low, high = finite_array(span, (2,), f"range of {name!r}").tolist()
        if not low < high:
            raise ValueError(f"range of {name!r} is {low:.9g} to {high:.9g}: the first is to be "
                             "the smaller one")
        spans[coordinate] = name, low, high
    if not spans:
        raise ValueError("ranges is empty: give (least, largest) for every driver that moves")
    counts = _counts([name for name, *_ in spans.values()], points)
    total = int(np.prod([float(n) for n in counts]))
    if total > MOST_POINTS:
        raise ValueError(f"the grid has {' x '.join(map(str, counts))} = {total} points; "
                         f"{MOST_POINTS} at most: give fewer `points`")
    return (tuple(name for name, *_ in spans.values()),
            [np.linspace(low, high, n)
             for (_, low, high), n in zip(spans.values(), counts, strict=True)])


def _counts(names: list[str], points: int | Mapping[str, int] | None) -> list[int]:
    if points is None:
        return [min(FINEST, int(USUAL ** (1.0 / len(names)) + 1e-9))] * len(names)
    if isinstance(points, Mapping):
        if set(points) != set(names):
            raise ValueError(f"points are given of {', '.join(map(repr, points)) or 'nothing'}; "
                             f"they are wanted of {', '.join(map(repr, names))}")
        counts = [whole_number(points[name], f"points of {name!r}") for name in names]
    else:
        counts = [whole_number(points, "points")] * len(names)
    if min(counts) < 2:
        raise ValueError(f"points is {min(counts)}; a range needs 2 at least")
    return counts


def _columns(
    mechanism: Mechanism, state: State, frame: str, names: tuple[str, ...]
) -> tuple[str, ...] | None:
    """Return what Jacobians are taken with respect to: all drivers (None), if they determine it."""
    drivers = {mechanism.prescribed_coordinate(d.joint) for d in mechanism.drivers.values()}
    if {mechanism.prescribed_coordinate(name) for name in names} <= drivers:
        try:
            jacobian(mechanism, state, frame)
        except SingularError:
            return names
        return None
    return names


def _begin(filling: Filling, start: State) -> None:
    """Go from the assembled state to the nearest point of the grid that the branch leads to.

    Raises:
        SpatialPinError: it leads to none of those near it.
    """
    asked, shape = filling.asked, filling.shape
    mechanism = asked.mechanism
    here = np.array([coordinate_value(mechanism, mechanism.prescribed_coordinate(name), start.q)
                     for name in asked.names])
    steps = np.array([ticks[1] - ticks[0] for ticks in filling.ticks])
    grid = grid_of(filling.ticks)
    far = np.linalg.norm((grid - here) / steps, axis=1)
    error: object = "joint limits are passed"
    for row in np.argsort(far, kind="stable")[:STARTS_TRIED].tolist():
        ways = {name: np.array([a, b]) for name, a, b in zip(
            asked.names, here.tolist(), grid[row].tolist(), strict=True)}
        try:
            motion = follow(mechanism, ways, guess=start, on_crossing="raise")
        except SpatialPinError as caught:
            error = caught
            continue
        beyond = beyond_limits(mechanism, motion.q[1]) if asked.limits else {}
        if beyond:
            error = f"{next(iter(beyond))} is beyond its joint limit"
            continue
        index = np.unravel_index(row, shape)
        at = motion.frame(asked.frame)
        found = Followed(motion.q[1:], motion.angles[1:], motion.closure_error[1:],
                         at.position[1:], at.rotation[1:],
                         natural_jacobians(asked, [motion.state(1)]), None)
        filling.place(tuple(int(i) for i in index), found, 0)
        return
    raise SpatialPinError(
        f"mechanism {mechanism.name!r}: the branch leads from the assembled state to no point of "
        f"the grid near it ({error}); give a guess inside of the ranges, or more points")


def _flat(filling: Filling, name: str) -> Array:
    """Return what is known of the grid's points in rows."""
    data = filling.data[name]
    return data.reshape(filling.reached.size, *data.shape[len(filling.shape) :])


def _crossings(
    filling: Filling, task: str | None, executor: Executor | None
) -> Iterator[Border]:
    """Yield where the determinant vanishes on lines of the grid."""
    asked_of = task_of(_flat(filling, "jacobians"), task)
    cells = crossed_cells(filling, asked_of)
    for border in spread(work_of(asked_of), filling.asked, cells, executor):
        if border is not None:
            yield border


def _workspace(
    filling: Filling, task: str | None, singular: list[Border], is_whole: bool
) -> Workspace:
    asked, jacobians = filling.asked, _flat(filling, "jacobians")
    found = task_of(jacobians, task)
    dexterity, least = measures(found, jacobians)
    why = tuple(filling.words(index, is_whole) for index in np.ndindex(*filling.shape))
    return Workspace(
        mechanism=asked.mechanism, frame=asked.frame, names=asked.names, shape=filling.shape,
        drivers=grid_of(filling.ticks), reached=filling.reached.ravel(),
        points=_flat(filling, "points"), rotations=_flat(filling, "rotations"),
        dexterity=dexterity, least=least, why=why,
        boundary=_borders(filling.borders, len(asked.names)),
        singular=_borders(singular, len(asked.names)), task=found.name,
        directions=len(found.directions), n_drivers=found.n_drivers, is_whole=is_whole,
        _rows={name: _flat(filling, name) for name in ("q", "angles", "errors")})


def _borders(found: list[Border], k: int) -> Borders:
    return Borders(np.array([b.drivers for b in found]).reshape(-1, k),
                   np.array([b.point for b in found]).reshape(-1, 3), tuple(b.why for b in found))
