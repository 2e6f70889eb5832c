"""Commands of how motion is passed on: jacobian, transmission."""

from __future__ import annotations

import argparse

import numpy as np

import spatial_pin as sp
from spatial_pin._support.columns import Quantity, flat
from spatial_pin.assembly.holding import held_by
from spatial_pin.cli.arguments import along, check_names, held, loaded, motion_over, state_at
from spatial_pin.cli.options import (
    CONFIGURATION,
    SPRINGS_HELP,
    Command,
    data_options,
    hold_option,
    option,
    over_options,
)
from spatial_pin.cli.printing import finite, grid, print_result
from spatial_pin.motion.motion import first_samples
from spatial_pin.motion.summary import tidy
from spatial_pin.rates.rates import check_not_held

UNITS = {"v": "m", "w": "rad"}  # of what rows are rates of
ROWS = ("vx", "vy", "vz", "wx", "wy", "wz")


def jacobian(options: argparse.Namespace) -> None:
    """Twist of a frame per unit speed of every driver, loops closed."""
    mechanism = loaded(options)
    mechanism.frame_id(options.frame)
    check_names(options, mechanism)
    names = _movers(options, mechanism)
    by = [mechanism.driven_coordinate(name) for name in names]
    state = state_at(options, mechanism)
    found = sp.jacobian(mechanism, state, options.frame, options.by or None,
                        hold=held(options))
    units = [[_per(UNITS[row[0]], c.unit) for c in by] for row in ROWS]
    heads = [f"{name} [{c.unit}]" for name, c in zip(names, by, strict=True)]
    lines = [f"{mechanism.name}: twist of {options.frame} at its origin, world axes, per unit "
             "speed of the drivers, loops closed",
             grid([[row, UNITS[row[0]], *(tidy(x, found) for x in found[k])]
                   for k, row in enumerate(ROWS)], ("", "of", *heads))]
    table = {"component": list(ROWS), "of": [UNITS[row[0]] for row in ROWS],
             **{head: found[:, k].tolist() for k, head in enumerate(heads)}}
    print_result(options, "\n".join(lines), finite({
                "mechanism": mechanism.name, "frame": options.frame, "rows": list(ROWS),
                "drivers": names, "units": units, "matrix": found.tolist(),
                "closure_error": state.closure_error}), table)


def _movers(options: argparse.Namespace, mechanism: sp.Mechanism) -> list[str]:
    """Return the names of what moves the frame: those of `--by`, else the drivers not held.

    Raises:
        SpatialPinError: all drivers are held.
        ValueError: what is to move it is held.
    """
    if options.by:
        check_not_held(mechanism, [mechanism.driven_coordinate(x) for x in options.by],
                       held(options))
        return list(options.by)
    still = held_by(mechanism, held(options)).entries
    moving = [x for x in mechanism.drivers if mechanism.driven_coordinate(x).v not in still]
    if mechanism.drivers and not moving:
        raise sp.SpatialPinError(
            f"mechanism {mechanism.name!r}: nothing moves {options.frame!r}: "
            f"{', '.join(mechanism.drivers)} {'are' if len(mechanism.drivers) > 1 else 'is'} "
            "held; hold less, or name what moves it with --by")
    return moving


def _units(output: str, driver: str) -> dict[str, str]:
    return {"ratio": _per(output, driver), "angle": "rad",
            "mechanical_advantage": _per(driver, output)}


def _per(unit: str, by: str) -> str:
    return "1" if unit == by else f"{unit}/{by}"


# ---------------------------------------------------------------- transmission


def transmission(options: argparse.Namespace) -> None:
    """Speed ratio, mechanical advantage and transmission angle of an output."""
    mechanism = loaded(options)
    output = mechanism.driven_coordinate(options.output)
    for name in filter(None, [options.driver]):
        mechanism.driven_coordinate(name)
    motion = motion_over(options, mechanism, of_rates=True)
    if motion is not None:
        _tell_along(options, motion)
        return
    state = state_at(options, mechanism)
    found = sp.transmission(mechanism, state, output.name, options.driver, options.pair,
                            hold=held(options))
    driver = mechanism.driven_coordinate(options.driver or next(iter(mechanism.drivers)))
    units = _units(output.unit, driver.unit)
    shown = {"speed ratio": (found.ratio, units["ratio"]),
             "mechanical advantage": (found.mechanical_advantage, units["mechanical_advantage"]),
             "transmission angle": (found.angle, f"rad ({np.degrees(found.angle):.6g}°)")}
    rows = [[name, f"{x:.9g}", unit.removeprefix("1")] for name, (x, unit) in shown.items()]
    head = f"{mechanism.name}: {driver.name} moves {output.name} at {found.at}"
    content = {"mechanism": mechanism.name, "output": output.name, "driver": driver.name,
               **found._asdict(), "units": units, "closure_error": state.closure_error}
    print_result(options, f"{head}\n{grid(rows)}", finite(content),
                 {"quantity": list(units), "value": [float(getattr(found, name)) for name in units],
                  "unit": list(units.values())})


def _tell_along(options: argparse.Namespace, motion: sp.Motion) -> None:
    """Answer with the transmission along a sweep."""
    mechanism, driver = motion.mechanism, options.driver or motion.driver_name
    found: list[sp.Transmission] = along(options, lambda: _each(options, motion, driver))
    values, ratios, angles = (np.asarray(x)[: len(found)] for x in (
        motion.driver, [x.ratio for x in found], [x.angle for x in found]))
    units = _units(*(mechanism.driven_coordinate(x).unit for x in (options.output, driver)))
    table = flat({
        motion.driver_name: Quantity(values, motion.driver_unit),
        "ratio": Quantity(ratios, units["ratio"].replace("1", "-")),
        "mechanical advantage": Quantity(np.array([x.mechanical_advantage for x in found]),
                                         units["mechanical_advantage"].replace("1", "-")),
        "transmission angle": Quantity(angles, "rad")})
    unit, rows = motion.driver_unit, []
    for name, column, mark in (("speed ratio", ratios, ""),
                               ("transmission angle", np.degrees(angles), "°")):
        for word, k in (("least", int(column.argmin())), ("most", int(column.argmax()))):
            rows.append([word, name, f"{column[k]:.6g}{mark}",
                         f"at {motion.driver_name} = {values[k]:.6g} {unit}"])
    head = (f"{mechanism.name}: {driver} moves {options.output} at {found[0].at}, "
            f"{len(found)} values")
    content = {"mechanism": mechanism.name, "output": options.output, "driver": driver,
               "at": found[0].at, "units": units,
               "columns": {name: x.tolist() for name, x in table.items()}}
    print_result(options, f"{head}\n{grid(rows)}", finite(content), table)


def _each(options: argparse.Namespace, motion: sp.Motion, driver: str) -> list[sp.Transmission]:
    """Return the transmission at every sample.

    Raises:
        Interrupted: Ctrl-C ended it; has those until then.
    """
    found: list[sp.Transmission] = []
    try:
        for state in map(motion.state, range(len(motion))):
            found.append(sp.transmission(motion.mechanism, state, options.output, driver,
                                         options.pair, hold=held(options)))
    except KeyboardInterrupt:
        if not found:
            raise
        raise sp.Interrupted(first_samples(motion, len(found)), found) from None
    return found


COMMANDS = {
    "jacobian": Command(jacobian, (
        option("frame", metavar="FRAME", help="link, frame or joint whose twist is wanted"),
        *CONFIGURATION,
        option("--by", action="append", default=[], metavar="NAME",
               help="a driver or coordinate that moves it (all drivers)"),
        *hold_option(SPRINGS_HELP),
        *data_options("the matrix", "the matrix"),
    )),
    "transmission": Command(transmission, (
        option("output", metavar="OUTPUT", help="coordinate of a joint of one freedom"),
        *CONFIGURATION,
        option("--driver", metavar="NAME", help="what moves it (the only driver)"),
        option("--pair", metavar="NAME",
               help="closure or joint at which its link is moved, where there are several"),
        *over_options(SPRINGS_HELP),
        *data_options("it", "it, along --over one row a value,"),
    )),
}
