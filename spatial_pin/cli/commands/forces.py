"""The command of forces at rest: statics."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from spatial_pin.cli.arguments import along, in_units, loaded, motion_over, state_at
from spatial_pin.cli.options import (
    CONFIGURATION,
    Command,
    data_options,
    numbers,
    option,
    over_options,
)
from spatial_pin.cli.printing import finite, grid, print_result
from spatial_pin.motion.summary import EFFORTS, tidy
from spatial_pin.numerics.linalg import Array

COMPONENTS = [(part, unit, axis) for part, unit in (("force", "N"), ("moment", "N·m"))
              for axis in "xyz"]
EFFORTS_OF_MANY = "* is one of many: the drivers can press against each other"


def statics(options: argparse.Namespace) -> None:
    """Efforts that hold it at rest against gravity, springs and loads."""
    mechanism = loaded(options)
    actuated = options.actuated or None
    for name in options.actuated:
        mechanism.driven_coordinate(name)
    external = {name: _wrench(name, given) for name, given in _loads(options, mechanism).items()}
    motion = motion_over(options, mechanism)
    if motion is not None:
        _tell_curve(options, along(options, lambda: sp.kinetostatics(
            mechanism, motion, actuated, external=external)))
        return
    found = sp.inverse_dynamics(mechanism, state_at(options, mechanism), actuated,
                                external=external)
    _tell_forces(options, mechanism, found)


def _loads(
    options: argparse.Namespace, mechanism: sp.Mechanism
) -> dict[str, tuple[float, ...]]:
    found = dict(options.loads)
    if len(found) < len(options.loads):
        options.usage_error("a name is given two loads")
    for name, given in found.items():
        mechanism.frame_id(name)
        if len(given) not in (3, 6):
            options.usage_error(f"--load {name}: a force has 3 numbers, with a moment 6, not "
                                f"{len(given)}")
    return found


def _wrench(name: str, given: tuple[float, ...]) -> pin.Force:
    force, moment = given[:3], given[3:] or (0.0, 0.0, 0.0)
    for x in force:
        in_units({f"a force on {name}": x}, "N", "kN")
    for x in moment:
        in_units({f"a moment on {name}": x}, "Nm", "N·m")
    return pin.Force(np.array(force, dtype=float), np.array(moment, dtype=float))


def _tell_forces(
    options: argparse.Namespace, mechanism: sp.Mechanism, found: sp.Efforts
) -> None:
    """Answer with efforts and reactions of one configuration."""
    units = {name: EFFORTS[mechanism.coordinate(name).unit] for name in found.efforts}
    alone = found.unique_efforts
    efforts = [[name, f"{x:.9g}{'*' * (not alone[name])}", units[name]]
               for name, x in found.efforts.items()]
    whole = np.array([force.vector for force in found.reactions.values()])
    pairs = [[name, *_marked(force.linear, found.unique[name][:3], whole),
              *_marked(force.angular, found.unique[name][3:], whole)]
             for name, force in found.reactions.items()]
    lines = [f"{mechanism.name} at rest, closed to {found.state.closure_error:.1e}", "efforts:",
             grid(efforts), "reactions of pairs, world axes [N, N·m]:",
             grid(pairs, ("", "fx", "fy", "fz", "mx", "my", "mz"))]
    if not all(alone.values()):
        lines.append(EFFORTS_OF_MANY)
    lines += found.why_not_unique()
    content = {
        "mechanism": mechanism.name, "closure_error": found.state.closure_error,
        "coordinates": {name: found.state.coordinate(name).value
                        for name in mechanism.coordinates},
        "efforts": found.efforts, "units": units, "unique_efforts": alone,
        "reactions": {name: [*force.linear.tolist(), *force.angular.tolist()]
                      for name, force in found.reactions.items()},
        "unique": {name: each.tolist() for name, each in found.unique.items()},
        "on_ground": [*found.on_ground.linear.tolist(), *found.on_ground.angular.tolist()],
    }
    print_result(options, "\n".join(lines), finite(content), _table(found, units))


def _table(found: sp.Efforts, units: dict[str, str]) -> dict[str, list[Any]]:
    """Return efforts and reactions, a number a row; named as `Kinetostatics.columns` names them."""
    rows = [(f"{name} effort", x, units[name], found.unique_efforts[name])
            for name, x in found.efforts.items()]
    ground = {"on ground": (found.on_ground, np.ones(6, dtype=bool))}
    for name, (force, unique) in ({f"{name} reaction": (x, found.unique[name])
                                  for name, x in found.reactions.items()} | ground).items():
        rows += [(f"{name} {part} {axis}", float(x), unit, bool(one)) for (part, unit, axis), x, one
                 in zip(COMPONENTS, force.vector, unique, strict=True)]
    return dict(zip(("quantity", "value", "unit", "unique"), map(list, zip(*rows, strict=True)),
                    strict=True))


def _marked(x: Array, unique: Any, whole: Array) -> list[str]:
    """Return components, 0 where they are round-off of the whole, * where they are of many."""
    return [f"{float(tidy(c, whole)):.4g}{'*' * (not one)}"
            for c, one in zip(x, unique, strict=True)]


def _tell_curve(options: argparse.Namespace, found: sp.Kinetostatics) -> None:
    """Answer with efforts and reactions along a sweep."""
    table = found.columns()
    content = {"mechanism": found.motion.mechanism.name,
               "columns": {name: x.tolist() for name, x in table.items()},
               "reactions": {name: x.tolist() for name, x in found.reactions.items()},
               "on_ground": found.on_ground.tolist()}
    print_result(options, found, finite(content), table)


COMMANDS = {
    "statics": Command(statics, (
        *CONFIGURATION,
        option("--load", dest="loads", action="append", default=[], type=numbers,
               metavar="NAME=FX,FY,FZ[,MX,MY,MZ]",
               help="a force [N], and moment [N·m], on a link or frame at its origin, "
                    "world axes, as tip=0,0,-50N"),
        option("--actuated", action="append", default=[], metavar="NAME",
               help="a driver, joint or coordinate that holds it (all drivers)"),
        *over_options(),
        *data_options("efforts and reactions", "efforts and reactions, along --over one a column,"),
    )),
}
