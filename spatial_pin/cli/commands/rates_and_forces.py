"""Commands of how motion is passed on, and of forces at rest: jacobian, transmission, statics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from spatial_pin._support.columns import Quantity, flat
from spatial_pin.assembly.holding import held_by
from spatial_pin.cli import options as opt
from spatial_pin.cli.mechanism_arguments import Options, in_units
from spatial_pin.cli.printing import grid, print_result
from spatial_pin.motion.summary import EFFORTS, tidy
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import check_not_held

UNITS = {"v": "m", "w": "rad"}  # of the rows of velocity v and angular velocity w
ROWS = ("vx", "vy", "vz", "wx", "wy", "wz")
COMPONENTS = [(part, unit, axis) for part, unit in (("force", "N"), ("moment", "N·m"))
              for axis in "xyz"]
EFFORTS_OF_MANY = "* is one of many: the drivers can press against each other"


def jacobian(options: Options) -> None:
    """Twist of a frame per unit speed of every driver, loops closed."""
    mechanism = options.loaded
    mechanism.frame_id(options.frame)
    options.check_names()
    names = _movers(options)
    by = [mechanism.driven_coordinate(name) for name in names]
    state = options.state()
    matrix = sp.jacobian(mechanism, state, options.frame, options.by or None,
                        hold=options.held)
    units = [[_per(UNITS[row[0]], c.unit) for c in by] for row in ROWS]
    heads = [f"{name} [{c.unit}]" for name, c in zip(names, by, strict=True)]
    lines = [f"{mechanism.name}: twist of {options.frame} at its origin, world axes, per unit "
             "speed of the drivers, loops closed",
             grid([[row, UNITS[row[0]], *(tidy(x, matrix) for x in matrix[k])]
                   for k, row in enumerate(ROWS)], ("", "of", *heads))]
    table = {"component": list(ROWS), "of": [UNITS[row[0]] for row in ROWS],
             **{head: matrix[:, k].tolist() for k, head in enumerate(heads)}}
    print_result(options, "\n".join(lines), {
                "mechanism": mechanism.name, "frame": options.frame, "rows": list(ROWS),
                "drivers": names, "units": units, "matrix": matrix.tolist(),
                "closure_error": state.closure_error}, table)


def _movers(options: Options) -> list[str]:
    """Return the names of what moves the frame: those of `--by`, else the drivers not held."""
    mechanism = options.loaded
    if options.by:
        check_not_held(mechanism, [mechanism.driven_coordinate(x) for x in options.by],
                       options.held)
        return list(options.by)
    still = held_by(mechanism, options.held).entries
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


def transmission(options: Options) -> None:
    """Speed ratio, mechanical advantage and transmission angle of an output."""
    mechanism = options.loaded
    output = mechanism.driven_coordinate(options.output)
    for name in filter(None, [options.driver]):
        mechanism.driven_coordinate(name)
    motion = options.motion_over(of_rates=True)
    if motion is not None:
        _tell_along(options, motion)
        return
    state = options.state()
    result = sp.transmission(mechanism, state, output.name, options.driver, options.pair,
                            hold=options.held)
    driver = mechanism.driven_coordinate(options.driver or next(iter(mechanism.drivers)))
    units = _units(output.unit, driver.unit)
    shown = {"speed ratio": (result.ratio, units["ratio"]),
             "mechanical advantage": (result.mechanical_advantage, units["mechanical_advantage"]),
             "transmission angle": (result.angle, f"rad ({np.degrees(result.angle):.6g}°)")}
    rows = [[name, f"{x:.9g}", unit.removeprefix("1")] for name, (x, unit) in shown.items()]
    head = f"{mechanism.name}: {driver.name} moves {output.name} at {result.at}"
    content = {"mechanism": mechanism.name, "output": output.name, "driver": driver.name,
               **result._asdict(), "units": units, "closure_error": state.closure_error}
    print_result(options, f"{head}\n{grid(rows)}", content,
                 {"quantity": list(units),
                  "value": [float(getattr(result, name)) for name in units],
                  "unit": list(units.values())})


def _tell_along(options: Options, motion: sp.Motion) -> None:
    """Answer with the transmission along a sweep."""
    mechanism, driver = motion.mechanism, options.driver or motion.driver_name
    result = sp.transmission(mechanism, motion, options.output, driver, options.pair,
                             hold=options.held)
    values = np.asarray(motion.driver)
    units = _units(*(mechanism.driven_coordinate(x).unit for x in (options.output, driver)))
    table = flat({
        motion.driver_name: Quantity(values, motion.driver_unit),
        "ratio": Quantity(result.ratio, units["ratio"].replace("1", "-")),
        "mechanical advantage": Quantity(result.mechanical_advantage,
                                         units["mechanical_advantage"].replace("1", "-")),
        "transmission angle": Quantity(result.angle, "rad")})
    unit, rows = motion.driver_unit, []
    for name, column, mark in (("speed ratio", result.ratio, ""),
                               ("transmission angle", np.degrees(result.angle), "°")):
        for word, k in (("least", int(column.argmin())), ("most", int(column.argmax()))):
            rows.append([word, name, f"{column[k]:.6g}{mark}",
                         f"at {motion.driver_name} = {values[k]:.6g} {unit}"])
    head = (f"{mechanism.name}: {driver} moves {options.output} at {result.at}, "
            f"{len(motion)} values")
    content = {"mechanism": mechanism.name, "output": options.output, "driver": driver,
               "at": result.at, "units": units,
               "columns": {name: x.tolist() for name, x in table.items()}}
    print_result(options, f"{head}\n{grid(rows)}", content, table)


# ---------------------------------------------------------------- statics


def statics(options: Options) -> None:
    """Efforts that hold it at rest against gravity, springs and loads."""
    mechanism = options.loaded
    actuated = options.actuated or None
    for name in options.actuated:
        mechanism.driven_coordinate(name)
    external = external_forces(options)
    motion = options.motion_over()
    if motion is None:
        _print_efforts(options, sp.inverse_dynamics(
            mechanism, options.state(), actuated, external=external))
        return
    loads: sp.Kinetostatics = options.along(lambda: sp.kinetostatics(
        mechanism, motion, actuated, external=external))
    table = loads.columns()
    content = {"mechanism": mechanism.name,
               "columns": {name: x.tolist() for name, x in table.items()},
               "reactions": {name: x.tolist() for name, x in loads.reactions.items()},
               "on_ground": loads.on_ground.tolist()}
    print_result(options, loads, content, table)


def external_forces(options: Options) -> dict[str, pin.Force]:
    """Return the loads by link or frame."""
    forces = {}
    for name, given in options.unique(options.loads, "loads").items():
        options.loaded.frame_id(name)
        if len(given) not in (3, 6):
            options.usage_error(f"--load {name}: a force has 3 numbers, with a moment 6, not "
                                f"{len(given)}")
        force, moment = given[:3], given[3:] or (0.0, 0.0, 0.0)
        for x in force:
            in_units({f"a force on {name}": x}, "N", "kN")
        for x in moment:
            in_units({f"a moment on {name}": x}, "Nm", "N·m")
        forces[name] = pin.Force(np.array(force, dtype=float), np.array(moment, dtype=float))
    return forces


def _print_efforts(options: Options, result: sp.Efforts) -> None:
    """Answer with efforts and reactions of one configuration."""
    mechanism = options.loaded
    units = {name: EFFORTS[mechanism.coordinate(name).unit] for name in result.efforts}
    alone = result.unique_efforts
    efforts = [[name, f"{x:.9g}{'*' * (not alone[name])}", units[name]]
               for name, x in result.efforts.items()]
    whole = np.array([force.vector for force in result.reactions.values()])
    pairs = [[name, *_marked(force.linear, result.unique[name][:3], whole),
              *_marked(force.angular, result.unique[name][3:], whole)]
             for name, force in result.reactions.items()]
    lines = [f"{mechanism.name} at rest, closed to {result.state.closure_error:.1e}", "efforts:",
             grid(efforts), "reactions of pairs, world axes [N, N·m]:",
             grid(pairs, ("", "fx", "fy", "fz", "mx", "my", "mz"))]
    if not all(alone.values()):
        lines.append(EFFORTS_OF_MANY)
    lines += result.why_not_unique()
    content = {
        "mechanism": mechanism.name, "closure_error": result.state.closure_error,
        "coordinates": {name: result.state.coordinate(name).value
                        for name in mechanism.coordinates},
        "efforts": result.efforts, "units": units, "unique_efforts": alone, **balance(result)}
    print_result(options, "\n".join(lines), content, _table(result, units))


def balance(result: sp.Efforts | sp.Equilibrium) -> dict[str, Any]:
    """Return reactions as JSON has them, force then moment, and which of them are unique."""
    return {"reactions": {name: force.vector.tolist() for name, force in result.reactions.items()},
            "unique": {name: each.tolist() for name, each in result.unique.items()},
            "on_ground": result.on_ground.vector.tolist()}


def _table(result: sp.Efforts, units: dict[str, str]) -> dict[str, list[Any]]:
    """Return efforts and reactions, a number a row; named as `Kinetostatics.columns` names them."""
    rows = [(f"{name} effort", x, units[name], result.unique_efforts[name])
            for name, x in result.efforts.items()]
    ground = {"on ground": (result.on_ground, np.ones(6, dtype=bool))}
    for name, (force, single) in ({f"{name} reaction": (x, result.unique[name])
                                  for name, x in result.reactions.items()} | ground).items():
        rows += [(f"{name} {part} {axis}", float(x), unit, bool(one)) for (part, unit, axis), x, one
                 in zip(COMPONENTS, force.vector, single, strict=True)]
    return dict(zip(("quantity", "value", "unit", "unique"), map(list, zip(*rows, strict=True)),
                    strict=True))


def _marked(x: Array, unique: Any, whole: Array) -> list[str]:
    """Return components, 0 where they are round-off of the whole, * where they are of many."""
    return [f"{float(tidy(c, whole)):.4g}{'*' * (not one)}"
            for c, one in zip(x, unique, strict=True)]


COMMANDS = {
    "jacobian": opt.Command(jacobian, (
        opt.option("frame", "link, frame or joint whose twist is wanted", metavar="FRAME"),
        *opt.CONFIGURATION,
        opt.many("--by", "a driver or coordinate that moves it (all drivers)"),
        opt.hold_option(opt.SPRINGS_HELP),
        *opt.data_options("the matrix", "the matrix"),
    )),
    "transmission": opt.Command(transmission, (
        opt.option("output", "coordinate of a joint of one freedom", metavar="OUTPUT"),
        *opt.CONFIGURATION,
        opt.option("--driver", "what moves it (the only driver)", metavar="NAME"),
        opt.option("--pair", "closure or joint at which its link is moved, where there are several",
                   metavar="NAME"),
        *opt.over_options(opt.SPRINGS_HELP),
        *opt.data_options("it", "it, along --over one row a value,"),
    )),
    "statics": opt.Command(statics, (
        *opt.CONFIGURATION,
        opt.many("--load",
                 "a force [N], and moment [N·m], on a link or frame at its origin, world axes, as "
                 "tip=0,0,-50N", dest="loads", type=opt.numbers,
                 metavar="NAME=FX,FY,FZ[,MX,MY,MZ]"),
        opt.many("--actuated", "a driver, joint or coordinate that holds it (all drivers)"),
        *opt.over_options(),
        *opt.data_options("efforts and reactions",
                          "efforts and reactions, along --over one a column,"),
    )),
}
