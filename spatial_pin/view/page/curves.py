"""Outputs of a film as curves that the page draws under the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.motion.motion import Motion, Output
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.page.plots import abscissa, default_outputs, drawn_parts
from spatial_pin.view.scene.film import Film, film, moments

NO_RATES = "output {!r}: a page that is moved by hand knows no rates"


def curves_of(
    shown: Film, names: Sequence[str], others: Sequence[State | Motion] = ()
) -> dict[str, Any] | None:
    """Return the curves under the picture, for its script; None where nothing moves.

    Args:
        shown: the film.
        names: of outputs, as `Motion.output` takes them: the page opens with them. Without any it
            has those of `default_outputs`, behind a button.
        others: what is shown beside it; motions that have an output too have dashed curves.

    Raises:
        UnknownNameError: there is no such output.
        SpatialPinError: some are named, and nothing moves.
    """
    if not isinstance(shown.source, Motion) or not shown.seconds[-1] > 0:
        if names:
            raise SpatialPinError("curves belong to a motion: leave `curves` out of the look of "
                                  "what stands still")
        return None
    motion = shown.motion
    x, name, unit = abscissa(motion)
    drawn = names or default_outputs(motion)
    panels = _panels(motion, drawn)
    for k, other in enumerate((x for x in others if isinstance(x, Motion)), start=1):
        _add_other(panels, shown, film(other), drawn, f"other {k}" if k > 1 else "other")
    title = f"{name} [{unit}]" if unit else name
    return {"x": _rounded(x), "name": title, "panels": panels, "open": bool(names)}


def growing_curves(now: Motion, names: Sequence[str], over: str) -> dict[str, Any] | None:
    """Return curves without points, for a page that adds them while a mechanism is moved by hand.

    Args:
        now: where it stands, one sample.
        names: of outputs; None without any.
        over: what they are drawn over, with its unit.

    Raises:
        UnknownNameError: there is no such output.
        SpatialPinError: an output is a rate.
    """
    if not names:
        return None
    for output in map(now.output, names):
        if output.unit not in ("rad", "m"):
            raise SpatialPinError(NO_RATES.format(output.label))
    panels = _panels(now, names)
    for line in (line for panel in panels for line in panel["lines"]):
        line["values"] = []
    return {"x": [], "name": over, "panels": panels, "open": True}


def points_now(now: Motion, names: Sequence[str]) -> list[list[float | None]]:
    """Return what a sample adds to growing curves: of every panel a value for each line."""
    return [[line["values"][0] for line in panel["lines"]] for panel in _panels(now, names)]


def _add_other(
    panels: list[dict[str, Any]], shown: Film, other: Film, names: Sequence[str], called: str
) -> None:
    """Add the curves of another motion to those of a film, where they are shown together."""
    seconds, rows, _ = moments(shown, other)
    panel = iter(panels)
    for name in names:
        own = drawn_parts(shown.motion, shown.motion.output(name))
        try:
            found = drawn_parts(other.motion, other.motion.output(name))
        except UnknownNameError:
            found = ()
        for k, _ in enumerate(own):
            there = next(panel)
            for line in _panel(found[k])["lines"] if k < len(found) else ():
                given = np.array(line["values"], float)[rows]
                values = np.interp(shown.seconds, seconds, given, left=np.nan, right=np.nan)
                both = f"{line['name']} {called}".strip()
                there["lines"].append({"name": both, "values": _rounded(values),
                                       "of": line["of"]})


def _panels(motion: Motion, names: Sequence[str]) -> list[dict[str, Any]]:
    return [_panel(part) for name in names for part in drawn_parts(motion, motion.output(name))]


def _panel(output: Output) -> dict[str, Any]:
    values, unit = np.asarray(output.values, float), "" if output.unit == "1" else output.unit
    if unit == "rad":
        values, unit = np.rad2deg(values), "°"
    columns = values.reshape(len(values), -1).T
    names = "xyz" if len(columns) == 3 else [""] * len(columns)
    lines = [{"name": name, "values": _rounded(x), "of": k}
             for k, (name, x) in enumerate(zip(names, columns, strict=True))]
    label = f"{output.label} [{unit}]" if unit else output.label
    return {"name": output.label, "label": label, "unit": unit,
            "lines": lines}


def _rounded(values: Array) -> list[float | None]:
    """Return values with the digits that a curve can show; None for what is none."""
    return [float(f"{x:.6g}") if math.isfinite(x) else None for x in values]
