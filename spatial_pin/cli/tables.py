"""What the command line reads besides numbers: tables of values, poses, measurements; targets."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.output_files import plain_text
from spatial_pin.dimensions.measurements import ENCODER, UNITS as MEASURED_UNITS
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.inverse_kinematics import targets
from spatial_pin.inverse_kinematics.named_targets import is_angle, is_coordinate, is_part
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.units import UNITS, ValueWithUnit, quantity

TIME = "time"
POINT, TURNED = ("x", "y", "z"), ("rx", "ry", "rz")  # columns of a frame: NAME.x, NAME.rx
NOT_READ = (" rate", " acceleration", " effort", " power", "closure error")  # what names end with
POSITION = re.compile(r" position ([xyz])$")  # of a frame, as tables are written
NO_POSITION = re.compile(r" (velocity|acceleration|jerk|force|moment) [xyz]$")  # not read either
ENERGY = "J"  # unit of other columns that `--csv` writes
# of targets: the units of their numbers, " " for none, and what makes one of these and a weight
KINDS: dict[str, tuple[tuple[str, ...], Callable[[Array, float | None], targets.Target]]] = {
    "position": (("m", "m", "m"), targets.position),
    "pose": (("m", "m", "m", "rad", "rad", "rad"), lambda x, weight: targets.pose(
        pin.SE3(pin.exp3(x[3:]), x[:3]), weight)),
    "orientation": (("rad", "rad", "rad"), lambda x, weight: targets.orientation(
        pin.exp3(x), weight)),
    "direction": ((" ", " ", " "), lambda x, weight: targets.direction(
        np.array([0.0, 0.0, 1.0]), x / (np.linalg.norm(x) or 1.0), weight)),
}
CENTRE = "com"  # name of the target of the centre of mass


def read_table(
    path: str | Path, mechanism: Mechanism | None = None, with_blanks: bool = False
) -> tuple[dict[str, Array], Array | None]:
    """Return columns (N,) by their names [rad, m], and times (N,) [s] where it has some.

    The first line of the file has names, each with or without its unit: `boom`, `boom [deg]`,
    `time [s]`; `tip position x [m]` is `tip.x`. Numbers may have units of their own, `20deg`.
    Between them are commas, or semicolons or tabs where the first line has no comma; numbers
    between semicolons may have decimal commas. Columns of rates, accelerations, efforts and
    energies, as `--csv` writes them, are left out. `with_blanks`: empty fields are NaN.
    """
    lines = _lines(path)
    if len(lines) < 2:
        raise SpatialPinError(f"{path}: no table: a line of names and lines of numbers are needed")
    columns: dict[str, Array] = {}
    (_, heads), *rows = lines
    for k, head in enumerate(heads):
        if not "".join(word for _, line in lines for word in line[k : k + 1]).strip():
            continue  # a comma at the end of every line leaves an empty column
        name, unit = _head(path, head)
        if name.endswith(NOT_READ) or NO_POSITION.search(name) or unit == ENERGY:
            continue
        if name in columns:
            raise SpatialPinError(f"{path}: two columns are named {name!r}")
        _check_unit(path, mechanism, name, unit)
        columns[name] = np.array([
            _number(path, mechanism, (name, unit, k), row, line[k].strip() if k < len(line) else "",
                    with_blanks) for row, line in rows])
    times = columns.pop(TIME, None)
    if times is not None and not with_blanks and (back := np.diff(times) <= 0.0).any():
        k = int(np.argmax(back))
        raise SpatialPinError(f"{path}: line {rows[k + 1][0]}: the time {times[k + 1]:.9g} s does "
                              f"not rise: {times[k]:.9g} s comes before it")
    return columns, times


@contextmanager
def name_of_column(path: str | Path, column: str) -> Iterator[None]:
    """Name file and column where it is the name of nothing."""
    try:
        yield
    except UnknownNameError as error:
        raise SpatialPinError(f"{path}: column {column!r}: {error}") from error


def _lines(path: str | Path) -> list[tuple[int, list[str]]]:
    """Return number and words of a table's lines, but for those that are blank."""
    try:
        with open(path, encoding="utf-8-sig") as file:
            text = file.read()
        first = text.partition("\n")[0]
        mark = next((mark for mark in ",;\t" if mark in first), ",")
        reader = csv.reader(text.splitlines(), delimiter=mark)
        lines = [(reader.line_num, [plain_text(word) for word in line]) for line in reader
                 if any(word.strip() for word in line)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise SpatialPinError(f"{path}: no table in UTF-8: {error}") from None
    for row, line in lines:
        if any(word.strip() for word in line[len(lines[0][1]):]):
            raise SpatialPinError(f"{path}: line {row} has more numbers than there are names")
    return [(row, [word.replace(",", ".") for word in line]) for row, line in lines] if (
        mark == ";") else lines


def _check_unit(path: str | Path, mechanism: Mechanism | None, name: str, unit: str) -> None:
    """Refuse a unit that does not fit the quantity of a column."""
    last, base = name.rpartition(".")[2], ""
    if name == TIME:
        base = "s"
    elif mechanism and is_coordinate(mechanism, name):
        base = mechanism.coordinate(name).unit
    elif mechanism and (is_angle(mechanism, name) or last in TURNED):
        base = "rad"
    elif mechanism and last in POINT:
        base = "m"
    given = ValueWithUnit(1.0)
    given.unit = unit
    if base and not given.is_for(base):
        raise SpatialPinError(f"{path}: column {name!r} is in {base}, not in {unit}")


def targets_of(
    path: str | Path, mechanism: Mechanism, columns: Mapping[str, Array]
) -> dict[str, Any]:
    """Return targets along a path, as `reach_path` takes them, from the columns of a table.

    `NAME.x`, `NAME.y` and `NAME.z` are points of a frame [m]; with `NAME.rx`, `NAME.ry` and
    `NAME.rz`, rotation vectors [rad], placements. Other columns are coordinates, drivers or outputs
    of one number, as `NAME.position.z` [m] and `LINK.angle` [rad].
    """
    targets: dict[str, Any] = {}
    frames: dict[str, dict[str, Array]] = {}
    for name, column in columns.items():
        frame, _, part = name.rpartition(".")
        with name_of_column(path, name):
            if frame and part in (*POINT, *TURNED) and not is_coordinate(mechanism, name) and (
                    not is_part(mechanism, name)):
                mechanism.frame_id(frame)
                frames.setdefault(frame, {})[part] = column
            else:
                is_own = is_coordinate(mechanism, name) or not is_part(mechanism, name)
                targets[mechanism.coordinate(name).name if is_own else name] = column
    return {**targets, **{frame: frame_targets(f"{path}: no column", frame, parts)
                        for frame, parts in frames.items()}}


def frame_targets(where: str, frame: str, parts: Mapping[str, Any]) -> Any:
    """Return points (N, 3) of a frame, or its placements, from columns (N,) by x, y, z, rx, ry, rz.

    `where` is the text before the names of missing columns.
    """
    wanted = (*POINT, *TURNED) if set(parts) & set(TURNED) else POINT
    missing = [f"{frame}.{part}" for part in wanted if part not in parts]
    if missing:
        raise SpatialPinError(f"{where} {', '.join(missing)}: a point has x, y and z, a "
                              "placement rx, ry and rz besides")
    rows = np.column_stack([parts[part] for part in wanted])
    return rows if wanted is POINT else [pin.SE3(pin.exp3(x[3:]), x[:3]) for x in rows]


def _head(path: str | Path, text: str) -> tuple[str, str]:
    match = re.fullmatch(r"\s*([^\[\]]+?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*", text)
    if match is None:
        raise SpatialPinError(f"{path}: {text!r} is no name of a column, as 'boom' or 'boom [deg]'")
    name, unit = POSITION.sub(r".\1", match[1]), match[2] or ""
    if unit not in UNITS:
        if name.endswith(NOT_READ) or NO_POSITION.search(name) or unit == ENERGY:
            return name, unit
        known = ", ".join(u for u in UNITS if u)
        raise SpatialPinError(f"{path}: column {name!r} has the unit {unit!r}; known are {known}")
    return name, unit


def _number(
    path: str | Path, mechanism: Mechanism | None, column: tuple[str, str, int], row: int,
    word: str, may_be_blank: bool,
) -> float:
    """Return the number [rad, m, s] of a field of a column (name, unit, number from 0)."""
    name, unit, k = column
    try:
        value = UNITS[unit] * float(word)
    except ValueError:
        if may_be_blank and not word:
            return float("nan")
    else:
        if math.isfinite(value) or (may_be_blank and math.isnan(value)):
            return value
    try:
        number = quantity(word)
    except ValueError:
        raise SpatialPinError(f"{path}: line {row}, column {k + 1}: "
                              f"{repr(word) if word else 'nothing'} is no number") from None
    _check_unit(path, mechanism, name, number.unit)
    return float(number)


# ---------------------------------------------------------------- measurements


def read_measurements(
    path: str | Path, mechanism: Mechanism, read: Collection[str] = ()
) -> list[tuple[dict[str, float], dict[str, Any]]]:
    """Return measurements as `calibrate` takes them: readings of encoders, and measured outputs.

    Columns of drivers, and of the coordinates in `read`, are what encoders read. Measured are
    `NAME.x`, `NAME.y`, `NAME.z` of a point [m], with `NAME.rx`, `NAME.ry`, `NAME.rz` (rotation
    vector, rad) of a placement, other coordinates by their names, and `NAME-OTHER` the distance of
    two frames [m]. A field that is empty was not measured at that pose.
    """
    columns, _ = read_table(path, mechanism, with_blanks=True)
    own = {name for d in mechanism.drivers.values()
           for name in (d.name, mechanism.coordinate(d.joint).name)} | set(read)
    count = len(next(iter(columns.values()))) if columns else 0
    measurements = []
    for i in range(count):
        row = {name: float(x[i]) for name, x in columns.items() if not np.isnan(x[i])}
        encoders = {name: row.pop(name) for name in list(row) if name in own}
        measurements.append((encoders, _measured(f"{path}: row {i + 1}", mechanism, row)))
    return measurements


def _measured(where: str, mechanism: Mechanism, row: Mapping[str, float]) -> dict[str, Any]:
    """Return the measured outputs of a pose, by name of a frame or coordinate."""
    entry: dict[str, Any] = {}
    frames: dict[str, dict[str, float]] = {}
    for name, value in row.items():
        frame, _, part = name.rpartition(".")
        words = name.split("-")
        pairs = (("-".join(words[:k]).strip(), "-".join(words[k:]).strip())
                 for k in range(1, len(words)))
        pair = next((two for two in pairs if all(map(mechanism.model.existFrame, two))), None)
        if name in mechanism.coordinate_table:
            entry[name] = value
        elif frame and part in (*POINT, *TURNED):
            frames.setdefault(frame, {})[part] = value
        elif pair:
            if pair[0] in entry or pair[0] in frames:
                raise SpatialPinError(f"{where}: {pair[0]!r} is measured twice; write the distance "
                                      f"as {pair[1]}-{pair[0]}")
            entry[pair[0]] = targets.distance(pair[1], value)
        else:
            entry[mechanism.coordinate(name).name] = value  # says which there are
    return {**entry, **{name: frame_targets(f"{where}: no", name, parts)[0]
                        for name, parts in frames.items()}}


def check_sigma(mechanism: Mechanism, sigma: Mapping[str, float]) -> None:
    """Refuse standard deviations in other units than their measurements."""
    for name, value in sigma.items():
        kind = name.rpartition(".")[2]
        coordinate = name.removesuffix(ENCODER)
        unit = MEASURED_UNITS.get(kind, "")
        if not unit and (coordinate in mechanism.drivers or coordinate in
                         mechanism.coordinate_table):
            unit = mechanism.coordinate(coordinate).unit
        if unit and isinstance(value, ValueWithUnit) and not value.is_for(unit):
            raise ValueError(f"sigma of {name} is in {unit}, not in {value.unit}")


# ---------------------------------------------------------------- targets


def read_target(text: str) -> tuple[str, Any]:
    """Return name and target of `NAME.position=x,y,z`, or of `NAME=value`.

    The latter is a coordinate, or another output of one number, as `NAME.position.z`.

    `NAME.pose=x,y,z,rx,ry,rz` has a rotation vector behind the position, `NAME.orientation=` the
    rotation vector alone, `NAME.direction=x,y,z` says where the z axis of the frame points,
    `NAME.distance=OTHER,d` how far it is from another frame. `com=x,y,z` is the centre of mass, `_`
    for what may be anywhere. `@w` behind any of them is its weight.
    """
    name, equals, value = text.partition("=")
    if not (name.strip() and equals):
        raise ValueError(f"{text!r} is not NAME.position=x,y,z or NAME=value")
    value, at, given = value.partition("@")
    weight = _weight(text, given) if at else None
    frame, _, kind = name.strip().rpartition(".")
    words = value.split(",")
    if frame and kind == "distance":
        return frame, _distance(text, words, weight)
    if name.strip() == CENTRE and len(words) > 1:
        return CENTRE, _centre(text, words, weight)
    if kind not in KINDS or not frame:
        if len(words) > 1:
            raise ValueError(f"{text!r}: several numbers are those of NAME.position, NAME.pose, "
                             "NAME.orientation, NAME.direction or com")
        number = quantity(value)
        if weight is None:
            return name.strip(), number
        return name.strip(), targets.CoordinateValue(weight=weight, value=number)
    units, make = KINDS[kind]
    of_kind = f"{'an' if kind == 'orientation' else 'a'} {kind}"
    if len(words) != len(units):
        raise ValueError(f"{text!r}: {of_kind} has {len(units)} numbers, not {len(words)}")
    numbers = [quantity(word) for word in words]
    if not all(x.is_for(unit) if unit != " " else not x.unit for x, unit in zip(
            numbers, units, strict=True)):
        raise ValueError(f"{text!r}: {of_kind} has numbers in {', '.join(units)}")
    if kind == "position" and f".{frame}".endswith(f".{CENTRE}"):  # of a link, or of the whole
        frame = name.strip()
    return frame, make(np.array(numbers, dtype=float), weight)


def _weight(text: str, given: str) -> float:
    weight = quantity(given)
    if not weight > 0.0 or weight.unit:
        raise ValueError(f"{text!r}: a weight is a positive number without a unit, behind the @")
    return float(weight)


def _distance(text: str, words: list[str], weight: float | None) -> targets.Target:
    if len(words) != 2:
        raise ValueError(f"{text!r}: a distance is NAME.distance=OTHER,d")
    length = quantity(words[1])
    if not length.is_for("m"):
        raise ValueError(f"{text!r}: a distance is in m, not in {length.unit}")
    return targets.distance(words[0].strip(), length, weight)


def _centre(text: str, words: list[str], weight: float | None) -> targets.Target:
    if len(words) != 3:
        raise ValueError(f"{text!r}: the centre of mass has 3 numbers, _ for any, not "
                         f"{len(words)}")
    point = [None if word.strip() == "_" else quantity(word) for word in words]
    if not all(x is None or x.is_for("m") for x in point):
        raise ValueError(f"{text!r}: the centre of mass has numbers in m")
    x, y, z = (None if v is None else float(v) for v in point)
    return targets.centre_of_mass(x, y, z, weight)
