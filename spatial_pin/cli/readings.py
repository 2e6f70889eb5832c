"""Measurements of a mechanism as the command line reads them: a table, a row for each pose."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spatial_pin.cli.tables import POINT, TURNED, frame_targets, read_table
from spatial_pin.dimensions.measurements import ENCODER, UNITS
from spatial_pin.errors import SpatialPinError
from spatial_pin.inverse_kinematics import targets
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.units import Quantity


def read_readings(
    path: str | Path, mechanism: Mechanism, read: Collection[str] = ()
) -> list[tuple[dict[str, float], dict[str, Any]]]:
    """Return measurements as `calibrate` takes them: what encoders read, and what was measured.

    Columns of drivers are what encoders read. Measured are `NAME.x`, `NAME.y`, `NAME.z` of a point
    [m], with `NAME.rx`, `NAME.ry`, `NAME.rz` (rotation vector, rad) of a placement, other
    coordinates by their names, and `NAME-OTHER` the distance of two frames [m]. A field that is
    empty was not measured at that pose.

    Args:
        path: of the file.
        mechanism: whose names these are.
        read: coordinates besides the drivers that are read.

    Raises:
        OSError: it cannot be read.
        SpatialPinError: it is no such table; says where.
        UnknownNameError: there is no such frame, coordinate or driver.
    """
    columns, _ = read_table(path, mechanism, with_blanks=True)
    own = {name for d in mechanism.drivers.values()
           for name in (d.name, mechanism.coordinate(d.joint).name)} | set(read)
    count = len(next(iter(columns.values()))) if columns else 0
    found = []
    for i in range(count):
        row = {name: float(x[i]) for name, x in columns.items() if not np.isnan(x[i])}
        encoders = {name: row.pop(name) for name in list(row) if name in own}
        found.append((encoders, _measured(f"{path}: row {i + 1}", mechanism, row)))
    return found


def _measured(where: str, mechanism: Mechanism, row: Mapping[str, float]) -> dict[str, Any]:
    """Return what was measured at a pose, by name of a frame or coordinate."""
    found: dict[str, Any] = {}
    frames: dict[str, dict[str, float]] = {}
    for name, value in row.items():
        frame, _, part = name.rpartition(".")
        pair = _pair(mechanism, name)
        if name in mechanism.coordinate_table:
            found[name] = value
        elif frame and part in (*POINT, *TURNED):
            frames.setdefault(frame, {})[part] = value
        elif pair:
            if pair[0] in found or pair[0] in frames:
                raise SpatialPinError(f"{where}: {pair[0]!r} is measured twice; write the distance "
                                      f"as {pair[1]}-{pair[0]}")
            found[pair[0]] = targets.distance(pair[1], value)
        else:
            found[mechanism.coordinate(name).name] = value  # says which there are
    return {**found, **{name: frame_targets(f"{where}: no", name, parts)[0]
                        for name, parts in frames.items()}}


def _pair(mechanism: Mechanism, name: str) -> tuple[str, str] | None:
    """Return the two frames that `NAME-OTHER` names, if it does."""
    model = mechanism.model
    words = name.split("-")
    for k in range(1, len(words)):
        first, second = "-".join(words[:k]).strip(), "-".join(words[k:]).strip()
        if model.existFrame(first) and model.existFrame(second):
            return first, second
    return None


def check_sigma(mechanism: Mechanism, sigma: Mapping[str, float]) -> None:
    """Refuse standard deviations whose units are not those of what they are of."""
    for name, value in sigma.items():
        kind = name.rpartition(".")[2]
        coordinate = name.removesuffix(ENCODER)
        unit = UNITS.get(kind, "")
        if not unit and (coordinate in mechanism.drivers or coordinate in
                         mechanism.coordinate_table):
            unit = mechanism.coordinate(coordinate).unit
        if unit and isinstance(value, Quantity) and not value.is_for(unit):
            raise ValueError(f"sigma of {name} is in {unit}, not in {value.unit}")
