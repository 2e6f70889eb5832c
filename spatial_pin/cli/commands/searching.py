"""Commands that search: workspace, design, calibrate; and the files of goals.

A TOML file of goals has an array of tables `[[goal]]`, each with the `kind` of a goal of `sp.goals`
and the arguments of its function, and a table `[dimensions]` with the least and the largest value
of each that may change. Numbers are SI, or texts with a unit ("60deg", "12mm").
"""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from spatial_pin._support.output_files import write_columns
from spatial_pin.cli import options as opt
from spatial_pin.cli.mechanism_arguments import Options, in_units, or_partial_result, workers
from spatial_pin.cli.printing import print_result
from spatial_pin.cli.tables import check_sigma, read_measurements, read_table, targets_of
from spatial_pin.dimensions.bounds import Bounds
from spatial_pin.errors import SpatialPinError, suggestion
from spatial_pin.formats.file_access import parse_toml
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.synthesis import goals
from spatial_pin.synthesis.precision import Goal
from spatial_pin.units import LENGTHS, ValueWithUnit, quantity
from spatial_pin.workspace.grid_axes import PARTS
from spatial_pin.workspace.section_curves import curve_columns
from spatial_pin.workspace.workspace_result import unit_of

EXACT = "exact"  # a weight in the file: the goal is to be met exactly
KINDS: dict[str, Callable[..., Goal]] = {
    name: make for name, make in vars(goals).items()
    if inspect.isfunction(make) and make.__module__ == goals.__name__ and name[0] != "_"}
# units of numbers, by goal and argument: "m", "rad", or that of the coordinate an argument names
BASES = {
    ("path", "points"): "m", ("function", "values"): "output", ("swing", "angle"): "output",
    ("transmission", "at_least"): "rad", ("clearance", "at_least"): "m", ("size", "at_most"): "m",
}
_NUMBER = re.compile(r"\s*[-+]?\.?\d")


def read_goals(path: str | Path, mechanism: Mechanism) -> tuple[list[Goal], dict[str, Bounds]]:
    """Return the goals of a .toml or .csv file, and the bounds (least, most) by dimension."""
    path = Path(path)
    if path.suffix.lower() != ".toml":
        return _goals_of_table(path, mechanism, {}), {}
    content = parse_toml(path.read_text(encoding="utf-8-sig"), path)
    for key in content:
        if key not in ("goal", "dimensions"):
            raise SpatialPinError(f"{path}: there is no table {key!r}; it has [[goal]] for every "
                                  "goal, and [dimensions]")
    tables, bounds = content.get("goal", []), content.get("dimensions", {})
    if not (isinstance(tables, list) and all(isinstance(x, dict) for x in tables) and tables):
        raise SpatialPinError(f"{path}: there is no goal; write [[goal]], and below it its kind")
    if not isinstance(bounds, dict):
        raise SpatialPinError(f"{path}: dimensions is a table [dimensions] of NAME = [least, most]")
    goals = []
    for k, table in enumerate(tables, start=1):
        try:
            goals += _goals(path, mechanism, dict(table))
        except (SpatialPinError, ValueError, TypeError) as error:
            raise SpatialPinError(f"{path}: goal {k}: {error}") from error
    return goals, {name: _bounds(path, name, given) for name, given in bounds.items()}


def _bounds(path: Path, name: str, given: Any) -> Bounds:
    if given == "free":
        return None
    try:
        low, high = (None if x == "free" else x if isinstance(x, ValueWithUnit) else float(x)
                     for x in map(_plain, given))
    except (TypeError, ValueError):
        raise SpatialPinError(f"{path}: dimension {name} is [least, most] or \"free\", as either "
                              f"of both may be, not {given!r}") from None
    return low, high


def check_bounds(bounds: Mapping[str, Bounds]) -> None:
    """Refuse bounds with units of something else than a length or an angle, or of one of each."""
    for name, ends in bounds.items():
        given = [x for x in ends or () if isinstance(x, ValueWithUnit) and x.unit]
        units = " and ".join(x.unit for x in given)
        if not any(all(x.is_for(base) for x in given) for base in ("m", "rad")):
            raise ValueError(f"bounds of {name} are in {units}; a dimension is a length or an "
                             "angle")


# ---------------------------------------------------------------- goals in TOML


def _goals(path: Path, mechanism: Mechanism, table: dict[str, Any]) -> list[Goal]:
    """Return the goal of a table, or those of the .csv file that it names."""
    if "weight" in table:
        given = table["weight"]
        table["weight"] = None if given == EXACT else _plain(given)
    if "table" in table:
        kind, name = table.pop("kind", None), table.pop("table")
        goals = _goals_of_table(path.parent / str(name), mechanism, table)
        if kind is not None and any(x.name.split()[0] != kind for x in goals):
            raise ValueError(f"{name} has columns of {' and '.join(x.name for x in goals)}, "
                             f"which is no {kind}")
        return goals
    kind = table.pop("kind", None)
    make = KINDS.get(kind) if isinstance(kind, str) else None
    if make is None:
        given = "it has no kind" if kind is None else f"kind is {kind!r}"
        raise ValueError(f"{given}; {suggestion(str(kind), KINDS)}")
    parameters = inspect.signature(make).parameters
    for key in table:
        if key not in parameters:
            raise ValueError(f"{kind} has no {key!r}; {suggestion(key, parameters)}")
    for key, parameter in parameters.items():
        if key not in table and parameter.default is parameter.empty:
            raise ValueError(f"{kind} needs {key!r}")
    arguments = {key: _argument(mechanism, str(kind), key, table) for key in table}
    return [make(**arguments)]


def _argument(mechanism: Mechanism, kind: str, key: str, table: Mapping[str, Any]) -> Any:
    """Return an argument of a goal as its function takes it."""
    given = table[key]
    if key == "drivers" and isinstance(given, dict):
        return {name: _in_units(f"{key}: {name}", _plain(values), mechanism.coordinate(name).unit)
                for name, values in given.items()}
    value = given if key == "weight" else _plain(given)
    if key == "placements" and isinstance(value, list):
        placements = []  # x, y, z, rx, ry, rz (rotation vector); a matrix as it is
        for i, x in enumerate(value):
            if isinstance(x, list) and len(x) == 6:
                for number, base in zip(x, ("m", "m", "m", "rad", "rad", "rad"), strict=True):
                    _in_units(f"placement {i}", number, base)
                numbers = np.array(x, dtype=float)
                x = pin.SE3(pin.exp3(numbers[3:]), numbers[:3])
            placements.append(x)
        return placements
    base = BASES.get((kind, key), "")
    if base == "output":
        base = mechanism.coordinate(str(table.get("output"))).unit
    return _in_units(key, value, base)


def _plain(given: Any) -> Any:
    """Return a file's values; texts that begin with a number become quantities."""
    if isinstance(given, str) and _NUMBER.match(given):
        return quantity(given)
    if isinstance(given, list):
        return [_plain(x) for x in given]
    if isinstance(given, dict):
        return {key: _plain(x) for key, x in given.items()}
    return given


def _in_units(key: str, given: Any, base: str) -> Any:
    """Return a value after a check of its units."""
    if isinstance(given, ValueWithUnit) and base and not given.is_for(base):
        raise ValueError(f"{key} is in {base}, not in {given.unit}")
    if isinstance(given, list):
        for x in given:
            _in_units(key, x, base)
    return given


# ---------------------------------------------------------------- goals in a table


def _goals_of_table(
    path: Path, mechanism: Mechanism, more: Mapping[str, Any]
) -> list[Goal]:
    """Return goals for the columns of a .csv file; `more` are their other arguments.

    `NAME.x`, `NAME.y`, `NAME.z` are a path, with `NAME.rx`, `NAME.ry`, `NAME.rz` poses; columns of
    drivers are their values there; those of other coordinates are functions of the drivers.
    """
    columns, times = read_table(path, mechanism)
    if times is not None:
        raise SpatialPinError(f"{path}: a design has no time; name a driver, and its values")
    targets = targets_of(path, mechanism, columns)
    moved = {mechanism.driven_coordinate(name).name for name in mechanism.drivers}
    drivers = {name: x for name, x in targets.items() if name in moved}
    goals = []
    for name, target in targets.items():
        if name in moved:
            continue
        kind = "poses"
        if isinstance(target, np.ndarray):
            kind = "path" if target.ndim == 2 else "function"
        parameters = inspect.signature(KINDS[kind]).parameters
        for key in more:
            if key not in parameters:
                raise ValueError(f"{kind} has no {key!r}; {suggestion(key, parameters)}")
        goals.append(KINDS[kind](name, target, drivers, **more))
    if not goals:
        raise SpatialPinError(f"{path}: there is no goal: columns NAME.x, NAME.y, NAME.z of a "
                              "frame, or of a coordinate that is no driver")
    return goals


# ---------------------------------------------------------------- workspace


def workspace(options: Options) -> None:
    """Where a frame gets to over ranges of drivers or poses."""
    mechanism = options.loaded
    mechanism.frame_id(options.frame)
    options.check_held()
    in_units({"clearance": options.clearance}, *LENGTHS)
    ranges = options.unique(options.ranges, "ranges")
    for k in (0, 1):
        options.fitting({name: ends[k] for name, ends in ranges.items()})
        for name, ends in ranges.items():
            unit = unit_of(mechanism, name) if name in PARTS else ""
            if unit and not ends[k].is_for(unit):
                raise ValueError(f"{name} is in {unit}, not in {ends[k].unit}")

    def files() -> Iterator[Path | str]:
        if options.curves:
            yield write_columns(Path(options.curves), curve_columns(result, result.curves()))
        if options.picture:
            result.plot(options.picture, plane=options.plane, at=options.at)
            yield options.picture
        if options.html:
            state = sp.assemble(result.mechanism, {}, options.start_guess)
            yield sp.export_html(state, options.html, look=sp.Look(workspace=result))

    with workers(options.workers) as executor:
        result = or_partial_result(lambda: sp.workspace(
            mechanism, options.frame, ranges, points=options.points,
            guess=options.start_guess, hold=options.held, task=options.task,
            limits=options.limits, on_crossing=options.on_crossing, clearance=options.clearance,
            sheets=options.sheets, executor=executor, progress=True))
    table = result.columns()
    columns = {name: column.tolist() for name, column in table.items()}
    print_result(options, result, {"mechanism": mechanism.name, "frame": result.frame,
                                         "columns": columns}, table, files(),
                 result.is_whole)


# ---------------------------------------------------------------- design


def design(options: Options) -> None:
    """Find dimensions that meet the goals."""
    mechanism = options.loaded
    goals, bounds = read_goals(options.goals, mechanism)
    bounds |= options.unique(options.dimensions, "ranges")
    if not bounds:
        options.usage_error("nothing may change: name dimensions, as r2=50mm..0.6")
    check_bounds(bounds)

    def files() -> Iterator[Path | str]:
        if designs and options.save:
            yield designs[0].mechanism.save(options.save)
        if designs and options.html:
            yield sp.export_html(designs, options.html)
        if designs and options.report:
            yield sp.report(designs, options.report)

    with workers(options.workers) as executor:
        designs = or_partial_result(lambda: sp.design(
            mechanism, goals, bounds, guess=options.start_guess, starts=options.starts,
            method=options.method, seed=options.seed, executor=executor, progress=True,
            resume=options.resume, most=options.most))
    names = list(designs[0].dimensions) if designs else []
    print_result(options, designs, designs.as_dict(),
                 {"design": list(range(1, len(designs) + 1)),
                  "error": [float(x.error) for x in designs],
                  **{name: [float(x.dimensions[name]) for x in designs] for name in names}},
                 files(), designs.is_whole)


# ---------------------------------------------------------------- calibrate


def calibrate(options: Options) -> None:
    """Find dimensions, offsets of encoders and the base from measurements."""
    mechanism = options.loaded
    dimensions, sigma = dict(options.dimension), options.unique(options.sigma)
    if len(dimensions) < len(options.dimension):
        options.usage_error("a dimension is named twice")
    check_sigma(mechanism, sigma)
    measurements = read_measurements(options.table, mechanism, options.read)
    result = or_partial_result(lambda: sp.calibrate(
        mechanism, measurements, dimensions, offsets=options.offset, base=options.base,
        sigma=sigma or None, loss=options.loss, margin=options.margin,
        guess=options.start_guess))
    content: dict[str, Any] = result.as_dict()
    residuals = content["residuals"]
    table = {key: [row[key] for row in residuals] for key in residuals[0]} if residuals else {}
    files = [result.mechanism.save(options.folder)] if options.folder else []
    print_result(options, result, content, table, files, result.is_whole)


COMMANDS = {
    "workspace": opt.Command(workspace, (
        opt.option("frame", "link, frame or joint whose points are wanted", metavar="FRAME"),
        opt.option("ranges",
                   "drivers, as crank=0..90deg, or parts of the frame's pose: x, y, z, turn_x, "
                   "turn_y, turn_z, as x=-0.2..0.2", nargs="+", type=opt.rising,
                   metavar="NAME=LO..HI"),
        opt.option("--points", "number of values of each range", type=opt.count),
        opt.option("--task",
                   "motion that dexterity is computed for; of a grid of poses, whether the "
                   "orientation is held", choices=("position", "pose")),
        opt.option("--limits", "keep the joint limits", action=argparse.BooleanOptionalAction,
                   default=True),
        opt.option("--on-crossing", "action where branches cross (stop)",
                   choices=("stop", "straight"), default="stop"),
        opt.option("--clearance",
                   "links that are not joined keep this distance; 0: they do not touch",
                   type=opt.not_negative, metavar="DISTANCE"),
        opt.switch("--sheets", "look for other branches over the same grid"),
        *opt.WORKERS,
        opt.hold_option(opt.SPRINGS_HELP),
        *opt.GUESS,
        *opt.data_options("the table", "a row for every point of the grid"),
        opt.file_option("--curves", "write boundary and singular curves of a grid of two (.csv)"),
        opt.file_option("--picture", "write a figure (.png, .svg, .pdf)"),
        opt.option("--plane", "that the figure shows", choices=("xy", "xz", "yz")),
        opt.option("--at", "position of the plane of a cross-section", type=opt.value,
                   metavar="VALUE"),
        opt.file_option("--html", "write a page with the mechanism and its points"),
    )),
    "design": opt.Command(design, (
        opt.option("dimensions",
                   "a dimension that may change, and its bounds; NAME alone has none, NAME=LO.. "
                   "one; besides those of the file", nargs="*", default=[], type=opt.bounded,
                   metavar="NAME=LO..HI"),
        opt.file_option("--goals",
                        "goals: a .toml file with [[goal]] tables and [dimensions], or a .csv "
                        "file with columns as tip.x [mm], tip.y, tip.z (a path), with tip.rx, "
                        "tip.ry, tip.rz (poses), or coordinates (a function), and drivers",
                        required=True),
        opt.option("--starts", "local solutions to try (20)", type=opt.count, default=20),
        opt.option("--method", "choice of their starts (multistart)",
                   choices=("multistart", "atlas", "evolution", "local"), default="multistart"),
        opt.option("--seed", "of random numbers (0)", type=opt.from_zero, default=0),
        opt.option("--most", "number of designs in the result (10)", type=opt.count, default=10),
        *opt.WORKERS,
        opt.file_option("--resume", "store results in this file, and continue from those in it"),
        *opt.GUESS,
        opt.option("--save", "write the best as a mechanism", metavar="FOLDER"),
        *opt.data_options("all designs", "error and dimensions, a design in every row,"),
        opt.file_option("--html", "write a page that shows the best with its goals"),
        opt.file_option("--report", "write a page to send and to print: the best with its goals"),
    )),
    "calibrate": opt.Command(calibrate, (
        opt.option("table",
                   "a .csv file: a line of names, then a line of numbers for every pose; columns "
                   "of drivers are readings of encoders, measured are tip.x [mm], tip.y, tip.z "
                   "and tip.rx, tip.ry, tip.rz (rotation vector), coordinates, and NAME-OTHER, a "
                   "distance; an empty field was not measured", metavar="TABLE"),
        opt.many("--dimension", "a dimension to find, as b or b=0.3..0.4", type=opt.bounded,
                 metavar="NAME[=LO..HI]"),
        opt.many("--offset", "a driver whose encoder is off", metavar="DRIVER"),
        opt.switch("--base",
                   "points and placements were measured in axes of their own: find the pose of "
                   "the mechanism in these"),
        opt.many("--read", "a coordinate that is read, besides the drivers"),
        opt.many("--sigma",
                 "standard deviation of position, rotation, angle, length or encoder, or of one "
                 "quantity, as position=0.02mm, crank.encoder=0.1deg", type=opt.spread,
                 metavar="NAME=VALUE"),
        opt.option("--loss", "how much outliers count (linear: as the others)",
                   choices=("linear", "soft_l1", "huber", "cauchy", "arctan"), default="linear"),
        opt.option("--margin", "distance of an outlier [sigma] (1.5)", type=opt.positive,
                   default=1.5),
        *opt.GUESS,
        *opt.data_options("the result", "the residuals, one a row,"),
        opt.file_option("--folder", "write the calibrated mechanism into a folder"),
    )),
}
