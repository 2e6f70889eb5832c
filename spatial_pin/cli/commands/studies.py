"""Commands of what dimensions change, and settings: sensitivity, tolerance, tradeoff."""

from __future__ import annotations

from typing import Any

import numpy as np

import spatial_pin as sp
from spatial_pin._support.columns import heading
from spatial_pin.accuracy.tradeoff_view import table
from spatial_pin.cli import options as opt
from spatial_pin.cli.commands.motions import beginning, sweep_task
from spatial_pin.cli.mechanism_arguments import Options, in_units, or_partial_result, workers
from spatial_pin.cli.printing import print_result
from spatial_pin.dimensions.bounds import check_dimensions
from spatial_pin.dimensions.sensitivity import unit_of_derivative
from spatial_pin.motion.motion import first_samples
from spatial_pin.motion.outputs import label_of

OUTPUT_HELP = ("as rocker_pin, rocker_pin.rate, coupler.position, crank.effort, "
               "limit.lower.rocker_pin")
WIDE_SPREAD = 0.1  # standard deviation relative to the dimension from which a unit may be missing
XYZ = ("x", "y", "z")
UNITS = {"time_per_step": "s", "spread": "s", **dict.fromkeys(  # of others "-", of texts none
    ("setting", "steps", "solver_steps", "below_reference", "on_front", "note"), "")}
PARTS = "closure errors, errors of positions, velocities and accelerations: --csv, --json"
COMPONENTS = {3: XYZ, 6: tuple(f"{part} {axis}" for part in ("force", "moment") for axis in XYZ)}


def _numbers(name: str, value: Any) -> dict[str, float]:
    """Return the numbers of an output by name: `NAME.x` of a vector, `NAME.force.x` of a wrench."""
    value = np.asarray(value)
    if value.ndim == 0:
        return {name: float(value)}
    return {f"{name}.{axis.replace(' ', '.')}": float(x)
            for axis, x in zip(COMPONENTS[len(value)], value, strict=True)}


# ---------------------------------------------------------------- sensitivity


def sensitivity(options: Options) -> None:
    """How an output changes with the dimensions."""
    mechanism = options.loaded
    check_dimensions(mechanism, options.to)
    if not mechanism.dimensions:
        options.hints.append(f"{mechanism.name} has no dimensions: "
                             '<xacro:arg name="b" default="0.4"/> in a .xacro tree makes one')
    subject = options.motion_over() or options.state()
    result = options.along(lambda: sp.sensitivity(
        mechanism, subject, options.output, options.to or None))
    content = {"mechanism": mechanism.name, "output": result.output, "unit": result.unit,
               "derivative_unit": unit_of_derivative(result.unit),
               "value": np.asarray(result.value).tolist(),
               "derivatives": {k: np.asarray(x).tolist() for k, x in result.derivatives.items()},
               "errors": {k: np.asarray(x).tolist() for k, x in result.errors.items()},
               "idle": result.idle}
    if isinstance(subject, sp.Motion):
        subject = first_samples(subject, len(result.value))
        content["driver"] = {"name": subject.driver_name, "unit": subject.driver_unit,
                             "values": np.asarray(subject.driver).tolist()}
        print_result(options, _along(subject, result), content, _columns(subject, result))
        return
    rows = [(name, *row) for name, x in result.derivatives.items() for row in zip(
        _numbers(result.output, x), _numbers("", x).values(),
        np.broadcast_to(result.errors[name], np.shape(x) or (1,)), strict=True)]
    print_result(options, f"{mechanism.name}: {result}", content,
                 {"dimension": [row[0] for row in rows], "of": [row[1] for row in rows],
                  "derivative": [row[2] for row in rows], "error": [float(row[3]) for row in rows],
                  "unit": [unit_of_derivative(result.unit)] * len(rows)})


def _columns(motion: sp.Motion, result: sp.Sensitivity) -> dict[str, Any]:
    """Return an output and its derivatives along a sweep, by name."""
    columns: dict[str, Any] = {heading(motion.driver_name, motion.driver_unit): motion.driver}
    unit = "-" if result.unit in ("", "1") else result.unit
    for name, of, x in [(label_of(result.output), unit, result.value),
                        *((f"d/d {k}", "", x) for k, x in result.derivatives.items())]:
        x = np.asarray(x)
        columns |= {heading(name, of): x} if x.ndim == 1 else {
            heading(f"{name} {axis}", of): x[:, k] for k, axis in enumerate(COMPONENTS[x.shape[1]])}
    return columns


def _along(motion: sp.Motion, result: sp.Sensitivity) -> str:
    """Return how large derivatives get along a sweep, and where."""
    values = np.asarray(motion.driver)
    lines = [f"{motion.mechanism.name}: {result.output} over {motion.driver_name}, "
             f"{len(values)} values"]
    lines += [f"  d/d {name} = 0: it changes nothing in the file" for name in result.idle]
    for name, x in result.derivatives.items():
        if name in result.idle:
            continue
        size = np.abs(x) if np.ndim(x) == 1 else np.linalg.norm(x, axis=1)
        k = int(size.argmax())
        lines.append(f"  d/d {name}: at most {size[k]:.9g}, at {motion.driver_name} = "
                     f"{values[k]:.6g} {motion.driver_unit} (± {np.max(result.errors[name]):.0e}) "
                     f"[{unit_of_derivative(result.unit)}]")
    return "\n".join(lines)


# ---------------------------------------------------------------- tolerance


def tolerance(options: Options) -> None:
    """How an output scatters when the dimensions do."""
    mechanism = options.loaded
    spread = options.unique(options.deviation)
    check_dimensions(mechanism, spread)
    in_units(spread, "m", "cm", "mm", "um", "in", "rad", "deg", "°")
    for name, x in spread.items():
        nominal = abs(mechanism.dimensions[name])
        if not getattr(x, "unit", "") and nominal > 0.0 and x > WIDE_SPREAD * nominal:
            options.hints.append(f"{name} scatters by {x / nominal:.0%} of its "
                                 f"{mechanism.dimensions[name]:.6g}: {x:g}mm?")
    state = options.state()
    with workers(options.workers) as executor:
        result = or_partial_result(lambda: sp.tolerance(
            mechanism, [options.output, *options.also], spread, state, samples=options.samples,
            executor=executor, seed=options.seed, progress=True))
    kinds = {"nominal": result.nominal, "linear": result.linear,
             **({"mean": result.mean, "sampled": result.sampled} if result.sampled else {})}
    content = {"mechanism": mechanism.name, "units": result.units, "deviations": spread,
               "samples": len(result.is_closed), "failed": result.failed,
               "is_whole": result.is_whole,
               **{kind: {k: np.asarray(x).tolist() for k, x in (of or {}).items()}
                  for kind, of in kinds.items()}}
    columns = {kind: [x for name, value in (of or {}).items()
                      for x in _numbers(name, value).values()] for kind, of in kinds.items()}
    names = [(one, result.units[name]) for name, value in result.nominal.items()
             for one in _numbers(name, value)]
    print_result(options, f"{mechanism.name}: {result}", content,
                 {"output": [name for name, _ in names], "unit": [unit for _, unit in names],
                  **columns},
                 is_whole=result.is_whole)


# ---------------------------------------------------------------- tradeoff


def tradeoff(options: Options) -> None:
    """Measure what accuracy settings cost and lose on a motion of it."""
    mechanism = options.loaded
    task = _task(options)
    result = or_partial_result(lambda: sp.tradeoff(
        mechanism, task, repeats=options.repeats, progress=True))
    text, files = f"{table(result, is_narrow=True)}\n{PARTS}", []
    if not result.is_whole:
        text += "\ncut short"
    elif options.error is not None:
        pick = sp.Accuracy.for_error(options.error, measured=result)
        text += f"\ncheapest for an error of {options.error:.3g}: {pick}"
    if options.plot:
        result.plot(options.plot)
        files.append(options.plot)
    content = result.as_dict()
    keys = [key for key, x in content["rows"][0].items() if not isinstance(x, list | dict)]
    print_result(options, text, content, {heading(key, UNITS.get(key, "-")): [
                row[key] for row in content["rows"]] for key in keys}, files, result.is_whole)


def _task(options: Options) -> str | dict[str, Any]:
    """What a trade-off is measured on."""
    if options.simulate is None:
        if options.at or options.begin or options.effort or options.rows:
            options.usage_error("--at, --begin, --effort and --rows need --simulate")
        if options.driver is None:
            if options.hold:
                options.usage_error("--hold needs a driver, a first and a last value")
            return "sweep"
        if options.last is None:
            options.usage_error("a sweep needs a driver, a first and a last value")
        still = {"hold": options.held} if options.hold else {}
        return sweep_task(options) | still
    if options.driver is not None or options.speed is not None or options.acceleration:
        options.usage_error("--simulate takes no driver to sweep: its speeds are given by --begin")
    if options.hold:
        options.usage_error("--hold is of a sweep: in a simulation forces move all")
    given = options.at or options.begin or options.effort or options.rows or options.guess
    if not options.simulate:
        if given:
            options.usage_error("--simulate needs a duration with these options")
        return "simulate"
    state, efforts = beginning(options, options.begin, options.simulate)
    return {"state": state, "duration": options.simulate, "efforts": efforts,
            "times": np.linspace(0.0, options.simulate, options.rows or 201)}


COMMANDS = {
    "sensitivity": opt.Command(sensitivity, (
        opt.option("output", OUTPUT_HELP, metavar="OUTPUT"),
        *opt.CONFIGURATION,
        *opt.RATE_OPTIONS,
        opt.many("--to", "a dimension that changes (all)"),
        *opt.over_options(),
        *opt.data_options("the derivatives", "derivatives, along --over one a column,"),
    )),
    "tolerance": opt.Command(tolerance, (
        opt.option("output", OUTPUT_HELP, metavar="OUTPUT"),
        *opt.CONFIGURATION,
        *opt.RATE_OPTIONS,
        opt.many("--also", "another output, of the same samples", metavar="OUTPUT"),
        opt.many("--deviation", "standard deviation of a dimension, as b=0.1mm", required=True,
                 type=opt.spread, metavar="NAME=VALUE"),
        opt.option("--samples", "number of mechanisms to draw, besides the linear estimate (0)",
                   type=opt.from_zero, default=0),
        opt.option("--seed", "of random numbers (0)", type=opt.from_zero, default=0),
        *opt.WORKERS,
        *opt.data_options("means and spreads", "means and spreads"),
    )),
}
ACCURACY = {
    "tradeoff": opt.Command(tradeoff, (
        *opt.sweep_arguments(needed=False),
        opt.hold_option(opt.SPRINGS_HELP),
        opt.option("--simulate",
                   "a simulation instead of a sweep, as 10 or 500ms (a few seconds under gravity)",
                   nargs="?", const=0.0, type=opt.above_zero, metavar="DURATION"),
        *opt.start_options("--begin"),  # --speed is that of a sweep
        opt.option("--rows", "number of its rows (201)", type=opt.count),
        opt.option("--repeats", "runs of each setting (5)", type=opt.count, default=5),
        opt.option("--error", "name the cheapest setting for this error", type=opt.positive),
        *opt.data_options("the table", "a setting in every row,"),
        opt.file_option("--plot", "write a figure (.png, .svg, .pdf)"),
    )),
}
