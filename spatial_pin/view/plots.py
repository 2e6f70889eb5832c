"""Outputs of a motion drawn over its driver."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from spatial_pin.kinematics.motion import Motion

Array = NDArray[np.floating]

COLOURS = ("#0072b2", "#d55e00", "#009e73")  # of Okabe and Ito: x, y, z
INK, FAINT = "#2b3138", "#d5d9de"
NEGLIGIBLE = 1e-9  # variation, by the largest value, that is round-off and not blown up
LEGEND: dict[str, Any] = {"frameon": False, "handlelength": 1.2, "borderaxespad": 0.0}
DEGREE_STEPS = (1, 1.5, 3, 4.5, 6, 9, 10)  # times a power of ten: ticks at 15, 30, 45, 60, 90


def _in_degrees(values: Array, unit: str) -> tuple[Array, str]:
    """Return values and unit, angles in degrees."""
    return (np.rad2deg(values), "°") if unit == "rad" else (values, unit)


def _abscissa(motion: Motion) -> tuple[Array, str, str]:
    """Return values, name and unit of what outputs are drawn over."""
    if motion.time is not None and (motion.driver is None or not _one_way(motion.driver)):
        return np.asarray(motion.time, float), "time", "s"
    values, unit = _in_degrees(np.asarray(motion.driver, float), motion.driver_unit)
    return values, motion.driver_name, unit


def _one_way(driver: Array) -> bool:
    """Whether the driver never turns back nor stands still."""
    steps = np.diff(driver)
    return bool(np.all(steps > 0) or np.all(steps < 0))


def _label(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} [{unit}]"


def _hold_still(axes: Axes, values: Array) -> None:
    """Widen the range of a constant, so that its round-off does not fill the panel."""
    finite = values[np.isfinite(values)]
    if finite.size and np.ptp(finite) <= NEGLIGIBLE * np.max(np.abs(finite)):
        middle = float(np.mean(finite))
        reach = 0.1 * abs(middle) or 1.0
        axes.set_ylim(middle - reach, middle + reach)


def _style(axes: Axes) -> None:
    axes.grid(color=FAINT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#8a939c")
    axes.tick_params(colors=INK)
    axes.margins(x=0)


def _draw(axes: Axes, x: Array, output: Any) -> None:
    """Draw one output: a line, or one a component with a legend."""
    values, unit = _in_degrees(np.asarray(output.values, float), output.unit)
    if values.ndim == 1:
        axes.plot(x, values, color=COLOURS[0])
    else:
        for component, name, colour in zip(values.T, "xyz", COLOURS, strict=True):
            axes.plot(x, component, color=colour, label=name)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=3, **LEGEND)
    axes.set_title(_label(output.label, unit), loc="left", fontsize=10, color=INK)
    _hold_still(axes, values)
    _style(axes)


def plot(
    motion: Motion,
    outputs: str | Sequence[str],
    path: str | Path | None = None,
    *,
    title: str | None = None,
) -> Figure:
    """Draw outputs of a motion over its driver, one panel each.

    They are drawn over the time, if the motion has one, where the driver turns back or stands
    still. Angles are drawn in degrees. The figure belongs to no window and leaves pyplot alone.

    Args:
        motion: the motion.
        outputs: names of outputs, as `motion.output` takes them.
        path: file to write as well; its suffix says how: .png, .svg, .pdf.
        title: heading; the mechanism's title if not given.

    Returns:
        The figure.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    names = [outputs] if isinstance(outputs, str) else list(outputs)
    if not names:
        raise ValueError("no outputs to plot: give at least one name")
    found = [motion.output(name) for name in names]
    x, driver, unit = _abscissa(motion)
    figure = Figure(figsize=(7.5, 1.0 + 2.1 * len(found)), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(found), sharex=True, squeeze=False)[:, 0]
    for axes, output in zip(panels, found, strict=True):
        _draw(axes, x, output)
    if unit == "°":
        panels[-1].xaxis.set_major_locator(MaxNLocator(nbins=10, steps=list(DEGREE_STEPS)))
    panels[-1].set_xlabel(_label(driver, unit))
    figure.suptitle(title or motion.mechanism.title or motion.mechanism.name, fontsize=12)
    if path is not None:
        figure.savefig(path)
    return figure
