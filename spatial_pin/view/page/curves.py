"""Outputs of a film as curves that the page draws under the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from spatial_pin.motion.motion import Motion, Output
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.page.plots import abscissa, default_outputs, drawn_parts
from spatial_pin.view.scene.film import Film


def curves_of(shown: Film, names: Sequence[str]) -> dict[str, Any] | None:
    """Return the curves under the picture, for its script; None where nothing moves.

    Args:
        shown: the film.
        names: of outputs, as `Motion.output` takes them: the page opens with them. Without any it
            has those of `default_outputs`, behind a button.

    Raises:
        UnknownNameError: there is no such output.
    """
    if not isinstance(shown.source, Motion) or not shown.seconds[-1] > 0:
        return None
    motion = shown.motion
    x, name, unit = abscissa(motion)
    panels = [_panel(part) for name in names or default_outputs(motion)
              for part in drawn_parts(motion, motion.output(name))]
    title = f"{name} [{unit}]" if unit else name
    return {"x": _rounded(x), "name": title, "panels": panels, "open": bool(names)}


def _panel(output: Output) -> dict[str, Any]:
    values, unit = np.asarray(output.values, float), "" if output.unit == "1" else output.unit
    if unit == "rad":
        values, unit = np.rad2deg(values), "°"
    columns = values.reshape(len(values), -1).T
    names = "xyz" if len(columns) == 3 else [""] * len(columns)
    lines = [{"name": name, "values": _rounded(x)}
             for name, x in zip(names, columns, strict=True)]
    return {"label": f"{output.label} [{unit}]" if unit else output.label, "unit": unit,
            "lines": lines}


def _rounded(values: Array) -> list[float | None]:
    """Return values with the digits that a curve can show; None for what is none."""
    return [float(f"{x:.6g}") if math.isfinite(x) else None for x in values]
