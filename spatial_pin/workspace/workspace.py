"""Workspace: points that a frame reaches over a grid of drivers or poses, and its dexterity."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np

from spatial_pin._support.checks import checked, positive_number
from spatial_pin._support.progress import progress_bar
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import BASE, Hold, hold_names
from spatial_pin.assembly.state import State
from spatial_pin.errors import SingularError, SpatialPinError, unless_cut
from spatial_pin.mechanism.coordinates import (
    coordinate_value,
    driver_coordinates,
    require_mechanism,
)
from spatial_pin.mechanism.joint_limits import beyond_limits
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.follow import follow
from spatial_pin.motion.sweep import check_choice
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.jacobians import jacobian
from spatial_pin.rates.rates import check_not_held
from spatial_pin.workspace.dexterity import (
    TASKS,
    aspects_of,
    crossed_cells,
    grid_of,
    located,
    measures,
    task_of,
)
from spatial_pin.workspace.filled_grid import FilledGrid, one_of, other_starts, spread
from spatial_pin.workspace.grid_axes import posed, read_ranges
from spatial_pin.workspace.grid_lines import Border, GridConfig, touching
from spatial_pin.workspace.workspace_result import Borders, Workspace

STARTS_TRIED = 64  # points of the grid tried as first ones, the nearest to the assembled state


@checked
def workspace(
    mechanism: Mechanism,
    frame: str,
    ranges: Mapping[str, Any],
    *,
    points: int | Mapping[str, int] | None = None,
    guess: Mapping[str, Any] | State | Array | None = None,
    hold: Hold = BASE,
    task: str | None = None,
    limits: bool = True,
    on_crossing: str = "stop",
    clearance: float | None = None,
    sheets: bool = False,
    executor: Executor | None = None,
    progress: bool = False,
) -> Workspace:
    """Return the points that a frame reaches over a grid of drivers or poses, and its dexterity.

    The mechanism is assembled, follows its branch to the nearest point of the grid, and from there
    the lines of the grid, along all coordinates in turn, until no more is reached. Where the branch
    ends on a line (limit position, branch point, joint limit) the place is located as by `sweep`;
    where the determinant of the closed-loop Jacobian changes its sign between two points, to 1e-9
    of their distance. Ctrl-C ends the search, see `Interrupted`.

    In a grid of poses each point is a pose of the frame: the drivers follow, as in `reach_path`.
    Parts of the pose that are not given keep the guess's value, if they can be chosen
    independently: a Gough platform keeps its orientation.

    Args:
        mechanism: the mechanism.
        frame: link, frame or joint.
        ranges: (least, largest) by driver, or coordinate of a joint [rad or m]; other drivers keep
            their values from the guess. Or of the frame's pose: "x", "y", "z" [m] of its origin in
            the world, "turn_x", "turn_y", "turn_z" [rad], Cardan angles about its own axes, one
            after the other, from the orientation that the guess has; below a right angle.
        points: how many values each has, or by name; default some 10 000 in all, and 41 at most.
        guess: where to assemble, as for `assemble`: it decides the branch.
        hold: names of other joints that keep their values from the guess, as for `sweep`.
        task: whether dexterity is of the frame's "position" or its "pose"; default the one which
            has a direction for each driver, position first. Of a grid of poses, whether its
            orientation is kept ("pose") or free.
        limits: whether joint limits are kept.
        on_crossing: "stop" where branches cross, beyond which the drivers do not determine where
            the mechanism goes, or "straight" to follow the one that goes straight on.
        clearance: least distance [m] that links which are not joined keep, as `sp.clearance`
            measures it; 0: they do not touch. None: not checked.
        sheets: whether other branches are looked for: other assembly modes that lie over the grid,
            or, where it is one of poses, other ways to reach them. Each is one of `sheets`.
        executor: where lines are followed (any `concurrent.futures` executor, a Dask client's too);
            default in this process. The answer is the same.
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The Workspace; `print` it for a summary.

    Raises:
        AssemblyError: the guess does not close.
        SpatialPinError: the branch leads to no point of the grid near the assembled state; the
            pose leaves freedoms open.
        UnknownNameError: there is no such frame, or driver.
        ValueError: bounds are not two numbers, the smaller one first, or there are too many points,
            200 000 at most, or fewer than 2 of a coordinate; ranges are of drivers and of poses, or
            of parts of a pose that cannot change each for itself.
        Interrupted: after Ctrl-C; `.result` has the points that were reached until then.

    Example:
        >>> mech = sp.load("delta")
        >>> ranges = {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}  # of the platform's origin [m]
        >>> found = sp.workspace(mech, "platform", ranges, points=5)
        >>> found.points.shape, int(found.reached.sum())  # (N, 3), of 25 points
        ((25, 3), 19)
    """
    require_mechanism(mechanism)
    mechanism.frame_id(mechanism.placed(frame))
    if task is not None:
        check_choice("task", task, tuple(TASKS))
    check_choice("on_crossing", on_crossing, ("stop", "straight"))
    if clearance is not None and clearance != 0.0:
        clearance = positive_number(clearance, "clearance")
    names, ticks, is_posed = read_ranges(mechanism, frame, ranges, points)
    start = assembled(mechanism, {}, guess)
    held = hold_names(hold)
    config, start, task = _configured(start, frame, names, task, held, is_posed)
    config = config._replace(limits=limits, on_crossing=on_crossing, apart=clearance)
    first = FilledGrid(config, ticks)
    _begin(first, start)
    fillings = [(first, list[Border]())]
    is_whole = False
    with progress_bar(first.reached.size, f"{mechanism.name}: workspace", progress) as bar:
        bar.update(1)
        try:
            _fill(*fillings[0], task, executor, bar.update)
            for index, other in other_starts(first) if sheets else ():
                if any(filling.holds(index, other) for filling, _ in fillings):
                    continue
                bar.reset()
                fillings.append((FilledGrid(config, ticks), []))
                fillings[-1][0].enter(index, other, 0)
                _fill(*fillings[-1], task, executor, bar.update)
            is_whole = True
        except KeyboardInterrupt:  # the result has the lines until then
            pass
    others = tuple(_workspace(*x, task, names, is_whole) for x in fillings[1:])
    return unless_cut(_workspace(*fillings[0], task, names, is_whole, others))


def _configured(
    start: State, frame: str, names: tuple[str, ...], task: str | None, hold: tuple[str, ...],
    is_posed: bool,
) -> tuple[GridConfig, State, str | None]:
    """Return the settings of the grid, the start, and the task."""
    mechanism = start.mechanism
    if not is_posed:
        check_not_held(mechanism, [mechanism.prescribed_coordinate(x) for x in names], hold)
        columns = _columns(mechanism, start, frame, names, hold)
        return (GridConfig(mechanism, names, frame, columns, True, "stop", (), hold, mechanism),
                start, task)
    copy, coordinates, others, task = posed(start, frame, names, task, hold)
    columns = _columns(mechanism, start, frame, (), hold)
    whole = tuple(coordinates[name] for name in names)
    standing = tuple(coordinates[name] for name in others)
    return (GridConfig(copy.mechanism, whole, frame, columns, True, "stop", standing, hold,
                       mechanism), copy, task)


def _fill(
    filling: FilledGrid, singular: list[Border], task: str | None, executor: Executor | None,
    tell: Any,
) -> None:
    """Fill a grid from its first point, and add zeros of its determinant to a list."""
    filling.fill(executor, tell)
    frame_task = task_of(_flat(filling, "jacobians"), task)
    cells = crossed_cells(filling, frame_task)
    for border in spread(partial(located, frame_task), filling.config, cells, executor):
        if border is not None:
            singular.append(border)


def _columns(
    mechanism: Mechanism, state: State, frame: str, names: tuple[str, ...], hold: Hold
) -> tuple[str, ...] | None:
    """Return the coordinates of the Jacobians: all drivers (None), if they determine the motion."""
    drivers = {*driver_coordinates(mechanism).values()}
    if {mechanism.prescribed_coordinate(name) for name in names} <= drivers:
        try:
            jacobian(mechanism, state, frame, hold=hold)
        except SingularError:
            return names
        return None
    return names


def _begin(filling: FilledGrid, start: State) -> None:
    """Move from the assembled state to the nearest point of the grid on the branch."""
    config, shape = filling.config, filling.shape
    mechanism = config.mechanism
    here = np.array([coordinate_value(mechanism, mechanism.prescribed_coordinate(name), start.q)
                     for name in config.names])
    steps = np.array([ticks[1] - ticks[0] for ticks in filling.ticks])
    grid = grid_of(filling.ticks)
    far = np.linalg.norm((grid - here) / steps, axis=1)
    error: object = "joint limits are passed"
    distances = config.distances()
    for row in np.argsort(far, kind="stable")[:STARTS_TRIED].tolist():
        ways = {name: np.array([a, b]) for name, a, b in zip(
            config.names, here.tolist(), grid[row].tolist(), strict=True)}
        try:
            motion = follow(mechanism, ways, guess=start, hold=[*config.hold, *config.standing],
                            on_crossing="raise")
        except SpatialPinError as caught:
            error = caught
            continue
        beyond = beyond_limits(mechanism, motion.q[1]) if config.limits else {}
        if beyond:
            error = f"{next(iter(beyond))} is beyond its joint limit"
            continue
        if near := touching(config, distances, motion.q[1]):
            error = near
            continue
        index = np.unravel_index(row, shape)
        point = one_of(config, motion.state(1))
        filling.enter(tuple(int(i) for i in index), point, 0)
        return
    raise SpatialPinError(
        f"mechanism {mechanism.name!r}: the branch leads from the assembled state to no point of "
        f"the grid near it ({error}); give a guess inside of the ranges, or more points")


def _flat(filling: FilledGrid, name: str) -> Array:
    """Return data of the grid's points in rows."""
    data = filling.data[name]
    return data.reshape(filling.reached.size, *data.shape[len(filling.shape) :])


def _workspace(
    filling: FilledGrid, singular: list[Border], task: str | None, names: tuple[str, ...],
    is_whole: bool, sheets: tuple[Workspace, ...] = (),
) -> Workspace:
    config, jacobians = filling.config, _flat(filling, "jacobians")
    frame_task = task_of(jacobians, task)
    dexterity, least = measures(frame_task, jacobians)
    why = tuple(filling.words(index, is_whole) for index in np.ndindex(*filling.shape))
    rows = {name: _flat(filling, name) for name in ("q", "angles", "errors")}
    rows["q"] = rows["q"][:, : config.body.model.nq]
    return Workspace(
        mechanism=config.body, frame=config.frame, names=names, shape=filling.shape,
        drivers=grid_of(filling.ticks), reached=filling.reached.ravel(),
        points=_flat(filling, "points"), rotations=_flat(filling, "rotations"),
        dexterity=dexterity, least=least, why=why,
        boundary=_borders(filling.borders, len(names)), singular=_borders(singular, len(names)),
        aspects=aspects_of(filling, frame_task).ravel(), sheets=sheets, task=frame_task.name,
        directions=len(frame_task.directions), n_drivers=frame_task.n_drivers, is_whole=is_whole,
        _rows=rows, _source=(config, filling.ticks, [*filling.borders, *singular], frame_task))


def _borders(borders: list[Border], k: int) -> Borders:
    return Borders(np.array([b.drivers for b in borders]).reshape(-1, k),
                   np.array([b.point for b in borders]).reshape(-1, 3),
                   tuple(b.why for b in borders))
