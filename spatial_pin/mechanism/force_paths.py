"""Where the force of a coupling acts: at teeth, or along the strands of a belt.

In a mechanism file these are tables of a coupling by a ratio or ratios:

    [closures.teeth]
    frame = "ground"            # its axes; default: the body that carries the first joint
    point = [0.02, 0.0, 0.0]    # pitch point, where the pitch circles touch [m]
    pitch_line = [0, 0, 1]      # of the pitch surfaces there; default from the joints
    pressure_angle = 0.349      # in the normal section [rad]; default 20 degrees
    helix_angle = 0.0           # of the teeth on the first joint's gear, right-handed [rad];
                                # where axes cross, as of a worm, it follows from the ratio

    [closures.strands]
    frame = "ground"
    points = [[[0, 0.02, 0], [0.3, 0.05, 0]], [[0, -0.02, 0], [0.3, -0.05, 0]]]
    pretension = 0.0            # of each strand where no torque is handed on [N]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from spatial_pin._support.checks import numbers_or_none
from spatial_pin.numerics.linalg import Array

# Largest angles [rad]: teeth have pressure angles of 45 degrees at most, worms leads of a degree.
LARGEST = {"pressure_angle": math.radians(80.0), "helix_angle": math.radians(89.9)}


@dataclass(frozen=True, eq=False)
class Teeth:
    """Where two gears, or a gear and a rack, touch.

    Attributes:
        frame: in whose axes the rest is; "": the body that carries the first joint.
        point: (3,) of contact, on both pitch surfaces [m].
        pitch_line: (3,) unit vector in the plane that touches both pitch surfaces there, across
            the motion of the teeth; None: as the joints' axes have it.
        pressure_angle: in the normal section [rad].
        helix_angle: of the gear of the first joint, positive if right-handed [rad]; where axes
            cross it follows from the ratio, and one that is not 0 is compared with that.
    """

    frame: str
    point: Array
    pitch_line: Array | None = None
    pressure_angle: float = math.radians(20.0)
    helix_angle: float = 0.0

    @property
    def form(self) -> dict[str, Any]:
        """It as a mechanism file has it."""
        line = {} if self.pitch_line is None else {"pitch_line": self.pitch_line.tolist()}
        return {**({"frame": self.frame} if self.frame else {}), "point": self.point.tolist(),
                **line, "pressure_angle": self.pressure_angle, "helix_angle": self.helix_angle}


@dataclass(frozen=True, eq=False)
class Strands:
    """The straight strands of a belt, chain or rope between two wheels.

    Attributes:
        frame: in whose axes the rest is; "": the body that carries the first joint.
        points: (1 or 2, 2, 3) of each strand where it leaves the body of the first joint, and that
            of the last [m].
        pretension: of each strand where no force is handed on, not negative [N].
    """

    frame: str
    points: Array
    pretension: float = 0.0

    @property
    def form(self) -> dict[str, Any]:
        """It as a mechanism file has it."""
        return {**({"frame": self.frame} if self.frame else {}), "points": self.points.tolist(),
                "pretension": self.pretension}


def teeth_of(given: Any, _: Any = None) -> Teeth:
    """Return teeth from their table in a mechanism file; a ValueError names a wrong key."""
    if isinstance(given, Teeth):
        return given
    table = _table(given, ("frame", "point", "pitch_line", "pressure_angle", "helix_angle"))
    line = None
    if "pitch_line" in table:
        line = _numbers(table, "pitch_line", (3,))
        size = float(np.linalg.norm(line))
        if size == 0.0:
            raise ValueError("pitch_line: has no direction")
        line = line / size
    angles = {key: float(_numbers(table, key, ())) for key in ("pressure_angle", "helix_angle")
              if key in table}
    for key, angle in angles.items():
        if abs(angle) > LARGEST[key] or (key == "pressure_angle" and angle < 0.0):
            raise ValueError(f"{key}: is {angle} rad; teeth have less than {LARGEST[key]:.3g} rad")
    return Teeth(_frame(table), _numbers(table, "point", (3,)), line, **angles)


def strands_of(given: Any, _: Any = None) -> Strands:
    """Return strands from their table in a mechanism file; a ValueError names a wrong key."""
    if isinstance(given, Strands):
        return given
    table = _table(given, ("frame", "points", "pretension"))
    points = np.array(table.get("points"), dtype=object)
    if points.shape not in ((1, 2, 3), (2, 2, 3)):
        raise ValueError("points: one strand or two, each from a point [x, y, z] to another")
    points = _numbers(table, "points", points.shape)
    if np.any(np.all(points[:, 0] == points[:, 1], axis=1)):
        raise ValueError("points: a strand has a length")
    pretension = float(_numbers({"pretension": 0.0, **table}, "pretension", ()))
    if pretension < 0.0:
        raise ValueError(f"pretension: is {pretension} N; a belt does not push")
    return Strands(_frame(table), points, pretension)


def _table(given: Any, keys: tuple[str, ...]) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise ValueError(f"is a table of {', '.join(keys)}")
    for key in given:
        if key not in keys:
            raise ValueError(f"{key} is not one of its keys: {', '.join(keys)}")
    return given


def _frame(table: Mapping[str, Any]) -> str:
    frame = table.get("frame", "")
    if not isinstance(frame, str):
        raise ValueError(f"frame: is a name, not {str(frame)[:60]}")
    return frame


def _numbers(table: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> Array:
    numbers = numbers_or_none(table.get(key))
    if numbers.shape != shape or not np.isfinite(numbers).all():
        many = "three finite numbers are" if shape == (3,) else "a finite number is"
        raise ValueError(f"{key}: {many} needed, not {str(table.get(key))[:60]}")
    return numbers
