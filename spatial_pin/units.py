"""Quantities with units as people type them: `60deg`, `240rpm`, `12mm`."""

from __future__ import annotations

import math
import re

UNITS = {
    "": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180.0,
    "°": math.pi / 180.0,
    "turn": 2.0 * math.pi,
    "turns": 2.0 * math.pi,
    "m": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "in": 0.0254,
    "rad/s": 1.0,
    "deg/s": math.pi / 180.0,
    "rpm": 2.0 * math.pi / 60.0,
    "m/s": 1.0,
    "mm/s": 1e-3,
    "rad/s2": 1.0,
    "deg/s2": math.pi / 180.0,
    "rpm/s": 2.0 * math.pi / 60.0,
    "m/s2": 1.0,
    "mm/s2": 1e-3,
    "s": 1.0,
    "ms": 1e-3,
    "N": 1.0,
    "kN": 1e3,
    "Nm": 1.0,
    "N·m": 1.0,
}
LENGTHS = ("m", "cm", "mm", "um", "in")
KINDS = {  # what may be written for an SI unit
    "rad": ("rad", "deg", "°", "turn", "turns"), "m": LENGTHS,
    "rad/s": ("rad/s", "deg/s", "rpm"), "m/s": ("m/s", "mm/s"),
    "rad/s2": ("rad/s2", "deg/s2", "rpm/s"), "m/s2": ("m/s2", "mm/s2"),
    "s": ("s", "ms"), "N": ("N", "kN"), "N·m": ("Nm", "N·m"),
}

_PATTERN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*")


class ValueWithUnit(float):
    """An SI value that remembers the unit it was written with ("" for none)."""

    unit: str = ""

    def is_for(self, base: str) -> bool:
        """Whether it can be a value in `base`, an SI unit as "rad" or "m/s2"."""
        return not self.unit or self.unit in KINDS[base]


def quantity(text: str) -> ValueWithUnit:
    """Return the SI value of a number with an optional unit.

    Raises:
        ValueError: it is no finite number, or the unit is not known.
    """
    match = _PATTERN.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a number, as 30 or 30deg")
    if match[2] not in UNITS:
        units = ", ".join(unit for unit in UNITS if unit)
        raise ValueError(f"{text!r} has no unit that is known; there are: {units}")
    value = float(match[1]) * UNITS[match[2]]
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is not finite")
    value_with_unit = ValueWithUnit(value)
    value_with_unit.unit = match[2]
    return value_with_unit


def likely_unit(times: float) -> str:
    """Return the unit that a number was probably written in, by its size; "" if in its own.

    Args:
        times: the number, taken in metres or radians, relative to what it usually is.
    """
    if 300.0 < abs(times) < 3000.0:
        return "millimetres"
    return "degrees" if 40.0 < abs(times) < 80.0 else ""
