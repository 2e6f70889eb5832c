"""A motion in a few lines of text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

MOST_LINES = 12  # lines per kind of event: a summary of three kinds fits on a screen
EFFORTS = {"rad": "N·m", "m": "N"}  # units, by that of what they move


def heading(motion: Motion) -> str:
    """Return the mechanism, the number and range of steps, and the closure error."""
    name, unit = _over(motion)
    values = motion.driver if motion.driver is not None else motion.time
    span = ""
    if values is not None and len(values):
        span = f", {name} {tidy(values[0], values)} to {tidy(values[-1], values)} {unit}"
    return (f"{motion.mechanism.name}: {len(motion)} samples{span}, closure error at most "
            f"{motion.closure_error.max(initial=0.0):.1e}")


def error_lines(motion: Motion) -> list[str]:
    """Return a line that tells how far the motion may be off, where that was estimated."""
    return [f"  error: {motion.error}"] if len(motion) and len(motion.error_estimates) else []


def ranges(motion: Motion) -> list[str]:
    """Return a line for every coordinate: its range and its largest rate."""
    if not len(motion):
        return []
    table = motion.mechanism.coordinate_table
    width, lines = max(map(len, table), default=0), []
    for name, c in table.items():
        value, rate, _ = motion.coordinate(name)
        low, high = (round(float(x), 6) + 0.0 for x in (value.min(), value.max()))  # no -0
        lines.append(f"  {name:{width}}  {low:+.6f} to {high:+.6f} {c.unit}, rate "
                     f"{tidy(rate.min(), rate, '+')} to {tidy(rate.max(), rate, '+')} "
                     f"{motion.rate_unit(c.unit)}")
    return lines


def first_of(lines: Sequence[str], what: str) -> list[str]:
    """Return lines; if there are too many, the last line is the number of the others."""
    if len(lines) <= MOST_LINES:
        return list(lines)
    return [*lines[: MOST_LINES - 1], f"  ... and {len(lines) - MOST_LINES + 1} more {what}"]


def summary(motion: Motion) -> str:
    """Return a motion's heading, the ranges of its first coordinates, and its first events."""
    events = [f"  {event.text}" for event in motion.events]
    return "\n".join([heading(motion), *error_lines(motion),
                      *first_of(ranges(motion), "coordinates"),
                      *first_of(events, "events"), *unreached_lines(motion)])


def unreached_lines(motion: Motion) -> list[str]:
    """Return lines on the samples whose values cannot be reached."""
    lines = [f"  sample {k}: {reason}" for k, reason in motion.unreached.items()]
    return [f"  out of reach: {len(lines)} of {len(motion)} samples",
            *first_of(lines, "samples out of reach")] if lines else []


def effort_lines(motion: Motion, efforts: dict[str, Array]) -> list[str]:
    """Return a line for every effort (N,) over a motion: its range, and where it is largest."""
    width, lines = max(map(len, efforts), default=0), []
    for name, x in efforts.items():
        if len(x):
            unit = EFFORTS[motion.mechanism.coordinate(name).unit]
            lines.append(f"  {name:{width}}  {tidy(x.min(), x)} to {tidy(x.max(), x)} {unit}, "
                         f"largest {where(motion, int(np.abs(x).argmax()))}")
    return lines


def where(motion: Motion, row: int) -> str:
    """Return the driver value, or time, of a sample as text."""
    name, unit = _over(motion)
    values = motion.driver if motion.driver is not None else motion.time
    return f"at {name} = {values[row]:.6g} {unit}" if values is not None else f"in sample {row}"


def tidy(x: float, among: Array, sign: str = "") -> str:
    """Return a number as text with six digits; "0" if it is round-off of the largest of `among`."""
    return f"{0.0 if abs(x) <= TOLERANCES.round_off * np.abs(among).max() else x:{sign}.6g}"


def _over(motion: Motion) -> tuple[str, str]:
    return (motion.driver_name, motion.driver_unit) if motion.driver is not None else ("time", "s")
