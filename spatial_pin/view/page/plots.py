"""Outputs of a motion, or of its loads, drawn over its driver."""

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
from spatial_pin._support.outputs import literal, save_figure
from spatial_pin.motion.motion import Output, motion_needed
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.view.scene.film import one_way

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from spatial_pin.dynamics.kinetostatics import Kinetostatics
    from spatial_pin.mechanism.mechanism import Mechanism
    from spatial_pin.motion.motion import Motion

Array = NDArray[np.floating]

COLOURS = ("#0072b2", "#d55e00", "#009e73")  # of Okabe and Ito: x, y, z
INK, FAINT = "#2b3138", "#d5d9de"
NARROW = 1e-3  # range of the abscissa relative to its values: from there labels have 7 digits
LEGEND: dict[str, Any] = {"frameon": False, "handlelength": 1.2, "borderaxespad": 0.0}
DEGREE_STEPS = (1, 1.5, 3, 4.5, 6, 9, 10)  # times a power of ten: ticks at 15, 30, 45, 60, 90
# events of a simulation that have a time
OF_TIME = ("joint limit", "velocity limit", "effort limit", "stopped")
DASHES = ((0, (4, 3)), (0, (1, 2)), (0, (7, 2, 1, 2)), (0, (2, 1)))  # of events, kind by kind
MOST_PANELS = (4, 10)  # in one column, and in two: more columns keep a figure on a screen
MOST_OUTPUTS = 3  # drawn when none are named: more panels do not fit on a page


def _in_degrees(values: Array, unit: str) -> tuple[Array, str]:
    """Return values and unit, angles in degrees."""
    return (np.rad2deg(values), "°") if unit == "rad" else (values, unit)


def abscissa(motion: Motion) -> tuple[Array, str, str]:
    """Return values, name and unit of what outputs are drawn over: driver, time, or samples."""
    if motion.time is None and motion.driver is None:
        return np.arange(len(motion), dtype=float), "sample", ""
    if motion.time is not None and (motion.driver is None or not one_way(motion.driver)):
        return np.asarray(motion.time, float), "time", "s"
    values, unit = _in_degrees(np.asarray(motion.driver, float), motion.driver_unit)
    return values, motion.driver_name, unit


def _label(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} [{unit}]"


def _hold_still(axes: Axes, values: Array) -> None:
    """Widen the range of a constant, so that its round-off does not fill the panel."""
    finite = values[np.isfinite(values)]
    if finite.size and np.ptp(finite) <= TOLERANCES.nothing * np.max(np.abs(finite)):
        middle = float(np.mean(finite))
        reach = 0.1 * abs(middle) or 1.0
        axes.set_ylim(middle - reach, middle + reach)


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
    _hold_still(axes, values)
    style(axes)


def _marks(motion: Motion, over: str) -> dict[str, Array]:
    """Return where on the abscissa, the driver's or the time's, events lie, by their kind."""
    if over == motion.driver_name:
        events = motion.events
    elif motion.driver is None:
        events = [event for event in motion.events if event.kind in OF_TIME]
    else:
        return {}
    return {kind: np.array([e.value for e in events if e.kind == kind])
            for kind in dict.fromkeys(event.kind for event in events)}


def _mark_events(figure: Figure, motion: Motion, name: str, unit: str) -> None:
    """Draw a line at every event in all panels, and below them what the lines mean."""
    handles: dict[str, Line2D] = {}
    for k, (kind, values) in enumerate(_marks(motion, name).items()):
        for value in _in_degrees(values, "rad")[0] if unit == "°" else values:
            for axes in figure.axes:
                handles[kind] = axes.axvline(value, color=INK, linewidth=0.9, label=kind,
                                             linestyle=DASHES[k % len(DASHES)])
    if handles:
        figure.legend(list(handles.values()), list(handles), loc="outside lower right",
                      ncols=len(handles), fontsize=9, frameon=False, handlelength=2.4)


def _moves(motion: Motion, name: str) -> bool:
    """Whether an output changes by more than round-off."""
    values, _, unit = motion.output(name)
    size = motion.mechanism.characteristic_length if unit == "m" else 1.0
    return len(values) > 0 and np.ptp(values, axis=0).max() > TOLERANCES.nothing * size


def _of_joints(mechanism: Mechanism) -> dict[str, bool]:
    """Return the outputs that tell where joints are, and whether they do from the ground.

    They are the coordinates that a plain number describes, and the positions of floating bodies.
    """
    found = {}
    for c in mechanism.coordinate_table.values():
        from_ground = mechanism.model.parents[mechanism.joint_id(c.joint)] == 0
        if c.q >= 0:
            found[c.name] = from_ground
        elif mechanism.pair_of(c.joint) == "floating":
            found[f"{c.joint}.position"] = from_ground
    return found


def _of_links(mechanism: Mechanism) -> list[str]:
    """Return the outputs that tell where the links are, the last of the tree first."""
    links = [name for name in mechanism.links if name not in mechanism.unplaced]
    heavy = [x for x in links if x in mechanism.inertias and mechanism.inertias[x].mass > 0.0]
    found = [f"{x}.com.position" for x in heavy] or [f"{x}.position" for x in links]
    return found[::-1]


def default_outputs(motion: Motion) -> list[str]:
    """Return the outputs of a motion that an engineer looks at first, one to three.

    They are what moves of these, the first that do: the coordinates of joints on the ground that a
    plain number describes, and positions of floating bodies; the same of other joints; the
    positions of links. The coordinate that is swept comes last, where nothing else moves.
    """
    mechanism = motion.mechanism
    swept = mechanism.coordinate(motion.driver_name).name if motion.driver_name else ""
    joints = {name: ground for name, ground in _of_joints(mechanism).items() if name != swept}
    grounded = [name for name, from_ground in joints.items() if from_ground]
    for candidates in (grounded, list(joints), _of_links(mechanism)):
        moving = [name for name in candidates if _moves(motion, name)]
        if moving:
            return moving[:MOST_OUTPUTS]
    return [swept or next(iter(mechanism.coordinates))]


def svg(figure: Figure, name: str) -> str:
    """Return a figure as an SVG element for a page.

    Args:
        figure: the figure.
        name: what it shows, for those who cannot see it; its identifiers follow from it.
    """
    from matplotlib import rc_context

    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    drawing = buffer.getvalue()
    attributes = f'<svg role="img" aria-label="{html.escape(name)}"'
    return attributes + drawing[drawing.index("<svg") + 4 :]


def drawn_parts(motion: Motion, output: Output) -> Sequence[Output]:
    """Return what is drawn of an output: a reaction's force and moment, anything else itself.

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


def _label_abscissa(axes: Axes, x: Array, name: str, unit: str) -> None:
    """Label the abscissa of the last panel of a column."""
    from matplotlib.ticker import MaxNLocator

    if len(x) and np.ptp(x) < NARROW * np.abs(x).max(initial=0.0):
        axes.xaxis.set_major_locator(MaxNLocator(nbins=4))  # labels of many digits
    elif unit == "°":
        axes.xaxis.set_major_locator(MaxNLocator(nbins=10, steps=list(DEGREE_STEPS)))
    axes.set_xlabel(literal(_label(name, unit)))


def _columns(count: int, asked: int | None) -> int:
    """Return in how many columns so many panels stand.

    Raises:
        ValueError: fewer than one was asked for.
    """
    if asked is not None and asked < 1:
        raise ValueError(f"columns is {asked}; it is a whole number from 1 up")
    return min(count, asked or 1 + sum(count > most for most in MOST_PANELS))


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
        motion: the motion, or what `kinetostatics` found of it.
        outputs: names of outputs, as its `output` takes them, or quantities of one's own with a
            row for each sample of the motion.
        path: file to write as well; its suffix says how: .png, .svg, .pdf.
        title: heading, "" for none; the mechanism's title if not given.
        columns: of panels, which stand row by row; one up to four panels, two up to ten, else
            three if not given.

    Returns:
        The figure, a matplotlib one.

    Raises:
        TypeError: it is no Motion.
        UnknownNameError: there is no such output.
        SpatialPinError: an output is a force, and `motion` is not what `kinetostatics` found.
        ValueError: no outputs, no columns, or a suffix that no figure has.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 91), speed=1.0)
        >>> figure = sp.plot(motion, ["rocker_pin", "coupler_b.velocity"], "plot.svg")
        >>> len(figure.axes)
        2
    """
    from spatial_pin._support.figures import ShownFigure
    from spatial_pin.dynamics.kinetostatics import Kinetostatics

    if not hasattr(motion, "output"):  # as a Mechanism or a State
        motion_needed(motion)
    asked = [outputs] if isinstance(outputs, str | Output) else list(outputs)
    if not asked:
        raise ValueError("no outputs to plot: give at least one name")
    found = [x if isinstance(x, Output) else motion.output(x) for x in asked]
    moved = motion.motion if isinstance(motion, Kinetostatics) else motion
    found = [part for output in found for part in drawn_parts(moved, output)]
    x, driver, unit = abscissa(moved)
    title = moved.mechanism.title or moved.mechanism.name if title is None else plain_text(
        title, "title")
    columns = _columns(len(found), columns)
    height = (1.0 if title else 0.6) + 2.1 * math.ceil(len(found) / columns)
    figure = ShownFigure(figsize=(7.5 if columns == 1 else 5.0 * columns, height))
    panels = _panels(figure, len(found), columns)
    for axes, output in zip(panels, found, strict=True):
        _draw(axes, x, output)
    _mark_events(figure, moved, driver, unit)
    for axes in panels[-columns:]:
        _label_abscissa(axes, x, driver, unit)
    if title:
        figure.suptitle(literal(title), fontsize=12)
    if path is not None:
        save_figure(figure, path)
    return figure
