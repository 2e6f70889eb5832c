"""Outputs of a film as curves that the page draws under the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from spatial_pin.errors import SpatialPinError
from spatial_pin.motion.motion import Motion, Output
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.page.plots import abscissa, default_outputs, drawn_parts
from spatial_pin.view.scene.film import Film

NO_RATES = "output {!r}: a page that is moved by hand knows no rates"


def curves_of(shown: Film, names: Sequence[str]) -> dict[str, Any] | None:
    """Return the curves under the picture, for its script; None where nothing moves.

    Args:
        shown: the film.
        names: of outputs, as `Motion.output` takes them: the page opens with them. Without any it
            has those of `default_outputs`, behind a button.

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
    panels = _panels(motion, names or default_outputs(motion))
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


def _panels(motion: Motion, names: Sequence[str]) -> list[dict[str, Any]]:
    return [_panel(part) for name in names for part in drawn_parts(motion, motion.output(name))]


def _panel(output: Output) -> dict[str, Any]:
    values, unit = np.asarray(output.values, float), "" if output.unit == "1" else output.unit
    if unit == "rad":
        values, unit = np.rad2deg(values), "°"
    columns = values.reshape(len(values), -1).T
    names = "xyz" if len(columns) == 3 else [""] * len(columns)
    lines = [{"name": name, "values": _rounded(x)}
             for name, x in zip(names, columns, strict=True)]
    label = f"{output.label} [{unit}]" if unit else output.label
    return {"name": output.label, "label": label, "unit": unit,
            "lines": lines}


def _rounded(values: Array) -> list[float | None]:
    """Return values with the digits that a curve can show; None for what is none."""
    return [float(f"{x:.6g}") if math.isfinite(x) else None for x in values]
