"""Commands that search: workspace, design, calibrate."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import spatial_pin as sp
from spatial_pin._support.output_files import write_columns
from spatial_pin.cli.goal_files import check_bounds, read_goals
from spatial_pin.cli.mechanism_arguments import (
    check_held,
    fitting,
    guess_of,
    held,
    in_units,
    loaded,
    or_partial_result,
    unique,
    workers,
)
from spatial_pin.cli.options import (
    GUESS,
    SPRINGS_HELP,
    WORKERS,
    Command,
    bounded,
    count,
    data_options,
    from_zero,
    hold_option,
    not_negative,
    option,
    positive,
    rising,
    spread,
    value,
)
from spatial_pin.cli.printing import print_result
from spatial_pin.cli.tables import check_sigma, read_measurements
from spatial_pin.units import LENGTHS
from spatial_pin.workspace.grid_axes import PARTS
from spatial_pin.workspace.section_curves import curve_columns
from spatial_pin.workspace.workspace_result import unit_of


def workspace(options: argparse.Namespace) -> None:
    """Where a frame gets to over ranges of drivers or poses."""
    mechanism = loaded(options)
    mechanism.frame_id(options.frame)
    check_held(options, mechanism)
    ranges = dict(options.ranges)
    in_units({"clearance": options.clearance}, *LENGTHS)
    if len(ranges) < len(options.ranges):
        options.usage_error("a name is given two ranges")
    for k in (0, 1):
        fitting(options, mechanism, {name: ends[k] for name, ends in ranges.items()})
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
            state = sp.assemble(result.mechanism, {}, guess_of(options, result.mechanism))
            yield sp.export_html(state, options.html, look=sp.Look(workspace=result))

    with workers(options.workers) as executor:
        result = or_partial_result(lambda: sp.workspace(
            mechanism, options.frame, ranges, points=options.points,
            guess=guess_of(options, mechanism), hold=held(options), task=options.task,
            limits=options.limits, on_crossing=options.on_crossing, clearance=options.clearance,
            sheets=options.sheets, executor=executor, progress=True))
    table = result.columns()
    columns = {name: column.tolist() for name, column in table.items()}
    print_result(options, result, {"mechanism": mechanism.name, "frame": result.frame,
                                         "columns": columns}, table, files(),
                 result.is_whole)


# ---------------------------------------------------------------- design


def design(options: argparse.Namespace) -> None:
    """Find dimensions that meet the goals."""
    mechanism = loaded(options)
    goals, bounds = read_goals(options.goals, mechanism)
    bounds |= dict(options.dimensions)
    if len(dict(options.dimensions)) < len(options.dimensions):
        options.usage_error("a name is given two ranges")
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
            mechanism, goals, bounds, guess=guess_of(options, mechanism), starts=options.starts,
            method=options.method, seed=options.seed, executor=executor, progress=True,
            resume=options.resume, most=options.most))
    names = list(designs[0].dimensions) if designs else []
    print_result(options, designs, designs.as_dict(),
                 {"design": list(range(1, len(designs) + 1)),
                  "error": [float(x.error) for x in designs],
                  **{name: [float(x.dimensions[name]) for x in designs] for name in names}},
                 files(), designs.is_whole)


# ---------------------------------------------------------------- calibrate


def calibrate(options: argparse.Namespace) -> None:
    """Find dimensions, offsets of encoders and the base from measurements."""
    mechanism = loaded(options)
    dimensions, sigma = dict(options.dimension), unique(options, options.sigma)
    if len(dimensions) < len(options.dimension):
        options.usage_error("a dimension is named twice")
    check_sigma(mechanism, sigma)
    measurements = read_measurements(options.table, mechanism, options.read)
    result = or_partial_result(lambda: sp.calibrate(
        mechanism, measurements, dimensions, offsets=options.offset, base=options.base,
        sigma=sigma or None, loss=options.loss, margin=options.margin,
        guess=guess_of(options, mechanism)))
    content: dict[str, Any] = result.as_dict()
    residuals = content["residuals"]
    table = {key: [row[key] for row in residuals] for key in residuals[0]} if residuals else {}
    files = [result.mechanism.save(options.folder)] if options.folder else []
    print_result(options, result, content, table, files, result.is_whole)


COMMANDS = {
    "workspace": Command(workspace, (
        option("frame", metavar="FRAME", help="link, frame or joint whose points are wanted"),
        option("ranges", nargs="+", type=rising, metavar="NAME=LO..HI",
               help="drivers, as crank=0..90deg, or parts of the frame's pose: x, y, z, "
                    "turn_x, turn_y, turn_z, as x=-0.2..0.2"),
        option("--points", type=count, help="number of values of each range"),
        option("--task", choices=("position", "pose"),
               help="motion that dexterity is computed for; of a grid of poses, whether the "
                    "orientation is held"),
        option("--limits", action=argparse.BooleanOptionalAction, default=True,
               help="keep the joint limits"),
        option("--on-crossing", choices=("stop", "straight"), default="stop",
               help="action where branches cross (stop)"),
        option("--clearance", type=not_negative, metavar="DISTANCE",
               help="links that are not joined keep this distance; 0: they do not touch"),
        option("--sheets", action="store_true",
               help="look for other branches over the same grid"),
        *WORKERS,
        *hold_option(SPRINGS_HELP),
        *GUESS,
        *data_options("the table", "a row for every point of the grid"),
        option("--curves", metavar="F",
               help="write boundary and singular curves of a grid of two (.csv)"),
        option("--picture", metavar="F", help="write a figure (.png, .svg, .pdf)"),
        option("--plane", choices=("xy", "xz", "yz"), help="that the figure shows"),
        option("--at", type=value, metavar="VALUE",
               help="position of the plane of a cross-section"),
        option("--html", metavar="F", help="write a page with the mechanism and its points"),
    )),
    "design": Command(design, (
        option("dimensions", nargs="*", default=[], type=bounded,
               metavar="NAME=LO..HI", help="a dimension that may change, and its bounds; "
               "NAME alone has none, NAME=LO.. one; besides those of the file"),
        option("--goals", metavar="F", required=True,
               help="goals: a .toml file with [[goal]] tables and [dimensions], "
                    "or a .csv file with columns as tip.x [mm], tip.y, tip.z (a path), with "
                    "tip.rx, tip.ry, tip.rz (poses), or coordinates (a function), and "
                    "drivers"),
        option("--starts", type=count, default=20, help="local solutions to try (20)"),
        option("--method", choices=("multistart", "atlas", "evolution", "local"),
               default="multistart", help="choice of their starts (multistart)"),
        option("--seed", type=from_zero, default=0, help="of random numbers (0)"),
        option("--most", type=count, default=10, help="number of designs in the result (10)"),
        *WORKERS,
        option("--resume", metavar="F",
               help="store results in this file, and continue from those in it"),
        *GUESS,
        option("--save", metavar="FOLDER", help="write the best as a mechanism"),
        *data_options("all designs", "error and dimensions, a design in every row,"),
        option("--html", metavar="F", help="write a page that shows the best with its goals"),
        option("--report", metavar="F",
               help="write a page to send and to print: the best with its goals"),
    )),
    "calibrate": Command(calibrate, (
        option("table", metavar="TABLE", help="a .csv file: a line of names, then a line of "
               "numbers for every pose; columns of drivers are readings of encoders, measured "
               "are tip.x [mm], tip.y, tip.z and tip.rx, tip.ry, tip.rz (rotation vector), "
               "coordinates, and NAME-OTHER, a distance; an empty field was not measured"),
        option("--dimension", action="append", default=[], type=bounded,
               metavar="NAME[=LO..HI]", help="a dimension to find, as b or b=0.3..0.4"),
        option("--offset", action="append", default=[], metavar="DRIVER",
               help="a driver whose encoder is off"),
        option("--base", action="store_true", help="points and placements were measured in "
               "axes of their own: find the pose of the mechanism in these"),
        option("--read", action="append", default=[], metavar="NAME",
               help="a coordinate that is read, besides the drivers"),
        option("--sigma", action="append", default=[], type=spread, metavar="NAME=VALUE",
               help="standard deviation of position, rotation, angle, length or encoder, or "
               "of one quantity, as position=0.02mm, crank.encoder=0.1deg"),
        option("--loss", choices=("linear", "soft_l1", "huber", "cauchy", "arctan"),
               default="linear", help="how much outliers count (linear: as the others)"),
        option("--margin", type=positive, default=1.5,
               help="distance of an outlier [sigma] (1.5)"),
        *GUESS,
        *data_options("the result", "the residuals, one a row,"),
        option("--folder", metavar="F", help="write the calibrated mechanism into a folder"),
    )),
}
