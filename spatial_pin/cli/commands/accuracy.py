"""The command that measures what accuracy costs: tradeoff."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import spatial_pin as sp
from spatial_pin._support.columns import heading
from spatial_pin.accuracy.tradeoff_view import table
from spatial_pin.cli.arguments import as_far_as_found, held, loaded
from spatial_pin.cli.commands.motions import beginning, sweep_task
from spatial_pin.cli.options import (
    SPRINGS_HELP,
    Command,
    above_zero,
    count,
    data_options,
    hold_option,
    option,
    positive,
    start_options,
    sweep_arguments,
)
from spatial_pin.cli.printing import finite, print_result

UNITS = {"time_per_step": "s", "spread": "s", **dict.fromkeys(  # of others "-", of texts none
    ("setting", "steps", "solver_steps", "below_reference", "on_front", "said"), "")}
PARTS = "errors of positions, velocities and accelerations one by one: --csv, --json"


def tradeoff(options: argparse.Namespace) -> None:
    """Measure what accuracy settings cost and lose on a motion of it."""
    mechanism = loaded(options)
    task = _task(options, mechanism)
    found = as_far_as_found(lambda: sp.tradeoff(
        mechanism, task, repeats=options.repeats, progress=True))
    text, files = f"{table(found, is_narrow=True)}\n{PARTS}", []
    if not found.is_whole:
        text += "\ncut short"
    elif options.error is not None:
        pick = sp.Accuracy.for_error(options.error, measured=found)
        text += f"\ncheapest for an error of {options.error:.3g}: {pick}"
    if options.plot:
        found.plot(options.plot)
        files.append(options.plot)
    content = finite(found.as_dict())
    keys = [key for key, x in content["rows"][0].items() if not isinstance(x, list | dict)]
    print_result(options, text, content, {heading(key, UNITS.get(key, "-")): [
                row[key] for row in content["rows"]] for key in keys}, files, found.is_whole)


def _task(options: argparse.Namespace, mechanism: sp.Mechanism) -> str | dict[str, Any]:
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
        still = {"hold": held(options)} if options.hold else {}
        return sweep_task(options, mechanism) | still
    if options.driver is not None or options.speed is not None or options.acceleration:
        options.usage_error("--simulate takes no driver to sweep: its speeds are given by --begin")
    if options.hold:
        options.usage_error("--hold is of a sweep: in a simulation forces move all")
    said = options.at or options.begin or options.effort or options.rows or options.guess
    if not options.simulate:
        if said:
            options.usage_error("--simulate needs a duration where more is said")
        return "simulate"
    state, efforts = beginning(options, mechanism, options.begin, options.simulate)
    return {"state": state, "duration": options.simulate, "efforts": efforts,
            "times": np.linspace(0.0, options.simulate, options.rows or 201)}


COMMANDS = {
    "tradeoff": Command(tradeoff, (
        *sweep_arguments(needed=False),
        *hold_option(SPRINGS_HELP),
        option("--simulate", nargs="?", const=0.0, type=above_zero, metavar="DURATION",
               help="a simulation instead of a sweep, as 10 or 500ms "
                    "(a few seconds under gravity)"),
        *start_options("--begin"),  # --speed is that of a sweep
        option("--rows", type=count, help="number of its rows (201)"),
        option("--repeats", type=count, default=5, help="runs of each setting (5)"),
        option("--error", type=positive, help="name the cheapest setting for this error"),
        *data_options("the table", "a setting in every row,"),
        option("--plot", metavar="F", help="write a figure (.png, .svg, .pdf)"),
    )),
}
