"""Outputs of a motion, or of its loads, over its driver: figures, and the curves of a page."""

from __future__ import annotations

import html
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import checked, plain_text
from spatial_pin._support.output_files import literal, save_figure
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.motion.motion import Motion, Output, require_motion
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.view.scene.film import Film, film, is_monotonic, moments

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from spatial_pin.dynamics.kinetostatics import Kinetostatics

Array = NDArray[np.floating]

COLOURS = ("#0072b2", "#d55e00", "#009e73")  # of Okabe and Ito: x, y, z
INK, FAINT = "#2b3138", "#d5d9de"
NARROW = 1e-3  # range of the abscissa relative to its values: from there labels have 7 digits
LEGEND: dict[str, Any] = {"frameon": False, "handlelength": 1.2, "borderaxespad": 0.0}
DEGREE_STEPS = (1, 1.5, 3, 4.5, 6, 9, 10)  # times a power of ten: ticks at 15, 30, 45, 60, 90
# events of a simulation that have a time
OF_TIME = ("joint limit", "velocity limit", "effort limit", "lift off", "end of curve",
           "stopped")
DASHES = ((0, (4, 3)), (0, (1, 2)), (0, (7, 2, 1, 2)), (0, (2, 1)))  # of events, kind by kind
MOST_PANELS = (4, 10)  # in one column, and in two: more columns keep a figure on a screen
NO_RATES = "output {!r}: a page that is moved by hand knows no rates"
MOST_OUTPUTS = 3  # drawn when none are named: more panels do not fit on a page


def _in_degrees(values: Array, unit: str) -> tuple[Array, str]:
    """Return values and unit, angles in degrees."""
    return (np.rad2deg(values), "°") if unit == "rad" else (values, unit)


def abscissa(motion: Motion) -> tuple[Array, str, str]:
    """Return values, name and unit of the abscissa: driver, time, or samples."""
    if motion.time is None and motion.driver is None:
        return np.arange(len(motion), dtype=float), "sample", ""
    if motion.time is not None and (motion.driver is None or not is_monotonic(motion.driver)):
        return np.asarray(motion.time, float), "time", "s"
    values, unit = _in_degrees(np.asarray(motion.driver, float), motion.driver_unit)
    return values, motion.driver_name, unit


def _label(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} [{unit}]"


def style(axes: Axes) -> None:
    """Give a panel the library's looks."""
    axes.grid(color=FAINT, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#8a939c")
    axes.tick_params(colors=INK)
    axes.margins(x=0)
    axes.ticklabel_format(useOffset=False)  # no heading such as 1e-5-2.1379e1 to add in one's head


def _draw(axes: Axes, x: Array, output: Any) -> None:
    """Draw one output: a line, or one a component with a legend."""
    values, unit = _in_degrees(np.asarray(output.values, float), output.unit)
    if values.ndim == 1:
        axes.plot(x, values, color=COLOURS[0])
    else:
        for component, name, colour in zip(values.T, "xyz", COLOURS, strict=True):
            axes.plot(x, component, color=colour, label=name)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=3, **LEGEND)
    axes.set_title(literal(_label(output.label, unit)), loc="left", fontsize=10, color=INK)
    finite = values[np.isfinite(values)]
    if finite.size and np.ptp(finite) <= TOLERANCES.nothing * np.max(np.abs(finite)):
        middle = float(np.mean(finite))  # of a constant, whose round-off is not to fill the panel
        reach = 0.1 * abs(middle) or 1.0
        axes.set_ylim(middle - reach, middle + reach)
    style(axes)


def _dash_unstable(axes: Axes, stable: NDArray[np.bool_] | None) -> None:
    """Draw lines through poses at rest dashed where these are not stable."""
    if stable is None or stable.all():
        return
    for line in list(axes.lines):
        x, y = (np.asarray(part, float) for part in line.get_data())
        joined = stable.copy()  # a dashed line begins and ends at a stable pose
        joined[1:] &= stable[:-1]
        joined[:-1] &= stable[1:]
        axes.plot(x, np.where(joined, np.nan, y), color=line.get_color(), linestyle=DASHES[0])
        line.set_ydata(np.where(stable, y, np.nan))


def _mark_events(figure: Figure, motion: Motion, name: str, unit: str) -> None:
    """Draw a line at every event of the abscissa in all panels, and a legend below."""
    events = [] if name != motion.driver_name else motion.events
    if hasattr(motion, "load_factor") and motion.driver is not None:  # whose values are factors
        events = [event._replace(value=float(motion.driver[max(event.row - 1, 0) : event.row + 1]
                                             .mean())) for event in events]
    if name != motion.driver_name and motion.driver is None:
        events = [event for event in motion.events if event.kind in OF_TIME]
    handles: dict[str, Line2D] = {}
    for k, kind in enumerate(dict.fromkeys(event.kind for event in events)):
        values = np.array([event.value for event in events if event.kind == kind])
        for value in _in_degrees(values, "rad")[0] if unit == "°" else values:
            for axes in figure.axes:
                handles[kind] = axes.axvline(value, color=INK, linewidth=0.9, label=kind,
                                             linestyle=DASHES[k % len(DASHES)])
    if handles:
        figure.legend(list(handles.values()), list(handles), loc="outside lower right",
                      ncols=len(handles), fontsize=9, frameon=False, handlelength=2.4)


def default_outputs(motion: Motion) -> list[str]:
    """Return the outputs of a motion that an engineer looks at first, one to three.

    They are what moves of these, the first that do: the coordinates of joints on the ground that a
    plain number describes, and positions of floating bodies; the same of other joints; the
    positions of links. The coordinate that is swept comes last, where nothing else moves.
    """
    mechanism = motion.mechanism
    swept = mechanism.coordinate(motion.driver_name).name if motion.driver_name else ""
    joints, grounded = list[str](), list[str]()
    for c in mechanism.coordinate_table.values():
        name = c.name if c.q >= 0 else f"{c.joint}.position"
        if name in (swept, *joints) or (c.q < 0 and mechanism.pair_of(c.joint) != "floating"):
            continue
        joints.append(name)
        if mechanism.model.parents[mechanism.joint_id(c.joint)] == 0:
            grounded.append(name)
    links = [name for name in mechanism.links if name not in mechanism.unplaced]
    heavy = [x for x in links if x in mechanism.inertias and mechanism.inertias[x].mass > 0.0]
    bodies = [f"{x}.com.position" for x in heavy] or [f"{x}.position" for x in links]
    for candidates in (grounded, joints, bodies[::-1]):  # the last link of the tree first
        moving = []  # by more than round-off
        for name in candidates:
            values, _, unit = motion.output(name)
            size = mechanism.characteristic_length if unit == "m" else 1.0
            if len(values) and np.ptp(values, axis=0).max() > TOLERANCES.nothing * size:
                moving.append(name)
        if moving:
            return moving[:MOST_OUTPUTS]
    return [swept or next(iter(mechanism.coordinates))]


def svg(figure: Figure, name: str) -> str:
    """Return a figure as an SVG element for a page, with a name for readers who cannot see it."""
    from matplotlib import rc_context

    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    drawing = buffer.getvalue()
    attributes = f'<svg role="img" aria-label="{html.escape(name)}"'
    return attributes + drawing[drawing.index("<svg") + 4 :]


def drawn_parts(motion: Motion, output: Output) -> Sequence[Output]:
    """Return the curves of an output: a reaction's force and moment, any other output itself.

    One of the two that is round-off of the other, as a ball's moment, is drawn as zero.
    """
    if output.values.ndim == 1 or output.values.shape[1] == 3:
        return (output,)
    force, moment = output.parts()
    size = motion.mechanism.characteristic_length
    largest = [np.abs(x.values).max(initial=0.0) for x in (force, moment)]
    least = TOLERANCES.round_off * max(largest[0] * size, largest[1])
    return (force._replace(values=force.values * (largest[0] * size > least)),
            moment._replace(values=moment.values * (largest[1] > least)))


def _panels(figure: Figure, count: int, columns: int) -> list[Axes]:
    """Return panels with one abscissa, row by row; the last of each column has its labels."""
    rows = math.ceil(count / columns)
    grid = figure.add_gridspec(rows, columns)
    panels: list[Axes] = []
    for k in range(count):
        panels.append(figure.add_subplot(grid[divmod(k, columns)],
                                         sharex=panels[0] if panels else None))
        panels[k].tick_params(labelbottom=k + columns >= count)
    return panels


@checked
def plot(
    motion: Motion | Kinetostatics,
    outputs: str | Output | Sequence[str | Output],
    path: str | Path | None = None,
    *,
    title: str | None = None,
    columns: int | None = None,
) -> Figure:
    """Draw outputs of a motion, or of its loads, over its driver, one panel each.

    They are drawn over the time, if the motion has one, where the driver turns back or stands
    still. Angles are drawn in degrees. A reaction has two panels, its force and its moment. The
    figure belongs to no window and leaves pyplot alone; in a notebook it shows itself.

    Args:
        motion: the motion, or the result of `kinetostatics`.
        outputs: names of outputs, as its `output` takes them, or quantities of one's own with a
            row for each sample of the motion.
        path: file to write as well, in the format of its suffix: .png, .svg, .pdf.
        title: heading, "" for none; the mechanism's title if not given.
        columns: of panels, which stand row by row; one up to four panels, two up to ten, else
            three if not given.

    Returns:
        The figure, a matplotlib one.

    Raises:
        TypeError: it is no Motion.
        UnknownNameError: there is no such output.
        SpatialPinError: an output is a force, and `motion` is not a result of `kinetostatics`.
        ValueError: no outputs, no columns, or a suffix that no figure has.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 91), speed=1.0)
        >>> figure = sp.plot(motion, ["rocker_pin", "coupler_b.velocity"], "plot.svg")
        >>> len(figure.axes)
        2
    """
    from matplotlib.ticker import MaxNLocator

    from spatial_pin._support.figures import ShownFigure
    from spatial_pin.dynamics.kinetostatics import Kinetostatics

    if not hasattr(motion, "output"):  # as a Mechanism or a State
        require_motion(motion)
    several = [outputs] if isinstance(outputs, str | Output) else list(outputs)
    if not several:
        raise ValueError("no outputs to plot: give at least one name")
    curves = [x if isinstance(x, Output) else motion.output(x) for x in several]
    moved = motion.motion if isinstance(motion, Kinetostatics) else motion
    curves = [part for output in curves for part in drawn_parts(moved, output)]
    x, driver, unit = abscissa(moved)
    title = moved.mechanism.title or moved.mechanism.name if title is None else plain_text(
        title, "title")
    if columns is not None and columns < 1:
        raise ValueError(f"columns is {columns}; it is a whole number from 1 up")
    columns = min(len(curves), columns or 1 + sum(len(curves) > most for most in MOST_PANELS))
    height = (1.0 if title else 0.6) + 2.1 * math.ceil(len(curves) / columns)
    figure = ShownFigure(figsize=(7.5 if columns == 1 else 5.0 * columns, height))
    panels = _panels(figure, len(curves), columns)
    for axes, output in zip(panels, curves, strict=True):
        _draw(axes, x, output)
        _dash_unstable(axes, getattr(moved, "stable", None))
    _mark_events(figure, moved, driver, unit)
    is_narrow = len(x) > 0 and np.ptp(x) < NARROW * np.abs(x).max(initial=0.0)
    for axes in panels[-columns:]:  # the last of each column
        if is_narrow:
            axes.xaxis.set_major_locator(MaxNLocator(nbins=4))  # labels of many digits
        elif unit == "°":
            axes.xaxis.set_major_locator(MaxNLocator(nbins=10, steps=list(DEGREE_STEPS)))
        axes.set_xlabel(literal(_label(driver, unit)))
    if title:
        figure.suptitle(literal(title), fontsize=12)
    if path is not None:
        save_figure(figure, path)
    return figure


# ---------------------------------------------------------------- curves of a page


def curves_of(
    shown: Film, names: Sequence[str], others: Sequence[State | Motion] = ()
) -> dict[str, Any] | None:
    """Return the curves under the picture, for its script; None where nothing moves.

    The page opens with the named outputs; without any it has those of `default_outputs`, behind a
    button. Curves of other motions are dashed.
    """
    if not isinstance(shown.source, Motion) or not shown.seconds[-1] > 0:
        if names:
            raise SpatialPinError("curves belong to a motion: leave `curves` out of the look of "
                                  "a state")
        return None
    motion = shown.motion
    x, name, unit = abscissa(motion)
    drawn = names or default_outputs(motion)
    panels = _curve_panels(motion, drawn)
    for k, other in enumerate((x for x in others if isinstance(x, Motion)), start=1):
        _add_other(panels, shown, film(other), drawn, f"other {k}" if k > 1 else "other")
    return {"x": _rounded(x), "name": _label(name, unit), "panels": panels, "open": bool(names)}


def growing_curves(now: Motion, names: Sequence[str], over: str) -> dict[str, Any] | None:
    """Return curves without points, for a page that adds them while a mechanism is moved by hand.

    `now` is its pose, one sample; `over` the abscissa, with its unit. None without names.
    """
    if not names:
        return None
    for output in map(now.output, names):
        if output.unit not in ("rad", "m"):
            raise SpatialPinError(NO_RATES.format(output.label))
    panels = _curve_panels(now, names)
    for line in (line for panel in panels for line in panel["lines"]):
        line["values"] = []
    return {"x": [], "name": over, "panels": panels, "open": True}


def points_now(now: Motion, names: Sequence[str]) -> list[list[float | None]]:
    """Return the values of a sample for growing curves: for every line of every panel."""
    return [[line["values"][0] for line in panel["lines"]] for panel in _curve_panels(now, names)]


def _add_other(
    panels: list[dict[str, Any]], shown: Film, other: Film, names: Sequence[str], called: str
) -> None:
    """Add the curves of another motion to those of a film, where they are shown together."""
    seconds, rows, _ = moments(shown, other)
    panel = iter(panels)
    for name in names:
        own = drawn_parts(shown.motion, shown.motion.output(name))
        try:
            drawn = drawn_parts(other.motion, other.motion.output(name))
        except UnknownNameError:
            drawn = ()
        for k, _ in enumerate(own):
            there = next(panel)
            for line in _curve_panel(drawn[k])["lines"] if k < len(drawn) else ():
                given = np.array(line["values"], float)[rows]
                values = np.interp(shown.seconds, seconds, given, left=np.nan, right=np.nan)
                both = f"{line['name']} {called}".strip()
                there["lines"].append({"name": both, "values": _rounded(values),
                                       "of": line["of"]})


def _curve_panels(motion: Motion, names: Sequence[str]) -> list[dict[str, Any]]:
    return [_curve_panel(part) for name in names
            for part in drawn_parts(motion, motion.output(name))]


def _curve_panel(output: Output) -> dict[str, Any]:
    values, unit = _in_degrees(np.asarray(output.values, float), output.unit)
    unit = "" if unit == "1" else unit
    columns = values.reshape(len(values), -1).T
    names = "xyz" if len(columns) == 3 else [""] * len(columns)
    lines = [{"name": name, "values": _rounded(x), "of": k}
             for k, (name, x) in enumerate(zip(names, columns, strict=True))]
    return {"name": output.label, "label": _label(output.label, unit), "unit": unit,
            "lines": lines}


def _rounded(values: Array) -> list[float | None]:
    """Return values with the digits that a curve can show; None for NaN and infinity."""
    return [float(f"{x:.6g}") if math.isfinite(x) else None for x in values]
