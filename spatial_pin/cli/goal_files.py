"""Goals of a design in a file: goals and bounds in TOML, or points and values in a table.

A TOML file has an array of tables `[[goal]]`, each with the `kind` of a goal of `sp.goals` and the
arguments of its function, and a table `[dimensions]` with the least and the largest value of each
that may change. Numbers are SI, or texts with a unit ("60deg", "12mm").
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.cli.tables import read_table, targets_of
from spatial_pin.dimensions.bounds import Bounds
from spatial_pin.errors import SpatialPinError, suggestion
from spatial_pin.formats.parsing import parse_toml
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.synthesis import goals
from spatial_pin.synthesis.precision import Goal
from spatial_pin.units import ValueWithUnit, quantity

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
    """Return the goals of a .toml or .csv file, and by dimension the bounds (least, most) or None.

    Raises:
        OSError: it cannot be read.
        SpatialPinError: it is no such file, or a goal is wrong; names file and goal.
    """
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
    """Refuse bounds with units of something else than a length or an angle, or of one of each.

    Raises:
        ValueError: names the dimension.
    """
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
    """Return goals for the columns of a .csv file.

    `NAME.x`, `NAME.y`, `NAME.z` are a path, with `NAME.rx`, `NAME.ry`, `NAME.rz` poses; columns of
    drivers say where they stand there; those of other coordinates are functions of the drivers.

    `more` are arguments that the goals have besides.
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
